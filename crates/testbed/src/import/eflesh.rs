//! eFlesh (Pattabiraman et al., arXiv 2506.09994; github notvenky/eFlesh, MIT): a magnetic pad, pressed by a robot.
//!
//! A run is a folder with `sensor.csv` (unix time, then 15 or 30 flux densities), `sensor_post_baselines.csv` (the same
//! minus a reading of the untouched pad) and `states.csv` (unix time, robot x, y, z in mm, and in the force runs a
//! load cell's grams-force, −1 where it had no reading). There are no header rows.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::{BufRead, BufReader},
    ops::Range,
    path::Path,
};

use dermis_msgs::{
    builtin_interfaces::msg::Time,
    geometry_msgs::msg::{Point, PointStamped, Vector3},
    msg::{Contact, Indentation, IndentationContact},
    std_msgs::msg::Header,
};

use super::{
    Facts, IDLE_REPEATS, IDLE_STEP, ImportError, ImportReport, Label, Skin, Target, pressed, stamp_of,
    unknown_point,
};

const SKIN: &str = include_str!("../../../../launch/skins/eflesh.toml");
const SHEAR_SKIN: &str = include_str!("../../../../launch/skins/eflesh-shear.toml");
/// \[N\] of one gram-force.
const GRAM_FORCE: f64 = 9.806_65e-3;
/// \[gf\] above the load cell's reading at rest that counts as first contact: five of its steps of noise, 0.05 N.
const CONTACT_FORCE: f64 = 5.0;
/// \[mm\] within which the robot is at the top of its stroke.
const TOP: f64 = 0.005;
/// \[mm\] below which the robot stands still between two readings.
const STILL: f64 = 5e-4;
/// \[uT\] beyond the rounding of the printed numbers: the authors took another baseline.
const BASELINE_STEP: f64 = 0.05;
/// \[s\] between a reading and a robot state beyond which the files don't belong together.
const WORST: f64 = 0.5;

/// What a run is about; its files tell by their number of columns.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Presses on a grid, one reading each.
    Spatial,
    /// Slow strokes in one place, with a load cell along the normal.
    Normal,
    /// Slow strokes along the surface of a stack of two boards, with a load cell along the stroke.
    Shear,
}

struct Row {
    time: f64,
    values: Vec<f64>,
}

pub(super) fn recognises(path: &Path) -> bool {
    path.join("sensor.csv").is_file() && path.join("states.csv").is_file()
}

/// Reads rows of numbers; every row has as many columns as the first, and time never runs back.
fn read(path: &Path) -> Result<Vec<Row>, ImportError> {
    let file = dermis_io::open_at_most(path, dermis_io::TABLE).map_err(ImportError::read(path))?;
    let mut rows: Vec<Row> = Vec::new();
    for (index, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(ImportError::read(path))?;
        if line.trim().is_empty() {
            continue;
        }
        let wrong = |at: String, problem: String| ImportError::Value { path: path.into(), at, problem };
        let at = format!("line {}", index + 1);
        let mut numbers = Vec::new();
        for (column, text) in line.split(',').enumerate() {
            let at = || format!("{at}, column {}", column + 1);
            let number: f64 = text
                .trim()
                .parse()
                .map_err(|_| wrong(at(), format!("\"{}\" is not a number", shorten(text))))?;
            if !number.is_finite() {
                return Err(wrong(at(), format!("{number} is not finite")));
            }
            numbers.push(number);
        }
        let values = numbers.split_off(1);
        let time = numbers[0];
        if stamp_of(time).is_none() {
            return Err(wrong(
                format!("{at}, column 1"),
                format!("{time} is not a time in seconds since 1970"),
            ));
        }
        if let Some(before) = rows.last() {
            if before.values.len() != values.len() {
                return Err(wrong(
                    at,
                    format!(
                        "has {} columns, the lines before have {}",
                        values.len() + 1,
                        before.values.len() + 1
                    ),
                ));
            }
            if before.time > time {
                return Err(wrong(
                    format!("{at}, column 1"),
                    format!("time runs back from {} to {time}", before.time),
                ));
            }
        }
        rows.push(Row { time, values });
    }
    if rows.is_empty() {
        return Err(ImportError::file(path, "holds no rows"));
    }
    Ok(rows)
}

