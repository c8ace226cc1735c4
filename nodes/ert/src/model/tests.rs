use std::sync::LazyLock;

use approx::assert_relative_eq;
use dermis_model::Tip;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::*;

/// The panel that ships.
const PANEL: &str = include_str!("../../../../launch/skins/ert-panel.toml");
/// A panel of nine electrodes, flat.
pub const SMALL: &str = r#"
schema = "dermis-skin/1"
name = "small"
sensor = "ert"
frame_id = "small_link"
unit = "V"
rate = 100.0
noise = 1e-3
surface = { type = "rectangle", size = [0.2, 0.18], spacing = 0.01 }
[medium]
cells = [34, 30]
electrodes = { radius = 0.005, rows = [{ y = -0.06, x = [-0.07, 0.0, 0.07] }, { y = 0.0, x = [-0.07, 0.003, 0.07] }, { y = 0.06, x = [-0.07, 0.0, 0.07] }] }
sheet = { bottom = 1e4, top = 2.0 }
foam = { thickness = 0.008, young_modulus = 157e3, poisson_ratio = 0.03, densification = 0.85, surface_resistance = 1e11, conductance = 2e-3, reference_pressure = 5e4, exponent = 1.5, hysteresis = 0.1, creep = 0.02 }
top = { thickness = 0.0032, young_modulus = 95e3, poisson_ratio = 0.25, densification = 0.85 }
drive = { source_voltage = 3.0, source_resistance = 100.0, full_scale = 3.3, bits = 12 }
"#;

pub fn small(text: &str) -> SkinDescription {
    dermis_skin::register(crate::FAMILY);
    SkinDescription::from_toml(text, "small.toml").unwrap()
}

static FLAT: LazyLock<FabricModel> = LazyLock::new(|| FabricModel::new(&small(SMALL)).unwrap());
static CURVED: LazyLock<FabricModel> = LazyLock::new(|| {
    let text = SMALL.replace(
        "{ type = \"rectangle\", size = [0.2, 0.18], spacing = 0.01 }",
        "{ type = \"panel\", radius = 0.15, size = [0.2, 0.18], spacing = 0.01 }",
    );
    FabricModel::new(&small(&text)).unwrap()
});

fn contact(model: &FabricModel, at: [f64; 2], force: f64, flat: bool) -> Indentation {
    let (position, normal) = model.parameters.panel.roll(at);
    let shape =
        if flat { TipShape::FlatPunch { diameter: 0.02 } } else { TipShape::Sphere { diameter: 0.02 } };
    Indentation {
        position,
        force: -normal * force,
        tip: Tip { shape, orientation: UnitQuaternion::identity() },
    }
}

fn pressed(contacts: Vec<Indentation>) -> Stimulus {
    Stimulus { contacts, ..Stimulus::default() }
}

fn read(model: &FabricModel, stimulus: &Stimulus) -> Vec<f64> {
    let mut out = vec![0.0; model.channels()];
    model.response(stimulus, &mut out).unwrap();
    out
}

#[test]
fn the_panel_that_ships_has_its_channels() {
    let skin = small(PANEL);
    assert_eq!((skin.taxels.len(), skin.channels().len()), (28, 784));
    assert_eq!(skin.channels()[29].name, "e01-e01");
    assert_eq!((skin.channels()[30].name.as_str(), skin.channels()[30].taxel.as_str()), ("e01-e02", "e02"));
    let written = toml::to_string(&skin).unwrap();
    assert_eq!(SkinDescription::from_toml(&written, "written").unwrap(), skin);
    let model = FabricModel::new(&skin).unwrap();
    let mut untouched = vec![0.0; 784];
    model.untouched(&mut untouched).unwrap();
    let range = skin.range.unwrap();
    for v in &untouched {
        assert!((2.9..=3.0).contains(v) && *v < range[1], "{v} V untouched");
    }
    // 5 mm at 40 N under a flat tip of 20 mm (thesis, 4.2.4).
    let depth = model.stack().depth(&TipShape::FlatPunch { diameter: 0.02 }, 40.0).unwrap();
    assert_relative_eq!(depth, 5e-3, max_relative = 0.02);
}

#[test]
fn flat_and_curved_panels_are_one_sheet() {
    let at = [0.03, -0.041];
    let [flat, curved] = [&*FLAT, &*CURVED].map(|m| read(m, &pressed(vec![contact(m, at, 20.0, true)])));
    flat.iter().zip(&curved).for_each(|(a, b)| assert_relative_eq!(*a, *b, max_relative = 1e-9));
}

