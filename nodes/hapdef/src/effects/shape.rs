//! Effects that change what the model is computed from.

use dermis_mechanics::shell::{Orthotropy, Section};
use dermis_mechanics::stream;
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use rand::Rng;
use rand::seq::index;
use rand_distr::StandardNormal;

use super::EFFECTS;
use crate::parameters::{Clamp, Parameters, refusal};

/// Waves that make up a random field: many, so that it is close to Gaussian.
const WAVES: usize = 200;

/// Applies the static effects of a skin to the numbers that its model is computed from. Effects that remember
/// are checked and left to [`Dynamics`](super::Dynamics).
///
/// # Errors
///
/// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, has a value
/// that cannot be, or leaves a device that cannot be.
pub fn shape(skin: &SkinDescription, parameters: &mut Parameters) -> Result<(), ModelError> {
    Effect::check(&skin.effects, EFFECTS, &skin.name)?;
    // In the order of the table, so that the order in the file makes no difference.
    for info in EFFECTS {
        let on = |e: &&Effect| e.name == info.name && e.strength > 0.0;
        let Some(effect) = skin.effects.iter().find(on) else { continue };
        apply(info, effect, parameters).map_err(|(name, reason)| {
            let i = skin.effects.iter().position(|e| e.name == info.name).unwrap_or_default();
            refusal(skin, &format!("effects[{i}].{name}"), reason)
        })?;
    }
    Ok(())
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

/// A random field on the triangles: normal, its correlation falling as exp(−d²/2ℓ²) with the distance d (Rahimi and Recht's random
/// waves, in space).
fn field(effect: &Effect, length: f64, parameters: &Parameters) -> Vec<f64> {
    let mut rng = stream(effect, 0);
    let waves: Vec<(Vector3<f64>, f64)> = (0..WAVES)
        .map(|_| {
            let wave = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal)) / length;
            (wave, rng.random_range(0.0..std::f64::consts::TAU))
        })
        .collect();
    let scale = (2.0 / WAVES as f64).sqrt();
    let surface = &parameters.surface;
    let at = |t: &[u32; 3]| {
        let middle: Vector3<f64> =
            t.iter().map(|i| surface.points[*i as usize].coords).sum::<Vector3<f64>>() / 3.0;
        scale * waves.iter().map(|(k, phase)| (k.dot(&middle) + phase).cos()).sum::<f64>()
    };
    surface.triangles.iter().map(at).collect()
}
