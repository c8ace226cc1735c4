//! What each effect would change in a recording: its signature, from our own simulator.
//!
//! Every effect is realised several times: at its typical parameters, at the ends of each parameter's range, and, where it is
//! drawn at random, for several devices. The principal components of what these realisations change are its columns. So a
//! parameter that acts nonlinearly (a time constant, a threshold) needs no treatment of its own. An effect that differs from
//! channel to channel gets components for each channel where components for all channels together do not foresee a device that
//! they were not made from.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

use dermis_model::{common_effect, full_scale};
use dermis_skin::{Effect, EffectInfo, SkinDescription};
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};

use crate::GapError;
use crate::algebra::{cholesky_solve, components, direction, dot};
use crate::data::Recording;
use crate::rows::Rows;
use crate::simulate::Simulator;
use crate::statistics::{Column, Statistics, Sum};

/// A device with one effect of its family, its seed, and what it read.
type DeviceReadings = (Effect, Option<u64>, Vec<f32>);
/// What a change that any family may have is called, how large it was, and what the device read.
type CommonReadings = (String, f64, Vec<f32>);
/// A change of a field over the distance, in units of its width.
type Shape = fn(f64) -> f64;

/// Devices that an effect is drawn for.
const DEVICES: u64 = 8;
/// Share of the energy of realisations that columns hold.
const HELD: f64 = 0.998;
/// Components of an effect for all channels together, and for each of them, at most.
const TOGETHER: usize = 5;
const EACH: usize = 3;
/// What components of the other devices must foresee of a device for an effect to act alike on all channels.
const FORESEEN: f64 = 0.9;
/// With so many of them.
const FEW: usize = 3;
/// In deviations of the noise, root mean square over rows and channels: below this an effect does not move the output.
const MOVED: f64 = 1e-3;
/// Share of the energy of a change that must not be in proportion to its amount to be a direction of its own.
const BEND: f64 = 0.01;
/// What two effects must explain of each other to be two names of one thing.
const SAME: f64 = 0.97;
/// Relative tolerance of every number of a data sheet.
const TOLERANCE: f64 = 0.05;
/// Relative tolerance of a contact law: exponent of the force, width of a footprint.
const LAW: f64 = 0.05;
/// Columns of the simulator's own error, at most.
const FORMS: usize = 12;
/// Simulations whose readings are held at once, about: those of one effect stay together.
const AT_ONCE: usize = 16;

/// An effect that may be the cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Name of the effect.
    pub name: String,
    /// One sentence for people.
    pub what: String,
    /// Whether its family knows it; otherwise it is common to all skins.
    pub family: bool,
    /// Whether it belongs to the rig.
    pub rig: bool,
    /// Its columns.
    pub columns: Vec<usize>,
    /// Whether each channel has columns of its own.
    pub each: bool,
    /// Whether it goes its own way through time: repeats do not show it, and no device foresees another.
    #[serde(default)]
    pub wanders: bool,
    /// Whether it is drawn at random and acts on readings other than in proportion to what is drawn: where it is large its columns
    /// leave what looks like other effects.
    #[serde(default)]
    pub bent: bool,
    /// Whether it follows the time since power-on: repeats do not show it either.
    #[serde(default)]
    pub timed: bool,
    /// A common effect that is the same thing, in which its values are written.
    pub form: Option<String>,
    /// Realisations: what was switched on, and coordinates of what it changed.
    pub starts: Vec<(Effect, Vec<f64>)>,
    /// What is written for each column and a coefficient of 1, for effects that are linear: effect, parameter, amount.
    pub linear: Vec<(String, String, f64)>,
}

/// Signatures of all effects in one recording, in deviations of the declared noise.
#[derive(Debug, Clone, Default)]
pub struct Signatures {
    /// Readings of the nominal model, rows × channels, in the unit of the skin.
    pub nominal: Vec<f32>,
    /// Columns of candidates, then of the simulator's own error.
    pub columns: Vec<Column>,
    /// Effects.
    pub candidates: Vec<Candidate>,
    /// Columns of the simulator's own error: its tolerances, each for a coefficient of 1.
    pub form: Vec<usize>,
    /// What the simulator's own error is made of.
    pub form_names: Vec<String>,
    /// Effects that cannot be seen in this recording, and why.
    pub silent: Vec<(String, String)>,
}

/// One simulation that signatures need.
struct Job {
    skin: SkinDescription,
    use_: Use,
}

