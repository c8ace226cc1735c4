//! Parameters of a node and the standard services that reach them.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, OnceLock};

use dermis_msgs::rcl_interfaces::msg::{
    FloatingPointRange, IntegerRange, ListParametersResult, Parameter as ParameterMsg,
    ParameterDescriptor as DescriptorMsg, ParameterEvent, ParameterType as T, ParameterValue as ValueMsg,
    SetParametersResult,
};

use crate::error::NodeError;
use crate::executor::lock;

/// A parameter's value.
#[derive(Debug, Clone, PartialEq)]
pub enum ParameterValue {
    /// No value.
    NotSet,
    /// A truth value.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A floating point number.
    Double(f64),
    /// Text.
    String(String),
    /// Bytes.
    ByteArray(Vec<u8>),
    /// Truth values.
    BoolArray(Vec<bool>),
    /// Whole numbers.
    IntegerArray(Vec<i64>),
    /// Floating point numbers.
    DoubleArray(Vec<f64>),
    /// Texts.
    StringArray(Vec<String>),
}

impl ParameterValue {
    /// The name of its type, as `ros2 param` prints it.
    #[must_use]
    pub const fn type_name(&self) -> &'static str {
        match self {
            Self::NotSet => "not set",
            Self::Bool(_) => "bool",
            Self::Integer(_) => "integer",
            Self::Double(_) => "double",
            Self::String(_) => "string",
            Self::ByteArray(_) => "byte array",
            Self::BoolArray(_) => "bool array",
            Self::IntegerArray(_) => "integer array",
            Self::DoubleArray(_) => "double array",
            Self::StringArray(_) => "string array",
        }
    }

    /// The truth value, if it is one.
    #[must_use]
    pub const fn as_bool(&self) -> Option<bool> {
        if let Self::Bool(value) = self { Some(*value) } else { None }
    }

    /// The whole number, if it is one.
    #[must_use]
    pub const fn as_i64(&self) -> Option<i64> {
        if let Self::Integer(value) = self { Some(*value) } else { None }
    }

    /// The floating point number, if it is one.
    #[must_use]
    pub const fn as_f64(&self) -> Option<f64> {
        if let Self::Double(value) = self { Some(*value) } else { None }
    }

    /// The text, if it is one.
    #[must_use]
    pub fn as_str(&self) -> Option<&str> {
        if let Self::String(value) = self { Some(value) } else { None }
    }

    /// The floating point numbers, if it is an array of them.
    #[must_use]
    pub fn as_f64_slice(&self) -> Option<&[f64]> {
        if let Self::DoubleArray(value) = self { Some(value) } else { None }
    }

    /// Reads the text of `-p name:=value`: `true`, `3`, `0.5`, `[1.0, 2.0]`, `"text"`; anything else is a
    /// string.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        match serde_json::from_str::<serde_json::Value>(text) {
            Ok(value) => Self::from_json(&value).unwrap_or_else(|| Self::String(text.to_owned())),
            Err(_) => Self::String(text.to_owned()),
        }
    }

    /// Reads a JSON (or YAML, TOML) scalar or a list of scalars of one kind; whole and floating point
    /// numbers in one list make a double array. `None` where there is no such parameter type.
    #[must_use]
    pub fn from_json(value: &serde_json::Value) -> Option<Self> {
        use serde_json::Value as Json;
        let list = match value {
            Json::Bool(v) => return Some(Self::Bool(*v)),
            Json::Number(n) => {
                return n.as_i64().map_or_else(|| n.as_f64().map(Self::Double), |i| Some(Self::Integer(i)));
            }
            Json::String(s) => return Some(Self::String(s.clone())),
            Json::Array(list) if !list.is_empty() => list,
            _ => return None,
        };
        if let Some(v) = list.iter().map(Json::as_bool).collect::<Option<Vec<_>>>() {
            return Some(Self::BoolArray(v));
        }
        if let Some(v) = list.iter().map(Json::as_i64).collect::<Option<Vec<_>>>() {
            return Some(Self::IntegerArray(v));
        }
        if let Some(v) = list.iter().map(Json::as_f64).collect::<Option<Vec<_>>>() {
            return Some(Self::DoubleArray(v));
        }
        list.iter().map(|s| s.as_str().map(str::to_owned)).collect::<Option<Vec<_>>>().map(Self::StringArray)
    }

    fn type_id(&self) -> u8 {
        match self {
            Self::NotSet => T::PARAMETER_NOT_SET,
            Self::Bool(_) => T::PARAMETER_BOOL,
            Self::Integer(_) => T::PARAMETER_INTEGER,
            Self::Double(_) => T::PARAMETER_DOUBLE,
            Self::String(_) => T::PARAMETER_STRING,
            Self::ByteArray(_) => T::PARAMETER_BYTE_ARRAY,
            Self::BoolArray(_) => T::PARAMETER_BOOL_ARRAY,
            Self::IntegerArray(_) => T::PARAMETER_INTEGER_ARRAY,
            Self::DoubleArray(_) => T::PARAMETER_DOUBLE_ARRAY,
            Self::StringArray(_) => T::PARAMETER_STRING_ARRAY,
        }
    }

    /// The message form.
    #[must_use]
    pub fn to_msg(&self) -> ValueMsg {
        let mut msg = ValueMsg { r#type: self.type_id(), ..ValueMsg::default() };
        match self.clone() {
            Self::NotSet => {}
            Self::Bool(v) => msg.bool_value = v,
            Self::Integer(v) => msg.integer_value = v,
            Self::Double(v) => msg.double_value = v,
            Self::String(v) => msg.string_value = v,
            Self::ByteArray(v) => msg.byte_array_value = v,
            Self::BoolArray(v) => msg.bool_array_value = v,
            Self::IntegerArray(v) => msg.integer_array_value = v,
            Self::DoubleArray(v) => msg.double_array_value = v,
            Self::StringArray(v) => msg.string_array_value = v,
        }
        msg
    }

    /// Reads the message form; `None` for a type number that ROS does not know.
    #[must_use]
    pub fn from_msg(msg: ValueMsg) -> Option<Self> {
        Some(match msg.r#type {
            T::PARAMETER_NOT_SET => Self::NotSet,
            T::PARAMETER_BOOL => Self::Bool(msg.bool_value),
            T::PARAMETER_INTEGER => Self::Integer(msg.integer_value),
            T::PARAMETER_DOUBLE => Self::Double(msg.double_value),
            T::PARAMETER_STRING => Self::String(msg.string_value),
            T::PARAMETER_BYTE_ARRAY => Self::ByteArray(msg.byte_array_value),
            T::PARAMETER_BOOL_ARRAY => Self::BoolArray(msg.bool_array_value),
            T::PARAMETER_INTEGER_ARRAY => Self::IntegerArray(msg.integer_array_value),
            T::PARAMETER_DOUBLE_ARRAY => Self::DoubleArray(msg.double_array_value),
            T::PARAMETER_STRING_ARRAY => Self::StringArray(msg.string_array_value),
            _ => return None,
        })
    }

    /// An integer where a double is declared is what people write in a configuration.
    fn widened_to(self, declared: &Self) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "configured numbers are far below 2^53")]
        match (self, declared) {
            (Self::Integer(v), Self::Double(_)) => Self::Double(v as f64),
            (Self::IntegerArray(v), Self::DoubleArray(_)) => {
                Self::DoubleArray(v.into_iter().map(|v| v as f64).collect())
            }
            (other, _) => other,
        }
    }
}

