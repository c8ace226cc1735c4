//! The file of a label map: what it says, and what it may not say.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::LearnError;

const SCHEMA: &str = "dermis-labels/1";

/// Where something is mounted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mount {
    /// \[m\] x, y, z.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

impl Default for Mount {
    fn default() -> Self {
        Self { position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] }
    }
}

/// The skin that is pressed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SkinSide {
    /// Topic of its frames; needed where several skins of one description are in a bag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taxels: Option<String>,
    /// Pose of the skin's link in the robot's base.
    pub pose: Mount,
}

/// The robot that moves the indenter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSide {
    /// Topic of its pose.
    pub topic: String,
    /// `child_frame_id` of the tool; needed where the topic carries several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<String>,
    /// `frame_id` of the base; checked where it is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<String>,
    /// \[m\] centre of the tip's sphere in the frame of the tool.
    #[serde(default)]
    pub tip: [f64; 3],
    /// \[m\] radius of the tip.
    #[serde(default)]
    pub tip_radius: f64,
    /// \[s\] added to its stamps.
    #[serde(default)]
    pub time_offset: f64,
}

/// What the axes of the force sensor keep their direction to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Carrier {
    /// The sensor moves with the tool.
    Tool,
    /// The sensor stands still, e.g. below the skin.
    Base,
}

/// Whose force a wrench is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Exerted {
    /// What pushes on the tip, as a sensor between robot and tip reports it.
    Tip,
    /// What the tip exerts on the skin.
    Skin,
}

/// The force sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSide {
    /// Topic of its wrench.
    pub topic: String,
    /// What it is mounted to.
    pub mounted: Carrier,
    /// Orientation of its axes in the frame of what it is mounted to: unit quaternion x, y, z, w.
    #[serde(default = "upright")]
    pub orientation: [f64; 4],
    /// On what the reported force is exerted.
    pub exerted_on: Exerted,
    /// \[s\] added to its stamps.
    #[serde(default)]
    pub time_offset: f64,
    /// Whether its readings while the tip is away are subtracted: a force cell has an offset that drifts.
    #[serde(default = "yes")]
    pub remove_bias: bool,
}

fn upright() -> [f64; 4] {
    Mount::default().orientation
}

fn yes() -> bool {
    true
}

/// When the skin counts as touched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactRule {
    /// \[N\] pressing force from which on it is touched.
    pub on: f64,
    /// \[N\] pressing force below which it is untouched again.
    pub off: f64,
    /// \[m\] between tip and surface from which on nothing can touch: there the force sensor's bias and the skin's
    /// zero are taken.
    pub clearance: f64,
}

impl Default for ContactRule {
    fn default() -> Self {
        Self { on: 0.05, off: 0.03, clearance: 0.002 }
    }
}

/// How readings of different clocks and rates meet, and what counts as one place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Join {
    /// \[s\] between two readings that are still interpolated.
    pub max_gap: f64,
    /// \[m\] within which presses are at the same location; data are split by it.
    pub location_size: f64,
}

impl Default for Join {
    fn default() -> Self {
        Self { max_gap: 0.1, location_size: 0.001 }
    }
}

/// How a rig's topics become ground truth. A file is TOML; unknown keys are errors.
///
/// ```
/// let map = dermis_learn::LabelMap::from_toml(
///     r#"
///     schema = "dermis-labels/1"
///     [robot]
///     topic = "/tool_pose"
///     tip = [0.0, 0.0, 0.05]
///     tip_radius = 0.002
///     [force]
///     topic = "/wrench"
///     mounted = "tool"
///     exerted_on = "tip"
///     "#,
///     "labels.toml",
/// )?;
/// assert_eq!(map.contact.on, 0.05);
/// # Ok::<(), dermis_learn::LearnError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelMap {
    schema: String,
    /// The skin that is pressed.
    #[serde(default)]
    pub skin: SkinSide,
    /// The robot that moves the indenter.
    pub robot: RobotSide,
    /// The force sensor.
    pub force: ForceSide,
    /// When the skin counts as touched.
    #[serde(default)]
    pub contact: ContactRule,
    /// How readings meet.
    #[serde(default)]
    pub join: Join,
}

impl LabelMap {
    /// Reads a map.
    ///
    /// # Errors
    ///
    /// [`LearnError`] names the file and the field, or line and column.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LearnError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT).map_err(LearnError::io(path, "read"))?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Reads a map; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_toml(text: &str, file: &str) -> Result<Self, LearnError> {
        let map: Self = LearnError::of_toml(text, file)?;
        let wrong = |field: &str, reason: String| {
            Err(LearnError::Config { file: file.to_owned(), field: field.to_owned(), reason })
        };
        if map.schema != SCHEMA {
            return wrong("schema", format!("is \"{}\" where this program reads \"{SCHEMA}\"", map.schema));
        }
        for (field, topic) in [("robot.topic", &map.robot.topic), ("force.topic", &map.force.topic)] {
            if topic.is_empty() {
                return wrong(field, "is empty: name the topic as it is in the bag".into());
            }
        }
        let numbers = [
            ("skin.pose.position", &map.skin.pose.position[..]),
            ("robot.tip", &map.robot.tip[..]),
            ("robot.time_offset", std::slice::from_ref(&map.robot.time_offset)),
            ("force.time_offset", std::slice::from_ref(&map.force.time_offset)),
        ];
        for (field, values) in numbers {
            if !values.iter().all(|v| v.abs() < 1e4) {
                return wrong(
                    field,
                    format!("is {values:?}: metres and seconds of a rig are finite and small"),
                );
            }
        }
        for (field, q) in [
            ("skin.pose.orientation", map.skin.pose.orientation),
            ("force.orientation", map.force.orientation),
        ] {
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            // Four digits are what people type.
            if !(0.999..1.001).contains(&norm) {
                return wrong(
                    field,
                    format!("is {q:?} of length {norm:.4} and must be a unit quaternion x, y, z, w"),
                );
            }
        }
        if !(0.0..1.0).contains(&map.robot.tip_radius) {
            return wrong(
                "robot.tip_radius",
                format!("is {} m and must be 0 or positive", map.robot.tip_radius),
            );
        }
        let c = map.contact;
        for (field, value, [low, high], unit) in [
            ("contact.on", c.on, [1e-9, 1e6], "N"),
            ("contact.off", c.off, [1e-9, 1e6], "N"),
            ("contact.clearance", c.clearance, [1e-9, 1e3], "m"),
            ("join.max_gap", map.join.max_gap, [1e-6, 1e4], "s"),
            ("join.location_size", map.join.location_size, [1e-9, 1e3], "m"),
        ] {
            // What is not positive at all has a sentence of its own.
            if value > 0.0 && value.is_finite() && !(low..=high).contains(&value) {
                return wrong(field, format!("is {value:e} {unit} and must be {low} to {high} {unit}"));
            }
        }
        if !(c.off > 0.0 && c.off <= c.on && c.on.is_finite()) {
            return wrong("contact.off", format!("is {} N with contact.on {} N: 0 < off ≤ on", c.off, c.on));
        }
        for (field, v) in [
            ("contact.clearance", c.clearance),
            ("join.max_gap", map.join.max_gap),
            ("join.location_size", map.join.location_size),
        ] {
            if !(v > 0.0 && v.is_finite()) {
                return wrong(field, format!("is {v} and must be positive"));
            }
        }
        Ok(map)
    }
}
