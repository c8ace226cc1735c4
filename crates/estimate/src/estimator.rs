//! Frame → contacts in one struct, the same in the node and in offline evaluation.

mod background;
mod finding;
mod maps;
mod quality;
#[cfg(test)]
mod tests;

use dermis_inference::Baseline;
use dermis_inversion::{Reading, Solution};
use dermis_skin::{
    Condition, Estimate, EstimateError, Estimator, Frame, SkinDescription, Surface, TareState,
};

use crate::condition::{Conditioned, Conditioner, TareRefusal};
use crate::contacts::{TaxelShares, Tracker};
use crate::finder::Before;
use crate::models::{Models, Pipeline, SetupError, maps};
use background::BackgroundSearch;
use dermis_sensor::{ElementFault, FrameCheck};

/// Whether the estimate can be relied on; the order is from best to worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Quality {
    /// Yes: no contacts means "not touched".
    Ok,
    /// With less certainty: channels are missing or out of range.
    Degraded,
    /// Not yet: no zero, no model, or the model fails.
    #[default]
    Uncalibrated,
    /// No: most readings are invalid.
    Fault,
}

/// Maps over the surface that are requested. What nobody asks for is not computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Maps {
    /// Forces.
    pub force: bool,
    /// Displacements.
    pub displacement: bool,
}

impl Maps {
    /// All that there are.
    pub const ALL: Self = Self { force: true, displacement: true };
    /// None.
    pub const NONE: Self = Self { force: false, displacement: false };
}

/// What is known about the latest frame besides its contacts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Verdict {
    /// Whether the estimate can be relied on.
    pub quality: Quality,
    /// One sentence, empty when all is well.
    pub text: String,
    /// Root mean square of the signal in units of the channels' noise; NaN before the first tare.
    pub level: f64,
    /// Whether something touches the skin, by level or by the model.
    pub touched: bool,
    /// Model's probability of a contact, where it gives one.
    pub probability: Option<f64>,
}

/// Frame → contacts of a skin whose channels are read together.
///
/// Presence, position and force come from learned models, one contact at a time; a bundle whose manifest has `peaks` or `force_peaks`
/// gives a map whose peaks are the contacts. One whose manifest has `inversion` has its answer refined on the skin's forward
/// model (corrected, where it has a `correction`), which may tell several contacts apart: one after the other or, where it says so,
/// among all pairs of locations when contacts come and go, and from those of the frame before while they last. A frame goes through
/// [`Conditioner`], the models' features, the models, [`Inverter`] and [`Tracker`]; nothing but the frames and the loaded
/// bundles goes in, so that a recording gives the same contacts offline as it gave in the node; but for contacts that are
/// [searched in the background](SkinEstimator::search_in_background).
pub struct SkinEstimator {
    skin: SkinDescription,
    surface: Surface,
    conditioner: Conditioner,
    pipelines: Vec<Pipeline>,
    shares: TaxelShares,
    tracker: Tracker,
    cleaned: Conditioned,
    verdict: Verdict,
    /// Pressing force \[N\] below which contacts are not reported.
    least_force: f64,
    probable: bool,
    /// A forward model explains the latest signal by a contact.
    explained: bool,
    /// Something touched at the latest frame that was estimated.
    present: bool,
    /// What a forward model that searches in pairs found in the latest frame, where it was called.
    solution: Option<Solution>,
    before: Before,
    /// Searches on a forward model that frames do not wait for; `None` where they do.
    background: Option<BackgroundSearch>,
    /// The latest signal, as an inverter takes it.
    readings: Vec<Reading>,
    /// What a forward model makes of the channels that have no reading out of those that have one; empty where none is
    /// missing, or no model knows.
    guessed: Vec<f64>,
    maps: Maps,
    no_model: String,
    /// Looks for faults that no channel shows by itself.
    check: Option<Box<dyn FrameCheck>>,
    /// What it found at the latest frame.
    faults: Vec<ElementFault>,
}

