//! Tables of the book, made from `benches/results/*.json` and `targets.toml`.
//!
//! A page holds the table's template in a comment, and below it the table that was made from it:
//!
//! ```text
//! <!-- table
//! | node | frames/s per core |
//! |---|---|
//! | dermis over hiroz | {node /hiroz/frames_per_core | s3} |
//! -->
//! … the table …
//! <!-- end table -->
//! ```
//!
//! `{FILE POINTER | FORMAT}` is one figure, or several in neighbouring cells. FILE is a name in `benches/results/` without
//! `.json`, or `targets`. A step of the POINTER is a key, an index, a range `2..5` of indices (both included), a choice `a,b` of
//! keys, or `[key=value]`, the first item of a list whose field has that value. Words of the FORMAT: `*1000` scales, `.2` is
//! decimals, `s3` significant figures, `ci` takes two ends of an interval, `of` makes a count of a share ("4 of 5") by the field `of`
//! beside it, `reached` adds an asterisk where the field `reached` beside the figure is false.
//!
//! `<!-- table once FILE: COMMAND` in place of `<!-- table` is for figures that take hours: as long as FILE is not there, a sentence
//! stands in place of the table and names the command that makes it.
//!
//! `<!-- targets NAME … -->` is a table of those targets whose names begin so.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use serde_json::Value;

/// Begins the template of a table.
const TABLE: &str = "<!-- table";
/// Begins a table of targets.
const TARGETS: &str = "<!-- targets ";
/// Ends what is generated.
pub const END: &str = "<!-- end table -->";

/// Where figures come from.
pub struct Sources {
    folder: PathBuf,
    /// In the order of the file.
    targets: Vec<Value>,
    read: RefCell<BTreeMap<String, Rc<Value>>>,
}

impl Sources {
    pub fn new(root: &Path) -> Result<Self> {
        let text = fs::read_to_string(root.join("targets.toml")).context("targets.toml cannot be read")?;
        let file: Value = toml::from_str(&text).context("targets.toml cannot be read")?;
        let targets = file["target"].as_array().cloned().unwrap_or_default();
        Ok(Self { folder: root.join("benches/results"), targets, read: RefCell::default() })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }

    /// What was measured last, of a file in `benches/results/` without `.json`; `targets` are the targets by their names.
    pub fn file(&self, name: &str) -> Result<Rc<Value>> {
        if let Some(value) = self.read.borrow().get(name) {
            return Ok(value.clone());
        }
        let value = if name == "targets" {
            let named = self.targets.iter().map(|t| (t["name"].as_str().unwrap_or_default().to_owned(), t));
            Value::Object(named.map(|(name, target)| (name, target.clone())).collect())
        } else {
            let path = self.path(name);
            let text =
                fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
            serde_json::from_str(&text).with_context(|| format!("{} is no JSON", path.display()))?
        };
        let value = Rc::new(value);
        self.read.borrow_mut().insert(name.to_owned(), value.clone());
        Ok(value)
    }

    /// The text with its tables made anew.
    pub fn expand(&self, text: &str) -> Result<String> {
        let mut out = String::new();
        let mut lines = text.split_inclusive('\n');
        while let Some(line) = lines.next() {
            out.push_str(line);
            let start = line.trim_end();
            let table = if let Some(once) = table_start(start)? {
                let mut template = String::new();
                loop {
                    let line = lines.next().context("a comment with a table has no end `-->`")?;
                    out.push_str(line);
                    if line.trim_end() == "-->" {
                        break;
                    }
                    template.push_str(line);
                }
                match once {
                    Some((file, command)) if !self.path(file).exists() => {
                        format!("Not measured yet: `{command}` makes these figures.\n")
                    }
                    _ => self.fill(&template)?,
                }
            } else if let Some(names) = start.strip_prefix(TARGETS).and_then(|s| s.strip_suffix(" -->")) {
                self.list(&names.split(' ').collect::<Vec<_>>())?
            } else {
                continue;
            };
            // What stood there is left out. A table begins after an empty line.
            loop {
                let line = lines.next().with_context(|| format!("a table has no end `{END}`"))?;
                if line.trim_end() == END {
                    let _ = write!(out, "\n{table}\n{line}");
                    break;
                }
            }
        }
        Ok(out)
    }

