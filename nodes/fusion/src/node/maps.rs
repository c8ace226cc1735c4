//! Force maps of the skins: subscribed while somebody listens to what is made of them.

use std::sync::{Arc, PoisonError};
use std::time::Instant;

use dermis_body::Robot;
use dermis_msgs::msg::{ForceMap, SkinGeometry};
use dermis_node::Qos;

use super::Shared;
use crate::maps::Maps;

impl Shared {
    /// Subscribes the skins' maps when somebody begins to listen, and lets them go when nobody does any more: skins do not compute maps
    /// that nobody wants.
    pub(super) fn follow_maps(self: &Arc<Self>) {
        let wanted = self.lock().publishers.maps.subscriber_count() > 0;
        let mut held = self.map_subscriptions.lock().unwrap_or_else(PoisonError::into_inner);
        if wanted != held.is_empty() {
            return;
        }
        if !wanted {
            held.clear();
            self.lock().maps.clear();
            return;
        }
        for (index, skin) in self.robot.skins.iter().enumerate() {
            let (surfaces, forces) = (Arc::downgrade(self), Arc::downgrade(self));
            let geometry = format!("{}/skin_geometry", skin.namespace);
            let map = format!("{}/force_map", skin.namespace);
            let of_geometry = self.node.subscribe(&geometry, Qos::latched(), move |m: SkinGeometry, _| {
                if let Some(shared) = surfaces.upgrade() {
                    shared.take_map(|maps, robot| maps.take_geometry(robot, index, &m));
                }
            });
            let of_map = self.node.subscribe(&map, Qos::sensor_data(), move |m: ForceMap, _| {
                if let Some(shared) = forces.upgrade() {
                    shared.take_map(|maps, robot| maps.take(robot, index, m));
                }
            });
            for subscription in [of_geometry, of_map] {
                match subscription {
                    Ok(subscription) => held.push(subscription),
                    Err(error) => tracing::warn!("{error}"),
                }
            }
        }
    }

    fn take_map(&self, take: impl FnOnce(&mut Maps, &Robot) -> Result<(), String>) {
        let mut core = self.lock();
        if let Err(text) = take(&mut core.maps, &self.robot) {
            if core.maps_refused.as_ref().is_none_or(|(before, _)| *before != text) {
                tracing::warn!("{text}");
            }
            core.maps_refused = Some((text, Instant::now()));
        }
    }
}
