//! ROS 2 through `r2r`, for robots that have ROS 2 installed: any RMW, any client library on the other side.
//!
//! It builds against the ROS 2 that is sourced (`. /opt/ros/<distro>/setup.sh`), with `dermis_msgs` built from `msgs/`
//! (`colcon build --paths msgs && . install/setup.sh`), and is left out of the default build.
//!
//! What this backend cannot do, because rcl or r2r do not let it:
//! - One process is in one ROS domain: the first node's domain holds for all, and another one is refused.
//! - One process has one type for each topic: another one is refused, not only reported.
//! - Subscriptions of other nodes are not listed in the graph; their number on an own topic is.
//! - A subscription or service that was dropped leaves the graph with its next message, or with its node.
//! - Messages carry neither the time nor the number that their publisher gave them (r2r 0.9 takes them with rcl's
//!   `rmw_message_info_t` and drops it): [`dermis_node::MessageInfo::source_ns`] and `publication` are `None`, and how many
//!   were lost on the way is not known.
//! - Services are those of the packages that a node itself needs: std_srvs, rcl_interfaces, lifecycle_msgs and ours; and the
//!   cancelling of an action's goals.
//! - A node that was killed stays in the graph until DDS gives it up (20 s with Fast DDS); its replacement reports
//!   a second node of its name so long.
//! - rcl reads the program's `--ros-args`, too, so that remappings `a:=b` and `b:=c` together take `a` to `c`.
//! - A client, and a call that was given up, is remembered until its node is closed.
//!
//! ```no_run
//! use dermis_node::{Node, NodeOptions};
//! use dermis_node_r2r::R2rBackend;
//!
//! let node = Node::open(NodeOptions::new("listener"), &R2rBackend)?;
//! # Ok::<(), dermis_node::NodeError>(())
//! ```

mod context;
mod services;
mod worker;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use dermis_msgs::TypeSupport;
use dermis_node::backend::{
    Backend, BackendClient, BackendEndpoint, BackendError, BackendNode, BackendPublisher, EndpointInfo,
    EndpointKind, GraphHook, MessageSink, NodeSpec, RequestSink, ServiceSupport,
};
use dermis_node::{Durability, History, Qos, Reliability};
use futures::FutureExt;
use futures::future::BoxFuture;
use r2r::qos::{DurabilityPolicy, HistoryPolicy, QosProfile, ReliabilityPolicy};

use crate::context::{context, open_to};
use crate::worker::Worker;

const NAME: &str = "r2r";

/// ROS 2 through rcl.
#[derive(Debug, Default)]
pub struct R2rBackend;

impl Backend for R2rBackend {
    fn name(&self) -> &'static str {
        NAME
    }

    fn open(&self, spec: &NodeSpec) -> Result<Arc<dyn BackendNode>, BackendError> {
        let context = context(spec)?;
        let node = r2r::Node::create(context, &spec.name, &spec.namespace).map_err(|e| {
            BackendError::Open { backend: NAME, node: spec.full_name(), reason: e.to_string() }
        })?;
        Ok(Arc::new(R2rNode {
            spec: spec.clone(),
            worker: Worker::start(node, &spec.full_name()),
            own: Mutex::default(),
        }))
    }
}

/// Own endpoints by name: rcl does not list all of them.
type Own = Mutex<Vec<(Arc<AtomicBool>, String, EndpointKind, EndpointInfo)>>;

struct R2rNode {
    spec: NodeSpec,
    worker: Worker,
    own: Own,
}

impl R2rNode {
    fn endpoint_error(what: &'static str, name: &str, e: &r2r::Error) -> BackendError {
        BackendError::Endpoint { what, name: name.to_owned(), reason: e.to_string() }
    }

    /// Remembers an own endpoint until the returned flag is cleared.
    fn remember(
        &self,
        name: &str,
        kind: EndpointKind,
        type_name: &str,
        hash: &str,
        qos: Option<Qos>,
    ) -> Arc<AtomicBool> {
        let alive = Arc::new(AtomicBool::new(true));
        let info = EndpointInfo {
            node: self.spec.full_name(),
            own: true,
            type_name: type_name.to_owned(),
            type_hash: Some(hash.to_owned()),
            qos,
        };
        let mut own = lock(&self.own);
        own.retain(|(alive, ..)| alive.load(Ordering::Acquire));
        own.push((Arc::clone(&alive), name.to_owned(), kind, info));
        alive
    }
}

impl BackendNode for R2rNode {
    fn open_to(&self) -> String {
        open_to(&self.spec.network)
    }

