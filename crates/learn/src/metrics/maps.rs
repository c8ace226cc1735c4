//! Errors of maps over a surface.
//!
//! Problem: a model gives one number, or one vector, a point of the surface; how far is that from the true map? Method: root
//! mean square of the differences over all points of all frames, as it is and as a share of the root mean square of the true
//! maps; for forces the error of their sum, too, which a map that is right but for its sharpness does not have. Points count
//! alike, whatever area they stand for. Assumption: true maps are those of [`Maps`], which spread a contact's force over its
//! patch and take displacements from the forward model. Cost: a true map a frame.

use std::borrow::Cow;
use std::collections::BTreeMap;

use dermis_skin::{Estimate, ForceValues};
use serde::{Deserialize, Serialize};

use super::contacts::{ContactsOfMaps, MapContacts, MapReading};
use super::examples::{Examples, MapExample};
use super::strongest::{StrongestErrors, StrongestPoints};
use crate::LearnError;
use crate::dataset::Truth;
use crate::target::{MapTarget, Maps};

/// Errors of one map, on frames of which the true map is known.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MapErrors {
    /// `m` or `N`, of one point.
    pub unit: String,
    /// On touched frames.
    pub touched: MapPart,
    /// On untouched ones, whose true map is 0.
    pub untouched: MapPart,
    /// On touched frames, by true number of contacts.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_number: BTreeMap<usize, MapOfNumber>,
    /// Contacts that are read off a map of forces, for each threshold; empty for displacements and where not requested.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contacts: Vec<MapContacts>,
    /// One contact by the strongest points, on touched frames; only of `map.force`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub strongest: Option<StrongestErrors>,
    /// Of every channel on touched frames; only of `signal`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channels: Option<ChannelErrors>,
    /// Single frames, for people, by ascending number of contacts; only of maps of forces on surfaces that are seen from above.
    #[serde(skip)]
    pub examples: Vec<MapExample>,
}

/// Errors of a signal, channel by channel, in the unit of the skin: what a transfer network leaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelErrors {
    /// Mean of estimate − truth.
    pub mean: Vec<f64>,
    /// Standard deviation around it.
    pub deviation: Vec<f64>,
}

/// Errors of one map on frames of one number of contacts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MapOfNumber {
    /// Frames that were compared.
    pub frames: usize,
    /// Root mean square over all numbers of all frames.
    pub rms: f64,
    /// Fraction of the variance of the true maps that is unexplained; absent where these are all the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fvu: Option<f64>,
}

/// Errors of one map on some frames.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MapPart {
    /// Frames that were compared.
    pub frames: usize,
    /// Frames for which no map of the right length was given.
    pub unanswered: usize,
    /// Root mean square over all points of all frames, of vectors that of the length of the difference; absent where nothing
    /// was compared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms: Option<f64>,
    /// [`rms`](Self::rms) divided by the root mean square of the true maps; absent where these are 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative: Option<f64>,
    /// \[N\] root mean square over the frames of the error of the sum of all points, of vectors of its length; absent for
    /// displacements.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total_force: Option<f64>,
}

/// Sum of squared differences, and of squares of the truth.
fn squares<T: Copy + Into<f64>>(truth: &[T], answer: &[T]) -> [f64; 2] {
    truth.iter().zip(answer).fold([0.0; 2], |[error, energy], (truth, answer)| {
        let (truth, answer): (f64, f64) = ((*truth).into(), (*answer).into());
        [error + (answer - truth).powi(2), energy + truth * truth]
    })
}

/// What [`MapPart`] is made of.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    frames: usize,
    points: usize,
    squares: f64,
    energy: f64,
    /// \[N²\] of the errors of the sums of all points.
    totals: f64,
}

impl Sums {
    fn push(&mut self, map: MapTarget, truth: &[f64], answer: &[f64]) {
        let [error, energy] = squares(truth, answer);
        self.frames += 1;
        self.points += truth.len() / map.per_point();
        self.squares += error;
        self.energy += energy;
        let axis = |k: usize| {
            let sum = |values: &[f64]| values.iter().skip(k).step_by(map.per_point()).sum::<f64>();
            (sum(answer) - sum(truth)).powi(2)
        };
        self.totals += (0..map.per_point()).map(axis).sum::<f64>();
    }

