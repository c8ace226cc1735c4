//! What a settings file says.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{PipelineSettings, SceneSettings, TableSettings};
use crate::{LearnError, SplitConfig};

/// Everything that decides what comes out, besides skin and recordings. A file is TOML, every key has a default, and unknown
/// keys are errors; see `launch/real2sim/` for an example to copy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Free text for the bundle.
    pub description: String,
    /// What is simulated.
    pub scenes: SceneSettings,
    /// The three networks.
    pub pipeline: PipelineSettings,
    /// The table of who extrapolates.
    pub table: TableSettings,
    /// What of the recordings is held out.
    pub split: SplitConfig,
    /// \[N\] from which on recorded contacts are learned from.
    pub least: f64,
    /// Recorded frames that are learned from at most, evenly.
    pub most: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            description: String::new(),
            scenes: SceneSettings::default(),
            pipeline: PipelineSettings::default(),
            table: TableSettings::default(),
            split: SplitConfig::default(),
            least: 0.5,
            // What the thesis recorded.
            most: 27_000,
        }
    }
}

impl Settings {
    /// Reads a file; the defaults where there is none.
    ///
    /// # Errors
    ///
    /// [`LearnError`] names file and field.
    pub fn load(path: Option<&Path>) -> Result<Self, LearnError> {
        let Some(path) = path else { return Ok(Self::default()) };
        let text = dermis_io::read_text(path, dermis_io::TEXT).map_err(LearnError::io(path, "read"))?;
        let file = path.display().to_string();
        let settings: Self = LearnError::of_toml(&text, &file)?;
        settings.pipeline.validate(&file)?;
        if !(settings.least.is_finite() && settings.least > 0.0 && settings.most > 0) {
            return Err(LearnError::Config {
                file,
                field: "least".into(),
                reason: "and `most` must be positive".into(),
            });
        }
        Ok(settings)
    }
}
