//! Causes that act on what touches: forces by what their place remembers, tips, and where the rig really presses.
//!
//! Every place of a script is a channel that reads the force on it; the laws of [`memory`](crate::memory) and
//! [`laws`](crate::laws) change that reading, and the force with it. A family's own model then answers what the changed force
//! does. So an elastomer or a foam that remembers is computed without any law that the family has for it.

use std::collections::BTreeMap;

use dermis_skin::Surface;
use nalgebra::{Point3, Vector3};
use rand::Rng;

use crate::cause::{CauseInfo, Causes};
use crate::script::Script;
use crate::{Cause, laws, memory};

/// Causes that act on loads. A device of which one is at work is asked for other stimuli than the script's.
const ON_LOADS: [&str; 13] = [
    "preisach-friction",
    "inner-friction",
    "slipping-elements",
    "creeping-foam",
    "softening",
    "stiff-gel",
    "yielding-gel",
    "scaled-force",
    "wide-tip",
    "shifted-rig",
    "bumped-mount",
    "dragging-tip",
    "turned-skin",
];
/// What a force can become at most, times what it was.
const MOST: f64 = 4.0;
/// \[m/s²\].
const GRAVITY: f64 = 9.81;

/// Whether a device with these causes is pressed otherwise than the script says.
pub(crate) fn act_on_loads(causes: &Causes) -> bool {
    ON_LOADS.iter().any(|id| causes.get(id).is_some())
}

/// What really touches, where the script says otherwise.
pub(crate) fn really(causes: &Causes, script: &Script, surface: &Surface) -> Script {
    let mut script = script.clone();
    remembered(causes, &mut script);
    resized(causes, &mut script);
    displaced(causes, &mut script, surface);
    dragged(causes, &mut script);
    turned(causes, &mut script);
    script
}

/// Forces by what their place remembers.
fn remembered(causes: &Causes, script: &mut Script) {
    let mut columns: BTreeMap<(u32, u64), usize> = BTreeMap::new();
    let at: Vec<Option<usize>> = script
        .instants
        .iter()
        .map(|instant| {
            let moment = &instant.moment;
            let touched = !moment.stimulus.contacts.is_empty();
            // A press without a place is a place of its own.
            let key = if moment.location > 0 { (moment.location, 0) } else { (0, moment.press) };
            let next = columns.len();
            touched.then(|| *columns.entry(key).or_insert(next))
        })
        .collect();
    let places = columns.len().max(1);
    let mut loads = vec![0.0; places * script.instants.len()];
    for ((row, at), instant) in loads.chunks_mut(places).zip(&at).zip(&script.instants) {
        if let (Some(at), Some(contact)) = (at, instant.moment.stimulus.contacts.first()) {
            row[*at] = contact.force.norm();
        }
    }
    let clean = loads.clone();
    if let Some((_, width)) = causes.get("preisach-friction") {
        laws::preisach(places, width, &mut loads);
    }
    if let Some((_, width)) = causes.get("inner-friction") {
        memory::bouc_wen(places, width, &mut loads);
    }
    if let Some((_, width)) = causes.get("slipping-elements") {
        laws::maxwell_slip(places, width, &mut loads);
    }
    if let Some((_, loss)) = causes.get("softening") {
        memory::softening(places, loss, &mut loads);
    }
    if let Some((_, share)) = causes.get("creeping-foam") {
        memory::creep(script, places, (-share, 0.25), &mut loads);
    }
    let large = memory::scale(&clean);
    let power = causes.size("yielding-gel");
    let stiffer = 1.0 + causes.size("stiff-gel");
    let factor = (1.0 + causes.size("scaled-force")) / stiffer;
    for (index, instant) in script.instants.iter_mut().enumerate() {
        let Some(at) = at[index] else { continue };
        let (before, after) = (clean[index * places + at], loads[index * places + at]);
        if before <= 0.0 {
            continue;
        }
        let bent = (1.0 + 9.0 * before / large).powf(-power);
        let change = (after / before * factor * bent).clamp(0.0, MOST);
        instant.moment.stimulus.contacts.iter_mut().for_each(|c| c.force *= change);
    }
}

