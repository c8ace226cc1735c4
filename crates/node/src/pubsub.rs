//! Publishers and subscriptions.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use dermis_msgs::sequence::{LossCounter, Losses};
use dermis_msgs::{Message, TypeSupport};

use crate::backend::{BackendEndpoint, BackendPublisher, EndpointKind, Publication, RawMessage};
use crate::error::NodeError;
use crate::executor::{Lane, lock};
use crate::names::NameKind;
use crate::node::{Close, Core, Registration};
use crate::qos::Qos;
use crate::watch::OwnEndpoint;

/// What is known of a message beside its content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct MessageInfo {
    /// When the sender published it, ns since the epoch by its clock, where the wire tells.
    pub source_ns: Option<i64>,
    /// When it arrived here, ns since the epoch by the system clock.
    pub received_ns: i64,
    /// Who published it, and its number there, where the wire tells.
    pub publication: Option<Publication>,
}

impl MessageInfo {
    fn of(message: &RawMessage) -> Self {
        Self {
            source_ns: message.source_ns,
            received_ns: message.received_ns,
            publication: message.publication,
        }
    }
}

/// Counts what was lost on the way to a subscription, by the numbers that publishers give their messages.
#[derive(Debug, Default)]
pub struct PublicationCounter(LossCounter<[u8; 16]>);

impl PublicationCounter {
    /// A message came.
    pub fn observe(&mut self, publication: Option<Publication>, source_ns: Option<i64>) {
        match publication {
            Some(Publication { publisher, number }) => {
                self.0.observe(&publisher, number, source_ns);
            }
            None => self.0.observe_unnumbered(),
        }
    }

    /// What is missing so far.
    #[must_use]
    pub fn losses(&self) -> Losses {
        self.0.losses()
    }
}

pub(crate) struct PublisherInner {
    core: Arc<Core>,
    topic: String,
    backend: RwLock<Option<Arc<dyn BackendPublisher>>>,
    published: AtomicU64,
    _registration: Registration,
}

impl Close for PublisherInner {
    fn close(&self) {
        let backend = self.backend.write().unwrap_or_else(PoisonError::into_inner).take();
        drop(backend);
    }
}

/// Who decides how fast a reliable publisher is.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Pace {
    /// A reader that does not read holds it up.
    OfReaders,
    /// It holds nobody's messages back: what a reader has no room for is dropped.
    Own,
}

/// A publisher of encoded messages. Cheap to clone; the last clone withdraws it.
#[derive(Clone)]
pub struct RawPublisher(Arc<PublisherInner>);

impl RawPublisher {
    pub(crate) fn new(
        core: &Arc<Core>,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: Qos,
        pace: Pace,
    ) -> Result<Self, NodeError> {
        let topic = core.names.resolve(topic, NameKind::Topic)?;
        core.check_open()?;
        let registration = core.register(OwnEndpoint {
            kind: EndpointKind::Publisher,
            name: topic.clone(),
            type_name: type_support.name,
            type_hash: type_support.hash,
            qos: Some(qos),
        });
        let backend = match pace {
            Pace::OfReaders => core.node.publisher(&topic, type_support, &qos)?,
            Pace::Own => core.node.stream_publisher(&topic, type_support, &qos)?,
        };
        let inner = Arc::new(PublisherInner {
            core: Arc::clone(core),
            topic,
            backend: RwLock::new(Some(backend)),
            published: AtomicU64::new(0),
            _registration: registration,
        });
        core.track(&inner);
        Ok(Self(inner))
    }

    /// The full name of its topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        &self.0.topic
    }

    /// Sends a message that is encoded already (CDR with its encapsulation header).
    ///
    /// # Errors
    ///
    /// When the node is shut down or the network refuses.
    pub fn publish_cdr(&self, payload: &[u8]) -> Result<(), NodeError> {
        let backend = self.0.backend.read().unwrap_or_else(PoisonError::into_inner).clone();
        let Some(backend) = backend else {
            return Err(self.0.core.shut_down());
        };
        backend.publish(payload)?;
        self.0.published.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// How many subscriptions would get a message now. Cheap enough to ask before each frame, so that
    /// what nobody wants is not computed.
    #[must_use]
    pub fn subscriber_count(&self) -> usize {
        let backend = self.0.backend.read().unwrap_or_else(PoisonError::into_inner);
        backend.as_ref().map_or(0, |backend| backend.subscriber_count())
    }

    /// How many messages were sent.
    #[must_use]
    pub fn published(&self) -> u64 {
        self.0.published.load(Ordering::Relaxed)
    }
}

/// A publisher of one message type. Cheap to clone; the last clone withdraws it.
pub struct Publisher<T> {
    raw: RawPublisher,
    message: PhantomData<fn(T)>,
}

impl<T> Clone for Publisher<T> {
    fn clone(&self) -> Self {
        Self { raw: self.raw.clone(), message: PhantomData }
    }
}

impl<T: Message> Publisher<T> {
    pub(crate) fn new(core: &Arc<Core>, topic: &str, qos: Qos, pace: Pace) -> Result<Self, NodeError> {
        let raw = RawPublisher::new(core, topic, TypeSupport::of::<T>(), qos, pace)?;
        Ok(Self { raw, message: PhantomData })
    }

    /// Encodes and sends a message.
    ///
    /// # Errors
    ///
    /// When the node is shut down or the network refuses.
    pub fn publish(&self, message: &T) -> Result<(), NodeError> {
        self.raw.publish_cdr(&message.to_cdr())
    }

    /// Sends a message of type `T` that is encoded already (CDR with its encapsulation header).
    ///
    /// # Errors
    ///
    /// When the node is shut down or the network refuses.
    pub fn publish_cdr(&self, payload: &[u8]) -> Result<(), NodeError> {
        self.raw.publish_cdr(payload)
    }

