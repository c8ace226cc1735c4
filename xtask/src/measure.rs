//! Measurements behind `targets.toml`; each prints one line of JSON at the end, and keeps it in `benches/results/`.

use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use serde_json::{Value, json};

use crate::programs;
use crate::record;
use crate::run::{cargo, output, run as execute, target_dir};

mod barodome;
mod comparisons;
mod e_skins;
mod ert;
mod gap;
mod hapdefx;
mod insight;
mod limb;
mod physics;
mod pictures;
mod placement;
mod printed;
mod recorded;

/// What can be measured.
#[derive(Subcommand)]
pub enum Measurement {
    /// CPU minutes and wall minutes of the README's first command on a fresh clone with an empty target folder. What a measurement
    /// prints is kept in benches/results/NAME.json, with its command, commit and machine; NAME is that of the measurement, where
    /// nothing else is said.
    ColdBuild,
    /// Localisation on a recorded magnetic skin: import, train on one run, evaluate on held-out presses, on unseen
    /// locations and on the other run.
    Localisation,
    /// Normal force on the same kind of skin: import, train on the first part of a trial, evaluate on its end and on
    /// the other trial.
    Force,
    /// Shear along the stroke on a stack of two boards of that skin: import, train on the first part of the trial, evaluate on its end.
    Shear,
    /// How well a model of one recorded run of the magnetic skin answers another run, or the end of the same: the one that `dermis train`
    /// chooses, beside a network, support vectors and a Gaussian process, each alone. Written to benches/results/transfers.json.
    Transfers,
    /// The shipped bundles of the barometer skins beside the network of the thesis, tuned regressors on the same frames, and isolines, on
    /// held-out locations of the training bags. Written to benches/results/comparison-line.json, comparison-grid.json and comparison-dome.json.
    Comparisons,
    /// Localisation on recorded hydrogel skins, one plain and four patterned: import, train on four presses of five, evaluate on the
    /// rest. `DERMIS_E_SKINS` names the folder of the recordings.
    ESkins,
    /// How much of what was measured on tanks of water a uniform sheet with complete electrodes explains. `DERMIS_DATA` names the
    /// folder of the recordings.
    Tanks,
    /// Position and force by the model bundles that ship for the simulated barometer skins, on locations and forces that
    /// they were not trained on, against the Cramér–Rao bound.
    Accuracy,
    /// The same by networks that are trained and measured on devices with the default effects, against what the thesis
    /// measured on its real ones (Table 5.2).
    Realism,
    /// Single contacts on the limb with strain gauges by the bundle that ships: as designed, with one dead gauge that the node
    /// does not know of, and on a device with the default effects; as designed beside support vectors, nearest neighbours and a
    /// network that learn from the same presses. Written to benches/results/limb-accuracy.json.
    Limb,
    /// One and two contacts on the limb by the bundle that ships for two, as designed and on a device with the default effects that it does
    /// not know of: how many are found, and how far off. Written to benches/results/limb-doubles.json.
    Doubles,
    /// One and two contacts on a limb with the default effects: all ways, learned from recorded single contacts. Written to
    /// benches/results/real2sim-shin.json.
    Real2sim,
    /// Chapter 3 of the thesis at its sizes (HapDefX) on the limb of `real2sim`: maps, ways to one contact, errors of one and two
    /// contacts. Writes benches/results/hapdefx-shin.json, from which `cargo xtask docs --tables` makes the tables. About an hour
    /// and a half of one core. Interrupted, the same command goes on.
    Hapdefx(hapdefx::Options),
    /// Seconds from `kill -9` of a node under `launch` to the contacts of the one that comes after it.
    Restart,
    /// Seconds from the start of a node's process until a subscriber has contacts with status OK, with an empty and with a warm
    /// cache.
    Start,
    /// The diagnosis of gaps on benchmark sets with withheld causes, for the row of barometers, the pad, the limb, the conductive panel and the
    /// soft thumb. Written to benches/results/gap-check-SKIN.json, SKIN being line, grid, shin, panel or thumb, with a picture of each.
    Gap(gap::Options),
    /// What `dermis gap close` gains on a row of barometers whose elements read half too much: errors of an estimator that learned from the
    /// nominal simulation and of one that learned from the corrected one, on held-out presses. Written to benches/results/gap-close.json.
    GapClose,
    /// One to six contacts on the simulated conductive panel, found by inversion of its forward model, beside the Cramér–Rao bound of the
    /// very same frames. Written to benches/results/ert-inversion.json.
    Panel,
    /// One contact anywhere, on the fovea and by a larger ball than is assumed, and one to five at once, on the simulated soft thumb, found by
    /// inversion of its forward model, beside the Cramér–Rao bound of the very same frames. Written to benches/results/insight-accuracy.json,
    /// insight-fovea.json, insight-large-tip.json and insight-contacts.json.
    Insight,
    /// Table 6.6 of the thesis on the simulated soft thumb, reduced: force maps by a network for each of five ways to spread a ball's force.
    /// Written to benches/results/insight-maps.json.
    InsightMaps,
    /// The thesis' residual network on pictures of the simulated soft thumb (ResNet-18), and a small one, learned from the same pictures and
    /// measured on the frames of `insight`. Written to benches/results/insight-pictures.json, which says what is reduced.
    InsightPictures(pictures::Options),
    /// Tables 4.3 to 4.5 of the thesis on the simulated conductive panel, written to benches/results/ert-tables.json; the result says
    /// what is reduced.
    ErtTables(ert::Sizes),
    /// The physics of every sensor family against closed forms and other programs, as `dermis validate` computes it. Written to
    /// benches/results/FAMILY-validation.json. Fails where a case does.
    Validation,
    /// Least errors of the conductive panel and of the row of barometers, and the super-resolution factors of the row, as `dermis bounds`
    /// computes them. Written to benches/results/ert-panel-bounds.json and baro-line-bounds.json.
    Bounds,
    /// Placement of ten gauges on the limb by five methods: errors by number of gauges and of failed ones, and CPU time of the search.
    /// Written to benches/results/placement-hapdef-shin.json.
    Placement,
    /// Simulated slides that the fusion finds, and reports of slides that are right, as its test measures and bounds them.
    Slip,
    /// How long a node waits to publish beside a subscriber that stopped reading, over both backends, as their tests measure and bound it.
    Hanging,
    /// Where a recorded skin is touched, learned from the ratios between its channels and with their magnitude besides, by a Gaussian
    /// process: on unseen locations and on another run. Written to benches/results/eflesh-inputs.json.
    Inputs,
}

