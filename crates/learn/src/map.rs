//! Ground truth of a rig that knows nothing of skins: a robot's pose and a force sensor's wrench, mapped by a file.
//!
//! The robot tells where its tool is in its base (`geometry_msgs/msg/TransformStamped`, or `tf2_msgs/msg/TFMessage`),
//! the force sensor what it feels (`geometry_msgs/msg/WrenchStamped`). A [`LabelMap`] says how tool, tip, skin and
//! sensor are mounted, and makes of both what [`Truth`](crate::Truth) is: a contact at the first point of the undeformed surface,
//! and a force on the skin, in the frame of the skin's link. `launch/labels/` has an example to copy.

mod file;
mod label;

use std::sync::Arc;

use dermis_bag::{BagMessage, BagReader, Filter};
use dermis_msgs::Message;
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{
    Transform, TransformStamped, Vector3 as VectorMsg, Wrench, WrenchStamped,
};
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_skin::convert::vector;
use dermis_skin::{Stamp, Surface};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::LearnError;
use crate::dataset::{FromBag, Gathered, Track, check_late};
use crate::findings::Findings;

pub use file::{Carrier, ContactRule, Exerted, ForceSide, Join, LabelMap, Mount, RobotSide, SkinSide};
pub use label::Bias;
pub(crate) use label::Labeller;

impl Mount {
    fn isometry(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(self.position), rotation(self.orientation))
    }
}

fn rotation([x, y, z, w]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

impl LabelMap {
    /// What a rig that is mounted as this map says would report of a tip whose sphere is `gap` \[m\] away from the
    /// surface above `place` (frame of the skin's link), while `force` \[N\] acts on the skin. The sensor's own
    /// offset is added in its axes.
    #[must_use]
    pub fn report(
        &self,
        surface: &Surface,
        (place, gap): (&Point3<f64>, f64),
        force: &Vector3<f64>,
        offset: &Vector3<f64>,
        stamp: Stamp,
    ) -> (TransformStamped, WrenchStamped) {
        let (on_surface, normal) = surface.project(place);
        let centre = on_surface + normal * (gap + self.robot.tip_radius);
        let skin = self.skin.pose.isometry();
        // The tool looks along the normal into the skin.
        let down = UnitQuaternion::rotation_between(&Vector3::z(), &-normal)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let turn = skin.rotation * down;
        let tool = skin * centre - turn * Vector3::from(self.robot.tip);
        let moved = |seconds: f64| Time::from_nanos(stamp - (seconds * 1e9) as i64);
        let q = turn.quaternion();
        let name =
            |given: &Option<String>, otherwise: &str| given.clone().unwrap_or_else(|| otherwise.to_owned());
        let base = name(&self.robot.base, "base");
        let pose = TransformStamped {
            header: Header { stamp: moved(self.robot.time_offset), frame_id: base.clone() },
            child_frame_id: name(&self.robot.tool, "tool"),
            transform: Transform {
                translation: vector(&tool.coords),
                rotation: dermis_msgs::geometry_msgs::msg::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w },
            },
        };
        let axes = self.sensor_axes(&turn);
        let measured = axes.inverse() * (skin.rotation * force) * self.sign() + offset;
        let frame_id = match self.force.mounted {
            Carrier::Tool => pose.child_frame_id.clone(),
            Carrier::Base => base,
        };
        let wrench = WrenchStamped {
            header: Header { stamp: moved(self.force.time_offset), frame_id },
            wrench: Wrench { force: vector(&measured), torque: VectorMsg::default() },
        };
        (pose, wrench)
    }

    /// Orientation of the sensor's axes in the base.
    fn sensor_axes(&self, tool: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self.force.mounted {
            Carrier::Tool => tool * rotation(self.force.orientation),
            Carrier::Base => rotation(self.force.orientation),
        }
    }

    /// \[ns\] between two readings that are still interpolated.
    fn max_gap(&self) -> i64 {
        (self.join.max_gap * 1e9) as i64
    }

    fn sign(&self) -> f64 {
        match self.force.exerted_on {
            Exerted::Tip => -1.0,
            Exerted::Skin => 1.0,
        }
    }
}

/// Something that is sampled over time.
trait Sampled: Copy {
    fn between(&self, other: &Self, weight: f64) -> Self;
}

