//! Which samples are held out.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::LearnError;
use crate::dataset::{Dataset, FrameInfo, Run, SampleId, Truth};

/// What a split holds out whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SplitKind {
    /// Contact locations: nothing that is tested was ever touched in training.
    #[default]
    Location,
    /// Presses. Other presses at the same locations are trained on, so this only serves to compare with figures
    /// that were measured that way.
    Press,
    /// The end of every run.
    Time,
}

impl SplitKind {
    /// As it is written in files and flags.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Location => "location",
            Self::Press => "press",
            Self::Time => "time",
        }
    }
}

impl std::str::FromStr for SplitKind {
    type Err = LearnError;

    fn from_str(text: &str) -> Result<Self, LearnError> {
        [Self::Location, Self::Press, Self::Time].into_iter().find(|k| k.name() == text).ok_or_else(|| {
            LearnError::Config {
                file: "flags".into(),
                field: "--split".into(),
                reason: format!("is `{text}` and must be `location`, `press` or `time`"),
            }
        })
    }
}

/// One of several equal parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fold {
    /// Which part is held out, from 0.
    pub index: u32,
    /// Number of parts.
    pub of: u32,
}

/// How a data set is split. The same configuration splits any part of the same data alike: a location or press
/// goes to its part by a hash of its identity and the seed, and not by its place in a shuffled list.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SplitConfig {
    /// What is held out whole.
    pub kind: SplitKind,
    /// Share that is held out, of locations, presses or time.
    pub fraction: f64,
    /// Draws locations or presses.
    pub seed: u64,
    /// Holds out one of several parts instead of `fraction`; not for [`SplitKind::Time`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
}

impl Default for SplitConfig {
    fn default() -> Self {
        Self { kind: SplitKind::Location, fraction: 0.2, seed: 1, fold: None }
    }
}

/// Labelled samples in two parts, each in order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Split {
    /// To train on.
    pub train: Vec<SampleId>,
    /// Held out.
    pub test: Vec<SampleId>,
}

impl SplitConfig {
    /// In words, for cards and reports.
    #[must_use]
    pub fn describe(&self) -> String {
        let share = self.fold.map_or_else(
            || format!("{} % of the", self.fraction * 100.0),
            |f| format!("part {} of {} of the", f.index + 1, f.of),
        );
        match self.kind {
            SplitKind::Location => format!("{share} contact locations (seed {})", self.seed),
            SplitKind::Press => {
                format!("{share} presses, at locations that are also trained on (seed {})", self.seed)
            }
            SplitKind::Time => format!("the last {} % of every run", self.fraction * 100.0),
        }
    }

    /// The frames that a model is evaluated on, and their name: the held-out part, or all labelled frames without a split.
    ///
    /// # Errors
    ///
    /// As [`apply`](Self::apply).
    pub fn evaluated(
        split: Option<Self>,
        data: &Dataset,
    ) -> Result<(Option<Vec<SampleId>>, String), LearnError> {
        let Some(split) = split else { return Ok((None, "all labelled frames".to_owned())) };
        Ok((Some(split.apply(data)?.test), split.describe()))
    }

    /// Splits the labelled samples.
    ///
    /// Untouched samples tell nothing about a location: they go with their press.
    ///
    /// # Errors
    ///
    /// [`LearnError::Split`] where the configuration is impossible or a part would hold no touched sample.
    pub fn apply(&self, data: &Dataset) -> Result<Split, LearnError> {
        let wrong = |reason: String| Err(LearnError::Split { kind: self.kind.name(), reason });
        if !(self.fraction > 0.0 && self.fraction < 1.0) {
            return wrong(format!("the held-out share is {} and must lie between 0 and 1", self.fraction));
        }
        if let Some(fold) = self.fold {
            if self.kind == SplitKind::Time {
                return wrong("has no folds; split by location or press".into());
            }
            if fold.of < 2 || fold.index >= fold.of {
                return wrong(format!("part {} of {} does not exist", fold.index, fold.of));
            }
        }
        let ends: Vec<i64> = data.runs().iter().map(|run| self.time_bound(run)).collect();
        let mut split = Split::default();
        let mut touched = [0_usize; 2];
        for (id, sample, truth) in data.labelled() {
            let held_out = self.holds_out(&data.runs()[id.run].session, ends[id.run], sample, truth);
            touched[usize::from(held_out)] += usize::from(truth.touched());
            if held_out { &mut split.test } else { &mut split.train }.push(id);
        }
        if touched.contains(&0) {
            return wrong(match (self.kind, data.locations()) {
                (SplitKind::Location, n @ 0..=1) => {
                    format!(
                        "the data has {n} contact locations; hold out the end of each run instead (`--split time`)"
                    )
                }
                (_, n) => format!(
                    "{} of the two parts would hold no touched sample, of {} in {n} locations; record more",
                    if touched[0] == 0 { "the training part" } else { "the held-out part" },
                    touched[0] + touched[1]
                ),
            });
        }
        Ok(split)
    }

