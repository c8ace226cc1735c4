//! Ways to one and two contacts, side by side on the same recordings. The sampled frames do not follow each other, so each is
//! taken by itself; a node follows contacts from frame to frame.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use dermis_estimate::finder::MapFinder;
use dermis_inference::{Bundle, Runtime, RuntimeConfig};
use dermis_learn::cli::Labels;
use dermis_learn::real2sim::Compliance;
use dermis_learn::{Bounds, SampleId, Truth, TruthContact, frame_bounds};
use dermis_model::Unknowns;
use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};

use super::nominal;
use super::train::parts;
use crate::{Families, LeftOut, Progress, labelled};

mod evaluator;
mod methods;

pub use evaluator::{Errors, Row};
pub(super) use evaluator::{MethodEvaluator, Targets};
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
    /// Labelled bags with one and two contacts of the same device, at locations and forces of other seeds.
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

/// One frame to look at.
pub struct ShownFrame {
    /// \[m\] of every point of the surface.
    pub map: Vec<f64>,
    /// What truly touched.
    pub contacts: Vec<TruthContact>,
}

/// Everything that was found.
pub struct Findings {
    /// What was requested.
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
    /// What any estimator without bias could reach on the contacts that are compared, of one and of two.
    pub bound: Option<Bounds>,
    /// Touched frames that are not compared, and why.
    pub left_out: Vec<LeftOut>,
    /// Target figures.
    pub asks: Vec<TargetFigure>,
    /// The first bundle's map of two contacts far apart.
    pub shown: Option<ShownFrame>,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let frames: BTreeMap<&str, usize> = self.frames.iter().map(|(k, n)| (k.name(), *n)).collect();
        json!({
            "skin": self.skin.name, "skin_hash": self.skin.hash(), "least_n": self.request.least,
            "bins_n": self.request.bins, "rigid_locations": self.request.rigid,
            "share_that_gives_way": self.gives_way,
            "learned": { "data_hash": self.learned.0, "notes": self.learned.1 },
            "tested": { "data_hash": self.tested, "frames": frames },
            "rows": self.rows, "bound": self.bound, "left_out": self.left_out, "asks": self.asks,
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
    let learned = labelled(&options.train, &skin, &labels, progress)?;
    let data = labelled(&options.bags, &skin, &labels, progress)?;
    let compliance = Compliance::of(model.as_ref(), 0.010)?;
    let targets = Targets::of(&data, options, &compliance)?;
    let test = &targets.all;
    if test.values().all(Vec::is_empty) {
        bail!("these bags hold no frame of one or two contacts of {} N or more each", options.least);
    }
    let all: Vec<SampleId> =
        learned.labelled().filter(|(_, _, t)| t.single().is_some()).map(|(id, ..)| id).collect();
    let (learn, choose) = parts(&learned, &all);
    let prepared = prepare(options, &skin, &model, &compliance, &learned, (&learn, &choose), progress)?;
    let compared: Vec<SampleId> = targets.compared().copied().collect();
    let bounds = frame_bounds(model.as_ref(), &data, Some(&compared), Unknowns::Normal)?;
    let evaluator =
        MethodEvaluator { data: &data, bounds: &bounds, bins: &options.bins, kept: targets.kept.as_ref() };
    let mut rows = Vec::new();
    let mut shown: Option<ShownFrame> = None;
    for (name, mut method) in prepared.methods {
        progress.begin(&name);
        for (kind, ids) in test {
            if ids.is_empty() || (method.single() && *kind != Kind::Single) {
                continue;
            }
            rows.push(evaluator.row(&name, method.as_mut(), (*kind, ids), progress)?);
        }
    }
    // A frame to look at: the first bundle's map of two contacts far apart.
    if let (Some(path), Some(id)) = (options.model.first(), test.get(&Kind::Far).and_then(|ids| ids.first()))
    {
        let runtime = Runtime::load(&RuntimeConfig::default())?;
        let mut peaks = MapFinder::new(&Bundle::load(path, &skin)?, &skin, runtime)?;
        if let Some((_, sample)) = data.gather(&[*id])?.first() {
            let map = peaks.map(&sample.conditioned())?.to_vec();
            let contacts = sample.truth.as_ref().map(|t| t.contacts.clone()).unwrap_or_default();
            shown = Some(ShownFrame { map, contacts });
        }
    }
    let bound = bounds.summary(&options.bins);
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
        left_out: targets.left_out,
        asks,
        shown,
    })
}

/// One target figure.
#[derive(Debug, Clone, Serialize)]
pub struct TargetFigure {
    /// Which figure.
    pub what: &'static str,
    /// What it should be.
    pub target: String,
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
        let found: Vec<&Errors> = rows
            .iter()
            .filter(|r| r.method == method && kinds.iter().any(|k| k.name() == r.kind))
            .map(|r| &r.errors)
            .filter(|e| e.count_right.is_some())
            .collect();
        let frames = found.iter().map(|r| r.frames).sum::<usize>() as f64;
        let mean = |value: fn(&Errors) -> f64| {
            found.iter().map(|r| value(r) * r.frames as f64).sum::<f64>() / frames
        };
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
                target: format!("{:.0} mm, {force} N", place * 1e3),
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
            target: "90 %".into(),
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
        let errors = Errors {
            frames: 10,
            count_right: right,
            position_mean: place,
            position_rms: place,
            position_median: place,
            force_mean: force,
            force_rms: force,
            lost: 0.0,
        };
        Row {
            method: method.into(),
            kind: kind.name(),
            with_everything: None,
            errors,
            found: None,
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
        let lines: Vec<String> =
            found.iter().map(|a| format!("{} {} {} {}", a.what, a.method, a.found, a.reached)).collect();
        insta::assert_snapshot!(lines.join("\n"), @r"
        one contact, mean errors a 4.00 mm, 1.00 N true
        two contacts, mean errors a 6.00 mm, 1.00 N false
        number of contacts, two far apart a 80.0 % false
        ");
    }
}
