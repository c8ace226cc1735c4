//! Everything that the forward model is computed from: what the skin description says, which effects then change.

mod complete;

use std::f64::consts::TAU;

use dermis_skin::{FieldFault, ModelError, SkinDescription, SurfaceSpec};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use serde::Deserialize;

pub use complete::{check, complete};

use crate::elastic::Grid;
use crate::elastic::mesh::{Elastomer, Fovea, Skeleton};
use crate::elastic::stretching::STRETCHED;
use crate::optics::lens::FULL_WIDTH;
use crate::optics::light::{Beam, COLOURS, Finish, Lamp};
use crate::optics::picture::Texture;
use crate::optics::ridges::Ridges;
use crate::optics::{Camera, Light, Noise};
use crate::shape::Thumb;
use crate::surface::Rings;

/// Name of the shape in skin files.
pub const SHAPE: &str = "thumb";

/// `surface` of a skin description.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShapeSpec {
    /// \[m\] of the base.
    radius: f64,
    /// \[m\].
    height: f64,
    /// \[m\] of the tip's radius.
    tip: f64,
    /// \[m\] above the base where the elastomer ends.
    end: f64,
    /// \[m\] between the points of the outside.
    spacing: f64,
}

/// `medium` of a skin description.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct MediumSpec {
    elastomer: ElastomerSpec,
    skeleton: Skeleton,
    fovea: Option<Fovea>,
    ridges: Option<Ridges>,
    camera: CameraSpec,
    lamps: LampsSpec,
    finish: FinishSpec,
    noise: NoiseSpec,
    /// Blocks of pixels across and down that the numbers of a frame are made of.
    blocks: [u32; 2],
}

/// `medium.elastomer`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct ElastomerSpec {
    thickness: f64,
    young_modulus: f64,
    poisson_ratio: f64,
    density: f64,
    /// Tangential over normal force at which a contact slips.
    friction: f64,
    /// Cells around (a multiple of 8), and through.
    cells: [usize; 2],
    /// \[m\] between nodes of the inside's grid.
    grid: f64,
    /// \[m\] around it that a press reaches.
    reach: f64,
}

/// `medium.camera`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraSpec {
    /// Pixels.
    size: [u32; 2],
    /// \[pixels\] of a picture that is 1640 wide.
    focal: f64,
    /// \[m\] of the pupil above the base.
    height: f64,
    /// Of the sensor's red, green, blue.
    gains: [f64; COLOURS],
    /// Of all of them.
    exposure: f64,
    gamma: f64,
    /// Share of red and of green light that blue sees.
    blue_sees: [f64; 2],
}

/// `medium.lamps`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct LampsSpec {
    /// R, G, B in the order around the axis.
    colours: String,
    /// \[rad\] to the first.
    azimuth: f64,
    /// \[m\] of the ring.
    radius: f64,
    /// \[m\] above the base.
    height: f64,
    /// Of red, green, blue.
    drive: [f64; COLOURS],
    /// \[m\] of a collimator's hole.
    hole: f64,
    /// \[rad\] by which beams lean outwards.
    tilt: f64,
    /// \[m\] of a beam's radius at the hole.
    beam: f64,
    /// \[m\] by which it grows with each metre.
    spread: f64,
}

/// `medium.finish`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct FinishSpec {
    diffuse: f64,
    specular: f64,
    shininess: f64,
    /// Share of the mean light that the inside lights itself with.
    ambient: f64,
}

/// `medium.noise`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct NoiseSpec {
    /// Root mean square of the difference of two pictures of which nothing has changed.
    difference: f64,
    /// Standard deviation in the dark.
    read: f64,
}

/// Brightness that the noise's size is said for.
const NOISE_AT: f64 = 0.4;

