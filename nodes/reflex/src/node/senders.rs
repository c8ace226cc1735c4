//! What commands are sent with: publishers that never wait, and calls on threads of their own.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use dermis_msgs::action_msgs::srv::{CancelGoal, CancelGoalRequest, CancelGoalResponse};
use dermis_msgs::geometry_msgs::msg::{Twist, TwistStamped};
use dermis_msgs::std_msgs::msg::{Bool, Empty, Float64, Header};
use dermis_msgs::std_srvs::srv::{Trigger, TriggerRequest};
use dermis_node::{Client, Node, NodeError, Publisher};

use crate::outputs::{Command, Order};
use crate::rules::{Action, ActionKind};

/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them. A stop that is older than the
/// next repeat is of no use.
const KEPT: usize = 2;
/// Longest wait for the answer to a call.
const PATIENCE: Duration = Duration::from_secs(1);

/// A client of an action's service.
#[derive(Clone)]
pub(super) enum Caller {
    Trigger(Client<Trigger>),
    Cancel(Client<CancelGoal>),
}

enum Sender {
    Bool(Publisher<Bool>),
    Empty(Publisher<Empty>),
    Twist(Publisher<Twist>),
    TwistStamped(Publisher<TwistStamped>, String),
    Scale(Publisher<Float64>),
    Call(Caller, Mutex<Option<SyncSender<()>>>),
    /// Another action sends for it, on the same topic.
    Shared,
}

/// One for each action.
pub(super) struct Senders(Vec<Sender>);

impl Senders {
    pub(super) fn new(node: &Node, actions: &[Action]) -> Result<Self, NodeError> {
        let mut senders = Vec::with_capacity(actions.len());
        for (i, action) in actions.iter().enumerate() {
            let call = |caller| Sender::Call(caller, Mutex::new(None));
            senders.push(match &action.kind {
                ActionKind::Bool { topic, .. } => Sender::Bool(node.stream_publisher(topic, KEPT)?),
                ActionKind::Empty { topic } => Sender::Empty(node.stream_publisher(topic, KEPT)?),
                ActionKind::Twist { topic, stamped: None } => {
                    Sender::Twist(node.stream_publisher(topic, KEPT)?)
                }
                ActionKind::Twist { topic, stamped: Some(frame) } => {
                    Sender::TwistStamped(node.stream_publisher(topic, KEPT)?, frame.clone())
                }
                ActionKind::SpeedScale { topic, .. } => {
                    let before = actions[..i].iter().any(|other| other.kind.scales_with(&action.kind));
                    if before { Sender::Shared } else { Sender::Scale(node.stream_publisher(topic, KEPT)?) }
                }
                ActionKind::Trigger { service } => call(Caller::Trigger(node.client(service)?)),
                ActionKind::Cancel { action } => {
                    call(Caller::Cancel(node.client(&format!("{action}/_action/cancel_goal"))?))
                }
            });
        }
        Ok(Self(senders))
    }

    /// Sends one command; `stamp` \[ns\] is that of messages that have one.
    pub(super) fn send(&self, command: Command, stamp: i64) {
        let done = match (&self.0[command.action], command.order) {
            (Sender::Bool(publisher), Order::Bool(data)) => publisher.publish(&Bool { data }),
            (Sender::Empty(publisher), Order::Empty) => publisher.publish(&Empty::default()),
            (Sender::Twist(publisher), Order::ZeroTwist) => publisher.publish(&Twist::default()),
            (Sender::TwistStamped(publisher, frame), Order::ZeroTwist) => {
                let header = Header::new(stamp, frame.as_str());
                publisher.publish(&TwistStamped { header, ..TwistStamped::default() })
            }
            (Sender::Scale(publisher), Order::Scale(data)) => publisher.publish(&Float64 { data }),
            (Sender::Call(_, requests), Order::Call) => {
                // One call is under way at a time: there is room for one.
                let requests = requests.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some(requests) = &*requests {
                    let _ = requests.try_send(());
                }
                Ok(())
            }
            (_, order) => {
                tracing::error!("an action cannot send {order:?}");
                Ok(())
            }
        };
        if let Err(error) = done {
            tracing::warn!("a stop was not sent: {error}");
        }
    }

    /// The client of an action that calls.
    pub(super) fn client(&self, action: usize) -> Option<Caller> {
        match &self.0[action] {
            Sender::Call(caller, _) => Some(caller.clone()),
            _ => None,
        }
    }

    /// Where calls of an action are requested.
    pub(super) fn set_caller(&self, action: usize, to: SyncSender<()>) {
        if let Sender::Call(_, requests) = &self.0[action] {
            *requests.lock().unwrap_or_else(PoisonError::into_inner) = Some(to);
        }
    }

    /// Ends the threads that call.
    pub(super) fn end(&self) {
        for sender in &self.0 {
            if let Sender::Call(_, requests) = sender {
                requests.lock().unwrap_or_else(PoisonError::into_inner).take();
            }
        }
    }
}

/// A thread that calls on request and reports the result; it ends when nobody can ask it any more, or `answered` says so.
pub(super) fn start_caller(
    caller: Caller,
    action: &Action,
    answered: impl Fn(bool) -> bool + Send + 'static,
) -> std::io::Result<SyncSender<()>> {
    let (to, requests): (_, Receiver<()>) = sync_channel(1);
    let name = action.name.clone();
    std::thread::Builder::new().name("dermis-reflex-call".to_owned()).spawn(move || {
        for () in requests {
            let success = match caller.call() {
                Ok(()) => true,
                Err(sentence) => {
                    tracing::warn!("action `{name}`: {sentence}");
                    false
                }
            };
            if !answered(success) {
                return;
            }
        }
    })?;
    Ok(to)
}

impl Caller {
    /// Calls, and says why it had no success.
    fn call(&self) -> Result<(), String> {
        match self {
            Self::Trigger(client) => {
                let answer = client.call_blocking(&TriggerRequest::default(), PATIENCE);
                let answer = answer.map_err(|error| error.to_string())?;
                if answer.success {
                    Ok(())
                } else {
                    Err(format!("{} refused: {}", client.name(), answer.message))
                }
            }
            Self::Cancel(client) => {
                // A goal of no id and no time: all of them.
                let answer = client.call_blocking(&CancelGoalRequest::default(), PATIENCE);
                let answer = answer.map_err(|error| error.to_string())?;
                match answer.return_code {
                    // Where no goal runs, some servers reject.
                    CancelGoalResponse::ERROR_NONE | CancelGoalResponse::ERROR_REJECTED => Ok(()),
                    code => Err(format!("{} answered with the code {code}", client.name())),
                }
            }
        }
    }
}
