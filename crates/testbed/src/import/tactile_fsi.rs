//! Tactile Perception through Fluid-Solid Interaction (Goshtasbi et al., 2025; github SDUSoftRobotics/2025_TactileFSI,
//! CC BY 4.0): a fluid-filled bore or channel in silicone with a pressure sensor at either end.
//!
//! Presses are sheets of peaks (`.xlsx`), one row a press; time series are the logged volts (`.npz` with `volts`
//! of three columns: load cell, left and right pressure, and `fs`).

mod series;
mod sweeps;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::BufReader,
    path::Path,
};

use calamine::{Data, DataType as _, Reader as _, Xlsx};
use dermis_msgs::{geometry_msgs::msg::Point, msg::Indentation};

use super::{Facts, IDLE_REPEATS, IDLE_STEP, ImportError, ImportReport, Label, Skin, Target, pressed};
use series::time_series;

const LINE: &str = include_str!("../../../../launch/skins/tactile-fsi-line.toml");
const PAD: &str = include_str!("../../../../launch/skins/tactile-fsi-pad.toml");
const LICENCE: &str = "Goshtasbi et al., Tactile Perception through Fluid-Solid Interaction, 2025, CC BY 4.0";

/// \[ns since the epoch\] 2025-01-01: the recordings have no date.
const EPOCH: i64 = 1_735_689_600_000_000_000;
/// \[ns\] between the presses of a sheet.
const PRESS_STEP: i64 = 1_000_000_000;
/// \[N\] above the load cell's rest from which on something touches, and \[s\] that a press lasts and rests at least.
const TOUCHED: f64 = 0.12;
const SHORTEST: f64 = 0.5;
const REST: f64 = 1.0;
/// \[s\] by which the way back to the first place is longer than that to the next one.
const WAY_BACK: [f64; 2] = [0.6, 3.0];
/// Locations of a sweep along the line, and \[m\] between them: 10 to 90 mm.
const SWEEP: usize = 9;
const SWEEP_STEP: f64 = 0.010;
/// Share of a press's usual force that tells holding from loading and unloading.
const HELD: f64 = 0.9;

pub(super) fn recognises(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    match extension {
        "npz" => true,
        // Simulation results of the same authors are sheets, too, of another kind.
        "xlsx" => path.file_name().is_some_and(|name| {
            let name = name.to_string_lossy();
            name.starts_with("1D_") || name.starts_with("2D_")
        }),
        _ => false,
    }
}

/// Imports one sheet of presses or one time series into the bag folder `out_dir`.
///
/// **Presses.** A reading has the peak pressures of a press in Pa (the sheet has kPa), and for the pad the rise times in s;
/// the authors have taken the pressure before each press as zero. Ground truth is the pressed place in metres
/// from the middle of the pressed line or grid, the peak force along −z, and the depth where the sheet has it. A
/// sheet has no times: presses are stamped 1 s apart from 2025-01-01 on, after four readings of zero that stand for
/// the untouched skin.
///
/// **Time series.** Readings at the recorded rate in Pa, 5000 Pa/V and not zeroed (the sensors rest at about
/// 2.5 V). The force is −4.1448 N/V of the load cell minus its mean over the first second. Where the skin is pressed is not
/// recorded. The rhythm of presses on the line tells it where they come in sweeps of nine locations with a longer way back after
/// each: then presses, phases and locations are those, forces are above those before the press, and each press is a location
/// of its own, for its depth is another. Otherwise the contact's position is NaN throughout. Stamps count from 2025-01-01 on.
///
/// # Errors
/// File and cell of what is wrong, or why the bag cannot be written.
pub fn tactile_fsi(file: &Path, out_dir: &Path) -> Result<ImportReport, ImportError> {
    match file.extension().and_then(|extension| extension.to_str()) {
        Some("xlsx") => presses(file, out_dir),
        Some("npz") => time_series(file, out_dir),
        _ => Err(ImportError::Unknown { path: file.into() }),
    }
}

fn session_of(file: &Path) -> String {
    file.file_stem().map_or("tactile_fsi".into(), |stem| stem.to_string_lossy().into_owned())
}

/// One row of a sheet, in SI units.
struct Press {
    x: f64,
    y: Option<f64>,
    pressures: [f64; 2],
    rise_times: Option<[f64; 2]>,
    force: f64,
    depth: f64,
}

