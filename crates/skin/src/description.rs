//! The skin description file.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::OnceLock;

use dermis_msgs::ChannelLayout;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::family::{self, FamilyShape, FieldFault};
use crate::mesh::TriangleMesh;
use crate::panel::Panel;
use crate::{Effect, ModelError, SkinError, Surface};

const SCHEMA: &str = "dermis-skin/1";

/// Whether readings come from hardware, from a simulator, or are computed from other sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorKind {
    /// Hardware.
    #[default]
    Real,
    /// A simulator.
    Simulated,
    /// Other sensors.
    Virtual,
}

/// Shape of the skin's outside, in the frame of its link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum SurfaceSpec {
    /// In the plane z = 0, centred on the origin, normal +z.
    Rectangle {
        /// \[m\] along x and y.
        size: [f64; 2],
        /// \[m\] between the points of its triangulation.
        spacing: f64,
    },
    /// A hemisphere on a cylinder about z; the origin lies in the base of the cylinder, the tip is up.
    Dome {
        /// \[m\] of hemisphere and cylinder.
        radius: f64,
        /// \[m\] height of the cylinder.
        cylinder: f64,
        /// \[m\] between the points of its triangulation.
        spacing: f64,
    },
    /// A shell of beams and holes: part of a cylinder about x, the middle of its outside at z = `radius`, with a grid of
    /// rectangular openings.
    Panel {
        /// \[m\] of the outside.
        radius: f64,
        /// \[m\] along x and along the arc.
        size: [f64; 2],
        /// \[m\] between the points of its triangulation, which lie on every edge of an opening.
        spacing: f64,
        /// \[m\] of solid material at each end along x.
        #[serde(default)]
        margin: f64,
        /// \[m\] of solid material along each straight side.
        #[serde(default)]
        rail: f64,
        /// Openings along x and along the arc.
        #[serde(default)]
        cells: [u32; 2],
        /// \[m\] of material between openings that are neighbours along x, and along the arc.
        #[serde(default)]
        beam: [f64; 2],
    },
    /// A triangulated surface from a file; its triangles are counter-clockwise seen from outside.
    Mesh {
        /// STL (text or binary) or OBJ; relative to the folder of the skin file.
        file: std::path::PathBuf,
        /// \[m\] of a unit of the file; 0.001 where it is drawn in millimetres.
        #[serde(default = "one")]
        scale: f64,
        /// Rims that are meant: the outer one, and one for every opening.
        #[serde(default = "one_rim")]
        rims: usize,
        /// What is in the file; read with the description.
        #[serde(skip)]
        mesh: TriangleMesh,
    },
    /// A shape of the sensor family's own.
    #[serde(skip)]
    Family(FamilyShape),
}

impl SurfaceSpec {
    /// The panel, where it is one and its openings leave any material.
    pub(crate) fn panel(&self) -> Option<Panel> {
        let SurfaceSpec::Panel { radius, size, margin, rail, cells, beam, .. } = *self else { return None };
        Panel::new(radius, size, [margin, rail], cells, beam)
    }

    /// What of it is the shape, and not where a file lies.
    fn identity(&self) -> serde_json::Value {
        match self {
            SurfaceSpec::Mesh { mesh, .. } => {
                serde_json::json!({ "type": "mesh", "sha256": mesh.digest() })
            }
            SurfaceSpec::Family(shape) => {
                serde_json::json!({ "type": shape.name, "parameters": shape.parameters })
            }
            shape => serde_json::json!(shape),
        }
    }
}

fn one() -> f64 {
    1.0
}

fn one_rim() -> usize {
    1
}

/// One sensing element.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Taxel {
    /// Unique in the skin.
    pub name: String,
    /// \[m\] in the frame of the skin's link.
    pub position: [f64; 3],
    /// Out of the surface; normalised on loading.
    #[serde(default = "up")]
    pub normal: [f64; 3],
    /// Direction along the surface in which an element measures that has one, as a strain gauge; made perpendicular to `normal`
    /// and normalised on loading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<[f64; 3]>,
}

impl Taxel {
    /// Position \[m\].
    #[must_use]
    pub fn point(&self) -> Point3<f64> {
        Point3::from(self.position)
    }

    /// Rotation that takes the taxel's z axis to its normal in the link frame.
    #[must_use]
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::from(self.normal))
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
    }
}

