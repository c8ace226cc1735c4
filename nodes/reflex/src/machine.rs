//! When a rule acts, and when it is released.
//!
//! Every rule is a small state machine:
//!
//! | state | leaves it |
//! |---|---|
//! | idle | a condition acts: to *pending*, or to *acting* where `hold` is 0 |
//! | pending | no condition holds: to *idle*; `hold` is over: to *acting* |
//! | acting | not latched, and no condition has held for `quiet`: to *idle* |
//! | acting, latched | only by [`Reflex::release`], which refuses as long as a condition holds or `quiet` is not over |
//!
//! A condition *acts* above its threshold and *holds* above its release threshold. An input that is silent for its timeout is a
//! condition like any other, where the rule counts it.
//!
//! A limit that depends on how long a contact lasts uses one clock for the rule's region: it starts with the first contact and
//! starts anew after the region was free for `quiet`. So a contact whose id changes, or a second contact, never restarts it; the
//! quasi-static limit counts no later than for each contact alone.
//!
//! Time is an argument: any clock that does not run backwards. [`Reflex::next_wake`] says when [`Reflex::tick`] has to be
//! called where no message comes. The cost of a message is that of assessing it for each rule that listens.

use std::fmt;
use std::time::Duration;

use dermis_msgs::msg::{BodyContacts, ContactArray};

use crate::assess::{self, Assessment};
use crate::outputs::{Command, Outputs};
use crate::rules::{AtEnd, Loss, Rule, Rules, Start};
use crate::slide::Slides;

/// What a call of the state machine leads to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Done {
    /// To be sent now, in this order.
    pub commands: Vec<Command>,
    /// What changed, for people.
    pub events: Vec<Event>,
}

/// A change of a rule.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// It acts.
    Acts {
        /// Name of the rule.
        rule: String,
        /// Why, as part of a sentence.
        reason: String,
    },
    /// It no longer acts: it does not latch.
    Ends {
        /// Name of the rule.
        rule: String,
    },
    /// Somebody released it.
    Released {
        /// Name of the rule.
        rule: String,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Acts { rule, reason } => write!(f, "rule `{rule}` acts: {reason}"),
            Self::Ends { rule } => write!(f, "rule `{rule}` no longer acts"),
            Self::Released { rule } => write!(f, "rule `{rule}` is released"),
        }
    }
}

/// Why nothing was released.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("rule `{rule}` is not released: {reason}")]
pub struct ReleaseRefused {
    /// Name of the rule.
    pub rule: String,
    /// Why, as part of a sentence.
    pub reason: String,
}

/// What a rule does now, for diagnostics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RuleState<'a> {
    /// Name of the rule.
    pub rule: &'a str,
    /// Why it acts; `None` where it does not.
    pub acts: Option<&'a str>,
    /// Whether it acts until it is released.
    pub latched: bool,
    /// Why it could not be released now; `None` where it could.
    pub holds: Option<&'a str>,
}

/// What tells a message of an input from another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Label {
    /// \[ns\]
    stamp: i64,
    sequence: u64,
}

/// What is known of an input.
#[derive(Default)]
struct InputState {
    /// When the latest new message arrived.
    heard: Option<Duration>,
    /// What that message is called.
    latest: Option<Label>,
    /// Why what came last does not count as heard.
    refused: Option<String>,
    slides: Slides,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Phase {
    Idle,
    Pending { since: Duration, latches: bool },
    Acting { latched: bool, reason: String, quiet_since: Option<Duration> },
}

/// One rule's memory.
struct RuleMemory {
    phase: Phase,
    /// What the latest message of each of its inputs means.
    latest: Vec<Assessment>,
    /// Since when its region is touched, with breaks shorter than `quiet`.
    touched_since: Option<Duration>,
    free_since: Option<Duration>,
    /// Whether a loss of sense latches it: not before all its senses were there once, where rules start clear.
    armed: bool,
    /// Why a condition holds.
    holds: Option<String>,
}

/// What a rule's conditions say at one instant.
#[derive(Default)]
struct Verdict {
    touch: Option<String>,
    loss: Option<String>,
    holds: bool,
}

/// The state machine of all rules.
pub struct Reflex {
    rules: Rules,
    inputs: Vec<InputState>,
    memory: Vec<RuleMemory>,
    outputs: Outputs,
    acting: Vec<bool>,
    now: Duration,
}

impl Reflex {
    /// Starts at `now`. What acts from the start is sent by the first call of any other function.
    #[must_use]
    pub fn new(rules: Rules, now: Duration) -> Self {
        let memory = |rule: &Rule| {
            let stopped = rules.start == Start::Stopped;
            let phase = if stopped && rule.latch {
                let reason = "the reflex has started, and nobody has released it yet".to_owned();
                Phase::Acting { latched: true, reason, quiet_since: None }
            } else {
                Phase::Idle
            };
            RuleMemory {
                phase,
                latest: vec![Assessment::default(); rule.inputs.len()],
                touched_since: None,
                free_since: None,
                armed: stopped,
                holds: None,
            }
        };
        Self {
            inputs: rules.inputs.iter().map(|_| InputState::default()).collect(),
            memory: rules.rules.iter().map(memory).collect(),
            outputs: Outputs::new(rules.actions.clone()),
            acting: vec![false; rules.actions.len()],
            rules,
            now,
        }
    }