/// Tips of another size than the rig says.
fn resized(causes: &Causes, script: &mut Script) {
    let Some((_, change)) = causes.get("wide-tip") else { return };
    let contacts = script.instants.iter_mut().flat_map(|i| &mut i.moment.stimulus.contacts);
    contacts.for_each(|c| c.tip.shape = c.tip.shape.scaled(1.0 + change));
}

/// Which way \[m\] a rig is off, and from which time \[s\] on.
fn ways(causes: &Causes, script: &Script) -> Vec<(f64, Vector3<f64>)> {
    let direction = |cause: &Cause| {
        let mut rng = cause.rng();
        rng.set_stream(5);
        let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
        Vector3::new(cos, sin, rng.random_range(-1.0..1.0)).normalize()
    };
    let shifted = causes.get("shifted-rig").map(|(cause, way)| (f64::NEG_INFINITY, direction(cause) * way));
    let bumped = causes.get("bumped-mount").and_then(|(cause, _)| {
        let (from, way, _) = memory::bump(causes, script)?;
        Some((from, direction(cause) * way))
    });
    shifted.into_iter().chain(bumped).collect()
}

/// Contacts beside where the rig says, on the surface and as steep to it as they were.
fn displaced(causes: &Causes, script: &mut Script, surface: &Surface) {
    let ways = ways(causes, script);
    if ways.is_empty() {
        return;
    }
    for instant in &mut script.instants {
        let off: Vector3<f64> = ways.iter().filter(|(from, _)| instant.time > *from).map(|(_, w)| w).sum();
        if off == Vector3::zeros() {
            continue;
        }
        for contact in &mut instant.moment.stimulus.contacts {
            let (_, before) = surface.project(&contact.position);
            let (at, after) = surface.project(&(contact.position + off));
            contact.position = at;
            let pressing = -contact.force.dot(&before);
            contact.force = -after * pressing;
            contact.tip = dermis_model::Tip::standing(contact.tip.shape, &after);
        }
    }
}

/// A tip that slides drags the surface along.
fn dragged(causes: &Causes, script: &mut Script) {
    let Some((_, friction)) = causes.get("dragging-tip") else { return };
    let mut before: Option<(f64, Point3<f64>)> = None;
    for instant in &mut script.instants {
        let now = instant.moment.stimulus.contacts.first().map(|c| (instant.time, c.position));
        if let (Some((then, from)), Some((time, to))) = (before, now) {
            for contact in &mut instant.moment.stimulus.contacts {
                let pressing = contact.force.norm();
                contact.force += laws::drag(friction, pressing, to - from, time - then);
            }
        }
        before = now;
    }
}

/// In the second session the skin hangs another way, and its own weight pulls at it: nobody wrote that down.
fn turned(causes: &Causes, script: &mut Script) {
    let Some((cause, share)) = causes.get("turned-skin") else { return };
    let (sin, cos) = cause.rng().random_range(0.0..std::f64::consts::TAU).sin_cos();
    let down = Vector3::new(cos, sin, 0.0) * (GRAVITY * share);
    for instant in script.instants.iter_mut().filter(|i| i.session > 0) {
        instant.moment.stimulus.gravity = down;
    }
}

pub(crate) const SCALED_FORCE: CauseInfo = CauseInfo::new(
    "scaled-force",
    "the rig's force cell says less or more than what presses, by one factor",
    "calibration of a force cell",
    ("relative-change", "1", 0.5),
    true,
    true,
);

/// A rig that is registered wrongly; the size is that of a panel.
pub(crate) const SHIFTED_RIG: CauseInfo = CauseInfo::new(
    "shifted-rig",
    "the rig's frame lies beside that of the skin",
    "registration of stage and skin",
    ("shift", "m", 0.03),
    false,
    true,
);

