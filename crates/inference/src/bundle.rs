//! Model bundles: a folder with `bundle.toml`, `model.onnx` where anything was learned, `normalisation.npy` where the channels are many,
//! `sensitivity.onnx` where contacts are read off a map, `correction.json` where a forward model was corrected by what was
//! recorded, and, for people, `card.json`.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use dermis_inversion::Correction;
use dermis_skin::SkinDescription;
use sha2::{Digest, Sha256};

use crate::correction::{self, CorrectionError};
use crate::features::Features;
use crate::file;
use crate::limits::Limits;
use crate::manifest::{Manifest, ManifestError, ModelSection, SkinSection};
use crate::model::Model;
use crate::normalisation;
use crate::onnx;
use crate::outputs::Outputs;
use crate::peaks::PeakSection;
use crate::runtime::Runtime;
use crate::trial::{self, Candidate};
pub use error::{BundleError, SkinMismatch};
pub use join::{JoinError, Joined, SIGNAL, join};
pub use writer::BundleWriter;

mod error;
mod join;
mod writer;

const MANIFEST: &str = Bundle::MANIFEST;
const MODEL: &str = "model.onnx";
const SENSITIVITY: &str = "sensitivity.onnx";
const CORRECTION: &str = "correction.json";
const NORMALISATION: &str = "normalisation.npy";
const CARD: &str = "card.json";
/// \[bytes\] longest file of a correction: a device has thousands of channels at most.
const LONGEST_CORRECTION: u64 = 64 << 20;

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