    /// Of `targets` frames.
    fn part(&self, map: MapTarget, targets: usize) -> MapPart {
        let any = self.frames > 0;
        MapPart {
            frames: self.frames,
            unanswered: targets.saturating_sub(self.frames),
            rms: any.then(|| (self.squares / self.points as f64).sqrt()),
            relative: (self.energy > 0.0).then(|| (self.squares / self.energy).sqrt()),
            total_force: (any && map.is_force()).then(|| (self.totals / self.frames as f64).sqrt()),
        }
    }
}

/// What is collected of one map.
struct Collected {
    map: MapTarget,
    /// Of untouched and touched frames.
    sums: [Sums; 2],
    by_number: BTreeMap<usize, MapScores>,
    contacts: Option<ContactsOfMaps>,
    strongest: Option<StrongestPoints>,
    channels: Option<ChannelSums>,
    examples: Option<Examples>,
}

/// What [`ChannelErrors`] are made of (Welford 1962).
#[derive(Default)]
struct ChannelSums {
    count: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl ChannelSums {
    fn push(&mut self, truth: &[f64], answer: &[f64]) {
        self.count += 1.0;
        self.mean.resize(truth.len(), 0.0);
        self.squares.resize(truth.len(), 0.0);
        let sums = self.mean.iter_mut().zip(&mut self.squares);
        for ((mean, squares), (truth, answer)) in sums.zip(truth.iter().zip(answer)) {
            let apart = answer - truth - *mean;
            *mean += apart / self.count;
            *squares += apart * (answer - truth - *mean);
        }
    }

    fn errors(self) -> Option<ChannelErrors> {
        let deviation = self.squares.iter().map(|s| (s / self.count).sqrt()).collect();
        (self.count > 0.0).then_some(ChannelErrors { mean: self.mean, deviation })
    }
}

/// Compares the maps that are given for frames with the true ones, frame by frame.
pub(crate) struct MapScorer {
    maps: Maps,
    /// Of each map that was given at least once: untouched and touched frames.
    sums: BTreeMap<&'static str, Collected>,
    /// How contacts are read off maps of forces; not where absent.
    reading: Option<MapReading>,
    /// Untouched and touched frames whose true map is known.
    targets: [usize; 2],
    truth: Vec<f64>,
}

impl MapScorer {
    /// Compares with these; contacts are read off maps of forces where the surface is wide enough for [`MapReading::default`].
    pub(crate) fn new(maps: Maps) -> Self {
        let reading = MapReading::of_surface(maps.surface());
        Self { maps, sums: BTreeMap::new(), reading, targets: [0; 2], truth: Vec::new() }
    }

    /// Reads contacts off maps of forces in this way.
    pub(crate) fn reading(mut self, reading: MapReading) -> Self {
        self.reading = Some(reading);
        self
    }

