//! What the node says of itself: in the log when something changes, and once a second on `/diagnostics`.

use std::sync::atomic::Ordering;
use std::time::Duration;

use dermis_msgs::msg::ContactArray;
use dermis_node::{Level, Status};

use super::{Core, Shared};
use crate::fuser::BodyState;

/// Whether two sentences say the same: numbers in a sentence change, what it is about does not.
fn same(a: &str, b: &str) -> bool {
    let words = |text: &str| text.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
    words(a) == words(b)
}

impl Shared {
    /// Logs what is wrong once when it begins, and once when it is over.
    pub(super) fn log_changes(&self, core: &mut Core, state: &BodyState) {
        for (known, at) in core.texts.iter_mut().zip(&state.skins) {
            let text = &at.health.text;
            if !same(known, text) {
                match text.is_empty() {
                    true => tracing::info!("skin `{}`: is back", self.robot.skins[at.skin].name),
                    false => tracing::warn!("{text}"),
                }
                known.clone_from(text);
            }
        }
        let joints = state.joints.sentence().unwrap_or_default();
        if joints.is_empty() != core.joints_text.is_empty() {
            match joints.is_empty() {
                true => tracing::info!("every joint position is known again"),
                false => tracing::warn!("{joints}"),
            }
            core.joints_text = joints;
        }
    }

    /// The state of all skins, and figures of each.
    pub(super) fn diagnose(&self) -> Status {
        if !self.active.load(Ordering::Acquire) {
            return Status::ok("not active");
        }
        let mut core = self.lock();
        let Some(state) = core.last.clone() else { return Status::ok("nothing has been requested yet") };
        let mut status = Status::ok("all skins feel");
        match state.status {
            ContactArray::STATUS_OK => {}
            ContactArray::STATUS_DEGRADED => status.worsen(Level::Warn, &state.text),
            _ => status.worsen(Level::Error, &state.text),
        }
        let refused = core.joints_refused.as_ref().filter(|(_, at)| at.elapsed() < Duration::from_secs(1));
        if let Some((text, _)) = refused {
            status.worsen(Level::Warn, text);
            status.value("refused joint state", text);
        }
        let refused = core.maps_refused.as_ref().filter(|(_, at)| at.elapsed() < Duration::from_secs(1));
        if let Some((text, _)) = refused {
            status.worsen(Level::Warn, text);
            status.value("refused force map", text);
        }
        if let Some(text) = core.fuser.torque_sentence() {
            status.value("joint torques", text);
        }
        let (answers, delay) = std::mem::take(&mut core.answers);
        status.value("contacts", state.contacts.len());
        status.value("answers since the last diagnostics", answers);
        if answers > 0 {
            let mean = delay as f64 * 1e-6 / answers as f64;
            status.value("mean age of the newest reading (ms)", format!("{mean:.1}"));
        }
        for at in &state.skins {
            let (name, health) = (&self.robot.skins[at.skin].name, &at.health);
            status.value(format!("{name}: rate (Hz)"), format!("{:.1}", health.rate));
            status.value(format!("{name}: lost frames"), health.lost);
            status.value(format!("{name}: refused reports"), health.refused);
            status.value(format!("{name}: restarts"), health.restarts);
        }
        status
    }
}
