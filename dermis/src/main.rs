//! `dermis`: the tactile-skin stack on the command line. See `dermis --help` and the README.

mod backend;
mod bags;
mod bridge;
mod bundle;
mod collect;
mod compare;
mod demo;
mod design;
mod device;
mod doctor;
mod effects;
mod evaluate;
mod export;
mod figures;
mod foreign;
mod gap;
mod launch;
mod log;
mod manual;
mod nodes;
mod place;
mod play;
mod quantity;
mod real2sim;
mod record;
mod refine;
mod registry;
mod schema;
mod skins;
mod stats;
mod steps;
mod table;
mod theory;
mod train;
mod variation;
mod verify;
mod watch;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use dermis_io::pipe::ReaderGone;

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
    /// Run the node of a skin of taxels in an elastic medium: raw bytes in, contacts out.
    Barodome(Box<nodes::Skin>),
    /// Run the node of a shell with strain gauges: raw bytes in, contacts out.
    Hapdef(Box<nodes::Skin>),
    /// Start what a launch file names, keep it running, and gather what it says.
    Launch(launch::Options),
    #[command(name = launch::GUARD, hide = true)]
    LaunchGuard,
    /// Show what running skins feel, whoever started them.
    Watch(watch::Options),
    /// Offer every skin in the ROS domain as JSON over zenoh, for clients that know no ROS.
    Bridge(bridge::Options),
    /// Put a simulated skin, or a recorded one, behind a pseudo-terminal.
    #[command(subcommand)]
    Device(device::Device),
    /// Turn other people's recordings into labelled bags.
    Import(bags::Import),
    /// Let the virtual testbed press a simulated skin, and record a labelled bag.
    Collect(collect::Options),
    /// Learn contacts from labelled bags, and write a model bundle (program dermis-train).
    #[command(disable_help_flag = true)]
    Train(train::Options),
    /// Have a bundle's answers refined on the skin's forward model, where recordings show that this helps.
    Refine(refine::Options),
    /// Measure model bundles on labelled bags; exits with 1 where a requirement is missed.
    Evaluate(evaluate::Options),
    /// Compare estimators with each other and with the bound on what was held out.
    Compare(compare::Options),
    /// Several contacts from few readings by way of a simulation, beside other ways to them.
    #[command(name = "real2sim", subcommand)]
    Real2Sim(real2sim::Real2Sim),
    /// Make model bundles of models that were trained elsewhere.
    #[command(subcommand)]
    Bundle(bundle::Bundle),
    /// Record what is published into a bag.
    Record(Box<record::Options>),
    /// Publish what a bag holds.
    Play(Box<play::Options>),
    /// Look into a bag, check, mend and cut it.
    #[command(subcommand)]
    Bag(bags::Bag),
    /// How well a skin can know a contact at best, from its forward model or a recording.
    Theory(theory::Options),
    /// Check the physics of a sensor family against closed forms and other programs; exits with 1 where a case fails.
    Verify(verify::Options),
    /// What makes a device differ from its design: the effects that a sensor family knows.
    Effects(effects::Options),
    /// Where to put sensing elements, of thousands of places where they could be.
    Place(place::Options),
    /// Where a simulated skin and a real one differ, which effect makes them, and how far it closes the gap.
    #[command(subcommand)]
    Gap(gap::Gap),
    /// What a skin would gain from being built otherwise: depth, thickness, pitch, material, noise.
    Design(design::Options),
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

fn main() -> ExitCode {
    // The program starts itself once more for each model that it has to try.
    if let Some(code) = dermis_inference::trial::serve() {
        return code;
    }
    dermis_io::pipe::end_quietly();
    let cli = Cli::parse();
    let level = match cli.command {
        Command::Barodome(_) | Command::Hapdef(_) | Command::Bridge(_) | Command::Device(_) => "info",
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
    let done = match cli.command {
        Command::Demo(options) => demo::run(&options),
        Command::Barodome(options) => block_on(nodes::run(&dermis_barodome::FAMILY, *options)),
        Command::Hapdef(options) => block_on(nodes::run(&dermis_hapdef::FAMILY, *options)),
        Command::Watch(options) => block_on(watch::run(options)),
        Command::Bridge(options) => block_on(bridge::run(options)),
        Command::Device(device) => device::run(&device),
        Command::Launch(options) => block_on(launch::run(&options, format)),
        Command::LaunchGuard => {
            launch::guard();
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
        Command::Record(options) => block_on(record::run(*options)),
        Command::Play(options) => block_on(play::run(*options)),
        Command::Bag(bag) => bags::run(&bag),
        Command::Theory(options) => theory::run(&options),
        Command::Verify(options) => verify::run(&options),
        Command::Effects(options) => effects::run(&options),
        Command::Place(options) => place::run(&options),
        Command::Gap(gap) => gap::run(&gap),
        Command::Design(options) => design::run(&options),
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
            // What was asked for is there, but not all of it.
            if error.is::<record::Incomplete>() { ExitCode::from(3) } else { ExitCode::FAILURE }
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
}
