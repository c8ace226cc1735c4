//! From the model's numbers to contacts, and which contact is which from frame to frame.

use dermis_skin::{Contact, Frame, SkinDescription, Stamp};
use nalgebra::Point3;

/// A taxel belongs to a contact if it carries at least this share of the strongest taxel's amplitude.
const TAXEL_SHARE: f64 = 0.2;
/// \[s\] for which a contact may vanish and still be the same, at least.
const HOLD: f64 = 0.1;
/// Periods of the skin for which it may, at least: slow devices have gaps of single frames, too.
const HOLD_FRAMES: f64 = 2.5;
/// \[m\] that a contact may jump between frames and still be the same, at least.
const LEAST_GATE: f64 = 0.005;

/// Which taxels carry a signal.
#[derive(Debug, Clone)]
pub struct TaxelShares {
    taxel_of: Vec<usize>,
    noise: Vec<f64>,
    amplitude: Vec<f64>,
    positions: Vec<Point3<f64>>,
}

impl TaxelShares {
    /// For one skin.
    #[must_use]
    pub fn new(skin: &SkinDescription) -> Self {
        Self {
            taxel_of: skin.channel_taxels(),
            noise: skin.channel_noise(),
            amplitude: vec![0.0; skin.taxels.len()],
            positions: skin.taxels.iter().map(dermis_skin::Taxel::point).collect(),
        }
    }

    /// Indices of the taxels that are nearest to a place, of several contacts that each have their own: those within
    /// half as far again as the nearest.
    #[must_use]
    pub fn near(&self, place: &Point3<f64>) -> Vec<u32> {
        let mut by_distance: Vec<(f64, u32)> =
            self.positions.iter().zip(0..).map(|(p, i)| ((p - place).norm(), i)).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0));
        let reach = by_distance.first().map_or(0.0, |(d, _)| d * 1.5);
        by_distance.into_iter().take_while(|(d, _)| *d <= reach).map(|(_, i)| i).collect()
    }

    /// Indices of the taxels that stand out of `floor` noise deviations and carry a share of the strongest
    /// one's amplitude, strongest first. `signal` is a frame less its zero.
    pub fn of(&mut self, signal: &Frame, floor: f64) -> Vec<u32> {
        self.amplitude.fill(0.0);
        for ((value, taxel), noise) in signal.values.iter().zip(&self.taxel_of).zip(&self.noise) {
            let z = f64::from(*value) / noise;
            if z.is_finite() {
                self.amplitude[*taxel] += z * z;
            }
        }
        for a in &mut self.amplitude {
            *a = a.sqrt();
        }
        let strongest = self.amplitude.iter().copied().fold(0.0, f64::max);
        let least = (TAXEL_SHARE * strongest).max(floor);
        let mut carrying: Vec<u32> = (0..self.amplitude.len())
            .filter(|i| self.amplitude[*i] >= least)
            .filter_map(|i| u32::try_from(i).ok())
            .collect();
        carrying.sort_by(|a, b| self.amplitude[*b as usize].total_cmp(&self.amplitude[*a as usize]));
        carrying
    }
}

/// Gives contacts an identity that lasts as long as they do.
///
/// Nearest pairs within a gate are the same contact. A contact that was gone for longer than 0.1 s, and than two frames, is a
/// new one.
#[derive(Debug, Clone)]
pub struct Tracker {
    gate: f64,
    hold: f64,
    next: u32,
    tracks: Vec<Track>,
}

#[derive(Debug, Clone)]
struct Track {
    id: u32,
    position: Point3<f64>,
    seen: Stamp,
}

