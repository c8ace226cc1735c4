//! What a testbed does to a skin, as a file says it.

mod limits;
mod numbers;
mod step;
mod step_file;
mod steps;
mod tip;

use std::path::Path;

use dermis_model::TipShape;
use dermis_skin::{SkinDescription, SurfaceSpec, TipKind};
use serde::{Deserialize, Serialize};

use crate::TestbedError;
pub(crate) use limits::LONGEST;
use numbers::OneOrMore;
pub use step::{Action, Drawn, HEX_ARMS, Level, Levels, PostureSet, PressProfile, Step, Strokes};
use step_file::StepFile;
pub use tip::PlanTip;

const SCHEMA: &str = "dermis-plan/1";

/// How long the phases of a press last: each duration is drawn uniformly from its range \[s\].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Timing {
    /// Above the surface, not touching.
    pub approach: [f64; 2],
    /// From first contact to full force.
    pub load: [f64; 2],
    /// At full force; a slide takes as long as its way.
    pub hold: [f64; 2],
    /// From full force to none.
    pub unload: [f64; 2],
    /// Untouched after the press.
    pub gap: [f64; 2],
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            approach: [0.05, 0.1],
            load: [0.1, 0.2],
            hold: [0.2, 0.4],
            unload: [0.1, 0.2],
            gap: [0.1, 0.3],
        }
    }
}

/// How a force is drawn from its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForceDistribution {
    /// Every force is as likely as any other.
    #[default]
    Uniform,
    /// Every ratio is as likely as any other: as many presses from 0.1 to 0.2 N as from 1 to 2 N.
    Log,
}

/// What a testbed does to a skin: a list of steps, and what they have in common.
///
/// A file is TOML; see `launch/plans/` for examples to copy. Unknown keys are errors. What is drawn at random
/// depends on the seed, the steps and the skin's surface only.
///
/// ```
/// use dermis_testbed::Plan;
///
/// let plan = Plan::from_toml(
///     r#"
///     schema = "dermis-plan/1"
///     name = "ten-presses"
///     diameter = 0.004
///     [[steps]]
///     kind = "presses"
///     count = 10
///     force = [0.1, 1.0]
///     "#,
///     "ten-presses.toml",
/// )?;
/// assert_eq!(plan.steps.len(), 1);
/// # Ok::<(), dermis_testbed::TestbedError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    schema: &'static str,
    /// What errors call it.
    #[serde(skip)]
    file: String,
    /// What recordings of it are called.
    pub name: String,
    /// Free text.
    pub description: String,
    /// Seed where the caller gives none.
    pub seed: u64,
    /// \[m\] of the indenter's spherical tip; of several, one is drawn for each place.
    pub diameter: Vec<f64>,
    /// A tip that is no sphere, instead of `diameter`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip: Option<PlanTip>,
    /// \[m/s²\] in the frame of the link; none where absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity: Option<[f64; 3]>,
    /// \[m\] that contacts keep from the rim of the surface.
    pub margin: f64,
    /// \[m\] two corners of a box in the link frame that locations are drawn from; all of the surface where absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub region: Option<[[f64; 3]; 2]>,
    /// How forces and depths are drawn from their ranges.
    pub force_distribution: ForceDistribution,
    /// \[N\] standard deviation of the ground truth's force along each axis: what a force sensor of this class adds.
    pub force_noise: f64,
    /// \[m\] standard deviation of the ground truth's position along each axis, one draw a press: what a positioning stage of
    /// this class misses by.
    pub stage_noise: f64,
    /// How long the phases of a press last.
    pub timing: Timing,
    /// What is done, in order.
    pub steps: Vec<Step>,
}

/// A plan as files say it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    schema: String,
    name: String,
    #[serde(default)]
    description: String,
    #[serde(default)]
    seed: u64,
    diameter: Option<OneOrMore>,
    tip: Option<PlanTip>,
    gravity: Option<[f64; 3]>,
    #[serde(default)]
    margin: f64,
    region: Option<[[f64; 3]; 2]>,
    #[serde(default)]
    force_distribution: ForceDistribution,
    #[serde(default = "force_noise")]
    force_noise: f64,
    #[serde(default = "stage_noise")]
    stage_noise: f64,
    #[serde(default)]
    timing: Timing,
    steps: Vec<StepFile>,
}

/// The thesis' force sensor \[N\].
fn force_noise() -> f64 {
    0.004
}

/// The thesis' stage \[m\].
fn stage_noise() -> f64 {
    7.5e-6
}

