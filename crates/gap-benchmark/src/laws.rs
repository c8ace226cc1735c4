//! More than one law for an effect: what a right name with a wrong law leaves is not what the library calls by that name, and a tool that
//! knows one law must not fall for another.
//!
//! | effect | laws |
//! |---|---|
//! | hysteresis | Bouc and Wen ([`bouc_wen`](crate::memory::bouc_wen)), Preisach ([`preisach`]), Maxwell slip ([`maxwell_slip`]) |
//! | creep | power-law spectrum ([`creep`](crate::memory::creep)), standard solid ([`standard_solid`]) |
//! | ageing | exponential in presses (`wearing`), logarithmic ([`worn`]) |
//! | saturation | hyperbolic tangent (`soft-ceiling`), algebraic ([`bend_over`]) |
//! | local change | cavity, broken beam, soft spot ([`soft_spot`]), crack ([`crack`]) |
//! | what stays | permanent set ([`permanent_set`]) |
//!
//! Rows are one reading a channel, row after row.

use nalgebra::{Point2, Point3, Vector2, Vector3};

use crate::cause::{Cause, Causes};
use crate::memory::scale;
use crate::script::Script;

/// Relays along each threshold of Preisach's plane.
const RELAYS: usize = 16;
/// Share of a large reading over which the weight of relays falls with the distance of their thresholds.
const NARROW: f64 = 0.2;

/// Preisach's hysteresis (Preisach 1935, Mayergoyz 1986): relays that switch up at one level and down at a lower one, most of them
/// narrow; `width` is the share of the reading that goes through them.
pub(crate) fn preisach(channels: usize, width: f64, readings: &mut [f64]) {
    let large = scale(readings);
    let level = |i: usize| (i as f64 + 0.5) / RELAYS as f64;
    let relays: Vec<(f64, f64, f64)> = (0..RELAYS)
        .flat_map(|up| (0..=up).map(move |down| (up, down)))
        .map(|(up, down)| {
            let (up, down) = (level(up), level(down) - 0.5 / RELAYS as f64);
            (up, down, (-(up - down) / NARROW).exp())
        })
        .collect();
    let total: f64 = relays.iter().map(|r| r.2).sum();
    let mut states = vec![false; relays.len() * channels];
    for row in readings.chunks_mut(channels) {
        for (c, value) in row.iter_mut().enumerate() {
            let now = value.abs() / large;
            let mut on = 0.0;
            for ((up, down, weight), state) in relays.iter().zip(&mut states[c * relays.len()..]) {
                *state = now >= *up || (*state && now > *down);
                on += if *state { *weight } else { 0.0 };
            }
            *value = (1.0 - width) * *value + width * large * on / total * value.signum();
        }
    }
}

/// Maxwell slip (Iwan 1966): springs that slip at loads of their own, in parallel; a share of the reading in proportion to the load.
pub(crate) fn maxwell_slip(channels: usize, width: f64, readings: &mut [f64]) {
    const LIMITS: [f64; 6] = [0.01, 0.03, 0.06, 0.12, 0.25, 0.5];
    let large = scale(readings);
    let total: f64 = LIMITS.iter().sum();
    let mut states = vec![([0.0f64; LIMITS.len()], 0.0f64); channels];
    for row in readings.chunks_mut(channels) {
        for (value, (springs, last)) in row.iter_mut().zip(&mut states) {
            let change = (*value - *last) / large;
            *last = *value;
            for (spring, limit) in springs.iter_mut().zip(LIMITS) {
                *spring = (*spring + change).clamp(-limit, limit);
            }
            *value *= 1.0 - width * springs.iter().sum::<f64>() / total;
        }
    }
}

/// Zener's standard linear solid: `share` of a held reading fades with one time constant \[s\].
pub(crate) fn standard_solid(
    script: &Script,
    channels: usize,
    (share, time): (f64, f64),
    readings: &mut [f64],
) {
    let mut faded = vec![0.0; channels];
    let mut before = None;
    for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
        let step = before.map_or(script.step, |b| instant.time - b);
        before = Some(instant.time);
        for (value, faded) in row.iter_mut().zip(&mut faded) {
            *faded += (*value - *faded) * (1.0 - (-step / time).exp());
            *value -= share * *faded;
        }
    }
}

