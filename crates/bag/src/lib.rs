//! rosbag2 bags in MCAP: write and read.
//!
//! A bag is a folder as `ros2 bag record` makes it: `<name>/<name>_0.mcap` with zstd-compressed chunks and
//! `<name>/metadata.yaml` (version 9, what Jazzy and Kilted write). A message is stored as the CDR bytes that
//! went over the bus; its schema is the full `ros2msg` text, so that a reader needs nothing but the bag.
//!
//! [`BagWriter`] writes `metadata.yaml` last, in [`BagWriter::finish`]: a bag without one is a recording that was
//! interrupted, and [`BagReader::open`] says so; [`BagReader::recover`] reads what is whole of it.
//! [`BagReader`] streams chunk by chunk, so its memory does not grow with the file; it checks the checksum of
//! every chunk before it hands out a message of it, and a typed read checks the type's name and its RIHS01 hash
//! (or, where the bag has none, the definition) before it decodes. Messages of before are handed out as they are defined today;
//! [`convert`] writes a bag in which they are.
//!
//! ```no_run
//! use dermis_bag::{BagReader, BagWriter};
//! use dermis_msgs::msg::TaxelFrame;
//!
//! # fn main() -> Result<(), dermis_bag::BagError> {
//! let mut writer = BagWriter::create("presses")?;
//! writer.write("taxels", &TaxelFrame::default(), 1_700_000_000_000_000_000)?;
//! writer.finish()?;
//!
//! let reader = BagReader::open("presses")?;
//! for frame in reader.read::<TaxelFrame>("taxels")? {
//!     println!("{:?}", frame?.message.values);
//! }
//! # Ok(())
//! # }
//! ```

mod ament;
mod check;
mod definition;
mod error;
mod frames;
mod guard;
mod info;
mod losses;
mod metadata;
mod order;
mod patience;
mod qos;
mod reader;
mod recorder;
mod recovery;
mod repair;
mod resume;
mod skins;
mod versions;
mod writer;

pub use ament::definition_of;
pub use check::{BagReport, Finding, MissingFrames, Severity, check};
pub use error::BagError;
pub use info::{BagInfo, TopicInfo};
pub use losses::{RecordedLosses, TopicLosses};
pub use order::MessagesByTime;
pub use qos::{BagQos, Durability, Reliability};
pub use reader::{BagMessage, BagReader, Filter, Messages, Topic, Typed, TypedMessages};
pub use recorder::{Recorded, Recorder, RecorderOptions, RecorderState, TopicSink, TopicState};
pub use repair::{Repaired, copy, repair};
pub use resume::next_free;
pub use skins::{BagSkin, SkinChoice, SkinChoiceError};
pub use versions::convert;
pub use writer::{BagOptions, BagWriter, Compression, TopicId};
