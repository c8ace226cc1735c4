//! What is to be written to a device: handed over by the consumer, sent by the source's thread.

use std::io::{self, PipeReader, PipeWriter, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// \[bytes\] that may wait for the line.
const MOST: usize = 1 << 16;

/// Bytes that wait for the line.
#[derive(Debug)]
pub(super) struct Outbox {
    waiting: Mutex<Waiting>,
    bell: PipeWriter,
}

#[derive(Debug, Default)]
struct Waiting {
    /// The link is up.
    open: bool,
    bytes: Vec<u8>,
}

/// Rings when something was put into the outbox.
#[derive(Debug)]
pub(super) struct Wake(PipeReader);

impl Wake {
    pub(super) fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }

    /// Takes the rings that came; called where the pipe can be read.
    pub(super) fn answer(&self) {
        let mut rings = [0; 64];
        // One that stays is one wake-up more.
        let _ = (&self.0).read(&mut rings);
    }
}

impl Outbox {
    pub(super) fn new() -> io::Result<(Self, Wake)> {
        let (heard, bell) = io::pipe()?;
        Ok((Self { waiting: Mutex::default(), bell }, Wake(heard)))
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The link is up: nothing that was meant for an earlier one is sent.
    pub(super) fn open(&self) {
        *self.lock() = Waiting { open: true, bytes: Vec::new() };
    }

    /// The link is down.
    pub(super) fn close(&self) {
        *self.lock() = Waiting::default();
    }

    /// Adds bytes, all of them or none; whether they were added.
    pub(super) fn put(&self, bytes: &[u8]) -> bool {
        let mut waiting = self.lock();
        if !waiting.open || waiting.bytes.len() + bytes.len() > MOST {
            return false;
        }
        let first = waiting.bytes.is_empty();
        waiting.bytes.extend_from_slice(bytes);
        // The thread empties the pipe before the outbox, so that one ring for all that waits never fills the pipe.
        !first || (&self.bell).write_all(&[1]).is_ok()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.lock().bytes.is_empty()
    }

    /// Lets `write` send of what waits as much as it can.
    pub(super) fn send(&self, write: impl FnOnce(&[u8]) -> io::Result<usize>) -> io::Result<()> {
        let mut waiting = self.lock();
        if waiting.bytes.is_empty() {
            return Ok(());
        }
        let sent = write(&waiting.bytes)?;
        waiting.bytes.drain(..sent);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_refused_whole() {
        let (outbox, _wake) = Outbox::new().unwrap();
        assert!(!outbox.put(b"nobody is there"));
        outbox.open();
        assert!(outbox.put(&[1; 60_000]) && !outbox.put(&[2; 6_000]) && outbox.put(&[3; 5_000]));
        outbox.send(|bytes| Ok(bytes.len() - 1)).unwrap();
        outbox
            .send(|bytes| {
                assert_eq!(bytes, [3]);
                Ok(1)
            })
            .unwrap();
        assert!(outbox.is_empty());
        assert!(outbox.put(b"old"));
        outbox.open();
        assert!(outbox.is_empty(), "a new link begins anew");
    }
}