fn up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// One number of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channel {
    /// Unique in the skin.
    pub name: String,
    /// Name of the taxel that it belongs to.
    pub taxel: String,
    /// Range of the device, in the unit of the skin; a reading at either end is saturated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Standard deviation of its noise, in the unit of the skin; the skin's value where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
}

/// Framing on the raw transport.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum WireProtocol {
    /// Binary frames delimited by COBS, with CRC-16, sequence and device time.
    #[default]
    Native,
    /// A line of numbers a frame.
    Ascii,
    /// One of the sensor family's own, by its name.
    Family(String),
}

impl From<String> for WireProtocol {
    fn from(name: String) -> Self {
        match name.as_str() {
            "native" => Self::Native,
            "ascii" => Self::Ascii,
            _ => Self::Family(name),
        }
    }
}

impl From<WireProtocol> for String {
    fn from(protocol: WireProtocol) -> Self {
        match protocol {
            WireProtocol::Native => "native".to_owned(),
            WireProtocol::Ascii => "ascii".to_owned(),
            WireProtocol::Family(name) => name,
        }
    }
}

/// How raw readings become values in the unit of the skin: `value = raw · scale + offset`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wire {
    /// Framing.
    pub protocol: WireProtocol,
    /// Unit of the skin per raw count.
    pub scale: f64,
    /// Unit of the skin at raw count 0.
    pub offset: f64,
    /// Least and largest count of the device's converter. A line of text, which has no checksum, is refused where it holds
    /// anything but whole numbers between them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counts: Option<[u32; 2]>,
}

impl Default for Wire {
    fn default() -> Self {
        Self { protocol: WireProtocol::Native, scale: 1.0, offset: 0.0, counts: None }
    }
}

/// How raw values are cleaned before inference. Thresholds are multiples of a channel's noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Condition {
    /// \[s\] of untouched readings that a tare averages.
    pub tare_duration: f64,
    /// A contact is assumed when the root mean square of the channels exceeds this many noise deviations.
    pub contact_threshold: f64,
    /// \[s\] time constant with which the zero follows slow drift while the skin is not touched.
    pub drift_time: f64,
    /// Share of a contact's strongest signal below which a signal that stands still for `tare_duration` is what the
    /// medium's hysteresis leaves behind: the contact has ended there, and that signal is the new zero. 0 switches
    /// this off: where contacts may shift their weight instead of ending, as under a foot, stillness says nothing.
    pub release_share: f64,
    /// \[s\] without any change after which a channel is stuck; 0 switches the check off.
    pub stuck_time: f64,
    /// Whether whatever presses a channel to the end of its range is felt by others, too, as in a shell that bends as a
    /// whole: a channel that stands there for `stuck_time` while no other feels anything is broken then.
    pub coupled: bool,
    /// \[s\] without a frame after which the skin is stale.
    pub stale_time: f64,
}

impl Default for Condition {
    fn default() -> Self {
        Self {
            tare_duration: 0.5,
            contact_threshold: 4.0,
            drift_time: 30.0,
            release_share: 0.0,
            stuck_time: 5.0,
            coupled: false,
            stale_time: 0.5,
        }
    }
}

/// A number that follows from the rest of a description: two that differ in it only are equal.
#[derive(Debug, Clone, Default)]
struct Layout(OnceLock<(String, u32)>);

impl PartialEq for Layout {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// What a skin is, as its file says it.
///
/// A file is TOML; see `launch/skins/` for examples to copy. Unknown keys are errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkinDescription {
    schema: String,
    /// Of the type: lower case letters, digits, `-` and `_`. Of the device, unique on the robot, once it is an
    /// [instance](Self::into_instance).
    pub name: String,
    /// Name of the file's, where `name` is that of an instance.
    #[serde(skip)]
    pub(crate) type_name: Option<String>,
    /// What its frames carry, for the unit that it was computed for.
    #[serde(skip)]
    layout: Layout,
    /// Which sensor family reads it: a name in the program's registry.
    pub sensor: String,
    /// Free text.
    #[serde(default)]
    pub description: String,
    /// Where the readings come from.
    #[serde(default)]
    pub kind: SensorKind,
    /// Coordinate frame of every position: the URDF link that the skin is fixed to.
    pub frame_id: String,
    /// Unit of every value: an SI symbol, or `1`.
    pub unit: String,
    /// Frames a second \[Hz\].
    pub rate: f64,
    /// Standard deviation of a channel's noise, in `unit`.
    pub noise: f64,
    /// Range of the device, in `unit`, for channels that name none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Framing and raw counts.
    #[serde(default)]
    pub wire: Wire,
    /// Cleaning of raw values.
    #[serde(default)]
    pub condition: Condition,
    /// Shape of the outside.
    #[serde(serialize_with = "family::serialize_surface", deserialize_with = "family::deserialize_surface")]
    pub surface: SurfaceSpec,
    /// Sensing elements; a sensor family may fill them in.
    #[serde(default)]
    pub taxels: Vec<Taxel>,
    /// Numbers of a frame, in order; one a taxel and of its name where absent.
    #[serde(default)]
    channels: Vec<Channel>,
    /// What lies between surface and taxels: read by the sensor family's forward model.
    #[serde(default)]
    pub medium: toml::Table,
    /// What the nominal model leaves out and this device has: read by the sensor family's forward model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<Effect>,
}

