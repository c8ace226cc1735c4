//! The model's output → named quantities in SI units.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// How a raw output becomes a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Link {
    /// `raw · scale + mean`.
    #[default]
    Linear,
    /// `1 / (1 + e^−(raw · scale + mean))`: a logit that becomes a probability.
    Logistic,
}

/// Held-out error up to a force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SigmaBin {
    /// \[N\] upper end of the bin; it begins where the bin before ends, the first at 0.
    pub up_to: f64,
    /// Held-out RMSE in the bin, in the unit of the output.
    pub sigma: f64,
}

/// One output, or a run of outputs that share a meaning (a force map).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputSpec {
    /// `position.x`, `position.y`, `position.z`, `force.x`, `force.y`, `force.z`, `force.normal`, `contact`
    /// (probability), or another name that the sensor's estimator knows.
    pub name: String,
    /// `m`, `N`, or `1` for a probability.
    pub unit: String,
    /// How many consecutive numbers it is.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub count: usize,
    /// Added after scaling, in `unit`.
    #[serde(default)]
    pub mean: f64,
    /// `unit` per unit of the raw output; not 0.
    #[serde(default = "unity")]
    pub scale: f64,
    /// How the raw output becomes a value.
    #[serde(default)]
    pub link: Link,
    /// Held-out RMSE, in `unit`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// Held-out RMSE by normal force, ascending; the last bin also holds for larger forces.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sigma_by_force: Vec<SigmaBin>,
}

fn one() -> usize {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_one(count: &usize) -> bool {
    *count == 1
}

fn unity() -> f64 {
    1.0
}

impl OutputSpec {
    /// One linear output with this de-normalisation (`unit`).
    #[must_use]
    pub fn new(name: impl Into<String>, unit: impl Into<String>, mean: f64, scale: f64) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            count: 1,
            mean,
            scale,
            link: Link::Linear,
            sigma: None,
            sigma_by_force: Vec::new(),
        }
    }

    /// Held-out RMSE at a normal force \[N\], in `unit`; `None` where the bundle names none.
    #[must_use]
    pub fn sigma_at(&self, force: f64) -> Option<f64> {
        self.sigma_by_force
            .iter()
            .find(|bin| force <= bin.up_to)
            .or(self.sigma_by_force.last())
            .map(|bin| bin.sigma)
            .or(self.sigma)
    }
}

/// Every output, in order. Serialised in the `[output]` table of a bundle's manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputConfig {
    /// In the order of the model's output.
    pub values: Vec<OutputSpec>,
}

impl OutputConfig {
    /// Of no model: what stands where there is none.
    #[must_use]
    pub fn none() -> Self {
        Self { values: Vec::new() }
    }

    /// Length of the model's output.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.iter().map(|v| v.count).fold(0, usize::saturating_add)
    }

    /// Whether there is no output: so where there is no model.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Says what is impossible.
    ///
    /// # Errors
    ///
    /// [`OutputError::Impossible`] names the field.
    pub fn validate(&self) -> Result<(), OutputError> {
        let wrong = |i: usize, field: &str, reason: String| {
            Err(OutputError::Impossible { field: format!("values[{i}].{field}"), reason })
        };
        if self.values.is_empty() {
            return Err(OutputError::Impossible {
                field: "values".into(),
                reason: "is empty: a model has at least one output".into(),
            });
        }
        let mut names = BTreeSet::new();
        for (i, value) in self.values.iter().enumerate() {
            if !names.insert(&value.name) {
                return wrong(i, "name", format!("\"{}\" is already taken", value.name));
            }
            let unit = match value.name.split('.').next() {
                Some("position") => Some("m"),
                Some("force") => Some("N"),
                Some("contact") => Some("1"),
                _ => None,
            };
            if let Some(unit) = unit
                && unit != value.unit
            {
                return wrong(
                    i,
                    "unit",
                    format!("is \"{}\" where `{}` is given in \"{unit}\"", value.unit, value.name),
                );
            }
            if value.count == 0 || value.count > 1 << 24 {
                return wrong(i, "count", format!("is {} and must be a sensible number", value.count));
            }
            if !value.mean.is_finite() {
                return wrong(i, "mean", "must be a finite number".into());
            }
            if !value.scale.is_normal() {
                return wrong(i, "scale", "must be a finite number other than 0".into());
            }
            if value.sigma.is_some_and(|s| !(s.is_finite() && s >= 0.0)) {
                return wrong(i, "sigma", "must be a number of at least 0".into());
            }
            let mut below = 0.0;
            for (j, bin) in value.sigma_by_force.iter().enumerate() {
                if !(bin.up_to.is_finite() && bin.up_to > below) {
                    return wrong(i, &format!("sigma_by_force[{j}].up_to"), "must ascend from 0".into());
                }
                if !(bin.sigma.is_finite() && bin.sigma >= 0.0) {
                    return wrong(
                        i,
                        &format!("sigma_by_force[{j}].sigma"),
                        "must be a number of at least 0".into(),
                    );
                }
                below = bin.up_to;
            }
        }
        Ok(())
    }
}

