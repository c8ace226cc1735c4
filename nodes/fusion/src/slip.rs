//! Whether a contact slips: not at all, a part of it, or all of it.
//!
//! Problem: friction is not known, a contact of a tip moves over the skin as it slides, and one of a large flat thing does not. Method:
//! three pieces of evidence, each against its own measured noise.
//!
//! - **Motion.** The difference of a fast and a slow average of the position is the velocity times the difference of their times. Where it
//!   is beyond its noise, all of the contact slides. A way from where the contact last stuck that is too slow for that, along the shear force, is the partial
//!   slip of Cattaneo and Mindlin (Johnson, *Contact Mechanics*, 1985, §7.2): incipient.
//! - **Friction.** While a contact slides, shear over normal force is its coefficient of friction. From then on, a contact that sticks
//!   again slips incipiently above [`NEAR`] of that.
//! - **Vibration.** Sliding shakes the shear force (Howe and Cutkosky, *Sensing skin acceleration for slip and texture perception*, ICRA 1989).
//!   Where its scatter, by second differences, is beyond [`SHAKEN`] times that of the contact while it stuck, all of it slides. Skins below
//!   200 Hz do not resolve this.
//!
//! One skin tells of a contact, as long as it feels it. What is said stays for [`HOLD`]. Without shear, a contact that does not move is
//! *unknown*: a flat thing may slide there. A contact that rolls is taken for one that slides: its place moves, too.
//!
//! Cost: constant for each reading; nothing is kept but averages.

use dermis_skin::Stamp;
use nalgebra::Vector3;

use crate::track::seconds;

/// \[s\] of the fast and the slow average of the position.
const FAST: f64 = 0.025;
const SLOW: f64 = 0.1;
/// \[s\] in which the place where a contact stuck follows what is slower than any slip.
const ANCHOR: f64 = 1.0;
/// \[1\] squared distance that is motion: χ² with two degrees of freedom beyond it once in 20,000 independent readings.
const GATE: f64 = 20.0;
/// \[m/s\] least velocity of a slide.
const LEAST_SPEED: f64 = 0.003;
/// \[m\] least way of an incipient slip.
const LEAST_WAY: f64 = 2e-4;
/// \[1\] of the friction at which a contact that sticks slips incipiently.
const NEAR: f64 = 0.85;
/// \[1\] scatter of the shear force over that of a contact that sticks, from which on it slides.
const SHAKEN: f64 = 3.0;
/// \[s\] over which scatter is taken, and the least number of readings in it.
const SHAKE: f64 = 0.05;
/// \[1\] of the scatter while it sticks that one reading counts with at most: a force that jumps does not shake.
const CLIP: f64 = 10.0;
const SHAKE_READINGS: f64 = 10.0;
/// \[s\] over which noise is measured.
const NOISE: f64 = 1.0;
/// \[s\] after the first reading before which nothing is said: the patch of a contact grows and its middle moves.
const SETTLE: f64 = 0.15;
/// \[s\] for which a slip is said after the last evidence.
const HOLD: f64 = 0.03;
/// \[1\] of the fastest motion of the last [`PEAK`] below which a slide is over: the averages go on for a while.
const OVER: f64 = 0.65;
/// \[s\] in which the fastest motion is forgotten.
const PEAK: f64 = 0.3;
/// \[s\] without a reading after which all begins anew.
const GAP: f64 = 0.5;

/// How a contact slips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Slip {
    /// No skin that feels it resolves it.
    #[default]
    Unknown,
    /// It sticks.
    None,
    /// A part of it slides.
    Incipient,
    /// All of it slides.
    Gross,
}

/// One reading of a contact, in a frame that moves with the skin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Touched {
    /// \[m\]; `None` where the skin does not say.
    pub position: Option<Vector3<f64>>,
    /// \[N\], all components; `None` where the skin does not measure shear.
    pub force: Option<Vector3<f64>>,
    /// Unit.
    pub normal: Vector3<f64>,
}

/// Scatter of the readings of a vector along the surface about a steady change.
#[derive(Debug, Clone, Copy, Default)]
struct Scatter {
    last: Option<[Vector3<f64>; 2]>,
    /// Variance of one component.
    variance: f64,
    readings: f64,
}

