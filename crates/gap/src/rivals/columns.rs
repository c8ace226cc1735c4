//! Columns of the shapes: the signal of the nominal model times a few functions of what was recorded.

use std::collections::BTreeMap;

use super::{Made, Shape};
use crate::algebra::components;
use crate::constants::location::FORCE;
use crate::constants::rivals::{
    AMOUNT, DISTINCT, FADE, FIRST_SINCE, HELD, PATCH_END, PATCHES, PATTERNS, PLACES_A_PATCH, POWERS, SPEED,
    WIDE, WIDTH, ZERO_KNOTS,
};
use crate::samples::{Sample, Samples};
use crate::statistics::Column;

/// Columns of a shape; `signals` are those of the nominal model, samples × channels.
pub(crate) fn of(shape: Shape, samples: &Samples, signals: &[f32], channels: usize) -> Made {
    let locations = Locations::of(samples);
    let list = &samples.list;
    let each = |functions: &[Vec<f64>]| Made {
        columns: of_channels(signals, channels, functions),
        locations: Vec::new(),
    };
    match shape {
        Shape::Field => each(&smooth(&locations, list)),
        Shape::ForceCurve => each(&powers(list)),
        Shape::Mixing => Made { columns: mixing(list.len(), signals, channels), locations: Vec::new() },
        Shape::Lag => Made { columns: lag(list, signals, channels), locations: Vec::new() },
        Shape::Zero => Made { columns: zeros(samples, channels), locations: Vec::new() },
        Shape::Place => {
            let (functions, centres) = patches(&locations, samples);
            let columns = functions.iter().map(|f| of_all(signals, channels, f)).collect();
            Made { columns, locations: centres }
        }
    }
}

/// A column for each channel and function: the signal times the function.
pub(super) fn of_channels(signals: &[f32], channels: usize, functions: &[Vec<f64>]) -> Vec<Column> {
    let column = |k: usize, function: &Vec<f64>| {
        let own = signals.iter().skip(k).step_by(channels);
        let values = own.zip(function).map(|(s, f)| (AMOUNT * f64::from(*s) * f) as f32).collect();
        Column { channel: Some(k), values }
    };
    (0..channels).flat_map(|k| functions.iter().map(move |f| column(k, f))).collect()
}

/// One column for all channels.
pub(super) fn of_all(signals: &[f32], channels: usize, function: &[f64]) -> Column {
    let value = |(i, s): (usize, &f32)| (AMOUNT * f64::from(*s) * function[i / channels]) as f32;
    Column { channel: None, values: signals.iter().enumerate().map(value).collect() }
}

/// Locations of contact along the axes in which they differ, each from −1 to 1.
pub(super) struct Locations {
    middle: [f64; 3],
    half: [f64; 3],
    wide: Vec<usize>,
}

impl Locations {
    pub fn of(samples: &Samples) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for s in samples.list.iter().filter(|s| s.position[0].is_finite()) {
            for a in 0..3 {
                (low[a], high[a]) = (low[a].min(s.position[a]), high[a].max(s.position[a]));
            }
        }
        let half: [f64; 3] = std::array::from_fn(|a| 0.5 * (high[a] - low[a]));
        let most = half.iter().copied().fold(0.0, f64::max);
        // A millimetre in a decimetre is no axis of its own.
        let wide = (0..3).filter(|a| half[*a] > WIDE[0] && half[*a] > WIDE[1] * most).collect();
        Self { middle: std::array::from_fn(|a| 0.5 * (low[a] + high[a])), half, wide }
    }

    fn at(&self, sample: &Sample) -> Option<Vec<f64>> {
        let of = |&a: &usize| (sample.position[a] - self.middle[a]) / self.half[a];
        sample.position[0].is_finite().then(|| self.wide.iter().map(of).collect())
    }
}

