//! What was found, as a summary for programs.

use dermis_theory::resolution::Testbed;
use dermis_theory::{Averages, ByForce, LineStudy, TaxelStudy};
use serde_json::{Value, json};

use super::{Findings, INTERVALS};

/// Root mean square of σ_P over the locations and the forces of an interval \[m\]: how it was computed, by whom.
#[must_use]
pub fn by_interval(line: &LineStudy, of: fn(&ByForce) -> Option<Averages>) -> Vec<Option<f64>> {
    in_each(line, |inside| {
        let squares: Vec<f64> = inside.into_iter().filter_map(of).map(|a| a.position_rms.powi(2)).collect();
        (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
    })
}

/// Share of the locations and the forces of an interval, 0 to 1, that [`by_interval`] is of: elsewhere there is no such estimate,
/// or no end to its error. `None` where no force of the interval was studied.
#[must_use]
pub fn share_by_interval(line: &LineStudy, of: fn(&ByForce) -> Option<Averages>) -> Vec<Option<f64>> {
    in_each(line, |inside| {
        let shares: Vec<f64> = inside.into_iter().map(|f| of(f).map_or(0.0, |a| a.share)).collect();
        (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64)
    })
}

/// What `of` makes of the studied forces of each interval.
fn in_each(line: &LineStudy, of: impl Fn(Vec<&ByForce>) -> Option<f64>) -> Vec<Option<f64>> {
    let within = |edges: &[f64]| {
        let inside = line.by_force.iter().filter(|f| edges[0] - 1e-9 <= f.force && f.force < edges[1] - 1e-9);
        of(inside.collect())
    };
    INTERVALS.windows(2).map(within).collect()
}

/// Median over taxels.
#[must_use]
pub fn median(line: &LineStudy, of: impl Fn(&TaxelStudy) -> Option<f64>) -> f64 {
    let mut values: Vec<f64> = line.taxels.iter().filter_map(of).filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// For programs: everything but what belongs to single locations.
#[must_use]
pub fn summary(findings: &Findings) -> Value {
    let line = findings.line.as_ref().map(|line| {
        json!({
            "taxels": line.count,
            "span_m": line.span,
            "c_n_per_unit": line.taxels.iter().map(|t| t.c).collect::<Vec<_>>(),
            "alpha_by_value": alphas(line),
            "intervals_n": INTERVALS,
            "position_m": {
                "fits": by_interval(line, |f| f.fits),
                "corners": by_interval(line, |f| f.corners),
                "bound": by_interval(line, |f| f.bound),
            },
            "share_of_line": {
                "fits": share_by_interval(line, |f| f.fits),
                "corners": share_by_interval(line, |f| f.corners),
                "bound": share_by_interval(line, |f| f.bound),
            },
            "super_resolution": line.factors,
            "distinguished_by_isolines": findings.distinguishable,
        })
    });
    let surface = findings
        .surface
        .as_ref()
        .map(|s| json!({ "minimum_force_n": s.minimum_force_summary, "super_resolution": s.factors }));
    json!({
        "skin": findings.skin.name,
        "channels": findings.skin.channels().len(),
        "tip": findings.request.tip().name(),
        "diameter_m": findings.request.diameter(),
        "unknowns": findings.unknowns,
        "isolines_from": findings.source.describe(),
        "noise": findings.source.noise(),
        "least": findings.least,
        "testbed": Testbed::THESIS,
        "one_contact": findings.maps.iter().map(|m| json!({
            "force_n": m.force, "position_m": m.position, "normal_force_n": m.normal_force,
        })).collect::<Vec<_>>(),
        "two_contacts": findings.pairs,
        "line": line,
        "surface": surface,
        "notes": findings.notes,
    })
}

/// Value and median exponent over the taxels that have a fit of it.
#[must_use]
pub fn alphas(line: &LineStudy) -> Vec<[f64; 2]> {
    let mut values: Vec<f64> = line.taxels.iter().flat_map(|t| &t.fits).map(|f| f.value).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
        .into_iter()
        .map(|value| [value, median(line, |t| t.fits.iter().find(|f| f.value == value).map(|f| f.alpha))])
        .collect()
}