    /// What it goes by.
    #[must_use]
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// A message of one skin came on an input at `now`, `age` \[ns\] after its stamp.
    pub fn skin(&mut self, input: usize, message: &ContactArray, now: Duration, age: i64) -> Done {
        // A node that is blind says so again and again, with the number of the last frame that it read.
        let numbered = ContactArray::feels(message.status);
        let label = Label { stamp: message.header.stamp.as_nanos(), sequence: message.sequence };
        let now = self.hear(input, now, age, label, numbered);
        if let Some(state) = self.inputs.get_mut(input) {
            state.slides.take(message);
        }
        let speeds = self.inputs.get(input).map_or(&[][..], |state| state.slides.speeds.as_slice());
        for (rule, memory) in self.rules.rules.iter().zip(&mut self.memory) {
            if let Some(slot) = rule.inputs.iter().position(|i| *i == input) {
                memory.latest[slot] = assess::skin(&self.rules, rule, input, message, speeds);
            }
        }
        self.step(now)
    }

    /// A message of the fusion came on an input at `now`, `age` \[ns\] after its stamp.
    pub fn body(&mut self, input: usize, message: &BodyContacts, now: Duration, age: i64) -> Done {
        let label = Label { stamp: message.header.stamp.as_nanos(), sequence: message.sequence };
        let now = self.hear(input, now, age, label, true);
        for (rule, memory) in self.rules.rules.iter().zip(&mut self.memory) {
            if let Some(slot) = rule.inputs.iter().position(|i| *i == input) {
                memory.latest[slot] = assess::body(&self.rules, rule, message);
            }
        }
        self.step(now)
    }

    /// Time passed.
    pub fn tick(&mut self, now: Duration) -> Done {
        let now = self.forward(now);
        self.step(now)
    }

    /// Goes on after [`last_words`](Self::last_words) were sent: every output says where it stands.
    pub fn resume(&mut self, now: Duration) -> Done {
        self.outputs.announce();
        self.tick(now)
    }

    /// A call of an action was answered, with success or not, or not in time.
    pub fn answered(&mut self, action: usize, success: bool, now: Duration) -> Done {
        let now = self.forward(now);
        self.outputs.answered(action, success, now);
        self.step(now)
    }

    /// Releases every rule that is latched: all of them, or none.
    ///
    /// # Errors
    ///
    /// Where a condition of a latched rule holds, or has not been quiet for long enough.
    pub fn release(&mut self, now: Duration) -> Result<Done, ReleaseRefused> {
        let now = self.forward(now);
        let mut done = self.step(now);
        let refused = self.rules.rules.iter().zip(&self.memory).find_map(|(rule, memory)| {
            let reason = memory.refuses_release(rule, now)?;
            Some(ReleaseRefused { rule: rule.name.clone(), reason })
        });
        if let Some(refused) = refused {
            return Err(refused);
        }
        for (rule, memory) in self.rules.rules.iter().zip(&mut self.memory) {
            if matches!(memory.phase, Phase::Acting { latched: true, .. }) {
                memory.phase = Phase::Idle;
                memory.armed = true;
                done.events.push(Event::Released { rule: rule.name.clone() });
            }
        }
        let after = self.step(now);
        done.commands.extend(after.commands);
        done.events.extend(after.events);
        Ok(done)
    }

    /// What is sent when the node ends.
    #[must_use]
    pub fn last_words(&self) -> Vec<Command> {
        if self.rules.at_end == AtEnd::Act { self.stop_commands() } else { Vec::new() }
    }

    /// What every action that publishes sends when it acts.
    #[must_use]
    pub fn stop_commands(&self) -> Vec<Command> {
        self.outputs.stop_commands()
    }

