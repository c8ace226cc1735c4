//! Labels frames one after the other: where the tip is, with which force it presses, and whether that is a contact.

use dermis_skin::{ForceComponents, SkinDescription, Stamp, Surface};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::{LabelMap, Locations, Readings, at};
use crate::dataset::{Truth, TruthContact};
use crate::findings::Findings;

/// What the rig's force sensor does when nothing touches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bias {
    /// Stretches in which it was measured.
    pub stretches: usize,
    /// \[N\] mean over them, in the sensor's axes.
    pub mean: [f64; 3],
    /// \[N\] standard deviation of one reading of one axis around it.
    pub noise: f64,
}

/// Readings without contact that a bias is taken of at least.
const FEWEST_FREE: usize = 5;

/// Offset of the force sensor over time: a mean for each stretch in which the tip is away.
struct Offsets {
    stretches: Vec<(Stamp, Vector3<f64>)>,
    squares: f64,
    readings: usize,
}

impl Offsets {
    /// Measured wherever the tip is away from the surface.
    fn of(readings: &Readings, map: &LabelMap, surface: &Surface) -> Self {
        let max_gap = map.max_gap();
        let away: Vec<bool> = readings
            .forces
            .iter()
            .map(|(t, _)| {
                at(&readings.poses, *t, max_gap)
                    .is_some_and(|tool| approach(map, surface, &tool).gap >= map.contact.clearance)
            })
            .collect();
        Self::measure(&readings.forces, &away)
    }

    fn measure(forces: &[(Stamp, Vector3<f64>)], away: &[bool]) -> Self {
        let mut offsets = Self { stretches: Vec::new(), squares: 0.0, readings: 0 };
        let mut k = 0;
        while k < forces.len() {
            let end = (k..forces.len()).find(|&i| !away[i]).unwrap_or(forces.len());
            let stretch = &forces[k..end];
            if stretch.len() >= FEWEST_FREE {
                let mean = stretch.iter().map(|(_, f)| f).sum::<Vector3<f64>>() / stretch.len() as f64;
                offsets.squares += stretch.iter().map(|(_, f)| (f - mean).norm_squared()).sum::<f64>();
                offsets.readings += stretch.len();
                offsets.stretches.push((stretch[stretch.len() / 2].0, mean));
            }
            k = end.max(k + 1);
        }
        offsets
    }

    fn at(&self, stamp: Stamp) -> Vector3<f64> {
        let (Some(first), Some(last)) = (self.stretches.first(), self.stretches.last()) else {
            return Vector3::zeros();
        };
        let held = if stamp <= first.0 { first.1 } else { last.1 };
        at(&self.stretches, stamp, i64::MAX).unwrap_or(held)
    }

    fn figures(&self) -> Bias {
        let count = self.stretches.len().max(1) as f64;
        let mean = self.stretches.iter().map(|(_, m)| m).sum::<Vector3<f64>>() / count;
        let free = (3 * (self.readings.saturating_sub(self.stretches.len()))).max(1) as f64;
        Bias { stretches: self.stretches.len(), mean: mean.into(), noise: (self.squares / free).sqrt() }
    }

    /// Says whether the offset is unknown, or too noisy for the rule of contacts.
    fn check(&self, map: &LabelMap, place: &str, findings: &mut Findings) {
        let clearance = map.contact.clearance * 1e3;
        if self.stretches.is_empty() && map.force.remove_bias {
            findings.fatal(
                place,
                format!(
                    "the tip is never {clearance} mm or more away from the skin for {FEWEST_FREE} readings of {}",
                    map.force.topic
                ),
                "the force sensor's bias is unknown; check robot.tip and skin.pose of the map, record the tip in the air, \
                 or set force.remove_bias to false",
            );
            return;
        }
        let figures = self.figures();
        if figures.noise * 3.0 > map.contact.off {
            findings.notice(
                place,
                format!(
                    "the force sensor's noise without contact is {:.3} N, and contact.off of the map {} N",
                    figures.noise, map.contact.off
                ),
                "noise will be taken for contacts; raise contact.on and contact.off to five times the noise",
            );
        }
    }
}

/// Where the tip is relative to a surface.
struct Approach {
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// \[m\] between tip and surface, negative where it sinks in.
    gap: f64,
    /// Whether the tip is beyond the rim.
    beside: bool,
}

