//! The node: endpoints, parameters, clock, diagnostics and lifecycle over any backend.
//!
//! | file | what it does |
//! |---|---|
//! | `endpoints` | what publishers, subscriptions and services share |
//! | `system` | what every node offers by itself: log, parameter services, clock, diagnostics |
//! | `managed` | the lifecycle services |
//! | `timers` | timers and the thread that keeps time |
//! | `ending` | shutdown |

use std::any::Any;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::{Arc, Condvar, Mutex, OnceLock, Weak};
use std::thread::JoinHandle;

use dermis_msgs::rcl_interfaces::msg::Log;
use dermis_msgs::{Message, Service, TypeSupport};

use crate::backend::{Backend, EndpointInfo, EndpointKind, NodeSpec};
use crate::clock::Clock;
use crate::diagnostics::Diagnostics;
use crate::error::NodeError;
use crate::executor::{Executor, Lane, lock};
use crate::lifecycle::Lifecycle;
use crate::names::{NameKind, Names};
use crate::options::NodeOptions;
use crate::parameters::{ParameterValue, Parameters};
use crate::pubsub::{MessageInfo, Pace, Publisher, RawPublisher, Subscription};
use crate::qos::Qos;
use crate::service::{Client, ServiceServer};
use crate::watch::{Problem, ProblemKind};
use ending::Closing;
use system::SIM_TIME;
use timers::{Alarm, TimerInner, keep_time};

pub use ending::{end_all_nodes, end_all_nodes_on_signal, end_of_all_nodes, signalled};
pub(crate) use endpoints::{Close, Core, Registration, runtime};
pub use system::LogLevel;
pub use timers::Timer;

mod ending;
mod endpoints;
mod managed;
mod system;
mod timers;

type ProblemMap = BTreeMap<(ProblemKind, String), Problem>;
type ProblemCallback = Box<dyn FnMut(&Problem) + Send>;

/// What the threads of a node and its clones share.
struct Shared {
    core: Arc<Core>,
    backend: &'static str,
    domain_id: u16,
    parameters: Parameters,
    clock: Clock,
    clock_subscription: Mutex<Option<Subscription>>,
    diagnostics: Diagnostics,
    lifecycle: Mutex<Option<Lifecycle>>,
    /// Why other nodes may not change it.
    lifecycle_refused: Option<String>,
    log: OnceLock<Arc<Lane<Log>>>,
    problems: Mutex<ProblemMap>,
    problem_callbacks: Arc<Mutex<Vec<ProblemCallback>>>,
    problem_lane: OnceLock<Arc<Lane<Problem>>>,
    timers: Mutex<Vec<Weak<TimerInner>>>,
    /// Services, publishers and timers of the node itself.
    kept: Mutex<Vec<Box<dyn Any + Send>>>,
    keeper: Mutex<Option<JoinHandle<()>>>,
    ended: tokio::sync::watch::Sender<bool>,
    closing: (Mutex<Closing>, Condvar),
}

/// What clones of a node share; threads of the node hold [`Shared`] only, so that the last clone shuts the
/// node down where it is dropped.
struct Handle(Arc<Shared>);

impl Deref for Handle {
    type Target = Shared;

    fn deref(&self) -> &Shared {
        &self.0
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.0.shutdown();
    }
}

/// A ROS 2 node. Cheap to clone; the last clone shuts it down. Publishers and subscriptions do not keep
/// it alive.
#[derive(Clone)]
pub struct Node(Arc<Handle>);

