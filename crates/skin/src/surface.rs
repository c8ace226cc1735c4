//! Triangulated outside of a skin.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use crate::description::SurfaceSpec;
use crate::mesh;
use crate::panel::Panel;

/// Triangulated outside of a skin, in the frame of its link.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// \[m\], n points.
    pub points: Vec<Point3<f64>>,
    /// Unit, out of the skin, one a point.
    pub normals: Vec<Vector3<f64>>,
    /// \[m²\] of the surface around each point; they sum to the area of the triangles.
    pub areas: Vec<f64>,
    /// Indices of points, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    spec: SurfaceSpec,
    panel: Option<Panel>,
}

impl Surface {
    /// The surface that a description names. The description has been checked: sizes are positive.
    #[must_use]
    pub fn from_spec(spec: &SurfaceSpec) -> Self {
        let (points, normals, triangles) = match *spec {
            SurfaceSpec::Rectangle { size, spacing } => rectangle(size, spacing),
            SurfaceSpec::Dome { radius, cylinder, spacing } => dome(radius, cylinder, spacing),
            SurfaceSpec::Panel { spacing, .. } => {
                spec.panel().map(|panel| panel.triangulate(spacing)).unwrap_or_default()
            }
            SurfaceSpec::Mesh { ref mesh, .. } => mesh.triangulation(),
            SurfaceSpec::Family(ref shape) => shape.mesh.triangulation(),
        };
        let mut areas = vec![0.0; points.len()];
        for t in &triangles {
            let [a, b, c] = t.map(|i| points[i as usize]);
            let third = (b - a).cross(&(c - a)).norm() / 6.0;
            for &i in t {
                areas[i as usize] += third;
            }
        }
        Self { points, normals, areas, triangles, panel: spec.panel(), spec: spec.clone() }
    }

