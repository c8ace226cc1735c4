//! The node of the soft thumb at its camera's rate: pictures over the original wire, contacts found by the bundle that ships.
//!
//! The camera is this process: it answers each request with the next of some hundred pictures that were rendered and compressed before, forty
//! a second at most. So the node alone is measured: its reading, decoding, search and publishing.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_insight::model::ThumbModel;
use dermis_insight::wire::PictureWriter;
use dermis_model::{ForwardModel, Indentation, Stimulus, tangents};
use dermis_msgs::msg::ContactArray;
use dermis_sensor::Encoder;
use dermis_skin::{Frame, SkinDescription};
use dermis_transport::now_ns;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde_json::{Value, json};

use crate::limb::{summary, table};
use crate::machine::cpu_time;
use crate::node::{PATIENCE, Pace};
use crate::subscriber::{Arrival, Choice, domain_of, spawn, start};

const SKIN: &str = "launch/skins/insight-thumb.toml";
/// Presses that are played, and their pictures: pressed harder and harder, held, let go, untouched.
const PRESSES: usize = 24;
const PHASES: [usize; 4] = [6, 16, 6, 8];
/// Untouched pictures that come again and again before.
const UNTOUCHED: usize = 32;
/// \[N\] of the presses at their strongest, from light to strong alike in ratio; shear is up to half of that (thesis, section 6.4.6).
const FORCES: [f64; 2] = [0.1, 1.6];
/// \[m\] of the tips, and from the end of the elastomer.
const DIAMETER: f64 = 0.004;
const MARGIN: f64 = 0.004;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Folder of our programs.
    #[arg(long)]
    programs: PathBuf,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// \[s\] that one and two contacts are measured for.
    #[arg(long, default_value_t = 40.0)]
    seconds: f64,
    /// \[Hz\] of the camera.
    #[arg(long, default_value_t = 40.0)]
    rate: f64,
}

/// Measures presses of one ball, and of two at once.
///
/// # Errors
///
/// Where the thumb has no model, or its node does not come up.
pub fn run(options: &Options) -> Result<Value> {
    dermis_skin::register(dermis_insight::FAMILY);
    let model = ThumbModel::new(&SkinDescription::load(options.root.join(SKIN))?)?;
    let mut rows = Vec::new();
    for (n, contacts) in [1, 2].into_iter().enumerate() {
        eprintln!("measuring {contacts} pressing");
        let camera = Camera::new(pictures(&model, contacts)?, options.rate)?;
        let mut row = measure(options, &camera, domain_of(n))?;
        (row["name"], row["pressing"]) = (json!(format!("{contacts} pressing")), json!(contacts));
        rows.push(row);
    }
    table(&rows, options.rate);
    let size = model.parameters().camera.size;
    Ok(json!({
        "rate_hz": options.rate, "seconds": options.seconds, "size": size, "one": rows[0], "two": rows[1],
    }))
}

/// Untouched pictures, and presses, as the wire has them.
fn pictures(model: &ThumbModel, contacts: usize) -> Result<[Vec<Vec<u8>>; 2]> {
    let mut rng = ChaCha8Rng::seed_from_u64(70 + contacts as u64);
    let mut writer = PictureWriter::default();
    let mut take = |stimulus: &Stimulus, rng: &mut ChaCha8Rng| -> Result<Vec<u8>> {
        let image = model.capture(stimulus, &mut || rng.sample(StandardNormal))?;
        let mut frame = Frame::new(0, 0, Vec::new());
        frame.image = image;
        Ok(writer.encode(&frame, 0).map_err(anyhow::Error::msg)?.to_vec())
    };
    let untouched: Vec<_> =
        (0..UNTOUCHED).map(|_| take(&Stimulus::default(), &mut rng)).collect::<Result<_>>()?;
    let mut touched = Vec::new();
    for _ in 0..PRESSES {
        let held: Vec<Indentation> = apart(model, contacts, &mut rng);
        let [rise, hold, fall, rest] = PHASES;
        for k in 0..rise + hold + fall + rest {
            let share = match k {
                k if k < rise => (k + 1) as f64 / rise as f64,
                k if k < rise + hold => 1.0,
                k if k < rise + hold + fall => 1.0 - (k + 1 - rise - hold) as f64 / fall as f64,
                _ => 0.0,
            };
            let pressing = held.iter().map(|c| Indentation { force: c.force * share, ..c.clone() });
            let contacts = if share > 0.0 { pressing.collect() } else { Vec::new() };
            touched.push(take(&Stimulus { contacts, ..Stimulus::default() }, &mut rng)?);
        }
    }
    Ok([untouched, touched])
}

