//! The check of the diagnosis: reports first, sealed by their hash; then the ground truths are opened and the reports scored.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_gap::{SampleOptions, Samples, Simulator};
use dermis_gap_benchmark::score::{self, Answer, Mapping, Scorecard};
use dermis_gap_benchmark::set::{self, Case, GroundTruth, Manifest};
use dermis_model::common_effect;
use dermis_model::diagnosis::Evidence;
use dermis_skin::{Effect, SkinDescription};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use super::answers::answer;
use super::follow_ups::{Asking, ask};
use super::scorecard;
use crate::{Families, Progress};

/// Which benchmark sets to check on.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Folder of a benchmark set; several are scored together, of one skin or of several.
    #[arg(long, alias = "pack", required = true, value_name = "DIR")]
    #[serde(alias = "pack")]
    pub set: Vec<PathBuf>,
    /// Folder of the ground truths of each set, in the same order. Without them the reports are written and sealed, and nothing is
    /// opened.
    #[arg(long, alias = "secret", value_name = "DIR")]
    #[serde(alias = "secret")]
    pub truth: Vec<PathBuf>,
    /// Folder for reports, their hashes, scores.json (every case) and summary.json, .md and .svg; reports that are there already
    /// are not made again.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Diagnoses at once.
    #[arg(long, default_value_t = Request::default().jobs)]
    pub jobs: usize,
    /// Leave the baselines out.
    #[arg(long)]
    pub no_baselines: bool,
    /// Do not try what reports switch on in another recording of the same reference device.
    #[arg(long)]
    pub no_elsewhere: bool,
    /// How often each case may ask for presses (`dermis gap next`), which its reference device does, before it answers again; scored beside
    /// the first answers. Needs the ground truths.
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub follow_ups: usize,
    /// Minutes of pressing that a case may ask for each time.
    #[arg(long, value_name = "MIN", default_value_t = Request::default().follow_up_minutes)]
    pub follow_up_minutes: f64,
    /// Passed on to every diagnosis, e.g. --resamples 0.
    #[arg(last = true)]
    pub diagnose: Vec<String>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            set: Vec::new(),
            truth: Vec::new(),
            out: PathBuf::new(),
            jobs: 1,
            no_baselines: false,
            no_elsewhere: false,
            follow_ups: 0,
            follow_up_minutes: 3.0,
            diagnose: Vec::new(),
        }
    }
}

/// Skin file, bag and further options of one diagnosis → its report as JSON.
pub type Diagnose<'a> = &'a (dyn Fn(&Path, &Path, &[String]) -> Result<Vec<u8>> + Sync);

/// What became of the sets.
pub enum Findings {
    /// Nothing was opened: the folder of the reports of each set, and the hash of their list.
    Sealed(Vec<(PathBuf, String)>),
    /// The scores.
    Scored(Box<BenchmarkScores>),
}

/// Scores of opened sets.
pub struct BenchmarkScores {
    /// Which tool, command and sets.
    pub head: Value,
    /// Name of the skin.
    pub skin: String,
    /// Of the diagnosis.
    pub scorecard: Scorecard,
    /// After each number of follow-ups, from one on.
    pub followed: Vec<Scorecard>,
    /// Of simpler ways.
    pub baselines: Vec<(String, Scorecard)>,
    /// Every case with its answer.
    pub cases: Value,
}

impl BenchmarkScores {
    /// Without the single cases.
    #[must_use]
    pub fn summary(&self) -> Value {
        scorecard::json(&self.head, &self.scorecard, &self.followed, &self.baselines)
    }
}

impl Serialize for BenchmarkScores {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut whole = self.summary();
        whole["cases"] = self.cases.clone();
        whole.serialize(serializer)
    }
}

