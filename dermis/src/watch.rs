//! What running skins feel, whoever started them: `dermis watch`.
//!
//! Skins are found by the type of their contacts in the ROS graph, and told apart by topic and name, because two nodes may
//! publish one topic.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use dermis_bridge_zenoh::commands::{Command, Commander, node_of};
use dermis_msgs::msg::ContactArray;
use dermis_msgs::{Message, TypeSupport};
use dermis_node::{Node, NodeOptions, Qos, Subscription};
use dermis_perception::cli::NetworkArguments;
use serde_json::{Value, json};

use crate::backend::Choice;
use crate::demo::duration;
use crate::table::{DRAW, Felt, Table};

/// Which skins, and how they are shown.
#[derive(Args)]
pub struct Options {
    /// Skins to show, by the name that their contacts carry; all that are there where none is given.
    skins: Vec<String>,
    /// Tare each of them first; nothing may touch them.
    #[arg(long)]
    tare: bool,
    /// One JSON object a second instead of a table.
    #[arg(long)]
    json: bool,
    /// End after this long, e.g. `10s` or `2m`; until Ctrl-C where absent.
    #[arg(long, value_parser = duration)]
    duration: Option<Duration>,
    /// How long to look for a skin before giving up.
    #[arg(long, value_parser = duration, default_value = "10s")]
    within: Duration,
    #[command(flatten)]
    network: NetworkArguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Topic and name of a skin.
type Key = (String, String);

/// What came until now.
#[derive(Default)]
struct Seen {
    shown: BTreeMap<Key, Felt>,
    /// Names of skins that are there and were not asked for.
    others: Vec<String>,
}

/// Topics of contacts that are listened to.
type Listened = BTreeMap<String, Subscription>;

/// Runs until Ctrl-C, or as long as was said.
pub async fn run(options: Options) -> Result<()> {
    let name = format!("dermis_watch_{}", std::process::id());
    let node = Node::open(
        NodeOptions::new(name).network(options.network.choice()).diagnostics(false),
        options.backend.open()?.as_ref(),
    )?;
    eprintln!("{}", node.open_to());
    let seen = Arc::new(Mutex::new(Seen::default()));
    let done = watch(&options, &node, &seen).await;
    let closing = node.clone();
    // It waits for callbacks, which an asynchronous thread must not.
    tokio::task::spawn_blocking(move || closing.shutdown()).await?;
    done
}

async fn watch(options: &Options, node: &Node, seen: &Arc<Mutex<Seen>>) -> Result<()> {
    let mut listened = Listened::new();
    let mut table = Table::begin();
    let mut tares = Tares::new(node);
    let mut objects = 0;
    loop {
        listen(options, node, seen, &mut listened)?;
        tokio::select! {
            () = tokio::time::sleep(DRAW) => {}
            stopped = tokio::signal::ctrl_c() => { stopped?; break; }
        }
        let (missing, news) = {
            let seen = lock(seen);
            let news: Vec<Key> = seen.shown.keys().cloned().collect();
            (missing(options, &seen), news)
        };
        if !missing.is_empty() && table.elapsed() >= options.within {
            bail!("{}", nothing(options, node, &lock(seen), &missing, &listened));
        }
        if options.tare {
            tares.of(&news).await;
        }
        let seen = lock(seen);
        if !options.json {
            crate::table::shown(table.draw(seen.shown.values()))?;
        } else if table.elapsed().as_secs() > objects && !seen.shown.is_empty() {
            objects = table.elapsed().as_secs();
            print(&object(node, &seen))?;
        }
        if options.duration.is_some_and(|d| table.elapsed() >= d) {
            break;
        }
    }
    let missing = missing(options, &lock(seen));
    if !missing.is_empty() {
        bail!("{}", nothing(options, node, &lock(seen), &missing, &listened));
    }
    tares.end()
}

/// Subscribes to contacts that are new in the graph, and lets go of those that went.
fn listen(options: &Options, node: &Node, seen: &Arc<Mutex<Seen>>, listened: &mut Listened) -> Result<()> {
    let topics = node.topics()?;
    let there =
        |topic: &str| topics.iter().any(|(name, kind)| name == topic && kind == ContactArray::TYPE_NAME);
    listened.retain(|topic, _| there(topic));
    for (topic, kind) in &topics {
        if kind != ContactArray::TYPE_NAME || listened.contains_key(topic) {
            continue;
        }
        let (sink, key, wanted) = (Arc::clone(seen), topic.clone(), options.skins.clone());
        let subscription =
            node.subscribe::<ContactArray>(topic, Qos::sensor_data(), move |array, info| {
                lock(&sink).take(&key, &wanted, array, info.received_ns);
            })?;
        listened.insert(topic.clone(), subscription);
    }
    Ok(())
}

impl Seen {
    fn take(&mut self, topic: &str, wanted: &[String], array: ContactArray, received_ns: i64) {
        if !wanted.is_empty() && !wanted.contains(&array.skin) {
            if !self.others.contains(&array.skin) {
                self.others.push(array.skin);
            }
            return;
        }
        let (skin, key) = (array.skin.clone(), (topic.to_owned(), array.skin.clone()));
        if let Some(felt) = self.shown.get_mut(&key) {
            return felt.take(array, received_ns);
        }
        let mut felt = Felt::new(skin.as_str());
        felt.take(array, received_ns);
        self.shown.insert(key, felt);
        // Two devices of one name: the topic tells them apart.
        if self.shown.keys().filter(|(_, name)| *name == skin).count() > 1 {
            for ((topic, _), felt) in self.shown.iter_mut().filter(|((_, name), _)| *name == skin) {
                felt.rename(format!("{skin} ({topic})"));
            }
        }
    }
}

/// Skins that were asked for and are not there: by name, or any.
fn missing(options: &Options, seen: &Seen) -> Vec<String> {
    if options.skins.is_empty() {
        return if seen.shown.is_empty() { vec![String::new()] } else { Vec::new() };
    }
    let there = |name: &str| seen.shown.keys().any(|(_, skin)| skin == name);
    options.skins.iter().filter(|name| !there(name)).cloned().collect()
}

/// Why there is nothing to show, and what to look at.
fn nothing(options: &Options, node: &Node, seen: &Seen, missing: &[String], listened: &Listened) -> String {
    let what = match missing {
        [one] if one.is_empty() => "no skin was heard".to_owned(),
        several => format!("skin `{}` was not heard", several.join("`, `")),
    };
    let within = options.duration.map_or(options.within, |d| d.min(options.within)).as_secs_f64();
    let domain = node.domain_id();
    let sentence = format!("{what} within {within} s in ROS domain {domain} over {}", node.backend_name());
    let mut names: Vec<&str> = seen
        .others
        .iter()
        .map(String::as_str)
        .chain(seen.shown.keys().map(|(_, skin)| skin.as_str()))
        .collect();
    names.sort_unstable();
    names.dedup();
    if !names.is_empty() {
        return format!("{sentence}; there are {}", names.join(", "));
    }
    if !listened.is_empty() {
        let topics: Vec<&str> = listened.keys().map(String::as_str).collect();
        return format!(
            "{sentence}: {} is published, but no message comes; look at the node's log and at /diagnostics",
            topics.join(", ")
        );
    }
    format!(
        "{sentence}; check that its node runs, that ROS_DOMAIN_ID is the same for both, that both may use the same network \
         (docs/network.md), and that both speak through the same ROS 2 implementation (`--backend`)"
    )
}

/// Tares of skins as they appear.
struct Tares {
    commander: Commander,
    node: Node,
    done: Vec<Key>,
    refused: Vec<String>,
}

impl Tares {
    fn new(node: &Node) -> Self {
        Self { commander: Commander::new(node), node: node.clone(), done: Vec::new(), refused: Vec::new() }
    }