impl fmt::Display for ParameterValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotSet => f.write_str("not set"),
            Self::Bool(v) => write!(f, "{v}"),
            Self::Integer(v) => write!(f, "{v}"),
            Self::Double(v) => write!(f, "{v:?}"),
            Self::String(v) => write!(f, "{v:?}"),
            Self::ByteArray(v) => write!(f, "{v:?}"),
            Self::BoolArray(v) => write!(f, "{v:?}"),
            Self::IntegerArray(v) => write!(f, "{v:?}"),
            Self::DoubleArray(v) => write!(f, "{v:?}"),
            Self::StringArray(v) => write!(f, "{v:?}"),
        }
    }
}

macro_rules! from_value {
    ($($from:ty => $variant:ident),* $(,)?) => {$(
        impl From<$from> for ParameterValue {
            fn from(value: $from) -> Self {
                Self::$variant(value.into())
            }
        }
    )*};
}
from_value! {
    bool => Bool, i64 => Integer, i32 => Integer, u32 => Integer, f64 => Double, f32 => Double,
    String => String, &str => String, Vec<f64> => DoubleArray, Vec<i64> => IntegerArray,
    Vec<bool> => BoolArray, Vec<String> => StringArray,
}

/// Bounds of a number, both inclusive. With a step other than 0, values lie on `from + n·step`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterRange {
    /// Of a double.
    Float {
        /// Least value.
        from: f64,
        /// Greatest value.
        to: f64,
        /// Grid, or 0.
        step: f64,
    },
    /// Of an integer.
    Integer {
        /// Least value.
        from: i64,
        /// Greatest value.
        to: i64,
        /// Grid, or 0.
        step: u64,
    },
}

