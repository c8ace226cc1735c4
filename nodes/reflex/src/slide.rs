//! How fast the contacts of a skin slide, from their positions.
//!
//! Messages of one skin give positions and no velocities. The speed of a contact is the way of its position along the surface over
//! a window of time, divided by that time. The noise of the speed is that of two positions over the window: with 0.5 mm and 50 ms,
//! 14 mm/s. A contact that is younger than one window has the speed 0.

use dermis_msgs::msg::{Contact, ContactArray};

/// \[ns\] Shortest time that a speed is computed over.
const WINDOW: i64 = 50_000_000;

struct Track {
    id: u32,
    stamp: i64,
    position: [f64; 3],
    speed: f64,
}

/// Contacts of one skin, by their ids.
#[derive(Default)]
pub(crate) struct Slides {
    tracks: Vec<Track>,
    /// \[m/s\] of each contact of the latest message; NaN where it has no position.
    pub(crate) speeds: Vec<f64>,
}

impl Slides {
    /// Takes a message.
    pub(crate) fn take(&mut self, message: &ContactArray) {
        let stamp = message.header.stamp.as_nanos();
        let known = std::mem::take(&mut self.tracks);
        self.speeds.clear();
        for contact in &message.contacts {
            let position = [contact.position.x, contact.position.y, contact.position.z];
            let track = match known.iter().find(|track| track.id == contact.track_id) {
                Some(track) => track.moved(stamp, position, contact),
                None => Track { id: contact.track_id, stamp, position, speed: 0.0 },
            };
            let known_place = position.iter().all(|v| v.is_finite());
            self.speeds.push(if known_place { track.speed } else { f64::NAN });
            self.tracks.push(track);
        }
    }
}

impl Track {
    fn moved(&self, stamp: i64, position: [f64; 3], contact: &Contact) -> Self {
        let elapsed = stamp.saturating_sub(self.stamp);
        // A device that starts again has stamps of before.
        if elapsed < 0 {
            return Self { id: self.id, stamp, position, speed: 0.0 };
        }
        if elapsed < WINDOW {
            return Self { id: self.id, stamp: self.stamp, position: self.position, speed: self.speed };
        }
        let way = [0, 1, 2].map(|i| position[i] - self.position[i]);
        let speed = along_surface(way, contact) / (elapsed as f64 * 1e-9);
        Self { id: self.id, stamp, position, speed }
    }
}

/// Length of the part of a vector that is not along the contact's normal; of all of it where the normal is unknown.
pub(crate) fn along_surface(vector: [f64; 3], contact: &Contact) -> f64 {
    let normal = [contact.normal.x, contact.normal.y, contact.normal.z];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let square = dot(normal, normal);
    let along = if square > 0.5 && square < 2.0 { dot(vector, normal).powi(2) / square } else { 0.0 };
    // Of rounding, the difference may be a little below zero; a NaN stays one.
    let rest = dot(vector, vector) - along;
    if rest < 0.0 { 0.0 } else { rest.sqrt() }
}

#[cfg(test)]
mod tests {
    use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
    use dermis_msgs::std_msgs::msg::Header;

    use super::*;

    fn at(ms: i64, x: f64, z: f64) -> ContactArray {
        let contact = Contact {
            track_id: 3,
            position: Point { x, y: 0.0, z },
            normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
            ..Contact::default()
        };
        ContactArray {
            header: Header::new(ms * 1_000_000, "palm"),
            contacts: vec![contact],
            ..ContactArray::default()
        }
    }

    #[test]
    fn the_speed_is_that_along_the_surface() {
        let mut slides = Slides::default();
        let mut seen = Vec::new();
        for ms in 0..=200 {
            // 30 mm/s along the surface, 100 mm/s into it.
            slides.take(&at(ms, 0.03e-3 * ms as f64, -0.1e-3 * ms as f64));
            seen.push(slides.speeds[0]);
        }
        assert!(seen[..50].iter().all(|speed| *speed == 0.0), "younger than a window");
        assert!(seen[50..].iter().all(|speed| (speed - 0.03).abs() < 1e-9), "{seen:?}");
    }

    #[test]
    fn what_is_not_known_is_not_zero() {
        let mut slides = Slides::default();
        slides.take(&at(0, f64::NAN, 0.0));
        assert!(slides.speeds[0].is_nan());
        slides.take(&at(100, 0.0, 0.0));
        assert!(slides.speeds[0].is_nan(), "it has come from nowhere");
        slides.take(&at(200, 0.0, 0.0));
        assert_eq!(slides.speeds, [0.0]);
        slides.take(&ContactArray::default());
        assert!(slides.speeds.is_empty() && slides.tracks.is_empty());
    }

    #[test]
    fn stamps_that_jump_back_begin_anew() {
        let mut slides = Slides::default();
        slides.take(&at(1000, 0.0, 0.0));
        slides.take(&at(0, 1.0, 0.0));
        assert_eq!(slides.speeds, [0.0]);
    }
}
