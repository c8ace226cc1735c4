//! The node: messages of skins and joints in, what the body feels out.
//!
//! A report is worked in by the thread that brings it. An answer is made after each report (at most `max_rate` a second), or at the configured
//! rate, and every 0.1 s in any case: silence of this node is never to be taken for "no touch". What nobody listens to is not made.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dermis_body::{HistoryLimits, Robot};
use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::msg::{BodyContacts, ContactArray};
use dermis_msgs::sensor_msgs::msg::{JointState, PointCloud2};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::visualization_msgs::msg::MarkerArray;
use dermis_node::{
    Backend, Node, NodeError, NodeOptions, ParameterDescriptor, Publisher, Qos, Status, Subscription, Timer,
    parse_remapping,
};

use crate::config::{Config, Transforms};
use crate::fuser::{BodyState, Fuser, contacts_topic};
use crate::intake::WAITING;
use crate::maps::Maps;
use crate::messages;
use crate::settings::{BIRTHS, FIELDS};
use crate::torque::JointValues;

pub use error::RunError;

mod diagnostics;
mod error;
mod maps;

/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them.
const KEPT: usize = 10;
/// Periods of `max_rate` after which a report that came too soon after an answer has its own.
const TRAILING: u32 = 2;
/// Longest time between two answers.
const HEARTBEAT: Duration = Duration::from_millis(100);
/// Shortest time between two marker messages: viewers draw 30 times a second.
const MARKER_PERIOD: Duration = Duration::from_millis(33);
/// Shortest time between two clouds of force maps.
const MAP_PERIOD: Duration = Duration::from_millis(33);
/// \[s\] after which arrows vanish that nobody renews.
const MARKER_LIFE: f64 = 0.3;
/// \[Hz\] fastest `rate`.
const MOST_RATE: f64 = 1000.0;
/// \[Hz\] what `max_rate` may be: slower than the heartbeat it would say nothing.
const MAX_RATES: std::ops::RangeInclusive<f64> = 10.0..=10_000.0;

/// One for each topic.
struct Publishers {
    contacts: Publisher<BodyContacts>,
    /// By link.
    links: BTreeMap<usize, Publisher<WrenchStamped>>,
    net: Publisher<WrenchStamped>,
    torques: Publisher<JointState>,
    points: Publisher<PointCloud2>,
    maps: Publisher<PointCloud2>,
    markers: Publisher<MarkerArray>,
    moving: Option<Publisher<TFMessage>>,
    fixed: Option<Publisher<TFMessage>>,
}

struct Core {
    fuser: Fuser,
    publishers: Publishers,
    sequence: u64,
    answered: Option<Instant>,
    /// Whether a report has come since the last answer.
    pending: bool,
    markers_sent: Option<Instant>,
    arrows: bool,
    maps: Maps,
    maps_sent: Option<Instant>,
    /// Why the last map of a skin was refused.
    maps_refused: Option<(String, Instant)>,
    /// What was last wrong with each skin.
    texts: Vec<String>,
    joints_text: String,
    /// Why the last joint state was refused.
    joints_refused: Option<(String, Instant)>,
    last: Option<BodyState>,
    /// Answers and their delay \[ns\] since the last diagnostics.
    answers: (u64, i64),
}

struct Shared {
    node: Node,
    robot: Robot,
    transforms: Transforms,
    limits: HistoryLimits,
    /// Shortest time between two answers to reports; none where answers come at a rate of their own.
    eager: Option<Duration>,
    active: AtomicBool,
    core: Mutex<Core>,
    /// Subscriptions of the skins' maps, while somebody listens to what is made of them.
    map_subscriptions: Mutex<Vec<Subscription>>,
}

/// A running node; dropping it stops it.
///
/// Topics, relative to its namespace: `body_contacts`, `net_wrench`, `joint_torques`, `contact_points`, `contact_markers`, `force_points` and,
/// for each link with skins, `links/<link>/wrench`; `/tf_static` and, where the configuration says so, `/tf`. It subscribes `contacts` in
/// the namespace of each skin of the robot file, and `/joint_states`; `skin_geometry` and `force_map` of the skins while somebody
/// subscribes `force_points`.
pub struct FusionNode {
    shared: Arc<Shared>,
    _subscriptions: Vec<Subscription>,
    _timer: Timer,
}