impl SkinEstimator {
    /// An estimator without a model: it conditions frames and finds nothing until
    /// [`set_models`](Self::set_models). `masked` names channels that are to be left out.
    ///
    /// # Errors
    ///
    /// [`SetupError::Condition`] names a channel that does not exist.
    pub fn new(skin: &SkinDescription, masked: &[String]) -> Result<Self, SetupError> {
        Ok(Self {
            surface: skin.surface(),
            conditioner: Conditioner::new(skin, masked)?,
            pipelines: Vec::new(),
            shares: TaxelShares::new(skin),
            tracker: Tracker::new(skin),
            cleaned: Conditioned::default(),
            verdict: Verdict { level: f64::NAN, ..Verdict::default() },
            least_force: 0.0,
            probable: false,
            explained: false,
            present: false,
            solution: None,
            before: Before::default(),
            background: None,
            readings: Vec::new(),
            guessed: Vec::new(),
            maps: Maps::ALL,
            no_model: "no model is loaded, so that contacts are unknown; train one with `dermis train` and name its \
                       folder in `models`"
                .into(),
            check: None,
            faults: Vec::new(),
            skin: skin.clone(),
        })
    }

    /// Has frames inspected for faults that no channel shows by itself, from the next one on.
    pub fn set_check(&mut self, check: Option<Box<dyn FrameCheck>>) {
        self.check = check;
        self.faults.clear();
    }

    /// Parts of the device that were out of order at the latest frame; `None` where nobody looks for them.
    #[must_use]
    pub fn element_faults(&self) -> Option<&[ElementFault]> {
        self.check.as_ref().map(|_| self.faults.as_slice())
    }

    /// Uses these models from the next frame on.
    pub fn set_models(&mut self, models: Models) {
        self.pipelines = models.0;
        self.follow_models();
    }

    /// Uses these models in place of those that give any of the same outputs; the others stay.
    pub fn replace_models(&mut self, models: Models) {
        // What stood in for a bundle is no longer needed.
        self.pipelines.retain(|old| old.model.is_some());
        self.pipelines
            .retain(|old| !models.0.iter().any(|new| old.names().any(|n| new.names().any(|m| m == n))));
        self.pipelines.extend(models.0);
        self.follow_models();
    }

    /// Forgets what other models said, and has the images made that these take.
    fn follow_models(&mut self) {
        let grid = self.pipelines.iter().find_map(|p| p.features.config().image);
        self.conditioner.set_image(grid);
        self.forget_contacts();
        self.probable = false;
    }

    fn forget_contacts(&mut self) {
        self.before = Before::default();
        if let Some(background) = &mut self.background {
            background.forget();
        }
    }

    /// Whether searches for contacts on a forward model run on a thread of their own, so that frames do not wait for them: until one ends, frames
    /// are answered by the contacts of the frame before, moved to where they explain the readings best. Single contacts are searched so where
    /// frames come faster than 200 a second. For live devices. What a frame says then depends on how fast the machine is; it does not at first.
    pub fn search_in_background(&mut self, on: bool) {
        self.background = on.then(BackgroundSearch::default);
    }

    /// Has the verdict say why there is no model, for as long as there is none.
    pub fn explain_missing_model(&mut self, sentence: String) {
        self.no_model = sentence;
    }

    /// What is known about the latest frame besides its contacts.
    #[must_use]
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// The latest frame after conditioning.
    #[must_use]
    pub fn conditioned(&self) -> &Conditioned {
        &self.cleaned
    }

    /// Where the tare stands.
    #[must_use]
    pub fn tare_state(&self) -> TareState {
        self.conditioner.tare_state()
    }

    /// Zero of every channel in the unit of the skin; `None` before the first tare.
    #[must_use]
    pub fn zero(&self) -> Option<&[f64]> {
        self.conditioner.zero()
    }

    /// Starts a tare; see [`Conditioner::begin_tare`].
    ///
    /// # Errors
    ///
    /// [`TareRefusal`]; the zero stays as it was.
    pub fn begin_tare(&mut self, even_if_touched: bool) -> Result<(), TareRefusal> {
        self.conditioner.begin_tare(even_if_touched)
    }

    /// Gives up a tare that has not ended.
    pub fn cancel_tare(&mut self) {
        self.conditioner.cancel_tare();
    }

