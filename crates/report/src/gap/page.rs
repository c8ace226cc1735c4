//! A report as one page that needs nothing beside it.

use std::fmt::Write as _;

use anyhow::Result;
use dermis_figures::{Axes, Bar, bars, escape, figure, page, surface_within};
use dermis_gap::{Axis, Bin, Gap, Map, NamedEffect, Report, Tier, Unknown, Verdict};

use super::text::{percent, short, value};

/// The whole page.
///
/// # Errors
///
/// Where a figure cannot be drawn.
pub fn html(report: &Report) -> Result<String> {
    let mut body = format!("<p style=\"font-size:1.25rem\"><b>{}</b></p>\n", escape(&report.sentence));
    let data = &report.data;
    let _ = writeln!(
        body,
        "<p>{}: {} frames, {} presses of skin {}.</p>",
        escape(&data.name),
        data.frames,
        data.presses,
        escape(&data.skin)
    );
    for problem in &data.problems {
        let kind = if problem.fatal { "Wrong" } else { "Note" };
        let _ = writeln!(body, "<p><b>{kind}:</b> {}</p>", escape(&problem.what));
    }
    if let Some(gap) = &report.gap {
        size(&mut body, report, gap)?;
    }
    maps(&mut body, report)?;
    axes(&mut body, &report.axes)?;
    effects(&mut body, report)?;
    rivals(&mut body, report)?;
    confusions(&mut body, report);
    experiments(&mut body, report);
    tables(&mut body, report);
    consistency_checks(&mut body, report);
    provenance(&mut body, report);
    Ok(page(&format!("{}: the gap between model and recording", data.skin), &body))
}

/// How large the gap is.
fn size(body: &mut String, report: &Report, gap: &Gap) -> Result<()> {
    let share = |name: &str, value: f64| Bar::new(name, value, percent(value));
    let interval = [gap.interval[0] + gap.floor, gap.interval[1] + gap.floor];
    let mut rows = vec![share("before", gap.fvu_before).interval(interval)];
    if let (Some(held), Some(reduction)) = (report.held_out, report.residual_reduction) {
        let open = held[0] - held[2];
        let left = |reduction: f64| held[0] - reduction * open;
        let interval = [left(reduction.interval[1]), left(reduction.interval[0])];
        rows.push(share("after, on contacts kept for the end", held[1]).interval(interval));
    }
    rows.push(share("noise floor", gap.floor));
    let _ = writeln!(body, "<h2>How large it is</h2>");
    let zero = if gap.zero > 0.0 {
        format!(" Of the noise, {} is that of the zero that readings are counted from.", percent(gap.zero))
    } else {
        String::new()
    };
    let again = gap.irreproducible.map_or(String::new(), |share| {
        format!(
            " Presses that were done alike ({} pairs) differ by {}, which no model removes.",
            gap.repeats,
            percent(share)
        )
    });
    body.push_str(&figure(
        &[bars("", &rows, None)?],
        &format!(
            "Unexplained share of the readings' variance, with intervals over locations. Systematic is {} ({} to {}).{zero}{again}",
            percent(gap.systematic),
            percent(gap.interval[0]),
            percent(gap.interval[1])
        ),
    ));
    for missing in &report.data.missing {
        let _ = writeln!(
            body,
            "<p>Missing: {}. Open without it: {}.</p>",
            escape(&missing.what),
            escape(&missing.blocks)
        );
    }
    Ok(())
}

/// A map laid flat along its two widest axes.
fn flat(map: &Map) -> Vec<(f64, f64)> {
    let extent = |a: usize| {
        let all = map.points.iter().map(|p| p[a]);
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| extent(*b).total_cmp(&extent(*a)));
    let (x, y) = (order[0].min(order[1]), order[0].max(order[1]));
    map.points.iter().map(|p| (p[x] * 1e3, p[y] * 1e3)).collect()
}

/// Share of the readings' variance that, left unexplained everywhere, has the last colour of a map: yellow, or deep red or blue.
///
/// A gap of 0.5 % is the least that matters ([`Verdict::NoGapBeyondNoise`] lies below it). Ten times as much is one that no reader
/// should overlook; its root mean square residual is 22 % of the readings' own standard deviation.
const FULL_COLOUR_SHARE: f64 = 0.05;

/// Times the largest value of a map that the last colour stands for where the verdict is that there is no gap: what is drawn then
/// ends half way from white to deep red, whatever single locations show.
const PALE: f64 = 2.0;

