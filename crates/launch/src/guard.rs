//! What ends the processes of a launch that was itself killed.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Mutex, PoisonError};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;

/// Reads which process groups run (`+ID`, `-ID`, one a line) until the input ends, and kills those that still run then.
///
/// It is the whole of a small process beside a launch. The kernel closes the pipe between them however the launch ends,
/// so that `kill -9` leaves nothing behind: neither the processes that it started nor what those started in turn, which
/// a parent-death signal would not reach.
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

/// The side of a launch.
#[derive(Debug)]
pub(crate) struct Guard {
    child: Child,
    pipe: Mutex<Option<ChildStdin>>,
}

impl Guard {
    pub(crate) fn start(command: &mut Command) -> std::io::Result<Self> {
        // A group of its own: what ends the launch at a terminal must not end its guard.
        let mut child = command
            .process_group(0)
            .current_dir("/")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        let pipe = Mutex::new(child.stdin.take());
        Ok(Self { child, pipe })
    }

    /// Says that a process group runs, or that it has ended.
    pub(crate) fn tell(&self, group: i32, runs: bool) {
        let mut pipe = self.pipe.lock().unwrap_or_else(PoisonError::into_inner);
        let sign = if runs { '+' } else { '-' };
        // A guard that somebody killed cannot be told; the launch is worth more than its guard.
        if pipe.as_mut().is_some_and(|pipe| writeln!(pipe, "{sign}{group}").is_err()) {
            *pipe = None;
        }
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        // It ends with its input.
        *self.pipe.lock().unwrap_or_else(PoisonError::into_inner) = None;
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_still_runs_is_killed_and_nonsense_is_left() {
        let start = || Command::new("sleep").arg("1000").process_group(0).spawn().unwrap();
        let (mut told, mut over) = (start(), start());
        let text =
            format!("+{}\n+{}\nnonsense\n+0\n+1\n+-1\n\n\u{e4}\n-{}\n", told.id(), over.id(), over.id());
        guard(text.as_bytes());
        let status = told.wait().unwrap();
        assert!(!status.success());
        assert!(over.try_wait().unwrap().is_none(), "one that ended before is not killed");
        over.kill().unwrap();
        over.wait().unwrap();
    }
}
