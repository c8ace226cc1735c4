//! Recordings as a source: the `TaxelFrame`s of a rosbag2, sent again as native wire bytes.
//!
//! A recording is read from front to back and held in memory one record at a time, so that its length does not matter.
//! Unlike a device it can wait: a slow consumer holds it up, and nothing is dropped.
//!
//! A device is one skin: frames of two skins, or of one skin on two topics, are never sent one between the other. Where a
//! recording has several, it has to be said which is meant.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bytes::Bytes;
use dermis_msgs::Message;
use dermis_msgs::msg::TaxelFrame;
use dermis_msgs::v0::Upgrade;
use mcap::records::Record;
use mcap::sans_io::{
    LinearReadEvent, LinearReader, LinearReaderOptions, SummaryReadEvent, SummaryReader, SummaryReaderOptions,
};

use super::Stop;
use super::queue::Queue;
use crate::TransportError;
use crate::framing::{NativeEncoder, NativeFormat};

/// \[bytes\] longest record that is read; a damaged length must not ask for all the memory.
const RECORD_LIMIT: usize = 64 << 20;

/// Longest pause that is kept; a damaged time stamp must not halt a replay for good.
const MAX_WAIT: Duration = Duration::from_secs(3600);

pub(super) struct Plan<'a> {
    pub(super) path: &'a Path,
    pub(super) speed: f64,
    pub(super) topic: Option<&'a str>,
    pub(super) skin: Option<&'a str>,
    pub(super) repeat: bool,
}

/// Sends the whole recording, or says why it cannot.
pub(super) fn run(plan: &Plan<'_>, queue: &Queue, stop: &Stop) -> Result<(), String> {
    let files = files(plan.path)?;
    let topics = choose_topics(&files, plan)?;
    let pace = match plan.speed {
        0.0 => "as fast as possible".to_owned(),
        speed => format!("at {speed} times its pace"),
    };
    let shown = topics.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    queue.connected(&format!("recording {}, topic {shown}, {pace}", plan.path.display()));
    let mut player = Player {
        topics: &topics,
        skin: plan.skin.map(str::to_owned),
        chosen: plan.skin.is_some(),
        from: None,
        others: BTreeSet::new(),
        layout: None,
        queue,
        stop,
        output: Output::new(plan.speed),
        sent: 0,
    };
    loop {
        let before = player.sent;
        for file in &files {
            if player.play(file)? == Go::Stop {
                return Ok(());
            }
        }
        if player.sent == before {
            let place = plan.path.display();
            return Err(match plan.skin {
                Some(skin) if !player.others.is_empty() => {
                    let others = player.others.into_iter().collect::<Vec<_>>().join("`, `");
                    format!("{place} holds no frame of skin `{skin}`; it has those of `{others}`")
                }
                _ => format!("topic {shown} of {place} holds no frame"),
            });
        }
        if !plan.repeat {
            return Ok(());
        }
        player.output.start_again();
    }
}

/// The MCAP files of a recording, in the order in which they were written.
fn files(path: &Path) -> Result<Vec<PathBuf>, String> {
    let shown = path.display();
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = std::fs::read_dir(path).map_err(|e| format!("cannot open the recording {shown}: {e}"))?;
    let mut files: Vec<PathBuf> =
        entries.flatten().map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "mcap")).collect();
    // rosbag2 splits into name_0.mcap, name_1.mcap, … name_10.mcap.
    files.sort_by_key(|p| {
        let stem = p.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.rsplit_once('_').and_then(|(_, n)| n.parse::<u64>().ok());
        (number.unwrap_or(0), stem)
    });
    if files.is_empty() {
        return Err(format!("{shown} is no recording: a rosbag2 folder holds .mcap files"));
    }
    Ok(files)
}

/// Topic names by type name.
type Topics = BTreeMap<String, BTreeSet<String>>;

/// The topics that the summary at the end of a file lists; nothing where the recorder did not get to write one.
fn summary_topics(path: &Path, topics: &mut Topics) -> Result<(), String> {
    let open = |e: std::io::Error| format!("cannot read {}: {e}", path.display());
    let mut file = dermis_io::open(path).map_err(open)?;
    let size = file.metadata().map_err(open)?.len();
    let options = SummaryReaderOptions::default().with_file_size(size).with_record_length_limit(RECORD_LIMIT);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(n)) => {
                let n = file.read(reader.insert(n)).map_err(open)?;
                reader.notify_read(n);
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => reader.notify_seeked(file.seek(to).map_err(open)?),
            Err(_) => return Ok(()),
        }
    }
    for channel in reader.finish().iter().flat_map(|s| s.channels.values()) {
        let type_name = channel.schema.as_ref().map_or("", |s| &s.name);
        topics.entry(type_name.to_owned()).or_default().insert(channel.topic.clone());
    }
    Ok(())
}

fn same_topic(a: &str, b: &str) -> bool {
    a.trim_start_matches('/') == b.trim_start_matches('/')
}

