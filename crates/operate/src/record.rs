//! Records what nodes publish into a bag.
//!
//! Topics are taken up as they appear in the ROS graph. A queue that is bounded in bytes lies between the subscriptions and the
//! thread that writes; what does not fit is dropped and counted, and so is what is lost on the way, where publishers number
//! their messages. A full disk is waited for.

mod selection;
mod session;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::time::{Duration, Instant, SystemTime};

use clap::{Args, ValueEnum};
use dermis_bag::{
    BagError, BagInfo, Compression, Recorded, Recorder, RecorderOptions, RecorderState, TopicState,
};
use dermis_node::{Backend, Node, NodeOptions};
use dermis_perception::cli::NetworkArguments;
use regex::Regex;
use serde::{Deserialize, Serialize};

use self::selection::Selection;
use self::session::{Ended, Session};
use crate::quantity::{duration, size};
use crate::{OperateError, Progress, written};

/// How often the graph is checked for new topics, and the end for its reasons.
const LOOK_AROUND: Duration = Duration::from_millis(100);
/// How often a recording that finds no room for its folder tries again.
const AGAIN: Duration = Duration::from_secs(1);

/// Memory for messages that wait for the disk, where nothing is said.
const BUFFER: &str = "512MiB";

/// What to record, and how.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Topics to record, relative to the namespace; every topic where neither these nor --regex nor --type are given.
    pub topics: Vec<String>,
    /// Every topic but hidden ones.
    #[arg(short, long)]
    pub all: bool,
    /// Topics that this regular expression finds; may be repeated.
    #[arg(short = 'e', long)]
    #[serde(with = "written::patterns")]
    pub regex: Vec<Regex>,
    /// Topics of this type, e.g. dermis_msgs/msg/TaxelFrame; may be repeated.
    #[arg(long = "type", value_name = "TYPE")]
    pub types: Vec<String>,
    /// Not the topics that this regular expression finds; may be repeated.
    #[arg(short = 'x', long, value_name = "REGEX")]
    #[serde(with = "written::patterns")]
    pub exclude: Vec<Regex>,
    /// Hidden topics too: those with a part that begins with `_`.
    #[arg(long)]
    pub include_hidden: bool,
    /// Folder of the bag; must not exist yet, but with --resume.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Where the folder exists, go on in DIR-2, DIR-3 and so on: for recorders that are started again after a crash.
    #[arg(long)]
    pub resume: bool,
    /// Begin a new file after this many bytes, e.g. 1GiB.
    #[arg(long, value_parser = size, value_name = "SIZE")]
    #[serde(with = "written::optional_size")]
    pub split_size: Option<u64>,
    /// Begin a new file after this time, e.g. 10min.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    #[serde(with = "written::duration")]
    pub split_time: Option<Duration>,
    /// Compression of the chunks.
    #[arg(long, value_enum, default_value_t)]
    pub compression: Level,
    /// Exit with 3 where the bag is complete, but messages are missing in it, or it is not known whether some are.
    #[arg(long)]
    pub complete: bool,
    /// Memory for messages that wait for the disk; what comes while it is full is dropped and counted.
    #[arg(long, value_parser = size, default_value = BUFFER, value_name = "SIZE")]
    #[serde(with = "written::size")]
    pub buffer: u64,
    /// End after this long, e.g. 60s; at Ctrl-C where absent.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    #[serde(with = "written::duration")]
    pub duration: Option<Duration>,
    /// Namespace of the recorder, and of topics that are given without a leading `/`.
    #[arg(long, default_value_t = Request::default().namespace)]
    pub namespace: String,
    /// How far the network reaches.
    #[command(flatten)]
    pub network: NetworkArguments,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            topics: Vec::new(),
            all: false,
            regex: Vec::new(),
            types: Vec::new(),
            exclude: Vec::new(),
            include_hidden: false,
            out: PathBuf::new(),
            resume: false,
            split_size: None,
            split_time: None,
            compression: Level::default(),
            complete: false,
            buffer: size(BUFFER).unwrap_or(u64::MAX),
            duration: None,
            namespace: "/".into(),
            network: NetworkArguments::default(),
        }
    }
}

