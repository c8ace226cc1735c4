//! What a skin file leaves to its family: the outside's triangles, and the numbers of a frame with what they see.

use dermis_skin::{Channel, FieldFault, ModelError, SkinDescription, Taxel};

use super::{MediumSpec, Parameters, shape};
use crate::optics::light::COLOURS;
use crate::optics::observer::PATTERNS;
use crate::optics::shading::inside;
use crate::optics::table::meets;

/// Numbers of a block: its colours, and how far its ridges have moved along the meridian and around.
const NAMES: [&str; COLOURS + PATTERNS] = ["r", "g", "b", "along", "around"];

/// Fills in the shape, and taxels and channels that a skin file leaves out: 20 × 15 blocks of pixels make 900 channels, and 600 more where
/// the inside has ridges.
///
/// # Errors
///
/// [`FieldFault`] names what cannot be.
pub fn complete(skin: &mut SkinDescription) -> Result<(), FieldFault> {
    let (thumb, _, rings) = shape(skin)?;
    skin.set_shape(rings.mesh(&thumb).map_err(|reason| FieldFault::new("surface.spacing", reason))?);
    if !skin.medium.is_empty() && skin.taxels.is_empty() {
        skin.taxels = taxels(&Parameters::nominal(skin).map_err(fault)?);
    }
    if skin.channels().is_empty() {
        let ridged = !skin.medium.is_empty() && MediumSpec::read(skin).map_err(fault)?.ridges.is_some();
        let names = if ridged { &NAMES[..] } else { &NAMES[..COLOURS] };
        let channels = skin.taxels.iter().flat_map(|taxel| {
            names.iter().map(|name| Channel {
                name: format!("{}.{name}", taxel.name),
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

/// The locations of the inside that the middles of blocks see.
fn taxels(parameters: &Parameters) -> Vec<Taxel> {
    let Parameters { camera, elastomer, blocks, .. } = parameters;
    let see = |i: u32| {
        let share = |k: u32, n: u32, pixels: u32| (f64::from(k) + 0.5) / f64::from(n) * f64::from(pixels);
        let at = [
            share(i % blocks[0], blocks[0], camera.size[0]),
            share(i / blocks[0], blocks[1], camera.size[1]),
        ];
        let [s, azimuth] = meets(elastomer, camera, at).unwrap_or([elastomer.thumb.length(), 0.0]);
        let (position, inwards) = inside(elastomer, s, azimuth);
        Taxel { name: format!("p{i:03}"), position: position.into(), normal: (-inwards).into(), axis: None }
    };
    (0..blocks[0] * blocks[1]).map(see).collect()
}

fn fault(error: ModelError) -> FieldFault {
    match error {
        ModelError::Description { field, reason, .. } => FieldFault { field, reason },
        other => FieldFault::new("medium", other.to_string()),
    }
}

/// Refuses a medium that cannot be, without computing anything.
///
/// # Errors
///
/// [`ModelError::Description`] names the field.
pub fn check(skin: &SkinDescription) -> Result<(), ModelError> {
    MediumSpec::read(skin).map(drop)
}
