//! `dermis play`: a bag, published again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_bag::{BagMessage, BagQos, BagReader, BagSkin, Filter};
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::rosgraph_msgs::msg::Clock;
use dermis_msgs::{OF_A_SKIN, SkinNames, TypeSupport, type_support};
use dermis_node::{
    Durability, History, Node, NodeOptions, Publisher, Qos, RawPublisher, Reliability, parse_remapping,
};
use dermis_perception::cli::NetworkArguments;
use serde_json::json;

use crate::backend::Choice;
use crate::quantity::duration;

/// Behind by more than this is told.
const BEHIND: Duration = Duration::from_millis(100);
/// How often it is told at most.
const TELL: Duration = Duration::from_secs(5);
/// How long subscribers have to find what is published before the first message goes out.
const DISCOVERY: Duration = Duration::from_millis(500);
/// Period of `/clock`.
const CLOCK: Duration = Duration::from_millis(10);

/// What to play, and how.
#[derive(Args)]
pub struct Options {
    /// Folder of a rosbag2 bag, or an .mcap file.
    bag: PathBuf,
    /// Speed: 2 is twice as fast; 0 as fast as it goes.
    #[arg(short, long, default_value_t = 1.0)]
    rate: f64,
    /// Begin again at the end, until Ctrl-C.
    #[arg(short, long)]
    r#loop: bool,
    /// Only these topics, by their full name or its end.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    topics: Vec<String>,
    /// Only what this skin has published, where a bag holds several; `dermis bag info` lists them. What does not name a skin
    /// (a wrench, markers) is taken from the namespaces that are of this skin alone.
    #[arg(long, value_name = "NAME")]
    skin_instance: Option<String>,
    /// Publish under another name: from:=to; may be repeated.
    #[arg(short = 'm', long, value_parser = remapping, value_name = "A:=B")]
    remap: Vec<(String, String)>,
    /// Leave out the first part of the bag, e.g. 10s.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    start_offset: Option<Duration>,
    /// End after this much of the bag, e.g. 60s.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    duration: Option<Duration>,
    /// Publish the bag's time on /clock, for nodes with use_sim_time.
    #[arg(long)]
    clock: bool,
    /// Begin when every topic has this many subscribers.
    #[arg(long, value_name = "N")]
    wait_for_subscribers: Option<usize>,
    /// Play what is whole of a bag whose recording was interrupted.
    #[arg(long)]
    recover: bool,
    #[command(flatten)]
    network: NetworkArguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

fn remapping(text: &str) -> Result<(String, String), String> {
    parse_remapping(text).map_err(|error| error.to_string())
}

/// How playing ended.
#[derive(Debug, Default)]
struct Played {
    messages: u64,
    bytes: u64,
    loops: u64,
    behind: Duration,
}

/// Plays to the end of the bag, or until Ctrl-C.
pub async fn run(options: Options) -> Result<()> {
    if !(options.rate >= 0.0 && options.rate.is_finite()) {
        bail!("--rate {} is no speed: give a number from 0 up", options.rate);
    }
    let reader =
        if options.recover { BagReader::recover(&options.bag)? } else { BagReader::open(&options.bag)? };
    let Some((first, last)) = reader.span() else {
        bail!("{} has no messages to play", options.bag.display());
    };
    let mut node_options = NodeOptions::new(format!("dermis_play_{}", std::process::id()))
        .network(options.network.choice())
        .diagnostics(false)
        .threads(1);
    for (from, to) in &options.remap {
        node_options = node_options.remap(from, to);
    }
    let node = Node::open(node_options, options.backend.open()?.as_ref())?;
    eprintln!("{}", node.open_to());
    let skin = options.skin_instance.as_deref().map(|name| skin(&reader, name)).transpose()?;
    let publishers = publishers(&options, &reader, &node, skin.as_ref())?;
    let clock = options
        .clock
        .then(|| {
            node.publisher::<Clock>(
                "/clock",
                Qos { reliability: Reliability::BestEffort, ..Qos::reliable(1) },
            )
        })
        .transpose()?;

    let nanos = |time: Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
    let start = first.saturating_add(options.start_offset.map_or(0, nanos));
    if start > last {
        bail!(
            "--start-offset is beyond the end of {}, which is {:.3} s long",
            options.bag.display(),
            (last - first) as f64 * 1e-9
        );
    }
    let end = options.duration.map_or(i64::MAX, |time| start.saturating_add(nanos(time)));
    let filter = Filter::default().topics(publishers.keys().cloned()).between(start, end);

    let worker = node.clone();
    let playing = tokio::task::spawn_blocking(move || {
        let mut played = Played::default();
        let skin = options.skin_instance.as_deref();
        let mut player = Player { node: &worker, publishers: &publishers, clock, rate: options.rate, skin };
        player.wait(options.wait_for_subscribers);
        while !worker.is_shut_down() {
            player.once(&reader, &filter, start, &mut played)?;
            played.loops += 1;
            if !options.r#loop {
                break;
            }
        }
        // What was sent last is on its way still.
        drop(publishers);
        Ok::<_, anyhow::Error>((played, options.json))
    });
    let stopping = node.clone();
    tokio::select! {
        done = playing => {
            let (played, as_json) = done.context("the player ended by a panic")??;
            node.shutdown();
            report(&played, as_json);
        }
        stopped = stopping.wait_for_shutdown() => stopped?,
    }
    Ok(())
}

