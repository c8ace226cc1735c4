//! How much of a residual is noise: of the sensor, of the zero that readings are counted from, and of a press that is done again.
//!
//! A zero is the mean of some untouched frames. Its error is the same in every frame that counts from it, so that it looks like a
//! systematic gap; but another recording of the same device has another one, and no model takes it away. With independent noise of
//! variance σ² a mean of n frames has the variance σ²/n. Noise that lasts from frame to frame makes it larger; what that is too much is
//! still counted as gap.

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
    /// Noise of the zero that readings are counted from; part of `floor`.
    #[serde(default)]
    pub zero: f64,
    /// What differs between presses that were done alike; part of `floor`. `None` without such presses.
    pub irreproducible: Option<f64>,
    /// Pairs of presses that were done alike.
    pub repeats: usize,
    /// Energy of the readings about their means, in deviations of the noise squared, a reading.
    #[serde(skip)]
    pub variance: f64,
}

impl Gap {
    /// Noise of single frames: the floor without what their zeros add and without what does not repeat.
    pub(crate) fn frame_noise(&self) -> f64 {
        self.floor - self.zero - self.irreproducible.unwrap_or(0.0)
    }

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
    zeros: f64,
}

/// Energies of a reading.
struct Energies {
    residual: f64,
    /// Of the noise of single frames.
    frame: f64,
    /// Of the noise of their zeros.
    zero: f64,
}

impl Sums {
    /// Over some groups; `usable` is the number of channels that count.
    fn total(groups: impl Iterator<Item = Self>, usable: f64) -> Energies {
        let mut t = Self::default();
        for s in groups {
            t.energy += s.energy;
            t.samples += s.samples;
            t.twins += s.twins;
            t.pairs += s.pairs;
            t.zeros += s.zeros;
        }
        // Without twins the noise is what it was measured to be between frames: 1.
        let frame = if t.pairs >= PAIRS { t.twins / t.pairs / usable } else { 1.0 };
        let samples = t.samples.max(1.0);
        Energies { residual: t.energy / samples / usable, frame, zero: frame * t.zeros / samples }
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
            s.zeros += r.zero_variance();
            if r.paired && i + 1 < list.len() {
                s.twins += self.apart(i, i + 1, 1.0);
                s.pairs += 1.0;
            }
        }
        sums
    }

    /// What differs between presses that were done alike. Alike are same place, same force, same tip and same phase; a group holds
    /// locations whole, whichever run they are of.
    fn between_repeats(&self) -> Repeats {
        let list = &self.samples.list;
        let mut locations: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, r) in list.iter().enumerate() {
            if r.phase == Phase::Hold && r.contacts == 1 {
                locations.entry(r.group).or_default().push(i);
            }
        }
        let mut found = Repeats::default();
        for frames in locations.values() {
            for (a, &i) in frames.iter().enumerate() {
                for &j in &frames[a + 1..] {
                    let (p, q) = (&list[i], &list[j]);
                    if alike(p, q) {
                        // A difference in force is no noise: what it makes is taken out to first order.
                        let ratio = (p.force / q.force.max(1e-9)) as f32;
                        found.energy += self.apart(i, j, ratio);
                        found.pairs += 1;
                        // What both count from takes itself away.
                        if p.zero.map(|z| z.index) != q.zero.map(|z| z.index) {
                            found.zeros += f64::midpoint(p.zero_variance(), q.zero_variance());
                        }
                    }
                }
            }
        }
        found
    }
}

/// Sums over pairs of presses that were done alike.
#[derive(Debug, Clone, Copy, Default)]
struct Repeats {
    energy: f64,
    pairs: usize,
    /// Variances of zeros that are not the same, in variances of a frame's noise.
    zeros: f64,
}

