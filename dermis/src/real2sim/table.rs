//! Table 3.1.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use dermis_learn::real2sim::{Scenes, Settings, Table, table};
use serde_json::json;

use super::{nominal, progress, save, sensors, tell};
use crate::figures::{Axes, Curve, curves, escape, figure, page};

/// Which skin, and where the table goes.
#[derive(Args)]
pub struct Options {
    /// Skin description; its forward model must know displacements.
    skin: PathBuf,
    /// Settings (TOML); see `launch/real2sim/`.
    #[arg(long)]
    settings: Option<PathBuf>,
    /// Folder for `table.json` and `table.html`.
    #[arg(short, long)]
    out: Option<PathBuf>,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

const NUMERALS: [&str; 4] = ["I", "II", "III", "IV"];

/// Makes the table.
pub fn run(options: &Options) -> Result<()> {
    let settings = Settings::load(options.settings.as_deref())?;
    let (skin, model) = nominal(&options.skin)?;
    let scenes = Scenes::new(model.as_ref(), &settings.scenes)?;
    // The table is about virtual sensors: those of the thesis, whatever the pipeline uses.
    let each = if settings.pipeline.each == 0 { 24 } else { settings.pipeline.each };
    let sensors = sensors(&model, &skin, each)?;
    let bar = progress()?;
    let started = std::time::Instant::now();
    let found = table(model.as_ref(), &sensors, &scenes, &settings.table, &tell(&bar))?;
    bar.finish_and_clear();
    let [line, network] = found.messages();
    let record = json!({
        "skin": skin.name, "skin_hash": skin.hash(), "scenes": settings.scenes, "table": found,
        "messages": { "linear_extrapolates_best_from_single_contacts": line, "network_best_where_learned": network },
        "margins": { "linear": found.margins()[0], "network": found.margins()[1] },
        "seconds": started.elapsed().as_secs_f64(),
    });
    let text = text(&skin.name, &found);
    if let Some(folder) = &options.out {
        save(folder, "table.json", &format!("{record}\n"))?;
        save(folder, "table.html", &html(&skin.name, &found, &text)?)?;
    }
    if options.json {
        println!("{record}");
    } else {
        print!("{text}");
    }
    Ok(())
}

/// The table as lines of text.
fn text(skin: &str, table: &Table) -> String {
    let mut out = format!(
        "{skin}: displacement maps of {} points from {}\n{} shapes keep {:.3} % of their squares; noise {:.1} % of the \
         sensors' root mean square\n\nRMSE over all points [µm], and in parentheses the share of the variance that is \
         unexplained [%]\n",
        table.points,
        table.sensors,
        table.rank,
        table.kept * 100.0,
        table.settings.noise * 100.0,
    );
    for trained in 1..=4 {
        let _ = write!(out, "\n{:<22}", format!("learned from {}", NUMERALS[..trained].join(", ")));
        for tested in NUMERALS {
            let _ = write!(out, "{tested:>18}");
        }
        let _ = writeln!(out);
        for method in Table::METHODS {
            let _ = write!(out, "  {method:<20}");
            for tested in 1..=4 {
                if let Some(cell) = table.cell(method, trained, tested) {
                    let fvu = cell.error.fvu * 100.0;
                    let _ = write!(out, "{:>18}", format!("{:.1} ({fvu:.1})", cell.error.rms * 1e6));
                }
            }
            let _ = writeln!(out);
        }
    }
    let [line, network] = table.messages();
    let holds = |b: bool| if b { "holds" } else { "does not hold" };
    let _ = write!(
        out,
        "\n{}: of what learned from single contacts only, the line errs least on two, three and four\n\
         {}: the network errs least wherever the number of contacts was learned\n",
        holds(line),
        holds(network)
    );
    out
}

fn html(skin: &str, table: &Table, text: &str) -> Result<String> {
    let mut pictures = Vec::new();
    for trained in 1..=4 {
        let axes = Axes {
            log_y: true,
            ..Axes::new(
                format!("learned from {}", NUMERALS[..trained].join(", ")),
                "contacts at once",
                "unexplained [%]",
            )
        };
        let curve = |(n, method): (usize, &'static str)| {
            let at = |tested: usize| {
                table.cell(method, trained, tested).map(|c| (tested as f64, c.error.fvu * 100.0))
            };
            Curve::new(method, n, (1..=4).filter_map(at).collect())
        };
        pictures.push(curves(&axes, &Table::METHODS.into_iter().enumerate().map(curve).collect::<Vec<_>>())?);
    }
    let body = format!(
        "<pre>{}</pre>\n{}",
        escape(text),
        figure(&pictures, "Share of the variance of the maps that each method leaves unexplained.")
    );
    Ok(page(&format!("{skin}: who extrapolates to more contacts"), &body))
}
