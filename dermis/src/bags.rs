//! Bags: importing recordings of others, looking into bags, mending and cutting them.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use dermis_bag::{BagOptions, BagReader, Compression, Filter};
use dermis_operate::OperateError;
use dermis_operate::quantity::{duration, size};
use dermis_operate::record::Level;

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
    /// Folder of a rosbag2 bag, or an .mcap file.
    bag: PathBuf,
    /// Folder of the new bag; must not exist yet.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Only these topics, by their full name or its end.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    topics: Vec<String>,
    /// From here on: seconds after the start of the bag, or since 1970 (from 1000000000 on).
    #[arg(long, value_name = "S")]
    from: Option<f64>,
    /// Before here, as --from.
    #[arg(long, value_name = "S")]
    to: Option<f64>,
    /// Begin a new file after this many bytes, e.g. 1GiB.
    #[arg(long, value_parser = size, value_name = "SIZE")]
    split_size: Option<u64>,
    /// Begin a new file after this time, e.g. 10min.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    split_time: Option<Duration>,
    /// Compression of the chunks.
    #[arg(long, value_enum, default_value = "default")]
    compression: Level,
    /// Take what is whole of a bag whose recording was interrupted.
    #[arg(long)]
    recover: bool,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

fn open(bag: &Path, recover: bool) -> Result<BagReader, dermis_bag::BagError> {
    if recover { BagReader::recover(bag) } else { BagReader::open(bag) }
}

/// Does it, and prints what came of it.
pub fn run(command: &Bag) -> Result<()> {
    match command {
        Bag::Info { bag, recover, json } => info(&open(bag, *recover)?, *json),
        Bag::Check(options) => check(options),
        Bag::Export(options) => crate::export::run(options),
        Bag::Slice(options) => slice(options),
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

fn slice(options: &Slice) -> Result<()> {
    let reader = open(&options.bag, options.recover)?;
    let Some((start, _)) = reader.span() else {
        bail!("{} has no messages", options.bag.display());
    };
    let mut filter = Filter::default();
    if !options.topics.is_empty() {
        let topics = options.topics.iter().map(|name| Ok(reader.topic(name)?.name.clone()));
        filter = filter.topics(topics.collect::<Result<Vec<_>>>()?);
    }
    let time = |seconds: Option<f64>, none: i64| seconds.map_or(none, |seconds| moment(seconds, start));
    let (from, to) = (time(options.from, i64::MIN), time(options.to, i64::MAX));
    if from >= to {
        bail!("--from must lie before --to");
    }
    let layout = BagOptions::default()
        .compression(options.compression.into())
        .split_bytes(options.split_size)
        .split_ns(options.split_time.and_then(|time| i64::try_from(time.as_nanos()).ok()));
    let cut = [("sliced from".to_owned(), options.bag.display().to_string())];
    let info = dermis_bag::copy(&reader, &options.out, filter.between(from, to), &layout, cut)?;
    print(&info, options.json)
}

/// Nanoseconds since 1970 of a time that is given in seconds, after the start of a bag or since 1970. Bags of the first
/// 31 years of that time don't exist, bags of 31 years neither.
fn moment(seconds: f64, start: i64) -> i64 {
    let nanos = (seconds * 1e9) as i64;
    if seconds < 1e9 { start.saturating_add(nanos) } else { nanos }
}