/// Balls that press at locations at least 15 mm apart.
fn apart(model: &ThumbModel, contacts: usize, rng: &mut ChaCha8Rng) -> Vec<Indentation> {
    let elastomer = &model.parameters().elastomer;
    let mut held: Vec<Indentation> = Vec::new();
    while held.len() < contacts {
        let s = (elastomer.end() - MARGIN) * rng.random_range(0.0..1.0f64).sqrt();
        let place = elastomer.thumb.point(s, rng.random_range(0.0..std::f64::consts::TAU), 0.0).0;
        let (position, normal) = model.surface().project(&place);
        if held.iter().any(|other| (other.position - position).norm() < 0.015) {
            continue;
        }
        let force = FORCES[0] * (FORCES[1] / FORCES[0]).powf(rng.random_range(0.0..1.0));
        let shear = tangents(&normal)[0] * (force * rng.random_range(-0.5..0.5));
        held.push(Indentation::sphere(position, shear - normal * force, DIAMETER));
    }
    held
}

/// A camera behind a port of this machine.
struct Camera {
    port: u16,
    state: Arc<State>,
}

/// What the camera's thread and the measurement share.
struct State {
    touched: AtomicBool,
    stop: AtomicBool,
    /// When each picture was handed over, ns since the epoch, by number.
    sent: Mutex<Vec<i64>>,
}

impl Camera {
    fn new([untouched, touched]: [Vec<Vec<u8>>; 2], rate: f64) -> Result<Self> {
        let listener = TcpListener::bind(("127.0.0.1", 0)).context("no port for the camera")?;
        let port = listener.local_addr()?.port();
        let state = Arc::new(State {
            touched: AtomicBool::new(false),
            stop: AtomicBool::new(false),
            sent: Mutex::default(),
        });
        let shared = Arc::clone(&state);
        std::thread::spawn(move || -> Result<()> {
            let (mut stream, _) = listener.accept()?;
            stream.set_nodelay(true)?;
            let (mut pace, mut request) = (Pace::new(rate), [0; 256]);
            let mut counts = [0, 0];
            while !shared.stop.load(Ordering::Relaxed) && stream.read(&mut request)? > 0 {
                pace.wait();
                let which = usize::from(shared.touched.load(Ordering::Relaxed));
                let pool = [&untouched, &touched][which];
                let picture = &pool[counts[which] % pool.len()];
                counts[which] += 1;
                shared.sent.lock().unwrap_or_else(PoisonError::into_inner).push(now_ns());
                stream.write_all(picture)?;
            }
            Ok(())
        });
        Ok(Self { port, state })
    }

    fn sent(&self) -> Vec<i64> {
        self.state.sent.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.state.stop.store(true, Ordering::Relaxed);
    }
}

fn measure(options: &Options, camera: &Camera, domain: u16) -> Result<Value> {
    let (subscriber, arrivals) = start(Choice::Hiroz, domain)?;
    let mut command = Command::new(options.programs.join("dermis"));
    command.arg("run").arg(options.root.join(SKIN));
    command.arg("--model").arg(options.root.join("models/insight-thumb"));
    command.arg("--source").arg(format!("tcp://127.0.0.1:{}", camera.port));
    command.args(["--backend", "hiroz", "--strict"]).env("DERMIS_LOG", "error");
    let node = spawn(&mut command, domain)?;
    let begun = Instant::now();
    while !arrivals.try_iter().any(|a| a.status == ContactArray::STATUS_OK) {
        std::thread::sleep(Duration::from_millis(20));
        // What the elastomer does is computed by the first node that a machine runs.
        if begun.elapsed() > 4 * PATIENCE {
            bail!("no calibrated frame came within {} s", (4 * PATIENCE).as_secs());
        }
    }
    camera.state.touched.store(true, Ordering::Relaxed);
    let first = camera.sent().len() as u64;
    let (cpu, begun) = (cpu_time(&node.0)?, Instant::now());
    let end = begun + Duration::from_secs_f64(options.seconds);
    let mut seen: Vec<Arrival> = Vec::new();
    while Instant::now() < end {
        std::thread::sleep(Duration::from_millis(20));
        seen.extend(arrivals.try_iter());
    }
    let elapsed = begun.elapsed().as_secs_f64();
    let used = (cpu_time(&node.0)? - cpu).as_secs_f64() / elapsed;
    let sent = camera.sent();
    let frames = sent.len() as u64 - first;
    // The last ones are still on their way; the camera goes on meanwhile.
    let end = Instant::now() + Duration::from_secs(3);
    while let Ok(arrival) = arrivals.recv_timeout(end.saturating_duration_since(Instant::now())) {
        if arrival.sequence >= first + frames {
            break;
        }
        seen.push(arrival);
    }
    drop((node, subscriber));
    seen.retain(|a| (first..first + frames).contains(&a.sequence));
    // A node that hears nothing more says so with the last frame's number.
    seen.sort_by_key(|a| (a.sequence, a.received_ns));
    seen.dedup_by_key(|a| a.sequence);
    let mut row = summary(&seen, &sent, frames, frames as f64 / elapsed, used);
    row["answered_hz"] = json!(seen.len() as f64 / elapsed);
    Ok(row)
}
