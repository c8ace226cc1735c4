//! Follows the contacts of running skins, whoever started them.
//!
//! Skins are found by the type of their contacts in the ROS graph, and distinguished by topic and name, because two nodes may
//! publish one topic.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dermis_msgs::msg::ContactArray;
use dermis_msgs::{Message, TypeSupport};
use dermis_node::{Backend, NetworkChoice, Node, NodeOptions, Qos, Subscription};
use dermis_perception::remote::{Command, Commander, node_of};
use serde::Serialize;
use serde_json::Value;

use crate::touch::Touch;
use crate::{LOOK, OperateError, Progress};

type Result<T, E = OperateError> = std::result::Result<T, E>;

/// Which skins, and how long.
#[derive(Debug, Clone)]
pub struct Request {
    /// Skins, by the name that their contacts carry; all that are there where none is given.
    pub skins: Vec<String>,
    /// Tare each of them first; nothing may touch them.
    pub tare: bool,
    /// End after this long; not by itself where absent.
    pub duration: Option<Duration>,
    /// How long to look for a skin before giving up.
    pub within: Duration,
    /// How far the network reaches.
    pub network: NetworkChoice,
}

/// Topic and name of a skin.
type Key = (String, String);

/// What came until now.
#[derive(Default)]
struct Seen {
    shown: BTreeMap<Key, Touch>,
    /// Names of skins that are there and were not requested.
    others: Vec<String>,
}

/// Topics of contacts that are listened to.
type Listened = BTreeMap<String, Subscription>;

/// What running skins feel now.
pub struct View<'a> {
    node: &'a Node,
    seen: &'a Seen,
    elapsed: Duration,
}

impl View<'_> {
    /// Since watching began.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.elapsed
    }

    /// The skins that were heard, by topic and name.
    pub fn skins(&self) -> impl Iterator<Item = &Touch> {
        self.seen.shown.values()
    }

    /// All of it, for programs.
    #[must_use]
    pub fn record(&self) -> Record {
        record(self.node, self.seen)
    }
}

/// Follows skins until `end`, or as long as requested, and hands what they feel to `show` several times a second.
///
/// # Errors
///
/// Where a skin that was requested is not heard in time or not tared, or `show` fails.
pub async fn watch(
    request: &Request,
    backend: &dyn Backend,
    end: impl Future<Output = ()>,
    progress: &dyn Progress,
    show: &mut dyn FnMut(&View<'_>) -> io::Result<()>,
) -> Result<()> {
    let name = format!("dermis_watch_{}", std::process::id());
    let node =
        Node::open(NodeOptions::new(name).network(request.network.clone()).diagnostics(false), backend)?;
    progress.note(&node.open_to());
    let seen = Arc::new(Mutex::new(Seen::default()));
    let done = follow(request, &node, &seen, end, progress, show).await;
    let closing = node.clone();
    // It waits for callbacks, which an asynchronous thread must not.
    tokio::task::spawn_blocking(move || closing.shutdown()).await.map_err(io::Error::from)?;
    done
}

async fn follow(
    request: &Request,
    node: &Node,
    seen: &Arc<Mutex<Seen>>,
    end: impl Future<Output = ()>,
    progress: &dyn Progress,
    show: &mut dyn FnMut(&View<'_>) -> io::Result<()>,
) -> Result<()> {
    let mut end = std::pin::pin!(end);
    let mut listened = Listened::new();
    let began = Instant::now();
    let mut tares = Tares::new(node, progress);
    loop {
        listen(request, node, seen, &mut listened)?;
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            () = &mut end => break,
        }
        let (missing, news) = {
            let seen = lock(seen);
            let news: Vec<Key> = seen.shown.keys().cloned().collect();
            (missing(request, &seen), news)
        };
        if !missing.is_empty() && began.elapsed() >= request.within {
            let why = nothing(request, node, &lock(seen), &missing, &listened);
            return Err(OperateError::NotHeard(why));
        }
        if request.tare {
            tares.of(&news).await;
        }
        show(&View { node, seen: &lock(seen), elapsed: began.elapsed() })?;
        if request.duration.is_some_and(|d| began.elapsed() >= d) {
            break;
        }
    }
    let missing = missing(request, &lock(seen));
    if !missing.is_empty() {
        let why = nothing(request, node, &lock(seen), &missing, &listened);
        return Err(OperateError::NotHeard(why));
    }
    tares.end()
}

/// Subscribes to contacts that are new in the graph, and lets go of those that went.
fn listen(request: &Request, node: &Node, seen: &Arc<Mutex<Seen>>, listened: &mut Listened) -> Result<()> {
    let topics = node.topics()?;
    let there =
        |topic: &str| topics.iter().any(|(name, kind)| name == topic && kind == ContactArray::TYPE_NAME);
    listened.retain(|topic, _| there(topic));
    for (topic, kind) in &topics {
        if kind != ContactArray::TYPE_NAME || listened.contains_key(topic) {
            continue;
        }
        let (sink, key, wanted) = (Arc::clone(seen), topic.clone(), request.skins.clone());
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
        if let Some(touch) = self.shown.get_mut(&key) {
            return touch.take(array, received_ns);
        }
        let mut touch = Touch::new(skin.as_str());
        touch.take(array, received_ns);
        self.shown.insert(key, touch);
        // Two devices of one name: the topic tells them apart.
        if self.shown.keys().filter(|(_, name)| *name == skin).count() > 1 {
            for ((topic, _), touch) in self.shown.iter_mut().filter(|((_, name), _)| *name == skin) {
                touch.rename(format!("{skin} ({topic})"));
            }
        }
    }
}

/// Skins that were requested and are not there: by name, or any.
fn missing(request: &Request, seen: &Seen) -> Vec<String> {
    if request.skins.is_empty() {
        return if seen.shown.is_empty() { vec![String::new()] } else { Vec::new() };
    }
    let there = |name: &str| seen.shown.keys().any(|(_, skin)| skin == name);
    request.skins.iter().filter(|name| !there(name)).cloned().collect()
}

/// Why there is nothing to show, and what to look at.
fn nothing(request: &Request, node: &Node, seen: &Seen, missing: &[String], listened: &Listened) -> String {
    let what = match missing {
        [one] if one.is_empty() => "no skin was heard".to_owned(),
        several => format!("skin `{}` was not heard", several.join("`, `")),
    };
    let within = request.duration.map_or(request.within, |d| d.min(request.within)).as_secs_f64();
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
struct Tares<'a> {
    commander: Commander,
    node: Node,
    progress: &'a dyn Progress,
    done: Vec<Key>,
    refused: Vec<String>,
}

impl<'a> Tares<'a> {
    fn new(node: &Node, progress: &'a dyn Progress) -> Self {
        Self {
            commander: Commander::new(node),
            node: node.clone(),
            progress,
            done: Vec::new(),
            refused: Vec::new(),
        }
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
                tokio::time::sleep(LOOK).await;
            }
            let answer = self.commander.tell(topic, skin, &Command::Tare).await;
            self.progress.note(&format!("{skin}: {}", answer.message));
            if !answer.success {
                self.refused.push(skin.clone());
            }
        }
    }

    fn end(self) -> Result<()> {
        if !self.refused.is_empty() {
            return Err(OperateError::NotTared(self.refused.join(", ")));
        }
        Ok(())
    }
}