impl Scatter {
    /// Takes a reading; the variance of one component by this reading alone, from the third on.
    fn take(&mut self, value: Vector3<f64>, normal: &Vector3<f64>, time: f64, dt: f64) -> Option<f64> {
        let unknown = Vector3::repeat(f64::NAN);
        let [one, two] = self.last.unwrap_or([unknown, unknown]);
        self.last = Some([value, one]);
        let bend = value - 2.0 * one + two;
        // Two components, each with 1 + 4 + 1 times the variance of one.
        let single = (bend - normal * bend.dot(normal)).norm_squared() / 12.0;
        if !single.is_finite() {
            return None;
        }
        self.readings += 1.0;
        let weight = (1.0 / self.readings).max(1.0 - (-dt / time).exp());
        self.variance += weight * (single - self.variance);
        Some(single)
    }
}

/// What is known of the slip of one contact.
#[derive(Debug, Clone, Default)]
pub(crate) struct SlipWatch {
    skin: Option<usize>,
    begun: Stamp,
    at: Stamp,
    /// \[s\] between readings, smoothed.
    period: f64,
    fast: Option<Vector3<f64>>,
    slow: Vector3<f64>,
    /// \[m\] of the difference of the two, at most, of late.
    peak: f64,
    /// Where it stuck.
    anchor: Vector3<f64>,
    position: Scatter,
    /// Scatter of the shear force while it sticks.
    shear: Scatter,
    /// The same over a short time, whatever it does.
    shaken: f64,
    /// Shear over normal force while it slid.
    friction: Option<f64>,
    state: Slip,
    /// When there was evidence of the state last, and how much \[1\]: 1 is just enough.
    seen: Stamp,
    evidence: f64,
}

/// Weight of a reading in an average over `time`.
fn weight(dt: f64, time: f64) -> f64 {
    1.0 - (-dt / time).exp()
}

impl SlipWatch {
    /// How the contact slips, and how likely that is right: a half where the evidence is just enough.
    pub(crate) fn state(&self) -> (Slip, f64) {
        let confidence = match self.state {
            Slip::Unknown => f64::NAN,
            Slip::None => 1.0 - 0.5 * self.evidence.clamp(0.0, 1.0),
            Slip::Incipient | Slip::Gross => 1.0 - 0.5_f64.powf(self.evidence.max(1.0)),
        };
        (self.state, confidence)
    }

    /// Takes a reading of a skin; `feels` says which skins feel the contact.
    pub(crate) fn take(&mut self, skin: usize, at: Stamp, reading: &Touched, feels: impl Fn(usize) -> bool) {
        if self.skin.is_some_and(|known| known != skin && feels(known)) {
            return;
        }
        let dt = seconds(self.at, at);
        if self.skin != Some(skin) || !(0.0..GAP).contains(&dt) {
            // What was learnt of friction is the contact's, not the skin's.
            *self = Self { skin: Some(skin), begun: at, at, friction: self.friction, ..Self::default() };
        }
        if seconds(self.at, at) == 0.0 && self.period > 0.0 {
            return;
        }
        self.at = at;
        if dt < GAP {
            self.period += if self.period == 0.0 { dt } else { 0.1 * (dt - self.period) };
        }
        let (motion, way) = self.move_on(reading, dt);
        let sheared = reading.force.map(|force| shear(&force, &reading.normal));
        let vibration = self.shake(reading, dt, motion > 1.0);
        let gross = motion.max(vibration);
        let mut incipient: f64 = match sheared {
            Some((along, _)) if way.dot(&along) <= 0.0 => 0.0,
            _ => self.way_evidence(&way),
        };
        if let (Some((along, normal)), Some(friction)) = (sheared, self.friction) {
            incipient = incipient.max(along.norm() / normal.max(1e-6) / (NEAR * friction));
        }
        if gross > 1.0 {
            if let Some((along, normal)) = sheared.filter(|(_, normal)| *normal > 0.0) {
                let ratio = along.norm() / normal;
                self.friction = Some(self.friction.map_or(ratio, |f| f + weight(dt, SLOW) * (ratio - f)));
            }
            self.anchor = self.fast.unwrap_or(self.anchor);
        }
        self.decide(gross, incipient, sheared.is_some());
    }

