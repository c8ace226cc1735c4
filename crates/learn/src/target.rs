//! What a model learns to answer: scalars of one contact, and maps over the surface.
//!
//! | name | numbers | what it is |
//! |---|---|---|
//! | `position.x` …, `force.x` …, `force.normal`, `contact` | 1 | of the only contact; see [`Truth::value`] |
//! | `map.normal` | one a surface point | \[N\] pressing force that acts on the point, positive when pushed in |
//! | `map.force` | three a surface point | \[N\] force on the point, in the frame of the skin's link |
//! | `map.displacement` | one a surface point | \[m\] how far the point gives way, inwards along its normal |
//! | `signal` | one a channel | in the unit of the skin: what the forward model reads for the true contacts, minus its untouched readings |
//!
//! Maps are computed from the ground truth of a frame when it is needed, for any number of contacts, and are not recorded.
//! A force is spread over its contact patch: a point gets the share of its area, weighted by the pressure that Hertz (1882)
//! gives for a sphere, √(1 − r²/a²), so that the points sum to the force. The radius a = √(R d) of the patch follows from the
//! depth d to which the forward model lets the tip of radius R sink in; without a forward model the patch is taken to be
//! half as wide as the tip. A flat tip presses evenly on its whole face. Where the patch is so small that no point lies in it, the nearest point gets the force.
//! That is what acts; what a network learns best may be smoother ([`ForceProfile`]).
//! Displacements are those of the forward model. A network that learns the signal from readings of a device takes away what the device
//! has and its model lacks (a transfer network, thesis section 4.3.1): what was trained on the model can then work on the device.
//!
//! Cost: a force map visits every point of the surface once a contact; a displacement map is one call of the model.

use std::borrow::Cow;
use std::sync::Arc;

use dermis_inference::MAP_DISPLACEMENT;
/// Pressing forces over the surface, and what the forward model reads.
pub use dermis_inference::{MAP_NORMAL, SIGNAL};
use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::{SkinDescription, Surface};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::bounds::stimulus;
use crate::dataset::{Truth, TruthContact};

/// Forces over the surface.
pub const MAP_FORCE: &str = "map.force";

/// What a training configuration can name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// One of [`Truth::TARGETS`].
    Scalar(&'static str),
    /// One number, or one vector, a point of the surface.
    Map(MapTarget),
}

/// A quantity that every point of the surface has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapTarget {
    /// [`MAP_NORMAL`].
    Normal,
    /// [`MAP_FORCE`].
    Force,
    /// [`MAP_DISPLACEMENT`].
    Displacement,
    /// [`SIGNAL`], over the channels in place of the points.
    Signal,
}

impl MapTarget {
    /// Every one.
    pub const ALL: [Self; 4] = [Self::Normal, Self::Force, Self::Displacement, Self::Signal];

    /// What configurations and bundles call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => MAP_NORMAL,
            Self::Force => MAP_FORCE,
            Self::Displacement => MAP_DISPLACEMENT,
            Self::Signal => SIGNAL,
        }
    }

    /// Numbers a point, or a channel.
    #[must_use]
    pub fn per_point(self) -> usize {
        if self == Self::Force { 3 } else { 1 }
    }

    /// Whether it tells forces on points.
    #[must_use]
    pub fn is_force(self) -> bool {
        matches!(self, Self::Normal | Self::Force)
    }

    /// Whether it is computed by a forward model.
    #[must_use]
    pub fn needs_model(self) -> bool {
        matches!(self, Self::Displacement | Self::Signal)
    }
}

impl Target {
    /// What is called so.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        let scalar = Truth::TARGETS.into_iter().find(|t| *t == name).map(Self::Scalar);
        scalar.or_else(|| MapTarget::ALL.into_iter().find(|m| m.name() == name).map(Self::Map))
    }

    /// What it is called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar(name) => name,
            Self::Map(map) => map.name(),
        }
    }

    /// Every name.
    pub fn names() -> impl Iterator<Item = &'static str> {
        Truth::TARGETS.into_iter().chain(MapTarget::ALL.into_iter().map(MapTarget::name))
    }
}

/// How the force of a ball is spread over the points around a contact, x \[m\] from them (thesis, section 6.4.2, equations 6.1 to 6.4; σ is
/// the ball's radius). A flat tip presses evenly on its whole face, whatever is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForceProfile {
    /// Hertz' pressure over the patch that the ball touches at its depth.
    #[default]
    Patch,
    /// The same up to σ (equation 6.4).
    Uniform,
    /// Hertz' pressure up to σ, √(1 − x²/σ²) (equation 6.1).
    Hertz,
    /// exp(−x²/(0.8 σ²)) up to 2σ (equation 6.3).
    Gaussian,
    /// exp(−x/(0.87 σ)) up to 2σ (equation 6.2), as high as Hertz'.
    Laplacian1,
    /// exp(−x/(0.5 σ)) up to 2σ (equation 6.2).
    Laplacian2,
}

impl ForceProfile {
    /// Every one.
    pub const ALL: [Self; 6] =
        [Self::Patch, Self::Uniform, Self::Hertz, Self::Gaussian, Self::Laplacian1, Self::Laplacian2];

