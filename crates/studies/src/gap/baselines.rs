//! What simpler ways to a cause answer, for comparison: they see the same recording and the same effects of the same model.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use dermis_bag::BagReader;
use dermis_gap_benchmark::score::{Answer, Named};
use dermis_model::{ForwardModel, Stimulus};
use dermis_msgs::msg::{Indentation as Label, TaxelFrame};
use dermis_skin::{Effect, SkinDescription};
use nalgebra::{DMatrix, DVector};

use crate::Families;

/// Frames between two that are sampled: effects that remember see a slower clock, nothing else.
const STRIDE: usize = 5;
/// Devices that are drawn of an effect that differs from device to device.
const DEVICES: u64 = 4;
/// \[s\] of untouched readings that the zero is taken from.
const QUIET: f64 = 2.0;

/// Names of the baselines.
pub const NAMES: [&str; 3] = ["nearest signature", "joint least squares, largest z", "in-sample BIC"];

struct Record {
    times: Vec<f64>,
    stimuli: Vec<Stimulus>,
    /// Row after row.
    readings: Vec<f64>,
}

fn read(bag: &Path) -> Result<Record> {
    let reader = BagReader::open(bag)?;
    let mut record = Record { times: Vec::new(), stimuli: Vec::new(), readings: Vec::new() };
    let frames = reader.read::<TaxelFrame>("taxels")?;
    let labels = reader.read::<Label>("ground_truth")?;
    let mut start = None;
    for (frame, label) in frames.zip(labels).step_by(STRIDE) {
        let (frame, label) = (frame?.message, label?.message);
        let stamp = frame.header.stamp.as_nanos();
        let start = *start.get_or_insert(stamp);
        record.times.push((stamp - start) as f64 * 1e-9);
        record.readings.extend(frame.values.iter().map(|v| f64::from(*v)));
        // A light touch may pull, as far as a force cell with noise knows: models know no adhesion.
        let pressing = label
            .contacts
            .iter()
            .filter(|c| c.force.x * c.normal.x + c.force.y * c.normal.y + c.force.z * c.normal.z < 0.0);
        let contacts = pressing.map(dermis_gap::touch);
        record.stimuli.push(Stimulus {
            contacts: contacts.collect(),
            temperature: f64::from(label.temperature),
            ..Stimulus::default()
        });
    }
    Ok(record)
}

/// What a model reads along the recording, minus what it reads at its start.
fn simulate(model: &Arc<dyn ForwardModel>, record: &Record) -> Result<Vec<f64>> {
    let channels = model.channels();
    let mut readings = vec![0.0; channels * record.times.len()];
    let mut state = model.start(0);
    for ((row, time), stimulus) in readings.chunks_mut(channels).zip(&record.times).zip(&record.stimuli) {
        let mut stimulus = stimulus.clone();
        state.apply_to_stimulus(*time, &mut stimulus);
        state.step(*time, &stimulus, row)?;
        state.quantize(row);
    }
    zeroed(&mut readings, channels, &record.times);
    Ok(readings)
}

fn zeroed(readings: &mut [f64], channels: usize, times: &[f64]) {
    let quiet = times.iter().take_while(|t| **t < QUIET).count().max(1);
    let mut zero = vec![0.0; channels];
    for row in readings.chunks(channels).take(quiet) {
        zero.iter_mut().zip(row).for_each(|(z, v)| *z += v / quiet as f64);
    }
    readings.chunks_mut(channels).for_each(|row| row.iter_mut().zip(&zero).for_each(|(v, z)| *v -= z));
}