/// Share of the largest force of each sample.
fn forces(list: &[Sample]) -> Vec<f64> {
    let most = list.iter().map(|s| s.force).filter(|f| f.is_finite()).fold(1e-9, f64::max);
    list.iter().map(|s| if s.force.is_finite() { s.force / most } else { 0.0 }).collect()
}

/// Polynomials of the place to the second degree (to the third along one axis), and those of the first times the force.
pub(super) fn smooth(locations: &Locations, list: &[Sample]) -> Vec<Vec<f64>> {
    let at: Vec<Option<Vec<f64>>> = list.iter().map(|s| locations.at(s)).collect();
    let forces = forces(list);
    let d = locations.wide.len();
    let mut found = vec![vec![1.0; list.len()], forces.clone()];
    let mut add = |f: &dyn Fn(&[f64], f64) -> f64| {
        let value = |(at, force): (&Option<Vec<f64>>, &f64)| at.as_ref().map_or(0.0, |x| f(x, *force));
        found.push(at.iter().zip(&forces).map(value).collect());
    };
    for a in 0..d {
        add(&|x, _| x[a]);
        add(&|x, force| x[a] * force);
        for b in a..d {
            add(&|x, _| x[a] * x[b]);
        }
    }
    if d == 1 {
        add(&|x, _| x[0].powi(3));
    }
    found
}

/// Powers of the force.
fn powers(list: &[Sample]) -> Vec<Vec<f64>> {
    let forces = forces(list);
    (0..POWERS).map(|p| forces.iter().map(|f| f.powi(p)).collect()).collect()
}

/// For each channel the courses that all channels have most in common.
fn mixing(count: usize, signals: &[f32], channels: usize) -> Vec<Column> {
    let own: Vec<Vec<f32>> =
        (0..channels).map(|k| signals.iter().skip(k).step_by(channels).copied().collect()).collect();
    let (courses, _) = components(&own, HELD, PATTERNS.min(channels.saturating_sub(1)));
    let mut found = Vec::new();
    for k in 0..channels {
        for course in &courses {
            let values = course.iter().take(count).map(|v| (AMOUNT * f64::from(*v)) as f32).collect();
            found.push(Column { channel: Some(k), values });
        }
    }
    found
}

/// What goes with the course of a press: loading, unloading, how long it lasts, and what is left after it.
fn lag(list: &[Sample], signals: &[f32], channels: usize) -> Vec<Column> {
    use dermis_skin::Phase::{Load, Unload};
    let touched = |s: &Sample| s.phase.touched();
    let when = |s: &Sample, yes: bool| f64::from(u8::from(yes && touched(s)));
    let functions: Vec<Vec<f64>> = vec![
        vec![1.0; list.len()],
        list.iter().map(|s| when(s, s.phase == Load)).collect(),
        list.iter().map(|s| when(s, s.phase == Unload)).collect(),
        list.iter().map(|s| when(s, true) * s.since.max(FIRST_SINCE).ln()).collect(),
        list.iter()
            .map(|s| when(s, true) * (s.speed / s.force.max(FORCE) / SPEED).clamp(-1.0, 1.0))
            .collect(),
    ];
    let functions: Vec<Vec<f64>> = functions
        .into_iter()
        .map(|f| f.into_iter().map(|v| if v.is_finite() { v } else { 0.0 }).collect())
        .collect();
    let mut found = of_channels(signals, channels, &functions);
    // What a press leaves behind goes with the largest signal of it.
    let mut peaks: BTreeMap<usize, Vec<f32>> = BTreeMap::new();
    for (s, row) in list.iter().zip(signals.chunks_exact(channels)).filter(|(s, _)| s.press != usize::MAX) {
        let peak = peaks.entry(s.press).or_insert_with(|| vec![0.0; channels]);
        peak.iter_mut().zip(row).filter(|(p, v)| v.abs() > p.abs()).for_each(|(p, v)| *p = *v);
    }
    for k in 0..channels {
        for fades in [false, true] {
            let value = |s: &Sample| {
                let peak = peaks.get(&s.press).map_or(0.0, |p| f64::from(p[k]));
                let fade = if fades { (-s.since.max(0.0) / FADE).exp() } else { 1.0 };
                if touched(s) || !s.since.is_finite() { 0.0 } else { (AMOUNT * peak * fade) as f32 }
            };
            found.push(Column { channel: Some(k), values: list.iter().map(value).collect() });
        }
    }
    found
}

