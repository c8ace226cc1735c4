//! Reads bags: folders and single files, whole and interrupted ones.
//!
//! [`BagReader`] knows what is in a bag; `scan` finds that out when it is opened, `messages` reads it file by file, and
//! `stored` has the topics, messages and filters themselves.
//! Cost: opening reads the index of each file, or each whole file where it has none; reading holds one chunk at a time.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dermis_msgs::{Message, TypeSupport};

use crate::metadata::Metadata;
use crate::order::MessagesByTime;
use crate::versions::Units;
use crate::{BagError, BagInfo, TopicInfo, definition};
use scan::{Contents, scan};

pub use messages::{Messages, TypedMessages};
pub(crate) use scan::{Part, mcap_files, nanos, read_summary, record_limit};
pub use stored::{BagMessage, Filter, Topic, Typed};

mod messages;
mod scan;
mod stored;

/// An open bag. It holds no file handle: each iteration opens its own.
#[derive(Debug, Clone)]
pub struct BagReader {
    path: PathBuf,
    files: Vec<Arc<Path>>,
    /// What is known of each file.
    parts: Vec<Part>,
    topics: Vec<Topic>,
    bytes: u64,
    span: Option<(i64, i64)>,
    messages: u64,
    custom: BTreeMap<String, String>,
    complete: bool,
    recover: bool,
    units: Arc<Units>,
}

