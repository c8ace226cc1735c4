//! Loaded model bundles: each gives some of the outputs, from the same conditioned frames.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use dermis_inference::{
    Baseline, Bundle, BundleError, Features, MAP_DISPLACEMENT, MAP_NORMAL, Model, Outputs, Runtime,
};
use dermis_inversion::{Corrected, Inverter, InverterError, Search, Settings};
use dermis_model::{ForwardModel, Stimulus, Unknowns};
use dermis_sensor::Sensor;
use dermis_skin::{ModelError, SkinDescription, Surface};

use crate::condition::ConditionError;
use crate::estimator::Maps;
use crate::finder::{ConditionedFrame, FindError, Peaks};

/// Output that gives x, y and z of the force at every point of the surface \[N\].
pub(crate) const MAP_FORCE: &str = "map.force";
/// Share of the largest force that a light press has.
const LIGHT: f64 = 0.1;

/// What stands in the place of a bundle's folder where there is none.
const NO_BUNDLE: &str = "no bundle";
/// Contacts that are looked for without a bundle, at most.
const MOST_CONTACTS: usize = 6;
/// Channels that each unknown of a contact shall have, at least, where nobody measured how many contacts can be distinguished.
const CHANNELS_EACH: usize = 4;
/// Channels from which on each place of a skin has a pattern of its own, shear included, where nobody measured it: those of pictures.
const PICTURED: usize = 1000;
/// Standard deviation of shear along each direction over the pressing force, before a frame is read: half of what presses (thesis, section
/// 6.4.6) is then rarely exceeded, and slipping at a friction of 1 hardly ever.
const SHEAR: f64 = 0.3;
/// Widest tip that is tried where the one that the skin is built for does not fit, in diameters of that one.
const WIDEST: f64 = 4.0;
/// Share by which a device and its forward model differ where nobody measured it: gains, and what the medium remembers.
const UNMEASURED: f64 = 0.02;

/// Whether a skin's channels are so many that each place has a pattern of its own: those of pictures.
#[must_use]
pub fn is_pictured(skin: &SkinDescription) -> bool {
    skin.channels().len() >= PICTURED
}

/// How contacts are looked for on a skin's forward model alone: those of the tip and the forces that the skin is built for, one after
/// the other.
#[must_use]
pub fn settings_without_bundle(skin: &SkinDescription, model: &dyn ForwardModel) -> Settings {
    let rated = skin.rated_press();
    let mut settings = Settings::new(rated.diameter, STRONGER * rated.force[1]);
    if is_pictured(skin) {
        (settings.unknowns, settings.search) = (Unknowns::Full, Search::Near);
        settings.shear = Some(SHEAR);
        settings.widest = Some(WIDEST * rated.diameter);
    }
    let unknowns = settings.unknowns.count();
    settings.contacts = (skin.channels().len() / (CHANNELS_EACH * unknowns)).clamp(1, MOST_CONTACTS);
    settings.tip = rated.tip;
    settings.distance = settings.distance.max(rated.diameter);
    settings.model_error = UNMEASURED;
    if settings.contacts > 1 && !model.superposes() {
        // All contacts are refined together there, which takes long: this search follows them from frame to frame.
        settings.search = Search::Pairs;
    }
    settings
}

/// Factor of the strongest press that a skin is built for: what presses a little harder is not taken for another contact.
const STRONGER: f64 = 1.2;

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
    /// Two bundles take images of different sizes.
    #[error(
        "model bundles {first} and {second} take images of different sizes (`input.image`), and one is made of every frame; \
         load only one of them, or train them on images of one size"
    )]
    OtherImage {
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
    /// A skin without a bundle that has no forward model to invert either.
    #[error("skin `{skin}`: there is no model bundle, and no forward model to find contacts on: {source}")]
    NotInvertible {
        /// Name of the skin.
        skin: String,
        /// Why there is none.
        source: ModelError,
    },
    /// A skin whose frames cannot be checked.
    #[error(transparent)]
    FrameCheck(ModelError),
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
    /// A bundle that gives no map to read contacts off.
    #[error(
        "model bundle {path}: bundle.toml has no `[peaks]` and no `[force_peaks]`: train one with `dermis real2sim train`, or one \
         that draws forces"
    )]
    NoPeaks {
        /// Folder of the bundle.
        path: PathBuf,
    },
}

