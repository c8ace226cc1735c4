//! What processes print, gathered: one line after the other, with the process and the time.

use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::error::LaunchError;
use crate::file::loose;
use crate::rate::Bucket;
use crate::rotate::LogFile;

/// Lines of one process that may wait to be written. What comes while so many wait is left out and counted: a process
/// is never stopped by its log, and none takes the memory or the turn of another.
const WAITING: usize = 256;
/// Shortest time between two sentences on how many lines of a process were left out, while it goes on printing.
pub(crate) const CONFESS: Duration = Duration::from_secs(5);
/// Longest wait for the last lines to be written.
const LAST_LINES: Duration = Duration::from_secs(2);

/// How gathered lines are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// For people.
    #[default]
    Human,
    /// One JSON object a line: `time`, `process`, `level` (where it is known), `message`, and `target` and `fields` of
    /// our own programs.
    Json,
}

/// Where gathered lines go.
#[derive(Debug, Clone, Default)]
pub struct LogOptions {
    /// How they are written.
    pub format: Format,
    /// Whether standard output shows colours.
    pub colours: bool,
    /// Folder of one more file for each process, in the same format.
    pub folder: Option<PathBuf>,
    /// How much is written.
    pub limits: LogLimits,
}

/// How much processes may log.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogLimits {
    /// \[lines/s\] of a process that are written, on average over 10 s; the others are counted. 0 is without limit.
    #[serde(deserialize_with = "loose")]
    pub rate: f64,
    /// \[MB\] that a log file may have before a new one is begun; 0 is without limit.
    #[serde(deserialize_with = "loose")]
    pub size: f64,
    /// Older files of a process that are kept.
    #[serde(deserialize_with = "loose")]
    pub keep: u32,
}

impl Default for LogLimits {
    /// 100 lines a second; at most 50 MB for each process.
    fn default() -> Self {
        Self { rate: 100.0, size: 10.0, keep: 4 }
    }
}

impl LogLimits {
    /// The field that cannot be used, and why.
    ///
    /// # Errors
    ///
    /// The name of the field, and a sentence.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !(0.0..=1e6).contains(&self.rate) {
            return Err((
                "rate",
                format!("{} is no rate; give lines a second from 0 (no limit) to 1000000", self.rate),
            ));
        }
        // Less than a kilobyte would be a new file with every few lines.
        if self.size != 0.0 && !(1e-3..=1e6).contains(&self.size) {
            return Err((
                "size",
                format!("{} is no size; give megabytes from 0.001 to 1000000, or 0 (no limit)", self.size),
            ));
        }
        if self.keep > 1000 {
            return Err(("keep", format!("{} is too many; keep at most 1000 older files", self.keep)));
        }
        Ok(())
    }

    /// \[byte\], 0 without limit.
    fn bytes(&self) -> u64 {
        (self.size * 1e6) as u64
    }
}

/// How important a line is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Level {
    Trace,
    Debug,
    Info,
    Warn,
    Error,
}

impl Level {
    fn word(self) -> &'static str {
        match self {
            Self::Trace => "TRACE",
            Self::Debug => "DEBUG",
            Self::Info => "INFO",
            Self::Warn => "WARN",
            Self::Error => "ERROR",
        }
    }

    fn colour(self) -> &'static str {
        match self {
            Self::Trace | Self::Debug => "\x1b[2m",
            Self::Info => "\x1b[32m",
            Self::Warn => "\x1b[33m",
            Self::Error => "\x1b[31m",
        }
    }

    /// The words of `tracing`, of ROS 2 and of Python.
    fn parse(word: &str) -> Option<Self> {
        match word {
            "TRACE" => Some(Self::Trace),
            "DEBUG" => Some(Self::Debug),
            "INFO" => Some(Self::Info),
            "WARN" | "WARNING" => Some(Self::Warn),
            "ERROR" | "FATAL" | "CRITICAL" => Some(Self::Error),
            _ => None,
        }
    }
}

/// One line.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Record {
    /// RFC 3339.
    time: String,
    level: Option<Level>,
    pub message: String,
    target: Option<String>,
    fields: Map<String, Value>,
}

fn now() -> String {
    humantime::format_rfc3339_millis(SystemTime::now()).to_string()
}

impl Record {
    fn plain(level: Option<Level>, message: String) -> Self {
        Self { time: now(), level, message, target: None, fields: Map::new() }
    }

