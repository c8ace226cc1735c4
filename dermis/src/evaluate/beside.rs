//! Other ways to one contact, learned from recordings and measured beside a model.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Result, bail};
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::Recorded;
use dermis_learn::{Bin, Bounds, Dataset, Evaluation, Evaluator, SampleId};
use dermis_skin::{Estimate, SkinDescription};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::{Value, json};

use crate::real2sim::estimators::{Direct, Method};
use crate::real2sim::train::parts;

/// Recorded readings that neighbours and the network learn from at most, and support vectors.
const LEARNED: usize = 12_000;
const VECTORS: usize = 2500;
/// Readings that every way is asked at most: more of them change the last digit.
const ASKED: usize = 12_000;

/// What another way makes of the same recordings.
#[derive(Debug, Serialize)]
pub struct Beside {
    method: &'static str,
    /// Settings that were chosen on places that nothing was learned from.
    settings: Value,
    evaluation: Evaluation,
}

/// Learns from `bags`, and answers the touched frames of one contact of `data` (of these `only`).
pub fn beside(
    skin: &SkinDescription,
    bags: &[PathBuf],
    labels: &Labels,
    data: &Dataset,
    only: Option<&[SampleId]>,
    bins: &[f64],
) -> Result<Vec<Beside>> {
    let learned = Dataset::from_bags(bags, skin, &labels.options()?)?;
    let single: Vec<SampleId> =
        learned.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
    let (learn, choose) = parts(&learned, &single);
    let least = bins.first().copied().unwrap_or_default();
    let of = |ids: &[SampleId], most| Recorded::of(&learned, ids, least, most);
    let (learn, choose) = (of(&learn, LEARNED)?, of(&choose, LEARNED / 4)?);
    if learn.is_empty() || choose.is_empty() {
        bail!(
            "the bags of `--beside` hold no single contact of {least} N or more, of known place, force and tip"
        );
    }
    let style = ProgressStyle::with_template("{msg:40} {spinner} {elapsed}")?;
    let bar = ProgressBar::new_spinner().with_style(style);
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    let mut asked: Vec<SampleId> = match only {
        Some(ids) => ids.to_vec(),
        None => data.labelled().map(|(id, ..)| id).collect(),
    };
    let felt = |id: &SampleId| {
        data.sample(*id).is_some_and(|s| {
            let heavy = |t: &dermis_learn::Truth| {
                t.single().and_then(dermis_learn::TruthContact::normal_force).is_some_and(|f| f >= least)
            };
            s.truth.as_ref().is_some_and(heavy)
        })
    };
    asked.retain(felt);
    let mut asked = data.gather(&asked)?;
    asked.retain(|(_, sample)| sample.tared.iter().any(|v| v.is_finite()));
    let every = asked.len().div_ceil(ASKED).max(1);
    let mut found = Vec::new();
    let mut measure = |method: &'static str, settings: Value, mut direct: Direct| -> Result<()> {
        bar.set_message(format!("{method}: answering"));
        let mut evaluator = Evaluator::new().by_force(bins);
        for (id, sample) in asked.iter().step_by(every) {
            let Some(truth) = sample.truth.as_ref() else { continue };
            let contacts = direct.contacts(sample)?;
            evaluator.push(id.run, truth, &Estimate { contacts, ..Estimate::default() });
        }
        found.push(Beside { method, settings, evaluation: evaluator.finish(method) });
        Ok(())
    };
    bar.set_message("support vectors: learning");
    let (vectors, settings) = Direct::tuned_vectors(skin, &learn, &choose, VECTORS)?;
    let [x, y, z, force] = settings;
    measure("support vectors", json!({ "x": x, "y": y, "z": z, "force": force }), vectors)?;
    bar.set_message("nearest neighbours: learning");
    let (neighbours, count) = Direct::tuned_neighbours(skin, &learn, &choose)?;
    measure("nearest neighbours", json!({ "count": count }), neighbours)?;
    bar.set_message("feed-forward network: learning");
    let network = Direct::network(skin, &learn)?;
    measure("feed-forward network", json!({ "learned": learn.len() }), network)?;
    bar.finish_and_clear();
    Ok(found)
}

