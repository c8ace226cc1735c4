//! A plan carried out on a surface: what touches it at every instant.
//!
//! [`Timeline::new`] draws what the plan leaves open and lays its presses one after the other (`schedule`, with the random
//! choices of `draw` and the candidate locations of `candidates`). [`Timeline::at`] interpolates within a press: force and
//! approach follow a raised cosine between the ends of its phases, so that no speed jumps.
//! Assumptions: tips of one press act independently of each other; a slide runs at constant speed on a straight line that is
//! projected to the surface, and between postures the skin is turned in no time.
//! Cost: a press is a few numbers; one instant takes a binary search and, for a depth, the model's force at it.

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Stimulus, Tip as ModelTip, TipShape};
use dermis_msgs::geometry_msgs::msg::{Quaternion, Vector3 as VectorMsg};
use dermis_msgs::msg::{self, IndentationContact};
use dermis_skin::convert::{point, vector};
use dermis_skin::{Phase, SkinDescription, Stamp, Surface};
use nalgebra::{Point3, Vector3};

use crate::plan::{Level, PlanTip};

mod candidates;
mod draw;
mod motion;
mod schedule;
#[cfg(test)]
mod tests;

/// The testbed at one instant: the ground truth.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GroundTruth {
    /// What it is doing.
    pub phase: Phase,
    /// Counts presses from 1; 0 before the first.
    pub press: u64,
    /// Identity of the place, from 1; 0 where no place is meant.
    pub location: u32,
    /// 0 for the first press at this place.
    pub repeat: u32,
    /// What touches the skin.
    pub stimulus: Stimulus,
    /// \[m\] of each contact's tip below first contact; `None` where the model does not know.
    pub depths: Vec<Option<f64>>,
    /// Where the (first) indenter is; `None` where it has no place to go.
    pub tip: Option<Tip>,
}

/// The tip of an indenter over a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    /// Point of the surface below it, in the frame of the skin's link.
    pub place: Point3<f64>,
    /// \[m\] between tip and surface; 0 while it touches.
    pub gap: f64,
}

/// \[m\] that an indenter keeps from the skin between two presses.
const RETREAT: f64 = 0.01;

impl GroundTruth {
    /// As the ground truth message of a labelled bag.
    #[must_use]
    pub fn message(
        &self,
        skin: &SkinDescription,
        surface: &Surface,
        session: &str,
        stamp: Stamp,
    ) -> msg::Indentation {
        let depths = self.depths.iter().copied().chain(std::iter::repeat(None));
        let contacts = self.stimulus.contacts.iter().zip(depths).map(|(c, depth)| {
            let (_, normal) = surface.project(&c.position);
            let sphere = IndentationContact::sphere(
                point(&c.position),
                vector(&normal),
                vector(&c.force),
                msg::Contact::FORCE_FULL,
                depth.unwrap_or(f64::NAN),
                c.diameter(),
            );
            with_tip(sphere, &c.tip)
        });
        msg::Indentation {
            header: skin.header(stamp),
            skin: skin.name.clone(),
            session: session.to_owned(),
            press: self.press,
            location: self.location,
            repeat: self.repeat,
            phase: self.phase.code(),
            temperature: self.stimulus.temperature as f32,
            // A plan that says nothing of gravity does not know of it.
            gravity: match self.stimulus.gravity {
                none if none == Vector3::zeros() => VectorMsg::UNKNOWN,
                gravity => vector(&gravity),
            },
            contacts: contacts.collect(),
        }
    }
}

/// The same contact with another tip than a sphere.
fn with_tip(mut contact: IndentationContact, tip: &ModelTip) -> IndentationContact {
    (contact.tip, contact.tip_parameters) = match tip.shape {
        TipShape::Sphere { .. } => return contact,
        TipShape::FlatPunch { .. } => (IndentationContact::TIP_FLAT, Vec::new()),
        TipShape::Cylinder { diameter, length } => {
            contact.diameter = diameter;
            (IndentationContact::TIP_CYLINDER, vec![length])
        }
        TipShape::Box { size: [x, y] } => (IndentationContact::TIP_BOX, vec![x, y]),
        TipShape::Wedge { .. } | TipShape::Polygon { .. } => (IndentationContact::TIP_MESH, Vec::new()),
    };
    contact.tip_name = tip.shape.name().to_owned();
    let q = tip.orientation.quaternion();
    contact.tip_pose.orientation = Quaternion { x: q.i, y: q.j, z: q.k, w: q.w };
    contact
}

/// One contact of a press, on the surface.
#[derive(Debug, Clone, PartialEq)]
struct Touch {
    from: Point3<f64>,
    to: Point3<f64>,
    level: Level<f64>,
    diameter: f64,
    /// Where the tip is moved sideways to: along the surface at `from`, as long as the ratio of tangential to normal force.
    shear: Vector3<f64>,
}

/// State at the end of a part of a press, in shares of its full level.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key {
    /// \[s\] from the start of the press.
    end: f64,
    phase: Phase,
    level: f64,
    shear: f64,
    /// Share of the slide.
    slide: f64,
}

/// A press, or a stretch of nothing where it has no touches.
#[derive(Debug, Clone, PartialEq)]
struct Press {
    number: u64,
    location: u32,
    repeat: u32,
    touches: Vec<Touch>,
    start: f64,
    keys: Vec<Key>,
    /// \[m/s²\] in the frame of the link, where it is not that of the plan.
    gravity: Option<Vector3<f64>>,
}

