//! The node.

use std::any::Any;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError, Weak};
use std::thread::{JoinHandle, ThreadId};
use std::time::{Duration, Instant};

use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::diagnostic_msgs::msg::DiagnosticArray;
use dermis_msgs::lifecycle_msgs::msg::TransitionEvent;
use dermis_msgs::lifecycle_msgs::srv as lifecycle_srv;
use dermis_msgs::rcl_interfaces::msg::{Log, Parameter, ParameterEvent, SetParametersResult};
use dermis_msgs::rcl_interfaces::srv as parameter_srv;
use dermis_msgs::rosgraph_msgs::msg::Clock as ClockMsg;
use dermis_msgs::sequence::Losses;
use dermis_msgs::{Message, Service, TypeSupport};

use crate::backend::{Backend, BackendNode, EndpointInfo, EndpointKind, NodeSpec};
use crate::clock::Clock;
use crate::diagnostics::{Diagnostics, Level, Status};
use crate::error::NodeError;
use crate::executor::{Executor, Lane, lock};
use crate::lifecycle::Lifecycle;
use crate::names::{NameKind, Names};
use crate::options::NodeOptions;
use crate::parameters::{ParameterDescriptor, ParameterValue, Parameters};
use crate::pubsub::{MessageInfo, Pace, Publisher, RawPublisher, Subscription, SubscriptionInner};
use crate::qos::{Durability, History, Qos, Reliability};
use crate::service::{Client, ServiceServer};
use crate::watch::{OwnEndpoint, Problem, ProblemKind, problems};

/// How often the graph is looked at where nothing reports a change.
const GRAPH_PERIOD: Duration = Duration::from_secs(1);
/// Changes of the graph come in bursts; one look is enough for each.
const GRAPH_QUIET: Duration = Duration::from_millis(20);
/// Longest wait of a second caller of `shutdown` for the first one.
const CLOSE_WAIT: Duration = Duration::from_secs(10);
/// Period of `/diagnostics`.
const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);

const SIM_TIME: &str = "use_sim_time";

/// The runtime for timers and signals: callers may have none, or one that must not block.
pub(crate) fn runtime() -> Result<&'static tokio::runtime::Runtime, NodeError> {
    static RUNTIME: OnceLock<Result<tokio::runtime::Runtime, String>> = OnceLock::new();
    RUNTIME
        .get_or_init(|| {
            tokio::runtime::Builder::new_multi_thread()
                .worker_threads(1)
                .thread_name("dermis-node-io")
                .enable_all()
                .build()
                .map_err(|error| error.to_string())
        })
        .as_ref()
        .map_err(|reason| NodeError::Thread { node: "(all)".to_owned(), reason: reason.clone() })
}

/// What is withdrawn when the node shuts down.
pub(crate) trait Close: Send + Sync {
    fn close(&self);
}

/// What endpoints share.
pub(crate) struct Core {
    pub(crate) names: Names,
    pub(crate) node: Arc<dyn BackendNode>,
    /// Runs the callbacks of the user.
    pub(crate) executor: Executor,
    /// Runs what must go on while callbacks are busy: parameter services, diagnostics, logs.
    system: Executor,
    own: Mutex<BTreeMap<u64, OwnEndpoint>>,
    next: AtomicU64,
    tracked: Mutex<Vec<Weak<dyn Close>>>,
    /// Whose losses are told in the diagnostics.
    subscriptions: Mutex<Vec<Weak<SubscriptionInner>>>,
    closed: AtomicBool,
    alarm: Arc<Alarm>,
}

impl Core {
    pub(crate) fn shut_down(&self) -> NodeError {
        NodeError::ShutDown { node: self.names.full_name() }
    }

    pub(crate) fn check_open(&self) -> Result<(), NodeError> {
        if self.closed.load(Ordering::Acquire) { Err(self.shut_down()) } else { Ok(()) }
    }

    /// Notes an endpoint for the watch over the graph, until the registration is dropped.
    pub(crate) fn register(self: &Arc<Self>, endpoint: OwnEndpoint) -> Registration {
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        lock(&self.own).insert(id, endpoint);
        self.alarm.graph_changed();
        Registration { core: Arc::downgrade(self), id }
    }

    pub(crate) fn track(&self, closer: &Arc<impl Close + 'static>) {
        let weak = Arc::downgrade(closer);
        {
            let mut tracked = lock(&self.tracked);
            tracked.retain(|known| known.strong_count() > 0);
            tracked.push(weak);
        }
        // The node may have been shut down since the check.
        if self.closed.load(Ordering::Acquire) {
            closer.close();
        }
    }

