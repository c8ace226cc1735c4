//! Writes a bag.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, BufWriter},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
};

use dermis_msgs::{Message, TypeSupport};

use crate::{
    BagError, BagInfo, BagQos, Topic, TopicInfo,
    error::say,
    losses,
    metadata::{FileMetadata, Metadata, TopicMetadata},
    patience::{Patience, Patient, no_room},
};

pub use options::{BagOptions, Compression};

mod options;
mod out;
mod parts;
use out::Out;
use parts::write_metadata_file;

/// A topic that was declared to a [`BagWriter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TopicId(usize);

struct TopicState {
    topic: Topic,
    /// In the file that is open.
    channel: u16,
    sequence: u32,
}

/// The file that is open.
struct Part {
    path: PathBuf,
    mcap: mcap::Writer<Out>,
    length: Arc<AtomicU64>,
    span: Option<(i64, i64)>,
    messages: u64,
}

fn widen(span: &mut Option<(i64, i64)>, time: i64) {
    *span = Some(span.map_or((time, time), |(first, last)| (first.min(time), last.max(time))));
}

/// Writes one bag: `<dir>/<name>_0.mcap`, where it is split also `<name>_1.mcap` and so on, and, in
/// [`finish`](Self::finish), `<dir>/metadata.yaml`.
///
/// A writer that is dropped without `finish` completes the last `.mcap` file as well as it can but writes no
/// `metadata.yaml`, so that the bag is recognised as interrupted.
pub struct BagWriter {
    dir: PathBuf,
    name: String,
    options: BagOptions,
    part: Part,
    /// Files that are complete.
    done: Vec<FileMetadata>,
    done_bytes: u64,
    /// Hand complete files to the disk while the next one is written.
    syncing: Vec<JoinHandle<Result<(), BagError>>>,
    topics: Vec<TopicState>,
    by_name: BTreeMap<String, TopicId>,
    span: Option<(i64, i64)>,
    messages: u64,
    custom: BTreeMap<String, String>,
    /// Where absent, a write that finds no room fails.
    patience: Option<Arc<Patience>>,
}

impl std::fmt::Debug for BagWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BagWriter")
            .field("dir", &self.dir)
            .field("messages", &self.messages)
            .finish_non_exhaustive()
    }
}

/// The topic as it is stored: with a leading slash, as a recorder sees it on the bus.
fn absolute(topic: &str) -> String {
    if topic.starts_with('/') { topic.to_owned() } else { format!("/{topic}") }
}

/// Runs an attempt once, or until there is room.
fn attempt<T>(patience: Option<&Arc<Patience>>, mut attempt: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    match patience {
        Some(patience) => patience.patiently(attempt),
        None => attempt(),
    }
}

/// Begins file number `index` of a bag.
fn begin(
    dir: &Path,
    name: &str,
    index: usize,
    options: &BagOptions,
    patience: Option<&Arc<Patience>>,
) -> Result<Part, BagError> {
    let path = dir.join(format!("{name}_{index}.mcap"));
    let file = attempt(patience, || File::create_new(&path))
        .map_err(|error| BagError::io_or_full("create", &path, error))?;
    let file = Patient { inner: file, patience: patience.cloned() };
    let length = Arc::new(AtomicU64::new(0));
    let (compression, level) = match options.compression {
        Compression::None => (None, 0),
        Compression::Fast => (Some(mcap::Compression::Zstd), 1),
        Compression::Default => (Some(mcap::Compression::Zstd), 3),
        Compression::Small => (Some(mcap::Compression::Zstd), 15),
    };
    let mcap = mcap::WriteOptions::new()
        .profile("ros2")
        .library(concat!("dermis-bag ", env!("CARGO_PKG_VERSION")))
        .compression(compression)
        .compression_level(level)
        .compression_threads(0)
        .chunk_size(Some(options.chunk_bytes))
        // A chunk is made in memory and written in one go: what an interruption tears is the last one at most.
        .disable_seeking(true)
        .create(Out { file: BufWriter::new(file), written: 0, length: Arc::clone(&length) })
        .map_err(|error| write_error(&path, &error))?;
    Ok(Part { path, mcap, length, span: None, messages: 0 })
}

