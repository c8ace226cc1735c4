//! Time series: the logged volts of a load cell and two pressure sensors.

use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::Path;

use dermis_msgs::{geometry_msgs::msg::Point, msg::Indentation};

use super::sweeps::{Pressed, line_place, sweeps};
use super::{EPOCH, LICENCE, LINE, SWEEP, session_of};
use crate::import::{Facts, ImportError, ImportReport, Label, Skin, Target, pressed, unknown_point};

/// \[Pa/V\] of the pressure sensors, by the authors' script.
const PASCAL_PER_VOLT: f64 = 5000.0;
/// \[N/V\] of the load cell, pressing counted positive, by the authors' script.
const NEWTON_PER_VOLT: f64 = -4.1448;
/// \[s\] at the start of a time series that give the load cell's zero.
const ZERO_TIME: f64 = 1.0;
/// Largest array that a recording can hold: a day at 100 Hz.
const MOST_SAMPLES: u64 = 24 * 3600 * 100;

/// Reads one array of the archive, row by row however it is stored.
fn array<T: npyz::Deserialize + Copy>(
    file: &Path,
    archive: &mut zip::ZipArchive<BufReader<File>>,
    name: &str,
) -> Result<(Vec<u64>, Vec<T>), ImportError> {
    let wrong = |problem: String| ImportError::file(file, format!("array {name}: {problem}"));
    let entry = archive.by_name(&format!("{name}.npy")).map_err(|error| wrong(error.to_string()))?;
    // A header that promises more than a recording can hold must not be believed.
    let limited = entry.take(MOST_SAMPLES * 3 * 8 + 4096);
    let npy = npyz::NpyFile::new(limited).map_err(|error| wrong(error.to_string()))?;
    let shape = npy.shape().to_vec();
    if shape.iter().try_fold(1_u64, |product, n| product.checked_mul(*n)).is_none_or(|n| n > MOST_SAMPLES * 3)
    {
        return Err(wrong(format!("its shape {shape:?} is larger than a day of samples")));
    }
    let by_columns = npy.order() == npyz::Order::Fortran;
    let values = npy.into_vec::<T>().map_err(|error| wrong(error.to_string()))?;
    let values = match shape.as_slice() {
        [_, columns] if by_columns && *columns > 0 => {
            let columns = usize::try_from(*columns).map_err(|error| wrong(error.to_string()))?;
            let rows = values.len() / columns;
            (0..rows * columns).map(|at| values[at % columns * rows + at / columns]).collect()
        }
        _ => values,
    };
    Ok((shape, values))
}

/// Volts in rows of three (load cell, left and right pressure), and their rate \[Hz\].
fn read(file: &Path) -> Result<(Vec<f32>, f64), ImportError> {
    let handle = dermis_io::open_at_most(file, dermis_io::TABLE).map_err(ImportError::read(file))?;
    let mut archive = zip::ZipArchive::new(BufReader::new(handle))
        .map_err(|error| ImportError::file(file, format!("is not a readable .npz archive: {error}")))?;
    let (shape, volts) = array::<f32>(file, &mut archive, "volts")?;
    let (_, rates) = array::<f64>(file, &mut archive, "fs")?;
    if shape.len() != 2 || shape[1] != 3 || shape[0] == 0 {
        return Err(ImportError::file(
            file,
            format!("array volts: its shape is {shape:?} where rows of 3 are expected"),
        ));
    }
    let rate = match rates.as_slice() {
        [rate] if (1.0..=1e5).contains(rate) => *rate,
        other => return Err(ImportError::file(file, format!("array fs: {other:?} is not one rate in Hz"))),
    };
    if let Some(at) = volts.iter().position(|value| !value.is_finite()) {
        return Err(ImportError::Value {
            path: file.into(),
            at: format!("array volts, row {}, column {}", at / 3 + 1, at % 3 + 1),
            problem: format!("{} is not finite", volts[at]),
        });
    }
    Ok((volts, rate))
}

/// What the load cell measures \[N\] above its mean over the first second.
fn forces(rows: &[&[f32]], rate: f64) -> Vec<f64> {
    let zero_rows = ((ZERO_TIME * rate) as usize).clamp(1, rows.len());
    let zero = rows[..zero_rows].iter().map(|row| f64::from(row[0])).sum::<f64>() / zero_rows as f64;
    rows.iter().map(|row| NEWTON_PER_VOLT * (f64::from(row[0]) - zero)).collect()
}

