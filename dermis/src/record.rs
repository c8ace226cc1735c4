//! `dermis record`: what nodes publish, into a bag.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use dermis_bag::{BagQos, Compression, Recorded, Recorder, RecorderOptions, RecorderState, Topic, TopicSink};
use dermis_msgs::{TypeSupport, type_support};
use dermis_node::backend::{EndpointInfo, EndpointKind};
use dermis_node::{Durability, History, Node, NodeOptions, Qos, Reliability, Subscription};
use dermis_perception::cli::NetworkArguments;
use indicatif::{ProgressBar, ProgressStyle};
use regex::Regex;
use serde_json::json;

use crate::backend::Choice;
use crate::quantity::{duration, size};

/// How often the graph is looked at for new topics, and the end for its reasons.
const LOOK_AROUND: Duration = Duration::from_millis(100);
/// How often progress is shown on a terminal.
const DRAW: Duration = Duration::from_millis(500);
/// How often it is told elsewhere.
const TELL: Duration = Duration::from_secs(15);
/// Messages that a queue of ROS 2 holds for us, where it cannot be without a bound.
const DEPTH: usize = 1000;

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
    /// Folder of the bag; must not exist yet.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Begin a new file after this many bytes, e.g. 1GiB.
    #[arg(long, value_parser = size, value_name = "SIZE")]
    split_size: Option<u64>,
    /// Begin a new file after this time, e.g. 10min.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    split_time: Option<Duration>,
    /// Compression of the chunks.
    #[arg(long, value_enum, default_value_t)]
    compression: Level,
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

/// Runs until Ctrl-C, SIGTERM, the end of its time or of the disk.
pub async fn run(options: Options) -> Result<()> {
    ignore_file_size_signal();
    let defaults = RecorderOptions::default();
    let layout = defaults
        .bag
        .compression(options.compression.into())
        .split_bytes(options.split_size)
        .split_ns(options.split_time.and_then(|time| i64::try_from(time.as_nanos()).ok()));
    let queue_bytes = usize::try_from(options.buffer).unwrap_or(usize::MAX);
    let recorder_options = defaults.bag(layout).queue_bytes(queue_bytes);
    let mut end = std::pin::pin!(end_asked()?);
    let node_options = NodeOptions::new(node_name())
        .namespace(&options.namespace)
        .network(options.network.choice())
        .diagnostics(false)
        .threads(1);
    let node = Node::open(node_options, options.backend.open()?.as_ref())?;
    eprintln!("{}", node.open_to());
    let selection = Selection::new(&options, &node)?;
    let recorder = Recorder::start(&options.out, recorder_options)?;
    let mut recording =
        Recording { node, recorder, selection, taken: BTreeMap::new(), told: BTreeSet::new() };

    let progress = Progress::start(&options)?;
    let began = Instant::now();
    let mut ticks = tokio::time::interval(LOOK_AROUND);
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = &mut end => break,
        }
        recording.look_around(&progress);
        progress.tell(&recording.recorder.state(), began.elapsed());
        if recording.recorder.failed() || options.duration.is_some_and(|time| began.elapsed() >= time) {
            break;
        }
    }
    progress.finish();
    let seconds = began.elapsed().as_secs_f64();
    let recorded = recording.finish(seconds)?;
    report(&recorded, seconds, options.json);
    Ok(())
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

/// Which topics are wanted.
struct Selection {
    topics: BTreeSet<String>,
    regex: Vec<Regex>,
    types: Vec<String>,
    exclude: Vec<Regex>,
    all: bool,
    hidden: bool,
}

impl Selection {
    fn new(options: &Options, node: &Node) -> Result<Self> {
        let topics = options.topics.iter().map(|topic| node.resolve_name(topic)).collect::<Result<_, _>>()?;
        let some = !options.topics.is_empty() || !options.regex.is_empty() || !options.types.is_empty();
        Ok(Self {
            topics,
            regex: options.regex.clone(),
            types: options.types.clone(),
            exclude: options.exclude.clone(),
            all: options.all || !some,
            hidden: options.include_hidden,
        })
    }

    fn wants(&self, topic: &str, type_name: &str) -> bool {
        if self.topics.contains(topic) {
            return true;
        }
        let hidden = topic.split('/').any(|part| part.starts_with('_'));
        let found = self.all
            || self.regex.iter().any(|regex| regex.is_match(topic))
            || self.types.iter().any(|wanted| wanted == type_name);
        found && (self.hidden || !hidden) && !self.exclude.iter().any(|regex| regex.is_match(topic))
    }
}

/// A topic that is being recorded.
struct Taken {
    subscription: Subscription,
    sink: TopicSink,
    qos: Qos,
}

struct Recording {
    node: Node,
    recorder: Recorder,
    selection: Selection,
    taken: BTreeMap<String, Taken>,
    /// Topics that cannot be recorded, and why, each said once.
    told: BTreeSet<(String, String)>,
}

