//! What is sent, and how often.
//!
//! Actions that go to one place are one output: several speed scales on one topic send the smallest that acts. An output says at
//! once that it acts, or acts otherwise, and repeats it, because one message can be lost. Between two calls of
//! [`Outputs::update`] nothing happens, so that the caller decides what time it is.

use std::time::Duration;

use crate::rules::{Action, ActionKind};

/// One message or call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Index of the action whose topic, service or action name it goes to.
    pub action: usize,
    /// What is sent.
    pub order: Order,
}

/// What is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// A `Bool` with this value.
    Bool(bool),
    /// An `Empty`.
    Empty,
    /// A twist of zeros.
    ZeroTwist,
    /// A `Float64`: the share of the speed.
    Scale(f64),
    /// A call of the service; [`Outputs::answered`] wants to know how it went.
    Call,
}

/// A call between request and answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Call {
    /// Nothing is under way.
    #[default]
    Idle,
    /// An answer is waited for.
    Waiting,
    /// An answer is waited for that came too early to count: the output stopped acting and acts anew.
    WaitingForOld,
}

/// Where commands go to.
struct Output {
    /// Indices of its actions; the first gives topic and times.
    members: Vec<usize>,
    /// What it says: the scale, or 0 where it is no scale; `None`: it does not act.
    level: Option<f64>,
    /// When it says so again.
    next: Option<Duration>,
    call: Call,
}

/// All outputs of a rule file.
pub struct Outputs {
    actions: Vec<Action>,
    outputs: Vec<Output>,
    started: bool,
    /// Whether every output says where it stands with the next update.
    announce: bool,
}

impl Outputs {
    /// Outputs of these actions, none of which acts.
    #[must_use]
    pub fn new(actions: Vec<Action>) -> Self {
        let mut outputs: Vec<Output> = Vec::with_capacity(actions.len());
        for (i, action) in actions.iter().enumerate() {
            let shared = |output: &&mut Output| actions[output.members[0]].kind.scales_with(&action.kind);
            match outputs.iter_mut().find(shared) {
                Some(output) => output.members.push(i),
                None => outputs.push(Output { members: vec![i], level: None, next: None, call: Call::Idle }),
            }
        }
        Self { actions, outputs, started: false, announce: false }
    }

    /// Takes which actions act now, one truth value each, and adds what is to be sent at `now`.
    pub fn update(&mut self, now: Duration, acting: &[bool], commands: &mut Vec<Command>) {
        let start = !std::mem::replace(&mut self.started, true);
        let announce = std::mem::take(&mut self.announce);
        for output in &mut self.outputs {
            let level = output.wanted(&self.actions, acting);
            let action = &self.actions[output.members[0]];
            let changed = level != output.level;
            let announced = announce || (start && action.heartbeat.is_some());
            let due = output.next.is_some_and(|next| next <= now);
            if changed && level.is_some() && output.level.is_none() && output.call == Call::Waiting {
                output.call = Call::WaitingForOld;
            }
            output.level = level;
            if changed || announced || due {
                output.send(action, now, commands);
            }
        }
    }

    /// Has every output say where it stands with the next update: somebody sent something else in between.
    pub fn announce(&mut self) {
        self.announce = true;
    }

    /// A call was answered, with success or not, or not in time.
    pub fn answered(&mut self, action: usize, success: bool, now: Duration) {
        let Some(output) = self.outputs.iter_mut().find(|output| output.members[0] == action) else { return };
        let action = &self.actions[action];
        let old = std::mem::take(&mut output.call) == Call::WaitingForOld;
        output.next = match output.level {
            None => None,
            Some(_) if old => Some(now),
            // What was cancelled can be started again by somebody who does not know; a trigger that was obeyed was obeyed.
            Some(_) if success && matches!(action.kind, ActionKind::Trigger { .. }) => None,
            Some(_) => Some(now + action.repeat),
        };
    }

    /// What every output that is no call sends when all of its actions act.
    #[must_use]
    pub fn stop_commands(&self) -> Vec<Command> {
        let mut commands = Vec::new();
        for output in &self.outputs {
            let smallest = output.wanted(&self.actions, &vec![true; self.actions.len()]);
            let action = &self.actions[output.members[0]];
            if !action.kind.is_call()
                && let Some(order) = order(&action.kind, smallest)
            {
                commands.push(Command { action: output.members[0], order });
            }
        }
        commands
    }

