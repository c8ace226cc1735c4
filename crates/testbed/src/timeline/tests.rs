use std::collections::{BTreeMap, BTreeSet};

use dermis_skin::SurfaceSpec;
use proptest::prelude::*;

use super::*;
use crate::plan::Plan;
use crate::testing;

fn moments(timeline: &Timeline) -> Vec<GroundTruth> {
    let steps = (timeline.duration() * 1000.0) as u32;
    (0..=steps).map(|i| timeline.at(f64::from(i) / 1000.0)).collect()
}

#[test]
fn a_press_goes_through_its_phases_and_its_force_does_not_jump() {
    let skin = testing::skin(100.0);
    let timeline = Timeline::new(&testing::plan(), &testing::shared_bumps(&skin), 3).unwrap();
    let force = |m: &GroundTruth| m.stimulus.contacts.iter().map(|c| -c.force.z).fold(0.0, f64::max);
    let mut last = GroundTruth::default();
    for moment in moments(&timeline) {
        if moment.press == last.press && moment.phase != last.phase {
            let expected = match last.phase {
                Phase::Idle | Phase::Approach => &[Phase::Load][..],
                Phase::Load => &[Phase::Hold, Phase::Slide],
                Phase::Hold | Phase::Slide => &[Phase::Unload],
                Phase::Unload => &[Phase::Idle],
            };
            assert!(expected.contains(&moment.phase), "{:?} after {:?}", moment.phase, last.phase);
        }
        // 0.5 N in 30 ms along a cosine is at most 26 N/s.
        assert!((force(&moment) - force(&last)).abs() < 0.03, "{last:?} then {moment:?}");
        let tip = moment.tip.unwrap();
        assert_eq!(tip.gap > 0.0, matches!(moment.phase, Phase::Idle | Phase::Approach), "{moment:?}");
        assert!(moment.stimulus.contacts.first().is_none_or(|c| c.position == tip.place));
        let touches = matches!(moment.phase, Phase::Hold | Phase::Slide);
        assert!(!touches || force(&moment) > 0.0);
        assert!(
            !matches!(moment.phase, Phase::Idle | Phase::Approach) || moment.stimulus.contacts.is_empty()
        );
        last = moment;
    }
    assert_eq!(timeline.at(-1.0), GroundTruth::default());
    assert_eq!(timeline.at(timeline.duration() + 1e6).phase, Phase::Idle);
}

