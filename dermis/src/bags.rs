//! Bags: importing recordings of others, and looking into bags.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use dermis_bag::BagReader;

/// Turns a recording into a labelled bag.
#[derive(Args)]
pub struct Import {
    /// Folder or file of the recording; what it is, is recognised.
    recording: PathBuf,
    /// Folder of the bag to write; must not exist yet.
    #[arg(short, long)]
    out: PathBuf,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Imports, and prints what was taken over, what is missing and what was assumed.
pub fn import(options: &Import) -> Result<()> {
    let report = dermis_testbed::import::auto(&options.recording, &options.out)?;
    if options.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        println!("{report}");
    }
    Ok(())
}

/// Looking into bags.
#[derive(Subcommand)]
pub enum Bag {
    /// What a bag holds.
    Info {
        /// Folder of a rosbag2 bag, or an .mcap file.
        bag: PathBuf,
        /// Read what is whole of a bag whose recording was interrupted.
        #[arg(long)]
        recover: bool,
        /// One JSON object.
        #[arg(long)]
        json: bool,
    },
}

/// Prints it.
pub fn run(command: &Bag) -> Result<()> {
    match command {
        Bag::Info { bag, recover, json } => {
            let reader = if *recover { BagReader::recover(bag)? } else { BagReader::open(bag)? };
            let info = reader.info();
            if *json {
                println!("{}", serde_json::to_string(&info)?);
            } else {
                println!("{info}");
            }
        }
    }
    Ok(())
}
