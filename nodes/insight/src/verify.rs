//! Figures of the thumb's physics, computed now, against closed forms and the thesis: I1, I3, I4, I5 and I7; I6 with CalculiX.

use std::f64::consts::FRAC_PI_2;

use dermis_mechanics::MechanicsError;
use dermis_mechanics::calculix::{CalculixError, Plate, plate_deflections};
use dermis_mechanics::fem::{HexMesh, Solid};
use dermis_model::Case;
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use crate::elastic::basis::{Field, Grid};
use crate::elastic::mesh::{Elastomer, Skeleton};
use crate::elastic::stretching::{STRETCHED, relaxed};
use crate::optics::displaced::Displaced;
use crate::optics::lens::field_of_view;
use crate::optics::light::{Beam, COLOURS, Finish, Lamp};
use crate::optics::picture::Noise;
use crate::optics::shading::{Changes, inside};
use crate::optics::table::met_along;
use crate::optics::{Camera, Light, Shading};
use crate::shape::Thumb;

/// Every case of this family.
///
/// # Errors
///
/// [`MechanicsError`] where a case cannot be computed at all.
pub fn cases() -> Result<Vec<Case>, MechanicsError> {
    let mut cases = Vec::new();
    for poisson in [0.49, 0.4999] {
        cases.push(tube(poisson)?);
    }
    cases.extend(fields_of_view());
    cases.push(round_trip());
    cases.extend([point_lamp(), furnace(), noise()]);
    cases.extend(moved_wall().map_err(|reason| MechanicsError::Contact { reason })?);
    Ok(cases)
}

/// A tube under inner pressure in plane strain (G. Lamé): what locks is too stiff by far.
fn tube(poisson: f64) -> Result<Case, MechanicsError> {
    let (a, b, young, p) = (0.010, 0.0172, 70e3, 1e3);
    let exact =
        (1.0 + poisson) / young * p * a * a / (b * b - a * a) * ((1.0 - 2.0 * poisson) * a + b * b / a);
    let (cells, through) = (24_u32, 8_u32);
    let angle = |i: u32| FRAC_PI_2 * f64::from(i) / f64::from(cells);
    let radii: Vec<f64> = (0..=through).map(|i| a + (b - a) * f64::from(i) / f64::from(through)).collect();
    let angles: Vec<f64> = (0..=cells).map(angle).collect();
    let mut mesh = HexMesh::block([&radii, &angles, &[0.0, 1e-3]]);
    let polar: Vec<[f64; 2]> = mesh.nodes.iter().map(|n| [n.x, n.y]).collect();
    for (n, [r, t]) in mesh.nodes.iter_mut().zip(&polar) {
        (n.x, n.y) = (r * t.cos(), r * t.sin());
    }
    let near = |t: f64, at: f64| (t - at).abs() < 1e-9;
    let held = |i: usize, _: &Point3<f64>| [near(polar[i][1], FRAC_PI_2), near(polar[i][1], 0.0), true];
    let solid = Solid::new(mesh, young, poisson, held)?;
    // Pressure on the chords of the inner wall, by halves at both of their ends and at both ends of the tube.
    let chord = 2.0 * a * (FRAC_PI_2 / f64::from(cells) / 2.0).sin();
    let inner: Vec<usize> = (0..polar.len()).filter(|i| near(polar[*i][0], a)).collect();
    let load = |i: &usize| {
        let t = polar[*i][1];
        let share = if near(t, 0.0) || near(t, FRAC_PI_2) { 0.5 } else { 1.0 };
        (*i, Vector3::new(t.cos(), t.sin(), 0.0) * (p * chord * 1e-3 * share / 2.0))
    };
    let moved = solid.displacements(&[inner.iter().map(load).collect()]);
    let radial = |i: &usize| {
        let t = polar[*i][1];
        moved[0][*i].x * t.cos() + moved[0][*i].y * t.sin()
    };
    let mean = inner.iter().map(radial).sum::<f64>() / inner.len() as f64;
    Ok(Case::relative(
        format!("I1-{poisson}"),
        format!("tube of 10 and 17.2 mm under 1 kPa, ν = {poisson}: how far its inside moves"),
        "Lamé's closed form, plane strain",
        "m",
        [mean, exact],
        0.01,
    ))
}

/// \[N\] on a plate like the fovea, and by how much its deflection may differ. Beyond, the rubber beneath the patch is pushed so thin that
/// CalculiX's solids collapse.
const PUSHES: [f64; 4] = [0.01, 0.03, 0.1, 0.2];
const PUSHED_WITHIN: f64 = 0.07;

