//! Ways to one and two contacts, side by side on the same recordings.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_inference::{Bundle, Runtime, RuntimeConfig};
use dermis_inversion::{Corrected, ForcePrior, Inverter, SparseSettings};
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::{Compliance, Recorded, matched, superpose};
use dermis_learn::refine::Learned;
use dermis_learn::{Dataset, Evaluation, Evaluator, SampleId, Truth, TruthContact, bounds, refine};
use dermis_model::{ForwardModel, Unknowns};
use dermis_skin::{Estimate, SkinDescription};
use indicatif::ProgressBar;
use serde::Serialize;
use serde_json::{Value, json};

use super::estimators::{Begin, Direct, Likely, Method, Peaks, Refined, Searched, Sparse, inverter};
use super::train::parts;
use super::{flat, nominal, progress, save};
use crate::figures::{Axes, Curve, Legend, Pen, curves, escape, figure, page, surface};

/// What to compare on what.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    #[arg(long)]
    skin: PathBuf,
    /// Model bundle of `dermis real2sim train`; several are compared.
    #[arg(long)]
    model: Vec<PathBuf>,
    /// Labelled bag with single contacts of the device, which gains, corrections and regressions are learned from.
    #[arg(long, required = true)]
    train: Vec<PathBuf>,
    /// Force [N] that every contact presses with at least.
    #[arg(long, default_value_t = 1.0)]
    least: f64,
    /// Compare on contacts where nothing gives way, too, which no reading shows.
    #[arg(long)]
    rigid: bool,
    /// Readings of each number of contacts that are compared at most; of more, every n-th is taken.
    #[arg(long, default_value_t = 1500)]
    most: usize,
    /// Recorded readings that are learned from at most.
    #[arg(long, default_value_t = 12000)]
    learn: usize,
    /// Recorded readings that support vectors are learned from at most.
    #[arg(long, default_value_t = 2500)]
    vectors: usize,
    /// Contacts that are looked for at most.
    #[arg(long, default_value_t = 4)]
    contacts: usize,
    /// Ascending forces [N] at which the bins of errors by force begin.
    #[arg(long, value_delimiter = ',', default_values_t = [0.0, 4.9, 9.8, 19.6])]
    bins: Vec<f64>,
    /// Folder for `comparison.json` and `comparison.html`.
    #[arg(short, long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    labels: Labels,
    /// One JSON object.
    #[arg(long)]
    json: bool,
    /// Labelled bags with one and two contacts of the same device, at places and forces of other seeds.
    #[arg(required = true)]
    bags: Vec<PathBuf>,
}

/// \[m\] from which on two contacts are far apart.
const FAR: f64 = 0.030;

/// Frames that are compared, by what touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Single,
    Near,
    Far,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Single, Self::Near, Self::Far];

    fn of(truth: &Truth) -> Option<Self> {
        match truth.contacts.as_slice() {
            [_] => Some(Self::Single),
            [a, b] if (a.position - b.position).norm() >= FAR => Some(Self::Far),
            [_, _] => Some(Self::Near),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Near => "double_near",
            Self::Far => "double_far",
        }
    }

    fn in_words(self) -> String {
        match self {
            Self::Single => "one contact".into(),
            Self::Near => format!("two contacts, less than {:.0} mm apart", FAR * 1e3),
            Self::Far => format!("two contacts, {:.0} mm apart or more", FAR * 1e3),
        }
    }
}

/// What a method made of one kind of frames.
#[derive(Debug, Clone, Serialize)]
struct Row {
    method: String,
    kind: &'static str,
    frames: usize,
    /// Share of frames with the right number of contacts; absent for a method that always says one.
    count_right: Option<f64>,
    /// \[m\] and \[N\] of true contacts for which one was found.
    position_mean: f64,
    position_rms: f64,
    position_median: f64,
    force_mean: f64,
    force_rms: f64,
    /// Share of true contacts for which none was found.
    lost: f64,
    /// \[s\] a frame.
    seconds: f64,
    /// Errors by force, for one contact.
    #[serde(skip_serializing_if = "Option::is_none")]
    evaluation: Option<Evaluation>,
}

