//! Rotations that are not small: every triangle keeps its linear stiffness in a frame that goes with it.
//!
//! C. A. Felippa, B. Haugen, *A unified formulation of small-strain corotational finite elements: I. Theory*, Comput.
//! Methods Appl. Mech. Engrg. 194 (2005) 2285-2335.

use nalgebra::{Matrix3, Point3, Rotation3, SMatrix, SVector, Vector3};

use super::element::{Element, Stiffness};
use super::gauge::{Gauge, Pieces};
use super::{Action, Deformation, FREEDOMS, Parts, Section, ShellMesh, Support};
use crate::MechanicsError;
use crate::fem::sparse::{HELD, Ordering, Symmetric};

/// Displacements, rotations or forces of a triangle's corners.
type Corners = SVector<f64, 18>;
/// Iterations before a step is given up.
const ITERATIONS: usize = 40;
/// A step has converged when an iteration moves nodes by no more than this share of the largest displacement: the error that
/// is left is about its square.
const TOLERANCE: f64 = 1e-7;
/// The same as a share of the shell's size: where numbers are rounded.
const ROUNDING: f64 = 1e-12;

/// A shell whose rotations may be large while its strains are small: the reference for what a linear shell leaves out, such as
/// the stiffening of a plate that is bent as far as it is thick.
#[derive(Debug)]
pub struct Corotational {
    mesh: ShellMesh,
    parts: Parts,
    /// Of each triangle in its own frame.
    stiffness: Vec<Stiffness>,
    joined: Vec<[usize; 18]>,
    empty: Symmetric,
    ordering: Ordering,
}

/// A state of equilibrium.
#[derive(Debug, Clone, PartialEq)]
pub struct Bent {
    /// \[m\] of the nodes, and rotation vectors \[rad\].
    pub deformation: Deformation,
    /// What of it deforms each triangle, in the triangle's frame.
    own: Vec<Corners>,
}

/// Where nodes are and how they are turned.
#[derive(Clone)]
struct State {
    points: Vec<Point3<f64>>,
    turns: Vec<Rotation3<f64>>,
}

fn spin(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The rotation vector of a turn. (That of a turn's cosine has no digits left where the turn is small.)
fn vector(turn: &Rotation3<f64>) -> Vector3<f64> {
    let m = turn.matrix();
    let twice = Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]);
    let (sine, cosine) = (twice.norm() / 2.0, (m.trace() - 1.0) / 2.0);
    if cosine < -0.9 {
        turn.scaled_axis()
    } else if sine < 1e-12 {
        twice / 2.0
    } else {
        twice * (0.5 * sine.atan2(cosine) / sine)
    }
}

/// Change of a rotation vector by a small turn in front of it: the inverse of the left Jacobian.
fn change(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let eta = if angle < 1e-3 {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle)
    };
    let s = spin(turn);
    Matrix3::identity() - s * 0.5 + s * s * eta
}

/// A triangle in its present place.
struct Carried {
    /// Rows are its axes.
    local_from_link: Matrix3<f64>,
    /// What deforms it.
    own: Corners,
    /// Small changes of `own` for those of the corners in the triangle's frame.
    variation: SMatrix<f64, 18, 18>,
    /// The same before rotation vectors are taken.
    projector: SMatrix<f64, 18, 18>,
    /// Turn of the frame.
    follow: SMatrix<f64, 3, 18>,
    /// Rotation vectors' part of `variation`.
    vectors: SMatrix<f64, 18, 18>,
}

