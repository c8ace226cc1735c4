//! Everything that the forward model is computed from: what the skin description says, which static effects then change.

use dermis_mechanics::MechanicsError;
use dermis_mechanics::shell::{PlateTheory, Section};
use dermis_skin::{ModelError, SkinDescription, Surface, SurfaceSpec};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

/// \[m\] off the inner face that a gauge may be written down: rounding of a drawing, with room to spare.
const OFF_FACE: f64 = 5e-4;
/// How upright a gauge's normal may stand to that of the surface: 20°.
const UPRIGHT: f64 = 0.94;

/// `medium` of a skin description.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct MediumSpec {
    /// \[m\] of the shell.
    thickness: f64,
    /// \[Pa\].
    young_modulus: f64,
    poisson_ratio: f64,
    /// \[m\] length along its axis, and width, of every gauge.
    gauge: [f64; 2],
    /// \[m\] radius over which a touch presses in maps of displacement.
    #[serde(default = "patch")]
    patch: f64,
    /// How the shell is computed.
    #[serde(default)]
    theory: Theory,
    /// Boxes whose points are held; the two ends along x of a panel where absent.
    #[serde(default)]
    clamp: Vec<Region>,
    /// What turns strain into counts; readings are not counted where absent.
    #[serde(default)]
    bridge: Option<Bridge>,
}

/// `medium.theory` of a skin description.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Theory {
    /// Normals stay normal, on the triangles of the surface, and forces act on the middle surface: what the bundles that ship were
    /// trained on. Gauges read about 9 % less than in converged solids, and a force along the surface, which also turns the shell by
    /// its arm of half a thickness, has a wrong effect.
    #[default]
    KirchhoffLove,
    /// The shell shears across its thickness, on triangles that are refined at edges and corners, and forces act on the outside.
    /// Within 3 % of solids; five times as long to solve.
    ReissnerMindlin,
}

fn patch() -> f64 {
    5e-3
}

/// A box in the link frame.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Region {
    /// \[m\].
    min: [f64; 3],
    /// \[m\].
    max: [f64; 3],
}

impl Region {
    fn holds(&self, p: &Point3<f64>) -> bool {
        (0..3).all(|k| (self.min[k]..=self.max[k]).contains(&p[k]))
    }
}

/// A Wheatstone bridge, its amplifier and its converter, all on one supply.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bridge {
    /// Of the amplifier.
    gain: f64,
    /// Relative change of resistance per strain.
    gauge_factor: f64,
    /// Arms that are strained: 1 or 2 of a half bridge.
    active_arms: f64,
    /// Of the converter, whose range is the supply.
    bits: u32,
}

impl Bridge {
    /// Strain of one count: the bridge gives arms · factor · strain / 4 of the supply, the amplifier `gain` times that.
    #[must_use]
    pub fn count(&self) -> f64 {
        4.0 / (self.active_arms * self.gauge_factor * self.gain * f64::from(1u32 << self.bits))
    }
}

/// One channel's strain gauge.
#[derive(Debug, Clone, PartialEq)]
pub struct StrainGauge {
    /// \[m\] its middle, on the inner face.
    pub position: Point3<f64>,
    /// Unit, out of the shell's outer side, at its middle.
    pub normal: Vector3<f64>,
    /// Unit, along the surface: the direction that it measures in.
    pub axis: Vector3<f64>,
    /// \[m\] along and across `axis`.
    pub size: [f64; 2],
    /// Reading per strain.
    pub gain: f64,
    /// Reading per strain across, over reading per strain along.
    pub transverse: f64,
}

/// How the ends are held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Clamp {
    /// Without any give.
    Rigid,
    /// By springs that, all together, have these stiffnesses.
    Springs {
        /// \[N/m\] along each axis.
        translation: f64,
        /// \[N·m/rad\] about each axis.
        rotation: f64,
    },
}

/// Numbers that readings are computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    /// The outside.
    pub surface: Surface,
    /// Material and thickness: one for all triangles, or one for each.
    pub sections: Vec<Section>,
    /// Whether the shell shears across its thickness; then its triangles are refined, and forces act on the outside.
    pub theory: PlateTheory,
    /// \[m\] of the shell by design.
    pub thickness: f64,
    /// Points of the surface that are held.
    pub held: Vec<usize>,
    /// How they are.
    pub clamp: Clamp,
    /// \[m\].
    pub patch: f64,
    /// Geometric stiffening β: under the deflection u the force is 1 + β(u/h)² times what the linear shell needs.
    pub stiffening: f64,
    /// One a channel.
    pub gauges: Vec<StrainGauge>,
    /// Where readings are counted.
    pub bridge: Option<Bridge>,
}

