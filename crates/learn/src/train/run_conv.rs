//! From a data set to a convolutional network.
//!
//! Inputs and targets are held where a quarter of the free memory has room for them ([`held`](super::held)); otherwise they are computed
//! anew in every epoch, while the bags are read, and nothing of them is held but a mini-batch and what is shuffled. A tenth of the
//! locations of the training part serves to stop early, besides those that are held out.

use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use dermis_inference::{Interface, TensorPort};

use super::checkpoint::signature;
use super::config::ConvConfig;
use super::conv::{ConvNetwork, ConvSpec, ConvTraining, Form, Head, TensorReader, TensorSample, fit};
use super::held::{Held, budget};
use super::network::Progress;
use super::run::{Job, Trained, no_rows, partial};
use crate::dataset::{SampleId, Truth};
use crate::target::{Maps, Target};
use crate::{LearnError, SplitKind};

/// Samples among which the next one is drawn.
const SHUFFLE: usize = 1024;
/// Locations of the training part that serve to stop early.
const VALIDATION: f64 = 0.1;

/// Targets of a sample, one list for each head, and how much they count; `None` where nothing is known.
pub(super) type TargetsOf<'a> = dyn Fn(&Truth) -> Result<Option<[Vec<Vec<f32>>; 2]>, LearnError> + 'a;

/// Samples of a data set.
struct Reader<'a> {
    held: RefCell<Held>,
    /// \[bytes\] that may still be held, of all readers.
    left: &'a Cell<usize>,
    job: &'a Job<'a>,
    ids: BTreeSet<SampleId>,
    targets: &'a TargetsOf<'a>,
}

impl TensorReader for Reader<'_> {
    fn each(&self, take: &mut dyn FnMut(TensorSample) -> Result<(), LearnError>) -> Result<(), LearnError> {
        if let Held::All(samples) = &*self.held.borrow() {
            return samples.iter().try_for_each(|sample| take(sample.unpack()));
        }
        self.held.borrow_mut().begin(self.left);
        self.read(take)?;
        self.held.borrow_mut().end();
        Ok(())
    }
}

impl Reader<'_> {
    /// Reads the bags.
    fn read(&self, take: &mut dyn FnMut(TensorSample) -> Result<(), LearnError>) -> Result<(), LearnError> {
        let (data, baseline) = (self.job.request.data, self.job.request.config.baseline);
        data.each_input(self.job.features, baseline, |id, row| {
            let truth = data.sample(id).and_then(|s| s.truth.as_ref());
            let Some(truth) = truth.filter(|_| self.ids.contains(&id)) else { return Ok(()) };
            let Some([targets, weights]) = (self.targets)(truth)? else { return Ok(()) };
            let sample = TensorSample { input: row.to_vec(), targets, weights };
            self.held.borrow_mut().push(&sample, self.left);
            take(sample)
        })
    }
}

/// One tensor for the scalars, one for every map, one for the logit of a contact.
fn heads(job: &Job<'_>, conv: &ConvConfig) -> Result<Vec<Head>, LearnError> {
    let specs = &job.decoder.config().values;
    let scalars =
        job.outputs.iter().filter(|n| matches!(Target::of(n), Some(Target::Scalar(_))) && **n != "contact");
    let mut heads = Vec::new();
    let count = scalars.count();
    if count > 0 {
        heads.push(Head { name: "scalars".into(), form: Form::Vector(count), logit: false });
    }
    for (name, spec) in job.outputs.iter().zip(specs) {
        let Some(Target::Map(map)) = Target::of(name) else { continue };
        let form = match conv.surface {
            Some([rows, columns]) if rows * columns * map.per_point() != spec.count => {
                return Err(LearnError::Training {
                    reason: format!(
                        "`network.conv.surface` has {rows} × {columns} points where the surface of the skin has {}",
                        spec.count / map.per_point()
                    ),
                });
            }
            // Vectors lie point by point, not plane by plane.
            Some([rows, columns]) if map.per_point() == 1 => Form::Map([1, rows, columns]),
            _ => Form::Vector(spec.count),
        };
        heads.push(Head { name: (*name).to_owned(), form, logit: false });
    }
    if job.outputs.contains(&"contact") {
        heads.push(Head { name: "contact".into(), form: Form::Vector(1), logit: true });
    }
    Ok(heads)
}