impl SkinDescription {
    /// Reads a skin description file.
    ///
    /// # Errors
    ///
    /// [`SkinError`] says which file and field is wrong and what would be right.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SkinError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| SkinError::Read { path: path.to_owned(), source })?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Reads a skin description; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_toml(text: &str, file: &str) -> Result<Self, SkinError> {
        let deserializer = toml::Deserializer::parse(text).map_err(|e| SkinError::Parse {
            file: file.to_owned(),
            field: position(text, e.span()),
            reason: e.message().to_owned(),
        })?;
        let mut unknown = None;
        let mut track = serde_path_to_error::Track::new();
        let parsed: Result<Self, _> = {
            let path_aware = serde_path_to_error::Deserializer::new(deserializer, &mut track);
            serde_ignored::deserialize(path_aware, |path| {
                unknown.get_or_insert_with(|| path.to_string());
            })
        };
        // A misspelt key is the likely reason for a missing one, so that it comes first.
        if let Some(key) = unknown {
            return Err(SkinError::UnknownKey { file: file.to_owned(), key, known: KNOWN_KEYS.join(", ") });
        }
        let mut skin = parsed.map_err(|e| SkinError::Parse {
            file: file.to_owned(),
            field: match track.path().to_string() {
                p if p == "." => position(text, e.span()),
                p => p,
            },
            reason: e.message().to_owned(),
        })?;
        skin.finish(file)?;
        crate::limits::distinct(&skin.taxels).map_err(|(field, reason)| SkinError::Impossible {
            file: file.to_owned(),
            field,
            reason,
        })?;
        Ok(skin)
    }

    /// Fills in what may be left out and refuses what cannot be.
    fn finish(&mut self, file: &str) -> Result<(), SkinError> {
        let wrong = |field: String, reason: String| {
            Err(SkinError::Impossible { file: file.to_owned(), field, reason })
        };
        if self.schema != SCHEMA {
            return wrong(
                "schema".into(),
                format!("is \"{}\" where this program reads \"{SCHEMA}\"", self.schema),
            );
        }
        if let Err((field, reason)) = crate::limits::check(self) {
            return wrong(field, reason);
        }
        if let Err(FieldFault { field, reason }) = family::complete(self) {
            return wrong(field, reason);
        }
        // Again, with what the family filled in.
        if let Err((field, reason)) = crate::limits::check(self) {
            return wrong(field, reason);
        }
        let name_ok = |s: &str| {
            !s.is_empty()
                && s.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_')
        };
        if !name_ok(&self.name) {
            return wrong(
                "name".into(),
                format!("\"{}\" may only hold lower case letters, digits, `-` and `_`", self.name),
            );
        }
        if self.frame_id.is_empty() || self.frame_id.starts_with('/') {
            return wrong("frame_id".into(), "names a link, without a leading slash".into());
        }
        let positive = [
            ("rate", self.rate),
            ("noise", self.noise),
            ("condition.tare_duration", self.condition.tare_duration),
            ("condition.contact_threshold", self.condition.contact_threshold),
            ("condition.drift_time", self.condition.drift_time),
            ("condition.stale_time", self.condition.stale_time),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field.into(), format!("is {value} and must be a positive number"));
            }
        }
        if !(0.0..1.0).contains(&self.condition.release_share) {
            return wrong("condition.release_share".into(), "must be at least 0 (off) and below 1".into());
        }
        if !(self.condition.stuck_time.is_finite() && self.condition.stuck_time >= 0.0) {
            return wrong(
                "condition.stuck_time".into(),
                "must be 0 (off) or a positive number of seconds".into(),
            );
        }
        if !(self.wire.scale.is_finite() && self.wire.scale != 0.0 && self.wire.offset.is_finite()) {
            return wrong(
                "wire.scale".into(),
                "must be a finite number other than 0, and `offset` finite".into(),
            );
        }
        if let Some([low, high]) = self.wire.counts
            && low >= high
        {
            return wrong(
                "wire.counts".into(),
                format!("is [{low}, {high}] and must be a least and a greater largest count"),
            );
        }
        let lengths: Vec<(&str, f64)> = match self.surface {
            SurfaceSpec::Panel { radius, size, spacing, .. } => {
                vec![("radius", radius), ("size[0]", size[0]), ("size[1]", size[1]), ("spacing", spacing)]
            }
            SurfaceSpec::Mesh { scale, .. } => vec![("scale", scale)],
            SurfaceSpec::Family(_) => Vec::new(),
            SurfaceSpec::Rectangle { size, spacing } => {
                vec![("size[0]", size[0]), ("size[1]", size[1]), ("spacing", spacing)]
            }
            SurfaceSpec::Dome { radius, cylinder, spacing } => {
                vec![("radius", radius), ("cylinder", cylinder), ("spacing", spacing)]
            }
        };
        for (field, value) in &lengths {
            if !(value.is_finite() && *value > 0.0) {
                return wrong(
                    format!("surface.{field}"),
                    format!("is {value} m and must be a positive length"),
                );
            }
        }
        if let SurfaceSpec::Panel { radius, size, margin, rail, beam, .. } = self.surface {
            let borders = [("margin", margin), ("rail", rail), ("beam[0]", beam[0]), ("beam[1]", beam[1])];
            if let Some((field, value)) = borders.iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
                return wrong(
                    format!("surface.{field}"),
                    format!("is {value} m and must be 0 or a positive length"),
                );
            }
            if size[1] >= std::f64::consts::TAU * radius {
                return wrong(
                    "surface.size[1]".into(),
                    format!(
                        "{} m along the arc goes all the way around a cylinder of radius {radius} m",
                        size[1]
                    ),
                );
            }
            if self.surface.panel().is_none() {
                return wrong(
                    "surface.cells".into(),
                    "leaves no width for the openings between `margin`, `rail` and `beam`: take fewer".into(),
                );
            }
        }
        if let SurfaceSpec::Mesh { file: path, scale, rims, mesh } = &mut self.surface {
            // Beside the skin file, whatever folder the program runs in.
            if let Some(folder) = Path::new(file).parent() {
                *path = folder.join(&*path);
            }
            match TriangleMesh::load(path, *scale, *rims) {
                Ok(read) => *mesh = read,
                Err(reason) => return wrong("surface.file".into(), reason),
            }
        }
        if self.taxels.is_empty() {
            return wrong("taxels".into(), "is empty: a skin has at least one".into());
        }
        if let Some((field, reason)) = crate::effect::impossible(&self.effects) {
            return wrong(field, reason);
        }
        let mut names = BTreeSet::new();
        for (i, taxel) in self.taxels.iter_mut().enumerate() {
            if !names.insert(taxel.name.clone()) {
                return wrong(format!("taxels[{i}].name"), format!("\"{}\" is already taken", taxel.name));
            }
            if taxel.position.iter().any(|v| !v.is_finite()) {
                return wrong(format!("taxels[{i}].position"), "holds a number that is not finite".into());
            }
            let Some(unit) = Vector3::from(taxel.normal).try_normalize(1e-9) else {
                return wrong(format!("taxels[{i}].normal"), "has no length".into());
            };
            taxel.normal = unit.into();
            if let Some(axis) = &mut taxel.axis {
                let along = Vector3::from(*axis);
                let along = along - unit * unit.dot(&along);
                let Some(along) = along.try_normalize(1e-6) else {
                    return wrong(
                        format!("taxels[{i}].axis"),
                        "must be a direction along the surface, not along `normal`".into(),
                    );
                };
                *axis = along.into();
            }
        }
        if self.channels.is_empty() {
            self.channels = self
                .taxels
                .iter()
                .map(|t| Channel { name: t.name.clone(), taxel: t.name.clone(), range: None, noise: None })
                .collect();
        }
        let mut channels = BTreeSet::new();
        for (i, channel) in self.channels.iter_mut().enumerate() {
            if !channels.insert(channel.name.clone()) {
                return wrong(
                    format!("channels[{i}].name"),
                    format!("\"{}\" is already taken", channel.name),
                );
            }
            if !names.contains(&channel.taxel) {
                return wrong(
                    format!("channels[{i}].taxel"),
                    format!(
                        "\"{}\" is none of the taxels; they are {}",
                        channel.taxel,
                        join(names.iter(), 12)
                    ),
                );
            }
            channel.range = channel.range.or(self.range);
            if let Some([low, high]) = channel.range
                && low.partial_cmp(&high) != Some(std::cmp::Ordering::Less)
            {
                return wrong(
                    format!("channels[{i}].range"),
                    format!("[{low}, {high}] is empty: low must be below high"),
                );
            }
            let noise = *channel.noise.get_or_insert(self.noise);
            if !(noise.is_finite() && noise > 0.0) {
                return wrong(format!("channels[{i}].noise"), format!("is {noise} and must be positive"));
            }
        }
        Ok(())
    }

    /// The same skin with other sensing elements, one channel each: elements that could be, for placement, or that are only
    /// computed.
    ///
    /// # Errors
    ///
    /// [`SkinError::Impossible`] where an element cannot be, as in a file.
    pub fn with_taxels(&self, taxels: Vec<Taxel>) -> Result<Self, SkinError> {
        let mut skin = Self { taxels, channels: Vec::new(), layout: Layout::default(), ..self.clone() };
        skin.finish(&format!("{}, with other taxels", self.name))?;
        Ok(skin)
    }

    /// What [`medium`](Self::medium) says, as a sensor family knows it.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] with the field `medium.…` that is missing, unknown or of another type.
    pub fn medium_as<T: serde::de::DeserializeOwned>(&self) -> Result<T, ModelError> {
        serde_path_to_error::deserialize(toml::Value::Table(self.medium.clone())).map_err(|e| {
            let field = match e.path().to_string() {
                p if p == "." => "medium".to_owned(),
                p => format!("medium.{p}"),
            };
            let reason = e.inner().message().trim().replace('\n', " ");
            ModelError::Description { skin: self.name.clone(), field, reason }
        })
    }

    /// What `read`, a family's reader of [`medium`](Self::medium), says of that table. A skin without one has no forward model, which
    /// is no mistake; neither is one that the family has no model for.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] for a field of `medium`.
    pub fn check_medium(&self, read: impl FnOnce() -> Result<(), ModelError>) -> Result<(), ModelError> {
        if self.medium.is_empty() {
            return Ok(());
        }
        match read() {
            Err(error @ ModelError::Description { .. }) if error.is_of_medium() => Err(error),
            _ => Ok(()),
        }
    }

    /// Numbers of a frame, in order. `range` and `noise` have the skin's values filled in.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Gives the skin these numbers of a frame, for a sensor family that [completes](crate::Family::complete) it.
    pub fn set_channels(&mut self, channels: Vec<Channel>) {
        self.channels = channels;
        self.layout = Layout::default();
    }

    /// Gives the shape that only the sensor family knows its mesh; nothing happens to a skin of another shape.
    pub fn set_shape(&mut self, mesh: TriangleMesh) {
        if let SurfaceSpec::Family(shape) = &mut self.surface {
            shape.mesh = mesh;
        }
    }

    /// What says of a frame that its values are those of [`channels`](Self::channels) in [`unit`](Self::unit); see
    /// [`ChannelLayout`]. Computed once: frames come often.
    #[must_use]
    pub fn layout_id(&self) -> u32 {
        let names = self.channels.iter().map(|channel| channel.name.as_str());
        let (unit, id) = self
            .layout
            .0
            .get_or_init(|| (self.unit.clone(), ChannelLayout::id_of(&self.unit, names.clone())));
        // The unit can be written from outside.
        if *unit == self.unit { *id } else { ChannelLayout::id_of(&self.unit, names) }
    }

    /// Standard deviation of each channel's noise, in `unit`.
    #[must_use]
    pub fn channel_noise(&self) -> Vec<f64> {
        self.channels.iter().map(|c| c.noise.unwrap_or(self.noise)).collect()
    }

    /// Index of the taxel that each channel belongs to.
    #[must_use]
    pub fn channel_taxels(&self) -> Vec<usize> {
        self.channels
            .iter()
            .map(|c| self.taxels.iter().position(|t| t.name == c.taxel).unwrap_or_default())
            .collect()
    }

    /// The triangulated surface.
    #[must_use]
    pub fn surface(&self) -> Surface {
        Surface::from_spec(&self.surface)
    }

    /// Identity of the type: `sha256:` and 64 hex digits over sensor family, unit, surface, taxels, channels and medium. What
    /// does not change the physics (name, text, rate, wire, cleaning, link) does not change the hash, nor do comments and
    /// formatting; nor do effects, which say what a device of this design is really like, so that a model that was trained on
    /// the design can be tried on the device.
    ///
    /// Names of taxels and channels are covered: where several channels belong to one taxel (the axes of a magnetometer), the
    /// name alone says which number of a frame is which, and recordings are matched by it.
    #[must_use]
    pub fn hash(&self) -> String {
        digest(&self.identity())
    }

    /// The hash as versions before this one wrote it, which covered the name.
    pub(crate) fn hash_of_named(&self, name: &str) -> String {
        let mut identity = self.identity();
        identity["name"] = name.into();
        digest(&identity)
    }

    fn identity(&self) -> serde_json::Value {
        serde_json::json!({
            "schema": self.schema,
            "sensor": self.sensor,
            "unit": self.unit,
            "surface": self.surface.identity(),
            "taxels": self.taxels,
            "channels": self.channels,
            "medium": self.medium,
        })
    }
}

