//! The program `dermis` with the two sensor families of the test.

use std::process::ExitCode;

fn main() -> ExitCode {
    dermis::run(&dermis_toys::SENSORS)
}
