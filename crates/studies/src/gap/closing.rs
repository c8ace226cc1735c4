//! The whole loop: diagnose, correct the simulation, train on it, and see how the estimator does on the real recording.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, ValueEnum as _};
use dermis_gap::{Diagnosis, Downstream};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::diagnosis;
use crate::refinement::UnknownsChoice;

/// What to close, and with which estimator to see it.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
// clap names the group of options after the type, and the diagnosis' has that name.
#[group(skip)]
pub struct Request {
    /// The diagnosis.
    #[command(flatten)]
    pub diagnose: diagnosis::Request,
    /// Plan that training data are simulated by; with --config the estimator is trained twice: on the nominal and on the
    /// corrected simulation.
    #[arg(long, requires = "config")]
    pub plan: Option<PathBuf>,
    /// Training configuration; see launch/train/.
    #[arg(long, requires = "plan")]
    pub config: Option<PathBuf>,
    /// Refine both estimators on their forward models, too: what is looked for in each contact.
    #[arg(long, requires = "plan", value_enum)]
    pub refine: Option<UnknownsChoice>,
    /// Held-out real bag that both estimators are measured on; the diagnosed one where absent.
    #[arg(long, value_name = "BAG")]
    pub held_out: Option<PathBuf>,
}

/// Runs the program with these arguments; what it prints.
pub type Run<'a> = &'a dyn Fn(&[String]) -> Result<String>;

/// What was simulated and trained on, in `out` beside the corrected skin `skin.toml`: its effect on an estimator goes into the
/// report. Nothing happens where no plan is named, or nothing was found that could be switched on.
///
/// # Errors
///
/// Where a command fails.
pub fn close(options: &Request, out: &Path, found: &mut Diagnosis, run: Run<'_>) -> Result<()> {
    let (Some(plan), Some(config)) = (&options.plan, &options.config) else { return Ok(()) };
    if found.report.corrected.is_empty() {
        return Ok(());
    }
    let Some(bag) = options.held_out.as_ref().or(options.diagnose.real.first()) else { return Ok(()) };
    if options.held_out.is_none() {
        found.report.warnings.push(
            "the estimator was measured on the recording that was diagnosed; pass --held-out another one"
                .to_owned(),
        );
    }
    let before = estimator(&options.diagnose.skin, plan, config, &out.join("nominal"), bag, options, run)?;
    let after = estimator(&out.join("skin.toml"), plan, config, &out.join("corrected"), bag, options, run)?;
    let which = if options.held_out.is_some() { "a held-out real recording" } else { "the real recording" };
    for (name, metric) in [
        ("position_rms", "root mean square error of the position [m]"),
        ("position_median", "median error of the position [m]"),
        ("force_normal_rms", "root mean square error of the pressing force [N]"),
        ("force_normal_median", "median error of the pressing force [N]"),
        ("missed", "share of missed contacts [1]"),
    ] {
        if let (Some(before), Some(after)) = (figure(&before, name), figure(&after, name)) {
            let metric = format!("estimator on {which}: {metric}");
            found.report.downstream.push(Downstream { metric, before, after });
        }
    }
    Ok(())
}

fn figure(evaluation: &Value, name: &str) -> Option<f64> {
    evaluation.get("figures")?.get(name)?.as_f64()
}

/// Simulates, trains and evaluates with the commands that people use.
fn estimator(
    skin: &Path,
    plan: &Path,
    config: &Path,
    folder: &Path,
    real: &Path,
    options: &Request,
    dermis: Run<'_>,
) -> Result<Value> {
    std::fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let (bag, model) = (folder.join("bag"), folder.join("model"));
    let path = |p: &Path| p.display().to_string();
    let seed = options.diagnose.seed.to_string();
    let collected =
        ["collect", &path(skin), "--plan", &path(plan), "--seed", &seed, "--resume", "--out", &path(&bag)];
    dermis(&collected.map(str::to_owned))?;
    // The model is one of the design: a corrected skin may have its taxels elsewhere.
    let trained =
        ["train", "--skin", &path(skin), "--config", &path(config), "--out", &path(&model), &path(&bag)];
    dermis(&trained.map(str::to_owned))?;
    if let Some(unknowns) = &options.refine {
        let unknowns = unknowns.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
        let refined =
            ["refine", "--skin", &path(skin), "--model", &path(&model), "--unknowns", &unknowns, &path(&bag)];
        dermis(&refined.map(str::to_owned))?;
    }
    let mut evaluate =
        ["evaluate", "--skin", &path(skin), "--model", &path(&model), "--json"].map(str::to_owned).to_vec();
    if let Some(map) = &options.diagnose.map {
        evaluate.extend(["--map".to_owned(), path(map)]);
    }
    evaluate.push(path(real));
    let text = dermis(&evaluate)?;
    serde_json::from_str(&text).context("`dermis evaluate --json` did not print JSON")
}
