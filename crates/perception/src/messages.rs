//! What planners, controllers and viewers read, made from an estimate.

use dermis_msgs::builtin_interfaces::msg::Duration;
use dermis_msgs::geometry_msgs::msg::{
    Quaternion, Transform, TransformStamped, Vector3 as VectorMsg, WrenchStamped,
};
use dermis_msgs::msg::ContactArray;
use dermis_msgs::sensor_msgs::msg::{PointCloud2, PointField};
use dermis_msgs::std_msgs::msg::{ColorRGBA, Header};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::visualization_msgs::msg::{Marker, MarkerArray};
use dermis_skin::convert::{point, vector};
use dermis_skin::{Contact, Estimate, ForceComponents, Frame, SkinDescription, Stamp, contact_array};
use nalgebra::Vector3;

use dermis_estimate::{Quality, SkinEstimator};

/// \[m\] of an arrow per newton.
const ARROW_PER_NEWTON: f64 = 0.01;
/// \[m\] shortest and longest arrow.
const ARROW: (f64, f64) = (0.004, 0.06);
/// Names of the floats of a point, in order.
const POINT_FIELDS: [&str; 11] =
    ["x", "y", "z", "nx", "ny", "nz", "fx", "fy", "fz", "confidence", "intensity"];

/// The estimate of one frame with everything that a stranger needs to read it.
#[must_use]
pub fn contacts_message(
    skin: &SkinDescription,
    estimator: &SkinEstimator,
    frame: &Frame,
    estimate: &Estimate,
) -> ContactArray {
    let verdict = estimator.verdict();
    ContactArray {
        status: match verdict.quality {
            Quality::Ok => ContactArray::STATUS_OK,
            Quality::Degraded => ContactArray::STATUS_DEGRADED,
            Quality::Uncalibrated => ContactArray::STATUS_UNCALIBRATED,
            Quality::Fault => ContactArray::STATUS_FAULT,
        },
        status_text: verdict.text.clone(),
        force_threshold: estimator.force_threshold() as f32,
        force_max: estimator.force_max() as f32,
        ..contact_array(skin, frame, estimate)
    }
}

/// What is said where there is no frame to say anything about: no contacts, and why that means nothing.
#[must_use]
pub fn blind_message(
    skin: &SkinDescription,
    estimator: &SkinEstimator,
    stamp: Stamp,
    sequence: u64,
    status: u8,
    text: &str,
) -> ContactArray {
    let frame = Frame::new(stamp, sequence, Vec::new());
    ContactArray {
        status,
        status_text: text.to_owned(),
        force_threshold: estimator.force_threshold() as f32,
        force_max: estimator.force_max() as f32,
        ..contact_array(skin, &frame, &Estimate::default())
    }
}

/// Sum of the contact forces \[N\] and of their moments about the link's origin \[N m\], in the link's frame; `None`
/// where a contact's force is not measured. A moment is NaN where a contact has no position.
#[must_use]
pub fn wrench_message(skin: &SkinDescription, stamp: Stamp, contacts: &[Contact]) -> Option<WrenchStamped> {
    if contacts.iter().any(|c| c.force_components == ForceComponents::None) {
        return None;
    }
    let mut force = Vector3::zeros();
    let mut torque = Vector3::zeros();
    for contact in contacts {
        force += contact.force;
        torque += contact.position.coords.cross(&contact.force);
    }
    let mut message = WrenchStamped { header: skin.header(stamp), ..WrenchStamped::default() };
    message.wrench.force = vector(&force);
    message.wrench.torque = vector(&torque);
    Some(message)
}

/// One point a contact that has a position: position \[m\], normal, force \[N\], confidence, and |force| \[N\] as
/// intensity.
#[must_use]
pub fn points_message(skin: &SkinDescription, stamp: Stamp, contacts: &[Contact]) -> PointCloud2 {
    points_in(skin.header(stamp), contacts)
}

/// The same for contacts in the coordinate frame of a header.
#[must_use]
pub fn points_in(header: Header, contacts: &[Contact]) -> PointCloud2 {
    let placed: Vec<&Contact> =
        contacts.iter().filter(|c| c.position.iter().all(|v| v.is_finite())).collect();
    let mut data = Vec::with_capacity(placed.len() * POINT_FIELDS.len() * 4);
    let mut dense = true;
    for c in &placed {
        let numbers = c.position.iter().chain(c.normal.iter()).chain(c.force.iter()).map(|v| *v as f32);
        for number in numbers.chain([c.confidence, c.force.norm() as f32]) {
            dense &= number.is_finite();
            data.extend_from_slice(&number.to_le_bytes());
        }
    }
    let step = 4 * POINT_FIELDS.len() as u32;
    let width = placed.len() as u32;
    PointCloud2 {
        header,
        height: 1,
        width,
        fields: POINT_FIELDS
            .iter()
            .zip(0_u32..)
            .map(|(name, i)| PointField {
                name: (*name).to_owned(),
                offset: 4 * i,
                datatype: PointField::FLOAT32,
                count: 1,
            })
            .collect(),
        is_bigendian: false,
        point_step: step,
        row_step: step * width,
        data,
        is_dense: dense,
    }
}

