//! What the nominal model, and variations of it, would have read in a recording.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use dermis_model::{ForwardModel, Untouched, common_effect, device};
use dermis_skin::{Effect, EffectInfo, SkinDescription};
use indicatif::ProgressBar;

use crate::GapError;
use crate::design;
use crate::effects;
use crate::recording::{Recording, Zero};
use crate::samples::Samples;
use crate::zero_level::ZeroLevel;

/// What a device would have read along a recording.
type Simulated = Result<Vec<f32>, GapError>;

/// Makes a family's forward model of a skin description; a sentence where it cannot be.
pub type Make<'a> = &'a (dyn Fn(&SkinDescription) -> Result<Arc<dyn ForwardModel>, String> + Sync);

/// A skin's simulator, and what its family says of effects.
#[derive(Clone, Copy)]
pub struct Simulator<'a> {
    /// The skin by design; effects that its description switches on belong to the design.
    pub skin: &'a SkinDescription,
    /// Effects that the family knows.
    pub effects: &'static [EffectInfo],
    /// Makes the family's model.
    pub make: Make<'a>,
}

/// What a family's model says, as an error of either kind.
enum Refused {
    Model(String),
}

impl From<dermis_skin::ModelError> for Refused {
    fn from(error: dermis_skin::ModelError) -> Self {
        Self::Model(error.to_string())
    }
}

