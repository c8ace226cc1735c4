//! Made-up skins with formulas of their own.

use std::sync::Mutex;

use dermis_fixtures::Analytic;
use dermis_mechanics::{Base, Medium, PressureTable};
use dermis_model::{ForwardModel, Indentation};
use dermis_skin::{Surface, SurfaceSpec};
use nalgebra::Point3;

pub const DEPTH: f64 = 0.005;

/// Point taxels at depth h under a plane: force · h / (r² + h²), and shear along x tilts the field.
pub fn toy(taxels: &[(f64, f64)]) -> Analytic {
    let spec = SurfaceSpec::Rectangle { size: [0.04, 0.04], spacing: 0.005 };
    let locations = taxels.iter().map(|(x, y)| Point3::new(*x, *y, 0.0));
    Analytic::new(Surface::from_spec(&spec), locations, 2.0, |c, taxel| {
        let (dx, dy) = (c.position.x - taxel.x, c.position.y - taxel.y);
        let r = dx * dx + dy * dy + DEPTH * DEPTH;
        (-c.force.z + 0.3 * c.force.x * dx / DEPTH) * DEPTH / r
    })
}

/// [`toy`] of 3×3 taxels 8 mm apart.
pub fn grid() -> Analytic {
    let at = |i: usize| (i as f64 - 1.0) * 0.008;
    toy(&(0..9).map(|i| (at(i % 3), at(i / 3))).collect::<Vec<_>>())
}

/// [`toy`] of taxels 6.5 mm apart along x.
pub fn row(count: usize) -> Analytic {
    let middle = (count as f64 - 1.0) / 2.0;
    toy(&(0..count).map(|i| ((i as f64 - middle) * 0.0065, 0.0)).collect::<Vec<_>>())
}

/// The same skin, whose channels read something where nothing touches: more than any touch of the tests, and least where it reads
/// most.
pub fn shifted(model: Analytic) -> Analytic {
    model.resting_at(|k| 3000.0 - 200.0 * k as f64)
}

/// What a skin reads for one contact that presses along the normal.
pub fn read(model: &Analytic, position: &Point3<f64>, force: f64) -> Vec<f64> {
    let (position, normal) = model.surface().project(position);
    model.read(&[Indentation::sphere(position, -normal * force, 0.004)])
}

/// Taxels at depth h under a dome: force · h / (d² + h²) with the shortest way d along the surface. One below the tip, six around
/// the hemisphere, two rings of six around the cylinder.
pub fn dome() -> Analytic {
    let spec = SurfaceSpec::Dome { radius: 0.010, cylinder: 0.016, spacing: 0.001 };
    let surface = Surface::from_spec(&spec);
    let mut feet = vec![Point3::new(0.0, 0.0, 0.026)];
    for (up, turn) in [(0.7, 0.0), (0.0, 0.5), (-0.7, 0.0)] {
        for i in 0..6 {
            let angle = (f64::from(i) + turn) * std::f64::consts::TAU / 6.0;
            feet.push(Point3::new(0.01 * angle.cos(), 0.01 * angle.sin(), 0.016 + 0.01 * up));
        }
    }
    let feet: Vec<_> = feet.iter().map(|p| surface.project(p).0).collect();
    // The last place, and its distance along the surface to each foot.
    let ways: Mutex<(Point3<f64>, Vec<f64>)> = Mutex::default();
    Analytic::of_contacts(surface.clone(), feet, 2.0, move |c, elements, out| {
        let pressing = -c.force.dot(&surface.project(&c.position).1);
        let mut ways = ways.lock().unwrap();
        if ways.0 != c.position || ways.1.is_empty() {
            *ways = (c.position, elements.iter().map(|e| surface.geodesic(&c.position, &e.at)).collect());
        }
        for (value, d) in out.iter_mut().zip(&ways.1) {
            *value += pressing * DEPTH / (d * d + DEPTH * DEPTH);
        }
    })
}

/// \[m\] between the taxels of [`ideal`].
pub const IDEAL_DISTANCE: f64 = 0.005;

/// The thesis' normalised setting with any number of taxels along x: a reading is the force less (|d| / distance)^α, so that
/// all isolines have the same shape and one σ_S is the same force everywhere.
pub fn ideal(count: usize, alpha: f64, sigma: f64) -> Analytic {
    let middle = (count as f64 - 1.0) / 2.0;
    let spec = SurfaceSpec::Rectangle { size: [0.04, 0.001], spacing: 0.001 };
    let feet = (0..count).map(|i| Point3::new((i as f64 - middle) * IDEAL_DISTANCE, 0.0, 0.0));
    Analytic::new(Surface::from_spec(&spec), feet, sigma, move |c, foot| {
        -c.force.z - ((c.position.x - foot.x).abs() / IDEAL_DISTANCE).powf(alpha)
    })
}

/// Six pressure sensors 6.5 mm apart, 5 mm deep in a bonded elastic layer of 10 mm, under a sphere of 4 mm: the row of the
/// thesis, with its noise of 20 Pa.
pub fn thesis_row() -> Analytic {
    let spec = SurfaceSpec::Rectangle { size: [0.0325, 0.0002], spacing: 0.0005 };
    let medium = Medium::layer(70e3, 0.49, 0.010, Base::Bonded).unwrap();
    let table = PressureTable::sphere(&medium, 0.004, 0.005, 0.034, 5.0).unwrap();
    let feet = (0..6).map(|i| Point3::new((f64::from(i) - 2.5) * 0.0065, 0.0, 0.0));
    Analytic::new(Surface::from_spec(&spec), feet, 20.0, move |c, foot| {
        table.pressure(-c.force.z, (c.position.x - foot.x).abs())
    })
}
