//! Reads a bag: ground truth, and what is known of its frames.
//!
//! A bag whose frames and ground truth are few is read once, and both are joined in memory. Of others, the first reading finds what is wrong,
//! the hash and how far things lie out of order; then frames and ground truth are read side by side, and joined as they come.

mod contents;
mod opened;

use dermis_skin::{SkinDescription, Stamp};
use nalgebra::Point3;
use sha2::{Digest, Sha256};

use super::index::{Counts, Indexer, Plan};
use super::order::WINDOW;
use super::recording::Losses;
use super::stream::{BagFrames, BagOrder};
use super::track::Track;
use super::{DatasetOptions, Run, Truth, hex};
use crate::LearnError;
use crate::findings::{self, Findings};
use crate::map::{Labeller, Locations};
use contents::Contents;
pub(super) use opened::Opened;
use opened::topic_of;

/// How bags are read: what for, and how much of all of them together may be held.
pub(super) struct Reader<'a> {
    pub(super) skin: &'a SkinDescription,
    pub(super) options: &'a DatasetOptions,
    pub(super) plan: Plan,
    /// What is left of [`DatasetOptions::memory`].
    pub(super) memory: usize,
}

impl Reader<'_> {
    /// One bag, joined; `None` where it cannot be. `findings` are those of this bag alone.
    pub(super) fn read(
        &mut self,
        opened: &Opened,
        locations: &mut Locations,
        findings: &mut Findings,
    ) -> Result<Option<Run>, LearnError> {
        let (skin, options, most) = (self.skin, self.options, self.plan.most());
        let path = opened.bag.path();
        let place = &findings::bag(path);
        let share = self.plan.share(opened.frames);
        let streamed = share.every > 1 || opened.readings > most;
        let mut hasher = Sha256::new();
        let mut contents = Contents::read(opened, skin, options, &mut hasher, (self.memory, streamed, most))?;
        contents.check_frames(skin, place, findings);
        if contents.choice.is_some() {
            return Ok(None);
        }
        let invalid = contents.frames.unhealthy;
        let of_bag = BagFrames {
            instance: contents.instance.clone(),
            topic: topic_of(options).cloned(),
            images: contents.images.clone(),
            order: BagOrder::Stored,
        };
        let mut found = std::mem::take(&mut contents.frames).finish(of_bag, &mut self.memory);
        let losses = found.losses;
        check_losses(&losses, place, findings);
        let (labels, span) = if let Some(map) = &options.map {
            let span = contents.rig.span();
            let readings = std::mem::take(&mut contents.rig);
            let bound = streamed.then_some(most);
            let tracks = readings.tracks(map, &opened.bag, place, findings);
            let labels = Labeller::new(tracks, map, skin, (locations, bound), place, findings)?;
            hasher.update(serde_json::to_vec(map).unwrap_or_default());
            let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
            contents.sessions.insert(name);
            (labels.map(|labeller| Labels::Rig(Box::new(labeller))), span)
        } else {
            let span = contents.truth_span();
            let tolerance = options.tolerance.unwrap_or_else(|| (0.5 / skin.rate).max(0.01));
            let track = contents.truth_track(&opened.bag, losses.frames, place, findings);
            (Some(Labels::Truths(track, tolerance)), span)
        };
        let Some(mut labels) = labels.filter(|_| !findings.is_fatal()) else { return Ok(None) };
        let tare_after = options.tare_when_idle.then_some(skin.condition.tare_duration);
        let mut index = Indexer::new(share, tare_after, losses.frames);
        for mark in found.marks(path)? {
            let mark = mark?;
            index.push(mark.stamp, mark.flags, labels.of(mark.stamp)?);
        }
        let (samples, between, counts) = index.finish();
        let tolerance = labels.tolerance();
        let bias = labels.finish(counts.frames, place, findings);
        check_labels(&counts, span, tolerance, place, findings);
        if findings.is_fatal() {
            return Ok(None);
        }
        if invalid > 0 {
            findings.notice(place, format!("{invalid} frames have channels that are not healthy"), "");
        }
        check_index(&counts, samples.len(), (share.every, most), place, findings);
        let session = contents.sessions.into_iter().collect::<Vec<_>>().join("+");
        let (hash, source) = (hex(&hasher.finalize()), found.source);
        let lost = losses.lost;
        Ok(Some(Run { path: path.into(), session, hash, samples, lost, bias, between, source }))
    }
}

/// What tells what was true of a frame.
enum Labels<'a> {
    /// Our own ground truth, within so many seconds.
    Truths(Track<Truth>, f64),
    Rig(Box<Labeller<'a>>),
}

impl Labels<'_> {
    /// What was true at `stamp`, which must not become less from call to call.
    fn of(&mut self, stamp: Stamp) -> Result<Option<Truth>, LearnError> {
        match self {
            Self::Truths(track, tolerance) => {
                Ok(truth_at(track.around(stamp)?, stamp, (*tolerance * 1e9) as i64))
            }
            Self::Rig(labeller) => labeller.label(stamp),
        }
    }

    /// \[s\] between a frame and its ground truth that still counts as the same instant.
    fn tolerance(&self) -> f64 {
        match self {
            Self::Truths(_, tolerance) => *tolerance,
            Self::Rig(labeller) => labeller.tolerance(),
        }
    }

    /// Says what was found on the way, over so many frames.
    fn finish(self, frames: usize, place: &str, findings: &mut Findings) -> Option<crate::map::Bias> {
        match self {
            Self::Truths(..) => None,
            Self::Rig(labeller) => Some(labeller.finish(frames, place, findings)),
        }
    }
}

