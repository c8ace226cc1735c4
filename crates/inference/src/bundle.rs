//! Model bundles: a folder with `bundle.toml`, `model.onnx` where anything was learned, `normalisation.npy` where the channels are many,
//! `sensitivity.onnx` where contacts are read off a map, `correction.json` where a forward model was corrected by what was
//! recorded, and, for people, `card.json`.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use dermis_inversion::Correction;
use dermis_skin::SkinDescription;
use sha2::{Digest, Sha256};

use crate::correction::{self, CorrectionError};
use crate::features::Features;
use crate::file;
use crate::interface::Interface;
use crate::limits::Limits;
use crate::manifest::{FileSection, Manifest, ManifestError, ModelSection, SkinSection};
use crate::model::{Model, ModelError};
use crate::normalisation;
use crate::onnx;
use crate::outputs::Outputs;
use crate::peaks::PeakSection;
use crate::runtime::Runtime;
use crate::trial::{self, Candidate};

const MANIFEST: &str = Bundle::MANIFEST;
const MODEL: &str = "model.onnx";
const SENSITIVITY: &str = "sensitivity.onnx";
const CORRECTION: &str = "correction.json";
const NORMALISATION: &str = "normalisation.npy";
const CARD: &str = "card.json";
/// \[bytes\] longest file of a correction: a device has thousands of channels at most.
const LONGEST_CORRECTION: u64 = 64 << 20;

/// A bundle that cannot be used or written, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BundleError {
    /// There is no such folder.
    #[error(
        "model bundle {path}: there is no such folder; train one with `dermis train` or correct the path"
    )]
    NoFolder {
        /// Folder that was requested.
        path: PathBuf,
    },
    /// A file of the bundle is not there.
    #[error(
        "model bundle {path}: holds no `{file}`, so it is not a whole bundle; copy it again or train it anew"
    )]
    NoFile {
        /// Folder of the bundle.
        path: PathBuf,
        /// File that is missing.
        file: &'static str,
    },
    /// A file or folder cannot be read or written.
    #[error("model bundle: {path} cannot be {action}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// `read` or `written`.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// What lies in a file's place is none.
    #[error(
        "model bundle file {path}: is no plain file, but a pipe, a device or a folder; copy the bundle again"
    )]
    NotAFile {
        /// What lies there.
        path: PathBuf,
    },
    /// A file is longer than any of its kind is.
    #[error(
        "model bundle file {path}: has {found} bytes, and at most {most} are read; is it the right file?"
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length.
        found: u64,
        /// The longest that is read.
        most: u64,
    },
    /// The manifest is wrong.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The graph's file is shorter or longer than the manifest says.
    #[error(
        "model file {path}: has {found} bytes where bundle.toml field `{field}.bytes` says {expected}: it was cut short \
         or replaced; copy the bundle again"
    )]
    Length {
        /// File of the graph.
        path: PathBuf,
        /// Table of the manifest that speaks of it.
        field: &'static str,
        /// Its length.
        found: u64,
        /// Length that the manifest says.
        expected: u64,
    },
    /// The graph's file has another content than the manifest says.
    #[error(
        "model file {path}: has hash {found} where bundle.toml field `{field}.hash` says {expected}: it was damaged or \
         replaced; copy the bundle again"
    )]
    Content {
        /// File of the graph.
        path: PathBuf,
        /// Table of the manifest that speaks of it.
        field: &'static str,
        /// Its hash.
        found: String,
        /// Hash that the manifest says.
        expected: String,
    },
    /// The graph cannot be used.
    #[error("model file {path}: {source}")]
    Model {
        /// File of the graph.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelError,
    },
    /// The correction of the forward model cannot be used.
    #[error("model bundle file {path}: {source}")]
    Correction {
        /// Its file.
        path: PathBuf,
        /// What is wrong with it.
        source: CorrectionError,
    },
    /// The model was trained for another skin.
    #[error(transparent)]
    AnotherSkin(Box<SkinMismatch>),
    /// The manifest names the skin's hash, but other channels or another unit: someone has edited it.
    #[error(
        "bundle file {path}: field `{field}`: {difference}, though `skin.hash` is that of skin `{skin}`; restore the file"
    )]
    Contradiction {
        /// The manifest.
        path: PathBuf,
        /// `skin.channels` or `skin.unit`.
        field: &'static str,
        /// What differs.
        difference: String,
        /// Name of the skin.
        skin: String,
    },
    /// The folder to write holds something else.
    #[error("model bundle {path}: the folder exists and is no bundle; choose another one")]
    Occupied {
        /// Folder that was requested.
        path: PathBuf,
    },
    /// The card cannot be written as JSON, or the manifest as TOML.
    #[error("model bundle {path}: {file} cannot be encoded: {reason}")]
    Encode {
        /// Folder of the bundle.
        path: PathBuf,
        /// The file.
        file: &'static str,
        /// Why.
        reason: String,
    },
}

