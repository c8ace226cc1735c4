//! A flat rectangular facet of a shell that shears across its thickness: Katili's plate and Pian and Sumihara's membrane.
//!
//! - Bending and shear: DKMQ. I. Katili, *A new discrete Kirchhoff-Mindlin element based on Mindlin-Reissner plate theory and assumed
//!   shear strain fields, part II: an extended DKQ element for thick-plate bending analysis*, Int. J. Numer. Meth. Engng 36 (1993)
//!   1885-1908. Normals turn bilinearly, and by a parabola along each side, whose height is the one with which the side's own
//!   bending balances its shear. Shear strains vary linearly between opposite sides, so that thin facets do not lock.
//! - Turns about the normal: T. J. R. Hughes, F. Brezzi, *On drilling degrees of freedom*, Comput. Methods Appl. Mech. Engrg. 72
//!   (1989) 105-121, in one point. Where facets meet at an angle, they carry the twist of one into the plane of the other. With springs
//!   in their place, strains grow without end as the mesh becomes finer (N. F. Knight, *Raasch challenge for shell elements*, AIAA
//!   J. 35 (1997) 375-381).
//! - Membrane: T. H. H. Pian, K. Sumihara, *Rational approach for assumed stress finite elements*, Int. J. Numer. Meth. Engng 20
//!   (1984) 1685-1695.
//!
//! Corners in order (0, 0), (a, 0), (a, b), (0, b); at each u, v, w, rotations about the local axes x, y, z. Strains are those of
//! the middle, positive where it stretches; curvatures are the slopes of the normals' turns β = (θ_y, -θ_x), so that a strain at
//! height z is that of the middle plus z times them.

use nalgebra::{Matrix3, RowSVector, SMatrix};

/// Stiffness of a facet, in its own axes.
pub(super) type Stiffness = SMatrix<f64, 24, 24>;
/// From displacements of a facet's corners to three strains.
pub(super) type Strains = SMatrix<f64, 3, 24>;

/// An orthotropic material in plane stress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Material {
    /// \[Pa\] along x and y.
    pub young: [f64; 2],
    /// Poisson's ratio of a pull along x.
    pub poisson: f64,
}

impl Material {
    /// From strains to stresses.
    pub fn stress(&self) -> Matrix3<f64> {
        let [along, across] = self.young;
        let back = self.poisson * across / along;
        let d = 1.0 - self.poisson * back;
        // Huber's shear modulus.
        let shear = (along * across).sqrt() / (2.0 * (1.0 + (self.poisson * back).sqrt()));
        Matrix3::new(
            along / d,
            self.poisson * across / d,
            0.0,
            self.poisson * across / d,
            across / d,
            0.0,
            0.0,
            0.0,
            shear,
        )
    }
}

/// A rectangle with sides `a` and `b` \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Facet {
    pub a: f64,
    pub b: f64,
}

const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];
/// Signs of the corners along both axes.
const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
/// A side of a facet.
struct SideOf {
    /// Corners at its ends, in the direction of its axis.
    ends: [usize; 2],
    /// Along x or y.
    axis: usize,
    /// Natural coordinate of the other axis on it.
    across: f64,
}

const SIDES: [SideOf; 4] = [
    SideOf { ends: [0, 1], axis: 0, across: -1.0 },
    SideOf { ends: [3, 2], axis: 0, across: 1.0 },
    SideOf { ends: [0, 3], axis: 1, across: -1.0 },
    SideOf { ends: [1, 2], axis: 1, across: 1.0 },
];
/// Share of the thickness that carries a shear force (E. Reissner).
const SHEAR_CORRECTION: f64 = 5.0 / 6.0;

/// One number as a sum over the displacements.
type Row = RowSVector<f64, 24>;

/// What a facet is made of, and how thick it is \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wall<'a> {
    pub material: &'a Material,
    pub thickness: f64,
}

impl Facet {
    /// The mean shear strain across the thickness along each side as its corners alone say it.
    fn side_shear(&self) -> [Row; 4] {
        SIDES.map(|SideOf { ends: [from, to], axis, .. }| {
            let mut row = Row::zeros();
            for (corner, sign) in [(from, -1.0), (to, 1.0)] {
                row[6 * corner + 2] = sign / [self.a, self.b][axis];
                // Half the turn of the normal along the side: θ_y along x, -θ_x along y.
                row[6 * corner + 4 - axis] = if axis == 0 { 0.5 } else { -0.5 };
            }
            row
        })
    }