/// The inverter that a bundle asks for on a skin's forward model, with the bundle's correction; `None` where its manifest has
/// no `inversion`.
///
/// # Errors
///
/// [`SetupError`] where there is no such model, or the bundle's correction or settings do not fit it.
pub fn inverter(
    bundle: &Bundle,
    model: impl FnOnce() -> Result<Arc<dyn ForwardModel>, ModelError>,
) -> Result<Option<Inverter>, SetupError> {
    let path = || bundle.path().to_owned();
    let Some(settings) = &bundle.manifest().inversion else { return Ok(None) };
    let mut model = model().map_err(|source| SetupError::NoForwardModel { path: path(), source })?;
    if let Some(correction) = bundle.correction() {
        let corrected = Corrected::new(model, correction.clone())
            .map_err(|source| SetupError::Correction { path: path(), source })?;
        model = Arc::new(corrected);
    }
    let inverter = Inverter::new(model, settings.clone())
        .map_err(|source| SetupError::Inversion { path: path(), source })?;
    Ok(Some(inverter))
}

/// A model that is no bundle yet: one that was just trained, or that somebody else made.
pub struct UnpackedModel {
    /// Where it lies or will lie, for whoever reads an error.
    pub path: PathBuf,
    /// The graph.
    pub model: Model,
    /// What its output means.
    pub outputs: Outputs,
    /// How frames become its input.
    pub features: Features,
    /// Which readings it takes.
    pub baseline: Baseline,
}

/// One loaded bundle.
pub(crate) struct Pipeline {
    pub(crate) path: PathBuf,
    pub(crate) name: String,
    pub(crate) baseline: Baseline,
    pub(crate) force_range: Option<[f64; 2]>,
    pub(crate) features: Features,
    /// `None` where there is nothing but a forward model.
    pub(crate) model: Option<Model>,
    pub(crate) raw: Vec<f32>,
    pub(crate) outputs: Outputs,
    pub(crate) fresh: bool,
    /// Reads contacts off the map that it gives.
    pub(crate) peaks: Option<Peaks>,
    /// Refines what it says on the skin's forward model.
    pub(crate) inverter: Option<Arc<Inverter>>,
    /// \[N\] and the share of the surface where so light a press cannot be detected, by that model.
    pub(crate) undetectable_fraction: Option<(f64, f64)>,
    /// That model knows how far the surface gives way.
    pub(crate) displaces: bool,
    /// It has been called before, which may take seconds the first time: whether it has answered.
    pub(crate) answered: Option<Arc<AtomicBool>>,
}

impl Pipeline {
    /// A model on its own: what it takes and gives, and where it lies for whoever reads an error.
    fn of_model(
        path: PathBuf,
        (features, baseline): (Features, Baseline),
        (model, outputs): (Option<Model>, Outputs),
        surface: &Surface,
    ) -> Result<Self, SetupError> {
        let points = surface.points.len();
        for (output, expected) in [(MAP_NORMAL, points), (MAP_FORCE, 3 * points), (MAP_DISPLACEMENT, points)]
        {
            if let Some(values) = outputs.values(output)
                && values.len() != expected
            {
                return Err(SetupError::Output {
                    path,
                    output: output.into(),
                    reason: format!(
                        "has {} numbers where the surface needs {expected}; was `surface.spacing` changed?",
                        values.len()
                    ),
                });
            }
        }
        Ok(Self {
            name: String::new(),
            force_range: None,
            peaks: None,
            inverter: None,
            undetectable_fraction: None,
            displaces: false,
            answered: None,
            raw: Vec::new(),
            fresh: false,
            path,
            baseline,
            features,
            model,
            outputs,
        })
    }

