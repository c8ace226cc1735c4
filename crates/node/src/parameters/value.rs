//! Values of parameters, as texts, JSON and messages.

use std::fmt;

use dermis_msgs::rcl_interfaces::msg::{ParameterType as T, ParameterValue as ValueMsg};

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

    pub(super) fn type_id(&self) -> u8 {
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
    pub(super) fn widened_to(self, declared: &Self) -> Self {
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
