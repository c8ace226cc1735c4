//! An elastomer over a rigid core, both hemispheres on cylinders.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use dermis_skin::cache::{Bytes, Keep};
use nalgebra::{Matrix3, Point3, Vector3};

use super::source::Source;
use super::sparse::{HELD, Ordering, Symmetric};
use super::{Bicubic, Probe};
use crate::error::positive;
use crate::quadrature::gauss_legendre;
use crate::{Base, MechanicsError, Medium};

/// Nodes of an element, three times three.
const NODES: usize = 9;
/// Displacements of an element's nodes.
const DOFS: usize = 3 * NODES;
/// Most elements across the elastomer, along the hemisphere, along the cylinder.
const ELEMENTS_MAX: [f64; 3] = [16.0, 64.0, 96.0];
/// Most harmonics.
const HARMONICS_MAX: f64 = 80.0;

/// \[m\] between rings that are taken for one.
const SAME: f64 = 1e-6;

/// How finely all is resolved, in the depth of the shallowest sensor.
struct Resolution {
    /// Elements in that depth.
    elements: f64,
    /// Points of the table of influences in that depth.
    points: f64,
    /// What may be left of the highest harmonic.
    left: f64,
}

/// Resolves influences to about 0.2 % of their peak.
const USUAL: Resolution = Resolution { elements: 6.0, points: 7.0, left: 1e-4 };

/// Where the elastomer lies: the tip is up, the origin in the base of the cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DomeShape {
    /// \[m\] of the outer hemisphere and the outer cylinder.
    pub radius: f64,
    /// \[m\] height of the cylinder.
    pub cylinder: f64,
    /// \[m\] of elastomer between the core and the outside.
    pub thickness: f64,
}

impl DomeShape {
    /// Arc \[m\] from the tip down to the foot of the cylinder.
    #[must_use]
    pub fn length(&self) -> f64 {
        FRAC_PI_2 * self.radius + self.cylinder
    }

    /// Arc from the tip \[m\] and angle about the axis \[rad\], in \[0, 2π), of a point on the outside.
    #[must_use]
    pub fn chart(&self, point: &Point3<f64>) -> [f64; 2] {
        let (r, above) = (point.x.hypot(point.y), point.z - self.cylinder);
        let arc = if above > 0.0 { self.radius * r.atan2(above) } else { FRAC_PI_2 * self.radius - above };
        let angle = point.y.atan2(point.x);
        [arc, if angle < 0.0 { angle + TAU } else { angle }]
    }

    /// Point at an arc and an angle, as [`chart`](Self::chart) has them.
    #[must_use]
    pub fn point(&self, [arc, angle]: [f64; 2]) -> Point3<f64> {
        let (r, z) = self.meridian(arc, self.radius);
        Point3::new(r * angle.cos(), r * angle.sin(), z)
    }

    /// Unit, out of the surface, at the point of the outside that is nearest to `point`; up where that is none.
    #[must_use]
    pub fn normal(&self, point: &Point3<f64>) -> Vector3<f64> {
        Vector3::new(point.x, point.y, (point.z - self.cylinder).max(0.0))
            .try_normalize(1e-12)
            .unwrap_or_else(Vector3::z)
    }

    /// \[m\] from a point to the outside, positive in the body.
    #[must_use]
    pub fn depth(&self, point: &Point3<f64>) -> f64 {
        self.radius - point.x.hypot(point.y).hypot((point.z - self.cylinder).max(0.0))
    }

    /// Distance from the axis and height of the point that lies under `arc` at `radius` from the hemisphere's centre or
    /// the axis.
    fn meridian(&self, arc: f64, radius: f64) -> (f64, f64) {
        let angle = arc / self.radius;
        if angle < FRAC_PI_2 {
            (radius * angle.sin(), self.cylinder + radius * angle.cos())
        } else {
            (radius, self.cylinder - (arc - FRAC_PI_2 * self.radius))
        }
    }

    fn check(&self) -> Result<(), MechanicsError> {
        positive("radius of the dome [m]", self.radius)?;
        positive("height of the cylinder [m]", self.cylinder)?;
        positive("thickness [m]", self.thickness)?;
        if self.thickness < self.radius {
            Ok(())
        } else {
            Err(MechanicsError::Value {
                quantity: "thickness [m]",
                value: self.thickness,
                expected: "smaller than the radius of the dome",
            })
        }
    }
}

/// Influence of sensors in a dome, tabulated over its outside.
///
/// The core is rigid; the outside and the foot of the cylinder are free. Around the axis, displacements are a Fourier
/// series; each harmonic is solved on the meridian by quadratic quadrilaterals with a linear dilatation each (B-bar), which
/// neither lock nor show alternating pressures. What a sensor's place sends out in a medium without end is known, so that
/// the elements only find what the boundaries add.
#[derive(Debug, Clone)]
pub struct Dome {
    shape: DomeShape,
    table: Bicubic,
}

