//! How transfer, reconstruction and sensitivity network are trained, one after another.
//!
//! | stage | samples | loss |
//! |---|---|---|
//! | transfer | recorded single contacts, and what the simulation reads of the same contacts | squared error (thesis, eq. 3.1) |
//! | reconstruction | simulated scenes of one to four contacts at locations of their own | squared error (eq. 3.2) |
//! | sensitivity | peaks of reconstructed maps that lie near a recorded contact | squared error (eq. 3.3), of the force or its logarithm |
//!
//! Cost: the reconstruction takes nearly all of it, six operations a weight, sample and epoch.

use std::sync::Arc;

use dermis_inference::Runtime;
use dermis_inversion::PeakSettings;
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::Contact;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::sensitivity::{Peak, Sensitivity};
use super::{CONTACTS, Pipeline, PipelineSettings, Trained, Transfer, wrong};
use crate::LearnError;
use crate::real2sim::regressor::scale;
use crate::real2sim::{
    Compliance, LinearMap, MapBasis, MapRegressor, NetMap, Part, ProgressFn, Recorded, Scenes, Simulated,
    VirtualSensors, matched, simulate, superpose, tune,
};
use crate::train::{NetworkConfig, States, TrainingConfig};

/// \[m\] between a peak and the contact that it belongs to, at most.
const REACH: f64 = 0.015;
/// Maps whose shapes are the basis, of each number of contacts.
const BASIS_MAPS: usize = 1000;
/// Frames of each number of contacts whose peaks teach sensitivity and suppression.
const PEAK_FRAMES: usize = 2500;
/// What the state of a reconstruction is called that saw simulated scenes alone.
const RECONSTRUCTION: &str = "reconstruction";
/// Simulated scenes of each number of contacts that maps are judged on.
const JUDGED: usize = 500;

/// What a device reads, and what the simulation would read of the same contacts.
#[derive(Debug, Clone, PartialEq)]
pub struct Paired {
    /// Row-major \[n, channels\], in the unit of the skin.
    pub signals: Vec<f32>,
    /// Virtual sensors and maps.
    pub simulated: Simulated,
}

/// What all stages share.
#[derive(Clone, Copy)]
pub struct Stages<'a> {
    /// The skin as it was designed.
    pub model: &'a Arc<dyn ForwardModel>,
    /// What the transfer leads to.
    pub sensors: &'a VirtualSensors,
    /// What is simulated.
    pub scenes: &'a Scenes,
    /// How.
    pub settings: &'a PipelineSettings,
    /// Where the states of networks are kept.
    pub states: Option<&'a States>,
    /// Who watches.
    pub progress: ProgressFn<'a>,
}

