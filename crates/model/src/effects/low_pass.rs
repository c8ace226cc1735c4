//! First-order low-pass, exact for readings that stay from frame to frame.

use dermis_skin::ParameterInfo;

use super::diagnosis::{Diagnosis, FORWARDS, FreeNumber, Variation};
use super::{Act, Circumstances, CommonEffect, CommonParameters, Refused, Settings, Stage, StatefulAct};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "low-pass",
    what: "Readings follow with a time constant.",
    source: "first-order filter",
    parameters: CommonParameters::Named(&[ParameterInfo::new(
        "time",
        "s",
        "time constant",
        0.0,
        [0.0, 0.1],
        [0.0, f64::INFINITY],
    )]),
    unit: "s",
    stateful: true,
    rig: false,
    stage: Stage::Electronics,
    diagnosis: Diagnosis {
        limits: FORWARDS,
        free: &[FreeNumber::LAG],
        ..Diagnosis::simulated(&[Variation::frames("time", 1.0), Variation::frames("time", 10.0)])
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let constant = settings.duration("time")?;
    if constant == 0.0 {
        return Ok(Vec::new());
    }
    Ok(vec![Act::remembers(Stage::Electronics, LowPass { constant, before: None })])
}

#[derive(Clone)]
struct LowPass {
    /// \[s\]
    constant: f64,
    /// Time of the last frame, and what it read.
    before: Option<(f64, Vec<f64>)>,
}

impl StatefulAct for LowPass {
    fn apply(&mut self, now: &Circumstances, readings: &mut [f64]) {
        let (then, state) = self.before.get_or_insert_with(|| (now.time, readings.to_vec()));
        let keep = (-(now.time - *then).max(0.0) / self.constant).exp();
        for (s, r) in state.iter_mut().zip(readings.iter_mut()) {
            *s = *r + (*s - *r) * keep;
            *r = *s;
        }
        *then = now.time;
    }
}
