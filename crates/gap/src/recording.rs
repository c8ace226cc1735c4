//! What was done to a skin, and what it read: the input of every diagnosis.

use std::collections::BTreeMap;

use dermis_model::{Indentation, Stimulus, TipShape};
use dermis_skin::Phase;
use sha2::{Digest, Sha256};

use crate::constants::noise::SAME_PLACE;
use crate::constants::reading::{ZERO_AT_START, ZERO_BEFORE_PRESS};

/// What is known of one frame of a recording besides its readings.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameLabel {
    /// \[s\] since its run began.
    pub time: f64,
    /// Which run: the device is switched on anew at the beginning of each.
    pub run: u32,
    /// Counts presses within the run; frames between two presses belong to the one before them.
    pub press: u64,
    /// Identity of the place.
    pub location: u32,
    /// What the rig was doing.
    pub phase: Phase,
    /// What touches; `None` where nobody knows.
    pub stimulus: Option<Stimulus>,
    /// \[K\] of the skin, NaN where unknown.
    pub temperature: f64,
}

impl FrameLabel {
    /// \[N\] total of what presses; 0 where nothing touches or nobody knows.
    #[must_use]
    pub fn force(&self) -> f64 {
        self.stimulus.as_ref().map_or(0.0, |s| s.contacts.iter().map(|c| c.force.norm()).sum())
    }
}

/// What readings are counted from.
///
/// A model may read something where nothing touches. Readings as they were recorded are compared with what it reads; tared ones with
/// its signals, from which its own readings in the same untouched frames are subtracted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Zero {
    /// As they were recorded: the zero of the device is part of the gap.
    #[default]
    AsRead,
    /// From what was read untouched at the beginning of each run, as a node does that is tared once.
    Start,
    /// From what was read just before each press: drift between presses is no part of the gap.
    Press,
}

/// What the zero of a frame was measured from: a mean that has noise of its own, the same in every frame that counts from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZeroMean {
    /// Counts the zeros of a recording: frames with the same number count from the same mean.
    pub index: u32,
    /// Untouched frames that it is the mean of; 0 where there were none, and nothing was subtracted.
    pub frames: u32,
    /// \[s\] since its run began, of the middle one of these frames.
    pub time: f64,
    /// \[K\] of the skin in it, NaN where unknown.
    pub temperature: f64,
    /// Presses of the run that had begun before.
    pub presses: u32,
}

impl ZeroMean {
    /// Variance of the mean, in variances of a frame's noise; noise of different frames is taken to be independent.
    #[must_use]
    pub fn variance(self) -> f64 {
        if self.frames == 0 { 0.0 } else { 1.0 / f64::from(self.frames) }
    }
}

/// The zeros of a recording.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Zeros {
    /// Which zero each frame counts from.
    of_frame: Vec<u32>,
    means: Vec<ZeroMean>,
    /// Untouched frames that each is the mean of.
    frames: Vec<Vec<usize>>,
}

impl Zeros {
    /// What a frame counts from; `None` where readings are as they were recorded.
    #[must_use]
    pub fn of(&self, frame: usize) -> Option<ZeroMean> {
        let index = *self.of_frame.get(frame)?;
        self.means.get(index as usize).copied()
    }

    /// Untouched frames that a zero is the mean of.
    #[must_use]
    pub fn frames(&self, zero: u32) -> &[usize] {
        self.frames.get(zero as usize).map_or(&[], Vec::as_slice)
    }
}

/// Something about a recording that a person should know.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Problem {
    /// Stable name, e.g. `clock`, `units`, `frame`, `channel-order`, `not-finite`, `few-contacts`.
    pub code: String,
    /// One sentence: what is wrong, where, and what to do.
    pub what: String,
    /// Whether nothing can be said of causes while it stands.
    pub fatal: bool,
}

impl Problem {
    pub(crate) fn fatal(code: &str, what: impl Into<String>) -> Self {
        Self { code: code.to_owned(), what: what.into(), fatal: true }
    }

    pub(crate) fn note(code: &str, what: impl Into<String>) -> Self {
        Self { code: code.to_owned(), what: what.into(), fatal: false }
    }
}

/// What was done to a skin and what it read, in the order of acquisition.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// For people.
    pub name: String,
    /// Channels of every frame.
    pub channels: usize,
    /// What was done.
    pub labels: Vec<FrameLabel>,
    /// What was read, `channels` numbers a frame, in the unit of the skin; NaN where a channel gave none.
    pub readings: Vec<f32>,
    /// Names of sessions: readings of one share mounting, zero and temperature history.
    pub sessions: Vec<String>,
    /// Which session each frame belongs to; empty where runs and sessions are the same.
    pub session: Vec<u32>,
    /// What was noticed on reading it.
    pub problems: Vec<Problem>,
    /// What its readings are counted from; [`tare`](Self::tare) sets it.
    pub zero: Zero,
    /// What readings count from; empty where they are as they were recorded.
    pub zeros: Zeros,
}

impl Recording {
    /// An empty recording of a skin with so many channels.
    #[must_use]
    pub fn new(name: impl Into<String>, channels: usize) -> Self {
        Self { name: name.into(), channels, ..Self::default() }
    }