    pub(crate) fn watch_losses(&self, subscription: &Arc<SubscriptionInner>) {
        let mut known = lock(&self.subscriptions);
        known.retain(|subscription| subscription.strong_count() > 0);
        known.push(Arc::downgrade(subscription));
    }

    /// Messages lost on the way and drops of the queues, of each topic that lost something.
    fn losses(&self) -> BTreeMap<String, (u64, u64)> {
        let known: Vec<_> = lock(&self.subscriptions).iter().filter_map(Weak::upgrade).collect();
        let mut topics: BTreeMap<String, (u64, u64)> = BTreeMap::new();
        for subscription in known {
            let (Losses { lost, .. }, dropped) = subscription.counts();
            if lost + dropped > 0 {
                let sum = topics.entry(subscription.topic().to_owned()).or_default();
                *sum = (sum.0 + lost, sum.1 + dropped);
            }
        }
        topics
    }
}

/// Keeps an endpoint under watch.
pub(crate) struct Registration {
    core: Weak<Core>,
    id: u64,
}

impl Drop for Registration {
    fn drop(&mut self) {
        if let Some(core) = self.core.upgrade() {
            lock(&core.own).remove(&self.id);
        }
    }
}

#[derive(Default)]
struct AlarmState {
    graph_changed: bool,
    timers_changed: bool,
    stop: bool,
}

/// Wakes the thread that keeps time.
#[derive(Default)]
struct Alarm {
    state: Mutex<AlarmState>,
    wake: Condvar,
}

impl Alarm {
    fn graph_changed(&self) {
        lock(&self.state).graph_changed = true;
        self.wake.notify_all();
    }
}

struct TimerInner {
    period: Duration,
    next: Mutex<Instant>,
    lane: Arc<Lane<()>>,
}

impl Close for TimerInner {
    fn close(&self) {
        self.lane.close();
    }
}

impl Drop for TimerInner {
    fn drop(&mut self) {
        self.lane.close();
    }
}

/// A timer. Its callback is called until this is dropped or the node is shut down.
#[must_use = "a timer that is dropped does not tick"]
pub struct Timer(#[expect(dead_code, reason = "held for its drop")] Arc<TimerInner>);

/// Severity of a line in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LogLevel {
    /// For those who look for a fault.
    Debug,
    /// For the record.
    Info,
    /// Somebody should look.
    Warn,
    /// Something does not work.
    Error,
}

type ProblemMap = BTreeMap<(ProblemKind, String), Problem>;
type ProblemCallback = Box<dyn FnMut(&Problem) + Send>;

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

/// How far the end of a node is.
#[derive(Default)]
struct Closing {
    by: Option<ThreadId>,
    done: bool,
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
        let core = Arc::new(Core {
            names,
            node,
            executor,
            system,
            own: Mutex::default(),
            next: AtomicU64::new(0),
            tracked: Mutex::default(),
            subscriptions: Mutex::default(),
            closed: AtomicBool::new(false),
            alarm,
        });
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

    /// Calls `callback` on a thread of the node every `period` of real time. A tick that comes while the
    /// last one still runs is left out.
    pub fn timer(&self, period: Duration, callback: impl FnMut() + Send + 'static) -> Timer {
        Timer(self.timer_on(&self.0.core.executor, period, callback))
    }