/// The topic that is meant; all that could carry the skin where only that is named.
fn choose_topics(files: &[PathBuf], plan: &Plan<'_>) -> Result<BTreeSet<String>, String> {
    let shown = plan.path.display();
    let mut topics = Topics::new();
    for file in files {
        summary_topics(file, &mut topics)?;
        if topics.is_empty() {
            scan_topics(file, &mut topics)?;
        }
    }
    let frames = topics.get(TaxelFrame::TYPE_NAME).cloned().unwrap_or_default();
    let listed = || frames.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    if frames.is_empty() {
        let types = topics.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        let types = if types.is_empty() { "none".to_owned() } else { types };
        return Err(format!("{shown} holds no {}; its types are: {types}", TaxelFrame::TYPE_NAME));
    }
    match plan.topic {
        Some(wanted) => frames
            .iter()
            .find(|t| same_topic(t, wanted))
            .map(|topic| BTreeSet::from([topic.clone()]))
            .ok_or_else(|| {
                format!(
                    "{shown} has no topic {wanted} of type {}; it has {}",
                    TaxelFrame::TYPE_NAME,
                    listed()
                )
            }),
        None if frames.len() > 1 && plan.skin.is_none() => Err(format!(
            "{shown} holds frames on several topics, choose one with topic=…, or a skin with skin=…: {}",
            listed()
        )),
        None => Ok(frames),
    }
}

/// The topics of a file without a summary, as a recorder leaves it that was killed.
fn scan_topics(path: &Path, topics: &mut Topics) -> Result<(), String> {
    let mut schemas = HashMap::new();
    let result = read_records(path, |record| {
        match record {
            Record::Schema { header, .. } => {
                schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let name = schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                topics.entry(name).or_default().insert(channel.topic);
            }
            _ => {}
        }
        Ok(Go::On)
    });
    // What is readable of a damaged file is played; playing it says where it ends.
    if topics.is_empty() { result.map(|_| ()) } else { Ok(()) }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Go {
    On,
    Stop,
}

fn read_records(path: &Path, mut each: impl FnMut(Record<'_>) -> Result<Go, String>) -> Result<Go, String> {
    let damaged = |e: mcap::McapError| format!("{} is damaged or cut off: {e}", path.display());
    let mut file = dermis_io::open(path).map_err(|e| format!("cannot open {}: {e}", path.display()))?;
    let options =
        LinearReaderOptions::default().with_record_length_limit(RECORD_LIMIT).with_validate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event.map_err(damaged)? {
            LinearReadEvent::ReadRequest(n) => {
                // A damaged chunk length asks for more than there is: what is taken is bounded instead.
                let n = file
                    .read(reader.insert(n.min(RECORD_LIMIT)))
                    .map_err(|e| format!("cannot read {}: {e}", path.display()))?;
                reader.notify_read(n);
            }
            LinearReadEvent::Record { opcode, data } => {
                if each(mcap::parse_record(opcode, data).map_err(damaged)?)? == Go::Stop {
                    return Ok(Go::Stop);
                }
            }
        }
    }
    Ok(Go::On)
}

struct Player<'a> {
    topics: &'a BTreeSet<String>,
    /// Skin whose frames are sent: the named one, else that of the first frame.
    skin: Option<String>,
    /// Whether it was named.
    chosen: bool,
    /// Topic that its first frame came on.
    from: Option<String>,
    /// Skins whose frames are left out.
    others: BTreeSet<String>,
    /// Channels of its frames: a device does not change them.
    layout: Option<u32>,
    queue: &'a Queue,
    stop: &'a Stop,
    output: Output,
    sent: u64,
}

