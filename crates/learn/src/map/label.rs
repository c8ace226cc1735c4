//! Labels frames one after the other: where the tip is, with which force it presses, and whether that is a contact.

use dermis_skin::{ForceComponents, SkinDescription, Stamp, Surface};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::{LabelMap, Locations, Tracks, at};
use crate::LearnError;
use crate::dataset::{Sparse, Truth, TruthContact};
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

/// Readings without contact that one bias is taken of at most where readings are not held: a minute at 1 kHz.
const MOST_FREE: usize = 60_000;

/// Offset of the force sensor over time: a mean for each stretch in which the tip is away.
struct Offsets {
    stretches: Sparse<(Stamp, Vector3<f64>)>,
    /// Stretches, those between the ones that are kept too.
    count: usize,
    squares: f64,
    readings: usize,
}

impl Offsets {
    /// Measured wherever the tip is away from the surface. At most `bound` stretches are kept, evenly spread.
    fn of(
        tracks: &mut Tracks,
        map: &LabelMap,
        surface: &Surface,
        bound: Option<usize>,
    ) -> Result<Self, LearnError> {
        let Tracks { poses, forces } = tracks;
        let mut offsets =
            Self { stretches: Sparse::new(bound.unwrap_or(usize::MAX)), count: 0, squares: 0.0, readings: 0 };
        let longest = if forces.is_streamed() { MOST_FREE } else { usize::MAX };
        let mut stretch: Vec<(Stamp, Vector3<f64>)> = Vec::new();
        for reading in forces.all() {
            let (stamp, force) = reading?;
            let away = at(poses.around(stamp)?, stamp, map.max_gap())
                .is_some_and(|tool| approach(map, surface, &tool).gap >= map.contact.clearance);
            if away {
                stretch.push((stamp, force));
            }
            if !away || stretch.len() >= longest {
                offsets.take(&stretch);
                stretch.clear();
            }
        }
        offsets.take(&stretch);
        poses.rewind();
        Ok(offsets)
    }

    /// Takes a stretch without contact.
    fn take(&mut self, stretch: &[(Stamp, Vector3<f64>)]) {
        if stretch.len() >= FEWEST_FREE {
            let mean = stretch.iter().map(|(_, f)| f).sum::<Vector3<f64>>() / stretch.len() as f64;
            self.squares += stretch.iter().map(|(_, f)| (f - mean).norm_squared()).sum::<f64>();
            self.readings += stretch.len();
            self.count += 1;
            self.stretches.push((stretch[stretch.len() / 2].0, mean));
        }
    }

    fn at(&self, stamp: Stamp) -> Vector3<f64> {
        let stretches = self.stretches.list();
        let (Some(first), Some(last)) = (stretches.first(), stretches.last()) else {
            return Vector3::zeros();
        };
        let held = if stamp <= first.0 { first.1 } else { last.1 };
        at(stretches, stamp, i64::MAX).unwrap_or(held)
    }

    fn figures(&self) -> Bias {
        let stretches = self.stretches.list();
        let count = stretches.len().max(1) as f64;
        let mean = stretches.iter().map(|(_, m)| m).sum::<Vector3<f64>>() / count;
        let free = (3 * (self.readings.saturating_sub(self.count))).max(1) as f64;
        Bias { stretches: self.count, mean: mean.into(), noise: (self.squares / free).sqrt() }
    }

    /// Says whether the offset is unknown, or too noisy for the rule of contacts.
    fn check(&self, map: &LabelMap, place: &str, findings: &mut Findings) {
        let clearance = map.contact.clearance * 1e3;
        if self.count == 0 && map.force.remove_bias {
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
pub(crate) struct Labeller<'a> {
    map: &'a LabelMap,
    tracks: Tracks,
    surface: Surface,
    offsets: Offsets,
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

impl<'a> Labeller<'a> {
    /// Measures the force sensor's bias; `None` where something is in the way. Where readings are not held, `bound` is how many stretches
    /// without contact the bias is kept of.
    pub(crate) fn new(
        mut tracks: Tracks,
        map: &'a LabelMap,
        skin: &SkinDescription,
        (locations, bound): (&'a mut Locations, Option<usize>),
        place: &str,
        findings: &mut Findings,
    ) -> Result<Option<Self>, LearnError> {
        if findings.is_fatal() {
            return Ok(None);
        }
        let surface = skin.surface();
        let offsets = Offsets::of(&mut tracks, map, &surface, bound)?;
        offsets.check(map, place, findings);
        if findings.is_fatal() {
            return Ok(None);
        }
        Ok(Some(Self {
            map,
            tracks,
            surface,
            offsets,
            locations,
            to_link: map.skin.pose.isometry().rotation.inverse(),
            touched: false,
            press: 0,
            location: 0,
            elsewhere: 0,
            beside: 0,
        }))
    }

    /// What is true of the frame with this stamp; `None` where the rig does not tell.
    /// From call to call, stamps must not become less.
    pub(crate) fn label(&mut self, stamp: Stamp) -> Result<Option<Truth>, LearnError> {
        let max_gap = self.map.max_gap();
        let tool = at(self.tracks.poses.around(stamp)?, stamp, max_gap);
        let force = at(self.tracks.forces.around(stamp)?, stamp, max_gap);
        let truth = tool.zip(force).map(|(tool, force)| self.truth(stamp, &tool, force));
        self.touched &= truth.is_some();
        Ok(truth.flatten())
    }

    /// What is true at `stamp` by the pose of the tool and the reading of the force sensor.
    fn truth(&mut self, stamp: Stamp, tool: &Isometry3<f64>, raw: Vector3<f64>) -> Option<Truth> {
        let map = self.map;
        let tip = approach(map, &self.surface, tool);
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

    /// \[s\] between two readings that are still interpolated.
    pub(crate) fn tolerance(&self) -> f64 {
        self.map.join.max_gap
    }

    /// Says in how many of the frames something else was pushed; what the force sensor does when nothing touches.
    pub(crate) fn finish(self, frames: usize, place: &str, findings: &mut Findings) -> Bias {
        let clearance = self.map.contact.clearance * 1e3;
        for (count, what) in [
            (self.elsewhere, format!("with the tip {clearance} mm or more away from the skin")),
            (self.beside, "with the tip beyond the rim of the skin".to_owned()),
        ] {
            if count > 0 {
                findings.notice(
                    place,
                    format!("in {count} of {frames} frames the force sensor feels a push {what}"),
                    "they are not used; check robot.tip, skin.pose and the time offsets of the map",
                );
            }
        }
        self.offsets.figures()
    }
}
