//! Zero error of the force cell: the true force is that much larger than the said one, in its direction.

use std::sync::Arc;

use dermis_skin::{ParameterInfo, Surface};

use super::diagnosis::{Diagnosis, FreeNumber, Variation};
use super::{Act, CommonEffect, CommonParameters, Refused, RigAct, Settings, Stage};
use crate::Indentation;

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "force-zero",
    what: "The zero of the force cell is off: the true force is that much larger.",
    source: "zero error of a force cell",
    parameters: CommonParameters::Named(&[ParameterInfo::new(
        "force",
        "N",
        "true minus said force",
        0.0,
        [-0.05, 0.05],
        [f64::NEG_INFINITY, f64::INFINITY],
    )]),
    unit: "N",
    stateful: false,
    rig: true,
    stage: Stage::Rig,
    diagnosis: Diagnosis {
        free: &[FreeNumber::new(None, [-2.0, 2.0], 0.05, 0.0)],
        ..Diagnosis::simulated(&[Variation::by("force", 0.005), Variation::by("force", -0.005)])
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let more = settings.scaled("force");
    if more == 0.0 {
        return Ok(Vec::new());
    }
    Ok(vec![Act::Rig(Arc::new(ForceZero(more)))])
}

/// \[N\]
struct ForceZero(f64);

impl RigAct for ForceZero {
    fn real(&self, contact: &mut Indentation, _: &Surface) {
        let size = contact.force.norm();
        // A tip that the cell does not feel touches nowhere that anybody knows.
        contact.force *= self.real_force(size) / size.max(1e-12);
    }

    fn real_force(&self, stated: f64) -> f64 {
        (stated + self.0).max(0.0)
    }

    fn stated_force(&self, real: f64) -> f64 {
        real - self.0
    }
}
