//! Running other programs, with an error that says which one failed.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, bail};

/// The repository's root.
pub fn root() -> Result<PathBuf> {
    let manifest = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    manifest.parent().map(Path::to_owned).context("xtask lies outside of a workspace")
}

/// Runs to the end; anything but success is an error that names the command.
pub fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("{} cannot be started", show(command)))?;
    if !status.success() {
        bail!("{} ended with {status}", show(command));
    }
    Ok(())
}

/// Standard output of a command that succeeded.
pub fn output(command: &mut Command) -> Result<String> {
    let out = command.output().with_context(|| format!("{} cannot be started", show(command)))?;
    if !out.status.success() {
        bail!("{} ended with {}:\n{}", show(command), out.status, String::from_utf8_lossy(&out.stderr));
    }
    Ok(String::from_utf8(out.stdout)?)
}

/// `cargo` as this xtask was started with, in the repository's root.
pub fn cargo(root: &Path) -> Command {
    let mut c = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    c.current_dir(root);
    without_own_variables(&mut c);
    // Subcommands that were installed for this repository.
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&path).chain([root.join(".dermis/tools/bin")]);
    if let Ok(path) = std::env::join_paths(folders) {
        c.env("PATH", path);
    }
    c
}

/// Takes away what `cargo xtask` sets for this program. A build script that asks for one of these variables (ring's does) would run
/// again whenever cargo is called now from here and now by hand, and everything above it be compiled again.
pub fn without_own_variables(command: &mut Command) {
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            command.env_remove(&name);
        }
    }
}

/// Where cargo puts what it builds.
pub fn target_dir(root: &Path) -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR") {
        Some(dir) => root.join(dir),
        None => root.join("target"),
    }
}

/// Runs one step of a longer command and prints how long it took.
pub fn step<T>(name: &str, f: impl FnOnce() -> Result<T>) -> Result<T> {
    println!("## {name}");
    let start = Instant::now();
    let result = f().with_context(|| format!("step \"{name}\" failed"))?;
    println!("## {name}: {:.0} s", start.elapsed().as_secs_f64());
    Ok(result)
}

fn show(command: &Command) -> String {
    let mut text = command.get_program().to_string_lossy().into_owned();
    for arg in command.get_args() {
        text.push(' ');
        text.push_str(&arg.to_string_lossy());
    }
    text
}
