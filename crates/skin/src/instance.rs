//! A skin type and its devices.
//!
//! A skin file describes a *type*: geometry, channels, medium, wire. A robot carries *instances* of it: devices, each with a name,
//! a coordinate frame and a place of its own. Whatever has to tell devices apart (messages, keys of the bridge, diagnostics, TF,
//! recordings) goes by the name of the instance; whatever fits all devices of a type (model bundles) goes by
//! [`SkinDescription::hash`], which knows no name.
//!
//! [`SkinDescription::into_instance`] puts the names of an instance in place of those of the file, so that everything that is
//! made from the description afterwards speaks of that device.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::SkinDescription;

/// \[m\] farthest that a skin can be from the link that it is fixed to.
const FARTHEST: f64 = 10.0;
/// Largest difference from 1 of a quaternion's length that rounding explains.
const ROUNDING: f64 = 1e-3;
/// Longest name.
const LONGEST: usize = 128;

/// Why an instance cannot be as it is configured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// The name cannot be a part of a key.
    #[error("`instance`: \"{0}\" is no name of a skin: take up to {LONGEST} letters, digits, `_` and `-`")]
    Name(String),
    /// The name of the coordinate frame cannot be one.
    #[error(
        "`frame_id`: \"{0}\" is no coordinate frame: take the name of a link, without a leading slash and without spaces"
    )]
    Frame(String),
    /// The mount cannot be.
    #[error("`mount`: {0}")]
    Mount(#[from] MountError),
    /// A frame cannot be fixed to itself.
    #[error("`mount.parent` is \"{0}\", the skin's own `frame_id`: name the link that the skin is fixed to")]
    Loop(String),
}

/// Why a mount cannot be as it is configured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MountError {
    /// The parent's name cannot be one.
    #[error("`parent` is \"{0}\": give the name of a link, without a leading slash and without spaces")]
    Parent(String),
    /// Not a position on a robot.
    #[error("`translation` is {0:?} and must be three finite numbers in metres, at most {FARTHEST} m each")]
    Translation([f64; 3]),
    /// Not a rotation.
    #[error("`rotation` is {0:?} and must be a quaternion [x, y, z, w] of length 1")]
    Rotation([f64; 4]),
    /// Not angles in radians.
    #[error("`rpy` is {0:?} and must be roll, pitch and yaw in radians, from -2π to 2π")]
    Rpy([f64; 3]),
    /// The rotation is there twice.
    #[error("has both `rotation` and `rpy`: leave one of them")]
    Twice,
    /// A text that is no mount.
    #[error(
        "\"{0}\" is none: write parent,x,y,z or parent,x,y,z,roll,pitch,yaw or parent,x,y,z,qx,qy,qz,qw, in metres and radians"
    )]
    Text(String),
}

/// Where a skin is fixed on a robot: the pose of its coordinate frame in that of a link.
///
/// In a file: `mount = { parent = "left_wrist", translation = [0.0, 0.01, 0.05], rpy = [0.0, 1.5708, 0.0] }`, in metres and
/// radians, with axes as REP-103 says. `rotation = [x, y, z, w]` is a unit quaternion and may stand in place of `rpy`, which
/// turns about the fixed axes x, y, z of the parent, in this order, as in URDF.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "MountFile", into = "MountFile")]
pub struct Mount {
    parent: String,
    pose: Isometry3<f64>,
}

/// A mount as a file says it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MountFile {
    parent: String,
    #[serde(default)]
    translation: [f64; 3],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rotation: Option<[f64; 4]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rpy: Option<[f64; 3]>,
}

impl TryFrom<MountFile> for Mount {
    type Error = MountError;

    fn try_from(file: MountFile) -> Result<Self, MountError> {
        match (file.rotation, file.rpy) {
            (Some(_), Some(_)) => Err(MountError::Twice),
            (Some(rotation), None) => Self::new(file.parent, file.translation, rotation),
            (None, rpy) => Self::from_rpy(file.parent, file.translation, rpy.unwrap_or_default()),
        }
    }
}

impl From<Mount> for MountFile {
    fn from(mount: Mount) -> Self {
        let (translation, rotation) = (mount.translation(), Some(mount.rotation()));
        Self { parent: mount.parent, translation, rotation, rpy: None }
    }
}

