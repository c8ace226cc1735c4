//! Coupling of neighbouring channels: `r(k) + before · r(k-1) + after · r(k+1)`.

use dermis_skin::ParameterInfo;

use super::diagnosis::{Diagnosis, FreeNumber, Needs, Variation};
use super::{Act, CommonEffect, CommonParameters, ReadingAct, Refused, Settings, Stage};

/// Crosstalk beyond a half would be another channel's reading.
const HALF: f64 = 0.49;

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "crosstalk",
    what: "Channels read a share of what their neighbours on the bus read as well: of the one before, of the one after.",
    source: "charge that a multiplexer keeps from the channel before, and coupling of neighbouring lines: Horowitz and Hill, The Art of Electronics, 3rd ed., 3.4 and 13.11",
    parameters: CommonParameters::Named(&[
        ParameterInfo::new(
            "before",
            "1",
            "of what the channel before it on the bus reads",
            0.0,
            [-0.1, 0.3],
            [-0.49, 0.49],
        ),
        ParameterInfo::new(
            "after",
            "1",
            "of what the channel after it on the bus reads",
            0.0,
            [-0.1, 0.3],
            [-0.49, 0.49],
        ),
    ]),
    unit: "1",
    stateful: false,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        limits: Some([-HALF, HALF]),
        free: &[FreeNumber::new(None, [-HALF, HALF], 0.1, 0.0)],
        ..Diagnosis::simulated(&[
            Variation::by("before", 0.05).needing(Needs::SeveralChannels),
            Variation::by("after", 0.05).needing(Needs::SeveralChannels),
        ])
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let share = |name: &str| match settings.scaled(name) {
        share if share.abs() < 0.5 => Ok(share),
        share => Err((name.to_owned(), format!("is {share} at this strength and must stay below 0.5"))),
    };
    let (before, after) = (share("before")?, share("after")?);
    if (before, after) == (0.0, 0.0) {
        return Ok(Vec::new());
    }
    Ok(vec![Act::reading(Stage::Electronics, Crosstalk { before, after })])
}

struct Crosstalk {
    before: f64,
    after: f64,
}

impl ReadingAct for Crosstalk {
    fn apply(&self, _: f64, readings: &mut [f64]) {
        let mut before = 0.0;
        for k in 0..readings.len() {
            let own = readings[k];
            let after = readings.get(k + 1).copied().unwrap_or(0.0);
            readings[k] = own + self.before * before + self.after * after;
            before = own;
        }
    }
}
