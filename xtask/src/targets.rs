//! `targets.toml`: every target figure of the project, and the command that measures it.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::{Args, Parser};
use serde::Deserialize;
use serde_json::Value;

use crate::docs::tables::Sources;
use crate::run::output;
use crate::{Cli, programs, record};

/// Which figures, and how to report.
#[derive(Args)]
pub struct Options {
    /// Only the figures whose name starts with this.
    name: Option<String>,
    /// List the figures and what was last measured, without measuring.
    #[arg(long)]
    list: bool,
    /// One JSON array instead of a table.
    #[arg(long)]
    json: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    target: Vec<Target>,
}

/// One figure.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Target {
    name: String,
    /// What the figure is, in a sentence.
    what: String,
    /// `<= 0.5` or `>= 20`.
    bound: String,
    unit: String,
    /// Shell command, run in the repository's root; its last line of output is JSON. `dermis` is the program as it is now.
    command: String,
    /// Where the figure stands in that JSON (RFC 6901).
    pointer: String,
    /// File in `benches/results/`, without `.json`, that keeps what the command measured, with the figure at the same place. Of a command
    /// that writes several, each keeps what is printed under one key, and the figure stands there without that first step.
    record: Option<String>,
    /// Last measured value, and the commit it was measured at.
    value: Option<f64>,
    commit: Option<String>,
    /// Why a bound is missed, or what the figure rests on.
    note: Option<String>,
}

/// Whether `value` keeps `bound`.
pub fn keeps(bound: &str, value: f64) -> Result<bool> {
    let wrong = || format!("bound `{bound}` is neither `<= NUMBER` nor `>= NUMBER`");
    let (sign, number) = bound.split_once(' ').with_context(wrong)?;
    let number: f64 = number.trim().parse().with_context(wrong)?;
    Ok(match sign {
        "<=" => value <= number,
        ">=" => value >= number,
        _ => bail!(wrong()),
    })
}

fn measure(root: &Path, target: &Target) -> Result<f64> {
    let mut shell = Command::new("sh");
    if target.command.starts_with("dermis ") {
        let dermis = programs::dermis(root)?;
        let folders = std::env::var_os("PATH").unwrap_or_default();
        let folders = dermis.parent().map(Path::to_owned).into_iter().chain(std::env::split_paths(&folders));
        shell.env("PATH", std::env::join_paths(folders)?);
    }
    let text = output(shell.args(["-c", &target.command]).current_dir(root))?;
    let line = text.lines().rev().find(|l| !l.trim().is_empty()).context("it printed nothing")?;
    let json: Value =
        serde_json::from_str(line).with_context(|| format!("its last line is no JSON: {line}"))?;
    json.pointer(&target.pointer)
        .and_then(Value::as_f64)
        .with_context(|| format!("its JSON has no number at {}: {line}", target.pointer))
}

impl File {
    fn read(root: &Path) -> Result<Self> {
        let path = root.join("targets.toml");
        let text =
            std::fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        toml::from_str(&text).with_context(|| format!("{} is not as expected", path.display()))
    }
}

/// Share by which a rounded value may differ from its record.
const ROUNDED: f64 = 0.02;

/// What is not true of `targets.toml`, one sentence each: a command that is none, a record that its command does not write, a value that is
/// not that of its record, a missed bound without a reason. A record that its command has not written yet is none to hold a value against.
pub fn untrue(root: &Path) -> Result<Vec<String>> {
    let (mut wrong, records) = (Vec::new(), Sources::new(root)?);
    for target in &File::read(root)?.target {
        let Target { name, bound, pointer, value, note, command, .. } = target;
        let written = match written(command) {
            Ok(written) => written,
            Err(why) => {
                wrong.push(format!("targets.toml: the command of `{name}` is none: {why}"));
                continue;
            }
        };
        if let Some(value) = value
            && !keeps(bound, *value)?
            && !note.as_ref().is_some_and(|note| note.contains("missed"))
        {
            wrong.push(format!("targets.toml: `{name}` misses its bound; say so in its note, and why"));
        }
        let Some(kept) = &target.record else {
            if let [first, ..] = written.as_slice() {
                wrong.push(format!(
                    "targets.toml: `{name}` names no record, but its command writes `{first}`"
                ));
            }
            continue;
        };
        if !written.is_empty() && !written.contains(kept) {
            wrong.push(format!(
                "targets.toml: the command of `{name}` does not write `{kept}`, but {}",
                written.join(", ")
            ));
            continue;
        }
        if !written.is_empty() && !record::path(root, kept).exists() {
            continue;
        }
        let recorded = records.file(kept).with_context(|| format!("the record of target `{name}`"))?;
        let Some(value) = value else { continue };
        match figure(&recorded, pointer, written.len() > 1) {
            Some(found) if (found - value).abs() <= ROUNDED * found.abs() => {}
            found => wrong.push(format!(
                "targets.toml: `{name}` is {value}, and {} at {pointer} of benches/results/{kept}.json; enter what was measured last",
                found.map_or("no number".to_owned(), |found| found.to_string())
            )),
        }
    }
    Ok(wrong)
}

