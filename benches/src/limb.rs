//! The node of the limb at its own rate, with one and with two contacts: how long an answer takes, how many frames get none because
//! a search took longer than frames come, and what all of that costs.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_msgs::msg::ContactArray;
use dermis_skin::SkinDescription;
use dermis_transport::framing::NativeFormat;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde_json::{Value, json};

use crate::device::Device;
use crate::machine::cpu_time;
use crate::node::{PATIENCE, Pace, number, percentile};
use crate::subscriber::{Arrival, Choice, spawn, start};

/// Scenes that are played, each with contacts of its own.
const SCENES: usize = 24;
/// Frames of a scene: pressed harder and harder, held, let go, untouched.
const RISE: usize = 200;
const HOLD: usize = 1000;
const FALL: usize = 200;
const REST: usize = 200;
/// \[N\] of the contacts that are held.
const FORCES: [f64; 2] = [4.0, 34.0];
/// \[m\] that two contacts are apart at least, and from the clamps.
const APART: f64 = 0.030;
const CLAMP: f64 = 0.020;
/// \[m\] of the tips.
const DIAMETER: f64 = 0.010;
/// Gains of a device that differs from its model, by channel: mean and standard deviation, `gauge-gain` of launch/effects/hapdef-default.toml.
const GAINS: [f64; 2] = [0.95, 0.08];

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Folder of our programs.
    #[arg(long)]
    programs: PathBuf,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// \[s\] that each bundle is measured for.
    #[arg(long, default_value_t = 40.0)]
    seconds: f64,
    /// \[Hz\] of the frames.
    #[arg(long, default_value_t = 1000.0)]
    rate: f64,
}

/// Measures the bundle for one contact with one, on a device as designed and on one that differs, and that for two with one, and with two on
/// either.
///
/// # Errors
///
/// Where a node does not come up.
pub fn run(options: &Options) -> Result<Value> {
    let skin = SkinDescription::load(options.root.join("launch/skins/hapdef-shin.toml"))?;
    let model = dermis_hapdef::model(&skin)?;
    let mut rows = Vec::new();
    let cases = [
        ("hapdef-shin", 1, false),
        ("hapdef-shin", 1, true),
        ("hapdef-shin-two", 1, false),
        ("hapdef-shin-two", 2, false),
        ("hapdef-shin-two", 2, true),
    ];
    for (n, (bundle, contacts, differs)) in cases.into_iter().enumerate() {
        let name = format!("{bundle}, {contacts} pressing{}", if differs { ", differs" } else { "" });
        eprintln!("measuring {name}");
        let device = device(&skin, model.as_ref(), contacts, differs)?;
        let domain = 20 + (std::process::id() % 10) as u16 * 4 + n as u16;
        let mut row = measure(options, device, &options.root.join("models").join(bundle), domain)
            .with_context(|| name.clone())?;
        (row["name"], row["pressing"]) = (json!(name), json!(contacts));
        row["gains"] = json!(differs.then_some(GAINS));
        rows.push(row);
    }
    table(&rows, options.rate);
    Ok(json!({
        "rate_hz": options.rate, "seconds": options.seconds,
        "one": rows[0], "one_differs": rows[1], "two_bundle_one_pressing": rows[2], "two": rows[3],
        "two_differs": rows[4],
    }))
}