/// Says a failure to write; a full disk has a variant of its own, because it is none of the program's.
fn write_error(path: &Path, error: &mcap::McapError) -> BagError {
    if let mcap::McapError::Io(source) = error
        && let Some(reason) = full(source)
    {
        return BagError::Full { path: path.into(), reason };
    }
    BagError::Write { path: path.into(), problem: say(error) }
}

/// What no room on the disk helps against.
pub(crate) const FILE_LIMIT: &str = "the file has reached the largest size that is allowed here";

/// Why there is no room for more, now or ever.
pub(crate) fn full(error: &io::Error) -> Option<&'static str> {
    match error.kind() {
        io::ErrorKind::FileTooLarge => Some(FILE_LIMIT),
        _ => no_room(error),
    }
}

impl BagWriter {
    /// Makes the folder `dir` and starts a bag named like it.
    ///
    /// # Errors
    /// Where the folder exists and is not empty, or cannot be made.
    pub fn create(dir: impl AsRef<Path>) -> Result<Self, BagError> {
        Self::create_with(dir, &BagOptions::default())
    }

    /// [`create`](Self::create) with another layout.
    ///
    /// # Errors
    /// As [`create`](Self::create).
    pub fn create_with(dir: impl AsRef<Path>, options: &BagOptions) -> Result<Self, BagError> {
        Self::create_waiting(dir.as_ref(), options, None)
    }

    /// A bag whose writes wait while the disk is full.
    pub(crate) fn create_waiting(
        dir: &Path,
        options: &BagOptions,
        patience: Option<Arc<Patience>>,
    ) -> Result<Self, BagError> {
        let name = match dir.file_name() {
            Some(name) => name.to_string_lossy().into_owned(),
            None => "bag".to_owned(),
        };
        Self::create_named(dir.to_path_buf(), name, options, patience)
    }

    /// A bag whose files are not named like its folder: one that takes its place later.
    pub(crate) fn create_named(
        dir: PathBuf,
        name: String,
        options: &BagOptions,
        patience: Option<Arc<Patience>>,
    ) -> Result<Self, BagError> {
        if dir.exists() {
            let mut entries = std::fs::read_dir(&dir).map_err(BagError::io("open", &dir))?;
            if entries.next().is_some() {
                return Err(BagError::Exists { path: dir });
            }
        }
        attempt(patience.as_ref(), || std::fs::create_dir_all(&dir))
            .map_err(|error| BagError::io_or_full("create", &dir, error))?;
        let part = begin(&dir, &name, 0, options, patience.as_ref())?;
        Ok(Self {
            dir,
            name,
            options: *options,
            part,
            done: Vec::new(),
            done_bytes: 0,
            syncing: Vec::new(),
            topics: Vec::new(),
            by_name: BTreeMap::new(),
            span: None,
            messages: 0,
            custom: BTreeMap::new(),
            patience,
        })
    }