/// Compares.
pub fn run(options: &Options) -> Result<()> {
    let (skin, model) = nominal(&options.skin)?;
    let labels = options.labels.options()?;
    let learned = Dataset::from_bags(&options.train, &skin, &labels)?;
    let data = Dataset::from_bags(&options.bags, &skin, &labels)?;
    let compliance = Compliance::of(model.as_ref(), 0.010)?;
    let test = frames(&data, options, &compliance);
    if test.values().all(Vec::is_empty) {
        bail!("these bags hold no frame of one or two contacts of {} N or more each", options.least);
    }
    let bar = progress()?;
    let all: Vec<SampleId> =
        learned.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
    let (learn, choose) = parts(&learned, &all);
    let prepared = prepare(options, &skin, &model, &compliance, &learned, (&learn, &choose), &bar)?;
    let mut rows = Vec::new();
    let mut shown: Option<Shown> = None;
    let total = (prepared.methods.len() * test.values().map(Vec::len).sum::<usize>()) as u64;
    bar.set_length(total.max(1));
    bar.set_position(0);
    for (name, mut method) in prepared.methods {
        bar.set_message(name.clone());
        for (kind, ids) in &test {
            if ids.is_empty() || (method.single() && *kind != Kind::Single) {
                bar.inc(ids.len() as u64);
                continue;
            }
            rows.push(row(&name, method.as_mut(), *kind, &data, ids, &options.bins, &bar)?);
        }
    }
    // A frame to look at: the first bundle's map of two contacts far apart.
    if let (Some(path), Some(id)) = (options.model.first(), test.get(&Kind::Far).and_then(|ids| ids.first()))
    {
        let runtime = Runtime::load(&RuntimeConfig::default())?;
        let mut peaks = Peaks::new(&Bundle::load(path, &skin)?, model.surface(), runtime)?;
        if let Some(sample) = data.sample(*id) {
            let map = peaks.map(sample)?.to_vec();
            shown = Some(Shown { map, id: *id });
        }
    }
    bar.finish_and_clear();
    let singles = test.get(&Kind::Single).map(Vec::as_slice).unwrap_or_default();
    let bound = if singles.is_empty() {
        None
    } else {
        bounds(model.as_ref(), &data, Some(singles), Unknowns::Normal, &options.bins)?
    };
    let asks = asks(&rows);
    let record = json!({
        "skin": skin.name, "skin_hash": skin.hash(), "least_n": options.least, "bins_n": options.bins,
        "rigid_places": options.rigid, "share_that_gives_way": compliance.share(),
        "learned": { "data_hash": learned.hash(), "notes": prepared.notes },
        "tested": { "data_hash": data.hash(),
                    "frames": test.iter().map(|(k, ids)| (k.name(), ids.len())).collect::<BTreeMap<_, _>>() },
        "rows": rows, "bound": bound, "asks": asks,
    });
    let text = text(&skin, options.rigid, &rows, &test, &options.bins, &record["bound"], &asks);
    if let Some(folder) = &options.out {
        save(folder, "comparison.json", &format!("{record}\n"))?;
        save(folder, "comparison.html", &html(&skin, &model, &data, &rows, &text, shown)?)?;
    }
    if options.json {
        println!("{record}");
    } else {
        print!("{text}");
    }
    Ok(())
}

/// Touched frames of one and two contacts, evenly thinned.
fn frames(data: &Dataset, options: &Options, compliance: &Compliance) -> BTreeMap<Kind, Vec<SampleId>> {
    let mut all: BTreeMap<Kind, Vec<SampleId>> = BTreeMap::new();
    let heavy = |c: &TruthContact| {
        c.normal_force().is_some_and(|f| f >= options.least)
            && (options.rigid || compliance.gives_way(&c.position))
    };
    for (id, sample, truth) in data.labelled() {
        if let Some(kind) = Kind::of(truth)
            && truth.contacts.iter().all(heavy)
            && sample.tared.iter().any(|v| v.is_finite())
        {
            all.entry(kind).or_default().push(id);
        }
    }
    for ids in all.values_mut() {
        let step = ids.len().div_ceil(options.most.max(1)).max(1);
        *ids = ids.iter().copied().step_by(step).collect();
    }
    all
}