/// Part of a topic's name: a link may have characters that a topic may not.
fn topic_part(link: &str) -> String {
    let part: String = link.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if part.starts_with(|c: char| c.is_ascii_digit()) { format!("_{part}") } else { part }
}

impl FusionNode {
    /// Starts a node.
    ///
    /// # Errors
    ///
    /// [`RunError`] says in one sentence what is wrong: file and field, and what to do.
    pub fn start(config: &Config, backend: &dyn Backend) -> Result<Self, RunError> {
        let robot = Robot::load(&config.robot)?;
        if robot.skins.is_empty() {
            return Err(RunError::NoSkins { path: config.robot.clone() });
        }
        if !(0.0..=MOST_RATE).contains(&config.rate) {
            return Err(RunError::Rate { rate: config.rate });
        }
        if !MAX_RATES.contains(&config.max_rate) {
            return Err(RunError::MaxRate { rate: config.max_rate });
        }
        let eager = (config.rate == 0.0).then(|| Duration::from_secs_f64(1.0 / config.max_rate));
        let limits = config.joint_states;
        let mut fuser =
            Fuser::new(robot.clone(), config.settings, limits, &config.expected, &config.self_contact)?;
        if let Some(torques) = &config.torques {
            fuser.report_unknown(torques)?;
        }
        if config.assume_rest {
            fuser.assume_rest();
        }
        let node = Node::open(options(config)?, backend)?;
        declare(&node, config)?;
        let publishers = Publishers::new(&node, &robot, config.transforms)?;
        let (skins, robot_of_maps) = (robot.skins.len(), robot.clone());
        let shared = Arc::new(Shared {
            node: node.clone(),
            robot,
            transforms: config.transforms,
            limits,
            eager,
            active: AtomicBool::new(false),
            core: Mutex::new(Core {
                fuser,
                publishers,
                sequence: 0,
                answered: None,
                pending: false,
                markers_sent: None,
                arrows: false,
                maps: Maps::new(&robot_of_maps),
                maps_sent: None,
                maps_refused: None,
                texts: vec![String::new(); skins],
                joints_text: String::new(),
                joints_refused: None,
                last: None,
                answers: (0, 0),
            }),
            map_subscriptions: Mutex::default(),
        });
        shared.take_parameters();
        shared.follow();
        let subscriptions = shared.subscribe()?;
        let ticking = Arc::downgrade(&shared);
        let period =
            eager.map_or_else(|| Duration::from_secs_f64(1.0 / config.rate), |least| least * TRAILING);
        let timer = node.timer(period.min(HEARTBEAT), move || {
            if let Some(shared) = ticking.upgrade() {
                shared.tick();
            }
        });
        let running = Self { shared, _subscriptions: subscriptions, _timer: timer };
        let shared = Arc::downgrade(&running.shared);
        running.shared.node.work_while_active(config.autostart, move |active| {
            if let Some(shared) = shared.upgrade() {
                shared.lock().fuser.reset(shared.limits);
                shared.active.store(active, Ordering::Release);
                if active {
                    shared.publish_fixed();
                }
            }
        })?;
        Ok(running)
    }

    /// The ROS node: names, parameters, lifecycle, clock.
    #[must_use]
    pub fn node(&self) -> &Node {
        &self.shared.node
    }
}

impl Drop for FusionNode {
    fn drop(&mut self) {
        self.shared.node.shutdown();
    }
}

fn options(config: &Config) -> Result<NodeOptions, RunError> {
    let mut options =
        NodeOptions::new(&config.name).namespace(&config.namespace).use_sim_time(config.use_sim_time);
    options.domain_id = config.domain_id;
    options.network = config.network.clone();
    options.parameters.clone_from(&config.parameters);
    for rule in &config.remap {
        let (from, to) = parse_remapping(rule)?;
        options = options.remap(from, to);
    }
    Ok(options)
}

