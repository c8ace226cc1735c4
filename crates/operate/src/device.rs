//! Devices that are not there, for trying nodes without hardware: a modelled or a recorded skin behind a pseudo-terminal.
//!
//! A modelled one can also publish what really touches it, and what a robot and a force sensor would report that press it, so
//! that whole recordings with labels can be made without a laboratory.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use dermis_learn::LabelMap;
use dermis_msgs::geometry_msgs::msg::{TransformStamped, WrenchStamped};
use dermis_msgs::msg::Indentation;
use dermis_node::{Backend, Node, NodeOptions};
use dermis_perception::cli::NetworkArguments;
use dermis_sensor::Registry;
use dermis_skin::SkinDescription;
use dermis_testbed::{DeviceStats, Outlet, Plan, ReplayDevice, ReplayOptions, VirtualDevice};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use tokio::time::MissedTickBehavior;

use crate::effects::Chosen;
use crate::{OperateError, model_of_file};

/// A modelled skin that a plan presses, over and over.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Simulation {
    /// Skin description.
    pub skin: PathBuf,
    /// Plan of the presses; random touches where absent.
    #[arg(long)]
    pub plan: Option<PathBuf>,
    /// What makes the device differ from its design.
    #[command(flatten)]
    pub chosen: Chosen,
    /// Seed of everything random, the device's own effects included.
    #[arg(long, default_value_t = Simulation::default().seed)]
    pub seed: u64,
    /// Where it is plugged in.
    #[command(flatten)]
    pub outlet: Plug,
    /// What is published on the bus of what really touches it.
    #[command(flatten)]
    pub published: Published,
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            plan: None,
            chosen: Chosen::default(),
            seed: 1,
            outlet: Plug::default(),
            published: Published::default(),
        }
    }
}

/// The recorded frames of a bag, byte by byte.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Replay {
    /// Skin description.
    #[arg(long)]
    pub skin: PathBuf,
    /// Bag that holds the frames.
    pub bag: PathBuf,
    /// Which device, where the bag holds several of the skin's type; `dermis bag info` lists them.
    #[arg(long, value_name = "NAME")]
    pub skin_instance: Option<String>,
    /// Factor on the recorded pace; 0 for as fast as it is read.
    #[arg(long, default_value_t = Replay::default().speed)]
    pub speed: f64,
    /// Where it is plugged in.
    #[command(flatten)]
    pub outlet: Plug,
}

impl Default for Replay {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            bag: PathBuf::new(),
            skin_instance: None,
            speed: 1.0,
            outlet: Plug::default(),
        }
    }
}

/// Where a device is plugged in.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Plug {
    /// Symbolic link to the pseudo-terminal, for a path that stays the same.
    #[arg(long)]
    pub link: Option<PathBuf>,
}

impl Plug {
    fn outlet(&self) -> Outlet {
        self.link.clone().map_or(Outlet::Pty, Outlet::PtyLink)
    }
}

/// What a testbed tells on the bus beside the bytes of its skin, for recordings that a model learns from.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Published {
    /// Publish what is true as dermis_msgs/msg/Indentation on this topic, e.g. `ground_truth`.
    #[arg(long, value_name = "TOPIC")]
    pub ground_truth: Option<String>,
    /// Publish what a robot and a force sensor would that are mounted as this map of labels says, on its topics.
    #[arg(long, value_name = "MAP")]
    pub rig: Option<PathBuf>,
    /// Name of the device in what is published; that of the skin file where absent.
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
    /// Coordinate frame of what is published; that of the skin file where absent.
    #[arg(long, value_name = "LINK")]
    pub frame_id: Option<String>,
    /// ROS namespace of the topics.
    #[arg(long, default_value = "")]
    pub namespace: String,
    /// How far the network reaches.
    #[command(flatten)]
    pub network: NetworkArguments,
}

/// What is said; an argument of a launch file that nobody gave is empty.
fn given(text: &Option<String>) -> Option<&str> {
    text.as_deref().filter(|text| !text.is_empty())
}

/// How often the end is looked for.
const WAIT: Duration = Duration::from_millis(50);

/// A modelled skin that runs.
pub struct Simulated {
    device: VirtualDevice,
    skin: SkinDescription,
    rig: Option<LabelMap>,
    seed: u64,
    published: Published,
}

impl Simulated {
    /// Plugs it in.
    ///
    /// # Errors
    ///
    /// Where a file cannot be used, the skin has no forward model, or there is no line to send on.
    pub fn start(request: &Simulation, sensors: &Registry) -> Result<Self, OperateError> {
        let Simulation { skin: path, plan, chosen, seed, outlet, published } = request;
        let mut skin = SkinDescription::load(path)?;
        chosen.apply(&mut skin, *seed)?;
        let model = model_of_file(path, &skin, sensors)?;
        let plan = match plan {
            Some(path) => Plan::load(path)?,
            None => Plan::rated_touches(&skin),
        };
        let rig = published.rig.as_deref().map(LabelMap::load).transpose()?;
        let [instance, frame] = [&published.instance, &published.frame_id].map(given);
        let skin = skin.into_instance(instance, frame, None)?;
        let encoder = sensors.of(&skin)?.encoder(&skin)?;
        let device = VirtualDevice::start_on(encoder, model, &skin, &plan, *seed, &outlet.outlet())?;
        Ok(Self { device, skin, rig, seed: *seed, published: published.clone() })
    }

