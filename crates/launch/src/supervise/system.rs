//! What the system says of a process: how it ended, its signals, its files, and what it prints.

use std::os::unix::fs::MetadataExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::Arc;

use nix::sys::signal::Signal;
use regex::Regex;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::lines::Lines;
use crate::log::{CONFESS, Record, Tap};

pub(crate) fn exit_text(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(0), _) => "ended".to_owned(),
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(number)) => {
            let name = Signal::try_from(number).map_or("an unknown signal", Signal::as_str);
            format!("was ended by signal {number} ({name})")
        }
        (None, None) => "ended".to_owned(),
    }
}

/// Whether this process was started with a signal ignored.
pub(super) fn is_ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap_or_default();
    u64::from_str_radix(mask.trim(), 16).is_ok_and(|mask| mask >> (signal as i32 - 1) & 1 == 1)
}

/// What tells a file from another one that had its name before.
pub(super) fn identity(path: &Path) -> Option<(u64, u64, i64, i64)> {
    let found = std::fs::symlink_metadata(PathBuf::from(path)).ok()?;
    Some((found.dev(), found.ino(), found.ctime(), found.ctime_nsec()))
}

/// Reads a pipe to its end, faster than anything can fill it.
pub(super) fn gather(
    mut pipe: impl AsyncRead + Unpin + Send + 'static,
    tap: Tap,
    mut pattern: Option<Regex>,
    seen: Arc<watch::Sender<bool>>,
) -> JoinHandle<()> {
    tokio::spawn(async move {
        let mut lines = Lines::default();
        let mut block = vec![0; 64 * 1024];
        let mut each = |line: &[u8]| {
            let room = tap.has_room();
            if !room && pattern.is_none() {
                return;
            }
            let record = Record::parse(line);
            if pattern.as_ref().is_some_and(|pattern| pattern.is_match(&record.message)) {
                pattern = None;
                seen.send_replace(true);
            }
            if room {
                tap.take(record);
            }
        };
        loop {
            match tokio::time::timeout(CONFESS, pipe.read(&mut block)).await {
                Ok(Ok(count @ 1..)) => lines.push(&block[..count], &mut each),
                Ok(_) => break,
                // It is quiet after a flood.
                Err(_) => tap.confess(true),
            }
        }
        lines.finish(each);
    })
}
