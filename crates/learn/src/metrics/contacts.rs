//! Contacts that are read off a map of forces, beside the true ones.
//!
//! Problem: how well does a map tell the number, locations, forces and widths of one to six contacts? Method (thesis section 4.3.2):
//! contacts are the peaks of the map ([`ForcePeakFinder`]); each is held against the true one that the optimal assignment gives it
//! (Kuhn 1955). Number, force and diameter are signed shares of the true ones. Rule: a true contact that no peak stands for counts
//! in number, in [`force_rms`](ContactsRead::force_rms) as a force of 0, and in [`position`](ContactsRead::position) as the distance
//! to the middle of the surface; `…_found` and the shares of force and diameter are of contacts that were found.
//! [`position_nearest`](ContactsRead::position_nearest) is the thesis' own: the distance to the nearest peak, which one peak may be for
//! several. Everything is given for each true number of contacts apart, and for all touched frames together.
//!
//! Assumption: the true diameter is that of the tip. Cost: one pass over the discs of all points a frame and threshold.

use std::collections::BTreeMap;

use dermis_inversion::{ForcePeak, ForcePeakFinder};
use dermis_skin::{Surface, assign};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::median;
use crate::dataset::Truth;
use crate::evaluate::centre;

/// How contacts are read off maps of forces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapReading {
    /// \[m\] diameter of the disc in which a contact is the largest pressure.
    pub disc: f64,
    /// \[N\] that a disc bears at least where it is a contact; everything is reported for each.
    pub thresholds: Vec<f64>,
    /// \[N\] frames in which a true contact presses with less are not compared.
    pub least_force: f64,
}

impl Default for MapReading {
    /// The thesis' disc of 64 mm; its threshold of 5 N and half of it, because its test has loads of 4.905 N.
    fn default() -> Self {
        Self { disc: 0.064, thresholds: vec![5.0, 2.5], least_force: 0.0 }
    }
}

impl MapReading {
    /// The default where a surface is wide enough for it, four discs each way; a smaller skin needs numbers of its own.
    #[must_use]
    pub fn of_surface(surface: &Surface) -> Option<Self> {
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let along = || surface.points.iter().map(|p| p[axis]);
            along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
        });
        let mut extents = [x, y, z];
        extents.sort_by(f64::total_cmp);
        let reading = Self::default();
        (extents[1] >= 4.0 * reading.disc).then_some(reading)
    }

    /// Says what is impossible: field and reason.
    ///
    /// # Errors
    ///
    /// The name of the field, and what it must be.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !(self.disc.is_finite() && self.disc > 0.0) {
            return Err(("disc", format!("is {} m and must be a positive length", self.disc)));
        }
        if self.thresholds.is_empty() {
            return Err(("thresholds", "is empty: name at least one force".into()));
        }
        for (field, force) in
            self.thresholds.iter().map(|t| ("thresholds", *t)).chain([("least_force", self.least_force)])
        {
            if !(force.is_finite() && force >= 0.0) {
                return Err((field, format!("has {force} N and must be 0 or positive")));
            }
        }
        Ok(())
    }
}

/// Distribution of one error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean, with its sign.
    pub mean: f64,
    /// Standard deviation around it.
    pub deviation: f64,
    /// Median magnitude.
    pub median: f64,
    /// Root mean square.
    pub rms: f64,
}

impl Spread {
    fn of(values: &[f64]) -> Option<Self> {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let square = values.iter().map(|v| v * v).sum::<f64>() / count;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt();
        let mut magnitudes: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        (!values.is_empty()).then(|| Self {
            mean,
            deviation,
            median: median(&mut magnitudes),
            rms: square.sqrt(),
        })
    }
}

/// Contacts of maps of one threshold beside the true ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapContacts {
    /// \[m\] diameter of the discs.
    pub disc: f64,
    /// \[N\] that a disc bears at least.
    pub threshold: f64,
    /// Share of touched frames that were not compared, because a true contact presses with less than
    /// [`MapReading::least_force`]; absent where that is 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<f64>,
    /// Of all touched frames.
    pub all: ContactsRead,
    /// By true number of contacts.
    pub by_number: BTreeMap<usize, ContactsRead>,
    /// Contacts a frame that were read off maps of an untouched skin; absent without such frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub untouched: Option<f64>,
}

