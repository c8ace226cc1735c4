//! Ways to one and two contacts, side by side on the same recordings. The frames that are asked do not follow each other, so each is
//! taken by itself; a node follows contacts from frame to frame.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use dermis_estimate::ContactFinder;
use dermis_estimate::finder::MapFinder;
use dermis_inference::{Bundle, Runtime, RuntimeConfig};
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::{Compliance, matched};
use dermis_learn::{Bounds, Dataset, Evaluation, Evaluator, SampleId, Truth, TruthContact, bounds};
use dermis_model::Unknowns;
use dermis_skin::{Estimate, SkinDescription};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};

use super::nominal;
use super::train::parts;
use crate::{Families, Progress, conditioned};

mod methods;

use methods::prepare;

/// What to compare on what.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    #[arg(long)]
    pub skin: PathBuf,
    /// Model bundle of `dermis real2sim train`; several are compared.
    #[arg(long)]
    pub model: Vec<PathBuf>,
    /// Labelled bag with single contacts of the device, which gains, corrections and regressions are learned from.
    #[arg(long, required = true)]
    pub train: Vec<PathBuf>,
    /// Force [N] that every contact presses with at least.
    #[arg(long, default_value_t = Request::default().least)]
    pub least: f64,
    /// Compare on contacts where nothing gives way, too, which no reading shows.
    #[arg(long)]
    pub rigid: bool,
    /// Readings of each number of contacts that are compared at most; of more, every n-th is taken.
    #[arg(long, default_value_t = Request::default().most)]
    pub most: usize,
    /// Recorded readings that are learned from at most.
    #[arg(long, default_value_t = Request::default().learn)]
    pub learn: usize,
    /// Recorded readings that support vectors are learned from at most.
    #[arg(long, default_value_t = Request::default().vectors)]
    pub vectors: usize,
    /// Contacts that are looked for at most.
    #[arg(long, default_value_t = Request::default().contacts)]
    pub contacts: usize,
    /// Ascending forces [N] at which the bins of errors by force begin.
    #[arg(long, value_delimiter = ',', default_values_t = Request::default().bins)]
    pub bins: Vec<f64>,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// Labelled bags with one and two contacts of the same device, at places and forces of other seeds.
    #[arg(required = true)]
    pub bags: Vec<PathBuf>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            model: Vec::new(),
            train: Vec::new(),
            least: 1.0,
            rigid: false,
            most: 1500,
            learn: 12_000,
            vectors: 2500,
            contacts: 4,
            bins: vec![0.0, 4.9, 9.8, 19.6],
            labels: Labels::default(),
            bags: Vec::new(),
        }
    }
}

/// \[m\] from which on two contacts are far apart.
const FAR: f64 = 0.030;

/// Frames that are compared, by what touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// One contact.
    Single,
    /// Two, less than 30 mm apart.
    Near,
    /// Two, 30 mm apart or more.
    Far,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Single, Self::Near, Self::Far];

    fn of(truth: &Truth) -> Option<Self> {
        match truth.contacts.as_slice() {
            [_] => Some(Self::Single),
            [a, b] if (a.position - b.position).norm() >= FAR => Some(Self::Far),
            [_, _] => Some(Self::Near),
            _ => None,
        }
    }

    /// For programs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Near => "double_near",
            Self::Far => "double_far",
        }
    }

    /// For people.
    #[must_use]
    pub fn in_words(self) -> String {
        match self {
            Self::Single => "one contact".into(),
            Self::Near => format!("two contacts, less than {:.0} mm apart", FAR * 1e3),
            Self::Far => format!("two contacts, {:.0} mm apart or more", FAR * 1e3),
        }
    }
}

/// What a method made of one kind of frames.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Its name.
    pub method: String,
    /// [`Kind::name`].
    pub kind: &'static str,
    /// Frames that it answered.
    pub frames: usize,
    /// Share of frames with the right number of contacts; absent for a method that always says one.
    pub count_right: Option<f64>,
    /// \[m\] mean distance, of true contacts for which one was found.
    pub position_mean: f64,
    /// \[m\] root mean square.
    pub position_rms: f64,
    /// \[m\] median.
    pub position_median: f64,
    /// \[N\] mean error of the pressing force of the same.
    pub force_mean: f64,
    /// \[N\] root mean square.
    pub force_rms: f64,
    /// Share of true contacts for which none was found.
    pub lost: f64,
    /// \[s\] a frame.
    pub seconds: f64,
    /// Errors by force, for one contact.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evaluation: Option<Evaluation>,
}

/// One frame to look at.
pub struct ShownFrame {
    /// \[m\] of every point of the surface.
    pub map: Vec<f64>,
    /// What truly touched.
    pub contacts: Vec<TruthContact>,
}

/// Everything that was found.
pub struct Findings {
    /// What was asked for.
    pub request: Request,
    /// The skin as it was designed.
    pub skin: SkinDescription,
    /// Share of the surface that gives way.
    pub gives_way: f64,
    /// Hash of what was learned from, and what was found on the way.
    pub learned: (String, Value),
    /// Hash of what was answered.
    pub tested: String,
    /// Frames of each kind.
    pub frames: BTreeMap<Kind, usize>,
    /// One for each method and kind.
    pub rows: Vec<Row>,
    /// What any estimator without bias could reach on one contact.
    pub bound: Option<Bounds>,
    /// Figures that are asked for.
    pub asks: Vec<TargetFigure>,
    /// The first bundle's map of two contacts far apart.
    pub shown: Option<ShownFrame>,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let frames: BTreeMap<&str, usize> = self.frames.iter().map(|(k, n)| (k.name(), *n)).collect();
        json!({
            "skin": self.skin.name, "skin_hash": self.skin.hash(), "least_n": self.request.least,
            "bins_n": self.request.bins, "rigid_places": self.request.rigid,
            "share_that_gives_way": self.gives_way,
            "learned": { "data_hash": self.learned.0, "notes": self.learned.1 },
            "tested": { "data_hash": self.tested, "frames": frames },
            "rows": self.rows, "bound": self.bound, "asks": self.asks,
        })
        .serialize(serializer)
    }
}

