//! What is trained, and how.

mod checks;

use std::path::{Path, PathBuf};

use dermis_inference::{Baseline, FeatureConfig, Missing, Taps};
use dermis_regress::dense::Activation;
use dermis_skin::ImageGrid;
use serde::{Deserialize, Serialize};

use super::candidates::{self, ModelChoice};
use super::image::ImageConfig;
use crate::dataset::Truth;
use crate::target::{ForceProfile, MapTarget};
use crate::{LearnError, SplitConfig};

/// Everything that decides what comes out of training, besides the data. A file is TOML; unknown keys are errors.
///
/// ```
/// let config = dermis_learn::train::TrainConfig::from_toml(
///     r#"
///     targets = ["position.x", "position.y"]
///     [network]
///     hidden = [64, 64]
///     "#,
///     "position.toml",
/// )?;
/// assert_eq!(config.training.epochs, 200);
/// # Ok::<(), dermis_learn::LearnError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Free text for the bundle.
    #[serde(default)]
    pub description: String,
    /// Quantities to learn: `position.x`, `position.y`, `position.z`, `force.x`, `force.y`, `force.z`,
    /// `force.normal`, `contact`, and the maps `map.normal`, `map.force`, `map.displacement`; see
    /// [`target`](crate::target).
    pub targets: Vec<String>,
    /// How forces are spread over the points of `map.normal` and `map.force` that are learned. Errors of maps are still those against what
    /// acts.
    #[serde(default, skip_serializing_if = "ForceProfile::is_default")]
    pub force_profile: ForceProfile,
    /// Whether the model takes readings minus their zero, or as they are.
    #[serde(default = "tared")]
    pub baseline: Baseline,
    /// \[N\] normal force below which a touched sample does not count for positions; samples of unknown force do.
    #[serde(default)]
    pub position_min_force: f64,
    /// \[N\] normal force from which on a sample counts fully for positions; below, with the square of its share of
    /// it, as the error of a position grows with the inverse of the force. 0: all count the same.
    #[serde(default)]
    pub position_full_force: f64,
    /// Whether every range of normal force ([`FORCE_BINS`](crate::FORCE_BINS), and untouched) counts alike for the
    /// forces, however many samples it has. Helps where some forces are rare and matter; readings that are plenty, an
    /// untouched skin mostly, are then fitted less closely.
    #[serde(default)]
    pub balance_force: bool,
    /// How frames become inputs.
    #[serde(default)]
    pub features: FeatureChoice,
    /// Which regressors may be the model.
    #[serde(default, skip_serializing_if = "ModelChoice::is_default")]
    pub model: ModelChoice,
    /// The network.
    #[serde(default)]
    pub network: NetworkConfig,
    /// How it is fitted.
    #[serde(default)]
    pub training: TrainingConfig,
    /// What is held out.
    #[serde(default)]
    pub split: SplitConfig,
}

fn tared() -> Baseline {
    Baseline::Tared
}

/// The part of [`FeatureConfig`] that is chosen; mean and scale are measured on the training part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureChoice {
    /// Frames that the model sees.
    pub taps: Taps,
    /// \[s\] time constants of low-passed copies.
    pub low_pass: Vec<f64>,
    /// \[s\] spans of differences.
    pub difference: Vec<f64>,
    /// What stands in for an invalid channel.
    pub missing: Missing,
    /// \[s\] without a frame after which history starts anew.
    pub max_gap: f64,
    /// What a channel is divided by.
    pub scaling: Scaling,
    /// The image that the model sees in place of the channels, of a skin that is read by a camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageGrid>,
}

impl Default for FeatureChoice {
    fn default() -> Self {
        let newest = FeatureConfig::newest(Vec::new(), Vec::new());
        Self {
            taps: newest.taps,
            low_pass: newest.low_pass,
            difference: newest.difference,
            missing: newest.missing,
            max_gap: newest.max_gap,
            scaling: Scaling::default(),
            image: None,
        }
    }
}

impl FeatureChoice {
    /// With a measured mean and scale, one a channel, in the unit of the skin.
    #[must_use]
    pub fn with(&self, mean: Vec<f32>, scale: Vec<f32>) -> FeatureConfig {
        FeatureConfig {
            mean,
            scale,
            taps: self.taps.clone(),
            low_pass: self.low_pass.clone(),
            difference: self.difference.clone(),
            missing: self.missing,
            max_gap: self.max_gap,
            image: self.image,
        }
    }
}

