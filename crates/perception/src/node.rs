//! The node: a source of bytes at one end, ROS topics at the other, one thread between them.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dermis_inference::{Bundle, Limits, Runtime, RuntimeError};
use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::msg::{ContactArray, DisplacementMap, ForceMap, SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::{Image, PointCloud2};
use dermis_msgs::srv::{LoadModel, LoadModelResponse};
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolResponse, Trigger, TriggerResponse};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::visualization_msgs::msg::MarkerArray;
use dermis_node::backend::BackendError;
use dermis_node::{
    Backend, Level, Node, NodeError, NodeOptions, ParameterDescriptor, ParameterValue, Parameters, Publisher,
    Qos, ServiceServer, State, Status, Transition, parse_remapping,
};
use dermis_skin::{
    ChannelFlags, Estimate, Estimator, Frame, InstanceError, ModelError, Mount, SkinDescription, SkinError,
    Surface, TareState,
};
use dermis_transport::{Event, Source, SourceOptions, SourceStats, SourceUrl, TransportError, now_ns};

use crate::commands::{Command, Commands};
use crate::config::Config;
use crate::folders;
use crate::messages::{
    blind_message, contacts_message, markers_message, no_markers_message, points_message, transform_message,
    wrench_message,
};
use dermis_estimate::{Maps, Models, Quality, SetupError, SkinEstimator};
use dermis_sensor::{Decoder, DecoderOptions, Sensor};
use kept_zero::KeptZero;
use loader::Loader;

mod kept_zero;
mod loader;

/// Longest wait for bytes, and so the longest time until a stop or a silence is noticed.
const TICK: Duration = Duration::from_millis(50);
/// How long a frame may wait, and at least so many periods of the skin, before it is passed over for the newest one; and how long
/// all that wait would take.
const LATE: (Duration, f64) = (Duration::from_millis(25), 2.0);
/// Events that are taken from a source in a row, before a frame is looked at.
const MOST_EVENTS: usize = 1024;
/// Weight of the last frame in the average of what frames take.
const PACE: f64 = 0.1;
/// Share of frames that may be passed over before diagnostics warn of it: any machine is busy elsewhere now and then.
const PASSED: f64 = 0.01;
/// Period at which a blind skin says that it is blind.
const BLIND_PERIOD: Duration = Duration::from_millis(500);
/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them.
const KEPT: usize = 10;
/// The same for maps, which are larger: some implementations of DDS wait where too many bytes are not confirmed.
const KEPT_MAPS: usize = 2;
/// Shortest time between two marker messages: viewers draw 30 times a second.
const MARKER_PERIOD: Duration = Duration::from_millis(33);
/// Shortest time between two warnings about a clock: a broken one jumps with every frame.
const JUMP_PERIOD: Duration = Duration::from_secs(10);
/// Shortest time between two log lines on one reason that a link is down.
const LINK_PERIOD: Duration = Duration::from_secs(60);
/// Shortest time between two log lines that a link is up.
const UP_PERIOD: Duration = Duration::from_secs(5);
/// \[s\] beyond its duration that a tare may take before its caller hears that it did not end.
const TARE_PATIENCE: f64 = 2.0;

/// Why the node does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The skin description cannot be used.
    #[error(transparent)]
    Skin(#[from] SkinError),
    /// The skin belongs to another node.
    #[error(
        "skin file {path}: field `sensor`: is \"{found}\", which this node does not read; it reads \"{expected}\""
    )]
    Sensor {
        /// Skin description file.
        path: PathBuf,
        /// Sensor family that it names.
        found: String,
        /// Sensor family of this node.
        expected: &'static str,
    },
    /// The device's name, coordinate frame or mount cannot be.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// What the sensor family reads of the skin description cannot be: its medium, or its wire.
    #[error("skin file {path}: field `{field}`: {reason}")]
    Medium {
        /// Skin description file.
        path: PathBuf,
        /// Path of the field.
        field: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// The source URL cannot be used.
    #[error(transparent)]
    Source(#[from] TransportError),
    /// A model or a masked channel does not fit.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A correction that nothing is corrected by.
    #[error(
        "`correction`: none of the models refines its answer on the forward model, which {path} corrects; leave it out, or \
         add `inversion` to a model with `dermis refine`"
    )]
    UnusedCorrection {
        /// File of the correction.
        path: PathBuf,
    },
    /// No runtime for models.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// ROS refused.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// A start value of a parameter that is no parameter value.
    #[error(
        "parameter `{name}`: {value} is no parameter value; give a truth value, a number, a text or a list of them"
    )]
    ParameterValue {
        /// Name of the parameter.
        name: String,
        /// The value as configured.
        value: String,
    },
    /// A start value of a parameter that the configuration decides.
    #[error(
        "parameter `{name}` follows from the configuration: write `{key}` there, and leave it out of `parameters`"
    )]
    FixedParameter {
        /// Name of the parameter.
        name: &'static str,
        /// Key of the configuration.
        key: &'static str,
    },
    /// Start values of parameters that this node does not have.
    #[error("parameter `{names}` is none of this node; its parameters are {known}")]
    UnknownParameter {
        /// Names as configured.
        names: String,
        /// Parameters that exist.
        known: String,
    },
    /// The system gave no thread.
    #[error("cannot start the thread of skin `{skin}`: {source}")]
    Thread {
        /// Name of the skin.
        skin: String,
        /// What the system said.
        source: std::io::Error,
    },
}

/// A running node; dropping it stops it.
///
/// Topics, relative to its namespace: `contacts`, `taxels`, `image` (of a skin that is read by a camera), `wrench`, `contact_points`, `contact_markers`,
/// `skin_geometry` (latched) and, where the models give them, `force_map` and `displacement_map`; where the configuration has a
/// `mount`, its transform on `/tf_static`. Services: `~/tare`, `~/set_enabled`,
/// `~/load_model`. `taxels` carries readings in the unit of the skin *before* tare, so that a recording of it is all
/// that training needs. `wrench`, `contact_points` and `contact_markers` fall silent while the skin is blind;
/// `contacts` goes on and says why.
pub struct SkinNode {
    node: Node,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    _services: Vec<ServiceServer>,
}

