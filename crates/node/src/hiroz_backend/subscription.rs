//! Subscriptions: samples go from the queue of hiroz to the sink of the node.

use std::borrow::Cow;
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use hiroz::attachment::Attachment;
use hiroz::pubsub::ZSub;
use hiroz::queue::BoundedQueue;
use zenoh::bytes::ZBytes;
use zenoh::sample::Sample;

use super::{Raw, RawSerdes, off_runtime};
use crate::backend::{BackendEndpoint, MessageSink, Publication, RawMessage};
use crate::clock::system_now;
use crate::executor::lock;

/// The way from the queue of hiroz to the sink, on the thread that a sample comes by: that of zenoh, or that of a publisher in the
/// same session.
pub(super) struct Passage {
    ends: Mutex<Ends>,
}

struct Ends {
    /// Known once the subscription is made.
    queue: Option<Arc<BoundedQueue<Sample>>>,
    /// Taken out when the subscription is dropped.
    sink: Option<MessageSink>,
}

impl Passage {
    pub(super) fn new(sink: MessageSink) -> Self {
        Self { ends: Mutex::new(Ends { queue: None, sink: Some(sink) }) }
    }

    /// Hands on what has come, and from now on what comes.
    pub(super) fn open(&self, queue: Arc<BoundedQueue<Sample>>) {
        lock(&self.ends).queue = Some(queue);
        self.hand_on();
    }

    /// Hands on what has come. Samples are taken out under the lock, so that they keep their order, and so that whoever shuts the
    /// passage knows that none is on its way.
    pub(super) fn hand_on(&self) {
        lock(&self.ends).hand_on();
    }

    /// Hands on what has come, and nothing any more.
    fn shut(&self) {
        let sink = {
            let mut ends = lock(&self.ends);
            ends.hand_on();
            ends.sink.take()
        };
        drop(sink);
    }
}

impl Ends {
    fn hand_on(&self) {
        let Self { queue: Some(queue), sink: Some(sink) } = self else { return };
        while let Some(sample) = queue.try_recv() {
            sink(raw_message(&sample));
        }
    }
}

/// Withdraws the subscription when it is dropped, after what has arrived was handed on.
pub(super) struct HirozSubscription {
    pub(super) subscription: Option<ZSub<Raw, Sample, RawSerdes>>,
    pub(super) passage: Arc<Passage>,
}

impl BackendEndpoint for HirozSubscription {}

impl Drop for HirozSubscription {
    fn drop(&mut self) {
        let subscription = self.subscription.take();
        off_runtime(|| drop(subscription));
        self.passage.shut();
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
        payload: payload(sample.payload()),
        source_ns: attachment.map(|attachment| attachment.source_timestamp),
        received_ns: system_now(),
        publication,
    }
}

/// \[bytes\] From here on, a message keeps the buffer that it came in. zenoh receives up to 64 kB in one buffer, which a small
/// message in a long queue would keep whole; copying one of these takes less than a microsecond.
const KEPT: usize = 16 * 1024;

/// The bytes of a sample: a small one is copied, a large one stays where it lies, which is the publisher's own buffer where the
/// publisher shares the session.
fn payload(bytes: &ZBytes) -> Bytes {
    struct Whole(ZBytes);
    impl AsRef<[u8]> for Whole {
        fn as_ref(&self) -> &[u8] {
            self.0.slices().next().unwrap_or_default()
        }
    }
    match bytes.to_bytes() {
        Cow::Borrowed(slice) if slice.len() >= KEPT => Bytes::from_owner(Whole(bytes.clone())),
        // What came in fragments was joined.
        joined => Bytes::from(joined.into_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_message_is_not_copied_and_one_in_fragments_is_whole() {
        for length in [0, 1, KEPT - 1, KEPT, 3 * KEPT] {
            let bytes: Vec<u8> = (0..length).map(|i| (i % 251) as u8).collect();
            let one = ZBytes::from(bytes.clone());
            let place = one.slices().next().map(<[u8]>::as_ptr);
            let read = payload(&one);
            assert_eq!(read, bytes);
            assert_eq!(Some(read.as_ptr()) == place, length >= KEPT, "{length} bytes");
            let mut writer = ZBytes::writer();
            let (first, rest) = bytes.split_at(length / 2);
            writer.append(ZBytes::from(first.to_vec()));
            writer.append(ZBytes::from(rest.to_vec()));
            assert_eq!(payload(&writer.finish()), bytes);
        }
    }
}
