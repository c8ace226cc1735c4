//! Scores of opened cases: of their reports, of what these switch on elsewhere, of what they say after follow-ups, and of baselines.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};
use dermis_gap::{SampleOptions, Samples, Simulator};
use dermis_gap_benchmark::Designs;
use dermis_gap_benchmark::score::{self, Answer, Mapping, Scorecard};
use dermis_gap_benchmark::set::{self, Manifest};
use dermis_model::common_effect;
use dermis_model::diagnosis::Evidence;
use dermis_skin::{Effect, SkinDescription};
use serde_json::{Value, json};

use super::reports::{self, Opened};
use super::{Diagnose, Request};
use crate::gap::answers::answer;
use crate::gap::baselines;
use crate::gap::diagnosis::Zero;
use crate::gap::follow_ups::{Asking, ask};
use crate::{Families, Progress};

/// What all cases are scored with.
pub(super) struct Scoring<'a> {
    pub(super) options: &'a Request,
    pub(super) families: &'a Families,
    pub(super) progress: &'a dyn Progress,
    /// Of each set.
    pub(super) skins: Vec<SkinDescription>,
    pub(super) mapping: Mapping,
    /// Effects that the reports know.
    pub(super) library: BTreeSet<String>,
}

impl Scoring<'_> {
    /// Scores of answers, one a case.
    pub(super) fn scorecard<'c>(
        &self,
        cases: &'c [Opened],
        answers: impl IntoIterator<Item = &'c Answer>,
    ) -> Scorecard {
        let of = cases.iter().zip(answers).map(|(case, answer)| (&case.truth, answer));
        Scorecard::new(of, &self.mapping, &self.library)
    }

    /// Tries what each report switches on in another recording of the same reference device, which no report has seen.
    pub(super) fn elsewhere(&self, cases: &mut [Opened]) -> Result<()> {
        let open: Vec<&mut Opened> =
            cases.iter_mut().filter(|c| c.answer.residual_reduction.is_some()).collect();
        self.progress.begin("recording again");
        let (count, done) = (open.len().max(1), AtomicUsize::new(0));
        let next = Mutex::new(open.into_iter());
        let worker = || -> Result<()> {
            loop {
                let Some(case) = next.lock().map_err(|_| anyhow::anyhow!("a worker was cut off"))?.next()
                else {
                    return Ok(());
                };
                case.answer.elsewhere = self.reduction_elsewhere(case)?;
                self.progress.at((1 + done.fetch_add(1, Ordering::Relaxed)) as f64 / count as f64);
            }
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.options.jobs.max(1)).map(|_| scope.spawn(worker)).collect();
            workers
                .into_iter()
                .try_for_each(|w| w.join().unwrap_or_else(|_| bail!("a recording was cut off")))
        })?;
        Ok(())
    }

    /// By which share what a report switches on reduces the residual of another recording; `None` where it switches on nothing that
    /// such a recording can show.
    fn reduction_elsewhere(&self, case: &Opened) -> Result<Option<f64>> {
        let skin = &self.skins[case.set];
        let make = |skin: &SkinDescription| self.families.model(skin).map_err(|e| format!("{e:#}"));
        let simulator = Simulator { skin, effects: self.families.of(skin)?.effects(), make: &make };
        let sigma = skin.channel_noise();
        let mut effects: Vec<Effect> = serde_json::from_value(case.report["corrected"].clone())
            .with_context(|| format!("{}: field `corrected` of its report", case.truth.case))?;
        // What a spectrum shows has another phase in every recording, and counts as noise where it is named.
        let mut truth = case.truth.clone();
        let spectral = |name: &str| {
            let evidence = common_effect(name).map(|info| info.diagnosis.evidence);
            matches!(evidence, Some(Evidence::Spectrum { .. }))
        };
        for effect in effects.extract_if(.., |e| spectral(&e.name)) {
            truth.causes.retain(|known| !self.mapping.right(&known.cause.id, &effect.name));
        }
        if effects.is_empty() {
            return Ok(None);
        }
        let folder = tempfile::tempdir().context("no folder for another recording can be made")?;
        let bag = folder.path().join("again");
        set::record_again(skin, &truth, &Designs::new(&make), &bag)?;
        let mut recording = dermis_gap::read(&[&bag], skin, None, None)?;
        recording.tare(Zero::of_arguments(&self.options.diagnose).into());
        let usable = vec![true; sigma.len()];
        let samples = Samples::draw(&recording, &usable, &SampleOptions::default());
        let frames = samples.frames();
        let nominal = simulator.readings(skin, &recording, &frames)?;
        let mut readings: Vec<f32> = frames.iter().flat_map(|f| recording.frame(*f)).copied().collect();
        // What a report's residual reduction leaves out is left out here as well.
        dermis_gap::mask_saturated(&mut readings, &nominal, skin, &sigma);
        let left = |model: &[f32]| -> f64 {
            let apart = readings.iter().zip(model).zip(sigma.iter().cycle());
            let squares = apart.map(|((y, s), sigma)| (f64::from(y - s) / sigma).powi(2));
            squares.filter(|square| square.is_finite()).sum()
        };
        let corrected = simulator.readings(&simulator.with(&effects), &recording, &frames)?;
        let (before, after) = (left(&nominal), left(&corrected));
        Ok((before > 0.0).then(|| 1.0 - after / before))
    }

    /// Answers of all cases after so many follow-ups.
    pub(super) fn follow(
        &self,
        times: usize,
        cases: &[Opened],
        seals: &[(PathBuf, String)],
        diagnosis: Diagnose<'_>,
    ) -> Result<Vec<Answer>> {
        let Request { set, diagnose, follow_up_minutes, .. } = self.options;
        self.progress.begin("following up");
        let mut answers = Vec::new();
        for (n, case) in cases.iter().enumerate() {
            let (out, _) = &seals[case.set];
            let skin_file = set[case.set].join("skin.toml");
            let asking = Asking {
                skin_file: &skin_file,
                skin: &self.skins[case.set],
                truth: &case.truth,
                bag: &case.bag,
                report: reports::file(out, &case.truth.case),
                folder: out.join("follow-ups").join(&case.truth.case),
            };
            let path = ask(&asking, (times, *follow_up_minutes), diagnose, self.families, diagnosis)
                .with_context(|| case.truth.case.clone())?;
            answers.push(answer(&reports::read(&path)?));
            if !self.progress.at((n + 1) as f64 / cases.len() as f64) {
                bail!("interrupted; call it again to go on");
            }
        }
        Ok(answers)
    }

    /// Scorecards of the baselines on the same cases.
    pub(super) fn baselines(&self, cases: &[Opened]) -> Result<Vec<(String, Scorecard)>> {
        self.progress.begin("baselines");
        let mut answers: Vec<Vec<Answer>> = Vec::new();
        let mut columns = baselines::Columns::default();
        for (n, case) in cases.iter().enumerate() {
            // Cases of the same set and presses have the same signatures.
            let key = (case.bag.parent().map(Path::to_owned).unwrap_or_default(), case.presses);
            let skin = &self.skins[case.set];
            answers.push(baselines::answers(skin, self.families, &case.bag, &key, &mut columns)?);
            self.progress.at((n + 1) as f64 / cases.len() as f64);
        }
        let of = |i: usize| self.scorecard(cases, answers.iter().map(|all| &all[i]));
        let names = baselines::NAMES.iter().enumerate();
        let mut scorecards: Vec<(String, Scorecard)> =
            names.map(|(i, name)| ((*name).to_owned(), of(i))).collect();
        scorecards.push(("random".to_owned(), self.blind(cases)));
        Ok(scorecards)
    }

    /// What choosing blindly scores. It has no cases of its own: its share of hits is that of accepted names among all.
    fn blind(&self, cases: &[Opened]) -> Scorecard {
        let mut random = Scorecard::default();
        let within = self.mapping.within(&self.library);
        for case in cases.iter().filter(|c| c.truth.kind == set::Kind::Singles && c.truth.gap >= 3.0) {
            let withheld = case.truth.causes.first();
            let accepted = withheld.and_then(|t| within.causes.get(&t.cause.id)).map_or(0, |a| a.names.len());
            if accepted > 0 {
                let hit = accepted as f64 / self.library.len() as f64;
                random.headline.top1 = random.headline.top1.and(hit.min(1.0));
                random.headline.top3 = random.headline.top3.and((3.0 * hit).min(1.0));
            }
        }
        random
    }

    /// Names of the skins.
    pub(super) fn skin(&self) -> String {
        let mut names: Vec<&str> = self.skins.iter().map(|skin| skin.name.as_str()).collect();
        names.dedup();
        names.join(", ")
    }

    /// Which tool, command and sets.
    pub(super) fn head(&self, manifests: &[Manifest], seals: &[(PathBuf, String)]) -> Result<Value> {
        let sets = manifests.iter().zip(&self.options.set).zip(seals);
        let sets = sets.map(|((manifest, dir), (_, seal))| -> Result<Value> {
            Ok(json!({ "kind": manifest.kind, "cases": manifest.cases.len(), "generator": manifest.generator,
                "sha256": Manifest::hash(dir)?, "reports_sha256": seal }))
        });
        Ok(json!({
            "schema": "gap-check/1",
            "tool": format!("dermis {}", env!("CARGO_PKG_VERSION")),
            "command": command(self.options),
            "skin": self.skin(),
            "mapping_sha256": set::sha256(Mapping::TEXT.as_bytes()),
            "sets": sets.collect::<Result<Vec<_>>>()?,
            "library": self.library,
        }))
    }

    /// Every case with its ground truth and its answer.
    pub(super) fn answered(&self, cases: &[Opened]) -> Value {
        let within = self.mapping.within(&self.library);
        let one = |c: &Opened| {
            let s = &c.truth;
            json!({ "case": s.case, "set": c.set + 1, "skin": self.skins[c.set].name, "kind": s.kind,
                "cell": score::cell(s, &within), "disturbance": s.disturbance, "gap": s.gap, "noise": s.noise,
                "unexplained": s.unexplained, "causes": s.causes, "answer": c.answer })
        };
        cases.iter().map(one).collect()
    }
}

/// How this check was called.
fn command(options: &Request) -> String {
    let path = |p: &Path| p.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let mut text = "dermis gap benchmark run".to_owned();
    for (flag, folders) in [("--set", &options.set), ("--truth", &options.truth)] {
        folders.iter().for_each(|folder| text.push_str(&format!(" {flag} {}", path(folder))));
    }
    text.push_str(&format!(" --out {}", path(&options.out)));
    if !options.diagnose.is_empty() {
        text.push_str(&format!(" -- {}", options.diagnose.join(" ")));
    }
    text
}