/// Says how many frames are missing between those of a bag, and which cannot be used.
fn check_losses(losses: &Losses, place: &str, findings: &mut Findings) {
    if losses.lost > 0 {
        findings.notice(
            place,
            format!(
                "{} frames ({:.1} %) were lost between device and bag, the longest gap is {:.2} s",
                losses.lost,
                100.0 * losses.lost as f64 / (losses.lost as f64 + losses.frames as f64),
                losses.gap as f64 * 1e-9
            ),
            "a model that looks back sees steps there",
        );
    }
    check_late(losses.late, "frames", place, findings);
}

/// Says that some of `what` lie too far out of order.
pub(crate) fn check_late(late: usize, what: &str, place: &str, findings: &mut Findings) {
    if late > 0 {
        findings.notice(
            place,
            format!("{late} {what} lie behind more than {WINDOW} later ones"),
            "they are left out; where memory allows, raise `--most-frames` above the number of messages, and all are brought into order",
        );
    }
}

/// Says that not all frames are in the index, and what that leaves out.
fn check_index(
    counts: &Counts,
    indexed: usize,
    (every, most): (usize, usize),
    place: &str,
    findings: &mut Findings,
) {
    if every <= 1 {
        return;
    }
    let (frames, left_out) = (counts.frames, counts.frames - indexed);
    findings.notice(
        place,
        format!(
            "{frames} frames, every {} of which is used, and one of each press that has none among those: {indexed} of them \
             (most_frames = {most}); {left_out}, {:.1} %, are left out",
            ordinal(every),
            100.0 * left_out as f64 / frames.max(1) as f64
        ),
        "they serve as history and for the zero only; more are used with `--most-frames`, at 72 bytes each and 88 for each contact",
    );
    if counts.presses_left_out > 0 {
        findings.notice(
            place,
            format!("no frame of {} short presses is used", counts.presses_left_out),
            "locations may be missing; raise `--most-frames`",
        );
    }
    if counts.stretches_left_out > 0 {
        findings.notice(
            place,
            format!("{} untouched stretches are more than are kept track of", counts.stretches_left_out),
            "the zero rests in them as if the skin was touched; raise `--most-frames`",
        );
    }
}

/// A number that counts, e.g. 22nd.
fn ordinal(number: usize) -> String {
    let end = match (number % 10, number % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("{number}{end}")
}

/// Says which frames have no ground truth, and which have that of several contacts. `span` is from the first to the last stamp of
/// the ground truth.
fn check_labels(
    counts: &Counts,
    span: Option<(Stamp, Stamp)>,
    tolerance: f64,
    place: &str,
    findings: &mut Findings,
) {
    let Counts { frames, labelled, several, .. } = *counts;
    if labelled == 0 {
        let (begin, end) = counts.span.unwrap_or_default();
        let relative = |t: Stamp| t.saturating_sub(begin) as f64 * 1e-9;
        let (from, to) = span.unwrap_or_default();
        findings.fatal(
            place,
            format!(
                "none of {frames} frames has ground truth within {tolerance} s of its stamp: frames reach from 0 to {:.2} s, \
                 the ground truth from {:.2} to {:.2} s after the first frame",
                relative(end),
                relative(from),
                relative(to)
            ),
            "check that both were stamped by the same clock",
        );
        return;
    }
    if labelled < frames {
        findings.notice(
            place,
            format!("{} of {frames} frames have no ground truth within {tolerance} s", frames - labelled),
            "they are used as history only",
        );
    }
    if several > 0 {
        findings.notice(
            place,
            format!("{several} frames have several contacts"),
            "they only count for the target `contact`",
        );
    }
}

pub(super) fn truth_at(truths: &[(Stamp, Truth)], stamp: Stamp, tolerance: i64) -> Option<Truth> {
    let after = truths.partition_point(|(t, _)| *t < stamp);
    let before = after.checked_sub(1).and_then(|i| truths.get(i));
    let after = truths.get(after);
    let near = |t: &Stamp| t.saturating_sub(stamp).abs() <= tolerance;
    let distance = |(t, _): &(Stamp, Truth)| t.saturating_sub(stamp).abs();
    let (nearest, other) = match (before, after) {
        (Some(b), Some(a)) if distance(b) < distance(a) => (b, Some(a)),
        (Some(b), Some(a)) => (a, Some(b)),
        (Some(only), None) | (None, Some(only)) => (only, None),
        (None, None) => return None,
    };
    if !near(&nearest.0) {
        return None;
    }
    let mut truth = nearest.1.clone();
    if let Some((time, other)) = other
        && (time - nearest.0).abs() <= 2 * tolerance.max(1)
        && other.press == truth.press
        && other.location == truth.location
        && let ([mine], [theirs]) = (truth.contacts.as_mut_slice(), other.contacts.as_slice())
        && mine.components == theirs.components
        && *time != nearest.0
    {
        let weight = (stamp - nearest.0) as f64 / (time - nearest.0) as f64;
        // A gap in one of the readings must not spread to the other.
        let blend = |a: f64, b: f64| if a.is_finite() && b.is_finite() { a + weight * (b - a) } else { a };
        mine.position = Point3::from(mine.position.coords.zip_map(&theirs.position.coords, blend));
        mine.force = mine.force.zip_map(&theirs.force, blend);
    }
    Some(truth)
}
