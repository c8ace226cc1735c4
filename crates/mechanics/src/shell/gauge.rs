//! What a strain gauge on a face of the shell reads.

use dermis_skin::closest_on_triangle;
use nalgebra::{Matrix2, Point2, Point3, Vector2, Vector3};

use super::element::{Element, Row};
use super::{Action, FREEDOMS, Shell, ShellMesh};
use crate::MechanicsError;
use crate::error::positive;

/// A triangle belongs to the footprint's side of the shell if its normal is nearer than 60° to the footprint's.
const FACING: f64 = 0.5;

/// Which face of the shell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Face {
    /// Against the outward normal: half a thickness below the middle surface.
    Inner,
    /// The middle surface: membrane strain only.
    Middle,
    /// Along the outward normal.
    Outer,
}

impl Face {
    /// Height over the middle surface as a share of the thickness.
    fn height(self) -> f64 {
        match self {
            Self::Inner => -0.5,
            Self::Middle => 0.0,
            Self::Outer => 0.5,
        }
    }
}

/// A strain gauge: a rectangle that reads the mean strain along its length.
#[derive(Debug, Clone, PartialEq)]
pub struct Gauge {
    /// \[m\] its middle, frame of the mesh; projected to the middle surface.
    pub centre: Point3<f64>,
    /// Direction along which it measures, of any length; its part in the surface counts.
    pub along: Vector3<f64>,
    /// \[m\] along that direction.
    pub length: f64,
    /// \[m\] across.
    pub width: f64,
    /// The face that it is glued to.
    pub face: Face,
}

/// A gauge's reading as a function of how the shell moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Strain of displacements \[m\] and rotations \[rad\]; as a load, its solution is the gauge's influence.
    pub row: Action,
    /// How much of the rectangle lies on material, 0 to 1. Below 1 it hangs over a hole or an edge, and the row is the
    /// mean over what there is.
    pub covered: f64,
}

/// A point of the middle surface.
pub(crate) struct Foot {
    /// \[m\].
    pub point: Point3<f64>,
    /// Unit, out of the outer side, between those of the triangle's corners.
    pub normal: Vector3<f64>,
    /// Where it lies.
    pub triangle: usize,
    /// Area coordinates of the triangle's corners.
    pub at: [f64; 3],
}

impl Foot {
    /// The point that is nearest to `p`; `None` where there is none with a normal.
    pub fn new(mesh: &ShellMesh, normals: &[Vector3<f64>], p: &Point3<f64>) -> Option<Self> {
        let mut best: Option<Self> = None;
        let mut least = f64::INFINITY;
        for (triangle, t) in mesh.triangles.iter().enumerate() {
            let corners = t.map(|n| mesh.points[n as usize]);
            let at = closest_on_triangle(&corners, p);
            let point = corners.iter().zip(at).fold(Vector3::zeros(), |sum, (q, w)| sum + q.coords * w);
            let squared_distance = (p.coords - point).norm_squared();
            if squared_distance < least {
                least = squared_distance;
                let normal =
                    t.iter().zip(at).fold(Vector3::zeros(), |sum, (n, w)| sum + normals[*n as usize] * w);
                best = Some(Self { point: point.into(), normal: normal.try_normalize(0.0)?, triangle, at });
            }
        }
        best
    }
}

/// The part of a convex polygon where `inside` is not negative; `inside` is linear.
fn clip(polygon: &[Point2<f64>], inside: impl Fn(&Point2<f64>) -> f64) -> Vec<Point2<f64>> {
    let mut out = Vec::with_capacity(polygon.len() + 1);
    for (i, a) in polygon.iter().enumerate() {
        let b = &polygon[(i + 1) % polygon.len()];
        let (da, db) = (inside(a), inside(b));
        if da >= 0.0 {
            out.push(*a);
        }
        if (da >= 0.0) != (db >= 0.0) {
            out.push(a + (b - a) * (da / (da - db)));
        }
    }
    out
}

/// Area and centre of a polygon; the area is negative where it runs clockwise.
fn area_and_centre(polygon: &[Point2<f64>]) -> (f64, Point2<f64>) {
    let Some(first) = polygon.first() else { return (0.0, Point2::origin()) };
    let (mut area, mut moment) = (0.0, Vector2::zeros());
    for pair in polygon.windows(2).skip(1) {
        let (a, b) = (pair[0] - first, pair[1] - first);
        let part = (a.x * b.y - a.y * b.x) / 2.0;
        area += part;
        moment += (a + b) * (part / 3.0);
    }
    if area == 0.0 { (0.0, *first) } else { (area, first + moment / area) }
}

/// Where a gauge's rectangle lies.
pub(crate) struct Footprint {
    /// \[m\] its middle, on the middle surface.
    pub foot: Point3<f64>,
    /// Unit, along its length.
    pub along: Vector3<f64>,
    /// Unit, along its width.
    pub across: Vector3<f64>,
    /// Unit, out of the outer side.
    pub normal: Vector3<f64>,
}

fn nothing(gauge: &Gauge) -> MechanicsError {
    MechanicsError::NoMaterial { x: gauge.centre.x, y: gauge.centre.y, z: gauge.centre.z }
}

