//! The quality of service that a topic was offered with: a player offers the same again.

use std::fmt::Write as _;

use yaml_rust2::{Yaml, YamlLoader};

/// Whether a publisher resends what a subscriber missed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reliability {
    /// Samples may be lost; the publisher never waits.
    BestEffort,
    /// Samples are resent until they arrive.
    Reliable,
}

/// Whether a late subscriber gets samples from before it joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Durability {
    /// No.
    Volatile,
    /// The last `depth` ones ("latched").
    TransientLocal,
}

/// Offered quality of service of a recorded topic; deadline, lifespan and liveliness are always infinite and
/// automatic here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
pub struct BagQos {
    /// Delivery.
    pub reliability: Reliability,
    /// Late joiners.
    pub durability: Durability,
    /// Samples kept for a slow or late subscriber (history is keep-last); 0 stands for keep-all.
    pub depth: usize,
}

impl BagQos {
    /// `SensorDataQoS`: best effort, volatile, the last 5 samples.
    #[must_use]
    pub const fn sensor_data() -> Self {
        Self { reliability: Reliability::BestEffort, durability: Durability::Volatile, depth: 5 }
    }

    /// Reliable and volatile with the last `depth` samples.
    #[must_use]
    pub const fn reliable(depth: usize) -> Self {
        Self { reliability: Reliability::Reliable, durability: Durability::Volatile, depth }
    }

    /// Reliable and transient local with one sample: geometry, robot descriptions.
    #[must_use]
    pub const fn latched() -> Self {
        Self { reliability: Reliability::Reliable, durability: Durability::TransientLocal, depth: 1 }
    }

    /// The YAML list of profiles that metadata version 9 and the channel's metadata hold, each line indented.
    pub(crate) fn to_yaml(self, indent: &str) -> String {
        let history = if self.depth == 0 { "keep_all" } else { "keep_last" };
        let reliability = match self.reliability {
            Reliability::BestEffort => "best_effort",
            Reliability::Reliable => "reliable",
        };
        let durability = match self.durability {
            Durability::Volatile => "volatile",
            Durability::TransientLocal => "transient_local",
        };
        let mut out = String::new();
        let _ = writeln!(out, "{indent}- history: {history}");
        let _ = writeln!(out, "{indent}  depth: {}", self.depth);
        let _ = writeln!(out, "{indent}  reliability: {reliability}");
        let _ = writeln!(out, "{indent}  durability: {durability}");
        for (key, after) in
            [("deadline", ""), ("lifespan", "liveliness: automatic"), ("liveliness_lease_duration", "")]
        {
            // The value that rosbag2 writes for "infinite".
            let _ = writeln!(out, "{indent}  {key}:");
            let _ = writeln!(out, "{indent}    sec: 9223372036");
            let _ = writeln!(out, "{indent}    nsec: 854775807");
            if !after.is_empty() {
                let _ = writeln!(out, "{indent}  {after}");
            }
        }
        let _ = writeln!(out, "{indent}  avoid_ros_namespace_conventions: false");
        out
    }

    /// Reads the first profile of a list, in the words of version 9 or the numbers of earlier ones, from nested
    /// YAML or from a string that holds YAML.
    pub(crate) fn from_yaml(value: &Yaml) -> Option<Self> {
        if let Yaml::String(text) = value {
            let inner = YamlLoader::load_from_str(text).ok()?;
            return match inner.first() {
                Some(Yaml::String(_)) | None => None,
                Some(value) => Self::from_yaml(value),
            };
        }
        let profile = value.as_vec()?.first()?;
        let is = |key: &str, word: &str, number: i64| {
            let field = &profile[key];
            field.as_str().is_some_and(|text| text.eq_ignore_ascii_case(word))
                || field.as_i64() == Some(number)
        };
        let depth = if is("history", "keep_all", 2) {
            0
        } else {
            usize::try_from(profile["depth"].as_i64()?).ok()?
        };
        Some(Self {
            reliability: if is("reliability", "best_effort", 2) {
                Reliability::BestEffort
            } else {
                Reliability::Reliable
            },
            durability: if is("durability", "transient_local", 1) {
                Durability::TransientLocal
            } else {
                Durability::Volatile
            },
            depth,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_survive_their_text() {
        for qos in [BagQos::sensor_data(), BagQos::reliable(0), BagQos::reliable(17), BagQos::latched()] {
            let text = qos.to_yaml("");
            let yaml = YamlLoader::load_from_str(&text).unwrap();
            assert_eq!(BagQos::from_yaml(&yaml[0]), Some(qos), "{text}");
            assert_eq!(BagQos::from_yaml(&Yaml::String(text)), Some(qos));
        }
    }

    #[test]
    fn numbers_of_older_bags_are_read() {
        let old = "- history: 1\n  depth: 3\n  reliability: 2\n  durability: 1\n";
        assert_eq!(
            BagQos::from_yaml(&Yaml::String(old.into())),
            Some(BagQos {
                reliability: Reliability::BestEffort,
                durability: Durability::TransientLocal,
                depth: 3
            })
        );
        assert_eq!(BagQos::from_yaml(&Yaml::String(String::new())), None);
        assert_eq!(BagQos::from_yaml(&Yaml::String("\"nested\"".into())), None);
    }
}
