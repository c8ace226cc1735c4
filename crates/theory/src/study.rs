//! Everything that the isolines along a line say of a skin, as figures and files need it.

use dermis_model::tangents;
use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::normalised::Deviations;
use crate::resolution::{Testbed, along_line};
use crate::surface::positive;
use crate::{Isoline, IsolineFit, Line, LineTaxel, Path, TheoryError};

/// Share of the distance of taxels that one may lie beside a line and still be on it.
const BESIDE: f64 = 0.15;

/// What is asked of a line.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyOptions {
    /// S_min, in the unit of the skin: smaller readings count as none.
    pub least: f64,
    /// Values of the isolines, in the unit of the skin, ascending.
    pub values: Vec<f64>,
    /// \[N\] forces of the super-resolution factors, ascending.
    pub forces: Vec<f64>,
    /// \[N\] forces of the maps over place and force, ascending.
    pub map_forces: Vec<f64>,
    /// \[m\] between the places that are averaged over and drawn.
    pub step: f64,
    /// Precision with which an error would be measured.
    pub testbed: Testbed,
}

/// Isolines of one taxel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TaxelStudy {
    /// Its channel.
    pub channel: usize,
    /// \[m\] of its foot along the line.
    pub foot: f64,
    /// One a value.
    pub isolines: Vec<Isoline>,
    /// Of those that can be fitted.
    pub fits: Vec<IsolineFit>,
    /// c(0): newtons per unit of the skin straight above, by least squares of the force over the values.
    pub c: f64,
    /// Largest deviation of the forces straight above from c · S, relative to the largest of them.
    pub nonlinearity: f64,
    /// \[m\] distance from the foot and c(d), where the taxel reads the middle one of the values.
    pub c_by_distance: Vec<[f64; 2]>,
}

/// Deviations over place and force; `null` where a contact cannot be located.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LineMap {
    /// \[m\] along the line.
    pub arc: Vec<f64>,
    /// \[N\].
    pub forces: Vec<f64>,
    /// σ_P \[m\] of all taxels that read S_min or more, by exact corners: of a force, of a place.
    pub position: Vec<Vec<Option<f64>>>,
    /// σ_F \[N\], likewise.
    pub force: Vec<Vec<Option<f64>>>,
}

/// What one way of computing σ_P says, averaged over the line between the outermost taxels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Averages {
    /// \[m\] mean of σ_P.
    pub position: f64,
    /// \[m\] root mean square of σ_P.
    pub position_rms: f64,
    /// \[N\] mean of σ_F.
    pub force: f64,
    /// Share of the line where there is one.
    pub share: f64,
    /// Ω (5.20).
    pub factor: f64,
    /// Ω with the testbed's precision (5.21).
    pub factor_with_testbed: f64,
}

/// Averages under one force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ByForce {
    /// \[N\].
    pub force: f64,
    /// By (5.18) and (5.19): both taxels next to the contact, fitted isolines.
    pub fits: Option<Averages>,
    /// By the exact corners of both taxels next to the contact.
    pub corners: Option<Averages>,
    /// The Cramér–Rao bound of all taxels.
    pub bound: Option<Averages>,
}

/// Everything that a line says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LineStudy {
    /// \[m\] places along the line.
    pub arc: Vec<f64>,
    /// \[m\] from the first taxel to the last, or all around a ring.
    pub span: f64,
    /// S_min, in the unit of the skin.
    pub least: f64,
    /// In order along the line.
    pub taxels: Vec<TaxelStudy>,
    /// F_S \[N\] at every place: from here on two taxels read S_min.
    pub minimum_force: Vec<Option<f64>>,
    /// σ_P and σ_F.
    pub map: LineMap,
    /// Ω.
    pub by_force: Vec<ByForce>,
    /// Means of Ω over the forces: by the fits, by corners, by the bound; each without and with the testbed's precision.
    pub factors: Factors,
}

/// Super-resolution factors, means over all forces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Factors {
    /// (5.20), and with the testbed's precision.
    pub fits: [f64; 2],
    /// By exact corners.
    pub corners: [f64; 2],
    /// By the Cramér–Rao bound.
    pub bound: [f64; 2],
}

