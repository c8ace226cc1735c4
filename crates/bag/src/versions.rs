//! Bags whose messages are defined as they were before.
//!
//! The problem: bags outlive definitions. A reader hands out what [`dermis_msgs::v0`] knows as it is defined today, so that nobody
//! who reads bags knows of another version; [`convert`] writes a bag in which it is so.
//!
//! What a bag holds is identified by the type hash that it stores, or by its definition where it has none. An old geometry does not say
//! the unit of the readings; the frames of its skin do, so they are inspected when the first such geometry is read.
//!
//! A converted message costs one decoding and one encoding.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::v0::{self, Upgrade};
use dermis_msgs::{ChannelLayout, Message, TypeSupport};

use crate::{
    BagError, BagInfo, BagOptions, BagQos, BagReader, BagWriter, Filter, Messages, Topic, TopicId, definition,
};

/// Messages of a topic that are inspected: skins that share a topic take turns on it.
pub(crate) const INSPECTED: u64 = 200;

/// What makes today's messages of recorded ones; `None` where they are today's, or not known at all.
pub(crate) fn upgrade_of(type_name: &str, hash: Option<&str>, recorded: &str) -> Option<&'static Upgrade> {
    if let Some(upgrade) = hash.and_then(|hash| Upgrade::of_hash(type_name, hash)) {
        return Some(upgrade);
    }
    let upgrade = v0::UPGRADES.iter().find(|upgrade| upgrade.old.name == type_name)?;
    let same = |support: &TypeSupport| {
        !recorded.is_empty() && definition::difference(type_name, recorded, support.definition).is_none()
    };
    (hash != Some(upgrade.new.hash) && same(upgrade.old)).then_some(upgrade)
}

impl Topic {
    /// What makes today's messages of those that were recorded.
    pub(crate) fn upgrade(&self) -> Option<&'static Upgrade> {
        upgrade_of(&self.type_name, self.type_hash.as_deref(), &self.definition)
    }

    /// Whether its messages were recorded as they were defined before, and are converted as they are read.
    #[must_use]
    pub fn is_converted(&self) -> bool {
        self.upgrade().is_some()
    }
}

/// Units of the skins of a bag whose geometry does not say them.
#[derive(Debug, Default)]
pub(crate) struct Units {
    files: Vec<Arc<Path>>,
    recover: bool,
    /// Topics with old frames, and how many of them were inspected.
    frames: BTreeMap<String, u64>,
    found: OnceLock<BTreeMap<String, String>>,
}

impl Units {
    pub(crate) fn new(files: Vec<Arc<Path>>, recover: bool, topics: &[Topic]) -> Self {
        let frames = topics.iter().filter(|topic| topic.type_name == TaxelFrame::TYPE_NAME);
        let frames = frames.filter(|topic| topic.messages > 0 && topic.is_converted());
        let frames = frames.map(|topic| (topic.name.clone(), topic.messages.min(INSPECTED))).collect();
        Self { files, recover, frames, found: OnceLock::new() }
    }

    pub(crate) fn of(&self, skin: &str) -> Option<String> {
        self.found.get_or_init(|| self.find()).get(skin).cloned()
    }

    /// What cannot be read says no unit; whoever reads it for its own sake hears why.
    fn find(&self) -> BTreeMap<String, String> {
        let mut units = BTreeMap::new();
        let mut left = self.frames.clone();
        if left.is_empty() {
            return units;
        }
        let filter = Filter::default().topics(left.keys().cloned());
        for message in Messages::recorded(self.files.clone(), filter, self.recover).flatten() {
            match left.get_mut(&*message.topic) {
                None | Some(0) => continue,
                Some(count) => *count -= 1,
            }
            if let Ok(frame) = v0::msg::TaxelFrame::from_cdr(&message.data)
                && let Some(layout) = frame.layout()
            {
                units.entry(frame.skin).or_insert(layout.unit);
            }
            if left.values().all(|count| *count == 0) {
                break;
            }
        }
        units
    }
}

