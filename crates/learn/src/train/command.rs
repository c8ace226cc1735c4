//! The command `dermis train`, and the program `dermis-train` that does the same.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use dermis_inference::{Runtime, RuntimeConfig};
use dermis_model::ForwardModel;
use dermis_skin::SkinDescription;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde_json::json;

use super::candidates::Candidate;
use super::run::check_framework;
use super::{Outcome, Processor, Progress, Request, TrainConfig, run};
use crate::cli::Labels;
use crate::target::MapTarget;
use crate::{Dataset, LearnError, Requirement, SplitKind, Verdicts};

/// Learn contacts from labelled bags, and write a model bundle.
///
/// The bundle is measured on what was held out of the bags, and on other bags given with `--test`. Ctrl-C saves the
/// state; the same command with `--resume` goes on. Flags override the configuration file.
#[derive(Args)]
pub struct Options {
    /// What to learn and how; examples lie in `launch/train/`.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Folder of the bundle; an older bundle is replaced.
    #[arg(long, required_unless_present = "check")]
    out: Option<PathBuf>,
    /// Bags of other runs to report on; may be repeated.
    #[arg(long)]
    test: Vec<PathBuf>,
    /// What is held out: location, press (only to compare with figures measured that way) or time.
    #[arg(long)]
    split: Option<SplitKind>,
    /// Share that is held out.
    #[arg(long)]
    fraction: Option<f64>,
    /// Quantities to learn, e.g. `position.x,position.y,force.normal`.
    #[arg(long, value_delimiter = ',')]
    targets: Option<Vec<String>>,
    /// Regressors of which training keeps the best, e.g. `network`: the other ones take most of the time.
    #[arg(long, value_delimiter = ',')]
    candidates: Option<Vec<Candidate>>,
    /// Widths of the hidden layers, e.g. `128,128`.
    #[arg(long, value_delimiter = ',')]
    hidden: Option<Vec<usize>>,
    /// Networks whose outputs are averaged.
    #[arg(long)]
    members: Option<u32>,
    /// Passes over the training part.
    #[arg(long)]
    epochs: Option<u32>,
    /// Seed of every random choice in training; the split has its own, in the configuration file.
    #[arg(long)]
    seed: Option<u64>,
    /// Networks fitted at the same time; all cores where absent.
    #[arg(long)]
    threads: Option<usize>,
    /// What convolutional networks are fitted on: `cpu`, or a GPU (`gpu`, `gpu:1`) in programs that were built with
    /// `--features gpu`.
    #[arg(long, default_value_t)]
    processor: Processor,
    #[command(flatten)]
    labels: Labels,
    /// Say what the data lack, and train nothing.
    #[arg(long)]
    check: bool,
    /// Go on from where an interrupted call with the same data and configuration stopped.
    #[arg(long)]
    resume: bool,
    /// A figure that must be reached on what was held out, in SI units, e.g. `position_rms<=0.0005`; may be repeated.
    #[arg(long)]
    require: Vec<Requirement>,
    /// One JSON object instead of tables.
    #[arg(long)]
    json: bool,
    /// Labelled bags to learn from.
    #[arg(required = true)]
    bags: Vec<PathBuf>,
}

/// Flags over the file.
fn configuration(options: &Options) -> Result<TrainConfig, LearnError> {
    let mut config = match (&options.config, &options.targets) {
        (Some(path), _) => TrainConfig::load(path)?,
        (None, Some(_)) => TrainConfig::from_toml("targets = [\"contact\"]", "flags")?,
        (None, None) => {
            return Err(LearnError::Config {
                file: "flags".into(),
                field: "--config".into(),
                reason: "is missing: name a file (examples lie in `launch/train/`) or `--targets`".into(),
            });
        }
    };
    if let Some(targets) = &options.targets {
        config.targets.clone_from(targets);
    }
    if let Some(candidates) = &options.candidates {
        config.model.candidates.clone_from(candidates);
    }
    if let Some(hidden) = &options.hidden {
        config.network.hidden.clone_from(hidden);
    }
    config.network.members = options.members.unwrap_or(config.network.members);
    config.training.epochs = options.epochs.unwrap_or(config.training.epochs);
    config.training.seed = options.seed.unwrap_or(config.training.seed);
    config.split.kind = options.split.unwrap_or(config.split.kind);
    config.split.fraction = options.fraction.unwrap_or(config.split.fraction);
    config.validate("flags and configuration")?;
    Ok(config)
}

/// Finds the forward model of a skin, whose description lies at the path.
pub type FindModel<'a> = &'a dyn Fn(&Path, &SkinDescription) -> Result<Arc<dyn ForwardModel>, String>;

