//! `dermis real2sim`: several contacts from few readings by way of a simulation, and who else could find them.

mod compare;
pub mod estimators;
mod table;
pub mod train;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use clap::Subcommand;
use dermis_learn::real2sim::VirtualSensors;
use dermis_model::ForwardModel;
use dermis_skin::SkinDescription;
use indicatif::{ProgressBar, ProgressStyle};

/// What to do.
#[derive(Subcommand)]
pub enum Real2Sim {
    /// Who extrapolates to more contacts than were learned from: a line, neighbours and a network from virtual sensors to
    /// displacement maps (thesis, Table 3.1).
    Table(table::Options),
    /// Learn a bundle whose contacts are peaks of a displacement map, from recorded single contacts.
    Train(train::Options),
    /// Compare ways to one and two contacts on recordings that nothing was learned from.
    Compare(compare::Options),
}

/// Runs one of the commands.
pub fn run(command: &Real2Sim) -> Result<()> {
    match command {
        Real2Sim::Table(options) => table::run(options),
        Real2Sim::Train(options) => train::run(options),
        Real2Sim::Compare(options) => compare::run(options),
    }
}

/// A skin as it was designed, and its forward model: a simulation knows nothing of what makes a device differ.
fn nominal(path: &Path) -> Result<(SkinDescription, Arc<dyn ForwardModel>)> {
    let mut skin = SkinDescription::load(path)?;
    if !skin.effects.is_empty() {
        let names: Vec<&str> = skin.effects.iter().map(|e| e.name.as_str()).collect();
        eprintln!(
            "note: the simulation is of the skin as it was designed; it leaves out the effects of {}: {}",
            path.display(),
            names.join(", ")
        );
        skin.effects.clear();
    }
    let model = crate::registry::forward(path, &skin)?;
    Ok((skin, model))
}

/// The virtual sensors that settings ask for.
fn sensors(model: &Arc<dyn ForwardModel>, skin: &SkinDescription, each: usize) -> Result<VirtualSensors> {
    Ok(match each {
        0 => VirtualSensors::channels(Arc::clone(model))?,
        each => VirtualSensors::displacements(model.as_ref(), skin, each),
    })
}

/// A bar for work that tells its share.
fn progress() -> Result<ProgressBar> {
    Ok(ProgressBar::new(1000)
        .with_style(ProgressStyle::with_template("{msg:40} {wide_bar} {percent} %, {elapsed} gone")?))
}

/// Moves a bar.
fn tell(bar: &ProgressBar) -> impl Fn(&str, f64) + Sync + '_ {
    |what, share| {
        bar.set_message(what.to_owned());
        bar.set_position((1000.0 * share) as u64);
    }
}

/// Writes a file of a folder that is made where it is missing.
fn save(folder: &Path, file: &str, content: &str) -> Result<PathBuf> {
    std::fs::create_dir_all(folder).with_context(|| format!("folder {} cannot be made", folder.display()))?;
    let path = folder.join(file);
    std::fs::write(&path, content).with_context(|| format!("{} cannot be written", path.display()))?;
    Ok(path)
}

/// Points of a surface laid flat \[mm\]: x, and the way around it from the middle.
fn flat(surface: &dermis_skin::Surface, skin: &SkinDescription) -> Vec<(f64, f64)> {
    let around = |p: &nalgebra::Point3<f64>| match skin.surface {
        dermis_skin::SurfaceSpec::Panel { radius, .. } => radius * p.y.atan2(p.z),
        _ => p.y,
    };
    surface.points.iter().map(|p| (p.x * 1e3, around(p) * 1e3)).collect()
}
