//! Recordings that would make a diagnosis confidently wrong, and what one lacks.

use dermis_skin::{Phase, SkinDescription};
use serde::{Deserialize, Serialize};

use crate::GapError;
use crate::constants::check::{
    AGREES, COMPARED, EXCHANGED, FACTOR, FEWEST_PRESSES, FEWEST_SAMPLES, FRAME_GAIN, IDLE, IN_PLACE, KELVIN,
    MIRRORED, NEVER_CHANGES, NO_NUMBER, SAME_SHAPE, UNRELATED,
};
use crate::constants::noise::REPEATS;
use crate::recording::{Problem, Recording};
use crate::samples::Samples;
use crate::simulate::Simulator;
use crate::wording::short;

/// Something that a recording lacks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Missing {
    /// What.
    pub what: String,
    /// Questions that cannot be answered without it.
    pub blocks: String,
}

/// What a recording lacks, and the questions that this blocks.
#[must_use]
pub fn missing(recording: &Recording, samples: &Samples, repeats: usize) -> Vec<Missing> {
    let mut found = Vec::new();
    let mut lacks = |what: &str, blocks: &str| {
        found.push(Missing { what: what.to_owned(), blocks: blocks.to_owned() });
    };
    if repeats < REPEATS {
        lacks(
            "repeats: presses of the same place and force, at least ten pairs",
            "how much of the gap comes again (irreproducible share); the floor is that of the noise within one press",
        );
    }
    if recording.sessions.len() < 2 {
        lacks(
            "a second session",
            "whether the gap is the same after the skin was mounted or switched on again",
        );
    }
    let kelvin: Vec<f64> = recording.labels.iter().map(|m| m.temperature).filter(|t| t.is_finite()).collect();
    let (low, high) =
        kelvin.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), t| (l.min(*t), h.max(*t)));
    if kelvin.len() * 2 < recording.labels.len() {
        lacks("the temperature", "whether zero or gain follow it");
    } else if high - low < KELVIN {
        lacks("a temperature that changes", "whether zero or gain follow it");
    }
    let idle = recording.labels.iter().filter(|m| m.phase == Phase::Idle).count();
    if idle < IDLE {
        lacks(
            "windows without contact, at least half a second each",
            "offsets, drift and noise apart from contacts",
        );
    }
    let held = samples.list.iter().filter(|r| r.phase == Phase::Hold).map(|r| r.since).fold(0.0, f64::max);
    if held < 1.0 {
        lacks("presses that are held for a second or more", "creep and relaxation beyond that time");
    }
    if !samples.list.iter().any(|r| r.contacts > 1) {
        lacks("several contacts at once", "superposition");
    }
    let mut tips: Vec<i64> =
        samples.list.iter().filter(|r| r.contacts > 0).map(|r| (r.diameter * 1e6) as i64).collect();
    tips.sort_unstable();
    tips.dedup();
    if tips.len() < 2 {
        lacks("a second tip", "size of the tip apart from depth and softness of the skin");
    }
    found
}

