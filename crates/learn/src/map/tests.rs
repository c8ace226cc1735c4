use std::path::{Path, PathBuf};

use dermis_bag::BagWriter;
use dermis_msgs::msg::TaxelFrame;
use dermis_skin::ForceComponents;

use dermis_skin::Frame;

use super::*;
use crate::dataset::tests::{STEP, skin};
use crate::{Dataset, DatasetOptions};

/// A tilted skin, a sensor that is turned in the tool, and clocks that do not agree.
const MAP: &str = r#"
schema = "dermis-labels/1"
[skin.pose]
position = [0.4, -0.1, 0.2]
orientation = [0.0, 0.38268343236508984, 0.0, 0.9238795325112867]
[robot]
topic = "/tool_pose"
tool = "flange"
tip = [0.0, 0.01, 0.05]
tip_radius = 0.002
time_offset = 0.02
[force]
topic = "/wrench"
mounted = "tool"
orientation = [0.0, 0.0, 0.7071067811865476, 0.7071067811865476]
exerted_on = "tip"
time_offset = -0.01
[contact]
on = 0.1
off = 0.05
"#;

const BEGIN: Stamp = 1_700_000_000_000_000_000;
const OFFSET: [f64; 3] = [0.7, -0.3, 1.1];

fn map(changes: &[(&str, &str)]) -> LabelMap {
    let text = changes.iter().fold(MAP.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from} is not in the map");
        text.replacen(from, to, 1)
    });
    LabelMap::from_toml(&text, "labels.toml").unwrap()
}

/// What is done: place, gap and force at every instant.
type Act = Box<dyn Fn(f64) -> (Point3<f64>, f64, Vector3<f64>)>;

/// Two presses of a second each, with a second in the air around them.
fn two_presses() -> Act {
    Box::new(|t| {
        let x = if t < 2.5 { 0.003 } else { -0.0045 };
        let pressed = (1.0..2.0).contains(&t) || (3.0..4.0).contains(&t);
        let force =
            if pressed { Vector3::new(0.2, -0.1, -1.0 - 0.5 * (t * 3.0).sin()) } else { Vector3::zeros() };
        (Point3::new(x, 0.001, 0.0), if pressed { 0.0 } else { 0.01 }, force)
    })
}

fn record(
    dir: &Path,
    map: &LabelMap,
    act: &Act,
    edit: impl Fn(&mut TaxelFrame, &mut TransformStamped, &mut WrenchStamped),
) -> PathBuf {
    let skin = skin();
    let path = dir.join("rig");
    let mut writer = BagWriter::create(&path).unwrap();
    for k in 0..500_i64 {
        let stamp = BEGIN + k * STEP;
        let frame = Frame::new(stamp, k as u64, vec![100.0 + (k % 3) as f32, 50.0 + (k % 2) as f32]);
        let mut frame = skin.frame_message(&frame);
        // The rig is sampled at other instants than the skin.
        let stamp = stamp + 3_000_000;
        let (place, gap, force) = act((stamp - BEGIN) as f64 * 1e-9);
        let (mut pose, mut wrench) =
            map.report(&skin.surface(), (&place, gap), &force, &Vector3::from(OFFSET), stamp);
        edit(&mut frame, &mut pose, &mut wrench);
        writer.write("/pad/taxels", &frame, stamp).unwrap();
        writer.write(&map.robot.topic, &pose, stamp).unwrap();
        writer.write(&map.force.topic, &wrench, stamp).unwrap();
    }
    writer.finish().unwrap();
    path
}

fn options(map: &LabelMap) -> DatasetOptions {
    DatasetOptions { map: Some(map.clone()), ..DatasetOptions::default() }
}

fn near(a: &Vector3<f64>, b: &Vector3<f64>, tolerance: f64) {
    assert!((a - b).norm() < tolerance, "{a} {b}");
}

#[test]
fn a_rigs_readings_become_what_was_done() {
    let mounts = [
        vec![],
        vec![("mounted = \"tool\"", "mounted = \"base\""), ("exerted_on = \"tip\"", "exerted_on = \"skin\"")],
    ];
    for changes in mounts {
        let (dir, map, act) = (tempfile::tempdir().unwrap(), map(&changes), two_presses());
        let bag = record(dir.path(), &map, &act, |_, _, _| {});
        let data = Dataset::from_bags(&[&bag], &skin(), &options(&map)).unwrap();
        let run = &data.runs()[0];
        let mut touched = 0;
        for sample in &run.samples {
            let Some(truth) = &sample.truth else { continue };
            let t = (sample.stamp - BEGIN) as f64 * 1e-9;
            let (place, gap, force) = act(t);
            // Half a sample around the edges is a blend of both sides.
            if [1.0, 2.0, 2.5, 3.0, 4.0].iter().any(|edge| (t - edge).abs() < 0.015) {
                continue;
            }
            assert_eq!(truth.touched(), gap == 0.0, "{t} s");
            assert_eq!(truth.idle, gap > 0.0);
            if let Some(contact) = truth.single() {
                touched += 1;
                near(&contact.position.coords, &place.coords, 1e-9);
                near(&contact.force, &force, 1e-3);
                near(&contact.normal, &Vector3::z(), 1e-12);
                assert_eq!(contact.components, ForceComponents::Full);
            }
        }
        assert!(touched > 180, "{touched}");
        assert_eq!(data.locations(), 2);
        let presses: std::collections::BTreeSet<u64> =
            data.labelled().filter(|(_, _, t)| t.touched()).map(|(_, _, t)| t.press).collect();
        assert_eq!(presses.len(), 2);
        let bias = run.bias.unwrap();
        assert_eq!(bias.stretches, 3);
        near(&Vector3::from(bias.mean), &Vector3::from(OFFSET), 1e-3);
        assert!(run.samples.iter().filter(|s| s.tare).count() == 3);
    }
}

