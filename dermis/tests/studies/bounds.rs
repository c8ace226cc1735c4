use dermis_model::{TipShape, Unknowns};
use dermis_report::bounds as report;
use dermis_skin::SkinDescription;
use dermis_studies::Unwatched;
use dermis_studies::bounds::{Findings, Request, bound, by_interval, median};
use dermis_theory::{LineStudy, over_surface};

use crate::{FAMILIES, load, path};

fn options(skin: &str, line: bool) -> Request {
    Request { skin: path(skin), force: vec![0.2, 1.0], line, ..Request::default() }
}

fn find(request: &Request) -> anyhow::Result<Findings> {
    bound(request, &FAMILIES, &Unwatched)
}

#[test]
fn the_grid_is_bounded_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options("baro-grid.toml", false);
    // A pad that goes on beyond its surface is solved in closed form, one that ends by finite elements.
    let text = std::fs::read_to_string(&options.skin).unwrap().replace("edge = \"free\"", "edge = \"wide\"");
    options.skin = folder.path().join("wide.toml");
    std::fs::write(&options.skin, text).unwrap();
    options.trends = true;
    let findings = find(&options).unwrap();
    let html = report::html(&findings, &report::text(&findings)).unwrap();
    let json = serde_json::to_string(&findings).unwrap();
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(html.matches("<svg").count() >= 15 && !html.contains("NaN"));
    assert_eq!(
        value["maps"][0]["bounds"].as_array().unwrap().len(),
        value["points"].as_array().unwrap().len()
    );
    let at = |i: usize| value["summary"]["one_contact"][i]["position_m"]["median"].as_f64().unwrap();
    // Five times the force, on a skin that is nearly linear in it; a bound of micrometres would be a mistake.
    let inside = &value["surface"]["factors"];
    assert!(inside[1]["factor"].as_f64().unwrap() > inside[0]["factor"].as_f64().unwrap());
    assert_eq!(value["line"]["taxels"].as_array().unwrap().len(), 5);
    assert!(at(0) > 2.0 * at(1) && at(1) > 1e-6 && at(0) < 1e-3, "{} {}", at(0), at(1));
}

/// RMS over the row and over the forces of each interval of the thesis' Table 5.2 \[mm\], against what a prototype with
/// the same medium and noise gave.
#[test]
fn the_row_is_bounded_as_a_prototype_found() {
    let skin = load("baro-line.toml");
    let model = FAMILIES.model(&skin).unwrap();
    let edges = [0.02, 0.14, 0.2, 0.4, 0.6, 0.9, 1.2, 1.5];
    let expected = [0.45, 0.119, 0.072, 0.041, 0.027, 0.019, 0.015];
    for (interval, expected) in edges.windows(2).zip(expected) {
        let forces: Vec<f64> =
            (0..8).map(|i| interval[0] + (interval[1] - interval[0]) * (f64::from(i) + 0.5) / 8.0).collect();
        let squares = forces.iter().map(|f| {
            over_surface(model.as_ref(), *f, TipShape::Sphere { diameter: 0.004 }, Unknowns::Line)
                .unwrap()
                .position
                .rms
                .powi(2)
        });
        let rms = (squares.sum::<f64>() / forces.len() as f64).sqrt() * 1e3;
        assert!((rms / expected - 1.0).abs() < 0.35, "{interval:?} N: {rms:.4} mm, not {expected}");
    }
}

