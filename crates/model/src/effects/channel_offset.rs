//! Zero error of channels: `reading + offset`.

use super::diagnosis::{Amount, Diagnosis};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "channel-offset",
    what: "Channels read something where nothing touches.",
    source: "zero error of a transducer, IEC 60050-311",
    parameters: CommonParameters::Channels,
    unit: "",
    stateful: false,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        describes_channels: true,
        shifts_channels: true,
        ..Diagnosis::of_channels(Amount::Deviations(1.0), |_| 1.0)
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let offsets = settings.scaled_channels()?;
    Ok(offsets.map(|o| Act::reading(Stage::Electronics, Offset(o))).into_iter().collect())
}

struct Offset(Vec<f64>);

impl ReadingAct for Offset {
    fn apply(&self, _: f64, readings: &mut [f64]) {
        readings.iter_mut().zip(&self.0).for_each(|(r, offset)| *r += offset);
    }
}
