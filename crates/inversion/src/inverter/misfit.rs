//! How far a device differs from its model, as one frame says, and how many contacts its readings are worth then.
//!
//! Problem: a device that differs from its model by some percent of its signals leaves many times what noise does. Each contact more explains
//! some of that, whether it is there or not, so that one touch is answered by as many contacts as are looked for. Method: the readings have
//! an error in proportion to themselves besides their noise; the one that makes what the most contacts leave as much as can be expected is
//! the frame's (R. C. Paule and J. Mandel, *J. Res. Natl. Bur. Stand.* 87 (1982) 377), and a contact must lower the squares by
//! [`Settings::evidence`](crate::Settings::evidence) in units of noise and error together, as in Mallows' C_p (C. L. Mallows,
//! *Technometrics* 15 (1973) 661). Assumptions: errors are independent from channel to channel, and the most contacts that were looked for
//! are all that there are. Where noise may explain what these leave, nothing changes. Cost: some sums over the channels.

use std::convert::Infallible;

use super::{Inverter, counted, within};
use crate::calibrate::model_error;
use crate::fit::{Datum, Minimum};

/// Factor by which what a device differs by may have grown before contacts are looked for anew: that of the force at which they are in any
/// case ([`Inverter::has_moved`]). The device that differs of `cargo xtask bench limb` says what following saves.
pub(super) const GROWN: f64 = 2.0;
/// Deviations of its expectation from which on a sum of squared deviations is no longer noise: of χ² with four degrees of freedom, one in
/// 250 is beyond, with twenty, one in 1,000. Fewer of them cost light contacts beside strong ones where a device is like its model.
const DIFFERS: f64 = 4.0;

impl Inverter {
    /// Error of the model, as share of a signal, with which noise explains what a minimum leaves; 0 where noise does so alone.
    pub(super) fn misfit(&self, minimum: &Minimum, data: &[Datum]) -> f64 {
        let freedom = counted(data).saturating_sub(self.settings.unknowns.count() * minimum.contacts.len());
        if freedom == 0 || minimum.chi2 <= within(freedom, DIFFERS) {
            return 0.0;
        }
        let exceeds = |error| Ok::<_, Infallible>(left(minimum, data, error) > freedom as f64);
        let Ok(error) = model_error(exceeds);
        error
    }

    /// As many contacts as the readings are worth: those of `most`, or of one of the minima of `fewer`.
    pub(super) fn worth(&self, most: Minimum, mut fewer: Vec<Minimum>, data: &[Datum]) -> Minimum {
        let error = self.misfit(&most, data);
        if error <= 0.0 {
            return most;
        }
        let cost = |m: &Minimum| left(m, data, error) + self.settings.evidence * m.contacts.len() as f64;
        // Somebody has said that there is a contact.
        fewer.retain(|m| !m.contacts.is_empty());
        fewer.into_iter().fold(most, |best, other| if cost(&other) < cost(&best) { other } else { best })
    }
}

/// Sum of the squares of what a minimum leaves, in units of the noise and a model's `error` together.
pub(super) fn left(minimum: &Minimum, data: &[Datum], error: f64) -> f64 {
    if error <= 0.0 {
        return minimum.chi2;
    }
    let by_error = |(datum, signal): (&Datum, &f64)| {
        let more = error.powi(2) * datum.square();
        datum.residual(*signal).0.powi(2) * more / (1.0 + more)
    };
    minimum.chi2 - data.iter().zip(&minimum.signal).map(by_error).sum::<f64>()
}
