//! A plan carried out on a surface: what touches it at every instant.

use std::collections::BTreeMap;

use dermis_msgs::geometry_msgs::msg::{Point, Vector3 as VectorMsg};
use dermis_msgs::msg::{self, IndentationContact};
use dermis_skin::{Indentation, SkinDescription, Stamp, Stimulus, Surface};
use nalgebra::{Point3, Vector3};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::TestbedError;
use crate::plan::{ForceDistribution, Plan, Step};

/// What the testbed is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Phase {
    /// Nothing is near.
    #[default]
    Idle,
    /// The indenter comes near; it does not touch yet.
    Approach,
    /// The force grows.
    Load,
    /// The force is constant.
    Hold,
    /// The force is constant and the indenter moves along the surface.
    Slide,
    /// The force falls.
    Unload,
}

impl Phase {
    /// As `Indentation.phase` says it.
    #[must_use]
    pub fn code(self) -> u8 {
        match self {
            Self::Idle => msg::Indentation::PHASE_IDLE,
            Self::Approach => msg::Indentation::PHASE_APPROACH,
            Self::Load => msg::Indentation::PHASE_LOAD,
            Self::Hold => msg::Indentation::PHASE_HOLD,
            Self::Slide => msg::Indentation::PHASE_SLIDE,
            Self::Unload => msg::Indentation::PHASE_UNLOAD,
        }
    }
}

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

