//! How fast a shell is factored and answers: against CHOLMOD with OpenBLAS on the same matrix, against CalculiX on the same
//! load, and how many samples the forward model of a shell with gauges gives.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::Args;
use dermis_hapdef::model::Solved;
use dermis_mechanics::calculix::{self, Panel, PanelTimes};
use dermis_mechanics::shell::{Action, Face, Gauge, Green, PlateTheory, Quads, Section, Shell, ShellMesh};
use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{SkinDescription, Surface};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::sampling::sample;

/// Stimuli that are sampled again and again.
const STIMULI: usize = 2048;
/// \[N\] pressing forces.
const FORCES: std::ops::Range<f64> = 0.5..34.0;
/// \[m\] of the tip.
const DIAMETER: f64 = 0.010;
/// Contacts of a stimulus, at most.
const CONTACTS: usize = 4;
/// Further load cases of a run of CalculiX, beside a run of one.
const LOADS: u32 = 8;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Python with numpy, scipy and scikit-sparse; leaves CHOLMOD out where absent.
    #[arg(long)]
    peer_python: Option<PathBuf>,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// Skin description: gauges on a panel.
    #[arg(long, default_value = "launch/skins/hapdef-shin.toml")]
    skin: PathBuf,
    /// \[s\] of each measurement of samples.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Times that a factor is made; the best counts.
    #[arg(long, default_value_t = 20)]
    repeats: usize,
    /// Threads that sample.
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

/// Measures ours and the peers', one after the other.
///
/// # Errors
///
/// Where the skin has no shell, or a peer fails or disagrees.
pub fn run(options: &Options) -> Result<Value> {
    let skin = SkinDescription::load(options.root.join(&options.skin))?;
    let begun = Instant::now();
    let model = dermis_hapdef::model(&skin)?;
    let set_up = begun.elapsed().as_secs_f64();
    let surface = model.surface();
    // By the theory of the skin file, on the triangles that its model takes.
    let Solved { mut shell, section, held } = Solved::new(&skin)?;
    let factor = best(options.repeats, || Ok(shell.refactor()?))?;
    let watch = Watch::new()?;
    let green = shell.normal_green_of_first(&surface.normals)?;
    let columns = watch.read()?;
    let one = Action::force(surface.points.len() / 2, Vector3::z());
    let load = best(options.repeats, || Ok(shell.solve(std::slice::from_ref(&one)).map(drop)?))?;
    eprintln!(
        "{} nodes, {} unknowns: factored in {:.1} ms, {} loads in {:.2} s ({:.2} s of CPU time), one in {:.2} ms",
        shell.mesh().points.len(),
        shell.unknowns(),
        factor.clock * 1e3,
        green.nodes(),
        columns.clock,
        columns.cpu,
        load.clock * 1e3,
    );
    let mut result = json!({
        "skin": skin.name,
        "theory": match section.theory {
            PlateTheory::KirchhoffLove => "kirchhoff-love",
            PlateTheory::ReissnerMindlin => "reissner-mindlin",
        },
        "points": surface.points.len(),
        "nodes": shell.mesh().points.len(),
        "unknowns": shell.unknowns(),
        "ours": { "factor_s": factor.json(), "all_loads_s": columns.json(), "one_load_s": load.json() },
    });

    if let Some(python) = &options.peer_python {
        let folder = tempfile::tempdir()?;
        export(folder.path(), &shell, &surface.normals, &green)?;
        for threads in [1, options.threads] {
            let peer = cholmod(python, folder.path(), threads, options)?;
            // Alone by CPU time: what else runs on the machine meets both alike. Ours factors on one core and solves on all.
            let kind = if threads == 1 { "cpu" } else { "clock" };
            let [their_factor, their_loads] = ["factor_s", "loads_s"].map(|key| least(&peer[key], kind));
            let of = |time: &Time| if threads == 1 { time.cpu } else { time.clock };
            let ratio = json!({ "by": kind, "factor": their_factor / of(&factor), "all_loads": their_loads / of(&columns) });
            eprintln!(
                "CHOLMOD, threads: {threads}, by {kind}: factored in {:.1} ms, the same loads in {their_loads:.2} s: {ratio}",
                their_factor * 1e3,
            );
            let name = format!("cholmod_{threads}_threads");
            result["ratio"][&name] = ratio;
            result[&name] = peer;
        }
    }

    let judged = solids(&section, surface, &held)?;
    if let Some(times) = judged {
        let per_load = columns.clock / green.nodes() as f64;
        let [first, step, at_once] = [times.first, times.step, times.at_once].map(|t| t.as_secs_f64());
        eprintln!(
            "CalculiX, solids on the same cells: {first:.2} s for one load; for each further one {step:.2} s as a step of its own, which \
             is {:.0} times ours one by one and {:.0} times ours together, and {at_once:.3} s with the same factor, {:.0} times ours \
             one by one",
            step / load.clock,
            step / per_load,
            at_once / load.clock
        );
        result["calculix"] =
            json!({ "first_load_s": first, "further_load_s": step, "further_load_at_once_s": at_once });
        result["ratio"]["calculix"] = json!({
            "one_load": step / load.clock,
            "all_loads": step / per_load,
            "one_load_at_once": at_once / load.clock,
        });
    }

    let samples = samples(model.as_ref(), &skin, options)?;
    result["set_up_s"] = json!(set_up);
    result["samples"] = samples;
    Ok(result)
}