impl SkinNode {
    /// Starts a node.
    ///
    /// # Errors
    ///
    /// [`RunError`] says in one sentence what is wrong: file, field or channel, and what to do.
    pub fn start(
        sensor: &'static dyn Sensor,
        config: &Config,
        backend: &dyn Backend,
    ) -> Result<Self, RunError> {
        let (skin, url) = skin_and_source(sensor, config)?;
        // Joining the network takes half a second, in which the device can send already: a zero is found by then.
        let early = config.autostart.then(|| Source::open(url.clone(), SourceOptions::default()));
        let mut estimator = SkinEstimator::new(&skin, &config.masked)?;
        estimator.set_least_force(config.force_threshold);
        check_correction(config, &skin)?;
        let surface = skin.surface();
        let runtime = Runtime::load(&config.runtime)?;
        let loader = Loader::start(sensor, config, &skin, runtime, &mut estimator)?;

        let node = Node::open(options(config, &skin)?, backend)?;
        declare(node.parameters(), config, &skin, &mut estimator)?;
        // A recording that is started again is at its beginning.
        let live = !matches!(url, SourceUrl::Replay { .. });
        let folder = std::env::var_os(kept_zero::FOLDER).filter(|_| live).map(PathBuf::from);
        let kept_zero = KeptZero::new(folder.as_deref(), &node.full_name(), &skin);
        if let Some((zero, age)) = kept_zero.load(now_ns()) {
            let age = age.as_secs_f64();
            tracing::info!(
                "skin `{}`: goes on with its zero of {age:.1} s ago, before the restart",
                skin.name
            );
            estimator.set_zero(&zero);
        }
        let mut publishers = Publishers::new(&node, estimator.maps())?;
        if config.mount.is_some() {
            publishers.transform = transforms(&node, &skin)?;
        }
        let thread_error = |source| RunError::Thread { skin: skin.name.clone(), source };
        let slow = slow_lane().map_err(thread_error)?;
        let shared = Arc::new(Shared {
            sensor,
            device_time: config.device_time,
            mount: config.mount.clone(),
            correction: config.correction.clone(),
            skin: skin.clone(),
            surface,
            url,
            runtime,
            node: node.clone(),
            slow,
            commands: config.commands.clone(),
            model_limits: config.model_limits,
            model_folders: config
                .model_folders
                .clone()
                .unwrap_or_else(|| folders::of_bundles(&config.models)),
            kept_zero,
            core: Mutex::new(Core {
                reader: None,
                estimator,
                publishers,
                enabled: true,
                loading: loader.is_some(),
                sequence: 0,
                figures: Figures::default(),
                source: SourceStats::default(),
                refused: 0,
                blind: None,
                jumps: (0, None),
            }),
            progress: Condvar::new(),
            active: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        });
        shared.follow_parameters();
        let services = shared.serve()?;
        let watched = Arc::downgrade(&shared);
        node.diagnostics().set_hardware_id(&shared.skin.name);
        node.diagnostics().add("skin", move || {
            watched.upgrade().map_or_else(|| Status::ok("stopped"), |shared| shared.diagnose())
        });
        let worker = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name(format!("dermis-{}", sensor.name()))
            .spawn(move || worker.work(early))
            .map_err(thread_error)?;
        let running = Self { node, shared, thread: Some(thread), _services: services };
        running.manage(config.autostart)?;
        if let Some(loader) = loader {
            loader.hand_over(&running.shared, config.strict)?;
        }
        Ok(running)
    }

    fn manage(&self, autostart: bool) -> Result<(), NodeError> {
        let life = self.node.lifecycle()?;
        for (transition, active) in [(Transition::Activate, true), (Transition::Deactivate, false)] {
            let shared = Arc::downgrade(&self.shared);
            life.on(transition, move |_| {
                if let Some(shared) = shared.upgrade() {
                    shared.active.store(active, Ordering::Release);
                }
                Ok(())
            });
        }
        let node = self.node.clone();
        let shared = Arc::downgrade(&self.shared);
        life.on(Transition::Shutdown, move |_| {
            if let Some(shared) = shared.upgrade() {
                shared.stop.store(true, Ordering::Release);
            }
            // The node must not wait for the callback that asks it to end.
            let node = node.clone();
            std::thread::spawn(move || node.shutdown());
            Ok(())
        });
        if autostart {
            life.take(Transition::Configure)?;
            life.take(Transition::Activate)?;
        }
        Ok(())
    }

    /// The ROS node: names, parameters, lifecycle, clock.
    #[must_use]
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// The skin that it reads.
    #[must_use]
    pub fn skin(&self) -> &SkinDescription {
        &self.shared.skin
    }

    /// Its own diagnostics, now.
    #[must_use]
    pub fn diagnosis(&self) -> Status {
        self.shared.diagnose()
    }

    /// Stops reading and leaves the ROS graph.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of skin `{}` ended by a panic", self.shared.skin.name);
        } else {
            self.shared.kept_zero.forget();
        }
        self.node.shutdown();
    }
}

impl Drop for SkinNode {
    fn drop(&mut self) {
        self.end();
    }
}

fn options(config: &Config, skin: &SkinDescription) -> Result<NodeOptions, RunError> {
    let mut options = NodeOptions::new(config.node_name(skin))
        .namespace(&config.namespace)
        .use_sim_time(config.use_sim_time);
    options.parameters_refused = config.commands.refusal(Command::Parameters);
    options.lifecycle_refused = config.commands.refusal(Command::Lifecycle);
    options.domain_id = config.domain_id;
    options.network = config.network_choice();
    for rule in &config.remap {
        let (from, to) = parse_remapping(rule)?;
        options = options.remap(from, to);
    }
    for (name, value) in &config.parameters {
        let value = ParameterValue::from_json(value)
            .ok_or_else(|| RunError::ParameterValue { name: name.clone(), value: value.to_string() })?;
        options = options.parameter(name, value);
    }
    Ok(options)
}

