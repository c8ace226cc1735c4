//! Iterators over the messages of a bag.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::marker::PhantomData;
use std::path::Path;
use std::sync::Arc;

use dermis_msgs::Message;
use dermis_msgs::v0::Upgrade;
use mcap::McapError;
use mcap::sans_io::LinearReaderOptions;

use super::scan::{nanos, read_summary, record_limit};
use super::{BagMessage, Filter, Typed};
use crate::BagError;
use crate::error::say;
use crate::guard::guarded;
use crate::recovery::Recovery;
use crate::versions::{Units, upgrade_of};

/// Messages of one file, with errors in our words.
pub(super) struct FileMessages {
    pub(super) file: Arc<Path>,
    pub(super) reader: Reader,
    pub(super) count: u64,
    pub(super) last_topic: String,
}

pub(super) enum Reader {
    /// Ends at the first damage.
    Strict(Box<mcap::io::MessageReader<BufReader<File>>>),
    /// Skips damaged chunks.
    Lenient(Box<Recovery>),
}

impl FileMessages {
    pub(super) fn open(path: &Arc<Path>, recover: bool) -> Result<Self, BagError> {
        let mut file = dermis_io::open(path).map_err(BagError::io("open", &**path))?;
        let length = file.metadata().map_err(BagError::io("read", &**path))?.len();
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(record_limit(length));
        let summary = if recover { read_summary(&mut file, length).ok().flatten() } else { None };
        let file = BufReader::new(file);
        Ok(Self {
            file: Arc::clone(path),
            reader: if recover {
                Reader::Lenient(Box::new(Recovery::new(file, length, summary)))
            } else {
                Reader::Strict(Box::new(mcap::io::MessageReader::new_with_options(file, options)))
            },
            count: 0,
            last_topic: String::new(),
        })
    }
}

impl Iterator for FileMessages {
    type Item = Result<mcap::Message<'static>, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let path = || self.file.to_path_buf();
        let next = match &mut self.reader {
            Reader::Strict(reader) => guarded(|| reader.next()).transpose()?.and_then(|message| message),
            Reader::Lenient(recovery) => recovery.next()?.map_err(McapError::Io),
        };
        match next {
            Ok(message) => {
                self.count += 1;
                if self.last_topic != message.channel.topic {
                    self.last_topic.clone_from(&message.channel.topic);
                }
                Some(Ok(message))
            }
            Err(McapError::Io(source))
                if source.kind() != std::io::ErrorKind::UnexpectedEof && source.raw_os_error().is_some() =>
            {
                Some(Err(BagError::Io { action: "read", path: path(), source }))
            }
            Err(McapError::UnexpectedEof) => {
                Some(Err(BagError::Truncated { path: path(), messages: self.count }))
            }
            Err(error) => Some(Err(BagError::Corrupt {
                path: path(),
                topic: self.last_topic.clone(),
                messages: self.count,
                problem: say(&error),
            })),
        }
    }
}

/// Iterator over stored messages; it ends after the first error.
pub struct Messages {
    waiting: std::vec::IntoIter<Arc<Path>>,
    current: Option<FileMessages>,
    /// By channel of the current file.
    channels: BTreeMap<u16, Channel>,
    filter: Filter,
    recover: bool,
    /// Units of the skins, where messages of earlier definitions are converted.
    units: Option<Arc<Units>>,
    failed: bool,
}

/// Topic and type of a channel, shared by its messages.
struct Channel {
    topic: Arc<str>,
    type_name: Arc<str>,
    upgrade: Option<&'static Upgrade>,
}

impl Channel {
    fn of(channel: &mcap::Channel<'_>) -> Self {
        let schema = channel.schema.as_ref();
        let type_name = schema.map_or("", |schema| schema.name.as_str());
        let hash =
            channel.metadata.get("topic_type_hash").map(String::as_str).filter(|hash| !hash.is_empty());
        let text = schema.filter(|schema| schema.encoding == "ros2msg");
        let text = text.map(|schema| String::from_utf8_lossy(&schema.data)).unwrap_or_default();
        Self {
            topic: Arc::from(channel.topic.as_str()),
            type_name: Arc::from(type_name),
            upgrade: upgrade_of(type_name, hash, &text),
        }
    }
}

impl std::fmt::Debug for Messages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Messages").field("filter", &self.filter).finish_non_exhaustive()
    }
}

impl Messages {
    /// Messages in today's definition of their types.
    pub(super) fn of(files: Vec<Arc<Path>>, filter: Filter, recover: bool, units: &Arc<Units>) -> Self {
        Self { units: Some(Arc::clone(units)), ..Self::recorded(files, filter, recover) }
    }

    /// Messages as they were recorded.
    pub(crate) fn recorded(files: Vec<Arc<Path>>, filter: Filter, recover: bool) -> Self {
        Self {
            waiting: files.into_iter(),
            current: None,
            channels: BTreeMap::new(),
            filter,
            recover,
            units: None,
            failed: false,
        }
    }

    fn step(&mut self) -> Option<Result<BagMessage, BagError>> {
        loop {
            let Some(current) = &mut self.current else {
                let file = self.waiting.next()?;
                self.channels.clear();
                match FileMessages::open(&file, self.recover) {
                    Ok(messages) => self.current = Some(messages),
                    Err(error) => return Some(Err(error)),
                }
                continue;
            };
            let Some(message) = current.next() else {
                self.current = None;
                continue;
            };
            let message = match message {
                Ok(message) => message,
                Err(error) => return Some(Err(error)),
            };
            let channel =
                self.channels.entry(message.channel.id).or_insert_with(|| Channel::of(&message.channel));
            if !self.filter.takes(&channel.topic, &channel.type_name, nanos(message.log_time)) {
                continue;
            }
            let mut taken = BagMessage {
                topic: Arc::clone(&channel.topic),
                type_name: Arc::clone(&channel.type_name),
                log_time: nanos(message.log_time),
                publish_time: nanos(message.publish_time),
                data: message.data.into_owned(),
                before: None,
                refused: None,
                file: Arc::clone(&current.file),
            };
            if let (Some(units), Some(upgrade)) = (&self.units, channel.upgrade) {
                match upgrade.apply(&taken.data, &|skin| units.of(skin)) {
                    Ok(data) => taken.before = Some(std::mem::replace(&mut taken.data, data)),
                    Err(error) => {
                        taken.before = Some(std::mem::take(&mut taken.data));
                        taken.refused = Some(Box::new(error));
                    }
                }
            }
            return Some(Ok(taken));
        }
    }
}

impl Iterator for Messages {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let item = self.step();
        self.failed = !matches!(item, Some(Ok(_)));
        item
    }
}

/// Iterator over the decoded messages of one topic; it ends after the first error.
#[derive(Debug)]
pub struct TypedMessages<T> {
    messages: Messages,
    marker: PhantomData<fn() -> T>,
}

impl<T: Message> TypedMessages<T> {
    pub(super) fn of(messages: Messages) -> Self {
        Self { messages, marker: PhantomData }
    }
}

impl<T: Message> Iterator for TypedMessages<T> {
    type Item = Result<Typed<T>, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let decoded = self.messages.next()?.and_then(|message| {
            Ok(Typed {
                log_time: message.log_time,
                publish_time: message.publish_time,
                message: message.decode()?,
            })
        });
        self.messages.failed |= decoded.is_err();
        Some(decoded)
    }
}