/// One arrow a contact that has a position, from outside onto the skin along the force (against the normal where no
/// force is known), 10 mm a newton; orange where the skin is degraded, and fainter the less certain the contact is.
/// Arrows vanish by themselves after `lifetime` \[s\].
#[must_use]
pub fn markers_message(
    skin: &SkinDescription,
    stamp: Stamp,
    contacts: &[Contact],
    degraded: bool,
    lifetime: f64,
) -> MarkerArray {
    markers_in(&skin.header(stamp), &skin.name, contacts, degraded, lifetime)
}

/// The same for contacts in the coordinate frame of a header; `namespace` is theirs among the markers of a viewer.
#[must_use]
pub fn markers_in(
    header: &Header,
    namespace: &str,
    contacts: &[Contact],
    degraded: bool,
    lifetime: f64,
) -> MarkerArray {
    let arrow = |contact: &Contact| {
        let magnitude = contact.force.norm();
        let direction = contact.force.try_normalize(1e-9).unwrap_or(-contact.normal);
        let length = if magnitude.is_finite() {
            (ARROW_PER_NEWTON * magnitude).clamp(ARROW.0, ARROW.1)
        } else {
            ARROW_PER_NEWTON
        };
        let direction = if direction.iter().all(|v| v.is_finite()) { direction } else { -contact.normal };
        let mut marker = Marker {
            header: header.clone(),
            ns: namespace.to_owned(),
            id: i32::from_ne_bytes(contact.track_id.to_ne_bytes()),
            r#type: Marker::ARROW,
            action: Marker::ADD,
            // Width of the shaft and of the head.
            scale: VectorMsg { x: 0.0015, y: 0.003, z: 0.0 },
            color: ColorRGBA {
                r: if degraded { 1.0 } else { 0.1 },
                g: if degraded { 0.55 } else { 0.8 },
                b: 0.1,
                a: contact.confidence.clamp(0.2, 1.0),
            },
            lifetime: Duration { sec: lifetime.trunc() as i32, nanosec: (lifetime.fract() * 1e9) as u32 },
            points: vec![point(&(contact.position - direction * length)), point(&contact.position)],
            ..Marker::default()
        };
        marker.pose.orientation.w = 1.0;
        marker
    };
    let placed = |c: &&Contact| c.position.iter().chain(c.normal.iter()).all(|v| v.is_finite());
    MarkerArray { markers: contacts.iter().filter(placed).map(arrow).collect() }
}

/// Where a skin is fixed: its frame in that of the link `parent`, at `translation` \[m\], turned by the unit quaternion
/// `rotation` (x, y, z, w).
#[must_use]
pub fn transform_message(
    skin: &SkinDescription,
    stamp: Stamp,
    parent: &str,
    translation: [f64; 3],
    rotation: [f64; 4],
) -> TFMessage {
    TFMessage { transforms: vec![transform_in(stamp, parent, &skin.frame_id, translation, rotation)] }
}

/// The pose of the coordinate frame `child` in `parent`.
#[must_use]
pub fn transform_in(
    stamp: Stamp,
    parent: &str,
    child: &str,
    translation: [f64; 3],
    rotation: [f64; 4],
) -> TransformStamped {
    let [x, y, z] = translation;
    let transform = Transform {
        translation: VectorMsg { x, y, z },
        rotation: Quaternion { x: rotation[0], y: rotation[1], z: rotation[2], w: rotation[3] },
    };
    TransformStamped { header: Header::new(stamp, parent), child_frame_id: child.to_owned(), transform }
}

/// Takes away all arrows.
#[must_use]
pub fn no_markers_message(skin: &SkinDescription, stamp: Stamp) -> MarkerArray {
    no_markers_in(skin.header(stamp), &skin.name)
}

