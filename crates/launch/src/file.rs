//! What a launch file holds, as it is written.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, Error as _, Visitor};
use serde_json::{Map, Value};

use crate::backoff::Backoff;
use crate::error::LaunchError;
use crate::log::LogLimits;
use crate::plan::{Restart, Stop};

/// A text; a number or truth value that was written without quotes is one too.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Text(pub String);

impl<'de> Deserialize<'de> for Text {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl Visitor<'_> for Any {
            type Value = Text;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a text")
            }
            fn visit_str<E>(self, v: &str) -> Result<Text, E> {
                Ok(Text(v.to_owned()))
            }
            fn visit_bool<E>(self, v: bool) -> Result<Text, E> {
                Ok(Text(v.to_string()))
            }
            fn visit_i64<E>(self, v: i64) -> Result<Text, E> {
                Ok(Text(v.to_string()))
            }
            fn visit_u64<E>(self, v: u64) -> Result<Text, E> {
                Ok(Text(v.to_string()))
            }
            fn visit_f64<E>(self, v: f64) -> Result<Text, E> {
                Ok(Text(v.to_string()))
            }
        }
        deserializer.deserialize_any(Any)
    }
}

/// A number or truth value, also where `${…}` made a text of it.
pub(crate) fn loose<'de, D: Deserializer<'de>, T: DeserializeOwned>(deserializer: D) -> Result<T, D::Error> {
    let value = Value::deserialize(deserializer)?;
    if let Value::String(text) = &value
        && let Ok(value) = serde_json::from_str::<Value>(text)
        && let Ok(value) = serde_json::from_value(value)
    {
        return Ok(value);
    }
    serde_json::from_value(value).map_err(D::Error::custom)
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct File {
    /// Read before the rest, because the rest needs it.
    #[serde(default, rename = "arguments")]
    _arguments: Option<Value>,
    #[serde(default)]
    pub namespace: Option<Text>,
    #[serde(default)]
    pub environment: BTreeMap<String, Text>,
    #[serde(default, deserialize_with = "loose")]
    pub domain_id: Option<u16>,
    #[serde(default)]
    pub network: Option<Text>,
    #[serde(default)]
    pub zenoh_config: Option<Text>,
    #[serde(default)]
    pub log: Option<Text>,
    #[serde(default)]
    pub log_limits: LogLimits,
    pub processes: Vec<Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Argument {
    #[serde(default)]
    pub default: Option<Text>,
    #[serde(default)]
    pub about: String,
    #[serde(default)]
    pub path: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Group {
    #[serde(default)]
    pub namespace: Option<Text>,
    #[serde(default)]
    pub environment: BTreeMap<String, Text>,
    #[serde(default, deserialize_with = "loose")]
    pub domain_id: Option<u16>,
    #[serde(default)]
    pub network: Option<Text>,
    #[serde(default)]
    pub zenoh_config: Option<Text>,
    #[serde(default)]
    pub log: Option<Text>,
    pub processes: Vec<Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Include {
    pub file: Text,
    #[serde(default)]
    pub arguments: BTreeMap<String, Text>,
    #[serde(default)]
    pub namespace: Option<Text>,
    #[serde(default)]
    pub environment: BTreeMap<String, Text>,
    #[serde(default, deserialize_with = "loose")]
    pub domain_id: Option<u16>,
    #[serde(default)]
    pub network: Option<Text>,
    #[serde(default)]
    pub zenoh_config: Option<Text>,
    #[serde(default)]
    pub log: Option<Text>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Entry {
    pub name: Option<Text>,
    pub node: Option<Text>,
    pub dermis: Option<Vec<Text>>,
    pub program: Option<Vec<Text>>,
    pub group: Option<Group>,
    pub include: Option<Include>,
    pub config: Option<Value>,
    pub flags: Vec<Text>,
    pub parameters: Map<String, Value>,
    pub remap: Vec<Text>,
    #[serde(deserialize_with = "loose")]
    pub ros_args: bool,
    pub namespace: Option<Text>,
    pub environment: BTreeMap<String, Text>,
    #[serde(deserialize_with = "loose")]
    pub domain_id: Option<u16>,
    pub network: Option<Text>,
    pub zenoh_config: Option<Text>,
    pub log: Option<Text>,
    pub directory: Option<Text>,
    pub after: Vec<Text>,
    pub ready: Option<Ready>,
    pub restart: Restart,
    pub backoff: Backoff,
    #[serde(deserialize_with = "loose")]
    pub required: bool,
    pub stop: Stop,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Ready {
    #[serde(default)]
    pub file: Option<Text>,
    #[serde(default)]
    pub line: Option<Text>,
    #[serde(default = "half_a_minute", deserialize_with = "loose")]
    pub within: f64,
}

fn half_a_minute() -> f64 {
    30.0
}

/// The tree of a file: YAML where its name ends in `.yaml` or `.yml`, otherwise TOML.
pub(crate) fn read(path: &Path) -> Result<Value, LaunchError> {
    let text = std::fs::read_to_string(path).map_err(|e| LaunchError::Read {
        path: path.to_owned(),
        reason: format!("cannot be read: {e}; check the path and its permissions"),
    })?;
    let yaml = path.extension().is_some_and(|e| e == "yaml" || e == "yml");
    parse(&text, yaml).map_err(|reason| LaunchError::Read { path: path.to_owned(), reason })
}

pub(crate) fn parse(text: &str, yaml: bool) -> Result<Value, String> {
    if let Some(line) = nested_too_deeply(text).filter(|_| yaml) {
        return Err(format!("line {line} is nested too deeply"));
    }
    let format = if yaml { config::FileFormat::Yaml } else { config::FileFormat::Toml };
    config::Config::builder()
        .add_source(config::File::from_str(text, format))
        .build()
        .and_then(config::Config::try_deserialize)
        .map_err(|e| one_line(&e.to_string()))
}

/// A part of a tree as what it should be; the path of a field that is not begins with `at`.
pub(crate) fn typed<T: DeserializeOwned>(value: Value, path: &Path, at: &str) -> Result<T, LaunchError> {
    serde_path_to_error::deserialize(value).map_err(|e| {
        let inner = e.path().to_string();
        let field = match (at, inner.as_str()) {
            ("", ".") => "(top level)".to_owned(),
            (at, ".") => at.to_owned(),
            ("", inner) => inner.to_owned(),
            (at, inner) => format!("{at}.{inner}"),
        };
        LaunchError::Field { path: path.to_owned(), field, reason: one_line(&e.inner().to_string()) }
    })
}

/// The first line whose content stands further right than any launch file has it: block nesting is read recursively, and
/// thousands of levels would end the program.
fn nested_too_deeply(text: &str) -> Option<usize> {
    const DEEPEST: usize = 200;
    let column =
        |line: &str| line.find(|c: char| !matches!(c, ' ' | '\t' | '-' | '?' | ':')).unwrap_or(line.len());
    text.lines().position(|line| column(line) > DEEPEST).map(|at| at + 1)
}

pub(crate) fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
