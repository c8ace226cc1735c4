//! How long a diagnosis of many contacts on many channels takes, and what memory. No skin of so many channels has a model yet: this
//! one is analytic, with effects of every kind (drawn by device, by channel, of several numbers, remembering, drifting).

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use clap::Args;
use dermis_gap::{FrameLabel, Memory, Phase, Recording, Simulator, diagnose};
use dermis_model::{DeviceState, ForwardModel, Indentation, Stepped, Stimulus};
use dermis_skin::{Effect, EffectInfo, ModelError, ParameterInfo, SkinDescription, Surface};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde_json::{Value, json};

/// \[s\] between frames.
const FRAME: f64 = 0.02;
/// \[m\] between taxels, and deviation of the footprint.
const PITCH: f64 = 0.01;
const WIDTH: f64 = 0.006;
/// Reading of a taxel under 1 N, in deviations of the noise.
const SENSITIVITY: f64 = 400.0;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Contacts; one in ten is done again.
    #[arg(long, default_value_t = 10_000)]
    contacts: u64,
    /// Taxels along each side of the fabric.
    #[arg(long, default_value_t = 28)]
    side: usize,
}

const fn number(
    name: &'static str,
    unit: &'static str,
    typical: f64,
    range: [f64; 2],
    limits: [f64; 2],
) -> ParameterInfo {
    ParameterInfo::new(name, unit, "a number of the analytic fabric", typical, range, limits)
}

const fn effect(
    name: &'static str,
    what: &'static str,
    parameters: &'static [ParameterInfo],
    [stateful, random]: [bool; 2],
) -> EffectInfo {
    EffectInfo { name, what, source: "analytic", parameters, stateful, random }
}

const EFFECTS: &[EffectInfo] = &[
    effect(
        "gains",
        "Each taxel reads by a factor of its own.",
        &[number("spread", "1", 0.1, [0.02, 0.2], [0.0, 0.9])],
        [false, true],
    ),
    effect(
        "misplacement",
        "Taxels lie elsewhere.",
        &[number("by", "m", 5e-4, [1e-4, 1e-3], [0.0, 4e-3])],
        [false, true],
    ),
    effect(
        "footprint",
        "Footprints are wider.",
        &[number("change", "1", 0.1, [-0.15, 0.2], [-0.5, 1.0])],
        [false, false],
    ),
    effect(
        "stiffening",
        "Strong presses read too much.",
        &[number("rise", "1/N", 0.2, [-0.2, 0.3], [-0.9, 3.0])],
        [false, false],
    ),
    effect(
        "ceiling",
        "Readings level off.",
        &[number("level", "1", 500.0, [300.0, 2000.0], [50.0, 1e6])],
        [false, false],
    ),
    effect(
        "slope",
        "The sensitivity goes over the fabric from side to side.",
        &[number("x", "1", 0.1, [-0.2, 0.2], [-0.9, 0.9]), number("y", "1", 0.0, [-0.2, 0.2], [-0.9, 0.9])],
        [false, false],
    ),
    effect(
        "creep",
        "What is held fades.",
        &[
            number("share", "1", 0.1, [0.02, 0.3], [0.0, 0.9]),
            number("time", "s", 0.3, [0.05, 2.0], [1e-2, 1e3]),
        ],
        [true, false],
    ),
    effect(
        "weather",
        "All read what the air does.",
        &[number("deviation", "1", 10.0, [1.0, 30.0], [0.0, 1e5])],
        [true, true],
    ),
];

/// The factor that the effect `gains` draws for a taxel.
fn drawn_gain(effect: &Effect, taxel: usize) -> f64 {
    let spread = effect.strength * EFFECTS[0].value(effect, "spread");
    1.0 + spread * stream(effect, taxel).random_range(-1.0..=1.0)
}

fn stream(effect: &Effect, taxel: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(effect.seed.unwrap_or(0));
    rng.set_stream(1 + taxel as u64);
    rng
}