    fn timer_on(
        &self,
        executor: &Executor,
        period: Duration,
        mut callback: impl FnMut() + Send + 'static,
    ) -> Arc<TimerInner> {
        let period = period.max(Duration::from_micros(100));
        let lane = executor.lane("timer".to_owned(), Some(1), move |()| callback());
        let timer = Arc::new(TimerInner { period, next: Mutex::new(Instant::now() + period), lane });
        lock(&self.0.timers).push(Arc::downgrade(&timer));
        self.0.core.track(&timer);
        lock(&self.0.core.alarm.state).timers_changed = true;
        self.0.core.alarm.wake.notify_all();
        timer
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

    /// Its managed life. The first call announces the lifecycle services and `~/transition_event`; the
    /// node is Unconfigured then. A node that never calls this is not managed.
    ///
    /// # Errors
    ///
    /// When the node is shut down or the backend refuses the services.
    pub fn lifecycle(&self) -> Result<Lifecycle, NodeError> {
        let mut slot = lock(&self.0.lifecycle);
        if let Some(lifecycle) = &*slot {
            return Ok(lifecycle.clone());
        }
        let clock = self.0.clock.clone();
        let lifecycle = Lifecycle::new(self.full_name(), Box::new(move || clock.now()));
        let core = &self.0.core;
        let events: Publisher<TransitionEvent> = self.stream_publisher("~/transition_event", 10)?;
        let lane = core.system.lane("transition_event".to_owned(), None, move |event| {
            if let Err(error) = events.publish(&event) {
                tracing::debug!("{error}");
            }
        });
        lifecycle.set_event_sink(Box::new(move |event| lane.push(event)));

        let life = lifecycle.clone();
        let get_state =
            ServiceServer::new::<lifecycle_srv::GetState>(core, &core.system, "~/get_state", move |_| {
                lifecycle_srv::GetStateResponse { current_state: life.state_msg() }
            })?;
        let life = lifecycle.clone();
        let refused = self.0.lifecycle_refused.clone();
        let locked = refused.is_some();
        let change_state = self.serve::<lifecycle_srv::ChangeState>("~/change_state", move |request| {
            let success = match &refused {
                Some(why) => {
                    tracing::warn!("a transition was asked for: {why}");
                    false
                }
                None => life.change(&request.transition),
            };
            lifecycle_srv::ChangeStateResponse { success }
        })?;
        let states = ServiceServer::new::<lifecycle_srv::GetAvailableStates>(
            core,
            &core.system,
            "~/get_available_states",
            |_| lifecycle_srv::GetAvailableStatesResponse { available_states: Lifecycle::available_states() },
        )?;
        let mut kept: Vec<Box<dyn Any + Send>> =
            vec![Box::new(get_state), Box::new(change_state), Box::new(states)];
        for (name, all) in [("~/get_available_transitions", false), ("~/get_transition_graph", true)] {
            let life = lifecycle.clone();
            let server = ServiceServer::new::<lifecycle_srv::GetAvailableTransitions>(
                core,
                &core.system,
                name,
                // None can be taken by whoever asks where they are refused.
                move |_| lifecycle_srv::GetAvailableTransitionsResponse {
                    available_transitions: if locked && !all { Vec::new() } else { life.transitions(all) },
                },
            )?;
            kept.push(Box::new(server));
        }
        lock(&self.0.kept).append(&mut kept);
        *slot = Some(lifecycle.clone());
        Ok(lifecycle)
    }

    /// Writes a line to the program's log and to `/rosout`. Never blocks.
    pub fn log(&self, level: LogLevel, text: impl Into<String>) {
        self.0.log(level, text.into());
    }

    /// What keeps messages from arriving at the moment, as far as the graph tells.
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

    /// Leaves the domain: takes a managed node to Finalized, withdraws all endpoints and waits for running
    /// callbacks. No callback is called and no message sent afterwards. A transition that runs is waited for, and the
    /// node is Finalized after it. A second call waits for the end of the first one, except in a callback.
    pub fn shutdown(&self) {
        self.0.shutdown();
    }

    /// Whether it was shut down.
    #[must_use]
    pub fn is_shut_down(&self) -> bool {
        self.0.core.closed.load(Ordering::Acquire)
    }

    /// Waits for Ctrl-C, SIGTERM or [`Node::shutdown`], and shuts the node down. May be awaited on any
    /// executor.
    ///
    /// # Errors
    ///
    /// When the signals cannot be listened to; the node is not shut down then.
    pub async fn wait_for_shutdown(&self) -> Result<(), NodeError> {
        let mut ended = self.0.ended.subscribe();
        let signalled = runtime()?.spawn(async {
            #[cfg(unix)]
            {
                use tokio::signal::unix::{SignalKind, signal};
                let mut terminate = signal(SignalKind::terminate())?;
                tokio::select! {
                    result = tokio::signal::ctrl_c() => result,
                    _ = terminate.recv() => Ok(()),
                }
            }
            #[cfg(not(unix))]
            tokio::signal::ctrl_c().await
        });
        let abort = signalled.abort_handle();
        let shut_down = std::pin::pin!(ended.wait_for(|ended| *ended));
        match futures::future::select(shut_down, signalled).await {
            futures::future::Either::Left(_) => abort.abort(),
            futures::future::Either::Right((signal, _)) => {
                let signal = signal.unwrap_or_else(|error| Err(std::io::Error::other(error)));
                signal.map_err(|error| NodeError::Thread {
                    node: self.full_name(),
                    reason: format!("cannot listen to signals: {error}"),
                })?;
                tracing::info!("node {} shuts down", self.full_name());
            }
        }
        let node = self.clone();
        let done = runtime()?.spawn_blocking(move || node.shutdown());
        done.await.map_err(|error| NodeError::Thread { node: self.full_name(), reason: error.to_string() })
    }

    fn keep(&self, item: impl Any + Send) {
        lock(&self.0.kept).push(Box::new(item));
    }

    fn start_log(&self) -> Result<(), NodeError> {
        let qos = Qos {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            history: History::KeepLast(1000),
        };
        let publisher: Publisher<Log> = self.publisher("/rosout", qos)?;
        let lane = self.0.core.system.lane("/rosout".to_owned(), Some(1000), move |line: Log| {
            if let Err(error) = publisher.publish(&line) {
                tracing::debug!("{error}");
            }
        });
        // Set once: a node starts once.
        let _ = self.0.log.set(lane);
        Ok(())
    }

    fn start_parameters(&self, refused: Option<String>) -> Result<(), NodeError> {
        let core = &self.0.core;
        let events: Publisher<ParameterEvent> = self.stream_publisher("/parameter_events", 1000)?;
        let lane =
            core.system.lane("/parameter_events".to_owned(), Some(1000), move |event: ParameterEvent| {
                if let Err(error) = events.publish(&event) {
                    tracing::debug!("{error}");
                }
            });
        let full_name = self.full_name();
        let clock = self.0.clock.clone();
        self.0.parameters.set_event_sink(Box::new(move |mut event| {
            event.stamp = Time::from_nanos(clock.now());
            event.node.clone_from(&full_name);
            lane.push(event);
        }));

        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::GetParameters>(
            core,
            &core.system,
            "~/get_parameters",
            move |request| parameter_srv::GetParametersResponse { values: p.get_msgs(&request.names) },
        )?);
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::GetParameterTypes>(
            core,
            &core.system,
            "~/get_parameter_types",
            move |request| parameter_srv::GetParameterTypesResponse {
                types: p.get_msgs(&request.names).iter().map(|value| value.r#type).collect(),
            },
        )?);
        let p = self.0.parameters.clone();
        let fixed = refused.is_some();
        let set = move |parameters: Vec<Parameter>| match &refused {
            Some(reason) => SetParametersResult { successful: false, reason: reason.clone() },
            None => p.set_msgs(parameters),
        };
        let each = set.clone();
        self.keep(ServiceServer::new::<parameter_srv::SetParameters>(
            core,
            &core.system,
            "~/set_parameters",
            move |request| parameter_srv::SetParametersResponse {
                results: request.parameters.into_iter().map(|one| each(vec![one])).collect(),
            },
        )?);
        self.keep(ServiceServer::new::<parameter_srv::SetParametersAtomically>(
            core,
            &core.system,
            "~/set_parameters_atomically",
            move |request| parameter_srv::SetParametersAtomicallyResponse { result: set(request.parameters) },
        )?);
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::DescribeParameters>(
            core,
            &core.system,
            "~/describe_parameters",
            move |request| {
                let mut descriptors = p.describe_msgs(&request.names);
                // What cannot be set by others is shown so by tools that have a field for each.
                descriptors.iter_mut().for_each(|descriptor| descriptor.read_only |= fixed);
                parameter_srv::DescribeParametersResponse { descriptors }
            },
        )?);
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::ListParameters>(
            core,
            &core.system,
            "~/list_parameters",
            move |request| parameter_srv::ListParametersResponse {
                result: p.list(&request.prefixes, request.depth),
            },
        )?);
        Ok(())
    }

    fn start_clock(&self) -> Result<(), NodeError> {
        let descriptor = ParameterDescriptor::new("whether stamps come from /clock instead of the system");
        let simulated = self.0.parameters.declare(SIM_TIME, false, descriptor)?;
        if simulated == ParameterValue::Bool(true) {
            self.0.set_simulated(true)?;
        }
        let weak = Arc::downgrade(&self.0.0);
        self.0.parameters.on_changed(move |name, value| {
            let (SIM_TIME, Some(simulated), Some(shared)) = (name, value.as_bool(), weak.upgrade()) else {
                return;
            };
            if let Err(error) = shared.set_simulated(simulated) {
                shared.log(LogLevel::Error, format!("cannot follow /clock: {error}"));
            }
        });
        Ok(())
    }

    fn start_problems(&self) {
        let callbacks = Arc::clone(&self.0.problem_callbacks);
        let lane = self.0.core.executor.lane("problems".to_owned(), Some(100), move |problem: Problem| {
            for callback in lock(&callbacks).iter_mut() {
                callback(&problem);
            }
        });
        // Set once: a node starts once.
        let _ = self.0.problem_lane.set(lane);
    }

    fn start_diagnostics(&self) -> Result<(), NodeError> {
        let weak = Arc::downgrade(&self.0.0);
        self.0.diagnostics.add("ROS graph", move || {
            let mut status = Status::ok("no conflict with other nodes");
            if let Some(shared) = weak.upgrade() {
                for problem in lock(&shared.problems).values() {
                    status.worsen(Level::Warn, &problem.sentence);
                }
                let (jumps, last) = shared.clock.jumps();
                status.value("backend", shared.backend);
                status.value("domain", shared.domain_id);
                status.value("clock", if shared.clock.is_simulated() { "/clock" } else { "system" });
                status.value("clock jumps back", jumps);
                if let Some(jump) = last {
                    status.value("last clock jump (ns)", jump.to_ns.saturating_sub(jump.from_ns));
                }
            }
            status
        });
        let core = Arc::downgrade(&self.0.core);
        let mut before = BTreeMap::new();
        self.0.diagnostics.add("subscriptions", move || {
            let now = core.upgrade().map(|core| core.losses()).unwrap_or_default();
            let status = subscriptions_status(&before, &now);
            before = now;
            status
        });
        let publisher: Publisher<DiagnosticArray> = self.stream_publisher("/diagnostics", 10)?;
        let weak = Arc::downgrade(&self.0.0);
        let timer = self.timer_on(&self.0.core.system, DIAGNOSTICS_PERIOD, move || {
            let Some(shared) = weak.upgrade() else { return };
            if publisher.subscriber_count() > 0 {
                let message = shared.diagnostics.message(shared.clock.now());
                if let Err(error) = publisher.publish(&message) {
                    tracing::debug!("{error}");
                }
            }
        });
        self.keep(timer);
        Ok(())
    }
}

