//! Writes a bag.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
};

use dermis_msgs::{Message, TypeSupport};

use crate::{
    BagError, BagInfo, BagQos, TopicInfo,
    error::say,
    metadata::{Metadata, TopicMetadata},
};

/// Uncompressed bytes of a chunk: a reader holds one chunk in memory, and an interruption loses at most one.
const CHUNK_BYTES: u64 = 768 * 1024;

struct TopicState {
    channel: u16,
    sequence: u32,
    metadata: TopicMetadata,
}

/// Writes one bag: `<dir>/<name>_0.mcap` and, in [`finish`](Self::finish), `<dir>/metadata.yaml`.
///
/// A writer that is dropped without `finish` completes the `.mcap` file as well as it can but writes no
/// `metadata.yaml`, so that the bag is recognised as interrupted.
pub struct BagWriter {
    dir: PathBuf,
    file: PathBuf,
    mcap: mcap::Writer<BufWriter<File>>,
    topics: BTreeMap<String, TopicState>,
    span: Option<(i64, i64)>,
    messages: u64,
    custom: BTreeMap<String, String>,
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

impl BagWriter {
    /// Makes the folder `dir` and starts a bag named like it.
    ///
    /// # Errors
    /// Where the folder exists and is not empty, or cannot be made.
    pub fn create(dir: impl AsRef<Path>) -> Result<Self, BagError> {
        let dir = dir.as_ref().to_path_buf();
        let name = match dir.file_name() {
            Some(name) => name.to_string_lossy().into_owned(),
            None => "bag".to_owned(),
        };
        if dir.exists() {
            let mut entries = std::fs::read_dir(&dir).map_err(BagError::io("open", &dir))?;
            if entries.next().is_some() {
                return Err(BagError::Exists { path: dir });
            }
        }
        std::fs::create_dir_all(&dir).map_err(BagError::io("create", &dir))?;
        let file = dir.join(format!("{name}_0.mcap"));
        let handle = File::create_new(&file).map_err(BagError::io("create", &file))?;
        let mcap = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("dermis-bag ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .create(BufWriter::new(handle))
            .map_err(|error| BagError::Write { path: file.clone(), problem: say(&error) })?;
        Ok(Self {
            dir,
            file,
            mcap,
            topics: BTreeMap::new(),
            span: None,
            messages: 0,
            custom: BTreeMap::new(),
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

    /// Adds an entry to the custom data of `metadata.yaml`: where an imported recording comes from, what was
    /// assumed. The same key again replaces its value.
    pub fn set_custom(&mut self, key: impl Into<String>, value: impl Into<String>) {
        self.custom.insert(key.into(), value.into());
    }

    /// Declares a topic with its offered quality of service before its first message. A topic that was not
    /// declared gets [`BagQos::sensor_data`].
    ///
    /// # Errors
    /// Where the topic exists with another type, or writing fails.
    pub fn add_topic(&mut self, topic: &str, support: &TypeSupport, qos: BagQos) -> Result<(), BagError> {
        let name = absolute(topic);
        if let Some(state) = self.topics.get(&name) {
            return self.check_type(&name, &state.metadata.type_name, support.name);
        }
        let write_error = |error| BagError::Write { path: self.file.clone(), problem: say(&error) };
        let schema = self
            .mcap
            .add_schema(support.name, "ros2msg", support.definition.as_bytes())
            .map_err(write_error)?;
        let channel_metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), qos.to_yaml("")),
            ("topic_type_hash".to_owned(), support.hash.to_owned()),
        ]);
        let write_error = |error| BagError::Write { path: self.file.clone(), problem: say(&error) };
        let channel = self.mcap.add_channel(schema, &name, "cdr", &channel_metadata).map_err(write_error)?;
        let metadata = TopicMetadata {
            name: name.clone(),
            type_name: support.name.to_owned(),
            encoding: "cdr".to_owned(),
            qos: Some(qos),
            type_hash: Some(support.hash.to_owned()),
            messages: 0,
        };
        self.topics.insert(name, TopicState { channel, sequence: 0, metadata });
        Ok(())
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
        let refused = |problem: &str| BagError::Refused {
            path: self.dir.clone(),
            topic: name.clone(),
            problem: problem.to_owned(),
        };
        let Ok(time) = u64::try_from(log_time_ns) else {
            return Err(refused(&format!("its time of {log_time_ns} ns is before 1970")));
        };
        if !matches!(cdr, [0, 0 | 1, _, _, ..]) {
            return Err(refused(
                "it does not start with a CDR encapsulation header (00 01 00 00 or 00 00 00 00)",
            ));
        }
        match self.topics.get(&name) {
            Some(state) => self.check_type(&name, &state.metadata.type_name, support.name)?,
            None => self.add_topic(&name, support, BagQos::sensor_data())?,
        }
        let Some(state) = self.topics.get_mut(&name) else {
            return Err(BagError::Refused {
                path: self.dir.clone(),
                topic: name,
                problem: "it was not declared".into(),
            });
        };
        let header = mcap::records::MessageHeader {
            channel_id: state.channel,
            sequence: state.sequence,
            log_time: time,
            publish_time: time,
        };
        self.mcap
            .write_to_known_channel(&header, cdr)
            .map_err(|error| BagError::Write { path: self.file.clone(), problem: say(&error) })?;
        state.sequence = state.sequence.wrapping_add(1);
        state.metadata.messages += 1;
        self.messages += 1;
        self.span = Some(self.span.map_or((log_time_ns, log_time_ns), |(first, last)| {
            (first.min(log_time_ns), last.max(log_time_ns))
        }));
        Ok(())
    }