/// The straight line along a surface that most of the taxels lie on, in steps of `step` \[m\], and how far \[m\] from it a taxel
/// may lie to be on it.
///
/// # Errors
///
/// [`TheoryError::Line`] where no two taxels lie on one.
pub fn longest_row(surface: &Surface, feet: &[Point3<f64>], step: f64) -> Result<(Path, f64), TheoryError> {
    positive("step of a path [m]", step)?;
    let nearest = feet.iter().enumerate().map(|(i, a)| {
        let others = feet.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, b)| (a - b).norm()).filter(|d| *d > 1e-6).fold(f64::INFINITY, f64::min)
    });
    let mut nearest: Vec<f64> = nearest.filter(|d| d.is_finite()).collect();
    nearest.sort_by(f64::total_cmp);
    let Some(pitch) = nearest.get(nearest.len() / 2) else {
        return Err(TheoryError::Line { taxels: feet.len() });
    };
    let tolerance = BESIDE * pitch;
    let count = surface.points.len().max(1) as f64;
    let middle = Point3::from(surface.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count);
    let mut best: Option<(usize, f64, Point3<f64>, Vector3<f64>)> = None;
    for foot in feet {
        let [first, second] = tangents(&surface.project(foot).1);
        for direction in [first, second] {
            let path = Path::across(surface, foot, &direction, pitch / 8.0)?;
            let on = feet.iter().filter(|f| path.nearest(f).1 <= tolerance + pitch / 16.0).count();
            let off = (foot - middle).norm();
            // More taxels first, then nearer to the middle; the first direction (x) where both are equal.
            let better = best
                .as_ref()
                .is_none_or(|(most, least, ..)| on > *most || (on == *most && off < *least - 1e-9));
            if better {
                best = Some((on, off, *foot, direction));
            }
        }
    }
    let Some((taxels, _, through, direction)) = best else { return Err(TheoryError::Line { taxels: 0 }) };
    if taxels < 2 {
        return Err(TheoryError::Line { taxels });
    }
    Ok((Path::across(surface, &through, &direction, step)?, tolerance))
}

impl Line {
    /// Studies the line. `progress` is told the share that is done, now and then.
    #[must_use]
    pub fn study(&self, options: &StudyOptions, mut progress: impl FnMut(f64)) -> LineStudy {
        let taxels: Vec<TaxelStudy> = self.taxels().iter().map(|t| self.taxel(t, options)).collect();
        let minimum_force =
            (0..self.arc().len()).map(|p| self.responses().minimum_force(p, options.least, 2)).collect();
        let places = self.places(options.step);
        let rows = options.map_forces.len().max(1) as f64;
        let mut map = LineMap {
            arc: places.iter().map(|p| self.arc()[*p]).collect(),
            forces: options.map_forces.clone(),
            position: Vec::new(),
            force: Vec::new(),
        };
        for (row, force) in options.map_forces.iter().enumerate() {
            let found: Vec<Option<Deviations>> = places
                .iter()
                .map(|place| {
                    let active = self.responses().active(*place, *force, options.least);
                    (active.len() > 1).then(|| self.corners_of_all(*place, *force, &active)).flatten()
                })
                .collect();
            map.position.push(found.iter().map(|d| d.map(|d| d.position)).collect());
            map.force.push(found.iter().map(|d| d.map(|d| d.force)).collect());
            progress(0.5 * (row + 1) as f64 / rows);
        }
        let between: Vec<usize> = places
            .into_iter()
            .filter(|p| {
                let first = self.taxels()[0].foot;
                self.around().is_some()
                    || (first - 1e-9..=first + self.span() + 1e-9).contains(&self.arc()[*p])
            })
            .collect();
        let mut by_force = Vec::new();
        for (row, force) in options.forces.iter().enumerate() {
            by_force.push(self.averages(*force, &between, &taxels, options));
            progress(0.5 + 0.5 * (row + 1) as f64 / options.forces.len() as f64);
        }
        let mean = |of: fn(&ByForce) -> Option<Averages>| {
            let known: Vec<Averages> = by_force.iter().filter_map(of).collect();
            let n = known.len() as f64;
            [
                known.iter().map(|a| a.factor).sum::<f64>() / n,
                known.iter().map(|a| a.factor_with_testbed).sum::<f64>() / n,
            ]
        };
        let factors =
            Factors { fits: mean(|f| f.fits), corners: mean(|f| f.corners), bound: mean(|f| f.bound) };
        LineStudy {
            arc: self.arc().to_vec(),
            span: self.span(),
            least: options.least,
            taxels,
            minimum_force,
            map,
            by_force,
            factors,
        }
    }

