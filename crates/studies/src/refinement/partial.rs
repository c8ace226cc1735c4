//! What is done of a refinement, kept in the bundle until all is.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dermis_inference::Bundle;
use dermis_learn::{Dataset, Evaluation};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{Refinement, Request};

/// Where what is done is kept in the bundle until all is.
pub(super) const DONE: &str = "refinement.partial.json";

/// What is done of a refinement, so that an interruption costs one step at most.
#[derive(Serialize, Deserialize)]
pub(super) struct Done {
    /// Of what: another command does not go on with it.
    key: serde_json::Value,
    #[serde(skip)]
    pub(super) path: PathBuf,
    pub(super) refinement: Option<Refinement>,
    /// Of the half that is chosen by, and of that which is reported.
    pub(super) without: Option<[Evaluation; 2]>,
    pub(super) with: Option<[Evaluation; 2]>,
}

impl Done {
    /// What was kept of the same; nothing where it was of another kind, or cannot be read.
    pub(super) fn of(bundle: &Path, key: serde_json::Value) -> Self {
        let path = bundle.join(DONE);
        let kept = dermis_io::read_text(&path, dermis_io::REPORT).ok();
        let kept: Option<Self> = kept.and_then(|text| serde_json::from_str(&text).ok());
        match kept {
            Some(kept) if kept.key == key => Self { path, ..kept },
            _ => Self { key, path, refinement: None, without: None, with: None },
        }
    }

    pub(super) fn keep(&self) -> Result<()> {
        let written = || format!("{} cannot be written", self.path.display());
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let scratch = tempfile::NamedTempFile::new_in(folder).with_context(written)?;
        std::fs::write(scratch.path(), serde_json::to_string(self)?).with_context(written)?;
        scratch.persist(&self.path).with_context(written)?;
        Ok(())
    }

    pub(super) fn forget(&self) -> Result<()> {
        std::fs::remove_file(&self.path).with_context(|| format!("{} cannot be removed", self.path.display()))
    }
}

pub(super) fn interrupted(done: &Done) -> anyhow::Error {
    anyhow!(
        "interrupted; what was done is kept in {}: the same command goes on from there",
        done.path.display()
    )
}

/// What a refinement depends on.
pub(super) fn key(options: &Request, bundle: &Bundle, data: &Dataset) -> serde_json::Value {
    let manifest = bundle.manifest();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "skin": manifest.skin.hash,
        "model": manifest.model.as_ref().map(|model| &model.hash),
        "data": data.hash(),
        "labels": format!("{:?}", options.labels),
        "contacts": options.contacts,
        "unknowns": format!("{:?}", options.unknowns),
        "invert": options.invert,
        "force_prior": format!("{:?}", options.force_prior),
        "search": format!("{:?}", options.search),
        "distance": options.distance,
        "correct": options.correct,
    })
}
