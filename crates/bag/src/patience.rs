//! Waits for a disk that is full.
//!
//! Problem: a recorder that ends when the disk is full loses everything from then on, though somebody may make room a minute
//! later. Method: the write that found no room is tried again until there is some, so that the file goes on where it stopped
//! and nothing of it is torn. Meanwhile messages wait in the recorder's queue, which is bounded; what does not fit there is
//! counted by it. A limit on the size of one file is not waited for: nobody will lift it.

use std::{
    io::{self, Write},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// How often a write is tried again.
const AGAIN: Duration = Duration::from_millis(100);

/// Why nothing can be written for now; `None` for errors that waiting does not help against.
pub(crate) fn no_room(error: &io::Error) -> Option<&'static str> {
    match error.kind() {
        io::ErrorKind::StorageFull => Some("the disk is full"),
        io::ErrorKind::QuotaExceeded => Some("the disk quota is used up"),
        _ => None,
    }
}

/// Whether writes wait, and how long they have.
#[derive(Debug, Default)]
pub(crate) struct Patience {
    on: AtomicBool,
    /// Since when a write waits, and for what.
    since: Mutex<Option<(Instant, &'static str)>>,
    pauses: AtomicU64,
    waited_ms: AtomicU64,
}

impl Patience {
    fn since(&self) -> MutexGuard<'_, Option<(Instant, &'static str)>> {
        self.since.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on a write that finds no room waits.
    pub(crate) fn begin(&self) {
        self.on.store(true, Ordering::Release);
    }

    /// From now on a write that finds no room fails, as it does before the beginning.
    pub(crate) fn end(&self) {
        self.on.store(false, Ordering::Release);
    }

    /// What is waited for now.
    pub(crate) fn waiting(&self) -> Option<&'static str> {
        self.since().map(|(_, reason)| reason)
    }

    /// How often room was waited for.
    pub(crate) fn pauses(&self) -> u64 {
        self.pauses.load(Ordering::Relaxed)
    }

    /// How long in all, the present wait included.
    pub(crate) fn waited(&self) -> Duration {
        let now = self.since().map_or(Duration::ZERO, |(since, _)| since.elapsed());
        Duration::from_millis(self.waited_ms.load(Ordering::Relaxed)) + now
    }

    /// Tries until there is room, or patience has ended.
    pub(crate) fn patiently<T>(&self, mut attempt: impl FnMut() -> io::Result<T>) -> io::Result<T> {
        loop {
            let done = attempt();
            let reason = done.as_ref().err().and_then(no_room);
            let Some(reason) = reason.filter(|_| self.on.load(Ordering::Acquire)) else {
                if let Some((since, _)) = self.since().take() {
                    let ms = u64::try_from(since.elapsed().as_millis()).unwrap_or(u64::MAX);
                    self.waited_ms.fetch_add(ms, Ordering::Relaxed);
                }
                return done;
            };
            self.since().get_or_insert_with(|| {
                self.pauses.fetch_add(1, Ordering::Relaxed);
                (Instant::now(), reason)
            });
            std::thread::sleep(AGAIN);
        }
    }
}

/// A file whose writes wait for room, where there is somebody to wait.
pub(crate) struct Patient<W> {
    pub(crate) inner: W,
    pub(crate) patience: Option<std::sync::Arc<Patience>>,
}

impl<W: Write> Write for Patient<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &self.patience {
            Some(patience) => patience.patiently(|| self.inner.write(bytes)),
            None => self.inner.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    /// A disk with so much room; the rest of a write that does not fit is refused.
    #[derive(Default)]
    struct Disk {
        room: Arc<Mutex<usize>>,
        bytes: Vec<u8>,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut room = self.room.lock().unwrap();
            let count = bytes.len().min(*room);
            if count == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            *room -= count;
            self.bytes.extend_from_slice(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_write_goes_on_where_it_stopped() {
        let room = Arc::new(Mutex::new(5));
        let patience = Arc::new(Patience::default());
        patience.begin();
        let disk = Disk { room: Arc::clone(&room), bytes: Vec::new() };
        let mut file = Patient { inner: disk, patience: Some(Arc::clone(&patience)) };
        let written = std::thread::scope(|scope| {
            let writing = scope.spawn(|| file.write_all(b"eleven bytes"));
            while patience.waiting() != Some("the disk is full") {
                std::thread::yield_now();
            }
            *room.lock().unwrap() = 100;
            writing.join().unwrap()
        });
        written.unwrap();
        assert_eq!(file.inner.bytes, b"eleven bytes");
        assert_eq!((patience.pauses(), patience.waiting()), (1, None));
        assert!(patience.waited() > Duration::ZERO);
    }

    #[test]
    fn patience_ends() {
        let patience = Arc::new(Patience::default());
        patience.begin();
        let mut file = Patient { inner: Disk::default(), patience: Some(Arc::clone(&patience)) };
        let written = std::thread::scope(|scope| {
            let writing = scope.spawn(|| file.write_all(b"x"));
            while patience.waiting().is_none() {
                std::thread::yield_now();
            }
            patience.end();
            writing.join().unwrap()
        });
        assert_eq!(written.unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(patience.waiting(), None);
        // Without anybody to wait, it fails at once.
        let mut file = Patient { inner: Disk::default(), patience: None };
        assert_eq!(file.write_all(b"x").unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