impl Stages<'_> {
    /// All stages. `recorded` is learned from; `choose` (single contacts at other locations) is what errors of the transfer are
    /// measured on.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where the model knows no displacements, nothing was recorded, or a fit goes wrong.
    pub fn train(
        &self,
        (recorded, choose): (&[Recorded], &[Recorded]),
        runtime: &Runtime,
    ) -> Result<(Pipeline, Trained), LearnError> {
        self.check((recorded, choose))?;
        let basis = self.basis()?;
        let paired = self.paired(&self.presses(recorded, self.settings.superpose), &basis)?;
        let held = self.paired(&self.presses(choose, 1), &basis)?;
        let transfer = self.transfer(&paired, &held)?;
        let residuals = difference(&transfer.predict(&held.signals)?, &held.simulated.sensors);
        let transfer_error = f64::from(scale(&residuals) / scale(&held.simulated.sensors));
        let reconstruction = {
            let mut samples = self.simulated(&basis)?;
            if self.settings.residuals {
                // What the transfer leaves is what the reconstruction will see on top: errors of held-out contacts, in proportion
                // to the signal.
                let (width, seed) = (self.sensors.count(), self.scenes.settings().seed);
                perturb(&mut samples.sensors, width, &residuals, &held.simulated.sensors, seed);
            }
            if self.settings.superpose > 1 {
                let sensors = transfer.predict(&paired.signals)?;
                samples.extend(&Simulated { sensors, maps: paired.simulated.maps.clone() });
            }
            let own = self.settings.residuals || self.settings.superpose > 1;
            self.fit_reconstruction(if own { "reconstruction-of-device" } else { RECONSTRUCTION }, &samples)?
        };
        drop((paired, held));
        let map_rms = self.map_rms(&reconstruction, &basis)?;
        let mut pipeline = Pipeline {
            channels: self.model.channels(),
            transfer,
            reconstruction,
            basis,
            sensitivity: Sensitivity::unknown(),
            peaks: self.settings.peaks.clone(),
            weights: if self.settings.weighted {
                Compliance::of(self.model.as_ref(), self.scenes.settings().diameter)?.weights()
            } else {
                Vec::new()
            },
        };
        let peaks = self.sensitivity(&mut pipeline, recorded, runtime)?;
        let trained = Trained {
            sensors: self.sensors.describe(),
            virtual_sensors: self.sensors.count(),
            rank: pipeline.basis.rank(),
            kept: pipeline.basis.kept(),
            recorded: recorded.len(),
            transfer_error,
            map_rms,
            peaks,
            settings: pipeline.peaks.clone(),
        };
        Ok((pipeline, trained))
    }

    /// Says what is impossible.
    fn check(&self, (recorded, choose): (&[Recorded], &[Recorded])) -> Result<(), LearnError> {
        self.settings.validate("settings")?;
        if recorded.is_empty() || choose.is_empty() {
            return Err(wrong(
                "no single contact of known place, force and tip was recorded at some locations to learn from and at others to choose by",
            ));
        }
        if self.settings.superpose > 1 && !self.model.superposes() {
            return Err(wrong(
                "this skin's readings of several contacts do not add up, so that sums of recorded presses are none of it: set `superpose` to 1",
            ));
        }
        Ok(())
    }

    /// What maps are sums of.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the model knows no displacements.
    pub fn basis(&self) -> Result<MapBasis, LearnError> {
        let points = self.model.surface().points.len();
        if self.settings.whole_maps {
            return Ok(MapBasis::whole(points));
        }
        (self.progress)("shapes of maps", 0.0);
        let mut maps = Vec::new();
        for contacts in 1..=CONTACTS {
            let count = self.settings.samples[contacts - 1].min(BASIS_MAPS);
            let drawn = self.scenes.draw(Part::Train, contacts, count);
            maps.extend(simulate(self.model.as_ref(), self.sensors, &drawn, None, self.progress)?.maps);
        }
        Ok(MapBasis::measure(&maps, points, self.settings.kept, self.scenes.settings().seed))
    }

    /// Recorded single contacts, and sums of up to `most` of them.
    #[must_use]
    pub fn presses(&self, recorded: &[Recorded], most: usize) -> Vec<(Stimulus, Vec<f32>)> {
        let one = |r: &Recorded| {
            (Stimulus { contacts: vec![r.contact.clone()], ..Stimulus::default() }, r.signal.clone())
        };
        let mut all: Vec<_> = recorded.iter().map(one).collect();
        let scenes = self.scenes.settings();
        for contacts in 2..=most {
            let count = self.settings.sums;
            let model = self.model.as_ref();
            all.extend(superpose(model, recorded, contacts, count, scenes.distance, scenes.seed));
        }
        all
    }

    /// Signals, and what the simulation reads of what pressed.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the model has no answer.
    pub fn paired(&self, presses: &[(Stimulus, Vec<f32>)], basis: &MapBasis) -> Result<Paired, LearnError> {
        let stimuli: Vec<Stimulus> = presses.iter().map(|(s, _)| s.clone()).collect();
        let simulated = simulate(self.model.as_ref(), self.sensors, &stimuli, Some(basis), self.progress)?;
        Ok(Paired { signals: presses.iter().flat_map(|(_, signal)| signal).copied().collect(), simulated })
    }

    /// Fits the transfer. Where it is a matrix, `held` chooses its ridge.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where a fit goes wrong.
    pub fn transfer(&self, paired: &Paired, held: &Paired) -> Result<Transfer, LearnError> {
        let channels = self.model.channels();
        let sensors = &paired.simulated.sensors;
        if self.settings.linear_transfer {
            let validation = (held.signals.as_slice(), held.simulated.sensors.as_slice());
            let linear = LinearMap::fit(&paired.signals, sensors, channels, validation)?;
            return Ok(Transfer::Linear(linear, scale(&paired.signals)));
        }
        let how = (&self.settings.transfer, &self.settings.transfer_training);
        Ok(Transfer::Network(self.network("transfer", (&paired.signals, sensors), channels, how)?))
    }

    /// Simulated scenes of one to four contacts.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the model knows no displacements.
    pub fn simulated(&self, basis: &MapBasis) -> Result<Simulated, LearnError> {
        let mut all = Simulated::default();
        for contacts in 1..=CONTACTS {
            let drawn = self.scenes.draw(Part::Train, contacts, self.settings.samples[contacts - 1]);
            all.extend(&simulate(self.model.as_ref(), self.sensors, &drawn, Some(basis), self.progress)?);
        }
        Ok(all)
    }

    /// Fits the reconstruction to simulated scenes alone.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where the fit goes wrong.
    pub fn reconstruction(&self, samples: &Simulated) -> Result<NetMap, LearnError> {
        self.fit_reconstruction(RECONSTRUCTION, samples)
    }

    fn fit_reconstruction(&self, name: &str, samples: &Simulated) -> Result<NetMap, LearnError> {
        let how = (&self.settings.reconstruction, &self.settings.reconstruction_training);
        self.network(name, (&samples.sensors, &samples.maps), self.sensors.count(), how)
    }

    fn network(
        &self,
        name: &str,
        samples: (&[f32], &[f32]),
        width: usize,
        how: (&NetworkConfig, &TrainingConfig),
    ) -> Result<NetMap, LearnError> {
        let step = format!("{name} network");
        (self.progress)(&step, 0.0);
        // Other virtual sensors make other samples of the same number.
        let states = self.states.map(|states| states.of(&self.sensors.describe()));
        let keep = states.as_ref().map(|states| (states, name));
        NetMap::fit_kept(samples, width, how, keep, &mut |p| {
            (self.progress)(&step, f64::from(p.epoch) / f64::from(p.epochs));
        })
    }

    /// Root mean square \[m\] over whole maps of simulated contacts at held-out locations, by their number from 1 on.
    fn map_rms(&self, reconstruction: &NetMap, basis: &MapBasis) -> Result<Vec<f64>, LearnError> {
        (self.progress)("maps of held-out locations", 0.0);
        let points = self.model.surface().points.len();
        let of = |contacts: usize| {
            let drawn = self.scenes.draw(Part::Test, contacts, JUDGED);
            let truth = simulate(self.model.as_ref(), self.sensors, &drawn, None, self.progress)?;
            let maps = basis.decode(&reconstruction.predict(&truth.sensors)?);
            let mut scores = crate::MapScores::new();
            let both = truth.maps.chunks_exact(points).zip(maps.chunks_exact(points));
            both.for_each(|(t, a)| scores.push(t, a));
            Ok(scores.summary().rms)
        };
        (1..=CONTACTS).map(of).collect()
    }

    /// Fits the sensitivity to peaks of the pipeline's maps, and chooses which peaks are contacts; how many peaks there were.
    fn sensitivity(
        &self,
        pipeline: &mut Pipeline,
        recorded: &[Recorded],
        runtime: &Runtime,
    ) -> Result<usize, LearnError> {
        (self.progress)("sensitivity network", 0.0);
        let frames = self.peak_frames(recorded);
        let taught = |(stimulus, _): &&(Stimulus, Vec<f32>)| {
            stimulus.contacts.len() <= self.settings.sensitivity_contacts
        };
        let mut reader = pipeline.contacts(self.model.surface(), runtime)?;
        // Without a sensitivity, the force of a peak is its displacement.
        let mut peaks = Vec::new();
        for (stimulus, signal) in frames.iter().filter(taught) {
            let found = reader.candidates(&pipeline.map(signal)?)?;
            peaks.extend(of_known_force(stimulus, &found, self.model.as_ref()));
        }
        if peaks.is_empty() {
            return Err(wrong(
                "no peak of the reconstructed maps lies near a contact: record more locations",
            ));
        }
        let how = (&self.settings.sensitivity, &self.settings.sensitivity_training);
        let states = self.states.map(|states| states.of(&self.sensors.describe()));
        pipeline.sensitivity =
            Sensitivity::fit(&peaks, self.settings.sensitivity_output, how, states.as_ref())?;
        pipeline.peaks = self.suppression(pipeline, &frames, runtime)?;
        Ok(peaks.len())
    }

    /// Frames whose peaks are inspected: recorded singles, and sums of several, whatever the networks were trained on. The
    /// thesis' network sees singles only; the suppression needs several, and sums of recorded ones are at hand.
    fn peak_frames(&self, recorded: &[Recorded]) -> Vec<(Stimulus, Vec<f32>)> {
        let scenes = self.scenes.settings();
        let singles = self.presses(recorded, 1);
        let step = singles.len().div_ceil(PEAK_FRAMES).max(1);
        let mut frames: Vec<_> = singles.into_iter().step_by(step).collect();
        // Nearer than two radii of the search, peaks run into one another whatever is set.
        let apart = scenes.distance.max(2.0 * self.settings.peaks.radius);
        for contacts in 2..=CONTACTS {
            // Of few presses, no more sums than there is to learn of.
            let (model, count) = (self.model.as_ref(), (PEAK_FRAMES / contacts).min(4 * recorded.len()));
            frames.extend(superpose(model, recorded, contacts, count, apart, scenes.seed ^ 0x5eed));
        }
        frames
    }

    fn suppression(
        &self,
        pipeline: &Pipeline,
        frames: &[(Stimulus, Vec<f32>)],
        runtime: &Runtime,
    ) -> Result<PeakSettings, LearnError> {
        let mut reader = pipeline.contacts(self.model.surface(), runtime)?;
        let mut counted = Vec::with_capacity(frames.len());
        let mut least = f64::INFINITY;
        for (stimulus, signal) in frames {
            let found = reader.candidates(&pipeline.map(signal)?)?;
            counted.push((stimulus.contacts.len(), found.iter().map(Contact::normal_force).collect()));
            least = stimulus.contacts.iter().map(|c| c.force.norm()).fold(least, f64::min);
        }
        Ok(tune(&counted, least, &self.settings.peaks))
    }
}

