//! Rigid displacement of the skin on the rig: contacts lie elsewhere, and forces turn with the surface there.

use std::sync::Arc;

use dermis_skin::{ParameterInfo, Surface};
use nalgebra::{Rotation3, Vector3};

use super::{Act, CommonEffect, CommonParameters, Refused, RigAct, Settings, Signature, Stage};
use crate::Indentation;

pub(super) const EFFECT: CommonEffect = CommonEffect {
    name: "truth-shift",
    what: "Contacts are elsewhere than the ground truth says: the skin is mounted askew on the rig.",
    source: "rigid displacement between two frames",
    parameters: CommonParameters::Named(&[
        ParameterInfo::new(
            "x",
            "m",
            "along x of the link frame",
            0.0,
            [-2e-3, 2e-3],
            [f64::NEG_INFINITY, f64::INFINITY],
        ),
        ParameterInfo::new(
            "y",
            "m",
            "along y of the link frame",
            0.0,
            [-2e-3, 2e-3],
            [f64::NEG_INFINITY, f64::INFINITY],
        ),
        ParameterInfo::new(
            "z",
            "m",
            "along z of the link frame",
            0.0,
            [-2e-3, 2e-3],
            [f64::NEG_INFINITY, f64::INFINITY],
        ),
        ParameterInfo::new(
            "turn",
            "rad",
            "about z of the link frame",
            0.0,
            [-0.1, 0.1],
            [f64::NEG_INFINITY, f64::INFINITY],
        ),
    ]),
    unit: "m",
    stateful: false,
    rig: true,
    stage: Stage::Rig,
    signature: Signature::SIMULATED,
    acts,
};

fn acts(settings: &Settings<'_>) -> Result<Vec<Act>, Refused> {
    let shift = Vector3::new(settings.scaled("x"), settings.scaled("y"), settings.scaled("z"));
    let turn = settings.scaled("turn");
    if shift == Vector3::zeros() && turn == 0.0 {
        return Ok(Vec::new());
    }
    Ok(vec![Act::Rig(Arc::new(Shift { shift, turn: Rotation3::from_axis_angle(&Vector3::z_axis(), turn) }))])
}

struct Shift {
    /// \[m\]
    shift: Vector3<f64>,
    turn: Rotation3<f64>,
}

impl RigAct for Shift {
    fn real(&self, contact: &mut Indentation, surface: &Surface) {
        let (_, before) = surface.project(&contact.position);
        let (on, after) = surface.project(&(self.turn * contact.position + self.shift));
        contact.position = on;
        if (before - after).norm() > 1e-9 {
            let bend = Rotation3::rotation_between(&before, &after).unwrap_or_else(Rotation3::identity);
            contact.force = bend * contact.force;
            contact.tip.orientation = bend * contact.tip.orientation;
        }
    }
}
