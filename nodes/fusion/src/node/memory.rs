//! A backend that carries messages within the process, for tests: topics only.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::{SystemTime, UNIX_EPOCH};

use dermis_msgs::{ServiceSupport, TypeSupport};
use dermis_node::backend::{
    BackendClient, BackendEndpoint, BackendError, BackendNode, BackendPublisher, EndpointInfo, EndpointKind,
    GraphHook, MessageSink, NodeSpec, RawMessage, RequestSink,
};
use dermis_node::{Backend, Durability, Publication, Qos};

#[derive(Default)]
struct Topic {
    sinks: Vec<Weak<MessageSink>>,
    /// The last message of a latched topic.
    latched: Option<RawMessage>,
}

type Topics = Arc<Mutex<BTreeMap<String, Topic>>>;

/// Nodes that are opened on one of these hear each other.
#[derive(Clone, Default)]
pub(super) struct Memory(Topics);

impl Backend for Memory {
    fn name(&self) -> &'static str {
        "memory"
    }

    fn open(&self, _: &NodeSpec) -> Result<Arc<dyn BackendNode>, BackendError> {
        Ok(Arc::new(MemoryNode(Arc::clone(&self.0))))
    }
}

struct MemoryNode(Topics);

struct Sender {
    topics: Topics,
    topic: String,
    latched: bool,
    id: [u8; 16],
    sent: AtomicU64,
}

impl BackendPublisher for Sender {
    fn publish(&self, payload: &[u8]) -> Result<(), BackendError> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as i64;
        let number = self.sent.fetch_add(1, Ordering::Relaxed);
        let message = RawMessage {
            payload: payload.to_vec().into(),
            source_ns: Some(now),
            received_ns: now,
            publication: Some(Publication { publisher: self.id, number }),
        };
        let mut topics = self.topics.lock().unwrap();
        let topic = topics.entry(self.topic.clone()).or_default();
        topic.sinks.retain(|sink| sink.strong_count() > 0);
        topic.sinks.iter().filter_map(Weak::upgrade).for_each(|sink| sink(message.clone()));
        topic.latched = self.latched.then_some(message);
        Ok(())
    }

    fn subscriber_count(&self) -> usize {
        let topics = self.topics.lock().unwrap();
        topics.get(&self.topic).map_or(0, |t| t.sinks.iter().filter(|s| s.strong_count() > 0).count())
    }
}

struct Held(#[expect(dead_code, reason = "held for its drop")] Option<Arc<MessageSink>>);

impl BackendEndpoint for Held {}

fn none(name: &str) -> BackendError {
    BackendError::NoAnswer { name: name.to_owned(), reason: "there are topics only".into() }
}

impl BackendNode for MemoryNode {
    fn open_to(&self) -> String {
        "open to this process".into()
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
        let (topics, topic) = (Arc::clone(&self.0), topic.to_owned());
        Ok(Arc::new(Sender { topics, topic, latched, id, sent: AtomicU64::new(0) }))
    }

    fn subscribe(
        &self,
        topic: &str,
        _: &'static TypeSupport,
        _: &Qos,
        sink: MessageSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        let sink = Arc::new(sink);
        let mut topics = self.0.lock().unwrap();
        let topic = topics.entry(topic.to_owned()).or_default();
        if let Some(message) = &topic.latched {
            sink(message.clone());
        }
        topic.sinks.push(Arc::downgrade(&sink));
        Ok(Box::new(Held(Some(sink))))
    }

    fn serve(
        &self,
        _: &str,
        _: &ServiceSupport,
        _: RequestSink,
    ) -> Result<Box<dyn BackendEndpoint>, BackendError> {
        Ok(Box::new(Held(None)))
    }

    fn client(&self, name: &str, _: &ServiceSupport) -> Result<Arc<dyn BackendClient>, BackendError> {
        Err(none(name))
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
