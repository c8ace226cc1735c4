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
        let mut ticks = ticks(low, high, log);
        // Values that floating point hardly tells apart would have the same label.
        let labels = Labels::of(&ticks, log);
        let mut last = f64::NEG_INFINITY;
        ticks.retain(|tick| {
            let read = labels.label(*tick).parse().unwrap_or(f64::NAN);
            let kept = f64::is_finite(read) && read > last;
            last = if kept { read } else { last };
            kept
        });
        Self { low, high, ticks }
    }

    /// What stands beside the ticks.
    pub(crate) fn labels(&self, log: bool) -> Labels {
        Labels::of(&self.ticks, log)
    }

    pub(crate) fn ticks(&self) -> &[f64] {
        &self.ticks
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

/// A number with three digits that say something; a power of ten where it would have many zeros; in words where it is not finite.
#[must_use]
pub fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0" } else { "not determined" }.to_owned();
    }
    let long = !FIXED.contains(&magnitude(value));
    let step = 10f64.powi(magnitude(value) - 2);
    // Whole numbers that are written out are whole.
    number(value, if long { step } else { step.min(1.0) }, long)
}

/// Powers of ten of numbers that are written out.
const FIXED: std::ops::Range<i32> = -4..6;

fn magnitude(value: f64) -> i32 {
    // A power of ten is not below itself by rounding.
    (value.abs().log10() + 1e-9).floor() as i32
}

/// A number to the digit of `step`, without zeros that say nothing.
fn number(value: f64, step: f64, power_of_ten: bool) -> String {
    let trimmed = |text: String| {
        let short = text.trim_end_matches('0').trim_end_matches('.').to_owned();
        if text.contains('.') { short } else { text }
    };
    let last = if step > 0.0 { magnitude(step) } else { 0 };
    if !power_of_ten {
        let text = trimmed(format!("{value:.*}", (-last).max(0) as usize));
        return if text == "-0" { "0".to_owned() } else { text };
    }
    if step > 0.0 && (value / step).round() == 0.0 {
        return "0".to_owned();
    }
    let digits = (magnitude(value) - last).clamp(0, 15) as usize;
    let text = format!("{value:.digits$e}");
    text.split_once('e')
        .map_or_else(|| text.clone(), |(factor, power)| format!("{}e{power}", trimmed(factor.to_owned())))
}

/// Labels of ticks: with as many digits as tell them apart, and powers of ten where all would be long.
pub(crate) struct Labels {
    /// Least difference of two neighbours, as a share of the larger one on a logarithmic axis.
    step: f64,
    power_of_ten: bool,
    log: bool,
}

impl Labels {
    pub(crate) fn of(ticks: &[f64], log: bool) -> Self {
        let shown: Vec<f64> = ticks.iter().map(|t| if log { 10f64.powf(*t) } else { *t }).collect();
        let largest = shown.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let apart = |w: &[f64]| (w[1] - w[0]).abs() / if log { w[1] } else { 1.0 };
        let step = shown.windows(2).map(apart).fold(f64::INFINITY, f64::min);
        // A single tick shows three digits.
        let alone = || {
            if log {
                1e-2
            } else if largest > 0.0 {
                10f64.powi(magnitude(largest) - 2)
            } else {
                0.0
            }
        };
        let step = if step.is_finite() { step } else { alone() };
        let power_of_ten =
            largest > 0.0 && (!FIXED.contains(&magnitude(largest)) || magnitude(step) < FIXED.start);
        Self { step, power_of_ten, log }
    }

    pub(crate) fn label(&self, tick: f64) -> String {
        if !self.log {
            return number(tick, self.step, self.power_of_ten);
        }
        let value = 10f64.powf(tick);
        let two_digits = 10f64.powi(magnitude(value) - 1);
        number(value, two_digits.min(self.step * value), !FIXED.contains(&magnitude(value)))
    }
}

/// Round numbers between two locations of an axis.
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
        // Not more than some eight, in whole steps of decades.
        let step = ((span / 8.0).ceil() as i32).max(1);
        let decades = low.floor() as i32..=high.ceil() as i32;
        let found: Vec<f64> = decades
            .filter(|d| d % step == 0)
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

