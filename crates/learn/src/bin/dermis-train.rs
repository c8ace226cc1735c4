//! `dermis train` as a program of its own.

use std::process::ExitCode;

use clap::Parser;
use dermis_learn::train::command;

/// Learn contacts from labelled bags, and write a model bundle.
///
/// The bundle is measured on what was held out of the bags, and on other bags given with `--test`. Ctrl-C saves the
/// state; the same command with `--resume` goes on. Flags override the configuration file.
#[derive(Parser)]
#[command(name = "dermis-train", version)]
struct Program {
    #[command(flatten)]
    options: command::Options,
}

fn main() -> ExitCode {
    dermis_io::pipe::end_quietly();
    match command::train(&Program::parse().options, None) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
