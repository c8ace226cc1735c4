//! Recordings that would make a diagnosis confidently wrong, and what one lacks.

mod agreement;

use dermis_skin::{Phase, SkinDescription};
use serde::{Deserialize, Serialize};

use crate::constants::check::{
    FEWEST_PRESSES, FEWEST_SAMPLES, IDLE, KELVIN, LONG_HOLD, NEVER_CHANGES, NO_NUMBER,
};
use crate::constants::noise::REPEATS;
use crate::recording::{Problem, Recording};
use crate::samples::Samples;

pub use agreement::agreement;

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
    if held < LONG_HOLD {
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

#[cfg(test)]
mod tests {
    use dermis_model::{Indentation, Stimulus};
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::recording::FrameLabel;
    use crate::samples::SampleOptions;

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
}
