//! Tolerance of a tip: all of its lengths are off by one factor.

use std::sync::Arc;

use dermis_skin::{ParameterInfo, Surface};

use super::diagnosis::{Diagnosis, FACTOR, FreeNumber, Variation};
use super::{Act, CommonEffect, CommonParameters, Refused, RigAct, Settings, Stage};
use crate::Indentation;

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "tip-scale",
    what: "The tip is larger, or smaller, than the ground truth says.",
    source: "tolerance of a tip",
    parameters: CommonParameters::Named(&[ParameterInfo::new(
        "factor",
        "1",
        "true over said diameter",
        1.0,
        [0.8, 1.25],
        [0.0, f64::INFINITY],
    )]),
    unit: "1",
    stateful: false,
    rig: true,
    stage: Stage::Rig,
    diagnosis: Diagnosis {
        neutral: 1.0,
        limits: FACTOR,
        tolerance: Some(("factor", "diameter of the tip")),
        free: &[FreeNumber::new(None, [0.1, 10.0], 0.2, 1.0)],
        ..Diagnosis::simulated(&[Variation::by("factor", 0.1), Variation::by("factor", -0.1)])
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let factor = settings.factor("factor")?;
    if factor == 1.0 {
        return Ok(Vec::new());
    }
    Ok(vec![Act::Rig(Arc::new(TipScale(factor)))])
}

struct TipScale(f64);

impl RigAct for TipScale {
    fn real(&self, contact: &mut Indentation, _: &Surface) {
        contact.tip.shape = contact.tip.shape.scaled(self.0);
    }
}
