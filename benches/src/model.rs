//! How fast the forward model samples, noise included, against numpy and scipy on the same table.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Barrier};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_skin::{ForwardModel, Indentation, SkinDescription, Stimulus};
use dermis_testbed::Sampler;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// Stimuli that are sampled again and again.
const STIMULI: usize = 2048;
/// \[N\] pressing forces.
const FORCES: std::ops::Range<f64> = 0.02..1.5;
/// \[m\] of the tip.
const DIAMETER: f64 = 0.004;
/// Samples between two looks at the clock.
const BATCH: usize = 256;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Python with numpy and scipy; leaves the peer out where absent.
    #[arg(long)]
    peer_python: Option<PathBuf>,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// Skin description: taxels at one depth under a rectangle.
    #[arg(long, default_value = "launch/skins/baro-grid.toml")]
    skin: PathBuf,
    /// \[s\] of each measurement.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Threads of ours, processes of the peer.
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

/// Measures ours and the peer's, one after the other.
///
/// # Errors
///
/// Where the skin has no flat model, or the peer fails or disagrees.
pub fn run(options: &Options) -> Result<Value> {
    let skin = SkinDescription::load(options.root.join(&options.skin))?;
    let model = dermis_barodome::model(&skin)?;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let normal: Vec<Stimulus> = (0..STIMULI).map(|_| stimulus(model.as_ref(), &mut rng, 0.0, 1)).collect();
    let sheared: Vec<Stimulus> = (0..STIMULI).map(|_| stimulus(model.as_ref(), &mut rng, 0.5, 1)).collect();
    let three: Vec<Stimulus> = (0..STIMULI).map(|_| stimulus(model.as_ref(), &mut rng, 0.0, 3)).collect();
    // Tables are made when a tip first presses.
    let begun = Instant::now();
    let clean: Vec<Vec<f64>> = normal.iter().map(|s| response(model.as_ref(), s)).collect::<Result<_>>()?;
    let set_up = begun.elapsed().as_secs_f64();

    let mut ours = serde_json::Map::new();
    for (name, stimuli) in [("normal", &normal), ("with_shear", &sheared), ("three_contacts", &three)] {
        let rate = sample(&model, &skin, stimuli, options)?;
        eprintln!(
            "{:<48} {:>8.3} million samples/s",
            format!("dermis, {}", name.replace('_', " ")),
            rate / 1e6
        );
        ours.insert(name.into(), json!(rate));
    }
    let rate = ours["normal"].as_f64().unwrap_or(f64::NAN);
    let mut result = json!({
        "skin": skin.name,
        "channels": model.channels(),
        "threads": options.threads,
        "set_up_s": set_up,
        "samples_per_s": ours,
    });
    if let Some(python) = &options.peer_python {
        let peers = peers(python, &skin, model.as_ref(), &normal, &clean, options)?;
        let best = peers.iter().filter_map(|p| p["samples_per_s"].as_f64()).fold(0.0, f64::max);
        for peer in &peers {
            eprintln!(
                "{:<48} {:>8.3} million samples/s, {:.3} % away from ours at most",
                peer["name"].as_str().unwrap_or_default(),
                peer["samples_per_s"].as_f64().unwrap_or(f64::NAN) / 1e6,
                peer["deviation"].as_f64().unwrap_or(f64::NAN) * 100.0
            );
        }
        eprintln!("{:<48} {:>8.1} times the fastest peer", "", rate / best);
        result["peers"] = json!(peers);
        result["ratio"] = json!(rate / best);
    }
    Ok(result)
}

/// Contacts somewhere on the surface, with up to `shear` of the normal force along it.
fn stimulus(model: &dyn ForwardModel, rng: &mut ChaCha8Rng, shear: f64, contacts: usize) -> Stimulus {
    let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
    let mut high = -low;
    for p in &model.surface().points {
        (low, high) = (low.inf(p), high.sup(p));
    }
    let contacts = (0..contacts)
        .map(|_| {
            let force = rng.random_range(FORCES);
            let along = |rng: &mut ChaCha8Rng| (rng.random::<f64>() - 0.5) * 2.0 * shear * force;
            Indentation {
                position: Point3::new(rng.random_range(low.x..high.x), rng.random_range(low.y..high.y), 0.0),
                force: Vector3::new(along(rng), along(rng), -force),
                diameter: DIAMETER,
            }
        })
        .collect();
    Stimulus { contacts, ..Stimulus::default() }
}

fn response(model: &dyn ForwardModel, stimulus: &Stimulus) -> Result<Vec<f64>> {
    let mut out = vec![0.0; model.channels()];
    model.response(stimulus, &mut out)?;
    Ok(out)
}

