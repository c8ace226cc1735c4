//! Bounds as text.

use std::fmt::Write as _;

use dermis_studies::bounds::{
    Findings, INTERVALS, TipChoice, alphas, by_interval, median, share_by_interval,
};
use dermis_theory::{Averages, ByForce, LineStudy};

/// Millimetres, as few digits as say something.
pub(crate) fn mm(metres: f64) -> String {
    number(metres * 1e3, 3)
}

/// A number that says something in so many digits behind the point; a dash where there is none.
fn number(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "-".into() }
}

/// A reading in the unit of the skin: as it is written from 1 on, and in three figures below.
fn reading(value: f64, digits: usize) -> String {
    if value.is_finite() && value.abs() >= 1.0 || value == 0.0 {
        return number(value, digits);
    }
    if !value.is_finite() {
        return "-".into();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).clamp(0, 12);
    if decimals > 6 { format!("{value:.2e}") } else { number(value, usize::try_from(decimals).unwrap_or(0)) }
}

/// Rows of cells, right-aligned, with a bar before each of the columns `bars`: as wide as their longest cell, and 9 at least.
fn table(rows: &[Vec<String>], bars: &[usize]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let longest = |k: usize| rows.iter().filter_map(|row| row.get(k)).map(|cell| cell.chars().count()).max();
    // The first column and those behind a bar stand apart by themselves.
    let apart = |k: usize| usize::from(k > 0 && !bars.contains(&k));
    let widths: Vec<usize> = (0..columns).map(|k| (longest(k).unwrap_or(0) + apart(k)).max(9)).collect();
    let mut out = String::new();
    for row in rows {
        for (k, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let bar = if bars.contains(&k) { " | " } else { "" };
            let _ = write!(out, "{bar}{cell:>width$}");
        }
        out.push('\n');
    }
    out
}

fn newtons(value: f64) -> String {
    number(value, 4)
}

/// For people.
#[must_use]
pub fn text(findings: &Findings) -> String {
    let mut out = String::new();
    if !findings.maps.is_empty() {
        bounds(&mut out, findings);
    }
    let unit = &findings.skin.unit;
    let sigma = findings.source.noise().iter().copied().fold(0.0, f64::max);
    if findings.line.is_some() || findings.surface.is_some() {
        let _ = writeln!(
            out,
            "\nisolines from {}; σ_S {} {unit} {}; S_min {} {unit}",
            findings.source.describe(),
            reading(sigma, 1),
            findings.source.noise_source(),
            reading(findings.least, 0)
        );
    }
    if let Some(line) = &findings.line {
        row(&mut out, line, unit);
    }
    if let Some(surface) = &findings.surface {
        let f = surface.minimum_force_summary;
        let _ = writeln!(
            out,
            "surface: three taxels read S_min from F_S = {} N on (median; 95 % of it {} N)",
            newtons(f.median),
            newtons(f.p95)
        );
        for factor in &surface.factors {
            let _ = writeln!(
                out,
                "  Ω (5.24) at {} N: {} by the bound ({} with the testbed)",
                factor.force,
                number(factor.factor, 0),
                number(factor.factor_with_testbed, 0)
            );
        }
    }
    for note in &findings.notes {
        let _ = writeln!(out, "note: {note}");
    }
    out
}

