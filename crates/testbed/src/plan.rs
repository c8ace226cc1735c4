//! What a testbed does to a skin, as a file says it.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::TestbedError;

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

/// One part of a plan; parts follow one another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Step {
    /// Nothing touches.
    Idle {
        /// \[s\].
        duration: f64,
    },
    /// Single presses at random places.
    Presses {
        /// Number of places.
        count: u32,
        /// \[N\] range of the largest pressing force of each press.
        force: [f64; 2],
        /// Presses at each place, each with a force of its own.
        #[serde(default = "one")]
        repeats: u32,
    },
    /// Single presses on a grid of places, in random order of the places.
    Grid {
        /// \[m\] between places, along the axes of the skin's link.
        pitch: f64,
        /// \[N\] largest pressing force of each press, one press after another at each place.
        forces: Vec<f64>,
        /// How often the forces are gone through at each place.
        #[serde(default = "one")]
        repeats: u32,
    },
    /// Presses that slide along the surface at full force.
    Slides {
        /// Number of slides.
        count: u32,
        /// \[N\] range of the pressing force.
        force: [f64; 2],
        /// \[m\] range of the way.
        length: [f64; 2],
        /// \[m/s\] range of the speed.
        speed: [f64; 2],
    },
    /// Several contacts at once, at random places.
    Multi {
        /// Number of presses.
        count: u32,
        /// Range of the number of contacts in a press, both ends included.
        contacts: [u32; 2],
        /// \[m\] least distance between the contacts of a press.
        distance: f64,
        /// \[N\] range of the largest pressing force of each contact.
        force: [f64; 2],
    },
}

fn one() -> u32 {
    1
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    schema: String,
    /// What recordings of it are called.
    pub name: String,
    /// Free text.
    #[serde(default)]
    pub description: String,
    /// Seed where the caller gives none.
    #[serde(default)]
    pub seed: u64,
    /// \[m\] of the indenter's spherical tip.
    pub diameter: f64,
    /// \[m\] that contacts keep from the rim of the surface.
    #[serde(default)]
    pub margin: f64,
    /// How forces are drawn from their ranges.
    #[serde(default)]
    pub force_distribution: ForceDistribution,
    /// How long the phases of a press last.
    #[serde(default)]
    pub timing: Timing,
    /// What is done, in order.
    pub steps: Vec<Step>,
}

/// Most contacts of a plan: what fits into memory with room to spare.
const PRESSES_MAX: u64 = 1_000_000;

