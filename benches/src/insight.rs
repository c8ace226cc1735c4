//! How fast the soft thumb's forward model makes pictures, noise included, beside a renderer that others wrote, and how untouched ones
//! compare to real frames.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Args;
use dermis_insight::model::ThumbModel;
use dermis_model::{ForwardModel, Indentation, Stimulus, tangents};
use dermis_skin::SkinDescription;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use zune_jpeg::zune_core::bytestream::ZCursor;

use crate::peers;
use crate::sampling::{render, sample};

/// Stimuli that are sampled again and again.
const STIMULI: usize = 256;
/// \[N\] of each contact; shear is up to half of that (thesis, section 6.4.6).
const FORCES: std::ops::Range<f64> = 0.05..1.6;
/// \[m\] of the tips, and from the end of the elastomer.
const DIAMETER: f64 = 0.004;
const MARGIN: f64 = 0.004;
/// Pixels of pictures: what networks take, and what the camera has.
const SIZES: [[i64; 2]; 2] = [[410, 308], [1640, 1232]];
/// Recorded frames: untouched, by all lamps, and touched.
const FRAMES: [&str; 3] = ["dataflow_reference.jpg", "imaging_all_leds.jpg", "dataflow_contact_pinch.jpg"];
/// Pictures of the peer, and \[mm\] by which its balls sink into its gel.
const PEER_PRESSES: usize = 24;
const PEER_DEPTHS: std::ops::Range<f64> = 0.2..1.0;
/// Bytes from which a value counts as saturated: 0.98 of full scale.
const SATURATED: u8 = 250;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Folder of recorded frames; leaves the comparison out where absent.
    #[arg(long)]
    frames: Option<PathBuf>,
    /// Python with Taxim and JAX; leaves the peer out where absent.
    #[arg(long)]
    peer_python: Option<PathBuf>,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// [s] of each measurement.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Threads.
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

/// Measures pictures of one to three contacts at both sizes, and the frame's numbers alone.
///
/// # Errors
///
/// Where the thumb has no model, or a frame cannot be read.
pub fn run(options: &Options) -> Result<Value> {
    dermis_skin::register(dermis_insight::FAMILY);
    let mut sizes = Vec::new();
    let mut statistics = serde_json::Map::new();
    let mut basis = 0.0;
    for size in SIZES {
        let skin = thumb(&options.root, size)?;
        let begun = Instant::now();
        let model = ThumbModel::new(&skin)?;
        let table = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        model.basis()?;
        // Both sizes share one: the second finds it.
        basis = begun.elapsed().as_secs_f64().max(basis);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let stimuli: Vec<Stimulus> = (0..STIMULI).map(|_| stimulus(&model, &mut rng)).collect();
        let pictures = render(&model, &stimuli, options.seconds, options.threads)?;
        let numbers = sample(&model, &skin, &stimuli, false, options.seconds, options.threads)?;
        let name = format!("{} x {}", size[0], size[1]);
        eprintln!("{name:<12} {:>9.1} pictures/s, {:>9.1} by CPU time", pictures[0], pictures[1]);
        let untouched = model.capture(&Stimulus::default(), &mut || 0.0)?.context("a thumb has a camera")?;
        statistics.insert(format!("ours, {name}"), looks(untouched.data()));
        sizes.push(json!({
            "size": size, "table_s": table,
            "pictures_per_s": pictures[0], "pictures_by_cpu_time": pictures[1],
            "numbers_per_s": numbers[0], "numbers_by_cpu_time": numbers[1],
        }));
    }
    if let Some(folder) = &options.frames {
        for name in FRAMES {
            statistics.insert(name.to_owned(), looks(&frame(&folder.join(name))?));
        }
        let [idle, pinch] = [0, 2].map(|i| frame(&folder.join(FRAMES[i])));
        let (idle, pinch) = (idle?, pinch?);
        if idle.len() != pinch.len() {
            bail!("{} and {} are not of one size", FRAMES[0], FRAMES[2]);
        }
        let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
        let mean = idle.iter().zip(&pinch).map(square).sum::<f64>() / idle.len() as f64;
        statistics.insert("difference of the recorded pinch".to_owned(), json!(mean.sqrt() / 255.0));
    }
    let mut result = json!({
        "skin": "insight-thumb", "contacts": "one to three", "threads": options.threads, "basis_s": basis,
        "sizes": sizes, "looks": statistics,
    });
    if let Some(python) = &options.peer_python {
        let peers = beside(python, options)?;
        let [ours, theirs] = [&result["sizes"][0], &peers[0]].map(megapixels);
        result["times_the_pixels_of_peer"] = json!(ours / theirs);
        result["peers"] = json!(peers);
    }
    Ok(result)
}

