//! What a sensor family is to the rest of dermis.
//!
//! A family is one folder: all that is true of it only, as one implementation of [`Sensor`]. The node, the virtual testbed, the
//! studies and the gap diagnosis know it through that trait; a program lists its families once, in a [`Registry`].
//!
//! | seam | trait | default |
//! |---|---|---|
//! | what a skin file leaves to the family | [`Family`](dermis_skin::Family) | nothing |
//! | bytes of the device → frames | [`Decoder`] | the native wire, or lines of text ([`FrameReader`]) |
//! | frames → bytes of a simulated device | [`Encoder`] | the same wires ([`FrameWriter`]) |
//! | stimulus → readings | [`ForwardModel`], by [`Sensor::nominal`] | |
//! | what the nominal model leaves out | [`Sensor::effects`] | nothing but what is common to all |
//! | faults that only whole frames show | [`FrameCheck`], by [`Sensor::frame_check`] | none |
//! | where elements could be | [`Sensor::candidates`] | below the surface, as deep as now |
//! | figures of its physics beside references | [`Sensor::validation_cases`] | none |

mod candidates;
mod faults;
mod reader;
mod registry;
mod writer;

use std::sync::Arc;

pub use candidates::below_the_surface;
use dermis_model::{Case, ForwardModel};
use dermis_skin::{EffectInfo, Family, Frame, ModelError, SkinDescription, Taxel, WireProtocol};
use dermis_transport::ClockState;
use dermis_transport::framing::DecoderStats;
pub use faults::{ElementFault, FrameCheck};
pub use reader::FrameReader;
pub use registry::{Registry, UnknownSensor};
pub use writer::FrameWriter;

/// Finds the frames of a skin in a device's bytes.
///
/// A decoder takes bytes however they are cut up, never panics, holds a bounded amount of memory, and counts what it rejects.
pub trait Decoder: Send {
    /// Takes the next bytes, read at `received_ns` \[ns since the Unix epoch\], and appends the frames that end in them to
    /// `out`: values in the unit of the skin, stamped on the host clock with the time of acquisition.
    fn push(&mut self, bytes: &[u8], received_ns: i64, out: &mut Vec<Frame>);

    /// What to write to the device now, for one that answers requests. Called after every frame, and at least every 50 ms whether
    /// the link is up or not; `now_ns` \[ns since the Unix epoch\] says when an answer is overdue and the request is made again.
    fn request(&mut self, now_ns: i64) -> Option<Vec<u8>> {
        let _ = now_ns;
        None
    }

    /// Bytes are missing here: the link was lost, or the queue overflowed.
    fn gap(&mut self);

    /// What was decoded, rejected and lost so far.
    fn stats(&self) -> &DecoderStats;

    /// Where stamps come from.
    fn clock(&self) -> ClockState;

    /// Times that the device started again, or that its clock and this machine's jumped against each other.
    fn clock_jumps(&self) -> u64;

    /// What to write into the skin file where the device speaks another wire than that says; `None` where it does not, or
    /// nobody can tell yet.
    fn other_wire(&self) -> Option<String> {
        None
    }
}

/// How a decoder stamps frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderOptions {
    /// Stamps follow the device's clock as it is, from the first frame on: for recordings that are played at another pace than
    /// they were made at. A device without a clock is stamped on arrival all the same.
    pub device_time: bool,
}

/// Writes frames as the device of a skin sends them: what stands in for hardware.
pub trait Encoder: Send {
    /// The bytes of a frame; `device_time_us` is the device's clock \[µs\].
    ///
    /// # Errors
    ///
    /// A sentence where the wire cannot carry the frame.
    fn encode(&mut self, frame: &Frame, device_time_us: u64) -> Result<&[u8], String>;

    /// Whether the device sends only on request.
    fn on_request(&self) -> bool {
        false
    }

    /// Takes what the host wrote; returns how many frames that requests. A device that sends by itself ignores it.
    fn requested_frames(&mut self, bytes: &[u8]) -> usize {
        let _ = bytes;
        0
    }
}

/// A family of sensors: the only thing that the rest of dermis knows of it.
pub trait Sensor: Family {
    /// One line for people: what the program of its node says it does.
    fn about(&self) -> &'static str;

    /// The forward model without effects that every skin can have; those of the family are in it. See [`model`](Self::model).
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the family, or that skin, has no forward model.
    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError>;

    /// Stimulus → readings, with every effect that the description switches on.
    ///
    /// # Errors
    ///
    /// As [`nominal`](Self::nominal), and where an effect cannot be.
    fn model(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        dermis_model::device(skin, |inner| self.nominal(inner))
    }

    /// What is wrong with the table `medium` of a skin that has one, found without computing anything: a key that the family does
    /// not know, or a value that cannot be.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field.
    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        let _ = skin;
        Ok(())
    }

    /// Bytes → frames.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the family does not know the wire.
    fn decoder(
        &self,
        skin: &SkinDescription,
        options: DecoderOptions,
    ) -> Result<Box<dyn Decoder>, ModelError> {
        let reader = FrameReader::new(skin).ok_or_else(|| unknown_wire(skin))?;
        Ok(Box::new(if options.device_time { reader.with_device_time() } else { reader }))
    }

    /// Frames → bytes, for a simulated device.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the family does not know the wire.
    fn encoder(&self, skin: &SkinDescription) -> Result<Box<dyn Encoder>, ModelError> {
        Ok(Box::new(FrameWriter::new(skin).ok_or_else(|| unknown_wire(skin))?))
    }

    /// What the nominal model leaves out and a device of this family may have, besides what every device may have.
    fn effects(&self) -> &'static [EffectInfo] {
        &[]
    }

    /// What finds faults of such a device that no channel shows by itself.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the skin does not say what that takes.
    fn frame_check(&self, skin: &SkinDescription) -> Result<Option<Box<dyn FrameCheck>>, ModelError> {
        let _ = skin;
        Ok(None)
    }

    /// Where sensing elements of such a skin could be.
    ///
    /// # Errors
    ///
    /// [`ModelError`] where the skin leaves no place for any.
    fn candidates(&self, skin: &SkinDescription) -> Result<Vec<Taxel>, ModelError> {
        Ok(below_the_surface(skin))
    }

    /// Figures of the family's physics, computed now, beside their references. Those that another program judges are among them
    /// where it is installed.
    ///
    /// # Errors
    ///
    /// A sentence where a figure cannot be computed.
    fn validation_cases(&self) -> Result<Vec<Case>, String> {
        Ok(Vec::new())
    }

    /// What of a description the family refuses, found without computing anything: its medium and its wire.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field.
    fn check(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        self.check_medium(skin)?;
        self.decoder(skin, DecoderOptions::default()).map(drop)
    }
}

impl std::fmt::Debug for dyn Sensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Sensor({})", self.name())
    }
}

/// What is wrong with a skin whose wire its family does not know.
fn unknown_wire(skin: &SkinDescription) -> ModelError {
    let name = match &skin.wire.protocol {
        WireProtocol::Family(name) => name.clone(),
        known => String::from(known.clone()),
    };
    ModelError::Description {
        skin: skin.name.clone(),
        field: "wire.protocol".into(),
        reason: format!(
            "is \"{name}\", which sensor family `{}` does not speak; every family speaks native (binary frames) and ascii (lines of \
             text)",
            skin.sensor
        ),
    }
}