impl Footprint {
    /// The rectangle of `gauge` on a surface with these `normals`.
    pub fn new(mesh: &ShellMesh, normals: &[Vector3<f64>], gauge: &Gauge) -> Result<Self, MechanicsError> {
        positive("length of the gauge [m]", gauge.length)?;
        positive("width of the gauge [m]", gauge.width)?;
        let length = positive("length of the gauge's direction", gauge.along.norm())?;
        let foot = Foot::new(mesh, normals, &gauge.centre).ok_or_else(|| nothing(gauge))?;
        let along = gauge.along - foot.normal * gauge.along.dot(&foot.normal);
        // One that is almost normal to the surface has no direction in it.
        let flat = along.norm() / length;
        if flat < 1e-3 {
            return Err(MechanicsError::Value {
                quantity: "part of the gauge's direction in the surface",
                value: flat,
                expected: "more than 0.001: turn the direction along the surface",
            });
        }
        let along = along.normalize();
        Ok(Self { foot: foot.point, along, across: foot.normal.cross(&along), normal: foot.normal })
    }
}

/// Which triangles a gauge reads: each one's number, and the reading of its displacements in its own frame.
pub(super) struct Pieces {
    pub rows: Vec<(usize, Row)>,
    /// How much of the rectangle lies on material.
    pub covered: f64,
}

impl Shell {
    /// What `gauge` reads: the mean over its rectangle of the strain along its length, s = (1/A) ∫ tᵀ(ε + zκ)t dA, where
    /// ε is the membrane strain and κ the curvature of the triangles' own fields and z the height of the face.
    ///
    /// The rectangle lies in the plane that touches the shell at its centre; triangles are projected to it along the normal.
    /// Strain is linear over a triangle, so that the mean over its part under the rectangle is the strain in that part's
    /// centre: the integral is exact, and smooth in the gauge's place.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] for a rectangle without a size or a direction, [`MechanicsError::NoMaterial`] where nothing
    /// lies under it.
    pub fn gauge(&self, gauge: &Gauge) -> Result<Reading, MechanicsError> {
        self.read(gauge, &self.mesh.normals())
    }

    /// The same for many.
    ///
    /// # Errors
    ///
    /// As [`Shell::gauge`], for the first that is refused.
    pub fn gauges(&self, gauges: &[Gauge]) -> Result<Vec<Reading>, MechanicsError> {
        let normals = self.mesh.normals();
        gauges.iter().map(|gauge| self.read(gauge, &normals)).collect()
    }

    fn read(&self, gauge: &Gauge, normals: &[Vector3<f64>]) -> Result<Reading, MechanicsError> {
        let pieces = Pieces::new(&self.mesh, &self.elements, normals, gauge)?;
        let mut entries = Vec::with_capacity(18 * pieces.rows.len());
        for (triangle, row) in &pieces.rows {
            let corners = &self.mesh.triangles[*triangle];
            let row = self.elements[*triangle].turn_columns(row);
            let freedom = |i: usize| FREEDOMS * corners[i / FREEDOMS] as usize + i % FREEDOMS;
            entries.extend(row.iter().enumerate().map(|(i, value)| (freedom(i), *value)));
        }
        Ok(Reading { row: Action::new(entries), covered: pieces.covered })
    }
}

impl Pieces {
    pub fn new(
        mesh: &ShellMesh,
        elements: &[Element],
        normals: &[Vector3<f64>],
        gauge: &Gauge,
    ) -> Result<Self, MechanicsError> {
        let footprint = Footprint::new(mesh, normals, gauge)?;
        let Footprint { foot, along, across, normal } = footprint;
        let (half_length, half_width) = (gauge.length / 2.0, gauge.width / 2.0);
        let reach = half_length.hypot(half_width);
        let whole = gauge.length * gauge.width;

        let mut rows = Vec::new();
        let mut covered = 0.0;
        for (triangle, (element, t)) in elements.iter().zip(&mesh.triangles).enumerate() {
            let corners = t.map(|n| {
                let from = mesh.points[n as usize] - foot;
                (Point2::new(from.dot(&along), from.dot(&across)), from.dot(&normal))
            });
            let [a, b, c] = corners.map(|(p, _)| p);
            let beside = |low: f64, high: f64, half: f64| high < -half || low > half;
            if beside(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x), half_length)
                || beside(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), half_width)
                // The other side of a limb.
                || corners.iter().all(|(_, height)| height.abs() > reach)
                || element.local_from_link.row(2).transpose().dot(&normal) < FACING
            {
                continue;
            }
            let mut part = vec![a, b, c];
            part = clip(&part, |p| half_length - p.x);
            part = clip(&part, |p| half_length + p.x);
            part = clip(&part, |p| half_width - p.y);
            part = clip(&part, |p| half_width + p.y);
            let (area, centre) = area_and_centre(&part);
            if area <= 0.0 {
                continue;
            }
            let Some(inverse) = Matrix2::from_columns(&[b - a, c - a]).try_inverse() else { continue };
            let at = inverse * (centre - a);
            let height = gauge.face.height() * element.thickness;
            let Some(row) = element.strain_along(&along, [1.0 - at.x - at.y, at.x, at.y], height) else {
                continue;
            };
            covered += area;
            rows.push((triangle, row * area));
        }
        if covered < 1e-6 * whole {
            return Err(nothing(gauge));
        }
        for (_, row) in &mut rows {
            *row /= covered;
        }
        Ok(Self { rows, covered: covered / whole })
    }
}
