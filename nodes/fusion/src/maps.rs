//! The force maps of all skins as one cloud of points on the body.
//!
//! Problem: each skin says how much force acts on each point of its own surface; where two skins lie over each other, both say it of the
//! same force. Method: every point is placed by its skin's geometry and the pose of its link. The force of a point that further skins cover
//! is shared: each of the k skins that cover the place and have a map counts with 1/k (a partition of unity), so that the sum over
//! the cloud is the force on the body. Maps have no covariance that better weights could be made of. A skin covers a point where one of its own
//! points is next to it: along the surface by no more than the distance of its points, across it by no more than [`LAYER`].
//!
//! Assumptions: skins that cover each other are rigidly connected, as with contacts. At the rim of an overlap, weights jump.
//!
//! Cost: which points are covered is found when a geometry comes, by cells, linear in points; a cloud costs one transform a point.

use std::collections::HashMap;

use dermis_body::{Poses, Robot, SkinOnBody};
use dermis_msgs::msg::{ForceMap, SkinGeometry};
use dermis_msgs::sensor_msgs::msg::{PointCloud2, PointField};
use dermis_msgs::std_msgs::msg::Header;
use dermis_skin::Stamp;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::track::seconds;

/// \[m\] between two skins that lie over each other, at most.
const LAYER: f64 = 0.015;
/// Cosine between the normals of two locations that are one, at least.
const SAME_SIDE: f64 = 0.5;
/// Points of a skin that are read.
const MOST_POINTS: usize = 200_000;
/// Fields of a point, all 32-bit floats: place \[m\] and normal in the body frame, force \[N\] on it, the surface around it \[m²\],
/// `intensity`, which is the pressure along the inward normal \[Pa\], the index of its skin in `BodyContacts.skins`, and its age \[s\].
pub const FIELDS: [&str; 13] =
    ["x", "y", "z", "nx", "ny", "nz", "fx", "fy", "fz", "area", "intensity", "skin", "age"];

/// The surface of a skin, in the frame of the topmost link that it is rigidly connected with.
#[derive(Debug)]
struct Surface {
    id: String,
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    areas: Vec<f32>,
    /// \[m\] between its points.
    pitch: f64,
    /// Further skins that cover each point.
    covered: Vec<Vec<u16>>,
}

#[derive(Debug)]
struct Latest {
    stamp: Stamp,
    map: ForceMap,
}

#[derive(Debug)]
struct SkinMap {
    top: usize,
    top_from_skin: Isometry3<f64>,
    surface: Option<Surface>,
    latest: Option<Latest>,
}

/// The maps of all skins of a robot.
#[derive(Debug)]
pub(crate) struct Maps {
    skins: Vec<SkinMap>,
}

impl Maps {
    pub(crate) fn new(robot: &Robot) -> Self {
        let skins = robot.skins.iter().map(|skin| {
            let (top, top_from_link) = robot.body.rigid_top(skin.link);
            SkinMap { top, top_from_skin: top_from_link * skin.pose, surface: None, latest: None }
        });
        Self { skins: skins.collect() }
    }

    /// Forgets every map, and keeps surfaces.
    pub(crate) fn clear(&mut self) {
        self.skins.iter_mut().for_each(|skin| skin.latest = None);
    }

