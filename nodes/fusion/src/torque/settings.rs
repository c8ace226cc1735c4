//! What is assumed of joint torques.

use std::collections::BTreeMap;

use dermis_body::{Friction, Joint, Robot};
use serde::{Deserialize, Serialize};

use crate::settings::SettingError;

/// What is assumed of joint torques.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TorqueSettings {
    /// \[m/s²\] in the body frame. A robot whose base is tilted has another.
    pub gravity: [f64; 3],
    /// \[1/s\] of the observer: a push is there after some 2/gain.
    pub gain: f64,
    /// \[1\] standard deviation of what torques differ by from the robot's model where nothing touches it, as a share of the joint's limit
    /// in the URDF: torque sensors are good to 1 or 2 %, torques from motor currents to 5 to 10 %.
    pub deviation_share: f64,
    /// \[N m\], \[N\] at prismatic joints: the same of single joints, as measured on the robot.
    pub deviations: BTreeMap<String, f64>,
    /// Friction of single joints, as measured on the robot; that of `<dynamics>` in the URDF where absent.
    pub friction: BTreeMap<String, JointFriction>,
    /// \[rad/s\], \[m/s\] at prismatic joints: speed at which three quarters of the Coulomb friction act. Below it, its direction is not known.
    pub standstill: f64,
    /// Joints whose torques count; all where empty. Legs that stand on soles without skins do not.
    pub joints: Vec<String>,
    /// \[1\] standard deviation of the shear force on skins that measure none, as a share of the normal force: their friction.
    pub unmeasured_shear: f64,
    /// \[1\] standard deviations that an unexplained torque has to exceed to be a contact.
    pub alarm: f64,
    /// \[s\] for which it has to: longer than skins take to report a contact.
    pub confirm: f64,
}

/// Friction of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointFriction {
    /// \[N m\] or \[N\] against the direction of motion, whatever the speed.
    pub coulomb: f64,
    /// \[N m s/rad\] or \[N s/m\] in proportion to the speed.
    pub viscous: f64,
    /// \[N m\] or \[N\] that the effort is too large by, at rest as in motion.
    pub offset: f64,
}

impl JointFriction {
    /// \[N m\] or \[N\] that it takes of the effort at this velocity (Coulomb and viscous friction with the jump at rest smoothed; Armstrong-Hélouvry,
    /// Dupont and Canudas de Wit, *A survey of models, analysis tools and compensation methods for the control of machines with friction*,
    /// Automatica 30(7), 1994).
    pub(super) fn effort(&self, rate: f64, standstill: f64) -> f64 {
        self.coulomb * (rate / standstill).tanh() + self.viscous * rate + self.offset
    }

    /// Variance of that: at rest Coulomb friction may hold either way.
    pub(super) fn variance(&self, rate: f64, standstill: f64) -> f64 {
        self.coulomb.powi(2) * (1.0 - (rate / standstill).tanh().powi(2))
    }
}

impl Default for TorqueSettings {
    fn default() -> Self {
        Self {
            gravity: [0.0, 0.0, -9.806_65],
            gain: 25.0,
            deviation_share: 0.02,
            deviations: BTreeMap::new(),
            friction: BTreeMap::new(),
            standstill: 0.01,
            joints: Vec::new(),
            unmeasured_shear: 0.5,
            alarm: 4.0,
            confirm: 0.1,
        }
    }
}

/// Why settings of joint torques cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TorqueError {
    /// A number that cannot be.
    #[error("torques: {0}")]
    Number(#[from] SettingError),
    /// A joint that the robot does not have, or that does not move by itself.
    #[error(
        "torques: `{field}`: \"{joint}\" is no joint of the robot that moves by itself; correct the name"
    )]
    Joint {
        /// Name of the field.
        field: &'static str,
        /// Joint that was named.
        joint: String,
    },
}

impl TorqueSettings {
    pub(super) fn check(&self, robot: &Robot) -> Result<(), TorqueError> {
        let number =
            |name: &'static str, value: f64, least: f64, most: f64| match (least..=most).contains(&value) {
                true => Ok(()),
                false => Err(SettingError { name, value, least, most }),
            };
        self.gravity.iter().try_for_each(|g| number("gravity", *g, -100.0, 100.0))?;
        number("gain", self.gain, 0.1, 1e4)?;
        number("deviation_share", self.deviation_share, 0.0, 10.0)?;
        self.deviations.values().try_for_each(|d| number("deviations", *d, 0.0, 1e6))?;
        for friction in self.friction.values() {
            number("friction.coulomb", friction.coulomb, 0.0, 1e6)?;
            number("friction.viscous", friction.viscous, 0.0, 1e6)?;
            number("friction.offset", friction.offset, -1e6, 1e6)?;
        }
        number("standstill", self.standstill, 1e-6, 10.0)?;
        number("unmeasured_shear", self.unmeasured_shear, 0.0, 10.0)?;
        number("alarm", self.alarm, 0.1, 1e6)?;
        number("confirm", self.confirm, 0.0, 60.0)?;
        let named = self.deviations.keys().map(|j| ("deviations", j));
        let named = named.chain(self.friction.keys().map(|j| ("friction", j)));
        for (field, joint) in named.chain(self.joints.iter().map(|j| ("joints", j))) {
            if !robot.body.coordinates().any(|c| c.name == *joint) {
                return Err(TorqueError::Joint { field, joint: joint.clone() });
            }
        }
        Ok(())
    }

    /// Whether a joint's torque counts.
    pub(super) fn counts(&self, joint: &Joint) -> bool {
        self.joints.is_empty() || self.joints.contains(&joint.name)
    }

    /// Friction of a joint: as measured, else as the URDF says.
    pub(super) fn friction(&self, joint: &Joint) -> JointFriction {
        let Friction { coulomb, viscous } = joint.friction;
        let stated = JointFriction { coulomb, viscous, offset: 0.0 };
        self.friction.get(&joint.name).copied().unwrap_or(stated)
    }

    /// Standard deviation \[N m\] or \[N\] of what a joint's torque differs by; `None` where neither file tells.
    pub(super) fn deviation(&self, joint: &Joint) -> Option<f64> {
        let of_limit = || joint.limits.map(|l| l.effort).filter(|effort| *effort > 0.0);
        self.deviations.get(&joint.name).copied().or_else(|| of_limit().map(|e| e * self.deviation_share))
    }
}