/// See [`crate::check`].
pub(crate) fn check(sensor: &dyn Sensor, config: &Config) -> Vec<RunError> {
    let mut faults: Vec<RunError> =
        SourceUrl::parse(&config.source).map_err(RunError::from).err().into_iter().collect();
    // All the rest is about the skin.
    let skin = match skin(sensor, config) {
        Ok(skin) => skin,
        Err(error) => {
            faults.push(error);
            return faults;
        }
    };
    let bundles = config
        .models
        .iter()
        .filter_map(|folder| Bundle::load_within(folder, &skin, &config.model_limits).err());
    faults.extend(bundles.map(|error| RunError::from(SetupError::from(error))));
    if faults.is_empty() {
        // What is wrong with a bundle makes its correction useless, too.
        faults.extend(check_correction(config, &skin).err());
    }
    let start = || -> Result<(), RunError> {
        let mut estimator = SkinEstimator::new(&skin, &config.masked)?;
        let parameters = Parameters::new(options(config, &skin)?.parameters);
        // Of every node.
        parameters.declare("use_sim_time", config.use_sim_time, ParameterDescriptor::default())?;
        declare(&parameters, config, &skin, &mut estimator)
    };
    faults.extend(start().err());
    faults
}

/// Whether the correction of this device can be read, and is of use to one of the models.
fn check_correction(config: &Config, skin: &SkinDescription) -> Result<(), RunError> {
    let Some(file) = &config.correction else { return Ok(()) };
    let mut used = false;
    // What is wrong with a bundle itself is said where it is loaded.
    for mut bundle in config.models.iter().filter_map(|folder| Bundle::load(folder, skin).ok()) {
        if bundle.manifest().inversion.is_some() {
            bundle.take_correction(file, skin).map_err(SetupError::from)?;
            used = true;
        }
    }
    if used { Ok(()) } else { Err(RunError::UnusedCorrection { path: file.clone() }) }
}

fn skin_and_source(sensor: &dyn Sensor, config: &Config) -> Result<(SkinDescription, SourceUrl), RunError> {
    Ok((skin(sensor, config)?, SourceUrl::parse(&config.source)?))
}

fn skin(sensor: &dyn Sensor, config: &Config) -> Result<SkinDescription, RunError> {
    let skin = SkinDescription::load(&config.skin)?;
    if skin.sensor != sensor.name() {
        return Err(RunError::Sensor {
            path: config.skin.clone(),
            found: skin.sensor,
            expected: sensor.name(),
        });
    }
    if let Err(ModelError::Description { field, reason, .. }) = sensor.check(&skin) {
        return Err(RunError::Medium { path: config.skin.clone(), field, reason });
    }
    Ok(config.instance_of(skin)?)
}

/// Parameters that say how a node was configured, and the key that decides each.
const FIXED: [(&str, &str); 10] = [
    ("skin", "instance"),
    ("skin_type", "skin"),
    ("skin_hash", "skin"),
    ("frame_id", "frame_id"),
    ("mount_parent", "mount"),
    ("mount_pose", "mount"),
    ("masked", "masked"),
    ("correction", "correction"),
    ("source", "source"),
    ("models", "models"),
];

/// Declares the parameters and takes their start values over into the estimator.
fn declare(
    parameters: &Parameters,
    config: &Config,
    skin: &SkinDescription,
    estimator: &mut SkinEstimator,
) -> Result<(), RunError> {
    if let Some((name, key)) = FIXED.into_iter().find(|(name, _)| config.parameters.contains_key(*name)) {
        return Err(RunError::FixedParameter { name, key });
    }
    let fixed = |text: &str| ParameterDescriptor::new(text).read_only();
    parameters.declare("skin", skin.name.as_str(), fixed("name of this skin, unique on the robot"))?;
    parameters.declare("skin_type", skin.type_name(), fixed("name of the skin file's"))?;
    parameters.declare(
        "skin_hash",
        skin.hash(),
        fixed("identity of the type; models are trained for one"),
    )?;
    parameters.declare("frame_id", skin.frame_id.as_str(), fixed("coordinate frame of this skin"))?;
    let mount = config.mount.as_ref();
    let parent = mount.map(Mount::parent).unwrap_or_default();
    parameters.declare(
        "mount_parent",
        parent,
        fixed("link that this skin is fixed to; empty: not known here"),
    )?;
    let pose = mount.map(|m| [&m.translation()[..], &m.rotation()[..]].concat()).unwrap_or_default();
    parameters.declare(
        "mount_pose",
        pose,
        fixed("pose of `frame_id` in `mount_parent`: x, y, z [m] and quaternion x, y, z, w; empty: not known here"),
    )?;
    parameters.declare("masked", config.masked.clone(), fixed("channels that are left out"))?;
    let correction = config.correction.as_ref().map(|file| file.display().to_string()).unwrap_or_default();
    parameters.declare(
        "correction",
        correction,
        fixed("file of how this skin differs from its forward model; empty: as its models say"),
    )?;
    parameters.declare("source", config.source.as_str(), fixed("where the bytes come from"))?;
    let models: Vec<String> = config.models.iter().map(|m| m.display().to_string()).collect();
    parameters.declare("models", models, fixed("model bundles at start; ~/load_model replaces them"))?;
    let live = |text: &str, from: f64, to: f64| ParameterDescriptor::new(text).float_range(from, to);
    let c = &skin.condition;
    for (name, value, descriptor) in [
        (
            "contact_threshold",
            c.contact_threshold,
            live("a contact is assumed above this many noise deviations (rms of the channels)", 0.1, 1e6),
        ),
        (
            "drift_time",
            c.drift_time,
            live("[s] with which the zero follows drift while untouched", 1e-3, 1e6),
        ),
        (
            "release_share",
            c.release_share,
            live(
                "share of a contact's peak below which a signal at rest becomes the new zero; 0: never",
                0.0,
                0.99,
            ),
        ),
        (
            "tare_duration",
            c.tare_duration,
            live("[s] of untouched readings that a tare averages", 1e-3, 600.0),
        ),
        (
            "stuck_time",
            c.stuck_time,
            live("[s] without change after which a channel is stuck; 0: off", 0.0, 1e6),
        ),
        ("stale_time", c.stale_time, live("[s] without a frame after which the skin is stale", 1e-3, 1e4)),
        ("force_threshold", config.force_threshold, live("[N] lighter contacts are not reported", 0.0, 1e6)),
    ] {
        parameters.declare(name, value, descriptor)?;
    }
    parameters.declare(
        "tare_while_touched",
        false,
        ParameterDescriptor::new(
            "whether ~/tare is obeyed where the skin reads as touched: its zero has drifted",
        ),
    )?;
    let unused = parameters.unused_overrides();
    if !unused.is_empty() {
        return Err(RunError::UnknownParameter {
            names: unused.join("`, `"),
            known: parameters.names().join(", "),
        });
    }
    for name in parameters.names() {
        if let Some(value) = parameters.get(&name) {
            apply(estimator, &name, &value);
        }
    }
    Ok(())
}

