//! The one thread that may touch an rcl node.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, TryRecvError};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bytes::Bytes;
use dermis_node::backend::{BackendError, MessageSink, RawMessage};
use futures::future::BoxFuture;
use futures::stream::Stream;
use futures::{FutureExt, StreamExt};

use crate::{Gate, lock};

/// Longest wait for an event before commands are read. A message ends the wait at once.
const WAIT: Duration = Duration::from_millis(5);
/// How often a client asks whether its server is there.
const AVAILABILITY: Duration = Duration::from_millis(200);

type Command = Box<dyn FnOnce(&mut State) + Send>;
/// Encoded messages of one subscription.
pub(crate) type Messages = Box<dyn Stream<Item = Vec<u8>> + Unpin + Send>;
/// Completes when the server of a client is there.
pub(crate) type Poll = Box<dyn Fn() -> Option<BoxFuture<'static, ()>> + Send>;
/// Takes the requests that came and hands them on; the flag says whether they are still wanted.
pub(crate) type Server = Box<dyn FnMut(bool) + Send>;

/// What lives on the worker's thread.
pub(crate) struct State {
    pub node: r2r::Node,
    pub subscriptions: Vec<(Gate, Messages, MessageSink)>,
    pub servers: Vec<(Gate, Server)>,
    pub watches: Vec<Watch>,
}

/// Follows whether the server of one client is there.
pub(crate) struct Watch {
    gate: Gate,
    poll: Poll,
    available: Arc<AtomicBool>,
    pending: Option<BoxFuture<'static, ()>>,
    checked: Instant,
}

impl Watch {
    pub fn new(gate: Gate, poll: Poll, available: Arc<AtomicBool>) -> Self {
        let pending = poll();
        Self { gate, poll, available, pending, checked: Instant::now() }
    }

    fn step(&mut self) {
        if let Some(pending) = &mut self.pending {
            if pending.now_or_never().is_some() {
                self.available.store(true, Ordering::Release);
                self.pending = None;
            } else if self.checked.elapsed() > AVAILABILITY {
                self.available.store(false, Ordering::Release);
            }
        } else if self.checked.elapsed() > AVAILABILITY {
            self.pending = (self.poll)();
            self.checked = Instant::now();
        }
    }
}

/// Handle of the thread; the thread ends on request, or with its last handle.
#[derive(Clone)]
pub(crate) struct Worker {
    commands: mpsc::Sender<Command>,
    thread: Arc<Thread>,
}

struct Thread {
    name: String,
    stopping: Arc<AtomicBool>,
    handle: Mutex<Option<JoinHandle<()>>>,
}

impl Drop for Thread {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Thread {
    fn stop(&self) {
        self.stopping.store(true, Ordering::Release);
        let handle = lock(&self.handle).take();
        if let Some(handle) = handle
            && handle.thread().id() != std::thread::current().id()
            && handle.join().is_err()
        {
            tracing::error!("the ROS thread of {} panicked", self.name);
        }
    }
}

impl Worker {
    pub fn start(node: r2r::Node, name: &str) -> Self {
        let (commands, inbox) = mpsc::channel::<Command>();
        let stopping = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&stopping);
        let spawned = std::thread::Builder::new().name("ros".to_owned()).spawn(move || {
            let mut state =
                State { node, subscriptions: Vec::new(), servers: Vec::new(), watches: Vec::new() };
            while !stop.load(Ordering::Acquire) {
                loop {
                    match inbox.try_recv() {
                        Ok(command) => command(&mut state),
                        Err(TryRecvError::Empty) => break,
                        Err(TryRecvError::Disconnected) => return,
                    }
                }
                if state.subscriptions.is_empty() && state.servers.is_empty() && state.watches.is_empty() {
                    // rcl does not wait for nothing: it refuses at once.
                    match inbox.recv_timeout(WAIT) {
                        Ok(command) => command(&mut state),
                        Err(RecvTimeoutError::Timeout) => {}
                        Err(RecvTimeoutError::Disconnected) => return,
                    }
                    continue;
                }
                state.node.spin_once(WAIT);
                deliver(&mut state);
            }
        });
        let handle = match spawned {
            Ok(handle) => Some(handle),
            Err(e) => {
                tracing::error!("no thread for {name}: {e}");
                None
            }
        };
        let thread = Arc::new(Thread { name: name.to_owned(), stopping, handle: Mutex::new(handle) });
        Self { commands, thread }
    }

    /// Runs `f` on the thread and waits for what it returns.
    pub fn ask<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut State) -> T + Send + 'static,
    ) -> Result<T, BackendError> {
        let (answer, wait) = mpsc::channel();
        self.tell(move |state| {
            // Nobody waits any more: there is nothing to tell.
            let _ = answer.send(f(state));
        });
        wait.recv().map_err(|_| BackendError::Closed { node: self.thread.name.clone() })
    }

    /// Runs `f` on the thread, some time; not at all after [`stop`](Self::stop).
    pub fn tell(&self, f: impl FnOnce(&mut State) + Send + 'static) {
        if !self.thread.stopping.load(Ordering::Acquire) {
            // A thread that ended has destroyed everything that `f` could touch.
            let _ = self.commands.send(Box::new(f));
        }
    }

    pub fn stop(&self) {
        self.thread.stop();
    }
}

fn deliver(state: &mut State) {
    state.subscriptions.retain_mut(|(gate, messages, sink)| {
        let open = lock(gate);
        if !*open {
            return false;
        }
        while let Some(Some(payload)) = messages.next().now_or_never() {
            sink(RawMessage {
                payload: Bytes::from(payload),
                // r2r takes messages with rcl's information about them, but does not hand that on.
                source_ns: None,
                received_ns: dermis_node::system_now(),
                publication: None,
            });
        }
        true
    });
    state.servers.retain_mut(|(gate, server)| {
        let open = lock(gate);
        server(*open);
        *open
    });
    state.watches.retain_mut(|watch| {
        let open = *lock(&watch.gate);
        if open {
            watch.step();
        }
        open
    });
}