/// What a parameter is for and what it may be.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ParameterDescriptor {
    /// One sentence, with the unit.
    pub description: String,
    /// Further constraints in plain words.
    pub constraints: String,
    /// Whether it can only be given at start.
    pub read_only: bool,
    /// Whether its type may change.
    pub dynamic_typing: bool,
    /// Bounds.
    pub range: Option<ParameterRange>,
}

impl ParameterDescriptor {
    /// A parameter that may be set at any time.
    #[must_use]
    pub fn new(description: impl Into<String>) -> Self {
        Self { description: description.into(), ..Self::default() }
    }

    /// Only to be given at start.
    #[must_use]
    pub fn read_only(mut self) -> Self {
        self.read_only = true;
        self
    }

    /// Bounds of a double, both inclusive.
    #[must_use]
    pub fn float_range(mut self, from: f64, to: f64) -> Self {
        self.range = Some(ParameterRange::Float { from, to, step: 0.0 });
        self
    }

    /// Bounds of an integer, both inclusive.
    #[must_use]
    pub fn integer_range(mut self, from: i64, to: i64) -> Self {
        self.range = Some(ParameterRange::Integer { from, to, step: 0 });
        self
    }

    fn refuses(&self, value: &ParameterValue) -> Option<String> {
        match (self.range, value) {
            (Some(ParameterRange::Float { from, to, step }), ParameterValue::Double(v)) => {
                let off_grid = step > 0.0 && {
                    let n = (v - from) / step;
                    (n - n.round()).abs() > 1e-9 && (v - to).abs() > 1e-12
                };
                if !(from..=to).contains(v) {
                    Some(format!("{v:?} is outside of {from:?} to {to:?}"))
                } else if off_grid {
                    Some(format!("{v:?} is not {from:?} plus a multiple of {step:?}"))
                } else {
                    None
                }
            }
            (Some(ParameterRange::Integer { from, to, step }), ParameterValue::Integer(v)) => {
                if !(from..=to).contains(v) {
                    Some(format!("{v} is outside of {from} to {to}"))
                } else if step > 1 && v.abs_diff(from) % step != 0 && *v != to {
                    Some(format!("{v} is not {from} plus a multiple of {step}"))
                } else {
                    None
                }
            }
            _ => None,
        }
    }

    fn to_msg(&self, name: &str, value: &ParameterValue) -> DescriptorMsg {
        let mut msg = DescriptorMsg {
            name: name.to_owned(),
            r#type: value.type_id(),
            description: self.description.clone(),
            additional_constraints: self.constraints.clone(),
            read_only: self.read_only,
            dynamic_typing: self.dynamic_typing,
            ..DescriptorMsg::default()
        };
        match self.range {
            Some(ParameterRange::Float { from, to, step }) => {
                msg.floating_point_range.push(FloatingPointRange { from_value: from, to_value: to, step });
            }
            Some(ParameterRange::Integer { from, to, step }) => {
                msg.integer_range.push(IntegerRange { from_value: from, to_value: to, step });
            }
            None => {}
        }
        msg
    }
}

struct Entry {
    value: ParameterValue,
    descriptor: ParameterDescriptor,
}

type Validator = Box<dyn FnMut(&[(String, ParameterValue)]) -> Result<(), String> + Send>;
type Watcher = Box<dyn FnMut(&str, &ParameterValue) + Send>;
type EventSink = Box<dyn Fn(ParameterEvent) + Send + Sync>;

#[derive(Default)]
struct Store {
    entries: Mutex<BTreeMap<String, Entry>>,
    overrides: BTreeMap<String, ParameterValue>,
    /// Held while a set is checked and applied, so that two of them do not mix.
    setting: Mutex<()>,
    validators: Mutex<Vec<Validator>>,
    watchers: Mutex<Vec<Watcher>>,
    events: OnceLock<EventSink>,
}

/// The parameters of a node. Cheap to clone; clones share the values.
#[derive(Clone)]
pub struct Parameters(Arc<Store>);

