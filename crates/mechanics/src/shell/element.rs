//! The flat triangle: bending by discrete Kirchhoff or Mindlin theory, membrane with drilling rotations.
//!
//! - Bending without shear across the thickness: DKT. J.-L. Batoz, K.-J. Bathe, L.-W. Ho, *A study of three-node triangular
//!   plate bending elements*, Int. J. Numer. Meth. Engng 15 (1980) 1771-1812.
//! - Bending with it: DKMT. I. Katili, *A new discrete Kirchhoff-Mindlin element based on Mindlin-Reissner plate theory and
//!   assumed shear strain fields, part I: an extended DKT element for thick-plate bending analysis*, Int. J. Numer. Meth. Engng
//!   36 (1993) 1859-1883. It is DKT where the thickness is small against the sides, and does not lock.
//! - Membrane: the optimal triangle of the ANDES template. C. A. Felippa, *A study of optimal membrane triangles with
//!   drilling freedoms*, Comput. Methods Appl. Mech. Engrg. 192 (2003) 2125-2168.
//!
//! Both are written as strains that are linear over the triangle, so that the strain which a gauge reads and the strain
//! whose energy is the stiffness are the same.

use nalgebra::{Matrix3, Point3, RowSVector, RowVector3, SMatrix, Vector3};

use super::{PlateTheory, Section};
use crate::MechanicsError;

/// Strains (ε_x, ε_y, γ_xy) or curvatures of the 18 displacements of a triangle.
pub(super) type Strains = SMatrix<f64, 3, 18>;
/// A triangle's stiffness.
pub(super) type Stiffness = SMatrix<f64, 18, 18>;
/// One number as a linear function of a triangle's displacements.
pub(super) type Row = RowSVector<f64, 18>;

/// Middles of the sides: a rule that is exact for squares of linear strains.
const MIDDLES: [[f64; 3]; 3] = [[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]];
/// Share of the thickness that carries a shear force: E. Reissner's 5/6 for stress that is a parabola over the thickness.
const SHEAR_CORRECTION: f64 = 5.0 / 6.0;
/// Lumping of the drilling rotations into the mean strain (α_b).
const LUMPING: f64 = 1.5;
/// The optimal triangle's natural strains of the corners' rotations (β₁ … β₉).
const BETA: [f64; 9] = [1.0, 2.0, 1.0, 0.0, 1.0, -1.0, -1.0, -1.0, -2.0];

/// Freedoms of a corner in the triangle's frame.
const W: usize = 2;
const ROTATION: usize = 3;

/// A triangle in its own frame: x along the side from the first to the second corner, z its normal. A corner has three
/// displacements \[m\] and three rotations \[rad\].
#[derive(Debug, Clone)]
pub(super) struct Element {
    /// Rows are the triangle's axes in the frame of the mesh.
    pub local_from_link: Matrix3<f64>,
    /// \[m\] of the corners; the first is the origin.
    pub corners: [[f64; 2]; 3],
    /// \[m²\].
    pub area: f64,
    /// \[m\].
    pub thickness: f64,
    /// \[Pa\] stress of strain.
    elasticity: Matrix3<f64>,
    /// From each corner to the next.
    sides: [Side; 3],
    /// \[N/m\] shear force over shear strain across the thickness; `None` where normals stay normal.
    shear_stiffness: Option<f64>,
    /// Mean membrane strain.
    mean: Strains,
    /// Membrane strain that varies: one term for each area coordinate.
    varying: [Strains; 3],
}

/// A side of a triangle.
#[derive(Debug, Clone)]
struct Side {
    /// Corners.
    from: usize,
    to: usize,
    /// Unit, from one to the other.
    along: [f64; 2],
    /// \[m\].
    length: f64,
    /// Stiffness in bending over that in shear, Katili's φ = 12 D / (κ G h L²); 0 in Kirchhoff's theory.
    shear: f64,
}

impl Side {
    /// The three sides of a triangle whose shear stiffness \[N/m\] is `shear`.
    fn around(
        corners: &[[f64; 2]; 3],
        elasticity: &Matrix3<f64>,
        thickness: f64,
        shear: Option<f64>,
    ) -> [Self; 3] {
        [0, 1, 2].map(|from| {
            let to = (from + 1) % 3;
            let (x, y) = (corners[to][0] - corners[from][0], corners[to][1] - corners[from][1]);
            let length = x.hypot(y);
            let (c, s) = (x / length, y / length);
            // Stress along the side of a strain along it alone.
            let strain = Vector3::new(c * c, s * s, 2.0 * c * s);
            let bending = strain.dot(&(elasticity * strain)) * thickness.powi(3);
            let shear = shear.map_or(0.0, |shear| bending / (shear * length * length));
            Self { from, to, along: [c, s], length, shear }
        })
    }
}

