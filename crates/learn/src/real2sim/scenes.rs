//! Simulated contacts, one to four at a time.

use dermis_model::{ForwardModel, Indentation, Stimulus};
use nalgebra::{Point3, Vector3};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::LearnError;

/// Share of the median compliance below which a location is taken for rigid: it has no signal, and nothing is simulated.
const RIGID: f64 = 0.1;
/// Draws of one scene before its contacts are allowed to stand nearer to each other than requested.
const TRIES: usize = 200;

/// What is simulated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneSettings {
    /// \[N\] range of every contact's pressing force.
    pub force: [f64; 2],
    /// \[m\] of the tip.
    pub diameter: f64,
    /// \[m\] that contacts of a scene are apart at least.
    pub distance: f64,
    /// Locations of the surface that are pressed, over all three parts.
    #[serde(alias = "sites")]
    pub locations: usize,
    /// Draws locations, parts and scenes.
    pub seed: u64,
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self { force: [0.5, 34.3], diameter: 0.010, distance: 0.012, locations: 2500, seed: 1 }
    }
}

/// How far every point of a surface gives way to what presses there, as a share of the median: what is rigid feels nothing, and no
/// estimator knows of a contact there.
#[derive(Debug, Clone, PartialEq)]
pub struct Compliance {
    points: Vec<Point3<f64>>,
    shares: Vec<f64>,
}

impl Compliance {
    /// Presses every point of a model's surface with a tip of `diameter` \[m\].
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the model knows no displacements.
    pub fn of(model: &dyn ForwardModel, diameter: f64) -> Result<Self, LearnError> {
        let wrong = |reason: String| LearnError::Training { reason };
        let surface = model.surface();
        let mut map = vec![0.0; surface.points.len()];
        let mut shares = Vec::with_capacity(map.len());
        for (i, (position, normal)) in surface.points.iter().zip(&surface.normals).enumerate() {
            let contact = Indentation::sphere(*position, -normal, diameter);
            let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
            if !model.displacement(&stimulus, &mut map).map_err(|e| wrong(e.to_string()))? {
                return Err(unknown());
            }
            shares.push(map[i]);
        }
        let mut sorted = shares.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0).max(f64::MIN_POSITIVE);
        shares.iter_mut().for_each(|s| *s /= median);
        Ok(Self { points: surface.points.clone(), shares })
    }

    /// Of every point: one over the root of what it gives way, 0 where it is rigid. A map times these has its peak where a
    /// single contact is (see [`PeakSection::weights`](dermis_inference::PeakSection::weights)).
    #[must_use]
    pub fn weights(&self) -> Vec<f32> {
        self.shares.iter().map(|s| if *s >= RIGID { (1.0 / s.sqrt()) as f32 } else { 0.0 }).collect()
    }

    /// Whether the surface gives way at a location.
    #[must_use]
    pub fn gives_way(&self, location: &Point3<f64>) -> bool {
        let distance = |p: &Point3<f64>| (p - location).norm_squared();
        let nearest = (0..self.points.len())
            .min_by(|a, b| distance(&self.points[*a]).total_cmp(&distance(&self.points[*b])));
        nearest.is_some_and(|i| self.shares[i] >= RIGID)
    }

    /// Share of the points that give way.
    #[must_use]
    pub fn share(&self) -> f64 {
        let give = self.shares.iter().filter(|s| **s >= RIGID).count();
        give as f64 / self.shares.len().max(1) as f64
    }
}

fn unknown() -> LearnError {
    LearnError::Training {
        reason: "the forward model of this skin knows no displacements, which real2sim goes by; it is for skins whose \
                 surface bends"
            .into(),
    }
}

/// Locations are held out whole, in the thesis' ratio of 3 : 1 : 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// To learn from.
    Train,
    /// To choose by.
    Validation,
    /// To report on.
    Test,
}

/// Locations to press, parted.
#[derive(Debug, Clone)]
pub struct Scenes {
    settings: SceneSettings,
    /// Training, validation, test.
    parts: [Vec<(Point3<f64>, Vector3<f64>)>; 3],
}