impl Node {
    /// Joins the domain.
    ///
    /// May be called from async code; it blocks for the time that discovery takes (about half a second
    /// over hiroz).
    ///
    /// # Errors
    ///
    /// When a name or remapping is not valid, the environment is not, or the backend refuses.
    pub fn open(options: NodeOptions, backend: &dyn Backend) -> Result<Self, NodeError> {
        let domain_id = options.resolve_domain()?;
        let network = options.network.resolve()?;
        let NodeOptions {
            name,
            namespace,
            remappings,
            parameters: mut overrides,
            use_sim_time,
            diagnostics: publish_diagnostics,
            threads,
            parameters_refused,
            lifecycle_refused,
            ..
        } = options;
        let names = Names::new(&name, &namespace, &remappings)?;
        let full_name = names.full_name();
        let spec =
            NodeSpec { name: names.name.clone(), namespace: names.namespace.clone(), domain_id, network };
        let thread_error =
            |error: std::io::Error| NodeError::Thread { node: full_name.clone(), reason: error.to_string() };
        let executor = Executor::start("dermis-node", threads).map_err(thread_error)?;
        let system = Executor::start("dermis-node-sys", 1).map_err(thread_error)?;
        let alarm = Arc::new(Alarm::default());
        let node = backend.open(&spec)?;
        crate::network::announce(&node.open_to());
        let hook = Arc::clone(&alarm);
        node.on_graph_change(Box::new(move || hook.graph_changed()));
        let core = Arc::new(Core::new(names, node, executor, system, alarm));
        if use_sim_time {
            overrides.entry(SIM_TIME.to_owned()).or_insert(ParameterValue::Bool(true));
        }
        let shared = Arc::new(Shared {
            core,
            backend: backend.name(),
            domain_id,
            parameters: Parameters::new(overrides),
            clock: Clock::new(),
            clock_subscription: Mutex::default(),
            diagnostics: Diagnostics::new(full_name.clone()),
            lifecycle: Mutex::default(),
            lifecycle_refused,
            log: OnceLock::new(),
            problems: Mutex::default(),
            problem_callbacks: Arc::default(),
            problem_lane: OnceLock::new(),
            timers: Mutex::default(),
            kept: Mutex::default(),
            keeper: Mutex::default(),
            ended: tokio::sync::watch::Sender::new(false),
            closing: Default::default(),
        });
        let node = Self(Arc::new(Handle(shared)));
        node.start_log()?;
        node.start_parameters(parameters_refused)?;
        node.start_clock()?;
        node.start_problems();
        if publish_diagnostics {
            node.start_diagnostics()?;
        }
        let weak = Arc::downgrade(&node.0.0);
        let alarm = Arc::clone(&node.0.core.alarm);
        let keeper = std::thread::Builder::new()
            .name("dermis-node-time".to_owned())
            .spawn(move || keep_time(&weak, &alarm))
            .map_err(thread_error)?;
        *lock(&node.0.keeper) = Some(keeper);
        Ok(node)
    }

    /// `/namespace/name`.
    #[must_use]
    pub fn full_name(&self) -> String {
        self.0.core.names.full_name()
    }