    /// Whether it is what acts, as far as Hertz knows.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Makes maps of what was true.
pub struct Maps {
    surface: Surface,
    profile: ForceProfile,
    model: Option<Arc<dyn ForwardModel>>,
    displacement: Vec<f64>,
    /// Whether the forward model knows displacements, once it was evaluated.
    displaces: Option<bool>,
    /// What the channels read where nothing touches, once the forward model was evaluated.
    untouched: Option<Vec<f64>>,
    channels: usize,
    /// Of the skin.
    unit: String,
}

impl Maps {
    /// Maps over the surface of a skin. Without a forward model there are no displacements.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where one of `wanted` needs a forward model and there is none.
    pub fn new(
        skin: &SkinDescription,
        model: Option<Arc<dyn ForwardModel>>,
        wanted: &[MapTarget],
    ) -> Result<Self, LearnError> {
        if let Some(map) = wanted.iter().find(|map| map.needs_model())
            && model.is_none()
        {
            return Err(LearnError::Training {
                reason: format!(
                    "target `{}` needs the forward model of skin `{}`: train with `dermis train`, which knows \
                     the models of its sensors, or leave the target out",
                    map.name(),
                    skin.name
                ),
            });
        }
        let surface = skin.surface();
        Ok(Self {
            displacement: vec![0.0; surface.points.len()],
            displaces: None,
            untouched: None,
            channels: skin.channels().len(),
            unit: skin.unit.clone(),
            surface,
            profile: ForceProfile::default(),
            model,
        })
    }

    /// Spreads forces like this.
    #[must_use]
    pub fn spread_by(self, profile: ForceProfile) -> Self {
        Self { profile, ..self }
    }

    /// What maps lie over.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// \[N\] pressing forces of a map of forces, one a point; the map itself where it has one number a point.
    #[must_use]
    pub fn pressing<'a>(&self, map: MapTarget, values: &'a [f64]) -> Cow<'a, [f64]> {
        if map.per_point() == 1 {
            return Cow::Borrowed(values);
        }
        let normals = &self.surface.normals;
        let vectors = values.chunks_exact(map.per_point()).map(|f| Vector3::new(f[0], f[1], f[2]));
        Cow::Owned(vectors.zip(normals).map(|(force, normal)| -force.dot(normal)).collect())
    }

    /// Numbers of a map.
    #[must_use]
    pub fn len(&self, map: MapTarget) -> usize {
        if map == MapTarget::Signal { self.channels } else { map.per_point() * self.surface.points.len() }
    }

    /// Unit of a map's numbers.
    #[must_use]
    pub fn unit(&self, map: MapTarget) -> &str {
        match map {
            MapTarget::Normal | MapTarget::Force => "N",
            MapTarget::Displacement => "m",
            MapTarget::Signal => &self.unit,
        }
    }

    /// Whether a map can be computed at all: displacements need a forward model that knows them, the signal one of as many channels.
    #[must_use]
    pub fn knows(&mut self, map: MapTarget) -> bool {
        if map == MapTarget::Signal {
            return self.model.as_ref().is_some_and(|model| model.channels() == self.channels);
        }
        map != MapTarget::Displacement
            || *self.displaces.get_or_insert_with(|| {
                let model = self.model.as_ref();
                let answer = model.map(|m| m.displacement(&Stimulus::default(), &mut self.displacement));
                matches!(answer, Some(Ok(true)))
            })
    }

    /// Whether the ground truth of a frame tells its maps: place, force and diameter of every contact are known.
    #[must_use]
    pub fn tells(truth: &Truth) -> bool {
        stimulus(truth).is_some()
    }

    /// Appends a map in SI units; NaN throughout where the ground truth does not tell it.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the forward model knows no displacements, or refuses the contacts.
    pub fn append(&mut self, map: MapTarget, truth: &Truth, out: &mut Vec<f64>) -> Result<(), LearnError> {
        let start = out.len();
        out.resize(start + self.len(map), 0.0);
        let Some(mut stimulus) = stimulus(truth) else {
            out[start..].fill(f64::NAN);
            return Ok(());
        };
        if map.needs_model() {
            // A force cell's noise pulls at the skin now and then, which no forward model knows.
            let normals = truth.contacts.iter().map(|c| c.normal);
            let all = stimulus.contacts.into_iter().zip(normals);
            stimulus.contacts = all.filter(|(c, normal)| c.force.dot(normal) < 0.0).map(|(c, _)| c).collect();
        }
        if stimulus.contacts.is_empty() {
            return Ok(());
        }
        if map == MapTarget::Signal {
            return self.signal(&stimulus, &mut out[start..]);
        }
        if map == MapTarget::Displacement {
            self.displaced(&stimulus)?;
            out[start..].copy_from_slice(&self.displacement);
            return Ok(());
        }
        for (pressed, truth) in stimulus.contacts.iter().zip(&truth.contacts) {
            let depth = self.model.as_ref().and_then(|model| {
                let force = -pressed.force.dot(&truth.normal);
                model.depth_of_tip(&pressed.position, &pressed.tip.shape, force)
            });
            let patch = Patch::of(truth, depth, self.profile);
            for (i, share) in shares(&self.surface, &pressed.position, patch) {
                let force: Vector3<f64> = pressed.force * share;
                match map {
                    MapTarget::Normal => out[start + i] -= force.dot(&self.surface.normals[i]),
                    MapTarget::Force | MapTarget::Displacement | MapTarget::Signal => {
                        let at = start + 3 * i;
                        out[at..at + 3].iter_mut().zip(&force).for_each(|(o, f)| *o += f);
                    }
                }
            }
        }
        Ok(())
    }

    /// Computes what the model reads.
    fn signal(&mut self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), LearnError> {
        let failed = |reason: String| LearnError::Training { reason: format!("target `{SIGNAL}`: {reason}") };
        let model = self.model.as_ref().ok_or_else(|| failed("there is no forward model".into()))?;
        if model.channels() != out.len() {
            let (has, skin) = (model.channels(), out.len());
            return Err(failed(format!("the forward model has {has} channels and the skin {skin}")));
        }
        let rest = match &mut self.untouched {
            Some(rest) => rest,
            none => {
                let mut rest = vec![0.0; out.len()];
                model.untouched(&mut rest).map_err(|e| failed(e.to_string()))?;
                none.insert(rest)
            }
        };
        model.response(stimulus, out).map_err(|e| failed(e.to_string()))?;
        out.iter_mut().zip(rest).for_each(|(value, rest)| *value -= *rest);
        Ok(())
    }

    /// Computes how far the surface gives way.
    fn displaced(&mut self, stimulus: &Stimulus) -> Result<(), LearnError> {
        let failed = |reason: String| LearnError::Training {
            reason: format!("target `{MAP_DISPLACEMENT}`: {reason}"),
        };
        let model = self.model.as_ref().ok_or_else(|| failed("there is no forward model".into()))?;
        match model.displacement(stimulus, &mut self.displacement) {
            Ok(true) => Ok(()),
            Ok(false) => Err(failed(
                "the forward model of this skin knows no displacements; leave the target out".into(),
            )),
            Err(error) => Err(failed(error.to_string())),
        }
    }
}