    /// Places about `step` \[m\] apart.
    fn places(&self, step: f64) -> Vec<usize> {
        let last = self.arc().len() - 1;
        let every = ((step / (self.arc()[last] / last as f64)).round() as usize).max(1);
        (0..=last).step_by(every).collect()
    }

    fn taxel(&self, taxel: &LineTaxel, options: &StudyOptions) -> TaxelStudy {
        let isolines: Vec<Isoline> = options.values.iter().map(|v| self.isoline(taxel, *v)).collect();
        let fits: Vec<IsolineFit> = isolines.iter().filter_map(Isoline::fit).collect();
        let above = self.place(taxel.foot);
        let over: Vec<(f64, f64)> = options
            .values
            .iter()
            .filter_map(|v| Some((*v, self.responses().force_for(above, taxel.channel, *v)?)))
            .collect();
        let c = over.iter().map(|(s, f)| s * f).sum::<f64>() / over.iter().map(|(s, _)| s * s).sum::<f64>();
        let largest = over.iter().map(|(_, f)| *f).fold(0.0, f64::max);
        let off = over.iter().map(|(s, f)| (f - c * s).abs()).fold(0.0, f64::max);
        let value = options.values.get(options.values.len() / 2).copied().unwrap_or(options.least);
        let c_by_distance = self
            .places(options.step)
            .into_iter()
            .filter_map(|p| Some([self.distance(p, taxel), self.responses().slope(p, taxel.channel, value)?]))
            .collect();
        TaxelStudy {
            channel: taxel.channel,
            foot: taxel.foot,
            isolines,
            fits,
            c,
            nonlinearity: off / largest,
            c_by_distance,
        }
    }

    fn averages(
        &self,
        force: f64,
        places: &[usize],
        taxels: &[TaxelStudy],
        options: &StudyOptions,
    ) -> ByForce {
        let average = |of: &dyn Fn(usize) -> Option<Deviations>| -> Option<Averages> {
            let found: Vec<Deviations> = places.iter().filter_map(|p| of(*p)).collect();
            let n = found.len() as f64;
            if found.is_empty() {
                return None;
            }
            let position = found.iter().map(|d| d.position).sum::<f64>() / n;
            let factor = |sigma| along_line(self.span(), self.taxels().len(), sigma);
            Some(Averages {
                position,
                position_rms: (found.iter().map(|d| d.position * d.position).sum::<f64>() / n).sqrt(),
                force: found.iter().map(|d| d.force).sum::<f64>() / n,
                share: n / places.len() as f64,
                factor: factor(position),
                factor_with_testbed: factor(options.testbed.position(position)),
            })
        };
        let pair = |place: usize| self.pair(self.arc()[place]);
        let located = |place: usize| {
            pair(place).iter().all(|t| self.responses().reading(place, t.channel, force) >= options.least)
        };
        let fits_of = |taxel: &LineTaxel| {
            taxels.iter().find(|t| t.channel == taxel.channel).map_or(&[][..], |t| t.fits.as_slice())
        };
        ByForce {
            force,
            fits: average(&|place| {
                let pair = pair(place);
                located(place)
                    .then(|| self.by_fits(place, force, &pair, [fits_of(&pair[0]), fits_of(&pair[1])]))
                    .flatten()
            }),
            corners: average(&|place| {
                located(place).then(|| self.corners(place, force, pair(place).map(|t| t.channel))).flatten()
            }),
            bound: average(&|place| self.bound(place, force)),
        }
    }

