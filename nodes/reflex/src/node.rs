//! The reflex node: contacts at one end, stop messages at the other, and the state machine of [`Reflex`] between them.
//!
//! | file | what it does |
//! |---|---|
//! | `guard` | what the threads share: a message or the passing of time goes in, messages go out |
//! | `senders` | publishers, and calls on threads of their own |
//! | `diagnostics` | the status on `/diagnostics` |
//!
//! A stop message is sent by the thread that took the message which asks for it, before that thread logs or counts anything. A
//! second thread sleeps until the state machine has to be called without a message (a timeout, a repeat) and polls nothing. One
//! lock orders the two: what is decided first is sent first. Publishers never wait for a peer.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

use dermis_msgs::Message;
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::msg::{BodyContacts, ContactArray};
use dermis_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use dermis_node::{Backend, MessageInfo, Node, NodeError, Qos, ServiceServer, Status, Subscription};

use crate::config::{Config, RunError};
use crate::machine::{Done, Reflex};
use crate::rules::{Input, InputKind, Rules};
use guard::Guard;
use senders::Senders;

mod diagnostics;
mod guard;
mod senders;

/// Messages of one input that wait while the machine is busy elsewhere: a touch that was short is not to be dropped for newer
/// messages.
const WAITING: usize = 64;

/// A running node; dropping it stops it.
///
/// It subscribes to the inputs of its rule file and offers the service `~/release` (`std_srvs/srv/Trigger`), which
/// releases every latched rule, or none and says why. While it is not active it guards nothing; the change is announced by the
/// same messages as its end ([`AtEnd`](crate::rules::AtEnd)).
pub struct ReflexNode {
    node: Node,
    guard: Arc<Guard>,
    timekeeper: Option<JoinHandle<()>>,
    _subscriptions: Vec<Subscription>,
    _release: ServiceServer,
}

impl ReflexNode {
    /// Starts a node.
    ///
    /// # Errors
    ///
    /// [`RunError`] says in one sentence what is wrong: file, line and field, or what ROS refused.
    pub fn start(config: &Config, backend: &dyn Backend) -> Result<Self, RunError> {
        let rules = Rules::load(&config.rules)?;
        let node = Node::open(config.options(&rules)?, backend)?;
        let senders = Senders::new(&node, &rules.actions)?;
        let guard = Arc::new(Guard::new(node.clone(), Reflex::new(rules.clone(), Duration::ZERO), senders));
        guard.start_callers(&rules.actions).map_err(RunError::Thread)?;
        let subscriptions = rules
            .inputs
            .iter()
            .enumerate()
            .map(|(i, input)| subscribe(&node, &guard, i, input))
            .collect::<Result<Vec<_>, _>>()?;
        let release = serve_release(&node, &guard)?;
        let watched = Arc::downgrade(&guard);
        node.diagnostics().set_hardware_id(&rules.name);
        node.diagnostics().add("reflex", move || {
            watched.upgrade().map_or_else(|| Status::ok("stopped"), |guard| guard.diagnose())
        });
        let keeper = Arc::clone(&guard);
        let timekeeper = std::thread::Builder::new()
            .name("dermis-reflex-time".to_owned())
            .spawn(move || keeper.keep_time_always())
            .map_err(RunError::Thread)?;
        let running = Self {
            node,
            guard,
            timekeeper: Some(timekeeper),
            _subscriptions: subscriptions,
            _release: release,
        };
        let guard = Arc::downgrade(&running.guard);
        running.node.work_while_active(config.autostart, move |active| {
            if let Some(guard) = guard.upgrade() {
                guard.activate(active);
            }
        })?;
        Ok(running)
    }

    /// The ROS node: names, lifecycle, clock.
    #[must_use]
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// Its own diagnostics, now.
    #[must_use]
    pub fn diagnosis(&self) -> Status {
        self.guard.diagnose()
    }

    /// Stops guarding and leaves the ROS graph.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.guard.activate(false);
        self.guard.end();
        if let Some(thread) = self.timekeeper.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that keeps the reflexes' time ended by a panic");
        }
        self.node.shutdown();
    }
}

impl Drop for ReflexNode {
    fn drop(&mut self) {
        self.end();
    }
}

fn subscribe(
    node: &Node,
    guard: &Arc<Guard>,
    index: usize,
    input: &Input,
) -> Result<Subscription, NodeError> {
    match input.kind {
        InputKind::Body => {
            listen(node, guard, &input.topic, move |reflex, message: &BodyContacts, now, age| {
                reflex.body(index, message, now, age)
            })
        }
        InputKind::Skin { .. } => {
            listen(node, guard, &input.topic, move |reflex, message: &ContactArray, now, age| {
                reflex.skin(index, message, now, age)
            })
        }
    }
}

/// A message with the time that it was acquired at.
trait Stamped: Message {
    fn stamp(&self) -> &Time;
}

impl Stamped for BodyContacts {
    fn stamp(&self) -> &Time {
        &self.header.stamp
    }
}

impl Stamped for ContactArray {
    fn stamp(&self) -> &Time {
        &self.header.stamp
    }
}

fn listen<T: Stamped>(
    node: &Node,
    guard: &Arc<Guard>,
    topic: &str,
    take: impl Fn(&mut Reflex, &T, Duration, i64) -> Done + Send + 'static,
) -> Result<Subscription, NodeError> {
    let guard = Arc::clone(guard);
    node.subscribe::<T>(topic, Qos::sensor_data().with_depth(WAITING), move |message, info: MessageInfo| {
        let stamp = message.stamp().as_nanos();
        guard.hear(info.received_ns, |reflex, now, clock_ns| {
            take(reflex, &message, now, clock_ns.saturating_sub(stamp))
        });
    })
}

fn serve_release(node: &Node, guard: &Arc<Guard>) -> Result<ServiceServer, NodeError> {
    let guard = Arc::clone(guard);
    node.serve::<Trigger>("~/release", move |_| match guard.release() {
        Ok(message) => TriggerResponse { success: true, message },
        Err(message) => TriggerResponse { success: false, message },
    })
}

/// Runs a node until it is stopped by a signal or through its lifecycle.
///
/// # Errors
///
/// [`RunError`] says in one sentence why it does not start.
pub async fn run(config: &Config, backend: &dyn Backend) -> Result<(), RunError> {
    // Before the first heartbeat: a signal in between would end the process without the stop that is its last word.
    dermis_node::end_all_nodes_on_signal()?;
    let running = ReflexNode::start(config, backend)?;
    running.node().wait_for_shutdown().await?;
    running.stop();
    Ok(())
}

impl Guard {
    /// Whether it guards.
    fn is_active(&self) -> bool {
        self.active.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests;
