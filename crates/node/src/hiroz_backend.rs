//! The embedded backend: ROS 2 over zenoh with the wire of `rmw_zenoh`, by the hiroz library.
//!
//! Here are sessions and nodes; `wire` has names, types and QoS as `rmw_zenoh` writes them, `publisher`, `subscription` and
//! `service` the endpoints.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Weak};

use dermis_msgs::TypeSupport;
use hiroz::Builder;
use hiroz::context::{ZContext, ZContextBuilder};
use hiroz::entity::{EndpointKind as GraphKind, TypeInfo};
use hiroz::graph::Graph;
use hiroz::msg::ZService;
use hiroz::node::ZNode;
use zenoh::Wait;
use zenoh::qos::CongestionControl;
use zenoh::session::ZenohId;

use crate::backend::{
    Backend, BackendClient, BackendEndpoint, BackendError, BackendNode, BackendPublisher, EndpointInfo,
    EndpointKind, GraphHook, MessageSink, NodeSpec, RequestSink, ServiceSupport,
};
use crate::executor::lock;
use crate::network::zenoh_config::insert;
use crate::network::{Network, SessionOptions};
use crate::node::runtime;
use crate::qos::{Qos, Reliability};
use publisher::{HirozPublisher, HirozStream};
use service::{HirozClient, HirozServer, raw_request};
use subscription::{HirozSubscription, Passage};
use wire::{endpoint, from_wire_qos, has_type, ros_type_name, to_wire_qos, type_info};

mod publisher;
mod service;
mod subscription;
mod wire;

const NAME: &str = "hiroz";

/// How the embedded backend finds others within the [`Network`] of a node; the default suits most.
///
/// Nodes find each other by multicast, and no router is needed. Where a router of `rmw_zenoh` runs on this machine, it is
/// used too. The environment variable `ZENOH_CONFIG_OVERRIDE` of `rmw_zenoh` counts here too.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HirozConfig {
    /// Options of the sessions, in addition to the network of a node.
    pub session: SessionOptions,
    /// Entries of the zenoh configuration that win over it: key and JSON5 value.
    pub overrides: Vec<(String, String)>,
}

impl HirozConfig {
    fn zenoh(&self, network: &Network) -> Result<zenoh::Config, String> {
        let mut config = network.session(&self.session)?;
        // History for late joiners needs stamps from peers, too.
        let stamps = serde_json::json!({ "router": true, "peer": true, "client": true });
        insert(&mut config, "timestamping/enabled", &stamps.to_string())?;
        for (key, value) in &self.overrides {
            insert(&mut config, key, value)?;
        }
        Ok(config)
    }
}

/// The embedded backend. Each node is a zenoh session of its own, or all nodes of a process share one.
#[derive(Debug, Clone, Default)]
pub struct HirozBackend {
    config: HirozConfig,
    sessions: Option<Sessions>,
}

impl HirozBackend {
    /// A backend with this configuration; [`HirozBackend::default`] suits most.
    #[must_use]
    pub fn new(config: HirozConfig) -> Self {
        Self { config, sessions: None }
    }

    /// The same, but nodes that are opened with it, or with a clone of it, share a session for each domain and network. What
    /// one of them publishes reaches the others without a socket and without a copy, and leaves the process once for all
    /// of them. They are peers of others together, so that nobody outside can cut off one of them alone.
    #[must_use]
    pub fn one_session(self) -> Self {
        Self { sessions: Some(Sessions::default()), ..self }
    }
}

/// Sessions that nodes share, as long as one of those nodes is open.
#[derive(Debug, Clone, Default)]
struct Sessions(Arc<Mutex<Vec<SharedSession>>>);

/// A session, and the domain and network that it was opened for.
#[derive(Debug)]
struct SharedSession {
    domain_id: u16,
    network: Network,
    session: Weak<Session>,
}

impl Sessions {
    /// The session of this domain and network, opened by `open` where there is none. Who asks meanwhile waits.
    fn get(
        &self,
        domain_id: u16,
        network: &Network,
        open: impl FnOnce() -> zenoh::Result<Session>,
    ) -> zenoh::Result<Arc<Session>> {
        let mut sessions = lock(&self.0);
        sessions.retain(|shared| shared.session.strong_count() > 0);
        let mut alike = sessions.iter().filter(|s| s.domain_id == domain_id && s.network == *network);
        if let Some(session) = alike.find_map(|shared| shared.session.upgrade()) {
            return Ok(session);
        }
        let session = Arc::new(open()?);
        let shared = SharedSession { domain_id, network: network.clone(), session: Arc::downgrade(&session) };
        sessions.push(shared);
        Ok(session)
    }
}