    /// A side's stiffness in bending over that in shear, 12 D / (κ G h L²), along x and y.
    fn sheared(&self, wall: Wall<'_>) -> [f64; 2] {
        let stress = wall.material.stress();
        let bending = |axis: usize| stress[(axis, axis)] * wall.thickness.powi(3);
        let shear = SHEAR_CORRECTION * stress[(2, 2)] * wall.thickness;
        [bending(0) / (shear * self.a * self.a), bending(1) / (shear * self.b * self.b)]
    }

    /// Curvatures at natural coordinates, of all displacements.
    fn curvature(&self, wall: Wall<'_>, xi: f64, eta: f64) -> Strains {
        let (sx, sy) = (2.0 / self.a, 2.0 / self.b);
        let mut all = Strains::zeros();
        for (corner, [x, y]) in CORNERS.into_iter().enumerate() {
            let dx = x * (1.0 + y * eta) / 4.0 * sx;
            let dy = y * (1.0 + x * xi) / 4.0 * sy;
            let [turn_x, turn_y] = [6 * corner + 4, 6 * corner + 3];
            all[(0, turn_x)] += dx;
            all[(2, turn_x)] += dy;
            all[(1, turn_y)] -= dy;
            all[(2, turn_y)] -= dx;
        }
        let sheared = self.sheared(wall);
        for (SideOf { axis, across: away, .. }, row) in SIDES.into_iter().zip(self.side_shear()) {
            let height = row * (-1.5 / (1.0 + sheared[axis]));
            let (along, across) = if axis == 0 { (xi, eta) } else { (eta, xi) };
            let (s, t) = if axis == 0 { (sx, sy) } else { (sy, sx) };
            // The parabola (1 - along²), which fades to the opposite side.
            let slope = height * (-2.0 * along * s * (1.0 + away * across) / 2.0);
            let fading = height * ((1.0 - along * along) * away / 2.0 * t);
            for c in 0..24 {
                all[(axis, c)] += slope[c];
                all[(2, c)] += fading[c];
            }
        }
        all
    }

    /// Shear strains across the thickness along x and y at natural coordinates.
    fn shear(&self, wall: Wall<'_>, xi: f64, eta: f64) -> SMatrix<f64, 2, 24> {
        let sheared = self.sheared(wall);
        let mut all = SMatrix::<f64, 2, 24>::zeros();
        for (SideOf { axis, across: away, .. }, row) in SIDES.into_iter().zip(self.side_shear()) {
            let weight = (1.0 + away * [eta, xi][axis]) / 2.0 * sheared[axis] / (1.0 + sheared[axis]);
            all.set_row(axis, &(all.row(axis) + row * weight));
        }
        all
    }

    /// Strains of the middle as the displacements alone say them.
    fn stretch(&self, xi: f64, eta: f64) -> Strains {
        let mut all = Strains::zeros();
        for (corner, [x, y]) in CORNERS.into_iter().enumerate() {
            let dx = x * (1.0 + y * eta) / 4.0 * 2.0 / self.a;
            let dy = y * (1.0 + x * xi) / 4.0 * 2.0 / self.b;
            all[(0, 6 * corner)] = dx;
            all[(1, 6 * corner + 1)] = dy;
            all[(2, 6 * corner)] = dy;
            all[(2, 6 * corner + 1)] = dx;
        }
        all
    }

    /// By how much the corners' mean turn about the normal exceeds that of the middle of the facet in its plane.
    fn spin(&self) -> Row {
        let mut row = Row::zeros();
        for (corner, [x, y]) in CORNERS.into_iter().enumerate() {
            row[6 * corner] = y / (4.0 * self.b);
            row[6 * corner + 1] = -x / (4.0 * self.a);
            row[6 * corner + 5] = 0.25;
        }
        row
    }

    /// From displacements to the five coefficients of Pian and Sumihara's stresses.
    fn hybrid(&self, material: &Material) -> (SMatrix<f64, 5, 5>, SMatrix<f64, 5, 24>) {
        let compliance = material.stress().try_inverse().unwrap_or_else(Matrix3::zeros);
        let (mut h, mut g) = (SMatrix::<f64, 5, 5>::zeros(), SMatrix::<f64, 5, 24>::zeros());
        for (xi, wx) in GAUSS {
            for (eta, wy) in GAUSS {
                let weight = wx * wy * self.a * self.b / 4.0;
                let p = stresses(xi, eta);
                h += p.transpose() * compliance * p * weight;
                g += p.transpose() * self.stretch(xi, eta) * weight;
            }
        }
        (h.try_inverse().unwrap_or_else(SMatrix::zeros), g)
    }