impl Keep for Dome {
    fn put(&self, out: &mut Vec<u8>) {
        [self.shape.radius, self.shape.cylinder, self.shape.thickness].put(out);
        self.table.put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let [radius, cylinder, thickness] = Keep::take(from)?;
        Some(Self { shape: DomeShape { radius, cylinder, thickness }, table: Keep::take(from)? })
    }
}

impl Dome {
    /// Solves for `probes` in an elastomer of `poisson_ratio` on a core to which it is bonded or on which it slips.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number cannot be, or a point of a probe does not lie in the elastomer, at least
    /// a twentieth of its thickness away from the outside, the core and the foot.
    pub fn new(
        shape: DomeShape,
        poisson_ratio: f64,
        base: Base,
        probes: &[Probe],
    ) -> Result<Self, MechanicsError> {
        Self::resolved(shape, poisson_ratio, base, probes, &USUAL)
    }

    fn resolved(
        shape: DomeShape,
        poisson_ratio: f64,
        base: Base,
        probes: &[Probe],
        resolution: &Resolution,
    ) -> Result<Self, MechanicsError> {
        shape.check()?;
        Medium::half_space(1.0, poisson_ratio)?;
        let mut depth = shape.thickness / 2.0;
        for (point, _) in probes.iter().flatten() {
            let nearest = shape.depth(point).min(shape.thickness - shape.depth(point)).min(point.z);
            if nearest.is_nan() || nearest < shape.thickness / 20.0 {
                return Err(MechanicsError::Value {
                    quantity: "distance of a sensor from the nearest side of the elastomer [m]",
                    value: nearest,
                    expected: "at least a twentieth of its thickness",
                });
            }
            depth = depth.min(shape.depth(point));
        }
        let size = depth / resolution.elements;
        let mesh = Meridian::new(shape, size);

        // Sensors on one ring about the axis have the same field, turned.
        let mut rings: Vec<[f64; 2]> = Vec::new();
        let places: Vec<Vec<(usize, f64, f64)>> = probes
            .iter()
            .map(|probe| {
                probe
                    .iter()
                    .map(|(p, weight)| {
                        let (r, angle) = (p.x.hypot(p.y), p.y.atan2(p.x));
                        let same = |ring: &[f64; 2]| (ring[0] - r).abs().max((ring[1] - p.z).abs()) < SAME;
                        let ring = rings.iter().position(same).unwrap_or_else(|| {
                            rings.push([r, p.z]);
                            rings.len() - 1
                        });
                        (ring, angle, *weight)
                    })
                    .collect()
            })
            .collect();
        // The field that boundaries send back comes from beyond them and falls by R/(R+d) from harmonic to harmonic.
        let harmonics =
            (-resolution.left.ln() / (depth / shape.radius).ln_1p()).ceil().min(HARMONICS_MAX) as usize;
        let sources: Vec<Source> =
            rings.iter().map(|[r, z]| Source::new(Point3::new(*r, 0.0, *z), poisson_ratio)).collect();
        let step = depth / resolution.points;
        let along = (shape.length() / step).ceil().clamp(8.0, 200.0) as usize + 1;
        // Even, so that the other side of the tip is a point of the table.
        let around = 2 * (PI * shape.radius / step).ceil().clamp(8.0, 150.0) as usize;
        let steps = [shape.length() / (along - 1) as f64, TAU / around as f64];
        let arcs: Vec<f64> = (0..along).map(|i| i as f64 * steps[0]).collect();
        let returned = mesh.solve(poisson_ratio, base, &sources, harmonics, &arcs)?;

        let width = 3 * probes.len();
        let mut values = vec![0.0; along * around * width];
        for (i, &arc) in arcs.iter().enumerate() {
            for (p, probe) in places.iter().enumerate() {
                for j in 0..around {
                    let angle = j as f64 * steps[1];
                    let at = shape.point([arc, angle]);
                    let mut sum = Vector3::zeros();
                    for &(ring, turned, weight) in probe {
                        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), turned);
                        let here = turn.inverse() * at;
                        let own = sources[ring].displacement(&here);
                        // cos mφ and sin mφ by recursion.
                        let (sine, cosine) = (angle - turned).sin_cos();
                        let (mut c, mut s) = (1.0, 0.0);
                        let mut back = Vector3::zeros();
                        for harmonic in 0..=harmonics {
                            let [u, v, w] = returned[(ring * (harmonics + 1) + harmonic) * along + i];
                            back += Vector3::new(u * c, v * s, w * c);
                            (c, s) = (c * cosine - s * sine, s * cosine + c * sine);
                        }
                        let cartesian = Vector3::new(
                            back.x * cosine - back.y * sine,
                            back.x * sine + back.y * cosine,
                            back.z,
                        );
                        sum += turn * (own + cartesian) * weight;
                    }
                    let place = (i * around + j) * width + 3 * p;
                    values[place..place + 3].copy_from_slice(sum.as_slice());
                }
            }
        }
        let row = |i: usize, j: isize| {
            let place = (i * around + j.rem_euclid(around as isize) as usize) * width;
            &values[place..place + width]
        };
        let table = Bicubic::new([0.0; 2], steps, [along, around + 1], width, |[i, j], out| {
            if i < 0 {
                out.copy_from_slice(row(1, j + around as isize / 2));
            } else if i as usize == along {
                let last = [row(along - 1, j), row(along - 2, j), row(along - 3, j)];
                for (k, o) in out.iter_mut().enumerate() {
                    *o = 3.0 * (last[0][k] - last[1][k]) + last[2][k];
                }
            } else {
                out.copy_from_slice(row(i as usize, j));
            }
        });
        Ok(Self { shape, table })
    }

    /// The shape.
    #[must_use]
    pub fn shape(&self) -> &DomeShape {
        &self.shape
    }

    /// A mixture: the influence in a dome of which the share `share` behaves like `other`, and the rest like this one.
    ///
    /// # Panics
    ///
    /// Where the other has not the same shape, or other probes.
    #[must_use]
    pub fn mixed(mut self, other: &Self, share: f64) -> Self {
        assert_eq!(self.shape, other.shape);
        self.table.mix(&other.table, share);
        self
    }

    /// Over [`DomeShape::chart`]: \[Pa\] per \[N\] of a force in x, y and z, three numbers a probe.
    #[must_use]
    pub fn influence(&self) -> &Bicubic {
        &self.table
    }
}

