//! Bags that hold their ground truth as `dermis_msgs/msg/Indentation` → recordings.

use std::path::Path;

use dermis_bag::{BagReader, BagSkin, Filter, Messages, SkinChoice};
use dermis_model::{Indentation as Touch, Tip, TipShape};
use dermis_msgs::msg::{Indentation, IndentationContact, TaxelFrame};
use dermis_msgs::{Message, TypeSupport};
use dermis_skin::{Frame, Phase, SkinDescription, Stamp, Surface};
use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};

use super::{Doubts, stimulus};
use crate::GapError;
use crate::constants::reading::SAME_TIME;
use crate::recording::{FrameLabel, Problem, Recording};

/// One frame as a bag gives it.
struct Raw {
    stamp: Stamp,
    values: Vec<f32>,
    temperature: f64,
}

/// The skin in a bag that is meant.
struct Source<'a> {
    /// Which bag.
    place: &'a str,
    skin: &'a SkinDescription,
    /// The device as the bag knows it.
    chosen: &'a BagSkin,
    /// Whether no other skin of the bag has frames.
    alone: bool,
}

/// Adds a bag with ground truth of its own to a recording.
pub(super) fn own(
    path: &Path,
    skin: &SkinDescription,
    instance: Option<&str>,
    recording: &mut Recording,
) -> Result<(), GapError> {
    let place = path.display().to_string();
    let bag = BagReader::open(path)?;
    let wanted = [TypeSupport::of::<TaxelFrame>(), TypeSupport::of::<Indentation>()];
    for support in &wanted {
        for topic in bag.topics().iter().filter(|t| t.type_name == support.name) {
            bag.check_type(topic, support)?;
        }
    }
    let skins = bag.skins()?;
    let chosen = meant(&skins, skin, instance, &place)?;
    let alone = skins.iter().filter(|s| s.topics_of::<TaxelFrame>().next().is_some()).count() == 1;
    let source = Source { place: &place, skin, chosen, alone };
    let messages = bag.messages_where(Filter::default().types(wanted.iter().map(|s| s.name)));
    let (frames, truths) = source.frames_and_truths(messages, recording)?;
    source.label(&frames, &truths, recording);
    Ok(())
}

fn wrong(place: &str, reason: String) -> GapError {
    GapError::Recording { place: place.to_owned(), reason }
}

/// The device of a bag that is meant, whose frames come on one topic.
fn meant<'s>(
    skins: &'s [BagSkin],
    skin: &SkinDescription,
    instance: Option<&str>,
    place: &str,
) -> Result<&'s BagSkin, GapError> {
    let choice = SkinChoice { instance, topic: None, type_name: skin.type_name() };
    let chosen = choice.of(skins, |hash, name| skin.is_type(hash, name)).map_err(|error| {
        wrong(place, format!("{error}; `--skin-instance` names one, `dermis bag info` lists them"))
    })?;
    let topics: Vec<&str> = chosen.topics_of::<TaxelFrame>().collect();
    if topics.len() > 1 {
        return Err(wrong(
            place,
            format!(
                "frames of skin `{}` come on several topics: {}: two skins would be taken for one; give them names of their own \
                 (`instance`), or cut one out with `dermis bag slice --topics`",
                chosen.name,
                topics.join(", ")
            ),
        ));
    }
    Ok(chosen)
}

