//! From model outputs to contacts.

use std::sync::Arc;

use dermis_inference::{Baseline, Missing};
use dermis_inversion::{Inverter, InverterError, Reading, Solution};
use dermis_skin::Contact;

use super::Quality;
use super::SkinEstimator;
use super::background::Job;
use crate::finder::{
    Learned, Peaks, Regressed, follow, is_flat, peaks, provisional, readings, refined, regressed, solve,
};
use crate::models::Pipeline;

/// Presence by probability begins above the first and ends below the second.
const PRESENT: (f64, f64) = (0.5, 0.4);
/// \[Hz\] Frames that come no faster wait for the search of a single contact: a millisecond, and ten at times.
const FAST: f64 = 200.0;
/// What is said of frames that come before the first search of a touch has ended.
const GUESS: &str = "contacts are a first guess: the search for all of them has not ended yet";

impl SkinEstimator {
    pub(super) fn get(&self, output: &str) -> Option<f64> {
        self.pipelines.iter().filter(|p| p.fresh).find_map(|p| p.outputs.get(output))
    }

    pub(super) fn sigma(&self, output: &str, force: f64) -> f64 {
        let found = self.pipelines.iter().find_map(|p| p.outputs.sigma(output, force));
        found.unwrap_or(f64::NAN)
    }

