//! The check of the diagnosis: reports first, sealed by their hash; then the secrets are opened and scored.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_gap_worlds::pack::{self, Case, Manifest, Secret};
use dermis_gap_worlds::score::{Answer, Card, Mapping, Named, Share};
use dermis_skin::SkinDescription;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;

/// Which packs to check on.
#[derive(Args)]
pub struct Options {
    /// Folder of a pack; several of one skin are scored together.
    #[arg(long, required = true, value_name = "DIR")]
    pack: Vec<PathBuf>,
    /// Folder of the secrets of each pack, in the same order. Without them the reports are written and sealed, and nothing is
    /// opened.
    #[arg(long, value_name = "DIR")]
    secret: Vec<PathBuf>,
    /// Folder for reports, their hashes and the scores; reports that are there already are not made again.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Diagnoses at once.
    #[arg(long, default_value_t = 1)]
    jobs: usize,
    /// Leave the baselines out, which take some seconds a case.
    #[arg(long)]
    no_baselines: bool,
    /// Passed on to every diagnosis, e.g. --resamples 0.
    #[arg(last = true)]
    diagnose: Vec<String>,
    /// The scores as JSON.
    #[arg(long)]
    json: bool,
}

/// Diagnoses, seals, opens, scores.
pub fn run(options: &Options) -> Result<()> {
    if !options.secret.is_empty() && options.secret.len() != options.pack.len() {
        bail!(
            "{} packs and {} folders of secrets: name one for each pack, or none to seal the reports only",
            options.pack.len(),
            options.secret.len()
        );
    }
    let packs: Vec<Manifest> =
        options.pack.iter().map(|dir| Manifest::load(dir)).collect::<Result<_, _>>()?;
    let mut seals = Vec::new();
    for (dir, manifest) in options.pack.iter().zip(&packs) {
        let out = options.out.join(Manifest::hash(dir)?.get(..12).unwrap_or_default());
        std::fs::create_dir_all(&out).with_context(|| format!("{} cannot be made", out.display()))?;
        diagnose(dir, manifest, &out, options)?;
        let seal = seal(manifest, &out)?;
        seals.push((out, seal));
    }
    if options.secret.is_empty() {
        for (out, seal) in &seals {
            println!("{}: reports sealed, sha256 {seal}", out.display());
        }
        return Ok(());
    }
    // From here on the reports must not change: their hashes lie on the disk.
    let mapping = Mapping::from_toml(Mapping::TEXT).map_err(anyhow::Error::msg)?;
    let mut cases: Vec<(Secret, Answer, Value)> = Vec::new();
    for (((manifest, secrets), (out, seal)), pack) in
        packs.iter().zip(&options.secret).zip(&seals).zip(&options.pack)
    {
        for case in &manifest.cases {
            let path = report(out, case);
            let text = std::fs::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
            let read: Value =
                serde_json::from_slice(&text).with_context(|| format!("{} is no report", path.display()))?;
            cases.push((pack::unseal(secrets, case)?, answer(&read), read));
        }
        tracing::info!("{}: reports sha256 {seal}", pack.display());
    }
    let mut card = Card::new(cases.iter().map(|(secret, answer, _)| (secret, answer)), &mapping);
    let skin = SkinDescription::load(options.pack[0].join("skin.toml"))?;
    let effects = crate::registry::family(&skin)?.effects;
    let library: BTreeSet<String> = effects.iter().map(|e| e.name.to_owned()).collect();
    card.note_library(&mapping, &library);
    let baselines =
        if options.no_baselines { Vec::new() } else { baselines(options, &packs, &cases, &mapping)? };
    let each: Vec<Value> = cases
        .iter()
        .map(|(secret, answer, _)| {
            serde_json::json!({ "case": secret.case, "kind": secret.kind, "gap": secret.gap, "noise": secret.noise,
                "unexplained": secret.unexplained, "causes": secret.causes, "answer": answer })
        })
        .collect();
    let summary = serde_json::json!({
        "schema": "gap-check/1",
        "packs": packs.iter().zip(&options.pack).zip(&seals).map(|((manifest, dir), (_, seal))| {
            Ok(serde_json::json!({ "kind": manifest.kind, "skin": manifest.skin, "cases": manifest.cases.len(),
                "sha256": Manifest::hash(dir)?, "reports_sha256": seal }))
        }).collect::<Result<Vec<_>>>()?,
        "scores": card,
        "baselines": baselines.iter().map(|(name, card)| serde_json::json!({ "name": name, "scores": card })).collect::<Vec<_>>(),
        "cases": each,
    });
    let path = options.out.join("scores.json");
    std::fs::write(&path, serde_json::to_string_pretty(&summary)?)
        .with_context(|| format!("{} cannot be written", path.display()))?;
    if options.json {
        println!("{summary}");
    } else {
        println!("{}", card.table());
        if !baselines.is_empty() {
            println!("| baseline | top-1 | top-3 | false alarms |\n|---|---|---|---|");
        }
        for (name, card) in &baselines {
            let s = &card.headline;
            println!("| {name} | {} | {} | {} |", shown(s.top1), shown(s.top3), shown(s.false_alarms));
        }
    }
    Ok(())
}