    /// A model that is no bundle yet, on a surface.
    pub(crate) fn unpacked(unpacked: UnpackedModel, surface: &Surface) -> Result<Self, SetupError> {
        let UnpackedModel { path, model, outputs, features, baseline } = unpacked;
        Self::of_model(path, (features, baseline), (Some(model), outputs), surface)
    }

    /// A bundle on a surface, without the forward model that it may ask for.
    pub(crate) fn of(bundle: &Bundle, surface: &Surface, runtime: &Runtime) -> Result<Self, SetupError> {
        let manifest = bundle.manifest();
        let peaks = Peaks::of(bundle, surface, runtime)?;
        let input = (bundle.features(), manifest.baseline);
        let output = (bundle.session(runtime)?, bundle.outputs());
        let pipeline = Self::of_model(bundle.path().to_owned(), input, output, surface)?;
        let points = surface.points.len();
        let weights = manifest.peaks.as_ref().map_or(0, |peaks| peaks.weights.len());
        if weights != 0 && weights != points {
            return Err(SetupError::Output {
                path: pipeline.path,
                output: MAP_DISPLACEMENT.into(),
                reason: format!(
                    "`peaks.weights` has {weights} numbers where the surface needs {points}; was `surface.spacing` changed?"
                ),
            });
        }
        Ok(Self { name: manifest.name.clone(), force_range: manifest.force_range, peaks, ..pipeline })
    }

    fn new(
        sensor: &dyn Sensor,
        skin: &SkinDescription,
        bundle: &Bundle,
        runtime: &Runtime,
    ) -> Result<Self, SetupError> {
        let pipeline = Self::of(bundle, &skin.surface(), runtime)?;
        Ok(match inverter(bundle, || sensor.model(skin))? {
            Some(inverter) => pipeline.refined_by(inverter),
            None => pipeline,
        })
    }

    /// Nothing but the inversion of a skin's forward model.
    fn inverted(sensor: &dyn Sensor, skin: &SkinDescription) -> Result<Self, SetupError> {
        let path = PathBuf::from(NO_BUNDLE);
        let model = sensor
            .model(skin)
            .map_err(|source| SetupError::NotInvertible { skin: skin.name.clone(), source })?;
        let settings = settings_without_bundle(skin, model.as_ref());
        let force_range = Some([0.0, settings.force_max]);
        let inverter = Inverter::new(model, settings)
            .map_err(|source| SetupError::Inversion { path: path.clone(), source })?;
        let features = Features::as_read(skin.channels().len());
        let pipeline =
            Self::of_model(path, (features, Baseline::Tared), (None, Outputs::none()), &skin.surface())?;
        Ok(Self { name: Models::INVERSION.into(), force_range, ..pipeline }.refined_by(inverter))
    }

    /// The same with its answers refined.
    fn refined_by(self, inverter: Inverter) -> Self {
        let model = inverter.model();
        let mut points = vec![0.0; model.surface().points.len()];
        let displaces = matches!(model.displacement(&Stimulus::default(), &mut points), Ok(true));
        let force = LIGHT * inverter.settings().force_max;
        let fraction = Some((force, inverter.undetectable_fraction(force, inverter.settings().presence)));
        Self { inverter: Some(Arc::new(inverter)), undetectable_fraction: fraction, displaces, ..self }
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.outputs.config().values.iter().map(|v| v.name.as_str())
    }

    /// Evaluates the model on the newest frame; `false` while its history is not filled.
    pub(crate) fn infer(&mut self) -> Result<bool, String> {
        let Some(model) = &mut self.model else {
            self.fresh = true;
            return Ok(true);
        };
        let Some(input) = self.features.input() else { return Ok(false) };
        model
            .run(input, &mut self.raw)
            .map_err(|e| e.to_string())
            .and_then(|()| self.outputs.decode(&self.raw).map_err(|e| e.to_string()))
            .map_err(|reason| format!("model {}: {reason}", self.path.display()))?;
        self.fresh = true;
        Ok(true)
    }