/// The skin that a model was trained for, and the one that it is to be used on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "model bundle {path}: was trained for skin `{bundle_skin}` ({bundle_hash}), not for `{skin}` ({skin_hash}): \
     {difference}; train a model for this skin"
)]
pub struct SkinMismatch {
    /// Folder of the bundle.
    pub path: PathBuf,
    /// Name of the skin that it was trained for.
    pub bundle_skin: String,
    /// Hash of the skin that it was trained for.
    pub bundle_hash: String,
    /// Name of the skin that it is to be used on.
    pub skin: String,
    /// Hash of the skin that it is to be used on.
    pub skin_hash: String,
    /// What differs.
    pub difference: String,
}

/// A model bundle that fits a skin.
#[derive(Debug, Clone)]
pub struct Bundle {
    path: PathBuf,
    manifest: Manifest,
    /// `None` where contacts are found on the forward model alone.
    graph: Option<Vec<u8>>,
    /// The network that turns peaks into forces.
    sensitivity: Option<Vec<u8>>,
    correction: Option<Correction>,
    limits: Limits,
}

impl Bundle {
    /// Reads a bundle folder and checks that it is whole and fits the skin, within the usual [`Limits`]. Runs nothing of it.
    ///
    /// # Errors
    ///
    /// [`BundleError`] says which file and field is wrong and what to do.
    pub fn load(path: impl AsRef<Path>, skin: &SkinDescription) -> Result<Self, BundleError> {
        Self::load_within(path, skin, &Limits::default())
    }

