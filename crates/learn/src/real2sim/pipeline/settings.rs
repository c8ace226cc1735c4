//! How transfer, reconstruction and sensitivity network are made.

use dermis_inversion::PeakSettings;
use serde::{Deserialize, Serialize};

use super::CONTACTS;
use crate::LearnError;
use crate::train::{Activation, NetworkConfig, TrainingConfig};

/// What the sensitivity network gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensitivityOutput {
    /// The logarithm of force over displacement: errors count relative to the force.
    #[default]
    Ratio,
    /// The force, by its squared error: what the thesis does (eq. 3.3).
    Force,
}

/// How the three networks are trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PipelineSettings {
    /// Points of the surface near each element that are virtual sensors; 0: the channels of the skin as designed.
    pub each: usize,
    /// Recorded single contacts of which sums stand in for several at once, at most: 1 is what the thesis does.
    pub superpose: usize,
    /// Sums of each number of contacts.
    pub sums: usize,
    /// Whether the transfer is a matrix instead of a network.
    pub linear_transfer: bool,
    /// Simulated samples with one, two, three and four contacts.
    pub samples: [usize; CONTACTS],
    /// Whether the reconstruction gives every point of the map, as in the thesis, instead of amplitudes of a basis. Costs several
    /// times as much.
    pub whole_maps: bool,
    /// Share of the squares of the maps that the basis keeps.
    pub kept: f64,
    /// Whether the reconstruction sees, on top of simulated virtual sensors, what the transfer gets wrong; the thesis does not.
    pub residuals: bool,
    /// Hidden layers of the transfer.
    pub transfer: NetworkConfig,
    /// How it is fitted.
    pub transfer_training: TrainingConfig,
    /// Hidden layers of the reconstruction.
    pub reconstruction: NetworkConfig,
    /// How it is fitted.
    pub reconstruction_training: TrainingConfig,
    /// Hidden layers of the sensitivity.
    pub sensitivity: NetworkConfig,
    /// What it gives.
    pub sensitivity_output: SensitivityOutput,
    /// Peaks of sums of so many recorded single contacts teach it, at most: 1 is what the thesis does.
    pub sensitivity_contacts: usize,
    /// How it is fitted.
    pub sensitivity_training: TrainingConfig,
    /// Whether displacements are divided by the root of what each point gives way before peaks are looked for; the thesis does
    /// not.
    pub weighted: bool,
    /// Which peaks are contacts, before the suppression is tuned.
    pub peaks: PeakSettings,
}

impl Default for PipelineSettings {
    fn default() -> Self {
        let network = |hidden: &[usize], activation| NetworkConfig {
            hidden: hidden.to_vec(),
            activation,
            ..NetworkConfig::default()
        };
        let training = |epochs| TrainingConfig { epochs, learning_rate: 1e-3, ..TrainingConfig::default() };
        Self {
            each: 24,
            superpose: 1,
            sums: 10_000,
            linear_transfer: false,
            samples: [16_200, 3_600, 3_600, 3_600],
            whole_maps: false,
            kept: 0.999,
            residuals: true,
            transfer: network(&[128, 128, 128], Activation::Silu),
            transfer_training: training(80),
            reconstruction: network(&[256, 256, 256], Activation::Silu),
            reconstruction_training: training(60),
            sensitivity: network(&[48, 48], Activation::Silu),
            sensitivity_output: SensitivityOutput::default(),
            sensitivity_contacts: CONTACTS,
            sensitivity_training: training(120),
            weighted: false,
            peaks: PeakSettings::default(),
        }
    }
}

impl PipelineSettings {
    /// Says what is impossible; `file` is what errors call the settings.
    ///
    /// # Errors
    ///
    /// [`LearnError::Config`] names the field.
    pub fn validate(&self, file: &str) -> Result<(), LearnError> {
        let wrong = |field: &str, reason: String| {
            Err(LearnError::Config { file: file.to_owned(), field: field.to_owned(), reason })
        };
        for (field, contacts) in
            [("superpose", self.superpose), ("sensitivity_contacts", self.sensitivity_contacts)]
        {
            if !(1..=CONTACTS).contains(&contacts) {
                return wrong(field, format!("is {contacts} and must be 1 to {CONTACTS}"));
            }
        }
        if self.samples[0] == 0 {
            return wrong("samples[0]", "is 0: single contacts are the least that is simulated".into());
        }
        if !(self.kept > 0.0 && self.kept < 1.0) {
            return wrong("kept", format!("is {} and must lie between 0 and 1", self.kept));
        }
        if let Err((field, reason)) = self.peaks.check() {
            return wrong(&format!("peaks.{field}"), reason);
        }
        Ok(())
    }
}
