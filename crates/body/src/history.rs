//! Where the joints were at an instant.
//!
//! Problem: frames of a skin are acquired between joint states, and come late; the newest joint state is of another instant than the
//! contact. Method: the last seconds of each joint are kept, and a position is interpolated linearly between the two samples around
//! the instant; a joint without limits takes the shorter way around.
//!
//! Nothing is extrapolated: behind the newest sample its position stands for [`HistoryLimits::hold`], and then the joint is missing,
//! by name, as it is where two samples lie further apart than [`HistoryLimits::gap`]. Whoever publishes states of some joints only
//! is one of several: each joint has a history of its own.
//!
//! Cost: one entry a joint and state, bounded by [`HistoryLimits::span`] and [`MOST`]; a binary search a joint for each instant.

use std::collections::{HashMap, VecDeque};
use std::f64::consts::{PI, TAU};

use dermis_skin::Stamp;
use serde::{Deserialize, Serialize};

use crate::body::{Body, JointKind};

/// Most samples that are kept of a joint.
const MOST: usize = 4096;

/// How long joint states count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HistoryLimits {
    /// \[s\] for which samples are kept. A stamp that goes back by more is another run, and begins anew.
    pub span: f64,
    /// \[s\] for which the newest position stands.
    pub hold: f64,
    /// \[s\] longest distance of two samples between which is interpolated.
    pub gap: f64,
}

impl Default for HistoryLimits {
    fn default() -> Self {
        Self { span: 2.0, hold: 0.1, gap: 0.5 }
    }
}

/// A joint state that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refused {
    /// A position is missing or too many.
    #[error(
        "a joint state has {names} names and {positions} positions; the publisher must give one position a name"
    )]
    Lengths {
        /// Number of names.
        names: usize,
        /// Number of positions.
        positions: usize,
    },
    /// A position is no number.
    #[error(
        "the joint state of \"{joint}\" is {position}; its publisher must leave out what it does not know"
    )]
    NotFinite {
        /// Name of the joint.
        joint: String,
        /// What was said.
        position: f64,
    },
}

/// Why the position of a joint is not known at an instant.
#[derive(Debug, Clone, PartialEq)]
pub struct MissingJoint {
    /// Name of the joint.
    pub joint: String,
    /// \[s\] how long before the instant its newest position was; `None` where none has come, or none that is old enough.
    pub behind: Option<f64>,
}

/// Positions of a body's [coordinates](Body::coordinates) at an instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointsAt {
    /// \[rad\] or \[m\]; NaN where not known.
    pub positions: Vec<f64>,
    /// Joints whose position is not known.
    pub missing: Vec<MissingJoint>,
}

impl JointsAt {
    /// Which joints are missing, in one sentence; `None` where none is.
    #[must_use]
    pub fn sentence(&self) -> Option<String> {
        let (first, more) = self.missing.split_first()?;
        let names: Vec<&str> = self.missing.iter().take(5).map(|m| m.joint.as_str()).collect();
        let rest = self.missing.len() - names.len();
        let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
        let why = match first.behind {
            None if more.is_empty() => "its state has not come".to_owned(),
            None => "their states have not come".to_owned(),
            Some(behind) => format!("the newest state of {} is {behind:.2} s old", first.joint),
        };
        Some(format!(
            "the position of {}{rest} is not known: {why}; start what publishes joint states, or check its rate and clock",
            names.join(", ")
        ))
    }
}

/// The last seconds of the joints of a body.
#[derive(Debug, Clone)]
pub struct JointHistory {
    limits: HistoryLimits,
    index: HashMap<String, usize>,
    joints: Vec<JointTrack>,
    /// Times that a stamp went back so far that a joint began anew.
    jumps: u64,
}

#[derive(Debug, Clone)]
struct JointTrack {
    name: String,
    wraps: bool,
    samples: VecDeque<(Stamp, f64)>,
}

/// \[s\] from `from` to `to`.
fn seconds(from: Stamp, to: Stamp) -> f64 {
    to.saturating_sub(from) as f64 * 1e-9
}