impl Simulator<'_> {
    /// The skin by design with `effects` on top. One that is named after a number of the description (`medium.thickness`) makes that
    /// number its parameter `value`.
    #[must_use]
    pub fn with(&self, effects: &[Effect]) -> SkinDescription {
        let mut skin = self.skin.clone();
        for effect in effects {
            let number = effect.parameters.get(design::VALUE);
            if !number.is_some_and(|to| design::put(&mut skin, &effect.name, *to)) {
                Effect::merge(&mut skin.effects, [effect.clone()]);
            }
        }
        skin
    }

    /// The model of a skin, common effects included.
    ///
    /// # Errors
    ///
    /// [`GapError::Make`] with what the family says.
    pub fn model(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, GapError> {
        let made = device(skin, |inner| (self.make)(inner).map_err(Refused::Model));
        made.map_err(|Refused::Model(reason)| GapError::Make { what: describe(skin, self.skin), reason })
    }

    /// Whether effects of a skin make what it reads depend on what happened before.
    fn remembers(&self, skin: &SkinDescription) -> bool {
        skin.effects.iter().filter(|e| e.strength > 0.0).any(|e| self.is_stateful(&e.name))
    }

    /// Whether what an effect does depends on what happened before.
    pub(crate) fn is_stateful(&self, effect: &str) -> bool {
        self.effects.iter().find(|info| info.name == effect).is_some_and(|info| info.stateful)
            || common_effect(effect).is_some_and(|c| c.stateful)
    }

    /// The model of `skin` without effects that only shift channels: those stay visible in a tared recording, as what its zero missed.
    /// `model` is the skin's, and the same where it has none.
    fn unshifted(
        &self,
        skin: &SkinDescription,
        model: &Arc<dyn ForwardModel>,
    ) -> Result<Arc<dyn ForwardModel>, GapError> {
        let shifts = |name: &str| effects::of(name).shifts_channels;
        if !skin.effects.iter().any(|e| shifts(&e.name)) {
            return Ok(Arc::clone(model));
        }
        let mut other = skin.clone();
        other.effects.retain(|e| !shifts(&e.name));
        self.model(&other)
    }

    fn untouched(&self, model: &Arc<dyn ForwardModel>) -> Result<Untouched, GapError> {
        let what = || format!("skin `{}`, untouched", self.skin.name);
        Untouched::of(model.as_ref()).map_err(|source| GapError::Model { what: what(), source })
    }

    /// Whether untouched readings are subtracted from simulated ones: the recording was tared, and the design reads something of its
    /// own where nothing touches. What effects alone add to a design that reads 0 stays, as what the zero of the recording missed.
    fn subtracts(&self, recording: &Recording) -> Result<bool, GapError> {
        if recording.zero == Zero::AsRead {
            return Ok(false);
        }
        let plain = self.unshifted(self.skin, &self.model(self.skin)?)?;
        Ok(!self.untouched(&plain)?.is_zero())
    }

    /// What the design reads untouched, and what of it simulated readings of this recording hold.
    pub(crate) fn zero_level(&self, recording: &Recording) -> Result<ZeroLevel, GapError> {
        let model = self.model(self.skin)?;
        let unshifted = self.untouched(&self.unshifted(self.skin, &model)?)?;
        Ok(ZeroLevel::new(&self.untouched(&model)?, &unshifted, recording.zero != Zero::AsRead))
    }

    /// Noise-free readings of `skin` in the samples of a recording, a channel after another for each sample, in the unit of the skin:
    /// signals, where the recording was tared.
    ///
    /// # Errors
    ///
    /// [`GapError::Make`] and [`GapError::Model`] with what the model says.
    pub fn readings(
        &self,
        skin: &SkinDescription,
        recording: &Recording,
        frames: &[usize],
    ) -> Result<Vec<f32>, GapError> {
        self.simulate(skin, recording, frames, (true, self.subtracts(recording)?))
    }

    /// As [`readings`](Self::readings) of a device whose channels never end; what effects say of their ends holds.
    ///
    /// # Errors
    ///
    /// As [`readings`](Self::readings).
    pub fn unlimited(
        &self,
        skin: &SkinDescription,
        recording: &Recording,
        frames: &[usize],
    ) -> Result<Vec<f32>, GapError> {
        self.simulate(skin, recording, frames, (false, self.subtracts(recording)?))
    }

    /// Steps a device through the frames of a recording; `limited` says whether channels end, `subtracts` whether its untouched
    /// readings are subtracted.
    fn simulate(
        &self,
        skin: &SkinDescription,
        recording: &Recording,
        frames: &[usize],
        (limited, subtracts): (bool, bool),
    ) -> Result<Vec<f32>, GapError> {
        let model = self.model(skin)?;
        let channels = model.channels();
        if channels != recording.channels {
            return Err(GapError::Recording {
                place: recording.name.clone(),
                reason: format!(
                    "has {} channels where the model of skin `{}` has {channels}",
                    recording.channels, skin.name
                ),
            });
        }
        let ranges: Vec<Option<[f64; 2]>> = skin.channels().iter().map(|c| c.range).collect();
        let mut out = Vec::with_capacity(frames.len() * channels);
        let mut read = vec![0.0; channels];
        let whole = model.remembers() || self.remembers(skin);
        let tare = || self.tare((skin, &model), recording, frames, whole);
        let mut tare = subtracts.then(tare).transpose()?;
        let mut state = model.start(0);
        let mut run = None;
        let mut wanted = frames.iter().copied().peekable();
        let resting = tare.iter().flat_map(|tare| tare.part_of.keys());
        let asked: BTreeSet<usize> = frames.iter().chain(resting).copied().collect();
        let last = asked.last().map_or(0, |last| last + 1);
        let all: Box<dyn Iterator<Item = usize>> =
            if whole { Box::new(0..last) } else { Box::new(asked.into_iter()) };
        for frame in all {
            let label = &recording.labels[frame];
            if run != Some(label.run) {
                state = model.start(0);
                run = Some(label.run);
            }
            let Some(stimulus) = &label.stimulus else {
                // Nothing is known of it, and no row asks for it.
                continue;
            };
            let mut real = stimulus.clone();
            state.apply_to_stimulus(label.time, &mut real);
            state.step(label.time, &real, &mut read).map_err(|source| GapError::Model {
                what: format!("{}, frame {frame}", recording.name),
                source,
            })?;
            if let Some(tare) = &mut tare {
                tare.add(frame, &read);
            }
            if wanted.peek() != Some(&frame) {
                continue;
            }
            wanted.next();
            state.quantize(&mut read);
            for (channel, value) in read.iter().enumerate() {
                let value = *value as f32;
                let range = ranges.get(channel).copied().flatten().filter(|_| limited);
                out.push(range.map_or(value, |[low, high]| value.clamp(low as f32, high as f32)));
            }
        }
        if let Some(tare) = &tare {
            tare.subtract(recording, frames, &mut out);
        }
        Ok(out)
    }

    /// What the zeros of these frames will be measured from: all of the frames that they were, or one of each where what is read does not
    /// depend on what happened before (`whole`).
    fn tare(
        &self,
        (skin, model): (&SkinDescription, &Arc<dyn ForwardModel>),
        recording: &Recording,
        frames: &[usize],
        whole: bool,
    ) -> Result<Tare, GapError> {
        let plain = self.unshifted(skin, model)?;
        let rest = self.untouched(&plain)?.readings().to_vec();
        let shift = if Arc::ptr_eq(&plain, model) {
            vec![0.0; rest.len()]
        } else {
            self.untouched(model)?
                .readings()
                .iter()
                .zip(&rest)
                .map(|(shifted, rest)| shifted - rest)
                .collect()
        };
        let zeros: BTreeSet<u32> =
            frames.iter().filter_map(|frame| Some(recording.zeros.of(*frame)?.index)).collect();
        let mut part_of = BTreeMap::new();
        for zero in zeros {
            let all = recording.zeros.frames(zero);
            let read = if whole { all } else { all.get(all.len() / 2).map_or(&[][..], std::slice::from_ref) };
            part_of.extend(read.iter().map(|frame| (*frame, zero)));
        }
        Ok(Tare { part_of, sums: BTreeMap::new(), rest, shift })
    }

    /// Readings of several skins, on two threads; what cannot be made is an error of its own. `limited` says whether channels end.
    ///
    /// # Errors
    ///
    /// [`GapError::Interrupted`] where `stop` was set.
    pub fn many(
        &self,
        skins: &[SkinDescription],
        recording: &Recording,
        (samples, limited): (&Samples, bool),
        stop: &AtomicBool,
        progress: &ProgressBar,
    ) -> Result<Vec<Result<Vec<f32>, GapError>>, GapError> {
        let frames = samples.frames();
        let how = (limited, self.subtracts(recording)?);
        let next = AtomicUsize::new(0);
        let done: Vec<Mutex<Option<Simulated>>> = skins.iter().map(|_| Mutex::new(None)).collect();
        std::thread::scope(|scope| {
            for _ in 0..2.min(skins.len()) {
                scope.spawn(|| {
                    loop {
                        let i = next.fetch_add(1, Ordering::Relaxed);
                        let Some(skin) = skins.get(i).filter(|_| !stop.load(Ordering::Relaxed)) else {
                            break;
                        };
                        let readings = self.simulate(skin, recording, &frames, how);
                        if let Ok(mut slot) = done[i].lock() {
                            *slot = Some(readings);
                        }
                        progress.inc(1);
                    }
                });
            }
        });
        let found: Option<Vec<_>> = done.into_iter().map(|slot| slot.into_inner().ok().flatten()).collect();
        found.ok_or(GapError::Interrupted)
    }
}

