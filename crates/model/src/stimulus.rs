//! What touches a skin: the input of a forward model.

use std::f64::consts::TAU;

use dermis_skin::{ModelError, Surface, TipKind};
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Shape and size \[m\] of the end of an indenter. It presses along its own -z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "kebab-case", deny_unknown_fields)]
pub enum TipShape {
    /// A ball.
    Sphere {
        /// \[m\]
        diameter: f64,
    },
    /// A rod that lies on its side, along its own x.
    Cylinder {
        /// \[m\]
        diameter: f64,
        /// \[m\]
        length: f64,
    },
    /// The flat end of a round rod.
    FlatPunch {
        /// \[m\] of the face.
        diameter: f64,
    },
    /// An edge along its own x, between two flanks.
    Wedge {
        /// \[rad\] between the flanks.
        angle: f64,
        /// \[m\] of the edge.
        length: f64,
    },
    /// The flat end of a rod with as many equal sides; the first corner is on its own x.
    Polygon {
        /// Sides of the face.
        sides: u32,
        /// \[m\] of the circle through its corners.
        diameter: f64,
    },
    /// The flat side of a box; tilted, its edge presses first.
    Box {
        /// \[m\] along its own x and y.
        size: [f64; 2],
    },
}

impl TipShape {
    /// The tip of this diameter \[m\] that a skin is rated for.
    #[must_use]
    pub fn of_kind(kind: TipKind, diameter: f64) -> Self {
        match kind {
            TipKind::Sphere => Self::Sphere { diameter },
            TipKind::FlatPunch => Self::FlatPunch { diameter },
        }
    }

    /// As files and errors call it.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Sphere { .. } => "sphere",
            Self::Cylinder { .. } => "cylinder",
            Self::FlatPunch { .. } => "flat-punch",
            Self::Wedge { .. } => "wedge",
            Self::Polygon { .. } => "polygon",
            Self::Box { .. } => "box",
        }
    }

    /// \[m\] from end to end: the diameter of a sphere, the longest extent of the face of any other shape.
    #[must_use]
    pub fn extent(&self) -> f64 {
        match *self {
            Self::Sphere { diameter } | Self::FlatPunch { diameter } | Self::Polygon { diameter, .. } => {
                diameter
            }
            Self::Cylinder { diameter, length } => diameter.max(length),
            Self::Wedge { length, .. } => length,
            Self::Box { size: [x, y] } => x.hypot(y),
        }
    }

    /// \[m\] by which the tip's face lies above its lowest point, over (x, y) \[m\] in its own frame; `None` beside the face.
    #[must_use]
    pub fn face(&self, x: f64, y: f64) -> Option<f64> {
        let round =
            |radius: f64, r: f64| (r <= radius).then(|| radius - (radius * radius - r * r).max(0.0).sqrt());
        match *self {
            Self::Sphere { diameter } => round(diameter / 2.0, x.hypot(y)),
            Self::Cylinder { diameter, length } => {
                round(diameter / 2.0, y.abs()).filter(|_| x.abs() <= length / 2.0)
            }
            Self::FlatPunch { diameter } => (x.hypot(y) <= diameter / 2.0).then_some(0.0),
            Self::Wedge { angle, length } => (x.abs() <= length / 2.0).then(|| y.abs() / (angle / 2.0).tan()),
            Self::Polygon { sides, diameter } => {
                // Within half a side of the middle of the nearest one, all of which are as far away.
                let side = TAU / f64::from(sides);
                let beside = (y.atan2(x) - side / 2.0).rem_euclid(side);
                let beside = beside.min(side - beside);
                (x.hypot(y) * beside.cos() <= diameter / 2.0 * (side / 2.0).cos()).then_some(0.0)
            }
            Self::Box { size } => (x.abs() <= size[0] / 2.0 && y.abs() <= size[1] / 2.0).then_some(0.0),
        }
    }

    /// The same shape with all lengths times `factor`.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        match &mut self {
            Self::Sphere { diameter } | Self::FlatPunch { diameter } | Self::Polygon { diameter, .. } => {
                *diameter *= factor;
            }
            Self::Cylinder { diameter, length } => {
                *diameter *= factor;
                *length *= factor;
            }
            Self::Wedge { length, .. } => *length *= factor,
            Self::Box { size } => size.iter_mut().for_each(|s| *s *= factor),
        }
        self
    }

    /// What of the shape cannot be: which number, and what it must be.
    ///
    /// # Errors
    ///
    /// A sentence.
    pub fn check(&self) -> Result<(), String> {
        let (low, high) =
            (Indentation::DIAMETERS.start().to_owned(), Indentation::DIAMETERS.end().to_owned());
        let lengths: &[(&str, f64)] = match self {
            Self::Sphere { diameter } | Self::FlatPunch { diameter } => &[("diameter", *diameter)],
            Self::Cylinder { diameter, length } => &[("diameter", *diameter), ("length", *length)],
            Self::Wedge { angle, length } => {
                if !(*angle > 0.0 && *angle < std::f64::consts::PI) {
                    return Err(format!("the angle of its wedge is {angle} rad and must be between 0 and π"));
                }
                &[("length", *length)]
            }
            Self::Polygon { sides, diameter } => {
                if !(3..=64).contains(sides) {
                    return Err(format!("its polygon has {sides} sides and must have 3 to 64"));
                }
                &[("diameter", *diameter)]
            }
            Self::Box { size: [x, y] } => &[("first side", *x), ("second side", *y)],
        };
        for (name, value) in lengths {
            if !Indentation::DIAMETERS.contains(value) {
                return Err(format!("its {name} is {value} m and must be {low} to {high} m"));
            }
        }
        Ok(())
    }
}

