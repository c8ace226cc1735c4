//! One contact on the body over time: where it is, how it moves, how hard it presses, and which skins feel it.
//!
//! Problem: readings of one contact come from several skins, each with its own error and at its own times. Method: a Kalman filter for
//! position and velocity, and one for the force, both with [biases that stay](crate::filter).
//!
//! - Velocity follows an Ornstein–Uhlenbeck process, and position is its integral: the contact forgets its velocity within
//!   [`slide_time`](Settings::slide_time), so that a lost contact does not run away (Bar-Shalom, Li and Kirubarajan, *Estimation with
//!   Applications to Tracking and Navigation*, 2001, §8.2).
//! - Force is a random walk of intensity [`force_change`](Settings::force_change).
//!
//! Everything is in the frame of the topmost link that the skin is rigidly connected with: there a moving arm does not move its
//! contacts, and joint positions are not needed.
//!
//! Assumption: skins that feel one contact each feel all of its force, as where one lies over the other, so that forces are averaged.

use dermis_skin::{Contact, ForceComponents, Stamp};
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3};

use crate::filter::{Filter, Reading};
use crate::settings::Settings;
use crate::slip::{SlipWatch, Touched};

/// \[N²\] variance of a component of the force that is not measured.
const UNMEASURED: f64 = 1e6;
/// \[N²\] above which a component counts as not measured.
const KNOWN: f64 = 1e4;
/// \[m²\], \[N²\] added to covariances of readings: those of points on a surface have no extent across it.
const LEAST: f64 = 1e-8;
/// Cosine of the largest angle between the normals of one contact.
const LEAST_COSINE: f64 = 0.0;

/// \[s\] from `from` to `to`.
pub(crate) fn seconds(from: Stamp, to: Stamp) -> f64 {
    to.saturating_sub(from) as f64 * 1e-9
}

/// A contact that a skin reports, as the filters read it.
#[derive(Debug, Clone)]
pub(crate) struct Detection {
    /// Identity at the skin.
    pub track: u32,
    /// `None` where the skin does not say where.
    pub place: Option<Reading>,
    /// `None` where the skin does not say how hard.
    pub force: Option<Reading>,
    pub normal: Vector3<f64>,
    pub components: ForceComponents,
    pub diameter: f32,
    pub confidence: f32,
    pub taxels: Vec<u32>,
}

fn finite(matrix: &Matrix3<f64>) -> bool {
    matrix.iter().all(|v| v.is_finite())
}

/// Half of what rounding made of it, so that it is symmetric, and no axis without extent.
fn covariance(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5 + Matrix3::from_diagonal_element(LEAST)
}

impl Detection {
    /// \[m²\] what its place adds to how far it can be from a track; 0 where it has none.
    pub(crate) fn extent(&self) -> f64 {
        self.place.map_or(0.0, |p| p.noise.trace() + 2.0 * p.bias.trace())
    }

    /// What a skin reports, in the frame in which tracks are kept.
    pub(crate) fn of(contact: &Contact, skin: usize, top_from_skin: &Isometry3<f64>, s: &Settings) -> Self {
        let turn = top_from_skin.rotation.to_rotation_matrix();
        let turned = |m: Matrix3<f64>| turn * m * turn.transpose();
        let share = s.systematic_share;
        let place = contact.position.iter().all(|v| v.is_finite()).then(|| {
            let said = contact.position_covariance;
            let unknown = Matrix3::from_diagonal_element(s.unknown_position_deviation.powi(2));
            let all = turned(covariance(if finite(&said) { &said } else { &unknown }));
            let mount = Matrix3::from_diagonal_element(s.mount_deviation.powi(2));
            Reading {
                skin,
                value: (top_from_skin * contact.position).coords,
                noise: all * (1.0 - share),
                bias: all * share + mount,
            }
        });
        let force = Self::force(contact, s).map(|(value, noise, bias)| Reading {
            skin,
            value: turn * value,
            noise: turned(noise),
            bias: turned(bias),
        });
        let normal = contact.normal.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        Self {
            track: contact.track_id,
            place,
            components: if force.is_some() { contact.force_components } else { ForceComponents::None },
            force,
            normal: turn * normal,
            diameter: contact.diameter,
            confidence: if contact.confidence.is_finite() { contact.confidence.clamp(0.0, 1.0) } else { 1.0 },
            taxels: contact.taxels.clone(),
        }
    }