impl BagReader {
    /// Opens a rosbag2 folder or a single `.mcap` file that was completed.
    ///
    /// # Errors
    /// Where there is no bag, it was interrupted, or it is stored in a way that is not read here.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        Self::open_with(path.as_ref(), false)
    }

    /// Opens a bag that may have been interrupted: damaged chunks are skipped, and a file ends where its next record
    /// cannot be read.
    ///
    /// # Errors
    /// Where there is no bag or it is stored in a way that is not read here.
    pub fn recover(path: impl AsRef<Path>) -> Result<Self, BagError> {
        Self::open_with(path.as_ref(), true)
    }

    fn open_with(path: &Path, recover: bool) -> Result<Self, BagError> {
        if !path.exists() {
            return Err(BagError::Missing { path: path.into() });
        }
        let mut complete = true;
        let (files, metadata) = if path.is_dir() {
            let yaml = path.join("metadata.yaml");
            if yaml.exists() {
                let metadata = Metadata::read(&yaml)?;
                // Before version 4 the paths repeated the folder's name, which the caller may have changed since.
                let files = metadata.files.iter().map(|file| path.join(&file.path)).collect();
                (files, Some(metadata))
            } else {
                let files = mcap_files(path)?;
                if !recover || files.is_empty() {
                    return Err(BagError::NoMetadata { path: path.into(), files: files.len() });
                }
                complete = false;
                (files, None)
            }
        } else {
            (vec![path.to_path_buf()], None)
        };

        let mut contents = Contents::default();
        let mut bytes = 0;
        let mut parts = Vec::new();
        for file in &files {
            bytes += std::fs::metadata(file).map_err(BagError::io("open", file))?.len();
            let before = contents.span.take();
            let (whole, disorder) = scan(file, recover, &mut contents)?;
            complete &= whole;
            parts.push(Part { span: contents.span, disorder });
            if let Some((first, last)) = before {
                contents.widen(first, last);
            }
        }
        let mut custom = BTreeMap::new();
        if let Some(metadata) = metadata {
            for topic in metadata.topics {
                if let Some(known) = contents.topics.get_mut(&topic.name) {
                    known.type_hash = known.type_hash.take().or(topic.type_hash);
                    known.qos = known.qos.or(topic.qos);
                }
            }
            custom = metadata.custom;
        } else if let Some(note) = contents.note.take() {
            custom = note;
        }
        let files: Vec<Arc<Path>> = files.into_iter().map(Arc::from).collect();
        let topics: Vec<Topic> = contents.topics.into_values().collect();
        Ok(Self {
            path: path.into(),
            units: Arc::new(Units::new(files.clone(), recover, &topics)),
            files,
            parts,
            topics,
            bytes,
            span: contents.span,
            messages: contents.messages,
            custom,
            complete,
            recover,
        })
    }

    /// The folder or file that was opened.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Topics in the order of their names.
    #[must_use]
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Its `.mcap` files.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|file| &**file)
    }

    /// First and last log time [ns since the epoch]; `None` where there is no message.
    #[must_use]
    pub fn span(&self) -> Option<(i64, i64)> {
        self.span
    }

    /// False where the recording was interrupted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Custom data of `metadata.yaml`.
    #[must_use]
    pub fn custom(&self) -> &BTreeMap<String, String> {
        &self.custom
    }

    /// Summary for people.
    #[must_use]
    pub fn info(&self) -> BagInfo {
        let topics = self.topics.iter().map(|topic| TopicInfo {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            messages: topic.messages,
            type_hash: topic.type_hash.clone(),
            qos: topic.qos,
        });
        BagInfo {
            path: self.path.clone(),
            files: self.files.len(),
            bytes: self.bytes,
            span: self.span,
            messages: self.messages,
            topics: topics.collect(),
            custom: self.custom.clone(),
            complete: self.complete,
        }
    }

    /// Finds a topic by its name: as it is, with a leading slash, or as the end of one namespaced name
    /// (`taxels` finds `/left_arm/taxels`).
    ///
    /// # Errors
    /// Where no topic fits, or several do.
    pub fn topic(&self, name: &str) -> Result<&Topic, BagError> {
        let bare = name.trim_start_matches('/');
        let exact = |topic: &&Topic| topic.name == name || topic.name.trim_start_matches('/') == bare;
        if let Some(topic) = self.topics.iter().find(exact) {
            return Ok(topic);
        }
        let ending = format!("/{bare}");
        let fitting: Vec<&Topic> = self
            .topics
            .iter()
            .filter(|topic| !name.starts_with('/') && topic.name.ends_with(&ending))
            .collect();
        match fitting.as_slice() {
            [topic] => Ok(topic),
            [] => Err(BagError::NoTopic {
                path: self.path.clone(),
                topic: name.to_owned(),
                topics: self.topics.iter().map(|topic| topic.name.clone()).collect(),
            }),
            several => Err(BagError::Ambiguous {
                path: self.path.clone(),
                wanted: name.to_owned(),
                topics: several.iter().map(|topic| topic.name.clone()).collect(),
            }),
        }
    }

    /// Topics of type `T`, in the order of their names.
    pub fn topics_of_type<T: Message>(&self) -> impl Iterator<Item = &Topic> {
        self.topics.iter().filter(|topic| topic.type_name == T::TYPE_NAME)
    }

    /// The topic of type `T`.
    ///
    /// # Errors
    /// Where no topic has the type, or several have it.
    pub fn topic_of_type<T: Message>(&self) -> Result<&Topic, BagError> {
        let fitting: Vec<&Topic> = self.topics_of_type::<T>().collect();
        match fitting.as_slice() {
            [topic] => Ok(topic),
            [] => Err(BagError::NoTopicOfType {
                path: self.path.clone(),
                type_name: T::TYPE_NAME.to_owned(),
                topics: self
                    .topics
                    .iter()
                    .map(|topic| format!("{} ({})", topic.name, topic.type_name))
                    .collect(),
            }),
            several => Err(BagError::Ambiguous {
                path: self.path.clone(),
                wanted: T::TYPE_NAME.to_owned(),
                topics: several.iter().map(|topic| topic.name.clone()).collect(),
            }),
        }
    }

    /// Checks that a topic carries the type, in the version that is built in here or in one that is converted to it: by the
    /// RIHS01 hash where the bag has it, else field by field.
    ///
    /// # Errors
    /// Where the name, the hash or a field differs.
    pub fn check_type(&self, topic: &Topic, support: &TypeSupport) -> Result<(), BagError> {
        if topic.type_name != support.name {
            return Err(BagError::WrongType {
                path: self.path.clone(),
                topic: topic.name.clone(),
                found: topic.type_name.clone(),
                expected: support.name.to_owned(),
            });
        }
        if topic.type_hash.as_deref() == Some(support.hash)
            || topic.upgrade().is_some_and(|upgrade| upgrade.new.hash == support.hash)
        {
            return Ok(());
        }
        let difference = if topic.definition.is_empty() {
            topic
                .type_hash
                .as_ref()
                .map(|hash| format!("its hash is {hash} in the bag and {} here", support.hash))
        } else {
            definition::difference(support.name, &topic.definition, support.definition)
        };
        match difference {
            Some(difference) => Err(BagError::WrongVersion {
                path: self.path.clone(),
                topic: topic.name.clone(),
                type_name: support.name.to_owned(),
                difference,
            }),
            None => Ok(()),
        }
    }

    /// All messages, in the order in which they were stored: that of their arrival.
    #[must_use]
    pub fn messages(&self) -> Messages {
        self.messages_where(Filter::default())
    }

    /// The messages that a filter takes, in the order in which they were stored.
    #[must_use]
    pub fn messages_where(&self, filter: Filter) -> Messages {
        Messages::of(self.files.clone(), filter, self.recover, &self.units)
    }

    /// As [`messages_where`](Self::messages_where), with the bytes that are in the bag, whatever version they are of.
    pub(crate) fn recorded_where(&self, filter: Filter) -> Messages {
        Messages::recorded(self.files.clone(), filter, self.recover)
    }

    /// The messages that a filter takes, in the order of their log times over all files.
    #[must_use]
    pub fn messages_by_time(&self, filter: &Filter) -> MessagesByTime {
        let files = self.files.iter().zip(&self.parts).map(|(file, part)| {
            let messages = Messages::of(vec![Arc::clone(file)], filter.clone(), self.recover, &self.units);
            (messages, *part)
        });
        MessagesByTime::new(files)
    }

    /// Decoded messages of one topic, which is found as in [`topic`](Self::topic) and checked as in
    /// [`check_type`](Self::check_type).
    ///
    /// # Errors
    /// Where the topic is not there or carries another type or version. The iterator's items fail where the file
    /// is damaged or a message does not decode.
    pub fn read<T: Message>(&self, topic: &str) -> Result<TypedMessages<T>, BagError> {
        let topic = self.topic(topic)?;
        self.check_type(topic, TypeSupport::of::<T>())?;
        let messages = self.messages_where(Filter::default().topics([topic.name.clone()]));
        Ok(TypedMessages::of(messages))
    }

    /// Decoded messages of the one topic that has type `T`.
    ///
    /// # Errors
    /// As [`topic_of_type`](Self::topic_of_type) and [`read`](Self::read).
    pub fn read_only_topic<T: Message>(&self) -> Result<TypedMessages<T>, BagError> {
        let name = self.topic_of_type::<T>()?.name.clone();
        self.read(&name)
    }
}
