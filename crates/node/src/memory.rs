//! A backend that carries messages and calls within the process, for tests of nodes: no network, no discovery, no waiting.
//!
//! Nodes that are opened on one [`Memory`] hear each other, in whatever domain they are. The graph is empty.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use bytes::Bytes;
use dermis_msgs::TypeSupport;
use futures::FutureExt as _;
use futures::future::BoxFuture;

use crate::backend::{
    Backend, BackendClient, BackendEndpoint, BackendError, BackendNode, BackendPublisher, EndpointInfo,
    EndpointKind, GraphHook, MessageSink, NodeSpec, Publication, RawMessage, RawRequest, RequestSink,
    ServiceSupport,
};
use crate::clock::system_now;
use crate::executor::lock;
use crate::qos::{Durability, Qos};

#[derive(Default)]
struct Topic {
    sinks: Vec<Weak<MessageSink>>,
    /// The last message of a latched topic.
    latched: Option<RawMessage>,
}

#[derive(Default)]
struct Bus {
    topics: Mutex<BTreeMap<String, Topic>>,
    services: Mutex<BTreeMap<String, Weak<RequestSink>>>,
}

/// Nodes that are opened on one of these, or on a clone of it, hear each other.
#[derive(Clone, Default)]
pub struct Memory(Arc<Bus>);

impl Backend for Memory {
    fn name(&self) -> &'static str {
        "memory"
    }

    fn open(&self, _: &NodeSpec) -> Result<Arc<dyn BackendNode>, BackendError> {
        Ok(Arc::new(MemoryNode(Arc::clone(&self.0))))
    }
}

struct MemoryNode(Arc<Bus>);

struct Sender {
    bus: Arc<Bus>,
    topic: String,
    latched: bool,
    id: [u8; 16],
    sent: AtomicU64,
}

impl BackendPublisher for Sender {
    fn publish(&self, payload: &[u8]) -> Result<(), BackendError> {
        let now = system_now();
        let number = self.sent.fetch_add(1, Ordering::Relaxed);
        let message = RawMessage {
            payload: Bytes::copy_from_slice(payload),
            source_ns: Some(now),
            received_ns: now,
            publication: Some(Publication { publisher: self.id, number }),
        };
        let mut topics = lock(&self.bus.topics);
        let topic = topics.entry(self.topic.clone()).or_default();
        topic.sinks.retain(|sink| sink.strong_count() > 0);
        topic.sinks.iter().filter_map(Weak::upgrade).for_each(|sink| sink(message.clone()));
        topic.latched = self.latched.then_some(message);
        Ok(())
    }

    fn subscriber_count(&self) -> usize {
        let topics = lock(&self.bus.topics);
        topics.get(&self.topic).map_or(0, |t| t.sinks.iter().filter(|s| s.strong_count() > 0).count())
    }
}

/// What a subscription or a service lives by.
struct Held<T>(#[expect(dead_code, reason = "held for its drop")] Arc<T>);

impl<T: Send + Sync> BackendEndpoint for Held<T> {}

struct Caller {
    bus: Arc<Bus>,
    name: String,
}

impl Caller {
    fn server(&self) -> Option<Arc<RequestSink>> {
        lock(&self.bus.services).get(&self.name).and_then(Weak::upgrade)
    }
}

impl BackendClient for Caller {
    fn available(&self) -> bool {
        self.server().is_some()
    }

    fn call(&self, request: &[u8], _: Duration) -> BoxFuture<'static, Result<Bytes, BackendError>> {
        let none = BackendError::NoAnswer { name: self.name.clone(), reason: "nobody serves it".to_owned() };
        let Some(server) = self.server() else { return futures::future::ready(Err(none)).boxed() };
        let (answer, answered) = futures::channel::oneshot::channel();
        let reply = Box::new(move |response: &[u8]| {
            // Who gave up waiting has no use for the answer.
            let _ = answer.send(Bytes::copy_from_slice(response));
            Ok(())
        });
        server(RawRequest { payload: Bytes::copy_from_slice(request), reply });
        async move { answered.await.map_err(|_| none) }.boxed()
    }
}

impl BackendNode for MemoryNode {
    fn open_to(&self) -> String {
        "open to this process".to_owned()
    }

    fn publisher(
        &self,
        topic: &str,
        _: &'static TypeSupport,
        qos: &Qos,
    ) -> Result<Arc<dyn BackendPublisher>, BackendError> {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let id = u128::from(NEXT.fetch_add(1, Ordering::Relaxed)).to_le_bytes();
        let latched = qos.durability == Durability::TransientLocal;
        let (bus, topic) = (Arc::clone(&self.0), topic.to_owned());
        Ok(Arc::new(Sender { bus, topic, latched, id, sent: AtomicU64::new(0) }))
    }

    fn subscribe(
        &self,
        topic: &str,
        _: &'static TypeSupport,
        _: &Qos,
        sink: MessageSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        let sink = Arc::new(sink);
        let mut topics = lock(&self.0.topics);
        let topic = topics.entry(topic.to_owned()).or_default();
        if let Some(message) = &topic.latched {
            sink(message.clone());
        }
        topic.sinks.push(Arc::downgrade(&sink));
        Ok(Box::new(Held(sink)))
    }

    fn serve(
        &self,
        name: &str,
        _: &ServiceSupport,
        sink: RequestSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        let sink = Arc::new(sink);
        lock(&self.0.services).insert(name.to_owned(), Arc::downgrade(&sink));
        Ok(Box::new(Held(sink)))
    }

    fn client(&self, name: &str, _: &ServiceSupport) -> Result<Arc<dyn BackendClient>, BackendError> {
        Ok(Arc::new(Caller { bus: Arc::clone(&self.0), name: name.to_owned() }))
    }

    fn node_names(&self) -> Result<Vec<String>, BackendError> {
        Ok(Vec::new())
    }

    fn endpoints(&self, _: &str, _: EndpointKind) -> Result<Vec<EndpointInfo>, BackendError> {
        Ok(Vec::new())
    }

    fn topics(&self) -> Result<Vec<(String, String)>, BackendError> {
        Ok(Vec::new())
    }

    fn on_graph_change(&self, _: GraphHook) {}

    fn close(&self) {}
}
