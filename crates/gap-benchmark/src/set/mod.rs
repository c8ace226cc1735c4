//! Benchmark sets: recordings whose causes are withheld, sealed by the hash of what is withheld.
//!
//! A benchmark set's folder is public: `manifest.json`, `skin.toml` and one bag a case under `bags/`. Its ground truths lie in another folder, one
//! file a case. A ground truth holds a salt, so that nobody guesses it from its hash; the seed that would rebuild it is in the ground truths
//! only.

mod generate;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{BenchmarkError, Cause, Numerics, Region};

pub use generate::{generate, press, record_again};

/// Schema of a manifest.
pub const SET_SCHEMA: &str = "gap-benchmark-set/1";
/// Schema that manifests had before; they are read as well.
const OLD_SCHEMA: &str = "gap-pack/1";
/// Schema of a ground truth.
pub const GROUND_TRUTH_SCHEMA: &str = "gap-ground-truth/1";
/// Fraction of variance that counts as practically explained: part of every floor, beside the noise.
pub const MARGIN: f64 = 0.005;
/// Cases of a full benchmark set, by what is withheld.
pub const FULL: [(Kind, usize); 6] = [
    (Kind::Singles, 180),
    (Kind::Controls, 100),
    (Kind::OutOfLibrary, 60),
    (Kind::Pairs, 60),
    (Kind::Triples, 20),
    (Kind::Confounded, 20),
];
/// Kinds whose cases are scored apart, each as one cell of the scorecard.
pub const CELLS: [Kind; 7] = [
    Kind::DoesNotRepeat,
    Kind::SameLaw,
    Kind::OtherLaw,
    Kind::DesignNumber,
    Kind::Foreign,
    Kind::Pairs,
    Kind::Controls,
];

/// What is withheld in the cases of a benchmark set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// One cause that the literature lists.
    Singles,
    /// Two of them.
    Pairs,
    /// Three of them.
    Triples,
    /// None: another mesh and other laws only.
    Controls,
    /// A cause that no library holds.
    OutOfLibrary,
    /// A cause that the recording cannot tell from another.
    ///
    /// The temperature only rises, or nothing else shows it.
    Confounded,
    /// A cause that does not come again with the same press.
    DoesNotRepeat,
    /// A cause of the literature with the usual law.
    SameLaw,
    /// A cause of the literature with another law.
    OtherLaw,
    /// A number of the skin's description that is another one.
    DesignNumber,
    /// A systematic cause that no library holds.
    Foreign,
}

impl Kind {
    /// As a command line says it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Singles => "singles",
            Self::Pairs => "pairs",
            Self::Triples => "triples",
            Self::Controls => "controls",
            Self::OutOfLibrary => "out-of-library",
            Self::Confounded => "confounded",
            Self::DoesNotRepeat => "does-not-repeat",
            Self::SameLaw => "same-law",
            Self::OtherLaw => "other-law",
            Self::DesignNumber => "design-number",
            Self::Foreign => "foreign",
        }
    }
}

/// What disturbs a recording without being a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Disturbance {
    /// Nothing.
    #[default]
    Plain,
    /// Noise 30 to 100 % larger than the skin's description says.
    Louder,
    /// Noise with heavy tails, and other deviations from channel to channel.
    HeavyTails,
    /// Every tenth frame is lost, single ones and bursts.
    LostFrames,
}

impl Disturbance {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Plain, Self::Louder, Self::HeavyTails, Self::LostFrames];
}

/// A cause, as the ground truth describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WithheldCause {
    /// The cause itself.
    #[serde(flatten)]
    pub cause: Cause,
    /// Physical description.
    pub what: String,
    /// Sizes in SI units.
    pub parameters: BTreeMap<String, f64>,
    /// Where it sits, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<Region>,
}

/// What is withheld of one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroundTruth {
    schema: String,
    /// Program and version that made it.
    pub generator: String,
    /// Case that it belongs to.
    pub case: String,
    /// What the case counts as: by the causes that reach the least gap, so that it is a control where none does.
    pub kind: Kind,
    /// Random, so that the hash gives nothing away.
    pub salt: String,
    /// Seed of the whole set.
    pub seed: u64,
    /// Causes at work.
    pub causes: Vec<WithheldCause>,
    /// Requested gap, in multiples of `floor`; 0 for controls.
    pub gap: f64,
    /// Noise, in multiples of the skin's.
    pub noise: f64,
    /// What disturbs the recording besides.
    #[serde(default)]
    pub disturbance: Disturbance,
    /// Fraction of variance that noise and practical margin make up.
    pub floor: f64,
    /// Fraction of variance that the causes move, noise-free: measured, not requested.
    pub unexplained: f64,
    /// The same of each cause alone, in their order.
    pub alone: Vec<f64>,
    /// How the reference device is computed.
    #[serde(alias = "form")]
    pub numerics: Numerics,
    /// How the temperature runs.
    pub only_warmer: bool,
    /// How many presses, compared to the usual 150.
    pub size: f64,
}

/// One case, as everybody may see it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Name.
    pub id: String,
    /// Folder of the bag, below that of the benchmark set.
    pub bag: PathBuf,
    /// SHA-256 of the ground truth's file.
    #[serde(alias = "secret_sha256")]
    pub ground_truth_sha256: String,
    /// SHA-256 of the bag's files, one after another in the order of their names.
    pub bag_sha256: String,
    /// Which presses it has: cases of one number have the same ground truth.
    pub presses: usize,
}