/// A piecewise linear zero of each channel through each session.
fn zeros(samples: &Samples, channels: usize) -> Vec<Column> {
    let list = &samples.list;
    let mut sessions: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
    for s in list {
        let span = sessions.entry(s.session).or_insert([f64::INFINITY, f64::NEG_INFINITY]);
        *span = [span[0].min(s.time), span[1].max(s.time)];
    }
    let mut hats: Vec<Vec<f64>> = Vec::new();
    for (session, [begin, end]) in sessions {
        let step = ((end - begin) / (ZERO_KNOTS - 1) as f64).max(1e-9);
        for knot in 0..ZERO_KNOTS {
            let at = begin + knot as f64 * step;
            let hat = |s: &Sample| {
                let near = (1.0 - ((s.time - at) / step).abs()).max(0.0);
                if s.session == session { near } else { 0.0 }
            };
            hats.push(list.iter().map(hat).collect());
        }
    }
    let column = |k: usize, hat: &Vec<f64>| Column {
        channel: Some(k),
        values: hat.iter().map(|h| *h as f32).collect(),
    };
    (0..channels).flat_map(|k| hats.iter().map(move |hat| column(k, hat))).collect()
}

/// Bumps over the locations of contact, and their middles \[m\]: each as wide as its middle is from the nearest other one.
pub(super) fn patches(locations: &Locations, samples: &Samples) -> (Vec<Vec<f64>>, Vec<[f64; 3]>) {
    let at: Vec<Option<Vec<f64>>> = samples.list.iter().map(|s| locations.at(s)).collect();
    let known: Vec<usize> = (0..at.len()).filter(|i| at[*i].is_some()).collect();
    let count = (samples.groups / PLACES_A_PATCH).clamp(1, PATCHES);
    let Some(&first) = known.first().filter(|_| !locations.wide.is_empty()) else {
        return (Vec::new(), Vec::new());
    };
    let away = |i: usize, j: usize| -> f64 {
        let (Some(a), Some(b)) = (&at[i], &at[j]) else { return f64::INFINITY };
        // In metres, so that a patch is as wide along all axes.
        let apart = a
            .iter()
            .zip(b)
            .zip(&locations.wide)
            .map(|((a, b), axis)| ((a - b) * locations.half[*axis]).powi(2));
        apart.sum::<f64>().sqrt()
    };
    // Each next middle is the place that is farthest from all others (Gonzalez 1985).
    let mut middles = vec![first];
    let mut nearest: Vec<f64> = known.iter().map(|i| away(*i, first)).collect();
    let mut width = f64::INFINITY;
    while middles.len() < count {
        let Some((far, next)) = nearest.iter().zip(&known).max_by(|a, b| a.0.total_cmp(b.0)) else { break };
        if *far < DISTINCT {
            break;
        }
        (width, middles) = (*far, middles.into_iter().chain([*next]).collect());
        let last = middles[middles.len() - 1];
        nearest.iter_mut().zip(&known).for_each(|(n, i)| *n = n.min(away(*i, last)));
    }
    if !width.is_finite() {
        return (Vec::new(), Vec::new());
    }
    let bump = |middle: usize| -> Vec<f64> {
        (0..at.len())
            .map(|i| {
                let far = away(i, middle) / (WIDTH * width);
                if far < PATCH_END { (-0.5 * far * far).exp() } else { 0.0 }
            })
            .collect()
    };
    (middles.iter().map(|m| bump(*m)).collect(), middles.iter().map(|m| samples.list[*m].position).collect())
}
