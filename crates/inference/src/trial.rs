//! A trial of each model before it is used: in a process of its own, that may take so much memory and time and no more.
//!
//! The problem: a graph of some hundred bytes can ask for gigabytes, or for hours, when it is loaded or run, and no runtime has a
//! budget for that. So a program starts itself once more, hands the graph over, and has the other process load it and run it on
//! plausible inputs. That process limits its address space and its processor time (`setrlimit`) before it looks at the graph, and is
//! killed when its time is up. Only a graph that lives through this, and answers finite numbers, is loaded where a skin is read.
//!
//! A program offers this by calling [`serve`] first in its `main`. In one that does not, graphs are checked without a process of their
//! own: by their length and that of their constants, and by their operators: those whose result may be of any size are refused. What
//! passed its trial once is remembered where results are kept ([`dermis_skin::cache`]), by graph, runtime, limits and program.

use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, ExitCode, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use dermis_skin::cache::{self, Key};
use serde::{Deserialize, Serialize};

use crate::interface::Interface;
use crate::limits::Limits;
use crate::model::{Model, ModelError};
use crate::onnx;
use crate::runtime::Runtime;
use crate::runtime_config::{RuntimeChoice, RuntimeConfig};

/// First argument of a program that is started to try a model.
const ARGUMENT: &str = "__try-model";
/// Exit status of a trial whose model was refused with a sentence.
const REFUSED: u8 = 3;
/// \[bytes\] of what a trial says that are kept.
const SENTENCE_MAX: u64 = 4096;
/// Longest time between two looks at whether a trial has ended.
const TICK: Duration = Duration::from_millis(5);

/// The program that trials are run by.
static PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// A trial's input, besides the graph's bytes.
#[derive(Debug, Serialize, Deserialize)]
struct Request {
    interface: Interface,
    ranges: Vec<[f32; 2]>,
    runtime: RuntimeConfig,
    limits: Limits,
    bytes: u64,
}

/// A graph to be tried.
#[derive(Debug, Clone, Copy)]
pub struct Candidate<'a> {
    /// The bytes of its file.
    pub graph: &'a [u8],
    /// What goes in and what comes out.
    pub interface: &'a Interface,
    /// Between what its first inputs plausibly lie; all others are normalised readings.
    pub ranges: &'a [[f32; 2]],
}

/// Makes this program one that tries models in processes of their own. Call it first in `main`: where the program was started for a
/// trial, that is done, and the exit code is the one to end with.
#[must_use]
pub fn serve() -> Option<ExitCode> {
    let first: Option<OsString> = std::env::args_os().nth(1);
    if first.is_some_and(|argument| argument == ARGUMENT) {
        return Some(attempt());
    }
    // By this link the program is found even after its file was replaced.
    let link = PathBuf::from("/proc/self/exe");
    let program = if link.exists() { Some(link) } else { std::env::current_exe().ok() };
    if let Some(program) = program {
        // A second call changes nothing.
        let _ = PROGRAM.set(program);
    }
    None
}

/// Looks at the constants of a graph and, where this program [serves](serve) trials, has another process try it.
///
/// # Errors
///
/// [`ModelError`] says why it is not to be loaded.
pub fn check(runtime: &Runtime, candidate: &Candidate<'_>, limits: &Limits) -> Result<(), ModelError> {
    let Candidate { graph, interface, ranges } = *candidate;
    onnx::check(graph, interface)?;
    onnx::check_constants(graph, limits.constant_bytes)?;
    let Some(program) = PROGRAM.get() else { return Ok(()) };
    let depends = (crate::bundle::hash(graph), interface, ranges, runtime.report(), limits);
    let key = || Key::new("trial").debug(&depends);
    if !cache::noted(key()) {
        attempt_elsewhere(Command::new(program).arg(ARGUMENT), runtime, candidate, limits)?;
        cache::note("that a model passed its trial", key());
    }
    Ok(())
}

/// Loads a graph after its trial, and rehearses it.
pub(crate) fn load(
    runtime: &Runtime,
    candidate: &Candidate<'_>,
    limits: &Limits,
) -> Result<Model, ModelError> {
    check(runtime, candidate, limits)?;
    if PROGRAM.get().is_none()
        && let Some(operator) = onnx::unbounded(candidate.graph)
    {
        return Err(ModelError::Unbounded { operator });
    }
    let mut model = Model::load(runtime, candidate.graph, candidate.interface)?;
    model.rehearse(candidate.ranges)?;
    Ok(model)
}