    /// Closest point of the ideal (not the triangulated) surface, and its outward normal; on a panel the closest one along it,
    /// on a mesh that of its triangles.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> (Point3<f64>, Vector3<f64>) {
        match self.spec {
            SurfaceSpec::Rectangle { size, .. } => {
                let [hx, hy] = size.map(|s| s / 2.0);
                (Point3::new(point.x.clamp(-hx, hx), point.y.clamp(-hy, hy), 0.0), Vector3::z())
            }
            SurfaceSpec::Dome { radius, cylinder, .. } => {
                // The tip of the dome is up; the origin lies in the base of the cylinder.
                let axis_z = point.z.clamp(0.0, cylinder);
                let offset = if point.z > cylinder {
                    point - Point3::new(0.0, 0.0, cylinder)
                } else {
                    Vector3::new(point.x, point.y, 0.0)
                };
                let normal = offset.try_normalize(1e-12).unwrap_or_else(Vector3::z);
                (Point3::new(0.0, 0.0, axis_z) + normal * radius, normal)
            }
            // The description has been checked: there is a panel.
            SurfaceSpec::Panel { .. } => self
                .panel
                .as_ref()
                .map_or((*point, Vector3::z()), |panel| panel.roll(panel.nearest(panel.unroll(point)))),
            SurfaceSpec::Mesh { ref mesh, .. } => mesh.project(point),
            SurfaceSpec::Family(ref shape) => shape.mesh.project(point),
        }
    }

    /// Length \[m\] of the shortest way along the ideal surface between two points; what lies off it is projected first. Around
    /// the openings of a panel, and on a mesh, that of the shortest way over the triangulation, which is longer by some percent:
    /// it takes milliseconds; see [`ways_from`](Self::ways_from) for many.
    #[must_use]
    pub fn geodesic(&self, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
        let (a, b) = (self.project(from).0, self.project(to).0);
        let (radius, cylinder) = match (&self.spec, &self.panel) {
            (SurfaceSpec::Dome { radius, cylinder, .. }, _) => (*radius, *cylinder),
            (SurfaceSpec::Rectangle { .. }, _) => return (a - b).norm(),
            (_, panel) => {
                if let Some(panel) = panel {
                    let (a, b) = (panel.unroll(&a), panel.unroll(&b));
                    if panel.sees(a, b) {
                        return (a[0] - b[0]).hypot(a[1] - b[1]);
                    }
                }
                let ways = self.ways_from(&a);
                let around = self.around(&b);
                let last = |i: &u32| ways[*i as usize] + (self.points[*i as usize] - b).norm();
                return around.iter().map(last).fold(f64::INFINITY, f64::min);
            }
        };
        let centre = Point3::new(0.0, 0.0, cylinder);
        let azimuth = |p: &Point3<f64>| p.y.atan2(p.x);
        let arc = |p: &Point3<f64>, q: &Point3<f64>| {
            let (u, v) = (p - centre, q - centre);
            radius * u.cross(&v).norm().atan2(u.dot(&v))
        };
        let turn = |by: f64| (by + PI).rem_euclid(TAU) - PI;
        match (a.z > cylinder, b.z > cylinder) {
            (true, true) => arc(&a, &b),
            // Unrolled. The way over the hemisphere is never shorter: it meets the equator, which is straight on both.
            (false, false) => (radius * turn(azimuth(&b) - azimuth(&a))).hypot(b.z - a.z),
            (low_is_b, _) => {
                let (low, high) = if low_is_b { (b, a) } else { (a, b) };
                let across = turn(azimuth(&high) - azimuth(&low));
                let through = |share: f64| {
                    let angle = share * across;
                    let (sin, cos) = (azimuth(&low) + angle).sin_cos();
                    let equator = Point3::new(radius * cos, radius * sin, cylinder);
                    (radius * angle).hypot(cylinder - low.z) + arc(&equator, &high)
                };
                // Where the way crosses the equator: near the best of some locations, the length has one minimum.
                let locations = (0..=16).map(|i| f64::from(i) / 16.0);
                let near = locations.min_by(|p, q| through(*p).total_cmp(&through(*q))).unwrap_or(0.0);
                let (mut from, mut to) = ((near - 1.0 / 16.0).max(0.0), (near + 1.0 / 16.0).min(1.0));
                for _ in 0..30 {
                    let third = (to - from) / 3.0;
                    if through(from + third) < through(to - third) {
                        to -= third;
                    } else {
                        from += third;
                    }
                }
                through(f64::midpoint(from, to))
            }
        }
    }

    /// [`geodesic`](Self::geodesic) from one point to each of others; on a mesh at the cost of one.
    #[must_use]
    pub fn geodesics(&self, from: &Point3<f64>, to: &[Point3<f64>]) -> Vec<f64> {
        if self.has_closed_form() {
            return to.iter().map(|p| self.geodesic(from, p)).collect();
        }
        let ways = self.ways_from(&self.project(from).0);
        let length = |p: &Point3<f64>| {
            let on = self.project(p).0;
            let last = |i: u32| ways[i as usize] + (self.points[i as usize] - on).norm();
            self.around(&on).into_iter().map(last).fold(f64::INFINITY, f64::min)
        };
        to.iter().map(length).collect()
    }

    /// Whether distances along the surface follow from a formula (around the openings of a panel they do not); otherwise they are
    /// looked for over the triangulation.
    #[must_use]
    pub fn has_closed_form(&self) -> bool {
        !matches!(self.spec, SurfaceSpec::Mesh { .. } | SurfaceSpec::Family(_))
    }

    /// Lengths \[m\] of the shortest ways over the triangulation from a place on it to each of its points; infinite where there is
    /// none. They follow edges and diagonals, and so are some percent longer than those along the ideal surface.
    #[must_use]
    pub fn ways_from(&self, place: &Point3<f64>) -> Vec<f64> {
        mesh::ways(&self.points, &self.triangles, place, &self.around(place))
    }

    /// Corners of the triangle whose middle is closest to a place.
    fn around(&self, place: &Point3<f64>) -> Vec<u32> {
        let off = |t: &&[u32; 3]| {
            let middle = t.iter().map(|i| self.points[*i as usize].coords).sum::<Vector3<f64>>() / 3.0;
            (place.coords - middle).norm_squared()
        };
        let nearest = self.triangles.iter().min_by(|s, t| off(s).total_cmp(&off(t)));
        nearest.map_or_else(Vec::new, |t| t.to_vec())
    }

    /// Distance of `point` from the ideal surface \[m\].
    #[must_use]
    pub fn distance(&self, point: &Point3<f64>) -> f64 {
        (point - self.project(point).0).norm()
    }
}

/// Points, normals, triangles.
pub(crate) type Triangulation = (Vec<Point3<f64>>, Vec<Vector3<f64>>, Vec<[u32; 3]>);

fn rectangle([lx, ly]: [f64; 2], spacing: f64) -> Triangulation {
    let cells = |length: f64| (length / spacing).round().max(1.0) as u32;
    let (nx, ny) = (cells(lx), cells(ly));
    let mut points = Vec::new();
    for j in 0..=ny {
        for i in 0..=nx {
            let along = |k: u32, n: u32, length: f64| (f64::from(k) / f64::from(n) - 0.5) * length;
            points.push(Point3::new(along(i, nx, lx), along(j, ny, ly), 0.0));
        }
    }
    let mut triangles = Vec::new();
    for j in 0..ny {
        for i in 0..nx {
            let a = j * (nx + 1) + i;
            let (b, c, d) = (a + 1, a + nx + 1, a + nx + 2);
            triangles.push([a, b, d]);
            triangles.push([a, d, c]);
        }
    }
    let normals = vec![Vector3::z(); points.len()];
    (points, normals, triangles)
}

