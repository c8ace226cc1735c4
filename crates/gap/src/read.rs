//! Bags → recordings.

mod labelled;

use std::path::{Path, PathBuf};

use dermis_learn::{Dataset, DatasetOptions, LabelMap};
use dermis_model::{Indentation as Touch, Stimulus, Tip};
use dermis_skin::{Phase, SkinDescription, Surface};

use crate::GapError;
use crate::constants::reading::{CHANGES, HELD, MILLIMETRES, OFF_SURFACE, PULLS, TIP, WRONG_FRAME};
use crate::recording::{FrameLabel, Problem, Recording};

pub use labelled::touch;

/// Reads labelled bags of one skin. Ground truth is `dermis_msgs/msg/Indentation`, or what a robot's and a force sensor's topics
/// say by `map`. `instance` names the device, where a bag holds several of the skin's type.
///
/// # Errors
///
/// [`GapError::Bag`] where a bag cannot be read, [`GapError::Recording`] where it holds no frames or no ground truth of this
/// skin, [`GapError::Learn`] where a mapped bag cannot be joined. What is wrong with the readings themselves is in
/// [`Recording::problems`].
pub fn read(
    bags: &[impl AsRef<Path>],
    skin: &SkinDescription,
    map: Option<&LabelMap>,
    instance: Option<&str>,
) -> Result<Recording, GapError> {
    let names: Vec<String> = bags
        .iter()
        .map(|b| b.as_ref().file_name().unwrap_or(b.as_ref().as_os_str()).to_string_lossy().into_owned())
        .collect();
    twice(bags)?;
    let mut recording = Recording::new(names.join(", "), skin.channels().len());
    match map {
        Some(map) => mapped(bags, skin, map, instance, &mut recording)?,
        None => {
            for bag in bags {
                labelled::own(bag.as_ref(), skin, instance, &mut recording)?;
            }
        }
    }
    Ok(recording)
}

/// Refuses a bag that is named twice: its presses would count as repeats that agree perfectly.
fn twice(bags: &[impl AsRef<Path>]) -> Result<(), GapError> {
    let mut seen: Vec<PathBuf> = Vec::new();
    for bag in bags {
        let path = bag.as_ref().canonicalize().unwrap_or_else(|_| bag.as_ref().to_owned());
        if seen.contains(&path) {
            return Err(GapError::Recording {
                place: bag.as_ref().display().to_string(),
                reason:
                    "is named twice: its presses would be repeats of themselves; name each recording once"
                        .to_owned(),
            });
        }
        seen.push(path);
    }
    Ok(())
}

/// What was found odd about ground truth.
#[derive(Default)]
pub(crate) struct Doubts {
    unknown: usize,
    contacts: usize,
    /// Off the surface by more than a mould is, and the largest such distance \[m\].
    off: usize,
    farthest: f64,
    pulls: usize,
    odd: usize,
    tips: usize,
}

impl Doubts {
    pub(crate) fn report(&self, place: &str, recording: &mut Recording) {
        let share = |n: usize| 100.0 * n as f64 / self.contacts.max(1) as f64;
        if share(self.off) > 100.0 * WRONG_FRAME[0] {
            let far = self.farthest;
            let guess = if far > MILLIMETRES { "millimetres instead of metres, or " } else { "" };
            recording.problems.push(Problem::fatal(
                "frame",
                format!(
                    "{place}: {:.0} % of the true contacts lie off the surface of the skin, by up to {far:.4} m: the ground truth \
                     is in {guess}another frame than the skin's link; transform it",
                    share(self.off)
                ),
            ));
        }
        if share(self.pulls) > 100.0 * WRONG_FRAME[1] {
            recording.problems.push(Problem::fatal(
                "frame",
                format!(
                    "{place}: {:.0} % of the true contacts pull: their force is that of the skin on the tip, or in another frame; \
                     turn its sign",
                    share(self.pulls)
                ),
            ));
        }
        if share(self.odd) > 1.0 {
            recording.problems.push(Problem::note(
                "not-finite",
                format!("{place}: {:.1} % of the true contacts have no position or force", share(self.odd)),
            ));
        }
        if self.tips > 0 {
            recording.problems.push(Problem::note(
                "tip",
                format!("{place}: the tip's diameter is not known; 4 mm are assumed, so that its size cannot be identified"),
            ));
        }
        if self.unknown > 0 {
            recording.problems.push(Problem::note(
                "no-truth",
                format!("{place}: {} frames have no ground truth near them and are left out", self.unknown),
            ));
        }
    }
}

