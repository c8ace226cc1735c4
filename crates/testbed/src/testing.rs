//! A skin and a model for the tests of this crate: bumps, no physics.

use std::sync::Arc;

use dermis_model::{DeviceState, ForwardModel, Indentation, Memory, Stepped, Stimulus};
use dermis_skin::{ModelError, SkinDescription, Surface, SurfaceSpec};
use nalgebra::Point3;

/// Three channels on a pad of 30 mm by 20 mm.
pub(crate) fn skin(rate: f64) -> SkinDescription {
    let text = format!(
        r#"
        schema = "dermis-skin/1"
        name = "pad"
        sensor = "bumps"
        kind = "simulated"
        frame_id = "pad_link"
        unit = "Pa"
        rate = {rate:?}
        noise = 2.0
        range = [-1000.0, 900.0]
        surface = {{ type = "rectangle", size = [0.03, 0.02], spacing = 0.001 }}
        taxels = [
            {{ name = "left", position = [-0.01, 0.0, -0.005] }},
            {{ name = "middle", position = [0.0, 0.0, -0.005] }},
            {{ name = "right", position = [0.01, 0.0, -0.005] }},
        ]
        "#
    );
    SkinDescription::from_toml(&text, "pad.toml").unwrap()
}

/// Reads 1 kPa per newton straight above a channel, less further away.
pub(crate) struct Bumps {
    surface: Surface,
    noise: Vec<f64>,
    centres: Vec<Point3<f64>>,
    /// Contacts with more force than this are an error.
    pub(crate) limit: f64,
    /// Whether it knows how deep tips sink in.
    pub(crate) deep: bool,
}

impl Bumps {
    pub(crate) fn new(skin: &SkinDescription) -> Self {
        let centres = skin.taxels.iter().map(dermis_skin::Taxel::point).collect();
        Self {
            surface: skin.surface(),
            noise: skin.channel_noise(),
            centres,
            limit: f64::INFINITY,
            deep: true,
        }
    }

    /// On another surface.
    pub(crate) fn on(surface: &SurfaceSpec) -> Arc<dyn ForwardModel> {
        Arc::new(Self { surface: Surface::from_spec(surface), ..Self::new(&skin(100.0)) })
    }

    pub(crate) fn drop_channel(&mut self) {
        self.noise.pop();
        self.centres.pop();
    }

    pub(crate) fn shared(skin: &SkinDescription) -> Arc<dyn ForwardModel> {
        Arc::new(Self::new(skin))
    }
}

impl ForwardModel for Bumps {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let force = contact.force.norm();
            if force > self.limit {
                return Err(ModelError::Stimulus { index, reason: format!("{force} N are too much") });
            }
            for (o, centre) in out.iter_mut().zip(&self.centres) {
                let offset = contact.position - centre;
                *o += 1000.0 * force * (-(offset.x.powi(2) + offset.y.powi(2)) / 5e-5).exp();
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// A spring of 500 N/m, 5 mm long.
    fn force_at(&self, _: &Point3<f64>, _: f64, depth: f64) -> Option<f64> {
        (self.deep && depth <= 0.005).then_some(500.0 * depth)
    }

    fn depth_at(&self, _: &Point3<f64>, _: f64, force: f64) -> Option<f64> {
        (self.deep && force <= 2.5).then_some(force / 500.0)
    }

    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, Dragged::default()))
    }
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
