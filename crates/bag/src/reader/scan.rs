//! What is in the files of a bag: from their summaries, or message by message where they have none.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::sans_io::{SummaryReadEvent, SummaryReader, summary_reader::SummaryReaderOptions};
use mcap::{McapError, Summary};
use yaml_rust2::Yaml;

use super::Topic;
use super::messages::{FileMessages, Reader};
use crate::guard::{guarded, parse_record};
use crate::{BagError, BagQos, losses};

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

/// Times of one file.
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

/// What the files themselves hold; `metadata.yaml` is applied over it.
#[derive(Default)]
pub(super) struct Contents {
    pub(super) topics: BTreeMap<String, Topic>,
    pub(super) span: Option<(i64, i64)>,
    pub(super) messages: u64,
    /// The last note of the recorder: what is missing.
    pub(super) note: Option<BTreeMap<String, String>>,
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

    /// Extends the span by a file or message.
    pub(super) fn widen(&mut self, first: i64, last: i64) {
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
        if let Reader::Lenient(recovery) = messages.reader {
            self.note = recovery.note.or(self.note.take());
        }
        Ok(())
    }
}

/// A time of the file format as that of the public interface.
pub(crate) fn nanos(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

/// The `.mcap` files of a folder, in the order in which they were recorded.
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
pub(super) fn scan(path: &Path, recover: bool, contents: &mut Contents) -> Result<(bool, i64), BagError> {
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
        // The scan of the messages below finds the exact damage.
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

/// The last note of the recorder in a file that has an index. One that cannot be read counts as none: it is no message.
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

/// The index at the end of a file; `None` where it has none.
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
