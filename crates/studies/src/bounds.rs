//! How well a skin can know a contact at best, from its forward model or from a recording.
//!
//! Problem: which error of place and force must every estimator make on these channels? Method: Cramér–Rao bounds of one and
//! of two contacts over the surface, and taxel value isolines with the deviations σ_P, σ_F and the super-resolution factor Ω
//! of the thesis' chapter 5 (equations 5.1 to 5.24). Assumptions: independent Gaussian noise of the channels, one frame, an
//! estimator without bias. Cost: one response of the model for each point, force and difference; seconds for some hundred points
//! and some hundred channels. Isolines are computed of at most [`dermis_theory::MOST_STUDIED`] channels of the row, or of those that
//! σ_P needs; bands are overlapped of at most [`dermis_theory::MOST_BANDS`] channels at a place.

mod sources;
mod summary;
mod surface;
mod trends;

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use dermis_learn::cli::Labels;
use dermis_model::{ForwardModel, TipShape, Unknowns};
use dermis_skin::{Rated, SkinDescription, Surface, TipKind};
use dermis_theory::resolution::Testbed;
use dermis_theory::{
    BandBox, Isoline, Line, LineStudy, StudyOptions, Summary, SurfaceBound, TwoContacts, force_ladder,
    longest_row, over_surface, over_surface_and_bands, two_contacts,
};
use nalgebra::Point3;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use crate::{Families, Progress};

pub use sources::Source;
pub use summary::{alphas, by_interval, median, share_by_interval, summary};
use surface::surface_study;
pub use trends::{Trend, TrendCurve, trends};

/// \[m\] between distances of two contacts that are bounded, at least; a quarter of a tip where that is more.
const LEAST_STEP: f64 = 1e-3;
/// These distances in such steps.
const DISTANCES: std::ops::RangeInclusive<u32> = 1..=40;
/// \[N\] range of forces that isolines and factors are computed for, and their step (thesis 5.7.1).
const FORCES: [f64; 2] = [0.02, 1.5];
const FORCE_STEP: f64 = 0.01;
/// Forces of the maps over position and force.
const MAP_FORCES: u32 = 28;
/// Isolines of a taxel.
const VALUES: i32 = 12;
/// \[N\] edges of the intervals in which σ_P is summarised: those of the thesis' Table 5.2.
pub const INTERVALS: [f64; 8] = [0.02, 0.14, 0.2, 0.4, 0.6, 0.9, 1.2, 1.5];

/// What to bound.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Skin description.
    pub skin: PathBuf,
    /// Pressing force [N]; may be repeated. Those that the skin is rated for where absent.
    #[arg(long)]
    pub force: Vec<f64>,
    /// Diameter of the tip [m]; that which the skin is rated for where absent.
    #[arg(long)]
    pub diameter: Option<f64>,
    /// End of the tip; that which the skin is rated for where absent. Isolines are always those of a ball.
    #[arg(long, value_enum)]
    pub tip: Option<TipChoice>,
    /// Shear is unknown, too; otherwise the contact is known to press along the normal.
    #[arg(long, conflicts_with = "line")]
    pub shear: bool,
    /// Only x is unknown of the place: for taxels in a row.
    #[arg(long)]
    pub line: bool,
    /// Labelled bag to take the isolines and the noise from, in place of the model; may be repeated.
    #[arg(long)]
    pub bag: Vec<PathBuf>,
    /// How the bags are read.
    #[command(flatten)]
    pub labels: Labels,
    /// Smallest reading that counts, in the unit of the skin; the node's threshold of a contact where absent.
    #[arg(long)]
    pub least: Option<f64>,
    /// How isolines change with the design and the tip, too: some skins more to be simulated, which only a page shows.
    #[arg(skip)]
    pub trends: bool,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            skin: PathBuf::new(),
            force: Vec::new(),
            diameter: None,
            tip: None,
            shear: false,
            line: false,
            bag: Vec::new(),
            labels: Labels::default(),
            least: None,
            trends: false,
        }
    }
}

