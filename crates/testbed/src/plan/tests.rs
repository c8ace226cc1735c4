use super::*;
use crate::testing::PLAN;

fn refused(from: &str, to: &str) -> String {
    assert!(PLAN.contains(from), "{from} is not in the plan");
    Plan::from_toml(&PLAN.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
}

#[test]
fn refusals_name_file_field_and_remedy() {
    insta::assert_snapshot!(refused("plan/1", "plan/7"), @r#"plan plan.toml: field `schema`: is "dermis-plan/7" where this program reads "dermis-plan/1""#);
    insta::assert_snapshot!(refused("diameter = 0.004", "diameter = -0.004"), @"plan plan.toml: field `diameter`: is -0.004 m and must be a positive length");
    insta::assert_snapshot!(refused("margin = 0.002", "margin = nan"), @"plan plan.toml: field `margin`: is NaN m and must be 0 or positive");
    insta::assert_snapshot!(refused("margin = 0.002", "marjin = 0.002"), @"plan plan.toml: field `marjin`: unknown field `marjin`, expected one of `schema`, `name`, `description`, `seed`, `diameter`, `tip`, `gravity`, `margin`, `region`, `force_distribution`, `force_noise`, `stage_noise`, `timing`, `steps`");
    insta::assert_snapshot!(refused("hold = [0.04, 0.06]", "hold = [0.06, 0.04]"), @"plan plan.toml: field `timing.hold`: [0.06, 0.04] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
    insta::assert_snapshot!(refused("duration = 0.2", "duration = 0.0"), @"plan plan.toml: field `steps[0].duration`: is 0 s and must be positive, a day at most");
    insta::assert_snapshot!(refused("force = [0.1, 0.5]", "force = [0.0, 0.5]"), @"plan plan.toml: field `steps[1].force`: [0, 0.5] is not a range: 0 < low ≤ high N");
    insta::assert_snapshot!(refused("forces = [0.2, 0.4]", "forces = []"), @"plan plan.toml: field `steps[2].forces`: is empty: name at least one");
    insta::assert_snapshot!(refused("contacts = [2, 3]", "contacts = [0, 3]"), @"plan plan.toml: field `steps[4].contacts`: [0, 3] is not a range: 1 ≤ low ≤ high ≤ 100");
    insta::assert_snapshot!(refused("kind = \"slides\"", "kind = \"slide\""), @"plan plan.toml: field `steps[3].kind`: unknown variant `slide`, expected one of `idle`, `presses`, `grid`, `locations`, `places`, `slides`, `multi`, `hex`, `postures`");
    insta::assert_snapshot!(refused("count = 4", "count = 4000000000"), @"plan plan.toml: field `steps`: make 8000000016 contacts; 1000000 at most fit a recording");
    insta::assert_snapshot!(refused("repeats = 2", "repeats = 0"), @"plan plan.toml: field `steps[1].repeats`: is 0 and must be at least 1");
    insta::assert_snapshot!(refused("seed = 3", "seed = \"three\""), @r#"plan plan.toml: field `seed`: invalid type: string "three", expected u64"#);
    insta::assert_snapshot!(refused("seed = 3", "seed ="), @"plan plan.toml: field `line 4, column 7`: string values must be quoted, expected literal string");
}

const MORE: &str = r#"
    schema = "dermis-plan/1"
    name = "more"
    diameter = [0.002, 0.004]
    force_noise = 0.0
    stage_noise = 1e-5
    [[steps]]
    kind = "grid"
    pitch = [0.004, 0.002]
    depths = [0.001, 0.002]
    incremental = true
    shear = 0.5
    shear_direction = 1.5
    hold = [0.1, 0.2]
    [[steps]]
    kind = "locations"
    at = [[0.0, 0.0, 0.0], [0.001, 0.0, 0.0]]
    forces = [0.1]
    diameter = 0.008
    [[steps]]
    kind = "presses"
    count = 3
    depth = [0.001, 0.002]
    shear = [0.0, 0.7]
"#;

const TOGETHER: &str = r#"
    schema = "dermis-plan/1"
    name = "together"
    tip = { shape = { shape = "flat-punch", diameter = 0.020 } }
    [[steps]]
    kind = "hex"
    count = 3
    contacts = [1, 6]
    radius = [0.03, 0.2]
    turn = 0.5
    depths = [0.001, 0.002]
    incremental = true
    least_force = 5.0
    [[steps]]
    kind = "multi"
    count = 3
    contacts = [2, 4]
    distance = 0.04
    forces = [4.905, 7.358, 9.810]
"#;

#[test]
fn several_tips_refuse_what_cannot_be() {
    let refused = |from: &str, to: &str| {
        assert!(TOGETHER.contains(from), "{from} is not in the plan");
        Plan::from_toml(&TOGETHER.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused("[1, 6]", "[1, 7]"), @"plan plan.toml: field `steps[0].contacts`: [1, 7] is not a range: 1 ≤ low ≤ high ≤ 6");
    insta::assert_snapshot!(refused("[0.03, 0.2]", "[0.2, 0.03]"), @"plan plan.toml: field `steps[0].radius`: [0.2, 0.03] is not a range: 0 < low ≤ high m");
    insta::assert_snapshot!(refused("radius = [0.03, 0.2]", ""), @"plan plan.toml: field `steps[0].radius`: is missing: a step of kind `hex` needs it");
    insta::assert_snapshot!(refused("turn = 0.5", "turn = [0.5, 0.0]"), @"plan plan.toml: field `steps[0].turn`: [0.5, 0] is not a range of angles: low ≤ high rad");
    insta::assert_snapshot!(refused("least_force = 5.0", "least_force = 0.0"), @"plan plan.toml: field `steps[0].least_force`: is 0 N and must be positive");
    insta::assert_snapshot!(refused("[0.001, 0.002]", "[0.002, 0.001]"), @"plan plan.toml: field `steps[0].depths[1]`: is 0.001 m, and an incremental press goes up only");
    insta::assert_snapshot!(refused("[4.905, 7.358, 9.810]", "[]"), @"plan plan.toml: field `steps[1].forces`: is empty: name at least one");
    insta::assert_snapshot!(refused("[4.905, 7.358, 9.810]", "[4.905, -1.0]"), @"plan plan.toml: field `steps[1].forces[1]`: [-1, -1] is not a range: 0 < low ≤ high N");
    insta::assert_snapshot!(refused("distance = 0.04", "distance = 0.04\n        force = [1.0, 2.0]"), @"plan plan.toml: field `steps[1].forces`: names one of some: leave out the range `force` or `depth` beside it");
}

const MOVED: &str = r#"
    schema = "dermis-plan/1"
    name = "moved"
    diameter = 0.004
    [[steps]]
    kind = "slides"
    count = 2
    force = [0.3, 0.5]
    length = [0.002, 0.003]
    speed = [0.02, 0.02]
    strokes = 5
    stop = 5.0
    cycles = 2
    [[steps]]
    kind = "postures"
    yaw = [-1.5708, 1.5708]
    roll = [0.0, 6.2832]
    counts = [13, 24]
    duration = 0.5
    [[steps]]
    kind = "postures"
    yaw = 0.5
    roll = [0.0, 3.0]
    count = 7
    duration = 0.5
"#;

#[test]
fn strokes_and_postures_refuse_what_cannot_be() {
    let refused = |from: &str, to: &str| {
        assert!(MOVED.contains(from), "{from} is not in the plan");
        Plan::from_toml(&MOVED.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused("strokes = 5", "strokes = 0"), @"plan plan.toml: field `steps[0].strokes`: is 0 and must be at least 1");
    insta::assert_snapshot!(refused("cycles = 2", "cycles = 4000000000"), @"plan plan.toml: field `steps[0].cycles`: make 40000000000 strokes; 1000000 at most fit a recording");
    insta::assert_snapshot!(refused("stop = 5.0", "stop = [5.0, 1.0]"), @"plan plan.toml: field `steps[0].stop`: [5, 1] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
    insta::assert_snapshot!(refused("yaw = [-1.5708, 1.5708]\n", ""), @"plan plan.toml: field `steps[1].yaw`: is missing: a step of kind `postures` needs it");
    insta::assert_snapshot!(refused("[-1.5708, 1.5708]", "[1.5708, -1.5708]"), @"plan plan.toml: field `steps[1].yaw`: [1.5708, -1.5708] is not a range of angles: low ≤ high rad");
    insta::assert_snapshot!(refused("6.2832", "6283.2"), @"plan plan.toml: field `steps[1].roll`: is 6.2832e3 rad and must be 0 to 1000 rad");
    insta::assert_snapshot!(refused("[13, 24]", "[13, 0]"), @"plan plan.toml: field `steps[1].counts[1]`: is 0 and must be at least 1");
    insta::assert_snapshot!(refused("[13, 24]", "[13, 24]\n    count = 3"), @"plan plan.toml: field `steps[1].counts`: stands beside `count`: name one of them");
    insta::assert_snapshot!(refused("counts = [13, 24]\n", ""), @"plan plan.toml: field `steps[1].count`: is missing: a step of kind `postures` needs it, or `counts`");
    insta::assert_snapshot!(refused("duration = 0.5", "duration = 0.0"), @"plan plan.toml: field `steps[1].duration`: is 0 s and must be positive, a day at most");
    insta::assert_snapshot!(refused("duration = 0.5", "duration = 0.5\n    force = [0.1, 0.2]"), @"plan plan.toml: field `steps[1].force`: is no key of a step of kind `postures`, which has yaw, roll, count, counts, duration");
}

#[test]
fn what_is_written_reads_back() {
    for text in [PLAN, MORE, TOGETHER, MOVED] {
        let plan = Plan::from_toml(text, "plan.toml").unwrap();
        let again = toml::to_string(&plan).unwrap();
        assert_eq!(Plan::from_toml(&again, "plan.toml").unwrap_or_else(|e| panic!("{e}\n{again}")), plan);
    }
}

#[test]
fn steps_refuse_what_does_not_belong_to_them() {
    let refused = |from: &str, to: &str| {
        assert!(MORE.contains(from), "{from} is not in the plan");
        Plan::from_toml(&MORE.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused("count = 3", "count = 3\npitch = 0.1"), @"plan plan.toml: field `steps[2].pitch`: is no key of a step of kind `presses`, which has count, force, depth, forces, depths, incremental, repeats, diameter, shear, shear_direction, load, hold, unload, gap, least_force, most_force");
    insta::assert_snapshot!(refused("count = 3", "count = 3\ncolour = 1"), @"plan plan.toml: field `steps[2].colour`: unknown field `colour`, expected one of `kind`, `duration`, `count`, `pitch`, `at`, `contacts`, `distance`, `force`, `depth`, `forces`, `depths`, `incremental`, `repeats`, `length`, `speed`, `diameter`, `shear`, `shear_direction`, `load`, `hold`, `unload`, `gap`, `least_force`, `most_force`, `radius`, `turn`, `strokes`, `stop`, `cycles`, `yaw`, `roll`, `counts`");
    insta::assert_snapshot!(refused("count = 3", ""), @"plan plan.toml: field `steps[2].count`: is missing: a step of kind `presses` needs it");
    insta::assert_snapshot!(refused("count = 3", "count = 3\nforce = [0.1, 0.2]"), @"plan plan.toml: field `steps[2].depth`: stands beside `force`: name one of them");
    insta::assert_snapshot!(refused("forces = [0.1]", ""), @"plan plan.toml: field `steps[1].forces`: is missing: a step of kind `locations` needs it, or `depths`");
    insta::assert_snapshot!(refused("forces = [0.1]", "forces = [0.1]\ndepths = [0.1]"), @"plan plan.toml: field `steps[1].depths`: stands beside `forces`: name one of them");
    insta::assert_snapshot!(refused("[0.001, 0.002]\n    incremental", "[0.002, 0.002]\n    incremental"), @"plan plan.toml: field `steps[0].depths[1]`: is 0.002 m, and an incremental press goes up only");
    insta::assert_snapshot!(refused("shear = 0.5\n", ""), @"plan plan.toml: field `steps[0].shear_direction`: says where to without `shear`, which says how much");
    insta::assert_snapshot!(refused("shear = [0.0, 0.7]", "shear = [0.7, 0.0]"), @"plan plan.toml: field `steps[2].shear`: [0.7, 0] is not a range: 0 ≤ low ≤ high");
    insta::assert_snapshot!(refused("shear = [0.0, 0.7]", "shear = \"much\""), @"plan plan.toml: field `steps[2].shear`: a number, or two of them in brackets");
    insta::assert_snapshot!(refused("[0.002, 0.004]", "[]"), @"plan plan.toml: field `diameter`: is empty: a tip has a diameter");
    insta::assert_snapshot!(refused("diameter = 0.008", "diameter = -0.008"), @"plan plan.toml: field `steps[1].diameter`: is -0.008 m and must be a positive length");
    insta::assert_snapshot!(refused("hold = [0.1, 0.2]", "hold = [0.1, -0.2]"), @"plan plan.toml: field `steps[0].hold`: [0.1, -0.2] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
    insta::assert_snapshot!(refused("force_noise = 0.0", "force_noise = -1.0"), @"plan plan.toml: field `force_noise`: is -1 N and must be 0 or positive");
    insta::assert_snapshot!(refused("[[0.0, 0.0, 0.0], [0.001, 0.0, 0.0]]", "[]"), @"plan plan.toml: field `steps[1].at`: is empty: name at least one place");
    insta::assert_snapshot!(refused("[0.001, 0.0, 0.0]", "[0.001, 0.0, nan]"), @"plan plan.toml: field `steps[1].at[1]`: is (0.001, 0, NaN) m and must be a point");
    insta::assert_snapshot!(refused("diameter = 0.008", "diameter = []"), @"plan plan.toml: field `steps[1].diameter`: is empty: a tip has a diameter");
    insta::assert_snapshot!(refused("[0.004, 0.002]", "[0.004, nan]"), @"plan plan.toml: field `steps[0].pitch`: [NaN, NaN] is not a range: 0 < low ≤ high m");
}

#[test]
fn plans_that_ship_are_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/plans");
    let mut found = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let plan = Plan::load(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(plan.name, path.file_stem().unwrap().to_str().unwrap());
        found += 1;
    }
    assert!(found >= 2);
}

#[test]
fn a_missing_file_is_named() {
    let error = Plan::load("/nowhere/plan.toml").unwrap_err().to_string();
    assert!(error.starts_with("plan file /nowhere/plan.toml: cannot be read"), "{error}");
}

proptest::proptest! {
    #[test]
    fn no_text_panics(text in ".{0,200}") {
        let _ = Plan::from_toml(&text, "x");
    }
}
