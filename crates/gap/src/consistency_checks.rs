//! Checks of readings that need no model, or next to none: each isolates a kind of cause.

use dermis_skin::Phase;
use serde::{Deserialize, Serialize};

use crate::axes::View;
use crate::constants::consistency::{ALIKE, COMPARED, DEVIATIONS, FACTOR, TOGETHER};
use crate::constants::noise::SAME_PLACE;

/// One check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyCheck {
    /// Name.
    pub check: String,
    /// What it compares, for people.
    pub what: String,
    /// Violation, in deviations of a channel's noise (root mean square); `None` where the recording has nothing to compare.
    pub violation: Option<f64>,
    /// Violation as a share of the signal.
    pub share: Option<f64>,
    /// Pairs or frames that were compared.
    pub compared: usize,
    /// Whether it is beyond the noise.
    pub violated: bool,
}

/// All checks that hold for any skin.
#[must_use]
pub fn checks(view: &View<'_>, readings: &[f32]) -> Vec<ConsistencyCheck> {
    vec![
        return_to_zero(view, readings),
        common_mode(view, readings),
        homogeneity(view, readings),
        superposition(view),
    ]
}

fn row<'a>(values: &'a [f32], view: &View<'_>, i: usize) -> &'a [f32] {
    &values[i * view.channels..(i + 1) * view.channels]
}

fn check(check: &str, what: &str, square: f64, signal: f64, n: usize, noise: f64) -> ConsistencyCheck {
    let violation = (n > 0).then(|| square.sqrt());
    ConsistencyCheck {
        check: check.to_owned(),
        what: what.to_owned(),
        violation,
        share: (n > 0 && signal > 0.0).then(|| (square / signal).sqrt()),
        compared: n,
        violated: n >= COMPARED && square > noise * (1.0 + DEVIATIONS / (n as f64).sqrt()) * FACTOR,
    }
}

/// Untouched after a press against untouched before it.
fn return_to_zero(view: &View<'_>, readings: &[f32]) -> ConsistencyCheck {
    let samples = &view.samples.list;
    let (mut square, mut signal, mut n) = (0.0, 0.0, 0usize);
    let mut rest: Option<usize> = None;
    let mut strong: Option<usize> = None;
    let mut last = usize::MAX;
    let channels = view.sigma.iter().filter(|s| s.is_finite()).count().max(1) as f64;
    for (i, r) in samples.iter().enumerate() {
        // Samples without a press lie between presses.
        if r.press != last && r.phase.touched() {
            (last, strong) = (r.press, None);
        }
        if r.phase == Phase::Hold {
            strong = Some(i);
        }
        if !r.phase.touched() {
            if let (Some(before), Some(held)) = (rest, strong) {
                let (a, b) = (row(readings, view, before), row(readings, view, i));
                square += a.iter().zip(b).map(|(a, b)| f64::from(b - a).powi(2)).sum::<f64>() / channels;
                let h = row(readings, view, held);
                signal += h.iter().zip(a).map(|(h, a)| f64::from(h - a).powi(2)).sum::<f64>() / channels;
                n += 1;
                strong = None;
            }
            rest = Some(i);
        }
    }
    let mean = n.max(1) as f64;
    check(
        "return to zero",
        "untouched readings after a press against those before it",
        square / mean,
        signal / mean,
        n,
        2.0 * view.noise,
    )
}