/// Stress of strain \[Pa\] in the triangle's frame, and ν² as the optimal triangle needs it.
fn elasticity(section: &Section, local_from_link: &Matrix3<f64>) -> Option<(Matrix3<f64>, f64)> {
    let (young, poisson) = (section.young_modulus, section.poisson_ratio);
    let Some(print) = &section.orthotropy else {
        let plane = young / (1.0 - poisson * poisson);
        let shear = section.shear_modulus();
        let matrix = Matrix3::new(plane, plane * poisson, 0.0, plane * poisson, plane, 0.0, 0.0, 0.0, shear);
        return Some((matrix, poisson * poisson));
    };
    let along = local_from_link * print.direction;
    let length = along.xy().norm();
    if length < 1e-6 * print.direction.norm() {
        return None;
    }
    let (c, s) = (along.x / length, along.y / length);
    let across = young * print.ratio;
    // ν₁₂ ν₂₁.
    let poisson_squared = poisson * poisson * print.ratio;
    let unit = 1.0 - poisson_squared;
    let mixed = poisson * across / unit;
    let shear = section.shear_modulus();
    let own = Matrix3::new(young / unit, mixed, 0.0, mixed, across / unit, 0.0, 0.0, 0.0, shear);
    // Strain in the axes of the material from that in the triangle's.
    let turn =
        Matrix3::new(c * c, s * s, c * s, s * s, c * c, -c * s, -2.0 * c * s, 2.0 * c * s, c * c - s * s);
    Some((turn.transpose() * own * turn, poisson_squared))
}

impl Element {
    /// A triangle between `points` \[m\], counter-clockwise seen from its outer side.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Triangle`] where it has no area, or the direction of its material is normal to it.
    pub fn new(index: usize, points: [Point3<f64>; 3], section: &Section) -> Result<Self, MechanicsError> {
        let wrong = |what| MechanicsError::Triangle { triangle: index, what };
        let [p1, p2, p3] = points;
        let normal = (p2 - p1).cross(&(p3 - p1));
        let longest = (p2 - p1).norm().max((p3 - p2).norm()).max((p1 - p3).norm());
        let tall = normal.norm() > 1e-6 * longest * longest;
        if !(tall && normal.norm().is_finite()) {
            return Err(wrong("has no area"));
        }
        let (e1, e3) = ((p2 - p1).normalize(), normal.normalize());
        let e2 = e3.cross(&e1);
        let local_from_link = Matrix3::from_rows(&[e1.transpose(), e2.transpose(), e3.transpose()]);
        let corners = points.map(|p| [(p - p1).dot(&e1), (p - p1).dot(&e2)]);
        let (elasticity, poisson_squared) = elasticity(section, &local_from_link)
            .ok_or(wrong("is normal to the direction of its material"))?;
        let area = normal.norm() / 2.0;
        let (mean, varying) = membrane(&corners, area, poisson_squared);
        let thickness = section.thickness;
        let shear_stiffness = match section.theory {
            PlateTheory::KirchhoffLove => None,
            PlateTheory::ReissnerMindlin => Some(SHEAR_CORRECTION * section.shear_modulus() * thickness),
        };
        let sides = Side::around(&corners, &elasticity, thickness, shear_stiffness);
        Ok(Self {
            local_from_link,
            corners,
            area,
            thickness,
            elasticity,
            sides,
            shear_stiffness,
            mean,
            varying,
        })
    }

    /// Strain of the middle surface at area coordinates `at`.
    pub fn membrane(&self, at: [f64; 3]) -> Strains {
        self.mean + self.varying[0] * at[0] + self.varying[1] * at[1] + self.varying[2] * at[2]
    }

    /// By how much the rotation of the normal in the middle of each side, along that side, exceeds the mean of its ends: Katili's
    /// Δβ. It makes the mean shear strain along the side the one that the side's own bending asks for.
    fn side_rotations(&self) -> [Row; 3] {
        self.sides.each_ref().map(|side| {
            let [c, s] = side.along;
            let mut row = Row::zeros();
            for (corner, sign) in [(side.from, -1.0), (side.to, 1.0)] {
                row[6 * corner + W] = sign;
                // Rotations of the normal, β_x = θ_y and β_y = −θ_x.
                row[6 * corner + ROTATION] = -s * side.length / 2.0;
                row[6 * corner + ROTATION + 1] = c * side.length / 2.0;
            }
            row * (-1.5 / (side.length * (1.0 + side.shear)))
        })
    }

