//! Everything at once, without hardware: a modelled skin behind a pseudo-terminal, its node, and a subscriber that compares what
//! comes over the bus with what really touches the skin.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dermis_msgs::geometry_msgs::msg::Point;
use dermis_msgs::msg::ContactArray;
use dermis_node::{Backend, NetworkChoice, Node, NodeOptions, Qos, Subscription};
use dermis_perception::{Config, SkinNode};
use dermis_sensor::Registry;
use dermis_skin::SkinDescription;
use dermis_testbed::{Outlet, Plan, VirtualDevice};
use serde::Serialize;
use tempfile::TempDir;

use crate::stats::{Samples, Spread};
use crate::touch::{Touch, pressing, pressing_force};
use crate::{LOOK, OperateError, Progress};

/// \[N\] Truth and estimate are compared where the press is at least this strong, and as strong as the skin is rated for.
const COMPARED: f64 = 0.1;

/// How to run it.
#[derive(Debug, Clone)]
pub struct Request {
    /// Seed of the touches and the noise.
    pub seed: u64,
    /// How far the network reaches.
    pub network: NetworkChoice,
}

/// What is shown.
#[derive(Debug, Clone, Copy)]
pub enum Shown<'a> {
    /// A skin inside of the program.
    Inside(Contents<'a>),
    /// A skin of a file.
    File {
        /// Skin description.
        skin: &'a Path,
        /// Folders of model bundles; contacts are found on the skin's forward model where there are none.
        models: &'a [PathBuf],
    },
}

/// What a demo needs, inside of the program: no file beside it.
#[derive(Debug, Clone, Copy)]
pub struct Contents<'a> {
    /// Name of the skin; its file and the folder of its bundle are called so.
    pub name: &'a str,
    /// The skin description.
    pub skin: &'a str,
    /// The plan of the presses; one that suits the skin where absent.
    pub plan: Option<&'a str>,
    /// The files of the model bundle, each with its name; none where no bundle ships.
    pub bundle: &'a [(&'a str, &'a [u8])],
    /// Folders of bundles that are loaded in its place.
    pub models: &'a [PathBuf],
}

impl Contents<'_> {
    /// The plan of the presses on this skin.
    ///
    /// # Errors
    ///
    /// Where its text cannot be read.
    pub fn plan(&self, skin: &SkinDescription) -> Result<Plan, OperateError> {
        Ok(match self.plan {
            Some(text) => Plan::from_toml(text, "demo.toml")?,
            None => Plan::rated_presses(skin),
        })
    }

    /// Writes skin and bundle into a folder; where the skin lies there, and the bundles that are to be loaded.
    fn write(&self, folder: &Path) -> Result<(PathBuf, Vec<PathBuf>), OperateError> {
        let skin = folder.join(format!("{}.toml", self.name));
        std::fs::write(&skin, self.skin)?;
        if !self.models.is_empty() || self.bundle.is_empty() {
            return Ok((skin, self.models.to_vec()));
        }
        let bundle = folder.join(self.name);
        std::fs::create_dir(&bundle)?;
        for (name, bytes) in self.bundle {
            std::fs::write(bundle.join(name), bytes)?;
        }
        Ok((skin, vec![bundle]))
    }
}

/// A demo that runs.
pub struct Demo {
    device: VirtualDevice,
    node: SkinNode,
    watcher: Node,
    seen: Arc<Mutex<Seen>>,
    _subscription: Subscription,
    /// Skin and model lie in it.
    _scratch: TempDir,
}

impl Demo {
    /// Starts the device, the node and the subscriber; needs a runtime of tokio.
    ///
    /// # Errors
    ///
    /// Where one of them does not start.
    pub fn start(
        request: &Request,
        shown: &Shown<'_>,
        sensors: &Registry,
        backend: &dyn Backend,
        progress: &dyn Progress,
    ) -> Result<Self, OperateError> {
        let scratch = tempfile::tempdir().map_err(OperateError::NoFolder)?;
        let (skin_path, models, skin, plan) = match shown {
            Shown::Inside(contents) => {
                let (path, models) = contents.write(scratch.path())?;
                let skin = SkinDescription::load(&path)?;
                let plan = contents.plan(&skin)?;
                (path, models, skin, plan)
            }
            Shown::File { skin: path, models } => {
                let skin = SkinDescription::load(path)?;
                let plan = Plan::rated_presses(&skin);
                (path.to_path_buf(), models.to_vec(), skin, plan)
            }
        };
        let sensor = sensors.of(&skin)?;
        let model = sensor.model(&skin)?;
        let encoder = sensor.encoder(&skin)?;
        let device = VirtualDevice::plug(encoder, model, &skin, &plan, request.seed, &Outlet::Pty)?;

        let mut config = Config::new(skin_path, device.url());
        if models.is_empty() {
            progress.note(&format!(
                "there is no model bundle of skin `{}`: contacts are found by inverting its forward model",
                skin.name
            ));
            config.invert = true;
        }
        config.models = models;
        let network = request.network.clone();
        (config.network, config.zenoh_config) = (network.network, network.zenoh_config.clone());
        let node = SkinNode::start(sensor, &config, backend)?;

        let watcher = Node::open(NodeOptions::new("dermis_demo").network(network), backend)?;
        progress.note(&watcher.open_to());
        let seen = Arc::new(Mutex::new(Seen::new(&skin.name, skin.rated_press().force[0].max(COMPARED))));
        let sink = Arc::clone(&seen);
        let subscription =
            watcher.subscribe::<ContactArray>("contacts", Qos::sensor_data(), move |array, info| {
                lock(&sink).take(array, info.received_ns);
            })?;
        // Last, so that a node that computes for seconds before it reads finds its zero before the first touch.
        let device = device.start()?;
        Ok(Self { device, node, watcher, seen, _subscription: subscription, _scratch: scratch })
    }