enum Use {
    /// Of a family's effect: its place in the table, what was switched on, device where drawn.
    Family(usize, Effect, Option<u64>),
    /// Of a common effect: name, parameter, amount for which its column is.
    Common(&'static str, String, f64),
    /// All taxels moved along an axis.
    Taxels(usize, f64),
    /// One side of a tolerance: its name, and the side.
    Form(String, f64),
}

/// What one parameter of an effect changes.
struct Part {
    /// The effect in whose words it is written, where that is another one.
    effect: Option<&'static str>,
    parameter: String,
    /// Value for which the column is.
    amount: f64,
    column: Column,
}

impl Part {
    fn new(parameter: impl Into<String>, amount: f64, column: Column) -> Self {
        Self { effect: None, parameter: parameter.into(), amount, column }
    }
}

/// How far things are moved to see what that changes.
const SHIFT: f64 = 2e-4;
const TURN: f64 = 0.02;

impl Signatures {
    /// Simulates all effects of the skin's family, and those that every skin can have.
    ///
    /// # Errors
    ///
    /// [`GapError`] where the nominal model fails; effects that cannot be simulated are listed as silent.
    pub fn simulate(
        simulator: &Simulator<'_>,
        recording: &Recording,
        rows: &Rows,
        stop: &AtomicBool,
        progress: &ProgressBar,
    ) -> Result<Self, GapError> {
        let frames = rows.frames();
        let skin = simulator.skin;
        let channels = recording.channels;
        let nominal = simulator.readings(skin, recording, &frames)?;
        // A signature that is cut off at the end of the range is no longer in proportion to its effect.
        let open = simulator.unlimited(skin, recording, &frames)?;
        let noise = skin.channel_noise();
        let jobs = jobs(simulator, rows);
        progress.set_length(jobs.len() as u64);
        let mut found = Self { nominal, ..Self::default() };
        let deviation = |readings: &[f32]| -> Vec<f32> {
            readings
                .iter()
                .zip(&open)
                .enumerate()
                .map(|(i, (a, b))| (f64::from(a - b) / noise[i % channels]) as f32)
                .collect()
        };
        let mut refused: BTreeMap<String, String> = BTreeMap::new();
        let mut run = |jobs: Vec<Job>| -> Result<Vec<(Use, Vec<f32>)>, GapError> {
            let (skins, uses): (Vec<SkinDescription>, Vec<Use>) =
                jobs.into_iter().map(|j| (j.skin, j.use_)).unzip();
            let read = simulator.many(&skins, recording, (rows, false), stop, progress)?;
            let mut changed = Vec::new();
            for (use_, read) in uses.into_iter().zip(read) {
                match (read, use_) {
                    (Ok(read), use_) => changed.push((use_, deviation(&read))),
                    (Err(error), Use::Family(_, effect, _)) => {
                        refused.insert(effect.name, error.to_string());
                    }
                    (Err(_), _) => {}
                }
            }
            Ok(changed)
        };
        let (families, others): (Vec<Job>, Vec<Job>) =
            jobs.into_iter().partition(|j| matches!(j.use_, Use::Family(..)));
        let mut common: BTreeMap<&'static str, Vec<CommonReadings>> = BTreeMap::new();
        let mut taxels: [Vec<(f64, Vec<f32>)>; 3] = Default::default();
        let mut forms: BTreeMap<String, Vec<(f64, Vec<f32>)>> = BTreeMap::new();
        for (use_, changed) in run(others)? {
            match use_ {
                Use::Family(..) => {}
                Use::Common(name, parameter, amount) => {
                    common.entry(name).or_default().push((parameter, amount, changed));
                }
                Use::Taxels(axis, by) => taxels[axis].push((by, changed)),
                Use::Form(name, side) => forms.entry(name).or_default().push((side, changed)),
            }
        }
        found.common(skin, recording, rows, &noise, common, &taxels);
        let effect = |job: &Job| if let Use::Family(index, ..) = job.use_ { index } else { 0 };
        let mut batch: Vec<Job> = Vec::new();
        let mut left = families.into_iter().peekable();
        while let Some(job) = left.next() {
            let ends = left.peek().is_none_or(|next| effect(next) != effect(&job));
            batch.push(job);
            if !ends || (batch.len() < AT_ONCE && left.peek().is_some()) {
                continue;
            }
            let mut family: BTreeMap<usize, Vec<DeviceReadings>> = BTreeMap::new();
            for (use_, changed) in run(std::mem::take(&mut batch))? {
                if let Use::Family(index, effect, device) = use_ {
                    family.entry(index).or_default().push((effect, device, changed));
                }
            }
            for (index, realised) in family {
                found.family(&simulator.effects[index], &realised, rows, channels);
            }
        }
        for (name, reason) in refused {
            if !found.candidates.iter().any(|c| c.name == name) {
                found.silent.push((name, reason));
            }
        }
        found.name_alike(rows, channels);
        found.forms(forms, &taxels, skin, rows, &noise, channels);
        Ok(found)
    }

