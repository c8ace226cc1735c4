//! Numbers of which a file may name one or several.

use serde::{Deserialize, Serialize};

/// A number, or two of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, or two of them in brackets")]
pub(super) enum OneOrTwo {
    One(f64),
    Two([f64; 2]),
}

impl OneOrTwo {
    pub(super) fn both(self) -> [f64; 2] {
        match self {
            Self::One(value) => [value, value],
            Self::Two(values) => values,
        }
    }
}

impl From<[f64; 2]> for OneOrTwo {
    fn from([a, b]: [f64; 2]) -> Self {
        if a == b { Self::One(a) } else { Self::Two([a, b]) }
    }
}

/// A number, or some of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, or some of them in brackets")]
pub(super) enum OneOrMore {
    One(f64),
    More(Vec<f64>),
}

impl OneOrMore {
    pub(super) fn all(self) -> Vec<f64> {
        match self {
            Self::One(value) => vec![value],
            Self::More(values) => values,
        }
    }

    pub(super) fn of(values: Vec<f64>) -> Option<Self> {
        match values[..] {
            [] => None,
            [value] => Some(Self::One(value)),
            _ => Some(Self::More(values)),
        }
    }
}
