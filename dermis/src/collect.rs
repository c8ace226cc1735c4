//! The virtual testbed on the command line.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use clap::Args;
use dermis_skin::SkinDescription;
use dermis_testbed::{CollectOptions, Plan, collect};
use indicatif::{ProgressBar, ProgressStyle};

use crate::effects::Chosen;

/// What to press, and where to put it.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    skin: PathBuf,
    /// Plan of the presses.
    #[arg(long)]
    plan: PathBuf,
    /// What makes the device differ from its design.
    #[command(flatten)]
    chosen: Chosen,
    /// Seed of everything random, the device's own effects included; the plan's where absent.
    #[arg(long)]
    seed: Option<u64>,
    /// Standard deviation of the ground truth's force along each axis [N]; the plan's where absent.
    #[arg(long, value_name = "N", value_parser = noise)]
    force_noise: Option<f64>,
    /// Standard deviation of the ground truth's position along each axis [m]; the plan's where absent.
    #[arg(long, value_name = "M", value_parser = noise)]
    stage_noise: Option<f64>,
    /// Stamp of the first frame [ns since 1970]; now where absent. With it the bag's messages are the same every time.
    #[arg(long, value_name = "NS", value_parser = clap::value_parser!(i64).range(0..))]
    start: Option<i64>,
    /// Go on with a bag that was interrupted, by whatever; the finished bag is the same as one that was not.
    #[arg(long)]
    resume: bool,
    /// Folder of the bag to write; must not exist yet, but for --resume.
    #[arg(short, long)]
    out: PathBuf,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Reads a standard deviation.
fn noise(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(sigma) if sigma.is_finite() && sigma >= 0.0 => Ok(sigma),
        _ => Err(format!("`{text}` is no standard deviation: write 0 or a positive number")),
    }
}

/// Collects, and says what was collected. Ctrl-C ends early with a valid bag.
pub fn run(options: &Options) -> Result<()> {
    let mut skin = SkinDescription::load(&options.skin)?;
    let plan = Plan::load(&options.plan)?;
    options.chosen.apply(&mut skin, options.seed.unwrap_or(plan.seed))?;
    let model = crate::registry::forward(&options.skin, &skin)?;
    let progress = ProgressBar::new(0).with_style(ProgressStyle::with_template(
        "{msg} {wide_bar} {human_pos}/{human_len} frames, {eta} left",
    )?);
    progress.set_message(skin.name.clone());
    let stop = stop_on_interrupt()?;
    let report = collect(
        &model,
        &skin,
        &plan,
        &options.out,
        &CollectOptions {
            seed: options.seed,
            start: options.start,
            force_noise: options.force_noise,
            stage_noise: options.stage_noise,
            resume: options.resume,
            stop,
            progress: progress.clone(),
        },
    )?;
    progress.finish_and_clear();
    if options.json {
        println!(
            "{}",
            serde_json::json!({
                "bag": report.path, "frames": report.frames, "resumed": report.resumed, "presses": report.presses,
                "duration_s": report.duration, "seed": report.seed, "interrupted": report.interrupted,
            })
        );
    } else {
        let resumed = match report.resumed {
            0 => String::new(),
            n if n == report.frames => "; all of it was there already".to_owned(),
            n => format!("; {n} frames were there already"),
        };
        println!(
            "{}: {} frames, {} presses, {:.0} s of {}, seed {}{resumed}{}",
            report.path.display(),
            report.frames,
            report.presses,
            report.duration,
            skin.name,
            report.seed,
            if report.interrupted { "; ended early by Ctrl-C, --resume goes on" } else { "" }
        );
    }
    Ok(())
}

/// A flag that Ctrl-C sets.
pub fn stop_on_interrupt() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::Builder::new().name("interrupt".to_owned()).spawn(move || {
        runtime.block_on(async {
            if tokio::signal::ctrl_c().await.is_ok() {
                flag.store(true, Ordering::Release);
            }
        });
    })?;
    Ok(stop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Effect;
    use dermis_testbed::Timeline;
    use std::path::Path;

    fn files(folder: &str) -> Vec<PathBuf> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch").join(folder);
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    fn skin(name: &str) -> SkinDescription {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch/skins");
        SkinDescription::load(folder.join(format!("{name}.toml"))).unwrap_or_else(|e| panic!("{e}"))
    }

    #[test]
    fn every_plan_that_ships_can_be_carried_out_on_its_skin() {
        for path in files("plans") {
            let plan = Plan::load(&path).unwrap_or_else(|e| panic!("{e}"));
            let of = ["baro-line", "baro-dome"].into_iter().find(|skin| plan.name.starts_with(skin));
            let skin = skin(of.unwrap_or("baro-grid"));
            let model = crate::registry::family(&skin).unwrap().model(&skin).unwrap();
            Timeline::new(&plan, &model, plan.seed).unwrap_or_else(|e| panic!("{e}"));
        }
    }

    #[test]
    fn every_set_of_effects_that_ships_makes_a_device_of_every_skin() {
        let mut tried = 0;
        for path in files("effects") {
            // A set is called by the skins that it is for: baro-default, of baro-line and others.
            let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
            let family = stem.split('-').next().unwrap();
            for name in ["baro-line", "baro-grid", "baro-dome", "hapdef-shin"] {
                if !name.starts_with(family) {
                    continue;
                }
                tried += 1;
                let mut skin = skin(name);
                let chosen = Chosen { effects: vec![path.clone()], effect: vec![] };
                chosen.apply(&mut skin, 7).unwrap();
                assert_eq!(skin.effects.len(), Effect::load(&path).unwrap().len());
                let model = crate::registry::family(&skin).unwrap().model(&skin);
                model.unwrap_or_else(|e| panic!("{name}, {}: {e}", path.display()));
            }
        }
        assert!(tried >= 4, "{tried}");
    }
}
