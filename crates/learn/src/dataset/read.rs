//! Reads a bag once: ground truth, and what is known of its frames.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use dermis_bag::{BagReader, BagSkin, Filter, SkinChoice, SkinChoiceError};
use dermis_msgs::geometry_msgs::msg::{TransformStamped, WrenchStamped};
use dermis_msgs::msg::{Contact as ContactMsg, Indentation, IndentationContact, SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::Image as ImageMsg;
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::{Message, TypeSupport};
use dermis_skin::{ForceComponents, Frame, SkinDescription, Stamp};
use nalgebra::{Point3, Vector3};
use sha2::{Digest, Sha256};

use super::recording::Recording;
use super::stream::{BagFrames, infos};
use super::{DatasetOptions, Run, Truth, TruthContact, hex};
use crate::LearnError;
use crate::findings::{self, Findings};
use crate::map::{self, Locations, Readings};

/// What one bag holds for a skin, before it is joined.
#[derive(Default)]
struct Contents {
    frames: Recording,
    truths: Vec<(Stamp, Truth)>,
    rig: Readings,
    /// Frames of the skin by topic.
    topics: BTreeMap<String, usize>,
    /// Topic of the images that belong to them.
    images: Option<String>,
    /// Other skins that the bag holds.
    others: BTreeSet<String>,
    sessions: BTreeSet<String>,
    geometry: Option<String>,
    /// Device whose frames these are.
    instance: String,
    /// Why no frames were taken.
    choice: Option<SkinChoiceError>,
    /// Frames and ground truth without a stamp.
    unstamped: [u64; 2],
    /// First frame that is not as the skin's description says.
    mismatch: Option<String>,
}

impl Contents {
    fn read(
        path: &Path,
        skin: &SkinDescription,
        options: &DatasetOptions,
        hasher: &mut Sha256,
        memory: usize,
    ) -> Result<Self, LearnError> {
        let bag = BagReader::open(path)?;
        let mut found = Self::default();
        found.frames.held = Some(Vec::new());
        let mut wanted = vec![
            TypeSupport::of::<TaxelFrame>(),
            TypeSupport::of::<SkinGeometry>(),
            TypeSupport::of::<Indentation>(),
        ];
        if options.map.is_some() {
            wanted.truncate(2);
            wanted.extend([
                TypeSupport::of::<WrenchStamped>(),
                TypeSupport::of::<TransformStamped>(),
                TypeSupport::of::<TFMessage>(),
            ]);
        }
        for support in &wanted {
            for topic in bag.topics().iter().filter(|t| t.type_name == support.name) {
                bag.check_type(topic, support)?;
            }
        }
        let named = topic_of(options);
        let skins = bag.skins()?;
        let choice = SkinChoice {
            instance: options.instance.as_deref(),
            topic: named.map(String::as_str),
            type_name: skin.type_name(),
        };
        let mut layouts = BTreeMap::new();
        let truths = match choice.of(&skins, |hash, name| skin.is_type(hash, name)) {
            Ok(chosen) => {
                found.instance.clone_from(&chosen.name);
                layouts.clone_from(&chosen.layouts);
                Truths::of(chosen, &skins, named.map(String::as_str), skin)
            }
            Err(error) => {
                found.choice = Some(error);
                return Ok(found);
            }
        };
        for message in bag.messages_where(Filter::default().types(wanted.iter().map(|s| s.name))) {
            let message = message?;
            if *message.type_name == *TaxelFrame::TYPE_NAME {
                let frame: TaxelFrame = message.decode()?;
                if frame.skin != found.instance {
                    found.others.insert(frame.skin);
                } else if named.is_none_or(|topic| **topic == *message.topic) {
                    hasher.update(message.recorded());
                    *found.topics.entry(message.topic.to_string()).or_insert(0) += 1;
                    if found.mismatch.is_none() {
                        found.mismatch = skin.layout_mismatch(&frame, &layouts);
                    }
                    if frame.header.stamp.as_nanos() == 0 {
                        found.unstamped[0] += 1;
                    } else {
                        found.frames.push(Frame::from(&frame), memory);
                    }
                }
            } else if *message.type_name == *Indentation::TYPE_NAME {
                let truth: Indentation = message.decode()?;
                if truths.take(&message.topic, &truth.skin) {
                    hasher.update(message.recorded());
                    found.sessions.insert(truth.session.clone());
                    if truth.header.stamp.as_nanos() == 0 {
                        found.unstamped[1] += 1;
                    } else {
                        found.truths.push((truth.header.stamp.as_nanos(), truth_of(&truth)));
                    }
                }
            } else if *message.type_name == *SkinGeometry::TYPE_NAME {
                if let Ok(message) = message.decode::<SkinGeometry>()
                    && message.skin == found.instance
                {
                    found.geometry = Some(message.skin_hash);
                }
            } else if let Some(map) = &options.map {
                if *message.topic == *map.robot.topic || *message.topic == *map.force.topic {
                    hasher.update(message.recorded());
                }
                found.rig.take(map, &message)?;
            }
        }
        found.truths.sort_by_key(|(stamp, _)| *stamp);
        if let Some(topic) = found.topics.keys().next().filter(|_| found.topics.len() == 1) {
            let beside = format!("{}/image", namespace(topic));
            let image = TypeSupport::of::<ImageMsg>();
            if let Some(topic) = bag.topics().iter().find(|t| t.name == beside && t.type_name == image.name) {
                bag.check_type(topic, image)?;
                found.images = Some(beside);
            }
        }
        Ok(found)
    }

    /// Says what is wrong with the frames themselves.
    fn check_frames(&self, skin: &SkinDescription, place: &str, findings: &mut Findings) {
        if let Some(error) = &self.choice {
            let what = match error {
                SkinChoiceError::Several { .. } => {
                    "two devices would be taken for one; name one of them with `--skin-instance`, or its topic with `--taxels`"
                }
                _ => {
                    "there is nothing to learn from; `--skin-instance` names a device of this type, `dermis bag info` lists them"
                }
            };
            findings.fatal(place, error.to_string(), what);
            return;
        }
        if self.instance != skin.name {
            findings.notice(
                place,
                format!("its frames are of `{}`, a skin of the type `{}`", self.instance, skin.type_name()),
                "",
            );
        }
        if let Some(reason) = &self.mismatch {
            findings.fatal(
                place,
                reason.clone(),
                "the readings cannot be assigned to channels; check the skin description",
            );
        }
        if self.unstamped[0] > 0 {
            findings.fatal(
                place,
                format!("{} frames have no stamp (header.stamp is 0)", self.unstamped[0]),
                "nothing can be joined by acquisition time; let the driver stamp its frames",
            );
        }
        if self.topics.len() > 1 {
            let topics: Vec<&str> = self.topics.keys().map(String::as_str).collect();
            findings.fatal(
                place,
                format!("frames of skin `{}` come on several topics: {}", self.instance, topics.join(", ")),
                "two skins would be taken for one; name one of them with `--taxels`, or skin.taxels of the map",
            );
        }
        if !self.others.is_empty() {
            let others = self.others.iter().map(|s| format!("`{s}`")).collect::<Vec<_>>().join(", ");
            findings.notice(place, format!("also holds frames of {others}"), "they are not used");
        }
        let other = |hash: &&String| !hash.is_empty() && !skin.is_type(hash, &self.instance);
        if let Some(hash) = self.geometry.as_ref().filter(other) {
            findings.notice(
                place,
                format!(
                    "was recorded with another description of skin `{}` ({hash}, here {})",
                    self.instance,
                    skin.hash()
                ),
                "a model of one does not load for the other",
            );
        }
        self.check_channels(skin, place, findings);
    }

    fn check_channels(&self, skin: &SkinDescription, place: &str, findings: &mut Findings) {
        if self.frames.marks.len() < 10 || self.mismatch.is_some() {
            return;
        }
        let (mut silent, mut constant) = (Vec::new(), Vec::new());
        for (i, channel) in skin.channels().iter().enumerate() {
            match self.frames.first.get(i).copied().flatten() {
                None => silent.push(channel.name.as_str()),
                Some(_) if !self.frames.varies[i] => constant.push(channel.name.as_str()),
                Some(_) => {}
            }
        }
        let all = silent.len() + constant.len() == skin.channels().len();
        for (names, what) in [(silent, "never give a number"), (constant, "never change")] {
            if names.is_empty() {
                continue;
            }
            let what =
                format!("{} of {} channels {what}: {}", names.len(), skin.channels().len(), listed(&names));
            if all {
                findings.fatal(place, what, "there is nothing to learn from");
            } else {
                findings.notice(
                    place,
                    what,
                    "a model will not know them; check the wiring before it is trained",
                );
            }
        }
    }
}

/// Topic of the frames, where one is named.
fn topic_of(options: &DatasetOptions) -> Option<&String> {
    options.map.as_ref().and_then(|m| m.skin.taxels.as_ref()).or(options.taxels.as_ref())
}

/// Which ground truth of a bag is that of a device. What presses a skin may know its type only.
struct Truths {
    instance: String,
    type_name: String,
    /// Namespaces of the device's frames, where the type's name is not enough.
    namespaces: Option<BTreeSet<String>>,
    /// Whether the device's own name is not enough either: another one has it too.
    shared: bool,
}

impl Truths {
    fn of(chosen: &BagSkin, skins: &[BagSkin], topic: Option<&str>, skin: &SkinDescription) -> Self {
        let framed = |skin: &&BagSkin| skin.topics_of::<TaxelFrame>().next().is_some();
        let shared = chosen.topics_of::<TaxelFrame>().count() > 1;
        let alone = !shared && skins.iter().filter(framed).count() == 1;
        let topics =
            chosen.topics_of::<TaxelFrame>().filter(|other| topic.is_none_or(|topic| topic == *other));
        Self {
            instance: chosen.name.clone(),
            type_name: skin.type_name().to_owned(),
            namespaces: (!alone).then(|| topics.map(|topic| namespace(topic).to_owned()).collect()),
            shared,
        }
    }

    fn take(&self, topic: &str, skin: &str) -> bool {
        let beside = || self.namespaces.as_ref().is_none_or(|of_frames| of_frames.contains(namespace(topic)));
        skin == self.instance && (!self.shared || beside()) || skin == self.type_name && beside()
    }
}

fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}

