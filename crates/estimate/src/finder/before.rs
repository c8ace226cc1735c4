//! Where the search for the contacts of a frame begins: at those of the frames before.

use dermis_inversion::{ContactEstimate, Inverter, Solution};

/// What is known of the contacts of the frames before.
#[derive(Debug, Clone, Default)]
pub(crate) struct Before {
    /// Those of the latest frame that had any, by the minima that may be true, the likeliest first.
    minima: Vec<Vec<ContactEstimate>>,
    /// The likeliest minimum that the latest search found.
    searched: Vec<ContactEstimate>,
    /// By how much the device differs from its model, as that search says ([`Solution::misfit`]); 0 once noise explains a frame.
    misfit: f64,
    /// Frames since that search.
    frames: u32,
}

/// \[s\] after which pairs are looked for again on a device that seems to differ from its model: a search that missed the right pair leaves as much.
/// What that costs is the row of two contacts on a device that differs of `cargo xtask bench limb`.
const AGAIN: f64 = 0.1;

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

    /// Begins anew at what a search found.
    pub(crate) fn search(&mut self, inverter: &Inverter, found: &Solution) {
        self.minima.clear();
        (self.misfit, self.frames) = (found.misfit, 0);
        self.follow(inverter, found);
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
        self.frames = self.frames.saturating_add(1);
        // One frame in hundreds leaves more by chance, and would make up for contacts that come and go.
        if found.misfit <= 0.0 {
            self.misfit = 0.0;
        }
    }

    /// Whether other contacts may explain the readings by now, although these do; `rate` \[Hz\] of frames. Several that leave no more than noise
    /// are all that there are. One may be in another minimum, and so may any on a device that differs from its model, once they have moved.
    pub(crate) fn may_have_changed(&self, inverter: &Inverter, rate: f64) -> bool {
        let settings = inverter.settings();
        if self.misfit <= 0.0 && !settings.is_single() {
            return false;
        }
        settings.in_pairs() && f64::from(self.frames) > AGAIN * rate
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

    const RATE: f64 = 1000.0;

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
        before.search(&inverter, &found(&inverter, 1.0, 0.0));
        assert_eq!((before.likeliest().len(), before.misfit()), (2, 0.0));
        before.follow(&inverter, &found(&inverter, 3.0, 0.0));
        assert!(!before.may_have_changed(&inverter, RATE));
    }

    #[test]
    fn contacts_of_a_device_that_differs_are_looked_for_again() {
        let inverter = inverter(2);
        let differs = found(&inverter, 1.0, 0.3);
        assert!(differs.misfit > 0.0 && differs.contacts.len() == 2, "{differs:?}");
        let mut before = Before::default();
        before.search(&inverter, &differs);
        before.follow(&inverter, &differs);
        assert!(!before.may_have_changed(&inverter, RATE));
        // Once they press harder, and after a while.
        let mut harder = before.clone();
        harder.follow(&inverter, &found(&inverter, 3.0, 0.3));
        assert!(harder.may_have_changed(&inverter, RATE));
        let mut later = before.clone();
        (0..100).for_each(|_| later.follow(&inverter, &differs));
        assert!(later.may_have_changed(&inverter, RATE));
        later.search(&inverter, &differs);
        assert!(!later.may_have_changed(&inverter, RATE));
        // What noise explains does not differ.
        before.follow(&inverter, &found(&inverter, 1.0, 0.0));
        assert_eq!(before.misfit(), 0.0);
    }
}