impl Sampled for Vector3<f64> {
    fn between(&self, other: &Self, weight: f64) -> Self {
        self.lerp(other, weight)
    }
}

impl Sampled for Isometry3<f64> {
    fn between(&self, other: &Self, weight: f64) -> Self {
        // Opposite orientations have no way between them.
        self.try_lerp_slerp(other, weight, 1e-9).unwrap_or(*self)
    }
}

/// A rig's readings in order of their stamps, one for each.
pub(crate) struct Tracks {
    poses: Track<Isometry3<f64>>,
    forces: Track<Vector3<f64>>,
}

/// Value at `stamp` between the two readings around it, where these are no more than `max_gap` \[ns\] apart.
fn at<T: Sampled>(samples: &[(Stamp, T)], stamp: Stamp, max_gap: i64) -> Option<T> {
    let after = samples.partition_point(|(t, _)| *t < stamp);
    let (t1, b) = samples.get(after)?;
    if *t1 == stamp {
        return Some(*b);
    }
    let (t0, a) = after.checked_sub(1).and_then(|i| samples.get(i))?;
    let apart = t1.saturating_sub(*t0);
    (apart <= max_gap).then(|| a.between(b, (stamp - t0) as f64 / apart as f64))
}

/// What a bag says on a rig's topics.
#[derive(Debug, Default)]
pub(crate) struct Readings {
    poses: Gathered<Isometry3<f64>>,
    forces: Gathered<Vector3<f64>>,
    unstamped: [u64; 2],
    broken: [u64; 2],
    tools: std::collections::BTreeSet<String>,
    bases: std::collections::BTreeSet<String>,
}

impl Readings {
    /// Holds no reading, but finds out how they lie.
    pub(crate) fn streamed() -> Self {
        Self { poses: Gathered::streamed(), forces: Gathered::streamed(), ..Self::default() }
    }

    /// Takes a message of one of the map's topics.
    pub(crate) fn take(&mut self, map: &LabelMap, message: &BagMessage) -> Result<(), LearnError> {
        let topic = &*message.topic;
        if topic == map.robot.topic {
            if &*message.type_name == TFMessage::TYPE_NAME {
                message.decode::<TFMessage>()?.transforms.iter().for_each(|t| self.pose(map, t));
            } else {
                self.pose(map, &message.decode::<TransformStamped>()?);
            }
        } else if topic == map.force.topic {
            let wrench: WrenchStamped = message.decode()?;
            let f = &wrench.wrench.force;
            let force = Vector3::new(f.x, f.y, f.z);
            let stamp = wrench.header.stamp.as_nanos();
            if stamp == 0 {
                self.unstamped[1] += 1;
            } else if force.iter().all(|v| v.is_finite()) {
                self.forces.push(stamp + (map.force.time_offset * 1e9) as i64, force);
            } else {
                self.broken[1] += 1;
            }
        }
        Ok(())
    }

    fn pose(&mut self, map: &LabelMap, message: &TransformStamped) {
        if map.robot.tool.as_ref().is_some_and(|tool| *tool != message.child_frame_id) {
            self.tools.insert(message.child_frame_id.clone());
            return;
        }
        let stamp = message.header.stamp.as_nanos();
        if stamp == 0 {
            self.unstamped[0] += 1;
            return;
        }
        let (t, q) = (&message.transform.translation, &message.transform.rotation);
        let quaternion = Quaternion::new(q.w, q.x, q.y, q.z);
        let place = Vector3::new(t.x, t.y, t.z);
        if !((quaternion.norm() - 1.0).abs() < 1e-2 && place.iter().all(|v| v.is_finite())) {
            self.broken[0] += 1;
            return;
        }
        self.tools.insert(message.child_frame_id.clone());
        self.bases.insert(message.header.frame_id.clone());
        let pose = Isometry3::from_parts(place.into(), UnitQuaternion::from_quaternion(quaternion));
        self.poses.push(stamp + (map.robot.time_offset * 1e9) as i64, pose);
    }

    /// First and last stamp of what tells a force.
    pub(crate) fn span(&self) -> Option<(Stamp, Stamp)> {
        self.forces.span()
    }

