//! Triangulated surfaces from files, and operations on any triangulation.

use std::collections::{BTreeMap, BinaryHeap};
use std::path::Path;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rstar::{AABB, PointDistance, RTree, RTreeObject};
use sha2::{Digest, Sha256};

/// Points closer than this share of the mesh's extent are one.
const SAME: f64 = 1e-6;
/// Points that a mesh may have.
const POINTS_MAX: usize = 1_000_000;
/// \[m\] that they may be away along each axis.
const FARTHEST: f64 = 100.0;

/// A triangulation that was read from a file and checked: one piece of surface, its triangles counter-clockwise seen from outside.
#[derive(Debug, Clone, Default)]
pub struct TriangleMesh(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    triangles: Vec<[u32; 3]>,
    faces: RTree<Face>,
    digest: String,
}

impl PartialEq for TriangleMesh {
    fn eq(&self, other: &Self) -> bool {
        self.0.digest == other.0.digest
    }
}

/// A triangle and its number.
#[derive(Debug, Clone)]
struct Face {
    number: usize,
    corners: [Point3<f64>; 3],
}

impl RTreeObject for Face {
    type Envelope = AABB<[f64; 3]>;
    fn envelope(&self) -> Self::Envelope {
        let corners = self.corners.map(|p| [p.x, p.y, p.z]);
        AABB::from_points(&corners)
    }
}

impl PointDistance for Face {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let p = Point3::from(*point);
        let at = closest_on_triangle(&self.corners, &p);
        (p - from_weights(&self.corners, at)).norm_squared()
    }
}

fn from_weights(corners: &[Point3<f64>; 3], w: [f64; 3]) -> Point3<f64> {
    Point3::from(corners[0].coords * w[0] + corners[1].coords * w[1] + corners[2].coords * w[2])
}

/// The point of a triangle that is closest to `p`, as barycentric coordinates of its corners (C. Ericson, *Real-Time Collision
/// Detection*, 5.1.5).
#[must_use]
pub fn closest_on_triangle([a, b, c]: &[Point3<f64>; 3], p: &Point3<f64>) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let whole = va + vb + vc;
    [va / whole, vb / whole, vc / whole]
}

impl TriangleMesh {
    /// Reads an STL or OBJ file whose lengths are `scale` metres and which is one piece of surface with `rims` rims: its outer
    /// edge, and one for every opening that is meant.
    ///
    /// # Errors
    ///
    /// A sentence that says what is wrong with the mesh, and where.
    pub fn load(path: &Path, scale: f64, rims: usize) -> Result<Self, String> {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        let open = || {
            let file = dermis_io::open_at_most(path, dermis_io::MESH);
            file.map_err(|e| format!("mesh file {} cannot be read: {e}", path.display()))
        };
        let unreadable = |e: &dyn std::fmt::Display| format!("mesh file {}: {e}", path.display());
        let (points, triangles) = match extension.as_deref() {
            Some("stl") => {
                let mesh =
                    stl_io::read_stl(&mut std::io::BufReader::new(open()?)).map_err(|e| unreadable(&e))?;
                let points =
                    mesh.vertices.iter().map(|v| Point3::new(v[0], v[1], v[2]).cast::<f64>()).collect();
                (points, mesh.faces.iter().map(|f| f.vertices).collect::<Vec<_>>())
            }
            Some("obj") => {
                let options =
                    tobj::LoadOptions { triangulate: true, single_index: false, ..Default::default() };
                // Materials say nothing of a shape.
                let (models, _) = tobj::load_obj_buf(&mut std::io::BufReader::new(open()?), &options, |_| {
                    Ok(Default::default())
                })
                .map_err(|e| unreadable(&e))?;
                let (mut points, mut triangles) = (Vec::new(), Vec::new());
                for model in &models {
                    let first = points.len();
                    points.extend(
                        model
                            .mesh
                            .positions
                            .chunks_exact(3)
                            .map(|p| Point3::new(p[0], p[1], p[2]).cast::<f64>()),
                    );
                    let corners = model.mesh.indices.chunks_exact(3);
                    triangles.extend(corners.map(|t| [t[0], t[1], t[2]].map(|i| first + i as usize)));
                }
                (points, triangles)
            }
            _ => {
                return Err(format!(
                    "mesh file {} is neither .stl nor .obj: export it as one of these",
                    path.display()
                ));
            }
        };
        Self::checked(points, &triangles, scale, rims).map_err(|reason| unreadable(&reason))
    }

