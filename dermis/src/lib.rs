//! `dermis`: the tactile-skin stack on the command line. See `dermis --help` and the README.
//!
//! The program is a library so that another one can be the same with sensor families of its own: [`run`] takes the families.
//!
//! ```no_run
//! use dermis_sensor::Registry;
//!
//! static FAMILIES: Registry = Registry::new(&[/* one line for each family */]);
//!
//! fn main() -> std::process::ExitCode {
//!     dermis::run(&FAMILIES)
//! }
//! ```

mod backend;
mod bags;
mod bounds;
mod bridge;
mod bundle;
mod collect;
mod compare;
mod container;
mod demo;
mod device;
mod doctor;
mod effects;
mod evaluate;
mod export;
mod fusion;
mod gap;
mod interrupt;
mod launch;
mod log;
mod manual;
mod nodes;
mod output;
mod placement;
mod play;
mod real2sim;
mod record;
mod refine;
mod reflex;
mod registry;
mod schema;
mod skins;
mod steps;
mod sweep;
mod table;
mod train;
mod validate;
mod watch;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use dermis_io::pipe::ReaderGone;
use dermis_operate::OperateError;
use dermis_sensor::Registry;

#[derive(Parser)]
#[command(
    name = "dermis",
    version,
    about = "Tactile skins for ROS 2: where, how hard and in which direction a robot is touched"
)]
struct Cli {
    /// How log lines are written; `DERMIS_LOG_FORMAT` says it where this does not.
    #[arg(long, global = true, value_enum)]
    log_format: Option<log::Format>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// A simulated skin behind a pseudo-terminal, the node that reads it, and a table of what it feels.
    Demo(demo::Options),
    #[command(flatten)]
    Node(container::Node),
    /// Run several nodes in one process, where a message from one to another crosses no socket.
    Container(container::Options),
    /// Start what a launch file names, keep it running, and gather what it says.
    Launch(launch::Options),
    #[command(name = launch::GUARD, hide = true)]
    LaunchGuard(launch::Guarded),
    /// Show what running skins feel, whoever started them.
    Watch(watch::Options),
    /// Put a simulated skin, or a recorded one, behind a pseudo-terminal.
    #[command(subcommand)]
    Device(device::Device),
    /// Turn other people's recordings into labelled bags.
    Import(bags::Import),
    /// Let the virtual testbed press a simulated skin, and record a labelled bag.
    Collect(collect::Options),
    /// Learn contacts from labelled bags, and write a model bundle.
    ///
    /// The bundle is measured on what was held out of the bags, and on other bags given with `--test`. Ctrl-C saves the
    /// state; the same command with `--resume` goes on. Flags override the configuration file.
    Train(Box<train::Options>),
    /// Have a bundle's answers refined on the skin's forward model, where recordings show that this helps.
    Refine(refine::Options),
    /// Measure model bundles on labelled bags; exits with 1 where a requirement is missed.
    Evaluate(evaluate::Options),
    /// Compare estimators with each other and with the bound on what was held out.
    Compare(compare::Options),
    /// Several contacts from few readings by way of a simulation, beside other ways to them.
    #[command(name = "real2sim", subcommand)]
    Real2Sim(real2sim::Real2Sim),
    /// Make model bundles of models that were trained elsewhere, or of two bundles.
    #[command(subcommand)]
    Bundle(bundle::Bundle),
    /// Publish what a bag holds.
    Play(Box<play::Options>),
    /// Look into a bag, check, mend and cut it.
    #[command(subcommand)]
    Bag(bags::Bag),
    /// How well a skin can know a contact at best, from its forward model or a recording.
    #[command(alias = "theory")]
    Bounds(bounds::Options),
    /// Check the physics of a sensor family against closed forms and other programs; exits with 1 where a case fails.
    #[command(alias = "verify")]
    Validate(validate::Options),
    /// What makes a device differ from its design: the effects that a sensor family knows.
    Effects(effects::Options),
    /// Where to put sensing elements, of thousands of locations where they could be.
    #[command(alias = "place")]
    OptimizePlacement(Box<placement::Options>),
    /// Where a simulated skin and a real one differ, which effect makes them, and how far that reduces the difference.
    #[command(subcommand)]
    Gap(gap::Gap),
    /// What a skin would gain from being built otherwise: depth, thickness, pitch, material, noise.
    #[command(alias = "design")]
    Sweep(sweep::Options),
    /// Check a skin description and say what it describes.
    Skin(skins::Options),
    /// What this machine offers: inference runtimes, serial devices, ROS 2.
    Doctor(doctor::Options),
    /// Print the completion script of a shell.
    Completions(manual::Completions),
    /// Write man pages of every command into a folder.
    Man(manual::Man),
    /// Print the JSON schema of a kind of file, for editors that complete and check it.
    Schema(schema::Options),
    /// Print every command as Markdown, for the book.
    #[command(hide = true)]
    Reference,
}