/// The zeros of a simulated device: it is tared in the frames in which the real one was, so that what changes with time or temperature is
/// subtracted as it was then.
struct Tare {
    /// Which zero an untouched frame is a part of.
    part_of: BTreeMap<usize, u32>,
    /// Sum of what was read in the frames of a zero, and their number.
    sums: BTreeMap<u32, (Vec<f64>, f64)>,
    /// What is read untouched, where a zero has no frames.
    rest: Vec<f64>,
    /// What channels are shifted by, which stays visible.
    shift: Vec<f64>,
}

impl Tare {
    /// Counts what is read in a frame.
    fn add(&mut self, frame: usize, read: &[f64]) {
        let Some(zero) = self.part_of.get(&frame) else { return };
        let (sum, count) = self.sums.entry(*zero).or_insert_with(|| (vec![0.0; read.len()], 0.0));
        sum.iter_mut().zip(read).for_each(|(s, r)| *s += r);
        *count += 1.0;
    }

    /// Subtracts from the readings of these frames, `out`, what each counts from.
    fn subtract(&self, recording: &Recording, frames: &[usize], out: &mut [f32]) {
        for (frame, row) in frames.iter().zip(out.chunks_exact_mut(self.rest.len().max(1))) {
            let sums = recording.zeros.of(*frame).and_then(|zero| self.sums.get(&zero.index));
            for (k, value) in row.iter_mut().enumerate() {
                let level = sums.map_or(self.rest[k], |(sum, count)| sum[k] / count - self.shift[k]);
                *value = (f64::from(*value) - level) as f32;
            }
        }
    }
}

