//! Starting a robot's skins from one file.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_launch::{Host, LogOptions, NodeRequest, Refusal};
use dermis_node::Reach;
use dermis_operate::launching;
use dermis_perception::cli::NetworkArguments;
use serde_json::Value;

use crate::log::Format;
use crate::registry::sensors;

/// What to start.
#[derive(Args)]
pub struct Options {
    /// Launch file (YAML or TOML).
    file: PathBuf,
    /// Arguments that the file declares, `name:=value`.
    #[arg(value_name = "NAME:=VALUE")]
    arguments: Vec<String>,
    /// Check the file and show what it would start, without starting it.
    #[arg(long)]
    check: bool,
    /// With --check: show it as JSON.
    #[arg(long, requires = "check")]
    json: bool,
    #[command(flatten)]
    network: NetworkArguments,
    /// Write what each process prints to a file of its own in this folder too.
    #[arg(long)]
    log_dir: Option<PathBuf>,
    /// Lines a second of each process that are written; 0: all [default: the file's, or else 100].
    #[arg(long, value_name = "LINES/S")]
    log_rate: Option<f64>,
    /// Megabytes that a log file may have before a new one is begun; 0: any [default: the file's, or else 10].
    #[arg(long, value_name = "MB")]
    log_size: Option<f64>,
    /// Older log files of each process that are kept [default: the file's, or else 4].
    #[arg(long, value_name = "COUNT")]
    log_keep: Option<u32>,
}

/// Names the folder in which nodes keep what they want to know after a crash.
const RESTART: &str = "DERMIS_RESTART_DIR";

/// What the names of launches' folders begin with.
const FOLDER: &str = "dermis-launch-";

/// The command that is the guard of a launch.
pub const GUARD: &str = "launch-guard";

/// What [`GUARD`] is told.
#[derive(Args)]
pub struct Guarded {
    /// Folder of the launch.
    folder: PathBuf,
}

/// Ends what a launch has left, once the launch is gone: processes, and its folder.
pub fn guard(of: &Guarded) {
    dermis_launch::guard(std::io::stdin());
    let name = of.folder.file_name().map(std::ffi::OsStr::to_string_lossy);
    if name.is_some_and(|name| name.starts_with(FOLDER)) {
        // A launch that was not killed has removed it.
        let _ = std::fs::remove_dir_all(&of.folder);
    }
}

/// Runs until Ctrl-C, until a required process ends, or until all have ended.
pub async fn run(options: &Options, format: Format) -> Result<()> {
    let program = std::env::current_exe().context("the file of this program cannot be found out")?;
    let host = Dermis { program };
    let tmp =
        tempfile::Builder::new().prefix(FOLDER).tempdir().context("no temporary folder for the launch")?;
    let mut plan = dermis_launch::load(&options.file, &options.arguments, tmp.path(), &host)?;
    launching::hand_over(&options.network.choice(), &mut plan)?;
    if options.check {
        if options.json {
            println!("{:#}", plan.json());
        } else {
            print!("{}", plan.text());
        }
        return Ok(());
    }
    // A node that is killed goes on with the zero that it had.
    for process in plan.processes.iter_mut().filter(|process| process.own) {
        process.environment.insert(RESTART.to_owned(), tmp.path().display().to_string());
    }
    let mut limits = plan.log_limits.clone();
    limits.rate = options.log_rate.unwrap_or(limits.rate);
    limits.size = options.log_size.unwrap_or(limits.size);
    limits.keep = options.log_keep.unwrap_or(limits.keep);
    if let Err((field, reason)) = limits.check() {
        bail!("option --log-{field}: {reason}");
    }
    let log = LogOptions {
        format: match format {
            Format::Human => dermis_launch::Format::Human,
            Format::Json => dermis_launch::Format::Json,
        },
        colours: std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
        folder: options.log_dir.clone(),
        limits,
    };
    let mut guard = Command::new(&host.program);
    guard.arg(GUARD).arg(tmp.path());
    let ended = dermis_launch::run(&plan, &log, Some(guard)).await?;
    if !ended.failures.is_empty() {
        bail!("{}: {}", options.file.display(), ended.failures.join("; "));
    }
    Ok(())
}

/// This program, as launch files know it.
struct Dermis {
    program: PathBuf,
}

impl Host for Dermis {
    fn program(&self) -> &Path {
        &self.program
    }

    fn check(&self, arguments: &[String]) -> Result<(), String> {
        crate::parse(arguments).map(drop)
    }

    fn can_share(&self, arguments: &[String]) -> bool {
        matches!(crate::parse(arguments), Ok(crate::Command::Node(_)))
    }

    fn network(&self, text: &str) -> Result<(), String> {
        text.parse::<Reach>().map(drop).map_err(|error| error.to_string())
    }

    fn node(&self, request: &NodeRequest<'_>) -> Result<Value, Vec<Refusal>> {
        launching::config(request, sensors())
    }

    fn together(&self, nodes: &[(&str, &Value)]) -> Vec<(usize, Refusal)> {
        launching::together(nodes)
    }
}
