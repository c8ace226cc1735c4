//! Quality of service of a topic.

use std::fmt;

/// Whether lost messages are sent again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reliability {
    /// Sent once; a slow peer loses messages and never holds the publisher up.
    BestEffort,
    /// Sent until received; a peer that stops reading can hold the publisher up.
    Reliable,
}

/// Whether a late joiner gets what was published before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Durability {
    /// Only what is published from now on.
    Volatile,
    /// The last messages, as many as the history depth says.
    TransientLocal,
}

/// How many messages are kept where the reader is slower than the writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum History {
    /// The newest `depth` messages (at least 1); older ones are dropped.
    KeepLast(usize),
    /// All of them, up to the resources of the machine.
    KeepAll,
}

/// Quality of service of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Qos {
    /// Whether lost messages are sent again.
    pub reliability: Reliability,
    /// Whether a late joiner gets what was published before.
    pub durability: Durability,
    /// How many messages are kept for a slow reader.
    pub history: History,
}

impl Qos {
    /// For streams of a sensor (REP-2003): best effort, the last 5, volatile.
    #[must_use]
    pub const fn sensor_data() -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            history: History::KeepLast(5),
        }
    }

    /// Reliable, volatile, keeping the last `depth` (0 counts as 1).
    #[must_use]
    pub const fn reliable(depth: usize) -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::Volatile,
            history: History::KeepLast(if depth == 0 { 1 } else { depth }),
        }
    }

    /// For what seldom changes (geometry, static transforms): reliable, and a late joiner gets the last one.
    #[must_use]
    pub const fn latched() -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            history: History::KeepLast(1),
        }
    }

    /// The profile of ROS 2 services: reliable, volatile, the last 10.
    #[must_use]
    pub const fn services() -> Self {
        Self::reliable(10)
    }

    /// The profile of `/parameter_events`: reliable, volatile, the last 1000.
    #[must_use]
    pub const fn parameter_events() -> Self {
        Self::reliable(1000)
    }

    /// The profile of `/clock`: best effort, the last 1.
    #[must_use]
    pub const fn clock() -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            history: History::KeepLast(1),
        }
    }

    /// The same with another depth (0 counts as 1).
    #[must_use]
    pub const fn with_depth(mut self, depth: usize) -> Self {
        self.history = History::KeepLast(if depth == 0 { 1 } else { depth });
        self
    }

    /// How many messages a reader's queue holds; `None` where it is not bounded.
    #[must_use]
    pub const fn depth(&self) -> Option<usize> {
        match self.history {
            History::KeepLast(0) => Some(1),
            History::KeepLast(depth) => Some(depth),
            History::KeepAll => None,
        }
    }

    /// Why a subscription with this profile gets nothing, or less than it requested, from a publisher
    /// with `offered`; `None` where the two fit.
    #[must_use]
    pub fn unmet_by(&self, offered: &Self) -> Option<&'static str> {
        if self.reliability == Reliability::Reliable && offered.reliability == Reliability::BestEffort {
            Some("the subscription asks for reliable, the publisher offers best effort")
        } else if self.durability == Durability::TransientLocal && offered.durability == Durability::Volatile
        {
            Some("the subscription asks for transient local, the publisher offers volatile")
        } else {
            None
        }
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reliability = match self.reliability {
            Reliability::BestEffort => "best effort",
            Reliability::Reliable => "reliable",
        };
        let durability = match self.durability {
            Durability::Volatile => "volatile",
            Durability::TransientLocal => "transient local",
        };
        match self.history {
            History::KeepLast(depth) => write!(f, "{reliability}, {durability}, keep last {depth}"),
            History::KeepAll => write!(f, "{reliability}, {durability}, keep all"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mismatches_are_those_of_dds() {
        let latched = Qos::latched();
        let sensor = Qos::sensor_data();
        assert_eq!(sensor.unmet_by(&latched), None);
        assert_eq!(latched.unmet_by(&latched), None);
        assert!(latched.unmet_by(&sensor).is_some_and(|why| why.contains("reliable")));
        assert!(latched.unmet_by(&Qos::reliable(1)).is_some_and(|why| why.contains("transient local")));
    }

    #[test]
    fn a_depth_of_zero_counts_as_one() {
        assert_eq!(Qos::reliable(0).depth(), Some(1));
        assert_eq!(Qos::sensor_data().with_depth(0).depth(), Some(1));
    }

    #[test]
    fn it_reads_well() {
        assert_eq!(Qos::latched().to_string(), "reliable, transient local, keep last 1");
    }
}