impl Player<'_> {
    fn play(&mut self, path: &Path) -> Result<Go, String> {
        let mut wanted = BTreeMap::new();
        let mut schemas = HashMap::new();
        read_records(path, |record| {
            match record {
                Record::Schema { header, data } if header.name == TaxelFrame::TYPE_NAME => {
                    schemas.insert(header.id, String::from_utf8_lossy(&data).into_owned());
                }
                Record::Channel(channel) => {
                    let definition = schemas.get(&channel.schema_id);
                    if let Some(definition) = definition.filter(|_| self.topics.contains(&channel.topic)) {
                        // A recording may be older than the definition of today.
                        let upgrade = match channel.metadata.get("topic_type_hash") {
                            Some(hash) => Upgrade::of_hash(TaxelFrame::TYPE_NAME, hash),
                            None => Upgrade::of_definition(TaxelFrame::TYPE_NAME, definition),
                        };
                        wanted.insert(channel.id, (channel.topic, upgrade));
                    }
                }
                Record::Message { header, data } => {
                    let Some((topic, upgrade)) = wanted.get(&header.channel_id) else { return Ok(Go::On) };
                    let frame = match upgrade {
                        Some(upgrade) => {
                            upgrade.apply(&data, &|_| None).and_then(|data| TaxelFrame::from_cdr(&data))
                        }
                        None => TaxelFrame::from_cdr(&data),
                    };
                    let frame = frame.map_err(|e| {
                        format!("message {} on {topic} of {} is {e}", self.sent, path.display())
                    })?;
                    if self.is_meant(&frame.skin, topic, path)? {
                        let log_time = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                        return self.send(&frame, log_time, topic, path);
                    }
                }
                _ => {}
            }
            Ok(Go::On)
        })
    }

    /// Whether a frame is of the skin that is sent. Refuses what would be mixed with it.
    fn is_meant(&mut self, skin: &str, topic: &str, path: &Path) -> Result<bool, String> {
        let named = self.skin.get_or_insert_with(|| skin.to_owned());
        if named == skin {
            let from = self.from.get_or_insert_with(|| topic.to_owned());
            if from == topic {
                return Ok(true);
            }
            return Err(format!(
                "{} holds frames of skin `{skin}` on {from} and on {topic}, choose one with topic=…",
                path.display()
            ));
        }
        if !self.chosen {
            return Err(format!(
                "topic {topic} of {} carries frames of `{named}` and of `{skin}`, choose one with skin=…",
                path.display()
            ));
        }
        if !self.others.contains(skin) {
            self.others.insert(skin.to_owned());
        }
        Ok(false)
    }

    fn send(&mut self, frame: &TaxelFrame, log_time: i64, topic: &str, path: &Path) -> Result<Go, String> {
        let layout = *self.layout.get_or_insert(frame.layout_id);
        if layout != frame.layout_id {
            return Err(format!(
                "frame {} on {topic} of {} has the channel layout {:08x} where those before have {layout:08x}: the skin was \
                 changed in the middle",
                frame.sequence,
                path.display(),
                frame.layout_id
            ));
        }
        let (wait, bytes) = self
            .output
            .frame(frame, log_time)
            .map_err(|e| format!("message {} on {topic} of {}: {e}", self.sent, path.display()))?;
        if self.stop.stopped_within(wait) || !self.queue.push_waiting(bytes, crate::now_ns) {
            return Ok(Go::Stop);
        }
        self.sent += 1;
        Ok(Go::On)
    }
}

/// Turns recorded frames into what a device would have sent, one pass after the other.
struct Output {
    encoder: NativeEncoder,
    speed: f64,
    pass: Option<Pass>,
    /// Sequence number and device time \[µs\] sent last.
    last: Option<(u32, u64)>,
    /// \[µs\] device time between the last two frames.
    period_us: u64,
}

struct Pass {
    began: Instant,
    first_log: i64,
    first_time_us: u64,
    /// \[µs\] device time at which this pass begins.
    base_us: u64,
    last_sequence: u64,
}

impl Output {
    fn new(speed: f64) -> Self {
        Self { encoder: NativeEncoder::new(NativeFormat::F32), speed, pass: None, last: None, period_us: 0 }
    }

    fn start_again(&mut self) {
        self.pass = None;
    }

    /// How long it is until the frame is due, and its bytes.
    fn frame(&mut self, frame: &TaxelFrame, log_time: i64) -> Result<(Duration, Bytes), TransportError> {
        let stamp_us = u64::try_from(frame.header.stamp.as_nanos() / 1000).unwrap_or(0);
        let time_us = if frame.device_time_us != 0 { frame.device_time_us } else { stamp_us };
        let last = self.last;
        let pause = Duration::from_micros(if last.is_some() { self.period_us } else { 0 }).min(MAX_WAIT);
        let pass = self.pass.get_or_insert_with(|| Pass {
            began: Instant::now() + pause,
            first_log: log_time,
            first_time_us: time_us,
            base_us: last.map_or(time_us, |(_, us)| us + self.period_us.max(1)),
            last_sequence: frame.sequence.wrapping_sub(1),
        });
        // Gaps of the recording stay gaps; a recording without numbers gets some.
        let step = match frame.sequence.wrapping_sub(pass.last_sequence) {
            step @ 1..=0x7fff_ffff => step as u32,
            _ => 1,
        };
        pass.last_sequence = frame.sequence;
        let sequence = last.map_or(frame.sequence as u32, |(n, _)| n.wrapping_add(step));
        // The clock of the device runs with the pace, as that of a real one does with the host's.
        let scale = if self.speed > 0.0 { self.speed } else { 1.0 };
        let scaled = |span: f64| (span / scale).max(0.0);
        let time_us = match time_us {
            0 => 0,
            us => pass.base_us.saturating_add(scaled(us.saturating_sub(pass.first_time_us) as f64) as u64),
        };
        let wait = if self.speed > 0.0 {
            let span_s = scaled(log_time.saturating_sub(pass.first_log) as f64) / 1e9;
            let span = Duration::try_from_secs_f64(span_s).unwrap_or(MAX_WAIT);
            span.saturating_sub(pass.began.elapsed()).min(MAX_WAIT)
        } else {
            Duration::ZERO
        };
        if let Some((_, then)) = last
            && time_us > then
        {
            self.period_us = time_us - then;
        }
        self.last = Some((sequence, time_us));
        let bytes = self.encoder.encode(sequence, time_us, &frame.values)?;
        Ok((wait, Bytes::copy_from_slice(bytes)))
    }
}