    /// The backend it runs over: `hiroz`, `r2r`.
    #[must_use]
    pub fn backend_name(&self) -> &'static str {
        self.0.backend
    }

    /// What it is open to and to whom, in one sentence for people; the log has it too, at level info.
    #[must_use]
    pub fn open_to(&self) -> String {
        self.0.core.node.open_to()
    }

    /// The ROS domain it is in.
    #[must_use]
    pub fn domain_id(&self) -> u16 {
        self.0.domain_id
    }

    /// The full name that a relative (`contacts`) or private (`~/tare`) name has after remapping.
    ///
    /// # Errors
    ///
    /// When ROS does not allow the name.
    pub fn resolve_name(&self, name: &str) -> Result<String, NodeError> {
        self.0.core.names.resolve(name, NameKind::Topic)
    }

    /// Publishes messages of type `T` on `topic`.
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn publisher<T: Message>(&self, topic: &str, qos: Qos) -> Result<Publisher<T>, NodeError> {
        Publisher::new(&self.0.core, topic, qos, Pace::OfReaders)
    }

    /// Publishes a stream of messages of type `T`: it offers reliable delivery, so that subscriptions with any reliability
    /// match it, and keeps the last `depth` messages; but it never waits for a peer. What a peer that does not read has no room
    /// for is dropped. This is how ROS 2 itself does it: DDS overwrites what is older than `depth`, and `rmw_zenoh` drops
    /// what a queue does not take.
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn stream_publisher<T: Message>(&self, topic: &str, depth: usize) -> Result<Publisher<T>, NodeError> {
        Publisher::new(&self.0.core, topic, Qos::reliable(depth), Pace::Own)
    }

    /// Publishes encoded messages of a type that is known by name only.
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn publisher_raw(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: Qos,
    ) -> Result<RawPublisher, NodeError> {
        RawPublisher::new(&self.0.core, topic, type_support, qos, Pace::OfReaders)
    }

    /// Calls `callback` on a thread of the node for each message on `topic`, one after the other. Where
    /// it is slower than messages come, the oldest beyond the depth of `qos` are dropped and counted.
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn subscribe<T: Message>(
        &self,
        topic: &str,
        qos: Qos,
        callback: impl FnMut(T, MessageInfo) + Send + 'static,
    ) -> Result<Subscription, NodeError> {
        Subscription::typed(&self.0.core, topic, qos, callback)
    }

    /// [`Node::subscribe`] for the encoded bytes (CDR with encapsulation header).
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn subscribe_raw(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: Qos,
        callback: impl FnMut(&[u8], MessageInfo) + Send + 'static,
    ) -> Result<Subscription, NodeError> {
        Subscription::new(&self.0.core, topic, type_support, qos, Arc::default(), callback)
    }

    /// Answers a service with `handler`, called on a thread of the node for one request after the other.
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn serve<S: Service>(
        &self,
        name: &str,
        handler: impl FnMut(S::Request) -> S::Response + Send + 'static,
    ) -> Result<ServiceServer, NodeError> {
        ServiceServer::new::<S>(&self.0.core, &self.0.core.executor, name, handler)
    }

    /// Makes a client of a service.
    ///
    /// # Errors
    ///
    /// When the name is not valid, the node is shut down, or the backend refuses.
    pub fn client<S: Service>(&self, name: &str) -> Result<Client<S>, NodeError> {
        Client::new(&self.0.core, name)
    }

    /// Its parameters.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.0.parameters
    }

    /// Its clock.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.0.clock
    }

    /// Its diagnostics.
    #[must_use]
    pub fn diagnostics(&self) -> &Diagnostics {
        &self.0.diagnostics
    }

    /// Writes a line to the program's log and to `/rosout`. Never blocks.
    pub fn log(&self, level: LogLevel, text: impl Into<String>) {
        self.0.log(level, text.into());
    }

    /// What keeps messages from arriving at the moment, as far as the graph shows it.
    #[must_use]
    pub fn problems(&self) -> Vec<Problem> {
        lock(&self.0.problems).values().cloned().collect()
    }

    /// Calls `callback` once for each problem that appears in the graph.
    pub fn on_problem(&self, callback: impl FnMut(&Problem) + Send + 'static) {
        lock(&self.0.problem_callbacks).push(Box::new(callback));
    }

    /// Full names of all nodes in the domain, one entry for each instance, sorted.
    ///
    /// # Errors
    ///
    /// When the graph cannot be read.
    pub fn node_names(&self) -> Result<Vec<String>, NodeError> {
        let mut names = self.0.core.node.node_names()?;
        names.sort();
        Ok(names)
    }

    /// Every topic of the domain that somebody publishes, with its type (`pkg/msg/Type`), sorted.
    ///
    /// # Errors
    ///
    /// When the graph cannot be read.
    pub fn topics(&self) -> Result<Vec<(String, String)>, NodeError> {
        let mut topics = self.0.core.node.topics()?;
        topics.sort();
        Ok(topics)
    }

    /// All endpoints of one kind on a topic or service of the domain.
    ///
    /// # Errors
    ///
    /// When the name is not valid or the graph cannot be read.
    pub fn endpoints(&self, name: &str, kind: EndpointKind) -> Result<Vec<EndpointInfo>, NodeError> {
        let name = self.0.core.names.resolve(name, NameKind::Topic)?;
        Ok(self.0.core.node.endpoints(&name, kind)?)
    }
}
