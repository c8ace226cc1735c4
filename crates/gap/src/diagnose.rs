//! The whole diagnosis.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use dermis_model::{CURVED, common_effect};
use dermis_skin::{Effect, SkinDescription};
use indicatif::ProgressBar;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

use crate::axes::{self, Axis, View};
use crate::data::{Problem, Recording, hex};
use crate::library::{Candidate, Gram, Signatures};
use crate::noise::{self, Gap};
use crate::polish::{self, Form, Free, Target};
use crate::report::{
    Alike, Closure, DataSummary, NamedEffect, Provenance, Report, SCHEMA, Suspect, Unknown, Value, Verdict,
};
use crate::rows::{RowOptions, Rows};
use crate::select::{CLEARLY, Member, SURELY, SelectOptions, Selection, Selector, Tier};
use crate::simulate::Simulator;
use crate::statistics::{Column, Fit, Statistics};
use crate::{GapError, checks, experiments, hum, library, parity, steps, store, unknown};

/// Share of the gap below which it is not systematic enough to be explained.
const UNSYSTEMATIC: f64 = 0.2;
/// Share of the systematic gap that effects must explain on other contacts to be named.
const NAMED: f64 = 0.3;
/// Share of the gap that an effect closes on other contacts at least, if its signature is to be believed beyond that.
const HELPS: f64 = 0.15;
/// Share of the systematic gap that signatures of the named effects may explain beyond what these close once they are switched on.
const APART: f64 = 0.15;
/// Share of the systematic gap that named effects may leave: laws are not known better.
const REMAINDER: f64 = 0.26;
/// What the closure in another recording of the same device differs by, beyond what resampling says.
const ELSEWHERE: f64 = 0.03;
/// The same, of what depends on the past.
const HISTORY: f64 = 0.1;
/// Relative error of the floor.
const FLOOR_ERROR: f64 = 0.1;
/// Share of what single presses leave that must differ between presses that were done alike to be a gap of its own.
const RESTLESS: f64 = 0.5;

/// How a recording is diagnosed.
#[derive(Debug, Clone)]
pub struct Options {
    /// How frames are drawn.
    pub rows: RowOptions,
    /// How causes are selected.
    pub select: SelectOptions,
    /// Times that selection and fit are run again for the interval of the closure.
    pub resamples: usize,
    /// Effects that are fitted on the full simulator for each named one, at most; 0 leaves all at their linear values.
    pub polish: usize,
    /// Folder that keeps signatures between runs.
    pub cache: Option<PathBuf>,
    /// Set it from anywhere to end early.
    pub stop: Arc<AtomicBool>,
    /// Shows simulations done and to do; hidden by default.
    pub progress: ProgressBar,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            rows: RowOptions::default(),
            select: SelectOptions::default(),
            resamples: 16,
            polish: 8,
            cache: None,
            stop: Arc::default(),
            progress: ProgressBar::hidden(),
        }
    }
}

/// Keeps signatures in memory, so that many recordings of the same presses are diagnosed with one set of simulations.
#[derive(Debug, Default)]
pub struct Memory {
    kept: Mutex<BTreeMap<String, Arc<Signatures>>>,
}

/// One diagnosis, and what else it found out.
#[derive(Debug, Clone)]
pub struct Diagnosis {
    /// What it says.
    pub report: Report,
    /// The skin by design with the named effects switched on.
    pub corrected: SkinDescription,
}