/// From the least to the largest of values that can be shown, with some room; `None` where there are none.
pub(crate) fn range(
    values: impl Iterator<Item = f64>,
    given: Option<(f64, f64)>,
    log: bool,
) -> Option<(f64, f64)> {
    if let Some((low, high)) = given {
        return Some((place(low, log), place(high, log)));
    }
    let shown = values.map(|v| place(v, log)).filter(|v| v.is_finite());
    let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if !(low.is_finite() && high.is_finite()) {
        return None;
    }
    let size = low.abs().max(high.abs());
    let room = ((high - low) * 0.04).max(if size > 0.0 { size * 1e-3 } else { 1.0 });
    // A quantity that cannot be negative starts at 0 where that is near.
    let low = if !log && low >= 0.0 && low < 0.3 * high { 0.0 } else { low - room };
    Some((low, high + room))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn labels(low: f64, high: f64, log: bool) -> Vec<String> {
        let axis = Scaled::new(low, high, log);
        let of = axis.labels(log);
        axis.ticks.iter().map(|t| of.label(*t)).collect()
    }

    #[test]
    fn ticks_are_short() {
        assert_eq!(
            [short(0.0), short(0.05), short(12.0), short(1234.5), short(-0.001), short(1.0)],
            ["0", "0.05", "12", "1234", "-0.001", "1"]
        );
        assert_eq!(
            [short(2.345e-7), short(-4e9), short(f64::INFINITY)],
            ["2.34e-7", "-4e9", "not determined"]
        );
        assert_eq!(ticks(0.0, 1.04, false), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(labels(0.0, 1.04, false), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        assert_eq!(labels(-1.1, 1.2, true), ["0.1", "0.2", "0.5", "1", "2", "5", "10"]);
        assert_eq!(labels(-2.0, 2.5, true), ["0.01", "0.1", "1", "10", "100"]);
    }

    #[test]
    fn small_large_and_narrow_axes_have_labels_that_differ() {
        assert_eq!(labels(-2e-8, 6e-8, false), ["-2e-8", "0", "2e-8", "4e-8", "6e-8"]);
        assert_eq!(labels(1234.5, 1234.9, false), ["1234.5", "1234.6", "1234.7", "1234.8", "1234.9"]);
        assert_eq!(labels(0.0, 2e7, false), ["0", "5e6", "1e7", "1.5e7", "2e7"]);
        // A bound of nothing beside one of a metre.
        assert_eq!(
            labels(-14.3, 0.2, true),
            ["1e-14", "1e-12", "1e-10", "1e-8", "1e-6", "0.0001", "0.01", "1"]
        );
        assert_eq!(labels(-7.0, -4.0, true), ["1e-7", "3e-7", "1e-6", "3e-6", "1e-5", "3e-5", "0.0001"]);
    }

    #[test]
    fn nothing_has_no_range_and_one_value_has_one() {
        assert_eq!(range([f64::NAN, f64::INFINITY].into_iter(), None, false), None);
        for value in [0.0, 3e-15, -2.0, 1e12] {
            let (low, high) = range([value].into_iter(), None, false).unwrap();
            assert!(low <= value && value <= high && low < high, "{value}: {low} to {high}");
        }
    }

    proptest! {
        #[test]
        fn labels_of_an_axis_differ_and_rise(middle in -3.0..3.0f64, span in 1e-3..2.0f64, power in -15..15i32) {
            let unit = 10f64.powi(power);
            let all = labels((middle - span) * unit, (middle + span) * unit, false);
            prop_assert!(all.len() > 1, "{all:?}");
            let read: Vec<f64> = all.iter().map(|l| l.parse().unwrap()).collect();
            prop_assert!(read.windows(2).all(|w| w[0] < w[1]), "{all:?}");
            prop_assert!(all.iter().all(|l| l != "-0" && l.len() < 12), "{all:?}");
        }

        #[test]
        fn labels_of_any_finite_range_differ_and_rise(ends in any::<(f64, f64)>()) {
            let (low, high) = (ends.0.min(ends.1), ends.0.max(ends.1));
            prop_assume!(low.is_finite() && high.is_finite());
            let all = labels(low, high, false);
            let read: Vec<f64> = all.iter().map(|l| l.parse().unwrap()).collect();
            prop_assert!(read.iter().all(|v| v.is_finite()) && read.windows(2).all(|w| w[0] < w[1]), "{all:?}");
            prop_assert!(all.iter().all(|l| l != "-0"), "{all:?}");
            // Of a range that is a part of its values, and not of the ends of what a number holds.
            let size = low.abs().max(high.abs());
            if high - low > 1e-3 * size && (1e-290..1e300).contains(&size) {
                prop_assert!(all.len() > 1 && all.len() < 12, "{low} to {high}: {all:?}");
                prop_assert!(all.iter().all(|l| l.len() < 14), "{all:?}");
            }
        }

        #[test]
        fn short_numbers_can_be_read(value in any::<f64>()) {
            let text = short(value);
            let read = text.parse::<f64>().ok();
            prop_assert_eq!(read.is_some(), value.is_finite(), "{}", text);
            if let Some(read) = read.filter(|_| value.abs() > 1e-290) {
                prop_assert!((read / value - 1.0).abs() < 6e-3, "{value}: {text}");
            }
        }

        #[test]
        fn labels_of_a_logarithmic_axis_differ_and_rise(low in -300.0..280.0f64, span in 0.05..20.0f64) {
            let all = labels(low, low + span, true);
            prop_assert!(all.len() < 16 && all.iter().all(|l| l.len() < 12), "{all:?}");
            let read: Vec<f64> = all.iter().map(|l| l.parse().unwrap()).collect();
            prop_assert!(read.windows(2).all(|w| w[0] < w[1]), "{all:?}");
        }
    }
}
