//! A report for a terminal.

use std::fmt::Write as _;

use dermis_gap::{DataSummary, Downstream, Gap, NamedEffect, Report, Tier, Value};

/// The report as text.
#[must_use]
pub fn text(report: &Report) -> String {
    let mut out = format!("{}\n", report.sentence);
    data(&mut out, &report.data);
    let Some(gap) = &report.gap else { return out };
    size(&mut out, gap);
    axes(&mut out, report);
    consistency_checks(&mut out, report);
    if !report.effects.is_empty() {
        let _ = writeln!(out, "\neffects");
    }
    for named in &report.effects {
        effect(&mut out, named);
    }
    suspects(&mut out, report);
    residual(&mut out, report);
    beyond_the_library(&mut out, report);
    experiments(&mut out, report);
    for down in &report.downstream {
        let _ = writeln!(out, "{}", downstream(down));
    }
    for warning in &report.warnings {
        let _ = writeln!(out, "note: {warning}");
    }
    out
}

/// Which recording it is, what is wrong with it, and what is missing.
fn data(out: &mut String, data: &DataSummary) {
    let _ = writeln!(
        out,
        "\n{}: {} frames, {} presses of skin {}; {} frames sampled, {} locations fitted, {} kept for the end",
        data.name, data.frames, data.presses, data.skin, data.samples, data.locations[0], data.locations[1]
    );
    for problem in &data.problems {
        let _ = writeln!(out, "  {}: {}", if problem.fatal { "wrong" } else { "note" }, problem.what);
    }
    for missing in &data.missing {
        let _ = writeln!(out, "  missing: {}; open: {}", missing.what, missing.blocks);
    }
}

/// How large the gap is.
fn size(out: &mut String, gap: &Gap) {
    let _ = writeln!(
        out,
        "\nunexplained variance {}, of which noise {}, systematic {} ({} to {})",
        percent(gap.fvu_before),
        percent(gap.floor),
        percent(gap.systematic),
        percent(gap.interval[0]),
        percent(gap.interval[1])
    );
    if gap.zero > 0.0 {
        let _ = writeln!(
            out,
            "  of the noise, {} is that of the zero that readings are counted from",
            percent(gap.zero)
        );
    }
    if let Some(share) = gap.irreproducible {
        let _ =
            writeln!(out, "  of the noise, {} differs between presses that were done alike", percent(share));
    }
}

/// Along what the gap goes.
fn axes(out: &mut String, report: &Report) {
    let telling: Vec<_> = report.axes.iter().filter(|a| a.share > 0.01).take(5).collect();
    if telling.is_empty() {
        return;
    }
    let _ = writeln!(out, "\nwhere");
    for axis in telling {
        let [low, high] = axis.interval;
        let _ = writeln!(
            out,
            "  {:44} {:>7} of the gap ({} to {})",
            axis.title(),
            percent(axis.share),
            percent(low),
            percent(high)
        );
    }
}

/// Which consistency checks the readings violate.
fn consistency_checks(out: &mut String, report: &Report) {
    for check in report.consistency_checks.iter().filter(|c| c.violated) {
        let share = check.share.map_or(String::new(), |s| format!(", {} of the signal", percent(s)));
        let _ = writeln!(
            out,
            "  violated: {} ({}): {:.1} noise deviations{share}",
            check.check,
            check.what,
            check.violation.unwrap_or(f64::NAN)
        );
    }
}

/// Fitted values of an effect that are shown, at most.
const SHOWN: usize = 12;

/// A named effect, what cannot be distinguished from it, and its fitted values.
fn effect(out: &mut String, effect: &NamedEffect) {
    let tier = match effect.tier {
        Tier::Strict => "",
        Tier::Loose => ", or the model discrepancy",
    };
    let _ = writeln!(
        out,
        "  {}{tier}: explains {} of the variance (p = {:.3})",
        effect.names().first().unwrap_or(&effect.label),
        percent(effect.gain),
        effect.p_max_t
    );
    for alike in effect.class.iter().skip(1).filter(|a| !a.alias) {
        let _ = writeln!(
            out,
            "    indistinguishable from {} (explains {}, confused with probability {:.2})",
            alike.name,
            percent(alike.gain),
            alike.p_confuse
        );
    }
    if !effect.covers.is_empty() {
        let _ = writeln!(out, "    more general: {}", effect.covers.join(", "));
    }
    for alias in &effect.covariate_alias {
        let _ = writeln!(out, "    in this recording also {alias}");
    }
    for theta in effect.theta.iter().take(SHOWN) {
        let _ = writeln!(out, "    {}", value(theta));
    }
    if effect.theta.len() > SHOWN {
        let _ = writeln!(out, "    and {} values more", effect.theta.len() - SHOWN);
    }
    if !effect.written {
        let _ = writeln!(out, "    a skin description cannot say it: the corrected skin is without it");
    }
}

