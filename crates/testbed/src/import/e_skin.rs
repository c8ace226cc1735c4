//! Hydrogel skins read by electrical impedance tomography (github DSHardman/Variable-Sensitivity-E-Skins, which belongs to "Variable
//! Sensitivity Multimaterial Robotic E-Skins using Electrical Impedance Tomography"; no licence is stated): a conductive sheet, plain or
//! patterned, pressed at random locations by a robot.
//!
//! A recording is a folder with two tables without header rows: `inp_*.csv` has 192 numbers a press, `out_*.csv` the robot's x, y and z in m.

use std::{
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
};

use dermis_msgs::{
    builtin_interfaces::msg::Time,
    geometry_msgs::msg::{Point, PointStamped},
    msg::Indentation,
    std_msgs::msg::Header,
};

use super::{Facts, IDLE_REPEATS, IDLE_STEP, ImportError, ImportReport, Label, Skin, Target, pressed};

const SKIN: &str = include_str!("../../../../launch/skins/e-skin-hydrogel.toml");
/// \[ns since the epoch\] 2022-01-01: the recordings have no date.
const EPOCH: i64 = 1_640_995_200_000_000_000;
/// \[ns\] between presses.
const PRESS_STEP: i64 = 2_000_000_000;
/// Numbers of a press in the two tables.
const COLUMNS: [usize; 2] = [192, 3];
/// What editors put before a table in UTF-8.
const MARK: char = '\u{feff}';

/// The one table in a folder whose name begins so.
fn table(folder: &Path, prefix: &str) -> Option<PathBuf> {
    let mut found =
        std::fs::read_dir(folder).ok()?.filter_map(Result::ok).map(|entry| entry.path()).filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(prefix) && name.ends_with(".csv") && path.is_file()
        });
    let one = found.next()?;
    found.next().is_none().then_some(one)
}

pub(super) fn recognises(path: &Path) -> bool {
    path.is_dir() && table(path, "inp_").is_some() && table(path, "out_").is_some()
}

/// Rows of so many finite numbers.
fn read(path: &Path, columns: usize) -> Result<Vec<Vec<f64>>, ImportError> {
    let file = dermis_io::open_at_most(path, dermis_io::TABLE).map_err(ImportError::read(path))?;
    let mut rows = Vec::new();
    for (index, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(ImportError::read(path))?;
        let line = line.trim_start_matches(MARK).trim();
        if line.is_empty() {
            continue;
        }
        let wrong = |at: String, problem: String| ImportError::Value { path: path.into(), at, problem };
        let at = format!("line {}", index + 1);
        let mut row = Vec::with_capacity(columns);
        for (column, text) in line.split(',').enumerate() {
            let text = text.trim();
            let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
            row.push(number.ok_or_else(|| {
                let shown: String = text.chars().take(40).collect();
                wrong(format!("{at}, column {}", column + 1), format!("\"{shown}\" is not a finite number"))
            })?);
        }
        if row.len() != columns {
            return Err(wrong(at, format!("has {} columns, and {columns} belong there", row.len())));
        }
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(ImportError::file(path, "holds no rows"));
    }
    Ok(rows)
}

/// Imports the presses of one skin into the bag folder `out_dir`.
///
/// - Readings are as in the table, in counts of a converter that is not published. The authors have taken the reading before each
///   press as its zero; four readings of zero, 0.2 s apart, stand for it before each press.
/// - Position: metres from the middle of the pressed rectangle, axes along the robot's, z out of the surface. Each press is a location
///   of its own.
/// - Force and depth were not recorded: NaN. The robot's position is on topic `probe`, z included.
/// - Times were not recorded: presses are stamped 2 s apart from 2022-01-01 on, in the order of the table.
///
/// # Errors
/// File, line and column of what is wrong, or why the bag cannot be written.
pub fn e_skin(folder: &Path, out_dir: &Path) -> Result<ImportReport, ImportError> {
    let (Some(inputs), Some(outputs)) = (table(folder, "inp_"), table(folder, "out_")) else {
        return Err(ImportError::Unknown { path: folder.into() });
    };
    let (readings, locations) = (read(&inputs, COLUMNS[0])?, read(&outputs, COLUMNS[1])?);
    if readings.len() != locations.len() {
        let problem =
            format!("has {} rows where {} has {}", readings.len(), outputs.display(), locations.len());
        return Err(ImportError::file(&inputs, problem));
    }
    let middle = [0, 1].map(|axis: usize| {
        let of = |pick: fn(f64, f64) -> f64| locations.iter().map(|place| place[axis]).reduce(pick);
        f64::midpoint(of(f64::min).unwrap_or_default(), of(f64::max).unwrap_or_default())
    });
    let stem = inputs.file_stem().unwrap_or_default().to_string_lossy();
    let session = stem.trim_start_matches("inp_");
    let skin = Skin::described(SKIN, "e-skin-hydrogel.toml")?;
    let mut target = Target::create(folder, out_dir, session, skin, EPOCH)?;
    for (press, (reading, place)) in readings.iter().zip(&locations).enumerate() {
        let stamp = EPOCH + (press as i64 + 1) * PRESS_STEP;
        let location = u32::try_from(press).unwrap_or(u32::MAX);
        let label = |phase, contact| Label { press: press as u64, location, repeat: 0, phase, contact };
        for back in (1..=IDLE_REPEATS).rev() {
            let idle = label(Indentation::PHASE_IDLE, None);
            target.write(stamp - back * IDLE_STEP, vec![0.0; COLUMNS[0]], idle)?;
        }
        let position = Point { x: place[0] - middle[0], y: place[1] - middle[1], z: 0.0 };
        let contact = pressed(position, f64::NAN, f64::NAN);
        let values = reading.iter().map(|value| *value as f32).collect();
        target.write(stamp, values, label(Indentation::PHASE_HOLD, Some(contact)))?;
        let probe = PointStamped {
            header: Header { stamp: Time::from_nanos(stamp), frame_id: "robot".into() },
            point: Point { x: place[0], y: place[1], z: place[2] },
        };
        target.write_other("probe", &probe, stamp)?;
    }
    target.finish(facts(session, middle, locations.len() as u64), folder)
}

fn facts(session: &str, [x, y]: [f64; 2], presses: u64) -> Facts {
    Facts {
        data_set: format!("Variable Sensitivity E-Skins, {session} (Hardman et al.; no licence stated)"),
        presses,
        locations: presses,
        worst_mismatch: None,
        assumed: vec![
            format!(
                "the origin is the middle of the pressed rectangle, robot x {:.2} and y {:.2} mm; axes along the robot's, z out of the \
                 surface",
                x * 1e3,
                y * 1e3
            ),
            "readings are differences from the untouched skin before each press, as the authors wrote them; the untouched skin is \
             four readings of zero before each"
                .to_owned(),
            "stamps are made up: 2 s from press to press".to_owned(),
        ],
        missing: vec![
            "force and depth: both are NaN; topic probe keeps the robot's height".to_owned(),
            "the unit of the readings, and which electrodes each belongs to".to_owned(),
        ],
    }
}
