//! Impedance tomography of tanks of water with 16 electrodes on their rim, adjacent drive, adjacent reading: 208 readings a frame.
//!
//! Four formats: the deformed tanks of Ottawa (`.npz` with `phantomdata_*` and the electrodes' positions; EIDORS data set of 2008), the
//! tank of Manchester (`.txt` that begins with `#MEAS`; EIDORS data set of 2004), the tank of PyEIDORS (`*Hz.csv`, pairs of real and
//! imaginary part), and MATLAB files of level 5, whose variables with 256 rows are frames: 16 drives of 16 readings, of which those of the
//! driven electrodes are left out (EIDORS data sets of 2005 and 2006). What lies in a tank is in the names of files and folders.

use std::{
    fs::File,
    io::{BufRead as _, BufReader, Read as _},
    path::Path,
};

use dermis_msgs::msg::Indentation;

use super::{Facts, ImportError, ImportReport, Label, Skin, Target, mat};

const ELECTRODES: usize = 16;
/// Readings of a drive: pairs without a driven electrode.
const EACH: usize = ELECTRODES - 3;
const READINGS: usize = ELECTRODES * EACH;
/// \[ns since the epoch\] 2008-01-01: the files have no dates that could be relied on.
const EPOCH: i64 = 1_199_145_600_000_000_000;
/// \[ns\] between frames.
const FRAME_STEP: i64 = 1_000_000_000;
/// Where electrodes are, in the archives of Ottawa; a column for each frame.
const POSITIONS: &str = "phantomdata_true_electrode_positions.npy";
const FRAMES: &str = "phantomdata_";
/// Bytes of an array in such an archive at most.
const MOST_BYTES: u64 = 1 << 20;

/// One frame of a tank.
#[derive(Debug, Clone, PartialEq)]
pub struct TankFrame {
    /// Number of the measurement within the file.
    pub name: String,
    /// Drive by drive, each beginning at the pair behind the driven one.
    pub readings: Vec<f64>,
    /// Measured positions of the electrodes, counter-clockwise about the middle, in a unit of the authors'; `None` where the tank is
    /// round.
    pub rim: Option<Vec<[f64; 2]>>,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Ottawa,
    Manchester,
    Matlab,
    PyEidors,
}

fn kind(path: &Path) -> Option<Kind> {
    let name = path.file_name()?.to_string_lossy();
    let opened = || dermis_io::open_at_most(path, dermis_io::TABLE).ok();
    if name.ends_with("Hz.csv") {
        Some(Kind::PyEidors)
    } else if name.ends_with(".txt") {
        let mut start = [0; 5];
        opened()?.read_exact(&mut start).ok()?;
        (&start == b"#MEAS").then_some(Kind::Manchester)
    } else if name.ends_with(".mat") {
        let mut start = [0; 7];
        opened()?.read_exact(&mut start).ok()?;
        mat::recognises(&start).then_some(Kind::Matlab)
    } else if name.ends_with(".npz") {
        let archive = zip::ZipArchive::new(BufReader::new(opened()?)).ok()?;
        archive.file_names().filter_map(Result::ok).any(|entry| entry == POSITIONS).then_some(Kind::Ottawa)
    } else {
        None
    }
}

pub(super) fn recognises(path: &Path) -> bool {
    path.is_file() && kind(path).is_some()
}

/// The frames of a file, which [`auto`](super::auto) imports into a bag.
///
/// # Errors
/// File and place of what is wrong.
pub fn read_tank(file: &Path) -> Result<Vec<TankFrame>, ImportError> {
    let frames = match kind(file) {
        Some(Kind::Ottawa) => ottawa(file)?,
        Some(Kind::Manchester) => vec![manchester(file)?],
        Some(Kind::Matlab) => matlab(file)?,
        Some(Kind::PyEidors) => py_eidors(file)?,
        None => return Err(ImportError::Unknown { path: file.into() }),
    };
    for frame in &frames {
        if frame.readings.len() != READINGS {
            let problem =
                format!("has {} readings, and a frame of 16 electrodes has {READINGS}", frame.readings.len());
            return Err(ImportError::file(file, problem));
        }
    }
    Ok(frames)
}