/// Contacts of some maps beside the true ones; shares are of the true value, with their sign.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ContactsRead {
    /// Frames that were compared.
    pub frames: usize,
    /// True contacts in them.
    pub contacts: usize,
    /// Of these, such as a peak stands for.
    pub found: usize,
    /// Share of frames whose number of contacts is right.
    pub number_right: f64,
    /// Error of the number, frame by frame, as a share of the true one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<Spread>,
    /// \[m\] distance of every true contact to what was found for it; see the module for those that were not found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<Spread>,
    /// \[m\] the same of contacts that were found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_found: Option<Spread>,
    /// \[m\] distance of every true contact to the nearest peak, in frames with any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_nearest: Option<Spread>,
    /// \[N\] root mean square error of the force of every true contact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_rms: Option<f64>,
    /// Error of the force of contacts that were found, as a share of the true one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<Spread>,
    /// Error of the full width at half maximum of contacts that were found, as a share of the tip's diameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter: Option<Spread>,
}

/// Errors of some frames.
#[derive(Debug, Clone, Default)]
struct Errors {
    right: usize,
    number: Vec<f64>,
    position: Vec<f64>,
    position_found: Vec<f64>,
    position_nearest: Vec<f64>,
    newtons: Vec<f64>,
    force: Vec<f64>,
    diameter: Vec<f64>,
}

impl Errors {
    fn push(&mut self, truth: &Truth, peaks: &[ForcePeak], centre: Option<&Point3<f64>>) {
        let contacts = &truth.contacts;
        self.right += usize::from(peaks.len() == contacts.len());
        self.number.push(peaks.len() as f64 / contacts.len() as f64 - 1.0);
        let distance = |t: usize, f: usize| (peaks[f].position - contacts[t].position).norm();
        let assigned = assign(contacts.len(), peaks.len(), distance);
        for (t, (contact, peak)) in contacts.iter().zip(assigned).enumerate() {
            let true_force = contact.normal_force().unwrap_or(f64::NAN);
            let nearest = (0..peaks.len()).map(|f| distance(t, f)).min_by(f64::total_cmp);
            self.position_nearest.extend(nearest);
            let Some(f) = peak else {
                self.position.extend(centre.map(|c| (contact.position - c).norm()));
                self.newtons.push(-true_force);
                continue;
            };
            self.position.push(distance(t, f));
            self.position_found.push(distance(t, f));
            self.newtons.push(peaks[f].force - true_force);
            self.force.extend((true_force > 0.0).then(|| peaks[f].force / true_force - 1.0));
            self.diameter
                .extend((contact.diameter > 0.0).then(|| peaks[f].diameter / contact.diameter - 1.0));
        }
    }

    fn extend(&mut self, other: &Self) {
        self.right += other.right;
        for (own, others) in [
            (&mut self.number, &other.number),
            (&mut self.position, &other.position),
            (&mut self.position_found, &other.position_found),
            (&mut self.position_nearest, &other.position_nearest),
            (&mut self.newtons, &other.newtons),
            (&mut self.force, &other.force),
            (&mut self.diameter, &other.diameter),
        ] {
            own.extend_from_slice(others);
        }
    }

    fn read(&self) -> ContactsRead {
        let frames = self.number.len();
        ContactsRead {
            frames,
            contacts: self.newtons.len(),
            found: self.position_found.len(),
            number_right: self.right as f64 / frames.max(1) as f64,
            number: Spread::of(&self.number),
            position: Spread::of(&self.position),
            position_found: Spread::of(&self.position_found),
            position_nearest: Spread::of(&self.position_nearest),
            force_rms: Spread::of(&self.newtons).map(|s| s.rms),
            force: Spread::of(&self.force),
            diameter: Spread::of(&self.diameter),
        }
    }
}

/// Compares the contacts that maps of forces show with the true ones, map by map.
///
/// ```
/// use dermis_learn::{ContactsOfMaps, MapReading};
/// # use dermis_skin::{Surface, SurfaceSpec};
/// let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.5, 0.5], spacing: 0.02 });
/// let maps = ContactsOfMaps::new(&surface, MapReading::default());
/// let [thesis, ours] = &maps.finish()[..] else { panic!("one for each threshold") };
/// assert_eq!((thesis.threshold, ours.threshold), (5.0, 2.5));
/// ```
#[derive(Debug, Clone)]
pub struct ContactsOfMaps {
    reading: MapReading,
    finder: ForcePeakFinder,
    centre: Option<Point3<f64>>,
    /// For each threshold, by true number of contacts.
    errors: Vec<BTreeMap<usize, Errors>>,
    /// Peaks of untouched frames, for each threshold.
    wrong: Vec<usize>,
    untouched: usize,
    left_out: usize,
}