    /// A mesh of `points` (times `scale` metres) and `triangles` that has been checked as [`load`](Self::load) does.
    pub(crate) fn checked(
        points: Vec<Point3<f64>>,
        triangles: &[[usize; 3]],
        scale: f64,
        rims: usize,
    ) -> Result<Self, String> {
        if triangles.is_empty() {
            return Err("holds no triangle".into());
        }
        if points.len() > POINTS_MAX {
            return Err(format!("has {} points; {POINTS_MAX} at most make sense: coarsen it", points.len()));
        }
        if let Some((i, p)) = points.iter().enumerate().find(|(_, p)| p.iter().any(|v| !v.is_finite())) {
            return Err(format!("point {i} ({}, {}, {}) is not a number", p.x, p.y, p.z));
        }
        let points: Vec<Point3<f64>> = points.into_iter().map(|p| p * scale).collect();
        if let Some((i, p)) = points.iter().enumerate().find(|(_, p)| p.coords.amax() > FARTHEST) {
            return Err(format!(
                "point {i} lies {:e} m away from the origin of the link, and {FARTHEST} m at most make sense: correct `scale`",
                p.coords.norm()
            ));
        }
        let (points, number) = merged(&points);
        let mut kept = Vec::with_capacity(triangles.len());
        for (i, t) in triangles.iter().enumerate() {
            let t = t.map(|p| number.get(p).copied().unwrap_or(u32::MAX));
            if t.contains(&u32::MAX) {
                return Err(format!("triangle {i} names a point that is not there"));
            }
            let [a, b, c] = t.map(|p| points[p as usize]);
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            if (b - a).cross(&(c - a)).norm() < 1e-6 * longest * longest {
                return Err(format!("triangle {i} at {} has no area: repair the mesh", place(&a)));
            }
            kept.push(t);
        }
        edges(&points, &kept, rims)?;
        Ok(Self::new(points, kept))
    }

    /// A mesh of points \[m\] and triangles, counter-clockwise seen from outside, with so many rims.
    ///
    /// # Errors
    ///
    /// What is wrong with it, as for a [file](Self::load).
    pub fn from_triangles(
        points: Vec<Point3<f64>>,
        triangles: &[[usize; 3]],
        rims: usize,
    ) -> Result<Self, String> {
        Self::checked(points, triangles, 1.0, rims)
    }

