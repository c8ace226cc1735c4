//! What the threads of the node share.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use dermis_node::{LogLevel, Node, system_now};

use super::senders::{Senders, start_caller};
use crate::machine::{Done, Event, Reflex};
use crate::rules::Action;

/// What is sent at the end leaves the network's queue within this time: a session that closes sends it no more.
const PARTING: Duration = Duration::from_millis(20);

/// How messages went since the last diagnosis.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Figures {
    /// Messages taken.
    pub(super) messages: u64,
    /// \[ns\] from the arrival of a message to the end of its handling: sum and largest.
    pub(super) delay_sum: i64,
    pub(super) delay_max: i64,
    /// How often a rule began to act, since the start.
    pub(super) acted: u64,
}

impl Figures {
    fn count(&mut self, delay_ns: i64) {
        self.messages += 1;
        self.delay_sum = self.delay_sum.saturating_add(delay_ns);
        self.delay_max = self.delay_max.max(delay_ns);
    }
}

/// What the lock holds.
pub(super) struct Core {
    pub(super) reflex: Reflex,
    pub(super) figures: Figures,
    /// What the thread that keeps the time sleeps until; `None`: until it is woken.
    sleeps_until: Option<Duration>,
    /// Whether it guarded before, and said that it does not any more.
    paused: bool,
    ended: bool,
}

/// The state machine with its time, its publishers and its lock.
pub(super) struct Guard {
    pub(super) node: Node,
    pub(super) active: AtomicBool,
    begun: Instant,
    senders: Senders,
    core: Mutex<Core>,
    wake: Condvar,
}

impl Guard {
    pub(super) fn new(node: Node, reflex: Reflex, senders: Senders) -> Self {
        let core =
            Core { reflex, figures: Figures::default(), sleeps_until: None, paused: false, ended: false };
        Self {
            node,
            active: AtomicBool::new(false),
            begun: Instant::now(),
            senders,
            core: Mutex::new(core),
            wake: Condvar::new(),
        }
    }

