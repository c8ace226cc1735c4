//! What is whole of a damaged or interrupted file.

use std::{
    collections::{BTreeMap, VecDeque},
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    sync::Arc,
};

use mcap::{
    Channel, Message, Schema, Summary,
    records::{Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use crate::{
    guard::{guarded, parse_record},
    losses,
    reader::record_limit,
};

/// Opcode and length of a record.
const HEAD: u64 = 9;

/// Iterator over the messages of a file, record by record: a damaged chunk is skipped, and the file ends where its next
/// record does not. It fails only where the system does.
pub(crate) struct Recovery {
    file: BufReader<File>,
    at: u64,
    length: u64,
    schemas: BTreeMap<u16, Arc<Schema<'static>>>,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
    waiting: VecDeque<Message<'static>>,
    /// The last note of the recorder that was passed: what is missing.
    pub(crate) note: Option<BTreeMap<String, String>>,
    record: Vec<u8>,
    ended: bool,
}

impl Recovery {
    /// From the start of a file of so many bytes on. Channels that its index names are known even where the chunk that declares
    /// them is damaged.
    pub(crate) fn new(file: BufReader<File>, length: u64, index: Option<Summary>) -> Self {
        let index = index.unwrap_or_default();
        Self {
            file,
            at: mcap::MAGIC.len() as u64,
            length,
            schemas: index.schemas.into_iter().collect(),
            channels: index.channels.into_iter().collect(),
            waiting: VecDeque::new(),
            note: None,
            record: Vec::new(),
            ended: false,
        }
    }

    /// Reads one record; false where there is none any more.
    fn step(&mut self) -> io::Result<bool> {
        if self.at == mcap::MAGIC.len() as u64 {
            self.file.seek(SeekFrom::Start(self.at))?;
        }
        if self.at + HEAD > self.length {
            return Ok(false);
        }
        let mut head = [0; HEAD as usize];
        self.file.read_exact(&mut head)?;
        let mut size = [0; 8];
        size.copy_from_slice(&head[1..]);
        let (opcode, size) = (head[0], u64::from_le_bytes(size));
        let known = (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        self.at += HEAD;
        // The index that follows says nothing that is not known, and beyond a damaged length all is noise.
        if !known || opcode == op::DATA_END || size > self.length - self.at {
            return Ok(false);
        }
        self.at += size;
        let wanted = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK | op::METADATA);
        let limit = record_limit(self.length);
        match usize::try_from(size) {
            Ok(size) if wanted && size <= limit => {
                self.record.resize(size, 0);
                self.file.read_exact(&mut self.record)?;
                let record = std::mem::take(&mut self.record);
                self.take(&head, &record, limit);
                self.record = record;
            }
            _ => {
                self.file.seek(SeekFrom::Start(self.at))?;
            }
        }
        Ok(true)
    }

    fn take(&mut self, head: &[u8], bytes: &[u8], limit: usize) {
        if head[0] != op::CHUNK {
            if let Ok(record) = parse_record(head[0], bytes) {
                self.keep(record.into_owned());
            }
            return;
        }
        // The record alone, read as a file of its own, whose checksum is compared before anything is taken of it.
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(limit);
        let mut reader = LinearReader::new_with_options(options);
        let mut input = head.chain(bytes);
        while let Ok(Some(Ok(event))) = guarded(|| reader.next_event()) {
            match event {
                LinearReadEvent::ReadRequest(size) => {
                    let read = input.read(reader.insert(size)).unwrap_or(0);
                    reader.notify_read(read);
                }
                LinearReadEvent::Record { data, opcode } => {
                    if let Ok(record) = parse_record(opcode, data) {
                        self.keep(record.into_owned());
                    }
                }
            }
        }
    }

    fn keep(&mut self, record: Record<'static>) {
        match record {
            Record::Schema { header, data } => {
                let schema = Schema { id: header.id, name: header.name, encoding: header.encoding, data };
                self.schemas.insert(schema.id, Arc::new(schema));
            }
            Record::Channel(channel) => {
                let made = Channel {
                    id: channel.id,
                    topic: channel.topic,
                    schema: self.schemas.get(&channel.schema_id).cloned(),
                    message_encoding: channel.message_encoding,
                    metadata: channel.metadata,
                };
                self.channels.insert(made.id, Arc::new(made));
            }
            Record::Message { header, data } => {
                // Of a channel that is declared nowhere else than in a damaged chunk not even the type is known.
                if let Some(channel) = self.channels.get(&header.channel_id) {
                    self.waiting.push_back(Message {
                        channel: Arc::clone(channel),
                        sequence: header.sequence,
                        log_time: header.log_time,
                        publish_time: header.publish_time,
                        data,
                    });
                }
            }
            Record::Metadata(metadata) if metadata.name == losses::RECORD => {
                self.note = Some(metadata.metadata);
            }
            _ => {}
        }
    }
}

impl Iterator for Recovery {
    type Item = io::Result<Message<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(message) = self.waiting.pop_front() {
                return Some(Ok(message));
            }
            if self.ended {
                return None;
            }
            match self.step() {
                Ok(true) => {}
                Ok(false) => self.ended = true,
                Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => self.ended = true,
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
    }
}