    /// Force, what is new in each reading, and what stays, in the frame of the skin.
    fn force(contact: &Contact, s: &Settings) -> Option<(Vector3<f64>, Matrix3<f64>, Matrix3<f64>)> {
        let said = contact.force_covariance;
        let unknown = Matrix3::from_diagonal_element(s.unknown_force_deviation.powi(2));
        let share = s.systematic_share;
        match contact.force_components {
            ForceComponents::None => None,
            ForceComponents::Normal => {
                let normal = contact.normal.try_normalize(1e-9)?;
                let along = contact.force.dot(&normal);
                let along = if along.is_finite() { along } else { return None };
                let variance = if finite(&said) { normal.dot(&(said * normal)) } else { unknown[(0, 0)] };
                let axis = normal * normal.transpose();
                let across = (Matrix3::identity() - axis) * UNMEASURED;
                let bias = variance * share + (s.gain_deviation * along).powi(2);
                Some((normal * along, axis * (variance * (1.0 - share) + LEAST) + across, axis * bias))
            }
            ForceComponents::Full => {
                let mut value = contact.force;
                if value.iter().all(|v| !v.is_finite()) {
                    return None;
                }
                let all = covariance(if finite(&said) { &said } else { &unknown });
                let (mut noise, mut bias) = (all * (1.0 - share), all * share);
                for i in 0..3 {
                    if value[i].is_finite() {
                        bias[(i, i)] += (s.gain_deviation * value[i]).powi(2);
                        continue;
                    }
                    value[i] = 0.0;
                    for matrix in [&mut noise, &mut bias] {
                        matrix.fill_row(i, 0.0);
                        matrix.fill_column(i, 0.0);
                    }
                    noise[(i, i)] = UNMEASURED;
                }
                Some((value, noise, bias))
            }
        }
    }
}

/// What a skin adds to a track.
#[derive(Debug, Clone)]
pub(crate) struct Source {
    pub skin: usize,
    /// Identity at the skin.
    pub track: u32,
    /// When it reported the contact last.
    pub seen: Stamp,
    pub normal: Vector3<f64>,
    pub components: ForceComponents,
    pub diameter: f32,
    pub confidence: f32,
    pub taxels: Vec<u32>,
    /// \[m²\] trace of the covariance of its latest position; infinite where it gives none.
    pub spread: f64,
    /// Readings in a row that were too far away.
    pub strays: u32,
}

/// One contact over time.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    /// Identity on the body; 0 before it is published.
    pub id: u32,
    /// Position and velocity; `None` where no skin says where it is.
    pub place: Option<Filter<6>>,
    pub force: Option<Filter<3>>,
    /// Skins that feel it now, the most certain first.
    pub sources: Vec<Source>,
    /// When it was detected first.
    pub born: Stamp,
    /// When it was detected last.
    pub seen: Stamp,
    /// What its filters are for.
    pub at: Stamp,
    /// Reports that contain it.
    pub hits: u32,
    pub slip: SlipWatch,
}

impl Track {
    pub(crate) fn begin(detection: &Detection, skin: usize, at: Stamp, s: &Settings) -> Self {
        let mut track = Self {
            id: 0,
            place: detection.place.map(|p| Filter::begin(&p, s.slide_speed.powi(2))),
            force: detection.force.map(|f| Filter::begin(&f, 0.0)),
            sources: Vec::new(),
            born: at,
            seen: at,
            at,
            hits: 1,
            slip: SlipWatch::default(),
        };
        track.note(detection, skin, at, 0);
        track
    }

    /// Takes the filters on to `at`. They never go back.
    pub(crate) fn predict(&mut self, at: Stamp, s: &Settings) {
        let dt = seconds(self.at, at);
        if dt <= 0.0 {
            return;
        }
        self.at = at;
        if let Some(place) = &mut self.place {
            let (f, q) = slide(dt, s);
            place.predict(&f, &q);
        }
        if let Some(force) = &mut self.force {
            force.diffuse(&Matrix3::from_diagonal_element(s.force_change.powi(2) * dt));
        }
    }

    /// Whether it is detected by this skin under this identity.
    pub(crate) fn is_detected_as(&self, skin: usize, track: u32) -> bool {
        self.sources.iter().any(|s| s.skin == skin && s.track == track)
    }

    /// \[1\] squared distance up to which a detection of a skin can be of this contact. One of a skin that feels it has twice as much:
    /// the errors of a skin stay, so that what is far once is far again.
    pub(crate) fn gate(&self, skin: usize, s: &Settings) -> f64 {
        if self.is_detected_by(skin) { 2.0 * s.gate } else { s.gate }
    }

    /// Whether a skin feels it.
    pub(crate) fn is_detected_by(&self, skin: usize) -> bool {
        self.sources.iter().any(|s| s.skin == skin)
    }

    /// Unit, out of the skins: the mean of what they say, the more certain ones counting more.
    pub(crate) fn normal(&self) -> Vector3<f64> {
        let weight = |s: &Source| if s.spread.is_finite() { 1.0 / s.spread } else { 1e-9 };
        let sum: Vector3<f64> = self.sources.iter().map(|s| s.normal * weight(s)).sum();
        sum.try_normalize(0.0).unwrap_or_else(Vector3::z)
    }

