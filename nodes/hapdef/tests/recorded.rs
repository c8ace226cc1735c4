//! Readings of devices with effects, alone and together, are those that were recorded when each effect was last reviewed.
//!
//! `DERMIS_RECORD=1 cargo nextest run -p dermis-hapdef recorded` records them anew.

use std::path::Path;

use dermis_model::suite::Effects;
use dermis_model::{Indentation, Stimulus};
use dermis_skin::SkinDescription;
use nalgebra::{Point3, Vector3};

const PANEL: &str = r#"
schema = "dermis-skin/1"
name = "panel"
sensor = "hapdef"
frame_id = "panel_link"
unit = "1"
rate = 100.0
noise = 3e-6
surface = { type = "panel", radius = 0.045, size = [0.1, 0.06], spacing = 0.006, margin = 0.02, rail = 0.012, cells = [2, 1], beam = [0.02, 0.0] }
taxels = [
    { name = "g0", position = [0.0, 0.0, 0.043], axis = [1.0, 0.0, 0.0] },
    { name = "g1", position = [-0.04, 0.0, 0.043], axis = [1.0, 0.0, 0.0] },
    { name = "g2", position = [0.038, 0.0, 0.043], axis = [0.0, 1.0, 0.0] },
]
[medium]
thickness = 0.002
young_modulus = 1.7e9
poisson_ratio = 0.394
gauge = [0.008, 0.005]
"#;
/// \[s\] between frames.
const FRAME: f64 = 0.02;

/// Two presses, of which the first slides and the second has another beside it; meanwhile it gets warmer.
fn stimuli() -> Vec<Stimulus> {
    let contact = |x: f64, arc: f64, force: f64| {
        let (sin, cos) = (arc / 0.045).sin_cos();
        let normal = Vector3::new(0.0, sin, cos);
        Indentation::sphere(
            Point3::from(normal * 0.045) + Vector3::x() * x,
            Vector3::x() * (0.1 * force) - normal * force,
            0.01,
        )
    };
    let at = |i: i32| {
        let t = f64::from(i) * FRAME;
        let mut contacts = Vec::new();
        if (0.1..0.7).contains(&t) {
            contacts.push(contact(-0.004 + 0.01 * t, 0.0, 20.0 * (t - 0.1)));
        }
        if t > 0.8 {
            contacts.push(contact(0.004, 0.004, 8.0));
            contacts.push(contact(-0.004, -0.006, 3.0 * t));
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
        let mut skin = SkinDescription::from_toml(PANEL, "panel.toml").unwrap();
        skin.effects = effects;
        skin
    };
    let device = |skin: &SkinDescription| dermis_hapdef::model(skin);
    let effects =
        Effects { known: dermis_hapdef::effects::EFFECTS, skin: &skin, device: &device, frame: FRAME };
    effects.are_as_recorded(&stimuli(), &Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recorded.toml"));
}
