//! Tables of figures that are neither generated nor say where their figures are from.
//!
//! A column is one of figures where at least half of its cells that hold something are figures. The first column of a table names its
//! rows, and does not count. A table with a column of figures is a table of figures. A cell is a figure where it begins with a digit,
//! after a sign, a bracket or a comparison, or where it holds a number with a unit. Code is no figure. A row of a table begins with `|`.
//!
//! A table of figures that were measured stands between the comments that [`super::tables`] generates it from. One of figures that nobody
//! measured (defaults, limits, what a paper states) stands right under a marker:
//!
//! ```text
//! <!-- given: SOURCE -->
//! ```
//!
//! A word of SOURCE with a `/` is a path in the repository, or a URL.
//!
//! A page that a program writes as a whole says so in a comment that begins with [`MADE`], and is left out.

use std::collections::BTreeMap;

use super::tables;

/// Begins a marker of figures that were not measured.
const GIVEN: &str = "<!-- given: ";
/// Begins a page that is generated as a whole.
const MADE: &str = "<!-- Made by `cargo xtask docs --tables`";

/// Units that make a number a figure.
const UNITS: [&str; 44] = [
    "%", "‰", "°", "°C", "K", "nm", "µm", "mm", "cm", "m", "km", "mm²", "m²", "ns", "µs", "us", "ms", "s",
    "min", "h", "days", "Hz", "kHz", "MHz", "nN", "mN", "N", "kN", "MN", "Pa", "kPa", "MPa", "V", "mV", "Ω",
    "kΩ", "g", "kg", "bytes", "kB", "MB", "GB", "MiB", "GiB",
];

/// What is wrong with the tables of a page: the line, counted from 1, and a sentence. `exists` tells whether the repository has a path.
pub fn unmarked(text: &str, exists: impl Fn(&str) -> bool) -> Vec<(usize, String)> {
    if text.starts_with(MADE) || text.contains(&format!("\n{MADE}")) {
        return Vec::new();
    }
    let mut wrong = Vec::new();
    let visible = visible(text);
    let mut lines = visible.iter().peekable();
    // The line of a marker that no table has followed yet.
    let mut marker: Option<usize> = None;
    while let Some(line) = lines.next() {
        match line {
            Line::Marker(at, said) => {
                if let Some(before) = marker.replace(*at) {
                    wrong.push((before, NO_TABLE.to_owned()));
                }
                if let Err(why) = check(said, &exists) {
                    wrong.push((*at, why));
                }
            }
            Line::Text(_, text) if text.trim().is_empty() => {}
            Line::Text(at, text) if is_row(text) => {
                let mut rows = vec![*text];
                while let Some(Line::Text(_, next)) =
                    lines.next_if(|l| matches!(l, Line::Text(_, t) if is_row(t)))
                {
                    rows.push(next);
                }
                if marker.take().is_none() && holds_figures(&rows) {
                    wrong.push((*at, UNMARKED.to_owned()));
                }
            }
            Line::Text(..) => {
                if let Some(at) = marker.take() {
                    wrong.push((at, NO_TABLE.to_owned()));
                }
            }
        }
    }
    wrong.extend(marker.map(|at| (at, NO_TABLE.to_owned())));
    wrong
}

const NO_TABLE: &str = "a marker of a table stands right above none";
const UNMARKED: &str =
    "a table of figures is neither generated (`<!-- table`) nor marked (`<!-- given: SOURCE -->`)";