/// Diagnoses a recording.
///
/// # Errors
///
/// [`GapError`] where the nominal model cannot read the stimuli of the recording; what is wrong with the recording is a verdict.
pub fn diagnose(
    simulator: &Simulator<'_>,
    recording: &Recording,
    options: &Options,
    memory: &Memory,
) -> Result<Diagnosis, GapError> {
    let begun = Instant::now();
    let skin = simulator.skin;
    let mut sigma = noise::deviations(recording, skin);
    let usable: Vec<bool> = sigma.iter().map(|s| s.is_finite()).collect();
    let rows = Rows::draw(recording, &usable, &options.rows);
    let mut report = empty(simulator, recording, &rows, options);
    report.data.problems.extend(recording.clock());
    report.data.problems.extend(checks::readings(recording, skin, &rows));
    if report.data.problems.iter().any(|p| p.fatal) {
        return Ok(unusable(report, simulator));
    }
    let (signatures, seconds) = signatures(simulator, recording, &rows, options, memory)?;
    report.provenance.seconds[0] = seconds;
    report.provenance.silent = signatures.silent.iter().map(|(a, b)| [a.clone(), b.clone()]).collect();
    report.provenance.form.clone_from(&signatures.form_names);
    report.provenance.tried = signatures.candidates.iter().map(|c| c.name.clone()).collect();
    // No residual shows it: the spectrum of untouched frames does.
    report.provenance.tried.push("interference".to_owned());
    report.provenance.library_hash = hex(&Sha256::digest(report.provenance.tried.join(",")));

    let channels = recording.channels;
    if rows.glances > 0 {
        report.warnings.push(format!(
            "of {} presses every phase is looked at in {}, and one held frame in {} others: {} frames in all",
            report.data.presses,
            rows.presses,
            rows.glances,
            rows.rows.len()
        ));
    }
    let mut readings: Vec<f32> =
        rows.rows.iter().flat_map(|r| recording.frame(r.frame).iter().copied()).collect();
    let agreement = checks::agreement(simulator, recording, &rows, &readings, &signatures.nominal, &sigma)?;
    report.data.problems.extend(agreement.problems);
    if report.data.problems.iter().any(|p| p.fatal) {
        return Ok(unusable(report, simulator));
    }
    let mut fixed: Vec<Effect> = Vec::new();
    // Effects that something else than the size of a residual shows, and the gap before each.
    let mut certain: Vec<(NamedEffect, f64)> = Vec::new();
    if let Some(order) = agreement.order {
        let whitened = residual(&readings, &signatures.nominal, &sigma);
        let scaled = whiten(&readings, &sigma);
        let before = measure(&whitened, &scaled, &rows, &sigma, options).fvu_before;
        let read = readings.clone();
        let deviations = sigma.clone();
        let mut effect = Effect::new("channel-order");
        let mut told = Vec::new();
        for (at, from) in order.iter().enumerate() {
            if at != *from {
                sigma[*from] = deviations[at];
                for i in 0..rows.rows.len() {
                    readings[i * channels + from] = read[i * channels + at];
                }
                let names = skin.channels();
                effect.parameters.insert(names[at].name.clone(), *from as f64);
                told.push(format!("{} carries {}", names[at].name, names[*from].name));
            }
        }
        report.data.problems.push(Problem::note(
            "channel-order",
            format!(
                "channels are in another order: {}; all that follows has them in the right one",
                told.join(", ")
            ),
        ));
        certain.push((
            known_effect(
                &effect,
                "Channels are read in another order than the skin's description says.",
                "place",
            ),
            before,
        ));
        fixed.push(effect);
    }
    let mut nominal = signatures.nominal.clone();
    // Those of them that models are simulated with from here on: readings are in the right order by now, and their steps count as noise.
    let mut beside: Vec<Effect> = Vec::new();
    let mut step = 0.0;
    if let Some(coarse) = coarse(simulator, recording, &rows, &readings, &sigma)? {
        let whitened = residual(&readings, &nominal, &sigma);
        let before = measure(&whitened, &whiten(&readings, &sigma), &rows, &sigma, options).fvu_before;
        nominal = coarse.nominal.unwrap_or(nominal);
        step = coarse.step;
        let info = simulator.effects.iter().find(|i| i.name == coarse.effect.name);
        certain.push((known_effect(&coarse.effect, info.map_or("", |i| i.what), &skin.unit), before));
        fixed.push(coarse.effect);
        fixed.extend(coarse.down.clone());
        beside.extend(coarse.down);
    }
    let scaled = whiten(&readings, &sigma);
    cut(&mut readings, &nominal, skin, &sigma);
    let whitened = residual(&readings, &nominal, &sigma);
    let mut gap = measure(&whitened, &scaled, &rows, &sigma, options);
    // A reading lies anywhere within its step, and frame after frame at the same place of it.
    let stepped = (rounding(step, !beside.is_empty(), &nominal, &sigma) / gap.variance - gap.floor
        + gap.irreproducible.unwrap_or(0.0))
    .max(0.0);
    gap.counts_as_noise(stepped);
    let mut before = gap.fvu_before - stepped;
    for (effect, of) in certain.iter_mut().rev() {
        effect.gain = *of - before;
        effect.solo = effect.gain;
        effect.class[0].gain = effect.gain;
        before = *of;
    }
    let certain: Vec<NamedEffect> = certain.into_iter().map(|(effect, _)| effect).collect();
    let taken: f64 = certain.iter().map(|effect| effect.gain.max(0.0)).sum();
    report.data.repeats = gap.repeats;
    report.data.missing = checks::missing(recording, &rows, gap.repeats);
    let modelled = whiten(&nominal, &sigma);
    let surface = skin.surface();
    {
        let view = view(&rows, &whitened, &modelled, &sigma, &gap);
        report.axes = axes::shares(&view, &recording.sessions, options.select.seed);
        report.channels = axes::channels(&view, &scaled, skin);
        report.maps.push(axes::map(&view, &surface));
        report.parity = parity::checks(&view, &scaled);
    }
    // What differs from press to press is a gap as well, where it is no noise of single frames.
    let restless = gap.irreproducible.is_some_and(|i| i > options.select.margin.max(RESTLESS * gap.floor));
    let irreproducible = gap.irreproducible.unwrap_or(0.0);
    let hum = hum::find(recording, skin.rate).map(|hum| {
        // Frames that follow each other differ by more than a hum itself where it turns round between them, and by less where it hardly
        // moves.
        let turn = (std::f64::consts::TAU * hum.frequency / skin.rate).cos();
        let twins = gap.floor - irreproducible;
        let noise = twins / (1.0 - turn * hum.share);
        (hum, noise - twins, hum.share * noise)
    });
    let hum = hum.filter(|(.., size)| *size > options.select.margin).map(|(hum, by, size)| {
        gap.counts_as_noise(by);
        (hum, size)
    });
    if let Some((hum, size)) = &hum {
        let share = |of: f64| {
            let size = of.clamp(0.0, 1.0) / hum.share * size;
            size / (size + gap.systematic.max(0.0) + irreproducible)
        };
        report.axes.push(Axis {
            axis: "frequency".to_owned(),
            share: share(hum.share),
            interval: [share(hum.share - hum.half), share(hum.share + hum.half)],
            bins: Vec::new(),
            alike: Vec::new(),
        });
        report.axes.sort_by(|a, b| b.share.total_cmp(&a.share));
        let mains = hum::mains(hum.frequency, skin.rate);
        report.warnings.push(format!(
            "{} % of the energy of untouched frames is a hum that shows at {} Hz{}: {} % of what the readings do, which counts as noise below; \
             look at mains, motors and their shielding",
            percent(hum.share),
            axes::short(hum.frequency),
            mains.map_or(String::new(), |f| format!(", as mains of {f} Hz do in these frames")),
            percent(*size)
        ));
    }
    report.gap = Some(gap.clone());
    let none = gap.interval[1] < options.select.margin && !restless;
    let hum = hum.map(|(hum, size)| humming(hum, size, &skin.unit));
    let taken = taken + hum.as_ref().map_or(0.0, |(named, _)| named.gain);
    if none
        && fixed.is_empty()
        && let Some((named, effect)) = hum
    {
        report.verdict = Verdict::Named;
        report.sentence = format!(
            "No gap between model and presses that matters, but interference: {}.",
            report.warnings.last().map_or("", |w| w)
        );
        report.effects = vec![named];
        report.corrected = vec![effect];
        report.provenance.seconds[1] = begun.elapsed().as_secs_f64() - seconds;
        let corrected = simulator.with(&report.corrected);
        return Ok(Diagnosis { report, corrected });
    }
    if none && fixed.is_empty() {
        report.verdict = Verdict::NoGapBeyondNoise;
        report.sentence = format!(
            "No gap beyond noise: at most {} % of what the readings do is not in the nominal model, and below {} % it does not matter.",
            percent(gap.interval[1].max(0.0)),
            percent(options.select.margin)
        );
        report.provenance.seconds[1] = begun.elapsed().as_secs_f64() - seconds;
        return Ok(Diagnosis { report, corrected: skin.clone() });
    }

    let data = Data {
        simulator,
        recording,
        rows: &rows,
        readings: &readings,
        sigma: &sigma,
        signatures: &signatures,
        gap: &gap,
        options,
    };
    // Where not even the sign of the systematic part is known there is nothing to explain.
    let established = restless || (gap.interval[0] > 0.0 && gap.systematic >= UNSYSTEMATIC * gap.fvu_before);
    let found = if none || !established { Found::default() } else { data.causes(&beside, &whitened)? };
    let gap = found.gap.clone().unwrap_or(gap);
    report.gap = Some(gap.clone());
    let mut effects = certain;
    let sure = effects.len();
    effects.extend(found.named);
    report.warnings.extend(found.warnings);
    report.closure = found.closure;
    report.held_out = found.held_out;
    let certainly = fixed.len();
    report.corrected = fixed.into_iter().chain(found.effects).collect();
    // What does not hold on other contacts explains nothing: all of the gap is left.
    let holds = found.library >= NAMED * gap.systematic;
    let left = found.left.filter(|_| holds).unwrap_or_else(|| whitened.clone());
    let mut share = (found.library / gap.systematic.max(1e-12)).clamp(0.0, 1.0);
    {
        let view = view(&rows, &left, &modelled, &sigma, &gap);
        report.maps.push(axes::map(&view, &surface));
        let systematic = gap.systematic.max(1e-12);
        // What differs from press to press has to go as well.
        if restless && holds {
            let still = |residual: &[f32]| {
                let measured = measure(residual, &scaled, &rows, &sigma, options);
                measured.systematic.max(0.0) + measured.irreproducible.unwrap_or(0.0)
            };
            share = share.min(1.0 - still(&left) / still(&whitened).max(1e-12)).max(0.0);
        }
        // Of all of the gap, with what certain effects have taken away; a rest that does not matter is none.
        let rest = if none { 0.0 } else { systematic / (systematic + taken) };
        report.unknown = Unknown {
            share: (rest * (1.0 - share)).max(0.0),
            library: 1.0 - rest * (1.0 - share),
            form: rest * ((found.both - found.library) / systematic).clamp(0.0, 1.0),
            explainable: explainable(&view, &gap, options.select.seed),
            fingerprint: Vec::new(),
        };
        if share < 0.8 {
            report.unknown.fingerprint =
                axes::shares(&view, &recording.sessions, options.select.seed).into_iter().take(4).collect();
            report.unknown.fingerprint.iter_mut().for_each(|a| a.bins.clear());
        }
    }
    // What the named effects make of the gap lies along the same axes, without the noise and the rest that blur them.
    if holds && share >= 0.5 {
        let made: Vec<f32> = whitened.iter().zip(&left).map(|(before, after)| before - after).collect();
        let silent = Gap { floor: 0.0, ..gap.clone() };
        let view = view(&rows, &made, &modelled, &sigma, &silent);
        let shares = axes::shares(&view, &recording.sessions, options.select.seed);
        report.axes.retain(|axis| axis.axis == "frequency");
        report.axes.extend(shares);
        report.axes.sort_by(|a, b| b.share.total_cmp(&a.share));
    }
    alias(&mut effects, &rows);
    report.suspects = suspects(&signatures.candidates, &found.selection, options.select.floor);
    report.verdict =
        verdict(&report.unknown, (sure, effects.len()), &found.selection, &gap, options.select.margin);
    if effects.len() > sure && share < NAMED {
        report.closure = None;
        report.held_out = None;
        // A name for a small part of a gap would be taken for the cause.
        for effect in &effects[sure..] {
            report.warnings.push(format!(
                "{} explains {} % of the systematic gap: too little to be named its cause",
                effect.label,
                percent(share)
            ));
        }
        effects.truncate(sure);
        report.corrected.truncate(certainly);
    }
    if let Some((named, effect)) = hum {
        report.verdict = match report.verdict {
            Verdict::Named | Verdict::Undecided => Verdict::Named,
            // Beside a hum that is larger than what presses have in common there is nothing sure to explain.
            _ if !established || none => Verdict::Named,
            _ => Verdict::NamedAndUnknown,
        };
        report.corrected.push(effect);
        effects.push(named);
    }
    // The strongest first.
    effects.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    report.effects = effects;
    report.next_experiments = experiments::rank(simulator, &found.members, &rows, &options.stop);
    report.sentence = sentence(&report);
    report.provenance.seconds[1] = begun.elapsed().as_secs_f64() - seconds;
    let corrected = simulator.with(&report.corrected);
    Ok(Diagnosis { report, corrected })
}

fn empty(simulator: &Simulator<'_>, recording: &Recording, rows: &Rows, options: &Options) -> Report {
    let test = rows.test.iter().filter(|t| **t).count();
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
            frames: recording.moments.len(),
            presses: recording.contacts(),
            rows: rows.rows.len(),
            places: [rows.groups - test, test],
            repeats: 0,
            sessions: recording.sessions.clone(),
            missing: checks::missing(recording, rows, 0),
            problems: recording.problems.clone(),
        },
        gap: None,
        axes: Vec::new(),
        channels: Vec::new(),
        maps: Vec::new(),
        parity: Vec::new(),
        effects: Vec::new(),
        suspects: Vec::new(),
        closure: None,
        held_out: None,
        unknown: Unknown::default(),
        next_experiments: Vec::new(),
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

fn unusable(mut report: Report, simulator: &Simulator<'_>) -> Diagnosis {
    report.verdict = Verdict::UnusableRecording;
    let first = report.data.problems.iter().find(|p| p.fatal);
    report.sentence = format!(
        "This recording cannot be diagnosed: {}.",
        first.map_or("it holds nothing to compare", |p| p.what.trim_end_matches('.'))
    );
    Diagnosis { report, corrected: simulator.skin.clone() }
}