    /// Hands the latest frame to the features of the models.
    pub(super) fn push(&mut self) -> Result<(), String> {
        let cleaned = &self.cleaned;
        for pipeline in &mut self.pipelines {
            pipeline.fresh = false;
            let config = pipeline.features.config();
            // A model that receives which channels are missing knows better what to make of it, and an image has no channels.
            let as_it_is =
                self.guessed.is_empty() || config.missing == Missing::Mask || config.image.is_some();
            if as_it_is {
                pipeline.take(&cleaned.frame()).map_err(|e| e.to_string())?;
                continue;
            }
            let (values, zero) = match pipeline.baseline {
                Baseline::Raw => (&cleaned.reading.values, self.conditioner.zero()),
                Baseline::Tared => (&cleaned.signal.values, None),
            };
            let whole: Vec<f32> = values
                .iter()
                .zip(&self.guessed)
                .enumerate()
                .map(|(i, (value, guessed))| match value.is_nan() {
                    true => (guessed + zero.map_or(0.0, |zero| zero[i])) as f32,
                    false => *value,
                })
                .collect();
            pipeline.features.push(cleaned.reading.stamp, &whole).map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    /// Runs what is needed of the models. Returns whether a contact is there and whether every model could answer.
    pub(super) fn infer(&mut self) -> Result<(bool, bool), String> {
        self.push()?;
        // A model that says whether there is a contact is called on every frame, the others only during contacts.
        let mut probability = None;
        for pipeline in &mut self.pipelines {
            if pipeline.names().any(|n| n == "contact") && pipeline.infer()? {
                probability = pipeline.outputs.contact();
            }
        }
        self.verdict.probability = probability;
        if let Some(p) = probability {
            self.probable = p > if self.probable { PRESENT.1 } else { PRESENT.0 };
        }
        let present =
            if probability.is_some() { self.probable } else { self.cleaned.touched || self.explains() };
        let mut complete = true;
        for pipeline in &mut self.pipelines {
            if present && !pipeline.fresh {
                complete &= pipeline.infer()?;
            }
        }
        Ok((present, complete))
    }

    /// Whether a forward model explains the signal by a contact, light ones included that the level does not show.
    pub(super) fn explains(&mut self) -> bool {
        let Some(inverter) = self.pipelines.iter().find_map(|p| p.inverter.as_ref()) else { return false };
        self.explained =
            inverter.settings().exceeds_threshold(inverter.evidence(&self.readings), self.explained);
        self.explained
    }

    /// Takes the signal of the latest frame for an inverter.
    pub(super) fn read(&mut self) {
        if self.pipelines.iter().all(|p| p.inverter.is_none()) {
            return;
        }
        let signal = &self.cleaned.signal;
        self.readings.clear();
        self.readings.extend(readings(&signal.values, &signal.flags));
    }

    /// Guesses what channels without a reading would read, from the contacts that a forward model finds in the others.
    pub(super) fn guess(&mut self) -> Result<(), InverterError> {
        self.guessed.clear();
        let Some(inverter) = self.pipelines.iter().find_map(|p| p.inverter.as_ref()) else { return Ok(()) };
        if !self.readings.contains(&Reading::Missing) || !self.conditioner.is_tared() {
            return Ok(());
        }
        self.guessed.resize(self.readings.len(), 0.0);
        // Whatever it leaves: channels that drift are not those that are missing.
        let shows = self.cleaned.touched
            || inverter.settings().exceeds_threshold((inverter.evidence(&self.readings).0, 0.0), true);
        if shows {
            let inverter = Arc::clone(inverter);
            let solution = self.solved(&inverter, Learned::default())?;
            let found = inverter.settings().indentations(&solution.contacts);
            inverter.signal(&found, &mut self.guessed)?;
            // Called once a frame: what it costs is the frame's time.
            self.solution = (inverter.settings().follows()).then_some(solution);
        }
        Ok(())
    }

    /// Whether contacts are read off a map whose peaks a forward model can be begun at.
    fn complete(&self) -> bool {
        self.pipelines.iter().any(|p| p.fresh && p.peaks.as_ref().is_some_and(Peaks::are_starts))
    }

    /// Contacts as the learned models give them: the peaks of a map or, without any, one from position and force.
    pub(super) fn learned(&mut self) -> Result<Vec<Contact>, String> {
        if self.pipelines.iter().all(|p| p.model.is_none()) {
            return Ok(Vec::new());
        }
        let refined = self.pipelines.iter().any(|p| p.inverter.is_some());
        let reads = |p: &&mut Pipeline| p.fresh && p.reads_peaks(refined);
        let Some(pipeline) = self.pipelines.iter_mut().find(reads) else {
            return Ok(vec![self.contact()]);
        };
        let mut contacts = peaks(pipeline)?;
        let single = contacts.len() == 1;
        for contact in &mut contacts {
            contact.confidence = self.confidence(contact.normal_force()) as f32;
            contact.taxels = if single { self.carrying() } else { self.shares.near(&contact.position) };
            if self.channels_missing() {
                contact.position_covariance.fill(f64::NAN);
                contact.force_covariance.fill(f64::NAN);
            }
        }
        Ok(contacts)
    }

    /// Taxels that carry the signal.
    pub(super) fn carrying(&mut self) -> Vec<u32> {
        self.shares.of(&self.cleaned.signal, self.conditioner.condition().contact_threshold)
    }

    /// What the learned models say, refined on the forward model where a bundle asks for it, and which bundle did.
    pub(super) fn contacts(&mut self) -> Result<(Vec<Contact>, Option<usize>), String> {
        let learned = self.learned()?;
        let Some((index, inverter)) =
            self.pipelines.iter().enumerate().find_map(|(i, p)| Some((i, p.inverter.as_ref()?)))
        else {
            return Ok((learned, None));
        };
        let inverter = Arc::clone(inverter);
        let solution = match self.solution.take() {
            // Found when it predicted what the missing channels would read.
            Some(solution) => Ok(solution),
            None => {
                let learned = Learned { contacts: &learned, complete: self.complete() };
                self.solved(&inverter, learned)
            }
        };
        let solution =
            solution.map_err(|e| format!("model {}: {e}", self.pipelines[index].path.display()))?;
        let (mut contacts, refined) = refined(&inverter, &solution.contacts, learned);
        if !refined {
            return Ok((contacts, None));
        }
        let single = contacts.len() == 1;
        let carrying = self.carrying();
        for contact in &mut contacts {
            contact.confidence = self.confidence(contact.normal_force()) as f32;
            contact.taxels = if single { carrying.clone() } else { self.shares.near(&contact.position) };
        }
        Ok((contacts, Some(index)))
    }

    /// The contacts that explain the latest frame. Where searches run in the background, it is answered without waiting for one.
    fn solved(&mut self, inverter: &Arc<Inverter>, learned: Learned<'_>) -> Result<Solution, InverterError> {
        let single = inverter.settings().is_single() && self.skin.rate > FAST;
        let follows = single || inverter.settings().follows();
        let stamp = self.cleaned.reading.stamp;
        let Some(background) = self.background.as_mut().filter(|_| follows) else {
            return solve(inverter, &self.readings, learned, &mut self.before, stamp);
        };
        if let Some(found) = background.found() {
            self.before.search(inverter, &found?, stamp);
        }
        let mut followed = None;
        if single || !background.is_searching() {
            followed = follow(inverter, &self.readings, learned, &mut self.before)?;
        }
        let anew = followed.is_none() || self.before.may_have_changed(inverter, stamp);
        if !background.is_searching() && anew {
            let job = Job::of(inverter, &self.readings, learned, self.before.likeliest());
            if let Err(job) = background.begin(job) {
                let found = job.search()?;
                self.before.search(inverter, &found, stamp);
                return Ok(found);
            }
        }
        if let Some(solution) = followed {
            return Ok(solution);
        }
        if background.guesses() && self.verdict.quality == Quality::Ok {
            self.verdict.quality = Quality::Degraded;
            self.verdict.text = GUESS.to_owned();
        }
        let solution = provisional(inverter, &self.readings, learned, &self.before)?;
        self.before.follow(inverter, &solution);
        Ok(solution)
    }

    pub(super) fn contact(&mut self) -> Contact {
        let Regressed { mut contact, magnitude } = regressed(
            |name| self.get(name),
            |name, force| self.sigma(name, force),
            &self.surface,
            is_flat(&self.skin),
        );
        if self.channels_missing() {
            // The errors of a model were measured with every channel there.
            contact.position_covariance.fill(f64::NAN);
            contact.force_covariance.fill(f64::NAN);
        }
        contact.taxels = self.carrying();
        contact.confidence = self.confidence(magnitude) as f32;
        contact
    }

    pub(super) fn channels_missing(&self) -> bool {
        self.cleaned.reading.values.iter().any(|v| v.is_nan())
    }

    /// 0 to 1: how surely this is a contact, less for channels that are missing and for a force that the model has
    /// never seen.
    pub(super) fn confidence(&self, pressing: f64) -> f64 {
        let present = self.verdict.probability.unwrap_or_else(|| {
            // One half at the threshold, and towards one as the signal rises above it.
            let ratio = self.cleaned.level / self.conditioner.condition().contact_threshold;
            1.0 - 0.5 * (1.0 - ratio).exp()
        });
        let reading = &self.cleaned.reading;
        let healthy = reading.healthy_channels() as f64 / reading.values.len().max(1) as f64;
        let familiar = match self.force_range() {
            Some([_, most]) if pressing > most && most > 0.0 => most / pressing,
            _ => 1.0,
        };
        (present * healthy * familiar).clamp(0.0, 1.0)
    }
}