    /// Adds an effect that is known by its columns, each of one parameter; those that move nothing are left out.
    fn add_linear(&mut self, name: &str, each: bool, parts: Vec<Part>, least: f64) {
        let Some(info) = common_effect(name) else { return };
        let mut candidate = Candidate {
            name: name.to_owned(),
            what: info.what.to_owned(),
            family: false,
            rig: info.rig,
            columns: Vec::new(),
            each,
            wanders: false,
            bent: info.signature.nonlinear,
            timed: info.signature.depends_on_uptime,
            form: None,
            starts: Vec::new(),
            linear: Vec::new(),
        };
        for Part { effect, parameter, amount, column } in parts {
            if dot(&column.values, &column.values).sqrt() < least {
                continue;
            }
            candidate.columns.push(self.columns.len());
            candidate.linear.push((effect.unwrap_or(name).to_owned(), parameter, amount));
            self.columns.push(column);
        }
        if candidate.columns.is_empty() {
            self.silent.push((name.to_owned(), "nothing in this recording shows it".to_owned()));
        } else {
            self.candidates.push(candidate);
        }
    }

    fn common(
        &mut self,
        skin: &SkinDescription,
        recording: &Recording,
        rows: &Rows,
        noise: &[f64],
        simulated: BTreeMap<&'static str, Vec<CommonReadings>>,
        taxels: &[Vec<(f64, Vec<f32>)>; 3],
    ) {
        let (n, channels) = (rows.rows.len(), recording.channels);
        let least = MOVED * ((n * channels) as f64).sqrt();
        let names: Vec<String> = skin.channels().iter().map(|c| c.name.clone()).collect();
        let of_channel = |amount: f64, value: &dyn Fn(usize, usize) -> f64| -> Vec<Part> {
            (0..channels)
                .map(|k| {
                    let values = (0..n).map(|i| (amount * value(i, k) / noise[k]) as f32).collect();
                    Part::new(&names[k], amount, Column { channel: Some(k), values })
                })
                .collect()
        };
        let nominal = |i: usize, k: usize| f64::from(self.nominal[i * channels + k]);
        let sigma = noise.iter().sum::<f64>() / noise.len().max(1) as f64;
        let offsets = of_channel(sigma, &|_, _| 1.0);
        let gains = of_channel(0.05, &nominal);
        let full: Vec<f64> = skin.channels().iter().map(|c| full_scale(c, skin.noise)).collect();
        let bends = of_channel(0.05, &|i, k| nominal(i, k).powi(2) / full[k]);
        // A temperature that hardly changes tells nothing.
        let kelvin: Vec<f64> = rows.rows.iter().map(|r| r.temperature).collect();
        let known = kelvin.iter().all(|t| t.is_finite());
        let (low, high) =
            kelvin.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), t| (l.min(*t), h.max(*t)));
        let thermal = (known && high - low > 0.2).then(|| {
            let warm = |i: usize| kelvin[i] - 293.15;
            let mut zeros = of_channel(sigma, &|i, _| warm(i));
            let bends = of_channel(0.1 * sigma, &|i, _| warm(i) * warm(i));
            zeros.extend(bends.into_iter().map(|part| Part { effect: Some("thermal-bend"), ..part }));
            (zeros, of_channel(0.01, &|i, k| warm(i) * nominal(i, k)))
        });
        // Sensitivity goes with the time in use and with presses, and what is cold goes home from switching on.
        let scaled = |way: &dyn Fn(usize) -> f64| -> Column {
            let value =
                |i: usize| way(i / channels) * nominal(i / channels, i % channels) / noise[i % channels];
            Column { channel: None, values: (0..n * channels).map(|i| value(i) as f32).collect() }
        };
        let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max).max(1e-9);
        let times: Vec<f64> = rows.rows.iter().map(|r| r.time).collect();
        let counts = presses(rows);
        let (rate, wear) = (0.1 / largest(&times), 0.1 / largest(&counts));
        let ageing = vec![
            Part::new("rate", rate, scaled(&|row| -rate * times[row])),
            Part::new("wear", wear, scaled(&|row| -wear * counts[row])),
        ];
        let ways = cooling(rows);
        let mut warming: Vec<Part> = Vec::new();
        for k in 0..channels {
            for way in &ways {
                let factor = (sigma / noise[k]) as f32;
                let values = way.iter().map(|v| v * factor).collect();
                warming.push(Part::new(&names[k], sigma, Column { channel: Some(k), values }));
            }
        }
        for way in &ways {
            warming.push(Part::new("span", 0.1, scaled(&|row| 0.1 * f64::from(way[row]))));
        }
        self.add_linear("channel-offset", true, offsets, least);
        self.add_linear("channel-gain", true, gains, least);
        self.add_linear("channel-curvature", true, bends, least);
        if let Some((zero, span)) = thermal {
            self.add_linear("thermal-zero", true, zero, least);
            self.add_linear("thermal-span", true, span, least);
        } else {
            let why = if known {
                "the temperature hardly changes in this recording"
            } else {
                "the temperature is not recorded"
            };
            for name in ["thermal-zero", "thermal-span"] {
                self.silent.push((name.to_owned(), why.to_owned()));
            }
        }
        self.add_linear("ageing", false, ageing, least);
        self.add_linear("warm-up", true, warming, least);
        let owners = skin.channel_taxels();
        let mut parts = Vec::new();
        for (axis, realised) in taxels.iter().enumerate() {
            let Some(slope) = central(realised) else { continue };
            for k in 0..channels {
                let values = (0..n).map(|i| slope[i * channels + k] * SHIFT as f32).collect();
                let name = format!("{}.{}", skin.taxels[owners[k]].name, ["x", "y", "z"][axis]);
                parts.push(Part::new(name, SHIFT, Column { channel: Some(k), values }));
            }
        }
        // Channels of one taxel move together, which columns of a channel each cannot say.
        if owners.iter().collect::<std::collections::BTreeSet<_>>().len() == owners.len() {
            self.add_linear("taxel-position", true, parts, least);
        }
        for (name, mut realised) in simulated {
            let mut parameters: Vec<String> = realised.iter().map(|(p, ..)| p.clone()).collect();
            parameters.dedup();
            let mut parts = Vec::new();
            for parameter in parameters {
                let of: Vec<(f64, Vec<f32>)> = realised
                    .iter_mut()
                    .filter(|(p, ..)| *p == parameter)
                    .map(|(_, amount, changed)| (*amount, std::mem::take(changed)))
                    .collect();
                let reach = of.iter().map(|(a, _)| a.abs()).fold(0.0, f64::max);
                if let Some(slope) = central(&of) {
                    let values: Vec<f32> = slope.iter().map(|v| v * reach as f32).collect();
                    let along = dot(&values, &values);
                    // What a large amount changes beyond that is a direction of its own; the first one says the amount.
                    let bend = of.iter().find(|(amount, _)| *amount == reach).map(|(_, large)| {
                        let part = (dot(large, &values) / along.max(1e-300)) as f32;
                        large.iter().zip(&values).map(|(l, v)| l - part * v).collect::<Vec<f32>>()
                    });
                    parts.push(Part::new(&parameter, reach, Column { channel: None, values }));
                    if let Some(values) = bend.filter(|b| dot(b, b) > BEND * along) {
                        parts.push(Part::new(parameter, 0.0, Column { channel: None, values }));
                    }
                }
            }
            self.add_linear(name, false, parts, least);
        }
    }

    /// Adds a family's effect by the components of its realisations.
    fn family(
        &mut self,
        info: &EffectInfo,
        realised: &[(Effect, Option<u64>, Vec<f32>)],
        rows: &Rows,
        channels: usize,
    ) {
        let n = rows.rows.len();
        let vectors: Vec<&[f32]> = realised.iter().map(|(.., v)| v.as_slice()).collect();
        let rms = |v: &[f32]| (dot(v, v) / (n * channels).max(1) as f64).sqrt();
        if vectors.iter().map(|v| rms(v)).fold(0.0, f64::max) < MOVED {
            self.silent
                .push((info.name.to_owned(), "it does not move any reading in this recording".to_owned()));
            return;
        }
        let each = info.random && !foreseen(realised);
        let wanders = info.random.then(|| wander(realised, rows, channels)).flatten();
        let mut bent = info.random && wanders.is_none();
        let mut columns: Vec<Column> = Vec::new();
        if let Some(common) = &wanders {
            columns = drifts(rows, common, channels);
        } else if each {
            // One for each channel says that it is in proportion.
            bent = false;
            for k in 0..channels {
                let own: Vec<Vec<f32>> =
                    vectors.iter().map(|v| (0..n).map(|i| v[i * channels + k]).collect()).collect();
                let (found, _) = components(&own, HELD, EACH);
                bent |= found.len() > 1;
                columns.extend(found.into_iter().map(|values| Column { channel: Some(k), values }));
            }
        } else {
            let (found, _) = components(&vectors, HELD, TOGETHER);
            columns.extend(found.into_iter().map(|values| Column { channel: None, values }));
        }
        let first = self.columns.len();
        let norms: Vec<f64> = columns.iter().map(|c| dot(&c.values, &c.values)).collect();
        let starts = if each || wanders.is_some() {
            Vec::new()
        } else {
            let coordinates = |v: &[f32]| -> Vec<f64> {
                columns.iter().zip(&norms).map(|(c, norm)| dot(&c.values, v) / norm).collect()
            };
            realised.iter().map(|(effect, _, v)| (effect.clone(), coordinates(v))).collect()
        };
        self.candidates.push(Candidate {
            name: info.name.to_owned(),
            what: info.what.to_owned(),
            family: true,
            rig: false,
            columns: (first..first + columns.len()).collect(),
            each: each || wanders.is_some(),
            wanders: wanders.is_some(),
            bent,
            timed: false,
            form: None,
            starts,
            linear: Vec::new(),
        });
        self.columns.append(&mut columns);
    }

    /// A family's effect that a common one says as well, and the other way round, is that one under the family's name.
    fn name_alike(&mut self, rows: &Rows, channels: usize) {
        let nothing = vec![0.0f32; rows.rows.len() * channels];
        let gram = Gram::of(&Statistics::new(&self.columns, &nothing, rows, channels));
        let mut merged: Vec<usize> = Vec::new();
        for f in 0..self.candidates.len() {
            if !(self.candidates[f].family && self.candidates[f].each) {
                continue;
            }
            for c in 0..self.candidates.len() {
                let (family, common) = (&self.candidates[f], &self.candidates[c]);
                if common.family || !common.each {
                    continue;
                }
                let there = gram.explained(&family.columns, &common.columns);
                let back = gram.explained(&common.columns, &family.columns);
                if there > SAME && back > SAME {
                    let (columns, linear, form) =
                        (common.columns.clone(), common.linear.clone(), common.name.clone());
                    let family = &mut self.candidates[f];
                    (family.columns, family.linear, family.form) = (columns, linear, Some(form));
                    merged.push(c);
                    break;
                }
            }
        }
        let mut index = 0;
        self.candidates.retain(|_| {
            index += 1;
            !merged.contains(&(index - 1))
        });
    }

    /// Columns of what the simulator itself may have wrong: numbers of data sheets within their tolerance, the tip, and laws of
    /// contact and of spread that every model simplifies.
    fn forms(
        &mut self,
        simulated: BTreeMap<String, Vec<(f64, Vec<f32>)>>,
        taxels: &[Vec<(f64, Vec<f32>)>; 3],
        skin: &SkinDescription,
        rows: &Rows,
        noise: &[f64],
        channels: usize,
    ) {
        let mut vectors = Vec::new();
        for (name, sides) in simulated {
            if let Some(change) = central(&sides) {
                vectors.push(change);
                self.form_names.push(name);
            }
        }
        let whitened = |value: &dyn Fn(usize, usize) -> f64| -> Vec<f32> {
            (0..rows.rows.len() * channels)
                .map(|i| {
                    let (row, k) = (i / channels, i % channels);
                    (value(row, k) / noise[k]) as f32
                })
                .collect()
        };
        let nominal = |i: usize, k: usize| f64::from(self.nominal[i * channels + k]);
        let forces: Vec<f64> = rows.rows.iter().filter(|r| r.force > 0.0).map(|r| r.force.ln()).collect();
        let mean = forces.iter().sum::<f64>() / forces.len().max(1) as f64;
        vectors.push(whitened(&|i, k| {
            let force = rows.rows[i].force;
            if force > 0.0 { LAW * nominal(i, k) * (force.ln() - mean) } else { 0.0 }
        }));
        self.form_names.push("exponent of the force".to_owned());
        // How far a channel's taxel is from the contact: shape of the spread.
        let owners = skin.channel_taxels();
        let distance = |i: usize, k: usize| {
            let (p, t) = (rows.rows[i].position, skin.taxels[owners[k]].position);
            let square: f64 = p.iter().zip(t).map(|(a, b)| (a - b).powi(2)).sum();
            square.sqrt()
        };
        let mut scale: f64 = 0.0;
        let mut weight: f64 = 0.0;
        for i in 0..rows.rows.len() {
            for k in 0..channels {
                let (d, s) = (distance(i, k), nominal(i, k).powi(2));
                if d.is_finite() {
                    scale += s * d;
                    weight += s;
                }
            }
        }
        let scale = scale / weight.max(1e-300);
        if scale > 0.0 {
            let shapes: [(&str, Shape); 3] = [
                ("height of the spread", |q| (-q * q).exp()),
                ("width of the spread", |q| q * q * (-q * q / 4.0).exp()),
                ("tail of the spread", |q| q * q / (1.0 + q * q)),
            ];
            for (name, shape) in shapes {
                vectors.push(whitened(&|i, k| {
                    let q = distance(i, k) / scale;
                    if q.is_finite() { LAW * nominal(i, k) * shape(q) } else { 0.0 }
                }));
                self.form_names.push(name.to_owned());
            }
            // Depth of all taxels together, as a share of the distance that they see contacts from.
            if let Some(slope) = central(&taxels[2]) {
                vectors.push(slope.iter().map(|v| v * (LAW * scale) as f32).collect());
                self.form_names.push("depth of all taxels".to_owned());
            }
        }
        // Many tolerances at once: components of their sum, not of their mean.
        let (mut found, _) = components(&vectors, 0.9995, FORMS);
        let back = (vectors.len() as f32).sqrt();
        for values in &mut found {
            values.iter_mut().for_each(|v| *v *= back);
            self.form.push(self.columns.len());
            self.columns.push(Column { channel: None, values: std::mem::take(values) });
        }
    }
}

