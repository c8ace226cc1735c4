//! A bag that is open: which device of it is meant, and how much it holds for it.

use std::collections::BTreeSet;
use std::path::Path;

use dermis_bag::{BagMessage, BagReader, BagSkin, SkinChoice, SkinChoiceError};
use dermis_msgs::geometry_msgs::msg::{TransformStamped, WrenchStamped};
use dermis_msgs::msg::{Indentation, SkinGeometry, TaxelFrame};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::{Message, TypeSupport};
use dermis_skin::SkinDescription;

use crate::LearnError;
use crate::dataset::DatasetOptions;

/// A bag whose messages are not read yet.
pub(in crate::dataset) struct Opened {
    pub(super) bag: BagReader,
    /// The skins that it speaks of.
    pub(super) skins: Vec<BagSkin>,
    /// Messages on the topics of the frames, as the bag's summary counts them: at least as many as there are frames.
    pub(in crate::dataset) frames: usize,
    /// Messages on all topics that may hold such frames.
    pub(super) allowed: usize,
    /// Messages on the topics of the ground truth.
    pub(super) readings: usize,
}

impl Opened {
    /// Opens a bag, and checks that the types of its messages are ours.
    pub(in crate::dataset) fn new(
        path: &Path,
        skin: &SkinDescription,
        options: &DatasetOptions,
    ) -> Result<Self, LearnError> {
        let bag = BagReader::open(path)?;
        for support in &wanted_types(options) {
            for topic in bag.topics().iter().filter(|t| t.type_name == support.name) {
                bag.check_type(topic, support)?;
            }
        }
        let skins = bag.skins()?;
        let mut opened = Self { bag, skins, frames: 0, allowed: 0, readings: 0 };
        if let Ok(chosen) = opened.chosen(skin, options) {
            let named = topic_of(options).map(String::as_str);
            let topics: BTreeSet<&str> =
                chosen.topics_of::<TaxelFrame>().filter(|t| named.is_none_or(|named| named == *t)).collect();
            let frames = opened.messages(|t| topics.contains(t.name.as_str()));
            opened.readings = match &options.map {
                Some(map) => opened.messages(|t| t.name == map.robot.topic || t.name == map.force.topic),
                None => opened.messages(|t| t.type_name == Indentation::TYPE_NAME),
            };
            let framed = |t: &dermis_bag::Topic| t.type_name == TaxelFrame::TYPE_NAME;
            opened.allowed = opened.messages(|t| framed(t) && named.is_none_or(|named| named == t.name));
            opened.frames = frames;
        }
        Ok(opened)
    }

    fn messages(&self, of: impl Fn(&dermis_bag::Topic) -> bool) -> usize {
        let counts = self.bag.topics().iter().filter(|t| of(t)).map(|t| t.messages);
        usize::try_from(counts.fold(0, u64::saturating_add)).unwrap_or(usize::MAX)
    }

    /// The device whose frames are meant.
    pub(super) fn chosen(
        &self,
        skin: &SkinDescription,
        options: &DatasetOptions,
    ) -> Result<&BagSkin, SkinChoiceError> {
        let topic = topic_of(options).map(String::as_str);
        let choice = SkinChoice { instance: options.instance.as_deref(), topic, type_name: skin.type_name() };
        choice.of(&self.skins, |hash, name| skin.is_type(hash, name))
    }
}

/// The types of message that ground truth and frames are made of.
pub(super) fn wanted_types(options: &DatasetOptions) -> Vec<&'static TypeSupport> {
    let mut wanted = vec![TypeSupport::of::<TaxelFrame>(), TypeSupport::of::<SkinGeometry>()];
    if options.map.is_some() {
        wanted.extend([
            TypeSupport::of::<WrenchStamped>(),
            TypeSupport::of::<TransformStamped>(),
            TypeSupport::of::<TFMessage>(),
        ]);
    } else {
        wanted.push(TypeSupport::of::<Indentation>());
    }
    wanted
}

/// Topic of the frames, where one is named.
pub(super) fn topic_of(options: &DatasetOptions) -> Option<&String> {
    options.map.as_ref().and_then(|m| m.skin.taxels.as_ref()).or(options.taxels.as_ref())
}

/// Which ground truth of a bag is that of a device. What presses a skin may know its type only.
pub(super) struct Truths {
    instance: String,
    type_name: String,
    /// Namespaces of the device's frames, where the type's name is not enough.
    namespaces: Option<BTreeSet<String>>,
    /// Whether the device's own name is not enough either: another one has it too.
    shared: bool,
}

impl Truths {
    pub(super) fn of(
        chosen: &BagSkin,
        skins: &[BagSkin],
        topic: Option<&str>,
        skin: &SkinDescription,
    ) -> Self {
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

    /// The ground truth that a message tells, where it is that of the device.
    pub(super) fn of_message(&self, message: &BagMessage) -> Result<Option<Indentation>, LearnError> {
        let truth: Indentation = message.decode()?;
        Ok(self.takes(&message.topic, &truth.skin).then_some(truth))
    }

    fn takes(&self, topic: &str, skin: &str) -> bool {
        let beside = || self.namespaces.as_ref().is_none_or(|of_frames| of_frames.contains(namespace(topic)));
        skin == self.instance && (!self.shared || beside()) || skin == self.type_name && beside()
    }
}

pub(super) fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}
