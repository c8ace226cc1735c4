//! Requests in files: times, sizes, regular expressions and remappings as a command line takes them.
//!
//! A time is a number of seconds or a text such as `10min`, a size a number of bytes or a text such as `1GiB`. Both are written as
//! numbers. Regular expressions and remappings (`from:=to`) are texts.

use serde::{Deserialize, Deserializer};

/// A number, or a text as on a command line.
#[derive(Deserialize)]
#[serde(untagged)]
enum Typed<N> {
    Number(N),
    Text(String),
}

impl<N> Typed<N> {
    fn read<'de, T, D: Deserializer<'de>>(
        self,
        number: impl Fn(N) -> Result<T, String>,
        text: impl Fn(&str) -> Result<T, String>,
    ) -> Result<T, D::Error> {
        match self {
            Self::Number(value) => number(value),
            Self::Text(value) => text(&value),
        }
        .map_err(serde::de::Error::custom)
    }
}

/// A time that may be absent.
pub mod duration {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Typed;
    use crate::quantity;

    pub fn serialize<S: Serializer>(time: &Option<Duration>, serializer: S) -> Result<S::Ok, S::Error> {
        time.map(|t| t.as_secs_f64()).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Duration>, D::Error> {
        let typed = Option::<Typed<f64>>::deserialize(deserializer)?;
        typed.map(|t| t.read::<_, D>(quantity::seconds, quantity::duration)).transpose()
    }
}

/// A size that may be absent.
pub mod optional_size {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Typed;
    use crate::quantity;

    pub fn serialize<S: Serializer>(size: &Option<u64>, serializer: S) -> Result<S::Ok, S::Error> {
        size.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
        let typed = Option::<Typed<u64>>::deserialize(deserializer)?;
        typed.map(|t| t.read::<_, D>(quantity::bytes, quantity::size)).transpose()
    }
}

/// A size.
pub mod size {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Typed;
    use crate::quantity;

    pub fn serialize<S: Serializer>(size: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        size.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        Typed::<u64>::deserialize(deserializer)?.read::<_, D>(quantity::bytes, quantity::size)
    }
}

/// Regular expressions.
pub mod patterns {
    use regex::Regex;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(patterns: &[Regex], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(patterns.iter().map(Regex::as_str))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Regex>, D::Error> {
        let texts = Vec::<String>::deserialize(deserializer)?;
        texts.iter().map(|text| Regex::new(text).map_err(D::Error::custom)).collect()
    }
}

/// Other names for topics.
pub mod remappings {
    use dermis_node::parse_remapping;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(rules: &[(String, String)], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(rules.iter().map(|(from, to)| format!("{from}:={to}")))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<(String, String)>, D::Error> {
        let texts = Vec::<String>::deserialize(deserializer)?;
        texts.iter().map(|text| parse_remapping(text).map_err(D::Error::custom)).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use serde_json::json;

    use crate::{play, record, slice};

    #[test]
    fn times_sizes_and_rules_read_as_on_a_command_line() {
        let text = json!({ "out": "bag", "regex": ["^/skin"], "split_size": "1MiB", "split_time": "10min",
                           "buffer": 4096, "duration": 1.5, "compression": "small" });
        let recorded: record::Request = serde_json::from_value(text).unwrap();
        assert_eq!(recorded.split_size, Some(1 << 20));
        assert_eq!((recorded.buffer, recorded.split_time), (4096, Some(Duration::from_secs(600))));
        assert_eq!(recorded.duration, Some(Duration::from_millis(1500)));
        assert_eq!((recorded.regex[0].as_str(), recorded.compression), ("^/skin", record::Level::Small));
        let played = json!({ "bag": "b", "remap": ["a:=b"], "start_offset": "3h" });
        let played: play::Request = serde_json::from_value(played).unwrap();
        assert_eq!(played.remap, [("a".to_owned(), "b".to_owned())]);
        assert_eq!(played.start_offset, Some(Duration::from_secs(3 * 3600)));
        assert_eq!(played.rate.to_bits(), 1.0_f64.to_bits());

        // What is written reads as the same.
        let written = serde_json::to_value(&recorded).unwrap();
        assert_eq!((&written["split_time"], &written["split_size"]), (&json!(600.0), &json!(1 << 20)));
        let again: record::Request = serde_json::from_value(written.clone()).unwrap();
        assert_eq!(serde_json::to_value(again).unwrap(), written);
        assert_eq!(serde_json::to_value(&played).unwrap()["remap"], json!(["a:=b"]));
    }

    #[test]
    fn what_cannot_be_is_refused_with_a_sentence() {
        let message = |text| serde_json::from_value::<record::Request>(text).unwrap_err().to_string();
        assert_eq!(
            message(json!({ "duration": "3y" })),
            "`y` is no unit of time: write e.g. `500ms`, `10s`, `10min` or `2h`"
        );
        assert_eq!(
            message(json!({ "duration": -1.0 })),
            "`-1` is no duration: write e.g. `500ms`, `10s`, `10min` or `2h`"
        );
        assert_eq!(message(json!({ "buffer": 0 })), "`0` is no size: write e.g. `500MB` or `1GiB`");
        assert!(message(json!({ "regex": ["("] })).contains("unclosed group"));
        assert!(message(json!({ "regexp": [] })).contains("unknown field `regexp`"));
        let message = |text| serde_json::from_value::<play::Request>(text).unwrap_err().to_string();
        assert!(message(json!({ "remap": ["a=b"] })).contains("a=b"));
        let message = |text| serde_json::from_value::<slice::Request>(text).unwrap_err().to_string();
        assert!(message(json!({ "split_size": "1 furlong" })).contains("furlong"));
    }
}
