//! Subscriptions: samples go from the queue of hiroz to the sink of the node.

use std::sync::{Arc, Mutex};
use std::task::Poll;

use bytes::Bytes;
use hiroz::attachment::Attachment;
use hiroz::pubsub::ZSub;
use hiroz::queue::BoundedQueue;
use zenoh::sample::Sample;

use super::{Raw, RawSerdes, off_runtime};
use crate::backend::{BackendEndpoint, MessageSink, Publication, RawMessage};
use crate::clock::system_now;
use crate::executor::lock;

/// Where the samples of a subscription go; taken out when it is dropped.
pub(super) type Gate = Arc<Mutex<Option<MessageSink>>>;

/// Hands samples on as they come, until the gate is shut. A sample is taken out of the queue under the lock of the gate, so
/// that whoever shuts the gate knows that none is on its way between them.
pub(super) async fn hand_on(queue: Arc<BoundedQueue<Sample>>, gate: Gate) {
    /// Samples after which others get their turn on the runtime.
    const TURN: usize = 64;
    let mut next = Box::pin(queue.recv_async());
    std::future::poll_fn(|context| {
        for _ in 0..TURN {
            let gate = lock(&gate);
            let Some(sink) = &*gate else { return Poll::Ready(()) };
            match next.as_mut().poll(context) {
                Poll::Ready(sample) => sink(raw_message(&sample)),
                Poll::Pending => return Poll::Pending,
            }
            next.set(queue.recv_async());
        }
        context.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// Withdraws the subscription when it is dropped, after what has arrived was handed on.
pub(super) struct HirozSubscription {
    pub(super) subscription: Option<ZSub<Raw, Sample, RawSerdes>>,
    /// Samples that have arrived and were not handed on yet.
    pub(super) waiting: Arc<BoundedQueue<Sample>>,
    pub(super) gate: Gate,
    pub(super) task: tokio::task::AbortHandle,
}

impl BackendEndpoint for HirozSubscription {}

impl Drop for HirozSubscription {
    fn drop(&mut self) {
        let subscription = self.subscription.take();
        off_runtime(|| drop(subscription));
        let sink = {
            let mut gate = lock(&self.gate);
            // What has arrived is not lost.
            while let Some(sink) = &*gate
                && let Some(sample) = self.waiting.try_recv()
            {
                sink(raw_message(&sample));
            }
            gate.take()
        };
        drop(sink);
        self.task.abort();
    }
}

fn raw_message(sample: &Sample) -> RawMessage {
    // A plain zenoh client publishes without an attachment.
    let attachment = sample.attachment().and_then(|bytes| Attachment::try_from(bytes).ok());
    let publication = attachment.as_ref().and_then(|attachment| {
        let number = u64::try_from(attachment.sequence_number).ok()?;
        Some(Publication { publisher: attachment.source_gid, number })
    });
    RawMessage {
        payload: Bytes::from(sample.payload().to_bytes().into_owned()),
        source_ns: attachment.map(|attachment| attachment.source_timestamp),
        received_ns: system_now(),
        publication,
    }
}
