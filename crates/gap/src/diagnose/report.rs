//! Stage `report`: verdict, where the gap lies, and what is left.

use dermis_model::diagnosis::Evidence;
use dermis_skin::{Effect, SkinDescription};
use sha2::{Digest, Sha256};

use super::data::Data;
use super::measure::{FoundInterference, Measured, Scope};
use super::predict::{Explained, Members};
use super::{Diagnosis, Options, contest, covariates};
use crate::axes::{self, Axis, FREQUENCY, View};
use crate::constants::report::{
    DISCREPANCY, EFFECTS_ALONG_AXES, EXPLAINABLE, FINGERPRINT, LEFT, NAMED, REMAINDER, SUSPECTS, UNSYSTEMATIC,
};
use crate::constants::select::{CLEARLY, SURELY};
use crate::effects;
use crate::noise::Gap;
use crate::protocol::design::Hypothesis;
use crate::recording::{Recording, hex};
use crate::report::{
    Alternative, DataSummary, NamedEffect, Provenance, Report, SCHEMA, UnconfirmedEffect, Unknown, Value,
    Verdict,
};
use crate::samples::Samples;
use crate::select::{SelectOptions, Selection, Tier};
use crate::signatures::{Candidate, Signatures};
use crate::simulate::Simulator;
use crate::whitening::{measure, view};
use crate::wording::{percent, short};
use crate::{checks, consistency_checks, explainability, mains_interference};

pub(super) use crate::wording::sentence;

/// A report of what was recorded.
pub(super) fn begin(
    simulator: &Simulator<'_>,
    recording: &Recording,
    samples: &Samples,
    options: &Options,
) -> Report {
    let test = samples.test.iter().filter(|t| **t).count();
    Report {
        schema: SCHEMA.to_owned(),
        sentence: String::new(),
        verdict: Verdict::UnusableRecording,
        data: DataSummary {
            name: recording.name.clone(),
            hash: recording.hash(),
            skin: simulator.skin.name.clone(),
            skin_hash: simulator.skin.hash(),
            unit: simulator.skin.unit.clone(),
            channels: recording.channels,
            frames: recording.labels.len(),
            presses: recording.contacts(),
            samples: samples.list.len(),
            locations: [samples.groups - test, test],
            repeats: 0,
            sessions: recording.sessions.clone(),
            missing: checks::missing(recording, samples, 0),
            problems: recording.problems.clone(),
        },
        gap: None,
        axes: Vec::new(),
        channels: Vec::new(),
        maps: Vec::new(),
        consistency_checks: Vec::new(),
        effects: Vec::new(),
        suspects: Vec::new(),
        residual_reduction: None,
        held_out: None,
        unknown: Unknown::default(),
        rivals: Vec::new(),
        next_experiments: Vec::new(),
        hypotheses: Vec::new(),
        downstream: Vec::new(),
        corrected: Vec::new(),
        provenance: Provenance {
            tool: format!("dermis-gap {}", env!("CARGO_PKG_VERSION")),
            seed: options.select.seed,
            ..Provenance::default()
        },
        warnings: Vec::new(),
    }
}

/// Whether nothing can be said of causes.
pub(super) fn fatal(report: &Report) -> bool {
    report.data.problems.iter().any(|p| p.fatal)
}

/// A diagnosis of a recording that something is wrong with.
pub(super) fn unusable(mut report: Report, simulator: &Simulator<'_>) -> Diagnosis {
    report.verdict = Verdict::UnusableRecording;
    let first = report.data.problems.iter().find(|p| p.fatal);
    report.sentence = format!(
        "This recording cannot be diagnosed: {}.",
        first.map_or("it holds nothing to compare", |p| p.what.trim_end_matches('.'))
    );
    Diagnosis { report, corrected: simulator.skin.clone() }
}