enum Line<'a> {
    Text(usize, &'a str),
    /// A marker as a whole.
    Marker(usize, &'a str),
}

/// Lines that are no code, no comment and no part of what is generated, and markers. Where code and what is generated begin, their
/// first line stands for them.
fn visible(text: &str) -> Vec<Line<'_>> {
    let mut found = Vec::new();
    let (mut fence, mut comment, mut generated) = (None, false, false);
    for (i, line) in text.lines().enumerate() {
        let start = line.trim_start();
        if let Some(mark) = fence {
            if start.starts_with(mark) {
                fence = None;
            }
            continue;
        }
        fence = ["```", "~~~"].into_iter().find(|mark| start.starts_with(mark));
        if fence.is_some() || tables::begins(line) {
            // What follows is left out, and no marker reaches over it.
            found.push(Line::Text(i + 1, line));
        }
        if fence.is_some() {
            continue;
        }
        if line.starts_with(GIVEN) {
            found.push(Line::Marker(i + 1, line.trim_end()));
            continue;
        }
        if tables::begins(line) {
            generated = true;
        } else if line.trim_end() == tables::END {
            generated = false;
        }
        comment |= start.starts_with("<!--");
        if comment {
            comment = !line.contains("-->");
        } else if !generated {
            found.push(Line::Text(i + 1, line));
        }
    }
    found
}

/// What is wrong with a marker.
fn check(marker: &str, exists: &impl Fn(&str) -> bool) -> Result<(), String> {
    let source = marker.strip_prefix(GIVEN).and_then(|s| s.strip_suffix(" -->")).map(str::trim);
    let source = source
        .filter(|source| !source.is_empty())
        .ok_or_else(|| format!("`{marker}` is not of the form `{GIVEN}SOURCE -->`"))?;
    let mut paths = source.split_whitespace().map(|word| word.trim_matches([',', ';', '`']));
    let gone = paths.find(|word| word.contains('/') && !word.contains("://") && !exists(word));
    gone.map_or(Ok(()), |path| Err(format!("`{marker}` names {path}, which is not there")))
}

fn is_row(line: &str) -> bool {
    line.trim_start().starts_with('|')
}

/// Cells of a row of a table.
fn cells(row: &str) -> Vec<String> {
    let row = row.trim().replace("\\|", "\u{0}");
    let inside = row.strip_prefix('|').unwrap_or(&row);
    let inside = inside.strip_suffix('|').unwrap_or(inside);
    inside.split('|').map(|cell| cell.trim().replace('\u{0}', "|")).collect()
}

/// Whether one of the columns after the first is one of figures.
fn holds_figures(rows: &[&str]) -> bool {
    // Of each column, the cells that hold something, and those that hold a figure.
    let mut columns: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
    for row in rows.iter().skip(2) {
        for (i, cell) in cells(row).iter().enumerate().skip(1).filter(|(_, cell)| !cell.is_empty()) {
            let counts = columns.entry(i).or_default();
            counts[0] += 1;
            counts[1] += usize::from(is_figure(cell));
        }
    }
    columns.values().any(|[filled, figures]| 2 * figures >= *filled)
}

