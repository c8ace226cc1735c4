//! Making the configured models ready while the node works already.
//!
//! A forward model of finite elements takes seconds to compute where it is not in the cache. Meanwhile the device is read, readings
//! and status are published, and the zero is found: contacts come from the frame on that follows. What takes its time is said in
//! the log, before and after.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use dermis_inference::{Bundle, Limits, Runtime};
use dermis_skin::SkinDescription;
use dermis_skin::cache::{self, Stage, Work};

use super::RunError;
use super::shared::Shared;
use crate::config::Config;
use dermis_estimate::{Models, SetupError, SkinEstimator};
use dermis_sensor::Sensor;

/// Work that takes less is not worth a line.
const QUICK: Duration = Duration::from_millis(300);

/// Reads bundles, and puts the correction of this device in the place of theirs where there is one.
pub(super) fn bundles(
    folders: &[PathBuf],
    skin: &SkinDescription,
    limits: &Limits,
    correction: Option<&Path>,
) -> Result<Vec<Bundle>, SetupError> {
    let load = |folder| Bundle::load_within(folder, skin, limits);
    let mut bundles = folders.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    if let Some(file) = correction {
        for bundle in bundles.iter_mut().filter(|bundle| bundle.manifest().inversion.is_some()) {
            bundle.take_correction(file, skin)?;
        }
    }
    Ok(bundles)
}

/// What makes models ready, on a thread of its own.
pub(super) struct Loader {
    /// Gives the thread the node that the models are for.
    node: Sender<Weak<Shared>>,
    /// Result of the thread.
    ended: Receiver<Result<(), SetupError>>,
}

impl Loader {
    /// Begins; `None` where there is nothing to load. Bundles are read here, so that a configuration that cannot work is refused at
    /// once where it is `strict`.
    pub(super) fn start(
        sensor: &'static dyn Sensor,
        config: &Config,
        skin: &SkinDescription,
        runtime: &'static Runtime,
        estimator: &mut SkinEstimator,
    ) -> Result<Option<Self>, RunError> {
        cache::use_folder(config.cache.folder());
        cache::observe(say);
        if config.models.is_empty() && !config.invert {
            return Ok(None);
        }
        let read = bundles(&config.models, skin, &config.model_limits, config.correction.as_deref());
        let bundles = match read {
            Ok(bundles) => bundles,
            Err(error) if config.strict => return Err(error.into()),
            Err(error) => {
                tracing::error!("{error}");
                estimator.explain_missing_model(error.to_string());
                return Ok(None);
            }
        };
        let mut names: Vec<String> = bundles.iter().map(|b| b.manifest().name.clone()).collect();
        if names.is_empty() {
            names.push(Models::INVERSION.into());
        }
        let names = names.join(", ");
        estimator.explain_missing_model(format!(
            "the model ({names}) is being made ready, so that contacts are unknown yet; wait some seconds"
        ));
        let (node, whom) = channel::<Weak<Shared>>();
        let (end, ended) = channel();
        let (skin, begun) = (skin.clone(), Instant::now());
        let name = skin.name.clone();
        let work = move || {
            tracing::info!("skin `{}`: makes the model ready ({names})", skin.name);
            let models = if bundles.is_empty() {
                Models::inverted(sensor, &skin)
            } else {
                Models::load(sensor, &skin, &bundles, runtime)
            };
            // The node may have ended, or failed to start, before its models were there.
            let Some(shared) = whom.recv().ok().and_then(|node| node.upgrade()) else { return };
            let done = models.and_then(|models| shared.take_over(models));
            match &done {
                Ok(()) => tracing::info!(
                    "skin `{}`: the model ({names}) is ready after {:.2} s",
                    skin.name,
                    begun.elapsed().as_secs_f64()
                ),
                Err(error) => shared.do_without(error),
            }
            // Nobody waits for it but a strict start.
            let _ = end.send(done);
        };
        std::thread::Builder::new()
            .name("dermis-models".into())
            .spawn(work)
            .map_err(|source| RunError::Thread { skin: name, source })?;
        Ok(Some(Self { node, ended }))
    }

    /// Gives the models to a node as soon as they are ready; where `strict`, waits for that and returns the result.
    pub(super) fn hand_over(self, shared: &Arc<Shared>, strict: bool) -> Result<(), RunError> {
        // This fails where the thread ended by a panic; the other channel is closed then, too.
        let _ = self.node.send(Arc::downgrade(shared));
        if !strict {
            return Ok(());
        }
        match self.ended.recv() {
            Ok(done) => Ok(done?),
            Err(_) => Err(RunError::Thread {
                skin: shared.skin.name.clone(),
                source: std::io::Error::other("the thread that makes models ready ended by a panic"),
            }),
        }
    }
}

impl Shared {
    /// Uses models from the next frame on.
    fn take_over(&self, models: Models) -> Result<(), SetupError> {
        let mut core = self.lock();
        if let Err(error) = core.publishers.add(&self.node, models.maps()) {
            // Contacts come all the same.
            tracing::error!("skin `{}`: no maps: {error}", self.skin.name);
        }
        core.estimator.set_models(models);
        core.loading = false;
        Ok(())
    }

    /// Records why there are no contacts.
    fn do_without(&self, error: &SetupError) {
        tracing::error!("{error}");
        let mut core = self.lock();
        core.estimator.explain_missing_model(error.to_string());
        core.loading = false;
    }
}

/// Logs what takes long, and where results come from.
fn say(work: &Work) {
    let what = work.what;
    match &work.stage {
        Stage::Computing => tracing::info!("computes {what}; this may take some seconds"),
        Stage::Computed(time) if *time >= QUICK => {
            tracing::info!("computed {what} in {:.2} s", time.as_secs_f64());
        }
        Stage::Computed(time) => tracing::debug!("computed {what} in {time:?}"),
        Stage::Found(time) => {
            tracing::info!("found {what} in the cache, in {:.0} ms", 1e3 * time.as_secs_f64());
        }
        Stage::Ignored(path, why) => {
            tracing::warn!("cache entry {} is ignored: {why}; what it held is computed anew", path.display());
        }
        Stage::NotKept(folder, why) => {
            tracing::warn!(
                "{what} cannot be kept in {}: {why}; the next start computes it again",
                folder.display()
            );
        }
        _ => {}
    }
}