/// The end of an indenter, and how it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    /// Shape and size.
    pub shape: TipShape,
    /// From the frame of the tip to that of the skin's link. A sphere is the same whichever way it is turned.
    pub orientation: UnitQuaternion<f64>,
}

impl Tip {
    /// A ball of this diameter \[m\].
    #[must_use]
    pub fn sphere(diameter: f64) -> Self {
        Self { shape: TipShape::Sphere { diameter }, orientation: UnitQuaternion::identity() }
    }

    /// A tip that stands straight where the surface has this outward normal, its x axis along the first
    /// [tangent](crate::tangents).
    #[must_use]
    pub fn standing(shape: TipShape, normal: &Vector3<f64>) -> Self {
        let [first, second] = crate::tangents(normal);
        let turn = Rotation3::from_basis_unchecked(&[first, second, *normal]);
        Self { shape, orientation: UnitQuaternion::from_rotation_matrix(&turn) }
    }

    /// The diameter \[m\] of a sphere; `None` for any other shape.
    #[must_use]
    pub fn as_sphere(&self) -> Option<f64> {
        match self.shape {
            TipShape::Sphere { diameter } => Some(diameter),
            _ => None,
        }
    }
}

/// One indenter on the skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Indentation {
    /// \[m\] centre of the contact on the undeformed surface.
    pub position: Point3<f64>,
    /// \[N\] exerted on the skin, in the link frame; the normal part points into the surface.
    pub force: Vector3<f64>,
    /// What presses.
    pub tip: Tip,
}

impl Indentation {
    /// \[m\] off the surface that a contact may lie: rounding of single precision, with room to spare.
    pub const OFF_SURFACE: f64 = 1e-4;
    /// \[m\] diameters of a tip that forward models speak of.
    pub const DIAMETERS: std::ops::RangeInclusive<f64> = 1e-4..=0.1;

    /// A ball of `diameter` \[m\] that exerts `force` \[N\] at `position` \[m\].
    #[must_use]
    pub fn sphere(position: Point3<f64>, force: Vector3<f64>, diameter: f64) -> Self {
        Self { position, force, tip: Tip::sphere(diameter) }
    }

    /// \[m\] of a spherical tip; of any other, its longest extent ([`TipShape::extent`]).
    #[must_use]
    pub fn diameter(&self) -> f64 {
        self.tip.shape.extent()
    }

    /// The same with a spherical tip of another diameter \[m\].
    #[must_use]
    pub fn with_diameter(self, diameter: f64) -> Self {
        Self { tip: Tip::sphere(diameter), ..self }
    }

    /// The outward normal under a contact that forward models for spherical tips can speak of; `index` is its place in the
    /// stimulus.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where it is not a number, lies off `surface`, pulls, or has an impossible tip or one that is no
    /// sphere.
    pub fn check(&self, index: usize, surface: &Surface) -> Result<Vector3<f64>, ModelError> {
        let wrong = |reason: String| Err(ModelError::Stimulus { index, reason });
        if self.tip.as_sphere().is_none() {
            return wrong(format!(
                "its tip is a {}, and this model knows spheres only: give a tip of shape \"sphere\"",
                self.tip.shape.name()
            ));
        }
        self.check_any_tip(index, surface)
    }

    /// As [`check`](Self::check), for models that know every shape of tip.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where it is not a number, lies off `surface`, pulls, or has an impossible tip.
    pub fn check_any_tip(&self, index: usize, surface: &Surface) -> Result<Vector3<f64>, ModelError> {
        let wrong = |reason: String| Err(ModelError::Stimulus { index, reason });
        let p = self.position;
        if !p.iter().chain(self.force.iter()).all(|v| v.is_finite()) {
            return wrong("its position or force is not a number".into());
        }
        let (nearest, normal) = surface.project(&p);
        let off = (p - nearest).norm();
        if off > Self::OFF_SURFACE {
            return wrong(format!("({}, {}, {}) m lies {off:.6} m off the surface", p.x, p.y, p.z));
        }
        let pressing = -self.force.dot(&normal);
        if pressing < 0.0 {
            return wrong(format!("it pulls with {} N, and this model knows no adhesion", -pressing));
        }
        match self.tip.shape.check() {
            Ok(()) => Ok(normal),
            Err(reason) => wrong(reason),
        }
    }
}