/// Mean and standard deviation of the magnitudes of errors.
fn spread(bin: &Bin, factor: f64) -> String {
    let deviation = (bin.rms * bin.rms - bin.mean * bin.mean).max(0.0).sqrt();
    format!("{:.2} ±{:.2}", bin.mean * factor, deviation * factor)
}

/// Errors by force, side by side: means and standard deviations, and below them the bound, which is of the root mean square.
pub fn table(own: &Evaluation, others: &[Beside], bound: Option<&Bounds>) -> String {
    let mut out = String::new();
    for (quantity, title, factor) in
        [("position", "position error [mm]", 1e3), ("force.normal", "force error [N]", 1.0)]
    {
        let Some(bins) = own.by_force.get(quantity) else { continue };
        let _ = write!(out, "\n  {title:<22}");
        for bin in bins {
            let to = bin.to.map_or_else(String::new, |v| format!("{v}"));
            let _ = write!(out, "{:>18}", format!("{}–{to} N", bin.from));
        }
        let _ = writeln!(out);
        let rows = others.iter().map(|b| (b.method, &b.evaluation));
        for (name, evaluation) in rows.chain([("the model", own)]) {
            let _ = write!(out, "  {name:<22}");
            for bin in bins {
                let same =
                    evaluation.by_force.get(quantity).into_iter().flatten().find(|b| b.from == bin.from);
                let cell = same.map_or_else(|| "-".to_owned(), |b| spread(b, factor));
                let _ = write!(out, "{cell:>18}");
            }
            let _ = writeln!(out);
        }
        let of = bound.map(|b| if quantity == "position" { &b.position } else { &b.normal_force });
        let Some(of) = of.filter(|of| !of.is_empty()) else { continue };
        let _ = write!(out, "  {:<22}", "bound, RMS");
        for bin in bins {
            let same = of.iter().find(|b| b.from == bin.from);
            let cell = same.map_or_else(|| "-".to_owned(), |b| format!("{:.2}", b.rms * factor));
            let _ = write!(out, "{cell:>18}");
        }
        let _ = writeln!(out);
    }
    out
}

#[cfg(test)]
mod tests {
    use dermis_learn::{Truth, TruthContact};
    use dermis_skin::{Contact, ForceComponents};
    use nalgebra::{Point3, Vector3};

    use super::*;

    /// One press of 2 N and one of 7 N, found so far off.
    fn evaluation(metres: f64, newtons: f64) -> Evaluation {
        let mut evaluator = Evaluator::new().by_force(&[0.5, 4.9, 9.8]);
        for (location, force) in [(0, 2.0), (1, 7.0)] {
            let at = Point3::new(0.0, 0.0, 0.0);
            let truth = Truth {
                location,
                press: u64::from(location),
                idle: false,
                contacts: vec![TruthContact {
                    position: at,
                    normal: Vector3::z(),
                    force: Vector3::new(0.0, 0.0, -force),
                    components: ForceComponents::Full,
                    diameter: 0.01,
                }],
            };
            let mut contact = Contact::at(at + Vector3::x() * metres * force, Vector3::z());
            contact.force = Vector3::new(0.0, 0.0, -force - newtons);
            contact.force_components = ForceComponents::Normal;
            evaluator.push(0, &truth, &Estimate { contacts: vec![contact], ..Estimate::default() });
        }
        evaluator.finish("made up")
    }

    #[test]
    fn people_read_every_way_by_force() {
        let others =
            [Beside { method: "support vectors", settings: Value::Null, evaluation: evaluation(0.001, 0.5) }];
        insta::assert_snapshot!(table(&evaluation(0.0002, 0.1), &others, None), @r#"
position error [mm]            0.5–4.9 N         4.9–9.8 N
support vectors               2.00 ±0.00        7.00 ±0.00
the model                     0.40 ±0.00        1.40 ±0.00

force error [N]                0.5–4.9 N         4.9–9.8 N
support vectors               0.50 ±0.00        0.50 ±0.00
the model                     0.10 ±0.00        0.10 ±0.00
"#);
    }
}
