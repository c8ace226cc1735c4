//! A plan carried out on a surface: what touches it at every instant.

mod sites;

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Stimulus, Tip as ModelTip, TipShape};
use dermis_msgs::geometry_msgs::msg::{Point, Vector3 as VectorMsg};
use dermis_msgs::msg::{self, IndentationContact};
use dermis_skin::{Phase, SkinDescription, Stamp, Surface};
use nalgebra::{Point3, Vector3};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::TestbedError;
use crate::plan::{Action, ForceDistribution, LONGEST, Level, Levels, Manner, Plan, PlanTip};
use sites::Sites;

/// The testbed at one instant: the ground truth.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Moment {
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

/// \[m\] off the surface that a named place may lie: rounding.
const OFF_SURFACE: f64 = 1e-4;
/// \[m\] that an indenter keeps from the skin between two presses.
const RETREAT: f64 = 0.01;

impl Moment {
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
            IndentationContact::sphere(
                Point { x: c.position.x, y: c.position.y, z: c.position.z },
                vector(&normal),
                vector(&c.force),
                msg::Contact::FORCE_FULL,
                depth.unwrap_or(f64::NAN),
                c.diameter(),
            )
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
            gravity: VectorMsg::UNKNOWN,
            contacts: contacts.collect(),
        }
    }
}