    /// When [`tick`](Self::tick) has to be called at the latest; `None`: not before something else happens.
    #[must_use]
    pub fn next_wake(&self) -> Option<Duration> {
        let late = self
            .inputs
            .iter()
            .zip(&self.rules.inputs)
            .filter_map(|(state, input)| Some(state.heard? + input.timeout).filter(|at| *at > self.now));
        let rules = self
            .rules
            .rules
            .iter()
            .zip(&self.memory)
            .filter_map(|(rule, memory)| memory.next_wake(rule, self.now));
        late.chain(rules).chain(self.outputs.next_wake()).min()
    }

    /// Rules and what they do.
    pub fn states(&self) -> impl Iterator<Item = RuleState<'_>> {
        self.rules.rules.iter().zip(&self.memory).map(|(rule, memory)| {
            let (acts, latched) = match &memory.phase {
                Phase::Acting { reason, latched, .. } => (Some(reason.as_str()), *latched),
                _ => (None, false),
            };
            RuleState { rule: &rule.name, acts, latched, holds: memory.holds.as_deref() }
        })
    }

    /// Time since each input was heard; `None` where nothing has come.
    pub fn silences(&self, now: Duration) -> impl Iterator<Item = (&str, Option<Duration>)> {
        let since = move |heard: Duration| now.saturating_sub(heard);
        self.rules
            .inputs
            .iter()
            .zip(&self.inputs)
            .map(move |(input, state)| (input.name.as_str(), state.heard.map(since)))
    }

    /// Time never runs backwards here, whatever the caller says.
    fn forward(&mut self, now: Duration) -> Duration {
        self.now = self.now.max(now);
        self.now
    }

    /// Notes that a message came; one that is `numbered` is news only with a number of its own, whatever its stamp: a node that has
    /// stopped reading may go on stamping.
    fn hear(&mut self, input: usize, now: Duration, age: i64, label: Label, numbered: bool) -> Duration {
        let now = self.forward(now);
        let (Some(state), Some(rules)) = (self.inputs.get_mut(input), self.rules.inputs.get(input)) else {
            return now;
        };
        let repeated =
            state.latest.is_some_and(|last| last == label || (numbered && last.sequence == label.sequence));
        let largest = rules.max_age.map(|age| i64::try_from(age.as_nanos()).unwrap_or(i64::MAX));
        // A stamp from the future is as wrong as an old one.
        let old = largest.is_some_and(|largest| age > largest || age < -largest);
        if repeated {
            state.refused = Some("its messages repeat themselves".to_owned());
        } else if old {
            let ms = age as f64 * 1e-6;
            state.refused = Some(format!("its messages arrive {ms:.1} ms after their stamps"));
        } else {
            state.heard = Some(now);
            state.refused = None;
        }
        state.latest = Some(label);
        now
    }

    fn step(&mut self, now: Duration) -> Done {
        let mut done = Done::default();
        self.acting.fill(false);
        for (rule, memory) in self.rules.rules.iter().zip(&mut self.memory) {
            let verdict = memory.verdict(rule, &self.rules, &self.inputs, now);
            memory.advance(rule, verdict, now, &mut done.events);
            if matches!(memory.phase, Phase::Acting { .. }) {
                for action in &rule.actions {
                    self.acting[*action] = true;
                }
            }
        }
        self.outputs.update(now, &self.acting, &mut done.commands);
        done
    }
}

/// Why an input counts as silent at `now`; `None` where it does not.
fn silence(rules: &Rules, states: &[InputState], input: usize, now: Duration) -> Option<(Loss, String)> {
    let (state, rules) = (&states[input], &rules.inputs[input]);
    let name = &rules.name;
    let refused = |text: String| match &state.refused {
        Some(why) => format!("{text}: {why}"),
        None => text,
    };
    match state.heard {
        None => Some((Loss::Missing, refused(format!("nothing has come from input `{name}`")))),
        Some(heard) if now.saturating_sub(heard) >= rules.timeout => {
            let timeout = rules.timeout.as_secs_f64();
            Some((Loss::Late, refused(format!("input `{name}` brought nothing new for {timeout} s"))))
        }
        Some(_) => None,
    }
}

