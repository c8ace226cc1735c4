//! Which frames are compared, and which of them belong together.
//!
//! A press is sampled in every phase (some eight frames); where a recording has too many presses, every so many are, and of the others
//! one held frame each. Samples of one place are one group: groups are what is resampled, held out and permuted.

use dermis_skin::Phase;
use std::collections::BTreeMap;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::constants::sampling::{AFTER, GROUPS, READINGS, TEST};
use crate::recording::{Recording, ZeroMean};

/// One frame that is compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Index in [`Recording::labels`].
    pub frame: usize,
    /// Frames of one group are never parted: those of one place.
    pub group: usize,
    /// Counts presses over all runs; frames between presses belong to the one before.
    pub press: usize,
    /// Place.
    pub location: (u32, u32),
    /// Place of its session in [`Recording::sessions`].
    pub session: u32,
    /// What the rig was doing.
    pub phase: Phase,
    /// \[N\] total.
    pub force: f64,
    /// \[s\] since the contact began, while it lasts; since it ended, after it. NaN where nothing has touched yet.
    pub since: f64,
    /// \[s\] since the run began.
    pub time: f64,
    /// \[N\] largest force so far at this place.
    pub before: f64,
    /// \[N/s\] change of the force.
    pub speed: f64,
    /// \[K\], NaN where unknown.
    pub temperature: f64,
    /// \[m\] of the (first) contact; NaN where nothing touches.
    pub position: [f64; 3],
    /// \[m\] of its tip.
    pub diameter: f64,
    /// Contacts at once.
    pub contacts: usize,
    /// Whether the row after this one is the next frame of the same hold.
    pub paired: bool,
    /// What its zero was measured from; `None` where readings are as they were recorded.
    pub zero: Option<ZeroMean>,
}

impl Sample {
    /// Variance that its zero adds to a reading, in variances of a frame's noise.
    #[must_use]
    pub fn zero_variance(&self) -> f64 {
        self.zero.map_or(0.0, ZeroMean::variance)
    }
}

/// The frames that are compared.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// In the order of acquisition.
    pub list: Vec<Sample>,
    /// Number of groups.
    pub groups: usize,
    /// Which groups are kept for the end: neither fitted nor selected on.
    pub test: Vec<bool>,
    /// Presses that are sampled in every phase.
    pub presses: usize,
    /// Presses of which one held frame is, where there are too many.
    pub single_frame_samples: usize,
    /// Samples that were left out because a reading is missing.
    pub missing: usize,
}

/// How samples are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleOptions {
    /// Readings (samples × channels), at most, of presses that are sampled in every phase; where there are more presses
    /// than these hold, as many again of one held frame a press.
    pub readings: usize,
    /// Groups, at most.
    pub groups: usize,
    /// Share of groups that is kept for the end.
    pub test: f64,
    /// Which are drawn.
    pub seed: u64,
}

impl Default for SampleOptions {
    fn default() -> Self {
        Self { readings: READINGS, groups: GROUPS, test: TEST, seed: 1 }
    }
}

impl Samples {
    /// Draws samples evenly over presses and phases. `usable` says which channels count.
    #[must_use]
    pub fn draw(recording: &Recording, usable: &[bool], options: &SampleOptions) -> Self {
        let facts = facts(recording);
        let chosen = Chosen::of(recording, usable, &facts, options.readings);
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let groups = Groups::of(&chosen.frames, &recording.locations(), options, &mut rng);
        let list = chosen.frames.iter().zip(&groups.of_each);
        let mut list: Vec<Sample> =
            list.map(|(frame, group)| sample(recording, &facts, *frame, *group)).collect();
        // A pair may have lost its second row.
        for i in 0..list.len() {
            let next = list.get(i + 1).is_some_and(|n| {
                n.frame == list[i].frame + 1 && n.press == list[i].press && n.phase == list[i].phase
            });
            list[i].paired &= next;
        }
        Self {
            list,
            groups: groups.count,
            test: groups.held_out(options.test, &mut rng),
            presses: chosen.presses,
            single_frame_samples: chosen.single_frame_samples,
            missing: chosen.missing,
        }
    }

    /// Indices of the frames, in order.
    #[must_use]
    pub fn frames(&self) -> Vec<usize> {
        self.list.iter().map(|r| r.frame).collect()
    }

    /// One number a group: 1 for those that are fitted and selected on.
    #[must_use]
    pub fn training(&self) -> Vec<f64> {
        self.test.iter().map(|t| f64::from(u8::from(!t))).collect()
    }
}

/// A frame that was chosen.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Drawn {
    frame: usize,
    /// `usize::MAX` between presses.
    press: usize,
    /// Whether the next frame is its twin.
    paired: bool,
}

impl Drawn {
    fn is_idle(&self) -> bool {
        self.press == usize::MAX
    }
}

