use serde_json::json;

use super::*;

/// A report with a residual of 0.3 in most locations and of 0.4 in one, which leaves this share of the variance.
fn report(verdict: &str, share: f64) -> Report {
    let points: Vec<[f64; 3]> =
        (0..16).map(|i| [1e-3 * f64::from(i % 4), 1e-3 * f64::from(i / 4), 0.0]).collect();
    let values: Vec<Option<f64>> =
        (0..16).map(|i| (i > 2).then_some(if i == 9 { 0.4 } else { 0.3 })).collect();
    let map =
        json!({ "points": points, "mean": values, "rms": values, "peak": points[9], "prominence": 1.3 });
    serde_json::from_value(json!({
            "schema": "gap-report/2",
            "sentence": "a sentence",
            "verdict": verdict,
            "data": {
                "name": "bag", "hash": "", "skin": "skin", "skin_hash": "", "unit": "Pa", "channels": 4, "frames": 9,
                "presses": 3, "samples": 9, "locations": [3, 1], "repeats": 0, "sessions": [], "missing": [], "problems": [],
            },
            "gap": {
                "fvu_before": share, "floor": 0.9 * share, "systematic": 0.1 * share, "interval": [0.0, 0.2 * share],
                "irreproducible": null, "repeats": 0,
            },
            "where": [], "channels": [], "maps": [map], "consistency_checks": [], "effects": [], "suspects": [],
            "residual_reduction": null, "held_out": null,
            "unknown": {
                "share": 0.0, "library": 0.0, "model_discrepancy": 0.0, "explainable": 0.0, "fingerprint": [],
            },
            "next_experiments": [], "corrected": [],
            "provenance": {
                "tool": "dermis", "seed": 1, "library_hash": "", "tried": [], "silent": [], "model_discrepancy": [],
                "seconds": [0.0, 0.0],
            },
            "warnings": [],
        }))
        .unwrap()
}

/// Whether a colour of the page is a deep red: far more red than anything else.
fn deep_red(page: &str) -> bool {
    let colours = page.split('#').skip(1).filter_map(|rest| u32::from_str_radix(rest.get(..6)?, 16).ok());
    let mut channels = colours.map(|c| [16, 8, 0].map(|shift| i64::from((c >> shift) & 0xff)));
    channels.any(|[red, green, blue]| red - green.max(blue) > 100)
}

#[test]
fn a_page_of_no_gap_has_no_deep_red() {
    // With much noise the residual that 5 % of the variance would leave is smaller than what single locations show.
    for share in [1e-4, 0.02, 0.3] {
        let page = html(&report("no-gap-beyond-noise", share)).unwrap();
        assert!(page.contains("before: mean") && !deep_red(&page), "{share}");
    }
    assert!(deep_red(&html(&report("unknown-systematic", 0.3)).unwrap()));
    // A small gap is not painted like a large one, whatever the verdict.
    assert!(!deep_red(&html(&report("named", 1e-3)).unwrap()));
}

#[test]
fn the_last_colour_stands_for_a_share_of_the_variance() {
    let [small, large] = [0.05, 0.2].map(|share| full_colour(&report("named", share), 0.1));
    // The residual's root mean square leaves 5 %: it has the last colour itself; where it leaves 20 %, half of it has.
    let rms = ((12.0 * 0.09 + 0.16) / 13.0f64).sqrt();
    assert!((small - rms).abs() < 1e-12 && (large - rms / 2.0).abs() < 1e-12, "{small} {large}");
    assert_eq!(full_colour(&report("named", 0.05), 3.0), 3.0);
    assert_eq!(full_colour(&report("no-gap-beyond-noise", 0.05), 3.0), 6.0);
}

#[test]
fn a_map_without_a_value_is_a_sentence() {
    let mut report = report("no-gap-beyond-noise", 1e-4);
    report.maps[0].rms.fill(None);
    report.maps[0].mean.fill(None);
    let page = html(&report).unwrap();
    assert!(page.contains("There is no map") && !page.contains("before: mean"));
}
