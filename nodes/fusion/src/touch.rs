//! Contacts on links, and what acts on a link.

use dermis_body::{Poses, Robot, Wrench};
use dermis_msgs::msg::ContactArray;
use dermis_skin::{Contact, ForceComponents, Stamp};
use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::cause::{Cause, Causes};
use crate::fuser::{SkinAt, SkinState, worse};
use crate::slip::Slip;
use crate::track::{Track, hide_unmeasured};

/// A contact on the body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyTouch {
    /// In the frame of its link; its force is what counts, less what is expected there.
    pub contact: Contact,
    /// \[N\] all that is measured, what is expected there included, in the frame of its link.
    pub measured: Vector3<f64>,
    /// Link that it is on, the innermost one where only joints feel it.
    pub link: usize,
    /// Further links that it can be on; empty where the link is known.
    pub other_links: Vec<usize>,
    /// Skins that feel it and what they call it, the most certain first; empty where only joints feel it.
    pub skins: Vec<(usize, u32)>,
    /// Its link in the body frame; NaN where joint positions are not known.
    pub body_from_link: Isometry3<f64>,
    /// Contact frame in the body frame, z along the outward normal; NaN where joint positions or the place are not known.
    pub body_from_contact: Isometry3<f64>,
    /// \[m/s\] over its link, in the frame of the link; NaN where not known.
    pub velocity: Vector3<f64>,
    /// \[m²/s²\]
    pub velocity_covariance: Matrix3<f64>,
    /// When it was detected first.
    pub born: Stamp,
    /// When the latest reading that it rests on was acquired.
    pub seen: Stamp,
    /// What it is due to.
    pub cause: Cause,
    /// Whether it slips, and the confidence 0 to 1 that this is right; NaN where it is not known.
    pub slip: (Slip, f64),
}

/// What acts on one link with skins.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkLoad {
    /// The link.
    pub link: usize,
    /// About the link's origin, in its frame.
    pub wrench: Wrench,
    /// About the origin of the body frame, in that frame; NaN where joint positions are not known.
    pub body_wrench: Wrench,
    /// \[N²\] of the force; NaN where unknown.
    pub force_covariance: Matrix3<f64>,
    /// The worst status of its skins.
    pub status: u8,
}

/// A track as a contact on its link and on the body; `None` where no skin feels it.
pub(crate) fn place(
    track: &Track,
    robot: &Robot,
    skins: &[SkinState],
    poses: &Poses<'_>,
    causes: &Causes,
) -> Option<BodyTouch> {
    let first = track.sources.first()?.skin;
    let link = robot.skins[first].link;
    // The same link in the frame of the group, by way of the skin.
    let link_from_top = robot.skins[first].pose * skins[first].top_from_skin.inverse();
    let turn = link_from_top.rotation.to_rotation_matrix();
    let (mut contact, velocity, velocity_covariance) = track.estimate();
    contact.position = link_from_top * contact.position;
    contact.normal = turn * contact.normal;
    contact.force = turn * contact.force;
    for covariance in [&mut contact.position_covariance, &mut contact.force_covariance] {
        *covariance = turn * *covariance * turn.transpose();
    }
    hide_unmeasured(&mut contact);
    let measured = contact.force;
    let mut cause = Cause::Environment;
    if contact.force_components != ForceComponents::None {
        (contact.force, cause) = causes.left(link, &contact.position, &contact.force);
    }
    let along =
        nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &contact.normal).unwrap_or_else(|| {
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
    let link_from_contact = Isometry3::from_parts(contact.position.into(), along);
    let body_from_link = poses.between(robot.base, link);
    Some(BodyTouch {
        body_from_contact: body_from_link * link_from_contact,
        body_from_link,
        measured,
        link,
        other_links: Vec::new(),
        skins: track.sources.iter().map(|s| (s.skin, s.track)).collect(),
        velocity: turn * velocity,
        velocity_covariance: turn * velocity_covariance * turn.transpose(),
        born: track.born,
        seen: track.seen,
        cause,
        slip: track.slip.state(),
        contact,
    })
}

/// Sum of what acts on one link. The robot's own touch acts on both its links and counts on each.
pub(crate) fn load(
    link: usize,
    robot: &Robot,
    skins: &[SkinAt],
    contacts: &[BodyTouch],
    poses: &Poses<'_>,
) -> LinkLoad {
    let (mut wrench, mut covariance) = (Wrench::zero(), Matrix3::zeros());
    for touch in contacts.iter().filter(|c| c.link == link && c.cause != Cause::Expected) {
        wrench += Wrench::of_force(touch.contact.force, touch.contact.position);
        covariance += touch.contact.force_covariance;
    }
    let of_link = skins.iter().filter(|s| robot.skins[s.skin].link == link);
    let status = of_link.fold(ContactArray::STATUS_OK, |worst, s| worse(worst, s.health.status));
    // What nothing touches feels nothing, wherever it is.
    let untouched = wrench == Wrench::zero();
    let body_wrench =
        if untouched { Wrench::zero() } else { wrench.seen_from(&poses.between(robot.base, link)) };
    LinkLoad { link, wrench, body_wrench, force_covariance: covariance, status }
}