/// What a channel is divided by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scaling {
    /// The standard deviation of its touched training samples.
    #[default]
    Channel,
    /// One for all: the root mean square of those. Keeps the ratios between channels.
    Common,
}

/// What the first layer sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InputForm {
    /// The normalised readings.
    #[default]
    Plain,
    /// Direction and logarithm of the magnitude of the first tap's readings, and everything else normalised. Where a
    /// contact is shows in the ratios between channels, how hard it is in their magnitude.
    Direction,
    /// The direction of `direction` alone: the ratios between the channels. For where a contact is on a skin whose recordings hold few
    /// depths or forces: what a regressor makes of a magnitude that it has never seen is a guess.
    Ratios,
    /// Signed logarithms of the first tap's readings, and everything else normalised: asinh(x / s), which is x / s for small readings
    /// x and ± ln(2|x| / s) for large ones. s is the median over the training samples of the root mean square of the channels. For
    /// skins with a few channels that are many times stronger than the others, which would outweigh them all.
    Logarithm,
}

/// A multilayer perceptron, or the mean of several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Widths of the hidden layers.
    pub hidden: Vec<usize>,
    /// What the first layer sees.
    pub input: InputForm,
    /// Non-linearity of the hidden layers.
    pub activation: Activation,
    /// Networks whose outputs are averaged; each starts and shuffles differently.
    pub members: u32,
    /// Makes the network one that draws a picture of the forces; `hidden` and `activation` do not count then. Only programs that were
    /// built with feature `train` fit it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageConfig>,
    /// Makes the network a convolutional one; `hidden` and `activation` do not count then. Only programs that were built
    /// with feature `train` fit it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conv: Option<ConvConfig>,
}

/// A convolutional network on channels that lie in a grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConvConfig {
    /// \[planes, rows, columns\] of the grid in which the inputs lie row by row; a plane for every block of inputs.
    pub grid: [usize; 3],
    /// Channels of every level of the encoder; each halves rows and columns.
    pub encoder: Vec<usize>,
    /// Width of the dense layer between encoder and outputs.
    #[serde(default = "hidden")]
    pub hidden: usize,
    /// \[rows, columns\] of the points of the surface, where they lie in a grid row by row: maps are decoded by
    /// convolutions then, and by a dense layer otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<[usize; 2]>,
    /// Epochs without a lower error at other locations of the training part after which training ends; 0: never.
    #[serde(default = "patience")]
    pub patience: u32,
}

fn hidden() -> usize {
    128
}

fn patience() -> u32 {
    20
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            hidden: vec![128, 128],
            input: InputForm::default(),
            activation: Activation::default(),
            members: 1,
            image: None,
            conv: None,
        }
    }
}

/// Adam (Kingma & Ba 2015) on the mean squared error, with a rate that falls to 0 along a cosine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingConfig {
    /// Passes over the training part.
    pub epochs: u32,
    /// Samples a step.
    pub batch: usize,
    /// Largest step size.
    pub learning_rate: f64,
    /// Decoupled weight decay a step, relative to the step size.
    pub weight_decay: f64,
    /// Standard deviation of Gaussian noise that is added to inputs at every step, in normalised units.
    pub noise: f64,
    /// Noise of each channel by itself, as another model leaves it; for networks that draw pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel_noise: Option<ChannelNoise>,
    /// Decay of Adam's first moment.
    #[serde(skip_serializing_if = "is_usual")]
    pub momentum: f64,
    /// Seed of every random choice.
    pub seed: u64,
}

/// Gaussian noise that is added to inputs at every step: what a model of the signal leaves of each channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelNoise {
    /// Folder of a bundle with the target `signal`, as seen from where the program runs; its card has the standard deviations.
    pub bundle: PathBuf,
    /// Share of these.
    pub share: f64,
}

/// Adam's usual decay of the first moment.
const MOMENTUM: f64 = 0.9;

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_usual(momentum: &f64) -> bool {
    *momentum == MOMENTUM
}

