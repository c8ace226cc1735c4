//! Extremely randomised trees.
//!
//! Problem: a regression of many rows without a scale that is the same everywhere. Method: the mean of trees whose nodes draw one cut at
//! random on each of some inputs, and keep the one that leaves the least variance (P. Geurts, D. Ernst, L. Wehenkel, *Extremely randomized
//! trees*, Machine Learning 63, 2006). Every tree sees all rows. All outputs share the trees; their variances are added, so that targets
//! of one fit should be of one unit. Assumptions: none; answers never leave the range of the targets. Cost: trees × rows × inputs ×
//! depth to fit; trees × depth to answer.

use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::{RegressError, Rows};

/// Settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TreeSettings {
    /// Trees.
    pub trees: usize,
    /// Rows that a leaf holds at least.
    pub leaf: usize,
    /// Share of the inputs on which a node draws a cut; at least one.
    pub share: f64,
    /// What is drawn by.
    pub seed: u64,
}

impl Default for TreeSettings {
    fn default() -> Self {
        Self { trees: 100, leaf: 1, share: 1.0, seed: 0 }
    }
}

/// A node; of a leaf, `feature` is [`LEAF`] and `below` the index of its first value.
#[derive(Debug, Clone, Copy)]
struct Node {
    feature: u32,
    cut: f64,
    /// The node of what is below the cut; the one of what is above comes next.
    below: u32,
}

const LEAF: u32 = u32::MAX;

#[derive(Debug, Clone, Default)]
struct Tree {
    nodes: Vec<Node>,
    values: Vec<f64>,
}

/// A fitted forest.
#[derive(Debug, Clone)]
pub struct Trees {
    width: usize,
    outputs: usize,
    trees: Vec<Tree>,
}

impl Trees {
    /// Fits all columns of `targets` at once.
    ///
    /// # Errors
    ///
    /// [`RegressError`] where the tables do not have equally many rows, or a setting is out of its range.
    pub fn fit(inputs: Rows<'_>, targets: Rows<'_>, settings: &TreeSettings) -> Result<Self, RegressError> {
        if targets.count() != inputs.count() {
            return Err(RegressError::Size {
                what: "the table of targets",
                found: targets.count(),
                expected: inputs.count(),
            });
        }
        for (name, value) in [("trees", settings.trees), ("leaf", settings.leaf)] {
            if value == 0 {
                return Err(RegressError::Setting { name, value: 0.0, must: "at least 1" });
            }
        }
        if !(settings.share > 0.0 && settings.share <= 1.0) {
            return Err(RegressError::Setting { name: "share", value: settings.share, must: "in (0, 1]" });
        }
        let grow = |number: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
            rng.set_stream(number as u64);
            Tree::grow(inputs, targets, settings, &mut rng)
        };
        let trees = (0..settings.trees).map(grow).collect();
        Ok(Self { width: inputs.width(), outputs: targets.width(), trees })
    }

    /// The answer to one row, one number an output.
    ///
    /// # Errors
    ///
    /// [`RegressError::Size`] for a row of another width.
    pub fn predict(&self, row: &[f64]) -> Result<Vec<f64>, RegressError> {
        if row.len() != self.width {
            return Err(RegressError::Size { what: "a row", found: row.len(), expected: self.width });
        }
        let mut out = vec![0.0; self.outputs];
        for tree in &self.trees {
            let leaf = tree.leaf(row) as usize;
            let values = &tree.values[leaf..leaf + self.outputs];
            out.iter_mut().zip(values).for_each(|(o, v)| *o += v / self.trees.len() as f64);
        }
        Ok(out)
    }
}

impl Tree {
    fn grow(inputs: Rows<'_>, targets: Rows<'_>, settings: &TreeSettings, rng: &mut ChaCha8Rng) -> Self {
        let mut tree = Self::default();
        let mut order: Vec<usize> = (0..inputs.count()).collect();
        let mut features: Vec<usize> = (0..inputs.width()).collect();
        let tried = ((settings.share * features.len() as f64).ceil() as usize).clamp(1, features.len());
        tree.nodes.push(Node { feature: LEAF, cut: 0.0, below: 0 });
        let mut open = vec![(0_usize, 0, order.len())];
        while let Some((node, from, to)) = open.pop() {
            let rows = &mut order[from..to];
            features.shuffle(rng);
            let cut = best_cut((inputs, targets), rows, (&features, tried), settings.leaf, rng);
            let Some((feature, cut)) = cut else {
                let first = tree.values.len() as u32;
                tree.values.extend(sums(targets, rows).iter().map(|s| s / rows.len() as f64));
                tree.nodes[node] = Node { feature: LEAF, cut: 0.0, below: first };
                continue;
            };
            let below = partition(rows, |row| inputs.row(row)[feature] <= cut);
            let next = tree.nodes.len();
            tree.nodes[node] = Node { feature: feature as u32, cut, below: next as u32 };
            tree.nodes.extend([Node { feature: LEAF, cut: 0.0, below: 0 }; 2]);
            open.push((next, from, from + below));
            open.push((next + 1, from + below, to));
        }
        tree
    }

    /// Index of the first value of the leaf that a row falls into.
    fn leaf(&self, row: &[f64]) -> u32 {
        let mut node = self.nodes[0];
        while node.feature != LEAF {
            let above = row[node.feature as usize] > node.cut;
            node = self.nodes[node.below as usize + usize::from(above)];
        }
        node.below
    }
}