fn carried(element: &Element, corners: &[Point3<f64>; 3], turns: &[Rotation3<f64>; 3]) -> Option<Carried> {
    let [p1, p2, p3] = corners;
    let e1 = (p2 - p1).try_normalize(0.0)?;
    let normal = (p2 - p1).cross(&(p3 - p1));
    let double = normal.norm();
    let e3 = normal.try_normalize(0.0)?;
    let local_from_link = Matrix3::from_rows(&[e1.transpose(), e3.cross(&e1).transpose(), e3.transpose()]);
    let middle = (p1.coords + p2.coords + p3.coords) / 3.0;
    let locations = corners.map(|p| local_from_link * (p.coords - middle));
    let first = element.corners;
    let first_middle = [0, 1].map(|k| (first[0][k] + first[1][k] + first[2][k]) / 3.0);
    let mut follow = SMatrix::<f64, 3, 18>::zeros();
    for (a, [j, m]) in [[1, 2], [2, 0], [0, 1]].into_iter().enumerate() {
        follow[(0, 6 * a + 2)] = (locations[m].x - locations[j].x) / double;
        follow[(1, 6 * a + 2)] = -(locations[j].y - locations[m].y) / double;
    }
    let side = (p2 - p1).norm();
    follow[(2, 1)] = -1.0 / side;
    follow[(2, 7)] = 1.0 / side;

    let mut own = Corners::zeros();
    let mut projector = SMatrix::<f64, 18, 18>::identity();
    let mut vectors = SMatrix::<f64, 18, 18>::identity();
    for a in 0..3 {
        let start = Vector3::new(first[a][0] - first_middle[0], first[a][1] - first_middle[1], 0.0);
        own.fixed_rows_mut::<3>(6 * a).copy_from(&(locations[a] - start));
        let turn = local_from_link * turns[a].matrix() * element.local_from_link.transpose();
        let vector = vector(&Rotation3::from_matrix_unchecked(turn));
        own.fixed_rows_mut::<3>(6 * a + 3).copy_from(&vector);
        vectors.fixed_view_mut::<3, 3>(6 * a + 3, 6 * a + 3).copy_from(&change(&vector));
        for b in 0..3 {
            let mut block = projector.fixed_view_mut::<3, 3>(6 * a, 6 * b);
            block -= Matrix3::identity() / 3.0;
        }
        let mut displacements = projector.fixed_rows_mut::<3>(6 * a);
        displacements += spin(&locations[a]) * follow;
        let mut rotations = projector.fixed_rows_mut::<3>(6 * a + 3);
        rotations -= follow;
    }
    let variation = vectors * projector;
    Some(Carried { local_from_link, own, variation, projector, follow, vectors })
}

impl Carried {
    /// Forces on the corners, and their change by the corners' movement, both in the frame of the mesh. `full` has the stiffness of
    /// the present stresses, too.
    fn forces(&self, stiffness: &Stiffness, full: bool) -> (Corners, Stiffness) {
        let raw = self.vectors.transpose() * (stiffness * self.own);
        let local = self.projector.transpose() * raw;
        let mut tangent = self.variation.transpose() * stiffness * self.variation;
        if full {
            let mut turned = SMatrix::<f64, 18, 3>::zeros();
            let mut moved = SMatrix::<f64, 3, 18>::zeros();
            for block in 0..6 {
                let force = local.fixed_rows::<3>(3 * block).into_owned();
                turned.fixed_rows_mut::<3>(3 * block).copy_from(&spin(&force));
                if block % 2 == 0 {
                    let force = raw.fixed_rows::<3>(3 * block).into_owned();
                    moved.fixed_columns_mut::<3>(3 * block).copy_from(&spin(&force));
                }
            }
            tangent += self.follow.transpose() * (moved * self.projector) - turned * self.follow;
            tangent = (tangent + tangent.transpose()) / 2.0;
        }
        let mut force = Corners::zeros();
        let mut out = Stiffness::zeros();
        let turn = &self.local_from_link;
        for a in 0..6 {
            force.fixed_rows_mut::<3>(3 * a).copy_from(&(turn.transpose() * local.fixed_rows::<3>(3 * a)));
            for b in 0..6 {
                let block = turn.transpose() * tangent.fixed_view::<3, 3>(3 * a, 3 * b) * turn;
                out.fixed_view_mut::<3, 3>(3 * a, 3 * b).copy_from(&block);
            }
        }
        (force, out)
    }
}

impl Corotational {
    /// A shell as [`Shell::new`](super::Shell::new) takes it.
    ///
    /// # Errors
    ///
    /// The same.
    pub fn new(mesh: ShellMesh, sections: &[Section], supports: &[Support]) -> Result<Self, MechanicsError> {
        let parts = Parts::new(&mesh, sections, supports)?;
        let joined = parts.joined(&mesh);
        let empty = Symmetric::new(parts.count, joined.iter().map(|dofs| &dofs[..]));
        let ordering = empty.order(None)?;
        let stiffness = parts.elements.iter().map(Element::stiffness).collect();
        Ok(Self { mesh, parts, stiffness, joined, empty, ordering })
    }

    /// The middle surface before anything acts on it.
    #[must_use]
    pub fn mesh(&self) -> &ShellMesh {
        &self.mesh
    }