    /// Stiffness of a wall.
    pub fn stiffness(&self, wall: Wall<'_>) -> Stiffness {
        let Wall { material, thickness } = wall;
        let stress = material.stress();
        let bending = stress * (thickness.powi(3) / 12.0);
        let shearing = SHEAR_CORRECTION * stress[(2, 2)] * thickness;
        let mut k = Stiffness::zeros();
        for (xi, wx) in GAUSS {
            for (eta, wy) in GAUSS {
                let weight = wx * wy * self.a * self.b / 4.0;
                let b = self.curvature(wall, xi, eta);
                k += b.transpose() * bending * b * weight;
                let s = self.shear(wall, xi, eta);
                k += s.transpose() * s * (shearing * weight);
            }
        }
        let (h, g) = self.hybrid(material);
        k += g.transpose() * h * g * thickness;
        let spin = self.spin();
        k += spin.transpose() * spin * (stress[(2, 2)] * thickness * self.a * self.b);
        // What corners turn against each other about the normal has no stiffness; a little keeps the system regular.
        let spring = 1e-4 * stress[(2, 2)] * thickness * self.a * self.b;
        for i in 0..4 {
            for j in 0..4 {
                k[(6 * i + 5, 6 * j + 5)] += spring * if i == j { 0.75 } else { -0.25 };
            }
        }
        k
    }

    /// Strains at height `z` \[m\] over the middle, at natural coordinates.
    pub fn strains(&self, wall: Wall<'_>, (xi, eta): (f64, f64), z: f64) -> Strains {
        let (h, g) = self.hybrid(wall.material);
        let compliance = wall.material.stress().try_inverse().unwrap_or_else(Matrix3::zeros);
        let middle = compliance * stresses(xi, eta) * h * g;
        middle + self.curvature(wall, xi, eta) * z
    }

    /// Shares of the corners of a load at natural coordinates.
    pub fn shares((xi, eta): (f64, f64)) -> [f64; 4] {
        CORNERS.map(|[x, y]| (1.0 + x * xi) * (1.0 + y * eta) / 4.0)
    }
}