/// What subscriptions lost, by topic: on the way, and dropped by a queue for newer messages.
fn subscriptions_status(before: &BTreeMap<String, (u64, u64)>, now: &BTreeMap<String, (u64, u64)>) -> Status {
    let mut status = Status::ok("nothing was lost since the last report");
    for (topic, &(lost, dropped)) in now {
        let (lost_before, dropped_before) = before.get(topic).copied().unwrap_or_default();
        if lost > lost_before {
            let sentence = format!("{} messages on {topic} were lost on the way", lost - lost_before);
            status.worsen(Level::Warn, sentence);
        } else if dropped > dropped_before && status.level == Level::Ok {
            // With keep last, a slow reader gets the newest and goes without the rest: this is as it should be.
            status.message =
                "messages were dropped, because newer ones came before they were read".to_owned();
        }
        status.value(format!("{topic}: lost on the way"), lost);
        status.value(format!("{topic}: dropped for newer ones"), dropped);
    }
    status
}

impl Shared {
    fn log(&self, level: LogLevel, text: String) {
        let node = self.core.names.full_name();
        let id = match level {
            LogLevel::Debug => {
                tracing::debug!(%node, "{text}");
                Log::DEBUG
            }
            LogLevel::Info => {
                tracing::info!(%node, "{text}");
                Log::INFO
            }
            LogLevel::Warn => {
                tracing::warn!(%node, "{text}");
                Log::WARN
            }
            LogLevel::Error => {
                tracing::error!(%node, "{text}");
                Log::ERROR
            }
        };
        if let Some(lane) = self.log.get() {
            lane.push(Log {
                stamp: Time::from_nanos(self.clock.now()),
                level: id,
                name: node.trim_start_matches('/').replace('/', "."),
                msg: text,
                ..Log::default()
            });
        }
    }