impl Tracker {
    /// For one skin: the gate is twice the distance of neighbouring taxels, but at least 5 mm.
    #[must_use]
    pub fn new(skin: &SkinDescription) -> Self {
        let points: Vec<Point3<f64>> = skin.taxels.iter().map(dermis_skin::Taxel::point).collect();
        let mut nearest: Vec<f64> = points
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let others = points.iter().enumerate().filter(|(j, _)| *j != i);
                others.map(|(_, q)| (p - q).norm()).fold(f64::INFINITY, f64::min)
            })
            .collect();
        nearest.sort_by(f64::total_cmp);
        // With one taxel there is no spacing, and one contact at most.
        let spacing = nearest.get(nearest.len() / 2).copied().unwrap_or(f64::INFINITY);
        Self {
            gate: (2.0 * spacing).max(LEAST_GATE),
            hold: HOLD.max(HOLD_FRAMES / skin.rate),
            next: 1,
            tracks: Vec::new(),
        }
    }

    /// Writes the identity of each contact of the frame acquired at `stamp`.
    pub fn assign(&mut self, contacts: &mut [Contact], stamp: Stamp) {
        // Backwards in time is another recording.
        self.tracks.retain(|t| {
            let gone = stamp.saturating_sub(t.seen) as f64 * 1e-9;
            (0.0..=self.hold).contains(&gone)
        });
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (c, contact) in contacts.iter().enumerate() {
            for (t, track) in self.tracks.iter().enumerate() {
                let distance = (contact.position - track.position).norm();
                // Without a position there is one contact at most, and nothing to tell it by.
                let distance = if distance.is_nan() { 0.0 } else { distance };
                if distance <= self.gate {
                    pairs.push((distance, c, t));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut of_contact: Vec<Option<usize>> = vec![None; contacts.len()];
        let mut taken = vec![false; self.tracks.len()];
        for (_, c, t) in pairs {
            if of_contact[c].is_none() && !taken[t] {
                of_contact[c] = Some(t);
                taken[t] = true;
            }
        }
        for (contact, track) in contacts.iter_mut().zip(of_contact) {
            let track = track.unwrap_or_else(|| {
                let id = self.next;
                self.next = self.next.checked_add(1).unwrap_or(1);
                self.tracks.push(Track { id, position: contact.position, seen: stamp });
                self.tracks.len() - 1
            });
            let track = &mut self.tracks[track];
            track.position = contact.position;
            track.seen = stamp;
            contact.track_id = track.id;
        }
    }

    /// Forgets every contact and starts to count from 1.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.next = 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::skin_with;
    use nalgebra::Vector3;

    fn contact(x_mm: f64, y_mm: f64) -> Contact {
        Contact::at(Point3::new(x_mm * 1e-3, y_mm * 1e-3, 0.0), Vector3::z())
    }

    fn ids(tracker: &mut Tracker, at_ms: i64, mut contacts: Vec<Contact>) -> Vec<u32> {
        tracker.assign(&mut contacts, at_ms * 1_000_000);
        contacts.iter().map(|c| c.track_id).collect()
    }

    #[test]
    fn an_identity_lasts_as_long_as_the_contact() {
        let mut tracker = Tracker::new(&skin_with(""));
        for k in 0..100 {
            // Slides over the pad.
            assert_eq!(ids(&mut tracker, k * 10, vec![contact(k as f64 * 0.1, 0.0)]), [1]);
        }
        assert_eq!(ids(&mut tracker, 1050, vec![]), [0; 0]);
        assert_eq!(ids(&mut tracker, 1060, vec![contact(9.9, 0.0)]), [1], "a flicker is no new contact");
        assert_eq!(ids(&mut tracker, 1300, vec![contact(9.9, 0.0)]), [2], "a gap ends a contact");
    }

    #[test]
    fn a_slow_device_keeps_identities_from_frame_to_frame() {
        let mut tracker = Tracker::new(&skin_with("rate = 10.0"));
        assert_eq!(ids(&mut tracker, 0, vec![contact(0.0, 0.0)]), [1]);
        assert_eq!(ids(&mut tracker, 103, vec![contact(0.1, 0.0)]), [1]);
        assert_eq!(ids(&mut tracker, 305, vec![contact(0.2, 0.0)]), [1], "one frame was lost");
        assert_eq!(ids(&mut tracker, 700, vec![contact(0.2, 0.0)]), [2]);
    }

    #[test]
    fn two_contacts_keep_their_identities_whatever_their_order() {
        let mut tracker = Tracker::new(&skin_with(""));
        assert_eq!(ids(&mut tracker, 0, vec![contact(-8.0, 0.0), contact(8.0, 0.0)]), [1, 2]);
        assert_eq!(ids(&mut tracker, 10, vec![contact(7.0, 0.0), contact(-7.0, 0.0)]), [2, 1]);
        assert_eq!(ids(&mut tracker, 20, vec![contact(-7.0, 0.0)]), [1]);
        assert_eq!(ids(&mut tracker, 30, vec![contact(-7.0, 0.0), contact(7.0, 0.0)]), [1, 2]);
    }

    #[test]
    fn a_jump_beyond_the_gate_is_another_contact() {
        let mut tracker = Tracker::new(&skin_with(""));
        assert_eq!(ids(&mut tracker, 0, vec![contact(-10.0, -10.0)]), [1]);
        assert_eq!(ids(&mut tracker, 10, vec![contact(10.0, 10.0)]), [2]);
    }

    #[test]
    fn contacts_without_a_position_are_followed_by_presence() {
        let mut tracker = Tracker::new(&skin_with(""));
        assert_eq!(ids(&mut tracker, 0, vec![contact(f64::NAN, 0.0)]), [1]);
        assert_eq!(ids(&mut tracker, 10, vec![contact(f64::NAN, 0.0)]), [1]);
        assert_eq!(ids(&mut tracker, 500, vec![contact(f64::NAN, 0.0)]), [2]);
    }

    #[test]
    fn a_clock_that_jumps_back_starts_over() {
        let mut tracker = Tracker::new(&skin_with(""));
        assert_eq!(ids(&mut tracker, 1000, vec![contact(0.0, 0.0)]), [1]);
        assert_eq!(ids(&mut tracker, 0, vec![contact(0.0, 0.0)]), [2]);
        tracker.reset();
        assert_eq!(ids(&mut tracker, 10, vec![contact(0.0, 0.0)]), [1]);
    }

    #[test]
    fn taxels_that_carry_the_signal_come_strongest_first() {
        let mut shares = TaxelShares::new(&skin_with(""));
        let frame = Frame::new(0, 0, vec![100.0, 1000.0, f32::NAN, 400.0]);
        assert_eq!(shares.of(&frame, 4.0), [1, 3], "a tenth of the strongest is no part of it");
        let quiet = Frame::new(0, 0, vec![10.0, 20.0, -10.0, 0.0]);
        assert_eq!(shares.of(&quiet, 4.0), [0_u32; 0]);
    }
}