    /// [`load`](Self::load) within these limits, which hold for [`session`](Self::session), too.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn load_within(
        path: impl AsRef<Path>,
        skin: &SkinDescription,
        limits: &Limits,
    ) -> Result<Self, BundleError> {
        let path = path.as_ref();
        if !path.is_dir() {
            return Err(BundleError::NoFolder { path: path.to_owned() });
        }
        let manifest_path = path.join(MANIFEST);
        let text = file::read(path, MANIFEST, limits.manifest_bytes)?;
        let text = String::from_utf8(text).map_err(|_| ManifestError::Parse {
            file: manifest_path.display().to_string(),
            field: "(whole file)".into(),
            reason: "is not UTF-8 text".into(),
        })?;
        let mut manifest = Manifest::from_toml(&text, &manifest_path.display().to_string())?;
        read_normalisation(path, &mut manifest, limits)?;
        fits(path, &manifest.skin, skin)?;
        let graph = match &manifest.model {
            Some(model) => Some(read_graph(path, (MODEL, "model"), model, limits)?),
            None => None,
        };
        let sensitivity = match &manifest.peaks {
            Some(peaks) => {
                Some(read_graph(path, (SENSITIVITY, "peaks.sensitivity"), &peaks.sensitivity, limits)?)
            }
            None => None,
        };
        let correction = match &manifest.correction {
            Some(section) => {
                let expected = (section.bytes, section.hash.as_str());
                let bytes = read_whole(path, (CORRECTION, "correction"), expected, limits.correction_bytes)?;
                let same = |other: &SkinSection| {
                    other.hash.eq_ignore_ascii_case(&manifest.skin.hash)
                        || skin.is_type(&other.hash, &other.name)
                };
                let correction = correction::decode(&bytes, &manifest.skin, same)
                    .map_err(|source| BundleError::Correction { path: path.join(CORRECTION), source })?;
                Some(correction)
            }
            None => None,
        };
        Ok(Self { path: path.to_owned(), manifest, graph, sensitivity, correction, limits: *limits })
    }

    /// How the device differs from its forward model, where that was learned.
    #[must_use]
    pub fn correction(&self) -> Option<&Correction> {
        self.correction.as_ref()
    }

    /// Takes the correction of one device of this type from a file of its own, in place of the bundle's: a `correction.json` as
    /// `dermis refine --correct` writes it.
    ///
    /// # Errors
    ///
    /// [`BundleError`] where the file cannot be read, or was learned on another type of skin.
    pub fn take_correction(&mut self, file: &Path, skin: &SkinDescription) -> Result<(), BundleError> {
        let failed = |source| BundleError::Io { path: file.to_owned(), action: "read", source };
        let mut bytes = Vec::new();
        let opened = std::fs::File::open(file).map_err(failed)?;
        opened.take(LONGEST_CORRECTION + 1).read_to_end(&mut bytes).map_err(failed)?;
        let read = if bytes.len() as u64 > LONGEST_CORRECTION {
            Err(CorrectionError::Parse(format!("is longer than {LONGEST_CORRECTION} bytes")))
        } else {
            correction::decode(&bytes, &self.manifest.skin, |other| skin.is_type(&other.hash, &other.name))
        };
        let correction = read.map_err(|source| BundleError::Correction { path: file.to_owned(), source })?;
        self.correction = Some(correction);
        Ok(())
    }

    /// Folder that it was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What it says about itself.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Writes another manifest into the folder, whole or not at all, and with it the correction that its `correction` speaks
    /// of, whose length and hash are filled in; the graphs stay. Without a correction the manifest speaks of none.
    ///
    /// # Errors
    ///
    /// [`BundleError`] where manifest or correction contradict themselves, or a file cannot be written.
    pub fn amend(
        &mut self,
        mut manifest: Manifest,
        correction: Option<Correction>,
    ) -> Result<(), BundleError> {
        let path = self.path.join(MANIFEST);
        if manifest.input.mean != self.manifest.input.mean
            || manifest.input.scale != self.manifest.input.scale
        {
            // The file that is there holds others.
            manifest.normalisation = None;
        }
        match (&correction, &mut manifest.correction) {
            (Some(correction), section @ Some(_)) => {
                let file = self.path.join(CORRECTION);
                correction
                    .check(manifest.skin.channels.len())
                    .map_err(|e| BundleError::Correction { path: file.clone(), source: e.into() })?;
                let text = correction::encode(correction, &manifest.skin)
                    .map_err(|e| self.encode(CORRECTION, &e))?;
                if let Some(section) = section {
                    (section.bytes, section.hash) = (text.len() as u64, hash(text.as_bytes()));
                }
                manifest.validate(&path.display().to_string())?;
                if self.manifest.correction.is_some() {
                    // Whatever comes in between, the manifest never speaks of another file than is there.
                    let mut bare = self.manifest.clone();
                    bare.correction = None;
                    replace(
                        &path,
                        &toml::to_string(&*bare.written()).map_err(|e| self.encode(MANIFEST, &e))?,
                    )?;
                }
                replace(&file, &text)?;
            }
            (_, section) => *section = None,
        }
        manifest.validate(&path.display().to_string())?;
        replace(&path, &toml::to_string(&*manifest.written()).map_err(|e| self.encode(MANIFEST, &e))?)?;
        self.correction = correction.filter(|_| manifest.correction.is_some());
        if self.correction.is_none() {
            // Nothing speaks of it any more, so that it does no harm where it cannot be removed.
            let _ = std::fs::remove_file(self.path.join(CORRECTION));
        }
        self.manifest = manifest;
        Ok(())
    }

    fn encode(&self, file: &'static str, reason: &dyn std::fmt::Display) -> BundleError {
        BundleError::Encode { path: self.path.clone(), file, reason: reason.to_string() }
    }

    /// Turns frames into its input, which is the newest frame where there is no graph; starts with an empty history.
    #[must_use]
    pub fn features(&self) -> Features {
        match self.graph {
            Some(_) => Features::of_valid(self.manifest.input.clone()),
            None => Features::as_read(self.manifest.skin.channels.len()),
        }
    }

    /// Reads its output.
    #[must_use]
    pub fn outputs(&self) -> Outputs {
        Outputs::of_valid(self.manifest.output.clone())
    }

    /// Loads its graph into a runtime, after it has shown that it can be loaded, and gives finite numbers ([`trial`]); `None` where it
    /// has none.
    ///
    /// # Errors
    ///
    /// [`BundleError::Model`] where the runtime refuses the graph, or it fails its trial.
    ///
    /// [`trial`]: crate::trial
    pub fn session(&self, runtime: &Runtime) -> Result<Option<Model>, BundleError> {
        let (Some(graph), Some(model)) = (&self.graph, &self.manifest.model) else { return Ok(None) };
        trial::load(runtime, &Candidate { graph, interface: &model.interface, ranges: &[] }, &self.limits)
            .map(Some)
            .map_err(|source| BundleError::Model { path: self.path.join(MODEL), source })
    }

    /// Loads the network that turns peaks of its map into forces, tried as [`session`](Self::session) tries its graph; `None`
    /// where it has none.
    ///
    /// # Errors
    ///
    /// As [`session`](Self::session).
    pub fn sensitivity(&self, runtime: &Runtime) -> Result<Option<Model>, BundleError> {
        let Some(graph) = &self.sensitivity else { return Ok(None) };
        let interface = &PeakSection::interface();
        trial::load(runtime, &Candidate { graph, interface, ranges: &PeakSection::RANGES }, &self.limits)
            .map(Some)
            .map_err(|source| BundleError::Model { path: self.path.join(SENSITIVITY), source })
    }

    /// What says that a folder is a bundle, and which one.
    pub const MANIFEST: &str = "bundle.toml";

    /// The files that a bundle may consist of.
    pub const FILES: [&str; 6] = [MANIFEST, MODEL, NORMALISATION, SENSITIVITY, CORRECTION, CARD];
}

