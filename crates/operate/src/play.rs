//! Publishes what a bag holds.
//!
//! Each message goes out after the time that lies between it and the first, as it was logged, divided by the speed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use dermis_bag::{BagMessage, BagQos, BagReader, BagSkin, Filter};
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::rosgraph_msgs::msg::Clock;
use dermis_msgs::{OF_A_SKIN, SkinNames, TypeSupport, type_support};
use dermis_node::{
    Backend, Durability, History, Node, NodeOptions, Publisher, Qos, RawPublisher, Reliability,
    parse_remapping,
};
use dermis_perception::cli::NetworkArguments;
use serde::{Deserialize, Serialize};

use crate::quantity::duration;
use crate::{OperateError, Progress, foreign, written};

type Result<T, E = OperateError> = std::result::Result<T, E>;

/// Behind by more than this is reported.
const BEHIND: Duration = Duration::from_millis(100);
/// How often it is reported at most.
const TELL: Duration = Duration::from_secs(5);
/// How long subscribers have to find what is published before the first message goes out.
const DISCOVERY: Duration = Duration::from_millis(500);
/// Period of `/clock`.
const CLOCK: Duration = Duration::from_millis(10);

/// What to play, and how.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Folder of a rosbag2 bag, or an .mcap file.
    pub bag: PathBuf,
    /// Speed: 2 is twice as fast; 0 as fast as it goes.
    #[arg(short, long, default_value_t = Request::default().rate)]
    pub rate: f64,
    /// Begin again at the end, until Ctrl-C.
    #[arg(short, long)]
    pub r#loop: bool,
    /// Only these topics, by their full name or its end.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Only what this skin has published, where a bag holds several; `dermis bag info` lists them. What does not name a skin
    /// (a wrench, markers) is taken from the namespaces that are of this skin alone.
    #[arg(long, value_name = "NAME")]
    pub skin_instance: Option<String>,
    /// Publish under another name: from:=to; may be repeated.
    #[arg(short = 'm', long, value_parser = remapping, value_name = "A:=B")]
    #[serde(with = "written::remappings")]
    pub remap: Vec<(String, String)>,
    /// Leave out the first part of the bag, e.g. 10s.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    #[serde(with = "written::duration")]
    pub start_offset: Option<Duration>,
    /// End after this much of the bag, e.g. 60s.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    #[serde(with = "written::duration")]
    pub duration: Option<Duration>,
    /// Publish the bag's time on /clock, for nodes with use_sim_time.
    #[arg(long)]
    pub clock: bool,
    /// Begin when every topic has this many subscribers.
    #[arg(long, value_name = "N")]
    pub wait_for_subscribers: Option<usize>,
    /// Play what is whole of a bag whose recording was interrupted.
    #[arg(long)]
    pub recover: bool,
    /// How far the network reaches.
    #[command(flatten)]
    pub network: NetworkArguments,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            bag: PathBuf::new(),
            rate: 1.0,
            r#loop: false,
            topics: Vec::new(),
            skin_instance: None,
            remap: Vec::new(),
            start_offset: None,
            duration: None,
            clock: false,
            wait_for_subscribers: None,
            recover: false,
            network: NetworkArguments::default(),
        }
    }
}

fn remapping(text: &str) -> Result<(String, String), String> {
    parse_remapping(text).map_err(|error| error.to_string())
}

/// How playing ended.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Findings {
    /// Messages that were published.
    pub messages: u64,
    /// Bytes of these.
    pub bytes: u64,
    /// How often the bag was played to its end.
    pub loops: u64,
    /// \[s\] that a message went out later than it was due, at most.
    pub behind_s: f64,
}

