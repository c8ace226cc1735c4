//! A robot's reflexes: rules that act on touch.
//!
//! A rule names a region of the robot, conditions on its contacts, and actions. The rules stand in a file
//! ([`Rules::load`]). [`Reflex`] is the state machine that decides: messages and the time go in, commands come out. It
//! does no input or output and reads no clock, so that every case can be tested. The node around it subscribes, publishes and
//! keeps the time.
//!
//! | module | question |
//! |---|---|
//! | [`rules`] | what do the rules say? |
//! | [`file`](mod@file) | what does the rule file say, and what is wrong with it? |
//! | [`assess`] | what does one message mean for one rule? |
//! | [`machine`] | when does a rule act, and when is it released? |
//! | [`outputs`] | what is sent, and how often? |
//! | [`ReflexNode`] | the node: topics, services, lifecycle, diagnostics |
//!
//! # What fails safe
//!
//! An empty list of contacts means "not touched" only where the sense is there. A rule says which losses of sense count as touched
//! ([`rules::Loss`]); where it says nothing, all do but a degraded skin. A force that the message does not give is a loss, too. A rule
//! that latches acts until somebody releases it, and nobody can release it while its condition holds.
//!
//! This is a program on a general-purpose computer. It is no safety function in the sense of ISO 13849 or IEC 61508, and no
//! limit value ships with it.
//!
//! ```
//! use std::time::Duration;
//!
//! use dermis_msgs::msg::{Contact, ContactArray};
//! use dermis_reflex::{Reflex, Rules};
//!
//! let rules = Rules::from_toml(
//!     r#"
//!     schema = "dermis-reflex/1"
//!     name = "gripper"
//!     start = "clear"
//!     [inputs.palm]
//!     kind = "skin"
//!     topic = "/palm/contacts"
//!     timeout = 0.02
//!     [actions.stop]
//!     kind = "bool"
//!     topic = "stop"
//!     [[rules]]
//!     name = "touch"
//!     force = { above = 5.0 }
//!     actions = ["stop"]
//!     "#,
//!     "gripper.toml",
//! )?;
//! let mut reflex = Reflex::new(rules, Duration::ZERO);
//! let mut pressed = ContactArray { skin: "palm".into(), sequence: 1, ..ContactArray::default() };
//! pressed.contacts.push(Contact {
//!     force_components: Contact::FORCE_NORMAL,
//!     force: dermis_msgs::geometry_msgs::msg::Vector3 { x: 0.0, y: 0.0, z: -6.0 },
//!     ..Contact::default()
//! });
//! let done = reflex.skin(0, &pressed, Duration::from_millis(10), 0);
//! assert_eq!(done.events[0].to_string(), "rule `touch` acts: a force of 6 N on skin `palm` is above 5 N");
//! assert_eq!(done.commands.len(), 1);
//! # Ok::<(), dermis_reflex::RuleFileError>(())
//! ```

pub mod assess;
pub mod cli;
mod config;
pub mod file;
pub mod machine;
mod node;
pub mod outputs;
pub mod rules;
mod slide;

pub use config::{Config, RunError};
pub use file::RuleFileError;
pub use machine::{Done, Event, Reflex, ReleaseRefused};
pub use node::{ReflexNode, run};
pub use outputs::{Command, Order};
pub use rules::Rules;

/// What the rule file of a configuration says, in one sentence.
///
/// # Errors
///
/// Where it cannot be used: file, line and field.
pub fn check(config: &Config) -> Result<String, RuleFileError> {
    let rules = Rules::load(&config.rules)?;
    let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    Ok(format!(
        "{}: {} on {}, with {}",
        config.rules.display(),
        count(rules.rules.len(), "rule"),
        count(rules.inputs.len(), "input"),
        count(rules.actions.len(), "action"),
    ))
}
