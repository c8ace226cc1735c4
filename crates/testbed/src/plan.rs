//! What a testbed does to a skin, as a file says it.

mod limits;
mod step;
mod tip;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::TestbedError;
pub(crate) use limits::LONGEST;
pub use step::{Action, Drawn, HEX_ARMS, Level, Levels, PressProfile, Step};
use step::{OneOrMore, StepFile};
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
    /// \[m\] two corners of a box in the link frame that places are drawn from; all of the surface where absent.
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
            steps.push(Action::Slides { count: 1, force, length, speed }.into());
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
            reason: reason.trim().replace('\n', " "),
        };
        let deserializer = toml::Deserializer::parse(text).map_err(|e| {
            let start = e.span().map_or(0, |span| span.start);
            let line = 1 + text.get(..start).unwrap_or(text).matches('\n').count();
            wrong(&format!("line {line}"), e.message())
        })?;
        let read: PlanFile = serde_path_to_error::deserialize(deserializer).map_err(|e| {
            let field = match e.path().to_string() {
                p if p == "." => "(whole file)".to_owned(),
                p => p,
            };
            wrong(&field, e.inner().message())
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
        let diameter = match (read.diameter, &read.tip) {
            (Some(diameter), None) => diameter.all(),
            (None, Some(tip)) => vec![tip.shape.extent()],
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
        let tips =
            |field: &str, diameters: &[f64]| match diameters.iter().find(|d| !(d.is_finite() && **d > 0.0)) {
                Some(bad) => Err(self.wrong(field, format!("is {bad} m and must be a positive length"))),
                None => Ok(()),
            };
        tips("diameter", &self.diameter)?;
        let durations = |field: String, [low, high]: [f64; 2]| {
            if low >= 0.0 && low <= high && high <= 3600.0 {
                return Ok(());
            }
            let reason = format!("[{low}, {high}] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
            Err(self.wrong(field, reason))
        };
        let t = &self.timing;
        for (field, range) in [
            ("approach", t.approach),
            ("load", t.load),
            ("hold", t.hold),
            ("unload", t.unload),
            ("gap", t.gap),
        ] {
            durations(format!("timing.{field}"), range)?;
        }
        if self.steps.is_empty() {
            return wrong("steps".into(), "is empty: a plan does something".into());
        }
        let mut presses = 0u64;
        for (i, step) in self.steps.iter().enumerate() {
            let range = |field: &str, [low, high]: [f64; 2], unit: &str| {
                if low > 0.0 && low <= high && high.is_finite() {
                    return Ok(());
                }
                let reason = format!("[{low}, {high}] is not a range: 0 < low ≤ high {unit}");
                Err(self.wrong(format!("steps[{i}].{field}"), reason))
            };
            let at_least_one = |field: &str, number: u32| {
                if number > 0 {
                    return Ok(());
                }
                Err(self.wrong(format!("steps[{i}].{field}"), "is 0 and must be at least 1"))
            };
            let drawn = |level: &Level<[f64; 2]>| match level {
                Level::Force(force) => range("force", *force, "N"),
                Level::Depth(depth) => range("depth", *depth, "m"),
            };
            let some = |level: &Level<Vec<f64>>| {
                let (field, unit) = match level {
                    Level::Force(_) => ("forces", "N"),
                    Level::Depth(_) => ("depths", "m"),
                };
                let values = level.value();
                if values.is_empty() {
                    return Err(self.wrong(format!("steps[{i}].{field}"), "is empty: name at least one"));
                }
                let positive = |(j, value): (usize, &f64)| range(&format!("{field}[{j}]"), [*value; 2], unit);
                values.iter().enumerate().try_for_each(positive)?;
                Ok((field, unit))
            };
            let listed = |levels: &Levels| {
                at_least_one("repeats", levels.repeats)?;
                let (field, unit) = some(&levels.values)?;
                let values = levels.values.value();
                for (j, value) in values.iter().enumerate() {
                    if levels.incremental && j > 0 && *value <= values[j - 1] {
                        let reason = format!("is {value} {unit}, and an incremental press goes up only");
                        return Err(self.wrong(format!("steps[{i}].{field}[{j}]"), reason));
                    }
                }
                Ok(levels.presses() as u64 * u64::from(levels.repeats))
            };
            match &step.action {
                Action::Idle { duration } => {
                    if !(*duration > 0.0 && *duration <= 86_400.0) {
                        return wrong(
                            format!("steps[{i}].duration"),
                            format!("is {duration} s and must be positive, a day at most"),
                        );
                    }
                }
                Action::Presses { count, level, repeats } => {
                    at_least_one("count", *count)?;
                    at_least_one("repeats", *repeats)?;
                    drawn(level)?;
                    presses += u64::from(*count) * u64::from(*repeats);
                }
                Action::Grid { pitch: [x, y], levels } => {
                    range("pitch", [*x, *x], "m")?;
                    range("pitch", [*y, *y], "m")?;
                    presses += listed(levels)?;
                }
                Action::Places { at, levels } => {
                    if at.is_empty() {
                        return wrong(format!("steps[{i}].at"), "is empty: name at least one place".into());
                    }
                    if let Some((j, [x, y, z])) =
                        at.iter().enumerate().find(|(_, at)| !at.iter().all(|c| c.is_finite()))
                    {
                        let reason = format!("is ({x}, {y}, {z}) m and must be a point");
                        return wrong(format!("steps[{i}].at[{j}]"), reason);
                    }
                    presses += at.len() as u64 * listed(levels)?;
                }
                Action::Slides { count, force, length, speed } => {
                    at_least_one("count", *count)?;
                    range("force", *force, "N")?;
                    range("length", *length, "m")?;
                    range("speed", *speed, "m/s")?;
                    presses += u64::from(*count);
                }
                Action::Multi { count, contacts: [low, high], distance, level } => {
                    at_least_one("count", *count)?;
                    match level.value() {
                        Drawn::Within(range) => drawn(&level.map(|_| *range))?,
                        Drawn::OneOf(list) => some(&level.map(|_| list.clone())).map(|_| ())?,
                    }
                    range("distance", [distance[0], distance[1].min(f64::MAX)], "m")?;
                    if !(1 <= *low && low <= high && *high <= 100) {
                        return wrong(
                            format!("steps[{i}].contacts"),
                            format!("[{low}, {high}] is not a range: 1 ≤ low ≤ high ≤ 100"),
                        );
                    }
                    presses += u64::from(*count) * u64::from(*high);
                }
                Action::Hex { count, contacts: [low, high], radius, turn: [from, to], levels } => {
                    at_least_one("count", *count)?;
                    range("radius", *radius, "m")?;
                    if !(1 <= *low && low <= high && *high <= 6) {
                        return wrong(
                            format!("steps[{i}].contacts"),
                            format!("[{low}, {high}] is not a range: 1 ≤ low ≤ high ≤ 6"),
                        );
                    }
                    if !(from <= to && (to - from).is_finite()) {
                        return wrong(
                            format!("steps[{i}].turn"),
                            format!("[{from}, {to}] is not a range of angles: low ≤ high rad"),
                        );
                    }
                    presses += u64::from(*count) * u64::from(*high) * listed(levels)?;
                }
            }
            let profile = &step.profile;
            if self.tip.is_some() && !profile.diameter.is_empty() {
                let reason = "stands in a plan whose `tip` is no sphere: leave it out";
                return wrong(format!("steps[{i}].diameter"), reason.into());
            }
            tips(&format!("steps[{i}].diameter"), &profile.diameter)?;
            if let Some([low, high]) = profile.shear
                && !(low >= 0.0 && low <= high && high.is_finite())
            {
                let reason = format!("[{low}, {high}] is not a range: 0 ≤ low ≤ high");
                return wrong(format!("steps[{i}].shear"), reason);
            }
            if let Some(direction) = profile.shear_direction {
                if !direction.is_finite() {
                    let reason = format!("is {direction} rad and must be a finite number");
                    return wrong(format!("steps[{i}].shear_direction"), reason);
                }
                if profile.shear.is_none() {
                    let reason = "says where to without `shear`, which says how much".to_owned();
                    return wrong(format!("steps[{i}].shear_direction"), reason);
                }
            }
            if let Some(force) = profile.least_force
                && !(force > 0.0 && force.is_finite())
            {
                let reason = format!("is {force} N and must be positive");
                return wrong(format!("steps[{i}].least_force"), reason);
            }
            if let Some(hold) = profile.hold {
                durations(format!("steps[{i}].hold"), hold)?;
            }
        }
        self.fits(presses)
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
mod tests {
    use super::*;
    use crate::testing::PLAN;

    fn refused(from: &str, to: &str) -> String {
        assert!(PLAN.contains(from), "{from} is not in the plan");
        Plan::from_toml(&PLAN.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
    }

    #[test]
    fn refusals_name_file_field_and_remedy() {
        insta::assert_snapshot!(refused("plan/1", "plan/7"), @r#"plan plan.toml: field `schema`: is "dermis-plan/7" where this program reads "dermis-plan/1""#);
        insta::assert_snapshot!(refused("diameter = 0.004", "diameter = -0.004"), @"plan plan.toml: field `diameter`: is -0.004 m and must be a positive length");
        insta::assert_snapshot!(refused("margin = 0.002", "margin = nan"), @"plan plan.toml: field `margin`: is NaN m and must be 0 or positive");
        insta::assert_snapshot!(refused("margin = 0.002", "marjin = 0.002"), @"plan plan.toml: field `marjin`: unknown field `marjin`, expected one of `schema`, `name`, `description`, `seed`, `diameter`, `tip`, `gravity`, `margin`, `region`, `force_distribution`, `force_noise`, `stage_noise`, `timing`, `steps`");
        insta::assert_snapshot!(refused("hold = [0.04, 0.06]", "hold = [0.06, 0.04]"), @"plan plan.toml: field `timing.hold`: [0.06, 0.04] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
        insta::assert_snapshot!(refused("duration = 0.2", "duration = 0.0"), @"plan plan.toml: field `steps[0].duration`: is 0 s and must be positive, a day at most");
        insta::assert_snapshot!(refused("force = [0.1, 0.5]", "force = [0.0, 0.5]"), @"plan plan.toml: field `steps[1].force`: [0, 0.5] is not a range: 0 < low ≤ high N");
        insta::assert_snapshot!(refused("forces = [0.2, 0.4]", "forces = []"), @"plan plan.toml: field `steps[2].forces`: is empty: name at least one");
        insta::assert_snapshot!(refused("contacts = [2, 3]", "contacts = [0, 3]"), @"plan plan.toml: field `steps[4].contacts`: [0, 3] is not a range: 1 ≤ low ≤ high ≤ 100");
        insta::assert_snapshot!(refused("kind = \"slides\"", "kind = \"slide\""), @"plan plan.toml: field `steps[3].kind`: unknown variant `slide`, expected one of `idle`, `presses`, `grid`, `places`, `slides`, `multi`, `hex`");
        insta::assert_snapshot!(refused("count = 4", "count = 4000000000"), @"plan plan.toml: field `steps`: make 8000000016 contacts; 1000000 at most fit a recording");
        insta::assert_snapshot!(refused("repeats = 2", "repeats = 0"), @"plan plan.toml: field `steps[1].repeats`: is 0 and must be at least 1");
        insta::assert_snapshot!(refused("seed = 3", "seed = \"three\""), @r#"plan plan.toml: field `seed`: invalid type: string "three", expected u64"#);
        insta::assert_snapshot!(refused("seed = 3", "seed ="), @"plan plan.toml: field `line 4`: string values must be quoted, expected literal string");
    }

    const MORE: &str = r#"
        schema = "dermis-plan/1"
        name = "more"
        diameter = [0.002, 0.004]
        force_noise = 0.0
        stage_noise = 1e-5
        [[steps]]
        kind = "grid"
        pitch = [0.004, 0.002]
        depths = [0.001, 0.002]
        incremental = true
        shear = 0.5
        shear_direction = 1.5
        hold = [0.1, 0.2]
        [[steps]]
        kind = "places"
        at = [[0.0, 0.0, 0.0], [0.001, 0.0, 0.0]]
        forces = [0.1]
        diameter = 0.008
        [[steps]]
        kind = "presses"
        count = 3
        depth = [0.001, 0.002]
        shear = [0.0, 0.7]
    "#;

    const TOGETHER: &str = r#"
        schema = "dermis-plan/1"
        name = "together"
        tip = { shape = { shape = "flat-punch", diameter = 0.020 } }
        [[steps]]
        kind = "hex"
        count = 3
        contacts = [1, 6]
        radius = [0.03, 0.2]
        turn = 0.5
        depths = [0.001, 0.002]
        incremental = true
        least_force = 5.0
        [[steps]]
        kind = "multi"
        count = 3
        contacts = [2, 4]
        distance = 0.04
        forces = [4.905, 7.358, 9.810]
    "#;

    #[test]
    fn several_tips_refuse_what_cannot_be() {
        let refused = |from: &str, to: &str| {
            assert!(TOGETHER.contains(from), "{from} is not in the plan");
            Plan::from_toml(&TOGETHER.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused("[1, 6]", "[1, 7]"), @"plan plan.toml: field `steps[0].contacts`: [1, 7] is not a range: 1 ≤ low ≤ high ≤ 6");
        insta::assert_snapshot!(refused("[0.03, 0.2]", "[0.2, 0.03]"), @"plan plan.toml: field `steps[0].radius`: [0.2, 0.03] is not a range: 0 < low ≤ high m");
        insta::assert_snapshot!(refused("radius = [0.03, 0.2]", ""), @"plan plan.toml: field `steps[0].radius`: is missing: a step of kind `hex` needs it");
        insta::assert_snapshot!(refused("turn = 0.5", "turn = [0.5, 0.0]"), @"plan plan.toml: field `steps[0].turn`: [0.5, 0] is not a range of angles: low ≤ high rad");
        insta::assert_snapshot!(refused("least_force = 5.0", "least_force = 0.0"), @"plan plan.toml: field `steps[0].least_force`: is 0 N and must be positive");
        insta::assert_snapshot!(refused("[0.001, 0.002]", "[0.002, 0.001]"), @"plan plan.toml: field `steps[0].depths[1]`: is 0.001 m, and an incremental press goes up only");
        insta::assert_snapshot!(refused("[4.905, 7.358, 9.810]", "[]"), @"plan plan.toml: field `steps[1].forces`: is empty: name at least one");
        insta::assert_snapshot!(refused("[4.905, 7.358, 9.810]", "[4.905, -1.0]"), @"plan plan.toml: field `steps[1].forces[1]`: [-1, -1] is not a range: 0 < low ≤ high N");
        insta::assert_snapshot!(refused("distance = 0.04", "distance = 0.04\n        force = [1.0, 2.0]"), @"plan plan.toml: field `steps[1].forces`: names one of some: leave out the range `force` or `depth` beside it");
    }

    #[test]
    fn what_is_written_reads_back() {
        for text in [PLAN, MORE, TOGETHER] {
            let plan = Plan::from_toml(text, "plan.toml").unwrap();
            let again = toml::to_string(&plan).unwrap();
            assert_eq!(Plan::from_toml(&again, "plan.toml").unwrap_or_else(|e| panic!("{e}\n{again}")), plan);
        }
    }

    #[test]
    fn steps_refuse_what_does_not_belong_to_them() {
        let refused = |from: &str, to: &str| {
            assert!(MORE.contains(from), "{from} is not in the plan");
            Plan::from_toml(&MORE.replacen(from, to, 1), "plan.toml").unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused("count = 3", "count = 3\npitch = 0.1"), @"plan plan.toml: field `steps[2].pitch`: is no key of a step of kind `presses`, which has count, force, depth, repeats, diameter, shear, shear_direction, hold, least_force");
        insta::assert_snapshot!(refused("count = 3", "count = 3\ncolour = 1"), @"plan plan.toml: field `steps[2].colour`: unknown field `colour`, expected one of `kind`, `duration`, `count`, `pitch`, `at`, `contacts`, `distance`, `force`, `depth`, `forces`, `depths`, `incremental`, `repeats`, `length`, `speed`, `diameter`, `shear`, `shear_direction`, `hold`, `least_force`, `radius`, `turn`");
        insta::assert_snapshot!(refused("count = 3", ""), @"plan plan.toml: field `steps[2].count`: is missing: a step of kind `presses` needs it");
        insta::assert_snapshot!(refused("count = 3", "count = 3\nforce = [0.1, 0.2]"), @"plan plan.toml: field `steps[2].depth`: stands beside `force`: name one of them");
        insta::assert_snapshot!(refused("forces = [0.1]", ""), @"plan plan.toml: field `steps[1].forces`: is missing: a step of kind `places` needs it, or `depths`");
        insta::assert_snapshot!(refused("forces = [0.1]", "forces = [0.1]\ndepths = [0.1]"), @"plan plan.toml: field `steps[1].depths`: stands beside `forces`: name one of them");
        insta::assert_snapshot!(refused("[0.001, 0.002]\n        incremental", "[0.002, 0.002]\n        incremental"), @"plan plan.toml: field `steps[0].depths[1]`: is 0.002 m, and an incremental press goes up only");
        insta::assert_snapshot!(refused("shear = 0.5\n", ""), @"plan plan.toml: field `steps[0].shear_direction`: says where to without `shear`, which says how much");
        insta::assert_snapshot!(refused("shear = [0.0, 0.7]", "shear = [0.7, 0.0]"), @"plan plan.toml: field `steps[2].shear`: [0.7, 0] is not a range: 0 ≤ low ≤ high");
        insta::assert_snapshot!(refused("shear = [0.0, 0.7]", "shear = \"much\""), @"plan plan.toml: field `steps[2].shear`: a number, or two of them in brackets");
        insta::assert_snapshot!(refused("[0.002, 0.004]", "[]"), @"plan plan.toml: field `diameter`: is empty: a tip has a diameter");
        insta::assert_snapshot!(refused("diameter = 0.008", "diameter = -0.008"), @"plan plan.toml: field `steps[1].diameter`: is -0.008 m and must be a positive length");
        insta::assert_snapshot!(refused("hold = [0.1, 0.2]", "hold = [0.1, -0.2]"), @"plan plan.toml: field `steps[0].hold`: [0.1, -0.2] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
        insta::assert_snapshot!(refused("force_noise = 0.0", "force_noise = -1.0"), @"plan plan.toml: field `force_noise`: is -1 N and must be 0 or positive");
        insta::assert_snapshot!(refused("[[0.0, 0.0, 0.0], [0.001, 0.0, 0.0]]", "[]"), @"plan plan.toml: field `steps[1].at`: is empty: name at least one place");
        insta::assert_snapshot!(refused("[0.001, 0.0, 0.0]", "[0.001, 0.0, nan]"), @"plan plan.toml: field `steps[1].at[1]`: is (0.001, 0, NaN) m and must be a point");
        insta::assert_snapshot!(refused("diameter = 0.008", "diameter = []"), @"plan plan.toml: field `steps[1].diameter`: is empty: a tip has a diameter");
        insta::assert_snapshot!(refused("[0.004, 0.002]", "[0.004, nan]"), @"plan plan.toml: field `steps[0].pitch`: [NaN, NaN] is not a range: 0 < low ≤ high m");
    }

    #[test]
    fn plans_that_ship_are_valid() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/plans");
        let mut found = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let plan = Plan::load(&path).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(plan.name, path.file_stem().unwrap().to_str().unwrap());
            found += 1;
        }
        assert!(found >= 2);
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = Plan::load("/nowhere/plan.toml").unwrap_err().to_string();
        assert!(error.starts_with("plan file /nowhere/plan.toml: cannot be read"), "{error}");
    }

    proptest::proptest! {
        #[test]
        fn no_text_panics(text in ".{0,200}") {
            let _ = Plan::from_toml(&text, "x");
        }
    }
}