/// All simulations that signatures need.
fn jobs(simulator: &Simulator<'_>, rows: &Rows) -> Vec<Job> {
    let skin = simulator.skin;
    let mut jobs = Vec::new();
    for (index, info) in simulator.effects.iter().enumerate() {
        let base = skin.effects.iter().find(|e| e.name == info.name && e.strength > 0.0);
        let base = base.cloned().unwrap_or_else(|| Effect::new(info.name));
        let mut realise = |effect: Effect, device: Option<u64>| {
            let skin = simulator.with(std::slice::from_ref(&effect));
            jobs.push(Job { skin, use_: Use::Family(index, effect, device) });
        };
        let drawn =
            |effect: Effect, device: u64| if info.random { effect.seed(1000 + device) } else { effect };
        for device in 0..if info.random { DEVICES } else { 1 } {
            realise(drawn(base.clone(), device), info.random.then_some(device));
        }
        for parameter in info.parameters {
            for value in parameter.range {
                if value != info.value(&base, parameter.name) {
                    let effect = base.clone().with(parameter.name, value);
                    // Devices that differ by more than a parameter say nothing of either.
                    realise(drawn(effect, 0), None);
                }
            }
        }
    }
    let mut common = |name: &'static str, parameter: &str, value: f64, amount: f64| {
        let effect = Effect::new(name).with(parameter, value);
        let skin = simulator.with(&[effect]);
        jobs.push(Job { skin, use_: Use::Common(name, parameter.to_owned(), amount) });
    };
    let period = 1.0 / skin.rate;
    common("delay", "time", period, period);
    common("delay", "time", 5.0 * period, 5.0 * period);
    common("low-pass", "time", period, period);
    common("low-pass", "time", 10.0 * period, 10.0 * period);
    let flat = rows.rows.iter().all(|r| !r.position[2].is_finite() || r.position[2].abs() < 1e-6);
    for axis in ["x", "y", "z"].into_iter().take(if flat { 2 } else { 3 }) {
        for side in [1.0, -1.0] {
            common("truth-shift", axis, side * SHIFT, side * SHIFT);
        }
    }
    if skin.channels().len() > 1 {
        for side in ["before", "after"] {
            common("crosstalk", side, 0.05, 0.05);
        }
    }
    for side in [1.0, -1.0] {
        common("truth-shift", "turn", side * TURN, side * TURN);
        common("force-scale", "factor", 1.0 + side * 0.05, side * 0.05);
        common("force-zero", "force", side * 0.005, side * 0.005);
        common("tip-scale", "factor", 1.0 + side * 0.1, side * 0.1);
    }
    for axis in 0..3 {
        for by in [SHIFT, -SHIFT] {
            let mut moved = skin.clone();
            moved.taxels.iter_mut().for_each(|t| t.position[axis] += by);
            jobs.push(Job { skin: moved, use_: Use::Taxels(axis, by) });
        }
    }
    for (name, value) in &skin.medium {
        let number = value.as_float().or_else(|| value.as_integer().map(|i| i as f64));
        let Some(number) = number.filter(|v| *v != 0.0) else { continue };
        for side in [1.0, -1.0] {
            let mut other = skin.clone();
            let changed = number * (1.0 + side * TOLERANCE);
            other.medium.insert(name.clone(), toml::Value::Float(changed));
            jobs.push(Job { skin: other, use_: Use::Form(format!("medium.{name}"), side) });
        }
    }
    for side in [1.0, -1.0] {
        let skin = simulator.with(&[Effect::new("tip-scale").with("factor", 1.0 + side * TOLERANCE)]);
        jobs.push(Job { skin, use_: Use::Form("diameter of the tip".to_owned(), side) });
    }
    jobs
}

