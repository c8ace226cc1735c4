//! The random choices of a timeline: locations, levels, tips, directions.
//!
//! Two streams of one seed: a second one serves what not every press draws, so that a plan without it draws what it drew before.

use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Touch;
use super::candidates::CandidateLocations;
use crate::plan::{Drawn, ForceDistribution, Level, Plan, PressProfile};

/// Random choices of one timeline.
pub(super) struct Draw<'a> {
    pub(super) rng: ChaCha8Rng,
    /// For what not every press draws, so that the others stay what they are without it.
    pub(super) more: ChaCha8Rng,
    pub(super) plan: &'a Plan,
    pub(super) candidates: &'a CandidateLocations<'a>,
    /// Comparisons with edges of the rim and with other contacts, for all locations that were tried.
    pub(super) tried: u64,
}

/// Comparisons of all locations that a plan draws: some seconds.
pub(super) const EFFORT: u64 = 1_000_000_000;

/// Tries before a surface counts as too small for what the plan names.
const TRIES: usize = 2000;

impl<'a> Draw<'a> {
    pub(super) fn new(plan: &'a Plan, candidates: &'a CandidateLocations<'a>, seed: u64) -> Self {
        let mut more = ChaCha8Rng::seed_from_u64(seed);
        more.set_stream(1);
        Self { rng: ChaCha8Rng::seed_from_u64(seed), more, plan, candidates, tried: 0 }
    }

    pub(super) fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.rng.random_range(low..=high)
    }

    /// Of what not every press draws.
    pub(super) fn more_within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.more.random_range(low..=high)
    }

    pub(super) fn level(&mut self, range: &Level<[f64; 2]>) -> Level<f64> {
        range.map(|range| match self.plan.force_distribution {
            ForceDistribution::Uniform => self.within(*range),
            ForceDistribution::Log => self.within(range.map(f64::ln)).exp(),
        })
    }

    pub(super) fn one_level(&mut self, drawn: &Level<Drawn>) -> Level<f64> {
        match drawn.value() {
            Drawn::Within(range) => self.level(&drawn.map(|_| *range)),
            Drawn::OneOf(list) => drawn.map(|_| list[self.rng.random_range(0..list.len())]),
        }
    }

    pub(super) fn diameter(&mut self, profile: &PressProfile) -> f64 {
        let of = if profile.diameter.is_empty() { &self.plan.diameter } else { &profile.diameter };
        match of[..] {
            [diameter] => diameter,
            _ => of[self.more.random_range(0..of.len())],
        }
    }

    /// A contact that stays in place, moved by its shear only.
    pub(super) fn touch(
        &mut self,
        at: Point3<f64>,
        level: Level<f64>,
        diameter: f64,
        profile: &PressProfile,
    ) -> Touch {
        let mut shear = Vector3::zeros();
        if let Some([low, high]) = profile.shear {
            let ratio = self.more.random_range(low..=high);
            let turn = match profile.shear_direction {
                Some(direction) => direction,
                None => self.more.random_range(0.0..std::f64::consts::TAU),
            };
            let (_, normal) = self.candidates.surface.project(&at);
            if let Some(along) = along_surface(&normal) {
                let (sin, cos) = turn.sin_cos();
                shear = (along * cos + normal.cross(&along) * sin) * ratio;
            }
        }
        Touch { from: at, to: at, level, diameter, shear }
    }

    pub(super) fn place(&mut self) -> Option<Point3<f64>> {
        (0..TRIES).find_map(|_| {
            self.tried += 10 + self.candidates.edges();
            let p = self.candidates.random(&mut self.rng);
            self.candidates.may_be_touched(&p).then_some(p)
        })
    }

    /// Ends of a straight slide, projected to the surface.
    pub(super) fn path(&mut self, length: [f64; 2]) -> Option<(Point3<f64>, Point3<f64>)> {
        for _ in 0..TRIES {
            let from = self.place()?;
            let long = self.within(length);
            let (_, normal) = self.candidates.surface.project(&from);
            let direction = Vector3::from_fn(|_, _| self.rng.random_range(-1.0..1.0f64));
            let Some(along) = (direction - normal * direction.dot(&normal)).try_normalize(1e-3) else {
                continue;
            };
            let (to, _) = self.candidates.surface.project(&(from + along * long));
            self.tried += self.candidates.edges();
            // One that the rim or the curvature cut short has another length than the one that was drawn.
            if (to - from).norm() > 0.7 * long && self.candidates.may_be_touched(&to) {
                return Some((from, to));
            }
        }
        None
    }

    /// Ends of these arms of a hexagon about a random place, counted in steps of 60°, all of which may be touched; lengths \[m\] and
    /// angles \[rad\] of the first arm are drawn anew with each place.
    pub(super) fn hexagon(
        &mut self,
        arms: &[u32],
        radius: [f64; 2],
        turn: [f64; 2],
    ) -> Option<Vec<Point3<f64>>> {
        for _ in 0..TRIES {
            self.tried += 10 + self.candidates.edges() * arms.len() as u64;
            // The middle of the plate touches nothing: it need not keep the margin.
            let middle = self.candidates.random(&mut self.rng);
            let (radius, turn) = (self.within(radius), self.within(turn));
            let (_, normal) = self.candidates.surface.project(&middle);
            let Some(x) = along_surface(&normal) else { continue };
            let arm = |arm: &u32| {
                let (sin, cos) = (turn + f64::from(*arm) * std::f64::consts::FRAC_PI_3).sin_cos();
                middle + (x * cos + normal.cross(&x) * sin) * radius
            };
            let ends: Vec<Point3<f64>> = arms.iter().map(arm).collect();
            // One that the rim or the curvature moved is no arm of that hexagon any more.
            let on = ends.iter().map(|end| self.candidates.surface.project(end).0);
            let near = |(on, end): (Point3<f64>, &Point3<f64>)| {
                let fits = (on - end).norm() <= 0.05 * radius && self.candidates.may_be_touched(&on);
                fits.then_some(on)
            };
            if let Some(locations) = on.zip(&ends).map(near).collect() {
                return Some(locations);
            }
        }
        None
    }

    /// So many locations, each so far from every other.
    pub(super) fn apart(&mut self, count: usize, [least, most]: [f64; 2]) -> Option<Vec<Point3<f64>>> {
        for _ in 0..20 {
            let mut locations: Vec<Point3<f64>> = Vec::new();
            for _ in 0..TRIES / 10 {
                self.tried += locations.len() as u64;
                let p = self.place()?;
                if locations.iter().all(|q| (least..=most).contains(&(p - q).norm())) {
                    locations.push(p);
                }
                if locations.len() == count {
                    return Some(locations);
                }
            }
        }
        None
    }
}

/// The link's x axis along a surface of this normal, its y axis where x is the normal.
fn along_surface(normal: &Vector3<f64>) -> Option<Vector3<f64>> {
    [Vector3::x(), Vector3::y()]
        .into_iter()
        .find_map(|axis| (axis - normal * axis.dot(normal)).try_normalize(1e-3))
}