/// The first few of many names.
fn listed(names: &[&str]) -> String {
    let mut text = names.iter().take(8).copied().collect::<Vec<_>>().join(", ");
    if names.len() > 8 {
        text.push_str(&format!(" and {} more", names.len() - 8));
    }
    text
}

/// One bag, joined; `None` where it cannot be. `memory` is what is left of [`DatasetOptions::memory`].
pub(super) fn read_run(
    path: &Path,
    skin: &SkinDescription,
    options: &DatasetOptions,
    locations: &mut Locations,
    findings: &mut Findings,
    memory: &mut usize,
) -> Result<Option<Run>, LearnError> {
    let place = &findings::bag(path);
    let mut own = Findings::default();
    let mut hasher = Sha256::new();
    let mut found = Contents::read(path, skin, options, &mut hasher, *memory)?;
    found.check_frames(skin, place, &mut own);
    if found.choice.is_some() {
        findings.extend(own);
        return Ok(None);
    }
    let invalid = found.frames.unhealthy;
    let of_bag = BagFrames {
        instance: found.instance.clone(),
        topic: topic_of(options).cloned(),
        images: found.images.clone(),
        ranks: None,
    };
    let (frames, source) = std::mem::take(&mut found.frames).finish(of_bag, memory);
    let (mut lost, mut gap) = (0_u64, 0);
    for w in frames.windows(2) {
        lost = lost.saturating_add(w[1].sequence.saturating_sub(w[0].sequence).saturating_sub(1));
        gap = gap.max(w[1].stamp.saturating_sub(w[0].stamp));
    }
    if lost > 0 {
        own.notice(
            place,
            format!(
                "{lost} frames ({:.1} %) were lost between device and bag, the longest gap is {:.2} s",
                100.0 * lost as f64 / (lost as f64 + frames.len() as f64),
                gap as f64 * 1e-9
            ),
            "a model that looks back sees steps there",
        );
    }
    let tolerance = options.map.as_ref().map_or_else(
        || options.tolerance.unwrap_or_else(|| (0.5 / skin.rate).max(0.01)),
        |map| map.join.max_gap,
    );
    let stamps: Vec<Stamp> = frames.iter().map(|f| f.stamp).collect();
    let (mut labels, mut bias) = (Vec::new(), None);
    let mut span = found.rig.span();
    if let Some(map) = &options.map {
        (labels, bias) = map::label(&stamps, &mut found.rig, map, skin, locations, place, &mut own);
        hasher.update(serde_json::to_vec(map).unwrap_or_default());
        found.sessions.insert(path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned());
    } else {
        span = found.truths.first().zip(found.truths.last()).map(|((a, _), (b, _))| (*a, *b));
        if found.unstamped[1] > 0 {
            own.fatal(
                place,
                format!("{} ground truth messages have no stamp (header.stamp is 0)", found.unstamped[1]),
                "nothing can be joined by acquisition time",
            );
        } else if found.truths.is_empty() {
            own.fatal(
                place,
                format!(
                    "holds {} frames of skin `{}` but no ground truth (dermis_msgs/msg/Indentation) for it",
                    frames.len(),
                    found.instance
                ),
                "nothing can be learned or measured; record one with `dermis collect`, `dermis import` a labelled \
                 recording, or name a robot's and a force sensor's topics in a file and pass it as `--map`",
            );
        }
        if found.sessions.len() > 1 {
            own.notice(place, format!("holds {} sessions, which count as one run", found.sessions.len()), "");
        }
        labels.extend(stamps.iter().map(|t| truth_at(&found.truths, *t, (tolerance * 1e9) as i64)));
    }
    if own.is_fatal() {
        findings.extend(own);
        return Ok(None);
    }
    let marks = frames.into_iter().map(|m| (m.stamp, m.flags)).collect();
    let samples = infos(marks, labels, skin, options.tare_when_idle);
    let labelled = samples.iter().filter(|s| s.truth.is_some()).count();
    if labelled == 0 {
        let begin = stamps.first().copied().unwrap_or(0);
        let relative = |t: Stamp| t.saturating_sub(begin) as f64 * 1e-9;
        let (from, to) = span.unwrap_or_default();
        own.fatal(
            place,
            format!(
                "none of {} frames has ground truth within {tolerance} s of its stamp: frames reach from 0 to {:.2} s, \
                 the ground truth from {:.2} to {:.2} s after the first frame",
                samples.len(),
                relative(stamps.last().copied().unwrap_or(begin)),
                relative(from),
                relative(to)
            ),
            "check that both were stamped by the same clock",
        );
        findings.extend(own);
        return Ok(None);
    }
    if labelled < samples.len() {
        own.notice(
            place,
            format!(
                "{} of {} frames have no ground truth within {tolerance} s",
                samples.len() - labelled,
                samples.len()
            ),
            "they are used as history only",
        );
    }
    let several = samples.iter().filter(|s| s.truth.as_ref().is_some_and(|t| t.contacts.len() > 1)).count();
    if several > 0 {
        own.notice(
            place,
            format!("{several} frames have several contacts"),
            "they only count for the target `contact`",
        );
    }
    if invalid > 0 {
        own.notice(place, format!("{invalid} frames have channels that are not healthy"), "");
    }
    findings.extend(own);
    let session = found.sessions.into_iter().collect::<Vec<_>>().join("+");
    Ok(Some(Run { path: path.into(), session, hash: hex(&hasher.finalize()), samples, lost, bias, source }))
}

