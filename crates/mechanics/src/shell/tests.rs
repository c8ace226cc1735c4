use nalgebra::{Matrix3, Rotation3, SVector};

use super::*;

/// A plate of 60 mm by 40 mm whose inner nodes are not in rows, as `turn` puts it.
fn patch(turn: &Rotation3<f64>) -> (ShellMesh, Vec<Point3<f64>>) {
    let flat = Quads::grid(6, 4, |x, y| {
        let k = (6.0 * x + 28.0 * y).round() as u32 + 1;
        let inner = x > 0.0 && x < 1.0 && y > 0.0 && y < 1.0;
        let shift = if inner { 0.003 * (f64::from(k * k % 17) / 8.0 - 1.0) } else { 0.0 };
        Point3::new(0.060 * x + shift, 0.040 * y - 0.7 * shift, 0.0)
    })
    .split();
    let mesh = ShellMesh { points: flat.points.iter().map(|p| turn * p).collect(), ..flat.clone() };
    (mesh, flat.points)
}

fn turns() -> [Rotation3<f64>; 2] {
    [Rotation3::identity(), Rotation3::from_euler_angles(0.7, -0.4, 1.9)]
}

fn free(mesh: ShellMesh) -> Shell {
    // Held so that it can be factored; what is tested does not need that.
    Shell::new(mesh, &[Section::isotropic(2e9, 0.35, 0.002)], &[Support::clamped(0)]).unwrap()
}

/// Forces and moments on the nodes that make a deformation.
fn forces(shell: &Shell, u: &Deformation) -> Vec<f64> {
    let mut out = vec![0.0; u.0.len()];
    for (element, t) in shell.elements.iter().zip(&shell.mesh.triangles) {
        let freedom = |i: usize| FREEDOMS * t[i / FREEDOMS] as usize + i % FREEDOMS;
        let own = SVector::<f64, 18>::from_fn(|i, _| u.0[freedom(i)]);
        for (i, f) in (element.stiffness_in_link() * own).iter().enumerate() {
            out[freedom(i)] += f;
        }
    }
    out
}

/// Strain of the middle surface and curvature, the same everywhere, on the patch: displacements and rotations.
fn constant(
    flat: &[Point3<f64>],
    turn: &Rotation3<f64>,
    [ex, ey, gxy]: [f64; 3],
    [kx, ky, kxy]: [f64; 3],
) -> Deformation {
    let values = flat.iter().flat_map(|p| {
        let (x, y) = (p.x, p.y);
        let moved = Vector3::new(
            ex * x + 0.25 * gxy * y,
            ey * y + 0.75 * gxy * x,
            -(kx * x * x + ky * y * y + kxy * x * y) / 2.0,
        );
        let slope = [-kx * x - kxy * y / 2.0, -ky * y - kxy * x / 2.0];
        let turned = Vector3::new(slope[1], -slope[0], 0.25 * gxy);
        let (moved, turned) = (turn * moved, turn * turned);
        [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z]
    });
    Deformation(values.collect())
}

#[test]
fn constant_strain_and_curvature_are_exact() {
    for turn in turns() {
        for (strain, curvature) in [([1e-3, -2e-4, 7e-4], [0.0; 3]), ([0.0; 3], [0.4, -0.3, 0.7])] {
            let (mesh, flat) = patch(&turn);
            let shell = free(mesh);
            let u = constant(&flat, &turn, strain, curvature);
            let forces = forces(&shell, &u);
            let scale = forces.iter().fold(0.0f64, |m, f| m.max(f.abs()));
            for (n, p) in flat.iter().enumerate() {
                if p.x > 1e-9 && p.x < 0.060 - 1e-9 && p.y > 1e-9 && p.y < 0.040 - 1e-9 {
                    for f in &forces[6 * n..6 * n + 6] {
                        assert!(f.abs() < 1e-10 * scale, "node {n}: {f} of {scale}");
                    }
                }
            }
            // Gauges read it, too.
            for angle in [0.0f64, 0.6, 2.0] {
                let (s, c) = angle.sin_cos();
                let along = Vector3::new(c, s, 0.0);
                for (face, height) in [(Face::Inner, -0.001), (Face::Middle, 0.0), (Face::Outer, 0.001)] {
                    let gauge = Gauge {
                        centre: turn * Point3::new(0.031, 0.019, 0.0),
                        along: turn * along,
                        length: 0.008,
                        width: 0.005,
                        face,
                    };
                    let reading = shell.gauge(&gauge).unwrap();
                    let e: [f64; 3] = std::array::from_fn(|k| strain[k] + height * curvature[k]);
                    let exact = c * c * e[0] + s * s * e[1] + c * s * e[2];
                    assert!((reading.covered - 1.0).abs() < 1e-9, "{}", reading.covered);
                    assert!(
                        (u.dot(&reading.row) - exact).abs() < 1e-12,
                        "{} for {exact}",
                        u.dot(&reading.row)
                    );
                }
            }
        }
    }
}

