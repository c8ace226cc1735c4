//! Both runtimes, our graph writer and Python's onnx and onnxruntime agree.
//!
//! A process has one runtime, so what needs another one runs in a process of its own.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use dermis_inference::{Model, ModelError, Runtime, RuntimeChoice, RuntimeConfig, RuntimeError, RuntimeKind};

use crate::graphs::{self, Graph, Random};

const ROWS: usize = 16;

pub fn embedded() -> &'static Runtime {
    Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
}

/// \[KiB\] that are this process's own.
#[cfg(target_os = "linux")]
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

#[test]
#[cfg(target_os = "linux")]
fn a_day_of_frames_leaves_nothing_behind() {
    let graph = graphs::mlp();
    let mut model = Model::load(embedded(), &graph.bytes, &graph.interface).unwrap();
    let input = Random::new(5).take(graph.interface.input_len().unwrap());
    let mut output = Vec::new();
    let mut frames = |count: u32| (0..count).for_each(|_| model.run(&input, &mut output).unwrap());
    frames(2_000);
    let before = resident();
    frames(100_000);
    // A leak of 8 bytes a frame shows.
    let grown = resident().saturating_sub(before);
    assert!(grown < 700, "memory grew by {grown} KiB over 100 000 frames");
}

/// Runs every graph of the folder `DERMIS_WORKER` and writes its outputs and the runtime's report there.
#[test]
#[ignore = "started by the other tests, in a process of its own"]
fn worker() {
    let folder = PathBuf::from(std::env::var_os("DERMIS_WORKER").expect("started by another test"));
    let choice = match std::env::var("DERMIS_WORKER_CHOICE").unwrap().as_str() {
        "auto" => RuntimeChoice::Auto,
        "native" => RuntimeChoice::Native,
        _ => RuntimeChoice::Embedded,
    };
    let runtime = match Runtime::load(&RuntimeConfig { choice, library: None }) {
        Ok(runtime) => runtime,
        Err(e) => {
            std::fs::write(folder.join("error"), e.to_string()).unwrap();
            return;
        }
    };
    std::fs::write(folder.join("report.json"), serde_json::to_string(runtime.report()).unwrap()).unwrap();
    let suffix = match runtime.report().kind {
        RuntimeKind::Native => "native",
        RuntimeKind::Embedded => "embedded",
    };
    for graph in graphs::all() {
        let inputs = floats(&folder.join(format!("{}.in", graph.name)));
        let mut model = Model::load(runtime, &graph.bytes, &graph.interface).unwrap();
        let mut outputs = Vec::new();
        model.run_batch(&inputs, &mut outputs).unwrap();
        let bytes: Vec<u8> = outputs.iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(folder.join(format!("{}.{suffix}", graph.name)), bytes).unwrap();
        garble(runtime, &graph);
    }
}

/// A graph with wrong bytes in it is refused or runs; either way this process goes on.
fn garble(runtime: &Runtime, graph: &Graph) {
    let mut random = Random::new(23);
    let rounds = std::env::var("DERMIS_GARBLE_ROUNDS").map_or(25, |n| n.parse().unwrap());
    for _ in 0..rounds {
        let mut bytes = graph.bytes.clone();
        for _ in 0..=random.below(3) {
            let at = random.below(bytes.len());
            bytes[at] = random.below(256) as u8;
        }
        if let Ok(mut model) = Model::load(runtime, &bytes, &graph.interface) {
            let _ = model.run(&vec![0.5; model.input_len()], &mut Vec::new());
        }
    }
}

