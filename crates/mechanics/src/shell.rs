//! Thin elastic shells: plates, pieces of cylinders, grids of beams, whatever is made of flat triangles.
//!
//! - [`ShellMesh`]: points of the middle surface and the triangles between them; [`Quads`] makes them, [`ShellMesh::graded`]
//!   refines them where stress is steep;
//! - [`Section`]: material and thickness, the same everywhere or one a triangle, and the [`PlateTheory`] by which it bends;
//!   [`Support`]: what holds a node;
//! - [`Shell`]: the assembled shell, its stiffness factored once: any number of loads, adjoints and Green's columns;
//! - [`Gauge`]: a strain gauge's rectangle, and its reading as a linear function of the displacements;
//! - [`Corotational`]: the same triangles under rotations that are not small, by Newton's method.
//!
//! A node has three displacements \[m\] and three rotations \[rad\] along the axes of the mesh's frame. Strains are small and
//! the material is linear. By reciprocity the reading of a gauge under every force on the shell is one solution, with the
//! gauge's [`Action`] as its load:
//!
//! ```
//! use dermis_mechanics::shell::{Action, Face, Gauge, Quads, Section, Shell, Support};
//! use nalgebra::{Point3, Vector3};
//!
//! // A strip of 100 mm by 10 mm by 2 mm, clamped at x = 0.
//! let mesh = Quads::grid(20, 2, |x, y| Point3::new(0.100 * x, 0.010 * y, 0.0)).split();
//! let supports: Vec<Support> = (0..mesh.points.len())
//!     .filter(|&n| mesh.points[n].x == 0.0)
//!     .map(Support::clamped)
//!     .collect();
//! let tip = (0..mesh.points.len()).find(|&n| mesh.points[n] == Point3::new(0.100, 0.005, 0.0)).unwrap();
//! let shell = Shell::new(mesh, &[Section::isotropic(1.8e9, 0.0, 0.002)], &supports)?;
//!
//! let gauge = Gauge {
//!     centre: Point3::new(0.030, 0.005, 0.0),
//!     along: Vector3::x(),
//!     length: 0.008,
//!     width: 0.005,
//!     face: Face::Inner,
//! };
//! let reading = shell.gauge(&gauge)?;
//! assert!(reading.covered > 0.99);
//! let influence = shell.solve(&[reading.row])?.remove(0);
//! // 1 N down at the tip: compression of the lower face, 6 F (L − x) / (E b h²).
//! let strain = influence.dot(&Action::force(tip, -Vector3::z()));
//! assert!((strain / (-6.0 * 0.070 / (1.8e9 * 0.010 * 0.002f64.powi(2))) - 1.0).abs() < 0.01);
//! # Ok::<(), dermis_mechanics::MechanicsError>(())
//! ```

mod cases;
mod corotational;
mod element;
mod gauge;
mod green;
mod mesh;
mod refine;
mod section;

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

pub(crate) use cases::roof_displacement;
pub use cases::shell_cases;
pub use corotational::{Bent, Corotational};
pub use gauge::{Face, Gauge, Reading};
pub(crate) use gauge::{Foot, Footprint};
pub use green::Green;
pub use mesh::{Quads, ShellMesh};
pub use refine::Refined;
pub use section::{Orthotropy, PlateTheory, Section};

use crate::MechanicsError;
use crate::fem::sparse::{BLOCK, Factor, HELD, Symmetric};
use element::Element;

/// Freedoms of a node.
const FREEDOMS: usize = 6;

/// What holds a node. Several for one node add up.
#[derive(Debug, Clone, PartialEq)]
pub struct Support {
    /// Which node.
    pub node: usize,
    /// Which of its displacements and rotations, along x, y and z each, are none.
    pub held: [bool; FREEDOMS],
    /// Springs to the ground: \[N/m\] for displacements, \[N·m/rad\] for rotations.
    pub stiffness: [f64; FREEDOMS],
}

impl Support {
    /// Holds all of a node.
    #[must_use]
    pub const fn clamped(node: usize) -> Self {
        Self::held(node, [true; FREEDOMS])
    }

    /// Holds some freedoms of a node.
    #[must_use]
    pub const fn held(node: usize, held: [bool; FREEDOMS]) -> Self {
        Self { node, held, stiffness: [0.0; FREEDOMS] }
    }

