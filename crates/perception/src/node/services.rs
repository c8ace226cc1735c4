//! The services of a node: `~/tare`, `~/set_enabled`, `~/load_model`.

use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError, Weak};
use std::time::{Duration, Instant};

use dermis_estimate::Models;
use dermis_msgs::srv::{LoadModel, LoadModelResponse};
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolResponse, Trigger, TriggerResponse};
use dermis_node::{NodeError, ServiceServer};
use dermis_skin::TareState;

use super::loader;
use super::shared::{Shared, TICK};
use crate::commands::Command;
use crate::folders;

/// \[s\] beyond its duration that a tare may take before its caller hears that it did not end.
const TARE_PATIENCE: f64 = 2.0;

impl Shared {
    /// Answers a command, where the node obeys it.
    fn command<T>(
        weak: &Weak<Self>,
        command: Command,
        act: impl FnOnce(&Self) -> Result<T, String>,
    ) -> Result<T, String> {
        let shared = weak.upgrade().ok_or("the node is stopping")?;
        match shared.commands.refusal(command) {
            Some(why) => Err(why),
            None => act(&shared),
        }
    }

    /// Offers the services.
    pub(super) fn serve(self: &Arc<Self>) -> Result<Vec<ServiceServer>, NodeError> {
        let answer = |done: Result<String, String>| match done {
            Ok(message) => (true, message),
            Err(message) => (false, message),
        };
        let shared = Arc::downgrade(self);
        let tare = self.node.serve::<Trigger>("~/tare", move |_| {
            let (success, message) = answer(Self::command(&shared, Command::Tare, Self::tare));
            TriggerResponse { success, message }
        })?;
        let shared = Arc::downgrade(self);
        let enable = self.node.serve::<SetBool>("~/set_enabled", move |request| {
            let (success, message) = answer(Self::command(&shared, Command::Enable, |shared| {
                shared.lock().enabled = request.data;
                let message =
                    if request.data { "enabled" } else { "disabled: contacts are reported as stale" };
                Ok(message.into())
            }));
            SetBoolResponse { success, message }
        })?;
        let shared = Arc::downgrade(self);
        let load = self.node.serve::<LoadModel>("~/load_model", move |request| {
            let load = |shared: &Self| shared.load_model(&request.bundle);
            let (success, message) = answer(Self::command(&shared, Command::Load, load));
            LoadModelResponse { success, message }
        })?;
        Ok(vec![tare, enable, load])
    }

    /// Tares and waits for the end of it.
    pub(super) fn tare(&self) -> Result<String, String> {
        let forced =
            self.node.parameters().get("tare_while_touched").and_then(|v| v.as_bool()).unwrap_or(false);
        let mut core = self.lock();
        if !self.active.load(Ordering::Acquire) {
            return Err(
                "the node is not active, so that no frame comes to tare with; activate it first".into()
            );
        }
        if let Some((_, why)) = &core.blind {
            return Err(format!("not tared: {why}"));
        }
        core.estimator.begin_tare(forced).map_err(|refusal| refusal.to_string())?;
        let begun = Instant::now();
        let duration = core.estimator.condition().tare_duration;
        let patience = Duration::from_secs_f64(duration + TARE_PATIENCE + 4.0 / self.skin.rate);
        loop {
            if core.estimator.tare_state() == TareState::Done {
                return Ok(format!("tared over {duration} s"));
            }
            let left = patience.saturating_sub(begun.elapsed());
            if left.is_zero() || self.stopping() {
                let why = match core.estimator.tare_state() {
                    TareState::Averaging { disturbed: Some(spread), .. } => format!(
                        "the readings move by {spread:.1} times their noise; leave the skin untouched and call again"
                    ),
                    _ => format!(
                        "no {duration} s of untouched readings came; leave the skin untouched and call again"
                    ),
                };
                core.estimator.cancel_tare();
                return Err(format!("not tared: {why}"));
            }
            core.awaited += 1;
            core = self.progress.wait_timeout(core, left.min(TICK)).unwrap_or_else(PoisonError::into_inner).0;
            core.awaited -= 1;
        }
    }

    /// Takes a bundle in place of those that give the same outputs.
    fn load_model(&self, name: &str) -> Result<String, String> {
        if self.lock().loading {
            return Err(
                "the models that are configured are still being made ready; call again when contacts come"
                    .into(),
            );
        }
        let folder = folders::bundle(name, &self.model_folders)?;
        let models = loader::bundles(&[folder], &self.skin, &self.model_limits, self.correction.as_deref())
            .and_then(|bundles| Models::load(self.sensor, &self.skin, &bundles, self.runtime))
            .map_err(|e| e.to_string())?;
        let mut core = self.lock();
        core.publishers.add(&self.node, models.maps()).map_err(|e| e.to_string())?;
        core.estimator.replace_models(models);
        let names: Vec<String> =
            core.estimator.models().map(|(name, path)| format!("{name} ({})", path.display())).collect();
        Ok(format!("running {}", names.join(", ")))
    }
}