/// Takes one parameter over into the estimator.
fn apply(estimator: &mut SkinEstimator, name: &str, value: &ParameterValue) {
    let Some(value) = value.as_f64() else { return };
    let mut condition = estimator.condition().clone();
    match name {
        "contact_threshold" => condition.contact_threshold = value,
        "drift_time" => condition.drift_time = value,
        "release_share" => condition.release_share = value,
        "tare_duration" => condition.tare_duration = value,
        "stuck_time" => condition.stuck_time = value,
        "stale_time" => condition.stale_time = value,
        "force_threshold" => return estimator.set_least_force(value),
        _ => return,
    }
    estimator.set_condition(condition);
}

struct Publishers {
    taxels: Publisher<TaxelFrame>,
    /// Of a skin that is read by a camera, from its first picture on.
    image: Option<Publisher<Image>>,
    contacts: Publisher<ContactArray>,
    wrench: Publisher<WrenchStamped>,
    points: Publisher<PointCloud2>,
    markers: Publisher<MarkerArray>,
    geometry: Publisher<SkinGeometry>,
    /// Where the skin is fixed, if that is known.
    transform: Option<Publisher<TFMessage>>,
    force_map: Option<Publisher<ForceMap>>,
    displacement_map: Option<Publisher<DisplacementMap>>,
    markers_sent: Option<Instant>,
    arrows: bool,
}

impl Publishers {
    fn new(node: &Node, maps: Maps) -> Result<Self, NodeError> {
        let mut publishers = Self {
            taxels: node.stream_publisher("taxels", KEPT)?,
            image: None,
            contacts: node.stream_publisher("contacts", KEPT)?,
            wrench: node.stream_publisher("wrench", KEPT)?,
            points: node.stream_publisher("contact_points", KEPT)?,
            markers: node.stream_publisher("contact_markers", KEPT)?,
            geometry: node.publisher("skin_geometry", Qos::latched())?,
            transform: None,
            force_map: None,
            displacement_map: None,
            markers_sent: None,
            arrows: false,
        };
        publishers.add(node, maps)?;
        Ok(publishers)
    }

    /// Offers these maps besides those that are offered already.
    fn add(&mut self, node: &Node, maps: Maps) -> Result<(), NodeError> {
        if maps.force && self.force_map.is_none() {
            self.force_map = Some(node.stream_publisher("force_map", KEPT_MAPS)?);
        }
        if maps.displacement && self.displacement_map.is_none() {
            self.displacement_map = Some(node.stream_publisher("displacement_map", KEPT_MAPS)?);
        }
        Ok(())
    }

    /// Maps that somebody listens to.
    fn wanted(&self) -> Maps {
        Maps {
            force: self.force_map.as_ref().is_some_and(|p| p.subscriber_count() > 0),
            displacement: self.displacement_map.as_ref().is_some_and(|p| p.subscriber_count() > 0),
        }
    }
}

/// The publisher of static transforms; none where the ROS 2 that is sourced has no messages for them.
fn transforms(node: &Node, skin: &SkinDescription) -> Result<Option<Publisher<TFMessage>>, NodeError> {
    match node.publisher("/tf_static", Qos::latched()) {
        Err(NodeError::Backend(error @ BackendError::UnknownType { .. })) => {
            tracing::warn!(
                "skin `{}`: where it is mounted is not published on /tf_static ({error}): install tf2_msgs of your ROS 2 and \
                 build again, or put its frame into the robot's description",
                skin.name
            );
            Ok(None)
        }
        made => made.map(Some),
    }
}

/// Publishes what `make` gives if somebody listens.
fn send<T: dermis_msgs::Message>(publisher: &Publisher<T>, make: impl FnOnce() -> Option<T>) {
    if publisher.subscriber_count() == 0 {
        return;
    }
    if let Some(message) = make()
        && let Err(error) = publisher.publish(&message)
    {
        tracing::debug!("{error}");
    }
}

type Job = Box<dyn FnOnce() -> Result<(), NodeError> + Send>;

/// A thread for what late subscribers get, too: over zenoh a peer that stopped reading holds the publisher of that up for a
/// minute, and frames must not wait for that.
fn slow_lane() -> std::io::Result<SyncSender<Job>> {
    let (tx, rx) = sync_channel::<Job>(8);
    std::thread::Builder::new().name("dermis-latched".into()).spawn(move || {
        for job in rx {
            if let Err(error) = job() {
                tracing::debug!("{error}");
            }
        }
    })?;
    Ok(tx)
}

/// What the working thread, services, parameters and diagnostics share.
struct Shared {
    sensor: &'static dyn Sensor,
    /// Whether stamps follow the device's clock as it is.
    device_time: bool,
    /// Where this device is fixed, if that is known.
    mount: Option<Mount>,
    /// How this device differs from its forward model, where its models are not to say it.
    correction: Option<PathBuf>,
    skin: SkinDescription,
    surface: Surface,
    url: SourceUrl,
    runtime: &'static Runtime,
    node: Node,
    slow: SyncSender<Job>,
    commands: Commands,
    model_limits: Limits,
    /// Folders below which bundles may be loaded from.
    model_folders: Vec<PathBuf>,
    kept_zero: KeptZero,
    core: Mutex<Core>,
    /// Told after every batch of frames.
    progress: Condvar,
    active: AtomicBool,
    stop: AtomicBool,
}

struct Core {
    /// While active.
    reader: Option<Box<dyn Decoder>>,
    estimator: SkinEstimator,
    publishers: Publishers,
    enabled: bool,
    /// The models that are configured are still being made ready.
    loading: bool,
    /// Of the latest frame.
    sequence: u64,
    figures: Figures,
    source: SourceStats,
    /// What of other senders had been left out when the diagnostics asked last.
    refused: u64,
    /// Why the skin is blind, if it is: status and sentence.
    blind: Option<(u8, String)>,
    /// Jumps of the device's clock that were warned of, and when that was.
    jumps: (u64, Option<Instant>),
}

