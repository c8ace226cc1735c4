//! Contacts whose bound is infinite, which stand in no root mean square: how many there are, and how far off they are.

use serde::{Deserialize, Serialize};

use crate::metrics::bin_in;

/// Contacts of which the channels do not determine a quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Undetermined {
    /// Over all forces.
    pub all: Uncounted,
    /// By true normal force; bins without any are left out.
    pub by_force: Vec<UncountedBin>,
}

/// Contacts without a finite bound in one bin of force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UncountedBin {
    /// \[N\] lower end.
    pub from: f64,
    /// \[N\] upper end, absent for the last bin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    /// How many.
    #[serde(flatten)]
    pub uncounted: Uncounted,
}

/// How many contacts have an infinite bound.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Uncounted {
    /// Contacts.
    pub contacts: usize,
    /// Share of all contacts with an error.
    pub share: f64,
    /// Root mean square of their errors, in the unit of the quantity.
    pub error_rms: f64,
}

impl Undetermined {
    /// Of force and error of contacts without a finite bound, and the forces of all others.
    pub(super) fn of(open: &[(f64, f64)], others: &[f64], edges: &[f64]) -> Option<Self> {
        let count = |bin: Option<usize>| {
            let within = |force: f64| bin.is_none() || bin_in(edges, force) == bin;
            let errors: Vec<f64> = open.iter().filter(|(f, _)| within(*f)).map(|(_, error)| *error).collect();
            let contacts = errors.len();
            let all = contacts + others.iter().filter(|force| within(**force)).count();
            let squares: f64 = errors.iter().map(|error| error * error).sum();
            (contacts > 0).then(|| Uncounted {
                contacts,
                share: contacts as f64 / all as f64,
                error_rms: (squares / contacts as f64).sqrt(),
            })
        };
        let bin = |n: usize| {
            let uncounted = count(Some(n))?;
            Some(UncountedBin { from: edges[n], to: edges.get(n + 1).copied(), uncounted })
        };
        Some(Self { all: count(None)?, by_force: (0..edges.len()).filter_map(bin).collect() })
    }
}
