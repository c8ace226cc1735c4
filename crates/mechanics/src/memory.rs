//! What devices remember, whatever they sense with, and the random numbers that tell one device from another.

use dermis_skin::{Effect, ParameterInfo};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// The random numbers of an effect on one channel (or taxel) of a device: a stream of its own, so that another effect, or another
/// channel, changes nothing of it.
#[must_use]
pub fn stream(effect: &Effect, index: usize) -> ChaCha8Rng {
    // FNV-1a: the name says which stream, not the place in a table that may grow.
    let name = effect.name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let mut rng = ChaCha8Rng::seed_from_u64(effect.seed.unwrap_or(0));
    rng.set_stream((name << 20) | index as u64);
    rng
}

/// Waves that make up a random field: many, so that it is close to Gaussian.
const WAVES: usize = 200;

/// A random field of an effect at `locations` \[m\]: normal, its correlation falling as exp(−d²/2ℓ²) with the distance d for the `length` ℓ
/// \[m\] (Rahimi and Recht's random waves, in space).
#[must_use]
pub fn random_field<const N: usize>(
    effect: &Effect,
    length: f64,
    locations: impl Iterator<Item = [f64; N]>,
) -> Vec<f64> {
    let mut rng = stream(effect, 0);
    let waves: Vec<([f64; N], f64)> = (0..WAVES)
        .map(|_| {
            let wave = [(); N].map(|()| rng.sample::<f64, _>(StandardNormal) / length);
            (wave, rng.random_range(0.0..std::f64::consts::TAU))
        })
        .collect();
    let scale = (2.0 / WAVES as f64).sqrt();
    let phase_at = |wave: &[f64; N], at: &[f64; N]| wave.iter().zip(at).map(|(k, x)| k * x).sum::<f64>();
    let value = |at: [f64; N]| {
        scale * waves.iter().map(|(wave, phase)| (phase_at(wave, &at) + phase).cos()).sum::<f64>()
    };
    locations.map(value).collect()
}

/// The random numbers of one time that a device is switched on: those of the device itself for `start` 0, others of the same stream
/// for any other.
fn restarted(rng: &ChaCha8Rng, start: u64) -> ChaCha8Rng {
    let mut seed = rng.get_seed();
    // The effect's seed fills the first bytes most: any place will do, as the cipher mixes all of it.
    for (byte, by) in seed[24..].iter_mut().zip(start.to_le_bytes()) {
        *byte ^= by;
    }
    let mut other = ChaCha8Rng::from_seed(seed);
    other.set_stream(rng.get_stream());
    other
}

/// Prony series of two terms on every channel: how much of each signal has faded. Each change of a signal is held by a term
/// and forgotten with its time. Exact where signals are linear between frames, however long the time between them.
#[derive(Debug, Clone)]
pub struct Prony {
    /// Share and time \[s\].
    terms: [(f64, f64); 2],
    /// What of each term has not faded yet.
    held: Vec<[f64; 2]>,
    before: Vec<f64>,
}

impl Prony {
    /// Untouched `channels` with the shares and times \[s\] of both terms.
    #[must_use]
    pub fn new(terms: [(f64, f64); 2], channels: usize) -> Self {
        Self { terms, held: vec![[0.0; 2]; channels], before: vec![0.0; channels] }
    }

    /// Sum over the terms of share times what has faded of the channel's signal, `dt` \[s\] after the last call for it.
    pub fn faded(&mut self, channel: usize, dt: f64, signal: f64) -> f64 {
        let change = signal - self.before[channel];
        self.before[channel] = signal;
        let mut faded = 0.0;
        for ((share, time), held) in self.terms.iter().zip(&mut self.held[channel]) {
            let steps = dt / time;
            // Mean of e^(-t/time) over the frame's time: what is left of a change that came evenly.
            let left = if steps > 0.0 { -(-steps).exp_m1() / steps } else { 1.0 };
            *held = *held * (-steps).exp() + change * left;
            faded += share * (signal - *held);
        }
        faded
    }
}

/// A slow random drift about zero: an Ornstein-Uhlenbeck process, exact for any time between frames.
#[derive(Debug, Clone)]
pub struct RandomDrift {
    deviation: f64,
    time: f64,
    /// In deviations.
    value: Option<f64>,
    rng: ChaCha8Rng,
}

