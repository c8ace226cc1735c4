//! Whether readings and nominal model agree at all: in units, sign, order of channels and frame of the ground truth.

use dermis_skin::{Phase, Surface};

use crate::GapError;
use crate::constants::check::{
    AGREES, COMPARED, EXCHANGED, FACTOR, FRAME_GAIN, IN_PLACE, MIRRORED, SAME_SHAPE, UNRELATED,
};
use crate::recording::{Problem, Recording};
use crate::samples::Samples;
use crate::simulate::Simulator;
use crate::wording::short;

/// Readings of samples minus those of the untouched ones, and the same of the model, in deviations of the noise.
struct Tared {
    real: Vec<f32>,
    model: Vec<f32>,
    channels: usize,
    usable: Vec<usize>,
}

impl Tared {
    fn agreement(&self) -> f64 {
        let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
        for (r, m) in self.real.chunks_exact(self.channels).zip(self.model.chunks_exact(self.channels)) {
            for &k in &self.usable {
                let (a, b) = (f64::from(r[k]), f64::from(m[k]));
                xy += a * b;
                xx += a * a;
                yy += b * b;
            }
        }
        xy / (xx * yy).sqrt().max(1e-300)
    }

    /// Least squares factor from model to readings.
    fn gain(&self) -> f64 {
        let (mut xy, mut yy) = (0.0, 0.0);
        for (a, b) in self.real.iter().zip(&self.model) {
            xy += f64::from(*a) * f64::from(*b);
            yy += f64::from(*b).powi(2);
        }
        xy / yy.max(1e-300)
    }

    fn correlation(&self, real: usize, model: usize) -> f64 {
        let (mut xy, mut xx, mut yy) = (0.0, 1e-9, 1e-9);
        let pairs = self.real.chunks_exact(self.channels).zip(self.model.chunks_exact(self.channels));
        for (r, m) in pairs {
            let (a, b) = (f64::from(r[real]), f64::from(m[model]));
            xy += a * b;
            xx += a * a;
            yy += b * b;
        }
        xy / (xx * yy).sqrt()
    }
}

/// Samples in which something is held, every so many.
fn held(samples: &Samples) -> Vec<usize> {
    let found: Vec<usize> = (0..samples.list.len())
        .filter(|i| {
            matches!(samples.list[*i].phase, Phase::Hold | Phase::Slide) && samples.list[*i].contacts > 0
        })
        .collect();
    let step = found.len().div_ceil(COMPARED).max(1);
    found.into_iter().step_by(step).collect()
}

fn tared(readings: &[f32], model: &[f32], samples: &Samples, sigma: &[f64]) -> Tared {
    let channels = sigma.len();
    let usable: Vec<usize> = (0..channels).filter(|k| sigma[*k].is_finite()).collect();
    let rest: Vec<usize> = (0..samples.list.len()).filter(|i| !samples.list[*i].phase.touched()).collect();
    let zero = |of: &[f32]| -> Vec<f32> {
        let median = |k: usize| {
            let mut values: Vec<f32> = rest.iter().map(|i| of[i * channels + k]).collect();
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        };
        (0..channels).map(median).collect()
    };
    // A model may read something where nothing touches, as a device does.
    let (zero, nothing) = (zero(readings), zero(model));
    let (mut real, mut said) = (Vec::new(), Vec::new());
    for i in held(samples) {
        for k in 0..channels {
            let finite = sigma[k].is_finite();
            let s = sigma[k] as f32;
            real.push(if finite { (readings[i * channels + k] - zero[k]) / s } else { 0.0 });
            said.push(if finite { (model[i * channels + k] - nothing[k]) / s } else { 0.0 });
        }
    }
    Tared { real, model: said, channels, usable }
}

/// What readings and model say of each other beyond any effect.
pub struct Agreement {
    /// What was noticed.
    pub problems: Vec<Problem>,
    /// For each channel, the channel whose readings it carries, where that is another.
    pub order: Option<Vec<usize>>,
}

