//! How a skin is held and how a tip strokes it, of what a plan says.
//!
//! Problem: a rig turns a skin about two axes, and what the skin feels of it is gravity in its own frame; an indenter slides to and fro and
//! stops in between. Method: rotations about fixed axes, and shares of a way. Assumptions: a posture is reached in no time, and nothing is
//! accelerated. Cost: a few numbers a posture or a stroke.

use nalgebra::{UnitQuaternion, Vector3};

use super::draw::Draw;
use crate::plan::{PostureSet, Strokes};

/// \[m/s²\] at the surface of the earth (3rd CGPM, 1901).
const STANDARD_GRAVITY: f64 = 9.806_65;
/// \[rad\] by which a range of angles may miss a whole turn: digits of a plan.
const TURN: f64 = 1e-3;

/// \[rad\] yaw and roll of each posture.
pub(super) fn postures([yaw, roll]: [[f64; 2]; 2], set: PostureSet, draw: &mut Draw<'_>) -> Vec<[f64; 2]> {
    match set {
        PostureSet::Drawn(count) => (0..count).map(|_| [yaw, roll].map(|range| draw.within(range))).collect(),
        PostureSet::Grid([yaws, rolls]) => {
            evenly(yaw, yaws).flat_map(|yaw| evenly(roll, rolls).map(move |roll| [yaw, roll])).collect()
        }
    }
}

/// So many angles from one end of a range to the other; without the end of a whole turn, which is the beginning.
fn evenly([low, high]: [f64; 2], count: u32) -> impl Iterator<Item = f64> {
    let parts = if high - low >= std::f64::consts::TAU - TURN { count } else { count.saturating_sub(1) };
    (0..count).map(move |i| low + (high - low) * f64::from(i) / f64::from(parts.max(1)))
}

/// \[m/s²\] gravity in the frame of a link that was turned by roll about its own z axis, and then by yaw about the y axis of the rig, from where
/// gravity is `upright` in it: straight down along z where that is zero.
pub(super) fn gravity_in(upright: &Vector3<f64>, [yaw, roll]: [f64; 2]) -> Vector3<f64> {
    let down = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY);
    let gravity = if *upright == Vector3::zeros() { &down } else { upright };
    let [about_y, about_z] = [(Vector3::y_axis(), yaw), (Vector3::z_axis(), roll)]
        .map(|(axis, angle)| UnitQuaternion::from_axis_angle(&axis, angle));
    let rig_from_link = about_y * about_z;
    rig_from_link.inverse_transform_vector(gravity)
}

/// One stroke of a slide.
pub(super) struct Stroke {
    /// \[s\] that it takes.
    pub(super) duration: f64,
    /// Share of the way at which it ends.
    pub(super) to: f64,
    /// \[s\] for which the tip then stops.
    pub(super) stop: f64,
}

/// The strokes of a slide that takes `duration` \[s\] one way.
pub(super) fn strokes_of(strokes: &Strokes, duration: f64, draw: &mut Draw<'_>) -> Vec<Stroke> {
    let count = f64::from(strokes.count);
    let ends = (0..strokes.ways()).flat_map(|way| (1..=strokes.count).map(move |end| (way % 2 == 1, end)));
    ends.map(|(back, end)| {
        let to = f64::from(if back { strokes.count - end } else { end }) / count;
        // Nothing is drawn for a slide that does not stop, so that it stays what it was.
        let stop = if strokes.stop[1] > 0.0 { draw.more_within(strokes.stop) } else { 0.0 };
        Stroke { duration: duration / count, to, stop }
    })
    .collect()
}
