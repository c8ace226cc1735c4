//! `dermis-bench`: measurements of speed, each against a named peer in the same run. Start it by `cargo xtask bench`.

mod body;
mod chain;
mod counts;
mod device;
mod ert;
mod fusion;
mod gap;
mod insight;
mod limb;
mod machine;
mod model;
mod node;
mod peers;
mod programs;
mod publish;
mod recording;
mod reflex;
mod restart;
mod sampling;
mod shell;
mod shell_study;
mod soak;
mod start;
mod subscriber;
mod thumb;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use serde_json::Value;

#[derive(Parser)]
#[command(name = "dermis-bench", about = "Measurements of speed")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// File for the result as JSON; it is printed as a table in any case.
    #[arg(long, global = true)]
    out: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Command {
    /// From the last byte of a frame to the message at a subscriber in another process, and frames/s per core: our node
    /// over each backend, a node of rclpy and ONNX Runtime with the same model, and a chain in C that only writes to a socket.
    Node(node::Options),
    /// From the last byte of the first pressed frame to the stop message at a subscriber in another process: our reflexes over each
    /// backend, and a subscriber of rclpy that compares forces; on the machine as it is, and beside load.
    Reflex(reflex::Options),
    /// Samples per second of the forward model with its noise, against numpy and scipy on the same table.
    Model(model::Options),
    /// A shell: its factor and loads against CHOLMOD with OpenBLAS and against CalculiX, and samples per second of its forward
    /// model, with and without maps of displacement.
    Shell(shell::Options),
    /// How close shells on ever finer triangles come to solids, by both theories, and what that costs. Needs CalculiX.
    ShellStudy(shell_study::Options),
    /// Frames per second of the panel of fabric's forward model with its noise, against scipy and pyEIT on the same sheet.
    Ert(ert::Options),
    /// Pictures per second of the soft thumb's forward model with its noise, at both sizes; with recorded frames, how their statistics
    /// compare.
    Insight(insight::Options),
    /// Eight skins at 1 kHz merged: time of an update, and how it grows with contacts; against the same fusion in numpy and scipy.
    Fusion(fusion::Options),
    /// Eight skins at 1 kHz and the fusion, each a process, and all in one; against a fusion in rclpy and numpy: from the last byte of a frame
    /// to the body's message at one more process.
    Body(body::Options),
    /// A diagnosis of ten thousand contacts on a fabric of 784 channels: seconds after its signatures are kept, and memory.
    Gap(gap::Options),
    /// The node of the limb at its rate, by the bundles that look for one and for two contacts: latency, frames without an answer,
    /// CPU time.
    Limb(limb::Options),
    /// The node of the soft thumb at its camera's rate, with one and with two contacts: frames answered per second, latency, CPU time.
    Thumb(thumb::Options),
    /// How soon contacts are known after a node was started, with an empty and with a warm cache.
    Start(start::Options),
    /// What publishing costs, with and without a subscriber.
    Publish(publish::Options),
    /// A long run of four skins and a recorder: memory, losses, latency.
    Soak(soak::Options),
    /// From `kill -9` of a node under `launch` to its contacts.
    Restart(restart::Options),
    /// What the disk takes, and the recorder on it: from its queue to the file, and over the bus.
    Recording(recording::Options),
    /// Used by the others: a process that publishes.
    #[command(hide = true)]
    RecordingSource(recording::SourceOptions),
    /// Used by the others: a subscriber process.
    #[command(hide = true)]
    Subscriber(subscriber::Options),
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let result = match cli.command {
        Command::Node(options) => node::run(&options)?,
        Command::Reflex(options) => reflex::run(&options)?,
        Command::Model(options) => model::run(&options)?,
        Command::Shell(options) => shell::run(&options)?,
        Command::ShellStudy(options) => shell_study::run(&options)?,
        Command::Ert(options) => ert::run(&options)?,
        Command::Insight(options) => insight::run(&options)?,
        Command::Fusion(options) => fusion::run(&options)?,
        Command::Body(options) => body::run(&options)?,
        Command::Gap(options) => gap::run(&options)?,
        Command::Limb(options) => limb::run(&options)?,
        Command::Thumb(options) => thumb::run(&options)?,
        Command::Start(options) => start::run(&options)?,
        Command::Publish(options) => publish::run(&options)?,
        Command::Soak(options) => soak::run(&options)?,
        Command::Restart(options) => restart::run(&options)?,
        Command::Recording(options) => recording::run(&options)?,
        Command::RecordingSource(options) => return recording::source(&options),
        Command::Subscriber(options) => return subscriber::run(&options),
    };
    let result = machine::stamp(result);
    if let Some(path) = &cli.out {
        write(path, &result)?;
    }
    println!("{result}");
    Ok(())
}

fn write(path: &std::path::Path, result: &Value) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let text = serde_json::to_string_pretty(result)? + "\n";
    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn arguments_are_consistent() {
        Cli::command().debug_assert();
    }
}
