//! Effects that change what the model is computed from.

use dermis_mechanics::stream;
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription, SurfaceSpec};
use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use rand::Rng;

use super::EFFECTS;
use crate::parameters::{Element, Parameters};

/// Applies the static effects of a skin to the numbers that its model is computed from. Effects that remember
/// are checked and left to [`Dynamics`](super::Dynamics).
///
/// # Errors
///
/// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, has a value
/// that cannot be, or leaves a device that cannot be.
pub fn shape(skin: &SkinDescription, parameters: &mut Parameters) -> Result<(), ModelError> {
    Effect::apply(skin, EFFECTS, |info, effect| apply(info, effect, skin, parameters))
}

/// What of an effect leaves an impossible device, and why.
type Impossible = (&'static str, String);

fn apply(
    info: &EffectInfo,
    effect: &Effect,
    skin: &SkinDescription,
    parameters: &mut Parameters,
) -> Result<(), Impossible> {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    match info.name {
        "modulus" => parameters.young_modulus *= (1.0 + value("change")).powf(strength),
        "thickness" => {
            parameters.thickness += strength * value("change");
            fits(parameters).map_err(|reason| ("change", reason))?;
        }
        "base-bonding" => {
            let share = strength * value("slip");
            if share > 1.0 {
                return Err((
                    "strength",
                    format!("is {strength}, and makes {share} of the base slip: 1 at most"),
                ));
            }
            parameters.slip += share * (1.0 - parameters.slip);
        }
        "misplacement" => {
            let (lateral, depth) = (strength * value("lateral"), strength * value("depth"));
            each_taxel(skin, parameters, |taxel, element| {
                let mut rng = stream(effect, taxel);
                let by =
                    Vector3::new(lateral, lateral, depth).map(|most| most * rng.random_range(-1.0..=1.0));
                element.position += upright(&element.normal) * by;
            });
            fits(parameters).map_err(|reason| ("depth", reason))?;
        }
        "tilt" => {
            let (angle, lever) = (strength * value("angle"), value("lever"));
            each_taxel(skin, parameters, |taxel, element| {
                let mut rng = stream(effect, taxel);
                let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
                let axis = Unit::new_normalize(upright(&element.normal) * Vector3::new(cos, sin, 0.0));
                let turn = UnitQuaternion::from_axis_angle(&axis, angle * rng.random_range(0.0..=1.0));
                let tilted = turn * element.normal;
                element.position += (tilted - element.normal) * lever;
                element.normal = tilted;
            });
            fits(parameters).map_err(|reason| ("lever", reason))?;
        }
        "footprint" => {
            let sides = [strength * value("length"), strength * value("width")];
            parameters.elements.iter_mut().for_each(|e| e.footprint = sides);
        }
        "inclusion-gain" => {
            let (mean, spread) = (value("mean"), value("spread"));
            for (channel, element) in parameters.elements.iter_mut().enumerate() {
                let differs = 1.0 + spread * stream(effect, channel).random_range(-1.0..=1.0);
                element.gain *= (mean * differs).powf(strength);
            }
        }
        "package-stiffening" => {
            parameters.stiffening += strength * value("rise");
            parameters.stiffening_reach = value("reach");
        }
        "indenter-size" => parameters.diameter_scale *= value("scale").powf(strength),
        _ => {}
    }
    Ok(())
}

/// Calls `change` for every channel's element with the number of its taxel: channels of one taxel share its package.
fn each_taxel(
    skin: &SkinDescription,
    parameters: &mut Parameters,
    mut change: impl FnMut(usize, &mut Element),
) {
    for (taxel, element) in skin.channel_taxels().into_iter().zip(&mut parameters.elements) {
        change(taxel, element);
    }
}

/// Turns the axes of the link so that z becomes `normal`.
fn upright(normal: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), normal)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// Why the elements do not lie in the elastomer, if they do not.
fn fits(parameters: &Parameters) -> Result<(), String> {
    let thickness = parameters.thickness;
    if thickness <= 0.0 {
        return Err(format!("leaves {thickness} m of elastomer"));
    }
    for element in &parameters.elements {
        let depth = depth(&parameters.surface, &element.position);
        if !(depth > 0.0 && depth <= thickness) {
            return Err(format!(
                "leaves a taxel at a depth of {depth:.6} m in {thickness:.6} m of elastomer"
            ));
        }
    }
    Ok(())
}

/// \[m\] below the surface.
fn depth(surface: &SurfaceSpec, point: &Point3<f64>) -> f64 {
    match *surface {
        SurfaceSpec::Rectangle { .. } => -point.z,
        // Refused before.
        SurfaceSpec::Panel { .. } | SurfaceSpec::Mesh { .. } | SurfaceSpec::Family(_) => f64::NAN,
        SurfaceSpec::Dome { radius, cylinder, .. } => {
            let up = (point.z - cylinder).max(0.0);
            radius - Vector3::new(point.x, point.y, up).norm()
        }
    }
}
