//! The main job without hardware: a simulated skin behind a pseudo-terminal, the node, and what a subscriber gets.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use dermis_bridge_zenoh::{Bridge, BridgeConfig};
use dermis_operate::Touch;
use dermis_operate::demo::{Contents, Demo, Request};
use dermis_operate::quantity::duration;
use dermis_perception::cli::NetworkArguments;

use crate::backend::Choice;
use crate::output::{StandardError, shown};
use crate::registry::SHIPPED;
use crate::table::Table;

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
}

const SKIN: &str = include_str!("../../launch/skins/baro-grid.toml");
const PLAN: &str = include_str!("../../launch/plans/demo.toml");
/// The model bundle that ships, inside of the program: the demo needs no file beside it.
const BUNDLE: [(&str, &[u8]); 3] = [
    ("bundle.toml", include_bytes!("../../models/baro-grid/bundle.toml")),
    ("model.onnx", include_bytes!("../../models/baro-grid/model.onnx")),
    ("card.json", include_bytes!("../../models/baro-grid/card.json")),
];

/// What the program holds for its demo.
const CONTENTS: Contents<'static> = Contents { name: "baro-grid", skin: SKIN, plan: PLAN, bundle: &BUNDLE };

/// Runs the demo.
pub fn run(options: &Options) -> Result<()> {
    crate::block_on(play(options))
}

async fn play(options: &Options) -> Result<()> {
    let network = options.network.choice();
    let request = Request { seed: options.seed, network: network.clone() };
    let backend = options.backend.open()?;
    // The skin that ships, whatever families this program was given.
    let demo = Demo::start(&request, &CONTENTS, &SHIPPED, backend.as_ref(), &StandardError)?;
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
    let elapsed = shown(demo.watch(options.duration, tokio::signal::ctrl_c(), &mut show).await)?;
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
    use dermis_testbed::Plan;

    use super::*;

    #[test]
    fn what_ships_inside_fits_together() {
        let skin = SkinDescription::from_toml(SKIN, "baro-grid.toml").unwrap();
        Plan::from_toml(PLAN, "demo.toml").unwrap();
        dermis_barodome::model(&skin).unwrap();
        let dir = tempfile::tempdir().unwrap();
        for (name, bytes) in BUNDLE {
            std::fs::write(dir.path().join(name), bytes).unwrap();
        }
        dermis_inference::Bundle::load(dir.path(), &skin).unwrap();
    }
}