/// Copies a bag into a new one whose messages are defined as they are today: those of before are converted, all others are
/// copied as they are. Where an old bag has frames but no geometry, a geometry without a surface is written before the first
/// of them, so that the new bag still names its channels. The original is only read.
///
/// # Errors
/// Where reading or writing fails, a message does not decode, or the target exists. What was written is removed then.
pub fn convert(reader: &BagReader, out: impl AsRef<Path>, options: &BagOptions) -> Result<BagInfo, BagError> {
    let out = out.as_ref();
    crate::repair::written(out, || convert_into(reader, BagWriter::create_with(out, options)?))
}

fn convert_into(reader: &BagReader, mut writer: BagWriter) -> Result<BagInfo, BagError> {
    for (key, value) in reader.custom() {
        writer.set_custom(key, value);
    }
    let mut ids: BTreeMap<&str, TopicId> = BTreeMap::new();
    for topic in reader.topics() {
        let today = topic.upgrade().map(|upgrade| Topic {
            messages: topic.messages,
            ..Topic::of_type(&topic.name, upgrade.new, topic.qos)
        });
        ids.insert(&topic.name, writer.declare(today.as_ref().unwrap_or(topic))?);
    }
    let old: Vec<&str> =
        reader.topics().iter().filter(|topic| topic.is_converted()).map(|t| t.name.as_str()).collect();
    if !old.is_empty() {
        let what = format!("definitions of before, on {}", old.join(", "));
        writer.set_custom("converted from", what);
    }
    let mut named = Named::of(reader)?;
    for message in reader.messages() {
        let message = message?;
        message.readable()?;
        let Some(&id) = ids.get(&*message.topic) else { continue };
        if let Some(geometry) = named.missing_at(&message) {
            let topic = geometry_topic(&message.topic);
            let topic = Topic::of_type(&topic, TypeSupport::of::<SkinGeometry>(), Some(BagQos::latched()));
            let id = writer.declare(&topic)?;
            writer.write_bytes(id, &geometry.to_cdr(), message.log_time, message.publish_time)?;
        }
        writer.write_bytes(id, &message.data, message.log_time, message.publish_time)?;
    }
    writer.finish()
}

/// Beside the frames.
fn geometry_topic(frames: &str) -> String {
    format!("{}/skin_geometry", frames.rsplit_once('/').map_or("", |(namespace, _)| namespace))
}

/// Layouts that a converted bag names.
struct Named(BTreeSet<(String, u32)>);

impl Named {
    fn of(reader: &BagReader) -> Result<Self, BagError> {
        let mut named = BTreeSet::new();
        let topics = reader.topics_of_type::<SkinGeometry>().map(|topic| topic.name.clone());
        for message in reader.messages_where(Filter::default().topics(topics)) {
            if let Ok(geometry) = message?.decode::<SkinGeometry>() {
                named.insert((geometry.skin, geometry.layout_id));
            }
        }
        Ok(Self(named))
    }

    /// What names the channels of an old frame, where nothing does yet.
    fn missing_at(&mut self, message: &crate::BagMessage) -> Option<SkinGeometry> {
        if *message.type_name != *TaxelFrame::TYPE_NAME || !message.is_converted() {
            return None;
        }
        let frame = v0::msg::TaxelFrame::from_cdr(message.recorded()).ok()?;
        let layout: ChannelLayout = frame.layout()?;
        let layout_id = layout.id();
        self.0.insert((frame.skin.clone(), layout_id)).then(|| SkinGeometry {
            header: Header { stamp: frame.header.stamp, frame_id: frame.header.frame_id },
            skin: frame.skin,
            layout_id,
            unit: layout.unit,
            channels: layout.channels,
            electrodes: frame.electrodes,
            ..SkinGeometry::default()
        })
    }
}
