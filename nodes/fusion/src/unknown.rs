//! Contacts that no skin feels and joints do: which links can they be on?
//!
//! Problem: [unexplained torques](crate::torque) say that something pushes, but not where. Method: a contact moves only the joints
//! between the base and its link. So the outermost joint of a chain whose torque is unexplained (beyond
//! [`alarm`](TorqueSettings::alarm) standard deviations, for [`confirm`](TorqueSettings::confirm)) says the innermost link that the contact
//! can be on (Haddadin, De Luca and Albu-Schäffer 2017, §V-A). Links beyond further joints stay possible: a force through the axis of a
//! joint moves it not. They are ruled out once such a joint has turned by [`TURNED`] meanwhile and still feels nothing, and where a
//! joint's torque is not known, its links stay. Chains of their own have contacts of their own; two contacts on one chain are one here.
//!
//! The force is reported where the torques of six joints or more determine it: weighted least squares of the wrench on the innermost link, for
//! any place of the contact.
//!
//! A contact ends when the joint has been below [`STAYS`] of the alarm for as long.
//!
//! Cost: linear in joints and links; one 6×6 eigenvalue problem a contact.

use dermis_body::{Body, JointKind, Poses, Robot};
use dermis_skin::{Contact, ForceComponents, Stamp};
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, SymmetricEigen, Vector3, Vector6};

use crate::cause::Cause;
use crate::slip::Slip;
use crate::torque::{TorqueSettings, Torques};
use crate::touch::BodyTouch;
use crate::track::seconds;

/// \[rad\], or \[m\] times ten, by which a joint has to have turned that rules out what it carries.
const TURNED: f64 = 0.2;
/// \[1\] of the alarm above which a contact stays.
const STAYS: f64 = 0.75;
/// \[m\] that moments are compared with forces by: the size of a limb.
const LENGTH: f64 = 0.1;
/// Least ratio of eigenvalues of the information on a wrench that determines it.
const DETERMINED: f64 = 1e-7;

/// One contact on a chain of joints.
#[derive(Debug, Clone)]
struct Active {
    /// Outermost coordinate whose torque is unexplained.
    tip: usize,
    /// 0 before it is published.
    id: u32,
    born: Stamp,
    seen: Stamp,
    /// Joint positions when it began.
    positions: Vec<f64>,
    /// Further joints that have turned without contact.
    passed: Vec<usize>,
}

/// All contacts that only joints feel.
#[derive(Debug, Default)]
pub(crate) struct Unknowns {
    active: Vec<Active>,
    at: Stamp,
}

/// Coordinates between the base and each coordinate's joint.
fn above(body: &Body, coordinate: usize) -> Vec<usize> {
    let mut above = Vec::new();
    let mut link = body.coordinates().nth(coordinate).map(|j| j.parent);
    while let Some(joint) = link.and_then(|l| body.joint_above(l)) {
        above.extend(joint.moved_by.map(|by| by.coordinate));
        link = Some(joint.parent);
    }
    above
}

impl Unknowns {
    pub(crate) fn clear(&mut self) {
        self.active.clear();
    }

    /// Takes unexplained torques of an instant and the joint positions that they are for.
    pub(crate) fn take(
        &mut self,
        body: &Body,
        at: Stamp,
        torques: &Torques,
        positions: &[f64],
        s: &TorqueSettings,
        mut identity: impl FnMut() -> u32,
    ) {
        self.at = at;
        let strength: Vec<f64> =
            torques.values.iter().zip(&torques.variances).map(|(t, v)| t.abs() / v.sqrt()).collect();
        let strong: Vec<usize> = (0..strength.len()).filter(|i| strength[*i] > s.alarm).collect();
        let ancestors: Vec<Vec<usize>> = (0..strength.len()).map(|i| above(body, i)).collect();
        let related = |a: usize, b: usize| a == b || ancestors[a].contains(&b) || ancestors[b].contains(&a);
        let tips = strong.iter().copied().filter(|t| !strong.iter().any(|o| ancestors[*o].contains(t)));
        for tip in tips {
            match self.active.iter_mut().find(|a| related(a.tip, tip)) {
                Some(active) => {
                    active.tip = tip;
                    active.seen = at;
                }
                None => self.active.push(Active {
                    tip,
                    id: 0,
                    born: at,
                    seen: at,
                    positions: positions.to_vec(),
                    passed: Vec::new(),
                }),
            }
        }
        for active in &mut self.active {
            if active.id != 0 && strength[active.tip] > STAYS * s.alarm {
                active.seen = at;
            }
            for (k, joint) in body.coordinates().enumerate() {
                let scale = if joint.kind == JointKind::Prismatic { 10.0 } else { 1.0 };
                let turned = (positions[k] - active.positions[k]).abs() * scale;
                if turned > TURNED && strength[k] < s.alarm && !active.passed.contains(&k) {
                    active.passed.push(k);
                }
            }
            if active.id == 0 && active.seen == at && seconds(active.born, at) >= s.confirm {
                active.id = identity();
            }
        }
        // What is not confirmed has to be there in each state.
        self.active
            .retain(|a| if a.id == 0 { a.seen == at } else { seconds(a.seen, at) < s.confirm.max(1e-3) });
    }

