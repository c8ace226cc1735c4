//! Placement tolerance: the family's model is made of other positions.

use super::{Act, CommonEffect, CommonParameters, Refused, Settings, Signature, Stage};

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "taxel-position",
    what: "Taxels do not lie where they were designed to.",
    source: "placement tolerance",
    parameters: CommonParameters::Taxels,
    unit: "m",
    stateful: false,
    rig: false,
    stage: Stage::Medium,
    signature: Signature { nonlinear: true, ..Signature::SIMULATED },
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
