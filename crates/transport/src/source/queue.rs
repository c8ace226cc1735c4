//! The queue between the reader thread and the consumer: bounded in bytes, in pieces and in status events.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use tokio::sync::Notify;

use super::{Event, SourceStats};

/// Addresses of others that are remembered.
const OTHERS: usize = 8;
/// What is left out, and whose it is.
#[derive(Debug, Clone, Copy)]
pub(super) enum Refused {
    Datagram(SocketAddr),
    Client(SocketAddr),
}

/// Status events that wait for the consumer; a link that flaps while nobody listens must not fill the memory.
const STATUS_LIMIT: usize = 64;

#[derive(Debug)]
pub(super) struct Queue {
    state: Mutex<State>,
    arrived: Condvar,
    taken: Condvar,
    notify: Notify,
    limit_bytes: usize,
    limit_chunks: usize,
}

#[derive(Debug, Default)]
struct State {
    events: VecDeque<Event>,
    chunks: usize,
    stats: SourceStats,
    ended: bool,
    closed: bool,
    /// Threads that wait for an event, and for room: who wakes nobody asks nothing of the system.
    listeners: usize,
    pushers: usize,
    /// When the consumer left with an event or without one, and the longest that it stayed away of late \[s\].
    left: Option<Instant>,
    away: f64,
}

/// What a wait for an event brought.
pub(super) enum Next<T> {
    Event(Event),
    /// The time is over.
    Nothing,
    /// What the consumer is to do instead of waiting.
    Instead(T),
}

/// \[s\] A consumer that comes back sooner reads the line itself.
const QUICK: f64 = 1e-3;
/// What an absence counts at the next return.
const FADING: f64 = 0.9;

impl State {
    fn drop_oldest_bytes(&mut self) {
        let Some(at) = self.events.iter().position(|e| matches!(e, Event::Bytes { .. })) else { return };
        let Some(Event::Bytes { data, .. }) = self.events.remove(at) else { return };
        self.chunks -= 1;
        self.stats.queued_bytes -= data.len();
        self.stats.dropped_chunks += 1;
        self.stats.dropped_bytes += data.len() as u64;
        match at.checked_sub(1).and_then(|before| self.events.get_mut(before)) {
            Some(Event::Overflow { dropped_bytes }) => *dropped_bytes += data.len() as u64,
            _ => self.events.insert(at, Event::Overflow { dropped_bytes: data.len() as u64 }),
        }
    }

    fn push_status(&mut self, event: Event) {
        if self.events.len() - self.chunks >= STATUS_LIMIT {
            // Nobody has listened through all these changes: what is left of them is that bytes are missing.
            let mut dropped = 0;
            for event in self.events.drain(..) {
                match event {
                    Event::Bytes { data, .. } => {
                        self.stats.dropped_chunks += 1;
                        self.stats.dropped_bytes += data.len() as u64;
                        dropped += data.len() as u64;
                    }
                    Event::Overflow { dropped_bytes } => dropped += dropped_bytes,
                    _ => {}
                }
            }
            self.chunks = 0;
            self.stats.queued_bytes = 0;
            self.events.push_back(Event::Overflow { dropped_bytes: dropped });
        }
        self.events.push_back(event);
    }

    fn pop(&mut self) -> Option<Event> {
        match self.events.pop_front() {
            Some(Event::Bytes { data, received_ns }) => {
                self.chunks -= 1;
                self.stats.queued_bytes -= data.len();
                Some(Event::Bytes { data, received_ns })
            }
            Some(event) => Some(event),
            None => (self.ended || self.closed).then_some(Event::Ended),
        }
    }
}

