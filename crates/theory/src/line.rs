//! Taxels along a line: where their isolines meet, and how exactly.
//!
//! Problem: how far may a contact on a line be off where every channel reads its value within one deviation of its noise? Method:
//! intersection of the bands around isolines (thesis chapter 5, equations 5.7 to 5.10), exactly by their corners, and to first order
//! by their slopes (5.14). Assumptions: one contact, on the line, that presses along the normal; isolines are straight between the
//! locations of the line. Cost: a crossing searches outwards from a place, some tens of table reads; all pairs of channels at one place go
//! with the square of their number.

use dermis_skin::Surface;
use nalgebra::Point3;

use crate::normalised::Deviations;
use crate::path::distinct;
use crate::{Isoline, IsolineFit, Path, Responses, TheoryError};

/// Signs of both bands at the four corners of an intersection (5.7–5.10).
const CORNERS: [[f64; 2]; 4] = [[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]];

/// A taxel on a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineTaxel {
    /// Its channel.
    pub channel: usize,
    /// \[m\] of its foot along the path.
    pub foot: f64,
}

/// What the taxels along a path read when it is pressed somewhere on it.
///
/// Distances are those along the surface, also where it is curved.
#[derive(Debug, Clone)]
pub struct Line {
    responses: Responses,
    arc: Vec<f64>,
    /// \[m\] all around a closed line.
    around: Option<f64>,
    taxels: Vec<LineTaxel>,
}

/// Where two isolines cross.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crossing {
    pub(crate) arc: f64,
    pub(crate) force: f64,
}

impl Line {
    /// The line of `responses` at the locations of `path`. `feet` are the points of the surface that lie above each channel's
    /// taxel; those further than `tolerance` \[m\] from the path are not on the line.
    ///
    /// # Errors
    ///
    /// [`TheoryError::Line`] where fewer than two taxels are on it, or the locations are not those of the path.
    pub fn new(
        responses: Responses,
        path: &Path,
        surface: &Surface,
        feet: &[Point3<f64>],
        tolerance: f64,
    ) -> Result<Self, TheoryError> {
        let (locations, of) = distinct(feet);
        let on = |foot: &Point3<f64>| {
            let off = surface.geodesic(foot, &path.points[path.nearest(foot).0]);
            (off <= tolerance).then(|| path.foot(foot))
        };
        let on: Vec<Option<f64>> = locations.iter().map(on).collect();
        let mut taxels: Vec<LineTaxel> = of
            .iter()
            .enumerate()
            .filter_map(|(channel, location)| Some(LineTaxel { channel, foot: on[*location]? }))
            .collect();
        taxels.sort_by(|a, b| a.foot.total_cmp(&b.foot));
        let fits = responses.points() == path.points.as_slice() && feet.len() == responses.channels();
        if !fits || taxels.len() < 2 {
            return Err(TheoryError::Line { taxels: taxels.len() });
        }
        Ok(Self { responses, arc: path.arc.clone(), around: path.around, taxels })
    }

    /// Readings at the locations of the line.
    #[must_use]
    pub fn responses(&self) -> &Responses {
        &self.responses
    }

    /// \[m\] along the line of each place.
    #[must_use]
    pub fn arc(&self) -> &[f64] {
        &self.arc
    }

    /// In order along the line.
    #[must_use]
    pub fn taxels(&self) -> &[LineTaxel] {
        &self.taxels
    }

    /// \[m\] all around, where the line is closed.
    #[must_use]
    pub fn around(&self) -> Option<f64> {
        self.around
    }

    /// \[m\] from the first taxel to the last, or all around.
    #[must_use]
    pub fn span(&self) -> f64 {
        if let Some(around) = self.around {
            return around;
        }
        self.taxels.last().map_or(0.0, |t| t.foot) - self.taxels.first().map_or(0.0, |t| t.foot)
    }

    /// Signed distance \[m\] of a place from a taxel's foot, the shorter one where the line is closed.
    #[must_use]
    pub fn distance(&self, location: usize, taxel: &LineTaxel) -> f64 {
        let off = self.arc[location] - taxel.foot;
        self.around.map_or(off, |around| (off + around / 2.0).rem_euclid(around) - around / 2.0)
    }

    /// Signed distance \[m\] of every place from a taxel's foot.
    #[must_use]
    pub fn distances(&self, taxel: &LineTaxel) -> Vec<f64> {
        (0..self.arc.len()).map(|location| self.distance(location, taxel)).collect()
    }

    /// A place by its number, and where it lies \[m\]: on a closed line numbers and lengths go on beyond its ends.
    fn at(&self, number: isize) -> Option<(usize, f64)> {
        let count = self.arc.len() as isize;
        match self.around {
            Some(around) => {
                let location = number.rem_euclid(count) as usize;
                Some((location, self.arc[location] + number.div_euclid(count) as f64 * around))
            }
            None => (0..count).contains(&number).then(|| (number as usize, self.arc[number as usize])),
        }
    }