/// \[s\] by the clock, and of CPU time of this process.
struct Time {
    clock: f64,
    cpu: f64,
}

impl Time {
    fn json(&self) -> Value {
        json!({ "clock": self.clock, "cpu": self.cpu })
    }
}

struct Watch(Instant, f64);

impl Watch {
    fn new() -> Result<Self> {
        Ok(Self(Instant::now(), process_time()?))
    }

    fn read(&self) -> Result<Time> {
        Ok(Time { clock: self.0.elapsed().as_secs_f64(), cpu: process_time()? - self.1 })
    }
}

/// The least of some.
fn best(repeats: usize, mut work: impl FnMut() -> Result<()>) -> Result<Time> {
    let mut least = Time { clock: f64::INFINITY, cpu: f64::INFINITY };
    for _ in 0..repeats.max(1) {
        let watch = Watch::new()?;
        work()?;
        let time = watch.read()?;
        least = Time { clock: least.clock.min(time.clock), cpu: least.cpu.min(time.cpu) };
    }
    Ok(least)
}

/// The least of an object's times of this kind.
fn least(times: &Value, kind: &str) -> f64 {
    let times = times.as_object().into_iter().flatten();
    times.filter_map(|(_, time)| time[kind].as_f64()).fold(f64::INFINITY, f64::min)
}

/// \[s\] of CPU time of this process, threads that have ended included.
fn process_time() -> Result<f64> {
    let time = nix::time::clock_gettime(nix::time::ClockId::CLOCK_PROCESS_CPUTIME_ID)?;
    Ok(Duration::from(time).as_secs_f64())
}

/// Writes what the peer needs.
fn export(folder: &Path, shell: &Shell, normals: &[Vector3<f64>], green: &Green) -> Result<()> {
    let write = |name: &str, bytes: &mut dyn Iterator<Item = Vec<u8>>| -> Result<()> {
        let mut file = std::io::BufWriter::new(std::fs::File::create(folder.join(name))?);
        for bytes in bytes {
            file.write_all(&bytes)?;
        }
        Ok(file.flush()?)
    };
    let whole = |n: &usize| (*n as i64).to_le_bytes().to_vec();
    let (starts, rows, values) = shell.stiffness();
    write("starts", &mut starts.iter().map(whole))?;
    write("rows", &mut rows.iter().map(whole))?;
    write("values", &mut values.iter().map(|v| v.to_le_bytes().to_vec()))?;
    let nodes = 0..normals.len();
    let unknowns =
        nodes.flat_map(|node| (0..3).map(move |k| shell.unknown(node, k).map_or(-1, |u| u as i64)));
    write("unknowns", &mut unknowns.map(|u| u.to_le_bytes().to_vec()))?;
    write("normals", &mut normals.iter().flat_map(|n| n.iter()).map(|v| v.to_le_bytes().to_vec()))?;
    write("green", &mut green.values().iter().map(|v| v.to_le_bytes().to_vec()))
}

