//! Several contacts from few readings by way of a simulation, and who else could find them.

use anyhow::Result;
use clap::{Args, Subcommand};
use dermis_report::real2sim as report;
use dermis_studies::real2sim::{compare, table, thesis, train};

use crate::output::{self, Output};
use crate::registry::families;
use crate::steps::Steps;

/// What to do.
#[derive(Subcommand)]
pub enum Real2Sim {
    /// Who extrapolates to more contacts than were learned from: a line, neighbours and a network from virtual sensors to
    /// displacement maps (thesis, Table 3.1).
    Table(Table),
    /// Learn a bundle whose contacts are peaks of a displacement map, from recorded single contacts.
    Train(Train),
    /// Compare ways to one and two contacts on recordings that nothing was learned from.
    Compare(Compare),
    /// Measure chapter 3 of the thesis (HapDefX) again: maps by the number of virtual sensors (Fig. 3.5 A), ways to one contact
    /// (Fig. 3.8), errors of one and two contacts (Table 3.2). With the sizes of the thesis, hours.
    Thesis(Thesis),
}

/// Which skin, and where the table goes.
#[derive(Args)]
pub struct Table {
    #[command(flatten)]
    request: table::Request,
    #[command(flatten)]
    output: Output,
}

/// What to learn from.
#[derive(Args)]
pub struct Train {
    /// One JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    request: train::Request,
}

/// What to compare on what.
#[derive(Args)]
pub struct Compare {
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    request: compare::Request,
}

/// What to learn from, and what to measure on.
#[derive(Args)]
pub struct Thesis {
    /// One JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    request: thesis::Request,
}

/// Runs one of the commands.
pub fn run(command: &Real2Sim) -> Result<()> {
    let steps = Steps::new("{msg:40} {wide_bar} {percent} %, {elapsed} gone")?;
    match command {
        Real2Sim::Table(options) => {
            let findings = table::make(&options.request, &families(), &steps)?;
            steps.finish();
            let text = report::table(&findings);
            if let Some(folder) = &options.output.out {
                let json = serde_json::to_string(&findings)? + "\n";
                let page = report::table_page(&findings, &text)?;
                output::save(folder, &[("table.json", json), ("table.html", page)])?;
            }
            output::print(options.output.json, &findings, &text)
        }
        Real2Sim::Train(options) => {
            let findings = train::learn(&options.request, &families(), &steps)?;
            steps.finish();
            output::print(options.json, &findings, &report::trained(&findings))
        }
        Real2Sim::Compare(options) => {
            let findings = compare::compare(&options.request, &families(), &steps)?;
            steps.finish();
            let text = report::comparison(&findings);
            if let Some(folder) = &options.output.out {
                let json = serde_json::to_string(&findings)? + "\n";
                let page = report::comparison_page(&findings, &text)?;
                output::save(folder, &[("comparison.json", json), ("comparison.html", page)])?;
            }
            output::print(options.output.json, &findings, &text)
        }
        Real2Sim::Thesis(options) => {
            let findings = thesis::measure(&options.request, &families(), &steps)?;
            steps.finish();
            output::print(options.json, &findings, &report::thesis(&findings))
        }
    }
}
