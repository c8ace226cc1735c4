//! What ends the processes of a launch that was itself killed.
//!
//! A launch that gets SIGKILL cannot stop anything. Two things do it then, because each has a hole that the other one
//! closes:
//!
//! - A *guard*: a small process that knows the process groups of the launch and kills them once its standard input, a
//!   pipe from the launch, ends. It reaches what the processes started in turn. Somebody may kill it too: the launch
//!   then starts another one ([`Guard`]).
//! - A parent-death signal (`PR_SET_PDEATHSIG`, Linux) on each process ([`Starter`]): the kernel sends SIGKILL when the
//!   launch is gone, also where launch and guard are killed at the same moment. It reaches no grandchildren.
//!
//! The kernel counts the *thread* that started a process as its parent, so that all are started on one thread that lives
//! as long as the launch.

use std::collections::BTreeSet;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use tokio::sync::oneshot;

use crate::backoff::{Backoff, Restarts};
use crate::log::Level;

/// When a guard that ended is started again: it is never given up.
const AGAIN: Backoff = Backoff { at_once: 3, first: 0.1, most: 10.0, stable: 10.0, limit: u32::MAX };

/// Reads which process groups run (`+ID`, `-ID`, one a line) until the input ends, and kills those that still run then.
///
/// It is the whole of a small process beside a launch. The kernel closes the pipe between them however the launch ends,
/// so that `kill -9` leaves nothing behind: neither the processes that it started nor what those started in turn.
pub fn guard(input: impl Read) {
    let mut groups = BTreeSet::new();
    for line in BufReader::new(input).lines().map_while(Result::ok) {
        match (line.split_at_checked(1), line.get(1..).and_then(|id| id.parse::<i32>().ok())) {
            (Some(("+", _)), Some(id)) if id > 1 => drop(groups.insert(id)),
            (Some(("-", _)), Some(id)) => drop(groups.remove(&id)),
            _ => {}
        }
    }
    for id in groups {
        // It may have ended in the meantime.
        let _ = killpg(Pid::from_raw(id), Signal::SIGKILL);
    }
}

/// The side of a launch; dropping it ends the guard.
#[derive(Debug)]
pub(crate) struct Guard {
    shared: Arc<Shared>,
    watch: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    /// Signalled when the launch is over.
    over: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// Groups that run.
    groups: BTreeSet<i32>,
    /// To the guard; none while there is none.
    pipe: Option<ChildStdin>,
    over: bool,
}

