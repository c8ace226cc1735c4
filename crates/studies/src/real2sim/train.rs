//! Recorded single contacts → a bundle that gives displacement maps, and contacts as their peaks.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use clap::Args;
use dermis_inference::{
    Baseline, BundleWriter, FeatureConfig, MAP_DISPLACEMENT, Manifest, OutputConfig, OutputSpec, Runtime,
    RuntimeConfig, TrainingSection,
};
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::{Compliance, Pipeline, Recorded, Scenes, Settings, Trained, train};
use dermis_learn::target::Maps;
use dermis_learn::{Dataset, Evaluation, Evaluator, SampleId};
use dermis_model::ForwardModel;
use dermis_skin::{DisplacementMap, Estimate, SkinDescription};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use super::{nominal, sensors, watched};
use crate::{Families, Progress, labelled};

/// What to learn from.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description; its forward model must know displacements.
    #[arg(long)]
    pub skin: PathBuf,
    /// Settings (TOML); see `launch/real2sim/`.
    #[arg(long)]
    pub settings: Option<PathBuf>,
    /// Folder of the bundle.
    #[arg(short, long)]
    pub out: PathBuf,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// Labelled bags with single contacts of the device.
    #[arg(required = true)]
    pub bags: Vec<PathBuf>,
}

/// What was learned.
pub struct Findings {
    /// Of the pipeline.
    pub trained: Trained,
    /// Errors on contacts that were held out.
    pub evaluation: Evaluation,
    /// \[s\] that it took.
    pub seconds: f64,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        json!({ "trained": self.trained, "held_out": self.evaluation, "seconds": self.seconds })
            .serialize(serializer)
    }
}

/// Trains and writes the bundle.
///
/// # Errors
///
/// Where skin, settings or bags cannot be read, or the bundle cannot be written.
pub fn learn(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let settings = Settings::load(options.settings.as_deref())?;
    let (skin, model) = nominal(&options.skin, families, progress)?;
    let data = labelled(&options.bags, &skin, &options.labels.options()?, progress)?;
    let split = settings.split.apply(&data)?;
    let (learn, choose) = parts(&data, &split.train);
    let compliance = Compliance::of(model.as_ref(), settings.scenes.diameter)?;
    // What presses where nothing gives way shows in no reading.
    let detectable = |ids: &[SampleId], most: usize| {
        let mut all = Recorded::of(&data, ids, settings.least, most)?;
        all.retain(|r| compliance.gives_way(&r.contact.position));
        anyhow::Ok(all)
    };
    let recorded = detectable(&learn, settings.most)?;
    let choose = detectable(&choose, settings.most / 4)?;
    let scenes = Scenes::new(model.as_ref(), &settings.scenes)?;
    let sensors = sensors(&model, &skin, settings.pipeline.each)?;
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let started = std::time::Instant::now();
    let (pipeline, trained) = train(
        &model,
        &sensors,
        &scenes,
        (&recorded, &choose),
        &settings.pipeline,
        runtime,
        &watched(progress),
    )?;
    let seconds = started.elapsed().as_secs_f64();
    progress.begin("held-out contacts");
    let course = Course { settings: &settings, skin: &skin, model: &model, data: &data };
    let evaluation = course.evaluate(&pipeline, &compliance, &split.test, runtime)?;
    let mut writer = BundleWriter::new(course.manifest(&pipeline, recorded.len(), &evaluation));
    writer.sensitivity = Some(pipeline.sensitivity_onnx()?);
    writer.card = dermis_learn::card::of_data(&data)?;
    let card = [
        ("real2sim", json!(trained)),
        ("settings", json!(settings)),
        ("split", json!(settings.split)),
        ("split_in_words", json!(settings.split.describe())),
        ("seed", json!(settings.scenes.seed)),
        ("held_out", evaluation.to_json()),
        ("fit_seconds", json!(seconds)),
    ];
    writer.card.extend(card.into_iter().map(|(key, value)| (key.to_owned(), value)));
    writer.write(&options.out, &pipeline.to_onnx()?)?;
    Ok(Findings { trained, evaluation, seconds })
}

