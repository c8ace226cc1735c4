use super::*;
use crate::model::ThumbModel;
use crate::model::tests::{SMALL, skin};

/// Neighbours that move in opposite directions, so that the inside is as rough as it can be.
fn rough(grid: &Grid, most: f32) -> Field {
    let way = |i: usize| [0.3, -0.9, 1.0, -0.4, 0.7, -1.0, 0.1][i % 7];
    Field { values: (0..3 * grid.count()).map(|i| most * way(i)).collect(), rows: [0, grid.rows] }
}

/// A Gaussian dent of 3 mm.
fn dent(shading: &Shading, middle: &Point3<f64>, by: &Vector3<f64>) -> Field {
    let dent = |node: &Node| {
        let share = (-(node.position - middle).norm_squared() / (2.0 * 0.003 * 0.003)).exp();
        (by * share).map(|u| u as f32)
    };
    let values = shading.nodes.iter().flat_map(|node| <[f32; 3]>::from(dent(node))).collect();
    Field { values, rows: [0, shading.grid.rows] }
}

/// Changes by ray.
fn seen(shading: &Shading, field: &Field) -> Vec<[f32; CHANGES]> {
    seen_with(shading, field, &mut Displaced::default())
}

fn seen_with(shading: &Shading, field: &Field, displaced: &mut Displaced) -> Vec<[f32; CHANGES]> {
    let mut changes = Changes::default();
    shading.changes(field, displaced, &mut changes);
    let Grid { columns, .. } = shading.grid;
    (0..shading.nodes.len()).map(|i| changes.values[i / columns * (columns + 1) + i % columns]).collect()
}

/// The largest difference of colours, and the largest change.
fn apart(found: &[[f32; CHANGES]], exact: &[[f32; CHANGES]]) -> (f32, f32) {
    let colours = |of: &[[f32; CHANGES]]| of.iter().flat_map(|v| v[..COLOURS].to_vec()).collect::<Vec<_>>();
    let (found, exact) = (colours(found), colours(exact));
    let off = found.iter().zip(&exact).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
    (off, exact.iter().fold(0.0, |most, v| most.max(v.abs())))
}

/// What rays meet, triangle by triangle, with none left out.
fn cast(shading: &Shading, field: &Field) -> Vec<Option<[f32; COLOURS]>> {
    let Grid { rows, columns, .. } = shading.grid;
    let turned: Vec<Turned> = (0..rows * columns).map(|node| shading.turned(field, node)).collect();
    let mut triangles = Vec::new();
    for (row, column) in (0..rows - 1).flat_map(|row| (0..columns).map(move |column| (row, column))) {
        let beside = (column + 1) % columns;
        let [above, below] = [row, row + 1].map(|row| row * columns);
        triangles.push([above + column, below + column, below + beside]);
        triangles.push([above + column, below + beside, above + beside]);
    }
    let meets = |ray: usize| {
        let direction = &shading.rays.directions[ray];
        let mut nearest: Option<(f64, Vector3<f64>)> = None;
        for nodes in &triangles {
            let [a, b, c] = nodes.map(|node| turned[node].corner.position);
            // Shares of the corners are those of the way to the plane: a linear system.
            let sides = Matrix3::from_columns(&[
                a - shading.rays.camera,
                b - shading.rays.camera,
                c - shading.rays.camera,
            ]);
            let Some(weights) = sides.lu().solve(direction) else { continue };
            if weights.sum() <= 0.0 || weights.iter().any(|w| *w < -1e-7 * weights.sum()) {
                continue;
            }
            let depth = 1.0 / weights.sum();
            if nearest.is_none_or(|(nearest, _)| depth < nearest) {
                let normal = (0..3).map(|k| turned[nodes[k]].normal * weights[k]).sum::<Vector3<f64>>();
                nearest = Some((depth, normal.normalize()));
            }
        }
        nearest.map(|(depth, normal)| shading.colour(direction, depth, &normal))
    };
    (0..rows * columns).map(meets).collect()
}

/// What bulges towards the camera hides what is behind it, and is seen larger: against all triangles for each ray.
#[test]
fn rays_end_at_the_nearest_triangle() {
    let model = ThumbModel::new(&skin(SMALL)).unwrap();
    let shading = model.shading();
    for (s, azimuth, depth) in
        [(0.03, 2.0, 0.002), (0.028, 0.8, 0.006), (0.0, 0.0, 0.003), (0.05, 4.0, 0.004)]
    {
        let (middle, normal) = inside(&model.parameters().elastomer, s, azimuth);
        let field = dent(shading, &middle, &(normal * depth + Vector3::new(2e-4, -1e-4, 3e-4)));
        let mut displaced = Displaced::default();
        let found = seen_with(shading, &field, &mut displaced);
        let (mut changed, mut off_edge) = (0, 0);
        for (ray, exact) in cast(shading, &field).into_iter().enumerate() {
            let exact = exact.unwrap();
            if displaced.edges.has(ray) {
                continue;
            }
            let off = |c: usize| (found[ray][c] + shading.seen[ray][c] - exact[c]).abs();
            off_edge += usize::from((0..COLOURS).any(|c| off(c) > 1e-3));
            changed += usize::from((0..COLOURS).any(|c| (exact[c] - shading.seen[ray][c]).abs() > 0.01));
        }
        // The rays through an edge that hides something may pass it on either side.
        assert!(changed > 10 && off_edge < 2, "{changed} {off_edge}");
    }
}

