use dermis_bag::BagWriter;
use dermis_fixtures::SkinFile;
use dermis_msgs::msg::{Contact as ContactMsg, Indentation, SkinGeometry, TaxelFrame};
use dermis_skin::{ForceComponents, Frame, Stamp};
use nalgebra::{Point3, Vector3};

use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{Point, Vector3 as VectorMsg};
use dermis_msgs::msg::IndentationContact;
use dermis_msgs::std_msgs::msg::Header;

use super::read::truth_at;
use super::*;

mod thinned;

pub(crate) const STEP: i64 = 10_000_000;

fn file() -> SkinFile {
    SkinFile::new("pad")
        .taxels([("left", [-0.005, 0.0, -0.005]), ("right", [0.005, 0.0, -0.005])])
        .tables("[condition]\ntare_duration = 0.03\n")
}

pub(crate) fn skin() -> SkinDescription {
    file().read()
}

pub(crate) fn contact(x: f64, y: f64, newtons: f64) -> TruthContact {
    TruthContact {
        position: Point3::new(x, y, 0.0),
        normal: Vector3::z(),
        force: Vector3::new(0.0, 0.0, -newtons),
        components: ForceComponents::Full,
        diameter: 0.004,
        flat: false,
    }
}

/// `repeats` rounds of presses at `locations` locations, two touched frames each after ten untouched ones; readings
/// are linear in position and force over a zero of 1000.
pub(crate) fn presses(locations: u32, repeats: u32) -> Dataset {
    let skin = skin();
    let mut stamp = 0;
    let (mut frames, mut truths) = (Vec::new(), Vec::new());
    let mut push = |values: [f64; 2], truth: Truth| {
        stamp += STEP;
        let values = values.map(|v| v as f32).to_vec();
        frames.push(Frame::new(stamp, frames.len() as u64, values));
        truths.push((stamp, truth));
    };
    for repeat in 0..repeats {
        for location in 0..locations {
            let press = u64::from(repeat * locations + location);
            for _ in 0..10 {
                push([1000.0, 1000.0], Truth { press, location, idle: true, contacts: Vec::new() });
            }
            let (x, force) =
                (f64::from(location) / f64::from(locations) * 0.01, 1.0 + f64::from(location % 5));
            for _ in 0..2 {
                let truth = Truth { press, location, idle: false, contacts: vec![contact(x, 0.0, force)] };
                push([1000.0 + 1e4 * x, 1000.0 + 20.0 * force], truth);
            }
        }
    }
    let labels = labels(&frames, &truths);
    Dataset::from_runs(&skin, vec![made(frames, labels, &skin, true)])
}

fn made(frames: Vec<Frame>, labels: Vec<Option<Truth>>, skin: &SkinDescription, anew: bool) -> Run {
    Run::of_frames(("made.bag".into(), "made".into(), hex(&[0; 32])), frames, labels, skin, anew)
}

/// Every frame of the first run.
pub(crate) fn samples(data: &Dataset) -> Vec<Sample> {
    data.stream(0).unwrap().collect::<Result<_, _>>().unwrap()
}

fn labels(frames: &[Frame], truths: &[(Stamp, Truth)]) -> Vec<Option<Truth>> {
    frames.iter().map(|f| truth_at(truths, f.stamp, 1_000_000)).collect()
}

/// Stamps of the tests count from here: 0 means that there is none.
const BEGIN: i64 = 1_700_000_000_000_000_000;

fn frame(stamp: i64, sequence: u64, values: Vec<f32>) -> TaxelFrame {
    let skin = skin();
    skin.frame_message(&Frame::new(BEGIN + stamp, sequence, values))
}