    /// The contacts that are there.
    pub(crate) fn touches(&self, robot: &Robot, poses: &Poses<'_>, torques: &Torques) -> Vec<BodyTouch> {
        self.active.iter().filter(|a| a.id != 0).filter_map(|a| a.touch(robot, poses, torques)).collect()
    }
}

impl Active {
    fn touch(&self, robot: &Robot, poses: &Poses<'_>, torques: &Torques) -> Option<BodyTouch> {
        let link = robot.body.coordinates().nth(self.tip)?.child;
        let nowhere = Vector3::repeat(f64::NAN);
        let mut contact = Contact::at(Point3::from(nowhere), nowhere);
        contact.track_id = self.id;
        contact.position_covariance = Matrix3::repeat(f64::NAN);
        (contact.force, contact.force_covariance) = (nowhere, Matrix3::repeat(f64::NAN));
        contact.force_components = ForceComponents::None;
        contact.diameter = f32::NAN;
        if let Some((force, covariance)) = force_on(link, poses, torques) {
            contact.force_components = ForceComponents::Full;
            (contact.force, contact.force_covariance) = (force, covariance);
        }
        // Both tails of a normal distribution are below 2 exp(−x²/2).
        let square = torques.values[self.tip].powi(2) / torques.variances[self.tip];
        contact.confidence = (1.0 - 2.0 * (-0.5 * square).exp()).clamp(0.0, 1.0) as f32;
        let mut body_from_contact = Isometry3::identity();
        body_from_contact.translation.vector.fill(f64::NAN);
        Some(BodyTouch {
            measured: contact.force,
            contact,
            link,
            other_links: beyond(&robot.body, link, &self.passed),
            skins: Vec::new(),
            body_from_link: poses.between(robot.base, link),
            body_from_contact,
            velocity: nowhere,
            velocity_covariance: Matrix3::repeat(f64::NAN),
            born: self.born,
            seen: self.seen,
            cause: Cause::Environment,
            slip: (Slip::Unknown, f64::NAN),
        })
    }
}

/// Links that `link` carries, but for those beyond the coordinates in `passed`.
fn beyond(body: &Body, link: usize, passed: &[usize]) -> Vec<usize> {
    let (mut found, mut next) = (Vec::new(), vec![link]);
    while let Some(at) = next.pop() {
        for joint in body.joints().iter().filter(|j| j.parent == at) {
            if !joint.moved_by.is_some_and(|by| passed.contains(&by.coordinate)) {
                found.push(joint.child);
                next.push(joint.child);
            }
        }
    }
    found.sort_unstable();
    found
}