/// All channels together where nothing touches.
fn common_mode(view: &View<'_>, readings: &[f32]) -> ConsistencyCheck {
    let usable: Vec<usize> = (0..view.channels).filter(|k| view.sigma[*k].is_finite()).collect();
    let untouched: Vec<usize> =
        (0..view.samples.list.len()).filter(|i| !view.samples.list[*i].phase.touched()).collect();
    let m = untouched.len();
    if m < COMPARED || usable.len() < 2 {
        return check("common mode", COMMON, 0.0, 0.0, 0, 1.0);
    }
    let mean: Vec<f64> = usable
        .iter()
        .map(|&k| untouched.iter().map(|i| f64::from(row(readings, view, *i)[k])).sum::<f64>() / m as f64)
        .collect();
    let n = usable.len() as f64;
    let mut together = 0.0;
    let mut all = 0.0;
    for &i in &untouched {
        let values: Vec<f64> =
            usable.iter().zip(&mean).map(|(&k, m)| f64::from(row(readings, view, i)[k]) - m).collect();
        let common = values.iter().sum::<f64>() / n;
        together += common * common;
        all += values.iter().map(|v| v * v).sum::<f64>() / n;
    }
    let (together, all) = (together / m as f64, all / m as f64);
    let mut found = check("common mode", COMMON, together, all, m, view.noise / n);
    found.violated = m >= COMPARED && together > TOGETHER * view.noise / n;
    found
}

const COMMON: &str = "what all channels have in common where nothing touches";

/// Residuals per force at one place: the same for all forces where the gap is linear.
fn homogeneity(view: &View<'_>, readings: &[f32]) -> ConsistencyCheck {
    let samples = &view.samples.list;
    let held: Vec<usize> = (0..samples.len())
        .filter(|i| samples[*i].phase == Phase::Hold && samples[*i].contacts == 1)
        .collect();
    let channels = view.sigma.iter().filter(|s| s.is_finite()).count().max(1) as f64;
    let (mut square, mut signal, mut n) = (0.0, 0.0, 0usize);
    for pair in held.windows(2) {
        let (a, b) = (&samples[pair[0]], &samples[pair[1]]);
        let near = a.position.iter().zip(b.position).all(|(x, y)| (x - y).abs() < SAME_PLACE);
        let ratio = a.force / b.force.max(1e-9);
        if a.location != b.location || !near || (ALIKE[0]..=ALIKE[1]).contains(&ratio) || b.force <= 0.0 {
            continue;
        }
        let (x, y) = (row(view.residual, view, pair[0]), row(view.residual, view, pair[1]));
        let scale = 1.0 / (1.0 + ratio * ratio);
        square += x.iter().zip(y).map(|(x, y)| (f64::from(*x) - ratio * f64::from(*y)).powi(2)).sum::<f64>()
            * scale
            / channels;
        signal += row(readings, view, pair[0]).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() * scale
            / channels;
        n += 1;
    }
    let mean = n.max(1) as f64;
    check(
        "homogeneity",
        "the gap at one place under two forces, scaled to one",
        square / mean,
        signal / mean,
        n,
        view.noise,
    )
}

/// The gap of several contacts at once against that of single ones.
fn superposition(view: &View<'_>) -> ConsistencyCheck {
    let samples = &view.samples.list;
    let channels = view.sigma.iter().filter(|s| s.is_finite()).count().max(1) as f64;
    let energy = |several: bool| {
        let (mut square, mut model, mut n) = (0.0, 0.0, 0usize);
        for (i, r) in
            samples.iter().enumerate().filter(|(_, r)| r.contacts > 0 && (r.contacts > 1) == several)
        {
            let _ = r;
            square +=
                row(view.residual, view, i).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / channels;
            model += row(view.model, view, i).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / channels;
            n += 1;
        }
        (square, model, n)
    };
    let ((one, of_one, singles), (more, of_more, n)) = (energy(false), energy(true));
    let what = "the gap of several contacts at once beyond that of single ones, per signal";
    if n < COMPARED || singles < COMPARED {
        return check("superposition", what, 0.0, 0.0, 0, 1.0);
    }
    // What is in both is no violation.
    let expected = one / of_one.max(1e-300) * of_more;
    let beyond = ((more - expected) / n as f64).max(0.0);
    let mut found = check("superposition", what, beyond, of_more / n as f64, n, view.noise);
    found.violated = more > FACTOR * expected && beyond > view.noise;
    found
}