    /// Figures in place of `{…}`.
    fn fill(&self, template: &str) -> Result<String> {
        let mut out = String::new();
        let mut rest = template;
        while let Some((before, after)) = rest.split_once('{') {
            let (inside, end) = after.split_once('}').with_context(|| format!("no `}}` after {after}"))?;
            out.push_str(before);
            out.push_str(&self.figures(inside).with_context(|| format!("figure {{{inside}}}"))?);
            rest = end;
        }
        out.push_str(rest);
        Ok(out)
    }

    fn figures(&self, what: &str) -> Result<String> {
        let (place, format) = what.split_once(" | ").unwrap_or((what, ""));
        let (file, pointer) = place.trim().split_once(' ').context("has no pointer")?;
        let file = self.file(file)?;
        let mut at: Vec<(&Value, &Value)> = vec![(&file, &Value::Null)];
        for step in pointer.trim().split('/').skip(1) {
            let mut next = Vec::new();
            for (value, _) in at {
                for found in steps(value, step)? {
                    next.push((found, value));
                }
            }
            at = next;
        }
        let cells = at.into_iter().map(|(value, parent)| show(value, parent, format));
        Ok(cells.collect::<Result<Vec<_>>>()?.join(" | "))
    }

    /// The targets whose names begin with one of `names`.
    fn list(&self, names: &[&str]) -> Result<String> {
        let mut out =
            String::from("| what | target | measured | command | commit |\n|---|---|---|---|---|\n");
        let chosen = |target: &&Value| {
            let name = target["name"].as_str().unwrap_or_default();
            names.iter().any(|start| *start == "all" || name.starts_with(start))
        };
        let mut count = 0;
        for target in self.targets.iter().filter(chosen) {
            let text = |key: &str| target[key].as_str().unwrap_or_default();
            let value = target["value"].as_f64();
            let unit = match text("unit") {
                "" | "1" => String::new(),
                unit => format!(" {unit}"),
            };
            let measured = value.map_or("not yet".to_owned(), |v| format!("{v}{unit}"));
            let kept = value.map(|v| crate::targets::keeps(text("bound"), v)).transpose()?;
            let note = if text("note").is_empty() { String::new() } else { format!(" ({})", text("note")) };
            let _ = writeln!(
                out,
                "| {}{} | {} | {measured}{} | `{}` | {} |",
                text("what").replace('|', "\\|"),
                note.replace('|', "\\|"),
                text("bound").replace('<', "&lt;").replace('>', "&gt;"),
                if kept == Some(false) { " \\*" } else { "" },
                text("command"),
                text("commit"),
            );
            count += 1;
        }
        if count == 0 {
            bail!("no target begins with {}", names.join(" or "));
        }
        Ok(out)
    }
}

/// Whether a line begins what is generated.
pub fn begins(line: &str) -> bool {
    line.starts_with(TABLE) || line.starts_with(TARGETS)
}

/// Whether a line begins a table, and what it waits for: a file, and the command that makes it.
fn table_start(line: &str) -> Result<Option<Option<(&str, &str)>>> {
    let Some(rest) = line.strip_prefix(TABLE) else { return Ok(None) };
    if rest.is_empty() {
        return Ok(Some(None));
    }
    let once = rest.strip_prefix(" once ").and_then(|rest| rest.split_once(": "));
    Ok(Some(Some(
        once.with_context(|| format!("`{line}` is not of the form `<!-- table once FILE: COMMAND`"))?,
    )))
}

/// The tables of a page that wait for a file: the line, counted from 1, the file and the command that makes it.
pub fn awaited(text: &str) -> Result<Vec<(usize, &str, &str)>> {
    let mut found = Vec::new();
    for (i, line) in text.lines().enumerate() {
        if let Some(Some((file, command))) = table_start(line.trim_end())? {
            found.push((i + 1, file, command));
        }
    }
    Ok(found)
}

