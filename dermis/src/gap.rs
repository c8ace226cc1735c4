//! Where a simulated skin and a real one differ, which effect makes them, and how far that reduces the difference.

mod generate;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use dermis_gap::{Diagnosis, Report};
use dermis_report::gap as report;
use dermis_studies::gap::{benchmark, calibration, closing, diagnosis, planning};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;

use crate::output;
use crate::registry::families;
use crate::steps::Steps;

/// What to do about a gap.
#[derive(Subcommand)]
pub enum Gap {
    /// Say whether a recording of a real skin differs from its model beyond noise, where, and which effect makes that.
    Diagnose(Box<Diagnose>),
    /// Diagnose, switch on in the skin's description what was found, and train on the corrected simulation.
    Close(Box<Close>),
    /// Write the first protocol of a skin: what to press so that a diagnosis can tell causes apart.
    Plan(Plan),
    /// Design the next presses: those that best tell apart what a report leaves open.
    Next(Next),
    /// Measure on simulated devices what right names leave, and what wrong ones do: the table by which causes are called unknown.
    Calibrate(Calibrate),
    /// Check the diagnosis on recordings whose causes are withheld.
    #[command(subcommand)]
    Benchmark(Benchmark),
    /// The old name of `benchmark generate`.
    #[command(hide = true)]
    MakePack(generate::Options),
    /// The old name of `benchmark run`.
    #[command(hide = true)]
    Check(Check),
    /// Print the JSON schema of reports.
    Schema,
}

/// What to do with a benchmark.
#[derive(Subcommand)]
pub enum Benchmark {
    /// Make recordings of skins with withheld effects, and keep the effects apart.
    Generate(generate::Options),
    /// Diagnose every recording, seal the reports, then open what was withheld and score.
    Run(Check),
}

/// Which recording, and where the report goes.
#[derive(Args)]
pub struct Diagnose {
    #[command(flatten)]
    request: diagnosis::Request,
    #[command(flatten)]
    output: Output,
}

/// What to close, and where the report goes.
#[derive(Args)]
pub struct Close {
    #[command(flatten)]
    request: closing::Request,
    #[command(flatten)]
    output: Output,
}

/// Which skin, and where its first protocol goes.
#[derive(Args)]
pub struct Plan {
    #[command(flatten)]
    request: planning::PlanRequest,
    #[command(flatten)]
    output: PlanOutput,
}

/// Which report, and where the next presses go.
#[derive(Args)]
pub struct Next {
    #[command(flatten)]
    request: planning::NextRequest,
    #[command(flatten)]
    output: PlanOutput,
}

/// Along which presses, and where trials and table go.
#[derive(Args)]
pub struct Calibrate {
    #[command(flatten)]
    request: calibration::Request,
    /// File for all trials (JSON), for `--with` of another run.
    #[arg(long, value_name = "FILE")]
    trials: Option<PathBuf>,
    /// File for the table (TOML).
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// The table as one JSON object.
    #[arg(long)]
    json: bool,
}