/// Numbers that pictures are computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    /// What deforms.
    pub elastomer: Elastomer,
    /// The points of the outside.
    pub rings: Rings,
    /// Of the inside.
    pub grid: Grid,
    /// \[m\] around it that a press reaches.
    pub reach: f64,
    /// Tangential over normal force at which a contact slips.
    pub friction: f64,
    /// Factor of Young's modulus: displacements of another elastomer are known without another basis.
    pub stiffness: f64,
    /// Relative stiffening where the inside gives way by the elastomer's thickness ([`stretching`](crate::elastic::stretching)).
    pub stiffening: f64,
    /// \[m/N\] that the top of the skeleton gives way sideways.
    pub flex: f64,
    /// The camera.
    pub camera: Camera,
    /// Its lamps' light, without ambient light.
    pub light: Light,
    /// Share of the mean light that the inside lights itself with.
    pub ambient: f64,
    /// Relative change of the lamps' light with temperature \[1/K\].
    pub per_kelvin: f64,
    /// What the inside has besides its shape.
    pub texture: Texture,
    /// Of a pixel.
    pub noise: Noise,
    /// Blocks of pixels across and down.
    pub blocks: [u32; 2],
}

/// A field, its value, and the least and the largest that it may have.
type Limits = (&'static str, f64, [f64; 2]);

impl MediumSpec {
    /// All numbers, with what they may be.
    fn limits(&self) -> Vec<Limits> {
        let Self { elastomer: e, skeleton: k, camera: c, lamps: l, finish: f, noise: n, blocks, .. } = self;
        let mut limits = vec![
            ("elastomer.thickness", e.thickness, [1e-4, 0.02]),
            ("elastomer.young_modulus", e.young_modulus, [1e3, 1e9]),
            ("elastomer.poisson_ratio", e.poisson_ratio, [0.0, 0.4999]),
            ("elastomer.density", e.density, [0.0, 2e4]),
            ("elastomer.friction", e.friction, [0.0, 10.0]),
            ("elastomer.cells[0]", e.cells[0] as f64, [16.0, 200.0]),
            ("elastomer.cells[1]", e.cells[1] as f64, [2.0, 20.0]),
            ("elastomer.grid", e.grid, [3e-4, 0.02]),
            ("elastomer.reach", e.reach, [2e-3, 0.1]),
            ("skeleton.beam", k.beam, [1e-4, 0.02]),
            ("skeleton.inside", k.inside, [0.0, (e.thickness - k.beam).max(0.0)]),
            ("camera.size[0]", f64::from(c.size[0]), [16.0, 4096.0]),
            ("camera.size[1]", f64::from(c.size[1]), [16.0, 4096.0]),
            ("camera.focal", c.focal, [300.0, 1e4]),
            ("camera.height", c.height, [0.0, 0.05]),
            ("camera.exposure", c.exposure, [1e-3, 1e3]),
            ("camera.gamma", c.gamma, [1.0, 3.0]),
            ("camera.blue_sees[0]", c.blue_sees[0], [0.0, 1.0]),
            ("camera.blue_sees[1]", c.blue_sees[1], [0.0, 1.0]),
            ("lamps.radius", l.radius, [1e-4, 0.1]),
            ("lamps.height", l.height, [-0.02, 0.05]),
            ("lamps.azimuth", l.azimuth, [-TAU, TAU]),
            ("lamps.hole", l.hole, [1e-4, 0.02]),
            ("lamps.tilt", l.tilt, [-1.0, 1.0]),
            ("lamps.beam", l.beam, [1e-4, 0.05]),
            ("lamps.spread", l.spread, [0.0, 10.0]),
            ("finish.diffuse", f.diffuse, [0.0, 10.0]),
            ("finish.specular", f.specular, [0.0, 10.0]),
            ("finish.shininess", f.shininess, [1.0, 1e3]),
            ("finish.ambient", f.ambient, [0.0, 0.9]),
            ("noise.read", n.read, [0.0, 0.1]),
            ("noise.difference", n.difference, [2f64.sqrt() * n.read, 0.3]),
            ("blocks[0]", f64::from(blocks[0]), [2.0, 64.0]),
            ("blocks[1]", f64::from(blocks[1]), [2.0, 48.0]),
        ];
        let names = ["camera.gains[0]", "camera.gains[1]", "camera.gains[2]"];
        limits.extend(names.into_iter().zip(c.gains).map(|(name, gain)| (name, gain, [0.0, 100.0])));
        let names = ["lamps.drive[0]", "lamps.drive[1]", "lamps.drive[2]"];
        limits.extend(names.into_iter().zip(l.drive).map(|(name, drive)| (name, drive, [0.0, 100.0])));
        if let Some(fovea) = &self.fovea {
            limits.extend([
                ("fovea.thickness", fovea.thickness, [1e-4, e.thickness]),
                ("fovea.size[0]", fovea.size[0], [1e-3, 0.1]),
                ("fovea.size[1]", fovea.size[1], [1e-3, 0.1]),
            ]);
        }
        if let Some(ridges) = &self.ridges {
            limits.extend([
                ("ridges.pitch", ridges.pitch, [2e-4, 0.02]),
                ("ridges.count", f64::from(ridges.count), [1.0, 1e3]),
                ("ridges.height", ridges.height, [0.0, 0.5 * ridges.pitch]),
            ]);
        }
        limits
    }

    fn read(skin: &SkinDescription) -> Result<Self, ModelError> {
        let spec: Self = skin.medium_as()?;
        for (field, value, [low, high]) in spec.limits() {
            if !(low..=high).contains(&value) {
                let reason = format!("is {value} and must be {low} to {high}");
                return Err(skin.refusal(&format!("medium.{field}"), reason));
            }
        }
        let known = |c: char| "RGB".contains(c);
        if spec.lamps.colours.is_empty()
            || spec.lamps.colours.len() > 64
            || !spec.lamps.colours.chars().all(known)
        {
            let reason = format!("is \"{}\" and must be 1 to 64 letters R, G, B", spec.lamps.colours);
            return Err(skin.refusal("medium.lamps.colours", reason));
        }
        Ok(spec)
    }
}

/// The shape of a skin.
///
/// # Errors
///
/// [`FieldFault`] names the field that cannot be.
pub fn shape(skin: &SkinDescription) -> Result<(Thumb, ShapeSpec, Rings), FieldFault> {
    let wrong = |field: &str, reason: String| Err(FieldFault::new(format!("surface.{field}"), reason));
    let known = match &skin.surface {
        SurfaceSpec::Family(shape) if shape.name == SHAPE => shape.parameters_as::<ShapeSpec>()?,
        _ => return wrong("type", format!("must be \"{SHAPE}\": a cone that a sphere closes")),
    };
    let thumb = Thumb::new(known.radius, known.height, known.tip)
        .map_err(|reason| FieldFault::new("surface.tip", reason))?;
    for (field, value, [low, high]) in [
        ("radius", known.radius, [2e-3, 0.2]),
        ("height", known.height, [5e-3, 0.5]),
        ("end", known.end, [0.0, 0.8 * known.height]),
        ("spacing", known.spacing, [thumb.length() / 200.0, thumb.length() / 5.0]),
    ] {
        if !(low..=high).contains(&value) {
            return wrong(field, format!("is {value} m and must be {low} to {high} m"));
        }
    }
    let rings = Rings::new(&thumb, thumb.way_to(known.end), known.spacing);
    Ok((thumb, known, rings))
}

impl Parameters {
    /// The nominal numbers of a skin.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible.
    pub fn nominal(skin: &SkinDescription) -> Result<Self, ModelError> {
        let spec = MediumSpec::read(skin)?;
        let (thumb, surface, rings) =
            shape(skin).map_err(|fault| skin.refusal(&fault.field, fault.reason))?;
        let ElastomerSpec { thickness, cells, grid, .. } = spec.elastomer;
        if thickness >= surface.tip || spec.camera.height >= surface.height - surface.tip {
            let reason = format!(
                "leaves no room inside: the elastomer must be thinner than the tip's radius of {} m, and the camera below its middle",
                surface.tip
            );
            return Err(skin.refusal("medium.elastomer.thickness", reason));
        }
        let mut skeleton = spec.skeleton.clone();
        // The elastomer ends in a ring, wherever the others are.
        skeleton.rings.retain(|ring| *ring < thumb.way_to(surface.end) - skeleton.beam);
        skeleton.rings.push(thumb.way_to(surface.end));
        // Of a quarter, and even: the tip is divided like half of a cube.
        let around = cells[0] / 8 * 2;
        let elastomer = Elastomer {
            thumb,
            thickness,
            young_modulus: spec.elastomer.young_modulus,
            poisson_ratio: spec.elastomer.poisson_ratio,
            density: spec.elastomer.density,
            skeleton,
            fovea: spec.fovea,
            around,
            layers: cells[1],
            cell: surface.spacing,
        };
        let columns = (TAU * (surface.radius - thickness) / grid / 4.0).ceil().max(3.0) as usize * 4;
        let light = light(&spec);
        Ok(Self {
            elastomer,
            rings,
            grid: Grid::new(thumb.length(), grid, columns),
            reach: spec.elastomer.reach,
            friction: spec.elastomer.friction,
            stiffness: 1.0,
            stiffening: STRETCHED,
            flex: 0.0,
            camera: Camera {
                size: spec.camera.size,
                focal: spec.camera.focal * f64::from(spec.camera.size[0]) / FULL_WIDTH,
                position: Point3::new(0.0, 0.0, spec.camera.height),
                orientation: Rotation3::identity(),
            },
            light,
            ambient: spec.finish.ambient,
            per_kelvin: 0.0,
            texture: Texture { ridges: spec.ridges, ..Texture::default() },
            noise: Noise {
                shot: (0.5 * spec.noise.difference.powi(2) - spec.noise.read.powi(2)) / NOISE_AT,
                read: spec.noise.read,
            },
            blocks: spec.blocks,
        })
    }

    /// \[Pa\] E/(1 − ν²).
    #[must_use]
    pub fn modulus(&self) -> f64 {
        self.stiffness * self.elastomer.young_modulus / (1.0 - self.elastomer.poisson_ratio.powi(2))
    }
}

/// Lamps in a ring, their beams, what they light and what the sensor makes of it.
fn light(spec: &MediumSpec) -> Light {
    let lamps = &spec.lamps;
    let count = lamps.colours.chars().count() as f64;
    let lamp = |(i, colour): (usize, char)| {
        let (sin, cos) = (lamps.azimuth + TAU * i as f64 / count).sin_cos();
        let (out, up) = lamps.tilt.sin_cos();
        let mut power = [0.0; COLOURS];
        let own = usize::from(colour != 'R') + usize::from(colour == 'B');
        power[own] = lamps.drive[own];
        Lamp {
            position: Point3::new(lamps.radius * cos, lamps.radius * sin, lamps.height),
            axis: Vector3::new(out * cos, out * sin, up),
            power,
        }
    };
    let [red, green] = spec.camera.blue_sees;
    let gains = Vector3::from(spec.camera.gains) * spec.camera.exposure;
    let mixing = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, red, green, 1.0);
    Light {
        lamps: lamps.colours.chars().enumerate().map(lamp).collect(),
        beam: Beam { radius: lamps.beam, spread: lamps.spread, edge: lamps.hole },
        finish: Finish {
            diffuse: spec.finish.diffuse,
            specular: spec.finish.specular,
            shininess: spec.finish.shininess,
        },
        ambient: [0.0; COLOURS],
        sensor: Matrix3::from_diagonal(&gains) * mixing,
        gamma: spec.camera.gamma,
    }
}
