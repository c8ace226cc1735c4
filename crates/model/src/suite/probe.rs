//! Every wrapper of a model forwards every method.

use dermis_skin::{Image, ModelError, PixelFormat, Surface, SurfaceSpec};
use nalgebra::{Point3, Vector3};

use crate::{DeviceState, Differences, ForwardModel, Indentation, Stimulus, TipShape, Unknowns};

/// A model whose every method answers with something that no default does, to try wrappers on: two channels on a square of 20 mm.
pub struct Probe {
    surface: Surface,
    superposes: bool,
}

impl Default for Probe {
    fn default() -> Self {
        let spec = SurfaceSpec::Rectangle { size: [0.02, 0.02], spacing: 0.005 };
        Self { surface: Surface::from_spec(&spec), superposes: false }
    }
}

impl Probe {
    /// One that says that readings of contacts add up.
    #[must_use]
    pub fn that_superposes() -> Self {
        Self { superposes: true, ..Self::default() }
    }
}

/// Counts its steps and pictures from the seed on.
struct ProbeState(f64);

#[deny(clippy::missing_trait_methods)]
impl DeviceState for ProbeState {
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        stimulus.temperature += 1.0 + time;
    }

    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.0 += 1.0;
        out.copy_from_slice(&[self.0 + time, stimulus.temperature]);
        Ok(())
    }

    /// One grey pixel that tells the count, the time, the forces and the noise: not what the model's own picture tells.
    fn capture(
        &mut self,
        time: f64,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.0 += 1.0;
        let force: f64 = stimulus.contacts.iter().map(|c| c.force.norm()).sum();
        let level = self.0 + 8.0 * time + 40.0 * force + noise();
        Ok(Image::new(1, 1, PixelFormat::Mono8, vec![level as u8]))
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        readings.iter_mut().for_each(|r| *r = r.round());
    }
}

#[deny(clippy::missing_trait_methods)]
impl ForwardModel for Probe {
    fn channels(&self) -> usize {
        2
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        let force: f64 = stimulus.contacts.iter().map(|c| c.force.norm()).sum();
        out.copy_from_slice(&[3.0 * force, 5.0 * force]);
        Ok(())
    }

    /// Not what [`response`](ForwardModel::response) says, so that a test sees which one was called.
    fn untouched(&self, out: &mut [f64]) -> Result<(), ModelError> {
        out.copy_from_slice(&[17.0, 19.0]);
        Ok(())
    }

    /// Not what [`response`](ForwardModel::response) says, so that a test sees which one was called.
    fn responses(&self, stimuli: &[Stimulus], out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(stimuli.len() as f64);
        Ok(())
    }

    fn jacobian(
        &self,
        _: &Stimulus,
        unknowns: Unknowns,
        _: &Differences,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        out.fill(unknowns.count() as f64);
        Ok(())
    }

    fn superposes(&self) -> bool {
        self.superposes
    }

    fn noise(&self) -> &[f64] {
        &[0.25, 0.5]
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        out.fill(7.0 + stimulus.contacts.len() as f64);
        Ok(true)
    }

    /// One grey pixel that tells the number of contacts and the noise.
    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let level = 10.0 * stimulus.contacts.len() as f64 + noise();
        Ok(Image::new(1, 1, PixelFormat::Mono8, vec![level as u8]))
    }

    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        out.fill(f64::from(image.data()[0]));
        true
    }

    fn remembers(&self) -> bool {
        true
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(ProbeState(seed as f64))
    }

    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        Some(at.x + 10.0 * diameter + 100.0 * depth)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Some(at.x + 10.0 * diameter + force)
    }

    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        match tip {
            TipShape::Sphere { diameter } => self.force_at(at, *diameter, depth),
            _ => Some(at.x + 20.0 * tip.extent() + 100.0 * depth),
        }
    }

    fn depth_of_tip(&self, at: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        match tip {
            TipShape::Sphere { diameter } => self.depth_at(at, *diameter, force),
            _ => Some(at.x + 20.0 * tip.extent() + force),
        }
    }
}

