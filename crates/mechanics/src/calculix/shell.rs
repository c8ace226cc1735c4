//! Shells as thin solids: the roof of Scordelis and Lo, and a panel with openings like a limb's.
//!
//! CalculiX' own shell elements are expanded into solids, and what their rotations are held by changes the answer of the roof
//! tenfold; 20-node hexahedra of reduced integration leave nothing to hold but displacements.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use nalgebra::{Point3, Vector3};

use super::faces::{press, side_strain, weighed};
use super::quadratic::{EDGES, FIRST_SIDE, LAST_SIDE, Quadratic, Share};
use super::{CalculixError, Load, Model, SOURCE};
use crate::Case;
use crate::fem::HexMesh;
use crate::shell::{Action, Face, Foot, Gauge, Quads, Section, Shell, Support};

/// A shell that is held somewhere and pressed somewhere, with gauges on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel<'a> {
    /// Short, in the names of its cases.
    pub name: &'a str,
    /// The middle surface. Of a [`ShellMesh`] that has two triangles of each quadrilateral: [`Quads::join`].
    pub quads: &'a Quads,
    /// Material and thickness everywhere; without orthotropy.
    pub section: &'a Section,
    /// Points of the middle surface that are held, through all of the thickness.
    pub clamped: &'a [usize],
    /// Middle \[m\] of what presses on the outer face.
    pub centre: Point3<f64>,
    /// \[m\] of the patch that it presses on; over half of the quadrilaterals' sides.
    pub patch: f64,
    /// Gauges on the inner or the outer face.
    pub gauges: &'a [Gauge],
    /// Shares by which the displacement, and strains of the largest one, may differ.
    pub within: [f64; 2],
}

/// The roof, and a panel with openings, clamped at both ends.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails.
pub fn shell_cases() -> Result<Vec<Case>, CalculixError> {
    let mut cases = vec![roof()?];
    let (quads, clamped) = limb(2);
    let gauges = limb_gauges();
    cases.extend(panel_cases(&Panel {
        name: "limb",
        quads: &quads,
        section: &Section::isotropic(1.7e9, 0.394, 0.002),
        clamped: &clamped,
        centre: on_limb(0.0, 0.0),
        patch: 0.005,
        gauges: &gauges,
        // Hexahedra of 0.8 mm and triangles as fine differ by 3.8 % and 5.4 %, most of it shear across the thickness: beams of
        // 2 mm are 12.5 mm long. Here, at 1.25 mm, it is 4.6 % and 6.2 %; at 2.5 mm 7.4 % and 9.0 %, because at the openings'
        // sharp corners all meshes converge slowly, ours from the stiff side.
        within: [0.06, 0.075],
    })?);
    Ok(cases)
}

/// Middle surface of the limb at x and the arc's length from its top \[m\].
fn on_limb(x: f64, s: f64) -> Point3<f64> {
    let radius = 0.045;
    let (sin, cos) = (s / radius).sin_cos();
    Point3::new(x, radius * sin, radius * cos)
}

/// Part of a cylinder, 100 mm by 60 mm, with beams of 10 mm between 4 by 2 openings, and the points at its ends;
/// quadrilaterals of 2.5 mm / `finer`.
fn limb(finer: usize) -> (Quads, Vec<usize>) {
    let (nx, ny) = (40 * finer, 24 * finer);
    let opening = |k: usize, from: usize, pitch: usize, wide: usize, count: usize| {
        let k = k / finer;
        k >= from && (k - from) % pitch < wide && (k - from) / pitch < count
    };
    let quads = Quads::grid_with_holes(
        nx,
        ny,
        |x, y| on_limb(0.1 * (x - 0.5), 0.06 * (y - 0.5)),
        |i, j| opening(i, 4, 9, 5, 4) && opening(j, 4, 10, 6, 2),
    );
    let clamped = (0..quads.points.len()).filter(|&n| quads.points[n].x.abs() > 0.05 - 1e-9).collect();
    (quads, clamped)
}

/// Gauges of 8 mm by 5 mm on the beams of the limb, some along it and some across.
fn limb_gauges() -> [Gauge; 6] {
    let gauge = |x: f64, s: f64, along: Vector3<f64>| Gauge {
        centre: on_limb(x, s),
        along,
        length: 0.008,
        width: 0.005,
        face: Face::Inner,
    };
    // The direction of the arc, wherever on the limb: its part in the surface counts.
    let around = Vector3::y();
    [
        gauge(0.0, 0.0, Vector3::x()),
        gauge(0.0, 0.0, around),
        gauge(-0.01125, 0.0, Vector3::x()),
        gauge(0.03375, 0.0, Vector3::x()),
        gauge(0.0, 0.0125, around),
        gauge(0.0225, -0.0125, around),
    ]
}