impl JointHistory {
    /// Of which nothing is known yet.
    #[must_use]
    pub fn new(body: &Body, limits: HistoryLimits) -> Self {
        let joints: Vec<JointTrack> = body
            .coordinates()
            .map(|joint| JointTrack {
                name: joint.name.clone(),
                wraps: joint.kind == JointKind::Continuous,
                samples: VecDeque::new(),
            })
            .collect();
        let index = joints.iter().enumerate().map(|(i, joint)| (joint.name.clone(), i)).collect();
        Self { limits, index, joints, jumps: 0 }
    }

    /// Times that a stamp went back so far that a joint began anew.
    #[must_use]
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    /// Takes the positions of some joints at an instant. Joints that the body does not have, and those that follow others, are passed
    /// over. A sample that is older than the newest of its joint is dropped, unless it is so much older that it begins another run.
    ///
    /// # Errors
    ///
    /// [`Refused`] where nothing of the state is taken.
    pub fn push(&mut self, stamp: Stamp, names: &[String], positions: &[f64]) -> Result<(), Refused> {
        if names.len() != positions.len() {
            return Err(Refused::Lengths { names: names.len(), positions: positions.len() });
        }
        let known = || names.iter().zip(positions).filter_map(|(n, p)| self.index.get(n).map(|i| (*i, *p)));
        if let Some((i, position)) = known().find(|(_, p)| !p.is_finite()) {
            return Err(Refused::NotFinite { joint: self.joints[i].name.clone(), position });
        }
        let taken: Vec<(usize, f64)> = known().collect();
        let mut jumped = false;
        for (i, position) in taken {
            let samples = &mut self.joints[i].samples;
            if let Some((newest, held)) = samples.back_mut() {
                if *newest == stamp {
                    *held = position;
                    continue;
                }
                if seconds(stamp, *newest) > self.limits.span {
                    samples.clear();
                    jumped = true;
                } else if stamp < *newest {
                    continue;
                }
            }
            samples.push_back((stamp, position));
            while samples.len() > MOST
                || samples.front().is_some_and(|(oldest, _)| seconds(*oldest, stamp) > self.limits.span)
            {
                samples.pop_front();
            }
        }
        self.jumps += u64::from(jumped);
        Ok(())
    }

    /// The positions at an instant.
    #[must_use]
    pub fn at(&self, stamp: Stamp) -> JointsAt {
        let mut joints = JointsAt::default();
        for joint in &self.joints {
            let position = joint.at(stamp, self.limits);
            joints.positions.push(position.unwrap_or(f64::NAN));
            if let Err(behind) = position {
                joints.missing.push(MissingJoint { joint: joint.name.clone(), behind });
            }
        }
        joints
    }
}