impl Recording {
    /// Takes up topics that appeared.
    fn look_around(&mut self, progress: &Progress) {
        let topics = match self.node.topics() {
            Ok(topics) => topics,
            Err(error) => return self.tell(progress, "the ROS graph", &error.to_string()),
        };
        let mut by_name: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (name, type_name) in topics {
            by_name.entry(name).or_default().push(type_name);
        }
        for (name, types) in by_name {
            let type_name = &types[0];
            if !self.selection.wants(&name, type_name) {
                continue;
            }
            if let Err(why) = self.take(&name, &types) {
                self.tell(progress, &name, &format!("{why:#}"));
            }
        }
    }

    fn tell(&mut self, progress: &Progress, what: &str, why: &str) {
        if self.told.insert((what.to_owned(), why.to_owned())) {
            progress.say(&format!("{what} is not recorded: {why}"));
        }
    }

    fn take(&mut self, name: &str, types: &[String]) -> Result<()> {
        let mut offers = self.node.endpoints(name, EndpointKind::Publisher)?;
        offers.retain(|offer| !offer.own);
        let Some(first) = offers.first() else { return Ok(()) };
        let (wanted, offered) = adapt(&offers, self.node.backend_name());
        if let Some(taken) = self.taken.get(name)
            && (taken.qos == wanted || wanted.unmet_by(&taken.qos).is_none())
        {
            return Ok(());
        }
        if types.len() > 1 {
            anyhow::bail!("its publishers disagree on the type: {}", types.join(", "));
        }
        let support = support_of(first)?;
        let sink = self.recorder.topic(Topic::of_type(name, support, Some(offered)));
        let queue = sink.clone();
        // Before a new subscription with other terms, the old one ends.
        self.taken.remove(name);
        let subscription = self.node.subscribe_raw(name, support, wanted, move |data, info| {
            let published = info.source_ns.unwrap_or(info.received_ns);
            // What does not fit is counted there.
            let _ = queue.push(data.to_vec(), info.received_ns, published);
        })?;
        self.taken.insert(name.to_owned(), Taken { subscription, sink, qos: wanted });
        Ok(())
    }

    fn finish(self, seconds: f64) -> Result<Recorded> {
        for taken in self.taken.into_values() {
            let (subscription, sink) = (taken.subscription, taken.sink);
            sink.lost(subscription.dropped());
            drop(subscription);
        }
        let custom = [
            ("recorder".to_owned(), concat!("dermis ", env!("CARGO_PKG_VERSION")).to_owned()),
            ("recorded_s".to_owned(), format!("{seconds:.3}")),
        ];
        let recorded = self.recorder.finish(custom)?;
        self.node.shutdown();
        Ok(recorded)
    }
}

/// The terms to subscribe with, and those to store: reliable and latched only where all publishers offer it.
fn adapt(offers: &[EndpointInfo], backend: &str) -> (Qos, BagQos) {
    let known = || offers.iter().filter_map(|offer| offer.qos);
    let all = |test: fn(&Qos) -> bool| known().next().is_some() && known().all(|qos| test(&qos));
    let reliable = all(|qos| qos.reliability == Reliability::Reliable);
    let latched = all(|qos| qos.durability == Durability::TransientLocal);
    let depth = known().map(|qos| qos.depth().unwrap_or(0)).max().unwrap_or(10);
    let keep_all = known().any(|qos| qos.depth().is_none());
    let wanted = Qos {
        reliability: if reliable { Reliability::Reliable } else { Reliability::BestEffort },
        durability: if latched { Durability::TransientLocal } else { Durability::Volatile },
        // What the recorder's own queue, bounded in bytes, does not take, it counts: no queue before it may drop.
        history: if backend == "hiroz" { History::KeepAll } else { History::KeepLast(DEPTH) },
    };
    let offered = BagQos {
        reliability: if reliable {
            dermis_bag::Reliability::Reliable
        } else {
            dermis_bag::Reliability::BestEffort
        },
        durability: if latched {
            dermis_bag::Durability::TransientLocal
        } else {
            dermis_bag::Durability::Volatile
        },
        depth: if keep_all { 0 } else { depth },
    };
    (wanted, offered)
}

/// What is known of the type of a publisher: built in, or by its hash from the graph and its definition from the ROS 2
/// that is sourced.
fn support_of(offer: &EndpointInfo) -> Result<&'static TypeSupport> {
    let built_in = type_support(&offer.type_name);
    let Some(hash) = &offer.type_hash else {
        return built_in.with_context(|| {
            format!("type {} is not known here, and the graph has no hash of it", offer.type_name)
        });
    };
    if let Some(support) = built_in.filter(|support| support.hash == hash) {
        return Ok(support);
    }
    let other = if built_in.is_some() { "another version of " } else { "" };
    let definition = crate::foreign::definition(&offer.type_name).with_context(|| {
        format!("{} publishes {other}{}, which is not known here", offer.node, offer.type_name)
    })?;
    Ok(crate::foreign::support(&offer.type_name, hash, &definition))
}