#[test]
fn constant_strain_has_its_energy() {
    let (mesh, flat) = patch(&turns()[1]);
    let shell = free(mesh);
    let (young, poisson, h, area) = (2e9, 0.35, 0.002, 0.060 * 0.040);
    let plane = young / (1.0 - poisson * poisson);
    let d = Matrix3::new(1.0, poisson, 0.0, poisson, 1.0, 0.0, 0.0, 0.0, (1.0 - poisson) / 2.0) * plane;
    let (strain, curvature) = ([1e-3, -2e-4, 7e-4], [0.4, -0.3, 0.7]);
    let (e, k) = (Vector3::from(strain), Vector3::from(curvature));
    let exact = area / 2.0 * (h * e.dot(&(d * e)) + h * h * h / 12.0 * k.dot(&(d * k)));
    let got = shell.energy(&constant(&flat, &turns()[1], strain, curvature));
    assert!((got / exact - 1.0).abs() < 1e-10, "{got} for {exact}");
}

#[test]
fn an_orthotropic_strip_is_as_stiff_as_its_direction() {
    let mesh = Quads::grid(30, 4, |x, y| Point3::new(0.1 * x, 0.01 * (y - 0.5), 0.0)).split();
    let held: Vec<Support> =
        (0..mesh.points.len()).filter(|n| mesh.points[*n].x == 0.0).map(Support::clamped).collect();
    let tip = mesh.points.iter().position(|p| *p == Point3::new(0.1, 0.0, 0.0)).unwrap();
    let bend = |direction: Vector3<f64>, ratio: f64| {
        let section = Section {
            orthotropy: Some(Orthotropy { ratio, direction }),
            ..Section::isotropic(2e9, 0.0, 0.002)
        };
        let shell = Shell::new(mesh.clone(), &[section], &held).unwrap();
        shell.solve(&[Action::force(tip, Vector3::z())]).unwrap()[0].displacement(tip).z
    };
    let exact = |young: f64| 4.0 * 0.1f64.powi(3) / (young * 0.01 * 0.002f64.powi(3));
    assert!((bend(Vector3::x(), 0.6) / exact(2e9) - 1.0).abs() < 0.005);
    assert!((bend(Vector3::new(0.0, 3.0, 1.0), 0.6) / exact(1.2e9) - 1.0).abs() < 0.005);
}

/// Bent in its plane: what a narrow beam does, where a triangle without drilling rotations locks.
#[test]
fn a_narrow_beam_bends_in_its_plane() {
    let (length, width, h, young) = (0.060, 0.010, 0.002, 2e9);
    for (cells, within) in [(2, 0.10), (4, 0.05), (8, 0.01)] {
        let mesh =
            Quads::grid(6 * cells, cells, |x, y| Point3::new(length * x, width * (y - 0.5), 0.0)).split();
        let held: Vec<Support> =
            (0..mesh.points.len()).filter(|n| mesh.points[*n].x == 0.0).map(Support::clamped).collect();
        let tip: Vec<usize> = (0..mesh.points.len()).filter(|n| mesh.points[*n].x > length - 1e-9).collect();
        let shell = Shell::new(mesh, &[Section::isotropic(young, 0.3, h)], &held).unwrap();
        let moments: Vec<Action> =
            tip.iter().map(|n| Action::force(*n, Vector3::y() / tip.len() as f64)).collect();
        let load = Action::sum(moments.iter().map(|m| (1.0, m)));
        let answer = shell.solve(&[load]).unwrap().remove(0);
        let moment_of_area = h * width.powi(3) / 12.0;
        // Euler's beam and its shear.
        let shear = 1.2 * length * 2.6 / (young * h * width);
        let exact = length.powi(3) / (3.0 * young * moment_of_area) + shear;
        let got = answer.displacement(tip[0]).y;
        assert!((got / exact - 1.0).abs() < 0.01, "{cells} cells: {got} for {exact}");
        // At the edge, where the strain is largest, mean over the gauge.
        let gauge = Gauge {
            centre: Point3::new(0.030, 0.0030, 0.0),
            along: Vector3::x(),
            length: 0.008,
            width: 0.003,
            face: Face::Middle,
        };
        let strain = answer.dot(&shell.gauge(&gauge).unwrap().row);
        let exact = -(length - 0.030) * 0.0030 / (young * moment_of_area);
        assert!((strain / exact - 1.0).abs() < within, "{cells} cells: {strain} for {exact}");
    }
}