    /// Compares what is given for one frame; `given` answers with a map in SI units, or with nothing. Maps that cannot be known
    /// here are left out.
    ///
    /// # Errors
    ///
    /// [`LearnError::Training`] where the forward model fails on a displacement.
    pub(crate) fn push<'a>(
        &mut self,
        truth: &Truth,
        given: impl Fn(MapTarget) -> Option<Cow<'a, [f64]>>,
    ) -> Result<(), LearnError> {
        if !Maps::tells(truth) {
            return Ok(());
        }
        let part = usize::from(truth.touched());
        self.targets[part] += 1;
        for map in MapTarget::ALL {
            let Some(answer) = given(map).filter(|a| a.len() == self.maps.len(map)) else { continue };
            if !self.maps.knows(map) {
                continue;
            }
            self.truth.clear();
            self.maps.append(map, truth, &mut self.truth)?;
            let collected = self.sums.entry(map.name()).or_insert_with(|| Collected {
                map,
                sums: [Sums::default(); 2],
                by_number: BTreeMap::new(),
                contacts: (self.reading.clone().filter(|_| map.is_force()))
                    .map(|reading| ContactsOfMaps::new(self.maps.surface(), reading)),
                strongest: (map == MapTarget::Force).then(|| StrongestPoints::new(self.maps.surface())),
                channels: (map == MapTarget::Signal).then(ChannelSums::default),
                examples: map.is_force().then(|| Examples::of(self.maps.surface())),
            });
            collected.sums[part].push(map, &self.truth, &answer);
            let pressing = map.is_force().then(|| self.maps.pressing(map, &answer));
            if truth.touched() {
                let of_number = collected.by_number.entry(truth.contacts.len()).or_default();
                of_number.push(&self.truth, &answer);
                if let Some(channels) = &mut collected.channels {
                    channels.push(&self.truth, &answer);
                }
                if let Some(strongest) = &mut collected.strongest {
                    strongest.push(truth, &answer);
                }
                if let (Some(examples), Some(pressing)) = (&mut collected.examples, &pressing) {
                    examples.push(truth, &self.maps.pressing(map, &self.truth), pressing);
                }
            }
            if let (Some(contacts), Some(pressing)) = (&mut collected.contacts, &pressing) {
                contacts.push(truth, pressing);
            }
        }
        Ok(())
    }

    /// Compares the maps of an estimate.
    ///
    /// # Errors
    ///
    /// As [`push`](Self::push).
    pub(crate) fn push_estimate(&mut self, truth: &Truth, estimate: &Estimate) -> Result<(), LearnError> {
        let whole = |values: &[f32]| Cow::Owned(values.iter().map(|v| f64::from(*v)).collect());
        self.push(truth, |map| {
            let forces = estimate.force_map.as_ref().filter(|m| m.indices.is_none()).map(|m| &m.forces);
            match (map, forces) {
                (MapTarget::Normal, Some(ForceValues::Normal(values))) => Some(whole(values)),
                (MapTarget::Force, Some(ForceValues::Vector(values))) => Some(whole(values.as_flattened())),
                (MapTarget::Displacement, _) => {
                    let map = estimate.displacement_map.as_ref().filter(|m| m.indices.is_none())?;
                    Some(whole(&map.displacements))
                }
                _ => None,
            }
        })
    }

    /// Errors by name of the map; none of maps that were never given.
    pub(crate) fn finish(self) -> BTreeMap<String, MapErrors> {
        let [untouched, touched] = self.targets;
        let of_number = |(number, scores): (usize, MapScores)| {
            let MapSummary { maps: frames, rms, fvu } = scores.summary();
            (number, MapOfNumber { frames, rms, fvu: Some(fvu).filter(|fvu| fvu.is_finite()) })
        };
        let errors =
            |Collected { map, sums, by_number, contacts, strongest, channels, examples }| MapErrors {
                unit: self.maps.unit(map).into(),
                touched: sums[1].part(map, touched),
                untouched: sums[0].part(map, untouched),
                by_number: by_number.into_iter().map(of_number).collect(),
                contacts: contacts.map(|contacts| contacts.finish()).unwrap_or_default(),
                strongest: strongest.and_then(|strongest| strongest.finish()),
                channels: channels.and_then(ChannelSums::errors),
                examples: examples.map(Examples::finish).unwrap_or_default(),
            };
        self.sums.into_iter().map(|(name, of)| (name.to_owned(), errors(of))).collect()
    }
}

/// Errors of whole maps (displacements over a surface), map by map.
#[derive(Debug, Clone, Default)]
pub struct MapScores {
    squares: f64,
    energy: f64,
    /// Sum of the true maps, point by point.
    sums: Vec<f64>,
    maps: usize,
}

/// What [`MapScores`] come to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MapSummary {
    /// Maps that were compared.
    pub maps: usize,
    /// Root mean square over all points of all maps, in their unit.
    pub rms: f64,
    /// Fraction of the variance of the true maps that is unexplained: 0 is perfect, 1 as good as their mean.
    pub fvu: f64,
}