/// Peaks that lie near a true contact, and its force.
fn of_known_force(stimulus: &Stimulus, found: &[Contact], model: &dyn ForwardModel) -> Vec<Peak> {
    let near = matched(&stimulus.contacts, found, REACH);
    let known = stimulus.contacts.iter().zip(near).filter_map(|(truth, index)| {
        let contact = &found[index?];
        let (p, force, displacement) = (contact.position, pressing(truth, model), contact.normal_force());
        (force > 0.0 && displacement > 0.0)
            .then_some(([p.x as f32, p.y as f32, p.z as f32, displacement as f32], force as f32))
    });
    known.collect()
}

fn pressing(contact: &Indentation, model: &dyn ForwardModel) -> f64 {
    -contact.force.dot(&model.surface().project(&contact.position).1)
}

fn difference(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Adds to each row of `sensors` the residual of a row that is drawn, times the ratio of their sizes.
fn perturb(sensors: &mut [f32], width: usize, residuals: &[f32], of: &[f32], seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let size = |row: &[f32]| row.iter().map(|v| v * v).sum::<f32>().sqrt();
    let count = of.len() / width.max(1);
    for row in sensors.chunks_exact_mut(width) {
        let i = rng.random_range(0..count);
        let drawn = i * width..(i + 1) * width;
        let ratio = size(row) / size(&of[drawn.clone()]).max(f32::MIN_POSITIVE);
        // A contact that hardly showed says nothing of how errors grow.
        let ratio = ratio.min(10.0);
        row.iter_mut().zip(&residuals[drawn]).for_each(|(v, r)| *v += ratio * r);
    }
}
