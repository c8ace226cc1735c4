//! What a recording lacks, as its bag tells it.
//!
//! A recorder counts three things, each on its own: messages that were *lost* on the way to it (by the numbers that publishers
//! give them), messages that arrived and were *dropped* (the queue or the disk was full), and *taxel frames* that the skin
//! numbered and that are not in the bag, whatever the reason: these two, or the skin's node or wire before the bus. They are
//! stored as custom data of `metadata.yaml` and, while the recording goes on, as MCAP metadata records named
//! `dermis_recording`, so that an interrupted bag has them, too:
//!
//! | key | value |
//! |---|---|
//! | `lost` | lost messages of all topics of which it is known, or `unknown` |
//! | `lost <topic>` | lost messages, where there are some, or `unknown` |
//! | `dropped`, `dropped <topic>` | likewise |
//! | `missing frames <topic>` | taxel frames that are missing, where there are some |

use std::{collections::BTreeMap, fmt};

/// Name of the MCAP metadata records.
pub(crate) const RECORD: &str = "dermis_recording";

const UNKNOWN: &str = "unknown";
const LOST: &str = "lost";
const DROPPED: &str = "dropped";
const FRAMES: &str = "missing frames";

/// What one topic lacks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct TopicLosses {
    /// Messages that were lost on the way to the recorder; `None` where nothing tells.
    pub lost: Option<u64>,
    /// Messages that arrived and were not written.
    pub dropped: u64,
    /// Taxel frames that the skin numbered and that are not there.
    pub missing_frames: u64,
}

/// What a recording lacks, by topic; `Display` says it in one sentence.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct RecordedLosses {
    /// By topic; those of which nothing is said lack nothing.
    pub topics: BTreeMap<String, TopicLosses>,
}

impl RecordedLosses {
    /// What the custom data of a bag say; `None` where they say nothing, as those of other recorders.
    #[must_use]
    pub fn of(custom: &BTreeMap<String, String>) -> Option<Self> {
        if !custom.contains_key(LOST) && !custom.contains_key(DROPPED) {
            return None;
        }
        let mut topics: BTreeMap<String, TopicLosses> = BTreeMap::new();
        for (key, value) in custom {
            let count = value.parse().ok();
            if let Some(topic) = topic_of(key, LOST) {
                topics.entry(topic.into()).or_insert(NOTHING).lost = count;
            } else if let Some(topic) = topic_of(key, DROPPED) {
                topics.entry(topic.into()).or_insert(NOTHING).dropped = count.unwrap_or(0);
            } else if let Some(topic) = topic_of(key, FRAMES) {
                topics.entry(topic.into()).or_insert(NOTHING).missing_frames = count.unwrap_or(0);
            }
        }
        Some(Self { topics })
    }

    /// As custom data; `topics` are all that were recorded.
    pub(crate) fn to_custom(topics: &BTreeMap<String, TopicLosses>) -> BTreeMap<String, String> {
        let known: Vec<u64> = topics.values().filter_map(|topic| topic.lost).collect();
        let lost = if known.is_empty() && !topics.is_empty() {
            UNKNOWN.to_owned()
        } else {
            known.iter().sum::<u64>().to_string()
        };
        let dropped: u64 = topics.values().map(|topic| topic.dropped).sum();
        let mut custom = BTreeMap::from([(LOST.to_owned(), lost), (DROPPED.to_owned(), dropped.to_string())]);
        for (name, topic) in topics {
            match topic.lost {
                Some(0) => {}
                Some(lost) => drop(custom.insert(format!("{LOST} {name}"), lost.to_string())),
                None => drop(custom.insert(format!("{LOST} {name}"), UNKNOWN.to_owned())),
            }
            for (key, count) in [(DROPPED, topic.dropped), (FRAMES, topic.missing_frames)] {
                if count > 0 {
                    custom.insert(format!("{key} {name}"), count.to_string());
                }
            }
        }
        custom
    }

    /// Whether a key of the custom data belongs here.
    pub(crate) fn owns(key: &str) -> bool {
        [LOST, DROPPED].contains(&key) || [LOST, DROPPED, FRAMES].iter().any(|k| topic_of(key, k).is_some())
    }