/// Fatigue that goes on with the logarithm of the presses near a channel (Basquin's law of many small loads): `loss` of it after a
/// hundred.
pub(crate) fn worn(channels: usize, loss: f64, readings: &mut [f64]) {
    let large = scale(readings);
    let mut presses = vec![(0.0f64, false); channels];
    for row in readings.chunks_mut(channels) {
        for (value, (count, pressed)) in row.iter_mut().zip(&mut presses) {
            let now = value.abs() > 0.2 * large;
            *count += f64::from(u8::from(now && !*pressed));
            *pressed = now;
            *value *= 1.0 - (loss * (*count).ln_1p() / 100.0f64.ln_1p()).min(0.95);
        }
    }
}

/// Bends over towards a ceiling that is so much below twice the largest reading: `v / (1 + |v / c|³)^(1/3)`.
pub(crate) fn bend_over(depth: f64, readings: &mut [f64]) {
    let most = readings.iter().fold(0.0f64, |most, v| most.max(v.abs())).max(f64::MIN_POSITIVE);
    let ceiling = 2.0 * most * (1.0 - depth).max(1e-3);
    readings.iter_mut().for_each(|v| *v /= (1.0 + (v.abs() / ceiling).powi(3)).cbrt());
}

/// What a channel has been pressed to leaves a share of it behind for good (plastic strain; compression set).
pub(crate) fn permanent_set(channels: usize, share: f64, readings: &mut [f64]) {
    let mut most = vec![0.0f64; channels];
    for row in readings.chunks_mut(channels) {
        for (value, most) in row.iter_mut().zip(&mut most) {
            let clean = *value;
            *value += share * *most;
            if clean.abs() > most.abs() {
                *most = clean;
            }
        }
    }
}

/// Within some way \[m\] of one place the skin gives way more and reads more, the more the harder it is pressed.
pub(crate) fn soft_spot(
    script: &Script,
    channels: usize,
    (at, reach): (&Point3<f64>, f64),
    rise: f64,
    readings: &mut [f64],
) {
    let most = script
        .instants
        .iter()
        .flat_map(|i| &i.moment.stimulus.contacts)
        .map(|c| c.force.norm())
        .fold(f64::MIN_POSITIVE, f64::max);
    for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
        for contact in &instant.moment.stimulus.contacts {
            let away = (contact.position - at).norm() / reach;
            let hard = (contact.force.norm() / most).sqrt();
            let factor = 1.0 + rise * hard * (-0.5 * away * away).exp();
            row.iter_mut().for_each(|v| *v *= factor);
        }
    }
}

/// A cut along a line: what is pressed on one side of it arrives on the other side in part only.
pub(crate) fn crack(
    script: &Script,
    elements: &[Point2<f64>],
    (through, across): (&Point2<f64>, &Vector2<f64>),
    loss: f64,
    readings: &mut [f64],
) {
    let side = |p: &Point2<f64>| (p - through).dot(across);
    for (row, instant) in readings.chunks_mut(elements.len()).zip(&script.instants) {
        let Some(contact) = instant.moment.stimulus.contacts.first() else { continue };
        let pressed = side(&contact.position.xy());
        for (value, element) in row.iter_mut().zip(elements) {
            if pressed * side(element) < 0.0 {
                *value *= 1.0 - loss;
            }
        }
    }
}

/// \[N\] with which a tip that slid `way` \[m\] in `time` \[s\] drags the surface along: friction grows less than the load (Schallamach).
pub(crate) fn drag(friction: f64, pressing: f64, way: Vector3<f64>, time: f64) -> Vector3<f64> {
    let speed = way / time.max(1e-6);
    let drag = friction * pressing * pressing.max(1e-3).powf(-1.0 / 9.0);
    speed / (speed.norm() + 5e-4) * drag
}

/// \[s\] of a standard solid, drawn once a device.
pub(crate) fn solid_time(cause: &Cause) -> f64 {
    0.5 * 10f64.powf(0.5 * (1.0 + cause.normals(1)[0].clamp(-1.0, 1.0)))
}

/// What material and converter remember by these laws. `creeps` is the sign of creep: a reading that is held fades, or grows.
pub(crate) fn remember(causes: &Causes, script: &Script, channels: usize, creeps: f64, readings: &mut [f64]) {
    if let Some((_, width)) = causes.get("preisach-friction") {
        preisach(channels, width, readings);
    }
    if let Some((_, width)) = causes.get("slipping-elements") {
        maxwell_slip(channels, width, readings);
    }
    if let Some((cause, share)) = causes.get("standard-solid") {
        standard_solid(script, channels, (creeps * share, solid_time(cause)), readings);
    }
    if let Some((_, loss)) = causes.get("wearing-logarithmic") {
        worn(channels, loss, readings);
    }
    if let Some((_, share)) = causes.get("permanent-set") {
        permanent_set(channels, share, readings);
    }
    if let Some((_, depth)) = causes.get("bending-over") {
        bend_over(depth, readings);
    }
}

