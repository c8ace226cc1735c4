//! Which presses tell apart best what a diagnosis leaves open.
//!
//! Problem: hypotheses that explain a recording equally well, and a budget of minutes. Method: T-optimality (Atkinson and Fedorov 1975): a
//! set of presses is worth how far the readings of one hypothesis at its fitted values are from those of its rival *after the best fit of
//! the rival* to them,
//!
//! ```text
//! T(a | b) = min over θ of  ‖ C^(-1/2) (change of a − columns of b · θ) ‖² + prior(θ) ,      P(confuse) = Φ(−√T / 2)
//! ```
//!
//! where C holds the noise, and for each block and channel a share of the reading that the simulator is wrong by (all presses of a block
//! alike, so that a paired contrast does not see it). Blocks are chosen one after another, each the one whose presses add the most
//! information `½ ln(1 + T)` over all pairs in a minute (greedy; what different blocks say adds).
//!
//! What no hypothesis of the library explains ("unknown") has no readings that could be simulated. It is served by presses that are
//! done again, which say whether it is systematic, at locations that are spread, which say where it lies.
//!
//! Assumptions: changes of a rival are linear in its columns ([`Signatures`]); blocks do not influence one another. Cost: one set of
//! signatures over the menu at all locations, then small matrices.

use std::sync::atomic::AtomicBool;

use dermis_skin::Effect;
use indicatif::ProgressBar;
use nalgebra::{DMatrix, DVector, Point3};
use serde::{Deserialize, Serialize};

use super::{Block, BlockKind, Range, carried_out, menu};
use crate::GapError;
use crate::algebra::{dot, normal};
use crate::constants::experiments::{SETTLED, TRUST};
use crate::constants::protocol::{ALIKE, COLUMNS, LOCATIONS, UNTELLABLE};
use crate::constants::select::PRIOR;
use crate::recording::Recording;
use crate::samples::{SampleOptions, Samples};
use crate::signatures::Signatures;
use crate::simulate::Simulator;
use crate::whitening;

/// Something that explains a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hypothesis {
    /// Name of the effect.
    pub name: String,
    /// As it would be switched on, at its fitted values; empty where it can be fitted as a rival only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<Effect>,
    /// Probability that another recording of the same presses would put it first.
    pub p_confuse: f64,
}

/// What a design is to do.
#[derive(Debug, Clone)]
pub struct DesignOptions {
    /// Minutes on the rig.
    pub minutes: f64,
    /// Forces and tips.
    pub range: Range,
    /// Effects that are there whichever hypothesis is right.
    pub beside: Vec<Effect>,
    /// Share of the minutes that serves what no hypothesis explains.
    pub unknown: f64,
}

/// What a design does for two hypotheses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Separation {
    /// The two.
    pub between: [String; 2],
    /// Probability of confusing them before.
    pub p_before: f64,
    /// The same with the presses of the design.
    pub p_after: f64,
    /// Which kind of block tells them apart best; `None` where none does.
    pub by: Option<BlockKind>,
    /// Whether no press that a rig can do tells them apart: two names of one thing, here.
    pub one_thing: bool,
}

/// Presses that tell hypotheses apart.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Design {
    /// What to press, in the order in which it was chosen: the most telling first. Blocks of [`BlockKind::Again`] and
    /// [`BlockKind::Single`] that serve what is unknown come last.
    pub blocks: Vec<Block>,
    /// What that does.
    pub separations: Vec<Separation>,
}

impl Design {
    /// \[min\] on the rig.
    #[must_use]
    pub fn minutes(&self) -> f64 {
        self.blocks.iter().map(Block::minutes).sum()
    }
}

/// One hypothesis over all candidate blocks, in deviations of noise and trust.
struct Spread {
    /// What it changes at its fitted values.
    change: Option<Vec<f32>>,
    /// Directions in which it can be fitted.
    columns: Vec<Vec<f32>>,
}