#[test]
fn poses_may_come_as_one_of_many_transforms() {
    let (dir, map, act) = (tempfile::tempdir().unwrap(), map(&[]), two_presses());
    let single = record(dir.path(), &map, &act, |_, _, _| {});
    let path = dir.path().join("tf");
    let mut writer = BagWriter::create(&path).unwrap();
    for message in BagReader::open(&single).unwrap().messages() {
        let message = message.unwrap();
        let time = message.log_time;
        if &*message.topic == "/tool_pose" {
            let tool: TransformStamped = message.decode().unwrap();
            let other = TransformStamped { child_frame_id: "camera".into(), ..tool.clone() };
            writer.write(&message.topic, &TFMessage { transforms: vec![other, tool] }, time).unwrap();
        } else if &*message.topic == "/wrench" {
            writer.write(&message.topic, &message.decode::<WrenchStamped>().unwrap(), time).unwrap();
        } else {
            writer.write(&message.topic, &message.decode::<TaxelFrame>().unwrap(), time).unwrap();
        }
    }
    writer.finish().unwrap();
    let read = |path| Dataset::from_bags(&[path], &skin(), &options(&map)).unwrap();
    let (one, many) = (read(&single), read(&path));
    assert!(one.labelled().count() > 400);
    assert!(one.labelled().map(|(_, _, t)| t).eq(many.labelled().map(|(_, _, t)| t)));
}

#[test]
fn readings_that_are_too_many_to_be_held_tell_the_same() {
    let (dir, map, act) = (tempfile::tempdir().unwrap(), map(&[]), two_presses());
    let bag = record(dir.path(), &map, &act, |_, _, _| {});
    let read = |most_frames| {
        let options = DatasetOptions { most_frames, memory: 0, ..options(&map) };
        Dataset::from_bags(&[&bag], &skin(), &options).unwrap()
    };
    // There are 500 frames, and 1000 readings.
    let (whole, streamed, thinned) = (read(1000), read(500), read(100));
    assert_eq!(whole.runs()[0].samples, streamed.runs()[0].samples);
    let run = &thinned.runs()[0];
    assert_eq!((run.frames(), run.every(), thinned.locations()), (500, 6, 2));
    assert!(run.samples.iter().all(|s| *s == whole.runs()[0].samples[s.number as usize]));
    for data in [&streamed, &thinned] {
        assert_eq!((data.hash(), data.runs()[0].bias), (whole.hash(), whole.runs()[0].bias));
    }
}

#[test]
fn pressed_locations_have_identities_that_scatter_does_not_change() {
    let (mut here, mut there) = (Locations::default(), Locations::default());
    let at = |x: f64| Point3::new(x, 0.0, 0.0);
    // 6.5 mm lies on the edge of a cell of 1 mm.
    let ids: Vec<u32> = [0.00651, 0.00649, 0.0065].iter().map(|x| here.identify(&at(*x), 1e-3)).collect();
    assert!(ids.windows(2).all(|w| w[0] == w[1]));
    assert_ne!(here.identify(&at(0.0082), 1e-3), ids[0]);
    assert_eq!(there.identify(&at(0.0082), 1e-3), here.identify(&at(0.0082), 1e-3));
}