/// Force \[N\] on a link and its covariance, in the frame of the link, by weighted least squares of its wrench; `None` where the joints do
/// not determine it.
fn force_on(link: usize, poses: &Poses<'_>, torques: &Torques) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let pose = poses.root_from(link);
    let jacobian = poses.jacobian(link, &Point3::from(pose.translation.vector));
    let (mut information, mut sum) = (Matrix6::zeros(), Vector6::zeros());
    for (i, column) in jacobian.column_iter().enumerate() {
        let (torque, variance) = (torques.values[i], torques.variances[i]);
        if variance.is_finite() && torque.is_finite() && variance > 0.0 {
            let mut row: Vector6<f64> = column.into_owned();
            row.fixed_rows_mut::<3>(3).scale_mut(1.0 / LENGTH);
            information += row * row.transpose() / variance;
            sum += row * (torque / variance);
        }
    }
    let values = SymmetricEigen::new(information).eigenvalues;
    let determined = values.min() > DETERMINED * values.max();
    let covariance = information.try_inverse().filter(|_| determined)?;
    let wrench = covariance * sum;
    let turn = pose.rotation.inverse().to_rotation_matrix();
    let spread = turn * covariance.fixed_view::<3, 3>(0, 0).into_owned() * turn.transpose();
    Some((turn * wrench.fixed_rows::<3>(0).into_owned(), spread))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body() -> Body {
        let urdf = "<robot name='r'><link name='base'/><link name='a'/><link name='shell'/><link name='b'/><link name='c'/><link name='side'/>\
            <joint name='j1' type='revolute'><parent link='base'/><child link='a'/></joint>\
            <joint name='f' type='fixed'><parent link='a'/><child link='shell'/></joint>\
            <joint name='j2' type='revolute'><parent link='a'/><child link='b'/></joint>\
            <joint name='j3' type='revolute'><parent link='b'/><child link='c'/></joint>\
            <joint name='k' type='revolute'><parent link='base'/><child link='side'/></joint></robot>";
        Body::from_urdf(urdf, "r").unwrap()
    }

    fn torques(values: [f64; 4]) -> Torques {
        Torques { values: values.to_vec(), variances: vec![1.0; 4] }
    }

    /// Feeds torques for 20 ms each; outermost joints and possible further links of what is published at the end.
    fn run(steps: &[([f64; 4], [f64; 4])]) -> Vec<(u32, usize, Vec<usize>)> {
        let (body, mut unknowns, mut last) = (body(), Unknowns::default(), 0);
        let s = TorqueSettings::default();
        for (k, (values, positions)) in steps.iter().enumerate() {
            let identity = || {
                last += 1;
                last
            };
            unknowns.take(&body, k as i64 * 20_000_000, &torques(*values), positions, &s, identity);
        }
        let shown = unknowns.active.iter().filter(|a| a.id != 0);
        shown
            .map(|a| {
                let link = body.coordinates().nth(a.tip).unwrap().child;
                (a.id, link, beyond(&body, link, &a.passed))
            })
            .collect()
    }

    #[test]
    fn the_outermost_joint_says_the_innermost_link() {
        let still = [0.0; 4];
        assert_eq!(run(&[([9.0, 6.0, 0.5, 0.1], still); 8]), [(1, 3, vec![4])], "on b, or on c beyond");
        assert_eq!(run(&[([9.0, 6.0, 0.5, 0.1], still); 3]), [], "not for long enough");
        assert_eq!(
            run(&[([9.0, 0.0, 0.0, -7.0], still); 8]),
            [(1, 1, vec![2, 3, 4]), (2, 5, vec![])],
            "two chains"
        );
        let mut gone = vec![([9.0, 6.0, 0.5, 0.1], still); 8];
        gone.extend(vec![([3.5, 3.5, 0.0, 0.0], still); 20]);
        assert_eq!(run(&gone).len(), 1, "above three quarters of the alarm it stays");
        gone.extend(vec![([1.0, 1.0, 0.0, 0.0], still); 8]);
        assert_eq!(run(&gone), []);
    }

    #[test]
    fn a_joint_that_turns_and_feels_nothing_rules_out_what_it_carries() {
        let still = [0.0; 4];
        let mut steps = vec![([9.0, 0.0, 0.0, 0.0], still); 8];
        steps.push(([9.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.3, 0.0]));
        assert_eq!(run(&steps), [(1, 1, vec![2, 3])], "c is out");
        steps.push(([9.0, f64::NAN, 0.0, 0.0], [0.0, 0.3, 0.3, 0.0]));
        assert_eq!(run(&steps), [(1, 1, vec![2, 3])], "a joint without torque rules out nothing");
        steps.push(([9.0, 0.0, 0.0, 0.0], [0.0, 0.3, 0.3, 0.0]));
        assert_eq!(run(&steps), [(1, 1, vec![2])]);
        // Where a further joint feels it after all, the contact is beyond that.
        steps.push(([9.0, 9.0, 0.0, 0.0], [0.0, 0.3, 0.3, 0.0]));
        assert_eq!(run(&steps)[0].1, 3);
    }
}