    /// Takes a zero from elsewhere; see [`Conditioner::set_zero`].
    pub fn set_zero(&mut self, zero: &[f64]) {
        self.conditioner.set_zero(zero);
    }

    /// Thresholds and times in use.
    #[must_use]
    pub fn condition(&self) -> &Condition {
        self.conditioner.condition()
    }

    /// Uses other thresholds and times from the next frame on.
    pub fn set_condition(&mut self, condition: Condition) {
        self.conditioner.set_condition(condition);
    }

    /// \[N\] pressing force below which contacts are not reported; 0 reports whatever stands out of the noise.
    pub fn set_least_force(&mut self, newton: f64) {
        if newton.is_finite() && newton >= 0.0 {
            self.least_force = newton;
        }
    }

    /// \[N\] lightest contact that is reported: the configured force, or where none is configured the model's own error
    /// for light contacts, below which a force is not distinguished from nothing. NaN where no model gives a force.
    #[must_use]
    pub fn force_threshold(&self) -> f64 {
        let sigma = ["force.normal", "force.z"]
            .iter()
            .find_map(|name| self.pipelines.iter().find_map(|p| p.outputs.sigma(name, 0.0)))
            .or_else(|| self.pipelines.iter().find_map(|p| p.peaks.as_ref()?.force_sigma()));
        if self.least_force > 0.0 { self.least_force } else { sigma.unwrap_or(f64::NAN) }
    }

    /// \[N\] largest normal force that the model was trained on; NaN where unknown.
    #[must_use]
    pub fn force_max(&self) -> f64 {
        self.force_range().map_or(f64::NAN, |[_, most]| most)
    }

    fn force_range(&self) -> Option<[f64; 2]> {
        let gives_force = |p: &&Pipeline| {
            p.model.is_none() || p.peaks.is_some() || p.names().any(|n| n.starts_with("force."))
        };
        self.pipelines.iter().find(gives_force).and_then(|p| p.force_range)
    }

    /// Without a zero neither the signal is known nor, unless a model says so, whether something touches.
    fn needs_zero(&self) -> bool {
        self.pipelines.iter().any(|p| p.baseline == Baseline::Tared)
            || !self.outputs().any(|n| n == "contact")
    }

    /// Names of everything that the loaded models give.
    pub fn outputs(&self) -> impl Iterator<Item = &str> {
        self.pipelines.iter().flat_map(Pipeline::names)
    }

    /// Whether contacts come with a force.
    #[must_use]
    pub fn gives_force(&self) -> bool {
        self.outputs().any(|o| o.starts_with("force."))
            || self.pipelines.iter().any(|p| p.peaks.is_some() || p.inverter.is_some())
    }

    /// A light force \[N\], and the share of the surface where a press of it cannot be detected, by the forward model that refines;
    /// `None` where none does. There, nothing is reported although something may touch.
    #[must_use]
    pub fn undetectable_fraction(&self) -> Option<(f64, f64)> {
        self.pipelines.iter().find_map(|p| p.undetectable_fraction)
    }

    /// Maps that can be had with the loaded models.
    #[must_use]
    pub fn maps(&self) -> Maps {
        maps(&self.pipelines)
    }

    /// Computes only these maps from the next frame on; all of them at first.
    pub fn want_maps(&mut self, maps: Maps) {
        self.maps = maps;
    }

    /// Loaded models: name and folder.
    pub fn models(&self) -> impl Iterator<Item = (&str, &std::path::Path)> {
        self.pipelines.iter().map(|p| (p.name.as_str(), p.path.as_path()))
    }
}

impl SkinEstimator {
    /// Takes a frame that nobody waits for, because a newer one is there: channel health, zero and the models' history go on as
    /// with every frame, contacts are not looked for.
    ///
    /// # Errors
    ///
    /// [`EstimateError::Channels`] for a frame of another skin.
    pub fn pass(&mut self, frame: &Frame) -> Result<(), EstimateError> {
        let quality = self.receive(frame)?;
        self.guessed.clear();
        let pushed = if quality <= Quality::Degraded { self.push() } else { Ok(()) };
        self.verdict.touched |= self.present;
        self.conditioner.follow(&self.cleaned, self.present);
        pushed.map_err(|reason| EstimateError::Model { sequence: frame.sequence, reason })
    }