/// Cells of the rectangle around all of a sheet.
const MOST_CELLS: u64 = 10_000_000;

/// `C7` of a row and column that count from 0.
fn cell_name(row: usize, column: usize) -> String {
    let mut letters = String::new();
    let mut rest = column + 1;
    while rest > 0 {
        letters.insert(0, char::from(b'A' + ((rest - 1) % 26) as u8));
        rest = (rest - 1) / 26;
    }
    format!("{letters}{}", row + 1)
}

/// Refuses a sheet of which two cells are so far apart that the rectangle between them, which is held in memory, fills it.
fn bounded(book: &mut Xlsx<BufReader<File>>, file: &Path, sheet: &str) -> Result<(), ImportError> {
    let wrong = |problem: String| ImportError::file(file, format!("sheet {sheet} {problem}"));
    let unreadable = |error: calamine::XlsxError| wrong(format!("cannot be read: {error}"));
    let mut cells = book.worksheet_cells_reader(sheet).map_err(unreadable)?;
    let mut corner = [0u64; 2];
    while let Some(cell) = cells.next_cell().map_err(unreadable)? {
        let (row, column) = cell.get_position();
        corner = [corner[0].max(u64::from(row) + 1), corner[1].max(u64::from(column) + 1)];
        if corner[0] * corner[1] > MOST_CELLS {
            let at = cell_name(row as usize, column as usize);
            return Err(wrong(format!(
                "has a cell {at}: it spans more than {MOST_CELLS} cells; remove what is far away"
            )));
        }
    }
    Ok(())
}

fn read_sheet(file: &Path) -> Result<Vec<Press>, ImportError> {
    let handle = dermis_io::open_at_most(file, dermis_io::TABLE).map_err(ImportError::read(file))?;
    let mut book: Xlsx<_> = Xlsx::new(BufReader::new(handle))
        .map_err(|error| ImportError::file(file, format!("is not a readable .xlsx workbook: {error}")))?;
    let sheet = book
        .sheet_names()
        .first()
        .cloned()
        .ok_or_else(|| ImportError::file(file, "the workbook has no sheet"))?;
    bounded(&mut book, file, &sheet)?;
    let range = book
        .worksheet_range(&sheet)
        .map_err(|error| ImportError::file(file, format!("sheet {sheet} cannot be read: {error}")))?;
    let (top, left) = range.start().map_or((0, 0), |(row, column)| (row as usize, column as usize));
    let mut rows = range.rows();
    let header: Vec<String> = rows
        .next()
        .unwrap_or_default()
        .iter()
        .map(|cell| cell.as_string().unwrap_or_default().trim().to_owned())
        .collect();
    let find = |name: &str| header.iter().position(|title| title.eq_ignore_ascii_case(name));
    let need = |name: &str| {
        find(name).ok_or_else(|| {
            let found: Vec<&str> =
                header.iter().map(String::as_str).filter(|title| !title.is_empty()).collect();
            ImportError::file(
                file,
                format!("sheet {sheet} has no column {name}; its first row holds: {}", found.join(", ")),
            )
        })
    };
    let (x, left_pressure, right_pressure, force) = (need("X")?, need("Pl")?, need("Pr")?, need("F")?);
    let (y, depth) = (find("Y"), find("depth"));
    let rise = if y.is_some() { Some((need("Tl")?, need("Tr")?)) } else { None };

    let mut presses = Vec::new();
    for (index, row) in rows.enumerate() {
        if [x, left_pressure, right_pressure, force]
            .iter()
            .all(|&column| row.get(column).is_none_or(Data::is_empty))
        {
            continue;
        }
        let number = |column: usize| match row.get(column).unwrap_or(&Data::Empty) {
            cell if cell.is_float() || cell.is_int() => {
                cell.as_f64().filter(|value| value.is_finite()).ok_or("is not finite".to_owned())
            }
            Data::Empty => Err("is empty where a number belongs".to_owned()),
            other => {
                Err(format!("\"{}\" is not a number", other.to_string().chars().take(40).collect::<String>()))
            }
        };
        let value = |column: usize| {
            number(column).map_err(|problem| ImportError::Value {
                path: file.into(),
                at: format!("cell {} (column {})", cell_name(top + index + 1, left + column), header[column]),
                problem,
            })
        };
        presses.push(Press {
            x: value(x)? * 1e-3,
            y: y.map(&value).transpose()?.map(|y| y * 1e-3),
            pressures: [value(left_pressure)? * 1e3, value(right_pressure)? * 1e3],
            rise_times: rise
                .map(|(left, right)| Ok::<_, ImportError>([value(left)?, value(right)?]))
                .transpose()?,
            force: value(force)?,
            depth: match depth {
                Some(column) if row.get(column).is_some_and(|cell| !cell.is_empty()) => value(column)? * 1e-3,
                _ => f64::NAN,
            },
        });
    }
    if presses.is_empty() {
        return Err(ImportError::file(file, format!("sheet {sheet} holds no presses below its first row")));
    }
    Ok(presses)
}