/// A zenoh session with its graph; the last node closes it.
#[derive(Debug)]
struct Session(ZContext);

impl Session {
    fn open(domain_id: u16, config: zenoh::Config) -> zenoh::Result<Self> {
        let builder = ZContextBuilder::default().with_domain_id(usize::from(domain_id));
        Ok(Self(builder.with_zenoh_config(config).build()?))
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if let Err(error) = off_runtime(|| self.0.shutdown()) {
            tracing::debug!("closing a zenoh session: {error}");
        }
    }
}

/// Runs what may wait on zenoh's runtime. Zenoh must not wait on the thread of a foreign single-threaded
/// runtime, so this moves to another one there.
fn off_runtime<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    if tokio::runtime::Handle::try_current().is_err() {
        return work();
    }
    std::thread::scope(|scope| match scope.spawn(work).join() {
        Ok(result) => result,
        Err(panic) => std::panic::resume_unwind(panic),
    })
}

impl Backend for HirozBackend {
    fn name(&self) -> &'static str {
        NAME
    }

    fn open(&self, spec: &NodeSpec) -> Result<Arc<dyn BackendNode>, BackendError> {
        let error = |reason: String| BackendError::Open { backend: NAME, node: spec.full_name(), reason };
        let config = self.config.zenoh(&spec.network).map_err(error)?;
        let namespace = if spec.namespace == "/" { "" } else { spec.namespace.as_str() };
        let (session, node) = off_runtime(|| -> zenoh::Result<(Arc<Session>, ZNode)> {
            let open = || Session::open(spec.domain_id, config.clone());
            let session = match &self.sessions {
                None => Arc::new(open()?),
                Some(sessions) => sessions.get(spec.domain_id, &spec.network, open)?,
            };
            let node =
                session.0.create_node(&spec.name).with_namespace(namespace).without_parameters().build()?;
            Ok((session, node))
        })
        .map_err(|e| error(e.to_string()))?;
        let open_to = off_runtime(|| spec.network.opened(node.session(), &config));
        let graph = Arc::clone(session.0.graph());
        let entity = node.node_entity();
        let shared = Arc::new(Shared {
            id: (entity.z_id, entity.id),
            node: Mutex::new(Some(node)),
            graph: Arc::clone(&graph),
            publishers: Mutex::default(),
            hooks: Mutex::default(),
            next: AtomicU64::new(0),
        });
        let weak = Arc::downgrade(&shared);
        let watch = runtime()
            .map_err(|e| error(e.to_string()))?
            .spawn(async move { follow(&weak, &graph).await })
            .abort_handle();
        Ok(Arc::new(HirozNode {
            full_name: spec.full_name(),
            open_to,
            session: Mutex::new(Some(session)),
            shared,
            watch,
        }))
    }
}

/// Counts the subscriptions anew after each change of the graph.
async fn follow(shared: &Weak<Shared>, graph: &Arc<Graph>) {
    loop {
        let changed = graph.change_notify.notified();
        let Some(shared) = shared.upgrade() else { return };
        shared.count();
        for hook in lock(&shared.hooks).iter() {
            hook();
        }
        drop(shared);
        changed.await;
    }
}

/// A publisher whose subscriptions are counted.
struct Matching {
    topic: String,
    type_info: TypeInfo,
    count: Arc<AtomicUsize>,
}

/// What a node shares with its publishers and with [`follow`].
struct Shared {
    /// Session and number of the node there.
    id: (ZenohId, usize),
    /// Taken out when the node is closed.
    node: Mutex<Option<ZNode>>,
    graph: Arc<Graph>,
    publishers: Mutex<HashMap<u64, Matching>>,
    hooks: Mutex<Vec<GraphHook>>,
    next: AtomicU64,
}

impl Shared {
    fn count(&self) {
        for publisher in lock(&self.publishers).values() {
            publisher.count.store(self.subscriptions(publisher), Ordering::Release);
        }
    }

    fn subscriptions(&self, publisher: &Matching) -> usize {
        self.graph
            .get_entities_by_topic(GraphKind::Subscription, &publisher.topic)
            .iter()
            .filter(|entity| has_type(entity, &publisher.type_info))
            .count()
    }
}