/// The displacement under a force of 1 N that is spread over the patch, and the strain that each gauge reads: ours, and those of
/// a mesh of 20-node hexahedra, one through the thickness, over the same quadrilaterals.
///
/// What a solid does and a shell leaves out is the shear across the thickness and the dent under the patch; they grow with
/// thickness over span. Strains are compared by the peak of all gauges' references.
///
/// # Errors
///
/// [`CalculixError`] where there is no CalculiX, or it fails, or the shell, its loads or its gauges cannot be.
pub fn panel_cases(panel: &Panel) -> Result<Vec<Case>, CalculixError> {
    let answer = compare(panel)?;
    let peak = answer.strains.iter().fold(0.0f64, |peak, [_, reference]| peak.max(reference.abs()));
    let mut cases = vec![Case::relative(
        format!("shell-ccx-{}-w", panel.name),
        format!(
            "panel with openings, 1 N on a patch of {} mm: displacement in its middle",
            panel.patch * 1e3
        ),
        SOURCE,
        "m",
        answer.displacement,
        panel.within[0],
    )];
    for (k, (strain, gauge)) in answer.strains.into_iter().zip(panel.gauges).enumerate() {
        let ([x, y, z], [a, b, c]): ([f64; 3], [f64; 3]) = ((gauge.centre * 1e3).into(), gauge.along.into());
        cases.push(Case::new(
            format!("shell-ccx-{}-g{k}", panel.name),
            format!(
                "the same: strain of a gauge at ({x:.1}, {y:.1}, {z:.1}) mm along ({a:.2}, {b:.2}, {c:.2})"
            ),
            SOURCE,
            "",
            strain,
            (panel.within[1], peak),
        ));
    }
    Ok(cases)
}

/// Ours and the solid's.
struct Compared {
    /// \[m\] inwards.
    displacement: [f64; 2],
    strains: Vec<[f64; 2]>,
}

/// A panel in both worlds.
struct Both {
    shell: Shell,
    normals: Vec<Vector3<f64>>,
    solid: Quadratic,
    model: Model,
    /// Forces on the shell.
    points: Vec<Share>,
}

impl Both {
    fn new(panel: &Panel) -> Result<Self, CalculixError> {
        let supports: Vec<Support> = panel.clamped.iter().map(|&n| Support::clamped(n)).collect();
        let shell = Shell::new(panel.quads.split(), std::slice::from_ref(panel.section), &supports)?;
        let normals = shell.mesh().normals();
        let (solid, mut model) = solid_of(panel.quads, &normals, panel.section, panel.clamped);
        let place = (&panel.centre, panel.patch);
        let (forces, points) = press(&solid, shell.mesh(), &normals, place, |normal| -normal)?;
        model.loads.push(Load { forces, ..Load::default() });
        Ok(Self { shell, normals, solid, model, points })
    }
}

/// A solid with one hexahedron through the thickness on each quadrilateral, and the model of it, without loads.
fn solid_of(
    quads: &Quads,
    normals: &[Vector3<f64>],
    section: &Section,
    clamped: &[usize],
) -> (Quadratic, Model) {
    let solid = extrude(quads, normals, section.thickness, |p| p);
    let count = normals.len();
    let mut holds = vec![false; count];
    for &n in clamped {
        holds[n] = true;
    }
    let model = Model {
        nodes: solid.nodes.clone(),
        element: "C3D20R",
        elements: solid.cells.clone(),
        young_modulus: section.young_modulus,
        poisson_ratio: section.poisson_ratio,
        held: clamped_nodes(&solid, |n| holds[n % count]),
        large: false,
        sensors: Vec::new(),
        loads: Vec::new(),
    };
    (solid, model)
}

/// What touches the outer face of a shell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// \[m\] its middle.
    pub centre: Point3<f64>,
    /// \[m\] radius R of the patch that it presses on, as (1 − r²/R²)².
    pub patch: f64,
    /// \[N\].
    pub force: Vector3<f64>,
}

