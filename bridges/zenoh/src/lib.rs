//! Everything that skins publish, for clients that know no ROS: JSON over zenoh.
//!
//! | key | value |
//! |---|---|
//! | `dermis/<robot>/<skin>/contacts` | `dermis_msgs/msg/ContactArray` as JSON, at every frame |
//! | `dermis/<robot>/<skin>/taxels` | `dermis_msgs/msg/TaxelFrame` with two more fields, `unit` and `channels`, once the skin's geometry has arrived |
//! | `dermis/<robot>/<skin>/force_map`, `displacement_map`, `skin_geometry`, … | the other topics of the skin, under the last part of their name |
//! | `dermis/<robot>/schemas/<pkg>/msg/<Type>` | text of the message definition |
//! | `dermis/<robot>/<skin>/tare`, `set_enabled`, `load_model` | commands: queries that the skin's node answers, as `{"success": …, "message": …}` |
//!
//! `<robot>` is the robot's name in ROS domain 0, and `<name>@<domain>` in any other: two domains on one host have keys of
//! their own, and a client of `dermis/left_arm/**` hears domain 0 alone. `dermis/*/**` hears all.
//!
//! The session reaches as far as `BridgeConfig::network` says: programs of this machine, unless somebody requested more.
//!
//! Every key answers a `get` with the latest value (so a late client sees the geometry at once), and values carry
//! the encoding `application/json`. A liveliness token stands on `dermis/<robot>/<skin>` while the skin's topics
//! exist. NaN becomes `null`, because JSON has no NaN.
//!
//! `<skin>` is the name of the device (`instance` of its node), not of its type. Two devices that claim one name are distinguished
//! by the namespaces of their topics, and never share a key.
//!
//! The bridge finds skins by itself: whatever is published in the ROS domain with a type of `dermis_msgs` that names
//! its skin is bridged. A message is decoded only here, once, from the bytes that ROS 2 clients get.
//!
//! ```no_run
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! use dermis_bridge_zenoh::{Bridge, BridgeConfig};
//! use dermis_node::{HirozBackend, Node, NodeOptions};
//!
//! let node = Node::open(NodeOptions::new("zenoh_bridge"), &HirozBackend::default())?;
//! let bridge = Bridge::open(&node, BridgeConfig { robot: "left_arm".into(), ..BridgeConfig::default() }).await?;
//! node.wait_for_shutdown().await?;
//! bridge.close().await;
//! # Ok(())
//! # }
//! ```

mod claims;
mod queries;

/// Commands to a skin, which queries are sent on as.
pub use dermis_perception::remote as commands;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use dermis_msgs::msg::{ContactArray, SkinGeometry, TaxelFrame};
use dermis_msgs::{ChannelLayout, Message, OF_A_SKIN, TypeSupport, type_support};
use dermis_node::network::SessionOptions;
use dermis_node::{Network, NetworkChoice, Node, Qos, Subscription};
use tokio::task::JoinHandle;
use tracing::{info, warn};
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::{Session, Wait};

use crate::claims::{Claims, Publisher, Verdict, last_part};
use crate::commands::Commander;
use crate::queries::Offered;

/// How often the ROS graph is inspected for new skins.
const LOOK_AROUND: Duration = Duration::from_millis(500);

/// Where the bridge appears.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BridgeConfig {
    /// Second part of every key: one word that tells this robot from others on the network.
    pub robot: String,
    /// `peer` (default: finds others on the network by itself) or `client` (talks through a router).
    pub mode: String,
    /// Endpoints to connect to, e.g. `tcp/192.0.2.1:7447`; a client needs at least one.
    pub connect: Vec<String>,
    /// Endpoints to listen on, e.g. `tcp/0.0.0.0:7448`; a free port where empty.
    pub listen: Vec<String>,
    /// How far it reaches; the environment decides where nothing is chosen.
    pub network: NetworkChoice,
    /// Offer no commands.
    pub read_only: bool,
}

impl Default for BridgeConfig {
    fn default() -> Self {
        Self {
            robot: "robot".to_owned(),
            mode: "peer".to_owned(),
            connect: Vec::new(),
            listen: Vec::new(),
            network: NetworkChoice::default(),
            read_only: false,
        }
    }
}

/// Why the bridge cannot run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BridgeError {
    /// A configured value cannot be.
    #[error("bridge: field `{field}`: {reason}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// What is wrong, and what would be right.
        reason: String,
    },
    /// The zenoh session does not open.
    #[error("bridge: zenoh session: {reason}; check `connect` and `listen`")]
    Session {
        /// What zenoh said.
        reason: String,
    },
    /// The ROS side fails.
    #[error("bridge: {0}")]
    Node(#[from] dermis_node::NodeError),
}

