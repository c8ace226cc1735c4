//! Names and numbers of a rule file, within their bounds.

use std::time::Duration;

use super::{Wrong, wrong};

/// \[s\] longest time in a file: a day.
const LONGEST: f64 = 86_400.0;
/// \[s\] shortest period and timeout: below it a timer of the system means nothing.
const SHORTEST: f64 = 1e-4;

pub(super) fn name_of(name: &str, field: &str) -> Result<(), Wrong> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if name.is_empty() || !name.chars().all(fits) {
        return wrong(field, format!("\"{name}\" is no name: take letters, digits, `_` and `-`"));
    }
    Ok(())
}

pub(super) fn topic(topic: &str, field: &str) -> Result<(), Wrong> {
    if topic.is_empty() || topic.contains(char::is_whitespace) {
        return wrong(field, format!("\"{topic}\" is no name of a topic, service or action"));
    }
    Ok(())
}

pub(super) fn at_least_zero(value: f64, field: &str) -> Result<f64, Wrong> {
    within(Some(value), 0.0, (0.0, 1e9), field)
}

pub(super) fn positive(value: f64, field: &str) -> Result<f64, Wrong> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    wrong(field, format!("is {value} and must be larger than 0"))
}

pub(super) fn ratio(value: Option<f64>, usual: f64, field: &str) -> Result<f64, Wrong> {
    within(value, usual, (0.0, 1.0), field)
}

pub(super) fn within(
    value: Option<f64>,
    usual: f64,
    (low, high): (f64, f64),
    field: &str,
) -> Result<f64, Wrong> {
    let value = value.unwrap_or(usual);
    if value >= low && value <= high {
        return Ok(value);
    }
    wrong(field, format!("is {value} and must be between {low} and {high}"))
}

pub(super) fn time(seconds: f64, field: &str) -> Result<Duration, Wrong> {
    within(Some(seconds), 0.0, (0.0, LONGEST), field).map(Duration::from_secs_f64)
}

pub(super) fn positive_time(seconds: f64, field: &str) -> Result<Duration, Wrong> {
    within(Some(seconds), 0.0, (SHORTEST, LONGEST), field).map(Duration::from_secs_f64)
}