/// Fits a convolutional network.
pub(super) fn fit_conv(
    job: &Job<'_>,
    conv: &ConvConfig,
    maps: Maps,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Trained, LearnError> {
    if conv.grid.iter().product::<usize>() != job.features.input_len() {
        return Err(LearnError::Training {
            reason: format!(
                "`network.conv.grid` is {:?}, which are {} numbers, where {} channels give {}",
                conv.grid,
                conv.grid.iter().product::<usize>(),
                job.features.channels(),
                job.features.input_len()
            ),
        });
    }
    let heads = heads(job, conv)?;
    let spec = ConvSpec {
        input: "input".into(),
        shape: conv.grid,
        encoder: conv.encoder.clone(),
        hidden: conv.hidden,
        heads: heads.clone(),
        layers: Vec::new(),
    };
    let (maps, columns) = (RefCell::new(maps), job.columns());
    let targets = |truth: &Truth| {
        let targets = job.targets(truth, &mut maps.borrow_mut())?;
        if targets.iter().all(|t| t.is_nan()) {
            return Ok(None);
        }
        let parts = |all: &[f32]| {
            let mut rest = all;
            let mut part = |head: &Head| {
                let (own, others) = rest.split_at(head.form.len());
                rest = others;
                own.to_vec()
            };
            heads.iter().map(&mut part).collect()
        };
        Ok(Some([parts(&targets), parts(&job.weights(truth, &columns))]))
    };
    let (network, samples) = fit_spec(job, &spec, (conv.patience, Vec::new()), &targets, stop, progress)?;
    let graph = network.to_onnx("dermis")?;
    let port = |name: &str, shape: &[usize]| TensorPort { name: name.into(), shape: [&[1], shape].concat() };
    let outputs: Vec<TensorPort> = heads
        .iter()
        .map(|head| match head.form {
            Form::Vector(count) => port(&head.name, &[count]),
            Form::Map(shape) => port(&head.name, &shape),
        })
        .collect();
    Ok(Trained {
        graph,
        interface: Interface::of(&[port("input", &conv.grid)], &outputs),
        samples,
        every: 1,
        choice: None,
    })
}

/// Fits a network to what `targets` says of the training part, with so much patience and noise of the inputs; the network, and the
/// number of samples.
pub(super) fn fit_spec(
    job: &Job<'_>,
    spec: &ConvSpec,
    (patience, noise): (u32, Vec<f32>),
    targets: &TargetsOf<'_>,
    stop: &AtomicBool,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<(ConvNetwork, usize), LearnError> {
    let (request, config) = (job.request, job.request.config);
    let training = ConvTraining {
        epochs: config.training.epochs,
        batch: config.training.batch,
        learning_rate: config.training.learning_rate,
        patience,
        shuffle: SHUFFLE,
        seed: config.training.seed,
        momentum: config.training.momentum,
        noise,
        data: signature(request.data, config)?,
        processor: request.processor,
    };
    let mut other = config.split;
    (other.seed, other.fraction, other.fold) = (config.split.seed.wrapping_add(1), VALIDATION, None);
    if other.kind == SplitKind::Time {
        // The end of what comes before the part that is held out.
        other.fraction = config.split.fraction + VALIDATION * (1.0 - config.split.fraction);
    }
    let aside: BTreeSet<SampleId> = other.apply(request.data)?.test.into_iter().collect();
    let (validation, train): (BTreeSet<_>, BTreeSet<_>) =
        job.split.train.iter().partition(|id| aside.contains(*id));
    if train.is_empty() || validation.is_empty() {
        return Err(no_rows());
    }
    let left = Cell::new(budget());
    let reader =
        |ids: BTreeSet<SampleId>| Reader { held: RefCell::new(Held::new()), left: &left, job, ids, targets };
    let samples = train.len();
    let folder = partial(request.out);
    std::fs::create_dir_all(&folder).map_err(LearnError::io(&folder, "written"))?;
    let state = folder.join("conv.state");
    let fitted = fit(
        spec,
        &training,
        (&reader(train), &reader(validation)),
        Some((&state, request.resume)),
        stop,
        &mut |p| {
            progress(Progress { member: 0, epoch: p.epoch, epochs: training.epochs, loss: p.validation });
        },
    )?;
    Ok((fitted.network, samples))
}