/// An output that cannot be read, or a configuration of outputs that cannot be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The configuration contradicts itself.
    #[error("field `{field}`: {reason}")]
    Impossible {
        /// Path of the field below `[output]`.
        field: String,
        /// Why it cannot be, and what would be right.
        reason: String,
    },
    /// The model gave another number of values than the bundle names.
    #[error("the model gave {got} numbers where its bundle names {expected}")]
    Length {
        /// Numbers that came.
        got: usize,
        /// Numbers that the bundle names.
        expected: usize,
    },
    /// The model gave NaN or infinity.
    #[error("the model's output `{name}` is not a finite number; its bundle is unusable for this input")]
    NotFinite {
        /// Name of the output.
        name: String,
    },
}

/// Reads the model's output by name.
#[derive(Debug, Clone)]
pub struct Outputs {
    config: OutputConfig,
    values: Vec<f64>,
    position: Option<[usize; 3]>,
    force: Option<[usize; 3]>,
    normal: Option<usize>,
    contact: Option<usize>,
}

impl Outputs {
    /// Ready to decode; every value is 0 before.
    ///
    /// # Errors
    ///
    /// As [`OutputConfig::validate`].
    pub fn new(config: OutputConfig) -> Result<Self, OutputError> {
        config.validate()?;
        Ok(Self::of_valid(config))
    }

    /// Of what is no learned model: there is nothing to decode.
    #[must_use]
    pub fn none() -> Self {
        Self::of_valid(OutputConfig::none())
    }

    pub(crate) fn of_valid(config: OutputConfig) -> Self {
        let at = |name: &str| offset(&config, name).map(|(start, _)| start);
        let three = |stem: &str| {
            Some([at(&format!("{stem}.x"))?, at(&format!("{stem}.y"))?, at(&format!("{stem}.z"))?])
        };
        Self {
            position: three("position"),
            force: three("force"),
            normal: at("force.normal"),
            contact: at("contact"),
            values: vec![0.0; config.len()],
            config,
        }
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &OutputConfig {
        &self.config
    }

    /// Takes the model's output.
    ///
    /// # Errors
    ///
    /// [`OutputError::Length`] and [`OutputError::NotFinite`]; the values before stay.
    pub fn decode(&mut self, raw: &[f32]) -> Result<(), OutputError> {
        if raw.len() != self.values.len() {
            return Err(OutputError::Length { got: raw.len(), expected: self.values.len() });
        }
        let mut at = 0;
        for spec in &self.config.values {
            if raw[at..at + spec.count].iter().any(|v| !v.is_finite()) {
                return Err(OutputError::NotFinite { name: spec.name.clone() });
            }
            at += spec.count;
        }
        let mut at = 0;
        for spec in &self.config.values {
            for (value, raw) in self.values[at..at + spec.count].iter_mut().zip(&raw[at..]) {
                let linear = f64::from(*raw) * spec.scale + spec.mean;
                *value = match spec.link {
                    Link::Linear => linear,
                    Link::Logistic => 1.0 / (1.0 + (-linear).exp()),
                };
            }
            at += spec.count;
        }
        Ok(())
    }

    /// Undoes [`decode`](Self::decode) for one output: the raw number that a value (in its unit) has. For
    /// training targets. `None` for an unknown name.
    #[must_use]
    pub fn encode(&self, name: &str, value: f64) -> Option<f32> {
        let spec = self.config.values.iter().find(|s| s.name == name)?;
        let linear = match spec.link {
            Link::Linear => value,
            Link::Logistic => (value / (1.0 - value)).ln(),
        };
        Some(((linear - spec.mean) / spec.scale) as f32)
    }

    /// Every value, in order and in the units of the configuration.
    #[must_use]
    pub fn all(&self) -> &[f64] {
        &self.values
    }

    /// The values of one output, in its unit.
    #[must_use]
    pub fn values(&self, name: &str) -> Option<&[f64]> {
        let (start, count) = offset(&self.config, name)?;
        self.values.get(start..start + count)
    }

    /// The (first) value of one output, in its unit.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values(name)?.first().copied()
    }

    /// \[m\] where the contact is, in the frame of the skin's link.
    #[must_use]
    pub fn position(&self) -> Option<[f64; 3]> {
        self.position.map(|at| at.map(|i| self.values[i]))
    }

    /// \[N\] that the environment exerts on the skin, in the frame of the skin's link.
    #[must_use]
    pub fn force(&self) -> Option<[f64; 3]> {
        self.force.map(|at| at.map(|i| self.values[i]))
    }

