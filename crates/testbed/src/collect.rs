//! A plan carried out on a modelled skin becomes a labelled bag.

mod resume;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_bag::{BagQos, BagWriter};
use dermis_model::{ForwardModel, Stimulus};
use dermis_msgs::msg::{Indentation, SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::Image;
use dermis_msgs::{Message, TypeSupport};
use dermis_skin::{Frame, SkinDescription, Stamp, Surface};
use indicatif::ProgressBar;
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::{GroundTruth, Plan, Sampler, TestbedError, Timeline};
use resume::Begun;

/// How a plan is carried out and labelled.
#[derive(Debug, Clone)]
pub struct CollectOptions {
    /// Seed of everything random; the plan's own where absent.
    pub seed: Option<u64>,
    /// Stamp of the first frame [ns since the Unix epoch]; now where absent. With a seed and a start the bag's
    /// messages are the same every time.
    pub start: Option<Stamp>,
    /// \[N\] standard deviation of the ground truth's force along each axis; the plan's own where absent.
    pub force_noise: Option<f64>,
    /// \[m\] standard deviation of the ground truth's position along each axis, one draw a press; the plan's own where absent.
    pub stage_noise: Option<f64>,
    /// Writes the pictures of a skin that a camera reads besides the numbers that are made of them.
    pub images: bool,
    /// Goes on with a bag that an earlier call began and did not end, whatever ended it. The finished bag is the same, message
    /// for message, as one that was never interrupted. Where there is none, it is begun; where it is finished, nothing is done.
    pub resume: bool,
    /// Set it from anywhere (a signal handler, another thread) to end early: the bag holds what was collected
    /// up to then and is finished properly.
    pub stop: Arc<AtomicBool>,
    /// Shows frames done and to do; hidden by default.
    pub progress: ProgressBar,
}

impl Default for CollectOptions {
    fn default() -> Self {
        Self {
            seed: None,
            start: None,
            force_noise: None,
            stage_noise: None,
            images: true,
            resume: false,
            stop: Arc::default(),
            progress: ProgressBar::hidden(),
        }
    }
}

/// What was collected.
#[derive(Debug, Clone, PartialEq)]
pub struct CollectReport {
    /// The bag.
    pub path: PathBuf,
    /// Frames in it, each with its ground truth.
    pub frames: u64,
    /// Of these, frames that were there already.
    pub resumed: u64,
    /// Presses that were begun.
    pub presses: u64,
    /// \[s\] of recorded time.
    pub duration: f64,
    /// Seed that was used.
    pub seed: u64,
    /// Whether it was stopped before the plan's end.
    pub interrupted: bool,
}

/// Frames between two looks at the stop flag and the progress bar.
const STRIDE: u64 = 64;
/// Custom data of a bag that was stopped before its plan's end.
const INTERRUPTED: &str = "interrupted";

/// Carries out `plan` on the modelled skin and writes the labelled bag `dir`: topics `taxels`, `ground_truth`,
/// `skin_geometry` and, where the skin is read by a camera and [pictures](CollectOptions::images) are requested, `image`. As fast as the model answers, not in real time.
///
/// # Errors
///
/// [`TestbedError`] where the plan does not fit the skin, the model has no answer, the bag cannot be written, or one that was
/// begun holds something else than is collected now. A bag that was begun is finished with what was collected before the error.
pub fn collect(
    model: &Arc<dyn ForwardModel>,
    skin: &SkinDescription,
    plan: &Plan,
    dir: impl AsRef<Path>,
    options: &CollectOptions,
) -> Result<CollectReport, TestbedError> {
    let dir = dir.as_ref();
    let seed = options.seed.unwrap_or(plan.seed);
    let timeline = Timeline::new(plan, model, seed)?;
    let mut sampler = Sampler::new(model.as_ref(), skin, seed ^ 0x5eed_0001)?;
    let mut truth = Truth::new(plan, options, seed);
    let session = format!("{}/{seed}", plan.name);
    let total = (timeline.duration() * skin.rate).ceil() as u64;
    let mut report = CollectReport {
        path: dir.to_path_buf(),
        frames: 0,
        resumed: 0,
        presses: 0,
        duration: 0.0,
        seed,
        interrupted: false,
    };
    let json = |value: Result<String, serde_json::Error>| value.unwrap_or_default();
    let custom = [
        ("plan", plan.name.clone()),
        ("plan_json", json(serde_json::to_string(plan))),
        ("seed", seed.to_string()),
        ("skin_hash", skin.hash()),
        ("effects", json(serde_json::to_string(&skin.effects))),
        ("force_noise", truth.force_noise.to_string()),
        ("stage_noise", truth.stage_noise.to_string()),
    ];

    let is_type = |hash: &str| skin.is_type(hash, skin.type_name());
    let begun = if options.resume { resume::find(dir, &custom, is_type)? } else { resume::Found::Nothing };
    let begun = match begun {
        resume::Found::Nothing => None,
        resume::Found::Begun(begun) => Some(*begun),
        resume::Found::Finished => {
            (report.frames, report.resumed, report.presses) = (total, total, timeline.presses());
            report.duration = total as f64 / skin.rate;
            return Ok(report);
        }
    };
    let start = options.start.or(begun.as_ref().map(Begun::start)).unwrap_or_else(dermis_transport::now_ns);
    report.resumed = begun.as_ref().map_or(0, Begun::frames);

    let mut writer = BagWriter::create(dir)?;
    for (key, value) in custom {
        writer.set_custom(key, value);
    }
    writer.add_topic("skin_geometry", TypeSupport::of::<SkinGeometry>(), BagQos::latched())?;
    writer.add_topic("taxels", TypeSupport::of::<TaxelFrame>(), BagQos::sensor_data())?;
    writer.add_topic("ground_truth", TypeSupport::of::<Indentation>(), BagQos::sensor_data())?;
    let untouched = model.capture(&Stimulus::default(), &mut || 0.0);
    let pictured = untouched.map_err(|source| TestbedError::Model { press: 0, source })?.is_some();
    if pictured && options.images {
        writer.add_topic("image", TypeSupport::of::<Image>(), BagQos::sensor_data())?;
    }
    let mut out = Output { writer, begun };
    options.progress.set_length(total);
    let mut frame = Frame::default();
    let mut one = |index: u64, out: &mut Output| -> Result<u64, TestbedError> {
        let t = index as f64 / skin.rate;
        let mut moment = timeline.at(t);
        sampler
            .sample(t, &mut moment.stimulus, &mut frame)
            .map_err(|source| TestbedError::Model { press: moment.press, source })?;
        frame.stamp = start + (t * 1e9).round() as Stamp;
        frame.sequence = index;
        // A device clock of 0 would mean that there is none.
        frame.device_time_us = 1 + (t * 1e6).round() as u64;
        frame.temperature = moment.stimulus.temperature as f32;
        out.write("taxels", &skin.frame_message(&frame), frame.stamp)?;
        if let Some(image) = skin.image_message(&frame).filter(|_| options.images) {
            out.write("image", &image, frame.stamp)?;
        }
        truth.blur(&mut moment, model.surface());
        let label = moment.message(skin, model.surface(), &session, frame.stamp);
        out.write("ground_truth", &label, frame.stamp)?;
        Ok(moment.press)
    };
    let mut failed = out
        .write("skin_geometry", &skin.geometry_message(model.surface(), start), start)
        // What the start was is on the disk from here on.
        .and_then(|()| Ok(out.writer.flush()?))
        .err();
    for index in 0..total {
        if failed.is_some() {
            break;
        }
        if index % STRIDE == 0 {
            options.progress.set_position(index);
            if options.stop.load(Ordering::Relaxed) {
                report.interrupted = true;
                break;
            }
        }
        match one(index, &mut out) {
            Ok(press) => {
                report.presses = press;
                report.frames = index + 1;
            }
            Err(error) => failed = Some(error),
        }
    }
    if report.interrupted || failed.is_some() {
        out.writer.set_custom(INTERRUPTED, "true");
    }
    report.frames = report.frames.max(out.finish()?);
    report.duration = report.frames as f64 / skin.rate;
    options.progress.set_position(report.frames);
    options.progress.finish();
    failed.map_or(Ok(report), Err)
}

/// The bag that is written, and the one that was begun before.
struct Output {
    writer: BagWriter,
    begun: Option<Begun>,
}

impl Output {
    fn write<T: Message>(&mut self, topic: &str, message: &T, stamp: Stamp) -> Result<(), TestbedError> {
        let cdr = message.to_cdr();
        if let Some(begun) = &mut self.begun {
            begun.expect(topic, &cdr, stamp)?;
        }
        Ok(self.writer.write_cdr(topic, TypeSupport::of::<T>(), &cdr, stamp)?)
    }

    /// Finishes the bag. Where it does not hold yet what was begun before, that takes its place again; its frames, otherwise 0.
    fn finish(mut self) -> Result<u64, TestbedError> {
        let passed = self.begun.as_mut().is_none_or(Begun::is_passed);
        if let Some(begun) = self.begun.take_if(|_| !passed) {
            drop(self.writer);
            return begun.put_back();
        }
        self.writer.finish()?;
        self.begun.map_or(Ok(()), Begun::discard)?;
        Ok(0)
    }
}

/// What stage and force sensor know of a moment.
struct Truth {
    rng: ChaCha8Rng,
    /// For the force along the surface.
    along: ChaCha8Rng,
    force_noise: f64,
    stage_noise: f64,
    press: Option<u64>,
    offset: Vector3<f64>,
}

impl Truth {
    fn new(plan: &Plan, options: &CollectOptions, seed: u64) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_0002);
        let mut along = rng.clone();
        along.set_stream(1);
        Self {
            rng,
            along,
            force_noise: options.force_noise.unwrap_or(plan.force_noise),
            stage_noise: options.stage_noise.unwrap_or(plan.stage_noise),
            press: None,
            offset: Vector3::zeros(),
        }
    }

    fn blur(&mut self, moment: &mut GroundTruth, surface: &Surface) {
        if self.press != Some(moment.press) {
            self.press = Some(moment.press);
            self.offset =
                Vector3::from_fn(|_, _| self.stage_noise * self.rng.sample::<f64, _>(StandardNormal));
        }
        let depths = moment.depths.iter_mut();
        for (contact, depth) in moment.stimulus.contacts.iter_mut().zip(depths) {
            let (_, normal) = surface.project(&contact.position);
            let across = self.offset.dot(&normal);
            contact.position = surface.project(&(contact.position + self.offset - normal * across)).0;
            *depth = depth.map(|depth| depth - across);
            let noise: f64 = self.rng.sample(StandardNormal);
            let along = Vector3::from_fn(|_, _| self.along.sample::<f64, _>(StandardNormal));
            let noise = along - normal * (along.dot(&normal) + noise);
            contact.force += noise * self.force_noise;
        }
    }
}

#[cfg(test)]
mod tests {
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
                forces += [
                    found.force.x - real.force.x,
                    found.force.y - real.force.y,
                    found.force.z - real.force.z,
                ]
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
        let bytes =
            |bag| BagReader::open(bag).unwrap().messages().map(|m| m.unwrap().data).collect::<Vec<_>>();
        assert!(bytes(&bag) == bytes(&again), "the same plan and seed made another bag");
    }

    #[test]
    fn a_reading_beyond_the_range_is_cut_and_flagged() {
        let skin = testing::skin(100.0);
        let model = shared_bumps(&skin);
        let mut sampler = Sampler::new(model.as_ref(), &skin, 1).unwrap();
        let contact = dermis_model::Indentation::sphere(
            nalgebra::Point3::origin(),
            Vector3::new(0.0, 0.0, -2.0),
            0.004,
        );
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
            let stopping: Arc<dyn ForwardModel> = Arc::new(Interrupted {
                inner: bumps(&skin),
                left: left.into(),
                stop: Arc::clone(&options.stop),
            });
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
        let mut names: Vec<_> =
            std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
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
        for (i, cut) in [0, 5, 60, 2000, file.len() / 2, file.len() - 100, file.len()].into_iter().enumerate()
        {
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
}