/// What blocks say of an ordered pair.
#[derive(Clone)]
struct Information {
    energy: f64,
    side: DVector<f64>,
    gram: DMatrix<f64>,
}

impl Information {
    /// Of no block: what is known of so many coefficients beforehand.
    fn none(columns: usize) -> Self {
        let gram = DMatrix::identity(columns, columns) * PRIOR;
        Self { energy: 0.0, side: DVector::zeros(columns), gram }
    }

    fn add(&mut self, more: &Self) {
        self.energy += more.energy;
        self.side += &more.side;
        self.gram += &more.gram;
    }

    /// T.
    fn separation(self) -> f64 {
        let Some(factor) = self.gram.cholesky() else { return 0.0 };
        (self.energy - self.side.dot(&factor.solve(&self.side))).max(0.0)
    }
}

/// An ordered pair: the readings of the first, the best fit of the second.
struct Pair {
    /// By block.
    of: Vec<Information>,
    /// Of the blocks that were taken.
    taken: Information,
}

impl Pair {
    fn new(a: &[f32], b: &Spread, rows: &[Vec<usize>]) -> Self {
        let m = b.columns.len();
        let at = |values: &[f32], rows: &[usize]| -> Vec<f32> { rows.iter().map(|r| values[*r]).collect() };
        let of = rows.iter().map(|rows| {
            let change = at(a, rows);
            let columns: Vec<Vec<f32>> = b.columns.iter().map(|c| at(c, rows)).collect();
            let mut gram = DMatrix::zeros(m, m);
            for i in 0..m {
                for j in 0..=i {
                    let product = dot(&columns[i], &columns[j]);
                    (gram[(i, j)], gram[(j, i)]) = (product, product);
                }
            }
            let side = DVector::from_iterator(m, columns.iter().map(|c| dot(c, &change)));
            Information { energy: dot(&change, &change), side, gram }
        });
        Self { of: of.collect(), taken: Information::none(m) }
    }

    /// T with these blocks besides those that were taken.
    fn with(&self, more: &[usize]) -> f64 {
        self.beside(self.taken.clone(), more)
    }

    /// T of these blocks alone.
    fn alone(&self, blocks: &[usize]) -> f64 {
        self.beside(Information::none(self.taken.side.len()), blocks)
    }

    fn beside(&self, mut sum: Information, blocks: &[usize]) -> f64 {
        blocks.iter().for_each(|block| sum.add(&self.of[*block]));
        sum.separation()
    }

    fn take(&mut self, block: usize) {
        self.taken.add(&self.of[block]);
    }
}

/// Two hypotheses, each read as the other's rival where it can be simulated.
struct Question {
    members: [usize; 2],
    pairs: Vec<Pair>,
    /// T of the recording that left them open.
    before: f64,
    one_thing: bool,
}

impl Question {
    /// Probability of confusing the two with these blocks besides those that were taken.
    fn confusion(&self, more: &[usize]) -> f64 {
        let of = |pair: &Pair| normal(-(self.before + pair.with(more)).sqrt() / 2.0);
        self.pairs.iter().map(of).sum::<f64>() / self.pairs.len().max(1) as f64
    }
}

/// T of a probability of confusion: the inverse of Φ(−√T / 2).
fn separation(p: f64) -> f64 {
    let (mut low, mut high) = (0.0f64, 12.0f64);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if normal(-middle) > p { low = middle } else { high = middle }
    }
    (2.0 * low).powi(2)
}