fn vector(v: &Vector3<f64>) -> VectorMsg {
    VectorMsg { x: v.x, y: v.y, z: v.z }
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

/// Where a part of a press has got to at its end, in shares of what the press goes up to.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key {
    /// \[s\] from the start of the press.
    end: f64,
    phase: Phase,
    level: f64,
    shear: f64,
    way: f64,
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
    /// Draws what `plan` leaves open.
    ///
    /// # Errors
    ///
    /// [`TestbedError::Plan`] where the plan does not fit the skin: no place keeps the margin, a place lies off the surface,
    /// contacts cannot keep their distance, or the model knows no force for a depth.
    pub fn new(plan: &Plan, model: &Arc<dyn ForwardModel>, seed: u64) -> Result<Self, TestbedError> {
        let surface = model.surface();
        let sites = Sites::new(surface, plan.margin, plan.region);
        let mut more = ChaCha8Rng::seed_from_u64(seed);
        more.set_stream(1);
        let mut draw = Draw { rng: ChaCha8Rng::seed_from_u64(seed), more, plan, sites: &sites, tried: 0 };
        let mut timeline = Self {
            presses: Vec::new(),
            duration: 0.0,
            count: 0,
            model: Arc::clone(model),
            tip: plan.tip,
            gravity: plan.gravity.unwrap_or_default().into(),
        };
        let mut location = 0;
        let too_narrow = || {
            let within = if plan.region.is_some() { " within `region`" } else { "" };
            let reason = format!("no place on the surface{within} is {} m away from its rim", plan.margin);
            plan.wrong("margin", reason)
        };
        for (i, step) in plan.steps.iter().enumerate() {
            let place = |draw: &mut Draw<'_>| draw.place().ok_or_else(too_narrow);
            let bounded = |timeline: &Self, draw: &Draw<'_>| timeline.bounded(plan, draw, i);
            let manner = &step.manner;
            let known = |touch: &Touch| knows(plan, model, i, touch);
            match &step.action {
                Action::Idle { duration } => timeline.idle(*duration),
                Action::Presses { count, level, repeats } => {
                    for _ in 0..*count {
                        bounded(&timeline, &draw)?;
                        let at = place(&mut draw)?;
                        location += 1;
                        let diameter = draw.diameter(manner);
                        for repeat in 0..*repeats {
                            let level = draw.level(level);
                            let touch = draw.touch(at, level, diameter, manner);
                            known(&touch)?;
                            timeline.press(&mut draw, manner, (location, repeat), vec![touch], None);
                        }
                    }
                }
                Action::Grid { pitch, levels } => {
                    let mut places = sites
                        .grid(*pitch)
                        .map_err(|reason| plan.wrong(format!("steps[{i}].pitch"), reason))?;
                    if places.is_empty() {
                        return Err(too_narrow());
                    }
                    plan.fits(places.len() as u64 * u64::from(levels.repeats) * levels.presses() as u64)?;
                    places.shuffle(&mut draw.rng);
                    for at in places {
                        bounded(&timeline, &draw)?;
                        location += 1;
                        timeline.place(&mut draw, manner, (i, location), at, levels)?;
                    }
                }
                Action::Places { at, levels } => {
                    for (j, at) in at.iter().enumerate() {
                        let (x, y, z) = (at[0], at[1], at[2]);
                        let at = Point3::from(*at);
                        let off = surface.distance(&at);
                        if off > OFF_SURFACE {
                            let reason = format!("({x}, {y}, {z}) m lies {off:.6} m off the surface");
                            return Err(plan.wrong(format!("steps[{i}].at[{j}]"), reason));
                        }
                        let (at, _) = surface.project(&at);
                        if !sites.may_be_touched(&at) {
                            let or = if plan.region.is_some() { ", or outside of `region`" } else { "" };
                            let reason = format!(
                                "({x}, {y}, {z}) m is nearer to the rim than the margin of {} m{or}",
                                plan.margin
                            );
                            return Err(plan.wrong(format!("steps[{i}].at[{j}]"), reason));
                        }
                        location += 1;
                        timeline.place(&mut draw, manner, (i, location), at, levels)?;
                    }
                }
                Action::Slides { count, force, length, speed } => {
                    for _ in 0..*count {
                        bounded(&timeline, &draw)?;
                        let (from, to) = draw.way(*length).ok_or_else(|| {
                            let reason =
                                format!("no way of {} m fits on the surface within the margin", length[0]);
                            plan.wrong(format!("steps[{i}].length"), reason)
                        })?;
                        location += 1;
                        let duration = (to - from).norm() / draw.within(*speed);
                        let level = draw.level(&Level::Force(*force));
                        let diameter = draw.diameter(manner);
                        let touch = Touch { from, to, level, diameter, shear: Vector3::zeros() };
                        timeline.press(&mut draw, manner, (location, 0), vec![touch], Some(duration));
                    }
                }
                Action::Multi { count, contacts, distance, level } => {
                    for _ in 0..*count {
                        bounded(&timeline, &draw)?;
                        let wanted = draw.rng.random_range(contacts[0]..=contacts[1]) as usize;
                        let at = draw.apart(wanted, *distance).ok_or_else(|| {
                            let [least, most] = *distance;
                            let far = if most.is_finite() {
                                format!("{least} to {most}")
                            } else {
                                least.to_string()
                            };
                            let reason = format!("{wanted} contacts {far} m apart do not fit on the surface");
                            plan.wrong(format!("steps[{i}].distance"), reason)
                        })?;
                        location += 1;
                        let diameter = draw.diameter(manner);
                        let mut touches = Vec::with_capacity(at.len());
                        for at in at {
                            let level = draw.level(level);
                            let touch = draw.touch(at, level, diameter, manner);
                            known(&touch)?;
                            touches.push(touch);
                        }
                        timeline.press(&mut draw, manner, (location, 0), touches, None);
                    }
                }
            }
            bounded(&timeline, &draw)?;
        }
        if timeline.duration <= 0.0 {
            return Err(plan.wrong("timing", "lets the plan last no time at all: lengthen a phase"));
        }
        Ok(timeline)
    }

    /// Refuses a plan that takes too long to carry out, or to draw.
    fn bounded(&self, plan: &Plan, draw: &Draw<'_>, step: usize) -> Result<(), TestbedError> {
        if self.duration > LONGEST {
            let days = LONGEST / 86_400.0;
            let reason =
                format!("makes the plan last longer than {days} days: take fewer or shorter presses");
            return Err(plan.wrong(format!("steps[{step}]"), reason));
        }
        if draw.tried > EFFORT {
            let reason = "finds too few places that keep the margin and the distances: take fewer presses, a smaller margin or \
                          shorter distances";
            return Err(plan.wrong(format!("steps[{step}]"), reason));
        }
        Ok(())
    }

    /// All presses at one place.
    fn place(
        &mut self,
        draw: &mut Draw<'_>,
        manner: &Manner,
        (step, location): (usize, u32),
        at: Point3<f64>,
        levels: &Levels,
    ) -> Result<(), TestbedError> {
        let diameter = draw.diameter(manner);
        for repeat in 0..levels.repeats {
            let values = levels.values.value();
            let all: &[f64] = if levels.incremental { &values[values.len() - 1..] } else { values };
            for value in all {
                let touch = draw.touch(at, levels.values.map(|_| *value), diameter, manner);
                knows(draw.plan, &self.model, step, &touch)?;
                let stairs: Vec<f64> =
                    if levels.incremental { values.iter().map(|v| v / value).collect() } else { vec![1.0] };
                self.climb(draw, manner, (location, repeat), vec![touch], None, &stairs);
            }
        }
        Ok(())
    }

    fn idle(&mut self, duration: f64) {
        self.presses.push(Press {
            number: self.count,
            location: 0,
            repeat: 0,
            touches: Vec::new(),
            start: self.duration,
            keys: Vec::new(),
        });
        self.duration += duration;
    }

    fn press(
        &mut self,
        draw: &mut Draw<'_>,
        manner: &Manner,
        whose: (u32, u32),
        touches: Vec<Touch>,
        slide: Option<f64>,
    ) {
        self.climb(draw, manner, whose, touches, slide, &[1.0]);
    }

    /// A press that holds at each of `stairs`, in shares of what it goes up to, the last of which is 1.
    fn climb(
        &mut self,
        draw: &mut Draw<'_>,
        manner: &Manner,
        (location, repeat): (u32, u32),
        touches: Vec<Touch>,
        slide: Option<f64>,
        stairs: &[f64],
    ) {
        let t = &draw.plan.timing;
        let held = manner.hold.unwrap_or(t.hold);
        let [approach, load, hold, unload, gap] =
            [t.approach, t.load, held, t.unload, t.gap].map(|range| draw.within(range));
        let mut keys = Vec::with_capacity(4);
        let mut at = Key { end: approach, phase: Phase::Approach, level: 0.0, shear: 0.0, way: 0.0 };
        keys.push(at);
        let mut go = |duration: f64, key: Key| {
            at = Key { end: at.end + duration, ..key };
            keys.push(at);
            at
        };
        let sheared = touches.iter().any(|touch| touch.shear != Vector3::zeros());
        let mut key = Key { end: approach, phase: Phase::Load, level: 0.0, shear: 0.0, way: 0.0 };
        for (i, stair) in stairs.iter().enumerate() {
            let [load, hold] = if i == 0 {
                [load, hold]
            } else {
                [t.load, held].map(|[low, high]| draw.more.random_range(low..=high))
            };
            key = go(load, Key { phase: Phase::Load, level: *stair, ..key });
            key = match slide {
                Some(duration) => go(duration, Key { phase: Phase::Slide, way: 1.0, ..key }),
                None => go(hold, Key { phase: Phase::Hold, ..key }),
            };
            if sheared {
                let [load, hold] = [t.load, held].map(|[low, high]| draw.more.random_range(low..=high));
                key = go(load, Key { phase: Phase::Load, shear: *stair, ..key });
                key = go(hold, Key { phase: Phase::Hold, ..key });
            }
        }
        let end = go(unload, Key { phase: Phase::Unload, level: 0.0, shear: 0.0, ..key }).end;
        self.count += 1;
        self.presses.push(Press {
            number: self.count,
            location,
            repeat,
            touches,
            start: self.duration,
            keys,
        });
        self.duration += end + gap;
    }

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
    pub(crate) fn first_touch(&self) -> Moment {
        let first = self.presses.iter().find_map(|p| p.keys.get(1).map(|key| p.start + key.end));
        first.map(|t| self.at(t)).unwrap_or_default()
    }

    /// Nothing touches.
    fn idle_moment(&self) -> Moment {
        let stimulus = Stimulus { gravity: self.gravity, ..Stimulus::default() };
        Moment { stimulus, ..Moment::default() }
    }

    /// What the testbed does at `t` \[s\]; idle before the start and after the end.
    #[must_use]
    pub fn at(&self, t: f64) -> Moment {
        let index = self.presses.partition_point(|p| p.start <= t).saturating_sub(1);
        let Some(press) = self.presses.get(index).filter(|p| p.start <= t) else {
            return self.idle_moment();
        };
        let since = t - press.start;
        let mut moment = Moment {
            press: press.number,
            location: press.location,
            repeat: press.repeat,
            ..self.idle_moment()
        };
        // A smooth start and end: a stage does not change its speed in no time.
        let smooth = |x: f64| 0.5 - 0.5 * (std::f64::consts::PI * x.clamp(0.0, 1.0)).cos();
        let next = press.keys.partition_point(|key| key.end <= since);
        let begin = next
            .checked_sub(1)
            .map_or(Key { end: 0.0, phase: Phase::Idle, level: 0.0, shear: 0.0, way: 0.0 }, |before| {
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
                    way: begin.way + (key.way - begin.way) * part,
                    ..*key
                }
            }
        };
        moment.phase = now.phase;
        let surface = self.model.surface();
        if now.level > 0.0 {
            for touch in &press.touches {
                let straight = touch.from + (touch.to - touch.from) * now.way;
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
            let (place, _) = surface.project(&(touch.from + (touch.to - touch.from) * now.way));
            Tip { place, gap }
        });
        moment
    }

    /// Pressing force \[N\] and depth \[m\] of a touch at a share of what it goes up to.
    fn press_of(&self, touch: &Touch, at: &Point3<f64>, share: f64) -> (f64, Option<f64>) {
        match touch.level {
            Level::Force(force) => {
                let force = force * share;
                // Of other tips than spheres no model knows how deep they sink in.
                let sphere = self.tip.is_none_or(|tip| matches!(tip.shape, TipShape::Sphere { .. }));
                (force, sphere.then(|| self.model.depth_at(at, touch.diameter, force)).flatten())
            }
            Level::Depth(depth) => {
                let depth = depth * share;
                // That it is known was seen when the plan was drawn.
                let force = self.model.force_at(at, touch.diameter, depth).unwrap_or_default();
                (force, Some(depth))
            }
        }
    }
}