#[test]
fn the_plan_is_carried_out_in_full() {
    let skin = testing::skin(100.0);
    let timeline = Timeline::new(&testing::plan(), &testing::shared_bumps(&skin), 3).unwrap();
    // 26 mm by 16 mm within the margin: points at 0, 8, 16, 24 by 0, 8, 16 mm.
    let grid = 4 * 3;
    assert_eq!(timeline.presses(), 4 * 2 + grid * 2 * 2 + 3 + 3);
    let all = moments(&timeline);
    let locations: BTreeSet<u32> = all.iter().map(|m| m.location).collect();
    assert_eq!(locations.len() as u64, 1 + 4 + grid + 3 + 3);
    assert!(all.iter().any(|m| m.phase == Phase::Slide));
    for pair in all.iter().map(|m| &m.stimulus.contacts).filter(|c| c.len() > 1) {
        assert!((pair[0].position - pair[1].position).norm() >= 0.006);
    }
    // One place is one position, whatever the repeat, unless it slides.
    for location in 1..=4 {
        let positions: Vec<_> = all
            .iter()
            .filter(|m| m.location == location)
            .flat_map(|m| m.stimulus.contacts.iter().map(|c| c.position))
            .collect();
        assert!(positions.len() > 10 && positions.iter().all(|p| *p == positions[0]));
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let skin = testing::skin(100.0);
    let plan_error = |text: &str| {
        let plan = Plan::from_toml(text, "plan.toml").unwrap();
        Timeline::new(&plan, &testing::shared_bumps(&skin), 1).unwrap_err().to_string()
    };
    let refused = |from: &str, to: &str| plan_error(&testing::PLAN.replace(from, to));
    let no_time = r#"
        schema = "dermis-plan/1"
        name = "no-time"
        diameter = 0.004
        timing = { approach = [0, 0], load = [0, 0], hold = [0, 0], unload = [0, 0], gap = [0, 0] }
        steps = [{ kind = "presses", count = 3, force = [0.1, 0.2] }]
    "#;
    insta::assert_snapshot!(plan_error(no_time), @"plan plan.toml: field `timing`: lets the plan last no time at all: lengthen a phase");
    insta::assert_snapshot!(refused("margin = 0.002", "margin = 0.011"), @"plan plan.toml: field `margin`: no place on the surface is 0.011 m away from its rim");
    insta::assert_snapshot!(refused("length = [0.004, 0.008]", "length = [0.1, 0.2]"), @"plan plan.toml: field `steps[3].length`: no way of 0.1 m fits on the surface within the margin");
    insta::assert_snapshot!(refused("distance = 0.006", "distance = 0.06"), @"plan plan.toml: field `steps[4].distance`: 2 contacts 0.06 m apart do not fit on the surface");
}

fn carried_out(steps: &str) -> Result<Timeline, String> {
    let text = format!(
        r#"
        schema = "dermis-plan/1"
        name = "some"
        diameter = 0.004
        margin = 0.002
        timing = {{ approach = [0.02, 0.02], load = [0.04, 0.04], hold = [0.1, 0.1], unload = [0.04, 0.04], gap = [0.02, 0.02] }}
        {steps}
        "#
    );
    let plan = Plan::from_toml(&text, "some.toml").map_err(|e| e.to_string())?;
    let model = testing::shared_bumps(&testing::skin(100.0));
    Timeline::new(&plan, &model, 1).map_err(|e| e.to_string())
}

#[test]
fn a_plan_may_name_a_tip_that_is_no_sphere_and_gravity() {
    let steps = "[[steps]]\nkind = \"presses\"\ncount = 3\nforce = [0.5, 1.0]\n";
    let tip = "{ shape = { shape = \"wedge\", angle = 1.0, length = 0.006 }, turn = 0.5, tilt = 0.25 }";
    let head = format!("schema = \"dermis-plan/1\"\nname = \"some\"\ntip = {tip}\n");
    let text = format!("{head}gravity = [0.0, 0.0, -9.81]\n{steps}");
    let read = |text: &str| Plan::from_toml(text, "some.toml").map_err(|e| e.to_string());
    let plan = read(&text).unwrap();
    let model = testing::shared_bumps(&testing::skin(100.0));
    let timeline = Timeline::new(&plan, &model, 1).unwrap();
    let mut pressed = 0;
    for moment in moments(&timeline) {
        assert_eq!(moment.stimulus.gravity, Vector3::new(0.0, 0.0, -9.81));
        for contact in &moment.stimulus.contacts {
            assert_eq!(contact.tip.shape, TipShape::Wedge { angle: 1.0, length: 0.006 });
            let turned = contact.tip.orientation * Vector3::x();
            assert!((turned - Vector3::new(0.5f64.cos(), 0.5f64.sin(), 0.0)).norm() < 1e-12);
            let up = contact.tip.orientation * Vector3::z();
            assert!((up.z - 0.25f64.cos()).abs() < 1e-12);
            pressed += 1;
        }
        assert!(moment.depths.iter().all(Option::is_none));
    }
    assert!(pressed > 0);
    // Written and read again it is the same plan; one that says nothing of it does not write it.
    let json = serde_json::to_value(&plan).unwrap();
    assert_eq!(json["tip"]["shape"]["shape"], "wedge");
    let plain =
        read(&format!("schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n{steps}")).unwrap();
    let json = serde_json::to_value(&plain).unwrap();
    assert!(json.get("tip").is_none() && json.get("gravity").is_none());
    let deep = text.replace("force = [0.5, 1.0]", "depth = [0.0005, 0.001]");
    insta::assert_snapshot!(Timeline::new(&read(&deep).unwrap(), &model, 1).unwrap_err(), @"plan some.toml: field `steps[0].depth`: the model of this skin does not know how deep a tip sinks in: name forces instead");
    let refused = |from: &str, to: &str| read(&text.replace(from, to)).unwrap_err();
    insta::assert_snapshot!(refused("gravity", "diameter = 0.004\ngravity"), @"plan some.toml: field `tip`: stands beside `diameter`, which means a sphere: name one of them");
    insta::assert_snapshot!(refused("-9.81", "-9810.0"), @"plan some.toml: field `gravity`: has -9810 m/s² and must be -1000 to 1000 m/s²");
    insta::assert_snapshot!(refused("0.006", "0.0"), @"plan some.toml: field `tip.shape`: its length is 0 m and must be 0.0001 to 0.1 m");
    insta::assert_snapshot!(refused("tilt = 0.25", "tilt = 2.5"), @"plan some.toml: field `tip.tilt`: is 2.5 rad and must be -1.5707963267948966 to 1.5707963267948966 rad");
    insta::assert_snapshot!(read(&format!("schema = \"dermis-plan/1\"\nname = \"some\"\n{steps}")).unwrap_err(), @"plan some.toml: field `(whole file)`: missing field `diameter`, or `tip` for a tip that is no sphere");
    insta::assert_snapshot!(refused("force = [0.5, 1.0]", "force = [0.5, 1.0]\ndiameter = 0.004"), @"plan some.toml: field `steps[0].diameter`: stands in a plan whose `tip` is no sphere: leave it out");
}

#[test]
fn depths_take_the_force_that_the_model_knows() {
    let steps = "[[steps]]\nkind = \"presses\"\ncount = 20\ndepth = [0.0005, 0.002]\n";
    let timeline = carried_out(steps).unwrap();
    let mut deepest = 0.0f64;
    for moment in moments(&timeline) {
        assert_eq!(moment.stimulus.contacts.len(), moment.depths.len());
        for (contact, depth) in moment.stimulus.contacts.iter().zip(&moment.depths) {
            let depth = depth.unwrap();
            assert!((-contact.force.z - 500.0 * depth).abs() < 1e-12 && depth <= 0.002);
            deepest = deepest.max(depth);
        }
    }
    assert!(deepest > 0.0015, "{deepest}");
    let refused = |from: &str, to: &str| carried_out(&steps.replace(from, to)).unwrap_err();
    insta::assert_snapshot!(refused("0.002]", "0.02]"), @"plan some.toml: field `steps[0].depth`: 0.009491 m at (-0.003716, -0.005006, 0.000000) m is deeper than a tip of 0.004 m can be pressed into this skin");
    let mut bumps = testing::bumps(&testing::skin(100.0));
    bumps.spring = None;
    let model: Arc<dyn ForwardModel> = Arc::new(bumps);
    let text = format!("schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n{steps}");
    let plan = Plan::from_toml(&text, "some.toml").unwrap();
    insta::assert_snapshot!(Timeline::new(&plan, &model, 1).unwrap_err(), @"plan some.toml: field `steps[0].depth`: the model of this skin does not know how deep a tip sinks in: name forces instead");
}

/// Presses a flat tip into a spring of 2 kN/m and a sphere into one of 500 N/m.
struct KnowsFlatTips(Arc<dyn ForwardModel>);

impl dermis_model::Wrapper for KnowsFlatTips {
    const CHANGES_RESPONSE: bool = false;

    fn inner(&self) -> &dyn ForwardModel {
        self.0.as_ref()
    }

    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        match tip {
            // Stiffer to the right: of several tips one is the lightest.
            TipShape::FlatPunch { .. } => Some((2000.0 + 1e5 * at.x) * depth),
            _ => self.0.force_of_tip(at, tip, depth),
        }
    }
}

