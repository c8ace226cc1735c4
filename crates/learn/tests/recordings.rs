//! Learns from the recordings of a real skin. They are found by the environment variable `DERMIS_DATA` or in
//! `../shared/data` beside the repository, and skipped where they are missing.
//!
//! The networks are small, so that this takes seconds in an unoptimised build; the target figures are
//! measured with the configurations in `launch/train/` by `cargo xtask targets`.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use dermis_inference::{Bundle, Runtime, RuntimeChoice, RuntimeConfig};
use dermis_learn::train::{Outcome, Request, TrainConfig, run};
use dermis_learn::{Dataset, DatasetOptions, SplitKind};
use dermis_skin::SkinDescription;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Imports both runs of a kind; `None` where there are no recordings.
fn runs(kind: &str, names: [&str; 2], scratch: &Path, skin: &SkinDescription) -> Option<[Dataset; 2]> {
    let data = std::env::var("DERMIS_DATA").map_or_else(|_| root().join("../shared/data"), PathBuf::from);
    let source = data.join("eflesh").join(kind);
    if !source.is_dir() {
        println!("skipped: {} is missing; set DERMIS_DATA", source.display());
        return None;
    }
    Some(names.map(|name| {
        let bag = scratch.join(name);
        dermis_testbed::import::auto(&source.join(name), &bag).unwrap();
        Dataset::from_bags(&[bag], skin, &DatasetOptions::default()).unwrap()
    }))
}

fn learn(
    data: &Dataset,
    other: &Dataset,
    config: &TrainConfig,
    skin: &SkinDescription,
    out: &Path,
) -> Outcome {
    let embedded = RuntimeConfig { choice: RuntimeChoice::Embedded, library: None };
    let request = Request {
        data,
        others: &[("other".to_owned(), other.clone())],
        config,
        out,
        model: None,
        resume: false,
        threads: 2,
        processor: dermis_learn::train::Processor::Cpu,
        runtime: Runtime::load(&embedded).unwrap(),
    };
    let outcome = run(&request, &AtomicBool::new(false), &|_| {}).unwrap();
    println!("{}{}", outcome.held_out, outcome.others[0].1);
    Bundle::load(out, skin).unwrap();
    outcome
}

#[test]
fn position_is_learned_from_a_real_skin() {
    let scratch = tempfile::tempdir().unwrap();
    let skin = SkinDescription::load(root().join("launch/skins/eflesh.toml")).unwrap();
    let names = ["20250316_155729_probe", "20250317_134149_probe"];
    let Some([data, other]) = runs("spatial_resolution", names, scratch.path(), &skin) else { return };
    assert_eq!((data.locations(), other.locations()), (961, 961));
    let mut config = TrainConfig::load(&root().join("launch/train/eflesh-position.toml")).unwrap();
    config.network.hidden = vec![48, 48];
    config.network.members = 1;
    config.training.epochs = 60;
    config.model.most = 400;
    config.split.kind = SplitKind::Press;
    let figures = learn(&data, &other, &config, &skin, &scratch.path().join("model"));
    assert!(figures.held_out.figures()["position_rms"] < 0.0007);
    assert_eq!(figures.held_out.unanswered, 0);
    // The pad was mounted anew for the other run.
    assert!(figures.others[0].1.figures()["position_rms"] < 0.0010);
}

#[test]
fn force_is_learned_from_a_real_skin() {
    let scratch = tempfile::tempdir().unwrap();
    let skin = SkinDescription::load(root().join("launch/skins/eflesh.toml")).unwrap();
    let names = ["20250401_014340_probe", "20250401_015037_probe"];
    let Some([data, other]) = runs("normal_force", names, scratch.path(), &skin) else { return };
    let mut config = TrainConfig::load(&root().join("launch/train/eflesh-force.toml")).unwrap();
    config.network.hidden = vec![32];
    config.network.members = 1;
    config.training.epochs = 60;
    config.model.most = 400;
    let figures = learn(&data, &other, &config, &skin, &scratch.path().join("model"));
    assert!(figures.held_out.figures()["force_normal_rms"] < 0.5);
    assert!(figures.others[0].1.figures()["force_normal_rms"] < 2.0);
}
