//! What a skin description says of one common effect.

use dermis_skin::{Effect, SkinDescription};

use super::{CommonEffect, CommonParameters, Refused};

/// Parameters of an effect on a skin, each of which has a name that there is and lies within its limits.
pub(crate) struct Settings<'a> {
    info: &'a CommonEffect,
    effect: &'a Effect,
    channels: Vec<String>,
    skin: &'a SkinDescription,
}

impl<'a> Settings<'a> {
    /// Checks names and limits.
    pub fn new(
        info: &'a CommonEffect,
        effect: &'a Effect,
        skin: &'a SkinDescription,
    ) -> Result<Self, Refused> {
        let channels = skin.channels().iter().map(|c| c.name.clone()).collect();
        let settings = Self { info, effect, channels, skin };
        for (name, value) in &effect.parameters {
            settings.check(name, *value).map_err(|reason| (name.clone(), reason))?;
        }
        Ok(settings)
    }

    fn check(&self, name: &str, value: f64) -> Result<(), String> {
        let named = self.info.named();
        if let Some(of) = named.iter().find(|p| p.name == name) {
            let [low, high] = of.limits;
            // Times and factors say by themselves what they must be.
            let bounded = low.is_finite() && high.is_finite();
            if bounded && !(low..=high).contains(&value) {
                let unit = if of.unit == "1" { "" } else { of.unit };
                return Err(format!("is {value} {unit} and must be {low} to {high}").replace("  ", " "));
            }
            return Ok(());
        }
        match self.info.parameters {
            CommonParameters::Channels | CommonParameters::ChannelsAnd(_) => {
                if self.channels.iter().all(|c| c != name) {
                    return Err(format!("is no channel of this skin; it has {}", self.channels.join(", ")));
                }
            }
            CommonParameters::Taxels => {
                if self.taxel(name).is_none() {
                    return Err("names a taxel and an axis, e.g. \"t0.x\"".to_owned());
                }
            }
            CommonParameters::Named(_) => {
                let names: Vec<&str> = named.iter().map(|p| p.name).collect();
                return Err(format!("is no parameter of {}; it has {}", self.info.name, names.join(", ")));
            }
        }
        Ok(())
    }

    /// Number of a taxel and of an axis, from a name like `t0.x`.
    fn taxel(&self, name: &str) -> Option<(usize, usize)> {
        let (taxel, axis) = name.rsplit_once('.')?;
        let axis = ["x", "y", "z"].iter().position(|a| *a == axis)?;
        Some((self.skin.taxels.iter().position(|t| t.name == taxel)?, axis))
    }

    /// The skin that the effect is on.
    pub fn skin(&self) -> &SkinDescription {
        self.skin
    }

    /// 0 is no effect, 1 the one that the parameters say.
    pub fn strength(&self) -> f64 {
        self.effect.strength
    }

    fn given(&self, name: &str) -> Option<f64> {
        self.effect.parameters.get(name).copied()
    }

    /// A parameter with a name of its own; typical where the file does not say it.
    pub fn value(&self, name: &str) -> f64 {
        let typical = || self.info.named().iter().find(|p| p.name == name).map_or(f64::NAN, |p| p.typical);
        self.given(name).unwrap_or_else(typical)
    }

    /// A parameter that is neutral at 0, times the strength.
    pub fn scaled(&self, name: &str) -> f64 {
        self.given(name).map_or(0.0, |value| self.strength() * value)
    }

    /// A time \[s\] that is neutral at 0, times the strength.
    pub fn duration(&self, name: &str) -> Result<f64, Refused> {
        let time = self.scaled(name);
        if time >= 0.0 {
            return Ok(time);
        }
        Err((name.to_owned(), format!("is {time} s and must be 0 or positive")))
    }

    /// A factor, as far from 1 as the strength says.
    pub fn factor(&self, name: &str) -> Result<f64, Refused> {
        let Some(value) = self.given(name) else { return Ok(1.0) };
        let factor = 1.0 + self.strength() * (value - 1.0);
        if factor > 0.0 {
            return Ok(factor);
        }
        Err((name.to_owned(), format!("is {value} and must be positive")))
    }

    /// One number a channel: `of` what the file says of it, `neutral` where it says nothing; `None` where all are neutral.
    pub fn channels(
        &self,
        neutral: f64,
        of: impl Fn(f64) -> Result<f64, String>,
    ) -> Result<Option<Vec<f64>>, Refused> {
        let mut values = vec![neutral; self.channels.len()];
        // A name of the effect's own comes before a channel of the same name.
        let own = |name: &str| self.info.named().iter().any(|p| p.name == name);
        for (value, name) in values.iter_mut().zip(&self.channels).filter(|(_, name)| !own(name)) {
            if let Some(given) = self.given(name) {
                *value = of(given).map_err(|reason| (name.clone(), reason))?;
            }
        }
        Ok(values.iter().any(|v| *v != neutral).then_some(values))
    }

    /// One number a channel that is neutral at 0, times the strength.
    pub fn scaled_channels(&self) -> Result<Option<Vec<f64>>, Refused> {
        self.channels(0.0, |value| Ok(self.strength() * value))
    }

    /// Taxel, axis and value, times the strength, of every parameter that is called after a taxel.
    pub fn taxels(&self) -> Vec<(usize, usize, f64)> {
        let of = |(name, value): (&String, &f64)| {
            let (taxel, axis) = self.taxel(name)?;
            Some((taxel, axis, self.strength() * value))
        };
        self.effect.parameters.iter().filter_map(of).collect()
    }
}