#[cfg(test)]
mod tests {
    use dermis_model::{Indentation, Stimulus};
    use dermis_testbed::GroundTruth;
    use nalgebra::Vector3;

    use super::*;
    use crate::script::Instant;

    /// Up to the largest value and down again, in so many frames each.
    fn triangle(frames: usize) -> Vec<f64> {
        let up = (0..=frames).map(move |i| 1000.0 * i as f64 / frames as f64);
        up.clone().chain(up.rev()).collect()
    }

    #[test]
    fn loops_of_both_laws_are_as_wide_at_any_speed_and_close_in_themselves() {
        for law in [preisach, maxwell_slip] {
            let width = |frames: usize| {
                let mut readings = triangle(frames);
                law(1, 0.3, &mut readings);
                readings[frames / 2] - readings[frames + 1 + frames / 2]
            };
            let (slow, fast) = (width(2000), width(100));
            assert!(slow < -20.0, "loading reads less than unloading: {slow}");
            approx::assert_relative_eq!(slow, fast, max_relative = 0.05);
            // The same loop again is the same loop (wiping out; Mayergoyz 1986).
            let mut twice = [triangle(400), triangle(400)].concat();
            law(1, 0.3, &mut twice);
            approx::assert_relative_eq!(twice[600], twice[600 + 802], max_relative = 1e-9);
        }
    }

    fn held(seconds: f64) -> Script {
        let step = 0.01;
        let count = (seconds / step) as usize;
        let instant = |i: usize| {
            let contact =
                Indentation::sphere(Point3::new(0.002, 0.0, 0.0), Vector3::new(0.0, 0.0, -1.0), 0.004);
            let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
            let moment = GroundTruth { stimulus, ..GroundTruth::default() };
            Instant { time: i as f64 * step, session: 0, moment }
        };
        Script { step, instants: (0..count).map(instant).collect(), quiet: 0 }
    }

    #[test]
    fn a_standard_solid_fades_with_one_time_constant() {
        let script = held(6.0);
        let mut readings = vec![100.0; script.instants.len()];
        standard_solid(&script, 1, (0.4, 1.0), &mut readings);
        let left = |t: f64| (readings[(t / 0.01) as usize] - 60.0) / 40.0;
        // exp(−t) at 1 and 2 s, with a frame's delay.
        assert!((left(1.0) - (-1.0f64).exp()).abs() < 0.01 && (left(2.0) - (-2.0f64).exp()).abs() < 0.01);
        assert!(left(5.9) < 0.01);
    }

    #[test]
    fn wear_goes_with_the_logarithm_of_the_presses() {
        let mut readings: Vec<f64> = (0..400).flat_map(|_| [100.0, 0.0]).collect();
        worn(1, 0.5, &mut readings);
        let lost = |press: usize| 100.0 - readings[2 * (press - 1)];
        approx::assert_relative_eq!(lost(100), 50.0, max_relative = 1e-9);
        approx::assert_relative_eq!(lost(9) / lost(99), 0.5, max_relative = 1e-9);
    }

    #[test]
    fn readings_bend_over_and_stay_below_the_ceiling() {
        let mut readings = vec![1.0, 10.0, 100.0];
        bend_over(0.5, &mut readings);
        assert!((readings[0] - 1.0).abs() < 1e-3 && readings[2] < 80.0 && readings[2] > 70.0, "{readings:?}");
    }

    #[test]
    fn a_set_stays_and_grows_with_the_largest_press_only() {
        let mut readings = vec![0.0, 50.0, 0.0, 100.0, 0.0, 50.0, 0.0];
        permanent_set(1, 0.1, &mut readings);
        assert_eq!([readings[0], readings[2], readings[4], readings[6]], [0.0, 5.0, 10.0, 10.0]);
    }

    #[test]
    fn a_soft_spot_and_a_crack_act_where_they_are() {
        let script = held(0.02);
        let spot = |x: f64| {
            let mut readings = vec![100.0; 2];
            soft_spot(&script, 1, (&Point3::new(x, 0.0, 0.0), 0.003), 0.5, &mut readings);
            readings[0]
        };
        assert!((spot(0.002) - 150.0).abs() < 1e-9 && (spot(0.03) - 100.0).abs() < 1e-3);
        let elements = [Point2::new(0.004, 0.0), Point2::new(-0.004, 0.0)];
        let mut readings = vec![100.0; 4];
        crack(&script, &elements, (&Point2::origin(), &Vector2::x()), 0.4, &mut readings);
        assert_eq!(readings, [100.0, 60.0, 100.0, 60.0]);
    }
}
