//! Effects that act as a device is stepped.

use dermis_mechanics::{RandomWalk, stream};
use dermis_skin::{Effect, ModelError, SkinDescription};

use super::EFFECTS;

/// What a device that was just switched on will do.
#[derive(Debug, Clone, Default)]
pub struct Dynamics {
    drift: Option<RandomWalk>,
    scan: Option<f64>,
}

impl Dynamics {
    /// Those of the effects of `skin` that drift or take time.
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
                "fabric-drift" => {
                    let rate = effect.strength * value("rate") / 3600f64.sqrt();
                    dynamics.drift = Some(RandomWalk::new(rate, stream(effect, 0)));
                }
                "scan-skew" => dynamics.scan = Some(effect.strength * value("duration")),
                _ => {}
            }
        }
        Ok(dynamics)
    }

    /// Switches the device on.
    #[must_use]
    pub fn start(&self, seed: u64) -> Started {
        Started { drift: self.drift.as_ref().map(|drift| drift.restarted(seed)), scan: self.scan }
    }
}

/// What drifts from when a device was switched on.
#[derive(Debug, Clone)]
pub struct Started {
    drift: Option<RandomWalk>,
    scan: Option<f64>,
}

impl Started {
    /// Factor of the sheets' resistance, `dt` \[s\] after the last call.
    pub fn fabric(&mut self, dt: f64) -> f64 {
        self.drift.as_mut().map_or(1.0, |drift| drift.next(dt).exp())
    }

    /// \[s\] that a frame takes from its first injection to its stamp.
    #[must_use]
    pub fn scan(&self) -> Option<f64> {
        self.scan
    }
}
