//! Frame → contacts: conditioning, inference, contact extraction and tracking in one struct, the same in the node and
//! in offline evaluation.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_inference::{
    Baseline, Bundle, BundleError, Features, MAP_DISPLACEMENT, MapContacts, Missing, Model, Outputs, Runtime,
};
use dermis_inversion::{Corrected, Found, Inverter, InverterError, Reading, Solution};
use dermis_model::{Indentation, Stimulus};
use dermis_skin::{
    ChannelFlags, Condition, Contact, DisplacementMap, Estimate, EstimateError, Estimator, ForceComponents,
    ForceMap, ForceValues, Frame, ModelError, SkinDescription, Surface, SurfaceSpec, TareState,
};
use nalgebra::{Matrix3, Point3, Vector3};

use crate::Sensor;
use crate::condition::{ConditionError, Conditioned, Conditioner, TareRefusal, listed};
use crate::contacts::{TaxelShares, Tracker};

/// Presence by probability begins above the first and ends below the second.
const PRESENT: (f64, f64) = (0.5, 0.4);
/// Output that gives the pressing force at every point of the surface \[N\].
const MAP_NORMAL: &str = "map.normal";
/// Output that gives x, y and z of the force at every point of the surface \[N\].
const MAP_FORCE: &str = "map.force";
/// Share of the largest force that a light press has.
const LIGHT: f64 = 0.1;
/// \[m\] about a contact of unknown diameter that its force is spread over.
const REACH: f64 = 0.005;

/// Why an estimator could not be made, or a model not be taken over.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SetupError {
    /// A bundle is missing, damaged or for another skin.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The configuration does not fit the skin.
    #[error(transparent)]
    Condition(#[from] ConditionError),
    /// Two bundles answer the same question.
    #[error("model bundles {first} and {second} both give `{output}`; load only one of them")]
    SameOutput {
        /// Name of the output.
        output: String,
        /// Bundle that came first.
        first: PathBuf,
        /// Bundle that came second.
        second: PathBuf,
    },
    /// A bundle that wants its answers refined on a forward model, which the skin has not.
    #[error("model bundle {path}: field `inversion`: {source}")]
    NoForwardModel {
        /// Folder of the bundle.
        path: PathBuf,
        /// Why there is none.
        source: ModelError,
    },
    /// A bundle whose correction is not one of this skin's forward model.
    #[error("model bundle {path}: field `correction`: {source}")]
    Correction {
        /// Folder of the bundle.
        path: PathBuf,
        /// What is wrong with it.
        source: InverterError,
    },
    /// A bundle whose answers cannot be refined as it says.
    #[error("model bundle {path}: field `inversion`: {source}")]
    Inversion {
        /// Folder of the bundle.
        path: PathBuf,
        /// What cannot be.
        source: InverterError,
    },
    /// A bundle whose outputs cannot be placed on this skin.
    #[error("model bundle {path}: output `{output}`: {reason}")]
    Output {
        /// Folder of the bundle.
        path: PathBuf,
        /// Name of the output.
        output: String,
        /// What is wrong with it.
        reason: String,
    },
}

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

/// Maps over the surface that are asked for. What nobody asks for is not computed.
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

/// One loaded bundle.
struct Pipeline {
    path: PathBuf,
    name: String,
    baseline: Baseline,
    force_range: Option<[f64; 2]>,
    features: Features,
    model: Model,
    raw: Vec<f32>,
    outputs: Outputs,
    fresh: bool,
    /// Reads contacts off the displacement map that it gives.
    peaks: Option<MapContacts>,
    /// Refines what it says on the skin's forward model.
    inverter: Option<Inverter>,
    /// \[N\] and the share of the surface where so light a press is not felt, by that model.
    unfelt: Option<(f64, f64)>,
    /// That model knows how far the surface gives way.
    displaces: bool,
    /// It has been asked before, which may take seconds the first time: whether it has answered.
    answered: Option<Arc<AtomicBool>>,
}

impl Pipeline {
    fn new(
        sensor: &Sensor,
        skin: &SkinDescription,
        bundle: &Bundle,
        runtime: &Runtime,
    ) -> Result<Self, SetupError> {
        let path = || bundle.path().to_owned();
        let inverter = match &bundle.manifest().inversion {
            None => None,
            Some(settings) => {
                let mut model = (sensor.model)(skin)
                    .map_err(|source| SetupError::NoForwardModel { path: path(), source })?;
                if let Some(correction) = bundle.correction() {
                    let corrected = Corrected::new(model, correction.clone())
                        .map_err(|source| SetupError::Correction { path: path(), source })?;
                    model = Arc::new(corrected);
                }
                let inverter = Inverter::new(model, settings.clone())
                    .map_err(|source| SetupError::Inversion { path: path(), source })?;
                Some(inverter)
            }
        };
        let displaces = inverter.as_ref().is_some_and(|inverter| {
            let model = inverter.model();
            let mut points = vec![0.0; model.surface().points.len()];
            matches!(model.displacement(&Stimulus::default(), &mut points), Ok(true))
        });
        let unfelt = inverter.as_ref().map(|inverter| {
            let force = LIGHT * inverter.settings().force_max;
            (force, inverter.unfelt(force, inverter.settings().presence))
        });
        Ok(Self {
            peaks: MapContacts::of(bundle, &skin.surface(), runtime)?,
            inverter,
            unfelt,
            displaces,
            answered: None,
            path: bundle.path().to_owned(),
            name: bundle.manifest().name.clone(),
            baseline: bundle.manifest().baseline,
            force_range: bundle.manifest().force_range,
            features: bundle.features(),
            model: bundle.session(runtime)?,
            raw: Vec::new(),
            outputs: bundle.outputs(),
            fresh: false,
        })
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        self.outputs.config().values.iter().map(|v| v.name.as_str())
    }

    /// Evaluates the model on the newest frame; `false` while its history is not filled.
    fn infer(&mut self) -> Result<bool, String> {
        let Some(input) = self.features.input() else { return Ok(false) };
        self.model
            .run(input, &mut self.raw)
            .map_err(|e| e.to_string())
            .and_then(|()| self.outputs.decode(&self.raw).map_err(|e| e.to_string()))
            .map_err(|reason| format!("model {}: {reason}", self.path.display()))?;
        self.fresh = true;
        Ok(true)
    }
}

/// Loaded bundles that share the work: each gives some of the outputs.
pub struct Models(Vec<Pipeline>);

impl Models {
    /// Loads bundles into a runtime; takes a moment, and seconds where a bundle wants its answers refined on a forward
    /// model that is computed by finite elements.
    ///
    /// # Errors
    ///
    /// [`SetupError`] where a graph is refused, two bundles give the same output, or a force map does not fit the
    /// surface.
    pub fn load(
        sensor: &Sensor,
        skin: &SkinDescription,
        bundles: &[Bundle],
        runtime: &Runtime,
    ) -> Result<Self, SetupError> {
        let mut models = Self(Vec::new());
        let surface = skin.surface();
        for bundle in bundles {
            let pipeline = Pipeline::new(sensor, skin, bundle, runtime)?;
            for other in &models.0 {
                if let Some(output) = pipeline.names().find(|n| other.names().any(|o| o == *n)) {
                    return Err(SetupError::SameOutput {
                        output: output.to_owned(),
                        first: other.path.clone(),
                        second: pipeline.path.clone(),
                    });
                }
            }
            let points = surface.points.len();
            for (output, expected) in
                [(MAP_NORMAL, points), (MAP_FORCE, 3 * points), (MAP_DISPLACEMENT, points)]
            {
                if let Some(values) = pipeline.outputs.values(output)
                    && values.len() != expected
                {
                    return Err(SetupError::Output {
                        path: pipeline.path,
                        output: output.into(),
                        reason: format!(
                            "has {} numbers where the surface needs {expected}; was `surface.spacing` changed?",
                            values.len()
                        ),
                    });
                }
            }
            let weights = bundle.manifest().peaks.as_ref().map_or(0, |peaks| peaks.weights.len());
            if weights != 0 && weights != points {
                return Err(SetupError::Output {
                    path: pipeline.path,
                    output: MAP_DISPLACEMENT.into(),
                    reason: format!(
                        "`peaks.weights` has {weights} numbers where the surface needs {points}; was `surface.spacing` changed?"
                    ),
                });
            }
            models.0.push(pipeline);
        }
        Ok(models)
    }

