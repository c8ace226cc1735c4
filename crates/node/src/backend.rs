//! What a ROS 2 implementation has to give so that dermis nodes can run over it.
//!
//! A backend moves CDR bytes between names. Everything that is ROS semantics but not wire (parameter and
//! lifecycle services, `/clock`, diagnostics, name remapping, callback scheduling, keep-last queues) is
//! written once above this trait, so that every backend behaves alike.
//!
//! All names that reach a backend are fully qualified and valid (`/ns/topic`), and already remapped.
//! Payloads are CDR with the four byte encapsulation header (`00 01 00 00`).

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
pub use dermis_msgs::ServiceSupport;
use dermis_msgs::{Service, TypeSupport};
use futures::future::BoxFuture;

use crate::network::Network;
use crate::qos::Qos;

/// Receives a message. Called from any thread of the backend; returns at once and never blocks, because
/// it only queues.
pub type MessageSink = Box<dyn Fn(RawMessage) + Send + Sync>;

/// Receives a service request. Called from any thread of the backend; returns at once and never blocks.
pub type RequestSink = Box<dyn Fn(RawRequest) + Send + Sync>;

/// Sends the encoded response of a service.
pub type Reply = Box<dyn FnOnce(&[u8]) -> Result<(), BackendError> + Send>;

/// Called after endpoints or nodes appeared or went. Returns at once.
pub type GraphHook = Box<dyn Fn() + Send + Sync>;

/// A ROS 2 implementation.
pub trait Backend: Send + Sync + 'static {
    /// Short name for diagnostics: `hiroz`, `r2r`.
    fn name(&self) -> &'static str;

    /// Joins the domain with one node.
    ///
    /// # Errors
    ///
    /// When the network or the ROS installation refuses; the message says which setting to change.
    fn open(&self, spec: &NodeSpec) -> Result<Arc<dyn BackendNode>, BackendError>;
}

/// What a backend needs to know of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeSpec {
    /// Node name without namespace.
    pub name: String,
    /// Absolute namespace: `/` or `/left/arm`.
    pub namespace: String,
    /// ROS domain id.
    pub domain_id: u16,
    /// How far the node reaches.
    pub network: Network,
}

impl NodeSpec {
    /// `/namespace/name`.
    #[must_use]
    pub fn full_name(&self) -> String {
        crate::names::join(&self.namespace, &self.name)
    }
}

/// One node on the network. Dropping it leaves the network, as [`BackendNode::close`] does.
pub trait BackendNode: Send + Sync {
    /// What this node is open to and to whom, in one sentence for people.
    fn open_to(&self) -> String;