    /// A line that a process printed: JSON of `tracing`, or any text.
    pub(crate) fn parse(line: &[u8]) -> Self {
        if line.first() == Some(&b'{')
            && let Ok(Value::Object(mut object)) = serde_json::from_slice(line)
            && let Some(level) = object.get("level").and_then(Value::as_str).and_then(Level::parse)
            && let Some(Value::Object(mut fields)) = object.remove("fields")
        {
            let mut text = |key: &str| match object.remove(key) {
                Some(Value::String(text)) => Some(text),
                _ => None,
            };
            let (time, target) = (text("timestamp").unwrap_or_else(now), text("target"));
            let message = match fields.remove("message") {
                Some(Value::String(text)) => text,
                Some(other) => other.to_string(),
                None => String::new(),
            };
            return Self { time, level: Some(level), message, target, fields };
        }
        let text = String::from_utf8_lossy(line).into_owned();
        // `[INFO] [1700000000.0] [node]: …` of ROS 2, `2026-11-21T12:00:00Z  INFO …` of tracing, `WARNING:root:…`.
        let level = text
            .split_whitespace()
            .take(3)
            .find_map(|word| Level::parse(word.trim_start_matches('[').split([']', ':']).next()?));
        Self::plain(level, text)
    }

    fn json(&self, process: &str) -> String {
        let mut object = json!({ "time": self.time, "process": process, "message": self.message });
        if let Some(level) = self.level {
            object["level"] = level.word().into();
        }
        if let Some(target) = &self.target {
            object["target"] = target.as_str().into();
        }
        if !self.fields.is_empty() {
            object["fields"] = Value::Object(self.fields.clone());
        }
        object.to_string()
    }

    fn human(&self, process: Option<(&str, usize, usize)>, colours: bool) -> String {
        let paint = |colour: &str, text: &str| {
            if colours { format!("{colour}{text}\x1b[0m") } else { text.to_owned() }
        };
        // The day is known to who reads along.
        let mut out = self.time.get(11..23).unwrap_or(&self.time).to_owned();
        if let Some((name, width, index)) = process {
            const COLOURS: [&str; 6] =
                ["\x1b[36m", "\x1b[35m", "\x1b[34m", "\x1b[96m", "\x1b[95m", "\x1b[94m"];
            out += &format!(" {}", paint(COLOURS[index % COLOURS.len()], &format!("{name:width$}")));
        }
        let level = self.level.map_or("", Level::word);
        out += &format!(" {} ", paint(self.level.map_or("", Level::colour), &format!("{level:5}")));
        out += &self.message;
        for (key, value) in &self.fields {
            let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            out += &format!(" {}", paint("\x1b[2m", &format!("{key}={value}")));
        }
        out
    }
}

/// The end of one process that takes its lines.
#[derive(Debug, Clone)]
pub(crate) struct Tap {
    process: usize,
    lines: Sender<(usize, Record, Arc<AtomicUsize>)>,
    waiting: Arc<AtomicUsize>,
    meter: Arc<Mutex<Meter>>,
}

/// What a process may print, and what was left out since that was last said.
#[derive(Debug)]
struct Meter {
    bucket: Bucket,
    rate: f64,
    too_many: u64,
    without_room: u64,
    confessed: Option<Instant>,
}

impl Tap {
    /// Whether a line is to be taken: one of too many, or without room, is counted.
    pub(crate) fn has_room(&self) -> bool {
        let room = self.waiting.load(Ordering::Acquire) < WAITING;
        let mut meter = self.meter.lock().unwrap_or_else(PoisonError::into_inner);
        let allowed = meter.bucket.take(Instant::now());
        if !allowed {
            meter.too_many += 1;
        } else if !room {
            meter.without_room += 1;
        }
        allowed && room
    }

    /// Takes a line that there is room for.
    pub(crate) fn take(&self, record: Record) {
        self.confess(false);
        self.send(record);
    }

    /// A line of our own, which is never left out.
    pub(crate) fn say(&self, level: Level, text: impl Into<String>) {
        self.send(Record::plain(Some(level), text.into()));
    }

    /// Says how many lines were left out since it was last said; seldom, unless that is all that there is `to_say`.
    pub(crate) fn confess(&self, to_say: bool) {
        let mut meter = self.meter.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        if !to_say && meter.confessed.is_some_and(|at| now.duration_since(at) < CONFESS) {
            return;
        }
        let (too_many, without_room) =
            (std::mem::take(&mut meter.too_many), std::mem::take(&mut meter.without_room));
        if too_many + without_room == 0 {
            return;
        }
        meter.confessed = Some(now);
        let rate = meter.rate;
        drop(meter);
        if too_many > 0 {
            let text =
                format!("{too_many} lines left out here: more than {rate} a second (`log_limits.rate`)");
            self.say(Level::Warn, text);
        }
        if without_room > 0 {
            let text =
                format!("{without_room} lines left out here: they came faster than they could be written");
            self.say(Level::Warn, text);
        }
    }

