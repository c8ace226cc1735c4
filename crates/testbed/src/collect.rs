//! A plan carried out on a modelled skin becomes a labelled bag.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_bag::{BagQos, BagWriter};
use dermis_msgs::TypeSupport;
use dermis_msgs::msg::{Indentation, SkinGeometry, TaxelFrame};
use dermis_skin::{ForwardModel, Frame, SkinDescription, Stamp};
use indicatif::ProgressBar;
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::{Moment, Plan, Sampler, TestbedError, Timeline};

/// How a plan is carried out and labelled.
#[derive(Debug, Clone)]
pub struct CollectOptions {
    /// Seed of everything random; the plan's own where absent.
    pub seed: Option<u64>,
    /// Stamp of the first frame [ns since the Unix epoch]; now where absent. With a seed and a start the bag's
    /// messages are the same every time.
    pub start: Option<Stamp>,
    /// \[N\] standard deviation of the ground truth's force: what a force cell of this class adds.
    pub force_noise: f64,
    /// \[m\] standard deviation of the ground truth's position along the surface, one draw a press: what a
    /// positioning stage of this class misses by.
    pub position_noise: f64,
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
            force_noise: 0.004,
            position_noise: 7.5e-6,
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

/// Carries out `plan` on the modelled skin and writes the labelled bag `dir`: topics `taxels`, `ground_truth`
/// and `skin_geometry`. As fast as the model answers, not in real time.
///
/// # Errors
///
/// [`TestbedError`] where the plan does not fit the skin, the model has no answer, or the bag cannot be written.
/// A bag that was begun is finished with what was collected before the error.
pub fn collect(
    model: &Arc<dyn ForwardModel>,
    skin: &SkinDescription,
    plan: &Plan,
    dir: impl AsRef<Path>,
    options: &CollectOptions,
) -> Result<CollectReport, TestbedError> {
    let seed = options.seed.unwrap_or(plan.seed);
    let timeline = Timeline::new(plan, model.surface(), seed)?;
    let mut sampler = Sampler::new(Arc::clone(model), skin, seed ^ 0x5eed_0001)?;
    let mut truth = Truth {
        rng: ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_0002),
        force_noise: options.force_noise,
        position_noise: options.position_noise,
        press: None,
        offset: Vector3::zeros(),
    };
    let start = options.start.unwrap_or_else(dermis_transport::now_ns);
    let session = format!("{}/{seed}", plan.name);

    let mut writer = BagWriter::create(dir.as_ref())?;
    writer.set_custom("plan", plan.name.clone());
    writer.set_custom("seed", seed.to_string());
    writer.set_custom("skin_hash", skin.hash());
    writer.add_topic("skin_geometry", TypeSupport::of::<SkinGeometry>(), BagQos::latched())?;
    writer.add_topic("taxels", TypeSupport::of::<TaxelFrame>(), BagQos::sensor_data())?;
    writer.add_topic("ground_truth", TypeSupport::of::<Indentation>(), BagQos::sensor_data())?;
    writer.write("skin_geometry", &skin.geometry_message(model.surface(), start), start)?;

    let total = (timeline.duration() * skin.rate).ceil() as u64;
    options.progress.set_length(total);
    let mut report = CollectReport {
        path: dir.as_ref().to_path_buf(),
        frames: 0,
        presses: 0,
        duration: 0.0,
        seed,
        interrupted: false,
    };
    let mut frame = Frame::default();
    let mut one = |index: u64, writer: &mut BagWriter| -> Result<u64, TestbedError> {
        let t = index as f64 / skin.rate;
        let mut moment = timeline.at(t);
        sampler
            .sample(&moment.stimulus, &mut frame.values, &mut frame.flags)
            .map_err(|source| TestbedError::Model { press: moment.press, source })?;
        frame.stamp = start + (t * 1e9).round() as Stamp;
        frame.sequence = index;
        // A device clock of 0 would mean that there is none.
        frame.device_time_us = 1 + (t * 1e6).round() as u64;
        frame.temperature = moment.stimulus.temperature as f32;
        writer.write("taxels", &skin.frame_message(&frame), frame.stamp)?;
        truth.blur(&mut moment, model.surface());
        let label = moment.message(skin, model.surface(), &session, frame.stamp);
        writer.write("ground_truth", &label, frame.stamp)?;
        Ok(moment.press)
    };
    let mut failed = None;
    for index in 0..total {
        if index % STRIDE == 0 {
            options.progress.set_position(index);
            if options.stop.load(Ordering::Relaxed) {
                report.interrupted = true;
                break;
            }
        }
        match one(index, &mut writer) {
            Ok(press) => report.presses = press,
            Err(error) => {
                failed = Some(error);
                break;
            }
        }
        report.frames = index + 1;
    }
    report.duration = report.frames as f64 / skin.rate;
    options.progress.set_position(report.frames);
    options.progress.finish();
    writer.finish()?;
    failed.map_or(Ok(report), Err)
}

/// What stage and force cell know of a moment.
struct Truth {
    rng: ChaCha8Rng,
    force_noise: f64,
    position_noise: f64,
    press: Option<u64>,
    offset: Vector3<f64>,
}