/// What touches, on the surface; `None` where that is not known.
pub(crate) fn stimulus(
    contacts: Vec<Touch>,
    temperature: f64,
    surface: &Surface,
    doubts: &mut Doubts,
) -> Option<Stimulus> {
    let mut kept = Vec::with_capacity(contacts.len());
    for mut contact in contacts {
        doubts.contacts += 1;
        if !contact.position.iter().chain(contact.force.iter()).all(|v| v.is_finite()) {
            doubts.odd += 1;
            return None;
        }
        let (on, normal) = surface.project(&contact.position);
        let off = (on - contact.position).norm();
        if off > OFF_SURFACE {
            doubts.off += 1;
            doubts.farthest = doubts.farthest.max(off);
        }
        contact.position = on;
        if !(contact.diameter().is_finite() && contact.diameter() > 0.0) {
            doubts.tips += 1;
            contact.tip = Tip::sphere(TIP);
        }
        // What pulls is noise of the force cell around nothing, unless there is a lot of it.
        let pressing = -contact.force.dot(&normal);
        if pressing <= 0.0 {
            doubts.pulls += usize::from(pressing < -PULLS);
            continue;
        }
        kept.push(contact);
    }
    let standard = Stimulus::default();
    let temperature = if temperature.is_finite() { temperature } else { standard.temperature };
    Some(Stimulus { contacts: kept, temperature, ..standard })
}

/// Bags whose ground truth is a robot's pose and a force sensor's wrench: phases follow from the force.
fn mapped(
    bags: &[impl AsRef<Path>],
    skin: &SkinDescription,
    map: &LabelMap,
    instance: Option<&str>,
    recording: &mut Recording,
) -> Result<(), GapError> {
    let options = DatasetOptions {
        map: Some(map.clone()),
        instance: instance.map(str::to_owned),
        // A recording holds every frame.
        most_frames: usize::MAX,
        ..DatasetOptions::default()
    };
    let data = Dataset::from_bags(bags, skin, &options)?;
    recording.problems.extend(data.notices().into_iter().map(|n| Problem::note("data", n)));
    let surface = skin.surface();
    for (run, read) in data.runs().iter().enumerate() {
        recording.sessions.push(read.session.clone());
        let begin = read.samples.first().map_or(0, |s| s.stamp);
        let mut doubts = Doubts::default();
        let first = recording.labels.len();
        for sample in data.stream(run)? {
            let sample = sample?;
            let mut label = FrameLabel {
                time: (sample.frame.stamp - begin) as f64 * 1e-9,
                run: run as u32,
                press: 0,
                location: 0,
                phase: Phase::Approach,
                stimulus: None,
                temperature: f64::from(sample.frame.temperature),
            };
            match &sample.truth {
                None => doubts.unknown += 1,
                Some(truth) => {
                    (label.press, label.location) = (truth.press, truth.location);
                    label.phase = match (truth.touched(), truth.idle) {
                        (true, _) => Phase::Hold,
                        (false, true) => Phase::Idle,
                        (false, false) => Phase::Approach,
                    };
                    let contacts = truth.contacts.iter().map(|c| {
                        let pressing = c.normal_force().unwrap_or(f64::NAN);
                        let full = c.force.iter().all(|v| v.is_finite());
                        let force = if full { c.force } else { -c.normal * pressing };
                        Touch::sphere(c.position, force, c.diameter)
                    });
                    label.stimulus = stimulus(contacts.collect(), label.temperature, &surface, &mut doubts);
                }
            }
            let values: Vec<f32> = sample.frame.values.clone();
            recording.push(label, &values);
        }
        by_force(&mut recording.labels[first..]);
        doubts.report(&read.path.display().to_string(), recording);
    }
    Ok(())
}

/// Distinguishes loading, holding and unloading by the change of the force.
fn by_force(labels: &mut [FrameLabel]) {
    let force: Vec<f64> = labels.iter().map(FrameLabel::force).collect();
    for i in 0..labels.len() {
        if !labels[i].phase.touched() {
            continue;
        }
        let (a, b) = (force[i.saturating_sub(2)], force[(i + 2).min(force.len() - 1)]);
        let change = (b - a) / force[i].max(1e-9);
        labels[i].phase = if change > CHANGES * HELD {
            Phase::Load
        } else if change < -CHANGES * HELD {
            Phase::Unload
        } else {
            Phase::Hold
        };
    }
}