    fn set_simulated(&self, simulated: bool) -> Result<(), NodeError> {
        let mut slot = lock(&self.clock_subscription);
        if simulated == slot.is_some() {
            return Ok(());
        }
        self.clock.set_simulated(simulated);
        *slot = if simulated {
            let clock = self.clock.clone();
            let on_clock = move |message: ClockMsg, _| {
                clock.set_simulated_now(message.clock.as_nanos());
            };
            Some(Subscription::typed(&self.core, "/clock", Qos::clock(), on_clock)?)
        } else {
            None
        };
        Ok(())
    }

    fn look_at_graph(&self) {
        let own: Vec<OwnEndpoint> = lock(&self.core.own).values().cloned().collect();
        let found = match problems(self.core.node.as_ref(), &self.core.names.full_name(), &own) {
            Ok(found) => found,
            Err(error) => {
                tracing::debug!("{error}");
                return;
            }
        };
        let before = std::mem::replace(&mut *lock(&self.problems), found.clone());
        for (key, problem) in found {
            if !before.contains_key(&key) {
                self.log(LogLevel::Warn, problem.sentence.clone());
                if let Some(lane) = self.problem_lane.get() {
                    lane.push(problem);
                }
            }
        }
    }

    /// Starts the timers that are due and returns when the next one is.
    fn tick(&self, now: Instant) -> Option<Instant> {
        let mut timers = lock(&self.timers);
        timers.retain(|timer| timer.strong_count() > 0);
        let due = timers.iter().filter_map(Weak::upgrade).map(|timer| {
            let mut next = lock(&timer.next);
            if *next <= now {
                timer.lane.push(());
                *next += timer.period;
                if *next <= now {
                    *next = now + timer.period;
                }
            }
            *next
        });
        due.min()
    }