/// A piece of a cylinder with holes, clamped at both ends.
fn panel() -> (ShellMesh, Vec<Support>) {
    let mesh = Quads::grid_with_holes(
        20,
        12,
        |x, y| {
            let (s, c) = (1.2 * (y - 0.5)).sin_cos();
            Point3::new(0.1 * x, -0.045 * -s, 0.045 * c)
        },
        |i, j| i % 5 == 2 && j % 4 == 1,
    )
    .split();
    let ends = |p: &Point3<f64>| p.x < 1e-9 || p.x > 0.1 - 1e-9;
    let supports = (0..mesh.points.len()).filter(|n| ends(&mesh.points[*n])).map(Support::clamped).collect();
    (mesh, supports)
}

#[test]
fn quads_come_back_from_their_triangles() {
    let (mesh, _) = panel();
    let quads = Quads::join(&mesh).unwrap();
    assert_eq!(2 * quads.quads.len(), mesh.triangles.len());
    let area = |m: &ShellMesh| m.areas().iter().sum::<f64>();
    let again = quads.split();
    assert!((area(&again) / area(&mesh) - 1.0).abs() < 1e-3);
    assert!(again.normals().iter().zip(mesh.normals()).all(|(a, b)| a.dot(&b) > 0.99));
    let apart = ShellMesh { triangles: mesh.triangles[1..].to_vec(), ..mesh };
    assert_eq!(Quads::join(&apart), None);
}

#[test]
fn influence_is_what_loads_do() {
    let (mesh, supports) = panel();
    let normals = mesh.normals();
    assert!(normals.iter().all(|n| n.z > 0.0));
    let shell = Shell::new(mesh, &[Section::isotropic(1.7e9, 0.394, 0.0025)], &supports).unwrap();
    let gauge = Gauge {
        centre: Point3::new(0.05, 0.0, 0.045),
        along: Vector3::x(),
        length: 0.008,
        width: 0.005,
        face: Face::Inner,
    };
    let reading = shell.gauge(&gauge).unwrap();
    let influence = shell.solve(std::slice::from_ref(&reading.row)).unwrap().remove(0);
    let nodes: Vec<usize> = (0..normals.len()).step_by(7).collect();
    let loads: Vec<Action> = nodes.iter().map(|n| Action::force(*n, -normals[*n])).collect();
    let answers = shell.solve(&loads).unwrap();
    let peak = answers.iter().fold(0.0f64, |m, a| m.max(a.dot(&reading.row).abs()));
    for (load, answer) in loads.iter().zip(&answers) {
        let (direct, adjoint) = (answer.dot(&reading.row), influence.dot(load));
        assert!((direct - adjoint).abs() < 1e-9 * peak, "{direct} and {adjoint}");
    }
    // And Green's columns hold the same displacements.
    let green = shell.normal_green(&normals).unwrap();
    for (n, answer) in nodes.iter().zip(&answers) {
        for (m, got) in green.column(*n).iter().enumerate() {
            let direct = -answer.displacement(m).dot(&normals[m]);
            assert!((f64::from(*got) - direct).abs() < 1e-6 * f64::from(green.column(*n)[*n].abs()) + 1e-15);
            assert!((green.column(m)[*n] - got).abs() <= 1e-6 * green.column(*n)[*n].abs());
        }
    }
}