/// What CalculiX makes of a rubber plate that stretches, and this model of the same.
///
/// # Errors
///
/// [`CalculixError`] where CalculiX is not installed, or fails.
pub fn judged() -> Result<Vec<Case>, CalculixError> {
    let plate = Plate {
        size: [0.013, 0.011],
        thickness: 0.0012,
        young_modulus: 70e3,
        poisson_ratio: 0.49,
        patch: 0.0015,
        cells: [14, 12, 2],
    };
    // Linear cells bend as solids of 20 nodes do where there are twice as many of them.
    let mesh = Plate { cells: [14, 12, 4], ..plate }.mesh();
    let middle = plate.middle(&mesh.nodes)?;
    let cells = plate.pushed(&mesh);
    // A quarter of a side's share on each of its corners.
    let each = Vector3::new(0.0, 0.0, -1.0 / (4 * cells.len()) as f64);
    let corners = cells.iter().flat_map(|cell| [4, 5, 6, 7].map(|k| mesh.cells[*cell][k] as usize));
    let load: Vec<(usize, Vector3<f64>)> = corners.map(|n| (n, each)).collect();
    let held = |_: usize, p: &Point3<f64>| [plate.held(p); 3];
    let solid = Solid::new(mesh, plate.young_modulus, plate.poisson_ratio, held)?;
    let per_newton = -solid.displacements(&[load])[0][middle].z;
    let case = |(force, reference): (f64, f64)| {
        let linear = per_newton * force;
        let ours = linear * relaxed(linear / plate.thickness, STRETCHED);
        Case::relative(
            format!("I6-{force}"),
            format!(
                "rubber plate of 13 x 11 x 1.2 mm with fixed edges: how far its middle gives way to {force} N"
            ),
            "neo-Hookean solids of CalculiX ccx, run now",
            "m",
            [ours, reference],
            PUSHED_WITHIN,
        )
    };
    Ok(PUSHES.into_iter().zip(plate_deflections(&plate, &PUSHES)?).map(case).collect())
}

/// Pixels of a mode's picture that are as large as those of the first mode, and its field of view \[°\], across and down (thesis, Table 6.2).
const MODES: [([f64; 2], [f64; 2]); 3] =
    [([1640.0, 1232.0], [123.8, 91.0]), ([1280.0, 720.0], [94.7, 52.7]), ([640.0, 480.0], [46.8, 34.8])];
/// \[pixels\]
const FOCAL: f64 = 795.0;

fn fields_of_view() -> Vec<Case> {
    let of = |(mode, (pixels, degrees)): (usize, &([f64; 2], [f64; 2]))| {
        [0, 1].map(|k| {
            let way = ["across", "down"][k];
            Case::relative(
                format!("I3-{}-{way}", mode + 1),
                format!("field of view of mode {} {way}, equisolid lens of {FOCAL} pixels", mode + 1),
                "thesis, Table 6.2",
                "rad",
                [field_of_view(pixels[k], FOCAL), degrees[k].to_radians()],
                0.01,
            )
        })
    };
    MODES.iter().enumerate().flat_map(of).collect()
}

/// From pixels to directions and back, all over the largest picture.
fn round_trip() -> Case {
    let camera = Camera {
        size: [1640, 1232],
        focal: FOCAL,
        position: Point3::new(0.0, 0.0, 0.003),
        orientation: Rotation3::identity(),
    };
    let off = |i: u32| {
        let at = [f64::from(i % 41) * 40.0, f64::from(i / 41) * 44.0];
        camera
            .direction(at)
            .and_then(|direction| camera.project(&(camera.position + direction * 0.03)))
            .map_or(f64::INFINITY, |[x, y]| (x - at[0]).hypot(y - at[1]))
    };
    let worst = (0..41 * 29).map(off).fold(0.0, f64::max);
    let what = "pixel to direction to pixel, all over the picture: the largest difference";
    Case::new("I3-round-trip", what, "identity", "px", [worst, 0.0], (0.01, 1.0))
}

/// A lamp whose beam is as wide as everything.
fn wide_lamp() -> Light {
    Light {
        lamps: vec![Lamp { position: Point3::origin(), axis: Vector3::z(), power: [1.0; COLOURS] }],
        beam: Beam { radius: 1.0, spread: 100.0, edge: 1e-3 },
        finish: Finish { diffuse: 1.0, specular: 0.0, shininess: 1.0 },
        ambient: [0.0; COLOURS],
        sensor: Matrix3::identity(),
        gamma: 1.0,
    }
}

/// Light of a point lamp on a plane, beside its axis: I cos θ / d², by the value below the lamp.
fn point_lamp() -> Case {
    let light = wide_lamp();
    let (height, beside) = (0.02, 0.015);
    let on = |x: f64| light.irradiance(&light.lamps[0], &Point3::new(x, 0.0, height), &-Vector3::z());
    let far = height.hypot(beside);
    let exact = (height / far) * (height / far).powi(2);
    let what = "light of a point lamp on a plane, 15 mm beside its foot of 20 mm, over the light there";
    Case::relative("I4-lamp", what, "cos θ / d²", "", [on(beside) / on(0.0), exact], 5e-3)
}