/// How hard to compress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Not at all.
    None,
    /// zstd level 1.
    #[default]
    Fast,
    /// zstd level 3.
    Default,
    /// zstd level 15; far slower than a sensor.
    Small,
}

impl From<Level> for Compression {
    fn from(level: Level) -> Self {
        match level {
            Level::None => Self::None,
            Level::Fast => Self::Fast,
            Level::Default => Self::Default,
            Level::Small => Self::Small,
        }
    }
}

/// Who watches a recording.
pub trait Watcher: Progress {
    /// Recording begins, into this folder.
    fn begin(&self, folder: &Path);

    /// Where the recording is, after this time; reported several times a second.
    fn at(&self, state: &RecorderState, elapsed: Duration);

    /// No more messages are waited for: the bag is completed.
    fn end(&self);
}

/// What was recorded.
#[derive(Debug, Clone, Serialize)]
pub struct Recording {
    /// The bag.
    pub bag: PathBuf,
    /// \[s\] that it took.
    pub seconds: f64,
    /// Messages that were written.
    pub messages: u64,
    /// Messages that arrived and were not written.
    pub dropped: u64,
    /// Messages that were lost on the way; `None` where it is not known of any topic.
    pub lost: Option<u64>,
    /// Bytes of the messages.
    pub payload_bytes: u64,
    /// Bytes of the files.
    pub stored_bytes: u64,
    /// Files that it has.
    pub files: usize,
    /// \[s\] that room was waited for.
    pub waited_for_room_s: f64,
    /// The bag of the part before this one.
    pub goes_on_from: Option<PathBuf>,
    /// Topics that were requested by name and on which nothing came, each with why.
    pub silent: BTreeMap<String, String>,
    /// What was recorded and lost, by topic.
    pub topics: Vec<TopicState>,
    /// The bag as its metadata describe it.
    #[serde(skip)]
    pub info: BagInfo,
}

/// How a recording ended.
#[derive(Debug)]
pub struct Findings {
    /// What was recorded, or why the bag could not be completed.
    pub recording: Result<Recording, BagError>,
    /// What was recorded and lost, also where the bag could not be completed.
    pub state: RecorderState,
    silent: Vec<(String, String)>,
}

impl Findings {
    fn new(ended: Ended, part: Part, seconds: f64) -> Self {
        let Ended { recorded, state, silent } = ended;
        let recording = recorded.map(|Recorded { bag: info, .. }| Recording {
            bag: info.path.clone(),
            seconds,
            messages: state.messages,
            dropped: state.dropped,
            lost: state.lost,
            payload_bytes: state.payload_bytes,
            stored_bytes: info.bytes,
            files: info.files,
            waited_for_room_s: state.paused_ms as f64 * 1e-3,
            goes_on_from: part.before,
            silent: silent.iter().cloned().collect(),
            topics: state.topics.clone(),
            info,
        });
        Self { recording, state, silent }
    }

    /// Refuses a recording that lacks something.
    ///
    /// # Errors
    ///
    /// Where the bag could not be completed, or a topic that was requested by name brought nothing; with `complete` also
    /// [`OperateError::Incomplete`], where messages are missing or it is not known whether some are.
    pub fn require(self, complete: bool) -> Result<(), OperateError> {
        self.recording?;
        if !self.silent.is_empty() {
            let why: Vec<_> = self.silent.iter().map(|(topic, why)| format!("{topic} ({why})")).collect();
            return Err(OperateError::Silent(why.join(", ")));
        }
        let losses = self.state.losses();
        if complete && !losses.is_complete() {
            return Err(OperateError::Incomplete(losses.to_string()));
        }
        Ok(())
    }
}