/// What everybody may see of a benchmark set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    schema: String,
    /// Program and version that made it.
    pub generator: String,
    /// What is withheld in every case; `None` where each case holds something else, and which is withheld, too.
    pub kind: Option<Kind>,
    /// Name of the skin.
    pub skin: String,
    /// Its hash.
    pub skin_hash: String,
    /// How many presses a case has, compared to the usual 150.
    pub size: f64,
    /// The cases.
    pub cases: Vec<Case>,
}

/// What a benchmark set is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct SetSpec {
    /// How many cases of each kind, in the order of kinds where there is one only, else mixed.
    pub cases: Vec<(Kind, usize)>,
    /// Of everything.
    pub seed: u64,
    /// How many presses a case has, compared to the usual 150.
    pub size: f64,
    /// Whether it is made for a scorecard whose cells are apart: gaps of 3 and 10 floors only, and disturbed controls.
    pub cells: bool,
}

impl SetSpec {
    /// So many cases of each cell of the scorecard.
    #[must_use]
    pub fn cells(count: usize, seed: u64, size: f64) -> Self {
        Self { cases: CELLS.map(|kind| (kind, count)).to_vec(), seed, size, cells: true }
    }

    /// The proportions of a full benchmark set, at `share` of its cases, at least one of each kind.
    #[must_use]
    pub fn mixed(share: f64, seed: u64, size: f64) -> Self {
        let scaled = |count: usize| (count as f64 * share).round().max(1.0) as usize;
        Self { cases: FULL.map(|(kind, count)| (kind, scaled(count))).to_vec(), seed, size, cells: false }
    }

    /// Number of cases.
    #[must_use]
    pub fn count(&self) -> usize {
        self.cases.iter().map(|(_, count)| count).sum()
    }

    /// Kind of all cases, where there is one only.
    fn kind(&self) -> Option<Kind> {
        match self.cases[..] {
            [(kind, _)] => Some(kind),
            _ => None,
        }
    }

    /// How many scripts the cases share. What was done and how well the rig knows it is the same in all cases of a script, so that
    /// a tool simulates its signatures once for them.
    fn scripts(&self) -> usize {
        (self.count() / 24).clamp(2, 16)
    }
}

/// Hexadecimal SHA-256.
#[must_use]
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

fn generator() -> String {
    format!("{} {}", env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"))
}

fn read(path: &Path) -> Result<Vec<u8>, BenchmarkError> {
    dermis_io::read(path, dermis_io::TABLE).map_err(BenchmarkError::io(path, "read"))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), BenchmarkError> {
    std::fs::write(path, bytes).map_err(BenchmarkError::io(path, "written"))
}

fn folder(path: &Path) -> Result<(), BenchmarkError> {
    std::fs::create_dir_all(path).map_err(BenchmarkError::io(path, "made"))
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path, bytes: &[u8]) -> Result<T, BenchmarkError> {
    serde_json::from_slice(bytes)
        .map_err(|e| BenchmarkError::File { path: path.to_owned(), reason: e.to_string() })
}

fn json<T: Serialize>(path: &Path, value: &T) -> Result<Vec<u8>, BenchmarkError> {
    let mut bytes = serde_json::to_vec_pretty(value)
        .map_err(|e| BenchmarkError::File { path: path.to_owned(), reason: e.to_string() })?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// SHA-256 of the files of a bag, in the order of their names.
fn bag_hash(dir: &Path) -> Result<String, BenchmarkError> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(dir)
        .map_err(BenchmarkError::io(dir, "read"))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    let mut hash = Sha256::new();
    for file in files {
        hash.update(read(&file)?);
    }
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}

impl Manifest {
    /// Reads that of the benchmark set `dir`.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::File`] where it is none of ours.
    pub fn load(dir: &Path) -> Result<Self, BenchmarkError> {
        let path = dir.join("manifest.json");
        let manifest: Self = parse(&path, &read(&path)?)?;
        if ![SET_SCHEMA, OLD_SCHEMA].contains(&manifest.schema.as_str()) {
            let reason = format!("field `schema` is \"{}\" where \"{SET_SCHEMA}\" is read", manifest.schema);
            return Err(BenchmarkError::File { path, reason });
        }
        Ok(manifest)
    }

    /// SHA-256 of the manifest's file: with it everything of the benchmark set is said.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::Io`] where it cannot be read.
    pub fn hash(dir: &Path) -> Result<String, BenchmarkError> {
        Ok(sha256(&read(&dir.join("manifest.json"))?))
    }
}

/// Opens the ground truth of `case` in the folder `ground_truths`.
///
/// # Errors
///
/// [`BenchmarkError::Seal`] where it is not the one whose hash was published.
pub fn open_ground_truth(ground_truths: &Path, case: &Case) -> Result<GroundTruth, BenchmarkError> {
    let path = ground_truths.join(format!("{}.json", case.id));
    let bytes = read(&path)?;
    let found = sha256(&bytes);
    if found != case.ground_truth_sha256 {
        return Err(BenchmarkError::Seal { path, found, published: case.ground_truth_sha256.clone() });
    }
    parse(&path, &bytes)
}
