//! Taxels along a line: where their isolines meet, and how exactly.

use dermis_skin::Surface;
use nalgebra::Point3;

use crate::normalised::Deviations;
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
    /// The line of `responses` at the places of `path`. `feet` are the points of the surface that lie above each channel's
    /// taxel; those further than `tolerance` \[m\] from the path are not on the line.
    ///
    /// # Errors
    ///
    /// [`TheoryError::Line`] where fewer than two taxels are on it, or the places are not those of the path.
    pub fn new(
        responses: Responses,
        path: &Path,
        surface: &Surface,
        feet: &[Point3<f64>],
        tolerance: f64,
    ) -> Result<Self, TheoryError> {
        let mut taxels: Vec<LineTaxel> = feet
            .iter()
            .enumerate()
            .filter(|(_, foot)| surface.geodesic(foot, &path.points[path.nearest(foot).0]) <= tolerance)
            .map(|(channel, foot)| LineTaxel { channel, foot: path.foot(foot) })
            .collect();
        taxels.sort_by(|a, b| a.foot.total_cmp(&b.foot));
        let fits = responses.points() == path.points.as_slice() && feet.len() == responses.channels();
        if !fits || taxels.len() < 2 {
            return Err(TheoryError::Line { taxels: taxels.len() });
        }
        Ok(Self { responses, arc: path.arc.clone(), around: path.around, taxels })
    }

    /// Readings at the places of the line.
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

    /// Signed distance \[m\] of a place from a taxel's foot, the shorter way around.
    #[must_use]
    pub fn distance(&self, place: usize, taxel: &LineTaxel) -> f64 {
        let off = self.arc[place] - taxel.foot;
        self.around.map_or(off, |around| (off + around / 2.0).rem_euclid(around) - around / 2.0)
    }

    /// Signed distance \[m\] of every place from a taxel's foot.
    #[must_use]
    pub fn distances(&self, taxel: &LineTaxel) -> Vec<f64> {
        (0..self.arc.len()).map(|place| self.distance(place, taxel)).collect()
    }

    /// A place by its number, and where it lies \[m\]: on a closed line numbers and lengths go on beyond its ends.
    fn at(&self, number: isize) -> Option<(usize, f64)> {
        let count = self.arc.len() as isize;
        match self.around {
            Some(around) => {
                let place = number.rem_euclid(count) as usize;
                Some((place, self.arc[place] + number.div_euclid(count) as f64 * around))
            }
            None => (0..count).contains(&number).then(|| (number as usize, self.arc[number as usize])),
        }
    }

    /// Places before and after one, itself at an end, and how far \[m\] they are apart.
    pub(crate) fn beside(&self, place: usize) -> ([usize; 2], f64) {
        let here = (place, self.arc[place]);
        let before = self.at(place as isize - 1).unwrap_or(here);
        let after = self.at(place as isize + 1).unwrap_or(here);
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
    pub fn place(&self, arc: f64) -> usize {
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
    fn gap(&self, place: usize, a: (usize, f64), b: (usize, f64)) -> Option<(f64, f64)> {
        let first = self.responses.force_for(place, a.0, a.1)?;
        let second = self.responses.force_for(place, b.0, b.1)?;
        Some((first - second, first))
    }

    /// Where the isolines of two channels' values cross, nearest to a place and within `bounds` (numbers of places, both
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
                let (Some((place, to)), Some((_, from))) = (self.at(next), self.at(*number)) else {
                    continue;
                };
                moved = true;
                let gap = self.gap(place, a, b);
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

    /// Numbers of all places around one: half of a closed line to either side.
    fn all(&self, place: usize) -> [isize; 2] {
        let (count, place) = (self.arc.len() as isize, place as isize);
        if self.around.is_some() { [place - count / 2, place + count / 2] } else { [0, count - 1] }
    }

    /// Readings of channels under a force at a place, and their deviations; `None` where one is not known.
    fn bands(&self, place: usize, force: f64, channels: &[usize]) -> Option<Vec<(usize, f64, f64)>> {
        let noise = self.responses.noise();
        let band = |c: &usize| (*c, self.responses.reading(place, *c, force), noise[*c]);
        let bands: Vec<_> = channels.iter().map(band).collect();
        bands.iter().all(|b| b.1.is_finite()).then_some(bands)
    }

    /// σ_P \[m\] and σ_F \[N\] of a contact at a place with `force` \[N\] from two channels, by the exact corners of the
    /// intersection of both isolines' bands S ± σ_S (5.7–5.10): half of the corners' bounding box. `None` where the
    /// isolines do not cross at all four corners: the area has no end on the line, or a value is not reached.
    #[must_use]
    pub fn corners(&self, place: usize, force: f64, pair: [usize; 2]) -> Option<Deviations> {
        let bands = self.bands(place, force, &pair)?;
        let corners = CORNERS.map(|signs| {
            let [a, b] = [0, 1].map(|i| (bands[i].0, bands[i].1 + signs[i] * bands[i].2));
            self.crossing(a, b, place, self.all(place))
        });
        extent(&corners.into_iter().collect::<Option<Vec<_>>>()?)
    }

    /// As [`corners`](Self::corners), of any set of channels: half of the bounding box of the area in which the bands of
    /// all of them overlap.
    #[must_use]
    pub fn corners_of_all(&self, place: usize, force: f64, channels: &[usize]) -> Option<Deviations> {
        let bands = self.bands(place, force, channels)?;
        // The area of all lies in that of the pair which locates best: no other corner need be looked for beyond it.
        let mut bounds = self.all(place);
        let mut smallest = f64::INFINITY;
        for (i, a) in bands.iter().enumerate() {
            for b in &bands[..i] {
                let Some(first) = self.first_order(place, force, [a.0, b.0]) else { continue };
                if first.position < smallest {
                    smallest = first.position;
                    let ends = [[1.0, -1.0], [-1.0, 1.0]].map(|s| {
                        self.crossing(
                            (a.0, a.1 + s[0] * a.2),
                            (b.0, b.1 + s[1] * b.2),
                            place,
                            self.all(place),
                        )
                    });
                    if let [Some(p), Some(q)] = ends {
                        let (low, high) = (p.arc.min(q.arc), p.arc.max(q.arc));
                        // From the place next to the one end to that next to the other.
                        let outside = |number: &isize, step: isize| {
                            let inner = self.at(*number).is_some_and(|(_, arc)| low < arc && arc < high);
                            inner.then_some(number + step)
                        };
                        let end =
                            |step| std::iter::successors(Some(place as isize), |n| outside(n, step)).last();
                        let whole = self.all(place);
                        bounds = [end(-1).unwrap_or(whole[0]), end(1).unwrap_or(whole[1])];
                        // The contact may lie on either end itself.
                        bounds = [bounds[0].min(place as isize - 1), bounds[1].max(place as isize + 1)];
                    }
                }
            }
        }
        let mut vertices = Vec::new();
        for (i, a) in bands.iter().enumerate() {
            for b in &bands[..i] {
                for signs in CORNERS {
                    let (p, q) = ((a.0, a.1 + signs[0] * a.2), (b.0, b.1 + signs[1] * b.2));
                    let Some(corner) = self.crossing(p, q, place, bounds) else { continue };
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
    fn slope(&self, place: usize, force: f64, channel: usize) -> Option<(f64, f64)> {
        let value = self.responses.reading(place, channel, force);
        let sigma = self.responses.noise()[channel];
        let ([before, after], way) = self.beside(place);
        let low = self.responses.force_for(before, channel, value)?;
        let high = self.responses.force_for(after, channel, value)?;
        let c = self.responses.slope(place, channel, value)?;
        Some(((high - low) / way, c * sigma))
    }

    /// σ_P and σ_F of a contact from two channels to first order, with the isolines' own slopes: (5.14) with the sign of
    /// each slope, so that it also holds outside of both taxels, and each channel's σ_S in newtons by its c(d).
    #[must_use]
    pub fn first_order(&self, place: usize, force: f64, pair: [usize; 2]) -> Option<Deviations> {
        let (first, a) = self.slope(place, force, pair[0])?;
        let (second, b) = self.slope(place, force, pair[1])?;
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
        place: usize,
        force: f64,
        pair: &[LineTaxel; 2],
        fits: [&[IsolineFit]; 2],
    ) -> Option<Deviations> {
        let mut slopes = 0.0;
        for (taxel, fits) in pair.iter().zip(fits) {
            let value = self.responses.reading(place, taxel.channel, force);
            slopes += IsolineFit::between(fits, value)?.slope(self.distance(place, taxel));
        }
        let value = self.responses.reading(place, pair[0].channel, force);
        let c = self.responses.slope(place, pair[0].channel, value)?;
        let both = 2.0 * c * self.responses.noise()[pair[0].channel];
        (slopes > 0.0).then_some(Deviations { position: both / slopes, force: both })
    }

    /// Whether two contacts, each a place and a force \[N\], can be told apart by their isolines (thesis 5.3.3): each reaches
    /// `needed` taxels that the other one leaves below `least`, so that its triangulation is not spoilt.
    #[must_use]
    pub fn told_apart(&self, a: (usize, f64), b: (usize, f64), least: f64, needed: usize) -> bool {
        let on_line = |(place, force): (usize, f64)| -> Vec<bool> {
            self.taxels.iter().map(|t| self.responses.reading(place, t.channel, force) >= least).collect()
        };
        let (first, second) = (on_line(a), on_line(b));
        let own = |x: &[bool], y: &[bool]| x.iter().zip(y).filter(|(x, y)| **x && !**y).count();
        own(&first, &second) >= needed && own(&second, &first) >= needed
    }

    /// Share of the pairs of contacts of `force` \[N\] each, at each of these distances \[m\] along the line, that
    /// [`told_apart`](Self::told_apart) can tell apart.
    #[must_use]
    pub fn told_apart_by_distance(&self, force: f64, least: f64, distances: &[f64]) -> Vec<f64> {
        let end = self.arc[self.arc.len() - 1];
        let farthest = self.around.map_or(end, |around| around / 2.0);
        distances
            .iter()
            .map(|distance| {
                // Around a closed line every place has another one at any distance up to half of it.
                let other = |arc: f64| match self.around {
                    Some(around) => Some((arc + distance).rem_euclid(around)),
                    None => Some(arc + distance).filter(|arc| *arc <= end + 1e-9),
                };
                let told: Vec<bool> = self
                    .arc
                    .iter()
                    .enumerate()
                    .filter(|_| *distance <= farthest + 1e-9)
                    .filter_map(|(place, arc)| Some((place, other(*arc)?)))
                    .map(|(place, arc)| self.told_apart((place, force), (self.place(arc), force), least, 2))
                    .collect();
                told.iter().filter(|t| **t).count() as f64 / told.len().max(1) as f64
            })
            .collect()
    }
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
mod tests {
    use approx::assert_relative_eq;
    use dermis_model::{ForwardModel, Unknowns};
    use nalgebra::Vector3;

    use super::*;
    use crate::normalised::TwoTaxels;
    use crate::testing::{Dome, Ideal, Toy};
    use crate::{cramer_rao, force_ladder};

    fn row(step: f64, noise: f64) -> (Line, Toy) {
        let mut model = Toy::row(6);
        model.noise.fill(noise);
        let path = Path::across(model.surface(), &Point3::origin(), &Vector3::x(), step).unwrap();
        let responses = Responses::of_model(&model, &path.points, &force_ladder(3.0, 30), 0.004).unwrap();
        let feet: Vec<_> = model.taxels.iter().map(|(x, y)| Point3::new(*x, *y, 0.0)).collect();
        (Line::new(responses, &path, model.surface(), &feet, 0.001).unwrap(), model)
    }

    /// Place at x.
    fn at(line: &Line, x: f64) -> usize {
        line.place(x + 0.02)
    }

    #[test]
    fn taxels_lie_in_order() {
        let (line, _) = row(0.0005, 2.0);
        assert_relative_eq!(line.span(), 0.0325, max_relative = 1e-6);
        assert_eq!(line.pair(0.02).map(|t| t.channel), [2, 3]);
        assert_eq!(line.pair(0.0).map(|t| t.channel), [0, 1]);
        assert_eq!(line.pair(0.04).map(|t| t.channel), [4, 5]);
    }

    #[test]
    fn corners_tend_to_the_closed_form_and_to_the_slopes_of_the_toy() {
        let (x, force) = (0.001, 0.8);
        // F = S (h + d²/h): σ_P = σ (c₁ + c₂) / |m₁ − m₂| with m = 2 S d / h.
        let h = 0.005;
        let (d1, d2) = (x + 0.00325, x - 0.00325);
        let c = |d: f64| h + d * d / h;
        let m = |d: f64| 2.0 * (force / c(d)) * d / h;
        let exact = |sigma: f64| sigma * (c(d1) + c(d2)) / (m(d1) - m(d2)).abs();
        for sigma in [1.0, 0.25] {
            let (line, _) = row(0.00005, sigma);
            let place = at(&line, x);
            let corners = line.corners(place, force, [2, 3]).unwrap();
            let first = line.first_order(place, force, [2, 3]).unwrap();
            assert_relative_eq!(first.position, exact(sigma), max_relative = 2e-3);
            assert_relative_eq!(corners.position, first.position, max_relative = 5e-3);
            assert_relative_eq!(corners.force, first.force, max_relative = 2e-2);
        }
    }

    /// The thesis' setting, with `count` taxels.
    fn ideal(count: usize, alpha: f64, sigma: f64) -> (Line, Ideal) {
        let model = Ideal::new(count, alpha, sigma);
        let path = Path::across(model.surface(), &Point3::origin(), &Vector3::x(), 0.00005).unwrap();
        let responses = Responses::of_model(&model, &path.points, &force_ladder(20.0, 60), 0.004).unwrap();
        let feet: Vec<_> = model.feet.iter().map(|x| Point3::new(*x, 0.0, 0.0)).collect();
        (Line::new(responses, &path, model.surface(), &feet, 0.001).unwrap(), model)
    }

    #[test]
    fn a_line_of_two_is_the_normalised_setting() {
        for alpha in [1.5, 2.0, 3.0] {
            let (line, model) = ideal(2, alpha, 0.02);
            let two = TwoTaxels::normalised(alpha).unwrap();
            for x in [-0.002, 0.0, 0.001, 0.004] {
                let place = at(&line, x);
                let contact = (line.responses().points()[place].x - model.feet[0]) / model.distance;
                let (found, expected) =
                    (line.corners(place, 2.0, [0, 1]).unwrap(), two.corners(contact, 0.02));
                assert_relative_eq!(found.position / model.distance, expected.position, max_relative = 5e-3);
                assert_relative_eq!(found.force, expected.force, max_relative = 1e-2);
            }
        }
    }

    #[test]
    fn taxels_further_away_locate_better_where_the_noise_is_the_same_force() {
        // Fig. 5.4: each band of a pair twice as far apart is crossed twice as steeply.
        let (line, _) = ideal(4, 2.0, 0.02);
        let place = at(&line, 0.0005);
        let of = |channels: &[usize]| line.corners_of_all(place, 6.0, channels).unwrap().position;
        let (two, three, four) = (of(&[1, 2]), of(&[1, 2, 3]), of(&[0, 1, 2, 3]));
        assert_relative_eq!(two, 0.02 * 0.005, max_relative = 5e-3);
        assert_relative_eq!(three / two, 0.5, max_relative = 5e-3);
        assert_relative_eq!(four / two, 1.0 / 3.0, max_relative = 5e-3);
        // F_S is lower between taxels than above one.
        let least = |x: f64| line.responses().minimum_force(at(&line, x), 0.1, 2).unwrap();
        assert_relative_eq!(least(0.0), 0.35, max_relative = 1e-3);
        assert_relative_eq!(least(0.0025), 1.1, max_relative = 1e-3);
    }

    #[test]
    fn fits_of_parabolas_give_the_same() {
        let (line, _) = row(0.0001, 1.0);
        let values: Vec<f64> = (1..=20).map(|i| f64::from(i) * 10.0).collect();
        let pair = line.pair(0.021);
        let fits = pair.map(|t| line.fits(&t, &values));
        let (place, force) = (line.place(0.021), 0.6);
        let found = line.by_fits(place, force, &pair, [&fits[0], &fits[1]]).unwrap();
        let first = line.first_order(place, force, pair.map(|t| t.channel)).unwrap();
        // Two different c, of which (5.18) takes one.
        assert!((found.position / first.position - 1.0).abs() < 0.35, "{found:?} {first:?}");
    }

    #[test]
    fn more_taxels_locate_no_worse() {
        let (line, model) = row(0.0001, 2.0);
        for x in [-0.006, 0.0, 0.0013] {
            let place = at(&line, x);
            let pair = line.pair(line.arc()[place]).map(|t| t.channel);
            let two = line.corners(place, 0.8, pair).unwrap().position;
            let of = |channels: &[usize]| line.corners_of_all(place, 0.8, channels).unwrap().position;
            assert_relative_eq!(of(&pair), two, max_relative = 1e-6);
            let (four, six) = (of(&[1, 2, 3, 4]), of(&[0, 1, 2, 3, 4, 5]));
            // Taxels that lie further away have steeper isolines, but here one σ_S of them is more force.
            assert!(four <= two && six <= four, "{two} {four} {six}");
            // And the box that holds all bands is wider than what their average would have, which is the bound.
            let contact = dermis_model::Indentation::sphere(
                line.responses().points()[place],
                Vector3::new(0.0, 0.0, -0.8),
                0.004,
            );
            let stimulus = dermis_model::Stimulus { contacts: vec![contact], ..Default::default() };
            let bound = cramer_rao(&model, &stimulus, Unknowns::Line).unwrap()[0].position;
            assert!(bound < six * 1.05, "{bound} {six}");
        }
    }

    #[test]
    fn equal_taxels_average() {
        // √n: four at each place of two.
        let model = |n: usize| {
            let feet: Vec<_> = (0..n).flat_map(|_| [(-0.00325, 0.0), (0.00325, 0.0)]).collect();
            Toy::new(&feet)
        };
        let bound = |n| {
            let contact = dermis_model::Indentation::sphere(
                Point3::new(0.001, 0.0, 0.0),
                Vector3::new(0.0, 0.0, -0.5),
                0.004,
            );
            let stimulus = dermis_model::Stimulus { contacts: vec![contact], ..Default::default() };
            cramer_rao(&model(n), &stimulus, Unknowns::Line).unwrap()[0].position
        };
        assert_relative_eq!(bound(1) / bound(4), 2.0, max_relative = 1e-6);
    }

    #[test]
    fn less_force_is_needed_between_taxels() {
        let (line, _) = row(0.0005, 2.0);
        let least = |x: f64| line.responses().minimum_force(at(&line, x), 50.0, 2).unwrap();
        assert!(least(0.0) < least(0.00325), "{} {}", least(0.0), least(0.00325));
        // Ever more taxels need ever more force.
        let more = |n| line.responses().minimum_force(at(&line, 0.0), 10.0, n).unwrap();
        assert!(more(2) < more(3) && more(3) <= more(4));
    }

    #[test]
    fn two_contacts_are_told_apart_where_each_has_taxels_of_its_own() {
        let (line, _) = row(0.0005, 2.0);
        let (a, b) = (at(&line, -0.0130), at(&line, 0.0130));
        assert!(line.told_apart((a, 0.3), (b, 0.3), 25.0, 2));
        assert!(!line.told_apart((a, 0.3), (at(&line, -0.0065), 0.3), 25.0, 2));
        // Close together never; "with higher forces the distinguishable distance is larger": they reach more taxels.
        let told = |force: f64| line.told_apart_by_distance(force, 25.0, &[0.004, 0.011, 0.012]);
        let (light, hard) = (told(0.3), told(0.6));
        assert_eq!((light[0], hard[0]), (0.0, 0.0));
        assert!(light[1] > hard[1] && light[2] > hard[2], "{light:?} {hard:?}");
    }

    #[test]
    fn distances_on_a_dome_are_those_along_it() {
        let model = Dome::new();
        let tip = Point3::new(0.0, 0.0, 0.026);
        let path = Path::across(model.surface(), &tip, &Vector3::x(), 0.0004).unwrap();
        let responses = Responses::of_model(&model, &path.points, &force_ladder(2.0, 20), 0.004).unwrap();
        let line = Line::new(responses, &path, model.surface(), &model.feet, 0.001).unwrap();
        // Tip, upper and lower taxels on both sides.
        assert_eq!(line.taxels().len(), 5);
        let tip = line.taxels()[2];
        assert_eq!(tip.channel, 0);
        let fit = line.isoline(&tip, 40.0).fit().unwrap();
        // A parabola in the distance along the surface.
        assert_relative_eq!(fit.alpha, 2.0, max_relative = 0.01);
        assert_relative_eq!(fit.g, 40.0 * 0.005, max_relative = 0.01);
        let place = line.place(tip.foot + 0.003);
        let pair = line.pair(line.arc()[place]).map(|t| t.channel);
        let (exact, first) =
            (line.corners(place, 1.0, pair).unwrap(), line.first_order(place, 1.0, pair).unwrap());
        assert_relative_eq!(exact.position, first.position, max_relative = 0.05);
    }

    #[test]
    fn a_ring_has_no_ends() {
        let model = Dome::new();
        let path =
            Path::across(model.surface(), &Point3::new(0.01, 0.0, 0.016), &Vector3::y(), 0.0002).unwrap();
        let responses = Responses::of_model(&model, &path.points, &force_ladder(3.0, 20), 0.004).unwrap();
        let line = Line::new(responses, &path, model.surface(), &model.feet, 0.001).unwrap();
        // Six taxels, the same everywhere between two of them, also where the path begins and ends.
        assert_eq!(line.taxels().len(), 6);
        assert_relative_eq!(line.span(), std::f64::consts::TAU * 0.01, max_relative = 1e-2);
        let sixth = line.span() / 6.0;
        let of = |i: usize| {
            let place = line.place((line.taxels()[0].foot + sixth * (0.3 + i as f64)) % line.span());
            let pair = line.pair(line.arc()[place]).map(|t| t.channel);
            let active = line.responses().active(place, 1.0, 20.0);
            let all = line.corners_of_all(place, 1.0, &active).unwrap();
            (line.corners(place, 1.0, pair).unwrap(), line.first_order(place, 1.0, pair).unwrap(), all)
        };
        let (first, ..) = of(0);
        for i in 0..6 {
            let (corners, linear, all) = of(i);
            assert_relative_eq!(corners.position, first.position, max_relative = 0.05);
            assert_relative_eq!(corners.position, linear.position, max_relative = 0.05);
            assert!(all.position <= corners.position * 1.001);
        }
        let fits = line.taxels().iter().map(|t| line.isoline(t, 40.0).fit().unwrap().alpha);
        assert!(fits.into_iter().all(|alpha| (alpha - 2.0).abs() < 0.02));
    }

    #[test]
    fn one_taxel_is_no_line() {
        let model = Toy::row(1);
        let path = Path::across(model.surface(), &Point3::origin(), &Vector3::x(), 0.001).unwrap();
        let responses = Responses::of_model(&model, &path.points, &force_ladder(1.0, 5), 0.004).unwrap();
        let error = Line::new(responses, &path, model.surface(), &[Point3::origin()], 0.001).unwrap_err();
        insta::assert_snapshot!(error, @"1 taxels lie on the line where at least two must: their isolines have to cross");
    }
}
