//! Contacts by triangulation: where the isolines of what the strongest taxels read cross (thesis 5.7.1).

use dermis_model::ForwardModel;
use dermis_skin::{Surface, SurfaceSpec};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::surface::positive;
use crate::{Path, Press, Responses, TheoryError, force_ladder};

/// Steps of force in a table.
const FORCES: usize = 40;

/// What an [`IsolineSolver`] is made with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SolverOptions {
    /// \[N\] largest force that is tabulated; a contact that presses harder is not found.
    pub force_max: f64,
    /// \[m\] between tabulated locations; between them isolines are straight.
    pub step: f64,
    /// \[m\] diameter of the tip, where the table is that of a model.
    pub diameter: f64,
    /// Readings below this many standard deviations of their noise do not count.
    pub threshold: f64,
    /// \[m\] around a tabulated place from which presses count, where a recording is read.
    pub reach: f64,
    /// How crossings are averaged.
    pub averaging: Averaging,
}

/// How the crossings of several pairs or triples become one contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Averaging {
    /// All the same, as the thesis does. Where two taxels lie on the same side of a contact their isolines run nearly
    /// parallel, and a crossing that noise moves far counts as much as a good one.
    Plain,
    /// By the inverse square of each crossing's σ_P, which its slopes give (5.14).
    #[default]
    Weighted,
}

impl SolverOptions {
    /// For taxels in a row: locations 0.1 mm apart.
    #[must_use]
    pub fn line() -> Self {
        Self {
            force_max: 2.5,
            step: 1e-4,
            diameter: 4e-3,
            threshold: 3.0,
            reach: 1e-3,
            averaging: Averaging::Weighted,
        }
    }

    /// For a surface: locations 0.5 mm apart.
    #[must_use]
    pub fn surface() -> Self {
        Self { step: 5e-4, reach: 1.5e-3, ..Self::line() }
    }
}

/// What the isolines say of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// \[m\] on the surface.
    pub position: Point3<f64>,
    /// \[N\] pressing.
    pub force: f64,
    /// Whether isolines do cross; otherwise this is where they come closest to each other.
    pub crossed: bool,
    /// Channels whose isolines were used, the strongest first.
    pub channels: Vec<usize>,
}

/// Finds a contact by crossing the isolines of the values that the strongest taxels read: along a line those of two, or of
/// each pair of more; on a surface those of three, or of each triple of more. The crossings are averaged.
///
/// It is what learning and maximum likelihood are compared with.
#[derive(Debug, Clone)]
pub struct IsolineSolver {
    responses: Responses,
    surface: Surface,
    shape: Shape,
    /// Place above each channel's taxel.
    peaks: Vec<usize>,
    threshold: f64,
    averaging: Averaging,
}

#[derive(Debug, Clone)]
enum Shape {
    Line,
    Surface,
}

/// A crossing.
#[derive(Debug, Clone, Copy)]
struct Crossed {
    at: Point3<f64>,
    force: f64,
    /// Whether isolines do cross there.
    crossed: bool,
    /// \[m²\] that noise makes of it, to first order.
    variance: f64,
}

impl IsolineSolver {
    /// Along a line of a model's surface: through `through` in `direction`, from end to end.
    ///
    /// # Errors
    ///
    /// [`TheoryError`] where the model has no answer or an option is not positive.
    pub fn line_of_model(
        model: &dyn ForwardModel,
        through: &Point3<f64>,
        direction: &Vector3<f64>,
        options: &SolverOptions,
    ) -> Result<Self, TheoryError> {
        let path = Path::across(model.surface(), through, direction, options.step)?;
        let responses = Responses::of_model(model, &path.points, &options.forces()?, options.diameter)?;
        Ok(Self::new(responses, model.surface().clone(), Shape::Line, options))
    }