/// Records until `end`, or as long as requested. A full disk is waited for.
///
/// # Errors
///
/// Where recording cannot begin. How it ended is said by [`Findings::require`].
pub async fn record(
    request: &Request,
    backend: &dyn Backend,
    end: impl Future<Output = ()>,
    watcher: &dyn Watcher,
) -> Result<Findings, OperateError> {
    ignore_file_size_signal(watcher);
    let defaults = RecorderOptions::default();
    let layout = defaults
        .bag
        .compression(request.compression.into())
        .split_bytes(request.split_size)
        .split_ns(request.split_time.and_then(|time| i64::try_from(time.as_nanos()).ok()));
    let queue_bytes = usize::try_from(request.buffer).unwrap_or(usize::MAX);
    let recorder_options = defaults.bag(layout).queue_bytes(queue_bytes).wait_for_room(true);
    let mut end = std::pin::pin!(end);
    let node_options = NodeOptions::new(node_name())
        .namespace(&request.namespace)
        .network(request.network.choice())
        .threads(1);
    let node = Node::open(node_options, backend)?;
    watcher.note(&node.open_to());
    let selection = Selection::new(request, &node)?;
    let (recorder, part) = start(request, recorder_options, end.as_mut(), watcher).await?;

    watcher.begin(&part.dir);
    let mut session = Session::new(node, recorder, selection);
    let began = Instant::now();
    let mut ticks = tokio::time::interval(LOOK_AROUND);
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = &mut end => break,
        }
        session.look_around(watcher);
        watcher.at(&session.state(), began.elapsed());
        if session.failed() || request.duration.is_some_and(|time| began.elapsed() >= time) {
            break;
        }
    }
    watcher.end();
    let seconds = began.elapsed().as_secs_f64();
    let ended = session.finish(part.custom(seconds));
    Ok(Findings::new(ended, part, seconds))
}

/// Where this recording goes, and what it goes on from.
struct Part {
    dir: PathBuf,
    before: Option<PathBuf>,
    /// Seconds since the part before was last written to.
    gap_s: Option<f64>,
}

impl Part {
    /// With --resume, the first name that is free.
    fn choose(request: &Request, watcher: &dyn Watcher) -> Result<Self, OperateError> {
        if !request.resume {
            return Ok(Self { dir: request.out.clone(), before: None, gap_s: None });
        }
        let (dir, before) = dermis_bag::next_free(&request.out)?;
        let gap_s = before
            .as_deref()
            .and_then(last_written)
            .and_then(|last| SystemTime::now().duration_since(last).ok().map(|since| since.as_secs_f64()));
        if let Some(before) = &before {
            watcher.note(&format!(
                "{} holds an earlier part: recording goes on in {}",
                before.display(),
                dir.display()
            ));
            if !before.join("metadata.yaml").exists() {
                watcher.note(&format!(
                    "{0} was interrupted: `dermis bag check --repair {0}` completes it",
                    before.display()
                ));
            }
        }
        Ok(Self { dir, before, gap_s })
    }

    /// What the bag says of it.
    fn custom(&self, seconds: f64) -> Vec<(String, String)> {
        let mut custom = vec![
            ("recorder".to_owned(), concat!("dermis ", env!("CARGO_PKG_VERSION")).to_owned()),
            ("recorded_s".to_owned(), format!("{seconds:.3}")),
        ];
        if let Some(name) = self.before.as_deref().and_then(Path::file_name) {
            custom.push(("goes on from".to_owned(), name.to_string_lossy().into_owned()));
        }
        if let Some(gap) = self.gap_s {
            custom.push(("not recorded before (s)".to_owned(), format!("{gap:.1}")));
        }
        custom
    }
}

/// When a file of a bag was written to last.
fn last_written(dir: &Path) -> Option<SystemTime> {
    let entries = std::fs::read_dir(dir).ok()?;
    entries.filter_map(|entry| entry.ok()?.metadata().ok()?.modified().ok()).max()
}