const PLATE: &str = r#"
    schema = "dermis-plan/1"
    name = "plate"
    tip = { shape = { shape = "flat-punch", diameter = 0.002 } }
    margin = 0.001
    timing = { approach = [0.02, 0.02], load = [0.02, 0.02], hold = [0.04, 0.04], unload = [0.02, 0.02], gap = [0.02, 0.02] }
    [[steps]]
    kind = "hex"
    count = 40
    contacts = [1, 6]
    radius = [0.003, 0.005]
    depths = [0.0005, 0.001, 0.0015]
    incremental = true
    least_force = 1.2
"#;

#[test]
fn tips_of_a_plate_are_lowered_together_on_the_arms_of_a_hexagon() {
    let model: Arc<dyn ForwardModel> = Arc::new(KnowsFlatTips(testing::shared_bumps(&testing::skin(100.0))));
    let plan = Plan::from_toml(PLATE, "plate.toml").unwrap();
    let timeline = Timeline::new(&plan, &model, 5).unwrap();
    let mut numbers = BTreeSet::new();
    let mut lightest = f64::INFINITY;
    for moment in moments(&timeline).into_iter().filter(|m| m.phase == Phase::Hold) {
        let contacts = &moment.stimulus.contacts;
        numbers.insert(contacts.len());
        assert_eq!(moment.depths.len(), contacts.len());
        for (contact, depth) in contacts.iter().zip(&moment.depths) {
            assert_eq!(contact.tip.shape, TipShape::FlatPunch { diameter: 0.002 });
            assert!((depth.unwrap() - moment.depths[0].unwrap()).abs() < 1e-15, "one depth for all");
            let force = (2000.0 + 1e5 * contact.position.x) * depth.unwrap();
            assert!((-contact.force.z - force).abs() < 1e-9, "each with its force");
            lightest = lightest.min(force);
        }
        let arms = crate::HEX_ARMS[contacts.len() - 1];
        // The first arm points along x.
        let radii: Vec<f64> = if let [_, second, ..] = &contacts[..] {
            // Two tips of one plate are 2 r sin(half of the angle between them) apart.
            let angle = f64::from(arms[1] - arms[0]) * std::f64::consts::FRAC_PI_3;
            vec![(second.position - contacts[0].position).norm() / (2.0 * (angle / 2.0).sin())]
        } else {
            Vec::new()
        };
        for radius in radii {
            assert!((0.003 - 1e-9..=0.005 + 1e-9).contains(&radius), "{radius}");
            let middle = contacts[0].position - Vector3::x() * radius;
            for (contact, arm) in contacts.iter().zip(arms) {
                let (sin, cos) = (f64::from(*arm) * std::f64::consts::FRAC_PI_3).sin_cos();
                let wanted = middle + Vector3::new(cos, sin, 0.0) * radius;
                assert!((contact.position - wanted).norm() < 1e-9, "{contacts:?}");
            }
        }
    }
    assert_eq!(numbers, (1..=6).collect());
    assert!((1.2 * (1.0 - 1e-8)..1.4).contains(&lightest), "{lightest}");
    // Without the limit every place is pressed, and every step is held.
    let every = Plan::from_toml(&PLATE.replace("least_force = 1.2", ""), "plate.toml").unwrap();
    let every = Timeline::new(&every, &model, 5).unwrap();
    assert_eq!(every.presses(), 40);
    assert!(timeline.presses() < 40 && timeline.presses() > 10, "{}", timeline.presses());
    let keys = |timeline: &Timeline| timeline.presses.iter().map(|p| p.keys.len()).collect::<BTreeSet<_>>();
    assert_eq!(keys(&every), [2 + 2 * 3].into());
    assert!(keys(&timeline).contains(&4), "only the deepest step is heavy enough somewhere");
}