    /// When [`update`](Self::update) has to be called at the latest.
    #[must_use]
    pub fn next_wake(&self) -> Option<Duration> {
        self.outputs.iter().filter_map(|output| output.next).min()
    }
}

impl Output {
    /// The smallest scale of its actions that act.
    fn wanted(&self, actions: &[Action], acting: &[bool]) -> Option<f64> {
        let scale = |i: &usize| match actions[*i].kind {
            ActionKind::SpeedScale { scale, .. } => scale,
            _ => 0.0,
        };
        self.members.iter().filter(|i| acting[**i]).map(scale).reduce(f64::min)
    }

    fn send(&mut self, action: &Action, now: Duration, commands: &mut Vec<Command>) {
        let acts = self.level.is_some();
        if action.kind.is_call() {
            self.next = None;
            if acts && self.call == Call::Idle {
                self.call = Call::Waiting;
                commands.push(Command { action: self.members[0], order: Order::Call });
            }
            return;
        }
        if let Some(order) = order(&action.kind, self.level) {
            commands.push(Command { action: self.members[0], order });
        }
        self.next =
            if acts { Some(now + action.repeat) } else { action.heartbeat.map(|period| now + period) };
    }
}

/// The message for a level; `None` where there is none to send.
fn order(kind: &ActionKind, level: Option<f64>) -> Option<Order> {
    match (kind, level) {
        (ActionKind::Bool { value, .. }, level) => Some(Order::Bool(*value == level.is_some())),
        (ActionKind::SpeedScale { .. }, level) => Some(Order::Scale(level.unwrap_or(1.0))),
        (ActionKind::Empty { .. }, Some(_)) => Some(Order::Empty),
        (ActionKind::Twist { .. }, Some(_)) => Some(Order::ZeroTwist),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn outputs(kinds: Vec<ActionKind>, heartbeat: Option<Duration>) -> Outputs {
        let action = |kind| Action { name: "a".into(), kind, repeat: 10 * MS, heartbeat };
        Outputs::new(kinds.into_iter().map(action).collect())
    }

    fn orders(outputs: &mut Outputs, ms: u32, acting: &[bool]) -> Vec<Order> {
        let mut commands = Vec::new();
        outputs.update(ms * MS, acting, &mut commands);
        commands.into_iter().map(|command| command.order).collect()
    }

    fn bool_() -> ActionKind {
        ActionKind::Bool { topic: "stop".into(), value: true }
    }

    fn scale(scale: f64) -> ActionKind {
        ActionKind::SpeedScale { topic: "scale".into(), scale }
    }

    #[test]
    fn a_stop_is_repeated_and_its_end_is_said_once() {
        let mut outputs = outputs(vec![bool_()], None);
        assert_eq!(orders(&mut outputs, 0, &[false]), []);
        assert_eq!(outputs.next_wake(), None);
        assert_eq!(orders(&mut outputs, 1, &[true]), [Order::Bool(true)]);
        assert_eq!(outputs.next_wake(), Some(11 * MS));
        assert_eq!(orders(&mut outputs, 5, &[true]), []);
        assert_eq!(orders(&mut outputs, 11, &[true]), [Order::Bool(true)]);
        assert_eq!(orders(&mut outputs, 50, &[true]), [Order::Bool(true)], "a late call sends once");
        assert_eq!(outputs.next_wake(), Some(60 * MS));
        assert_eq!(orders(&mut outputs, 55, &[false]), [Order::Bool(false)]);
        assert_eq!(outputs.next_wake(), None);
    }

    #[test]
    fn a_heartbeat_says_that_somebody_guards() {
        let mut outputs = outputs(vec![bool_()], Some(20 * MS));
        assert_eq!(orders(&mut outputs, 0, &[false]), [Order::Bool(false)]);
        assert_eq!(orders(&mut outputs, 19, &[false]), []);
        assert_eq!(orders(&mut outputs, 20, &[false]), [Order::Bool(false)]);
        assert_eq!(orders(&mut outputs, 21, &[true]), [Order::Bool(true)]);
        assert_eq!(outputs.next_wake(), Some(31 * MS), "a stop is repeated at its own rate");
    }

    #[test]
    fn an_inverted_stop_says_false_while_it_acts() {
        let mut outputs =
            outputs(vec![ActionKind::Bool { topic: "enabled".into(), value: false }], Some(20 * MS));
        assert_eq!(orders(&mut outputs, 0, &[false]), [Order::Bool(true)]);
        assert_eq!(orders(&mut outputs, 1, &[true]), [Order::Bool(false)]);
    }

    #[test]
    fn the_smallest_scale_of_a_topic_counts() {
        let mut outputs = outputs(vec![scale(0.5), scale(0.2)], None);
        assert_eq!(orders(&mut outputs, 0, &[true, false]), [Order::Scale(0.5)]);
        assert_eq!(orders(&mut outputs, 1, &[true, true]), [Order::Scale(0.2)]);
        assert_eq!(orders(&mut outputs, 2, &[true, false]), [Order::Scale(0.5)]);
        assert_eq!(orders(&mut outputs, 3, &[false, false]), [Order::Scale(1.0)]);
        let commands = outputs.stop_commands();
        assert_eq!(commands, [Command { action: 0, order: Order::Scale(0.2) }]);
    }

    #[test]
    fn what_was_said_in_between_is_set_right() {
        let mut outputs = outputs(vec![bool_(), scale(0.2)], None);
        assert_eq!(orders(&mut outputs, 0, &[false, true]), [Order::Scale(0.2)]);
        outputs.announce();
        assert_eq!(orders(&mut outputs, 1, &[false, true]), [Order::Bool(false), Order::Scale(0.2)]);
        assert_eq!(orders(&mut outputs, 2, &[false, true]), []);
    }

    #[test]
    fn twists_and_empties_are_sent_only_while_they_act() {
        let kinds = vec![
            ActionKind::Empty { topic: "e".into() },
            ActionKind::Twist { topic: "cmd_vel".into(), stamped: None },
        ];
        let mut outputs = outputs(kinds, None);
        assert_eq!(orders(&mut outputs, 0, &[true, true]), [Order::Empty, Order::ZeroTwist]);
        assert_eq!(orders(&mut outputs, 1, &[false, false]), []);
        assert_eq!(outputs.next_wake(), None);
    }

    #[test]
    fn a_trigger_is_called_until_it_is_obeyed() {
        let mut outputs = outputs(vec![ActionKind::Trigger { service: "stop".into() }], None);
        assert_eq!(orders(&mut outputs, 0, &[true]), [Order::Call]);
        assert_eq!(orders(&mut outputs, 100, &[true]), [], "one call at a time");
        outputs.answered(0, false, 200 * MS);
        assert_eq!(outputs.next_wake(), Some(210 * MS));
        assert_eq!(orders(&mut outputs, 210, &[true]), [Order::Call]);
        outputs.answered(0, true, 220 * MS);
        assert_eq!((orders(&mut outputs, 900, &[true]), outputs.next_wake()), (vec![], None));
        assert_eq!(orders(&mut outputs, 901, &[false]), []);
        assert_eq!(orders(&mut outputs, 902, &[true]), [Order::Call]);
    }

    #[test]
    fn the_answer_to_an_older_stop_does_not_count() {
        let mut outputs = outputs(vec![ActionKind::Trigger { service: "stop".into() }], None);
        assert_eq!(orders(&mut outputs, 0, &[true]), [Order::Call]);
        assert_eq!(orders(&mut outputs, 1, &[false]), []);
        assert_eq!(orders(&mut outputs, 2, &[true]), []);
        outputs.answered(0, true, 3 * MS);
        assert_eq!(orders(&mut outputs, 3, &[true]), [Order::Call]);
        outputs.answered(0, true, 4 * MS);
        assert_eq!(outputs.next_wake(), None);
        assert!(outputs.stop_commands().is_empty(), "nobody waits for a call at the end");
    }

    #[test]
    fn goals_are_cancelled_as_long_as_it_acts() {
        let mut outputs = outputs(vec![ActionKind::Cancel { action: "move".into() }], None);
        assert_eq!(orders(&mut outputs, 0, &[true]), [Order::Call]);
        outputs.answered(0, true, MS);
        assert_eq!(orders(&mut outputs, 11, &[true]), [Order::Call]);
        assert_eq!(orders(&mut outputs, 12, &[false]), []);
        outputs.answered(0, true, 13 * MS);
        assert_eq!(outputs.next_wake(), None);
    }
}
