//! Publishers: one that waits for its peers where it is reliable, and one that never does.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicUsize, Ordering};
use std::sync::{Arc, Weak};

use hiroz::attachment::{Attachment, GidArray};
use hiroz::pubsub::ZPub;
use zenoh::Wait;

use super::{Raw, RawSerdes, Shared, off_runtime};
use crate::backend::{BackendError, BackendPublisher};
use crate::executor::lock;

/// A publisher that hiroz sends for; a reliable one waits for its peers.
pub(super) struct HirozPublisher {
    pub(super) topic: String,
    pub(super) publisher: Option<(ZPub<Raw, RawSerdes>, zenoh::pubsub::Publisher<'static>)>,
    pub(super) count: Arc<AtomicUsize>,
    pub(super) watched: Arc<AtomicBool>,
    pub(super) id: u64,
    pub(super) shared: Weak<Shared>,
}

impl HirozPublisher {
    fn not_sent(&self, error: &zenoh::Error) -> BackendError {
        BackendError::Send { name: self.topic.clone(), reason: error.to_string() }
    }
}

impl BackendPublisher for HirozPublisher {
    fn publish(&self, payload: &[u8]) -> Result<(), BackendError> {
        let Some((publisher, _)) = &self.publisher else { return Ok(()) };
        publisher.publish_serialized(payload).map_err(|error| self.not_sent(&error))
    }

    fn subscriber_count(&self) -> usize {
        let plain = usize::from(self.watched.load(Ordering::Acquire));
        self.count.load(Ordering::Acquire).max(plain)
    }
}

impl Drop for HirozPublisher {
    fn drop(&mut self) {
        if let Some(shared) = self.shared.upgrade() {
            lock(&shared.publishers).remove(&self.id);
        }
        let publisher = self.publisher.take();
        off_runtime(|| drop(publisher));
    }
}

/// A publisher that offers reliable delivery and never waits. hiroz makes each reliable publisher wait for its peers, up to a
/// minute for one that stopped reading; `rmw_zenoh` does so only for one that keeps all messages. So hiroz announces the
/// publisher, and its messages go another way.
pub(super) struct HirozStream {
    publisher: HirozPublisher,
    sequence: AtomicI64,
    gid: GidArray,
}

impl HirozStream {
    pub(super) fn new(publisher: HirozPublisher) -> Self {
        let entity = publisher.publisher.as_ref().map(|(announced, _)| announced.entity());
        let gid = entity.and_then(hiroz::entity::endpoint_gid).unwrap_or_default();
        Self { publisher, sequence: AtomicI64::new(0), gid }
    }
}

impl BackendPublisher for HirozStream {
    fn publish(&self, payload: &[u8]) -> Result<(), BackendError> {
        let Some((_, sender)) = &self.publisher.publisher else { return Ok(()) };
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        sender
            .put(payload)
            .attachment(Attachment::new(sequence, self.gid))
            .wait()
            .map_err(|error| self.publisher.not_sent(&error))
    }

    fn subscriber_count(&self) -> usize {
        self.publisher.subscriber_count()
    }
}
