use super::*;
use crate::testing::square::{geometry, map, points};
use crate::testing::{BEGIN, MS, robot};

/// Skins `a` and `b` of the robot, of which the second is pushed to where it covers half of the first, 5 mm above it.
fn overlapping() -> (Robot, Maps) {
    let mut robot = robot();
    let chest = robot.skins[0].link;
    robot.skins[1].link = chest;
    robot.skins[1].pose = robot.skins[0].pose * Isometry3::translation(0.02, 0.0, 0.005);
    let mut maps = Maps::new(&robot);
    for (skin, frame) in [(0, "a_skin"), (1, "b_skin")] {
        maps.take_geometry(&robot, skin, &geometry(frame)).unwrap();
    }
    (robot, maps)
}

/// A press of 3.2 N over both skins counts once, whatever part of it each of them sees.
#[test]
fn a_force_on_two_skins_counts_once() {
    let (robot, mut maps) = overlapping();
    // 0.1 N a point where x of the chest is from 0 to 20 mm: half of each skin.
    let press =
        |low: bool| -> Vec<f32> { (0..64).map(|k| if (k % 8 < 4) == low { 0.1 } else { 0.0 }).collect() };
    maps.take(&robot, 0, map("a_skin", BEGIN, press(false))).unwrap();
    let poses = robot.body.poses(&[0.0]);
    let sum = |maps: &Maps, stamp: Stamp| -> f32 {
        points(&maps.cloud(&robot, &poses, stamp, &[true; 3])).iter().map(|p| p[8]).sum()
    };
    assert!((sum(&maps, BEGIN) + 3.2).abs() < 1e-5, "one skin alone has all of it");
    maps.take(&robot, 1, map("b_skin", BEGIN + 50 * MS, press(true))).unwrap();
    assert!((sum(&maps, BEGIN + 50 * MS) + 3.2).abs() < 1e-5, "two skins say the same force");
    // The first goes stale: the second has it alone.
    assert!((sum(&maps, BEGIN + 210 * MS) + 3.2).abs() < 1e-5);
    let cloud = maps.cloud(&robot, &poses, BEGIN + 210 * MS, &[true; 3]);
    assert!(points(&cloud).iter().all(|p| p[11] == 1.0), "only the second skin is there");
    assert_eq!(maps.cloud(&robot, &poses, BEGIN + 300 * MS, &[true; 3]).width, 0, "stale maps leave");
    assert_eq!(maps.cloud(&robot, &poses, BEGIN + 50 * MS, &[true, false, true]).width, 64, "a faulty skin");
}

#[test]
fn points_are_on_the_body() {
    let robot = robot();
    let mut maps = Maps::new(&robot);
    maps.take_geometry(&robot, 2, &geometry("c_skin")).unwrap();
    let mut sparse = map("c_skin", BEGIN, vec![0.0, 0.0, -2.0, 0.5, 0.0, 0.0]);
    (sparse.kind, sparse.indices) = (ForceMap::KIND_VECTOR, vec![0, 63]);
    maps.take(&robot, 2, sparse).unwrap();
    let poses = robot.body.poses(&[std::f64::consts::FRAC_PI_2]);
    let cloud = maps.cloud(&robot, &poses, BEGIN + 20 * MS, &[true; 3]);
    assert_eq!((cloud.header.frame_id.as_str(), cloud.width, cloud.is_dense), ("base", 2, true));
    let found = points(&cloud);
    // The skin is 0.3 m out on an arm that points to y, 0.5 m up; x of the skin is y of the body, and y is −x.
    let expected = [0.0175, 0.2825, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, -2.0, 25e-6, 80e3, 2.0, 0.02];
    for (found, expected) in found[0].iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6 * expected.abs().max(1.0), "{found} {expected}");
    }
    assert!((found[1][7] - 0.5).abs() < 1e-6, "a shear force turns with the arm: {:?}", found[1]);
    let unknown = robot.body.poses(&[f64::NAN]);
    assert_eq!(
        maps.cloud(&robot, &unknown, BEGIN, &[true; 3]).width,
        0,
        "without joint positions there is no place"
    );
}

#[test]
fn maps_that_cannot_be_are_named() {
    let robot = robot();
    let mut maps = Maps::new(&robot);
    let good = map("a_skin", BEGIN, vec![0.0; 64]);
    insta::assert_snapshot!(maps.take(&robot, 0, good.clone()).unwrap_err(), @"skin `a`: its force map is of a geometry that has not come on `skin_geometry`");
    insta::assert_snapshot!(maps.take_geometry(&robot, 0, &geometry("b_skin")).unwrap_err(), @r#"skin `a`: its geometry is in frame "b_skin" where the robot file says "a_skin""#);
    let mut short = geometry("a_skin");
    short.areas.pop();
    insta::assert_snapshot!(maps.take_geometry(&robot, 0, &short).unwrap_err(), @"skin `a`: its geometry has 64 points, 64 normals and 63 areas; each point has one, and there are 200000 at most");
    maps.take_geometry(&robot, 0, &geometry("a_skin")).unwrap();
    maps.take(&robot, 0, good.clone()).unwrap();
    insta::assert_snapshot!(maps.take(&robot, 0, ForceMap { forces: vec![0.0; 3], ..good.clone() }).unwrap_err(), @"skin `a`: its force map has 3 numbers for 64 points of 1");
    insta::assert_snapshot!(maps.take(&robot, 0, ForceMap { indices: vec![64], forces: vec![0.0], ..good }).unwrap_err(), @"skin `a`: its force map names a point beyond the 64 of its geometry");
}