/// Diagnoses, seals, opens, scores.
///
/// # Errors
///
/// Where a set or its ground truths cannot be read, a diagnosis fails, or reports were changed after they were sealed.
pub fn run(
    options: &Request,
    families: &Families,
    diagnosis: Diagnose<'_>,
    progress: &dyn Progress,
) -> Result<Findings> {
    if !options.truth.is_empty() && options.truth.len() != options.set.len() {
        bail!(
            "{} benchmark sets and {} folders of ground truths: name one for each set, or none to seal the reports only",
            options.set.len(),
            options.truth.len()
        );
    }
    let manifests: Vec<Manifest> =
        options.set.iter().map(|dir| Manifest::load(dir)).collect::<Result<_, _>>()?;
    let mut seals = Vec::new();
    for (dir, manifest) in options.set.iter().zip(&manifests) {
        let out = options.out.join(Manifest::hash(dir)?.get(..12).unwrap_or_default());
        std::fs::create_dir_all(&out).with_context(|| format!("{} cannot be made", out.display()))?;
        diagnose(dir, manifest, &out, options, diagnosis, progress)?;
        let seal = seal(manifest, &out)?;
        seals.push((out, seal));
    }
    if options.truth.is_empty() {
        return Ok(Findings::Sealed(seals));
    }
    // From here on the reports must not change: their hashes lie on the disk.
    let mapping = Mapping::from_toml(Mapping::TEXT).map_err(anyhow::Error::msg)?;
    let mut cases: Vec<Opened> = Vec::new();
    for (index, (((manifest, truths), (out, _)), folder)) in
        manifests.iter().zip(&options.truth).zip(&seals).zip(&options.set).enumerate()
    {
        for case in &manifest.cases {
            let path = report(out, case);
            let text = dermis_io::read(&path, dermis_io::REPORT)
                .with_context(|| format!("{} cannot be read", path.display()))?;
            let read: Value =
                serde_json::from_slice(&text).with_context(|| format!("{} is no report", path.display()))?;
            let (truth, answer) = (set::open_ground_truth(truths, case)?, answer(&read));
            cases.push(Opened {
                truth,
                answer,
                report: read,
                bag: folder.join(&case.bag),
                presses: case.presses,
                set: index,
            });
        }
    }
    let library = library(&cases);
    let skins: Vec<SkinDescription> = options
        .set
        .iter()
        .map(|folder| SkinDescription::load(folder.join("skin.toml")))
        .collect::<Result<_, _>>()?;
    if !options.no_elsewhere {
        elsewhere(&skins, &mut cases, &mapping, options, families, progress)?;
    }
    let scorecard = Scorecard::new(cases.iter().map(|c| (&c.truth, &c.answer)), &mapping, &library);
    let mut followed = Vec::new();
    for times in 1..=options.follow_ups {
        let answers = follow(times, &skins, &cases, &seals, options, families, diagnosis, progress)?;
        let of = cases.iter().zip(&answers).map(|(case, answer)| (&case.truth, answer));
        followed.push(Scorecard::new(of, &mapping, &library));
    }
    let baselines = if options.no_baselines {
        Vec::new()
    } else {
        baselines(&skins, &cases, &mapping, &library, families, progress)?
    };
    let mut names: Vec<&str> = skins.iter().map(|skin| skin.name.as_str()).collect();
    names.dedup();
    let name = names.join(", ");
    let head = serde_json::json!({
        "schema": "gap-check/1",
        "tool": format!("dermis {}", env!("CARGO_PKG_VERSION")),
        "command": command(options),
        "skin": name,
        "mapping_sha256": set::sha256(Mapping::TEXT.as_bytes()),
        "sets": manifests.iter().zip(&options.set).zip(&seals).map(|((manifest, dir), (_, seal))| {
            Ok(serde_json::json!({ "kind": manifest.kind, "cases": manifest.cases.len(), "generator": manifest.generator,
                "sha256": Manifest::hash(dir)?, "reports_sha256": seal }))
        }).collect::<Result<Vec<_>>>()?,
        "library": library,
    });
    let within = mapping.within(&library);
    let cases = cases
        .iter()
        .map(|c| {
            let s = &c.truth;
            serde_json::json!({ "case": s.case, "set": c.set + 1, "skin": skins[c.set].name, "kind": s.kind,
                "cell": score::cell(s, &within), "disturbance": s.disturbance, "gap": s.gap, "noise": s.noise,
                "unexplained": s.unexplained, "causes": s.causes, "answer": c.answer })
        })
        .collect();
    Ok(Findings::Scored(Box::new(BenchmarkScores {
        head,
        skin: name,
        scorecard,
        followed,
        baselines,
        cases,
    })))
}

