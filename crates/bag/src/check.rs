//! Looks at every byte of a bag, and says what is wrong where.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    fs::File,
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::{Path, PathBuf},
};

use dermis_msgs::{
    Message as _,
    msg::{SkinGeometry, TaxelFrame},
    sequence::{Arrival, SequenceTracker},
    type_support,
    v0::Upgrade,
};
use mcap::{
    McapError,
    records::{ChunkIndex, Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use crate::{
    BagError, RecordedLosses,
    error::say,
    guard::{guarded, parse_record},
    losses,
    metadata::Metadata,
    reader::{mcap_files, nanos, read_summary, record_limit},
    versions::upgrade_of,
};

/// Findings of one kind are listed up to this many; the rest is counted.
const LISTED: usize = 20;

/// How grave a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The bag is what it says; somebody should know all the same.
    Note,
    /// Something is missing or contradicts itself.
    Error,
}

/// Something that was found.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Finding {
    /// How grave.
    pub severity: Severity,
    /// The file, and where in it.
    pub place: String,
    /// What is wrong.
    pub problem: String,
}

/// What [`check`] found; `Display` prints it for people.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct BagReport {
    /// The folder or file.
    pub path: PathBuf,
    /// Its `.mcap` files.
    pub files: usize,
    /// Chunks whose checksum was compared.
    pub chunks: u64,
    /// Messages that are whole.
    pub messages: u64,
    /// What was found, the first of each kind in full.
    pub findings: Vec<Finding>,
    /// What the recorder missed, as it counted; `None` where the bag does not say.
    pub losses: Option<RecordedLosses>,
    /// Steps in the numbers of taxel frames, by topic.
    pub missing_frames: BTreeMap<String, MissingFrames>,
}

/// Taxel frames that a topic lacks, by their numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct MissingFrames {
    /// Frames that the skin numbered and that are not there.
    pub frames: u64,
    /// Places where some are missing.
    pub gaps: u64,
}

impl BagReport {
    /// Whether nothing is wrong; notes don't count.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity == Severity::Note)
    }

    /// Whether nothing is wrong, nothing is known to be missing, and a recorder that counts has recorded it.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.is_sound()
            && self.missing_frames.is_empty()
            && self.losses.as_ref().is_some_and(RecordedLosses::is_complete)
    }

    /// What is missing, in words; empty where nothing is known to be.
    #[must_use]
    pub fn missing(&self) -> String {
        let mut clauses = Vec::new();
        if let Some(losses) = self.losses.as_ref().filter(|losses| !losses.is_complete()) {
            clauses.push(losses.to_string());
        }
        if !self.missing_frames.is_empty() {
            let of = self.missing_frames.iter();
            let of = of.map(|(topic, m)| format!("{topic} {} in {}", m.frames, gap_count(m.gaps)));
            clauses.push(format!("taxel frames are missing: {}", of.collect::<Vec<_>>().join(", ")));
        }
        clauses.join("; ")
    }
}

fn gap_count(count: u64) -> String {
    if count == 1 { "1 place".to_owned() } else { format!("{count} places") }
}

impl fmt::Display for BagReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            let word = if finding.severity == Severity::Note { "note: " } else { "" };
            writeln!(f, "{}: {word}{}", finding.place, finding.problem)?;
        }
        let missing = self.missing();
        let (word, but) = (
            if self.is_sound() { "sound" } else { "not sound" },
            if self.is_sound() { "but" } else { "and" },
        );
        write!(
            f,
            "{}: {word}{}{missing} ({} messages, {} chunks, {} files)",
            self.path.display(),
            if missing.is_empty() { String::new() } else { format!(", {but} ") },
            self.messages,
            self.chunks,
            self.files
        )
    }
}

/// Gathers findings, few of each kind.
#[derive(Default)]
struct Findings {
    list: Vec<Finding>,
    counts: BTreeMap<(String, &'static str, Severity), usize>,
}

impl Findings {
    fn add(&mut self, severity: Severity, place: String, kind: &'static str, problem: String) {
        let count = self.counts.entry((place.clone(), kind, severity)).or_default();
        *count += 1;
        if *count <= LISTED {
            self.list.push(Finding { severity, place, problem });
        }
    }

    fn error(&mut self, place: impl fmt::Display, kind: &'static str, problem: String) {
        self.add(Severity::Error, place.to_string(), kind, problem);
    }