    /// Publishes what `make` gives if somebody listens. What the network refuses is logged, and lost.
    pub fn offer(&self, make: impl FnOnce() -> Option<T>) {
        if self.subscriber_count() == 0 {
            return;
        }
        if let Some(message) = make()
            && let Err(error) = self.publish(&message)
        {
            tracing::debug!("{error}");
        }
    }

    /// How many subscriptions would get a message now; see [`RawPublisher::subscriber_count`].
    #[must_use]
    pub fn subscriber_count(&self) -> usize {
        self.raw.subscriber_count()
    }

    /// How many messages were sent.
    #[must_use]
    pub fn published(&self) -> u64 {
        self.raw.published()
    }

    /// The full name of its topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        self.raw.topic()
    }
}

pub(crate) struct SubscriptionInner {
    topic: String,
    endpoint: Mutex<Option<Box<dyn BackendEndpoint>>>,
    lane: Arc<Lane<RawMessage>>,
    /// What is missing of what was published, as it arrives: before the queue.
    missing: Arc<Mutex<PublicationCounter>>,
    rejected: Arc<AtomicU64>,
    _registration: Registration,
}

impl SubscriptionInner {
    pub(crate) fn topic(&self) -> &str {
        &self.topic
    }

    pub(crate) fn counts(&self) -> (Losses, u64) {
        (lock(&self.missing).losses(), self.lane.dropped())
    }
}

impl Close for SubscriptionInner {
    fn close(&self) {
        let endpoint = lock(&self.endpoint).take();
        drop(endpoint);
        self.lane.close();
    }
}

impl Drop for SubscriptionInner {
    fn drop(&mut self) {
        self.close();
    }
}

/// Messages that arrived and that the callback of a subscription never had.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Unread {
    /// Dropped for newer ones, as [`Subscription::dropped`] counts.
    pub dropped: u64,
    /// Still waiting at the end.
    pub waiting: u64,
}

/// A subscription. Its callback is called until this is dropped or the node is shut down.
#[must_use = "a subscription that is dropped receives nothing"]
pub struct Subscription(Arc<SubscriptionInner>);

impl Subscription {
    pub(crate) fn new(
        core: &Arc<Core>,
        topic: &str,
        type_support: &'static TypeSupport,
        qos: Qos,
        rejected: Arc<AtomicU64>,
        mut callback: impl FnMut(&[u8], MessageInfo) + Send + 'static,
    ) -> Result<Self, NodeError> {
        let topic = core.names.resolve(topic, NameKind::Topic)?;
        core.check_open()?;
        let registration = core.register(OwnEndpoint {
            kind: EndpointKind::Subscription,
            name: topic.clone(),
            type_name: type_support.name,
            type_hash: type_support.hash,
            qos: Some(qos),
        });
        let lane = core.executor.lane(topic.clone(), qos.depth(), move |message: RawMessage| {
            callback(&message.payload, MessageInfo::of(&message));
        });
        let sink = Arc::clone(&lane);
        let missing = Arc::new(Mutex::new(PublicationCounter::default()));
        let counter = Arc::clone(&missing);
        let take = move |message: RawMessage| {
            lock(&counter).observe(message.publication, message.source_ns);
            sink.push(message);
        };
        let endpoint = core.node.subscribe(&topic, type_support, &qos, Box::new(take))?;
        let inner = Arc::new(SubscriptionInner {
            topic,
            endpoint: Mutex::new(Some(endpoint)),
            lane,
            missing,
            rejected,
            _registration: registration,
        });
        core.track(&inner);
        core.watch_losses(&inner);
        Ok(Self(inner))
    }

    pub(crate) fn typed<T: Message>(
        core: &Arc<Core>,
        topic: &str,
        qos: Qos,
        mut callback: impl FnMut(T, MessageInfo) + Send + 'static,
    ) -> Result<Self, NodeError> {
        let name = topic.to_owned();
        let rejected = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&rejected);
        let on_bytes = move |bytes: &[u8], info: MessageInfo| match T::from_cdr(bytes) {
            Ok(message) => callback(message, info),
            Err(source) => {
                let before = count.fetch_add(1, Ordering::Relaxed);
                if before.is_power_of_two() || before == 0 {
                    tracing::warn!("{}", NodeError::Decode { name: name.clone(), source });
                }
            }
        };
        Self::new(core, topic, TypeSupport::of::<T>(), qos, rejected, on_bytes)
    }

    /// The full name of its topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        &self.0.topic
    }

    /// How many messages were dropped because the callback was slower than they came.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.0.lane.dropped()
    }

    /// How many messages were lost on the way, by the numbers that publishers give them; what
    /// [`dropped`](Self::dropped) counts did arrive and is not among them. Counting begins with the first message of each
    /// publisher. What was lost after the last message that came is not known here.
    #[must_use]
    pub fn losses(&self) -> Losses {
        lock(&self.0.missing).losses()
    }

    /// Ends the subscription, after its callback has had everything that arrived before. Waits for that as long as
    /// `patience`, and says what the callback never had. Must not be called from the callback.
    pub fn finish(self, patience: Duration) -> Unread {
        let endpoint = lock(&self.0.endpoint).take();
        drop(endpoint);
        let waiting = self.0.lane.finish(patience);
        Unread { dropped: self.0.lane.dropped(), waiting: u64::try_from(waiting).unwrap_or(u64::MAX) }
    }

    /// How many messages did not decode.
    #[must_use]
    pub fn rejected(&self) -> u64 {
        self.0.rejected.load(Ordering::Relaxed)
    }
}
