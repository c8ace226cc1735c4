//! Recordings from bags.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::Path;

use dermis_bag::{BagQos, BagWriter};
use dermis_fixtures::SkinFile;
use dermis_gap::{GapError, Phase, Recording, SampleOptions, Samples};
use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
use dermis_msgs::msg::{Indentation, IndentationContact, SkinGeometry, TaxelFrame};
use dermis_msgs::{Message, TypeSupport};
use dermis_skin::{Frame, SkinDescription};

fn pad() -> SkinFile {
    SkinFile::new("pad")
}

fn skin() -> SkinDescription {
    pad().read()
}

/// Twenty presses of ten frames; `scale` of the ground truth's lengths, `sign` of its forces.
fn bag(path: &Path, skin: &SkinDescription, scale: f64, sign: f64) {
    let mut writer = BagWriter::create(path).unwrap();
    writer.add_topic("taxels", TypeSupport::of::<TaxelFrame>(), BagQos::sensor_data()).unwrap();
    writer.add_topic("truth", TypeSupport::of::<Indentation>(), BagQos::sensor_data()).unwrap();
    // It names the channels; that the type's hash is not known keeps the name of the skin in play.
    let geometry = SkinGeometry { skin_hash: String::new(), ..skin.geometry_message(&skin.surface(), 1) };
    writer.write("skin_geometry", &geometry, 1_700_000_000_000_000_000).unwrap();
    for index in 0..200_u64 {
        let stamp = 1_700_000_000_000_000_000 + index as i64 * 10_000_000;
        let mut frame = Frame::new(stamp, index, vec![index as f32, -(index as f32)]);
        frame.temperature = 294.0;
        writer
            .write_cdr("taxels", TypeSupport::of::<TaxelFrame>(), &skin.frame_message(&frame).to_cdr(), stamp)
            .unwrap();
        let within = index % 10;
        let touched = (2..8).contains(&within);
        let contact = IndentationContact::sphere(
            Point { x: scale * 0.003, y: 0.0, z: 0.0 },
            Vector3 { x: 0.0, y: 0.0, z: 1.0 },
            Vector3 { x: 0.0, y: 0.0, z: -sign },
            dermis_msgs::msg::Contact::FORCE_FULL,
            f64::NAN,
            0.004,
        );
        let truth = Indentation {
            header: skin.header(stamp),
            skin: skin.name.clone(),
            session: "first".to_owned(),
            press: index / 10 + 1,
            location: 1 + (index / 10) as u32,
            repeat: 0,
            phase: if touched { Indentation::PHASE_HOLD } else { Indentation::PHASE_IDLE },
            temperature: f32::NAN,
            gravity: Vector3::UNKNOWN,
            contacts: if touched { vec![contact] } else { Vec::new() },
        };
        writer.write_cdr("truth", TypeSupport::of::<Indentation>(), &truth.to_cdr(), stamp).unwrap();
    }
    writer.finish().unwrap();
}

fn read(scale: f64, sign: f64) -> Recording {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag");
    bag(&path, &skin(), scale, sign);
    dermis_gap::read(&[path], &skin(), None, None).unwrap()
}

#[test]
fn frames_and_ground_truth_are_joined() {
    let recording = read(1.0, 1.0);
    assert_eq!((recording.labels.len(), recording.contacts(), recording.channels), (200, 20, 2));
    assert_eq!(recording.sessions, ["first"]);
    assert!(recording.problems.is_empty(), "{:?}", recording.problems);
    let label = &recording.labels[33];
    assert_eq!((label.press, label.location, label.phase), (4, 4, Phase::Hold));
    assert!((label.time - 0.33).abs() < 1e-9 && label.temperature == 294.0);
    let contact = &label.stimulus.as_ref().unwrap().contacts[0];
    assert_eq!((contact.position.x, contact.force.z, contact.diameter()), (0.003, -1.0, 0.004));
    assert_eq!(recording.frame(33), [33.0, -33.0]);
    assert_eq!(recording.labels[31].phase, Phase::Idle);
}