impl Measurement {
    /// Names of the records that it writes. Where there are several, each holds what is printed under one key.
    pub fn records(&self) -> &'static [&'static str] {
        match self {
            Self::ColdBuild => &["cold-build"],
            Self::Localisation => &["localisation"],
            Self::Force => &["force"],
            Self::Shear => &["shear"],
            Self::Transfers => &["transfers"],
            Self::Comparisons => &["comparison-line", "comparison-grid", "comparison-dome"],
            Self::ESkins => &["e-skins"],
            Self::Tanks => &["tanks"],
            Self::Accuracy => &["accuracy"],
            Self::Realism => &["realism"],
            Self::Limb => &["limb-accuracy"],
            Self::Doubles => &["limb-doubles"],
            Self::Real2sim => &["real2sim-shin"],
            Self::Hapdefx(_) => &["hapdefx-shin"],
            Self::Restart => &["restart"],
            Self::Start => &["start"],
            Self::Gap(_) => {
                &["gap-check-line", "gap-check-grid", "gap-check-shin", "gap-check-panel", "gap-check-thumb"]
            }
            Self::GapClose => &["gap-close"],
            Self::Panel => &["ert-inversion"],
            Self::Insight => &["insight-accuracy", "insight-fovea", "insight-large-tip", "insight-contacts"],
            Self::InsightMaps => &["insight-maps"],
            Self::InsightPictures(_) => &["insight-pictures"],
            Self::ErtTables(_) => &["ert-tables"],
            Self::Validation => &physics::VALIDATIONS,
            Self::Bounds => &physics::BOUNDS,
            Self::Placement => &["placement-hapdef-shin"],
            Self::Slip => &["slip"],
            Self::Hanging => &["hanging"],
            Self::Inputs => &["eflesh-inputs"],
        }
    }

    /// Whether [`run`] writes its record; those that keep what a run of another size measured do it themselves.
    fn is_kept_here(&self) -> bool {
        !matches!(self, Self::Hapdefx(_) | Self::ErtTables(_))
    }
}

