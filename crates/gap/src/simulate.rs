//! What the nominal model, and variations of it, would have read in a recording.

use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use dermis_model::{ForwardModel, common_effect, device};
use dermis_skin::{Effect, EffectInfo, SkinDescription};
use indicatif::ProgressBar;

use crate::GapError;
use crate::recording::Recording;
use crate::samples::Samples;

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
    /// The skin by design with `effects` on top.
    #[must_use]
    pub fn with(&self, effects: &[Effect]) -> SkinDescription {
        let mut skin = self.skin.clone();
        Effect::merge(&mut skin.effects, effects.iter().cloned());
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

    /// Whether what a skin reads depends on what happened before.
    fn remembers(&self, skin: &SkinDescription) -> bool {
        skin.effects.iter().filter(|e| e.strength > 0.0).any(|e| {
            self.effects.iter().find(|info| info.name == e.name).is_some_and(|info| info.stateful)
                || common_effect(&e.name).is_some_and(|c| c.stateful)
        })
    }

    /// Noise-free readings of `skin` in the samples of a recording, a channel after another for each sample, in the unit of the skin.
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
        let mut out = self.unlimited(skin, recording, frames)?;
        let ranges: Vec<Option<[f64; 2]>> = skin.channels().iter().map(|c| c.range).collect();
        for row in out.chunks_exact_mut(ranges.len().max(1)) {
            for (v, range) in row.iter_mut().zip(&ranges) {
                if let Some([low, high]) = range {
                    *v = v.clamp(*low as f32, *high as f32);
                }
            }
        }
        Ok(out)
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
        let mut out = Vec::with_capacity(frames.len() * channels);
        let mut read = vec![0.0; channels];
        let whole = self.remembers(skin);
        let mut state = model.start(0);
        let mut run = None;
        let mut wanted = frames.iter().copied().peekable();
        let last = frames.last().map_or(0, |l| l + 1);
        let all: Box<dyn Iterator<Item = usize>> =
            if whole { Box::new(0..last) } else { Box::new(frames.iter().copied()) };
        for frame in all {
            let moment = &recording.moments[frame];
            if run != Some(moment.run) {
                state = model.start(0);
                run = Some(moment.run);
            }
            let Some(stimulus) = &moment.stimulus else {
                // Nothing is known of it, and no row asks for it.
                continue;
            };
            let mut real = stimulus.clone();
            state.apply_to_stimulus(moment.time, &mut real);
            state.step(moment.time, &real, &mut read).map_err(|source| GapError::Model {
                what: format!("{}, frame {frame}", recording.name),
                source,
            })?;
            if wanted.peek() == Some(&frame) {
                wanted.next();
                state.quantize(&mut read);
                out.extend(read.iter().map(|v| *v as f32));
            }
        }
        Ok(out)
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
                        let readings = if limited {
                            self.readings(skin, recording, &frames)
                        } else {
                            self.unlimited(skin, recording, &frames)
                        };
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