/// Scenes of so many contacts each, that begin and end together; the device has gains of its own where it `differs`.
fn device(
    skin: &SkinDescription,
    model: &dyn ForwardModel,
    contacts: usize,
    differs: bool,
) -> Result<Device> {
    let mut random = ChaCha8Rng::seed_from_u64(40 + contacts as u64);
    let surface = model.surface();
    let most = surface.points.iter().map(|p| p.x.abs()).fold(0.0, f64::max);
    let free: Vec<usize> =
        (0..surface.points.len()).filter(|i| surface.points[*i].x.abs() < most - CLAMP).collect();
    let mut rest = vec![0.0; model.channels()];
    model.response(&Stimulus::default(), &mut rest)?;
    let [mean, spread] = GAINS;
    let mut gain = || if differs { mean + spread * random.sample::<f64, _>(StandardNormal) } else { 1.0 };
    let gains: Vec<f64> = rest.iter().map(|_| gain()).collect();
    let mut touched = Vec::new();
    for _ in 0..SCENES {
        let mut at: Vec<usize> = Vec::new();
        while at.len() < contacts {
            let next = free[random.random_range(0..free.len())];
            if at.iter().all(|i| (surface.points[*i] - surface.points[next]).norm() >= APART) {
                at.push(next);
            }
        }
        let held: Vec<Indentation> = at
            .iter()
            .map(|i| {
                Indentation::sphere(
                    surface.points[*i],
                    -surface.normals[*i] * random.random_range(FORCES[0]..FORCES[1]),
                    DIAMETER,
                )
            })
            .collect();
        let mut pressed = vec![0.0; model.channels()];
        model.response(&Stimulus { contacts: held, ..Stimulus::default() }, &mut pressed)?;
        for ((pressed, rest), gain) in pressed.iter_mut().zip(&rest).zip(&gains) {
            *pressed = rest + gain * (*pressed - rest);
        }
        let share = |k: usize| match k {
            k if k < RISE => k as f64 / RISE as f64,
            k if k < RISE + HOLD => 1.0,
            k if k < RISE + HOLD + FALL => 1.0 - (k - RISE - HOLD) as f64 / FALL as f64,
            _ => 0.0,
        };
        for k in 0..RISE + HOLD + FALL + REST {
            touched.push(counts(skin, &rest, &pressed, share(k), &mut random));
        }
    }
    let untouched = (0..1000).map(|_| counts(skin, &rest, &rest, 0.0, &mut random)).collect();
    Device::playing(NativeFormat::U16, untouched, touched)
}

/// One frame as the converter gives it.
fn counts(
    skin: &SkinDescription,
    rest: &[f64],
    pressed: &[f64],
    share: f64,
    random: &mut ChaCha8Rng,
) -> Vec<f32> {
    let [low, high] = skin.wire.counts.unwrap_or([0, u32::from(u16::MAX)]);
    let noise = skin.channel_noise();
    let channels = rest.iter().zip(pressed).zip(noise);
    let read = channels.map(|((rest, pressed), noise)| {
        let value = rest + share * (pressed - rest) + noise * random.sample::<f64, _>(StandardNormal);
        ((value - skin.wire.offset) / skin.wire.scale).round().clamp(f64::from(low), f64::from(high)) as f32
    });
    read.collect()
}

fn measure(options: &Options, mut device: Device, model: &Path, domain: u16) -> Result<Value> {
    let (subscriber, arrivals) = start(Choice::Hiroz, domain)?;
    let mut command = Command::new(options.programs.join("dermis"));
    command.arg("hapdef").arg("--skin").arg(options.root.join("launch/skins/hapdef-shin.toml"));
    command.arg("--model").arg(model).arg("--source").arg(format!("serial://{}", device.path()));
    command.args(["--backend", "hiroz", "--strict"]).env("DERMIS_LOG", "error");
    let node = spawn(&mut command, domain)?;
    let begun = Instant::now();
    let mut pace = Pace::new(options.rate);
    while !arrivals.try_iter().any(|a| a.status == ContactArray::STATUS_OK) {
        device.send(false)?;
        pace.wait();
        if begun.elapsed() > PATIENCE {
            bail!("no calibrated frame came within {} s", PATIENCE.as_secs());
        }
    }
    let first = device.sent.len() as u64;
    let (cpu, begun) = (cpu_time(&node.0)?, Instant::now());
    let end = begun + Duration::from_secs_f64(options.seconds);
    let mut seen: Vec<Arrival> = Vec::new();
    while Instant::now() < end {
        device.send(true)?;
        pace.wait();
        seen.extend(arrivals.try_iter());
    }
    let used = (cpu_time(&node.0)? - cpu).as_secs_f64() / begun.elapsed().as_secs_f64();
    let frames = device.sent.len() as u64 - first;
    let rate = frames as f64 / begun.elapsed().as_secs_f64();
    // The last ones are still on their way.
    while let Ok(arrival) = arrivals.recv_timeout(Duration::from_millis(500)) {
        seen.push(arrival);
    }
    drop((node, subscriber));
    seen.retain(|a| (first..first + frames).contains(&a.sequence));
    // A node that hears nothing more says so with the last frame's number.
    seen.sort_by_key(|a| (a.sequence, a.received_ns));
    seen.dedup_by_key(|a| a.sequence);
    Ok(summary(&seen, &device.sent, frames, rate, used))
}