impl Parameters {
    /// The nominal numbers of a skin.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible.
    pub fn nominal(skin: &SkinDescription) -> Result<Self, ModelError> {
        let wrong = |field: &str, reason: String| skin.refusal(field, reason);
        if skin.unit != "1" {
            return Err(wrong("unit", format!("is \"{}\" where strain gauges read \"1\"", skin.unit)));
        }
        let spec: MediumSpec = skin.medium_as()?;
        let lengths = [
            ("medium.thickness", spec.thickness),
            ("medium.young_modulus", spec.young_modulus),
            ("medium.gauge[0]", spec.gauge[0]),
            ("medium.gauge[1]", spec.gauge[1]),
            ("medium.patch", spec.patch),
        ];
        if let Some((field, value)) = lengths.iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
            return Err(wrong(field, format!("is {value} and must be a positive number")));
        }
        if !(0.0..0.5).contains(&spec.poisson_ratio) {
            return Err(wrong(
                "medium.poisson_ratio",
                format!("is {} and must be at least 0 and below 0.5", spec.poisson_ratio),
            ));
        }
        if let Some(bridge) = &spec.bridge {
            let numbers = [
                ("medium.bridge.gain", bridge.gain),
                ("medium.bridge.gauge_factor", bridge.gauge_factor),
                ("medium.bridge.active_arms", bridge.active_arms),
            ];
            if let Some((field, value)) = numbers.iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
                return Err(wrong(field, format!("is {value} and must be a positive number")));
            }
            if !(1..=30).contains(&bridge.bits) {
                return Err(wrong("medium.bridge.bits", format!("is {} and must be 1 to 30", bridge.bits)));
            }
        }
        let surface = skin.surface();
        let held = held(skin, &spec, &surface)?;
        let gauges = skin
            .channel_taxels()
            .into_iter()
            .map(|taxel| gauge(skin, &spec, &surface, taxel))
            .collect::<Result<_, _>>()?;
        let theory = match spec.theory {
            Theory::KirchhoffLove => PlateTheory::KirchhoffLove,
            Theory::ReissnerMindlin => PlateTheory::ReissnerMindlin,
        };
        let section = Section::isotropic(spec.young_modulus, spec.poisson_ratio, spec.thickness).by(theory);
        Ok(Self {
            sections: vec![section],
            theory,
            thickness: spec.thickness,
            held,
            clamp: Clamp::Rigid,
            patch: spec.patch,
            stiffening: 0.0,
            gauges,
            bridge: spec.bridge,
            surface,
        })
    }

    /// \[m\] from the middle surface to where forces act, along the normal.
    #[must_use]
    pub fn arm(&self) -> f64 {
        match self.theory {
            PlateTheory::KirchhoffLove => 0.0,
            PlateTheory::ReissnerMindlin => self.thickness / 2.0,
        }
    }

    /// \[m\] the point of the middle surface below a point of the outside.
    #[must_use]
    pub fn middle(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> Point3<f64> {
        point - normal * (self.thickness / 2.0)
    }
}

/// Refuses what mechanics refuses.
pub fn impossible(skin: &SkinDescription, field: &str) -> impl Fn(MechanicsError) -> ModelError {
    let (skin, field) = (skin.name.clone(), field.to_owned());
    move |error| ModelError::Description {
        skin: skin.clone(),
        field: field.clone(),
        reason: error.to_string(),
    }
}

fn held(skin: &SkinDescription, spec: &MediumSpec, surface: &Surface) -> Result<Vec<usize>, ModelError> {
    let points = surface.points.iter().enumerate();
    let held: Vec<usize> = match (&skin.surface, spec.clamp.is_empty()) {
        (SurfaceSpec::Panel { size, .. }, true) => {
            let end = size[0] / 2.0 * (1.0 - 1e-9);
            points.filter(|(_, p)| p.x.abs() >= end).map(|(i, _)| i).collect()
        }
        (_, true) => {
            return Err(skin.refusal("medium.clamp",
                "is missing: say where the shell is held, as [{ min = [x, y, z], max = [x, y, z] }] in metres".into(),
            ));
        }
        _ => points.filter(|(_, p)| spec.clamp.iter().any(|r| r.holds(p))).map(|(i, _)| i).collect(),
    };
    // A whole edge, not a point of it: three points not in one line are the least that hold a shell.
    if held.len() < 3 {
        return Err(skin.refusal(
            "medium.clamp",
            format!("holds {} points of the surface: at least three are needed", held.len()),
        ));
    }
    Ok(held)
}

fn gauge(
    skin: &SkinDescription,
    spec: &MediumSpec,
    surface: &Surface,
    taxel: usize,
) -> Result<StrainGauge, ModelError> {
    let field = |name: &str| format!("taxels[{taxel}].{name}");
    let description = &skin.taxels[taxel];
    let at = description.point();
    let (outside, normal) = surface.project(&at);
    let inside = outside - normal * spec.thickness;
    let off = (at - inside).norm();
    if off > OFF_FACE {
        return Err(skin.refusal(&field("position"),
            format!(
                "({}, {}, {}) m lies {off:.4} m off the inner face of the shell, whose nearest point is ({:.4}, {:.4}, \
                 {:.4}) m",
                at.x, at.y, at.z, inside.x, inside.y, inside.z
            ),
        ));
    }
    if Vector3::from(description.normal).dot(&normal) < UPRIGHT {
        return Err(skin.refusal(
            &field("normal"),
            format!(
                "is not that of the surface there, which is [{:.4}, {:.4}, {:.4}]",
                normal.x, normal.y, normal.z
            ),
        ));
    }
    let Some(axis) = description.axis else {
        return Err(
            skin.refusal(&field("axis"), "is missing: a strain gauge measures along a direction".into())
        );
    };
    let axis = Vector3::from(axis);
    // Both are upright to nearly the same normal: something is left of it.
    let axis = (axis - normal * normal.dot(&axis)).normalize();
    Ok(StrainGauge { position: inside, normal, axis, size: spec.gauge, gain: 1.0, transverse: 0.0 })
}