/// A white furnace: a lamp in the middle of a ball. What falls on the ball is what the lamp sends, whatever the ball's size.
fn furnace() -> Case {
    let light = wide_lamp();
    let flux = |radius: f64| {
        let rings = 200;
        let ring = |i: i32| {
            // The lamp sends forwards only.
            let polar = FRAC_PI_2 * (f64::from(i) + 0.5) / f64::from(rings);
            let outwards = Vector3::new(polar.sin(), 0.0, polar.cos());
            let area = polar.sin() * radius * radius;
            area * light.irradiance(&light.lamps[0], &Point3::from(outwards * radius), &-outwards)
        };
        (0..rings).map(ring).sum::<f64>()
    };
    let what = "light on a ball around a lamp, over that on a ball of a third of the radius";
    Case::relative("I4-furnace", what, "conservation of energy", "", [flux(0.03) / flux(0.01), 1.0], 5e-3)
}

/// The noise of a pixel of the brightness that it is said for.
fn noise() -> Case {
    let noise = Noise { shot: (0.5 * 0.012f64.powi(2) - 0.004f64.powi(2)) / 0.4, read: 0.004 };
    let got = 2f64.sqrt() * noise.deviation(0.4);
    let what = "root mean square of the difference of two untouched pictures, at a brightness of 0.4";
    Case::relative("I5-idle", what, "thesis, section 6.4.3", "", [got, 0.012], 0.1)
}

/// \[m\] by which the whole inside moves inwards, and how far its looks may be off, over their change. Where the tip meets the cone, normals
/// begin to turn within a cell of the grid, which is more of a small change.
const MOVED: [(f64, f64); 3] = [(1e-4, 0.06), (1e-3, 0.01), (3e-3, 0.01)];

/// An inside that moves inwards everywhere looks like that of a thumb whose elastomer is thicker by as much. Rays meet that one by Newton's
/// method on its own shape, and neither a grid nor a displacement is in it.
fn moved_wall() -> Result<[Case; 3], String> {
    let camera = Camera {
        size: [410, 308],
        focal: FOCAL / 4.0,
        position: Point3::new(0.0, 0.0, 0.003),
        orientation: Rotation3::identity(),
    };
    let mut light = wide_lamp();
    light.lamps[0].position = Point3::new(0.006, 0.003, 0.003);
    light.finish = Finish { diffuse: 0.5, specular: 1.0, shininess: 12.0 };
    let thumb = Thumb::new(0.020, 0.070, 0.009)?;
    let grid = Grid::new(0.06, 0.00125, 84);
    let elastomer = |thickness: f64| Elastomer {
        thumb,
        thickness,
        young_modulus: 70e3,
        poisson_ratio: 0.49,
        density: 1070.0,
        skeleton: Skeleton { beam: 0.0016, inside: 0.0008, rings: Vec::new(), meridians: Vec::new() },
        fovea: None,
        around: 10,
        layers: 2,
        cell: 0.002,
    };
    let before = elastomer(0.004);
    let shading = Shading::new(&before, grid, &camera, light.clone(), None);
    Ok(MOVED.map(|(by, within)| {
        let after = elastomer(before.thickness + by);
        let mut field = Field { values: Vec::new(), rows: [0, grid.rows] };
        for node in 0..grid.count() {
            let [s, azimuth] = grid.place(node);
            let (_, normal) = inside(&before, s, azimuth);
            field.values.extend((normal * by).iter().map(|u| *u as f32));
        }
        let mut changes = Changes::default();
        shading.changes(&field, &mut Displaced::default(), &mut changes);
        let seen = |of: &Elastomer, [s, azimuth]: [f64; 2]| {
            let (p, normal) = inside(of, s, azimuth);
            light.seen(light.radiance(&p, &normal, &(camera.position - p).normalize()))
        };
        let (mut off, mut whole) = (0.0, 0.0);
        // The last rows look past the end of the other.
        for node in 0..grid.count() - 4 * grid.columns {
            let place = grid.place(node);
            let ray = (inside(&before, place[0], place[1]).0 - camera.position).normalize();
            let Some(met) = met_along(&after, &camera.position, &ray) else { continue };
            let (now, then) = (seen(&after, met), seen(&before, place));
            let (row, column) = (node / grid.columns, node % grid.columns);
            let found = changes.values[row * (grid.columns + 1) + column];
            for c in 0..COLOURS {
                let exact = f64::from(now[c] - then[c]);
                off += (f64::from(found[c]) - exact).powi(2);
                whole += exact * exact;
            }
        }
        Case::new(
            format!("I7-{by:e}"),
            format!(
                "inside that moves inwards by {} mm everywhere: how far its looks are off, over their change",
                by * 1e3
            ),
            "a thumb whose elastomer is thicker by as much, whose rays are followed anew",
            "",
            [(off / whole).sqrt(), 0.0],
            (within, 1.0),
        )
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_passes() {
        dermis_model::suite::all_pass(&cases().unwrap());
    }
}
