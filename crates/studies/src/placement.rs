//! Where to put k sensing elements, of thousands of locations where they could be.
//!
//! Method: the forward model is pressed once at many locations and read at all candidates; then greedy support vector regression,
//! pivoted QR of principal components, entropy and mutual information of a Gaussian process (the thesis' chapter 2), and the
//! Cramér–Rao bound each choose a set. All sets are judged alike: by a support vector regression on locations that no method saw,
//! also with elements that fail. Assumptions: noise as the skin says; forces as requested. Cost: one response for each place
//! and force; the searches take from milliseconds (bound) to minutes (greedy regression).

pub(crate) mod candidates;
mod presses;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use dermis_skin::{SkinDescription, Surface, Taxel};
use dermis_theory::placement::{
    BoundSettings, Evaluation, EvaluationSettings, Feasibility, Field, GaussianField, GreedySettings, Method,
    Reduction, Sets, Verdict, by_bound, evaluate, feasible, greedy_svr, pca_qr, reduce,
};
use nalgebra::Point3;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use self::presses::{forces, pressed};
use crate::flat::laid_flat;
use crate::{Families, Progress};

/// Locations that crlb looks at, at most.
const SEEN: usize = 700;
/// Points of the surface that the Gaussian process knows at most.
const SITES: usize = 1600;
/// Of the distances between points of the surface: how far the centre of those around may lie off a candidate.
const EDGE: f64 = 0.5;

/// What to place where.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    pub skin: PathBuf,
    /// How; may be repeated.
    #[arg(long, value_enum, default_value = "all")]
    pub method: Vec<MethodChoice>,
    /// Elements.
    #[arg(long, default_value_t = Request::default().budget, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub budget: u32,
    /// Pressing force [N]; of several any may be met, and the estimator does not know which. One under which the elements of
    /// the skin read 300 times their noise where absent.
    #[arg(long)]
    pub force: Vec<f64>,
    /// Diameter of the tip [m].
    #[arg(long, default_value_t = Request::default().diameter)]
    pub diameter: f64,
    /// Locations that are pressed at most.
    #[serde(alias = "places")]
    #[arg(long, alias = "places", default_value_t = Request::default().locations)]
    pub locations: usize,
    /// Share of the locations that no method sees, and that all are judged on.
    #[arg(long, default_value_t = Request::default().held_out)]
    pub held_out: f64,
    /// Locations that greedy-svr cross-validates with at most, and pca-qr takes its components from.
    #[arg(long, default_value_t = Request::default().searched)]
    pub searched: usize,
    /// Distance from where the skin is held [m] below which nothing is placed or pressed.
    #[arg(long, default_value_t = Request::default().margin)]
    pub margin: f64,
    /// Points of the surface around a candidate that say whether it is at an edge.
    #[arg(long, default_value_t = Request::default().neighbours)]
    pub neighbours: usize,
    /// How far their centre may lie off it [m]; half of the distance between points where absent.
    #[arg(long)]
    pub edge: Option<f64>,
    /// Share of the variance of all candidates' readings that those of them may leave unexplained which greedy-svr tries.
    #[arg(long, default_value_t = Request::default().unexplained)]
    pub unexplained: f64,
    /// Noises and divisions of the locations that the evaluation is repeated with.
    #[arg(long, default_value_t = Request::default().repeats, value_parser = clap::value_parser!(u64).range(1..=10))]
    pub repeats: u64,
    /// Draws locations, noise and folds.
    #[arg(long, default_value_t = Request::default().seed)]
    pub seed: u64,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            method: vec![MethodChoice::All],
            budget: 10,
            force: Vec::new(),
            diameter: 0.01,
            locations: 1200,
            held_out: 0.25,
            searched: 300,
            margin: 0.02,
            neighbours: 12,
            edge: None,
            unexplained: 0.01,
            repeats: 5,
            seed: 1,
        }
    }
}

/// A method, or all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MethodChoice {
    /// Greedy selection by support vector regression.
    GreedySvr,
    /// Pivoted QR of principal components.
    PcaQr,
    /// Entropy of a Gaussian process.
    GpEntropy,
    /// Mutual information of a Gaussian process.
    GpMi,
    /// The Cramér–Rao bound on the forward model.
    Crlb,
    /// All of them.
    All,
}