/// The toy presses back with (2000 + 10⁵ x) N per metre of depth.
#[test]
fn steps_stop_at_a_force() {
    let model: Arc<dyn ForwardModel> = Arc::new(KnowsFlatTips(testing::shared_bumps(&testing::skin(100.0))));
    let steps = r#"
    kind = "presses"
    count = 30
    depths = [0.0005, 0.001, 0.0015]
    incremental = true
    most_force = 2.0
"#;
    let head = PLATE.split("kind = ").next().unwrap();
    let text = format!("{head}{}", steps.trim_start());
    let plan = Plan::from_toml(&text, "steps.toml").unwrap();
    let timeline = Timeline::new(&plan, &model, 5).unwrap();
    assert_eq!(timeline.presses(), 30);
    let mut held = BTreeMap::<u64, (f64, f64)>::new();
    for moment in moments(&timeline).into_iter().filter(|m| m.phase == Phase::Hold) {
        let depth = moment.depths[0].unwrap();
        let force = -moment.stimulus.contacts[0].force.z;
        assert!(force <= 2.0 * (1.0 + 1e-8), "{force} N");
        held.entry(moment.press).or_insert((0.0, 0.0)).clone_from(&(depth, force / depth));
    }
    let mut stopped = 0;
    for (depth, stiffness) in held.values() {
        let wanted = (1..=3).rev().map(|i| 0.0005 * f64::from(i)).find(|d| d * stiffness <= 2.0);
        assert!((depth - wanted.unwrap()).abs() < 1e-12, "{depth} m at {stiffness} N/m");
        stopped += usize::from(*depth < 0.0014);
    }
    assert!(stopped > 0 && stopped < 30, "{stopped}");
    // A plan says what it read.
    assert_eq!(Plan::from_toml(&toml::to_string(&plan).unwrap(), "steps.toml").unwrap(), plan);
}

#[test]
fn what_a_plate_cannot_do_is_refused() {
    let refused = |from: &str, to: &str, knows: bool| {
        let plan = Plan::from_toml(&PLATE.replace(from, to), "plate.toml").unwrap();
        let bumps = testing::shared_bumps(&testing::skin(100.0));
        let model: Arc<dyn ForwardModel> = if knows { Arc::new(KnowsFlatTips(bumps)) } else { bumps };
        Timeline::new(&plan, &model, 5).unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused("", "", false), @"plan plate.toml: field `steps[0].depths`: the model of this skin does not know how deep a tip sinks in: name forces instead");
    insta::assert_snapshot!(refused("diameter = 0.002 } }", "diameter = 0.002 }, tilt = 0.1 }", true), @"plan plate.toml: field `steps[0].depths`: the model of this skin does not know how deep a tip sinks in: name forces instead");
    insta::assert_snapshot!(refused("contacts = [1, 6]\n    radius = [0.003, 0.005]", "contacts = [6, 6]\n    radius = [0.03, 0.05]", true), @"plan plate.toml: field `steps[0].radius`: 6 tips 0.03 m and more from the middle of their plate do not fit on the surface within the margin");
}

