//! Several contacts by way of a simulation, and other ways to them.

mod thesis;

use std::fmt::Write as _;

use anyhow::Result;
use dermis_figures::{Axes, COLOURS, Curve, Pen, curves, escape, figure, page, surface};
use dermis_learn::TruthContact;
use dermis_learn::real2sim::Table;
use dermis_skin::{SkinDescription, Surface, SurfaceSpec};
use dermis_studies::real2sim::compare::{self, Kind};
use dermis_studies::real2sim::{table, train};
use nalgebra::Point3;
pub use thesis::text as thesis;

const NUMERALS: [&str; 4] = ["I", "II", "III", "IV"];

/// The table as lines of text.
#[must_use]
pub fn table(findings: &table::Findings) -> String {
    let table::Findings { skin, table, .. } = findings;
    let skin = &skin.name;
    let mut out = format!(
        "{skin}: displacement maps of {} points from {}\n{} shapes keep {:.3} % of their squares; noise {:.1} % of the \
         sensors' root mean square\n\nRMSE over all points [µm], and in parentheses the share of the variance that is \
         unexplained [%]\n",
        table.points,
        table.sensors,
        table.rank,
        table.kept * 100.0,
        table.settings.noise * 100.0,
    );
    for trained in 1..=4 {
        let _ = write!(out, "\n{:<22}", format!("learned from {}", NUMERALS[..trained].join(", ")));
        for tested in NUMERALS {
            let _ = write!(out, "{tested:>18}");
        }
        let _ = writeln!(out);
        for method in Table::METHODS {
            let _ = write!(out, "  {method:<20}");
            for tested in 1..=4 {
                if let Some(cell) = table.cell(method, trained, tested) {
                    let fvu = cell.error.fvu * 100.0;
                    let _ = write!(out, "{:>18}", format!("{:.1} ({fvu:.1})", cell.error.rms * 1e6));
                }
            }
            let _ = writeln!(out);
        }
    }
    let [line, network] = table.messages();
    let holds = |b: bool| if b { "holds" } else { "does not hold" };
    let _ = write!(
        out,
        "\n{}: of what learned from single contacts only, the line errs least on two, three and four\n\
         {}: the network errs least wherever the number of contacts was learned\n",
        holds(line),
        holds(network)
    );
    out
}

/// The page of the table.
///
/// # Errors
///
/// Where a figure cannot be drawn.
pub fn table_page(findings: &table::Findings, text: &str) -> Result<String> {
    let table::Findings { skin, table, .. } = findings;
    let skin = &skin.name;
    let mut pictures = Vec::new();
    for trained in 1..=4 {
        let axes = Axes {
            log_y: true,
            // Two with their legends stand beside each other.
            size: (420, 320),
            ..Axes::new(
                format!("learned from {}", NUMERALS[..trained].join(", ")),
                "contacts at once",
                "unexplained [%]",
            )
        };
        let curve = |(n, method): (usize, &'static str)| {
            let at = |tested: usize| {
                table.cell(method, trained, tested).map(|c| (tested as f64, c.error.fvu * 100.0))
            };
            Curve::new(method, n, (1..=4).filter_map(at).collect())
        };
        pictures.push(curves(&axes, &Table::METHODS.into_iter().enumerate().map(curve).collect::<Vec<_>>())?);
    }
    let body = format!(
        "<pre>{}</pre>\n{}",
        escape(text),
        figure(&pictures, "Share of the variance of the maps that each method leaves unexplained.")
    );
    Ok(page(&format!("{skin}: who extrapolates to more contacts"), &body))
}