    /// Announces a publisher.
    ///
    /// # Errors
    ///
    /// When the type is unknown to the backend or the endpoint cannot be made.
    fn publisher(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<Arc<dyn BackendPublisher>, BackendError>;

    /// Announces a publisher of a stream, which never waits for a peer, whatever reliability it offers. Over DDS every
    /// publisher that keeps the last messages only is one: what a slow reader has not confirmed is overwritten.
    ///
    /// # Errors
    ///
    /// When the type is unknown to the backend or the endpoint cannot be made.
    fn stream_publisher(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<Arc<dyn BackendPublisher>, BackendError> {
        self.publisher(topic, type_support, qos)
    }

    /// Announces a subscription. Messages go into `sink` in the order of arrival until the endpoint is
    /// dropped; after the drop returned, `sink` is not called again.
    ///
    /// # Errors
    ///
    /// When the type is unknown to the backend or the endpoint cannot be made.
    fn subscribe(
        &self,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: &Qos,
        sink: MessageSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError>;

    /// Announces a service. Requests go into `sink` until the endpoint is dropped.
    ///
    /// # Errors
    ///
    /// When the type is unknown to the backend or the endpoint cannot be made.
    fn serve(
        &self,
        name: &str,
        service: &ServiceSupport,
        sink: RequestSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError>;

    /// Makes a client of a service.
    ///
    /// # Errors
    ///
    /// When the type is unknown to the backend or the endpoint cannot be made.
    fn client(&self, name: &str, service: &ServiceSupport) -> Result<Arc<dyn BackendClient>, BackendError>;

    /// Full names (`/ns/name`) of all nodes seen in the domain, this one included, one entry for each
    /// instance: two nodes of one name are two entries.
    ///
    /// # Errors
    ///
    /// When the graph cannot be read.
    fn node_names(&self) -> Result<Vec<String>, BackendError>;

    /// All endpoints of one kind on a topic or service, own ones included.
    ///
    /// # Errors
    ///
    /// When the graph cannot be read.
    fn endpoints(&self, name: &str, kind: EndpointKind) -> Result<Vec<EndpointInfo>, BackendError>;

    /// Every topic that somebody publishes, own ones included, with its type (`pkg/msg/Type`).
    ///
    /// # Errors
    ///
    /// When the graph cannot be read.
    fn topics(&self) -> Result<Vec<(String, String)>, BackendError>;

    /// Calls `hook` after each change of the graph. A backend that cannot tell ignores it; the graph is
    /// checked once a second anyway.
    fn on_graph_change(&self, hook: GraphHook);

    /// Leaves the network. Endpoints of this node do nothing afterwards, and a second call neither.
    fn close(&self);
}

/// A publisher on the network. Dropping it withdraws it.
pub trait BackendPublisher: Send + Sync {
    /// Sends one encoded message. With a best effort [`Qos`], or as a stream, this never waits for a peer.
    ///
    /// # Errors
    ///
    /// When the message could not be handed to the network.
    fn publish(&self, payload: &[u8]) -> Result<(), BackendError>;

    /// How many subscriptions would get a message now. Cheap: callers ask once per frame.
    fn subscriber_count(&self) -> usize;
}

/// A subscription or service on the network. Dropping it withdraws it.
pub trait BackendEndpoint: Send + Sync {}

/// A service client on the network.
pub trait BackendClient: Send + Sync {
    /// Whether a server is there.
    fn available(&self) -> bool;

    /// Sends a request and yields the response. The caller gives up after `timeout` by dropping the
    /// future; the backend may free what it holds for the call then. The future may be
    /// polled on any executor.
    fn call(&self, request: &[u8], timeout: Duration) -> BoxFuture<'static, Result<Bytes, BackendError>>;
}

/// One message as it came.
#[derive(Debug, Clone)]
pub struct RawMessage {
    /// CDR with encapsulation header.
    pub payload: Bytes,
    /// When the sender published it, ns since the epoch, where the wire tells.
    pub source_ns: Option<i64>,
    /// When it arrived here, ns since the epoch (system clock).
    pub received_ns: i64,
    /// Who published it, and its number there, where the wire tells.
    pub publication: Option<Publication>,
}

/// A message as its publisher counts it. A step of more than one from a publisher is a loss; a publisher that was
/// started again has another id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Publication {
    /// Unique id of the publisher (`gid`).
    pub publisher: [u8; 16],
    /// Number of the message at this publisher; where it begins is up to the implementation.
    pub number: u64,
}

/// One service request as it came, with the way back.
pub struct RawRequest {
    /// CDR with encapsulation header.
    pub payload: Bytes,
    /// Sends the encoded response. May block shortly; called from a thread of the node, not of the backend.
    pub reply: Reply,
}

/// The support of a generated service type.
#[must_use]
pub fn service_support_of<S: Service>() -> ServiceSupport {
    ServiceSupport {
        name: S::TYPE_NAME,
        hash: S::TYPE_HASH,
        request: TypeSupport::of::<S::Request>(),
        response: TypeSupport::of::<S::Response>(),
    }
}

/// Kind of an endpoint in the graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EndpointKind {
    /// Publishes on a topic.
    Publisher,
    /// Subscribes to a topic.
    Subscription,
    /// Serves a service.
    Service,
    /// Calls a service.
    Client,
}

/// One endpoint in the graph, with what the backend could learn of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EndpointInfo {
    /// Full name of its node.
    pub node: String,
    /// Whether it belongs to this node.
    pub own: bool,
    /// `pkg/msg/Type`, or empty where unknown.
    pub type_name: String,
    /// `RIHS01_…`, where the backend tells.
    pub type_hash: Option<String>,
    /// Its policies, where the backend tells.
    pub qos: Option<Qos>,
}

/// Failures below the node API.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BackendError {
    /// Joining the network failed.
    #[error("cannot open node {node} over {backend}: {reason}")]
    Open {
        /// Backend name.
        backend: &'static str,
        /// Full node name.
        node: String,
        /// What the network said, and what to change.
        reason: String,
    },
    /// An endpoint could not be made.
    #[error("cannot create {what} on {name}: {reason}")]
    Endpoint {
        /// `publisher`, `subscription`, `service`, `client`.
        what: &'static str,
        /// Topic or service.
        name: String,
        /// What the network said.
        reason: String,
    },
    /// The backend has no code for this type.
    #[error(
        "type {type_name} is not known to the {backend} backend: build the backend with its package sourced"
    )]
    UnknownType {
        /// Backend name.
        backend: &'static str,
        /// `pkg/msg/Type`.
        type_name: String,
    },
    /// Sending failed.
    #[error("cannot send on {name}: {reason}")]
    Send {
        /// Topic or service.
        name: String,
        /// What the network said.
        reason: String,
    },
    /// No server answered a call.
    #[error("service {name} gave no answer: {reason}")]
    NoAnswer {
        /// Service.
        name: String,
        /// What the network said.
        reason: String,
    },
    /// The graph could not be read.
    #[error("cannot read the ROS graph: {reason}")]
    Graph {
        /// What the network said.
        reason: String,
    },
    /// The node has left the network.
    #[error("node {node} is closed")]
    Closed {
        /// Full node name.
        node: String,
    },
}
