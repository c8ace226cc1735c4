//! Devices that are not there, for trying nodes without hardware.

use anyhow::Result;
use clap::Subcommand;
use dermis_operate::device::{Replay, Replayed, Simulated, Simulation};
use dermis_operate::robot;

use crate::backend::Choice;
use crate::registry::sensors;

/// A device on a pseudo-terminal.
#[derive(Subcommand)]
pub enum Device {
    /// A modelled skin that a plan presses, over and over.
    Simulate {
        #[command(flatten)]
        request: Box<Simulation>,
        /// ROS 2 implementation.
        #[arg(long, value_enum, default_value_t)]
        backend: Choice,
    },
    /// A robot whose joints swing, and where its skins are really touched, on `/joint_states` and `body_truth`.
    Robot {
        #[command(flatten)]
        request: robot::Simulation,
        /// ROS 2 implementation.
        #[arg(long, value_enum, default_value_t)]
        backend: Choice,
    },
    /// The recorded frames of a bag, byte by byte.
    Replay(Replay),
}

/// Runs until Ctrl-C, or until the recording has been sent and read.
pub fn run(device: &Device) -> Result<()> {
    let stop = crate::interrupt::stop_on_interrupt()?;
    match device {
        Device::Simulate { request, backend } => {
            let device = Simulated::start(request, sensors())?;
            println!("{}", device.url());
            if device.publishes() {
                let backend = backend.open()?;
                crate::block_on(async { Ok(device.publish(backend.as_ref(), &stop).await?) })?;
            }
            let stats = device.finish(&stop)?;
            eprintln!("{} frames made, {} not read by anyone", stats.frames, stats.dropped);
        }
        Device::Robot { request, backend } => {
            let backend = backend.open()?;
            crate::block_on(async { Ok(robot::simulate(request, backend.as_ref(), &stop).await?) })?;
        }
        Device::Replay(request) => {
            let device = Replayed::start(request, sensors())?;
            println!("{}", device.url());
            let stats = device.finish(&stop)?;
            eprintln!("{} frames sent", stats.frames);
        }
    }
    Ok(())
}
