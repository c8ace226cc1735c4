//! Where readings come from: a forward model, or recordings.

use std::sync::Arc;

use anyhow::{Result, bail};
use dermis_learn::{Dataset, SampleId};
use dermis_model::ForwardModel;
use dermis_skin::{SkinDescription, Surface};
use dermis_theory::{Press, Responses, noise_of_repeats};
use nalgebra::Point3;

use super::Request;
use crate::{Progress, labelled};

/// \[N\] up to which isolines of a model are followed.
const FORCE_MAX: f64 = 2.5;
/// Frames of an untouched stretch that noise is taken from: a second at most rates, so that temperature does not count.
const STRETCH: usize = 200;

/// Readings of a skin over locations and forces.
pub enum Source {
    /// The forward model.
    Model(Arc<dyn ForwardModel>),
    /// Presses of labelled bags.
    Recording {
        /// Frames of one contact of known place and force.
        presses: Vec<Press>,
        /// σ_S of every channel.
        noise: Vec<f64>,
        /// Whether it comes from untouched stretches; otherwise it is what the skin says.
        measured: bool,
        /// \[N\] largest force.
        most: f64,
        /// \[m\] diameter of its tip; NaN where it is unknown.
        diameter: f64,
    },
}

impl Source {
    /// The bags that options name, or the model.
    pub(super) fn new(
        options: &Request,
        skin: &SkinDescription,
        model: Option<&Arc<dyn ForwardModel>>,
        progress: &dyn Progress,
    ) -> Result<Self> {
        if options.bag.is_empty() {
            let Some(model) = model else { bail!("there is neither a model nor a bag") };
            return Ok(Self::Model(Arc::clone(model)));
        }
        let data = labelled(&options.bag, skin, &options.labels.options()?, progress)?;
        let mut diameter = f64::NAN;
        let single: Vec<SampleId> =
            data.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
        let presses: Vec<Press> = data
            .gather(&single)?
            .iter()
            .filter_map(|(_, sample)| {
                let truth = sample.truth.as_ref()?;
                let contact = truth.single()?;
                let force = contact.normal_force().filter(|f| *f > 0.0)?;
                let known = contact.position.iter().all(|v| v.is_finite());
                let readings: Vec<f64> = sample.tared.iter().map(|v| f64::from(*v)).collect();
                diameter = contact.diameter;
                (known && readings.iter().all(|v| v.is_finite())).then_some(Press {
                    position: contact.position,
                    force,
                    readings,
                })
            })
            .collect();
        if presses.is_empty() {
            bail!(
                "no frame of {} shows a single contact of known place and force with a known zero: isolines cannot be \
                 extracted; record presses after an untouched stretch",
                options.bag.iter().map(|b| b.display().to_string()).collect::<Vec<_>>().join(", ")
            );
        }
        let most = presses.iter().map(|p| p.force).fold(0.0, f64::max);
        let mut stretches: Vec<Vec<Vec<f64>>> = Vec::new();
        for run in 0..data.runs().len() {
            stretches.extend(untouched(&data, run)?);
        }
        let noise = noise_of_repeats(stretches.iter().map(Vec::as_slice), skin.channels().len())
            .filter(|n| n.iter().all(|v| *v > 0.0));
        let measured = noise.is_some();
        let noise = noise.unwrap_or_else(|| skin.channel_noise());
        Ok(Self::Recording { presses, noise, measured, most, diameter })
    }

    /// σ_S of every channel: from the untouched stretches of a recording, otherwise as the skin says.
    #[must_use]
    pub fn noise(&self) -> &[f64] {
        match self {
            Self::Recording { noise, .. } => noise,
            Self::Model(model) => model.noise(),
        }
    }

    /// Where σ_S comes from, for people.
    #[must_use]
    pub fn noise_source(&self) -> &'static str {
        match self {
            Self::Recording { measured: true, .. } => "from untouched frames",
            _ => "as the skin description says",
        }
    }

    /// \[N\] up to which there are readings.
    pub(super) fn force_max(&self) -> f64 {
        match self {
            Self::Model(_) => FORCE_MAX,
            Self::Recording { most, .. } => *most,
        }
    }

    /// Step of a path per tolerance of its taxels: a recording has too few presses for fine ones.
    pub(super) fn fineness(&self) -> f64 {
        match self {
            Self::Model(_) => 0.125,
            Self::Recording { .. } => 0.25,
        }
    }

    /// Readings at locations; those of a recording from presses within `reach` \[m\].
    pub(super) fn responses(
        &self,
        surface: &Surface,
        points: &[Point3<f64>],
        forces: &[f64],
        diameter: f64,
        reach: f64,
    ) -> Result<Responses> {
        Ok(match self {
            Self::Model(model) => Responses::of_model(model.as_ref(), points, forces, diameter)?,
            Self::Recording { presses, noise, .. } => {
                Responses::of_presses(presses, noise, surface, points, forces, reach)?
            }
        })
    }

    /// What it is, for people.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Model(_) => "the forward model".to_owned(),
            Self::Recording { presses, diameter, .. } => {
                let tip = if diameter.is_finite() {
                    format!(", tip of {} mm", diameter * 1e3)
                } else {
                    String::new()
                };
                format!("{} recorded frames{tip}", presses.len())
            }
        }
    }
}

/// Stretches of a recording in which nothing touches.
fn untouched(data: &Dataset, run: usize) -> Result<Vec<Vec<Vec<f64>>>> {
    let mut found = Vec::new();
    let mut stretch: Vec<Vec<f64>> = Vec::new();
    for sample in data.stream(run)? {
        let sample = sample?;
        // The zero jumps where it is taken anew; what the device gave does not.
        let still = sample.truth.as_ref().is_some_and(|t| !t.touched());
        if still {
            stretch.push(sample.frame.values.iter().map(|v| f64::from(*v)).collect());
        }
        if !still || stretch.len() >= STRETCH {
            found.push(std::mem::take(&mut stretch));
        }
    }
    found.push(stretch);
    Ok(found)
}