impl Source<'_> {
    /// Its frames in the order in which they were recorded, so that a clock that runs backwards shows, and its ground truth in
    /// that of time.
    fn frames_and_truths(
        &self,
        messages: Messages,
        recording: &mut Recording,
    ) -> Result<(Vec<Raw>, Vec<Indentation>), GapError> {
        let (mut frames, mut truths, mut layout) = (Vec::new(), Vec::new(), None);
        for message in messages {
            let message = message?;
            if *message.type_name == *TaxelFrame::TYPE_NAME {
                let frame: TaxelFrame = message.decode()?;
                if frame.skin != self.chosen.name {
                    continue;
                }
                self.check_layout(&frame, layout, recording)?;
                layout = Some(frame.layout_id);
                let stamp = frame.header.stamp.as_nanos();
                let frame = Frame::from(&frame);
                let values = frame.values.iter().zip(&frame.flags);
                let values = values.map(|(v, f)| if f.is_invalid() { f32::NAN } else { *v }).collect();
                frames.push(Raw { stamp, values, temperature: f64::from(frame.temperature) });
            } else {
                let truth: Indentation = message.decode()?;
                // What presses the only skin may know its type only.
                if truth.skin == self.chosen.name || self.alone && truth.skin == self.skin.type_name() {
                    truths.push(truth);
                }
            }
        }
        if frames.is_empty() {
            return Err(wrong(self.place, format!("holds no frames of skin `{}`", self.chosen.name)));
        }
        if truths.is_empty() {
            return Err(wrong(
                self.place,
                format!(
                    "holds no ground truth (dermis_msgs/msg/Indentation) of skin `{}`: name a robot's and a force sensor's topics in \
                     a file and pass it as `--map`",
                    self.chosen.name
                ),
            ));
        }
        truths.sort_by_key(|t| t.header.stamp.as_nanos());
        Ok((frames, truths))
    }

    /// Refuses a frame whose channels are not the skin's, or not those of the frames before it.
    fn check_layout(
        &self,
        frame: &TaxelFrame,
        before: Option<u32>,
        recording: &mut Recording,
    ) -> Result<(), GapError> {
        let expected = self.skin.channels().len();
        if frame.values.len() != expected {
            return Err(wrong(
                self.place,
                format!(
                    "its frames have {} channels where skin `{}` has {expected}: pass the description that it was recorded with",
                    frame.values.len(),
                    self.skin.name
                ),
            ));
        }
        match before {
            None => self.named_otherwise(frame, recording),
            Some(first) if first != frame.layout_id => Err(wrong(
                self.place,
                format!(
                    "frame {} has the channel layout {:08x} where those before have {first:08x}: the skin was changed in the \
                     middle; cut the bag there with `dermis bag slice`",
                    frame.sequence, frame.layout_id
                ),
            )),
            Some(_) => Ok(()),
        }
    }

    /// Says where a bag names its channels otherwise than the skin does, and refuses another unit.
    fn named_otherwise(&self, frame: &TaxelFrame, recording: &mut Recording) -> Result<(), GapError> {
        let Self { place, skin, chosen, .. } = self;
        let Some(reason) = skin.layout_mismatch(frame, &chosen.layouts) else { return Ok(()) };
        let Some(layout) = chosen.layouts.get(&frame.layout_id) else {
            return Err(wrong(
                place,
                format!(
                    "{reason}: readings would be taken for those of others; pass the description that it was recorded with"
                ),
            ));
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
            return Err(wrong(
                place,
                format!(
                    "its readings are in \"{}\" where skin `{}` is in \"{}\"",
                    layout.unit, skin.name, skin.unit
                ),
            ));
        }
        Ok(())
    }

    /// Adds the frames to a recording, each with the ground truth that is nearest in time.
    fn label(&self, frames: &[Raw], truths: &[Indentation], recording: &mut Recording) {
        let run = recording.labels.last().map_or(0, |m| m.run + 1);
        let first_session = recording.sessions.len();
        let names = self.sessions(truths, run, recording);
        let mut session = first_session;
        let begin = frames.first().map_or(0, |frame| frame.stamp);
        let tolerance = ((SAME_TIME[0] / self.skin.rate).max(SAME_TIME[1]) * 1e9) as Stamp;
        let surface = self.skin.surface();
        let mut doubts = Doubts::default();
        for frame in frames {
            let mut label = FrameLabel {
                time: frame.stamp.saturating_sub(begin) as f64 * 1e-9,
                run,
                press: 0,
                location: 0,
                phase: Phase::Idle,
                stimulus: None,
                temperature: frame.temperature,
            };
            match nearest(truths, frame.stamp, tolerance) {
                None => doubts.unknown += 1,
                Some(truth) => {
                    let within = names.iter().position(|n| *n == self.session(truth));
                    session = first_session + within.unwrap_or(0);
                    describe(&mut label, truth, &surface, &mut doubts);
                }
            }
            recording.push(label, &frame.values);
            recording.session.push(session as u32);
        }
        doubts.report(self.place, recording);
    }

    /// Adds the sessions of the bag to a recording, and says what its ground truth calls them: a bag may hold several sessions, and
    /// several bags sessions of one name.
    fn sessions<'t>(
        &'t self,
        truths: &'t [Indentation],
        run: u32,
        recording: &mut Recording,
    ) -> Vec<&'t str> {
        let mut names: Vec<&str> = Vec::new();
        for truth in truths {
            let name = self.session(truth);
            if !names.contains(&name) {
                names.push(name);
                // The same plan makes sessions of one name, and they are two all the same.
                let taken = recording.sessions.iter().any(|session| session == name);
                recording.sessions.push(if taken {
                    format!("{name} ({run})", run = run + 1)
                } else {
                    name.to_owned()
                });
            }
        }
        names
    }

    /// What the ground truth calls its session.
    fn session<'t>(&'t self, truth: &'t Indentation) -> &'t str {
        if truth.session.is_empty() { self.place } else { &truth.session }
    }
}