    fn publisher(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<Arc<dyn BackendPublisher>, BackendError> {
        let (name, kind, profile) = (topic.to_owned(), type_support.name, profile(qos));
        known_type(type_support.name)?;
        let publisher = self
            .worker
            .ask(move |w| {
                let made = w.node.create_publisher_untyped(&name, kind, profile);
                made.map_err(|e| refusal(&w.node, &name, kind, &e))
            })?
            .map_err(|reason| BackendError::Endpoint { what: "publisher", name: topic.to_owned(), reason })?;
        let alive =
            self.remember(topic, EndpointKind::Publisher, type_support.name, type_support.hash, Some(*qos));
        Ok(Arc::new(Publisher {
            topic: topic.to_owned(),
            inner: Mutex::new(publisher),
            worker: self.worker.clone(),
            alive,
        }))
    }

    fn subscribe(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
        sink: MessageSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        known_type(type_support.name)?;
        let alive = self.remember(
            topic,
            EndpointKind::Subscription,
            type_support.name,
            type_support.hash,
            Some(*qos),
        );
        let guard = Endpoint::new(alive);
        let (name, kind, profile, gate) = (topic.to_owned(), type_support.name, profile(qos), guard.gate());
        self.worker
            .ask(move |w| {
                let made =
                    w.node.subscribe_raw(&name, kind, profile).map(|s| Box::new(s) as worker::Messages);
                let messages = made.map_err(|e| refusal(&w.node, &name, kind, &e))?;
                w.subscriptions.push((gate, messages, sink));
                Ok(())
            })?
            .map_err(|reason| BackendError::Endpoint {
                what: "subscription",
                name: topic.to_owned(),
                reason,
            })?;
        Ok(Box::new(guard))
    }

    fn serve(
        &self,
        name: &str,
        service: &ServiceSupport,
        sink: RequestSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        let serve = services::server(service.name).ok_or_else(|| unknown(service.name))?;
        let alive = self.remember(name, EndpointKind::Service, service.name, service.hash, None);
        let guard = Endpoint::new(alive);
        let (owned, gate) = (name.to_owned(), guard.gate());
        self.worker
            .ask(move |w| {
                let server = serve(&mut w.node, &owned, sink)?;
                w.servers.push((gate, server));
                Ok(())
            })?
            .map_err(|e: r2r::Error| Self::endpoint_error("service", name, &e))?;
        Ok(Box::new(guard))
    }

    fn client(&self, name: &str, service: &ServiceSupport) -> Result<Arc<dyn BackendClient>, BackendError> {
        let make = services::client(service.name).ok_or_else(|| unknown(service.name))?;
        let alive = self.remember(name, EndpointKind::Client, service.name, service.hash, None);
        let guard = Endpoint::new(alive);
        let (owned, gate) = (name.to_owned(), guard.gate());
        let available = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&available);
        let call = self
            .worker
            .ask(move |w| {
                let client = make(&mut w.node, &owned)?;
                w.watches.push(worker::Watch::new(gate, client.poll, seen));
                Ok(client.call)
            })?
            .map_err(|e: r2r::Error| Self::endpoint_error("client", name, &e))?;
        Ok(Arc::new(Client { name: name.to_owned(), call, available, _guard: guard }))
    }

    fn node_names(&self) -> Result<Vec<String>, BackendError> {
        // rcl's list of nodes is not in r2r. Nodes of all client libraries publish parameter events, once each;
        // one that does not still has a log, or two: rcl's and its own.
        let ask = |w: &mut worker::State| {
            let events = w.node.get_publishers_info_by_topic("/parameter_events", false)?;
            Ok((events, w.node.get_publishers_info_by_topic("/rosout", false)?))
        };
        let (events, logs) =
            self.worker.ask(ask)?.map_err(|e: r2r::Error| BackendError::Graph { reason: e.to_string() })?;
        let mut names: Vec<String> =
            events.iter().filter_map(|i| node_of(&i.node_namespace, &i.node_name)).collect();
        for name in logs.iter().filter_map(|i| node_of(&i.node_namespace, &i.node_name)) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        Ok(names)
    }

    fn endpoints(&self, name: &str, kind: EndpointKind) -> Result<Vec<EndpointInfo>, BackendError> {
        if kind != EndpointKind::Publisher {
            let own = lock(&self.own);
            return Ok(own
                .iter()
                .filter(|(alive, n, k, _)| alive.load(Ordering::Acquire) && n == name && *k == kind)
                .map(|(.., info)| info.clone())
                .collect());
        }
        let topic = name.to_owned();
        let infos = self
            .worker
            .ask(move |w| w.node.get_publishers_info_by_topic(&topic, false))?
            .map_err(|e| BackendError::Graph { reason: e.to_string() })?;
        let full_name = self.spec.full_name();
        Ok(infos
            .iter()
            .filter_map(|i| {
                let node = node_of(&i.node_namespace, &i.node_name)?;
                Some(EndpointInfo {
                    own: node == full_name,
                    node,
                    type_name: i.topic_type.clone(),
                    type_hash: None,
                    qos: Some(policies(&i.qos_profile)),
                })
            })
            .collect())
    }

    fn topics(&self) -> Result<Vec<(String, String)>, BackendError> {
        self.worker
            .ask(|w| {
                let mut published = Vec::new();
                for (name, kinds) in w.node.get_topic_names_and_types()? {
                    if !w.node.get_publishers_info_by_topic(&name, false)?.is_empty() {
                        published.extend(kinds.into_iter().map(|kind| (name.clone(), kind)));
                    }
                }
                Ok(published)
            })?
            .map_err(|e: r2r::Error| BackendError::Graph { reason: e.to_string() })
    }