/// Rates and delays since the diagnostics asked last.
#[derive(Debug, Default)]
struct Figures {
    frames_total: u64,
    frames: u64,
    /// \[ns\] from acquisition to publication.
    latency_sum: i64,
    latency_max: i64,
    /// \[ns\] from a frame to its last message, over those whose contacts were looked for.
    work_sum: i64,
    work_max: i64,
    /// Frames that were passed over, because a newer one was there.
    passed: u64,
    passed_total: u64,
    asked: Option<Instant>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes on the other thread; what does not fit into its queue is dropped.
    fn slowly(&self, job: impl FnOnce() -> Result<(), NodeError> + Send + 'static) {
        if self.slow.try_send(Box::new(job)).is_err() {
            tracing::debug!(
                "a subscriber of skin `{}` does not read: a message for late subscribers was dropped",
                self.skin.name
            );
        }
    }

    fn stopping(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// The working thread: reads while the node is active, says that it is blind while nothing comes.
    fn work(&self, mut early: Option<Source>) {
        let mut source: Option<Source> = None;
        let mut last_frame = Instant::now();
        let mut last_blind: Option<Instant> = None;
        // Frames that wait, and when they came [ns since the Unix epoch].
        let mut waiting: VecDeque<(i64, Frame)> = VecDeque::new();
        // A recording waits for whoever reads it: nothing of it is passed over.
        let live = !matches!(self.url, SourceUrl::Replay { .. });
        let patience = LATE.0.max(Duration::from_secs_f64(LATE.1 / self.skin.rate));
        // What a frame takes, on average over the last few.
        let mut pace = 0.0f64;
        let mut link = LinkNews::default();
        let mut kept: Option<Instant> = None;
        while !self.stopping() {
            if !self.active.load(Ordering::Acquire) {
                if source.take().is_some() {
                    waiting.clear();
                    let mut core = self.lock();
                    core.reader = None;
                    core.blind = None;
                    self.clear_arrows(&mut core);
                }
                std::thread::sleep(TICK);
                continue;
            }
            if source.is_none() {
                let options = DecoderOptions { device_time: self.device_time };
                let reader = self.sensor.decoder(&self.skin, options);
                let mut core = self.lock();
                // That there is one was seen before the node was started.
                core.reader = reader.ok();
                core.jumps = (0, None);
                drop(core);
                self.publish_latched();
                last_frame = Instant::now();
                last_blind = None;
            }
            let source = source.get_or_insert_with(|| {
                early.take().unwrap_or_else(|| Source::open(self.url.clone(), SourceOptions::default()))
            });
            let request = self.lock().reader.as_mut().and_then(|reader| reader.request(now_ns()));
            if let Some(request) = request {
                // Where the link is down it is made again.
                source.send(&request);
            }
            let mut event = match (waiting.is_empty(), live) {
                (true, _) => source.next_timeout(TICK),
                (false, true) => source.next_timeout(Duration::ZERO),
                (false, false) => None,
            };
            let mut core = self.lock();
            core.source = source.stats();
            let mut taken = 0;
            while let Some(next) = event.take() {
                taken += 1;
                match next {
                    Event::Bytes { data, received_ns } => {
                        let mut frames = Vec::new();
                        if let Some(reader) = &mut core.reader {
                            reader.push(&data, received_ns, &mut frames);
                        }
                        self.warn_of_jumps(&mut core);
                        if !frames.is_empty() {
                            last_frame = Instant::now();
                            if core.enabled {
                                last_blind = None;
                                core.blind = None;
                            }
                        }
                        waiting.extend(frames.into_iter().map(|frame| (received_ns, frame)));
                    }
                    Event::Overflow { .. } => core.gap(),
                    Event::Disconnected { reason, .. } => {
                        link.down(&self.skin.name, reason);
                        core.gap();
                    }
                    Event::Connected { description } => link.up(&self.skin.name, &description),
                    Event::OtherSender { notice, taken_over } => {
                        tracing::warn!("skin `{}`: {notice}", self.skin.name);
                        if taken_over {
                            core.gap();
                        }
                    }
                    Event::Ended => {
                        // Every later event is this one again: the wait is ours.
                        if waiting.is_empty() {
                            drop(core);
                            std::thread::sleep(TICK);
                            core = self.lock();
                        }
                        break;
                    }
                    _ => {}
                }
                if live && taken < MOST_EVENTS {
                    event = source.next_timeout(Duration::ZERO);
                }
            }
            // Before a frame is looked at, which may take long: what comes meanwhile is in the queue.
            let silence = last_frame.elapsed();
            if let Some((received_ns, frame)) = waiting.pop_front() {
                let mut newest = frame;
                let waited = u64::try_from(now_ns().saturating_sub(received_ns)).unwrap_or(0);
                // A burst that is soon worked off is worked off.
                let backlog = pace * (waiting.len() + 1) as f64 > patience.as_secs_f64();
                if live && backlog && Duration::from_nanos(waited) > patience {
                    for (_, newer) in waiting.drain(..) {
                        self.pass(&mut core, std::mem::replace(&mut newest, newer));
                    }
                }
                let begun = Instant::now();
                self.take(&mut core, newest);
                pace += PACE * (begun.elapsed().as_secs_f64() - pace);
            }
            let stale = silence.as_secs_f64() > core.estimator.condition().stale_time;
            if stale || !core.enabled {
                let (status, text) = if core.enabled {
                    self.why_blind(&core, silence)
                } else {
                    (ContactArray::STATUS_STALE, "switched off by ~/set_enabled".to_owned())
                };
                let news = core.blind.as_ref().is_none_or(|(before, _)| *before != status);
                if news {
                    tracing::warn!("skin `{}`: {text}", self.skin.name);
                }
                if news || last_blind.is_none_or(|at| at.elapsed() >= BLIND_PERIOD) {
                    last_blind = Some(Instant::now());
                    let stamp = self.node.clock().now();
                    let c = &*core;
                    send(&c.publishers.contacts, || {
                        Some(blind_message(&self.skin, &c.estimator, stamp, c.sequence, status, &text))
                    });
                    self.clear_arrows(&mut core);
                }
                core.blind = Some((status, text));
            }
            if !stale
                && kept.is_none_or(|at| at.elapsed() >= kept_zero::PERIOD)
                && let Some(save) = core.estimator.zero().and_then(|zero| self.kept_zero.save(zero, now_ns()))
            {
                kept = Some(Instant::now());
                self.slowly(move || {
                    save();
                    Ok(())
                });
            }
            drop(core);
            self.progress.notify_all();
        }
    }

    /// What late subscribers get, too: the skin's shape, and where it is fixed.
    fn publish_latched(&self) {
        let stamp = self.node.clock().now();
        let message = self.skin.geometry_message(&self.surface, stamp);
        let (geometry, transform) = {
            let core = self.lock();
            (core.publishers.geometry.clone(), core.publishers.transform.clone())
        };
        self.slowly(move || geometry.publish(&message));
        if let (Some(publisher), Some(mount)) = (transform, &self.mount) {
            let message =
                transform_message(&self.skin, stamp, mount.parent(), mount.translation(), mount.rotation());
            self.slowly(move || publisher.publish(&message));
        }
    }

    /// Says that stamps begin anew, because what computes with them takes a gap for a movement.
    fn warn_of_jumps(&self, core: &mut Core) {
        let jumps = core.reader.as_ref().map_or(0, |reader| reader.clock_jumps());
        let (warned, at) = core.jumps;
        if jumps > warned && at.is_none_or(|at| at.elapsed() >= JUMP_PERIOD) {
            core.jumps = (jumps, Some(Instant::now()));
            tracing::warn!(
                "skin `{}`: the device started again, or one of the clocks was set ({jumps} times so far): stamps \
                 follow its clock anew",
                self.skin.name
            );
        }
    }

    /// Why no frame comes, as far as link and decoder know.
    fn why_blind(&self, core: &Core, silence: Duration) -> (u8, String) {
        let stats = core.reader.as_ref().map(|reader| reader.stats());
        let name = &self.skin.name;
        if let Some(key) = core.reader.as_ref().and_then(|reader| reader.other_wire()) {
            return (ContactArray::STATUS_FAULT, format!("skin `{name}` on {}: {key}", self.url));
        }
        if let Some(diagnosis) = stats.and_then(|s| s.diagnosis(Some(&self.url))) {
            return (ContactArray::STATUS_FAULT, format!("skin `{name}` on {}: {diagnosis}", self.url));
        }
        let why = if !core.source.connected {
            core.source.last_reason.clone().unwrap_or_else(|| format!("{} is not connected yet", self.url))
        } else if stats.is_some_and(|s| s.bytes_since_valid > 0) {
            format!("{} sends bytes, but no whole frame yet", self.url)
        } else {
            format!("{} is connected and silent; check that the device is on", self.url)
        };
        (ContactArray::STATUS_STALE, format!("no frame for {:.1} s: {why}", silence.as_secs_f64()))
    }

    /// Stamps a frame that came, and publishes its picture. Whether anybody wants the rest.
    fn receive(&self, core: &mut Core, frame: &mut Frame) -> bool {
        core.sequence = frame.sequence;
        if frame.image.is_some() && core.publishers.image.is_none() {
            // What cannot be offered is tried again with the next picture.
            core.publishers.image = self.node.stream_publisher("image", KEPT_MAPS).ok();
        }
        if self.node.clock().is_simulated() {
            frame.stamp = frame.stamp.saturating_sub(now_ns()).saturating_add(self.node.clock().now());
        }
        if let Some(publisher) = &core.publishers.image {
            send(publisher, || self.skin.image_message(frame));
        }
        core.enabled
    }

    /// One frame through conditioning, for a newer one is there to look for contacts in.
    fn pass(&self, core: &mut Core, mut frame: Frame) {
        if !self.receive(core, &mut frame) {
            return;
        }
        if let Err(error) = core.estimator.pass(&frame) {
            tracing::debug!("skin `{}`: {error}", self.skin.name);
        }
        // A recording of them has every frame.
        let Core { estimator, publishers, figures, .. } = core;
        send(&publishers.taxels, || Some(self.skin.frame_message(&estimator.conditioned().reading)));
        figures.frames_total += 1;
        figures.frames += 1;
        figures.passed += 1;
        figures.passed_total += 1;
    }

    /// One frame through conditioning, inference and publication.
    fn take(&self, core: &mut Core, mut frame: Frame) {
        let begun = Instant::now();
        if !self.receive(core, &mut frame) {
            return;
        }
        let mut wanted = core.publishers.wanted();
        wanted.displacement = wanted.displacement && core.estimator.displacements_ready();
        core.estimator.want_maps(wanted);
        let estimate = core.estimator.estimate(&frame).unwrap_or_else(|error| {
            tracing::debug!("skin `{}`: {error}", self.skin.name);
            Estimate::default()
        });
        self.publish(core, &frame, &estimate);
        let now = self.node.clock().now();
        let figures = &mut core.figures;
        figures.frames_total += 1;
        figures.frames += 1;
        let latency = now.saturating_sub(frame.stamp);
        figures.latency_sum = figures.latency_sum.saturating_add(latency);
        figures.latency_max = figures.latency_max.max(latency);
        let work = i64::try_from(begun.elapsed().as_nanos()).unwrap_or(i64::MAX);
        figures.work_sum = figures.work_sum.saturating_add(work);
        figures.work_max = figures.work_max.max(work);
    }

    fn publish(&self, core: &mut Core, frame: &Frame, estimate: &Estimate) {
        let (skin, stamp) = (&self.skin, frame.stamp);
        let Core { estimator, publishers, .. } = core;
        let contacts = &estimate.contacts;
        let quality = estimator.verdict().quality;
        send(&publishers.taxels, || Some(skin.frame_message(&estimator.conditioned().reading)));
        send(&publishers.contacts, || Some(contacts_message(skin, estimator, frame, estimate)));
        if let Some(publisher) = &publishers.force_map {
            send(publisher, || estimate.force_map.as_ref().map(|map| map.to_message(skin, frame)));
        }
        if let Some(publisher) = &publishers.displacement_map {
            send(publisher, || estimate.displacement_map.as_ref().map(|map| map.to_message(skin, frame)));
        }
        if quality > Quality::Degraded {
            self.clear_arrows(core);
            return;
        }
        if estimator.gives_force() {
            send(&publishers.wrench, || wrench_message(skin, stamp, contacts));
        }
        send(&publishers.points, || Some(points_message(skin, stamp, contacts)));
        if contacts.is_empty() {
            self.clear_arrows(core);
        } else if publishers.markers_sent.is_none_or(|at| at.elapsed() >= MARKER_PERIOD) {
            publishers.markers_sent = Some(Instant::now());
            publishers.arrows = true;
            let lifetime = (3.0 / skin.rate).max(0.2);
            let degraded = quality == Quality::Degraded;
            send(&publishers.markers, || Some(markers_message(skin, stamp, contacts, degraded, lifetime)));
        }
    }

    fn clear_arrows(&self, core: &mut Core) {
        if std::mem::take(&mut core.publishers.arrows) {
            let stamp = self.node.clock().now();
            send(&core.publishers.markers, || Some(no_markers_message(&self.skin, stamp)));
        }
    }

    fn follow_parameters(self: &Arc<Self>) {
        let shared = Arc::downgrade(self);
        self.node.parameters().on_changed(move |name, value| {
            if let Some(shared) = shared.upgrade() {
                apply(&mut shared.lock().estimator, name, value);
            }
        });
    }

    /// Answers a command, where the node obeys it.
    fn command<T>(
        weak: &Weak<Self>,
        command: Command,
        act: impl FnOnce(&Self) -> Result<T, String>,
    ) -> Result<T, String> {
        let shared = weak.upgrade().ok_or("the node is stopping")?;
        match shared.commands.refusal(command) {
            Some(why) => Err(why),
            None => act(&shared),
        }
    }

    fn serve(self: &Arc<Self>) -> Result<Vec<ServiceServer>, NodeError> {
        let answer = |done: Result<String, String>| match done {
            Ok(message) => (true, message),
            Err(message) => (false, message),
        };
        let shared = Arc::downgrade(self);
        let tare = self.node.serve::<Trigger>("~/tare", move |_| {
            let (success, message) = answer(Self::command(&shared, Command::Tare, Self::tare));
            TriggerResponse { success, message }
        })?;
        let shared = Arc::downgrade(self);
        let enable = self.node.serve::<SetBool>("~/set_enabled", move |request| {
            let (success, message) = answer(Self::command(&shared, Command::Enable, |shared| {
                shared.lock().enabled = request.data;
                let message =
                    if request.data { "enabled" } else { "disabled: contacts are reported as stale" };
                Ok(message.into())
            }));
            SetBoolResponse { success, message }
        })?;
        let shared = Arc::downgrade(self);
        let load = self.node.serve::<LoadModel>("~/load_model", move |request| {
            let load = |shared: &Self| shared.load_model(&request.bundle);
            let (success, message) = answer(Self::command(&shared, Command::Load, load));
            LoadModelResponse { success, message }
        })?;
        Ok(vec![tare, enable, load])
    }

    /// Tares and waits for the end of it.
    fn tare(&self) -> Result<String, String> {
        let forced =
            self.node.parameters().get("tare_while_touched").and_then(|v| v.as_bool()).unwrap_or(false);
        let mut core = self.lock();
        if !self.active.load(Ordering::Acquire) {
            return Err(
                "the node is not active, so that no frame comes to tare with; activate it first".into()
            );
        }
        if let Some((_, why)) = &core.blind {
            return Err(format!("not tared: {why}"));
        }
        core.estimator.begin_tare(forced).map_err(|refusal| refusal.to_string())?;
        let begun = Instant::now();
        let duration = core.estimator.condition().tare_duration;
        let patience = Duration::from_secs_f64(duration + TARE_PATIENCE + 4.0 / self.skin.rate);
        loop {
            if core.estimator.tare_state() == TareState::Done {
                return Ok(format!("tared over {duration} s"));
            }
            let left = patience.saturating_sub(begun.elapsed());
            if left.is_zero() || self.stopping() {
                let why = match core.estimator.tare_state() {
                    TareState::Averaging { disturbed: Some(spread), .. } => format!(
                        "the readings move by {spread:.1} times their noise; leave the skin untouched and call again"
                    ),
                    _ => format!(
                        "no {duration} s of untouched readings came; leave the skin untouched and call again"
                    ),
                };
                core.estimator.cancel_tare();
                return Err(format!("not tared: {why}"));
            }
            core = self.progress.wait_timeout(core, left.min(TICK)).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Takes a bundle in place of those that give the same outputs.
    fn load_model(&self, name: &str) -> Result<String, String> {
        if self.lock().loading {
            return Err(
                "the models that are configured are still being made ready; call again when contacts come"
                    .into(),
            );
        }
        let folder = folders::bundle(name, &self.model_folders)?;
        let models = loader::bundles(&[folder], &self.skin, &self.model_limits, self.correction.as_deref())
            .and_then(|bundles| Models::load(self.sensor, &self.skin, &bundles, self.runtime))
            .map_err(|e| e.to_string())?;
        let mut core = self.lock();
        core.publishers.add(&self.node, models.maps()).map_err(|e| e.to_string())?;
        core.estimator.replace_models(models);
        let names: Vec<String> =
            core.estimator.models().map(|(name, path)| format!("{name} ({})", path.display())).collect();
        Ok(format!("running {}", names.join(", ")))
    }

    fn diagnose(&self) -> Status {
        let mut core = self.lock();
        let verdict = core.estimator.verdict().clone();
        let active = self.active.load(Ordering::Acquire);
        let mut status = Status::ok("reads, and contacts are known");
        if !active {
            let state = self.node.lifecycle().map_or(State::Unconfigured, |life| life.state());
            status = Status::ok(format!("{state}: reads nothing"));
        } else if let Some((code, text)) = &core.blind {
            let level = if *code == ContactArray::STATUS_FAULT { Level::Error } else { Level::Stale };
            status.worsen(level, text);
        } else if core.figures.frames_total == 0 {
            status.worsen(Level::Warn, "no frame yet");
        } else {
            match verdict.quality {
                Quality::Ok => {}
                Quality::Degraded | Quality::Uncalibrated => status.worsen(Level::Warn, &verdict.text),
                Quality::Fault => status.worsen(Level::Error, &verdict.text),
            }
        }

        let hash = self.skin.hash();
        status.value("skin type", format!("{} ({})", self.skin.type_name(), hash.get(..19).unwrap_or(&hash)));
        let now = Instant::now();
        let passed = core.figures.asked.map_or(0.0, |at| now.duration_since(at).as_secs_f64());
        let figures = &core.figures;
        if passed > 0.0 {
            let rate = figures.frames as f64 / passed;
            status.value("rate [Hz]", format!("{rate:.1}"));
            if active
                && core.blind.is_none()
                && rate < 0.5 * self.skin.rate
                && figures.frames_total > 0
                && passed > 0.5
            {
                status.worsen(
                    Level::Warn,
                    format!("{rate:.1} frames a second where the skin file says {}", self.skin.rate),
                );
            }
        }
        let taken = figures.frames - figures.passed;
        if taken > 0 {
            let mean = |sum: i64| sum as f64 / taken as f64 * 1e-6;
            status.value("latency mean [ms]", format!("{:.3}", mean(figures.latency_sum)));
            status.value("latency max [ms]", format!("{:.3}", figures.latency_max as f64 * 1e-6));
            status.value("processing mean [ms]", format!("{:.3}", mean(figures.work_sum)));
            status.value("processing max [ms]", format!("{:.3}", figures.work_max as f64 * 1e-6));
            if active && core.blind.is_none() && figures.passed as f64 > PASSED * figures.frames as f64 {
                status.worsen(
                    Level::Warn,
                    format!(
                        "contacts are known for {taken} of {} frames: looking for them takes {:.1} ms on average and {:.1} ms at \
                         most where a frame comes every {:.1} ms, so that the newest is taken and others are passed over",
                        figures.frames,
                        mean(figures.work_sum),
                        figures.work_max as f64 * 1e-6,
                        1e3 / self.skin.rate
                    ),
                );
            }
        }
        status.value("frames", figures.frames_total);
        status.value("frames passed over", figures.passed_total);
        if let Some(reader) = &core.reader {
            let stats = reader.stats();
            let rejected = &stats.rejected;
            status.value("frames lost", stats.lost);
            status.value("CRC errors", rejected.crc);
            status.value("other rejected frames", rejected.total() - rejected.crc);
            status.value("resynchronisations", stats.resyncs);
            status.value("device restarts", stats.restarts);
            status.value("clock jumps", reader.clock_jumps());
            status.value("stamps from", format!("{:?}", reader.clock()));
            if let Some(last) = &stats.last_rejection {
                status.value("last rejection", last);
            }
        }
        status.value("reconnects", core.source.connects.saturating_sub(1));
        status.value("disconnects", core.source.disconnects);
        status.value("bytes dropped", core.source.dropped_bytes);
        let refused = core.source.refused_datagrams + core.source.refused_connections;
        if refused > 0 {
            let others: Vec<String> = core.source.others.iter().map(ToString::to_string).collect();
            status.value("datagrams of others", core.source.refused_datagrams);
            status.value("connections refused", core.source.refused_connections);
            status.value("other senders", others.join(", "));
            if active && refused > core.refused {
                let read =
                    core.source.peer.map_or_else(|| "another device".to_owned(), |peer| peer.to_string());
                status.worsen(
                    Level::Warn,
                    format!("{} wants to send too and is left out, while {read} is read", others.join(", ")),
                );
            }
        }
        let flags = &core.estimator.conditioned().reading.flags;
        for (name, flag) in [
            ("dead channels", ChannelFlags::DEAD),
            ("saturated channels", ChannelFlags::SATURATED),
            ("stuck channels", ChannelFlags::STUCK),
            ("not finite channels", ChannelFlags::NOT_FINITE),
            ("masked channels", ChannelFlags::MASKED),
        ] {
            let named: Vec<&str> = self
                .skin
                .channels()
                .iter()
                .zip(flags)
                .filter(|(_, f)| f.contains(flag))
                .map(|(c, _)| c.name.as_str())
                .collect();
            status.value(name, if named.is_empty() { "none".into() } else { named.join(", ") });
        }
        status.value("level [noise deviations]", format!("{:.2}", verdict.level));
        status.value("touched", verdict.touched);
        if let Some((force, share)) = core.estimator.unfelt() {
            status
                .value("not felt [% of surface]", format!("{:.1} (a press of {force:.2} N)", 100.0 * share));
        }
        status.value(
            "tare",
            match core.estimator.tare_state() {
                TareState::Done => "done".to_owned(),
                TareState::Averaging { elapsed, .. } => format!("averaging, {elapsed:.1} s so far"),
            },
        );
        let models: Vec<String> =
            core.estimator.models().map(|(name, path)| format!("{name} ({})", path.display())).collect();
        let models = if core.loading { vec!["being made ready".to_owned()] } else { models };
        status.value("models", if models.is_empty() { "none".into() } else { models.join(", ") });
        status.value("runtime", self.runtime.report());
        status.value("source", &self.url);
        let Figures { frames_total, passed_total, .. } = core.figures;
        core.refused = refused;
        core.figures = Figures { frames_total, passed_total, asked: Some(now), ..Figures::default() };
        status
    }
}

/// What is logged of a link that may come and go many times a second.
#[derive(Debug, Default)]
struct LinkNews {
    /// Why it was down the last time that this was logged, and when that was.
    told: Option<(String, Instant)>,
    /// Times that it went down, or was tried, since then.
    untold: u64,
    up_at: Option<Instant>,
}

impl LinkNews {
    /// A reason is logged once, and again where it is another one or was not logged for long.
    fn down(&mut self, skin: &str, reason: String) {
        let now = Instant::now();
        if self
            .told
            .as_ref()
            .is_some_and(|(told, at)| *told == reason && now.duration_since(*at) < LINK_PERIOD)
        {
            self.untold += 1;
            return;
        }
        match std::mem::take(&mut self.untold) {
            0 => tracing::warn!("skin `{skin}`: {reason}"),
            untold => tracing::warn!(
                "skin `{skin}`: {reason} (down or not to be had {untold} times more since that was last said)"
            ),
        }
        self.told = Some((reason, now));
    }

    fn up(&mut self, skin: &str, description: &str) {
        let now = Instant::now();
        // One that flaps is not logged each time; one that comes back after a while is.
        if self.up_at.replace(now).is_none_or(|at| now.duration_since(at) >= UP_PERIOD) {
            tracing::info!("skin `{skin}`: connected to {description}");
        }
    }
}

impl Core {
    /// Bytes are missing.
    fn gap(&mut self) {
        if let Some(reader) = &mut self.reader {
            reader.gap();
        }
    }
}

#[cfg(test)]
mod tests;