    /// Squared Mahalanobis distance of a detection, and what its uncertainty adds to the cost of taking the two for one \[1\]; `None`
    /// where they cannot be one.
    pub(crate) fn distance(&self, detection: &Detection) -> Option<(f64, f64)> {
        if self.normal().dot(&detection.normal) <= LEAST_COSINE {
            return None;
        }
        let (Some(filter), Some(reading)) = (&self.place, &detection.place) else { return None };
        let (distance, log_det) = filter.innovation(reading).distance();
        let own = (reading.noise + reading.bias).determinant().ln();
        distance.is_finite().then_some((distance, (log_det - own).max(0.0)))
    }

    /// \[m\] that a detection at `at` can be away at most whose [extent](Detection::extent) is no more than this, without the inverse that
    /// tells it exactly.
    pub(crate) fn reach(&self, extent: f64, at: Stamp, s: &Settings) -> f64 {
        let Some(filter) = &self.place else { return 0.0 };
        let dt = seconds(self.at, at).max(0.0);
        let velocity = filter.mean.fixed_rows::<3>(3).norm();
        // The largest eigenvalue is below the trace; a bias counts twice at most where it is in both.
        let covariance = &filter.covariance;
        let own = covariance[(0, 0)] + covariance[(1, 1)] + covariance[(2, 2)];
        let moved =
            (covariance[(3, 3)] + covariance[(4, 4)] + covariance[(5, 5)] + 3.0 * s.slide_speed.powi(2))
                * dt.powi(2);
        (2.0 * s.gate * (2.0 * (own + moved) + extent)).sqrt() + velocity * dt
    }

    /// Takes a detection of a skin for this contact, whose filters are for the same instant.
    pub(crate) fn take(&mut self, detection: &Detection, skin: usize, at: Stamp, s: &Settings) {
        if let Some(reading) = &detection.place {
            match &mut self.place {
                Some(filter) => filter.update(reading),
                None => self.place = Some(Filter::begin(reading, s.slide_speed.powi(2))),
            }
        }
        self.take_force(detection);
        self.note(detection, skin, at, 0);
        self.hits = self.hits.saturating_add(1);
        let reading = Touched {
            position: detection.place.map(|p| p.value),
            force: detection.force.filter(|_| detection.components == ForceComponents::Full).map(|f| f.value),
            normal: detection.normal,
        };
        let sources = &self.sources;
        self.slip.take(skin, at, &reading, |s| sources.iter().any(|known| known.skin == s));
    }

    /// Whether a reading that a skin takes for this contact, and that is too far away, may still be of it: a first one is an outlier, and
    /// where no other skin feels the contact, it is where the second says.
    pub(crate) fn bears_stray(&self, skin: usize, track: u32) -> bool {
        let source = self.sources.iter().find(|s| s.skin == skin && s.track == track && track != 0);
        source.is_some_and(|s| s.strays == 0 || self.sources.len() == 1)
    }

    /// Takes such a reading. The place of the first is skipped; at the second the contact is there.
    pub(crate) fn stray(&mut self, detection: &Detection, skin: usize, at: Stamp, s: &Settings) {
        let before = self.sources.iter().find(|s| s.skin == skin).map_or(0, |s| s.strays);
        let mut strays = before + 1;
        if before > 0
            && let (Some(filter), Some(reading)) = (&mut self.place, &detection.place)
        {
            filter.reset(reading, s.slide_speed.powi(2));
            strays = 0;
        }
        self.take_force(detection);
        self.note(detection, skin, at, strays);
        self.hits = self.hits.saturating_add(1);
    }

    fn take_force(&mut self, detection: &Detection) {
        if let Some(reading) = &detection.force {
            match &mut self.force {
                Some(filter) => filter.update(reading),
                None => self.force = Some(Filter::begin(reading, 0.0)),
            }
        }
    }

    fn note(&mut self, detection: &Detection, skin: usize, at: Stamp, strays: u32) {
        self.seen = at;
        let spread = detection.place.map_or(f64::INFINITY, |p| (p.noise + p.bias).trace());
        let source = Source {
            skin,
            track: detection.track,
            seen: at,
            normal: detection.normal,
            components: detection.components,
            diameter: detection.diameter,
            confidence: detection.confidence,
            taxels: detection.taxels.clone(),
            spread,
            strays,
        };
        match self.sources.iter_mut().find(|s| s.skin == skin) {
            Some(known) => *known = source,
            None => self.sources.push(source),
        }
        self.sources.sort_by(|a, b| a.spread.total_cmp(&b.spread).then(a.skin.cmp(&b.skin)));
    }