impl Mount {
    /// A skin whose frame lies at `translation` \[m\] in the frame `parent`, turned by the unit quaternion `rotation`
    /// (x, y, z, w).
    ///
    /// # Errors
    ///
    /// [`MountError`] names the value that cannot be.
    pub fn new(
        parent: impl Into<String>,
        translation: [f64; 3],
        rotation: [f64; 4],
    ) -> Result<Self, MountError> {
        let [x, y, z, w] = rotation;
        let quaternion = Quaternion::new(w, x, y, z);
        let off = (quaternion.norm() - 1.0).abs();
        if !off.is_finite() || off > ROUNDING {
            return Err(MountError::Rotation(rotation));
        }
        // What rounds to itself stays as it was written.
        let rotation = if off <= f64::EPSILON {
            UnitQuaternion::new_unchecked(quaternion)
        } else {
            UnitQuaternion::new_normalize(quaternion)
        };
        Self::checked(parent.into(), translation, rotation)
    }

    /// As [`new`](Self::new), turned by roll, pitch and yaw \[rad\] about the fixed axes x, y, z of the parent, in this order.
    ///
    /// # Errors
    ///
    /// [`MountError`] names the value that cannot be.
    pub fn from_rpy(
        parent: impl Into<String>,
        translation: [f64; 3],
        rpy: [f64; 3],
    ) -> Result<Self, MountError> {
        // Larger ones are degrees.
        if !rpy.iter().all(|angle| angle.abs() <= std::f64::consts::TAU) {
            return Err(MountError::Rpy(rpy));
        }
        Self::checked(parent.into(), translation, UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]))
    }

    fn checked(
        parent: String,
        translation: [f64; 3],
        rotation: UnitQuaternion<f64>,
    ) -> Result<Self, MountError> {
        if !is_frame(&parent) {
            return Err(MountError::Parent(parent));
        }
        // Larger ones are millimetres.
        if !translation.iter().all(|length| length.abs() <= FARTHEST) {
            return Err(MountError::Translation(translation));
        }
        Ok(Self { parent, pose: Isometry3::from_parts(Translation3::from(translation), rotation) })
    }

    /// Frame of the link that the skin is fixed to: `frame_id` of the static transform whose `child_frame_id` is the skin's.
    #[must_use]
    pub fn parent(&self) -> &str {
        &self.parent
    }

    /// `parent_from_skin`: a point of the skin in the frame of the parent.
    #[must_use]
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.pose
    }

    /// \[m\] origin of the skin's frame in the frame of the parent.
    #[must_use]
    pub fn translation(&self) -> [f64; 3] {
        self.pose.translation.vector.into()
    }

    /// Unit quaternion x, y, z, w that turns the skin's axes into the parent's frame.
    #[must_use]
    pub fn rotation(&self) -> [f64; 4] {
        self.pose.rotation.coords.into()
    }
}

/// From a command line: `left_wrist,0,0.01,0.05` and, after it, roll, pitch, yaw or a quaternion.
impl std::str::FromStr for Mount {
    type Err = MountError;

    fn from_str(text: &str) -> Result<Self, MountError> {
        let wrong = || MountError::Text(text.to_owned());
        let mut parts = text.split(',').map(str::trim);
        let parent = parts.next().unwrap_or_default().to_owned();
        let numbers: Vec<f64> = parts.map(str::parse).collect::<Result<_, _>>().map_err(|_| wrong())?;
        match *numbers {
            [x, y, z] => Self::from_rpy(parent, [x, y, z], [0.0; 3]),
            [x, y, z, roll, pitch, yaw] => Self::from_rpy(parent, [x, y, z], [roll, pitch, yaw]),
            [x, y, z, qx, qy, qz, qw] => Self::new(parent, [x, y, z], [qx, qy, qz, qw]),
            _ => Err(wrong()),
        }
    }
}

impl std::fmt::Display for Mount {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ([x, y, z], [qx, qy, qz, qw]) = (self.translation(), self.rotation());
        write!(f, "{},{x},{y},{z},{qx},{qy},{qz},{qw}", self.parent)
    }
}