/// Lines that hold anything, with their numbers and numbers.
fn numbers(
    file: &Path,
    separator: char,
    is_data: &mut dyn FnMut(&str) -> bool,
) -> Result<Vec<(usize, Vec<f64>)>, ImportError> {
    let handle = dermis_io::open_at_most(file, dermis_io::TABLE).map_err(ImportError::read(file))?;
    let mut rows = Vec::new();
    for (index, line) in BufReader::new(handle).lines().enumerate() {
        let line = line.map_err(ImportError::read(file))?;
        if !is_data(line.trim()) {
            continue;
        }
        let parse = |text: &str| {
            text.parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(|| ImportError::Value {
                path: file.into(),
                at: format!("line {}", index + 1),
                problem: format!("\"{}\" is not a finite number", text.chars().take(40).collect::<String>()),
            })
        };
        let fields = line.split(separator).map(str::trim).filter(|text| !text.is_empty());
        rows.push((index + 1, fields.map(parse).collect::<Result<Vec<f64>, ImportError>>()?));
    }
    Ok(rows)
}

fn py_eidors(file: &Path) -> Result<Vec<TankFrame>, ImportError> {
    let rows = numbers(file, ',', &mut |line| !line.is_empty())?;
    let columns = rows.first().map_or(0, |(_, row)| row.len());
    for (line, row) in &rows {
        if row.len() != columns || columns % 2 != 0 || columns == 0 {
            let problem = format!(
                "has {} numbers, and pairs of real and imaginary part belong there, as many as in line 1",
                row.len()
            );
            return Err(ImportError::Value { path: file.into(), at: format!("line {line}"), problem });
        }
    }
    // The sign is lost in the device's phase, and alike for all pairs of an empty tank.
    let frame = |at: usize| TankFrame {
        name: at.to_string(),
        readings: rows.iter().map(|(_, row)| row[2 * at].hypot(row[2 * at + 1])).collect(),
        rim: None,
    };
    Ok((0..columns / 2).map(frame).collect())
}

fn manchester(file: &Path) -> Result<TankFrame, ImportError> {
    let mut started = false;
    let rows = numbers(file, ' ', &mut |line| {
        let data = started && !line.is_empty() && !line.starts_with('#');
        started |= line.starts_with("#Start");
        data
    })?;
    let mut readings = Vec::with_capacity(rows.len());
    for (line, row) in rows {
        let at = format!("line {line}");
        let [real, _, current] = row[..] else {
            let problem =
                format!("has {} numbers, and real part, imaginary part and current belong there", row.len());
            return Err(ImportError::Value { path: file.into(), at, problem });
        };
        if current == 0.0 {
            let problem = "has the current 0, by which nothing can be divided".to_owned();
            return Err(ImportError::Value { path: file.into(), at, problem });
        }
        readings.push(real / current);
    }
    // The files of 2004 end with their last line twice.
    if let [.., before, last] = readings[..]
        && readings.len() == READINGS + 1
        && before == last
    {
        readings.pop();
    }
    Ok(TankFrame { name: "0".to_owned(), readings, rim: None })
}