/// How a skin differs from its design, for errors.
fn describe(skin: &SkinDescription, nominal: &SkinDescription) -> String {
    let on: Vec<&str> =
        skin.effects.iter().filter(|e| !nominal.effects.contains(e)).map(|e| e.name.as_str()).collect();
    if on.is_empty() {
        format!("skin `{}`", skin.name)
    } else {
        format!("skin `{}` with {}", skin.name, on.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use dermis_fixtures::Analytic;
    use dermis_model::{Memory, Stimulus};

    use super::*;
    use crate::testing::{EFFECTS, gains, presses, skin, small};

    fn along(zero: Zero) -> Recording {
        let mut recording = Recording { zero, ..Recording::new("presses", 3) };
        presses().into_iter().for_each(|label| recording.push(label, &[]));
        recording
    }

    #[test]
    fn a_tared_recording_is_simulated_by_signals() {
        let skin = skin();
        let plain = |skin: &SkinDescription| small(skin, 0.0);
        let resting = |skin: &SkinDescription| small(skin, 700.0);
        let of = |make| Simulator { skin: &skin, effects: EFFECTS, make };
        let (plain, resting) = (of(&plain), of(&resting));
        let frames: Vec<usize> = (0..600).step_by(7).collect();
        let offset = Effect::new("channel-offset").with("b", 30.0);
        for effects in [Vec::new(), vec![gains()], vec![offset]] {
            let read =
                |of: &Simulator<'_>, zero| of.readings(&of.with(&effects), &along(zero), &frames).unwrap();
            // What channels are shifted by stays visible, as what the zero of the recording missed.
            for (a, b) in read(&plain, Zero::Press).iter().zip(read(&resting, Zero::Press)) {
                // Single precision of readings of 2,500 Pa.
                assert!((a - b).abs() < 1e-3, "{effects:?}: {a} {b}");
            }
            // A design that reads nothing untouched is simulated alike, bit for bit, whatever readings count from.
            assert_eq!(read(&plain, Zero::AsRead), read(&plain, Zero::Start));
        }
        // As recorded, untouched readings are readings.
        let read = resting.readings(&skin, &along(Zero::AsRead), &[0]).unwrap();
        assert_eq!(read, [700.0, 1400.0, 2100.0]);
    }

    #[test]
    fn a_simulated_device_is_tared_when_the_recording_was() {
        let skin = skin();
        let make = |skin: &SkinDescription| small(skin, 700.0);
        let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
        // It loses a tenth of its sensitivity in the 144 s of the recording, of what it reads untouched as well.
        let device = simulator.with(&[Effect::new("ageing").with("rate", 7e-4)]);
        let mut recording = along(Zero::AsRead);
        let frames: Vec<usize> = (0..recording.labels.len()).step_by(10).collect();
        let as_read = simulator.readings(&device, &recording, &frames).unwrap();
        for zero in [Zero::Start, Zero::Press] {
            recording.tare(zero);
            let read = simulator.readings(&device, &recording, &frames).unwrap();
            let mut plain = recording.clone();
            plain.zero = Zero::AsRead;
            for ((row, tared), frame) in as_read.chunks_exact(3).zip(read.chunks_exact(3)).zip(&frames) {
                let rests = recording.zeros.frames(recording.zeros.of(*frame).unwrap().index);
                let rests: Vec<usize> = rests.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
                let rest = simulator.readings(&device, &plain, &rests).unwrap();
                for k in 0..3 {
                    let level = rest.iter().skip(k).step_by(3).sum::<f32>() / rests.len() as f32;
                    assert!((row[k] - level - tared[k]).abs() < 0.01, "{zero:?}, frame {frame}, channel {k}");
                }
            }
        }
    }

    #[test]
    fn ends_of_channels_are_those_of_readings() {
        let mut skin = skin();
        let mut channels = skin.channels().to_vec();
        channels.iter_mut().for_each(|channel| channel.range = Some([0.0, 1000.0]));
        skin.set_channels(channels);
        let make = |skin: &SkinDescription| small(skin, 990.0);
        let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
        let recording = along(Zero::Start);
        let frames: Vec<usize> = (0..recording.labels.len()).collect();
        let read = simulator.readings(&skin, &recording, &frames).unwrap();
        // The first channel rests at 990 of 1000 Pa: no signal is more than 10.
        let most = read.iter().step_by(3).copied().fold(0.0f32, f32::max);
        assert!((most - 10.0).abs() < 1e-3, "{most}");
        let most = simulator.unlimited(&skin, &recording, &frames).unwrap();
        assert!(most.iter().step_by(3).any(|v| *v > 100.0));
    }

    /// Reads how many frames it has seen.
    struct Count(f64);

    impl Memory for Count {
        fn apply_transducer(&mut self, _: f64, _: &Stimulus, readings: &mut [f64]) {
            self.0 += 1.0;
            readings.fill(self.0);
        }
    }

    #[test]
    fn a_model_that_remembers_is_stepped_through_every_frame() {
        let skin = skin();
        let make = |skin: &SkinDescription| {
            let model = Analytic::of_skin(skin, |_, _| 0.0).that_remembers(|| Count(0.0));
            Ok(Arc::new(model) as Arc<dyn ForwardModel>)
        };
        let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
        let read = simulator.readings(&skin, &along(Zero::AsRead), &[3, 10]).unwrap();
        assert_eq!(read, [4.0, 4.0, 4.0, 11.0, 11.0, 11.0]);
    }
}
