//! Every test, from formatting to ROS 2.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, anyhow};
use clap::Args;

use crate::advisories;
use crate::environment::{self, Ros};
use crate::lints;
use crate::run::{cargo, output, run as execute, step, target_dir};

/// What to leave out.
#[derive(Args)]
pub struct Options {
    /// Leave out what needs ROS 2: nothing is downloaded for it.
    #[arg(long)]
    no_ros: bool,
    /// Leave out formatting, lints and licences.
    #[arg(long)]
    no_lint: bool,
    /// Also the tests that need minutes and the machine to themselves: the long run, the listener that hangs, and the meshes of a shell. They
    /// measure latency and memory, so that this builds as --release does.
    #[arg(long)]
    nightly: bool,
    /// Build as the program ships, which takes twice as long; otherwise what computes is optimised, nothing else, and assertions are checked.
    #[arg(long)]
    release: bool,
    /// Only tests whose name contains this; without formatting, lints and licences, and with ROS 2 in the program only where one of its
    /// tests is among them.
    filter: Option<String>,
}

/// Everything but the crate that needs ROS 2 headers.
const WITHOUT_ROS: [&str; 3] =
    ["--workspace", "--exclude=dermis-node-r2r", "--features=dermis-learn/train,dermis-node/test-suite"];

/// Everything; the program still without ROS 2, as it ships.
pub const WITH_ROS: [&str; 2] =
    ["--workspace", "--features=dermis-learn/train,dermis-node/test-suite,dermis-node-r2r/test-suite"];

/// Everything, with ROS 2 in the program, too. The selection is that of [`WITH_ROS`], so that no dependency is built twice.
pub const ROS_IN_PROGRAM: [&str; 2] = [
    "--workspace",
    "--features=dermis-learn/train,dermis-node/test-suite,dermis-node-r2r/test-suite,dermis/ros2",
];

/// Programs and tests in one go: apart, their dependencies differ in features and are built twice.
const BUILD: [&str; 3] = ["build", "--bins", "--tests"];

/// What is linted: examples and benches, too.
const LINTED: [&str; 2] = ["build", "--all-targets"];

/// What the tests with ROS 2 need: nothing else is linked once more.
const BUILD_ROS: [&str; 4] = ["build", "--bin=dermis", "--bin=dermis-train", "--test=ros2"];

/// Adds the selection where ROS 2 is set up, with its environment, and [`WITHOUT_ROS`] where it is not.
pub fn select(command: &mut Command, selection: [&str; 2], ros: Option<&Ros>) {
    match ros {
        Some(ros) => command.args(selection).envs(ros.variables()),
        None => command.args(WITHOUT_ROS),
    };
}

pub fn run(root: &Path, options: &Options) -> Result<()> {
    let mut skipped = Vec::new();
    let lint = !options.no_lint && options.filter.is_none();
    if options.no_lint {
        skipped.push("formatting, lints and licences (--no-lint)".to_owned());
    }
    if lint {
        step("formatting", || execute(cargo(root).args(["fmt", "--all", "--check"])))?;
    }
    let (clients, ros) = set_up(root, options, lint, &mut skipped)?;
    let built = Built { root, options, ros, clients };
    step("build", || execute(&mut built.everything(&BUILD)))?;
    if lint {
        step("lints", || lints::run(&target_dir(root), &mut built.with_ros_in_program(&LINTED)))?;
    }
    if options.nightly {
        // A workspace of its own, with parts of crates by the paths of their files.
        let manifest = "--manifest-path=fuzz/Cargo.toml";
        step("fuzz targets compile", || execute(cargo(root).args(["check", "--workspace", manifest])))?;
    }
    built.test(&mut skipped)?;
    if skipped.is_empty() {
        println!("all tests passed, nothing skipped");
    } else {
        println!("all tests passed; skipped: {}", skipped.join("; "));
    }
    Ok(())
}

/// Makes all that tests need besides what is built here, and checks dependencies where `lint` is asked for; the Python with clients, and
/// ROS 2.
fn set_up(
    root: &Path,
    options: &Options,
    lint: bool,
    skipped: &mut Vec<String>,
) -> Result<(PathBuf, Option<Ros>)> {
    std::thread::scope(|threads| {
        // It is built on one core while the other unpacks what was downloaded and builds ROS 2 messages.
        let deny = lint.then(|| threads.spawn(|| advisories::tool(root)));
        let clients = prepare(root, skipped)?;
        let ros = if options.no_ros {
            skipped.push("ROS 2 (--no-ros)".to_owned());
            None
        } else {
            Some(step("ROS 2", || environment::ros(root))?)
        };
        if let Some(deny) = deny {
            step("licences and sources", || {
                deny.join().map_err(|_| anyhow!("the thread that installs cargo-deny panicked"))??;
                licences(root)
            })?;
            skipped.extend(step("advisories", || advisories::check(root))?);
        }
        Ok((clients, ros))
    })
}

/// Checks licences and sources of all crates.
fn licences(root: &Path) -> Result<()> {
    // Crates of every platform: cargo builds with those of this one only, and has no others.
    execute(cargo(root).args(["fetch", "--locked", "--quiet"]))?;
    execute(cargo(root).args(["deny", "--offline", "check", "licenses", "bans", "sources"]))
}