fn truth_of(message: &Indentation) -> Truth {
    let contacts: Vec<TruthContact> = message
        .contacts
        .iter()
        .map(|c| TruthContact {
            position: Point3::new(c.position.x, c.position.y, c.position.z),
            normal: Vector3::new(c.normal.x, c.normal.y, c.normal.z),
            force: Vector3::new(c.force.x, c.force.y, c.force.z),
            components: match c.force_components {
                ContactMsg::FORCE_FULL => ForceComponents::Full,
                ContactMsg::FORCE_NORMAL => ForceComponents::Normal,
                _ => ForceComponents::None,
            },
            diameter: c.diameter,
            flat: c.tip == IndentationContact::TIP_FLAT,
        })
        .collect();
    let idle = message.phase == Indentation::PHASE_IDLE && contacts.is_empty();
    Truth { press: message.press, location: message.location, idle, contacts }
}

pub(super) fn truth_at(truths: &[(Stamp, Truth)], stamp: Stamp, tolerance: i64) -> Option<Truth> {
    let after = truths.partition_point(|(t, _)| *t < stamp);
    let before = after.checked_sub(1).and_then(|i| truths.get(i));
    let after = truths.get(after);
    let near = |t: &Stamp| t.saturating_sub(stamp).abs() <= tolerance;
    let distance = |(t, _): &(Stamp, Truth)| t.saturating_sub(stamp).abs();
    let (nearest, other) = match (before, after) {
        (Some(b), Some(a)) if distance(b) < distance(a) => (b, Some(a)),
        (Some(b), Some(a)) => (a, Some(b)),
        (Some(only), None) | (None, Some(only)) => (only, None),
        (None, None) => return None,
    };
    if !near(&nearest.0) {
        return None;
    }
    let mut truth = nearest.1.clone();
    if let Some((time, other)) = other
        && (time - nearest.0).abs() <= 2 * tolerance.max(1)
        && other.press == truth.press
        && other.location == truth.location
        && let ([mine], [theirs]) = (truth.contacts.as_mut_slice(), other.contacts.as_slice())
        && mine.components == theirs.components
        && *time != nearest.0
    {
        let weight = (stamp - nearest.0) as f64 / (time - nearest.0) as f64;
        // A gap in one of the readings must not spread to the other.
        let blend = |a: f64, b: f64| if a.is_finite() && b.is_finite() { a + weight * (b - a) } else { a };
        mine.position = Point3::from(mine.position.coords.zip_map(&theirs.position.coords, blend));
        mine.force = mine.force.zip_map(&theirs.force, blend);
    }
    Some(truth)
}