#[test]
fn the_ground_truth_of_a_flat_tip_says_so() {
    let model: Arc<dyn ForwardModel> = Arc::new(KnowsFlatTips(testing::shared_bumps(&testing::skin(100.0))));
    let timeline = Timeline::new(&Plan::from_toml(PLATE, "plate.toml").unwrap(), &model, 5).unwrap();
    let moment = timeline.first_touch();
    let message = moment.message(&testing::skin(100.0), model.surface(), "session", 1);
    assert!(!message.contacts.is_empty());
    for (contact, truth) in message.contacts.iter().zip(&moment.stimulus.contacts) {
        assert_eq!((contact.tip, contact.diameter), (IndentationContact::TIP_FLAT, 0.002));
        assert_eq!(contact.tip_name, "flat-punch");
        assert_eq!(contact.force.z, truth.force.z);
        assert!(contact.tip_pose.orientation.w.is_finite());
    }
}

#[test]
fn weights_are_drawn_from_a_list() {
    let steps = "[[steps]]\nkind = \"multi\"\ncount = 30\ncontacts = [2, 3]\ndistance = 0.004\nforces = [0.1, 0.2, 0.4]\n";
    let timeline = carried_out(steps).unwrap();
    let mut drawn: BTreeMap<u64, usize> = BTreeMap::new();
    let mut unlike = 0;
    for press in &timeline.presses {
        let forces: Vec<f64> = press.touches.iter().map(|t| *t.level.value()).collect();
        assert!(forces.len() == 2 || forces.len() == 3, "{forces:?}");
        unlike += usize::from(forces.iter().any(|f| *f != forces[0]));
        forces.iter().for_each(|f| *drawn.entry((f * 10.0).round() as u64).or_default() += 1);
    }
    assert_eq!(drawn.keys().copied().collect::<Vec<_>>(), [1, 2, 4]);
    // Of 60 to 90 contacts a third each; five standard deviations are 21.
    assert!(drawn.values().all(|n| *n > 5), "{drawn:?}");
    assert!(unlike > 10, "each contact of a press draws its own");
}

#[test]
fn an_incremental_press_climbs_and_is_moved_sideways_at_each_level() {
    let timeline = carried_out(
        "[[steps]]\nkind = \"locations\"\nat = [[0.001, 0.0, 0.0]]\nforces = [0.1, 0.3, 0.4]\nincremental = true\nshear = 0.5\nshear_direction = 1.0",
    )
    .unwrap();
    assert_eq!(timeline.presses(), 1);
    let mut held = Vec::new();
    let mut last: Vector3<f64> = Vector3::zeros();
    for moment in moments(&timeline) {
        let force = moment.stimulus.contacts.first().map_or(Vector3::zeros(), |c| c.force);
        let (normal, along) = (-force.z, Vector3::new(force.x, force.y, 0.0));
        assert!((along - Vector3::new(1f64.cos(), 1f64.sin(), 0.0) * along.norm()).norm() < 1e-12);
        if moment.phase == Phase::Load {
            assert!(normal >= -last.z - 1e-12 && along.norm() <= 0.5 * normal + 1e-12);
        }
        if moment.phase == Phase::Hold {
            let level = [normal, along.norm()].map(|f| (f * 1e9).round() / 1e9);
            if held.last() != Some(&level) {
                held.push(level);
            }
        }
        assert!((force - last).norm() < 0.03, "it jumps from {last:?} to {force:?}");
        last = force;
    }
    assert_eq!(held, [[0.1, 0.0], [0.1, 0.05], [0.3, 0.05], [0.3, 0.15], [0.4, 0.15], [0.4, 0.2]]);
}

#[test]
fn what_a_step_adds_does_not_change_what_the_others_draw() {
    let plain = "[[steps]]\nkind = \"presses\"\ncount = 6\nforce = [0.1, 0.5]\n";
    let of = |steps: &str| {
        let timeline = carried_out(steps).unwrap();
        let held = moments(&timeline).into_iter().filter(|m| m.phase == Phase::Hold);
        let mut locations: BTreeMap<u32, (Point3<f64>, f64, BTreeSet<u64>)> = BTreeMap::new();
        for moment in held {
            let contact = &moment.stimulus.contacts[0];
            let entry = locations.entry(moment.location).or_insert((
                contact.position,
                contact.force.z,
                BTreeSet::new(),
            ));
            entry.2.insert(contact.diameter().to_bits());
        }
        locations
    };
    let (plain, more) = (of(plain), of(&format!("{plain}shear = [0.1, 0.9]\ndiameter = [0.002, 0.008]")));
    let mut tips: BTreeSet<u64> = BTreeSet::new();
    for (location, (place, force, _)) in &plain {
        let (same, strong, diameters) = &more[location];
        assert_eq!((place, force, diameters.len()), (same, strong, 1));
        tips.extend(diameters);
    }
    assert_eq!(tips.len(), 2);
}