#[test]
fn all_that_is_missing_is_said_at_once() {
    let refusal = |map: &LabelMap,
                   edit: &dyn Fn(&mut TaxelFrame, &mut TransformStamped, &mut WrenchStamped),
                   options: &DatasetOptions| {
        let dir = tempfile::tempdir().unwrap();
        let bag = record(dir.path(), map, &two_presses(), edit);
        let error = Dataset::from_bags(&[&bag], &skin(), options).unwrap_err().to_string();
        error.replace(&bag.display().to_string(), "BAG")
    };
    let whole = map(&[]);
    insta::assert_snapshot!(refusal(&whole, &|f, p, w| {
        f.values = vec![3.0, f32::NAN];
        p.child_frame_id = "camera".into();
        w.header.stamp = Time::default();
    }, &options(&whole)), @r"
    4 things are in the way
      1. bag BAG: 1 of 2 channels never give a number: right: there is nothing to learn from
      2. bag BAG: 1 of 2 channels never change: left: there is nothing to learn from
      3. bag BAG: /tool_pose never tells of the tool `flange` (map: robot.tool), but of `camera`: without it there is no ground truth
      4. bag BAG: 500 messages on /wrench have no stamp (header.stamp is 0): nothing can be joined by acquisition time; let the driver stamp its messages
    ");
    insta::assert_snapshot!(refusal(&whole, &|_, p, _| p.child_frame_id = if p.header.stamp.nanosec % 3 == 0 { "a".into() } else { "b".into() }, &options(&map(&[("tool = \"flange\"\n", "")]))), @"bag BAG: /tool_pose carries several frames: `a`, `b`: which of them is the tool must be said (map: robot.tool)");
    insta::assert_snapshot!(refusal(&whole, &|_, p, _| p.header.frame_id = "world".into(), &options(&map(&[("tool = \"flange\"", "base = \"robot\"")]))), @"bag BAG: poses on /tool_pose are in the frame `world` where one base is needed (map: robot.base is `robot`): positions would be meaningless");
    insta::assert_snapshot!(refusal(&whole, &|_, p, w| {
        for stamp in [&mut p.header.stamp, &mut w.header.stamp] {
            *stamp = Time::from_nanos(stamp.as_nanos() + 100_000_000_000);
        }
    }, &options(&whole)), @"bag BAG: none of 500 frames has ground truth within 0.1 s of its stamp: frames reach from 0 to 4.99 s, the ground truth from 100.00 to 104.99 s after the first frame: check that both were stamped by the same clock");
    insta::assert_snapshot!(refusal(&whole, &|_, _, _| {}, &options(&map(&[("tip_radius = 0.002", "tip_radius = 0.02")]))), @"bag BAG: the tip is never 2 mm or more away from the skin for 5 readings of /wrench: the force sensor's bias is unknown; check robot.tip and skin.pose of the map, record the tip in the air, or set force.remove_bias to false");
}

#[test]
fn a_push_somewhere_else_is_no_ground_truth() {
    let (dir, map) = (tempfile::tempdir().unwrap(), map(&[]));
    let act: Act = Box::new(|t| {
        let force = Vector3::new(0.0, 0.0, if t > 4.0 { -1.0 } else { 0.0 });
        // A push that the skin cannot feel: the tip is in the air.
        if t > 4.5 {
            (Point3::new(0.0, 0.0, 0.0), 0.01, force)
        } else {
            (Point3::new(0.001, 0.0, 0.0), 0.01, Vector3::zeros())
        }
    });
    let bag = record(dir.path(), &map, &act, |_, _, _| {});
    let data = Dataset::from_bags(&[&bag], &skin(), &options(&map)).unwrap();
    assert!(data.labelled().all(|(_, _, t)| !t.touched()));
    let notices = data.notices().join("\n").replace(&bag.display().to_string(), "BAG");
    insta::assert_snapshot!(notices, @r"
    bag BAG: the force sensor's noise without contact is 0.173 N, and contact.off of the map 0.05 N: noise will be taken for contacts; raise contact.on and contact.off to five times the noise
    bag BAG: in 50 of 500 frames the force sensor feels a push with the tip 2 mm or more away from the skin: they are not used; check robot.tip, skin.pose and the time offsets of the map
    bag BAG: 51 of 500 frames have no ground truth within 0.1 s: they are used as history only
    ");
}

#[test]
fn maps_that_ship_are_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/labels");
    let maps: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    assert!(!maps.is_empty());
    maps.iter().for_each(|path| drop(LabelMap::load(path).unwrap()));
}

#[test]
fn refusals_name_file_and_field() {
    let refused = |from: &str, to: &str| {
        assert!(MAP.contains(from));
        LabelMap::from_toml(&MAP.replacen(from, to, 1), "labels.toml").unwrap_err().to_string()
    };
    insta::assert_snapshot!(refused("labels/1", "labels/9"), @r#"labels.toml: field `schema`: is "dermis-labels/9" where this program reads "dermis-labels/1""#);
    insta::assert_snapshot!(refused("tip_radius", "tip_radios"), @"labels.toml: field `robot.tip_radios`: unknown field `tip_radios`, expected one of `topic`, `tool`, `base`, `tip`, `tip_radius`, `time_offset`");
    insta::assert_snapshot!(refused("0.38268343236508984", "0.5"), @"labels.toml: field `skin.pose.orientation`: is [0.0, 0.5, 0.0, 0.9238795325112867] of length 1.0505 and must be a unit quaternion x, y, z, w");
    insta::assert_snapshot!(refused("off = 0.05", "off = 0.5"), @"labels.toml: field `contact.off`: is 0.5 N with contact.on 0.1 N: 0 < off ≤ on");
    insta::assert_snapshot!(refused("exerted_on = \"tip\"", "exerted_on = \"sensor\""), @"labels.toml: field `force.exerted_on`: unknown variant `sensor`, expected `tip` or `skin`");
    insta::assert_snapshot!(refused("tip = [0.0, 0.01, 0.05]", "tip = [0.0, nan, 0.05]"), @"labels.toml: field `robot.tip`: is [0.0, NaN, 0.05]: metres and seconds of a rig are finite and small");
}

proptest::proptest! {
    #[test]
    fn no_text_panics(text in ".{0,200}") {
        let _ = LabelMap::from_toml(&text, "x");
    }
}
