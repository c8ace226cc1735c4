//! The panel that ships is as lively as the thesis' (Table 4.3): standard deviation of its voltages over the trials of the hexagonal
//! indenter, by number of tips.
//!
//! Trials as in 4.2.4: a random centre and a random common radius, tips of 20 mm on six arms at 60°, lowered together by 5 mm in ten
//! steps; trials below 5 N are dropped. The radius (30 to 150 mm) is assumed, and so is that tips are attached to neighbouring arms.
//!
//! `cargo nextest run -p dermis-ert calibration --no-capture` prints what the skin file's conductance and exponent achieve.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use dermis_ert::model::FabricModel;
use dermis_model::{ForwardModel, Indentation, Stimulus, Tip, TipShape};
use dermis_skin::SkinDescription;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PANEL: &str = include_str!("../../../launch/skins/ert-panel.toml");
/// \[V\] RMSE over the root of FVU, of the last row of Table 4.3: one to six contacts.
const THESIS: [f64; 6] = [0.017, 0.043, 0.054, 0.063, 0.079, 0.068];
/// Placements for each number of tips.
const PLACEMENTS: usize = 150;
const TIP: TipShape = TipShape::FlatPunch { diameter: 0.02 };

/// Standard deviation \[V\] of voltages over the trials with so many tips: root mean square over the channels.
fn deviation(model: &FabricModel, tips: usize) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(tips as u64);
    let channels = model.channels();
    let (mut sum, mut squares, mut count) = (vec![0.0; channels], vec![0.0; channels], 0.0);
    let mut out = vec![0.0; channels];
    let half = model.parameters().panel.size.map(|s| s / 2.0 - 0.012);
    let mut placed = 0;
    while placed < PLACEMENTS {
        let centre = half.map(|h| rng.random_range(-h..h));
        let radius = rng.random_range(0.03..0.15);
        let at = |arm: usize| {
            let (sin, cos) = (arm as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
            [centre[0] + radius * cos, centre[1] + radius * sin]
        };
        let locations: Vec<[f64; 2]> = (0..tips).map(at).collect();
        if !locations.iter().all(|p| p[0].abs() < half[0] && p[1].abs() < half[1]) {
            continue;
        }
        placed += 1;
        for step in 1..=10 {
            let force = model.parameters().stack.force(&TIP, 5e-4 * f64::from(step)).unwrap();
            if force < 5.0 {
                continue;
            }
            let press = |p: &[f64; 2]| Indentation {
                position: Point3::new(p[0], p[1], 0.0),
                force: Vector3::new(0.0, 0.0, -force),
                tip: Tip { shape: TIP, orientation: UnitQuaternion::identity() },
            };
            let stimulus =
                Stimulus { contacts: locations.iter().map(press).collect(), ..Stimulus::default() };
            model.response(&stimulus, &mut out).unwrap();
            for ((v, sum), squares) in out.iter().zip(&mut sum).zip(&mut squares) {
                (*sum, *squares) = (*sum + v, *squares + v * v);
            }
            count += 1.0;
        }
    }
    let variance = sum.iter().zip(&squares).map(|(s, q)| q / count - (s / count).powi(2));
    (variance.sum::<f64>() / channels as f64).sqrt()
}

#[test]
fn voltages_vary_as_much_as_the_thesis_says() {
    dermis_skin::register(dermis_ert::FAMILY);
    let skin = SkinDescription::from_toml(PANEL, "ert-panel.toml").unwrap();
    let model = FabricModel::new(&skin).unwrap();
    let mut ratios = 1.0;
    for (tips, wanted) in (1..).zip(THESIS) {
        let found = deviation(&model, tips);
        println!("{tips} tips: {:.1} mV, {:.1} mV in the thesis", found * 1e3, wanted * 1e3);
        assert!(
            (0.6..1.6).contains(&(found / wanted)),
            "{tips} tips: {found} V where {wanted} V are expected"
        );
        ratios *= found / wanted;
    }
    // What is calibrated: the geometric mean over all numbers.
    assert!((0.93..1.07).contains(&f64::powf(ratios, 1.0 / 6.0)), "{ratios}");
    let depth = model.parameters().stack.depth(&TIP, 40.0).unwrap();
    println!("40 N press a tip of 20 mm in by {:.2} mm, 5 mm in the thesis", depth * 1e3);
}