/// \[s\] of zeros that go home from switching on: half an order of magnitude apart.
const WARMING: [f64; 5] = [30.0, 95.0, 300.0, 950.0, 3000.0];
/// Ways of them that columns are made for.
const WARM: usize = 2;

/// What all zeros that go home from switching on have in common: a few ways, one value a row each.
pub(crate) fn cooling(rows: &Rows) -> Vec<Vec<f32>> {
    let ways: Vec<Vec<f32>> = WARMING.iter().map(|tau| going_home(rows, *tau)).collect();
    components(&ways, 0.9999, WARM).0
}

/// What is left of a zero at power-on, one value a row.
fn going_home(rows: &Rows, time: f64) -> Vec<f32> {
    rows.rows.iter().map(|r| (-r.time / time).exp() as f32).collect()
}

/// Presses that have begun so far in the run of each row.
fn presses(rows: &Rows) -> Vec<f64> {
    let mut first: BTreeMap<u32, usize> = BTreeMap::new();
    let mut last = 0.0;
    rows.rows
        .iter()
        .map(|r| {
            // What comes between two presses has the count of the one before.
            if r.press != usize::MAX {
                last = (r.press - *first.entry(r.location.0).or_insert(r.press) + 1) as f64;
            } else if !first.contains_key(&r.location.0) {
                last = 0.0;
            }
            last
        })
        .collect()
}