    /// On the whole surface of a model, triangulated anew with [`SolverOptions::step`].
    ///
    /// # Errors
    ///
    /// As [`line_of_model`](Self::line_of_model).
    pub fn surface_of_model(
        model: &dyn ForwardModel,
        spec: &SurfaceSpec,
        options: &SolverOptions,
    ) -> Result<Self, TheoryError> {
        let fine = options.surface_of(spec)?;
        let responses = Responses::of_model(model, &fine.points, &options.forces()?, options.diameter)?;
        Ok(Self::new(responses, fine, Shape::Surface, options))
    }

    /// Along a line, from presses on it: what was recorded (and is not what it is tried on). `noise` is that of the
    /// channels, in the unit of the skin.
    ///
    /// # Errors
    ///
    /// [`TheoryError`] where presses are of another skin or an option is not positive.
    pub fn line_of_presses(
        presses: &[Press],
        noise: &[f64],
        surface: &Surface,
        through: &Point3<f64>,
        direction: &Vector3<f64>,
        options: &SolverOptions,
    ) -> Result<Self, TheoryError> {
        let path = Path::across(surface, through, direction, options.step)?;
        let responses =
            Responses::of_presses(presses, noise, surface, &path.points, &options.forces()?, options.reach)?;
        Ok(Self::new(responses, surface.clone(), Shape::Line, options))
    }

    /// On a whole surface, from presses all over it.
    ///
    /// # Errors
    ///
    /// As [`line_of_presses`](Self::line_of_presses).
    pub fn surface_of_presses(
        presses: &[Press],
        noise: &[f64],
        spec: &SurfaceSpec,
        options: &SolverOptions,
    ) -> Result<Self, TheoryError> {
        let fine = options.surface_of(spec)?;
        let responses =
            Responses::of_presses(presses, noise, &fine, &fine.points, &options.forces()?, options.reach)?;
        Ok(Self::new(responses, fine, Shape::Surface, options))
    }

    fn new(responses: Responses, surface: Surface, shape: Shape, options: &SolverOptions) -> Self {
        let peaks = (0..responses.channels()).map(|c| responses.peak(c)).collect();
        Self { responses, surface, shape, peaks, threshold: options.threshold, averaging: options.averaging }
    }

    /// Taxels that a solution needs: two along a line, three on a surface.
    #[must_use]
    pub fn needed(&self) -> usize {
        match self.shape {
            Shape::Line => 2,
            Shape::Surface => 3,
        }
    }

    /// The contact that one frame shows, by the isolines of its `taxels` strongest channels (at least
    /// [`needed`](Self::needed); fewer where fewer read anything). `values` are in the unit of the skin with the zero
    /// subtracted, one a channel; NaN where a channel is invalid.
    ///
    /// `None` where fewer than the needed channels read more than their noise: there is nothing to triangulate.
    #[must_use]
    pub fn solve(&self, values: &[f64], taxels: usize) -> Option<Solution> {
        let oriented = |(channel, value): (usize, &f64)| value * self.responses.orientation(channel);
        let values: Vec<f64> =
            values.iter().take(self.responses.channels()).enumerate().map(oriented).collect();
        let values = values.as_slice();
        let noise = self.responses.noise();
        let mut strongest: Vec<usize> = (0..self.responses.channels().min(values.len()))
            .filter(|c| values[*c] >= self.threshold * noise[*c])
            .collect();
        strongest.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
        strongest.truncate(taxels.max(self.needed()));
        if strongest.len() < self.needed() {
            return None;
        }
        // Where isolines cross more than once, the crossing counts that is nearest to what was found already: the
        // strongest come first. They are first expected between their taxels, nearer to those that read more.
        let points = self.responses.points();
        let total: f64 = strongest.iter().map(|c| values[*c]).sum();
        let between = strongest.iter().map(|c| points[self.peaks[*c]].coords * (values[*c] / total));
        let mut expected = Point3::from(between.sum::<Vector3<f64>>());
        let mut found: Vec<Crossed> = Vec::new();
        let mut take = |new: Option<Crossed>, expected: &mut Point3<f64>| {
            if let Some(new) = new {
                if found.is_empty() {
                    *expected = new.at;
                }
                found.push(new);
            }
        };
        match &self.shape {
            Shape::Line => {
                for pair in pairs(&strongest) {
                    take(self.cross_two(pair, values, &expected), &mut expected);
                }
            }
            Shape::Surface => {
                for three in triples(&strongest) {
                    take(self.cross_three(three, values, &expected), &mut expected);
                }
            }
        }
        // What only comes close counts where nothing crosses.
        let crossed = found.iter().any(|f| f.crossed);
        found.retain(|f| f.crossed || !crossed);
        let weight = |f: &Crossed| match self.averaging {
            Averaging::Weighted if crossed => 1.0 / f.variance,
            _ => 1.0,
        };
        let total: f64 = found.iter().map(weight).sum();
        let at = found.iter().map(|f| f.at.coords * (weight(f) / total)).sum::<Vector3<f64>>();
        (!found.is_empty() && total.is_finite()).then(|| Solution {
            position: self.surface.project(&Point3::from(at)).0,
            force: found.iter().map(|f| f.force * weight(f)).sum::<f64>() / total,
            crossed,
            channels: strongest,
        })
    }