/// What each of `gauges` reads of each of `touches` (one list a touch) on a solid over `quads` that is held at the points
/// `clamped`, by 20-node hexahedra, one through the thickness.
///
/// Each gauge is a load and each touch a reading of its displacements: by reciprocity (E. Betti, 1872) the numbers are the
/// same as the other way round, and as many touches as one likes cost a solution for each gauge, all with one factor.
///
/// # Errors
///
/// As [`panel_cases`].
pub fn touch_readings(
    quads: &Quads,
    section: &Section,
    clamped: &[usize],
    gauges: &[Gauge],
    touches: &[Touch],
) -> Result<Vec<Vec<f64>>, CalculixError> {
    let mesh = quads.split();
    let normals = mesh.normals();
    let (solid, mut model) = solid_of(quads, &normals, section, clamped);
    for gauge in gauges {
        let forces = side_strain(&solid, &mesh, &normals, gauge)?;
        model.loads.push(Load { forces, ..Load::default() });
    }
    let answers = model.solve()?;
    touches
        .iter()
        .map(|touch| {
            let place = (&touch.centre, touch.patch);
            let (forces, _) = press(&solid, &mesh, &normals, place, |_| touch.force)?;
            Ok(answers.iter().map(|answer| weighed(&forces, &answer.displacements)).collect())
        })
        .collect()
}

/// How long CalculiX takes for loads on a panel's solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PanelTimes {
    /// For the first.
    pub first: Duration,
    /// For each further one where each is a step of its own, which it factors anew for.
    pub step: Duration,
    /// For each further one where all share a factor.
    pub at_once: Duration,
}

/// Times CalculiX for the load of `panel` and `further` others.
///
/// # Errors
///
/// As [`panel_cases`].
pub fn panel_times(panel: &Panel, further: u32) -> Result<PanelTimes, CalculixError> {
    let Both { normals, mut model, .. } = Both::new(panel)?;
    let time = |model: &Model| {
        let begun = Instant::now();
        model.solve().map(|_| begun.elapsed())
    };
    let first = time(&model)?;
    let each = |all: Duration| all.saturating_sub(first) / further.max(1);
    let load = model.loads.remove(0);
    // The same load again has no force of its own, and is solved by a step.
    model.loads = vec![load.clone(); 1 + further as usize];
    let step = each(time(&model)?);
    // On one corner of the outer face each.
    let taken: HashSet<usize> =
        load.forces.iter().map(|(n, _)| *n).chain(model.held.iter().map(|(n, _)| *n)).collect();
    let corners = normals.len();
    let others = (corners..2 * corners).filter(|n| !taken.contains(n)).take(further as usize);
    let others = others.map(|n| Load { forces: vec![(n, -normals[n - corners])], ..Load::default() });
    model.loads = std::iter::once(load).chain(others).collect();
    let at_once = each(time(&model)?);
    Ok(PanelTimes { first, step, at_once })
}

