//! Managed life of a node: Unconfigured → Inactive → Active → Finalized, as the ROS 2 design
//! “Managed nodes” has it, with the standard services to drive it.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};
use std::thread::ThreadId;
use std::time::Duration;

use dermis_msgs::lifecycle_msgs::msg::{
    State as StateMsg, Transition as TransitionMsg, TransitionDescription, TransitionEvent,
};

use crate::error::NodeError;
use crate::executor::lock;

/// The states a node rests in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Made, but without its resources.
    Unconfigured,
    /// Configured; holds its resources and publishes nothing.
    Inactive,
    /// At work.
    Active,
    /// At its end.
    Finalized,
}

impl State {
    const ALL: [Self; 4] = [Self::Unconfigured, Self::Inactive, Self::Active, Self::Finalized];

    /// The label of the standard: `unconfigured`, …
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
        }
    }

    const fn id(self) -> u8 {
        match self {
            Self::Unconfigured => StateMsg::PRIMARY_STATE_UNCONFIGURED,
            Self::Inactive => StateMsg::PRIMARY_STATE_INACTIVE,
            Self::Active => StateMsg::PRIMARY_STATE_ACTIVE,
            Self::Finalized => StateMsg::PRIMARY_STATE_FINALIZED,
        }
    }

    fn to_msg(self) -> StateMsg {
        StateMsg { id: self.id(), label: self.label().to_owned() }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.label())
    }
}

/// The ways between the states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Transition {
    /// Unconfigured → Inactive.
    Configure,
    /// Inactive → Unconfigured.
    Cleanup,
    /// Inactive → Active.
    Activate,
    /// Active → Inactive.
    Deactivate,
    /// Any but Finalized → Finalized.
    Shutdown,
}

impl Transition {
    const ALL: [Self; 5] = [Self::Configure, Self::Cleanup, Self::Activate, Self::Deactivate, Self::Shutdown];

    /// The label of the standard: `configure`, …
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::Cleanup => "cleanup",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
            Self::Shutdown => "shutdown",
        }
    }

    /// Where it leads from `state`; `None` where it cannot be taken.
    #[must_use]
    pub const fn goal(self, state: State) -> Option<State> {
        match (self, state) {
            (Self::Configure, State::Unconfigured) | (Self::Deactivate, State::Active) => {
                Some(State::Inactive)
            }
            (Self::Cleanup, State::Inactive) => Some(State::Unconfigured),
            (Self::Activate, State::Inactive) => Some(State::Active),
            (Self::Shutdown, State::Unconfigured | State::Inactive | State::Active) => Some(State::Finalized),
            _ => None,
        }
    }

    /// The number of the standard; shutdown has one for each state it starts from.
    const fn id(self, from: State) -> u8 {
        match (self, from) {
            (Self::Configure, _) => TransitionMsg::TRANSITION_CONFIGURE,
            (Self::Cleanup, _) => TransitionMsg::TRANSITION_CLEANUP,
            (Self::Activate, _) => TransitionMsg::TRANSITION_ACTIVATE,
            (Self::Deactivate, _) => TransitionMsg::TRANSITION_DEACTIVATE,
            (Self::Shutdown, State::Inactive) => TransitionMsg::TRANSITION_INACTIVE_SHUTDOWN,
            (Self::Shutdown, State::Active) => TransitionMsg::TRANSITION_ACTIVE_SHUTDOWN,
            (Self::Shutdown, _) => TransitionMsg::TRANSITION_UNCONFIGURED_SHUTDOWN,
        }
    }

    /// The state a node is in while the callback runs, as events report it.
    fn transient(self) -> StateMsg {
        let (id, label) = match self {
            Self::Configure => (StateMsg::TRANSITION_STATE_CONFIGURING, "configuring"),
            Self::Cleanup => (StateMsg::TRANSITION_STATE_CLEANINGUP, "cleaningup"),
            Self::Activate => (StateMsg::TRANSITION_STATE_ACTIVATING, "activating"),
            Self::Deactivate => (StateMsg::TRANSITION_STATE_DEACTIVATING, "deactivating"),
            Self::Shutdown => (StateMsg::TRANSITION_STATE_SHUTTINGDOWN, "shuttingdown"),
        };
        StateMsg { id, label: label.to_owned() }
    }

    /// Reads the request of `~/change_state`: the number counts, the label where the number is 0.
    fn from_msg(msg: &TransitionMsg, from: State) -> Option<Self> {
        Self::ALL.into_iter().find(|transition| {
            if msg.id == 0 {
                msg.label == transition.label()
                    || (*transition == Self::Shutdown && msg.label.ends_with("_shutdown"))
            } else {
                msg.id == transition.id(from)
            }
        })
    }
}

