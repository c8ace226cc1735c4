//! How large the numbers of a plan may be.
//!
//! Problem: a number that is only "positive" may be 1e300 or 1e-300. A speed of 1e-300 m/s makes a slide that lasts longer than the
//! world, a length of 1e300 m a place that no arithmetic finds.
//!
//! Solution: each quantity has limits that lie far outside of what a testbed does, and a sentence.

use super::Plan;
use super::step::{Action, Drawn, Level};

/// \[s\] that a plan may last: what a testbed does in a month.
pub(crate) const LONGEST: f64 = 30.0 * 86_400.0;

/// \[m\] of tips, ways and distances.
const LENGTH: [f64; 2] = [1e-6, 100.0];
/// \[m\] that a tip is pressed in.
const DEPTH: [f64; 2] = [1e-9, 10.0];
/// \[N\].
const FORCE: [f64; 2] = [1e-9, 1e6];
/// \[m/s\].
const SPEED: [f64; 2] = [1e-6, 1e3];

/// Field, and what is wrong with it. What is not even positive is for the plan itself to say.
pub(super) fn check(plan: &Plan) -> Result<(), (String, String)> {
    let limits = |field: String, values: &[f64], [low, high]: [f64; 2], unit: &str| {
        let bad = values.iter().find(|v| **v > 0.0 && v.is_finite() && !(low..=high).contains(*v));
        bad.map_or(Ok(()), |value| {
            Err((field, format!("is {value:e} {unit} and must be {low} to {high} {unit}")))
        })
    };
    limits("diameter".into(), &plan.diameter, LENGTH, "m")?;
    limits("margin".into(), &[plan.margin], [0.0, LENGTH[1]], "m")?;
    limits("force_noise".into(), &[plan.force_noise], [0.0, FORCE[1]], "N")?;
    limits("stage_noise".into(), &[plan.stage_noise], [0.0, LENGTH[1]], "m")?;
    let corners: Vec<f64> = plan.region.iter().flatten().flatten().map(|v| v.abs()).collect();
    limits("region".into(), &corners, [0.0, 1e6], "m")?;
    for (i, step) in plan.steps.iter().enumerate() {
        let at = |field: &str| format!("steps[{i}].{field}");
        let drawn = |level: &Level<[f64; 2]>| match level {
            Level::Force(force) => limits(at("force"), force, FORCE, "N"),
            Level::Depth(depth) => limits(at("depth"), depth, DEPTH, "m"),
        };
        let listed = |level: &Level<Vec<f64>>| match level {
            Level::Force(forces) => limits(at("forces"), forces, FORCE, "N"),
            Level::Depth(depths) => limits(at("depths"), depths, DEPTH, "m"),
        };
        match &step.action {
            Action::Idle { .. } => {}
            Action::Presses { level, .. } => drawn(level)?,
            Action::Levels { levels, .. } => listed(&levels.values)?,
            Action::Grid { pitch, levels } => {
                limits(at("pitch"), pitch, LENGTH, "m")?;
                listed(&levels.values)?;
            }
            Action::Locations { at: locations, levels } => {
                for (j, place) in locations.iter().enumerate() {
                    limits(at(&format!("at[{j}]")), &place.map(f64::abs), [0.0, LENGTH[1]], "m")?;
                }
                listed(&levels.values)?;
            }
            Action::Slides { force, length, speed, .. } => {
                limits(at("force"), force, FORCE, "N")?;
                limits(at("length"), length, LENGTH, "m")?;
                limits(at("speed"), speed, SPEED, "m/s")?;
            }
            Action::Multi { distance, level, .. } => {
                limits(at("distance"), distance, LENGTH, "m")?;
                match level {
                    Level::Force(Drawn::Within(range)) => drawn(&Level::Force(*range))?,
                    Level::Depth(Drawn::Within(range)) => drawn(&Level::Depth(*range))?,
                    Level::Force(Drawn::OneOf(list)) => limits(at("forces"), list, FORCE, "N")?,
                    Level::Depth(Drawn::OneOf(list)) => limits(at("depths"), list, DEPTH, "m")?,
                }
            }
            Action::Hex { radius, turn, levels, .. } => {
                limits(at("radius"), radius, LENGTH, "m")?;
                limits(at("turn"), &turn.map(f64::abs), [0.0, 1e3], "rad")?;
                listed(&levels.values)?;
            }
            Action::Postures { yaw, roll, .. } => {
                limits(at("yaw"), &yaw.map(f64::abs), [0.0, 1e3], "rad")?;
                limits(at("roll"), &roll.map(f64::abs), [0.0, 1e3], "rad")?;
            }
        }
        limits(at("diameter"), &step.profile.diameter, LENGTH, "m")?;
        limits(at("shear"), step.profile.shear.as_ref().map_or(&[], |s| s), [0.0, 1e3], "N/N")?;
        limits(at("least_force"), step.profile.least_force.as_slice(), FORCE, "N")?;
        limits(at("most_force"), step.profile.most_force.as_slice(), FORCE, "N")?;
        let turn = step.profile.shear_direction.map_or(0.0, f64::abs);
        limits(at("shear_direction"), &[turn], [0.0, 1e3], "rad")?;
    }
    Ok(())
}
