//! Calibrates "unknown" on the library itself, and writes the table that reports are judged by; the work is done in `dermis-gap`.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_gap::calibrate::{Trial, trials};
use dermis_gap::unknown::{Model, Source};
use dermis_gap::{Options, Simulator};
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize};

use crate::Families;

/// Along which presses devices are simulated.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description: the model by design.
    #[arg(long, requires = "presses")]
    pub skin: Option<PathBuf>,
    /// Labelled bag whose presses are simulated anew; its readings are not used. Several are pressed one after another.
    #[arg(long, value_name = "BAG", requires = "skin")]
    pub presses: Vec<PathBuf>,
    /// Devices along the presses of each bag.
    #[arg(long, default_value_t = Request::default().count)]
    pub count: usize,
    /// Of everything random.
    #[arg(long, default_value_t = Request::default().seed)]
    pub seed: u64,
    /// Trials of earlier runs that the table is fitted to as well.
    #[arg(long, value_name = "FILE")]
    pub with: Vec<PathBuf>,
    /// Folder that keeps simulated signatures; the user's cache folder where absent.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        Self { skin: None, presses: Vec::new(), count: 100, seed: 1, with: Vec::new(), cache: None }
    }
}

/// Trials with where they come from.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Made {
    /// `gap-trials/1`.
    pub schema: String,
    /// Where each run of trials comes from.
    pub sources: Vec<Source>,
    /// All trials.
    pub trials: Vec<Trial>,
}

/// Simulates and diagnoses. `done` is called after each bag with the number of trials so far.
///
/// # Errors
///
/// Where skin, bags or earlier trials cannot be read.
pub fn make(
    request: &Request,
    families: &Families,
    stop: &Arc<AtomicBool>,
    mut done: impl FnMut(usize),
) -> Result<Made> {
    let mut made = Made { schema: "gap-trials/1".to_owned(), sources: Vec::new(), trials: Vec::new() };
    for path in &request.with {
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .with_context(|| format!("trials {} cannot be read", path.display()))?;
        let earlier: Made = serde_json::from_str(&text)
            .with_context(|| format!("{} holds no trials of `dermis gap calibrate`", path.display()))?;
        made.sources.extend(earlier.sources);
        made.trials.extend(earlier.trials);
    }
    let Some(path) = &request.skin else { return Ok(made) };
    let skin = SkinDescription::load(path)?;
    let make = |skin: &SkinDescription| families.model(skin).map_err(|e| format!("{e:#}"));
    let simulator = Simulator { skin: &skin, effects: families.of(&skin)?.effects(), make: &make };
    let options = Options {
        cache: request.cache.clone().or_else(super::diagnosis::cache),
        stop: Arc::clone(stop),
        ..Options::default()
    };
    for (index, bag) in request.presses.iter().enumerate() {
        let recording = dermis_gap::read(&[bag], &skin, None, None)?;
        let seed = request.seed.wrapping_add(1000 * index as u64);
        made.trials.extend(trials(&simulator, &recording, &options, (request.count, seed))?);
        done(made.trials.len());
    }
    let of = |unknown: bool| made.trials.iter().filter(|t| t.kind.unknown() == unknown).count();
    let before = |of: fn(&Source) -> usize| made.sources.iter().map(of).sum::<usize>();
    made.sources.push(Source {
        skin: skin.name.clone(),
        command: format!(
            "dermis gap calibrate --skin {} --presses ({} bags) --count {} --seed {}",
            path.display(),
            request.presses.len(),
            request.count,
            request.seed
        ),
        known: of(false) - before(|s| s.known),
        unknown: of(true) - before(|s| s.unknown),
    });
    Ok(made)
}

/// The table of these trials, as TOML.
///
/// # Errors
///
/// Where there are too few.
pub fn table(made: &Made) -> Result<(Model, String)> {
    let Some(model) = Model::fit(&made.trials, made.sources.clone()) else {
        bail!("a table needs trials whose cause is in the library and such whose cause is not: raise --count")
    };
    let text = format!(
        "# How much speaks for a cause that the library lacks: weights of what is measured of names and of what they leave.\n\
         # Written by `dermis gap calibrate`; see crates/gap/src/unknown.rs.\n\n{}",
        toml::to_string(&model)?
    );
    Ok((model, text))
}