    /// Ends the chunk that is being filled and hands it to the system, so that an interruption from here on loses
    /// nothing written before.
    ///
    /// # Errors
    /// Where writing fails.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.mcap.flush().map_err(|error| BagError::Write { path: self.file.clone(), problem: say(&error) })
    }

    /// Completes the bag: index and footer, then `metadata.yaml` under a temporary name, then its real name.
    ///
    /// # Errors
    /// Where writing fails; the bag is then recognised as interrupted.
    pub fn finish(mut self) -> Result<BagInfo, BagError> {
        let write_error =
            |path: &Path, error: &mcap::McapError| BagError::Write { path: path.into(), problem: say(error) };
        let name = self.file.file_name().map(PathBuf::from).unwrap_or_default();
        let metadata = Metadata {
            files: vec![name],
            span: self.span,
            messages: self.messages,
            topics: self.topics.values().map(|state| state.metadata.clone()).collect(),
            custom: self.custom.clone(),
        };
        let yaml = metadata.to_yaml();
        // The same text inside the file, as the rosbag2 plugin stores it, so that the .mcap alone tells all.
        self.mcap
            .write_metadata(&mcap::records::Metadata {
                name: "rosbag2".into(),
                metadata: BTreeMap::from([("serialized_metadata".to_owned(), yaml.clone())]),
            })
            .map_err(|error| write_error(&self.file, &error))?;
        self.mcap.finish().map_err(|error| write_error(&self.file, &error))?;
        let handle = self.mcap.into_inner().into_inner().map_err(std::io::IntoInnerError::into_error);
        let handle = handle.map_err(BagError::io("write", &self.file))?;
        handle.sync_all().map_err(BagError::io("write", &self.file))?;
        let bytes = handle.metadata().map_err(BagError::io("read", &self.file))?.len();

        let target = self.dir.join("metadata.yaml");
        let partial = self.dir.join("metadata.yaml.partial");
        let mut out = File::create(&partial).map_err(BagError::io("create", &partial))?;
        out.write_all(yaml.as_bytes()).map_err(BagError::io("write", &partial))?;
        out.sync_all().map_err(BagError::io("write", &partial))?;
        std::fs::rename(&partial, &target).map_err(BagError::io("rename", &partial))?;
        Ok(BagInfo {
            path: self.dir,
            bytes,
            span: metadata.span,
            messages: metadata.messages,
            topics: metadata.topics.into_iter().map(TopicInfo::from).collect(),
            custom: metadata.custom,
            complete: true,
        })
    }
}

impl From<TopicMetadata> for TopicInfo {
    fn from(topic: TopicMetadata) -> Self {
        Self {
            name: topic.name,
            type_name: topic.type_name,
            messages: topic.messages,
            type_hash: topic.type_hash,
            qos: topic.qos,
        }
    }
}