/// Shows how it goes: a line that is drawn over on a terminal, a line now and then elsewhere.
struct Progress {
    bar: Option<ProgressBar>,
    last: std::cell::Cell<(Instant, u64)>,
}

impl Progress {
    fn start(options: &Options) -> Result<Self> {
        let bar = std::io::stderr().is_terminal().then(|| -> Result<_> {
            let bar = ProgressBar::new_spinner();
            bar.set_style(ProgressStyle::with_template("{spinner} {elapsed_precise} {msg}")?);
            bar.set_message(format!("waiting for topics; to {}", options.out.display()));
            bar.enable_steady_tick(Duration::from_millis(250));
            Ok(bar)
        });
        Ok(Self { bar: bar.transpose()?, last: std::cell::Cell::new((Instant::now(), 0)) })
    }

    fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None => eprintln!("{text}"),
        }
    }

    fn tell(&self, state: &RecorderState, elapsed: Duration) {
        let (last, bytes) = self.last.get();
        let since = last.elapsed();
        if since < if self.bar.is_some() { DRAW } else { TELL } {
            return;
        }
        let rate = (state.payload_bytes - bytes) as f64 / since.as_secs_f64() * 1e-6;
        self.last.set((Instant::now(), state.payload_bytes));
        let line = format!(
            "{} messages on {} topics, {:.1} MB, {rate:.1} MB/s, {} dropped",
            state.messages,
            state.topics.len(),
            state.payload_bytes as f64 * 1e-6,
            state.dropped
        );
        match &self.bar {
            Some(bar) => bar.set_message(line),
            None => eprintln!("{:.0} s: {line}", elapsed.as_secs_f64()),
        }
    }

    fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn report(recorded: &Recorded, seconds: f64, as_json: bool) {
    let Recorded { bag, state } = recorded;
    let text = if as_json {
        let report = json!({
            "bag": bag.path, "seconds": seconds, "messages": state.messages, "dropped": state.dropped,
            "payload_bytes": state.payload_bytes, "stored_bytes": bag.bytes, "files": bag.files,
            "topics": state.topics,
        });
        report.to_string()
    } else {
        bag.to_string()
    };
    // The bag is complete, whether or not somebody still reads what is printed.
    let _ = writeln!(std::io::stdout(), "{text}");
    for topic in state.topics.iter().filter(|topic| topic.dropped > 0) {
        let _ = writeln!(
            std::io::stderr(),
            "{}: {} of {} messages were dropped, because they came faster than they were written: give --buffer more, or --compression less",
            topic.name,
            topic.dropped,
            topic.dropped + topic.recorded
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selection(topics: &[&str], regex: &[&str], types: &[&str], exclude: &[&str], all: bool) -> Selection {
        let regexes = |list: &[&str]| list.iter().map(|text| Regex::new(text).unwrap()).collect();
        Selection {
            topics: topics.iter().map(|&t| t.to_owned()).collect(),
            regex: regexes(regex),
            types: types.iter().map(|&t| t.to_owned()).collect(),
            exclude: regexes(exclude),
            all: all || (topics.is_empty() && regex.is_empty() && types.is_empty()),
            hidden: false,
        }
    }

    #[test]
    fn topics_are_chosen_as_asked() {
        let frame = "dermis_msgs/msg/TaxelFrame";
        assert!(selection(&[], &[], &[], &[], false).wants("/left/taxels", frame));
        assert!(!selection(&[], &[], &[], &[], false).wants("/left/_hidden/x", frame));
        let some = selection(&["/_a"], &["^/left/"], &[frame], &["truth$"], false);
        assert!(some.wants("/_a", "x/msg/Y") && some.wants("/left/b", "x/msg/Y") && some.wants("/c", frame));
        assert!(!some.wants("/c", "x/msg/Y") && !some.wants("/left/ground_truth", frame));
    }

    #[test]
    fn terms_fit_every_publisher() {
        let offer = |qos: Qos| EndpointInfo {
            node: "/n".into(),
            own: false,
            type_name: String::new(),
            type_hash: None,
            qos: Some(qos),
        };
        let (wanted, stored) = adapt(&[offer(Qos::latched())], "hiroz");
        assert_eq!(
            (wanted.reliability, wanted.durability),
            (Reliability::Reliable, Durability::TransientLocal)
        );
        assert_eq!(stored, BagQos::latched());
        let (wanted, stored) = adapt(&[offer(Qos::latched()), offer(Qos::sensor_data())], "r2r");
        assert_eq!((wanted.reliability, wanted.durability), (Reliability::BestEffort, Durability::Volatile));
        assert_eq!(wanted.history, History::KeepLast(DEPTH));
        assert_eq!(stored, BagQos { depth: 5, ..BagQos::sensor_data() });
    }
}
