//! Other people's recordings as labelled rosbag2 bags.
//!
//! An imported bag holds `taxels` (readings), `ground_truth` (what touched the skin, with the stamps of the readings
//! that it belongs to), and the latched `skin_geometry` where a skin description exists. What had to be assumed or
//! made up, such as stamps that were not recorded, is in the [`ImportReport`] and in the bag's custom data.

mod e_skin;
mod eflesh;
mod mat;
mod tactile_fsi;
mod tanks;

use std::{
    fmt,
    path::{Path, PathBuf},
};

use dermis_bag::{BagError, BagInfo, BagQos, BagWriter};
use dermis_msgs::{
    ChannelLayout, Message, TypeSupport,
    builtin_interfaces::msg::Time,
    geometry_msgs::msg::{Point, Vector3},
    msg::{Contact, Indentation, IndentationContact, SkinGeometry, TaxelFrame},
    std_msgs::msg::Header,
};
use dermis_skin::{SkinDescription, SkinError};

pub use self::{
    e_skin::e_skin,
    eflesh::eflesh,
    tactile_fsi::tactile_fsi,
    tanks::{TankFrame, read_tank, tank},
};

/// Why a recording could not be imported. A bag that was begun is left without `metadata.yaml`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A value is not what the format says.
    #[error("{path}, {at}: {problem}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Line and column, or cell.
        at: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A file as a whole is not what the format says.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Nothing that an importer knows.
    #[error(
        "{path} is no recording that can be imported: known are an eFlesh run (a folder with sensor.csv and states.csv), a hydrogel skin (a folder with inp_*.csv and out_*.csv), impedance tomography of tanks (*Hz.csv, .txt that begins with #MEAS, .npz with phantomdata, .mat of MATLAB's level 5), and tactile_fsi files (presses as .xlsx, time series as .npz), or a folder of these"
    )]
    Unknown {
        /// The file or folder.
        path: PathBuf,
    },
    /// More than one recording.
    #[error("{path} holds {count} recordings, and a bag is made of one: name one of them, e.g. {first}")]
    Several {
        /// The folder.
        path: PathBuf,
        /// How many recordings lie in it.
        count: usize,
        /// The first of them.
        first: PathBuf,
    },
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The skin description that belongs to the recordings is wrong.
    #[error(transparent)]
    Skin(#[from] Box<SkinError>),
}

impl ImportError {
    fn read(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Read { path, source }
    }

    fn file(path: &Path, problem: impl Into<String>) -> Self {
        Self::File { path: path.into(), problem: problem.into() }
    }
}

/// What became of one recording; `Display` prints it for people.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ImportReport {
    /// What was imported.
    pub source: PathBuf,
    /// Data set, kind of recording, and licence.
    pub data_set: String,
    /// The bag that was written.
    pub bag: BagInfo,
    /// Readings of the skin while it was pressed or approached, as recorded.
    pub readings: u64,
    /// Readings of the untouched skin: see [`assumed`](Self::assumed) for where they come from.
    pub untouched: u64,
    /// Channels of a reading.
    pub channels: usize,
    /// Unit of the channels.
    pub unit: String,
    /// Presses.
    pub presses: u64,
    /// Distinct contact locations.
    pub locations: u64,
    /// \[s\] worst distance between a reading and the robot state that labels it; `None` where they share a row.
    pub worst_mismatch: Option<f64>,
    /// What had to be assumed or made up, a sentence each.
    pub assumed: Vec<String>,
    /// What the recording lacks, a sentence each.
    pub missing: Vec<String>,
}

impl fmt::Display for ImportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "imported  {}", self.source.display())?;
        writeln!(f, "data set  {}", self.data_set)?;
        writeln!(f, "bag       {}", self.bag.path.display())?;
        writeln!(
            f,
            "readings  {} pressed, {} untouched, {} channels in {}",
            self.readings, self.untouched, self.channels, self.unit
        )?;
        writeln!(f, "presses   {} at {} locations", self.presses, self.locations)?;
        if let Some(mismatch) = self.worst_mismatch {
            writeln!(f, "matching  every reading has a robot state within {:.1} ms", mismatch * 1e3)?;
        }
        for (title, lines) in [("assumed ", &self.assumed), ("missing ", &self.missing)] {
            for line in lines {
                writeln!(f, "{title}  {line}")?;
            }
        }
        Ok(())
    }
}

