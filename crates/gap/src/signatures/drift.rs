//! Random drifts: effects that go their own course through time, whatever touches.
//!
//! A course is piecewise linear between a few knots in each run. An effect drifts randomly where such courses hold what its
//! devices change, and the shape of one device's course does not predict another's.

use super::Realisation;
use crate::algebra::{cholesky_solve, components, direction, dot};
use crate::constants::signatures::{DRIFTS, FEW, KNOTS, ONE_COURSE, PAUSE, SMOOTH, WHOLE};
use crate::samples::Samples;
use crate::statistics::Column;

/// Hat functions over time: one value a sample each, and which stretch of time each belongs to.
struct Courses {
    hats: Vec<Vec<f32>>,
    stretches: Vec<usize>,
}

impl Courses {
    fn of(samples: &Samples) -> Self {
        let list = &samples.list;
        let n = list.len();
        let mut found = Self { hats: Vec::new(), stretches: Vec::new() };
        let mut start = 0;
        while start < n {
            // A pause, and another run, part it.
            let mut end = start + 1;
            while end < n
                && list[end].location.0 == list[start].location.0
                && (0.0..PAUSE).contains(&(list[end].time - list[end - 1].time))
            {
                end += 1;
            }
            let (first, last) = (list[start].time, list[end - 1].time);
            let knots = KNOTS.min((end - start) / 20 + 1);
            let apart = (last - first).max(1e-9) / knots as f64;
            for knot in 0..=knots {
                let mut values = vec![0.0f32; n];
                for (value, sample) in values[start..end].iter_mut().zip(&list[start..end]) {
                    let at = (sample.time - first) / apart;
                    *value = (1.0 - (at - knot as f64).abs()).max(0.0) as f32;
                }
                found.hats.push(values);
                found.stretches.push(start);
            }
            start = end;
        }
        found
    }

    /// Coefficients of what a device changes, a channel after another; `None` where courses do not hold it.
    fn project(&self, device: &[f32], channels: usize) -> Option<Vec<f64>> {
        let m = self.hats.len();
        let mut normal = vec![0.0; m * m];
        for i in 0..m {
            for j in 0..m {
                normal[i * m + j] = dot(&self.hats[i], &self.hats[j]);
            }
            normal[i * m + i] += 1e-6;
        }
        let n = device.len() / channels.max(1);
        let (mut held, mut all) = (0.0, 0.0);
        let mut own = Vec::new();
        for k in 0..channels {
            let values: Vec<f32> = (0..n).map(|i| device[i * channels + k]).collect();
            let b: Vec<f64> = self.hats.iter().map(|w| dot(w, &values)).collect();
            let mut x = b.clone();
            cholesky_solve(&mut normal.clone(), m, &mut x)?;
            held += x.iter().zip(&b).map(|(x, b)| x * b).sum::<f64>();
            all += dot(&values, &values);
            own.extend(x);
        }
        (held >= SMOOTH * all).then_some(own)
    }

    /// Takes the straight line out of each stretch: where a course starts and ends is no shape.
    fn straighten(&self, own: &mut [f64]) {
        for course in own.chunks_exact_mut(self.hats.len()) {
            let mut rest = course;
            for stretch in self.stretches.chunk_by(|a, b| a == b) {
                let (part, other) = rest.split_at_mut(stretch.len());
                straighten(part);
                rest = other;
            }
        }
    }
}

/// Takes the straight line from the first to the last value out.
fn straighten(values: &mut [f64]) {
    let (Some(&first), Some(&last)) = (values.first(), values.last()) else { return };
    let steps = (values.len() - 1).max(1) as f64;
    for (i, v) in values.iter_mut().enumerate() {
        *v -= first + (last - first) * i as f64 / steps;
    }
}

/// Whether the shape of each device's courses is what those of the others have in common.
fn predictable(along: &[Vec<f64>], m: usize) -> bool {
    let (mut seen, mut all) = (0.0, 0.0);
    for (d, own) in along.iter().enumerate() {
        let others = along.iter().enumerate().filter(|(o, _)| *o != d);
        let first = direction(others.flat_map(|(_, o)| o.chunks_exact(m)), m);
        for course in own.chunks_exact(m) {
            seen += first.iter().zip(course).map(|(c, w)| c * w).sum::<f64>().powi(2);
            all += course.iter().map(|w| w * w).sum::<f64>();
        }
    }
    seen > SMOOTH * all
}