/// Installs what tests run, and says what stays untested without it; the Python with clients.
fn prepare(root: &Path, skipped: &mut Vec<String>) -> Result<PathBuf> {
    step("test runner", || environment::subcommand(root, "nextest", "0.9.143"))?;
    step("system packages", || {
        environment::system_packages();
        Ok(())
    })?;
    skipped.extend(step("CalculiX", || Ok(environment::calculix()))?);
    skipped.extend(step("Chromium", || Ok(environment::chromium()))?);
    step("Python clients", || environment::clients(root))
}

/// Everything that can be built here, in the environment that it needs.
struct Built<'a> {
    root: &'a Path,
    options: &'a Options,
    ros: Option<Ros>,
    clients: PathBuf,
}

impl Built<'_> {
    /// Whether programs and tests are built as the program ships.
    fn as_shipped(&self) -> bool {
        self.options.release || self.options.nightly
    }

    fn cargo(&self, selection: [&'static str; 2], arguments: &[&str]) -> Command {
        let mut c = cargo(self.root);
        c.args(arguments);
        if self.as_shipped() {
            c.arg("--release");
        }
        select(&mut c, selection, self.ros.as_ref());
        c
    }

    fn everything(&self, arguments: &[&str]) -> Command {
        self.cargo(WITH_ROS, arguments)
    }

    fn with_ros_in_program(&self, arguments: &[&str]) -> Command {
        self.cargo(ROS_IN_PROGRAM, arguments)
    }

    /// Runs what was built, and what needs ROS 2 in the program after it.
    fn test(&self, skipped: &mut Vec<String>) -> Result<()> {
        let Self { root, options, .. } = *self;
        let data = std::env::var("DERMIS_DATA")
            .unwrap_or_else(|_| root.join("../shared/data").display().to_string());
        if !Path::new(&data).is_dir() {
            skipped.push(format!("tests on recordings: {data} is missing (set DERMIS_DATA)"));
        }
        let programs = target_dir(root).join(if self.as_shipped() { "release" } else { "debug" });
        // One more than there are cores: of the tests across processes, a few at a time, many wait rather than compute.
        let threads = std::env::var("NEXTEST_TEST_THREADS").unwrap_or_else(|_| {
            let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
            (cores + 1).to_string()
        });
        let nextest = |mut c: Command, programs: &Path, which: &str| {
            c.env("NEXTEST_TEST_THREADS", &threads).env("ORT_DISABLE_TELEMETRY", "1");
            c.env("DERMIS_CLIENT_PYTHON", &self.clients);
            c.env("DERMIS_DATA", &data).env("DERMIS_BIN", programs);
            execute(c.args(["-E", which, "--no-tests=pass"]).args(&options.filter))
        };
        let profile = if options.nightly {
            "--profile=nightly"
        } else {
            skipped.push(
                "the long run, the listener that hangs and the meshes of a shell (--nightly)".to_owned(),
            );
            "--profile=default"
        };
        let tests = ["nextest", "run", profile];
        step("tests", || nextest(self.everything(&tests), &programs, "not binary(ros2)"))?;
        if options.filter.is_none() {
            let arguments = ["test", "--doc", "--quiet"];
            step("documentation tests", || execute(&mut self.everything(&arguments)))?;
        }
        if self.ros.is_some() && self.any_with_ros()? {
            let programs = step("build with ROS 2", || {
                build_aside(&programs, &["dermis", "dermis-train"], || {
                    execute(&mut self.with_ros_in_program(&BUILD_ROS))
                })
            })?;
            let tests = [&tests[..], &["--test=ros2"]].concat();
            step("tests with ROS 2", || {
                nextest(self.with_ros_in_program(&tests), &programs, "binary(ros2)")
            })?;
        }
        Ok(())
    }

    /// Whether a test that needs ROS 2 in the program is among those to be run. The list is of what was built without it.
    fn any_with_ros(&self) -> Result<bool> {
        let Some(filter) = &self.options.filter else { return Ok(true) };
        let mut list = self.everything(&["nextest", "list", "--message-format=oneline"]);
        Ok(!output(list.args(["-E", "binary(ros2)", filter]))?.trim().is_empty())
    }
}

/// Builds programs into the folder `built` and moves them into one of their own. Those that were there stay: the program with ROS 2
/// in it does not start where ROS 2 is not sourced.
pub fn build_aside(built: &Path, programs: &[&str], build: impl FnOnce() -> Result<()>) -> Result<PathBuf> {
    let (aside, kept) = (built.join("with-ros2"), built.join("without-ros2"));
    for folder in [&aside, &kept] {
        fs::create_dir_all(folder)?;
    }
    for program in programs {
        fs::copy(built.join(program), kept.join(program))?;
    }
    let done = build();
    for program in programs {
        fs::copy(built.join(program), aside.join(program))?;
        // Not over the file: cargo has linked it to its own copy.
        fs::remove_file(built.join(program))?;
        fs::copy(kept.join(program), built.join(program))?;
    }
    fs::remove_dir_all(&kept)?;
    done.map(|()| aside)
}
