//! `bundle.toml`: what a bundle says about itself.

use std::borrow::Cow;
use std::collections::BTreeMap;

use dermis_inversion::Settings;
use dermis_io::toml::Fault;
use dermis_skin::{ImageGrid, SkinDescription};
use serde::{Deserialize, Serialize};

use crate::correction::CorrectionSection;
use crate::features::{FeatureConfig, FeatureError};
use crate::force_peaks::{ForcePeakSection, MAP_NORMAL};
use crate::interface::{Interface, elements};
use crate::outputs::{OutputConfig, OutputError};
use crate::peaks::{MAP_DISPLACEMENT, PeakSection};

pub use error::ManifestError;

// Named by its path because the fuzz workspace includes this file alone.
#[path = "manifest/error.rs"]
mod error;

const SCHEMA_STEM: &str = "dermis-bundle/";
const SCHEMA_VERSION: u32 = 1;

/// Which readings the model was trained on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Baseline {
    /// As the device gives them, in the unit of the skin.
    Raw,
    /// Minus the untouched reading, drift followed.
    Tared,
}

/// The skin that a model was trained for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkinSection {
    /// Name of the type.
    pub name: String,
    /// Its [hash](SkinDescription::hash); that of earlier versions covered `name`.
    pub hash: String,
    /// Unit of its readings.
    pub unit: String,
    /// Names of its channels, in order.
    pub channels: Vec<String>,
}

impl SkinSection {
    /// What a bundle says about this skin.
    #[must_use]
    pub fn of(skin: &SkinDescription) -> Self {
        Self {
            name: skin.type_name().to_owned(),
            hash: skin.hash(),
            unit: skin.unit.clone(),
            channels: skin.channels().iter().map(|c| c.name.clone()).collect(),
        }
    }
}

/// The file of the graph.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ModelSection {
    /// Its length in bytes.
    pub bytes: u64,
    /// `sha256:` and 64 hex digits over its content.
    pub hash: String,
    /// What goes in and what comes out.
    pub interface: Interface,
}

/// A file beside the manifest.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FileSection {
    /// Its length in bytes.
    pub bytes: u64,
    /// `sha256:` and 64 hex digits over its content.
    pub hash: String,
}

/// Where a model comes from.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TrainingSection {
    /// Hash of the data it was trained on.
    pub data_hash: String,
    /// Seed of every random choice, at most 2⁶³ − 1.
    pub seed: u64,
    /// Frames trained on.
    pub samples: u64,
    /// What was held out to measure the metrics.
    #[serde(default)]
    pub held_out: String,
}

/// What a bundle says about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    schema: String,
    /// What the model is called.
    pub name: String,
    /// Free text.
    #[serde(default)]
    pub description: String,
    /// Which readings it takes.
    pub baseline: Baseline,
    /// \[N\] least and largest normal force that it was trained on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_range: Option<[f64; 2]>,
    /// The skin it was trained for.
    pub skin: SkinSection,
    /// The graph; where absent, contacts are found on the skin's forward model alone, as `inversion` says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelSection>,
    /// How frames become its input; left out where there is no graph.
    #[serde(default = "FeatureConfig::none", skip_serializing_if = "FeatureConfig::is_none")]
    pub input: FeatureConfig,
    /// The file that holds mean and scale of the channels, where they are many; `input` holds them where absent. A bundle
    /// that was read has them in `input`, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normalisation: Option<FileSection>,
    /// What its output means; left out where there is no graph.
    #[serde(default = "OutputConfig::none", skip_serializing_if = "OutputConfig::is_empty")]
    pub output: OutputConfig,
    /// Where it comes from.
    pub training: TrainingSection,
    /// Refines the model's answer on the skin's forward model, with these settings; the model only where absent. Where there is no model,
    /// finds contacts on the forward model alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inversion: Option<Settings>,
    /// How the device differs from that forward model; it is as designed where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correction: Option<CorrectionSection>,
    /// Reads contacts off the displacement map that the model gives; it gives none where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peaks: Option<PeakSection>,
    /// Reads contacts off the force map that the model gives; it gives none where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_peaks: Option<ForcePeakSection>,
    /// Measured on what was held out; names end in their unit, e.g. `position_rmse_m`.
    #[serde(default)]
    pub metrics: BTreeMap<String, f64>,
}

impl Manifest {
    /// A manifest of this format for a skin; metrics, ranges and the graph's length and hash are still empty.
    #[must_use]
    pub fn new(
        name: impl Into<String>,
        skin: &SkinDescription,
        baseline: Baseline,
        input: FeatureConfig,
        output: OutputConfig,
        training: TrainingSection,
    ) -> Self {
        let interface = Interface::flat(input.input_len(), output.len());
        Self {
            schema: format!("{SCHEMA_STEM}{SCHEMA_VERSION}"),
            name: name.into(),
            description: String::new(),
            baseline,
            force_range: None,
            skin: SkinSection::of(skin),
            model: Some(ModelSection { interface, ..Default::default() }),
            input,
            normalisation: None,
            output,
            training,
            inversion: None,
            correction: None,
            peaks: None,
            force_peaks: None,
            metrics: BTreeMap::new(),
        }
    }