    /// Averages of the position; evidence of motion, and the way from where it stuck.
    fn move_on(&mut self, reading: &Touched, dt: f64) -> (f64, Vector3<f64>) {
        let Some(position) = reading.position else {
            self.fast = None;
            return (0.0, Vector3::zeros());
        };
        self.position.take(position, &reading.normal, NOISE, dt);
        let Some(fast) = &mut self.fast else {
            (self.fast, self.slow, self.anchor) = (Some(position), position, position);
            return (0.0, Vector3::zeros());
        };
        *fast += (position - *fast) * weight(dt, FAST);
        self.slow += (*fast - self.slow) * weight(dt, SLOW);
        self.anchor += (*fast - self.anchor) * weight(dt, ANCHOR);
        let fast = *fast;
        if seconds(self.begun, self.at) < SETTLE {
            self.anchor = fast;
            return (0.0, Vector3::zeros());
        }
        let along = |v: Vector3<f64>| v - reading.normal * v.dot(&reading.normal);
        let lead = along(fast - self.slow);
        self.peak = (self.peak * (-dt / PEAK).exp()).max(lead.norm());
        if lead.norm() < OVER * self.peak {
            return (0.0, along(fast - self.anchor));
        }
        // The slow average follows the fast one, SLOW behind it.
        let fast_enough = lead.norm() / (LEAST_SPEED * SLOW);
        let beyond_noise = lead.norm_squared() / (GATE * self.spread(FAST));
        (fast_enough.min(beyond_noise), along(fast - self.anchor))
    }

    /// Variance of one component of an average of the position.
    fn spread(&self, time: f64) -> f64 {
        let share = weight(self.period, time);
        (self.position.variance * share / (2.0 - share)).max(1e-14)
    }

    fn way_evidence(&self, way: &Vector3<f64>) -> f64 {
        (way.norm() / LEAST_WAY).min(way.norm_squared() / (GATE * self.spread(FAST)))
    }

    /// Evidence that the shear force shakes.
    fn shake(&mut self, reading: &Touched, dt: f64, moves: bool) -> f64 {
        let Some(force) = reading.force else { return 0.0 };
        let before = self.shear;
        let Some(single) = self.shear.take(force, &reading.normal, NOISE, dt) else { return 0.0 };
        let resolved = self.period > 0.0 && SHAKE / self.period >= SHAKE_READINGS;
        let known = before.readings >= SHAKE_READINGS && seconds(self.begun, self.at) >= SETTLE;
        let single = if known { single.min(CLIP * before.variance) } else { single };
        self.shaken += weight(dt, SHAKE).max(1.0 / self.shear.readings) * (single - self.shaken);
        let evidence =
            if resolved && known { self.shaken / (SHAKEN * before.variance.max(1e-12)) } else { 0.0 };
        // What shakes more than half of what would be a slide does not tell how a contact scatters that sticks.
        if known && (evidence > 0.5 || moves || self.state == Slip::Gross) {
            self.shear = Scatter { last: self.shear.last, ..before };
        }
        evidence
    }

    fn decide(&mut self, gross: f64, incipient: f64, sheared: bool) {
        let holds = seconds(self.seen, self.at) < HOLD;
        let next = if gross > 1.0 {
            Some((Slip::Gross, gross))
        } else if self.state == Slip::Gross && holds {
            None
        } else if incipient > 1.0 {
            Some((Slip::Incipient, incipient))
        } else if self.state == Slip::Incipient && holds {
            None
        } else if sheared && seconds(self.begun, self.at) >= SETTLE {
            Some((Slip::None, gross.max(incipient)))
        } else {
            Some((Slip::Unknown, 0.0))
        };
        if let Some((state, evidence)) = next {
            (self.state, self.evidence, self.seen) = (state, evidence, self.at);
        }
    }
}

/// The part of a force along the surface, and its size across it \[N\], positive where it presses.
fn shear(force: &Vector3<f64>, normal: &Vector3<f64>) -> (Vector3<f64>, f64) {
    let across = force.dot(normal);
    (force - normal * across, -across)
}

#[cfg(test)]
mod tests;