/// Of one random cut on each of `tried` inputs that vary, the one that leaves the least variance; `None` where none leaves `leaf` rows
/// on both sides, or nothing is left to explain.
fn best_cut(
    (inputs, targets): (Rows<'_>, Rows<'_>),
    rows: &[usize],
    (features, tried): (&[usize], usize),
    leaf: usize,
    rng: &mut ChaCha8Rng,
) -> Option<(usize, f64)> {
    let first = targets.row(rows[0]);
    if rows.len() < 2 * leaf || rows.iter().all(|r| targets.row(*r) == first) {
        return None;
    }
    let total = sums(targets, rows);
    let mut best: Option<(f64, usize, f64)> = None;
    let mut left = tried;
    for &feature in features {
        if left == 0 {
            break;
        }
        let values = rows.iter().map(|r| inputs.row(*r)[feature]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if high <= low {
            continue;
        }
        left -= 1;
        let cut = low + rng.random::<f64>() * (high - low);
        let (mut below, mut count) = (vec![0.0; total.len()], 0_usize);
        for row in rows.iter().filter(|r| inputs.row(**r)[feature] <= cut) {
            count += 1;
            below.iter_mut().zip(targets.row(*row)).for_each(|(b, t)| *b += t);
        }
        let above = rows.len() - count;
        if count < leaf || above < leaf {
            continue;
        }
        // What the means of both sides explain of the squares.
        let gain: f64 = below
            .iter()
            .zip(&total)
            .map(|(b, t)| b * b / count as f64 + (t - b).powi(2) / above as f64)
            .sum();
        if best.is_none_or(|(most, ..)| gain > most) {
            best = Some((gain, feature, cut));
        }
    }
    best.map(|(_, feature, cut)| (feature, cut))
}

fn sums(targets: Rows<'_>, rows: &[usize]) -> Vec<f64> {
    let mut sums = vec![0.0; targets.width()];
    for row in rows {
        sums.iter_mut().zip(targets.row(*row)).for_each(|(s, t)| *s += t);
    }
    sums
}

/// Brings what fits to the front, and says how many do.
fn partition(rows: &mut [usize], fits: impl Fn(usize) -> bool) -> usize {
    let mut count = 0;
    for i in 0..rows.len() {
        if fits(rows[i]) {
            rows.swap(i, count);
            count += 1;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step in the first input that a second one of noise hides nothing of, and a plane.
    fn made() -> (Vec<f64>, Vec<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let inputs: Vec<f64> = (0..1200).map(|_| rng.random_range(-1.0..1.0)).collect();
        let of = |x: &[f64]| [if x[0] > 0.2 { 3.0 } else { -1.0 }, x[0] + 2.0 * x[1]];
        let targets = inputs.chunks_exact(2).flat_map(of).collect();
        (inputs, targets)
    }

    #[test]
    fn rows_that_were_learned_are_known_and_others_near() {
        let (inputs, targets) = made();
        let (x, t) = (Rows::new(&inputs, 2, "inputs").unwrap(), Rows::new(&targets, 2, "targets").unwrap());
        let settings = TreeSettings { trees: 30, ..TreeSettings::default() };
        let forest = Trees::fit(x, t, &settings).unwrap();
        for i in [0, 17, 599] {
            let out = forest.predict(x.row(i)).unwrap();
            assert!(out.iter().zip(t.row(i)).all(|(a, b)| (a - b).abs() < 1e-9), "{out:?} {:?}", t.row(i));
        }
        for row in [[0.6, -0.4], [-0.5, 0.3], [-0.1, 0.0]] {
            let out = forest.predict(&row).unwrap();
            assert!((out[0] - if row[0] > 0.2 { 3.0 } else { -1.0 }).abs() < 0.2, "{row:?}: {out:?}");
            assert!((out[1] - row[0] - 2.0 * row[1]).abs() < 0.2, "{row:?}: {out:?}");
        }
        // Far away it keeps to the range of what was learned.
        let far = forest.predict(&[9.0, 9.0]).unwrap()[1];
        assert!(far > 2.0 && far <= 3.0, "{far}");
        assert!(forest.predict(&[1.0]).is_err());
        let again = Trees::fit(x, t, &settings).unwrap();
        assert_eq!(again.predict(&[0.3, 0.3]).unwrap(), forest.predict(&[0.3, 0.3]).unwrap());
    }

    #[test]
    fn leaves_hold_as_many_rows_as_requested() {
        let (inputs, targets) = made();
        let (x, t) = (Rows::new(&inputs, 2, "inputs").unwrap(), Rows::new(&targets, 2, "targets").unwrap());
        let settings = TreeSettings { trees: 1, leaf: 600, ..TreeSettings::default() };
        let mean = t.iter().map(|r| r[1]).sum::<f64>() / 600.0;
        let out = Trees::fit(x, t, &settings).unwrap().predict(&[0.9, 0.9]).unwrap();
        assert!((out[1] - mean).abs() < 1e-9);
        let refused = |s: TreeSettings| Trees::fit(x, t, &s).unwrap_err().to_string();
        insta::assert_snapshot!(refused(TreeSettings { leaf: 0, ..settings }), @"setting `leaf` is 0 and must be at least 1");
        insta::assert_snapshot!(refused(TreeSettings { share: 0.0, ..settings }), @"setting `share` is 0 and must be in (0, 1]");
    }
}