    /// Newtons of one σ_S of a channel at a place, where it reads `value`.
    fn band(&self, location: usize, channel: usize, value: f64) -> f64 {
        // At the end of the table c is what it is on average.
        let average = || self.responses.force_for(location, channel, value).map(|f| f / value);
        let c = self.responses.slope(location, channel, value).or_else(average);
        c.map_or(f64::INFINITY, |c| c * self.responses.noise()[channel])
    }

    /// Where the isolines of two channels cross on a line, nearest to where it is expected.
    fn cross_two(&self, [a, b]: [usize; 2], values: &[f64], expected: &Point3<f64>) -> Option<Crossed> {
        let points = self.responses.points();
        let gap = |location: usize| {
            let first = self.responses.force_for(location, a, values[a])?;
            let second = self.responses.force_for(location, b, values[b])?;
            Some((first, second))
        };
        let mut best: Option<(f64, Crossed)> = None;
        let mut closest: Option<(f64, Crossed)> = None;
        let mut before: Option<(f64, f64)> = None;
        for location in 0..points.len() {
            let here = gap(location);
            if let Some((first, second)) = here {
                let apart = (first - second).abs() / (first + second);
                if closest.is_none_or(|(least, _)| apart < least) {
                    let (at, force) = (points[location], f64::midpoint(first, second));
                    closest = Some((apart, Crossed { at, force, crossed: false, variance: f64::INFINITY }));
                }
            }
            if let (Some((f0, s0)), Some((f1, s1))) = (before, here)
                && (f0 - s0) * (f1 - s1) <= 0.0
                && f0 - s0 != f1 - s1
            {
                let share = (f0 - s0) / ((f0 - s0) - (f1 - s1));
                let step = points[location] - points[location - 1];
                let at = points[location - 1] + step * share;
                let off = (at - expected).norm();
                if best.is_none_or(|(least, _)| off < least) {
                    let apart = ((f1 - s1) - (f0 - s0)) / step.norm();
                    let band = self.band(location, a, values[a]).hypot(self.band(location, b, values[b]));
                    let (force, variance) = (f0 + share * (f1 - f0), (band / apart).powi(2));
                    best = Some((off, Crossed { at, force, crossed: true, variance }));
                }
            }
            before = here;
        }
        best.or(closest).map(|(_, found)| found)
    }