pub fn run(root: &Path, measurement: &Measurement) -> Result<()> {
    let value = match measurement {
        Measurement::ColdBuild => cold_build(root)?,
        Measurement::Localisation => recorded::recorded(root, &recorded::POSITION)?,
        Measurement::Accuracy => barodome::accuracy(root)?,
        Measurement::Realism => barodome::realism(root)?,
        Measurement::Limb => limb::limb(root)?,
        Measurement::Doubles => limb::doubles(root)?,
        Measurement::Real2sim => limb::real2sim(root)?,
        Measurement::Hapdefx(options) => hapdefx::run(root, options)?,
        Measurement::Start => start(root)?,
        Measurement::Gap(options) => gap::benchmark(root, options)?,
        Measurement::GapClose => gap::close(root)?,
        Measurement::Panel => ert::inversion(root)?,
        Measurement::Insight => insight::accuracy(root)?,
        Measurement::InsightMaps => insight::maps(root)?,
        Measurement::InsightPictures(options) => pictures::networks(root, options)?,
        Measurement::ErtTables(sizes) => ert::tables(root, sizes)?,
        Measurement::Validation => physics::validation(root)?,
        Measurement::Bounds => physics::bounds(root)?,
        Measurement::Placement => placement::placement(root)?,
        Measurement::Slip => printed::slip(root)?,
        Measurement::Hanging => printed::hanging(root)?,
        Measurement::Inputs => recorded::inputs(root)?,
        Measurement::Restart => restart(root)?,
        Measurement::Force => recorded::recorded(root, &recorded::FORCE)?,
        Measurement::Transfers => recorded::transfers(root)?,
        Measurement::Comparisons => comparisons::comparisons(root)?,
        Measurement::Tanks => tanks(root)?,
        Measurement::ESkins => e_skins::e_skins(root)?,
        Measurement::Shear => recorded::recorded(root, &recorded::SHEAR)?,
    };
    // What cannot be measured here is no reason to forget what was.
    if let (true, [name]) = (measurement.is_kept_here(), measurement.records())
        && value.get("skipped").is_none()
    {
        record::keep(root, name, &value)?;
    }
    println!("{value}");
    Ok(())
}

fn scratch(root: &Path, name: &str) -> Result<PathBuf> {
    let dir = root.join(".dermis/measure").join(name);
    if dir.exists() {
        std::fs::remove_dir_all(&dir)?;
    }
    std::fs::create_dir_all(&dir)?;
    Ok(dir)
}

/// Folder of the recordings that others made.
fn recordings(root: &Path) -> PathBuf {
    std::env::var("DERMIS_DATA").map_or_else(|_| root.join("../shared/data"), PathBuf::from)
}

fn read_toml(path: &Path) -> Result<toml::Table> {
    let text = dermis_io::read_text(path, dermis_io::TEXT)
        .with_context(|| format!("{} cannot be read", path.display()))?;
    text.parse().with_context(|| format!("{} is not TOML", path.display()))
}

/// What a command with `--json` prints: one value over several lines, or one in its last line.
fn evaluation(command: &mut Command) -> Result<Value> {
    printed(&output(command)?)
}

fn printed(text: &str) -> Result<Value> {
    let text = text.trim();
    serde_json::from_str(text)
        .or_else(|_| serde_json::from_str(text.lines().last().unwrap_or_default()))
        .context("a command with --json printed no JSON")
}

/// A number that changes with what these files hold, and with `further`: for names of what is kept between runs.
fn fingerprint(root: &Path, files: &[PathBuf], further: impl Hash) -> Result<u64> {
    let mut hasher = std::hash::DefaultHasher::new();
    for file in files {
        let file = root.join(file);
        std::fs::read(&file).with_context(|| format!("{} cannot be read", file.display()))?.hash(&mut hasher);
    }
    further.hash(&mut hasher);
    Ok(hasher.finish())
}

/// Has `dermis collect` write a bag, unless it is there. It has another name until it is whole: an interrupted one has metadata, too.
fn collected(collect: &mut Command, bag: &Path) -> Result<()> {
    if bag.exists() {
        return Ok(());
    }
    let partial = bag.with_extension("partial");
    if partial.exists() {
        std::fs::remove_dir_all(&partial)?;
    }
    let report = evaluation(collect.arg("--json").arg("--out").arg(&partial))?;
    if report["interrupted"] != false {
        bail!("collecting {} was interrupted: run the measurement again", bag.display());
    }
    Ok(std::fs::rename(&partial, bag)?)
}

