//! Figures that an evaluation has to reach.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Evaluation;
use crate::LearnError;

/// A figure that an evaluation has to reach, e.g. `position_rms<=0.0005` (SI units).
#[derive(Debug, Clone, PartialEq)]
pub struct Requirement {
    figure: String,
    at_least: bool,
    bound: f64,
}

/// What an evaluation says to a requirement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The requirement.
    pub requirement: String,
    /// The measured figure; absent where the evaluation has none of this name, which counts as failed.
    pub value: Option<f64>,
    /// Whether it is met.
    pub met: bool,
}

/// What an evaluation says to all requirements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Verdicts(Vec<Verdict>);

impl Verdicts {
    /// Holds every requirement against an evaluation.
    #[must_use]
    pub fn of(requirements: &[Requirement], evaluation: &Evaluation) -> Self {
        Self(requirements.iter().map(|r| r.check(evaluation)).collect())
    }

    /// Whether all are met.
    ///
    /// # Errors
    ///
    /// [`LearnError::Missed`] counts those that are not.
    pub fn require(&self) -> Result<(), LearnError> {
        match self.0.iter().filter(|v| !v.met).count() {
            0 => Ok(()),
            missed => Err(LearnError::Missed { missed, of: self.0.len() }),
        }
    }
}

impl fmt::Display for Verdicts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|verdict| writeln!(f, "{verdict}"))
    }
}

impl std::str::FromStr for Requirement {
    type Err = LearnError;

    fn from_str(text: &str) -> Result<Self, LearnError> {
        let wrong = |reason: String| LearnError::Requirement { text: text.to_owned(), reason };
        let (figure, at_least, bound) = if let Some((figure, bound)) = text.split_once("<=") {
            (figure, false, bound)
        } else if let Some((figure, bound)) = text.split_once(">=") {
            (figure, true, bound)
        } else {
            return Err(wrong("needs `<=` or `>=`, as in `position_rms<=0.0005`".into()));
        };
        let bound = bound.trim();
        let bound: f64 =
            bound.parse().map_err(|_| wrong(format!("`{bound}` is not a number in SI units")))?;
        if !bound.is_finite() || figure.trim().is_empty() {
            return Err(wrong("needs the name of a figure and a finite number".into()));
        }
        Ok(Self { figure: figure.trim().to_owned(), at_least, bound })
    }
}

impl fmt::Display for Requirement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}{}", self.figure, if self.at_least { ">=" } else { "<=" }, self.bound)
    }
}

impl Requirement {
    /// Holds it against an evaluation.
    #[must_use]
    pub fn check(&self, evaluation: &Evaluation) -> Verdict {
        let value = evaluation.figures().get(&self.figure).copied();
        let met = value.is_some_and(|v| if self.at_least { v >= self.bound } else { v <= self.bound });
        Verdict { requirement: self.to_string(), value, met }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = if self.met { "met" } else { "MISSED" };
        match self.value {
            Some(value) => write!(f, "{mark}: {} (measured {value:.6})", self.requirement),
            None => write!(f, "{mark}: {} (no such figure here)", self.requirement),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requirements_are_read_strictly() {
        let message = |text: &str| text.parse::<Requirement>().unwrap_err().to_string();
        insta::assert_snapshot!(message("position_rms<0.1"), @"requirement `position_rms<0.1`: needs `<=` or `>=`, as in `position_rms<=0.0005`");
        insta::assert_snapshot!(message("position_rms<=0.5mm"), @"requirement `position_rms<=0.5mm`: `0.5mm` is not a number in SI units");
    }
}