/// Designs the next presses. `locations` \[m\] are where the skin may be pressed, the most telling first.
///
/// # Errors
///
/// [`GapError`] where the nominal model cannot read the presses, or the work was interrupted.
pub fn design(
    simulator: &Simulator<'_>,
    hypotheses: &[Hypothesis],
    locations: &[Point3<f64>],
    options: &DesignOptions,
    stop: &AtomicBool,
    progress: &ProgressBar,
) -> Result<Design, GapError> {
    let locations = &locations[..locations.len().min(LOCATIONS)];
    let candidates: Vec<Block> = locations.iter().flat_map(|at| menu(&options.range, *at)).collect();
    let mut found = Design::default();
    let mut minutes = options.minutes;
    if hypotheses.len() > 1 && !candidates.is_empty() {
        let share = 1.0 - options.unknown.clamp(0.0, 1.0);
        let mut questions = questions(simulator, hypotheses, &candidates, options, stop, progress)?;
        let taken = choose(&mut questions, &candidates, share * minutes);
        let kinds: Vec<BlockKind> = taken.iter().map(|b| candidates[*b].kind).collect();
        found.separations = questions.iter().map(|q| q.separation(hypotheses, &taken, &kinds)).collect();
        found.blocks = taken.into_iter().map(|block| candidates[block].clone()).collect();
        minutes -= found.minutes();
    }
    // What is unknown: again and elsewhere, the locations that have been pressed least first.
    let mut order: Vec<&Point3<f64>> = locations.iter().collect();
    order.sort_by_key(|at| found.blocks.iter().filter(|b| b.at == **at).count());
    let served = options.unknown > 0.0;
    for (number, at) in order.into_iter().enumerate().filter(|_| served) {
        let kind = if number % 3 == 0 { BlockKind::Again } else { BlockKind::Ladder };
        let block = menu(&options.range, *at).into_iter().find(|b| b.kind == kind);
        let block = block.filter(|b| b.minutes() <= minutes && !found.blocks.contains(b));
        if let Some(block) = block {
            minutes -= block.minutes();
            found.blocks.push(block);
        }
    }
    Ok(found)
}

/// Which blocks say most in a minute of all questions: the sum of their information `½ ln(1 + T)`, so that what is distinguished already
/// counts less and less.
fn choose(questions: &mut [Question], candidates: &[Block], minutes: f64) -> Vec<usize> {
    let mut taken: Vec<usize> = Vec::new();
    let mut left = minutes;
    questions.sort_by_key(|q| q.one_thing);
    let open = questions.iter().take_while(|q| !q.one_thing).count();
    loop {
        let information = |block: &[usize]| -> f64 {
            let pairs = questions[..open].iter().flat_map(|q| q.pairs.iter().map(|pair| (q.before, pair)));
            pairs.map(|(before, pair)| 0.5 * (before + pair.with(block)).ln_1p()).sum()
        };
        let now = information(&[]);
        let best = (0..candidates.len())
            .filter(|b| !taken.contains(b) && candidates[*b].minutes() <= left)
            .map(|block| ((information(&[block]) - now) / candidates[block].minutes(), block))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, block)) = best.filter(|(worth, _)| *worth > 0.0) else { return taken };
        left -= candidates[block].minutes();
        questions.iter_mut().flat_map(|q| &mut q.pairs).for_each(|pair| pair.take(block));
        taken.push(block);
    }
}

impl Question {
    /// What the blocks that were taken do for it.
    fn separation(&self, hypotheses: &[Hypothesis], taken: &[usize], kinds: &[BlockKind]) -> Separation {
        let alone = |kind: BlockKind| {
            let of: Vec<usize> =
                taken.iter().zip(kinds).filter(|(_, k)| **k == kind).map(|(b, _)| *b).collect();
            self.pairs.iter().map(|pair| pair.alone(&of)).sum::<f64>()
        };
        let mut all: Vec<BlockKind> = kinds.to_vec();
        all.sort_unstable();
        all.dedup();
        let best = all.into_iter().map(|kind| (alone(kind), kind)).max_by(|a, b| a.0.total_cmp(&b.0));
        Separation {
            between: self.members.map(|m| hypotheses[m].name.clone()),
            p_before: normal(-self.before.sqrt() / 2.0),
            p_after: self.confusion(&[]),
            by: best.filter(|(t, _)| *t > 0.0 && !self.one_thing).map(|(_, kind)| kind),
            one_thing: self.one_thing,
        }
    }
}