/// The values at power-on, and the time, that come nearest to what `ways` (one value a row) say.
pub(crate) fn warming(rows: &Rows, ways: &[Vec<f32>]) -> (Vec<f64>, f64) {
    // Half an order of magnitude in twelve steps.
    let times = (0..=48).map(|i| WARMING[0] * 10f64.powf(f64::from(i) / 24.0));
    let mut best = (f64::INFINITY, vec![0.0; ways.len()], WARMING[2]);
    for time in times {
        let way = going_home(rows, time);
        let energy = dot(&way, &way).max(1e-300);
        let along: Vec<f64> = ways.iter().map(|values| dot(&way, values)).collect();
        let left: f64 = ways.iter().zip(&along).map(|(v, a)| dot(v, v) - a * a / energy).sum();
        if left < best.0 {
            best = (left, along.iter().map(|a| a / energy).collect(), time);
        }
    }
    (best.1, best.2)
}

/// Change for an amount of 1: central where both sides are known, of one side otherwise.
fn central(sides: &[(f64, Vec<f32>)]) -> Option<Vec<f32>> {
    let plus = sides.iter().find(|(a, _)| *a > 0.0);
    let minus = sides.iter().find(|(a, _)| *a < 0.0);
    match (plus, minus) {
        (Some((a, p)), Some((b, m))) => {
            Some(p.iter().zip(m).map(|(p, m)| (p - m) / (a - b) as f32).collect())
        }
        (Some((a, v)), None) | (None, Some((a, v))) => Some(v.iter().map(|v| v / *a as f32).collect()),
        (None, None) => None,
    }
}

