//! A link that is lent to the consumer.
//!
//! *Problem.* A thread that reads and a consumer that waits for it are put to sleep and woken twice for each frame, which costs more
//! than the frame.
//!
//! *Method.* Where a consumer waits and is quick, the thread lends it the link: the consumer then waits for the line itself, and reads
//! in place. The thread takes the link back when nobody has come for it within [`GUARD`], so that the line is emptied while the consumer
//! works for long, and where the link went down, because to make it anew may take seconds.
//!
//! *Cost.* The thread looks once in every [`GUARD`].

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::link::{Link, Opener};

/// How long a link that is lent may lie unread. The kernel keeps 4 KiB of a terminal: more than 20 ms of 2 Mbaud.
pub(super) const GUARD: Duration = Duration::from_millis(20);

/// What it takes to read a link.
pub(super) struct Pump {
    pub(super) link: Link,
    pub(super) opener: Opener,
    pub(super) buffer: Vec<u8>,
}

/// How a loan ended for the thread.
pub(super) enum Returned {
    /// Nobody reads it.
    Unread(Box<Pump>),
    /// It went down at the consumer, for this reason; `None` when it is time to stop.
    Down(Opener, Option<String>),
    /// The source is gone, and the link with it.
    Closed,
}

/// Where the link is.
#[derive(Default)]
enum Place {
    /// With the thread, or down.
    #[default]
    Thread,
    /// To be taken, since then.
    Free(Box<Pump>, Instant),
    Consumer,
    Down(Opener, Option<String>),
}

/// The place where the link is handed over.
#[derive(Default)]
pub(super) struct Lent {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    place: Place,
    closed: bool,
}

impl std::fmt::Debug for Lent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Lent").finish_non_exhaustive()
    }
}

impl Lent {
    fn state(&self) -> MutexGuard<'_, State> {
        // No change of it is left half done.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The thread offers the link; [`returned`](Self::returned) waits for it.
    pub(super) fn offer(&self, pump: Box<Pump>) {
        self.state().place = Place::Free(pump, Instant::now());
    }

    /// The consumer takes it, if it is there.
    pub(super) fn take(&self) -> Option<Box<Pump>> {
        let mut state = self.state();
        match std::mem::replace(&mut state.place, Place::Consumer) {
            Place::Free(pump, _) => Some(pump),
            other => {
                state.place = other;
                None
            }
        }
    }

    /// Whether it lies there.
    #[cfg(test)]
    pub(super) fn is_free(&self) -> bool {
        matches!(self.state().place, Place::Free(..))
    }

    /// The consumer says that the link is down.
    pub(super) fn down(&self, opener: Opener, reason: Option<String>) {
        self.state().place = Place::Down(opener, reason);
        self.changed.notify_all();
    }

    /// Nobody will take the link any more; one that is free is closed.
    pub(super) fn close(&self) {
        *self.state() = State { place: Place::Thread, closed: true };
        self.changed.notify_all();
    }

    /// The thread waits until it has to act.
    pub(super) fn returned(&self) -> Returned {
        let mut state = self.state();
        loop {
            if state.closed {
                return Returned::Closed;
            }
            match std::mem::take(&mut state.place) {
                Place::Free(pump, since) if since.elapsed() >= GUARD => return Returned::Unread(pump),
                Place::Down(opener, reason) => return Returned::Down(opener, reason),
                other => state.place = other,
            }
            state = self.changed.wait_timeout(state, GUARD).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