#[test]
fn a_press_lowers_voltages_and_two_are_not_their_sum() {
    let [a, b] = [contact(&FLAT, [0.03, 0.02], 40.0, true), contact(&FLAT, [-0.05, -0.03], 40.0, true)];
    let rest = read(&FLAT, &Stimulus::default());
    let change = |contacts| -> Vec<f64> {
        read(&FLAT, &pressed(contacts)).iter().zip(&rest).map(|(v, r)| v - r).collect()
    };
    let (one, other, both) = (change(vec![a.clone()]), change(vec![b.clone()]), change(vec![a, b]));
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!(one.iter().all(|v| *v <= 1e-12) && norm(&one) > 1e-3, "{}", norm(&one));
    let sum: Vec<f64> = one.iter().zip(&other).zip(&both).map(|((a, b), c)| a + b - c).collect();
    assert!(norm(&sum) > 2e-3 * norm(&both), "{} of {}", norm(&sum), norm(&both));
}

#[test]
fn where_on_the_grid_a_tip_is_hardly_matters() {
    // Total conductance as the tip moves across a cell: its second moment on the grid varies.
    let total = |x: f64, flat: bool| -> f64 {
        let pressures =
            FLAT.pressures(&pressed(vec![contact(&FLAT, [0.02 + x, 0.011], 20.0, flat)])).unwrap();
        pressures.iter().map(|&(node, p)| FLAT.conductance(node, p)).sum()
    };
    for flat in [true, false] {
        let all: Vec<f64> = (0..20).map(|i| total(f64::from(i) * 3e-4, flat)).collect();
        let mean = all.iter().sum::<f64>() / 20.0;
        all.iter().for_each(|g| assert!((g / mean - 1.0).abs() < 0.02, "{g} S where {mean} S is the mean"));
    }
}

#[test]
fn steps_that_are_held_end_at_the_response() {
    for model in [&*FLAT, &*CURVED] {
        let stimulus =
            pressed(vec![contact(model, [0.01, 0.0], 25.0, true), contact(model, [-0.03, 0.05], 9.0, false)]);
        let mut state = model.start(0);
        let mut out = vec![0.0; model.channels()];
        for t in 0..1000 {
            let mut part = stimulus.clone();
            // First loading, then a long time.
            part.contacts.iter_mut().for_each(|c| c.force *= f64::from(t + 1).min(100.0) / 100.0);
            state.step(f64::from(t) * 0.5, &part, &mut out).unwrap();
        }
        let wanted = read(model, &stimulus);
        out.iter().zip(&wanted).for_each(|(a, b)| assert!((a - b).abs() < 1e-7, "{a} {b}"));
    }
}

#[test]
fn the_way_back_reads_otherwise() {
    let mut state = FLAT.start(0);
    let mut at = |time: f64, force: f64| {
        let mut out = vec![0.0; FLAT.channels()];
        state.step(time, &pressed(vec![contact(&FLAT, [0.02, 0.02], force, true)]), &mut out).unwrap();
        out.iter().sum::<f64>()
    };
    let up = at(0.0, 10.0);
    at(0.01, 40.0);
    let down = at(0.02, 10.0);
    assert!(down < up, "foam conducts better on the way back: {down} V and {up} V in all");
}

#[test]
fn stimuli_that_cannot_be_are_refused() {
    let mut edge = contact(&FLAT, [0.0, 0.0], 5.0, true);
    edge.tip.shape = TipShape::Box { size: [0.01, 0.01] };
    let mut out = vec![0.0; FLAT.channels()];
    insta::assert_snapshot!(
        FLAT.response(&pressed(vec![edge]), &mut out).unwrap_err(),
        @r#"contact 0: its tip is a box, and this model knows spheres and flat punches: give a tip of shape "sphere" or "flat-punch""#
    );
    let off = Indentation { position: Point3::new(0.0, 0.0, 0.01), ..contact(&FLAT, [0.0, 0.0], 5.0, true) };
    assert!(FLAT.response(&pressed(vec![off]), &mut out).is_err());
}

