//! Skins that differ from a description in one number.

use anyhow::{Result, bail};
use clap::ValueEnum;
use dermis_skin::{SkinDescription, SurfaceSpec};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// A number that a designer can choose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parameter {
    /// How deep the taxels lie below the surface.
    Depth,
    /// Thickness of the medium; the depth of the taxels stays.
    Thickness,
    /// Distance of the taxels; the surface grows with it.
    Pitch,
    /// Poisson's ratio of the medium.
    Poisson,
    /// Young's modulus of the medium.
    Modulus,
    /// Noise of every channel.
    Noise,
}

impl Parameter {
    /// For people, with the unit that figures use.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Depth => "depth of the taxels [mm]",
            Self::Thickness => "thickness [mm]",
            Self::Pitch => "distance of the taxels [mm]",
            Self::Poisson => "Poisson's ratio",
            Self::Modulus => "Young's modulus [kPa]",
            Self::Noise => "noise [unit of the skin]",
        }
    }

    /// As a subject of a sentence.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Thickness => "thickness",
            Self::Pitch => "pitch",
            Self::Poisson => "Poisson's ratio",
            Self::Modulus => "Young's modulus",
            Self::Noise => "noise",
        }
    }

    /// What [`label`](Self::label) shows of a value in SI units.
    #[must_use]
    pub fn shown(self, value: f64) -> f64 {
        match self {
            Self::Depth | Self::Thickness | Self::Pitch => value * 1e3,
            Self::Modulus => value * 1e-3,
            Self::Poisson | Self::Noise => value,
        }
    }

    /// Key of `medium` that holds it.
    fn key(self) -> Option<&'static str> {
        match self {
            Self::Thickness => Some("thickness"),
            Self::Poisson => Some("poisson_ratio"),
            Self::Modulus => Some("young_modulus"),
            Self::Depth | Self::Pitch | Self::Noise => None,
        }
    }

    /// Its value in a skin, in SI units (the noise in the unit of the skin).
    ///
    /// # Errors
    ///
    /// Where the skin has no such number.
    pub fn value(self, skin: &SkinDescription) -> Result<f64> {
        if let Some(key) = self.key() {
            let value = skin.medium.get(key).and_then(|v| v.as_float().or(v.as_integer().map(|i| i as f64)));
            let Some(value) = value else {
                bail!("skin `{}`: field `medium.{key}` is no number that could be varied", skin.name)
            };
            return Ok(value);
        }
        let surface = skin.surface();
        let points: Vec<Point3<f64>> = skin.taxels.iter().map(dermis_skin::Taxel::point).collect();
        let found = match self {
            Self::Depth => median(points.iter().map(|p| surface.distance(p)).collect()),
            Self::Noise => median(skin.channel_noise()),
            _ => median(nearest(&points)),
        };
        match found {
            Some(value) if value > 0.0 => Ok(value),
            _ => bail!("skin `{}`: its taxels have no {} that could be varied", skin.name, self.name()),
        }
    }

    /// The skin with this number `factor` times as large.
    ///
    /// # Errors
    ///
    /// Where the skin has no such number, or it cannot be varied.
    pub fn scaled(self, skin: &SkinDescription, factor: f64) -> Result<SkinDescription> {
        let mut varied = skin.clone();
        match self {
            Self::Depth => {
                let surface = skin.surface();
                for taxel in &mut varied.taxels {
                    let (foot, normal) = surface.project(&taxel.point());
                    taxel.position = (foot - normal * (surface.distance(&taxel.point()) * factor)).into();
                }
            }
            Self::Pitch => {
                let SurfaceSpec::Rectangle { size, spacing } = skin.surface else {
                    bail!("skin `{}`: the pitch of taxels can be varied on a flat surface only", skin.name)
                };
                varied.surface =
                    SurfaceSpec::Rectangle { size: size.map(|s| s * factor), spacing: spacing * factor };
                for taxel in &mut varied.taxels {
                    taxel.position[0] *= factor;
                    taxel.position[1] *= factor;
                }
            }
            Self::Noise => {
                // Channels have their noise filled in and cannot be changed from outside: by way of their file.
                let mut value = serde_json::to_value(skin)?;
                let scale = |value: &mut Value| {
                    if let Some(noise) = value.as_f64() {
                        *value = json!(noise * factor);
                    }
                };
                scale(&mut value["noise"]);
                for channel in value["channels"].as_array_mut().into_iter().flatten() {
                    scale(&mut channel["noise"]);
                }
                varied = serde_json::from_value(value)?;
            }
            Self::Thickness | Self::Poisson | Self::Modulus => {
                let value = self.value(skin)? * factor;
                if let Some(entry) = self.key().and_then(|key| varied.medium.get_mut(key)) {
                    *entry = value.into();
                }
            }
        }
        Ok(varied)
    }
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Distance of each point to the nearest other one.
fn nearest(points: &[Point3<f64>]) -> Vec<f64> {
    let to_others = |i: usize| {
        let others = points.iter().enumerate().filter(move |(j, _)| *j != i);
        others.map(|(_, p)| (p - points[i]).norm()).fold(f64::INFINITY, f64::min)
    };
    (0..points.len()).map(to_others).filter(|d| d.is_finite()).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn one_number_changes_and_the_rest_stays() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/skins/baro-grid.toml");
        let skin = SkinDescription::load(path).unwrap();
        let nominal = [0.005, 0.010, 0.0065, 0.49, 70e3, 20.0];
        let all = Parameter::value_variants();
        for (parameter, nominal) in all.iter().zip(nominal) {
            assert!((parameter.value(&skin).unwrap() / nominal - 1.0).abs() < 1e-9, "{parameter:?}");
            let varied = parameter.scaled(&skin, 0.8).unwrap();
            for (other, was) in all.iter().zip([0.005, 0.010, 0.0065, 0.49, 70e3, 20.0]) {
                let expected = if other == parameter { was * 0.8 } else { was };
                let found = other.value(&varied).unwrap();
                assert!((found / expected - 1.0).abs() < 1e-9, "{parameter:?} changed {other:?} to {found}");
            }
            assert_eq!(parameter.scaled(&skin, 1.0).unwrap().hash(), skin.hash(), "{parameter:?}");
        }
    }

    #[test]
    fn what_cannot_be_varied_is_said() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/skins/baro-grid.toml");
        let mut skin = SkinDescription::load(path).unwrap();
        skin.medium.remove("poisson_ratio");
        insta::assert_snapshot!(Parameter::Poisson.value(&skin).unwrap_err(), @"skin `baro-grid`: field `medium.poisson_ratio` is no number that could be varied");
        skin.surface = SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.001 };
        insta::assert_snapshot!(Parameter::Pitch.scaled(&skin, 0.9).unwrap_err(), @"skin `baro-grid`: the pitch of taxels can be varied on a flat surface only");
    }
}