/// What was learned, for people.
#[must_use]
pub fn trained(findings: &train::Findings) -> String {
    let train::Findings { trained, evaluation, seconds } = findings;
    let maps: Vec<String> = trained.map_rms.iter().map(|v| format!("{:.1}", v * 1e6)).collect();
    format!(
        "virtual sensors: {}\n{} shapes keep {:.3} % of the maps' squares\n{} recorded contacts; the transfer leaves {:.1} % of \
         held-out virtual sensors\nmaps of one to four simulated contacts: {} µm RMS\npeaks from {:.2} N and {:.0} % of the \
         strongest on are contacts\ntrained in {seconds:.0} s\n{evaluation}",
        trained.sensors,
        trained.rank,
        trained.kept * 100.0,
        trained.recorded,
        trained.transfer_error * 100.0,
        maps.join(", "),
        trained.settings.least_force,
        trained.settings.share * 100.0,
    )
}

/// The comparison, for people.
#[must_use]
pub fn comparison(findings: &compare::Findings) -> String {
    let mut out =
        format!("{}: ways to contacts on recordings that nothing was learned from\n", findings.skin.name);
    for left_out in &findings.left_out {
        let _ = writeln!(out, "{left_out}");
    }
    out.push_str(
        "a contact that is not found counts as far away as the middle of the surface, and as a force of 0\n",
    );
    for kind in Kind::ALL {
        errors_of_kind(&mut out, findings, kind);
    }
    errors_by_force(&mut out, findings, "position", "mm", 1e3);
    errors_by_force(&mut out, findings, "force.normal", "N", 1.0);
    for r in &findings.rows {
        let Some(evaluation) = r.evaluation.as_ref().filter(|e| !e.against_bound.is_empty()) else {
            continue;
        };
        let _ = writeln!(out, "\n{}, {}", r.method, r.kind.replace('_', " "));
        for against in &evaluation.against_bound {
            let _ = write!(out, "{against}");
        }
    }
    if let Some(bound) = &findings.bound {
        let _ = write!(out, "{}", bound.left_out);
    }
    let _ = writeln!(out);
    for ask in &findings.asks {
        let reached = if ask.reached { "reached" } else { "missed" };
        let _ =
            writeln!(out, "{reached}: {} (target {}): {} by {}", ask.what, ask.target, ask.found, ask.method);
    }
    out
}

/// How far every method is off in frames of one kind.
fn errors_of_kind(out: &mut String, findings: &compare::Findings, kind: Kind) {
    let found: Vec<&compare::Row> = findings.rows.iter().filter(|r| r.kind == kind.name()).collect();
    if found.is_empty() {
        return;
    }
    let _ = writeln!(
        out,
        "\n{}: {} frames\n{:<38}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}",
        kind.in_words(),
        findings.frames.get(&kind).copied().unwrap_or(0),
        "",
        "mean mm",
        "RMS mm",
        "median",
        "mean N",
        "RMS N",
        "lost %",
        "number ok %"
    );
    for r in found {
        match &r.with_everything {
            Some(everything) => {
                errors(out, &r.method, everything);
                errors(out, "  where the surface gives way", &r.errors);
            }
            None => errors(out, &r.method, &r.errors),
        }
        if let Some(found) = &r.found {
            errors(out, "  of these, contacts that were found", found);
        }
    }
}

/// One line of errors.
fn errors(out: &mut String, name: &str, e: &compare::Errors) {
    let right = e.count_right.map_or_else(|| "-".to_owned(), |v| format!("{:.1}", v * 100.0));
    let _ = writeln!(
        out,
        "{name:<38}{:>10.2}{:>10.2}{:>10.2}{:>10.2}{:>10.2}{:>10.1}{right:>12}",
        e.position_mean * 1e3,
        e.position_rms * 1e3,
        e.position_median * 1e3,
        e.force_mean,
        e.force_rms,
        e.lost * 100.0
    );
}

