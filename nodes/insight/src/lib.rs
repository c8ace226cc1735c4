//! A camera inside a soft thumb (thesis, chapter 6): an elastomer over a stiff skeleton, lit from within by lamps of three colours, whose
//! deformation a fisheye camera sees.
//!
//! Forces on the points of the outside ([`surface`]) become displacements of the inside ([`elastic`]), these change how it looks ([`optics`]),
//! and [`model`] answers with pictures and with the numbers of their blocks.

pub mod effects;
pub mod elastic;
mod jpeg;
pub mod model;
pub mod optics;
pub mod parameters;
pub mod shape;
pub mod surface;
pub mod verify;
pub mod wire;

use std::sync::Arc;

use dermis_model::{Case, ForwardModel};
use dermis_sensor::{Decoder, DecoderOptions, Encoder, FrameReader, FrameWriter, Sensor};
use dermis_skin::{
    EffectInfo, Family, FieldFault, ModelError, Rated, SkinDescription, TipKind, WireProtocol,
};

/// What a skin description names in `sensor` for this family.
pub const SENSOR: &str = "insight";

/// The family.
pub const FAMILY: &dyn Sensor = &Insight;

#[derive(Debug)]
struct Insight;

impl Family for Insight {
    fn name(&self) -> &'static str {
        SENSOR
    }

    fn complete(&self, skin: &mut SkinDescription) -> Result<(), FieldFault> {
        parameters::complete(skin)
    }

    /// As chapter 6 of the thesis presses its thumb.
    fn rated(&self, _: &SkinDescription) -> Rated {
        Rated { force: [0.03, 1.6], diameter: 0.004, tip: TipKind::Sphere }
    }
}

impl Sensor for Insight {
    fn about(&self) -> &'static str {
        "Reads the camera inside a soft thumb and publishes its contacts"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(model::ThumbModel::new(skin)?))
    }

    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        skin.check_medium(|| parameters::check(skin))
    }

    /// Of the camera's own wire; the wires that every family speaks carry the numbers alone.
    fn decoder(
        &self,
        skin: &SkinDescription,
        options: DecoderOptions,
    ) -> Result<Box<dyn Decoder>, ModelError> {
        if let Some(protocol) = pictures(skin) {
            let observer = model::observer(&parameters::Parameters::nominal(skin)?);
            return Ok(match protocol {
                Pictures::OnRequest => Box::new(wire::PictureReader::new(observer)),
                Pictures::Streamed => Box::new(wire::stream::StreamReader::new(observer)),
            });
        }
        let reader = FrameReader::new(skin).ok_or_else(|| unknown_wire(skin))?;
        Ok(Box::new(if options.device_time { reader.with_device_time() } else { reader }))
    }

    fn encoder(&self, skin: &SkinDescription) -> Result<Box<dyn Encoder>, ModelError> {
        match pictures(skin) {
            Some(Pictures::OnRequest) => return Ok(Box::new(wire::PictureWriter::default())),
            Some(Pictures::Streamed) => return Err(skin.refusal("wire.protocol", not_spoken())),
            None => {}
        }
        Ok(Box::new(FrameWriter::new(skin).ok_or_else(|| unknown_wire(skin))?))
    }

    fn effects(&self) -> &'static [EffectInfo] {
        effects::EFFECTS
    }

    fn validation_cases(&self) -> Result<Vec<Case>, String> {
        let mut cases = verify::cases().map_err(|error| error.to_string())?;
        if dermis_mechanics::calculix::available() {
            cases.extend(verify::judged().map_err(|error| error.to_string())?);
        }
        Ok(cases)
    }
}

/// How pictures come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pictures {
    /// One for each request.
    OnRequest,
    /// One after another.
    Streamed,
}

/// `None` where numbers come.
fn pictures(skin: &SkinDescription) -> Option<Pictures> {
    let WireProtocol::Family(name) = &skin.wire.protocol else { return None };
    match name.as_str() {
        wire::NAME => Some(Pictures::OnRequest),
        wire::stream::NAME => Some(Pictures::Streamed),
        _ => None,
    }
}

fn not_spoken() -> String {
    format!(
        "is \"{}\", which is read from a camera's web server and not spoken by a simulated device; set \"{}\" for that",
        wire::stream::NAME,
        wire::NAME
    )
}

fn unknown_wire(skin: &SkinDescription) -> ModelError {
    skin.refusal(
        "wire.protocol",
        format!(
            "must be \"{}\" or \"{}\" (pictures), \"native\" or \"ascii\" (their numbers)",
            wire::NAME,
            wire::stream::NAME
        ),
    )
}

/// Stimulus → numbers and pictures, for skins whose `medium` says what the thumb is made of.
///
/// # Errors
///
/// [`ModelError::Description`] where the thumb cannot be.
pub fn model(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
    FAMILY.model(skin)
}
