//! Clippy on every crate of the workspace, with dependencies as the build has left them.
//!
//! Problem: `cargo clippy` first checks every dependency for its metadata, of which it takes nothing from what `cargo build` has
//! compiled. That is four fifths of its time.
//!
//! Method: cargo calls `RUSTC_WORKSPACE_WRAPPER` in place of rustc for crates of the workspace, and `cargo clippy` itself works
//! so. Here the wrapper is this program, called by `cargo build`: [`serve`] hands rustc's arguments to clippy-driver, without code
//! generation. Dependencies are those of the build, as long as features and profile are the same.
//!
//! Assumption: no crate of the workspace is a procedural macro; one would be compiled and not linted. Build scripts are.
//! Cost: cargo expects files of a compiler and finds none, so that each crate is linted anew each time.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::run::run as execute;

/// Tells this program that cargo calls it for a compiler.
const LINT: &str = "DERMIS_XTASK_LINT";

/// Runs clippy in place of each compilation of this workspace that `build`, a `cargo build`, makes; warnings are errors.
pub fn run(target: &Path, build: &mut Command) -> Result<()> {
    // A copy, because cargo may have replaced the file that this program was started from. Another run may be using an older one.
    let folder = tempfile::Builder::new().prefix("lints-").tempdir_in(target)?;
    let wrapper = folder.path().join("xtask");
    let own = env::current_exe().context("the file of this program cannot be found out")?;
    let open = if own.exists() { own } else { "/proc/self/exe".into() };
    fs::copy(&open, &wrapper).with_context(|| format!("{} cannot be copied", open.display()))?;
    execute(build.env("RUSTC_WORKSPACE_WRAPPER", &wrapper).env(LINT, "1"))
}

/// What cargo called this program for, where it did: returns only where the compiler cannot be started.
pub fn serve() -> Option<io::Error> {
    env::var_os(LINT)?;
    let mut words = env::args_os().skip(1);
    let rustc = words.next()?;
    let arguments: Vec<OsString> = words.collect();
    let mut command = if is_linted(&arguments) {
        let mut clippy = Command::new("clippy-driver");
        clippy.arg(rustc).args(arguments.into_iter().map(without_code)).args(["-D", "warnings"]);
        clippy
    } else {
        let mut compiler = Command::new(rustc);
        compiler.args(arguments);
        compiler
    };
    Some(command.exec())
}

/// Whether this is a crate, and neither a question to the compiler nor something that the build itself runs.
fn is_linted(arguments: &[OsString]) -> bool {
    let name = arguments.iter().position(|word| word == "--crate-name").and_then(|at| arguments.get(at + 1));
    let name = name.and_then(|name| name.to_str()).unwrap_or("___");
    // Cargo asks for the compiler's settings with a crate of that name.
    name != "___" && !name.starts_with("build_script_") && !arguments.iter().any(|word| word == "proc-macro")
}

/// The same argument where no code is generated: of crates that were linted before, there is metadata only.
fn without_code(argument: OsString) -> OsString {
    let Some(text) = argument.to_str() else { return argument };
    if text.starts_with("--emit=") {
        return "--emit=dep-info,metadata".into();
    }
    match text.split_once('=') {
        Some((_, file)) if file.ends_with(".rlib") && !Path::new(file).exists() => {
            Path::new(text).with_extension("rmeta").into()
        }
        _ => argument,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<OsString> {
        text.split(' ').map(OsString::from).collect()
    }

    #[test]
    fn crates_are_linted_and_what_the_build_runs_is_compiled() {
        for (arguments, linted) in [
            ("--crate-name dermis_skin --edition=2024 src/lib.rs", true),
            ("--crate-name dermis --test src/main.rs", true),
            ("--crate-name build_script_build build.rs", false),
            ("--crate-name derive --crate-type proc-macro src/lib.rs", false),
            ("- --crate-name ___ --print=file-names", false),
            ("-vV", false),
        ] {
            assert_eq!(is_linted(&words(arguments)), linted, "{arguments}");
        }
    }

    #[test]
    fn no_code_is_generated() {
        let folder = tempfile::tempdir().unwrap();
        let there = folder.path().join("libserde-1.rlib");
        fs::write(&there, "").unwrap();
        let there = format!("serde={}", there.display());
        for (argument, expected) in [
            ("--emit=dep-info,metadata,link", "--emit=dep-info,metadata"),
            ("dermis_skin=/no/libdermis_skin-2.rlib", "dermis_skin=/no/libdermis_skin-2.rmeta"),
            (there.as_str(), there.as_str()),
            ("opt-level=3", "opt-level=3"),
        ] {
            assert_eq!(without_code(argument.into()), OsString::from(expected));
        }
    }
}