/// Where a tip presses.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Patch {
    /// \[m\] beyond which nothing acts.
    radius: f64,
    pressure: Pressure,
}

/// Pressure by distance, but for a factor.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pressure {
    Even,
    /// √(1 − x²/r²), r the patch's radius.
    Hertz,
    /// exp(−x²/a), a in m².
    Gaussian(f64),
    /// exp(−x/λ), λ in m.
    Exponential(f64),
}

impl Patch {
    /// The patch of a tip that has sunk in so deep \[m\].
    fn of(contact: &TruthContact, depth: Option<f64>, profile: ForceProfile) -> Self {
        let tip = contact.diameter / 2.0;
        let (radius, pressure) = match profile {
            _ if contact.flat => (tip, Pressure::Even),
            ForceProfile::Patch => match depth.filter(|d| *d > 0.0) {
                Some(depth) => ((tip * depth).sqrt().min(tip), Pressure::Hertz),
                None => (tip / 2.0, Pressure::Hertz),
            },
            ForceProfile::Uniform => (tip, Pressure::Even),
            ForceProfile::Hertz => (tip, Pressure::Hertz),
            ForceProfile::Gaussian => (2.0 * tip, Pressure::Gaussian(0.8 * tip * tip)),
            ForceProfile::Laplacian1 => (2.0 * tip, Pressure::Exponential(0.87 * tip)),
            ForceProfile::Laplacian2 => (2.0 * tip, Pressure::Exponential(0.5 * tip)),
        };
        Self { radius, pressure }
    }

    fn at(&self, distance: f64) -> f64 {
        match self.pressure {
            Pressure::Even => 1.0,
            Pressure::Hertz => (1.0 - (distance / self.radius).powi(2)).sqrt(),
            Pressure::Gaussian(width) => (-distance * distance / width).exp(),
            Pressure::Exponential(length) => (-distance / length).exp(),
        }
    }
}

/// Points of a surface on which a contact at `at` acts, and what share of its force each of them gets; the shares sum to 1.
fn shares(surface: &Surface, at: &Point3<f64>, patch: Patch) -> Vec<(usize, f64)> {
    let within = |(i, point): (usize, &Point3<f64>)| {
        let distance = (point - at).norm();
        (distance < patch.radius).then(|| (i, patch.at(distance) * surface.areas[i]))
    };
    let mut found: Vec<(usize, f64)> = surface.points.iter().enumerate().filter_map(within).collect();
    let total: f64 = found.iter().map(|(_, share)| share).sum();
    if total > 0.0 {
        found.iter_mut().for_each(|(_, share)| *share /= total);
        return found;
    }
    let distance = |i: &usize| (surface.points[*i] - at).norm();
    let nearest = (0..surface.points.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    nearest.map(|i| (i, 1.0)).into_iter().collect()
}

#[cfg(test)]
mod tests;