/// Whether components of all devices but one foresee that one.
fn foreseen(realised: &[(Effect, Option<u64>, Vec<f32>)]) -> bool {
    let mut devices: Vec<Vec<f32>> =
        realised.iter().filter(|r| r.1.is_some()).map(|(.., v)| v.clone()).collect();
    // What all devices have in common says nothing of how they differ.
    let count = devices.len().max(1) as f32;
    let mut mean = vec![0.0f32; devices.first().map_or(0, Vec::len)];
    for device in &devices {
        mean.iter_mut().zip(device).for_each(|(m, v)| *m += v / count);
    }
    for device in &mut devices {
        device.iter_mut().zip(&mean).for_each(|(v, m)| *v -= m);
    }
    let mut shares = Vec::new();
    for left in 0..devices.len() {
        let others: Vec<&[f32]> =
            devices.iter().enumerate().filter(|(i, _)| *i != left).map(|(_, v)| v.as_slice()).collect();
        let (found, _) = components(&others, 0.9999, FEW);
        let target = &devices[left];
        let energy = dot(target, target);
        let held: f64 = found.iter().map(|c| dot(c, target).powi(2) / dot(c, c).max(1e-300)).sum::<f64>();
        shares.push(if energy > 0.0 { held / energy } else { 1.0 });
    }
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() / 2).is_some_and(|s| *s > FORESEEN)
}

/// Bends of a way through time, in each run.
const BENDS: usize = 12;

/// Ways through time that are straight between as many bends: one value a row each, and which stretch of time each belongs to.
fn bends(rows: &Rows) -> (Vec<Vec<f32>>, Vec<usize>) {
    let n = rows.rows.len();
    let mut found: Vec<Vec<f32>> = Vec::new();
    let mut stretches = Vec::new();
    let mut start = 0;
    while start < n {
        // A pause, and another run, part it.
        let mut end = start + 1;
        while end < n
            && rows.rows[end].location.0 == rows.rows[start].location.0
            && (0.0..PAUSE).contains(&(rows.rows[end].time - rows.rows[end - 1].time))
        {
            end += 1;
        }
        let (first, last) = (rows.rows[start].time, rows.rows[end - 1].time);
        let bends = BENDS.min((end - start) / 20 + 1);
        let apart = (last - first).max(1e-9) / bends as f64;
        for bend in 0..=bends {
            let mut values = vec![0.0f32; n];
            for (value, row) in values[start..end].iter_mut().zip(&rows.rows[start..end]) {
                let at = (row.time - first) / apart;
                *value = (1.0 - (at - bend as f64).abs()).max(0.0) as f32;
            }
            found.push(values);
            stretches.push(start);
        }
        start = end;
    }
    (found, stretches)
}

/// \[s\] without rows after which a way through time starts anew.
const PAUSE: f64 = 120.0;
/// What the bends must hold of a device's way for it to be one.
const SMOOTH: f64 = 0.9;

/// Takes the straight line from the first to the last value out.
fn straighten(values: &mut [f64]) {
    let (Some(&first), Some(&last)) = (values.first(), values.last()) else { return };
    let steps = (values.len() - 1).max(1) as f64;
    for (i, v) in values.iter_mut().enumerate() {
        *v -= first + (last - first) * i as f64 / steps;
    }
}

