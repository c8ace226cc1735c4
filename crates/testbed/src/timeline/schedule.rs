//! From a plan to presses, one after the other.
//!
//! Steps are carried out in order, and each draws its locations, levels and durations. A plan that would last or draw for too
//! long is refused while it is drawn, and a depth that the model knows no force for before it is recorded.

use std::sync::Arc;

use dermis_model::ForwardModel;
use dermis_skin::Phase;
use nalgebra::{Point3, Vector3};
use rand::Rng;
use rand::seq::SliceRandom;

use super::candidates::CandidateLocations;
use super::draw::{Draw, EFFORT};
use super::motion::{Stroke, gravity_in, postures, strokes_of};
use super::{Key, Press, Timeline, Touch};
use crate::TestbedError;
use crate::plan::{
    Action, Drawn, HEX_ARMS, LONGEST, Level, Levels, Plan, PostureSet, PressProfile, Step, Strokes,
};

/// \[m\] off the surface that a named place may lie: rounding.
const OFF_SURFACE: f64 = 1e-4;

impl Timeline {
    /// Draws what `plan` leaves open.
    ///
    /// # Errors
    ///
    /// [`TestbedError::Plan`] where the plan does not fit the skin: no place keeps the margin, a place lies off the surface,
    /// contacts cannot keep their distance, or the model knows no force for a depth.
    pub fn new(plan: &Plan, model: &Arc<dyn ForwardModel>, seed: u64) -> Result<Self, TestbedError> {
        let candidates = CandidateLocations::new(model.surface(), plan.margin, plan.region);
        let timeline = Self {
            presses: Vec::new(),
            duration: 0.0,
            count: 0,
            model: Arc::clone(model),
            tip: plan.tip,
            gravity: plan.gravity.unwrap_or_default().into(),
        };
        let draw = Draw::new(plan, &candidates, seed);
        let mut schedule = Schedule { timeline, draw, step: 0, location: 0, named: Vec::new() };
        for (i, step) in plan.steps.iter().enumerate() {
            schedule.step = i;
            schedule.carry_out(step)?;
            schedule.check_bounds()?;
        }
        let timeline = schedule.timeline;
        if timeline.duration <= 0.0 {
            return Err(plan.wrong("timing", "lets the plan last no time at all: lengthen a phase"));
        }
        Ok(timeline)
    }

    /// A stretch of nothing, at a location of its own where gravity is not the plan's.
    fn idle(&mut self, duration: f64, posture: Option<(u32, Vector3<f64>)>) {
        self.presses.push(Press {
            number: self.count,
            location: posture.map_or(0, |(location, _)| location),
            repeat: 0,
            touches: Vec::new(),
            start: self.duration,
            keys: Vec::new(),
            gravity: posture.map(|(_, gravity)| gravity),
        });
        self.duration += duration;
    }
}

/// A timeline that is being drawn.
struct Schedule<'a> {
    timeline: Timeline,
    draw: Draw<'a>,
    /// Index of the step.
    step: usize,
    /// Identity of the last place, from 1.
    location: u32,
    /// Locations that were named, and their identities.
    named: Vec<(Point3<f64>, u32)>,
}

