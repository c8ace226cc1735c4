use super::*;
use dermis_fixtures::Analytic;

use crate::testing::{self, bumps, shared_bumps};
use dermis_bag::BagReader;
use dermis_model::{DeviceState, ForwardModel, Stepped, Stimulus, Wrapper};
use dermis_skin::{ChannelFlags, ModelError};

const START: Stamp = 1_700_000_000_000_000_000;

fn options() -> CollectOptions {
    CollectOptions { start: Some(START), ..CollectOptions::default() }
}

fn read(bag: &Path) -> (Vec<TaxelFrame>, Vec<Indentation>) {
    let reader = BagReader::open(bag).unwrap();
    let frames = reader.read::<TaxelFrame>("taxels").unwrap().map(|m| m.unwrap().message).collect();
    let truth = reader.read::<Indentation>("ground_truth").unwrap().map(|m| m.unwrap().message).collect();
    (frames, truth)
}

#[test]
fn a_bag_holds_what_the_model_reads_and_what_was_done() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let model = shared_bumps(&skin);
    let bag = dir.path().join("bag");
    let report = collect(&model, &skin, &testing::plan(), &bag, &options()).unwrap();
    assert!(!report.interrupted);
    let (frames, truth) = read(&bag);
    assert_eq!(frames.len() as u64, report.frames);
    assert_eq!(truth.len(), frames.len());

    let timeline = Timeline::new(&testing::plan(), &model, 3).unwrap();
    let mut state = model.start(0);
    assert_eq!(report.presses, timeline.presses());
    let (mut clean, mut squares, mut forces) = ([0.0; 3], 0.0, 0.0);
    let (mut readings, mut contacts) = (0.0, 0.0);
    for (i, (frame, label)) in frames.iter().zip(&truth).enumerate() {
        let stamp = START + i as i64 * 5_000_000;
        assert_eq!((frame.header.stamp.as_nanos(), label.header.stamp.as_nanos()), (stamp, stamp));
        assert_eq!(frame.sequence, i as u64);
        let t = i as f64 / 200.0;
        let mut moment = timeline.at(t);
        assert_eq!(
            (label.press, label.location, label.phase),
            (moment.press, moment.location, moment.phase.code())
        );
        state.apply_to_stimulus(t, &mut moment.stimulus);
        state.step(t, &moment.stimulus, &mut clean).unwrap();
        for (value, clean) in frame.values.iter().zip(clean) {
            squares += (f64::from(*value) - clean).powi(2);
            readings += 1.0;
        }
        assert_eq!(label.contacts.len(), moment.stimulus.contacts.len());
        for (found, real) in label.contacts.iter().zip(&moment.stimulus.contacts) {
            let off = (found.position.x - real.position.x).hypot(found.position.y - real.position.y);
            assert!(off < 6.0 * 7.5e-6, "stage is {off} m off");
            forces +=
                [found.force.x - real.force.x, found.force.y - real.force.y, found.force.z - real.force.z]
                    .map(|off| off * off)
                    .iter()
                    .sum::<f64>();
            contacts += 3.0;
            assert_eq!(found.diameter, 0.004);
            let depth = -real.force.z / 500.0;
            assert!((found.depth - depth).abs() < 6.0 * 7.5e-6, "{} m for {depth} m", found.depth);
        }
    }
    // Standard deviations are those that were requested: 2 Pa and 4 mN, within their own statistics.
    approx::assert_relative_eq!(f64::sqrt(squares / readings), 2.0, max_relative = 0.1);
    approx::assert_relative_eq!(f64::sqrt(forces / contacts), 0.004, max_relative = 0.1);

    let reader = BagReader::open(&bag).unwrap();
    let geometry = reader.read_only_topic::<SkinGeometry>().unwrap().next().unwrap().unwrap().message;
    assert_eq!(geometry.skin_hash, skin.hash());

    let again = dir.path().join("again");
    collect(&model, &skin, &testing::plan(), &again, &options()).unwrap();
    // As bytes: an unknown depth is NaN, which equals nothing.
    let bytes = |bag| BagReader::open(bag).unwrap().messages().map(|m| m.unwrap().data).collect::<Vec<_>>();
    assert!(bytes(&bag) == bytes(&again), "the same plan and seed made another bag");
}