    /// Takes the surface of a skin.
    ///
    /// # Errors
    ///
    /// One sentence where it cannot be; the one before stays.
    pub(crate) fn take_geometry(
        &mut self,
        robot: &Robot,
        skin: usize,
        message: &SkinGeometry,
    ) -> Result<(), String> {
        let on_body = &robot.skins[skin];
        let wrong = |what: String| Err(format!("skin `{}`: its geometry {what}", on_body.name));
        if let Some(what) = elsewhere(on_body, &message.header) {
            return wrong(what);
        }
        let n = message.points.len();
        if n > MOST_POINTS || message.normals.len() != n || message.areas.len() != n {
            return wrong(format!(
                "has {n} points, {} normals and {} areas; each point has one, and there are {MOST_POINTS} at most",
                message.normals.len(),
                message.areas.len()
            ));
        }
        let pose = self.skins[skin].top_from_skin;
        let points: Vec<Point3<f64>> =
            message.points.iter().map(|p| pose * Point3::new(p.x, p.y, p.z)).collect();
        let normals = message.normals.iter().map(|v| pose.rotation * Vector3::new(v.x, v.y, v.z)).collect();
        let known = |v: &f32| v.is_finite() && *v > 0.0;
        let total: f64 = message.areas.iter().copied().filter(known).map(f64::from).sum();
        if points.iter().any(|p| !p.iter().all(|v| v.is_finite())) || total <= 0.0 {
            return wrong("has points without a place, or no area; correct the skin file".into());
        }
        // Squares of that size: their corners are no further than 0.71 of a side from a point.
        let pitch = (total / n as f64).sqrt();
        self.skins[skin].surface = Some(Surface {
            id: message.geometry_id.clone(),
            points,
            normals,
            areas: message.areas.clone(),
            pitch,
            covered: vec![Vec::new(); n],
        });
        for other in 0..self.skins.len() {
            if other != skin && self.skins[other].top == self.skins[skin].top {
                self.cover(skin, other);
                self.cover(other, skin);
            }
        }
        Ok(())
    }