    /// Where the isolines of three channels cross on a surface, nearest to where it is expected: within a triangle all of
    /// them are planes.
    fn cross_three(&self, channels: [usize; 3], values: &[f64], expected: &Point3<f64>) -> Option<Crossed> {
        let points = self.responses.points();
        // A contact lies nearer to the taxels that read most than these lie to each other, or not much further.
        let far = channels.iter().map(|c| (points[self.peaks[*c]] - expected).norm()).fold(0.0, f64::max);
        let forces: Vec<Option<[f64; 3]>> = points
            .iter()
            .enumerate()
            .map(|(location, point)| {
                if (point - expected).norm() > 1.5 * far + 1e-3 {
                    return None;
                }
                let [a, b, c] = channels.map(|c| self.responses.force_for(location, c, values[c]));
                Some([a?, b?, c?])
            })
            .collect();
        let mut best: Option<(f64, Crossed)> = None;
        for triangle in &self.surface.triangles {
            let corners = triangle.map(|i| i as usize);
            let [Some(p), Some(q), Some(r)] = corners.map(|i| forces[i]) else { continue };
            // F₀ − F₁ and F₀ − F₂ vanish at p + s (q − p) + t (r − p).
            let gap = |f: [f64; 3]| [f[0] - f[1], f[0] - f[2]];
            let [g, h, k] = [p, q, r].map(gap);
            let (a, b, c, d) = (h[0] - g[0], k[0] - g[0], h[1] - g[1], k[1] - g[1]);
            let determinant = a * d - b * c;
            if determinant == 0.0 {
                continue;
            }
            let s = (-g[0] * d + g[1] * b) / determinant;
            let t = (-g[1] * a + g[0] * c) / determinant;
            if !(s >= -1e-9 && t >= -1e-9 && s + t <= 1.0 + 1e-9) {
                continue;
            }
            let [u, v, w] = corners.map(|i| points[i]);
            let at = u + (v - u) * s + (w - u) * t;
            let off = (at - expected).norm();
            if best.is_none_or(|(least, _)| off < least) {
                let force = p[0] + s * (q[0] - p[0]) + t * (r[0] - p[0]);
                // Where the crossing goes when both gaps change, and what each channel's noise changes of them.
                let moved = |g: [f64; 2]| {
                    let (s, t) = ((g[0] * d - g[1] * b) / determinant, (g[1] * a - g[0] * c) / determinant);
                    ((v - u) * s + (w - u) * t).norm_squared()
                };
                let noise = channels.map(|c| self.band(corners[0], c, values[c]));
                let gaps = [[noise[0], noise[0]], [noise[1], 0.0], [0.0, noise[2]]];
                let variance = gaps.into_iter().map(moved).sum();
                best = Some((off, Crossed { at, force, crossed: true, variance }));
            }
        }
        best.map(|(_, found)| found).or_else(|| {
            let spread = |f: &[f64; 3]| {
                let mean = f.iter().sum::<f64>() / 3.0;
                f.iter().map(|f| (f / mean - 1.0).powi(2)).sum::<f64>()
            };
            let known = forces.iter().enumerate().filter_map(|(i, f)| Some((i, (*f)?)));
            let closest = known.min_by(|a, b| spread(&a.1).total_cmp(&spread(&b.1)))?;
            let (at, force) = (points[closest.0], closest.1.iter().sum::<f64>() / 3.0);
            Some(Crossed { at, force, crossed: false, variance: f64::INFINITY })
        })
    }
}

impl SolverOptions {
    fn forces(&self) -> Result<Vec<f64>, TheoryError> {
        Ok(force_ladder(positive("largest force [N]", self.force_max)?, FORCES))
    }

    fn surface_of(&self, spec: &SurfaceSpec) -> Result<Surface, TheoryError> {
        let step = positive("step of the table [m]", self.step)?;
        let mut fine = spec.clone();
        match &mut fine {
            SurfaceSpec::Rectangle { spacing, .. }
            | SurfaceSpec::Dome { spacing, .. }
            | SurfaceSpec::Panel { spacing, .. } => *spacing = step,
            // As fine as it was drawn.
            SurfaceSpec::Mesh { .. } | SurfaceSpec::Family(_) => {}
        }
        Ok(Surface::from_spec(&fine))
    }
}

fn pairs(channels: &[usize]) -> impl Iterator<Item = [usize; 2]> {
    let n = channels.len();
    (0..n).flat_map(move |i| (i + 1..n).map(move |j| [channels[i], channels[j]]))
}

fn triples(channels: &[usize]) -> impl Iterator<Item = [usize; 3]> {
    let n = channels.len();
    (0..n).flat_map(move |i| {
        (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| [channels[i], channels[j], channels[k]]))
    })
}

#[cfg(test)]
mod tests;