/// All methods, and what was found while they were made.
struct Prepared {
    methods: Vec<(String, Box<dyn Method>)>,
    notes: Value,
}

fn prepare(
    options: &Options,
    skin: &SkinDescription,
    model: &Arc<dyn ForwardModel>,
    compliance: &Compliance,
    learned: &Dataset,
    (learn, choose): (&[SampleId], &[SampleId]),
    bar: &ProgressBar,
) -> Result<Prepared> {
    let runtime = Runtime::load(&RuntimeConfig::default())?;
    let felt = |ids: &[SampleId], most: usize| {
        let mut all = Recorded::of(learned, ids, options.least * 0.5, most);
        all.retain(|r| compliance.gives_way(&r.contact.position));
        all
    };
    let (recorded, chosen) = (felt(learn, options.learn), felt(choose, options.learn / 4));
    if recorded.is_empty() || chosen.is_empty() {
        bail!("the bags of `--train` hold no single contact of known place, force and tip");
    }
    let mut methods: Vec<(String, Box<dyn Method>)> = Vec::new();
    for folder in &options.model {
        let bundle = Bundle::load(folder, skin)?;
        let name =
            folder.file_name().map_or_else(|| folder.display().to_string(), |n| n.to_string_lossy().into());
        methods.push((format!("{name}: peaks"), Box::new(Peaks::new(&bundle, model.surface(), runtime)?)));
    }

    bar.set_message("gains of the channels");
    let mut plain = refine::settings(model.as_ref(), learned, learn, Unknowns::Normal, options.contacts)?;
    plain.distance = 0.008;
    plain.force_prior = ForcePrior::Log;
    bar.set_message("what the model does not know");
    let on = |share: f64| {
        bar.set_position((1000.0 * share) as u64);
        true
    };
    let learned_of = refine::correction(model.as_ref(), &recorded, &chosen, &plain.gains, &on)?;
    let Learned { correction, settings, left, .. } =
        learned_of.context("the correction was not learned to its end")?;
    let corrected: Arc<dyn ForwardModel> = Arc::new(Corrected::new(Arc::clone(model), correction)?);
    let mut better =
        refine::settings(corrected.as_ref(), learned, choose, Unknowns::Normal, options.contacts)?;
    (better.distance, better.force_prior) = (plain.distance, plain.force_prior);
    // Gains are in the correction; measured once more on a few places they would only add noise.
    better.gains.clear();
    bar.set_message("how much evidence a contact needs");
    let pairs: Vec<_> = (1..=3).flat_map(|n| superpose(model.as_ref(), &chosen, n, 60, FAR, 77)).collect();
    refine::tune_evidence(model, &mut plain, &pairs, &on)?;
    refine::tune_evidence(&corrected, &mut better, &pairs, &on)?;

    methods.push(("forward model, likelihood".into(), Box::new(Likely(inverter(model, &plain)?))));
    let sparse = tune_sparse(&inverter(model, &plain)?, &pairs)?;
    methods.push((
        "forward model, sparse".into(),
        Box::new(Sparse { inverter: inverter(model, &plain)?, settings: sparse }),
    ));
    methods.push(("corrected model, likelihood".into(), Box::new(Likely(inverter(&corrected, &better)?))));
    methods.push(("corrected model, all pairs".into(), Box::new(Searched(inverter(&corrected, &better)?))));
    let generous = SparseSettings { share: 0.02, ..sparse };
    methods.push((
        "corrected model, from sparse".into(),
        Box::new(Refined { inverter: inverter(&corrected, &better)?, begin: Begin::Sparse(generous) }),
    ));
    if let Some(folder) = options.model.first() {
        let bundle = Bundle::load(folder, skin)?;
        let peaks = Peaks::new(&bundle, model.surface(), runtime)?;
        methods.push((
            "corrected model, from peaks".into(),
            Box::new(Refined {
                inverter: inverter(&corrected, &better)?,
                begin: Begin::Other(Box::new(peaks)),
            }),
        ));
    }

    bar.set_message("regressions");
    let vectors = Direct::vectors(skin, &recorded, options.vectors)?;
    methods.push(("support vectors".into(), Box::new(vectors)));
    methods.push(("6 nearest neighbours".into(), Box::new(Direct::neighbours(skin, &recorded)?)));
    methods.push(("feed-forward network".into(), Box::new(Direct::network(skin, &recorded)?)));
    let notes = json!({
        "recorded": recorded.len(), "gains": plain.gains, "model_error": plain.model_error,
        "evidence": plain.evidence, "sparse": { "penalty": sparse.penalty, "share": sparse.share },
        "correction": { "length_m": settings.length, "ridge": settings.ridge, "powers": settings.powers,
                        "remainder_before_in_noise": left[0], "remainder_after_in_noise": left[1],
                        "model_error": better.model_error, "evidence": better.evidence },
    });
    Ok(Prepared { methods, notes })
}

