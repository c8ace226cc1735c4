//! Measurements of speed, each against a named peer in the same run; results lie in `benches/results/`.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use clap::{Args, ValueEnum};

use crate::environment;
use crate::programs;
use crate::record;
use crate::run::{cargo, run as execute, target_dir};
use crate::test::{ROS_IN_PROGRAM, build_aside};

/// What can be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Name {
    /// Bytes on a line → message at a subscriber in another process, against rclpy and ONNX Runtime, and a chain in C.
    Node,
    /// First pressed frame → stop message at another process, against a subscriber of rclpy.
    Reflex,
    /// Samples per second of the forward model, against numpy and scipy.
    Model,
    /// Factor and loads of a shell, against CHOLMOD and CalculiX, and samples per second of its forward model.
    Shell,
    /// How close shells on ever finer triangles come to solids, by both theories, and what that costs: minutes, with CalculiX.
    ShellStudy,
    /// Frames per second of the panel of fabric, against scipy and pyEIT.
    Ert,
    /// Pictures per second of the soft thumb, against Taxim; beside real frames where `DERMIS_DATA` names the folder of the recordings.
    Insight,
    /// Merging the contacts of a body in one process, against the same in numpy and scipy.
    Fusion,
    /// Eight skins at 1 kHz and the fusion, each a process, against a fusion in rclpy and numpy.
    Body,
    /// Diagnosis of ten thousand contacts on 784 channels, on an analytic skin.
    Gap,
    /// The node of the limb at its rate, by the bundles for one and for two contacts.
    Limb,
    /// The node of the soft thumb at its camera's rate.
    Thumb,
    /// Publishing with and without a subscriber.
    Publish,
    /// Recording, against the disk.
    Recording,
    /// Half an hour of four skins and a recorder.
    Soak,
}

impl Name {
    /// What it is called by `dermis-bench`, too.
    fn text(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Name of its record in `benches/results/`.
    pub fn record(self) -> String {
        match self {
            // Beside the records of what is diagnosed.
            Self::Gap => "gap-speed".to_owned(),
            _ => self.text(),
        }
    }
}

/// Which, and how.
#[derive(Args)]
pub struct Options {
    /// Measurements; all but the long one where none is named.
    pub names: Vec<Name>,
    /// Arguments for the measurement, after `--`; `cargo xtask bench NAME -- --help` lists them.
    #[arg(last = true)]
    arguments: Vec<String>,
}

const PROGRAMS: [&str; 3] = ["dermis", "dermis-train", "dermis-bench"];

/// Builds what is measured, measures, and keeps the results.
pub fn run(root: &Path, options: &Options) -> Result<()> {
    let names = match options.names.as_slice() {
        [] => {
            vec![
                Name::Model,
                Name::Shell,
                Name::Ert,
                Name::Insight,
                Name::Fusion,
                Name::Body,
                Name::Node,
                Name::Reflex,
                Name::Limb,
                Name::Thumb,
                Name::Publish,
                Name::Recording,
            ]
        }
        names => names.to_vec(),
    };
    let clients = environment::clients(root)?;
    let ros = environment::ros(root)?;
    let programs = programs::built(root, &PROGRAMS)?;
    for name in names {
        let text = &name.text();
        let mut command = Command::new(programs.join("dermis-bench"));
        if matches!(name, Name::Node | Name::Reflex | Name::Body) {
            let aside = build_aside(&programs, &PROGRAMS, || {
                let mut c = cargo(root);
                let mut features = ROS_IN_PROGRAM.map(str::to_owned);
                features[1].push_str(",dermis-benches/ros2");
                execute(c.args(["build", "--release", "--bins"]).args(features).envs(ros.variables()))
            })?;
            command = Command::new(aside.join("dermis-bench"));
            command.envs(ros.variables()).arg(text);
            command.arg("--programs").arg(&programs).arg("--ros-programs").arg(&aside);
            command.arg("--ros-python").arg(&ros.variables()["DERMIS_ROS_PYTHON"]);
            if matches!(name, Name::Node | Name::Body) {
                // The interpreter lies in `bin` of its environment.
                let venv = clients.ancestors().nth(2).unwrap_or(root);
                command.arg("--peer-packages").arg(environment::site_packages(venv)?);
            }
        } else {
            command.arg(text);
            peers(root, name, &programs, &clients, &mut command)?;
        }
        // Without the telemetry of ONNX Runtime in the peers.
        command.current_dir(root).env("DERMIS_BIN", &programs).env("ORT_DISABLE_TELEMETRY", "1");
        let file = target_dir(root).join(format!("bench-{text}.json"));
        // Of a run that was interrupted.
        if file.exists() {
            std::fs::remove_file(&file)?;
        }
        command.arg("--out").arg(&file);
        execute(command.args(&options.arguments))?;
        record::take(root, &name.record(), &file)?;
    }
    Ok(())
}

/// Where a measurement without ROS 2 finds the programs that it starts, and the peers that it measures beside; those that cannot be
/// installed are left out, and named.
fn peers(root: &Path, name: Name, programs: &Path, clients: &Path, command: &mut Command) -> Result<()> {
    if matches!(name, Name::Limb | Name::Thumb) {
        command.arg("--programs").arg(programs);
    }
    if name == Name::Soak {
        command.arg("--plot").arg(record::path(root, &name.record()).with_extension("svg"));
    }
    if matches!(name, Name::Model | Name::Fusion) {
        command.arg("--peer-python").arg(clients);
    }
    if name == Name::Ert {
        match environment::pyeit(root) {
            Ok(python) => _ = command.arg("--peer-python").arg(python),
            Err(why) => eprintln!("scipy and pyEIT are left out, they cannot be installed: {why:#}"),
        }
    }
    if name == Name::Insight {
        if let Some(data) = std::env::var_os("DERMIS_DATA") {
            command.arg("--frames").arg(Path::new(&data).join("insight_frames"));
        }
        match environment::taxim(root) {
            Ok(python) => _ = command.arg("--peer-python").arg(python),
            Err(why) => eprintln!("Taxim is left out, it cannot be installed: {why:#}"),
        }
    }
    if matches!(name, Name::Shell | Name::ShellStudy)
        && let Some(why) = environment::calculix()
    {
        eprintln!("{why}");
    }
    if name == Name::Shell {
        match environment::cholmod(root)? {
            Some(python) => _ = command.arg("--peer-python").arg(python),
            None => eprintln!("CHOLMOD is left out: apt-get install libsuitesparse-dev libopenblas0-pthread"),
        }
    }
    Ok(())
}