impl Scenes {
    /// Draws locations all over the surface of a model, those left out that do not give way.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the model knows no displacements, or the settings are impossible.
    pub fn new(model: &dyn ForwardModel, settings: &SceneSettings) -> Result<Self, LearnError> {
        let wrong = |reason: String| LearnError::Training { reason };
        let [low, high] = settings.force;
        let lengths = [settings.diameter, settings.distance];
        let possible = low > 0.0 && high > low && high.is_finite() && lengths.iter().all(|l| *l > 0.0);
        if !possible {
            return Err(wrong(format!(
                "scenes of {low} to {high} N, a tip of {} m and a distance of {} m cannot be simulated: all must be \
                 positive, and the range of forces not empty",
                settings.diameter, settings.distance
            )));
        }
        let surface = model.surface();
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let mut sum = 0.0;
        let cumulative: Vec<f64> = surface
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| surface.points[i as usize]);
                sum += (b - a).cross(&(c - a)).norm() / 2.0;
                sum
            })
            .collect();
        let mut map = vec![0.0; surface.points.len()];
        let mut found = Vec::with_capacity(settings.locations);
        for _ in 0..settings.locations {
            let pick = rng.random_range(0.0..1.0) * sum;
            let index = cumulative.partition_point(|a| *a < pick).min(cumulative.len().saturating_sub(1));
            let Some(triangle) = surface.triangles.get(index) else { break };
            let [a, b, c] = triangle.map(|i| surface.points[i as usize]);
            let (mut u, mut v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let (position, normal) = surface.project(&(a + (b - a) * u + (c - a) * v));
            let contact = Indentation::sphere(position, -normal, settings.diameter);
            let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
            let known = model.displacement(&stimulus, &mut map).map_err(|e| wrong(format!("scenes: {e}")))?;
            if !known {
                return Err(unknown());
            }
            found.push((map.iter().copied().fold(0.0, f64::max), (position, normal)));
        }
        let mut sorted: Vec<f64> = found.iter().map(|(d, _)| *d).collect();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let mut locations: Vec<_> =
            found.into_iter().filter(|(d, _)| *d >= RIGID * median).map(|(_, location)| location).collect();
        if locations.len() < 10 {
            return Err(wrong(format!(
                "{} locations of the surface give way, where 10 are the least",
                locations.len()
            )));
        }
        locations.shuffle(&mut rng);
        let test = locations.split_off(locations.len() * 4 / 5);
        let validation = locations.split_off(locations.len() * 3 / 4);
        Ok(Self { settings: settings.clone(), parts: [locations, validation, test] })
    }

    /// What was requested.
    #[must_use]
    pub fn settings(&self) -> &SceneSettings {
        &self.settings
    }

    /// Locations of a part.
    #[must_use]
    pub fn locations(&self, part: Part) -> &[(Point3<f64>, Vector3<f64>)] {
        &self.parts[part as usize]
    }

    /// `count` scenes of `contacts` contacts at locations of a part, the same ones whenever they are requested.
    #[must_use]
    pub fn draw(&self, part: Part, contacts: usize, count: usize) -> Vec<Stimulus> {
        let s = &self.settings;
        let stream = (part as u64) << 8 | contacts as u64;
        let mut rng = ChaCha8Rng::seed_from_u64(s.seed);
        rng.set_stream(stream + 1);
        let locations = self.locations(part);
        let scene = |rng: &mut ChaCha8Rng| {
            let mut chosen: Vec<Indentation> = Vec::with_capacity(contacts);
            let mut tries = 0;
            while chosen.len() < contacts {
                let (position, normal) = locations[rng.random_range(0..locations.len())];
                tries += 1;
                let near = |c: &Indentation| (c.position - position).norm() < s.distance;
                if chosen.iter().any(near) && tries < TRIES {
                    continue;
                }
                let force = -normal * rng.random_range(s.force[0]..s.force[1]);
                chosen.push(Indentation::sphere(position, force, s.diameter));
            }
            Stimulus { contacts: chosen, ..Stimulus::default() }
        };
        (0..count).map(|_| scene(&mut rng)).collect()
    }
}
