//! Devices that are not there, for trying nodes without hardware.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::Result;
use clap::{Args, Subcommand};
use dermis_skin::SkinDescription;
use dermis_testbed::{Outlet, Plan, ReplayDevice, ReplayOptions, VirtualDevice};

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
        /// Seed of everything random.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Where it is plugged in.
        #[command(flatten)]
        outlet: Plug,
    },
    /// The recorded frames of a bag, byte by byte.
    Replay {
        /// Skin description.
        #[arg(long)]
        skin: PathBuf,
        /// Bag that holds the frames.
        bag: PathBuf,
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
        Device::Simulate { skin, plan, seed, outlet } => {
            let skin = SkinDescription::load(skin)?;
            let model = (crate::registry::family(&skin)?.model)(&skin)?;
            let plan = match plan {
                Some(path) => Plan::load(path)?,
                None => Plan::random_touches(0.004, [0.1, 1.0]),
            };
            let device = VirtualDevice::start(model, &skin, &plan, *seed, &outlet.outlet())?;
            println!("{}", device.url());
            while device.running() && !stop.load(Ordering::Acquire) {
                std::thread::sleep(wait);
            }
            let stats = device.stop()?;
            eprintln!("{} frames made, {} not read by anyone", stats.frames, stats.dropped);
        }
        Device::Replay { skin, bag, speed, outlet } => {
            let skin = SkinDescription::load(skin)?;
            let speed = if *speed == 0.0 { f64::INFINITY } else { *speed };
            let options = ReplayOptions { speed, topic: None, outlet: outlet.outlet() };
            let device = ReplayDevice::start(bag, &skin, &options)?;
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