    /// Holds a node by springs: the same stiffness along all three axes \[N/m\], and about them \[N·m/rad\].
    #[must_use]
    pub const fn spring(node: usize, translation: f64, rotation: f64) -> Self {
        let (t, r) = (translation, rotation);
        Self { node, held: [false; FREEDOMS], stiffness: [t, t, t, r, r, r] }
    }
}

/// What acts on nodes, or a linear function of how they move: numbers at a few freedoms of nodes.
///
/// The two are one thing. As a load its numbers are forces \[N\] and moments \[N·m\]; its value on a displacement is the
/// work that the load would do on it. As a reading (a gauge's strain) its value is the reading.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Action {
    /// Freedom (six a node: three displacements, three rotations) and number, ascending, each once.
    entries: Vec<(usize, f64)>,
}

impl Action {
    /// Numbers at freedoms: 6 × node + (0, 1, 2 for displacements, 3, 4, 5 for rotations). Those of one freedom add up.
    #[must_use]
    pub fn new(mut entries: Vec<(usize, f64)>) -> Self {
        entries.sort_by_key(|(freedom, _)| *freedom);
        entries.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 += next.1;
            }
            same
        });
        Self { entries }
    }

    /// A force \[N\] on a node.
    #[must_use]
    pub fn force(node: usize, force: Vector3<f64>) -> Self {
        Self { entries: (0..3).map(|k| (FREEDOMS * node + k, force[k])).collect() }
    }

    /// A moment \[N·m\] on a node.
    #[must_use]
    pub fn moment(node: usize, moment: Vector3<f64>) -> Self {
        Self { entries: (0..3).map(|k| (FREEDOMS * node + 3 + k, moment[k])).collect() }
    }

    /// All of several at once, each times its factor.
    #[must_use]
    pub fn sum<'a>(parts: impl IntoIterator<Item = (f64, &'a Action)>) -> Self {
        let entries = parts.into_iter().flat_map(|(factor, part)| {
            part.entries.iter().map(move |&(freedom, value)| (freedom, factor * value))
        });
        Self::new(entries.collect())
    }

    /// Freedoms and their numbers, ascending.
    #[must_use]
    pub fn entries(&self) -> &[(usize, f64)] {
        &self.entries
    }
}

/// How every node moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Deformation(Vec<f64>);

impl Deformation {
    /// \[m\].
    ///
    /// # Panics
    ///
    /// Where there is no such node.
    #[must_use]
    pub fn displacement(&self, node: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&self.0[FREEDOMS * node..][..3])
    }

    /// \[rad\].
    ///
    /// # Panics
    ///
    /// Where there is no such node.
    #[must_use]
    pub fn rotation(&self, node: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&self.0[FREEDOMS * node + 3..][..3])
    }

    /// Six numbers a node: displacements \[m\], rotations \[rad\].
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// What `action` reads of this, or the work \[J\] that it does.
    ///
    /// # Panics
    ///
    /// Where `action` has a freedom that this lacks.
    #[must_use]
    pub fn dot(&self, action: &Action) -> f64 {
        action.entries.iter().map(|&(freedom, value)| self.0[freedom] * value).sum()
    }
}

/// A shell that is held somewhere, its stiffness factored.
#[derive(Debug)]
pub struct Shell {
    mesh: ShellMesh,
    elements: Vec<Element>,
    /// Unknown of each freedom, or [`HELD`].
    unknowns: Vec<usize>,
    stiffness: Symmetric,
    factor: Factor,
}

/// What [`Shell`] and [`Corotational`] are made from, checked.
#[derive(Debug)]
struct Parts {
    elements: Vec<Element>,
    /// Unknown of each freedom, or [`HELD`].
    unknowns: Vec<usize>,
    /// How many are not held.
    count: usize,
    /// Springs at freedoms.
    springs: Vec<(usize, f64)>,
}