/// \[m/s²\] of gravity and acceleration at most: a hundred times that of the earth.
const GRAVITY: f64 = 1e3;

/// Diameters of the tip that a rectangle is wider than, for presses to keep off its rim.
const ROOM: f64 = 4.0;

/// Most contacts of a plan: what fits into memory with room to spare.
pub(crate) const PRESSES_MAX: u64 = 1_000_000;

impl Plan {
    /// An endless walk of a hand over the skin: single presses, slides and pairs of contacts with pauses, for
    /// demonstrations. `force` \[N\] is the range of the pressing forces, `diameter` \[m\] the tip's.
    #[must_use]
    pub fn random_touches(diameter: f64, force: [f64; 2]) -> Self {
        let mut steps = Vec::new();
        for _ in 0..20 {
            let (length, speed) = ([0.004, 0.012], [0.005, 0.02]);
            steps.push(Action::Presses { count: 3, level: Level::Force(force), repeats: 1 }.into());
            let strokes = Strokes::default();
            steps.push(Action::Slides { count: 1, force, length, speed, strokes }.into());
            steps.push(Action::Idle { duration: 0.5 }.into());
        }
        let name = "random-touches".to_owned();
        Self {
            schema: SCHEMA,
            file: name.clone(),
            name,
            description: String::new(),
            seed: 0,
            diameter: vec![diameter],
            tip: None,
            gravity: None,
            margin: diameter,
            region: None,
            force_distribution: ForceDistribution::Uniform,
            force_noise: force_noise(),
            stage_noise: stage_noise(),
            timing: Timing { hold: [0.4, 1.0], gap: [0.3, 0.6], ..Timing::default() },
            steps,
        }
    }

    /// As [`random_touches`](Self::random_touches), with the tip that a skin is [rated](dermis_skin::Rated) for and from a tenth of its
    /// largest force on.
    #[must_use]
    pub fn rated_touches(skin: &SkinDescription) -> Self {
        let rated = skin.rated_press();
        let [least, most] = rated.force;
        let shape = TipShape::of_kind(rated.tip, rated.diameter);
        let margin = match skin.surface {
            SurfaceSpec::Rectangle { size: [x, y], .. } if x.min(y) > ROOM * rated.diameter => {
                rated.diameter / 2.0
            }
            _ => 0.0,
        };
        Self {
            tip: (rated.tip == TipKind::FlatPunch).then_some(PlanTip { shape, turn: 0.0, tilt: 0.0 }),
            margin,
            ..Self::random_touches(rated.diameter, [least.max(0.1 * most), most])
        }
    }

    /// What shows a skin: presses at random locations, with the tip and the forces that it is [rated](dermis_skin::Rated) for, after
    /// some seconds in which nothing touches and a node finds its zero.
    #[must_use]
    pub fn rated_presses(skin: &SkinDescription) -> Self {
        let level = Level::Force(skin.rated_press().force);
        let presses = Action::Presses { count: 16, level, repeats: 1 };
        Self {
            name: "rated-presses".to_owned(),
            timing: Timing { load: [0.15, 0.3], hold: [0.4, 0.8], gap: [0.3, 0.6], ..Timing::default() },
            steps: vec![Action::Idle { duration: 3.0 }.into(), presses.into()],
            ..Self::rated_touches(skin)
        }
    }