/// Samples per second of all threads: response, noise, range.
fn sample(
    model: &Arc<dyn ForwardModel>,
    skin: &SkinDescription,
    stimuli: &[Stimulus],
    options: &Options,
) -> Result<f64> {
    let duration = Duration::from_secs_f64(options.seconds);
    let barrier = Barrier::new(options.threads);
    let rates = std::thread::scope(|scope| {
        let work = |seed: usize| {
            let (barrier, model) = (&barrier, Arc::clone(model));
            move || -> Result<f64> {
                let sampler = Sampler::new(model, skin, seed as u64);
                barrier.wait();
                let mut sampler = sampler?;
                let (mut values, mut flags, mut count, mut sum) = (Vec::new(), Vec::new(), 0, 0.0f32);
                let begun = Instant::now();
                let mut batches = stimuli.chunks(BATCH).cycle();
                while begun.elapsed() < duration {
                    let Some(batch) = batches.next() else { bail!("there is nothing to sample") };
                    for stimulus in batch {
                        sampler.sample(stimulus, &mut values, &mut flags)?;
                        sum += values[0];
                    }
                    count += batch.len();
                }
                std::hint::black_box(sum);
                Ok(count as f64 / begun.elapsed().as_secs_f64())
            }
        };
        let threads: Vec<_> = (0..options.threads).map(|seed| scope.spawn(work(seed))).collect();
        threads
            .into_iter()
            .map(|t| t.join().unwrap_or_else(|_| bail!("a thread broke off")))
            .collect::<Result<Vec<f64>>>()
    })?;
    Ok(rates.iter().sum())
}

/// \[Pa/N\] of a taxel over the cube root of the force (rows) and the distance (columns), as our model reads it.
fn table(model: &dyn ForwardModel, channel: usize, taxel: [f64; 2], rows: usize, step: f64) -> Result<Value> {
    let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
    let mut high = -low;
    for p in &model.surface().points {
        (low, high) = (low.inf(p), high.sup(p));
    }
    // Along the diagonal away from the taxel, as far as the surface goes.
    let (dx, dy) = (high.x - taxel[0], high.y - taxel[1]);
    let reach = dx.hypot(dy);
    let columns = (reach / step).floor() as usize + 1;
    let root_step = FORCES.end.cbrt() / (rows - 2) as f64;
    let mut values = Vec::with_capacity(rows * columns);
    for row in 0..rows {
        let force = (root_step * row as f64).powi(3).max(1e-9);
        for column in 0..columns {
            let along = step * column as f64 / reach;
            let contact = Indentation {
                position: Point3::new(taxel[0] + along * dx, taxel[1] + along * dy, 0.0),
                force: Vector3::new(0.0, 0.0, -force),
                diameter: DIAMETER,
            };
            let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
            values.push(response(model, &stimulus)?[channel] / force);
        }
    }
    Ok(json!({ "rows": rows, "root_step": root_step, "step": step, "values": values }))
}

/// What the peer makes of the same tables and stimuli.
fn peers(
    python: &Path,
    skin: &SkinDescription,
    model: &dyn ForwardModel,
    stimuli: &[Stimulus],
    clean: &[Vec<f64>],
    options: &Options,
) -> Result<Vec<Value>> {
    let taxels: Vec<[f64; 2]> = skin
        .channel_taxels()
        .into_iter()
        .map(|t| [skin.taxels[t].position[0], skin.taxels[t].position[1]])
        .collect();
    // The taxel in the corner sees the longest way across the surface, and with it every distance there is.
    let Some((corner, &place)) =
        taxels.iter().enumerate().min_by(|a, b| (a.1[0] + a.1[1]).total_cmp(&(b.1[0] + b.1[1])))
    else {
        bail!("skin `{}` has no taxels", skin.name);
    };
    let contacts: Vec<[f64; 3]> =
        stimuli.iter().flat_map(|s| &s.contacts).map(|c| [c.position.x, c.position.y, -c.force.z]).collect();
    let depth = -skin.taxels[0].position[2];
    let data = json!({
        "table": table(model, corner, place, 48, depth / 20.0)?,
        "fine": table(model, corner, place, 96, depth / 80.0)?,
        "taxels": taxels,
        "contacts": contacts,
        "clean": clean,
        "noise": model.noise()[0],
        "range": skin.channels()[0].range.unwrap_or([f64::MIN, f64::MAX]),
    });
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("data.json");
    std::fs::write(&file, data.to_string())?;
    let out = Command::new(python)
        .arg(options.root.join("benches/python/table_peer.py"))
        .arg(&file)
        .args([options.seconds.to_string(), options.threads.to_string()])
        .output()
        .with_context(|| format!("{} cannot be started", python.display()))?;
    if !out.status.success() {
        bail!("the peer failed: {}", String::from_utf8_lossy(&out.stderr));
    }
    let peers: Vec<Value> = serde_json::from_slice(&out.stdout).context("the peer printed something else")?;
    for peer in &peers {
        // A peer that computes something else is none.
        if peer["deviation"].as_f64().is_none_or(|d| d > 1e-3) {
            bail!("the peer's readings are not ours: {peer}");
        }
    }
    Ok(peers)
}