impl MapScores {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Compares one map with the true one. Maps of another length than the first are left out.
    pub fn push<T: Copy + Into<f64>>(&mut self, truth: &[T], answer: &[T]) {
        if self.maps == 0 {
            self.sums = vec![0.0; truth.len()];
        }
        if truth.len() != self.sums.len() || answer.len() != truth.len() {
            return;
        }
        let [error, energy] = squares(truth, answer);
        self.squares += error;
        self.energy += energy;
        self.sums.iter_mut().zip(truth).for_each(|(sum, t)| *sum += (*t).into());
        self.maps += 1;
    }

    /// Sums up; not a number where nothing was compared.
    #[must_use]
    pub fn summary(&self) -> MapSummary {
        let maps = self.maps as f64;
        let variance = self.energy - self.sums.iter().map(|s| s * s).sum::<f64>() / maps;
        MapSummary {
            maps: self.maps,
            rms: (self.squares / (maps * self.sums.len() as f64)).sqrt(),
            fvu: self.squares / variance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::tests::{contact, skin};

    fn truth(contacts: Vec<crate::TruthContact>) -> Truth {
        Truth { press: 0, location: 0, idle: contacts.is_empty(), contacts }
    }

    /// Compares the true map of a truth, changed by `change`, and sums up.
    fn scored(map: MapTarget, truths: &[Truth], change: impl Fn(&mut Vec<f64>)) -> MapErrors {
        let mut maps = Maps::new(&skin(), None, &[]).unwrap();
        let mut scorer = MapScorer::new(Maps::new(&skin(), None, &[]).unwrap());
        for truth in truths {
            let mut values = Vec::new();
            maps.append(map, truth, &mut values).unwrap();
            change(&mut values);
            scorer.push(truth, |of| (of == map).then_some(Cow::Borrowed(values.as_slice()))).unwrap();
        }
        let mut all = scorer.finish();
        assert_eq!(all.keys().collect::<Vec<_>>(), [map.name()], "no other map was given");
        all.remove(map.name()).unwrap()
    }

    #[test]
    fn a_map_of_forces_errs_at_its_points_and_in_its_sum() {
        // The pad has 25 points; a tip of 4 mm touches one of them, 5 mm apart, which gets the force.
        let frames =
            [truth(vec![contact(0.0, 0.0, 3.0)]), truth(vec![contact(0.005, 0.0, 4.0)]), truth(vec![])];
        let right = scored(MapTarget::Normal, &frames, |_| {});
        let perfect = |frames, relative| MapPart {
            frames,
            unanswered: 0,
            rms: Some(0.0),
            relative,
            total_force: Some(0.0),
        };
        assert_eq!((&right.touched, right.unit.as_str()), (&perfect(2, Some(0.0)), "N"));
        assert_eq!(right.untouched, perfect(1, None));

        // 0.1 N too much at every point: 2.5 N in all.
        let more = scored(MapTarget::Normal, &frames, |map| map.iter_mut().for_each(|v| *v += 0.1));
        approx::assert_relative_eq!(more.touched.rms.unwrap(), 0.1, max_relative = 1e-9);
        approx::assert_relative_eq!(more.touched.total_force.unwrap(), 2.5, max_relative = 1e-9);
        // The truth has 3² + 4² N² on 50 points.
        let relative = 0.1 / (25.0_f64 / 50.0).sqrt();
        approx::assert_relative_eq!(more.touched.relative.unwrap(), relative, max_relative = 1e-9);
        approx::assert_relative_eq!(more.untouched.rms.unwrap(), 0.1, max_relative = 1e-9);
        assert_eq!(more.untouched.relative, None);

        // The right force at the wrong point: nothing is wrong with the sum.
        let moved = scored(MapTarget::Normal, &frames[..1], |map| map.rotate_left(1));
        approx::assert_relative_eq!(
            moved.touched.rms.unwrap(),
            (18.0_f64 / 25.0).sqrt(),
            max_relative = 1e-9
        );
        approx::assert_relative_eq!(moved.touched.relative.unwrap(), 2.0_f64.sqrt(), max_relative = 1e-9);
        assert!(moved.touched.total_force.unwrap() < 1e-12);
    }

    #[test]
    fn vectors_err_by_the_length_of_their_difference() {
        let frames = [truth(vec![contact(0.0, 0.0, 2.0)])];
        // 0.3 N along x and 0.4 N along y at one point.
        let off = scored(MapTarget::Force, &frames, |map| {
            map[0] += 0.3;
            map[1] += 0.4;
        });
        approx::assert_relative_eq!(off.touched.rms.unwrap(), 0.1, max_relative = 1e-9);
        approx::assert_relative_eq!(off.touched.relative.unwrap(), 0.25, max_relative = 1e-9);
        approx::assert_relative_eq!(off.touched.total_force.unwrap(), 0.5, max_relative = 1e-9);
    }

    #[test]
    fn frames_without_a_map_are_counted_and_unknown_truths_are_not() {
        let points = skin().surface().points.len();
        let mut scorer = MapScorer::new(Maps::new(&skin(), None, &[]).unwrap());
        let touched = truth(vec![contact(0.0, 0.0, 2.0)]);
        let normal = |values: usize| {
            let forces = ForceValues::Normal(vec![0.0; values]);
            let force_map = Some(dermis_skin::ForceMap { indices: None, forces });
            // Nobody knows here how far the surface gives way.
            let displacements = vec![0.0; points];
            let displacement_map = Some(dermis_skin::DisplacementMap { indices: None, displacements });
            Estimate { contacts: Vec::new(), force_map, displacement_map }
        };
        scorer.push_estimate(&touched, &normal(points)).unwrap();
        scorer.push_estimate(&touched, &normal(points - 1)).unwrap();
        scorer.push_estimate(&touched, &Estimate::default()).unwrap();
        scorer.push_estimate(&truth(vec![]), &Estimate::default()).unwrap();
        let mut unknown = contact(0.0, 0.0, 1.0);
        unknown.components = dermis_skin::ForceComponents::None;
        scorer.push_estimate(&truth(vec![unknown]), &normal(points)).unwrap();
        let all = scorer.finish();
        assert_eq!(all.len(), 1, "{all:?}");
        let MapErrors { touched, untouched, .. } = &all["map.normal"];
        assert_eq!((touched.frames, touched.unanswered), (1, 2));
        approx::assert_relative_eq!(touched.relative.unwrap(), 1.0, max_relative = 1e-9);
        approx::assert_relative_eq!(touched.total_force.unwrap(), 2.0, max_relative = 1e-9);
        assert_eq!((untouched.frames, untouched.unanswered, untouched.rms), (0, 1, None));
        let text = serde_json::to_string(untouched).unwrap();
        assert_eq!(text, r#"{"frames":0,"unanswered":1}"#);
        assert_eq!(serde_json::from_str::<MapPart>(&text).unwrap(), *untouched);
    }

    #[test]
    fn maps_are_compared_point_by_point() {
        let truth = [[1.0, 0.0, 2.0], [3.0, 0.0, -2.0]];
        let mut perfect = MapScores::new();
        let mut mean = MapScores::new();
        for t in &truth {
            perfect.push(t, t);
            mean.push(t, &[2.0, 0.0, 0.0]);
        }
        assert_eq!(perfect.summary(), MapSummary { maps: 2, rms: 0.0, fvu: 0.0 });
        let summary = mean.summary();
        assert!((summary.fvu - 1.0).abs() < 1e-12, "{summary:?}");
        assert!((summary.rms - (10.0f64 / 6.0).sqrt()).abs() < 1e-12, "{summary:?}");
        mean.push(&[1.0], &[1.0]);
        assert_eq!(mean.summary(), summary, "a map of another surface");
        assert!(MapScores::new().summary().rms.is_nan());
    }
}
