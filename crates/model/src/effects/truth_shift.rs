//! Rigid displacement of the skin on the rig: contacts lie elsewhere, and forces turn with the surface there.

use std::sync::Arc;

use dermis_skin::{ParameterInfo, Surface};
use nalgebra::{Rotation3, Vector3};

use super::diagnosis::{Diagnosis, FreeNumber, Needs, Variation};
use super::{Act, CommonEffect, CommonParameters, Refused, RigAct, Settings, Stage};
use crate::Indentation;

/// \[m\] of central differences: small against a footprint of millimetres.
const SHIFT: f64 = 2e-4;
/// \[rad\] of central differences.
const TURN: f64 = 0.02;

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
    diagnosis: Diagnosis {
        free: &[
            FreeNumber::new(Some("turn"), [-0.5, 0.5], 0.05, 0.0),
            FreeNumber::new(None, [-0.02, 0.02], 1e-3, 0.0),
        ],
        ..Diagnosis::simulated(&[
            Variation::by("x", SHIFT),
            Variation::by("x", -SHIFT),
            Variation::by("y", SHIFT),
            Variation::by("y", -SHIFT),
            Variation::by("z", SHIFT).needing(Needs::CurvedSurface),
            Variation::by("z", -SHIFT).needing(Needs::CurvedSurface),
            Variation::by("turn", TURN),
            Variation::by("turn", -TURN),
        ])
    },
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

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;
    use nalgebra::Point3;

    use super::*;

    fn moved(shift: [f64; 3], turn: f64, surface: &Surface, at: [f64; 3], force: [f64; 3]) -> Indentation {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
        let mut contact = Indentation::sphere(Point3::from(at), Vector3::from(force), 0.004);
        Shift { shift: Vector3::from(shift), turn }.real(&mut contact, surface);
        contact
    }

    fn near(found: &Indentation, at: [f64; 3], force: [f64; 3]) {
        let (at, force) = (Point3::from(at), Vector3::from(force));
        assert!((found.position - at).norm() < 1e-9, "{} is not {at}", found.position);
        assert!((found.force - force).norm() < 1e-9, "{} is not {force}", found.force);
    }

    #[test]
    fn on_a_plane_contacts_turn_and_move_and_forces_stay() {
        let plane = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.04, 0.04], spacing: 0.01 });
        let found = moved([0.003, -0.001, 0.002], 0.3, &plane, [0.002, 0.004, 0.0], [0.1, 0.2, -1.0]);
        let (sin, cos) = 0.3_f64.sin_cos();
        let at = [0.002 * cos - 0.004 * sin + 0.003, 0.002 * sin + 0.004 * cos - 0.001, 0.0];
        near(&found, at, [0.1, 0.2, -1.0]);
    }

    /// Each parameter moves along its own axis: x is along the normal of this place, so that only the curve of the wall shows it.
    #[test]
    fn every_parameter_has_its_own_axis() {
        use dermis_fixtures::SkinFile;
        use dermis_skin::Effect;

        let dome = Surface::from_spec(&SurfaceSpec::Dome { radius: 0.03, cylinder: 0.02, spacing: 0.002 });
        let skin = SkinFile::new("pad").read();
        let effect = Effect::new("truth-shift").with("x", 0.001).with("y", 0.002).with("z", 0.004);
        let acts = acts(&Settings::new(&EFFECT, &effect, &skin).unwrap()).unwrap();
        let [Act::Rig(shift)] = acts.as_slice() else { panic!("it is one act on the rig") };
        let mut contact =
            Indentation::sphere(Point3::new(0.03, 0.0, 0.01), Vector3::new(-1.0, 0.0, 0.0), 0.004);
        shift.real(&mut contact, &dome);
        let angle = (0.002_f64).atan2(0.031);
        let (at, force) =
            ([0.03 * angle.cos(), 0.03 * angle.sin(), 0.014], [-angle.cos(), -angle.sin(), 0.0]);
        near(&contact, at, force);
    }

    #[test]
    fn around_a_wall_forces_turn_with_the_normal() {
        let dome = Surface::from_spec(&SurfaceSpec::Dome { radius: 0.03, cylinder: 0.02, spacing: 0.002 });
        // Up the wall: nothing but the height changes.
        near(
            &moved([0.0, 0.0, 0.002], 0.0, &dome, [0.03, 0.0, 0.01], [-1.0, 0.5, 0.25]),
            [0.03, 0.0, 0.012],
            [-1.0, 0.5, 0.25],
        );
        // A quarter round it: pressing stays pressing, and what pushed along the wall still does.
        near(
            &moved([0.0; 3], std::f64::consts::FRAC_PI_2, &dome, [0.03, 0.0, 0.01], [-1.0, 0.5, 0.25]),
            [0.0, 0.03, 0.01],
            [-0.5, -1.0, 0.25],
        );
    }
}
