//! Asks the linker for a smaller program, where the linker and the machine can.
//!
//! Each option is tried on a program of one line, which has to link and to run: linkers differ in what they know, and a
//! loader before glibc 2.36 cannot read packed relocations.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::{env, fs};

/// What is tried, and what it saves.
const OPTIONS: [&str; 3] = [
    // Addresses that the loader has to move, as bit maps in place of 24 bytes each.
    "-Wl,-z,pack-relative-relocs",
    // Functions of the same machine code once: copies of generic functions for types that look alike.
    "-Wl,--icf=all",
    "-Wl,-O2",
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // What is built for another machine cannot be tried on this one.
    if env::var_os("TARGET") != env::var_os("HOST") {
        return;
    }
    let folder = PathBuf::from(env::var_os("OUT_DIR").expect("cargo names the folder"));
    for option in OPTIONS {
        if works(&folder, option) {
            println!("cargo::rustc-link-arg-bins={option}");
        }
    }
    // Cargo strips only debugging information from a package that has an optimisation level of its own, whatever the
    // profile says: 20 MB of symbols stay.
    let strip = "-Wl,--strip-all";
    if env::var("PROFILE").is_ok_and(|profile| profile == "release") && works(&folder, strip) {
        println!("cargo::rustc-link-arg-bins={strip}");
    }
}

/// Whether a program of one line links with this option, and runs.
fn works(folder: &Path, option: &str) -> bool {
    let source = folder.join("one_line.rs");
    let program = folder.join("one_line");
    let compiler = env::var_os("RUSTC").expect("cargo names the compiler");
    fs::write(&source, "fn main() {}").is_ok()
        && quietly(
            Command::new(compiler).arg(&source).arg("-o").arg(&program).arg(format!("-Clink-arg={option}")),
        )
        && quietly(&mut Command::new(&program))
}

fn quietly(command: &mut Command) -> bool {
    command.stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}