/// Signatures from memory, from the disk, or simulated; and the seconds that simulating took.
fn signatures(
    simulator: &Simulator<'_>,
    recording: &Recording,
    rows: &Rows,
    options: &Options,
    memory: &Memory,
) -> Result<(Arc<Signatures>, f64), GapError> {
    let key = store::key(simulator, recording, rows);
    if let Ok(kept) = memory.kept.lock()
        && let Some(found) = kept.get(&key)
    {
        return Ok((Arc::clone(found), 0.0));
    }
    let begun = Instant::now();
    let mut seconds = 0.0;
    let stored = options.cache.as_ref().and_then(|folder| store::load(folder, &key));
    let found = match stored {
        Some(found) => found,
        None => {
            let found = Signatures::simulate(simulator, recording, rows, &options.stop, &options.progress)?;
            if let Some(folder) = &options.cache {
                store::save(folder, &key, &found)?;
            }
            seconds = begun.elapsed().as_secs_f64();
            found
        }
    };
    let found = Arc::new(found);
    if let Ok(mut kept) = memory.kept.lock() {
        kept.insert(key, Arc::clone(&found));
    }
    Ok((found, seconds))
}

/// Makes readings (rows × channels) NaN that lie at the end of their channel's range, or whose model does: how far beyond it they would
/// be nobody knows, and a fit must not take the end for a reading. `sigma` is the deviation of each channel's noise.
pub fn cut(readings: &mut [f32], nominal: &[f32], skin: &SkinDescription, sigma: &[f64]) {
    let ranges: Vec<Option<[f64; 2]>> = skin.channels().iter().map(|c| c.range).collect();
    for (i, (reading, model)) in readings.iter_mut().zip(nominal).enumerate() {
        let k = i % sigma.len();
        let Some([low, high]) = ranges[k] else { continue };
        let near = if sigma[k].is_finite() { sigma[k].min(0.01 * (high - low)) } else { 0.0 };
        let ends = |v: f64| v <= low + near || v >= high - near;
        if ends(f64::from(*reading)) || ends(f64::from(*model)) {
            *reading = f32::NAN;
        }
    }
}

fn residual(readings: &[f32], model: &[f32], sigma: &[f64]) -> Vec<f32> {
    readings
        .iter()
        .zip(model)
        .enumerate()
        .map(|(i, (y, s))| {
            let r = (f64::from(*y) - f64::from(*s)) / sigma[i % sigma.len()];
            // A channel that gives nothing has an infinite deviation; readings that were cut off are NaN.
            if r.is_finite() { r as f32 } else { 0.0 }
        })
        .collect()
}

fn whiten(readings: &[f32], sigma: &[f64]) -> Vec<f32> {
    let nothing = vec![0.0; readings.len()];
    residual(readings, &nothing, sigma)
}

fn measure(whitened: &[f32], scaled: &[f32], rows: &Rows, sigma: &[f64], options: &Options) -> Gap {
    let usable = sigma.iter().filter(|s| s.is_finite()).count();
    noise::measure(whitened, scaled, rows, usable, sigma.len(), options.select.seed)
}

fn view<'a>(rows: &'a Rows, residual: &'a [f32], model: &'a [f32], sigma: &'a [f64], gap: &Gap) -> View<'a> {
    View {
        rows,
        channels: sigma.len(),
        residual,
        model,
        sigma,
        variance: gap.variance,
        noise: gap.floor * gap.variance,
    }
}

/// Says what is being done, in so many steps.
fn stage(progress: &ProgressBar, what: &'static str, steps: usize) {
    progress.set_message(what);
    progress.set_length(steps as u64);
    progress.set_position(0);
}

/// Share of the systematic part of what is left that a smoother foresees.
fn explainable(view: &View<'_>, gap: &Gap, seed: u64) -> f64 {
    let share = unknown::explainable(view.residual, view.rows, view.channels, seed);
    let usable = view.sigma.iter().filter(|s| s.is_finite()).count().max(1);
    let all = view.residual.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>()
        / (view.rows.rows.len().max(1) * usable) as f64;
    let systematic = all - gap.floor * gap.variance;
    if systematic > 0.02 * all { (share * all / systematic).clamp(0.0, 1.0) } else { 0.0 }
}

/// `sure` effects are named by what else shows them than residuals, out of `all`.
fn verdict(
    unknown: &Unknown,
    (sure, all): (usize, usize),
    selection: &Selection,
    gap: &Gap,
    margin: f64,
) -> Verdict {
    if all > 0 {
        return if unknown.share <= REMAINDER {
            Verdict::Named
        } else if unknown.library >= NAMED || sure > 0 {
            Verdict::NamedAndUnknown
        } else if unknown.explainable >= 0.3 {
            Verdict::UnknownSystematic
        } else {
            Verdict::Unmeasured
        };
    }
    if gap.systematic < UNSYSTEMATIC * gap.fvu_before {
        // The gap is there, and another press of the same kind has another one.
        Verdict::Unmeasured
    } else if selection.form >= 0.5 * gap.systematic {
        Verdict::SimulatorForm
    } else if gap.interval[0] <= CLEARLY * margin && gap.systematic < SURELY * margin {
        Verdict::Undecided
    } else if unknown.explainable >= 0.3 {
        Verdict::UnknownSystematic
    } else {
        Verdict::Unmeasured
    }
}

/// The best five effects when they come alone.
fn suspects(candidates: &[Candidate], selection: &Selection, floor: f64) -> Vec<Suspect> {
    let mut found: Vec<Suspect> = candidates
        .iter()
        .zip(&selection.alone)
        .filter(|(_, [_, loose])| *loose >= floor)
        .map(|(c, [strict, loose])| Suspect { name: c.name.clone(), gain: *loose, beyond_form: *strict })
        .collect();
    found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    found.truncate(5);
    found
}

/// A hum as an effect that is named: its gain is its size, since no residual holds it.
fn humming(hum: hum::Hum, size: f64, unit: &str) -> (NamedEffect, Effect) {
    let effect =
        Effect::new("interference").with("amplitude", hum.amplitude).with("frequency", hum.frequency);
    let info = common_effect(&effect.name);
    let mut named = known_effect(&effect, info.map_or("", |i| i.what), unit);
    for value in &mut named.theta {
        value.unit = match info.map_or("", |i| i.unit_of(&value.name)) {
            "" => unit.to_owned(),
            other => other.to_owned(),
        };
    }
    (named.gain, named.solo, named.class[0].gain) = (size, size, size);
    (named, effect)
}

/// An effect that something else than the size of a residual shows; its gain is still to come.
fn known_effect(effect: &Effect, what: &str, unit: &str) -> NamedEffect {
    let theta = effect.parameters.iter().map(|(name, value)| Value {
        name: name.clone(),
        value: *value,
        unit: unit.to_owned(),
        interval: None,
    });
    let member = Alike { name: effect.name.clone(), gain: 0.0, p_confuse: 0.0, angle: Some(0.0), rig: false };
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

/// Readings that come in steps, and the effect of the family that makes such.
struct Coarse {
    effect: Effect,
    /// The step.
    step: f64,
    /// Readings of the model with `down`, and without steps.
    nominal: Option<Vec<f32>>,
    /// Half of a step on all channels, where the converter rounds down instead of to the nearest one.
    down: Option<Effect>,
}

/// Energy of what a converter with this step adds to what a model reads (rows × channels), a reading, in deviations of the noise. Noise
/// decides on which step a reading falls: what lies on the edge of one, as zero does where it rounds down, is off by half of it.
fn rounding(step: f64, down: bool, model: &[f32], sigma: &[f64]) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for (i, m) in model.iter().enumerate() {
        let sigma = sigma[i % sigma.len()];
        if !(step > 0.0 && sigma.is_finite() && m.is_finite()) {
            continue;
        }
        let centre = f64::from(*m);
        // A model that stands for rounding down lies half of a step lower.
        let before = if down { centre + 0.5 * step } else { centre };
        let counts = |v: f64| if down { (v / step).floor() } else { (v / step).round() };
        // The middles of six parts of equal probability.
        let off =
            [-1.383, -0.674, -0.21, 0.21, 0.674, 1.383].map(|z| step * counts(before + z * sigma) - centre);
        sum += off.iter().map(|o| o * o).sum::<f64>() / 6.0 / (sigma * sigma);
        n += 1;
    }
    sum / n.max(1) as f64
}