    /// Adds a frame. Missing readings are NaN, superfluous ones are dropped.
    pub fn push(&mut self, label: FrameLabel, readings: &[f32]) {
        self.labels.push(label);
        let whole = readings.iter().copied().chain(std::iter::repeat(f32::NAN));
        self.readings.extend(whole.take(self.channels));
    }

    /// Place in [`sessions`](Self::sessions) of a frame's session.
    #[must_use]
    pub fn session_of(&self, frame: usize) -> u32 {
        self.session.get(frame).or(self.labels.get(frame).map(|m| &m.run)).copied().unwrap_or(0)
    }

    /// For each frame the first run and place of that run at which the same was pressed: a place keeps its identity over the runs of
    /// a recording, so that what was learned of it in one run is not held out in another.
    ///
    /// Within a run the rig says which presses share a place. Those of different runs do where all of their contacts lie within
    /// the distance of a press that is done again: several bags count their locations anew.
    #[must_use]
    pub(crate) fn locations(&self) -> Vec<(u32, u32)> {
        let own = |m: &FrameLabel| {
            // A press without a place is a place of its own.
            let location = if m.location == 0 { u32::MAX - m.press as u32 } else { m.location };
            (m.run, location)
        };
        let mut first: BTreeMap<(u32, u32), (u32, u32)> = BTreeMap::new();
        if self.labels.first().map(|m| m.run) != self.labels.last().map(|m| m.run) {
            let mut known: Vec<(&[Indentation], (u32, u32))> = Vec::new();
            for m in &self.labels {
                let contacts = m.stimulus.as_ref().map_or(&[][..], |s| &s.contacts);
                if contacts.is_empty() || first.contains_key(&own(m)) {
                    continue;
                }
                let alike = |with: &[Indentation]| {
                    with.len() == contacts.len()
                        && with
                            .iter()
                            .zip(contacts)
                            .all(|(a, b)| (a.position - b.position).amax() < SAME_PLACE)
                };
                let before = known.iter().find(|(with, (run, _))| *run != m.run && alike(with));
                let place = before.map_or(own(m), |(_, place)| *place);
                if before.is_none() {
                    known.push((contacts, place));
                }
                first.insert(own(m), place);
            }
        }
        self.labels.iter().map(|m| first.get(&own(m)).copied().unwrap_or(own(m))).collect()
    }

    /// Readings of one frame.
    #[must_use]
    pub fn frame(&self, index: usize) -> &[f32] {
        &self.readings[index * self.channels..(index + 1) * self.channels]
    }