/// Starts the recorder, once there is room for its folder.
async fn start(
    request: &Request,
    recorder_options: RecorderOptions,
    mut end: Pin<&mut impl Future<Output = ()>>,
    watcher: &dyn Watcher,
) -> Result<(Recorder, Part), OperateError> {
    let part = Part::choose(request, watcher)?;
    let mut said = false;
    loop {
        match Recorder::start(&part.dir, recorder_options) {
            Ok(recorder) => return Ok((recorder, part)),
            Err(error) if error.is_no_room() => {
                if !said {
                    watcher.note(&format!("nothing is recorded yet: {error}"));
                    said = true;
                }
            }
            Err(error) => return Err(error.into()),
        }
        tokio::select! {
            () = tokio::time::sleep(AGAIN) => {}
            () = &mut end => return Err(OperateError::NoRoom(part.dir)),
        }
    }
}

/// A file that reaches a limit (`ulimit -f`) is to be an error like a full disk, not an end by a signal.
fn ignore_file_size_signal(watcher: &dyn Watcher) {
    use nix::sys::signal::{SigHandler, Signal, signal};
    // SAFETY: no handler is installed, so that none can be unsafe to run in a signal.
    let done = unsafe { signal(Signal::SIGXFSZ, SigHandler::SigIgn) };
    if let Err(error) = done {
        watcher.note(&format!("a file size limit will end the recording by a signal: {error}"));
    }
}

/// Recorders run side by side, so that each has a name of its own.
fn node_name() -> String {
    format!("dermis_record_{}", std::process::id())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn findings(lost: Option<u64>, silent: &[(&str, &str)]) -> Findings {
        let topic = TopicState {
            name: "/a".to_owned(),
            type_name: String::new(),
            recorded: 90,
            dropped: 0,
            lost,
            missing_frames: None,
        };
        let info = BagInfo {
            path: "bag".into(),
            files: 1,
            bytes: 10,
            span: None,
            messages: 90,
            topics: Vec::new(),
            custom: BTreeMap::new(),
            complete: true,
        };
        let state = RecorderState { messages: 90, topics: vec![topic], ..RecorderState::default() };
        let silent = silent.iter().map(|(topic, why)| ((*topic).to_owned(), (*why).to_owned())).collect();
        let recorded = Ok(Recorded { bag: info, state: state.clone() });
        let part = Part { dir: "bag".into(), before: None, gap_s: None };
        Findings::new(Ended { recorded, state, silent }, part, 2.0)
    }

    #[test]
    fn a_recording_that_lacks_something_is_refused_with_a_sentence() {
        let said = |found: Findings, complete| found.require(complete).err().map(|error| error.to_string());
        assert_eq!(said(findings(Some(0), &[]), true), None);
        assert_eq!(said(findings(Some(3), &[]), false), None);
        let lossy = said(findings(Some(3), &[]), true).unwrap();
        assert!(lossy.starts_with("the recording is not complete: ") && lossy.contains('3'), "{lossy}");
        assert!(said(findings(None, &[]), true).is_some(), "whether something is missing is not known");
        assert_eq!(
            said(findings(Some(0), &[("/b", "nobody published it")]), false).unwrap(),
            "nothing was recorded of what was requested by name: /b (nobody published it)"
        );
    }

    #[test]
    fn the_record_has_the_keys_that_scripts_read() {
        let found = findings(Some(0), &[]);
        let record = serde_json::to_value(found.recording.unwrap()).unwrap();
        let keys: Vec<&String> = record.as_object().unwrap().keys().collect();
        assert_eq!(
            keys,
            [
                "bag",
                "dropped",
                "files",
                "goes_on_from",
                "lost",
                "messages",
                "payload_bytes",
                "seconds",
                "silent",
                "stored_bytes",
                "topics",
                "waited_for_room_s"
            ]
        );
    }
}
