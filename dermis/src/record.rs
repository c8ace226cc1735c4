//! `dermis record`: what nodes publish, into a bag.

mod progress;
mod selection;
mod session;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use dermis_bag::{Compression, Recorder, RecorderOptions, RecorderState};
use dermis_node::{Node, NodeOptions};
use dermis_perception::cli::NetworkArguments;
use regex::Regex;
use serde_json::json;

use self::progress::Progress;
use self::selection::Selection;
use self::session::{Ended, Session};
use crate::backend::Choice;
use crate::quantity::{duration, size};

/// How often the graph is looked at for new topics, and the end for its reasons.
const LOOK_AROUND: Duration = Duration::from_millis(100);
/// How often a recording that finds no room for its folder tries again.
const AGAIN: Duration = Duration::from_secs(1);

/// What to record, and how.
#[derive(Args)]
pub struct Options {
    /// Topics to record, relative to the namespace; every topic where neither these nor --regex nor --type are given.
    topics: Vec<String>,
    /// Every topic but hidden ones.
    #[arg(short, long)]
    all: bool,
    /// Topics that this regular expression finds; may be repeated.
    #[arg(short = 'e', long)]
    regex: Vec<Regex>,
    /// Topics of this type, e.g. dermis_msgs/msg/TaxelFrame; may be repeated.
    #[arg(long = "type", value_name = "TYPE")]
    types: Vec<String>,
    /// Not the topics that this regular expression finds; may be repeated.
    #[arg(short = 'x', long, value_name = "REGEX")]
    exclude: Vec<Regex>,
    /// Hidden topics too: those with a part that begins with `_`.
    #[arg(long)]
    include_hidden: bool,
    /// Folder of the bag; must not exist yet, but with --resume.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Where the folder exists, go on in DIR-2, DIR-3 and so on: for recorders that are started again after a crash.
    #[arg(long)]
    resume: bool,
    /// Begin a new file after this many bytes, e.g. 1GiB.
    #[arg(long, value_parser = size, value_name = "SIZE")]
    split_size: Option<u64>,
    /// Begin a new file after this time, e.g. 10min.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    split_time: Option<Duration>,
    /// Compression of the chunks.
    #[arg(long, value_enum, default_value_t)]
    compression: Level,
    /// Exit with 3 where the bag is complete, but messages are missing in it, or it is not known whether some are.
    #[arg(long)]
    complete: bool,
    /// Memory for messages that wait for the disk; what comes while it is full is dropped and counted.
    #[arg(long, value_parser = size, default_value = "512MiB", value_name = "SIZE")]
    buffer: u64,
    /// End after this long, e.g. 60s; at Ctrl-C where absent.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    duration: Option<Duration>,
    /// Namespace of the recorder, and of topics that are given without a leading `/`.
    #[arg(long, default_value = "/")]
    namespace: String,
    #[command(flatten)]
    network: NetworkArguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

/// How hard to compress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
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

/// A bag that is complete and sound, of a recording that lacks something; asked for by --complete.
#[derive(Debug, thiserror::Error)]
#[error("the recording is not complete: {0}")]
pub struct Incomplete(pub String);

/// Runs until Ctrl-C, SIGTERM or the end of its time. A full disk is waited for.
pub async fn run(options: Options) -> Result<()> {
    ignore_file_size_signal();
    let defaults = RecorderOptions::default();
    let layout = defaults
        .bag
        .compression(options.compression.into())
        .split_bytes(options.split_size)
        .split_ns(options.split_time.and_then(|time| i64::try_from(time.as_nanos()).ok()));
    let queue_bytes = usize::try_from(options.buffer).unwrap_or(usize::MAX);
    let recorder_options = defaults.bag(layout).queue_bytes(queue_bytes).wait_for_room(true);
    let mut end = std::pin::pin!(end_asked()?);
    let node_options = NodeOptions::new(node_name())
        .namespace(&options.namespace)
        .network(options.network.choice())
        .threads(1);
    let node = Node::open(node_options, options.backend.open()?.as_ref())?;
    eprintln!("{}", node.open_to());
    let selection = Selection::new(&options, &node)?;
    let (recorder, part) = start(&options, recorder_options, end.as_mut()).await?;

    let progress = Progress::start(&part.dir)?;
    let mut session = Session::new(node, recorder, selection);
    let began = Instant::now();
    let mut ticks = tokio::time::interval(LOOK_AROUND);
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = &mut end => break,
        }
        session.look_around(&progress);
        progress.show(&session.state(), began.elapsed());
        if session.failed() || options.duration.is_some_and(|time| began.elapsed() >= time) {
            break;
        }
    }
    progress.finish();
    let seconds = began.elapsed().as_secs_f64();
    let ended = session.finish(part.custom(seconds));
    report(&ended, &part, seconds, options.json);
    conclude(ended, options.complete)
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
    fn choose(options: &Options) -> Result<Self> {
        if !options.resume {
            return Ok(Self { dir: options.out.clone(), before: None, gap_s: None });
        }
        let (dir, before) = dermis_bag::next_free(&options.out)?;
        let gap_s = before
            .as_deref()
            .and_then(last_written)
            .and_then(|last| SystemTime::now().duration_since(last).ok().map(|since| since.as_secs_f64()));
        if let Some(before) = &before {
            eprintln!("{} holds an earlier part: recording goes on in {}", before.display(), dir.display());
            if !before.join("metadata.yaml").exists() {
                eprintln!(
                    "{0} was interrupted: `dermis bag check --repair {0}` completes it",
                    before.display()
                );
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
    options: &Options,
    recorder_options: RecorderOptions,
    mut end: Pin<&mut impl Future<Output = ()>>,
) -> Result<(Recorder, Part)> {
    let part = Part::choose(options)?;
    let mut said = false;
    loop {
        match Recorder::start(&part.dir, recorder_options) {
            Ok(recorder) => return Ok((recorder, part)),
            Err(error) if error.is_no_room() => {
                if !said {
                    eprintln!("nothing is recorded yet: {error}");
                    said = true;
                }
            }
            Err(error) => return Err(error.into()),
        }
        tokio::select! {
            () = tokio::time::sleep(AGAIN) => {}
            () = &mut end => anyhow::bail!("nothing was recorded: there was no room for {}", part.dir.display()),
        }
    }
}

/// A file that reaches a limit (`ulimit -f`) is to be an error like a full disk, not an end by a signal.
fn ignore_file_size_signal() {
    use nix::sys::signal::{SigHandler, Signal, signal};
    // SAFETY: no handler is installed, so that none can be unsafe to run in a signal.
    let done = unsafe { signal(Signal::SIGXFSZ, SigHandler::SigIgn) };
    if let Err(error) = done {
        eprintln!("a file size limit will end the recording by a signal: {error}");
    }
}

/// Ends with Ctrl-C or SIGTERM.
fn end_asked() -> Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt()).context("Ctrl-C cannot be waited for")?;
    let mut terminate = signal(SignalKind::terminate()).context("SIGTERM cannot be waited for")?;
    Ok(async move {
        tokio::select! { _ = interrupt.recv() => {}, _ = terminate.recv() => {} }
    })
}