    /// Takes a frame into the history.
    pub(crate) fn take(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        let values = match (self.features.config().image.is_some(), self.baseline) {
            (false, Baseline::Raw) => frame.reading,
            (false, Baseline::Tared) => frame.signal,
            (true, Baseline::Raw) => frame.image,
            (true, Baseline::Tared) => frame.image_signal,
        };
        Ok(self.features.push(frame.stamp, values)?)
    }

    /// Takes a frame and evaluates the model on it.
    pub(crate) fn answer(&mut self, frame: &ConditionedFrame<'_>) -> Result<(), FindError> {
        self.take(frame)?;
        match self.infer() {
            Ok(true) => Ok(()),
            Ok(false) => Err(FindError::History(self.path.display().to_string())),
            Err(reason) => Err(FindError::Model(reason)),
        }
    }
}

/// Loaded bundles that share the work: each gives some of the outputs.
pub struct Models(pub(crate) Vec<Pipeline>);

impl Models {
    /// Loads bundles into a runtime; takes a moment, and seconds where a bundle wants its answers refined on a forward
    /// model that is computed by finite elements.
    ///
    /// # Errors
    ///
    /// [`SetupError`] where a graph is refused, two bundles give the same output, or a force map does not fit the
    /// surface.
    pub fn load(
        sensor: &dyn Sensor,
        skin: &SkinDescription,
        bundles: &[Bundle],
        runtime: &Runtime,
    ) -> Result<Self, SetupError> {
        let mut models = Self(Vec::new());
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
            let image = |p: &Pipeline| p.features.config().image;
            let other = |p: &&Pipeline| image(p).is_some() && image(p) != image(&pipeline);
            if let Some(other) = models.0.iter().find(other).filter(|_| image(&pipeline).is_some()) {
                return Err(SetupError::OtherImage { first: other.path.clone(), second: pipeline.path });
            }
            models.0.push(pipeline);
        }
        Ok(models)
    }

    /// What stands for the name of a bundle where there is none.
    pub const INVERSION: &'static str = "inversion of the forward model";

    /// What finds contacts without a bundle: maximum likelihood on the skin's forward model, as [`settings_without_bundle`] says. Takes
    /// some thousand responses of the model, and what it takes to compute that.
    ///
    /// # Errors
    ///
    /// [`SetupError::NotInvertible`] where the skin has no forward model.
    pub fn inverted(sensor: &dyn Sensor, skin: &SkinDescription) -> Result<Self, SetupError> {
        Ok(Self(vec![Pipeline::inverted(sensor, skin)?]))
    }

    /// Maps that can be had with them.
    #[must_use]
    pub fn maps(&self) -> Maps {
        maps(&self.0)
    }

    /// Maps that they give by themselves, and that are not made of contacts.
    #[must_use]
    pub fn own_maps(&self) -> Maps {
        Maps {
            force: gives(&self.0, &[MAP_NORMAL, MAP_FORCE]),
            displacement: gives(&self.0, &[MAP_DISPLACEMENT]),
        }
    }
}

pub(crate) fn gives(pipelines: &[Pipeline], outputs: &[&str]) -> bool {
    pipelines.iter().flat_map(Pipeline::names).any(|n| outputs.contains(&n))
}

/// What a model gives as it is comes before what a forward model makes of contacts.
pub(crate) fn maps(pipelines: &[Pipeline]) -> Maps {
    Maps {
        force: gives(pipelines, &[MAP_NORMAL, MAP_FORCE])
            || pipelines.iter().any(|p| p.inverter.is_some() || p.peaks.is_some()),
        displacement: gives(pipelines, &[MAP_DISPLACEMENT]) || pipelines.iter().any(|p| p.displaces),
    }
}