/// How far every method is off in a quantity of one contact, by force, beside the bound: `factor` times as in SI units.
fn errors_by_force(out: &mut String, findings: &compare::Findings, quantity: &str, unit: &str, factor: f64) {
    let bins = &findings.request.bins;
    let _ = write!(out, "\none contact, {quantity} RMSE [{unit}] by force [N]\n{:<38}", "");
    for (i, from) in bins.iter().enumerate() {
        let head = bins.get(i + 1).map_or_else(|| format!("{from}+"), |to| format!("{from}-{to}"));
        let _ = write!(out, "{head:>10}");
    }
    let _ = writeln!(out);
    let mut line = |name: &str, of: &dyn Fn(f64) -> Option<f64>| {
        let _ = write!(out, "{name:<38}");
        for from in bins {
            let cell = of(*from).map_or_else(|| "-".to_owned(), |v| format!("{:.2}", v * factor));
            let _ = write!(out, "{cell:>10}");
        }
        let _ = writeln!(out);
    };
    for r in &findings.rows {
        let Some(by_force) = r.evaluation.as_ref().and_then(|e| e.by_force.get(quantity)) else {
            continue;
        };
        line(&r.method, &|from| by_force.iter().find(|b| b.from.to_bits() == from.to_bits()).map(|b| b.rms));
    }
    if let Some(bound) = &findings.bound {
        let cells = if quantity == "position" { &bound.position } else { &bound.normal_force };
        let at = |from: f64| cells.iter().find(|b| b.from.to_bits() == from.to_bits());
        line("Cramér–Rao bound of the design", &|from| at(from).map(|b| b.rms));
        line("  its median", &|from| at(from).and_then(|b| b.median));
    }
}

/// The page of a comparison.
///
/// # Errors
///
/// Where a figure cannot be drawn.
pub fn comparison_page(findings: &compare::Findings, text: &str) -> Result<String> {
    let compare::Findings { skin, rows, shown, .. } = findings;
    let mut body = format!("<pre>{}</pre>\n", escape(text));
    let axes = Axes { log_y: true, ..Axes::new("one contact", "force [N]", "place, RMSE [mm]") };
    let all: Vec<Curve> = rows
        .iter()
        .filter_map(|r| Some((r, r.evaluation.as_ref()?.by_force.get("position")?)))
        .enumerate()
        .map(|(n, (r, bins))| {
            let middle = |b: &dermis_learn::Bin| b.to.map_or(b.from * 1.4, |to| f64::midpoint(b.from, to));
            let points = bins.iter().map(|b| (middle(b), b.rms * 1e3)).collect();
            let curve = Curve::new(r.method.clone(), n, points);
            if n >= COLOURS.len() { curve.pen(Pen::Dashed) } else { curve }
        })
        .collect();
    let mut pictures = Vec::new();
    if !all.is_empty() {
        pictures.push(curves(&axes, &all)?);
    }
    if let Some(compare::ShownFrame { map, contacts }) = shown {
        let on = skin.surface();
        let points = flat(&on, skin);
        let around = |c: &TruthContact| {
            let nearest = (0..points.len()).min_by(|a, b| {
                let distance = |i: usize| (on.points[i] - c.position).norm();
                distance(*a).total_cmp(&distance(*b))
            });
            nearest.map_or((0.0, 0.0), |i| points[i])
        };
        let crosses: Vec<(f64, f64)> = contacts.iter().map(around).collect();
        let micrometres: Vec<f64> = map.iter().map(|v| v * 1e6).collect();
        let axes = Axes::new("two contacts, as the map shows them", "along [mm]", "around [mm]");
        pictures.push(surface(&axes, "µm", &points, &micrometres, &crosses)?);
    }
    if !pictures.is_empty() {
        let caption = "<i>One contact</i>: errors by force. <i>Two contacts, as the map shows them</i>: a map of the first bundle; \
                       crosses are the true contacts.";
        body.push_str(&figure(&pictures, caption));
    }
    Ok(page(&format!("{}: ways to contacts", skin.name), &body))
}

/// Points of a surface laid flat \[mm\]: x, and the way around it from the middle.
fn flat(surface: &Surface, skin: &SkinDescription) -> Vec<(f64, f64)> {
    let around = |p: &Point3<f64>| match skin.surface {
        SurfaceSpec::Panel { radius, .. } => radius * p.y.atan2(p.z),
        _ => p.y,
    };
    surface.points.iter().map(|p| (p.x * 1e3, around(p) * 1e3)).collect()
}