    /// A manifest of this format for a skin whose contacts are found on its forward model alone, as `settings` say.
    #[must_use]
    pub fn of_inversion(
        name: impl Into<String>,
        skin: &SkinDescription,
        settings: Settings,
        training: TrainingSection,
    ) -> Self {
        let (input, output) = (FeatureConfig::none(), OutputConfig::none());
        let manifest = Self::new(name, skin, Baseline::Tared, input, output, training);
        Self { model: None, inversion: Some(settings), ..manifest }
    }

    /// Reads a manifest; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// [`ManifestError`] names the field and what is wrong with it.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, ManifestError> {
        let wrong = |fault: Fault| match fault {
            Fault::UnknownKey { key } => ManifestError::UnknownKey { file: file.to_owned(), key },
            fault => {
                let (field, reason) = fault.into_field();
                ManifestError::Parse { file: file.to_owned(), field, reason }
            }
        };
        let table = dermis_io::toml::table(text).map_err(wrong)?;
        // The schema comes first: a newer file may have any field.
        check_schema(table.get("schema"), file)?;
        let manifest: Self = dermis_io::toml::of_table(table).map_err(wrong)?;
        manifest.validate(file)?;
        Ok(manifest)
    }

    /// How many numbers a frame gives the model: the channels of the skin, or those of an image.
    pub(crate) fn numbers(&self) -> usize {
        self.input.image.map_or(self.skin.channels.len(), |grid| grid.numbers())
    }

    /// The input, with stand-ins for mean and scale while these are in a file that was not read yet.
    fn whole_input(&self) -> Cow<'_, FeatureConfig> {
        if self.normalisation.is_none() || !self.input.mean.is_empty() || !self.input.scale.is_empty() {
            return Cow::Borrowed(&self.input);
        }
        let mut input = self.input.clone();
        // A grid that is too large is refused by its own name.
        let numbers = if self.input.image.is_some_and(|grid| grid.numbers() > ImageGrid::MOST) {
            1
        } else {
            self.numbers()
        };
        input.mean = vec![0.0; numbers];
        input.scale = vec![1.0; numbers];
        Cow::Owned(input)
    }

    /// As it is written: mean and scale are in their file, where there is one.
    pub(crate) fn written(&self) -> Cow<'_, Self> {
        if self.normalisation.is_none() {
            return Cow::Borrowed(self);
        }
        let mut written = self.clone();
        written.input.mean.clear();
        written.input.scale.clear();
        Cow::Owned(written)
    }

    /// Says what is impossible; `file` is what errors call the manifest.
    ///
    /// # Errors
    ///
    /// [`ManifestError::Impossible`] names the field.
    pub fn validate(&self, file: &str) -> Result<(), ManifestError> {
        let wrong = |field: &str, reason: String| {
            Err(ManifestError::Impossible { file: file.to_owned(), field: field.to_owned(), reason })
        };
        if self.name.is_empty() {
            return wrong("name", "is empty".into());
        }
        if !is_hash(&self.skin.hash) {
            return wrong("skin.hash", "must be `sha256:` and 64 hex digits".into());
        }
        match &self.model {
            Some(model) => self.check_model(model, &wrong)?,
            None => self.check_without_model(&wrong)?,
        }
        if let Some([low, high]) = self.force_range
            && !(low.is_finite() && high.is_finite() && low < high)
        {
            return wrong("force_range", format!("[{low}, {high}] is empty: low must be below high"));
        }
        if let Some(settings) = &self.inversion
            && let Err(error) = settings.check(self.skin.channels.len())
        {
            return wrong("inversion", error.to_string());
        }
        if let Some(correction) = &self.correction {
            if let Err((field, reason)) = correction.check() {
                return wrong(&format!("correction.{field}"), reason);
            }
            if self.inversion.is_none() {
                return wrong("correction", "there is no `inversion` whose forward model it corrects".into());
            }
        }
        if let Err((field, reason)) = self.check_peaks() {
            return wrong(&field, reason);
        }
        if self.training.seed > i64::MAX.cast_unsigned() {
            return wrong("training.seed", "is beyond 2^63 - 1, the largest number that TOML has".into());
        }
        if let Some((name, _)) = self.metrics.iter().find(|(_, value)| !value.is_finite()) {
            return wrong(&format!("metrics.{name}"), "must be a finite number".into());
        }
        Ok(())
    }

    /// Says what is impossible of a graph, what goes in and what comes out.
    fn check_model(
        &self,
        model: &ModelSection,
        wrong: &dyn Fn(&str, String) -> Result<(), ManifestError>,
    ) -> Result<(), ManifestError> {
        let input = self.whole_input();
        if let Err(FeatureError::Impossible { field, reason }) = input.validate() {
            return wrong(&format!("input.{field}"), reason);
        }
        if let Err(OutputError::Impossible { field, reason }) = self.output.validate() {
            return wrong(&format!("output.{field}"), reason);
        }
        if !is_hash(&model.hash) {
            return wrong("model.hash", "must be `sha256:` and 64 hex digits".into());
        }
        if let Some(section) = &self.normalisation
            && !is_hash(&section.hash)
        {
            return wrong("normalisation.hash", "must be `sha256:` and 64 hex digits".into());
        }
        if self.numbers() != input.channels() {
            return wrong(
                "input.mean",
                format!(
                    "has {} entries where `skin.channels` names {}",
                    input.channels(),
                    self.skin.channels.len()
                ),
            );
        }
        let interface = &model.interface;
        let sides = [
            // Further inputs are tensors that the sensor's estimator fills: an image, say.
            (
                "input_shape",
                &interface.input_shape,
                elements(&interface.input_shape),
                "[input]",
                input.input_len(),
            ),
            ("output_shape", &interface.output_shape, interface.output_len(), "[output]", self.output.len()),
        ];
        for (field, ports) in
            [("more_inputs", &interface.more_inputs), ("more_outputs", &interface.more_outputs)]
        {
            for (i, port) in ports.iter().enumerate() {
                if port.shape.first() != Some(&1) || elements(&port.shape).is_none() {
                    return wrong(
                        &format!("model.interface.{field}[{i}].shape"),
                        format!(
                            "is {:?} and must have batch 1 and a sensible number of elements",
                            port.shape
                        ),
                    );
                }
            }
        }
        for (field, shape, len, table, expected) in sides {
            if shape.first() != Some(&1) || len != Some(expected) {
                return wrong(
                    &format!("model.interface.{field}"),
                    format!("is {shape:?} where {table} takes batch 1 and {expected} numbers"),
                );
            }
        }
        Ok(())
    }

    /// Says what is impossible where there is no graph.
    fn check_without_model(
        &self,
        wrong: &dyn Fn(&str, String) -> Result<(), ManifestError>,
    ) -> Result<(), ManifestError> {
        if self.inversion.is_none() {
            let reason = "is missing, and so is `inversion`: a bundle has at least one of the two to find contacts with";
            return wrong("model", reason.into());
        }
        let graph = [
            ("input", self.input.is_none()),
            ("normalisation", self.normalisation.is_none()),
            ("output", self.output.is_empty()),
            ("peaks", self.peaks.is_none()),
            ("force_peaks", self.force_peaks.is_none()),
        ];
        match graph.into_iter().find(|(_, absent)| !absent) {
            Some((field, _)) => wrong(
                field,
                "speaks of a graph, and there is no `[model]`; remove one or add the other".into(),
            ),
            None => Ok(()),
        }
    }
}

