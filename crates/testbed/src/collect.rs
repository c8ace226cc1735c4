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
    let sampler = Sampler::new(model.as_ref(), skin, seed ^ 0x5eed_0001)?;
    let truth = Truth::new(plan, options, seed);
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
    let custom = custom_data(plan, skin, seed, &truth);
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

    let writer = begin(dir, custom, model.as_ref(), options)?;
    let mut out = Output { writer, begun };
    options.progress.set_length(total);
    let surface = model.surface();
    let frame = Frame::default();
    let mut recorder = Recorder { skin, surface, options, session, start, timeline, sampler, truth, frame };
    let written = out
        .write("skin_geometry", &skin.geometry_message(surface, start), start)
        // What the start was is on the disk from here on.
        .and_then(|()| Ok(out.writer.flush()?))
        .and_then(|()| recorder.write_all(total, &mut out, &mut report));
    if report.interrupted || written.is_err() {
        out.writer.set_custom(INTERRUPTED, "true");
    }
    report.frames = report.frames.max(out.finish()?);
    report.duration = report.frames as f64 / skin.rate;
    options.progress.set_position(report.frames);
    options.progress.finish();
    written.map(|()| report)
}

/// What the bag says of its making.
fn custom_data(plan: &Plan, skin: &SkinDescription, seed: u64, truth: &Truth) -> [(&'static str, String); 7] {
    let json = |value: Result<String, serde_json::Error>| value.unwrap_or_default();
    [
        ("plan", plan.name.clone()),
        ("plan_json", json(serde_json::to_string(plan))),
        ("seed", seed.to_string()),
        ("skin_hash", skin.hash()),
        ("effects", json(serde_json::to_string(&skin.effects))),
        ("force_noise", truth.force_noise.to_string()),
        ("stage_noise", truth.stage_noise.to_string()),
    ]
}

/// Begins the bag, with a topic for each kind of message.
fn begin(
    dir: &Path,
    custom: [(&'static str, String); 7],
    model: &dyn ForwardModel,
    options: &CollectOptions,
) -> Result<BagWriter, TestbedError> {
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
    Ok(writer)
}

/// Makes frames and their ground truth, one after the other.
struct Recorder<'a> {
    skin: &'a SkinDescription,
    surface: &'a Surface,
    options: &'a CollectOptions,
    session: String,
    start: Stamp,
    timeline: Timeline,
    sampler: Sampler<'a>,
    truth: Truth,
    frame: Frame,
}

impl Recorder<'_> {
    /// Writes all frames; how far it got is in `report`.
    fn write_all(
        &mut self,
        total: u64,
        out: &mut Output,
        report: &mut CollectReport,
    ) -> Result<(), TestbedError> {
        for index in 0..total {
            if index % STRIDE == 0 {
                self.options.progress.set_position(index);
                if self.options.stop.load(Ordering::Relaxed) {
                    report.interrupted = true;
                    break;
                }
            }
            report.presses = self.write(index, out)?;
            report.frames = index + 1;
        }
        Ok(())
    }

    /// Writes one frame; the number of its press.
    fn write(&mut self, index: u64, out: &mut Output) -> Result<u64, TestbedError> {
        let t = index as f64 / self.skin.rate;
        let mut moment = self.timeline.at(t);
        let frame = &mut self.frame;
        self.sampler
            .sample(t, &mut moment.stimulus, frame)
            .map_err(|source| TestbedError::Model { press: moment.press, source })?;
        frame.stamp = self.start + (t * 1e9).round() as Stamp;
        frame.sequence = index;
        // A device clock of 0 would mean that there is none.
        frame.device_time_us = 1 + (t * 1e6).round() as u64;
        frame.temperature = moment.stimulus.temperature as f32;
        out.write("taxels", &self.skin.frame_message(frame), frame.stamp)?;
        if let Some(image) = self.skin.image_message(frame).filter(|_| self.options.images) {
            out.write("image", &image, frame.stamp)?;
        }
        self.truth.blur(&mut moment, self.surface);
        let label = moment.message(self.skin, self.surface, &self.session, frame.stamp);
        out.write("ground_truth", &label, frame.stamp)?;
        Ok(moment.press)
    }
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
mod tests;
