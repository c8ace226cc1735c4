//! The contacts of all skins that are rigidly connected.
//!
//! Problem: reports of several skins come at different rates, late and out of order; which of their contacts are the same, and the same
//! as before? Method, for each report in the order of acquisition:
//!
//! 1. Contacts of the report are gated with the tracks by their Mahalanobis distance, and assigned to them by the least sum of costs
//!    (global nearest neighbour; Blackman and Popoli, *Design and Analysis of Modern Tracking Systems*, 1999, §6.4). No two contacts of a
//!    report get the same track, so that two touches that one skin tells apart stay two.
//! 2. A contact that no track can be begins one. It is published once [`births`](Settings::births) reports contain it.
//! 3. A skin that does not feel a contact any more leaves its track after [`hold`](Settings::hold); a track without skins ends.
//! 4. Two tracks that no skin feels both, and that are in one place by their covariances, become one.
//!
//! Reports that can still be overtaken (another skin's newest report is older, by at most [`reorder`](Settings::reorder)) are kept, and
//! what they make of the tracks is computed again where one comes in between. So the answer is the same for every order of arrival.
//!
//! Cost: each report is worked in twice, and once more for each report that it overtakes. A pair of contact and track that are far from
//! each other costs a distance, so that the cost grows with the product of both from some hundred on; assignments are solved for each
//! set of contacts that compete with one another.

use std::cell::LazyCell;
use std::collections::{HashMap, VecDeque};

use dermis_skin::{Stamp, assign};
use nalgebra::Vector3;

use crate::settings::Settings;
use crate::track::{Detection, Track, seconds};

/// \[1\] what is added to the squared distance where the skin itself takes the contact for another one: 20 times less likely.
const SWITCH: f64 = 6.0;
/// \[1\] the same where the report has the contact that the skin takes for the track, too: then the skin tells the two apart.
const CONTRADICTION: f64 = 20.0;
/// \[1\] squared distance within which two tracks are one contact: 95 % of χ² with three degrees of freedom.
const MERGE_GATE: f64 = 7.81;
/// Periods of a skin for which a contact that it does not feel stays, at least.
const HOLD_PERIODS: f64 = 2.5;
/// \[s\] longest period of a skin that is believed.
const LONGEST_PERIOD: f64 = 0.4;
/// \[ns\] after which nobody waits for a skin.
const SILENT: i64 = 1_000_000_000;
/// Contacts on one group: what sends more is broken.
const MOST_TRACKS: usize = 4096;
/// Reports that wait for those that they may have overtaken.
const MOST_WAITING: usize = 4096;

/// One frame of one skin.
#[derive(Debug, Clone)]
pub(crate) struct Report {
    pub skin: usize,
    /// When it was acquired.
    pub stamp: Stamp,
    pub detections: Vec<Detection>,
}

/// A skin that reports.
#[derive(Debug, Clone, Copy)]
struct Reporter {
    skin: usize,
    last: Stamp,
    /// \[s\] between its reports, smoothed; 0 before the second.
    period: f64,
}

/// The tracks at an instant.
#[derive(Debug, Clone, Default)]
struct Tracks {
    tracks: Vec<Track>,
    reporters: Vec<Reporter>,
    at: Stamp,
}

impl Tracks {
    /// \[s\] for which a contact that this skin does not feel stays.
    fn hold(&self, skin: usize, s: &Settings) -> f64 {
        let period = self.reporters.iter().find(|r| r.skin == skin).map_or(0.0, |r| r.period);
        s.hold.max(HOLD_PERIODS * period)
    }

    fn note(&mut self, skin: usize, stamp: Stamp) {
        match self.reporters.iter_mut().find(|r| r.skin == skin) {
            Some(known) => {
                let period = seconds(known.last, stamp).clamp(0.0, LONGEST_PERIOD);
                known.period =
                    if known.period == 0.0 { period } else { known.period + 0.1 * (period - known.period) };
                known.last = stamp;
            }
            None => self.reporters.push(Reporter { skin, last: stamp, period: 0.0 }),
        }
    }