/// All pairs of hypotheses over the candidate blocks.
fn questions(
    simulator: &Simulator<'_>,
    hypotheses: &[Hypothesis],
    candidates: &[Block],
    options: &DesignOptions,
    stop: &AtomicBool,
    progress: &ProgressBar,
) -> Result<Vec<Question>, GapError> {
    let skin = simulator.skin;
    let model = simulator.model(skin)?;
    let channels = model.channels();
    let recording = carried_out(candidates, model.surface(), channels, skin.rate);
    let samples = Samples::draw(&recording, &vec![false; channels], &SampleOptions::default());
    let rows = rows_by_block(candidates, &recording, &samples);
    let signatures = Signatures::simulate(simulator, &recording, &samples, stop, progress)?;
    let noise = skin.channel_noise();
    let changes = changes(simulator, hypotheses, &options.beside, (&recording, &samples), stop)?;
    let trusted = Trust::new(&signatures, &noise, &rows, channels);
    let spreads: Vec<Spread> = hypotheses
        .iter()
        .zip(changes)
        .map(|(hypothesis, change)| {
            let columns = signatures.candidates.iter().find(|c| c.name == hypothesis.name);
            let columns = columns.map_or_else(Vec::new, |c| {
                reduced(c.columns.iter().map(|c| dense(&signatures.columns[*c], channels)).collect())
            });
            let columns = columns.into_iter().map(|c| trusted.apply(c)).collect();
            Spread { change: change.map(|c| trusted.apply(c)), columns }
        })
        .collect();
    let mut questions = Vec::new();
    for a in 0..hypotheses.len() {
        for b in a + 1..hypotheses.len() {
            questions.extend(Question::between([a, b], hypotheses, &spreads, &rows));
        }
    }
    Ok(questions)
}

/// For each block the readings of its samples: their places in samples × channels.
fn rows_by_block(candidates: &[Block], recording: &Recording, samples: &Samples) -> Vec<Vec<usize>> {
    let channels = recording.channels;
    // Which block each press belongs to.
    let block_of: Vec<usize> =
        candidates.iter().enumerate().flat_map(|(b, block)| vec![b; block.presses.len()]).collect();
    let mut rows: Vec<Vec<usize>> = vec![Vec::new(); candidates.len()];
    for (i, sample) in samples.list.iter().enumerate().filter(|(_, s)| s.press != usize::MAX) {
        let press = recording.labels[sample.frame].press;
        if let Some(block) = (press as usize).checked_sub(1).and_then(|p| block_of.get(p)) {
            rows[*block].extend(i * channels..(i + 1) * channels);
        }
    }
    rows
}

/// What each hypothesis changes in the readings of samples at its fitted values, in deviations of the noise, where it can be simulated.
fn changes(
    simulator: &Simulator<'_>,
    hypotheses: &[Hypothesis],
    beside: &[Effect],
    (recording, samples): (&Recording, &Samples),
    stop: &AtomicBool,
) -> Result<Vec<Option<Vec<f32>>>, GapError> {
    let mut skins = vec![simulator.with(beside)];
    let simulated: Vec<usize> =
        (0..hypotheses.len()).filter(|h| !hypotheses[*h].effects.is_empty()).collect();
    for h in &simulated {
        let mut all = beside.to_vec();
        Effect::merge(&mut all, hypotheses[*h].effects.clone());
        skins.push(simulator.with(&all));
    }
    let hidden = ProgressBar::hidden();
    let mut read = simulator.many(&skins, recording, (samples, false), stop, &hidden)?.into_iter();
    let base = read.next().transpose()?.unwrap_or_default();
    let noise = simulator.skin.channel_noise();
    let mut changes: Vec<Option<Vec<f32>>> = vec![None; hypotheses.len()];
    for (h, read) in simulated.into_iter().zip(read) {
        // One that a device cannot have remains a rival.
        changes[h] = read.ok().map(|read| whitening::residual(&read, &base, &noise));
    }
    Ok(changes)
}

