//! State of unfinished training on disk.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::config::TrainConfig;
use super::network::{Mlp, State};
use crate::LearnError;
use crate::dataset::{Dataset, hex};

const SCHEMA: &str = "dermis-checkpoint/1";

/// One line of JSON; parameters and both moments follow as little-endian 32-bit floats.
#[derive(Serialize, Deserialize)]
struct Header {
    schema: String,
    signature: String,
    epoch: u32,
    steps: u64,
    parameters: usize,
}

/// Where the state of one member lies.
pub(super) fn path(folder: &Path, member: u32) -> PathBuf {
    folder.join(format!("member-{member}.state"))
}

/// Writes whole or not at all. `signature` names everything that the state depends on.
pub(super) fn save(path: &Path, state: &State, signature: &str) -> Result<(), LearnError> {
    let header = Header {
        schema: SCHEMA.into(),
        signature: signature.into(),
        epoch: state.epoch,
        steps: state.steps,
        parameters: state.network.len(),
    };
    let mut bytes = serde_json::to_vec(&header)
        .map_err(|e| LearnError::Checkpoint { path: path.into(), reason: e.to_string() })?;
    bytes.push(b'\n');
    for part in [&state.network.parameters, &state.first, &state.second] {
        bytes.extend(part.iter().flatten().flat_map(|v| v.to_le_bytes()));
    }
    let scratch = path.with_extension("new");
    std::fs::write(&scratch, bytes).map_err(LearnError::io(&scratch, "written"))?;
    std::fs::rename(&scratch, path).map_err(LearnError::io(path, "written"))
}

/// Goes on from a file, for a network of the same shape.
pub(super) fn load(path: &Path, fresh: Mlp, signature: &str) -> Result<State, LearnError> {
    let wrong = |reason: &str| LearnError::Checkpoint { path: path.into(), reason: reason.into() };
    let bytes = dermis_io::read(path, dermis_io::TABLE).map_err(LearnError::io(path, "read"))?;
    let end = bytes.iter().position(|b| *b == b'\n').ok_or_else(|| wrong("is no checkpoint"))?;
    let header: Header = serde_json::from_slice(&bytes[..end]).map_err(|_| wrong("is no checkpoint"))?;
    if header.schema != SCHEMA {
        return Err(wrong("was written by another version"));
    }
    if header.signature != signature {
        return Err(wrong("belongs to other data or another configuration"));
    }
    let mut state = State::new(fresh);
    let body = &bytes[end + 1..];
    if header.parameters != state.network.len() || body.len() != 12 * state.network.len() {
        return Err(wrong("was cut short"));
    }
    let mut numbers = body.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    for part in [&mut state.network.parameters, &mut state.first, &mut state.second] {
        for (slot, number) in part.iter_mut().flatten().zip(&mut numbers) {
            *slot = number;
        }
    }
    (state.epoch, state.steps) = (header.epoch, header.steps);
    Ok(state)
}

/// Names everything that a checkpoint depends on.
pub(super) fn signature(data: &Dataset, config: &TrainConfig) -> Result<String, LearnError> {
    let mut hasher = Sha256::new();
    hasher.update(data.skin().hash().as_bytes());
    hasher.update(data.hash().as_bytes());
    // The hash of a data set is that of all frames, whether they are used or not.
    for run in data.runs().iter().filter(|run| run.every() > 1) {
        hasher.update(format!("{} of {}", run.samples.len(), run.every()).as_bytes());
    }
    let config = serde_json::to_vec(config).map_err(|e| LearnError::Training { reason: e.to_string() })?;
    hasher.update(config);
    Ok(hex(&hasher.finalize()))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::super::config::{NetworkConfig, TrainingConfig};
    use super::super::network::{Batch, advance, seed_of};
    use super::*;

    fn data() -> Batch {
        let inputs: Vec<f32> = (0..60).map(|i| (i as f32 * 0.7).sin()).collect();
        let targets = inputs.chunks(2).map(|x| x[0] * x[1]).collect();
        Batch { inputs, targets, width: 2, outputs: 1, ..Batch::default() }
    }

    #[test]
    fn an_interrupted_run_ends_where_an_undisturbed_one_does() {
        let dir = tempfile::tempdir().unwrap();
        let file = path(dir.path(), 0);
        let network = NetworkConfig { hidden: vec![4], ..Default::default() };
        let training = TrainingConfig { epochs: 6, batch: 7, noise: 0.01, ..Default::default() };
        let fresh = || Mlp::new(2, 1, &network, seed_of(&training, 0, 0));
        let never = AtomicBool::new(false);

        let mut whole = State::new(fresh());
        advance(&mut whole, &data(), &training, 0, &never, &mut |_, _| Ok(())).unwrap();

        let stop = AtomicBool::new(false);
        let mut part = State::new(fresh());
        advance(&mut part, &data(), &training, 0, &stop, &mut |state, p| {
            stop.store(p.epoch == 3, Ordering::Relaxed);
            save(&file, state, "these data")
        })
        .unwrap();
        assert_eq!(part.epoch, 3);
        let mut resumed = load(&file, fresh(), "these data").unwrap();
        assert_eq!(resumed, part);
        advance(&mut resumed, &data(), &training, 0, &never, &mut |_, _| Ok(())).unwrap();
        assert_eq!(resumed, whole);
    }

    #[test]
    fn a_checkpoint_that_does_not_fit_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let file = path(dir.path(), 0);
        let network = NetworkConfig { hidden: vec![4], ..Default::default() };
        let fresh = || Mlp::new(2, 1, &network, 1);
        save(&file, &State::new(fresh()), "these data").unwrap();
        let message = |signature: &str| {
            let error = load(&file, fresh(), signature).unwrap_err().to_string();
            error.replace(&file.display().to_string(), "FILE")
        };
        insta::assert_snapshot!(message("others"), @"checkpoint FILE: belongs to other data or another configuration; train without `--resume` to begin anew");
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() - 1]).unwrap();
        insta::assert_snapshot!(message("these data"), @"checkpoint FILE: was cut short; train without `--resume` to begin anew");
        std::fs::write(&file, b"hello").unwrap();
        insta::assert_snapshot!(message("these data"), @"checkpoint FILE: is no checkpoint; train without `--resume` to begin anew");
    }
}