/// Which effects are compared, and on which frames.
pub(super) fn library(report: &mut Report, signatures: &Signatures, simulated: f64, samples: &Samples) {
    let of = &mut report.provenance;
    of.seconds[0] = simulated;
    of.silent = signatures.silent.iter().map(|(a, b)| [a.clone(), b.clone()]).collect();
    of.model_discrepancy.clone_from(&signatures.discrepancy_names);
    of.tried = signatures.candidates.iter().map(|c| c.name.clone()).collect();
    // No residual shows it: the spectrum of untouched frames does.
    let spectral = effects::with(|p| matches!(p.evidence, Evidence::Spectrum { .. }));
    of.tried.extend(spectral.map(|info| info.name.to_owned()));
    of.library_hash = hex(&Sha256::digest(of.tried.join(",")));
    if samples.single_frame_samples > 0 {
        report.warnings.push(format!(
            "of {} presses {} are sampled in every phase, and {} others in one held frame: {} frames in all",
            report.data.presses,
            samples.presses,
            samples.single_frame_samples,
            samples.list.len()
        ));
    }
}

/// Where the gap lies.
pub(super) fn locate(
    report: &mut Report,
    measured: &Measured,
    skin: &SkinDescription,
    recording: &Recording,
    samples: &Samples,
    seed: u64,
) {
    let gap = &measured.gap;
    report.data.repeats = gap.repeats;
    report.data.missing = checks::missing(recording, samples, gap.repeats);
    let view = view(samples, &measured.whitened, &measured.modelled, &measured.sigma, gap);
    report.axes = axes::shares(&view, &recording.sessions, seed);
    report.channels = axes::channels(&view, &measured.scaled, skin);
    report.maps.push(axes::map(&view, &skin.surface()));
    report.consistency_checks = consistency_checks::checks(&view, &measured.signals);
}

/// Interference as an axis and a warning.
pub(super) fn interference(report: &mut Report, found: &FoundInterference, gap: &Gap) {
    let FoundInterference { line, size, .. } = found;
    let share = |of: f64| {
        let size = of.clamp(0.0, 1.0) / line.share * size;
        size / (size + gap.systematic.max(0.0) + gap.irreproducible.unwrap_or(0.0))
    };
    report.axes.push(Axis {
        axis: FREQUENCY.to_owned(),
        share: share(line.share),
        interval: [share(line.share - line.half), share(line.share + line.half)],
        bins: Vec::new(),
        alike: Vec::new(),
    });
    report.axes.sort_by(|a, b| b.share.total_cmp(&a.share));
    let mains = mains_interference::mains(line.frequency, line.rate);
    report.warnings.push(format!(
        "{} % of the energy of untouched frames is interference at {} Hz{}: {} % of what the readings do, which counts as noise below; \
         look at mains, motors and their shielding",
        percent(line.share),
        short(line.frequency),
        mains.map_or(String::new(), |f| format!(", as mains of {f} Hz make it in these frames")),
        percent(*size)
    ));
}

/// The report of a gap that does not matter.
pub(super) fn negligible(
    mut report: Report,
    interference: Option<(NamedEffect, Effect)>,
    options: &SelectOptions,
) -> Report {
    if let Some((named, effect)) = interference {
        report.verdict = Verdict::Named;
        report.sentence = format!(
            "No gap between model and presses that matters, but interference: {}.",
            report.warnings.last().map_or("", |w| w)
        );
        report.effects = vec![named];
        report.corrected = vec![effect];
        return report;
    }
    report.verdict = Verdict::NoGapBeyondNoise;
    let largest = report.gap.as_ref().map_or(0.0, |gap| gap.interval[1].max(0.0));
    report.sentence = format!(
        "No gap beyond noise: at most {} % of what the readings do is not in the nominal model, and below {} % it does not matter.",
        percent(largest),
        percent(options.margin)
    );
    report
}

/// What the named effects come to, and what they leave.
struct Remainder {
    /// Whitened residual after them.
    left: Vec<f32>,
    /// Whether they hold on other contacts.
    holds: bool,
    /// Share of the gap that they explain.
    share: f64,
}

