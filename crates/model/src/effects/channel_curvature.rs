//! Non-linearity of channels: `r + c · r² / full scale`, as far as the vertex of that parabola.

use super::diagnosis::{Amount, Diagnosis};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage, full_scale};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "channel-curvature",
    what: "Channels are not straight: they read more or less by the square of the reading, by this share of it at full scale; beyond the vertex they stay.",
    source: "non-linearity of a bridge of one active arm, and of transducers: Hoffmann, An Introduction to Stress Analysis and Transducer Design; full scale is the larger end of a channel's range, 1000 deviations of its noise where it has none",
    parameters: CommonParameters::Channels,
    unit: "1",
    stateful: false,
    rig: false,
    stage: Stage::Transducer,
    diagnosis: Diagnosis {
        limits: Some([-CURVED, CURVED]),
        ..Diagnosis::of_channels(Amount::Si(0.05), |sample| sample.reading.powi(2) / sample.full_scale)
    },
    acts,
};

/// Curvature of a channel at most. Few skins use their channels to the full: what bends much there may be all but straight in use.
const CURVED: f64 = 100.0;

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let curvatures = settings.channels(0.0, |value| {
        let curvature = settings.strength() * value;
        if curvature.abs() > CURVED {
            return Err(format!("is {curvature} at this strength and must be -{CURVED} to {CURVED}"));
        }
        Ok(curvature)
    })?;
    let skin = settings.skin();
    let full = || skin.channels().iter().map(|c| full_scale(c, skin.noise)).collect::<Vec<f64>>();
    let bent = |c: Vec<f64>| Act::reading(Stage::Transducer, Curvature(c.into_iter().zip(full()).collect()));
    Ok(curvatures.map(bent).into_iter().collect())
}

/// Curvature and full scale of every channel.
struct Curvature(Vec<(f64, f64)>);

impl ReadingAct for Curvature {
    fn apply(&self, _: f64, readings: &mut [f64]) {
        for (r, (curvature, full)) in readings.iter_mut().zip(&self.0) {
            // A transducer does not turn back: beyond the vertex it stays where it is.
            let vertex = -0.5 * full / curvature;
            if *curvature > 0.0 {
                *r = r.max(vertex);
            } else if *curvature < 0.0 {
                *r = r.min(vertex);
            }
            *r += curvature * *r * *r / full;
        }
    }
}
