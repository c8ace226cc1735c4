//! `dermis-fusion`: the skins of a robot, merged, as a ROS 2 node.

use std::process::ExitCode;

use clap::{Args, Command, FromArgMatches};
use dermis_fusion::cli::{ABOUT, Arguments};
use dermis_node::HirozBackend;

fn main() -> ExitCode {
    let command = Command::new("dermis-fusion").version(env!("CARGO_PKG_VERSION")).about(ABOUT);
    dermis_perception::cli::node_program(Arguments::augment_args(command), |matches| {
        let config = Arguments::from_arg_matches(matches)?.into_config()?;
        let runtime = tokio::runtime::Runtime::new()?;
        Ok(runtime.block_on(dermis_fusion::run(&config, &HirozBackend::default()))?)
    })
}