/// The families that ship.
pub use registry::SHIPPED;

/// The whole of the program, with these sensor families; its exit status.
#[must_use]
pub fn run(sensors: &'static Registry) -> ExitCode {
    // The program starts itself once more for each model that it has to try.
    if let Some(code) = dermis_inference::trial::serve() {
        return code;
    }
    dermis_io::pipe::end_quietly();
    registry::choose(sensors);
    let cli = Cli::parse();
    let level = match cli.command {
        Command::Node(container::Node::Record(_)) => "warn",
        Command::Node(_) | Command::Container(_) | Command::Device(_) => "info",
        _ => "warn",
    };
    let format = match log::Format::choose(cli.log_format) {
        Ok(format) => format,
        Err(sentence) => {
            eprintln!("dermis: {sentence}");
            return ExitCode::FAILURE;
        }
    };
    let limit = log::start(format, level);
    // What a model computes once is kept for every command; nodes receive it by their parameters.
    dermis_skin::cache::use_folder(dermis_skin::cache::usual_folder());
    let done = match cli.command {
        Command::Demo(options) => demo::run(&options),
        Command::Node(node) => block_on(node.run_alone()),
        Command::Watch(options) => block_on(watch::run(options)),
        Command::Device(device) => device::run(&device),
        Command::Container(options) => block_on(container::run(options)),
        Command::Launch(options) => block_on(launch::run(&options, format)),
        Command::LaunchGuard(of) => {
            launch::guard(&of);
            Ok(())
        }
        Command::Import(import) => bags::import(&import),
        Command::Collect(options) => collect::run(&options),
        Command::Train(options) => train::run(&options),
        Command::Refine(options) => refine::run(&options),
        Command::Evaluate(options) => evaluate::run(&options),
        Command::Compare(options) => compare::run(&options),
        Command::Real2Sim(command) => real2sim::run(&command),
        Command::Bundle(bundle) => bundle::run(&bundle),
        Command::Play(options) => block_on(play::run(*options)),
        Command::Bag(bag) => bags::run(&bag),
        Command::Bounds(options) => bounds::run(&options),
        Command::Validate(options) => validate::run(&options),
        Command::Effects(options) => effects::run(&options),
        Command::OptimizePlacement(options) => placement::run(&options),
        Command::Gap(gap) => gap::run(&gap),
        Command::Sweep(options) => sweep::run(&options),
        Command::Skin(options) => skins::run(&options),
        Command::Doctor(options) => doctor::run(&options),
        Command::Completions(options) => {
            manual::completions(Cli::command(), &options);
            Ok(())
        }
        Command::Man(options) => manual::man(Cli::command(), &options),
        Command::Schema(options) => schema::run(&options),
        Command::Reference => {
            manual::reference(Cli::command());
            Ok(())
        }
    };
    let code = match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<ReaderGone>() => dermis_io::pipe::die(),
        Err(error) => {
            report(&error, format);
            // What was requested is there, but not all of it.
            let incomplete = matches!(error.downcast_ref(), Some(OperateError::Incomplete(_)));
            if incomplete { ExitCode::from(3) } else { ExitCode::FAILURE }
        }
    };
    limit.finish();
    code
}

/// One sentence, then its causes, each once: a cause that its effect already quotes is not repeated.
fn report(error: &anyhow::Error, format: log::Format) {
    let mut sentences = vec![error.to_string()];
    for cause in error.chain().skip(1) {
        let text = cause.to_string();
        if sentences.last().is_some_and(|said| !said.contains(&text)) {
            sentences.push(text);
        }
    }
    match format {
        log::Format::Human => eprintln!("dermis: {}", sentences.join("\n  because ")),
        log::Format::Json => tracing::error!("{}", sentences.join(", because ")),
    }
}

