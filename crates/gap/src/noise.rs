//! How much of a residual is noise: of the sensor, and of a press that is done again.

use std::collections::BTreeMap;

use dermis_skin::{Phase, SkinDescription};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::constants::noise::{
    BELIEVED, DRAWS, FEWEST_STEPS, FRAMES, INTERVAL, MEDIAN_STEP, PAIRS, REPEATS, SAME_COURSE, SAME_FORCE,
    SAME_PLACE, SMALL_FORCE,
};
use crate::recording::Recording;
use crate::samples::Samples;

/// Standard deviation of each channel's noise in the unit of the skin, from one untouched frame to the next; that of the
/// description where there are too few of these. Infinite for a channel that gives no numbers.
#[must_use]
pub fn deviations(recording: &Recording, skin: &SkinDescription) -> Vec<f64> {
    let declared = skin.channel_noise();
    (0..recording.channels)
        .map(|k| {
            let mut steps: Vec<f64> = Vec::new();
            let mut finite = 0;
            for i in 0..recording.labels.len().saturating_sub(1) {
                let (a, b) = (recording.frame(i)[k], recording.frame(i + 1)[k]);
                finite += usize::from(a.is_finite());
                let (m, n) = (&recording.labels[i], &recording.labels[i + 1]);
                let still = !m.phase.touched() && !n.phase.touched() && m.run == n.run;
                if still && a.is_finite() && b.is_finite() && steps.len() < FRAMES {
                    steps.push(f64::from((b - a).abs()));
                }
            }
            if finite * 2 < recording.labels.len() {
                return f64::INFINITY;
            }
            let floor = declared.get(k).copied().unwrap_or(skin.noise);
            if steps.len() < FEWEST_STEPS {
                return floor;
            }
            steps.sort_by(f64::total_cmp);
            // Median of |a − b| of two normal numbers is 0.9539 of their deviation.
            let measured = steps[steps.len() / 2] / MEDIAN_STEP;
            if measured > BELIEVED * floor { measured } else { floor }
        })
        .collect()
}

/// How large the gap is, in shares of the readings' variance.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Gap {
    /// Of readings minus nominal model, noise included.
    pub fvu_before: f64,
    /// Noise: what no deterministic model takes away.
    pub floor: f64,
    /// Systematic: what a better model could take away.
    pub systematic: f64,
    /// 95 % interval of `systematic`, over locations.
    pub interval: [f64; 2],
    /// What differs between presses that were done alike; part of `floor`. `None` without such presses.
    pub irreproducible: Option<f64>,
    /// Pairs of presses that were done alike.
    pub repeats: usize,
    /// Energy of the readings about their means, in deviations of the noise squared, a reading.
    #[serde(skip)]
    pub variance: f64,
}

impl Gap {
    /// With a part of the systematic gap counted to the floor.
    pub(crate) fn counts_as_noise(&mut self, part: f64) {
        self.floor += part;
        self.systematic -= part;
        self.interval.iter_mut().for_each(|end| *end -= part);
    }
}

/// Sums over one group.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    energy: f64,
    samples: f64,
    twins: f64,
    pairs: f64,
}

/// Measures the gap of a residual (samples × channels, in deviations of the noise) by cross products: noise of different frames is
/// independent, the systematic part is the same. `readings` are the readings in the same scale.
#[must_use]
pub fn measure(
    residual: &[f32],
    readings: &[f32],
    samples: &Samples,
    usable: usize,
    channels: usize,
    seed: u64,
) -> Gap {
    let n = samples.list.len();
    let row = |i: usize| &residual[i * channels..(i + 1) * channels];
    let energy = |v: &[f32]| v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
    let apart = |i: usize, j: usize| {
        row(i).iter().zip(row(j)).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / 2.0
    };
    let mut sums = vec![Sums::default(); samples.groups];
    for (i, r) in samples.list.iter().enumerate() {
        let s = &mut sums[r.group];
        s.energy += energy(row(i));
        s.samples += 1.0;
        if r.paired && i + 1 < n {
            s.twins += apart(i, i + 1);
            s.pairs += 1.0;
        }
    }
    // Presses that were done alike: same place, same force, same tip, same phase; a group holds locations whole, whichever run they are of.
    let mut locations: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, r) in samples.list.iter().enumerate() {
        if r.phase == Phase::Hold && r.contacts == 1 {
            locations.entry(r.group).or_default().push(i);
        }
    }
    let (mut again, mut repeats) = (0.0, 0usize);
    for frames in locations.values() {
        for (a, &i) in frames.iter().enumerate() {
            for &j in &frames[a + 1..] {
                let (p, q) = (&samples.list[i], &samples.list[j]);
                let near = p.position.iter().zip(q.position).all(|(a, b)| (a - b).abs() < SAME_PLACE);
                let alike = (p.force - q.force).abs() < SAME_FORCE * p.force.max(SMALL_FORCE);
                let label = (p.since - q.since).abs() < SAME_COURSE[0] * p.since.abs().max(SAME_COURSE[1]);
                if p.press != q.press && near && alike && label && p.diameter == q.diameter {
                    // A difference in force is no noise: what it makes is taken out to first order.
                    let ratio = (p.force / q.force.max(1e-9)) as f32;
                    let differ: f64 =
                        row(i).iter().zip(row(j)).map(|(a, b)| f64::from(a - b * ratio).powi(2)).sum();
                    again += differ / 2.0;
                    repeats += 1;
                }
            }
        }
    }
    let mut mean = vec![0.0f64; channels];
    for r in readings.chunks_exact(channels) {
        for (m, v) in mean.iter_mut().zip(r) {
            *m += f64::from(*v) / n.max(1) as f64;
        }
    }
    let mut variance = 0.0;
    for r in readings.chunks_exact(channels) {
        variance += r.iter().zip(&mean).map(|(v, m)| (f64::from(*v) - m).powi(2)).sum::<f64>();
    }
    let scale = usable.max(1) as f64;
    let variance = variance / (n.max(1) as f64 * scale);
    let total = |sums: &mut dyn Iterator<Item = Sums>| {
        let mut t = Sums::default();
        for s in sums {
            t.energy += s.energy;
            t.samples += s.samples;
            t.twins += s.twins;
            t.pairs += s.pairs;
        }
        // Without twins the noise is what it was measured to be between frames: 1.
        let noise = if t.pairs >= PAIRS { t.twins / t.pairs / scale } else { 1.0 };
        (t.energy / t.samples.max(1.0) / scale, noise)
    };
    let (before, twins) = total(&mut sums.iter().copied());
    let again = (repeats >= REPEATS).then(|| (again / repeats as f64 / scale - twins).max(0.0));
    let floor = twins + again.unwrap_or(0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x9a9);
    let mut drawn: Vec<f64> = (0..DRAWS)
        .map(|_| {
            let mut picks = (0..sums.len()).map(|_| sums[rng.random_range(0..sums.len())]);
            let (before, twins) = total(&mut picks);
            (before - twins - again.unwrap_or(0.0)) / variance
        })
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = |share: f64| drawn.get((share * drawn.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    Gap {
        fvu_before: before / variance,
        floor: floor / variance,
        systematic: (before - floor) / variance,
        interval: INTERVAL.map(at),
        irreproducible: again.map(|a| a / variance),
        repeats,
        variance,
    }
}