#[test]
fn skins_that_cannot_be_are_refused_by_field() {
    let refused = |from: &str, to: &str| {
        assert!(SMALL.contains(from), "{from}");
        dermis_skin::register(crate::FAMILY);
        match SkinDescription::from_toml(&SMALL.replace(from, to), "small.toml") {
            Ok(skin) => FabricModel::new(&skin).unwrap_err().to_string(),
            Err(error) => error.to_string(),
        }
    };
    for (from, to, field) in [
        ("cells = [34, 30]", "cells = [3, 30]", "medium.cells[0]"),
        ("bottom = 1e4", "bottom = -1e4", "medium.sheet.bottom"),
        ("bits = 12", "bits = 99", "medium.drive.bits"),
        ("exponent = 1.5", "exponent = 0.5", "medium.foam.exponent"),
        ("creep = 0.02", "creep = 0.9", "medium.foam.creep"),
        ("y = 0.06", "y = 0.6", "medium.electrodes.rows"),
        ("unit = \"V\"", "unit = \"Pa\"", "unit"),
        ("top = 2.0", "top = 2.0, middle = 3.0", "medium.sheet.middle"),
        (
            "spacing = 0.01 }",
            "spacing = 0.01 }\ntaxels = [{ name = \"a\", position = [0.0, 0.0, 0.0] }]",
            "taxels",
        ),
    ] {
        let said = refused(from, to);
        assert!(said.contains(&format!("`{field}")), "{field}: {said}");
    }
}

/// Electrodes stay on the lower sheet, wherever a file that was written for other layers has them.
#[test]
fn layers_may_be_thicker_than_they_were_designed() {
    let mut skin = small(SMALL);
    for (layer, factor) in [("foam", 1.3), ("top", 1.8)] {
        let thickness = skin.medium.get_mut(layer).and_then(|table| table.get_mut("thickness")).unwrap();
        *thickness = toml::Value::Float(thickness.as_float().unwrap() * factor);
    }
    let thicker = FabricModel::new(&skin).unwrap();
    let press = pressed(vec![contact(&FLAT, [0.01, 0.02], 10.0, true)]);
    assert_ne!(read(&thicker, &press), read(&FLAT, &press));
    // One on the outside is a mistake.
    skin.taxels[4].position[2] = 0.0;
    let refused = FabricModel::new(&skin).unwrap_err().to_string();
    assert!(refused.contains("`taxels[4].position`"), "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Exact derivatives are those of central differences: of second order in the step on both sides.
    #[test]
    fn the_jacobian_is_that_of_differences(
        locations in proptest::collection::vec(proptest::array::uniform2(-0.07..0.07f64), 1..5),
        forces in proptest::array::uniform4(5.0..40.0f64), flat in any::<bool>(), curved in any::<bool>(),
    ) {
        let model = if curved { &*CURVED } else { &*FLAT };
        let contacts = locations.iter().zip(&forces).map(|(at, force)| contact(model, *at, *force, flat)).collect();
        let stimulus = pressed(contacts);
        let differences = Differences::default();
        let size = model.channels() * 3 * locations.len();
        let (mut exact, mut wanted) = (vec![0.0; size], vec![0.0; size]);
        model.jacobian(&stimulus, Unknowns::Normal, &differences, &mut exact).unwrap();
        differences.jacobian(model, &stimulus, Unknowns::Normal, &mut wanted).unwrap();
        for (column, (e, w)) in exact.chunks(model.channels()).zip(wanted.chunks(model.channels())).enumerate() {
            let scale = w.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            for (e, w) in e.iter().zip(w) {
                prop_assert!((e - w).abs() < 1e-3 * scale, "column {column}: {e} for {w} of {scale}");
            }
        }
    }

    /// Voltages are reciprocal around a cycle of three electrodes, whatever presses.
    #[test]
    fn voltages_are_reciprocal(
        at in proptest::array::uniform2(-0.07..0.07f64), force in 1.0..40.0f64, three in proptest::array::uniform3(0..9usize),
    ) {
        let v = read(&FLAT, &pressed(vec![contact(&FLAT, at, force, true)]));
        let [a, b, c] = three;
        let of = |j: usize, k: usize| v[9 * k + j];
        prop_assert!((of(a, b) * of(b, c) * of(c, a) / (of(b, a) * of(c, b) * of(a, c)) - 1.0).abs() < 1e-10);
        prop_assert!(v.iter().all(|v| *v > 0.0 && *v <= 3.0));
    }
}

#[test]
fn gravity_and_pressure_of_air_do_nothing() {
    let plain = pressed(vec![contact(&FLAT, [0.0, 0.01], 10.0, true)]);
    let other = Stimulus { gravity: Vector3::new(0.0, 0.0, -9.81), ambient_pressure: 9e4, ..plain.clone() };
    assert_eq!(read(&FLAT, &plain), read(&FLAT, &other));
}
