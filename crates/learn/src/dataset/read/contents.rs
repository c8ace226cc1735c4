//! What a bag holds for a skin, before its frames are joined with their ground truth.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use dermis_bag::{BagMessage, BagReader, Filter, SkinChoiceError};
use dermis_msgs::msg::{Contact as ContactMsg, Indentation, IndentationContact, SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::Image as ImageMsg;
use dermis_msgs::{ChannelLayout, Message, TypeSupport};
use dermis_skin::{ForceComponents, Frame, SkinDescription, Stamp};
use nalgebra::{Point3, Vector3};
use sha2::{Digest, Sha256};

use super::check_late;
use super::opened::{Opened, Truths, namespace, topic_of, wanted_types};
use crate::LearnError;
use crate::dataset::recording::Recording;
use crate::dataset::track::{FromBag, Gathered, Track};
use crate::dataset::{DatasetOptions, Truth, TruthContact};
use crate::findings::Findings;
use crate::map::{LabelMap, Readings};

/// What one bag holds for a skin, before it is joined.
#[derive(Default)]
pub(super) struct Contents {
    pub(super) frames: Recording,
    truths: Gathered<Truth>,
    /// Which ground truth is that of the device.
    wanted: Option<Arc<Truths>>,
    pub(super) rig: Readings,
    /// Frames of the skin by topic.
    topics: BTreeMap<String, usize>,
    /// Topic of the images that belong to them.
    pub(super) images: Option<String>,
    /// Other skins that the bag holds.
    others: BTreeSet<String>,
    pub(super) sessions: BTreeSet<String>,
    geometry: Option<String>,
    /// Device whose frames these are.
    pub(super) instance: String,
    /// Why no frames were taken.
    pub(super) choice: Option<SkinChoiceError>,
    /// Frames and ground truth without a stamp.
    unstamped: [u64; 2],
    /// First frame that is not as the skin's description says.
    mismatch: Option<String>,
    /// Number of frames of which there are more.
    exceeded: Option<usize>,
}

/// Which messages of a bag are taken, and for what they are checked.
struct Wanted<'a> {
    skin: &'a SkinDescription,
    /// Topic of the frames, where one is named.
    topic: Option<&'a str>,
    layouts: &'a BTreeMap<u32, ChannelLayout>,
    truths: Arc<Truths>,
    map: Option<&'a LabelMap>,
    /// Bytes of frames that may be held.
    memory: usize,
}

impl Contents {
    /// Reads a bag. `hasher` gets what is used of it; of its frames, `memory` bytes are held. Of what is `streamed`, no entry for
    /// each frame or message is held; of other bags, there may be `most` frames, or as many as the summary says.
    pub(super) fn read(
        opened: &Opened,
        skin: &SkinDescription,
        options: &DatasetOptions,
        hasher: &mut Sha256,
        (memory, streamed, most): (usize, bool, usize),
    ) -> Result<Self, LearnError> {
        let mut found = Self { frames: Recording::new(streamed), ..Self::default() };
        if streamed {
            (found.truths, found.rig) = (Gathered::streamed(), Readings::streamed());
        }
        let chosen = match opened.chosen(skin, options) {
            Ok(chosen) => chosen,
            Err(error) => {
                found.choice = Some(error);
                return Ok(found);
            }
        };
        found.instance.clone_from(&chosen.name);
        let topic = topic_of(options).map(String::as_str);
        let wanted = Wanted {
            skin,
            topic,
            layouts: &chosen.layouts,
            truths: Arc::new(Truths::of(chosen, &opened.skins, topic, skin)),
            map: options.map.as_ref(),
            memory,
        };
        found.wanted = Some(Arc::clone(&wanted.truths));
        let types = wanted_types(options);
        // Frames are numbered by 32 bits.
        let allowed = opened.allowed.max(most).min(u32::MAX as usize - 1);
        for message in opened.bag.messages_where(Filter::default().types(types.iter().map(|s| s.name))) {
            found.take(&message?, &wanted, hasher)?;
            if found.frames.count > allowed {
                found.exceeded = Some(allowed);
                break;
            }
        }
        found.images = found.image_topic(&opened.bag)?;
        Ok(found)
    }

    /// Takes one message of the bag.
    fn take(
        &mut self,
        message: &BagMessage,
        wanted: &Wanted<'_>,
        hasher: &mut Sha256,
    ) -> Result<(), LearnError> {
        if *message.type_name == *TaxelFrame::TYPE_NAME {
            self.take_frame(message, wanted, hasher)?;
        } else if *message.type_name == *Indentation::TYPE_NAME {
            if let Some(truth) = wanted.truths.of_message(message)? {
                hasher.update(message.recorded());
                self.sessions.insert(truth.session.clone());
                if truth.header.stamp.as_nanos() == 0 {
                    self.unstamped[1] += 1;
                } else {
                    self.truths.push(truth.header.stamp.as_nanos(), truth_of(&truth));
                }
            }
        } else if *message.type_name == *SkinGeometry::TYPE_NAME {
            if let Ok(message) = message.decode::<SkinGeometry>()
                && message.skin == self.instance
            {
                self.geometry = Some(message.skin_hash);
            }
        } else if let Some(map) = wanted.map {
            if *message.topic == *map.robot.topic || *message.topic == *map.force.topic {
                hasher.update(message.recorded());
            }
            self.rig.take(map, message)?;
        }
        Ok(())
    }