fn bounds(out: &mut String, findings: &Findings) {
    let options = &findings.request;
    let _ = writeln!(
        out,
        "{}: least error of one contact from one frame (Cramér–Rao), {}tip of {} mm, over the surface\n",
        findings.skin.name,
        if options.tip == Some(TipChoice::FlatPunch) { "flat " } else { "" },
        options.diameter() * 1e3
    );
    let mut rows = vec![
        ["force [N]", "pos. RMS", "median", "95 %", "worst", "F RMS", "median", "95 %", "worst"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for map in &findings.maps {
        let (p, f) = (map.position, map.normal_force);
        let mut row = vec![map.force.to_string()];
        row.extend([p.rms, p.median, p.p95, p.max].map(mm));
        row.extend([f.rms, f.median, f.p95, f.max].map(newtons));
        rows.push(row);
    }
    out.push_str(&table(&rows, &[1, 5]));
    out.push_str("\npositions in mm, forces in N; `-`: the channels do not tell it\n");
    for map in &findings.maps {
        for (what, infinite) in [("position", map.position.infinite), ("force", map.normal_force.infinite)] {
            if infinite > 0.0 {
                let _ = writeln!(
                    out,
                    "at {} N the channels do not determine the {what} on {:.1} % of the surface: the bound is infinite there, and \
                     so is its RMS",
                    map.force,
                    infinite * 100.0
                );
            }
        }
    }
    let force = options.force.get(options.force.len() / 2).copied().unwrap_or(f64::NAN);
    // From where on all wider ones can be distinguished.
    let from = findings.pairs.iter().rev().take_while(|p| p.resolved).last();
    match from {
        Some(pair) => {
            let _ = writeln!(
                out,
                "two contacts of {force} N across the middle can be distinguished from {} mm on (to {} mm each)",
                pair.distance * 1e3,
                mm(pair.position)
            );
        }
        None => {
            let _ = writeln!(out, "two contacts of {force} N across the middle cannot be distinguished");
        }
    }
}

fn row(out: &mut String, line: &LineStudy, unit: &str) {
    // Pressures are thousands of pascals.
    let (factor, per) = if unit == "Pa" { (1e3, "kPa".to_owned()) } else { (1.0, unit.to_owned()) };
    let least = |of: fn(f64, f64) -> f64, from: f64| {
        newtons(line.minimum_force.iter().flatten().copied().fold(from, of))
    };
    let _ = writeln!(
        out,
        "row of {} taxels, {} mm: c(0) = {} N/{per}, linear within {} %; F_S from {} to {} N",
        line.count,
        mm(line.span),
        number(median(line, |t| Some(t.c)) * factor, 3),
        number(median(line, |t| Some(t.nonlinearity)) * 100.0, 0),
        least(f64::min, f64::INFINITY),
        least(f64::max, 0.0)
    );
    let alphas = alphas(line);
    let largest = alphas.iter().copied().max_by(|a, b| a[1].total_cmp(&b[1]));
    if let (Some(first), Some(largest), Some(last)) = (alphas.first(), largest, alphas.last()) {
        let shown = [*first, largest, *last]
            .map(|[value, alpha]| format!("{} at {} {unit}", number(alpha, 1), reading(value, 0)));
        let _ =
            writeln!(out, "  I(d) = g + λ|d|^α, median α: {}, at most {}, {}", shown[0], shown[1], shown[2]);
    }
    let mut rows =
        vec![INTERVALS.windows(2).map(|edges| format!("{}-{}", edges[0], edges[1])).collect::<Vec<_>>()];
    type Way = fn(&ByForce) -> Option<Averages>;
    let ways: [(&str, Way); 3] = [
        ("fitted isolines of two (5.18)", |f| f.fits),
        ("exact corners of two (5.7-5.10)", |f| f.corners),
        ("Cramér–Rao bound of all", |f| f.bound),
    ];
    let cell = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), mm);
    rows.extend(ways.iter().map(|(_, of)| by_interval(line, *of).into_iter().map(cell).collect()));
    let names = std::iter::once("σ_P [mm], RMS, by force [N]").chain(ways.iter().map(|(name, _)| *name));
    let missing = rows.iter().flatten().any(|cell| cell == "-");
    for (name, cells) in names.zip(table(&rows, &[]).lines()) {
        let _ = writeln!(out, "  {name:<34}{cells}");
    }
    if missing {
        out.push_str("  `-`: no such force was studied, or no isolines cross there\n");
    }
    for (name, of) in ways {
        let shares = share_by_interval(line, of);
        // Where all of the line has one there is nothing to say.
        if shares.iter().flatten().all(|share| *share > 0.9995) {
            continue;
        }
        let percent = |share: &Option<f64>| share.map_or_else(|| "-".to_owned(), |s| number(s * 100.0, 1));
        let shares: Vec<String> = shares.iter().map(percent).collect();
        let _ = writeln!(
            out,
            "  {name}: of {} % of the line and the forces of each interval; elsewhere there is no estimate, or its error is infinite",
            shares.join(", ")
        );
    }
    let f = &line.factors;
    let _ = writeln!(
        out,
        "  Ω (5.20), mean over force: {} by fits, {} by corners, {} by the bound; with the testbed (5.21): \
         {}, {}, {}",
        number(f.fits[0], 0),
        number(f.corners[0], 0),
        number(f.bound[0], 0),
        number(f.fits[1], 0),
        number(f.corners[1], 0),
        number(f.bound[1], 0)
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_apart_whatever_they_hold() {
        let rows = [["force [N]", "median", "worst"], ["5", "14.201", "1234567.125"], ["40", "-", "0.004"]];
        let rows = rows.map(|row| row.map(str::to_owned).to_vec());
        let expected = [
            "force [N] |    median       worst",
            "        5 |    14.201 1234567.125",
            "       40 |         -       0.004",
        ];
        assert_eq!(table(&rows, &[1]).lines().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn numbers_that_do_not_exist_are_dashes() {
        let shown = [20.0, 0.005, 3e-6, 1.5e-9, f64::NAN, f64::INFINITY, 0.0].map(|v| reading(v, 1));
        assert_eq!(shown, ["20.0", "0.00500", "3.00e-6", "1.50e-9", "-", "-", "0.0"]);
        assert_eq!((number(f64::NAN, 0), number(12.6, 0)), ("-".into(), "13".into()));
    }
}
