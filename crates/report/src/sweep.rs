//! What a change of a design does.

use std::fmt::Write as _;

use anyhow::Result;
use dermis_figures::{Axes, Curve, Pen, curves, escape, figure, page, short};
use dermis_studies::sweep::{Figures, Findings, Sweep, Variant};
use dermis_studies::variation::Parameter;
use dermis_theory::Summary;

/// For people.
#[must_use]
pub fn text(findings: &Findings) -> String {
    let Findings { request: options, skin, nominal, sweeps } = findings;
    let nominal = *nominal;
    let mut out = format!(
        "{}: one contact of {} N, tip of {} mm: position {}, force {}, F_S {}, Ω {}\n",
        skin.name,
        options.force,
        options.diameter * 1e3,
        both(nominal.position, 1e3, 3, "mm"),
        number(nominal.force.rms, 4, " N RMS"),
        number(nominal.minimum_force.median, 4, " N median"),
        number(nominal.factor, 0, "")
    );
    for why in why_not(&nominal) {
        let _ = writeln!(out, "{why}");
    }
    out.push('\n');
    let _ = writeln!(
        out,
        "{:<16}{:>12} | {:>10}{:>10}{:>10}{:>10}{:>10}   least RMS in its range",
        "1 % more of", "from", "pos. RMS", "median", "F RMS", "F_S", "Ω"
    );
    let mut ranked: Vec<&Sweep> = sweeps.iter().collect();
    ranked.sort_by(|a, b| b.elasticity.position.abs().total_cmp(&a.elasticity.position.abs()));
    let percent = |v: f64| if v.is_finite() { format!("{v:+.2} %") } else { "-".to_owned() };
    for sweep in &ranked {
        let e = sweep.elasticity;
        let now = sweep.variants.iter().find(|v| v.relative == 1.0).map_or(f64::NAN, |v| v.value);
        let unit = match sweep.parameter {
            Parameter::Noise => skin.unit.as_str(),
            other => unit(other.label()),
        };
        let least = best(sweep).map_or_else(
            || NOT_DETERMINED.to_owned(),
            |best| {
                let at = short(sweep.parameter.shown(best.value));
                format!("{:.3} mm at {at}", best.figures.position.rms * 1e3)
            },
        );
        let _ = writeln!(
            out,
            "{:<16}{:>12} | {:>10}{:>10}{:>10}{:>10}{:>10}   {least}",
            sweep.parameter.name(),
            format!("{} {unit}", short(sweep.parameter.shown(now))).trim_end(),
            percent(e.position),
            percent(e.position_median),
            percent(e.force),
            percent(e.minimum_force),
            percent(e.factor)
        );
    }
    out.push('\n');
    out.push_str(&advice(nominal, &ranked));
    for refused in sweeps.iter().flat_map(|s| &s.refused) {
        let _ = writeln!(out, "left out: {refused}");
    }
    out
}

/// `depth [mm]` → `mm`.
fn unit(label: &str) -> &str {
    label.split_once(" [").map_or("", |(_, unit)| unit.trim_end_matches(']'))
}

const NOT_DETERMINED: &str = "not determined";

/// Why there is no error of the position.
const NO_POSITION: &str = "At some locations the channels do not determine the position: they read the same wherever along some direction the \
    skin is touched.";
/// What to do about it.
const OF_A_ROW: &str = "Of a row of taxels, --line asks for the position along the row alone.";
/// Why there is no error of the force.
const NO_FORCE: &str = "At some locations the channels do not determine the force.";
/// Why there is no F_S.
const NO_MINIMUM_FORCE: &str =
    "At some locations no force that was tried is read by as many taxels as locating a contact takes.";

/// Why figures are not determined, a line for each reason.
fn why_not(figures: &Figures) -> Vec<&'static str> {
    let mut lines = Vec::new();
    if !figures.position.rms.is_finite() {
        lines.extend([NO_POSITION, OF_A_ROW]);
    }
    if !figures.force.rms.is_finite() {
        lines.push(NO_FORCE);
    }
    if !figures.minimum_force.median.is_finite() {
        lines.push(NO_MINIMUM_FORCE);
    }
    lines
}

/// A value with so many digits behind the point and its unit, where it is finite.
fn number(value: f64, digits: usize, unit: &str) -> String {
    if value.is_finite() { format!("{value:.digits$}{unit}") } else { NOT_DETERMINED.to_owned() }
}

/// Root mean square and median in another unit.
fn both(of: Summary, factor: f64, digits: usize, unit: &str) -> String {
    if !of.rms.is_finite() && !of.median.is_finite() {
        return NOT_DETERMINED.to_owned();
    }
    let [rms, median] = [of.rms, of.median].map(|v| number(v * factor, digits, &format!(" {unit}")));
    format!("{rms} RMS ({median} median)")
}

/// The variant with the least error of the position, where one has any.
fn best(sweep: &Sweep) -> Option<&Variant> {
    let determined = sweep.variants.iter().filter(|v| v.figures.position.rms.is_finite());
    determined.min_by(|a, b| a.figures.position.rms.total_cmp(&b.figures.position.rms))
}

