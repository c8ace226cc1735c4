//! Every way to contacts that is compared, learned and tuned on recordings of single contacts.

use std::sync::Arc;

use anyhow::{Context, Result, bail};
use dermis_estimate::ContactFinder;
use dermis_estimate::finder::{InversionFinder, MapFinder, Start};
use dermis_inference::{Bundle, Runtime, RuntimeConfig};
use dermis_inversion::{Corrected, ForcePrior, Inverter, Settings, SparseSettings};
use dermis_learn::real2sim::{Compliance, Recorded, superpose};
use dermis_learn::refine::Learned;
use dermis_learn::{Dataset, SampleId, refine};
use dermis_model::{ForwardModel, Unknowns};
use dermis_regress::Method;
use dermis_skin::SkinDescription;
use serde_json::{Value, json};

use super::{FAR, Request};
use crate::regressions::{self, Learned as Presses, Most};
use crate::{Progress, called};

/// A way to contacts, with its name.
type Named = (String, Box<dyn ContactFinder>);

/// All methods, and what was found while they were made.
pub(super) struct Prepared {
    pub(super) methods: Vec<Named>,
    pub(super) notes: Value,
}

/// Makes all methods: peaks of every bundle, inversions of the forward model, regressions.
pub(super) fn prepare(
    options: &Request,
    skin: &SkinDescription,
    model: &Arc<dyn ForwardModel>,
    compliance: &Compliance,
    learned: &Dataset,
    (learn, choose): (&[SampleId], &[SampleId]),
    progress: &dyn Progress,
) -> Result<Prepared> {
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let detectable = |ids: &[SampleId], most: usize| {
        let mut all = Recorded::of(learned, ids, options.least * 0.5, most)?;
        all.retain(|r| compliance.gives_way(&r.contact.position));
        anyhow::Ok(all)
    };
    let (recorded, chosen) = (detectable(learn, options.learn)?, detectable(choose, options.learn / 4)?);
    if recorded.is_empty() || chosen.is_empty() {
        bail!("the bags of `--train` hold no single contact of known place, force and tip");
    }
    let mut methods: Vec<Named> = Vec::new();
    let peaks = |folder| anyhow::Ok(MapFinder::new(&Bundle::load(folder, skin)?, skin, runtime)?);
    for folder in &options.model {
        methods.push((format!("{}: peaks", called(folder)), Box::new(peaks(folder)?)));
    }
    let tuned = Tuned::new(options, model, learned, (learn, choose), (&recorded, &chosen), progress)?;
    methods.extend(tuned.inversions(model)?);
    if let Some(folder) = options.model.first() {
        let start = Start::Refine(Box::new(peaks(folder)?));
        methods.push(("corrected model, from peaks".into(), tuned.on_corrected(start)?));
    }

    progress.begin("regressions");
    let presses = Presses::of(skin, &recorded);
    let most = Most { all: options.learn, vectors: options.vectors };
    let mut notes = tuned.notes;
    let mut regress = |kinds: [Method; 2], methods: &mut Vec<Named>| -> Result<()> {
        for method in kinds {
            let (finder, settings) = regressions::tuned(method, skin, &presses, most)?;
            methods.push((method.in_words().into(), Box::new(finder)));
            notes[method.in_words()] = settings;
        }
        Ok(())
    };
    // New rows come last: the book names rows by their number.
    regress([Method::Vectors, Method::Neighbours], &mut methods)?;
    let (network, _) = regressions::network(skin, &presses, most.all)?;
    methods.push(("feed-forward network".into(), Box::new(network)));
    regress([Method::Trees, Method::Gaussian], &mut methods)?;
    notes["recorded"] = json!(recorded.len());
    Ok(Prepared { methods, notes })
}

/// A forward model as it was designed and as recordings correct it, each with settings of its own.
struct Tuned {
    corrected: Arc<dyn ForwardModel>,
    plain: Settings,
    better: Settings,
    sparse: SparseSettings,
    notes: Value,
}

