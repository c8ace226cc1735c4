//! Which skins a bag speaks of.
//!
//! A robot may carry several devices of one skin type. A recording tells them apart by the name in their messages, not by topics
//! alone: a topic can carry several skins (a remapped `contacts`), and a skin is on several topics. A type is identified by the hash
//! that the latched geometry carries, and what the channels of its frames are.
//!
//! What names a skin begins each message, so that nothing is decoded; of each topic the first messages are inspected, so that a
//! long bag is not read whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_msgs::{ChannelLayout, Message, OF_A_SKIN, SkinNames, v0};

use crate::versions::INSPECTED;
use crate::{BagError, BagMessage, BagReader, Filter};

/// A skin that a bag speaks of.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct BagSkin {
    /// Name of the instance: what `skin` in its messages says.
    pub name: String,
    /// Its coordinate frames; one, unless something is wrong.
    pub frame_ids: BTreeSet<String>,
    /// Hash of its type, where its geometry was recorded.
    pub hash: Option<String>,
    /// Topics that carry messages of it, with their types.
    pub topics: BTreeMap<String, String>,
    /// Channels of its frames by the number that those carry; one, unless the skin was changed meanwhile.
    pub layouts: BTreeMap<u32, ChannelLayout>,
}

impl BagSkin {
    /// What a message says of it beyond its name.
    fn take(&mut self, message: &BagMessage) {
        if *message.type_name == *SkinGeometry::TYPE_NAME
            && let Ok(geometry) = message.decode::<SkinGeometry>()
        {
            if geometry.layout_id != 0 {
                self.layouts.entry(geometry.layout_id).or_insert_with(|| ChannelLayout::of(&geometry));
            }
            if !geometry.skin_hash.is_empty() {
                self.hash = Some(geometry.skin_hash);
            }
        }
        // Frames of before name their channels themselves.
        if *message.type_name == *TaxelFrame::TYPE_NAME
            && message.is_converted()
            && let Ok(frame) = v0::msg::TaxelFrame::from_cdr(message.recorded())
            && let Some(layout) = frame.layout()
        {
            self.layouts.entry(layout.id()).or_insert(layout);
        }
    }

    /// Its topics of a type.
    pub fn topics_of<M: Message>(&self) -> impl Iterator<Item = &str> {
        self.topics.iter().filter(|(_, kind)| *kind == M::TYPE_NAME).map(|(topic, _)| topic.as_str())
    }
}

/// One line: name, type, coordinate frame, topics.
impl fmt::Display for BagSkin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |texts: Vec<&str>| texts.join(", ");
        write!(f, "{}", self.name)?;
        if let Some(hash) = &self.hash {
            // Enough to tell two types apart.
            write!(f, "  type {}", hash.get(..19).unwrap_or(hash))?;
        }
        write!(f, "  frame_id {}", list(self.frame_ids.iter().map(String::as_str).collect()))?;
        write!(f, "  {}", list(self.topics.keys().map(String::as_str).collect()))
    }
}

/// Why it is not clear which skin of a bag is meant. The bag's name is left to the caller.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SkinChoiceError {
    /// The name that was given is none of the bag's.
    #[error("holds no frames of skin `{wanted}`; it has {known}")]
    Unknown {
        /// Name that was given.
        wanted: String,
        /// Skins whose frames it has.
        known: String,
    },
    /// No skin is of this type, as far as is known.
    #[error("holds no frames of skin `{type_name}`; it has {known}")]
    NoneOfType {
        /// Name of the type.
        type_name: String,
        /// Skins whose frames it has.
        known: String,
    },
    /// Two devices of one type: their readings must not be mixed.
    #[error("holds frames of several skins of the type `{type_name}`: {known}")]
    Several {
        /// Name of the type.
        type_name: String,
        /// Skins whose frames it has.
        known: String,
    },
}

/// Which skin of a bag is meant.
#[derive(Debug, Clone, Copy, Default)]
pub struct SkinChoice<'a> {
    /// Name of the instance, where it was given.
    pub instance: Option<&'a str>,
    /// Topic of its frames, where it was given.
    pub topic: Option<&'a str>,
    /// Name of the type.
    pub type_name: &'a str,
}