/// What an effect does to each channel beside the others, where it goes its own way through time, whatever touches: one number a
/// channel where it is the same way in all of them, none where each has its own.
fn wander(realised: &[(Effect, Option<u64>, Vec<f32>)], rows: &Rows, channels: usize) -> Option<Vec<f64>> {
    let n = rows.rows.len();
    let (ways, stretches) = bends(rows);
    let devices: Vec<&Vec<f32>> = realised.iter().filter(|r| r.1.is_some()).map(|(.., v)| v).collect();
    if devices.len() < 3 || ways.is_empty() {
        return None;
    }
    let m = ways.len();
    let mut normal = vec![0.0; m * m];
    for i in 0..m {
        for j in 0..m {
            normal[i * m + j] = dot(&ways[i], &ways[j]);
        }
        normal[i * m + i] += 1e-6;
    }
    // Coefficients of every device's ways, a channel after another, and how much they hold.
    let mut along: Vec<Vec<f64>> = Vec::new();
    for device in &devices {
        let (mut held, mut all) = (0.0, 0.0);
        let mut own = Vec::new();
        for k in 0..channels {
            let values: Vec<f32> = (0..n).map(|i| device[i * channels + k]).collect();
            let b: Vec<f64> = ways.iter().map(|w| dot(w, &values)).collect();
            let mut x = b.clone();
            cholesky_solve(&mut normal.clone(), m, &mut x)?;
            held += x.iter().zip(&b).map(|(x, b)| x * b).sum::<f64>();
            all += dot(&values, &values);
            own.extend(x);
        }
        if held < SMOOTH * all {
            return None;
        }
        along.push(own);
    }
    // What follows the temperature has one shape of way in all devices: it is foreseen. Where a way starts and ends is no shape.
    for way in along.iter_mut().flat_map(|own| own.chunks_exact_mut(m)) {
        let mut rest = way;
        for stretch in stretches.chunk_by(|a, b| a == b) {
            let (part, other) = rest.split_at_mut(stretch.len());
            straighten(part);
            rest = other;
        }
    }
    let (mut seen, mut all) = (0.0, 0.0);
    for (d, own) in along.iter().enumerate() {
        let others = along.iter().enumerate().filter(|(o, _)| *o != d);
        let first = direction(others.flat_map(|(_, o)| o.chunks_exact(m)), m);
        for way in own.chunks_exact(m) {
            seen += first.iter().zip(way).map(|(c, w)| c * w).sum::<f64>().powi(2);
            all += way.iter().map(|w| w * w).sum::<f64>();
        }
    }
    if seen > SMOOTH * all {
        return None;
    }
    // One way for all channels?
    let mut patterns: Vec<Vec<f32>> = Vec::new();
    for own in &along {
        for w in 0..m {
            patterns.push((0..channels).map(|k| own[k * m + w] as f32).collect());
        }
    }
    let (found, _) = components(&patterns, 0.9999, 1);
    let energy: f64 = patterns.iter().map(|p| dot(p, p)).sum();
    let first = found.first()?;
    let held: f64 =
        patterns.iter().map(|p| dot(first, p).powi(2)).sum::<f64>() / dot(first, first).max(1e-300);
    if held > 0.97 * energy {
        let largest = first.iter().fold(0.0f32, |l, v| if v.abs() > l.abs() { *v } else { l });
        Some(first.iter().map(|v| f64::from(v / largest)).collect())
    } else {
        Some(Vec::new())
    }
}

/// Columns of ways through time: those of all channels by the numbers `common`, or each channel's own.
fn drifts(rows: &Rows, common: &[f64], channels: usize) -> Vec<Column> {
    let (ways, _) = bends(rows);
    if common.is_empty() {
        // As many as a fit can bear, and a few for each of many channels.
        let every = (channels * ways.len()).div_ceil(DRIFTS.max(FEW * channels)).max(1);
        let merged: Vec<Vec<f32>> = ways
            .chunks(every)
            .map(|of| {
                let mut sum = vec![0.0f32; rows.rows.len()];
                of.iter().for_each(|w| sum.iter_mut().zip(w).for_each(|(s, v)| *s += v));
                sum
            })
            .collect();
        return (0..channels)
            .flat_map(|k| merged.iter().map(move |w| Column { channel: Some(k), values: w.clone() }))
            .collect();
    }
    ways.iter()
        .map(|way| {
            let values = way.iter().flat_map(|v| common.iter().map(move |c| v * *c as f32)).collect();
            Column { channel: None, values }
        })
        .collect()
}

/// Columns of drifts, at most.
const DRIFTS: usize = 160;

/// Products of all columns over all rows.
pub(crate) struct Gram {
    sum: Sum,
}

impl Gram {
    /// Over all groups of these statistics.
    pub(crate) fn of(statistics: &Statistics) -> Self {
        Self { sum: statistics.sum(&vec![1.0; statistics.groups()]) }
    }

    /// Share of the energy of columns `of` that lies in the span of columns `by`.
    pub(crate) fn explained(&self, of: &[usize], by: &[usize]) -> f64 {
        let factor = self.sum.factor(by, |_, g| g * (1.0 + 1e-9) + 1e-12);
        let (mut held, mut all) = (0.0, 0.0);
        for &t in of {
            if let Some(factor) = &factor {
                let b: Vec<f64> = by.iter().map(|&i| self.sum.at(i, t)).collect();
                held += factor.held(&b);
            }
            all += self.sum.diagonal(t);
        }
        if all > 0.0 { held / all } else { 0.0 }
    }
}
