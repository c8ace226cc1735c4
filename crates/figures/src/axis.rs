//! Axes: where a value is drawn, and which values get a tick.

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint};
use plotters::prelude::*;

/// An axis that knows its ticks.
#[derive(Clone)]
pub(crate) struct Scaled {
    low: f64,
    high: f64,
    ticks: Vec<f64>,
}

impl Scaled {
    pub(crate) fn new(low: f64, high: f64, log: bool) -> Self {
        Self { low, high, ticks: ticks(low, high, log) }
    }

    /// An axis with these ticks.
    pub(crate) fn at(low: f64, high: f64, ticks: Vec<f64>) -> Self {
        Self { low, high, ticks }
    }
}

impl Ranged for Scaled {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.low) / (self.high - self.low);
        limit.0 + (f64::from(limit.1 - limit.0) * share).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _hint: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.low..self.high
    }
}

/// Value → where it is drawn: its logarithm on a logarithmic axis.
pub(crate) fn place(value: f64, log: bool) -> f64 {
    if log { value.log10() } else { value }
}

/// A number as a tick shows it: three digits that say something.
#[must_use]
pub fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Round numbers between two places of an axis.
pub(crate) fn ticks(low: f64, high: f64, log: bool) -> Vec<f64> {
    let round = |step: f64| -> Vec<f64> {
        let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
        (first..=last).map(|i| i as f64 * step).collect()
    };
    let span = high - low;
    if !(span.is_finite() && span > 0.0) {
        return vec![low];
    }
    if log {
        let parts: &[f64] = match span {
            s if s < 1.2 => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
            s if s < 2.5 => &[1.0, 2.0, 5.0],
            s if s < 4.5 => &[1.0, 3.0],
            _ => &[1.0],
        };
        let decades = low.floor() as i32..=high.ceil() as i32;
        let found: Vec<f64> = decades
            .flat_map(|d| parts.iter().map(move |p| f64::from(d) + p.log10()))
            .filter(|v| (low..=high).contains(v))
            .collect();
        // Within less than a half of a decade even steps say more.
        if span > 0.35 && found.len() > 2 {
            return found;
        }
        let (from, to) = (10f64.powf(low), 10f64.powf(high));
        return ticks(from, to, false).into_iter().filter(|v| *v > 0.0).map(f64::log10).collect();
    }
    let rough = 10f64.powf((span / 6.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * rough).find(|s| span / s <= 7.5);
    round(step.unwrap_or(span))
}

pub(crate) fn tick(value: f64, log: bool) -> String {
    if log && value < -3.9 {
        format!("{:.0e}", 10f64.powf(value))
    } else if log {
        let shown = 10f64.powf(value);
        let digits = (1 - shown.log10().floor() as i32).clamp(0, 9) as usize;
        let text = format!("{shown:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    } else if value.abs() < 1e-12 {
        "0".to_owned()
    } else {
        short(value)
    }
}

/// A value beside a linear axis.
pub(crate) fn tick_text(value: f64) -> String {
    tick(value, false)
}

/// From the least to the largest of values that can be shown, with some room.
pub(crate) fn range(values: impl Iterator<Item = f64>, given: Option<(f64, f64)>, log: bool) -> (f64, f64) {
    if let Some((low, high)) = given {
        return (place(low, log), place(high, log));
    }
    let shown = values.map(|v| place(v, log)).filter(|v| v.is_finite());
    let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if !(low.is_finite() && high.is_finite()) {
        return (0.0, 1.0);
    }
    let room = ((high - low) * 0.04).max(high.abs().max(1e-9) * 1e-3);
    // A quantity that cannot be negative starts at 0 where that is near.
    let low = if !log && low >= 0.0 && low < 0.3 * high { 0.0 } else { low - room };
    (low, high + room)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_short() {
        let of = |v: f64| tick(v, false);
        assert_eq!([of(0.0), of(0.05), of(12.0), of(1234.5)], ["0", "0.05", "12", "1234"]);
        assert_eq!(ticks(0.0, 1.04, false), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        let log: Vec<String> = ticks(-1.1, 1.2, true).iter().map(|v| tick(*v, true)).collect();
        assert_eq!(log, ["0.1", "0.2", "0.5", "1", "2", "5", "10"]);
        assert_eq!([tick(-2.0, true), tick(2.0, true), tick(-1.5, true)], ["0.01", "100", "0.032"]);
    }
}