/// What a pipeline was trained on.
struct Course<'a> {
    settings: &'a Settings,
    skin: &'a SkinDescription,
    model: &'a Arc<dyn ForwardModel>,
    data: &'a Dataset,
}

impl Course<'_> {
    /// Errors on contacts that were held out, where the surface gives way and the force is one that was learned.
    fn evaluate(
        &self,
        pipeline: &Pipeline,
        compliance: &Compliance,
        held_out: &[SampleId],
        runtime: &Runtime,
    ) -> Result<Evaluation> {
        let Self { settings, skin, model, data } = *self;
        let mut reader = pipeline.contacts(model.surface(), runtime)?;
        let mut evaluator = Evaluator::of(data).with_maps(Maps::new(skin, Some(Arc::clone(model)), &[])?);
        for (id, sample) in data.gather(held_out)? {
            let Some(truth) = sample.truth.as_ref().filter(|t| t.touched()) else { continue };
            let heavy =
                |c: &dermis_learn::TruthContact| c.normal_force().is_some_and(|f| f >= settings.least);
            let rigid = truth.contacts.iter().any(|c| !compliance.gives_way(&c.position));
            if rigid || !truth.contacts.iter().all(heavy) || sample.tared.iter().any(|v| !v.is_finite()) {
                continue;
            }
            let map = pipeline.map(&sample.tared)?;
            let displacements = map.iter().map(|d| *d as f32).collect();
            let estimate = Estimate {
                contacts: reader.contacts(&map)?,
                displacement_map: Some(DisplacementMap { indices: None, displacements }),
                ..Estimate::default()
            };
            evaluator.push(id, truth, &estimate);
            evaluator.push_maps(truth, &estimate)?;
        }
        Ok(evaluator.finish(settings.split.describe()))
    }

    /// What the bundle of a pipeline says of itself, which was trained with so many recorded contacts.
    fn manifest(&self, pipeline: &Pipeline, recorded: usize, evaluation: &Evaluation) -> Manifest {
        let Self { settings, skin, model, data } = *self;
        let channels = skin.channels().len();
        let features = FeatureConfig::newest(vec![0.0; channels], vec![pipeline.input_scale(); channels]);
        let mut map = OutputSpec::new(MAP_DISPLACEMENT, "m", 0.0, f64::from(pipeline.output_scale()));
        map.count = model.surface().points.len();
        let training = TrainingSection {
            data_hash: data.hash(),
            seed: settings.scenes.seed,
            samples: recorded as u64,
            held_out: settings.split.describe(),
        };
        let mut manifest = Manifest::new(
            format!("{}-real2sim", skin.name),
            skin,
            Baseline::Tared,
            features,
            OutputConfig { values: vec![map] },
            training,
        );
        manifest.description.clone_from(&settings.description);
        manifest.force_range = Some([settings.least, settings.scenes.force[1]]);
        let rms = |name: &str| evaluation.quantities.get(name).map(|s| s.rms);
        let mut section = pipeline.section();
        // Both tangents share the squares of a distance.
        section.position_sigma = rms("position").map(|r| r / std::f64::consts::SQRT_2);
        section.force_sigma = rms("force.normal");
        manifest.peaks = Some(section);
        manifest.metrics = evaluation
            .quantities
            .iter()
            .filter(|(name, _)| matches!(name.as_str(), "position" | "force.normal"))
            .map(|(name, s)| (format!("{}_rmse_{}", name.replace('.', "_"), s.unit.to_lowercase()), s.rms))
            .collect();
        manifest
    }
}

/// Four of five locations to learn from, and the fifth to choose by.
pub(crate) fn parts(data: &Dataset, train: &[SampleId]) -> (Vec<SampleId>, Vec<SampleId>) {
    let location = |id: &SampleId| data.sample(*id).and_then(|s| s.truth.as_ref()).map(|t| t.location);
    let locations: BTreeSet<u32> = train.iter().filter_map(location).collect();
    let chosen: BTreeSet<u32> = locations.into_iter().step_by(5).collect();
    let (choose, learn) =
        train.iter().copied().partition(|id| location(id).is_some_and(|p| chosen.contains(&p)));
    (learn, choose)
}
