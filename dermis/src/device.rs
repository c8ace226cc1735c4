//! Devices that are not there, for trying nodes without hardware.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use clap::{Args, Subcommand};
use dermis_learn::LabelMap;
use dermis_msgs::geometry_msgs::msg::{TransformStamped, WrenchStamped};
use dermis_msgs::msg::Indentation;
use dermis_node::{Node, NodeOptions};
use dermis_perception::cli::NetworkArguments;
use dermis_skin::SkinDescription;
use dermis_testbed::{Outlet, Plan, ReplayDevice, ReplayOptions, VirtualDevice};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use tokio::time::MissedTickBehavior;

use crate::backend::Choice;
use crate::effects::Chosen;

/// A device on a pseudo-terminal.
#[derive(Subcommand)]
pub enum Device {
    /// A modelled skin that a plan presses, over and over.
    Simulate {
        /// Skin description.
        skin: PathBuf,
        /// Plan of the presses; random touches where absent.
        #[arg(long)]
        plan: Option<PathBuf>,
        /// What makes the device differ from its design.
        #[command(flatten)]
        chosen: Chosen,
        /// Seed of everything random, the device's own effects included.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Where it is plugged in.
        #[command(flatten)]
        outlet: Plug,
        /// What is told on the bus of what really touches it.
        #[command(flatten)]
        told: Told,
    },
    /// The recorded frames of a bag, byte by byte.
    Replay {
        /// Skin description.
        #[arg(long)]
        skin: PathBuf,
        /// Bag that holds the frames.
        bag: PathBuf,
        /// Which device, where the bag holds several of the skin's type; `dermis bag info` lists them.
        #[arg(long, value_name = "NAME")]
        skin_instance: Option<String>,
        /// Factor on the recorded pace; 0 for as fast as it is read.
        #[arg(long, default_value_t = 1.0)]
        speed: f64,
        /// Where it is plugged in.
        #[command(flatten)]
        outlet: Plug,
    },
}

/// Where a device is plugged in.
#[derive(Args)]
pub struct Plug {
    /// Symbolic link to the pseudo-terminal, for a path that stays the same.
    #[arg(long)]
    link: Option<PathBuf>,
}

/// What a testbed tells on the bus beside the bytes of its skin, for recordings that a model learns from.
#[derive(Args)]
pub struct Told {
    /// Publish what is true as dermis_msgs/msg/Indentation on this topic, e.g. `ground_truth`.
    #[arg(long, value_name = "TOPIC")]
    ground_truth: Option<String>,
    /// Publish what a robot and a force sensor would that are mounted as this map of labels says, on its topics.
    #[arg(long, value_name = "MAP")]
    rig: Option<PathBuf>,
    /// Name of the device in what is published; that of the skin file where absent.
    #[arg(long, value_name = "NAME")]
    instance: Option<String>,
    /// Coordinate frame of what is published; that of the skin file where absent.
    #[arg(long, value_name = "LINK")]
    frame_id: Option<String>,
    /// ROS namespace of the topics.
    #[arg(long, default_value = "")]
    namespace: String,
    #[command(flatten)]
    network: NetworkArguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

impl Plug {
    fn outlet(&self) -> Outlet {
        self.link.clone().map_or(Outlet::Pty, Outlet::PtyLink)
    }
}

/// Runs until Ctrl-C, or until the recording has been sent and read.
pub fn run(device: &Device) -> Result<()> {
    let stop = crate::collect::stop_on_interrupt()?;
    let wait = Duration::from_millis(50);
    match device {
        Device::Simulate { skin, plan, chosen, seed, outlet, told } => {
            let path = skin;
            let mut skin = SkinDescription::load(path)?;
            chosen.apply(&mut skin, *seed)?;
            let model = crate::registry::forward(path, &skin)?;
            let plan = match plan {
                Some(path) => Plan::load(path)?,
                None => Plan::random_touches(0.004, [0.1, 1.0]),
            };
            let rig = told.rig.as_deref().map(LabelMap::load).transpose()?;
            let skin = skin.into_instance(told.instance.as_deref(), told.frame_id.as_deref(), None)?;
            let encoder = crate::registry::family(&skin)?.encoder(&skin)?;
            let device = VirtualDevice::start_on(encoder, model, &skin, &plan, *seed, &outlet.outlet())?;
            println!("{}", device.url());
            if told.ground_truth.is_some() || rig.is_some() {
                crate::block_on(tell(&device, &skin, told, rig.as_ref(), *seed, &stop))?;
            }
            while device.running() && !stop.load(Ordering::Acquire) {
                std::thread::sleep(wait);
            }
            let stats = device.stop()?;
            eprintln!("{} frames made, {} not read by anyone", stats.frames, stats.dropped);
        }
        Device::Replay { skin, bag, skin_instance, speed, outlet } => {
            let skin = SkinDescription::load(skin)?;
            let speed = if *speed == 0.0 { f64::INFINITY } else { *speed };
            let options = ReplayOptions {
                speed,
                topic: None,
                instance: skin_instance.clone(),
                outlet: outlet.outlet(),
            };
            let encoder = crate::registry::family(&skin)?.encoder(&skin)?;
            let device = ReplayDevice::start_on(encoder, bag, &skin, &options)?;
            println!("{}", device.url());
            while device.running() && !device.finished() && !stop.load(Ordering::Acquire) {
                std::thread::sleep(wait);
            }
            let stats = device.stop()?;
            eprintln!("{} frames sent", stats.frames);
        }
    }
    Ok(())
}

/// \[Hz\] at which robots and force sensors report, at least.
const RIG_RATE: f64 = 250.0;
/// \[N\] offset of the rig's force sensor in its axes: force cells have one.
const RIG_OFFSET: [f64; 3] = [0.31, -0.12, 0.54];
/// \[N\] standard deviation of a reading of it.
const RIG_NOISE: f64 = 0.004;

/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them.
const KEPT: usize = 10;

/// Publishes what is true until the device ends or is stopped.
async fn tell(
    device: &VirtualDevice,
    skin: &SkinDescription,
    told: &Told,
    rig: Option<&LabelMap>,
    seed: u64,
    stop: &AtomicBool,
) -> Result<()> {
    let options =
        NodeOptions::new("dermis_testbed").namespace(told.namespace.clone()).network(told.network.choice());
    let node = Node::open(options, told.backend.open()?.as_ref())?;
    let truth = told
        .ground_truth
        .as_ref()
        .map(|topic| node.stream_publisher::<Indentation>(topic, KEPT))
        .transpose()?;
    let rig = match rig {
        Some(map) => Some((
            map,
            node.stream_publisher::<TransformStamped>(&map.robot.topic, KEPT)?,
            node.stream_publisher::<WrenchStamped>(&map.force.topic, KEPT)?,
        )),
        None => None,
    };
    let surface = skin.surface();
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_0003);
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