impl Repeats {
    /// Energy of a reading that neither noise of single frames (`frame`) nor of zeros makes; `None` with too few pairs.
    fn irreproducible(self, frame: f64, usable: f64) -> Option<f64> {
        let pairs = self.pairs as f64;
        (self.pairs >= REPEATS)
            .then(|| (self.energy / pairs / usable - frame * (1.0 + self.zeros / pairs)).max(0.0))
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
    let repeats = residual.between_repeats();
    let variance = about_means(readings, n, channels) / (n.max(1) as f64 * scale);
    let whole = Sums::total(sums.iter().copied(), scale);
    let again = repeats.irreproducible(whole.frame, scale);
    let floor = whole.frame + whole.zero + again.unwrap_or(0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x9a9);
    let mut drawn: Vec<f64> = (0..DRAWS)
        .map(|_| {
            let picks = (0..sums.len()).map(|_| sums[rng.random_range(0..sums.len())]);
            let of = Sums::total(picks, scale);
            (of.residual - of.frame - of.zero - again.unwrap_or(0.0)) / variance
        })
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = |share: f64| drawn.get((share * drawn.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    Gap {
        fvu_before: whole.residual / variance,
        floor: floor / variance,
        systematic: (whole.residual - floor) / variance,
        interval: INTERVAL.map(at),
        zero: whole.zero / variance,
        irreproducible: again.map(|a| a / variance),
        repeats: repeats.pairs,
        variance,
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::StandardNormal;

    use super::*;
    use crate::recording::ZeroMean;
    use crate::statistics::tests::samples;

    const CHANNELS: usize = 600;
    /// Untouched frames that a zero is the mean of.
    const FRAMES: u32 = 20;

    /// Noise of 40 places, each pressed twice with four frames, counted from a mean of [`FRAMES`] frames: one for all, or another for
    /// each press.
    fn recorded(each_press: bool, known: bool) -> Gap {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut noise =
            |of: f64| (0..CHANNELS).map(|_| of * rng.sample::<f64, _>(StandardNormal)).collect::<Vec<f64>>();
        let of_zero = 1.0 / f64::from(FRAMES).sqrt();
        let mut samples = samples(&(0..320).map(|i| i / 8).collect::<Vec<_>>());
        let (mut residual, mut readings) = (Vec::new(), Vec::new());
        let mut zero = noise(of_zero);
        for (i, sample) in samples.list.iter_mut().enumerate() {
            let (press, step) = (i / 4, i % 4);
            if each_press && step == 0 {
                zero = noise(of_zero);
            }
            sample.press = press;
            sample.since = 0.1 * step as f64;
            sample.position[0] = 1e-3 * sample.group as f64;
            sample.paired = step == 0;
            let index = if each_press { press as u32 } else { 0 };
            let mean = ZeroMean { index, frames: FRAMES, time: 0.0, temperature: f64::NAN, presses: 0 };
            sample.zero = known.then_some(mean);
            let signal = noise(3.0);
            let all = noise(1.0).into_iter().zip(&zero).map(|(frame, zero)| (frame - zero) as f32);
            let all: Vec<f32> = all.collect();
            readings.extend(all.iter().zip(&signal).map(|(a, s)| a + *s as f32));
            residual.extend(all);
        }
        measure(&residual, &readings, &samples, CHANNELS, CHANNELS, 1)
    }

    #[test]
    fn noise_of_a_zero_is_no_gap() {
        for each_press in [false, true] {
            let gap = recorded(each_press, true);
            assert!(gap.interval[0] < 0.0 && gap.interval[1] > 0.0, "{each_press}: {gap:?}");
            approx::assert_relative_eq!(gap.zero, gap.frame_noise() / f64::from(FRAMES), max_relative = 1e-9);
            assert!(gap.irreproducible.unwrap() < 0.3 * gap.zero, "{each_press}: {gap:?}");
        }
        // Who does not know of it takes it for a gap where it is one for all, and for presses that do not repeat where it is not.
        let gap = recorded(false, false);
        assert!(gap.interval[0] > 0.0, "{gap:?}");
        assert!(recorded(true, false).irreproducible.unwrap() > 0.5 * recorded(true, true).zero);
    }
}