pub(crate) const WIDE_TIP: CauseInfo = CauseInfo::new(
    "wide-tip",
    "the tip is larger or smaller than the rig says, by one factor",
    "exchanged tips",
    ("relative-change", "1", 0.6),
    true,
    true,
);

#[cfg(test)]
mod tests {
    use dermis_model::{Indentation, Stimulus};
    use dermis_skin::SurfaceSpec;
    use dermis_testbed::GroundTruth;

    use super::*;
    use crate::cause::Cell;
    use crate::script::Instant;

    const KNOWN: &[CauseInfo] = &[
        SCALED_FORCE,
        WIDE_TIP,
        crate::common::PREISACH_FRICTION,
        crate::common::BUMPED_MOUNT.cell(Cell::DoesNotRepeat),
        crate::common::DRAGGING_TIP,
    ];

    /// Two presses of one place, up to 10 N and back in 20 instants each, and a third of another place that slides.
    fn script() -> Script {
        let mut instants = Vec::new();
        for i in 0..60u32 {
            let (press, part) = (i / 20, f64::from(i % 20) / 10.0);
            let force = 10.0 * (1.0 - (part - 1.0).abs());
            let x = if press == 2 { 0.001 * f64::from(i % 20) } else { 0.0 };
            let mut stimulus = Stimulus::default();
            if force > 0.0 {
                stimulus.contacts.push(Indentation::sphere(
                    Point3::new(x, 0.0, 0.0),
                    Vector3::new(0.0, 0.0, -force),
                    0.004,
                ));
            }
            let location = if press == 2 { 2 } else { 1 };
            let moment =
                GroundTruth { stimulus, press: u64::from(press) + 1, location, ..GroundTruth::default() };
            instants.push(Instant { time: f64::from(i) * 0.05, session: 0, moment });
        }
        Script { step: 0.05, instants, quiet: 0 }
    }

    fn changed(id: &str) -> Script {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.1, 0.1], spacing: 0.01 });
        let cause = Cause { id: id.to_owned(), strength: 0.4, seed: 3 };
        really(&Causes::new(KNOWN, &[cause]).unwrap(), &script(), &surface)
    }

    fn force(script: &Script, index: usize) -> f64 {
        script.instants[index].moment.stimulus.contacts[0].force.norm()
    }

    #[test]
    fn a_place_that_remembers_answers_less_on_the_way_up_than_back() {
        let changed = changed("preisach-friction");
        // 5 N on the way up and on the way back, of both presses of the place alike.
        assert!(force(&changed, 5) < force(&changed, 15) - 0.05, "{}", force(&changed, 5));
        approx::assert_relative_eq!(force(&changed, 15), force(&changed, 35), max_relative = 1e-9);
    }

    #[test]
    fn forces_tips_and_places_are_what_their_causes_say() {
        let (nominal, scaled, wide) = (script(), changed("scaled-force"), changed("wide-tip"));
        let ratio = force(&scaled, 10) / force(&nominal, 10);
        assert!((ratio - 1.2).abs() < 1e-9 || (ratio - 0.8).abs() < 1e-9, "{ratio}");
        let diameter = wide.instants[10].moment.stimulus.contacts[0].diameter();
        assert!((diameter / 0.004 - 1.0).abs() > 0.2, "{diameter}");
        let bumped = changed("bumped-mount");
        let at = |s: &Script, i: usize| s.instants[i].moment.stimulus.contacts[0].position;
        assert_eq!(at(&bumped, 5), at(&nominal, 5));
        assert!((at(&bumped, 58) - at(&nominal, 58)).norm() > 1e-4);
        assert!(at(&bumped, 58).z.abs() < 1e-9, "it stays on the surface");
        let dragged = changed("dragging-tip");
        let along = |i: usize| dragged.instants[i].moment.stimulus.contacts[0].force.x;
        assert!(along(5) == 0.0 && along(50) > 0.1, "{} {}", along(5), along(50));
    }
}