impl SkinChoice<'_> {
    /// The one skin that is meant: the named one, else the only one of the type. `is_type` says whether a hash that was
    /// recorded for a skin of this name is that of the type; a skin whose geometry was not recorded is of the type whose name
    /// it has, or of any where its topic was given.
    ///
    /// # Errors
    ///
    /// [`SkinChoiceError`] lists the skins that there are.
    pub fn of<'s>(
        &self,
        skins: &'s [BagSkin],
        is_type: impl Fn(&str, &str) -> bool,
    ) -> Result<&'s BagSkin, SkinChoiceError> {
        let framed: Vec<&BagSkin> =
            skins.iter().filter(|skin| skin.topics_of::<TaxelFrame>().next().is_some()).collect();
        let known = |skins: &[&BagSkin]| {
            let listed = skins.iter().map(|skin| {
                format!("`{}` ({})", skin.name, skin.topics_of::<TaxelFrame>().collect::<Vec<_>>().join(", "))
            });
            let listed = listed.collect::<Vec<_>>().join(", ");
            if listed.is_empty() { "no frames at all".to_owned() } else { format!("those of {listed}") }
        };
        if let Some(wanted) = self.instance {
            return framed.iter().find(|skin| skin.name == wanted).copied().ok_or_else(|| {
                SkinChoiceError::Unknown { wanted: wanted.to_owned(), known: known(&framed) }
            });
        }
        let type_name = self.type_name.to_owned();
        let there = |skin: &BagSkin| {
            self.topic.is_none_or(|topic| skin.topics_of::<TaxelFrame>().any(|other| other == topic))
        };
        let fits = |skin: &BagSkin| match &skin.hash {
            _ if skin.name == self.type_name => true,
            Some(hash) => is_type(hash, &skin.name),
            None => self.topic.is_some(),
        };
        let fitting: Vec<&BagSkin> =
            framed.iter().filter(|skin| there(skin) && fits(skin)).copied().collect();
        match *fitting.as_slice() {
            [only] => Ok(only),
            [] => Err(SkinChoiceError::NoneOfType { type_name, known: known(&framed) }),
            _ => Err(SkinChoiceError::Several { type_name, known: known(&fitting) }),
        }
    }
}

impl BagReader {
    /// The skins that it speaks of, by name. Of a topic with many messages only the first ones are inspected.
    ///
    /// # Errors
    ///
    /// [`BagError`] where the bag cannot be read.
    pub fn skins(&self) -> Result<Vec<BagSkin>, BagError> {
        let mut left: BTreeMap<&str, u64> = self
            .topics()
            .iter()
            .filter(|topic| OF_A_SKIN.contains(&topic.type_name.as_str()) && topic.messages > 0)
            .map(|topic| (topic.name.as_str(), topic.messages.min(INSPECTED)))
            .collect();
        let mut skins: BTreeMap<String, BagSkin> = BTreeMap::new();
        if left.is_empty() {
            return Ok(Vec::new());
        }
        for message in self.messages_where(Filter::default().topics(left.keys().copied())) {
            let message = message?;
            match left.get_mut(&*message.topic) {
                None | Some(0) => continue,
                Some(count) => *count -= 1,
            }
            // A message that is damaged or of another version is none of a skin; whoever reads it says so.
            if let Ok(names) = SkinNames::of(&message.data) {
                let skin = skins.entry(names.skin.clone()).or_default();
                skin.name = names.skin;
                skin.frame_ids.insert(names.frame_id);
                skin.topics.entry(message.topic.to_string()).or_insert_with(|| message.type_name.to_string());
                skin.take(&message);
            }
            if left.values().all(|count| *count == 0) {
                break;
            }
        }
        Ok(skins.into_values().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skin(name: &str, hash: Option<&str>, topic: &str) -> BagSkin {
        BagSkin {
            name: name.into(),
            frame_ids: BTreeSet::from([format!("{name}_link")]),
            hash: hash.map(Into::into),
            topics: BTreeMap::from([(topic.into(), TaxelFrame::TYPE_NAME.into())]),
            layouts: BTreeMap::new(),
        }
    }

    fn choose(skins: &[BagSkin], instance: Option<&str>, topic: Option<&str>) -> Result<String, String> {
        let choice = SkinChoice { instance, topic, type_name: "pad" };
        let chosen = choice.of(skins, |hash, _| hash == "sha256:pad");
        chosen.map(|skin| skin.name.clone()).map_err(|error| error.to_string())
    }

    #[test]
    fn one_skin_of_the_type_is_meant_without_a_word() {
        let other = skin("foot", Some("sha256:foot"), "/foot/taxels");
        let left = skin("left_pad", Some("sha256:pad"), "/left/taxels");
        let right = skin("right_pad", Some("sha256:pad"), "/right/taxels");
        let both = [other.clone(), left.clone(), right];
        assert_eq!(choose(&[other.clone(), left], None, None).unwrap(), "left_pad");
        assert_eq!(choose(&both, Some("right_pad"), None).unwrap(), "right_pad");
        assert_eq!(choose(&both, None, Some("/right/taxels")).unwrap(), "right_pad");
        insta::assert_snapshot!(choose(&both, None, None).unwrap_err(), @"holds frames of several skins of the type `pad`: those of `left_pad` (/left/taxels), `right_pad` (/right/taxels)");
        insta::assert_snapshot!(choose(&both, Some("pad"), None).unwrap_err(), @"holds no frames of skin `pad`; it has those of `foot` (/foot/taxels), `left_pad` (/left/taxels), `right_pad` (/right/taxels)");
        insta::assert_snapshot!(choose(&[other], None, None).unwrap_err(), @"holds no frames of skin `pad`; it has those of `foot` (/foot/taxels)");
        insta::assert_snapshot!(choose(&[], None, None).unwrap_err(), @"holds no frames of skin `pad`; it has no frames at all");
        // Of a type that was not recorded.
        assert_eq!(choose(&[skin("pad", None, "/taxels")], None, None).unwrap(), "pad");
        assert!(choose(&[skin("x", None, "/taxels")], None, None).is_err());
        assert_eq!(choose(&[skin("x", None, "/taxels")], None, Some("/taxels")).unwrap(), "x");
    }
}