/// Compares the readings of samples (unit of the skin) with the nominal model's: units, sign, order of channels, frame of the ground
/// truth.
///
/// # Errors
///
/// What the model says.
pub fn agreement(
    simulator: &Simulator<'_>,
    recording: &Recording,
    samples: &Samples,
    readings: &[f32],
    model: &[f32],
    sigma: &[f64],
) -> Result<Agreement, GapError> {
    let mut found = Agreement { problems: Vec::new(), order: None };
    let now = tared(readings, model, samples, sigma);
    if now.real.is_empty() {
        return Ok(found);
    }
    let agrees = now.agreement();
    if let Some(problem) = scaled(agrees, now.gain(), &simulator.skin.unit) {
        found.problems.push(problem);
        return Ok(found);
    }
    let order = order(&now);
    if order.is_none() && agrees > AGREES {
        return Ok(found);
    }
    // Ground truth that is mirrored or turned looks like channels in another order on many skins.
    let agrees_with = |read: &[f32]| tared(readings, read, samples, sigma).agreement();
    let best = best_turn(simulator, recording, &samples.frames(), agrees_with);
    let turned = best.filter(|(a, _)| *a > agrees + FRAME_GAIN && *a > AGREES);
    match (order, turned) {
        (_, Some((agreement, name))) => {
            let also =
                if agreement < MIRRORED { ", or channels are in a mirrored order" } else { "" };
            found.problems.push(Problem::fatal(
                "frame",
                format!(
                    "readings agree with the model ({agreement:.2} instead of {agrees:.2}) where {name}: the ground truth is in \
                     another frame{also}; say which, and diagnose again"
                ),
            ));
        }
        (Some(order), None) => found.order = Some(order),
        (None, None) if agrees < UNRELATED => found.problems.push(Problem::fatal(
            "unrelated",
            format!(
                "readings and model have next to nothing in common (agreement {agrees:.2} of 1): the ground truth belongs to \
                 another time or frame, or the readings to another skin"
            ),
        )),
        (None, None) => {}
    }
    Ok(found)
}

/// What is wrong with the units or the sign of readings that go with the model but for a factor.
fn scaled(agrees: f64, gain: f64, unit: &str) -> Option<Problem> {
    if agrees.abs() > SAME_SHAPE && !(FACTOR[0]..=FACTOR[1]).contains(&gain.abs()) {
        return Some(Problem::fatal(
            "units",
            format!(
                "readings are {} times what the model reads for these forces: readings are not in {unit}, or forces not in N, \
                 by a factor of some {:.0e}",
                short(gain),
                10f64.powf(gain.abs().log10().round())
            ),
        ));
    }
    (agrees < -SAME_SHAPE).then(|| {
        Problem::fatal(
            "sign",
            "readings fall where the model says that they rise: the sign of the readings is turned",
        )
    })
}

/// A frame that ground truth may be in by mistake.
struct Turn {
    name: &'static str,
    /// Of x and y, once they are exchanged.
    signs: [f64; 2],
    exchange: bool,
}

const TURNS: [Turn; 4] = [
    Turn { name: "x is mirrored", signs: [-1.0, 1.0], exchange: false },
    Turn { name: "y is mirrored", signs: [1.0, -1.0], exchange: false },
    Turn { name: "x and y are turned by 180°", signs: [-1.0, -1.0], exchange: false },
    Turn { name: "x and y are exchanged", signs: [1.0, 1.0], exchange: true },
];

impl Turn {
    /// The recording with its contacts in this frame, and without its readings: they are of no concern, and may be large.
    fn of(&self, recording: &Recording, surface: &Surface) -> Recording {
        let mut other = Recording {
            name: recording.name.clone(),
            channels: recording.channels,
            labels: recording.labels.clone(),
            zero: recording.zero,
            zeros: recording.zeros.clone(),
            ..Recording::default()
        };
        for m in &mut other.labels {
            for contact in m.stimulus.iter_mut().flat_map(|s| &mut s.contacts) {
                let (p, f) = (contact.position, contact.force);
                let (x, y) = if self.exchange { (p.y, p.x) } else { (p.x, p.y) };
                let (fx, fy) = if self.exchange { (f.y, f.x) } else { (f.x, f.y) };
                contact.position.x = self.signs[0] * x;
                contact.position.y = self.signs[1] * y;
                contact.force.x = self.signs[0] * fx;
                contact.force.y = self.signs[1] * fy;
                contact.position = surface.project(&contact.position).0;
            }
        }
        other
    }
}