    /// Works in one report, which is not older than the last one.
    fn work(&mut self, report: &Report, s: &Settings) {
        let at = report.stamp;
        self.at = at;
        self.note(report.skin, at);
        let chosen = self.associate(report, s);
        let mut begun = Vec::new();
        for (detection, track) in report.detections.iter().zip(chosen) {
            match track {
                Some(t) => {
                    let track = &mut self.tracks[t];
                    track.predict(at, s);
                    let gate = track.gate(report.skin, s);
                    // An identity that the skin gave to another contact before moves with it.
                    if detection.place.is_some()
                        && track.place.is_some()
                        && track.distance(detection).is_none_or(|(d, _)| d > gate)
                    {
                        track.stray(detection, report.skin, at, s);
                    } else {
                        track.take(detection, report.skin, at, s);
                    }
                }
                None if self.tracks.len() + begun.len() < MOST_TRACKS => {
                    begun.push(Track::begin(detection, report.skin, at, s));
                }
                None => {}
            }
        }
        // Where the skin takes a new place for a contact that it detected elsewhere, the contact is not there any more.
        for track in &mut self.tracks {
            let moved = |k: u32| begun.iter().any(|b| b.is_detected_as(report.skin, k));
            track
                .sources
                .retain(|source| source.skin != report.skin || source.seen == at || !moved(source.track));
        }
        self.tracks.append(&mut begun);
        let hold = self.hold(report.skin, s);
        self.retain(|skin, seen| skin != report.skin || seconds(seen, at) <= hold);
        self.merge(report, s);
    }

    /// Keeps what skins feel where `stays(skin, last seen)`, and tracks that some skin feels.
    fn retain(&mut self, stays: impl Fn(usize, Stamp) -> bool) {
        for track in &mut self.tracks {
            track.sources.retain(|s| stays(s.skin, s.seen));
        }
        self.tracks.retain(|t| !t.sources.is_empty());
    }

    /// The track of each detection, none twice; `None` where it is a new contact.
    fn associate(&mut self, report: &Report, s: &Settings) -> Vec<Option<usize>> {
        let detections = &report.detections;
        let mut named: HashMap<u32, usize> = HashMap::new();
        for (t, track) in self.tracks.iter().enumerate() {
            for source in track.sources.iter().filter(|s| s.skin == report.skin) {
                named.entry(source.track).or_insert(t);
            }
        }
        let owner = |d: &Detection| named.get(&d.track).copied().filter(|_| d.track != 0);
        let owners: Vec<Option<usize>> = detections.iter().map(owner).collect();
        let extent = detections.iter().map(Detection::extent).fold(0.0, f64::max);
        let locations: Vec<Option<Vector3<f64>>> =
            detections.iter().map(|d| d.place.map(|p| p.value)).collect();
        let mut pairs: Vec<(usize, usize, f64)> = Vec::new();
        for (t, track) in self.tracks.iter_mut().enumerate() {
            let reach = track.reach(extent, report.stamp, s).powi(2);
            let at: Option<Vector3<f64>> =
                track.place.as_ref().map(|p| p.mean.fixed_rows::<3>(0).into_owned());
            for (d, (detection, place)) in detections.iter().zip(&locations).enumerate() {
                // Most pairs end here.
                if let (Some(at), Some(place)) = (at, place)
                    && (at - place).norm_squared() > reach
                {
                    continue;
                }
                if let Some(cost) = pair(track, detection, report, s) {
                    // It is another track's by what the skin says.
                    let elsewhere = if owners[d].is_some_and(|owner| owner != t) { SWITCH } else { 0.0 };
                    pairs.push((d, t, cost + elsewhere));
                }
            }
        }
        // Most contacts compete with none.
        let costs =
            LazyCell::new(|| pairs.iter().map(|(d, t, cost)| ((*d, *t), *cost)).collect::<HashMap<_, _>>());
        let mut chosen = vec![None; detections.len()];
        for (rows, columns) in competitors(&pairs, detections.len(), self.tracks.len()) {
            if let ([d], [t]) = (rows.as_slice(), columns.as_slice()) {
                chosen[*d] = Some(*t);
                continue;
            }
            // Each detection may begin a track instead.
            let none = s.gate + CONTRADICTION + 2.0 * SWITCH;
            let cost = |r: usize, c: usize| match columns.get(c) {
                Some(t) => costs.get(&(rows[r], *t)).copied().unwrap_or(f64::INFINITY),
                None if c - columns.len() == r => none,
                None => f64::INFINITY,
            };
            for (r, c) in assign(rows.len(), columns.len() + rows.len(), cost).into_iter().enumerate() {
                chosen[rows[r]] = c.and_then(|c| columns.get(c)).copied();
            }
        }
        self.adopt_strays(report, &mut chosen);
        chosen
    }

    /// A detection that is nowhere near a track, but that its skin takes for it, may be an outlier of that track.
    fn adopt_strays(&self, report: &Report, chosen: &mut [Option<usize>]) {
        for d in 0..chosen.len() {
            if chosen[d].is_none() {
                let identity = report.detections[d].track;
                let own = self.tracks.iter().position(|t| t.bears_stray(report.skin, identity));
                chosen[d] = own.filter(|t| !chosen.contains(&Some(*t)));
            }
        }
    }

