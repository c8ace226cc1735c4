//! Effects that act as a device is stepped.

use std::sync::Arc;

use dermis_mechanics::Friction;
use dermis_model::Stimulus;
use dermis_skin::{Effect, ModelError, SkinDescription};

use super::EFFECTS;

/// What a device that was just switched on will do.
#[derive(Debug, Clone, Default)]
pub struct Dynamics {
    creep: Option<(f64, f64)>,
    shutter: Option<f64>,
    friction: Option<Friction>,
}

impl Dynamics {
    /// Those of the effects of `skin` that remember or take time.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] with the field `effects[i].…` that cannot be.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        Effect::check(&skin.effects, EFFECTS, &skin.name)?;
        let mut dynamics = Self::default();
        for effect in skin.effects.iter().filter(|e| e.strength > 0.0) {
            let Some(info) = EFFECTS.iter().find(|info| info.name == effect.name) else { continue };
            let value = |name: &str| info.value(effect, name);
            match info.name {
                "creep" => {
                    dynamics.creep = Some(((effect.strength * value("share")).min(1.0), value("time")));
                }
                "rolling-shutter" => dynamics.shutter = Some(effect.strength * value("duration")),
                "friction" => {
                    let coefficient = effect.strength * value("coefficient");
                    dynamics.friction = Some(Friction::new(coefficient, Arc::new(skin.surface())));
                }
                _ => {}
            }
        }
        Ok(dynamics)
    }

    /// Switches the device on. Nothing of it is drawn at random, so that every start is the same.
    #[must_use]
    pub fn start(&self, _: u64) -> Started {
        Started(self.clone())
    }
}

/// A device that was switched on.
#[derive(Debug, Clone)]
pub struct Started(Dynamics);

impl Started {
    /// Share of a displacement that creeps, and the time \[s\] that it takes.
    #[must_use]
    pub fn creep(&self) -> Option<(f64, f64)> {
        self.0.creep
    }

    /// \[s\] from the first row of a picture to the last, whose time is the frame's.
    #[must_use]
    pub fn shutter(&self) -> Option<f64> {
        self.0.shutter
    }

    /// Drags at tips that slide.
    pub fn drag(&mut self, time: f64, stimulus: &mut Stimulus) {
        if let Some(friction) = &mut self.0.friction {
            friction.drag(time, stimulus);
        }
    }
}
