//! `correction.json`: what presses at known locations have shown of how a device differs from its forward model.

use dermis_inversion::{Correction, InverterError};
use serde::{Deserialize, Serialize};

use crate::manifest::{SkinSection, is_hash};

const SCHEMA: &str = "dermis-correction/1";

/// The file `correction.json` and where it comes from. The `[correction]` table of a manifest.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrectionSection {
    /// Its length in bytes.
    #[serde(default)]
    pub bytes: u64,
    /// `sha256:` and 64 hex digits over its content.
    #[serde(default)]
    pub hash: String,
    /// Hash of the recordings that it was learned from.
    pub data_hash: String,
    /// Recorded presses that it was learned from.
    pub presses: u64,
    /// Root mean square, in units of the noise, of what the forward model leaves of presses at locations that nothing was learned
    /// from: without the correction, and with it.
    pub left: [f64; 2],
}

impl CorrectionSection {
    /// Says what is impossible: field and reason.
    pub(crate) fn check(&self) -> Result<(), (&'static str, String)> {
        if !is_hash(&self.hash) {
            return Err(("hash", "must be `sha256:` and 64 hex digits".into()));
        }
        if !self.left.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(("left", "must be two numbers, 0 or positive".into()));
        }
        Ok(())
    }
}

/// The content of the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    schema: String,
    skin: SkinSection,
    correction: Correction,
}

/// What is wrong with a correction.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CorrectionError {
    /// It is no JSON of this schema.
    #[error("{0}; copy the bundle again, or learn the correction anew with `dermis refine --correct`")]
    Parse(String),
    /// It was learned on another skin.
    #[error(
        "was learned on skin `{found}` ({found_hash}), not on the bundle's `{expected}` ({expected_hash}); learn it anew with \
         `dermis refine --correct`"
    )]
    AnotherSkin {
        /// Skin that it names.
        found: String,
        /// Its hash.
        found_hash: String,
        /// Skin of the bundle.
        expected: String,
        /// Its hash.
        expected_hash: String,
    },
    /// Its numbers cannot be.
    #[error(transparent)]
    Impossible(#[from] InverterError),
}

/// The file's text.
pub(crate) fn encode(correction: &Correction, skin: &SkinSection) -> Result<String, serde_json::Error> {
    let file = File { schema: SCHEMA.into(), skin: skin.clone(), correction: correction.clone() };
    serde_json::to_string(&file).map(|text| text + "\n")
}

/// Reads the file of a bundle for `skin`; `same` says whether the skin that a correction was learned on is that one.
pub(crate) fn decode(
    bytes: &[u8],
    skin: &SkinSection,
    same: impl FnOnce(&SkinSection) -> bool,
) -> Result<Correction, CorrectionError> {
    let file: File = serde_json::from_slice(bytes)
        .map_err(|e| CorrectionError::Parse(format!("cannot be read as a correction: {e}")))?;
    if file.schema != SCHEMA {
        let reason = format!("field `schema` is \"{}\" where this program reads \"{SCHEMA}\"", file.schema);
        return Err(CorrectionError::Parse(reason));
    }
    if !same(&file.skin) {
        return Err(CorrectionError::AnotherSkin {
            found: file.skin.name,
            found_hash: file.skin.hash,
            expected: skin.name.clone(),
            expected_hash: skin.hash.clone(),
        });
    }
    file.correction.check(skin.channels.len())?;
    Ok(file.correction)
}
