//! How fast the panel's forward model samples, noise included, against scipy and pyEIT, which solve the same sheet anew.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use dermis_ert::model::FabricModel;
use dermis_ert::sheet::Update;
use dermis_model::{Indentation, Stimulus, Tip, TipShape};
use dermis_skin::SkinDescription;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::peers;
use crate::sampling::sample;

/// Stimuli that are sampled again and again.
const STIMULI: usize = 2048;
/// Frames that peers solve.
const FRAMES: usize = 32;
/// \[N\] of each contact.
const FORCES: std::ops::Range<f64> = 5.0..40.0;
/// \[m\] of the flat tips, and from the border of the panel.
const DIAMETER: f64 = 0.02;
const MARGIN: f64 = 0.015;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Python with numpy, scipy and pyEIT; leaves the peers out where absent.
    #[arg(long)]
    peer_python: Option<PathBuf>,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// \[s\] of each measurement.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Threads of ours, processes of the peers.
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

/// Measures ours with one to six contacts, with six, and the peers'.
///
/// # Errors
///
/// Where the panel has no model, or a peer fails or disagrees.
pub fn run(options: &Options) -> Result<Value> {
    dermis_skin::register(dermis_ert::FAMILY);
    let skin = SkinDescription::load(options.root.join("launch/skins/ert-panel.toml"))?;
    let begun = Instant::now();
    let model = FabricModel::new(&skin)?;
    let set_up = begun.elapsed().as_secs_f64();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut mixed = || {
        let contacts = rng.random_range(1..=6);
        stimulus(&model, &mut rng, contacts)
    };
    let mixed: Vec<Stimulus> = (0..STIMULI).map(|_| mixed()).collect();
    let six: Vec<Stimulus> = (0..STIMULI).map(|_| stimulus(&model, &mut rng, 6)).collect();
    let show = |name: &str, [clock, cpu]: [f64; 2]| {
        eprintln!("{name:<32} {clock:>12.1} frames/s, {cpu:>12.1} by CPU time");
    };
    let mut ours = serde_json::Map::new();
    for (name, stimuli) in [("one_to_six", &mixed), ("six", &six)] {
        let rates = sample(&model, &skin, stimuli, false, options.seconds, options.threads)?;
        show(&format!("dermis, {}", name.replace('_', " ")), rates);
        ours.insert(name.into(), json!({ "frames_per_s": rates[0], "by_cpu_time": rates[1] }));
    }
    let mut result =
        json!({ "skin": skin.name, "channels": 784, "threads": options.threads, "set_up_s": set_up });
    if let Some(python) = &options.peer_python {
        let peers = beside(python, &model, &mixed[..FRAMES], options)?;
        // By CPU time: what else runs on the machine meets both alike.
        let rate = ours["one_to_six"]["by_cpu_time"].as_f64().unwrap_or(f64::NAN);
        let mut ratios = serde_json::Map::new();
        for (key, peer) in ["scipy", "pyeit"].into_iter().zip(&peers) {
            let number = |name: &str| peer[name].as_f64().unwrap_or(f64::NAN);
            show(peer["name"].as_str().unwrap_or_default(), [number("frames_per_s"), number("by_cpu_time")]);
            ratios.insert(key.into(), json!(rate / number("by_cpu_time")));
        }
        result["peers"] = json!(peers);
        result["ratio"] = Value::Object(ratios);
    }
    result["ours"] = Value::Object(ours);
    Ok(result)
}

/// Flat tips somewhere on the panel.
fn stimulus(model: &FabricModel, rng: &mut ChaCha8Rng, contacts: usize) -> Stimulus {
    let panel = model.parameters().panel;
    let contacts = (0..contacts)
        .map(|_| {
            let at = panel.size.map(|size| rng.random_range(MARGIN - size / 2.0..size / 2.0 - MARGIN));
            let (position, normal): (_, Vector3<f64>) = panel.roll(at);
            Indentation {
                position,
                force: -normal * rng.random_range(FORCES),
                tip: Tip {
                    shape: TipShape::FlatPunch { diameter: DIAMETER },
                    orientation: UnitQuaternion::identity(),
                },
            }
        })
        .collect();
    Stimulus { contacts, ..Stimulus::default() }
}

/// What peers make of the same sheet and contacts.
fn beside(python: &Path, model: &FabricModel, stimuli: &[Stimulus], options: &Options) -> Result<Vec<Value>> {
    let (parameters, sheet) = (model.parameters(), model.sheet());
    let n = sheet.electrodes();
    let (mut update, mut resistances) = (Update::default(), vec![0.0; n * n]);
    let mut frames = Vec::new();
    for stimulus in stimuli {
        let loads = model.loads(stimulus)?;
        update.solve(sheet, &loads, 1.0, &mut resistances);
        frames.push(json!({
            "nodes": loads.iter().map(|l| l.node).collect::<Vec<_>>(),
            "conductances": loads.iter().map(|l| l.conductance).collect::<Vec<_>>(),
            "resistances": resistances,
        }));
    }
    let electrodes: Vec<_> = parameters.electrodes.iter().map(|e| sheet.grid().weights(e.at)).collect();
    let data = json!({
        "cells": parameters.grid.cells, "size": parameters.grid.size, "square": parameters.resistance[0],
        "leak": parameters.leak, "electrodes": electrodes, "frames": frames,
    });
    let Options { root, seconds, threads, .. } = options;
    peers::Run { python, root, seconds: *seconds, threads: *threads }.of("ert_peer.py", &data, 1e-6)
}