/// A case whose ground truth is open.
struct Opened {
    truth: GroundTruth,
    answer: Answer,
    report: Value,
    bag: PathBuf,
    presses: usize,
    /// Which set it is of.
    set: usize,
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

/// The effects that the reports say were tried, or could not be seen.
fn library(cases: &[Opened]) -> BTreeSet<String> {
    let mut library = BTreeSet::new();
    for case in cases {
        let of = &case.report["provenance"];
        let tried = of["tried"].as_array().into_iter().flatten();
        let silent = of["silent"].as_array().into_iter().flatten().filter_map(|pair| pair.get(0));
        library.extend(tried.chain(silent).filter_map(Value::as_str).map(str::to_owned));
    }
    library
}

/// Tries what each report switches on in another recording of the same reference device, which no report has seen.
fn elsewhere(
    skins: &[SkinDescription],
    cases: &mut [Opened],
    mapping: &Mapping,
    options: &Request,
    families: &Families,
    progress: &dyn Progress,
) -> Result<()> {
    let make = |skin: &SkinDescription| families.model(skin).map_err(|e| format!("{e:#}"));
    let open: Vec<&mut Opened> = cases.iter_mut().filter(|c| c.answer.residual_reduction.is_some()).collect();
    progress.begin("recording again");
    let (count, done) = (open.len().max(1), AtomicUsize::new(0));
    let one = |case: &Opened| -> Result<Option<f64>> {
        let skin = &skins[case.set];
        let simulator = Simulator { skin, effects: families.of(skin)?.effects(), make: &make };
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
            truth.causes.retain(|known| !mapping.right(&known.cause.id, &effect.name));
        }
        if effects.is_empty() {
            return Ok(None);
        }
        let folder = tempfile::tempdir().context("no folder for another recording can be made")?;
        let bag = folder.path().join("again");
        set::record_again(skin, &truth, &bag)?;
        let recording = dermis_gap::read(&[&bag], skin, None, None)?;
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
    };
    let next = Mutex::new(open.into_iter());
    let worker = || -> Result<()> {
        loop {
            let Some(case) = next.lock().map_err(|_| anyhow::anyhow!("a worker was cut off"))?.next() else {
                return Ok(());
            };
            case.answer.elsewhere = one(case)?;
            progress.at((1 + done.fetch_add(1, Ordering::Relaxed)) as f64 / count as f64);
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.jobs.max(1)).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().try_for_each(|w| w.join().unwrap_or_else(|_| bail!("a recording was cut off")))
    })?;
    Ok(())
}

/// Answers of all cases after they have asked so many times.
#[expect(clippy::too_many_arguments, reason = "what a whole benchmark knows")]
fn follow(
    times: usize,
    skins: &[SkinDescription],
    cases: &[Opened],
    seals: &[(PathBuf, String)],
    options: &Request,
    families: &Families,
    diagnosis: Diagnose<'_>,
    progress: &dyn Progress,
) -> Result<Vec<Answer>> {
    progress.begin("following up");
    let mut answers = Vec::new();
    for (n, case) in cases.iter().enumerate() {
        let (out, _) = &seals[case.set];
        let skin_file = options.set[case.set].join("skin.toml");
        let asking = Asking {
            skin_file: &skin_file,
            skin: &skins[case.set],
            truth: &case.truth,
            bag: &case.bag,
            report: out.join(format!("{}.json", case.truth.case)),
            folder: out.join("follow-ups").join(&case.truth.case),
        };
        let minutes = options.follow_up_minutes;
        let path = ask(&asking, (times, minutes), &options.diagnose, families, diagnosis)
            .with_context(|| case.truth.case.clone())?;
        let text = dermis_io::read(&path, dermis_io::REPORT)
            .with_context(|| format!("{} cannot be read", path.display()))?;
        answers.push(answer(&serde_json::from_slice(&text)?));
        if !progress.at((n + 1) as f64 / cases.len() as f64) {
            bail!("interrupted; call it again to go on");
        }
    }
    Ok(answers)
}