    /// Locations before and after one, itself at an end, and how far \[m\] they are apart.
    pub(crate) fn neighbours(&self, location: usize) -> ([usize; 2], f64) {
        let here = (location, self.arc[location]);
        let before = self.at(location as isize - 1).unwrap_or(here);
        let after = self.at(location as isize + 1).unwrap_or(here);
        ([before.0, after.0], after.1 - before.1)
    }

    /// The isoline of a taxel's value along the line.
    #[must_use]
    pub fn isoline(&self, taxel: &LineTaxel, value: f64) -> Isoline {
        Isoline::of(&self.responses, &self.distances(taxel), taxel.channel, value)
    }

    /// Fits of the isolines of a taxel at ascending values; what cannot be fitted is left out.
    #[must_use]
    pub fn fits(&self, taxel: &LineTaxel, values: &[f64]) -> Vec<IsolineFit> {
        values.iter().filter_map(|v| self.isoline(taxel, *v).fit()).collect()
    }

    /// Index of the place nearest to `arc` \[m\].
    #[must_use]
    pub fn location(&self, arc: f64) -> usize {
        let after = self.arc.partition_point(|a| *a < arc).min(self.arc.len() - 1);
        let before = after.saturating_sub(1);
        if (self.arc[before] - arc).abs() < (self.arc[after] - arc).abs() { before } else { after }
    }

    /// Both taxels between which `arc` \[m\] lies; the outermost two beyond them, unless the line is closed.
    #[must_use]
    pub fn pair(&self, arc: f64) -> [LineTaxel; 2] {
        let (first, last) = (self.taxels[0], self.taxels[self.taxels.len() - 1]);
        if self.around.is_some() && !(first.foot..last.foot).contains(&arc) {
            return [last, first];
        }
        let after = self.taxels.partition_point(|t| t.foot <= arc).clamp(1, self.taxels.len() - 1);
        [self.taxels[after - 1], self.taxels[after]]
    }

    /// Difference of two isolines at a place.
    fn gap(&self, location: usize, a: (usize, f64), b: (usize, f64)) -> Option<(f64, f64)> {
        let first = self.responses.force_for(location, a.0, a.1)?;
        let second = self.responses.force_for(location, b.0, b.1)?;
        Some((first - second, first))
    }

    /// Where the isolines of two channels' values cross, nearest to a place and within `bounds` (numbers of locations, both
    /// included).
    pub(crate) fn crossing(
        &self,
        a: (usize, f64),
        b: (usize, f64),
        near: usize,
        bounds: [isize; 2],
    ) -> Option<Crossing> {
        let start = self.gap(near, a, b);
        if let Some((0.0, force)) = start {
            return Some(Crossing { arc: self.arc[near], force });
        }
        // Two fronts that move outwards, one place at a time.
        let mut fronts = [(near as isize, start), (near as isize, start)];
        loop {
            let mut moved = false;
            for (step, (number, known)) in [-1, 1].into_iter().zip(&mut fronts) {
                let next = *number + step;
                if !(bounds[0]..=bounds[1]).contains(&next) {
                    continue;
                }
                let (Some((location, to)), Some((_, from))) = (self.at(next), self.at(*number)) else {
                    continue;
                };
                moved = true;
                let gap = self.gap(location, a, b);
                if let (Some((g0, f0)), Some((g1, f1))) = (*known, gap)
                    && (g0 < 0.0) != (g1 < 0.0)
                {
                    let share = g0 / (g0 - g1);
                    return Some(Crossing { arc: from + share * (to - from), force: f0 + share * (f1 - f0) });
                }
                (*number, *known) = (next, gap);
            }
            if !moved {
                return None;
            }
        }
    }

    /// Numbers of all locations around one: half of a closed line to either side.
    fn all(&self, location: usize) -> [isize; 2] {
        let (count, location) = (self.arc.len() as isize, location as isize);
        if self.around.is_some() { [location - count / 2, location + count / 2] } else { [0, count - 1] }
    }

    /// Readings of channels under a force at a place, and their deviations; `None` where one is not known.
    fn bands(&self, location: usize, force: f64, channels: &[usize]) -> Option<Vec<(usize, f64, f64)>> {
        let noise = self.responses.noise();
        let band = |c: &usize| (*c, self.responses.reading(location, *c, force), noise[*c]);
        let bands: Vec<_> = channels.iter().map(band).collect();
        bands.iter().all(|b| b.1.is_finite()).then_some(bands)
    }