/// The same for the markers of a namespace.
#[must_use]
pub fn no_markers_in(header: Header, namespace: &str) -> MarkerArray {
    let mut marker =
        Marker { header, ns: namespace.to_owned(), action: Marker::DELETEALL, ..Marker::default() };
    marker.pose.orientation.w = 1.0;
    MarkerArray { markers: vec![marker] }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use dermis_estimate::testing::{TestBundle, skin_with, tared_estimator};
    use dermis_skin::Estimator;

    const STAMP: Stamp = 1_700_000_000_123_456_789;

    fn contact(x: f64, force: f64) -> Contact {
        let mut c = Contact::at(Point3::new(x, 0.002, 0.0), Vector3::z());
        c.force = Vector3::new(0.0, 0.0, -force);
        c.force_components = ForceComponents::Normal;
        c.track_id = 3;
        c
    }

    #[test]
    fn contacts_describe_themselves() {
        let (mut estimator, _dir) = tared_estimator(&TestBundle::default());
        let frame = Frame::new(STAMP, 812, vec![103_325.0, 101_325.0, 101_325.0, 101_325.0]);
        let estimate = estimator.estimate(&frame).unwrap();
        let message = contacts_message(&skin_with(""), &estimator, &frame, &estimate);
        assert_eq!(message.header.frame_id, "pad_link");
        assert_eq!(message.header.stamp.as_nanos(), STAMP, "the time of acquisition");
        assert_eq!((message.sequence, message.status), (812, ContactArray::STATUS_OK));
        assert_eq!(message.skin, "pad");
        assert!((message.force_threshold - 0.1).abs() < 1e-6 && (message.force_max - 5.0).abs() < 1e-6);
        let c = &message.contacts[0];
        assert!(c.track_id > 0 && c.force.z * c.normal.z < 0.0);
    }

    #[test]
    fn blind_never_looks_like_untouched() {
        let (estimator, _dir) = tared_estimator(&TestBundle::default());
        let message = blind_message(
            &skin_with(""),
            &estimator,
            STAMP,
            9,
            ContactArray::STATUS_STALE,
            "no frame for 2 s",
        );
        assert!(message.contacts.is_empty());
        assert_ne!(message.status, ContactArray::STATUS_OK);
        assert_eq!(message.status_text, "no frame for 2 s");
    }

    #[test]
    fn the_wrench_is_about_the_origin_of_the_link() {
        let skin = skin_with("");
        let message = wrench_message(&skin, STAMP, &[contact(0.01, 2.0), contact(-0.01, 1.0)]).unwrap();
        assert_eq!(message.header.frame_id, "pad_link");
        assert!((message.wrench.force.z + 3.0).abs() < 1e-12);
        // r × F = (y Fz, −x Fz): 0.002·(−3), −(0.01·(−2) − 0.01·(−1)).
        assert!((message.wrench.torque.x + 0.006).abs() < 1e-12);
        assert!((message.wrench.torque.y - 0.01).abs() < 1e-12);
        let untouched = wrench_message(&skin, STAMP, &[]).unwrap();
        assert_eq!(untouched.wrench.force, VectorMsg::default());
        let unknown = Contact::at(Point3::origin(), Vector3::z());
        assert_eq!(
            wrench_message(&skin, STAMP, &[unknown]),
            None,
            "a force that is not measured is not zero"
        );
    }

    #[test]
    fn the_cloud_has_the_fields_that_viewers_know() {
        let skin = skin_with("");
        let lost = Contact::at(Point3::new(f64::NAN, 0.0, 0.0), Vector3::z());
        let message = points_message(&skin, STAMP, &[contact(0.01, 2.0), lost]);
        assert_eq!((message.height, message.width, message.point_step), (1, 1, 44));
        assert_eq!(message.data.len(), 44);
        assert_eq!(message.row_step, 44);
        let read = |name: &str| {
            let at = message.fields.iter().find(|f| f.name == name).unwrap().offset as usize;
            f32::from_le_bytes(message.data[at..at + 4].try_into().unwrap())
        };
        assert_eq!((read("x"), read("y"), read("nz")), (0.01, 0.002, 1.0));
        assert_eq!((read("fz"), read("intensity"), read("confidence")), (-2.0, 2.0, 1.0));
        assert!(message.is_dense && !message.is_bigendian);
        let empty = points_message(&skin, STAMP, &[]);
        assert_eq!((empty.width, empty.fields.len()), (0, 11));
    }

    #[test]
    fn the_transform_goes_from_the_link_to_the_skin() {
        let message =
            transform_message(&skin_with(""), STAMP, "wrist", [0.1, 0.2, 0.3], [0.0, 0.6, 0.0, 0.8]);
        let [transform] = message.transforms.as_slice() else { panic!("one transform") };
        assert_eq!(
            (transform.header.frame_id.as_str(), transform.child_frame_id.as_str()),
            ("wrist", "pad_link")
        );
        assert_eq!(transform.header.stamp.as_nanos(), STAMP);
        assert_eq!(transform.transform.translation, VectorMsg { x: 0.1, y: 0.2, z: 0.3 });
        assert_eq!(transform.transform.rotation, Quaternion { x: 0.0, y: 0.6, z: 0.0, w: 0.8 });
    }

    #[test]
    fn arrows_end_on_the_skin_and_vanish() {
        let skin = skin_with("");
        let message = markers_message(&skin, STAMP, &[contact(0.01, 2.0)], false, 0.25);
        let [marker] = message.markers.as_slice() else { panic!("one arrow") };
        assert_eq!((marker.ns.as_str(), marker.id, marker.r#type), ("pad", 3, Marker::ARROW));
        assert_eq!((marker.lifetime.sec, marker.lifetime.nanosec), (0, 250_000_000));
        let [start, end] = marker.points.as_slice() else { panic!("start and end") };
        assert_eq!((end.x, end.y, end.z), (0.01, 0.002, 0.0));
        assert!((start.z - 0.02).abs() < 1e-12, "2 N are 20 mm, from outside");
        assert_eq!(marker.pose.orientation.w, 1.0);

        let unknown = Contact { track_id: 4, ..Contact::at(Point3::origin(), Vector3::z()) };
        let message = markers_message(&skin, STAMP, &[unknown], true, 0.25);
        assert!((message.markers[0].points[0].z - 0.01).abs() < 1e-12);
        let clear = no_markers_message(&skin, STAMP);
        assert_eq!(clear.markers[0].action, Marker::DELETEALL);
    }
}
