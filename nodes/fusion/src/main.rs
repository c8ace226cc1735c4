//! `dermis-fusion`: the skins of a robot, merged, as a ROS 2 node.

use std::process::ExitCode;

fn main() -> ExitCode {
    dermis_fusion::cli::program("dermis-fusion", env!("CARGO_PKG_VERSION"))
}