impl Tuned {
    fn new(
        options: &Request,
        model: &Arc<dyn ForwardModel>,
        learned: &Dataset,
        (learn, choose): (&[SampleId], &[SampleId]),
        (recorded, chosen): (&[Recorded], &[Recorded]),
        progress: &dyn Progress,
    ) -> Result<Self> {
        progress.begin("gains of the channels");
        let mut plain = refine::settings(model.as_ref(), learned, learn, Unknowns::Normal, options.contacts)?;
        plain.distance = 0.008;
        plain.force_prior = ForcePrior::Log;
        progress.begin("what the model does not know");
        let on = |share: f64| {
            progress.at(share);
            true
        };
        let learned_of = refine::correction(model.as_ref(), recorded, chosen, &plain.gains, &on)?;
        let Learned { correction, settings, left, .. } =
            learned_of.context("the correction was not learned to its end")?;
        let corrected: Arc<dyn ForwardModel> = Arc::new(Corrected::new(Arc::clone(model), correction)?);
        let mut better =
            refine::settings(corrected.as_ref(), learned, choose, Unknowns::Normal, options.contacts)?;
        (better.distance, better.force_prior) = (plain.distance, plain.force_prior);
        // Gains are in the correction; measured once more on a few locations they would only add noise.
        better.gains.clear();
        progress.begin("how much evidence a contact needs");
        let pairs: Vec<_> = (1..=3).flat_map(|n| superpose(model.as_ref(), chosen, n, 60, FAR, 77)).collect();
        refine::tune_evidence(model, &mut plain, &pairs, &on)?;
        refine::tune_evidence(&corrected, &mut better, &pairs, &on)?;
        let sparse = tune_sparse(&inverter(model, &plain)?, &pairs)?;
        let notes = json!({
            "gains": plain.gains, "model_error": plain.model_error,
            "evidence": plain.evidence, "sparse": { "penalty": sparse.penalty, "share": sparse.share },
            "correction": { "length_m": settings.length, "ridge": settings.ridge, "powers": settings.powers,
                            "remainder_before_in_noise": left[0], "remainder_after_in_noise": left[1],
                            "model_error": better.model_error, "evidence": better.evidence },
        });
        Ok(Self { corrected, plain, better, sparse, notes })
    }

    /// The corrected model from this start.
    fn on_corrected(&self, start: Start) -> Result<Box<dyn ContactFinder>> {
        Ok(Box::new(InversionFinder::new(inverter(&self.corrected, &self.better)?, start)))
    }

    /// The model as it was designed and the corrected one, from the starts that ask nobody else.
    fn inversions(&self, model: &Arc<dyn ForwardModel>) -> Result<Vec<Named>> {
        let plain = |start| -> Result<Box<dyn ContactFinder>> {
            Ok(Box::new(InversionFinder::new(inverter(model, &self.plain)?, start)))
        };
        let generous = SparseSettings { share: 0.02, ..self.sparse };
        Ok(vec![
            ("forward model, likelihood".into(), plain(Start::Greedy)?),
            ("forward model, sparse".into(), plain(Start::SparseOnly(self.sparse))?),
            ("corrected model, likelihood".into(), self.on_corrected(Start::Greedy)?),
            ("corrected model, all pairs".into(), self.on_corrected(Start::Pairs)?),
            ("corrected model, from sparse".into(), self.on_corrected(Start::Sparse(generous))?),
        ])
    }
}

/// An inverter of these settings.
fn inverter(model: &Arc<dyn ForwardModel>, settings: &Settings) -> Result<Inverter> {
    Ok(Inverter::new(Arc::clone(model), settings.clone())?)
}

type Sum = (dermis_model::Stimulus, Vec<f32>);

/// Penalty and share that give the right number most often, and locations that are nearest.
fn tune_sparse(inverter: &Inverter, frames: &[Sum]) -> Result<SparseSettings> {
    let mut best = (f64::NEG_INFINITY, SparseSettings::default());
    for penalty in [3e-4, 1e-3, 3e-3, 1e-2, 3e-2] {
        for share in [0.05, 0.1, 0.15, 0.2, 0.3] {
            let tried = SparseSettings { penalty, share, radius: 0.015 };
            let mut right = 0usize;
            for (stimulus, signal) in frames {
                right += usize::from(
                    inverter.sparse(&refine::exact(signal), &tried)?.len() == stimulus.contacts.len(),
                );
            }
            if right as f64 > best.0 {
                best = (right as f64, tried);
            }
        }
    }
    Ok(best.1)
}
