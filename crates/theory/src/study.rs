//! Everything that the isolines along a line say of a skin, as figures and files need it.
//!
//! Problem: how exactly can the taxels of a row locate a contact, by force and by place? Method: isolines of each taxel with their fits
//! (5.16), deviations from fits, from exact corners and as Cramér–Rao bound, and the super-resolution factors that follow from their
//! means (5.20, 5.21). Assumptions: those of [`Line`] and of [`Isoline`]. Cost: linear in channels, locations and forces, but for the
//! maps, which overlap the bands of all pairs of channels: hence [`MOST_STUDIED`] and [`MOST_BANDS`].

use std::collections::BTreeSet;

use dermis_model::tangents;
use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::normalised::Deviations;
use crate::path::{distinct, nearest};
use crate::resolution::{Testbed, along_line};
use crate::responses::Bracket;
use crate::surface::positive;
use crate::{Isoline, IsolineFit, Line, LineTaxel, Path, TheoryError};

/// Share of the distance of taxels that one may lie beside a line and still be on it.
const BESIDE: f64 = 0.15;
/// Channels on a line up to which the isolines of each are computed. Where there are more (a skin that reads every electrode while
/// each is driven has hundreds), only those are that σ_P is computed from: both next to some place of the line.
pub const MOST_STUDIED: usize = 64;
/// Channels at most whose bands are overlapped at one place: those that stand farthest out of their noise. The work goes with the
/// square of their number, and the bands of weaker channels are wider.
pub const MOST_BANDS: usize = 32;