    /// Maps that can be had with them.
    #[must_use]
    pub fn maps(&self) -> Maps {
        maps(&self.0)
    }
}

fn gives(pipelines: &[Pipeline], outputs: &[&str]) -> bool {
    pipelines.iter().flat_map(Pipeline::names).any(|n| outputs.contains(&n))
}

/// What a model gives as it is comes before what a forward model makes of contacts.
fn maps(pipelines: &[Pipeline]) -> Maps {
    Maps {
        force: gives(pipelines, &[MAP_NORMAL, MAP_FORCE])
            || pipelines.iter().any(|p| p.inverter.is_some() || p.peaks.is_some()),
        displacement: gives(pipelines, &[MAP_DISPLACEMENT]) || pipelines.iter().any(|p| p.displaces),
    }
}

/// Frame → contacts of a skin whose channels are read together.
///
/// Presence, position and force come from learned models, one contact at a time; a bundle whose manifest has `peaks` gives a
/// displacement map whose peaks are the contacts. One whose manifest has `inversion` has its answer refined on the skin's forward
/// model (corrected, where it has a `correction`), which may tell several contacts apart: one after the other or, where it says so,
/// among all pairs of places when contacts come and go, and from those of the frame before while they last. A frame goes through
/// [`Conditioner`], the models' features, the models, [`Inverter`] and [`Tracker`]; nothing but the frames and the loaded
/// bundles goes in, so that a recording gives the same contacts offline as it gave in the node.
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
    /// What a forward model that searches in pairs found in the latest frame, where it was asked.
    solution: Option<Solution>,
    /// The contacts that it found in the latest frame that had any.
    before: Vec<Found>,
    /// The latest signal, as an inverter takes it.
    readings: Vec<Reading>,
    /// What a forward model makes of the channels that have no reading out of those that have one; empty where none is
    /// missing, or no model knows.
    guessed: Vec<f64>,
    maps: Maps,
    no_model: String,
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
            before: Vec::new(),
            readings: Vec::new(),
            guessed: Vec::new(),
            maps: Maps::ALL,
            no_model: "no model is loaded, so that contacts are unknown; train one with `dermis train` and name its \
                       folder in `models`"
                .into(),
            skin: skin.clone(),
        })
    }

    /// Uses these models from the next frame on.
    pub fn set_models(&mut self, models: Models) {
        self.pipelines = models.0;
        self.before.clear();
        self.probable = false;
    }

    /// Uses these models in place of those that give any of the same outputs; the others stay.
    pub fn replace_models(&mut self, models: Models) {
        self.pipelines
            .retain(|old| !models.0.iter().any(|new| old.names().any(|n| new.names().any(|m| m == n))));
        self.pipelines.extend(models.0);
        self.before.clear();
        self.probable = false;
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
    /// for light contacts, below which a force is not told from nothing. NaN where no model gives a force.
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
        let gives_force = |p: &&Pipeline| p.peaks.is_some() || p.names().any(|n| n.starts_with("force."));
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

    /// A light force \[N\], and the share of the surface where a press of it is not felt, by the forward model that refines;
    /// `None` where none does. There, nothing is reported although something may touch.
    #[must_use]
    pub fn unfelt(&self) -> Option<(f64, f64)> {
        self.pipelines.iter().find_map(|p| p.unfelt)
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

    fn get(&self, output: &str) -> Option<f64> {
        self.pipelines.iter().filter(|p| p.fresh).find_map(|p| p.outputs.get(output))
    }

    fn sigma(&self, output: &str, force: f64) -> f64 {
        let found = self.pipelines.iter().find_map(|p| p.outputs.sigma(output, force));
        found.unwrap_or(f64::NAN)
    }

    /// Whether a displacement map comes without delay. The first one of a forward model may take seconds: it is made ready on
    /// another thread from the first call on.
    pub fn displacements_ready(&mut self) -> bool {
        if gives(&self.pipelines, &[MAP_DISPLACEMENT]) {
            return true;
        }
        let Some(pipeline) = self.pipelines.iter_mut().find(|p| p.displaces) else { return false };
        if let Some(answered) = &pipeline.answered {
            return answered.load(Ordering::Acquire);
        }
        let answered = Arc::new(AtomicBool::new(false));
        pipeline.answered = Some(Arc::clone(&answered));
        let Some(model) = pipeline.inverter.as_ref().map(|i| Arc::clone(i.model())) else { return false };
        let ask = move || {
            let surface = model.surface();
            let mut out = vec![0.0; surface.points.len()];
            if let Some((position, normal)) = surface.points.first().zip(surface.normals.first()) {
                let press = Indentation::sphere(*position, -normal, REACH);
                // What it says of this press is of no interest.
                let _ =
                    model.displacement(&Stimulus { contacts: vec![press], ..Stimulus::default() }, &mut out);
            }
            answered.store(true, Ordering::Release);
        };
        if let Err(error) = std::thread::Builder::new().name("dermis-displacement".into()).spawn(ask) {
            tracing::warn!("skin `{}`: no displacement map: no thread: {error}", self.skin.name);
        }
        false
    }

    /// Hands the latest frame to the features of the models.
    fn push(&mut self) -> Result<(), String> {
        let cleaned = &self.cleaned;
        for pipeline in &mut self.pipelines {
            pipeline.fresh = false;
            let values = match pipeline.baseline {
                Baseline::Raw => &cleaned.reading.values,
                Baseline::Tared => &cleaned.signal.values,
            };
            let stamp = cleaned.reading.stamp;
            // A model that was told which channels are missing knows better what to make of it.
            let pushed = if self.guessed.is_empty() || pipeline.features.config().missing == Missing::Mask {
                pipeline.features.push(stamp, values)
            } else {
                let zero = self.conditioner.zero().filter(|_| pipeline.baseline == Baseline::Raw);
                let whole: Vec<f32> = values
                    .iter()
                    .zip(&self.guessed)
                    .enumerate()
                    .map(|(i, (value, guessed))| match value.is_nan() {
                        true => (guessed + zero.map_or(0.0, |zero| zero[i])) as f32,
                        false => *value,
                    })
                    .collect();
                pipeline.features.push(stamp, &whole)
            };
            pushed.map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    /// Runs what is needed of the models. Returns whether a contact is there and whether every model could answer.
    fn infer(&mut self) -> Result<(bool, bool), String> {
        self.push()?;
        // A model that says whether there is a contact is asked on every frame, the others only during contacts.
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
    fn explains(&mut self) -> bool {
        let Some(inverter) = self.pipelines.iter().find_map(|p| p.inverter.as_ref()) else { return false };
        self.explained = inverter.settings().shows(inverter.evidence(&self.readings), self.explained);
        self.explained
    }

    /// Takes the signal of the latest frame for an inverter.
    fn read(&mut self) {
        if self.pipelines.iter().all(|p| p.inverter.is_none()) {
            return;
        }
        let signal = &self.cleaned.signal;
        self.readings.clear();
        let channels = signal.values.iter().zip(&signal.flags);
        self.readings.extend(channels.map(|(value, flags)| Reading::of(*value, *flags)));
    }

    /// Guesses what channels without a reading would read, from the contacts that a forward model finds in the others.
    fn guess(&mut self) -> Result<(), InverterError> {
        self.guessed.clear();
        let Some(inverter) = self.pipelines.iter().find_map(|p| p.inverter.as_ref()) else { return Ok(()) };
        if !self.readings.contains(&Reading::Missing) || !self.conditioner.is_tared() {
            return Ok(());
        }
        self.guessed.resize(self.readings.len(), 0.0);
        // Whatever it leaves: channels that drift are not those that are missing.
        let shows = self.cleaned.touched
            || inverter.settings().shows((inverter.evidence(&self.readings).0, 0.0), true);
        if shows {
            let solution = if inverter.settings().in_pairs() {
                locate(inverter, &self.readings, &self.before)?
            } else {
                inverter.solve(&self.readings, None)?
            };
            let found = indentations(&solution.contacts, inverter.settings().diameter);
            inverter.signal(&found, &mut self.guessed)?;
            // Asked once a frame: what it costs is the frame's time.
            self.solution = (inverter.settings().in_pairs()).then_some(solution);
        }
        Ok(())
    }

    /// Contacts as the learned models give them: the peaks of a map or, without any, one from position and force.
    fn learned(&mut self) -> Result<Vec<Contact>, String> {
        let refined = self.pipelines.iter().any(|p| p.inverter.is_some());
        let Some(pipeline) = self.pipelines.iter_mut().find(|p| p.fresh && p.peaks.is_some() && !refined)
        else {
            return Ok(vec![self.contact()]);
        };
        let Pipeline { peaks, outputs, path, .. } = pipeline;
        let map = outputs.values(MAP_DISPLACEMENT).unwrap_or_default();
        let mut contacts = match peaks {
            Some(peaks) => peaks.contacts(map).map_err(|e| format!("model {}: {e}", path.display()))?,
            None => Vec::new(),
        };
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
    fn carrying(&mut self) -> Vec<u32> {
        self.shares.of(&self.cleaned.signal, self.conditioner.condition().contact_threshold)
    }

    /// What the learned models say, refined on the forward model where a bundle asks for it, and which bundle did.
    fn contacts(&mut self) -> Result<(Vec<Contact>, Option<usize>), String> {
        let learned = self.learned()?;
        let Some((index, inverter)) =
            self.pipelines.iter().enumerate().find_map(|(i, p)| Some((i, p.inverter.as_ref()?)))
        else {
            return Ok((learned, None));
        };
        let settings = inverter.settings();
        let solution = if settings.in_pairs() {
            match self.solution.take() {
                Some(solution) => Ok(solution),
                None => locate(inverter, &self.readings, &self.before),
            }
        } else {
            let known = |c: &&Contact| {
                c.position.iter().chain(&c.force).all(|v| v.is_finite()) && c.normal_force() > 0.0
            };
            let hint = learned
                .first()
                .filter(known)
                .map(|c| Indentation::sphere(c.position, c.force, settings.diameter));
            inverter.solve(&self.readings, hint.as_ref())
        };
        let solution =
            solution.map_err(|e| format!("model {}: {e}", self.pipelines[index].path.display()))?;
        self.before.clone_from(&solution.contacts);
        if solution.contacts.is_empty() {
            return Ok((learned, None));
        }
        let components = settings.unknowns.force_components();
        let single = solution.contacts.len() == 1;
        let carrying = self.carrying();
        let contacts = solution
            .contacts
            .into_iter()
            .map(|found| {
                let Found { position, normal, force, position_covariance, force_covariance } = found;
                let mut contact = Contact::at(position, normal);
                contact.force = force;
                contact.force_components = components;
                contact.position_covariance = position_covariance;
                contact.force_covariance = force_covariance;
                contact.confidence = self.confidence(contact.normal_force()) as f32;
                contact.taxels = if single { carrying.clone() } else { self.shares.near(&position) };
                contact
            })
            .collect();
        Ok((contacts, Some(index)))
    }

    fn contact(&mut self) -> Contact {
        let flat = matches!(self.skin.surface, SurfaceSpec::Rectangle { .. });
        let (position, normal) =
            match (self.get("position.x"), self.get("position.y"), self.get("position.z")) {
                (Some(x), Some(y), Some(z)) => self.surface.project(&Point3::new(x, y, z)),
                (Some(x), Some(y), None) if flat => self.surface.project(&Point3::new(x, y, 0.0)),
                // On a flat skin the normal is known without the position.
                _ if flat => (Point3::from(Vector3::repeat(f64::NAN)), Vector3::z()),
                _ => (Point3::from(Vector3::repeat(f64::NAN)), Vector3::repeat(f64::NAN)),
            };
        let mut contact = Contact::at(position, normal);

        let full = match (self.get("force.x"), self.get("force.y"), self.get("force.z")) {
            (Some(x), Some(y), Some(z)) => Some(Vector3::new(x, y, z)),
            _ => None,
        };
        let pressing = self.get("force.normal").or_else(|| self.get("force.z").filter(|_| flat).map(|z| -z));
        let magnitude = if let Some(force) = full {
            contact.force = force;
            contact.force_components = ForceComponents::Full;
            let along = -force.dot(&normal);
            let along = if along.is_nan() { force.norm() } else { along };
            contact.force_covariance = Matrix3::from_diagonal(&Vector3::new(
                self.sigma("force.x", along).powi(2),
                self.sigma("force.y", along).powi(2),
                self.sigma("force.z", along).powi(2),
            ));
            along
        } else if let Some(pressing) = pressing.filter(|_| !normal.x.is_nan()) {
            contact.force = -normal * pressing;
            contact.force_components = ForceComponents::Normal;
            let by_normal = self.sigma("force.normal", pressing);
            let sigma = if by_normal.is_nan() { self.sigma("force.z", pressing) } else { by_normal };
            contact.force_covariance = normal * normal.transpose() * sigma.powi(2);
            pressing
        } else {
            f64::NAN
        };

        if !position.x.is_nan() {
            let at = if magnitude.is_nan() { 0.0 } else { magnitude };
            let z = self.sigma("position.z", at);
            contact.position_covariance = Matrix3::from_diagonal(&Vector3::new(
                self.sigma("position.x", at).powi(2),
                self.sigma("position.y", at).powi(2),
                // A flat skin knows its own height.
                if flat { 0.0 } else { z.powi(2) },
            ));
        }
        if self.channels_missing() {
            // The errors of a model were measured with every channel there.
            contact.position_covariance.fill(f64::NAN);
            contact.force_covariance.fill(f64::NAN);
        }
        contact.taxels = self.carrying();
        contact.confidence = self.confidence(magnitude) as f32;
        contact
    }

    fn channels_missing(&self) -> bool {
        self.cleaned.reading.values.iter().any(|v| v.is_nan())
    }

    /// 0 to 1: how surely this is a contact, less for channels that are missing and for a force that the model has
    /// never seen.
    fn confidence(&self, pressing: f64) -> f64 {
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

    fn map(&self, output: &str) -> Option<&[f64]> {
        self.pipelines.iter().filter(|p| p.fresh).find_map(|p| p.outputs.values(output))
    }

    /// What a learned model gives or, where none does, the forces of contacts that a forward model refined or that are peaks.
    fn force_map(&self, contacts: &[Contact], refined: bool) -> Option<ForceMap> {
        let placed = refined || self.pipelines.iter().any(|p| p.fresh && p.peaks.is_some());
        let forces = if let Some(map) = self.map(MAP_FORCE) {
            ForceValues::Vector(
                map.chunks_exact(3).map(|f| [f[0] as f32, f[1] as f32, f[2] as f32]).collect(),
            )
        } else if let Some(map) = self.map(MAP_NORMAL) {
            ForceValues::Normal(map.iter().map(|f| *f as f32).collect())
        } else if placed {
            ForceValues::Normal(spread(&self.surface, contacts))
        } else {
            return None;
        };
        Some(ForceMap { indices: None, forces })
    }

    /// What a learned model gives or, where none does, what the forward model that refined contacts makes of them.
    fn displacement_map(&self, contacts: &[Contact], refined: Option<usize>) -> Option<DisplacementMap> {
        if let Some(map) = self.map(MAP_DISPLACEMENT) {
            let displacements = map.iter().map(|d| *d as f32).collect();
            return Some(DisplacementMap { indices: None, displacements });
        }
        let inverter = self.pipelines.get(refined?)?.inverter.as_ref()?;
        let diameter = inverter.settings().diameter;
        let contacts = contacts.iter().map(|c| Indentation::sphere(c.position, c.force, diameter)).collect();
        let mut points = vec![0.0; self.surface.points.len()];
        let known = inverter.model().displacement(&Stimulus { contacts, ..Stimulus::default() }, &mut points);
        if !known.unwrap_or_else(|error| {
            tracing::debug!("skin `{}`: no displacement map: {error}", self.skin.name);
            false
        }) {
            return None;
        }
        Some(DisplacementMap { indices: None, displacements: points.iter().map(|d| *d as f32).collect() })
    }

    /// The maps of a skin that nothing touches.
    fn untouched(&self) -> Estimate {
        let points = self.surface.points.len();
        let can = self.maps();
        let forces = if gives(&self.pipelines, &[MAP_FORCE]) {
            ForceValues::Vector(vec![[0.0; 3]; points])
        } else {
            ForceValues::Normal(vec![0.0; points])
        };
        let displacements = vec![0.0; points];
        Estimate {
            contacts: Vec::new(),
            force_map: (can.force && self.maps.force).then_some(ForceMap { indices: None, forces }),
            displacement_map: (can.displacement && self.maps.displacement)
                .then_some(DisplacementMap { indices: None, displacements }),
        }
    }

    /// Impaired channels: their names with what is wrong, and of those that nobody asked to leave out, how many of how
    /// many are unusable.
    fn faults(&self) -> (Vec<String>, usize, usize) {
        let reading = &self.cleaned.reading;
        let mut names = Vec::new();
        let (mut invalid, mut asked) = (0, 0);
        for (channel, flags) in self.skin.channels().iter().zip(&reading.flags) {
            if !flags.contains(ChannelFlags::MASKED) {
                asked += 1;
                invalid += usize::from(flags.is_invalid());
            }
            if !flags.is_ok() {
                names.push(format!("{} ({flags})", channel.name));
            }
        }
        (names, invalid, asked)
    }

    fn judge(&self) -> (Quality, String) {
        let (faults, invalid, asked) = self.faults();
        if 2 * invalid > asked || asked == 0 {
            return (
                Quality::Fault,
                format!(
                    "{invalid} of {asked} channels are unusable: {}; check the sensor and its wiring",
                    listed(&faults, 8)
                ),
            );
        }
        if self.pipelines.is_empty() {
            return (Quality::Uncalibrated, self.no_model.clone());
        }
        if self.needs_zero() && !self.conditioner.is_tared() {
            return (Quality::Uncalibrated, self.untared());
        }
        if faults.is_empty() {
            return (Quality::Ok, String::new());
        }
        let channels = self.cleaned.reading.values.len();
        let mut text =
            format!("{} of {channels} channels are impaired: {}", faults.len(), listed(&faults, 8));
        if self.channels_missing() && self.pipelines.iter().all(|p| p.inverter.is_none()) {
            text += "; no forward model stands in for them, so that the error of the contacts is unknown";
        }
        (Quality::Degraded, text)
    }

    fn untared(&self) -> String {
        match self.conditioner.tare_state() {
            TareState::Averaging { disturbed: Some(spread), .. } => format!(
                "not tared: the readings move by {spread:.1} times their noise; leave the skin untouched, or correct \
                 `noise` in the skin file"
            ),
            TareState::Averaging { elapsed, .. } => format!(
                "not tared yet: {elapsed:.1} of {:.1} s of untouched readings",
                self.conditioner.condition().tare_duration
            ),
            TareState::Done => "not tared".into(),
        }
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
        let mut cleaned = std::mem::take(&mut self.cleaned);
        self.conditioner.clean(frame, &mut cleaned);
        self.cleaned = cleaned;
        if self.conditioner.zero_replaced() {
            for pipeline in self.pipelines.iter_mut().filter(|p| p.baseline == Baseline::Tared) {
                pipeline.features.reset();
            }
        }
        let (quality, text) = self.judge();
        self.verdict = Verdict {
            quality,
            text,
            level: self.cleaned.level,
            touched: self.cleaned.touched,
            probability: None,
        };
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
            self.before.clear();
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
        // Refused only where asked to check.
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
        self.before.clear();
    }
}

/// Several contacts: those of the frame before for as long as they last, otherwise whatever explains the readings best.
fn locate(inverter: &Inverter, readings: &[Reading], before: &[Found]) -> Result<Solution, InverterError> {
    match inverter.follow(readings, before)? {
        Some(solution) => Ok(solution),
        None => inverter.search(readings),
    }
}

fn indentations(found: &[Found], diameter: f64) -> Vec<Indentation> {
    found.iter().map(|f| Indentation::sphere(f.position, f.force, diameter)).collect()
}

/// \[N\] on every point of a surface: the pressing force of each contact on the points within its radius, shared by area.
/// The points add up to the contacts.
fn spread(surface: &Surface, contacts: &[Contact]) -> Vec<f32> {
    let mut forces = vec![0.0; surface.points.len()];
    for contact in contacts {
        let radius = if contact.diameter.is_finite() { f64::from(contact.diameter) / 2.0 } else { REACH };
        let distance = |i: usize| (surface.points[i] - contact.position).norm();
        let mut under: Vec<usize> = (0..forces.len()).filter(|i| distance(*i) <= radius).collect();
        if under.is_empty() {
            // Between the points of a coarse surface.
            under.extend((0..forces.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))));
        }
        let area: f64 = under.iter().map(|i| surface.areas[*i]).sum();
        for i in &under {
            let share = if area > 0.0 { surface.areas[*i] / area } else { 1.0 / under.len() as f64 };
            forces[*i] += contact.normal_force() * share;
        }
    }
    forces.iter().map(|f| *f as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{
        Membrane, Out, STRETCHED, TestBundle, load, load_for, nine, skin_with, tared_estimator,
    };
    use dermis_inversion::Settings;
    use dermis_model::ForwardModel;

    const IDLE: f32 = 101_325.0;

    fn frame(k: u64, load: [f32; 4]) -> Frame {
        // A pattern with a spread of one noise deviation and a mean of zero over four frames.
        let wiggle = [20.0, -20.0, -20.0, 20.0][(k % 4) as usize];
        let values =
            load.iter().enumerate().map(|(i, l)| IDLE + l + if i % 2 == 0 { wiggle } else { -wiggle });
        Frame::new(k as i64 * 10_000_000, k, values.collect())
    }

    fn press(estimator: &mut SkinEstimator, k: u64, load: [f32; 4]) -> Estimate {
        estimator.estimate(&frame(k, load)).unwrap()
    }

    #[test]
    fn without_a_model_it_is_uncalibrated_and_says_so() {
        let mut estimator = SkinEstimator::new(&skin_with(""), &[]).unwrap();
        for k in 0..100 {
            assert!(press(&mut estimator, k, [0.0; 4]).contacts.is_empty());
        }
        assert_eq!(estimator.verdict().quality, Quality::Uncalibrated);
        assert!(estimator.verdict().text.contains("no model is loaded"));
        assert!(estimator.zero().is_some(), "it tares all the same");
    }

    #[test]
    fn a_press_has_position_force_and_error_bars() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        assert!(press(&mut estimator, 100, [0.0; 4]).contacts.is_empty());
        assert_eq!((estimator.verdict().quality, estimator.verdict().text.as_str()), (Quality::Ok, ""));

        let contacts = press(&mut estimator, 101, [2000.0, 0.0, 0.0, 0.0]).contacts;
        let [contact] = contacts.as_slice() else { panic!("{contacts:?}") };
        assert_eq!(contact.track_id, 1);
        assert!((contact.position - Point3::new(-0.01, -0.01, 0.0)).norm() < 1e-3, "{}", contact.position);
        assert_eq!(contact.normal, Vector3::z());
        assert!((contact.normal_force() - 2.0).abs() < 0.1, "{}", contact.normal_force());
        assert!(contact.force.z < 0.0, "pressing pushes into the skin");
        assert_eq!(contact.force_components, ForceComponents::Normal);
        assert!((contact.position_covariance[(0, 0)] - 1e-6).abs() < 1e-12);
        assert_eq!(contact.position_covariance[(2, 2)], 0.0);
        assert!((contact.force_covariance[(2, 2)] - 0.01).abs() < 1e-9);
        assert_eq!(contact.taxels, [0]);
        assert!(contact.confidence > 0.99 && contact.diameter.is_nan());
        assert!((estimator.force_max() - 5.0).abs() < 1e-9);

        assert_eq!(press(&mut estimator, 102, [1900.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 1);
        assert!(press(&mut estimator, 103, [0.0; 4]).contacts.is_empty());
        assert_eq!(press(&mut estimator, 150, [1900.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 2);
    }

    #[test]
    fn positions_lie_on_the_surface() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        let contact = &press(&mut estimator, 100, [8000.0, 0.0, 0.0, 0.0]).contacts[0];
        assert_eq!(contact.position, Point3::new(-0.01, -0.01, 0.0), "beyond the edge of the pad");
        assert!(contact.confidence < 0.7, "8 N where the model knows 5: {}", contact.confidence);
    }

    #[test]
    fn the_same_frames_give_the_same_contacts() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        estimator.reset();
        let mut run = || -> Vec<Estimate> {
            (0..400)
                .map(|k| {
                    let touched = (100..300).contains(&k);
                    press(&mut estimator, k, if touched { [900.0, 100.0, 0.0, 40.0] } else { [0.0; 4] })
                })
                .collect()
        };
        let first = run();
        assert!(first.iter().any(|e| !e.contacts.is_empty()));
        let (estimator_again, _dir) = tared_estimator(&TestBundle::default());
        estimator = estimator_again;
        estimator.reset();
        let second: Vec<Estimate> = (0..400)
            .map(|k| {
                let touched = (100..300).contains(&k);
                press(&mut estimator, k, if touched { [900.0, 100.0, 0.0, 40.0] } else { [0.0; 4] })
            })
            .collect();
        assert_eq!(format!("{first:?}"), format!("{second:?}"));
    }

    #[test]
    fn impaired_channels_degrade_and_many_are_a_fault() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        let healthy = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts[0].confidence;
        let contacts = press(&mut estimator, 101, [2000.0, 0.0, f32::NAN, 0.0]).contacts;
        assert_eq!(estimator.verdict().quality, Quality::Degraded);
        insta::assert_snapshot!(estimator.verdict().text, @"1 of 4 channels are impaired: t2 (not finite); no forward model stands in for them, so that the error of the contacts is unknown");
        assert!(contacts[0].confidence < 0.8 * healthy);
        assert!(
            contacts[0].position_covariance.iter().chain(&contacts[0].force_covariance).all(|v| v.is_nan())
        );
        let blind = press(&mut estimator, 102, [f32::NAN, f32::NAN, f32::NAN, 0.0]);
        assert!(blind.contacts.is_empty() && blind.force_map.is_none());
        assert_eq!(estimator.verdict().quality, Quality::Fault);
        assert!(
            estimator.verdict().text.starts_with("3 of 4 channels are unusable: t0 (not finite), t1"),
            "{}",
            estimator.verdict().text
        );
    }

    #[test]
    fn an_untared_skin_is_no_untouched_skin() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        estimator.reset();
        press(&mut estimator, 0, [0.0; 4]);
        press(&mut estimator, 1, [0.0; 4]);
        assert_eq!(estimator.verdict().quality, Quality::Uncalibrated);
        insta::assert_snapshot!(estimator.verdict().text, @"not tared yet: 0.0 of 0.5 s of untouched readings");
        for k in 2..100 {
            press(&mut estimator, k, [k as f32 * 50.0, 0.0, 0.0, 0.0]);
        }
        insta::assert_snapshot!(estimator.verdict().text, @"not tared: the readings move by 18.6 times their noise; leave the skin untouched, or correct `noise` in the skin file");
    }

    #[test]
    fn a_model_that_says_whether_there_is_a_contact_is_believed() {
        let mut bundle = TestBundle::default();
        // One half at a sum of 1 kPa.
        bundle.outputs.push(Out::new("contact", "1", 20.0, [1.0; 4]).biased(-20.0).logistic());
        let (mut estimator, _dir) = tared_estimator(&bundle);
        assert!(press(&mut estimator, 100, [500.0, 0.0, 0.0, 0.0]).contacts.is_empty());
        assert!(estimator.conditioned().touched, "by level it is touched");
        let contacts = press(&mut estimator, 101, [1500.0, 0.0, 0.0, 0.0]).contacts;
        assert_eq!(contacts.len(), 1);
        assert!(estimator.verdict().probability.is_some_and(|p| p > 0.9));
    }

    #[test]
    fn presence_and_force_without_position_are_reported_as_such() {
        let mut bundle = TestBundle::default();
        bundle.outputs.retain(|o| o.name == "force.normal");
        let (mut estimator, _dir) = tared_estimator(&bundle);
        let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
        assert!(contact.position.x.is_nan() && contact.position_covariance[(0, 0)].is_nan());
        assert!((contact.normal_force() - 2.0).abs() < 0.1, "the normal of a flat skin is known");

        let dome =
            skin_with("surface = { type = \"dome\", radius = 0.01, cylinder = 0.01, spacing = 0.003 }");
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&dome, dir.path());
        let mut estimator = load(&dome, &[dir.path()]).unwrap();
        for k in 0..60 {
            press(&mut estimator, k, [0.0; 4]);
        }
        let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
        assert_eq!(contact.force_components, ForceComponents::None);
        assert!(contact.force.x.is_nan() && contact.normal.x.is_nan());
    }

    #[test]
    fn all_three_components_are_told_from_the_normal_one() {
        let mut bundle = TestBundle::default();
        bundle.outputs.retain(|o| o.name != "force.normal");
        for (axis, w) in [("x", 0.5), ("y", 0.0), ("z", -1.0)] {
            bundle.outputs.push(Out::new(&format!("force.{axis}"), "N", 1.0, [w; 4]));
        }
        let (mut estimator, _dir) = tared_estimator(&bundle);
        let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
        assert_eq!(contact.force_components, ForceComponents::Full);
        assert!((contact.force - Vector3::new(1.0, 0.0, -2.0)).norm() < 0.1, "{}", contact.force);
    }

    #[test]
    fn light_contacts_are_left_out_where_asked() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        assert!((estimator.force_threshold() - 0.1).abs() < 1e-9, "the model's own error");
        estimator.set_least_force(0.5);
        assert!((estimator.force_threshold() - 0.5).abs() < 1e-9);
        assert!(press(&mut estimator, 100, [300.0, 0.0, 0.0, 0.0]).contacts.is_empty());
        assert_eq!(press(&mut estimator, 101, [900.0, 0.0, 0.0, 0.0]).contacts.len(), 1);
    }

    #[test]
    fn two_bundles_share_the_work_but_not_an_output() {
        let skin = skin_with("");
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut position = TestBundle::default();
        let mut force = TestBundle::default();
        position.outputs.retain(|o| o.name != "force.normal");
        force.outputs.retain(|o| o.name == "force.normal");
        position.write(&skin, a.path());
        force.write(&skin, b.path());
        let mut estimator = load(&skin, &[a.path(), b.path()]).unwrap();
        for k in 0..60 {
            press(&mut estimator, k, [0.0; 4]);
        }
        let contact = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]).contacts.remove(0);
        assert!(contact.position.x < 0.0 && contact.normal_force() > 1.0);
        let error = load(&skin, &[a.path(), a.path()]).err().unwrap().to_string();
        assert!(error.contains("both give `position.x`"), "{error}");
    }

    #[test]
    fn a_force_map_appears_where_the_model_gives_one() {
        let points = skin_with("").surface().points.len();
        let mut bundle = TestBundle::default();
        let mut map = Out::new(MAP_NORMAL, "N", 0.1, [1.0, 0.0, 0.0, 0.0]);
        map.count = points;
        bundle.outputs.push(map);
        let (mut estimator, _dir) = tared_estimator(&bundle);
        assert!(estimator.maps().force && !estimator.maps().displacement);
        let idle = press(&mut estimator, 100, [0.0; 4]).force_map.unwrap();
        assert_eq!(idle.forces, ForceValues::Normal(vec![0.0; points]));
        let pressed = press(&mut estimator, 101, [2000.0, 0.0, 0.0, 0.0]).force_map.unwrap();
        let ForceValues::Normal(values) = pressed.forces else { panic!("vector map") };
        assert!(values.len() == points && (values[3] - 0.2).abs() < 0.01);

        bundle.outputs.last_mut().unwrap().count = 3;
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&skin_with(""), dir.path());
        let error = load(&skin_with(""), &[dir.path()]).err().unwrap().to_string();
        assert!(error.contains("has 3 numbers where the surface needs 25"), "{error}");
    }

    /// The pad of nine with a bundle that is refined on its forward model, tared.
    fn refined(outputs: &[Out], masked: &[String]) -> (SkinEstimator, tempfile::TempDir) {
        let skin = nine();
        let mut bundle = TestBundle { inversion: Some(Settings::new(0.004, 5.0)), ..TestBundle::default() };
        bundle.outputs.extend_from_slice(outputs);
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&skin, dir.path());
        let mut estimator = load_for(&STRETCHED, &skin, &[dir.path()], masked).unwrap();
        for k in 0..80 {
            pressed(&mut estimator, k, None, &[]);
        }
        assert!(estimator.zero().is_some());
        (estimator, dir)
    }

    /// One frame of that pad under a press at \[m\] with \[N\], without these channels.
    fn pressed(
        estimator: &mut SkinEstimator,
        k: u64,
        press: Option<([f64; 2], f64)>,
        broken: &[usize],
    ) -> Estimate {
        let contacts = press.map(|([x, y], force)| {
            Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
        });
        let stimulus = Stimulus { contacts: contacts.into_iter().collect(), ..Stimulus::default() };
        let mut signal = [0.0; 9];
        Membrane::new(&nine()).response(&stimulus, &mut signal).unwrap();
        let wiggle = |i: usize| [6.0, -6.0, -6.0, 6.0][(k as usize + i) % 4];
        let value = |(i, s): (usize, &f64)| {
            if broken.contains(&i) { f32::NAN } else { IDLE + *s as f32 + wiggle(i) }
        };
        let values = signal.iter().enumerate().map(value).collect();
        estimator.estimate(&Frame::new(k as i64 * 10_000_000, k, values)).unwrap()
    }

    #[test]
    fn a_forward_model_does_without_a_channel_and_says_how_well() {
        let (mut whole, _dir) = refined(&[], &[]);
        let press = Some(([0.003, 0.001], 1.0));
        let place = Point3::new(0.003, 0.001, 0.0);
        let all = pressed(&mut whole, 80, press, &[]).contacts.remove(0);
        assert_eq!((whole.verdict().quality, whole.verdict().text.as_str()), (Quality::Ok, ""));
        assert!((all.position - place).norm() < 2e-4, "{}", all.position);
        // The two that feel it most: dead, then left out by the configuration.
        let (mut masked, _dir) = refined(&[], &["t4".into(), "t5".into()]);
        let without = [
            (pressed(&mut whole, 81, press, &[4, 5]).contacts.remove(0), &whole, "not finite"),
            (pressed(&mut masked, 81, press, &[]).contacts.remove(0), &masked, "masked"),
        ];
        for (contact, estimator, why) in without {
            let verdict = estimator.verdict();
            assert_eq!(verdict.quality, Quality::Degraded);
            assert_eq!(verdict.text, format!("2 of 9 channels are impaired: t4 ({why}), t5 ({why})"));
            let error = (contact.position - place).norm();
            let sigma = contact.position_covariance.trace().sqrt();
            assert!(error < 1e-3 && error < 4.0 * sigma, "{} ± {sigma}", contact.position);
            let before = all.position_covariance.trace().sqrt();
            assert!(sigma > 1.1 * before, "it knows less: {sigma} after {before}");
            assert!((contact.normal_force() - 1.0).abs() < 0.1, "{}", contact.normal_force());
            assert!(contact.confidence < all.confidence);
        }
    }

    #[test]
    fn a_network_is_given_what_the_forward_model_expects_of_a_missing_channel() {
        // 1 N for 1 kPa on the first channel.
        let points = nine().surface().points.len();
        let mut map = Out::new(MAP_NORMAL, "N", 1.0, [1.0, 0.0, 0.0, 0.0]);
        map.count = points;
        let (mut estimator, _dir) = refined(&[map], &[]);
        let press = Some(([-0.006, -0.007], 1.0));
        let mut first = |k, broken: &[usize]| {
            let map = pressed(&mut estimator, k, press, broken).force_map.unwrap();
            let ForceValues::Normal(values) = map.forces else { panic!("vector map") };
            values[0]
        };
        let (all, without) = (first(80, &[]), first(81, &[0]));
        assert!(all > 1.5 && (without - all).abs() < 0.1, "{all} became {without}");
        assert!(pressed(&mut estimator, 82, None, &[0]).contacts.is_empty());
    }

    #[test]
    fn maps_are_made_of_refined_contacts_where_somebody_asks() {
        let (mut estimator, _dir) = refined(&[], &[]);
        assert_eq!(estimator.maps(), Maps::ALL);
        let points = nine().surface().points.len();
        let idle = pressed(&mut estimator, 80, None, &[]);
        assert_eq!(idle.force_map.unwrap().forces, ForceValues::Normal(vec![0.0; points]));
        assert_eq!(idle.displacement_map.unwrap().displacements, vec![0.0; points]);

        let touched = pressed(&mut estimator, 81, Some(([0.004, -0.002], 2.0)), &[]);
        let contact = &touched.contacts[0];
        let ForceValues::Normal(forces) = touched.force_map.unwrap().forces else { panic!("vector map") };
        let sum: f64 = forces.iter().map(|f| f64::from(*f)).sum();
        assert!((sum - contact.normal_force()).abs() < 1e-5, "{sum} of {}", contact.normal_force());
        for (point, force) in nine().surface().points.iter().zip(&forces) {
            assert_eq!(*force > 0.0, (point - contact.position).norm() <= REACH, "at {point}");
        }
        let displacements = touched.displacement_map.unwrap().displacements;
        let most = displacements.iter().copied().fold(0.0, f32::max);
        assert!((f64::from(most) - 2.0 * Membrane::GIVES).abs() < 1e-4, "{most} m inwards");

        // Made ready elsewhere, so that no frame waits for it.
        let begun = std::time::Instant::now();
        while !estimator.displacements_ready() {
            assert!(begun.elapsed().as_secs() < 30);
            std::thread::yield_now();
        }
        estimator.want_maps(Maps::NONE);
        let unasked = pressed(&mut estimator, 82, Some(([0.004, -0.002], 2.0)), &[]);
        assert!(
            unasked.contacts.len() == 1 && unasked.force_map.is_none() && unasked.displacement_map.is_none()
        );
        let blind = pressed(&mut estimator, 83, None, &[0, 1, 2, 3, 4, 5]);
        assert!(blind.force_map.is_none() && estimator.verdict().quality == Quality::Fault);
    }

    /// One frame of the pad of nine under presses at \[m\] with \[N\].
    fn both(k: u64, presses: &[([f64; 2], f64)]) -> Frame {
        let contacts = presses.iter().map(|([x, y], force)| {
            Indentation::sphere(Point3::new(*x, *y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
        });
        let mut signal = [0.0; 9];
        let stimulus = Stimulus { contacts: contacts.collect(), ..Stimulus::default() };
        Membrane::new(&nine()).response(&stimulus, &mut signal).unwrap();
        let wiggle = |i: usize| [6.0, -6.0, -6.0, 6.0][(k as usize + i) % 4];
        let values = signal.iter().enumerate().map(|(i, s)| IDLE + *s as f32 + wiggle(i)).collect();
        Frame::new(k as i64 * 10_000_000, k, values)
    }

    #[test]
    fn two_contacts_keep_their_identities_and_both_are_in_the_maps() {
        let skin = nine();
        let mut settings = Settings::new(0.004, 5.0);
        (settings.contacts, settings.distance) = (2, 0.006);
        settings.search = dermis_inversion::Search::Pairs;
        let bundle = TestBundle { inversion: Some(settings), ..TestBundle::default() };
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&skin, dir.path());
        let mut estimator = load_for(&STRETCHED, &skin, &[dir.path()], &[]).unwrap();
        for k in 0..80 {
            estimator.estimate(&both(k, &[])).unwrap();
        }
        let (a, b, surface) = ([-0.007, -0.006], [0.006, 0.007], skin.surface());
        let near = |c: &Contact, [x, y]: [f64; 2]| (c.position - Point3::new(x, y, 0.0)).norm() < 1e-3;
        let one = estimator.estimate(&both(80, &[(a, 1.0)])).unwrap().contacts;
        assert!(one.len() == 1 && near(&one[0], a) && one[0].track_id == 1, "{one:?}");
        for k in 81..100 {
            // The second grows above the first.
            let second = 0.4 + 0.08 * (k - 80) as f64;
            let estimate = estimator.estimate(&both(k, &[(a, 1.0), (b, second)])).unwrap();
            let mut found = estimate.contacts;
            found.sort_by_key(|c| c.track_id);
            assert_eq!(found.iter().map(|c| c.track_id).collect::<Vec<_>>(), [1, 2], "{found:?}");
            assert!(near(&found[0], a) && near(&found[1], b), "{found:?}");
            assert!((found[1].normal_force() - second).abs() < 0.15, "{found:?}");
            assert!(!found[0].taxels.is_empty() && found[0].taxels != found[1].taxels);
            let ForceValues::Normal(forces) = estimate.force_map.unwrap().forces else {
                panic!("vector map")
            };
            let sum: f64 = forces.iter().map(|f| f64::from(*f)).sum();
            assert!((sum - found[0].normal_force() - found[1].normal_force()).abs() < 1e-4);
            let depth = estimate.displacement_map.unwrap().displacements;
            let at = |[x, y]: [f64; 2]| {
                let place = Point3::new(x, y, 0.0);
                let under = surface.points.iter().zip(&depth).filter(|(p, _)| (*p - place).norm() < 2e-3);
                under.fold(0.0, |most, (_, d)| f64::from(*d).max(most))
            };
            assert!(at(a) > 0.8 * Membrane::GIVES && at(b) > 0.3 * Membrane::GIVES);
        }
        // One that ends leaves the other alone; a frame that is passed over changes nothing.
        estimator.pass(&both(100, &[(a, 1.0), (b, 2.0)])).unwrap();
        assert!(estimator.verdict().touched);
        let left = estimator.estimate(&both(101, &[(b, 2.0)])).unwrap().contacts;
        assert!(left.len() == 1 && near(&left[0], b) && left[0].track_id == 2, "{left:?}");
        assert!(estimator.estimate(&both(102, &[])).unwrap().contacts.is_empty());
        assert!(estimator.unfelt().is_some_and(|(force, share)| force > 0.0 && (0.0..1.0).contains(&share)));
    }

    #[test]
    fn frames_that_are_passed_over_are_conditioned_all_the_same() {
        let bundle = TestBundle { taps: vec![0, 5], ..TestBundle::default() };
        let (mut estimator, _dir) = tared_estimator(&bundle);
        for k in 80..86 {
            estimator.pass(&frame(k, [2000.0, 0.0, 0.0, 0.0])).unwrap();
        }
        let contacts = press(&mut estimator, 86, [2000.0, 0.0, 0.0, 0.0]).contacts;
        assert_eq!(contacts.len(), 1, "the history is filled: {}", estimator.verdict().text);
        assert!(estimator.pass(&Frame::new(0, 9, vec![0.0; 5])).is_err());
    }

    #[test]
    fn a_forward_model_is_corrected_by_what_was_recorded() {
        let skin = nine();
        let channels = skin.channels().len();
        let weights = vec![0.0_f32; channels];
        let text = |gains: &[f64]| {
            format!(
                "{{\"centres\":[[0.0,0.0,0.0]],\"length\":0.01,\"force\":1.0,\"powers\":1,\"gains\":{gains:?},\"weights\":{weights:?}}}"
            )
        };
        // Channels that read half and twice of what the design says.
        let gains: Vec<f64> = (0..channels).map(|i| if i % 2 == 0 { 0.5 } else { 2.0 }).collect();
        let bundle = TestBundle { inversion: Some(Settings::new(0.004, 5.0)), ..TestBundle::default() };
        let dir = tempfile::tempdir().unwrap();
        bundle.write(&skin, dir.path());
        let error = |corrected: bool| {
            let mut loaded = Bundle::load(dir.path(), &skin).unwrap();
            let mut manifest = loaded.manifest().clone();
            manifest.correction = corrected.then(dermis_inference::CorrectionSection::default);
            let correction = corrected.then(|| serde_json::from_str(&text(&gains)).unwrap());
            loaded.amend(manifest, correction).unwrap();
            let mut estimator = load_for(&STRETCHED, &skin, &[dir.path()], &[]).unwrap();
            let device = |k: u64, presses: &[([f64; 2], f64)]| {
                let mut frame = both(k, presses);
                for (value, gain) in frame.values.iter_mut().zip(&gains) {
                    *value = IDLE + (*value - IDLE) * *gain as f32;
                }
                frame
            };
            for k in 0..80 {
                estimator.estimate(&device(k, &[])).unwrap();
            }
            let found = estimator.estimate(&device(80, &[([0.003, 0.004], 1.0)])).unwrap().contacts;
            (found[0].position - Point3::new(0.003, 0.004, 0.0)).norm()
        };
        let (without, with) = (error(false), error(true));
        assert!(with < 3e-4 && without > 5.0 * with, "{without} m, {with} m with the correction");
    }

    #[test]
    fn drift_that_a_bundle_knows_of_is_no_light_contact() {
        let skin = nine();
        let felt = |presence: f64, newtons: f64| {
            let settings = Settings { presence, ..Settings::new(0.004, 5.0) };
            let bundle = TestBundle { inversion: Some(settings), ..TestBundle::default() };
            let dir = tempfile::tempdir().unwrap();
            bundle.write(&skin, dir.path());
            let mut estimator = load_for(&STRETCHED, &skin, &[dir.path()], &[]).unwrap();
            for k in 0..80 {
                estimator.estimate(&both(k, &[])).unwrap();
            }
            let contacts = estimator.estimate(&both(80, &[([0.003, 0.004], newtons)])).unwrap().contacts;
            assert_eq!(contacts.is_empty(), !estimator.verdict().touched);
            (!contacts.is_empty(), estimator.verdict().level)
        };
        // So light that the level does not show it.
        let light = (1..40).map(|k| f64::from(k) * 2e-3).find(|newtons| felt(30.0, *newtons).0).unwrap();
        let (level, threshold) = (felt(30.0, light).1, skin.condition.contact_threshold);
        assert!(level < threshold, "{light} N: {level}");
        assert!(!felt(1e4, light).0, "what untouched readings reach is no contact");
        assert!(felt(1e4, 1.0).0, "what the level shows is one, whatever the drift");
    }

    #[test]
    fn a_displacement_map_appears_where_the_model_gives_one() {
        let points = skin_with("").surface().points.len();
        let mut bundle = TestBundle::default();
        let mut map = Out::new(MAP_DISPLACEMENT, "m", 1e-4, [1.0, 0.0, 0.0, 0.0]);
        map.count = points;
        bundle.outputs.push(map);
        let (mut estimator, _dir) = tared_estimator(&bundle);
        assert_eq!(estimator.maps(), Maps { force: false, displacement: true });
        let pressed = press(&mut estimator, 100, [2000.0, 0.0, 0.0, 0.0]);
        let displacements = pressed.displacement_map.unwrap().displacements;
        assert!(displacements.len() == points && (displacements[7] - 2e-4).abs() < 1e-5);
        assert!(pressed.force_map.is_none());
    }

    #[test]
    fn a_force_without_a_point_under_it_goes_to_the_nearest() {
        let surface = skin_with("").surface();
        let mut contact = Contact::at(Point3::new(0.001, 0.0, 0.0), Vector3::z());
        contact.force = Vector3::new(0.3, 0.0, -2.0);
        contact.diameter = 0.001;
        let forces = spread(&surface, &[contact]);
        assert_eq!(forces.iter().filter(|f| **f > 0.0).count(), 1);
        assert!((forces.iter().sum::<f32>() - 2.0).abs() < 1e-6);
    }

    #[test]
    fn a_tare_that_is_told_to_leaves_identities_and_takes_a_new_zero() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        assert_eq!(press(&mut estimator, 80, [2000.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 1);
        Estimator::tare(&mut estimator);
        assert!(press(&mut estimator, 81, [400.0, 0.0, 0.0, 0.0]).contacts.is_empty());
        assert_eq!(estimator.verdict().quality, Quality::Uncalibrated, "the old zero is known to be wrong");
        for k in 82..140 {
            press(&mut estimator, k, [400.0, 0.0, 0.0, 0.0]);
        }
        assert!((estimator.zero().unwrap()[0] - 101_725.0).abs() < 10.0);
        assert_eq!(press(&mut estimator, 140, [2400.0, 0.0, 0.0, 0.0]).contacts[0].track_id, 2);
    }

    #[test]
    fn a_model_with_history_never_sees_two_zeros_at_once() {
        let bundle = TestBundle { taps: vec![0, 5], ..TestBundle::default() };
        let (mut estimator, _dir) = tared_estimator(&bundle);
        estimator.begin_tare(false).unwrap();
        let mut k = 80;
        while estimator.tare_state() != TareState::Done {
            press(&mut estimator, k, [0.0; 4]);
            k += 1;
        }
        press(&mut estimator, k, [2000.0, 0.0, 0.0, 0.0]);
        assert!(estimator.verdict().text.starts_with("touched, but"), "{}", estimator.verdict().text);
    }

    #[test]
    fn frames_of_another_skin_are_refused() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        let error = estimator.estimate(&Frame::new(0, 9, vec![0.0; 5])).unwrap_err().to_string();
        assert_eq!(error, "frame 9 has 5 channels where the skin has 4");
    }

    #[test]
    fn a_history_that_is_not_filled_is_no_untouched_skin() {
        let bundle = TestBundle { taps: vec![0, 5], ..TestBundle::default() };
        let (mut estimator, _dir) = tared_estimator(&bundle);
        // A pause of a second empties the history.
        let estimate = press(&mut estimator, 200, [2000.0, 0.0, 0.0, 0.0]);
        assert!(estimate.contacts.is_empty());
        assert_eq!(estimator.verdict().quality, Quality::Uncalibrated);
        assert!(estimator.verdict().text.starts_with("touched, but"));
        for k in 201..206 {
            press(&mut estimator, k, [2000.0, 0.0, 0.0, 0.0]);
        }
        assert_eq!(estimator.verdict().quality, Quality::Ok);
    }
}