/// Longest wait of a node that ends for a transition that still runs.
const TRANSITION_WAIT: Duration = Duration::from_secs(5);

type Callback = Box<dyn FnMut(State) -> Result<(), String> + Send>;
type EventSink = Box<dyn Fn(TransitionEvent) + Send + Sync>;

struct Inner {
    node: String,
    state: Mutex<State>,
    /// The thread that takes a transition now.
    taking: Mutex<Option<ThreadId>>,
    /// Signalled when a transition is over.
    idle: Condvar,
    /// A callback of the running transition requested the end of the node.
    end_requested: AtomicBool,
    callbacks: Mutex<Vec<(Transition, Callback)>>,
    events: OnceLock<EventSink>,
    now: Box<dyn Fn() -> i64 + Send + Sync>,
}

/// The managed life of a node. Cheap to clone; clones share the state.
#[derive(Clone)]
pub struct Lifecycle(Arc<Inner>);

impl Lifecycle {
    pub(crate) fn new(node: String, now: Box<dyn Fn() -> i64 + Send + Sync>) -> Self {
        Self(Arc::new(Inner {
            node,
            state: Mutex::new(State::Unconfigured),
            taking: Mutex::new(None),
            idle: Condvar::new(),
            end_requested: AtomicBool::new(false),
            callbacks: Mutex::new(Vec::new()),
            events: OnceLock::new(),
            now,
        }))
    }

    pub(crate) fn set_event_sink(&self, sink: EventSink) {
        // Set once, where the node makes the lifecycle.
        let _ = self.0.events.set(sink);
    }

    /// The state the node rests in; during a transition, the one it comes from.
    #[must_use]
    pub fn state(&self) -> State {
        *lock(&self.0.state)
    }

    /// Runs `callback` when `transition` is taken, with the state it starts from. An `Err` with a sentence
    /// keeps the node where it was. Several callbacks of one transition run in the order they were given.
    pub fn on(
        &self,
        transition: Transition,
        callback: impl FnMut(State) -> Result<(), String> + Send + 'static,
    ) {
        lock(&self.0.callbacks).push((transition, Box::new(callback)));
    }

    /// Takes a transition and returns the state reached. A shutdown reaches Finalized even where a
    /// callback fails, and reports the failure.
    ///
    /// # Errors
    ///
    /// When the transition cannot be taken from here, another one is running, or a callback fails.
    pub fn take(&self, transition: Transition) -> Result<State, NodeError> {
        {
            let mut taking = lock(&self.0.taking);
            if taking.is_some() {
                return Err(self.refused(transition, "another transition is running".to_owned()));
            }
            *taking = Some(std::thread::current().id());
        }
        let _taking = Taking(self);
        self.take_alone(transition)
    }

    /// Takes the node to Finalized because it ends: after the transition that runs, if one does, which may be the one
    /// to Finalized. Does nothing where the node is there.
    ///
    /// Called from a callback of a transition, which cannot wait for itself, it lets that transition end in Finalized.
    ///
    /// # Errors
    ///
    /// When a callback of the shutdown fails, or a transition does not end within [`TRANSITION_WAIT`].
    pub(crate) fn end(&self) -> Result<(), NodeError> {
        let me = std::thread::current().id();
        {
            let taking = lock(&self.0.taking);
            if *taking == Some(me) {
                self.0.end_requested.store(true, Ordering::Release);
                return Ok(());
            }
            let busy = |taking: &mut Option<ThreadId>| taking.is_some();
            let (mut taking, timeout) = self
                .0
                .idle
                .wait_timeout_while(taking, TRANSITION_WAIT, busy)
                .unwrap_or_else(PoisonError::into_inner);
            if timeout.timed_out() {
                let reason = format!("another transition does not end within {TRANSITION_WAIT:?}");
                return Err(self.refused(Transition::Shutdown, reason));
            }
            *taking = Some(me);
        }
        let _taking = Taking(self);
        if self.state() == State::Finalized {
            Ok(())
        } else {
            self.take_alone(Transition::Shutdown).map(drop)
        }
    }

