//! Handing an open link over to the consumer, and back.
//!
//! *Problem.* With one thread that reads and another that consumes, each frame puts two threads to sleep and wakes them. At 1 kHz that costs
//! more than the work on the frame.
//!
//! *Method.* When the consumer waits and usually comes back soon, the reading thread hands it the link (as the leader of the leader/followers
//! pattern: D. C. Schmidt et al., *Pattern-Oriented Software Architecture* 2, 2000): the consumer polls and reads the line itself. The
//! reading thread takes the link back when it was not read for [`MAX_UNREAD`], so that the line is emptied while the consumer works for long,
//! and when it goes down, because connecting again may take seconds.
//!
//! *Cost.* The reading thread wakes once in every [`MAX_UNREAD`].

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::link::{Link, Opener};

/// Longest time that a link may stay unread at the consumer. The kernel buffers 4 KiB of a terminal, which is 20 ms at 2 Mbaud.
pub(super) const MAX_UNREAD: Duration = Duration::from_millis(20);

/// An open link, and what it takes to read it.
pub(super) struct OpenLink {
    pub(super) link: Link,
    pub(super) opener: Opener,
    pub(super) buffer: Vec<u8>,
}

/// Why the link came back to the reading thread.
pub(super) enum Returned {
    /// The consumer did not read it for [`MAX_UNREAD`].
    Unread(Box<OpenLink>),
    /// It went down while the consumer read it, for this reason; `None` when it is time to stop.
    Down(Opener, Option<String>),
    /// The source is gone, and the link with it.
    Closed,
}

/// Who holds the link.
#[derive(Default)]
enum Holder {
    /// The reading thread; or there is no link.
    #[default]
    ReadingThread,
    /// Nobody, since then: the consumer may take it.
    Nobody(Box<OpenLink>, Instant),
    Consumer,
    /// It went down at the consumer.
    Down(Opener, Option<String>),
}

/// Where the link changes hands.
#[derive(Default)]
pub(super) struct Handover {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    holder: Holder,
    closed: bool,
}

impl std::fmt::Debug for Handover {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Handover").finish_non_exhaustive()
    }
}

impl Handover {
    fn state(&self) -> MutexGuard<'_, State> {
        // No change of it is left half done.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Leaves the link for the consumer; [`returned`](Self::returned) waits for it.
    pub(super) fn offer(&self, link: Box<OpenLink>) {
        self.state().holder = Holder::Nobody(link, Instant::now());
    }

    /// Takes the link, where it was left.
    pub(super) fn take(&self) -> Option<Box<OpenLink>> {
        let mut state = self.state();
        match std::mem::replace(&mut state.holder, Holder::Consumer) {
            Holder::Nobody(link, _) => Some(link),
            other => {
                state.holder = other;
                None
            }
        }
    }

    /// Whether it may be taken.
    #[cfg(test)]
    pub(super) fn is_free(&self) -> bool {
        matches!(self.state().holder, Holder::Nobody(..))
    }

    /// The link went down at the consumer.
    pub(super) fn down(&self, opener: Opener, reason: Option<String>) {
        self.state().holder = Holder::Down(opener, reason);
        self.changed.notify_all();
    }

    /// The consumer is gone; a link that it left is closed.
    pub(super) fn close(&self) {
        *self.state() = State { holder: Holder::ReadingThread, closed: true };
        self.changed.notify_all();
    }

    /// Waits until the reading thread has to act.
    pub(super) fn returned(&self) -> Returned {
        let mut state = self.state();
        loop {
            if state.closed {
                return Returned::Closed;
            }
            match std::mem::take(&mut state.holder) {
                Holder::Nobody(link, since) if since.elapsed() >= MAX_UNREAD => {
                    return Returned::Unread(link);
                }
                Holder::Down(opener, reason) => return Returned::Down(opener, reason),
                other => state.holder = other,
            }
            state = self.changed.wait_timeout(state, MAX_UNREAD).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