/// In which turned frame the ground truth makes the model agree best with the readings, and how well; `agrees_with` says how well they
/// agree with what the model reads in `frames`.
fn best_turn(
    simulator: &Simulator<'_>,
    recording: &Recording,
    frames: &[usize],
    agrees_with: impl Fn(&[f32]) -> f64,
) -> Option<(f64, &'static str)> {
    let surface = simulator.skin.surface();
    let mut best: Option<(f64, &str)> = None;
    for turn in TURNS {
        let other = turn.of(recording, &surface);
        let Ok(read) = simulator.readings(simulator.skin, &other, frames) else { continue };
        let agrees = agrees_with(&read);
        if best.is_none_or(|b| agrees > b.0) {
            best = Some((agrees, turn.name));
        }
    }
    best
}

/// Channels whose readings clearly are those of others: a permutation, or nothing.
fn order(tared: &Tared) -> Option<Vec<usize>> {
    let n = tared.channels;
    let mut order: Vec<usize> = (0..n).collect();
    let mut moved = Vec::new();
    for &j in &tared.usable {
        let own = tared.correlation(j, j);
        if own > IN_PLACE {
            continue;
        }
        let others = tared.usable.iter().map(|&k| (k, tared.correlation(j, k)));
        if let Some((k, best)) = others.max_by(|a, b| a.1.total_cmp(&b.1))
            && k != j
            && best > own + EXCHANGED[1]
            && best > EXCHANGED[0]
        {
            order[j] = k;
            moved.push(j);
        }
    }
    let mut targets: Vec<usize> = moved.iter().map(|&j| order[j]).collect();
    targets.sort_unstable();
    let mut sources = moved.clone();
    sources.sort_unstable();
    (moved.len() >= 2 && targets == sources).then_some(order)
}

#[cfg(test)]
mod tests {
    use dermis_skin::SkinDescription;

    use super::*;
    use crate::recording::Zero;
    use crate::samples::SampleOptions;
    use crate::testing::{EFFECTS, gains, recorded, skin, small};

    #[test]
    fn a_model_that_reads_something_untouched_agrees_as_one_that_does_not() {
        let skin = skin();
        for zero in [Zero::AsRead, Zero::Press] {
            let compared = |rest: f64| {
                let make = |skin: &SkinDescription| small(skin, rest);
                let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
                let mut recording = recorded(&simulator, &[gains()]);
                recording.tare(zero);
                let samples = Samples::draw(&recording, &[true; 3], &SampleOptions::default());
                let frames = samples.frames();
                let readings: Vec<f32> =
                    frames.iter().flat_map(|f| recording.frame(*f).iter().copied()).collect();
                let model = simulator.readings(&skin, &recording, &frames).unwrap();
                let sigma = [5.0; 3];
                let found = agreement(&simulator, &recording, &samples, &readings, &model, &sigma).unwrap();
                assert!(found.problems.is_empty() && found.order.is_none(), "{:?}", found.problems);
                let now = tared(&readings, &model, &samples, &sigma);
                (now.agreement(), now.gain())
            };
            let (plain, resting) = (compared(0.0), compared(4000.0));
            assert!(plain.0 > 0.95, "{plain:?}");
            // Gains scale an untouched reading, too, where nobody tares: the zero takes that away again.
            assert!((plain.0 - resting.0).abs() < 1e-4, "{plain:?} {resting:?}");
            assert!((plain.1 - resting.1).abs() < 1e-4, "{plain:?} {resting:?}");
        }
    }
}