    /// A transition on the thread that has noted itself as the one that takes it.
    fn take_alone(&self, transition: Transition) -> Result<State, NodeError> {
        let from = self.state();
        let Some(goal) = transition.goal(from) else {
            return Err(self.refused(transition, format!("possible are: {}", possible(from))));
        };
        self.event(transition, from, from.to_msg(), transition.transient());
        let mut callbacks = std::mem::take(&mut *lock(&self.0.callbacks));
        let mut failure = None;
        for (_, callback) in callbacks.iter_mut().filter(|(on, _)| *on == transition) {
            let run = std::panic::AssertUnwindSafe(|| callback(from));
            let result =
                std::panic::catch_unwind(run).unwrap_or_else(|_| Err("its callback panicked".to_owned()));
            if let Err(reason) = result {
                failure = Some(reason);
                break;
            }
        }
        let end_requested = self.0.end_requested.load(Ordering::Acquire);
        if end_requested {
            // The node has ended meanwhile, and its callbacks may hold it: they are not put back.
            drop(callbacks);
            self.clear_callbacks();
        } else {
            // Callbacks that were added meanwhile come last.
            let mut current = lock(&self.0.callbacks);
            callbacks.append(&mut current);
            *current = callbacks;
        }
        let reached = if end_requested {
            State::Finalized
        } else if failure.is_none() || transition == Transition::Shutdown {
            goal
        } else {
            from
        };
        *lock(&self.0.state) = reached;
        self.event(transition, from, transition.transient(), reached.to_msg());
        match failure {
            Some(reason) => Err(NodeError::Transition {
                node: self.0.node.clone(),
                transition: transition.label().to_owned(),
                state: from.label(),
                reason,
            }),
            None => Ok(reached),
        }
    }

    fn refused(&self, transition: Transition, reason: String) -> NodeError {
        NodeError::Transition {
            node: self.0.node.clone(),
            transition: transition.label().to_owned(),
            state: self.state().label(),
            reason,
        }
    }

    fn event(&self, transition: Transition, from: State, start_state: StateMsg, goal_state: StateMsg) {
        if let Some(sink) = self.0.events.get() {
            sink(TransitionEvent {
                timestamp: u64::try_from((self.0.now)()).unwrap_or(0),
                transition: TransitionMsg { id: transition.id(from), label: transition.label().to_owned() },
                start_state,
                goal_state,
            });
        }
    }

    pub(crate) fn state_msg(&self) -> StateMsg {
        self.state().to_msg()
    }

    pub(crate) fn change(&self, request: &TransitionMsg) -> bool {
        let from = self.state();
        let Some(transition) = Transition::from_msg(request, from) else {
            tracing::warn!(
                node = %self.0.node,
                "there is no transition {} `{}` from state {from}: possible are {}",
                request.id,
                request.label,
                possible(from)
            );
            return false;
        };
        match self.take(transition) {
            Ok(_) => true,
            Err(error) => {
                tracing::warn!("{error}");
                false
            }
        }
    }

    pub(crate) fn clear_callbacks(&self) {
        lock(&self.0.callbacks).clear();
    }

    pub(crate) fn available_states() -> Vec<StateMsg> {
        let unknown = StateMsg { id: StateMsg::PRIMARY_STATE_UNKNOWN, label: "unknown".to_owned() };
        std::iter::once(unknown)
            .chain(State::ALL.into_iter().map(State::to_msg))
            .chain(Transition::ALL.into_iter().map(Transition::transient))
            .collect()
    }

    /// Those of the whole graph, or those that can be taken now.
    pub(crate) fn transitions(&self, all: bool) -> Vec<TransitionDescription> {
        let now = self.state();
        let mut list = Vec::new();
        for from in State::ALL.into_iter().filter(|from| all || *from == now) {
            for transition in Transition::ALL {
                if let Some(goal) = transition.goal(from) {
                    list.push(TransitionDescription {
                        transition: TransitionMsg {
                            id: transition.id(from),
                            label: transition.label().to_owned(),
                        },
                        start_state: from.to_msg(),
                        goal_state: goal.to_msg(),
                    });
                }
            }
        }
        list
    }
}

/// Notes that no transition runs any more.
struct Taking<'a>(&'a Lifecycle);

impl Drop for Taking<'_> {
    fn drop(&mut self) {
        *lock(&self.0.0.taking) = None;
        self.0.0.idle.notify_all();
    }
}

fn possible(from: State) -> String {
    let labels: Vec<_> =
        Transition::ALL.into_iter().filter(|t| t.goal(from).is_some()).map(Transition::label).collect();
    if labels.is_empty() { "none".to_owned() } else { labels.join(", ") }
}

#[cfg(test)]
mod tests;