    /// Tares those that are new, one after the other, and says how it went.
    async fn of(&mut self, skins: &[Key]) {
        for key in skins {
            if self.done.contains(key) {
                continue;
            }
            self.done.push(key.clone());
            let (topic, skin) = key;
            // The graph may know the topic a little before its node.
            let looked = tokio::time::Instant::now();
            while node_of(&self.node, topic, skin).is_err() && looked.elapsed() < Duration::from_secs(2) {
                tokio::time::sleep(DRAW).await;
            }
            let answer = self.commander.tell(topic, skin, &Command::Tare).await;
            // The table is on standard output.
            eprintln!("{skin}: {}", answer.message);
            if !answer.success {
                self.refused.push(skin.clone());
            }
        }
    }

    fn end(self) -> Result<()> {
        if !self.refused.is_empty() {
            bail!("{} was not tared", self.refused.join(", "));
        }
        Ok(())
    }
}

/// All that is shown, for programs.
fn object(node: &Node, seen: &Seen) -> Value {
    let now = dermis_transport::now_ns();
    let skins: Vec<Value> = seen
        .shown
        .iter()
        .map(|((topic, skin), felt)| {
            let latest = felt.latest.as_ref().map(Message::to_cdr);
            let array = latest.and_then(|bytes| (TypeSupport::of::<ContactArray>().cdr_to_json)(&bytes).ok());
            json!({
                "skin": skin,
                "topic": topic,
                "node": node_of(node, topic, skin).ok(),
                "rate_hz": felt.recent_rate(),
                "latency_ms": { "p50": felt.latency_ms.percentile(50.0), "p99": felt.latency_ms.percentile(99.0) },
                "silent_s": felt.silent(now),
                "arrays": felt.arrays,
                "touched": felt.touched,
                "latest": array,
            })
        })
        .collect();
    json!({ "domain": node.domain_id(), "skins": skins })
}

fn print(value: &Value) -> std::io::Result<()> {
    use std::io::Write;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{value}")?;
    out.flush()
}

fn lock(seen: &Mutex<Seen>) -> MutexGuard<'_, Seen> {
    seen.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(skins: &[&str]) -> Options {
        Options {
            skins: skins.iter().map(|s| (*s).to_owned()).collect(),
            tare: false,
            json: false,
            duration: None,
            within: Duration::from_secs(1),
            network: NetworkArguments::default(),
            backend: Choice::Hiroz,
        }
    }

