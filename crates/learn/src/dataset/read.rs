//! Reads a bag once: ground truth, and what is known of its frames.

mod contents;

use std::path::Path;

use dermis_skin::{SkinDescription, Stamp};
use nalgebra::Point3;
use sha2::{Digest, Sha256};

use super::recording::Mark;
use super::stream::{BagFrames, FrameInfo, infos};
use super::{DatasetOptions, Run, Truth, hex};
use crate::LearnError;
use crate::findings::{self, Findings};
use crate::map::{self, Locations};
use contents::{Contents, topic_of};

/// One bag, joined; `None` where it cannot be. `findings` are those of this bag alone, `memory` is what is left of
/// [`DatasetOptions::memory`].
pub(super) fn read_run(
    path: &Path,
    skin: &SkinDescription,
    options: &DatasetOptions,
    locations: &mut Locations,
    findings: &mut Findings,
    memory: &mut usize,
) -> Result<Option<Run>, LearnError> {
    let place = &findings::bag(path);
    let mut hasher = Sha256::new();
    let mut found = Contents::read(path, skin, options, &mut hasher, *memory)?;
    found.check_frames(skin, place, findings);
    if found.choice.is_some() {
        return Ok(None);
    }
    let invalid = found.frames.unhealthy;
    let of_bag = BagFrames {
        instance: found.instance.clone(),
        topic: topic_of(options).cloned(),
        images: found.images.clone(),
        ranks: None,
    };
    let (frames, source) = std::mem::take(&mut found.frames).finish(of_bag, memory);
    let lost = check_losses(&frames, place, findings);
    let tolerance = options.map.as_ref().map_or_else(
        || options.tolerance.unwrap_or_else(|| (0.5 / skin.rate).max(0.01)),
        |map| map.join.max_gap,
    );
    let stamps: Vec<Stamp> = frames.iter().map(|f| f.stamp).collect();
    let (labels, span, bias) = if let Some(map) = &options.map {
        let span = found.rig.span();
        let (labels, bias) = map::label(&stamps, &mut found.rig, map, skin, locations, place, findings);
        hasher.update(serde_json::to_vec(map).unwrap_or_default());
        found.sessions.insert(path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned());
        (labels, span, bias)
    } else {
        (found.label(&stamps, tolerance, place, findings), found.truth_span(), None)
    };
    if findings.is_fatal() {
        return Ok(None);
    }
    let marks = frames.into_iter().map(|m| (m.stamp, m.flags)).collect();
    let samples = infos(marks, labels, skin, options.tare_when_idle);
    check_labels(&samples, span, tolerance, place, findings);
    if findings.is_fatal() {
        return Ok(None);
    }
    if invalid > 0 {
        findings.notice(place, format!("{invalid} frames have channels that are not healthy"), "");
    }
    let session = found.sessions.into_iter().collect::<Vec<_>>().join("+");
    Ok(Some(Run { path: path.into(), session, hash: hex(&hasher.finalize()), samples, lost, bias, source }))
}

/// How many frames are missing between those of a bag, in order of acquisition; says so where any are.
fn check_losses(frames: &[Mark], place: &str, findings: &mut Findings) -> u64 {
    let (mut lost, mut gap) = (0_u64, 0);
    for w in frames.windows(2) {
        lost = lost.saturating_add(w[1].sequence.saturating_sub(w[0].sequence).saturating_sub(1));
        gap = gap.max(w[1].stamp.saturating_sub(w[0].stamp));
    }
    if lost > 0 {
        findings.notice(
            place,
            format!(
                "{lost} frames ({:.1} %) were lost between device and bag, the longest gap is {:.2} s",
                100.0 * lost as f64 / (lost as f64 + frames.len() as f64),
                gap as f64 * 1e-9
            ),
            "a model that looks back sees steps there",
        );
    }
    lost
}

/// Says which frames have no ground truth, and which have that of several contacts. `span` is from the first to the last stamp of
/// the ground truth.
fn check_labels(
    samples: &[FrameInfo],
    span: Option<(Stamp, Stamp)>,
    tolerance: f64,
    place: &str,
    findings: &mut Findings,
) {
    let labelled = samples.iter().filter(|s| s.truth.is_some()).count();
    if labelled == 0 {
        let begin = samples.first().map_or(0, |s| s.stamp);
        let relative = |t: Stamp| t.saturating_sub(begin) as f64 * 1e-9;
        let (from, to) = span.unwrap_or_default();
        findings.fatal(
            place,
            format!(
                "none of {} frames has ground truth within {tolerance} s of its stamp: frames reach from 0 to {:.2} s, \
                 the ground truth from {:.2} to {:.2} s after the first frame",
                samples.len(),
                relative(samples.last().map_or(begin, |s| s.stamp)),
                relative(from),
                relative(to)
            ),
            "check that both were stamped by the same clock",
        );
        return;
    }
    if labelled < samples.len() {
        findings.notice(
            place,
            format!(
                "{} of {} frames have no ground truth within {tolerance} s",
                samples.len() - labelled,
                samples.len()
            ),
            "they are used as history only",
        );
    }
    let several = samples.iter().filter(|s| s.truth.as_ref().is_some_and(|t| t.contacts.len() > 1)).count();
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