    /// The shell under each of `shares` of `load`, one reached from the one before, so they should go up in steps that are
    /// not too large. The load keeps its direction (it does not turn with the shell).
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Node`] where the load acts on a node that is not there, [`MechanicsError::Equilibrium`] where Newton's
    /// method does not converge.
    pub fn equilibria(&self, load: &Action, shares: &[f64]) -> Result<Vec<Bent>, MechanicsError> {
        let mut right = vec![0.0; self.parts.count];
        for &(freedom, value) in load.entries() {
            let unknown = *self.parts.unknowns.get(freedom).ok_or(MechanicsError::Node {
                node: freedom / FREEDOMS,
                what: "has a load, but there is no such node",
            })?;
            if unknown != HELD {
                right[unknown] += value;
            }
        }
        let count = self.mesh.points.len();
        let mut state = State { points: self.mesh.points.clone(), turns: vec![Rotation3::identity(); count] };
        let mut out = Vec::with_capacity(shares.len());
        for &share in shares {
            self.step(&mut state, &right, share)?;
            out.push(self.bent(&state).ok_or(MechanicsError::Equilibrium { share, iterations: ITERATIONS })?);
        }
        Ok(out)
    }

    /// What `gauge` reads of a state, as [`Shell::gauge`](super::Shell::gauge) does for small displacements: its rectangle is
    /// placed on the shell as it was made.
    ///
    /// # Errors
    ///
    /// The same.
    pub fn strain(&self, bent: &Bent, gauge: &Gauge) -> Result<f64, MechanicsError> {
        let pieces = Pieces::new(&self.mesh, &self.parts.elements, &self.mesh.normals(), gauge)?;
        Ok(pieces.rows.iter().map(|(triangle, row)| (row * bent.own[*triangle]).x).sum())
    }

    fn carried(&self, state: &State, triangle: usize) -> Option<Carried> {
        let corners = self.mesh.triangles[triangle];
        carried(
            &self.parts.elements[triangle],
            &corners.map(|n| state.points[n as usize]),
            &corners.map(|n| state.turns[n as usize]),
        )
    }

    fn bent(&self, state: &State) -> Option<Bent> {
        let own =
            (0..self.stiffness.len()).map(|k| Some(self.carried(state, k)?.own)).collect::<Option<_>>()?;
        Some(Bent { deformation: Deformation(self.moved(state)), own })
    }

    /// Six numbers a node.
    fn moved(&self, state: &State) -> Vec<f64> {
        let mut out = Vec::with_capacity(FREEDOMS * state.points.len());
        for ((point, turn), first) in state.points.iter().zip(&state.turns).zip(&self.mesh.points) {
            out.extend((point - first).iter());
            out.extend(vector(turn).iter());
        }
        out
    }

    /// Newton's method.
    fn step(&self, state: &mut State, right: &[f64], share: f64) -> Result<(), MechanicsError> {
        let size = self.mesh.points.iter().map(|p| (p - self.mesh.points[0]).norm()).fold(0.0, f64::max);
        for _ in 0..ITERATIONS {
            let lost = MechanicsError::Equilibrium { share, iterations: ITERATIONS };
            // Where the stresses make the tangent indefinite, the way back is the stiffness without them.
            let step = match self.correction(state, right, share, true) {
                Some(step) => step,
                None => self.correction(state, right, share, false).ok_or(lost.clone())?,
            };
            let part = |node: usize, k: usize| {
                let unknown = self.parts.unknowns[FREEDOMS * node + k];
                if unknown == HELD { 0.0 } else { step[unknown] }
            };
            let (mut largest, mut way) = (0.0f64, 0.0f64);
            for node in 0..state.points.len() {
                let [a, b] = [0, 3].map(|from| Vector3::from_fn(|k, _| part(node, from + k)));
                state.points[node] += a;
                state.turns[node] = Rotation3::new(b) * state.turns[node];
                way = way.max(a.norm());
                largest = largest.max((state.points[node] - self.mesh.points[node]).norm());
            }
            if !way.is_finite() {
                return Err(lost);
            }
            if way <= TOLERANCE * largest + ROUNDING * size {
                for turn in &mut state.turns {
                    turn.renormalize();
                }
                return Ok(());
            }
        }
        Err(MechanicsError::Equilibrium { share, iterations: ITERATIONS })
    }

    fn correction(&self, state: &State, right: &[f64], share: f64, full: bool) -> Option<Vec<f64>> {
        let mut tangent = self.empty.clone();
        let mut residual: Vec<f64> = right.iter().map(|value| value * share).collect();
        for (k, (stiffness, dofs)) in self.stiffness.iter().zip(&self.joined).enumerate() {
            let (force, matrix) = self.carried(state, k)?.forces(stiffness, full);
            tangent.add(dofs, matrix.as_slice());
            for (&unknown, value) in dofs.iter().zip(force.iter()).filter(|(unknown, _)| **unknown != HELD) {
                residual[unknown] -= value;
            }
        }
        if !self.parts.springs.is_empty() {
            let moved = self.moved(state);
            for (freedom, spring) in &self.parts.springs {
                let unknown = self.parts.unknowns[*freedom];
                tangent.add(&[unknown], &[*spring]);
                if unknown != HELD {
                    residual[unknown] -= spring * moved[*freedom];
                }
            }
        }
        let factor = tangent.factor(&self.ordering).ok()?;
        factor.solve_columns(&mut residual, 1);
        Some(residual)
    }
}