/// Middle of the values.
fn middle(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    0.5 * (low + high)
}

fn presses(file: &Path, out_dir: &Path) -> Result<ImportReport, ImportError> {
    let presses = read_sheet(file)?;
    let pad = presses[0].y.is_some();
    let skin = if pad {
        Skin::described(PAD, "tactile-fsi-pad.toml")?
    } else {
        Skin::described(LINE, "tactile-fsi-line.toml")?
    };
    let mut target = Target::create(file, out_dir, &session_of(file), skin, EPOCH)?;
    let channels = target.skin.channels.len();
    for index in 0..IDLE_REPEATS {
        let label = Label { press: 0, location: 0, repeat: 0, phase: Indentation::PHASE_IDLE, contact: None };
        target.write(EPOCH + index * IDLE_STEP, vec![0.0; channels], label)?;
    }
    let centre = [
        middle(presses.iter().map(|press| press.x)),
        middle(presses.iter().map(|press| press.y.unwrap_or(0.0))),
    ];
    // Locations are distinguished to a tenth of a millimetre.
    let place =
        |press: &Press| ((press.x * 1e4).round() as i64, (press.y.unwrap_or(0.0) * 1e4).round() as i64);
    let locations: BTreeSet<(i64, i64)> = presses.iter().map(place).collect();
    let ids: BTreeMap<(i64, i64), u32> = locations.into_iter().zip(0..).collect();
    let mut repeats: BTreeMap<(u32, i64), u32> = BTreeMap::new();
    let mut stamp = EPOCH + (IDLE_REPEATS - 1) * IDLE_STEP;
    for (index, press) in presses.iter().enumerate() {
        stamp += PRESS_STEP;
        let location = ids.get(&place(press)).copied().unwrap_or_default();
        let depth_key = if press.depth.is_finite() { (press.depth * 1e6).round() as i64 } else { -1 };
        let repeat = repeats.entry((location, depth_key)).or_insert(0);
        let position = Point { x: press.x - centre[0], y: press.y.map_or(0.0, |y| y - centre[1]), z: 0.0 };
        let label = Label {
            press: index as u64 + 1,
            location,
            repeat: *repeat,
            phase: Indentation::PHASE_HOLD,
            contact: Some(pressed(position, press.force, press.depth)),
        };
        *repeat += 1;
        let values =
            press.pressures.iter().chain(press.rise_times.iter().flatten()).map(|v| *v as f32).collect();
        target.write(stamp, values, label)?;
    }
    let mut missing = vec![
        "temperature, diameter of the indenter".to_owned(),
        "what happened between the presses".to_owned(),
    ];
    if presses.iter().any(|press| press.depth.is_nan()) {
        missing.push("depth".into());
    }
    let facts = Facts {
        data_set: format!("tactile FSI, {} presses ({LICENCE})", if pad { "pad" } else { "line" }),
        presses: presses.len() as u64,
        locations: ids.len() as u64,
        worst_mismatch: None,
        assumed: vec![
            format!(
                "the origin is the middle of the pressed locations, x {:.0} and y {:.0} mm of the sheet; z out of the surface",
                centre[0] * 1e3,
                centre[1] * 1e3
            ),
            "Pl and Pr are in kPa and F in N, peaks above the level before the press, by the authors' script"
                .into(),
            "the sheet has no times: presses are stamped 1 s apart from 2025-01-01 on".into(),
            format!(
                "the {IDLE_REPEATS} readings of the untouched skin are zero by that definition, not measured"
            ),
        ],
        missing,
    };
    target.finish(facts, file)
}