    /// \[N\] pressing force; positive when pushed in.
    #[must_use]
    pub fn normal_force(&self) -> Option<f64> {
        self.normal.map(|i| self.values[i])
    }

    /// Probability that something touches the skin.
    #[must_use]
    pub fn contact(&self) -> Option<f64> {
        self.contact.map(|i| self.values[i])
    }

    /// Held-out RMSE of one output at a normal force \[N\], in its unit.
    #[must_use]
    pub fn sigma(&self, name: &str, force: f64) -> Option<f64> {
        self.config.values.iter().find(|s| s.name == name)?.sigma_at(force)
    }
}

fn offset(config: &OutputConfig, name: &str) -> Option<(usize, usize)> {
    let mut at = 0;
    for spec in &config.values {
        if spec.name == name {
            return Some((at, spec.count));
        }
        at += spec.count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> OutputConfig {
        let mut force = OutputSpec::new("force.normal", "N", 2.0, 3.0);
        force.sigma = Some(0.5);
        force.sigma_by_force = vec![SigmaBin { up_to: 1.0, sigma: 0.1 }, SigmaBin { up_to: 5.0, sigma: 0.4 }];
        let mut contact = OutputSpec::new("contact", "1", 0.0, 1.0);
        contact.link = Link::Logistic;
        let mut map = OutputSpec::new("map.normal", "N", 0.0, 2.0);
        map.count = 2;
        OutputConfig {
            values: vec![
                OutputSpec::new("position.x", "m", 0.01, 0.001),
                OutputSpec::new("position.y", "m", 0.0, 0.001),
                OutputSpec::new("position.z", "m", 0.0, 0.001),
                map,
                force,
                contact,
            ],
        }
    }

    #[test]
    fn values_are_named_and_in_si() {
        let mut outputs = Outputs::new(config()).unwrap();
        outputs.decode(&[2.0, -1.0, 0.0, 3.0, 4.0, 1.0, 0.0]).unwrap();
        let position = outputs.position().unwrap();
        assert!((position[0] - 0.012).abs() < 1e-12 && (position[1] + 0.001).abs() < 1e-12);
        assert_eq!(outputs.values("map.normal"), Some(&[6.0, 8.0][..]));
        assert_eq!(outputs.normal_force(), Some(5.0));
        assert_eq!(outputs.contact(), Some(0.5));
        assert_eq!(outputs.force(), None);
        assert_eq!(outputs.get("force.x"), None);
    }

    #[test]
    fn encode_undoes_decode() {
        let mut outputs = Outputs::new(config()).unwrap();
        let raw = [2.0, -1.0, 0.5, 3.0, 4.0, 1.0, -0.7];
        outputs.decode(&raw).unwrap();
        for (name, i) in [("position.x", 0), ("force.normal", 5), ("contact", 6)] {
            let back = outputs.encode(name, outputs.get(name).unwrap()).unwrap();
            assert!((back - raw[i]).abs() < 1e-5, "{name}: {back}");
        }
    }

    #[test]
    fn sigma_follows_the_force() {
        let outputs = Outputs::new(config()).unwrap();
        assert_eq!(outputs.sigma("force.normal", 0.5), Some(0.1));
        assert_eq!(outputs.sigma("force.normal", 3.0), Some(0.4));
        assert_eq!(outputs.sigma("force.normal", 50.0), Some(0.4));
        assert_eq!(outputs.sigma("position.x", 1.0), None);
    }

    #[test]
    fn bad_outputs_are_refused_whole() {
        let mut outputs = Outputs::new(config()).unwrap();
        outputs.decode(&[0.0; 7]).unwrap();
        let before = outputs.all().to_vec();
        assert!(matches!(outputs.decode(&[1.0; 3]), Err(OutputError::Length { got: 3, expected: 7 })));
        let nan = [1.0, 1.0, 1.0, 1.0, 1.0, f32::NAN, 1.0];
        assert_eq!(outputs.decode(&nan), Err(OutputError::NotFinite { name: "force.normal".into() }));
        assert_eq!(outputs.all(), before);
    }

    #[test]
    fn refusals_name_the_field() {
        let refused = |change: fn(&mut OutputConfig)| {
            let mut c = config();
            change(&mut c);
            c.validate().unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused(|c| c.values[0].unit = "mm".into()), @r#"field `values[0].unit`: is "mm" where `position.x` is given in "m""#);
        insta::assert_snapshot!(refused(|c| c.values[1].name = "position.x".into()), @r#"field `values[1].name`: "position.x" is already taken"#);
        insta::assert_snapshot!(refused(|c| c.values[4].sigma_by_force[1].up_to = 0.5), @"field `values[4].sigma_by_force[1].up_to`: must ascend from 0");
        insta::assert_snapshot!(refused(|c| c.values.clear()), @"field `values`: is empty: a model has at least one output");
    }
}