/// Where presses to come go.
#[derive(Args)]
struct PlanOutput {
    /// Plan file to write, for `dermis collect` and `dermis device simulate`.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// File for the instructions (Markdown) that are printed otherwise.
    #[arg(long, value_name = "FILE")]
    instructions: Option<PathBuf>,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Where the report goes.
#[derive(Args)]
struct Output {
    /// Folder for report.html, report.json and the corrected skin.toml.
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The report as JSON.
    #[arg(long)]
    json: bool,
}

/// Which benchmark sets to check on.
#[derive(Args)]
pub struct Check {
    /// The scores as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    request: benchmark::Request,
}

/// Does it.
pub fn run(gap: &Gap) -> Result<()> {
    match gap {
        Gap::Diagnose(options) => {
            let found = diagnose(&options.request)?;
            if let Some(out) = &options.output.out {
                write(out, &found)?;
            }
            print(&found.report, options.output.json)
        }
        Gap::Close(options) => close(options),
        Gap::Plan(options) => {
            let found = planning::plan(&options.request, &families())?;
            planned(&options.output, &found)
        }
        Gap::Next(options) => next(options),
        Gap::Calibrate(options) => calibrate(options),
        Gap::Benchmark(Benchmark::Generate(options)) | Gap::MakePack(options) => generate::run(options),
        Gap::Benchmark(Benchmark::Run(options)) | Gap::Check(options) => check(options),
        Gap::Schema => {
            print!("{}", dermis_gap::SCHEMA_JSON);
            Ok(())
        }
    }
}

fn print(report: &Report, json: bool) -> Result<()> {
    if json {
        println!("{}", report.to_json()?);
    } else {
        print!("{}", report::text(report));
    }
    Ok(())
}

fn diagnose(request: &diagnosis::Request) -> Result<Diagnosis> {
    let progress = ProgressBar::new(0)
        .with_style(ProgressStyle::with_template("{msg} {wide_bar} {human_pos}/{human_len}, {eta} left")?);
    progress.set_message("simulating effects");
    let stop = crate::interrupt::stop_on_interrupt()?;
    let found = diagnosis::diagnose(request, &families(), progress.clone(), stop)?;
    progress.finish_and_clear();
    Ok(found)
}

/// Writes page, report and corrected skin.
fn write(out: &Path, found: &Diagnosis) -> Result<()> {
    let comment: String =
        format!("{}\n", found.report.sentence).lines().map(|line| format!("# {line}\n")).collect();
    output::save(
        out,
        &[
            ("report.json", found.report.to_json()?),
            ("report.html", report::html(&found.report)?),
            ("skin.toml", format!("{comment}{}", dermis_gap::skin_text(&found.corrected)?)),
        ],
    )
}

/// Writes trials and table, and says how well they tell unknown causes.
fn calibrate(options: &Calibrate) -> Result<()> {
    let stop = crate::interrupt::stop_on_interrupt()?;
    let write = |path: &Path, text: &str| {
        std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
    };
    let done = |count: usize| eprintln!("{count} trials");
    let made = calibration::make(&options.request, &families(), &stop, done)?;
    if let Some(path) = &options.trials {
        write(path, &serde_json::to_string(&made)?)?;
    }
    let (model, text) = calibration::table(&made)?;
    if let Some(path) = &options.table {
        write(path, &text)?;
    }
    let said = format!(
        "{} trials: causes that are left out are distinguished from known ones with an AUROC of {:.3} (cross-validated); called unknown above {:.2}, \
         firm below {:.2}\n",
        made.trials.len(),
        model.auroc,
        model.unknown,
        model.firm
    );
    output::print(options.json, &model, &said)
}

fn next(options: &Next) -> Result<()> {
    let progress = ProgressBar::new(0).with_style(ProgressStyle::with_template(
        "simulating presses to come {wide_bar} {human_pos}/{human_len}, {eta} left",
    )?);
    let stop = crate::interrupt::stop_on_interrupt()?;
    let found = planning::next(&options.request, &families(), &progress, &stop)?;
    progress.finish_and_clear();
    planned(&options.output, &found)
}

/// Writes the plan, and says what to do.
fn planned(output: &PlanOutput, found: &planning::Planned) -> Result<()> {
    let write = |path: &Path, text: &str| {
        std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
    };
    write(&output.out, &found.protocol.plan_text())?;
    let text = report::instructions(found, &output.out.display().to_string());
    if let Some(path) = &output.instructions {
        write(path, &text)?;
    }
    match &output.instructions {
        Some(path) if !output.json => {
            let (presses, minutes) = (found.presses, found.minutes);
            println!(
                "{}: {presses} presses, {minutes:.1} min; instructions in {}",
                output.out.display(),
                path.display()
            );
            Ok(())
        }
        _ => output::print(output.json, found, &text),
    }
}

fn close(options: &Close) -> Result<()> {
    let Some(out) = &options.output.out else {
        bail!("name the folder for the corrected skin and the report: --out DIR");
    };
    let mut found = diagnose(&options.request.diagnose)?;
    write(out, &found)?;
    if found.report.corrected.is_empty() {
        eprintln!("note: nothing was found that could be switched on: the simulation stays as it is");
    } else if options.request.plan.is_some() {
        closing::close(&options.request, out, &mut found, &dermis)?;
        write(out, &found)?;
    }
    print(&found.report, options.output.json)
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

/// The diagnosis of one case by this program, as anybody would call it.
fn diagnose_case(skin: &Path, bag: &Path, more: &[String]) -> Result<Vec<u8>> {
    let program = std::env::current_exe().context("this program does not know where it lies")?;
    let done = Command::new(&program)
        .args(["gap", "diagnose", "--json", "--skin"])
        .arg(skin)
        .arg("--real")
        .arg(bag)
        .args(more)
        .output()
        .context("the diagnosis cannot be started")?;
    if !done.status.success() {
        bail!("{}", String::from_utf8_lossy(&done.stderr).trim());
    }
    Ok(done.stdout)
}

fn check(options: &Check) -> Result<()> {
    let steps = Steps::stoppable("{msg} {wide_bar} {percent} %, {eta} left")?;
    let found = benchmark::run(&options.request, &families(), &diagnose_case, &steps)?;
    steps.finish();
    let scored = match found {
        benchmark::Findings::Sealed(seals) => {
            for (out, seal) in &seals {
                println!("{}: reports sealed, sha256 {seal}", out.display());
            }
            return Ok(());
        }
        benchmark::Findings::Scored(scored) => scored,
    };
    let whole = serde_json::to_value(&scored)?;
    let mut markdown = report::markdown(&scored.head, &scored.scorecard, &scored.baselines);
    for (number, scorecard) in scored.followed.iter().enumerate() {
        markdown.push_str(&format!("\n## After {} follow-ups\n{}", number + 1, scorecard.cells.table()));
    }
    let pretty = |value: &Value| Ok::<_, serde_json::Error>(serde_json::to_string_pretty(value)? + "\n");
    output::save(
        &options.request.out,
        &[
            ("scores.json", pretty(&whole)?),
            ("summary.json", pretty(&scored.summary())?),
            ("summary.md", markdown.clone()),
            ("summary.svg", report::svg(&scored.skin, &scored.scorecard, &scored.baselines)?),
        ],
    )?;
    let single: Vec<(String, String)> = scored
        .cases
        .as_array()
        .into_iter()
        .flatten()
        .map(|case| {
            let text = |key: &str| case[key].as_str().unwrap_or_default().to_owned();
            Ok((format!("{}-{}-{}.json", case["set"], text("skin"), text("case")), pretty(case)?))
        })
        .collect::<Result<_>>()?;
    let single: Vec<(&str, String)> =
        single.iter().map(|(name, text)| (name.as_str(), text.clone())).collect();
    output::save(&options.request.out.join("cases"), &single)?;
    output::print(options.json, &whole, &markdown)
}
