//! A camera behind a soft pad: frames are pictures, on a wire of its own.
//!
//! Not a physical model: a press makes a dent, three lamps shade it in three colours, and the picture is requested and answered.

mod effects;
mod model;
mod wire;

use std::sync::Arc;

use dermis_model::ForwardModel;
use dermis_sensor::{Decoder, DecoderOptions, Encoder, Sensor};
use dermis_skin::{
    Channel, EffectInfo, Family, FieldFault, Image, ModelError, PixelFormat, SkinDescription, SurfaceSpec,
    Taxel, WireProtocol,
};

/// The family.
pub const FAMILY: &dyn Sensor = &Camera;

struct Camera;

/// Pixels along x and along y.
pub const SIZE: [u32; 2] = [320, 240];
/// Pixels along a side of a square whose mean is a number of a frame.
const BLOCK: usize = 20;
/// Squares along x and along y.
const BLOCKS: [usize; 2] = [SIZE[0] as usize / BLOCK, SIZE[1] as usize / BLOCK];
/// Colours of a pixel.
const COLOURS: usize = 3;
const WIRE: &str = "toy-picture";

/// Means over squares of pixels, by row, column and colour, 0 to 1.
fn means(image: &Image, out: &mut [f64]) -> bool {
    if [image.width(), image.height()] != SIZE || image.format() != PixelFormat::Rgb8 {
        return false;
    }
    out.fill(0.0);
    let width = SIZE[0] as usize;
    for (i, value) in image.data().iter().enumerate() {
        let (pixel, colour) = (i / COLOURS, i % COLOURS);
        let block = pixel / width / BLOCK * BLOCKS[0] + pixel % width / BLOCK;
        out[block * COLOURS + colour] += f64::from(*value);
    }
    let full = 255.0 * (BLOCK * BLOCK) as f64;
    out.iter_mut().for_each(|value| *value /= full);
    true
}

impl Family for Camera {
    fn name(&self) -> &'static str {
        "toy-camera"
    }

    fn complete(&self, skin: &mut SkinDescription) -> Result<(), FieldFault> {
        let SurfaceSpec::Rectangle { size, .. } = skin.surface else {
            return Err(FieldFault::new("surface.type", "must be \"rectangle\": the pad is flat"));
        };
        let [columns, rows] = BLOCKS;
        if skin.taxels.is_empty() {
            let along = |i: usize, n: usize, length: f64| ((i as f64 + 0.5) / n as f64 - 0.5) * length;
            skin.taxels = (0..columns * rows)
                .map(|i| Taxel {
                    name: format!("p{i}"),
                    position: [along(i % columns, columns, size[0]), along(i / columns, rows, size[1]), 0.0],
                    normal: [0.0, 0.0, 1.0],
                    axis: None,
                })
                .collect();
        }
        if skin.channels().is_empty() {
            let channels = skin.taxels.iter().flat_map(|taxel| {
                ["r", "g", "b"].map(|colour| Channel {
                    name: format!("{}.{colour}", taxel.name),
                    taxel: taxel.name.clone(),
                    range: None,
                    noise: None,
                })
            });
            let channels = channels.collect();
            skin.set_channels(channels);
        }
        Ok(())
    }
}

impl Sensor for Camera {
    fn about(&self) -> &'static str {
        "Reads the camera of a test and publishes its contacts"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(model::CameraModel::new(skin)?))
    }

    fn effects(&self) -> &'static [EffectInfo] {
        effects::EFFECTS
    }

    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        skin.check_medium(|| model::Medium::of(skin).map(drop))
    }

    fn decoder(&self, skin: &SkinDescription, _: DecoderOptions) -> Result<Box<dyn Decoder>, ModelError> {
        speaks(skin)?;
        Ok(Box::new(wire::PictureReader::new()))
    }

    fn encoder(&self, skin: &SkinDescription) -> Result<Box<dyn Encoder>, ModelError> {
        speaks(skin)?;
        Ok(Box::new(wire::PictureWriter::default()))
    }
}

/// Refuses another wire than the family's.
fn speaks(skin: &SkinDescription) -> Result<(), ModelError> {
    if skin.wire.protocol == WireProtocol::Family(WIRE.to_owned()) {
        return Ok(());
    }
    Err(ModelError::Description {
        skin: skin.name.clone(),
        field: "wire.protocol".into(),
        reason: format!("must be \"{WIRE}\""),
    })
}
