//! Devices that are not there: a model, or a recording, behind a real transport.
//!
//! Both speak the native wire (or lines, where the skin's description says so) on a pseudo-terminal or a TCP
//! port, with sequence and device time, so that a node cannot tell them from hardware. `simulated` is the modelled device,
//! `replay` the recording, `script` a plan that goes on round after round, `line` the device's end of the line.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use dermis_sensor::{Encoder, FrameWriter};
use dermis_skin::SkinDescription;

use crate::TestbedError;

pub use replay::{ReplayDevice, ReplayOptions};
pub use simulated::{PluggedDevice, VirtualDevice};

mod line;
mod replay;
mod script;
mod simulated;
#[cfg(test)]
mod tests;
mod worker;

/// Where a simulated device is plugged in.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Outlet {
    /// A new pseudo-terminal.
    #[default]
    Pty,
    /// A new pseudo-terminal with a symbolic link to it, for a path that stays the same.
    PtyLink(PathBuf),
    /// A TCP server for one client at a time; port 0 takes a free one.
    Tcp(SocketAddr),
}

/// What a simulated device has sent so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceStats {
    /// Frames that were made.
    pub frames: u64,
    /// Frames that the line did not take: nobody was reading.
    pub dropped: u64,
    /// Frames that were not made because this process had no time to.
    pub skipped: u64,
}

#[derive(Debug, Default)]
struct Counters {
    frames: AtomicU64,
    dropped: AtomicU64,
    skipped: AtomicU64,
}

impl Counters {
    fn read(&self) -> DeviceStats {
        let get = |c: &AtomicU64| c.load(Ordering::Relaxed);
        DeviceStats { frames: get(&self.frames), dropped: get(&self.dropped), skipped: get(&self.skipped) }
    }
}

/// The encoder of a skin whose family has no wire of its own.
fn plain_encoder(skin: &SkinDescription) -> Result<Box<dyn Encoder>, TestbedError> {
    FrameWriter::new(skin).map(|writer| Box::new(writer) as Box<dyn Encoder>).ok_or_else(|| {
        TestbedError::Wire {
            skin: skin.name.clone(),
            reason: "is spoken by its sensor family only".to_owned(),
        }
    })
}
