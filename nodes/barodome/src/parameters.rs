//! Everything that the forward model is computed from: what the skin description says, which static effects then change.

use dermis_mechanics::Medium;
use dermis_skin::{ModelError, SkinDescription, SurfaceSpec};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

/// What holds the lower side of the elastomer.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged, expecting = "must be \"bonded\", \"slip\", or a share of slip from 0 to 1")]
enum BaseSpec {
    Named(NamedBase),
    /// Share of slip.
    Share(f64),
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum NamedBase {
    Bonded,
    Slip,
}

/// What becomes of the elastomer at the edge of a flat surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Edge {
    /// It goes on, far enough to make no difference.
    #[default]
    Wide,
    /// It ends there, with a free side.
    Free,
}

/// `medium` of a skin description.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct MediumSpec {
    /// \[m\].
    thickness: f64,
    /// \[Pa\].
    young_modulus: f64,
    poisson_ratio: f64,
    #[serde(default)]
    base: Option<BaseSpec>,
    #[serde(default)]
    edge: Edge,
    #[serde(default)]
    bore: Option<BoreSpec>,
}

/// A bore full of fluid, instead of an elastomer that the sensing elements lie in.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoreSpec {
    /// \[Pa\] rise of pressure per share of the volume that is squeezed: the pressure itself for a gas, what walls and bubbles
    /// allow for a liquid.
    pub fluid_stiffness: f64,
    /// \[m\] of bore that hold as much fluid as tube and sensor beyond each end.
    pub dead_length: f64,
    /// \[m\] of bore that a large force squeezes out.
    pub displaced_length: f64,
    /// \[N\] that squeeze half of it out.
    pub half_force: f64,
    /// \[N\] from which on the bore is closed under the tip.
    pub pinch_force: f64,
}

/// One channel's sensing element.
#[derive(Debug, Clone, PartialEq)]
pub struct Element {
    /// \[m\] of its port, in the frame of the skin's link.
    pub position: Point3<f64>,
    /// Unit, out of the surface: the chip lies across it.
    pub normal: Vector3<f64>,
    /// \[m\] sides of the rectangle across `normal` over which it averages the pressure; 0 reads at a point.
    pub footprint: [f64; 2],
    /// Reading per mean compressive stress: what a stiff inclusion adds.
    pub gain: f64,
}

/// Numbers that readings are computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    /// Shape of the outside.
    pub surface: SurfaceSpec,
    /// \[m\] of elastomer between surface and base.
    pub thickness: f64,
    /// \[Pa\].
    pub young_modulus: f64,
    /// Of the elastomer.
    pub poisson_ratio: f64,
    /// 0: bonded to the base; 1: slips on it; between: that mixture of both fields.
    pub slip: f64,
    /// What becomes of the elastomer at the edge of a flat surface.
    pub edge: Edge,
    /// A bore through it that the sensing elements lie at the ends of, if any.
    pub bore: Option<BoreSpec>,
    /// \[Pa\] of the elastomer as the description says, whatever effects made of it.
    pub design_modulus: f64,
    /// Local stiffening by the packages: relative rise of the modulus that a contact straight above one feels.
    pub stiffening: f64,
    /// \[m\] distance from a package at which that has fallen to e^(-1/2).
    pub stiffening_reach: f64,
    /// Diameter of a tip relative to what the stimulus says.
    pub diameter_scale: f64,
    /// One a channel.
    pub elements: Vec<Element>,
}

impl Parameters {
    /// The nominal numbers of a skin.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible.
    pub fn nominal(skin: &SkinDescription) -> Result<Self, ModelError> {
        let wrong = |field: &str, reason: String| ModelError::Description {
            skin: skin.name.clone(),
            field: field.to_owned(),
            reason,
        };
        if skin.unit != "Pa" {
            return Err(wrong("unit", format!("is \"{}\" where barometers read \"Pa\"", skin.unit)));
        }
        let spec: MediumSpec = skin.medium_as()?;
        // One number at a time, so that the refusal names its field.
        let impossible = |field| move |e: dermis_mechanics::MechanicsError| wrong(field, e.to_string());
        Medium::half_space(1.0, spec.poisson_ratio).map_err(impossible("medium.poisson_ratio"))?;
        Medium::half_space(spec.young_modulus, 0.0).map_err(impossible("medium.young_modulus"))?;
        if !(spec.thickness.is_finite() && spec.thickness > 0.0) {
            let reason = format!("is {} m and must be a positive length", spec.thickness);
            return Err(wrong("medium.thickness", reason));
        }
        let slip = match spec.base {
            None | Some(BaseSpec::Named(NamedBase::Bonded)) => 0.0,
            Some(BaseSpec::Named(NamedBase::Slip)) => 1.0,
            Some(BaseSpec::Share(share)) if (0.0..=1.0).contains(&share) => share,
            Some(BaseSpec::Share(share)) => {
                let reason =
                    format!("is {share} and must be \"bonded\", \"slip\", or a share of slip from 0 to 1");
                return Err(wrong("medium.base", reason));
            }
        };
        let elements = skin
            .channel_taxels()
            .into_iter()
            .map(|taxel| {
                let taxel = &skin.taxels[taxel];
                Element {
                    position: taxel.point(),
                    normal: Vector3::from(taxel.normal),
                    footprint: [0.0; 2],
                    gain: 1.0,
                }
            })
            .collect();
        Ok(Self {
            surface: skin.surface.clone(),
            thickness: spec.thickness,
            young_modulus: spec.young_modulus,
            poisson_ratio: spec.poisson_ratio,
            slip,
            edge: spec.edge,
            bore: spec.bore,
            design_modulus: spec.young_modulus,
            stiffening: 0.0,
            stiffening_reach: 0.004,
            diameter_scale: 1.0,
            elements,
        })
    }
}