impl MethodChoice {
    fn methods(self) -> Vec<Method> {
        match self {
            Self::GreedySvr => vec![Method::GreedySvr],
            Self::PcaQr => vec![Method::PcaQr],
            Self::GpEntropy => vec![Method::GpEntropy],
            Self::GpMi => vec![Method::GpMi],
            Self::Crlb => vec![Method::Crlb],
            Self::All => Method::ALL.to_vec(),
        }
    }
}

/// What one method chose, and what that is worth.
#[derive(Debug, Clone, Serialize)]
pub struct Choice {
    /// Which method.
    pub method: Method,
    /// \[s\] of CPU time of the search on all its threads, readings at hand: what else runs on the machine hardly shows.
    pub seconds: f64,
    /// \[s\] by the clock.
    pub clock: f64,
    /// Threads of the search.
    pub threads: usize,
    /// Indices of candidates, by budget.
    pub sets: Sets,
    /// The elements of the whole budget.
    pub elements: Vec<Taxel>,
    /// Mean distance of the elements along the surface from everywhere, over that of all candidates: above 1 at the rim.
    pub outwardness: f64,
    /// \[m\] mean distance of the elements from the rim of the skin laid flat.
    pub rim: f64,
    /// Errors at locations that no method saw.
    pub evaluation: Evaluation,
}

/// How many candidates there are.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Counts {
    /// Proposed by the sensor family.
    pub all: usize,
    /// Of these at an edge of the surface.
    pub edge: usize,
    /// Of these close to a support.
    pub held: usize,
    /// Of these fit to be built on.
    pub feasible: usize,
    /// Of these needed to tell the readings of all others.
    pub reduced: usize,
}

/// Everything that was found.
pub struct Findings {
    /// What was requested.
    pub request: Request,
    /// The skin.
    pub skin: SkinDescription,
    /// Its surface.
    pub surface: Surface,
    /// Locations of all candidates on the surface, and whether they can be built.
    pub feet: Vec<(Point3<f64>, Verdict)>,
    /// Locations of those that can, in the order of every index.
    pub candidate_locations: Vec<Point3<f64>>,
    /// How many candidates there are.
    pub counts: Counts,
    /// The candidates that tell the others.
    pub reduction: Reduction,
    /// \[N\] that the skin was pressed with.
    pub forces: Vec<f64>,
    /// Locations that methods saw, and that they were judged at.
    pub locations: [usize; 2],
    /// One for each method.
    pub choices: Vec<Choice>,
    /// Whether it ended early: what was not through is left out.
    pub interrupted: bool,
}

impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        summary(self).serialize(serializer)
    }
}

fn summary(findings: &Findings) -> serde_json::Value {
    let options = &findings.request;
    json!({
        "skin": findings.skin.name,
        "skin_hash": findings.skin.hash(),
        "budget": options.budget,
        "seed": options.seed,
        "forces_n": findings.forces,
        "diameter_m": options.diameter,
        "candidates": findings.counts,
        "unexplained": findings.reduction.unexplained,
        "locations": { "seen": findings.locations[0], "held_out": findings.locations[1], "searched": options.searched },
        "rim_of_candidates": rim(&findings.skin, &findings.surface, &findings.candidate_locations),
        "methods": findings.choices,
        "interrupted": findings.interrupted,
        "crlb_against_greedy_svr": against(&findings.choices),
    })
}

/// How much faster ours is than greedy-svr, and its error over that of greedy-svr by number of elements and of failed ones.
fn against(choices: &[Choice]) -> Option<serde_json::Value> {
    let of = |method| choices.iter().find(|c| c.method == method).map(|c| &c.evaluation);
    let (ours, theirs) = (of(Method::Crlb)?, of(Method::GreedySvr)?);
    let by_count: Vec<f64> =
        ours.by_count.iter().zip(&theirs.by_count).map(|(a, b)| a.mean / b.mean).collect();
    let by_failures: Vec<f64> =
        ours.by_failures.iter().zip(&theirs.by_failures).map(|(a, b)| a.mean / b.mean).collect();
    Some(json!({
        "times_faster": faster(choices), "error_by_count": by_count, "error_by_failures": by_failures,
    }))
}