/// The residual, in the unit of the skin, that the last colour of a map stands for, at least: one that leaves
/// [`FULL_COLOUR_SHARE`] of the readings' variance unexplained. The readings' variance is that of the residual over the share that
/// it leaves. `top` is the largest value that is drawn.
fn full_colour(report: &Report, top: f64) -> f64 {
    let least = if report.verdict == Verdict::NoGapBeyondNoise { PALE * top } else { top };
    let known: Vec<f64> =
        report.maps.first().map(|m| m.rms.iter().flatten().copied().collect()).unwrap_or_default();
    let before = report.gap.as_ref().map_or(0.0, |gap| gap.fvu_before);
    if known.is_empty() || before.is_nan() || before <= 0.0 {
        return least;
    }
    let squares = known.iter().map(|v| v * v).sum::<f64>() / known.len() as f64;
    (squares * FULL_COLOUR_SHARE / before).sqrt().max(least)
}

fn maps(body: &mut String, report: &Report) -> Result<()> {
    if report.maps.iter().all(|m| m.points.is_empty()) {
        return Ok(());
    }
    let _ = writeln!(body, "<h2>Where on the surface</h2>");
    let mut pictures = Vec::new();
    // Before and after on one scale each; what lies below the noise is not drawn.
    let most = |of: fn(&Map) -> &Vec<Option<f64>>| {
        report.maps.iter().flat_map(of).flatten().map(|v| v.abs()).fold(0.0, f64::max)
    };
    let rms: fn(&Map) -> &Vec<Option<f64>> = |m| &m.rms;
    let mean: fn(&Map) -> &Vec<Option<f64>> = |m| &m.mean;
    for (of, what, low) in [(rms, "root mean square", 0.0), (mean, "mean", -1.0)] {
        let top = most(of);
        for (map, name) in report.maps.iter().zip(["before", "after"]) {
            let values: Vec<f64> = of(map).iter().map(|v| v.unwrap_or(f64::NAN)).collect();
            if top <= 0.0 || values.iter().all(|v| v.is_nan()) {
                continue;
            }
            let axes = Axes::new(format!("{name}: {what}"), "[mm]", "[mm]");
            let (range, full) = ([low * top, top], full_colour(report, top));
            pictures.push(surface_within(&axes, &report.data.unit, &flat(map), &values, range, full)?);
        }
    }
    if pictures.is_empty() {
        let _ = writeln!(
            body,
            "<p>There is no map: nowhere do readings differ from the model by more than the noise.</p>"
        );
        return Ok(());
    }
    let peak = report.maps.first().and_then(|m| m.peak.map(|p| (p, m.prominence)));
    let peak = peak.map_or(String::new(), |(p, prominence)| {
        format!(
            " It is largest at ({}, {}, {}) mm, {} times the median.",
            short(p[0] * 1e3),
            short(p[1] * 1e3),
            short(p[2] * 1e3),
            short(prominence)
        )
    });
    let cleared = report
        .maps
        .iter()
        .zip(["before", "after"])
        .filter(|(m, _)| !m.points.is_empty() && m.rms.iter().all(Option::is_none));
    let cleared: String = cleared
        .map(|(_, name)| format!(" There is no map of <i>{name}</i>: it is below the noise everywhere."))
        .collect();
    body.push_str(&figure(
        &pictures,
        &format!(
            "Readings minus model over where was pressed; nothing is drawn where it is below the noise. The strongest colour would \
             stand for what leaves {} of the readings' variance unexplained, or for the largest value where that is more.{peak}{cleared}",
            percent(FULL_COLOUR_SHARE)
        ),
    ));
    Ok(())
}

fn axes(body: &mut String, axes: &[Axis]) -> Result<()> {
    if axes.is_empty() {
        return Ok(());
    }
    let rows: Vec<Bar> = axes.iter().map(|a| along(a.title(), a)).collect();
    let _ = writeln!(body, "<h2>Along what it goes</h2>");
    body.push_str(&figure(
        &[bars("", &rows, None)?],
        "Share of the gap on held-out contacts that a mean and a factor for each bin and channel explain, beyond chance, or that lies in \
         other bins than readings do. Where effects are named, of what these make of it.",
    ));
    Ok(())
}

/// The share that goes along an axis.
fn along(name: impl Into<String>, axis: &Axis) -> Bar {
    Bar::new(name, axis.share.max(0.0), percent(axis.share)).interval(axis.interval)
}

/// The named effects, how far they reduce the residual, and what they leave.
fn effects(body: &mut String, report: &Report) -> Result<()> {
    let _ = writeln!(body, "<h2>What makes it</h2>");
    if report.effects.is_empty() {
        let _ = writeln!(body, "<p>No effect is named.</p>");
        for suspect in &report.suspects {
            let _ = writeln!(
                body,
                "<p>{} alone would explain {} of the variance, {} beyond the simulator's tolerances.</p>",
                escape(&suspect.name),
                percent(suspect.gain),
                percent(suspect.beyond_discrepancy)
            );
        }
    }
    for effect in &report.effects {
        named(body, effect);
    }
    if let Some(reduction) = &report.residual_reduction {
        let how = if reduction.achieved.is_some() {
            "Reduces the residual by"
        } else {
            "Cannot be switched on; its signature explains"
        };
        let _ = writeln!(
            body,
            "<p><b>{how} {}</b>, which were neither fitted nor selected on; predicted was {}.</p>",
            escape(&reduction.text()),
            percent(reduction.predicted)
        );
    }
    unknown(body, &report.unknown)
}