    /// Makes one of two tracks that look like one contact; only those that the report touched can have begun to.
    fn merge(&mut self, report: &Report, s: &Settings) {
        // A skin tells its own contacts apart: only one of others can be the same.
        if self.tracks.iter().all(|t| t.is_detected_by(report.skin)) {
            return;
        }
        let mut i = 0;
        while i < self.tracks.len() {
            let settled = |t: &Track| t.hits >= s.births;
            if !(settled(&self.tracks[i])
                && self.tracks[i].is_detected_by(report.skin)
                && self.tracks[i].seen == self.at)
            {
                i += 1;
                continue;
            }
            let other = (0..self.tracks.len()).find(|j| {
                *j != i
                    && settled(&self.tracks[*j])
                    && self.tracks[i].looks_like(&self.tracks[*j], MERGE_GATE)
            });
            let Some(j) = other else {
                i += 1;
                continue;
            };
            // What is published already keeps its identity, the older one of two.
            let rank = |t: &Track| (t.id == 0, t.id, t.born);
            let (keep, gone) = if rank(&self.tracks[j]) < rank(&self.tracks[i]) { (j, i) } else { (i, j) };
            let mut taken = self.tracks[gone].clone();
            taken.predict(self.at, s);
            let track = &mut self.tracks[keep];
            track.predict(self.at, s);
            track.absorb(&taken);
            self.tracks.remove(gone);
            i = 0;
        }
    }
}

/// Cost of taking a detection for a track; `None` where it cannot be.
fn pair(track: &mut Track, detection: &Detection, report: &Report, s: &Settings) -> Option<f64> {
    let same = track.is_detected_as(report.skin, detection.track);
    let (Some(_), Some(_)) = (&track.place, &detection.place) else {
        // Without a place there is nothing to tell it by but what the skin says.
        return same.then_some(0.0);
    };
    track.predict(report.stamp, s);
    let (distance, spread) = track.distance(detection)?;
    let named = track.sources.iter().find(|source| source.skin == report.skin).map(|source| source.track);
    let penalty = match named {
        Some(name) if !same && report.detections.iter().any(|d| d.track == name) => CONTRADICTION,
        Some(_) if !same => SWITCH,
        _ => 0.0,
    };
    // What was reported once may be noise.
    let doubt = if track.hits < s.births { SWITCH } else { 0.0 };
    (distance <= track.gate(report.skin, s)).then_some(distance + spread + penalty + doubt)
}

/// Detections and tracks that have pairs with one another, each set for itself.
fn competitors(
    pairs: &[(usize, usize, f64)],
    detections: usize,
    tracks: usize,
) -> Vec<(Vec<usize>, Vec<usize>)> {
    let mut of_track: Vec<Vec<usize>> = vec![Vec::new(); tracks];
    let mut of_detection: Vec<Vec<usize>> = vec![Vec::new(); detections];
    for (d, t, _) in pairs {
        of_detection[*d].push(*t);
        of_track[*t].push(*d);
    }
    let mut sets = Vec::new();
    let (mut seen_d, mut seen_t) = (vec![false; detections], vec![false; tracks]);
    for first in 0..detections {
        if seen_d[first] || of_detection[first].is_empty() {
            continue;
        }
        seen_d[first] = true;
        let (mut rows, mut columns, mut next) = (vec![first], Vec::new(), 0);
        while let Some(d) = rows.get(next).copied() {
            next += 1;
            for t in &of_detection[d] {
                if std::mem::replace(&mut seen_t[*t], true) {
                    continue;
                }
                columns.push(*t);
                for d in &of_track[*t] {
                    if !std::mem::replace(&mut seen_d[*d], true) {
                        rows.push(*d);
                    }
                }
            }
        }
        sets.push((rows, columns));
    }
    sets
}

/// Identities on the body, by what skins call the contacts.
#[derive(Debug, Default)]
pub(crate) struct Identities {
    last: u32,
    known: HashMap<(usize, u32), (u32, Stamp)>,
}

impl Identities {
    /// The identity that a contact of these skins had a moment ago and that is not in use.
    fn before(&self, track: &Track, used: &[u32], s: &Settings) -> Option<u32> {
        let known = track.sources.iter().filter(|source| source.track != 0).filter_map(|source| {
            let (id, seen) = self.known.get(&(source.skin, source.track))?;
            (seconds(*seen, track.seen) <= 2.0 * s.hold.max(0.05)).then_some(*id)
        });
        known.filter(|id| !used.contains(id)).min()
    }

    /// An identity that no contact had.
    pub(crate) fn fresh(&mut self) -> u32 {
        self.last = self.last.checked_add(1).unwrap_or(1);
        self.last
    }