/// The pattern over channels of an effect that drifts randomly: one number a channel where all follow one course, none where each
/// has its own. `None` for an effect that does not drift.
pub(super) fn pattern(realised: &[Realisation], samples: &Samples, channels: usize) -> Option<Vec<f64>> {
    let courses = Courses::of(samples);
    let devices: Vec<&Vec<f32>> = realised.iter().filter(|r| r.1.is_some()).map(|(.., v)| v).collect();
    let m = courses.hats.len();
    if devices.len() < 3 || m == 0 {
        return None;
    }
    let mut along: Vec<Vec<f64>> =
        devices.iter().map(|d| courses.project(d, channels)).collect::<Option<_>>()?;
    along.iter_mut().for_each(|own| courses.straighten(own));
    // What follows the temperature has one shape of course in all devices.
    if predictable(&along, m) {
        return None;
    }
    let mut patterns: Vec<Vec<f32>> = Vec::new();
    for own in &along {
        for w in 0..m {
            patterns.push((0..channels).map(|k| own[k * m + w] as f32).collect());
        }
    }
    let (found, _) = components(&patterns, WHOLE, 1);
    let energy: f64 = patterns.iter().map(|p| dot(p, p)).sum();
    let first = found.first()?;
    let held: f64 =
        patterns.iter().map(|p| dot(first, p).powi(2)).sum::<f64>() / dot(first, first).max(1e-300);
    if held > ONE_COURSE * energy {
        let largest = first.iter().fold(0.0f32, |l, v| if v.abs() > l.abs() { *v } else { l });
        Some(first.iter().map(|v| f64::from(v / largest)).collect())
    } else {
        Some(Vec::new())
    }
}

/// Columns of random drifts: those of all channels by the numbers `pattern`, or each channel's own.
pub(super) fn columns(samples: &Samples, pattern: &[f64], channels: usize) -> Vec<Column> {
    let hats = Courses::of(samples).hats;
    if pattern.is_empty() {
        // As many as a fit can bear, and a few for each of many channels.
        let every = (channels * hats.len()).div_ceil(DRIFTS.max(FEW * channels)).max(1);
        let merged: Vec<Vec<f32>> = hats
            .chunks(every)
            .map(|of| {
                let mut sum = vec![0.0f32; samples.list.len()];
                of.iter().for_each(|w| sum.iter_mut().zip(w).for_each(|(s, v)| *s += v));
                sum
            })
            .collect();
        return (0..channels)
            .flat_map(|k| merged.iter().map(move |w| Column { channel: Some(k), values: w.clone() }))
            .collect();
    }
    hats.iter()
        .map(|hat| {
            let values = hat.iter().flat_map(|v| pattern.iter().map(move |c| v * *c as f32)).collect();
            Column { channel: None, values }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use dermis_skin::Effect;
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::statistics::tests::samples;

    /// Two hundred samples a second apart.
    fn timed() -> Samples {
        let mut samples = samples(&[0; 200]);
        samples.list.iter_mut().enumerate().for_each(|(i, s)| s.time = i as f64);
        samples
    }

    /// Devices whose two channels follow `course` of time and device, the second one half as far.
    fn devices(course: impl Fn(f64, u64) -> f64) -> Vec<Realisation> {
        (0..6)
            .map(|d| {
                let values = (0..200).flat_map(|i| {
                    let v = course(f64::from(i), d);
                    [v as f32, 0.5 * v as f32]
                });
                (Effect::new("drift"), Some(d), values.collect())
            })
            .collect()
    }

    #[test]
    fn only_what_each_device_does_otherwise_is_a_random_drift() {
        let knots: Vec<[f64; 6]> = (0..6)
            .map(|d| {
                let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(d);
                [0; 6].map(|_| rng.random_range(-1.0..1.0))
            })
            .collect();
        let random = devices(|t, d| {
            let (at, part) = ((t / 40.0) as usize, (t / 40.0).fract());
            knots[d as usize][at] * (1.0 - part) + knots[d as usize][at + 1] * part
        });
        let found = pattern(&random, &timed(), 2).unwrap();
        assert!((found[0] - 1.0).abs() < 1e-9 && (found[1] - 0.5).abs() < 1e-3, "{found:?}");
        assert_eq!(columns(&timed(), &found, 2).len(), Courses::of(&timed()).hats.len());
        // One shape of other sizes, and what jumps from sample to sample, are none.
        assert_eq!(pattern(&devices(|t, d| (1.0 + d as f64) * (t / 60.0).sin()), &timed(), 2), None);
        assert_eq!(
            pattern(&devices(|t, d| if (t as u64 + d).is_multiple_of(2) { 1.0 } else { -1.0 }), &timed(), 2),
            None
        );
    }

    #[test]
    fn straight_lines_are_taken_out() {
        let mut values = [1.0, 4.0, 3.0];
        straighten(&mut values);
        assert_eq!(values, [0.0, 2.0, 0.0]);
    }
}
