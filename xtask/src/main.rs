//! Developer commands: `cargo xtask test` passes every test, `cargo xtask targets` measures every figure.

mod advisories;
mod bench;
mod docs;
mod environment;
mod fuzz;
mod layers;
mod lints;
mod measure;
mod mutants;
mod programs;
mod record;
mod run;
mod targets;
mod test;

use anyhow::Result;
use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Developer commands of dermis")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Set up what the tests need and run every one of them: formatting, lints, licences, unit tests, tests across
    /// processes, ROS 2.
    Test(test::Options),
    /// Set up the Python clients and ROS 2 (under .dermis/), and print the variables that point at them.
    Setup {
        /// Leave ROS 2 out.
        #[arg(long)]
        no_ros: bool,
    },
    /// Run a command with the ROS 2 environment of the tests, e.g. `cargo xtask ros -- target/debug/with-ros2/dermis demo --backend ros2`.
    Ros {
        /// The command and its arguments.
        #[arg(trailing_var_arg = true, required = true)]
        command: Vec<String>,
    },
    /// Measure the figures of targets.toml again; exits with 1 where a bound is missed.
    Targets(targets::Options),
    /// Measure speed against named peers: `benches/`.
    Bench(bench::Options),
    /// Take one measurement and print it as JSON; targets.toml names these.
    #[command(subcommand)]
    Measure(measure::Measurement),
    /// Try any bytes on what reads frames, messages, bags and configuration; see `fuzz/`.
    Fuzz(fuzz::Options),
    /// Change the code of the base crates in small ways, and say which changes no test notices; takes hours, so by night.
    Mutants(mutants::Options),
    /// Build the book under docs/, check its tables and links, or write what is generated of it.
    Docs(docs::Options),
    /// Check that imports between crates run one way.
    Layers,
    /// Check the crates that we depend on against the advisories that are known of them.
    Advisories,
}

fn main() -> Result<()> {
    if let Some(error) = lints::serve() {
        return Err(error.into());
    }
    dermis_io::pipe::end_quietly();
    let root = run::root()?;
    match Cli::parse().command {
        Command::Test(options) => test::run(&root, &options),
        Command::Setup { no_ros } => {
            environment::system_packages();
            let clients = environment::clients(&root)?;
            println!("DERMIS_CLIENT_PYTHON={}", clients.display());
            if !no_ros {
                for (name, value) in environment::ros(&root)?.variables() {
                    println!("{name}={value}");
                }
            }
            Ok(())
        }
        Command::Ros { command } => {
            let ros = environment::ros(&root)?;
            let mut it = command.iter();
            let program = it.next().map(String::as_str).unwrap_or_default();
            let mut child = std::process::Command::new(program);
            run::without_own_variables(child.args(it).envs(ros.variables()));
            let status = child.status()?;
            std::process::exit(status.code().unwrap_or(1));
        }
        Command::Targets(options) => targets::run(&root, &options),
        Command::Bench(options) => bench::run(&root, &options),
        Command::Measure(measurement) => measure::run(&root, &measurement),
        Command::Fuzz(options) => fuzz::run(&root, &options),
        Command::Mutants(options) => mutants::run(&root, &options),
        Command::Docs(options) => docs::run(&root, &options),
        Command::Layers => layers::check(&root),
        Command::Advisories => {
            advisories::tool(&root)?;
            advisories::check(&root).map(|note| note.iter().for_each(|note| println!("not checked: {note}")))
        }
    }
}