/// Settings of the study of a line.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyOptions {
    /// S_min, in the unit of the skin: smaller readings count as none.
    pub least: f64,
    /// Values of the isolines, in the unit of the skin, ascending.
    pub values: Vec<f64>,
    /// \[N\] forces of the super-resolution factors, ascending.
    pub forces: Vec<f64>,
    /// \[N\] forces of the maps over position and force, ascending.
    pub map_forces: Vec<f64>,
    /// \[m\] between the locations that are averaged over and drawn.
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
    /// \[m\] locations along the line.
    pub arc: Vec<f64>,
    /// \[m\] from the first taxel to the last, or all around a ring.
    pub span: f64,
    /// S_min, in the unit of the skin.
    pub least: f64,
    /// Taxels on the line.
    pub count: usize,
    /// In order along the line: all of them, up to [`MOST_STUDIED`].
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
    // Channels of one taxel have one foot: each foot is tried once, and counts as often as there are channels.
    let (locations, of) = distinct(feet);
    let mut counts = vec![0usize; locations.len()];
    of.iter().for_each(|location| counts[*location] += 1);
    let nearest_other = locations.iter().zip(&counts).enumerate().flat_map(|(i, (a, count))| {
        let others = locations.iter().enumerate().filter(move |(j, _)| *j != i);
        let nearest = others.map(|(_, b)| (a - b).norm()).filter(|d| *d > 1e-6).fold(f64::INFINITY, f64::min);
        std::iter::repeat_n(nearest, *count)
    });
    let mut apart: Vec<f64> = nearest_other.filter(|d| d.is_finite()).collect();
    apart.sort_by(f64::total_cmp);
    let Some(pitch) = apart.get(apart.len() / 2) else {
        return Err(TheoryError::Line { taxels: feet.len() });
    };
    let tolerance = BESIDE * pitch;
    let count = surface.points.len().max(1) as f64;
    let middle = Point3::from(surface.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count);
    let mut best: Option<(usize, f64, Point3<f64>, Vector3<f64>)> = None;
    for foot in &locations {
        let [first, second] = tangents(&surface.project(foot).1);
        for direction in [first, second] {
            let (path, _) = Path::locations(surface, foot, &direction, pitch / 8.0)?;
            let on = |f: &Point3<f64>| nearest(&path, f).1 <= tolerance + pitch / 16.0;
            let on =
                locations.iter().zip(&counts).filter(|(f, _)| on(f)).map(|(_, count)| count).sum::<usize>();
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
    /// Studies the line. `progress` is called with the share that is done, now and then.
    #[must_use]
    pub fn study(&self, options: &StudyOptions, mut progress: impl FnMut(f64)) -> LineStudy {
        let taxels: Vec<TaxelStudy> = self.studied().iter().map(|t| self.taxel(t, options)).collect();
        let minimum_force =
            (0..self.arc().len()).map(|p| self.responses().minimum_force(p, options.least, 2)).collect();
        let locations = self.locations(options.step);
        let rows = options.map_forces.len().max(1) as f64;
        let mut map = LineMap {
            arc: locations.iter().map(|p| self.arc()[*p]).collect(),
            forces: options.map_forces.clone(),
            position: Vec::new(),
            force: Vec::new(),
        };
        for (row, force) in options.map_forces.iter().enumerate() {
            let found: Vec<Option<Deviations>> = locations
                .iter()
                .map(|location| {
                    let mut active = self.responses().active(*location, *force, options.least);
                    self.clearest(*location, *force, &mut active);
                    (active.len() > 1).then(|| self.corners_of_all(*location, *force, &active)).flatten()
                })
                .collect();
            map.position.push(found.iter().map(|d| d.map(|d| d.position)).collect());
            map.force.push(found.iter().map(|d| d.map(|d| d.force)).collect());
            progress(0.5 * (row + 1) as f64 / rows);
        }
        let between: Vec<usize> = locations
            .into_iter()
            .filter(|p| {
                let first = self.taxels()[0].foot;
                self.around().is_some()
                    || (first - 1e-9..=first + self.span() + 1e-9).contains(&self.arc()[*p])
            })
            .collect();
        let bounds: Vec<Vec<Option<Deviations>>> =
            between.iter().map(|location| self.bounds(*location, &options.forces)).collect();
        let mut by_force = Vec::new();
        for (row, force) in options.forces.iter().enumerate() {
            let bounds: Vec<Option<Deviations>> = bounds.iter().map(|of| of[row]).collect();
            by_force.push(self.averages(*force, (&between, &bounds), &taxels, options));
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
            count: self.taxels().len(),
            taxels,
            minimum_force,
            map,
            by_force,
            factors,
        }
    }

    /// The taxels whose isolines are computed ([`MOST_STUDIED`]).
    fn studied(&self) -> Vec<LineTaxel> {
        let all = self.taxels();
        if all.len() <= MOST_STUDIED {
            return all.to_vec();
        }
        let pairs: BTreeSet<usize> =
            self.arc().iter().flat_map(|arc| self.pair(*arc)).map(|taxel| taxel.channel).collect();
        all.iter().copied().filter(|taxel| pairs.contains(&taxel.channel)).collect()
    }

    /// Leaves [`MOST_BANDS`] of `channels`, in their order: those that stand farthest out of their noise.
    fn clearest(&self, location: usize, force: f64, channels: &mut Vec<usize>) {
        if channels.len() <= MOST_BANDS {
            return;
        }
        let clear = |c: &usize| self.responses().reading(location, *c, force) / self.responses().noise()[*c];
        let mut by_clarity = channels.clone();
        by_clarity.sort_by(|a, b| clear(b).total_cmp(&clear(a)));
        by_clarity.truncate(MOST_BANDS);
        channels.retain(|c| by_clarity.contains(c));
    }

    /// Locations about `step` \[m\] apart.
    fn locations(&self, step: f64) -> Vec<usize> {
        let last = self.arc().len() - 1;
        let every = ((step / (self.arc()[last] / last as f64)).round() as usize).max(1);
        (0..=last).step_by(every).collect()
    }

    fn taxel(&self, taxel: &LineTaxel, options: &StudyOptions) -> TaxelStudy {
        let isolines: Vec<Isoline> = options.values.iter().map(|v| self.isoline(taxel, *v)).collect();
        let fits: Vec<IsolineFit> = isolines.iter().filter_map(Isoline::fit).collect();
        let above = self.location(taxel.foot);
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
            .locations(options.step)
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
        (locations, bounds): (&[usize], &[Option<Deviations>]),
        taxels: &[TaxelStudy],
        options: &StudyOptions,
    ) -> ByForce {
        let average = |found: Vec<Deviations>| -> Option<Averages> {
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
                share: n / locations.len() as f64,
                factor: factor(position),
                factor_with_testbed: factor(options.testbed.position(position)),
            })
        };
        let at_locations = |of: &dyn Fn(usize) -> Option<Deviations>| {
            average(locations.iter().filter_map(|location| of(*location)).collect())
        };
        let pair = |location: usize| self.pair(self.arc()[location]);
        let located = |location: usize| {
            pair(location)
                .iter()
                .all(|t| self.responses().reading(location, t.channel, force) >= options.least)
        };
        let fits_of = |taxel: &LineTaxel| {
            taxels.iter().find(|t| t.channel == taxel.channel).map_or(&[][..], |t| t.fits.as_slice())
        };
        ByForce {
            force,
            fits: at_locations(&|location| {
                let pair = pair(location);
                located(location)
                    .then(|| self.by_fits(location, force, &pair, [fits_of(&pair[0]), fits_of(&pair[1])]))
                    .flatten()
            }),
            corners: at_locations(&|location| {
                located(location)
                    .then(|| self.corners(location, force, pair(location).map(|t| t.channel)))
                    .flatten()
            }),
            bound: average(bounds.iter().flatten().copied().collect()),
        }
    }

    /// The Cramér–Rao bound of place along the line and force, from the differences of the readings themselves: of a
    /// recording as of a model.
    #[must_use]
    pub fn bound(&self, location: usize, force: f64) -> Option<Deviations> {
        self.bounds(location, &[force]).pop().flatten()
    }

    /// [`bound`](Self::bound) under many forces: every channel's curves are read once.
    #[must_use]
    pub fn bounds(&self, location: usize, forces: &[f64]) -> Vec<Option<Deviations>> {
        let ([before, after], apart) = self.neighbours(location);
        let responses = self.responses();
        let brackets: Vec<[Option<Bracket>; 3]> = forces
            .iter()
            .map(|force| [0.0, 0.02, -0.02].map(|share| responses.bracket(force + share * force)))
            .collect();
        // By place twice, by place and force, by force twice.
        let mut sums = vec![[0.0; 3]; forces.len()];
        for (channel, sigma) in responses.noise().iter().enumerate() {
            let [before, here, after] = [before, location, after].map(|p| responses.curve(p, channel));
            for ((sums, force), [at, more, less]) in sums.iter_mut().zip(forces).zip(&brackets) {
                let (Some(at), Some(more), Some(less)) = (at, more, less) else { continue };
                let change = 0.02 * force;
                let by_place = (at.of(after) - at.of(before)) / apart / sigma;
                let by_force = (more.of(here) - less.of(here)) / (2.0 * change) / sigma;
                if by_place.is_finite() && by_force.is_finite() {
                    sums[0] += by_place * by_place;
                    sums[1] += by_place * by_force;
                    sums[2] += by_force * by_force;
                }
            }
        }
        let bound = |[xx, xf, ff]: [f64; 3]| {
            let determinant = xx * ff - xf * xf;
            (determinant > 1e-12 * xx * ff)
                .then(|| Deviations { position: (ff / determinant).sqrt(), force: (xx / determinant).sqrt() })
        };
        sums.into_iter().map(bound).collect()
    }
}

#[cfg(test)]
mod tests;
