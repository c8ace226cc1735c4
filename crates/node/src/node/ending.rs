//! The end of a node: by a call, a signal, or the drop of its last clone.

use std::sync::atomic::Ordering;
use std::sync::{LazyLock, PoisonError, Weak};
use std::thread::ThreadId;
use std::time::Duration;

use super::endpoints::runtime;
use super::{Node, Shared};
use crate::error::NodeError;
use crate::executor::lock;

/// Longest wait of a second caller of `shutdown` for the first one.
const CLOSE_WAIT: Duration = Duration::from_secs(10);

/// Whether all nodes of the process are to end.
static ALL: LazyLock<tokio::sync::watch::Sender<bool>> =
    LazyLock::new(|| tokio::sync::watch::Sender::new(false));

/// Ends every [`Node::wait_for_shutdown`] of this process as a signal does, those that begin later, too: for programs that run
/// several nodes and end them together, of which some may still be starting.
pub fn end_all_nodes() {
    ALL.send_replace(true);
}

/// Calls [`end_all_nodes`] as soon as a signal, Ctrl-C or SIGTERM, comes from now on: for programs whose nodes speak before anybody
/// [waits](Node::wait_for_shutdown) for their end. A signal that nobody listens to ends a process without a last word.
///
/// # Errors
///
/// When the signals cannot be listened to.
pub fn end_all_nodes_on_signal() -> Result<(), NodeError> {
    let runtime = runtime()?;
    let _entered = runtime.enter();
    let signalled = signalled().map_err(|error| NodeError::Thread {
        node: "(all)".to_owned(),
        reason: format!("cannot listen to signals: {error}"),
    })?;
    runtime.spawn(async move {
        signalled.await;
        end_all_nodes();
    });
    Ok(())
}

/// Ends with Ctrl-C or SIGTERM, from now on; wherever tokio runs.
///
/// # Errors
///
/// When the signals cannot be listened to.
#[cfg(unix)]
pub fn signalled() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    Ok(async move {
        tokio::select! { _ = interrupt.recv() => {}, _ = terminate.recv() => {} }
    })
}

/// Ends with Ctrl-C.
///
/// # Errors
///
/// None.
#[cfg(not(unix))]
pub fn signalled() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

/// Waits for [`end_all_nodes`]: for what runs beside nodes and is to end with them.
pub async fn end_of_all_nodes() {
    // The sender lasts as long as the process.
    let _ = ALL.subscribe().wait_for(|all| *all).await;
}

/// How far the end of a node is.
#[derive(Default)]
pub(super) struct Closing {
    by: Option<ThreadId>,
    done: bool,
}

impl Node {
    /// Leaves the domain: takes a managed node to Finalized, withdraws all endpoints and waits for running
    /// callbacks. No callback is called and no message sent afterwards. A transition that runs is waited for, and the
    /// node is Finalized after it. A second call waits for the end of the first one, except in a callback.
    pub fn shutdown(&self) {
        self.0.shutdown();
    }

    /// Whether it was shut down.
    #[must_use]
    pub fn is_shut_down(&self) -> bool {
        self.0.core.closed.load(Ordering::Acquire)
    }

    /// Waits for Ctrl-C, SIGTERM, [`end_all_nodes`] or [`Node::shutdown`], and shuts the node down. May be awaited on any
    /// executor.
    ///
    /// # Errors
    ///
    /// When the signals cannot be listened to; the node is not shut down then.
    pub async fn wait_for_shutdown(&self) -> Result<(), NodeError> {
        let mut ended = self.0.ended.subscribe();
        let ending = runtime()?.spawn(async {
            tokio::select! {
                () = signalled()? => Ok(()),
                () = end_of_all_nodes() => Ok(()),
            }
        });
        let abort = ending.abort_handle();
        let shut_down = std::pin::pin!(ended.wait_for(|ended| *ended));
        match futures::future::select(shut_down, ending).await {
            futures::future::Either::Left(_) => abort.abort(),
            futures::future::Either::Right((signal, _)) => {
                let signal = signal.unwrap_or_else(|error| Err(std::io::Error::other(error)));
                signal.map_err(|error| NodeError::Thread {
                    node: self.full_name(),
                    reason: format!("cannot listen to signals: {error}"),
                })?;
                tracing::info!("node {} shuts down", self.full_name());
            }
        }
        let node = self.clone();
        let done = runtime()?.spawn_blocking(move || node.shutdown());
        done.await.map_err(|error| NodeError::Thread { node: self.full_name(), reason: error.to_string() })
    }
}

impl Shared {
    pub(super) fn shutdown(&self) {
        let lifecycle = lock(&self.lifecycle).clone();
        if !self.core.closed.load(Ordering::Acquire)
            && let Some(lifecycle) = lifecycle
            && let Err(error) = lifecycle.end()
        {
            tracing::warn!("{error}");
        }
        if self.core.closed.swap(true, Ordering::AcqRel) {
            self.wait_until_gone();
            return;
        }
        lock(&self.closing.0).by = Some(std::thread::current().id());
        self.core.alarm.stop();
        let keeper = lock(&self.keeper).take();
        if let Some(keeper) = keeper
            && keeper.thread().id() != std::thread::current().id()
            && keeper.join().is_err()
        {
            tracing::error!("the timer thread of the node ended by a panic");
        }
        let tracked = std::mem::take(&mut *lock(&self.core.tracked));
        for closer in tracked.iter().filter_map(Weak::upgrade) {
            closer.close();
        }
        let subscription = lock(&self.clock_subscription).take();
        drop(subscription);
        let kept = std::mem::take(&mut *lock(&self.kept));
        drop(kept);
        self.core.node.close();
        self.core.executor.stop();
        self.core.system.stop();
        self.parameters.clear_callbacks();
        self.clock.clear_callbacks();
        self.diagnostics.clear();
        lock(&self.problem_callbacks).clear();
        if let Some(lifecycle) = &*lock(&self.lifecycle) {
            lifecycle.clear_callbacks();
        }
        self.ended.send_replace(true);
        lock(&self.closing.0).done = true;
        self.closing.1.notify_all();
    }

    /// Waits for another thread that shuts the node down: a program that ended in the middle of it would leave its names in the
    /// graph of others until their liveliness expires. Not in a callback, which that thread waits for, nor in that
    /// thread itself, where the last clone of the node goes with the callbacks that are dropped.
    fn wait_until_gone(&self) {
        if self.core.executor.is_inside() || self.core.system.is_inside() {
            return;
        }
        let me = std::thread::current().id();
        let (closing, ended) = &self.closing;
        let unfinished = |closing: &mut Closing| !closing.done && closing.by != Some(me);
        let waited = ended.wait_timeout_while(lock(closing), CLOSE_WAIT, unfinished);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}