/// What helps most, in a few sentences.
fn advice(nominal: Figures, ranked: &[&Sweep]) -> String {
    let mut out = String::new();
    for sweep in ranked {
        let Some(best) = best(sweep).filter(|_| nominal.position.rms.is_finite()) else { continue };
        let (name, e) = (sweep.parameter.name(), sweep.elasticity.position);
        let gain = 1.0 - best.figures.position.rms / nominal.position.rms;
        if !e.is_finite() || gain < 0.02 {
            let _ = writeln!(out, "{name}: hardly matters for the position, or is best as it is.");
            continue;
        }
        let direction = if best.relative < 1.0 { "less" } else { "more" };
        let at = short(sweep.parameter.shown(best.value));
        let cost = best.figures.minimum_force.median / nominal.minimum_force.median - 1.0;
        let price = if !cost.is_finite() {
            "at a sensitivity that is not determined".to_owned()
        } else if cost.abs() < 0.02 {
            "at the same sensitivity".to_owned()
        } else if cost > 0.0 {
            format!("but needs {:.0} % more force to be noticed by enough taxels", cost * 100.0)
        } else {
            format!("and needs {:.0} % less force to be noticed by enough taxels", -cost * 100.0)
        };
        let end = sweep.variants.first().is_some_and(|v| v.value == best.value)
            || sweep.variants.last().is_some_and(|v| v.value == best.value);
        let end = if end { ", the end of what was tried" } else { "" };
        let _ = writeln!(
            out,
            "{name}: {direction} helps: at {at}{end}, the position error falls by {:.0} %, {price}.",
            gain * 100.0
        );
    }
    out
}

/// The whole page.
///
/// # Errors
///
/// Where a figure cannot be drawn.
pub fn html(findings: &Findings, text: &str) -> Result<String> {
    let Findings { skin, sweeps, .. } = findings;
    let mut body = format!("<pre>{}</pre>\n", escape(text));
    for sweep in sweeps {
        section(&mut body, sweep)?;
    }
    body.push_str(
        "<p>Errors are Cramér–Rao bounds of one contact from one frame, over the surface; F<sub>S</sub> is the force from which \
         on three taxels (two along a row) read the node's threshold of a contact, which follows the noise. With the pitch \
         the surface grows: the same number of taxels serves a larger skin.</p>\n",
    );
    Ok(page(&format!("{}: what a change of its design does", skin.name), &body))
}

/// What a change of one number does.
fn section(body: &mut String, sweep: &Sweep) -> Result<()> {
    let pictures = charts(sweep)?;
    let missing = ["the position", "the force", "F<sub>S</sub>", "Ω"];
    let reasons = [NO_POSITION, NO_FORCE, NO_MINIMUM_FORCE, NO_POSITION];
    let missing = pictures.iter().zip(missing.iter().zip(reasons)).filter(|(picture, _)| picture.is_none());
    let missing: String = missing
        .map(|(_, (what, why))| {
            format!("<p>There is no figure of {what}: it is {NOT_DETERMINED}. {why}</p>\n")
        })
        .collect();
    let pictures: Vec<String> = pictures.into_iter().flatten().collect();
    let _ = writeln!(body, "<h2>{}</h2>", escape(sweep.parameter.label()));
    let refused = if sweep.refused.is_empty() {
        String::new()
    } else {
        format!(" Left out: {}.", escape(&sweep.refused.join("; ")))
    };
    let e = sweep.elasticity;
    let changes = [
        ("the position error", e.position),
        ("the force error", e.force),
        ("F<sub>S</sub>", e.minimum_force),
        ("Ω", e.factor),
    ];
    let changes = changes.iter().filter(|(_, by)| by.is_finite());
    let changes: Vec<String> = changes.map(|(name, by)| format!("{name} by {by:+.2} %")).collect();
    let changes = if changes.is_empty() {
        String::new()
    } else {
        format!(" One per cent more changes {}.", changes.join(", "))
    };
    body.push_str(&missing);
    body.push_str(&figure(
        &pictures,
        &format!("Everything else as it is; dots mark the skin as it is.{changes}{refused}"),
    ));
    Ok(())
}

/// Position, force, minimum force and super-resolution over the values of one number; none of a figure that is not determined anywhere.
fn charts(sweep: &Sweep) -> Result<[Option<String>; 4]> {
    let line = |name: &str, n: usize, of: &dyn Fn(&Figures) -> f64| {
        let points = sweep.variants.iter().map(|v| (sweep.parameter.shown(v.value), of(&v.figures)));
        Curve::new(name, n, points.collect())
    };
    let now = |curve: &Curve| {
        let at = sweep.variants.iter().position(|v| v.relative == 1.0);
        let point = at.and_then(|i| curve.points.get(i)).copied();
        Curve {
            points: point.into_iter().collect(),
            name: String::new(),
            colour: curve.colour,
            pen: Pen::Mark,
        }
    };
    let chart = |title: &str, y: &str, lines: &[Curve]| {
        let axes = Axes { size: (400, 280), ..Axes::new(title, sweep.parameter.label(), y) };
        let marked: Vec<Curve> = lines.iter().flat_map(|l| [l.clone(), now(l)]).collect();
        // Axes without a value would be made up.
        let known = lines.iter().flat_map(|l| &l.points).any(|p| p.1.is_finite());
        known.then(|| curves(&axes, &marked)).transpose()
    };
    let position =
        [line("RMS", 0, &|f| f.position.rms * 1e3), line("median", 1, &|f| f.position.median * 1e3)];
    let force = [line("RMS", 0, &|f| f.force.rms), line("median", 1, &|f| f.force.median)];
    let minimum_force = [
        line("median", 1, &|f| f.minimum_force.median),
        line("95 % of the surface", 2, &|f| f.minimum_force.p95),
    ];
    Ok([
        chart("position", "bound [mm]", &position)?,
        chart("force", "bound [N]", &force)?,
        chart("minimum force", "F_S [N]", &minimum_force)?,
        chart("super-resolution", "Ω", &[line("by the bound", 0, &|f| f.factor)])?,
    ])
}
