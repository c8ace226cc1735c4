//! Parameters of a node and the standard services that reach them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

use dermis_msgs::rcl_interfaces::msg::{
    FloatingPointRange, IntegerRange, ListParametersResult, Parameter as ParameterMsg,
    ParameterDescriptor as DescriptorMsg, ParameterEvent, ParameterValue as ValueMsg, SetParametersResult,
};

use crate::error::NodeError;
use crate::executor::lock;
pub use value::ParameterValue;

mod value;

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
mod tests;