impl Request {
    /// The same with what the skin is rated for in the place of what was not said.
    #[must_use]
    pub fn for_skin(&self, skin: &SkinDescription) -> Self {
        let rated = skin.rated_press();
        let mut request = self.clone();
        if request.force.is_empty() {
            request.force = rated.ladder();
        }
        request.diameter.get_or_insert(rated.diameter);
        request.tip.get_or_insert(rated.tip.into());
        request
    }

    /// What presses.
    #[must_use]
    pub fn tip(&self) -> TipShape {
        TipShape::of_kind(self.tip.unwrap_or(TipChoice::Sphere).into(), self.diameter())
    }

    /// \[m\] of the tip.
    #[must_use]
    pub fn diameter(&self) -> f64 {
        self.diameter.unwrap_or_else(|| Rated::default().diameter)
    }
}

/// [`TipKind`], as the command line says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TipChoice {
    /// A ball.
    Sphere,
    /// The flat end of a round rod.
    FlatPunch,
}

impl From<TipKind> for TipChoice {
    fn from(kind: TipKind) -> Self {
        match kind {
            TipKind::Sphere => Self::Sphere,
            TipKind::FlatPunch => Self::FlatPunch,
        }
    }
}

impl From<TipChoice> for TipKind {
    fn from(choice: TipChoice) -> Self {
        match choice {
            TipChoice::Sphere => Self::Sphere,
            TipChoice::FlatPunch => Self::FlatPunch,
        }
    }
}

/// What isolines say of a whole surface.
#[derive(Serialize)]
pub struct SurfaceStudy {
    /// F_S \[N\] at every point: from here on three taxels read S_min.
    pub minimum_force: Vec<Option<f64>>,
    /// The same over the surface.
    pub minimum_force_summary: Summary,
    /// The channel nearest to the middle.
    pub channel: usize,
    /// Isoline of a value of that channel.
    pub isoline: Isoline,
    /// By force.
    pub factors: Vec<SurfaceFactor>,
}

/// Super-resolution under one force, over the part of the surface that lies between the outermost taxels.
#[derive(Serialize)]
pub struct SurfaceFactor {
    /// \[N\].
    pub force: f64,
    /// \[m\] along both directions: root mean square of the bound.
    pub bound: [f64; 2],
    /// \[m\] median of the bound.
    pub bound_median: [f64; 2],
    /// \[m\] median of the box around the bands of the three taxels that read most: where they run parallel there is no box,
    /// so that these have no mean.
    pub bands_median: [f64; 2],
    /// Ω (5.24) of `bound`.
    pub factor: f64,
    /// The same with the testbed's precision.
    pub factor_with_testbed: f64,
    /// Ω of `bound_median`.
    pub bound_median_factor: f64,
    /// Ω of `bands_median`.
    pub bands_median_factor: f64,
}

/// Everything that was found.
pub struct Findings {
    /// What was requested.
    pub request: Request,
    /// The skin.
    pub skin: SkinDescription,
    /// Its forward model; a recording can do without.
    pub model: Option<std::sync::Arc<dyn ForwardModel>>,
    /// Where readings came from.
    pub source: Source,
    /// Smallest reading that counts, in the unit of the skin.
    pub least: f64,
    /// What is unknown of a contact.
    pub unknowns: Unknowns,
    /// Bounds of one contact all over the skin, by force.
    pub maps: Vec<SurfaceBound>,
    /// Bounds of two contacts across the middle, by their distance.
    pub pairs: Vec<TwoContacts>,
    /// The row that most taxels lie on.
    pub line: Option<LineStudy>,
    /// Shares of pairs on the line that the isolines tell apart, at each of the distances of `pairs`.
    pub distinguishable: Vec<f64>,
    /// Isolines over the surface.
    pub surface: Option<SurfaceStudy>,
    /// How isolines change with the design and the tip.
    pub trends: Vec<Trend>,
    /// What could not be studied, and why.
    pub notes: Vec<String>,
}

/// The whole record; [`summary`] leaves out what belongs to single locations.
impl Serialize for Findings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        json!({
            "summary": summary(self),
            "points": self.skin.surface().points,
            "maps": self.maps,
            "line": self.line,
            "surface": self.surface,
            "trends": self.trends,
        })
        .serialize(serializer)
    }
}

