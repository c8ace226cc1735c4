//! Sensitivity error of the force cell: the true force is `factor · said force`.

use std::sync::Arc;

use dermis_skin::{ParameterInfo, Surface};

use super::diagnosis::{Diagnosis, FACTOR, FreeNumber, Variation};
use super::{Act, CommonEffect, CommonParameters, Refused, RigAct, Settings, Stage};
use crate::Indentation;

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "force-scale",
    what: "The force cell reads too much or too little: the true force is that factor of what it says.",
    source: "sensitivity error of a force cell",
    parameters: CommonParameters::Named(&[ParameterInfo::new(
        "factor",
        "1",
        "true over said force",
        1.0,
        [0.9, 1.1],
        [0.0, f64::INFINITY],
    )]),
    unit: "1",
    stateful: false,
    rig: true,
    stage: Stage::Rig,
    diagnosis: Diagnosis {
        neutral: 1.0,
        limits: FACTOR,
        free: &[FreeNumber::new(None, [0.1, 10.0], 0.2, 1.0)],
        ..Diagnosis::simulated(&[Variation::by("factor", 0.05), Variation::by("factor", -0.05)])
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let factor = settings.factor("factor")?;
    if factor == 1.0 {
        return Ok(Vec::new());
    }
    Ok(vec![Act::Rig(Arc::new(ForceScale(factor)))])
}

struct ForceScale(f64);

impl RigAct for ForceScale {
    fn real(&self, contact: &mut Indentation, _: &Surface) {
        contact.force *= self.0;
    }

    fn real_force(&self, stated: f64) -> f64 {
        stated * self.0
    }

    fn stated_force(&self, real: f64) -> f64 {
        real / self.0
    }
}
