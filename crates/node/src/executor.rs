//! Runs callbacks on the node's own threads.
//!
//! Each subscription, service and timer is a *lane*: a queue with one consumer. Items of a lane run one
//! after the other and in order; different lanes run side by side on the threads of the node, so that a
//! slow callback does not keep the parameter services from answering. Backends only push into lanes,
//! which never blocks: a lane with a depth drops its oldest item when it is full, as keep-last says.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, ThreadId};
use std::time::Duration;

/// How long closing a lane waits for its running callback.
const CLOSE_WAIT: Duration = Duration::from_secs(5);

/// Locks a mutex whose data stays valid when a holder panics.
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

trait Run: Send + Sync {
    /// Runs one item; true where more wait.
    fn run_one(&self) -> bool;
}

struct Shared {
    ready: Mutex<VecDeque<Arc<dyn Run>>>,
    wake: Condvar,
    stopped: AtomicBool,
}

/// The threads of one node.
pub(crate) struct Executor {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    ids: Vec<ThreadId>,
}

impl Executor {
    pub(crate) fn start(name: &str, threads: usize) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            ready: Mutex::new(VecDeque::new()),
            wake: Condvar::new(),
            stopped: AtomicBool::new(false),
        });
        let mut executor = Self { shared, threads: Mutex::new(Vec::new()), ids: Vec::new() };
        for _ in 0..threads.max(1) {
            let shared = Arc::clone(&executor.shared);
            let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || work(&shared))?;
            executor.ids.push(thread.thread().id());
            lock(&executor.threads).push(thread);
        }
        Ok(executor)
    }

    /// Whether the calling thread is one of its threads, so that its end must not be waited for.
    pub(crate) fn is_inside(&self) -> bool {
        self.ids.contains(&std::thread::current().id())
    }

    /// A queue whose items go to `handler`. `depth` bounds it, dropping the oldest.
    pub(crate) fn lane<T: Send + 'static>(
        &self,
        name: String,
        depth: Option<usize>,
        handler: impl FnMut(T) + Send + 'static,
    ) -> Arc<Lane<T>> {
        Arc::new(Lane {
            name,
            depth: depth.map(|d| d.max(1)),
            shared: Arc::clone(&self.shared),
            state: Mutex::new(LaneState {
                items: VecDeque::new(),
                scheduled: false,
                running_on: None,
                closed: false,
            }),
            idle: Condvar::new(),
            handler: Mutex::new(Some(Box::new(handler))),
            dropped: AtomicU64::new(0),
        })
    }

    /// Stops the threads. Waits for running callbacks, except when called from one of them.
    pub(crate) fn stop(&self) {
        self.shared.stopped.store(true, Ordering::Release);
        lock(&self.shared.ready).clear();
        self.shared.wake.notify_all();
        let threads = std::mem::take(&mut *lock(&self.threads));
        let me = std::thread::current().id();
        for thread in threads {
            if thread.thread().id() != me && thread.join().is_err() {
                tracing::error!("a node thread ended by a panic");
            }
        }
    }
}

impl Drop for Executor {
    fn drop(&mut self) {
        self.stop();
    }
}

fn work(shared: &Shared) {
    loop {
        let lane = {
            let mut ready = lock(&shared.ready);
            loop {
                if shared.stopped.load(Ordering::Acquire) {
                    return;
                }
                if let Some(lane) = ready.pop_front() {
                    break lane;
                }
                ready = shared.wake.wait(ready).unwrap_or_else(PoisonError::into_inner);
            }
        };
        if lane.run_one() && !shared.stopped.load(Ordering::Acquire) {
            lock(&shared.ready).push_back(lane);
            shared.wake.notify_one();
        }
    }
}

struct LaneState<T> {
    items: VecDeque<T>,
    /// Whether the lane is in the ready queue or running.
    scheduled: bool,
    running_on: Option<ThreadId>,
    closed: bool,
}

type Handler<T> = Box<dyn FnMut(T) + Send>;

/// A queue with one consumer.
pub(crate) struct Lane<T> {
    name: String,
    depth: Option<usize>,
    shared: Arc<Shared>,
    state: Mutex<LaneState<T>>,
    idle: Condvar,
    handler: Mutex<Option<Handler<T>>>,
    dropped: AtomicU64,
}

