//! Made-up skins with formulas of their own.

use dermis_mechanics::{Base, Medium, PressureTable};
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{ModelError, Surface, SurfaceSpec};
use nalgebra::Point3;

/// Point taxels at depth h under a plane: force · h / (r² + h²), and shear along x tilts the field.
pub struct Toy {
    surface: Surface,
    pub taxels: Vec<(f64, f64)>,
    pub noise: Vec<f64>,
}

pub const DEPTH: f64 = 0.005;

impl Toy {
    pub fn new(taxels: &[(f64, f64)]) -> Self {
        let spec = SurfaceSpec::Rectangle { size: [0.04, 0.04], spacing: 0.005 };
        Self { surface: Surface::from_spec(&spec), taxels: taxels.to_vec(), noise: vec![2.0; taxels.len()] }
    }

    pub fn grid() -> Self {
        let at = |i: usize| (i as f64 - 1.0) * 0.008;
        let taxels: Vec<_> = (0..9).map(|i| (at(i % 3), at(i / 3))).collect();
        Self::new(&taxels)
    }

    /// Taxels 6.5 mm apart along x.
    pub fn row(count: usize) -> Self {
        let middle = (count as f64 - 1.0) / 2.0;
        Self::new(&(0..count).map(|i| ((i as f64 - middle) * 0.0065, 0.0)).collect::<Vec<_>>())
    }

    pub fn read(&self, position: &Point3<f64>, force: f64) -> Vec<f64> {
        read(self, position, force)
    }
}

/// What a skin reads for one contact that presses along the normal.
pub fn read(model: &dyn ForwardModel, position: &Point3<f64>, force: f64) -> Vec<f64> {
    let (position, normal) = model.surface().project(position);
    let mut out = vec![0.0; model.channels()];
    let contacts = vec![Indentation::sphere(position, -normal * force, 0.004)];
    model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap();
    out
}

/// Taxels at depth h under a dome: force · h / (d² + h²) with the shortest way d along the surface.
pub struct Dome {
    surface: Surface,
    pub feet: Vec<Point3<f64>>,
    noise: Vec<f64>,
    /// The last place, and its distance along the surface to each foot.
    ways: std::sync::Mutex<(Point3<f64>, Vec<f64>)>,
}

impl Dome {
    /// One below the tip, six around the hemisphere, two rings of six around the cylinder.
    pub fn new() -> Self {
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
        Self { noise: vec![2.0; feet.len()], surface, feet, ways: std::sync::Mutex::default() }
    }
}

impl ForwardModel for Dome {
    fn channels(&self) -> usize {
        self.feet.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            let pressing = -c.force.dot(&self.surface.project(&c.position).1);
            let mut ways = self.ways.lock().unwrap();
            if ways.0 != c.position || ways.1.is_empty() {
                *ways =
                    (c.position, self.feet.iter().map(|f| self.surface.geodesic(&c.position, f)).collect());
            }
            for (value, d) in out.iter_mut().zip(&ways.1) {
                *value += pressing * DEPTH / (d * d + DEPTH * DEPTH);
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

/// A toy whose channels read something where nothing touches.
pub struct Shifted {
    pub toy: Toy,
    pub by: Vec<f64>,
}

impl Shifted {
    /// More on each channel than any touch of the tests, and least where the toy reads most.
    pub fn new(toy: Toy) -> Self {
        let by = (0..toy.taxels.len()).map(|k| 3000.0 - 200.0 * k as f64).collect();
        Self { toy, by }
    }
}

impl ForwardModel for Shifted {
    fn channels(&self) -> usize {
        self.toy.channels()
    }

    fn surface(&self) -> &Surface {
        self.toy.surface()
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        self.toy.response(stimulus, out)?;
        out.iter_mut().zip(&self.by).for_each(|(v, by)| *v += by);
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        self.toy.noise()
    }
}

impl ForwardModel for Toy {
    fn channels(&self) -> usize {
        self.taxels.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            for (value, (x, y)) in out.iter_mut().zip(&self.taxels) {
                let (dx, dy) = (c.position.x - x, c.position.y - y);
                let r = dx * dx + dy * dy + DEPTH * DEPTH;
                *value += (-c.force.z + 0.3 * c.force.x * dx / DEPTH) * DEPTH / r;
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

/// The thesis' normalised setting with any number of taxels along x: a reading is the force less (|d| / distance)^α, so that
/// all isolines have the same shape and one σ_S is the same force everywhere.
pub struct Ideal {
    surface: Surface,
    pub feet: Vec<f64>,
    pub distance: f64,
    pub alpha: f64,
    pub noise: Vec<f64>,
}

impl Ideal {
    pub fn new(count: usize, alpha: f64, sigma: f64) -> Self {
        let distance = 0.005;
        let middle = (count as f64 - 1.0) / 2.0;
        let spec = SurfaceSpec::Rectangle { size: [0.04, 0.001], spacing: 0.001 };
        let feet = (0..count).map(|i| (i as f64 - middle) * distance).collect();
        Self { surface: Surface::from_spec(&spec), feet, distance, alpha, noise: vec![sigma; count] }
    }
}

impl ForwardModel for Ideal {
    fn channels(&self) -> usize {
        self.feet.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            for (value, foot) in out.iter_mut().zip(&self.feet) {
                *value += -c.force.z - ((c.position.x - foot).abs() / self.distance).powf(self.alpha);
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

/// Six pressure sensors 6.5 mm apart, 5 mm deep in a bonded elastic layer of 10 mm, under a sphere of 4 mm: the row of the
/// thesis, with its noise of 20 Pa.
pub struct Row {
    surface: Surface,
    table: PressureTable,
    noise: Vec<f64>,
    /// Of each taxel's reading.
    pub gains: [f64; 6],
    /// \[m\] by which each taxel lies off its place.
    pub shifts: [f64; 6],
}

impl Row {
    pub fn new() -> Self {
        let spec = SurfaceSpec::Rectangle { size: [0.0325, 0.0002], spacing: 0.0005 };
        let medium = Medium::layer(70e3, 0.49, 0.010, Base::Bonded).unwrap();
        let table = PressureTable::sphere(&medium, 0.004, 0.005, 0.034, 5.0).unwrap();
        let surface = Surface::from_spec(&spec);
        Self { surface, table, noise: vec![20.0; 6], gains: [1.0; 6], shifts: [0.0; 6] }
    }

    pub fn feet() -> Vec<Point3<f64>> {
        (0..6).map(|i| Point3::new((f64::from(i) - 2.5) * 0.0065, 0.0, 0.0)).collect()
    }
}

impl ForwardModel for Row {
    fn channels(&self) -> usize {
        6
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for c in &stimulus.contacts {
            for (i, (value, foot)) in out.iter_mut().zip(Self::feet()).enumerate() {
                let distance = (c.position.x - foot.x - self.shifts[i]).abs();
                *value += self.gains[i] * self.table.pressure(-c.force.z, distance);
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}
