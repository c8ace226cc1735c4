//! The whole diagnosis, in stages.
//!
//! ```text
//! check ─→ signatures ─→ check against the model ─→ measure ─→ select ─→ refine ─→ predict ─→ contest ─→ report
//! ```
//!
//! | stage | from | to |
//! |---|---|---|
//! | [`check`] | recording | noise, samples, problems; then readings in the right order and their quantization |
//! | [`signatures`] | model, samples | what each effect would change |
//! | [`measure`] | readings, nominal model | size of the gap, interference |
//! | [`select`] | signatures, residual | effects that make the gap, to first order |
//! | [`refine`] | these effects | their values on the full simulator |
//! | [`predict`] | these values | how far they reduce the residual on other contacts |
//! | [`contest`] | what they leave | generic rivals, and which names are firm |
//! | [`report`] | all of it | verdict, axes, sentence |
//!
//! Each stage is a function of plain inputs. None knows an effect by its name: properties of effects are in
//! [`effects`](crate::effects), numbers that decide in [`constants`](crate::constants).

pub mod calibrate;
mod check;
mod contest;
mod covariates;
mod data;
mod evidence;
mod measure;
mod predict;
mod prior;
mod refine;
mod report;
mod select;
mod signatures;
#[cfg(test)]
mod testing;
mod write;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use dermis_skin::SkinDescription;
use indicatif::ProgressBar;

use crate::GapError;
use crate::constants;
use crate::recording::Recording;
use crate::report::Report;
use crate::samples::SampleOptions;
use crate::select::SelectOptions;
use crate::simulate::Simulator;

pub use signatures::Memory;

use data::Data;

/// How a recording is diagnosed.
#[derive(Debug, Clone)]
pub struct Options {
    /// How frames are drawn.
    pub samples: SampleOptions,
    /// How causes are selected.
    pub select: SelectOptions,
    /// Times that selection and fit are run again for the interval of the residual reduction.
    pub resamples: usize,
    /// Candidates that are fitted on the full simulator for each named effect, at most; 0 leaves all at their linear values.
    pub nonlinear_refinement: usize,
    /// Folder that keeps signatures between runs.
    pub cache: Option<PathBuf>,
    /// Effects that are left out of the library, as if nobody had thought of them: what the diagnosis makes of a cause that it
    /// does not know is calibrated so.
    pub without: Vec<String>,
    /// Set it from anywhere to end early.
    pub stop: Arc<AtomicBool>,
    /// Shows simulations done and to do; hidden by default.
    pub progress: ProgressBar,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            samples: SampleOptions::default(),
            select: SelectOptions::default(),
            resamples: constants::predict::RESAMPLES,
            nonlinear_refinement: constants::refine::CANDIDATES,
            cache: None,
            without: Vec::new(),
            stop: Arc::default(),
            progress: ProgressBar::hidden(),
        }
    }
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
    let checked = check::recording(recording, simulator.skin, &options.samples);
    let samples = &checked.samples;
    let mut report = report::begin(simulator, recording, samples, options);
    report.data.problems.extend(checked.problems);
    if report::fatal(&report) {
        return Ok(report::unusable(report, simulator));
    }
    let (mut signatures, simulated) = signatures::obtain(simulator, recording, samples, options, memory)?;
    if !options.without.is_empty() {
        Arc::make_mut(&mut signatures).candidates.retain(|c| !options.without.contains(&c.name));
    }
    report::library(&mut report, &signatures, simulated, samples);
    let aligned = check::align(simulator, recording, samples, checked.sigma, &signatures.nominal)?;
    report.data.problems.extend(aligned.problems.iter().cloned());
    if report::fatal(&report) {
        return Ok(report::unusable(report, simulator));
    }
    let seed = options.select.seed;
    let prepared = check::quantization(simulator, recording, samples, aligned, seed)?;
    report.data.problems.extend(prepared.problems.iter().cloned());
    let mut measured = measure::gap(prepared, (simulator.skin, &signatures.zero), samples, seed);
    report::locate(&mut report, &measured, simulator.skin, recording, samples, seed);
    let irreproducible = measure::irreproducible(&measured.gap, &options.select);
    let interference = measure::interference(recording, simulator.skin, &mut measured.gap, &options.select);
    if let Some(found) = &interference {
        report::interference(&mut report, found, &measured.gap);
    }
    report.gap = Some(measured.gap.clone());
    let scope = measure::scope(&measured.gap, &options.select, irreproducible);
    let seconds = || begun.elapsed().as_secs_f64() - simulated;
    if scope.negligible && measured.fixed.is_empty() {
        report = report::negligible(report, interference.and_then(|i| i.effect), &options.select);
        report.provenance.seconds[1] = seconds();
        let corrected = simulator.with(&report.corrected);
        return Ok(Diagnosis { report, corrected });
    }
    let data = Data {
        simulator,
        recording,
        samples,
        readings: &measured.readings,
        sigma: &measured.sigma,
        signatures: &signatures,
        gap: &measured.gap,
        options,
    };
    let explained = if scope.negligible || !scope.established {
        predict::Explained::default()
    } else {
        explain(&data, &measured)?
    };
    let interference = interference.and_then(|i| i.effect);
    let members = report::finish(&mut report, &data, &measured, explained, scope, interference);
    report.hypotheses = report::hypotheses(&report, &members);
    report.next_experiments = crate::experiments::rank(simulator, &members, samples, &options.stop);
    report.sentence = report::sentence(&report);
    report.provenance.seconds[1] = seconds();
    let corrected = simulator.with(&report.corrected);
    Ok(Diagnosis { report, corrected })
}

