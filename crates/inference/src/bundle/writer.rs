//! Writing bundles.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use super::{BundleError, CARD, MANIFEST, MODEL, NORMALISATION, SENSITIVITY, hash};
use crate::interface::Interface;
use crate::manifest::{FileSection, Manifest, ModelSection};
use crate::normalisation;
use crate::onnx;
use crate::peaks::PeakSection;

/// Writes a bundle folder.
///
/// Fields of the manifest that are not known when it is made are public.
#[derive(Debug, Clone)]
pub struct BundleWriter {
    /// What `bundle.toml` will say; length and hash of the graph are filled in by [`write`](Self::write).
    pub manifest: Manifest,
    /// What `card.json` will say, for people: plots, tables, how it was trained.
    pub card: BTreeMap<String, serde_json::Value>,
    /// `sensitivity.onnx`, where the manifest has `peaks`, whose length and hash of it are filled in.
    pub sensitivity: Option<Vec<u8>>,
}

impl BundleWriter {
    /// A bundle of this manifest and an empty card.
    #[must_use]
    pub fn new(manifest: Manifest) -> Self {
        Self { manifest, card: BTreeMap::new(), sensitivity: None }
    }

    /// Gives the graph another interface than one flat tensor each.
    #[must_use]
    pub fn with_interface(mut self, interface: Interface) -> Self {
        if let Some(model) = &mut self.manifest.model {
            model.interface = interface;
        }
        self
    }

    /// Writes the folder whole or not at all, with `graph` as its ONNX file where its manifest speaks of one. An older bundle at the same
    /// path is replaced; anything else is left alone.
    ///
    /// # Errors
    ///
    /// [`BundleError`] where the manifest contradicts itself or the graph, or the folder cannot be written.
    pub fn write(mut self, path: impl AsRef<Path>, graph: &[u8]) -> Result<(), BundleError> {
        let path = path.as_ref();
        if let Some(model) = &mut self.manifest.model {
            (model.bytes, model.hash) = (graph.len() as u64, hash(graph));
        }
        if let (Some(peaks), Some(sensitivity)) = (&mut self.manifest.peaks, &self.sensitivity) {
            peaks.sensitivity = ModelSection {
                bytes: sensitivity.len() as u64,
                hash: hash(sensitivity),
                interface: PeakSection::interface(),
            };
            onnx::check(sensitivity, &peaks.sensitivity.interface)
                .map_err(|source| BundleError::Model { path: path.join(SENSITIVITY), source })?;
        }
        let normalisation = (self.manifest.input.channels() >= normalisation::FROM)
            .then(|| normalisation::encode(&self.manifest.input));
        self.manifest.normalisation =
            normalisation.as_ref().map(|bytes| FileSection { bytes: bytes.len() as u64, hash: hash(bytes) });
        self.manifest.validate(&path.join(MANIFEST).display().to_string())?;
        if let Some(model) = &self.manifest.model {
            onnx::check(graph, &model.interface)
                .map_err(|source| BundleError::Model { path: path.join(MODEL), source })?;
        }
        let encode = |file, reason: String| BundleError::Encode { path: path.to_owned(), file, reason };
        let manifest =
            toml::to_string(&*self.manifest.written()).map_err(|e| encode(MANIFEST, e.to_string()))?;
        let card = serde_json::to_string_pretty(&self.card).map_err(|e| encode(CARD, e.to_string()))? + "\n";

        let exists = path.exists();
        if exists && !replaceable(path) {
            return Err(BundleError::Occupied { path: path.to_owned() });
        }
        let parent = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let written = |at: &Path| {
            let at = at.to_owned();
            move |source| BundleError::Io { path: at, action: "written", source }
        };
        std::fs::create_dir_all(parent).map_err(written(parent))?;
        let scratch = scratch_folder(parent).map_err(written(parent))?;
        let sensitivity = self.sensitivity.as_deref().filter(|_| self.manifest.peaks.is_some());
        let files = [(MANIFEST, manifest.as_bytes()), (CARD, card.as_bytes())];
        let graph = self.manifest.model.is_some().then_some(graph);
        let optional =
            [(MODEL, graph), (SENSITIVITY, sensitivity), (NORMALISATION, normalisation.as_deref())];
        let optional = optional.into_iter().filter_map(|(file, content)| Some((file, content?)));
        for (file, content) in files.into_iter().chain(optional) {
            let at = scratch.path().join(file);
            std::fs::File::create(&at)
                .and_then(|mut f| f.write_all(content).and_then(|()| f.sync_all()))
                .map_err(written(&at))?;
        }
        // A folder cannot be replaced in one step, so the old one moves aside first. It is removed with the
        // folder it moves into.
        let aside = scratch_folder(parent).map_err(written(parent))?;
        if exists {
            std::fs::rename(path, aside.path().join("old")).map_err(written(path))?;
        }
        if let Err(source) = std::fs::rename(scratch.path(), path) {
            if exists {
                // Best effort: the error that is reported is the one that matters.
                let _ = std::fs::rename(aside.path().join("old"), path);
            }
            return Err(written(path)(source));
        }
        // It is the bundle now, not scratch any more.
        let _ = scratch.keep();
        Ok(())
    }
}

/// Whether a path is a bundle or an empty folder.
fn replaceable(path: &Path) -> bool {
    path.join(MANIFEST).is_file() || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

/// A folder that others may read, since it becomes the bundle.
fn scratch_folder(parent: &Path) -> std::io::Result<tempfile::TempDir> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".bundle-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o755));
    }
    builder.tempdir_in(parent)
}