/// A renderer of another sensor: it takes the shape of its flat gel from the ball alone, and the shading of each pixel from a table of
/// slopes, where ours moves an elastomer and follows eight lamps. So only their pixels per second can be compared.
fn beside(python: &Path, options: &Options) -> Result<Vec<Value>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut press =
        || [rng.random_range(0.1..0.9), rng.random_range(0.1..0.9), rng.random_range(PEER_DEPTHS)];
    let presses: Vec<Vec<[f64; 3]>> =
        (0..PEER_PRESSES).map(|i| (0..=i % 3).map(|_| press()).collect()).collect();
    let data = json!({ "diameter": DIAMETER * 1e3, "presses": presses });
    let Options { root, seconds, threads, .. } = options;
    let peers =
        peers::Run { python, root, seconds: *seconds, threads: *threads }.answers("taxim_peer.py", &data)?;
    for peer in &peers {
        let number = |name: &str| peer[name].as_f64().unwrap_or(f64::NAN);
        let name = peer["name"].as_str().unwrap_or_default();
        eprintln!(
            "{name:<34} {:>9.2} pictures/s, {:>9.2} by CPU time",
            number("pictures_per_s"),
            number("pictures_by_cpu_time")
        );
    }
    Ok(peers)
}

/// Millions of pixels a second by CPU time: what else runs on the machine meets both alike.
fn megapixels(of: &Value) -> f64 {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    number(&of["size"][0]) * number(&of["size"][1]) * number(&of["pictures_by_cpu_time"]) * 1e-6
}

/// The thumb that ships, with pictures of another size.
fn thumb(root: &Path, size: [i64; 2]) -> Result<SkinDescription> {
    let path = root.join("launch/skins/insight-thumb.toml");
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    let mut table: toml::Table = text.parse()?;
    let camera = table.get_mut("medium").and_then(|medium| medium.get_mut("camera"));
    camera.context("the skin has no medium.camera")?["size"] = toml::Value::try_from(size)?;
    Ok(SkinDescription::from_toml(&table.to_string(), &path.display().to_string())?)
}

/// Balls somewhere on the elastomer.
fn stimulus(model: &ThumbModel, rng: &mut ChaCha8Rng) -> Stimulus {
    let elastomer = &model.parameters().elastomer;
    let contacts = (0..rng.random_range(1..=3))
        .map(|_| {
            let s = (elastomer.end() - MARGIN) * rng.random_range(0.0..1.0f64).sqrt();
            let place = elastomer.thumb.point(s, rng.random_range(0.0..std::f64::consts::TAU), 0.0).0;
            let (position, normal) = model.surface().project(&place);
            let force = rng.random_range(FORCES);
            let shear = tangents(&normal)[0] * (force * rng.random_range(-0.5..0.5));
            Indentation::sphere(position, shear - normal * force, DIAMETER)
        })
        .collect();
    Stimulus { contacts, ..Stimulus::default() }
}

/// Three bytes a pixel.
fn frame(path: &Path) -> Result<Vec<u8>> {
    let jpeg = std::fs::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
    let decoded = zune_jpeg::JpegDecoder::new(ZCursor::new(&jpeg)).decode();
    decoded.with_context(|| format!("{} is no JPEG that can be read", path.display()))
}

/// Mean of each colour, and the share of values that are saturated and dark.
fn looks(data: &[u8]) -> Value {
    let count = data.len() as f64;
    let mut sums = [0.0; 3];
    for pixel in data.as_chunks::<3>().0 {
        sums.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += f64::from(*value));
    }
    let share = |of: &dyn Fn(u8) -> bool| data.iter().filter(|v| of(**v)).count() as f64 / count;
    json!({
        "mean": sums.map(|sum| sum * 3.0 / count / 255.0),
        "saturated": share(&|v| v >= SATURATED), "dark": share(&|v| v <= 5),
    })
}
