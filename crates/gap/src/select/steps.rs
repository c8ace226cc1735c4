//! Forward steps, backward drops and swaps.

use std::collections::BTreeSet;
use std::sync::atomic::Ordering;

use super::{AcceptedEffect, Selection, Selector, Tier};
use crate::constants::select::{BEYOND, BEYOND_TEST, CLEARLY, SURELY};

/// The effect that makes the best model beside those that are accepted.
struct Step {
    best: usize,
    /// All of them.
    with: Vec<usize>,
    /// Reduction of the held-out error.
    gain: f64,
    /// By how much the model with it is better.
    won: f64,
}

/// What is accepted so far.
#[derive(Default)]
struct Accepted {
    set: Vec<usize>,
    /// Family-wise probabilities, one a step.
    ps: Vec<f64>,
    /// Whether the last one may as well be the model discrepancy.
    loose: bool,
}

/// Sets of effects that steps have led to, in whatever order each was accepted.
#[derive(Default)]
struct Visited(BTreeSet<BTreeSet<usize>>);

impl Visited {
    fn is_new(&mut self, set: &[usize]) -> bool {
        self.0.insert(set.iter().copied().collect())
    }
}

impl Selector<'_> {
    /// Selects.
    #[must_use]
    pub fn select(&self) -> Selection {
        let none = self.losses(&[], Tier::Loose);
        let strict_none = self.losses(&[], Tier::Strict);
        let mut found = Selection { discrepancy: self.gain(&none, &strict_none), ..Selection::default() };
        found.alone = (0..self.candidates.len())
            .map(|e| {
                [
                    self.gain(&strict_none, &self.losses(&[e], Tier::Strict)),
                    self.gain(&none, &self.losses(&[e], Tier::Loose)),
                ]
            })
            .collect();
        let Accepted { mut set, mut ps, mut loose } = self.forwards(&none);
        if let Some([a, b]) = self.better_pair(&set) {
            let p = |e, other| self.significance(&[other], e);
            ps = vec![p(a, b), p(b, a)];
            (set, loose) = (vec![a, b], false);
        }
        self.calibrate(&set[..set.len().saturating_sub(1)]);
        if set.len() > 1 {
            self.swap(&mut set);
        }
        let after = self.losses(&set, Tier::Loose);
        found.library = self.gain(&none, &after);
        found.both = self.gain(&none, &self.losses(&set, Tier::Strict));
        let shapley = self.shapley(&set, if loose { Tier::Loose } else { Tier::Strict });
        for (i, &candidate) in set.iter().enumerate() {
            let tier = if loose && i + 1 == set.len() { Tier::Loose } else { Tier::Strict };
            let others: Vec<usize> = set.iter().copied().filter(|c| *c != candidate).collect();
            let (class, covers) = self.class(candidate, &others, tier);
            found.picks.push(AcceptedEffect {
                candidate,
                tier,
                gain: class.first().map_or(0.0, |m| m.gain),
                solo: found.alone[candidate][usize::from(tier == Tier::Loose)],
                shapley: shapley[i],
                p: ps.get(i).copied().unwrap_or(f64::NAN),
                class,
                covers,
            });
        }
        found.picks.sort_by(|a, b| b.shapley.total_cmp(&a.shapley));
        found
    }

    /// Steps forwards until none passes, or one leads back to effects that were accepted before: where two explain nearly the same, each is
    /// taken in beside the other, which is then no longer needed. `none` are the losses without any effect.
    fn forwards(&self, none: &[f64]) -> Accepted {
        let mut found = Accepted::default();
        let mut visited = Visited::default();
        while found.set.len() < self.options.most {
            let set = &found.set;
            let Some(Step { best, with, gain, won }) = self.step(set) else { break };
            if gain < self.least(set) || won <= 0.0 {
                break;
            }
            // Near the margin, what the model discrepancy may do as well is no finding.
            let beyond = self.gain(&self.losses(set, Tier::Strict), &self.losses(&with, Tier::Strict));
            let clear = self.least > CLEARLY || beyond >= BEYOND * self.systematic;
            let firm = won > self.firm() && clear;
            // What is left that surely matters, and goes away with an effect that may as well be the model discrepancy, is reported as
            // such.
            let rest = self.systematic - self.gain(none, &self.losses(set, Tier::Loose));
            let surely = self.least * (rest / self.systematic).min(1.0) > SURELY;
            let loosely = surely && (set.is_empty() || gain >= BEYOND * rest);
            if !(firm || loosely) {
                break;
            }
            let p = self.significance(set, best);
            // Effects of many columns have little power in that test; evidence this strong needs none.
            if p > self.options.level && won < BEYOND_TEST * self.firm() {
                break;
            }
            let (mut set, mut ps) = (with, found.ps.clone());
            ps.push(p);
            self.prune(&mut set, &mut ps);
            if !visited.is_new(&set) {
                break;
            }
            found = Accepted { set, ps, loose: !firm };
            if !firm {
                break;
            }
        }
        found
    }

    /// Candidates that forward steps accept, without tests of significance: for resampling.
    #[must_use]
    pub fn quick(&self) -> Vec<usize> {
        let mut set: Vec<usize> = Vec::new();
        while set.len() < self.options.most {
            let Some(Step { with, gain, won, .. }) = self.step(&set) else { break };
            if gain < self.least(&set) || (!set.is_empty() && won < self.firm()) {
                break;
            }
            set = with;
        }
        set
    }

    /// By how much an effect has to beat the model discrepancy: every one of the library has its chance to by accident.
    pub(super) fn firm(&self) -> f64 {
        2.0 * (self.candidates.len().max(1) as f64 / self.options.level).ln()
    }

    /// The step forwards from `set`; `None` where every effect is in it.
    fn step(&self, set: &[usize]) -> Option<Step> {
        self.calibrate(set);
        let score = self.score(set);
        let (best, better) = self.best(set)?;
        let with: Vec<usize> = set.iter().copied().chain([best]).collect();
        // Held against the gap itself, and against what is left beside the model discrepancy.
        let gain = |tier| self.gain(&self.losses(set, tier), &self.losses(&with, tier));
        let gain = gain(Tier::Loose).max(gain(Tier::Strict));
        let won = if better < score { score - better } else { 0.0 };
        Some(Step { best, with, gain, won })
    }

    /// The effect beside `set` that makes the best model, and its score.
    fn best(&self, set: &[usize]) -> Option<(usize, f64)> {
        if let Some((_, progress)) = self.watch {
            progress.inc_length((self.candidates.len() - set.len()) as u64);
        }
        (0..self.candidates.len())
            .filter(|e| !set.contains(e))
            .take_while(|_| self.watch.is_none_or(|(stop, _)| !stop.load(Ordering::Relaxed)))
            .map(|e| {
                if let Some((_, progress)) = self.watch {
                    progress.inc(1);
                }
                let with: Vec<usize> = set.iter().copied().chain([e]).collect();
                (e, self.score(&with))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Drops what is no longer needed.
    fn prune(&self, set: &mut Vec<usize>, ps: &mut Vec<f64>) {
        let mut index = 0;
        while set.len() > 1 && index < set.len() {
            let all = self.losses(set, Tier::Strict);
            let rest: Vec<usize> = set.iter().copied().filter(|c| *c != set[index]).collect();
            let lost = self.gain(&self.losses(&rest, Tier::Strict), &all);
            // The last one has just been accepted.
            if lost < self.least(&rest) && index + 1 < set.len() {
                set.remove(index);
                ps.remove(index);
            } else {
                index += 1;
            }
        }
    }

    /// Exchanges an accepted effect for another where that is clearly better.
    fn swap(&self, set: &mut [usize]) {
        for _ in 0..set.len() {
            let now = self.score(set);
            let mut best: Option<(usize, usize, f64)> = None;
            for i in 0..set.len() {
                for e in 0..self.candidates.len() {
                    if set.contains(&e) {
                        continue;
                    }
                    let mut other = set.to_vec();
                    other[i] = e;
                    let score = self.score(&other);
                    if best.is_none_or(|b| score < b.2) {
                        best = Some((i, e, score));
                    }
                }
            }
            match best {
                Some((i, e, score)) if now - score > 2.0 * self.options.decisive_odds.ln() => set[i] = e,
                _ => break,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use indicatif::ProgressBar;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::select::SelectOptions;
    use crate::signatures::Candidate;
    use crate::statistics::{Column, Gram, Statistics, tests::samples};

    /// Two effects and a model discrepancy that are nearly the same column. Each effect is taken in beside the other, which is then no longer
    /// needed; without a memory of where steps led, they take each other's place for ever.
    #[test]
    fn steps_between_effects_that_explain_nearly_the_same_end() {
        let n = 240;
        let mut rng = ChaCha8Rng::seed_from_u64(580);
        let mut normal = move || rng.sample::<f32, _>(StandardNormal);
        let basis: [Vec<f32>; 4] = std::array::from_fn(|_| (0..n).map(|_| normal()).collect());
        let mut mixed = |others: usize| -> Vec<f32> {
            let weights: Vec<f32> = (1..others).map(|_| 0.3 * normal()).collect();
            let others = |i: usize| basis[1..].iter().zip(&weights).map(|(b, w)| w * b[i]).sum::<f32>();
            (0..n).map(|i| basis[0][i] + others(i)).collect()
        };
        let columns = [3, 4, 4].map(|others| Column { channel: None, values: mixed(others) });
        let mut residual = mixed(4);
        residual.iter_mut().for_each(|value| *value += 0.02 * normal());
        let effect = |column: usize, nonlinear: bool| Candidate {
            name: format!("effect {column}"),
            what: String::new(),
            family: false,
            rig: false,
            number: false,
            columns: vec![column],
            per_channel: false,
            drifts_randomly: false,
            nonlinear,
            depends_on_uptime: false,
            written_as: None,
            aliases: Vec::new(),
            starts: Vec::new(),
            linear: Vec::new(),
        };
        let candidates = [effect(0, true), effect(1, false)];
        let statistics = Statistics::new(&columns, &residual, &samples(&(0..n).collect::<Vec<_>>()), 1);
        let gram = Gram::of(&statistics);
        let options = SelectOptions { permutations: 19, ..SelectOptions::default() };
        let energy = residual.iter().map(|v| f64::from(*v).powi(2)).sum();
        let (stop, progress) = (AtomicBool::new(false), ProgressBar::hidden());
        let selected = std::thread::scope(|scope| {
            let (ended, end) = std::sync::mpsc::channel::<()>();
            let stop = &stop;
            // Ends a selection that would not end by itself.
            scope.spawn(move || {
                stop.store(end.recv_timeout(Duration::from_secs(20)).is_err(), Ordering::Relaxed);
            });
            let selector = Selector::new(
                &statistics,
                &candidates,
                &[2],
                &gram,
                (energy, 1.0, 1.0),
                &vec![1.0; n],
                &options,
            );
            let selected = selector.watched(stop, &progress).select();
            let _ = ended.send(());
            selected
        });
        assert!(!stop.load(Ordering::Relaxed), "the selection did not end by itself");
        assert_eq!(selected.picks.len(), 1);
    }

    #[test]
    fn a_set_that_steps_led_to_before_is_not_new_in_another_order() {
        let mut visited = Visited::default();
        assert!(visited.is_new(&[3]) && visited.is_new(&[3, 1]) && visited.is_new(&[1]));
        assert!(!visited.is_new(&[1, 3]) && !visited.is_new(&[3]));
    }
}
