//! The thread of a device.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::Instant;

use crate::TestbedError;

/// A thread that ends on demand, and is waited for.
#[derive(Debug)]
pub(super) struct Worker {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), TestbedError>>>,
}

impl Worker {
    pub(super) fn spawn(
        skin: &str,
        name: &str,
        stop: Arc<AtomicBool>,
        body: impl FnOnce() -> Result<(), TestbedError> + Send + 'static,
    ) -> Result<Self, TestbedError> {
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(body).map_err(|source| {
            TestbedError::Device { skin: skin.to_owned(), what: "cannot start its thread", source }
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }

    pub(super) fn running(&self) -> bool {
        self.thread.as_ref().is_some_and(|t| !t.is_finished())
    }

    pub(super) fn stop(&mut self) -> Result<(), TestbedError> {
        self.stop.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else { return Ok(()) };
        Thread::unpark(thread.thread());
        match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.stop.store(true, Ordering::Relaxed);
        } else if let Err(error) = self.stop() {
            tracing::warn!("{error}");
        }
    }
}

/// Sleeps until `deadline`, or less where `stop` is set and the thread unparked.
pub(super) fn sleep_until(deadline: Instant, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        let Some(left) = deadline.checked_duration_since(Instant::now()).filter(|d| !d.is_zero()) else {
            return;
        };
        std::thread::park_timeout(left);
    }
}
