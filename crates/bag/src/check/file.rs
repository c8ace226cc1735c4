//! One file of a bag: its records, the messages in them, and its indexes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _, SeekFrom};
use std::path::Path;

use dermis_msgs::Message as _;
use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_msgs::sequence::Arrival;
use dermis_msgs::type_support;
use dermis_msgs::v0::Upgrade;
use mcap::McapError;
use mcap::records::{ChunkIndex, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::{Across, Findings, Seen, Severity, span};
use crate::BagError;
use crate::error::say;
use crate::guard::{guarded, parse_record};
use crate::losses;
use crate::reader::{nanos, read_summary, record_limit};
use crate::versions::upgrade_of;

struct Channel {
    topic: String,
    type_name: String,
    upgrade: Option<&'static Upgrade>,
}

pub(super) struct FileCheck<'a> {
    pub(super) file: &'a Path,
    pub(super) findings: &'a mut Findings,
    pub(super) seen: Seen,
    /// Last log time of each topic.
    pub(super) last: BTreeMap<String, i64>,
    pub(super) across: &'a mut Across,
}

impl FileCheck<'_> {
    fn error(&mut self, kind: &'static str, problem: String) {
        self.findings.error(self.file.display(), kind, problem);
    }

    pub(super) fn run(&mut self) -> Result<(), BagError> {
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