/// What becomes of one combination of a node's displacements.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Role {
    /// An unknown, by number.
    Free(usize),
    /// Its value is given, by number.
    Given(usize),
    /// There is none.
    None,
}

/// Combinations of a node's displacements (radial, around, along the axis) and what becomes of each.
type Frame = [(Vector3<f64>, Role); 3];

/// The elastomer's half section.
struct Meridian {
    shape: DomeShape,
    /// Elements across, and along the whole arc.
    across: usize,
    along: usize,
    /// Arc of each line of nodes.
    arcs: Vec<f64>,
    /// Distance from the axis and height; from the core to the outside, line after line.
    nodes: Vec<[f64; 2]>,
}

/// An edge of an element on the boundary: its nodes, and which way is out.
struct Edge {
    nodes: [usize; 3],
    outward: f64,
}

impl Meridian {
    fn new(shape: DomeShape, size: f64) -> Self {
        let count = |length: f64, most: f64| (length / size).ceil().clamp(2.0, most) as usize;
        let across = count(shape.thickness, ELEMENTS_MAX[0]);
        let (over, down) =
            (count(FRAC_PI_2 * shape.radius, ELEMENTS_MAX[1]), count(shape.cylinder, ELEMENTS_MAX[2]));
        let arcs: Vec<f64> = (0..=2 * over)
            .map(|i| FRAC_PI_2 * shape.radius * i as f64 / (2 * over) as f64)
            .chain(
                (1..=2 * down)
                    .map(|i| FRAC_PI_2 * shape.radius + shape.cylinder * i as f64 / (2 * down) as f64),
            )
            .collect();
        let nodes = arcs
            .iter()
            .flat_map(|&arc| {
                (0..=2 * across).map(move |k| {
                    let r = shape.radius - shape.thickness * (1.0 - k as f64 / (2 * across) as f64);
                    let (r, z) = shape.meridian(arc, r);
                    // The tip's sine is exact, the foot's height is not.
                    [r, if arc == shape.length() { 0.0 } else { z }]
                })
            })
            .collect();
        Self { shape, across, along: over + down, arcs, nodes }
    }

    /// Nodes of a line.
    fn line(&self) -> usize {
        2 * self.across + 1
    }

    fn element(&self, along: usize, across: usize) -> [usize; NODES] {
        std::array::from_fn(|n| (2 * along + n / 3) * self.line() + 2 * across + n % 3)
    }