/// What one step of a pointer leads to.
fn steps<'a>(value: &'a Value, step: &str) -> Result<Vec<&'a Value>> {
    let step = step.replace("~1", "/");
    if let Some((key, wanted)) =
        step.strip_prefix('[').and_then(|s| s.strip_suffix(']')).and_then(|s| s.split_once('='))
    {
        let items = value.as_array().with_context(|| format!("no list at [{key}=…]"))?;
        let fits = |item: &&Value| item[key].as_str() == Some(wanted);
        return Ok(vec![items.iter().find(fits).with_context(|| format!("no item with {key} = {wanted}"))?]);
    }
    if let (Some((from, to)), Some(items)) = (step.split_once(".."), value.as_array()) {
        let (from, to): (usize, usize) = (from.parse()?, to.parse()?);
        return items.get(from..=to).map(|s| s.iter().collect()).with_context(|| format!("no items {step}"));
    }
    let one = |key: &str| match value {
        Value::Array(items) => key.parse::<usize>().ok().and_then(|i| items.get(i)),
        _ => value.get(key),
    };
    if let Some(found) = one(&step) {
        return Ok(vec![found]);
    }
    let several: Option<Vec<&Value>> = step.split(',').map(one).collect();
    several.with_context(|| format!("no `{step}`"))
}

/// A figure in a cell.
fn show(value: &Value, parent: &Value, format: &str) -> Result<String> {
    let (mut scale, mut decimals, mut significant) = (1.0, None, None);
    let (mut interval, mut counted, mut mark) = (false, false, false);
    for word in format.split_whitespace() {
        if let Some(by) = word.strip_prefix('*') {
            scale = by.parse()?;
        } else if let Some(count) = word.strip_prefix('.') {
            decimals = Some(count.parse::<usize>()?);
        } else if word == "ci" {
            interval = true;
        } else if word == "of" {
            counted = true;
        } else if word == "reached" {
            mark = true;
        } else if let Some(count) = word.strip_prefix('s') {
            significant = Some(count.parse::<i32>()?);
        } else {
            bail!("`{word}` is no word of a format");
        }
    }
    let number = |value: f64| -> Result<String> {
        let value = value * scale;
        let decimals = match (decimals, significant) {
            (Some(decimals), _) => Some(decimals),
            (None, Some(count)) => Some(decimals_for(value, count)),
            (None, None) => None,
        };
        Ok(decimals.map_or(format!("{value}"), |d| format!("{value:.d$}")))
    };
    let mut text = match value {
        Value::Null => "–".to_owned(),
        Value::String(text) => text.clone(),
        Value::Bool(yes) => (if *yes { "yes" } else { "no" }).to_owned(),
        Value::Number(share) if counted => {
            let of = parent["of"].as_u64().context("has no whole number `of` beside it")?;
            // A case may count in part: a name that is one of three is worth a third.
            let count = (share.as_f64().unwrap_or(f64::NAN) * of as f64 * 10.0).round() / 10.0;
            format!("{count} of {of}")
        }
        Value::Number(_) => number(value.as_f64().unwrap_or(f64::NAN))?,
        Value::Array(ends) if interval && ends.len() == 2 => {
            let [low, high] = [0, 1].map(|i| ends[i].as_f64().unwrap_or(f64::NAN));
            format!("({}–{})", number(low)?, number(high)?)
        }
        other => bail!("is no figure: {}", other.to_string().chars().take(60).collect::<String>()),
    };
    if mark && parent["reached"] == Value::Bool(false) {
        text.push_str(" \\*");
    }
    Ok(text)
}