fn cholmod(python: &Path, folder: &Path, threads: usize, options: &Options) -> Result<Value> {
    let out = Command::new(python)
        .arg(options.root.join("benches/python/cholmod_peer.py"))
        .arg(folder)
        .arg(options.repeats.to_string())
        .env("OPENBLAS_NUM_THREADS", threads.to_string())
        .output()
        .with_context(|| format!("{} cannot be started", python.display()))?;
    ensure!(out.status.success(), "CHOLMOD failed: {}", String::from_utf8_lossy(&out.stderr));
    let peer: Value = serde_json::from_slice(&out.stdout).context("the peer printed something else")?;
    let open = |file: &Value| file.as_str().is_some_and(|f| f.contains("openblas"));
    // The reference BLAS would be no peer.
    ensure!(
        peer["blas"].as_array().is_some_and(|files| files.iter().any(open)),
        "CHOLMOD has not loaded OpenBLAS but {}: install libopenblas0-pthread",
        peer["blas"]
    );
    ensure!(
        peer["deviation"].as_f64().is_some_and(|d| d < 1e-5),
        "CHOLMOD's displacements are not ours: {}",
        peer["deviation"]
    );
    Ok(peer)
}

/// How long CalculiX takes for loads on 20-node hexahedra over the same cells. `None` where it is not installed, or the surface is not made
/// of quadrilaterals.
fn solids(section: &Section, surface: &Surface, clamped: &[usize]) -> Result<Option<PanelTimes>> {
    let mesh = ShellMesh { points: surface.points.clone(), triangles: surface.triangles.clone() };
    let Some(quads) = Quads::join(&mesh).filter(|_| calculix::available()) else {
        eprintln!("CalculiX is left out: it is not installed, or the surface is not made of quadrilaterals");
        return Ok(None);
    };
    let centre = surface.project(&Point3::new(0.0, 0.0, 1.0)).0;
    let gauge = Gauge { centre, along: Vector3::x(), length: 0.008, width: 0.005, face: Face::Inner };
    let panel = Panel {
        name: "bench",
        quads: &quads,
        section,
        clamped,
        centre,
        patch: 0.005,
        gauges: std::slice::from_ref(&gauge),
        within: [0.1; 2],
    };
    Ok(Some(calculix::panel_times(&panel, LOADS)?))
}

/// Up to [`CONTACTS`] contacts on the surface.
fn stimulus(surface: &Surface, rng: &mut ChaCha8Rng) -> Stimulus {
    let contacts = (0..rng.random_range(1..=CONTACTS))
        .map(|_| {
            let triangle = surface.triangles[rng.random_range(0..surface.triangles.len())];
            let [a, b, c] = triangle.map(|n| surface.points[n as usize].coords);
            let (mut s, mut t) = (rng.random::<f64>(), rng.random::<f64>());
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            let (position, normal) = surface.project(&Point3::from(a + (b - a) * s + (c - a) * t));
            Indentation::sphere(position, normal * -rng.random_range(FORCES), DIAMETER)
        })
        .collect();
    Stimulus { contacts, ..Stimulus::default() }
}

/// Samples per second of the forward model with its noise, without and with the displacement of every point.
fn samples(model: &dyn ForwardModel, skin: &SkinDescription, options: &Options) -> Result<Value> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let stimuli: Vec<Stimulus> = (0..STIMULI).map(|_| stimulus(model.surface(), &mut rng)).collect();
    let begun = Instant::now();
    let mut map = vec![0.0; model.surface().points.len()];
    ensure!(model.displacement(&stimuli[0], &mut map)?, "skin `{}` knows no displacement", skin.name);
    let maps_ready = begun.elapsed().as_secs_f64();
    let mut result = json!({
        "contacts": format!("1 to {CONTACTS}"),
        "channels": model.channels(),
        "points": map.len(),
        "threads": options.threads,
        "first_map_s": maps_ready,
    });
    for (name, maps) in [("readings", false), ("readings_and_maps", true)] {
        let [clock, cpu] = sample(model, skin, &stimuli, maps, options.seconds, options.threads)?;
        let name_for_people = name.replace('_', " ");
        eprintln!(
            "{name_for_people:<20} {:>8.3} million samples/s, {:>8.3} by CPU time",
            clock / 1e6,
            cpu / 1e6
        );
        result[name] = json!({ "samples_per_s": clock, "by_cpu_time": cpu });
    }
    Ok(result)
}