    fn elements(&self) -> impl Iterator<Item = [usize; NODES]> + '_ {
        (0..self.along).flat_map(move |i| (0..self.across).map(move |k| self.element(i, k)))
    }

    /// Edges on which stress is given: the outside, the foot, and the core where the elastomer slips on it.
    fn edges(&self, base: Base) -> Vec<Edge> {
        let line = self.line();
        let arc = |i: usize, k: usize| [2 * i, 2 * i + 1, 2 * i + 2].map(|j| j * line + k);
        let mut edges: Vec<Edge> =
            (0..self.along).map(|i| Edge { nodes: arc(i, line - 1), outward: 1.0 }).collect();
        let foot = 2 * self.along * line;
        edges.extend(
            (0..self.across).map(|k| Edge { nodes: [0, 1, 2].map(|j| foot + 2 * k + j), outward: -1.0 }),
        );
        if base == Base::Slip {
            edges.extend((0..self.along).map(|i| Edge { nodes: arc(i, 0), outward: -1.0 }));
        }
        edges
    }

    /// Unknowns of a harmonic, how many of them, and how many displacements are given.
    fn frames(&self, harmonic: usize, base: Base) -> (Vec<Frame>, usize, usize) {
        let [r, t, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        let (mut free, mut given) = (0, 0);
        let frames = self
            .nodes
            .iter()
            .enumerate()
            .map(|(n, place)| {
                let on_axis = n < self.line();
                let on_core = n % self.line() == 0;
                let mut next = |role: Role| match role {
                    Role::Free(_) => {
                        free += 1;
                        Role::Free(free - 1)
                    }
                    Role::Given(_) => {
                        given += 1;
                        Role::Given(given - 1)
                    }
                    Role::None => Role::None,
                };
                let (yes, value, no) = (Role::Free(0), Role::Given(0), Role::None);
                // The mean turns nothing: without it, nothing would hold a core on which all slips.
                let around = if harmonic == 0 { no } else { yes };
                let roles = match (on_axis, on_core.then_some(base)) {
                    (_, Some(Base::Bonded)) => {
                        [(r, value), (t, if harmonic == 0 { no } else { value }), (z, value)]
                    }
                    // What is regular on the axis: along it the mean, across it the first harmonic.
                    (true, _) => match harmonic {
                        0 => [(r, no), (t, no), (z, if on_core { value } else { yes })],
                        1 => [(r - t, yes), (t, no), (z, no)],
                        _ => [(r, no), (t, no), (z, no)],
                    },
                    (false, Some(Base::Slip)) => {
                        let normal = self.outward(place);
                        [(normal, value), (t, around), (t.cross(&normal), yes)]
                    }
                    (false, None) => [(r, yes), (t, around), (z, yes)],
                };
                roles.map(|(vector, role)| (vector, next(role)))
            })
            .collect();
        (frames, free, given)
    }

    /// Away from the core, across its surface.
    fn outward(&self, place: &[f64; 2]) -> Vector3<f64> {
        Vector3::new(place[0], 0.0, (place[1] - self.shape.cylinder).max(0.0)).normalize()
    }

    /// Amplitudes (radial, around, along the axis) on the outside of what the boundaries send back, at each of `arcs`, for
    /// each harmonic of each source.
    fn solve(
        &self,
        poisson_ratio: f64,
        base: Base,
        sources: &[Source],
        harmonics: usize,
        arcs: &[f64],
    ) -> Result<Vec<[f64; 3]>, MechanicsError> {
        let parts: Vec<[Vec<f64>; 3]> = self
            .elements()
            .enumerate()
            .map(|(cell, nodes)| {
                let [zero, one, minus] = [0.0, 1.0, -1.0].map(|m| self.stiffness(&nodes, m, poisson_ratio));
                match (zero, one, minus) {
                    // The stiffness is a polynomial of second degree in the harmonic's number.
                    (Some(zero), Some(one), Some(minus)) => {
                        let linear = one.iter().zip(&minus).map(|(a, b)| (a - b) / 2.0).collect();
                        let square =
                            one.iter().zip(&minus).zip(&zero).map(|((a, b), c)| (a + b) / 2.0 - c).collect();
                        Ok([zero, linear, square])
                    }
                    _ => Err(MechanicsError::Mesh { cell }),
                }
            })
            .collect::<Result<_, _>>()?;
        let edges = self.edges(base);
        let boundary = Boundary::new(self, &edges, sources, harmonics);

        let outside: Vec<(usize, [f64; 3])> = arcs.iter().map(|&arc| self.on_outside(arc)).collect();
        let mut answer = vec![[0.0; 3]; sources.len() * (harmonics + 1) * arcs.len()];
        // From the second harmonic on, all have the same unknowns.
        let mut kept: Option<(Symmetric, Ordering)> = None;
        for m in 0..=harmonics {
            let (frames, free, given) = self.frames(m, base);
            let dofs: Vec<Vec<usize>> = self
                .elements()
                .map(|nodes| {
                    nodes
                        .iter()
                        .flat_map(|&n| {
                            frames[n].map(|(_, role)| if let Role::Free(i) = role { i } else { HELD })
                        })
                        .collect()
                })
                .collect();
            let (mut matrix, ordering) = match kept.take() {
                Some((mut matrix, ordering)) if m > 2 => {
                    matrix.clear();
                    (matrix, ordering)
                }
                _ => {
                    let matrix = Symmetric::new(free, dofs.iter().map(Vec::as_slice));
                    let ordering = matrix.order(None)?;
                    (matrix, ordering)
                }
            };
            let mut columns = vec![vec![0.0; free]; sources.len()];
            let values: Vec<Vec<f64>> = (0..sources.len())
                .map(|source| {
                    let mut values = vec![0.0; given];
                    for (n, frame) in frames.iter().enumerate() {
                        for (vector, role) in frame {
                            match *role {
                                Role::Free(i) => {
                                    columns[source][i] += vector.dot(&boundary.load(source, m, n));
                                }
                                Role::Given(i) => {
                                    values[i] = vector.dot(&boundary.displacement(source, m, n));
                                }
                                Role::None => {}
                            }
                        }
                    }
                    values
                })
                .collect();
            let number = m as f64;
            for ((nodes, parts), dofs) in self.elements().zip(&parts).zip(&dofs) {
                let mut local: Vec<f64> = parts[0]
                    .iter()
                    .zip(&parts[1])
                    .zip(&parts[2])
                    .map(|((a, b), c)| a + number * (b + number * c))
                    .collect();
                transform(&mut local, &nodes.map(|n| frames[n].map(|(v, _)| v)));
                matrix.add(dofs, &local);
                let roles: Vec<Role> = nodes.iter().flat_map(|&n| frames[n].map(|(_, role)| role)).collect();
                for (k, role) in roles.iter().enumerate() {
                    let Role::Given(g) = *role else { continue };
                    for (column, values) in columns.iter_mut().zip(&values) {
                        for (i, &dof) in dofs.iter().enumerate() {
                            if dof != HELD {
                                column[dof] -= local[i * DOFS + k] * values[g];
                            }
                        }
                    }
                }
            }
            matrix.factor(&ordering)?.solve(&mut columns);
            for (source, column) in columns.iter().enumerate() {
                let at = |node: usize| -> Vector3<f64> {
                    frames[node]
                        .iter()
                        .map(|(vector, role)| match *role {
                            Role::Free(i) => vector * column[i],
                            Role::Given(i) => vector * values[source][i],
                            Role::None => Vector3::zeros(),
                        })
                        .sum()
                };
                for (i, (first, weights)) in outside.iter().enumerate() {
                    let sum: Vector3<f64> =
                        weights.iter().enumerate().map(|(j, w)| at(first + j * self.line()) * *w).sum();
                    answer[(source * (harmonics + 1) + m) * arcs.len() + i] = sum.into();
                }
            }
            if m >= 2 {
                kept = Some((matrix, ordering));
            }
        }
        Ok(answer)
    }

    /// First of the three outer nodes around an arc (the next ones follow a line later), and their weights.
    fn on_outside(&self, arc: f64) -> (usize, [f64; 3]) {
        let element =
            self.arcs.iter().step_by(2).skip(1).position(|&end| arc <= end).unwrap_or(self.along - 1);
        let (low, high) = (self.arcs[2 * element], self.arcs[2 * element + 2]);
        let xi = 2.0 * (arc - low) / (high - low) - 1.0;
        (2 * element * self.line() + self.line() - 1, quadratic(xi).map(|(value, _)| value))
    }

    /// Stiffness of an element for the harmonic `m` and Young's modulus 1, by rows; of a radian about the axis, and half of
    /// that where both sine and cosine are concerned (which cancels out of each harmonic's equations).
    fn stiffness(&self, nodes: &[usize; NODES], m: f64, poisson_ratio: f64) -> Option<Vec<f64>> {
        let bulk = 1.0 / (3.0 * (1.0 - 2.0 * poisson_ratio));
        let shear = 0.5 / (1.0 + poisson_ratio);
        let mut matrix = vec![0.0; DOFS * DOFS];
        let mut moments = Matrix3::zeros();
        let mut dilatation = [[0.0; DOFS]; 3];
        let rule: Vec<(f64, f64)> = gauss_legendre(3).iter().map(|(x, w)| (2.0 * x - 1.0, 2.0 * w)).collect();
        for &(xi, weight_xi) in &rule {
            for &(eta, weight_eta) in &rule {
                let (along, across) = (quadratic(xi), quadratic(eta));
                let (mut r, mut jacobian) = (0.0, [[0.0; 2]; 2]);
                let local: [(f64, f64, f64); NODES] = std::array::from_fn(|n| {
                    let ((a, da), (b, db)) = (along[n / 3], across[n % 3]);
                    (a * b, da * b, a * db)
                });
                for (n, (value, xi, eta)) in nodes.iter().zip(local) {
                    let place = self.nodes[*n];
                    r += value * place[0];
                    for axis in 0..2 {
                        jacobian[0][axis] += xi * place[axis];
                        jacobian[1][axis] += eta * place[axis];
                    }
                }
                let determinant = jacobian[0][0] * jacobian[1][1] - jacobian[0][1] * jacobian[1][0];
                // The arc runs down, the other coordinate outwards: that is left-handed in (r, z).
                let weight = determinant.abs() * r * weight_xi * weight_eta;
                if weight.is_nan() || weight <= 0.0 {
                    return None;
                }
                // Strains rr, θθ, zz, rz, rθ, zθ of each displacement, and its dilatation.
                let mut strain = [[0.0; 6]; DOFS];
                let mut volume = [0.0; DOFS];
                for (n, (value, xi, eta)) in local.into_iter().enumerate() {
                    let dr = (jacobian[1][1] * xi - jacobian[0][1] * eta) / determinant;
                    let dz = (jacobian[0][0] * eta - jacobian[1][0] * xi) / determinant;
                    let hoop = value / r;
                    strain[3 * n] = [dr, hoop, 0.0, dz, -m * hoop, 0.0];
                    strain[3 * n + 1] = [0.0, m * hoop, 0.0, 0.0, dr - hoop, dz];
                    strain[3 * n + 2] = [0.0, 0.0, dz, dr, 0.0, -m * hoop];
                    for k in 0..3 {
                        let s = &strain[3 * n + k];
                        volume[3 * n + k] = s[0] + s[1] + s[2];
                    }
                }
                let basis = Vector3::new(1.0, xi, eta);
                moments += basis * basis.transpose() * weight;
                for (row, b) in dilatation.iter_mut().zip(basis.iter()) {
                    for (d, v) in row.iter_mut().zip(&volume) {
                        *d += b * v * weight;
                    }
                }
                for i in 0..DOFS {
                    for j in i..DOFS {
                        let (a, b) = (&strain[i], &strain[j]);
                        let normal = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                        let shears = a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
                        let trace = volume[i] * volume[j];
                        matrix[i * DOFS + j] += shear * weight * (2.0 * normal - 2.0 / 3.0 * trace + shears);
                    }
                }
            }
        }
        let inverse = moments.try_inverse()?;
        for i in 0..DOFS {
            let here = inverse * Vector3::new(dilatation[0][i], dilatation[1][i], dilatation[2][i]) * bulk;
            for j in i..DOFS {
                let there = Vector3::new(dilatation[0][j], dilatation[1][j], dilatation[2][j]);
                matrix[i * DOFS + j] += here.dot(&there);
                matrix[j * DOFS + i] = matrix[i * DOFS + j];
            }
        }
        Some(matrix)
    }
}