    /// The node of the subscriber, for others who want to listen.
    #[must_use]
    pub fn watcher(&self) -> &Node {
        &self.watcher
    }

    /// Compares what comes until `end` or as long as `duration`, and hands it to `show` several times a second; how long that was.
    ///
    /// # Errors
    ///
    /// Where the device stops by itself, or `show` fails.
    pub async fn watch(
        &self,
        duration: Option<Duration>,
        end: impl Future<Output = ()>,
        show: &mut dyn FnMut(&Touch, Duration) -> io::Result<()>,
    ) -> Result<Duration, OperateError> {
        let mut end = std::pin::pin!(end);
        let began = Instant::now();
        loop {
            tokio::select! {
                () = tokio::time::sleep(LOOK) => {}
                () = &mut end => break,
            }
            let mut seen = lock(&self.seen);
            seen.compare(&self.device);
            show(&seen.touch, began.elapsed())?;
            if duration.is_some_and(|d| began.elapsed() >= d) {
                break;
            }
            if !self.device.running() {
                return Err(OperateError::DeviceStopped);
            }
        }
        Ok(began.elapsed())
    }

    /// Stops everything; what came in this time.
    ///
    /// # Errors
    ///
    /// Where the device ended by an error.
    pub fn stop(self, elapsed: Duration) -> Result<Findings, OperateError> {
        self.node.stop();
        self.watcher.shutdown();
        let sent = self.device.stop()?;
        Ok(lock(&self.seen).findings(elapsed.as_secs_f64(), sent.frames))
    }
}

/// How a demo went.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// \[s\] that it took.
    pub seconds: f64,
    /// Frames that the device sent.
    pub frames_sent: u64,
    /// Contact arrays that came.
    pub arrays: u64,
    /// Those with a contact.
    pub touched: u64,
    /// \[1/s\] of contact arrays.
    pub rate_hz: f64,
    /// \[ms\] from acquisition to arrival.
    pub latency_ms: Spread,
    /// Contacts that were compared with the ground truth: pressed with at least [`least_force`](Self::least_force).
    pub compared: usize,
    /// \[N\] of the lightest press that is compared.
    #[serde(skip)]
    pub least_force: f64,
    /// \[mm\] between true and estimated position.
    pub position_error_mm: Spread,
    /// \[N\] between true and estimated normal force.
    pub force_error_n: Spread,
    /// Contact arrays by their status.
    pub status: Statuses,
}

/// Contact arrays by their status.
#[derive(Debug, Clone, Copy, Serialize)]
#[expect(missing_docs, reason = "as the message names them")]
pub struct Statuses {
    pub ok: u64,
    pub degraded: u64,
    pub stale: u64,
    pub uncalibrated: u64,
    pub fault: u64,
}

impl Findings {
    /// Refuses a demo in which nothing came.
    ///
    /// # Errors
    ///
    /// [`OperateError::NoContacts`] then.
    pub fn require(&self) -> Result<(), OperateError> {
        if self.arrays == 0 { Err(OperateError::NoContacts(self.seconds)) } else { Ok(()) }
    }
}

/// What came over the bus, and how far it is from what the device knows.
struct Seen {
    touch: Touch,
    least_force: f64,
    waiting: Vec<ContactArray>,
    position_error_mm: Samples,
    force_error_n: Samples,
}

impl Seen {
    fn new(name: &str, least_force: f64) -> Self {
        Self {
            touch: Touch::new(name),
            least_force,
            waiting: Vec::new(),
            position_error_mm: Samples::default(),
            force_error_n: Samples::default(),
        }
    }

    fn take(&mut self, array: ContactArray, received_ns: i64) {
        if array.contacts.len() == 1 {
            self.waiting.push(array.clone());
        }
        self.touch.take(array, received_ns);
    }

    /// Compares what came since the last call with what the device knows.
    fn compare(&mut self, device: &VirtualDevice) {
        for array in std::mem::take(&mut self.waiting) {
            let Some(truth) = device.truth_message(array.header.stamp.as_nanos()) else { continue };
            let [truth] = truth.contacts.as_slice() else { continue };
            let force = pressing(&truth.force, &truth.normal);
            if force < self.least_force {
                continue;
            }
            let contact = &array.contacts[0];
            self.position_error_mm.push(distance_mm(&contact.position, &truth.position));
            self.force_error_n.push((pressing_force(contact) - force).abs());
        }
    }

    fn findings(&self, seconds: f64, frames_sent: u64) -> Findings {
        let touch = &self.touch;
        let [ok, degraded, stale, uncalibrated, fault] = touch.statuses;
        Findings {
            seconds,
            frames_sent,
            arrays: touch.arrays,
            touched: touch.touched,
            rate_hz: touch.rate(),
            latency_ms: Spread::from(&touch.latency_ms),
            compared: self.position_error_mm.len(),
            least_force: self.least_force,
            position_error_mm: Spread::from(&self.position_error_mm),
            force_error_n: Spread::from(&self.force_error_n),
            status: Statuses { ok, degraded, stale, uncalibrated, fault },
        }
    }
}

fn distance_mm(a: &Point, b: &Point) -> f64 {
    ((a.x - b.x).powi(2) + (a.y - b.y).powi(2) + (a.z - b.z).powi(2)).sqrt() * 1e3
}

fn lock(seen: &Mutex<Seen>) -> MutexGuard<'_, Seen> {
    seen.lock().unwrap_or_else(PoisonError::into_inner)
}
