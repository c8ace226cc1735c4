//! Copies a part of a bag into a new one.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use dermis_bag::{BagError, BagInfo, BagOptions, BagReader, Filter};
use serde::{Deserialize, Serialize};

use crate::quantity::{duration, size};
use crate::record::Level;
use crate::{OperateError, written};

/// What to take over, and how to lay it out.
#[derive(Debug, Clone, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Request {
    /// Folder of a rosbag2 bag, or an .mcap file.
    pub bag: PathBuf,
    /// Folder of the new bag; must not exist yet.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Only these topics, by their full name or its end.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// From here on: seconds after the start of the bag, or since 1970 (from 1000000000 on).
    #[arg(long, value_name = "S")]
    pub from: Option<f64>,
    /// Before here, as --from.
    #[arg(long, value_name = "S")]
    pub to: Option<f64>,
    /// Begin a new file after this many bytes, e.g. 1GiB.
    #[arg(long, value_parser = size, value_name = "SIZE")]
    #[serde(with = "written::optional_size")]
    pub split_size: Option<u64>,
    /// Begin a new file after this time, e.g. 10min.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    #[serde(with = "written::duration")]
    pub split_time: Option<Duration>,
    /// Compression of the chunks.
    #[arg(long, value_enum, default_value = "default")]
    pub compression: Level,
    /// Take what is whole of a bag whose recording was interrupted.
    #[arg(long)]
    pub recover: bool,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            bag: PathBuf::new(),
            out: PathBuf::new(),
            topics: Vec::new(),
            from: None,
            to: None,
            split_size: None,
            split_time: None,
            compression: Level::Default,
            recover: false,
        }
    }
}

/// Opens a bag; `recover` takes what is whole of one whose recording was interrupted.
///
/// # Errors
///
/// Where it cannot be read.
pub fn open(bag: &Path, recover: bool) -> Result<BagReader, BagError> {
    if recover { BagReader::recover(bag) } else { BagReader::open(bag) }
}

/// Copies; what the new bag holds.
///
/// # Errors
///
/// Where the bag is empty or cannot be read, has no such topic, or the new one cannot be written.
pub fn slice(request: &Request) -> Result<BagInfo, OperateError> {
    let reader = open(&request.bag, request.recover)?;
    let Some((start, _)) = reader.span() else {
        return Err(OperateError::NothingToSlice(request.bag.clone()));
    };
    let mut filter = Filter::default();
    if !request.topics.is_empty() {
        let topics = request.topics.iter().map(|name| Ok(reader.topic(name)?.name.clone()));
        filter = filter.topics(topics.collect::<Result<Vec<_>, BagError>>()?);
    }
    let time = |seconds: Option<f64>, none: i64| seconds.map_or(none, |seconds| moment(seconds, start));
    let (from, to) = (time(request.from, i64::MIN), time(request.to, i64::MAX));
    if from >= to {
        return Err(OperateError::FromAfterTo);
    }
    let layout = BagOptions::default()
        .compression(request.compression.into())
        .split_bytes(request.split_size)
        .split_ns(request.split_time.and_then(|time| i64::try_from(time.as_nanos()).ok()));
    let cut = [("sliced from".to_owned(), request.bag.display().to_string())];
    Ok(dermis_bag::copy(&reader, &request.out, filter.between(from, to), &layout, cut)?)
}

/// Nanoseconds since 1970 of a time that is given in seconds, after the start of a bag or since 1970. Bags of the first
/// 31 years of that time don't exist, bags of 31 years neither.
fn moment(seconds: f64, start: i64) -> i64 {
    let nanos = (seconds * 1e9) as i64;
    if seconds < 1e9 { start.saturating_add(nanos) } else { nanos }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_after_the_start_or_since_1970() {
        let start = 1_700_000_000_000_000_000;
        assert_eq!(moment(2.5, start), start + 2_500_000_000);
        assert_eq!(moment(1.7e9, start), start);
        assert_eq!(moment(0.0, start), start);
    }
}