fn dome(radius: f64, cylinder: f64, spacing: f64) -> Triangulation {
    use std::f64::consts::FRAC_PI_2;
    let around = (TAU * radius / spacing).round().max(8.0) as u32;
    let up = (cylinder / spacing).round().max(1.0) as u32;
    let over = (FRAC_PI_2 * radius / spacing).round().max(2.0) as u32;
    // Rings from the base up; the last ring of the cylinder is the equator of the hemisphere.
    let mut rings: Vec<(f64, f64, f64)> =
        (0..=up).map(|k| (f64::from(k) / f64::from(up) * cylinder, 1.0, 0.0)).collect();
    rings.extend((1..over).map(|k| {
        let (sin, cos) = (f64::from(k) / f64::from(over) * FRAC_PI_2).sin_cos();
        (cylinder + radius * sin, cos, sin)
    }));
    let mut points = Vec::new();
    let mut normals = Vec::new();
    for &(z, cos, sin) in &rings {
        for k in 0..around {
            let (s, c) = (f64::from(k) / f64::from(around) * TAU).sin_cos();
            points.push(Point3::new(radius * cos * c, radius * cos * s, z));
            normals.push(Vector3::new(cos * c, cos * s, sin));
        }
    }
    let tip = points.len() as u32;
    points.push(Point3::new(0.0, 0.0, cylinder + radius));
    normals.push(Vector3::z());
    let mut triangles = Vec::new();
    let last = rings.len() as u32 - 1;
    for ring in 0..=last {
        for k in 0..around {
            let next = (k + 1) % around;
            let (a, b) = (ring * around + k, ring * around + next);
            if ring == last {
                triangles.push([a, b, tip]);
            } else {
                let (c, d) = (a + around, b + around);
                triangles.push([a, b, d]);
                triangles.push([a, d, c]);
            }
        }
    }
    (points, normals, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn outward(surface: &Surface) -> bool {
        surface.triangles.iter().all(|t| {
            let [a, b, c] = t.map(|i| surface.points[i as usize]);
            (b - a).cross(&(c - a)).dot(&surface.normals[t[0] as usize]) > 0.0
        })
    }

    #[test]
    fn areas_sum_to_the_rectangle() {
        let s = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.034, 0.02], spacing: 0.003 });
        approx::assert_relative_eq!(s.areas.iter().sum::<f64>(), 0.034 * 0.02, max_relative = 1e-12);
        assert!(outward(&s));
    }

    #[test]
    fn areas_approach_the_dome() {
        let (r, h) = (0.010, 0.016);
        let s = Surface::from_spec(&SurfaceSpec::Dome { radius: r, cylinder: h, spacing: 0.0005 });
        let exact = TAU * r * (h + r);
        approx::assert_relative_eq!(s.areas.iter().sum::<f64>(), exact, max_relative = 2e-3);
        assert!(outward(&s));
        for (p, n) in s.points.iter().zip(&s.normals) {
            let (q, m) = s.project(p);
            assert!((p - q).norm() < 1e-12 && (n - m).norm() < 1e-9);
        }
    }

    #[test]
    fn ways_along_a_dome() {
        let s = Surface::from_spec(&SurfaceSpec::Dome { radius: 0.010, cylinder: 0.016, spacing: 0.002 });
        let cylinder = |angle: f64, z: f64| Point3::new(0.010 * angle.cos(), 0.010 * angle.sin(), z);
        let tip = Point3::new(0.0, 0.0, 0.026);
        let way = |a: Point3<f64>, b: Point3<f64>| {
            approx::assert_relative_eq!(s.geodesic(&a, &b), s.geodesic(&b, &a), max_relative = 1e-6);
            s.geodesic(&a, &b)
        };
        // Straight up and over a quarter of the sphere; along a helix; along the shorter side of the equator.
        approx::assert_relative_eq!(
            way(cylinder(0.3, 0.004), tip),
            0.012 + 0.010 * PI / 2.0,
            max_relative = 1e-9
        );
        approx::assert_relative_eq!(
            way(cylinder(0.0, 0.0), cylinder(1.0, 0.012)),
            0.010f64.hypot(0.012),
            max_relative = 1e-9
        );
        approx::assert_relative_eq!(
            way(cylinder(-3.0, 0.016), cylinder(3.0, 0.016)),
            0.010 * (TAU - 6.0),
            max_relative = 1e-9
        );
    }

    /// A limb's shell: openings of 20 x 12 mm between beams of 10 and 6 mm.
    fn panel() -> SurfaceSpec {
        SurfaceSpec::Panel {
            radius: 0.045,
            size: [0.100, 0.078],
            spacing: 0.0025,
            margin: 0.010,
            rail: 0.015,
            cells: [3, 3],
            beam: [0.010, 0.006],
        }
    }

    #[test]
    fn a_panel_has_its_openings() {
        let s = Surface::from_spec(&panel());
        let openings = 9.0 * 0.020 * 0.012;
        // Chords of 2.5 mm on a radius of 45 mm are a little shorter than their arcs.
        approx::assert_relative_eq!(
            s.areas.iter().sum::<f64>(),
            0.100 * 0.078 - openings,
            max_relative = 1e-3
        );
        assert!(outward(&s));
        for (p, n) in s.points.iter().zip(&s.normals) {
            let (q, m) = s.project(p);
            assert!((p - q).norm() < 1e-12 && (n - m).norm() < 1e-9);
        }
        // The middle of the panel is the middle of an opening: the nearest beam lies along x.
        let (edge, _) = s.project(&Point3::new(0.001, 0.0, 0.1));
        approx::assert_relative_eq!(edge.x, 0.001);
        approx::assert_relative_eq!(edge.y.abs(), 0.045 * (0.006f64 / 0.045).sin(), max_relative = 1e-9);
    }

    #[test]
    fn ways_go_around_the_openings_of_a_panel() {
        let s = Surface::from_spec(&panel());
        let at = |x: f64, arc: f64| Point3::new(x, 0.045 * (arc / 0.045).sin(), 0.045 * (arc / 0.045).cos());
        // Along a beam; across an opening of 20 x 12 mm from side to side, where the way has two corners.
        approx::assert_relative_eq!(
            s.geodesic(&at(-0.04, 0.009), &at(0.04, 0.009)),
            0.08,
            max_relative = 1e-9
        );
        let around = s.geodesic(&at(-0.001, -0.006), &at(-0.001, 0.006));
        assert!((0.0299..0.0305).contains(&around), "{around}");
        let all = s.ways_from(&at(-0.05, 0.0));
        assert!(all.iter().all(|w| w.is_finite()));
    }

    /// The corners of a box without its lid, in millimetres.
    const TRAY: &str = "
        v 0 0 0\nv 10 0 0\nv 10 8 0\nv 0 8 0\nv 0 0 5\nv 10 0 5\nv 10 8 5\nv 0 8 5
        f 1 4 3 2\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

    fn from_file(name: &str, bytes: &[u8], rims: usize) -> Result<Surface, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let mesh = crate::TriangleMesh::load(&path, 1e-3, rims)
            .map_err(|e| e.replace(&*path.to_string_lossy(), name))?;
        let spec = SurfaceSpec::Mesh { file: path, scale: 1e-3, rims, mesh };
        Ok(Surface::from_spec(&spec))
    }

    #[test]
    fn a_mesh_is_read_from_a_file() {
        let s = from_file("tray.obj", TRAY.as_bytes(), 1).unwrap();
        assert_eq!((s.points.len(), s.triangles.len()), (8, 10));
        approx::assert_relative_eq!(s.areas.iter().sum::<f64>(), 260e-6, max_relative = 1e-6);
        // Over the floor, and beyond a wall.
        let (p, n) = s.project(&Point3::new(0.005, 0.004, -0.001));
        assert!((p - Point3::new(0.005, 0.004, 0.0)).norm() < 1e-9 && n.z < -0.5);
        let up_the_wall = s.geodesic(&Point3::new(0.005, 0.0, 0.005), &Point3::new(0.005, 0.004, 0.0));
        // From one point to many is as from one to each.
        let (from, to) = (Point3::new(0.005, 0.0, 0.005), [Point3::new(0.005, 0.004, 0.0), s.points[7]]);
        assert_eq!(s.geodesics(&from, &to), to.map(|p| s.geodesic(&from, &p)));
        assert!(!s.has_closed_form());
        // Eight points leave few ways.
        assert!((0.009..0.014).contains(&up_the_wall), "{up_the_wall}");
        // Text and binary STL of one triangle are the same.
        let text = b"solid t\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid t\n";
        let mut binary = vec![b' '; 80];
        binary.extend(1u32.to_le_bytes());
        for v in [0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            binary.extend(v.to_le_bytes());
        }
        binary.extend([0, 0]);
        let (a, b) = (from_file("t.stl", text, 1).unwrap(), from_file("t.stl", &binary, 1).unwrap());
        assert_eq!((a.points, a.triangles), (b.points, b.triangles));
    }

    #[test]
    fn refused_meshes_say_what_and_where() {
        let refused = |text: &str, rims: usize| from_file("m.obj", text.as_bytes(), rims).unwrap_err();
        insta::assert_snapshot!(refused(TRAY, 2), @"mesh file m.obj: has 1 rims where 2 are expected: 4 edges around (0.0050, 0.0040, 0.0050) m; close the holes that are not meant, or say `rims = 1`");
        insta::assert_snapshot!(refused(&TRAY.replace("f 2 3 7 6\n", ""), 2), @"mesh file m.obj: has 1 rims where 2 are expected: 6 edges around (0.0067, 0.0040, 0.0033) m; close the holes that are not meant, or say `rims = 1`");
        insta::assert_snapshot!(refused(&TRAY.replace("f 2 3 7 6\n", "f 6 7 3 2\n"), 1), @"mesh file m.obj: its triangles do not agree on which side is out: two turn opposite ways at the edge around (0.0100, 0.0040, 0.0000) m; make the normals of the mesh consistent");
        insta::assert_snapshot!(refused(&format!("{TRAY}f 1 2 7\n"), 1), @"mesh file m.obj: more than two triangles meet at the edge around (0.0050, 0.0000, 0.0000) m: it must be one surface");
        insta::assert_snapshot!(refused(&format!("{TRAY}v 90 0 0\nv 99 0 0\nv 90 9 0\nf 9 10 11\n"), 2), @"mesh file m.obj: is in pieces: (0.0000, 0.0000, 0.0000) m and (0.0900, 0.0000, 0.0000) m are not connected; join them, or remove what is not part of the skin");
        insta::assert_snapshot!(refused(&TRAY.replace("v 10 8 5", "v nan 8 5"), 1), @"mesh file m.obj: point 6 (NaN, 8, 5) is not a number");
        insta::assert_snapshot!(refused(&format!("{TRAY}v 5 0 0\nf 1 9 2\n"), 1), @"mesh file m.obj: triangle 10 at (0.0000, 0.0000, 0.0000) m has no area: repair the mesh");
        insta::assert_snapshot!(refused("v 0 0 0\n", 1), @"mesh file m.obj: holds no triangle");
        insta::assert_snapshot!(from_file("m.step", b"", 1).unwrap_err(), @"mesh file m.step is neither .stl nor .obj: export it as one of these");
        insta::assert_snapshot!(from_file("m.stl", b"solid\nfacet normal", 1).unwrap_err(), @"mesh file m.stl: failed to fill whole buffer");
    }

    proptest! {
        #[test]
        fn ways_are_a_metric(
            p in proptest::array::uniform3((-0.02..0.02f64, -0.02..0.02f64, -0.01..0.04f64)), dome in any::<bool>(),
        ) {
            let spec = if dome {
                SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 }
            } else {
                SurfaceSpec::Rectangle { size: [0.034, 0.02], spacing: 0.002 }
            };
            let s = Surface::from_spec(&spec);
            let [a, b, c] = p.map(|(x, y, z)| s.project(&Point3::new(x, y, z)).0);
            prop_assert!(s.geodesic(&a, &b) + 1e-9 >= (a - b).norm());
            prop_assert!(s.geodesic(&a, &c) <= s.geodesic(&a, &b) + s.geodesic(&b, &c) + 1e-7);
        }

        #[test]
        fn projection_is_idempotent_and_closest(
            x in -0.05..0.05f64, y in -0.05..0.05f64, z in -0.05..0.05f64, shape in 0..3,
        ) {
            let spec = match shape {
                0 => SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 },
                1 => panel(),
                _ => SurfaceSpec::Rectangle { size: [0.034, 0.02], spacing: 0.002 },
            };
            let s = Surface::from_spec(&spec);
            let p = Point3::new(x, y, z);
            let (q, n) = s.project(&p);
            prop_assert!((n.norm() - 1.0).abs() < 1e-9);
            prop_assert!(s.distance(&q) < 1e-9);
            // On a panel the closest point is meant along it.
            let from = if shape == 1 { q } else { p };
            let nearest = s.points.iter().map(|v| (v - from).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!(s.distance(&from) <= nearest + 1e-9);
        }
    }
}