/// Plays to the end of the bag, or until the node is shut down by a signal: then there is nothing to find.
///
/// # Errors
///
/// Where the bag cannot be read, or nothing of it can be published.
pub async fn play(
    request: Request,
    backend: &dyn Backend,
    progress: Arc<dyn Progress>,
) -> Result<Option<Findings>> {
    if !(request.rate >= 0.0 && request.rate.is_finite()) {
        return Err(OperateError::Rate(request.rate));
    }
    let reader =
        if request.recover { BagReader::recover(&request.bag)? } else { BagReader::open(&request.bag)? };
    let Some((first, last)) = reader.span() else {
        return Err(OperateError::Empty(request.bag));
    };
    let mut node_options = NodeOptions::new(format!("dermis_play_{}", std::process::id()))
        .network(request.network.choice())
        .diagnostics(false)
        .threads(1);
    for (from, to) in &request.remap {
        node_options = node_options.remap(from, to);
    }
    let node = Node::open(node_options, backend)?;
    progress.note(&node.open_to());
    let skin = request.skin_instance.as_deref().map(|name| skin(&reader, name)).transpose()?;
    let publishers = publishers(&request, &reader, &node, skin.as_ref(), progress.as_ref())?;
    let clock = request
        .clock
        .then(|| {
            node.publisher::<Clock>(
                "/clock",
                Qos { reliability: Reliability::BestEffort, ..Qos::reliable(1) },
            )
        })
        .transpose()?;

    let nanos = |time: Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
    let start = first.saturating_add(request.start_offset.map_or(0, nanos));
    if start > last {
        return Err(OperateError::BeyondEnd { bag: request.bag, seconds: (last - first) as f64 * 1e-9 });
    }
    let end = request.duration.map_or(i64::MAX, |time| start.saturating_add(nanos(time)));
    let filter = Filter::default().topics(publishers.keys().cloned()).between(start, end);

    let worker = node.clone();
    let playing = tokio::task::spawn_blocking(move || {
        let mut found = Findings::default();
        let mut player = Player {
            node: &worker,
            publishers: &publishers,
            clock,
            rate: request.rate,
            skin: request.skin_instance.as_deref(),
            progress: progress.as_ref(),
        };
        player.wait(request.wait_for_subscribers);
        while !worker.is_shut_down() {
            player.once(&reader, &filter, start, &mut found)?;
            found.loops += 1;
            if !request.r#loop {
                break;
            }
        }
        // What was sent last is on its way still.
        drop(publishers);
        Ok::<_, OperateError>(found)
    });
    let stopping = node.clone();
    tokio::select! {
        done = playing => {
            let found = done.map_err(OperateError::PlayerPanicked)??;
            node.shutdown();
            Ok(Some(found))
        }
        stopped = stopping.wait_for_shutdown() => {
            stopped?;
            Ok(None)
        }
    }
}

/// One skin of a bag: the topics that carry messages of it, and the namespaces that are of it alone.
struct OneSkin {
    topics: BTreeSet<String>,
    namespaces: BTreeSet<String>,
}

impl OneSkin {
    fn has(&self, topic: &dermis_bag::Topic) -> bool {
        if OF_A_SKIN.contains(&topic.type_name.as_str()) {
            return self.topics.contains(&topic.name);
        }
        self.namespaces.contains(namespace(&topic.name))
    }
}

fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}

/// The skin of this name.
fn skin(reader: &BagReader, name: &str) -> Result<OneSkin> {
    let skins = reader.skins()?;
    let Some(skin) = skins.iter().find(|skin| skin.name == name) else {
        let known: Vec<&str> = skins.iter().map(|skin| skin.name.as_str()).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        return Err(OperateError::NoSuchSkin { bag: reader.info().path, skin: name.to_owned(), known });
    };
    let spaces = |skin: &BagSkin| -> BTreeSet<String> {
        skin.topics.keys().map(|topic| namespace(topic).to_owned()).collect()
    };
    let others: BTreeSet<String> = skins.iter().filter(|s| s.name != name).flat_map(spaces).collect();
    Ok(OneSkin {
        topics: skin.topics.keys().cloned().collect(),
        namespaces: spaces(skin).difference(&others).cloned().collect(),
    })
}

/// One publisher for each topic that can be played; says which cannot.
fn publishers(
    request: &Request,
    reader: &BagReader,
    node: &Node,
    skin: Option<&OneSkin>,
    progress: &dyn Progress,
) -> Result<BTreeMap<String, RawPublisher>> {
    let mut wanted: Vec<&dermis_bag::Topic> = Vec::new();
    for name in &request.topics {
        wanted.push(reader.topic(name)?);
    }
    if request.topics.is_empty() {
        wanted.extend(reader.topics().iter().filter(|topic| topic.messages > 0));
    }
    let mut publishers = BTreeMap::new();
    for topic in wanted {
        if request.clock && topic.name == "/clock" || skin.is_some_and(|skin| !skin.has(topic)) {
            continue;
        }
        let made = support_of(reader, topic)
            .and_then(|support| Ok(node.publisher_raw(&topic.name, support, qos(topic.qos))?));
        match made {
            Ok(publisher) => {
                publishers.insert(topic.name.clone(), publisher);
            }
            Err(why) => progress.note(&format!("{} is not played: {}", topic.name, why.whole())),
        }
    }
    if publishers.is_empty() {
        return Err(OperateError::NothingToPlay(request.bag.clone()));
    }
    Ok(publishers)
}