    /// Slopes of the area coordinates along x and y \[1/m\].
    fn slopes(&self) -> [[f64; 2]; 3] {
        let corner = |i: usize| self.corners[i % 3];
        [0, 1, 2].map(|i| {
            let ([xj, yj], [xm, ym]) = (corner(i + 1), corner(i + 2));
            [(yj - ym) / (2.0 * self.area), (xm - xj) / (2.0 * self.area)]
        })
    }

    /// Curvature \[1/m\] at area coordinates `at`: strain a metre along the normal.
    pub fn bending(&self, at: [f64; 3]) -> Strains {
        let slopes = self.slopes();
        let mut b = Strains::zeros();
        for (corner, [x, y]) in slopes.into_iter().enumerate() {
            let (theta_x, theta_y) = (6 * corner + ROTATION, 6 * corner + ROTATION + 1);
            b[(0, theta_y)] = x;
            b[(1, theta_x)] = -y;
            b[(2, theta_y)] = y;
            b[(2, theta_x)] = -x;
        }
        for (side, row) in self.sides.iter().zip(self.side_rotations()) {
            // Slopes of 4 L_i L_j, which is 1 in the middle of the side and 0 on the others.
            let [x, y] = [0, 1]
                .map(|k| 4.0 * (slopes[side.from][k] * at[side.to] + slopes[side.to][k] * at[side.from]));
            let [c, s] = side.along;
            b += Vector3::new(x * c, y * s, y * c + x * s) * row;
        }
        b
    }

    /// Shear strain across the thickness (γ_xz, γ_yz) at area coordinates `at`: linear, and along each side the one that
    /// belongs to its rotation. None in Kirchhoff's theory.
    fn shear(&self, at: [f64; 3]) -> SMatrix<f64, 2, 18> {
        let along_side: [Row; 3] = {
            let rotations = self.side_rotations();
            std::array::from_fn(|k| rotations[k] * (-2.0 / 3.0 * self.sides[k].shear))
        };
        let mut out = SMatrix::<f64, 2, 18>::zeros();
        for (corner, share) in at.into_iter().enumerate() {
            // Sides that leave this corner and that arrive at it, going round.
            let (after, before) = (corner, (corner + 2) % 3);
            let ([ca, sa], [cb, sb]) = (self.sides[after].along, self.sides[before].along);
            let turn = ca * sb - sa * cb;
            let (a, b) = (along_side[after] * (share / turn), along_side[before] * (share / turn));
            let mut x = out.row_mut(0);
            x += a * sb - b * sa;
            let mut y = out.row_mut(1);
            y += b * ca - a * cb;
        }
        out
    }

    /// Stiffness in the triangle's frame.
    pub fn stiffness(&self) -> Stiffness {
        let h = self.thickness;
        let mut k = Stiffness::zeros();
        for at in MIDDLES {
            let (m, b) = (self.membrane(at), self.bending(at));
            let weight = self.area / 3.0;
            k += m.transpose() * (self.elasticity * (h * weight)) * m;
            k += b.transpose() * (self.elasticity * (h * h * h / 12.0 * weight)) * b;
            if let Some(shear) = self.shear_stiffness {
                let g = self.shear(at);
                k += g.transpose() * g * (shear * weight);
            }
        }
        // Exactly, so that it is factored as what it is.
        (k + k.transpose()) / 2.0
    }

    /// The same in the frame of the mesh.
    pub fn stiffness_in_link(&self) -> Stiffness {
        let turned = self.turn_columns(&self.stiffness());
        self.turn_columns(&turned.transpose())
    }

    /// Strain along `direction` (frame of the mesh; its part in the triangle's plane counts) at area coordinates `at`, at
    /// `height` \[m\] over the middle surface, of displacements in the triangle's frame. `None` where `direction` is normal to
    /// the triangle.
    pub fn strain_along(&self, direction: &Vector3<f64>, at: [f64; 3], height: f64) -> Option<Row> {
        let along = self.local_from_link * direction;
        let length = along.xy().norm();
        if length < 1e-6 * direction.norm() || length == 0.0 {
            return None;
        }
        let (c, s) = (along.x / length, along.y / length);
        let strains = self.membrane(at) + self.bending(at) * height;
        Some(RowVector3::new(c * c, s * s, c * s) * strains)
    }