impl Truth {
    fn blur(&mut self, moment: &mut Moment, surface: &dermis_skin::Surface) {
        if self.press != Some(moment.press) {
            self.press = Some(moment.press);
            self.offset =
                Vector3::from_fn(|_, _| self.position_noise * self.rng.sample::<f64, _>(StandardNormal));
        }
        for contact in &mut moment.stimulus.contacts {
            let (_, normal) = surface.project(&contact.position);
            let tangential = self.offset - normal * self.offset.dot(&normal);
            contact.position = surface.project(&(contact.position + tangential)).0;
            let noise: f64 = self.rng.sample(StandardNormal);
            contact.force -= normal * (self.force_noise * noise);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{self, Bumps};
    use dermis_bag::BagReader;
    use dermis_skin::{ChannelFlags, ModelError, Stimulus, Surface};

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
        let model = Bumps::shared(&skin);
        let bag = dir.path().join("bag");
        let report = collect(&model, &skin, &testing::plan(), &bag, &options()).unwrap();
        assert!(!report.interrupted);
        let (frames, truth) = read(&bag);
        assert_eq!(frames.len() as u64, report.frames);
        assert_eq!(truth.len(), frames.len());

        let timeline = Timeline::new(&testing::plan(), model.surface(), 3).unwrap();
        assert_eq!(report.presses, timeline.presses());
        let (mut clean, mut squares, mut forces) = ([0.0; 3], 0.0, 0.0);
        let (mut readings, mut contacts) = (0.0, 0.0);
        for (i, (frame, label)) in frames.iter().zip(&truth).enumerate() {
            let stamp = START + i as i64 * 5_000_000;
            assert_eq!((frame.header.stamp.as_nanos(), label.header.stamp.as_nanos()), (stamp, stamp));
            assert_eq!(frame.sequence, i as u64);
            let moment = timeline.at(i as f64 / 200.0);
            assert_eq!(
                (label.press, label.location, label.phase),
                (moment.press, moment.location, moment.phase.code())
            );
            model.response(&moment.stimulus, &mut clean).unwrap();
            for (value, clean) in frame.values.iter().zip(clean) {
                squares += (f64::from(*value) - clean).powi(2);
                readings += 1.0;
            }
            assert_eq!(label.contacts.len(), moment.stimulus.contacts.len());
            for (found, real) in label.contacts.iter().zip(&moment.stimulus.contacts) {
                let off = (found.position.x - real.position.x).hypot(found.position.y - real.position.y);
                assert!(off < 6.0 * 7.5e-6, "stage is {off} m off");
                forces += (found.force.z - real.force.z).powi(2);
                contacts += 1.0;
                assert_eq!(found.diameter, 0.004);
            }
        }
        // Standard deviations are those that were asked for: 2 Pa and 4 mN, within their own statistics.
        approx::assert_relative_eq!(f64::sqrt(squares / readings), 2.0, max_relative = 0.1);
        approx::assert_relative_eq!(f64::sqrt(forces / contacts), 0.004, max_relative = 0.15);

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
        let mut sampler = Sampler::new(Bumps::shared(&skin), &skin, 1).unwrap();
        let contact = dermis_skin::Indentation {
            position: nalgebra::Point3::origin(),
            force: Vector3::new(0.0, 0.0, -2.0),
            diameter: 0.004,
        };
        let (mut values, mut flags) = (Vec::new(), Vec::new());
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        sampler.sample(&stimulus, &mut values, &mut flags).unwrap();
        assert_eq!((values[1], flags[1]), (900.0, ChannelFlags::SATURATED));
        assert_eq!(flags[0], ChannelFlags::OK);
    }

    /// Raises the stop flag in the middle of its work, as a signal handler does.
    struct Interrupted {
        inner: Bumps,
        left: std::sync::atomic::AtomicI64,
        stop: Arc<AtomicBool>,
    }

    impl ForwardModel for Interrupted {
        fn channels(&self) -> usize {
            self.inner.channels()
        }
        fn surface(&self) -> &Surface {
            self.inner.surface()
        }
        fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
            if self.left.fetch_sub(1, Ordering::Relaxed) == 0 {
                self.stop.store(true, Ordering::Relaxed);
            }
            self.inner.response(stimulus, out)
        }
        fn noise(&self) -> &[f64] {
            self.inner.noise()
        }
    }

    #[test]
    fn a_stopped_collection_is_a_whole_bag() {
        let dir = tempfile::tempdir().unwrap();
        let skin = testing::skin(200.0);
        let options = options();
        let model: Arc<dyn ForwardModel> = Arc::new(Interrupted {
            inner: Bumps::new(&skin),
            left: 300.into(),
            stop: Arc::clone(&options.stop),
        });
        let bag = dir.path().join("bag");
        let report = collect(&model, &skin, &testing::plan(), &bag, &options).unwrap();
        assert!(report.interrupted);
        assert!((300..300 + STRIDE + 1).contains(&report.frames), "{}", report.frames);
        let (frames, truth) = read(&bag);
        assert_eq!((frames.len() as u64, truth.len() as u64), (report.frames, report.frames));
    }

    #[test]
    fn a_model_without_an_answer_ends_the_collection_with_a_whole_bag() {
        let dir = tempfile::tempdir().unwrap();
        let skin = testing::skin(200.0);
        let mut bumps = Bumps::new(&skin);
        bumps.limit = 0.3;
        let model: Arc<dyn ForwardModel> = Arc::new(bumps);
        let bag = dir.path().join("bag");
        let error = collect(&model, &skin, &testing::plan(), &bag, &options()).unwrap_err().to_string();
        assert!(error.starts_with("press ") && error.ends_with("N are too much"), "{error}");
        assert!(!read(&bag).0.is_empty());
    }

    #[test]
    fn a_model_of_another_skin_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let skin = testing::skin(200.0);
        let mut bumps = Bumps::new(&skin);
        bumps.drop_channel();
        let model: Arc<dyn ForwardModel> = Arc::new(bumps);
        let error = collect(&model, &skin, &testing::plan(), dir.path().join("bag"), &options()).unwrap_err();
        insta::assert_snapshot!(error, @"the model has 2 channels where skin `pad` has 3: they describe different skins");
    }
}