#[test]
fn ground_truth_in_millimetres_or_turned_is_named() {
    let far = read(1000.0, 1.0);
    let problem = far.problems.iter().find(|p| p.code == "frame").unwrap();
    assert!(problem.fatal && problem.what.contains("millimetres instead of metres"), "{}", problem.what);
    let pulled = read(1.0, -1.0);
    let problem = pulled.problems.iter().find(|p| p.code == "frame").unwrap();
    assert!(problem.fatal && problem.what.contains("turn its sign"), "{}", problem.what);
}

#[test]
fn several_bags_are_one_recording_of_one_device() {
    let dir = tempfile::tempdir().unwrap();
    let bags = ["first", "second"].map(|name| dir.path().join(name));
    bags.iter().for_each(|path| bag(path, &skin(), 1.0, 1.0));
    let both = dermis_gap::read(&bags, &skin(), None, None).unwrap();
    assert_eq!((both.labels.len(), both.contacts()), (400, 40));
    // Sessions of one name are two, and time and press count from the beginning of each bag.
    assert_eq!(both.sessions, ["first", "first (2)"]);
    let (a, b) = (&both.labels[33], &both.labels[233]);
    assert_eq!((a.run, b.run, a.press, b.press, a.time), (0, 1, 4, 4, b.time));
    assert_eq!((both.session_of(33), both.session_of(233)), (0, 1));
    // All presses are at one place: held out in one bag, they are held out in both.
    let samples = Samples::draw(&both, &[true; 2], &SampleOptions::default());
    let touched = || samples.list.iter().filter(|s| s.contacts > 0);
    for sample in touched().filter(|s| s.location.0 == 1) {
        let same = touched().find(|s| s.location.0 == 0 && s.location.1 == 1).unwrap();
        assert_eq!(sample.group, same.group);
    }
    let twice = dermis_gap::read(&[&bags[0], &bags[1], &bags[0]], &skin(), None, None).unwrap_err();
    let twice = twice.to_string().replace(&bags[0].display().to_string(), "BAG");
    insta::assert_snapshot!(twice, @"BAG: is named twice: its presses would be repeats of themselves; name each recording once");
}

#[test]
fn bags_of_other_skins_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag");
    bag(&path, &skin(), 1.0, 1.0);
    let refused = |other: SkinFile| {
        let error = dermis_gap::read(&[&path], &other.read(), None, None).unwrap_err();
        assert!(matches!(error, GapError::Recording { .. }));
        error.to_string().replace(&path.display().to_string(), "BAG")
    };
    insta::assert_snapshot!(refused(pad().set("name", "\"palm\"")), @"BAG: holds no frames of skin `palm`; it has those of `pad` (/taxels); `--skin-instance` names one, `dermis bag info` lists them");
    insta::assert_snapshot!(refused(pad().set("unit", "\"kPa\"")), @r#"BAG: its readings are in "Pa" where skin `pad` is in "kPa""#);
    insta::assert_snapshot!(refused(pad().taxels([("a", [-0.005, 0.0, -0.005])])), @"BAG: its frames have 2 channels where skin `pad` has 1: pass the description that it was recorded with");
}

#[test]
fn frames_of_other_channels_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let other = pad().taxels([("a", [-0.005, 0.0, -0.005]), ("c", [0.005, 0.0, -0.005])]).read();
    let refused = |name: &str, skins: [&SkinDescription; 2]| {
        let path = dir.path().join(name);
        let mut writer = BagWriter::create(&path).unwrap();
        for (index, skin) in (0_i64..).zip(skins) {
            let stamp = 1_700_000_000_000_000_000 + index * 10_000_000;
            let frame = skin.frame_message(&Frame::new(stamp, 7 + index as u64, vec![1.0, 2.0]));
            writer.write("taxels", &frame, stamp).unwrap();
        }
        writer.finish().unwrap();
        let error = dermis_gap::read(&[&path], &skin(), None, None).unwrap_err();
        error.to_string().replace(&path.display().to_string(), "BAG")
    };
    insta::assert_snapshot!(refused("all", [&other, &other]), @"BAG: frame 7 has the channel layout 17a9365d where the skin has 0eb2071c, and no geometry says which channels those are: readings would be taken for those of others; pass the description that it was recorded with");
    insta::assert_snapshot!(refused("later", [&skin(), &other]), @"BAG: frame 8 has the channel layout 17a9365d where those before have 0eb2071c: the skin was changed in the middle; cut the bag there with `dermis bag slice`");
}
