//! What a launch file holds, as it is written.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, Error as _, Visitor};
use serde_json::{Map, Value};
use serde_path_to_error::Segment;

use crate::backoff::Backoff;
use crate::error::LaunchError;
use crate::faults::Faults;
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
    pub container: Option<Text>,
    #[serde(default)]
    pub log_limits: LogLimits,
    /// Each is an [`Entry`].
    pub processes: Vec<Value>,
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
    #[serde(default)]
    pub container: Option<Text>,
    /// Each is an [`Entry`].
    pub processes: Vec<Value>,
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
    #[serde(default)]
    pub container: Option<Text>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Entry {
    pub name: Option<Text>,
    pub node: Option<Text>,
    pub dermis: Option<Vec<Text>>,
    pub program: Option<Vec<Text>>,
    /// A [`Group`].
    pub group: Option<Value>,
    /// An [`Include`].
    pub include: Option<Value>,
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
    pub container: Option<Text>,
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
    let text = dermis_io::read_text(path, dermis_io::TEXT).map_err(|e| LaunchError::Read {
        path: path.to_owned(),
        reason: format!("cannot be read: {e}; check the path and its permissions"),
    })?;
    let yaml = path.extension().is_some_and(|e| e == "yaml" || e == "yml");
    parse(&text, yaml).map_err(|reason| LaunchError::Read { path: path.to_owned(), reason })
}

pub(crate) fn parse(text: &str, yaml: bool) -> Result<Value, String> {
    if yaml {
        dermis_io::yaml::check(text, dermis_io::yaml::Budget::WRITTEN)?;
    }
    let format = if yaml { config::FileFormat::Yaml } else { config::FileFormat::Toml };
    config::Config::builder()
        .add_source(config::File::from_str(text, format))
        .build()
        .and_then(config::Config::try_deserialize)
        .map_err(|e| dermis_io::one_line(&e.to_string()))
}

/// A part of a tree as what it should be, and the keys of it that are not right. Every field that is not is reported, with a path that
/// begins with `at`, and left out; `None` where nothing can be left out.
pub(crate) fn typed<T: DeserializeOwned>(
    mut value: Value,
    path: &Path,
    at: &str,
    faults: &mut Faults,
) -> (Option<T>, BTreeSet<String>) {
    let mut bad = BTreeSet::new();
    loop {
        let error = match serde_path_to_error::deserialize(&value) {
            Ok(read) => return (Some(read), bad),
            Err(error) => error,
        };
        let inner = error.path().to_string();
        let field = match (at, inner.as_str()) {
            ("", ".") => "(top level)".to_owned(),
            (at, ".") => at.to_owned(),
            ("", inner) => inner.to_owned(),
            (at, inner) => format!("{at}.{inner}"),
        };
        let reason = dermis_io::one_line(&error.inner().to_string());
        faults.push(LaunchError::Field { path: path.to_owned(), field, reason });
        let left_out = without(&mut value, error.path());
        bad.extend(left_out.clone());
        if left_out.is_none() || faults.full() {
            return (None, bad);
        }
    }
}

/// Takes the innermost key of a path out of a tree; the outermost one is returned.
fn without(value: &mut Value, path: &serde_path_to_error::Path) -> Option<String> {
    let segments: Vec<&Segment> = path.iter().collect();
    let last = segments.iter().rposition(|segment| matches!(segment, Segment::Map { .. }))?;
    let mut at = value;
    for segment in &segments[..last] {
        at = match segment {
            Segment::Map { key } => at.get_mut(key)?,
            Segment::Seq { index } => at.get_mut(index)?,
            Segment::Enum { .. } | Segment::Unknown => return None,
        };
    }
    let Segment::Map { key } = segments[last] else { return None };
    at.as_object_mut()?.remove(key)?;
    let Some(Segment::Map { key }) = segments.first() else { return None };
    Some(key.clone())
}
