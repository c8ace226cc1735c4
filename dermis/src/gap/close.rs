//! The whole loop: diagnose, correct the simulation, train on it, and see how the estimator does on the real recording.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum as _};
use dermis_gap::Downstream;
use serde_json::Value;

use super::Diagnose;
use crate::refine::Looked;

/// What to close, and with which estimator to see it.
#[derive(Args, Clone)]
pub struct Close {
    #[command(flatten)]
    diagnose: Diagnose,
    /// Plan that training data are simulated by; with --config the estimator is trained twice: on the nominal and on the
    /// corrected simulation.
    #[arg(long, requires = "config")]
    plan: Option<PathBuf>,
    /// Training configuration; see launch/train/.
    #[arg(long, requires = "plan")]
    config: Option<PathBuf>,
    /// Refine both estimators on their forward models, too: what is looked for in each contact.
    #[arg(long, requires = "plan", value_enum)]
    refine: Option<Looked>,
    /// Held-out real bag that both estimators are measured on; the diagnosed one where absent.
    #[arg(long, value_name = "BAG")]
    held_out: Option<PathBuf>,
}

/// Closes the gap.
pub fn run(options: &Close) -> Result<()> {
    let Some(out) = options.diagnose.out.clone() else {
        bail!("name the folder for the corrected skin and the report: --out DIR");
    };
    let mut found = super::diagnose(&options.diagnose)?;
    super::write(&out, &found)?;
    if found.report.corrected.is_empty() {
        eprintln!("note: nothing was found that could be switched on: the simulation stays as it is");
    } else if let (Some(plan), Some(config)) = (&options.plan, &options.config) {
        let bag = options.held_out.as_ref().unwrap_or(&options.diagnose.real[0]);
        if options.held_out.is_none() {
            found.report.warnings.push(
                "the estimator was measured on the recording that was diagnosed; pass --held-out another one"
                    .to_owned(),
            );
        }
        let before = estimator(&options.diagnose.skin, plan, config, &out.join("nominal"), bag, options)?;
        let after = estimator(&out.join("skin.toml"), plan, config, &out.join("corrected"), bag, options)?;
        let which =
            if options.held_out.is_some() { "a held-out real recording" } else { "the real recording" };
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
        super::write(&out, &found)?;
    }
    super::print(&found.report, options.diagnose.json)
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
    options: &Close,
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

/// Runs this program with other arguments; what it prints.
fn dermis(arguments: &[String]) -> Result<String> {
    let program = std::env::current_exe().context("this program does not know where it lies")?;
    eprintln!("dermis {}", arguments.join(" "));
    let output = Command::new(&program)
        .args(arguments)
        .stderr(std::process::Stdio::inherit())
        .output()
        .with_context(|| format!("{} cannot be started", program.display()))?;
    if !output.status.success() {
        bail!("`dermis {}` failed", arguments.join(" "));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
