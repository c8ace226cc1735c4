//! Efforts of joints, as `/joint_states` brings them.

use dermis_msgs::msg::BodyContact;
use dermis_msgs::std_msgs::msg::Header;
use dermis_skin::Contact;
use nalgebra::{Point3, Vector3};

use super::*;
use crate::testing::arm::{BENT, ONE_SKIN, holding_torques, joints, push_torques, urdf, write_arm};
use crate::torque::TorqueSettings;

/// \[m\] in the plane of the skin of the fourth link, and \[N\], in the frame of that skin.
const ON_SKIN: ([f64; 2], [f64; 3]) = ([0.01, -0.02], [5.0, 8.0, -40.0]);
/// \[m\], \[N\] on the last link, in its frame, where no skin is.
const ON_HAND: ([f64; 3], [f64; 3]) = ([0.08, 0.05, 0.1], [-14.0, 9.0, -20.0]);

fn on_skin() -> Contact {
    let ([x, y], force) = ON_SKIN;
    let mut push = contact(1, x, y, 0.0);
    push.force = Vector3::from(force);
    push
}

/// \[N m\] of the push on the skin, which is turned by −90° about x on its link: its y is the link's −z, its z is the link's y.
fn torques_on_skin() -> [f64; 7] {
    let ([x, y], [fx, fy, fz]) = ON_SKIN;
    push_torques(&BENT, 4, Point3::new(x, 0.05, 0.1 - y), Vector3::new(fx, fz, -fy))
}

/// The arm at rest, with these efforts.
struct Still {
    bench: Bench,
    states: Publisher<JointState>,
    skin: Publisher<ContactArray>,
    efforts: [f64; 7],
}

impl Still {
    /// Publishes joint states and frames of the skin with these contacts until an answer fits.
    fn until(
        &mut self,
        contacts: &[Contact],
        body: &Receiver<BodyContacts>,
        fits: impl Fn(&BodyContacts) -> bool,
    ) -> BodyContacts {
        let deadline = Instant::now() + WAIT;
        let mut last = None;
        loop {
            let stamp = self.bench.other.clock().now();
            let state = JointState {
                header: Header::new(stamp, ""),
                name: joints(),
                position: BENT.to_vec(),
                velocity: vec![0.0; 7],
                effort: self.efforts.to_vec(),
            };
            self.states.publish(&state).unwrap();
            self.bench.sequence += 1;
            self.skin.publish(&report("a", self.bench.sequence, stamp, contacts)).unwrap();
            for message in body.try_iter() {
                if fits(&message) {
                    return message;
                }
                last = Some(message);
            }
            assert!(Instant::now() < deadline, "no answer fits; the last one was {last:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Whether torques are these, within 10 mN m.
fn are(found: &[f64], truth: &[f64; 7]) -> bool {
    found.len() == 7 && found.iter().zip(truth).all(|(found, truth)| (found - truth).abs() < 0.01)
}

/// The contact that no skin feels.
fn unknown(message: &BodyContacts) -> Option<&BodyContact> {
    message.contacts.iter().find(|c| c.skins.is_empty())
}

/// Two pushes on an arm at rest, one on its skin and one where no skin is: the skin's contact explains its part of the efforts, and the rest
/// is a contact on the last link. Then the skin says that nothing touches it, with the same efforts: what they disagree by are both pushes.
#[test]
fn efforts_that_the_skin_does_not_explain_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let robot = write_arm(folder.path(), &urdf(), ONE_SKIN);
    let bench = Bench::start(|c| {
        c.robot = robot;
        c.torques = Some(TorqueSettings::default());
    });
    let (_b, body) = bench.listen::<BodyContacts>("/body_contacts");
    let (at, force) = (Point3::from(ON_HAND.0), Vector3::from(ON_HAND.1));
    let (weight, of_skin) = (holding_torques(&BENT), torques_on_skin());
    let of_hand = push_torques(&BENT, 7, at, force);
    let both: [f64; 7] = std::array::from_fn(|i| of_skin[i] + of_hand[i]);
    let mut arm = Still {
        states: bench.other.stream_publisher("/joint_states", 10).unwrap(),
        skin: bench.other.stream_publisher("/a/contacts", 10).unwrap(),
        // What a push puts on a joint, the drive need not.
        efforts: std::array::from_fn(|i| weight[i] - both[i]),
        bench,
    };

    // The observer has settled. The arm is in a posture in which its joints tell the force, too.
    let message = arm.until(&[on_skin()], &body, |m| {
        let near = |touch: &BodyContact| {
            let f = &touch.contact.force;
            (Vector3::new(f.x, f.y, f.z) - force).norm() < 0.1
        };
        are(&m.joint_torques, &of_skin)
            && are(&m.unexplained_torques, &of_hand)
            && unknown(m).is_some_and(near)
    });
    assert_eq!(message.joints, joints());
    assert!(message.unexplained_variances.iter().all(|v| *v > 0.0), "{:?}", message.unexplained_variances);
    let touch = unknown(&message).unwrap();
    assert_eq!((touch.link.as_str(), touch.other_links.len(), message.contacts.len()), ("l7", 0, 2));
    assert!(touch.contact.position.x.is_nan(), "where on the link is not known");

    let message =
        arm.until(&[], &body, |m| are(&m.joint_torques, &[0.0; 7]) && are(&m.unexplained_torques, &both));
    assert!(message.contacts.iter().all(|c| c.skins.is_empty()), "{:?}", message.contacts);
}