    fn shutdown(&self) {
        let lifecycle = lock(&self.lifecycle).clone();
        if !self.core.closed.load(Ordering::Acquire)
            && let Some(lifecycle) = lifecycle
            && let Err(error) = lifecycle.end()
        {
            tracing::warn!("{error}");
        }
        if self.core.closed.swap(true, Ordering::AcqRel) {
            self.wait_until_gone();
            return;
        }
        lock(&self.closing.0).by = Some(std::thread::current().id());
        lock(&self.core.alarm.state).stop = true;
        self.core.alarm.wake.notify_all();
        let keeper = lock(&self.keeper).take();
        if let Some(keeper) = keeper
            && keeper.thread().id() != std::thread::current().id()
            && keeper.join().is_err()
        {
            tracing::error!("the timer thread of the node ended by a panic");
        }
        let tracked = std::mem::take(&mut *lock(&self.core.tracked));
        for closer in tracked.iter().filter_map(Weak::upgrade) {
            closer.close();
        }
        let subscription = lock(&self.clock_subscription).take();
        drop(subscription);
        let kept = std::mem::take(&mut *lock(&self.kept));
        drop(kept);
        self.core.node.close();
        self.core.executor.stop();
        self.core.system.stop();
        self.parameters.clear_callbacks();
        self.clock.clear_callbacks();
        self.diagnostics.clear();
        lock(&self.problem_callbacks).clear();
        if let Some(lifecycle) = &*lock(&self.lifecycle) {
            lifecycle.clear_callbacks();
        }
        self.ended.send_replace(true);
        lock(&self.closing.0).done = true;
        self.closing.1.notify_all();
    }

    /// Waits for another thread that shuts the node down: a program that goes on would end in the middle of it, and leave
    /// its names in the graph of others until they miss it. Not in a callback, which that thread waits for, nor in that
    /// thread itself, where the last clone of the node goes with the callbacks that are dropped.
    fn wait_until_gone(&self) {
        if self.core.executor.is_inside() || self.core.system.is_inside() {
            return;
        }
        let me = std::thread::current().id();
        let (closing, told) = &self.closing;
        let unfinished = |closing: &mut Closing| !closing.done && closing.by != Some(me);
        let waited = told.wait_timeout_while(lock(closing), CLOSE_WAIT, unfinished);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// Ticks timers and looks at the graph until the node ends.
fn keep_time(shared: &Weak<Shared>, alarm: &Alarm) {
    let mut next_look = Instant::now();
    loop {
        let now = Instant::now();
        let wake_at = {
            let Some(shared) = shared.upgrade() else { return };
            if now >= next_look {
                shared.look_at_graph();
                shared.clock.check_system();
                next_look = Instant::now() + GRAPH_PERIOD;
            }
            shared.tick(now).map_or(next_look, |next| next.min(next_look))
        };
        let state = lock(&alarm.state);
        let idle = |state: &mut AlarmState| !state.stop && !state.graph_changed && !state.timers_changed;
        let wait = wake_at.saturating_duration_since(Instant::now());
        let (mut state, _) =
            alarm.wake.wait_timeout_while(state, wait, idle).unwrap_or_else(PoisonError::into_inner);
        if state.stop {
            return;
        }
        state.timers_changed = false;
        if std::mem::take(&mut state.graph_changed) {
            next_look = next_look.min(Instant::now() + GRAPH_QUIET);
        }
    }
}
