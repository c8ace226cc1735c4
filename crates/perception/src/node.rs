//! The node of a skin: a source of bytes at one end, ROS topics at the other, one thread between them.
//!
//! | file | what it does |
//! |---|---|
//! | `setup` | configuration → skin, source, options; every fault of a configuration |
//! | `loader` | models, made ready on a thread of their own |
//! | `shared` | what the threads share |
//! | `work` | the working thread: bytes → frames → contacts |
//! | `publishers` | topics and when a message is sent on each |
//! | `parameters`, `services`, `diagnostics` | the rest of the ROS interface |
//! | `kept_zero` | the zero over a crash of the node |

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use dermis_estimate::SkinEstimator;
use dermis_inference::Runtime;
use dermis_node::{Backend, Node, NodeError, ServiceServer, Status, Transition};
use dermis_sensor::Sensor;
use dermis_skin::SkinDescription;
use dermis_transport::{Source, SourceOptions, SourceUrl, now_ns};

use crate::config::Config;
use kept_zero::KeptZero;
use loader::Loader;
use parameters::declare;
use publishers::{Publishers, slow_lane, transforms};
use setup::{check_correction, options, skin_and_source};
use shared::{Parts, Shared};

pub use error::RunError;
pub(crate) use setup::check;

mod diagnostics;
mod error;
mod kept_zero;
mod loader;
mod parameters;
mod publishers;
mod services;
mod setup;
mod shared;
mod work;

/// A running node; dropping it stops it.
///
/// Topics, relative to its namespace: `contacts`, `taxels`, `image` (of a skin that is read by a camera), `image/compressed`
/// (where that sends JPEG), `wrench`, `contact_points`, `contact_markers`, `skin_geometry` (latched) and, where the models give them, `force_map` and
/// `displacement_map`; where the configuration has a `mount`, its transform on `/tf_static`.
/// Services: `~/tare`, `~/set_enabled`, `~/load_model`.
///
/// `taxels` carries readings in the unit of the skin *before* tare, so that a recording of it is all
/// that training needs. `wrench`, `contact_points` and `contact_markers` fall silent while the skin is blind;
/// `contacts` continues, and its status gives the reason.
pub struct SkinNode {
    node: Node,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    _services: Vec<ServiceServer>,
}

impl SkinNode {
    /// Starts a node.
    ///
    /// # Errors
    ///
    /// [`RunError`] says in one sentence what is wrong: file, field or channel, and what to do.
    pub fn start(
        sensor: &'static dyn Sensor,
        config: &Config,
        backend: &dyn Backend,
    ) -> Result<Self, RunError> {
        let (skin, url) = skin_and_source(sensor, config)?;
        // Joining the network takes half a second, in which the device can send already: a zero is found by then.
        let early = config.autostart.then(|| Source::open(url.clone(), SourceOptions::default()));
        let mut estimator = SkinEstimator::new(&skin, &config.masked)?;
        estimator.set_least_force(config.force_threshold);
        estimator.set_check(dermis_estimate::frame_check(sensor, &skin)?);
        check_correction(config, &skin)?;
        let runtime = Runtime::load(&config.runtime)?;
        let loader = Loader::start(sensor, config, &skin, runtime, &mut estimator)?;

        let node = Node::open(options(config, &skin)?, backend)?;
        declare(node.parameters(), config, &skin, &mut estimator)?;
        let kept_zero = take_zero(&node, &url, &skin, &mut estimator);
        let mut publishers = Publishers::new(&node, estimator.maps())?;
        if config.mount.is_some() {
            publishers.transform = transforms(&node, &skin)?;
        }
        let name = skin.name.clone();
        let thread_error = |source| RunError::Thread { skin: name.clone(), source };
        let slow = slow_lane().map_err(thread_error)?;
        let parts = Parts {
            sensor,
            skin,
            url,
            runtime,
            node: node.clone(),
            slow,
            kept_zero,
            estimator,
            publishers,
            loading: loader.is_some(),
        };
        let shared = Shared::new(config, parts);
        shared.follow_parameters();
        let services = shared.serve()?;
        let watched = Arc::downgrade(&shared);
        node.diagnostics().set_hardware_id(&shared.skin.name);
        node.diagnostics().add("skin", move || {
            watched.upgrade().map_or_else(|| Status::ok("stopped"), |shared| shared.diagnose())
        });
        let worker = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name(format!("dermis-{}", sensor.name()))
            .spawn(move || worker.work(early))
            .map_err(thread_error)?;
        let running = Self { node, shared, thread: Some(thread), _services: services };
        running.manage(config.autostart)?;
        if let Some(loader) = loader {
            loader.hand_over(&running.shared, config.strict)?;
        }
        Ok(running)
    }

    /// Follows the lifecycle: reads while active, ends with it.
    fn manage(&self, autostart: bool) -> Result<(), NodeError> {
        let shared = Arc::downgrade(&self.shared);
        self.node.lifecycle()?.on(Transition::Shutdown, move |_| {
            if let Some(shared) = shared.upgrade() {
                shared.stop.store(true, Ordering::Release);
            }
            Ok(())
        });
        let shared = Arc::downgrade(&self.shared);
        self.node.work_while_active(autostart, move |active| {
            if let Some(shared) = shared.upgrade() {
                shared.active.store(active, Ordering::Release);
            }
        })
    }

    /// The ROS node: names, parameters, lifecycle, clock.
    #[must_use]
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// The skin that it reads.
    #[must_use]
    pub fn skin(&self) -> &SkinDescription {
        &self.shared.skin
    }

    /// Its own diagnostics, now.
    #[must_use]
    pub fn diagnosis(&self) -> Status {
        self.shared.diagnose()
    }

    /// Stops reading and leaves the ROS graph.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of skin `{}` ended by a panic", self.shared.skin.name);
        } else {
            self.shared.kept_zero.forget();
        }
        self.node.shutdown();
    }
}

impl Drop for SkinNode {
    fn drop(&mut self) {
        self.end();
    }
}

/// Restores the zero that was kept before a crash, where there is one. A replay has none: it starts at its beginning.
fn take_zero(
    node: &Node,
    url: &SourceUrl,
    skin: &SkinDescription,
    estimator: &mut SkinEstimator,
) -> KeptZero {
    let live = !matches!(url, SourceUrl::Replay { .. });
    let folder = std::env::var_os(kept_zero::FOLDER).filter(|_| live).map(PathBuf::from);
    let kept_zero = KeptZero::new(folder.as_deref(), &node.full_name(), skin);
    if let Some((zero, age)) = kept_zero.load(now_ns()) {
        let age = age.as_secs_f64();
        tracing::info!("skin `{}`: goes on with its zero of {age:.1} s ago, before the restart", skin.name);
        estimator.set_zero(&zero);
    }
    kept_zero
}

#[cfg(test)]
mod tests;