/// Recorders run side by side, so that each has a name of its own.
fn node_name() -> String {
    format!("dermis_record_{}", std::process::id())
}

fn report(ended: &Ended, part: &Part, seconds: f64, as_json: bool) {
    let state = &ended.state;
    if let Ok(recorded) = &ended.recorded {
        let text = if as_json { as_line(ended, recorded, part, seconds) } else { recorded.bag.to_string() };
        // The bag is complete, whether or not somebody still reads what is printed.
        let _ = writeln!(std::io::stdout(), "{}", text.trim_end());
    }
    for sentence in losses(state) {
        let _ = writeln!(std::io::stderr(), "{sentence}");
    }
}

fn as_line(ended: &Ended, recorded: &dermis_bag::Recorded, part: &Part, seconds: f64) -> String {
    let (bag, state) = (&recorded.bag, &ended.state);
    let silent: std::collections::BTreeMap<_, _> = ended.silent.iter().cloned().collect();
    let report = json!({
        "bag": bag.path, "seconds": seconds, "messages": state.messages, "dropped": state.dropped,
        "lost": state.lost, "payload_bytes": state.payload_bytes, "stored_bytes": bag.bytes, "files": bag.files,
        "waited_for_room_s": state.paused_ms as f64 * 1e-3, "goes_on_from": part.before, "silent": silent,
        "topics": state.topics,
    });
    report.to_string()
}

/// What is missing, a sentence for each topic and reason.
fn losses(state: &RecorderState) -> Vec<String> {
    let mut sentences = Vec::new();
    for topic in &state.topics {
        let (name, lost) = (&topic.name, topic.lost.unwrap_or(0));
        let all = topic.recorded + topic.dropped + lost;
        if lost > 0 {
            sentences.push(format!(
                "{name}: {lost} of {all} messages were lost on the way, before they reached the recorder"
            ));
        }
        if topic.dropped > 0 {
            let dropped = topic.dropped;
            sentences.push(format!(
                "{name}: {dropped} of {all} messages were dropped, because they came faster than they were written or found no room: give --buffer more, or --compression less"
            ));
        }
        let beyond = topic.missing_frames.unwrap_or(0).saturating_sub(lost + topic.dropped);
        if beyond > 0 {
            sentences.push(format!(
                "{name}: {beyond} frames of the skin are missing that were not published as messages here"
            ));
        }
    }
    let unknown: Vec<_> = state.topics.iter().filter(|t| t.lost.is_none()).map(|t| t.name.as_str()).collect();
    if !unknown.is_empty() {
        sentences.push(format!(
            "whether messages were lost on the way is not known of {}: their publishers, or this ROS 2 implementation, do not number them",
            unknown.join(", ")
        ));
    }
    sentences
}

/// The exit: an error where the bag could not be completed, or a topic that was asked for by name brought nothing.
fn conclude(ended: Ended, complete: bool) -> Result<()> {
    let Ended { recorded, state, silent } = ended;
    recorded?;
    if !silent.is_empty() {
        let why: Vec<_> = silent.iter().map(|(topic, why)| format!("{topic} ({why})")).collect();
        anyhow::bail!("nothing was recorded of what was asked for by name: {}", why.join(", "));
    }
    let losses = state.losses();
    if complete && !losses.is_complete() {
        return Err(Incomplete(losses.to_string()).into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use dermis_bag::TopicState;

    use super::*;

    #[test]
    fn what_is_missing_is_said_by_topic_and_reason() {
        let topic = |name: &str, dropped, lost, missing_frames| TopicState {
            name: name.into(),
            type_name: String::new(),
            recorded: 90,
            dropped,
            lost,
            missing_frames,
        };
        let topics = vec![
            topic("/a", 4, Some(6), Some(12)),
            topic("/b", 0, Some(0), None),
            topic("/c", 0, None, None),
        ];
        let said = losses(&RecorderState { topics, ..RecorderState::default() }).join("\n");
        insta::assert_snapshot!(said, @r"
        /a: 6 of 100 messages were lost on the way, before they reached the recorder
        /a: 4 of 100 messages were dropped, because they came faster than they were written or found no room: give --buffer more, or --compression less
        /a: 2 frames of the skin are missing that were not published as messages here
        whether messages were lost on the way is not known of /c: their publishers, or this ROS 2 implementation, do not number them
        ");
    }
}