#[test]
fn the_row_is_reported_on_one_screen() {
    let options = options("baro-line.toml", true);
    let mut findings = find(&options).unwrap();
    insta::assert_snapshot!(report::text(&findings), @r#"
baro-line: least error of one contact from one frame (Cramér–Rao), tip of 4 mm, over the surface

force [N] |  pos. RMS   median     95 %    worst |     F RMS   median     95 %    worst
      0.2 |     0.101    0.092    0.138    0.198 |    0.0032   0.0033   0.0034   0.0034
        1 |     0.021    0.019    0.028    0.040 |    0.0033   0.0034   0.0034   0.0034

positions in mm, forces in N; `-`: the channels do not tell it
two contacts of 1 N across the middle can be distinguished from 3 mm on (to 0.272 mm each)

isolines from the forward model; σ_S 20.0 Pa as the skin description says; S_min 80 Pa
row of 6 taxels, 32.500 mm: c(0) = 0.156 N/kPa, linear within 1 %; F_S from 0.0186 to 0.0468 N
  I(d) = g + λ|d|^α, median α: 2.3 at 80 Pa, at most 3.7 at 295 Pa, 2.1 at 9534 Pa
  σ_P [mm], RMS, by force [N]       0.02-0.14 0.14-0.2  0.2-0.4  0.4-0.6  0.6-0.9  0.9-1.2  1.2-1.5
  fitted isolines of two (5.18)         0.547    0.267    0.138    0.070    0.044    0.031    0.025
  exact corners of two (5.7-5.10)       0.493    0.175    0.103    0.060    0.040    0.029    0.022
  Cramér–Rao bound of all               0.436    0.125    0.073    0.042    0.028    0.020    0.016
  fitted isolines of two (5.18): of 86.8, 100.0, 100.0, 100.0, 100.0, 100.0, 100.0 % of the line and the forces of each interval; elsewhere there is no estimate, or its error is infinite
  exact corners of two (5.7-5.10): of 83.8, 98.5, 98.5, 98.5, 98.5, 98.5, 98.5 % of the line and the forces of each interval; elsewhere there is no estimate, or its error is infinite
  Ω (5.20), mean over force: 71 by fits, 72 by corners, 102 by the bound; with the testbed (5.21): 56, 58, 75
"#);
    // What no channel tells somewhere is said with its share.
    findings.maps[0].position.infinite = 0.125;
    let open = "at 0.2 N the channels do not determine the position on 12.5 % of the surface";
    assert!(report::text(&findings).contains(open), "{}", report::text(&findings));
}

/// The tip and the forces that the panel is rated for, and no isolines: each of its channels reads the whole sheet.
#[test]
fn a_panel_is_bounded_without_isolines() {
    let request = Request { skin: path("ert-panel.toml"), ..Request::default() };
    let findings = find(&request).unwrap();
    assert_eq!(
        (findings.request.force.as_slice(), findings.request.diameter()),
        (&[5.0, 10.0, 20.0, 40.0][..], 0.02)
    );
    assert!(findings.line.is_none() && findings.surface.is_none());
    let medians: Vec<f64> = findings.maps.iter().map(|map| map.position.median).collect();
    assert!(medians.windows(2).all(|m| m[1] < m[0]), "a stronger press is known better: {medians:?}");
    assert!((1e-4..0.1).contains(&medians[1]), "{medians:?}");
    let text = report::text(&findings);
    assert!(
        text.contains("flat tip of 20 mm")
            && text.contains("isolines are not studied: the channels are coupled"),
        "{text}"
    );
    assert!(!text.contains("NaN") && !text.contains("σ_S"), "{text}");
    // Every line of the table is as long as its head.
    let table: Vec<usize> = text.lines().filter(|l| l.contains(" | ")).map(|l| l.chars().count()).collect();
    assert!(table.len() == 5 && table.iter().all(|length| *length == table[0]), "{text}");
}

#[test]
fn a_recording_says_what_the_model_does() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options("baro-line.toml", true);
    let skin = SkinDescription::load(&options.skin).unwrap();
    let model = FAMILIES.model(&skin).unwrap();
    let plan = dermis_testbed::Plan::from_toml(
        r#"
        schema = "dermis-plan/1"
        name = "row"
        diameter = 0.004
        seed = 3
        [timing]
        approach = [0.01, 0.01]
        load = [0.2, 0.2]
        hold = [0.05, 0.05]
        unload = [0.2, 0.2]
        gap = [0.05, 0.05]
        [[steps]]
        kind = "idle"
        duration = 5.0
        [[steps]]
        kind = "presses"
        count = 400
        force = [1.2, 1.5]
        "#,
        "row.toml",
    )
    .unwrap();
    let bag = folder.path().join("bag");
    dermis_testbed::collect(&model, &skin, &plan, &bag, &dermis_testbed::CollectOptions::default()).unwrap();
    let by_model = find(&options).unwrap();
    options.bag = vec![bag];
    let by_bag = find(&options).unwrap();
    let noise = by_bag.source.noise();
    assert!(noise.iter().all(|n| (n / 20.0 - 1.0).abs() < 0.15), "{noise:?}");
    let (exact, found) = (by_model.line.as_ref().unwrap(), by_bag.line.as_ref().unwrap());
    let c = |line: &LineStudy| median(line, |t| Some(t.c));
    assert!((c(found) / c(exact) - 1.0).abs() < 0.05, "{} {}", c(found), c(exact));
    let corners = |line: &LineStudy| by_interval(line, |f| f.corners);
    // Light presses are few, and the hardest ones saturate the taxel below them.
    for (interval, (exact, found)) in corners(exact).iter().zip(corners(found)).enumerate().skip(2).take(4) {
        let (exact, found) = (exact.unwrap(), found.unwrap());
        assert!((found / exact - 1.0).abs() < 0.3, "interval {interval}: {found} m, not {exact}");
    }
    let text = report::text(&by_bag);
    assert!(text.contains("recorded frames, tip of 4 mm; σ_S"), "{text}");
    // Another skin's bag is refused.
    options.skin = path("baro-grid.toml");
    let refusal = find(&options).err().unwrap().to_string();
    assert!(refusal.contains("bag"), "{refusal}");
}

#[test]
fn what_cannot_be_is_refused() {
    let refused = |options: &Request| find(options).err().unwrap().to_string();
    let row = options("baro-line.toml", true);
    insta::assert_snapshot!(refused(&Request { least: Some(-1.0), ..row }), @"option `--least` is -1 Pa and must be positive");
}

#[test]
fn a_skin_is_bounded_for_what_it_is_rated_for_where_nothing_is_said() {
    let skin = SkinDescription::load(path("baro-line.toml")).unwrap();
    let row = Request { force: vec![], diameter: None, ..options("baro-line.toml", true) }.for_skin(&skin);
    assert_eq!((row.force, row.diameter), (vec![0.05, 0.1, 0.2, 0.5, 1.0], Some(0.004)));
}
