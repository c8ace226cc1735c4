//! Effects that change what the model is computed from.

use std::f64::consts::TAU;

use dermis_mechanics::{random_field, stream};
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::Rng;
use rand_distr::StandardNormal;

use super::EFFECTS;
use crate::optics::light::COLOURS;
use crate::optics::shading::inside;
use crate::parameters::Parameters;

/// \[m\] that a cover or the elastomer has at least.
const THINNEST: f64 = 1e-4;

/// Applies the static effects of a skin to the numbers that its model is computed from.
///
/// # Errors
///
/// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, has a value that cannot
/// be, or leaves a device that cannot be.
pub fn shape(skin: &SkinDescription, parameters: &mut Parameters) -> Result<(), ModelError> {
    Effect::apply(skin, EFFECTS, |info, effect| {
        body(info, effect, parameters)?;
        lamps(info, effect, parameters);
        camera(info, effect, parameters);
        finish(info, effect, parameters)
    })
}

/// What of an effect leaves an impossible device, and why.
type Impossible = (&'static str, String);

/// Effects of elastomer and skeleton.
fn body(info: &EffectInfo, effect: &Effect, p: &mut Parameters) -> Result<(), Impossible> {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    match info.name {
        "stiffness" => p.stiffness *= (1.0 + value("change")).powf(strength),
        "stiffening" => p.stiffening += strength * value("share"),
        "flex" => p.flex += strength * value("compliance"),
        "thickness" => {
            let e = &mut p.elastomer;
            let thickness = e.thickness + strength * value("change");
            let least = e.skeleton.inside + e.skeleton.beam + THINNEST;
            if !(least..0.02).contains(&thickness) {
                return Err((
                    "change",
                    format!("makes {thickness:.5} m of elastomer, and must leave {least:.5} m"),
                ));
            }
            e.thickness = thickness;
            if let Some(fovea) = &mut e.fovea {
                fovea.thickness = (fovea.thickness + strength * value("change")).clamp(THINNEST, thickness);
            }
        }
        "skeleton-offset" => {
            let e = &mut p.elastomer;
            let (inside, most) =
                (e.skeleton.inside + strength * value("distance"), e.thickness - e.skeleton.beam - THINNEST);
            if !(THINNEST..most).contains(&inside) {
                return Err((
                    "distance",
                    format!(
                        "leaves {inside:.5} m inside of the skeleton, and must leave {THINNEST} to {most:.5} m"
                    ),
                ));
            }
            e.skeleton.inside = inside;
        }
        _ => {}
    }
    Ok(())
}

/// Effects of lamps.
fn lamps(info: &EffectInfo, effect: &Effect, p: &mut Parameters) {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    match info.name {
        "lamp-drift" => {
            for (k, lamp) in p.light.lamps.iter_mut().enumerate() {
                let by: f64 = stream(effect, k).sample(StandardNormal);
                let factor = (strength * value("spread") * by).exp();
                lamp.power.iter_mut().for_each(|power| *power *= factor);
            }
        }
        "lamp-temperature" => p.per_kelvin += strength * value("per_kelvin"),
        "interreflection" => p.ambient += strength * value("share"),
        _ => {}
    }
}

/// Effects of camera and lens.
fn camera(info: &EffectInfo, effect: &Effect, p: &mut Parameters) {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    match info.name {
        "colour-mixing" => {
            let share = (strength * value("share")).min(1.0);
            let others = Matrix3::from_fn(|i, j| if i == j { 0.0 } else { 0.5 });
            p.light.sensor = (Matrix3::identity() * (1.0 - share) + others * share) * p.light.sensor;
        }
        "colour-gain" => {
            for colour in 0..COLOURS {
                let by: f64 = stream(effect, colour).sample(StandardNormal);
                p.light
                    .sensor
                    .row_mut(colour)
                    .iter_mut()
                    .for_each(|g| *g *= (strength * value("spread") * by).exp());
            }
        }
        "camera-shift" => {
            let (sin, cos) = stream(effect, 0).random_range(0.0..TAU).sin_cos();
            p.camera.position += Vector3::new(cos, sin, 0.0) * (strength * value("distance"));
        }
        "camera-tilt" => {
            let (sin, cos) = stream(effect, 0).random_range(0.0..TAU).sin_cos();
            let turn = Vector3::new(cos, sin, 0.0) * (strength * value("angle"));
            p.camera.orientation = Rotation3::new(turn) * p.camera.orientation;
        }
        "focal-length" => p.camera.focal *= (1.0 + value("change")).powf(strength),
        "blur" => p.texture.blur = p.texture.blur.hypot(strength * value("pixels")),
        _ => {}
    }
}

/// Effects of the inside's finish.
fn finish(info: &EffectInfo, effect: &Effect, p: &mut Parameters) -> Result<(), Impossible> {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    match info.name {
        "albedo-field" => {
            let locations = (0..p.grid.count()).map(|node| {
                let [s, azimuth] = p.grid.place(node);
                <[f64; 3]>::from(inside(&p.elastomer, s, azimuth).0.coords)
            });
            let field = random_field(effect, value("length"), locations);
            let spread = strength * value("spread");
            p.texture.albedo = field.into_iter().map(|by| (spread * by).exp()).collect();
        }
        "glints" => {
            let count = value("count");
            if count.fract() != 0.0 {
                return Err(("count", format!("is {count} and must be a whole number")));
            }
            for k in 0..count as usize {
                let mut rng = stream(effect, k);
                let s = p.elastomer.thumb.length() * rng.random_range(0.0..1.0f64).sqrt();
                let at = inside(&p.elastomer, s, rng.random_range(0.0..TAU)).0;
                let size = value("size") * rng.random_range(0.5..1.5);
                p.texture.glints.push((
                    at,
                    size,
                    strength * value("brightness") * rng.random_range(0.5..1.5),
                ));
            }
        }
        _ => {}
    }
    Ok(())
}