    /// The Cramér–Rao bound of place along the line and force, from the differences of the readings themselves: of a
    /// recording as of a model.
    #[must_use]
    pub fn bound(&self, place: usize, force: f64) -> Option<Deviations> {
        let ([before, after], way) = self.beside(place);
        let change = 0.02 * force;
        let read = |place, channel, force| self.responses().reading(place, channel, force);
        let (mut xx, mut xf, mut ff) = (0.0, 0.0, 0.0);
        for (channel, sigma) in self.responses().noise().iter().enumerate() {
            let by_place = (read(after, channel, force) - read(before, channel, force)) / way / sigma;
            let by_force = (read(place, channel, force + change) - read(place, channel, force - change))
                / (2.0 * change)
                / sigma;
            if by_place.is_finite() && by_force.is_finite() {
                xx += by_place * by_place;
                xf += by_place * by_force;
                ff += by_force * by_force;
            }
        }
        let determinant = xx * ff - xf * xf;
        (determinant > 1e-12 * xx * ff)
            .then(|| Deviations { position: (ff / determinant).sqrt(), force: (xx / determinant).sqrt() })
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use dermis_model::{ForwardModel, Unknowns};

    use super::*;
    use crate::testing::{Dome, Row, Toy};
    use crate::{Responses, force_ladder, over_surface};

    fn study() -> (LineStudy, Row) {
        let model = Row::new();
        let (path, tolerance) = longest_row(model.surface(), &Row::feet(), 1.25e-4).unwrap();
        let responses = Responses::of_model(&model, &path.points, &force_ladder(2.5, 40), 0.004).unwrap();
        let line = Line::new(responses, &path, model.surface(), &Row::feet(), tolerance).unwrap();
        let options = StudyOptions {
            least: 100.0,
            values: (0..8).map(|i| 200.0 * 1.6f64.powi(i)).collect(),
            forces: vec![0.1, 0.3, 0.5, 1.0, 1.4],
            map_forces: vec![0.2, 1.0],
            step: 5e-4,
            testbed: Testbed::THESIS,
        };
        let mut seen = 0.0;
        let study = line.study(&options, |share| {
            assert!(share >= seen);
            seen = share;
        });
        assert_relative_eq!(seen, 1.0);
        (study, model)
    }

    #[test]
    fn the_row_of_the_thesis() {
        let (study, model) = study();
        assert_eq!(study.taxels.len(), 6);
        assert_relative_eq!(study.span, 0.0325, max_relative = 1e-6);
        for taxel in &study.taxels {
            // physics.md: 0.141 N/kPa at a light touch; a deeper contact spreads and reads less.
            assert!((0.135e-3..0.175e-3).contains(&taxel.c) && taxel.nonlinearity < 0.1, "{taxel:?}");
            // α falls with the value.
            assert!(taxel.fits[0].alpha > taxel.fits[taxel.fits.len() - 1].alpha);
            // c grows with the distance.
            assert!(
                taxel.c_by_distance.iter().all(|[d, c]| *c > 0.0 && (d.abs() < 1e-3 || *c > taxel.c * 0.9))
            );
        }
        // Less between two taxels than above one, and least where most taxels are near.
        let least = |x: f64| study.minimum_force[((x + 0.01625) / 1.25e-4).round() as usize].unwrap();
        assert!(least(0.0) < least(0.00325) && least(-0.01625) > least(0.0));
        for by in &study.by_force {
            let bound = over_surface(&model, by.force, 0.004, Unknowns::Line).unwrap().position.rms;
            assert_relative_eq!(by.bound.unwrap().position_rms, bound, max_relative = 0.05);
            let (fits, corners) = (by.fits.unwrap(), by.corners.unwrap());
            assert!((0.2..5.0).contains(&(fits.position / corners.position)), "{by:?}");
            // A box is wider than a standard deviation.
            assert!(corners.position > by.bound.unwrap().position);
            assert!(fits.factor_with_testbed < fits.factor);
        }
        // More force, more resolution; more taxels and more force, smaller boxes.
        assert!(
            study.by_force.windows(2).all(|w| w[1].corners.unwrap().factor > w[0].corners.unwrap().factor)
        );
        let middle = study.map.arc.len() / 2;
        assert!(study.map.position[1][middle].unwrap() < study.map.position[0][middle].unwrap());
    }

    #[test]
    fn rows_are_found_on_any_surface() {
        let grid = Toy::grid();
        let feet: Vec<_> = grid.taxels.iter().map(|(x, y)| Point3::new(*x, *y, 0.0)).collect();
        let (path, tolerance) = longest_row(grid.surface(), &feet, 0.001).unwrap();
        // Through the middle, along x.
        assert!(path.points.iter().all(|p| p.y == 0.0) && (tolerance - 0.0012).abs() < 1e-9);
        let dome = Dome::new();
        let (path, _) = longest_row(dome.surface(), &dome.feet, 0.0005).unwrap();
        let on = dome.feet.iter().filter(|f| path.nearest(f).1 < 0.001).count();
        assert!(on >= 5, "{on}");
        assert!(longest_row(grid.surface(), &feet[..1], 0.001).is_err());
    }
}
