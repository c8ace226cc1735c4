//! Readings of devices with effects, alone and together, are those that were recorded when each effect was last reviewed.
//!
//! `DERMIS_RECORD=1 cargo nextest run -p dermis-barodome recorded` records them anew.

use std::path::Path;

use dermis_model::suite::Effects;
use dermis_model::{Indentation, Stimulus};
use dermis_skin::SkinDescription;
use nalgebra::{Point3, Vector3};

const PAD: &str = r#"
schema = "dermis-skin/1"
name = "pad"
sensor = "barodome"
frame_id = "pad_link"
unit = "Pa"
rate = 50.0
noise = 20.0
surface = { type = "rectangle", size = [0.02, 0.02], spacing = 0.002 }
taxels = [
    { name = "b0", position = [-0.00325, -0.00325, -0.005] },
    { name = "b1", position = [0.00325, -0.00325, -0.005] },
    { name = "b2", position = [-0.00325, 0.00325, -0.005] },
]
[medium]
thickness = 0.010
young_modulus = 70e3
poisson_ratio = 0.49
"#;
/// \[s\] between frames.
const FRAME: f64 = 0.02;

/// Two presses, of which the first slides and the second has another beside it; meanwhile it gets warmer.
fn stimuli() -> Vec<Stimulus> {
    let contact = |x: f64, y: f64, force: f64| {
        Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.1 * force, 0.0, -force), 0.004)
    };
    let at = |i: i32| {
        let t = f64::from(i) * FRAME;
        let mut contacts = Vec::new();
        if (0.1..0.7).contains(&t) {
            contacts.push(contact(-0.003 + 0.006 * t, -0.003, 2.0 * (t - 0.1)));
        }
        if t > 0.8 {
            contacts.push(contact(0.002, 0.001, 0.8));
            contacts.push(contact(-0.005, 0.004, 0.3 * t));
        }
        Stimulus {
            contacts,
            temperature: 293.15 + 4.0 * t,
            ambient_pressure: 101_325.0 + 40.0 * t,
            ..Stimulus::default()
        }
    };
    (0..60).map(at).collect()
}

#[test]
fn readings_are_those_that_were_recorded() {
    let skin = |effects| {
        let mut skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        skin.effects = effects;
        skin
    };
    let device = |skin: &SkinDescription| dermis_barodome::model(skin);
    let effects =
        Effects { known: dermis_barodome::effects::EFFECTS, skin: &skin, device: &device, frame: FRAME };
    effects.are_as_recorded(&stimuli(), &Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recorded.toml"));
}
