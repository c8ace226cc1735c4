use dermis_studies::bounds::{Trend, TrendCurve, feet, trends};

use crate::{FAMILIES, load};

#[test]
fn pressures_follow_depth_thickness_poisson_and_tip() {
    let skin = load("baro-line.toml");
    let model = FAMILIES.model(&skin).unwrap();
    let feet = feet(&skin, model.surface());
    let trends = trends(&skin, &model, &feet, 0.004, &FAMILIES).unwrap();
    let labels: Vec<&str> = trends.iter().map(|t| t.label).collect();
    assert_eq!(labels.len(), 4, "{labels:?}");
    // Force straight above the taxel, and how much more it is 5 mm beside it; in the order of what varies.
    let at = |trend: &Trend, d: f64| -> Vec<f64> {
        let near = |c: &TrendCurve| {
            c.isoline.iter().min_by(|a, b| (a[0] - d).abs().total_cmp(&(b[0] - d).abs())).unwrap()[1]
        };
        trend.curves.iter().map(near).collect()
    };
    let rises = |v: &[f64]| v.windows(2).all(|w| w[1] > w[0]);
    let [depth, thickness, poisson, tip] = trends.as_slice() else { panic!("{labels:?}") };
    // A shallower taxel is more sensitive above and falls off faster.
    let depths = at(depth, 0.0);
    assert!(rises(&depths[..3]), "{depths:?}");
    let falls: Vec<f64> = at(depth, 0.005).iter().zip(&depths).map(|(far, near)| far / near).collect();
    assert!(falls[0] > falls[1] && falls[1] > falls[2], "{falls:?}");
    // Pressure is where the elastomer cannot give way: thinner and less compressible is more sensitive, other than
    // displacement.
    assert!(rises(&at(thickness, 0.0)), "{:?}", at(thickness, 0.0));
    assert!(at(poisson, 0.0)[0] > *at(poisson, 0.0).last().unwrap());
    // A larger tip spreads its force.
    assert!(at(tip, 0.0)[0] < *at(tip, 0.0).last().unwrap(), "{:?}", at(tip, 0.0));
}