impl Plan {
    /// An endless walk of a hand over the skin: single presses, slides and pairs of contacts with pauses, for
    /// demonstrations. `force` \[N\] is the range of the pressing forces, `diameter` \[m\] the tip's.
    #[must_use]
    pub fn random_touches(diameter: f64, force: [f64; 2]) -> Self {
        let mut steps = Vec::new();
        for _ in 0..20 {
            steps.push(Step::Presses { count: 3, force, repeats: 1 });
            steps.push(Step::Slides { count: 1, force, length: [0.004, 0.012], speed: [0.005, 0.02] });
            steps.push(Step::Idle { duration: 0.5 });
        }
        Self {
            schema: SCHEMA.to_owned(),
            name: "random-touches".to_owned(),
            description: String::new(),
            seed: 0,
            diameter,
            margin: diameter,
            force_distribution: ForceDistribution::Uniform,
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
        let text = std::fs::read_to_string(path)
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
        let plan: Self = serde_path_to_error::deserialize(deserializer).map_err(|e| {
            let field = match e.path().to_string() {
                p if p == "." => "(whole file)".to_owned(),
                p => p,
            };
            wrong(&field, e.inner().message())
        })?;
        plan.check(file)?;
        Ok(plan)
    }

    fn check(&self, file: &str) -> Result<(), TestbedError> {
        let wrong =
            |field: String, reason: String| Err(TestbedError::Plan { file: file.to_owned(), field, reason });
        if self.schema != SCHEMA {
            return wrong(
                "schema".into(),
                format!("is \"{}\" where this program reads \"{SCHEMA}\"", self.schema),
            );
        }
        if self.name.is_empty() || self.name.contains(['/', '\0']) {
            return wrong("name".into(), "names a recording: not empty, without slashes".into());
        }
        if !(self.diameter.is_finite() && self.diameter > 0.0) {
            return wrong("diameter".into(), format!("is {} m and must be a positive length", self.diameter));
        }
        if !(self.margin.is_finite() && self.margin >= 0.0) {
            return wrong(
                "margin".into(),
                format!("is {} m and must be 0 or a positive length", self.margin),
            );
        }
        let t = &self.timing;
        for (field, [low, high]) in [
            ("approach", t.approach),
            ("load", t.load),
            ("hold", t.hold),
            ("unload", t.unload),
            ("gap", t.gap),
        ] {
            if !(low >= 0.0 && low <= high && high <= 3600.0) {
                return wrong(
                    format!("timing.{field}"),
                    format!("[{low}, {high}] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s"),
                );
            }
        }
        if self.steps.is_empty() {
            return wrong("steps".into(), "is empty: a plan does something".into());
        }
        let mut presses = 0u64;
        for (i, step) in self.steps.iter().enumerate() {
            let range = |field: &str, [low, high]: [f64; 2], unit: &str| {
                if low > 0.0 && low <= high && high.is_finite() {
                    Ok(())
                } else {
                    Err(TestbedError::Plan {
                        file: file.to_owned(),
                        field: format!("steps[{i}].{field}"),
                        reason: format!("[{low}, {high}] is not a range: 0 < low ≤ high {unit}"),
                    })
                }
            };
            let at_least_one = |field: &str, number: u32| {
                if number > 0 {
                    Ok(())
                } else {
                    Err(TestbedError::Plan {
                        file: file.to_owned(),
                        field: format!("steps[{i}].{field}"),
                        reason: "is 0 and must be at least 1".into(),
                    })
                }
            };
            match step {
                Step::Idle { duration } => {
                    if !(*duration > 0.0 && *duration <= 86_400.0) {
                        return wrong(
                            format!("steps[{i}].duration"),
                            format!("is {duration} s and must be positive, a day at most"),
                        );
                    }
                }
                Step::Presses { count, force, repeats } => {
                    at_least_one("count", *count)?;
                    at_least_one("repeats", *repeats)?;
                    range("force", *force, "N")?;
                    presses += u64::from(*count) * u64::from(*repeats);
                }
                Step::Grid { pitch, forces, repeats } => {
                    at_least_one("repeats", *repeats)?;
                    range("pitch", [*pitch, *pitch], "m")?;
                    for (j, f) in forces.iter().enumerate() {
                        range(&format!("forces[{j}]"), [*f, *f], "N")?;
                    }
                    if forces.is_empty() {
                        return wrong(
                            format!("steps[{i}].forces"),
                            "is empty: name at least one force".into(),
                        );
                    }
                    presses += forces.len() as u64 * u64::from(*repeats);
                }
                Step::Slides { count, force, length, speed } => {
                    at_least_one("count", *count)?;
                    range("force", *force, "N")?;
                    range("length", *length, "m")?;
                    range("speed", *speed, "m/s")?;
                    presses += u64::from(*count);
                }
                Step::Multi { count, contacts: [low, high], distance, force } => {
                    at_least_one("count", *count)?;
                    range("force", *force, "N")?;
                    range("distance", [*distance, *distance], "m")?;
                    if !(1 <= *low && low <= high && *high <= 100) {
                        return wrong(
                            format!("steps[{i}].contacts"),
                            format!("[{low}, {high}] is not a range: 1 ≤ low ≤ high ≤ 100"),
                        );
                    }
                    presses += u64::from(*count) * u64::from(*high);
                }
            }
        }
        if presses > PRESSES_MAX {
            return wrong(
                "steps".into(),
                format!("make {presses} contacts; {PRESSES_MAX} at most fit a recording"),
            );
        }
        Ok(())
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
        insta::assert_snapshot!(refused("margin = 0.002", "margin = nan"), @"plan plan.toml: field `margin`: is NaN m and must be 0 or a positive length");
        insta::assert_snapshot!(refused("margin = 0.002", "marjin = 0.002"), @"plan plan.toml: field `marjin`: unknown field `marjin`, expected one of `schema`, `name`, `description`, `seed`, `diameter`, `margin`, `force_distribution`, `timing`, `steps`");
        insta::assert_snapshot!(refused("hold = [0.04, 0.06]", "hold = [0.06, 0.04]"), @"plan plan.toml: field `timing.hold`: [0.06, 0.04] is not a range of durations: 0 ≤ low ≤ high ≤ 3600 s");
        insta::assert_snapshot!(refused("duration = 0.2", "duration = 0.0"), @"plan plan.toml: field `steps[0].duration`: is 0 s and must be positive, a day at most");
        insta::assert_snapshot!(refused("force = [0.1, 0.5]", "force = [0.0, 0.5]"), @"plan plan.toml: field `steps[1].force`: [0, 0.5] is not a range: 0 < low ≤ high N");
        insta::assert_snapshot!(refused("forces = [0.2, 0.4]", "forces = []"), @"plan plan.toml: field `steps[2].forces`: is empty: name at least one force");
        insta::assert_snapshot!(refused("contacts = [2, 3]", "contacts = [0, 3]"), @"plan plan.toml: field `steps[4].contacts`: [0, 3] is not a range: 1 ≤ low ≤ high ≤ 100");
        insta::assert_snapshot!(refused("kind = \"slides\"", "kind = \"slide\""), @"plan plan.toml: field `steps[3].kind`: unknown variant `slide`, expected one of `idle`, `presses`, `grid`, `slides`, `multi`");
        insta::assert_snapshot!(refused("count = 4", "count = 4000000000"), @"plan plan.toml: field `steps`: make 8000000016 contacts; 1000000 at most fit a recording");
        insta::assert_snapshot!(refused("repeats = 2", "repeats = 0"), @"plan plan.toml: field `steps[1].repeats`: is 0 and must be at least 1");
        insta::assert_snapshot!(refused("seed = 3", "seed = \"three\""), @r#"plan plan.toml: field `seed`: invalid type: string "three", expected u64"#);
        insta::assert_snapshot!(refused("seed = 3", "seed ="), @"plan plan.toml: field `line 4`: string values must be quoted, expected literal string");
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
