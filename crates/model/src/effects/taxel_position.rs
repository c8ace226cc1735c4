//! Placement tolerance: the family's model is made of other positions.

use super::diagnosis::{Diagnosis, Signature};
use super::{Act, CommonEffect, CommonParameters, Refused, Settings, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "taxel-position",
    what: "Taxels do not lie where they were designed to.",
    source: "placement tolerance",
    parameters: CommonParameters::Taxels,
    unit: "m",
    stateful: false,
    rig: false,
    stage: Stage::Medium,
    diagnosis: Diagnosis {
        signature: Signature::Taxels,
        nonlinear: true,
        describes_channels: true,
        ..Diagnosis::FAMILY
    },
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let moved = settings.taxels();
    Ok(vec![Act::Design(Box::new(move |skin| {
        for (taxel, axis, by) in moved {
            skin.taxels[taxel].position[axis] += by;
        }
    }))])
}