    /// Gives every track that is published an identity: its own, or that which its skins' contacts had a moment ago, or a new one.
    fn give(&mut self, tracks: &mut [Track], at: Stamp, s: &Settings) {
        let mut used: Vec<u32> = tracks.iter().map(|t| t.id).filter(|id| *id != 0).collect();
        for track in tracks.iter_mut().filter(|t| t.hits >= s.births) {
            if track.id == 0 {
                track.id = self.before(track, &used, s).unwrap_or_else(|| self.fresh());
                used.push(track.id);
            }
            for source in &track.sources {
                self.known.insert((source.skin, source.track), (track.id, source.seen));
            }
        }
        if self.known.len() > MOST_TRACKS {
            self.known.retain(|_, (_, seen)| seconds(*seen, at) < 1.0);
        }
    }

    /// Gives the tracks that published ones are made from what those were given.
    fn repeat(&self, tracks: &mut [Track], s: &Settings) {
        let mut used: Vec<u32> = tracks.iter().map(|t| t.id).filter(|id| *id != 0).collect();
        for track in tracks.iter_mut().filter(|t| t.id == 0) {
            track.id = self.before(track, &used, s).unwrap_or(0);
            used.push(track.id);
        }
    }

    /// What a skin called its contacts means nothing any more.
    pub(crate) fn forget(&mut self, skin: usize) {
        self.known.retain(|(s, _), _| *s != skin);
    }
}

/// What became of a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Taken {
    /// It counts.
    Used,
    /// It came after the tracks had gone on from its time.
    Late,
}

/// Skins that are rigidly connected, and the contacts on them.
#[derive(Debug, Default)]
pub(crate) struct Group {
    /// Tracks that nothing can change any more but newer reports.
    settled: Tracks,
    /// Tracks with everything that has come.
    current: Tracks,
    /// Reports between the two, in the order of acquisition.
    waiting: VecDeque<Report>,
    /// Whether `current` has to be made anew.
    dirty: bool,
    /// The latest stamp of each skin, whether its report counted or not.
    heard: Vec<(usize, Stamp)>,
}

impl Group {
    /// Works in a report.
    pub(crate) fn take(&mut self, report: Report, s: &Settings) -> Taken {
        match self.heard.iter_mut().find(|(skin, _)| *skin == report.skin) {
            Some((_, last)) => *last = report.stamp,
            None => self.heard.push((report.skin, report.stamp)),
        }
        // Of the tracks before the first report there is nothing to come too late for.
        if !self.settled.reporters.is_empty() && report.stamp < self.settled.at {
            return Taken::Late;
        }
        let place = self.waiting.partition_point(|r| r.stamp <= report.stamp);
        let newest = place == self.waiting.len();
        if newest && !self.dirty {
            self.current.work(&report, s);
        } else {
            self.dirty = true;
        }
        self.waiting.insert(place, report);
        self.settle(s);
        Taken::Used
    }

    /// Works in for good what no skin can overtake any more.
    fn settle(&mut self, s: &Settings) {
        let Some(newest) = self.waiting.back().map(|r| r.stamp) else { return };
        let horizon = newest.saturating_sub((s.reorder * 1e9) as i64);
        // Each skin sends its own reports in order, so that nothing older than every skin's newest can come.
        let silent = newest.saturating_sub(SILENT);
        let speaking = self.heard.iter().map(|(_, last)| *last).filter(|last| *last >= silent);
        let slowest = speaking.min().unwrap_or(newest).max(horizon);
        while let Some(first) = self.waiting.front() {
            if first.stamp > slowest && self.waiting.len() <= MOST_WAITING {
                break;
            }
            if let Some(report) = self.waiting.pop_front() {
                self.settled.work(&report, s);
            }
        }
    }

    /// Contacts with everything that has come, at `at` where that is later.
    pub(crate) fn tracks(&mut self, at: Stamp, identities: &mut Identities, s: &Settings) -> Vec<Track> {
        if std::mem::take(&mut self.dirty) {
            self.current = self.settled.clone();
            for report in &self.waiting {
                self.current.work(report, s);
            }
        }
        identities.give(&mut self.current.tracks, at, s);
        identities.repeat(&mut self.settled.tracks, s);
        let mut shown: Vec<Track> =
            self.current.tracks.iter().filter(|t| t.hits >= s.births).cloned().collect();
        for track in &mut shown {
            track.predict(at, s);
        }
        shown
    }

    /// Nothing is reported by this skin any more: it is gone, blind, or another one.
    pub(crate) fn lose(&mut self, skin: usize) {
        self.waiting.retain(|r| r.skin != skin);
        for tracks in [&mut self.settled, &mut self.current] {
            tracks.reporters.retain(|r| r.skin != skin);
            tracks.retain(|s, _| s != skin);
        }
        self.dirty = true;
    }
}

#[cfg(test)]
mod tests;