impl Schedule<'_> {
    fn carry_out(&mut self, step: &Step) -> Result<(), TestbedError> {
        let profile = &step.profile;
        match &step.action {
            Action::Idle { duration } => {
                self.timeline.idle(*duration, None);
                Ok(())
            }
            Action::Presses { count, level, repeats } => {
                (0..*count).try_for_each(|_| self.presses_at_one_location(level, *repeats, profile))
            }
            Action::Levels { count, levels } => (0..*count).try_for_each(|_| {
                self.check_bounds()?;
                let at = self.draw.place().ok_or_else(|| self.too_narrow())?;
                self.location += 1;
                self.levels(at, levels, profile)
            }),
            Action::Grid { pitch, levels } => self.grid(*pitch, levels, profile),
            Action::Locations { at, levels } => {
                at.iter().enumerate().try_for_each(|(j, at)| self.named_place(j, *at, levels, profile))
            }
            Action::Slides { count, force, length, speed, strokes } => {
                (0..*count).try_for_each(|_| self.slide(*force, [*length, *speed], strokes, profile))
            }
            Action::Multi { count, contacts, distance, level } => {
                (0..*count).try_for_each(|_| self.multi(*contacts, *distance, level, profile))
            }
            Action::Hex { count, contacts, radius, turn, levels } => {
                (0..*count).try_for_each(|_| self.hex(*contacts, [*radius, *turn], levels, profile))
            }
            Action::Postures { yaw, roll, set, duration } => self.postures([*yaw, *roll], *set, *duration),
        }
    }

    /// Holds the skin in one posture after another. Each has a location of its own, so that data sets can be split by them.
    fn postures(
        &mut self,
        ranges: [[f64; 2]; 2],
        set: PostureSet,
        duration: f64,
    ) -> Result<(), TestbedError> {
        let upright = self.timeline.gravity;
        for angles in postures(ranges, set, &mut self.draw) {
            self.check_bounds()?;
            self.location += 1;
            self.timeline.idle(duration, Some((self.location, gravity_in(&upright, angles))));
        }
        Ok(())
    }

    fn presses_at_one_location(
        &mut self,
        level: &Level<[f64; 2]>,
        repeats: u32,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        self.check_bounds()?;
        let at = self.draw.place().ok_or_else(|| self.too_narrow())?;
        self.location += 1;
        let diameter = self.draw.diameter(profile);
        for repeat in 0..repeats {
            let level = self.draw.level(level);
            let touch = self.draw.touch(at, level, diameter, profile);
            self.check_depth(&touch)?;
            self.press(profile, repeat, vec![touch], &[], &[1.0]);
        }
        Ok(())
    }

    fn grid(&mut self, pitch: [f64; 2], levels: &Levels, profile: &PressProfile) -> Result<(), TestbedError> {
        let plan = self.draw.plan;
        let mut locations = self
            .draw
            .candidates
            .grid(pitch)
            .map_err(|reason| plan.wrong(format!("steps[{}].pitch", self.step), reason))?;
        if locations.is_empty() {
            return Err(self.too_narrow());
        }
        plan.fits(locations.len() as u64 * u64::from(levels.repeats) * levels.presses() as u64)?;
        locations.shuffle(&mut self.draw.rng);
        for at in locations {
            self.check_bounds()?;
            self.location += 1;
            self.levels(at, levels, profile)?;
        }
        Ok(())
    }

    fn named_place(
        &mut self,
        index: usize,
        at: [f64; 3],
        levels: &Levels,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        let Draw { plan, candidates, .. } = self.draw;
        let field = || format!("steps[{}].at[{index}]", self.step);
        let [x, y, z] = at;
        let at = Point3::from(at);
        let off = candidates.surface.distance(&at);
        if off > OFF_SURFACE {
            let reason = format!("({x}, {y}, {z}) m lies {off:.6} m off the surface");
            return Err(plan.wrong(field(), reason));
        }
        let (at, _) = candidates.surface.project(&at);
        if !candidates.may_be_touched(&at) {
            let or = if plan.region.is_some() { ", or outside of `region`" } else { "" };
            let reason =
                format!("({x}, {y}, {z}) m is nearer to the rim than the margin of {} m{or}", plan.margin);
            return Err(plan.wrong(field(), reason));
        }
        // A place that is named again is the same place.
        let before = self.named.iter().find(|(place, _)| *place == at).map(|(_, location)| *location);
        if let Some(location) = before {
            let last = std::mem::replace(&mut self.location, location);
            let done = self.levels(at, levels, profile);
            self.location = last;
            return done;
        }
        self.location += 1;
        self.named.push((at, self.location));
        self.levels(at, levels, profile)
    }

    /// All presses at one place.
    fn levels(
        &mut self,
        at: Point3<f64>,
        levels: &Levels,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        let diameter = self.draw.diameter(profile);
        self.levels_of(&[at], levels, diameter, profile)
    }

    /// All presses of one or several tips that go up to the same levels together.
    fn levels_of(
        &mut self,
        at: &[Point3<f64>],
        levels: &Levels,
        diameter: f64,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        for repeat in 0..levels.repeats {
            let values = levels.values.value();
            let all: &[f64] = if levels.incremental { &values[values.len() - 1..] } else { values };
            for value in all {
                let touch = |at: &Point3<f64>, draw: &mut Draw<'_>| {
                    draw.touch(*at, levels.values.map(|_| *value), diameter, profile)
                };
                let touches: Vec<Touch> = at.iter().map(|at| touch(at, &mut self.draw)).collect();
                touches.iter().try_for_each(|touch| self.check_depth(touch))?;
                let staircase: Vec<f64> =
                    if levels.incremental { values.iter().map(|v| v / value).collect() } else { vec![1.0] };
                self.press(profile, repeat, touches, &[], &staircase);
            }
        }
        Ok(())
    }

    /// Tips on the arms of one plate, lowered together.
    fn hex(
        &mut self,
        contacts: [u32; 2],
        [radius, turn]: [[f64; 2]; 2],
        levels: &Levels,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        self.check_bounds()?;
        let wanted = self.draw.rng.random_range(contacts[0]..=contacts[1]);
        let arms = HEX_ARMS.get(wanted.saturating_sub(1) as usize).copied().unwrap_or_default();
        let at = self.draw.hexagon(arms, radius, turn).ok_or_else(|| {
            let reason = format!(
                "{wanted} tips {} m and more from the middle of their plate do not fit on the surface within the margin",
                radius[0]
            );
            self.draw.plan.wrong(format!("steps[{}].radius", self.step), reason)
        })?;
        self.location += 1;
        let diameter = self.draw.diameter(profile);
        self.levels_of(&at, levels, diameter, profile)
    }

    fn slide(
        &mut self,
        force: [f64; 2],
        [length, speed]: [[f64; 2]; 2],
        strokes: &Strokes,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        self.check_bounds()?;
        let way = length.map(|one| one * f64::from(strokes.count));
        let (from, to) = self.draw.path(way).ok_or_else(|| {
            let reason = format!("no way of {} m fits on the surface within the margin", way[0]);
            self.draw.plan.wrong(format!("steps[{}].length", self.step), reason)
        })?;
        self.location += 1;
        let duration = (to - from).norm() / self.draw.within(speed);
        let strokes = strokes_of(strokes, duration, &mut self.draw);
        let level = self.draw.level(&Level::Force(force));
        let diameter = self.draw.diameter(profile);
        let touch = Touch { from, to, level, diameter, shear: Vector3::zeros() };
        self.press(profile, 0, vec![touch], &strokes, &[1.0]);
        Ok(())
    }

    fn multi(
        &mut self,
        contacts: [u32; 2],
        distance: [f64; 2],
        level: &Level<Drawn>,
        profile: &PressProfile,
    ) -> Result<(), TestbedError> {
        self.check_bounds()?;
        let wanted = self.draw.rng.random_range(contacts[0]..=contacts[1]) as usize;
        let at = self.draw.apart(wanted, distance).ok_or_else(|| {
            let [least, most] = distance;
            let far = if most.is_finite() { format!("{least} to {most}") } else { least.to_string() };
            let reason = format!("{wanted} contacts {far} m apart do not fit on the surface");
            self.draw.plan.wrong(format!("steps[{}].distance", self.step), reason)
        })?;
        self.location += 1;
        let diameter = self.draw.diameter(profile);
        let mut touches = Vec::with_capacity(at.len());
        for at in at {
            let level = self.draw.one_level(level);
            let touch = self.draw.touch(at, level, diameter, profile);
            self.check_depth(&touch)?;
            touches.push(touch);
        }
        self.press(profile, 0, touches, &[], &[1.0]);
        Ok(())
    }

    /// A press at the last place that holds at each of `staircase`, in shares of its full level, the last of which is 1.
    fn press(
        &mut self,
        profile: &PressProfile,
        repeat: u32,
        touches: Vec<Touch>,
        slide: &[Stroke],
        staircase: &[f64],
    ) {
        let steps = self.within_forces(profile, &touches, staircase);
        if steps.is_empty() {
            return;
        }
        let draw = &mut self.draw;
        let t = &draw.plan.timing;
        let [loaded, held, unloaded, rested] = [
            profile.load.unwrap_or(t.load),
            profile.hold.unwrap_or(t.hold),
            profile.unload.unwrap_or(t.unload),
            profile.gap.unwrap_or(t.gap),
        ];
        let [approach, load, hold, unload, gap] =
            [t.approach, loaded, held, unloaded, rested].map(|range| draw.within(range));
        let mut keys = Vec::with_capacity(4);
        let mut at = Key { end: approach, phase: Phase::Approach, level: 0.0, shear: 0.0, slide: 0.0 };
        keys.push(at);
        let mut go = |duration: f64, key: Key| {
            at = Key { end: at.end + duration, ..key };
            keys.push(at);
            at
        };
        let sheared = touches.iter().any(|touch| touch.shear != Vector3::zeros());
        let mut key = Key { end: approach, phase: Phase::Load, level: 0.0, shear: 0.0, slide: 0.0 };
        for (i, step) in steps.iter().enumerate() {
            let [load, hold] =
                if i == 0 { [load, hold] } else { [loaded, held].map(|range| draw.more_within(range)) };
            key = go(load, Key { phase: Phase::Load, level: *step, ..key });
            if slide.is_empty() {
                key = go(hold, Key { phase: Phase::Hold, ..key });
            }
            for stroke in slide {
                key = go(stroke.duration, Key { phase: Phase::Slide, slide: stroke.to, ..key });
                if stroke.stop > 0.0 {
                    key = go(stroke.stop, Key { phase: Phase::Hold, ..key });
                }
            }
            if sheared {
                let [load, hold] = [loaded, held].map(|range| draw.more_within(range));
                key = go(load, Key { phase: Phase::Load, shear: *step, ..key });
                key = go(hold, Key { phase: Phase::Hold, ..key });
            }
        }
        let end = go(unload, Key { phase: Phase::Unload, level: 0.0, shear: 0.0, ..key }).end;
        let timeline = &mut self.timeline;
        timeline.count += 1;
        timeline.presses.push(Press {
            number: timeline.count,
            location: self.location,
            repeat,
            touches,
            start: timeline.duration,
            keys,
            gravity: None,
        });
        timeline.duration += end + gap;
    }

    /// Those steps of a staircase at which every tip presses with the least force of the profile or more, up to the first at which one
    /// presses with more than the most.
    fn within_forces(&self, profile: &PressProfile, touches: &[Touch], staircase: &[f64]) -> Vec<f64> {
        let least = profile.least_force.unwrap_or(0.0);
        // Rounding must not drop a level that is exactly the least.
        let heavy = |step: &f64, touch: &Touch| {
            self.timeline.press_of(touch, &touch.from, *step).0 >= least * (1.0 - 1e-9)
        };
        let most = profile.most_force.unwrap_or(f64::INFINITY) * (1.0 + 1e-9);
        let stops = |step: &&f64| {
            touches.iter().all(|touch| self.timeline.press_of(touch, &touch.from, **step).0 <= most)
        };
        staircase
            .iter()
            .take_while(stops)
            .filter(|step| touches.iter().all(|touch| heavy(step, touch)))
            .copied()
            .collect()
    }

    /// Refuses a plan that takes too long to carry out, or to draw.
    fn check_bounds(&self) -> Result<(), TestbedError> {
        let wrong = |reason: String| Err(self.draw.plan.wrong(format!("steps[{}]", self.step), reason));
        if self.timeline.duration > LONGEST {
            let days = LONGEST / 86_400.0;
            return wrong(format!(
                "makes the plan last longer than {days} days: take fewer or shorter presses"
            ));
        }
        if self.draw.tried > EFFORT {
            return wrong(
                "finds too few locations that keep the margin and the distances: take fewer presses, a smaller margin or shorter \
                 distances"
                    .to_owned(),
            );
        }
        Ok(())
    }

    /// Refuses a depth that takes no force that the model knows.
    fn check_depth(&self, touch: &Touch) -> Result<(), TestbedError> {
        let (plan, step) = (self.draw.plan, self.step);
        let Level::Depth(depth) = touch.level else { return Ok(()) };
        let known = |depth| self.timeline.force_of(touch, &touch.from, depth).is_some();
        if known(depth) {
            return Ok(());
        }
        let field = match &plan.steps[step].action {
            Action::Levels { .. }
            | Action::Grid { .. }
            | Action::Locations { .. }
            | Action::Hex { .. }
            | Action::Multi { level: Level::Depth(Drawn::OneOf(_)), .. } => "depths",
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

    fn too_narrow(&self) -> TestbedError {
        let plan = self.draw.plan;
        let within = if plan.region.is_some() { " within `region`" } else { "" };
        let reason = format!("no place on the surface{within} is {} m away from its rim", plan.margin);
        plan.wrong("margin", reason)
    }
}
