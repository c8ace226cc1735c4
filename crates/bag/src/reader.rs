//! Reads bags: folders and single files, whole and interrupted ones.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::{BufReader, Read as _, Seek as _},
    marker::PhantomData,
    path::{Path, PathBuf},
    sync::Arc,
};

use dermis_msgs::{CdrError, Message, TypeSupport, v0::Upgrade};
use mcap::{
    McapError, Summary,
    sans_io::{LinearReaderOptions, SummaryReadEvent, SummaryReader, summary_reader::SummaryReaderOptions},
};
use yaml_rust2::Yaml;

use crate::{
    BagError, BagInfo, BagQos, TopicInfo, definition,
    error::say,
    guard::{guarded, parse_record},
    losses,
    metadata::Metadata,
    order::MessagesByTime,
    salvage::Salvage,
    versions::{Units, upgrade_of},
};

/// Largest record or decompressed chunk that is held in memory; recorders make chunks of about 1 MB.
const RECORD_LIMIT: usize = 512 << 20;
/// What a byte of a file may become when chunks are decompressed: what a damaged file claims beyond is refused before
/// memory is made for it. Recordings stay far below; a fuzzer, which tries little else, gets less.
#[allow(unexpected_cfgs, reason = "cargo-fuzz sets it")]
const EXPANSION: usize = if cfg!(fuzzing) { 16 } else { 4096 };

/// Largest record or decompressed chunk of a file of so many bytes.
pub(crate) fn record_limit(length: u64) -> usize {
    usize::try_from(length).unwrap_or(usize::MAX).saturating_mul(EXPANSION).clamp(1 << 16, RECORD_LIMIT)
}

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
    /// The bytes that were recorded, where those are of a definition of before.
    before: Option<Vec<u8>>,
    /// Why they could not be converted; `data` is empty then.
    refused: Option<Box<CdrError>>,
    file: Arc<Path>,
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

    /// Says why it could not be converted, where that is so.
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

    /// Decodes the bytes as `T`, after a look at the type's name. That the bag's version of the type is ours is
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

    fn takes(&self, topic: &str, type_name: &str, log_time: i64) -> bool {
        self.takes_topic(topic, type_name)
            && self.start.is_none_or(|start| log_time >= start)
            && self.end.is_none_or(|end| log_time < end)
    }
}

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

/// One file at a glance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    /// First and last log time [ns]; `None` where it holds no message.
    pub(crate) span: Option<(i64, i64)>,
    /// How much earlier [ns] than one stored before it a message may be.
    pub(crate) disorder: i64,
}

/// Of files without an index: what arrives on several threads is stored out of order by no more than this.
const DISORDER: i64 = 1_000_000_000;

/// The largest disorder that the chunks allow: none of a chunk's messages is before its start.
fn disorder(summary: &Summary) -> i64 {
    let mut chunks: Vec<_> = summary.chunk_indexes.iter().filter(|c| c.message_end_time > 0).collect();
    chunks.sort_by_key(|chunk| chunk.chunk_start_offset);
    let mut newest = 0;
    let mut largest = 0;
    for chunk in chunks {
        newest = newest.max(chunk.message_end_time);
        largest = largest.max(newest.saturating_sub(chunk.message_start_time));
    }
    if summary.chunk_indexes.is_empty() { DISORDER } else { nanos(largest) }
}

/// What the files themselves say, before `metadata.yaml` is laid over it.
#[derive(Default)]
struct Contents {
    topics: BTreeMap<String, Topic>,
    span: Option<(i64, i64)>,
    messages: u64,
    /// The last note of the recorder: what is missing.
    note: Option<BTreeMap<String, String>>,
}