    /// σ_P \[m\] and σ_F \[N\] of a contact at a place with `force` \[N\] from two channels, by the exact corners of the
    /// intersection of both isolines' bands S ± σ_S (5.7–5.10): half of the corners' bounding box. `None` where the
    /// isolines do not cross at all four corners: the area has no end on the line, or a value is not reached.
    #[must_use]
    pub fn corners(&self, location: usize, force: f64, pair: [usize; 2]) -> Option<Deviations> {
        let bands = self.bands(location, force, &pair)?;
        let corners = CORNERS.map(|signs| {
            let [a, b] = [0, 1].map(|i| (bands[i].0, bands[i].1 + signs[i] * bands[i].2));
            self.crossing(a, b, location, self.all(location))
        });
        extent(&corners.into_iter().collect::<Option<Vec<_>>>()?)
    }

    /// As [`corners`](Self::corners), of any set of channels: half of the bounding box of the area in which the bands of
    /// all of them overlap.
    #[must_use]
    pub fn corners_of_all(&self, location: usize, force: f64, channels: &[usize]) -> Option<Deviations> {
        let bands = self.bands(location, force, channels)?;
        // The area of all lies in that of the pair which locates best: no other corner need be looked for beyond it.
        let mut bounds = self.all(location);
        let mut smallest = f64::INFINITY;
        for (i, a) in bands.iter().enumerate() {
            for b in &bands[..i] {
                let Some(first) = self.first_order(location, force, [a.0, b.0]) else { continue };
                if first.position < smallest {
                    smallest = first.position;
                    let ends = [[1.0, -1.0], [-1.0, 1.0]].map(|s| {
                        self.crossing(
                            (a.0, a.1 + s[0] * a.2),
                            (b.0, b.1 + s[1] * b.2),
                            location,
                            self.all(location),
                        )
                    });
                    if let [Some(p), Some(q)] = ends {
                        let (low, high) = (p.arc.min(q.arc), p.arc.max(q.arc));
                        // From the place next to the one end to that next to the other.
                        let outside = |number: &isize, step: isize| {
                            let inner = self.at(*number).is_some_and(|(_, arc)| low < arc && arc < high);
                            inner.then_some(number + step)
                        };
                        let end = |step| {
                            std::iter::successors(Some(location as isize), |n| outside(n, step)).last()
                        };
                        let whole = self.all(location);
                        bounds = [end(-1).unwrap_or(whole[0]), end(1).unwrap_or(whole[1])];
                        // The contact may lie on either end itself.
                        bounds = [bounds[0].min(location as isize - 1), bounds[1].max(location as isize + 1)];
                    }
                }
            }
        }
        let mut vertices = Vec::new();
        for (i, a) in bands.iter().enumerate() {
            for b in &bands[..i] {
                for signs in CORNERS {
                    let (p, q) = ((a.0, a.1 + signs[0] * a.2), (b.0, b.1 + signs[1] * b.2));
                    let Some(corner) = self.crossing(p, q, location, bounds) else { continue };
                    if bands.iter().all(|band| self.holds(band, &corner)) {
                        vertices.push(corner);
                    }
                }
            }
        }
        // Fewer do not bound an area.
        if vertices.len() < 3 { None } else { extent(&vertices) }
    }

    /// Whether a point lies within a channel's band, on it included.
    fn holds(&self, &(channel, value, sigma): &(usize, f64, f64), at: &Crossing) -> bool {
        let arc = self.around.map_or(at.arc, |around| at.arc.rem_euclid(around));
        let after = self.arc.partition_point(|a| *a < arc).max(1) as isize;
        let after = if self.around.is_some() { after } else { after.min(self.arc.len() as isize - 1) };
        let (Some((before, from)), Some((after, to))) = (self.at(after - 1), self.at(after)) else {
            return false;
        };
        let share = (arc - from) / (to - from);
        let force = |value: f64| {
            let low = self.responses.force_for(before, channel, value)?;
            let high = self.responses.force_for(after, channel, value)?;
            Some(low + share * (high - low))
        };
        let slack = 1e-6 * at.force.abs() + 1e-12;
        // Where no force reaches the upper end, there is none.
        force(value - sigma).is_some_and(|low| low <= at.force + slack)
            && force(value + sigma).is_none_or(|high| at.force <= high + slack)
    }

    /// Slope dI/dx \[N/m\] of the isoline that passes through a contact, and what one σ_S of the channel is in newtons.
    fn slope(&self, location: usize, force: f64, channel: usize) -> Option<(f64, f64)> {
        let value = self.responses.reading(location, channel, force);
        let sigma = self.responses.noise()[channel];
        let ([before, after], apart) = self.neighbours(location);
        let low = self.responses.force_for(before, channel, value)?;
        let high = self.responses.force_for(after, channel, value)?;
        let c = self.responses.slope(location, channel, value)?;
        Some(((high - low) / apart, c * sigma))
    }

