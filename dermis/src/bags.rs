//! Bags: importing recordings of others, looking into bags, mending and cutting them.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use dermis_bag::{BagOptions, BagReader, Compression};
use dermis_operate::OperateError;
use dermis_operate::record::Level;
use dermis_operate::slice::{self, open};

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

/// Looking into bags, mending and cutting them.
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
    /// Look at every byte of a bag and say what is wrong; exits with 1 where something is.
    Check(Check),
    /// Copy a part of a bag into a new one.
    Slice(Slice),
    /// Write a bag anew with the message definitions of today. Bags of before are read as they are; who needs this are programs
    /// that do not know the old definitions, as those of ROS 2.
    Convert {
        /// Folder of a rosbag2 bag, or an .mcap file.
        bag: PathBuf,
        /// Folder of the new bag; must not exist yet.
        out: PathBuf,
        /// Compression of the chunks.
        #[arg(long, value_enum, default_value = "default")]
        compression: Level,
        /// Take what is whole of a bag whose recording was interrupted.
        #[arg(long)]
        recover: bool,
        /// One JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write labelled bags as tables (Parquet, NPZ), one row a frame, for people who train elsewhere.
    Export(Box<crate::export::Options>),
}

/// What to check, and whether to mend it.
#[derive(Args)]
pub struct Check {
    /// Folder of a rosbag2 bag, or an .mcap file.
    bag: PathBuf,
    /// Make a complete bag of what is whole, where something is wrong; the original is kept beside it.
    #[arg(long)]
    repair: bool,
    /// Folder of the repaired bag; where absent, it takes the place of the original.
    #[arg(short, long, requires = "repair", value_name = "DIR")]
    out: Option<PathBuf>,
    /// Exit with 3 where the bag is sound, but messages are missing in it, or it is not known whether some are.
    #[arg(long)]
    complete: bool,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// What to take over, and how to lay it out.
#[derive(Args)]
pub struct Slice {
    #[command(flatten)]
    request: slice::Request,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Does it, and prints what came of it.
pub fn run(command: &Bag) -> Result<()> {
    match command {
        Bag::Info { bag, recover, json } => info(&open(bag, *recover)?, *json),
        Bag::Check(options) => check(options),
        Bag::Export(options) => crate::export::run(options),
        Bag::Slice(options) => print(&slice::slice(&options.request)?, options.json),
        Bag::Convert { bag, out, compression, recover, json } => {
            let layout = BagOptions::default().compression((*compression).into());
            print(&dermis_bag::convert(&open(bag, *recover)?, out, &layout)?, *json)
        }
    }
}

/// What a bag holds, and of which skins.
fn info(reader: &BagReader, json: bool) -> Result<()> {
    let info = reader.info();
    let skins = reader.skins()?;
    if json {
        let mut value = serde_json::to_value(&info)?;
        value["skins"] = serde_json::to_value(&skins)?;
        println!("{value}");
        return Ok(());
    }
    print!("{info}");
    println!("skins     {}", skins.len());
    for skin in skins {
        println!("  {skin}");
    }
    Ok(())
}

fn print(value: &(impl serde::Serialize + std::fmt::Display), json: bool) -> Result<()> {
    if json {
        println!("{}", serde_json::to_string(value)?);
    } else {
        println!("{value}");
    }
    Ok(())
}

fn check(options: &Check) -> Result<()> {
    let report = dermis_bag::check(&options.bag)?;
    if report.is_sound() || !options.repair {
        print(&report, options.json)?;
        if report.is_sound() {
            if options.complete && !report.is_complete() {
                let missing = match report.missing() {
                    none if none.is_empty() => "its recorder did not count what it lost".to_owned(),
                    missing => missing,
                };
                return Err(OperateError::Incomplete(missing).into());
            }
            return Ok(());
        }
        bail!(
            "{} is not sound: `dermis bag check --repair` makes a complete bag of what is whole",
            options.bag.display()
        );
    }
    let layout = BagOptions::default().compression(Compression::Fast);
    let repaired = dermis_bag::repair(&options.bag, options.out.as_deref(), &layout)?;
    if options.json {
        println!("{}", serde_json::json!({ "found": report, "repaired": repaired }));
        return Ok(());
    }
    println!("{report}\n\n{}", repaired.bag);
    if let Some(original) = &repaired.original {
        println!("the original lies in {}", original.display());
    }
    Ok(())
}
