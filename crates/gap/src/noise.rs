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
use crate::samples::{Sample, Samples};

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

impl Sums {
    /// Energy of a reading over some groups, and that of its noise; `usable` is the number of channels that count.
    fn total(groups: impl Iterator<Item = Self>, usable: f64) -> (f64, f64) {
        let mut t = Self::default();
        for s in groups {
            t.energy += s.energy;
            t.samples += s.samples;
            t.twins += s.twins;
            t.pairs += s.pairs;
        }
        // Without twins the noise is what it was measured to be between frames: 1.
        let noise = if t.pairs >= PAIRS { t.twins / t.pairs / usable } else { 1.0 };
        (t.energy / t.samples.max(1.0) / usable, noise)
    }
}

/// Residuals of samples, in deviations of the noise.
struct Residual<'a> {
    values: &'a [f32],
    channels: usize,
    samples: &'a Samples,
}

impl Residual<'_> {
    fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.channels..(i + 1) * self.channels]
    }

    /// Energy of the noise of two samples that are alike but for a factor.
    fn apart(&self, i: usize, j: usize, factor: f32) -> f64 {
        let rows = self.row(i).iter().zip(self.row(j));
        rows.map(|(a, b)| f64::from(a - b * factor).powi(2)).sum::<f64>() / 2.0
    }

    /// Energies of all samples and of the noise of twins, by group.
    fn by_group(&self) -> Vec<Sums> {
        let list = &self.samples.list;
        let mut sums = vec![Sums::default(); self.samples.groups];
        for (i, r) in list.iter().enumerate() {
            let s = &mut sums[r.group];
            s.energy += self.row(i).iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
            s.samples += 1.0;
            if r.paired && i + 1 < list.len() {
                s.twins += self.apart(i, i + 1, 1.0);
                s.pairs += 1.0;
            }
        }
        sums
    }

    /// Energy of what differs between presses that were done alike, over all pairs of them, and the number of pairs. Alike are same place,
    /// same force, same tip and same phase; a group holds locations whole, whichever run they are of.
    fn between_repeats(&self) -> (f64, usize) {
        let list = &self.samples.list;
        let mut locations: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, r) in list.iter().enumerate() {
            if r.phase == Phase::Hold && r.contacts == 1 {
                locations.entry(r.group).or_default().push(i);
            }
        }
        let (mut again, mut repeats) = (0.0, 0usize);
        for frames in locations.values() {
            for (a, &i) in frames.iter().enumerate() {
                for &j in &frames[a + 1..] {
                    let (p, q) = (&list[i], &list[j]);
                    if alike(p, q) {
                        // A difference in force is no noise: what it makes is taken out to first order.
                        let ratio = (p.force / q.force.max(1e-9)) as f32;
                        again += self.apart(i, j, ratio);
                        repeats += 1;
                    }
                }
            }
        }
        (again, repeats)
    }
}

/// Whether two held samples are of different presses that were done alike.
fn alike(p: &Sample, q: &Sample) -> bool {
    let near = p.position.iter().zip(q.position).all(|(a, b)| (a - b).abs() < SAME_PLACE);
    let force = (p.force - q.force).abs() < SAME_FORCE * p.force.max(SMALL_FORCE);
    let course = (p.since - q.since).abs() < SAME_COURSE[0] * p.since.abs().max(SAME_COURSE[1]);
    p.press != q.press && near && force && course && p.diameter == q.diameter
}

/// Energy of `n` rows of readings about their means.
fn about_means(readings: &[f32], n: usize, channels: usize) -> f64 {
    let mut mean = vec![0.0f64; channels];
    for r in readings.chunks_exact(channels) {
        for (m, v) in mean.iter_mut().zip(r) {
            *m += f64::from(*v) / n.max(1) as f64;
        }
    }
    let mut energy = 0.0;
    for r in readings.chunks_exact(channels) {
        energy += r.iter().zip(&mean).map(|(v, m)| (f64::from(*v) - m).powi(2)).sum::<f64>();
    }
    energy
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
    let (n, scale) = (samples.list.len(), usable.max(1) as f64);
    let residual = Residual { values: residual, channels, samples };
    let sums = residual.by_group();
    let (again, repeats) = residual.between_repeats();
    let variance = about_means(readings, n, channels) / (n.max(1) as f64 * scale);
    let (before, twins) = Sums::total(sums.iter().copied(), scale);
    let again = (repeats >= REPEATS).then(|| (again / repeats as f64 / scale - twins).max(0.0));
    let floor = twins + again.unwrap_or(0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x9a9);
    let mut drawn: Vec<f64> = (0..DRAWS)
        .map(|_| {
            let picks = (0..sums.len()).map(|_| sums[rng.random_range(0..sums.len())]);
            let (before, twins) = Sums::total(picks, scale);
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