/// The command that these arguments are; one sentence where they are none.
fn parse(arguments: &[String]) -> Result<Command, String> {
    let all = std::iter::once("dermis").chain(arguments.iter().map(String::as_str));
    Cli::try_parse_from(all).map(|cli| cli.command).map_err(|error| {
        let text = error.to_string();
        let sentence = text.split("\nUsage:").next().unwrap_or_default();
        let sentence = dermis_io::one_line(sentence);
        format!("`dermis {}`: {}", arguments.join(" "), sentence.trim_start_matches("error: "))
    })
}

/// Runs asynchronous work on a runtime of its own.
fn block_on<T>(work: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?.block_on(work)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_node_is_run_by_its_skin_or_by_its_family() {
        let node = |arguments: &[&str]| match Cli::try_parse_from(arguments).map(|cli| cli.command) {
            Ok(Command::Node(container::Node::Skin(_))) => Ok(()),
            Ok(_) => Err("another command".to_owned()),
            Err(error) => Err(error.to_string()),
        };
        node(&["dermis", "run", "pad.toml", "--source", "udp://0.0.0.0:7400"]).unwrap();
        node(&["dermis", "run", "--config", "pad.yaml"]).unwrap();
        node(&["dermis", "barodome", "--skin", "pad.toml", "--source", "udp://0.0.0.0:7400"]).unwrap();
        assert!(node(&["dermis", "run", "--source", "udp://0.0.0.0:7400"]).unwrap_err().contains("SKIN"));
        assert!(node(&["dermis", "barodom"]).unwrap_err().contains("barodome"));
    }

    #[test]
    fn commands_go_by_their_old_names_too() {
        let of = |words: &[&str]| -> Vec<String> {
            let matches = Cli::command().try_get_matches_from(words).unwrap();
            let mut names = Vec::new();
            let mut at = Some(&matches);
            while let Some((name, below)) = at.and_then(clap::ArgMatches::subcommand) {
                names.push(name.to_owned());
                at = Some(below);
            }
            names
        };
        let old = |word: &'static str, new: &str, old: &'static str| if word == new { old } else { word };
        assert_eq!(of(&["dermis", "theory", "a.toml", "--line"]), ["bounds"]);
        assert_eq!(of(&["dermis", "design", "a.toml", "--vary", "depth"]), ["sweep"]);
        assert_eq!(of(&["dermis", "place", "a.toml", "--method", "crlb"]), ["optimize-placement"]);
        assert_eq!(of(&["dermis", "verify", "baro"]), ["validate"]);
        let run = ["--set", "p", "--truth", "s", "--out", "o"];
        let generate = ["--skin", "a.toml", "--seed", "1", "--truth", "s", "--out", "o"];
        let (old_run, old_generate) =
            (run.map(|w| old(w, "--set", "--pack")), generate.map(|w| old(w, "--truth", "--secret")));
        let with = |words: &[&'static str], more: &[&'static str]| of(&[words, more].concat());
        assert_eq!(with(&["dermis", "gap", "benchmark", "run"], &run), ["gap", "benchmark", "run"]);
        assert_eq!(with(&["dermis", "gap", "check"], &old_run), ["gap", "check"]);
        assert_eq!(
            with(&["dermis", "gap", "benchmark", "generate"], &generate),
            ["gap", "benchmark", "generate"]
        );
        assert_eq!(with(&["dermis", "gap", "make-pack"], &old_generate), ["gap", "make-pack"]);
    }

    /// Otherwise a target whose command is none would be found out only when it is measured again.
    #[test]
    fn commands_that_measure_targets_are_commands() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../targets.toml");
        let targets: toml::Table = std::fs::read_to_string(file).unwrap().parse().unwrap();
        let mut parsed = 0;
        for target in targets["target"].as_array().unwrap() {
            for command in target["command"].as_str().unwrap().split(" && ") {
                let ours = ["cargo run --release --quiet -- ", "dermis "];
                let Some(arguments) = ours.iter().find_map(|start| command.strip_prefix(start)) else {
                    // Tests of xtask try these.
                    assert!(
                        command.starts_with("cargo xtask "),
                        "`{command}` is no command of this repository"
                    );
                    continue;
                };
                let words: Vec<String> = arguments.split_whitespace().map(str::to_owned).collect();
                if let Err(why) = parse(&words) {
                    panic!("{}: {why}", target["name"]);
                }
                parsed += 1;
            }
        }
        assert!(parsed > 10, "{parsed} commands");
    }

    #[test]
    fn help_speaks_of_the_new_names_only() {
        let mut all = Cli::command();
        let help = all.render_long_help().to_string();
        for (old, new) in [
            ("theory", "bounds"),
            ("design", "sweep"),
            ("place", "optimize-placement"),
            ("verify", "validate"),
        ] {
            let listed = |name: &str| help.lines().any(|l| l.trim_start().split(' ').next() == Some(name));
            assert!(listed(new) && !listed(old), "{help}");
        }
    }

    /// A request that a file names and one that a command line names have the same defaults.
    #[test]
    fn requests_read_alike_from_files_and_command_lines() {
        use dermis_operate::{device, play, record, slice};
        use dermis_studies::{bounds, comparison, evaluation, gap, placement, real2sim, refinement, sweep};
        use serde::{Serialize, de::DeserializeOwned};

        #[derive(clap::Parser)]
        struct Line<R: clap::Args> {
            #[command(flatten)]
            request: R,
        }

        fn same<R: clap::Args + Serialize + DeserializeOwned>(words: &[&str], file: &serde_json::Value) {
            let words = std::iter::once(&"dermis").chain(words);
            let line = Line::<R>::try_parse_from(words).map_err(|e| e.to_string()).unwrap().request;
            let file: R = serde_json::from_value(file.clone()).unwrap();
            assert_eq!(serde_json::to_value(line).unwrap(), serde_json::to_value(file).unwrap());
        }

        let skin = serde_json::json!({ "skin": "a" });
        same::<bounds::Request>(&["a"], &skin);
        same::<sweep::Request>(&["a"], &skin);
        same::<placement::Request>(&["a"], &skin);
        same::<real2sim::table::Request>(&["a"], &skin);
        let models = serde_json::json!({ "skin": "a", "model": ["m"], "bags": ["b"] });
        let words = ["--skin", "a", "--model", "m", "b"];
        same::<comparison::Request>(&words, &models);
        same::<evaluation::Request>(&words, &models);
        same::<refinement::Request>(&words, &serde_json::json!({ "skin": "a", "model": "m", "bags": ["b"] }));
        let gap = serde_json::json!({ "skin": "a", "real": ["b"] });
        same::<gap::diagnosis::Request>(&["--skin", "a", "--real", "b"], &gap);
        same::<gap::closing::Request>(
            &["--skin", "a", "--real", "b"],
            &serde_json::json!({ "diagnose": gap }),
        );
        let presses = serde_json::json!({ "skin": "a", "presses": ["b"] });
        same::<gap::calibration::Request>(&["--skin", "a", "--presses", "b"], &presses);
        let made = serde_json::json!({ "skin": "a", "seed": 3, "truth": "s", "out": "o" });
        let words = ["--skin", "a", "--seed", "3", "--truth", "s", "--out", "o"];
        same::<gap::generation::Request>(&words, &made);
        let pressed = serde_json::json!({ "skin": "a", "plan": "p", "out": "o" });
        same::<dermis_operate::collect::Request>(&["a", "--plan", "p", "--out", "o"], &pressed);
        same::<record::Request>(&["-o", "b"], &serde_json::json!({ "out": "b" }));
        same::<play::Request>(&["b"], &serde_json::json!({ "bag": "b" }));
        let part = serde_json::json!({ "bag": "b", "out": "o", "split_time": 60.0 });
        same::<slice::Request>(&["b", "-o", "o", "--split-time", "1min"], &part);
        same::<device::Simulation>(&["a"], &skin);
        let replayed = serde_json::json!({ "skin": "a", "bag": "b" });
        same::<device::Replay>(&["--skin", "a", "b"], &replayed);
        let sets = serde_json::json!({ "set": ["p"], "out": "o" });
        same::<gap::benchmark::Request>(&["--set", "p", "--out", "o"], &sets);
        let old = serde_json::json!({ "pack": ["p"], "secret": ["s"], "out": "o" });
        same::<gap::benchmark::Request>(&["--pack", "p", "--truth", "s", "--out", "o"], &old);
        let compared = serde_json::json!({ "skin": "a", "train": ["t"], "bags": ["b"] });
        same::<real2sim::compare::Request>(&["--skin", "a", "--train", "t", "b"], &compared);
        same::<real2sim::thesis::Request>(&["--skin", "a", "--train", "t", "b"], &compared);
    }
}
