//! Reports of all cases: made, sealed by their hash, and opened beside the ground truths.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};
use dermis_gap_benchmark::score::Answer;
use dermis_gap_benchmark::set::{self, Case, GroundTruth, Manifest};
use serde_json::Value;

use super::{Diagnose, Request};
use crate::Progress;
use crate::gap::answers::answer;

/// Has every set diagnosed: the folder of its reports, and the hash of their list.
pub(super) fn sealed(
    options: &Request,
    manifests: &[Manifest],
    diagnosis: Diagnose<'_>,
    progress: &dyn Progress,
) -> Result<Vec<(PathBuf, String)>> {
    let mut seals = Vec::new();
    for (dir, manifest) in options.set.iter().zip(manifests) {
        let out = options.out.join(Manifest::hash(dir)?.get(..12).unwrap_or_default());
        std::fs::create_dir_all(&out).with_context(|| format!("{} cannot be made", out.display()))?;
        diagnose(dir, manifest, &out, options, diagnosis, progress)?;
        let seal = seal(manifest, &out)?;
        seals.push((out, seal));
    }
    Ok(seals)
}

/// The report of the case with this identity.
pub(super) fn file(out: &Path, case: &str) -> PathBuf {
    out.join(format!("{case}.json"))
}

/// Reads a report.
pub(super) fn read(path: &Path) -> Result<Value> {
    let text = dermis_io::read(path, dermis_io::REPORT)
        .with_context(|| format!("{} cannot be read", path.display()))?;
    serde_json::from_slice(&text).with_context(|| format!("{} is no report", path.display()))
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
    let mut open: Vec<&Case> = manifest.cases.iter().filter(|case| !file(out, &case.id).exists()).collect();
    // One case of all presses first: the others find its signatures, which two that run at once would both simulate.
    let mut seen = BTreeSet::new();
    open.sort_by_cached_key(|case| !seen.insert(case.presses));
    progress.begin("diagnosing");
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let one = |case: &Case| -> Result<()> {
        let said = diagnosis(&folder.join("skin.toml"), &folder.join(&case.bag), &options.diagnose)
            .with_context(|| case.id.clone())?;
        let path = file(out, &case.id);
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
        let path = file(out, &case.id);
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

/// A case whose ground truth is open.
pub(super) struct Opened {
    pub(super) truth: GroundTruth,
    pub(super) answer: Answer,
    pub(super) report: Value,
    pub(super) bag: PathBuf,
    pub(super) presses: usize,
    /// Which set it is of.
    pub(super) set: usize,
}

/// Every case with its report and its ground truth.
pub(super) fn opened(
    options: &Request,
    manifests: &[Manifest],
    seals: &[(PathBuf, String)],
) -> Result<Vec<Opened>> {
    let mut cases = Vec::new();
    let folders = options.set.iter().zip(&options.truth).zip(seals);
    for (index, (manifest, ((folder, truths), (out, _)))) in manifests.iter().zip(folders).enumerate() {
        for case in &manifest.cases {
            let report = read(&file(out, &case.id))?;
            cases.push(Opened {
                truth: set::open_ground_truth(truths, case)?,
                answer: answer(&report),
                report,
                bag: folder.join(&case.bag),
                presses: case.presses,
                set: index,
            });
        }
    }
    Ok(cases)
}

/// The effects that the reports say were tried, or could not be seen.
pub(super) fn library(cases: &[Opened]) -> BTreeSet<String> {
    let mut library = BTreeSet::new();
    for case in cases {
        let of = &case.report["provenance"];
        let tried = of["tried"].as_array().into_iter().flatten();
        let silent = of["silent"].as_array().into_iter().flatten().filter_map(|pair| pair.get(0));
        library.extend(tried.chain(silent).filter_map(Value::as_str).map(str::to_owned));
    }
    library
}
