//! Fuzzing what reads bytes from outside: `fuzz/`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Args;

use crate::environment;
use crate::run::{cargo, output, run as execute};

/// What to fuzz and for how long.
#[derive(Args)]
pub struct Options {
    /// Target, see `fuzz/fuzz_targets`; all of them where absent.
    target: Option<String>,
    /// Inputs to try of each target.
    #[arg(long, default_value_t = 1_000_000)]
    runs: u64,
    /// Largest input \[bytes\].
    #[arg(long, default_value_t = 2048)]
    max_len: u32,
    /// Afterwards, keep the smallest corpus that reaches as much: `fuzz/corpus`, which tests replay.
    #[arg(long)]
    minimise: bool,
}

/// Largest corpus of a target that is committed \[bytes\].
const CORPUS_MAX: u64 = 32 * 1024;

pub fn run(root: &Path, options: &Options) -> Result<()> {
    if Command::new("c++").arg("--version").output().is_err() {
        bail!("a C++ compiler is needed, for libFuzzer (Debian: apt-get install g++)");
    }
    // No nightly toolchain: coverage counters are in every rustc, and a sanitizer has little to find in safe code.
    environment::subcommand(root, "fuzz", "0.13.2")?;
    let fuzz = root.join("fuzz");
    let listed = output(cargo(root).args(["fuzz", "list", "--fuzz-dir"]).arg(&fuzz))?;
    let mut targets: Vec<&str> = listed.lines().map(str::trim).filter(|t| !t.is_empty()).collect();
    if let Some(wanted) = &options.target {
        if !targets.contains(&wanted.as_str()) {
            bail!("there is no fuzz target `{wanted}`; the targets are {}", targets.join(", "));
        }
        targets.retain(|t| t == wanted);
    }
    let arguments = ["fuzz", "build", "-O", "--sanitizer", "none", "--fuzz-dir"];
    execute(cargo(root).args(arguments).arg(&fuzz).args(&options.target))?;
    let programs = programs(root, &fuzz)?;
    let mut rates = BTreeMap::new();
    for target in targets {
        rates.insert(target, one(&fuzz, &programs, target, options)?);
    }
    println!("{}", serde_json::json!({ "runs": options.runs, "runs_per_second": rates }));
    Ok(())
}

/// Where cargo puts the targets, which cargo-fuzz builds for a named platform.
fn programs(root: &Path, fuzz: &Path) -> Result<PathBuf> {
    let text = output(Command::new("rustc").arg("-vV").current_dir(root))?;
    let host = text.lines().find_map(|l| l.strip_prefix("host: ")).context("rustc names no host")?;
    let target = match std::env::var_os("CARGO_TARGET_DIR") {
        Some(dir) => root.join(dir),
        None => fuzz.join("target"),
    };
    Ok(target.join(host).join("release"))
}

/// Runs one target; returns how many inputs it tried a second.
fn one(fuzz: &Path, programs: &Path, target: &str, options: &Options) -> Result<f64> {
    let corpus = fuzz.join("corpus").join(target);
    let found = fuzz.join("artifacts").join(target);
    let grown = fuzz.join("target/corpus").join(target);
    let scratch = scratch(fuzz).join(format!("dermis-fuzz-{}", std::process::id()));
    for folder in [&corpus, &found, &grown, &scratch] {
        fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    }
    let program = || {
        let mut c = Command::new(programs.join(target));
        c.env("TMPDIR", &scratch).args(["-rss_limit_mb=2048", "-malloc_limit_mb=1024", "-timeout=10"]);
        c.arg(format!("-max_len={}", options.max_len));
        c
    };
    let begun = Instant::now();
    // New inputs go into the first folder; the committed ones are read only.
    let done = execute(
        program()
            .arg(format!("-runs={}", options.runs))
            .arg(format!("-artifact_prefix={}/", found.display()))
            .arg("-print_final_stats=1")
            .args([&grown, &corpus]),
    );
    let seconds = begun.elapsed().as_secs_f64();
    let rate = options.runs as f64 / seconds;
    let done = done.and_then(|()| {
        println!("{target}: {} runs in {seconds:.0} s, {rate:.0} a second", options.runs);
        if options.minimise { minimise(&program, &corpus, &grown) } else { Ok(()) }
    });
    // Nothing but files of one input lies there.
    let _ = fs::remove_dir_all(&scratch);
    done.map(|()| rate).with_context(|| {
        format!(
            "target `{target}` found an input in {}; put it into {} with its fix, so that it stays fixed",
            found.display(),
            corpus.display()
        )
    })
}

/// Files of one input are written and read again in memory where the system offers that.
fn scratch(fuzz: &Path) -> PathBuf {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { memory.to_owned() } else { fuzz.join("target") }
}

/// Adds to the committed corpus what reaches more than it does, the smallest first, as long as there is room.
fn minimise(program: &dyn Fn() -> Command, corpus: &Path, grown: &Path) -> Result<()> {
    let least = grown.with_extension("least");
    if least.exists() {
        fs::remove_dir_all(&least)?;
    }
    fs::create_dir_all(&least)?;
    execute(program().args(["-merge=1", "-verbosity=0"]).args([&least, &grown.to_path_buf()]))?;
    let mut files = Vec::new();
    for entry in fs::read_dir(&least)? {
        let path = entry?.path();
        files.push((fs::metadata(&path)?.len(), path));
    }
    files.sort();
    let mut room = CORPUS_MAX;
    for entry in fs::read_dir(corpus)? {
        room = room.saturating_sub(entry?.metadata()?.len());
    }
    for (length, path) in files {
        let Some(left) = room.checked_sub(length) else { break };
        let to = corpus.join(path.file_name().context("a file has a name")?);
        if !to.exists() {
            fs::copy(&path, to)?;
            room = left;
        }
    }
    Ok(())
}
