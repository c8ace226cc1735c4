//! The edge of every program: files from outside, and standard output.
//!
//! Problem: a path that a person or another program gives may name a pipe that nobody writes to, a device without an end, or
//! a file of terabytes; and a few hundred bytes of YAML may stand for gigabytes, because an alias repeats what it names. Who
//! reads the output may stop reading. None of this may hang a program, fill the memory, or end in a panic.
//!
//! Solution: [`read`], [`read_text`], [`open`] and [`open_at_most`] take regular files only and stop at a limit that the caller names.
//! [`yaml::check`] counts what a YAML text stands for before anything is built of it. [`toml::parse`] says where in a text a value is
//! wrong. [`pipe::end_quietly`] ends a program
//! whose standard output nobody reads any more, as the shell expects it. [`machine`] tells what a measurement ran on.
//!
//! All errors are of [`std::io::Error`], so that each reader puts them into its own sentence with the path.
//!
//! ```
//! # let folder = std::env::temp_dir();
//! let error = dermis_io::read_text("/dev/zero".as_ref(), dermis_io::TEXT).unwrap_err();
//! assert!(error.to_string().starts_with("it is a character device and not a regular file"));
//! ```

mod file;
mod machine;
pub mod pipe;
pub mod toml;
pub mod yaml;

pub use file::{open, open_at_most, read, read_text};
pub use machine::{Machine, machine};

/// What another library says over several lines, for a sentence of ours.
#[must_use]
pub fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// \[bytes\] of a file that people write: descriptions, plans, maps, configurations.
pub const TEXT: u64 = 4 << 20;
/// \[bytes\] of a file that a program of ours wrote as text: a report card, a manifest, a summary.
pub const REPORT: u64 = 64 << 20;
/// \[bytes\] of a triangulated surface: two million triangles in binary.
pub const MESH: u64 = 128 << 20;
/// \[bytes\] of a table of measurements, which is held in memory.
pub const TABLE: u64 = 1 << 30;
