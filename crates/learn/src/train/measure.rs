//! Normalisation of inputs and outputs, measured on the training part.

use std::collections::{BTreeMap, BTreeSet};

use dermis_inference::{FeatureConfig, Link, OutputConfig, OutputSpec};

use super::config::{Scaling, TrainConfig};
use super::run::no_rows;
use crate::LearnError;
use crate::dataset::{Dataset, SampleId, Truth};
use crate::findings::Findings;
use crate::split::Split;
use crate::target::{MapTarget, Maps, Target};

/// Step of a pixel's converter as a share of its full scale: no number of an image is known to be quieter.
const PIXEL_STEP: f64 = 1.0 / 255.0;

#[derive(Default, Clone, Copy)]
struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    fn push(&mut self, value: f64) {
        self.count += 1.0;
        let delta = value - self.mean;
        self.mean += delta / self.count;
        self.squares += delta * (value - self.mean);
    }

    fn deviation(&self) -> f64 {
        if self.count > 1.0 { (self.squares / self.count).sqrt() } else { 0.0 }
    }
}

/// Mean and scale of every channel over the touched samples of the training part.
pub(super) fn measure_features(
    data: &Dataset,
    config: &TrainConfig,
    split: &Split,
) -> Result<FeatureConfig, LearnError> {
    let image = config.features.image;
    let noise = match &image {
        Some(grid) => vec![PIXEL_STEP; grid.numbers()],
        None => data.skin().channel_noise(),
    };
    let mut moments = vec![Moments::default(); noise.len()];
    let train: BTreeSet<SampleId> = split.train.iter().copied().collect();
    for run in 0..data.runs().len() {
        for (sample, read) in data.stream_for(run, image)?.enumerate() {
            let read = read?;
            if !read.truth.as_ref().is_some_and(Truth::touched) || !train.contains(&SampleId { run, sample })
            {
                continue;
            }
            let values = read.numbers(config.baseline, image.is_some());
            for (m, v) in moments.iter_mut().zip(values).filter(|(_, v)| v.is_finite()) {
                m.push(f64::from(*v));
            }
        }
    }
    if moments.iter().all(|m| m.count == 0.0) {
        return Err(no_rows());
    }
    let mean = moments.iter().map(|m| m.mean as f32).collect();
    let common = (moments.iter().map(|m| m.deviation().powi(2)).sum::<f64>() / moments.len() as f64).sqrt();
    let scale = moments
        .iter()
        .zip(&noise)
        .map(|(m, noise)| {
            let scale = match config.features.scaling {
                Scaling::Channel => m.deviation(),
                Scaling::Common => common,
            };
            // A channel that never moved would blow its noise up.
            scale.max(*noise) as f32
        })
        .collect();
    let features = config.features.with(mean, scale);
    features.validate()?;
    Ok(features)
}

/// De-normalisation of every output over the training part.
pub(super) fn measure_outputs(
    data: &Dataset,
    outputs: &[&'static str],
    split: &Split,
    maps: &mut Maps,
) -> Result<OutputConfig, LearnError> {
    // The positions share a scale, so that an error counts the same in every direction; so do the forces.
    let mut moments: BTreeMap<&str, Moments> = BTreeMap::new();
    for truth in split.train.iter().filter_map(|id| data.sample(*id)?.truth.as_ref()) {
        for name in outputs {
            if let Some(value) = truth.value(name) {
                moments.entry(name).or_default().push(value);
            }
        }
    }
    let mut specs = Vec::new();
    for name in outputs {
        if *name == "contact" {
            let mut spec = OutputSpec::new(*name, "1", 0.0, 1.0);
            spec.link = Link::Logistic;
            specs.push(spec);
            continue;
        }
        if let Some(Target::Map(map)) = Target::of(name) {
            specs.push(measure_map(data, map, split, maps)?);
            continue;
        }
        let family = if name.starts_with("position.") { "position." } else { "force." };
        let scale = moments
            .iter()
            .filter(|(n, _)| n.starts_with(family))
            .map(|(_, m)| m.deviation())
            .fold(0.0, f64::max);
        if scale <= 0.0 {
            let mut findings = Findings::default();
            findings.fatal(
                "the training part",
                format!("`{name}` is the same in all {} samples", moments.get(name).map_or(0.0, |m| m.count)),
                "it cannot be learned; leave it out or record other presses",
            );
            return Err(LearnError::Unfit(findings));
        }
        let mean = moments.get(name).map_or(0.0, |m| m.mean);
        let unit = if family == "position." { "m" } else { "N" };
        specs.push(OutputSpec::new(*name, unit, mean, scale));
    }
    let specs = OutputConfig { values: specs };
    specs.validate()?;
    Ok(specs)
}

/// De-normalisation of a map: the root mean square of all its points over the touched samples of the training part. Its
/// zero stays, so that a model which answers nothing answers an untouched skin.
fn measure_map(
    data: &Dataset,
    map: MapTarget,
    split: &Split,
    maps: &mut Maps,
) -> Result<OutputSpec, LearnError> {
    let (mut squares, mut count, mut values) = (0.0, 0.0, Vec::new());
    for truth in split.train.iter().filter_map(|id| data.sample(*id)?.truth.as_ref()).filter(|t| t.touched())
    {
        values.clear();
        maps.append(map, truth, &mut values)?;
        for value in values.iter().filter(|v| v.is_finite()) {
            squares += value * value;
            count += 1.0;
        }
    }
    let scale = if count > 0.0 { f64::sqrt(squares / count) } else { 0.0 };
    if scale <= 0.0 {
        let mut findings = Findings::default();
        findings.fatal(
            "the training part",
            format!("`{}` is not known of any touched sample, or nothing acts there", map.name()),
            "it cannot be learned: record place, force and diameter of the tip of every contact",
        );
        return Err(LearnError::Unfit(findings));
    }
    let mut spec = OutputSpec::new(map.name(), maps.unit(map), 0.0, scale);
    spec.count = maps.len(map);
    Ok(spec)
}
