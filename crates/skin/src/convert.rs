//! From the vocabulary to messages and back.

use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{Point, Pose, Quaternion, Vector3 as VectorMsg};
use dermis_msgs::msg::{self, ContactArray, SkinGeometry, TaxelFrame};
use dermis_msgs::std_msgs::msg::Header;
use nalgebra::{Point3, Vector3};

use crate::{
    ChannelFlags, Contact, DisplacementMap, Estimate, ForceComponents, ForceMap, ForceValues, Frame,
    SensorKind, SkinDescription, Stamp, Surface,
};

fn point(p: &Point3<f64>) -> Point {
    Point { x: p.x, y: p.y, z: p.z }
}

fn vector(v: &Vector3<f64>) -> VectorMsg {
    VectorMsg { x: v.x, y: v.y, z: v.z }
}

impl SkinDescription {
    /// Header of a message about this skin.
    #[must_use]
    pub fn header(&self, stamp: Stamp) -> Header {
        Header { stamp: Time::from_nanos(stamp), frame_id: self.frame_id.clone() }
    }

    /// Identity that a [`ForceMap`] or [`DisplacementMap`] message refers to: changes with the points of the surface.
    #[must_use]
    pub fn geometry_id(&self) -> String {
        format!("{}/{}", self.name, &self.hash()[7..19])
    }

    /// Surface, taxels and channels as the latched message.
    #[must_use]
    pub fn geometry_message(&self, surface: &Surface, stamp: Stamp) -> SkinGeometry {
        SkinGeometry {
            header: self.header(stamp),
            skin: self.name.clone(),
            geometry_id: self.geometry_id(),
            skin_hash: self.hash(),
            points: surface.points.iter().map(point).collect(),
            normals: surface.normals.iter().map(vector).collect(),
            areas: surface.areas.iter().map(|a| *a as f32).collect(),
            triangles: surface.triangles.iter().flatten().copied().collect(),
            taxels: self.taxels.iter().map(|t| t.name.clone()).collect(),
            taxel_poses: self
                .taxels
                .iter()
                .map(|t| {
                    let q = t.orientation();
                    Pose {
                        position: point(&t.point()),
                        orientation: Quaternion { x: q.i, y: q.j, z: q.k, w: q.w },
                    }
                })
                .collect(),
            channels: self.channels().iter().map(|c| c.name.clone()).collect(),
            channel_taxels: self.channel_taxels().iter().map(|i| *i as u32).collect(),
        }
    }

    /// A frame as a message.
    #[must_use]
    pub fn frame_message(&self, frame: &Frame) -> TaxelFrame {
        TaxelFrame {
            header: self.header(frame.stamp),
            skin: self.name.clone(),
            sequence: frame.sequence,
            device_time_us: frame.device_time_us,
            channels: self.channels().iter().map(|c| c.name.clone()).collect(),
            unit: self.unit.clone(),
            values: frame.values.clone(),
            flags: frame.flags.iter().map(|f| f.bits()).collect(),
            electrodes: 0,
            temperature: frame.temperature,
        }
    }
}

impl From<&TaxelFrame> for Frame {
    fn from(m: &TaxelFrame) -> Self {
        // A recording of another program may carry no flags: its channels count as healthy.
        let mut flags: Vec<ChannelFlags> = m.flags.iter().map(|b| ChannelFlags::from(*b)).collect();
        flags.resize(m.values.len(), ChannelFlags::OK);
        Self {
            stamp: m.header.stamp.as_nanos(),
            sequence: m.sequence,
            device_time_us: m.device_time_us,
            values: m.values.clone(),
            flags,
            temperature: m.temperature,
            image: None,
        }
    }
}

impl From<&Contact> for msg::Contact {
    fn from(c: &Contact) -> Self {
        Self {
            track_id: c.track_id,
            position: point(&c.position),
            normal: vector(&c.normal),
            force: vector(&c.force),
            force_components: match c.force_components {
                ForceComponents::None => Self::FORCE_NONE,
                ForceComponents::Normal => Self::FORCE_NORMAL,
                ForceComponents::Full => Self::FORCE_FULL,
            },
            // nalgebra stores columns, messages rows; covariances are symmetric, but may be filled by others.
            position_covariance: std::array::from_fn(|i| c.position_covariance[(i / 3, i % 3)]),
            force_covariance: std::array::from_fn(|i| c.force_covariance[(i / 3, i % 3)]),
            diameter: c.diameter,
            confidence: c.confidence,
            taxels: c.taxels.clone(),
        }
    }
}

/// An estimate as the array that planners read; status is OK and thresholds are unknown until the caller sets them.
#[must_use]
pub fn contact_array(skin: &SkinDescription, frame: &Frame, estimate: &Estimate) -> ContactArray {
    ContactArray {
        header: skin.header(frame.stamp),
        skin: skin.name.clone(),
        sequence: frame.sequence,
        status: ContactArray::STATUS_OK,
        status_text: String::new(),
        sensor_kind: match skin.kind {
            SensorKind::Real => ContactArray::KIND_REAL,
            SensorKind::Simulated => ContactArray::KIND_SIMULATED,
            SensorKind::Virtual => ContactArray::KIND_VIRTUAL,
        },
        force_threshold: f32::NAN,
        force_max: f32::NAN,
        contacts: estimate.contacts.iter().map(Into::into).collect(),
    }
}

impl ForceMap {
    /// As a message that refers to the skin's geometry.
    #[must_use]
    pub fn to_message(&self, skin: &SkinDescription, frame: &Frame) -> msg::ForceMap {
        let (kind, forces) = match &self.forces {
            ForceValues::Normal(v) => (msg::ForceMap::KIND_NORMAL, v.clone()),
            ForceValues::Vector(v) => (msg::ForceMap::KIND_VECTOR, v.iter().flatten().copied().collect()),
        };
        msg::ForceMap {
            header: skin.header(frame.stamp),
            skin: skin.name.clone(),
            geometry_id: skin.geometry_id(),
            sequence: frame.sequence,
            kind,
            indices: self.indices.clone().unwrap_or_default(),
            forces,
        }
    }
}

impl DisplacementMap {
    /// As a message that refers to the skin's geometry.
    #[must_use]
    pub fn to_message(&self, skin: &SkinDescription, frame: &Frame) -> msg::DisplacementMap {
        msg::DisplacementMap {
            header: skin.header(frame.stamp),
            skin: skin.name.clone(),
            geometry_id: skin.geometry_id(),
            sequence: frame.sequence,
            indices: self.indices.clone().unwrap_or_default(),
            displacements: self.displacements.clone(),
        }
    }
}
