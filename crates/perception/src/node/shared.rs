//! What the working thread, services, parameters and diagnostics of a node share.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dermis_estimate::SkinEstimator;
use dermis_inference::{Limits, Runtime};
use dermis_node::Node;
use dermis_sensor::{Decoder, Sensor};
use dermis_skin::{Mount, SkinDescription, Surface};
use dermis_transport::{SourceStats, SourceUrl, SourceWatch};

use super::kept_zero::KeptZero;
use super::publishers::{Job, Publishers};
use crate::commands::Commands;
use crate::config::Config;
use crate::folders;

/// Longest wait for bytes, and so the longest time until a stop or a silence is noticed.
pub(super) const TICK: Duration = Duration::from_millis(50);

/// What is fixed from the start on, and the [`Core`] that changes, under its lock.
pub(super) struct Shared {
    pub(super) sensor: &'static dyn Sensor,
    /// Whether stamps follow the device's clock as it is.
    pub(super) device_time: bool,
    /// Where this device is fixed, if that is known.
    pub(super) mount: Option<Mount>,
    /// File of how this device differs from its forward model; it replaces the corrections of the models.
    pub(super) correction: Option<PathBuf>,
    pub(super) skin: SkinDescription,
    pub(super) surface: Surface,
    pub(super) url: SourceUrl,
    pub(super) runtime: &'static Runtime,
    pub(super) node: Node,
    pub(super) slow: SyncSender<Job>,
    pub(super) commands: Commands,
    pub(super) model_limits: Limits,
    /// Folders below which bundles may be loaded from.
    pub(super) model_folders: Vec<PathBuf>,
    pub(super) kept_zero: KeptZero,
    pub(super) core: Mutex<Core>,
    /// Notified after every batch of frames while [`Core::awaited`] says that somebody waits.
    pub(super) progress: Condvar,
    pub(super) active: AtomicBool,
    pub(super) stop: AtomicBool,
}

pub(super) struct Core {
    /// While active.
    pub(super) decoder: Option<Box<dyn Decoder>>,
    pub(super) estimator: SkinEstimator,
    pub(super) publishers: Publishers,
    pub(super) enabled: bool,
    /// The models that are configured are still being made ready.
    pub(super) loading: bool,
    /// Of the latest frame.
    pub(super) sequence: u64,
    pub(super) figures: Figures,
    /// When contacts were estimated the last time.
    pub(super) estimated: Option<Instant>,
    /// Since the node was active for the first time.
    pub(super) source: Option<SourceWatch>,
    /// Datagrams and connections of other senders that had been refused at the last diagnosis.
    pub(super) refused: u64,
    /// Why the skin is blind, if it is: status and sentence.
    pub(super) blind: Option<(u8, String)>,
    /// Jumps of the device's clock that were warned of, and when that was.
    pub(super) jumps: (u64, Option<Instant>),
    /// Threads that wait for [`Shared::progress`].
    pub(super) awaited: usize,
}

/// Rates and delays since the last diagnosis, and totals.
#[derive(Debug, Default)]
pub(super) struct Figures {
    pub(super) frames_total: u64,
    pub(super) frames: u64,
    /// \[ns\] from acquisition to publication.
    pub(super) latency_sum: i64,
    pub(super) latency_max: i64,
    /// \[ns\] from a frame to its last message, over the frames whose contacts were estimated.
    pub(super) work_sum: i64,
    pub(super) work_max: i64,
    /// Frames whose contacts were not estimated, because a newer one was there.
    pub(super) dropped: u64,
    pub(super) dropped_total: u64,
    /// Frames whose contacts were not estimated, because nobody listened.
    pub(super) unheard: u64,
    pub(super) unheard_total: u64,
    /// When the last diagnosis was made.
    pub(super) since: Option<Instant>,
}

/// What a node is started with, made ready one after the other.
pub(super) struct Parts {
    pub(super) sensor: &'static dyn Sensor,
    pub(super) skin: SkinDescription,
    pub(super) url: SourceUrl,
    pub(super) runtime: &'static Runtime,
    pub(super) node: Node,
    pub(super) slow: SyncSender<Job>,
    pub(super) kept_zero: KeptZero,
    pub(super) estimator: SkinEstimator,
    pub(super) publishers: Publishers,
    /// Models are being made ready.
    pub(super) loading: bool,
}

impl Shared {
    /// Of a node that is not active yet.
    pub(super) fn new(config: &Config, parts: Parts) -> Arc<Self> {
        let Parts { sensor, skin, url, runtime, node, slow, kept_zero, estimator, publishers, loading } =
            parts;
        let model_folders =
            config.model_folders.clone().unwrap_or_else(|| folders::of_bundles(&config.models));
        Arc::new(Self {
            sensor,
            device_time: config.device_time,
            mount: config.mount.clone(),
            correction: config.correction.clone(),
            surface: skin.surface(),
            skin,
            url,
            runtime,
            node,
            slow,
            commands: config.commands.clone(),
            model_limits: config.model_limits,
            model_folders,
            kept_zero,
            core: Mutex::new(Core {
                decoder: None,
                estimator,
                publishers,
                enabled: true,
                loading,
                sequence: 0,
                figures: Figures::default(),
                estimated: None,
                source: None,
                refused: 0,
                blind: None,
                jumps: (0, None),
                awaited: 0,
            }),
            progress: Condvar::new(),
            active: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        })
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn stopping(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }
}

impl Core {
    /// What the source did so far.
    pub(super) fn source(&self) -> SourceStats {
        self.source.as_ref().map(SourceWatch::stats).unwrap_or_default()
    }

    /// Bytes are missing.
    pub(super) fn gap(&mut self) {
        if let Some(decoder) = &mut self.decoder {
            decoder.gap();
        }
    }
}
