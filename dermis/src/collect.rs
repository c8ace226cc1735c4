//! The virtual testbed on the command line.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use clap::Args;
use dermis_skin::SkinDescription;
use dermis_testbed::{CollectOptions, Plan, collect};
use indicatif::{ProgressBar, ProgressStyle};

/// What to press, and where to put it.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    skin: PathBuf,
    /// Plan of the presses.
    #[arg(long)]
    plan: PathBuf,
    /// Seed of everything random; the plan's own where absent.
    #[arg(long)]
    seed: Option<u64>,
    /// Folder of the bag to write; must not exist yet.
    #[arg(short, long)]
    out: PathBuf,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Collects, and says what was collected. Ctrl-C ends early with a valid bag.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let model = (crate::registry::family(&skin)?.model)(&skin)?;
    let plan = Plan::load(&options.plan)?;
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
        &CollectOptions { seed: options.seed, stop, progress: progress.clone(), ..CollectOptions::default() },
    )?;
    progress.finish_and_clear();
    if options.json {
        println!(
            "{}",
            serde_json::json!({
                "bag": report.path, "frames": report.frames, "presses": report.presses,
                "duration_s": report.duration, "seed": report.seed, "interrupted": report.interrupted,
            })
        );
    } else {
        println!(
            "{}: {} frames, {} presses, {:.0} s of {}, seed {}{}",
            report.path.display(),
            report.frames,
            report.presses,
            report.duration,
            skin.name,
            report.seed,
            if report.interrupted { "; ended early by Ctrl-C" } else { "" }
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
