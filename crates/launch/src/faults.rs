//! Mistakes of launch files, gathered.
//!
//! Problem: who checks a file wants to hear of every mistake in it at once, and not of one a run; but what only follows from a
//! mistake that was reported already is no help.
//!
//! Solution: reading goes on after a mistake with whatever is left, and a mistake of a field is dropped where another one of that
//! field, of one within it or of one around it was reported before.

use std::collections::BTreeSet;
use std::path::Path;

use crate::error::{LaunchError, LaunchErrors};

/// Mistakes that are reported; a file with more of them is no launch file.
const MOST: usize = 100;

#[derive(Debug, Default)]
pub(crate) struct Faults {
    all: Vec<LaunchError>,
    /// Files and fields in the order of their names.
    fields: BTreeSet<(std::path::PathBuf, String)>,
}

impl Faults {
    /// Reports a mistake, unless it may follow from one that was reported.
    pub(crate) fn push(&mut self, error: LaunchError) {
        let LaunchError::Field { path, field, .. } = &error else { return self.tell(error) };
        let around = prefixes(field).any(|field| self.fields.contains(&(path.clone(), field.to_owned())));
        if !around && !self.holds_within(path, field) {
            self.tell(error);
        }
    }

    /// Tells a mistake that follows from no other.
    pub(crate) fn tell(&mut self, error: LaunchError) {
        if let LaunchError::Field { path, field, .. } = &error {
            self.fields.insert((path.clone(), field.clone()));
        }
        if !self.full() {
            self.all.push(error);
        }
    }

    /// Whether no more are reported: it is of no use to look for them.
    pub(crate) fn full(&self) -> bool {
        self.all.len() >= MOST
    }

    pub(crate) fn count(&self) -> usize {
        self.all.len()
    }

    /// `value`, where nothing is wrong.
    pub(crate) fn or<T>(self, value: T) -> Result<T, LaunchErrors> {
        if self.all.is_empty() { Ok(value) } else { Err(LaunchErrors(self.all)) }
    }

    fn holds_within(&self, path: &Path, field: &str) -> bool {
        let from = (path.to_owned(), field.to_owned());
        let mut later = self.fields.range(from..).take_while(|(p, f)| p == path && f.starts_with(field));
        later.any(|(_, f)| f[field.len()..].starts_with(['.', '[']))
    }
}

/// A field and all that it lies in: `a[1].b`, `a[1]`, `a`.
fn prefixes(field: &str) -> impl Iterator<Item = &str> {
    let cuts = field.match_indices(['.', '[']).map(|(at, _)| at);
    cuts.map(|at| &field[..at]).chain([field])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_from_a_mistake_is_not_reported_again() {
        let mut faults = Faults::default();
        let mut push = |field: &str| {
            let before = faults.count();
            faults.push(LaunchError::Field {
                path: "a.yaml".into(),
                field: field.to_owned(),
                reason: String::new(),
            });
            faults.count() > before
        };
        assert!(push("processes[1].dermis[2]"));
        assert!(
            !push("processes[1].dermis")
                && !push("processes[1].dermis[2]")
                && !push("processes[1].dermis[2].x")
        );
        assert!(push("processes[1].dermi") && push("processes[10]") && push("processes[1].ready"));
        assert!(!push("processes"));
    }
}