/// The stages that name causes: select, refine, predict.
fn explain(data: &Data<'_>, measured: &measure::Measured) -> Result<predict::Explained, GapError> {
    let selected = select::select(data, &measured.whitened)?;
    // What differs between presses that were done alike, and goes away with the effects, is a part of the gap that these make.
    let gap = select::with_irreproducible(data, &selected, &measured.whitened);
    let data = Data { gap: gap.as_ref().unwrap_or(data.gap), ..*data };
    if selected.selection.picks.is_empty() {
        let mut explained = predict::Explained::none(selected.selection.clone());
        contest::contest(&data, measured, &selected, &mut explained);
        return Ok(explained);
    }
    let refined = refine::refine(&data, &selected, &measured.beside)?;
    let mut explained = predict::predict(&data, &selected, refined, &measured.beside, &measured.whitened)?;
    contest::contest(&data, measured, &selected, &mut explained);
    explained.gap = gap;
    Ok(explained)
}

/// Says what is being done, in so many steps.
fn announce(progress: &ProgressBar, what: &'static str, steps: usize) {
    progress.set_message(what);
    progress.set_length(steps as u64);
    progress.set_position(0);
}

#[cfg(test)]
mod tests {
    use dermis_fixtures::Analytic;
    use dermis_model::ForwardModel;
    use dermis_skin::{Effect, SkinDescription};

    use super::*;
    use crate::recording::Zero;
    use crate::report::Verdict;
    use crate::testing::{EFFECTS, gains, recorded, skin, small};

    #[test]
    fn a_tared_skin_that_reads_something_untouched_gets_the_same_diagnosis() {
        let skin = skin();
        let said = |rest: f64| {
            let make = |skin: &SkinDescription| small(skin, rest);
            let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
            let mut recording = recorded(&simulator, &[gains()]);
            recording.tare(Zero::Press);
            let options = Options { resamples: 2, ..Options::default() };
            diagnose(&simulator, &recording, &options, &Memory::default()).unwrap().report
        };
        let (plain, resting) = (said(0.0), said(3.0));
        assert_eq!(plain.verdict, Verdict::Named, "{}", plain.sentence);
        assert_eq!(resting.verdict, plain.verdict, "{}", resting.sentence);
        assert_eq!(resting.class(), plain.class());
        let [a, b] = [&plain, &resting].map(|r| r.gap.as_ref().unwrap().systematic);
        assert!((a - b).abs() < 1e-3 * a, "{a} {b}");
        for name in ["a", "b", "c"] {
            let [a, b] = [&plain, &resting].map(|r| r.corrected[0].parameters[name]);
            assert!((a - b).abs() < 1e-3, "{name}: {a} {b}");
        }
    }

    /// A skin with numbers in nested tables: a spread, a stiffness, and an exponent of the force.
    fn layered() -> SkinDescription {
        let mut skin = skin();
        let text =
            "[pipe]\nradius = 2e-3\nexponent = 0.8\n[[layers]]\nyoung_modulus = 7e4\nname = \"foam\"\n";
        skin.medium = toml::from_str(text).unwrap();
        skin
    }

    fn nested(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
        Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
        let of = |path: &str| crate::design::value(skin, path).ok_or_else(|| format!("no {path}"));
        let (radius, exponent) = (of("medium.pipe.radius")?, of("medium.pipe.exponent")?);
        let gain = (of("medium.layers[0].young_modulus")? / 7e4).powf(-0.5);
        Ok(Arc::new(Analytic::of_skin(skin, move |contact, taxel| {
            let far = (contact.position - taxel).norm() / (3.0 * radius);
            1000.0 * gain * (-contact.force.z).max(0.0).powf(exponent) / (1.0 + far * far)
        })))
    }

    #[test]
    fn a_device_that_was_built_with_another_nested_number_gets_that_number() {
        let skin = layered();
        let make = |skin: &SkinDescription| nested(skin);
        let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
        for (path, value) in [
            ("medium.pipe.radius", 2.4e-3),
            ("medium.pipe.exponent", 0.9),
            ("medium.layers[0].young_modulus", 5e4),
        ] {
            let recording = recorded(&simulator, &[Effect::new(path).with("value", value)]);
            let options = Options { resamples: 2, ..Options::default() };
            let found = diagnose(&simulator, &recording, &options, &Memory::default()).unwrap();
            let report = &found.report;
            assert_eq!(report.verdict, Verdict::Named, "{path}: {}", report.sentence);
            assert!(report.class().contains(&path), "{path}: {}", report.sentence);
            assert_eq!(report.effects.len(), 1, "{}", report.sentence);
            let fitted = report.effects[0].theta.iter().find(|v| v.name == path);
            let fitted = fitted.unwrap_or_else(|| panic!("{path}: {:?}", report.effects)).value;
            assert!((fitted / value - 1.0).abs() < 0.05, "{path}: {fitted}");
            let corrected = crate::design::value(&found.corrected, path).unwrap();
            let written = report.corrected.iter().any(|e| e.name == path);
            assert!(!written || (corrected / value - 1.0).abs() < 0.05, "{path}: {corrected}");
        }
        // A device as it was designed has no number off.
        let report = {
            let options = Options { resamples: 2, ..Options::default() };
            diagnose(&simulator, &recorded(&simulator, &[]), &options, &Memory::default()).unwrap().report
        };
        assert!(report.effects.is_empty(), "{}", report.sentence);
    }
}
