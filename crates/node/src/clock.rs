//! The time of a node: the system's, or that of `/clock`.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crate::executor::lock;

/// A step back of the system clock smaller than this is slewing, not a jump. 10 ms, in ns.
const JUMP_NS: i64 = 10_000_000;

/// A jump of the clock, ns since the epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockJump {
    /// The time before.
    pub from_ns: i64,
    /// The time after, less than before.
    pub to_ns: i64,
}

type JumpCallback = Box<dyn FnMut(ClockJump) + Send>;

struct Inner {
    simulated: AtomicBool,
    /// Last time from `/clock`; 0 before the first.
    simulated_ns: AtomicI64,
    jumps: AtomicI64,
    last_jump: Mutex<Option<ClockJump>>,
    callbacks: Mutex<Vec<JumpCallback>>,
    /// System time and monotonic time of the last look.
    reference: Mutex<(i64, Instant)>,
}

/// The clock of a node. Cheap to clone.
#[derive(Clone)]
pub struct Clock(Arc<Inner>);

/// The system clock, ns since the epoch: that of [`MessageInfo::received_ns`](crate::MessageInfo::received_ns).
#[must_use]
pub fn system_now() -> i64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}

impl Clock {
    pub(crate) fn new() -> Self {
        Self(Arc::new(Inner {
            simulated: AtomicBool::new(false),
            simulated_ns: AtomicI64::new(0),
            jumps: AtomicI64::new(0),
            last_jump: Mutex::new(None),
            callbacks: Mutex::new(Vec::new()),
            reference: Mutex::new((system_now(), Instant::now())),
        }))
    }

    /// Now, in ns since the epoch. With simulated time this is the last time on `/clock`, 0 before the first.
    #[must_use]
    pub fn now(&self) -> i64 {
        if self.is_simulated() { self.0.simulated_ns.load(Ordering::Acquire) } else { system_now() }
    }

    /// Whether it follows `/clock`.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.0.simulated.load(Ordering::Acquire)
    }

    /// Calls `callback` when the time jumps back: a bag that starts again, a simulation that is reset, a
    /// system clock that is set. What was computed from earlier stamps (filters, tracks) is void then.
    pub fn on_jump_back(&self, callback: impl FnMut(ClockJump) + Send + 'static) {
        lock(&self.0.callbacks).push(Box::new(callback));
    }

    /// How many times the clock jumped back, and the last jump.
    #[must_use]
    pub fn jumps(&self) -> (u64, Option<ClockJump>) {
        let count = u64::try_from(self.0.jumps.load(Ordering::Acquire)).unwrap_or(0);
        (count, *lock(&self.0.last_jump))
    }

    pub(crate) fn set_simulated(&self, simulated: bool) {
        self.0.simulated_ns.store(0, Ordering::Release);
        self.0.simulated.store(simulated, Ordering::Release);
        *lock(&self.0.reference) = (system_now(), Instant::now());
    }

    pub(crate) fn set_simulated_now(&self, now_ns: i64) {
        let before = self.0.simulated_ns.swap(now_ns, Ordering::AcqRel);
        if self.is_simulated() && now_ns < before {
            self.jumped(ClockJump { from_ns: before, to_ns: now_ns });
        }
    }

    /// Looks whether the system clock was set back since the last look.
    pub(crate) fn check_system(&self) {
        if !self.is_simulated() {
            self.check(system_now(), Instant::now());
        }
    }

    fn check(&self, system: i64, monotonic: Instant) {
        let expected = {
            let mut reference = lock(&self.0.reference);
            let elapsed = monotonic.saturating_duration_since(reference.1).as_nanos();
            let expected = reference.0.saturating_add(i64::try_from(elapsed).unwrap_or(i64::MAX));
            *reference = (system, monotonic);
            expected
        };
        if expected.saturating_sub(system) > JUMP_NS {
            self.jumped(ClockJump { from_ns: expected, to_ns: system });
        }
    }

    fn jumped(&self, jump: ClockJump) {
        self.0.jumps.fetch_add(1, Ordering::AcqRel);
        *lock(&self.0.last_jump) = Some(jump);
        #[expect(clippy::cast_precision_loss, reason = "for people to read")]
        let seconds = (jump.from_ns - jump.to_ns) as f64 * 1e-9;
        tracing::warn!("the clock jumped back by {seconds:.3} s");
        let mut callbacks = std::mem::take(&mut *lock(&self.0.callbacks));
        for callback in &mut callbacks {
            callback(jump);
        }
        let mut current = lock(&self.0.callbacks);
        callbacks.append(&mut current);
        *current = callbacks;
    }

    pub(crate) fn clear_callbacks(&self) {
        lock(&self.0.callbacks).clear();
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_simulated_clock_reports_its_jumps() {
        let clock = Clock::new();
        let seen: Arc<Mutex<Vec<ClockJump>>> = Arc::default();
        let log = Arc::clone(&seen);
        clock.on_jump_back(move |jump| lock(&log).push(jump));
        assert!(clock.now() > 0);
        clock.set_simulated(true);
        assert_eq!(clock.now(), 0);
        clock.set_simulated_now(5);
        clock.set_simulated_now(9);
        assert_eq!(clock.now(), 9);
        clock.set_simulated_now(2);
        assert_eq!(*lock(&seen), [ClockJump { from_ns: 9, to_ns: 2 }]);
        assert_eq!(clock.jumps().0, 1);
    }

    #[test]
    fn a_system_clock_that_is_set_back_is_noticed() {
        let clock = Clock::new();
        let (system, monotonic) = *lock(&clock.0.reference);
        let second = Duration::from_secs(1);
        clock.check(system + 1_000_000_000 - JUMP_NS / 2, monotonic + second);
        assert_eq!(clock.jumps().0, 0, "slewing");
        clock.check(system, monotonic + 2 * second);
        assert_eq!(clock.jumps().0, 1);
        clock.check(system + 1_000_000_000, monotonic + 3 * second);
        assert_eq!(clock.jumps().0, 1, "going on from there");
    }
}