fn ottawa(file: &Path) -> Result<Vec<TankFrame>, ImportError> {
    let wrong = |problem: String| ImportError::file(file, problem);
    let handle = dermis_io::open_at_most(file, dermis_io::TABLE).map_err(ImportError::read(file))?;
    let mut archive = zip::ZipArchive::new(BufReader::new(handle))
        .map_err(|error| wrong(format!("is not a readable .npz archive: {error}")))?;
    let mut names: Vec<String> = archive
        .file_names()
        .filter_map(Result::ok)
        .filter(|name| name.starts_with(FRAMES) && *name != POSITIONS)
        .map(std::borrow::Cow::into_owned)
        .collect();
    names.sort();
    // Pairs of real and imaginary part, a row for each electrode and a column for each frame.
    let positions = array(file, &mut archive, POSITIONS, ELECTRODES * names.len() * 2)?;
    let mut frames = Vec::new();
    for (at, name) in names.iter().enumerate() {
        let whole = array(file, &mut archive, name, ELECTRODES * ELECTRODES)?;
        let rim = (0..ELECTRODES)
            .map(|electrode| {
                let from = (electrode * names.len() + at) * 2;
                [positions[from], positions[from + 1]]
            })
            .collect();
        frames.push(TankFrame {
            name: name.trim_start_matches(FRAMES).trim_end_matches(".npy").to_owned(),
            readings: read_pairs().map(|index| whole[index]).collect(),
            rim: Some(rim),
        });
    }
    Ok(frames)
}

/// Frames in the variables of a MATLAB file, one a column. Of complex ones the magnitude is taken, as the sign is lost in the device's
/// phase.
fn matlab(file: &Path) -> Result<Vec<TankFrame>, ImportError> {
    let bytes = dermis_io::read(file, dermis_io::TABLE).map_err(ImportError::read(file))?;
    let variables = mat::variables(file, &bytes)?;
    let mut frames = Vec::new();
    for variable in variables.iter().filter(|variable| variable.rows == ELECTRODES * ELECTRODES) {
        for column in 0..variable.columns {
            let name = if variable.columns == 1 {
                variable.name.clone()
            } else {
                format!("{}({})", variable.name, column + 1)
            };
            let from = column * variable.rows;
            let reading = |index: usize| {
                let real = variable.real[from + index];
                variable.imaginary.as_ref().map_or(real, |imaginary| real.hypot(imaginary[from + index]))
            };
            let readings: Vec<f64> = read_pairs().map(reading).collect();
            if let Some(bad) = readings.iter().find(|value| !value.is_finite()) {
                let at = format!("variable `{}`, column {}", variable.name, column + 1);
                let problem = format!("has the reading {bad}, and finite ones belong there");
                return Err(ImportError::Value { path: file.into(), at, problem });
            }
            frames.push(TankFrame { name, readings, rim: None });
        }
    }
    if frames.is_empty() {
        let sizes = variables.iter().map(|v| format!("`{}` [{}, {}]", v.name, v.rows, v.columns));
        let sizes = sizes.collect::<Vec<_>>().join(", ");
        let has = if sizes.is_empty() { "none of numbers".to_owned() } else { sizes };
        let problem = format!(
            "has no variable with 256 rows, which a frame of 16 electrodes with adjacent drive has; its variables are {has}"
        );
        return Err(ImportError::file(file, problem));
    }
    Ok(frames)
}

/// Where the readings of a frame lie among 16 drives of 16 readings, those of driven electrodes among them.
fn read_pairs() -> impl Iterator<Item = usize> {
    (0..ELECTRODES).flat_map(|drive| {
        (2..ELECTRODES - 1).map(move |step| drive * ELECTRODES + (drive + step) % ELECTRODES)
    })
}