/// Bounds one contact all over the skin and two contacts across its middle, and studies its isolines.
///
/// # Errors
///
/// Where the skin, its model or a bag cannot be read, or a number of the request cannot be.
pub fn bound(options: &Request, families: &Families, progress: &dyn Progress) -> Result<Findings> {
    let skin = SkinDescription::load(&options.skin)?;
    let options = &options.for_skin(&skin);
    let model = families.model_of_file(&options.skin, &skin);
    let (model, mut notes) = match (model, options.bag.is_empty()) {
        (Ok(model), _) => (Some(model), Vec::new()),
        (Err(error), true) => return Err(error),
        (Err(error), false) => {
            (None, vec![format!("there is no forward model, hence no bound of the surface: {error}")])
        }
    };
    let Some(&middle) = options.force.get(options.force.len() / 2) else { bail!("no force is given") };
    let source = Source::new(options, &skin, model.as_ref(), progress)?;
    let noise = source.noise().iter().copied().fold(0.0, f64::max);
    let least = options.least.unwrap_or(skin.condition.contact_threshold * noise);
    if !(least.is_finite() && least > 0.0) {
        bail!("option `--least` is {least} {} and must be positive", skin.unit);
    }
    let unknowns = match (options.line, options.shear) {
        (true, _) => Unknowns::Line,
        (false, true) => Unknowns::Full,
        (false, false) => Unknowns::Normal,
    };
    progress.begin(&skin.name);
    let surface = skin.surface();
    let reason = no_isolines(&skin);
    let (mut maps, mut boxes, mut pairs) = (Vec::new(), Vec::new(), Vec::new());
    if let Some(model) = &model {
        let bands = unknowns == Unknowns::Normal && reason.is_none();
        (maps, boxes) = over_all_forces(model.as_ref(), options, (unknowns, bands), progress)?;
        pairs = pairs_of(model.as_ref(), middle, options.tip(), unknowns)?;
    }
    let feet = feet(&skin, &surface);
    let mut distinguishable = Vec::new();
    let line = match line_of(reason.as_deref(), &source, &surface, &feet, options) {
        Ok(None) => None,
        Ok(Some(line)) => {
            let study = line.study(&study_options(&line, least), |share| {
                progress.at(0.3 + 0.4 * share);
            });
            let distances: Vec<f64> = pairs.iter().map(|p| p.distance).collect();
            distinguishable = line.distinguishable_by_distance(middle, least, &distances);
            Some(study)
        }
        Err(error) => {
            notes.push(format!("there is no line of taxels to study: {error}"));
            None
        }
    };
    let on_surface = if options.line || reason.is_some() {
        None
    } else {
        Some(surface_study(&source, model.as_deref(), &surface, &feet, (least, options), (&maps, &boxes))?)
    };
    notes.extend(reason.clone());
    progress.at(0.8);
    // A recording is of the skin as it is, and only the page shows how others would be.
    let trends = match &model {
        Some(model) if options.bag.is_empty() && options.trends && reason.is_none() => {
            trends(&skin, model, &feet, options.diameter(), families)?
        }
        _ => Vec::new(),
    };
    Ok(Findings {
        request: options.clone(),
        skin,
        model,
        source,
        least,
        unknowns,
        maps,
        pairs,
        line,
        distinguishable,
        surface: on_surface,
        trends,
        notes,
    })
}

/// Bounds all over the skin by force; and the boxes of the strongest bands where the same derivatives give them: the study of the
/// surface takes shear for known.
fn over_all_forces(
    model: &dyn ForwardModel,
    options: &Request,
    (unknowns, bands): (Unknowns, bool),
    progress: &dyn Progress,
) -> Result<(Vec<SurfaceBound>, Vec<Vec<BandBox>>)> {
    let (mut maps, mut boxes) = (Vec::new(), Vec::new());
    for (i, &force) in options.force.iter().enumerate() {
        if bands {
            let (map, bands) = over_surface_and_bands(model, force, options.tip(), unknowns)?;
            maps.push(map);
            boxes.push(bands);
        } else {
            maps.push(over_surface(model, force, options.tip(), unknowns)?);
        }
        progress.at(0.3 * (i + 1) as f64 / options.force.len() as f64);
    }
    Ok((maps, boxes))
}

