//! Diagnostics of a node on `/diagnostics`.

use std::fmt;
use std::sync::{Arc, Mutex};

use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use dermis_msgs::std_msgs::msg::Header;

use crate::executor::lock;

/// How bad it is; the order is that of badness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Level {
    /// As it should be.
    #[default]
    Ok,
    /// Works, but somebody should look.
    Warn,
    /// Does not work.
    Error,
    /// Nothing was heard for too long.
    Stale,
}

impl Level {
    const fn id(self) -> u8 {
        match self {
            Self::Ok => DiagnosticStatus::OK,
            Self::Warn => DiagnosticStatus::WARN,
            Self::Error => DiagnosticStatus::ERROR,
            Self::Stale => DiagnosticStatus::STALE,
        }
    }
}

/// What one source says of itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Status {
    /// How bad it is.
    pub level: Level,
    /// One sentence.
    pub message: String,
    /// Figures, with the unit in the key.
    pub values: Vec<(String, String)>,
}

impl Status {
    /// As it should be.
    #[must_use]
    pub fn ok(message: impl Into<String>) -> Self {
        Self { message: message.into(), ..Self::default() }
    }

    /// Raises the level to at least `level`; the sentence of the worst level wins, and those of one
    /// level are joined.
    pub fn worsen(&mut self, level: Level, message: impl fmt::Display) {
        if level > self.level {
            self.level = level;
            self.message = message.to_string();
        } else if level == self.level && level > Level::Ok {
            self.message = format!("{}; {message}", self.message);
        }
    }

    /// Adds a figure.
    pub fn value(&mut self, key: impl Into<String>, value: impl fmt::Display) {
        self.values.push((key.into(), value.to_string()));
    }
}

type Source = Box<dyn FnMut() -> Status + Send>;

struct Inner {
    node: String,
    hardware_id: Mutex<String>,
    sources: Mutex<Vec<(String, Source)>>,
}

/// The diagnostics of a node. Cheap to clone; clones share the sources.
#[derive(Clone)]
pub struct Diagnostics(Arc<Inner>);

impl Diagnostics {
    pub(crate) fn new(node: String) -> Self {
        Self(Arc::new(Inner {
            node,
            hardware_id: Mutex::new(String::new()),
            sources: Mutex::new(Vec::new()),
        }))
    }

    /// Adds a source; it is polled once a second. One of the same name is replaced. It must not add sources.
    pub fn add(&self, name: impl Into<String>, source: impl FnMut() -> Status + Send + 'static) {
        let name = name.into();
        let mut sources = lock(&self.0.sources);
        sources.retain(|(known, _)| *known != name);
        sources.push((name, Box::new(source)));
    }

    /// Names the device that the node speaks for, for instance a serial number.
    pub fn set_hardware_id(&self, id: impl Into<String>) {
        *lock(&self.0.hardware_id) = id.into();
    }

    /// Asks all sources now.
    #[must_use]
    pub fn collect(&self) -> Vec<(String, Status)> {
        lock(&self.0.sources).iter_mut().map(|(name, source)| (name.clone(), source())).collect()
    }

    pub(crate) fn message(&self, now_ns: i64) -> DiagnosticArray {
        let hardware_id = lock(&self.0.hardware_id).clone();
        let status = self
            .collect()
            .into_iter()
            .map(|(name, status)| DiagnosticStatus {
                level: status.level.id(),
                name: format!("{}: {name}", self.0.node.trim_start_matches('/')),
                message: status.message,
                hardware_id: hardware_id.clone(),
                values: status.values.into_iter().map(|(key, value)| KeyValue { key, value }).collect(),
            })
            .collect();
        let header = Header { stamp: Time::from_nanos(now_ns), ..Header::default() };
        DiagnosticArray { header, status }
    }

    pub(crate) fn clear(&self) {
        lock(&self.0.sources).clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_sentence_wins() {
        let mut status = Status::ok("streaming");
        status.worsen(Level::Ok, "fine");
        assert_eq!(status.message, "streaming");
        status.worsen(Level::Warn, "3 frames lost");
        status.worsen(Level::Warn, "channel b3 is saturated");
        assert_eq!(status.message, "3 frames lost; channel b3 is saturated");
        status.worsen(Level::Error, "no frame for 2 s");
        status.worsen(Level::Warn, "late");
        assert_eq!((status.level, status.message.as_str()), (Level::Error, "no frame for 2 s"));
    }

    #[test]
    fn messages_carry_node_device_and_figures() {
        let diagnostics = Diagnostics::new("/left/palm".to_owned());
        diagnostics.set_hardware_id("BD-0042");
        diagnostics.add("transport", || Status::ok("old"));
        diagnostics.add("transport", || {
            let mut status = Status::ok("streaming");
            status.value("rate (Hz)", 99.5);
            status
        });
        let message = diagnostics.message(1_500_000_000);
        assert_eq!(message.header.stamp.sec, 1);
        assert_eq!(message.status.len(), 1);
        let status = &message.status[0];
        assert_eq!(status.name, "left/palm: transport");
        assert_eq!(status.hardware_id, "BD-0042");
        assert_eq!(status.values[0].value, "99.5");
    }
}
