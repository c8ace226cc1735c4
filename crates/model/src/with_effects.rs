//! A family's model with the effects that every skin can have.
//!
//! Each effect acts once, where it acts in the device: the rig says what touches, the family's model and what its medium and
//! transducers remember answer, and what they answer goes through the acts of transducers and electronics in the order of
//! [`Stage`], those of one stage in the order of [`COMMON`](crate::COMMON).

use std::sync::Arc;

use dermis_skin::{Image, ModelError, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};

use crate::effects::{
    Act, Circumstances, NEUTRAL_TEMPERATURE, ReadingAct, RigAct, Settings, Stage, Starts, StatefulAct,
    common_effect,
};
use crate::wrapper::Wrapper;
use crate::{COMMON, DeviceState, ForwardModel, Indentation, Stimulus, Tip, TipShape};

/// The forward model of a skin whose description may switch common effects on; `make` builds the family's.
///
/// # Errors
///
/// [`ModelError::Description`] names the effect and parameter that cannot be; what `make` says.
pub fn device<E: From<ModelError>>(
    skin: &SkinDescription,
    make: impl FnOnce(&SkinDescription) -> Result<Arc<dyn ForwardModel>, E>,
) -> Result<Arc<dyn ForwardModel>, E> {
    if !skin.effects.iter().any(|e| common_effect(&e.name).is_some()) {
        return make(skin);
    }
    let mut inner = skin.clone();
    inner.effects.retain(|e| common_effect(&e.name).is_none());
    let effects = CommonEffects::new(skin, &mut inner)?;
    let model = make(&inner)?;
    if effects.rig.is_empty() && effects.acts.is_empty() {
        return Ok(model);
    }
    Ok(Arc::new(WithCommonEffects { model, effects }))
}

/// The common effects of a device.
struct CommonEffects {
    rig: Vec<Arc<dyn RigAct>>,
    /// In the order of the signal.
    acts: Vec<OnReadings>,
}

/// What an effect does to readings.
enum OnReadings {
    Reading(Box<dyn ReadingAct>),
    Remembers(Box<dyn Starts>),
}

impl CommonEffects {
    /// Those of `skin`; what changes its design is done to `inner`.
    fn new(skin: &SkinDescription, inner: &mut SkinDescription) -> Result<Self, ModelError> {
        let mut rig = Vec::new();
        let mut acts: Vec<(Stage, OnReadings)> = Vec::new();
        for info in COMMON {
            let Some((i, effect)) = skin.effects.iter().enumerate().find(|(_, e)| e.name == info.name) else {
                continue;
            };
            let found = Settings::new(info, effect, skin).and_then(|settings| (info.acts)(&settings));
            let found = found.map_err(|(name, reason)| ModelError::Description {
                skin: skin.name.clone(),
                field: format!("effects[{i}].{name}"),
                reason,
            })?;
            for act in found {
                match act {
                    Act::Design(change) => change(inner),
                    Act::Rig(act) => rig.push(act),
                    Act::Reading(stage, act) => acts.push((stage, OnReadings::Reading(act))),
                    Act::Remembers(stage, act) => acts.push((stage, OnReadings::Remembers(act))),
                }
            }
        }
        // Stable: those of one stage stay in the order of the table.
        acts.sort_by_key(|(stage, _)| *stage);
        Ok(Self { rig, acts: acts.into_iter().map(|(_, act)| act).collect() })
    }

    /// What really touches where the rig says this.
    fn real(&self, stimulus: &Stimulus, surface: &Surface) -> Stimulus {
        let mut real = stimulus.clone();
        for contact in &mut real.contacts {
            self.rig.iter().for_each(|act| act.real(contact, surface));
        }
        real
    }

    /// Position and diameter of a spherical tip, really, where the rig says these.
    fn real_tip(&self, at: &Point3<f64>, tip: &TipShape, surface: &Surface) -> (Point3<f64>, TipShape) {
        let tip = Tip::standing(*tip, &surface.project(at).1);
        let mut contact = Indentation { position: *at, force: Vector3::zeros(), tip };
        self.rig.iter().for_each(|act| act.real(&mut contact, surface));
        (contact.position, contact.tip.shape)
    }
}