/// Noise-free readings of the nominal model along some presses, and what each effect changes in them, by its name.
struct Simulated {
    nominal: Vec<f64>,
    changed: Vec<(&'static str, Vec<f64>)>,
}

/// What was simulated already, by benchmark set and number of presses.
#[derive(Default)]
pub struct Columns(BTreeMap<(PathBuf, usize), Simulated>);

fn simulated(skin: &SkinDescription, families: &Families, record: &Record) -> Result<Simulated> {
    let nominal = simulate(&families.model(skin)?, record)?;
    let mut changed = Vec::new();
    for info in families.of(skin)?.effects() {
        for seed in 0..if info.random { DEVICES } else { 1 } {
            let mut other = skin.clone();
            other.effects = vec![Effect::new(info.name).seed(seed)];
            let Ok(model) = families.model(&other) else { continue };
            let Ok(readings) = simulate(&model, record) else { continue };
            changed.push((info.name, readings));
        }
    }
    Ok(Simulated { nominal, changed })
}

/// The answers of all baselines on one recording, whose presses are those of all that have the same `key`.
pub fn answers(
    skin: &SkinDescription,
    families: &Families,
    bag: &Path,
    key: &(PathBuf, usize),
    columns: &mut Columns,
) -> Result<Vec<Answer>> {
    let mut record = read(bag).with_context(|| format!("bag {}", bag.display()))?;
    if !columns.0.contains_key(key) {
        columns.0.insert(key.clone(), simulated(skin, families, &record)?);
    }
    let Some(Simulated { nominal, changed }) = columns.0.get(key) else {
        return Ok(vec![Answer::default(); NAMES.len()]);
    };
    let sigma = skin.channel_noise();
    let channels = sigma.len();
    zeroed(&mut record.readings, channels, &record.times);
    let touched: Vec<bool> = record.stimuli.iter().map(|s| !s.contacts.is_empty()).collect();
    let whitened = |readings: &[f64]| -> DVector<f64> {
        let rows = readings.chunks(channels).zip(&touched).filter(|(_, t)| **t).map(|(row, _)| row);
        let values = rows.flat_map(|row| row.iter().zip(&sigma).map(|(v, s)| v / s));
        DVector::from_vec(values.collect())
    };
    let base = whitened(nominal);
    let residual = whitened(&record.readings) - &base;
    let mut columns: Vec<DVector<f64>> = Vec::new();
    let mut of: Vec<&str> = Vec::new();
    for (name, readings) in changed {
        let column = whitened(readings) - &base;
        let norm = column.norm();
        if norm > 1e-6 && norm.is_finite() {
            columns.push(column / norm);
            of.push(name);
        }
    }
    if columns.is_empty() {
        return Ok(vec![Answer::default(); NAMES.len()]);
    }
    let (energy, rows) = (residual.norm_squared(), residual.len() as f64);
    let matrix = DMatrix::from_columns(&columns);
    let gram = matrix.transpose() * &matrix;
    let side = matrix.transpose() * &residual;
    let mut names: Vec<&str> = of.clone();
    names.dedup();
    let mut near = Vec::new();
    let mut bic = Vec::new();
    for name in names {
        let own: Vec<usize> = (0..of.len()).filter(|i| of[*i] == name).collect();
        let g = DMatrix::from_fn(own.len(), own.len(), |i, j| {
            gram[(own[i], own[j])] + if i == j { 1e-9 } else { 0.0 }
        });
        let b = DVector::from_fn(own.len(), |i, _| side[own[i]]);
        let Some(solved) = g.cholesky().map(|c| c.solve(&b)) else { continue };
        let explained = b.dot(&solved);
        near.push((name, explained / energy.max(1e-12)));
        let left = ((energy - explained) / rows).max(1e-12);
        bic.push((name, -(rows * left.ln() + own.len() as f64 * rows.ln())));
    }
    let count = of.len();
    let joint = gram.clone() + DMatrix::identity(count, count) * 1e-8;
    let mut largest: Vec<(&str, f64)> = Vec::new();
    if let Some(inverse) = joint.try_inverse() {
        let fitted = &inverse * &side;
        let left = (energy - side.dot(&fitted)).max(1e-12) / (rows - count as f64).max(1.0);
        for (i, name) in of.iter().enumerate() {
            let z = fitted[i].abs() / (inverse[(i, i)].max(1e-300) * left).sqrt();
            match largest.iter_mut().find(|(n, _)| n == name) {
                Some((_, most)) => *most = most.max(z),
                None => largest.push((name, z)),
            }
        }
    }
    let none = -(rows * (energy / rows).max(1e-12).ln());
    let beyond = bic.iter().any(|(_, value)| *value > none);
    Ok(vec![ranked(near, true), ranked(largest, true), ranked(bic, beyond)])
}

/// The first three by what they score.
fn ranked(mut scores: Vec<(&str, f64)>, named: bool) -> Answer {
    scores.sort_by(|a, b| b.1.total_cmp(&a.1));
    let ranking: Vec<String> = scores.iter().take(3).map(|(name, _)| (*name).to_owned()).collect();
    let first = ranking.first().filter(|_| named).map(|name| Named {
        class: vec![name.clone()],
        firm: true,
        ..Named::default()
    });
    Answer { gap: named, unknown: false, named: first.into_iter().collect(), ranking, ..Answer::default() }
}
