//! `dermis-barodome`: one skin of taxels in an elastic medium as a ROS 2 node.

use std::process::ExitCode;

fn main() -> ExitCode {
    dermis_perception::cli::program(dermis_barodome::FAMILY, "dermis-barodome", env!("CARGO_PKG_VERSION"))
}