impl RandomDrift {
    /// With this standard deviation, forgetting itself in `time` \[s\].
    #[must_use]
    pub fn new(deviation: f64, time: f64, rng: ChaCha8Rng) -> Self {
        Self { deviation, time, value: None, rng }
    }

    /// The same, as it drifts after another start.
    #[must_use]
    pub fn restarted(&self, start: u64) -> Self {
        Self { rng: restarted(&self.rng, start), ..self.clone() }
    }

    /// Where it is `dt` \[s\] after the last call.
    pub fn next(&mut self, dt: f64) -> f64 {
        let draw: f64 = self.rng.sample(StandardNormal);
        let value = match self.value {
            None => draw,
            Some(before) => {
                let steps = dt / self.time;
                before * (-steps).exp() + draw * (-(-2.0 * steps).exp_m1()).sqrt()
            }
        };
        self.value = Some(value);
        self.deviation * value
    }
}

/// A random walk that starts at 0 and does not come back: Wiener's process.
#[derive(Debug, Clone)]
pub struct RandomWalk {
    rate: f64,
    value: f64,
    rng: ChaCha8Rng,
}

impl RandomWalk {
    /// With the standard deviation `rate` after a second; it grows with the root of the time.
    #[must_use]
    pub fn new(rate: f64, rng: ChaCha8Rng) -> Self {
        Self { rate, value: 0.0, rng }
    }

    /// The same, as it goes after another start.
    #[must_use]
    pub fn restarted(&self, start: u64) -> Self {
        Self { rng: restarted(&self.rng, start), ..self.clone() }
    }

    /// Where it is `dt` \[s\] after the last call.
    pub fn next(&mut self, dt: f64) -> f64 {
        let draw: f64 = self.rng.sample(StandardNormal);
        self.value += self.rate * dt.sqrt() * draw;
        self.value
    }
}

/// Warmth of a device above what it was balanced at: its own, and that of the room.
#[derive(Debug, Clone)]
pub struct Warmth {
    self_heating: f64,
    heating_time: f64,
    room: RandomDrift,
}

impl Warmth {
    /// Parameter of an effect: the time constant of warming up. It is listed after `self_heating`, which its description refers to.
    pub const HEATING_TIME: ParameterInfo =
        ParameterInfo::new("heating_time", "s", "with which they do", 60.0, [10.0, 600.0], [1e-3, 1e6]);
    /// Parameter of an effect: how far the temperature of the room drifts.
    pub const ROOM: ParameterInfo = ParameterInfo::new(
        "room",
        "K",
        "standard deviation of the room's temperature",
        0.3,
        [0.0, 2.0],
        [0.0, 50.0],
    );
    /// Parameter of an effect: how fast it drifts. It is listed after [`ROOM`](Self::ROOM).
    pub const ROOM_TIME: ParameterInfo = ParameterInfo::new(
        "room_time",
        "s",
        "time constant of its random drift",
        600.0,
        [60.0, 7200.0],
        [1e-3, 1e8],
    );

    /// Of a device that warms up by the parameter `self_heating` \[K\] of an effect after it was switched on. `value` gives the values of that
    /// parameter and of the ones above.
    #[must_use]
    pub fn of(value: impl Fn(&str) -> f64, random: ChaCha8Rng) -> Self {
        Self {
            self_heating: value("self_heating"),
            heating_time: value(Self::HEATING_TIME.name),
            room: RandomDrift::new(value(Self::ROOM.name), value(Self::ROOM_TIME.name), random),
        }
    }

    /// The same, in a room whose temperature drifts as after another start.
    #[must_use]
    pub fn restarted(&self, start: u64) -> Self {
        Self { room: self.room.restarted(start), ..self.clone() }
    }

    /// \[K\] that it is warmer, `on` \[s\] after it was switched on and `dt` \[s\] after the last call.
    pub fn kelvin(&mut self, on: f64, dt: f64) -> f64 {
        self.self_heating * -(-on / self.heating_time).exp_m1() + self.room.next(dt)
    }
}