/// Latency of all that was answered, and of what holds contacts. `seen` is in the order of its frames, one of each.
pub fn summary(seen: &[Arrival], sent: &[i64], frames: u64, rate: f64, cores: f64) -> Value {
    let latency = |of: &dyn Fn(&&Arrival) -> bool| {
        let took = |a: &Arrival| Some((a.received_ns - sent.get(a.sequence as usize)?) as f64 * 1e-6);
        let mut ms: Vec<f64> = seen.iter().filter(of).filter_map(took).collect();
        ms.sort_by(f64::total_cmp);
        json!({
            "p50_ms": percentile(&ms, 50.0), "p99_ms": percentile(&ms, 99.0), "max_ms": percentile(&ms, 100.0),
            "answers": ms.len(),
        })
    };
    let gap = seen.windows(2).map(|pair| pair[1].sequence - pair[0].sequence - 1).max();
    json!({
        "latency": latency(&|_| true),
        "latency_touched": latency(&|a| a.contacts > 0),
        "latency_two": latency(&|a| a.contacts == 2),
        "frames": frames,
        "sent_hz": rate,
        "dropped": frames.saturating_sub(seen.len() as u64) as f64 / frames.max(1) as f64,
        "dropped_in_a_row": gap,
        "cores": cores,
    })
}

/// Prints such summaries as a table.
pub fn table(rows: &[Value], rate: f64) {
    eprintln!(
        "\n{:<34} {:>8} {:>8} {:>9} {:>15} {:>15} {:>12} {:>7}",
        "bundle", "p50 ms", "p99 ms", "max ms", "touched p50 ms", "touched p99 ms", "dropped", "cores"
    );
    for row in rows {
        let (all, touched) = (&row["latency"], &row["latency_touched"]);
        eprintln!(
            "{:<34} {:>8} {:>8} {:>9} {:>15} {:>15} {:>10} % {:>7}",
            row["name"].as_str().unwrap_or(""),
            number(&all["p50_ms"], 3),
            number(&all["p99_ms"], 3),
            number(&all["max_ms"], 1),
            number(&touched["p50_ms"], 3),
            number(&touched["p99_ms"], 3),
            number(&json!(row["dropped"].as_f64().map(|v| v * 100.0)), 2),
            number(&row["cores"], 3),
        );
    }
    eprintln!(
        "\nAt {rate} Hz, from the last byte of a frame to the decoded message at a subscriber in another process."
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_without_an_answer_are_counted() {
        let arrival = |sequence: u64, contacts| Arrival {
            sequence,
            received_ns: sequence as i64 * 1_000_000 + 400_000,
            published_ns: 0,
            status: ContactArray::STATUS_OK,
            contacts,
        };
        let sent: Vec<i64> = (0..20).map(|k| k * 1_000_000).collect();
        let seen = [arrival(10, 0), arrival(11, 2), arrival(15, 2), arrival(16, 1)];
        let found = summary(&seen, &sent, 8, 1000.0, 0.2);
        assert_eq!((&found["dropped"], &found["dropped_in_a_row"]), (&json!(0.5), &json!(3)));
        let median = found["latency"]["p50_ms"].as_f64();
        assert!(median.is_some_and(|ms| (ms - 0.4).abs() < 1e-9), "{median:?} ms");
        assert_eq!(found["latency_touched"]["answers"], json!(3));
        assert_eq!(found["latency_two"]["answers"], json!(2));
    }
}
