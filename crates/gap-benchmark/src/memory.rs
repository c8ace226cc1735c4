//! Laws of materials and electronics that act on readings along time: rows of one reading a channel, row after row.

use rand::Rng;
use rand_distr::StandardNormal;

use crate::Noise;
use crate::cause::{Cause, Causes};
use crate::script::Script;

/// Root mean square of the largest tenth of what is read: the scale of a large reading.
pub(crate) fn scale(readings: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = readings.iter().map(|v| v.abs()).filter(|v| *v > 0.0).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.get(sizes.len() * 19 / 20).copied().unwrap_or(1.0).max(f64::MIN_POSITIVE)
}

/// Ogden and Roxburgh's pseudo-elasticity: below the largest energy that a channel has known it answers less.
pub(crate) fn softening(channels: usize, loss: f64, readings: &mut [f64]) {
    let large = scale(readings);
    let mut most = vec![0.0f64; channels];
    for row in readings.chunks_mut(channels) {
        for (value, most) in row.iter_mut().zip(&mut most) {
            let energy = (*value / large).powi(2);
            *most = most.max(energy);
            *value *= 1.0 - loss * libm::erf((*most - energy) / (0.1 + 0.3 * *most));
        }
    }
}

/// Bouc and Wen's hysteresis: a share of the reading that follows its changes and not its speed.
pub(crate) fn bouc_wen(channels: usize, width: f64, readings: &mut [f64]) {
    let yields = 0.08 * scale(readings);
    let (beta, gamma, power) = (0.6, 0.4, 1.6);
    let mut state = vec![(0.0f64, 0.0f64); channels];
    for row in readings.chunks_mut(channels) {
        for (value, (z, last)) in row.iter_mut().zip(&mut state) {
            let change = (*value - *last) / yields;
            *last = *value;
            // Small steps, so that the law and not the frame rate shapes the loop.
            let steps = (change.abs() * 8.0).ceil().max(1.0);
            for _ in 0..steps as usize {
                let d = change / steps;
                let grip = z.abs().powf(power);
                *z += d - (beta * d.abs() * z.signum() + gamma * d) * grip;
                *z = z.clamp(-1.0, 1.0);
            }
            *value *= 1.0 - width * *z;
        }
    }
}

/// Relaxation over a power-law spectrum of times from 30 ms to 100 s, `share` of it in all, weights as time to `power`.
pub(crate) fn creep(script: &Script, channels: usize, (share, power): (f64, f64), readings: &mut [f64]) {
    const TERMS: usize = 12;
    let times: Vec<f64> =
        (0..TERMS).map(|i| 0.03 * (3333.0f64).powf(i as f64 / (TERMS - 1) as f64)).collect();
    let weights: Vec<f64> = times.iter().map(|t| t.powf(-power)).collect();
    let total: f64 = weights.iter().sum();
    let mut state = vec![0.0; TERMS * channels];
    let mut before = None;
    for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
        let step = before.map_or(script.step, |b| instant.time - b);
        before = Some(instant.time);
        for (c, value) in row.iter_mut().enumerate() {
            let mut faded = 0.0;
            for ((state, time), weight) in state[c * TERMS..].iter_mut().zip(&times).zip(&weights) {
                *state += (*value - *state) * (1.0 - (-step / time).exp());
                faded += *state * weight / total;
            }
            *value -= share * faded;
        }
    }
}

/// The channels that a cause acts on, where it does not act on all.
pub(crate) fn on_channels(cause: &Cause, channels: usize) -> Option<Vec<usize>> {
    let mut rng = cause.rng();
    match cause.id.as_str() {
        "cable-tug" => {
            let first = rng.random_range(0..channels);
            Some(vec![first, (first + 1 + rng.random_range(0..channels.max(2) - 1)) % channels])
        }
        "leads-off" | "blocked-port" => Some(vec![rng.random_range(0..channels)]),
        _ => None,
    }
}

