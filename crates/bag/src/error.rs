//! What can go wrong with a bag, in one sentence each.

use std::path::{Path, PathBuf};

use crate::writer::{FILE_LIMIT, full};

/// Why a bag could not be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// The operating system refused.
    #[error("cannot {action} {path}: {source}")]
    Io {
        /// What was tried: `open`, `create`, `write`, …
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Nothing is at the path.
    #[error("there is no bag at {path}: give a rosbag2 folder or an .mcap file")]
    Missing {
        /// The path that was given.
        path: PathBuf,
    },
    /// The target folder of a new bag has content.
    #[error("{path} exists already: bags are never written over, give another name or remove it")]
    Exists {
        /// The target folder.
        path: PathBuf,
    },
    /// The folder has no `metadata.yaml`.
    #[error(
        "{path} has no metadata.yaml: the recording was interrupted before it was finished, or this is not a bag ({files} .mcap files are in it); name an .mcap file itself, or recover what is whole"
    )]
    NoMetadata {
        /// The folder.
        path: PathBuf,
        /// How many `.mcap` files it holds.
        files: usize,
    },
    /// `metadata.yaml` is not what rosbag2 writes.
    #[error("{path} is not rosbag2 metadata: {problem}")]
    Metadata {
        /// The `metadata.yaml`.
        path: PathBuf,
        /// What is wrong in it, with its field.
        problem: String,
    },
    /// The bag is stored in another way.
    #[error(
        "{path} is stored as {storage}, which is not read here: convert it with `ros2 bag convert` to uncompressed `mcap` storage"
    )]
    Storage {
        /// The bag or file.
        path: PathBuf,
        /// Storage plugin or compression, as the bag names it.
        storage: String,
    },
    /// The file is something else.
    #[error("{path} is not an MCAP file: it starts with {start}")]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Its first bytes, printed.
        start: String,
    },
    /// The file ends too early.
    #[error(
        "{path} ends in the middle, after {messages} whole messages: the recording was interrupted or the copy is not complete: copy it again, or recover what is whole"
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// How many messages were read before its end.
        messages: u64,
    },
    /// The file's bytes contradict each other.
    #[error("{path} is damaged after {messages} whole messages{}: {problem}", at_topic(.topic))]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Topic of the last message before the damage; empty where there was none.
        topic: String,
        /// How many messages were read before the damage.
        messages: u64,
        /// What does not fit.
        problem: String,
    },
    /// The bag has no such topic.
    #[error("{path} has no topic {topic}: it has {}", list(.topics))]
    NoTopic {
        /// The bag.
        path: PathBuf,
        /// The topic that was requested.
        topic: String,
        /// The topics that it has.
        topics: Vec<String>,
    },
    /// Several topics could be meant.
    #[error("{path} has several topics that fit {wanted}: {}; name one", list(.topics))]
    Ambiguous {
        /// The bag.
        path: PathBuf,
        /// Topic or type that was requested.
        wanted: String,
        /// The topics that fit.
        topics: Vec<String>,
    },
    /// The bag has no topic of a type.
    #[error("{path} has no topic of type {type_name}: it has {}", list(.topics))]
    NoTopicOfType {
        /// The bag.
        path: PathBuf,
        /// The type that was requested.
        type_name: String,
        /// Its topics, each with its type.
        topics: Vec<String>,
    },
    /// The topic carries another type.
    #[error("topic {topic} of {path} carries {found}, not {expected}")]
    WrongType {
        /// The bag or file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Type in the bag.
        found: String,
        /// Type that was requested.
        expected: String,
    },
    /// The type has the same name but other fields.
    #[error("topic {topic} of {path} was recorded with another version of {type_name}: {difference}")]
    WrongVersion {
        /// The bag or file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// How the definitions differ.
        difference: String,
    },
    /// The bytes of a message don't decode.
    #[error("message at {log_time} ns on topic {topic} of {path} does not decode as {type_name}: {source}")]
    Decode {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Type that was decoded.
        type_name: String,
        /// Log time of the message, nanoseconds since the epoch.
        log_time: i64,
        /// What the decoder said.
        source: Box<dermis_msgs::CdrError>,
    },
    /// A message that must not be stored.
    #[error("message for topic {topic} refused by {path}: {problem}")]
    Refused {
        /// The bag that is written.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Why.
        problem: String,
    },
    /// A bag that cannot be repaired where it is.
    #[error("cannot repair {path}: {problem}")]
    Repair {
        /// The bag or file.
        path: PathBuf,
        /// Why, and what to do.
        problem: String,
    },
    /// There is no room for more.
    #[error(
        "cannot write {path}: {reason}; what was written before stays readable: make room, then complete the bag with `dermis bag check --repair`"
    )]
    Full {
        /// The file.
        path: PathBuf,
        /// What ran out.
        reason: &'static str,
    },
    /// There is no room for a copy, of which nothing is left.
    #[error(
        "cannot write {path}: {reason}; what was written of it is removed again: make room and try again"
    )]
    NoRoom {
        /// The bag that was to be written.
        path: PathBuf,
        /// What ran out.
        reason: &'static str,
    },
    /// Writing the MCAP file failed.
    #[error("cannot write {path}: {problem}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the writer said.
        problem: String,
    },
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

fn at_topic(topic: &str) -> String {
    if topic.is_empty() { String::new() } else { format!(" (the last one on topic {topic})") }
}

impl BagError {
    /// Whether somebody has to make room, and the same would work then.
    #[must_use]
    pub fn is_no_room(&self) -> bool {
        match self {
            Self::Full { reason, .. } | Self::NoRoom { reason, .. } => *reason != FILE_LIMIT,
            _ => false,
        }
    }

    /// An I/O error with its action and path; a full disk has a variant of its own, because it is none of the program's.
    pub(crate) fn io_or_full(action: &'static str, path: &Path, source: std::io::Error) -> Self {
        match full(&source) {
            Some(reason) => Self::Full { path: path.into(), reason },
            None => Self::Io { action, path: path.into(), source },
        }
    }

    /// Attaches an action and a path to an I/O error, for `map_err`.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }
}

/// Says an MCAP error with all its causes: the library keeps the telling part in the source.
pub(crate) fn say(error: &mcap::McapError) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(inner) = cause {
        let inner_text = inner.to_string();
        if !text.contains(&inner_text) {
            text.push_str(": ");
            text.push_str(&inner_text);
        }
        cause = inner.source();
    }
    text
}
