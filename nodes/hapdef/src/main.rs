//! `dermis-hapdef`: one shell with strain gauges as a ROS 2 node.

use std::process::ExitCode;

fn main() -> ExitCode {
    dermis_perception::cli::program(dermis_hapdef::FAMILY, "dermis-hapdef", env!("CARGO_PKG_VERSION"))
}
