//! Starting, watching, starting again, stopping.

use std::io;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use tokio::process::Child;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::backoff::Restarts;
use crate::error::LaunchError;
use crate::guard::{Guard, Starter};
use crate::log::{Level, LogOptions, Tap, Writer};
use crate::plan::{Plan, Process, Ready, Restart};

use ready::Signs;
pub(crate) use system::exit_text;
use system::{gather, is_ignored};

mod ready;
mod system;

/// Longest wait for the rest of what a process printed, after its end: what it started may hold the pipe open.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// Wait between SIGTERM and SIGKILL where the launch shall hurry.
const HURRY: Duration = Duration::from_secs(1);
/// A signal this soon after the first one is the same one: `timeout`, `cargo run` and others give it to a process and
/// to its group.
const SAME_SIGNAL: Duration = Duration::from_millis(300);

/// How a launch ended.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Ended {
    /// One sentence for each process that failed for good.
    pub failures: Vec<String>,
}

/// Runs a plan until it is stopped (Ctrl-C, SIGTERM, SIGHUP), until a required process ends, or until all have ended.
///
/// Every process gets a group of its own, so that Ctrl-C at a terminal reaches it once, through here. They are stopped
/// in the reverse order of their start, one after the other; a second signal hurries. `guard` starts a program that
/// calls [`crate::guard()`](fn@crate::guard) on its standard input, for the case that the launch itself is killed.
///
/// # Errors
///
/// [`LaunchError::System`] where logs cannot be written or signals not be listened to. Processes that fail are no
/// error of the launch: they are reported in [`Ended`].
pub async fn run(plan: &Plan, log: &LogOptions, guard: Option<Command>) -> Result<Ended, LaunchError> {
    // Whoever started it with `nohup` wants it to go on; listening changes that.
    let heed_hang_up = !is_ignored(Signal::SIGHUP);
    let listen = |kind| signal(kind).map_err(|e| LaunchError::system("signals cannot be listened to", e));
    let mut interrupt = listen(SignalKind::interrupt())?;
    let mut terminate = listen(SignalKind::terminate())?;
    let mut hang_up = listen(SignalKind::hangup())?;
    let mut names: Vec<String> = plan.processes.iter().map(|p| p.label.clone()).collect();
    names.push("launch".to_owned());
    let writer = Writer::start(log, names)?;
    let tap = writer.tap(plan.processes.len());
    let guard = guard
        .map(|command| Guard::start(command, move |level, text| tap.say(level, text)))
        .transpose()
        .map_err(|e| LaunchError::system("the guard of the launch cannot be started", e))?;
    let starter = Starter::new()
        .map_err(|e| LaunchError::system("the thread that starts processes cannot be started", e))?;
    let launch = Arc::new(Launch {
        processes: plan.processes.clone(),
        states: plan.processes.iter().map(|_| watch::Sender::new(State::default())).collect(),
        stops: plan.processes.iter().map(|_| watch::Sender::new(false)).collect(),
        phase: watch::Sender::new(Phase::Run),
        started: Mutex::default(),
        ended: Mutex::default(),
        guard,
        starter,
        taps: (0..plan.processes.len()).map(|i| writer.tap(i)).collect(),
        tap: writer.tap(plan.processes.len()),
    });

    let work = tokio::spawn(Arc::clone(&launch).work());
    let mut work = std::pin::pin!(work);
    let mut requested: Option<Instant> = None;
    let done = loop {
        let name = tokio::select! {
            done = &mut work => break done,
            _ = interrupt.recv() => "Ctrl-C",
            _ = terminate.recv() => "SIGTERM",
            _ = hang_up.recv(), if heed_hang_up => "SIGHUP",
        };
        if *launch.phase.borrow() == Phase::Run {
            launch.tap.say(Level::Info, format!("{name}: stopping; once more to hurry"));
            launch.phase.send_replace(Phase::Stop);
            requested = Some(Instant::now());
        } else if requested.is_none_or(|requested| requested.elapsed() > SAME_SIGNAL) {
            launch.tap.say(Level::Warn, format!("{name} once more: not waiting any longer"));
            launch.phase.send_replace(Phase::Hurry);
        }
    };
    let failures = std::mem::take(&mut *lock(&launch.ended));
    drop(launch);
    writer.finish();
    done.map_err(|e| LaunchError::system("the launch itself failed", io::Error::other(e)))?;
    Ok(Ended { failures })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Run,
    Stop,
    Hurry,
}