#[test]
fn a_grid_has_the_requested_pitch() {
    let steps = "[[steps]]\nkind = \"grid\"\npitch = [0.0007, 0.004]\nforces = [0.1]\n";
    let timeline = carried_out(steps).unwrap();
    let mut locations: Vec<_> = timeline.presses.iter().map(|p| p.touches[0].from).collect();
    locations.sort_by(|a, b| (a.y, a.x).partial_cmp(&(b.y, b.x)).unwrap());
    // 26 mm by 16 mm within the margin.
    assert_eq!(locations.len(), 38 * 5);
    for pair in locations.windows(2) {
        let way = pair[1] - pair[0];
        assert!((way.x - 0.0007).abs() < 1e-12 && way.y == 0.0 || (way.y - 0.004).abs() < 1e-12, "{way:?}");
    }
    assert!((nalgebra::center(&locations[0], &locations[locations.len() - 1]).coords).norm() < 1e-12);
    let refused = |from: &str, to: &str| carried_out(&steps.replace(from, to)).unwrap_err();
    insta::assert_snapshot!(refused("[0.0007, 0.004]", "1e-6"), @"plan some.toml: field `steps[0].pitch`: makes 416042001 locations; 1000000 contacts at most fit a recording");
    insta::assert_snapshot!(refused("[0.0007, 0.004]\nforces = [0.1]", "0.00003\nforces = [0.1, 0.2, 0.3]"), @"plan some.toml: field `steps`: make 1388934 contacts; 1000000 at most fit a recording");
    let text = format!("schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n{steps}");
    let on_a_dome = |pitch: &str| {
        let plan = Plan::from_toml(&text.replace("[0.0007, 0.004]", pitch), "some.toml").unwrap();
        let dome = SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 };
        Timeline::new(&plan, &testing::bumps_on(&dome), 1).map_err(|e| e.to_string())
    };
    insta::assert_snapshot!(on_a_dome("[0.0007, 0.004]").unwrap_err(), @"plan some.toml: field `steps[0].pitch`: is of two numbers, which a flat skin has only");
    insta::assert_snapshot!(on_a_dome("0.0005").unwrap_err(), @"plan some.toml: field `steps[0].pitch`: is 0.0005 m, and the points of this curved surface are 0.002023 m apart: take a wider pitch, or a finer `surface.spacing` in the skin description");
    assert!(on_a_dome("0.004").unwrap().presses() > 50);
}

#[test]
fn shear_lies_in_a_curved_surface_too() {
    let text = r#"
        schema = "dermis-plan/1"
        name = "sheared"
        diameter = 0.004
        [[steps]]
        kind = "presses"
        count = 60
        force = [0.2, 0.4]
        shear = 0.5
        [[steps]]
        kind = "grid"
        pitch = 0.008
        depths = [0.001, 0.002]
        incremental = true
        shear = 0.5
        shear_direction = 0.0
    "#;
    let dome = SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 };
    let (model, plan) = (testing::bumps_on(&dome), Plan::from_toml(text, "sheared.toml").unwrap());
    let timeline = Timeline::new(&plan, &model, 1).unwrap();
    let mut largest = 0.0f64;
    for i in 0..(timeline.duration() * 100.0) as u32 {
        for contact in timeline.at(f64::from(i) / 100.0).stimulus.contacts {
            let (on, normal) = model.surface().project(&contact.position);
            let pressing = -contact.force.dot(&normal);
            let along = (contact.force + normal * pressing).norm();
            assert!((on - contact.position).norm() < 1e-9 && along <= 0.5 * pressing + 1e-9);
            largest = largest.max(along / pressing);
        }
    }
    assert!((largest - 0.5).abs() < 1e-9, "{largest}");
}