impl Guard {
    /// Starts a guard, and another one whenever it ends before the launch does; `say` hears of that.
    pub(crate) fn start(
        mut command: Command,
        say: impl Fn(Level, String) + Send + 'static,
    ) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        // A group of its own: what ends the launch at a terminal must not end its guard.
        command
            .process_group(0)
            .current_dir("/")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let child = shared.start_one(&mut command)?;
        let watcher = Arc::clone(&shared);
        let watch = std::thread::Builder::new()
            .name("launch-guard".to_owned())
            .spawn(move || watcher.keep(child, &mut command, &say))?;
        Ok(Self { shared, watch: Some(watch) })
    }

    /// Says that a process group runs, or that it has ended.
    pub(crate) fn tell(&self, group: i32, runs: bool) {
        let mut state = self.shared.lock();
        if runs {
            state.groups.insert(group);
        } else {
            state.groups.remove(&group);
        }
        let sign = if runs { '+' } else { '-' };
        // One that somebody killed cannot be reached; the next one receives everything.
        if state.pipe.as_mut().is_some_and(|pipe| writeln!(pipe, "{sign}{group}").is_err()) {
            state.pipe = None;
        }
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        {
            let mut state = self.shared.lock();
            state.over = true;
            // It ends with its input.
            state.pipe = None;
        }
        self.shared.over.notify_all();
        if let Some(watch) = self.watch.take() {
            let _ = watch.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a guard and tells it what runs.
    fn start_one(&self, command: &mut Command) -> io::Result<Child> {
        let mut child = command.spawn()?;
        let mut state = self.lock();
        let mut pipe = child.stdin.take();
        let lines: String = state.groups.iter().map(|group| format!("+{group}\n")).collect();
        // One that ended at once is noticed by who waits for it.
        if pipe.as_mut().is_some_and(|pipe| pipe.write_all(lines.as_bytes()).is_err()) {
            pipe = None;
        }
        state.pipe = pipe.filter(|_| !state.over);
        Ok(child)
    }

    /// Waits for the end of the guard, and starts another one until the launch is over.
    fn keep(&self, first: Child, command: &mut Command, say: &impl Fn(Level, String)) {
        let mut child = Some(first);
        let mut restarts = Restarts::default();
        loop {
            let begun = Instant::now();
            let how = child.take().map(|mut child| child.wait());
            let mut state = self.lock();
            state.pipe = None;
            if state.over {
                return;
            }
            let wait = restarts.next(&AGAIN, begun.elapsed()).unwrap_or_default();
            let (state, _) = self
                .over
                .wait_timeout_while(state, wait, |state| !state.over)
                .unwrap_or_else(PoisonError::into_inner);
            if state.over {
                return;
            }
            drop(state);
            match self.start_one(command) {
                Ok(started) => {
                    if let Some(Ok(status)) = how {
                        let id = started.id();
                        let how = crate::supervise::exit_text(status);
                        say(
                            Level::Warn,
                            format!("the guard of the launch {how}: started another one, process {id}"),
                        );
                    }
                    child = Some(started);
                }
                Err(error) => say(
                    Level::Error,
                    format!(
                        "the guard of the launch cannot be started ({error}): until it can, what processes start in \
                         turn would stay behind if the launch were killed"
                    ),
                ),
            }
        }
    }
}

/// Starts processes such that the kernel kills them when the launch is gone.
#[derive(Debug)]
pub(crate) struct Starter {
    jobs: Sender<(Command, oneshot::Sender<io::Result<tokio::process::Child>>)>,
}

impl Starter {
    /// A thread that lives as long as this. Must be called where a tokio runtime is.
    pub(crate) fn new() -> io::Result<Self> {
        let (jobs, requests) = channel::<(Command, oneshot::Sender<_>)>();
        let runtime = tokio::runtime::Handle::current();
        std::thread::Builder::new().name("launch-start".to_owned()).spawn(move || {
            let _inside = runtime.enter();
            for (command, answer) in requests {
                // Who asked is gone only where the launch is.
                let _ = answer.send(tokio::process::Command::from(command).spawn());
            }
        })?;
        Ok(Self { jobs })
    }

    /// Starts a process in a group of its own.
    pub(crate) async fn start(&self, mut command: Command) -> io::Result<tokio::process::Child> {
        let launch = nix::unistd::getpid();
        command.process_group(0);
        // SAFETY: between fork and exec only async-signal-safe functions may be called: these are two system calls, and
        // neither they nor the making of their errors allocates or locks.
        unsafe {
            command.pre_exec(move || {
                nix::sys::prctl::set_pdeathsig(Signal::SIGKILL)?;
                // The launch may have gone before it was requested.
                if nix::unistd::getppid() == launch { Ok(()) } else { Err(nix::Error::ESRCH.into()) }
            });
        }
        let gone = || io::Error::other("the thread that starts processes is gone");
        let (answer, started) = oneshot::channel();
        self.jobs.send((command, answer)).map_err(|_| gone())?;
        started.await.map_err(|_| gone())?
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::Receiver;
    use std::time::Duration;

    const WAIT: Duration = Duration::from_secs(20);

    #[test]
    fn what_still_runs_is_killed_and_nonsense_is_left() {
        let start = || Command::new("sleep").arg("1000").process_group(0).spawn().unwrap();
        let (mut running, mut over) = (start(), start());
        let text =
            format!("+{}\n+{}\nnonsense\n+0\n+1\n+-1\n\n\u{e4}\n-{}\n", running.id(), over.id(), over.id());
        guard(text.as_bytes());
        let status = running.wait().unwrap();
        assert!(!status.success());
        assert!(over.try_wait().unwrap().is_none(), "one that ended before is not killed");
        over.kill().unwrap();
        over.wait().unwrap();
    }

    /// A guard that writes down what it receives, and is killed.
    fn next_guard(heard: &Receiver<String>) -> i32 {
        let text = heard.recv_timeout(WAIT).unwrap();
        assert!(
            text.starts_with("the guard of the launch was ended by signal 9 (SIGKILL): started another"),
            "{text}"
        );
        text.rsplit(' ').next().unwrap().parse().unwrap()
    }

    #[test]
    fn a_guard_that_is_killed_is_replaced_and_receives_what_runs() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("received");
        let mut command = Command::new("sh");
        command.args(["-c", r#"while read line; do echo $$ $line >> "$0"; done"#]).arg(&out);
        let (tx, heard) = channel();
        let guard = Guard::start(command, move |_, text| tx.send(text).unwrap()).unwrap();
        guard.tell(41, true);
        guard.tell(42, true);
        guard.tell(42, false);
        let lines = |of: &str| -> Vec<String> {
            let text = std::fs::read_to_string(&out).unwrap_or_default();
            text.lines()
                .filter_map(|line| line.strip_prefix(of)?.strip_prefix(' ').map(str::to_owned))
                .collect()
        };
        let first =
            || std::fs::read_to_string(&out).unwrap_or_default().split(' ').next().unwrap_or("").to_owned();
        let until = |what: &str, holds: &dyn Fn() -> bool| {
            let deadline = Instant::now() + WAIT;
            while !holds() {
                assert!(Instant::now() < deadline, "never came: {what}");
                std::thread::sleep(Duration::from_millis(5));
            }
        };
        until("the first hears all", &|| lines(&first()) == ["+41", "+42", "-42"]);
        nix::sys::signal::kill(Pid::from_raw(first().parse().unwrap()), Signal::SIGKILL).unwrap();
        let second = next_guard(&heard);
        guard.tell(43, true);
        until("the second hears what runs", &|| lines(&second.to_string()) == ["+41", "+43"]);
        nix::sys::signal::kill(Pid::from_raw(second), Signal::SIGKILL).unwrap();
        let third = next_guard(&heard);
        until("the third, too", &|| lines(&third.to_string()) == ["+41", "+43"]);
        drop(guard);
        assert!(nix::sys::signal::kill(Pid::from_raw(third), None).is_err(), "it ends with the launch");
    }
}