    fn array(skin: &str) -> ContactArray {
        ContactArray { skin: skin.to_owned(), ..ContactArray::default() }
    }

    #[test]
    fn skins_are_told_apart_by_topic_and_name() {
        let mut seen = Seen::default();
        for (topic, skin) in [
            ("/left/contacts", "pad"),
            ("/right/contacts", "pad"),
            ("/contacts", "pad"),
            ("/contacts", "tip"),
        ] {
            seen.take(topic, &[], array(skin), 1);
            seen.take(topic, &[], array(skin), 2);
        }
        let now = 2;
        let titles: Vec<String> = seen
            .shown
            .values()
            .map(|f| f.lines(0.0, now)[0].split("   ").next().unwrap().to_owned())
            .collect();
        assert_eq!(titles, ["pad (/contacts)", "tip", "pad (/left/contacts)", "pad (/right/contacts)"]);
        assert!(seen.shown.values().all(|f| f.arrays == 2));
        assert!(missing(&options(&[]), &seen).is_empty());
        assert_eq!(missing(&options(&["tip", "toe"]), &seen), ["toe"]);
    }

    #[test]
    fn what_was_not_asked_for_is_remembered_by_name_only() {
        let mut seen = Seen::default();
        let wanted = ["tip".to_owned()];
        for _ in 0..3 {
            seen.take("/contacts", &wanted, array("pad"), 1);
        }
        assert!(seen.shown.is_empty());
        assert_eq!(seen.others, ["pad"]);
        assert_eq!(missing(&options(&[]), &seen), [""]);
    }
}