/// Finds the step that readings come in where it is more than their declared noise, and the family's effect with a parameter that
/// is such a step.
fn coarse(
    simulator: &Simulator<'_>,
    recording: &Recording,
    rows: &Rows,
    readings: &[f32],
    sigma: &[f64],
) -> Result<Option<Coarse>, GapError> {
    let noise = simulator.skin.channel_noise();
    let noise = noise.iter().sum::<f64>() / noise.len().max(1) as f64;
    let Some(found) = steps::step(readings).filter(|s| *s > noise) else { return Ok(None) };
    for info in simulator.effects.iter().filter(|i| !i.random) {
        for parameter in info.parameters.iter().filter(|p| p.unit == simulator.skin.unit) {
            let value = found.clamp(parameter.limits[0], parameter.limits[1]);
            let effect = Effect::new(info.name).with(parameter.name, value);
            let skin = simulator.with(std::slice::from_ref(&effect));
            let Ok(read) = simulator.readings(&skin, recording, &rows.frames()) else { continue };
            if steps::step(&read).is_none_or(|s| (s / found - 1.0).abs() > 0.02) {
                continue;
            }
            let left = |read: &[f32]| -> f64 {
                let apart = readings.iter().zip(read).map(|(r, m)| f64::from(r - m));
                let shares = apart.enumerate().map(|(i, d)| (d / sigma[i % sigma.len()]).powi(2));
                shares.filter(|s| s.is_finite()).sum()
            };
            let mut down = Effect::new("channel-offset");
            for channel in simulator.skin.channels() {
                down.parameters.insert(channel.name.clone(), -0.5 * found);
            }
            let skin = simulator.with(&[effect.clone(), down.clone()]);
            let below = simulator.readings(&skin, recording, &rows.frames()).ok();
            if below.is_none_or(|below| left(&below) >= left(&read)) {
                return Ok(Some(Coarse { effect, step: value, nominal: None, down: None }));
            }
            let skin = simulator.with(std::slice::from_ref(&down));
            let nominal = simulator.readings(&skin, recording, &rows.frames())?;
            return Ok(Some(Coarse { effect, step: value, nominal: Some(nominal), down: Some(down) }));
        }
    }
    Ok(None)
}

/// What rises and falls with the temperature or with time, for effects that do.
fn alias(effects: &mut [NamedEffect], rows: &Rows) {
    let series: [(&str, Vec<f64>); 3] = [
        ("temperature", rows.rows.iter().map(|r| r.temperature).collect()),
        ("session time", rows.rows.iter().map(|r| r.time).collect()),
        ("session", rows.rows.iter().map(|r| f64::from(r.session)).collect()),
    ];
    for effect in effects {
        if !effect.label.contains("thermal") {
            continue;
        }
        for (name, values) in &series[1..] {
            if correlation(&series[0].1, values).abs() > 0.8 {
                effect.covariate_alias.push(format!("anything that follows the {name}"));
            }
        }
    }
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().max(1) as f64;
    let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        xy += (x - ma) * (y - mb);
        xx += (x - ma).powi(2);
        yy += (y - mb).powi(2);
    }
    xy / (xx * yy).sqrt().max(1e-300)
}

pub(crate) fn percent(share: f64) -> String {
    axes::short(100.0 * share)
}

/// One sentence that a person can act on.
fn sentence(report: &Report) -> String {
    let Some(gap) = &report.gap else { return String::new() };
    let list = |names: &[&str]| match names {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [all @ .., last] => format!("{} or {last}", all.join(", ")),
    };
    let size = format!("{} % of what the readings do", percent(gap.systematic.max(0.0)));
    let names: Vec<String> = report
        .effects
        .iter()
        .map(|e| {
            let mut class: Vec<&str> = e.class.iter().map(|a| a.name.as_str()).collect();
            if e.tier == Tier::Loose {
                class.push("the simulator's own error");
            }
            list(&class)
        })
        .collect();
    let place = || {
        let axis = report.axes.first().filter(|a| a.share > 0.1);
        axis.map_or(String::new(), |a| format!(", mostly along {}", a.axis))
    };
    let next = report.next_experiments.first().map_or(String::new(), |e| format!(" Next: {}.", e.what));
    let closes = report.closure.map_or(String::new(), |c| {
        let share = c.achieved.unwrap_or(c.predicted);
        format!(
            "; switching it on closes {} % of the gap on held-out contacts ({} to {} %)",
            percent(share),
            percent(c.interval[0]),
            percent(c.interval[1])
        )
    });
    match report.verdict {
        Verdict::Named => format!("The gap ({size}) is {}{closes}.{next}", names.join(", and ")),
        Verdict::NamedAndUnknown => format!(
            "{} make {} % of the gap ({size}){closes}; the rest is none of the known effects.{next}",
            names.join(", and "),
            percent(report.unknown.library)
        ),
        Verdict::SimulatorForm => format!(
            "The gap ({size}) is within what the simulator's own tolerances allow: measure the numbers of the medium before you \
             look for an effect."
        ),
        Verdict::Undecided => format!(
            "The gap ({size}, surely between {} and {} %) may be too small to matter: press more places, or harder, before you look for \
             its cause.",
            percent(gap.interval[0].max(0.0)),
            percent(gap.interval[1])
        ),
        Verdict::UnknownSystematic => format!(
            "The gap ({size}) is systematic{}, and none of the known effects makes it: look at its fingerprint before you trust a \
             simulation.",
            place()
        ),
        Verdict::Unmeasured => match gap.irreproducible.filter(|share| *share > 0.5 * gap.fvu_before) {
            Some(share) => format!(
                "Readings differ from press to press by {} % of what they do where the presses were done alike, and hardly \
                 otherwise ({} %): no deterministic model removes that; look at the rig, and record what changes between presses.",
                percent(share),
                percent(gap.systematic.max(0.0))
            ),
            None => format!(
                "The gap ({size}) follows nothing that was recorded: repeat presses, and record temperature and time."
            ),
        },
        Verdict::NoGapBeyondNoise | Verdict::UnusableRecording => report.sentence.clone(),
    }
}

/// Causes and what they come to.
#[derive(Default)]
struct Found {
    /// The gap, where it is more than what presses have in common.
    gap: Option<Gap>,
    named: Vec<NamedEffect>,
    effects: Vec<Effect>,
    closure: Option<Closure>,
    held_out: Option<[f64; 3]>,
    /// Reduction by named effects, and with the simulator's own error.
    library: f64,
    both: f64,
    selection: Selection,
    /// Whitened residual after the named effects.
    left: Option<Vec<f32>>,
    /// Members of the first class that is open, each as effects.
    members: Vec<(String, Vec<Effect>)>,
    warnings: Vec<String>,
}

/// An effect with values, and what the full simulator makes of it.
#[derive(Clone)]
struct Tried {
    candidate: usize,
    effects: Vec<Effect>,
    /// What it leaves, in deviations of the noise.
    left: Vec<f32>,
    /// The energy of it in training, with the simulator's own error making the best of it.
    energy: f64,
    /// How badly its model does ([`Selector::weigh`]).
    score: f64,
    values: Vec<Value>,
}

/// Effects with their values, what the full simulator reads with them, and half of the interval of each number.
type Refined = (Vec<Effect>, Vec<f32>, Vec<(Free, f64)>);

struct Data<'a> {
    simulator: &'a Simulator<'a>,
    recording: &'a Recording,
    rows: &'a Rows,
    readings: &'a [f32],
    sigma: &'a [f64],
    signatures: &'a Signatures,
    gap: &'a Gap,
    options: &'a Options,
}