impl Remainder {
    fn of(data: &Data<'_>, measured: &Measured, explained: &mut Explained, gap: &Gap, scope: Scope) -> Self {
        // What does not hold on other contacts explains nothing: all of the gap is left.
        let holds = explained.library >= NAMED * gap.systematic;
        let left = explained.left.take().filter(|_| holds).unwrap_or_else(|| measured.whitened.clone());
        let mut share = (explained.library / gap.systematic.max(1e-12)).clamp(0.0, 1.0);
        // What differs from press to press has to go as well.
        if scope.irreproducible && holds {
            let seed = data.options.select.seed;
            let still = |residual: &[f32]| {
                let measured = measure(residual, &measured.scaled, data.samples, data.sigma, seed);
                measured.systematic.max(0.0) + measured.irreproducible.unwrap_or(0.0)
            };
            share = share.min(1.0 - still(&left) / still(&measured.whitened).max(1e-12)).max(0.0);
        }
        Self { left, holds, share }
    }
}

/// Completes a report, and gives the members of the first class that is open.
pub(super) fn finish(
    report: &mut Report,
    data: &Data<'_>,
    measured: &Measured,
    mut explained: Explained,
    scope: Scope,
    interference: Option<(NamedEffect, Effect)>,
) -> Members {
    let gap = explained.gap.clone().unwrap_or_else(|| measured.gap.clone());
    report.gap = Some(gap.clone());
    let remainder = Remainder::of(data, measured, &mut explained, &gap, scope);
    let taken: f64 = measured.known.iter().map(|effect| effect.gain.max(0.0)).sum();
    let taken = taken + interference.as_ref().map_or(0.0, |(named, _)| named.gain);
    unexplained(report, data, measured, &explained, (&remainder, &gap), (scope.negligible, taken));
    let mut effects = measured.known.clone();
    let sure = effects.len();
    effects.extend(explained.named);
    report.warnings.extend(explained.warnings);
    report.rivals = std::mem::take(&mut explained.rivals);
    report.residual_reduction = explained.reduction;
    report.held_out = explained.held_out;
    report.corrected = measured.fixed.iter().cloned().chain(explained.effects).collect();
    covariates::alias(&mut effects, data.samples);
    let options = &data.options.select;
    report.suspects = suspects(&data.signatures.candidates, &explained.selection, options.floor);
    let counts = (sure, effects.len());
    let (selection, irreproducible) = (&explained.selection, scope.irreproducible);
    report.verdict = verdict(&report.unknown, counts, selection, &gap, irreproducible, options.margin);
    if effects.len() > sure && remainder.share < NAMED {
        report.residual_reduction = None;
        report.held_out = None;
        // A name for a small part of a gap would be taken for the cause.
        for effect in &effects[sure..] {
            report.warnings.push(format!(
                "{} explains {} % of the systematic gap: too little to be named its cause",
                effect.label,
                percent(remainder.share)
            ));
        }
        effects.truncate(sure);
        report.corrected.truncate(measured.fixed.len());
    }
    if let Some((named, effect)) = interference {
        report.verdict = match report.verdict {
            Verdict::Named | Verdict::Undecided => Verdict::Named,
            // Beside interference that is larger than what presses have in common there is nothing sure to explain.
            _ if !scope.established || scope.negligible => Verdict::Named,
            _ => Verdict::NamedAndUnknown,
        };
        report.corrected.push(effect);
        effects.push(named);
    }
    // The strongest first.
    effects.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    report.effects = effects;
    report.verdict = contest::verdict(report.verdict, explained.contested);
    explained.members
}

