//! Bounds as text.

use std::fmt::Write as _;

use dermis_studies::bounds::{Findings, INTERVALS, alphas, by_interval, median};
use dermis_theory::{Averages, ByForce, LineStudy};

/// Millimetres, as few digits as say something.
pub(crate) fn mm(metres: f64) -> String {
    if metres.is_finite() { format!("{:.3}", metres * 1e3) } else { "-".into() }
}

fn newtons(value: f64) -> String {
    if value.is_finite() { format!("{value:.4}") } else { "-".into() }
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
    let _ = writeln!(
        out,
        "\nisolines from {}; σ_S {sigma:.1} {unit} {}; S_min {:.0} {unit}",
        findings.source.describe(),
        findings.source.noise_source(),
        findings.least
    );
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
                "  Ω (5.24) at {} N: {:.0} by the bound ({:.0} with the testbed)",
                factor.force, factor.factor, factor.factor_with_testbed
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
        "{}: least error of one contact from one frame (Cramér–Rao), tip of {} mm, over the surface\n",
        findings.skin.name,
        options.diameter * 1e3
    );
    let _ = writeln!(
        out,
        "{:>9} | {:>9}{:>9}{:>9}{:>9} | {:>9}{:>9}{:>9}{:>9}",
        "force [N]", "pos. RMS", "median", "95 %", "worst", "F RMS", "median", "95 %", "worst"
    );
    for map in &findings.maps {
        let (p, f) = (map.position, map.normal_force);
        let _ = writeln!(
            out,
            "{:>9} | {:>9}{:>9}{:>9}{:>9} | {:>9}{:>9}{:>9}{:>9}",
            map.force,
            mm(p.rms),
            mm(p.median),
            mm(p.p95),
            mm(p.max),
            newtons(f.rms),
            newtons(f.median),
            newtons(f.p95),
            newtons(f.max)
        );
    }
    out.push_str("\npositions in mm, forces in N; `-`: the channels do not tell it\n");
    let force = options.force.get(options.force.len() / 2).copied().unwrap_or(f64::NAN);
    // From where on all wider ones can be told apart.
    let from = findings.pairs.iter().rev().take_while(|p| p.resolved).last();
    match from {
        Some(pair) => {
            let _ = writeln!(
                out,
                "two contacts of {force} N across the middle can be told apart from {} mm on (to {} mm each)",
                pair.distance * 1e3,
                mm(pair.position)
            );
        }
        None => {
            let _ = writeln!(out, "two contacts of {force} N across the middle cannot be told apart");
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
        "row of {} taxels, {} mm: c(0) = {:.3} N/{per}, linear within {:.0} %; F_S from {} to {} N",
        line.count,
        mm(line.span),
        median(line, |t| Some(t.c)) * factor,
        median(line, |t| Some(t.nonlinearity)) * 100.0,
        least(f64::min, f64::INFINITY),
        least(f64::max, 0.0)
    );
    let alphas = alphas(line);
    let largest = alphas.iter().copied().max_by(|a, b| a[1].total_cmp(&b[1]));
    if let (Some(first), Some(largest), Some(last)) = (alphas.first(), largest, alphas.last()) {
        let shown = [*first, largest, *last].map(|[value, alpha]| format!("{alpha:.1} at {value:.0} {unit}"));
        let _ =
            writeln!(out, "  I(d) = g + λ|d|^α, median α: {}, at most {}, {}", shown[0], shown[1], shown[2]);
    }
    let _ = write!(out, "  {:<34}", "σ_P [mm], RMS, by force [N]");
    for edges in INTERVALS.windows(2) {
        let _ = write!(out, "{:>9}", format!("{}-{}", edges[0], edges[1]));
    }
    out.push('\n');
    type Way = fn(&ByForce) -> Option<Averages>;
    let ways: [(&str, Way); 3] = [
        ("fitted isolines of two (5.18)", |f| f.fits),
        ("exact corners of two (5.7-5.10)", |f| f.corners),
        ("Cramér–Rao bound of all", |f| f.bound),
    ];
    for (name, of) in ways {
        let _ = write!(out, "  {name:<34}");
        for value in by_interval(line, of) {
            let _ = write!(out, "{:>9}", value.map_or_else(|| "-".to_owned(), mm));
        }
        out.push('\n');
    }
    let f = &line.factors;
    let _ = writeln!(
        out,
        "  Ω (5.20), mean over force: {:.0} by fits, {:.0} by corners, {:.0} by the bound; with the testbed (5.21): \
         {:.0}, {:.0}, {:.0}",
        f.fits[0], f.corners[0], f.bound[0], f.fits[1], f.corners[1], f.bound[1]
    );
}