impl JointTrack {
    /// The position, or how far the newest sample is behind.
    fn at(&self, stamp: Stamp, limits: HistoryLimits) -> Result<f64, Option<f64>> {
        let after = self.samples.partition_point(|(at, _)| *at < stamp);
        if let Some((at, position)) = self.samples.get(after)
            && *at == stamp
        {
            return Ok(*position);
        }
        let Some((t0, q0)) = after.checked_sub(1).and_then(|i| self.samples.get(i)) else { return Err(None) };
        let since = seconds(*t0, stamp);
        let Some((t1, q1)) = self.samples.get(after) else {
            return if since <= limits.hold { Ok(*q0) } else { Err(Some(since)) };
        };
        let whole = seconds(*t0, *t1);
        if whole > limits.gap {
            return Err(Some(since));
        }
        let mut way = q1 - q0;
        if self.wraps {
            way = (way + PI).rem_euclid(TAU) - PI;
        }
        Ok(q0 + way * (since / whole))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: i64 = 1_000_000;

    fn arm() -> Body {
        let urdf = r#"<robot name="arm"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
            <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/></joint>
            <joint name="turn" type="continuous"><parent link="b"/><child link="c"/></joint>
            <joint name="follow" type="revolute"><parent link="c"/><child link="d"/><mimic joint="slide"/></joint></robot>"#;
        Body::from_urdf(urdf, "arm").unwrap()
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    fn both() -> Vec<String> {
        names(&["turn", "slide"])
    }

    #[test]
    fn positions_between_states_are_interpolated() {
        let mut history = JointHistory::new(&arm(), HistoryLimits::default());
        history.push(0, &both(), &[3.0, 0.0]).unwrap();
        history.push(100 * MS, &both(), &[-3.0, 1.0]).unwrap();
        let at = history.at(25 * MS);
        assert!(at.missing.is_empty() && at.sentence().is_none());
        assert!((at.positions[0] - 0.25).abs() < 1e-12);
        // The shorter way from 3 to −3 is over π: 0.283 rad, a quarter of it 0.0708.
        assert!((at.positions[1] - (3.0 + 0.25 * (TAU - 6.0))).abs() < 1e-12);
        assert_eq!(history.at(100 * MS).positions, [1.0, -3.0]);
    }

    #[test]
    fn nothing_is_extrapolated_beyond_the_hold() {
        let mut history = JointHistory::new(&arm(), HistoryLimits::default());
        history.push(0, &both(), &[0.0, 0.2]).unwrap();
        history.push(10 * MS, &both(), &[0.1, 0.3]).unwrap();
        assert_eq!(history.at(110 * MS).positions, [0.3, 0.1], "the newest stands for 0.1 s");
        let late = history.at(111 * MS);
        assert!(late.positions.iter().all(|q| q.is_nan()));
        insta::assert_snapshot!(late.sentence().unwrap(), @"the position of slide, turn is not known: the newest state of slide is 0.10 s old; start what publishes joint states, or check its rate and clock");
        let early = history.at(-1);
        assert_eq!(early.missing[0].behind, None, "before the first sample nothing is known");
    }

    #[test]
    fn joints_that_never_came_are_named() {
        let mut history = JointHistory::new(&arm(), HistoryLimits::default());
        history.push(0, &names(&["slide", "elsewhere"]), &[0.5, 9.0]).unwrap();
        let at = history.at(0);
        assert_eq!(at.positions[0], 0.5);
        insta::assert_snapshot!(at.sentence().unwrap(), @"the position of turn is not known: its state has not come; start what publishes joint states, or check its rate and clock");
    }

    #[test]
    fn a_gap_is_not_bridged_and_a_jump_begins_anew() {
        let mut history = JointHistory::new(&arm(), HistoryLimits::default());
        history.push(0, &both(), &[0.0, 0.0]).unwrap();
        history.push(600 * MS, &both(), &[0.0, 1.0]).unwrap();
        assert_eq!(history.at(300 * MS).missing.len(), 2);
        // A little late is late; far back is another run.
        history.push(590 * MS, &both(), &[0.0, 5.0]).unwrap();
        assert_eq!(history.at(600 * MS).positions[0], 1.0);
        history.push(-3000 * MS, &both(), &[0.0, 7.0]).unwrap();
        assert_eq!((history.jumps(), history.at(-3000 * MS).positions[0]), (1, 7.0));
        assert_eq!(history.at(600 * MS).missing.len(), 2);
    }

    #[test]
    fn states_that_cannot_be_are_refused_whole() {
        let mut history = JointHistory::new(&arm(), HistoryLimits::default());
        insta::assert_snapshot!(history.push(0, &both(), &[1.0]).unwrap_err(), @"a joint state has 2 names and 1 positions; the publisher must give one position a name");
        insta::assert_snapshot!(history.push(0, &both(), &[1.0, f64::NAN]).unwrap_err(), @r#"the joint state of "slide" is NaN; its publisher must leave out what it does not know"#);
        assert_eq!(history.at(0).missing.len(), 2);
    }

    proptest! {
        /// Whatever comes, memory is bounded and what is answered lies between samples.
        #[test]
        fn any_states(states in proptest::collection::vec((-5_000_000_000..5_000_000_000i64, -10.0..10.0f64), 1..60), ask in -5_000_000_000..5_000_000_000i64) {
            let mut history = JointHistory::new(&arm(), HistoryLimits::default());
            for (stamp, q) in &states {
                history.push(*stamp, &names(&["slide"]), &[*q]).unwrap();
            }
            let q = history.at(ask).positions[0];
            prop_assert!(q.is_nan() || (-10.0..=10.0).contains(&q));
        }
    }
}