/// What sources do at the boundary: harmonics of the forces that free the boundary of their stress, and of the displacements
/// that undo theirs on the core.
struct Boundary {
    harmonics: usize,
    /// Place of each node among those of the boundary.
    places: Vec<Option<usize>>,
    nodes: usize,
    loads: Vec<[f64; 3]>,
    displacements: Vec<[f64; 3]>,
}

impl Boundary {
    fn new(mesh: &Meridian, edges: &[Edge], sources: &[Source], harmonics: usize) -> Self {
        let core = (0..mesh.nodes.len()).step_by(mesh.line());
        let mut places = vec![None; mesh.nodes.len()];
        let mut nodes = 0;
        for n in edges.iter().flat_map(|e| e.nodes).chain(core.clone()) {
            places[n].get_or_insert_with(|| {
                nodes += 1;
                nodes - 1
            });
        }
        let size = sources.len() * (harmonics + 1) * nodes;
        let mut boundary = Self {
            harmonics,
            places,
            nodes,
            loads: vec![[0.0; 3]; size],
            displacements: vec![[0.0; 3]; size],
        };
        let turns = Turns::new(harmonics);
        let rule = gauss_legendre(4);
        for edge in edges {
            for &(x, w) in &rule {
                let shapes = quadratic(2.0 * x - 1.0);
                let (mut place, mut tangent) = ([0.0; 2], [0.0; 2]);
                for (n, (value, slope)) in edge.nodes.iter().zip(shapes) {
                    for axis in 0..2 {
                        place[axis] += value * mesh.nodes[*n][axis];
                        tangent[axis] += slope * mesh.nodes[*n][axis];
                    }
                }
                let length = tangent[0].hypot(tangent[1]);
                // To the left of the way down is out; of the way out along the foot, and on the core, it is in.
                let normal = [-tangent[1] / length * edge.outward, tangent[0] / length * edge.outward];
                let weight = 2.0 * w * length * place[0];
                for (s, source) in sources.iter().enumerate() {
                    let modes = turns.modes(|cosine, sine| {
                        let at = Point3::new(place[0] * cosine, place[0] * sine, place[1]);
                        source.traction(&at, &Vector3::new(normal[0] * cosine, normal[0] * sine, normal[1]))
                    });
                    for (m, mode) in modes.iter().enumerate() {
                        for (n, (value, _)) in edge.nodes.iter().zip(shapes) {
                            let Some(at) = boundary.index(s, m, *n) else { continue };
                            for (load, t) in boundary.loads[at].iter_mut().zip(mode) {
                                *load -= value * weight * t;
                            }
                        }
                    }
                }
            }
        }
        for n in core {
            let place = mesh.nodes[n];
            for (s, source) in sources.iter().enumerate() {
                let modes = turns.modes(|cosine, sine| {
                    source.displacement(&Point3::new(place[0] * cosine, place[0] * sine, place[1]))
                });
                for (m, mode) in modes.iter().enumerate() {
                    let Some(at) = boundary.index(s, m, n) else { continue };
                    boundary.displacements[at] = mode.map(|u| -u);
                }
            }
        }
        boundary
    }