    /// One thread for each action that calls a service.
    pub(super) fn start_callers(self: &Arc<Self>, actions: &[Action]) -> std::io::Result<()> {
        for (index, action) in actions.iter().enumerate() {
            if let Some(client) = self.senders.client(index) {
                let guard: Weak<Self> = Arc::downgrade(self);
                let answered = move |success: bool| {
                    guard.upgrade().is_some_and(|guard| {
                        guard.handle(None, |reflex, now| reflex.answered(index, success, now));
                        true
                    })
                };
                let requests = start_caller(client, action, answered)?;
                self.senders.set_caller(index, requests);
            }
        }
        Ok(())
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The time of the state machine: it does not run backwards, whatever is done to the system's clock.
    pub(super) fn now(&self) -> Duration {
        self.begun.elapsed()
    }

    /// A message arrived at `received_ns` of the system's clock; `take` gets the state machine, the time, and that of the
    /// node's clock in ns.
    pub(super) fn hear(&self, received_ns: i64, take: impl FnOnce(&mut Reflex, Duration, i64) -> Done) {
        if !self.is_active() {
            return;
        }
        let clock_ns = self.node.clock().now();
        self.handle(Some(received_ns), |reflex, now| take(reflex, now, clock_ns));
    }

    /// Calls the state machine and sends what it says, under one lock, so that what is decided first is sent first.
    fn handle(&self, received_ns: Option<i64>, call: impl FnOnce(&mut Reflex, Duration) -> Done) {
        let events = {
            let mut core = self.lock();
            if !self.is_active() || core.ended {
                return;
            }
            let done = call(&mut core.reflex, self.now());
            let events = self.carry_out(&mut core, done);
            if let Some(received_ns) = received_ns {
                core.figures.count(system_now().saturating_sub(received_ns));
            }
            events
        };
        self.report(&events);
    }

    /// Sends commands, counts, and wakes the thread that keeps the time where it would sleep too long.
    fn carry_out(&self, core: &mut Core, done: Done) -> Vec<Event> {
        let stamp = if done.commands.is_empty() { 0 } else { self.node.clock().now() };
        for command in &done.commands {
            self.senders.send(*command, stamp);
        }
        let acts = done.events.iter().filter(|event| matches!(event, Event::Acts { .. })).count();
        core.figures.acted += acts as u64;
        let wanted = core.reflex.next_wake();
        if wanted.is_some_and(|at| core.sleeps_until.is_none_or(|until| at < until)) {
            self.wake.notify_all();
        }
        done.events
    }

    /// Events go to the log and to `/rosout`, after everything was sent.
    fn report(&self, events: &[Event]) {
        for event in events {
            let level = if matches!(event, Event::Acts { .. }) { LogLevel::Warn } else { LogLevel::Info };
            self.node.log(level, event.to_string());
        }
    }

    /// Releases every latched rule, or none; one sentence in either case.
    pub(super) fn release(&self) -> Result<String, String> {
        if !self.is_active() {
            return Err("the reflex node is not active, so that it holds nothing to release".to_owned());
        }
        let events = {
            let mut core = self.lock();
            let done = core.reflex.release(self.now()).map_err(|refused| refused.to_string())?;
            self.carry_out(&mut core, done)
        };
        self.report(&events);
        let released = events.iter().filter(|event| matches!(event, Event::Released { .. })).count();
        Ok(match released {
            0 => "no rule was latched".to_owned(),
            1 => "1 rule is released".to_owned(),
            n => format!("{n} rules are released"),
        })
    }

    /// Begins or ends to guard.
    pub(super) fn activate(&self, active: bool) {
        let mut core = self.lock();
        if core.ended || self.active.swap(active, Ordering::AcqRel) == active {
            return;
        }
        let now = self.now();
        let done = if active {
            if core.paused { core.reflex.resume(now) } else { core.reflex.tick(now) }
        } else {
            // From now on nobody guards.
            core.paused = true;
            Done { commands: core.reflex.last_words(), events: Vec::new() }
        };
        let events = self.carry_out(&mut core, done);
        self.wake.notify_all();
        drop(core);
        self.report(&events);
        if !active {
            std::thread::sleep(PARTING);
        }
    }

    /// Ends the thread that keeps the time, and the callers.
    pub(super) fn end(&self) {
        self.lock().ended = true;
        self.wake.notify_all();
        self.senders.end();
    }

    /// [`Self::keep_time`], and again after a panic: without it no timeout would ever act. A panic is a stop.
    pub(super) fn keep_time_always(&self) {
        while catch_unwind(AssertUnwindSafe(|| self.keep_time())).is_err() {
            tracing::error!(
                "the thread that keeps the reflexes' time panicked: it stops the robot, and goes on"
            );
            let stamp = self.node.clock().now();
            for command in self.lock().reflex.stop_commands() {
                self.senders.send(command, stamp);
            }
            std::thread::sleep(PARTING);
        }
    }

    /// Calls the state machine when it requested to be called, until the node ends.
    fn keep_time(&self) {
        let mut core = self.lock();
        while !core.ended {
            let wanted = core.reflex.next_wake().filter(|_| self.is_active());
            let now = self.now();
            if wanted.is_some_and(|at| at <= now) {
                let done = core.reflex.tick(now);
                let events = self.carry_out(&mut core, done);
                if !events.is_empty() {
                    drop(core);
                    self.report(&events);
                    core = self.lock();
                }
                continue;
            }
            core.sleeps_until = wanted;
            core = match wanted {
                Some(at) => self.wake.wait_timeout(core, at - now).unwrap_or_else(PoisonError::into_inner).0,
                None => self.wake.wait(core).unwrap_or_else(PoisonError::into_inner),
            };
            // Awake: whoever changes the time of the next call need not wake it before it looks again.
            core.sleeps_until = Some(Duration::ZERO);
        }
    }
}
