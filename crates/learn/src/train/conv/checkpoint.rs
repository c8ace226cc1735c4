//! State of an unfinished convolutional network on disk.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::fit::State;
use super::{ConvSpec, ConvTraining};
use crate::LearnError;
use crate::dataset::hex;

const SCHEMA: &str = "dermis-conv-checkpoint/1";

/// One line of JSON; parameters, both moments and the best parameters follow as little-endian 32-bit floats.
#[derive(Serialize, Deserialize)]
struct Header {
    schema: String,
    /// Over specification and training.
    signature: String,
    epoch: u32,
    steps: u64,
    best_epoch: u32,
    /// Bits of the lowest loss: JSON has no infinity.
    best_loss: u64,
    parameters: usize,
}

fn signature(spec: &ConvSpec, training: &ConvTraining) -> Result<String, LearnError> {
    let text =
        serde_json::to_vec(&(spec, training)).map_err(|e| LearnError::Training { reason: e.to_string() })?;
    Ok(hex(&Sha256::digest(text)))
}

/// Writes whole or not at all.
pub(super) fn save(path: &Path, state: &State, training: &ConvTraining) -> Result<(), LearnError> {
    let header = Header {
        schema: SCHEMA.into(),
        signature: signature(&state.network.spec, training)?,
        epoch: state.epoch,
        steps: state.steps,
        best_epoch: state.best_epoch,
        best_loss: state.best_loss.to_bits(),
        parameters: state.network.len(),
    };
    let mut bytes = serde_json::to_vec(&header)
        .map_err(|e| LearnError::Checkpoint { path: path.into(), reason: e.to_string() })?;
    bytes.push(b'\n');
    let of = |network: &super::ConvNetwork| -> Vec<Vec<f32>> {
        network.parameters.iter().map(|p| p.values.clone()).collect()
    };
    for part in [&of(&state.network), &state.first, &state.second, &of(&state.best)] {
        bytes.extend(part.iter().flatten().flat_map(|v| v.to_le_bytes()));
    }
    let scratch = path.with_extension("new");
    std::fs::write(&scratch, bytes).map_err(LearnError::io(&scratch, "written"))?;
    std::fs::rename(&scratch, path).map_err(LearnError::io(path, "written"))
}

/// Goes on from a file, for a network of the same specification.
pub(super) fn load(
    path: &Path,
    mut state: State,
    spec: &ConvSpec,
    training: &ConvTraining,
) -> Result<State, LearnError> {
    let wrong = |reason: &str| LearnError::Checkpoint { path: path.into(), reason: reason.into() };
    let bytes = dermis_io::read(path, dermis_io::TABLE).map_err(LearnError::io(path, "read"))?;
    let end = bytes.iter().position(|b| *b == b'\n').ok_or_else(|| wrong("is no checkpoint"))?;
    let header: Header = serde_json::from_slice(&bytes[..end]).map_err(|_| wrong("is no checkpoint"))?;
    if header.schema != SCHEMA {
        return Err(wrong("was written by another version"));
    }
    if header.signature != signature(spec, training)? {
        return Err(wrong("belongs to another network or another configuration"));
    }
    let body = &bytes[end + 1..];
    if header.parameters != state.network.len() || body.len() != 16 * state.network.len() {
        return Err(wrong("was cut short"));
    }
    let mut read = body.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let mut fill = |slots: &mut dyn Iterator<Item = &mut Vec<f32>>| {
        slots.flatten().zip(&mut read).for_each(|(slot, number)| *slot = number);
    };
    fill(&mut state.network.parameters.iter_mut().map(|p| &mut p.values));
    fill(&mut state.first.iter_mut());
    fill(&mut state.second.iter_mut());
    fill(&mut state.best.parameters.iter_mut().map(|p| &mut p.values));
    state.best_loss = f64::from_bits(header.best_loss);
    (state.epoch, state.steps, state.best_epoch) = (header.epoch, header.steps, header.best_epoch);
    Ok(state)
}