/// Where no effect is named, what single effects would explain alone.
fn suspects(out: &mut String, report: &Report) {
    if !report.effects.is_empty() || report.suspects.is_empty() {
        return;
    }
    let _ = writeln!(out, "\nno effect is named; alone would explain of the variance");
    for suspect in &report.suspects {
        let _ = writeln!(
            out,
            "  {:32} {} ({} beyond the simulator's tolerances)",
            suspect.name,
            percent(suspect.gain),
            percent(suspect.beyond_discrepancy)
        );
    }
}

/// How far the named effects reduce the residual, and what they leave.
fn residual(out: &mut String, report: &Report) {
    if let Some(reduction) = &report.residual_reduction {
        let how = if reduction.achieved.is_some() {
            "removes"
        } else {
            "cannot be switched on; its signature explains"
        };
        let _ = writeln!(out, "\n{how} {}; predicted {}", reduction.text(), percent(reduction.predicted));
    }
    if !report.effects.is_empty() || report.unknown.share > 0.0 {
        let _ = writeln!(
            out,
            "left: {} of the systematic gap ({} of it within the simulator's tolerances); {} of what is left could be explained",
            percent(report.unknown.share),
            percent(report.unknown.model_discrepancy),
            percent(report.unknown.explainable)
        );
    }
}

/// What speaks for a cause that no effect is: the evidence, and the shape that explains most.
fn beyond_the_library(out: &mut String, report: &Report) {
    if let Some((evidence, threshold)) = report.unknown.evidence.zip(report.unknown.threshold) {
        let called = if evidence > threshold { "called unknown" } else { "not called unknown" };
        let _ = writeln!(
            out,
            "evidence for a cause that no effect is: log odds {evidence:.1}, {called} (from {threshold:.1} on)"
        );
    }
    if let Some(rival) = report.rivals.first().filter(|r| r.explains > 0.0) {
        let more =
            rival.excess.map_or(String::new(), |e| format!(", {} more than what is named", percent(e)));
        let _ = writeln!(
            out,
            "of shapes without a cause, {} explains most: {} of the gap on other locations{more}",
            rival.what,
            percent(rival.explains)
        );
    }
}

/// Which experiments would tell most.
fn experiments(out: &mut String, report: &Report) {
    for experiment in report.next_experiments.iter().take(3) {
        let _ = writeln!(
            out,
            "next ({} min): {}; {} then confused with probability {:.2}",
            experiment.minutes,
            experiment.what,
            experiment.separates.join(" and "),
            experiment.p_confuse_after
        );
    }
}

/// A fitted value with its interval.
pub(super) fn value(v: &Value) -> String {
    let unit = if v.unit == "1" || v.unit.is_empty() { String::new() } else { format!(" {}", v.unit) };
    let interval =
        v.interval.map_or(String::new(), |[low, high]| format!(" ({} to {})", short(low), short(high)));
    let plausible = v
        .plausibility
        .filter(|p| *p < 0.5)
        .map_or(String::new(), |p| format!(", beyond what is known of such devices (plausibility {p:.2})"));
    format!("{} = {}{unit}{interval}{plausible}", v.name, short(v.value))
}

/// What an estimator does before and after; lengths in millimetres.
pub(super) fn downstream(down: &Downstream) -> String {
    let (metric, scale) = match down.metric.strip_suffix("[m]") {
        Some(metric) => (format!("{metric}[mm]"), 1e3),
        None => (down.metric.trim_end_matches(" [1]").to_owned(), 1.0),
    };
    format!("{metric}: {} before, {} after", short(scale * down.before), short(scale * down.after))
}

/// A share in percent.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{} %", short(100.0 * share)) } else { "unknown".to_owned() }
}

/// Three digits.
pub(super) fn short(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && size < 1e-3 { format!("{value:.2e}") } else { dermis_figures::short(value) }
}