impl Parts {
    fn new(mesh: &ShellMesh, sections: &[Section], supports: &[Support]) -> Result<Self, MechanicsError> {
        mesh.check()?;
        if sections.len() != 1 && sections.len() != mesh.triangles.len() {
            return Err(MechanicsError::Count {
                what: "sections of the shell",
                got: sections.len(),
                expected: mesh.triangles.len(),
            });
        }
        for section in sections {
            section.check()?;
        }
        let elements = mesh
            .triangles
            .iter()
            .enumerate()
            .map(|(i, t)| {
                let section = &sections[if sections.len() == 1 { 0 } else { i }];
                Element::new(i, t.map(|n| mesh.points[n as usize]), section)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut held = vec![false; FREEDOMS * mesh.points.len()];
        let mut springs = Vec::new();
        for support in supports {
            if support.node >= mesh.points.len() {
                return Err(MechanicsError::Node {
                    node: support.node,
                    what: "is held, but there is no such node",
                });
            }
            for k in 0..FREEDOMS {
                let freedom = FREEDOMS * support.node + k;
                held[freedom] |= support.held[k];
                let stiffness = support.stiffness[k];
                if !(stiffness.is_finite() && stiffness >= 0.0) {
                    return Err(MechanicsError::Value {
                        quantity: "stiffness of a support [N/m or N·m/rad]",
                        value: stiffness,
                        expected: "a number of at least 0",
                    });
                }
                if stiffness > 0.0 {
                    springs.push((freedom, stiffness));
                }
            }
        }
        check_held(mesh, &held, &springs)?;
        let mut count = 0;
        let unknowns = held
            .iter()
            .map(|held| {
                if *held {
                    HELD
                } else {
                    count += 1;
                    count - 1
                }
            })
            .collect();
        Ok(Self { elements, unknowns, count, springs })
    }

    /// Unknowns of each triangle.
    fn joined(&self, mesh: &ShellMesh) -> Vec<[usize; 3 * FREEDOMS]> {
        let of = |t: &[u32; 3]| {
            std::array::from_fn(|i| self.unknowns[FREEDOMS * t[i / FREEDOMS] as usize + i % FREEDOMS])
        };
        mesh.triangles.iter().map(of).collect()
    }
}

/// Looks for a part of the shell that could move as a rigid body.
fn check_held(mesh: &ShellMesh, held: &[bool], springs: &[(usize, f64)]) -> Result<(), MechanicsError> {
    let mut holds = held.to_vec();
    for (freedom, _) in springs {
        holds[*freedom] = true;
    }
    let part_of = mesh.parts();
    let parts = part_of.iter().max().map_or(0, |last| last + 1);
    let mut middles = vec![(Vector3::zeros(), 0.0); parts];
    for (p, part) in mesh.points.iter().zip(&part_of) {
        middles[*part].0 += p.coords;
        middles[*part].1 += 1.0;
    }
    let middles: Vec<Point3<f64>> =
        middles.into_iter().map(|(sum, count)| Point3::from(sum / count)).collect();
    let mut sizes = vec![0.0f64; parts];
    for (p, part) in mesh.points.iter().zip(&part_of) {
        sizes[*part] = sizes[*part].max((p - middles[*part]).norm());
    }
    let mut sums = vec![Matrix6::zeros(); parts];
    for (freedom, _) in holds.iter().enumerate().filter(|(_, holds)| **holds) {
        let (node, k) = (freedom / FREEDOMS, freedom % FREEDOMS);
        let part = part_of[node];
        // How much of each rigid motion this freedom sees; turns are counted by the way of the farthest point.
        let mut row = Vector6::zeros();
        if k < 3 {
            row[k] = 1.0;
            let mut axis = Vector3::zeros();
            axis[k] = 1.0;
            let arm = (mesh.points[node] - middles[part]).cross(&axis) / sizes[part];
            row.fixed_rows_mut::<3>(3).copy_from(&arm);
        } else {
            row[k] = 1.0;
        }
        sums[part] += row * row.transpose();
    }
    for (part, sum) in sums.iter().enumerate() {
        let values = sum.symmetric_eigenvalues();
        let (low, high) = (values.min(), values.max());
        if low.is_nan() || low <= 1e-12 * high {
            let node = part_of.iter().position(|p| *p == part).unwrap_or(0);
            return Err(MechanicsError::Loose { node });
        }
    }
    Ok(())
}

impl Shell {
    /// Assembles and factors the stiffness. `sections` has one for all triangles or one for each.
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Triangle`] or [`MechanicsError::Node`] for a mesh that cannot be (a triangle without area, a node
    /// that belongs to none), [`MechanicsError::Count`] and [`MechanicsError::Value`] for sections and supports that
    /// cannot be, [`MechanicsError::Loose`] where a part of the shell could move as a rigid body, and
    /// [`MechanicsError::Singular`] where the numbers are too far apart to be solved.
    pub fn new(mesh: ShellMesh, sections: &[Section], supports: &[Support]) -> Result<Self, MechanicsError> {
        let parts = Parts::new(&mesh, sections, supports)?;
        let joined = parts.joined(&mesh);
        let mut stiffness = Symmetric::new(parts.count, joined.iter().map(|dofs| &dofs[..]));
        for (element, dofs) in parts.elements.iter().zip(&joined) {
            // Symmetric: by rows or by columns is the same.
            stiffness.add(dofs, element.stiffness_in_link().as_slice());
        }
        for (freedom, spring) in &parts.springs {
            stiffness.add(&[parts.unknowns[*freedom]], &[*spring]);
        }
        let factor = stiffness.factor(&stiffness.order(None)?)?;
        Ok(Self { mesh, elements: parts.elements, unknowns: parts.unknowns, stiffness, factor })
    }

    /// The middle surface.
    #[must_use]
    pub fn mesh(&self) -> &ShellMesh {
        &self.mesh
    }

    /// How many displacements and rotations are not held.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.stiffness.size()
    }

    /// The lower half of the stiffness of what is not held, by columns: where each column starts, the rows, the values. For
    /// those who want to factor it themselves.
    #[must_use]
    pub fn stiffness(&self) -> (&[usize], &[usize], &[f64]) {
        self.stiffness.columns()
    }

    /// Where a displacement (`axis` 0 to 2) or rotation (3 to 5) of a node is among the unknowns of [`Shell::stiffness`];
    /// `None` where it is held.
    ///
    /// # Panics
    ///
    /// Where there is no such node.
    #[must_use]
    pub fn unknown(&self, node: usize, axis: usize) -> Option<usize> {
        Some(self.unknowns[FREEDOMS * node + axis]).filter(|unknown| *unknown != HELD)
    }

    /// Looks for the order of elimination and factors the stiffness once more: for those who measure it.
    ///
    /// # Errors
    ///
    /// None that [`Shell::new`] has not had.
    pub fn refactor(&mut self) -> Result<(), MechanicsError> {
        self.factor = self.stiffness.factor(&self.stiffness.order(None)?)?;
        Ok(())
    }

    /// How the shell moves under each load; with a reading as the load, its adjoint: by how much the reading changes for
    /// each force \[1/N\] and moment \[1/(N·m)\].
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Node`] where a load acts on a node that is not there.
    pub fn solve(&self, loads: &[Action]) -> Result<Vec<Deformation>, MechanicsError> {
        let mut out = Vec::with_capacity(loads.len());
        for block in loads.chunks(BLOCK) {
            let size = self.unknowns();
            let mut columns = vec![0.0; size * block.len()];
            for (column, load) in columns.chunks_exact_mut(size.max(1)).zip(block) {
                for &(freedom, value) in &load.entries {
                    let unknown = *self.unknowns.get(freedom).ok_or(MechanicsError::Node {
                        node: freedom / FREEDOMS,
                        what: "has a load, but there is no such node",
                    })?;
                    if unknown != HELD {
                        column[unknown] += value;
                    }
                }
            }
            self.factor.solve_columns(&mut columns, block.len());
            out.extend((0..block.len()).map(|j| self.spread(&columns[j * size..(j + 1) * size])));
        }
        Ok(out)
    }

    /// Unknowns and zeros where nodes are held.
    fn spread(&self, solution: &[f64]) -> Deformation {
        let value = |&unknown: &usize| if unknown == HELD { 0.0 } else { solution[unknown] };
        Deformation(self.unknowns.iter().map(value).collect())
    }

    /// \[J\] elastic energy of the shell itself, without springs, moved by `deformation`; also where it moves what is held.
    ///
    /// # Panics
    ///
    /// Where `deformation` is of another shell, with fewer nodes.
    #[must_use]
    pub fn energy(&self, deformation: &Deformation) -> f64 {
        let energy = |(element, t): (&Element, &[u32; 3])| {
            let u = nalgebra::SVector::<f64, 18>::from_fn(|i, _| {
                deformation.0[FREEDOMS * t[i / FREEDOMS] as usize + i % FREEDOMS]
            });
            (element.stiffness_in_link() * u).dot(&u) / 2.0
        };
        self.elements.iter().zip(&self.mesh.triangles).map(energy).sum()
    }
}

#[cfg(test)]
mod tests;
