//! The topics of a node: what is offered, and which message is sent when.
//!
//! A message is made only where somebody listens. What late subscribers get, too (the skin's geometry, its transform), goes
//! through a thread of its own, because a peer that does not read can hold its publisher up.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

use dermis_estimate::{Maps, Quality};
use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::msg::{ContactArray, DisplacementMap, ForceMap, SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::{CompressedImage, Image, PointCloud2};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::visualization_msgs::msg::MarkerArray;
use dermis_node::backend::BackendError;
use dermis_node::{Node, NodeError, Publisher, Qos};
use dermis_skin::{Estimate, Frame, SkinDescription};

use super::shared::{Core, Shared};
use crate::messages::{
    contacts_message, markers_message, no_markers_message, points_message, transform_message, wrench_message,
};

/// Messages that are sent again to a subscriber who asks for reliable delivery and lost them.
pub(super) const KEPT: usize = 10;
/// The same for maps, which are larger: some implementations of DDS wait where too many bytes are not confirmed.
pub(super) const KEPT_MAPS: usize = 2;
/// Shortest time between two marker messages: viewers draw 30 times a second.
const MARKER_PERIOD: Duration = Duration::from_millis(33);

/// One for each topic of the skin.
pub(super) struct Publishers {
    pub(super) taxels: Publisher<TaxelFrame>,
    /// Of a skin that is read by a camera, from its first picture on.
    pub(super) image: Option<Publisher<Image>>,
    /// The same pictures as the device sent them.
    pub(super) jpeg: Option<Publisher<CompressedImage>>,
    pub(super) contacts: Publisher<ContactArray>,
    pub(super) wrench: Publisher<WrenchStamped>,
    pub(super) points: Publisher<PointCloud2>,
    pub(super) markers: Publisher<MarkerArray>,
    pub(super) geometry: Publisher<SkinGeometry>,
    /// Where the skin is fixed, if that is known.
    pub(super) transform: Option<Publisher<TFMessage>>,
    pub(super) force_map: Option<Publisher<ForceMap>>,
    pub(super) displacement_map: Option<Publisher<DisplacementMap>>,
    pub(super) markers_sent: Option<Instant>,
    pub(super) arrows: bool,
}

impl Publishers {
    pub(super) fn new(node: &Node, maps: Maps) -> Result<Self, NodeError> {
        let mut publishers = Self {
            taxels: node.stream_publisher("taxels", KEPT)?,
            image: None,
            jpeg: None,
            contacts: node.stream_publisher("contacts", KEPT)?,
            wrench: node.stream_publisher("wrench", KEPT)?,
            points: node.stream_publisher("contact_points", KEPT)?,
            markers: node.stream_publisher("contact_markers", KEPT)?,
            geometry: node.publisher("skin_geometry", Qos::latched())?,
            transform: None,
            force_map: None,
            displacement_map: None,
            markers_sent: None,
            arrows: false,
        };
        publishers.add(node, maps)?;
        Ok(publishers)
    }

    /// Offers these maps besides those that are offered already.
    pub(super) fn add(&mut self, node: &Node, maps: Maps) -> Result<(), NodeError> {
        if maps.force && self.force_map.is_none() {
            self.force_map = Some(node.stream_publisher("force_map", KEPT_MAPS)?);
        }
        if maps.displacement && self.displacement_map.is_none() {
            self.displacement_map = Some(node.stream_publisher("displacement_map", KEPT_MAPS)?);
        }
        Ok(())
    }

    /// Whether somebody listens to anything that is estimated.
    pub(super) fn heard(&self) -> bool {
        // Contacts first: whoever listens to anything mostly listens to them.
        self.contacts.subscriber_count() > 0
            || self.wrench.subscriber_count() > 0
            || self.points.subscriber_count() > 0
            || self.markers.subscriber_count() > 0
            || self.wanted() != Maps::NONE
    }

    /// Maps that somebody listens to.
    pub(super) fn wanted(&self) -> Maps {
        Maps {
            force: self.force_map.as_ref().is_some_and(|p| p.subscriber_count() > 0),
            displacement: self.displacement_map.as_ref().is_some_and(|p| p.subscriber_count() > 0),
        }
    }
}

/// The publisher of static transforms; none where the ROS 2 that is sourced has no messages for them.
pub(super) fn transforms(
    node: &Node,
    skin: &SkinDescription,
) -> Result<Option<Publisher<TFMessage>>, NodeError> {
    match node.publisher("/tf_static", Qos::latched()) {
        Err(NodeError::Backend(error @ BackendError::UnknownType { .. })) => {
            tracing::warn!(
                "skin `{}`: where it is mounted is not published on /tf_static ({error}): install tf2_msgs of your ROS 2 and \
                 build again, or put its frame into the robot's description",
                skin.name
            );
            Ok(None)
        }
        made => made.map(Some),
    }
}

/// What is done on that thread.
pub(super) type Job = Box<dyn FnOnce() -> Result<(), NodeError> + Send>;

/// A thread for what late subscribers get, too: over zenoh a peer that stopped reading holds the publisher of that up for a
/// minute, and frames must not wait for that.
pub(super) fn slow_lane() -> std::io::Result<SyncSender<Job>> {
    let (tx, rx) = sync_channel::<Job>(8);
    std::thread::Builder::new().name("dermis-latched".into()).spawn(move || {
        for job in rx {
            if let Err(error) = job() {
                tracing::debug!("{error}");
            }
        }
    })?;
    Ok(tx)
}

impl Shared {
    /// Publishes on the other thread; what does not fit into its queue is dropped.
    pub(super) fn slowly(&self, job: impl FnOnce() -> Result<(), NodeError> + Send + 'static) {
        if self.slow.try_send(Box::new(job)).is_err() {
            tracing::debug!(
                "a subscriber of skin `{}` does not read: a message for late subscribers was dropped",
                self.skin.name
            );
        }
    }

    /// What late subscribers get, too: the skin's shape, and where it is fixed.
    pub(super) fn publish_latched(&self) {
        let stamp = self.node.clock().now();
        let message = self.skin.geometry_message(&self.surface, stamp);
        let (geometry, transform) = {
            let core = self.lock();
            (core.publishers.geometry.clone(), core.publishers.transform.clone())
        };
        self.slowly(move || geometry.publish(&message));
        if let (Some(publisher), Some(mount)) = (transform, &self.mount) {
            let message =
                transform_message(&self.skin, stamp, mount.parent(), mount.translation(), mount.rotation());
            self.slowly(move || publisher.publish(&message));
        }
    }

    pub(super) fn publish(&self, core: &mut Core, frame: &Frame, estimate: &Estimate) {
        let (skin, stamp) = (&self.skin, frame.stamp);
        let Core { estimator, publishers, .. } = core;
        let contacts = &estimate.contacts;
        let quality = estimator.verdict().quality;
        publishers.taxels.offer(|| Some(skin.frame_message(&estimator.conditioned().reading)));
        publishers.contacts.offer(|| Some(contacts_message(skin, estimator, frame, estimate)));
        if let Some(publisher) = &publishers.force_map {
            publisher.offer(|| estimate.force_map.as_ref().map(|map| map.to_message(skin, frame)));
        }
        if let Some(publisher) = &publishers.displacement_map {
            publisher.offer(|| estimate.displacement_map.as_ref().map(|map| map.to_message(skin, frame)));
        }
        if quality > Quality::Degraded {
            self.clear_arrows(core);
            return;
        }
        if estimator.gives_force() {
            publishers.wrench.offer(|| wrench_message(skin, stamp, contacts));
        }
        publishers.points.offer(|| Some(points_message(skin, stamp, contacts)));
        if contacts.is_empty() {
            self.clear_arrows(core);
        } else if publishers.markers_sent.is_none_or(|at| at.elapsed() >= MARKER_PERIOD) {
            publishers.markers_sent = Some(Instant::now());
            publishers.arrows = true;
            let lifetime = (3.0 / skin.rate).max(0.2);
            let degraded = quality == Quality::Degraded;
            publishers.markers.offer(|| Some(markers_message(skin, stamp, contacts, degraded, lifetime)));
        }
    }

    pub(super) fn clear_arrows(&self, core: &mut Core) {
        if std::mem::take(&mut core.publishers.arrows) {
            let stamp = self.node.clock().now();
            core.publishers.markers.offer(|| Some(no_markers_message(&self.skin, stamp)));
        }
    }
}