/// A running bridge; closes when dropped.
pub struct Bridge {
    session: Session,
    open_to: String,
    task: Option<JoinHandle<()>>,
}

impl Bridge {
    /// Opens a zenoh session and starts to bridge every skin in the domain of `node`.
    ///
    /// # Errors
    ///
    /// [`BridgeError::Config`] for a value that cannot be, [`BridgeError::Session`] where zenoh refuses.
    pub async fn open(node: &Node, config: BridgeConfig) -> Result<Self, BridgeError> {
        let refused = |reason: String| BridgeError::Session { reason };
        let network = config.network.resolve()?;
        let wanted = session_config(&config, &network)?;
        let session = zenoh::open(wanted.clone()).await.map_err(|e| refused(e.to_string()))?;
        let prefix = prefix(&config.robot, node.domain_id());
        let (opened, keys) = (session.clone(), format!("{prefix}/**"));
        // zenoh must not be waited for on a thread of this runtime.
        let open_to = tokio::task::spawn_blocking(move || network.opened(&opened, &wanted))
            .await
            .map_err(|e| refused(e.to_string()))?;
        let open_to = format!("bridge {keys}: {open_to}");
        info!("{open_to}");
        let shared = Arc::new(Shared {
            prefix,
            session: session.clone(),
            claims: Mutex::default(),
            commander: (!config.read_only).then(|| Arc::new(Commander::new(node))),
            runtime: tokio::runtime::Handle::current(),
            skins: Mutex::default(),
            latest: Arc::default(),
            layouts: Mutex::default(),
        });
        serve_latest(&shared).map_err(|e| BridgeError::Session { reason: e.to_string() })?;
        let node = node.clone();
        let task = tokio::spawn(async move {
            let mut bridged: BTreeMap<(String, String), Subscription> = BTreeMap::new();
            let mut ticks = tokio::time::interval(LOOK_AROUND);
            loop {
                ticks.tick().await;
                look_around(&node, &shared, &mut bridged);
            }
        });
        Ok(Self { session, open_to, task: Some(task) })
    }

    /// Its keys, what they are open to and to whom, in one sentence for people; the log has it too, at level info.
    #[must_use]
    pub fn open_to(&self) -> &str {
        &self.open_to
    }

    /// Withdraws all keys and closes the session.
    pub async fn close(mut self) {
        if let Some(task) = self.task.take() {
            task.abort();
            // Its end drops the subscriptions: nothing is forwarded into a session that closes. That it was aborted is
            // no news.
            let _ = task.await;
        }
        if let Err(e) = self.session.close().await {
            warn!("bridge: zenoh session did not close: {e}");
        }
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        if let Some(task) = self.task.take() {
            task.abort();
        }
    }
}

/// What the callbacks of all topics share.
struct Shared {
    prefix: String,
    session: Session,
    claims: Mutex<Claims>,
    /// Who sends commands on; none where the bridge only shows.
    commander: Option<Arc<Commander>>,
    runtime: tokio::runtime::Handle,
    skins: Mutex<BTreeMap<String, Presence>>,
    latest: Arc<Mutex<BTreeMap<String, String>>>,
    /// Unit and channels by the number that frames carry.
    layouts: Mutex<Layouts>,
}

/// `unit` and `channels` of frames as JSON, by [`ChannelLayout::id`]. Frames carry the number only; clients of the bridge shall not
/// have to look names up.
type Layouts = BTreeMap<u32, (serde_json::Value, serde_json::Value)>;

/// Keeps what a geometry says of channels.
fn learn_layout(layouts: &mut Layouts, geometry: &serde_json::Value) {
    let names = geometry["channels"].as_array().into_iter().flatten();
    let names = names.filter_map(serde_json::Value::as_str);
    let unit = geometry["unit"].as_str().unwrap_or_default();
    let id = ChannelLayout::id_of(unit, names);
    // Another number would give names to frames of others.
    if geometry["layout_id"].as_u64() == Some(u64::from(id)) {
        layouts.entry(id).or_insert_with(|| (geometry["unit"].clone(), geometry["channels"].clone()));
    }
}

/// Adds unit and channel names to a frame, where they are known.
fn name_channels(layouts: &Layouts, frame: &mut serde_json::Value) {
    let id = frame["layout_id"].as_u64().and_then(|id| u32::try_from(id).ok());
    if let Some((unit, channels)) = id.and_then(|id| layouts.get(&id)) {
        frame["unit"] = unit.clone();
        frame["channels"] = channels.clone();
    }
}

/// A skin that is there, and the topics it is known by.
struct Presence {
    topics: BTreeSet<String>,
    _token: LivelinessToken,
    /// From the first contacts on.
    commands: Option<Offered>,
}

/// What all keys begin with.
fn prefix(robot: &str, domain: u16) -> String {
    match domain {
        0 => format!("dermis/{robot}"),
        domain => format!("dermis/{robot}@{domain}"),
    }
}