struct HirozNode {
    full_name: String,
    open_to: String,
    /// Taken out when the node is closed.
    session: Mutex<Option<Arc<Session>>>,
    shared: Arc<Shared>,
    watch: tokio::task::AbortHandle,
}

impl HirozNode {
    fn make<R: Send>(
        &self,
        what: &'static str,
        name: &str,
        make: impl FnOnce(&ZNode) -> zenoh::Result<R> + Send,
    ) -> Result<R, BackendError> {
        let node = lock(&self.shared.node);
        let Some(node) = node.as_ref() else {
            return Err(BackendError::Closed { node: self.full_name.clone() });
        };
        off_runtime(|| make(node)).map_err(|error| BackendError::Endpoint {
            what,
            name: name.to_owned(),
            reason: error.to_string(),
        })
    }

    /// Declares a publisher, and announces it in the graph.
    fn announce(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<HirozPublisher, BackendError> {
        let type_info = type_info("publisher", topic, type_support.name, type_support.hash)?;
        let id = self.shared.next.fetch_add(1, Ordering::Relaxed);
        let count = Arc::new(AtomicUsize::new(0));
        let watched = Arc::new(AtomicBool::new(false));
        let (publisher, watcher) = self.make("publisher", topic, |node| {
            let publisher = node
                .create_pub_impl::<Raw>(topic, Some(type_info.clone()))
                .with_qos(to_wire_qos(qos))
                .build()?;
            // The graph knows ROS subscriptions only; zenoh itself also knows of plain zenoh subscribers.
            let key = node.keyexpr_format().topic_key_expr(publisher.entity())?;
            // It also sends streams, which are to be dropped where a peer has no room for them.
            let watcher = node
                .session()
                .declare_publisher((*key).clone())
                .congestion_control(CongestionControl::Drop)
                .wait()?;
            let flag = Arc::clone(&watched);
            watcher
                .matching_listener()
                .callback(move |status| flag.store(status.matching(), Ordering::Release))
                .background()
                .wait()?;
            watched.store(watcher.matching_status().wait()?.matching(), Ordering::Release);
            Ok((publisher, watcher))
        })?;
        let matching = Matching { topic: topic.to_owned(), type_info, count: Arc::clone(&count) };
        count.store(self.shared.subscriptions(&matching), Ordering::Release);
        lock(&self.shared.publishers).insert(id, matching);
        // A change between counting and inserting would be missed.
        self.shared.count();
        Ok(HirozPublisher {
            topic: topic.to_owned(),
            publisher: Some((publisher, watcher)),
            count,
            watched,
            id,
            shared: Arc::downgrade(&self.shared),
        })
    }
}

impl BackendNode for HirozNode {
    fn open_to(&self) -> String {
        self.open_to.clone()
    }