impl Default for TrainingConfig {
    fn default() -> Self {
        Self {
            epochs: 200,
            batch: 128,
            learning_rate: 2e-3,
            weight_decay: 0.0,
            noise: 0.0,
            channel_noise: None,
            momentum: MOMENTUM,
            seed: 1,
        }
    }
}

impl TrainConfig {
    /// Reads a configuration file.
    ///
    /// # Errors
    ///
    /// [`LearnError`] names the file and field.
    pub fn load(path: &Path) -> Result<Self, LearnError> {
        let text = dermis_io::read_text(path, dermis_io::TEXT).map_err(LearnError::io(path, "read"))?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Reads a configuration; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// [`LearnError::Config`] names the field, or line and column.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, LearnError> {
        let config: Self = LearnError::of_toml(text, file)?;
        config.validate(file)?;
        Ok(config)
    }

    /// Says what is impossible; `file` is what errors call the configuration.
    ///
    /// # Errors
    ///
    /// [`LearnError::Config`] names the field.
    pub fn validate(&self, file: &str) -> Result<(), LearnError> {
        let wrong = |field: &str, reason: String| -> Result<(), LearnError> {
            Err(LearnError::Config { file: file.to_owned(), field: field.to_owned(), reason })
        };
        checks::targets(self, &wrong)?;
        checks::network_size(self, &wrong)?;
        candidates::check(self, &wrong)?;
        checks::input(self, &wrong)?;
        checks::image_network(self, &wrong)?;
        checks::dense_only(self, &wrong)?;
        checks::training(self, &wrong)
    }

    /// Targets in the order of the model's outputs: scalars, maps, and `contact` last.
    #[must_use]
    pub fn outputs(&self) -> Vec<&'static str> {
        let requested = |name: &&'static str| self.targets.iter().any(|own| own == name);
        let (contact, scalars): (Vec<_>, Vec<_>) =
            Truth::TARGETS.into_iter().filter(requested).partition(|name| *name == "contact");
        let maps = self.maps().into_iter().map(MapTarget::name);
        scalars.into_iter().chain(maps).chain(contact).collect()
    }

    /// Targets that are scalars of a contact, in the order of the outputs.
    #[must_use]
    pub fn scalars(&self) -> Vec<&'static str> {
        self.outputs().into_iter().filter(|name| Truth::TARGETS.contains(name)).collect()
    }

    /// Targets that are maps, in the order of the outputs.
    #[must_use]
    pub fn maps(&self) -> Vec<MapTarget> {
        MapTarget::ALL.into_iter().filter(|m| self.targets.iter().any(|own| own == m.name())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_name_the_field() {
        let message = |text: &str| TrainConfig::from_toml(text, "c.toml").unwrap_err().to_string();
        insta::assert_snapshot!(message("targets = [\"position.x\"]"), @"c.toml: field `targets`: position.x and position.y only make sense together");
        insta::assert_snapshot!(message("targets = [\"torque\"]"), @r#"c.toml: field `targets[0]`: is "torque" and must be one of position.x, position.y, position.z, force.x, force.y, force.z, force.normal, contact, map.normal, map.force, map.displacement, signal"#);
        insta::assert_snapshot!(message("targets = [\"contact\"]\n[training]\nepoch = 3"), @"c.toml: field `training.epoch`: unknown field `epoch`, expected one of `epochs`, `batch`, `learning_rate`, `weight_decay`, `noise`, `channel_noise`, `momentum`, `seed`");
        insta::assert_snapshot!(message("targets = [\"contact\"]\n[network]\nmembers = 0"), @"c.toml: field `network.members`: is 0 and must be 1 to 64");
    }

    #[test]
    fn contact_is_the_last_output() {
        let config = TrainConfig::from_toml("targets = [\"contact\", \"force.normal\"]", "c.toml").unwrap();
        assert_eq!(config.outputs(), ["force.normal", "contact"]);
        let text = "targets = [\"map.displacement\", \"contact\", \"map.normal\", \"position.z\"]";
        let config = TrainConfig::from_toml(text, "c.toml").unwrap();
        assert_eq!(config.outputs(), ["position.z", "map.normal", "map.displacement", "contact"]);
        assert_eq!(config.scalars(), ["position.z", "contact"]);
    }
}