    /// Whether there is no triangle in it.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.triangles.is_empty()
    }

    fn new(points: Vec<Point3<f64>>, triangles: Vec<[u32; 3]>) -> Self {
        let mut normals = vec![Vector3::zeros(); points.len()];
        let mut hash = Sha256::new();
        for p in &points {
            p.iter().for_each(|v| hash.update(v.to_le_bytes()));
        }
        let mut faces = Vec::with_capacity(triangles.len());
        for (i, t) in triangles.iter().enumerate() {
            let corners = t.map(|p| points[p as usize]);
            t.iter().for_each(|p| hash.update(p.to_le_bytes()));
            let [a, b, c] = corners;
            let across = (b - a).cross(&(c - a));
            for p in t {
                normals[*p as usize] += across;
            }
            faces.push(Face { number: i, corners });
        }
        for n in &mut normals {
            *n = n.try_normalize(1e-300).unwrap_or_else(Vector3::z);
        }
        let digest = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
        Self(Arc::new(Inner { faces: RTree::bulk_load(faces), points, normals, triangles, digest }))
    }

    /// SHA-256 over points and triangles.
    pub(crate) fn digest(&self) -> &str {
        &self.0.digest
    }

    pub(crate) fn triangulation(&self) -> crate::surface::Triangulation {
        (self.0.points.clone(), self.0.normals.clone(), self.0.triangles.clone())
    }

    /// Closest point of the triangles, and the normal there: that of the corners, blended.
    pub(crate) fn project(&self, p: &Point3<f64>) -> (Point3<f64>, Vector3<f64>) {
        let Some(face) = self.0.faces.nearest_neighbor([p.x, p.y, p.z]) else { return (*p, Vector3::z()) };
        let weights = closest_on_triangle(&face.corners, p);
        let corners = self.0.triangles[face.number].map(|i| self.0.normals[i as usize]);
        let normal = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
        let [a, b, c] = &face.corners;
        let flat = || (b - a).cross(&(c - a)).normalize();
        (from_weights(&face.corners, weights), normal.try_normalize(1e-9).unwrap_or_else(flat))
    }
}

fn place(p: &Point3<f64>) -> String {
    format!("({:.4}, {:.4}, {:.4}) m", p.x, p.y, p.z)
}

/// Points without repetitions, and which of them each one is: files repeat a point in every triangle.
fn merged(points: &[Point3<f64>]) -> (Vec<Point3<f64>>, Vec<u32>) {
    let extent = points.iter().map(|p| p.coords.amax()).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
    let cell = SAME * extent;
    let mut found: BTreeMap<[i64; 3], u32> = BTreeMap::new();
    let mut kept = Vec::new();
    let number = points
        .iter()
        .map(|p| {
            let key = [p.x, p.y, p.z].map(|v| (v / cell).round() as i64);
            *found.entry(key).or_insert_with(|| {
                kept.push(*p);
                (kept.len() - 1) as u32
            })
        })
        .collect();
    (kept, number)
}

/// Refuses a mesh that is no one piece of an oriented surface with `rims` rims.
fn edges(points: &[Point3<f64>], triangles: &[[u32; 3]], rims: usize) -> Result<(), String> {
    let mut uses: BTreeMap<[u32; 2], [u32; 2]> = BTreeMap::new();
    for t in triangles {
        for [i, j] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
            uses.entry([i.min(j), i.max(j)]).or_default()[usize::from(i > j)] += 1;
        }
    }
    let middle = |[i, j]: [u32; 2]| place(&nalgebra::center(&points[i as usize], &points[j as usize]));
    if let Some((edge, _)) = uses.iter().find(|(_, [up, down])| up + down > 2) {
        return Err(format!(
            "more than two triangles meet at the edge around {}: it must be one surface",
            middle(*edge)
        ));
    }
    if let Some((edge, _)) = uses.iter().find(|(_, [up, down])| *up == 2 || *down == 2) {
        return Err(format!(
            "its triangles do not agree on which side is out: two turn opposite ways at the edge around {}; make the normals \
             of the mesh consistent",
            middle(*edge)
        ));
    }
    // Pieces and rims, by joining what is connected.
    let mut of_piece: Vec<u32> = (0..points.len() as u32).collect();
    let mut of_rim = of_piece.clone();
    fn root(of: &mut [u32], mut i: u32) -> u32 {
        while of[i as usize] != i {
            of[i as usize] = of[of[i as usize] as usize];
            i = of[i as usize];
        }
        i
    }
    for ([i, j], [up, down]) in &uses {
        let (a, b) = (root(&mut of_piece, *i), root(&mut of_piece, *j));
        of_piece[a as usize] = b;
        if up + down == 1 {
            let (a, b) = (root(&mut of_rim, *i), root(&mut of_rim, *j));
            of_rim[a as usize] = b;
        }
    }
    let used = triangles[0][0];
    let first = root(&mut of_piece, used);
    if let Some(t) = triangles.iter().find(|t| root(&mut of_piece, t[0]) != first) {
        return Err(format!(
            "is in pieces: {} and {} are not connected; join them, or remove what is not part of the skin",
            place(&points[used as usize]),
            place(&points[t[0] as usize])
        ));
    }
    let mut loops: BTreeMap<u32, (usize, Vector3<f64>)> = BTreeMap::new();
    for ([i, j], _) in uses.iter().filter(|(_, [up, down])| up + down == 1) {
        let entry = loops.entry(root(&mut of_rim, *i)).or_insert((0, Vector3::zeros()));
        entry.0 += 1;
        entry.1 += nalgebra::center(&points[*i as usize], &points[*j as usize]).coords;
    }
    if loops.len() != rims {
        let mut found: Vec<(usize, String)> =
            loops.values().map(|(n, sum)| (*n, place(&Point3::from(sum / *n as f64)))).collect();
        found.sort();
        let named: Vec<String> =
            found.iter().take(6).map(|(n, at)| format!("{n} edges around {at}")).collect();
        return Err(format!(
            "has {} rims where {rims} are expected: {}{}; close the holes that are not meant, or say `rims = {}`",
            loops.len(),
            if named.is_empty() { "it is closed".to_owned() } else { named.join(", ") },
            if found.len() > 6 { ", …" } else { "" },
            loops.len()
        ));
    }
    Ok(())
}