/// A named effect, what it explains, and its fitted values.
fn named(body: &mut String, effect: &NamedEffect) {
    let class: Vec<String> = effect.names().iter().map(|name| escape(name)).collect();
    let or = if effect.tier == Tier::Loose { ", or the model discrepancy" } else { "" };
    let _ = writeln!(
        body,
        "<h3>{}{or}</h3><p>{} Explains {} of the variance when it comes last, {} alone; {} of what all named effects explain; \
         family-wise p = {:.3}.</p>",
        class.join(" or "),
        escape(&effect.what),
        percent(effect.gain),
        percent(effect.solo),
        percent(effect.shapley),
        effect.p_max_t
    );
    if !effect.covers.is_empty() {
        let _ = writeln!(
            body,
            "<p>More general effects that contain it: {}.</p>",
            escape(&effect.covers.join(", "))
        );
    }
    for alias in &effect.covariate_alias {
        let _ = writeln!(body, "<p>In this recording it could also be {}.</p>", escape(alias));
    }
    if !effect.theta.is_empty() {
        let values: Vec<String> = effect.theta.iter().map(|v| escape(&value(v))).collect();
        let _ = writeln!(body, "<pre>{}</pre>", values.join("\n"));
    }
    if !effect.written {
        let _ = writeln!(body, "<p>A skin description cannot say it: the corrected skin is without it.</p>");
    }
}

/// What the named effects leave.
fn unknown(body: &mut String, unknown: &Unknown) -> Result<()> {
    let _ = writeln!(
        body,
        "<p>Of the systematic gap {} is explained by the named effects, {} more could be the model discrepancy, which is the simulator's error within its \
         tolerances; of what is left {} goes with what was recorded.</p>",
        percent(unknown.library),
        percent(unknown.model_discrepancy),
        percent(unknown.explainable)
    );
    if let Some((evidence, threshold)) = unknown.evidence.zip(unknown.threshold) {
        let _ = writeln!(
            body,
            "<p>Evidence for a cause that none of the effects is: log odds {evidence:.1}; the cause is called unknown from {threshold:.1} on, \
             as that of two in a hundred simulated devices is whose cause is in the library.</p>"
        );
    }
    if let Some((what, share)) =
        unknown.shape.as_ref().zip(unknown.shape_share).filter(|(_, share)| *share > 0.01)
    {
        let _ = writeln!(
            body,
            "<p>What the names leave is shaped like {}: {} of the gap on locations that it was not fitted to.</p>",
            escape(what),
            percent(share)
        );
    }
    if !unknown.fingerprint.is_empty() {
        let _ = writeln!(body, "<h3>Fingerprint of the rest</h3>");
        let rows: Vec<Bar> = unknown.fingerprint.iter().map(|a| along(a.axis.as_str(), a)).collect();
        body.push_str(&figure(&[bars("", &rows, None)?], "Along what the rest goes."));
    }
    Ok(())
}

/// Shapes without a cause beside the named effects, and what these leave.
fn rivals(body: &mut String, report: &Report) -> Result<()> {
    if report.rivals.is_empty() {
        return Ok(());
    }
    let _ = writeln!(body, "<h2>What its shape is</h2>");
    let mut rows: Vec<Bar> = Vec::new();
    if let Some(held) = report.held_out.filter(|[before, _, floor]| before > floor) {
        let share = (held[0] - held[1]) / (held[0] - held[2]);
        rows.push(Bar::new("the named effects", share.clamp(0.0, 1.0), percent(share)));
    }
    rows.extend(
        report.rivals.iter().map(|r| Bar::new(r.what.as_str(), r.explains.max(0.0), percent(r.explains))),
    );
    body.push_str(&figure(
        &[bars("", &rows, None)?],
        "Share of the gap that shapes without a cause explain on locations that they were not fitted to. A name that is right leaves \
         little that they find; one that a shape clearly beats is not firm.",
    ));
    if let Some(s) = report.unknown.structure {
        let _ = writeln!(
            body,
            "<p>Of the gap, what is left holds {} by channel, {} smoothly over the place, {} in some locations, and {} in some locations of \
             single channels.</p>",
            percent(s.channel),
            percent(s.smooth_place),
            percent(s.local_place),
            percent(s.interaction)
        );
    }
    Ok(())
}