fn check(options: &Request) -> Result<()> {
    for (name, value) in
        [("--force", options.force.iter().copied().fold(1.0, f64::min)), ("--diameter", options.diameter)]
    {
        if !(value.is_finite() && value > 0.0) || options.force.iter().any(|f| !f.is_finite()) {
            bail!("option `{name}` is {value} and must be positive");
        }
    }
    for (name, value, high) in [
        ("--held-out", options.held_out, 0.9),
        ("--unexplained", options.unexplained, 1.0),
        ("--margin", options.margin, f64::INFINITY),
        ("--edge", options.edge.unwrap_or(0.0), f64::INFINITY),
    ] {
        if !(value >= 0.0 && value < high) {
            bail!(
                "option `{name}` is {value} and must be at least 0{}",
                if high < 2.0 { format!(" and below {high}") } else { String::new() }
            );
        }
    }
    if options.locations < 40 || options.searched < 20 {
        bail!(
            "`--locations` must be at least 40 and `--searched` 20: with fewer nothing can be learnt of them"
        );
    }
    Ok(())
}

/// Places and judges.
///
/// # Errors
///
/// Where the skin or its model cannot be, too few candidates are left, or it was interrupted before any method was through.
pub fn place(options: &Request, families: &Families, bar: &dyn Progress) -> Result<Findings> {
    check(options)?;
    let skin = SkinDescription::load(&options.skin)?;
    bar.begin("candidates");
    let surface = skin.surface();
    let proposed = families.of(&skin)?.candidates(&skin)?;
    let held = candidates::held(&skin.surface, &surface);
    let rule = Feasibility {
        neighbours: options.neighbours,
        edge: options.edge.unwrap_or(EDGE * candidates::point_spacing(&surface)),
        held,
        margin: options.margin,
    };
    let feet: Vec<Point3<f64>> = proposed.iter().map(|t| surface.project(&t.point()).0).collect();
    let verdicts = feasible(&surface, &feet, &rule);
    let kept: Vec<usize> = (0..feet.len()).filter(|i| verdicts[*i] == Verdict::Feasible).collect();
    if kept.len() < options.budget as usize {
        bail!(
            "only {} of {} candidates lie away from edges and supports, and {} elements are to be placed: see `--edge` and \
             `--margin`",
            kept.len(),
            feet.len(),
            options.budget
        );
    }
    let taxels: Vec<Taxel> = kept.iter().map(|i| proposed[*i].clone()).collect();
    let candidate_locations: Vec<Point3<f64>> = kept.iter().map(|i| feet[*i]).collect();
    let locations = pressed(&surface, &Feasibility { neighbours: 0, ..rule }, options);
    let forces = forces(&skin, options, &locations, families)?;
    bar.begin("what candidates read");
    let model = families.model_of_file(&options.skin, &skin.with_taxels(taxels.clone())?)?;
    let watch = |share: f64| bar.at(share);
    let Some(field) = Field::of_model(model.as_ref(), &locations, &forces, options.diameter, &watch)? else {
        bail!("interrupted before anything was found");
    };
    drop(model);
    let order = dermis_regress::shuffled(locations.len(), options.seed);
    let out = ((locations.len() as f64 * options.held_out).round() as usize).clamp(1, locations.len() / 2);
    let sorted = |of: &[usize]| {
        let mut of = of.to_vec();
        of.sort_unstable();
        of
    };
    let (ask, teach) = (field.at(&sorted(&order[..out])), field.at(&sorted(&order[out..])));
    // The order is random: its beginning is spread over the skin.
    let first = |count: usize| field.at(&sorted(&order[out..(out + count).min(order.len())]));
    let (few, many) = (first(options.searched), first(SEEN));
    drop(field);
    bar.begin("which of them tell the others");
    let reduction = reduce(&few, options.unexplained)?;
    let counts = Counts {
        all: feet.len(),
        edge: verdicts.iter().filter(|v| **v == Verdict::Edge).count(),
        held: verdicts.iter().filter(|v| **v == Verdict::Held).count(),
        feasible: kept.len(),
        reduced: reduction.chosen.len(),
    };
    let mut findings = Findings {
        request: options.clone(),
        feet: feet.into_iter().zip(verdicts).collect(),
        candidate_locations,
        counts,
        reduction,
        forces,
        locations: [teach.locations.len(), ask.locations.len()],
        choices: Vec::new(),
        interrupted: false,
        skin,
        surface,
    };
    choose(&mut findings, &taxels, [&few, &many, &teach, &ask], options, bar)?;
    if findings.choices.is_empty() {
        bail!("interrupted before any method was through");
    }
    Ok(findings)
}

