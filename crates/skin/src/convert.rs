//! From the vocabulary to messages and back.

use std::collections::BTreeMap;

use dermis_msgs::ChannelLayout;
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{Point, Pose, Quaternion, Vector3 as VectorMsg};
use dermis_msgs::msg::{self, ContactArray, SkinGeometry, TaxelFrame};
use dermis_msgs::sensor_msgs::msg::{CompressedImage, Image as ImageMsg};
use dermis_msgs::std_msgs::msg::Header;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::{
    ChannelFlags, Contact, DisplacementMap, Estimate, ForceComponents, ForceMap, ForceValues, Frame, Image,
    PixelFormat, SensorKind, SkinDescription, Stamp, Surface,
};

/// A point as messages have it.
#[must_use]
pub fn point(p: &Point3<f64>) -> Point {
    Point { x: p.x, y: p.y, z: p.z }
}

/// A vector as messages have it.
#[must_use]
pub fn vector(v: &Vector3<f64>) -> VectorMsg {
    VectorMsg { x: v.x, y: v.y, z: v.z }
}

/// A pose as messages have it.
#[must_use]
pub fn pose(p: &Isometry3<f64>) -> Pose {
    let q = &p.rotation;
    Pose {
        position: point(&p.translation.vector.into()),
        orientation: Quaternion { x: q.i, y: q.j, z: q.k, w: q.w },
    }
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
                .map(|t| pose(&Isometry3::from_parts(t.point().into(), t.orientation())))
                .collect(),
            layout_id: self.layout_id(),
            unit: self.unit.clone(),
            channels: self.channels().iter().map(|c| c.name.clone()).collect(),
            channel_taxels: self.channel_taxels().iter().map(|i| *i as u32).collect(),
            electrodes: 0,
        }
    }

    /// The picture of a frame as a message; `None` where the skin has no camera.
    #[must_use]
    pub fn image_message(&self, frame: &Frame) -> Option<ImageMsg> {
        let image = frame.image.as_ref()?;
        let step = image.width() * image.format().bytes() as u32;
        Some(ImageMsg {
            header: self.header(frame.stamp),
            height: image.height(),
            width: image.width(),
            encoding: image.format().encoding().to_owned(),
            is_bigendian: 0,
            step,
            data: image.data().to_vec(),
        })
    }

    /// The picture of a frame as its device sent it; `None` where that was no JPEG.
    #[must_use]
    pub fn compressed_image_message(&self, frame: &Frame) -> Option<CompressedImage> {
        let jpeg = frame.image.as_ref()?.jpeg()?;
        Some(CompressedImage {
            header: self.header(frame.stamp),
            format: "jpeg".to_owned(),
            data: jpeg.to_vec(),
        })
    }

    /// A frame as a message.
    #[must_use]
    pub fn frame_message(&self, frame: &Frame) -> TaxelFrame {
        TaxelFrame {
            header: self.header(frame.stamp),
            skin: self.name.clone(),
            sequence: frame.sequence,
            device_time_us: frame.device_time_us,
            layout_id: self.layout_id(),
            values: frame.values.clone(),
            flags: frame.flags.iter().map(|f| f.bits()).collect(),
            temperature: frame.temperature,
        }
    }
}

impl SkinDescription {
    /// Why the values of a frame are not those of this skin's channels; `None` where they are, or where a foreign sender did
    /// not say which channels they are of. `known` are the layouts that were recorded or heard, by their
    /// [`id`](ChannelLayout::id): they name what differs.
    #[must_use]
    pub fn layout_mismatch(
        &self,
        frame: &TaxelFrame,
        known: &BTreeMap<u32, ChannelLayout>,
    ) -> Option<String> {
        let (sequence, channels) = (frame.sequence, self.channels());
        if frame.values.len() != channels.len() {
            return Some(format!(
                "frame {sequence} has {} values where the skin has {} channels",
                frame.values.len(),
                channels.len()
            ));
        }
        if frame.layout_id == 0 || frame.layout_id == self.layout_id() {
            return None;
        }
        let Some(layout) = known.get(&frame.layout_id) else {
            return Some(format!(
                "frame {sequence} has the channel layout {:08x} where the skin has {:08x}, and no geometry says which \
                 channels those are",
                frame.layout_id,
                self.layout_id()
            ));
        };
        let mut pairs = layout.channels.iter().zip(channels).enumerate();
        if let Some((i, (got, expected))) = pairs.find(|(_, (got, expected))| **got != expected.name) {
            let expected = &expected.name;
            return Some(format!("frame {sequence}: channel {i} is `{got}` where the skin has `{expected}`"));
        }
        Some(format!("frame {sequence} is in \"{}\" where the skin is in \"{}\"", layout.unit, self.unit))
    }
}

