//! Signatures on the disk, so that a second look at the same presses costs no simulation.

use std::io::{Read, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::GapError;
use crate::recording::{Recording, hex};
use crate::samples::Samples;
use crate::signatures::{Candidate, Signatures};
use crate::simulate::Simulator;
use crate::statistics::Column;
use crate::zero_level::ZeroLevel;

/// Its digit goes up whenever signatures are made otherwise.
const MAGIC: &[u8; 8] = b"dgapsigg";

#[derive(Serialize, Deserialize)]
struct Head {
    candidates: Vec<Candidate>,
    discrepancy: Vec<usize>,
    discrepancy_names: Vec<String>,
    silent: Vec<(String, String)>,
    zero: ZeroLevel,
    nominal: usize,
    columns: Vec<(Option<usize>, usize)>,
}

/// What signatures depend on: the skin with its effects, the family's effects, the presses, what readings count from, the frames that
/// are compared, and this program.
pub(crate) fn key(simulator: &Simulator<'_>, recording: &Recording, samples: &Samples) -> String {
    let mut hasher = Sha256::new();
    hasher.update(MAGIC);
    hasher.update(env!("CARGO_PKG_VERSION"));
    hasher.update(simulator.skin.hash());
    hasher.update(simulator.skin.rate.to_le_bytes());
    for value in [serde_json::to_vec(&simulator.skin.effects), serde_json::to_vec(&simulator.effects)] {
        hasher.update(value.unwrap_or_default());
    }
    hasher.update(recording.stimulus_hash());
    hasher.update([recording.zero as u8]);
    for row in &samples.list {
        hasher.update((row.frame as u64).to_le_bytes());
    }
    hex(&hasher.finalize())[7..].to_owned()
}

/// Signatures that were kept; `None` where there are none that can be read.
pub(crate) fn load(folder: &Path, key: &str) -> Option<Signatures> {
    let mut file = std::io::BufReader::new(
        dermis_io::open_at_most(&folder.join(format!("{key}.sig")), dermis_io::TABLE).ok()?,
    );
    let mut start = [0u8; 16];
    file.read_exact(&mut start).ok()?;
    if &start[..8] != MAGIC {
        return None;
    }
    let length = u64::from_le_bytes(start[8..].try_into().ok()?);
    let mut head = Vec::new();
    file.by_ref().take(length).read_to_end(&mut head).ok()?;
    let head: Head = serde_json::from_slice(&head).ok()?;
    let mut numbers = |count: usize| -> Option<Vec<f32>> {
        let mut bytes = Vec::new();
        file.by_ref().take(count as u64 * 4).read_to_end(&mut bytes).ok()?;
        let (chunks, rest) = bytes.as_chunks::<4>();
        (chunks.len() == count && rest.is_empty())
            .then(|| chunks.iter().map(|b| f32::from_le_bytes(*b)).collect())
    };
    let nominal = numbers(head.nominal)?;
    let columns = head
        .columns
        .iter()
        .map(|(channel, count)| Some(Column { channel: *channel, values: numbers(*count)? }))
        .collect::<Option<Vec<_>>>()?;
    Some(Signatures {
        nominal,
        columns,
        candidates: head.candidates,
        discrepancy: head.discrepancy,
        discrepancy_names: head.discrepancy_names,
        silent: head.silent,
        zero: head.zero,
    })
}

/// Keeps signatures.
pub(crate) fn save(folder: &Path, key: &str, signatures: &Signatures) -> Result<(), GapError> {
    let fail = |path: &Path| {
        let path = path.to_owned();
        move |source| GapError::File { path, what: "written", source }
    };
    std::fs::create_dir_all(folder).map_err(fail(folder))?;
    let head = Head {
        candidates: signatures.candidates.clone(),
        discrepancy: signatures.discrepancy.clone(),
        discrepancy_names: signatures.discrepancy_names.clone(),
        silent: signatures.silent.clone(),
        zero: signatures.zero.clone(),
        nominal: signatures.nominal.len(),
        columns: signatures.columns.iter().map(|c| (c.channel, c.values.len())).collect(),
    };
    let head = serde_json::to_vec(&head)
        .map_err(|e| GapError::Format { what: "signatures", reason: e.to_string() })?;
    // Whole or not at all: another run may read it at any time.
    let (part, path) =
        (folder.join(format!("{key}.{}", std::process::id())), folder.join(format!("{key}.sig")));
    let write = || -> std::io::Result<()> {
        let mut file = std::io::BufWriter::new(std::fs::File::create(&part)?);
        file.write_all(MAGIC)?;
        file.write_all(&(head.len() as u64).to_le_bytes())?;
        file.write_all(&head)?;
        for values in std::iter::once(&signatures.nominal).chain(signatures.columns.iter().map(|c| &c.values))
        {
            for v in values {
                file.write_all(&v.to_le_bytes())?;
            }
        }
        file.flush()?;
        std::fs::rename(&part, &path)
    };
    write().map_err(fail(&path))
}

/// A skin as a file that every command accepts.
///
/// # Errors
///
/// [`GapError::Format`] where TOML cannot say it.
pub fn skin_text(skin: &dermis_skin::SkinDescription) -> Result<String, GapError> {
    toml::to_string(skin).map_err(|e| GapError::Format { what: "the skin", reason: e.to_string() })
}