/// What changes the gain of elements, their zero, or mixes them.
pub(crate) fn gains(causes: &Causes, script: &Script, channels: usize, readings: &mut [f64]) {
    let mut gain = vec![1.0 + causes.size("common-gain"); channels];
    for (cause, deviation) in ["element-gains", "gauge-factors"].into_iter().filter_map(|id| causes.get(id)) {
        for (gain, n) in gain.iter_mut().zip(cause.normals(channels)) {
            *gain *= (deviation * n).exp();
        }
    }
    for (cause, loss) in ["leads-off", "blocked-port"].into_iter().filter_map(|id| causes.get(id)) {
        on_channels(cause, channels).into_iter().flatten().for_each(|c| gain[c] *= 1.0 - loss);
    }
    let nonlinear =
        causes.get("nonlinear-characteristic").map(|(cause, size)| (cause.normals(channels), size));
    let warm = causes.get("warm-gain").map(|(cause, size)| {
        let own: Vec<f64> = cause.normals(channels).iter().map(|n| size * (1.0 + 0.3 * n)).collect();
        own
    });
    let (start, wear) = (causes.size("warming-up"), causes.size("wearing"));
    let large = scale(readings);
    let mut press_counts = vec![0.0f64; channels];
    let mut pressed = vec![false; channels];
    for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
        // Half of it is gone after 90 s, the rest goes more slowly.
        let up = 1.0 + start * (0.6 * (-instant.time / 130.0).exp() + 0.4 * (-instant.time / 700.0).exp());
        for (c, value) in row.iter_mut().enumerate() {
            let clean = *value;
            *value *= gain[c] * up;
            if let Some((own, size)) = &nonlinear {
                *value += own[c] * size * clean * clean.abs();
            }
            if let Some(own) = &warm {
                *value *= 1.0 + own[c] * instant.warmth();
            }
            if wear > 0.0 {
                let now = clean.abs() > 0.2 * large;
                press_counts[c] += f64::from(u8::from(now && !pressed[c]));
                pressed[c] = now;
                *value *= 1.0 - wear * (1.0 - (-press_counts[c] / 15.0).exp());
            }
        }
    }
}

/// What electronics and surroundings add on the way to the converter.
pub(crate) fn electronics(causes: &Causes, script: &Script, channels: usize, readings: &mut [f64]) {
    if let Some((_, share)) = causes.get("crosstalk") {
        for row in readings.chunks_mut(channels) {
            let own = row.to_vec();
            for (c, value) in row.iter_mut().enumerate() {
                let left = c.checked_sub(1).map_or(0.0, |i| own[i]);
                let right = own.get(c + 1).copied().unwrap_or(0.0);
                *value += share * (0.6 * left + 0.4 * right);
            }
        }
    }
    if let Some((cause, deviation)) = causes.get("weather") {
        // Three slow waves and a trend.
        let mut rng = cause.rng();
        let waves: [(f64, f64, f64); 3] = std::array::from_fn(|i| {
            let period = [31.0, 140.0, 900.0][i] * rng.random_range(0.8..1.25);
            (period, rng.random_range(0.0..std::f64::consts::TAU), [0.3, 0.5, 0.8][i])
        });
        let trend = cause.sign() * 0.5 / 1000.0;
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            let wave = |(period, phase, size): &(f64, f64, f64)| {
                size * (std::f64::consts::TAU * instant.time / period + phase).sin()
            };
            let now = deviation * (waves.iter().map(wave).sum::<f64>() + trend * instant.time);
            row.iter_mut().for_each(|v| *v += now);
        }
    }
    if let Some((cause, amplitude)) = causes.get("mains-interference") {
        let mut rng = cause.rng();
        let own: Vec<(f64, f64)> = (0..channels)
            .map(|_| (amplitude * rng.random_range(0.3..1.0), rng.random_range(0.0..std::f64::consts::TAU)))
            .collect();
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            for (value, (size, phase)) in row.iter_mut().zip(&own) {
                *value += size * (std::f64::consts::TAU * 49.93 * instant.time + phase).sin();
            }
        }
    }
    if let Some((cause, size)) = causes.get("cable-tug") {
        let mut rng = cause.rng();
        rng.set_stream(3);
        let pulled: Vec<f64> = (0..=script.presses())
            .map(|_| if rng.random::<f64>() < 0.15 { rng.random_range(0.5..1.5) } else { 0.0 })
            .collect();
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            if instant.moment.stimulus.contacts.is_empty() {
                continue;
            }
            let now = size * pulled[instant.moment.press as usize];
            for (c, share) in on_channels(cause, channels).into_iter().flatten().zip([1.0, -0.7]) {
                row[c] += share * now;
            }
        }
    }
    if let Some((_, sag)) = causes.get("sagging-supply") {
        let large = scale(readings) * channels as f64;
        for row in readings.chunks_mut(channels) {
            let drawn = row.iter().map(|v| v.abs()).sum::<f64>() / large;
            row.iter_mut().for_each(|v| *v *= 1.0 - sag * drawn / (1.0 + drawn));
        }
    }
    // The last one is read at the stamp, the others before it.
    if let Some((_, delay)) = causes.get("bus-order") {
        late(script, channels, |c| (channels - 1 - c) as f64 * delay, readings);
    }
    if let Some((_, delay)) = causes.get("late-stamps") {
        late(script, channels, |_| delay, readings);
    }
}

