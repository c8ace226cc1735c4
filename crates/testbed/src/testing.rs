//! A skin and a model for the tests of this crate: bumps, no physics.

use std::sync::Arc;

use dermis_fixtures::{Analytic, SkinFile};
use dermis_model::{ForwardModel, Indentation, Memory, Stimulus};
use dermis_skin::{SkinDescription, Surface, SurfaceSpec};

/// Three channels on a pad of 30 mm by 20 mm.
pub(crate) fn skin(rate: f64) -> SkinDescription {
    SkinFile::new("pad")
        .set("sensor", "\"bumps\"")
        .set("kind", "\"simulated\"")
        .set("rate", format!("{rate:?}"))
        .set("noise", "2.0")
        .set("range", "[-1000.0, 900.0]")
        .rectangle([0.03, 0.02], 0.001)
        .taxels([
            ("left", [-0.01, 0.0, -0.005]),
            ("middle", [0.0, 0.0, -0.005]),
            ("right", [0.01, 0.0, -0.005]),
        ])
        .read()
}

/// Reads 1 kPa per newton straight above a channel, less further away. Tips sink into a spring of 500 N/m that is 5 mm long, and
/// drag what moves.
pub(crate) fn bumps(skin: &SkinDescription) -> Analytic {
    Analytic::of_skin(skin, |contact, centre| {
        let offset = contact.position - centre;
        1000.0 * contact.force.norm() * (-(offset.x.powi(2) + offset.y.powi(2)) / 5e-5).exp()
    })
    .on_spring(500.0, 0.005)
    .with_memory(Dragged::default)
}

/// [`bumps`] on another surface.
pub(crate) fn bumps_on(surface: &SurfaceSpec) -> Arc<dyn ForwardModel> {
    Arc::new(bumps(&skin(100.0)).under(Surface::from_spec(surface)))
}

pub(crate) fn shared_bumps(skin: &SkinDescription) -> Arc<dyn ForwardModel> {
    Arc::new(bumps(skin))
}

/// Drags what moves, and never forgets: each frame reads 0.0001 more, so that a frame left out shows.
#[derive(Default)]
pub(crate) struct Dragged {
    frames: f64,
    last: Vec<Indentation>,
}

impl Memory for Dragged {
    fn apply_to_stimulus(&mut self, _: f64, stimulus: &mut Stimulus) {
        let contacts = stimulus.contacts.clone();
        for (contact, last) in stimulus.contacts.iter_mut().zip(&self.last) {
            let way = contact.position - last.position;
            if (1e-9..1e-3).contains(&way.norm()) {
                contact.force += way.normalize() * 0.05;
            }
        }
        self.last = contacts;
    }

    fn apply_transducer(&mut self, _: f64, _: &Stimulus, readings: &mut [f64]) {
        self.frames += 1.0;
        readings.iter_mut().for_each(|r| *r += 1e-4 * self.frames);
    }
}

/// The plan that most tests use: every kind of step, short.
pub(crate) const PLAN: &str = r#"
schema = "dermis-plan/1"
name = "all-kinds"
seed = 3
diameter = 0.004
margin = 0.002
[timing]
approach = [0.02, 0.04]
load = [0.03, 0.05]
hold = [0.04, 0.06]
unload = [0.03, 0.05]
gap = [0.02, 0.04]
[[steps]]
kind = "idle"
duration = 0.2
[[steps]]
kind = "presses"
count = 4
repeats = 2
force = [0.1, 0.5]
[[steps]]
kind = "grid"
pitch = 0.008
forces = [0.2, 0.4]
repeats = 2
[[steps]]
kind = "slides"
count = 3
force = [0.1, 0.5]
length = [0.004, 0.008]
speed = [0.05, 0.1]
[[steps]]
kind = "multi"
count = 3
contacts = [2, 3]
distance = 0.006
force = [0.1, 0.5]
"#;

pub(crate) fn plan() -> crate::Plan {
    crate::Plan::from_toml(PLAN, "all-kinds.toml").unwrap()
}
