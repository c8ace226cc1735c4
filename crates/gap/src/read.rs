//! Bags → recordings.

use std::path::{Path, PathBuf};

use dermis_bag::{BagReader, BagSkin, Filter, SkinChoice};
use dermis_learn::{Dataset, DatasetOptions, LabelMap};
use dermis_model::{Indentation as Touch, Stimulus, Tip};
use dermis_msgs::msg::{Indentation, TaxelFrame};
use dermis_msgs::{Message, TypeSupport};
use dermis_skin::{Frame, Phase, SkinDescription, Stamp, Surface};
use nalgebra::{Point3, Vector3};

use crate::GapError;
use crate::constants::reading::{
    CHANGES, HELD, MILLIMETRES, OFF_SURFACE, PULLS, SAME_TIME, TIP, WRONG_FRAME,
};
use crate::recording::{FrameLabel, Problem, Recording};

/// One frame as a bag gives it.
struct Raw {
    stamp: Stamp,
    values: Vec<f32>,
    temperature: f64,
}

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
                own(bag.as_ref(), skin, instance, &mut recording)?;
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

fn own(
    path: &Path,
    skin: &SkinDescription,
    instance: Option<&str>,
    recording: &mut Recording,
) -> Result<(), GapError> {
    let place = path.display().to_string();
    let wrong = |reason: String| GapError::Recording { place: place.clone(), reason };
    let bag = BagReader::open(path)?;
    let wanted = [TypeSupport::of::<TaxelFrame>(), TypeSupport::of::<Indentation>()];
    for support in &wanted {
        for topic in bag.topics().iter().filter(|t| t.type_name == support.name) {
            bag.check_type(topic, support)?;
        }
    }
    let skins = bag.skins()?;
    let choice = SkinChoice { instance, topic: None, type_name: skin.type_name() };
    let chosen = choice.of(&skins, |hash, name| skin.is_type(hash, name));
    let chosen = chosen.map_err(|error| {
        wrong(format!("{error}; `--skin-instance` names one, `dermis bag info` lists them"))
    })?;
    let topics: Vec<&str> = chosen.topics_of::<TaxelFrame>().collect();
    if topics.len() > 1 {
        return Err(wrong(format!(
            "frames of skin `{}` come on several topics: {}: two skins would be taken for one; give them names of their own \
             (`instance`), or cut one out with `dermis bag slice --topics`",
            chosen.name,
            topics.join(", ")
        )));
    }
    let alone = skins.iter().filter(|s| s.topics_of::<TaxelFrame>().next().is_some()).count() == 1;
    let (mut frames, mut truths, mut layout) = (Vec::new(), Vec::new(), None);
    let expected: Vec<&str> = skin.channels().iter().map(|c| c.name.as_str()).collect();
    for message in bag.messages_where(Filter::default().types(wanted.iter().map(|s| s.name))) {
        let message = message?;
        if *message.type_name == *TaxelFrame::TYPE_NAME {
            let frame: TaxelFrame = message.decode()?;
            if frame.skin != chosen.name {
                continue;
            }
            if frame.values.len() != expected.len() {
                return Err(wrong(format!(
                    "its frames have {} channels where skin `{}` has {}: pass the description that it was recorded with",
                    frame.values.len(),
                    skin.name,
                    expected.len()
                )));
            }
            match layout {
                None => named_otherwise(&frame, chosen, skin, &place, recording)?,
                Some(first) if first != frame.layout_id => {
                    return Err(wrong(format!(
                        "frame {} has the channel layout {:08x} where those before have {first:08x}: the skin was changed in the \
                         middle; cut the bag there with `dermis bag slice`",
                        frame.sequence, frame.layout_id
                    )));
                }
                Some(_) => {}
            }
            layout = Some(frame.layout_id);
            let stamp = frame.header.stamp.as_nanos();
            let frame = Frame::from(&frame);
            let values = frame.values.iter().zip(&frame.flags);
            let values = values.map(|(v, f)| if f.is_invalid() { f32::NAN } else { *v }).collect();
            frames.push(Raw { stamp, values, temperature: f64::from(frame.temperature) });
        } else {
            let truth: Indentation = message.decode()?;
            // What presses the only skin may know its type only.
            if truth.skin == chosen.name || alone && truth.skin == skin.type_name() {
                truths.push(truth);
            }
        }
    }
    if frames.is_empty() {
        return Err(wrong(format!("holds no frames of skin `{}`", chosen.name)));
    }
    if truths.is_empty() {
        return Err(wrong(format!(
            "holds no ground truth (dermis_msgs/msg/Indentation) of skin `{}`: name a robot's and a force sensor's topics in \
             a file and pass it as `--map`",
            chosen.name
        )));
    }
    // Frames stay in the order in which they were recorded, so that a clock that runs backwards shows; truth is looked up.
    truths.sort_by_key(|t| t.header.stamp.as_nanos());
    let run = recording.labels.last().map_or(0, |m| m.run + 1);
    // A bag may hold several sessions, and several bags sessions of one name.
    let first_session = recording.sessions.len();
    let mut names: Vec<&String> = Vec::new();
    for truth in &truths {
        let name = if truth.session.is_empty() { &place } else { &truth.session };
        if !names.contains(&name) {
            names.push(name);
            // The same plan makes sessions of one name, and they are two all the same.
            let taken = recording.sessions.contains(name);
            recording.sessions.push(if taken {
                format!("{name} ({run})", run = run + 1)
            } else {
                name.clone()
            });
        }
    }
    let mut session = first_session;
    let begin = frames[0].stamp;
    let tolerance = ((SAME_TIME[0] / skin.rate).max(SAME_TIME[1]) * 1e9) as Stamp;
    let surface = skin.surface();
    let mut doubts = Doubts::default();
    for frame in frames {
        let after = truths.partition_point(|t| t.header.stamp.as_nanos() < frame.stamp);
        let near = [after.checked_sub(1), Some(after)];
        let near = near.into_iter().flatten().filter_map(|i| truths.get(i));
        let away = |t: &&Indentation| t.header.stamp.as_nanos().saturating_sub(frame.stamp).saturating_abs();
        let truth = near.min_by_key(away).filter(|t| away(t) <= tolerance);
        let mut label = FrameLabel {
            time: frame.stamp.saturating_sub(begin) as f64 * 1e-9,
            run,
            press: 0,
            location: 0,
            phase: Phase::Idle,
            stimulus: None,
            temperature: frame.temperature,
        };
        match truth {
            None => doubts.unknown += 1,
            Some(truth) => {
                let name = if truth.session.is_empty() { &place } else { &truth.session };
                let within = names.iter().position(|n| *n == name);
                session = first_session + within.unwrap_or(0);
                label.press = truth.press;
                label.location = truth.location;
                label.phase = phase(truth.phase, !truth.contacts.is_empty());
                if truth.temperature.is_finite() {
                    label.temperature = f64::from(truth.temperature);
                }
                let contacts = truth.contacts.iter().map(|c| {
                    let position = Point3::new(c.position.x, c.position.y, c.position.z);
                    Touch::sphere(position, Vector3::new(c.force.x, c.force.y, c.force.z), c.diameter)
                });
                label.stimulus = stimulus(contacts.collect(), label.temperature, &surface, &mut doubts);
            }
        }
        recording.push(label, &frame.values);
        recording.session.push(session as u32);
    }
    doubts.report(&place, recording);
    Ok(())
}