    /// Takes a frame, where it is of the device that was chosen.
    fn take_frame(
        &mut self,
        message: &BagMessage,
        wanted: &Wanted<'_>,
        hasher: &mut Sha256,
    ) -> Result<(), LearnError> {
        let frame: TaxelFrame = message.decode()?;
        if frame.skin != self.instance {
            self.others.insert(frame.skin);
        } else if wanted.topic.is_none_or(|topic| *topic == *message.topic) {
            hasher.update(message.recorded());
            *self.topics.entry(message.topic.to_string()).or_insert(0) += 1;
            if self.mismatch.is_none() {
                self.mismatch = wanted.skin.layout_mismatch(&frame, wanted.layouts);
            }
            if frame.header.stamp.as_nanos() == 0 {
                self.unstamped[0] += 1;
            } else {
                self.frames.push(Frame::from(&frame), wanted.memory);
            }
        }
        Ok(())
    }

    /// Topic of the images beside that of the frames, where there is one.
    fn image_topic(&self, bag: &BagReader) -> Result<Option<String>, LearnError> {
        let Some(topic) = self.topics.keys().next().filter(|_| self.topics.len() == 1) else {
            return Ok(None);
        };
        let beside = format!("{}/image", namespace(topic));
        let image = TypeSupport::of::<ImageMsg>();
        let Some(topic) = bag.topics().iter().find(|t| t.name == beside && t.type_name == image.name) else {
            return Ok(None);
        };
        bag.check_type(topic, image)?;
        Ok(Some(beside))
    }

    /// First and last stamp of the ground truth.
    pub(super) fn truth_span(&self) -> Option<(Stamp, Stamp)> {
        self.truths.span()
    }

    /// The ground truth over time, of so many frames; says what is wrong with it.
    pub(super) fn truth_track(
        &mut self,
        bag: &BagReader,
        frames: usize,
        place: &str,
        findings: &mut Findings,
    ) -> Track<Truth> {
        if self.unstamped[1] > 0 {
            findings.fatal(
                place,
                format!("{} ground truth messages have no stamp (header.stamp is 0)", self.unstamped[1]),
                "nothing can be joined by acquisition time",
            );
        } else if self.truths.len() == 0 {
            findings.fatal(
                place,
                format!(
                    "holds {} frames of skin `{}` but no ground truth (dermis_msgs/msg/Indentation) for it",
                    frames, self.instance
                ),
                "nothing can be learned or measured; record one with `dermis collect`, `dermis import` a labelled \
                 recording, or name a robot's and a force sensor's topics in a file and pass it as `--map`",
            );
        }
        if self.sessions.len() > 1 {
            let what = format!("holds {} sessions, which count as one run", self.sessions.len());
            findings.notice(place, what, "");
        }
        let truths = std::mem::take(&mut self.truths);
        check_late(truths.late(), "ground truth messages", place, findings);
        let wanted = self.wanted.clone();
        truths.into_track(
            false,
            FromBag {
                bag: bag.clone(),
                filter: Filter::default().types([Indentation::TYPE_NAME]),
                take: Arc::new(move |message, order| {
                    let Some(wanted) = &wanted else { return Ok(()) };
                    if let Some(truth) = wanted.of_message(message)? {
                        let stamp = truth.header.stamp.as_nanos();
                        if stamp != 0 {
                            order.push(stamp, truth_of(&truth));
                        }
                    }
                    Ok(())
                }),
            },
        )
    }

    /// Says what is wrong with the frames themselves.
    pub(super) fn check_frames(&self, skin: &SkinDescription, place: &str, findings: &mut Findings) {
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
        if let Some(allowed) = self.exceeded {
            findings.fatal(
                place,
                format!("holds more than {allowed} frames, which its summary does not count, or which are too many for one bag"),
                "it is not read to its end; `dermis bag slice` writes it anew, or in parts",
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
        if self.frames.count < 10 || self.mismatch.is_some() {
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

/// The first few of many names.
fn listed(names: &[&str]) -> String {
    let mut text = names.iter().take(8).copied().collect::<Vec<_>>().join(", ");
    if names.len() > 8 {
        text.push_str(&format!(" and {} more", names.len() - 8));
    }
    text
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