    fn on_graph_change(&self, _hook: GraphHook) {}

    fn close(&self) {
        self.worker.stop();
    }
}

impl Drop for R2rNode {
    fn drop(&mut self) {
        self.worker.stop();
    }
}

struct Publisher {
    topic: String,
    inner: Mutex<r2r::PublisherUntyped>,
    worker: Worker,
    alive: Arc<AtomicBool>,
}

impl BackendPublisher for Publisher {
    fn publish(&self, payload: &[u8]) -> Result<(), BackendError> {
        lock(&self.inner)
            .publish_raw(payload)
            .map_err(|e| BackendError::Send { name: self.topic.clone(), reason: e.to_string() })
    }

    fn subscriber_count(&self) -> usize {
        lock(&self.inner).get_inter_process_subscription_count().unwrap_or(0)
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.alive.store(false, Ordering::Release);
        let publisher = lock(&self.inner).clone();
        self.worker.tell(move |w| w.node.destroy_publisher_untyped(publisher));
    }
}

/// Whether an endpoint may still be called. The lock is held during a call, so that none runs after the drop.
pub(crate) type Gate = Arc<Mutex<bool>>;

struct Endpoint {
    gate: Gate,
    alive: Arc<AtomicBool>,
}

impl Endpoint {
    fn new(alive: Arc<AtomicBool>) -> Self {
        Self { gate: Arc::new(Mutex::new(true)), alive }
    }

    fn gate(&self) -> Gate {
        Arc::clone(&self.gate)
    }
}

impl BackendEndpoint for Endpoint {}

impl Drop for Endpoint {
    fn drop(&mut self) {
        self.alive.store(false, Ordering::Release);
        *lock(&self.gate) = false;
    }
}

struct Client {
    name: String,
    call: services::Call,
    available: Arc<AtomicBool>,
    _guard: Endpoint,
}

impl BackendClient for Client {
    fn available(&self) -> bool {
        self.available.load(Ordering::Acquire)
    }

    fn call(&self, request: &[u8], _timeout: Duration) -> BoxFuture<'static, Result<Bytes, BackendError>> {
        let name = self.name.clone();
        match (self.call)(request) {
            Ok(answer) => answer
                .map(move |a| a.map_err(|e| BackendError::NoAnswer { name, reason: e.to_string() }))
                .boxed(),
            Err(e) => futures::future::ready(Err(BackendError::Send { name, reason: e.to_string() })).boxed(),
        }
    }
}

fn unknown(type_name: &str) -> BackendError {
    BackendError::UnknownType { backend: NAME, type_name: type_name.to_owned() }
}

fn known_type(name: &str) -> Result<(), BackendError> {
    r2r::WrappedNativeMsgUntyped::new_from(name).map(drop).map_err(|_| unknown(name))
}

/// Why an endpoint was refused, which rcl's code does not tell.
fn refusal(node: &r2r::Node, topic: &str, wanted: &str, e: &r2r::Error) -> String {
    let types =
        node.get_topic_names_and_types().ok().and_then(|mut all| all.remove(topic)).unwrap_or_default();
    types.iter().find(|t| *t != wanted).map_or_else(
        || e.to_string(),
        |other| {
            format!("{wanted} is wanted where {other} is in use, and one process has one type for each topic ({e})")
        },
    )
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn profile(qos: &Qos) -> QosProfile {
    let p = QosProfile::default();
    let p = match qos.reliability {
        Reliability::BestEffort => p.best_effort(),
        Reliability::Reliable => p.reliable(),
    };
    let p = match qos.durability {
        Durability::Volatile => p.volatile(),
        Durability::TransientLocal => p.transient_local(),
    };
    match qos.history {
        History::KeepLast(depth) => p.keep_last(depth.max(1)),
        History::KeepAll => p.keep_all(),
    }
}

fn policies(profile: &QosProfile) -> Qos {
    Qos {
        reliability: match profile.reliability {
            ReliabilityPolicy::BestEffort => Reliability::BestEffort,
            _ => Reliability::Reliable,
        },
        durability: match profile.durability {
            DurabilityPolicy::TransientLocal => Durability::TransientLocal,
            _ => Durability::Volatile,
        },
        // DDS does not tell other nodes how much a publisher keeps: depth 0 means unknown there.
        history: match profile.history {
            HistoryPolicy::KeepAll => History::KeepAll,
            _ => History::KeepLast(profile.depth.max(1)),
        },
    }
}

/// `/namespace/name` of the node of an endpoint; `None` while only the endpoint has been discovered.
fn node_of(namespace: &str, name: &str) -> Option<String> {
    let known = !name.is_empty() && name != "_NODE_NAME_UNKNOWN_";
    known.then(|| format!("{}/{name}", namespace.trim_end_matches('/')))
}

#[cfg(test)]
mod tests;
