//! Dense networks whose state is kept on disk while they are fitted, so that hours of training can be interrupted.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use sha2::{Digest, Sha256};

use super::checkpoint::{load, save};
use super::config::{NetworkConfig, TrainingConfig};
use super::network::{Batch, Mlp, Progress, State, advance, seed_of};
use crate::LearnError;

/// Time between two states on disk: the most that an interruption costs, and one epoch.
const OFTEN: Duration = Duration::from_secs(30);

/// A folder of states.
#[derive(Debug, Clone)]
pub struct States {
    folder: PathBuf,
    identity: String,
}

impl States {
    /// States in `folder`, which is made. `identity` names all that samples depend on (data sets, skin, settings): a state is only
    /// gone on from where it is the same, and so are network, training and number of samples.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where the folder cannot be made.
    pub fn new(folder: &Path, identity: impl Into<String>) -> Result<Self, LearnError> {
        std::fs::create_dir_all(folder).map_err(LearnError::io(folder, "written"))?;
        Ok(Self { folder: folder.to_owned(), identity: identity.into() })
    }

    /// The same folder, for samples that depend on this, too.
    #[must_use]
    pub fn of(&self, what: &str) -> Self {
        Self { folder: self.folder.clone(), identity: format!("{} {what}", self.identity) }
    }

    /// File and signature of one network.
    fn of_network(
        &self,
        name: &str,
        data: &Batch,
        network: &NetworkConfig,
        training: &TrainingConfig,
    ) -> Result<(PathBuf, String), LearnError> {
        let wrong = |e: serde_json::Error| LearnError::Training { reason: e.to_string() };
        let numbers = [data.len(), data.width, data.outputs];
        let text = serde_json::to_vec(&(&self.identity, name, numbers, network, training)).map_err(wrong)?;
        let signature: String = Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok((self.folder.join(format!("{name}-{}.state", &signature[..16])), signature))
    }
}

/// Fits one network as [`fit`](super::fit) does. Where `keep` says so, its state is kept under a name, half-way and at its end: the
/// same call goes on from there, and ends with the very same network. `report` is called after every epoch.
///
/// # Errors
///
/// [`LearnError`] where the loss stops being a number, or a state cannot be written.
pub fn fit_kept(
    data: &Batch,
    network: &NetworkConfig,
    training: &TrainingConfig,
    keep: Option<(&States, &str)>,
    report: &mut dyn FnMut(Progress),
) -> Result<Mlp, LearnError> {
    let fresh = || Mlp::new(data.width, data.outputs, network, seed_of(training, 0, 0));
    let file = keep.map(|(states, name)| states.of_network(name, data, network, training)).transpose()?;
    // What was cut short, or was written by another version, is no loss but of time.
    let known = file.as_ref().filter(|(path, _)| path.exists());
    let mut state = known
        .and_then(|(path, signature)| load(path, fresh(), signature).ok())
        .unwrap_or_else(|| State::new(fresh()));
    let mut saved = Instant::now();
    advance(&mut state, data, training, 0, &AtomicBool::new(false), &mut |state, progress| {
        report(progress);
        if let Some((path, signature)) = &file
            && (progress.epoch == progress.epochs || saved.elapsed() >= OFTEN)
        {
            save(path, state, signature)?;
            saved = Instant::now();
        }
        Ok(())
    })?;
    Ok(state.network)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::fit;

    fn data(samples: usize) -> Batch {
        let inputs: Vec<f32> = (0..2 * samples).map(|i| (i as f32 * 0.7).sin()).collect();
        let targets = inputs.chunks(2).map(|x| x[0] * x[1]).collect();
        Batch { inputs, targets, width: 2, outputs: 1, ..Batch::default() }
    }

    /// Epochs that a call goes through, and the network.
    fn fitted(data: &Batch, training: &TrainingConfig, states: &States) -> (u32, Mlp) {
        let network = NetworkConfig { hidden: vec![4], ..Default::default() };
        let mut epochs = 0;
        let net = fit_kept(data, &network, training, Some((states, "net")), &mut |_| epochs += 1).unwrap();
        (epochs, net)
    }

    #[test]
    fn what_was_fitted_is_read_and_what_differs_is_fitted_anew() {
        let dir = tempfile::tempdir().unwrap();
        let states = States::new(&dir.path().join("states"), "these data").unwrap();
        let training = TrainingConfig { epochs: 5, batch: 7, ..Default::default() };
        let network = NetworkConfig { hidden: vec![4], ..Default::default() };
        let plain = fit(&data(30), &network, &training, 0).unwrap();
        assert_eq!(fitted(&data(30), &training, &states), (5, plain.clone()));
        assert_eq!(fitted(&data(30), &training, &states), (0, plain.clone()));
        // Other samples, another training, other data.
        assert_eq!(fitted(&data(31), &training, &states).0, 5);
        assert_eq!(fitted(&data(30), &TrainingConfig { epochs: 6, ..training.clone() }, &states).0, 6);
        assert_eq!(fitted(&data(30), &training, &states.of("with another skin")).0, 5);
        // A state that was cut short.
        for entry in std::fs::read_dir(dir.path().join("states")).unwrap() {
            std::fs::write(entry.unwrap().path(), "{}").unwrap();
        }
        assert_eq!(fitted(&data(30), &training, &states), (5, plain));
    }

    #[test]
    fn a_run_that_ended_half_way_goes_on_to_the_same_network() {
        let dir = tempfile::tempdir().unwrap();
        let states = States::new(dir.path(), "these data").unwrap();
        let training = TrainingConfig { epochs: 6, batch: 7, ..Default::default() };
        let network = NetworkConfig { hidden: vec![4], ..Default::default() };
        let (path, signature) = states.of_network("net", &data(30), &network, &training).unwrap();
        let mut half = State::new(Mlp::new(2, 1, &network, seed_of(&training, 0, 0)));
        let stop = AtomicBool::new(false);
        advance(&mut half, &data(30), &training, 0, &stop, &mut |_, progress| {
            stop.store(progress.epoch == 4, std::sync::atomic::Ordering::Relaxed);
            Ok(())
        })
        .unwrap();
        save(&path, &half, &signature).unwrap();
        assert_eq!(
            fitted(&data(30), &training, &states),
            (2, fit(&data(30), &network, &training, 0).unwrap())
        );
    }
}