/// Runs a trial in another process.
fn attempt_elsewhere(
    command: &mut Command,
    runtime: &Runtime,
    candidate: &Candidate<'_>,
    limits: &Limits,
) -> Result<(), ModelError> {
    let Candidate { graph, interface, ranges } = *candidate;
    let failed = |reason: String| ModelError::Trial { reason };
    let report = runtime.report();
    let choice = if report.path.is_some() { RuntimeChoice::Native } else { RuntimeChoice::Embedded };
    let request = Request {
        interface: interface.clone(),
        ranges: ranges.to_vec(),
        runtime: RuntimeConfig { choice, library: report.path.clone() },
        limits: *limits,
        bytes: graph.len() as u64,
    };
    let mut head = serde_json::to_vec(&request).map_err(|e| failed(e.to_string()))?;
    head.push(b'\n');
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| failed(format!("no process could be started for it: {e}")))?;
    let (input, output) = (child.stdin.take(), child.stdout.take());
    let (status, said) = std::thread::scope(|scope| {
        // A process that reads nothing must not hold this one up.
        scope.spawn(move || {
            if let Some(mut input) = input {
                // One that ends early has its reason, which it says by its status.
                let _ = input.write_all(&head).and_then(|()| input.write_all(graph));
            }
        });
        let listener = scope.spawn(move || {
            let mut said = String::new();
            if let Some(output) = output {
                let _ = output.take(SENTENCE_MAX).read_to_string(&mut said);
            }
            said
        });
        let status = wait(&mut child, Duration::from_secs(limits.seconds));
        (status, listener.join().unwrap_or_default())
    });
    match status.map_err(|e| failed(e.to_string()))? {
        Some(status) => evaluate(status, said.trim(), limits),
        None => Err(failed(format!(
            "it took more than {} s to load and run, and was ended; export a smaller model, or raise `seconds` of \
             `model_limits`",
            limits.seconds
        ))),
    }
}

/// Waits for the end of a trial, `None` where its time is up and it was killed.
fn wait(child: &mut Child, most: Duration) -> std::io::Result<Option<ExitStatus>> {
    let begun = Instant::now();
    loop {
        let ended = child.try_wait();
        match ended {
            Ok(Some(status)) => return Ok(Some(status)),
            Ok(None) if begun.elapsed() < most => std::thread::sleep(TICK),
            Ok(None) | Err(_) => {
                // It may have ended just now.
                let _ = child.kill();
                child.wait()?;
                return ended.map(|_| None);
            }
        }
    }
}

fn evaluate(status: ExitStatus, said: &str, limits: &Limits) -> Result<(), ModelError> {
    let reason = match status.code() {
        Some(0) => return Ok(()),
        Some(code) if code == i32::from(REFUSED) => said.to_owned(),
        _ => {
            #[cfg(unix)]
            let signal = std::os::unix::process::ExitStatusExt::signal(&status);
            #[cfg(not(unix))]
            let signal: Option<i32> = None;
            let how = match signal {
                Some(signal) => format!("it ended its process by signal {signal}"),
                None => format!("it ended its process with {status}"),
            };
            format!(
                "{how}, most likely since it wants more than {} MiB of memory or {} s; export a smaller model, or raise \
                 `memory_bytes` or `seconds` of `model_limits`",
                limits.memory_bytes >> 20,
                limits.seconds
            )
        }
    };
    Err(ModelError::Trial { reason })
}

/// The trial itself, in the process that was started for it.
fn attempt() -> ExitCode {
    let sentence = match tried() {
        Ok(()) => return ExitCode::SUCCESS,
        Err(sentence) => sentence,
    };
    // Nobody may be listening any more.
    let _ = std::io::stdout().write_all(sentence.as_bytes());
    ExitCode::from(REFUSED)
}

fn tried() -> Result<(), String> {
    let mut input = std::io::stdin().lock();
    let mut head = Vec::new();
    let mut byte = [0];
    while head.len() < 1 << 20 {
        input.read_exact(&mut byte).map_err(|e| format!("the trial received nothing: {e}"))?;
        if byte[0] == b'\n' {
            break;
        }
        head.push(byte[0]);
    }
    let request: Request =
        serde_json::from_slice(&head).map_err(|e| format!("the trial received invalid input: {e}"))?;
    let runtime = Runtime::load(&request.runtime).map_err(|e| e.to_string())?;
    let mut graph = Vec::new();
    input
        .take(request.bytes.min(request.limits.graph_bytes))
        .read_to_end(&mut graph)
        .map_err(|e| e.to_string())?;
    confine(&request.limits).map_err(|e| format!("the trial cannot be limited: {e}"))?;
    let mut model = Model::load(runtime, &graph, &request.interface).map_err(|e| e.to_string())?;
    model.rehearse(&request.ranges).map_err(|e| e.to_string())
}