fn work(folder: &Path, choice: &str, library: Option<&Path>) -> Output {
    for graph in graphs::all() {
        std::fs::write(folder.join(format!("{}.onnx", graph.name)), &graph.bytes).unwrap();
        let count = graph.interface.input_len().unwrap() * ROWS;
        let bytes: Vec<u8> = Random::new(7).take(count).iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(folder.join(format!("{}.in", graph.name)), bytes).unwrap();
    }
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["runtimes::worker", "--exact", "--ignored", "--nocapture"])
        .env("DERMIS_WORKER", folder)
        .env("DERMIS_WORKER_CHOICE", choice)
        // Where a library's telemetry would keep its database.
        .envs([("HOME", folder.join("home")), ("XDG_CACHE_HOME", folder.join("home"))])
        .env_remove("ORT_DISABLE_TELEMETRY")
        .env_remove("ORT_DYLIB_PATH")
        .env_remove("VIRTUAL_ENV");
    if let Some(library) = library {
        command.env("ORT_DYLIB_PATH", library);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn floats(path: &Path) -> Vec<f32> {
    let bytes = std::fs::read(path).unwrap();
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

fn python() -> Option<PathBuf> {
    let python = std::env::var_os("DERMIS_CLIENT_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: DERMIS_CLIENT_PYTHON names no python with onnx, onnxruntime and numpy");
    }
    python
}

/// ONNX Runtime's library: where `ORT_DYLIB_PATH` says, or the one of the client Python.
fn native_library() -> Option<PathBuf> {
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH") {
        return Some(path.into());
    }
    let script = "import glob, os, onnxruntime as o; \
                  print(glob.glob(os.path.join(os.path.dirname(o.__file__), 'capi', 'libonnxruntime.so*'))[0])";
    let output = Command::new(python()?).args(["-c", script]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(PathBuf::from(String::from_utf8(output.stdout).unwrap().trim()))
}

#[test]
fn the_embedded_runtime_computes_what_the_graphs_say() {
    for graph in graphs::all() {
        let mut model = Model::load(embedded(), &graph.bytes, &graph.interface).unwrap();
        let mut output = Vec::new();
        let mut random = Random::new(11);
        for _ in 0..ROWS {
            let input = random.take(model.input_len());
            model.run(&input, &mut output).unwrap();
            assert_eq!(output.len(), model.output_len(), "{}", graph.name);
            let Some(oracle) = &graph.oracle else { continue };
            for (got, want) in output.iter().zip(oracle(&input)) {
                assert!((f64::from(*got) - want).abs() < 1e-5, "{}: {got} {want}", graph.name);
            }
        }
    }
}

#[test]
fn rows_of_a_batch_are_runs_one_by_one() {
    let graph = graphs::mlp();
    let mut model = Model::load(embedded(), &graph.bytes, &graph.interface).unwrap();
    let inputs = Random::new(3).take(4 * 5);
    let (mut batch, mut one, mut all) = (Vec::new(), Vec::new(), Vec::new());
    model.run_batch(&inputs, &mut batch).unwrap();
    for row in inputs.chunks(5) {
        model.run(row, &mut one).unwrap();
        all.extend_from_slice(&one);
    }
    assert_eq!(batch, all);
}

#[test]
fn inputs_that_no_model_can_take_are_refused() {
    let graph = graphs::mlp();
    let mut model = Model::load(embedded(), &graph.bytes, &graph.interface).unwrap();
    let mut output = Vec::new();
    assert_eq!(model.run(&[0.0; 4], &mut output), Err(ModelError::InputLength { got: 4, expected: 5 }));
    assert_eq!(
        model.run(&[0.0, 0.0, f32::NAN, 0.0, 0.0], &mut output),
        Err(ModelError::InputNotFinite { index: 2 })
    );
    assert!(model.run_batch(&[0.0; 7], &mut output).is_err());
}

#[test]
fn the_choice_holds_for_the_whole_process() {
    let first = embedded();
    let again = Runtime::load(&RuntimeConfig::default()).unwrap();
    assert!(std::ptr::eq(first, again));
    let other = Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Native, library: None });
    assert!(matches!(other, Err(RuntimeError::AlreadyChosen { wanted: "native", .. })));
}

#[test]
fn a_library_that_is_none_falls_back_or_is_an_error_as_configured() {
    let folder = tempfile::tempdir().unwrap();
    let broken = folder.path().join("libonnxruntime.so");
    std::fs::write(&broken, "no library").unwrap();

    work(folder.path(), "auto", Some(&broken));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("report.json")).unwrap()).unwrap();
    // Where a usable library is installed system-wide, it is the one that takes over.
    let kind = report["kind"].as_str().unwrap();
    assert!(kind == "embedded" || report["path"].is_string(), "{report}");
    assert_eq!(report["tried"][0]["path"], broken.to_str().unwrap());
    assert!(report["tried"][0]["reason"].as_str().unwrap().starts_with("cannot be loaded"), "{report}");
    if kind == "native" {
        return;
    }

    work(folder.path(), "native", Some(&broken));
    let error = std::fs::read_to_string(folder.path().join("error")).unwrap();
    assert!(error.contains(broken.to_str().unwrap()), "{error}");
    assert!(error.contains("pip install onnxruntime"), "{error}");
}

#[test]
fn native_and_embedded_agree() {
    let Some(library) = native_library() else { return };
    let folder = tempfile::tempdir().unwrap();
    work(folder.path(), "embedded", None);
    work(folder.path(), "native", Some(&library));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("report.json")).unwrap()).unwrap();
    assert_eq!(report["kind"], "native");
    assert_eq!(report["path"], library.to_str().unwrap());
    // The telemetry of versions from 1.31 on keeps a database there.
    assert!(!folder.path().join("home").exists(), "the library wrote into the user's folder");
    for graph in graphs::all() {
        let read = |suffix| floats(&folder.path().join(format!("{}.{suffix}", graph.name)));
        let (native, embedded) = (read("native"), read("embedded"));
        assert_eq!(native.len(), ROWS * graph.interface.output_len().unwrap());
        let worst = native.iter().zip(&embedded).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-5, "{}: {worst}", graph.name);
    }
}

#[test]
fn python_checks_and_computes_the_same() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    work(folder.path(), "embedded", None);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/check_models.py");
    let output = Command::new(python).arg(script).arg(folder.path()).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(text.lines().count(), graphs::all().len(), "{text}");
}