/// A family's model and the common effects of its device.
struct WithCommonEffects {
    model: Arc<dyn ForwardModel>,
    effects: CommonEffects,
}

impl Wrapper for WithCommonEffects {
    const CHANGES_RESPONSE: bool = true;

    fn inner(&self) -> &dyn ForwardModel {
        self.model.as_ref()
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        if self.effects.rig.is_empty() {
            self.model.response(stimulus, out)?;
        } else {
            self.model.response(&self.effects.real(stimulus, self.model.surface()), out)?;
        }
        let warmer = stimulus.temperature - NEUTRAL_TEMPERATURE;
        for act in &self.effects.acts {
            if let OnReadings::Reading(act) = act {
                act.apply(warmer, out);
            }
        }
        Ok(())
    }

    fn remembers(&self) -> bool {
        self.model.remembers() || self.effects.acts.iter().any(|act| matches!(act, OnReadings::Remembers(_)))
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        let acts = self.effects.acts.iter().map(|act| match act {
            OnReadings::Reading(act) => ActState::Reading(act.as_ref()),
            OnReadings::Remembers(act) => ActState::Remembers(act.start()),
        });
        Box::new(CommonEffectsState { inner: self.model.start(seed), device: self, acts: acts.collect() })
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        self.model.displacement(&self.effects.real(stimulus, self.model.surface()), out)
    }

    /// Of what the rig really does. Effects of electronics act on numbers, not on pixels.
    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.model.capture(&self.effects.real(stimulus, self.model.surface()), noise)
    }

    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        Wrapper::force_of_tip(self, at, &TipShape::Sphere { diameter }, depth)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Wrapper::depth_of_tip(self, at, &TipShape::Sphere { diameter }, force)
    }

    /// As the rig states the force: [`response`](Self::response) takes its scale and zero into account.
    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        let (at, tip) = self.effects.real_tip(at, tip, self.model.surface());
        let real = self.model.force_of_tip(&at, &tip, depth)?;
        let stated = self.effects.rig.iter().rev().fold(real, |force, act| act.stated_force(force));
        (stated >= 0.0).then_some(stated)
    }

    fn depth_of_tip(&self, at: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        let (at, tip) = self.effects.real_tip(at, tip, self.model.surface());
        let real = self.effects.rig.iter().fold(force, |force, act| act.real_force(force)).max(0.0);
        self.model.depth_of_tip(&at, &tip, real)
    }
}

/// An act of a device that is switched on.
enum ActState<'a> {
    Reading(&'a dyn ReadingAct),
    Remembers(Box<dyn StatefulAct>),
}

/// A device with common effects from when it was switched on.
struct CommonEffectsState<'a> {
    inner: Box<dyn DeviceState + 'a>,
    device: &'a WithCommonEffects,
    acts: Vec<ActState<'a>>,
}

#[deny(clippy::missing_trait_methods)]
impl DeviceState for CommonEffectsState<'_> {
    /// What the family says; the rig's error stays out of it, because what is left is what the rig's force cell measures.
    fn apply_to_stimulus(&mut self, time: f64, stimulus: &mut Stimulus) {
        self.inner.apply_to_stimulus(time, stimulus);
    }

    fn step(&mut self, time: f64, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        let effects = &self.device.effects;
        if effects.rig.is_empty() {
            self.inner.step(time, stimulus, out)?;
        } else {
            self.inner.step(time, &effects.real(stimulus, self.device.model.surface()), out)?;
        }
        let warmer = stimulus.temperature - NEUTRAL_TEMPERATURE;
        let now = Circumstances { time, touched: !stimulus.contacts.is_empty() };
        for act in &mut self.acts {
            match act {
                ActState::Reading(act) => act.apply(warmer, out),
                ActState::Remembers(act) => act.apply(&now, out),
            }
        }
        Ok(())
    }

    fn capture(
        &mut self,
        time: f64,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let effects = &self.device.effects;
        if effects.rig.is_empty() {
            return self.inner.capture(time, stimulus, noise);
        }
        self.inner.capture(time, &effects.real(stimulus, self.device.model.surface()), noise)
    }

    fn quantize(&mut self, readings: &mut [f64]) {
        self.inner.quantize(readings);
    }
}