/// What the library does not explain, its map and its fingerprint; and the axes of what it does.
fn unexplained(
    report: &mut Report,
    data: &Data<'_>,
    measured: &Measured,
    explained: &Explained,
    (remainder, gap): (&Remainder, &Gap),
    (negligible, taken): (bool, f64),
) {
    let Remainder { left, holds, share } = remainder;
    let seed = data.options.select.seed;
    let sessions = &data.recording.sessions;
    let systematic = gap.systematic.max(1e-12);
    let after = view(data.samples, left, &measured.modelled, data.sigma, gap);
    report.maps.push(axes::map(&after, &data.simulator.skin.surface()));
    // Of all of the gap, with what known effects have taken away; a rest that does not matter is none.
    let rest = if negligible { 0.0 } else { systematic / (systematic + taken) };
    report.unknown = Unknown {
        share: (rest * (1.0 - share)).max(0.0),
        library: 1.0 - rest * (1.0 - share),
        model_discrepancy: rest * ((explained.both - explained.library) / systematic).clamp(0.0, 1.0),
        explainable: explainable(&after, gap, seed),
        fingerprint: Vec::new(),
        structure: explained.structure,
        evidence: explained.judged.evidence,
        threshold: explained.judged.threshold,
        shape: explained.judged.shape.as_ref().map(|(what, _)| what.clone()),
        shape_share: explained.judged.shape.as_ref().map(|(_, share)| *share),
        tests: explained.judged.tests.clone(),
    };
    if *share < FINGERPRINT {
        report.unknown.fingerprint = axes::shares(&after, sessions, seed).into_iter().take(4).collect();
        report.unknown.fingerprint.iter_mut().for_each(|a| a.bins.clear());
    }
    // What the named effects make of the gap lies along the same axes, without the noise and the rest that blur them.
    if *holds && *share >= EFFECTS_ALONG_AXES {
        let made: Vec<f32> =
            measured.whitened.iter().zip(left).map(|(before, after)| before - after).collect();
        let silent = Gap { floor: 0.0, ..gap.clone() };
        let view = view(data.samples, &made, &measured.modelled, data.sigma, &silent);
        let shares = axes::shares(&view, sessions, seed);
        report.axes.retain(|axis| axis.axis == FREQUENCY);
        report.axes.extend(shares);
        report.axes.sort_by(|a, b| b.share.total_cmp(&a.share));
    }
}

/// Share of the systematic part of what is left that a smoother predicts.
fn explainable(view: &View<'_>, gap: &Gap, seed: u64) -> f64 {
    let share = explainability::explainable(view.residual, view.samples, view.channels, seed);
    let usable = view.sigma.iter().filter(|s| s.is_finite()).count().max(1);
    let all = view.residual.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>()
        / (view.samples.list.len().max(1) * usable) as f64;
    let systematic = all - gap.floor * gap.variance;
    if systematic > LEFT * all { (share * all / systematic).clamp(0.0, 1.0) } else { 0.0 }
}

/// `sure` effects are named by what else shows them than residuals, out of `all`. A gap that is `irreproducible` is there, however little
/// of it is systematic.
fn verdict(
    unknown: &Unknown,
    (sure, all): (usize, usize),
    selection: &Selection,
    gap: &Gap,
    irreproducible: bool,
    margin: f64,
) -> Verdict {
    if all > 0 {
        return if unknown.share <= REMAINDER {
            Verdict::Named
        } else if unknown.library >= NAMED || sure > 0 {
            Verdict::NamedAndUnknown
        } else if unknown.explainable >= EXPLAINABLE {
            Verdict::UnknownSystematic
        } else {
            Verdict::Unmeasured
        };
    }
    let small = gap.interval[0] <= CLEARLY * margin && gap.systematic < SURELY * margin;
    if gap.systematic < UNSYSTEMATIC * gap.fvu_before {
        // Either another press of the same kind has another gap, or there may be nothing but noise.
        if small && !irreproducible { Verdict::Undecided } else { Verdict::Unmeasured }
    } else if selection.discrepancy >= DISCREPANCY * gap.systematic {
        Verdict::ModelDiscrepancy
    } else if small {
        Verdict::Undecided
    } else if unknown.explainable >= EXPLAINABLE {
        Verdict::UnknownSystematic
    } else {
        Verdict::Unmeasured
    }
}

/// The best effects when they come alone.
fn suspects(candidates: &[Candidate], selection: &Selection, floor: f64) -> Vec<UnconfirmedEffect> {
    let mut found: Vec<UnconfirmedEffect> = candidates
        .iter()
        .zip(&selection.alone)
        .filter(|(_, [_, loose])| *loose >= floor)
        .map(|(c, [strict, loose])| UnconfirmedEffect {
            name: c.name.clone(),
            gain: *loose,
            beyond_discrepancy: *strict,
        })
        .collect();
    found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    found.truncate(SUSPECTS);
    found
}