/// What `work` makes of each item, in their order, of so many at once as `jobs` says; the first error where there are any.
fn at_once<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    work: impl Fn(&T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, items.len().max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else { break };
                    let result = work(item);
                    if result.is_err() {
                        next.store(items.len(), Ordering::Relaxed);
                    }
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

/// CPU seconds of all children that ended so far.
fn children_cpu() -> Result<f64> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN)?;
    let seconds = |t: nix::sys::time::TimeVal| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6;
    Ok(seconds(usage.user_time()) + seconds(usage.system_time()))
}

/// By the programs that are measured for speed, with the bundles that ship.
fn start(root: &Path) -> Result<Value> {
    // As it ships: what only tests need would be loaded, too.
    execute(cargo(root).args(["build", "--release", "-p", "dermis"]))?;
    execute(cargo(root).args(["build", "--release", "-p", "dermis-benches"]))?;
    let programs = target_dir(root).join("release");
    let mut bench = Command::new(programs.join("dermis-bench"));
    evaluation(bench.arg("start").arg("--programs").arg(&programs).arg("--root").arg(root).current_dir(root))
}

fn cold_build(root: &Path) -> Result<Value> {
    let dir = scratch(root, "cold-build")?;
    let clone = dir.join("dermis");
    execute(Command::new("git").args(["clone", "--quiet", "--no-local"]).arg(root).arg(&clone))?;
    // Downloading is not building.
    execute(cargo(&clone).arg("fetch").arg("--quiet"))?;
    let (cpu, wall) = (children_cpu()?, Instant::now());
    execute(cargo(&clone).args(["build", "--release"]).env("CARGO_TARGET_DIR", dir.join("target")))?;
    let value = json!({
        "cpu_minutes": (children_cpu()? - cpu) / 60.0,
        "wall_minutes": wall.elapsed().as_secs_f64() / 60.0,
        "program_megabytes": std::fs::metadata(dir.join("target/release/dermis"))?.len() as f64 * 1e-6,
    });
    std::fs::remove_dir_all(&dir)?;
    Ok(value)
}

/// Errors beside the bounds of their own frames, of so many contacts and this quantity.
fn beside_bound<'a>(found: &'a Value, contacts: u64, quantity: &str) -> &'a Value {
    let fits = |a: &&Value| a["contacts"] == contacts && a["quantity"] == quantity;
    found["against_bound"].as_array().into_iter().flatten().find(fits).unwrap_or(&Value::Null)
}

/// The limb's skin.
const LIMB: &str = "launch/skins/hapdef-shin.toml";

/// Kills a node under `launch`, and waits for its contacts.
fn restart(root: &Path) -> Result<Value> {
    let programs = programs::built(root, &["dermis", "dermis-bench"])?;
    evaluation(Command::new(programs.join("dermis-bench")).arg("restart").current_dir(root))
}

/// The model of tanks against recordings.
fn tanks(root: &Path) -> Result<Value> {
    let data = recordings(root);
    let folders: Vec<PathBuf> = ["eidors_tanks", "pyeidors_tank"]
        .map(|name| data.join(name))
        .into_iter()
        .filter(|f| f.is_dir())
        .collect();
    if folders.is_empty() {
        return Ok(
            json!({ "skipped": format!("{} has no recordings of tanks: set DERMIS_DATA", data.display()) }),
        );
    }
    let tanks = programs::built(root, &["dermis-tanks"])?.join("dermis-tanks");
    let mut value = evaluation(Command::new(tanks).args(folders))?;
    let summary =
        ["round", "measured_outline"].map(|outline| (outline.to_owned(), explained(&value, outline)));
    value["summary"] = Value::Object(summary.into_iter().collect());
    Ok(value)
}

/// Least, median and largest share of the readings of an outline's frames that the model explains, and how many frames those are.
fn explained(value: &Value, outline: &str) -> Value {
    let frames = value["frames"].as_array().map_or(&[][..], Vec::as_slice);
    let mut shares: Vec<f64> =
        frames.iter().filter_map(|frame| frame[outline]["explained"].as_f64()).collect();
    shares.sort_by(f64::total_cmp);
    let median = shares.get(shares.len() / 2);
    json!({ "frames": shares.len(), "least": shares.first(), "median": median, "most": shares.last() })
}

#[cfg(test)]
mod tests;