#[test]
fn a_reading_beyond_the_range_is_cut_and_flagged() {
    let skin = testing::skin(100.0);
    let model = shared_bumps(&skin);
    let mut sampler = Sampler::new(model.as_ref(), &skin, 1).unwrap();
    let contact =
        dermis_model::Indentation::sphere(nalgebra::Point3::origin(), Vector3::new(0.0, 0.0, -2.0), 0.004);
    let mut frame = Frame::default();
    let mut stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
    sampler.sample(0.0, &mut stimulus, &mut frame).unwrap();
    assert_eq!((frame.values[1], frame.flags[1]), (900.0, ChannelFlags::SATURATED));
    assert_eq!(frame.flags[0], ChannelFlags::OK);
}

/// Raises the stop flag in the middle of its work, as a signal handler does.
struct Interrupted {
    inner: Analytic,
    left: std::sync::atomic::AtomicI64,
    stop: Arc<AtomicBool>,
}

impl Wrapper for Interrupted {
    const CHANGES_RESPONSE: bool = true;

    fn inner(&self) -> &dyn ForwardModel {
        &self.inner
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        if self.left.fetch_sub(1, Ordering::Relaxed) == 0 {
            self.stop.store(true, Ordering::Relaxed);
        }
        self.inner.response(stimulus, out)
    }

    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, testing::Dragged::default()))
    }
}

#[test]
fn a_stopped_collection_is_a_whole_bag() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let options = options();
    let model: Arc<dyn ForwardModel> =
        Arc::new(Interrupted { inner: bumps(&skin), left: 300.into(), stop: Arc::clone(&options.stop) });
    let bag = dir.path().join("bag");
    let report = collect(&model, &skin, &testing::plan(), &bag, &options).unwrap();
    assert!(report.interrupted);
    assert!((300..300 + STRIDE + 1).contains(&report.frames), "{}", report.frames);
    let (frames, truth) = read(&bag);
    assert_eq!((frames.len() as u64, truth.len() as u64), (report.frames, report.frames));
}

/// All messages, as bytes.
fn bytes(bag: &Path) -> Vec<(String, i64, Vec<u8>)> {
    let reader = BagReader::open(bag).unwrap();
    reader.messages().map(|m| m.unwrap()).map(|m| (m.topic.to_string(), m.log_time, m.data)).collect()
}

#[test]
fn an_interrupted_collection_goes_on_to_the_same_bag() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let (whole, bag) = (dir.path().join("whole"), dir.path().join("bag"));
    let plan = testing::plan();
    let model = shared_bumps(&skin);
    let all = collect(&model, &skin, &plan, &whole, &options()).unwrap();

    // Stopped twice, the second time while it goes through what is there already; then again a little further.
    let mut frames = 0;
    for left in [300, 100, 700] {
        let options = CollectOptions { resume: true, ..options() };
        let stopping: Arc<dyn ForwardModel> =
            Arc::new(Interrupted { inner: bumps(&skin), left: left.into(), stop: Arc::clone(&options.stop) });
        let report = collect(&stopping, &skin, &plan, &bag, &options).unwrap();
        assert!(report.interrupted && report.resumed == frames && report.frames >= frames, "{report:?}");
        frames = report.frames;
        assert_eq!(read(&bag).0.len() as u64, frames);
    }
    let resume = CollectOptions { resume: true, ..CollectOptions::default() };
    let report = collect(&model, &skin, &plan, &bag, &resume).unwrap();
    assert_eq!(report, CollectReport { path: bag.clone(), resumed: frames, ..all.clone() });
    assert!(bytes(&bag) == bytes(&whole), "another bag");
    // What is finished stays as it is.
    let report = collect(&model, &skin, &plan, &bag, &resume).unwrap();
    assert_eq!(report, CollectReport { path: bag.clone(), resumed: all.frames, ..all });
    let mut names: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["bag", "whole"]);
}