fn stresses(xi: f64, eta: f64) -> SMatrix<f64, 3, 5> {
    SMatrix::<f64, 3, 5>::from_row_slice(&[
        1.0, 0.0, 0.0, eta, 0.0, //
        0.0, 1.0, 0.0, 0.0, xi, //
        0.0, 0.0, 1.0, 0.0, 0.0,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Displacement of the free end of a strip of `n` rows of `m` facets beside each other, each row turned by `turn` \[rad\] about x
    /// against the one before, clamped where it begins, under 1 N along an axis of the first row.
    fn end(facet: Facet, wall: Wall<'_>, [m, n]: [usize; 2], turn: f64, axis: usize) -> f64 {
        let k = facet.stiffness(wall);
        let (row, free) = (6 * (m + 1), 6 * (m + 1) * n);
        let mut system = nalgebra::DMatrix::<f64>::zeros(free + row, free + row);
        for (i, j) in (0..n).flat_map(|i| (0..m).map(move |j| (i, j))) {
            let (sin, cos) = ((i as f64 + 0.5) * turn).sin_cos();
            let axes = Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos);
            let first = i * (m + 1) + j;
            let nodes = [first, first + 1, first + m + 2, first + m + 1];
            for (p, q) in (0..8).flat_map(|p| (0..8).map(move |q| (p, q))) {
                let block: Matrix3<f64> = k.fixed_view::<3, 3>(3 * p, 3 * q).into_owned();
                let at = |p: usize| 6 * nodes[p / 2] + 3 * (p % 2);
                let mut sum = system.fixed_view_mut::<3, 3>(at(p), at(q));
                sum += axes.transpose() * block * axes;
            }
        }
        let system = system.view((row, row), (free, free)).into_owned();
        // Evenly over the end's nodes, of which the outer two have half.
        let mut load = nalgebra::DVector::<f64>::zeros(free);
        for j in 0..=m {
            load[free - row + 6 * j + axis] = if j == 0 || j == m { 0.5 } else { 1.0 } / m as f64;
        }
        system.cholesky().unwrap().solve(&load).dot(&load)
    }

    #[test]
    fn a_short_strip_shears_as_timoshenko_says() {
        // Six thicknesses long, without Poisson's effect: F L³ / 3 E I + F L / κ G A.
        let (t, width, length) = (0.002, 0.002, 0.012);
        let material = Material { young: [1e9, 1e9], poisson: 0.0 };
        let wall = Wall { material: &material, thickness: t };
        let bent = end(Facet { a: width, b: length / 6.0 }, wall, [1, 6], 0.0, 2);
        let bending = length.powi(3) / (3.0 * 1e9 * width * f64::powi(t, 3) / 12.0);
        let shearing = length / (SHEAR_CORRECTION * 0.5e9 * width * t);
        approx::assert_relative_eq!(bent, bending + shearing, max_relative = 2e-3);
        assert!(shearing > 0.015 * bending, "so thick a strip shows no shear");
    }

    #[test]
    fn a_curved_strip_twists_as_saint_venant_says() {
        // A quarter of a ring that is pushed out of its plane: F R³ (π / 4 E I + (3 π - 8) / 4 G J), and shear in its plane.
        let (t, width, radius) = (0.002, 0.008, 0.045);
        let material = Material { young: [1e9, 1e9], poisson: 0.0 };
        let wall = Wall { material: &material, thickness: t };
        let pushed = |[m, n]: [usize; 2]| {
            let turn = std::f64::consts::FRAC_PI_2 / n as f64;
            let facet = Facet { a: width / m as f64, b: 2.0 * radius * (turn / 2.0).sin() };
            end(facet, wall, [m, n], turn, 0)
        };
        let pi = std::f64::consts::PI;
        let i = t * f64::powi(width, 3) / 12.0;
        let j = width * f64::powi(t, 3) / 3.0 * (1.0 - 0.63 * t / width);
        let ring = radius.powi(3) * (pi / 4.0 / (1e9 * i) + (3.0 * pi - 8.0) / 4.0 / (0.5e9 * j));
        let (coarse, fine) = (pushed([4, 12]) / ring, pushed([8, 40]) / ring);
        // The layers along the edges in which a twisted strip shears are as wide as it is thick.
        assert!(
            (0.8..1.02).contains(&coarse) && (0.85..1.02).contains(&fine),
            "{coarse} and {fine} of a beam's"
        );
        // 0.89 and 1.30 where springs take the place of the turns about the normal.
        assert!(fine / coarse < 1.1, "grows from {coarse} to {fine} of a beam's as the mesh becomes finer");
    }

    #[test]
    fn pure_bending_and_pure_stretch_are_exact() {
        let facet = Facet { a: 0.003, b: 0.002 };
        let material = Material { young: [1.7e9, 1.7e9], poisson: 0.394 };
        let t = 0.002;
        let wall = Wall { material: &material, thickness: t };
        // w = -x² / 2 and u = 0.001 x, v = -ν u: curvature 1 and strain 0.001 along x.
        let mut d = nalgebra::SVector::<f64, 24>::zeros();
        for (corner, [sx, sy]) in CORNERS.into_iter().enumerate() {
            let (x, y) = (sx * facet.a / 2.0, sy * facet.b / 2.0);
            d[6 * corner] = 1e-3 * x;
            d[6 * corner + 1] = -0.394e-3 * y;
            d[6 * corner + 2] = -x * x / 2.0;
            d[6 * corner + 4] = x;
        }
        let strains = facet.strains(wall, (0.3, -0.6), 0.001) * d;
        approx::assert_relative_eq!(strains[0], 2e-3, max_relative = 1e-9);
        approx::assert_relative_eq!(strains[1], -0.394e-3, max_relative = 1e-9);
        approx::assert_abs_diff_eq!(strains[2], 0.0, epsilon = 1e-12);
        // Energy of both: E t ε² / 2 and D κ² / 2 over the area.
        let energy = 0.5 * d.dot(&(facet.stiffness(wall) * d));
        let area = facet.a * facet.b;
        let bending = 1.7e9 / (1.0 - 0.394f64.powi(2)) * f64::powi(t, 3) / 12.0 / 2.0 * area;
        let stretch = 1.7e9 * t * 1e-6 / 2.0 * area;
        approx::assert_relative_eq!(energy, bending + stretch, max_relative = 1e-6);
    }
}