fn truth(stamp: i64, press: u64, contacts: &[(f64, f64)]) -> Indentation {
    Indentation {
        header: Header { stamp: Time::from_nanos(BEGIN + stamp), frame_id: "pad_link".into() },
        skin: "pad".into(),
        session: "s1".into(),
        press,
        location: press as u32,
        contacts: contacts
            .iter()
            .map(|(x, force)| IndentationContact {
                position: Point { x: *x, y: 0.0, z: 0.0 },
                normal: VectorMsg { x: 0.0, y: 0.0, z: 1.0 },
                force: VectorMsg { x: f64::NAN, y: f64::NAN, z: -force },
                force_components: ContactMsg::FORCE_NORMAL,
                ..Default::default()
            })
            .collect(),
        ..Default::default()
    }
}

fn bag(dir: &Path, frames: &[TaxelFrame], truths: &[Indentation]) -> PathBuf {
    let path = dir.join("bag");
    let mut writer = BagWriter::create(&path).unwrap();
    for f in frames {
        writer.write("/pad/taxels", f, f.header.stamp.as_nanos()).unwrap();
    }
    for t in truths {
        writer.write("/pad/ground_truth", t, t.header.stamp.as_nanos()).unwrap();
    }
    writer.finish().unwrap();
    path
}

#[test]
fn frames_meet_their_ground_truth() {
    let dir = tempfile::tempdir().unwrap();
    let frames: Vec<TaxelFrame> = (0..12)
        .map(|k| {
            frame(
                k * STEP,
                k as u64 + u64::from(k > 9),
                vec![100.0 + k as f32, if k < 8 { 50.0 } else { 80.0 }],
            )
        })
        .collect();
    let mut truths: Vec<Indentation> = (0..6).map(|k| truth(k * STEP + 1_000_000, 1, &[])).collect();
    // Frame 8 lies a quarter of the way between two readings of one press, frame 9 beyond them.
    truths.push(truth(8 * STEP - 1_000_000, 2, &[(0.001, 1.0)]));
    truths.push(truth(8 * STEP + 3_000_000, 2, &[(0.001, 2.0)]));
    // Frame 10 has a gap in its nearest reading, frame 11 two contacts.
    truths.push(truth(10 * STEP, 3, &[(0.002, f64::NAN)]));
    truths.push(truth(11 * STEP, 4, &[(0.002, 1.0), (0.004, 1.0)]));
    let path = bag(dir.path(), &frames, &truths);
    let options = DatasetOptions { tolerance: Some(0.005), ..DatasetOptions::default() };
    let data = Dataset::from_bags(&[&path], &skin(), &options).unwrap();
    let run = &data.runs()[0];
    assert_eq!((run.samples.len(), run.lost, run.session.as_str()), (12, 1, "s1"));

    let read = samples(&data);
    let value = |k: usize, target: &str| run.samples[k].truth.as_ref().and_then(|t| t.value(target));
    assert_eq!(value(2, "contact"), Some(0.0));
    assert_eq!((value(2, "force.normal"), value(2, "position.x")), (Some(0.0), None));
    approx::assert_relative_eq!(value(8, "force.normal").unwrap(), 1.25, max_relative = 1e-12);
    assert_eq!((value(8, "position.x"), value(8, "force.z")), (Some(0.001), None));
    assert_eq!((value(10, "position.x"), value(10, "force.normal")), (Some(0.002), None));
    assert_eq!((value(11, "contact"), value(11, "position.x")), (Some(1.0), None));
    assert!(run.samples[7].truth.is_none(), "9 ms away from any ground truth");

    // The tare averages the first 30 ms of untouched frames: k = 0..=3.
    assert!(read[0].tared[0].is_nan());
    assert!((read[8].tared[1] - 30.0).abs() < 1e-4);
    assert_eq!(data.targets()["position.x"], 2);
    let notices = data.notices().join("\n").replace(&path.display().to_string(), "BAG");
    insta::assert_snapshot!(notices, @r"
    bag BAG: 1 frames (7.7 %) were lost between device and bag, the longest gap is 0.01 s: a model that looks back sees steps there
    bag BAG: 3 of 12 frames have no ground truth within 0.005 s: they are used as history only
    bag BAG: 1 frames have several contacts: they only count for the target `contact`
    ");
}

#[test]
fn what_a_bag_lacks_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let refusal = |frames: &[TaxelFrame], truths: &[Indentation]| {
        let path = bag(dir.path(), frames, truths);
        let error =
            Dataset::from_bags(&[&path], &skin(), &DatasetOptions::default()).unwrap_err().to_string();
        std::fs::remove_dir_all(&path).unwrap();
        error.replace(&path.display().to_string(), "BAG")
    };
    let good = frame(0, 7, vec![1.0, 2.0]);
    insta::assert_snapshot!(refusal(std::slice::from_ref(&good), &[]), @"bag BAG: holds 1 frames of skin `pad` but no ground truth (dermis_msgs/msg/Indentation) for it: nothing can be learned or measured; record one with `dermis collect`, `dermis import` a labelled recording, or name a robot's and a force sensor's topics in a file and pass it as `--map`");
    let mut other = good.clone();
    other.skin = "arm".into();
    insta::assert_snapshot!(refusal(&[other], &[truth(0, 0, &[])]), @"bag BAG: holds no frames of skin `pad`; it has those of `arm` (/pad/taxels): there is nothing to learn from; `--skin-instance` names a device of this type, `dermis bag info` lists them");
    insta::assert_snapshot!(refusal(std::slice::from_ref(&good), &[truth(STEP * 5, 0, &[])]), @"bag BAG: none of 1 frames has ground truth within 0.01 s of its stamp: frames reach from 0 to 0.00 s, the ground truth from 0.05 to 0.05 s after the first frame: check that both were stamped by the same clock");
    // Skins of the same shape whose channels are not ours; the bag's geometry names them.
    let like = |from: &str, to: &str| {
        SkinDescription::from_toml(&file().to_string().replace(from, to), "pad.toml").unwrap()
    };
    let swapped = like("\"left\"", "\"x\"");
    let refusal_of = |other: &SkinDescription| {
        let path = dir.path().join("bag");
        let mut writer = BagWriter::create(&path).unwrap();
        let geometry = other.geometry_message(&other.surface(), BEGIN);
        // That the descriptions differ would be said beside it.
        let geometry = SkinGeometry { skin_hash: String::new(), ..geometry };
        writer.write("/pad/skin_geometry", &geometry, BEGIN).unwrap();
        let reading = other.frame_message(&Frame::new(BEGIN, 7, vec![1.0, 2.0]));
        writer.write("/pad/taxels", &reading, BEGIN).unwrap();
        writer.write("/pad/ground_truth", &truth(0, 0, &[]), BEGIN).unwrap();
        writer.finish().unwrap();
        let error =
            Dataset::from_bags(&[&path], &skin(), &DatasetOptions::default()).unwrap_err().to_string();
        std::fs::remove_dir_all(&path).unwrap();
        error.replace(&path.display().to_string(), "BAG")
    };
    insta::assert_snapshot!(refusal_of(&swapped), @"bag BAG: frame 7: channel 0 is `x` where the skin has `left`: the readings cannot be assigned to channels; check the skin description");
    insta::assert_snapshot!(refusal_of(&like("\"Pa\"", "\"V\"")), @r#"bag BAG: frame 7 is in "V" where the skin is in "Pa": the readings cannot be assigned to channels; check the skin description"#);
    let nameless = swapped.frame_message(&Frame::new(BEGIN, 7, vec![1.0, 2.0]));
    insta::assert_snapshot!(refusal(&[nameless], &[truth(0, 0, &[])]), @"bag BAG: frame 7 has the channel layout fa8ce54b where the skin has 988a1319, and no geometry says which channels those are: the readings cannot be assigned to channels; check the skin description");
    let short = frame(0, 7, vec![1.0]);
    insta::assert_snapshot!(refusal(&[short], &[truth(0, 0, &[])]), @"bag BAG: frame 7 has 1 values where the skin has 2 channels: the readings cannot be assigned to channels; check the skin description");
}

#[test]
fn the_zero_is_taken_anew_in_every_idle_stretch() {
    let skin = skin();
    // The zero jumps by 5 Pa between two presses, too far for drift to be followed.
    let mut frames = Vec::new();
    let mut truths = Vec::new();
    for (k, (value, idle)) in [(100.0, true); 5]
        .into_iter()
        .chain([(120.0, false); 2])
        .chain([(105.0, true); 5])
        .chain([(125.0, false); 2])
        .enumerate()
    {
        let stamp = k as i64 * STEP;
        frames.push(Frame::new(stamp, k as u64, vec![value; 2]));
        let contacts = if idle { Vec::new() } else { vec![contact(0.0, 0.0, 1.0)] };
        truths.push((stamp, Truth { press: 0, location: 0, idle, contacts }));
    }
    let read = |anew: bool| {
        let run = made(frames.clone(), labels(&frames, &truths), &skin, anew);
        samples(&Dataset::from_runs(&skin, vec![run]))
    };
    let anew = read(true);
    let marks: Vec<usize> = anew.iter().enumerate().filter(|(_, s)| s.tare).map(|(k, _)| k).collect();
    assert_eq!(marks, [0, 7]);
    assert_eq!((anew[6].tared[0], anew[13].tared[0]), (20.0, 20.0));
    let once = read(false);
    assert!(once[13].tared[0] > 24.9);
}

#[test]
fn inputs_are_those_of_a_node() {
    let data = presses(6, 1);
    let mut config = FeatureConfig::newest(vec![0.0; 2], vec![1.0; 2]);
    config.low_pass = vec![0.1];
    let (ids, rows) = data.inputs(&config, Baseline::Tared).unwrap();
    assert_eq!(rows.len(), ids.len() * 4);
    let mut features = Features::new(config).unwrap();
    for sample in samples(&data) {
        if sample.tare {
            features.reset();
        }
        features.push(sample.frame.stamp, &sample.tared).unwrap();
    }
    assert_eq!(features.input().unwrap(), &rows[rows.len() - 4..]);
}

#[test]
fn frames_that_cannot_be_distinguished_or_joined_are_named_together() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag");
    let mut writer = BagWriter::create(&path).unwrap();
    for k in 0..20 {
        let mut message = frame(k * STEP, k as u64, vec![k as f32, 7.0]);
        let log = message.header.stamp.as_nanos();
        writer.write("/left/taxels", &message, log).unwrap();
        writer.write("/right/taxels", &message, log).unwrap();
        if k > 15 {
            message.header.stamp = Time::default();
            writer.write("/left/taxels", &message, log).unwrap();
        }
    }
    writer.finish().unwrap();
    let refusal = |options: &DatasetOptions| {
        let error = Dataset::from_bags(&[&path], &skin(), options).unwrap_err();
        error.to_string().replace(&path.display().to_string(), "BAG")
    };
    insta::assert_snapshot!(refusal(&DatasetOptions::default()), @r"
    3 things are in the way
      1. bag BAG: 4 frames have no stamp (header.stamp is 0): nothing can be joined by acquisition time; let the driver stamp its frames
      2. bag BAG: frames of skin `pad` come on several topics: /left/taxels, /right/taxels: two skins would be taken for one; name one of them with `--taxels`, or skin.taxels of the map
      3. bag BAG: holds 40 frames of skin `pad` but no ground truth (dermis_msgs/msg/Indentation) for it: nothing can be learned or measured; record one with `dermis collect`, `dermis import` a labelled recording, or name a robot's and a force sensor's topics in a file and pass it as `--map`
      note: bag BAG: 1 of 2 channels never change: right: a model will not know them; check the wiring before it is trained
    ");
    let one = DatasetOptions { taxels: Some("/right/taxels".into()), ..DatasetOptions::default() };
    insta::assert_snapshot!(refusal(&one), @r"
    bag BAG: holds 20 frames of skin `pad` but no ground truth (dermis_msgs/msg/Indentation) for it: nothing can be learned or measured; record one with `dermis collect`, `dermis import` a labelled recording, or name a robot's and a force sensor's topics in a file and pass it as `--map`
      note: bag BAG: 1 of 2 channels never change: right: a model will not know them; check the wiring before it is trained
    ");
}

/// A bag of two devices of the skin's type, and the rig's ground truth of each; `truth` names the skin that it says.
fn two_devices(dir: &Path, truth: impl Fn(&str) -> String) -> PathBuf {
    let path = dir.join("two");
    let mut writer = BagWriter::create(&path).unwrap();
    for (side, offset) in [("left", 0.0_f32), ("right", 100.0)] {
        let pad = skin().into_instance(Some(&format!("{side}_pad")), None, None).unwrap();
        let geometry = pad.geometry_message(&pad.surface(), BEGIN);
        writer.write(&format!("/{side}/skin_geometry"), &geometry, BEGIN).unwrap();
        for k in 0..12 {
            let reading = Frame::new(BEGIN + k * STEP, k as u64, vec![k as f32 + offset, 2.0 * k as f32]);
            writer.write(&format!("/{side}/taxels"), &pad.frame_message(&reading), reading.stamp).unwrap();
            let pressed = [(0.001, 1.0)];
            let mut said = self::truth(k * STEP, 1, if k > 6 { &pressed } else { &[] });
            said.skin = truth(side);
            writer.write(&format!("/{side}/ground_truth"), &said, reading.stamp).unwrap();
        }
    }
    writer.finish().unwrap();
    path
}

#[test]
fn one_of_two_like_skins_is_learned_from_and_never_both() {
    let dir = tempfile::tempdir().unwrap();
    for (name, truth) in
        [("own", (|side| format!("{side}_pad")) as fn(&str) -> String), ("type", |_| "pad".to_owned())]
    {
        let folder = dir.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        let path = two_devices(&folder, truth);
        let read = |instance: Option<&str>, taxels: Option<&str>| {
            let options = DatasetOptions {
                instance: instance.map(Into::into),
                taxels: taxels.map(Into::into),
                ..DatasetOptions::default()
            };
            Dataset::from_bags(&[&path], &skin(), &options)
                .map_err(|e| e.to_string().replace(&path.display().to_string(), "BAG"))
        };
        insta::allow_duplicates! {
            insta::assert_snapshot!(read(None, None).unwrap_err(), @"bag BAG: holds frames of several skins of the type `pad`: those of `left_pad` (/left/taxels), `right_pad` (/right/taxels): two devices would be taken for one; name one of them with `--skin-instance`, or its topic with `--taxels`");
            insta::assert_snapshot!(read(Some("foot"), None).unwrap_err(), @"bag BAG: holds no frames of skin `foot`; it has those of `left_pad` (/left/taxels), `right_pad` (/right/taxels): there is nothing to learn from; `--skin-instance` names a device of this type, `dermis bag info` lists them");
        }
        for data in [read(Some("right_pad"), None).unwrap(), read(None, Some("/right/taxels")).unwrap()] {
            let samples = samples(&data);
            assert_eq!(samples.len(), 12);
            assert!(samples.iter().all(|s| s.frame.values[0] >= 100.0), "frames of the right one alone");
            let truths = data.labelled().filter(|(_, _, t)| t.touched()).count();
            assert_eq!(truths, 5, "ground truth of the right one alone");
            assert!(
                data.notices()
                    .iter()
                    .any(|n| n.contains("its frames are of `right_pad`, a skin of the type `pad`")),
                "{:?}",
                data.notices()
            );
        }
    }
}

#[test]
fn a_recording_from_when_the_hash_covered_the_name_is_of_the_same_skin() {
    let dir = tempfile::tempdir().unwrap();
    let frames: Vec<TaxelFrame> =
        (0..12).map(|k| frame(k * STEP, k as u64, vec![k as f32, 1.0 + k as f32])).collect();
    let truths: Vec<Indentation> = (0..12).map(|k| truth(k * STEP, 1, &[(0.001, 1.0)])).collect();
    let path = bag(dir.path(), &frames, &truths);
    // Under another name of the file, its frames are of that skin only where somebody says so.
    let mut renamed = skin();
    renamed.name = "left-pad".into();
    assert!(Dataset::from_bags(&[&path], &renamed, &DatasetOptions::default()).is_err());
    let options = DatasetOptions { instance: Some("pad".into()), ..DatasetOptions::default() };
    assert_eq!(Dataset::from_bags(&[&path], &renamed, &options).unwrap().runs()[0].samples.len(), 12);
}

#[test]
fn what_blocks_training_is_said_beside_what_bags_lack() {
    let dir = tempfile::tempdir().unwrap();
    let frames: Vec<TaxelFrame> = (0..12).map(|k| frame(k * STEP, k as u64, vec![k as f32, 1.0])).collect();
    let truths: Vec<Indentation> = (0..12).map(|k| truth(k * STEP, 1, &[(0.001, f64::NAN)])).collect();
    let path = bag(dir.path(), &frames, &truths);
    let data = Dataset::survey(&[&path], &skin(), &DatasetOptions::default()).unwrap();
    let findings = data.check(&["force.normal", "contact"], Baseline::Tared, &SplitConfig::default());
    assert!(findings.is_fatal());
    let text = findings.to_string().replace(&path.display().to_string(), "BAG");
    insta::assert_snapshot!(text, @r#"
    4 things are in the way
      1. bag BAG: `force.normal` is never known while the skin is touched; known are contact (12 samples), position.x (12 samples), position.y (12 samples), position.z (12 samples): it cannot be learned; name other targets or record them
      2. bag BAG: holds touched samples only: `contact` cannot be learned; leave it out or record idle frames
      3. bag BAG: no stretch of 0.03 s (and 3 frames) before the touched frames is labelled untouched: the zero is unknown; record idle frames first, or train with `baseline = "raw"`
      4. bag BAG: split by location: the data has 1 contact locations; hold out the end of each run instead (`--split time`): nothing would be measured on what was not trained on
      note: bag BAG: 1 of 2 channels never change: right: a model will not know them; check the wiring before it is trained
    "#);
}

#[test]
fn what_is_streamed_is_what_is_held() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag");
    let mut writer = BagWriter::create(&path).unwrap();
    // Frames lie in the bag in another order than they were acquired in, and those of another skin between them.
    let order = [0, 1, 2, 3, 5, 4, 9, 6, 7, 8, 11, 10];
    for (at, k) in order.into_iter().enumerate() {
        let log = BEGIN + at as i64 * STEP;
        let mut message = frame(k * STEP, k as u64, vec![100.0 + k as f32, 50.0]);
        writer.write("/pad/taxels", &message, log).unwrap();
        message.skin = "other".into();
        writer.write("/other/taxels", &message, log).unwrap();
        let pressed = [(0.001, 1.0)];
        writer
            .write("/pad/ground_truth", &truth(k * STEP, 1, if k > 5 { &pressed } else { &[] }), log)
            .unwrap();
    }
    writer.finish().unwrap();
    let read = |memory: usize| {
        let options = DatasetOptions { memory, ..DatasetOptions::default() };
        Dataset::from_bags(&[&path], &skin(), &options).unwrap()
    };
    let (held, streamed) = (read(usize::MAX), read(0));
    assert!(streamed.runs()[0].source.held.is_none());
    assert!(held.runs()[0].source.held.is_some());
    let (a, b) = (samples(&held), samples(&streamed));
    assert_eq!(a.iter().map(|s| s.frame.sequence).collect::<Vec<_>>(), (0..12).collect::<Vec<_>>());
    assert!(a.iter().filter(|s| s.tared[0].is_finite()).count() >= 8);
    // NaN is not equal to itself.
    assert_eq!(format!("{a:?}"), format!("{b:?}"));
    assert_eq!(held.hash(), streamed.hash());

    let id = |sample: usize| SampleId { run: 0, sample };
    let some = streamed.gather(&[id(7), id(2), id(7), id(99)]).unwrap();
    assert_eq!(
        some.iter().map(|(id, s)| (id.sample, s.frame.sequence)).collect::<Vec<_>>(),
        [(7, 7), (2, 2), (7, 7)]
    );

    // A bag that is another one by now is not mixed with what was read before.
    std::fs::remove_dir_all(&path).unwrap();
    let mut writer = BagWriter::create(&path).unwrap();
    writer.write("/pad/taxels", &frame(0, 0, vec![1.0, 2.0]), BEGIN).unwrap();
    writer.finish().unwrap();
    let said = streamed.gather(&[id(7)]).unwrap_err().to_string().replace(&path.display().to_string(), "BAG");
    insta::assert_snapshot!(said, @"bag BAG has changed since it was first read: leave it alone until this command ends");
}

#[test]
fn images_meet_their_frames_in_whatever_order_they_were_recorded() {
    use dermis_skin::{Image, ImageGrid, PixelFormat};
    let skin = skin();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag");
    let mut writer = BagWriter::create(&path).unwrap();
    // Bright on the left, dark on the right, and brighter there by the number of the frame.
    let seen = |k: i64| Image::new(2, 1, PixelFormat::Mono8, vec![100, k as u8]).unwrap();
    for k in 0..40_i64 {
        let stamp = BEGIN + k * STEP;
        let mut frame = Frame::new(stamp, k as u64, vec![100.0 + k as f32, 50.0]);
        frame.image = Some(seen(k));
        let image = skin.image_message(&frame).unwrap();
        // Frame 7 has no image beside it, and one of its stamp is another skin's.
        let topic = if k == 7 { "/other/image" } else { "/pad/image" };
        let later = if k % 2 == 0 { -STEP / 4 } else { 3 * STEP };
        writer.write(topic, &image, stamp + later).unwrap();
        writer.write("/pad/taxels", &skin.frame_message(&frame), stamp).unwrap();
        let contacts = if k < 20 { vec![] } else { vec![(0.0, 1.0)] };
        writer.write("/pad/ground_truth", &truth(k * STEP, 0, &contacts), stamp).unwrap();
    }
    writer.finish().unwrap();
    let grid = ImageGrid { planes: 1, rows: 1, columns: 2 };
    for memory in [0, MEMORY] {
        let options = DatasetOptions { memory, ..DatasetOptions::default() };
        let data = Dataset::from_bags(&[&path], &skin, &options).unwrap();
        let all: Vec<Sample> = data.stream_images(0, Some(grid)).unwrap().collect::<Result<_, _>>().unwrap();
        assert_eq!(all.len(), 40);
        for (k, sample) in all.iter().enumerate() {
            assert_eq!(sample.frame.values[0], 100.0 + k as f32);
            let image = (k != 7).then(|| seen(k as i64));
            assert_eq!(sample.frame.image, image, "frame {k}");
            let dark = sample.image[1];
            assert!(
                if k == 7 { dark.is_nan() } else { (dark - k as f32 / 255.0).abs() < 1e-6 },
                "frame {k}: {dark}"
            );
        }
        // The zero of the image is from the untouched frames, and rests while something touches.
        let [left, right] = [all[39].image_tared[0], all[39].image_tared[1]];
        assert!(left.abs() < 1e-6 && right > 20.0 / 255.0, "{left} {right}");
        assert_eq!(all[39].numbers(Baseline::Tared, true), [left, right]);
        let without: Vec<Sample> = data.stream(0).unwrap().collect::<Result<_, _>>().unwrap();
        assert!(without.iter().all(|s| s.frame.image.is_none() && s.image.is_empty()));
        let refused = data.stream_images(0, Some(ImageGrid { columns: 3, ..grid })).unwrap().next().unwrap();
        let said = refused.unwrap_err().to_string();
        let wanted = format!(
            "bag {}: an image of 2 x 1 pixels and 1 colours does not divide into 3 x 1 blocks of 1 colours (columns x rows); \
             choose a size that divides it (`features.image`)",
            path.display()
        );
        assert_eq!(said, wanted);
    }
}