    /// Where a node finds it.
    #[must_use]
    pub fn url(&self) -> &str {
        self.device.url()
    }

    /// Whether anything is to be published: [`publish`](Self::publish) does it.
    #[must_use]
    pub fn publishes(&self) -> bool {
        given(&self.published.ground_truth).is_some() || self.rig.is_some()
    }

    /// Publishes what really touches it until the device ends or `stop` is set.
    ///
    /// # Errors
    ///
    /// Where the network or the ROS installation refuses.
    pub async fn publish(&self, backend: &dyn Backend, stop: &AtomicBool) -> Result<(), OperateError> {
        let Self { device, skin, published, .. } = self;
        // Several devices of one robot publish: each is a node of its own name.
        let name = match given(&published.instance) {
            Some(instance) => format!("dermis_testbed_{instance}"),
            None => "dermis_testbed".to_owned(),
        };
        let options = NodeOptions::new(&name)
            .namespace(published.namespace.clone())
            .network(published.network.choice());
        let node = Node::open(options, backend)?;
        let truth = given(&published.ground_truth)
            .map(|topic| node.stream_publisher::<Indentation>(topic, KEPT))
            .transpose()?;
        let rig = match &self.rig {
            Some(map) => Some((
                map,
                node.stream_publisher::<TransformStamped>(&map.robot.topic, KEPT)?,
                node.stream_publisher::<WrenchStamped>(&map.force.topic, KEPT)?,
            )),
            None => None,
        };
        let surface = skin.surface();
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ 0x5eed_0003);
        let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / skin.rate.max(RIG_RATE)));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        while device.running() && !stop.load(Ordering::Acquire) && !node.is_shut_down() {
            ticks.tick().await;
            let stamp = dermis_transport::now_ns();
            if let (Some(publisher), Some(message)) = (&truth, device.truth_message(stamp)) {
                publisher.publish(&message)?;
            }
            let Some((map, poses, wrenches)) = &rig else { continue };
            let Some(moment) = device.truth(stamp) else { continue };
            let Some(tip) = moment.tip else { continue };
            let mut offset = Vector3::from(RIG_OFFSET);
            offset.iter_mut().for_each(|v| *v += RIG_NOISE * rng.sample::<f64, _>(StandardNormal));
            let force = moment.stimulus.contacts.iter().map(|c| c.force).sum();
            let (pose, wrench) = map.report(&surface, (&tip.place, tip.gap), &force, &offset, stamp);
            poses.publish(&pose)?;
            wrenches.publish(&wrench)?;
        }
        node.shutdown();
        Ok(())
    }

    /// Waits until the device ends or `stop` is set; how many frames were made.
    ///
    /// # Errors
    ///
    /// Where the device ended by an error.
    pub fn finish(self, stop: &AtomicBool) -> Result<DeviceStats, OperateError> {
        while self.device.running() && !stop.load(Ordering::Acquire) {
            std::thread::sleep(WAIT);
        }
        Ok(self.device.stop()?)
    }
}

/// \[Hz\] at which robots and force sensors report, at least.
const RIG_RATE: f64 = 250.0;
/// \[N\] offset of the rig's force sensor in its axes: force cells have one.
const RIG_OFFSET: [f64; 3] = [0.31, -0.12, 0.54];
/// \[N\] standard deviation of a reading of it.
const RIG_NOISE: f64 = 0.004;

/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them.
const KEPT: usize = 10;

/// A recording that is sent.
pub struct Replayed(ReplayDevice);

impl Replayed {
    /// Plugs it in.
    ///
    /// # Errors
    ///
    /// Where a file cannot be used, the bag does not fit the skin, or there is no line to send on.
    pub fn start(request: &Replay, sensors: &Registry) -> Result<Self, OperateError> {
        let skin = SkinDescription::load(&request.skin)?;
        let options = ReplayOptions {
            speed: if request.speed == 0.0 { f64::INFINITY } else { request.speed },
            topic: None,
            instance: request.skin_instance.clone(),
            outlet: request.outlet.outlet(),
        };
        let encoder = sensors.of(&skin)?.encoder(&skin)?;
        Ok(Self(ReplayDevice::start_on(encoder, &request.bag, &skin, &options)?))
    }

    /// Where a node finds it.
    #[must_use]
    pub fn url(&self) -> &str {
        self.0.url()
    }

    /// Waits until the recording has been sent and read, or `stop` is set; how many frames were sent.
    ///
    /// # Errors
    ///
    /// Where the device ended by an error.
    pub fn finish(self, stop: &AtomicBool) -> Result<DeviceStats, OperateError> {
        while self.0.running() && !self.0.finished() && !stop.load(Ordering::Acquire) {
            std::thread::sleep(WAIT);
        }
        Ok(self.0.stop()?)
    }
}