/// Takes mean and scale from their file, where the manifest speaks of one.
fn read_normalisation(folder: &Path, manifest: &mut Manifest, limits: &Limits) -> Result<(), BundleError> {
    let Some(section) = &manifest.normalisation else { return Ok(()) };
    let expected = (section.bytes, section.hash.as_str());
    let bytes = read_whole(folder, (NORMALISATION, "normalisation"), expected, limits.manifest_bytes)?;
    let path = folder.join(NORMALISATION);
    let (mean, scale) = normalisation::decode(&bytes, manifest.numbers()).map_err(|reason| {
        ManifestError::Impossible { file: path.display().to_string(), field: "(whole file)".into(), reason }
    })?;
    (manifest.input.mean, manifest.input.scale) = (mean, scale);
    manifest.validate(&path.display().to_string())?;
    Ok(())
}

/// Reads a graph and checks that it is the one that the manifest speaks of.
fn read_graph(
    folder: &Path,
    (file, field): (&'static str, &'static str),
    section: &ModelSection,
    limits: &Limits,
) -> Result<Vec<u8>, BundleError> {
    let expected = (section.bytes, section.hash.as_str());
    let graph = read_whole(folder, (file, field), expected, limits.graph_bytes)?;
    onnx::check(&graph, &section.interface)
        .and_then(|()| onnx::check_constants(&graph, limits.constant_bytes))
        .map_err(|source| BundleError::Model { path: folder.join(file), source })?;
    Ok(graph)
}