#[test]
fn a_gauge_says_how_much_of_it_lies_on_material() {
    let mesh = Quads::grid(10, 10, |x, y| Point3::new(0.1 * x, 0.1 * y, 0.0)).split();
    let shell = free(mesh);
    let gauge = |x: f64, y: f64| Gauge {
        centre: Point3::new(x, y, 0.0),
        along: Vector3::x(),
        length: 0.008,
        width: 0.004,
        face: Face::Inner,
    };
    let covered = |x, y| shell.gauge(&gauge(x, y)).unwrap().covered;
    assert!((covered(0.0497, 0.0503) - 1.0).abs() < 1e-12);
    // The nearest point of the edge is a corner of the shell: the footprint's plane touches there.
    assert!((covered(0.0, 0.05) - 0.5).abs() < 1e-12);
    assert!((covered(0.1, 0.1) - 0.25).abs() < 1e-12);
    let error = shell.gauge(&Gauge { along: Vector3::z(), ..gauge(0.05, 0.05) }).unwrap_err();
    assert!(matches!(error, MechanicsError::Value { .. }), "{error}");
    let error = shell.gauge(&Gauge { width: 0.0, ..gauge(0.05, 0.05) }).unwrap_err();
    assert!(matches!(error, MechanicsError::Value { .. }), "{error}");
}

#[test]
fn springs_hold_as_clamps_do_when_stiff() {
    let (mesh, clamps) = panel();
    let section = [Section::isotropic(1.7e9, 0.394, 0.0025)];
    let under = mesh.points.iter().position(|p| (p - Point3::new(0.05, 0.0, 0.045)).norm() < 0.003).unwrap();
    let sinks = |supports: &[Support]| {
        let shell = Shell::new(mesh.clone(), &section, supports).unwrap();
        -shell.solve(&[Action::force(under, -Vector3::z())]).unwrap()[0].displacement(under).z
    };
    let springs = |k: f64| clamps.iter().map(|c| Support::spring(c.node, k, 1e-4 * k)).collect::<Vec<_>>();
    let clamped = sinks(&clamps);
    assert!((sinks(&springs(1e12)) / clamped - 1.0).abs() < 1e-4);
    assert!(sinks(&springs(1e5)) > 1.05 * clamped);
}

#[test]
fn what_cannot_be_solved_is_refused_in_words() {
    let (mesh, clamps) = panel();
    let section = Section::isotropic(1.7e9, 0.394, 0.0025);
    let refuse = |mesh: &ShellMesh, sections: &[Section], supports: &[Support]| {
        Shell::new(mesh.clone(), sections, supports).unwrap_err().to_string()
    };
    let ok = std::slice::from_ref(&section);
    insta::assert_snapshot!(refuse(&mesh, ok, &[]), @"nothing keeps the part of the shell around node 0 from moving or turning: hold more of its nodes");
    // Three translations of one node leave all turns free.
    let pin = Support::held(3, [true, true, true, false, false, false]);
    assert!(refuse(&mesh, ok, &[pin]).starts_with("nothing keeps"));
    let mut lonely = mesh.clone();
    lonely.points.push(Point3::origin());
    let last = lonely.points.len() - 1;
    assert_eq!(refuse(&lonely, ok, &clamps), format!("node {last} of the shell belongs to no triangle"));
    let mut flat = mesh.clone();
    flat.triangles[4][1] = flat.triangles[4][0];
    insta::assert_snapshot!(refuse(&flat, ok, &clamps), @"triangle 4 of the shell has the same corner twice");
    let mut far = mesh.clone();
    far.triangles[4][1] = 9999;
    insta::assert_snapshot!(refuse(&far, ok, &clamps), @"triangle 4 of the shell has a corner that is not among the points");
    let mut nowhere = mesh.clone();
    nowhere.points[5].x = f64::NAN;
    insta::assert_snapshot!(refuse(&nowhere, ok, &clamps), @"node 5 of the shell is not a place: its coordinates are not finite");
    insta::assert_snapshot!(refuse(&mesh, &[section.clone(), section.clone()], &clamps), @"there are 2 sections of the shell, and 456 are needed");
    let thin = Section { thickness: 0.0, ..section.clone() };
    insta::assert_snapshot!(refuse(&mesh, &[thin], &clamps), @"thickness of the shell [m] is 0 and must be a positive number");
    let beyond = [Support::clamped(9999)];
    insta::assert_snapshot!(refuse(&mesh, ok, &beyond), @"node 9999 of the shell is held, but there is no such node");
    let soft = [Support { stiffness: [f64::NAN; 6], ..Support::clamped(0) }];
    insta::assert_snapshot!(refuse(&mesh, ok, &soft), @"stiffness of a support [N/m or N·m/rad] is NaN and must be a number of at least 0");
    // A second piece that nothing holds.
    let mut two = mesh.clone();
    let from = two.points.len() as u32;
    two.points.extend([Point3::new(1.0, 0.0, 0.0), Point3::new(1.1, 0.0, 0.0), Point3::new(1.0, 0.1, 0.0)]);
    two.triangles.push([from, from + 1, from + 2]);
    assert_eq!(
        refuse(&two, ok, &clamps),
        format!(
            "nothing keeps the part of the shell around node {from} from moving or turning: hold more of its nodes"
        )
    );
    let shell = Shell::new(mesh.clone(), ok, &clamps).unwrap();
    let error = shell.solve(&[Action::force(9999, Vector3::z())]).unwrap_err();
    assert_eq!(error.to_string(), "node 9999 of the shell has a load, but there is no such node");
    assert!(shell.normal_green(&[Vector3::z()]).is_err());
}

