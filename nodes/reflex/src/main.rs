//! `dermis-reflex`: rules that act on touch, as a ROS 2 node.

use std::process::ExitCode;

use clap::{Args, Command, FromArgMatches};
use dermis_node::HirozBackend;
use dermis_reflex::cli::Arguments;

fn main() -> ExitCode {
    let about = "Act on touch: stop or slow a robot by rules on its contacts";
    let command = Command::new("dermis-reflex").version(env!("CARGO_PKG_VERSION")).about(about);
    dermis_perception::cli::node_program(Arguments::augment_args(command), |matches| {
        let arguments = Arguments::from_arg_matches(matches)?;
        if arguments.check {
            println!("{}", dermis_reflex::check(&arguments.into_config())?);
            return Ok(());
        }
        let runtime = tokio::runtime::Runtime::new()?;
        Ok(runtime.block_on(dermis_reflex::run(&arguments.into_config(), &HirozBackend::default()))?)
    })
}