impl Contents {
    fn topic(&mut self, path: &Path, channel: &mcap::Channel<'_>) -> Result<&mut Topic, BagError> {
        if channel.message_encoding != "cdr" {
            return Err(BagError::Storage {
                path: path.into(),
                storage: format!("`{}` on topic {}", channel.message_encoding, channel.topic),
            });
        }
        let (type_name, definition) = match &channel.schema {
            Some(schema) if schema.encoding == "ros2msg" => {
                (schema.name.clone(), Arc::from(String::from_utf8_lossy(&schema.data).as_ref()))
            }
            Some(schema) => (schema.name.clone(), Arc::from("")),
            None => (String::new(), Arc::from("")),
        };
        let found = self.topics.entry(channel.topic.clone()).or_insert_with(|| Topic {
            name: channel.topic.clone(),
            type_name: type_name.clone(),
            type_hash: channel.metadata.get("topic_type_hash").filter(|hash| !hash.is_empty()).cloned(),
            definition,
            qos: channel
                .metadata
                .get("offered_qos_profiles")
                .and_then(|text| BagQos::from_yaml(&Yaml::String(text.clone()))),
            messages: 0,
        });
        if found.type_name != type_name {
            return Err(BagError::WrongType {
                path: path.into(),
                topic: channel.topic.clone(),
                found: type_name,
                expected: found.type_name.clone(),
            });
        }
        Ok(found)
    }

    fn widen(&mut self, first: i64, last: i64) {
        self.span = Some(self.span.map_or((first, last), |(start, end)| (start.min(first), end.max(last))));
    }

    fn take_summary(
        &mut self,
        path: &Path,
        summary: &Summary,
        stats: &mcap::records::Statistics,
    ) -> Result<(), BagError> {
        for channel in summary.channels.values() {
            self.topic(path, channel)?.messages +=
                stats.channel_message_counts.get(&channel.id).copied().unwrap_or(0);
        }
        self.messages += stats.message_count;
        if stats.message_count > 0 {
            self.widen(nanos(stats.message_start_time), nanos(stats.message_end_time));
        }
        Ok(())
    }

    fn take_messages(&mut self, mut messages: FileMessages) -> Result<(), BagError> {
        let path = Arc::clone(&messages.file);
        for message in messages.by_ref() {
            let message = message?;
            self.topic(&path, &message.channel)?.messages += 1;
            self.messages += 1;
            self.widen(nanos(message.log_time), nanos(message.log_time));
        }
        if let Reader::Lenient(salvage) = messages.reader {
            self.note = salvage.note.or(self.note.take());
        }
        Ok(())
    }
}

pub(crate) fn nanos(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

impl BagReader {
    /// Opens a rosbag2 folder or a single `.mcap` file that was completed.
    ///
    /// # Errors
    /// Where there is no bag, it was interrupted, or it is stored in a way that is not read here.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        Self::open_with(path.as_ref(), false)
    }

    /// Opens a bag that may have been interrupted: what is whole of it is read, up to the first damage.
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
        Ok(TypedMessages { messages, marker: PhantomData })
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

pub(crate) fn mcap_files(dir: &Path) -> Result<Vec<PathBuf>, BagError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(BagError::io("open", dir))? {
        let file = entry.map_err(BagError::io("read", dir))?.path();
        if file.extension().is_some_and(|extension| extension == "mcap") {
            files.push(file);
        }
    }
    // `name_10.mcap` comes after `name_9.mcap`.
    files.sort_by_key(|file| {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.rsplit('_').next().and_then(|digits| digits.parse::<u64>().ok());
        (number, stem)
    });
    Ok(files)
}

