//! Topics and messages of a bag, and which of them to read.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use dermis_msgs::{CdrError, Message, TypeSupport};

use crate::{BagError, BagQos};

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name as recorded, mostly with a leading slash.
    pub name: String,
    /// Type, e.g. `dermis_msgs/msg/TaxelFrame`.
    pub type_name: String,
    /// RIHS01 hash of the type; older recorders don't store it.
    pub type_hash: Option<String>,
    /// Full `ros2msg` definition; empty where the bag has none or has it in another language.
    pub definition: Arc<str>,
    /// Offered quality of service, where the bag has it.
    pub qos: Option<BagQos>,
    /// Messages on this topic.
    pub messages: u64,
}

impl Topic {
    /// A topic of a type that is built in here, without messages.
    #[must_use]
    pub fn of_type(name: &str, support: &TypeSupport, qos: Option<BagQos>) -> Self {
        Self {
            name: name.to_owned(),
            type_name: support.name.to_owned(),
            type_hash: Some(support.hash.to_owned()),
            definition: Arc::from(support.definition),
            qos,
            messages: 0,
        }
    }
}

/// One stored message, not decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagMessage {
    /// Topic.
    pub topic: Arc<str>,
    /// Type, e.g. `dermis_msgs/msg/TaxelFrame`.
    pub type_name: Arc<str>,
    /// When it was received or measured, nanoseconds since the epoch.
    pub log_time: i64,
    /// When it was published, nanoseconds since the epoch.
    pub publish_time: i64,
    /// CDR bytes with their 4-byte encapsulation header, as the type is defined today where that is known.
    pub data: Vec<u8>,
    /// The bytes that were recorded, where those are of an earlier definition of the type.
    pub(super) before: Option<Vec<u8>>,
    /// Why they could not be converted; `data` is empty then.
    pub(super) refused: Option<Box<CdrError>>,
    pub(super) file: Arc<Path>,
}

impl BagMessage {
    /// The bytes as they are in the bag.
    #[must_use]
    pub fn recorded(&self) -> &[u8] {
        self.before.as_deref().unwrap_or(&self.data)
    }

    /// Whether it was recorded as its type was defined before.
    #[must_use]
    pub fn is_converted(&self) -> bool {
        self.before.is_some()
    }

    /// Refuses a message that could not be converted.
    pub(crate) fn readable(&self) -> Result<(), BagError> {
        self.refused.as_ref().map_or(Ok(()), |source| Err(self.undecodable(source.clone())))
    }

    fn undecodable(&self, source: Box<CdrError>) -> BagError {
        BagError::Decode {
            path: self.file.to_path_buf(),
            topic: self.topic.to_string(),
            type_name: self.type_name.to_string(),
            log_time: self.log_time,
            source,
        }
    }

    /// Decodes the bytes as `T`, after a check of the type's name. That the bag's version of the type is ours is
    /// checked by [`BagReader::read`], or for all messages of a topic by [`BagReader::check_type`].
    ///
    /// # Errors
    /// Where the type's name differs or the bytes don't decode.
    pub fn decode<T: Message>(&self) -> Result<T, BagError> {
        if &*self.type_name != T::TYPE_NAME {
            return Err(BagError::WrongType {
                path: self.file.to_path_buf(),
                topic: self.topic.to_string(),
                found: self.type_name.to_string(),
                expected: T::TYPE_NAME.to_owned(),
            });
        }
        self.readable()?;
        T::from_cdr(&self.data).map_err(|source| self.undecodable(Box::new(source)))
    }
}

/// A decoded message with its times.
#[derive(Debug, Clone, PartialEq)]
pub struct Typed<T> {
    /// When it was received or measured, nanoseconds since the epoch.
    pub log_time: i64,
    /// When it was published, nanoseconds since the epoch.
    pub publish_time: i64,
    /// The message.
    pub message: T,
}

/// Which messages to read; the default is all.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    topics: Option<BTreeSet<String>>,
    types: Option<BTreeSet<String>>,
    start: Option<i64>,
    end: Option<i64>,
}

impl Filter {
    /// Only these topics, by their full name.
    #[must_use]
    pub fn topics<S: Into<String>>(mut self, topics: impl IntoIterator<Item = S>) -> Self {
        self.topics = Some(topics.into_iter().map(Into::into).collect());
        self
    }

    /// Only topics of these types, e.g. `dermis_msgs/msg/TaxelFrame`.
    #[must_use]
    pub fn types<S: Into<String>>(mut self, types: impl IntoIterator<Item = S>) -> Self {
        self.types = Some(types.into_iter().map(Into::into).collect());
        self
    }

    /// Only log times from `start` on, and before `end` [ns since the epoch].
    #[must_use]
    pub fn between(mut self, start: i64, end: i64) -> Self {
        (self.start, self.end) = (Some(start), Some(end));
        self
    }

    pub(crate) fn takes_topic(&self, topic: &str, type_name: &str) -> bool {
        self.topics.as_ref().is_none_or(|topics| topics.contains(topic))
            && self.types.as_ref().is_none_or(|types| types.contains(type_name))
    }

    pub(super) fn takes(&self, topic: &str, type_name: &str, log_time: i64) -> bool {
        self.takes_topic(topic, type_name)
            && self.start.is_none_or(|start| log_time >= start)
            && self.end.is_none_or(|end| log_time < end)
    }
}