impl Data<'_> {
    fn channels(&self) -> usize {
        self.sigma.len()
    }

    fn usable(&self) -> f64 {
        self.sigma.iter().filter(|s| s.is_finite()).count() as f64
    }

    /// Energy of readings about their means over groups with these weights.
    fn scale(&self, weights: &[f64]) -> f64 {
        let rows: f64 = self.rows.rows.iter().map(|r| weights[r.group]).sum();
        rows * self.usable() * self.gap.variance
    }

    /// Whitened energy that is left in each group.
    fn group_losses(&self, left: &[f32]) -> Vec<f64> {
        let mut losses = vec![0.0; self.rows.groups];
        for (row, r) in self.rows.rows.iter().zip(left.chunks_exact(self.channels())) {
            losses[row.group] += r.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        }
        losses
    }

    /// What simulated readings leave, and the energy of it in training with the simulator's own error making the best of it.
    fn leaves(&self, simulated: &[f32], weights: &[f64], form: &Form) -> (Vec<f32>, f64) {
        let (_, energy) = self.target(weights, form, &self.options.progress).residual(simulated);
        (residual(self.readings, simulated, self.sigma), energy)
    }

    fn target<'b>(&'b self, weights: &'b [f64], form: &'b Form, progress: &'b ProgressBar) -> Target<'b> {
        Target {
            form,
            recording: self.recording,
            rows: self.rows,
            readings: self.readings,
            sigma: self.sigma,
            weights,
            stop: &self.options.stop,
            progress,
        }
    }

    fn selector<'b>(&'b self, statistics: &'b Statistics, gram: &'b Gram, weights: &[f64]) -> Selector<'b> {
        Selector::new(
            statistics,
            &self.signatures.candidates,
            &self.signatures.form,
            gram,
            (self.scale(weights), self.gap.systematic.max(0.0), self.gap.interval[0]),
            weights,
            &self.options.select,
        )
    }

    fn causes(&self, fixed: &[Effect], whitened: &[f32]) -> Result<Found, GapError> {
        let declared = self.simulator.skin.channel_noise();
        let columns: Vec<Column> = self
            .signatures
            .columns
            .iter()
            .map(|c| rescale(c, &declared, self.sigma, self.readings))
            .collect();
        let statistics = Statistics::new(&columns, whitened, self.rows, self.channels());
        let gram = Gram::of(&statistics);
        let weights = self.rows.training();
        let progress = &self.options.progress;
        stage(progress, "comparing effects", 0);
        let training = self.selector(&statistics, &gram, &weights).watched(&self.options.stop, progress);
        let selection = training.select();
        if self.options.stop.load(Ordering::Relaxed) {
            return Err(GapError::Interrupted);
        }
        // What differs between presses that were done alike, and goes away with the effects, is a part of the gap that these make: they go
        // with time or temperature.
        if let Some(part) = self.gap.irreproducible.filter(|_| !selection.picks.is_empty()) {
            let set: Vec<usize> = selection.picks.iter().map(|p| p.candidate).collect();
            let left = self.without(whitened, &columns, training.fit_all(&set, Tier::Loose).terms());
            let scaled = whiten(self.readings, self.sigma);
            let still = measure(&left, &scaled, self.rows, self.sigma, self.options).irreproducible;
            let part = part - still.unwrap_or(part);
            if part > 0.0 {
                let mut gap = self.gap.clone();
                gap.counts_as_noise(-part);
                gap.irreproducible = still;
                let again = Data { gap: &gap, ..*self };
                let mut found =
                    again.explained((fixed, whitened), &columns, (&statistics, &gram), selection)?;
                found.gap = Some(gap);
                return Ok(found);
            }
        }
        self.explained((fixed, whitened), &columns, (&statistics, &gram), selection)
    }

    /// What a selection comes to on the full simulator, and how much of the gap it closes.
    fn explained(
        &self,
        (fixed, whitened): (&[Effect], &[f32]),
        columns: &[Column],
        (statistics, gram): (&Statistics, &Gram),
        selection: Selection,
    ) -> Result<Found, GapError> {
        let candidates = &self.signatures.candidates;
        let weights = self.rows.training();
        let training = self.selector(statistics, gram, &weights);
        let mut found = Found { library: selection.library, both: selection.both, ..Found::default() };
        if selection.picks.is_empty() {
            found.selection = selection;
            return Ok(found);
        }
        let set: Vec<usize> = selection.picks.iter().map(|p| p.candidate).collect();
        let fit = training.fit_all(&set, Tier::Loose);

        let form = {
            let own: Vec<&Column> = self.signatures.form.iter().map(|c| &columns[*c]).collect();
            let prior = self.signatures.form.first().map_or(1.0, |f| training.prior(*f));
            Form::new(&own, self.rows, self.channels(), &weights, prior)
        };
        stage(&self.options.progress, "fitting values", 0);
        // Each named effect with values on the full simulator, beside what else may be meant.
        let before: f64 = (0..self.rows.groups).map(|g| statistics.energy(g) * weights[g]).sum();
        let mut tried: Vec<Vec<Tried>> = Vec::new();
        for (i, pick) in selection.picks.iter().enumerate() {
            // What linear signatures put behind may be before once it is simulated in full.
            let mut others: Vec<&Member> = pick.class.iter().collect();
            // What another one is named needs no second name.
            let taken = |c: usize| tried.iter().any(|t: &Vec<Tried>| t.iter().any(|t| t.candidate == c));
            others.retain(|m| m.candidate == pick.candidate || !taken(m.candidate));
            others.truncate(self.options.polish.max(1));
            let mut beside = fixed.to_vec();
            // What cannot be written is taken out of the readings as its signature says.
            let mut unwritten: Vec<usize> = Vec::new();
            for (j, other) in selection.picks.iter().enumerate().filter(|(j, _)| *j != i) {
                let done = tried.get(j).map(|t| t.first().map_or_else(Vec::new, |t| t.effects.clone()));
                let linear = || self.written(self.linear(columns, other.candidate, &fit, &weights));
                let effects = done.unwrap_or_else(linear);
                if effects.is_empty() {
                    unwritten.extend(&candidates[other.candidate].columns);
                }
                Effect::merge(&mut beside, effects);
            }
            let readings = self.without_columns(columns, &fit, &unwritten);
            let alone = Data { readings: &readings, ..*self };
            let mut of = Vec::new();
            let mut open: Vec<Member> = Vec::new();
            for member in others {
                let candidate = member.candidate;
                let model: Vec<usize> =
                    set.iter().map(|c| if *c == pick.candidate { candidate } else { *c }).collect();
                let refit = if candidate == pick.candidate {
                    fit.clone()
                } else {
                    training.fit_all(&model, Tier::Loose)
                };
                match alone.tried(columns, candidate, &refit, &beside, (&weights, &form), statistics) {
                    Ok(Some(mut one)) => {
                        one.score = training.weigh(one.energy, 0.0, &model);
                        of.push(one);
                    }
                    Ok(None) => open.push(member.clone()),
                    Err(GapError::Interrupted) => return Err(GapError::Interrupted),
                    Err(error) => {
                        found.warnings.push(format!("{}: {error}", candidates[candidate].name));
                        open.push(member.clone());
                    }
                }
            }
            // Those that cannot be simulated are where their signatures put them beside what is simulated in full.
            if !open.is_empty() && selection.picks.len() > 1 {
                let skin = self.simulator.with(&beside);
                let read = self.simulator.readings(&skin, self.recording, &self.rows.frames())?;
                let rest = residual(&readings, &read, self.sigma);
                let rest = Statistics::new(columns, &rest, self.rows, self.channels());
                let selector = self.selector(&rest, gram, &weights).measured_as(&training);
                let others: Vec<usize> = set.iter().copied().filter(|c| *c != pick.candidate).collect();
                for member in &mut open {
                    member.score = selector.score(&[member.candidate]) + training.weigh(0.0, 0.0, &others);
                }
            }
            found.named.push(self.name(pick, &mut of, &open, before));
            // The label decides what the others stand beside: the first, or none where it cannot be written.
            let label = found.named.last().map(|n| n.label.clone()).unwrap_or_default();
            if of.first().is_some_and(|t| candidates[t.candidate].name != label) {
                of.clear();
            }
            tried.push(of);
        }
        let mut set = set;
        self.dropped((&mut found, &mut tried, &mut set), fixed, columns, (statistics, &training), &form)?;
        let fit = training.fit_all(&set, Tier::Loose);
        let mut effects: Vec<Effect> = Vec::new();
        for of in &tried {
            if let Some(first) = of.first() {
                Effect::merge(&mut effects, first.effects.clone());
            }
        }
        if effects.is_empty() {
            found.warnings.push(
                "none of the named effects can be written into a skin description: the closure is that of its signature"
                    .to_owned(),
            );
        }
        let unwritten: Vec<usize> = set
            .iter()
            .zip(&tried)
            .filter(|(_, of)| of.is_empty())
            .flat_map(|(c, _)| candidates[*c].columns.iter().copied())
            .collect();
        let readings = self.without_columns(columns, &fit, &unwritten);
        let rest = Data { readings: &readings, ..*self };
        rest.close(&mut found, &effects, fixed, (statistics, gram), &training, &set, &weights)?;
        if let Some((_, of)) =
            found.named.iter().zip(&tried).find(|(n, of)| n.class.len() > 1 && of.len() > 1)
        {
            found.members =
                of.iter().map(|t| (candidates[t.candidate].name.clone(), t.effects.clone())).collect();
        }
        if found.left.is_none() {
            found.left = Some(self.without(whitened, columns, fit.terms()));
        }
        found.effects = effects;
        found.selection = selection;
        Ok(found)
    }

    /// Drops effects that the others, fitted again on the full simulator, do as well without: signatures are linear, and what is large
    /// may have needed one more of them.
    fn dropped(
        &self,
        (found, tried, set): (&mut Found, &mut Vec<Vec<Tried>>, &mut Vec<usize>),
        fixed: &[Effect],
        columns: &[Column],
        (statistics, training): (&Statistics, &Selector<'_>),
        form: &Form,
    ) -> Result<(), GapError> {
        let weights = self.rows.training();
        let Some(mut score) = tried.last().and_then(|of| of.first()).map(|t| t.score) else { return Ok(()) };
        let mut i = 0;
        while set.len() > 1 && i < set.len() && tried.iter().all(|of| !of.is_empty()) {
            // The others, the strongest of them fitted again.
            let again = (0..set.len())
                .filter(|j| *j != i)
                .max_by(|a, b| found.named[*a].gain.total_cmp(&found.named[*b].gain));
            let Some(again) = again else { return Ok(()) };
            let mut beside = fixed.to_vec();
            for (_, of) in tried.iter().enumerate().filter(|(j, _)| *j != i && *j != again) {
                Effect::merge(&mut beside, of[0].effects.clone());
            }
            let candidate = tried[again][0].candidate;
            let named = |j: usize| if j == again { candidate } else { set[j] };
            let model: Vec<usize> = (0..set.len()).filter(|j| *j != i).map(named).collect();
            let fit = training.fit_all(&model, Tier::Loose);
            match self.tried(columns, candidate, &fit, &beside, (&weights, form), statistics) {
                Ok(Some(mut one)) => {
                    one.score = training.weigh(one.energy, 0.0, &model);
                    if one.score <= score {
                        score = one.score;
                        found.named[again].theta.clone_from(&one.values);
                        tried[again][0] = one;
                        tried.remove(i);
                        found.named.remove(i);
                        set.remove(i);
                        continue;
                    }
                }
                Ok(None) => return Ok(()),
                Err(GapError::Interrupted) => return Err(GapError::Interrupted),
                // What it would be without the other no device can have.
                Err(_) => {}
            }
            i += 1;
        }
        Ok(())
    }

    /// Effects of a linear fit, none where no device can have them: a place beside the surface, say.
    fn written(&self, effects: Vec<Effect>) -> Vec<Effect> {
        let skin = self.simulator.with(&effects);
        let first: Vec<usize> = self.rows.frames().into_iter().take(1).collect();
        let possible = self.simulator.readings(&skin, self.recording, &first).is_ok();
        if possible { effects } else { Vec::new() }
    }

    /// Readings without what a fit makes of these columns.
    fn without_columns(&self, columns: &[Column], fit: &Fit, of: &[usize]) -> Vec<f32> {
        let nothing = vec![0.0; self.readings.len()];
        let less = self.without(&nothing, columns, fit.terms().filter(|(c, _)| of.contains(c)));
        let scaled = less.iter().zip(self.sigma.iter().cycle());
        let moved = scaled.map(|(l, sigma)| if sigma.is_finite() { l * *sigma as f32 } else { 0.0 });
        self.readings.iter().zip(moved).map(|(r, m)| r + m).collect()
    }

    /// A residual without what a fit makes of it.
    fn without(
        &self,
        residual: &[f32],
        columns: &[Column],
        terms: impl Iterator<Item = (usize, f64)>,
    ) -> Vec<f32> {
        let mut left = residual.to_vec();
        let channels = self.channels();
        for (column, x) in terms {
            let (column, x) = (&columns[column], x as f32);
            match column.channel {
                Some(k) => {
                    let own = left.iter_mut().skip(k).step_by(channels);
                    own.zip(&column.values).for_each(|(l, v)| *l -= x * v);
                }
                None => left.iter_mut().zip(&column.values).for_each(|(l, v)| *l -= x * v),
            }
        }
        left
    }

    /// Closure: predicted by what was fitted, achieved on what was kept, and its interval.
    #[allow(clippy::too_many_arguments)]
    fn close(
        &self,
        found: &mut Found,
        effects: &[Effect],
        fixed: &[Effect],
        (statistics, gram): (&Statistics, &Gram),
        training: &Selector<'_>,
        set: &[usize],
        weights: &[f64],
    ) -> Result<(), GapError> {
        let test: Vec<f64> = weights.iter().map(|w| 1.0 - w).collect();
        let floor = |weights: &[f64]| self.gap.floor * self.scale(weights);
        let before: Vec<f64> = (0..self.rows.groups).map(|g| statistics.energy(g)).collect();
        let closure = |losses: &[f64], weights: &[f64]| {
            let sum = |l: &[f64]| l.iter().zip(weights).map(|(l, w)| l * w).sum::<f64>();
            let (b, a) = (sum(&before), sum(losses));
            (b - a) / (b - floor(weights)).max(0.05 * b)
        };
        let fit = training.fit_all(set, Tier::Loose);
        let linear: Vec<f64> = (0..self.rows.groups).map(|g| statistics.loss(g, &fit)).collect();
        // What cross-validation loses against the fit itself.
        let optimism = closure(&linear, weights)
            - found.library * self.scale(weights)
                / (before.iter().zip(weights).map(|(b, w)| b * w).sum::<f64>() - floor(weights)).max(1e-9);
        let mut predicted = closure(&linear, weights) - optimism.max(0.0);
        let mut achieved = None;
        let mut after = linear.clone();
        if !effects.is_empty() {
            let mut all = fixed.to_vec();
            Effect::merge(&mut all, effects.to_vec());
            let skin = self.simulator.with(&all);
            let read = self.simulator.readings(&skin, self.recording, &self.rows.frames())?;
            let left = residual(self.readings, &read, self.sigma);
            after = self.group_losses(&left);
            predicted = closure(&after, weights) - optimism.max(0.0);
            achieved = Some(closure(&after, &test));
            found.left = Some(left);
            // What holds on contacts that nothing was fitted to is what is explained.
            let form = found.both - found.library;
            let closed = achieved.unwrap_or(0.0);
            if found.library - closed * self.gap.systematic > APART * self.gap.systematic {
                for named in &mut found.named {
                    named.tier = Tier::Loose;
                }
                found.warnings.push(format!(
                    "to first order the named effects explain {} % of the systematic gap, and switched on they close {} %: what makes it is \
                     like them, and may be another",
                    percent(found.library / self.gap.systematic),
                    percent(closed)
                ));
            }
            // Where the words of a skin description say an effect badly, its signature still does; where they are no help at all
            // on other contacts, it was none.
            let signature = if closed > HELPS { found.library } else { 0.0 };
            found.library = signature.max(closed * self.gap.systematic);
            found.both = found.library + form.max(0.0);
        }
        // The whole way again on other draws of places: selection, fit, and what is kept.
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.select.seed ^ 0xb007);
        let train: Vec<usize> = (0..weights.len()).filter(|g| weights[*g] > 0.0).collect();
        let kept: Vec<usize> = (0..weights.len()).filter(|g| weights[*g] == 0.0).collect();
        // The floor is an estimate, too: nothing closes more than all.
        predicted = predicted.min(1.0);
        let achieved = achieved.map(|a| a.min(1.0));
        let centre = achieved.unwrap_or(predicted);
        let mut draw = |from: &[usize]| {
            let mut weights = vec![0.0; weights.len()];
            for _ in 0..from.len() {
                weights[from[rng.random_range(0..from.len())]] += 1.0;
            }
            weights
        };
        let draws: Vec<[Vec<f64>; 2]> =
            (0..self.options.resamples).map(|_| [draw(&train), draw(&kept)]).collect();
        stage(&self.options.progress, "drawing other places", self.options.resamples);
        let again = |[again, ends]: &[Vec<f64>; 2]| {
            if self.options.stop.load(Ordering::Relaxed) {
                return None;
            }
            let selector = self.selector(statistics, gram, again);
            let picks: Vec<usize> = selector.quick();
            let fit = selector.fit_all(&picks, Tier::Loose);
            let losses: Vec<f64> = (0..self.rows.groups).map(|g| statistics.loss(g, &fit)).collect();
            self.options.progress.inc(1);
            // How far this draw is from the one at hand, by the same linear signatures; and what other contacts would give.
            let moved = closure(&losses, &test) - closure(&linear, &test);
            Some(moved + closure(&after, ends) - closure(&after, &test))
        };
        // Two threads, as all simulations have.
        let (first, last) = draws.split_at(draws.len() / 2);
        let drawn: Option<Vec<f64>> = std::thread::scope(|scope| {
            let other = scope.spawn(|| last.iter().map(again).collect::<Option<Vec<f64>>>());
            let mut found = first.iter().map(again).collect::<Option<Vec<f64>>>()?;
            match other.join() {
                Ok(more) => found.extend(more?),
                Err(panic) => std::panic::resume_unwind(panic),
            }
            Some(found)
        });
        let drawn = drawn.ok_or(GapError::Interrupted)?;
        let n = drawn.len().max(1) as f64;
        let spread = (drawn.iter().map(|d| d * d).sum::<f64>() / n).sqrt();
        // Other presses meet the laws elsewhere, and the floor is an estimate.
        let doubt = FLOOR_ERROR * floor(&test)
            / (before.iter().zip(&test).map(|(b, w)| b * w).sum::<f64>() - floor(&test)).max(1e-300);
        // What depends on the past meets another one, and what goes its own way through time goes another one: switched on there, it is
        // wrong twice.
        let share = |of: &dyn Fn(&str) -> bool| {
            let of = found.named.iter().filter(|named| of(&named.label)).map(|named| named.shapley);
            of.sum::<f64>().clamp(0.0, 1.0) * centre.max(0.0)
        };
        let past = HISTORY * share(&|name| self.remembers(name));
        let candidates = &self.signatures.candidates;
        let other = 2.0 * share(&|name| candidates.iter().any(|c| c.name == name && c.wanders));
        let parts = [1.645 * spread, centre - predicted, ELSEWHERE, doubt.clamp(0.0, 1.0), past];
        let half = parts.iter().map(|p| p * p).sum::<f64>().sqrt();
        let interval = [centre - half - other, (centre + half).min(1.0)];
        found.closure = Some(Closure { predicted, achieved, interval });
        let share = |losses: &[f64]| {
            losses.iter().zip(&test).map(|(l, w)| l * w).sum::<f64>() / self.scale(&test).max(1e-300)
        };
        found.held_out = Some([share(&before), share(&after), self.gap.floor]);
        Ok(())
    }

    /// Whether what an effect does depends on what was before.
    fn remembers(&self, name: &str) -> bool {
        self.simulator.effects.iter().any(|info| info.name == name && info.stateful)
            || common_effect(name).is_some_and(|common| common.stateful)
    }

    /// Names an effect: the label may change, where the full simulator says so.
    fn name(
        &self,
        pick: &crate::select::Pick,
        tried: &mut Vec<Tried>,
        linear: &[Member],
        before: f64,
    ) -> NamedEffect {
        let candidates = &self.signatures.candidates;
        let open = 2.0 * self.options.select.odds.ln();
        let chance = |worse: f64| 1.0 / (1.0 + (0.5 * worse).min(300.0).exp());
        tried.sort_by(|a, b| a.score.total_cmp(&b.score));
        let best = tried.first().map_or(f64::INFINITY, |t| t.score);
        let best = linear.iter().map(|m| m.score).fold(best, f64::min);
        tried.retain(|t| t.score - best < open);
        let weights = self.rows.training();
        let gain = |t: &Tried| {
            let left: f64 = self.group_losses(&t.left).iter().zip(&weights).map(|(l, w)| l * w).sum();
            (before - left) / self.scale(&weights)
        };
        let angle = |candidate: usize| {
            pick.class.iter().find(|m| m.candidate == candidate).map_or(f64::NAN, |m| m.angle)
        };
        let mut class: Vec<(usize, f64, f64, f64)> = tried
            .iter()
            .map(|t| (t.candidate, gain(t), chance(t.score - best), angle(t.candidate)))
            .collect();
        for member in linear.iter().filter(|m| m.score - best < open) {
            class.push((member.candidate, member.gain, chance(member.score - best), member.angle));
        }
        class.sort_by(|a, b| b.2.total_cmp(&a.2));
        let label = class.first().map_or(pick.candidate, |c| c.0);
        let candidate = &candidates[label];
        let values =
            tried.first().filter(|t| t.candidate == label).map_or_else(Vec::new, |t| t.values.clone());
        let written = tried.first().is_some_and(|t| t.candidate == label && !t.effects.is_empty());
        NamedEffect {
            label: candidate.name.clone(),
            what: candidate.what.clone(),
            p_confuse: class.iter().skip(1).map(|c| c.2).fold(0.0, f64::max),
            class: class
                .iter()
                .map(|(c, gain, p, angle)| Alike {
                    name: candidates[*c].name.clone(),
                    gain: *gain,
                    p_confuse: *p,
                    angle: Some(angle.to_degrees()).filter(|a| a.is_finite()),
                    rig: candidates[*c].rig,
                })
                .collect(),
            covers: pick.covers.iter().map(|c| candidates[*c].name.clone()).collect(),
            tier: pick.tier,
            theta: values,
            gain: pick.gain,
            solo: pick.solo,
            shapley: pick.shapley,
            p_max_t: pick.p,
            covariate_alias: Vec::new(),
            written,
        }
    }

    /// An effect with values, simulated in full; `None` where it cannot be written down.
    fn tried(
        &self,
        columns: &[Column],
        candidate: usize,
        fit: &Fit,
        beside: &[Effect],
        (weights, form): (&[f64], &Form),
        statistics: &Statistics,
    ) -> Result<Option<Tried>, GapError> {
        let of = &self.signatures.candidates[candidate];
        let own = self.linear(columns, candidate, fit, weights);
        if of.starts.is_empty() || !of.linear.is_empty() {
            if own.is_empty() {
                return Ok(None);
            }
            let (own, read, fitted) = self.refined(own, beside, weights, form)?;
            let halves = half_widths(statistics, fit, &of.columns, weights);
            let mut values = Vec::new();
            for effect in &own {
                for (name, value) in &effect.parameters {
                    let unit = common_effect(&effect.name).map_or("", |c| c.unit_of(name));
                    let unit = if unit.is_empty() { self.simulator.skin.unit.as_str() } else { unit };
                    let at = of.linear.iter().position(|(e, p, _)| *e == effect.name && p == name);
                    let half = fitted
                        .iter()
                        .find(|(f, _)| f.effect == effect.name && f.parameter == *name)
                        .map(|(_, half)| *half)
                        .or_else(|| at.filter(|_| !of.timed).map(|i| halves[i] * of.linear[i].2.abs()));
                    values.push(Value {
                        name: if own.len() > 1 {
                            format!("{} of {}", name, effect.name)
                        } else {
                            name.clone()
                        },
                        value: *value,
                        unit: unit.to_owned(),
                        interval: half.filter(|h| h.is_finite()).map(|h| [value - h, value + h]),
                    });
                }
            }
            let (left, energy) = self.leaves(&read, weights, form);
            return Ok(Some(Tried { candidate, effects: own, left, energy, score: f64::INFINITY, values }));
        }
        let Some(info) = self.simulator.effects.iter().find(|i| i.name == of.name) else { return Ok(None) };
        if info.random {
            return Ok(None);
        }
        let free: Vec<Free> = polish::free(info);
        let starts: Vec<Vec<Effect>> = self
            .starts(columns, of, fit)
            .into_iter()
            .map(|effect| {
                let mut all = beside.to_vec();
                Effect::merge(&mut all, [effect]);
                all
            })
            .collect();
        let target = self.target(weights, form, &self.options.progress);
        let (starts, free) = if self.options.polish == 0 {
            (starts.into_iter().take(1).collect(), Vec::new())
        } else {
            (starts, free)
        };
        let polished = polish::polish(self.simulator, &target, &starts, &free)?;
        let effect = polished.effects.iter().find(|e| e.name == of.name).cloned();
        let Some(effect) = effect else { return Ok(None) };
        let values = info
            .parameters
            .iter()
            .map(|p| {
                let value = info.value(&effect, p.name);
                let half = free.iter().position(|f| f.parameter == p.name);
                let half = half.and_then(|i| polished.halves.get(i)).copied().filter(|h| h.is_finite());
                let interval = half.map(|h| [value - h, value + h]);
                Value { name: p.name.to_owned(), value, unit: p.unit.to_owned(), interval }
            })
            .collect();
        let (left, energy) = self.leaves(&polished.readings, weights, form);
        Ok(Some(Tried { candidate, effects: vec![effect], left, energy, score: f64::INFINITY, values }))
    }

    /// Effects with values of a linear fit, fitted on the full simulator where they have few of them: what is linear in small
    /// (a shift, a delay) is not in large, and a parameter that hardly shows must not run away. Their readings beside `beside`,
    /// and half of the 90 % interval of what was fitted.
    fn refined(
        &self,
        own: Vec<Effect>,
        beside: &[Effect],
        weights: &[f64],
        form: &Form,
    ) -> Result<Refined, GapError> {
        let period = 1.0 / self.simulator.skin.rate;
        let free: Vec<Free> = own.iter().flat_map(|e| polish::free_common(e, period)).collect();
        let with = |own: &[Effect]| {
            let mut all = beside.to_vec();
            Effect::merge(&mut all, own.iter().cloned());
            all
        };
        if free.is_empty() || self.options.polish == 0 {
            let skin = self.simulator.with(&with(&own));
            let read = self.simulator.readings(&skin, self.recording, &self.rows.frames())?;
            return Ok((own, read, Vec::new()));
        }
        let mut neutral = own.clone();
        for effect in &mut neutral {
            for f in free.iter().filter(|f| f.effect == effect.name) {
                effect.parameters.insert(f.parameter.clone(), f.typical);
            }
        }
        let starts: Vec<Vec<Effect>> = [&own, &neutral].into_iter().map(|e| with(e)).collect();
        let polished = polish::polish(
            self.simulator,
            &self.target(weights, form, &self.options.progress),
            &starts,
            &free,
        )?;
        let fitted =
            own.iter().filter_map(|e| polished.effects.iter().find(|p| p.name == e.name).cloned()).collect();
        Ok((fitted, polished.readings, free.into_iter().zip(polished.halves).collect()))
    }

    /// Realisations that are nearest to what the linear fit says, the nearest first.
    fn starts(&self, columns: &[Column], of: &Candidate, fit: &Fit) -> Vec<Effect> {
        let theta: Vec<f64> = of.columns.iter().map(|c| fit.of(*c)).collect();
        let norms: Vec<f64> = of
            .columns
            .iter()
            .map(|c| crate::algebra::dot(&columns[*c].values, &columns[*c].values))
            .collect();
        let inner =
            |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).zip(&norms).map(|((a, b), n)| a * b * n).sum() };
        let mut ranked: Vec<(f64, &Effect)> = of
            .starts
            .iter()
            .map(|(effect, at)| {
                let away: Vec<f64> = theta.iter().zip(at).map(|(t, a)| t - a).collect();
                (inner(&away, &away), effect)
            })
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found: Vec<Effect> = ranked.into_iter().take(8).map(|(_, e)| e.clone()).collect();
        // A strength that is not 1 is what the file said; values are fitted at full strength.
        found.iter_mut().for_each(|e| e.strength = 1.0);
        found
    }

    /// What goes home from switching on: the columns say the way of each channel and of all, a file its start and one time for all.
    fn warming(&self, columns: &[Column], of: &Candidate, coefficient: &dyn Fn(usize) -> f64) -> Vec<Effect> {
        let n = self.rows.rows.len();
        let parts: Vec<(&str, f64, &Column, f32)> = of
            .columns
            .iter()
            .zip(&of.linear)
            .map(|(&c, (_, name, amount))| (name.as_str(), *amount, &columns[c], coefficient(c) as f32))
            .collect();
        let mut names: Vec<&str> = Vec::new();
        let mut ways: Vec<Vec<f32>> = Vec::new();
        let mut units: Vec<f64> = Vec::new();
        // Readings in deviations of the noise, root mean square: what a share of the sensitivity is worth.
        let model = whiten(&self.signatures.nominal, self.sigma);
        let weight = (crate::algebra::dot(&model, &model) / n.max(1) as f64).sqrt().max(1e-9);
        let cooling = library::cooling(self.rows);
        let mut seen = 0;
        for (name, amount, column, x) in parts {
            if names.last() != Some(&name) {
                names.push(name);
                ways.push(vec![0.0; n]);
                units.push(column.channel.map_or(1.0 / weight, |k| self.sigma[k]));
                seen = 0;
            }
            let Some(way) = ways.last_mut() else { continue };
            match column.channel {
                Some(_) => way.iter_mut().zip(&column.values).for_each(|(w, v)| *w += x * v),
                // Of a column of all channels only the way itself is wanted.
                None => {
                    let factor = x * (amount * weight) as f32;
                    let of = cooling.get(seen).map_or(&[][..], Vec::as_slice);
                    way.iter_mut().zip(of).for_each(|(w, v)| *w += factor * v);
                }
            }
            seen += 1;
        }
        let (values, time) = library::warming(self.rows, &ways);
        let mut effect = Effect::new(of.name.clone()).with("time", time);
        for ((name, value), unit) in names.iter().zip(values).zip(units) {
            let value = value * unit;
            if value.is_finite() {
                effect
                    .parameters
                    .insert((*name).to_owned(), if *name == "span" { value.max(-0.9) } else { value });
            }
        }
        vec![effect]
    }

    /// What a linear effect is in the words of a skin description; empty where there are none for it.
    fn linear(&self, columns: &[Column], candidate: usize, fit: &Fit, weights: &[f64]) -> Vec<Effect> {
        let of = &self.signatures.candidates[candidate];
        let coefficient = |c: usize| fit.of(c);
        if of.name == "warm-up" {
            return self.warming(columns, of, &coefficient);
        }
        if !of.linear.is_empty() {
            let parts = of.columns.iter().zip(&of.linear).map(|(c, part)| (part, coefficient(*c)));
            return written(parts);
        }
        if !of.starts.is_empty() {
            return self.starts(columns, of, fit).into_iter().take(1).collect();
        }
        // A random effect of the family: what it does to each channel may be said by offsets, gains and places.
        let n = self.rows.rows.len();
        let channels = self.channels();
        let words: Vec<(usize, &(String, String, f64))> = self
            .signatures
            .candidates
            .iter()
            .filter(|c| {
                let name = c.form.as_deref().unwrap_or(&c.name);
                ["channel-offset", "channel-gain", "taxel-position"].contains(&name)
            })
            .flat_map(|c| c.columns.iter().copied().zip(&c.linear))
            .collect();
        let (mut held, mut all) = (0.0, 0.0);
        let mut parts: Vec<(&(String, String, f64), f64)> = Vec::new();
        for k in 0..channels {
            let mut wanted = vec![0.0f32; n];
            for &c in &of.columns {
                if columns[c].channel == Some(k) {
                    let x = coefficient(c) as f32;
                    wanted.iter_mut().zip(&columns[c].values).for_each(|(w, v)| *w += x * v);
                }
            }
            for (w, row) in wanted.iter_mut().zip(&self.rows.rows) {
                *w *= weights[row.group] as f32;
            }
            let own: Vec<&(usize, &(String, String, f64))> =
                words.iter().filter(|(c, _)| columns[*c].channel == Some(k)).collect();
            let m = own.len();
            let mut a = vec![0.0; m * m];
            let mut b = vec![0.0; m];
            for (i, (c, _)) in own.iter().enumerate() {
                b[i] = crate::algebra::dot(&columns[*c].values, &wanted);
                for (j, (d, _)) in own.iter().enumerate() {
                    a[i * m + j] = self
                        .rows
                        .rows
                        .iter()
                        .enumerate()
                        .map(|(r, row)| {
                            weights[row.group]
                                * f64::from(columns[*c].values[r])
                                * f64::from(columns[*d].values[r])
                        })
                        .sum();
                }
                a[i * m + i] = a[i * m + i] * (1.0 + 1e-6) + 0.05;
            }
            let score = b.clone();
            if crate::algebra::cholesky_solve(&mut a, m, &mut b).is_some() {
                held += b.iter().zip(&score).map(|(x, s)| x * s).sum::<f64>();
                parts.extend(own.iter().zip(&b).map(|((_, part), x)| (*part, *x)));
            }
            all += crate::algebra::dot(&wanted, &wanted);
        }
        if all > 0.0 && held > 0.8 * all { written(parts.into_iter()) } else { Vec::new() }
    }
}