/// Limits this process from here on.
#[cfg(unix)]
fn confine(limits: &Limits) -> std::io::Result<()> {
    use nix::sys::resource::{Resource, setrlimit};
    use nix::sys::signal::{SigSet, Signal};
    // A library that wants to write a file beside its work is refused, and not ended.
    let mut signals = SigSet::empty();
    signals.add(Signal::SIGXFSZ);
    signals.thread_block().map_err(std::io::Error::from)?;
    // What it dies of is of no interest as a file.
    for (resource, most) in [
        (Resource::RLIMIT_AS, limits.memory_bytes),
        (Resource::RLIMIT_CPU, limits.seconds.max(1)),
        (Resource::RLIMIT_CORE, 0),
        (Resource::RLIMIT_FSIZE, 0),
    ] {
        setrlimit(resource, most, most).map_err(std::io::Error::from)?;
    }
    Ok(())
}

#[cfg(not(unix))]
fn confine(_: &Limits) -> std::io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::GraphBuilder;

    fn runtime() -> &'static Runtime {
        Runtime::load(&RuntimeConfig { choice: RuntimeChoice::Embedded, library: None }).unwrap()
    }

    /// 1 / x: finite but where nothing touches.
    fn inverse() -> Vec<u8> {
        let mut g = GraphBuilder::new("inverse");
        let x = g.input("input", &[1, 2]);
        let one = g.constant("one", &[1, 2], &[1.0, 1.0]);
        let y = g.div(&one, &x);
        g.output("output", &y, &[1, 2]);
        g.finish().unwrap()
    }

    #[test]
    fn a_model_that_answers_no_numbers_is_refused() {
        let interface = Interface::flat(2, 2);
        let candidate = Candidate { graph: &inverse(), interface: &interface, ranges: &[] };
        let text = load(runtime(), &candidate, &Limits::default()).unwrap_err();
        insta::assert_snapshot!(text, @"answers inf to plausible readings (output 0, run 0 of its trial); train or export the model again");
    }

    #[test]
    fn without_a_process_to_try_it_in_operators_without_a_bound_are_refused() {
        let mut g = GraphBuilder::new("tile");
        let x = g.input("input", &[1, 2]);
        let n = g.constant_i64("n", &[2], &[1, 1_000_000_000]);
        let y = g.operator("Tile", &[&x, &n], &[], 1).remove(0);
        g.output("output", &y, &[1, 2]);
        let interface = Interface::flat(2, 2);
        let candidate = Candidate { graph: &g.finish().unwrap(), interface: &interface, ranges: &[] };
        let text = load(runtime(), &candidate, &Limits::default());
        insta::assert_snapshot!(text.unwrap_err(), @"has the operator `Tile`, whose result may be of any size, and this program has no process to try it in: call `dermis_inference::trial::serve` first in `main`");
    }

    fn elsewhere(program: &str, arguments: &[&str], limits: &Limits) -> Result<(), ModelError> {
        let mut command = Command::new(program);
        let interface = Interface::flat(2, 2);
        let candidate = Candidate { graph: &vec![0; 1 << 20], interface: &interface, ranges: &[] };
        attempt_elsewhere(command.args(arguments), runtime(), &candidate, limits)
    }

    #[test]
    #[ignore = "run by another test, in a process of its own"]
    fn writes_a_file_in_a_trial() {
        let Some(path) = std::env::var_os("DERMIS_WRITES") else { return };
        confine(&Limits::default()).unwrap();
        let refused = std::fs::write(path, "what a library keeps for itself").unwrap_err();
        assert_eq!(refused.kind(), std::io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn who_writes_a_file_in_a_trial_is_refused_and_not_ended() {
        let folder = tempfile::tempdir().unwrap();
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["trial::tests::writes_a_file_in_a_trial", "--exact", "--ignored"])
            .env("DERMIS_WRITES", folder.path().join("file"))
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(std::fs::read(folder.path().join("file")).unwrap(), b"");
    }

    /// With other programs in the place of ours, which read nothing of what they are sent.
    #[test]
    fn however_a_trial_ends_there_is_a_sentence() {
        let limits = Limits { seconds: 1, ..Limits::default() };
        elsewhere("true", &[], &limits).unwrap();
        let refused = |program: &str, arguments: &[&str]| {
            elsewhere(program, arguments, &limits).unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused("sh", &["-c", "echo it is no good; exit 3"]), @"failed its trial: it is no good");
        insta::assert_snapshot!(refused("sh", &["-c", "kill -9 $$"]), @"failed its trial: it ended its process by signal 9, most likely since it wants more than 2048 MiB of memory or 1 s; export a smaller model, or raise `memory_bytes` or `seconds` of `model_limits`");
        insta::assert_snapshot!(refused("sleep", &["60"]), @"failed its trial: it took more than 1 s to load and run, and was ended; export a smaller model, or raise `seconds` of `model_limits`");
        assert!(refused("/nothing/here", &[]).contains("no process could be started for it"));
    }
}