type Sum = (dermis_model::Stimulus, Vec<f32>);

/// Penalty and share that give the right number most often, and places that are nearest.
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

fn row(
    name: &str,
    method: &mut dyn Method,
    kind: Kind,
    data: &Dataset,
    ids: &[SampleId],
    bins: &[f64],
    bar: &ProgressBar,
) -> Result<Row> {
    let mut evaluator = Evaluator::new().by_force(bins);
    let (mut distances, mut forces) = (Vec::new(), Vec::new());
    let (mut right, mut wanted) = (0usize, 0usize);
    let started = Instant::now();
    for id in ids {
        let Some(sample) = data.sample(*id) else { continue };
        let Some(truth) = sample.truth.as_ref() else { continue };
        let contacts = method.contacts(sample)?;
        bar.inc(1);
        wanted += truth.contacts.len();
        right += usize::from(contacts.len() == truth.contacts.len());
        let true_ones: Vec<dermis_model::Indentation> = truth
            .contacts
            .iter()
            .map(|c| dermis_model::Indentation::sphere(c.position, c.force, c.diameter))
            .collect();
        for (t, index) in matched(&true_ones, &contacts, f64::INFINITY).into_iter().enumerate() {
            let Some(found) = index.map(|i| &contacts[i]) else { continue };
            distances.push((found.position - truth.contacts[t].position).norm());
            if let Some(force) = truth.contacts[t].normal_force() {
                forces.push((found.normal_force() - force).abs());
            }
        }
        evaluator.push(id.run, truth, &Estimate { contacts, ..Estimate::default() });
    }
    let seconds = started.elapsed().as_secs_f64() / ids.len().max(1) as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let rms =
        |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt();
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    Ok(Row {
        method: name.to_owned(),
        kind: kind.name(),
        frames: ids.len(),
        count_right: (!method.single()).then(|| right as f64 / ids.len().max(1) as f64),
        position_mean: mean(&distances),
        position_rms: rms(&distances),
        position_median: sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN),
        force_mean: mean(&forces),
        force_rms: rms(&forces),
        lost: 1.0 - distances.len() as f64 / wanted.max(1) as f64,
        seconds,
        evaluation: (kind == Kind::Single).then(|| evaluator.finish(name.to_owned())),
    })
}

/// One figure that is asked for.
#[derive(Debug, Clone, Serialize)]
struct Ask {
    what: &'static str,
    asked: String,
    /// Method that comes nearest, and its figure.
    method: String,
    found: String,
    reached: bool,
}

