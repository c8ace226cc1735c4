//! How fast the forward model samples, noise included, against numpy and scipy on the same table.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::SkinDescription;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::peers;
use crate::sampling::sample;

/// Stimuli that are sampled again and again.
const STIMULI: usize = 2048;
/// \[N\] pressing forces.
const FORCES: std::ops::Range<f64> = 0.02..1.5;
/// \[m\] of the tip.
const DIAMETER: f64 = 0.004;

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
    // The peer looks up a layer without edges, and so does ours where the two are compared.
    let mut wide = skin.clone();
    wide.medium.insert("edge".into(), "wide".into());
    let layer = dermis_barodome::model(&wide)?;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut stimuli = |shear: f64, contacts: usize| -> Vec<Stimulus> {
        (0..STIMULI).map(|_| stimulus(model.as_ref(), &mut rng, shear, contacts)).collect()
    };
    let (normal, sheared, three) = (stimuli(0.0, 1), stimuli(0.5, 1), stimuli(0.0, 3));
    // Tables are made when a tip first presses.
    let begun = Instant::now();
    response(model.as_ref(), &normal[0])?;
    let set_up = begun.elapsed().as_secs_f64();
    let clean: Vec<Vec<f64>> = normal.iter().map(|s| response(layer.as_ref(), s)).collect::<Result<_>>()?;

    let show = |name: &str, [clock, cpu]: [f64; 2]| {
        eprintln!("{name:<48} {:>8.3} million samples/s, {:>8.3} by CPU time", clock / 1e6, cpu / 1e6);
    };
    let mut ours = serde_json::Map::new();
    for (name, model, stimuli) in [
        ("normal", &model, &normal),
        ("with_shear", &model, &sheared),
        ("three_contacts", &model, &three),
        ("without_edges", &layer, &normal),
    ] {
        let rates = sample(model.as_ref(), &skin, stimuli, false, options.seconds, options.threads)?;
        show(&format!("dermis, {}", name.replace('_', " ")), rates);
        ours.insert(name.into(), json!({ "samples_per_s": rates[0], "by_cpu_time": rates[1] }));
    }
    let mut result = json!({
        "skin": skin.name,
        "channels": model.channels(),
        "threads": options.threads,
        "set_up_s": set_up,
    });
    if let Some(python) = &options.peer_python {
        let peers = beside(python, &skin, layer.as_ref(), &normal, &clean, options)?;
        let number = |value: &Value, key: &str| value[key].as_f64().unwrap_or(f64::NAN);
        for peer in &peers {
            let name = peer["name"].as_str().unwrap_or_default();
            show(name, [number(peer, "samples_per_s"), number(peer, "by_cpu_time")]);
        }
        // By CPU time: what else runs on the machine meets both alike.
        let rate = number(&ours["without_edges"], "by_cpu_time");
        let best = peers.iter().map(|p| number(p, "by_cpu_time")).fold(f64::NAN, f64::max);
        let same = peers.first().map_or(f64::NAN, |p| number(p, "by_cpu_time"));
        eprintln!(
            "{:.1} times the same look-up, {:.1} times the fastest peer, by CPU time",
            rate / same,
            rate / best
        );
        result["peers"] = json!(peers);
        result["ratio"] = json!({ "same_lookup": rate / same, "fastest": rate / best });
    }
    result["ours"] = Value::Object(ours);
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
            Indentation::sphere(
                Point3::new(rng.random_range(low.x..high.x), rng.random_range(low.y..high.y), 0.0),
                Vector3::new(along(rng), along(rng), -force),
                DIAMETER,
            )
        })
        .collect();
    Stimulus { contacts, ..Stimulus::default() }
}

fn response(model: &dyn ForwardModel, stimulus: &Stimulus) -> Result<Vec<f64>> {
    let mut out = vec![0.0; model.channels()];
    model.response(stimulus, &mut out)?;
    Ok(out)
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
            let contact = Indentation::sphere(
                Point3::new(taxel[0] + along * dx, taxel[1] + along * dy, 0.0),
                Vector3::new(0.0, 0.0, -force),
                DIAMETER,
            );
            let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
            values.push(response(model, &stimulus)?[channel] / force);
        }
    }
    Ok(json!({ "rows": rows, "root_step": root_step, "step": step, "values": values }))
}

/// What the peer makes of the same tables and stimuli.
fn beside(
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
    let Options { root, seconds, threads, .. } = options;
    peers::Run { python, root, seconds: *seconds, threads: *threads }.of("table_peer.py", &data, 1e-3)
}
