//! All skins of a robot, and what its whole body feels.
//!
//! [`Fuser`] takes messages as they come and answers with a [`BodyState`] on request. It opens nothing and reads no clock: whoever
//! calls it says what time it is.

use dermis_body::{HistoryLimits, JointHistory, JointKind, JointsAt, Refused, Robot, SkinOnBody, Wrench};
use dermis_msgs::msg::ContactArray;
use dermis_skin::{Contact, Stamp};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::cause::{Cause, CauseError, Causes, Expected, SelfContact};
use crate::group::{Group, Identities, Report, Taken};
use crate::intake::{Health, Intake, Verdict};
use crate::settings::{SettingError, Settings};
use crate::torque::{JointValues, Observer, TorqueError, TorqueSettings, Torques, explained};
use crate::touch::{BodyTouch, LinkLoad, load, place};
use crate::track::{Detection, seconds};
use crate::unknown::Unknowns;

/// \[s\] by which the newest reading may be behind and still be the instant that an answer is for.
const LONGEST_LAG: f64 = 0.1;

/// Why a robot's skins cannot be merged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FuserError {
    /// An assumption that cannot be.
    #[error("settings: {0}")]
    Setting(#[from] SettingError),
    /// An expected contact that cannot be.
    #[error(transparent)]
    Cause(#[from] CauseError),
    /// Something of joint torques that cannot be.
    #[error(transparent)]
    Torque(#[from] TorqueError),
}

/// A skin as the fuser knows it.
#[derive(Debug)]
pub(crate) struct SkinState {
    intake: Intake,
    group: usize,
    pub top_from_skin: Isometry3<f64>,
    touched: bool,
}

/// A skin and what it can feel.
#[derive(Debug, Clone, PartialEq)]
pub struct SkinAt {
    /// Index in the robot file.
    pub skin: usize,
    /// What it can feel now.
    pub health: Health,
}

/// What the whole body feels at an instant.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyState {
    /// The instant that all of it is for.
    pub stamp: Stamp,
    /// The worst of the skins; DEGRADED at least where joint positions are missing.
    pub status: u8,
    /// One sentence for each thing that is wrong, empty where nothing is.
    pub text: String,
    /// Every skin that the robot should have.
    pub skins: Vec<SkinAt>,
    /// All contacts.
    pub contacts: Vec<BodyTouch>,
    /// One a link with skins.
    pub links: Vec<LinkLoad>,
    /// Sum of all forces, about the origin of the body frame, in that frame.
    pub net: Wrench,
    /// \[N m\], or \[N\] at prismatic joints, that the contacts put on each joint of the body's coordinates; empty where no joint states
    /// have come.
    pub torques: Vec<f64>,
    /// What the joints feel beyond what all contacts of skins put on them; `None` where they tell nothing.
    pub unexplained: Option<Torques>,
    /// Joint positions at the stamp.
    pub joints: JointsAt,
}

/// How badly a skin is off: `ContactArray::STATUS_*` in the order of what can be trusted.
fn badness(status: u8) -> u8 {
    match status {
        ContactArray::STATUS_OK => 0,
        ContactArray::STATUS_DEGRADED => 1,
        ContactArray::STATUS_UNCALIBRATED => 2,
        ContactArray::STATUS_STALE => 3,
        _ => 4,
    }
}

pub(crate) fn worse(a: u8, b: u8) -> u8 {
    if badness(b) > badness(a) { b } else { a }
}

/// Of a skin that nothing was heard of yet.
fn intake(skin: &SkinOnBody) -> Intake {
    Intake::new(skin, contacts_topic(skin))
}

/// Where the contacts of a skin come from.
pub(crate) fn contacts_topic(skin: &SkinOnBody) -> String {
    format!("{}/contacts", skin.namespace)
}

/// The skins of a robot, merged.
#[derive(Debug)]
pub struct Fuser {
    robot: Robot,
    settings: Settings,
    causes: Causes,
    skins: Vec<SkinState>,
    groups: Vec<Group>,
    identities: Identities,
    joints: JointHistory,
    /// Whether any joint state has come.
    joints_came: bool,
    /// Position of each joint that no state tells, where one is assumed.
    rest: Option<Vec<f64>>,
    /// Links with skins.
    links: Vec<usize>,
    newest: Option<Stamp>,
    /// Stamp of the last answer.
    answered: Option<Stamp>,
    observer: Observer,
    unknowns: Unknowns,
    /// Whether unexplained torques are contacts.
    reports_unknown: bool,
}

impl Fuser {
    /// For the skins of a robot, with what it is expected to touch.
    ///
    /// # Errors
    ///
    /// [`FuserError`] names the setting, or the field of the expectation.
    pub fn new(
        robot: Robot,
        settings: Settings,
        limits: HistoryLimits,
        expected: &[Expected],
        own: &[SelfContact],
    ) -> Result<Self, FuserError> {
        settings.check()?;
        let causes = Causes::new(&robot, expected, own)?;
        let (mut tops, mut skins, mut links): (Vec<usize>, Vec<SkinState>, Vec<usize>) = Default::default();
        for skin in &robot.skins {
            let (top, top_from_link) = robot.body.rigid_top(skin.link);
            let group = tops.iter().position(|t| *t == top).unwrap_or_else(|| {
                tops.push(top);
                tops.len() - 1
            });
            if !links.contains(&skin.link) {
                links.push(skin.link);
            }
            skins.push(SkinState {
                intake: intake(skin),
                group,
                top_from_skin: top_from_link * skin.pose,
                touched: false,
            });
        }
        let joints = JointHistory::new(&robot.body, limits);
        let groups = tops.iter().map(|_| Group::default()).collect();
        Ok(Self {
            observer: Observer::new(&robot, TorqueSettings::default())?,
            unknowns: Unknowns::default(),
            reports_unknown: false,
            robot,
            settings,
            causes,
            skins,
            groups,
            identities: Identities::default(),
            joints,
            joints_came: false,
            rest: None,
            links,
            newest: None,
            answered: None,
        })
    }

    /// Takes what joints feel beyond what skins explain for contacts, with these assumptions.
    ///
    /// # Errors
    ///
    /// [`TorqueError`] names the field.
    pub fn report_unknown(&mut self, settings: &TorqueSettings) -> Result<(), FuserError> {
        self.observer = Observer::new(&self.robot, settings.clone())?;
        self.reports_unknown = true;
        Ok(())
    }

    /// Why some joint's torque tells nothing, in one sentence; `None` where each does.
    #[must_use]
    pub fn torque_sentence(&self) -> Option<String> {
        self.observer.sentence(&self.robot)
    }

    /// The robot and its skins.
    #[must_use]
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// What it assumes of skins and contacts.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Assumes something else from now on.
    ///
    /// # Errors
    ///
    /// [`SettingError`] where a number cannot be; nothing changes then.
    pub fn set_settings(&mut self, settings: Settings) -> Result<(), SettingError> {
        settings.check()?;
        self.settings = settings;
        Ok(())
    }

    /// Takes a message of the skin of this index that came at `now`; `publisher` where the wire tells. Whether it counts.
    pub fn take(
        &mut self,
        skin: usize,
        report: &ContactArray,
        publisher: Option<[u8; 16]>,
        now: Stamp,
    ) -> bool {
        let s = self.settings;
        let Some(state) = self.skins.get_mut(skin) else { return false };
        let before = state.intake.came();
        let verdict = state.intake.take(report, publisher, now, &s);
        if state.intake.take_restart() {
            self.identities.forget(skin);
        }
        match verdict {
            Verdict::Use => {}
            // What is refused changes nothing until somebody asks: there may be a flood of it.
            Verdict::Refused => return false,
            Verdict::Blind => {
                state.touched = false;
                self.groups[state.group].lose(skin);
                return false;
            }
        }
        let stamp = report.header.stamp.as_nanos();
        let top_from_skin = state.top_from_skin;
        let detections = report
            .contacts
            .iter()
            .map(|c| Detection::of(&Contact::from(c), skin, &top_from_skin, &s))
            .collect();
        let group = state.group;
        let taken = self.groups[group].take(Report { skin, stamp, detections }, &s);
        if taken == Taken::Late {
            self.skins[skin].intake.was_late(before, now, &s);
            return false;
        }
        self.skins[skin].touched = true;
        self.newest = Some(self.newest.map_or(stamp, |newest| newest.max(stamp)));
        true
    }

    /// Takes the positions of some joints at an instant.
    ///
    /// # Errors
    ///
    /// [`Refused`] where nothing of the state is taken.
    pub fn take_joints(&mut self, stamp: Stamp, names: &[String], positions: &[f64]) -> Result<(), Refused> {
        self.joints.push(stamp, names, positions)?;
        self.joints_came = true;
        Ok(())
    }

    /// The same with velocities and efforts.
    ///
    /// # Errors
    ///
    /// As [`take_joints`](Self::take_joints).
    pub fn take_joint_values(&mut self, stamp: Stamp, values: &JointValues<'_>) -> Result<(), Refused> {
        self.take_joints(stamp, values.names, values.positions)?;
        self.observer.take(&self.robot, stamp, values, self.rest.as_deref());
        Ok(())
    }

    /// Takes joints that no state has reported for resting at 0, or at the limit next to it.
    pub fn assume_rest(&mut self) {
        let rest = |joint: &dermis_body::Joint| {
            joint
                .limits
                .filter(|l| l.lower <= l.upper && joint.kind != JointKind::Continuous)
                .map_or(0.0, |l| 0.0_f64.clamp(l.lower, l.upper))
        };
        self.rest = Some(self.robot.body.coordinates().map(rest).collect());
        self.joints_came = true;
    }

    /// Joint positions at an instant.
    #[must_use]
    pub fn joints_at(&self, stamp: Stamp) -> JointsAt {
        let mut joints = self.joints.at(stamp);
        if let Some(rest) = &self.rest {
            joints.missing.retain(|m| m.behind.is_some());
            let names = self.robot.body.coordinates().map(|joint| &joint.name);
            for ((position, rest), name) in joints.positions.iter_mut().zip(rest).zip(names) {
                if position.is_nan() && !joints.missing.iter().any(|m| m.joint == *name) {
                    *position = *rest;
                }
            }
        }
        joints
    }

    /// Forgets every contact and joint state: the clock jumped back.
    pub fn reset(&mut self, limits: HistoryLimits) {
        for (state, skin) in self.skins.iter_mut().zip(&self.robot.skins) {
            state.intake = intake(skin);
            state.touched = false;
        }
        self.groups.iter_mut().for_each(|group| *group = Group::default());
        for skin in 0..self.skins.len() {
            self.identities.forget(skin);
        }
        self.joints = JointHistory::new(&self.robot.body, limits);
        (self.newest, self.answered) = (None, None);
        self.observer.reset();
        self.unknowns.clear();
    }

    /// What each skin can feel at `now`. Contacts of those that feel nothing any more end.
    fn watch(&mut self, now: Stamp) -> Vec<SkinAt> {
        let mut all = Vec::with_capacity(self.skins.len());
        for (skin, state) in self.skins.iter_mut().enumerate() {
            let health = state.intake.health(now, &self.settings);
            if state.touched && !health.feels() {
                state.touched = false;
                self.groups[state.group].lose(skin);
            }
            all.push(SkinAt { skin, health });
        }
        all
    }

    /// The instant that an answer at `now` is for: that of the newest reading, or `now` where there is none for long. It never goes back.
    fn instant(&self, now: Stamp) -> Stamp {
        let stamp = self.newest.filter(|newest| seconds(*newest, now) <= LONGEST_LAG).unwrap_or(now);
        self.answered.map_or(stamp, |last| last.max(stamp))
    }

    /// What the body feels at `now`.
    pub fn state(&mut self, now: Stamp) -> BodyState {
        let skins = self.watch(now);
        let stamp = self.instant(now);
        self.answered = Some(stamp);
        let joints = self.joints_at(stamp);
        let poses = self.robot.body.poses(&joints.positions);
        let mut contacts = Vec::new();
        for group in &mut self.groups {
            for track in group.tracks(stamp, &mut self.identities, &self.settings) {
                contacts.extend(place(&track, &self.robot, &self.skins, &poses, &self.causes));
            }
        }
        self.mark_own(&mut contacts);
        let loads: Vec<LinkLoad> =
            self.links.iter().map(|link| load(*link, &self.robot, &skins, &contacts, &poses)).collect();
        let mut net = Wrench::zero();
        let mut torques = vec![0.0; if self.joints_came { joints.positions.len() } else { 0 }];
        for load in &loads {
            net += load.body_wrench;
            if self.joints_came {
                let in_root = load.wrench.seen_from(poses.root_from(load.link));
                // A link that nothing touches needs no joint positions.
                if in_root.force.iter().any(|v| *v != 0.0) {
                    let of_link = poses.torques(load.link, &in_root);
                    torques.iter_mut().zip(of_link).for_each(|(sum, t)| *sum += t);
                }
            }
        }
        let (status, text) = self.verdict(&skins, &joints);
        if self.observer.hears() {
            let load = explained(&self.robot, &poses, &contacts, self.observer.settings().unmeasured_shear);
            self.observer.advance(&self.robot, stamp, load);
        }
        let unexplained = self.observer.unexplained(&self.robot, self.settings.reorder);
        contacts.extend(self.unknown(unexplained.as_ref()));
        BodyState { stamp, status, text, skins, contacts, links: loads, net, torques, unexplained, joints }
    }

    /// Contacts that only joints feel.
    fn unknown(&mut self, torques: Option<&Torques>) -> Vec<BodyTouch> {
        let (Some(torques), Some((at, positions))) = (torques, self.observer.positions()) else {
            self.unknowns.clear();
            return Vec::new();
        };
        if !self.reports_unknown {
            return Vec::new();
        }
        let identity = || self.identities.fresh();
        self.unknowns.take(&self.robot.body, at, torques, positions, self.observer.settings(), identity);
        self.unknowns.touches(&self.robot, &self.robot.body.poses(positions), torques)
    }

    /// The worst of all skins, and a sentence for each thing that is wrong.
    fn verdict(&self, skins: &[SkinAt], joints: &JointsAt) -> (u8, String) {
        let status = skins.iter().fold(ContactArray::STATUS_OK, |worst, s| worse(worst, s.health.status));
        let mut sentences: Vec<String> =
            skins.iter().map(|s| s.health.text.clone()).filter(|text| !text.is_empty()).collect();
        // Joints that no skin hangs on do not matter.
        match joints.sentence() {
            Some(missing) if self.needs_joints() => {
                sentences.push(missing);
                (worse(status, ContactArray::STATUS_DEGRADED), sentences.join("; "))
            }
            _ => (status, sentences.join("; ")),
        }
    }

    /// Whether a joint that moves is between the base and a skin.
    fn needs_joints(&self) -> bool {
        let (base, _) = self.robot.body.rigid_top(self.robot.base);
        self.links.iter().any(|link| self.robot.body.rigid_top(*link).0 != base)
    }

    /// Notes which contacts are the robot's own.
    fn mark_own(&self, contacts: &mut [BodyTouch]) {
        let placed: Vec<(usize, Point3<f64>, Vector3<f64>)> = contacts
            .iter()
            .map(|c| {
                let pose = &c.body_from_contact;
                (c.link, Point3::from(pose.translation.vector), pose.rotation * Vector3::z())
            })
            .collect();
        for (contact, own) in contacts.iter_mut().zip(self.causes.own(&placed)) {
            if own && contact.cause == Cause::Environment {
                contact.cause = Cause::OwnBody;
            }
        }
    }
}

#[cfg(test)]
mod tests;