    /// Whether two tracks look like one contact: no skin feels both, and the distance of their means is within `gate` of their
    /// covariances.
    pub(crate) fn looks_like(&self, other: &Self, gate: f64) -> bool {
        let (Some(a), Some(b)) = (&self.place, &other.place) else { return false };
        // Most pairs end here.
        if self.sources.iter().any(|s| other.is_detected_by(s.skin)) {
            return false;
        }
        let difference = (a.mean - b.mean).fixed_rows::<3>(0).into_owned();
        let sum = a.head().1 + b.head().1;
        difference.norm_squared() <= gate * sum.trace()
            && self.normal().dot(&other.normal()) > LEAST_COSINE
            && sum.try_inverse().is_some_and(|i| difference.dot(&(i * difference)) <= gate)
    }

    /// Takes in a track that is the same contact, for the same instant.
    pub(crate) fn absorb(&mut self, other: &Self) {
        if let (Some(a), Some(b)) = (&self.place, &other.place)
            && let Some(both) = a.merged(b)
        {
            self.place = Some(both);
        }
        self.force = match (&self.force, &other.force) {
            (Some(a), Some(b)) => a.merged(b).or_else(|| Some(a.clone())),
            (a, b) => a.clone().or_else(|| b.clone()),
        };
        self.id = if self.id == 0 { other.id } else { self.id };
        self.sources.extend(other.sources.iter().cloned());
        self.sources.sort_by(|a, b| a.spread.total_cmp(&b.spread).then(a.skin.cmp(&b.skin)));
        self.born = self.born.min(other.born);
        self.seen = self.seen.max(other.seen);
        self.hits = self.hits.max(other.hits);
    }

    /// As a contact in the frame in which tracks are kept, and its velocity \[m/s\] with the covariance of that.
    pub(crate) fn estimate(&self) -> (Contact, Vector3<f64>, Matrix3<f64>) {
        let unknown = (Vector3::repeat(f64::NAN), Matrix3::repeat(f64::NAN));
        let (position, spread) = self.place.as_ref().map_or(unknown, Filter::head);
        let (velocity, velocity_spread) = self.place.as_ref().map_or(unknown, |p| {
            (p.mean.fixed_rows::<3>(3).into_owned(), p.covariance.fixed_view::<3, 3>(3, 3).into_owned())
        });
        let mut contact = Contact::at(Point3::from(position), self.normal());
        contact.track_id = self.id;
        contact.position_covariance = spread;
        self.put_force(&mut contact);
        if let Some(first) = self.sources.first() {
            contact.diameter = first.diameter;
            contact.taxels.clone_from(&first.taxels);
        }
        contact.confidence = self.sources.iter().map(|s| s.confidence).fold(0.0, f32::max);
        (contact, velocity, velocity_spread)
    }

    fn put_force(&self, contact: &mut Contact) {
        let measures = |c: ForceComponents| self.sources.iter().any(|s| s.components == c);
        let Some(filter) = &self.force else { return };
        let (force, spread) = filter.head();
        if measures(ForceComponents::Full) {
            contact.force_components = ForceComponents::Full;
            (contact.force, contact.force_covariance) = (force, spread);
        } else if measures(ForceComponents::Normal) {
            let normal = contact.normal;
            contact.force_components = ForceComponents::Normal;
            contact.force = normal * normal.dot(&force);
            contact.force_covariance = normal * normal.transpose() * normal.dot(&(spread * normal));
        }
    }
}

/// Makes components of a force that nobody measures NaN, once it is in the frame in which it is read.
pub(crate) fn hide_unmeasured(contact: &mut Contact) {
    for i in 0..3 {
        if contact.force_covariance[(i, i)] > KNOWN {
            contact.force[i] = f64::NAN;
            contact.force_covariance.fill_row(i, f64::NAN);
            contact.force_covariance.fill_column(i, f64::NAN);
        }
    }
}

/// Transition and noise of position and velocity over `dt` \[s\].
pub(crate) fn slide(dt: f64, s: &Settings) -> (Matrix6<f64>, Matrix6<f64>) {
    let (tau, variance) = (s.slide_time, s.slide_speed.powi(2));
    let x = dt / tau;
    let decay = (-x).exp();
    let lost = -(-x).exp_m1();
    // For short steps the terms of the exact form cancel.
    let spread = if x < 1e-3 {
        x.powi(3) * (2.0 / 3.0 - x / 2.0)
    } else {
        2.0 * x - 3.0 + 4.0 * decay - decay * decay
    };
    let (mut f, mut q) = (Matrix6::identity(), Matrix6::zeros());
    for i in 0..3 {
        f[(i, i + 3)] = tau * lost;
        f[(i + 3, i + 3)] = decay;
        q[(i, i)] = variance * tau * tau * spread;
        q[(i, i + 3)] = variance * tau * lost * lost;
        q[(i + 3, i)] = q[(i, i + 3)];
        q[(i + 3, i + 3)] = variance * (1.0 - decay * decay);
    }
    (f, q)
}
