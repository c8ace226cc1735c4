//! `dermis-ert`: one panel of conductive fabric as a ROS 2 node.

use std::process::ExitCode;

fn main() -> ExitCode {
    dermis_perception::cli::program(dermis_ert::FAMILY, "dermis-ert", env!("CARGO_PKG_VERSION"))
}