impl RuleMemory {
    fn verdict(&mut self, rule: &Rule, rules: &Rules, inputs: &[InputState], now: Duration) -> Verdict {
        let mut verdict = Verdict::default();
        let mut touched = false;
        let mut lasting = None;
        let mut all_heard = true;
        for (slot, input) in rule.inputs.iter().enumerate() {
            let silent = silence(rules, inputs, *input, now);
            all_heard &= silent.is_none();
            if let Some((_, text)) = silent.filter(|(loss, _)| rule.counts(*loss)) {
                verdict.holds = true;
                verdict.loss.get_or_insert(text);
            }
            // What was detected last counts on, also where nothing more comes.
            let latest = &self.latest[slot];
            touched |= latest.touched;
            verdict.holds |= latest.holds;
            verdict.touch = verdict.touch.or_else(|| latest.touch.clone());
            verdict.loss = verdict.loss.or_else(|| latest.loss.clone());
            lasting = lasting.or_else(|| latest.lasting.clone());
        }
        self.clock(rule, touched, now);
        if let (Some(text), Some(limits), Some(since)) = (lasting, &rule.limits, self.touched_since)
            && now.saturating_sub(since) >= limits.time_to_quasi_static
        {
            verdict.touch.get_or_insert(text);
        }
        self.armed |= all_heard && verdict.loss.is_none();
        verdict
    }

    /// The clock of how long the region is touched.
    fn clock(&mut self, rule: &Rule, touched: bool, now: Duration) {
        if self.free_since.is_some_and(|since| now.saturating_sub(since) >= rule.quiet) {
            self.touched_since = None;
        }
        if touched {
            self.touched_since.get_or_insert(now);
            self.free_since = None;
        } else {
            self.free_since.get_or_insert(now);
        }
    }

    fn advance(&mut self, rule: &Rule, verdict: Verdict, now: Duration, events: &mut Vec<Event>) {
        let Verdict { touch, loss, holds } = verdict;
        // A lost sense does not latch before it was there; a touch always does.
        let latches = rule.latch && (self.armed || touch.is_some());
        let acts = touch.or(loss);
        let holds = holds || acts.is_some();
        if let Phase::Acting { latched, reason, quiet_since } = &mut self.phase {
            if let Some(why) = acts.as_ref().filter(|_| latches && !*latched) {
                (*latched, *reason) = (true, why.clone());
                events.push(Event::Acts { rule: rule.name.clone(), reason: why.clone() });
            }
            if holds {
                *quiet_since = None;
            } else {
                let since = *quiet_since.get_or_insert(now);
                if !*latched && now.saturating_sub(since) >= rule.quiet {
                    self.phase = Phase::Idle;
                    events.push(Event::Ends { rule: rule.name.clone() });
                }
            }
        } else {
            let pending = match self.phase {
                Phase::Pending { since, latches: before } if holds => Some((since, before || latches)),
                _ => acts.is_some().then_some((now, latches)),
            };
            self.phase = match pending {
                None => Phase::Idle,
                Some((since, latched)) if now.saturating_sub(since) >= rule.hold => {
                    let reason = acts.clone().or_else(|| self.holds.clone()).unwrap_or_default();
                    events.push(Event::Acts { rule: rule.name.clone(), reason: reason.clone() });
                    Phase::Acting { latched, reason, quiet_since: None }
                }
                Some((since, latches)) => Phase::Pending { since, latches },
            };
        }
        self.holds = match acts {
            Some(text) => Some(text),
            None if holds => {
                self.holds.take().or_else(|| Some("a value is above its release threshold".to_owned()))
            }
            None => None,
        };
    }

    fn refuses_release(&self, rule: &Rule, now: Duration) -> Option<String> {
        let Phase::Acting { latched: true, quiet_since, .. } = &self.phase else { return None };
        if let Some(text) = &self.holds {
            return Some(text.clone());
        }
        let quiet = quiet_since.map_or(Duration::ZERO, |since| now.saturating_sub(since));
        (quiet < rule.quiet).then(|| {
            let (quiet, needed) = (quiet.as_secs_f64(), rule.quiet.as_secs_f64());
            format!("its conditions have been quiet for {quiet:.3} s only, of {needed} s")
        })
    }

    fn next_wake(&self, rule: &Rule, now: Duration) -> Option<Duration> {
        let phase = match &self.phase {
            Phase::Pending { since, .. } => Some(*since + rule.hold),
            Phase::Acting { latched: false, quiet_since, .. } => quiet_since.map(|since| since + rule.quiet),
            _ => None,
        };
        let lasts = self.latest.iter().any(|latest| latest.lasting.is_some());
        let clock = self.touched_since.zip(rule.limits.as_ref());
        let lasting = clock.filter(|_| lasts).map(|(since, limits)| since + limits.time_to_quasi_static);
        phase.into_iter().chain(lasting).filter(|at| *at > now).min()
    }
}

#[cfg(test)]
mod tests;