#[derive(Debug, Clone, Copy, Default)]
struct State {
    /// It was started once, or waits for another.
    met: bool,
    /// It was ready once.
    ready: bool,
    /// It is not started any more.
    over: bool,
}

struct Launch {
    processes: Vec<Process>,
    states: Vec<watch::Sender<State>>,
    /// Whether a process is to stop.
    stops: Vec<watch::Sender<bool>>,
    phase: watch::Sender<Phase>,
    /// Order of the first starts.
    started: Mutex<Vec<usize>>,
    ended: Mutex<Vec<String>>,
    guard: Option<Guard>,
    starter: Starter,
    taps: Vec<Tap>,
    tap: Tap,
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits until a watched value holds. The senders live as long as the launch.
async fn until<T>(watched: &watch::Sender<T>, holds: impl FnMut(&T) -> bool) {
    let _ = watched.subscribe().wait_for(holds).await;
}

impl Launch {
    async fn work(self: Arc<Self>) {
        let mut tasks = Vec::new();
        for index in 0..self.processes.len() {
            tasks.push(tokio::spawn(Arc::clone(&self).keep(index)));
            // One that waits for others holds nobody up.
            until(&self.states[index], |state| state.met || state.over).await;
        }
        let all_over = async {
            for state in &self.states {
                until(state, |state| state.over).await;
            }
        };
        tokio::select! {
            () = all_over => {}
            () = self.stop_all() => {}
        }
        for task in tasks {
            if let Err(error) = task.await {
                lock(&self.ended).push(format!("the launch itself failed: {error}"));
            }
        }
    }

    /// Once it is time, stops one process after the other, the last one first.
    async fn stop_all(&self) {
        until(&self.phase, |phase| *phase > Phase::Run).await;
        loop {
            let open = |index: &usize| !self.states[*index].borrow().over;
            let started = lock(&self.started).clone();
            let next =
                started.into_iter().rev().find(open).or_else(|| (0..self.states.len()).rev().find(open));
            let Some(index) = next else { return };
            self.stops[index].send_replace(true);
            let hurried = *self.phase.borrow() == Phase::Hurry;
            if hurried {
                for stop in &self.stops {
                    stop.send_replace(true);
                }
            }
            tokio::select! {
                () = until(&self.states[index], |state| state.over) => {}
                () = until(&self.phase, |phase| *phase == Phase::Hurry), if !hurried => {}
            }
        }
    }

    fn say(&self, level: Level, text: impl Into<String>) {
        self.tap.say(level, text);
    }

    fn fail(&self, sentence: String) {
        self.say(Level::Error, sentence.clone());
        lock(&self.ended).push(sentence);
    }

    /// Starts a process, again and again where its policy says so.
    async fn keep(self: Arc<Self>, index: usize) {
        self.keep_running(index).await;
        let process = &self.processes[index];
        if process.required && *self.phase.borrow() == Phase::Run {
            self.say(Level::Warn, format!("{} is required: stopping the others", process.label));
            self.phase.send_if_modified(|phase| {
                let first = *phase == Phase::Run;
                if first {
                    *phase = Phase::Stop;
                }
                first
            });
        }
        self.states[index].send_modify(|state| state.over = true);
    }

