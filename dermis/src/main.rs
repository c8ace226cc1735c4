//! The tactile-skin stack: command-line program.

fn main() {}