fn session_config(config: &BridgeConfig, network: &Network) -> Result<zenoh::Config, BridgeError> {
    let wrong = |field, reason| BridgeError::Config { field, reason };
    if config.robot.is_empty()
        || !config.robot.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
    {
        return Err(wrong(
            "robot",
            format!("\"{}\" must be one word of letters, digits, `-`, `_` and `.`", config.robot),
        ));
    }
    if !["peer", "client"].contains(&config.mode.as_str()) {
        return Err(wrong("mode", format!("is \"{}\" and must be \"peer\" or \"client\"", config.mode)));
    }
    if config.mode == "client" && config.connect.is_empty() {
        return Err(wrong(
            "connect",
            "is empty: a client needs the endpoint of a router, e.g. \"tcp/192.0.2.1:7447\"".into(),
        ));
    }
    // An endpoint that zenoh cannot read is found here, where the field is known.
    let mut checked = zenoh::Config::default();
    for (field, key, endpoints) in
        [("connect", "connect/endpoints", &config.connect), ("listen", "listen/endpoints", &config.listen)]
    {
        let value = serde_json::json!(endpoints).to_string();
        checked.insert_json5(key, &value).map_err(|e| wrong(field, e.to_string()))?;
    }
    let options = SessionOptions {
        mode: config.mode.clone(),
        connect: config.connect.clone(),
        listen: config.listen.clone(),
        local_router: false,
        ..SessionOptions::default()
    };
    network.session(&options).map_err(|reason| wrong("network", reason))
}

/// Answers `get` on every key with the latest value, and on the schema keys with the definitions.
fn serve_latest(shared: &Arc<Shared>) -> zenoh::Result<()> {
    let latest = Arc::clone(&shared.latest);
    let schemas = format!("{}/schemas/", shared.prefix);
    for name in OF_A_SKIN {
        if let Some(support) = type_support(name) {
            lock(&latest).insert(format!("{schemas}{name}"), support.definition.to_owned());
        }
    }
    let queryable = shared.session.declare_queryable(format!("{}/**", shared.prefix));
    queryable
        .callback(move |query| {
            let matching: Vec<(String, String)> = lock(&latest)
                .iter()
                .filter(|(key, _)| {
                    zenoh::key_expr::KeyExpr::try_from(key.as_str())
                        .is_ok_and(|k| query.key_expr().intersects(&k))
                })
                .map(|(k, v)| (k.clone(), v.clone()))
                .collect();
            for (key, value) in matching {
                let encoding =
                    if key.starts_with(&schemas) { Encoding::TEXT_PLAIN } else { Encoding::APPLICATION_JSON };
                if let Err(e) = query.reply(&key, value).encoding(encoding).wait() {
                    warn!("bridge: get on {key} was not answered: {e}");
                }
            }
        })
        .background()
        .wait()
}

/// Subscribes to topics that appeared, lets go of those that went.
fn look_around(node: &Node, shared: &Arc<Shared>, bridged: &mut BTreeMap<(String, String), Subscription>) {
    let topics = match node.topics() {
        Ok(topics) => topics,
        Err(e) => {
            warn!("bridge: the ROS graph cannot be read: {e}");
            return;
        }
    };
    let wanted: BTreeSet<(String, String)> =
        topics.into_iter().filter(|(_, kind)| OF_A_SKIN.contains(&kind.as_str())).collect();
    bridged.retain(|key, _| {
        let stays = wanted.contains(key);
        if !stays {
            info!("bridge: {} went away", key.0);
            forget(shared, &key.0);
        }
        stays
    });
    for (topic, kind) in wanted {
        if bridged.contains_key(&(topic.clone(), kind.clone())) {
            continue;
        }
        let Some(support) = type_support(&kind) else { continue };
        // Geometry is latched; everything else is a stream, where the newest counts.
        let qos = if kind == SkinGeometry::TYPE_NAME { Qos::latched() } else { Qos::sensor_data() };
        let (callback_shared, callback_topic) = (Arc::clone(shared), topic.clone());
        let subscribed = node.subscribe_raw(&topic, support, qos, move |bytes, _| {
            forward(&callback_shared, &callback_topic, support, bytes, None);
        });
        match subscribed {
            Ok(subscription) => {
                info!("bridge: {topic} [{kind}]");
                bridged.insert((topic, kind), subscription);
            }
            Err(e) => warn!("bridge: {topic} is not bridged: {e}"),
        }
    }
}

