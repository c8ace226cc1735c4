//! The tables of a skin description file: surface, taxels, channels, wire, cleaning.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::family::FamilyShape;
use crate::mesh::TriangleMesh;
use crate::panel::Panel;

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

    /// What identifies the shape: the content of a file, not its path.
    pub(super) fn identity(&self) -> serde_json::Value {
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
    /// With positions to 0.1 µm and directions to 1e-7.
    pub(super) fn rounded(&self) -> Self {
        // Adding nothing makes a zero of the negative one.
        let rounded = |of: [f64; 3]| of.map(|v| (v * 1e7).round() / 1e7 + 0.0);
        let Self { name, position, normal, axis } = self.clone();
        Self { name, position: rounded(position), normal: rounded(normal), axis: axis.map(rounded) }
    }

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

pub(super) fn up() -> [f64; 3] {
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
    /// How values lie in binary frames. Frames of another kind are refused; all kinds are read where absent, and a simulated device
    /// sends [`WireSamples::F32`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<WireSamples>,
    /// \[bytes\] of the longest datagram: a simulated device sends a longer binary frame in parts. In one piece where absent; frames
    /// in parts are read in either case.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub datagram: Option<u32>,
}

/// How the values of a binary frame lie on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WireSamples {
    /// Single precision.
    #[default]
    F32,
    /// Signed counts of 16 bits.
    I16,
    /// Counts of 16 bits.
    U16,
    /// Signed counts of 32 bits.
    I32,
    /// Counts of 12 bits, two in three bytes.
    U12,
}

impl WireSamples {
    /// The largest count that fits; `None` where every count of a converter does.
    pub(super) fn largest_count(self) -> Option<u32> {
        match self {
            Self::F32 | Self::I32 => None,
            Self::I16 => Some(0x7fff),
            Self::U16 => Some(0xffff),
            Self::U12 => Some(0xfff),
        }
    }
}

impl Default for Wire {
    fn default() -> Self {
        Self {
            protocol: WireProtocol::Native,
            scale: 1.0,
            offset: 0.0,
            counts: None,
            samples: None,
            datagram: None,
        }
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
    /// this off, for skins whose contacts may shift their weight instead of ending, as under a foot.
    pub release_share: f64,
    /// \[s\] without any change after which a channel is stuck; 0 switches the check off.
    pub stuck_time: f64,
    /// Whether a press that drives one channel to the end of its range is read by others, too, as in a shell that bends as a
    /// whole: a channel that stands there for `stuck_time` while no other reads a touch is broken then.
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