    /// Messages that were lost on the way or dropped, as far as it is known.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.topics.values().map(|topic| topic.lost.unwrap_or(0) + topic.dropped).sum()
    }

    /// Topics of which it is not known how many messages were lost on the way.
    pub fn unknown(&self) -> impl Iterator<Item = &str> {
        self.topics.iter().filter(|(_, topic)| topic.lost.is_none()).map(|(name, _)| name.as_str())
    }

    /// Whether it is known that nothing is missing.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.messages() == 0 && self.unknown().next().is_none() && self.frames().is_empty()
    }

    /// Taxel frames that are missing beyond the messages that were lost or dropped: their node never published them.
    fn frames(&self) -> Vec<(&str, u64)> {
        let beyond = |topic: &TopicLosses| {
            topic.missing_frames.saturating_sub(topic.lost.unwrap_or(0) + topic.dropped)
        };
        let all = self.topics.iter().map(|(name, topic)| (name.as_str(), beyond(topic)));
        all.filter(|(_, frames)| *frames > 0).collect()
    }
}

/// Nothing is said of a topic that has no key.
const NOTHING: TopicLosses = TopicLosses { lost: Some(0), dropped: 0, missing_frames: 0 };

fn topic_of<'a>(key: &'a str, kind: &str) -> Option<&'a str> {
    key.strip_prefix(kind)?.strip_prefix(' ').filter(|topic| topic.starts_with('/'))
}

impl fmt::Display for RecordedLosses {
    /// A clause without a capital and a full stop; `nothing was lost while recording` where nothing is missing.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut clauses = Vec::new();
        let messages = self.messages();
        if messages > 0 {
            let of = self.topics.iter().filter_map(|(name, topic)| {
                let count = topic.lost.unwrap_or(0) + topic.dropped;
                (count > 0).then(|| format!("{name} {count}"))
            });
            let (noun, verb) = if messages == 1 { ("message", "was") } else { ("messages", "were") };
            let of: Vec<_> = of.collect();
            clauses.push(format!("{messages} {noun} {verb} lost while recording: {}", of.join(", ")));
        }
        let frames = self.frames();
        if !frames.is_empty() {
            let of: Vec<_> = frames.iter().map(|(name, count)| format!("{name} {count}")).collect();
            clauses.push(format!("taxel frames are missing that were not published: {}", of.join(", ")));
        }
        let unknown: Vec<_> = self.unknown().collect();
        if !unknown.is_empty() {
            clauses.push(format!(
                "whether messages were lost on the way is not known of {}",
                unknown.join(", ")
            ));
        }
        if clauses.is_empty() {
            clauses.push("nothing was lost while recording".to_owned());
        }
        f.write_str(&clauses.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_survive_the_custom_data_and_are_said() {
        let topics = BTreeMap::from([
            ("/a".to_owned(), TopicLosses { lost: Some(3), dropped: 1, missing_frames: 6 }),
            ("/b".to_owned(), TopicLosses { lost: None, dropped: 0, missing_frames: 0 }),
            ("/c".to_owned(), TopicLosses { lost: Some(0), dropped: 0, missing_frames: 0 }),
        ]);
        let custom = RecordedLosses::to_custom(&topics);
        assert!(custom.keys().all(|key| RecordedLosses::owns(key)) && !RecordedLosses::owns("lost property"));
        let losses = RecordedLosses::of(&custom).unwrap();
        assert_eq!(
            (losses.topics["/a"], losses.topics["/b"], losses.topics.len()),
            (topics["/a"], topics["/b"], 2)
        );
        assert!(!losses.is_complete());
        insta::assert_snapshot!(losses, @"4 messages were lost while recording: /a 4; taxel frames are missing that were not published: /a 2; whether messages were lost on the way is not known of /b");
        assert_eq!(custom["lost"], "3");
    }

    #[test]
    fn unknown_is_not_nothing() {
        let one = |lost| BTreeMap::from([("/a".to_owned(), TopicLosses { lost, ..TopicLosses::default() })]);
        let unknown = RecordedLosses::to_custom(&one(None));
        assert_eq!(unknown["lost"], "unknown");
        assert!(!RecordedLosses::of(&unknown).unwrap().is_complete());
        let none = RecordedLosses::of(&RecordedLosses::to_custom(&one(Some(0)))).unwrap();
        assert!(none.is_complete());
        insta::assert_snapshot!(none, @"nothing was lost while recording");
        // Other recorders say nothing, and those before this counted drops only.
        assert_eq!(RecordedLosses::of(&BTreeMap::from([("source".to_owned(), "x".to_owned())])), None);
        let old = BTreeMap::from([
            ("dropped".to_owned(), "1".to_owned()),
            ("dropped /a".to_owned(), "1".to_owned()),
        ]);
        insta::assert_snapshot!(RecordedLosses::of(&old).unwrap(), @"1 message was lost while recording: /a 1");
    }
}