    /// Whether each sample of a run is held out; `None` without ground truth. Unlike [`apply`](Self::apply), one of
    /// the parts may be empty.
    #[must_use]
    pub fn mark(&self, run: &Run) -> Vec<Option<bool>> {
        let end = self.time_bound(run);
        let mark = |s: &FrameInfo| s.truth.as_ref().map(|t| self.holds_out(&run.session, end, s, t));
        run.samples.iter().map(mark).collect()
    }

    fn holds_out(&self, session: &str, end: i64, sample: &FrameInfo, truth: &Truth) -> bool {
        match self.kind {
            SplitKind::Time => sample.stamp >= end,
            SplitKind::Location if truth.touched() => self.draws("location", "", u64::from(truth.location)),
            SplitKind::Location | SplitKind::Press => self.draws("press", session, truth.press),
        }
    }

    /// Stamp from which on a run is held out: the last share of the time in which it is labelled.
    fn time_bound(&self, run: &Run) -> i64 {
        let mut labelled = run.samples.iter().filter(|s| s.truth.is_some()).map(|s| s.stamp);
        let first = labelled.next().unwrap_or(0);
        let last = labelled.next_back().unwrap_or(first);
        first + ((last - first) as f64 * (1.0 - self.fraction)) as i64
    }

    fn draws(&self, what: &str, session: &str, identity: u64) -> bool {
        let mut hasher = Sha256::new();
        hasher.update(self.seed.to_le_bytes());
        hasher.update(what.as_bytes());
        hasher.update(session.as_bytes());
        hasher.update(identity.to_le_bytes());
        let digest = hasher.finalize();
        let draw = u64::from_le_bytes(std::array::from_fn(|i| digest[i]));
        self.fold.map_or_else(
            || (draw as f64) < self.fraction * 2.0_f64.powi(64),
            |fold| draw % u64::from(fold.of) == u64::from(fold.index),
        )
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;
    use crate::dataset::tests::{presses, skin};

    fn locations(data: &Dataset, ids: &[SampleId]) -> BTreeSet<u32> {
        ids.iter()
            .filter_map(|id| data.sample(*id)?.truth.as_ref())
            .filter(|t| t.touched())
            .map(|t| t.location)
            .collect()
    }

    proptest! {
        #[test]
        fn no_location_is_in_both_parts(
            location_count in 5_u32..60, repeats in 1_u32..4, seed in any::<u64>(), fraction in 0.1..0.9_f64,
            folds in proptest::option::of(2_u32..6),
        ) {
            let data = presses(location_count, repeats);
            let fold = folds.map(|of| Fold { index: (seed % u64::from(of)) as u32, of });
            let config = SplitConfig { kind: SplitKind::Location, fraction, seed, fold };
            if let Ok(split) = config.apply(&data) {
                let (train, test) = (locations(&data, &split.train), locations(&data, &split.test));
                prop_assert!(train.is_disjoint(&test));
                prop_assert_eq!(train.len() + test.len(), location_count as usize);
                prop_assert_eq!(split.train.len() + split.test.len(), data.labelled().count());
            }
        }
    }

    #[test]
    fn folds_cover_everything_once() {
        let data = presses(40, 2);
        let mut seen = BTreeSet::new();
        for index in 0..4 {
            let config = SplitConfig { fold: Some(Fold { index, of: 4 }), ..Default::default() };
            let test = locations(&data, &config.apply(&data).unwrap().test);
            assert!(seen.is_disjoint(&test));
            seen.extend(test);
        }
        assert_eq!(seen.len(), 40);
    }

    #[test]
    fn a_part_of_the_data_is_split_alike() {
        let (whole, half) = (presses(40, 3), presses(20, 3));
        let config = SplitConfig::default();
        let held_out = locations(&whole, &config.apply(&whole).unwrap().test);
        let part = locations(&half, &config.apply(&half).unwrap().test);
        assert_eq!(part, held_out.into_iter().filter(|l| *l < 20).collect());
    }

    #[test]
    fn time_holds_out_the_end() {
        let data = presses(10, 1);
        let config = SplitConfig { kind: SplitKind::Time, ..Default::default() };
        let split = config.apply(&data).unwrap();
        let latest = split.train.iter().max().unwrap();
        assert!(split.test.iter().all(|id| id > latest));
        let share = split.test.len() as f64 / data.labelled().count() as f64;
        assert!((share - 0.2).abs() < 0.05, "{share}");
    }

    #[test]
    fn one_location_cannot_be_split_by_location() {
        let data = presses(1, 5);
        insta::assert_snapshot!(
            SplitConfig::default().apply(&data).unwrap_err(),
            @"split by location: the data has 1 contact locations; hold out the end of each run instead (`--split time`)"
        );
        assert_eq!(skin().channels().len(), 2);
    }
}