fn digest(identity: &serde_json::Value) -> String {
    let digest = Sha256::digest(identity.to_string().as_bytes());
    let hex: String = digest.iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{hex}")
}

const KNOWN_KEYS: [&str; 15] = [
    "schema",
    "name",
    "sensor",
    "description",
    "kind",
    "frame_id",
    "unit",
    "rate",
    "noise",
    "range",
    "wire",
    "condition",
    "surface, taxels, channels",
    "medium",
    "effects",
];

fn join<'a>(names: impl ExactSizeIterator<Item = &'a String>, most: usize) -> String {
    let total = names.len();
    let mut text = names.take(most).cloned().collect::<Vec<_>>().join(", ");
    if total > most {
        text.push_str(&format!(" and {} more", total - most));
    }
    text
}

/// "line 3, column 5" of a byte range, for errors that belong to no field.
fn position(text: &str, span: Option<std::ops::Range<usize>>) -> String {
    let Some(span) = span.filter(|s| s.start > 0) else { return "(whole file)".to_owned() };
    let before = text.get(..span.start).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    format!("line {line}, column {column}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAD: &str = r#"
schema = "dermis-skin/1"
name = "pad"
sensor = "taxels"
frame_id = "pad_link"
unit = "Pa"
rate = 100.0
noise = 20.0
surface = { type = "rectangle", size = [0.02, 0.01], spacing = 0.005 }
taxels = [{ name = "t0", position = [0.0, 0.0, -0.005] }, { name = "t1", position = [0.005, 0.0, -0.005] }]
"#;

    fn refused(from: &str, to: &str) -> String {
        assert!(PAD.contains(from));
        SkinDescription::from_toml(&PAD.replace(from, to), "pad.toml").unwrap_err().to_string()
    }

    #[test]
    fn channels_follow_taxels_where_none_are_named() {
        let skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        assert_eq!(skin.channels()[1].name, "t1");
        assert_eq!(skin.channel_noise(), [20.0, 20.0]);
        assert_eq!(skin.channel_taxels(), [0, 1]);
    }

    #[test]
    fn a_skin_can_have_other_taxels() {
        let skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        let mut other = skin.taxels[1].clone();
        other.normal = [0.0, 0.0, 2.0];
        let one = skin.with_taxels(vec![other.clone()]).unwrap();
        assert_eq!((one.channels().len(), one.channels()[0].name.as_str()), (1, "t1"));
        assert_eq!((one.taxels[0].normal, one.channel_noise()), ([0.0, 0.0, 1.0], vec![20.0]));
        let twice = skin.with_taxels(vec![other.clone(), other]).unwrap_err();
        insta::assert_snapshot!(twice, @r#"skin file pad, with other taxels: field `taxels[1].name`: "t1" is already taken"#);
    }

    #[test]
    fn hash_ignores_what_is_not_physics() {
        let hash = |text: &str| SkinDescription::from_toml(text, "pad.toml").unwrap().hash();
        assert_eq!(hash(PAD), hash(&PAD.replace("rate = 100.0", "rate = 50 # slower")));
        assert_eq!(hash(PAD), hash(&PAD.replace("name = \"pad\"", "name = \"left-pad\"")));
        assert_ne!(hash(PAD), hash(&PAD.replace("-0.005] }]", "-0.006] }]")));
        assert_ne!(hash(PAD), hash(&PAD.replace("\"t1\"", "\"t2\"")));
    }

    #[test]
    fn refusals_name_file_field_and_remedy() {
        insta::assert_snapshot!(refused("noise = 20.0", "noise = -1.0"), @"skin file pad.toml: field `noise`: is -1 and must be a positive number");
        insta::assert_snapshot!(refused("rate = 100.0", "rate = \"fast\""), @r#"skin file pad.toml: field `rate`: invalid type: string "fast", expected f64"#);
        insta::assert_snapshot!(refused("rate = 100.0", "rate = 100.0\nrat = 3"), @"skin file pad.toml: unknown key `rat`; remove it or correct its spelling (known here: schema, name, sensor, description, kind, frame_id, unit, rate, noise, range, wire, condition, surface, taxels, channels, medium, effects)");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\nwire = { protocol = \"ascii\", counts = [4095, 0] }"), @"skin file pad.toml: field `wire.counts`: is [4095, 0] and must be a least and a greater largest count");
        insta::assert_snapshot!(refused("size = [0.02, 0.01]", "size = [0.02, -0.01]"), @"skin file pad.toml: field `surface.size[1]`: is -0.01 m and must be a positive length");
        insta::assert_snapshot!(refused("\"t1\"", "\"t0\""), @r#"skin file pad.toml: field `taxels[1].name`: "t0" is already taken"#);
        insta::assert_snapshot!(refused("dermis-skin/1", "dermis-skin/9"), @r#"skin file pad.toml: field `schema`: is "dermis-skin/9" where this program reads "dermis-skin/1""#);
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\neffects = [{ name = \"gain\", strength = -1.0 }]"), @"skin file pad.toml: field `effects[0].strength`: is -1 and must be 0 (off) or positive");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\neffects = [{ name = \"gain\" }, { name = \"gain\", by = 0.2 }]"), @r#"skin file pad.toml: field `effects[1].name`: "gain" is already there"#);
        insta::assert_snapshot!(refused("name = \"pad\"\n", ""), @"skin file pad.toml: field `(whole file)`: missing field `name`");
    }

    proptest::proptest! {
        #[test]
        fn what_is_written_reads_back(
            name in "[a-z0-9_-]{1,12}",
            description in ".{0,30}",
            rate in 1e-3..1e5f64,
            noise in 1e-9..1e9f64,
            scale in 1e-9..1e9f64,
            offset in -1e9..1e9f64,
            ascii in proptest::bool::ANY,
            positions in proptest::collection::vec(proptest::array::uniform3(-1.0..1.0f64), 1..8),
            stuck in 0.0..1e3f64,
        ) {
            let mut skin = SkinDescription::from_toml(include_str!("../../../launch/skins/baro-grid.toml"), "grid").unwrap();
            skin.name = name;
            skin.description = description;
            (skin.rate, skin.noise, skin.condition.stuck_time) = (rate, noise, stuck);
            skin.wire.protocol = if ascii { WireProtocol::Ascii } else { WireProtocol::Native };
            (skin.wire.scale, skin.wire.offset) = (scale, offset);
            let taxels = positions.iter().enumerate();
            skin.taxels = taxels.map(|(i, p)| Taxel { name: format!("t{i}"), position: *p, normal: up(), axis: None }).collect();
            skin.channels.clear();
            skin.finish("written").unwrap();
            let text = toml::to_string(&skin).unwrap();
            proptest::prop_assert_eq!(SkinDescription::from_toml(&text, "written").unwrap(), skin);
        }

        #[test]
        fn no_text_panics(text in ".{0,200}") {
            let _ = SkinDescription::from_toml(&text, "x");
        }
    }
}