/// The ground truth, in the order of time, that is nearest to a moment, within a tolerance \[ns\].
fn nearest(truths: &[Indentation], stamp: Stamp, tolerance: Stamp) -> Option<&Indentation> {
    let after = truths.partition_point(|t| t.header.stamp.as_nanos() < stamp);
    let near = [after.checked_sub(1), Some(after)];
    let near = near.into_iter().flatten().filter_map(|i| truths.get(i));
    let away = |t: &&Indentation| t.header.stamp.as_nanos().saturating_sub(stamp).saturating_abs();
    near.min_by_key(away).filter(|t| away(t) <= tolerance)
}

/// Labels a frame with what its ground truth says.
fn describe(label: &mut FrameLabel, truth: &Indentation, surface: &Surface, doubts: &mut Doubts) {
    label.press = truth.press;
    label.location = truth.location;
    label.phase = phase(truth.phase, !truth.contacts.is_empty());
    if truth.temperature.is_finite() {
        label.temperature = f64::from(truth.temperature);
    }
    let contacts = truth.contacts.iter().map(touch);
    label.stimulus = stimulus(contacts.collect(), label.temperature, surface, doubts);
}

/// What touches, as the ground truth of a bag says it. A tip that is neither a ball nor the flat end of a rod is taken for a ball
/// of its diameter.
#[must_use]
pub fn touch(c: &IndentationContact) -> Touch {
    let position = Point3::new(c.position.x, c.position.y, c.position.z);
    let mut touch = Touch::sphere(position, Vector3::new(c.force.x, c.force.y, c.force.z), c.diameter);
    if c.tip == IndentationContact::TIP_FLAT {
        let shape = TipShape::FlatPunch { diameter: c.diameter };
        let q = &c.tip_pose.orientation;
        let turned = Quaternion::new(q.w, q.x, q.y, q.z);
        touch.tip = if turned.norm() > 0.5 {
            Tip { shape, orientation: UnitQuaternion::from_quaternion(turned) }
        } else {
            Tip::standing(shape, &Vector3::new(c.normal.x, c.normal.y, c.normal.z))
        };
    }
    touch
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_tip_is_read_as_one_however_it_was_written() {
        let contact = |tip: u8| IndentationContact { tip, diameter: 0.02, ..IndentationContact::default() };
        assert_eq!(touch(&contact(IndentationContact::TIP_SPHERE)).tip.as_sphere(), Some(0.02));
        let flat = TipShape::FlatPunch { diameter: 0.02 };
        let mut written = contact(IndentationContact::TIP_FLAT);
        written.normal.x = 1.0;
        // Where no pose was written, it stands straight on the surface.
        for w in [0.0, 1.0] {
            written.tip_pose.orientation.w = w;
            let read = touch(&written).tip;
            assert_eq!(read.shape, flat);
            let away = read.orientation * Vector3::z();
            let wanted = if w == 0.0 { Vector3::x() } else { Vector3::z() };
            assert!((away - wanted).norm() < 1e-9, "{away}");
        }
    }
}