impl Image {
    /// The picture of a message; `None` where its encoding is not known here, or its rows have something between them.
    #[must_use]
    pub fn from_message(message: &ImageMsg) -> Option<Self> {
        let format = PixelFormat::from_encoding(&message.encoding)?;
        Self::new(message.width, message.height, format, message.data.as_slice())
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

impl From<&msg::Contact> for Contact {
    fn from(c: &msg::Contact) -> Self {
        Self {
            track_id: c.track_id,
            position: Point3::new(c.position.x, c.position.y, c.position.z),
            normal: Vector3::new(c.normal.x, c.normal.y, c.normal.z),
            force: Vector3::new(c.force.x, c.force.y, c.force.z),
            force_components: match c.force_components {
                msg::Contact::FORCE_NORMAL => ForceComponents::Normal,
                msg::Contact::FORCE_FULL => ForceComponents::Full,
                // What a newer sender may say is not known here.
                _ => ForceComponents::None,
            },
            position_covariance: Matrix3::from_row_slice(&c.position_covariance),
            force_covariance: Matrix3::from_row_slice(&c.force_covariance),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::PAD;

    #[test]
    fn a_contact_comes_back_from_its_message() {
        let mut contact = Contact::at(Point3::new(0.1, 0.2, 0.3), Vector3::y());
        contact.force = Vector3::new(0.5, -2.0, 0.0);
        contact.position_covariance = Matrix3::new(1.0, 0.2, 0.3, 0.2, 2.0, 0.4, 0.3, 0.4, 3.0);
        contact.force_covariance = Matrix3::identity();
        (contact.diameter, contact.track_id, contact.taxels) = (0.01, 7, vec![2, 1]);
        for components in [ForceComponents::None, ForceComponents::Normal, ForceComponents::Full] {
            contact.force_components = components;
            assert_eq!(Contact::from(&msg::Contact::from(&contact)), contact);
        }
    }

    #[test]
    fn a_frame_of_other_channels_is_distinguished() {
        let skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        let of =
            |from: &str, to: &str| SkinDescription::from_toml(&PAD.replace(from, to), "pad.toml").unwrap();
        let frame = |skin: &SkinDescription| skin.frame_message(&Frame::new(1, 7, vec![1.0, 2.0]));
        let layout = |skin: &SkinDescription| ChannelLayout::of(&skin.geometry_message(&skin.surface(), 1));
        let none = BTreeMap::new();
        assert_eq!(skin.layout_mismatch(&frame(&skin), &none), None);
        assert_eq!(skin.layout_mismatch(&TaxelFrame { layout_id: 0, ..frame(&skin) }, &none), None);
        assert_eq!(skin.layout_mismatch(&frame(&of("pad_link", "other_link")), &none), None);
        assert_eq!(layout(&skin).id(), skin.layout_id());

        let (renamed, scaled) = (of("\"t1\"", "\"t2\""), of("\"Pa\"", "\"hPa\""));
        let known = [&renamed, &scaled].map(|skin| (skin.layout_id(), layout(skin))).into();
        insta::assert_snapshot!(skin.layout_mismatch(&frame(&renamed), &known).unwrap(), @"frame 7: channel 1 is `t2` where the skin has `t1`");
        insta::assert_snapshot!(skin.layout_mismatch(&frame(&renamed), &none).unwrap(), @"frame 7 has the channel layout 2c18c065 where the skin has 073593a6, and no geometry says which channels those are");
        insta::assert_snapshot!(skin.layout_mismatch(&frame(&scaled), &known).unwrap(), @r#"frame 7 is in "hPa" where the skin is in "Pa""#);
        let short = TaxelFrame { values: vec![1.0], ..frame(&skin) };
        insta::assert_snapshot!(skin.layout_mismatch(&short, &known).unwrap(), @"frame 7 has 1 values where the skin has 2 channels");

        // The number follows a unit that is written later.
        let mut written = skin.clone();
        assert_eq!(written.layout_id(), skin.layout_id());
        written.unit = "hPa".into();
        assert_eq!(written.layout_id(), scaled.layout_id());
    }
}