#[test]
fn a_torn_bag_goes_on_to_the_same_bag_wherever_it_ends() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let (whole, bag) = (dir.path().join("whole"), dir.path().join("bag"));
    let model = shared_bumps(&skin);
    collect(&model, &skin, &testing::plan(), &whole, &options()).unwrap();
    let file = std::fs::read(whole.join("whole_0.mcap")).unwrap();
    // As what is left after power was lost: with and without what an earlier attempt to go on had set aside.
    for (i, cut) in [0, 5, 60, 2000, file.len() / 2, file.len() - 100, file.len()].into_iter().enumerate() {
        std::fs::remove_dir_all(&bag).ok();
        std::fs::create_dir(&bag).unwrap();
        std::fs::write(bag.join("bag_0.mcap"), &file[..cut]).unwrap();
        if i % 2 == 1 {
            let aside = dir.path().join("bag.interrupted");
            std::fs::create_dir(&aside).unwrap();
            std::fs::write(aside.join("bag_0.mcap"), &file[..file.len() / 3]).unwrap();
        }
        collect(&model, &skin, &testing::plan(), &bag, &CollectOptions { resume: true, ..options() })
            .unwrap();
        assert!(bytes(&bag) == bytes(&whole), "another bag after {cut} bytes");
        assert!(!dir.path().join("bag.interrupted").exists());
    }
}

#[test]
fn a_collection_goes_on_with_its_own_bag_only() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let (whole, bag) = (dir.path().join("whole"), dir.path().join("bag"));
    let model = shared_bumps(&skin);
    collect(&model, &skin, &testing::plan(), &whole, &options()).unwrap();
    let file = std::fs::read(whole.join("whole_0.mcap")).unwrap();
    std::fs::create_dir(&bag).unwrap();
    std::fs::write(bag.join("bag_0.mcap"), &file[..file.len() * 2 / 3]).unwrap();

    let resume = || CollectOptions { resume: true, ..CollectOptions::default() };
    let refused = |out: &Path, options: &CollectOptions| {
        let error = collect(&model, &skin, &testing::plan(), out, options).unwrap_err().to_string();
        error.replace(&*dir.path().display().to_string(), "")
    };
    insta::assert_snapshot!(refused(&bag, &CollectOptions { seed: Some(9), ..resume() }), @"bag /bag: cannot be gone on with: its message 2 on /taxels is another one than is collected now: it was begun with another plan, skin, effects, seed, noise or program; give the same, or another --out");
    insta::assert_snapshot!(refused(&bag, &CollectOptions { start: Some(START + 1), ..resume() }), @"bag /bag: cannot be gone on with: its message 1 on /skin_geometry is another one than is collected now: it was begun with another plan, skin, effects, seed, noise or program; give the same, or another --out");
    insta::assert_snapshot!(refused(&whole, &CollectOptions { seed: Some(9), ..resume() }), @"bag /whole: cannot be gone on with: its seed is 3, and now it is 9; give the same, or another --out");
    assert!(std::fs::read(bag.join("bag_0.mcap")).unwrap() == file[..file.len() * 2 / 3]);
    std::fs::write(bag.join("thesis.tex"), "").unwrap();
    insta::assert_snapshot!(refused(&bag, &resume()), @"bag /bag: cannot be gone on with: the folder also holds `thesis.tex`: it is no bag that was begun here");
    assert!(bag.join("thesis.tex").exists() && !dir.path().join("bag.interrupted").exists());
}

#[test]
fn a_model_without_an_answer_ends_the_collection_with_a_whole_bag() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let mut model = bumps(&skin);
    model.limit = 0.3;
    let model: Arc<dyn ForwardModel> = Arc::new(model);
    let bag = dir.path().join("bag");
    let error = collect(&model, &skin, &testing::plan(), &bag, &options()).unwrap_err().to_string();
    assert!(error.starts_with("press ") && error.ends_with("N are too much"), "{error}");
    assert!(!read(&bag).0.is_empty());
}

#[test]
fn a_model_of_another_skin_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let skin = testing::skin(200.0);
    let mut model = bumps(&skin);
    model.elements.pop();
    model.noise.pop();
    let model: Arc<dyn ForwardModel> = Arc::new(model);
    let error = collect(&model, &skin, &testing::plan(), dir.path().join("bag"), &options()).unwrap_err();
    insta::assert_snapshot!(error, @"the model has 2 channels where skin `pad` has 3: they describe different skins");
}