/// A share with its interval.
fn shown(share: Share) -> String {
    if share.of == 0 {
        return "-".to_owned();
    }
    let [low, high] = share.interval();
    format!("{:.3} ({low:.2} to {high:.2})", share.value())
}

/// Cards of the baselines on the same cases.
fn baselines(
    options: &Options,
    packs: &[Manifest],
    cases: &[(Secret, Answer, Value)],
    mapping: &Mapping,
) -> Result<Vec<(String, Card)>> {
    let progress = ProgressBar::new(cases.len() as u64).with_style(ProgressStyle::with_template(
        "baselines {wide_bar} {human_pos}/{human_len}, {eta} left",
    )?);
    progress.tick();
    let mut answers: Vec<Vec<Answer>> = Vec::new();
    let mut library: Vec<&str> = Vec::new();
    for (manifest, dir) in packs.iter().zip(&options.pack) {
        let skin = SkinDescription::load(dir.join("skin.toml"))?;
        let family = crate::registry::family(&skin)?;
        library = family.effects.iter().map(|e| e.name).collect();
        for case in &manifest.cases {
            answers.push(super::baselines::answers(&skin, family, &dir.join(&case.bag))?);
            progress.inc(1);
        }
    }
    progress.finish_and_clear();
    let mut cards: Vec<(String, Card)> = super::baselines::NAMES
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let of = cases.iter().zip(&answers).map(|((secret, _, _), all)| (secret, &all[i]));
            ((*name).to_owned(), Card::new(of, mapping))
        })
        .collect();
    // Blind choice has no cases of its own: its share of hits is that of accepted names among all.
    let mut random = Card::default();
    for (secret, _, _) in cases.iter().filter(|(s, _, _)| s.causes.len() == 1 && s.gap >= 3.0) {
        let names = secret.causes.first().and_then(|t| mapping.causes.get(&t.cause.id)).map(|a| &a.names);
        let accepted =
            names.map_or(0, |names| library.iter().filter(|l| names.iter().any(|n| n == *l)).count());
        if accepted > 0 {
            let hit = accepted as f64 / library.len() as f64;
            random.headline.top1 = random.headline.top1.and(hit.min(1.0));
            random.headline.top3 = random.headline.top3.and((3.0 * hit).min(1.0));
        }
    }
    cards.push(("random".to_owned(), random));
    Ok(cards)
}

fn report(out: &Path, case: &Case) -> PathBuf {
    out.join(format!("{}.json", case.id))
}

/// Has every case diagnosed by this program, as anybody would call it, `--jobs` at once.
fn diagnose(pack: &Path, manifest: &Manifest, out: &Path, options: &Options) -> Result<()> {
    let program = std::env::current_exe().context("this program does not know where it lies")?;
    let mut open: Vec<&Case> = manifest.cases.iter().filter(|case| !report(out, case).exists()).collect();
    // One case of all presses first: the others find its signatures, which two that run at once would both simulate.
    let mut seen = BTreeSet::new();
    open.sort_by_cached_key(|case| !seen.insert(case.presses));
    let progress = ProgressBar::new(open.len() as u64).with_style(ProgressStyle::with_template(
        "diagnosing {wide_bar} {human_pos}/{human_len}, {eta} left",
    )?);
    progress.tick();
    let stop = crate::collect::stop_on_interrupt()?;
    let next = std::sync::atomic::AtomicUsize::new(0);
    let one = |case: &Case| -> Result<()> {
        let done = Command::new(&program)
            .args(["gap", "diagnose", "--json", "--skin"])
            .arg(pack.join("skin.toml"))
            .arg("--real")
            .arg(pack.join(&case.bag))
            .args(&options.diagnose)
            .output()
            .context("the diagnosis cannot be started")?;
        if !done.status.success() {
            bail!("{}: {}", case.id, String::from_utf8_lossy(&done.stderr).trim());
        }
        let path = report(out, case);
        let part = path.with_extension("part");
        std::fs::write(&part, &done.stdout)
            .with_context(|| format!("{} cannot be written", part.display()))?;
        std::fs::rename(&part, &path).with_context(|| format!("{} cannot be made", path.display()))?;
        Ok(())
    };
    let worker = || -> Result<()> {
        while let Some(case) = open.get(next.fetch_add(1, Ordering::Relaxed)) {
            if stop.load(Ordering::Acquire) {
                bail!("interrupted; call it again to go on");
            }
            one(case)?;
            progress.inc(1);
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.jobs.max(1)).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().try_for_each(|w| w.join().unwrap_or_else(|_| bail!("a diagnosis was cut off")))
    })?;
    progress.finish_and_clear();
    Ok(())
}