/// Imports the recording that is recognised at `path`, or below it where it is a folder of one, into the bag folder
/// `out`, which must not exist or be empty.
///
/// # Errors
/// Where nothing at `path` is recognised, or several recordings are; where the recording is damaged, or the bag cannot
/// be written.
pub fn auto(path: &Path, out: &Path) -> Result<ImportReport, ImportError> {
    let found = recordings(path)?;
    match found.as_slice() {
        [] => Err(ImportError::Unknown { path: path.into() }),
        [recording] if e_skin::recognises(recording) => e_skin(recording, out),
        [recording] if recording.is_dir() => eflesh(recording, out, &mut |_, _| {}),
        [recording] if tanks::recognises(recording) => tank(recording, out),
        [recording] => tactile_fsi(recording, out),
        [first, ..] => {
            Err(ImportError::Several { path: path.into(), count: found.len(), first: first.clone() })
        }
    }
}

/// The recordings at `path` or, where it is a folder, below it, in the order of their names: each can be given to
/// [`auto`].
///
/// # Errors
/// Where a folder cannot be read.
pub fn recordings(path: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    find(path, 0, &mut found)?;
    Ok(found)
}

/// Folders below which nothing is looked for: an eFlesh download is three deep.
const DEEPEST: usize = 6;

fn find(path: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<(), ImportError> {
    if path.is_file() {
        if tanks::recognises(path) || tactile_fsi::recognises(path) {
            found.push(path.into());
        }
        return Ok(());
    }
    if eflesh::recognises(path) || e_skin::recognises(path) {
        found.push(path.into());
        return Ok(());
    }
    if depth > DEEPEST {
        return Ok(());
    }
    let mut entries = Vec::new();
    for entry in std::fs::read_dir(path).map_err(ImportError::read(path))? {
        entries.push(entry.map_err(ImportError::read(path))?.path());
    }
    entries.sort();
    entries.iter().try_for_each(|entry| find(entry, depth + 1, found))
}

/// A labelled bag that is being written.
struct Target {
    writer: BagWriter,
    skin: Skin,
    session: String,
    sequence: u64,
    untouched: u64,
    readings: u64,
    layout_id: u32,
}

/// What of a skin its messages repeat.
struct Skin {
    name: String,
    frame_id: String,
    unit: String,
    channels: Vec<String>,
    /// `None` where too little is known of the skin for a description.
    description: Option<SkinDescription>,
}

impl Skin {
    fn described(text: &str, file: &str) -> Result<Self, ImportError> {
        let description = SkinDescription::from_toml(text, file).map_err(Box::new)?;
        Ok(Self {
            name: description.name.clone(),
            frame_id: description.frame_id.clone(),
            unit: description.unit.clone(),
            channels: description.channels().iter().map(|channel| channel.name.clone()).collect(),
            description: Some(description),
        })
    }

    /// Without a description it names the channels only.
    fn geometry(&self, start: i64) -> SkinGeometry {
        match &self.description {
            Some(description) => description.geometry_message(&description.surface(), start),
            None => SkinGeometry {
                header: Header { stamp: Time::from_nanos(start), frame_id: self.frame_id.clone() },
                skin: self.name.clone(),
                layout_id: ChannelLayout::id_of(&self.unit, self.channels.iter().map(String::as_str)),
                unit: self.unit.clone(),
                channels: self.channels.clone(),
                ..SkinGeometry::default()
            },
        }
    }
}

/// Labels of one instant.
#[derive(Clone)]
struct Label {
    press: u64,
    location: u32,
    repeat: u32,
    phase: u8,
    contact: Option<IndentationContact>,
}

impl Target {
    fn create(
        recording: &Path,
        out: &Path,
        session: &str,
        skin: Skin,
        start: i64,
    ) -> Result<Self, ImportError> {
        let mut writer = BagWriter::create(out)?;
        writer.set_custom("dermis.import.source", recording.display().to_string());
        writer.add_topic("taxels", TypeSupport::of::<TaxelFrame>(), BagQos::sensor_data())?;
        writer.add_topic("ground_truth", TypeSupport::of::<Indentation>(), BagQos::sensor_data())?;
        writer.add_topic("skin_geometry", TypeSupport::of::<SkinGeometry>(), BagQos::latched())?;
        let geometry = skin.geometry(start);
        writer.write("skin_geometry", &geometry, start)?;
        let layout_id = geometry.layout_id;
        Ok(Self {
            writer,
            skin,
            session: session.to_owned(),
            sequence: 0,
            untouched: 0,
            readings: 0,
            layout_id,
        })
    }

    fn header(&self, stamp: i64) -> Header {
        Header { stamp: Time::from_nanos(stamp), frame_id: self.skin.frame_id.clone() }
    }

    /// Writes a reading and its label under the same stamp.
    fn write(&mut self, stamp: i64, values: Vec<f32>, label: Label) -> Result<(), ImportError> {
        if label.phase == Indentation::PHASE_IDLE {
            self.untouched += 1;
        } else {
            self.readings += 1;
        }
        let frame = TaxelFrame {
            header: self.header(stamp),
            skin: self.skin.name.clone(),
            sequence: self.sequence,
            layout_id: self.layout_id,
            flags: values
                .iter()
                .map(|value| if value.is_finite() { 0 } else { TaxelFrame::FLAG_NOT_FINITE })
                .collect(),
            values,
            temperature: f32::NAN,
            device_time_us: 0,
        };
        self.sequence += 1;
        self.writer.write("taxels", &frame, stamp)?;
        let truth = Indentation {
            header: self.header(stamp),
            skin: self.skin.name.clone(),
            session: self.session.clone(),
            press: label.press,
            location: label.location,
            repeat: label.repeat,
            phase: label.phase,
            temperature: f32::NAN,
            gravity: Vector3::UNKNOWN,
            contacts: label.contact.into_iter().collect(),
        };
        self.writer.write("ground_truth", &truth, stamp)?;
        Ok(())
    }

    /// Writes a message of another topic.
    fn write_other<T: Message>(&mut self, topic: &str, message: &T, stamp: i64) -> Result<(), ImportError> {
        Ok(self.writer.write(topic, message, stamp)?)
    }

    fn finish(mut self, report: Facts, recording: &Path) -> Result<ImportReport, ImportError> {
        self.writer.set_custom("dermis.import.data_set", &report.data_set);
        self.writer.set_custom("dermis.import.assumed", report.assumed.join("; "));
        self.writer.set_custom("dermis.import.missing", report.missing.join("; "));
        let bag = self.writer.finish()?;
        Ok(ImportReport {
            source: recording.into(),
            data_set: report.data_set,
            bag,
            readings: self.readings,
            untouched: self.untouched,
            channels: self.skin.channels.len(),
            unit: self.skin.unit,
            presses: report.presses,
            locations: report.locations,
            worst_mismatch: report.worst_mismatch,
            assumed: report.assumed,
            missing: report.missing,
        })
    }
}

/// What an importer knows in the end and the writer doesn't.
struct Facts {
    data_set: String,
    presses: u64,
    locations: u64,
    worst_mismatch: Option<f64>,
    assumed: Vec<String>,
    missing: Vec<String>,
}

fn unknown_point() -> Point {
    Point::UNKNOWN
}

/// A contact that pushes straight in with `force` \[N\], NaN where it was not measured.
fn pressed(position: Point, force: f64, depth: f64) -> IndentationContact {
    let known = force.is_finite();
    IndentationContact::sphere(
        position,
        Vector3 { x: 0.0, y: 0.0, z: 1.0 },
        if known { Vector3 { x: 0.0, y: 0.0, z: -force } } else { Vector3::UNKNOWN },
        if known { Contact::FORCE_NORMAL } else { Contact::FORCE_NONE },
        depth,
        f64::NAN,
    )
}

/// Nanoseconds of a time in seconds since the epoch; `None` outside of what stamps can hold.
fn stamp_of(seconds: f64) -> Option<i64> {
    let (whole, rest) = (seconds.floor(), seconds - seconds.floor());
    // 32-bit seconds: what a ROS stamp holds.
    (0.0..f64::from(i32::MAX))
        .contains(&whole)
        .then(|| whole as i64 * 1_000_000_000 + (rest * 1e9).round() as i64)
}

/// Readings of the untouched skin are repeated like this before a press: a tare averages over time, and a device that
/// streams would have sent as many. \[ns\]
const IDLE_STEP: i64 = 200_000_000;
/// How often: spans the tare of the skin descriptions, with a frame to spare.
const IDLE_REPEATS: i64 = 4;

#[cfg(test)]
mod tests;