/// Whether a text can be the name of a coordinate frame.
#[must_use]
pub fn is_frame(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= LONGEST
        && !name.starts_with('/')
        && !name.chars().any(|c| c.is_whitespace() || c.is_control())
}

/// Whether a text can be the name of an instance.
#[must_use]
pub fn is_name(name: &str) -> bool {
    (1..=LONGEST).contains(&name.len())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

impl SkinDescription {
    /// The same skin as a device of this name and coordinate frame; those of the file where `None`.
    ///
    /// # Errors
    ///
    /// [`InstanceError`] names the value that cannot be.
    pub fn into_instance(
        mut self,
        name: Option<&str>,
        frame_id: Option<&str>,
        mount: Option<&Mount>,
    ) -> Result<Self, InstanceError> {
        if let Some(name) = name {
            if !is_name(name) {
                return Err(InstanceError::Name(name.to_owned()));
            }
            let type_name = std::mem::replace(&mut self.name, name.to_owned());
            self.type_name.get_or_insert(type_name);
        }
        if let Some(frame_id) = frame_id {
            if !is_frame(frame_id) {
                return Err(InstanceError::Frame(frame_id.to_owned()));
            }
            frame_id.clone_into(&mut self.frame_id);
        }
        if let Some(mount) = mount.filter(|mount| mount.parent == self.frame_id) {
            return Err(InstanceError::Loop(mount.parent.clone()));
        }
        Ok(self)
    }

    /// Name of the type: that of the skin file, whatever the instance is called.
    #[must_use]
    pub fn type_name(&self) -> &str {
        self.type_name.as_deref().unwrap_or(&self.name)
    }

    /// Whether a hash that was written for a skin called `name` is that of this type: its [`hash`](Self::hash), or one of
    /// earlier versions, which covered every digit of the taxels, and the name.
    #[must_use]
    pub fn is_type(&self, hash: &str, name: &str) -> bool {
        let is = |other: &String| hash.eq_ignore_ascii_case(other);
        is(&self.hash()) || self.earlier_hashes(name).iter().any(is)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SKIN: &str = include_str!("../../../launch/skins/baro-grid.toml");

    fn skin(text: &str) -> SkinDescription {
        SkinDescription::from_toml(text, "grid.toml").unwrap()
    }

    fn mount(text: &str) -> Result<Mount, String> {
        toml::from_str(text).map_err(|e: toml::de::Error| e.message().to_owned())
    }

    #[test]
    fn a_mount_is_a_quaternion_or_angles() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let by_angles =
            mount(&format!("parent = 'wrist'\ntranslation = [0.1, 0, -0.2]\nrpy = [0, 0, {quarter}]"));
        let by_angles = by_angles.unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let by_quaternion = Mount::new("wrist", [0.1, 0.0, -0.2], [0.0, 0.0, half, half]).unwrap();
        let point = nalgebra::Point3::new(1.0, 0.0, 0.0);
        for mount in [&by_angles, &by_quaternion] {
            // Yaw by 90° takes x to y.
            let there = mount.pose() * point;
            assert!((there - nalgebra::Point3::new(0.1, 1.0, -0.2)).norm() < 1e-12, "{there}");
        }
        let roll_then_yaw = Mount::from_rpy("w", [0.0; 3], [quarter, 0.0, quarter]).unwrap();
        let up = roll_then_yaw.pose() * nalgebra::Vector3::y();
        assert!((up - nalgebra::Vector3::z()).norm() < 1e-12, "about the fixed axes, x first: {up}");
        assert_eq!(mount("parent = 'w'").unwrap().rotation(), [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn mounts_that_cannot_be_are_named() {
        insta::assert_snapshot!(mount("parent = '/w'").unwrap_err(), @r#"`parent` is "/w": give the name of a link, without a leading slash and without spaces"#);
        insta::assert_snapshot!(mount("parent = 'w'\ntranslation = [0, 35, 0]").unwrap_err(), @"`translation` is [0.0, 35.0, 0.0] and must be three finite numbers in metres, at most 10 m each");
        insta::assert_snapshot!(mount("parent = 'w'\nrotation = [0, 0, 0, 0]").unwrap_err(), @"`rotation` is [0.0, 0.0, 0.0, 0.0] and must be a quaternion [x, y, z, w] of length 1");
        insta::assert_snapshot!(mount("parent = 'w'\nrpy = [0, 90, 0]").unwrap_err(), @"`rpy` is [0.0, 90.0, 0.0] and must be roll, pitch and yaw in radians, from -2π to 2π");
        insta::assert_snapshot!(mount("parent = 'w'\nrpy = [0, nan, 0]").unwrap_err(), @"`rpy` is [0.0, NaN, 0.0] and must be roll, pitch and yaw in radians, from -2π to 2π");
        insta::assert_snapshot!(mount("parent = 'w'\nrpy = [0, 0, 0]\nrotation = [0, 0, 0, 1]").unwrap_err(), @"has both `rotation` and `rpy`: leave one of them");
        insta::assert_snapshot!("w,1,2".parse::<Mount>().unwrap_err(), @r#""w,1,2" is none: write parent,x,y,z or parent,x,y,z,roll,pitch,yaw or parent,x,y,z,qx,qy,qz,qw, in metres and radians"#);
        assert!("w,inf,0,0".parse::<Mount>().is_err() && "w,0,0,0,nan,0,0,1".parse::<Mount>().is_err());
    }

    #[test]
    fn an_instance_has_its_own_names_and_the_hash_of_its_type() {
        let file = skin(SKIN);
        let mount = Mount::from_rpy("wrist", [0.0; 3], [0.0; 3]).unwrap();
        let left =
            file.clone().into_instance(Some("left_palm"), Some("left_palm_link"), Some(&mount)).unwrap();
        assert_eq!((left.name.as_str(), left.type_name()), ("left_palm", "baro-grid"));
        assert_eq!(left.header(0).frame_id, "left_palm_link");
        assert_eq!(left.hash(), file.hash());
        assert_eq!(file.clone().into_instance(None, None, None).unwrap(), file);
        let renamed = skin(&SKIN.replace("name = \"baro-grid\"", "name = \"right-palm\""));
        assert_eq!(renamed.hash(), file.hash());
        // What was stamped with the name in it.
        let [_, old] = file.earlier_hashes("baro-grid");
        assert!(
            old != file.hash() && renamed.is_type(&old, "baro-grid") && !renamed.is_type(&old, "right-palm")
        );
        assert!(renamed.is_type(&file.hash(), "whatever"));
        insta::assert_snapshot!(file.clone().into_instance(Some("a/b"), None, None).unwrap_err(), @r#"`instance`: "a/b" is no name of a skin: take up to 128 letters, digits, `_` and `-`"#);
        insta::assert_snapshot!(file.clone().into_instance(None, Some("a b"), None).unwrap_err(), @r#"`frame_id`: "a b" is no coordinate frame: take the name of a link, without a leading slash and without spaces"#);
        insta::assert_snapshot!(file.into_instance(None, Some("wrist"), Some(&mount)).unwrap_err(), @r#"`mount.parent` is "wrist", the skin's own `frame_id`: name the link that the skin is fixed to"#);
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(
            parent in "[a-z_][a-z0-9_/]{0,12}",
            translation in proptest::array::uniform3(-10.0..10.0f64),
            rpy in proptest::array::uniform3(-6.2..6.2f64),
        ) {
            let written = Mount::from_rpy(parent, translation, rpy).unwrap();
            let close = |read: &Mount| {
                read.parent() == written.parent()
                    && (read.pose().to_homogeneous() - written.pose().to_homogeneous()).norm() < 1e-12
            };
            let read: Mount = toml::from_str(&toml::to_string(&written).unwrap()).unwrap();
            prop_assert!(close(&read));
            let json: Mount = serde_json::from_str(&serde_json::to_string(&written).unwrap()).unwrap();
            prop_assert!(close(&json));
            prop_assert!(close(&written.to_string().parse().unwrap()));
        }

        #[test]
        fn no_text_panics(text in ".{0,60}", numbers in proptest::collection::vec(proptest::num::f64::ANY, 0..9)) {
            let _ = text.parse::<Mount>();
            let _ = numbers.iter().fold("w".to_owned(), |all, n| format!("{all},{n}")).parse::<Mount>();
        }
    }
}