    /// From displacements in the triangle's frame to those in the frame of the mesh.
    pub fn turn_columns<const R: usize>(&self, of_local: &SMatrix<f64, R, 18>) -> SMatrix<f64, R, 18> {
        let mut out = SMatrix::<f64, R, 18>::zeros();
        for block in 0..6 {
            let part = of_local.fixed_columns::<3>(3 * block) * self.local_from_link;
            out.fixed_columns_mut::<3>(3 * block).copy_from(&part);
        }
        out
    }
}

/// The mean membrane strain and the varying one for each area coordinate.
fn membrane(corners: &[[f64; 2]; 3], area: f64, poisson_squared: f64) -> (Strains, [Strains; 3]) {
    let x = |i: usize, j: usize| corners[i - 1][0] - corners[j - 1][0];
    let y = |i: usize, j: usize| corners[i - 1][1] - corners[j - 1][1];
    let mut mean = Strains::zeros();
    for (k, [i, j, m]) in [[1, 2, 3], [2, 3, 1], [3, 1, 2]].into_iter().enumerate() {
        let (b, c) = (y(j, m), x(m, j));
        let column = 6 * k;
        mean[(0, column)] = b;
        mean[(2, column)] = c;
        mean[(1, column + 1)] = c;
        mean[(2, column + 1)] = b;
        let drill = LUMPING / 6.0;
        mean[(0, column + 5)] = drill * b * (y(i, m) - y(j, i));
        mean[(1, column + 5)] = drill * c * (x(m, i) - x(i, j));
        mean[(2, column + 5)] = 2.0 * drill * (x(m, i) * y(i, m) - x(i, j) * y(j, i));
    }
    mean /= 2.0 * area;

    // Rotations of the corners beyond that of the whole triangle.
    let mut beyond = Strains::zeros();
    for row in 0..3 {
        for (k, [j, m]) in [[2, 3], [3, 1], [1, 2]].into_iter().enumerate() {
            beyond[(row, 6 * k)] = x(m, j) / (4.0 * area);
            beyond[(row, 6 * k + 1)] = y(m, j) / (4.0 * area);
        }
        beyond[(row, 6 * row + 5)] = 1.0;
    }
    let square = |i: usize, j: usize| x(i, j) * x(i, j) + y(i, j) * y(i, j);
    let [l21, l32, l13] = [square(2, 1), square(3, 2), square(1, 3)];
    let cartesian = Matrix3::new(
        y(2, 3) * y(1, 3) * l21,
        y(3, 1) * y(2, 1) * l32,
        y(1, 2) * y(3, 2) * l13,
        x(2, 3) * x(1, 3) * l21,
        x(3, 1) * x(2, 1) * l32,
        x(1, 2) * x(3, 2) * l13,
        (y(2, 3) * x(3, 1) + x(3, 2) * y(1, 3)) * l21,
        (y(3, 1) * x(1, 2) + x(1, 3) * y(2, 1)) * l32,
        (y(1, 2) * x(2, 3) + x(2, 1) * y(3, 2)) * l13,
    ) / (4.0 * area * area);
    let natural = |order: [usize; 9]| {
        let beta = |k: usize| BETA[order[k] - 1];
        Matrix3::new(
            beta(0) / l21,
            beta(1) / l21,
            beta(2) / l21,
            beta(3) / l32,
            beta(4) / l32,
            beta(5) / l32,
            beta(6) / l13,
            beta(7) / l13,
            beta(8) / l13,
        ) * (2.0 * area / 3.0)
    };
    let strength = 1.5 * ((1.0 - 4.0 * poisson_squared) / 2.0).max(0.01).sqrt();
    let orders = [[1, 2, 3, 4, 5, 6, 7, 8, 9], [9, 7, 8, 3, 1, 2, 6, 4, 5], [5, 6, 4, 8, 9, 7, 2, 3, 1]];
    (mean, orders.map(|order| cartesian * natural(order) * beyond * strength))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn element(section: &Section) -> (Element, [Point3<f64>; 3]) {
        let points = [Point3::new(0.1, 0.2, -0.3), Point3::new(1.3, 0.1, 0.2), Point3::new(0.4, 1.1, 0.5)];
        (Element::new(0, points, section).unwrap(), points)
    }

    fn sections() -> [Section; 2] {
        let plain = Section::isotropic(1.0, 0.3, 0.1);
        let orthotropy = Some(super::super::Orthotropy { ratio: 0.7, direction: Vector3::x() });
        [plain.clone(), Section { orthotropy, ..plain }]
    }

    const THEORIES: [PlateTheory; 2] = [PlateTheory::KirchhoffLove, PlateTheory::ReissnerMindlin];

    /// φ falls with the square of the thickness, and DKMT becomes DKT.
    #[test]
    fn a_thin_triangle_bends_the_same_by_both_theories() {
        for section in sections() {
            let of = |thickness: f64| {
                let section = Section { thickness, ..section.clone() };
                let [thin, shearing] = THEORIES.map(|theory| element(&section.clone().by(theory)).0);
                let at = [0.2, 0.5, 0.3];
                (shearing.bending(at) - thin.bending(at)).norm() / thin.bending(at).norm()
            };
            let (thick, thinner) = (of(0.2), of(0.02));
            assert!(thick > 0.01, "{thick}");
            assert!((thick / thinner / 100.0 - 1.0).abs() < 0.15, "{thick} {thinner}");
        }
    }

    /// Bent to a parabola, a plate does not shear, and has the same energy by both theories.
    #[test]
    fn constant_curvature_does_not_shear() {
        let points = [Point3::new(0.1, 0.2, 0.0), Point3::new(1.3, 0.1, 0.0), Point3::new(0.4, 1.1, 0.0)];
        let (a, b, c) = (0.7, -0.3, 0.4);
        let mut u = nalgebra::SVector::<f64, 18>::zeros();
        for (n, p) in points.iter().enumerate() {
            u[6 * n + 2] = a * p.x * p.x + b * p.y * p.y + c * p.x * p.y;
            // θ_x = ∂w/∂y, θ_y = −∂w/∂x.
            u[6 * n + 3] = 2.0 * b * p.y + c * p.x;
            u[6 * n + 4] = -2.0 * a * p.x - c * p.y;
        }
        let energies = THEORIES.map(|theory| {
            let section = sections()[0].clone().by(theory);
            let element = Element::new(0, points, &section).unwrap();
            // To the triangle's frame, of which every block is a vector.
            let mut own = u;
            for block in 0..6 {
                let part = element.local_from_link * u.fixed_rows::<3>(3 * block);
                own.fixed_rows_mut::<3>(3 * block).copy_from(&part);
            }
            assert!((element.shear([0.3, 0.3, 0.4]) * own).norm() < 1e-12);
            (element.stiffness() * own).dot(&own)
        });
        assert!((energies[0] / energies[1] - 1.0).abs() < 1e-12, "{energies:?}");
    }

    #[test]
    fn stiffness_knows_six_rigid_motions_and_no_other() {
        for section in sections().into_iter().flat_map(|s| THEORIES.map(|theory| s.clone().by(theory))) {
            let (element, points) = element(&section);
            let k = element.stiffness_in_link();
            for motion in 0..6 {
                let mut u = nalgebra::SVector::<f64, 18>::zeros();
                for (n, p) in points.iter().enumerate() {
                    let mut part = Vector3::zeros();
                    if motion < 3 {
                        part[motion] = 1.0;
                    } else {
                        let mut turn = Vector3::zeros();
                        turn[motion - 3] = 1.0;
                        part = turn.cross(&p.coords);
                        u[6 * n + motion] = 1.0;
                    }
                    u.fixed_rows_mut::<3>(6 * n).copy_from(&part);
                }
                assert!((k * u).norm() < 1e-12, "motion {motion}: {}", (k * u).norm());
            }
            let values = k.symmetric_eigenvalues();
            let zero = values.iter().filter(|v| v.abs() < 1e-12).count();
            assert_eq!(zero, 6, "{values}");
            assert!(values.iter().all(|v| *v > -1e-12));
            assert!((k - k.transpose()).norm() < 1e-15);
        }
    }

    #[test]
    fn strain_that_varies_has_no_mean() {
        let (element, _) = element(&sections()[0]);
        let sum = element.varying[0] + element.varying[1] + element.varying[2];
        assert!(sum.norm() < 1e-12 * element.varying[0].norm());
    }

    #[test]
    fn a_material_as_stiff_across_as_along_is_isotropic() {
        let [plain, mut print] = sections();
        if let Some(o) = &mut print.orthotropy {
            o.ratio = 1.0;
        }
        let difference = element(&plain).0.stiffness() - element(&print).0.stiffness();
        assert!(difference.norm() < 1e-14);
    }

    #[test]
    fn refuses_a_triangle_without_area() {
        let points = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(2.0, 0.0, 0.0)];
        let error = Element::new(7, points, &sections()[0]).unwrap_err();
        assert_eq!(error.to_string(), "triangle 7 of the shell has no area");
    }
}