/// What touches the skin at one instant, and what it is surrounded by.
#[derive(Debug, Clone, PartialEq)]
pub struct Stimulus {
    /// All indenters; empty means "not touched".
    pub contacts: Vec<Indentation>,
    /// \[K\] of the skin.
    pub temperature: f64,
    /// \[Pa\] of the air around it.
    pub ambient_pressure: f64,
    /// \[m/s²\] in the frame of the skin's link. Zero, the default: the weight of the skin itself is part of its tare.
    pub gravity: Vector3<f64>,
}

impl Default for Stimulus {
    /// Untouched at 20 °C and one standard atmosphere, without weight.
    fn default() -> Self {
        Self {
            contacts: Vec::new(),
            temperature: 293.15,
            ambient_pressure: 101_325.0,
            gravity: Vector3::zeros(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use approx::assert_relative_eq;
    use dermis_skin::SurfaceSpec;

    use super::*;

    #[test]
    fn faces_are_as_wide_and_high_as_their_shapes() {
        let sphere = TipShape::Sphere { diameter: 0.004 };
        assert_relative_eq!(sphere.face(0.0, 0.002).unwrap(), 0.002);
        assert_eq!((sphere.face(0.0, 0.0), sphere.face(0.0015, 0.0015)), (Some(0.0), None));
        let rod = TipShape::Cylinder { diameter: 0.004, length: 0.010 };
        assert_eq!(
            (rod.face(0.005, 0.0), rod.face(0.0051, 0.0), rod.face(0.0, 0.0021)),
            (Some(0.0), None, None)
        );
        let wedge = TipShape::Wedge { angle: FRAC_PI_2, length: 0.010 };
        assert_relative_eq!(wedge.face(0.004, -0.001).unwrap(), 0.001, max_relative = 1e-12);
        assert_eq!(wedge.face(0.006, 0.0), None);
        // Of a blunt one, the flanks rise slowly.
        let blunt = TipShape::Wedge { angle: 0.9 * PI, length: 0.010 };
        assert!(blunt.face(0.0, 0.001).unwrap() < 2e-4);
        let plate = TipShape::Box { size: [0.004, 0.002] };
        assert_eq!((plate.face(0.002, 0.001), plate.face(0.0021, 0.0)), (Some(0.0), None));
        // The area of a polygon's face: n/2 sin(2π/n) of the square of its circle's radius.
        for sides in [3, 4, 6, 9] {
            let shape = TipShape::Polygon { sides, diameter: 2.0 };
            let at = |i: i32| (f64::from(i) + 0.5) / 200.0;
            let inside = (-200..200).flat_map(|i| (-200..200).map(move |j| (i, j)));
            let inside = inside.filter(|(i, j)| shape.face(at(*i), at(*j)).is_some()).count();
            let n = f64::from(sides);
            assert_relative_eq!(inside as f64 / 4e4, n / 2.0 * (TAU / n).sin(), max_relative = 5e-3);
            // A corner is on x, and the side across from a triangle's corner is half as far away.
            assert!(shape.face(0.999, 0.0).is_some() && shape.face(1.001, 0.0).is_none());
            assert_eq!(shape.face(-0.6, 0.0).is_some(), sides > 3);
        }
    }

    #[test]
    fn what_presses_is_taken_and_what_pulls_is_refused() {
        let dome = Surface::from_spec(&SurfaceSpec::Dome { radius: 0.03, cylinder: 0.02, spacing: 0.002 });
        let on_wall =
            |force: [f64; 3]| Indentation::sphere(Point3::new(0.03, 0.0, 0.01), Vector3::from(force), 0.004);
        let normal = on_wall([-1.0, 0.0, 0.0]).check(0, &dome).unwrap();
        assert!((normal - Vector3::x()).norm() < 1e-6, "{normal}");
        // A force along the wall alone is no pull; the least bit away from the wall is.
        for (force, refused) in [
            ([-1.0, 3.0, 0.0], false),
            ([0.0, 3.0, 0.0], false),
            ([0.5, 0.0, -3.0], true),
            ([1e-6, 0.0, 0.0], true),
        ] {
            let checked = on_wall(force).check(2, &dome);
            assert_eq!(checked.is_err(), refused, "{force:?}");
            if let Err(error) = checked {
                assert!(error.to_string().starts_with("contact 2: it pulls with "), "{error}");
            }
        }
    }
}