/// Refuses a depth that takes no force that the model knows.
fn knows(plan: &Plan, model: &Arc<dyn ForwardModel>, step: usize, touch: &Touch) -> Result<(), TestbedError> {
    let Level::Depth(depth) = touch.level else { return Ok(()) };
    let sphere = plan.tip.is_none_or(|tip| matches!(tip.shape, TipShape::Sphere { .. }));
    let known = |depth| sphere && model.force_at(&touch.from, touch.diameter, depth).is_some();
    if known(depth) {
        return Ok(());
    }
    let field = match plan.steps[step].action {
        Action::Grid { .. } | Action::Places { .. } => "depths",
        _ => "depth",
    };
    let Point3 { coords } = touch.from;
    let reason = if known(0.0) {
        format!(
            "{depth:.6} m at ({:.6}, {:.6}, {:.6}) m is deeper than a tip of {} m can be pressed into this skin",
            coords.x, coords.y, coords.z, touch.diameter
        )
    } else {
        "the model of this skin does not know how deep a tip sinks in: name forces instead".to_owned()
    };
    Err(plan.wrong(format!("steps[{step}].{field}"), reason))
}

/// Random choices of one timeline.
struct Draw<'a> {
    rng: ChaCha8Rng,
    /// For what not every press draws, so that the others stay what they are without it.
    more: ChaCha8Rng,
    plan: &'a Plan,
    sites: &'a Sites<'a>,
    /// Comparisons with edges of the rim and with other contacts, for places that were tried.
    tried: u64,
}