    fn index(&self, source: usize, harmonic: usize, node: usize) -> Option<usize> {
        self.places[node].map(|place| (source * (self.harmonics + 1) + harmonic) * self.nodes + place)
    }

    fn load(&self, source: usize, harmonic: usize, node: usize) -> Vector3<f64> {
        self.index(source, harmonic, node).map_or_else(Vector3::zeros, |i| self.loads[i].into())
    }

    fn displacement(&self, source: usize, harmonic: usize, node: usize) -> Vector3<f64> {
        self.index(source, harmonic, node).map_or_else(Vector3::zeros, |i| self.displacements[i].into())
    }
}

/// Angles over half a turn, and their harmonics: enough to resolve twice the highest one.
struct Turns {
    angles: Vec<(f64, f64)>,
    /// cos mφ and sin mφ with the series' weights, by harmonic and angle.
    waves: Vec<Vec<(f64, f64)>>,
}

impl Turns {
    fn new(harmonics: usize) -> Self {
        let count = 2 * harmonics.max(8);
        let angle = |j: usize| PI * (j as f64 + 0.5) / count as f64;
        let weight = |m: usize| if m == 0 { 1.0 } else { 2.0 } / count as f64;
        Self {
            angles: (0..count).map(|j| (angle(j).cos(), angle(j).sin())).collect(),
            waves: (0..=harmonics)
                .map(|m| {
                    (0..count)
                        .map(|j| (m as f64 * angle(j)).sin_cos())
                        .map(|(s, c)| (weight(m) * c, weight(m) * s))
                        .collect()
                })
                .collect(),
        }
    }