/// Lengths \[m\] of the shortest ways over a triangulation from `start` to every point, infinite where there is none: along edges,
/// across two triangles that share an edge, and straight from `start` to the points around it.
pub(crate) fn ways(
    points: &[Point3<f64>],
    triangles: &[[u32; 3]],
    start: &Point3<f64>,
    from: &[u32],
) -> Vec<f64> {
    #[derive(PartialEq)]
    struct Reached(f64, u32);
    impl Eq for Reached {}
    impl Ord for Reached {
        fn cmp(&self, other: &Self) -> std::cmp::Ordering {
            other.0.total_cmp(&self.0)
        }
    }
    impl PartialOrd for Reached {
        fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
            Some(self.cmp(other))
        }
    }
    let mut opposite: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    let mut next: Vec<Vec<(u32, f64)>> = vec![Vec::new(); points.len()];
    let mut join = |i: u32, j: u32, length: f64| {
        next[i as usize].push((j, length));
        next[j as usize].push((i, length));
    };
    for t in triangles {
        for [i, j, k] in [[t[0], t[1], t[2]], [t[1], t[2], t[0]], [t[2], t[0], t[1]]] {
            let [a, b, c] = [i, j, k].map(|p| points[p as usize]);
            join(i, j, (b - a).norm());
            if let Some(l) = opposite.insert([i.min(j), i.max(j)], k) {
                // Both triangles laid flat; only where the straight way between their tips crosses the shared edge.
                let d = points[l as usize];
                let along = (b - a).normalize();
                let flat = |p: Point3<f64>| {
                    let x = (p - a).dot(&along);
                    (x, ((p - a).norm_squared() - x * x).max(0.0).sqrt())
                };
                let ((xc, yc), (xd, yd)) = (flat(c), flat(d));
                let cross = xc + (xd - xc) * yc / (yc + yd);
                if cross > 0.0 && cross < (b - a).norm() {
                    join(k, l, (xc - xd).hypot(yc + yd));
                }
            }
        }
    }
    let mut length = vec![f64::INFINITY; points.len()];
    let mut heap = BinaryHeap::new();
    for &i in from {
        length[i as usize] = (points[i as usize] - start).norm();
        heap.push(Reached(length[i as usize], i));
    }
    while let Some(Reached(at, i)) = heap.pop() {
        if at > length[i as usize] {
            continue;
        }
        for &(j, more) in &next[i as usize] {
            if at + more < length[j as usize] {
                length[j as usize] = at + more;
                heap.push(Reached(at + more, j));
            }
        }
    }
    length
}