    /// \[Hz\] frames a second: of the middle one of all times between frames of a run. `None` where no frame follows another.
    #[must_use]
    pub fn rate(&self) -> Option<f64> {
        let follow = self.labels.windows(2).filter(|pair| pair[0].run == pair[1].run);
        let mut steps: Vec<f64> =
            follow.map(|pair| pair[1].time - pair[0].time).filter(|s| *s > 0.0).collect();
        let middle = steps.len() / 2;
        (!steps.is_empty()).then(|| 1.0 / *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// Number of presses in which something touched.
    #[must_use]
    pub fn contacts(&self) -> usize {
        let mut found: Vec<(u32, u64)> =
            self.labels.iter().filter(|m| m.phase.touched()).map(|m| (m.run, m.press)).collect();
        found.sort_unstable();
        found.dedup();
        found.len()
    }

    /// Identity of what was done, whatever was read: signatures belong to it, once it is known what readings count from.
    #[must_use]
    pub fn stimulus_hash(&self) -> String {
        let mut hasher = Sha256::new();
        for m in &self.labels {
            hasher.update(m.time.to_le_bytes());
            hasher.update(m.run.to_le_bytes());
            hasher.update(m.press.to_le_bytes());
            hasher.update(m.location.to_le_bytes());
            hasher.update([m.phase as u8, u8::from(m.stimulus.is_some())]);
            if let Some(stimulus) = &m.stimulus {
                hash_stimulus(stimulus, &mut hasher);
            }
        }
        hex(&hasher.finalize())
    }

    /// Identity of everything: what was done and what was read.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        hasher.update(self.stimulus_hash());
        let mut bytes = Vec::with_capacity(4 * 4096);
        for values in self.readings.chunks(4096) {
            bytes.clear();
            values.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
            hasher.update(&bytes);
        }
        hex(&hasher.finalize())
    }

    /// Takes from each reading what its channel read while nothing touched.
    pub fn tare(&mut self, zero: Zero) {
        if zero != Zero::AsRead {
            self.zero = zero;
            self.zeros = Zeros::default();
        }
        let n = self.channels;
        let mut begin = 0;
        while begin < self.labels.len() {
            let run = self.labels[begin].run;
            let end = begin + self.labels[begin..].iter().take_while(|m| m.run == run).count();
            let free = |i: usize| self.labels[i].phase == Phase::Idle;
            // Each block of frames, and the untouched ones that its zero comes from.
            let mut blocks: Vec<(usize, Vec<usize>)> = Vec::new();
            match zero {
                Zero::AsRead => return,
                Zero::Start => {
                    let first = (begin..end).find(|i| free(*i)).map_or(f64::NAN, |i| self.labels[i].time);
                    let early =
                        (begin..end).filter(|i| free(*i) && self.labels[*i].time - first <= ZERO_AT_START);
                    blocks.push((begin, early.collect()));
                }
                Zero::Press => {
                    for i in begin + 1..end {
                        if !free(i) && free(i - 1) {
                            let since = self.labels[i].time - ZERO_BEFORE_PRESS;
                            let rest = (begin..i).rev().take_while(|j| free(*j));
                            let rest = rest.take_while(|j| self.labels[*j].time >= since).collect();
                            // What comes before the first press has no zero but its.
                            blocks.push((if blocks.is_empty() { begin } else { i }, rest));
                        }
                    }
                }
            }
            // All zeros first: those of a press are within what the zero of the press before it changes.
            let levels: Vec<Vec<f32>> = blocks.iter().map(|(_, frames)| self.levels(frames)).collect();
            for (at, ((from, frames), level)) in blocks.iter().zip(&levels).enumerate() {
                let to = blocks.get(at + 1).map_or(end, |b| b.0);
                self.count_from(to, frames.clone(), at as u32);
                for row in self.readings[from * n..to * n].chunks_exact_mut(n.max(1)) {
                    row.iter_mut().zip(level).for_each(|(r, l)| *r -= l);
                }
            }
            // A run without a press has no zero of its own.
            if self.zeros.of_frame.len() < end {
                self.count_from(end, Vec::new(), 0);
            }
            begin = end;
        }
    }

    /// Says that the frames before `to` that have no zero count from the mean of these, before which so many presses of the run began.
    fn count_from(&mut self, to: usize, frames: Vec<usize>, presses: u32) {
        let index = self.zeros.means.len() as u32;
        let middle = frames.get(frames.len() / 2).map(|i| &self.labels[*i]);
        self.zeros.of_frame.resize(to, index);
        self.zeros.means.push(ZeroMean {
            index,
            frames: frames.len() as u32,
            time: middle.map_or(f64::NAN, |m| m.time),
            temperature: middle.map_or(f64::NAN, |m| m.temperature),
            presses,
        });
        self.zeros.frames.push(frames);
    }

    /// Mean of each channel over some frames; 0 where none has a number.
    fn levels(&self, frames: &[usize]) -> Vec<f32> {
        let of = |k: usize| {
            let values = frames.iter().map(|i| f64::from(self.readings[i * self.channels + k]));
            let (sum, count) =
                values.filter(|v| v.is_finite()).fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
            (sum / f64::max(count, 1.0)) as f32
        };
        (0..self.channels).map(of).collect()
    }

    /// Says where the clock runs backwards: at such a place nobody knows which readings belong to which stimulus.
    pub(crate) fn clock(&self) -> Option<Problem> {
        let (mut back, mut stood, mut first) = (0usize, 0usize, None);
        for (i, pair) in self.labels.windows(2).enumerate() {
            if pair[0].run != pair[1].run {
                continue;
            }
            let step = pair[1].time - pair[0].time;
            if step < 0.0 {
                back += 1;
                first.get_or_insert((i + 1, -step));
            } else if step == 0.0 {
                stood += 1;
            }
        }
        if let Some((frame, by)) = first {
            return Some(Problem::fatal(
                "clock",
                format!(
                    "{}: the clock runs backwards {back} times, first at frame {frame} by {by:.3} s: which reading belongs to \
                     which press is open; record with a monotonic clock",
                    self.name
                ),
            ));
        }
        (stood * 100 > self.labels.len()).then(|| {
            Problem::note(
                "clock",
                format!("{}: {stood} frames have the stamp of the frame before them", self.name),
            )
        })
    }
}

/// All that a forward model may ask of a stimulus.
fn hash_stimulus(stimulus: &Stimulus, hasher: &mut Sha256) {
    let surroundings = [stimulus.temperature, stimulus.ambient_pressure];
    for v in surroundings.iter().chain(stimulus.gravity.iter()) {
        hasher.update(v.to_le_bytes());
    }
    hasher.update((stimulus.contacts.len() as u64).to_le_bytes());
    for contact in &stimulus.contacts {
        let shape = contact.tip.shape;
        let sizes = match shape {
            TipShape::Sphere { diameter } | TipShape::FlatPunch { diameter } => [diameter, 0.0],
            TipShape::Cylinder { diameter, length } => [diameter, length],
            TipShape::Wedge { angle, length } => [angle, length],
            TipShape::Polygon { sides, diameter } => [f64::from(sides), diameter],
            TipShape::Box { size } => size,
        };
        hasher.update(shape.name());
        for v in contact.position.iter().chain(contact.force.iter()).chain(&sizes) {
            hasher.update(v.to_le_bytes());
        }
        // A sphere is the same whichever way it is turned.
        if contact.tip.as_sphere().is_none() {
            contact.tip.orientation.coords.iter().for_each(|v| hasher.update(v.to_le_bytes()));
        }
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    let digits: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{digits}")
}

#[cfg(test)]
mod tests;