fn report(played: &Played, as_json: bool) {
    let behind = played.behind.as_secs_f64();
    if as_json {
        println!(
            "{}",
            json!({ "messages": played.messages, "bytes": played.bytes, "loops": played.loops, "behind_s": behind })
        );
    } else {
        println!("{} messages, {:.1} MB", played.messages, played.bytes as f64 * 1e-6);
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
        bail!("{} has no skin `{name}`; it has {known}", reader.info().path.display());
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
    options: &Options,
    reader: &BagReader,
    node: &Node,
    skin: Option<&OneSkin>,
) -> Result<BTreeMap<String, RawPublisher>> {
    let mut wanted: Vec<&dermis_bag::Topic> = Vec::new();
    for name in &options.topics {
        wanted.push(reader.topic(name)?);
    }
    if options.topics.is_empty() {
        wanted.extend(reader.topics().iter().filter(|topic| topic.messages > 0));
    }
    let mut publishers = BTreeMap::new();
    for topic in wanted {
        if options.clock && topic.name == "/clock" || skin.is_some_and(|skin| !skin.has(topic)) {
            continue;
        }
        let made = support_of(reader, topic)
            .and_then(|support| Ok(node.publisher_raw(&topic.name, support, qos(topic.qos))?));
        match made {
            Ok(publisher) => {
                publishers.insert(topic.name.clone(), publisher);
            }
            Err(why) => eprintln!("{} is not played: {why:#}", topic.name),
        }
    }
    if publishers.is_empty() {
        bail!("nothing of {} can be played", options.bag.display());
    }
    Ok(publishers)
}

/// The type of a recorded topic: built in, where the bag's version is ours, or as the bag describes it.
fn support_of(reader: &BagReader, topic: &dermis_bag::Topic) -> Result<&'static TypeSupport> {
    let checked =
        type_support(&topic.type_name).map(|support| reader.check_type(topic, support).map(|()| support));
    match (checked, &topic.type_hash) {
        (Some(Ok(support)), _) => Ok(support),
        (_, Some(hash)) => Ok(crate::foreign::support(&topic.type_name, hash, &topic.definition)),
        (Some(Err(error)), None) => Err(error.into()),
        (None, None) => bail!("type {} is not known here, and the bag has no hash of it", topic.type_name),
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
}

impl Player<'_> {
    /// Waits for the subscribers that were asked for; else gives those that are there the time to find the publishers.
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

    fn once(&mut self, reader: &BagReader, filter: &Filter, start: i64, played: &mut Played) -> Result<()> {
        let mut told: Option<Instant> = None;
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
                played.behind = played.behind.max(late);
                if late > BEHIND && told.is_none_or(|last| last.elapsed() >= TELL) {
                    told = Some(Instant::now());
                    eprintln!("{:.1} s behind: this is more than goes out in time", late.as_secs_f64());
                }
            } else if self.node.is_shut_down() {
                return Ok(());
            }
            self.tick(message.log_time, &mut now)?;
            let Some(publisher) = self.publishers.get(&*message.topic) else { continue };
            publisher.publish_cdr(&message.data)?;
            played.messages += 1;
            played.bytes += message.data.len() as u64;
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