/// Compares.
///
/// # Errors
///
/// Where skin, bundles or bags cannot be read, or they hold nothing to learn from or to compare on.
pub fn compare(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let (skin, model) = nominal(&options.skin, families, progress)?;
    let labels = options.labels.options()?;
    let learned = Dataset::from_bags(&options.train, &skin, &labels)?;
    let data = Dataset::from_bags(&options.bags, &skin, &labels)?;
    let compliance = Compliance::of(model.as_ref(), 0.010)?;
    let test = frames(&data, options, &compliance)?;
    if test.values().all(Vec::is_empty) {
        bail!("these bags hold no frame of one or two contacts of {} N or more each", options.least);
    }
    let all: Vec<SampleId> =
        learned.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
    let (learn, choose) = parts(&learned, &all);
    let prepared = prepare(options, &skin, &model, &compliance, &learned, (&learn, &choose), progress)?;
    let mut rows = Vec::new();
    let mut shown: Option<ShownFrame> = None;
    for (name, mut method) in prepared.methods {
        progress.begin(&name);
        for (kind, ids) in &test {
            if ids.is_empty() || (method.single() && *kind != Kind::Single) {
                continue;
            }
            rows.push(row(&name, method.as_mut(), *kind, &data, ids, &options.bins, progress)?);
        }
    }
    // A frame to look at: the first bundle's map of two contacts far apart.
    if let (Some(path), Some(id)) = (options.model.first(), test.get(&Kind::Far).and_then(|ids| ids.first()))
    {
        let runtime = Runtime::load(&RuntimeConfig::default())?;
        let mut peaks = MapFinder::new(&Bundle::load(path, &skin)?, &skin, runtime)?;
        if let Some((_, sample)) = data.gather(&[*id])?.first() {
            let map = peaks.map(&conditioned(sample))?.to_vec();
            let contacts = sample.truth.as_ref().map(|t| t.contacts.clone()).unwrap_or_default();
            shown = Some(ShownFrame { map, contacts });
        }
    }
    let singles = test.get(&Kind::Single).map(Vec::as_slice).unwrap_or_default();
    let bound = if singles.is_empty() {
        None
    } else {
        bounds(model.as_ref(), &data, Some(singles), Unknowns::Normal, &options.bins)?
    };
    let asks = asks(&rows);
    Ok(Findings {
        request: options.clone(),
        skin,
        gives_way: compliance.share(),
        learned: (learned.hash(), prepared.notes),
        tested: data.hash(),
        frames: test.iter().map(|(kind, ids)| (*kind, ids.len())).collect(),
        rows,
        bound,
        asks,
        shown,
    })
}

/// Touched frames of one and two contacts, evenly thinned.
fn frames(
    data: &Dataset,
    options: &Request,
    compliance: &Compliance,
) -> Result<BTreeMap<Kind, Vec<SampleId>>> {
    let mut all: BTreeMap<Kind, Vec<SampleId>> = BTreeMap::new();
    let heavy = |c: &TruthContact| {
        c.normal_force().is_some_and(|f| f >= options.least)
            && (options.rigid || compliance.gives_way(&c.position))
    };
    for run in 0..data.runs().len() {
        for (sample, read) in data.stream(run)?.enumerate() {
            let read = read?;
            if let Some(truth) = &read.truth
                && let Some(kind) = Kind::of(truth)
                && truth.contacts.iter().all(heavy)
                && read.tared.iter().any(|v| v.is_finite())
            {
                all.entry(kind).or_default().push(SampleId { run, sample });
            }
        }
    }
    for ids in all.values_mut() {
        let step = ids.len().div_ceil(options.most.max(1)).max(1);
        *ids = ids.iter().copied().step_by(step).collect();
    }
    Ok(all)
}

fn row(
    name: &str,
    method: &mut dyn ContactFinder,
    kind: Kind,
    data: &Dataset,
    ids: &[SampleId],
    bins: &[f64],
    progress: &dyn Progress,
) -> Result<Row> {
    let mut evaluator = Evaluator::new().by_force(bins);
    let (mut distances, mut forces) = (Vec::new(), Vec::new());
    let (mut right, mut wanted) = (0usize, 0usize);
    let read = data.gather(ids)?;
    let started = Instant::now();
    for (n, (id, sample)) in read.iter().enumerate() {
        let Some(truth) = sample.truth.as_ref() else { continue };
        // These frames do not follow each other.
        method.reset();
        let contacts = method.find(&conditioned(sample))?;
        progress.at((n + 1) as f64 / ids.len() as f64);
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
pub struct TargetFigure {
    /// Which figure.
    pub what: &'static str,
    /// What it should be.
    pub asked: String,
    /// Method that comes nearest.
    pub method: String,
    /// Its figure.
    pub found: String,
    /// Whether that is enough.
    pub reached: bool,
}

/// The asks of this study: mean errors of one contact, of two (all distances), and the number of contacts.
fn asks(rows: &[Row]) -> Vec<TargetFigure> {
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
            all.push(TargetFigure {
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
        all.push(TargetFigure {
            what: "number of contacts, two far apart",
            asked: "90 %".into(),
            method: method.to_owned(),
            found: format!("{:.1} %", right * 100.0),
            reached: right >= 0.9,
        });
    }
    all
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