/// The frames that are compared, before they are grouped; what it counts is as in [`Samples`].
#[derive(Default)]
struct Chosen {
    /// In the order of acquisition.
    frames: Vec<Drawn>,
    presses: usize,
    single_frame_samples: usize,
    missing: usize,
}

impl Chosen {
    /// Frames evenly over presses and phases, whose usable channels all have a reading: `readings` of them at most in presses that are
    /// sampled in every phase.
    fn of(recording: &Recording, usable: &[bool], facts: &[Facts], readings: usize) -> Self {
        let (presses, idle) = by_press(recording, facts);
        let whole = |i: usize| recording.frame(i).iter().zip(usable).all(|(v, u)| v.is_finite() || !u);
        let budget = (readings / recording.channels.max(1)).max(64);
        // Some eight frames of a press say all of it; where there are too many presses, every so many are taken.
        let keep = presses.len().div_ceil((budget / 8).max(1)).max(1);
        let mut chosen = Self { presses: presses.iter().step_by(keep).count(), ..Self::default() };
        for (press, frames) in presses.iter().enumerate().step_by(keep) {
            for (frame, paired) in of_press(recording, frames, facts) {
                chosen.take(Drawn { frame, press, paired }, whole(frame));
            }
        }
        // Of the others one frame each, so that every channel is touched as often as can be.
        let others = presses.iter().enumerate().filter(|(press, _)| press % keep != 0);
        let every = (presses.len() - presses.len().div_ceil(keep)).div_ceil(budget).max(1);
        for (press, frames) in others.step_by(every) {
            let held: Vec<usize> =
                frames.iter().copied().filter(|i| recording.labels[*i].phase == Phase::Hold).collect();
            if let Some(&frame) = held.get(held.len() / 2).filter(|frame| whole(**frame)) {
                chosen.frames.push(Drawn { frame, press, paired: false });
                chosen.single_frame_samples += 1;
            }
        }
        let most = (chosen.frames.len() / 10).clamp(20, 400);
        for &frame in idle.iter().step_by(idle.len().div_ceil(most).max(1)) {
            chosen.take(Drawn { frame, press: usize::MAX, paired: false }, whole(frame));
        }
        chosen.frames.sort_unstable();
        chosen.frames.dedup_by_key(|drawn| drawn.frame);
        chosen
    }

    /// Chooses a frame, or counts it where a reading is missing.
    fn take(&mut self, drawn: Drawn, whole: bool) {
        if whole {
            self.frames.push(drawn);
        } else {
            self.missing += 1;
        }
    }
}

/// Frames by press, in the order of acquisition, and those between presses. What touches is known of all.
fn by_press(recording: &Recording, facts: &[Facts]) -> (Vec<Vec<usize>>, Vec<usize>) {
    let mut presses: Vec<Vec<usize>> = Vec::new();
    let mut idle = Vec::new();
    let mut last = None;
    for (i, label) in recording.labels.iter().enumerate() {
        if label.stimulus.is_none() {
            continue;
        }
        if label.phase == Phase::Idle || facts[i].since.is_nan() {
            idle.push(i);
            continue;
        }
        if last != Some((label.run, label.press)) {
            presses.push(Vec::new());
            last = Some((label.run, label.press));
        }
        if let Some(press) = presses.last_mut() {
            press.push(i);
        }
    }
    presses.retain(|p| p.iter().any(|&i| recording.labels[i].phase.touched()));
    (presses, idle)
}

/// Which group each chosen frame is of: first come the groups of locations, then those of idle stretches.
struct Groups {
    of_each: Vec<usize>,
    /// Groups of locations.
    touched: usize,
    count: usize,
}

impl Groups {
    fn of(chosen: &[Drawn], place_of: &[(u32, u32)], options: &SampleOptions, rng: &mut ChaCha8Rng) -> Self {
        let mut locations: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        for drawn in chosen.iter().filter(|drawn| !drawn.is_idle()) {
            let next = locations.len();
            locations.entry(place_of[drawn.frame]).or_insert(next);
        }
        let most = options.groups.max(8) * 9 / 10;
        let touched = locations.len().min(most);
        let mut order: Vec<usize> = (0..locations.len()).collect();
        order.shuffle(rng);
        let stretches = (options.groups - most).clamp(1, 12);
        let idle_samples = chosen.iter().filter(|drawn| drawn.is_idle()).count();
        let mut idle_seen = 0;
        let of_each = chosen.iter().map(|drawn| {
            if drawn.is_idle() {
                let stretch = idle_seen * stretches / idle_samples.max(1);
                idle_seen += 1;
                touched + stretch
            } else {
                order[locations[&place_of[drawn.frame]]] % touched.max(1)
            }
        });
        let of_each = of_each.collect();
        Self { of_each, touched, count: touched + if idle_samples > 0 { stretches } else { 0 } }
    }

    /// Which groups are kept for the end: this share of those of locations.
    fn held_out(&self, share: f64, rng: &mut ChaCha8Rng) -> Vec<bool> {
        let mut numbers: Vec<usize> = (0..self.touched).collect();
        numbers.shuffle(rng);
        let mut test = vec![false; self.count];
        for group in numbers.iter().take((self.touched as f64 * share).round() as usize) {
            test[*group] = true;
        }
        test
    }
}