    fn send(&self, record: Record) {
        self.waiting.fetch_add(1, Ordering::AcqRel);
        // The writer is gone only when the launch is over.
        let _ = self.lines.send((self.process, record, Arc::clone(&self.waiting)));
    }
}

/// Writes what the taps take, on a thread of its own.
#[derive(Debug)]
pub(crate) struct Writer {
    thread: JoinHandle<()>,
    taps: Vec<Tap>,
}

impl Writer {
    /// A writer for processes of these names.
    pub(crate) fn start(options: &LogOptions, names: Vec<String>) -> Result<Self, LaunchError> {
        let mut files = Vec::new();
        if let Some(folder) = &options.folder {
            std::fs::create_dir_all(folder).map_err(|e| {
                LaunchError::system(format!("the log folder {} cannot be made", folder.display()), e)
            })?;
            for name in &names {
                let path = folder.join(format!("{}.log", name.replace('/', ".")));
                let failed = format!("the log file {} cannot be opened", path.display());
                let (size, keep) = (options.limits.bytes(), options.limits.keep);
                files.push(LogFile::open(path, size, keep).map_err(|e| LaunchError::system(failed, e))?);
            }
        }
        let (sender, receiver) = channel();
        let taps = (0..names.len())
            .map(|process| Tap {
                process,
                lines: sender.clone(),
                waiting: Arc::default(),
                meter: Arc::new(Mutex::new(Meter {
                    bucket: Bucket::new(options.limits.rate),
                    rate: options.limits.rate,
                    too_many: 0,
                    without_room: 0,
                    confessed: None,
                })),
            })
            .collect();
        let sink = Sink {
            width: names.iter().map(String::len).max().unwrap_or(0),
            names,
            format: options.format,
            colours: options.colours,
            out: Some(BufWriter::new(io::stdout())),
            files: files.into_iter().map(Some).collect(),
        };
        let thread = std::thread::Builder::new()
            .name("launch-log".to_owned())
            .spawn(move || sink.work(&receiver))
            .map_err(|e| LaunchError::system("the thread that writes logs cannot be started", e))?;
        Ok(Self { thread, taps })
    }

    pub(crate) fn tap(&self, process: usize) -> Tap {
        self.taps[process].clone()
    }

    /// Waits until everything is written; not for ever, because standard output may be a pipe that nobody reads.
    pub(crate) fn finish(self) {
        drop(self.taps);
        let deadline = Instant::now() + LAST_LINES;
        while !self.thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

struct Sink {
    names: Vec<String>,
    width: usize,
    format: Format,
    colours: bool,
    /// None once nobody reads it.
    out: Option<BufWriter<io::Stdout>>,
    /// None once it cannot be written.
    files: Vec<Option<LogFile>>,
}

impl Sink {
    fn work(mut self, lines: &Receiver<(usize, Record, Arc<AtomicUsize>)>) {
        loop {
            let next = match lines.try_recv() {
                Ok(next) => next,
                Err(TryRecvError::Disconnected) => break,
                Err(TryRecvError::Empty) => {
                    self.flush();
                    match lines.recv() {
                        Ok(next) => next,
                        Err(_) => break,
                    }
                }
            };
            let (process, record, waiting) = next;
            self.write(process, &record);
            waiting.fetch_sub(1, Ordering::AcqRel);
        }
        self.flush();
    }

    fn write(&mut self, process: usize, record: &Record) {
        let name = &self.names[process];
        let line = match self.format {
            Format::Json => record.json(name),
            Format::Human => record.human(Some((name, self.width, process)), self.colours),
        };
        if self.out.as_mut().is_some_and(|out| writeln!(out, "{line}").is_err()) {
            self.out = None;
        }
        if let Some(Some(file)) = self.files.get_mut(process) {
            let line = match self.format {
                Format::Json => line,
                Format::Human => record.human(None, false),
            };
            if let Err(error) = file.line(&line) {
                self.lose(process, &error);
            }
        }
    }

    fn flush(&mut self) {
        if self.out.as_mut().is_some_and(|out| out.flush().is_err()) {
            self.out = None;
        }
        for process in 0..self.files.len() {
            if let Some(file) = &mut self.files[process]
                && let Err(error) = file.flush()
            {
                self.lose(process, &error);
            }
        }
    }

    /// Goes on without a file that cannot be written, and says so once.
    fn lose(&mut self, process: usize, error: &io::Error) {
        if let Some(file) = self.files[process].take() {
            // What its buffer holds cannot be written either.
            let path = file.give_up();
            let text = format!("log file {}: {error}; it gets no further lines", path.display());
            self.write(process, &Record::plain(Some(Level::Error), text));
        }
    }
}

#[cfg(test)]
mod tests;