/// Whether a cell holds a figure.
fn is_figure(cell: &str) -> bool {
    // Code is left out: every second part between ticks.
    let text: String = cell.split('`').step_by(2).collect();
    let text = text.replace("&lt;", "<").replace("&gt;", ">");
    let bare = text.trim_start_matches(|c: char| c.is_whitespace() || "+-−–±~≈<>≤≥=([*".contains(c));
    let first: String = bare.chars().take_while(|c| c.is_ascii_digit() || *c == '.').collect();
    // An address has more than one point.
    if first.starts_with(|c: char| c.is_ascii_digit()) && first.matches('.').count() < 2 {
        return true;
    }
    let words: Vec<&str> =
        text.split_whitespace().map(|w| w.trim_matches(|c| ",;:()*".contains(c))).collect();
    let number = |word: &str| word.starts_with(|c: char| c.is_ascii_digit());
    words.windows(2).any(|pair| number(pair[0]) && UNITS.contains(&pair[1].trim_end_matches('.')))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines that are wrong in a text, in a repository that has `src/limits.rs` only.
    fn wrong(text: &str) -> Vec<usize> {
        unmarked(text, |path| path == "src/limits.rs").into_iter().map(|(line, _)| line).collect()
    }

    const MEASURED: &str = "| error | before | after |\n|---|---|---|\n| position [mm] | 0.55 | 0.20 |\n| force [N] | 0.10 | |\n";

    #[test]
    fn a_table_of_figures_without_a_source_is_wrong() {
        assert_eq!(wrong(&format!("Text.\n\n{MEASURED}")), [3]);
        // Nor does a comment of another kind, a marker of another table, or an end of what was generated help.
        assert_eq!(wrong(&format!("<!-- checked -->\n\n{MEASURED}")), [3]);
        assert_eq!(wrong(&format!("<!-- given: a paper -->\n\n{MEASURED}\n{MEASURED}")), [8]);
        let after = format!("<!-- table\n{MEASURED}-->\n\n{MEASURED}\n<!-- end table -->\n\n{MEASURED}");
        assert_eq!(wrong(&after), [15]);
    }

    #[test]
    fn a_table_that_says_where_its_figures_are_from_is_right() {
        for right in [
            format!("<!-- table\n{MEASURED}-->\n\n{MEASURED}\n<!-- end table -->\n"),
            format!("<!-- table once run: cargo x\n{MEASURED}-->\n\n{MEASURED}\n<!-- end table -->\n"),
            format!("<!-- targets speed. -->\n\n{MEASURED}\n<!-- end table -->\n"),
            format!("<!-- given: Table 5.2 of the thesis -->\n{MEASURED}"),
            format!("<!-- given: src/limits.rs, https://example.org/a -->\n{MEASURED}"),
            format!("```text\n{MEASURED}```\n"),
            format!("<!-- Made by `cargo xtask docs --tables` from the program. -->\n\n{MEASURED}"),
        ] {
            assert_eq!(wrong(&right), [0; 0], "{right}");
        }
    }

    #[test]
    fn a_marker_is_complete_and_stands_over_its_table() {
        for marker in ["<!-- given:  -->", "<!-- given: src/gone.rs -->"] {
            assert_eq!(wrong(&format!("Text.\n\n{marker}\n\n{MEASURED}")), [3], "{marker}");
        }
        let given = "<!-- given: a paper -->";
        assert_eq!(wrong(&format!("{given}\n\nText.\n\n{MEASURED}")), [1, 5]);
        assert_eq!(wrong(&format!("{given}\n```\ncode\n```\n\n{MEASURED}")), [1, 6]);
        assert_eq!(wrong(&format!("{given}\n<!-- targets a -->\n<!-- end table -->\n\n{MEASURED}")), [1, 5]);
        assert_eq!(wrong(&format!("{given}\n{given}\n\n{MEASURED}")), [1]);
        assert_eq!(wrong(given), [1]);
    }

    #[test]
    fn columns_of_figures_are_told_from_text() {
        let table = |cells: &[&str]| {
            let rows: Vec<String> = cells.iter().map(|cell| format!("| row 1 | text | {cell} |")).collect();
            format!("| | | |\n|---|---|---|\n{}\n", rows.join("\n"))
        };
        for figures in [
            &["0.44 (0.41–0.47) / 0.35"][..],
            &["within 0.3 % of the peak", "within 1.5 %"],
            &["displacement 4.6 %, strains 6.2 %", "unknown"],
            &["12 of 14", "", "–"],
            &["&lt;= 2", "≥ 3", "*7*"],
            &["a load\\|gauge of 3 mm"],
        ] {
            assert_eq!(wrong(&table(figures)), [1], "{figures:?}");
        }
        for text in [
            &["the first of 3 runs"][..],
            &["`0.5 s`", "127.0.0.1 and the address"],
            &["none", "as long as it takes", "0.5 s"],
            &["", ""],
        ] {
            assert_eq!(wrong(&table(text)), [0; 0], "{text:?}");
        }
        // Numbers of rows are no figures.
        assert_eq!(wrong("| | |\n|---|---|\n| 1 | first |\n| 2 | second |\n"), [0; 0]);
    }
}
