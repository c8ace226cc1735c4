//! What the endpoints of a node share: names, backend, executors, and the list of what ends with the node.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, Weak};

use dermis_msgs::sequence::Losses;

use super::timers::Alarm;
use crate::backend::BackendNode;
use crate::error::NodeError;
use crate::executor::{Executor, lock};
use crate::names::Names;
use crate::pubsub::SubscriptionInner;
use crate::watch::OwnEndpoint;

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
    pub(super) system: Executor,
    pub(super) own: Mutex<BTreeMap<u64, OwnEndpoint>>,
    next: AtomicU64,
    pub(super) tracked: Mutex<Vec<Weak<dyn Close>>>,
    /// Whose losses the diagnostics report.
    subscriptions: Mutex<Vec<Weak<SubscriptionInner>>>,
    pub(super) closed: AtomicBool,
    pub(super) alarm: Arc<Alarm>,
}

impl Core {
    pub(super) fn new(
        names: Names,
        node: Arc<dyn BackendNode>,
        executor: Executor,
        system: Executor,
        alarm: Arc<Alarm>,
    ) -> Self {
        Self {
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
        }
    }

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
    pub(super) fn losses(&self) -> BTreeMap<String, (u64, u64)> {
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
