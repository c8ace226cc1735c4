//! The program with the sensor families that ship.

use std::process::ExitCode;

fn main() -> ExitCode {
    dermis::run(&dermis::SHIPPED)
}