/// Gaussian footprints.
struct Fabric {
    surface: Surface,
    taxels: Vec<Point3<f64>>,
    gains: Vec<f64>,
    width: f64,
    rise: f64,
    ceiling: f64,
    noise: Vec<f64>,
    way: Way,
}

#[derive(Clone, Default)]
struct Way {
    creep: Option<(f64, f64)>,
    weather: Option<(f64, ChaCha8Rng, f64)>,
    state: Vec<f64>,
    last: Option<f64>,
}

impl Fabric {
    fn make(skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, String> {
        Effect::check(&skin.effects, EFFECTS, &skin.name).map_err(|e| e.to_string())?;
        let taxels: Vec<Point3<f64>> = skin.taxels.iter().map(dermis_skin::Taxel::point).collect();
        let width = skin.medium.get("width").and_then(toml::Value::as_float).unwrap_or(WIDTH);
        let mut fabric = Self {
            surface: skin.surface(),
            gains: vec![1.0; taxels.len()],
            width,
            rise: 0.0,
            ceiling: f64::INFINITY,
            noise: skin.channel_noise(),
            way: Way { state: vec![0.0; taxels.len()], ..Way::default() },
            taxels,
        };
        for effect in skin.effects.iter().filter(|e| e.strength > 0.0) {
            let info = EFFECTS.iter().find(|i| i.name == effect.name).ok_or("unknown effect")?;
            let plain = |name: &str| info.value(effect, name);
            let value = |name: &str| effect.strength * plain(name);
            match info.name {
                "gains" => {
                    for (t, gain) in fabric.gains.iter_mut().enumerate() {
                        *gain *= drawn_gain(effect, t);
                    }
                }
                "misplacement" => {
                    for (t, place) in fabric.taxels.iter_mut().enumerate() {
                        let mut rng = stream(effect, t);
                        place.x += value("by") * rng.random_range(-1.0..=1.0);
                        place.y += value("by") * rng.random_range(-1.0..=1.0);
                    }
                }
                "footprint" => fabric.width *= 1.0 + value("change"),
                "stiffening" => fabric.rise = value("rise"),
                "ceiling" => fabric.ceiling = plain("level") / effect.strength,
                "slope" => {
                    let half = fabric.taxels.iter().map(|t| t.x.abs().max(t.y.abs())).fold(1e-9, f64::max);
                    for (gain, t) in fabric.gains.iter_mut().zip(&fabric.taxels) {
                        *gain *= 1.0 + (value("x") * t.x + value("y") * t.y) / half;
                    }
                }
                "creep" => fabric.way.creep = Some((value("share"), plain("time"))),
                _ => fabric.way.weather = Some((value("deviation"), stream(effect, 0), f64::NAN)),
            }
        }
        Ok(Arc::new(fabric))
    }
}

impl ForwardModel for Fabric {
    fn channels(&self) -> usize {
        self.taxels.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for (i, c) in stimulus.contacts.iter().enumerate() {
            c.check(i, &self.surface)?;
            let force = -c.force.z * (1.0 + self.rise * -c.force.z);
            // A wide tip has a wide footprint.
            let square = self.width.powi(2) + c.diameter().powi(2) / 16.0;
            for ((o, t), gain) in out.iter_mut().zip(&self.taxels).zip(&self.gains) {
                let q = (c.position - t).xy().norm_squared() / (2.0 * square);
                if q < 30.0 {
                    *o += gain * SENSITIVITY * force * (-q).exp();
                }
            }
        }
        if self.ceiling.is_finite() {
            out.iter_mut().for_each(|o| *o = self.ceiling * (*o / self.ceiling).tanh());
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    fn start(&self, _: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, self.way.clone()))
    }
}

impl dermis_model::Memory for Way {
    fn apply_transducer(&mut self, time: f64, _: &Stimulus, readings: &mut [f64]) {
        let dt = time - self.last.unwrap_or(time);
        self.last = Some(time);
        if let Some((share, tau)) = self.creep {
            let part = -(-dt / tau).exp_m1();
            for (r, s) in readings.iter_mut().zip(&mut self.state) {
                *s += (*r - *s) * part;
                *r -= share * *s;
            }
        }
        if let Some((deviation, rng, value)) = &mut self.weather {
            let draw: f64 = rng.sample(StandardNormal);
            *value = if value.is_nan() { draw } else { *value + draw * (2.0 * dt / 600.0).sqrt() };
            readings.iter_mut().for_each(|r| *r += *deviation * *value);
        }
    }
}

fn fabric(side: usize) -> Result<SkinDescription> {
    let half = 0.5 * PITCH * (side as f64 - 1.0);
    let size = PITCH * side as f64;
    let mut text = format!(
        r#"
        schema = "dermis-skin/1"
        name = "fabric"
        sensor = "fabric"
        frame_id = "fabric_link"
        unit = "1"
        rate = {:.1}
        noise = 1.0
        surface = {{ type = "rectangle", size = [{size:?}, {size:?}], spacing = {PITCH:?} }}
        taxels = [
        "#,
        1.0 / FRAME
    );
    for i in 0..side {
        for j in 0..side {
            let (x, y) = (PITCH * i as f64 - half, PITCH * j as f64 - half);
            let _ = writeln!(text, "{{ name = \"t{i}x{j}\", position = [{x:?}, {y:?}, -0.001] }},");
        }
    }
    let _ = writeln!(text, "]\n[medium]\nwidth = {WIDTH:?}");
    Ok(SkinDescription::from_toml(&text, "fabric")?)
}

/// Presses at random locations of a device with these effects: load, hold, unload, rest.
fn recorded(skin: &SkinDescription, effects: Vec<Effect>, contacts: u64) -> Result<Recording> {
    let mut device = skin.clone();
    device.effects = effects;
    let real = Fabric::make(&device).map_err(|e| anyhow!(e))?;
    let channels = real.channels();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut recording = Recording::new("fabric", channels);
    recording.sessions.push("one".to_owned());
    let reach = 0.5 * PITCH * ((channels as f64).sqrt() - 1.0);
    let mut read = vec![0.0; channels];
    let mut values = vec![0.0f32; channels];
    let mut state = real.start(0);
    let (mut time, mut press, mut location) = (0.0, 0u64, 0u32);
    let mut frame = |phase: Phase,
                     touch: Option<(Point3<f64>, f64)>,
                     [press, location]: [u64; 2],
                     rng: &mut ChaCha8Rng|
     -> Result<()> {
        let contacts = touch
            .filter(|t| t.1 > 0.0)
            .map(|(position, force)| Indentation::sphere(position, Vector3::new(0.0, 0.0, -force), 0.004));
        let temperature = 293.15 + 4.0 * (time / 600.0f64).sin();
        let stimulus =
            Stimulus { contacts: contacts.into_iter().collect(), temperature, ..Stimulus::default() };
        state.step(time, &stimulus, &mut read)?;
        for (v, r) in values.iter_mut().zip(&read) {
            *v = (r + rng.sample::<f64, _>(StandardNormal)) as f32;
        }
        let location = u32::try_from(location)?;
        let stimulus = Some(stimulus);
        recording.push(FrameLabel { time, run: 0, press, location, phase, stimulus, temperature }, &values);
        time += FRAME;
        Ok(())
    };
    let origin = Point3::origin();
    while press < contacts {
        if location % 500 == 0 {
            for _ in 0..80 {
                frame(Phase::Idle, None, [press, 0], &mut rng)?;
            }
        }
        location += 1;
        let mut within = || rng.random_range(-reach..reach);
        let at = origin + Vector3::new(within(), within(), 0.0);
        let force = rng.random_range(0.1..1.0);
        let times = if location % 10 == 0 { 2 } else { 1 };
        for _ in 0..times {
            press += 1;
            let of = [press, u64::from(location)];
            for (phase, share) in [
                (Phase::Load, 0.4),
                (Phase::Load, 0.8),
                (Phase::Hold, 1.0),
                (Phase::Hold, 1.0),
                (Phase::Hold, 1.0),
                (Phase::Hold, 1.0),
                (Phase::Unload, 0.5),
                (Phase::Approach, 0.0),
                (Phase::Approach, 0.0),
            ] {
                frame(phase, Some((at, share * force)), of, &mut rng)?;
            }
        }
    }
    Ok(recording)
}

/// Measures.
///
/// # Errors
///
/// Where the diagnosis fails.
pub fn run(options: &Options) -> Result<Value> {
    let skin = fabric(options.side)?;
    let effects =
        vec![Effect::new("gains").with("spread", 0.4).seed(5), Effect::new("creep").with("time", 0.2)];
    let recording = recorded(&skin, effects.clone(), options.contacts)?;
    let make = |skin: &SkinDescription| Fabric::make(skin);
    let simulator = Simulator { skin: &skin, effects: EFFECTS, make: &make };
    let kept = tempfile::tempdir()?;
    let how = dermis_gap::Options { cache: Some(kept.path().to_owned()), ..dermis_gap::Options::default() };
    let begun = Instant::now();
    diagnose(&simulator, &recording, &how, &Memory::default())?;
    let first = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let found = diagnose(&simulator, &recording, &how, &Memory::default())?;
    let seconds = begun.elapsed().as_secs_f64();
    let report = found.report;
    // How well the gain of every channel is estimated: against what the device was given.
    let truth: Vec<f64> = (0..recording.channels).map(|t| drawn_gain(&effects[0], t)).collect();
    let channel_gains = found.corrected.effects.iter().find(|e| e.name == "channel-gain");
    let errors: Option<Vec<f64>> = channel_gains.map(|channel_gains| {
        let of = |t: &dermis_skin::Taxel| channel_gains.parameters.get(&t.name).copied().unwrap_or(1.0);
        let mut errors: Vec<f64> =
            skin.taxels.iter().zip(&truth).map(|(t, truth)| (of(t) - truth).abs()).collect();
        errors.sort_by(f64::total_cmp);
        errors
    });
    let status = std::fs::read_to_string("/proc/self/status").context("/proc is not there")?;
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let peak = peak.and_then(|p| p.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()).unwrap_or(f64::NAN);
    Ok(json!({
        "contacts": options.contacts,
        "channels": recording.channels,
        "frames": recording.labels.len(),
        "rows": report.data.samples,
        "first_s": first,
        "signatures_s": seconds_of_signatures(first, seconds),
        "seconds": seconds,
        "peak_gib": peak / 1024.0 / 1024.0,
        "named": report.effects.iter().map(|e| e.label.as_str()).collect::<Vec<_>>(),
        "channels_with_a_gain": channel_gains.map_or(0, |t| t.parameters.len()),
        "gain_error_median": errors.as_ref().map(|e| e[e.len() / 2]),
        "gain_error_90": errors.as_ref().map(|e| e[e.len() * 9 / 10]),
        "sentence": report.sentence,
        "warnings": report.warnings,
    }))
}

/// What the first diagnosis took longer.
fn seconds_of_signatures(first: f64, after: f64) -> f64 {
    (first - after).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_true_gains_are_those_of_the_device() {
        let mut skin = fabric(4).unwrap();
        let gains = Effect::new("gains").with("spread", 0.4).seed(5);
        let plain = Fabric::make(&skin).unwrap();
        skin.effects = vec![gains.clone()];
        let device = Fabric::make(&skin).unwrap();
        let contact = Indentation::sphere(Point3::origin(), Vector3::new(0.0, 0.0, -1.0), 0.004);
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        let [mut as_designed, mut read] = [vec![0.0; 16], vec![0.0; 16]];
        plain.response(&stimulus, &mut as_designed).unwrap();
        device.response(&stimulus, &mut read).unwrap();
        let largest = (0..16).map(|t| (drawn_gain(&gains, t) - 1.0).abs()).fold(0.0, f64::max);
        assert!(largest > 0.2 && largest <= 0.4, "{largest}");
        for (t, (read, designed)) in read.iter().zip(&as_designed).enumerate() {
            assert!((read - drawn_gain(&gains, t) * designed).abs() < 1e-9, "taxel {t}");
        }
    }
}