    fn publisher(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<Arc<dyn BackendPublisher>, BackendError> {
        Ok(Arc::new(self.announce(topic, type_support, qos)?))
    }

    fn stream_publisher(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<Arc<dyn BackendPublisher>, BackendError> {
        let publisher = self.announce(topic, type_support, qos)?;
        Ok(match qos.reliability {
            // It drops already.
            Reliability::BestEffort => Arc::new(publisher),
            Reliability::Reliable => Arc::new(HirozStream::new(publisher)),
        })
    }

    fn subscribe(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
        sink: MessageSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        let type_info = type_info("subscription", topic, type_support.name, type_support.hash)?;
        let passage = Arc::new(Passage::new(sink));
        let arrived = Arc::clone(&passage);
        let subscription = self.make("subscription", topic, |node| {
            node.create_sub_impl::<Raw>(topic, Some(type_info))
                .with_qos(to_wire_qos(qos))
                .with_buffer_group(hiroz::BufferGroup::Off)
                .build_with_notifier(move || arrived.hand_on())
        })?;
        let queue = subscription.queue.clone().ok_or_else(|| BackendError::Endpoint {
            what: "subscription",
            name: topic.to_owned(),
            reason: "it has no queue".to_owned(),
        })?;
        passage.open(queue);
        Ok(Box::new(HirozSubscription { subscription: Some(subscription), passage }))
    }

    fn serve(
        &self,
        name: &str,
        service: &ServiceSupport,
        sink: RequestSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        let type_info = type_info("service", name, service.name, service.hash)?;
        let server = self.make("service", name, |node| {
            let service = name.to_owned();
            node.create_service_impl::<RawService>(name, Some(type_info))
                .with_qos(to_wire_qos(&Qos::services()))
                .build_with_callback(move |query| sink(raw_request(&service, query)))
        })?;
        Ok(Box::new(HirozServer(Some(Box::new(server)))))
    }

    fn client(&self, name: &str, service: &ServiceSupport) -> Result<Arc<dyn BackendClient>, BackendError> {
        let type_info = type_info("client", name, service.name, service.hash)?;
        let (presence, gid, querier, session) = self.make("client", name, |node| {
            let builder = node
                .create_client_impl::<RawService>(name, Some(type_info.clone()))
                .with_qos(to_wire_qos(&Qos::services()));
            let key = (*node.keyexpr_format().topic_key_expr(builder.entity())?).clone();
            let gid = hiroz::entity::endpoint_gid(builder.entity()).unwrap_or_default();
            let querier = node.session().declare_querier(key).wait()?;
            Ok((builder.build()?, gid, querier, Arc::clone(node.session())))
        })?;
        Ok(Arc::new(HirozClient {
            name: name.to_owned(),
            presence: Some(Box::new(presence)),
            type_info,
            gid,
            querier: Some(querier),
            session: Some(session),
            graph: Arc::clone(&self.shared.graph),
            // rcl counts requests from 1.
            sequence: AtomicI64::new(1),
        }))
    }

    fn node_names(&self) -> Result<Vec<String>, BackendError> {
        let names = self.shared.graph.get_node_names();
        Ok(names.into_iter().map(|(name, namespace)| crate::names::join(&namespace, &name)).collect())
    }

    fn endpoints(&self, name: &str, kind: EndpointKind) -> Result<Vec<EndpointInfo>, BackendError> {
        let graph = &self.shared.graph;
        let entities = match kind {
            EndpointKind::Publisher => graph.get_entities_by_topic(GraphKind::Publisher, name),
            EndpointKind::Subscription => graph.get_entities_by_topic(GraphKind::Subscription, name),
            EndpointKind::Service => graph.get_entities_by_service(GraphKind::Service, name),
            EndpointKind::Client => graph.get_entities_by_service(GraphKind::Client, name),
        };
        Ok(entities
            .iter()
            .filter_map(|entity| endpoint(entity))
            .map(|endpoint| EndpointInfo {
                node: endpoint
                    .node
                    .as_ref()
                    .map_or_else(String::new, |node| crate::names::join(&node.namespace, &node.name)),
                own: endpoint.node.as_ref().is_some_and(|node| (node.z_id, node.id) == self.shared.id),
                type_name: endpoint
                    .type_info
                    .as_ref()
                    .map_or_else(String::new, |info| ros_type_name(&info.name)),
                type_hash: endpoint.type_info.as_ref().map(|info| info.hash.to_rihs_string()),
                qos: matches!(kind, EndpointKind::Publisher | EndpointKind::Subscription)
                    .then(|| from_wire_qos(&endpoint.qos)),
            })
            .collect())
    }

    fn topics(&self) -> Result<Vec<(String, String)>, BackendError> {
        let graph = &self.shared.graph;
        let mut topics = graph.get_topic_names_and_types();
        topics.retain(|(name, _)| !graph.get_entities_by_topic(GraphKind::Publisher, name).is_empty());
        Ok(topics.into_iter().map(|(name, kind)| (name, ros_type_name(&kind))).collect())
    }

    fn on_graph_change(&self, hook: GraphHook) {
        lock(&self.shared.hooks).push(hook);
    }

    fn close(&self) {
        let Some(node) = lock(&self.shared.node).take() else { return };
        self.watch.abort();
        lock(&self.shared.hooks).clear();
        let session = lock(&self.session).take();
        off_runtime(|| {
            drop(node);
            drop(session);
        });
    }
}

impl Drop for HirozNode {
    fn drop(&mut self) {
        self.close();
    }
}

/// Placeholder for the message type: bytes pass as they are, so nothing is ever encoded from or decoded
/// into it.
type Raw = u8;
type RawSerdes = <Raw as hiroz::msg::ZMessage>::Serdes;

struct RawService;

impl ZService for RawService {
    type Request = Raw;
    type Response = Raw;
}

#[cfg(test)]
mod tests;