impl Parameters {
    /// Parameters with these start values that no node offers: for checking start values before a node is made.
    #[must_use]
    pub fn new(overrides: BTreeMap<String, ParameterValue>) -> Self {
        Self(Arc::new(Store { overrides, ..Store::default() }))
    }

    pub(crate) fn set_event_sink(&self, sink: EventSink) {
        // A second sink would be a second node on one store, which cannot be made.
        let _ = self.0.events.set(sink);
    }

    /// Declares a parameter and returns its value: the override given at start, or else `default`.
    /// Declaring again keeps the value and replaces the descriptor.
    ///
    /// # Errors
    ///
    /// When the override has another type or lies outside of the range; the parameter is not declared then.
    pub fn declare(
        &self,
        name: &str,
        default: impl Into<ParameterValue>,
        descriptor: ParameterDescriptor,
    ) -> Result<ParameterValue, NodeError> {
        let refused = |reason: String| NodeError::Parameter { name: name.to_owned(), reason };
        let default = default.into();
        if name.is_empty() {
            return Err(refused("its name is empty".to_owned()));
        }
        let value = match self.0.overrides.get(name) {
            Some(given) => {
                let given = given.clone().widened_to(&default);
                if !descriptor.dynamic_typing
                    && default != ParameterValue::NotSet
                    && given.type_name() != default.type_name()
                {
                    return Err(refused(format!(
                        "its type is {}, but the value given at start is the {} {given}",
                        default.type_name(),
                        given.type_name()
                    )));
                }
                given
            }
            None => default,
        };
        if let Some(reason) = descriptor.refuses(&value) {
            return Err(refused(reason));
        }
        let value = {
            let mut entries = lock(&self.0.entries);
            if let Some(entry) = entries.get_mut(name) {
                entry.descriptor = descriptor;
                return Ok(entry.value.clone());
            }
            entries.insert(name.to_owned(), Entry { value: value.clone(), descriptor });
            value
        };
        let mut event = ParameterEvent::default();
        event.new_parameters.push(ParameterMsg { name: name.to_owned(), value: value.to_msg() });
        self.emit(event);
        Ok(value)
    }