impl ContactsOfMaps {
    /// Nothing yet of maps over this surface.
    #[must_use]
    pub fn new(surface: &Surface, reading: MapReading) -> Self {
        Self {
            finder: ForcePeakFinder::new(surface, reading.disc),
            centre: centre(surface),
            errors: vec![BTreeMap::new(); reading.thresholds.len()],
            wrong: vec![0; reading.thresholds.len()],
            untouched: 0,
            left_out: 0,
            reading,
        }
    }

    /// Compares a map of pressing forces \[N\], one a point, with the contacts that are true. Maps of another surface are left out, and
    /// so are frames in which the force of a contact is not known.
    pub fn push(&mut self, truth: &Truth, map: &[f64]) {
        let forces: Option<Vec<f64>> = truth.contacts.iter().map(crate::TruthContact::normal_force).collect();
        let Some(forces) = forces.filter(|_| map.len() == self.finder.points()) else { return };
        if forces.iter().any(|force| *force < self.reading.least_force) {
            self.left_out += 1;
            return;
        }
        self.untouched += usize::from(!truth.touched());
        for (i, threshold) in self.reading.thresholds.iter().enumerate() {
            let peaks = self.finder.find(map, *threshold);
            if truth.touched() {
                let of_number = self.errors[i].entry(truth.contacts.len()).or_default();
                of_number.push(truth, &peaks, self.centre.as_ref());
            } else {
                self.wrong[i] += peaks.len();
            }
        }
    }