    /// The folder of the bag.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.dir
    }

    /// Messages written so far.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Bytes of its files so far, without the chunk that is being filled.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.done_bytes + self.part.length.load(Ordering::Relaxed)
    }

    /// Files so far, the open one included.
    #[must_use]
    pub fn files(&self) -> usize {
        self.done.len() + 1
    }

    /// Adds an entry to the custom data of `metadata.yaml`: where an imported recording comes from, what was
    /// assumed. The same key again replaces its value.
    pub fn set_custom(&mut self, key: impl Into<String>, value: impl Into<String>) {
        self.custom.insert(key.into(), value.into());
    }

    /// Writes what a recording lacks so far into the file, so that a bag that is interrupted has it, too. Ends the chunk that
    /// is being filled.
    pub(crate) fn note_losses(&mut self, losses: &BTreeMap<String, String>) -> Result<(), BagError> {
        let metadata = mcap::records::Metadata { name: losses::RECORD.to_owned(), metadata: losses.clone() };
        self.part.mcap.write_metadata(&metadata).map_err(|error| write_error(&self.part.path, &error))
    }

    /// Declares a topic with its offered quality of service before its first message. A topic that was not
    /// declared gets [`BagQos::sensor_data`].
    ///
    /// # Errors
    /// Where the topic exists with another type, or writing fails.
    pub fn add_topic(&mut self, topic: &str, support: &TypeSupport, qos: BagQos) -> Result<(), BagError> {
        self.declare(&Topic::of_type(topic, support, Some(qos))).map(drop)
    }

    /// Declares a topic of any type, as another bag or the graph describes it; its `messages` don't count.
    ///
    /// # Errors
    /// Where the topic exists with another type, or writing fails.
    pub fn declare(&mut self, topic: &Topic) -> Result<TopicId, BagError> {
        let name = absolute(&topic.name);
        if let Some(&id) = self.by_name.get(&name) {
            self.check_type(&name, &self.topics[id.0].topic.type_name, &topic.type_name)?;
            return Ok(id);
        }
        let topic = Topic { name: name.clone(), messages: 0, ..topic.clone() };
        let channel = self.add_channel(&topic)?;
        let id = TopicId(self.topics.len());
        self.topics.push(TopicState { topic, channel, sequence: 0 });
        self.by_name.insert(name, id);
        Ok(id)
    }

    fn add_channel(&mut self, topic: &Topic) -> Result<u16, BagError> {
        let mut channel_metadata = BTreeMap::new();
        if let Some(qos) = topic.qos {
            channel_metadata.insert("offered_qos_profiles".to_owned(), qos.to_yaml(""));
        }
        if let Some(hash) = &topic.type_hash {
            channel_metadata.insert("topic_type_hash".to_owned(), hash.clone());
        }
        let mcap = &mut self.part.mcap;
        mcap.add_schema(&topic.type_name, "ros2msg", topic.definition.as_bytes())
            .and_then(|schema| mcap.add_channel(schema, &topic.name, "cdr", &channel_metadata))
            .map_err(|error| write_error(&self.part.path, &error))
    }

    fn check_type(&self, topic: &str, found: &str, expected: &str) -> Result<(), BagError> {
        if found == expected {
            return Ok(());
        }
        Err(BagError::WrongType {
            path: self.dir.clone(),
            topic: topic.to_owned(),
            found: found.to_owned(),
            expected: expected.to_owned(),
        })
    }

    /// Writes a message that was received (or measured) at `log_time_ns`, nanoseconds since the epoch.
    ///
    /// # Errors
    /// As [`write_cdr`](Self::write_cdr).
    pub fn write<T: Message>(&mut self, topic: &str, message: &T, log_time_ns: i64) -> Result<(), BagError> {
        self.write_cdr(topic, TypeSupport::of::<T>(), &message.to_cdr(), log_time_ns)
    }

    /// Writes a message that is encoded already, with its 4-byte encapsulation header, as it is.
    ///
    /// # Errors
    /// Where the topic carries another type, the bytes are not CDR, the time is before the epoch, or writing fails.
    pub fn write_cdr(
        &mut self,
        topic: &str,
        support: &TypeSupport,
        cdr: &[u8],
        log_time_ns: i64,
    ) -> Result<(), BagError> {
        let name = absolute(topic);
        if !matches!(cdr, [0, 0 | 1, _, _, ..]) {
            return Err(BagError::Refused {
                path: self.dir.clone(),
                topic: name,
                problem: "it does not start with a CDR encapsulation header (00 01 00 00 or 00 00 00 00)"
                    .into(),
            });
        }
        let id = match self.by_name.get(&name) {
            Some(&id) => {
                self.check_type(&name, &self.topics[id.0].topic.type_name, support.name)?;
                id
            }
            None => self.declare(&Topic::of_type(&name, support, Some(BagQos::sensor_data())))?,
        };
        self.write_bytes(id, cdr, log_time_ns, log_time_ns)
    }

    /// Writes the bytes of a message as they are, received at `log_time_ns` and published at `publish_time_ns`,
    /// nanoseconds since the epoch.
    ///
    /// # Errors
    /// Where a time is before the epoch, or writing fails.
    pub fn write_bytes(
        &mut self,
        topic: TopicId,
        data: &[u8],
        log_time_ns: i64,
        publish_time_ns: i64,
    ) -> Result<(), BagError> {
        let Ok(log_time) = u64::try_from(log_time_ns) else {
            return Err(BagError::Refused {
                path: self.dir.clone(),
                topic: self.topics[topic.0].topic.name.clone(),
                problem: format!("its time of {log_time_ns} ns is before 1970"),
            });
        };
        if self.split_is_due(log_time_ns) {
            self.split()?;
        }
        let state = &mut self.topics[topic.0];
        let header = mcap::records::MessageHeader {
            channel_id: state.channel,
            sequence: state.sequence,
            log_time,
            publish_time: u64::try_from(publish_time_ns).unwrap_or(log_time),
        };
        self.part
            .mcap
            .write_to_known_channel(&header, data)
            .map_err(|error| write_error(&self.part.path, &error))?;
        state.sequence = state.sequence.wrapping_add(1);
        state.topic.messages += 1;
        self.part.messages += 1;
        self.messages += 1;
        widen(&mut self.part.span, log_time_ns);
        widen(&mut self.span, log_time_ns);
        Ok(())
    }

    fn split_is_due(&self, log_time_ns: i64) -> bool {
        let Some((first, _)) = self.part.span else { return false };
        self.options.split_ns.is_some_and(|span| log_time_ns.saturating_sub(first) >= span)
            || self.options.split_bytes.is_some_and(|bytes| self.part.length.load(Ordering::Relaxed) >= bytes)
    }

    /// Ends the chunk that is being filled and hands it to the system, so that an interruption from here on loses
    /// nothing written before.
    ///
    /// # Errors
    /// Where writing fails.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.part.mcap.flush().map_err(|error| write_error(&self.part.path, &error))
    }

    /// Completes the open file and begins the next one, which knows all topics so far.
    ///
    /// # Errors
    /// Where writing fails.
    pub fn split(&mut self) -> Result<(), BagError> {
        let metadata = self.metadata();
        let next = begin(&self.dir, &self.name, self.files(), &self.options, self.patience.as_ref())?;
        let part = std::mem::replace(&mut self.part, next);
        let path = part.path.clone();
        let file = part.close(&metadata.to_yaml())?;
        self.done_bytes += file.metadata().map_err(BagError::io("read", &path))?.len();
        self.done = metadata.files;
        let sync = std::thread::Builder::new().name("bag-sync".into()).spawn({
            let path = path.clone();
            move || file.sync_all().map_err(|error| BagError::io_or_full("write", &path, error))
        });
        self.syncing.push(sync.map_err(BagError::io("write", &path))?);
        for index in 0..self.topics.len() {
            let topic = self.topics[index].topic.clone();
            self.topics[index].channel = self.add_channel(&topic)?;
        }
        Ok(())
    }

    /// The bag's metadata as it is with the open file.
    fn metadata(&self) -> Metadata {
        let mut files = self.done.clone();
        files.push(FileMetadata {
            path: self.part.path.file_name().map(PathBuf::from).unwrap_or_default(),
            span: self.part.span,
            messages: Some(self.part.messages),
        });
        let mut topics: Vec<_> = self.topics.iter().map(|state| TopicMetadata::of(&state.topic)).collect();
        topics.sort_by(|a, b| a.name.cmp(&b.name));
        Metadata { files, span: self.span, messages: self.messages, topics, custom: self.custom.clone() }
    }

    /// Completes the bag: index and footer, then `metadata.yaml` under a temporary name, then its real name.
    ///
    /// # Errors
    /// Where writing fails; the bag is then recognised as interrupted.
    pub fn finish(self) -> Result<BagInfo, BagError> {
        let metadata = self.metadata();
        let yaml = metadata.to_yaml();
        let Self { dir, part, done_bytes, syncing, .. } = self;
        let path = part.path.clone();
        let file = part.close(&yaml)?;
        file.sync_all().map_err(|error| BagError::io_or_full("write", &path, error))?;
        let bytes = done_bytes + file.metadata().map_err(BagError::io("read", &path))?.len();
        for thread in syncing {
            thread.join().map_err(|_| BagError::Write {
                path: dir.clone(),
                problem: "the thread that hands a file to the disk ended by a panic".into(),
            })??;
        }

        write_metadata_file(&dir, &yaml)?;
        Ok(BagInfo {
            path: dir,
            files: metadata.files.len(),
            bytes,
            span: metadata.span,
            messages: metadata.messages,
            topics: metadata.topics.into_iter().map(TopicInfo::from).collect(),
            custom: metadata.custom,
            complete: true,
        })
    }
}