/// Collects topics and counts of a file: from its summary, or message by message where it has none.
/// Returns whether the file is complete, and its disorder.
fn scan(path: &Path, recover: bool, contents: &mut Contents) -> Result<(bool, i64), BagError> {
    let mut file = dermis_io::open(path).map_err(BagError::io("open", path))?;
    let length = file.metadata().map_err(BagError::io("read", path))?.len();
    let mut start = Vec::new();
    file.by_ref().take(16).read_to_end(&mut start).map_err(BagError::io("read", path))?;
    if !start.starts_with(mcap::MAGIC) {
        return Err(if start.starts_with(b"SQLite format 3") {
            BagError::Storage { path: path.into(), storage: "`sqlite3`".into() }
        } else if start.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
            BagError::Storage { path: path.into(), storage: "a zstd-compressed file".into() }
        } else if start.is_empty() {
            BagError::Truncated { path: path.into(), messages: 0 }
        } else {
            BagError::Foreign { path: path.into(), start: format!("\"{}\"", start.escape_ascii()) }
        });
    }
    match read_summary(&mut file, length) {
        Ok(Some(summary)) => {
            if let Some(stats) = &summary.stats {
                contents.take_summary(path, &summary, stats)?;
                contents.note = read_note(&mut file, &summary, length).or(contents.note.take());
                return Ok((true, disorder(&summary)));
            }
        }
        Ok(None) => {}
        Err(McapError::Io(source)) => return Err(BagError::Io { action: "read", path: path.into(), source }),
        // What it is exactly, a look at the messages tells.
        Err(_) if recover => {}
        Err(_) => {
            let mut messages = FileMessages::open(&Arc::from(path), false)?;
            let error = messages.find_map(Result::err);
            let count = messages.count;
            return Err(error.unwrap_or(BagError::Truncated { path: path.into(), messages: count }));
        }
    }
    let mut messages = FileMessages::open(&Arc::from(path), false)?;
    let damaged = messages.find_map(Result::err);
    match damaged {
        Some(error) if !recover => Err(error),
        damaged => {
            contents.take_messages(FileMessages::open(&Arc::from(path), recover)?)?;
            Ok((damaged.is_none(), DISORDER))
        }
    }
}

/// The last note of the recorder in a file that has an index. One that does not read is as good as none: it is no message.
fn read_note(file: &mut File, summary: &Summary, length: u64) -> Option<BTreeMap<String, String>> {
    /// Opcode and length of a record.
    const HEAD: usize = 9;
    let index = summary.metadata_indexes.iter().rev().find(|index| index.name == losses::RECORD)?;
    let size =
        usize::try_from(index.length).ok().filter(|size| (HEAD..=record_limit(length)).contains(size))?;
    let mut bytes = vec![0; size];
    file.seek(std::io::SeekFrom::Start(index.offset)).ok()?;
    file.read_exact(&mut bytes).ok()?;
    match parse_record(bytes[0], &bytes[HEAD..]) {
        Ok(mcap::records::Record::Metadata(metadata)) => Some(metadata.metadata),
        _ => None,
    }
}

pub(crate) fn read_summary(file: &mut File, length: u64) -> Result<Option<Summary>, McapError> {
    let options =
        SummaryReaderOptions::default().with_file_size(length).with_record_length_limit(record_limit(length));
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = guarded(|| reader.next_event())? {
        match event? {
            SummaryReadEvent::SeekRequest(to) => {
                let position = file.seek(to)?;
                reader.notify_seeked(position);
            }
            SummaryReadEvent::ReadRequest(size) => {
                let read = file.read(reader.insert(size))?;
                reader.notify_read(read);
            }
        }
    }
    Ok(reader.finish())
}

/// Messages of one file, with errors in our words.
struct FileMessages {
    file: Arc<Path>,
    reader: Reader,
    count: u64,
    last_topic: String,
}

enum Reader {
    /// Ends at the first damage.
    Strict(Box<mcap::io::MessageReader<BufReader<File>>>),
    /// Passes over damaged chunks.
    Lenient(Box<Salvage>),
}

impl FileMessages {
    fn open(path: &Arc<Path>, recover: bool) -> Result<Self, BagError> {
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
                Reader::Lenient(Box::new(Salvage::new(file, length, summary)))
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
            Reader::Lenient(salvage) => salvage.next()?.map_err(McapError::Io),
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
    /// What is known of each channel.
    channels: BTreeMap<u16, Channel>,
    filter: Filter,
    recover: bool,
    /// Where messages of before are converted.
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
    fn of(files: Vec<Arc<Path>>, filter: Filter, recover: bool, units: &Arc<Units>) -> Self {
        Self { units: Some(Arc::clone(units)), ..Self::recorded(files, filter, recover) }
    }

    /// Without a conversion.
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