/// Points of the surface above each channel's taxel.
#[must_use]
pub fn feet(skin: &SkinDescription, surface: &Surface) -> Vec<Point3<f64>> {
    skin.channel_taxels().into_iter().map(|t| surface.project(&skin.taxels[t].point()).0).collect()
}

/// Why isolines say nothing of a skin; `None` where they do. Each channel needs a place of its own, from which distances count.
fn no_isolines(skin: &SkinDescription) -> Option<String> {
    let (channels, taxels) = (skin.channels().len(), skin.taxels.len());
    (skin.condition.coupled && channels > taxels).then(|| {
        format!(
            "isolines are not studied: the channels are coupled, and each of the {channels} reads all of the skin between its {taxels} \
             elements, so that it has no place of its own from which a distance to a contact could be counted"
        )
    })
}

/// The row that most taxels lie on, where isolines say anything.
fn line_of(
    reason: Option<&str>,
    source: &Source,
    surface: &Surface,
    feet: &[Point3<f64>],
    options: &Request,
) -> Result<Option<Line>> {
    if reason.is_some() {
        return Ok(None);
    }
    line(source, surface, feet, options.diameter()).map(Some)
}

/// The row that most taxels lie on.
fn line(source: &Source, surface: &Surface, feet: &[Point3<f64>], diameter: f64) -> Result<Line> {
    let (_, tolerance) = longest_row(surface, feet, 1e-3)?;
    let (path, tolerance) = longest_row(surface, feet, tolerance * source.fineness())?;
    let forces = force_ladder(source.force_max(), 40);
    let responses = source.responses(surface, &path.points, &forces, diameter, tolerance)?;
    Ok(Line::new(responses, &path, surface, feet, tolerance)?)
}

/// What the thesis looks at, as far as the skin reaches.
fn study_options(line: &Line, least: f64) -> StudyOptions {
    let most = line.responses().forces().last().map_or(FORCES[1], |f| f.min(FORCES[1]));
    let steps = ((most - FORCES[0]) / FORCE_STEP).round().max(1.0) as u32;
    let forces = (0..=steps).map(|i| FORCES[0] + f64::from(i) * FORCE_STEP).collect();
    let ratio = (most / FORCES[0]).ln() / f64::from(MAP_FORCES - 1);
    let map_forces = (0..MAP_FORCES).map(|i| FORCES[0] * (f64::from(i) * ratio).exp()).collect();
    // From the smallest reading to what the weakest taxel reads under the largest force straight above it.
    let above = line
        .taxels()
        .iter()
        .map(|t| line.responses().reading(line.location(t.foot), t.channel, most * 0.999));
    let largest = above.filter(|v| v.is_finite()).fold(f64::INFINITY, f64::min).max(2.0 * least);
    let largest = if largest.is_finite() { largest } else { 10.0 * least };
    let values =
        (0..VALUES).map(|i| least * (largest / least).powf(f64::from(i) / f64::from(VALUES - 1))).collect();
    // Many channels may have one foot.
    let mut feet: Vec<f64> = line.taxels().iter().map(|t| t.foot).collect();
    feet.dedup();
    let pitch = line.span() / (feet.len() - 1).max(1) as f64;
    StudyOptions { least, values, forces, map_forces, step: pitch / 13.0, testbed: Testbed::THESIS }
}

fn middle_of(surface: &Surface) -> Point3<f64> {
    let count = surface.points.len().max(1) as f64;
    Point3::from(surface.points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / count)
}

/// Two contacts of one force, as far apart as the surface allows.
fn pairs_of(
    model: &dyn ForwardModel,
    force: f64,
    tip: TipShape,
    unknowns: Unknowns,
) -> Result<Vec<TwoContacts>> {
    let middle = middle_of(model.surface());
    let width = model.surface().points.iter().map(|p| (p.x - middle.x).abs()).fold(0.0, f64::max) * 2.0;
    let step = LEAST_STEP.max(tip.extent() / 4.0);
    let distances: Vec<f64> = DISTANCES.map(|steps| f64::from(steps) * step).filter(|d| *d < width).collect();
    Ok(two_contacts(model, &middle, &distances, force, tip, unknowns)?)
}