/// So many numbers of an array of `float64` or `complex128` (two each), row by row however it is stored. (The reader of other recordings
/// knows no complex numbers.)
fn array(
    file: &Path,
    archive: &mut zip::ZipArchive<BufReader<File>>,
    name: &str,
    expected: usize,
) -> Result<Vec<f64>, ImportError> {
    let wrong = |problem: String| ImportError::file(file, format!("array {name}: {problem}"));
    let entry = archive.by_name(name).map_err(|error| wrong(error.to_string()))?;
    let mut bytes = Vec::new();
    entry.take(MOST_BYTES).read_to_end(&mut bytes).map_err(|error| wrong(error.to_string()))?;
    // Format 1.0 of NumPy: magic, version, length of the header, header.
    let length = bytes.get(8..10).map_or(0, |l| usize::from(u16::from_le_bytes([l[0], l[1]])));
    let header = bytes.get(10..10 + length).filter(|_| bytes.starts_with(b"\x93NUMPY\x01"));
    let header =
        String::from_utf8_lossy(header.ok_or_else(|| wrong("is not of NumPy's format 1".to_owned()))?);
    let pairs = header.contains("'<c16'");
    if !pairs && !header.contains("'<f8'") {
        return Err(wrong(format!("has another type than float64 or complex128: {}", header.trim())));
    }
    let values: Vec<f64> =
        bytes[10 + length..].as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    if values.len() != expected || values.iter().any(|value| !value.is_finite()) {
        return Err(wrong(format!("has {} numbers, and {expected} finite ones belong there", values.len())));
    }
    if !header.contains("'fortran_order': True") {
        return Ok(values);
    }
    // Only the positions have two dimensions that count.
    let (width, rows) = (if pairs { 2 } else { 1 }, if pairs { ELECTRODES } else { 1 });
    let columns = values.len() / width / rows;
    let order = (0..rows).flat_map(|row| (0..columns).map(move |column| column * rows + row));
    Ok(order.flat_map(|at| values[at * width..(at + 1) * width].to_vec()).collect())
}

/// Imports the frames of one file into the bag folder `out_dir`.
///
/// Channels are `d0.r2` to `d15.r13`: `d` the first of the driven pair, `r` the first of the pair that is read. Readings are volts where
/// the file has volts of a known drive, and volts over the current where it has both; the tanks of Ottawa and MATLAB files have a unit of their own. Nothing
/// touches a tank: every frame is one of an untouched skin. Frames are stamped 1 s apart from 2008-01-01 on.
///
/// # Errors
/// File and place of what is wrong, or why the bag cannot be written.
pub fn tank(file: &Path, out_dir: &Path) -> Result<ImportReport, ImportError> {
    let frames = read_tank(file)?;
    let (unit, licence) = match kind(file) {
        Some(Kind::Manchester) => ("Ohm", "EIDORS sample data, Manchester 2004, GPL 2"),
        Some(Kind::PyEidors) => ("V", "PyEIDORS, MIT"),
        Some(Kind::Matlab) => ("1", "EIDORS sample data, GPL 2"),
        _ => ("1", "EIDORS sample data, Ottawa 2008, GPL 2"),
    };
    let names = (0..ELECTRODES).flat_map(|drive| {
        (2..ELECTRODES - 1).map(move |step| format!("d{drive}.r{}", (drive + step) % ELECTRODES))
    });
    let skin = Skin {
        name: "tank".to_owned(),
        frame_id: "tank_link".to_owned(),
        unit: unit.to_owned(),
        channels: names.collect(),
        description: None,
    };
    let session = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut target = Target::create(file, out_dir, &session, skin, EPOCH)?;
    for (at, frame) in frames.iter().enumerate() {
        let stamp = EPOCH + at as i64 * FRAME_STEP;
        let label =
            Label { press: at as u64, location: 0, repeat: 0, phase: Indentation::PHASE_IDLE, contact: None };
        target.write(stamp, frame.readings.iter().map(|value| *value as f32).collect(), label)?;
    }
    let order: Vec<&str> = frames.iter().map(|frame| frame.name.as_str()).collect();
    let facts = Facts {
        data_set: format!("tank with 16 electrodes ({licence})"),
        presses: 0,
        locations: 0,
        worst_mismatch: None,
        assumed: vec![
            format!("frames are {}, in this order, stamped 1 s apart", order.join(", ")),
            "each drive is between neighbours, and readings begin at the pair behind it".to_owned(),
        ],
        missing: vec!["what lies in the tank, but for the names of file and folder".to_owned()],
    };
    target.finish(facts, file)
}