/// \[s\] of CPU time of this process, threads that have ended included.
fn process_time() -> Result<f64> {
    let time = nix::time::clock_gettime(nix::time::ClockId::CLOCK_PROCESS_CPUTIME_ID)?;
    Ok(Duration::from(time).as_secs_f64())
}

/// Lets every method choose, and judges it; what an interruption leaves undone is left out.
fn choose(
    findings: &mut Findings,
    taxels: &[Taxel],
    [few, many, teach, ask]: [&Field; 4],
    options: &Request,
    bar: &dyn Progress,
) -> Result<()> {
    let watch = |share: f64| bar.at(share);
    bar.begin("distances along the surface");
    let Some(process) = GaussianField::new(&findings.surface, &findings.candidate_locations, SITES, &watch)?
    else {
        findings.interrupted = true;
        return Ok(());
    };
    let mut methods: Vec<Method> = options.method.iter().flat_map(|w| w.methods()).collect();
    methods.sort_unstable();
    methods.dedup();
    let budget = options.budget as usize;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let settings = EvaluationSettings {
        seeds: (0..options.repeats).map(|r| options.seed.wrapping_mul(100).wrapping_add(r)).collect(),
        ..EvaluationSettings::default()
    };
    for method in methods {
        bar.begin(&format!("{}: searching", method.name()));
        let begun = (Instant::now(), process_time()?);
        let (sets, threads) = match method {
            Method::GreedySvr => {
                let settings = GreedySettings { seed: options.seed, threads, ..GreedySettings::default() };
                (greedy_svr(few, &findings.reduction.chosen, budget, &settings, &watch).0, threads)
            }
            Method::PcaQr => (pca_qr(few, budget)?, 1),
            Method::GpEntropy => (process.entropy(budget), 1),
            Method::GpMi => (process.mutual_information(budget)?, 1),
            Method::Crlb => {
                let among = &findings.reduction.chosen;
                (by_bound(many, among, budget, &BoundSettings::default(), &watch).unwrap_or_default(), 1)
            }
        };
        let (clock, seconds) = (begun.0.elapsed().as_secs_f64(), process_time()? - begun.1);
        if !bar.at(1.0) {
            findings.interrupted = true;
            return Ok(());
        }
        bar.begin(&format!("{}: evaluating", method.name()));
        let Some(evaluation) = evaluate(teach, ask, &sets, &settings, &watch)? else {
            findings.interrupted = true;
            return Ok(());
        };
        let elements: Vec<Taxel> = sets
            .last()
            .iter()
            .enumerate()
            .map(|(n, c)| Taxel { name: format!("g{n}"), ..taxels[*c].clone() })
            .collect();
        let feet: Vec<Point3<f64>> = sets.last().iter().map(|c| findings.candidate_locations[*c]).collect();
        findings.choices.push(Choice {
            method,
            seconds,
            clock,
            threads,
            outwardness: process.outwardness(&feet),
            rim: rim(&findings.skin, &findings.surface, &feet),
            sets,
            elements,
            evaluation,
        });
    }
    Ok(())
}

/// How often the bound is faster than greedy-svr, where both were run.
#[must_use]
pub fn faster(choices: &[Choice]) -> Option<f64> {
    let seconds = |method| choices.iter().find(|c| c.method == method).map(|c| c.seconds);
    Some(seconds(Method::GreedySvr)? / seconds(Method::Crlb)?.max(1e-9))
}

/// \[m\] mean distance of points from the rim of the skin laid flat, which is taken for a rectangle.
#[must_use]
pub fn rim(skin: &SkinDescription, surface: &Surface, points: &[Point3<f64>]) -> f64 {
    let (all, _) = laid_flat(skin, surface, &surface.points);
    let (first, last) = all
        .iter()
        .fold(((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY)), |(low, high), p| {
            ((low.0.min(p.0), low.1.min(p.1)), (high.0.max(p.0), high.1.max(p.1)))
        });
    let (flat, _) = laid_flat(skin, surface, points);
    let away = flat.iter().map(|p| (p.0 - first.0).min(last.0 - p.0).min(p.1 - first.1).min(last.1 - p.1));
    away.sum::<f64>() / points.len().max(1) as f64 * 1e-3
}

#[cfg(test)]
mod tests;