impl Moment {
    /// As the ground truth message of a labelled bag. The depth is NaN: a testbed of prescribed forces does not
    /// know how far the indenter sank in.
    #[must_use]
    pub fn message(
        &self,
        skin: &SkinDescription,
        surface: &Surface,
        session: &str,
        stamp: Stamp,
    ) -> msg::Indentation {
        let contacts = self.stimulus.contacts.iter().map(|c| {
            let (_, normal) = surface.project(&c.position);
            IndentationContact {
                position: Point { x: c.position.x, y: c.position.y, z: c.position.z },
                normal: vector(&normal),
                force: vector(&c.force),
                force_components: msg::Contact::FORCE_FULL,
                depth: f64::NAN,
                diameter: c.diameter,
            }
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
    force: f64,
}

/// A press, or a stretch of nothing where it has no touches.
#[derive(Debug, Clone, PartialEq)]
struct Press {
    number: u64,
    location: u32,
    repeat: u32,
    slides: bool,
    touches: Vec<Touch>,
    start: f64,
    /// Ends of approach, load, hold and unload \[s from `start`\].
    ends: [f64; 4],
}

/// A plan carried out on a surface with one seed. Time runs from 0 to [`duration`](Self::duration).
#[derive(Debug, Clone)]
pub struct Timeline {
    presses: Vec<Press>,
    duration: f64,
    diameter: f64,
    count: u64,
    surface: Surface,
}

impl Timeline {
    /// Draws what `plan` leaves open.
    ///
    /// # Errors
    ///
    /// [`TestbedError::Plan`] where the plan does not fit the surface: no place keeps the margin, or contacts
    /// cannot keep their distance.
    pub fn new(plan: &Plan, surface: &Surface, seed: u64) -> Result<Self, TestbedError> {
        let sites = Sites::new(surface, plan.margin);
        let mut draw = Draw { rng: ChaCha8Rng::seed_from_u64(seed), plan, sites: &sites };
        let mut timeline = Self {
            presses: Vec::new(),
            duration: 0.0,
            diameter: plan.diameter,
            count: 0,
            surface: surface.clone(),
        };
        let mut location = 0;
        let too_narrow = || TestbedError::Plan {
            file: plan.name.clone(),
            field: "margin".into(),
            reason: format!("no place on the surface is {} m away from its rim", plan.margin),
        };
        for (i, step) in plan.steps.iter().enumerate() {
            let place = |draw: &mut Draw<'_>| draw.place().ok_or_else(too_narrow);
            match step {
                Step::Idle { duration } => timeline.idle(*duration),
                Step::Presses { count, force, repeats } => {
                    for _ in 0..*count {
                        let at = place(&mut draw)?;
                        location += 1;
                        for repeat in 0..*repeats {
                            let force = draw.force(*force);
                            timeline.press(
                                &mut draw,
                                location,
                                repeat,
                                vec![Touch { from: at, to: at, force }],
                                None,
                            );
                        }
                    }
                }
                Step::Grid { pitch, forces, repeats } => {
                    let mut places = sites.grid(*pitch);
                    if places.is_empty() {
                        return Err(too_narrow());
                    }
                    places.shuffle(&mut draw.rng);
                    for at in places {
                        location += 1;
                        for repeat in 0..*repeats {
                            for &force in forces {
                                let touches = vec![Touch { from: at, to: at, force }];
                                timeline.press(&mut draw, location, repeat, touches, None);
                            }
                        }
                    }
                }
                Step::Slides { count, force, length, speed } => {
                    for _ in 0..*count {
                        let (from, to) = draw.way(*length).ok_or_else(|| TestbedError::Plan {
                            file: plan.name.clone(),
                            field: format!("steps[{i}].length"),
                            reason: format!(
                                "no way of {} m fits on the surface within the margin",
                                length[0]
                            ),
                        })?;
                        location += 1;
                        let duration = (to - from).norm() / draw.within(*speed);
                        let force = draw.force(*force);
                        timeline.press(
                            &mut draw,
                            location,
                            0,
                            vec![Touch { from, to, force }],
                            Some(duration),
                        );
                    }
                }
                Step::Multi { count, contacts, distance, force } => {
                    for _ in 0..*count {
                        let wanted = draw.rng.random_range(contacts[0]..=contacts[1]) as usize;
                        let at = draw.apart(wanted, *distance).ok_or_else(|| TestbedError::Plan {
                            file: plan.name.clone(),
                            field: format!("steps[{i}].distance"),
                            reason: format!("{wanted} contacts {distance} m apart do not fit on the surface"),
                        })?;
                        location += 1;
                        let touches = at
                            .into_iter()
                            .map(|at| Touch { from: at, to: at, force: draw.force(*force) })
                            .collect();
                        timeline.press(&mut draw, location, 0, touches, None);
                    }
                }
            }
        }
        if timeline.duration <= 0.0 {
            return Err(TestbedError::Plan {
                file: plan.name.clone(),
                field: "timing".into(),
                reason: "lets the plan last no time at all: lengthen a phase".into(),
            });
        }
        Ok(timeline)
    }

    fn idle(&mut self, duration: f64) {
        self.presses.push(Press {
            number: self.count,
            location: 0,
            repeat: 0,
            slides: false,
            touches: Vec::new(),
            start: self.duration,
            ends: [0.0; 4],
        });
        self.duration += duration;
    }

    fn press(
        &mut self,
        draw: &mut Draw<'_>,
        location: u32,
        repeat: u32,
        touches: Vec<Touch>,
        slide: Option<f64>,
    ) {
        let t = &draw.plan.timing;
        let [approach, load, hold, unload, gap] =
            [t.approach, t.load, t.hold, t.unload, t.gap].map(|range| draw.within(range));
        let mut end = 0.0;
        let ends = [approach, load, slide.unwrap_or(hold), unload].map(|duration| {
            end += duration;
            end
        });
        self.count += 1;
        self.presses.push(Press {
            number: self.count,
            location,
            repeat,
            slides: slide.is_some(),
            touches,
            start: self.duration,
            ends,
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
        let first = self.presses.iter().find(|p| !p.touches.is_empty());
        first.map(|p| self.at(p.start + p.ends[1])).unwrap_or_default()
    }

    /// What the testbed does at `t` \[s\]; idle before the start and after the end.
    #[must_use]
    pub fn at(&self, t: f64) -> Moment {
        let index = self.presses.partition_point(|p| p.start <= t).saturating_sub(1);
        let Some(press) = self.presses.get(index).filter(|p| p.start <= t) else {
            return Moment::default();
        };
        let since = t - press.start;
        let mut moment = Moment {
            press: press.number,
            location: press.location,
            repeat: press.repeat,
            ..Moment::default()
        };
        let [approach, load, hold, unload] = press.ends;
        // A smooth start and end: a stage does not change its speed in no time.
        let smooth = |x: f64| 0.5 - 0.5 * (std::f64::consts::PI * x.clamp(0.0, 1.0)).cos();
        let (phase, level, way) = if press.touches.is_empty() || since >= unload {
            (Phase::Idle, 0.0, 1.0)
        } else if since < approach {
            (Phase::Approach, 0.0, 0.0)
        } else if since < load {
            (Phase::Load, smooth((since - approach) / (load - approach)), 0.0)
        } else if since < hold {
            let phase = if press.slides { Phase::Slide } else { Phase::Hold };
            (phase, 1.0, (since - load) / (hold - load))
        } else {
            (Phase::Unload, smooth((unload - since) / (unload - hold)), 1.0)
        };
        moment.phase = phase;
        if level > 0.0 {
            moment.stimulus.contacts = press
                .touches
                .iter()
                .map(|touch| {
                    let straight = touch.from + (touch.to - touch.from) * way;
                    let (position, normal) = self.surface.project(&straight);
                    Indentation { position, force: -normal * (touch.force * level), diameter: self.diameter }
                })
                .collect();
        }
        let gap = match phase {
            Phase::Idle => RETREAT,
            Phase::Approach => RETREAT * (1.0 - smooth(since / approach)),
            _ => 0.0,
        };
        // Between presses it waits above the place that it has left, before the first above that to come.
        let at = self.presses[index..].iter().chain(&self.presses[..index]).find_map(|p| p.touches.first());
        moment.tip = at.map(|touch| {
            let (place, _) = self.surface.project(&(touch.from + (touch.to - touch.from) * way));
            Tip { place, gap }
        });
        moment
    }
}

/// Random choices of one timeline.
struct Draw<'a> {
    rng: ChaCha8Rng,
    plan: &'a Plan,
    sites: &'a Sites<'a>,
}

/// Tries before a surface counts as too small for what is asked.
const TRIES: usize = 2000;

impl Draw<'_> {
    fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.rng.random_range(low..=high)
    }

    fn force(&mut self, range: [f64; 2]) -> f64 {
        match self.plan.force_distribution {
            ForceDistribution::Uniform => self.within(range),
            ForceDistribution::Log => self.within(range.map(f64::ln)).exp(),
        }
    }

    fn place(&mut self) -> Option<Point3<f64>> {
        (0..TRIES).find_map(|_| {
            let p = self.sites.random(&mut self.rng);
            self.sites.keeps_margin(&p).then_some(p)
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
            // A way that the rim or the curvature cut short is another way than the one that was asked for.
            if (to - from).norm() > 0.7 * long && self.sites.keeps_margin(&to) {
                return Some((from, to));
            }
        }
        None
    }

    fn apart(&mut self, count: usize, distance: f64) -> Option<Vec<Point3<f64>>> {
        for _ in 0..20 {
            let mut places: Vec<Point3<f64>> = Vec::new();
            for _ in 0..TRIES / 10 {
                let p = self.place()?;
                if places.iter().all(|q| (p - q).norm() >= distance) {
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

/// Where a surface can be touched.
struct Sites<'a> {
    surface: &'a Surface,
    /// Sum of the areas of the triangles up to and with each.
    cumulative: Vec<f64>,
    /// Edges of one triangle only.
    rim: Vec<[Point3<f64>; 2]>,
    margin: f64,
}

impl<'a> Sites<'a> {
    fn new(surface: &'a Surface, margin: f64) -> Self {
        let mut sum = 0.0;
        let mut uses: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        let mut cumulative = Vec::with_capacity(surface.triangles.len());
        for t in &surface.triangles {
            let [a, b, c] = t.map(|i| surface.points[i as usize]);
            sum += (b - a).cross(&(c - a)).norm() / 2.0;
            cumulative.push(sum);
            for [i, j] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
                *uses.entry([i.min(j), i.max(j)]).or_default() += 1;
            }
        }
        let rim = uses.into_iter().filter(|(_, n)| *n == 1);
        let rim = rim.map(|(edge, _)| edge.map(|i| surface.points[i as usize])).collect();
        Self { surface, cumulative, rim, margin }
    }

    fn random(&self, rng: &mut impl Rng) -> Point3<f64> {
        let total = self.cumulative.last().copied().unwrap_or_default();
        let pick = rng.random_range(0.0..1.0) * total;
        let index = self.cumulative.partition_point(|a| *a < pick).min(self.cumulative.len() - 1);
        let [a, b, c] = self.surface.triangles[index].map(|i| self.surface.points[i as usize]);
        let (mut u, mut v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        self.surface.project(&(a + (b - a) * u + (c - a) * v)).0
    }

    fn keeps_margin(&self, p: &Point3<f64>) -> bool {
        // Rounding must not drop a place that is exactly the margin away.
        let least = self.margin * (1.0 - 1e-9);
        least <= 0.0
            || self.rim.iter().all(|[a, b]| {
                let edge = b - a;
                let along = ((p - a).dot(&edge) / edge.norm_squared()).clamp(0.0, 1.0);
                (p - (a + edge * along)).norm() >= least
            })
    }

    /// Points of the surface that keep the margin, at least `pitch` from one another along one of the axes: on
    /// a flat skin a square grid.
    fn grid(&self, pitch: f64) -> Vec<Point3<f64>> {
        let mut chosen: Vec<Point3<f64>> = Vec::new();
        // Rounding must not drop a neighbour that is exactly one pitch away.
        let least = pitch * (1.0 - 1e-9);
        for p in &self.surface.points {
            if self.keeps_margin(p) && chosen.iter().all(|q| (p - q).amax() >= least) {
                chosen.push(*p);
            }
        }
        chosen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use dermis_skin::SurfaceSpec;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn moments(timeline: &Timeline) -> Vec<Moment> {
        let steps = (timeline.duration() * 1000.0) as u32;
        (0..=steps).map(|i| timeline.at(f64::from(i) / 1000.0)).collect()
    }

    #[test]
    fn a_press_goes_through_its_phases_and_its_force_does_not_jump() {
        let skin = testing::skin(100.0);
        let timeline = Timeline::new(&testing::plan(), &skin.surface(), 3).unwrap();
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
        let timeline = Timeline::new(&testing::plan(), &skin.surface(), 3).unwrap();
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
            Timeline::new(&plan, &skin.surface(), 1).unwrap_err().to_string()
        };
        let refused = |from: &str, to: &str| plan_error(&testing::PLAN.replace(from, to));
        let no_time = r#"
            schema = "dermis-plan/1"
            name = "no-time"
            diameter = 0.004
            timing = { approach = [0, 0], load = [0, 0], hold = [0, 0], unload = [0, 0], gap = [0, 0] }
            steps = [{ kind = "presses", count = 3, force = [0.1, 0.2] }]
        "#;
        insta::assert_snapshot!(plan_error(no_time), @"plan no-time: field `timing`: lets the plan last no time at all: lengthen a phase");
        insta::assert_snapshot!(refused("margin = 0.002", "margin = 0.011"), @"plan all-kinds: field `margin`: no place on the surface is 0.011 m away from its rim");
        insta::assert_snapshot!(refused("length = [0.004, 0.008]", "length = [0.1, 0.2]"), @"plan all-kinds: field `steps[3].length`: no way of 0.1 m fits on the surface within the margin");
        insta::assert_snapshot!(refused("distance = 0.006", "distance = 0.06"), @"plan all-kinds: field `steps[4].distance`: 2 contacts 0.06 m apart do not fit on the surface");
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
            let surface = Surface::from_spec(&spec);
            let timeline = Timeline::new(&testing::plan(), &surface, seed).unwrap();
            let again = Timeline::new(&testing::plan(), &surface, seed).unwrap();
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