    /// Brings both into order, and says what is wrong with them. Where they are not held, they are read anew from `bag`.
    pub(crate) fn tracks(
        self,
        map: &LabelMap,
        bag: &BagReader,
        place: &str,
        findings: &mut Findings,
    ) -> Tracks {
        self.check(map, place, findings);
        let poses = Self::from_bag(map, bag, &map.robot.topic, |readings| readings.poses.take());
        let forces = Self::from_bag(map, bag, &map.force.topic, |readings| readings.forces.take());
        Tracks { poses: self.poses.into_track(true, poses), forces: self.forces.into_track(true, forces) }
    }

    /// How one side is read anew.
    fn from_bag<T: 'static>(
        map: &LabelMap,
        bag: &BagReader,
        topic: &str,
        side: fn(&mut Self) -> Vec<(Stamp, T)>,
    ) -> FromBag<T> {
        let map = map.clone();
        FromBag {
            bag: bag.clone(),
            filter: Filter::default().topics([topic]),
            take: Arc::new(move |message, order| {
                let mut readings = Self::default();
                readings.take(&map, message)?;
                side(&mut readings).into_iter().for_each(|(stamp, reading)| order.push(stamp, reading));
                Ok(())
            }),
        }
    }

    /// Says what is wrong with both.
    fn check(&self, map: &LabelMap, place: &str, findings: &mut Findings) {
        let sides =
            [("robot", &map.robot.topic, self.poses.len()), ("force", &map.force.topic, self.forces.len())];
        for (i, (side, topic, left)) in sides.into_iter().enumerate() {
            if self.unstamped[i] > 0 {
                findings.fatal(
                    place,
                    format!("{} messages on {topic} have no stamp (header.stamp is 0)", self.unstamped[i]),
                    "nothing can be joined by acquisition time; let the driver stamp its messages",
                );
            }
            if self.broken[i] > 0 {
                findings.notice(
                    place,
                    format!("{} messages on {topic} hold numbers that are no {side}", self.broken[i]),
                    "they are left out",
                );
            }
            check_late(
                [self.poses.late(), self.forces.late()][i],
                &format!("messages on {topic}"),
                place,
                findings,
            );
            if left == 0 && self.unstamped[i] == 0 {
                let tools = quoted(&self.tools);
                let what = match (&map.robot.tool, i, self.tools.is_empty()) {
                    (Some(tool), 0, false) => {
                        format!("{topic} never tells of the tool `{tool}` (map: robot.tool), but of {tools}")
                    }
                    _ => format!("holds nothing usable on {topic} (map: {side}.topic)"),
                };
                findings.fatal(place, what, "without it there is no ground truth");
            }
        }
        if map.robot.tool.is_none() && self.tools.len() > 1 {
            findings.fatal(
                place,
                format!("{} carries several frames: {}", map.robot.topic, quoted(&self.tools)),
                "which of them is the tool must be said (map: robot.tool)",
            );
        }
        let base = map.robot.base.as_ref();
        if self.bases.len() > 1 || self.bases.iter().any(|found| base.is_some_and(|b| b != found)) {
            findings.fatal(
                place,
                format!(
                    "poses on {} are in the frame {} where one base is needed{}",
                    map.robot.topic,
                    quoted(&self.bases),
                    base.map_or_else(String::new, |b| format!(" (map: robot.base is `{b}`)"))
                ),
                "positions would be meaningless",
            );
        }
    }
}

fn quoted(names: &std::collections::BTreeSet<String>) -> String {
    names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")
}

/// Locations that were pressed, over all bags of a data set: where the same place was pressed again is the same location,
/// whichever cell of a grid its scatter falls into.
#[derive(Debug, Default)]
pub(crate) struct Locations(Vec<(Point3<f64>, u32)>);

impl Locations {
    fn identify(&mut self, point: &Point3<f64>, size: f64) -> u32 {
        let near = self.0.iter().find(|(p, _)| (p - point).norm() <= size / 2.0);
        if let Some((_, id)) = near {
            return *id;
        }
        // The identity depends on the place only, so that other bags of the same locations are split alike.
        let mut id = 0x811c_9dc5_u32;
        for v in point.iter() {
            for byte in ((v / size).round() as i64).to_le_bytes() {
                id = (id ^ u32::from(byte)).wrapping_mul(0x0100_0193);
            }
        }
        self.0.push((*point, id));
        id
    }
}

#[cfg(test)]
mod tests;