fn compare(panel: &Panel) -> Result<Compared, CalculixError> {
    let Both { shell, normals, solid, model, points } = Both::new(panel)?;
    let mesh = shell.mesh();
    // The node that is nearest to the patch's middle, and the one in the solid's middle surface there.
    let nearest = |nodes: &[Point3<f64>], place: &Point3<f64>| {
        let distance = |n: &usize| (nodes[*n] - place).norm_squared();
        (0..nodes.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    };
    let under = nearest(&mesh.points, &panel.centre);
    let middle = nearest(&solid.nodes, &mesh.points[under]);
    let answers = model.solve()?;
    let solid_moved = &answers[0].displacements;

    // The same forces on the corners of the triangles under them.
    let mut acting = Vec::new();
    for (point, force) in &points {
        let Some(foot) = Foot::new(mesh, &normals, point) else { return Err(CalculixError::Results("node")) };
        for (n, share) in mesh.triangles[foot.triangle].iter().zip(foot.at) {
            acting.push(Action::force(*n as usize, force * share));
        }
    }
    let moved = shell.solve(&[Action::sum(acting.iter().map(|a| (1.0, a)))])?.remove(0);
    let strains = panel
        .gauges
        .iter()
        .map(|gauge| {
            let row = side_strain(&solid, mesh, &normals, gauge)?;
            Ok([moved.dot(&shell.gauge(gauge)?.row), weighed(&row, solid_moved)])
        })
        .collect::<Result<Vec<_>, CalculixError>>()?;
    let normal = normals[under];
    Ok(Compared {
        displacement: [-moved.displacement(under).dot(&normal), -solid_moved[middle].dot(&normal)],
        strains,
    })
}

/// A hexahedron on each quadrilateral, through all of the thickness: its first side is the inner one. Nodes of the inner face, then
/// those of the outer one, then the edges' middles.
fn extrude(
    quads: &Quads,
    normals: &[Vector3<f64>],
    thickness: f64,
    place: impl Fn(Point3<f64>) -> Point3<f64>,
) -> Quadratic {
    let face = |height: f64| {
        quads.points.iter().zip(normals).map(move |(p, n)| p + n * (height * thickness)).collect::<Vec<_>>()
    };
    let mut nodes = face(-0.5);
    nodes.extend(face(0.5));
    let count = quads.points.len() as u32;
    let cells = quads
        .quads
        .iter()
        .map(|&[a, b, c, d]| [a, b, c, d, a + count, b + count, c + count, d + count])
        .collect();
    Quadratic::new(&HexMesh { nodes, cells }, place)
}

/// Corners that are held, and the middles of the edges between two of them.
fn clamped_nodes(solid: &Quadratic, clamped: impl Fn(usize) -> bool) -> Vec<(usize, [bool; 3])> {
    let mut held = vec![false; solid.nodes.len()];
    for cell in &solid.cells {
        for &n in &cell[..8] {
            held[n] = clamped(n);
        }
        for (edge, [a, b]) in EDGES.into_iter().enumerate() {
            held[cell[8 + edge]] |= clamped(cell[a]) && clamped(cell[b]);
        }
    }
    (0..held.len()).filter(|&n| held[n]).map(|n| (n, [true; 3])).collect()
}

/// The roof of Scordelis and Lo, a quarter of it, 8 by 8 cells: displacement of the free edge's middle.
fn roof() -> Result<Case, CalculixError> {
    let (radius, half, angle, thickness) = (25.0, 25.0, 40f64.to_radians(), 0.25);
    let (young_modulus, weight) = (4.32e8, 90.0);
    let at = |x: f64, y: f64| {
        let (s, c) = (angle * y).sin_cos();
        Point3::new(half * x, radius * s, radius * c)
    };
    let quads = Quads::grid(8, 8, at);
    let normals: Vec<Vector3<f64>> =
        quads.points.iter().map(|p| Vector3::new(0.0, p.y, p.z).normalize()).collect();
    // Middles of the arcs lie on them.
    let solid = extrude(&quads, &normals, thickness, |p| {
        let from_axis = p.y.hypot(p.z);
        let layer = ((from_axis - radius) / (thickness / 2.0)).round();
        let out = (radius + layer * thickness / 2.0) / from_axis;
        Point3::new(p.x, p.y * out, p.z * out)
    });
    // Half of it on each face, so that it pulls at the middle surface.
    let mut forces = Vec::new();
    for (side, height) in [(FIRST_SIDE, -0.5), (LAST_SIDE, 0.5)] {
        let share = 0.5 * radius / (radius + height * thickness);
        let traction = Vector3::z() * (-weight * share);
        forces.extend(solid.spread_over(side, 0..solid.cells.len(), |_| traction).0);
    }
    let held = solid
        .nodes
        .iter()
        .enumerate()
        .map(|(n, p)| {
            let end = p.x > half - 1e-9;
            (n, [p.x < 1e-9, p.y < 1e-9 || end, end])
        })
        .collect();
    let edge = at(0.0, 1.0);
    let place = |p: &Point3<f64>| (p - edge).norm_squared();
    let free =
        (0..solid.nodes.len()).min_by(|&a, &b| place(&solid.nodes[a]).total_cmp(&place(&solid.nodes[b])));
    let model = Model {
        nodes: solid.nodes,
        element: "C3D20R",
        elements: solid.cells,
        young_modulus,
        poisson_ratio: 0.0,
        held,
        large: false,
        sensors: Vec::new(),
        loads: vec![Load { forces, ..Load::default() }],
    };
    let answer = model.solve()?;
    let reference = -answer[0].displacements[free.unwrap_or(0)].z;
    Ok(Case::relative(
        "shell-ccx-roof",
        "Scordelis-Lo roof, 32 by 32 cells: displacement of the free edge's middle",
        SOURCE,
        "m",
        [crate::shell::roof_displacement(32)?, reference],
        0.01,
    ))
}