    fn finish(mut self) -> Vec<Finding> {
        for ((place, kind, severity), count) in self.counts {
            if count > LISTED {
                let problem = format!("{} more of this kind: {kind}", count - LISTED);
                self.list.push(Finding { severity, place, problem });
            }
        }
        self.list
    }
}

/// Numbers of the frames of a topic, over all files.
#[derive(Default)]
struct Frames {
    /// By the name of the skin.
    skins: BTreeMap<String, SequenceTracker>,
    gaps: u64,
}

impl Frames {
    fn missing(&self) -> MissingFrames {
        MissingFrames { frames: self.skins.values().map(SequenceTracker::missing).sum(), gaps: self.gaps }
    }
}

/// What is carried from file to file.
#[derive(Default)]
struct Across {
    frames: BTreeMap<String, Frames>,
    /// Types that were inspected.
    types: BTreeSet<String>,
    /// What the last note of the recorder says is missing.
    noted: Option<BTreeMap<String, String>>,
    /// Channel layouts that geometries name, by skin.
    layouts: BTreeSet<(String, u32)>,
    /// Those that frames refer to, with their topic.
    used: BTreeMap<(String, u32), String>,
}

/// What the messages of a file are.
#[derive(Default)]
struct Seen {
    messages: u64,
    chunks: u64,
    span: Option<(i64, i64)>,
    topics: BTreeMap<String, u64>,
}

/// Checks a bag: the checksum of every chunk, data section and index, the indexes against the messages, the order of the
/// messages of each topic, every type against what is built in here, the `sequence` of every taxel frame, and
/// `metadata.yaml` against the files.
///
/// # Errors
/// Where nothing can be read at all. What is wrong with the bag is in the report.
pub fn check(path: impl AsRef<Path>) -> Result<BagReport, BagError> {
    let path = path.as_ref();
    if !path.exists() {
        return Err(BagError::Missing { path: path.into() });
    }
    let mut findings = Findings::default();
    let (files, metadata) = files_of(path, &mut findings)?;
    let mut all = Seen::default();
    let mut across = Across::default();
    for (index, file) in files.iter().enumerate() {
        let mut state = FileCheck {
            file,
            findings: &mut findings,
            seen: Seen::default(),
            last: BTreeMap::new(),
            across: &mut across,
        };
        state.run()?;
        let seen = state.seen;
        if let Some(said) = metadata.as_ref().and_then(|metadata| metadata.files.get(index)) {
            let place = path.join("metadata.yaml");
            let name = said.path.display();
            if said.messages.is_some_and(|messages| messages != seen.messages) {
                findings.error(
                    place.display(),
                    "counts",
                    format!(
                        "says {} messages of {name}, which has {}",
                        said.messages.unwrap_or(0),
                        seen.messages
                    ),
                );
            } else if said.messages.is_some() && said.span != seen.span {
                findings.error(
                    place.display(),
                    "times",
                    format!("says {} of {name}, whose messages are {}", span(said.span), span(seen.span)),
                );
            }
        }
        all.chunks += seen.chunks;
        all.messages += seen.messages;
        if let Some((first, last)) = seen.span {
            let known = all.span.unwrap_or((first, last));
            all.span = Some((known.0.min(first), known.1.max(last)));
        }
        for (topic, count) in seen.topics {
            *all.topics.entry(topic).or_default() += count;
        }
    }
    if let Some(metadata) = &metadata {
        compare(path, metadata, &all, &mut findings);
    }
    for ((skin, layout), topic) in &across.used {
        if !across.layouts.contains(&(skin.clone(), *layout)) {
            let problem = format!(
                "nothing here names the channels of the frames of skin `{skin}` on {topic} (layout {layout:08x}): keep its \
                 skin description beside the bag, or record skin_geometry with it"
            );
            findings.add(Severity::Note, path.display().to_string(), "layouts", problem);
        }
    }
    let said = metadata.as_ref().map(|metadata| &metadata.custom).or(across.noted.as_ref());
    let missing = across.frames.iter().map(|(topic, frames)| (topic.clone(), frames.missing()));
    Ok(BagReport {
        losses: said.and_then(RecordedLosses::of),
        missing_frames: missing.filter(|(_, missing)| missing.frames > 0).collect(),
        path: path.into(),
        files: files.len(),
        chunks: all.chunks,
        messages: all.messages,
        findings: findings.finish(),
    })
}

fn span(span: Option<(i64, i64)>) -> String {
    span.map_or("no time".into(), |(first, last)| format!("{first} to {last} ns"))
}

/// The files that belong to a bag, and what its metadata says, where it has some that can be read.
fn files_of(path: &Path, findings: &mut Findings) -> Result<(Vec<PathBuf>, Option<Metadata>), BagError> {
    if !path.is_dir() {
        return Ok((vec![path.to_path_buf()], None));
    }
    let yaml = path.join("metadata.yaml");
    let present = mcap_files(path)?;
    if !yaml.exists() {
        if present.is_empty() {
            return Err(BagError::NoMetadata { path: path.into(), files: 0 });
        }
        let problem = "is missing: the recording was interrupted before it was finished";
        findings.error(yaml.display(), "metadata", problem.into());
        return Ok((present, None));
    }
    let metadata = match Metadata::read(&yaml) {
        Ok(metadata) => metadata,
        Err(BagError::Metadata { problem, .. }) => {
            findings.error(yaml.display(), "metadata", format!("is not rosbag2 metadata: {problem}"));
            return Ok((present, None));
        }
        Err(error) => return Err(error),
    };
    let mut files = Vec::new();
    for file in &metadata.files {
        let file = path.join(&file.path);
        if file.exists() {
            files.push(file);
        } else {
            findings.error(yaml.display(), "files", format!("names {}, which is missing", file.display()));
        }
    }
    for file in present.iter().filter(|file| !files.contains(file)) {
        findings.error(
            file.display(),
            "files",
            "is not named in metadata.yaml: `ros2 bag` leaves it out".into(),
        );
    }
    if files.len() == metadata.files.len() {
        return Ok((files, Some(metadata)));
    }
    // What it says of the whole cannot hold.
    Ok((files, None))
}

fn compare(path: &Path, metadata: &Metadata, seen: &Seen, findings: &mut Findings) {
    let yaml = path.join("metadata.yaml");
    if metadata.messages != seen.messages {
        findings.error(
            yaml.display(),
            "counts",
            format!("says {} messages, the files have {}", metadata.messages, seen.messages),
        );
    } else if metadata.span != seen.span {
        findings.error(
            yaml.display(),
            "times",
            format!("says {}, the messages are {}", span(metadata.span), span(seen.span)),
        );
    }
    let said: BTreeMap<&str, u64> = metadata.topics.iter().map(|t| (t.name.as_str(), t.messages)).collect();
    for (topic, &count) in &seen.topics {
        match said.get(topic.as_str()) {
            Some(&messages) if messages == count => {}
            Some(messages) => findings.error(
                yaml.display(),
                "counts",
                format!("says {messages} messages on {topic}, the files have {count}"),
            ),
            None => findings.error(
                yaml.display(),
                "topics",
                format!("does not name {topic} with its {count} messages"),
            ),
        }
    }
    for (topic, messages) in said {
        if messages > 0 && !seen.topics.contains_key(topic) {
            findings.error(
                yaml.display(),
                "counts",
                format!("says {messages} messages on {topic}, the files have none"),
            );
        }
    }
}

struct Channel {
    topic: String,
    type_name: String,
    upgrade: Option<&'static Upgrade>,
}

struct FileCheck<'a> {
    file: &'a Path,
    findings: &'a mut Findings,
    seen: Seen,
    /// Last log time of each topic.
    last: BTreeMap<String, i64>,
    across: &'a mut Across,
}