/// Comparisons of all places that a plan draws: some seconds.
const EFFORT: u64 = 1_000_000_000;

/// Tries before a surface counts as too small for what is asked.
const TRIES: usize = 2000;

impl Draw<'_> {
    fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.rng.random_range(low..=high)
    }

    fn level(&mut self, range: &Level<[f64; 2]>) -> Level<f64> {
        range.map(|range| match self.plan.force_distribution {
            ForceDistribution::Uniform => self.within(*range),
            ForceDistribution::Log => self.within(range.map(f64::ln)).exp(),
        })
    }

    fn diameter(&mut self, manner: &Manner) -> f64 {
        let of = if manner.diameter.is_empty() { &self.plan.diameter } else { &manner.diameter };
        match of[..] {
            [diameter] => diameter,
            _ => of[self.more.random_range(0..of.len())],
        }
    }

    /// A contact that stays where it is, but for what its shear makes of it.
    fn touch(&mut self, at: Point3<f64>, level: Level<f64>, diameter: f64, manner: &Manner) -> Touch {
        let mut shear = Vector3::zeros();
        if let Some([low, high]) = manner.shear {
            let ratio = self.more.random_range(low..=high);
            let turn = match manner.shear_direction {
                Some(direction) => direction,
                None => self.more.random_range(0.0..std::f64::consts::TAU),
            };
            let (_, normal) = self.sites.surface.project(&at);
            let from = [Vector3::x(), Vector3::y()]
                .into_iter()
                .find_map(|axis| (axis - normal * axis.dot(&normal)).try_normalize(1e-3));
            if let Some(along) = from {
                let (sin, cos) = turn.sin_cos();
                shear = (along * cos + normal.cross(&along) * sin) * ratio;
            }
        }
        Touch { from: at, to: at, level, diameter, shear }
    }

    fn place(&mut self) -> Option<Point3<f64>> {
        (0..TRIES).find_map(|_| {
            self.tried += 10 + self.sites.edges();
            let p = self.sites.random(&mut self.rng);
            self.sites.may_be_touched(&p).then_some(p)
        })
    }

    fn way(&mut self, length: [f64; 2]) -> Option<(Point3<f64>, Point3<f64>)> {
        for _ in 0..TRIES {
            let from = self.place()?;
            let long = self.within(length);
            let (_, normal) = self.sites.surface.project(&from);
            let direction = Vector3::from_fn(|_, _| self.rng.random_range(-1.0..1.0f64));
            let Some(along) = (direction - normal * direction.dot(&normal)).try_normalize(1e-3) else {
                continue;
            };
            let (to, _) = self.sites.surface.project(&(from + along * long));
            self.tried += self.sites.edges();
            // A way that the rim or the curvature cut short is another way than the one that was asked for.
            if (to - from).norm() > 0.7 * long && self.sites.may_be_touched(&to) {
                return Some((from, to));
            }
        }
        None
    }

    fn apart(&mut self, count: usize, [least, most]: [f64; 2]) -> Option<Vec<Point3<f64>>> {
        for _ in 0..20 {
            let mut places: Vec<Point3<f64>> = Vec::new();
            for _ in 0..TRIES / 10 {
                self.tried += places.len() as u64;
                let p = self.place()?;
                if places.iter().all(|q| (least..=most).contains(&(p - q).norm())) {
                    places.push(p);
                }
                if places.len() == count {
                    return Some(places);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use dermis_skin::SurfaceSpec;
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet};

    fn moments(timeline: &Timeline) -> Vec<Moment> {
        let steps = (timeline.duration() * 1000.0) as u32;
        (0..=steps).map(|i| timeline.at(f64::from(i) / 1000.0)).collect()
    }

    #[test]
    fn a_press_goes_through_its_phases_and_its_force_does_not_jump() {
        let skin = testing::skin(100.0);
        let timeline = Timeline::new(&testing::plan(), &testing::Bumps::shared(&skin), 3).unwrap();
        let force = |m: &Moment| m.stimulus.contacts.iter().map(|c| -c.force.z).fold(0.0, f64::max);
        let mut last = Moment::default();
        for moment in moments(&timeline) {
            if moment.press == last.press && moment.phase != last.phase {
                let expected = match last.phase {
                    Phase::Idle | Phase::Approach => &[Phase::Load][..],
                    Phase::Load => &[Phase::Hold, Phase::Slide],
                    Phase::Hold | Phase::Slide => &[Phase::Unload],
                    Phase::Unload => &[Phase::Idle],
                };
                assert!(expected.contains(&moment.phase), "{:?} after {:?}", moment.phase, last.phase);
            }
            // 0.5 N in 30 ms along a cosine is at most 26 N/s.
            assert!((force(&moment) - force(&last)).abs() < 0.03, "{last:?} then {moment:?}");
            let tip = moment.tip.unwrap();
            assert_eq!(tip.gap > 0.0, matches!(moment.phase, Phase::Idle | Phase::Approach), "{moment:?}");
            assert!(moment.stimulus.contacts.first().is_none_or(|c| c.position == tip.place));
            let touches = matches!(moment.phase, Phase::Hold | Phase::Slide);
            assert!(!touches || force(&moment) > 0.0);
            assert!(
                !matches!(moment.phase, Phase::Idle | Phase::Approach) || moment.stimulus.contacts.is_empty()
            );
            last = moment;
        }
        assert_eq!(timeline.at(-1.0), Moment::default());
        assert_eq!(timeline.at(timeline.duration() + 1e6).phase, Phase::Idle);
    }

    #[test]
    fn the_plan_is_carried_out_in_full() {
        let skin = testing::skin(100.0);
        let timeline = Timeline::new(&testing::plan(), &testing::Bumps::shared(&skin), 3).unwrap();
        // 26 mm by 16 mm within the margin: points at 0, 8, 16, 24 by 0, 8, 16 mm.
        let grid = 4 * 3;
        assert_eq!(timeline.presses(), 4 * 2 + grid * 2 * 2 + 3 + 3);
        let all = moments(&timeline);
        let locations: BTreeSet<u32> = all.iter().map(|m| m.location).collect();
        assert_eq!(locations.len() as u64, 1 + 4 + grid + 3 + 3);
        assert!(all.iter().any(|m| m.phase == Phase::Slide));
        for pair in all.iter().map(|m| &m.stimulus.contacts).filter(|c| c.len() > 1) {
            assert!((pair[0].position - pair[1].position).norm() >= 0.006);
        }
        // One place is one position, whatever the repeat, unless it slides.
        for location in 1..=4 {
            let places: Vec<_> = all
                .iter()
                .filter(|m| m.location == location)
                .flat_map(|m| m.stimulus.contacts.iter().map(|c| c.position))
                .collect();
            assert!(places.len() > 10 && places.iter().all(|p| *p == places[0]));
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let skin = testing::skin(100.0);
        let plan_error = |text: &str| {
            let plan = Plan::from_toml(text, "plan.toml").unwrap();
            Timeline::new(&plan, &testing::Bumps::shared(&skin), 1).unwrap_err().to_string()
        };
        let refused = |from: &str, to: &str| plan_error(&testing::PLAN.replace(from, to));
        let no_time = r#"
            schema = "dermis-plan/1"
            name = "no-time"
            diameter = 0.004
            timing = { approach = [0, 0], load = [0, 0], hold = [0, 0], unload = [0, 0], gap = [0, 0] }
            steps = [{ kind = "presses", count = 3, force = [0.1, 0.2] }]
        "#;
        insta::assert_snapshot!(plan_error(no_time), @"plan plan.toml: field `timing`: lets the plan last no time at all: lengthen a phase");
        insta::assert_snapshot!(refused("margin = 0.002", "margin = 0.011"), @"plan plan.toml: field `margin`: no place on the surface is 0.011 m away from its rim");
        insta::assert_snapshot!(refused("length = [0.004, 0.008]", "length = [0.1, 0.2]"), @"plan plan.toml: field `steps[3].length`: no way of 0.1 m fits on the surface within the margin");
        insta::assert_snapshot!(refused("distance = 0.006", "distance = 0.06"), @"plan plan.toml: field `steps[4].distance`: 2 contacts 0.06 m apart do not fit on the surface");
    }

    fn carried_out(steps: &str) -> Result<Timeline, String> {
        let text = format!(
            r#"
            schema = "dermis-plan/1"
            name = "some"
            diameter = 0.004
            margin = 0.002
            timing = {{ approach = [0.02, 0.02], load = [0.04, 0.04], hold = [0.1, 0.1], unload = [0.04, 0.04], gap = [0.02, 0.02] }}
            {steps}
            "#
        );
        let plan = Plan::from_toml(&text, "some.toml").map_err(|e| e.to_string())?;
        let model = testing::Bumps::shared(&testing::skin(100.0));
        Timeline::new(&plan, &model, 1).map_err(|e| e.to_string())
    }

    #[test]
    fn a_plan_may_name_a_tip_that_is_no_sphere_and_gravity() {
        let steps = "[[steps]]\nkind = \"presses\"\ncount = 3\nforce = [0.5, 1.0]\n";
        let tip = "{ shape = { shape = \"wedge\", angle = 1.0, length = 0.006 }, turn = 0.5, tilt = 0.25 }";
        let head = format!("schema = \"dermis-plan/1\"\nname = \"some\"\ntip = {tip}\n");
        let text = format!("{head}gravity = [0.0, 0.0, -9.81]\n{steps}");
        let read = |text: &str| Plan::from_toml(text, "some.toml").map_err(|e| e.to_string());
        let plan = read(&text).unwrap();
        let model = testing::Bumps::shared(&testing::skin(100.0));
        let timeline = Timeline::new(&plan, &model, 1).unwrap();
        let mut pressed = 0;
        for moment in moments(&timeline) {
            assert_eq!(moment.stimulus.gravity, Vector3::new(0.0, 0.0, -9.81));
            for contact in &moment.stimulus.contacts {
                assert_eq!(contact.tip.shape, TipShape::Wedge { angle: 1.0, length: 0.006 });
                let turned = contact.tip.orientation * Vector3::x();
                assert!((turned - Vector3::new(0.5f64.cos(), 0.5f64.sin(), 0.0)).norm() < 1e-12);
                let up = contact.tip.orientation * Vector3::z();
                assert!((up.z - 0.25f64.cos()).abs() < 1e-12);
                pressed += 1;
            }
            assert!(moment.depths.iter().all(Option::is_none));
        }
        assert!(pressed > 0);
        // Written and read again it is the same plan; one that says nothing of it does not write it.
        let json = serde_json::to_value(&plan).unwrap();
        assert_eq!(json["tip"]["shape"]["shape"], "wedge");
        let plain =
            read(&format!("schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n{steps}")).unwrap();
        let json = serde_json::to_value(&plain).unwrap();
        assert!(json.get("tip").is_none() && json.get("gravity").is_none());
        let deep = text.replace("force = [0.5, 1.0]", "depth = [0.0005, 0.001]");
        insta::assert_snapshot!(Timeline::new(&read(&deep).unwrap(), &model, 1).unwrap_err(), @"plan some.toml: field `steps[0].depth`: the model of this skin does not know how deep a tip sinks in: name forces instead");
        let refused = |from: &str, to: &str| read(&text.replace(from, to)).unwrap_err();
        insta::assert_snapshot!(refused("gravity", "diameter = 0.004\ngravity"), @"plan some.toml: field `tip`: stands beside `diameter`, which means a sphere: name one of them");
        insta::assert_snapshot!(refused("-9.81", "-9810.0"), @"plan some.toml: field `gravity`: has -9810 m/s² and must be -1000 to 1000 m/s²");
        insta::assert_snapshot!(refused("0.006", "0.0"), @"plan some.toml: field `tip.shape`: its length is 0 m and must be 0.0001 to 0.1 m");
        insta::assert_snapshot!(refused("tilt = 0.25", "tilt = 2.5"), @"plan some.toml: field `tip.tilt`: is 2.5 rad and must be -1.5707963267948966 to 1.5707963267948966 rad");
        insta::assert_snapshot!(read(&format!("schema = \"dermis-plan/1\"\nname = \"some\"\n{steps}")).unwrap_err(), @"plan some.toml: field `(whole file)`: missing field `diameter`, or `tip` for a tip that is no sphere");
        insta::assert_snapshot!(refused("force = [0.5, 1.0]", "force = [0.5, 1.0]\ndiameter = 0.004"), @"plan some.toml: field `steps[0].diameter`: stands in a plan whose `tip` is no sphere: leave it out");
    }

    #[test]
    fn depths_take_the_force_that_the_model_knows() {
        let steps = "[[steps]]\nkind = \"presses\"\ncount = 20\ndepth = [0.0005, 0.002]\n";
        let timeline = carried_out(steps).unwrap();
        let mut deepest = 0.0f64;
        for moment in moments(&timeline) {
            assert_eq!(moment.stimulus.contacts.len(), moment.depths.len());
            for (contact, depth) in moment.stimulus.contacts.iter().zip(&moment.depths) {
                let depth = depth.unwrap();
                assert!((-contact.force.z - 500.0 * depth).abs() < 1e-12 && depth <= 0.002);
                deepest = deepest.max(depth);
            }
        }
        assert!(deepest > 0.0015, "{deepest}");
        let refused = |from: &str, to: &str| carried_out(&steps.replace(from, to)).unwrap_err();
        insta::assert_snapshot!(refused("0.002]", "0.02]"), @"plan some.toml: field `steps[0].depth`: 0.009491 m at (-0.003716, -0.005006, 0.000000) m is deeper than a tip of 0.004 m can be pressed into this skin");
        let mut bumps = testing::Bumps::new(&testing::skin(100.0));
        bumps.deep = false;
        let model: Arc<dyn ForwardModel> = Arc::new(bumps);
        let text = format!("schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n{steps}");
        let plan = Plan::from_toml(&text, "some.toml").unwrap();
        insta::assert_snapshot!(Timeline::new(&plan, &model, 1).unwrap_err(), @"plan some.toml: field `steps[0].depth`: the model of this skin does not know how deep a tip sinks in: name forces instead");
    }

    #[test]
    fn an_incremental_press_climbs_and_is_moved_sideways_at_each_level() {
        let timeline = carried_out(
            "[[steps]]\nkind = \"places\"\nat = [[0.001, 0.0, 0.0]]\nforces = [0.1, 0.3, 0.4]\nincremental = true\nshear = 0.5\nshear_direction = 1.0",
        )
        .unwrap();
        assert_eq!(timeline.presses(), 1);
        let mut held = Vec::new();
        let mut last: Vector3<f64> = Vector3::zeros();
        for moment in moments(&timeline) {
            let force = moment.stimulus.contacts.first().map_or(Vector3::zeros(), |c| c.force);
            let (normal, along) = (-force.z, Vector3::new(force.x, force.y, 0.0));
            assert!((along - Vector3::new(1f64.cos(), 1f64.sin(), 0.0) * along.norm()).norm() < 1e-12);
            if moment.phase == Phase::Load {
                assert!(normal >= -last.z - 1e-12 && along.norm() <= 0.5 * normal + 1e-12);
            }
            if moment.phase == Phase::Hold {
                let level = [normal, along.norm()].map(|f| (f * 1e9).round() / 1e9);
                if held.last() != Some(&level) {
                    held.push(level);
                }
            }
            assert!((force - last).norm() < 0.03, "it jumps from {last:?} to {force:?}");
            last = force;
        }
        assert_eq!(held, [[0.1, 0.0], [0.1, 0.05], [0.3, 0.05], [0.3, 0.15], [0.4, 0.15], [0.4, 0.2]]);
    }

    #[test]
    fn what_a_step_adds_does_not_change_what_the_others_draw() {
        let plain = "[[steps]]\nkind = \"presses\"\ncount = 6\nforce = [0.1, 0.5]\n";
        let of = |steps: &str| {
            let timeline = carried_out(steps).unwrap();
            let held = moments(&timeline).into_iter().filter(|m| m.phase == Phase::Hold);
            let mut places: BTreeMap<u32, (Point3<f64>, f64, BTreeSet<u64>)> = BTreeMap::new();
            for moment in held {
                let contact = &moment.stimulus.contacts[0];
                let entry = places.entry(moment.location).or_insert((
                    contact.position,
                    contact.force.z,
                    BTreeSet::new(),
                ));
                entry.2.insert(contact.diameter().to_bits());
            }
            places
        };
        let (plain, more) = (of(plain), of(&format!("{plain}shear = [0.1, 0.9]\ndiameter = [0.002, 0.008]")));
        let mut tips: BTreeSet<u64> = BTreeSet::new();
        for (location, (place, force, _)) in &plain {
            let (same, strong, diameters) = &more[location];
            assert_eq!((place, force, diameters.len()), (same, strong, 1));
            tips.extend(diameters);
        }
        assert_eq!(tips.len(), 2);
    }

    #[test]
    fn a_grid_has_the_pitch_that_was_asked_for() {
        let steps = "[[steps]]\nkind = \"grid\"\npitch = [0.0007, 0.004]\nforces = [0.1]\n";
        let timeline = carried_out(steps).unwrap();
        let mut places: Vec<_> = timeline.presses.iter().map(|p| p.touches[0].from).collect();
        places.sort_by(|a, b| (a.y, a.x).partial_cmp(&(b.y, b.x)).unwrap());
        // 26 mm by 16 mm within the margin.
        assert_eq!(places.len(), 38 * 5);
        for pair in places.windows(2) {
            let way = pair[1] - pair[0];
            assert!(
                (way.x - 0.0007).abs() < 1e-12 && way.y == 0.0 || (way.y - 0.004).abs() < 1e-12,
                "{way:?}"
            );
        }
        assert!((nalgebra::center(&places[0], &places[places.len() - 1]).coords).norm() < 1e-12);
        let refused = |from: &str, to: &str| carried_out(&steps.replace(from, to)).unwrap_err();
        insta::assert_snapshot!(refused("[0.0007, 0.004]", "1e-6"), @"plan some.toml: field `steps[0].pitch`: makes 416042001 places; 1000000 contacts at most fit a recording");
        insta::assert_snapshot!(refused("[0.0007, 0.004]\nforces = [0.1]", "0.00003\nforces = [0.1, 0.2, 0.3]"), @"plan some.toml: field `steps`: make 1388934 contacts; 1000000 at most fit a recording");
        let text = format!("schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n{steps}");
        let on_a_dome = |pitch: &str| {
            let plan = Plan::from_toml(&text.replace("[0.0007, 0.004]", pitch), "some.toml").unwrap();
            let dome = SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 };
            Timeline::new(&plan, &testing::Bumps::on(&dome), 1).map_err(|e| e.to_string())
        };
        insta::assert_snapshot!(on_a_dome("[0.0007, 0.004]").unwrap_err(), @"plan some.toml: field `steps[0].pitch`: is of two numbers, which a flat skin has only");
        insta::assert_snapshot!(on_a_dome("0.0005").unwrap_err(), @"plan some.toml: field `steps[0].pitch`: is 0.0005 m, and the points of this curved surface are 0.002023 m apart: take a wider pitch, or a finer `surface.spacing` in the skin description");
        assert!(on_a_dome("0.004").unwrap().presses() > 50);
    }

    #[test]
    fn shear_lies_in_a_curved_surface_too() {
        let text = r#"
            schema = "dermis-plan/1"
            name = "sheared"
            diameter = 0.004
            [[steps]]
            kind = "presses"
            count = 60
            force = [0.2, 0.4]
            shear = 0.5
            [[steps]]
            kind = "grid"
            pitch = 0.008
            depths = [0.001, 0.002]
            incremental = true
            shear = 0.5
            shear_direction = 0.0
        "#;
        let dome = SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 };
        let (model, plan) = (testing::Bumps::on(&dome), Plan::from_toml(text, "sheared.toml").unwrap());
        let timeline = Timeline::new(&plan, &model, 1).unwrap();
        let mut largest = 0.0f64;
        for i in 0..(timeline.duration() * 100.0) as u32 {
            for contact in timeline.at(f64::from(i) / 100.0).stimulus.contacts {
                let (on, normal) = model.surface().project(&contact.position);
                let pressing = -contact.force.dot(&normal);
                let along = (contact.force + normal * pressing).norm();
                assert!((on - contact.position).norm() < 1e-9 && along <= 0.5 * pressing + 1e-9);
                largest = largest.max(along / pressing);
            }
        }
        assert!((largest - 0.5).abs() < 1e-9, "{largest}");
    }

    #[test]
    fn named_places_lie_on_the_surface() {
        let refused = |at: &str| {
            carried_out(&format!(
                "[[steps]]\nkind = \"places\"\nat = [[0.0, 0.0, 0.0], {at}]\nforces = [0.1]"
            ))
            .unwrap_err()
        };
        insta::assert_snapshot!(refused("[0.02, 0.0, 0.0]"), @"plan some.toml: field `steps[0].at[1]`: (0.02, 0, 0) m lies 0.005000 m off the surface");
        insta::assert_snapshot!(refused("[0.0, 0.0, 0.001]"), @"plan some.toml: field `steps[0].at[1]`: (0, 0, 0.001) m lies 0.001000 m off the surface");
        insta::assert_snapshot!(refused("[0.0, 0.0095, 0.0]"), @"plan some.toml: field `steps[0].at[1]`: (0, 0.0095, 0) m is nearer to the rim than the margin of 0.002 m");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn contacts_lie_on_the_surface_and_press_with_what_was_asked(seed in any::<u64>(), dome in any::<bool>()) {
            let spec = if dome {
                SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 }
            } else {
                SurfaceSpec::Rectangle { size: [0.03, 0.02], spacing: 0.002 }
            };
            let model = testing::Bumps::on(&spec);
            let surface = model.surface();
            let timeline = Timeline::new(&testing::plan(), &model, seed).unwrap();
            let again = Timeline::new(&testing::plan(), &model, seed).unwrap();
            for i in 0..200 {
                let t = timeline.duration() * f64::from(i) / 200.0;
                let moment = timeline.at(t);
                prop_assert_eq!(&moment, &again.at(t));
                for contact in &moment.stimulus.contacts {
                    let (on, normal) = surface.project(&contact.position);
                    prop_assert!((on - contact.position).norm() < 1e-9);
                    let pressing = -contact.force.dot(&normal);
                    prop_assert!(pressing > 0.0 && pressing <= 0.5 + 1e-9);
                    prop_assert!((contact.force + normal * pressing).norm() < 1e-9);
                    if !dome {
                        let p = contact.position;
                        prop_assert!(p.x.abs() <= 0.013 + 1e-9 && p.y.abs() <= 0.008 + 1e-9);
                    }
                }
            }
        }
    }
}
