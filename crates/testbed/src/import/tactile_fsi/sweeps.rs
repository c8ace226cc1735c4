//! Presses in a time series of forces, and the sweeps along the line that they come in.

use super::{HELD, REST, SHORTEST, SWEEP, SWEEP_STEP, TOUCHED, WAY_BACK};

/// One press of a time series, in samples.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pressed {
    pub(super) begin: usize,
    pub(super) end: usize,
    /// First and last (exclusive) sample in which it is held.
    pub(super) held: [usize; 2],
    /// \[N\] that the load cell reads before it.
    pub(super) rest: f64,
    /// Which place of its sweep; `None` for presses outside of whole sweeps.
    pub(super) place: Option<usize>,
}

/// \[m\] from the middle of the line.
pub(super) fn line_place(place: usize) -> f64 {
    (place as f64 - (SWEEP as f64 - 1.0) / 2.0) * SWEEP_STEP
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The presses of a time series of forces \[N\], where these come in sweeps; none where most do not.
pub(super) fn sweeps(newtons: &[f64], rate: f64) -> Vec<Pressed> {
    let samples = |seconds: f64| (seconds * rate).round() as usize;
    let rest = median(newtons.to_vec());
    let wide = samples(0.04).max(1);
    let smooth = |i: usize| {
        let of = &newtons[i.saturating_sub(wide)..(i + wide + 1).min(newtons.len())];
        of.iter().sum::<f64>() / of.len() as f64
    };
    let mut spans: Vec<[usize; 2]> = Vec::new();
    for i in (0..newtons.len()).filter(|&i| smooth(i) - rest > TOUCHED) {
        match spans.last_mut() {
            Some(span) if i - span[1] < samples(REST) => span[1] = i + 1,
            _ => spans.push([i, i + 1]),
        }
    }
    spans.retain(|span| span[1] - span[0] > samples(SHORTEST));
    let mut found: Vec<Pressed> = spans
        .iter()
        .map(|&[begin, end]| {
            let before =
                newtons[begin.saturating_sub(samples(0.6))..begin.saturating_sub(samples(0.2))].to_vec();
            let rest = if before.is_empty() { rest } else { median(before) };
            let usual = median(newtons[begin..end].to_vec()) - rest;
            let strong = |i: &usize| newtons[*i] - rest >= HELD * usual;
            let first = (begin..end).find(strong).unwrap_or(begin);
            let last = (begin..end).rfind(strong).map_or(end, |i| i + 1);
            Pressed { begin, end, held: [first, last], rest, place: None }
        })
        .collect();
    let periods: Vec<f64> = found.windows(2).map(|p| (p[1].begin - p[0].begin) as f64 / rate).collect();
    let usual = median(periods.clone());
    let mut starts: Vec<usize> = periods
        .iter()
        .enumerate()
        .filter(|(_, p)| (WAY_BACK[0]..WAY_BACK[1]).contains(&(**p - usual)))
        .map(|(i, _)| i + 1)
        .collect();
    // The last sweep has no way back after it.
    starts.push(found.len());
    let mut placed = 0;
    for pair in starts.windows(2) {
        let last = pair[1] == found.len();
        if pair[1] - pair[0] == SWEEP || (last && pair[1] - pair[0] < SWEEP) {
            for (place, press) in found[pair[0]..pair[1]].iter_mut().enumerate() {
                press.place = Some(place);
                placed += 1;
            }
        }
    }
    if placed * 5 < found.len() * 4 || placed < 3 * SWEEP { Vec::new() } else { found }
}