fn approach(map: &LabelMap, surface: &Surface, tool: &Isometry3<f64>) -> Approach {
    let centre = map.skin.pose.isometry().inverse() * (tool * Point3::from(map.robot.tip));
    let (point, normal) = surface.project(&centre);
    let offset = centre - point;
    let along = offset.dot(&normal);
    let aside = (offset - normal * along).norm();
    let beside = aside > map.robot.tip_radius.max(1e-6);
    let distance = if beside { offset.norm() } else { along };
    Approach { point, normal, gap: distance - map.robot.tip_radius, beside }
}

/// Labels frames in order of their stamps.
struct Labeller<'a> {
    map: &'a LabelMap,
    readings: &'a Readings,
    surface: &'a Surface,
    offsets: &'a Offsets,
    locations: &'a mut Locations,
    /// From the axes of the base to those of the skin's link.
    to_link: UnitQuaternion<f64>,
    /// Whether the frame before was touched.
    touched: bool,
    /// The press that is going on, or was the last one.
    press: u64,
    /// Its location.
    location: u32,
    /// Frames in which something else is pushed: with the tip away from the skin, and beyond its rim.
    elsewhere: usize,
    beside: usize,
}

impl Labeller<'_> {
    /// What is true of the frame with this stamp; `None` where the rig does not tell.
    fn label(&mut self, stamp: Stamp) -> Option<Truth> {
        let (map, max_gap) = (self.map, self.map.max_gap());
        let (Some(tool), Some(raw)) =
            (at(&self.readings.poses, stamp, max_gap), at(&self.readings.forces, stamp, max_gap))
        else {
            self.touched = false;
            return None;
        };
        let tip = approach(map, self.surface, &tool);
        let bias = if map.force.remove_bias { self.offsets.at(stamp) } else { Vector3::zeros() };
        let force = self.to_link * (map.sensor_axes(&tool.rotation) * (raw - bias)) * map.sign();
        let pressing = -force.dot(&tip.normal);
        let was = self.touched;
        self.touched = pressing >= if was { map.contact.off } else { map.contact.on };
        let far = tip.gap >= map.contact.clearance;
        if self.touched && (far || tip.beside) {
            // Something is pushed, but not this skin where it has a surface.
            *(if far { &mut self.elsewhere } else { &mut self.beside }) += 1;
            self.touched = false;
            return None;
        }
        if !self.touched {
            return Some(Truth { press: self.press, location: 0, idle: far, contacts: Vec::new() });
        }
        if !was {
            self.press += 1;
            self.location = self.locations.identify(&tip.point, map.join.location_size);
        }
        let contact = TruthContact {
            position: tip.point,
            normal: tip.normal,
            force,
            components: ForceComponents::Full,
            diameter: 2.0 * map.robot.tip_radius,
            flat: false,
        };
        Some(Truth { press: self.press, location: self.location, idle: false, contacts: vec![contact] })
    }
}

/// Ground truth of every frame, given by its stamp; `None` where the rig does not tell.
pub(crate) fn label(
    frames: &[Stamp],
    readings: &mut Readings,
    map: &LabelMap,
    skin: &SkinDescription,
    locations: &mut Locations,
    place: &str,
    findings: &mut Findings,
) -> (Vec<Option<Truth>>, Option<Bias>) {
    readings.check(map, place, findings);
    if findings.is_fatal() {
        return (vec![None; frames.len()], None);
    }
    let surface = skin.surface();
    let offsets = Offsets::of(readings, map, &surface);
    offsets.check(map, place, findings);
    if findings.is_fatal() {
        return (vec![None; frames.len()], None);
    }
    let mut labeller = Labeller {
        map,
        readings,
        surface: &surface,
        offsets: &offsets,
        locations,
        to_link: map.skin.pose.isometry().rotation.inverse(),
        touched: false,
        press: 0,
        location: 0,
        elsewhere: 0,
        beside: 0,
    };
    let labels: Vec<Option<Truth>> = frames.iter().map(|stamp| labeller.label(*stamp)).collect();
    let clearance = map.contact.clearance * 1e3;
    for (count, what) in [
        (labeller.elsewhere, format!("with the tip {clearance} mm or more away from the skin")),
        (labeller.beside, "with the tip beyond the rim of the skin".to_owned()),
    ] {
        if count > 0 {
            findings.notice(
                place,
                format!("in {count} of {} frames the force sensor feels a push {what}", frames.len()),
                "they are not used; check robot.tip, skin.pose and the time offsets of the map",
            );
        }
    }
    (labels, Some(offsets.figures()))
}
