//! What depends on the time since power-on: exponential decays, and presses so far.

use std::collections::BTreeMap;

use crate::algebra::{components, dot};
use crate::constants::signatures::{DECAY_COLUMNS, DECAYS, WHOLE};
use crate::samples::{Sample, Samples};

/// A course from power-on, one value a sample.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Course {
    /// At the sample.
    pub now: Vec<f32>,
    /// In the frames that its zero was measured from; 0 where nothing was subtracted.
    pub at_zero: Vec<f32>,
}

impl Course {
    /// What a tared reading shows of it.
    pub fn since_zero(&self) -> Vec<f32> {
        self.now.iter().zip(&self.at_zero).map(|(now, zero)| now - zero).collect()
    }
}

/// What all decays from power-on have in common: a few courses. `tared` says whether what is read untouched was subtracted.
pub(crate) fn decays(samples: &Samples, tared: bool) -> Vec<Course> {
    let n = samples.list.len();
    let both = |tau: &f64| {
        let Course { mut now, at_zero } = decay(samples, *tau, tared);
        now.extend(at_zero);
        now
    };
    let courses: Vec<Vec<f32>> = DECAYS.iter().map(both).collect();
    let apart = |course: Vec<f32>| Course { now: course[..n].to_vec(), at_zero: course[n..].to_vec() };
    components(&courses, WHOLE, DECAY_COLUMNS).0.into_iter().map(apart).collect()
}

/// What is left of a value at power-on; `time` is the time constant in seconds.
fn decay(samples: &Samples, time: f64, tared: bool) -> Course {
    let left = |since: f64| (-since / time).exp() as f32;
    let zero =
        |s: &Sample| s.zero.filter(|zero| tared && zero.frames > 0).map_or(0.0, |zero| left(zero.time));
    Course {
        now: samples.list.iter().map(|s| left(s.time)).collect(),
        at_zero: samples.list.iter().map(zero).collect(),
    }
}

/// Presses that have begun so far in the run of each sample.
pub(crate) fn presses(samples: &Samples) -> Vec<f64> {
    let mut first: BTreeMap<u32, usize> = BTreeMap::new();
    let mut last = 0.0;
    samples
        .list
        .iter()
        .map(|s| {
            // What comes between two presses has the count of the one before.
            if s.press != usize::MAX {
                last = (s.press - *first.entry(s.location.0).or_insert(s.press) + 1) as f64;
            } else if !first.contains_key(&s.location.0) {
                last = 0.0;
            }
            last
        })
        .collect()
}

/// The values at power-on, and the common time constant in seconds, whose exponential decays come nearest to `courses` (one value a
/// sample, as tared readings show them) in least squares.
pub(crate) fn fit_decay(samples: &Samples, tared: bool, courses: &[Vec<f32>]) -> (Vec<f64>, f64) {
    // Half an order of magnitude in twelve steps.
    let times = (0..=48).map(|i| DECAYS[0] * 10f64.powf(f64::from(i) / 24.0));
    let mut best = (f64::INFINITY, vec![0.0; courses.len()], DECAYS[2]);
    for time in times {
        let decay = decay(samples, time, tared).since_zero();
        let energy = dot(&decay, &decay).max(1e-300);
        let along: Vec<f64> = courses.iter().map(|values| dot(&decay, values)).collect();
        let left: f64 = courses.iter().zip(&along).map(|(v, a)| dot(v, v) - a * a / energy).sum();
        if left < best.0 {
            best = (left, along.iter().map(|a| a / energy).collect(), time);
        }
    }
    (best.1, best.2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::ZeroMean;
    use crate::statistics::tests::samples;

    fn timed() -> Samples {
        let mut samples = samples(&[0; 40]);
        samples.list.iter_mut().enumerate().for_each(|(i, s)| s.time = 20.0 * i as f64);
        samples
    }

    #[test]
    fn a_decay_has_its_values_and_its_time() {
        let samples = timed();
        let courses: Vec<Vec<f32>> =
            [3.0, -1.5].map(|v| decay(&samples, 300.0, false).now.iter().map(|d| v * d).collect()).into();
        let (values, time) = fit_decay(&samples, false, &courses);
        assert!((time / 300.0 - 1.0).abs() < 1e-9, "{time}");
        assert!((values[0] - 3.0).abs() < 1e-5 && (values[1] + 1.5).abs() < 1e-5, "{values:?}");
    }

    #[test]
    fn a_tare_takes_away_what_a_decay_is_while_it_lasts() {
        let mut samples = timed();
        samples.list.iter_mut().for_each(|s| {
            s.zero = Some(ZeroMean { index: 0, frames: 9, time: 2.0, temperature: f64::NAN, presses: 0 });
        });
        let shown = decay(&samples, 300.0, true).since_zero();
        assert!((f64::from(shown[15]) - ((-1.0f64).exp() - (-2.0f64 / 300.0).exp())).abs() < 1e-6);
        let (values, time) = fit_decay(&samples, true, &[shown.iter().map(|v| 2.0 * v).collect()]);
        assert!((time / 300.0 - 1.0).abs() < 1e-9 && (values[0] - 2.0).abs() < 1e-5, "{values:?} {time}");
        // Courses of what all have in common hold it, too.
        let courses: Vec<Vec<f32>> = decays(&samples, true).iter().map(Course::since_zero).collect();
        assert!(courses.iter().all(|course| course.len() == 40 && course.iter().all(|v| v.is_finite())));
    }

    #[test]
    fn presses_are_counted_in_each_run() {
        let mut samples = timed();
        for (i, s) in samples.list.iter_mut().enumerate() {
            s.press = if i % 4 == 0 { usize::MAX } else { 7 + i / 8 };
            s.location.0 = u32::from(i >= 16);
        }
        let counts = presses(&samples);
        assert_eq!((counts[0], counts[1], counts[9], counts[12]), (0.0, 1.0, 2.0, 2.0));
        assert_eq!((counts[16], counts[17]), (0.0, 1.0));
    }
}