/// The skin of a session: the pad's time series have the line's channels, as rise times are not a signal.
fn skin_of(session: &str) -> Result<Skin, ImportError> {
    let line = Skin::described(LINE, "tactile-fsi-line.toml")?;
    if !session.starts_with("2D") {
        return Ok(line);
    }
    Ok(Skin {
        name: "tactile-fsi-pad-series".into(),
        frame_id: "tactile_fsi_pad_link".into(),
        description: None,
        ..line
    })
}

/// What is true of the sample with this index, at which the load cell measures `newtons`; `next` is the first of the presses that
/// is not over.
fn label_of(presses: &[Pressed], next: usize, index: usize, newtons: f64) -> Label {
    let untouched = |press: usize| Label {
        press: press as u64,
        location: press as u32,
        repeat: 0,
        phase: Indentation::PHASE_IDLE,
        contact: None,
    };
    match presses.get(next) {
        _ if presses.is_empty() => Label {
            phase: Indentation::PHASE_UNKNOWN,
            contact: Some(pressed(unknown_point(), newtons, f64::NAN)),
            ..untouched(0)
        },
        Some(found) if index >= found.begin => {
            let force = newtons - found.rest;
            let phase = if index < found.held[0] {
                Indentation::PHASE_LOAD
            } else if index < found.held[1] {
                Indentation::PHASE_HOLD
            } else {
                Indentation::PHASE_UNLOAD
            };
            let at =
                found.place.map_or(unknown_point(), |place| Point { x: line_place(place), y: 0.0, z: 0.0 });
            Label { phase, contact: Some(pressed(at, force, f64::NAN)), ..untouched(next + 1) }
        }
        _ => untouched(next),
    }
}

/// What had to be assumed, and what the recording lacks.
fn facts(series: &[Pressed], rate: f64) -> Facts {
    let placed = series.iter().filter(|press| press.place.is_some()).count() as u64;
    Facts {
        data_set: format!("tactile FSI, time series ({LICENCE})"),
        presses: placed,
        locations: if placed > 0 { SWEEP as u64 } else { 0 },
        worst_mismatch: None,
        assumed: vec![
            "5000 Pa/V for the pressures, not zeroed, and -4.1448 N/V for the force, by the authors' script"
                .into(),
            format!("nothing touches during the first {ZERO_TIME} s: their mean is the load cell's zero"),
            format!("the log has no date: stamps count from 2025-01-01 on, {rate} a second"),
            if placed > 0 {
                format!(
                    "{placed} of {} presses are in sweeps of {SWEEP}, recognised by the longer way back after each: they are taken to be \
                     at 10, 20, … 90 mm",
                    series.len()
                )
            } else {
                "presses follow no rhythm that tells their locations".to_owned()
            },
        ],
        missing: if placed > 0 {
            vec!["temperature, diameter of the indenter, depth".into()]
        } else {
            vec![
                "temperature, diameter of the indenter, depth".into(),
                "where and when the skin is pressed: a contact of unknown position carries the force throughout"
                    .into(),
            ]
        },
    }
}

/// Imports one time series.
pub(super) fn time_series(file: &Path, out_dir: &Path) -> Result<ImportReport, ImportError> {
    let (volts, rate) = read(file)?;
    let rows: Vec<&[f32]> = volts.chunks_exact(3).collect();
    let newtons = forces(&rows, rate);
    let session = session_of(file);
    let skin = skin_of(&session)?;
    let series = if session.starts_with("1D") { sweeps(&newtons, rate) } else { Vec::new() };
    let mut target = Target::create(file, out_dir, &session, skin, EPOCH)?;
    let mut next = 0;
    for (index, row) in rows.iter().enumerate() {
        let stamp = EPOCH + (index as f64 * 1e9 / rate).round() as i64;
        let values = row[1..].iter().map(|volt| (f64::from(*volt) * PASCAL_PER_VOLT) as f32).collect();
        while series.get(next).is_some_and(|sweep| sweep.end <= index) {
            next += 1;
        }
        target.write(stamp, values, label_of(&series, next, index, newtons[index]))?;
    }
    target.finish(facts(&series, rate), file)
}
