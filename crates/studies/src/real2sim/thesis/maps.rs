//! How well whole maps are known from readings, by number of virtual sensors and kind of transfer (thesis, Fig. 3.5 A).
//!
//! For every number of virtual sensors one reconstruction is learned from the simulation alone. In front of it stand three
//! transfers, learned from the same recorded single contacts: a matrix, neighbours, and a network.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use anyhow::Result;
use dermis_learn::real2sim::{LinearMap, MapRegressor, NearestMaps, ProgressFn, Stages};
use dermis_learn::{Dataset, MapScores, MapSummary, SampleId};
use dermis_model::{ForwardModel, Stimulus};
use serde::Serialize;

use super::Known;
use crate::real2sim::compare::{Kind, Targets};
use crate::real2sim::sensors;

/// Neighbours that answer, as in the thesis.
const NEIGHBOURS: usize = 6;

/// Touched frames of one and of two contacts: what pressed, the signal, and the true map.
pub struct Frames {
    /// Row-major \[n, channels\], of one and of two contacts.
    pub(super) signals: [Vec<f32>; 2],
    /// What pressed.
    pub(super) stimuli: [Vec<Stimulus>; 2],
    /// Row-major \[n, points\] \[m\].
    maps: [Vec<f32>; 2],
    channels: usize,
}

impl Frames {
    /// Frames that are compared, whose channels all have a reading.
    pub(super) fn of(data: &Dataset, targets: &Targets, model: &dyn ForwardModel) -> Result<Self> {
        let channels = model.channels();
        let mut all = Self {
            signals: Default::default(),
            stimuli: Default::default(),
            maps: Default::default(),
            channels,
        };
        let mut map = vec![0.0; model.surface().points.len()];
        for (kind, ids) in &targets.all {
            let of = usize::from(*kind != Kind::Single);
            let kept: Vec<SampleId> = ids.iter().copied().filter(|id| targets.keeps(id)).collect();
            for (_, sample) in data.gather(&kept)? {
                let Some(stimulus) = sample.truth.as_ref().and_then(dermis_learn::stimulus) else { continue };
                if sample.tared.iter().any(|v| !v.is_finite()) || !model.displacement(&stimulus, &mut map)? {
                    continue;
                }
                all.signals[of].extend_from_slice(&sample.tared);
                all.stimuli[of].push(stimulus);
                all.maps[of].extend(map.iter().map(|d| *d as f32));
            }
        }
        Ok(all)
    }

    /// Signals of one (0) or two (1) contacts, one by one.
    pub(super) fn each(&self, of: usize) -> impl Iterator<Item = (&Stimulus, &[f32])> {
        self.stimuli[of].iter().zip(self.signals[of].chunks_exact(self.channels))
    }

    /// What pressed, one (0) or two (1) contacts, and the true maps \[m\], one by one.
    pub(super) fn true_maps(&self, of: usize) -> impl Iterator<Item = (&Stimulus, &[f32])> {
        let points = self.maps[of].len() / self.stimuli[of].len().max(1);
        self.stimuli[of].iter().zip(self.maps[of].chunks_exact(points.max(1)))
    }

    /// Errors of maps that a function makes of all signals.
    fn evaluate(&self, of: usize, maps: impl Fn(&[f32]) -> Result<Vec<f32>>) -> Result<MapSummary> {
        let mut scores = MapScores::new();
        let points = self.maps[of].len() / self.stimuli[of].len().max(1);
        // In parts, so that the maps of all frames are not in memory twice.
        for (signals, truth) in
            self.signals[of].chunks(256 * self.channels).zip(self.maps[of].chunks(256 * points.max(1)))
        {
            let answer = maps(signals)?;
            let both = truth.chunks_exact(points).zip(answer.chunks_exact(points));
            both.for_each(|(truth, answer)| scores.push(truth, answer));
        }
        Ok(scores.summary())
    }
}

/// Errors of whole maps.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapRow {
    /// Virtual sensors near each element.
    pub each: usize,
    /// Virtual sensors in all.
    pub sensors: usize,
    /// `linear`, `neighbours` or `network`: the transfer.
    pub transfer: &'static str,
    /// One contact.
    pub single: MapSummary,
    /// Two contacts.
    pub double: MapSummary,
}

/// Rows of these numbers of virtual sensors; `most` are trained at once.
pub(super) fn rows_of(
    known: &Known,
    numbers: &[usize],
    frames: &Frames,
    most: usize,
    progress: ProgressFn<'_>,
) -> Result<Vec<MapRow>> {
    let waiting = Mutex::new(numbers.iter().copied().collect::<VecDeque<usize>>());
    let found = Mutex::new(Vec::new());
    let work = || {
        loop {
            let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
            let Some(each) = next else { return };
            let rows = rows(known, each, frames, progress);
            found.lock().unwrap_or_else(PoisonError::into_inner).push(rows);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..most.min(numbers.len()) {
            scope.spawn(work);
        }
    });
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok(found.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// Rows of one number of virtual sensors.
pub(super) fn rows(
    known: &Known,
    each: usize,
    frames: &Frames,
    progress: ProgressFn<'_>,
) -> Result<Vec<MapRow>> {
    let virtual_sensors = sensors(&known.model, &known.skin, each)?;
    let settings = known.settings_with(each);
    let stages = Stages {
        model: &known.model,
        sensors: &virtual_sensors,
        scenes: &known.scenes,
        settings: &settings,
        states: Some(&known.states),
        progress,
    };
    let basis = stages.basis()?;
    let channels = known.model.channels();
    let transfers: [(&'static str, Box<dyn MapRegressor>); 3] = {
        let paired = stages.paired(&stages.presses(&known.recorded, 1), &basis)?;
        let held = stages.paired(&stages.presses(&known.choose, 1), &basis)?;
        let (signals, seen) = (&paired.signals, &paired.simulated.sensors);
        let validation = (held.signals.as_slice(), held.simulated.sensors.as_slice());
        [
            ("linear", Box::new(LinearMap::fit(signals, seen, channels, validation)?)),
            ("neighbours", Box::new(NearestMaps::fit(signals, seen, channels, NEIGHBOURS)?)),
            ("network", Box::new(stages.transfer(&paired, &held)?)),
        ]
    };
    let reconstruction = stages.reconstruction(&stages.simulated(&basis)?)?;
    progress("maps of recorded contacts", 0.0);
    let row = |(name, transfer): (&'static str, Box<dyn MapRegressor>)| {
        let maps = |signals: &[f32]| {
            let amplitudes = reconstruction.predict(&transfer.predict(signals)?)?;
            Ok(basis.decode(&amplitudes))
        };
        Ok(MapRow {
            each,
            sensors: virtual_sensors.count(),
            transfer: name,
            single: frames.evaluate(0, maps)?,
            double: frames.evaluate(1, maps)?,
        })
    };
    transfers.into_iter().map(row).collect()
}