    /// Amplitudes of a field that is symmetric to the plane of angle 0, given by cosine and sine of the angle: radial and
    /// axial ones of cosines, those around the axis of sines.
    fn modes(&self, field: impl Fn(f64, f64) -> Vector3<f64>) -> Vec<[f64; 3]> {
        let samples: Vec<[f64; 3]> = self
            .angles
            .iter()
            .map(|&(c, s)| {
                let f = field(c, s);
                [f.x * c + f.y * s, f.y * c - f.x * s, f.z]
            })
            .collect();
        self.waves
            .iter()
            .map(|wave| {
                let mut sum = [0.0; 3];
                for (f, (c, s)) in samples.iter().zip(wave) {
                    sum[0] += c * f[0];
                    sum[1] += s * f[1];
                    sum[2] += c * f[2];
                }
                sum
            })
            .collect()
    }
}

/// Values and slopes of the three quadratic shape functions on [−1, 1].
fn quadratic(xi: f64) -> [(f64, f64); 3] {
    [(xi * (xi - 1.0) / 2.0, xi - 0.5), (1.0 - xi * xi, -2.0 * xi), (xi * (xi + 1.0) / 2.0, xi + 0.5)]
}

/// Takes an element's matrix to the frames of its nodes.
fn transform(matrix: &mut [f64], frames: &[[Vector3<f64>; 3]; NODES]) {
    let plain = [Vector3::x(), Vector3::y(), Vector3::z()];
    for (n, frame) in frames.iter().enumerate() {
        if *frame == plain {
            continue;
        }
        for i in 0..DOFS {
            let row = Vector3::from_fn(|k, _| matrix[i * DOFS + 3 * n + k]);
            for (k, vector) in frame.iter().enumerate() {
                matrix[i * DOFS + 3 * n + k] = vector.dot(&row);
            }
        }
        for j in 0..DOFS {
            let column = Vector3::from_fn(|k, _| matrix[(3 * n + k) * DOFS + j]);
            for (k, vector) in frame.iter().enumerate() {
                matrix[(3 * n + k) * DOFS + j] = vector.dot(&column);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::{HexMesh, Solid};

    const SHAPE: DomeShape = DomeShape { radius: 0.010, cylinder: 0.016, thickness: 0.0072 };
    const NU: f64 = 0.49;

    fn ring(angle_from_tip: f64, turn: f64) -> Probe {
        let r = 0.0064;
        vec![(
            Point3::new(
                r * angle_from_tip.sin() * turn.cos(),
                r * angle_from_tip.sin() * turn.sin(),
                0.016 + r * angle_from_tip.cos(),
            ),
            1.0,
        )]
    }

    fn probes() -> Vec<Probe> {
        let low = vec![(Point3::new(0.0, 0.0064, 0.008), 1.0)];
        vec![ring(0.0, 0.0), ring(1.0, 0.3), ring(1.0, 1.5), low]
    }

    fn at(dome: &Dome, arc: f64, angle: f64) -> Vec<f64> {
        let mut out = vec![0.0; dome.influence().width()];
        dome.influence().add(arc, angle, 1.0, &mut out);
        out
    }

    /// Largest difference between two domes' influences over the outside, relative to the peak, of each component.
    fn difference(a: &Dome, b: &Dome) -> f64 {
        let width = a.influence().width();
        let (mut worst, mut peak) = (vec![0.0f64; width], vec![0.0f64; width]);
        for i in 0..63 {
            for j in 0..63 {
                let (arc, angle) = (SHAPE.length() * f64::from(i) / 62.0, TAU * f64::from(j) / 62.0);
                for (k, (a, b)) in at(a, arc, angle).iter().zip(at(b, arc, angle)).enumerate() {
                    worst[k] = worst[k].max((a - b).abs());
                    peak[k] = peak[k].max(b.abs());
                }
            }
        }
        worst.iter().zip(&peak).map(|(w, p)| w / p).fold(0.0, f64::max)
    }

    #[test]
    fn finer_elements_change_little() {
        for base in [Base::Bonded, Base::Slip] {
            let dome = Dome::new(SHAPE, NU, base, &probes()).unwrap();
            let fine = Resolution { elements: 8.0, points: 12.0, left: 1e-6 };
            let fine = Dome::resolved(SHAPE, NU, base, &probes(), &fine).unwrap();
            let difference = difference(&dome, &fine);
            assert!(difference < 0.003, "{base:?}: {difference}");
        }
    }

    #[test]
    fn an_almost_incompressible_dome_does_not_lock() {
        let at = |poisson| Dome::new(SHAPE, poisson, Base::Bonded, &probes()).unwrap();
        let difference = difference(&at(0.499), &at(0.4999));
        assert!(difference < 0.01, "{difference}");
    }

    /// Hexahedra know nothing of harmonics, of sources, or of charts.
    #[test]
    fn hexahedra_agree() {
        let (around, layers) = (12, 6);
        let mesh = HexMesh::dome(SHAPE.radius, SHAPE.cylinder, SHAPE.thickness, around, layers).unwrap();
        let surface = mesh.nodes.len() / (layers + 1);
        let middle = |cell: usize| {
            let corners = mesh.corners(&mesh.cells[cell]);
            Point3::from(corners.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 8.0)
        };
        // The cells around a node halfway: over the tip, on the hemisphere, on the cylinder.
        let sensors: Vec<Vec<(usize, f64)>> = [[0.0, 0.0], [0.008, 0.5], [0.023, 2.0]]
            .iter()
            .map(|&place| {
                let outside = SHAPE.point(place);
                let inside = outside - SHAPE.normal(&outside) * (SHAPE.thickness / 2.0);
                let mut near: Vec<usize> = (0..mesh.cells.len()).collect();
                near.sort_by(|a, b| (middle(*a) - inside).norm().total_cmp(&(middle(*b) - inside).norm()));
                near.truncate(8);
                near.into_iter().map(|cell| (cell, 0.125)).collect()
            })
            .collect();
        let probes: Vec<Probe> = sensors
            .iter()
            .map(|s| s.iter().map(|&(cell, weight)| (middle(cell), weight)).collect())
            .collect();
        let outer = mesh.nodes.len() - surface..mesh.nodes.len();
        // Pushes as wide as a fingertip, into the surface and along it.
        let loads: Vec<Vec<(usize, Vector3<f64>)>> = [
            ([0.0, 0.0], [0.0, 0.0, -1.0]),
            ([0.009, 0.6], [-0.5, -0.3, -0.8]),
            ([0.021, 2.2], [0.6, -0.6, 0.5]),
        ]
        .into_iter()
        .map(|(place, force)| {
            let centre = SHAPE.point(place);
            let weight =
                |n: usize| (-(mesh.nodes[n] - centre).norm_squared() / (2.0 * 0.003f64.powi(2))).exp();
            let total: f64 = outer.clone().map(weight).sum();
            outer.clone().map(|n| (n, Vector3::from(force) * (weight(n) / total))).collect()
        })
        .collect();
        let solid = Solid::new(mesh.clone(), 1.0, NU, |n, _| [n < surface; 3]).unwrap();
        let moved = solid.displacements(&loads);
        let dome = Dome::new(SHAPE, NU, Base::Bonded, &probes).unwrap();
        for (load, moved) in loads.iter().zip(&moved) {
            let mut ours = [0.0; 9];
            for (n, force) in load {
                let [arc, angle] = SHAPE.chart(&mesh.nodes[*n]);
                for (k, a) in at(&dome, arc, angle).iter().enumerate() {
                    ours[k] += a * force[k % 3];
                }
            }
            let ours: Vec<f64> = ours.chunks(3).map(|c| c.iter().sum()).collect();
            let theirs: Vec<f64> = sensors
                .iter()
                .map(|s| s.iter().map(|&(cell, weight)| weight * solid.pressure(cell, moved)).sum())
                .collect();
            let peak = ours.iter().fold(0.0f64, |p, v| p.max(v.abs()));
            for (a, b) in ours.iter().zip(&theirs) {
                assert!((a - b).abs() < 0.03 * peak, "{ours:?} {theirs:?}");
            }
        }
    }

    #[test]
    fn chart_and_point_agree() {
        for place in [[0.001, 0.1], [0.015, 3.0], [0.0157, 6.2], [0.02, 4.0], [0.0317, 0.0]] {
            let [arc, angle] = SHAPE.chart(&SHAPE.point(place));
            assert!((arc - place[0]).abs() < 1e-12 && (angle - place[1]).abs() < 1e-12);
            assert!(SHAPE.depth(&SHAPE.point(place)).abs() < 1e-12);
        }
    }

    #[test]
    fn impossible_domes_are_refused() {
        let refused = |shape, z| {
            Dome::new(shape, NU, Base::Bonded, &[vec![(Point3::new(0.0, 0.0, z), 1.0)]])
                .unwrap_err()
                .to_string()
        };
        insta::assert_snapshot!(refused(SHAPE, 0.0184), @"distance of a sensor from the nearest side of the elastomer [m] is -0.00040000000000000105 and must be at least a twentieth of its thickness");
        insta::assert_snapshot!(refused(DomeShape { thickness: 0.01, ..SHAPE }, 0.02), @"thickness [m] is 0.01 and must be smaller than the radius of the dome");
        insta::assert_snapshot!(refused(DomeShape { cylinder: -1.0, ..SHAPE }, 0.02), @"height of the cylinder [m] is -1 and must be a positive number");
    }
}