    /// Notes which points of a skin another one covers.
    fn cover(&mut self, skin: usize, other: usize) {
        let Ok([skin, cover]) = self.skins.get_disjoint_mut([skin, other]) else { return };
        let (Some(surface), Some(by)) = (&mut skin.surface, &cover.surface) else { return };
        let cell = LAYER.max(by.pitch);
        let of = |p: &Point3<f64>| [p.x, p.y, p.z].map(|v| (v / cell).floor() as i64);
        let mut cells: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
        for (i, point) in by.points.iter().enumerate() {
            cells.entry(of(point)).or_default().push(i);
        }
        let index = other as u16;
        for (i, point) in surface.points.iter().enumerate() {
            let normal = surface.normals[i];
            let near = |j: &usize| {
                let (away, facing) = (point - by.points[*j], by.normals[*j]);
                let across = away.dot(&facing);
                let along = (away - facing * across).norm();
                across.abs() <= LAYER && along <= 0.75 * by.pitch && facing.dot(&normal) >= SAME_SIDE
            };
            let [x, y, z] = of(point);
            let around = (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
            let covered = around.filter_map(|c| cells.get(&c)).flatten().any(near);
            surface.covered[i].retain(|s| *s != index);
            if covered {
                surface.covered[i].push(index);
            }
        }
    }

    /// Takes a map.
    ///
    /// # Errors
    ///
    /// One sentence where it cannot be; the one before stays.
    pub(crate) fn take(&mut self, robot: &Robot, skin: usize, message: ForceMap) -> Result<(), String> {
        let on_body = &robot.skins[skin];
        let wrong = |what: String| Err(format!("skin `{}`: its force map {what}", on_body.name));
        if let Some(what) = elsewhere(on_body, &message.header) {
            return wrong(what);
        }
        let state = &mut self.skins[skin];
        let Some(surface) = state.surface.as_ref().filter(|s| s.id == message.geometry_id) else {
            return wrong("is of a geometry that has not come on `skin_geometry`".into());
        };
        let all = surface.points.len();
        let points = if message.indices.is_empty() { all } else { message.indices.len() };
        let each = if message.kind == ForceMap::KIND_VECTOR { 3 } else { 1 };
        if message.kind > ForceMap::KIND_VECTOR || message.forces.len() != points * each {
            return wrong(format!("has {} numbers for {points} points of {each}", message.forces.len()));
        }
        if message.indices.iter().any(|i| *i as usize >= all) {
            return wrong(format!("names a point beyond the {all} of its geometry"));
        }
        let stamp = message.header.stamp.as_nanos();
        // A node that started again may be a little behind; what is a second older begins anew.
        if state.latest.as_ref().is_none_or(|l| stamp >= l.stamp || seconds(stamp, l.stamp) > 1.0) {
            state.latest = Some(Latest { stamp, map: message });
        }
        Ok(())
    }

    /// All points of the maps that are no older than their skins' timeouts at `stamp`, where `feels` says that the skin can be trusted.
    /// Skins whose link has no known place are left out.
    pub(crate) fn cloud(
        &self,
        robot: &Robot,
        poses: &Poses<'_>,
        stamp: Stamp,
        feels: &[bool],
    ) -> PointCloud2 {
        let fresh = |i: usize| {
            let latest = self.skins[i].latest.as_ref();
            feels[i] && latest.is_some_and(|l| seconds(l.stamp, stamp) <= robot.skins[i].timeout)
        };
        let live: Vec<bool> = (0..self.skins.len()).map(fresh).collect();
        let mut data: Vec<u8> = Vec::new();
        let (mut width, mut dense) = (0_u32, true);
        for (i, skin) in
            self.skins.iter().enumerate().filter(|(i, _)| live[*i] && poses.knows(robot.skins[*i].link))
        {
            let (Some(surface), Some(latest)) = (&skin.surface, &skin.latest) else { continue };
            let pose = poses.between(robot.base, skin.top);
            let age = seconds(latest.stamp, stamp).max(0.0) as f32;
            for (point, force) in forces(surface, &latest.map, &skin.top_from_skin) {
                let sharing = surface.covered[point].iter().filter(|s| live[usize::from(**s)]).count();
                let force = force / (1 + sharing) as f64;
                let (at, normal) = (pose * surface.points[point], pose.rotation * surface.normals[point]);
                let pressure = -force.dot(&surface.normals[point]) / f64::from(surface.areas[point]);
                let force = pose.rotation * force;
                let numbers = at.iter().chain(normal.iter()).chain(force.iter()).map(|v| *v as f32);
                for number in numbers.chain([surface.areas[point], pressure as f32, i as f32, age]) {
                    dense &= number.is_finite();
                    data.extend_from_slice(&number.to_le_bytes());
                }
                width += 1;
            }
        }
        let fields = FIELDS.iter().zip(0_u32..).map(|(name, k)| PointField {
            name: (*name).to_owned(),
            offset: 4 * k,
            datatype: PointField::FLOAT32,
            count: 1,
        });
        let step = 4 * FIELDS.len() as u32;
        PointCloud2 {
            header: Header::new(stamp, robot.body.links()[robot.base].as_str()),
            height: 1,
            width,
            fields: fields.collect(),
            is_bigendian: false,
            point_step: step,
            row_step: step * width,
            data,
            is_dense: dense,
        }
    }
}

/// What is wrong with a message in another frame than its skin's.
fn elsewhere(skin: &SkinOnBody, header: &Header) -> Option<String> {
    let (found, frame) = (&header.frame_id, &skin.frame_id);
    (found != frame).then(|| format!("is in frame \"{found}\" where the robot file says \"{frame}\""))
}

/// Points of a map and the force \[N\] on each, in the frame of the surface.
fn forces<'a>(
    surface: &'a Surface,
    map: &'a ForceMap,
    top_from_skin: &Isometry3<f64>,
) -> impl Iterator<Item = (usize, Vector3<f64>)> + 'a {
    let turn = top_from_skin.rotation;
    let vectors = map.kind == ForceMap::KIND_VECTOR;
    let count = if map.indices.is_empty() { surface.points.len() } else { map.indices.len() };
    (0..count).map(move |k| {
        let point = map.indices.get(k).map_or(k, |i| *i as usize);
        let value = |j: usize| f64::from(map.forces[j]);
        let force = if vectors {
            turn * Vector3::new(value(3 * k), value(3 * k + 1), value(3 * k + 2))
        } else {
            -surface.normals[point] * value(k)
        };
        (point, force)
    })
}

#[cfg(test)]
mod tests;