/// Decimals that show so many significant figures.
fn decimals_for(value: f64, significant: i32) -> usize {
    if value == 0.0 || !value.is_finite() {
        return 0;
    }
    // As rounded: 0.0999 with two figures is 0.10.
    let exponent = format!("{:.*e}", usize::try_from(significant - 1).unwrap_or(0), value.abs());
    let exponent: i32 = exponent.split_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0);
    usize::try_from(significant - 1 - exponent).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources() -> (tempfile::TempDir, Sources) {
        let dir = tempfile::tempdir().unwrap();
        let results = dir.path().join("benches/results");
        fs::create_dir_all(&results).unwrap();
        let json = r#"{"rows": [{"n": "a", "rms": 0.000123}, {"n": "b", "rms": 0.00456}],
            "score": {"value": 0.5, "reached": false, "ends": [0.25, 0.75]}, "x/y": 7,
            "shares": [{"of": 5, "value": 0.6000000000000001}, {"of": 6, "value": 0.9444444444444443}]}"#;
        fs::write(results.join("run.json"), json).unwrap();
        let targets = "[[target]]\nname = \"speed.a\"\nwhat = \"A | B\"\nbound = \"<= 2\"\nunit = \"ms\"\n\
                       command = \"cargo x\"\nvalue = 3.5\ncommit = \"abc\"\n";
        fs::write(dir.path().join("targets.toml"), targets).unwrap();
        let sources = Sources::new(dir.path()).unwrap();
        (dir, sources)
    }

    #[test]
    fn a_template_becomes_a_table_and_stays_one() {
        let (_dir, sources) = sources();
        let text = "before\n<!-- table\n| {run /rows/0..1/rms | *1000 s2} | {run /rows/[n=b]/rms | .3} |\n-->\nold\n<!-- end table -->\nafter\n";
        let made = sources.expand(text).unwrap();
        assert!(made.contains("\n\n| 0.12 | 4.6 | 0.005 |\n\n<!-- end table -->\nafter"), "{made}");
        assert!(!made.contains("old"));
        assert_eq!(sources.expand(&made).unwrap(), made);
    }

    #[test]
    fn a_table_that_waits_for_a_file_says_so_until_it_is_there() {
        let (dir, sources) = sources();
        let text = "<!-- table once long: cargo xtask measure long\n| {long /n} |\n-->\n<!-- end table -->\n";
        let made = sources.expand(text).unwrap();
        assert!(
            made.contains(
                "-->\n\nNot measured yet: `cargo xtask measure long` makes these figures.\n\n<!-- end"
            ),
            "{made}"
        );
        assert_eq!(sources.expand(&made).unwrap(), made);
        fs::write(dir.path().join("benches/results/long.json"), "{\"n\": 7}").unwrap();
        let measured = sources.expand(&made).unwrap();
        assert!(
            measured.contains("\n\n| 7 |\n\n<!-- end") && !measured.contains("Not measured"),
            "{measured}"
        );
        for wrong in
            ["<!-- table once long\n-->\n<!-- end table -->\n", "<!-- tables\n-->\n<!-- end table -->\n"]
        {
            assert!(sources.expand(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn figures_are_shown_as_requested() {
        let (_dir, sources) = sources();
        for (what, shown) in [
            ("run /score/value | .2 reached", "0.50 \\*"),
            ("run /score/ends | ci .2", "(0.25–0.75)"),
            ("run /x~1y", "7"),
            ("run /shares/0..1/value | of", "3 of 5 | 5.7 of 6"),
            ("run /rows/0..1/n", "a | b"),
            ("run /score/value,reached", "0.5 | no"),
            ("targets /speed.a/value | .1", "3.5"),
        ] {
            assert_eq!(sources.figures(what).unwrap(), shown, "{what}");
        }
        for wrong in [
            "run /gone",
            "gone /a",
            "run",
            "run /rows",
            "run /rows/[n=c]/rms",
            "run /score/value | q",
            "run /x~1y | of",
        ] {
            assert!(sources.figures(wrong).is_err(), "{wrong}");
        }
        assert_eq!([9.96, 0.0999, 0.0, 1457.2, 0.101].map(|v| decimals_for(v, 2)), [0, 2, 0, 0, 2]);
    }

    #[test]
    fn targets_are_listed_with_what_was_missed() {
        let (_dir, sources) = sources();
        let made = sources.expand("<!-- targets speed. -->\n<!-- end table -->\n").unwrap();
        assert!(made.contains("| A \\| B | &lt;= 2 | 3.5 ms \\* | `cargo x` | abc |"), "{made}");
        assert!(sources.expand("<!-- targets none -->\n<!-- end table -->\n").is_err());
        assert!(sources.expand("<!-- targets speed. -->\n").is_err());
        assert!(sources.expand("<!-- table\n").is_err());
    }
}