/// Reads a file and checks that it has the length and the hash that the manifest says.
fn read_whole(
    folder: &Path,
    (file, field): (&'static str, &'static str),
    (bytes, expected): (u64, &str),
    most: u64,
) -> Result<Vec<u8>, BundleError> {
    let content = file::read_exactly(folder, (file, field), bytes, most)?;
    let found = hash(&content);
    if !found.eq_ignore_ascii_case(expected) {
        return Err(BundleError::Content {
            path: folder.join(file),
            field,
            found,
            expected: expected.to_owned(),
        });
    }
    Ok(content)
}

/// Replaces a file of a bundle, whole or not at all.
fn replace(path: &Path, text: &str) -> Result<(), BundleError> {
    let failed = |source| BundleError::Io { path: path.to_owned(), action: "written", source };
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut scratch = tempfile::Builder::new().prefix(".amended-").tempfile_in(folder).map_err(failed)?;
    scratch.write_all(text.as_bytes()).and_then(|()| scratch.as_file().sync_all()).map_err(failed)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let readable = std::fs::Permissions::from_mode(0o644);
        scratch.as_file().set_permissions(readable).map_err(failed)?;
    }
    scratch.persist(path).map_err(|e| failed(e.error))?;
    Ok(())
}

pub(crate) fn hash(bytes: &[u8]) -> String {
    let hex: String = Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{hex}")
}

/// A bundle fits every device of the type that it was trained for, whatever the skin file or the device is called.
fn fits(path: &Path, bundle: &SkinSection, description: &SkinDescription) -> Result<(), BundleError> {
    let skin = SkinSection::of(description);
    let unit = (bundle.unit != skin.unit)
        .then(|| format!("the bundle's unit is \"{}\" and the skin's is \"{}\"", bundle.unit, skin.unit));
    let channels = channel_difference(&bundle.channels, &skin.channels);
    if description.is_type(&bundle.hash, &bundle.name) {
        let contradiction = channels.map(|d| ("skin.channels", d)).or(unit.map(|d| ("skin.unit", d)));
        return contradiction.map_or(Ok(()), |(field, difference)| {
            Err(BundleError::Contradiction {
                path: path.join(MANIFEST),
                field,
                difference,
                skin: skin.name.clone(),
            })
        });
    }
    let mut differences: Vec<String> = channels.into_iter().chain(unit).collect();
    if differences.is_empty() {
        differences.push(
            "channels and unit are the same, but the surface, taxel positions, ranges, noise or medium differ"
                .into(),
        );
    }
    Err(BundleError::AnotherSkin(Box::new(SkinMismatch {
        path: path.to_owned(),
        bundle_skin: bundle.name.clone(),
        bundle_hash: bundle.hash.clone(),
        skin: skin.name.clone(),
        skin_hash: skin.hash.clone(),
        difference: differences.join(", and "),
    })))
}

/// How two channel tables differ.
fn channel_difference(bundle: &[String], skin: &[String]) -> Option<String> {
    if bundle == skin {
        return None;
    }
    let lacking = |of: &[String], from: &[String]| {
        let missing: Vec<&String> = of.iter().filter(|name| !from.contains(name)).collect();
        let mut text = missing.iter().take(8).map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
        if missing.len() > 8 {
            text.push_str(&format!(" and {} more", missing.len() - 8));
        }
        text
    };
    let (only_bundle, only_skin) = (lacking(bundle, skin), lacking(skin, bundle));
    Some(match (only_bundle.is_empty(), only_skin.is_empty()) {
        (true, true) => {
            let at = bundle.iter().zip(skin).position(|(a, b)| a != b);
            let name = |of: &[String]| at.and_then(|i| of.get(i)).cloned().unwrap_or_default();
            format!(
                "the channels are in another order: channel {} is `{}` in the bundle and `{}` in the skin",
                at.unwrap_or_else(|| bundle.len().min(skin.len())),
                name(bundle),
                name(skin),
            )
        }
        (false, true) => format!("the bundle has channels that the skin lacks: {only_bundle}"),
        (true, false) => format!("the skin has channels that the bundle lacks: {only_skin}"),
        (false, false) => {
            format!("the bundle has channels {only_bundle} where the skin has {only_skin}")
        }
    })
}

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