/// The type of a recorded topic: built in, where the bag's version is ours, or as the bag describes it.
fn support_of(reader: &BagReader, topic: &dermis_bag::Topic) -> Result<&'static TypeSupport> {
    let checked =
        type_support(&topic.type_name).map(|support| reader.check_type(topic, support).map(|()| support));
    match (checked, &topic.type_hash) {
        (Some(Ok(support)), _) => Ok(support),
        (_, Some(hash)) => Ok(foreign::support(&topic.type_name, hash, &topic.definition)),
        (Some(Err(error)), None) => Err(error.into()),
        (None, None) => Err(OperateError::UnknownType { type_name: topic.type_name.clone(), place: "bag" }),
    }
}

fn qos(recorded: Option<BagQos>) -> Qos {
    let Some(recorded) = recorded else { return Qos::reliable(10) };
    Qos {
        reliability: match recorded.reliability {
            dermis_bag::Reliability::BestEffort => Reliability::BestEffort,
            dermis_bag::Reliability::Reliable => Reliability::Reliable,
        },
        durability: match recorded.durability {
            dermis_bag::Durability::Volatile => Durability::Volatile,
            dermis_bag::Durability::TransientLocal => Durability::TransientLocal,
        },
        history: if recorded.depth == 0 { History::KeepAll } else { History::KeepLast(recorded.depth) },
    }
}

/// Whether a message names another skin: a topic may carry several.
fn is_of_another(skin: &str, message: &BagMessage) -> bool {
    OF_A_SKIN.contains(&&*message.type_name)
        && SkinNames::of(&message.data).is_ok_and(|names| names.skin != skin)
}

struct Player<'a> {
    node: &'a Node,
    publishers: &'a BTreeMap<String, RawPublisher>,
    clock: Option<Publisher<Clock>>,
    rate: f64,
    /// Name of the only skin that is played.
    skin: Option<&'a str>,
    progress: &'a dyn Progress,
}

impl Player<'_> {
    /// Waits for the subscribers that were requested; else gives those that are there the time to find the publishers.
    fn wait(&self, subscribers: Option<usize>) {
        let began = Instant::now();
        while !self.node.is_shut_down() {
            let ready = match subscribers {
                Some(count) => {
                    self.publishers.values().all(|publisher| publisher.subscriber_count() >= count)
                }
                None => began.elapsed() >= DISCOVERY,
            };
            if ready {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn once(&mut self, reader: &BagReader, filter: &Filter, start: i64, found: &mut Findings) -> Result<()> {
        let mut warned: Option<Instant> = None;
        let mut now = start;
        let mut messages = reader.messages_by_time(filter).peekable();
        // Until the first message is read, no time passes.
        messages.peek();
        let began = Instant::now();
        for message in messages {
            let message = message?;
            if self.skin.is_some_and(|skin| is_of_another(skin, &message)) {
                continue;
            }
            if self.rate > 0.0 {
                let since = (message.log_time - start).max(0) as f64 * 1e-9 / self.rate;
                let due = began + Duration::from_secs_f64(since);
                if !self.until(due, message.log_time, &mut now) {
                    return Ok(());
                }
                let late = due.elapsed();
                found.behind_s = found.behind_s.max(late.as_secs_f64());
                if late > BEHIND && warned.is_none_or(|last| last.elapsed() >= TELL) {
                    warned = Some(Instant::now());
                    let late = late.as_secs_f64();
                    self.progress.note(&format!("{late:.1} s behind: this is more than goes out in time"));
                }
            } else if self.node.is_shut_down() {
                return Ok(());
            }
            self.tick(message.log_time, &mut now)?;
            let Some(publisher) = self.publishers.get(&*message.topic) else { continue };
            publisher.publish_cdr(&message.data)?;
            found.messages += 1;
            found.bytes += message.data.len() as u64;
        }
        Ok(())
    }

    /// Sleeps until a message is due, while the bag's time goes on; false where the node was shut down.
    fn until(&self, due: Instant, log_time: i64, now: &mut i64) -> bool {
        let step = if self.clock.is_some() { CLOCK } else { Duration::from_millis(100) };
        loop {
            if self.node.is_shut_down() {
                return false;
            }
            let left = due.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(step));
            let left = due.saturating_duration_since(Instant::now()).as_secs_f64() * self.rate;
            let reached = log_time - (left * 1e9) as i64;
            if !left.le(&0.0) && self.tick(reached, now).is_err() {
                return false;
            }
        }
    }

    /// Publishes the bag's time, no more often than its period.
    fn tick(&self, reached: i64, now: &mut i64) -> Result<()> {
        let Some(clock) = &self.clock else { return Ok(()) };
        let period = i64::try_from(CLOCK.as_nanos()).unwrap_or(i64::MAX) / 2;
        if reached.saturating_sub(*now) >= period {
            *now = reached;
            clock.publish(&Clock { clock: Time::from_nanos(reached) })?;
        }
        Ok(())
    }
}