/// Says where a bag names its channels otherwise than the skin does, and refuses another unit.
fn named_otherwise(
    frame: &TaxelFrame,
    sender: &BagSkin,
    skin: &SkinDescription,
    place: &str,
    recording: &mut Recording,
) -> Result<(), GapError> {
    let Some(reason) = skin.layout_mismatch(frame, &sender.layouts) else { return Ok(()) };
    let Some(layout) = sender.layouts.get(&frame.layout_id) else {
        return Err(GapError::Recording {
            place: place.to_owned(),
            reason: format!(
                "{reason}: readings would be taken for those of others; pass the description that it was recorded with"
            ),
        });
    };
    let expected: Vec<&str> = skin.channels().iter().map(|c| c.name.as_str()).collect();
    if layout.channels.iter().map(String::as_str).ne(expected.iter().copied()) {
        recording.problems.push(Problem::fatal(
            "channel-names",
            format!(
                "{place}: its channels are named {} where skin `{}` has {}: readings would be taken for those of others; \
                 pass the description that it was recorded with",
                layout.channels.iter().take(4).cloned().collect::<Vec<_>>().join(", "),
                skin.name,
                expected.iter().take(4).copied().collect::<Vec<_>>().join(", ")
            ),
        ));
    }
    if !layout.unit.is_empty() && layout.unit != skin.unit {
        return Err(GapError::Recording {
            place: place.to_owned(),
            reason: format!(
                "its readings are in \"{}\" where skin `{}` is in \"{}\"",
                layout.unit, skin.name, skin.unit
            ),
        });
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
                format!("{place}: the tip's diameter is not known; 4 mm are assumed, so that its size cannot be told"),
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

/// What touches, on the surface; `None` where that cannot be told.
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

fn phase(code: u8, touched: bool) -> Phase {
    match code {
        Indentation::PHASE_IDLE if !touched => Phase::Idle,
        Indentation::PHASE_LOAD => Phase::Load,
        Indentation::PHASE_SLIDE => Phase::Slide,
        Indentation::PHASE_UNLOAD => Phase::Unload,
        _ if touched => Phase::Hold,
        _ => Phase::Approach,
    }
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
