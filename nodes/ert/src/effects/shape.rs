//! Effects that change what the model is computed from.

use dermis_mechanics::{random_field, stream};
use dermis_skin::{Effect, EffectInfo, ModelError, SkinDescription};
use rand::Rng;
use rand::seq::index;

use super::EFFECTS;
use crate::memory::Memory;
use crate::parameters::Parameters;

/// Applies the static effects of a skin to the numbers that its model is computed from.
///
/// # Errors
///
/// [`ModelError::Description`] with the field `effects[i].…` where an effect or one of its parameters is unknown, has a value
/// that cannot be, or leaves a device that cannot be.
pub fn shape(skin: &SkinDescription, parameters: &mut Parameters) -> Result<(), ModelError> {
    Effect::apply(skin, EFFECTS, |info, effect| {
        fabric(info, effect, parameters).and_then(|()| wiring(info, effect, parameters))
    })
}

/// What of an effect leaves an impossible device, and why.
type Impossible = (&'static str, String);

/// Effects of sheets and foam.
fn fabric(info: &EffectInfo, effect: &Effect, p: &mut Parameters) -> Result<(), Impossible> {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    let grown = |change: f64| (1.0 + change).powf(strength);
    match info.name {
        "sheet-resistance" => {
            let factor = grown(value("change"));
            p.resistance.iter_mut().for_each(|r| *r *= factor);
        }
        "sheet-field" => {
            let locations = (0..p.grid.count()).map(|node| p.grid.position(node));
            let field = random_field(effect, value("length"), locations);
            let spread = strength * value("spread");
            p.field = Some(field.into_iter().map(|deviation| (spread * deviation).exp()).collect());
        }
        "sheet-anisotropy" => {
            let factor = value("ratio").powf(strength / 2.0);
            p.resistance[0] *= factor;
            p.resistance[1] /= factor;
        }
        "climate" => {
            p.damp += strength * value("humidity") * value("per_humidity");
            p.per_kelvin += strength * value("per_kelvin");
        }
        "foam-stiffness" => {
            let factor = grown(value("change"));
            p.stack.layers[0].young_modulus *= factor;
            // A stiffer foam takes more pressure for the compression that lets it conduct.
            p.piezo.reference *= factor;
            p.stack = crate::foam::Stack::new(p.stack.layers[0], p.stack.layers[1]);
        }
        "foam-gain" => p.piezo.conductance *= grown(value("change")),
        "foam-exponent" => p.piezo.exponent += strength * value("change"),
        "foam-hysteresis" => p.memory.hysteresis += strength * value("width"),
        "foam-creep" => {
            p.memory.creep += strength * value("share");
            if p.memory.creep > Memory::MOST_CREEP {
                let reason = format!(
                    "makes {:.3} in all with what the skin has, and must be {} at most",
                    p.memory.creep,
                    Memory::MOST_CREEP
                );
                return Err(("share", reason));
            }
        }
        "air-gap" => p.piezo.threshold += strength * value("pressure"),
        "pre-stretch" => {
            p.resistance[0] *= 1.0 + strength * value("gauge_factor") * value("strain");
            p.tension += strength * value("pressure");
        }
        "wrinkles" => wrinkles(info, effect, p)?,
        _ => {}
    }
    Ok(())
}

/// Effects of electrodes, wires and multiplexer.
fn wiring(info: &EffectInfo, effect: &Effect, p: &mut Parameters) -> Result<(), Impossible> {
    let strength = effect.strength;
    let value = |name: &str| info.value(effect, name);
    let n = p.electrodes.len();
    match info.name {
        "electrode-impedance" => {
            for (e, impedance) in p.drive.impedance.iter_mut().enumerate() {
                *impedance += strength * value("resistance") * stream(effect, e).random_range(0.0..=2.0);
            }
        }
        "electrode-radius" => {
            let most = value("deviation");
            for (e, electrode) in p.electrodes.iter_mut().enumerate() {
                // Times a factor, so that nothing is left of no electrode.
                let by = most * stream(effect, e).random_range(-1.0..=1.0) / electrode.radius;
                electrode.radius *= (strength * by).exp();
            }
        }
        "electrode-place" => {
            let distance = strength * value("distance");
            for (e, electrode) in p.electrodes.iter_mut().enumerate() {
                let mut rng = stream(effect, e);
                for k in 0..2 {
                    let half = p.grid.size[k] / 2.0;
                    let by = distance * rng.random_range(-1.0..=1.0);
                    electrode.at[k] = (electrode.at[k] + by).clamp(-half, half);
                }
            }
        }
        "mux-resistance" => p.drive.series += strength * value("resistance"),
        "ground-resistance" => p.drive.ground += strength * value("resistance"),
        "mux-leakage" => p.drive.leakage = (p.drive.leakage + strength * value("share")).min(1.0),
        "settling" => p.drive.unsettled = (p.drive.unsettled + strength * value("share")).min(1.0),
        "open-electrode" => {
            for e in chosen(effect, value("count"), 1, n)? {
                p.drive.whole[e] *= (1.0 - strength).max(0.0);
            }
        }
        "shorted-electrode" => {
            for e in chosen(effect, value("count"), 1, n)? {
                p.drive.short[e] += strength / value("resistance");
            }
        }
        "exchanged-electrodes" => {
            let mut really: Vec<usize> = (0..n).collect();
            let pairs = chosen(effect, value("count"), 2, n)?;
            pairs.chunks_exact(2).for_each(|pair| really.swap(pair[0], pair[1]));
            p.drive.exchanged = Some((really, strength.min(1.0)));
        }
        _ => {}
    }
    Ok(())
}

/// So many times `each` electrodes: the first of one order, so that more of them are those before and others.
fn chosen(effect: &Effect, count: f64, each: usize, all: usize) -> Result<Vec<usize>, Impossible> {
    let most = all / each;
    if count.fract() != 0.0 || count > most as f64 {
        return Err(("count", format!("is {count} and must be a whole number, {most} at most")));
    }
    Ok(index::sample(&mut stream(effect, 0), all, all).into_iter().take(each * count as usize).collect())
}

/// Folds that press the foam along lines: each with a place, a direction, a length and a pressure of its own.
fn wrinkles(info: &EffectInfo, effect: &Effect, p: &mut Parameters) -> Result<(), Impossible> {
    let value = |name: &str| info.value(effect, name);
    let count = value("count");
    if count.fract() != 0.0 {
        return Err(("count", format!("is {count} and must be a whole number")));
    }
    let mut pressures = vec![0.0; p.grid.count()];
    for fold in 0..count as usize {
        let mut rng = stream(effect, fold);
        let middle = p.grid.size.map(|size| size * rng.random_range(-0.5..=0.5));
        let (sin, cos) = rng.random_range(0.0..std::f64::consts::PI).sin_cos();
        let length = p.grid.size[0].min(p.grid.size[1]) * rng.random_range(0.1..=0.4);
        let peak = effect.strength * value("pressure") * rng.random_range(0.3..=1.0);
        for (node, pressure) in pressures.iter_mut().enumerate() {
            let at = p.grid.position(node);
            let [x, y] = [at[0] - middle[0], at[1] - middle[1]];
            let (along, across) = ((cos * x + sin * y) / length, (cos * y - sin * x) / value("width"));
            *pressure += peak * (-0.5 * (along * along + across * across)).exp();
        }
    }
    p.wrinkles = Some(pressures);
    Ok(())
}