/// A plan carried out on a skin with one seed. Time runs from 0 to [`duration`](Self::duration).
#[derive(Clone)]
pub struct Timeline {
    presses: Vec<Press>,
    duration: f64,
    count: u64,
    model: Arc<dyn ForwardModel>,
    tip: Option<PlanTip>,
    gravity: Vector3<f64>,
}

impl std::fmt::Debug for Timeline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Timeline")
            .field("presses", &self.count)
            .field("duration", &self.duration)
            .finish_non_exhaustive()
    }
}

impl Timeline {
    /// \[s\].
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Number of presses.
    #[must_use]
    pub fn presses(&self) -> u64 {
        self.count
    }

    /// The first moment of full force; idle where nothing is ever touched.
    pub(crate) fn first_touch(&self) -> GroundTruth {
        let first = self.presses.iter().find_map(|p| p.keys.get(1).map(|key| p.start + key.end));
        first.map(|t| self.at(t)).unwrap_or_default()
    }

    /// Nothing touches.
    fn idle_moment(&self) -> GroundTruth {
        let stimulus = Stimulus { gravity: self.gravity, ..Stimulus::default() };
        GroundTruth { stimulus, ..GroundTruth::default() }
    }

    /// What the testbed does at `t` \[s\]; idle before the start and after the end.
    #[must_use]
    pub fn at(&self, t: f64) -> GroundTruth {
        let index = self.presses.partition_point(|p| p.start <= t).saturating_sub(1);
        let Some(press) = self.presses.get(index).filter(|p| p.start <= t) else {
            return self.idle_moment();
        };
        let since = t - press.start;
        let mut moment = GroundTruth {
            press: press.number,
            location: press.location,
            repeat: press.repeat,
            ..self.idle_moment()
        };
        moment.stimulus.gravity = press.gravity.unwrap_or(self.gravity);
        // A smooth start and end: a stage does not change its speed in no time.
        let smooth = |x: f64| 0.5 - 0.5 * (std::f64::consts::PI * x.clamp(0.0, 1.0)).cos();
        let next = press.keys.partition_point(|key| key.end <= since);
        let begin = next
            .checked_sub(1)
            .map_or(Key { end: 0.0, phase: Phase::Idle, level: 0.0, shear: 0.0, slide: 0.0 }, |before| {
                press.keys[before]
            });
        let mut approached = 0.0;
        let now = match press.keys.get(next) {
            None => Key { phase: Phase::Idle, ..begin },
            Some(key) => {
                let part = (since - begin.end) / (key.end - begin.end);
                approached = smooth(part);
                let along = |from: f64, to: f64| from + (to - from) * approached;
                Key {
                    level: along(begin.level, key.level),
                    shear: along(begin.shear, key.shear),
                    slide: begin.slide + (key.slide - begin.slide) * part,
                    ..*key
                }
            }
        };
        moment.phase = now.phase;
        let surface = self.model.surface();
        if now.level > 0.0 {
            for touch in &press.touches {
                let straight = touch.from + (touch.to - touch.from) * now.slide;
                let (position, normal) = surface.project(&straight);
                let (pressing, depth) = self.press_of(touch, &position, now.level);
                let mut force = -normal * pressing;
                if now.shear > 0.0 && touch.shear != Vector3::zeros() {
                    force += touch.shear * self.press_of(touch, &position, now.shear).0;
                }
                let tip = self.tip.map_or_else(|| ModelTip::sphere(touch.diameter), |tip| tip.on(&normal));
                moment.stimulus.contacts.push(Indentation { position, force, tip });
                moment.depths.push(depth);
            }
        }
        let gap = match now.phase {
            Phase::Idle => RETREAT,
            Phase::Approach => RETREAT * (1.0 - approached),
            _ => 0.0,
        };
        // Between presses it waits above the place that it has left, before the first above that to come.
        let at = self.presses[index..].iter().chain(&self.presses[..index]).find_map(|p| p.touches.first());
        moment.tip = at.map(|touch| {
            let (place, _) = surface.project(&(touch.from + (touch.to - touch.from) * now.slide));
            Tip { place, gap }
        });
        moment
    }

    /// Pressing force \[N\] and depth \[m\] of a touch at a share of its full level.
    fn press_of(&self, touch: &Touch, at: &Point3<f64>, share: f64) -> (f64, Option<f64>) {
        match touch.level {
            Level::Force(force) => {
                let force = force * share;
                let tip = self.straight_tip(touch);
                (force, tip.and_then(|tip| self.model.depth_of_tip(at, &tip, force)))
            }
            Level::Depth(depth) => {
                let depth = depth * share;
                // Checked when the plan was drawn.
                (self.force_of(touch, at, depth).unwrap_or_default(), Some(depth))
            }
        }
    }

    /// \[N\] that press the tip of a touch in so deep; `None` where the model does not know.
    fn force_of(&self, touch: &Touch, at: &Point3<f64>, depth: f64) -> Option<f64> {
        self.model.force_of_tip(at, &self.straight_tip(touch)?, depth)
    }

    /// The shape of a tip that stands straight; no model knows the depth of a tilted one, unless it is a sphere.
    fn straight_tip(&self, touch: &Touch) -> Option<TipShape> {
        match self.tip {
            None => Some(TipShape::Sphere { diameter: touch.diameter }),
            Some(PlanTip { shape, tilt, .. }) => {
                (tilt == 0.0 || matches!(shape, TipShape::Sphere { .. })).then_some(shape)
            }
        }
    }
}