impl Manifest {
    /// Says what is impossible of how contacts are read off maps: field and reason.
    fn check_peaks(&self) -> Result<(), (String, String)> {
        let gives = |output: &str| match self.output.values.iter().any(|v| v.name == output) {
            true => Ok(()),
            false => Err(format!("there is no output `{output}` to read them off")),
        };
        if let Some(peaks) = &self.peaks {
            peaks.check().map_err(|(field, reason)| (format!("peaks.{field}"), reason))?;
            if !is_hash(&peaks.sensitivity.hash) {
                let reason = "must be `sha256:` and 64 hex digits".into();
                return Err(("peaks.sensitivity.hash".into(), reason));
            }
            gives(MAP_DISPLACEMENT).map_err(|reason| ("peaks".into(), reason))?;
        }
        if let Some(peaks) = &self.force_peaks {
            peaks.check().map_err(|(field, reason)| (format!("force_peaks.{field}"), reason))?;
            if self.peaks.is_some() {
                let reason = "`peaks` reads contacts off another map already; keep one of the two tables";
                return Err(("force_peaks".into(), reason.into()));
            }
            gives(MAP_NORMAL).map_err(|reason| ("force_peaks".into(), reason))?;
        }
        Ok(())
    }
}

fn check_schema(schema: Option<&toml::Value>, file: &str) -> Result<(), ManifestError> {
    let wrong = |reason: String| ManifestError::Impossible {
        file: file.to_owned(),
        field: "schema".to_owned(),
        reason,
    };
    let Some(schema) = schema else {
        return Err(wrong(format!(
            "is missing; this program reads \"{SCHEMA_STEM}{SCHEMA_VERSION}\", so the file is no bundle of it"
        )));
    };
    let version = schema
        .as_str()
        .and_then(|s| s.strip_prefix(SCHEMA_STEM))
        .and_then(|version| version.parse::<u32>().ok());
    match version {
        Some(SCHEMA_VERSION) => Ok(()),
        Some(newer) if newer > SCHEMA_VERSION => {
            Err(ManifestError::Newer { file: file.to_owned(), found: format!("{SCHEMA_STEM}{newer}") })
        }
        _ => Err(wrong(format!("is {schema} where this program reads \"{SCHEMA_STEM}{SCHEMA_VERSION}\""))),
    }
}

pub(crate) fn is_hash(text: &str) -> bool {
    text.strip_prefix("sha256:")
        .is_some_and(|hex| hex.len() == 64 && hex.bytes().all(|b| b.is_ascii_hexdigit()))
}
