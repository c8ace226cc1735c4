//! Timers, and the thread that keeps time: it starts callbacks that are due and checks the graph.

use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use super::endpoints::Close;
use super::{Node, Shared};
use crate::executor::{Executor, Lane, lock};

/// Longest time between two checks of the graph, where nothing reports a change.
const GRAPH_PERIOD: Duration = Duration::from_secs(1);
/// Changes of the graph come in bursts; one check is enough for each.
const GRAPH_QUIET: Duration = Duration::from_millis(20);

/// Why the thread that keeps time is to wake.
#[derive(Default)]
struct AlarmState {
    graph_changed: bool,
    timers_changed: bool,
    stop: bool,
}

/// Wakes the thread that keeps time.
#[derive(Default)]
pub(super) struct Alarm {
    state: Mutex<AlarmState>,
    wake: Condvar,
}

impl Alarm {
    pub(super) fn graph_changed(&self) {
        lock(&self.state).graph_changed = true;
        self.wake.notify_all();
    }

    fn timers_changed(&self) {
        lock(&self.state).timers_changed = true;
        self.wake.notify_all();
    }

    /// Ends the thread that keeps time.
    pub(super) fn stop(&self) {
        lock(&self.state).stop = true;
        self.wake.notify_all();
    }
}

/// What a [`Timer`] keeps alive.
pub(super) struct TimerInner {
    period: Duration,
    next: Mutex<Instant>,
    lane: Arc<Lane<()>>,
}

impl Close for TimerInner {
    fn close(&self) {
        self.lane.close();
    }
}

impl Drop for TimerInner {
    fn drop(&mut self) {
        self.lane.close();
    }
}

/// A timer. Its callback is called until this is dropped or the node is shut down.
#[must_use = "a timer that is dropped does not tick"]
pub struct Timer(#[expect(dead_code, reason = "held for its drop")] Arc<TimerInner>);

impl Node {
    /// Calls `callback` on a thread of the node every `period` of real time. A tick that comes while the
    /// last one still runs is left out.
    pub fn timer(&self, period: Duration, callback: impl FnMut() + Send + 'static) -> Timer {
        Timer(self.timer_on(&self.0.core.executor, period, callback))
    }

    pub(super) fn timer_on(
        &self,
        executor: &Executor,
        period: Duration,
        mut callback: impl FnMut() + Send + 'static,
    ) -> Arc<TimerInner> {
        let period = period.max(Duration::from_micros(100));
        let lane = executor.lane("timer".to_owned(), Some(1), move |()| callback());
        let timer = Arc::new(TimerInner { period, next: Mutex::new(Instant::now() + period), lane });
        lock(&self.0.timers).push(Arc::downgrade(&timer));
        self.0.core.track(&timer);
        self.0.core.alarm.timers_changed();
        timer
    }
}

impl Shared {
    /// Starts the timers that are due and returns when the next one is.
    fn tick(&self, now: Instant) -> Option<Instant> {
        let mut timers = lock(&self.timers);
        timers.retain(|timer| timer.strong_count() > 0);
        let due = timers.iter().filter_map(Weak::upgrade).map(|timer| {
            let mut next = lock(&timer.next);
            if *next <= now {
                timer.lane.push(());
                *next += timer.period;
                if *next <= now {
                    *next = now + timer.period;
                }
            }
            *next
        });
        due.min()
    }
}

/// Ticks timers and checks the graph until the node ends.
pub(super) fn keep_time(shared: &Weak<Shared>, alarm: &Alarm) {
    let mut next_check = Instant::now();
    loop {
        let now = Instant::now();
        let wake_at = {
            let Some(shared) = shared.upgrade() else { return };
            if now >= next_check {
                shared.check_graph();
                shared.clock.check_system();
                next_check = Instant::now() + GRAPH_PERIOD;
            }
            shared.tick(now).map_or(next_check, |next| next.min(next_check))
        };
        let state = lock(&alarm.state);
        let idle = |state: &mut AlarmState| !state.stop && !state.graph_changed && !state.timers_changed;
        let wait = wake_at.saturating_duration_since(Instant::now());
        let (mut state, _) =
            alarm.wake.wait_timeout_while(state, wait, idle).unwrap_or_else(PoisonError::into_inner);
        if state.stop {
            return;
        }
        state.timers_changed = false;
        if std::mem::take(&mut state.graph_changed) {
            next_check = next_check.min(Instant::now() + GRAPH_QUIET);
        }
    }
}
