//! What a bundle says of the data behind it: `card.json` for programs; [`Report`](crate::plot::Report) shows the same.

use std::collections::{BTreeMap, BTreeSet};

use dermis_inference::{ForcePeakSection, Manifest, SigmaBin};
use serde_json::{Value, json};

use crate::dataset::{Dataset, SampleId, Truth};
use crate::evaluate::Evaluation;
use crate::metrics::{Bin, FORCE_BINS, MapErrors, bin_of};
use crate::target::{MAP_NORMAL, MapTarget};
use crate::{LearnError, SplitConfig};

/// What a card says of data that somebody else's model was measured on: all of them, or the part that `split` holds out.
///
/// # Errors
///
/// As [`of_data`].
pub fn of_measured(
    data: &Dataset,
    split: Option<SplitConfig>,
    evaluation: &Evaluation,
) -> Result<BTreeMap<String, Value>, LearnError> {
    let mut card = of_data(data)?;
    card.insert("held_out".into(), evaluation.to_json());
    if let Some(split) = split {
        card.insert("split".into(), json!(split));
    }
    Ok(card)
}

/// Everything that is true of the data, whatever is learned from it.
///
/// # Errors
///
/// [`LearnError`] where a bag cannot be read once more.
pub fn of_data(data: &Dataset) -> Result<BTreeMap<String, Value>, LearnError> {
    let skin = data.skin();
    let mut bags = Vec::new();
    for (index, run) in data.runs().iter().enumerate() {
        let stamps = || run.samples.iter().map(|s| s.stamp);
        let labelled = run.samples.iter().filter(|s| s.truth.is_some()).count();
        bags.push(json!({
            "name": run.path.file_name().map(|n| n.to_string_lossy()),
            "session": run.session,
            "hash": run.hash,
            "frames": run.frames(),
            "every": run.every(),
            "used": run.samples.len(),
            "labelled": labelled,
            "lost": run.lost,
            "seconds": stamps().max().zip(stamps().min()).map(|(last, first)| (last - first) as f64 * 1e-9),
            "tares": run.tares(),
            "noise": noise(data, index)?,
            "force_sensor": run.bias,
        }));
    }
    let presses: BTreeSet<(usize, u64)> =
        data.labelled().filter(|(_, _, t)| t.touched()).map(|(id, _, t)| (id.run, t.press)).collect();
    let sessions: BTreeSet<&str> = data.runs().iter().map(|r| r.session.as_str()).collect();
    let card = [
        ("skin", json!({ "name": skin.name, "hash": skin.hash(), "unit": skin.unit, "rate_hz": skin.rate })),
        ("bags", json!(bags)),
        ("data_hash", json!(data.hash())),
        ("sessions", json!(sessions)),
        ("locations", json!(data.locations())),
        ("presses", json!(presses.len())),
        ("where", reach(data)),
        ("forces", json!(histogram(data))),
        ("map", json!(data.map())),
        ("notices", json!(data.notices())),
        ("program", json!(format!("dermis {}", env!("CARGO_PKG_VERSION")))),
    ];
    Ok(card.into_iter().map(|(key, value)| (key.to_owned(), value)).collect())
}

/// Standard deviation of an untouched reading minus its zero, in the unit of the skin: the median and the largest of
/// the channels; `None` where nothing is known to be untouched.
pub(crate) fn noise(data: &Dataset, run: usize) -> Result<Option<Value>, LearnError> {
    let channels = data.skin().channels().len();
    let each = |take: &mut dyn FnMut(usize, f64)| -> Result<(), LearnError> {
        for sample in data.stream(run)? {
            let sample = sample?;
            if sample.truth.as_ref().is_some_and(|t| t.idle) {
                let known = sample.tared.iter().enumerate().filter(|(_, v)| v.is_finite());
                known.for_each(|(i, v)| take(i, f64::from(*v)));
            }
        }
        Ok(())
    };
    // Twice over the frames: the sum of squares of raw numbers loses the digits that matter.
    let (mut counts, mut sums, mut squares) = (vec![0.0; channels], vec![0.0; channels], vec![0.0; channels]);
    each(&mut |i, v| {
        counts[i] += 1.0;
        sums[i] += v;
    })?;
    each(&mut |i, v| squares[i] += (v - sums[i] / counts[i]).powi(2))?;
    let known = counts.iter().zip(&squares).filter(|(n, _)| **n > 1.0);
    let mut all: Vec<f64> =
        known.map(|(count, squares): (&f64, &f64)| (squares / (count - 1.0)).sqrt()).collect();
    all.sort_by(f64::total_cmp);
    let middle = all.get(all.len() / 2).zip(all.last());
    Ok(middle.map(|(median, max)| json!({ "median": median, "max": max })))
}