mod corotation {
    use super::*;

    /// The tangent's first step is the linear shell.
    #[test]
    fn small_loads_move_it_as_the_linear_shell() {
        let (mesh, clamps) = panel();
        let section = [Section::isotropic(1.7e9, 0.394, 0.0025)];
        let load = Action::force(130, Vector3::new(1e-3, 2e-3, -1e-2));
        let linear = Shell::new(mesh.clone(), &section, &clamps).unwrap();
        let bent = Corotational::new(mesh, &section, &clamps).unwrap();
        let (a, b) = (
            linear.solve(std::slice::from_ref(&load)).unwrap().remove(0),
            bent.equilibria(&load, &[1.0]).unwrap(),
        );
        let scale = a.values().iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for (a, b) in a.values().iter().zip(b[0].deformation.values()) {
            assert!((a - b).abs() < 1e-5 * scale, "{a} {b}");
        }
        let gauge = Gauge {
            centre: Point3::new(0.05, 0.0, 0.045),
            along: Vector3::x(),
            length: 0.008,
            width: 0.005,
            face: Face::Inner,
        };
        let (c, d) = (a.dot(&linear.gauge(&gauge).unwrap().row), bent.strain(&b[0], &gauge).unwrap());
        assert!((c / d - 1.0).abs() < 1e-4, "{c} {d}");
    }

    /// A strip under a moment at its end becomes a part of a circle: rotations of 90° and more.
    #[test]
    fn a_strip_rolls_up() {
        let (length, width, h, young) = (1.0, 0.1, 0.01, 1e9);
        let mesh = Quads::grid(20, 1, |x, y| Point3::new(length * x, width * y, 0.0)).split();
        let held: Vec<Support> =
            (0..mesh.points.len()).filter(|n| mesh.points[*n].x == 0.0).map(Support::clamped).collect();
        let tip: Vec<usize> = (0..mesh.points.len()).filter(|n| mesh.points[*n].x > length - 1e-9).collect();
        let shell = Corotational::new(mesh, &[Section::isotropic(young, 0.0, h)], &held).unwrap();
        let angle = std::f64::consts::FRAC_PI_2;
        let moment = young * width * h.powi(3) / 12.0 * angle / length;
        let parts: Vec<Action> =
            tip.iter().map(|n| Action::moment(*n, -Vector3::y() * (moment / 2.0))).collect();
        let load = Action::sum(parts.iter().map(|p| (1.0, p)));
        let bent = shell.equilibria(&load, &[0.25, 0.5, 0.75, 1.0]).unwrap();
        let end = bent[3].deformation.displacement(tip[0]);
        let radius = length / angle;
        let exact = Vector3::new(radius * angle.sin() - length, 0.0, radius * (1.0 - angle.cos()));
        assert!((end - exact).norm() < 0.01 * exact.norm(), "{end} for {exact}");
    }
}