/// Scorecards of the baselines on the same cases.
fn baselines(
    skins: &[SkinDescription],
    cases: &[Opened],
    mapping: &Mapping,
    library: &BTreeSet<String>,
    families: &Families,
    progress: &dyn Progress,
) -> Result<Vec<(String, Scorecard)>> {
    progress.begin("baselines");
    let mut answers: Vec<Vec<Answer>> = Vec::new();
    let mut columns = super::baselines::Columns::default();
    for (n, case) in cases.iter().enumerate() {
        // Cases of the same set and presses have the same signatures.
        let key = (case.bag.parent().map(Path::to_owned).unwrap_or_default(), case.presses);
        let skin = &skins[case.set];
        answers.push(super::baselines::answers(skin, families, &case.bag, &key, &mut columns)?);
        progress.at((n + 1) as f64 / cases.len() as f64);
    }
    let mut scorecards: Vec<(String, Scorecard)> = super::baselines::NAMES
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let of = cases.iter().zip(&answers).map(|(case, all)| (&case.truth, &all[i]));
            ((*name).to_owned(), Scorecard::new(of, mapping, library))
        })
        .collect();
    // Blind choice has no cases of its own: its share of hits is that of accepted names among all.
    let mut random = Scorecard::default();
    let within = mapping.within(library);
    for case in cases.iter().filter(|c| c.truth.kind == set::Kind::Singles && c.truth.gap >= 3.0) {
        let withheld = case.truth.causes.first();
        let accepted = withheld.and_then(|t| within.causes.get(&t.cause.id)).map_or(0, |a| a.names.len());
        if accepted > 0 {
            let hit = accepted as f64 / library.len() as f64;
            random.headline.top1 = random.headline.top1.and(hit.min(1.0));
            random.headline.top3 = random.headline.top3.and((3.0 * hit).min(1.0));
        }
    }
    scorecards.push(("random".to_owned(), random));
    Ok(scorecards)
}

fn report(out: &Path, case: &Case) -> PathBuf {
    out.join(format!("{}.json", case.id))
}

/// Has every case diagnosed that has no report yet, `jobs` at once.
fn diagnose(
    folder: &Path,
    manifest: &Manifest,
    out: &Path,
    options: &Request,
    diagnosis: Diagnose<'_>,
    progress: &dyn Progress,
) -> Result<()> {
    let mut open: Vec<&Case> = manifest.cases.iter().filter(|case| !report(out, case).exists()).collect();
    // One case of all presses first: the others find its signatures, which two that run at once would both simulate.
    let mut seen = BTreeSet::new();
    open.sort_by_cached_key(|case| !seen.insert(case.presses));
    progress.begin("diagnosing");
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let one = |case: &Case| -> Result<()> {
        let said = diagnosis(&folder.join("skin.toml"), &folder.join(&case.bag), &options.diagnose)
            .with_context(|| case.id.clone())?;
        let path = report(out, case);
        let part = path.with_extension("part");
        std::fs::write(&part, &said).with_context(|| format!("{} cannot be written", part.display()))?;
        std::fs::rename(&part, &path).with_context(|| format!("{} cannot be made", path.display()))?;
        Ok(())
    };
    let worker = || -> Result<()> {
        while let Some(case) = open.get(next.fetch_add(1, Ordering::Relaxed)) {
            if !progress.at(done.load(Ordering::Relaxed) as f64 / open.len() as f64) {
                bail!("interrupted; call it again to go on");
            }
            one(case)?;
            done.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.jobs.max(1)).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().try_for_each(|w| w.join().unwrap_or_else(|_| bail!("a diagnosis was cut off")))
    })?;
    Ok(())
}

/// Writes the hash of every report, and gives the hash of that list. A list that lies there already must be the same.
fn seal(manifest: &Manifest, out: &Path) -> Result<String> {
    let mut list = String::new();
    for case in &manifest.cases {
        let path = report(out, case);
        let text = dermis_io::read(&path, dermis_io::REPORT)
            .with_context(|| format!("{} cannot be read", path.display()))?;
        list.push_str(&format!("{}  {}.json\n", set::sha256(&text), case.id));
    }
    let path = out.join("reports.sha256");
    match dermis_io::read_text(&path, dermis_io::REPORT) {
        Ok(before) if before != list => bail!(
            "{}: names other hashes than the reports beside it have: they were changed after they were sealed; take another folder",
            path.display()
        ),
        Ok(_) => {}
        Err(_) => {
            std::fs::write(&path, &list).with_context(|| format!("{} cannot be written", path.display()))?;
        }
    }
    Ok(set::sha256(list.as_bytes()))
}