fn shorten(text: &str) -> String {
    text.trim().chars().take(40).collect()
}

/// Index of the state nearest in time, and the distance \[s\].
fn nearest(states: &[Row], time: f64) -> (usize, f64) {
    let after = states.partition_point(|state| state.time < time);
    let distance = |index: usize| states.get(index).map_or(f64::INFINITY, |state| (state.time - time).abs());
    match after.checked_sub(1) {
        Some(before) if distance(before) <= distance(after) => (before, distance(before)),
        _ => (after, distance(after)),
    }
}

/// First row of each stretch that shares one baseline.
fn stretches(baselines: Option<&[Vec<f64>]>, rows: usize, kind: Kind) -> Vec<usize> {
    match (kind, baselines) {
        // Every press has a baseline of its own.
        (Kind::Spatial, _) => (0..rows).collect(),
        (_, None) => vec![0],
        (_, Some(baselines)) => {
            let changed = |index: usize| {
                baselines[index].iter().zip(&baselines[index - 1]).any(|(a, b)| (a - b).abs() > BASELINE_STEP)
            };
            (0..rows).filter(|&index| index == 0 || changed(index)).collect()
        }
    }
}

/// Imports one run into the bag folder `out_dir`; `progress` gets the readings done and in all.
///
/// - Readings keep their recorded times and order; flux densities are converted from microtesla to T. That the unit is
///   microtesla is supported by the readings themselves: they are multiples of 2.4 and 3.872 (0.6 and 0.968 in the
///   shear run), the steps in microtesla that the data sheet of the MLX90393 gives for x, y and for z.
/// - Each reading is labelled by the robot state nearest in time, under the reading's stamp. The state itself, in the
///   robot's frame and at its own time, is on topic `probe`.
/// - Position: metres from the middle of the pressed grid (robot x 289, y −100 mm in both published runs), axes along the
///   robot's, z out of the surface. The force runs say nothing about where on the pad they press: NaN.
/// - Force: load cell times 9.80665e-3 N, along −z, NaN where the cell had no reading. In the shear run it is along
///   −x: which way of the pad the stroke went is not published.
/// - Depth: in the force runs below the height at which the load cell first rose by 5 gf in that stroke, negative above;
///   above that height nothing touches. The position runs record no contact height: NaN.
/// - The untouched pad: the authors' baseline of each press (position) or stroke (force), recovered as
///   `sensor − sensor_post_baselines`, is written four times 0.2 s apart, ending 0.2 s before the press or stroke. Its
///   values are measured, its stamps are not.
///
/// # Errors
/// File, line and column of what is wrong, or why the bag cannot be written.
pub fn eflesh(
    run_dir: &Path,
    out_dir: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<ImportReport, ImportError> {
    let run = Run::read(run_dir)?;
    let starts = stretches(run.baselines.as_deref(), run.sensor.len(), run.kind);
    let session = run_dir.file_name().map_or("eflesh".into(), |name| name.to_string_lossy().into_owned());
    let start_stamp = stamp_of(run.sensor[0].time).unwrap_or_default();
    let first_idle = if run.baselines.is_some() { IDLE_REPEATS * IDLE_STEP } else { 0 };
    let mut target = Target::create(run_dir, out_dir, &session, skin(run.kind)?, start_stamp - first_idle)?;
    let mut locations = Locations::new(&run.states);
    let readings = run.sensor.len();
    for (press, &start) in starts.iter().enumerate() {
        let end = starts.get(press + 1).copied().unwrap_or(readings);
        run.write_stroke(press, start..end, &mut locations, &mut target, progress)?;
    }
    progress(readings as u64, readings as u64);
    let facts = facts(run.kind, run.baselines.is_some(), &locations, starts.len() as u64, run.worst);
    target.finish(facts, run_dir)
}

/// A run, as its files say.
struct Run {
    kind: Kind,
    sensor: Vec<Row>,
    states: Vec<Row>,
    /// Which state is nearest in time to each reading.
    labels: Vec<usize>,
    /// \[s\] between a reading and that state at most.
    worst: f64,
    baselines: Option<Vec<Vec<f64>>>,
}

impl Run {
    fn read(run_dir: &Path) -> Result<Self, ImportError> {
        let sensor_path = run_dir.join("sensor.csv");
        let sensor = read(&sensor_path)?;
        let states_path = run_dir.join("states.csv");
        let states = read(&states_path)?;
        let channels = sensor[0].values.len();
        let kind = match (channels, states[0].values.len()) {
            (15, 3) => Kind::Spatial,
            (15, 4) => Kind::Normal,
            (30, 4) => Kind::Shear,
            (15 | 30, columns) => {
                return Err(ImportError::file(
                    &states_path,
                    format!("has {} columns; known are 4 (time, x, y, z) and, with weight, 5", columns + 1),
                ));
            }
            _ => {
                return Err(ImportError::file(
                    &sensor_path,
                    format!(
                        "has {} columns; known are 16 and 31: time and three axes of 5 or 10 magnetometers",
                        channels + 1
                    ),
                ));
            }
        };
        let baselines = read_baselines(run_dir, &sensor)?;

        let mut labels = Vec::with_capacity(sensor.len());
        let mut worst: f64 = 0.0;
        for (index, row) in sensor.iter().enumerate() {
            let (state, distance) = nearest(&states, row.time);
            if distance > WORST {
                return Err(ImportError::Value {
                    path: sensor_path,
                    at: format!("row {}", index + 1),
                    problem: format!(
                        "the nearest robot state in states.csv is {distance:.3} s away: the files don't belong together"
                    ),
                });
            }
            worst = worst.max(distance);
            labels.push(state);
        }
        Ok(Self { kind, sensor, states, labels, worst, baselines })
    }

    /// Writes the readings of one press or stroke, behind those of the untouched pad before it.
    fn write_stroke(
        &self,
        press: usize,
        rows: Range<usize>,
        locations: &mut Locations,
        target: &mut Target,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<(), ImportError> {
        let Self { kind, sensor, states, labels, .. } = self;
        let (kind, start) = (*kind, rows.start);
        let stroke: Vec<&[f64]> =
            labels[rows.clone()].iter().map(|&state| states[state].values.as_slice()).collect();
        let (location, repeat) = match kind {
            Kind::Spatial => locations.visit(stroke[0]),
            _ => (0, u32::try_from(press).unwrap_or(u32::MAX)),
        };
        let label = |phase, contact| Label { press: press as u64, location, repeat, phase, contact };
        if let Some(baselines) = &self.baselines {
            let stamp = stamp_of(sensor[start].time).unwrap_or_default();
            for back in (1..=IDLE_REPEATS).rev() {
                target.write(
                    stamp - back * IDLE_STEP,
                    tesla(&baselines[start]),
                    label(Indentation::PHASE_IDLE, None),
                )?;
            }
        }
        let contact_height = first_contact(&stroke, kind);
        for (offset, row) in sensor[rows].iter().enumerate() {
            let state = stroke[offset];
            let (phase, contact) = match kind {
                Kind::Spatial => {
                    (Indentation::PHASE_HOLD, Some(pressed(locations.position(state), f64::NAN, f64::NAN)))
                }
                _ => stroke_label(&stroke, offset, contact_height, kind),
            };
            let stamp = stamp_of(row.time).unwrap_or_default();
            target.write(stamp, tesla(&row.values), label(phase, contact))?;
            let index = start + offset;
            let state_time = stamp_of(states[labels[index]].time).unwrap_or_default();
            let probe = PointStamped {
                header: Header { stamp: Time::from_nanos(state_time), frame_id: "robot".into() },
                point: Point { x: state[0] * 1e-3, y: state[1] * 1e-3, z: state[2] * 1e-3 },
            };
            target.write_other("probe", &probe, state_time)?;
            if index.is_multiple_of(256) {
                progress(index as u64, sensor.len() as u64);
            }
        }
        Ok(())
    }
}

fn skin(kind: Kind) -> Result<Skin, ImportError> {
    match kind {
        Kind::Spatial | Kind::Normal => Skin::described(SKIN, "eflesh.toml"),
        Kind::Shear => Skin::described(SHEAR_SKIN, "eflesh-shear.toml"),
    }
}

fn tesla(microtesla: &[f64]) -> Vec<f32> {
    microtesla.iter().map(|value| (value * 1e-6) as f32).collect()
}

/// Readings of the untouched pad that belong to each row \[uT\]; `None` where the run has no such file.
fn read_baselines(run_dir: &Path, sensor: &[Row]) -> Result<Option<Vec<Vec<f64>>>, ImportError> {
    let path = run_dir.join("sensor_post_baselines.csv");
    if !path.is_file() {
        return Ok(None);
    }
    let rows = read(&path)?;
    if rows.len() != sensor.len() || rows[0].values.len() != sensor[0].values.len() {
        return Err(ImportError::file(
            &path,
            format!(
                "has {} rows of {} columns where sensor.csv has {} of {}",
                rows.len(),
                rows[0].values.len() + 1,
                sensor.len(),
                sensor[0].values.len() + 1
            ),
        ));
    }
    let mut baselines = Vec::with_capacity(rows.len());
    for (index, (row, raw)) in rows.iter().zip(sensor).enumerate() {
        if (row.time - raw.time).abs() > 1e-4 {
            return Err(ImportError::Value {
                path,
                at: format!("row {}, column 1", index + 1),
                problem: format!("time {} is not that of the same row in sensor.csv, {}", row.time, raw.time),
            });
        }
        baselines.push(raw.values.iter().zip(&row.values).map(|(raw, rest)| raw - rest).collect());
    }
    Ok(Some(baselines))
}

/// The pressed grid, in steps of 1 mm.
struct Locations {
    low: [f64; 2],
    high: [f64; 2],
    visits: BTreeMap<(u32, i64), u32>,
    seen: BTreeSet<u32>,
}

impl Locations {
    fn new(states: &[Row]) -> Self {
        let bound = |axis: usize, pick: fn(f64, f64) -> f64| {
            states.iter().map(|state| state.values[axis].round()).reduce(pick).unwrap_or_default()
        };
        Self {
            low: [bound(0, f64::min), bound(1, f64::min)],
            high: [bound(0, f64::max), bound(1, f64::max)],
            visits: BTreeMap::new(),
            seen: BTreeSet::new(),
        }
    }

    fn centre(&self) -> [f64; 2] {
        [0.5 * (self.low[0] + self.high[0]), 0.5 * (self.low[1] + self.high[1])]
    }

    /// Grid point of a state, and how often it was pressed before at this height within 0.1 mm.
    fn visit(&mut self, state: &[f64]) -> (u32, u32) {
        let along = |axis: usize| (state[axis].round() - self.low[axis]) as u32;
        let columns = (self.high[1] - self.low[1]) as u32 + 1;
        let location = along(0).saturating_mul(columns).saturating_add(along(1));
        self.seen.insert(location);
        let visits = self.visits.entry((location, (state[2] * 10.0).round() as i64)).or_insert(0);
        *visits += 1;
        (location, *visits - 1)
    }

    fn position(&self, state: &[f64]) -> Point {
        let [x, y] = self.centre();
        Point { x: (state[0] - x) * 1e-3, y: (state[1] - y) * 1e-3, z: 0.0 }
    }
}

/// Grams-force; `None` where the load cell had no reading.
fn weight(state: &[f64]) -> Option<f64> {
    state.get(3).copied().filter(|weight| *weight != -1.0)
}

/// Height \[mm\] at which the load cell first rose in a stroke; `None` where it never did.
fn first_contact(stroke: &[&[f64]], kind: Kind) -> Option<f64> {
    if kind == Kind::Spatial {
        return None;
    }
    let top = stroke[0][2];
    let at_top = stroke.iter().take_while(|state| (state[2] - top).abs() < TOP);
    let rest = at_top.filter_map(|state| weight(state)).reduce(f64::max).unwrap_or(0.0);
    stroke
        .iter()
        .find(|state| weight(state).is_some_and(|weight| weight > rest + CONTACT_FORCE))
        .map(|state| state[2])
}

/// Phase and contact of one reading of a slow stroke down and up again.
fn stroke_label(
    stroke: &[&[f64]],
    index: usize,
    contact_height: Option<f64>,
    kind: Kind,
) -> (u8, Option<IndentationContact>) {
    let height = stroke[index][2];
    let before = stroke[index.saturating_sub(1)][2];
    let lowest = stroke.iter().enumerate().min_by(|a, b| a.1[2].total_cmp(&b.1[2])).map_or(0, |(at, _)| at);
    let Some(contact_height) = contact_height.filter(|contact| height <= *contact) else {
        // The load cell shows that nothing touches yet, or any more.
        let phase = if index < lowest { Indentation::PHASE_APPROACH } else { Indentation::PHASE_UNLOAD };
        return (phase, None);
    };
    let phase = if (height - before).abs() < STILL {
        Indentation::PHASE_HOLD
    } else if height < before {
        Indentation::PHASE_LOAD
    } else {
        Indentation::PHASE_UNLOAD
    };
    let force = weight(stroke[index]).map_or(f64::NAN, |weight| weight * GRAM_FORCE);
    let depth = (contact_height - height) * 1e-3;
    let contact = if kind == Kind::Shear && force.is_finite() {
        IndentationContact {
            force: Vector3 { x: -force, y: f64::NAN, z: f64::NAN },
            force_components: Contact::FORCE_FULL,
            ..pressed(unknown_point(), f64::NAN, f64::NAN)
        }
    } else if kind == Kind::Shear {
        pressed(unknown_point(), f64::NAN, f64::NAN)
    } else {
        pressed(unknown_point(), force, depth)
    };
    (phase, Some(contact))
}

fn facts(kind: Kind, has_baselines: bool, locations: &Locations, presses: u64, worst: f64) -> Facts {
    let [x, y] = locations.centre();
    let mut assumed = vec![
        "sensor.csv is in microtesla: its steps are those of the MLX90393's data sheet; values here are in T"
            .to_owned(),
    ];
    let mut missing = vec!["temperature, diameter of the indenter".to_owned()];
    match kind {
        Kind::Spatial => {
            assumed.push(format!(
                "the origin is the middle of the pressed grid, robot x {x} and y {y} mm; axes along the robot's, z out of the surface"
            ));
            missing.push("force, and the height of first contact, so depth is NaN; topic probe keeps the robot's height".into());
        }
        Kind::Normal => {
            assumed.push("the load cell measures along the normal; first contact of a stroke is where it rises by 5 gf".into());
            missing.push("where on the pad the indenter presses: position is NaN".into());
        }
        Kind::Shear => {
            assumed.push("the stroke goes along -x of the skin: its direction is not published".into());
            assumed.push(
                "the second board lies 10 mm below the first, which nothing but pictures depend on".into(),
            );
            missing.push("where on the pad the indenter holds, the force across the stroke and along the normal, and where the second board lies".into());
        }
    }
    if has_baselines {
        assumed.push(format!(
            "readings of the untouched pad are the authors' baselines (sensor minus sensor_post_baselines), one of each press or stroke; each is written {IDLE_REPEATS} times with stamps made up, {} s apart before it",
            IDLE_STEP as f64 * 1e-9
        ));
    } else {
        missing.push("sensor_post_baselines.csv, and so every reading of the untouched pad".into());
    }
    if kind != Kind::Spatial {
        missing.push("every second reading of the load cell: its force is NaN".into());
    }
    let name = match kind {
        Kind::Spatial => "spatial resolution",
        Kind::Normal => "normal force",
        Kind::Shear => "shear force",
    };
    Facts {
        data_set: format!("eFlesh, {name} (Pattabiraman et al. 2025, MIT licence)"),
        presses,
        locations: if kind == Kind::Spatial { locations.seen.len() as u64 } else { 1 },
        worst_mismatch: Some(worst),
        assumed,
        missing,
    }
}