    /// Sums up, for each threshold.
    #[must_use]
    pub fn finish(&self) -> Vec<MapContacts> {
        let of = |(i, errors): (usize, &BTreeMap<usize, Errors>)| {
            let mut all = Errors::default();
            errors.values().for_each(|one| all.extend(one));
            let share = self.left_out as f64 / (self.left_out + all.number.len()).max(1) as f64;
            MapContacts {
                disc: self.reading.disc,
                threshold: self.reading.thresholds[i],
                left_out: (self.reading.least_force > 0.0).then_some(share),
                all: all.read(),
                by_number: errors.iter().map(|(number, one)| (*number, one.read())).collect(),
                untouched: (self.untouched > 0).then(|| self.wrong[i] as f64 / self.untouched as f64),
            }
        };
        self.errors.iter().enumerate().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;
    use crate::dataset::tests::contact;

    fn panel() -> Surface {
        Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.54, 0.56], spacing: 0.01 })
    }

    fn truth(contacts: &[(f64, f64, f64)]) -> Truth {
        let contacts =
            contacts.iter().map(|(x, y, f)| crate::TruthContact { diameter: 0.02, ..contact(*x, *y, *f) });
        let contacts: Vec<_> = contacts.collect();
        Truth { press: 0, location: 0, idle: contacts.is_empty(), contacts }
    }

    /// A map with each force on the point nearest to its place and those beside it.
    fn map(surface: &Surface, contacts: &[(f64, f64, f64)]) -> Vec<f64> {
        let mut map = vec![0.0; surface.points.len()];
        for (x, y, force) in contacts {
            let near: Vec<usize> = (0..map.len())
                .filter(|i| (surface.points[*i].x - x).hypot(surface.points[*i].y - y) < 0.0101)
                .collect();
            near.iter().for_each(|i| map[*i] += force / near.len() as f64);
        }
        map
    }

    #[test]
    fn the_true_map_has_the_true_contacts() {
        let surface = panel();
        let mut scores = ContactsOfMaps::new(&surface, MapReading::default());
        let six = [(-0.2, -0.2), (0.2, -0.2), (-0.2, 0.2), (0.2, 0.2), (0.0, 0.0), (0.1, 0.0)];
        let six: Vec<_> =
            six.iter().zip([40.0, 30.0, 20.0, 10.0, 8.0, 6.0]).map(|((x, y), f)| (*x, *y, f)).collect();
        for number in 1..=6 {
            scores.push(&truth(&six[..number]), &map(&surface, &six[..number]));
        }
        scores.push(&truth(&[]), &map(&surface, &[]));
        for of in scores.finish() {
            assert_eq!(of.by_number.keys().copied().collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6]);
            let ContactsRead { frames, contacts, found, number_right, .. } = of.all;
            assert_eq!((frames, contacts, found, number_right), (6, 21, 21, 1.0));
            assert_eq!(of.untouched, Some(0.0));
            let largest = |spread: Option<Spread>| spread.map_or(f64::NAN, |s| s.rms);
            assert!(largest(of.all.position) < 1e-9 && largest(of.all.position_nearest) < 1e-9);
            assert!(largest(of.all.force) < 1e-9 && of.all.force_rms.is_some_and(|f| f < 1e-9));
            // Five points of 1 cm² are a circle of 25.2 mm.
            let wide = 2.0 * (5e-4_f64 / std::f64::consts::PI).sqrt() / 0.02 - 1.0;
            let diameter = of.all.diameter.unwrap();
            assert!((diameter.mean - wide).abs() < 1e-9 && diameter.deviation < 1e-9, "{diameter:?}");
        }
    }

    #[test]
    fn what_is_missed_counts_and_what_is_too_much_counts_in_number() {
        let surface = panel();
        let mut scores = ContactsOfMaps::new(&surface, MapReading::default());
        // The second is below 5 N in the map, a third is not there, and the first is 20 mm off and a quarter too strong.
        let true_ones = [(0.1, 0.0, 16.0), (-0.1, 0.0, 10.0)];
        let given = [(0.12, 0.0, 20.0), (-0.1, 0.0, 4.0), (0.0, 0.2, 3.0)];
        scores.push(&truth(&true_ones), &map(&surface, &given));
        let found = scores.finish();
        let [thesis, ours] = &found[..] else { panic!("{found:?}") };
        let of = &thesis.by_number[&2];
        assert_eq!((of.contacts, of.found, of.number_right), (2, 1, 0.0));
        assert_eq!(of.number.unwrap().mean, -0.5);
        let close = |a: f64, b: f64| approx::assert_relative_eq!(a, b, max_relative = 1e-9);
        close(of.position_found.unwrap().mean, 0.02);
        close(of.position.unwrap().mean, (0.02 + 0.1) / 2.0);
        // The nearest peak to the second contact is the first one's.
        close(of.position_nearest.unwrap().mean, (0.02 + 0.22) / 2.0);
        close(of.force.unwrap().mean, 0.25);
        close(of.force_rms.unwrap(), ((4.0_f64.powi(2) + 10.0_f64.powi(2)) / 2.0).sqrt());
        let of = &ours.by_number[&2];
        assert_eq!((of.found, of.number.unwrap().mean), (2, 0.5));
        close(of.position.unwrap().mean, 0.01);
        close(of.force.unwrap().mean, (0.25 - 0.6) / 2.0);
        assert_eq!(&ours.all, of);
        let text = serde_json::to_string(&found).unwrap();
        let again: Vec<MapContacts> = serde_json::from_str(&text).unwrap();
        assert_eq!((again.len(), again[0].all.found, again[1].all.found), (2, 1, 2));
        close(again[1].all.position.unwrap().mean, 0.01);
    }

    #[test]
    fn light_frames_are_left_out_only_on_request() {
        let surface = panel();
        let light = truth(&[(0.1, 0.0, 16.0), (-0.1, 0.0, 4.0)]);
        let clear = truth(&[(0.1, 0.0, 16.0), (-0.1, 0.0, 4.905)]);
        let of = |least_force: f64| {
            let reading = MapReading { least_force, ..MapReading::default() };
            let mut scores = ContactsOfMaps::new(&surface, reading);
            for truth in [&light, &clear, &clear] {
                scores.push(truth, &vec![0.0; surface.points.len()]);
            }
            let first = scores.finish().swap_remove(0);
            (first.all.frames, first.left_out)
        };
        assert_eq!(of(0.0), (3, None));
        assert_eq!(of(4.9), (2, Some(1.0 / 3.0)));
    }

    #[test]
    fn wide_skins_are_read_and_impossible_numbers_refused() {
        assert!(MapReading::of_surface(&panel()).is_some());
        let pad = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.6, 0.05], spacing: 0.01 });
        assert_eq!(MapReading::of_surface(&pad), None);
        let refused = |change: &dyn Fn(&mut MapReading)| {
            let mut reading = MapReading::default();
            change(&mut reading);
            let (field, reason) = reading.check().unwrap_err();
            format!("{field} {reason}")
        };
        insta::assert_snapshot!(refused(&|r| r.disc = -1.0), @"disc is -1 m and must be a positive length");
        insta::assert_snapshot!(refused(&|r| r.thresholds = vec![5.0, f64::NAN]), @"thresholds has NaN N and must be 0 or positive");
        insta::assert_snapshot!(refused(&|r| r.thresholds.clear()), @"thresholds is empty: name at least one force");
        insta::assert_snapshot!(refused(&|r| r.least_force = -1.0), @"least_force has -1 N and must be 0 or positive");
    }
}
