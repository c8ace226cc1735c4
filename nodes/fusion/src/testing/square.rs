//! A square skin of 40 mm and its force maps.

use dermis_msgs::geometry_msgs::msg::{Point, Vector3 as VectorMsg};
use dermis_msgs::msg::{ForceMap, SkinGeometry};
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::std_msgs::msg::Header;
use dermis_skin::Stamp;

use super::BEGIN;

/// 8 × 8 points, in the frame of its skin.
pub(crate) fn geometry(frame: &str) -> SkinGeometry {
    let at = |i: usize| ((i as f64) - 3.5) * 0.005;
    SkinGeometry {
        header: Header::new(BEGIN, frame),
        geometry_id: "square".into(),
        points: (0..64).map(|k| Point { x: at(k % 8), y: at(k / 8), z: 0.0 }).collect(),
        normals: vec![VectorMsg { x: 0.0, y: 0.0, z: 1.0 }; 64],
        areas: vec![25e-6; 64],
        ..SkinGeometry::default()
    }
}

/// A normal force \[N\] for each point.
pub(crate) fn map(frame: &str, stamp: Stamp, forces: Vec<f32>) -> ForceMap {
    ForceMap {
        header: Header::new(stamp, frame),
        geometry_id: "square".into(),
        kind: ForceMap::KIND_NORMAL,
        forces,
        ..ForceMap::default()
    }
}

/// Every point of a cloud of force maps as its fields.
pub(crate) fn points(cloud: &PointCloud2) -> Vec<[f32; 13]> {
    assert_eq!(cloud.data.len(), (cloud.width * cloud.point_step) as usize);
    let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let of = |point: &[u8]| std::array::from_fn(|k| number(&point[4 * k..]));
    cloud.data.chunks_exact(cloud.point_step as usize).map(of).collect()
}
