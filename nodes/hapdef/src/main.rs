//! `dermis-hapdef`: one shell with strain gauges as a ROS 2 node.

use std::process::ExitCode;

use clap::Parser;
use dermis_node::HirozBackend;
use dermis_perception::cli::Arguments;

/// Reads the strain gauges of a shell and publishes its contacts.
#[derive(Parser)]
#[command(version)]
struct Program {
    #[command(flatten)]
    arguments: Arguments,
}

async fn run(arguments: Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let config = arguments.into_config()?;
    Ok(dermis_hapdef::FAMILY.run(&config, &HirozBackend::default()).await?)
}

#[tokio::main]
async fn main() -> ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "info".into());
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    match run(Program::parse().arguments).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("dermis-hapdef: {error}");
            ExitCode::FAILURE
        }
    }
}