/// A figure in a record; in one of several without the first step of its pointer.
fn figure(record: &Value, pointer: &str, of_several: bool) -> Option<f64> {
    let rest = pointer.get(1..).and_then(|steps| steps.find('/')).map(|end| &pointer[end + 1..]);
    record.pointer(if of_several { rest? } else { pointer })?.as_f64()
}

/// Names of the records that a command writes, as far as they are known: those of `cargo xtask measure` and `cargo xtask bench`. A sentence
/// where a `cargo xtask` is not one that this program has; commands of other programs are not judged here.
pub fn written(command: &str) -> Result<Vec<String>, String> {
    let words: Vec<&str> = command.split_whitespace().collect();
    let ["cargo", "xtask", arguments @ ..] = words.as_slice() else { return Ok(Vec::new()) };
    let parsed = Cli::try_parse_from(std::iter::once(&"xtask").chain(arguments));
    Ok(match parsed.map_err(|error| error.to_string())?.command {
        crate::Command::Measure(measurement) => {
            measurement.records().iter().map(|name| (*name).to_owned()).collect()
        }
        crate::Command::Bench(options) => options.names.iter().map(|name| name.record()).collect(),
        _ => Vec::new(),
    })
}

pub fn run(root: &Path, options: &Options) -> Result<()> {
    let file = File::read(root)?;
    let wanted: Vec<&Target> = file
        .target
        .iter()
        .filter(|t| options.name.as_ref().is_none_or(|n| t.name.starts_with(n.as_str())))
        .collect();
    if wanted.is_empty() {
        let names: Vec<&str> = file.target.iter().map(|t| t.name.as_str()).collect();
        bail!("no such figure; there are {}", names.join(", "));
    }
    let mut missed = Vec::new();
    let mut rows = Vec::new();
    for target in wanted {
        let (value, commit) = if options.list {
            (target.value, target.commit.clone())
        } else {
            eprintln!("measuring {}: {}", target.name, target.command);
            let value =
                measure(root, target).with_context(|| format!("{} cannot be measured", target.name))?;
            (Some(value), None)
        };
        let ok = value.map(|v| keeps(&target.bound, v)).transpose()?;
        if ok == Some(false) {
            missed.push(target.name.clone());
        }
        let verdict = match ok {
            Some(true) => "kept",
            Some(false) => "MISSED",
            None => "never measured",
        };
        if options.json {
            rows.push(serde_json::json!({
                "name": target.name, "what": target.what, "bound": target.bound, "unit": target.unit,
                "value": value, "kept": ok, "commit": commit, "note": target.note,
            }));
        } else {
            let shown = value.map_or("-".to_owned(), |v| format!("{v:.4}"));
            let at = commit.map_or(String::new(), |c| format!(" at {c}"));
            println!(
                "{:<34} {shown:>10} {} (target {}){at}: {verdict}",
                target.name, target.unit, target.bound
            );
            println!("    {}", target.what);
            if let Some(note) = &target.note {
                println!("    {note}");
            }
        }
    }
    if options.json {
        println!("{}", Value::Array(rows));
    }
    if missed.is_empty() || options.list {
        return Ok(());
    }
    bail!("bounds missed: {}", missed.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_both_ways() {
        assert!(keeps("<= 0.5", 0.5).unwrap() && !keeps("<= 0.5", 0.51).unwrap());
        assert!(keeps(">= 20", 20.0).unwrap() && !keeps(">= 20", 19.9).unwrap());
        assert!(keeps("about 3", 3.0).is_err());
    }

    #[test]
    fn the_file_of_this_repository_is_well_formed() {
        let root = crate::run::root().unwrap();
        let file = File::read(&root).unwrap();
        let mut names: Vec<&str> = file.target.iter().map(|t| t.name.as_str()).collect();
        names.sort_unstable();
        let count = names.len();
        names.dedup();
        assert_eq!(count, names.len(), "names are unique");
        for target in &file.target {
            keeps(&target.bound, 0.0).unwrap();
            assert!(target.pointer.starts_with('/'));
        }
        assert_eq!(untrue(&root).unwrap(), [""; 0]);
    }

    #[test]
    fn what_a_command_writes_is_known_and_a_command_that_is_none_is_said() {
        assert_eq!(written("cargo xtask bench gap"), Ok(vec!["gap-speed".to_owned()]));
        assert_eq!(written("cargo xtask measure start"), Ok(vec!["start".to_owned()]));
        assert_eq!(written("cargo xtask fuzz --runs 3"), Ok(Vec::new()));
        assert_eq!(written("dermis bounds a.toml --json"), Ok(Vec::new()));
        assert!(written("cargo xtask measure stert").unwrap_err().contains("stert"));
        assert!(written("cargo xtask bench soak --minuets 3").is_err());
    }

    #[test]
    fn a_record_that_its_command_does_not_write_is_found() {
        let root = tempfile::tempdir().unwrap();
        let results = root.path().join("benches/results");
        std::fs::create_dir_all(&results).unwrap();
        let target = |name: &str, command: &str, pointer: &str, record: &str| {
            format!(
                "[[target]]\nname = \"{name}\"\nwhat = \"w\"\nbound = \"<= 3\"\nunit = \"\"\ncommand = \"cargo xtask {command}\"\n\
                 pointer = \"{pointer}\"\nvalue = 1.0\n{record}\n"
            )
        };
        let text = [
            target("none", "mesure start", "/a", ""),
            target("silent", "measure start", "/a", ""),
            target("other", "measure start", "/a", "record = \"restart\""),
            target("later", "measure start", "/a", "record = \"start\""),
            target("several", "measure insight", "/fovea/a/b", "record = \"insight-fovea\""),
        ]
        .concat();
        std::fs::write(root.path().join("targets.toml"), &text).unwrap();
        std::fs::write(results.join("insight-fovea.json"), r#"{ "a": { "b": 1.0 } }"#).unwrap();
        let wrong = untrue(root.path()).unwrap();
        assert_eq!(wrong.len(), 3, "{wrong:#?}");
        assert!(wrong[0].starts_with("targets.toml: the command of `none` is none: "), "{}", wrong[0]);
        assert_eq!(
            wrong[1..],
            [
                "targets.toml: `silent` names no record, but its command writes `start`",
                "targets.toml: the command of `other` does not write `restart`, but start",
            ]
        );
        // Once it is written, it counts.
        std::fs::write(results.join("start.json"), r#"{ "a": 2.0 }"#).unwrap();
        std::fs::write(results.join("insight-fovea.json"), r#"{ "a": 1.0 }"#).unwrap();
        let wrong = untrue(root.path()).unwrap();
        assert!(wrong.iter().any(|w| w.starts_with("targets.toml: `later` is 1, and 2 at /a")), "{wrong:#?}");
        assert!(
            wrong.iter().any(|w| w.starts_with("targets.toml: `several` is 1, and no number")),
            "{wrong:#?}"
        );
    }

    #[test]
    fn what_a_record_contradicts_and_a_miss_without_a_reason_are_found() {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(root.path().join("benches/results")).unwrap();
        std::fs::write(root.path().join("benches/results/r.json"), r#"{ "a": 1.004, "b": 2.0 }"#).unwrap();
        let target = |name: &str, value: f64, note: &str| {
            format!(
                "[[target]]\nname = \"{name}\"\nwhat = \"w\"\nbound = \"<= 3\"\nunit = \"\"\ncommand = \"c\"\npointer = \"/{name}\"\n\
                 record = \"r\"\nvalue = {value}\n{note}\n"
            )
        };
        let text = [target("a", 1.0, ""), target("b", 4.0, ""), target("c", 1.0, "")].concat();
        std::fs::write(root.path().join("targets.toml"), &text).unwrap();
        let wrong = untrue(root.path()).unwrap();
        assert_eq!(
            wrong,
            [
                "targets.toml: `b` misses its bound; say so in its note, and why",
                "targets.toml: `b` is 4, and 2 at /b of benches/results/r.json; enter what was measured last",
                "targets.toml: `c` is 1, and no number at /c of benches/results/r.json; enter what was measured last",
            ]
        );
        std::fs::write(root.path().join("targets.toml"), target("b", 4.0, "note = \"missed: why\"")).unwrap();
        assert_eq!(untrue(root.path()).unwrap().len(), 1);
    }
}