    /// σ_P and σ_F of a contact from two channels to first order, with the isolines' own slopes: (5.14) with the sign of
    /// each slope, so that it also holds outside of both taxels, and each channel's σ_S in newtons by its c(d).
    #[must_use]
    pub fn first_order(&self, location: usize, force: f64, pair: [usize; 2]) -> Option<Deviations> {
        let (first, a) = self.slope(location, force, pair[0])?;
        let (second, b) = self.slope(location, force, pair[1])?;
        let apart = (first - second).abs();
        // At the corners along the line one isoline is high by its band, the other low by its own.
        let end = (second * a + first * b).abs() / apart;
        let same = (second * a - first * b).abs() / apart;
        Some(Deviations { position: (a + b) / apart, force: end.max(same) })
    }

    /// σ_P \[m\] of (5.18) and 2cσ_S \[N\] of (5.19) for a contact between two taxels, with the slopes of the fitted
    /// isolines of the values that both read there, `fits` one list a taxel. c is that of the first taxel, as in the thesis.
    ///
    /// (5.19) is the height of the whole intersection where every other σ_F here is half of it.
    #[must_use]
    pub fn by_fits(
        &self,
        location: usize,
        force: f64,
        pair: &[LineTaxel; 2],
        fits: [&[IsolineFit]; 2],
    ) -> Option<Deviations> {
        let mut slopes = 0.0;
        for (taxel, fits) in pair.iter().zip(fits) {
            let value = self.responses.reading(location, taxel.channel, force);
            slopes += IsolineFit::between(fits, value)?.slope(self.distance(location, taxel));
        }
        let value = self.responses.reading(location, pair[0].channel, force);
        let c = self.responses.slope(location, pair[0].channel, value)?;
        let both = 2.0 * c * self.responses.noise()[pair[0].channel];
        (slopes > 0.0).then_some(Deviations { position: both / slopes, force: both })
    }

    /// Whether two contacts, each a place and a force \[N\], can be distinguished by their isolines (thesis 5.3.3): each reaches
    /// `needed` taxels that the other one leaves below `least`, so that its triangulation is not spoilt.
    #[must_use]
    pub fn distinguishable(&self, a: (usize, f64), b: (usize, f64), least: f64, needed: usize) -> bool {
        each_has_own(&self.reached(a, least), &self.reached(b, least), needed)
    }

    /// Which taxels of the line read `least` or more of a contact, a place and a force \[N\].
    fn reached(&self, (location, force): (usize, f64), least: f64) -> Vec<bool> {
        self.taxels.iter().map(|t| self.responses.reading(location, t.channel, force) >= least).collect()
    }

    /// Share of the pairs of contacts of `force` \[N\] each, at each of these distances \[m\] along the line, that
    /// [`distinguishable`](Self::distinguishable) can tell apart.
    #[must_use]
    pub fn distinguishable_by_distance(&self, force: f64, least: f64, distances: &[f64]) -> Vec<f64> {
        let end = self.arc[self.arc.len() - 1];
        let farthest = self.around.map_or(end, |around| around / 2.0);
        let reached: Vec<Vec<bool>> =
            (0..self.arc.len()).map(|location| self.reached((location, force), least)).collect();
        distances
            .iter()
            .map(|distance| {
                // Around a closed line every place has another one at any distance up to half of it.
                let other = |arc: f64| match self.around {
                    Some(around) => Some((arc + distance).rem_euclid(around)),
                    None => Some(arc + distance).filter(|arc| *arc <= end + 1e-9),
                };
                let apart: Vec<bool> = self
                    .arc
                    .iter()
                    .enumerate()
                    .filter(|_| *distance <= farthest + 1e-9)
                    .filter_map(|(location, arc)| Some((location, other(*arc)?)))
                    .map(|(location, arc)| each_has_own(&reached[location], &reached[self.location(arc)], 2))
                    .collect();
                apart.iter().filter(|t| **t).count() as f64 / apart.len().max(1) as f64
            })
            .collect()
    }
}

/// Whether each of two sets of taxels has so many that the other one has not.
fn each_has_own(first: &[bool], second: &[bool], needed: usize) -> bool {
    let own = |x: &[bool], y: &[bool]| x.iter().zip(y).filter(|(x, y)| **x && !**y).count();
    own(first, second) >= needed && own(second, first) >= needed
}

/// Half of a bounding box.
fn extent(corners: &[Crossing]) -> Option<Deviations> {
    let half = |of: fn(&Crossing) -> f64| {
        let high = corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
        let low = corners.iter().map(of).fold(f64::INFINITY, f64::min);
        (high - low) / 2.0
    };
    let found = Deviations { position: half(|c| c.arc), force: half(|c| c.force) };
    found.position.is_finite().then_some(found)
}

#[cfg(test)]
mod tests;