impl FileCheck<'_> {
    fn error(&mut self, kind: &'static str, problem: String) {
        self.findings.error(self.file.display(), kind, problem);
    }

    fn run(&mut self) -> Result<(), BagError> {
        let mut file = dermis_io::open(self.file).map_err(BagError::io("open", self.file))?;
        let length = file.metadata().map_err(BagError::io("read", self.file))?.len();
        let mut channels = BTreeMap::new();
        let mut schemas = BTreeMap::new();
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(record_limit(length));
        let mut reader = LinearReader::new_with_options(options);
        let mut input = BufReader::with_capacity(1 << 20, &mut file);
        let mut failure = None;
        while let Some(event) = guarded(|| reader.next_event()).transpose() {
            match event.and_then(|event| event) {
                Ok(LinearReadEvent::ReadRequest(size)) => {
                    let read = input.read(reader.insert(size)).map_err(BagError::io("read", self.file))?;
                    reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { data, opcode }) => match parse_record(opcode, data) {
                    Ok(record) => self.record(&record, &mut schemas, &mut channels),
                    Err(error) => failure = Some(error),
                },
                Err(error) => failure = Some(error),
            }
            if failure.is_some() {
                break;
            }
        }
        if let Some(error) = failure {
            let after = format!("after {} whole messages", self.seen.messages);
            match error {
                McapError::UnexpectedEof => self.error("end", format!("ends in the middle, {after}")),
                error => self.error("damage", format!("is damaged {after}: {}", say(&error))),
            }
            return Ok(());
        }
        drop(input);
        self.indexes(&mut file, length)
    }

    fn record(
        &mut self,
        record: &Record<'_>,
        schemas: &mut BTreeMap<u16, (String, String)>,
        channels: &mut BTreeMap<u16, Channel>,
    ) {
        match record {
            Record::Schema { header, data } => {
                schemas.insert(header.id, (header.name.clone(), String::from_utf8_lossy(data).into_owned()));
            }
            Record::Channel(channel) => {
                let (type_name, definition) = schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                if type_name.is_empty() {
                    self.error("schemas", format!("topic {} has no schema", channel.topic));
                }
                let hash = channel.metadata.get("topic_type_hash").map_or("", String::as_str);
                let upgrade = upgrade_of(&type_name, Some(hash).filter(|hash| !hash.is_empty()), &definition);
                self.type_of(&channel.topic, &type_name, hash, &definition);
                channels.insert(channel.id, Channel { topic: channel.topic.clone(), type_name, upgrade });
            }
            Record::Message { header, data } => {
                let Some(channel) = channels.get(&header.channel_id) else {
                    return self.error(
                        "channels",
                        format!(
                            "message {} is on channel {}, which is not declared",
                            self.seen.messages, header.channel_id
                        ),
                    );
                };
                let time = nanos(header.log_time);
                self.seen.messages += 1;
                let known = self.seen.span.unwrap_or((time, time));
                self.seen.span = Some((known.0.min(time), known.1.max(time)));
                match self.seen.topics.get_mut(&channel.topic) {
                    Some(count) => *count += 1,
                    None => {
                        self.seen.topics.insert(channel.topic.clone(), 1);
                    }
                }
                self.order(&channel.topic, time);
                self.content(channel, data, time);
            }
            Record::ChunkIndex(_) => self.seen.chunks += 1,
            Record::Metadata(note) if note.name == losses::RECORD => {
                self.across.noted = Some(note.metadata.clone());
            }
            _ => {}
        }
    }

    fn order(&mut self, topic: &str, time: i64) {
        match self.last.get_mut(topic) {
            Some(last) if time < *last => {
                let problem = format!("message on {topic} at {time} ns is stored after one at {last} ns");
                self.error("order", problem);
            }
            Some(last) => *last = time,
            None => {
                self.last.insert(topic.to_owned(), time);
            }
        }
    }

    /// Decodes what is known here, and follows the sequence of taxel frames.
    fn content(&mut self, channel: &Channel, data: &[u8], time: i64) {
        let topic = &channel.topic;
        if !matches!(data, [0, _, _, _, ..]) {
            return self.error(
                "content",
                format!("message on {topic} at {time} ns has no CDR encapsulation header"),
            );
        }
        // The unit that an old geometry lacks is of no interest here.
        let converted = channel.upgrade.map(|upgrade| upgrade.apply(data, &|_| None)).transpose();
        let converted = match converted {
            Ok(converted) => converted,
            Err(error) => return self.error("content", format!("message on {topic} at {time} ns: {error}")),
        };
        let data = converted.as_deref().unwrap_or(data);
        let known = channel.upgrade.is_some();
        if channel.type_name == SkinGeometry::TYPE_NAME {
            if let Ok(geometry) = SkinGeometry::from_cdr(data) {
                self.across.layouts.insert((geometry.skin, geometry.layout_id));
            }
            return;
        }
        if channel.type_name != TaxelFrame::TYPE_NAME {
            return;
        }
        match TaxelFrame::from_cdr(data) {
            Ok(frame) => {
                // What is of before names its channels itself.
                if !known && frame.layout_id != 0 {
                    let layout = (frame.skin.clone(), frame.layout_id);
                    self.across.used.entry(layout).or_insert_with(|| topic.clone());
                }
                let frames = self.across.frames.entry(topic.clone()).or_default();
                let stamp = Some(frame.header.stamp.as_nanos()).filter(|stamp| *stamp != 0);
                let sequence = frame.sequence;
                // The recorder, or the link to the skin, may have lost some: the bag is what it says.
                let problem = match frames.skins.entry(frame.skin).or_default().observe(sequence, stamp) {
                    Arrival::First | Arrival::Next => return,
                    Arrival::After(count) => {
                        frames.gaps += 1;
                        format!("{topic} lacks {count} frames before {time} ns")
                    }
                    Arrival::Late => format!("frame {sequence} of {topic} is stored late, at {time} ns"),
                    Arrival::Repeated => format!("frame {sequence} of {topic} is there again at {time} ns"),
                    Arrival::Restarted => {
                        format!("the frames of {topic} count from {sequence} again at {time} ns")
                    }
                };
                self.findings.add(Severity::Note, self.file.display().to_string(), "sequence", problem);
            }
            Err(error) => self.error("content", format!("message on {topic} at {time} ns: {error}")),
        }
    }

    fn type_of(&mut self, topic: &str, type_name: &str, hash: &str, definition: &str) {
        if !self.across.types.insert(topic.to_owned()) {
            return;
        }
        let Some(support) = type_support(type_name) else { return };
        if hash == support.hash {
            return;
        }
        if upgrade_of(type_name, Some(hash).filter(|hash| !hash.is_empty()), definition).is_some() {
            let problem = format!(
                "{topic} was recorded with {type_name} as it was defined before: it is converted as it is read, \
                 `dermis bag convert` writes it anew"
            );
            return self.findings.add(Severity::Note, self.file.display().to_string(), "types", problem);
        }
        let difference = if definition.is_empty() {
            None
        } else {
            crate::definition::difference(type_name, definition, support.definition)
        };
        if let Some(difference) = difference {
            let problem = format!("{topic} was recorded with another version of {type_name}: {difference}");
            self.findings.add(Severity::Note, self.file.display().to_string(), "types", problem);
        } else if !hash.is_empty() {
            self.error(
                "types",
                format!("{topic} has the hash {hash}, its definition that of {}", support.hash),
            );
        }
    }

    /// The indexes against what was found, and against what they point at.
    fn indexes(&mut self, file: &mut File, length: u64) -> Result<(), BagError> {
        let summary = match read_summary(file, length) {
            Ok(Some(summary)) => summary,
            Ok(None) => {
                self.findings.add(
                    Severity::Note,
                    self.file.display().to_string(),
                    "index",
                    "has no index: reading it is slow".into(),
                );
                return Ok(());
            }
            Err(McapError::Io(source)) => {
                return Err(BagError::Io { action: "read", path: self.file.into(), source });
            }
            Err(error) => {
                self.error("index", format!("has a damaged index: {}", say(&error)));
                return Ok(());
            }
        };
        if let Some(stats) = &summary.stats {
            if stats.message_count != self.seen.messages {
                let problem = format!(
                    "its index counts {} messages, it has {}",
                    stats.message_count, self.seen.messages
                );
                self.error("index", problem);
            }
            let said = (stats.message_count > 0)
                .then(|| (nanos(stats.message_start_time), nanos(stats.message_end_time)));
            if said != self.seen.span {
                let problem =
                    format!("its index says {}, its messages are {}", span(said), span(self.seen.span));
                self.error("index", problem);
            }
        }
        for chunk in &summary.chunk_indexes {
            if let Some(problem) =
                wrong_chunk(file, chunk, length).map_err(BagError::io("read", self.file))?
            {
                self.error(
                    "index",
                    format!("the index of the chunk at byte {} {problem}", chunk.chunk_start_offset),
                );
            }
        }
        Ok(())
    }
}

/// Compares an index with the head of the chunk that it points at.
fn wrong_chunk(file: &mut File, index: &ChunkIndex, length: u64) -> std::io::Result<Option<String>> {
    // Opcode, length; start, end, size, checksum of the chunk.
    let mut head = [0; 9 + 28];
    if index.chunk_start_offset.saturating_add(head.len() as u64) > length {
        return Ok(Some("points beyond the end of the file".into()));
    }
    file.seek(SeekFrom::Start(index.chunk_start_offset))?;
    file.read_exact(&mut head)?;
    let number = |at: usize| u64::from_le_bytes(head[at..at + 8].try_into().unwrap_or_default());
    if head[0] != op::CHUNK {
        return Ok(Some("points at something else".into()));
    }
    if number(1).saturating_add(9) != index.chunk_length || number(25) != index.uncompressed_size {
        return Ok(Some("has another size than the chunk".into()));
    }
    if (number(9), number(17)) != (index.message_start_time, index.message_end_time) {
        return Ok(Some("has other times than the chunk".into()));
    }
    Ok(None)
}