/// The asks of this study: mean errors of one contact, of two (all distances), and the number of contacts.
fn asks(rows: &[Row]) -> Vec<Ask> {
    let mut methods: Vec<&str> = Vec::new();
    for row in rows {
        if !methods.contains(&row.method.as_str()) {
            methods.push(&row.method);
        }
    }
    let of = |method: &str, kinds: &[Kind]| -> Option<[f64; 3]> {
        let found: Vec<&Row> = rows
            .iter()
            .filter(|r| {
                r.method == method && kinds.iter().any(|k| k.name() == r.kind) && r.count_right.is_some()
            })
            .collect();
        let frames = found.iter().map(|r| r.frames).sum::<usize>() as f64;
        let mean =
            |value: fn(&Row) -> f64| found.iter().map(|r| value(r) * r.frames as f64).sum::<f64>() / frames;
        (frames > 0.0).then(|| {
            [mean(|r| r.position_mean), mean(|r| r.force_mean), mean(|r| r.count_right.unwrap_or(0.0))]
        })
    };
    let mut all = Vec::new();
    let errors: [(&'static str, &[Kind], [f64; 2]); 2] = [
        ("one contact, mean errors", &[Kind::Single], [0.005, 3.0]),
        ("two contacts, mean errors", &[Kind::Near, Kind::Far], [0.005, 2.0]),
    ];
    for (what, kinds, [place, force]) in errors {
        let best = methods
            .iter()
            .filter_map(|m| of(m, kinds).map(|[p, f, _]| (*m, p, f)))
            .min_by(|a, b| (a.1 / place).max(a.2 / force).total_cmp(&(b.1 / place).max(b.2 / force)));
        if let Some((method, p, f)) = best {
            all.push(Ask {
                what,
                asked: format!("{:.0} mm, {force} N", place * 1e3),
                method: method.to_owned(),
                found: format!("{:.2} mm, {f:.2} N", p * 1e3),
                reached: p <= place && f <= force,
            });
        }
    }
    let best = methods
        .iter()
        .filter_map(|m| of(m, &[Kind::Far]).map(|[.., right]| (*m, right)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((method, right)) = best {
        all.push(Ask {
            what: "number of contacts, two far apart",
            asked: "90 %".into(),
            method: method.to_owned(),
            found: format!("{:.1} %", right * 100.0),
            reached: right >= 0.9,
        });
    }
    all
}

fn text(
    skin: &SkinDescription,
    rigid: bool,
    rows: &[Row],
    test: &BTreeMap<Kind, Vec<SampleId>>,
    bins: &[f64],
    bound: &Value,
    asks: &[Ask],
) -> String {
    let mut out = format!("{}: ways to contacts on recordings that nothing was learned from\n", skin.name);
    if !rigid {
        out.push_str("left out: contacts where the surface gives way by less than a tenth of its median\n");
    }
    for kind in Kind::ALL {
        let found: Vec<&Row> = rows.iter().filter(|r| r.kind == kind.name()).collect();
        if found.is_empty() {
            continue;
        }
        let _ = writeln!(
            out,
            "\n{}: {} frames\n{:<38}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}",
            kind.in_words(),
            test.get(&kind).map_or(0, Vec::len),
            "",
            "mean mm",
            "RMS mm",
            "median",
            "mean N",
            "RMS N",
            "lost %",
            "number ok %"
        );
        for r in found {
            let right = r.count_right.map_or_else(|| "-".to_owned(), |v| format!("{:.1}", v * 100.0));
            let _ = writeln!(
                out,
                "{:<38}{:>10.2}{:>10.2}{:>10.2}{:>10.2}{:>10.2}{:>10.1}{right:>12}",
                r.method,
                r.position_mean * 1e3,
                r.position_rms * 1e3,
                r.position_median * 1e3,
                r.force_mean,
                r.force_rms,
                r.lost * 100.0
            );
        }
    }
    for (quantity, of_bound, unit, factor) in
        [("position", "position", "mm", 1e3), ("force.normal", "normal_force", "N", 1.0)]
    {
        let _ = write!(out, "\none contact, {quantity} RMSE [{unit}] by force [N]\n{:<38}", "");
        for (i, from) in bins.iter().enumerate() {
            let head = bins.get(i + 1).map_or_else(|| format!("{from}+"), |to| format!("{from}-{to}"));
            let _ = write!(out, "{head:>10}");
        }
        let _ = writeln!(out);
        let mut line = |name: &str, of: &dyn Fn(f64) -> Option<f64>| {
            let _ = write!(out, "{name:<38}");
            for from in bins {
                let cell = of(*from).map_or_else(|| "-".to_owned(), |v| format!("{:.2}", v * factor));
                let _ = write!(out, "{cell:>10}");
            }
            let _ = writeln!(out);
        };
        for r in rows {
            let Some(by_force) = r.evaluation.as_ref().and_then(|e| e.by_force.get(quantity)) else {
                continue;
            };
            line(&r.method, &|from| {
                by_force.iter().find(|b| b.from.to_bits() == from.to_bits()).map(|b| b.rms)
            });
        }
        if let Some(cells) = bound[of_bound].as_array() {
            line("Cramér–Rao bound of the design", &|from| {
                cells.iter().find(|b| b["from"].as_f64() == Some(from)).and_then(|b| b["rms"].as_f64())
            });
        }
    }
    let _ = writeln!(out);
    for ask in asks {
        let reached = if ask.reached { "reached" } else { "missed" };
        let _ =
            writeln!(out, "{reached}: {} ({} asked): {} by {}", ask.what, ask.asked, ask.found, ask.method);
    }
    out
}

/// One frame to look at.
struct Shown {
    map: Vec<f64>,
    id: SampleId,
}

fn html(
    skin: &SkinDescription,
    model: &Arc<dyn ForwardModel>,
    data: &Dataset,
    rows: &[Row],
    text: &str,
    shown: Option<Shown>,
) -> Result<String> {
    let mut body = format!("<pre>{}</pre>\n", escape(text));
    let axes = Axes {
        legend: Legend::Above,
        log_y: true,
        ..Axes::new("one contact", "force [N]", "place, RMSE [mm]")
    };
    let all: Vec<Curve> = rows
        .iter()
        .filter_map(|r| Some((r, r.evaluation.as_ref()?.by_force.get("position")?)))
        .enumerate()
        .map(|(n, (r, bins))| {
            let middle = |b: &dermis_learn::Bin| b.to.map_or(b.from * 1.4, |to| f64::midpoint(b.from, to));
            let points = bins.iter().map(|b| (middle(b), b.rms * 1e3)).collect();
            let curve = Curve::new(r.method.clone(), n, points);
            if n >= crate::figures::COLOURS.len() { curve.pen(Pen::Dashed) } else { curve }
        })
        .collect();
    let mut pictures = Vec::new();
    if !all.is_empty() {
        pictures.push(curves(&axes, &all)?);
    }
    if let Some(Shown { map, id }) = shown {
        let points = flat(model.surface(), skin);
        let truth = data.sample(id).and_then(|s| s.truth.as_ref());
        let around = |c: &TruthContact| {
            let nearest = (0..points.len()).min_by(|a, b| {
                let distance = |i: usize| (model.surface().points[i] - c.position).norm();
                distance(*a).total_cmp(&distance(*b))
            });
            nearest.map_or((0.0, 0.0), |i| points[i])
        };
        let crosses: Vec<(f64, f64)> =
            truth.map(|t| t.contacts.iter().map(around).collect()).unwrap_or_default();
        let micrometres: Vec<f64> = map.iter().map(|v| v * 1e6).collect();
        let axes = Axes::new("two contacts, as the map shows them", "along [mm]", "around [mm]");
        pictures.push(surface(&axes, "µm", &points, &micrometres, &crosses)?);
    }
    if !pictures.is_empty() {
        let caption =
            "Left: errors by force. Right: a map of the first bundle; crosses are the true contacts.";
        body.push_str(&figure(&pictures, caption));
    }
    Ok(page(&format!("{}: ways to contacts", skin.name), &body))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(method: &str, kind: Kind, place: f64, force: f64, right: Option<f64>) -> Row {
        Row {
            method: method.into(),
            kind: kind.name(),
            frames: 10,
            count_right: right,
            position_mean: place,
            position_rms: place,
            position_median: place,
            force_mean: force,
            force_rms: force,
            lost: 0.0,
            seconds: 0.0,
            evaluation: None,
        }
    }

    #[test]
    fn asks_are_judged_by_methods_that_count() {
        let rows = [
            row("a", Kind::Single, 0.004, 1.0, Some(1.0)),
            row("a", Kind::Near, 0.008, 1.0, Some(0.5)),
            row("a", Kind::Far, 0.004, 1.0, Some(0.8)),
            row("b", Kind::Single, 0.001, 4.0, Some(1.0)),
            row("regression", Kind::Single, 1e-4, 0.1, None),
        ];
        let found = asks(&rows);
        let told: Vec<String> =
            found.iter().map(|a| format!("{} {} {} {}", a.what, a.method, a.found, a.reached)).collect();
        insta::assert_snapshot!(told.join("\n"), @r"
        one contact, mean errors a 4.00 mm, 1.00 N true
        two contacts, mean errors a 6.00 mm, 1.00 N false
        number of contacts, two far apart a 80.0 % false
        ");
    }
}