/// Says what is wrong with readings whatever was done.
pub fn readings(recording: &Recording, skin: &SkinDescription, samples: &Samples) -> Vec<Problem> {
    let mut found = Vec::new();
    let n = recording.labels.len();
    let contacts = recording.contacts();
    if contacts < FEWEST_PRESSES {
        found.push(Problem::fatal(
            "few-contacts",
            format!(
                "{contacts} presses only: causes are not named below {FEWEST_PRESSES}; press at more locations"
            ),
        ));
    }
    for (k, channel) in skin.channels().iter().enumerate().take(recording.channels) {
        let (mut gaps, mut run, mut longest, mut at) = (0usize, 0usize, 0usize, 0usize);
        let (mut same, mut before) = (0usize, f32::NAN);
        for i in 0..n {
            let v = recording.readings[i * recording.channels + k];
            if v.is_finite() {
                run = 0;
                same += usize::from(v == before);
                before = v;
            } else {
                gaps += 1;
                run += 1;
                if run > longest {
                    (longest, at) = (run, i + 1 - run);
                }
            }
        }
        let name = &channel.name;
        if gaps > 0 {
            let from = recording.labels[at].time;
            let share = 100.0 * gaps as f64 / n as f64;
            let what = format!(
                "channel {name} gives no number in {gaps} frames ({share:.1} %), the longest stretch is {longest} frames from \
                 {from:.2} s on; these frames are left out"
            );
            found.push(if gaps == n {
                Problem::note("dead-channel", format!("channel {name} never gives a number; it is left out"))
            } else {
                Problem { code: "not-finite".to_owned(), what, fatal: share > 100.0 * NO_NUMBER }
            });
        } else if n > NEVER_CHANGES && same + 1 == n {
            found.push(Problem::note("dead-channel", format!("channel {name} never changes")));
        }
    }
    if samples.list.len() < FEWEST_SAMPLES && contacts >= FEWEST_PRESSES {
        found.push(Problem::fatal(
            "no-samples",
            format!(
                "{} frames remain in which all channels and the ground truth are known",
                samples.list.len()
            ),
        ));
    }
    found
}

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
    let (agrees, gain) = (now.agreement(), now.gain());
    let unit = &simulator.skin.unit;
    if agrees.abs() > SAME_SHAPE && !(FACTOR[0]..=FACTOR[1]).contains(&gain.abs()) {
        found.problems.push(Problem::fatal(
            "units",
            format!(
                "readings are {} times what the model reads for these forces: readings are not in {unit}, or forces not in N, \
                 by a factor of some {:.0e}",
                short(gain),
                10f64.powf(gain.abs().log10().round())
            ),
        ));
        return Ok(found);
    }
    if agrees < -SAME_SHAPE {
        found.problems.push(Problem::fatal(
            "sign",
            "readings fall where the model says that they rise: the sign of the readings is turned"
                .to_owned(),
        ));
        return Ok(found);
    }
    let order = order(&now);
    if order.is_none() && agrees > AGREES {
        return Ok(found);
    }
    // Ground truth that is mirrored or turned looks like channels in another order on many skins.
    let mut best: Option<(f64, &str)> = None;
    let turns: [(&str, [f64; 2], bool); 4] = [
        ("x is mirrored", [-1.0, 1.0], false),
        ("y is mirrored", [1.0, -1.0], false),
        ("x and y are turned by 180°", [-1.0, -1.0], false),
        ("x and y are exchanged", [1.0, 1.0], true),
    ];
    let frames: Vec<usize> = samples.frames();
    let surface = simulator.skin.surface();
    for (name, signs, exchange) in turns {
        // What was read is of no concern, and may be large.
        let mut other = Recording {
            name: recording.name.clone(),
            channels: recording.channels,
            labels: recording.labels.clone(),
            zero: recording.zero,
            ..Recording::default()
        };
        for m in &mut other.labels {
            for contact in m.stimulus.iter_mut().flat_map(|s| &mut s.contacts) {
                let (p, f) = (contact.position, contact.force);
                let (x, y) = if exchange { (p.y, p.x) } else { (p.x, p.y) };
                let (fx, fy) = if exchange { (f.y, f.x) } else { (f.x, f.y) };
                contact.position.x = signs[0] * x;
                contact.position.y = signs[1] * y;
                contact.force.x = signs[0] * fx;
                contact.force.y = signs[1] * fy;
                contact.position = surface.project(&contact.position).0;
            }
        }
        let Ok(read) = simulator.readings(simulator.skin, &other, &frames) else { continue };
        let agrees = tared(readings, &read, samples, sigma).agreement();
        if best.is_none_or(|b| agrees > b.0) {
            best = Some((agrees, name));
        }
    }
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
    use dermis_model::{Indentation, Stimulus};
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::recording::{FrameLabel, Zero};
    use crate::samples::SampleOptions;
    use crate::testing::{EFFECTS, gains, recorded, skin, small};

    /// Twelve presses in two sessions, of two tips, with everything that a recording can have.
    fn whole() -> Recording {
        let mut recording = Recording::new("whole", 1);
        recording.sessions = vec!["one".to_owned(), "two".to_owned()];
        for i in 0..12 * 300_u32 {
            let (press, within) = (u64::from(i / 300), i % 300);
            let touched = within >= 100;
            let contact = |x: f64| {
                Indentation::sphere(
                    Point3::new(x, 0.0, 0.0),
                    Vector3::new(0.0, 0.0, -1.0),
                    if press < 6 { 0.004 } else { 0.008 },
                )
            };
            let mut contacts = if touched { vec![contact(0.0)] } else { Vec::new() };
            if touched && press == 3 {
                contacts.push(contact(0.01));
            }
            let temperature = 293.0 + f64::from(i) * 1e-3;
            recording.push(
                FrameLabel {
                    time: f64::from(i) * 0.01,
                    run: 0,
                    press,
                    location: 1,
                    phase: if touched { Phase::Hold } else { Phase::Idle },
                    stimulus: Some(Stimulus { contacts, temperature, ..Stimulus::default() }),
                    temperature,
                },
                &[0.0],
            );
            recording.session.push(u32::from(press >= 6));
        }
        recording
    }

    fn lacks(repeats: usize, change: impl FnOnce(&mut Recording)) -> Vec<String> {
        let mut recording = whole();
        change(&mut recording);
        let samples = Samples::draw(&recording, &[true], &SampleOptions::default());
        missing(&recording, &samples, repeats).into_iter().map(|m| m.what).collect()
    }

    #[test]
    fn what_is_missing_is_said_and_nothing_else() {
        assert_eq!(lacks(10, |_| ()), [""; 0]);
        assert!(lacks(9, |_| ())[0].starts_with("repeats"));
        assert_eq!(
            lacks(10, |r| {
                r.sessions.pop();
            }),
            ["a second session"]
        );
        let each = |change: fn(&mut FrameLabel)| lacks(10, |r| r.labels.iter_mut().for_each(change));
        assert_eq!(each(|m| m.temperature = f64::NAN), ["the temperature"]);
        assert_eq!(each(|m| m.temperature = 293.0), ["a temperature that changes"]);
        assert_eq!(
            each(|m| m.stimulus.iter_mut().for_each(|s| s.contacts.truncate(1))),
            ["several contacts at once"]
        );
        assert_eq!(
            each(|m| m
                .stimulus
                .iter_mut()
                .flat_map(|s| &mut s.contacts)
                .for_each(|c| c.tip = dermis_model::Tip::sphere(0.004))),
            ["a second tip"]
        );
        // Presses of half a second, and no pause that is longer than a frame.
        assert_eq!(each(|m| m.time *= 0.25), ["presses that are held for a second or more"]);
        let busy = lacks(10, |r| {
            for m in r.labels.iter_mut().filter(|m| m.phase == Phase::Idle) {
                m.phase = Phase::Approach;
            }
        });
        assert_eq!(busy, ["windows without contact, at least half a second each"]);
    }

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