/// What running skins feel, for programs.
#[derive(Debug, Clone, Serialize)]
pub struct Record {
    /// The ROS domain.
    pub domain: u16,
    /// The skins that were heard, by topic and name.
    pub skins: Vec<SkinRecord>,
}

/// What one skin feels.
#[derive(Debug, Clone, Serialize)]
pub struct SkinRecord {
    /// Its name.
    pub skin: String,
    /// Topic of its contacts.
    pub topic: String,
    /// The node that publishes them; `None` where the graph does not tell.
    pub node: Option<String>,
    /// \[1/s\] over the last seconds.
    pub rate_hz: f64,
    /// \[ms\] from acquisition to arrival.
    pub latency_ms: Latency,
    /// \[s\] since the last contact array.
    pub silent_s: f64,
    /// Contact arrays that came.
    pub arrays: u64,
    /// Those with a contact.
    pub touched: u64,
    /// The last one.
    pub latest: Option<Value>,
}

/// Percentiles of a latency.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Latency {
    /// The median.
    pub p50: f64,
    /// 99 % are no larger.
    pub p99: f64,
}

fn record(node: &Node, seen: &Seen) -> Record {
    let now = dermis_transport::now_ns();
    let of = |((topic, skin), touch): (&Key, &Touch)| {
        let latest = touch.latest.as_ref().map(Message::to_cdr);
        SkinRecord {
            skin: skin.clone(),
            topic: topic.clone(),
            node: node_of(node, topic, skin).ok(),
            rate_hz: touch.recent_rate(),
            latency_ms: Latency {
                p50: touch.latency_ms.percentile(50.0),
                p99: touch.latency_ms.percentile(99.0),
            },
            silent_s: touch.silent(now),
            arrays: touch.arrays,
            touched: touch.touched,
            latest: latest.and_then(|bytes| (TypeSupport::of::<ContactArray>().cdr_to_json)(&bytes).ok()),
        }
    };
    Record { domain: node.domain_id(), skins: seen.shown.iter().map(of).collect() }
}

fn lock(seen: &Mutex<Seen>) -> MutexGuard<'_, Seen> {
    seen.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(skins: &[&str]) -> Request {
        Request {
            skins: skins.iter().map(|s| (*s).to_owned()).collect(),
            tare: false,
            duration: None,
            within: Duration::from_secs(1),
            network: NetworkChoice::default(),
        }
    }

    fn array(skin: &str) -> ContactArray {
        ContactArray { skin: skin.to_owned(), ..ContactArray::default() }
    }

    #[test]
    fn skins_are_distinguished_by_topic_and_name() {
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
        let titles: Vec<&str> = seen.shown.values().map(Touch::name).collect();
        assert_eq!(titles, ["pad (/contacts)", "tip", "pad (/left/contacts)", "pad (/right/contacts)"]);
        assert!(seen.shown.values().all(|f| f.arrays == 2));
        assert!(missing(&request(&[]), &seen).is_empty());
        assert_eq!(missing(&request(&["tip", "toe"]), &seen), ["toe"]);
    }

    #[test]
    fn what_was_not_requested_is_remembered_by_name_only() {
        let mut seen = Seen::default();
        let wanted = ["tip".to_owned()];
        for _ in 0..3 {
            seen.take("/contacts", &wanted, array("pad"), 1);
        }
        assert!(seen.shown.is_empty());
        assert_eq!(seen.others, ["pad"]);
        assert_eq!(missing(&request(&[]), &seen), [""]);
    }
}