impl<T: Send + 'static> Lane<T> {
    /// Queues an item; never blocks.
    pub(crate) fn push(self: &Arc<Self>, item: T) {
        let oldest;
        {
            let mut state = lock(&self.state);
            if state.closed {
                return;
            }
            oldest = match self.depth {
                Some(depth) if state.items.len() >= depth => state.items.pop_front(),
                _ => None,
            };
            state.items.push_back(item);
            if !state.scheduled {
                state.scheduled = true;
                let lane: Arc<Self> = Arc::clone(self);
                lock(&self.shared.ready).push_back(lane);
                self.shared.wake.notify_one();
            }
        }
        if oldest.is_some() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// How many items were dropped because the callback was too slow.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Closes the lane once its queue is empty and its callback has ended, at latest after `patience`. Returns how many
    /// items the callback never had.
    pub(crate) fn finish(&self, patience: Duration) -> usize {
        let left = {
            let state = lock(&self.state);
            let busy = |state: &mut LaneState<T>| {
                !state.closed && (!state.items.is_empty() || state.running_on.is_some())
            };
            let (state, _) =
                self.idle.wait_timeout_while(state, patience, busy).unwrap_or_else(PoisonError::into_inner);
            state.items.len()
        };
        self.close();
        left
    }

    /// Empties the queue for good. Waits for a running callback to end, at most [`CLOSE_WAIT`], except
    /// when called from within it.
    pub(crate) fn close(&self) {
        let me = std::thread::current().id();
        let items = {
            let mut state = lock(&self.state);
            state.closed = true;
            let items = std::mem::take(&mut state.items);
            let busy = |state: &mut LaneState<T>| state.running_on.is_some_and(|on| on != me);
            let (_state, timed_out) =
                self.idle.wait_timeout_while(state, CLOSE_WAIT, busy).unwrap_or_else(PoisonError::into_inner);
            if timed_out.timed_out() {
                tracing::warn!(lane = %self.name, "a callback is still running {CLOSE_WAIT:?} after its end was requested");
            }
            items
        };
        drop(items);
        let handler = lock(&self.handler).take();
        drop(handler);
    }
}