/// Writes the hash of every report, and gives the hash of that list. A list that lies there already must be the same.
fn seal(manifest: &Manifest, out: &Path) -> Result<String> {
    let mut list = String::new();
    for case in &manifest.cases {
        let path = report(out, case);
        let text = std::fs::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        list.push_str(&format!("{}  {}.json\n", pack::sha256(&text), case.id));
    }
    let path = out.join("reports.sha256");
    match std::fs::read_to_string(&path) {
        Ok(before) if before != list => bail!(
            "{}: names other hashes than the reports beside it have: they were changed after they were sealed; take another folder",
            path.display()
        ),
        Ok(_) => {}
        Err(_) => {
            std::fs::write(&path, &list).with_context(|| format!("{} cannot be written", path.display()))?;
        }
    }
    Ok(pack::sha256(list.as_bytes()))
}

/// What a report says, as scores need it.
fn answer(report: &Value) -> Answer {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let pair = |v: &Value| -> Option<[f64; 2]> { Some([v.get(0)?.as_f64()?, v.get(1)?.as_f64()?]) };
    let verdict = text(&report["verdict"]);
    let mut answer = Answer {
        gap: matches!(verdict.as_str(), "named" | "named-and-unknown" | "unknown-systematic" | "unmeasured"),
        unknown: matches!(verdict.as_str(), "unknown-systematic" | "unmeasured"),
        closure: report["closure"]["predicted"]
            .as_f64()
            .zip(report["closure"]["achieved"].as_f64())
            .map(<[f64; 2]>::from),
        interval: pair(&report["closure"]["interval"]),
        verdict: verdict.clone(),
        ..Answer::default()
    };
    for effect in report["effects"].as_array().into_iter().flatten() {
        let mut named = Named { firm: effect["tier"] == "strict", ..Named::default() };
        for member in effect["class"].as_array().into_iter().flatten() {
            named.class.push(member.as_str().map_or_else(|| text(&member["name"]), str::to_owned));
        }
        let label = text(&effect["label"]);
        if named.class.is_empty() {
            named.class.push(label.clone());
        }
        let first = named.class[0].clone();
        let mut parameters = BTreeMap::new();
        for theta in effect["theta"].as_array().into_iter().flatten() {
            if let Some(value) = theta["value"].as_f64() {
                let name = text(&theta["name"]);
                let interval = pair(&theta["interval"]).or_else(|| pair(&theta["ci"]));
                parameters.insert(format!("{first}.{name}"), (value, interval));
            }
        }
        named.parameters = parameters;
        answer.ranking.extend(named.class.iter().cloned());
        answer.named.push(named);
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_becomes_an_answer() {
        let report = serde_json::json!({
            "verdict": "named",
            "effects": [
                { "label": "thickness", "tier": "strict", "class": [{ "name": "thickness" }, { "name": "base-bonding" }],
                  "theta": [{ "name": "change", "value": -0.001, "interval": [-0.002, 0.0] }] },
                { "label": "friction", "tier": "loose", "class": [{ "name": "friction" }] },
            ],
            "closure": { "predicted": 0.9, "achieved": 0.8, "interval": [0.7, 0.95] },
        });
        let answer = answer(&report);
        assert!(answer.gap && !answer.unknown);
        assert_eq!(answer.ranking, ["thickness", "base-bonding", "friction"]);
        assert!(answer.named[0].firm && !answer.named[1].firm);
        assert_eq!(answer.named[0].parameters["thickness.change"], (-0.001, Some([-0.002, 0.0])));
        assert_eq!((answer.closure, answer.interval), (Some([0.9, 0.8]), Some([0.7, 0.95])));
        assert!(!super::answer(&serde_json::json!({ "verdict": "no-gap-beyond-noise" })).gap);
    }
}