/// Declares how the node was configured, and the assumptions that can be changed while it runs.
fn declare(node: &Node, config: &Config) -> Result<(), RunError> {
    let parameters = node.parameters();
    let fixed = |text: &str| ParameterDescriptor::new(text).read_only();
    parameters.declare("robot", config.robot.display().to_string(), fixed("robot file"))?;
    parameters.declare("rate", config.rate, fixed("[Hz] of answers; 0: one for each report"))?;
    parameters.declare("max_rate", config.max_rate, fixed("[Hz] of answers to reports, at most"))?;
    for field in FIELDS {
        let descriptor = ParameterDescriptor::new(field.about).float_range(field.least, field.most);
        parameters.declare(field.name, (field.get)(&config.settings), descriptor)?;
    }
    let (least, most) = BIRTHS;
    let births = ParameterDescriptor::new("reports that have to feel a contact before it is one")
        .integer_range(i64::from(least), i64::from(most));
    parameters.declare("births", config.settings.births, births)?;
    let unused = parameters.unused_overrides();
    if !unused.is_empty() {
        let known = parameters.names().join(", ");
        return Err(RunError::UnknownParameter { names: unused.join("`, `"), known });
    }
    Ok(())
}

impl Publishers {
    fn new(node: &Node, robot: &Robot, transforms: Transforms) -> Result<Self, NodeError> {
        let mut links = BTreeMap::new();
        for skin in &robot.skins {
            if let Entry::Vacant(place) = links.entry(skin.link) {
                let topic = format!("links/{}/wrench", topic_part(&robot.body.links()[skin.link]));
                place.insert(node.stream_publisher(&topic, KEPT)?);
            }
        }
        let (fixed, moving) = (transforms != Transforms::Off, transforms == Transforms::Robot);
        Ok(Self {
            contacts: node.stream_publisher("body_contacts", KEPT)?,
            links,
            net: node.stream_publisher("net_wrench", KEPT)?,
            torques: node.stream_publisher("joint_torques", KEPT)?,
            points: node.stream_publisher("contact_points", KEPT)?,
            maps: node.stream_publisher("force_points", KEPT)?,
            markers: node.stream_publisher("contact_markers", KEPT)?,
            moving: moving.then(|| node.stream_publisher("/tf", KEPT)).transpose()?,
            fixed: fixed.then(|| node.publisher("/tf_static", Qos::latched())).transpose()?,
        })
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes over every parameter as it is now.
    fn take_parameters(&self) {
        let parameters = self.node.parameters();
        let mut core = self.lock();
        let mut settings = *core.fuser.settings();
        for field in FIELDS {
            if let Some(value) = parameters.get(field.name).and_then(|v| v.as_f64()) {
                (field.set)(&mut settings, value);
            }
        }
        let births = parameters.get("births").and_then(|v| v.as_i64());
        settings.births = births.and_then(|v| u32::try_from(v).ok()).unwrap_or(settings.births);
        if let Err(error) = core.fuser.set_settings(settings) {
            tracing::warn!("{error}");
        }
    }

    /// Follows parameters, the clock and diagnostics.
    fn follow(self: &Arc<Self>) {
        let shared = Arc::downgrade(self);
        self.node.parameters().on_changed(move |_, _| {
            if let Some(shared) = shared.upgrade() {
                shared.take_parameters();
            }
        });
        let shared = Arc::downgrade(self);
        self.node.clock().on_jump_back(move |_| {
            if let Some(shared) = shared.upgrade() {
                shared.lock().fuser.reset(shared.limits);
            }
        });
        let shared = Arc::downgrade(self);
        self.node.diagnostics().set_hardware_id(&self.robot.name);
        self.node.diagnostics().add("fusion", move || {
            shared.upgrade().map_or_else(|| Status::ok("stopped"), |shared| shared.diagnose())
        });
    }

    fn subscribe(self: &Arc<Self>) -> Result<Vec<Subscription>, NodeError> {
        let qos = Qos::sensor_data().with_depth(WAITING);
        let mut all = Vec::new();
        for (index, skin) in self.robot.skins.iter().enumerate() {
            let topic = contacts_topic(skin);
            let shared = Arc::downgrade(self);
            all.push(self.node.subscribe(&topic, qos, move |message: ContactArray, info| {
                if let Some(shared) = shared.upgrade() {
                    shared.report(index, &message, info.publication.map(|p| p.publisher));
                }
            })?);
        }
        let shared = Arc::downgrade(self);
        all.push(self.node.subscribe("/joint_states", qos, move |message: JointState, _| {
            if let Some(shared) = shared.upgrade() {
                shared.joints(&message);
            }
        })?);
        Ok(all)
    }

    /// A frame of a skin.
    fn report(&self, skin: usize, message: &ContactArray, publisher: Option<[u8; 16]>) {
        if !self.active.load(Ordering::Acquire) {
            return;
        }
        let now = self.node.clock().now();
        let mut core = self.lock();
        core.fuser.take(skin, message, publisher, now);
        core.pending = true;
        if let Some(least) = self.eager
            && core.answered.is_none_or(|at| at.elapsed() >= least)
        {
            self.answer(&mut core);
        }
    }

    /// Joint positions.
    fn joints(&self, message: &JointState) {
        if !self.active.load(Ordering::Acquire) {
            return;
        }
        let stamp = message.header.stamp.as_nanos();
        let mut core = self.lock();
        let values = JointValues {
            names: &message.name,
            positions: &message.position,
            velocities: &message.velocity,
            efforts: &message.effort,
        };
        if let Err(refused) = core.fuser.take_joint_values(stamp, &values) {
            let text = refused.to_string();
            if core.joints_refused.as_ref().is_none_or(|(before, _)| *before != text) {
                tracing::warn!("{text}");
            }
            core.joints_refused = Some((text, Instant::now()));
            return;
        }
        if let Some(moving) = &core.publishers.moving {
            moving.offer(|| {
                let joints = core.fuser.joints_at(stamp);
                let message = messages::moving_transforms(&self.robot, stamp, &joints.positions);
                (!message.transforms.is_empty()).then_some(message)
            });
        }
    }

    /// Answers at the configured rate, or what no report answered.
    fn tick(self: &Arc<Self>) {
        self.follow_maps();
        // With simulated time there is none before the first message of the clock.
        if !self.active.load(Ordering::Acquire) || self.node.clock().now() == 0 {
            return;
        }
        let mut core = self.lock();
        // Where reports are answered, those need an answer that came too soon after the last one, and their silence.
        let due = self.eager.is_none() || core.pending;
        // A timer ticks a little early or late.
        if due || core.answered.is_none_or(|at| at.elapsed() * 10 >= HEARTBEAT * 9) {
            self.answer(&mut core);
        }
    }

    /// Says what the body feels now.
    fn answer(&self, core: &mut Core) {
        let now = self.node.clock().now();
        let state = core.fuser.state(now);
        core.answered = Some(Instant::now());
        core.pending = false;
        core.sequence += 1;
        core.answers = (core.answers.0 + 1, core.answers.1.saturating_add(now.saturating_sub(state.stamp)));
        let (robot, publishers, sequence) = (&self.robot, &core.publishers, core.sequence);
        publishers.contacts.offer(|| Some(messages::body_contacts(robot, &state, sequence)));
        for load in &state.links {
            if let Some(publisher) = publishers.links.get(&load.link) {
                publisher.offer(|| messages::wrench_of_link(robot, state.stamp, load));
            }
        }
        publishers.net.offer(|| messages::net_wrench(robot, &state));
        publishers.torques.offer(|| messages::joint_torques(robot, &state));
        publishers.points.offer(|| messages::points(robot, &state));
        if !state.contacts.is_empty() {
            if core.markers_sent.is_none_or(|at| at.elapsed() >= MARKER_PERIOD) {
                core.markers_sent = Some(Instant::now());
                core.arrows = true;
                publishers.markers.offer(|| Some(messages::markers(robot, &state, MARKER_LIFE)));
            }
        } else if std::mem::take(&mut core.arrows) {
            publishers.markers.offer(|| Some(messages::no_markers(robot, state.stamp)));
        }
        if core.maps_sent.is_none_or(|at| at.elapsed() >= MAP_PERIOD) {
            core.maps_sent = Some(Instant::now());
            core.publishers.maps.offer(|| {
                let poses = robot.body.poses(&state.joints.positions);
                let feels: Vec<bool> = state.skins.iter().map(|s| s.health.feels()).collect();
                Some(core.maps.cloud(robot, &poses, state.stamp, &feels))
            });
        }
        self.log_changes(core, &state);
        core.last = Some(state);
    }

    /// What late subscribers get, too: frames that never move.
    fn publish_fixed(&self) {
        let fixed = self.lock().publishers.fixed.clone();
        let Some(fixed) = fixed else { return };
        let message = messages::static_transforms(
            &self.robot,
            self.node.clock().now(),
            self.transforms == Transforms::Robot,
        );
        // A peer that does not read can hold its publisher up for a minute.
        std::thread::spawn(move || {
            if let Err(error) = fixed.publish(&message) {
                tracing::debug!("{error}");
            }
        });
    }
}

#[cfg(test)]
mod tests;