    /// The value of a declared parameter.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<ParameterValue> {
        lock(&self.0.entries).get(name).map(|entry| entry.value.clone())
    }

    /// The descriptor of a declared parameter.
    #[must_use]
    pub fn describe(&self, name: &str) -> Option<ParameterDescriptor> {
        lock(&self.0.entries).get(name).map(|entry| entry.descriptor.clone())
    }

    /// The names of all declared parameters, sorted.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        lock(&self.0.entries).keys().cloned().collect()
    }

    /// Overrides given at start that no declaration requested: most likely misspelt.
    #[must_use]
    pub fn unused_overrides(&self) -> Vec<String> {
        let entries = lock(&self.0.entries);
        self.0.overrides.keys().filter(|name| !entries.contains_key(*name)).cloned().collect()
    }

    /// Sets one parameter.
    ///
    /// # Errors
    ///
    /// When it is not declared, read-only, of another type, out of range, or refused by a validator.
    pub fn set(&self, name: &str, value: impl Into<ParameterValue>) -> Result<(), NodeError> {
        self.set_all(&[(name.to_owned(), value.into())])
    }

    /// Sets several parameters, all or none.
    ///
    /// # Errors
    ///
    /// As [`Parameters::set`], naming the first parameter that is refused.
    pub fn set_all(&self, changes: &[(String, ParameterValue)]) -> Result<(), NodeError> {
        let setting = lock(&self.0.setting);
        self.check(changes)?;
        for validator in lock(&self.0.validators).iter_mut() {
            validator(changes).map_err(|reason| NodeError::Parameter {
                name: changes.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join("`, `"),
                reason,
            })?;
        }
        let mut event = ParameterEvent::default();
        {
            let mut entries = lock(&self.0.entries);
            for (name, value) in changes {
                if let Some(entry) = entries.get_mut(name) {
                    entry.value = value.clone();
                }
                event.changed_parameters.push(ParameterMsg { name: name.clone(), value: value.to_msg() });
            }
        }
        for watcher in lock(&self.0.watchers).iter_mut() {
            for (name, value) in changes {
                watcher(name, value);
            }
        }
        drop(setting);
        self.emit(event);
        Ok(())
    }

    fn check(&self, changes: &[(String, ParameterValue)]) -> Result<(), NodeError> {
        let entries = lock(&self.0.entries);
        for (name, value) in changes {
            let refused = |reason: String| NodeError::Parameter { name: name.clone(), reason };
            let Some(entry) = entries.get(name) else {
                return Err(refused("it is not declared by this node".to_owned()));
            };
            if entry.descriptor.read_only {
                return Err(refused("it is read-only: give it when the node starts".to_owned()));
            }
            if !entry.descriptor.dynamic_typing
                && entry.value != ParameterValue::NotSet
                && entry.value.type_name() != value.type_name()
            {
                return Err(refused(format!(
                    "its type is {}, not {}",
                    entry.value.type_name(),
                    value.type_name()
                )));
            }
            if let Some(reason) = entry.descriptor.refuses(value) {
                return Err(refused(reason));
            }
        }
        Ok(())
    }

    /// Lets `validator` see every change before it is made; an `Err` with a sentence refuses all of it.
    /// It may read parameters, but not set them.
    pub fn on_set(
        &self,
        validator: impl FnMut(&[(String, ParameterValue)]) -> Result<(), String> + Send + 'static,
    ) {
        lock(&self.0.validators).push(Box::new(validator));
    }

    /// Calls `watcher` with name and new value after each change. It may read parameters, but not set them.
    pub fn on_changed(&self, watcher: impl FnMut(&str, &ParameterValue) + Send + 'static) {
        lock(&self.0.watchers).push(Box::new(watcher));
    }

    /// Drops what callbacks captured.
    pub(crate) fn clear_callbacks(&self) {
        lock(&self.0.validators).clear();
        lock(&self.0.watchers).clear();
    }

    fn emit(&self, event: ParameterEvent) {
        if let Some(sink) = self.0.events.get() {
            sink(event);
        }
    }

    pub(crate) fn get_msgs(&self, names: &[String]) -> Vec<ValueMsg> {
        names.iter().map(|name| self.get(name).unwrap_or(ParameterValue::NotSet).to_msg()).collect()
    }

    pub(crate) fn describe_msgs(&self, names: &[String]) -> Vec<DescriptorMsg> {
        let entries = lock(&self.0.entries);
        names
            .iter()
            .map(|name| {
                entries.get(name).map_or_else(
                    || DescriptorMsg { name: name.clone(), ..DescriptorMsg::default() },
                    |entry| entry.descriptor.to_msg(name, &entry.value),
                )
            })
            .collect()
    }

    pub(crate) fn set_msgs(&self, parameters: Vec<ParameterMsg>) -> SetParametersResult {
        let mut changes = Vec::with_capacity(parameters.len());
        for ParameterMsg { name, value } in parameters {
            let kind = value.r#type;
            let Some(value) = ParameterValue::from_msg(value) else {
                return SetParametersResult {
                    successful: false,
                    reason: format!("parameter `{name}`: there is no parameter type {kind}"),
                };
            };
            changes.push((name, value));
        }
        match self.set_all(&changes) {
            Ok(()) => SetParametersResult { successful: true, reason: String::new() },
            Err(error) => SetParametersResult { successful: false, reason: error.to_string() },
        }
    }

    /// Names below any of `prefixes` (all names where there are none), at most `depth` parts deeper than
    /// the prefix (0: any), and the prefixes of those names.
    pub(crate) fn list(&self, prefixes: &[String], depth: u64) -> ListParametersResult {
        let mut result = ListParametersResult::default();
        for name in lock(&self.0.entries).keys() {
            let dots = |text: &str| text.matches('.').count() as u64;
            let listed = if prefixes.is_empty() {
                depth == 0 || dots(name) < depth
            } else {
                prefixes.iter().any(|prefix| {
                    name == prefix
                        || name
                            .strip_prefix(prefix.as_str())
                            .and_then(|rest| rest.strip_prefix('.'))
                            .is_some_and(|rest| depth == 0 || dots(rest) < depth)
                })
            };
            if listed {
                result.names.push(name.clone());
                if let Some((prefix, _)) = name.rsplit_once('.')
                    && !result.prefixes.iter().any(|known| known == prefix)
                {
                    result.prefixes.push(prefix.to_owned());
                }
            }
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters() -> Parameters {
        let given = [("rate".to_owned(), 50.into()), ("misspelt".to_owned(), true.into())];
        let parameters = Parameters::new(given.into());
        let limits = ParameterDescriptor::new("frames per second (Hz)").float_range(1.0, 1000.0);
        parameters.declare("rate", 100.0, limits).unwrap();
        parameters.declare("filter.cutoff", 20.0, ParameterDescriptor::new("Hz")).unwrap();
        parameters.declare("skin", "palm.toml", ParameterDescriptor::new("file").read_only()).unwrap();
        parameters
    }

    #[test]
    fn overrides_win_over_defaults() {
        let parameters = parameters();
        assert_eq!(parameters.get("rate"), Some(ParameterValue::Double(50.0)));
        assert_eq!(parameters.unused_overrides(), ["misspelt"]);
    }

    #[test]
    fn refusals_say_why() {
        let parameters = parameters();
        parameters.on_set(|changes| {
            if changes.iter().any(|(_, value)| *value == ParameterValue::Double(13.0)) {
                Err("13 Hz is unlucky".to_owned())
            } else {
                Ok(())
            }
        });
        let set = |name: &str, value: ParameterValue| parameters.set(name, value).unwrap_err();
        insta::assert_snapshot!(set("rate", 0.0.into()), @"parameter `rate`: 0.0 is outside of 1.0 to 1000.0");
        insta::assert_snapshot!(set("rate", f64::NAN.into()), @"parameter `rate`: NaN is outside of 1.0 to 1000.0");
        insta::assert_snapshot!(set("rate", 3.into()), @"parameter `rate`: its type is double, not integer");
        insta::assert_snapshot!(set("skin", "x".into()), @"parameter `skin`: it is read-only: give it when the node starts");
        insta::assert_snapshot!(set("gain", 3.into()), @"parameter `gain`: it is not declared by this node");
        insta::assert_snapshot!(set("rate", 13.0.into()), @"parameter `rate`: 13 Hz is unlucky");
        assert_eq!(parameters.get("rate"), Some(ParameterValue::Double(50.0)));
        let odd = Parameters::new([("rate".to_owned(), "fast".into())].into());
        insta::assert_snapshot!(
            odd.declare("rate", 1.0, ParameterDescriptor::default()).unwrap_err(),
            @r#"parameter `rate`: its type is double, but the value given at start is the string "fast""#
        );
    }

    #[test]
    fn several_are_set_all_or_none() {
        let parameters = parameters();
        let changes = [("rate".to_owned(), 60.0.into()), ("skin".to_owned(), "x".into())];
        assert!(parameters.set_all(&changes).is_err());
        assert_eq!(parameters.get("rate"), Some(ParameterValue::Double(50.0)));
    }

    #[test]
    fn watchers_see_what_changed() {
        let parameters = parameters();
        let seen: Arc<Mutex<Vec<String>>> = Arc::default();
        let log = Arc::clone(&seen);
        parameters.on_changed(move |name, value| lock(&log).push(format!("{name}={value}")));
        parameters.set("rate", 60.0).unwrap();
        assert!(parameters.set("rate", -1.0).is_err());
        assert_eq!(*lock(&seen), ["rate=60.0"]);
    }

    #[test]
    fn lists_follow_prefix_and_depth() {
        let parameters = parameters();
        assert_eq!(parameters.list(&[], 0).names, ["filter.cutoff", "rate", "skin"]);
        assert_eq!(parameters.list(&[], 1).names, ["rate", "skin"]);
        let below = parameters.list(&["filter".to_owned()], 1);
        assert_eq!(below.names, ["filter.cutoff"]);
        assert_eq!(below.prefixes, ["filter"]);
    }

    #[test]
    fn values_survive_the_wire_form() {
        let values = [
            ParameterValue::NotSet,
            true.into(),
            (-3i64).into(),
            2.5.into(),
            "text".into(),
            ParameterValue::ByteArray(vec![1, 255]),
            vec![true, false].into(),
            vec![1i64, 2].into(),
            vec![0.5, 1.5].into(),
            vec!["a".to_owned()].into(),
        ];
        for value in values {
            assert_eq!(ParameterValue::from_msg(value.to_msg()), Some(value));
        }
        assert_eq!(ParameterValue::from_msg(ValueMsg { r#type: 77, ..ValueMsg::default() }), None);
    }

    #[test]
    fn text_becomes_the_value_that_was_meant() {
        for (text, value) in [
            ("true", true.into()),
            ("3", 3.into()),
            ("0.5", 0.5.into()),
            ("\"3\"", "3".into()),
            ("palm", "palm".into()),
            ("[1, 2.5]", vec![1.0, 2.5].into()),
        ] {
            assert_eq!(ParameterValue::parse(text), value);
        }
    }
}