/// What every method of a wrapper around [`Probe`] says must be what the probe says; `noise` is the one that it should have. Where
/// `same_response` is false, the wrapper has ways of its own for responses (neutral ones in the test): then they and their
/// derivatives are compared with the wrapper's own response.
///
/// # Panics
///
/// Where a method is not forwarded.
pub fn forwards_everything(wrapper: &dyn ForwardModel, noise: &[f64], same_response: bool) {
    let probe = Probe::default();
    let contact = Indentation::sphere(Point3::new(0.001, -0.002, 0.0), Vector3::new(0.0, 0.0, -0.5), 0.004);
    let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
    assert_eq!(wrapper.channels(), probe.channels());
    assert_eq!(wrapper.surface().points, probe.surface().points);
    assert_eq!(wrapper.noise(), noise);
    assert_eq!(wrapper.superposes(), probe.superposes());
    let (mut own, mut wanted) = ([f64::NAN; 2], [f64::NAN; 2]);
    wrapper.response(&stimulus, &mut own).expect("a press can be");
    probe.response(&stimulus, &mut wanted).expect("a press can be");
    assert_eq!(own, wanted, "response");
    let mut rest = [f64::NAN; 2];
    wrapper.untouched(&mut rest).expect("nothing can touch");
    assert_eq!(rest, if same_response { [17.0, 19.0] } else { [0.0; 2] }, "untouched");
    assert!(wrapper.remembers(), "remembers");

    let mut many = [f64::NAN; 4];
    wrapper.responses(&[stimulus.clone(), stimulus.clone()], &mut many).expect("a press can be");
    let [a, b] = own;
    assert_eq!(many, if same_response { [2.0; 4] } else { [a, b, a, b] }, "responses");
    let mut jacobian = [f64::NAN; 6];
    wrapper
        .jacobian(&stimulus, Unknowns::Normal, &Differences::default(), &mut jacobian)
        .expect("a press can be");
    if same_response {
        assert_eq!(jacobian, [3.0; 6], "jacobian");
    } else {
        for (found, wanted) in jacobian.iter().zip([0.0, 0.0, 0.0, 0.0, 3.0, 5.0]) {
            assert!((found - wanted).abs() < 1e-6, "jacobian: {jacobian:?}");
        }
    }

    let mut points = vec![f64::NAN; probe.surface().points.len()];
    assert!(wrapper.displacement(&stimulus, &mut points).expect("a press can be"), "displacement");
    assert!(points.iter().all(|p| *p == 8.0), "displacement: {points:?}");
    let image =
        wrapper.capture(&stimulus, &mut || 3.0).expect("a press can be").expect("the probe has a camera");
    assert_eq!(image.data(), [13], "capture");
    assert!(wrapper.observe(&image, &mut own), "observe");
    assert_eq!(own, [13.0; 2], "observe");
    let at = Point3::new(0.003, 0.0, 0.0);
    assert_eq!(wrapper.force_at(&at, 0.004, 0.001), probe.force_at(&at, 0.004, 0.001), "force_at");
    assert_eq!(wrapper.depth_at(&at, 0.004, 0.7), probe.depth_at(&at, 0.004, 0.7), "depth_at");
    for tip in [TipShape::Sphere { diameter: 0.004 }, TipShape::FlatPunch { diameter: 0.004 }] {
        let (own, wanted) = (wrapper.force_of_tip(&at, &tip, 0.001), probe.force_of_tip(&at, &tip, 0.001));
        assert_eq!(own, wanted, "force_of_tip");
        let (own, wanted) = (wrapper.depth_of_tip(&at, &tip, 0.7), probe.depth_of_tip(&at, &tip, 0.7));
        assert_eq!(own, wanted, "depth_of_tip");
    }

    let (mut state, mut real) = (wrapper.start(40), stimulus);
    state.apply_to_stimulus(0.5, &mut real);
    assert_eq!(real.temperature, 293.15 + 1.5, "apply_to_stimulus");
    for n in 1..3 {
        state.step(0.25, &real, &mut own).expect("a press can be");
        assert_eq!(own, [40.25 + f64::from(n), real.temperature], "step, and the seed of start");
    }
    let image = state.capture(0.5, &real, &mut || 3.0).expect("a press can be");
    // Two steps and this picture after a seed of 40, 0.5 s, 0.5 N, and the noise.
    assert_eq!(image.expect("the probe has a camera").data(), [43 + 4 + 20 + 3], "capture with memory");
    state.quantize(&mut own);
    assert_eq!(own, [42.0, 295.0], "quantize");
}

#[cfg(test)]
mod tests {
    /// Names of the methods of a trait, as its source has them.
    fn methods<'a>(source: &'a str, name: &str) -> Vec<&'a str> {
        let (_, body) = source.split_once(&format!("\npub trait {name}")).expect("the trait stands here");
        let (body, _) = body.split_once("\n}").expect("the trait ends");
        let lines = body.lines().filter_map(|line| line.strip_prefix("    fn "));
        lines.filter_map(|line| line.split_once('(')).map(|(method, _)| method).collect()
    }

    /// The lint makes the probe answer for a method that is new; this, that it is tried on wrappers.
    #[test]
    fn every_method_is_tried() {
        let (_, tried) =
            include_str!("probe.rs").split_once("pub fn forwards_everything").expect("it is here");
        let (tried, _) = tried.split_once("\n}").expect("it ends");
        let tried: String = tried.split_whitespace().collect();
        let model = methods(include_str!("../forward.rs"), "ForwardModel");
        let state = methods(include_str!("../state.rs"), "DeviceState");
        assert!(model.contains(&"start") && state.contains(&"step"), "{model:?} {state:?}");
        for (of, methods) in [("wrapper", model), ("state", state)] {
            for method in methods {
                assert!(tried.contains(&format!("{of}.{method}(")), "`{method}` is not tried on a {of}");
            }
        }
    }
}
