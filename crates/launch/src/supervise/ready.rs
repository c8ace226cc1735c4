//! What shows that a process is ready: a file that it makes, or a line that it prints.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::system::identity;
use super::until;
use crate::plan::{Process, Ready};

/// How often a file is looked for.
const LOOK: Duration = Duration::from_millis(20);

/// What tells a file from another one of its name.
type Identity = (u64, u64, i64, i64);

/// What shows that a process is ready.
pub(super) struct Signs {
    /// The file that it makes, as it was before the start.
    before: Option<Identity>,
    /// Whether the line was seen that it prints.
    pub(super) seen: Arc<watch::Sender<bool>>,
}

impl Signs {
    /// As they are before a process is started.
    pub(super) fn before_start(process: &Process) -> Self {
        let before = match &process.ready {
            Some(Ready::File { path, .. }) => identity(path),
            _ => None,
        };
        Self { before, seen: Arc::new(watch::Sender::new(false)) }
    }

    /// Whether they are there.
    pub(super) fn are_there(&self, process: &Process) -> bool {
        match &process.ready {
            Some(Ready::File { path, .. }) => identity(path).is_some_and(|now| Some(now) != self.before),
            _ => *self.seen.borrow(),
        }
    }

    /// Waits for them, as long as the process may take.
    pub(super) async fn in_time(&self, process: &Process) -> bool {
        let within = match &process.ready {
            None => return true,
            Some(Ready::File { within, .. } | Ready::Line { within, .. }) => *within,
        };
        let there = async {
            if matches!(process.ready, Some(Ready::Line { .. })) {
                return until(&self.seen, |seen| *seen).await;
            }
            while !self.are_there(process) {
                tokio::time::sleep(LOOK).await;
            }
        };
        tokio::time::timeout(within, there).await.is_ok()
    }
}