fn forward(shared: &Shared, topic: &str, support: &TypeSupport, bytes: &[u8], publisher: Publisher) {
    let mut value = match (support.cdr_to_json)(bytes) {
        Ok(value) => value,
        Err(e) => {
            warn!("bridge: a message on {topic} is dropped: {e}");
            return;
        }
    };
    let Some(skin) = value.get("skin").and_then(|s| s.as_str()).and_then(key_word) else {
        warn!(
            "bridge: a message on {topic} is dropped: its field `skin` is empty or cannot be part of a key"
        );
        return;
    };
    match support.name {
        SkinGeometry::TYPE_NAME => learn_layout(&mut lock(&shared.layouts), &value),
        TaxelFrame::TYPE_NAME => name_channels(&lock(&shared.layouts), &mut value),
        _ => {}
    }
    let text = value.to_string();
    // Held to the end, so that nothing goes out under a name whose keys have moved in between.
    let mut claims = lock(&shared.claims);
    let Some(skin) = claim(shared, &mut claims, &skin, topic, publisher) else { return };
    if let (Some(hash), Some(frame_id)) = (value["skin_hash"].as_str(), value["header"]["frame_id"].as_str())
        && let Some(warning) = claims.place(&skin, frame_id, hash)
    {
        warn!("bridge: {warning}");
    }
    announce(shared, &skin, topic);
    if support.name == ContactArray::TYPE_NAME {
        offer_commands(shared, &skin, topic);
    }
    put(shared, &skin, topic, text);
}

/// Sends a value, and keeps it for who asks later.
fn put(shared: &Shared, skin: &str, topic: &str, text: String) {
    let key = format!("{}/{skin}/{}", shared.prefix, last_part(topic));
    let sent = shared
        .session
        .put(&key, text.clone())
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(zenoh::qos::CongestionControl::Drop)
        .wait();
    if let Err(e) = sent {
        warn!("bridge: {key} was not sent: {e}");
    }
    lock(&shared.latest).insert(key, text);
}

/// The name under which a message is sent; `None` where it would be mixed with those of another device.
fn claim(
    shared: &Shared,
    claims: &mut Claims,
    skin: &str,
    topic: &str,
    publisher: Publisher,
) -> Option<String> {
    match claims.claim(skin, topic, publisher, Instant::now()) {
        Verdict::As(name) => Some(name),
        Verdict::Refused(warning) => {
            if let Some(warning) = warning {
                warn!("bridge: {warning}");
            }
            None
        }
        Verdict::Moved { name, from, to, warning } => {
            warn!("bridge: {warning}");
            lock(&shared.skins).remove(&from);
            for (topic, to) in to {
                let old = format!("{}/{from}/{}", shared.prefix, last_part(&topic));
                announce(shared, &to, &topic);
                let latest = lock(&shared.latest).remove(&old);
                if let Some(text) = latest {
                    put(shared, &to, &topic, text);
                }
            }
            Some(name)
        }
    }
}

/// Puts up the liveliness token of a skin when its first topic speaks.
fn announce(shared: &Shared, skin: &str, topic: &str) {
    let mut skins = lock(&shared.skins);
    if let Some(presence) = skins.get_mut(skin) {
        if !presence.topics.contains(topic) {
            presence.topics.insert(topic.to_owned());
        }
        return;
    }
    match shared.session.liveliness().declare_token(format!("{}/{skin}", shared.prefix)).wait() {
        Ok(token) => {
            info!("bridge: skin {skin} is there");
            skins.insert(
                skin.to_owned(),
                Presence { topics: BTreeSet::from([topic.to_owned()]), _token: token, commands: None },
            );
        }
        Err(e) => warn!("bridge: no liveliness token for {skin}: {e}"),
    }
}

/// Offers the commands of a skin when its contacts tell which node is its own.
fn offer_commands(shared: &Shared, skin: &str, topic: &str) {
    let Some(commander) = &shared.commander else { return };
    let mut skins = lock(&shared.skins);
    let Some(presence) = skins.get_mut(skin).filter(|p| p.commands.is_none()) else { return };
    let key = format!("{}/{skin}", shared.prefix);
    match queries::offer(&shared.session, commander, &shared.runtime, &key, topic, skin) {
        Ok(offered) => presence.commands = Some(offered),
        Err(e) => warn!("bridge: no commands for {skin}: {e}"),
    }
}

/// Takes down what a topic that went away had put up.
fn forget(shared: &Shared, topic: &str) {
    lock(&shared.claims).release(topic);
    lock(&shared.skins).retain(|skin, presence| {
        if presence.topics.remove(topic) {
            lock(&shared.latest).remove(&format!("{}/{skin}/{}", shared.prefix, last_part(topic)));
        }
        !presence.topics.is_empty()
    });
}

/// A skin's name as one part of a zenoh key; `None` where it cannot be.
fn key_word(name: &str) -> Option<String> {
    (!name.is_empty() && !name.contains(['/', '*', '$', '?', '#'])).then(|| name.to_owned())
}

/// A panic of another callback leaves the maps usable: each entry is replaced as a whole.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
