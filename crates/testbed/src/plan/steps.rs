//! What is possible in a step, and how many contacts it makes.

use super::step::{Action, Drawn, Level, Levels, PostureSet, PressProfile, Strokes};
use super::{PRESSES_MAX, Plan};
use crate::TestbedError;

type Checked<T = ()> = Result<T, TestbedError>;

/// Says what is wrong with the step of this index; otherwise how many contacts it makes.
pub(super) fn check(plan: &Plan, index: usize) -> Checked<u64> {
    let step = Checker { plan, index };
    let Some(it) = plan.steps.get(index) else { return Ok(0) };
    let contacts = step.action(&it.action)?;
    step.profile(&it.profile)?;
    Ok(contacts)
}

/// One step of a plan.
struct Checker<'a> {
    plan: &'a Plan,
    index: usize,
}

impl Checker<'_> {
    fn wrong<T>(&self, field: &str, reason: impl Into<String>) -> Checked<T> {
        Err(self.plan.wrong(format!("steps[{}].{field}", self.index), reason))
    }

    fn range(&self, field: &str, [low, high]: [f64; 2], unit: &str) -> Checked {
        if low > 0.0 && low <= high && high.is_finite() {
            return Ok(());
        }
        self.wrong(field, format!("[{low}, {high}] is not a range: 0 < low ≤ high {unit}"))
    }

    fn at_least_one(&self, field: &str, number: u32) -> Checked {
        if number > 0 { Ok(()) } else { self.wrong(field, "is 0 and must be at least 1") }
    }

    fn contacts(&self, [low, high]: [u32; 2], most: u32) -> Checked {
        if 1 <= low && low <= high && high <= most {
            return Ok(());
        }
        self.wrong("contacts", format!("[{low}, {high}] is not a range: 1 ≤ low ≤ high ≤ {most}"))
    }

    fn within(&self, level: &Level<[f64; 2]>) -> Checked {
        match level {
            Level::Force(force) => self.range("force", *force, "N"),
            Level::Depth(depth) => self.range("depth", *depth, "m"),
        }
    }

    /// Field and unit of a list of levels.
    fn list(&self, level: &Level<Vec<f64>>) -> Checked<(&'static str, &'static str)> {
        let (field, unit) = match level {
            Level::Force(_) => ("forces", "N"),
            Level::Depth(_) => ("depths", "m"),
        };
        let values = level.value();
        if values.is_empty() {
            return self.wrong(field, "is empty: name at least one");
        }
        let positive = |(j, value): (usize, &f64)| self.range(&format!("{field}[{j}]"), [*value; 2], unit);
        values.iter().enumerate().try_for_each(positive)?;
        Ok((field, unit))
    }

    /// Presses at one place.
    fn levels(&self, levels: &Levels) -> Checked<u64> {
        self.at_least_one("repeats", levels.repeats)?;
        let (field, unit) = self.list(&levels.values)?;
        let values = levels.values.value();
        for (j, value) in values.iter().enumerate() {
            if levels.incremental && j > 0 && *value <= values[j - 1] {
                let reason = format!("is {value} {unit}, and an incremental press goes up only");
                return self.wrong(&format!("{field}[{j}]"), reason);
            }
        }
        Ok(levels.presses() as u64 * u64::from(levels.repeats))
    }

    fn locations(&self, at: &[[f64; 3]]) -> Checked {
        if at.is_empty() {
            return self.wrong("at", "is empty: name at least one place");
        }
        match at.iter().enumerate().find(|(_, at)| !at.iter().all(|c| c.is_finite())) {
            Some((j, [x, y, z])) => {
                self.wrong(&format!("at[{j}]"), format!("is ({x}, {y}, {z}) m and must be a point"))
            }
            None => Ok(()),
        }
    }

    /// Contacts that an action makes.
    fn action(&self, action: &Action) -> Checked<u64> {
        match action {
            Action::Idle { duration } => self.duration(*duration).map(|()| 0),
            Action::Presses { count, level, repeats } => {
                self.at_least_one("count", *count)?;
                self.at_least_one("repeats", *repeats)?;
                self.within(level)?;
                Ok(u64::from(*count) * u64::from(*repeats))
            }
            Action::Levels { count, levels } => {
                self.at_least_one("count", *count)?;
                Ok(u64::from(*count) * self.levels(levels)?)
            }
            Action::Grid { pitch: [x, y], levels } => {
                self.range("pitch", [*x, *x], "m")?;
                self.range("pitch", [*y, *y], "m")?;
                self.levels(levels)
            }
            Action::Locations { at, levels } => {
                self.locations(at)?;
                Ok(at.len() as u64 * self.levels(levels)?)
            }
            Action::Slides { count, force, length, speed, strokes } => {
                self.at_least_one("count", *count)?;
                self.range("force", *force, "N")?;
                self.range("length", *length, "m")?;
                self.range("speed", *speed, "m/s")?;
                self.strokes(strokes)?;
                // Each stroke takes as much memory as a press does.
                Ok(u64::from(*count) * strokes.all())
            }
            Action::Multi { count, contacts, distance, level } => {
                self.at_least_one("count", *count)?;
                match level.value() {
                    Drawn::Within(range) => self.within(&level.map(|_| *range))?,
                    Drawn::OneOf(list) => self.list(&level.map(|_| list.clone())).map(|_| ())?,
                }
                self.range("distance", [distance[0], distance[1].min(f64::MAX)], "m")?;
                self.contacts(*contacts, 100)?;
                Ok(u64::from(*count) * u64::from(contacts[1]))
            }
            Action::Hex { count, contacts, radius, turn, levels } => {
                self.at_least_one("count", *count)?;
                self.range("radius", *radius, "m")?;
                self.contacts(*contacts, 6)?;
                self.angles("turn", *turn)?;
                Ok(u64::from(*count) * u64::from(contacts[1]) * self.levels(levels)?)
            }
            Action::Postures { yaw, roll, set, duration } => {
                self.angles("yaw", *yaw)?;
                self.angles("roll", *roll)?;
                self.duration(*duration)?;
                match set {
                    PostureSet::Drawn(count) => {
                        self.at_least_one("count", *count)?;
                        Ok(u64::from(*count))
                    }
                    PostureSet::Grid([yaws, rolls]) => {
                        self.at_least_one("counts[0]", *yaws)?;
                        self.at_least_one("counts[1]", *rolls)?;
                        Ok(u64::from(*yaws) * u64::from(*rolls))
                    }
                }
            }
        }
    }

    fn duration(&self, duration: f64) -> Checked {
        if duration > 0.0 && duration <= 86_400.0 {
            return Ok(());
        }
        self.wrong("duration", format!("is {duration} s and must be positive, a day at most"))
    }

    fn angles(&self, field: &str, [low, high]: [f64; 2]) -> Checked {
        if low <= high && (high - low).is_finite() {
            return Ok(());
        }
        self.wrong(field, format!("[{low}, {high}] is not a range of angles: low ≤ high rad"))
    }

    fn strokes(&self, strokes: &Strokes) -> Checked {
        self.at_least_one("strokes", strokes.count)?;
        if strokes.all() > PRESSES_MAX {
            let reason = format!("make {} strokes; {PRESSES_MAX} at most fit a recording", strokes.all());
            return self.wrong(if strokes.cycles == 0 { "strokes" } else { "cycles" }, reason);
        }
        self.plan.check_durations(format!("steps[{}].stop", self.index), strokes.stop)
    }

    fn profile(&self, profile: &PressProfile) -> Checked {
        if self.plan.tip.is_some() && !profile.diameter.is_empty() {
            return self.wrong("diameter", "stands in a plan whose `tip` is no sphere: leave it out");
        }
        let field = |name: &str| format!("steps[{}].{name}", self.index);
        self.plan.check_diameters(&field("diameter"), &profile.diameter)?;
        if let Some([low, high]) = profile.shear
            && !(low >= 0.0 && low <= high && high.is_finite())
        {
            return self.wrong("shear", format!("[{low}, {high}] is not a range: 0 ≤ low ≤ high"));
        }
        if let Some(direction) = profile.shear_direction {
            if !direction.is_finite() {
                let reason = format!("is {direction} rad and must be a finite number");
                return self.wrong("shear_direction", reason);
            }
            if profile.shear.is_none() {
                return self.wrong("shear_direction", "says where to without `shear`, which says how much");
            }
        }
        for (field, force) in [("least_force", profile.least_force), ("most_force", profile.most_force)] {
            if let Some(force) = force.filter(|force| !(*force > 0.0 && force.is_finite())) {
                return self.wrong(field, format!("is {force} N and must be positive"));
            }
        }
        if let (Some(least), Some(most)) = (profile.least_force, profile.most_force)
            && most < least
        {
            return self
                .wrong("most_force", format!("is {most} N, less than the `least_force` of {least} N"));
        }
        let durations = [
            ("load", profile.load),
            ("hold", profile.hold),
            ("unload", profile.unload),
            ("gap", profile.gap),
        ];
        let mut named = durations.into_iter().filter_map(|(name, range)| Some((name, range?)));
        named.try_for_each(|(name, range)| self.plan.check_durations(field(name), range))
    }
}