    async fn keep_running(&self, index: usize) {
        let process = &self.processes[index];
        let label = &process.label;
        if !self.others_are_ready(index).await {
            return;
        }
        let mut restarts = Restarts::default();
        loop {
            if *self.phase.borrow() > Phase::Run {
                return;
            }
            let begin = Instant::now();
            let end = match self.run_once(index).await {
                Ok(end) => end,
                Err(error) => {
                    let what = process.program.display();
                    return self.fail(format!("{label} cannot be started ({what}): {error}"));
                }
            };
            let ran = begin.elapsed();
            let how = match &end {
                End::Stopped => return,
                End::NotReady(status) => format!("{label} was not ready in time, and {}", exit_text(*status)),
                End::Itself(status) => {
                    format!("{label} {} after {:.1} s", exit_text(*status), ran.as_secs_f64())
                }
            };
            let failed = !matches!(&end, End::Itself(status) if status.success());
            let again =
                process.restart == Restart::Always || (failed && process.restart == Restart::OnFailure);
            let stopping = *self.phase.borrow() > Phase::Run;
            if stopping || !again {
                // While all are stopped, somebody else may stop some of them too, as service managers do.
                if failed && !stopping {
                    self.fail(how);
                } else {
                    self.say(Level::Info, how);
                }
                return;
            }
            let Some(wait) = restarts.next(&process.backoff, ran) else {
                let limit = process.backoff.limit;
                return self.fail(format!("{how}; given up after {limit} restarts in a row"));
            };
            let count = restarts.in_a_row();
            let limit = process.backoff.limit;
            let when = match wait {
                Duration::ZERO => "at once".to_owned(),
                wait => format!("in {:.2} s", wait.as_secs_f64()),
            };
            self.say(
                Level::Warn,
                format!("{how}; starting it again {when} (restart {count} of at most {limit})"),
            );
            tokio::select! {
                () = tokio::time::sleep(wait) => {}
                () = until(&self.phase, |phase| *phase > Phase::Run) => return,
            }
        }
    }

    async fn others_are_ready(&self, index: usize) -> bool {
        let process = &self.processes[index];
        if process.after.is_empty() {
            return true;
        }
        self.states[index].send_modify(|state| state.met = true);
        for &other in &process.after {
            tokio::select! {
                () = until(&self.states[other], |state| state.ready || state.over) => {}
                () = until(&self.phase, |phase| *phase > Phase::Run) => return false,
            }
            if !self.states[other].borrow().ready {
                let other = &self.processes[other].label;
                let label = &process.label;
                self.fail(format!("{label} is not started: {other}, which it waits for, was never ready"));
                return false;
            }
        }
        true
    }

    /// Starts a process and waits for its end.
    async fn run_once(&self, index: usize) -> io::Result<End> {
        let process = &self.processes[index];
        let signs = Signs::before_start(process);
        let mut child = self.starter.start(command(process)).await?;
        let group = child.id().and_then(|id| i32::try_from(id).ok()).map(Group);
        self.note_start(index, group);
        let readers = self.readers(index, &mut child, &signs);
        let end = self.until_end(index, &mut child, group, &signs).await;
        if let Some(group) = group {
            // What it started ends with it.
            group.signal(Signal::SIGKILL);
            if let Some(guard) = &self.guard {
                guard.tell(group.0, false);
            }
        }
        let rest = tokio::time::Instant::now() + LAST_WORDS;
        for mut reader in readers {
            if tokio::time::timeout_at(rest, &mut reader).await.is_err() {
                reader.abort();
            }
        }
        self.taps[index].confess(true);
        // It may have said so with its last words.
        if signs.are_there(process) {
            self.states[index].send_modify(|state| state.ready = true);
        }
        end
    }

    /// Says that a process was started, to people, to the guard and to those that wait for it.
    fn note_start(&self, index: usize, group: Option<Group>) {
        if let (Some(guard), Some(Group(id))) = (&self.guard, group) {
            guard.tell(id, true);
        }
        let label = &self.processes[index].label;
        self.say(Level::Info, format!("{label} started, process {}", group.map_or(0, |g| g.0)));
        let mut started = lock(&self.started);
        if !started.contains(&index) {
            started.push(index);
        }
        drop(started);
        self.states[index].send_modify(|state| state.met = true);
    }