fn confusions(body: &mut String, report: &Report) {
    // Another name of one thing is not confused with it.
    let open: Vec<_> = report.effects.iter().filter(|e| e.class.iter().skip(1).any(|a| !a.alias)).collect();
    if open.is_empty() {
        return;
    }
    let _ = writeln!(
        body,
        "<h2>What cannot be distinguished</h2><table><tr><th>named</th><th>or</th><th>explains</th><th>confused with \
         probability</th><th>angle [°]</th></tr>"
    );
    for effect in open {
        for alike in effect.class.iter().skip(1).filter(|a| !a.alias) {
            let angle = alike.angle.map_or("–".to_owned(), short);
            let _ = writeln!(
                body,
                "<tr><td>{}</td><td>{}</td><td>{}</td><td>{:.2}</td><td>{angle}</td></tr>",
                escape(&effect.label),
                escape(&alike.name),
                percent(alike.gain),
                alike.p_confuse
            );
        }
    }
    body.push_str("</table>\n");
}

fn experiments(body: &mut String, report: &Report) {
    if report.next_experiments.is_empty() {
        return;
    }
    let _ = writeln!(
        body,
        "<h2>What to do next</h2><table><tr><th>experiment</th><th>minutes</th><th>hardest to tell apart</th><th>then confused \
         with probability</th></tr>"
    );
    for e in &report.next_experiments {
        let _ = writeln!(
            body,
            "<tr><td style=\"text-align:left\">{}</td><td>{}</td><td>{}</td><td>{:.3}</td></tr>",
            escape(&e.what),
            short(e.minutes),
            escape(&e.separates.join(", ")),
            e.p_confuse_after
        );
    }
    body.push_str("</table>\n");
}

fn table(body: &mut String, name: &str, bins: &[Bin], unit: &str) {
    if bins.is_empty() {
        return;
    }
    let _ = writeln!(
        body,
        "<h3>By {}</h3><table><tr><th></th><th>frames</th><th>unexplained variance</th><th>RMSE [{}]</th></tr>",
        escape(name),
        escape(unit)
    );
    for bin in bins {
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&bin.label),
            bin.samples,
            percent(bin.fvu),
            short(bin.rmse)
        );
    }
    body.push_str("</table>\n");
}

fn tables(body: &mut String, report: &Report) {
    let _ = writeln!(body, "<h2>In numbers</h2>");
    let unit = &report.data.unit;
    table(body, "channel", &report.channels, unit);
    for name in ["force", "number of contacts", "phase"] {
        if let Some(axis) = report.axes.iter().find(|a| a.axis == name) {
            table(body, name, &axis.bins, unit);
        }
    }
    for down in &report.downstream {
        let _ = writeln!(body, "<p>{}.</p>", escape(&super::text::downstream(down)));
    }
}

fn consistency_checks(body: &mut String, report: &Report) {
    if report.consistency_checks.is_empty() {
        return;
    }
    let _ = writeln!(
        body,
        "<h2>Checks without a model</h2><table><tr><th>check</th><th>what</th><th>compared</th><th>noise deviations</th>\
         <th>share of the signal</th><th></th></tr>"
    );
    for check in &report.consistency_checks {
        let or = |v: Option<f64>, text: fn(f64) -> String| v.map_or("–".to_owned(), text);
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td style=\"text-align:left\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&check.check),
            escape(&check.what),
            check.compared,
            or(check.violation, short),
            or(check.share, percent),
            if check.violated {
                "violated"
            } else if check.compared == 0 {
                "not recorded"
            } else {
                "holds"
            }
        );
    }
    body.push_str("</table>\n");
}

fn provenance(body: &mut String, report: &Report) {
    let p = &report.provenance;
    let _ = writeln!(body, "<h2>Where this comes from</h2>");
    for warning in &report.warnings {
        let _ = writeln!(body, "<p>{}</p>", escape(warning));
    }
    let silent: Vec<String> = p.silent.iter().map(|[name, why]| format!("{name}: {why}")).collect();
    let _ = writeln!(
        body,
        "<pre>{}\nseed {}\nrecording {}\nskin {}\nlibrary {}\ntried: {}\ncannot be seen here:\n  {}\nmodel discrepancy: \
         {}\n{:.1} s of simulation, {:.1} s of diagnosis</pre>",
        escape(&p.tool),
        p.seed,
        escape(&report.data.hash),
        escape(&report.data.skin_hash),
        escape(&p.library_hash),
        escape(&p.tried.join(", ")),
        escape(&silent.join("\n  ")),
        escape(&p.model_discrepancy.join(", ")),
        p.seconds[0],
        p.seconds[1]
    );
}

#[cfg(test)]
mod tests;