#[test]
fn named_locations_lie_on_the_surface() {
    let refused = |at: &str| {
        carried_out(&format!("[[steps]]\nkind = \"locations\"\nat = [[0.0, 0.0, 0.0], {at}]\nforces = [0.1]"))
            .unwrap_err()
    };
    insta::assert_snapshot!(refused("[0.02, 0.0, 0.0]"), @"plan some.toml: field `steps[0].at[1]`: (0.02, 0, 0) m lies 0.005000 m off the surface");
    insta::assert_snapshot!(refused("[0.0, 0.0, 0.001]"), @"plan some.toml: field `steps[0].at[1]`: (0, 0, 0.001) m lies 0.001000 m off the surface");
    insta::assert_snapshot!(refused("[0.0, 0.0095, 0.0]"), @"plan some.toml: field `steps[0].at[1]`: (0, 0.0095, 0) m is nearer to the rim than the margin of 0.002 m");
}

#[test]
fn a_step_may_be_done_at_another_speed_and_a_place_that_is_named_again_is_the_same() {
    let place = "[[steps]]\nkind = \"locations\"\nforces = [0.2]\nat = ";
    let timeline = carried_out(&format!(
        "{place}[[0.001, 0.0, 0.0], [0.003, 0.0, 0.0]]\n\
         {place}[[0.003, 0.0, 0.0]]\nload = [0.5, 0.5]\nunload = [0.3, 0.3]\ngap = [1.0, 1.0]\n\
         {place}[[0.005, 0.0, 0.0]]\n"
    ))
    .unwrap();
    let mut seen: BTreeMap<u64, (u32, usize, usize)> = BTreeMap::new();
    for moment in moments(&timeline).iter().filter(|m| m.press > 0) {
        let of = seen.entry(moment.press).or_insert((moment.location, 0, 0));
        of.0 = of.0.max(moment.location);
        of.1 += usize::from(moment.phase == Phase::Load);
        of.2 += usize::from(moment.phase == Phase::Unload);
    }
    let locations: Vec<u32> = seen.values().map(|(location, ..)| *location).collect();
    assert_eq!(locations, [1, 2, 2, 3]);
    let (quick, slow) = (seen[&1], seen[&3]);
    assert!(slow.1 > 10 * quick.1 && slow.2 > 6 * quick.2, "{quick:?} {slow:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn contacts_lie_on_the_surface_and_press_with_the_requested_force(seed in any::<u64>(), dome in any::<bool>()) {
        let spec = if dome {
            SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 }
        } else {
            SurfaceSpec::Rectangle { size: [0.03, 0.02], spacing: 0.002 }
        };
        let model = testing::bumps_on(&spec);
        let surface = model.surface();
        let timeline = Timeline::new(&testing::plan(), &model, seed).unwrap();
        let again = Timeline::new(&testing::plan(), &model, seed).unwrap();
        for i in 0..200 {
            let t = timeline.duration() * f64::from(i) / 200.0;
            let moment = timeline.at(t);
            prop_assert_eq!(&moment, &again.at(t));
            for contact in &moment.stimulus.contacts {
                let (on, normal) = surface.project(&contact.position);
                prop_assert!((on - contact.position).norm() < 1e-9);
                let pressing = -contact.force.dot(&normal);
                prop_assert!(pressing > 0.0 && pressing <= 0.5 + 1e-9);
                prop_assert!((contact.force + normal * pressing).norm() < 1e-9);
                if !dome {
                    let p = contact.position;
                    prop_assert!(p.x.abs() <= 0.013 + 1e-9 && p.y.abs() <= 0.008 + 1e-9);
                }
            }
        }
    }
}

