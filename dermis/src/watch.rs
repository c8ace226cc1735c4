//! What running skins feel, whoever started them: `dermis watch`.

use std::io::Write;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use dermis_operate::quantity::duration;
use dermis_operate::watch::{Request, View, watch};
use dermis_perception::cli::NetworkArguments;

use crate::backend::Choice;
use crate::interrupt;
use crate::output::{StandardError, shown};
use crate::table::Table;

/// Which skins, and how they are shown.
#[derive(Args)]
pub struct Options {
    /// Skins to show, by the name that their contacts carry; all that are there where none is given.
    skins: Vec<String>,
    /// Tare each of them first; nothing may touch them.
    #[arg(long)]
    tare: bool,
    /// One JSON object a second instead of a table.
    #[arg(long)]
    json: bool,
    /// End after this long, e.g. `10s` or `2m`; until Ctrl-C where absent.
    #[arg(long, value_parser = duration)]
    duration: Option<Duration>,
    /// How long to look for a skin before giving up.
    #[arg(long, value_parser = duration, default_value = "10s")]
    within: Duration,
    #[command(flatten)]
    network: NetworkArguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C or SIGTERM, or as long as was said.
pub async fn run(options: Options) -> Result<()> {
    let Options { skins, tare, json, duration, within, network, backend } = options;
    let request = Request { skins, tare, duration, within, network: network.choice() };
    let (mut table, mut objects) = (Table::begin(), 0);
    let mut show = |view: &View<'_>| {
        if !json {
            return table.draw(view.elapsed(), view.skins());
        }
        let second = view.elapsed().as_secs();
        if second <= objects || view.skins().next().is_none() {
            return Ok(());
        }
        objects = second;
        let mut out = std::io::stdout().lock();
        writeln!(out, "{}", serde_json::to_value(view.record())?)?;
        out.flush()
    };
    let end = interrupt::ended()?;
    shown(watch(&request, backend.open()?.as_ref(), end, &StandardError, &mut show).await)
}
