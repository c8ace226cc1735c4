//! Triangulated outside of a skin.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use crate::description::SurfaceSpec;

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
}

impl Surface {
    /// The surface that a description names. The description has been checked: sizes are positive.
    #[must_use]
    pub fn from_spec(spec: &SurfaceSpec) -> Self {
        let (points, normals, triangles) = match *spec {
            SurfaceSpec::Rectangle { size, spacing } => rectangle(size, spacing),
            SurfaceSpec::Dome { radius, cylinder, spacing } => dome(radius, cylinder, spacing),
        };
        let mut areas = vec![0.0; points.len()];
        for t in &triangles {
            let [a, b, c] = t.map(|i| points[i as usize]);
            let third = (b - a).cross(&(c - a)).norm() / 6.0;
            for &i in t {
                areas[i as usize] += third;
            }
        }
        Self { points, normals, areas, triangles, spec: spec.clone() }
    }

    /// Closest point of the ideal (not the triangulated) surface, and its outward normal.
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
        }
    }

    /// Length \[m\] of the shortest way along the ideal surface between two points; what lies off it is projected first.
    #[must_use]
    pub fn geodesic(&self, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
        let (a, b) = (self.project(from).0, self.project(to).0);
        let SurfaceSpec::Dome { radius, cylinder, .. } = self.spec else { return (a - b).norm() };
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
                // Where the way crosses the equator: near the best of some places, the length has one minimum.
                let places = (0..=16).map(|i| f64::from(i) / 16.0);
                let near = places.min_by(|p, q| through(*p).total_cmp(&through(*q))).unwrap_or(0.0);
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

    /// Distance of `point` from the ideal surface \[m\].
    #[must_use]
    pub fn distance(&self, point: &Point3<f64>) -> f64 {
        (point - self.project(point).0).norm()
    }
}

/// Points, normals, triangles.
type Triangulation = (Vec<Point3<f64>>, Vec<Vector3<f64>>, Vec<[u32; 3]>);

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
            x in -0.05..0.05f64, y in -0.05..0.05f64, z in -0.05..0.05f64, dome in any::<bool>(),
        ) {
            let spec = if dome {
                SurfaceSpec::Dome { radius: 0.01, cylinder: 0.016, spacing: 0.002 }
            } else {
                SurfaceSpec::Rectangle { size: [0.034, 0.02], spacing: 0.002 }
            };
            let s = Surface::from_spec(&spec);
            let p = Point3::new(x, y, z);
            let (q, n) = s.project(&p);
            prop_assert!((n.norm() - 1.0).abs() < 1e-9);
            prop_assert!(s.distance(&q) < 1e-9);
            let nearest = s.points.iter().map(|v| (v - p).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!(s.distance(&p) <= nearest + 1e-9);
        }
    }
}
