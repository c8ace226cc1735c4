//! The numbers of a frame without a picture: a sparse matrix from what changes at the nodes of the inside.
//!
//! They are what [`Observer`] makes of a picture without noise, as long as pixels stay as open or as saturated as they are where nothing
//! touches: one at the end of its scale has no part in their changes, and [`Clipping`](super::clipping::Clipping) knows the others. Cost: some
//! twenty products for each node that changes and each block that sees it.

use std::collections::HashMap;

use super::grouped;
use super::light::COLOURS;
use super::observer::{Observer, PATTERNS};
use super::picture::{self, Noise};
use super::shading::{CHANGES, Changes};
use super::table::Table;

/// Share of the noise's variance that is left of a pixel at the end of its scale: half of a Gaussian is cut off.
const CUT: f64 = 0.5 - 0.5 / std::f64::consts::PI;

/// What a change at a node changes of a block's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Weights {
    /// Of means, by colour: of a change of that colour, and of the phases of ridges.
    means: [[f32; COLOURS]; 3],
    /// Of the numbers of ridges.
    patterns: [[f32; CHANGES]; PATTERNS],
}

/// Numbers by changes.
#[derive(Debug, Clone)]
pub(super) struct Numbers {
    columns: usize,
    rows: usize,
    per_block: usize,
    /// Where nothing touches, of all pixels, and what those that are not saturated have in it.
    untouched: Vec<f64>,
    free: Vec<f64>,
    /// Standard deviation.
    noise: Vec<f64>,
    /// Of each node of the grid with one column more: where its blocks begin.
    starts: Vec<u32>,
    weights: Vec<(u32, Weights)>,
}

impl Numbers {
    /// Of a table with so many nodes.
    pub(super) fn new(table: &Table, observer: &Observer, noise: Noise, nodes: usize) -> Self {
        let [columns, rows] = observer.blocks().map(|n| n as usize);
        let per = observer.per_block();
        let shares = observer.shares();
        let mut untouched = vec![0.0; observer.numbers()];
        let mut free = untouched.clone();
        let mut variance = untouched.clone();
        let mut found: HashMap<(u32, u32), Weights> = HashMap::new();
        for (i, pixel) in table.pixels.iter().enumerate() {
            let block = observer.block(i);
            let share = shares[block];
            let open = pixel.base.map(|v| if v < 1.0 { 1.0_f32 } else { 0.0 });
            let patterns = observer.weights(i, block);
            let place = block * per;
            for (colour, base) in pixel.base.iter().enumerate() {
                let (shown, own) = (f64::from(base.min(1.0)), f64::from(base * open[colour]));
                let noisy = noise.deviation(shown).powi(2) * if open[colour] > 0.0 { 1.0 } else { CUT };
                let mut add = |number: usize, weight: f64| {
                    untouched[number] += weight * shown;
                    free[number] += weight * own;
                    variance[number] += weight * weight * noisy;
                };
                add(place + colour, share);
                if let Some(patterns) = &patterns {
                    patterns.iter().enumerate().for_each(|(k, of)| add(place + COLOURS + k, of[colour]));
                }
            }
            let [along, around] = table.moved(i);
            let factor = table.factor(i);
            for (node, weight) in pixel.corners(table.wide) {
                if weight <= 0.0 {
                    continue;
                }
                let sum = found.entry((node as u32, block as u32)).or_default();
                for (colour, open) in open.iter().enumerate() {
                    let by = weight * factor * open;
                    let each = by * share as f32;
                    sum.means[0][colour] += each;
                    sum.means[1][colour] += each * along[colour];
                    sum.means[2][colour] += each * around[colour];
                    for (sum, of) in sum.patterns.iter_mut().zip(patterns.iter().flatten()) {
                        let by = by * of[colour] as f32;
                        sum[colour] += by;
                        sum[COLOURS] += by * along[colour];
                        sum[COLOURS + 1] += by * around[colour];
                    }
                }
            }
        }
        for block in 0..columns * rows {
            let offsets = observer.offsets(block);
            let numbers = untouched[block * per..(block + 1) * per].iter_mut().skip(COLOURS);
            numbers.zip(offsets).for_each(|(number, offset)| *number += offset);
        }
        let mut found: Vec<_> = found.into_iter().collect();
        found.sort_unstable_by_key(|(key, _)| *key);
        let starts = grouped::starts(nodes, found.iter().map(|((node, _), _)| *node as usize));
        Self {
            columns,
            rows,
            per_block: per,
            untouched,
            free,
            noise: variance.into_iter().map(f64::sqrt).collect(),
            starts,
            weights: found.into_iter().map(|((_, block), weights)| (block, weights)).collect(),
        }
    }

    /// Of pictures as the camera takes them.
    pub(super) fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// As [`Picture::respond`](super::Picture::respond), of pixels that neither reach the end of their scale nor leave it; numbers may lie beyond
    /// theirs.
    pub(super) fn respond(&self, shown: &[(&Changes, f64)], brighter: f64, out: &mut [f64]) {
        for ((value, untouched), free) in out.iter_mut().zip(&self.untouched).zip(&self.free) {
            *value = untouched + (brighter - 1.0) * free;
        }
        for (k, (changes, _)) in shown.iter().enumerate() {
            let by_row: Vec<f32> = (0..self.rows)
                .map(|row| picture::shares(shown, (row as f64 + 0.5) / self.rows as f64)[k] * brighter as f32)
                .collect();
            self.add(changes, &by_row, out);
        }
    }

    /// What changes alone add, however small: neither the untouched numbers nor the ends of the scale.
    pub(super) fn change(&self, changes: &Changes, brighter: f64, out: &mut [f64]) {
        out.fill(0.0);
        self.add(changes, &vec![brighter as f32; self.rows], out);
    }

    fn add(&self, changes: &Changes, by_row: &[f32], out: &mut [f64]) {
        for node in &changes.nodes {
            let [from, to] = [0, 1].map(|k| self.starts[*node as usize + k] as usize);
            let change = &changes.values[*node as usize];
            for (block, weights) in &self.weights[from..to] {
                let block = *block as usize;
                let by = by_row[block / self.columns];
                let numbers = &mut out[block * self.per_block..(block + 1) * self.per_block];
                let [own, along, around] = &weights.means;
                for (colour, value) in numbers[..COLOURS].iter_mut().enumerate() {
                    let ridges = along[colour] * change[COLOURS] + around[colour] * change[COLOURS + 1];
                    *value += f64::from(by * (own[colour] * change[colour] + ridges));
                }
                for (value, weights) in numbers[COLOURS..].iter_mut().zip(&weights.patterns) {
                    let sum: f32 = weights.iter().zip(change).map(|(w, c)| w * c).sum();
                    *value += f64::from(by * sum);
                }
            }
        }
    }
}
