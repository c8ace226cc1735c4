//! Who extrapolates to more contacts than were learned from (thesis, Table 3.1).

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use dermis_learn::real2sim::{SceneSettings, Scenes, Settings, Table, table};
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use super::{nominal, sensors, watched};
use crate::{Families, Progress};

/// Which skin.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description; its forward model must know displacements.
    pub skin: PathBuf,
    /// Settings (TOML); see `launch/real2sim/`.
    #[arg(long)]
    pub settings: Option<PathBuf>,
}

/// Everything that was found.
pub struct Findings {
    /// The skin.
    pub skin: SkinDescription,
    /// How contacts were drawn.
    pub scenes: SceneSettings,
    /// Errors.
    pub table: Table,
    /// \[s\] that it took.
    pub seconds: f64,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [line, network] = self.table.messages();
        json!({
            "skin": self.skin.name, "skin_hash": self.skin.hash(), "scenes": self.scenes, "table": self.table,
            "messages": {
                "linear_extrapolates_best_from_single_contacts": line, "network_best_where_learned": network,
            },
            "margins": { "linear": self.table.margins()[0], "network": self.table.margins()[1] },
            "seconds": self.seconds,
        })
        .serialize(serializer)
    }
}

/// Makes the table.
///
/// # Errors
///
/// Where skin or settings cannot be read, or the forward model knows no displacements.
pub fn make(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let settings = Settings::load(options.settings.as_deref())?;
    let (skin, model) = nominal(&options.skin, families, progress)?;
    let scenes = Scenes::new(model.as_ref(), &settings.scenes)?;
    // The table is about virtual sensors: those of the thesis, whatever the pipeline uses.
    let each = if settings.pipeline.each == 0 { 24 } else { settings.pipeline.each };
    let sensors = sensors(&model, &skin, each)?;
    let started = std::time::Instant::now();
    let table = table(model.as_ref(), &sensors, &scenes, &settings.table, &watched(progress))?;
    Ok(Findings { skin, scenes: settings.scenes, table, seconds: started.elapsed().as_secs_f64() })
}