/// Coefficients of linear parts as effects of a skin description.
fn written<'p>(parts: impl Iterator<Item = (&'p (String, String, f64), f64)>) -> Vec<Effect> {
    let mut found: Vec<Effect> = Vec::new();
    // A direction that stands for no amount is fitted with the one that does.
    for ((name, parameter, amount), coefficient) in parts.filter(|((.., amount), _)| *amount != 0.0) {
        let factor = ["channel-gain", "force-scale", "tip-scale"].contains(&name.as_str());
        let mut value = coefficient * amount + if factor { 1.0 } else { 0.0 };
        match name.as_str() {
            // What comes early cannot be simulated forwards.
            "delay" | "low-pass" => value = value.max(0.0),
            "channel-gain" if value.abs() < 1e-3 => value = 1e-3,
            "channel-curvature" => value = value.clamp(-CURVED, CURVED),
            "crosstalk" => value = value.clamp(-0.49, 0.49),
            "force-scale" | "tip-scale" => value = value.max(0.05),
            _ => {}
        }
        match found.iter_mut().find(|e| e.name == *name) {
            Some(effect) => {
                effect.parameters.insert(parameter.clone(), value);
            }
            None => found.push(Effect::new(name.clone()).with(parameter.clone(), value)),
        }
    }
    found
}

