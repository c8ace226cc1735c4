//! Effects that change what the model is computed from.

use dermis_mechanics::shell::{Orthotropy, Section};
use dermis_mechanics::{random_field, stream};
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use rand::Rng;
use rand::seq::index;

use super::EFFECTS;
use crate::parameters::{Clamp, Parameters};

/// Applies the static effects of a skin to the numbers that its model is computed from. Effects that remember
/// are checked and left to [`Dynamics`](super::Dynamics).
///
/// # Errors
///
/// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, has a value
/// that cannot be, or leaves a device that cannot be.
pub fn shape(skin: &SkinDescription, parameters: &mut Parameters) -> Result<(), ModelError> {
    Effect::apply(skin, EFFECTS, |info, effect| apply(info, effect, parameters))
}

/// What of an effect leaves an impossible device, and why.
type Impossible = (&'static str, String);

fn apply(info: &EffectInfo, effect: &Effect, parameters: &mut Parameters) -> Result<(), Impossible> {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    match info.name {
        "modulus" => {
            let factor = (1.0 + value("change")).powf(strength);
            parameters.sections.iter_mut().for_each(|s| s.young_modulus *= factor);
        }
        "thickness-field" => {
            let field = field(effect, value("length"), parameters);
            let sections = each(parameters);
            for (section, deviation) in sections.iter_mut().zip(field) {
                section.thickness *= (strength * value("spread") * deviation).exp();
            }
        }
        "print-anisotropy" => {
            let ratio = value("ratio").powf(strength);
            for section in &mut parameters.sections {
                section.orthotropy = Some(Orthotropy { ratio, direction: Vector3::x() });
            }
        }
        "clamp-compliance" => {
            let translation = value("stiffness") / strength;
            let rotation = translation * value("lever").powi(2);
            parameters.clamp = Clamp::Springs { translation, rotation };
        }
        "geometric-stiffening" => parameters.stiffening += strength * value("beta"),
        "gauge-gain" => {
            let (mean, spread) = (value("mean"), value("spread"));
            for (channel, gauge) in parameters.gauges.iter_mut().enumerate() {
                let differs = 1.0 + spread * stream(effect, channel).random_range(-1.0..=1.0);
                gauge.gain *= (mean * differs).powf(strength);
            }
        }
        "misplacement" => {
            let distance = strength * value("distance");
            let (surface, thickness) = (&parameters.surface, parameters.thickness);
            for (channel, gauge) in parameters.gauges.iter_mut().enumerate() {
                let mut rng = stream(effect, channel);
                let [along, across] = [(); 2].map(|()| distance * rng.random_range(-1.0..=1.0));
                let by = gauge.axis * along + gauge.normal.cross(&gauge.axis) * across;
                let (outside, normal) = surface.project(&(gauge.position + by));
                // The axis turns with the surface.
                let turn = UnitQuaternion::rotation_between(&gauge.normal, &normal).unwrap_or_default();
                gauge.position = outside - normal * thickness;
                gauge.axis = turn * gauge.axis;
                gauge.normal = normal;
            }
        }
        "misalignment" => {
            let angle = strength * value("angle");
            for (channel, gauge) in parameters.gauges.iter_mut().enumerate() {
                let by = angle * stream(effect, channel).random_range(-1.0..=1.0);
                gauge.axis =
                    UnitQuaternion::from_axis_angle(&Unit::new_normalize(gauge.normal), by) * gauge.axis;
            }
        }
        "transverse-sensitivity" => {
            parameters.gauges.iter_mut().for_each(|g| g.transverse += strength * value("coefficient"));
        }
        "dead-gauge" => {
            let (count, all) = (value("count"), parameters.gauges.len());
            if count.fract() != 0.0 || count > all as f64 {
                return Err(("count", format!("is {count} and must be a whole number, {all} at most")));
            }
            // The first of one order, so that more dead gauges are those before and others.
            let order = index::sample(&mut stream(effect, 0), all, all);
            for channel in order.into_iter().take(count as usize) {
                parameters.gauges[channel].gain *= (1.0 - strength).max(0.0);
            }
        }
        _ => {}
    }
    Ok(())
}

/// A section for each triangle.
fn each(parameters: &mut Parameters) -> &mut [Section] {
    if let [one] = &parameters.sections[..] {
        parameters.sections = vec![one.clone(); parameters.surface.triangles.len()];
    }
    &mut parameters.sections
}

/// A random field at the middles of the surface's triangles.
fn field(effect: &Effect, length: f64, parameters: &Parameters) -> Vec<f64> {
    let surface = &parameters.surface;
    let middle =
        |t: &[u32; 3]| t.iter().map(|i| surface.points[*i as usize].coords).sum::<Vector3<f64>>() / 3.0;
    random_field(effect, length, surface.triangles.iter().map(|t| middle(t).into()))
}