impl Queue {
    pub(super) fn new(limit_bytes: usize, limit_chunks: usize) -> Self {
        Self {
            state: Mutex::default(),
            arrived: Condvar::new(),
            taken: Condvar::new(),
            notify: Notify::new(),
            limit_bytes,
            limit_chunks,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // Nothing in here leaves the state half-changed, so that a panic elsewhere does no harm to it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wake(&self, state: MutexGuard<'_, State>) {
        let awaited = state.listeners > 0;
        drop(state);
        if awaited {
            self.arrived.notify_one();
        }
        self.notify.notify_one();
    }

    fn made_room(&self, state: MutexGuard<'_, State>) {
        let awaited = state.pushers > 0;
        drop(state);
        if awaited {
            self.taken.notify_one();
        }
    }

    /// Whether a consumer waits that could read the line itself: one that always comes back soon.
    pub(super) fn quick_consumer(&self) -> bool {
        let state = self.state();
        state.listeners > 0 && state.away < QUICK
    }

    /// Wakes a consumer that waits: there is something else to do.
    pub(super) fn nudge(&self) {
        self.wake(self.state());
    }

    /// Appends bytes, and drops the oldest where the consumer is too slow.
    pub(super) fn push(&self, data: Bytes, received_ns: i64) {
        let mut state = self.state();
        self.count(&mut state, &data, received_ns);
        while state.chunks > 0
            && (state.chunks >= self.limit_chunks || state.stats.queued_bytes + data.len() > self.limit_bytes)
        {
            state.drop_oldest_bytes();
        }
        self.append(state, data, received_ns);
    }

    /// Appends bytes, and waits where the consumer is too slow: for sources that can wait. False when closed.
    pub(super) fn push_waiting(&self, data: Bytes, received_ns: impl FnOnce() -> i64) -> bool {
        let mut state = self.state();
        while !state.closed
            && state.chunks > 0
            && (state.chunks >= self.limit_chunks || state.stats.queued_bytes + data.len() > self.limit_bytes)
        {
            state.pushers += 1;
            state = self.taken.wait(state).unwrap_or_else(PoisonError::into_inner);
            state.pushers -= 1;
        }
        if state.closed {
            return false;
        }
        let received_ns = received_ns();
        self.count(&mut state, &data, received_ns);
        self.append(state, data, received_ns);
        true
    }

    fn count(&self, state: &mut State, data: &Bytes, received_ns: i64) {
        state.stats.bytes += data.len() as u64;
        state.stats.chunks += 1;
        state.stats.last_received_ns = received_ns;
    }

    fn append(&self, mut state: MutexGuard<'_, State>, data: Bytes, received_ns: i64) {
        state.chunks += 1;
        state.stats.queued_bytes += data.len();
        state.events.push_back(Event::Bytes { data, received_ns });
        self.wake(state);
    }

    pub(super) fn connected(&self, description: &str) {
        let mut state = self.state();
        state.stats.connects += 1;
        state.stats.connected = true;
        state.stats.peer = None;
        state.push_status(Event::Connected { description: description.to_owned() });
        self.wake(state);
    }

    pub(super) fn listening(&self, endpoint: String) {
        let mut state = self.state();
        state.stats.endpoint = Some(endpoint.clone());
        state.push_status(Event::Listening { endpoint });
        self.wake(state);
    }

    /// Something that `who` sent, or its connection, is left out.
    pub(super) fn left_out(&self, who: Refused, notice: Option<String>) {
        let mut state = self.state();
        let address = match who {
            Refused::Datagram(address) => {
                state.stats.refused_datagrams += 1;
                address
            }
            Refused::Client(address) => {
                state.stats.refused_connections += 1;
                address
            }
        };
        let others = &mut state.stats.others;
        if !others.contains(&address) {
            if others.len() >= OTHERS {
                others.remove(0);
            }
            others.push(address);
        }
        if let Some(notice) = notice {
            state.push_status(Event::OtherSender { notice, taken_over: false });
            self.wake(state);
        }
    }

    /// From now on `peer` is read; a notice where it was another one.
    pub(super) fn reads(&self, peer: SocketAddr, notice: Option<String>) {
        let mut state = self.state();
        state.stats.peer = Some(peer);
        state.stats.others.retain(|other| *other != peer);
        if let Some(notice) = notice {
            state.push_status(Event::OtherSender { notice, taken_over: true });
            self.wake(state);
        }
    }

    pub(super) fn set_endpoint(&self, endpoint: String) {
        self.state().stats.endpoint = Some(endpoint);
    }

    pub(super) fn disconnected(&self, reason: String, retry_in: Duration, was_up: bool) {
        let mut state = self.state();
        if was_up {
            state.stats.disconnects += 1;
        } else {
            state.stats.failed_attempts += 1;
        }
        state.stats.connected = false;
        state.stats.last_reason = Some(reason.clone());
        state.push_status(Event::Disconnected { reason, retry_in });
        self.wake(state);
    }

    /// No event will be pushed any more.
    pub(super) fn end(&self) {
        let mut state = self.state();
        state.ended = true;
        state.stats.connected = false;
        drop(state);
        self.arrived.notify_all();
        self.notify.notify_one();
    }

    /// Nobody will take events any more.
    pub(super) fn close(&self) {
        self.state().closed = true;
        self.taken.notify_all();
    }

    pub(super) async fn next(&self) -> Event {
        loop {
            if let Some(event) = self.take(self.state()) {
                return event;
            }
            // A permit is kept for a wake-up between the look and the wait.
            self.notify.notified().await;
        }
    }

    /// The next event until then, or what `instead` gives where there is none yet and the time is not over.
    pub(super) fn next_until<T>(&self, until: Instant, instead: impl Fn() -> Option<T>) -> Next<T> {
        let mut state = self.state();
        let mut now = Instant::now();
        if let Some(left) = state.left {
            state.away = (FADING * state.away).max(now.saturating_duration_since(left).as_secs_f64());
        }
        loop {
            if let Some(event) = state.pop() {
                state.left = Some(now);
                self.made_room(state);
                return Next::Event(event);
            }
            let left = until.saturating_duration_since(now);
            if left.is_zero() {
                state.left = Some(now);
                return Next::Nothing;
            }
            if let Some(instead) = instead() {
                state.left = None;
                return Next::Instead(instead);
            }
            state.listeners += 1;
            state = self.arrived.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
            state.listeners -= 1;
            now = Instant::now();
        }
    }

    fn take(&self, mut state: MutexGuard<'_, State>) -> Option<Event> {
        let event = state.pop()?;
        self.made_room(state);
        Some(event)
    }

    pub(super) fn stats(&self) -> SourceStats {
        self.state().stats.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Queue {
        fn next_timeout(&self, timeout: Duration) -> Option<Event> {
            match self.next_until(Instant::now() + timeout, || None::<()>) {
                Next::Event(event) => Some(event),
                _ => None,
            }
        }
    }

    fn bytes(n: usize) -> Bytes {
        Bytes::from(vec![n as u8; n])
    }

    #[test]
    fn the_oldest_bytes_go_and_the_hole_is_marked_where_it_is() {
        let queue = Queue::new(10, 100);
        queue.connected("here");
        for n in [4, 5, 6, 3] {
            queue.push(bytes(n), 0);
        }
        let got: Vec<_> = std::iter::from_fn(|| queue.next_timeout(Duration::ZERO)).collect();
        assert_eq!(
            got,
            [
                Event::Connected { description: "here".into() },
                Event::Overflow { dropped_bytes: 9 },
                Event::Bytes { data: bytes(6), received_ns: 0 },
                Event::Bytes { data: bytes(3), received_ns: 0 },
            ]
        );
        let stats = queue.stats();
        assert_eq!((stats.dropped_bytes, stats.dropped_chunks, stats.queued_bytes), (9, 2, 0));
    }

    #[test]
    fn nothing_grows_while_nobody_listens() {
        let queue = Queue::new(1000, 20);
        for i in 0..10_000 {
            queue.push(bytes(1 + i % 200), 0);
            if i % 7 == 0 {
                queue.disconnected("gone".into(), Duration::ZERO, true);
                queue.connected("back");
            }
        }
        let state = queue.state();
        assert!(state.chunks <= 20 && state.stats.queued_bytes <= 1000);
        assert!(state.events.len() <= 20 + 2 * STATUS_LIMIT + 1, "{} events", state.events.len());
    }

    #[test]
    fn a_source_that_can_wait_never_runs_ahead() {
        use std::sync::atomic::{AtomicU64, Ordering};

        let (queue, taken) = (Queue::new(1000, 2), AtomicU64::new(0));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for i in 0..2000u64 {
                    let room = || i64::from(i < taken.load(Ordering::SeqCst) + 2);
                    assert!(queue.push_waiting(bytes(3), room));
                }
                queue.end();
            });
            loop {
                // Counted before it is taken: the pusher must not have gone on earlier than that.
                taken.fetch_add(1, Ordering::SeqCst);
                match queue.next_timeout(Duration::from_secs(20)) {
                    Some(Event::Bytes { received_ns, .. }) => {
                        assert_eq!(received_ns, 1, "pushed beyond the bound");
                    }
                    end => break assert_eq!(end, Some(Event::Ended)),
                }
            }
        });
        assert_eq!((queue.stats().dropped_bytes, queue.stats().bytes), (0, 6000));
        queue.push(bytes(1), 0);
        queue.push(bytes(1), 0);
        queue.close();
        assert!(!queue.push_waiting(bytes(1), || 0), "nobody waits for a consumer that is gone");
    }

    #[test]
    fn only_a_consumer_that_always_comes_back_soon_is_quick() {
        let queue = Queue::new(1000, 20);
        let waits = || {
            let patience = Instant::now() + Duration::from_secs(20);
            while queue.state().listeners == 0 {
                assert!(Instant::now() < patience, "nobody waits");
                std::thread::yield_now();
            }
            queue.quick_consumer()
        };
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while let Some(Event::Bytes { received_ns, .. }) = queue.next_timeout(Duration::from_secs(20))
                {
                    std::thread::sleep(Duration::from_millis(received_ns.unsigned_abs()));
                }
            });
            // It was not away yet.
            assert!(waits());
            queue.push(bytes(1), 5);
            while queue.state().listeners > 0 {
                std::thread::yield_now();
            }
            assert!(!waits(), "away for 5 ms");
            queue.end();
        });
        assert!(!queue.quick_consumer(), "nobody waits");
    }

    #[test]
    fn ended_comes_last_and_for_ever() {
        let queue = Queue::new(10, 10);
        queue.push(bytes(1), 5);
        queue.end();
        assert!(matches!(queue.next_timeout(Duration::ZERO), Some(Event::Bytes { received_ns: 5, .. })));
        assert_eq!(queue.next_timeout(Duration::ZERO), Some(Event::Ended));
        assert_eq!(queue.next_timeout(Duration::ZERO), Some(Event::Ended));
    }
}