/// The thesis' way for tracking: so far, a stop, and again, forth and back.
#[test]
fn a_slide_stops_after_each_stroke_and_comes_back() {
    let steps = "[[steps]]\nkind = \"slides\"\ncount = 1\nforce = [0.3, 0.3]\nlength = [0.004, 0.004]\nspeed = [0.04, 0.04]\n\
                 strokes = 3\nstop = 0.5\ncycles = 2\n";
    let timeline = carried_out(steps).unwrap();
    assert_eq!(timeline.presses(), 1);
    let Touch { from, to, .. } = timeline.presses[0].touches[0].clone();
    assert!(((to - from).norm() - 0.012).abs() < 1e-12, "flat: three strokes are the whole way");
    // Places where it stops, in order, and how many milliseconds it stops and slides.
    let (mut stops, mut stopped, mut slid) = (Vec::<u32>::new(), 0, 0);
    let mut last = GroundTruth::default();
    for moment in moments(&timeline) {
        if let Some(contact) = moment.stimulus.contacts.first() {
            if let Some(before) = last.stimulus.contacts.first() {
                let way = (contact.position - before.position).norm();
                assert!(way < 0.04e-3 * 1.001, "faster than it may: {way} m in a millisecond");
            }
            assert!(
                matches!(moment.phase, Phase::Load | Phase::Unload) || (contact.force.z + 0.3).abs() < 1e-12
            );
        }
        slid += u32::from(moment.phase == Phase::Slide);
        if moment.phase == Phase::Hold {
            stopped += 1;
            let end = (moment.stimulus.contacts[0].position - from).norm() / 0.004;
            assert!((end - end.round()).abs() < 1e-9, "it stops between strokes, at {end}");
            if last.phase != Phase::Hold {
                stops.push(end.round() as u32);
            }
        }
        last = moment;
    }
    assert_eq!(stops, [1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0]);
    // Twelve stops of half a second, twelve strokes of 4 mm at 40 mm/s; one reading each at the ends.
    assert!((5988..=6012).contains(&stopped) && (1188..=1212).contains(&slid), "{stopped} {slid}");
    // A slide that does not stop and does not come back is what it was before there were strokes.
    let plain = steps.split("strokes").next().unwrap();
    let once = carried_out(&format!("{plain}strokes = 1\nstop = 0.0\ncycles = 0\n")).unwrap();
    assert_eq!(once.presses, carried_out(plain).unwrap().presses);
    assert!(
        carried_out(&steps.replace("strokes = 3", "strokes = 30"))
            .unwrap_err()
            .contains("no way of 0.12 m fits")
    );
}

/// Gravity in the frame of the link: of Ry(yaw) Rz(roll), g (sin yaw cos roll, −sin yaw sin roll, −cos yaw).
#[test]
#[expect(clippy::approx_constant, reason = "as plans write them")]
fn postures_turn_gravity_in_the_frame_of_the_link() {
    let steps = |set: &str| {
        format!(
            "[[steps]]\nkind = \"postures\"\nyaw = [-1.5708, 1.5708]\nroll = [0.0, 6.2832]\n{set}\nduration = 0.05\n"
        )
    };
    let of = |timeline: &Timeline| -> Vec<(u32, Vector3<f64>)> {
        let mut seen: Vec<(u32, Vector3<f64>)> = Vec::new();
        for moment in moments(timeline).iter().take_while(|m| m.location > 0) {
            assert!(moment.phase == Phase::Idle && moment.stimulus.contacts.is_empty());
            if seen.last().is_none_or(|(location, _)| *location != moment.location) {
                seen.push((moment.location, moment.stimulus.gravity));
            }
        }
        seen
    };
    let grid = carried_out(&steps("counts = [3, 4]")).unwrap();
    let found = of(&grid);
    assert_eq!(found.iter().map(|(location, _)| *location).collect::<Vec<_>>(), (1..=12).collect::<Vec<_>>());
    let g = 9.806_65;
    for (k, (_, gravity)) in found.iter().enumerate() {
        let yaw = [-1.5708, 0.0, 1.5708f64][k / 4];
        // The end of the turn is its beginning, and is left out.
        let roll = 6.2832 / 4.0 * (k % 4) as f64;
        let wanted = Vector3::new(yaw.sin() * roll.cos(), -yaw.sin() * roll.sin(), -yaw.cos()) * g;
        assert!((gravity - wanted).norm() < 1e-9, "{k}: {gravity:?} and not {wanted:?}");
    }
    // What is drawn lies all over the half turn, and is as long as gravity.
    let drawn = of(&carried_out(&steps("count = 200")).unwrap());
    assert_eq!(drawn.len(), 200);
    assert!(drawn.iter().all(|(_, gravity)| (gravity.norm() - g).abs() < 1e-9 && gravity.z <= 1e-3));
    for axis in [0, 1] {
        let values = drawn.iter().map(|(_, gravity)| gravity[axis]);
        let (low, high) = values.fold((0.0f64, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
        assert!(low < -0.8 * g && high > 0.8 * g, "{low} to {high}");
    }
    // A press afterwards is in the plan's own posture, and the ground truth says so: it does not know of any here.
    let then =
        format!("{}[[steps]]\nkind = \"presses\"\ncount = 1\nforce = [0.5, 0.5]\n", steps("counts = [3, 4]"));
    let timeline = carried_out(&then).unwrap();
    let skin = testing::skin(100.0);
    let said = |moment: &GroundTruth| moment.message(&skin, timeline.model.surface(), "session", 1).gravity;
    let touched = timeline.first_touch();
    assert!(
        touched.location == 13 && touched.stimulus.gravity == Vector3::zeros() && said(&touched).x.is_nan()
    );
    assert!((said(&timeline.at(0.01)).x + g).abs() < 1e-6, "yaw of -90 degrees: the x axis points up");
}