/// A chosen frame with what was done in it.
fn sample(recording: &Recording, facts: &[Facts], drawn: Drawn, group: usize) -> Sample {
    let Drawn { frame, press, paired } = drawn;
    let label = &recording.labels[frame];
    let Facts { since, before, speed } = facts[frame];
    let first = label.stimulus.as_ref().and_then(|s| s.contacts.first());
    Sample {
        frame,
        group,
        press,
        location: (label.run, label.location),
        session: recording.session_of(frame),
        phase: label.phase,
        force: label.force(),
        since,
        time: label.time,
        before,
        speed,
        temperature: label.temperature,
        position: first.map_or([f64::NAN; 3], |c| c.position.coords.into()),
        diameter: first.map_or(f64::NAN, dermis_model::Indentation::diameter),
        contacts: label.stimulus.as_ref().map_or(0, |s| s.contacts.len()),
        paired,
        zero: recording.zeros.of(frame),
    }
}

/// A press without a place is a place of its own.
fn place(location: u32, press: u64) -> u32 {
    if location == 0 { u32::MAX - press as u32 } else { location }
}

/// What of a frame follows from those before it.
#[derive(Debug, Clone, Copy)]
struct Facts {
    since: f64,
    before: f64,
    speed: f64,
}

fn facts(recording: &Recording) -> Vec<Facts> {
    let mut found = Vec::with_capacity(recording.labels.len());
    let mut largest: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    let (mut began, mut run, mut was): (f64, Option<u32>, bool) = (f64::NAN, None, false);
    for (i, m) in recording.labels.iter().enumerate() {
        if run != Some(m.run) {
            (began, run, was) = (f64::NAN, Some(m.run), false);
        }
        let now = m.phase.touched();
        if now != was {
            began = m.time;
        }
        was = now;
        let force = m.force();
        let before = largest.entry((m.run, place(m.location, m.press))).or_insert(0.0);
        let neighbour = |j: usize| recording.labels.get(j).filter(|n| n.run == m.run);
        let ago = i.checked_sub(1).and_then(neighbour);
        let next = neighbour(i + 1);
        let speed = match (ago, next) {
            (Some(a), Some(b)) if b.time > a.time => (b.force() - a.force()) / (b.time - a.time),
            _ => 0.0,
        };
        let since = m.time - began;
        found.push(Facts {
            since: if !now && since > AFTER { f64::NAN } else { since },
            before: *before,
            speed,
        });
        if now {
            *before = before.max(force);
        }
    }
    found
}

/// The frames of a press that say all of it, and whether the next one is its twin.
fn of_press(recording: &Recording, press: &[usize], facts: &[Facts]) -> Vec<(usize, bool)> {
    let phase = |i: &usize| recording.labels[*i].phase;
    let of = |wanted: Phase| -> Vec<usize> {
        press.iter().copied().filter(|i| phase(i) == wanted && !facts[*i].since.is_nan()).collect()
    };
    let mut chosen: Vec<(usize, bool)> = Vec::new();
    let spread = |frames: &[usize], count: usize, chosen: &mut Vec<(usize, bool)>| {
        for n in 0..count.min(frames.len()) {
            let at = (2 * n + 1) * frames.len() / (2 * count.min(frames.len()));
            chosen.push((frames[at], false));
        }
    };
    spread(&of(Phase::Load), 2, &mut chosen);
    let hold = of(Phase::Hold);
    match hold.len() {
        0..=3 => chosen.extend(hold.iter().map(|i| (*i, false))),
        n => {
            let mid = n / 2;
            chosen.extend([
                (hold[0], false),
                (hold[mid - 1], false),
                (hold[mid], false),
                (hold[n - 1], false),
            ]);
        }
    }
    // Frames that follow on each other in a hold are twins: only noise tells them apart.
    for i in 0..chosen.len() {
        let twin = i + 1 < chosen.len()
            && phase(&chosen[i].0) == Phase::Hold
            && phase(&chosen[i + 1].0) == Phase::Hold
            && chosen[i + 1].0 == chosen[i].0 + 1;
        chosen[i].1 = twin && (i == 0 || !chosen[i - 1].1);
    }
    spread(&of(Phase::Slide), 4, &mut chosen);
    spread(&of(Phase::Unload), 2, &mut chosen);
    // After a release: at once, and as late as the pause allows.
    let touched = press.iter().rposition(|i| phase(i).touched());
    let rest: Vec<usize> =
        press[touched.map_or(0, |t| t + 1)..].iter().copied().filter(|i| !facts[*i].since.is_nan()).collect();
    if let (Some(first), Some(last)) = (rest.first(), rest.last()) {
        chosen.push((*first, false));
        if last != first {
            chosen.push((*last, false));
        }
    }
    chosen
}