    /// Reads what a process prints.
    fn readers(&self, index: usize, child: &mut Child, signs: &Signs) -> Vec<JoinHandle<()>> {
        let pattern = match &self.processes[index].ready {
            Some(Ready::Line { pattern, .. }) => Some(pattern.clone()),
            _ => None,
        };
        let mut readers = Vec::new();
        if let Some(pipe) = child.stdout.take() {
            readers.push(gather(pipe, self.taps[index].clone(), pattern.clone(), Arc::clone(&signs.seen)));
        }
        if let Some(pipe) = child.stderr.take() {
            readers.push(gather(pipe, self.taps[index].clone(), pattern, Arc::clone(&signs.seen)));
        }
        readers
    }

    /// Waits until a process ends. It is ended where it is not ready in time, or is to stop.
    async fn until_end(
        &self,
        index: usize,
        child: &mut Child,
        group: Option<Group>,
        signs: &Signs,
    ) -> io::Result<End> {
        let process = &self.processes[index];
        let mut ready = std::pin::pin!(signs.in_time(process));
        let mut waiting = true;
        loop {
            tokio::select! {
                biased;
                in_time = &mut ready, if waiting => {
                    waiting = false;
                    if !in_time {
                        return self.end(index, child, group).await.map(End::NotReady);
                    }
                    // Said before those that wait for it hear of it, so that the log is in order.
                    if process.ready.is_some() {
                        self.say(Level::Info, format!("{} is ready", process.label));
                    }
                    self.states[index].send_modify(|state| state.ready = true);
                }
                status = child.wait() => return status.map(End::Itself),
                () = until(&self.stops[index], |stop| *stop) => {
                    let status = self.end(index, child, group).await?;
                    self.say(Level::Info, format!("{} {}", process.label, exit_text(status)));
                    return Ok(End::Stopped);
                }
            }
        }
    }

    /// Asks a process to end, less and less politely.
    async fn end(&self, index: usize, child: &mut Child, group: Option<Group>) -> io::Result<ExitStatus> {
        let Process { label, stop, .. } = &self.processes[index];
        let Some(group) = group else { return child.wait().await };
        if *self.phase.borrow() < Phase::Hurry {
            group.signal(Signal::SIGINT);
            let patience = Duration::from_secs_f64(stop.interrupt);
            tokio::select! {
                status = child.wait() => return status,
                () = tokio::time::sleep(patience) => {
                    self.say(Level::Warn, format!("{label} ignores the interrupt for {} s: SIGTERM", stop.interrupt));
                }
                () = until(&self.phase, |phase| *phase == Phase::Hurry) => {}
            }
        }
        group.signal(Signal::SIGTERM);
        let patience = Duration::from_secs_f64(stop.terminate);
        let hurry = async {
            until(&self.phase, |phase| *phase == Phase::Hurry).await;
            tokio::time::sleep(HURRY).await;
        };
        tokio::select! {
            status = child.wait() => return status,
            () = tokio::time::sleep(patience) => {}
            () = hurry => {}
        }
        self.say(Level::Warn, format!("{label} ignores SIGTERM too: SIGKILL"));
        group.signal(Signal::SIGKILL);
        child.wait().await
    }
}

/// How a process is started.
fn command(process: &Process) -> Command {
    let mut command = Command::new(&process.program);
    command
        .args(&process.arguments)
        .envs(&process.environment)
        .current_dir(&process.directory)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// How one run of a process ended.
enum End {
    Stopped,
    NotReady(ExitStatus),
    Itself(ExitStatus),
}

/// A process and what it started.
#[derive(Debug, Clone, Copy)]
struct Group(i32);

impl Group {
    fn signal(self, signal: Signal) {
        // It may have ended already.
        let _ = killpg(Pid::from_raw(self.0), signal);
    }
}