impl Question {
    /// Two hypotheses over all blocks, by the `rows` of each; `None` where neither can be simulated and its rival fitted.
    fn between(
        [a, b]: [usize; 2],
        hypotheses: &[Hypothesis],
        spreads: &[Spread],
        rows: &[Vec<usize>],
    ) -> Option<Self> {
        let pair = |x: usize, y: usize| {
            let change = spreads[x].change.as_ref()?;
            (!spreads[y].columns.is_empty()).then(|| Pair::new(change, &spreads[y], rows))
        };
        let pairs: Vec<Pair> = [pair(a, b), pair(b, a)].into_iter().flatten().collect();
        if pairs.is_empty() {
            return None;
        }
        // The first stands for what was named: what others say of theirs says how open they are.
        let p = hypotheses[b].p_confuse.max(if a == 0 { 0.0 } else { hypotheses[a].p_confuse });
        let everything: Vec<usize> = (0..rows.len()).collect();
        let whole: Vec<f64> = pairs.iter().map(|pair| pair.alone(&everything)).collect();
        let least = pairs.iter().zip(&whole).all(|(pair, whole)| {
            let energy: f64 = pair.of.iter().map(|i| i.energy).sum();
            *whole < ALIKE * energy
        });
        let confused = whole.iter().map(|t| normal(-t.sqrt() / 2.0)).sum::<f64>() / whole.len() as f64;
        let one_thing = least || confused > UNTELLABLE;
        Some(Self { members: [a, b], pairs, before: separation(p.clamp(1e-6, 0.5)), one_thing })
    }
}

/// A column as samples × channels.
fn dense(column: &crate::statistics::Column, channels: usize) -> Vec<f32> {
    match column.channel {
        None => column.values.clone(),
        Some(k) => {
            let mut values = vec![0.0; column.values.len() * channels];
            for (row, v) in values.chunks_exact_mut(channels).zip(&column.values) {
                row[k] = *v;
            }
            values
        }
    }
}

/// Few directions that hold most of what many columns can do; the prior of a coefficient stays what it was.
fn reduced(columns: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
    if columns.len() <= COLUMNS {
        return columns;
    }
    let scale = (columns.len() as f64).sqrt() as f32;
    let (mut few, _) = crate::algebra::components(&columns, 1.0, COLUMNS);
    few.iter_mut().flatten().for_each(|v| *v *= scale);
    few
}

/// The error that a simulator has at a place: a share of what each channel reads there, in all presses of a block alike. Whitening by it is
/// a symmetric square root of the inverse of `1 + n nᵀ`.
struct Trust<'a> {
    rows: &'a [Vec<usize>],
    channels: usize,
    /// Samples × channels: what the nominal model's signal would be wrong by, in deviations of the noise.
    error: Vec<f32>,
}

impl<'a> Trust<'a> {
    fn new(signatures: &Signatures, noise: &[f64], rows: &'a [Vec<usize>], channels: usize) -> Self {
        let error = signatures.nominal.iter().enumerate().map(|(i, v)| {
            let k = i % channels;
            (TRUST * signatures.zero.signal(k, f64::from(*v)) / noise[k]) as f32
        });
        Self { rows, channels, error: error.collect() }
    }

    fn apply(&self, mut values: Vec<f32>) -> Vec<f32> {
        for rows in self.rows {
            for k in 0..self.channels {
                let of = || rows.iter().skip(k).step_by(self.channels).copied();
                let own: f64 = of().map(|i| f64::from(self.error[i]).powi(2)).sum();
                if own <= 0.0 {
                    continue;
                }
                let along: f64 = of().map(|i| f64::from(self.error[i]) * f64::from(values[i])).sum();
                let factor = (1.0 - 1.0 / (1.0 + own).sqrt()) / own * along;
                of().for_each(|i| values[i] -= (factor * f64::from(self.error[i])) as f32);
            }
        }
        values
    }
}

/// Whether a probability of confusion settles a question.
#[must_use]
pub fn settles(p: f64) -> bool {
    p < SETTLED
}