/// Reads the bags, says what they lack, trains, and prints the figures. `find` gives the forward model where a target needs
/// it.
///
/// # Errors
///
/// [`LearnError`] says what is wrong with configuration, data or files, or that a requirement is missed.
pub fn train(
    options: &Options,
    find: Option<FindModel<'_>>,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let config = configuration(options)?;
    check_framework(&config)?;
    options.processor.check(&config)?;
    let skin = SkinDescription::load(&options.skin)?;
    let how = options.labels.options()?;
    let data = Dataset::survey(&options.bags, &skin, &how)?;
    let findings = data.check(&config.scalars(), config.baseline, &config.split);
    if findings.is_fatal() {
        return Err(LearnError::Unfit(findings).into());
    }
    let mut notices = findings.notices();
    let mut others = Vec::new();
    for path in &options.test {
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let other = Dataset::from_bags(&[path], &skin, &how)?;
        notices.extend(other.notices());
        others.push((name, other));
    }
    for notice in notices {
        eprintln!("note: {notice}");
    }
    eprintln!(
        "learning {} from {} labelled frames at {} locations; held out: {}",
        config.outputs().join(", "),
        data.labelled().count(),
        data.locations(),
        config.split.describe()
    );
    let Some(out) = options.out.as_deref().filter(|_| !options.check) else { return Ok(()) };

    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))?;
    let threads = options
        .threads
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get));
    let request = Request {
        data: &data,
        others: &others,
        config: &config,
        model: forward_model(options, &config, &skin, find)?,
        out,
        resume: options.resume,
        threads,
        processor: options.processor,
        runtime: Runtime::load(&RuntimeConfig::default())?,
    };
    let bars = bars(&config)?;
    let outcome = run(&request, &stop, &|p: Progress| {
        if let Some(bar) = bars.get(p.member as usize) {
            bar.set_position(u64::from(p.epoch));
            bar.set_message(format!("{:.5}", p.loss));
        }
    })?;
    for bar in &bars {
        bar.finish_and_clear();
    }
    Ok(report(options, out, &outcome)?)
}

/// The forward model, where a map is learned.
fn forward_model(
    options: &Options,
    config: &TrainConfig,
    skin: &SkinDescription,
    find: Option<FindModel<'_>>,
) -> Result<Option<Arc<dyn ForwardModel>>, LearnError> {
    let Some(find) = find.filter(|_| !config.maps().is_empty()) else { return Ok(None) };
    match find(&options.skin, skin) {
        Ok(model) => Ok(Some(model)),
        // Forces are spread without a model, too.
        Err(_) if !config.maps().into_iter().any(MapTarget::needs_model) => Ok(None),
        Err(reason) => Err(LearnError::Training { reason }),
    }
}

/// A progress bar for each network; they hide themselves where no one watches.
fn bars(config: &TrainConfig) -> Result<Vec<ProgressBar>, Box<dyn std::error::Error + Send + Sync>> {
    let all = MultiProgress::new();
    let style =
        ProgressStyle::with_template("network {prefix}: {bar:30} epoch {pos}/{len}, loss {msg}, {eta} left")?;
    Ok((0..config.network.members)
        .map(|member| {
            let bar = all.add(ProgressBar::new(u64::from(config.training.epochs)));
            bar.set_style(style.clone());
            bar.set_prefix((member + 1).to_string());
            bar
        })
        .collect())
}

/// Prints the figures, and fails where a requirement is missed.
fn report(options: &Options, out: &Path, outcome: &Outcome) -> Result<(), LearnError> {
    let verdicts = Verdicts::of(&options.require, &outcome.held_out);
    if options.json {
        let others: serde_json::Map<String, serde_json::Value> =
            outcome.others.iter().map(|(name, e)| (name.clone(), e.to_json())).collect();
        let result = json!({
            "bundle": out,
            "samples": outcome.samples,
            "every": outcome.every,
            "seconds": outcome.seconds,
            "held_out": outcome.held_out.to_json(),
            "other_runs": others,
            "requirements": verdicts,
            "choice": outcome.choice,
        });
        println!("{result}");
    } else {
        if let Some(choice) = &outcome.choice {
            print!("{choice}");
        }
        print!("held out: {}", outcome.held_out);
        for (_, evaluation) in &outcome.others {
            print!("{evaluation}");
        }
        print!("{verdicts}");
        if outcome.every > 1 {
            println!(
                "learned from one of {} labelled frames, because all of them would take more than 4 GiB",
                outcome.every
            );
        }
        println!(
            "{} samples in {:.0} s; bundle and report in {}",
            outcome.samples,
            outcome.seconds,
            out.display()
        );
    }
    verdicts.require()
}