    /// Reads a plan file.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] says which file and field is wrong and what would be right.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, TestbedError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| TestbedError::ReadPlan { path: path.to_owned(), source })?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Reads a plan; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_toml(text: &str, file: &str) -> Result<Self, TestbedError> {
        let wrong = |field: &str, reason: &str| TestbedError::Plan {
            file: file.to_owned(),
            field: field.to_owned(),
            reason: reason.to_owned(),
        };
        let read: PlanFile = dermis_io::toml::parse(text).map_err(|fault| {
            let (field, reason) = fault.into_field();
            wrong(&field, &reason)
        })?;
        if read.schema != SCHEMA {
            let reason = format!("is \"{}\" where this program reads \"{SCHEMA}\"", read.schema);
            return Err(wrong("schema", &reason));
        }
        let mut steps = Vec::with_capacity(read.steps.len());
        for (i, step) in read.steps.into_iter().enumerate() {
            let step = step.step().map_err(|(key, reason)| wrong(&format!("steps[{i}].{key}"), &reason))?;
            steps.push(step);
        }
        let diameter = match (read.diameter.map(OneOrMore::all), &read.tip) {
            (Some(diameter), None) => diameter,
            (None, Some(tip)) => vec![tip.shape.extent()],
            // As plans are written: with the tip's own extent.
            (Some(diameter), Some(tip)) if diameter == [tip.shape.extent()] => diameter,
            (Some(_), Some(_)) => {
                return Err(wrong("tip", "stands beside `diameter`, which means a sphere: name one of them"));
            }
            (None, None) => {
                return Err(wrong(
                    "(whole file)",
                    "missing field `diameter`, or `tip` for a tip that is no sphere",
                ));
            }
        };
        let plan = Self {
            schema: SCHEMA,
            file: file.to_owned(),
            name: read.name,
            description: read.description,
            seed: read.seed,
            diameter,
            tip: read.tip,
            gravity: read.gravity,
            margin: read.margin,
            region: read.region,
            force_distribution: read.force_distribution,
            force_noise: read.force_noise,
            stage_noise: read.stage_noise,
            timing: read.timing,
            steps,
        };
        plan.check()?;
        Ok(plan)
    }

    /// Says what is wrong with the field of a plan.
    pub(crate) fn wrong(&self, field: impl Into<String>, reason: impl Into<String>) -> TestbedError {
        TestbedError::Plan { file: self.file.clone(), field: field.into(), reason: reason.into() }
    }

    fn check(&self) -> Result<(), TestbedError> {
        let wrong = |field: String, reason: String| Err(self.wrong(field, reason));
        if let Err((field, reason)) = limits::check(self) {
            return wrong(field, reason);
        }
        if self.name.is_empty() || self.name.contains(['/', '\0']) {
            return wrong("name".into(), "names a recording: not empty, without slashes".into());
        }
        if let Some(Err((field, reason))) = self.tip.as_ref().map(PlanTip::check) {
            return wrong(field, reason);
        }
        if let Some(bad) = self.gravity.iter().flatten().find(|g| !(-GRAVITY..=GRAVITY).contains(*g)) {
            return wrong(
                "gravity".into(),
                format!("has {bad} m/s² and must be -{GRAVITY} to {GRAVITY} m/s²"),
            );
        }
        if self.diameter.is_empty() {
            return wrong("diameter".into(), "is empty: a tip has a diameter".into());
        }
        for (field, value) in
            [("margin", self.margin), ("force_noise", self.force_noise), ("stage_noise", self.stage_noise)]
        {
            if !(value.is_finite() && value >= 0.0) {
                let unit = if field == "force_noise" { "N" } else { "m" };
                return wrong(field.into(), format!("is {value} {unit} and must be 0 or positive"));
            }
        }
        if let Some([low, high]) = self.region
            && !low.iter().zip(&high).all(|(low, high)| low < high && (high - low).is_finite())
        {
            return wrong(
                "region".into(),
                "must be two corners of a box: the lower one, then the higher".into(),
            );
        }
        self.check_diameters("diameter", &self.diameter)?;
        let t = &self.timing;
        for (field, range) in [
            ("approach", t.approach),
            ("load", t.load),
            ("hold", t.hold),
            ("unload", t.unload),
            ("gap", t.gap),
        ] {
            self.check_durations(format!("timing.{field}"), range)?;
        }
        if self.steps.is_empty() {
            return wrong("steps".into(), "is empty: a plan does something".into());
        }
        let mut presses = 0;
        for i in 0..self.steps.len() {
            presses += steps::check(self, i)?;
        }
        self.fits(presses)
    }

    fn check_diameters(&self, field: &str, diameters: &[f64]) -> Result<(), TestbedError> {
        match diameters.iter().find(|d| !(d.is_finite() && **d > 0.0)) {
            Some(bad) => Err(self.wrong(field, format!("is {bad} m and must be a positive length"))),
            None => Ok(()),
        }
    }

    fn check_durations(&self, field: String, [low, high]: [f64; 2]) -> Result<(), TestbedError> {
        if low >= 0.0 && low <= high && high <= 3600.0 {
            return Ok(());
        }
        let reason = format!("[{low}, {high}] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
        Err(self.wrong(field, reason))
    }

    /// Refuses more contacts than a recording holds.
    pub(crate) fn fits(&self, contacts: u64) -> Result<(), TestbedError> {
        if contacts <= PRESSES_MAX {
            return Ok(());
        }
        let reason = format!("make {contacts} contacts; {PRESSES_MAX} at most fit a recording");
        Err(self.wrong("steps", reason))
    }
}

#[cfg(test)]
mod tests;