/// Members of a class that is open, with how open they are.
pub(super) fn hypotheses(report: &Report, members: &Members) -> Vec<Hypothesis> {
    let open = |name: &str| {
        let of = report.effects.iter().flat_map(|e| &e.class).find(|a| a.name == name);
        of.map_or(0.5, |a| a.p_confuse)
    };
    let of = members.iter().map(|(name, effects)| Hypothesis {
        name: name.clone(),
        effects: effects.clone(),
        p_confuse: open(name),
    });
    of.collect()
}

/// An effect that something else than the size of a residual shows; its gain is still to come.
pub(super) fn known_effect(effect: &Effect, what: &str, unit: &str) -> NamedEffect {
    let theta = effect.parameters.iter().map(|(name, value)| Value {
        name: name.clone(),
        value: *value,
        unit: unit.to_owned(),
        interval: None,
        plausibility: None,
    });
    let member = Alternative {
        name: effect.name.clone(),
        gain: 0.0,
        p_confuse: 0.0,
        angle: Some(0.0),
        rig: false,
        alias: false,
        values: Vec::new(),
        effects: Vec::new(),
    };
    NamedEffect {
        label: effect.name.clone(),
        what: what.to_owned(),
        class: vec![member],
        covers: Vec::new(),
        tier: Tier::Strict,
        theta: theta.collect(),
        gain: 0.0,
        solo: 0.0,
        shapley: 0.0,
        p_max_t: 0.0,
        p_confuse: 0.0,
        covariate_alias: Vec::new(),
        written: true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gap(systematic: f64, least: f64) -> Gap {
        Gap {
            fvu_before: 0.1,
            floor: 0.01,
            systematic,
            interval: [least, 2.0 * systematic],
            zero: 0.0,
            irreproducible: None,
            repeats: 0,
            variance: 1.0,
        }
    }

    #[test]
    fn verdicts_follow_what_is_left() {
        let unknown = |share: f64, explainable: f64| Unknown {
            share,
            library: 1.0 - share,
            explainable,
            ..Unknown::default()
        };
        let said = |unknown: Unknown, counts, discrepancy: f64, gap: Gap| {
            let selection = Selection { discrepancy, ..Selection::default() };
            let irreproducible = gap.irreproducible.is_some();
            verdict(&unknown, counts, &selection, &gap, irreproducible, 0.005)
        };
        assert_eq!(said(unknown(0.2, 0.0), (0, 1), 0.0, gap(0.08, 0.07)), Verdict::Named);
        assert_eq!(said(unknown(0.5, 0.0), (0, 1), 0.0, gap(0.08, 0.07)), Verdict::NamedAndUnknown);
        assert_eq!(said(unknown(0.9, 0.5), (0, 1), 0.0, gap(0.08, 0.07)), Verdict::UnknownSystematic);
        assert_eq!(said(unknown(0.9, 0.5), (1, 1), 0.0, gap(0.08, 0.07)), Verdict::NamedAndUnknown);
        assert_eq!(said(unknown(1.0, 0.5), (0, 0), 0.0, gap(0.01, 0.009)), Verdict::Unmeasured);
        assert_eq!(said(unknown(1.0, 0.5), (0, 0), 0.05, gap(0.08, 0.07)), Verdict::ModelDiscrepancy);
        // As large as noise can make it, of readings that are mostly noise.
        let may_be_noise = Gap { irreproducible: None, ..gap(0.002, -0.001) };
        assert_eq!(said(unknown(1.0, 0.5), (0, 0), 0.0, may_be_noise.clone()), Verdict::Undecided);
        let differs = Gap { irreproducible: Some(0.05), ..may_be_noise };
        assert_eq!(said(unknown(1.0, 0.5), (0, 0), 0.0, differs), Verdict::Unmeasured);
        let mut small = gap(0.006, 0.004);
        small.fvu_before = 0.02;
        assert_eq!(said(unknown(1.0, 0.5), (0, 0), 0.0, small), Verdict::Undecided);
        assert_eq!(said(unknown(1.0, 0.5), (0, 0), 0.0, gap(0.08, 0.07)), Verdict::UnknownSystematic);
        assert_eq!(said(unknown(1.0, 0.1), (0, 0), 0.0, gap(0.08, 0.07)), Verdict::Unmeasured);
    }
}