    /// Conditions a frame and judges it.
    fn receive(&mut self, frame: &Frame) -> Result<Quality, EstimateError> {
        let expected = self.skin.channels().len();
        if frame.values.len() != expected {
            return Err(EstimateError::Channels {
                sequence: frame.sequence,
                found: frame.values.len(),
                expected,
            });
        }
        if let Some(check) = &mut self.check {
            self.faults.clear();
            check.check(frame, &mut self.faults);
            self.conditioner.set_broken(self.faults.iter().flat_map(|fault| fault.channels.iter().copied()));
        }
        let mut cleaned = std::mem::take(&mut self.cleaned);
        let seen = self.conditioner.clean(frame, &mut cleaned);
        self.cleaned = cleaned;
        if self.conditioner.zero_replaced() {
            for pipeline in self.pipelines.iter_mut().filter(|p| p.baseline == Baseline::Tared) {
                pipeline.features.reset();
            }
        }
        let (quality, text) = self.evaluate();
        self.verdict = Verdict {
            quality,
            text,
            level: self.cleaned.level,
            touched: self.cleaned.touched,
            probability: None,
        };
        if let Err(error) = seen {
            self.verdict.quality = Quality::Uncalibrated;
            self.verdict.text = error.to_string();
            return Err(EstimateError::Model { sequence: frame.sequence, reason: self.verdict.text.clone() });
        }
        Ok(quality)
    }
}

impl Estimator for SkinEstimator {
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate, EstimateError> {
        let quality = self.receive(frame)?;
        self.solution = None;
        self.read();
        let inferred = if quality <= Quality::Degraded {
            self.guess().map_err(|e| e.to_string()).and_then(|()| self.infer())
        } else {
            Ok((false, true))
        };
        self.present = matches!(inferred, Ok((true, _)));
        if !self.present {
            self.forget_contacts();
        }
        let (present, complete) = match inferred {
            Ok(answer) => answer,
            Err(reason) => {
                self.conditioner.follow(&self.cleaned, false);
                self.verdict.quality = Quality::Uncalibrated;
                self.verdict.text.clone_from(&reason);
                return Err(EstimateError::Model { sequence: frame.sequence, reason });
            }
        };
        self.verdict.touched |= present;
        self.conditioner.follow(&self.cleaned, present);
        if quality > Quality::Degraded {
            return Ok(Estimate::default());
        }
        if present && !complete {
            self.verdict.quality = Quality::Uncalibrated;
            self.verdict.text = "touched, but the model's history of readings is not filled yet".into();
            return Ok(Estimate::default());
        }
        if !present {
            return Ok(self.untouched());
        }
        let (mut contacts, refined) =
            self.contacts().map_err(|reason| EstimateError::Model { sequence: frame.sequence, reason })?;
        // A force that is not known is not too light.
        contacts.retain(|contact| {
            let pressing = contact.normal_force();
            pressing.is_nan() || pressing >= self.least_force
        });
        self.tracker.assign(&mut contacts, frame.stamp);
        Ok(Estimate {
            force_map: self.maps.force.then(|| self.force_map(&contacts, refined.is_some())).flatten(),
            displacement_map: self
                .maps
                .displacement
                .then(|| self.displacement_map(&contacts, refined))
                .flatten(),
            contacts,
        })
    }

    fn tare(&mut self) {
        // Refused only where a check is requested.
        let _ = self.conditioner.begin_tare(true);
    }

    fn reset(&mut self) {
        self.conditioner.reset();
        for pipeline in &mut self.pipelines {
            pipeline.features.reset();
            pipeline.fresh = false;
        }
        self.tracker.reset();
        self.cleaned = Conditioned::default();
        self.verdict = Verdict { level: f64::NAN, ..Verdict::default() };
        self.probable = false;
        self.explained = false;
        self.present = false;
        self.solution = None;
        self.forget_contacts();
        self.faults.clear();
        self.conditioner.set_broken([]);
        if let Some(check) = &mut self.check {
            check.reset();
        }
    }
}
