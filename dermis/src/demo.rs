//! The main job without hardware: a simulated skin behind a pseudo-terminal, the node, and what a subscriber gets.

mod shipped;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use dermis_bridge_zenoh::{Bridge, BridgeConfig};
use dermis_operate::Touch;
use dermis_operate::demo::{Contents, Demo, Request, Shown};
use dermis_operate::quantity::duration;
use dermis_perception::cli::NetworkArguments;
use dermis_sensor::Registry;

use crate::backend::Choice;
use crate::interrupt;
use crate::output::{StandardError, shown};
use crate::registry::{SHIPPED, sensors};
use crate::table::Table;
use shipped::SKINS;

/// How to show it.
#[derive(Args)]
pub struct Options {
    /// End after this long, e.g. `10s` or `2m`; until Ctrl-C where absent.
    #[arg(long, value_parser = duration)]
    duration: Option<Duration>,
    /// Print one JSON object at the end instead of a table.
    #[arg(long)]
    json: bool,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
    /// Without JSON over zenoh.
    #[arg(long)]
    no_bridge: bool,
    #[command(flatten)]
    network: NetworkArguments,
    /// Seed of the touches and the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Skin to show: baro-grid, baro-line, baro-dome, hapdef-shin, ert-panel, insight-thumb, or the path of a skin file.
    #[arg(long, value_name = "NAME|FILE", default_value = shipped::DEFAULT)]
    skin: PathBuf,
    /// Folder of a model bundle in place of the one that ships; may be given several times. Without any bundle, contacts are found
    /// on the skin's forward model.
    #[arg(long)]
    model: Vec<PathBuf>,
}

/// Runs the demo.
pub fn run(options: &Options) -> Result<()> {
    crate::block_on(play(options))
}

/// The skin of that name, or of that file, and the families that read it.
fn chosen<'a>(skin: &'a Path, models: &'a [PathBuf]) -> Result<(Shown<'a>, &'static Registry)> {
    if let Some(contents) = SKINS.iter().find(|contents| Path::new(contents.name) == skin) {
        // What ships is read by the families that ship, whatever families this program was given.
        return Ok((Shown::Inside(Contents { models, ..*contents }), &SHIPPED));
    }
    if !skin.is_file() {
        bail!(
            "skin `{}` neither ships with this program nor is a file: name one of {}, or give the path of a skin file",
            skin.display(),
            shipped::names()
        );
    }
    Ok((Shown::File { skin, models }, sensors()))
}

async fn play(options: &Options) -> Result<()> {
    let network = options.network.choice();
    let request = Request { seed: options.seed, network: network.clone() };
    let backend = options.backend.open()?;
    let (what, sensors) = chosen(&options.skin, &options.model)?;
    let demo = Demo::start(&request, &what, sensors, backend.as_ref(), &StandardError)?;
    let bridge = if options.no_bridge {
        None
    } else {
        let config = BridgeConfig { robot: "demo".into(), network, ..BridgeConfig::default() };
        // The table is worth more than the JSON beside it.
        Bridge::open(demo.watcher(), config)
            .await
            .inspect(|bridge| eprintln!("{}", bridge.open_to()))
            .inspect_err(|e| eprintln!("note: no JSON over zenoh: {e}"))
            .ok()
    };
    let mut table = Table::begin();
    let mut show = |touch: &Touch, elapsed: Duration| {
        if options.json { Ok(()) } else { table.draw(elapsed, std::iter::once(touch)) }
    };
    let elapsed = shown(demo.watch(options.duration, interrupt::ended()?, &mut show).await)?;
    if let Some(bridge) = bridge {
        bridge.close().await;
    }
    let found = demo.stop(elapsed)?;
    if options.json {
        println!("{}", serde_json::to_value(&found)?);
    } else {
        print!("{}", dermis_report::demo::text(&found));
    }
    Ok(found.require()?)
}

#[cfg(test)]
mod tests {
    use dermis_skin::SkinDescription;

    use super::*;

    #[test]
    fn what_ships_inside_fits_together() {
        crate::registry::choose(&SHIPPED);
        for contents in &SKINS {
            let skin = SkinDescription::from_toml(contents.skin, contents.name).unwrap();
            assert_eq!(skin.name, contents.name);
            let plan = contents.plan(&skin).unwrap();
            // The tip and the forces that the skin is built for; the default has a plan of its own.
            let rated = skin.rated_press();
            assert_eq!(plan.diameter, [rated.diameter], "{}", contents.name);
            if contents.bundle.is_empty() {
                continue;
            }
            let dir = tempfile::tempdir().unwrap();
            for (name, bytes) in contents.bundle {
                std::fs::write(dir.path().join(name), bytes).unwrap();
            }
            dermis_inference::Bundle::load(dir.path(), &skin).unwrap();
        }
    }

    #[test]
    fn skins_go_by_name_or_by_file() {
        let of = |skin: &'static str| chosen(Path::new(skin), &[]);
        assert!(matches!(of("ert-panel"), Ok((Shown::Inside(contents), _)) if contents.bundle.is_empty()));
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../launch/skins/baro-line.toml");
        assert!(matches!(of(file), Ok((Shown::File { .. }, _))));
        insta::assert_snapshot!(of("ert-pannel").err().unwrap(), @"skin `ert-pannel` neither ships with this program nor is a file: name one of baro-grid, baro-line, baro-dome, hapdef-shin, ert-panel, insight-thumb, or give the path of a skin file");
    }
}