/// Every channel as it was some time \[s\] ago.
fn late(script: &Script, channels: usize, by: impl Fn(usize) -> f64, readings: &mut [f64]) {
    let clean = readings.to_vec();
    for (t, row) in readings.chunks_mut(channels).enumerate() {
        for (c, value) in row.iter_mut().enumerate() {
            let back = by(c) / script.step;
            let frames = back.floor() as usize;
            let part = back - back.floor();
            let at = |frames: usize| clean[t.saturating_sub(frames) * channels + c];
            *value = at(frames) * (1.0 - part) + at(frames + 1) * part;
        }
    }
}

/// From which time \[s\] on, and by how much \[m\] along which angle \[rad\], a skin lies beside its place.
pub(crate) fn bump(causes: &Causes, script: &Script) -> Option<(f64, f64, f64)> {
    let (cause, shift) = causes.get("bumped-mount")?;
    let mut rng = cause.rng();
    let whole = script.instants.last()?.time;
    // On a line of elements what goes across it hardly shows.
    Some((whole * rng.random_range(0.3..0.7), cause.sign() * shift, rng.random_range(-0.6..0.6)))
}

/// How zeros move, by temperature and by themselves.
pub(crate) fn zeros(causes: &Causes, script: &Script, channels: usize, readings: &mut [f64]) {
    if let Some((cause, size)) = causes.get("warm-zero") {
        let own = cause.normals(2 * channels);
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            let warmth = instant.warmth();
            for (value, own) in row.iter_mut().zip(own.chunks(2)) {
                *value += size * (own[0] * warmth + 0.05 * own[1] * warmth * warmth);
            }
        }
    }
    if let Some((cause, size)) = causes.get("walking-zero") {
        let mut rng = cause.rng();
        let mut zero = vec![0.0; channels];
        let mut before = None;
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            let step = before.map_or(0.0, |b| instant.time - b);
            before = Some(instant.time);
            for (value, zero) in row.iter_mut().zip(&mut zero) {
                *zero += size * f64::sqrt(step / 100.0) * rng.sample::<f64, _>(StandardNormal);
                *value += *zero;
            }
        }
    }
}