/// What moves slightly changes as its slopes say, nearly as rays do: by half the noise of a block's mean at most, of which a node is a small part.
/// Slopes take the curvature from both sides of a node, and rays that of the side where they end.
#[test]
fn where_little_moves_colours_change_in_proportion() {
    let ridges = "ridges = { pitch = 0.006, count = 12, height = 0.0008 }\nblocks";
    // The second is as fine as that of the thumb that ships.
    for (spacing, share) in [("grid = 0.004", 0.15), ("grid = 0.00125", 0.1)] {
        let text = SMALL.replace("grid = 0.004", spacing).replacen("blocks", ridges, 1);
        // Without the fovea's border, where rays graze an edge.
        let even: Vec<&str> = text.lines().filter(|line| !line.starts_with("fovea")).collect();
        colours_change_in_proportion(&even.join("\n"), share);
    }
}

fn colours_change_in_proportion(text: &str, share: f32) {
    let model = ThumbModel::new(&skin(text)).unwrap();
    let shading = &mut model.shading().clone();
    // Parts of rays are another matter.
    shading.uneven.fill(false);
    let mut by_rays = shading.clone();
    by_rays.nodes.iter_mut().for_each(|node| node.slight = 0.0);
    let slight = || shading.nodes.iter().map(|node| node.slight);
    let field = rough(&shading.grid, slight().fold(f32::INFINITY, f32::min));
    let (off, change) = apart(&seen(shading, &field), &seen(&by_rays, &field));
    assert!(off > 0.0 && off < share * change && off < 1e-3, "{off} of {change}");
    let field = rough(&shading.grid, 20.0 * slight().fold(0.0, f32::max));
    let (off, change) = apart(&seen(shading, &field), &seen(&by_rays, &field));
    assert!(off == 0.0 && change > 0.0, "{off} of {change}");
    // Dents as presses make them, at the tip, where meridians meet, beside it, where the tip's curvature ends, and on the side.
    for at in [0.0005, 0.001, 0.002, 0.004, 0.008, 0.03] {
        let (middle, normal) = inside(&model.parameters().elastomer, at, 0.7);
        for depth in [1e-5, 1e-4, 4e-4] {
            let field = dent(shading, &middle, &(normal * depth));
            let (found, exact) = (seen(shading, &field), seen(&by_rays, &field));
            let (off, change) = apart(&found, &exact);
            assert!(off < 4e-4 && (depth < 5e-5 || off < 0.03 * change), "{at} {depth}: {off} of {change}");
            let phases =
                |of: &[[f32; CHANGES]]| of.iter().flat_map(|v| v[COLOURS..].to_vec()).collect::<Vec<_>>();
            for (found, exact) in phases(&found).into_iter().zip(phases(&exact)) {
                assert!((found - exact).abs() < 0.005, "{at} {depth}: {found} and {exact} of ridges");
            }
        }
    }
}

/// Strong presses on the side, on the tip and on the fovea: what changes with a little more of each is what differences say. Edges that hide
/// something move, too, which the slopes leave out.
#[test]
fn slopes_are_those_of_the_displaced_inside() {
    let model = ThumbModel::new(&skin(&SMALL.replace("grid = 0.004", "grid = 0.0015"))).unwrap();
    let shading = model.shading();
    for (s, azimuth, depth, share) in
        [(0.03, 3.0, 0.001, 0.01), (0.002, 1.0, 0.001, 0.01), (0.028, 0.8, 0.003, 0.05)]
    {
        let (middle, normal) = inside(&model.parameters().elastomer, s, azimuth);
        let field = dent(shading, &middle, &(normal * depth));
        for more in [normal * depth, Vector3::new(3e-4, -2e-4, 4e-4)] {
            let by = dent(shading, &(middle + Vector3::new(5e-4, 0.0, -5e-4)), &more);
            let (mut displaced, mut linear) =
                (Displaced::default(), crate::optics::slopes::Linear::default());
            let (mut changes, mut slopes) = (Changes::default(), Changes::default());
            shading.changes(&field, &mut displaced, &mut changes);
            shading.linearise(&displaced, &mut linear);
            shading.slopes((&field, &displaced), &mut linear, &by, &mut slopes);
            let at = |share: f32| {
                let values = field.values.iter().zip(&by.values).map(|(u, v)| u + share * v);
                seen(shading, &Field { values: values.collect(), rows: field.rows })
            };
            let (more, less) = (at(0.005), at(-0.005));
            let columns = shading.grid.columns;
            let (mut off, mut whole) = (0.0, 0.0);
            for i in 0..shading.nodes.len() {
                let slope = slopes.values[i / columns * (columns + 1) + i % columns];
                for c in 0..COLOURS {
                    let difference = (more[i][c] - less[i][c]) / 0.01;
                    off += (slope[c] - difference).powi(2);
                    whole += difference.powi(2);
                }
            }
            assert!(off < share * whole, "{s} {depth}: {off} of {whole}");
        }
    }
}