/// \[m\] least and largest coordinate that was pressed.
fn reach(data: &Dataset) -> Value {
    let mut axes = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    for contact in data.labelled().filter_map(|(_, _, t)| t.single()) {
        for (axis, v) in axes.iter_mut().zip(contact.position.iter()).filter(|(_, v)| v.is_finite()) {
            *axis = [axis[0].min(*v), axis[1].max(*v)];
        }
    }
    let known = |axis: [f64; 2]| (axis[0] <= axis[1]).then_some(axis);
    json!({ "x": known(axes[0]), "y": known(axes[1]), "z": known(axes[2]) })
}

/// Touched frames by normal force.
pub(crate) fn histogram(data: &Dataset) -> Vec<Value> {
    let mut counts = [0_usize; FORCE_BINS.len()];
    for force in
        data.labelled().filter(|(_, _, t)| t.touched()).filter_map(|(_, _, t)| t.value("force.normal"))
    {
        counts[bin_of(force)] += 1;
    }
    let bin = |(i, frames): (usize, &usize)| json!({ "from": FORCE_BINS[i], "to": FORCE_BINS.get(i + 1), "frames": frames });
    counts.iter().enumerate().filter(|(_, n)| **n > 0).map(bin).collect()
}

/// \[N\] least and largest normal force of these samples; `None` where there are not two.
pub(crate) fn force_range(data: &Dataset, ids: &[SampleId]) -> Option<[f64; 2]> {
    let forces = || {
        let truth = |id: &SampleId| data.sample(*id).and_then(|s| s.truth.as_ref());
        ids.iter().filter_map(truth).filter_map(Truth::single).filter_map(crate::TruthContact::normal_force)
    };
    let range = [forces().fold(f64::INFINITY, f64::min).max(0.0), forces().fold(f64::NEG_INFINITY, f64::max)];
    (range[0] < range[1]).then_some(range)
}

/// How contacts are read off a force map whose errors were measured: with the lowest threshold, as many as were there at most.
fn force_peaks(errors: &MapErrors) -> Option<ForcePeakSection> {
    let read = errors.contacts.iter().min_by(|a, b| a.threshold.total_cmp(&b.threshold))?;
    Some(ForcePeakSection {
        disc: read.disc,
        threshold: read.threshold,
        most: read.by_number.keys().copied().max()?.clamp(1, 10),
        // Of one of two tangents.
        position_sigma: read.all.position_found.as_ref().map(|s| s.rms / std::f64::consts::SQRT_2),
        force_sigma: None,
    })
}

/// Writes measured errors into a manifest, as metrics and as the sigma of its outputs.
pub fn measured(manifest: &mut Manifest, evaluation: &Evaluation) {
    // Of a vector, that of one of its numbers.
    let of_map = |name: &str| {
        let numbers = MapTarget::ALL.into_iter().find(|m| m.name() == name)?.per_point();
        Some(evaluation.maps.get(name)?.touched.rms? / (numbers as f64).sqrt())
    };
    for spec in &mut manifest.output.values {
        // A node publishes what it found.
        let found = format!("{} found", spec.name);
        let quantities = &evaluation.quantities;
        let sigma = quantities
            .get(&found)
            .or_else(|| quantities.get(&spec.name))
            .map(|s| s.rms)
            .or_else(|| of_map(&spec.name));
        spec.sigma = sigma.filter(|s| *s > 0.0);
        if let Some(bins) = evaluation.by_force.get(&found).or_else(|| evaluation.by_force.get(&spec.name)) {
            spec.sigma_by_force = sigma_bins(bins);
        }
    }
    if let Some(peaks) = evaluation.maps.get(MAP_NORMAL).and_then(force_peaks) {
        manifest.force_peaks = Some(peaks);
    }
    manifest.metrics = evaluation
        .quantities
        .iter()
        .flat_map(|(name, s)| {
            let name = name.replace(['.', ' '], "_");
            let unit = s.unit.to_lowercase();
            [(format!("{name}_rmse_{unit}"), s.rms), (format!("{name}_mean_{unit}"), s.mean)]
        })
        .collect();
    for (name, errors) in &evaluation.maps {
        let (name, unit) = (name.replace('.', "_"), errors.unit.to_lowercase());
        let figures = [
            (format!("{name}_rmse_{unit}"), errors.touched.rms),
            (format!("{name}_total_force_rmse_n"), errors.touched.total_force),
        ];
        manifest.metrics.extend(figures.into_iter().filter_map(|(name, v)| Some((name, v?))));
    }
}

/// A bundle's bins ascend without gaps; one with too few samples to tell is covered by the next.
fn sigma_bins(bins: &[Bin]) -> Vec<SigmaBin> {
    bins.iter()
        .filter(|b| b.rms > 0.0 && b.samples >= 10)
        .map(|b| SigmaBin { up_to: b.to.unwrap_or(b.from * 2.0), sigma: b.rms })
        .collect()
}