/// Half of the 90 % interval of coefficients, from the spread of scores over groups.
fn half_widths(statistics: &Statistics, fit: &Fit, of: &[usize], weights: &[f64]) -> Vec<f64> {
    let sum = statistics.sum(weights);
    let scores: Vec<Vec<f64>> = (0..statistics.groups())
        .filter(|g| weights[*g] > 0.0)
        .map(|g| {
            let fitted = statistics.project(g, fit, &fit.set);
            fit.set.iter().zip(fitted).map(|(&c, f)| weights[g] * (statistics.score(g)[c] - f)).collect()
        })
        .collect();
    let factor = sum.factor(&fit.set, |_, g| g * (1.0 + 1e-9) + 0.05);
    of.iter()
        .map(|c| {
            let at = fit.set.iter().position(|s| s == c);
            let (Some(at), Some(factor)) = (at, &factor) else { return f64::NAN };
            let mut row = vec![0.0; fit.set.len()];
            row[at] = 1.0;
            let row = factor.solve(&row);
            let variance: f64 =
                scores.iter().map(|s| row.iter().zip(s).map(|(r, s)| r * s).sum::<f64>().powi(2)).sum();
            1.645 * variance.sqrt()
        })
        .collect()
}

/// A column in deviations of the measured noise instead of the declared one, where there are `readings`.
fn rescale(column: &Column, declared: &[f64], sigma: &[f64], readings: &[f32]) -> Column {
    let channels = sigma.len();
    let factor = |i: usize| {
        let k = i % channels;
        let f = declared[k] / sigma[k];
        if f.is_finite() && readings[i].is_finite() { f as f32 } else { 0.0 }
    };
    let values = match column.channel {
        Some(k) => column.values.iter().enumerate().map(|(row, v)| v * factor(row * channels + k)).collect(),
        None => column.values.iter().enumerate().map(|(i, v)| v * factor(i)).collect(),
    };
    Column { channel: column.channel, values }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_takes_a_twelfth_of_its_square_and_a_quarter_at_its_edge() {
        let sigma = [0.01];
        let spread: Vec<f32> = (0..3000).map(|i| 0.1 * i as f32).collect();
        let noise = |down: bool, model: &[f32]| rounding(10.0, down, model, &sigma) * 1e-4;
        approx::assert_relative_eq!(noise(false, &spread), 100.0 / 12.0, max_relative = 0.02);
        approx::assert_relative_eq!(noise(true, &spread), 100.0 / 12.0, max_relative = 0.02);
        // What rounds down reads zero or a step less where nothing touches: its model stands between them.
        approx::assert_relative_eq!(noise(true, &[-5.0; 8]), 25.0, max_relative = 1e-6);
        assert!(noise(false, &[0.0; 8]) < 1e-3);
        assert_eq!(rounding(0.0, false, &spread, &sigma), 0.0);
    }
}
