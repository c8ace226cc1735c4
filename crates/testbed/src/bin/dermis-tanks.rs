//! How much of what was measured on tanks of water the complete electrode model of a uniform sheet explains.
//!
//! For every file that is named, or lies below a folder that is: the residual after one fitted scale, ‖measured − scale · computed‖ /
//! ‖measured‖, on a round tank, and on the measured outline where there is one. One object of JSON is printed.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use dermis_electrics::{Adjacent, Contacts, Density, Fit, Rim, Sheet, fit_scale};
use dermis_testbed::import::{TankFrame, read_tank, recordings};
use serde_json::{Value, json};

/// Share of the rim that electrodes cover, and their contact impedance over radius times resistance per square: neither is published for
/// these tanks, and pairs that are not driven hardly depend on them.
const SHARE: f64 = 0.2;
const IMPEDANCE: f64 = 0.01;
const PATTERN: Adjacent = Adjacent { electrodes: 16 };

type Failure = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if paths.is_empty() {
        eprintln!("error: name files or folders with recordings of tanks");
        return ExitCode::FAILURE;
    }
    match report(&paths) {
        Ok(value) => {
            println!("{value}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn report(paths: &[PathBuf]) -> Result<Value, Failure> {
    let round = computed(&Rim::circle(1.0, PATTERN.electrodes, SHARE)?)?;
    let mut rows = Vec::new();
    for path in paths {
        for file in recordings(path)? {
            // Other recordings may lie in the same folder.
            if let Ok(frames) = read_tank(&file) {
                for frame in frames {
                    rows.push(row(&file, &frame, &round)?);
                }
            }
        }
    }
    Ok(json!({ "share_of_electrodes": SHARE, "contact_impedance": IMPEDANCE, "frames": rows }))
}

fn row(file: &Path, frame: &TankFrame, round: &[f64]) -> Result<Value, Failure> {
    let outline = match &frame.rim {
        Some(points) => Some(fitted(frame, &computed(&Rim::through(points, SHARE)?)?)),
        None => None,
    };
    Ok(json!({
        "file": file.file_name().map(|name| name.to_string_lossy()),
        "folder": file.parent().and_then(Path::file_name).map(|name| name.to_string_lossy()),
        "frame": frame.name,
        "round": fit_json(fitted(frame, round)),
        "measured_outline": outline.map(fit_json),
    }))
}

fn computed(rim: &Rim) -> Result<Vec<f64>, Failure> {
    let sheet = Sheet::uniform(rim, Density::default(), 1.0, Contacts { impedance: IMPEDANCE })?;
    Ok(PATTERN.frame(&sheet.potentials(PATTERN)?))
}

fn fitted(frame: &TankFrame, computed: &[f64]) -> Fit {
    let distances: Vec<usize> =
        PATTERN.readings().map(|(k, m)| (m + PATTERN.electrodes - k) % PATTERN.electrodes).collect();
    fit_scale(&frame.readings, computed, &distances)
}

fn fit_json(fit: Fit) -> Value {
    json!({
        "residual": fit.residual,
        "explained": 1.0 - fit.residual * fit.residual,
        "uneven_residual": fit.uneven_residual,
    })
}