impl<T: Send + 'static> Run for Lane<T> {
    fn run_one(&self) -> bool {
        let item = {
            let mut state = lock(&self.state);
            let Some(item) = state.items.pop_front() else {
                state.scheduled = false;
                return false;
            };
            state.running_on = Some(std::thread::current().id());
            item
        };
        // Taken out while it runs, so that the callback may close its own lane.
        let handler = lock(&self.handler).take();
        if let Some(mut handler) = handler {
            if catch_unwind(AssertUnwindSafe(|| handler(item))).is_err() {
                tracing::error!(lane = %self.name, "a callback panicked: its message is lost, the node goes on");
            }
            if !lock(&self.state).closed {
                *lock(&self.handler) = Some(handler);
            }
        }
        let mut state = lock(&self.state);
        state.running_on = None;
        state.scheduled = !state.items.is_empty();
        let more = state.scheduled;
        drop(state);
        self.idle.notify_all();
        more
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    const WAIT: Duration = Duration::from_secs(10);

    #[test]
    fn items_of_a_lane_stay_in_order() {
        let executor = Executor::start("test", 4).unwrap();
        let (tx, rx) = mpsc::channel();
        let lane = executor.lane("numbers".into(), None, move |i: u32| tx.send(i).unwrap());
        for i in 0..1000 {
            lane.push(i);
        }
        let got: Vec<u32> = (0..1000).map(|_| rx.recv_timeout(WAIT).unwrap()).collect();
        assert!(got.is_sorted());
    }

    #[test]
    fn a_full_lane_drops_the_oldest() {
        let executor = Executor::start("test", 1).unwrap();
        let (entered_tx, entered) = mpsc::channel();
        let (go, gate) = mpsc::channel::<()>();
        let (tx, rx) = mpsc::channel();
        let lane = executor.lane("slow".into(), Some(2), move |i: u32| {
            if i == 0 {
                entered_tx.send(()).unwrap();
                gate.recv_timeout(WAIT).unwrap();
            }
            tx.send(i).unwrap();
        });
        lane.push(0);
        entered.recv_timeout(WAIT).unwrap();
        for i in 1..=5 {
            lane.push(i);
        }
        go.send(()).unwrap();
        let got: Vec<u32> = (0..3).map(|_| rx.recv_timeout(WAIT).unwrap()).collect();
        assert_eq!(got, [0, 4, 5]);
        assert_eq!(lane.dropped(), 3);
    }

    #[test]
    fn a_slow_lane_does_not_hold_up_another() {
        let executor = Executor::start("test", 2).unwrap();
        let (go, gate) = mpsc::channel::<()>();
        let slow = executor.lane("slow".into(), None, move |(): ()| gate.recv_timeout(WAIT).unwrap());
        let (tx, rx) = mpsc::channel();
        let quick = executor.lane("quick".into(), None, move |(): ()| tx.send(()).unwrap());
        slow.push(());
        quick.push(());
        rx.recv_timeout(WAIT).unwrap();
        go.send(()).unwrap();
    }

    #[test]
    fn a_panic_loses_one_item_only() {
        let executor = Executor::start("test", 1).unwrap();
        let (tx, rx) = mpsc::channel();
        let lane = executor.lane("panics".into(), None, move |i: u32| {
            assert_ne!(i, 1, "the panic of this test");
            tx.send(i).unwrap();
        });
        for i in 0..3 {
            lane.push(i);
        }
        assert_eq!(rx.recv_timeout(WAIT).unwrap(), 0);
        assert_eq!(rx.recv_timeout(WAIT).unwrap(), 2);
    }

    #[test]
    fn a_finished_lane_has_run_what_was_queued() {
        let executor = Executor::start("test", 1).unwrap();
        let seen = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&seen);
        let lane = executor.lane("finished".into(), None, move |(): ()| {
            count.fetch_add(1, Ordering::SeqCst);
        });
        for _ in 0..10_000 {
            lane.push(());
        }
        assert_eq!((lane.finish(WAIT), seen.load(Ordering::SeqCst)), (0, 10_000));

        let (go, gate) = mpsc::channel::<()>();
        let (entered_tx, entered) = mpsc::channel();
        let lane = executor.lane("stuck".into(), None, move |(): ()| {
            entered_tx.send(()).unwrap_or_default();
            gate.recv_timeout(WAIT).unwrap_or_default();
        });
        for _ in 0..3 {
            lane.push(());
        }
        entered.recv_timeout(WAIT).unwrap();
        std::thread::scope(|scope| {
            let left = scope.spawn(|| lane.finish(Duration::from_millis(1)));
            // Closing waits for the callback that runs.
            while !lock(&lane.state).closed {
                std::thread::yield_now();
            }
            go.send(()).unwrap();
            assert_eq!(left.join().unwrap(), 2, "what the callback never had is counted");
        });
    }

    #[test]
    fn nothing_runs_after_close() {
        let executor = Executor::start("test", 2).unwrap();
        let count = Arc::new(AtomicU64::new(0));
        let seen = Arc::clone(&count);
        let lane = executor.lane("closed".into(), None, move |(): ()| {
            seen.fetch_add(1, Ordering::SeqCst);
        });
        for _ in 0..100 {
            lane.push(());
        }
        lane.close();
        let at_close = count.load(Ordering::SeqCst);
        lane.push(());
        executor.stop();
        assert_eq!(count.load(Ordering::SeqCst), at_close);
        assert_eq!(Arc::strong_count(&count), 1, "the handler is gone with what it captured");
    }

    #[test]
    fn a_callback_may_close_its_own_lane() {
        let executor = Executor::start("test", 1).unwrap();
        let (tx, rx) = mpsc::channel();
        let slot: Arc<Mutex<Option<Arc<Lane<()>>>>> = Arc::default();
        let own = Arc::clone(&slot);
        let lane = executor.lane("own".into(), None, move |()| {
            lock(&own).take().unwrap().close();
            tx.send(()).unwrap();
        });
        *lock(&slot) = Some(Arc::clone(&lane));
        lane.push(());
        rx.recv_timeout(WAIT).unwrap();
    }
}