/// What the converter and the driver do, noise included in what they get.
pub(crate) fn converter(causes: &Causes, script: &Script, channels: usize, readings: &mut [f64]) {
    if let Some((_, depth)) = causes.get("soft-ceiling") {
        // At no depth even the largest reading stays below the knee.
        let most = readings.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let ceiling = most / 0.6 * (1.0 - depth);
        let knee = 0.6 * ceiling;
        for value in readings.iter_mut().filter(|v| v.abs() > knee) {
            let over = (value.abs() - knee) / (ceiling - knee);
            *value = value.signum() * (knee + (ceiling - knee) * over.tanh());
        }
    }
    if let Some((_, depth)) = causes.get("uneven-steps") {
        let large = scale(readings);
        // One and a bit waves over what is read, as a converter of several stages has them.
        for value in readings.iter_mut() {
            let wave = 9.0 * *value / large;
            *value += depth * large / 9.0 * wave.sin();
        }
    }
    if let Some((_, count)) = causes.get("coarse-counts") {
        readings.iter_mut().for_each(|v| *v = (*v / count).floor() * count);
    }
    if let Some((cause, share)) = causes.get("stale-frames") {
        let mut rng = cause.rng();
        let mut left = 0u32;
        for t in 1..script.instants.len() {
            if left == 0 && rng.random::<f64>() < share / 12.0 {
                left = rng.random_range(4..20);
            }
            if left > 0 {
                left -= 1;
                readings.copy_within((t - 1) * channels..t * channels, t * channels);
            }
        }
    }
}

/// Holds the readings of each channel within its range, where it has one.
pub(crate) fn limit(ranges: &[Option<[f64; 2]>], readings: &mut [f64]) {
    for row in readings.chunks_mut(ranges.len()) {
        for (value, range) in row.iter_mut().zip(ranges) {
            *value = range.map_or(*value, |[low, high]| value.clamp(low, high));
        }
    }
}

/// Adds noise, so many times that of each channel.
pub(crate) fn add_noise(noise: &[f64], how: Noise, readings: &mut [f64]) {
    let mut rng = <rand_chacha::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(how.seed);
    if how.heavy {
        // Each channel with a deviation of its own, and three degrees of freedom: one value in a hundred is beyond 2.6 deviations on
        // either side. Student's t has a variance of 3.
        let own: Vec<f64> = noise
            .iter()
            .map(|sigma| {
                how.factor * sigma * (0.3 * rng.sample::<f64, _>(StandardNormal)).exp() / 3f64.sqrt()
            })
            .collect();
        for row in readings.chunks_mut(noise.len()) {
            for (value, sigma) in row.iter_mut().zip(&own) {
                let mut normal = || rng.sample::<f64, _>(StandardNormal);
                let square = (0..3).map(|_| normal().powi(2)).sum::<f64>() / 3.0;
                *value += sigma * normal() / square.max(1e-6).sqrt();
            }
        }
        return;
    }
    for row in readings.chunks_mut(noise.len()) {
        for (value, sigma) in row.iter_mut().zip(noise) {
            *value += how.factor * sigma * rng.sample::<f64, _>(StandardNormal);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_is_as_wide_at_any_speed() {
        let loop_of = |frames: usize| -> f64 {
            let up = (0..=frames).map(|i| 1000.0 * i as f64 / frames as f64);
            let mut readings: Vec<f64> = up.clone().chain(up.rev()).collect();
            bouc_wen(1, 0.1, &mut readings);
            readings[frames / 2] - readings[frames + 1 + frames / 2]
        };
        let (slow, fast) = (loop_of(2000), loop_of(50));
        assert!(slow < -50.0, "loading reads less than unloading: {slow}");
        approx::assert_relative_eq!(slow, fast, max_relative = 0.05);
    }

    #[test]
    fn softening_starts_with_the_first_unloading() {
        let mut readings: Vec<f64> = [0.0, 50.0, 100.0, 50.0, 0.0, 50.0, 100.0].to_vec();
        softening(1, 0.3, &mut readings);
        assert_eq!((readings[1], readings[2]), (50.0, 100.0));
        assert!(readings[3] < 45.0 && readings[5] == readings[3] && readings[6] == 100.0, "{readings:?}");
    }
}
