//! Where the search for the contacts of a frame begins: at those of the frames before.

use dermis_inversion::{ContactEstimate, Inverter, Solution};
use dermis_skin::Stamp;

/// What is known of the contacts of the frames before.
#[derive(Debug, Clone, Default)]
pub(crate) struct Before {
    /// Those of the latest frame that had any, by the minima that may be true, the likeliest first.
    minima: Vec<Vec<ContactEstimate>>,
    /// The likeliest minimum that the latest search found.
    searched: Vec<ContactEstimate>,
    /// By how much the device differs from its model, as that search says ([`Solution::misfit`]); 0 once noise explains a frame.
    misfit: f64,
    /// Stamp of the frame at which that search was answered.
    stamp: Stamp,
    /// The same of the first of the searches that have found these contacts, one after the other.
    since: Stamp,
}

/// \[ns\] after which pairs are looked for again at the latest on a device that seems to differ from its model: a search that missed the right pair
/// leaves as much. What that costs is the row of two contacts on a device that differs of `cargo xtask bench limb`.
const AGAIN: u64 = 100_000_000;

impl Before {
    pub(crate) fn minima(&self) -> &[Vec<ContactEstimate>] {
        &self.minima
    }

    /// The contacts of the likeliest of the minima.
    pub(crate) fn likeliest(&self) -> &[ContactEstimate] {
        self.minima.first().map_or(&[], Vec::as_slice)
    }

    pub(crate) fn misfit(&self) -> f64 {
        self.misfit
    }

    /// Begins anew at what a search found, from the frame of this stamp on.
    pub(crate) fn search(&mut self, inverter: &Inverter, found: &Solution, stamp: Stamp) {
        self.minima.clear();
        (self.misfit, self.stamp) = (found.misfit, stamp);
        self.follow(inverter, found);
        if inverter.has_moved(&self.searched, &self.minima) {
            self.since = stamp;
        }
        self.searched = self.likeliest().to_vec();
    }

    /// Goes on with what was found near the contacts before. Where minima were not looked for, that is where the next frame begins, unless it
    /// is a guess at a single contact.
    pub(crate) fn follow(&mut self, inverter: &Inverter, found: &Solution) {
        if !found.minima.is_empty() || found.contacts.is_empty() {
            self.minima.clone_from(&found.minima);
        } else if !inverter.settings().is_single() {
            self.minima = vec![found.contacts.clone()];
        }
        // One frame in hundreds leaves more by chance, and would make up for contacts that come and go.
        if found.misfit <= 0.0 {
            self.misfit = 0.0;
        }
    }

    /// Whether other contacts may explain the readings of the frame of this stamp, although these do. Several that leave no more than noise
    /// are all that there are. One may be in another minimum, and so may any on a device that differs from its model, once they have moved. There,
    /// pairs are looked for again whenever the time for which searches have found the same has doubled, too.
    pub(crate) fn may_have_changed(&self, inverter: &Inverter, stamp: Stamp) -> bool {
        let settings = inverter.settings();
        if self.misfit <= 0.0 && !settings.is_single() {
            return false;
        }
        let same = self.stamp.abs_diff(self.since);
        settings.in_pairs() && stamp.abs_diff(self.stamp) >= same.min(AGAIN)
            || inverter.has_moved(&self.searched, &self.minima)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dermis_inversion::{Reading, Search, Settings};
    use dermis_model::Indentation;
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::testing::{membrane, nine};

    const MS: Stamp = 1_000_000;

    fn inverter(contacts: usize) -> Inverter {
        let mut settings = Settings::new(0.004, 5.0);
        (settings.contacts, settings.distance, settings.search) = (contacts, 0.006, Search::Pairs);
        Inverter::new(Arc::new(membrane(&nine())), settings).unwrap()
    }

    /// What a search of `inverter` finds of two presses, of so many newtons the second, on a device whose gains are so far from its model's.
    fn found(inverter: &Inverter, force: f64, gains: f64) -> Solution {
        let press = |x: f64, y: f64, force: f64| {
            Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
        };
        let signal = membrane(&nine()).read(&[press(-0.007, -0.006, 1.0), press(0.006, 0.007, force)]);
        let differing = |(i, v): (usize, &f64)| Reading::Exact(v * (1.0 + gains * (i as f64 * 2.4).sin()));
        let readings: Vec<Reading> = signal.iter().enumerate().map(differing).collect();
        inverter.search(&readings).unwrap()
    }

    #[test]
    fn several_contacts_that_noise_explains_are_all_that_there_are() {
        let inverter = inverter(2);
        let mut before = Before::default();
        before.search(&inverter, &found(&inverter, 1.0, 0.0), 0);
        assert_eq!((before.likeliest().len(), before.misfit()), (2, 0.0));
        before.follow(&inverter, &found(&inverter, 3.0, 0.0));
        assert!(!before.may_have_changed(&inverter, MS));
    }

    #[test]
    fn contacts_of_a_device_that_differs_are_looked_for_again() {
        let inverter = inverter(2);
        let differs = found(&inverter, 1.0, 0.3);
        assert!(differs.misfit > 0.0 && differs.contacts.len() == 2, "{differs:?}");
        let mut before = Before::default();
        let mut again_from = |searched: Stamp, from: Stamp| {
            before.search(&inverter, &differs, searched * MS);
            before.follow(&inverter, &differs);
            assert!(from <= searched || !before.may_have_changed(&inverter, (from - 1) * MS));
            assert!(before.may_have_changed(&inverter, from * MS));
        };
        // At once, and whenever the time for which the same is found has doubled, up to a longest one.
        again_from(3, 3);
        again_from(13, 23);
        again_from(23, 43);
        again_from(303, 403);
        // At once where they press harder.
        let mut harder = before.clone();
        harder.follow(&inverter, &found(&inverter, 3.0, 0.3));
        assert!(harder.may_have_changed(&inverter, 304 * MS));
        assert!(!before.may_have_changed(&inverter, 304 * MS));
        // What noise explains does not differ.
        before.follow(&inverter, &found(&inverter, 1.0, 0.0));
        assert_eq!(before.misfit(), 0.0);
    }
}
