//! Reference devices of a camera inside a soft body whose frames are the numbers of a picture's blocks.
//!
//! By design such a device reads what its family's own model says ([`Designs`]); what differs is computed here. Causes of lamps,
//! lens and converter act on blocks as on the pixels of a small picture ([`picture`]); causes of the elastomer act on the forces
//! of each place ([`loads`]), which is exact for a modulus: a linear elastomer knows force over modulus only. What it remembers
//! acts on what a touch changes.

mod causes;
mod picture;

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{SkinDescription, TipKind};
use nalgebra::Point3;
use rand::Rng;

use crate::cause::{Cause, Causes};
use crate::designs::Nominal;
use crate::fabric::{earlier, shift};
use crate::script::{Rig, Script};
use crate::{BenchmarkError, Designs, Noise, ReferenceDevice, Region, laws, memory};
use picture::{Blocks, COLOURS, Moved};

pub(crate) use causes::CAUSES;

/// \[m\] from the middle of a scratch, or of a soft spot, within which most of it is.
const SPOT: f64 = 0.008;
/// \[N\] of the touch that shows which blocks see a place.
const PROBE: f64 = 1.0;
/// Frames a second at most.
const RATE: f64 = 20.0;
/// \[s\] of a camera's exposure control.
const CONTROL: f64 = 0.33;
/// \[s\] that lamps are as good as new, and in which they have lost their size.
const FADING: [f64; 2] = [60.0, 3600.0];
/// \[Hz\] at which lamps beat with a picture, and turns of that between its rows.
const BEAT: (f64, f64) = (3.7, 2.3);
/// Drops on a stained lens, and how wide each is as a share of the picture's height.
const DROPS: (usize, f64) = (3, 0.12);

/// The reference device.
#[derive(Debug)]
pub(crate) struct CameraDevice {
    nominal: Nominal,
    blocks: Blocks,
    /// Where nothing touches.
    zero: Vec<f64>,
    noise: Vec<f64>,
    range: Vec<Option<[f64; 2]>>,
    /// Where a scratch or a soft spot is, and how much each block sees of a scratch, 0 to 1.
    spot: Point3<f64>,
    seeing: Vec<f64>,
    causes: Causes,
}

/// What presses such a skin.
pub(crate) fn rig(skin: &SkinDescription, size: f64) -> Rig {
    Rig {
        diameter: 0.004,
        tip: TipKind::Sphere,
        force: [0.1, 3.0],
        margin: 0.004,
        slide: [0.004, 0.010],
        rate: skin.rate.min(RATE),
        size,
        loudest: 1.0,
    }
}

/// Places \[px\] of drops on a lens.
fn drops(blocks: &Blocks, cause: &Cause) -> [[f64; 2]; DROPS.0] {
    let mut rng = cause.rng();
    let size = blocks.size();
    std::array::from_fn(|_| size.map(|s| s * rng.random_range(0.2..0.8)))
}

/// Contrast that drops leave a block, at full strength.
fn through(blocks: &Blocks, drops: &[[f64; 2]], block: usize) -> f64 {
    let (at, wide) = (blocks.middle(block), DROPS.1 * blocks.size()[1]);
    let covered = drops.iter().map(|d| (-((at[0] - d[0]).hypot(at[1] - d[1]) / wide).powi(4)).exp());
    1.0 - covered.fold(0.0, f64::max)
}

/// Where a cause sits.
pub(crate) fn place(skin: &SkinDescription, cause: &Cause) -> Option<Region> {
    match cause.id.as_str() {
        "scratched-inside" | "soft-spot" => {
            Some(Region::Place { at: cause.point_of(&skin.surface()).coords.into(), within: 2.0 * SPOT })
        }
        "stained-lens" => {
            let blocks = Blocks::of(skin, &skin.surface()).ok()?;
            let drops = drops(&blocks, cause);
            let covered = |(c, _): &(usize, _)| through(&blocks, &drops, c / blocks.per) < 0.5;
            let channels = skin.channels().iter().enumerate().filter(covered);
            Some(Region::Channels { names: channels.map(|(_, channel)| channel.name.clone()).collect() })
        }
        _ => None,
    }
}

/// From which time \[s\] on a bumped camera shows its picture elsewhere, and how.
fn bumped(cause: &Cause, way: f64, script: &Script) -> (f64, Moved) {
    let whole = script.instants.last().map_or(0.0, |i| i.time);
    (whole * cause.rng().random_range(0.3..0.7), askew(cause, way))
}

/// A picture that is moved by so many pixels, and turned a little.
fn askew(cause: &Cause, way: f64) -> Moved {
    let mut rng = cause.rng();
    rng.set_stream(6);
    let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
    Moved { by: [way * cos, way * sin], turn: 0.004 * way * rng.random_range(-1.0..1.0), larger: 0.0 }
}

impl CameraDevice {
    /// Whether such a reference device is like this skin.
    pub fn is_like(skin: &SkinDescription) -> bool {
        ["blocks", "camera", "lamps"].iter().all(|t| skin.medium.contains_key(*t))
    }

    pub fn new(
        skin: &SkinDescription,
        causes: &[Cause],
        designs: &Designs<'_>,
    ) -> Result<Self, BenchmarkError> {
        let causes = Causes::new(CAUSES, causes)?;
        let nominal = designs.of(skin)?;
        let blocks = Blocks::of(skin, nominal.model.surface())?;
        let mut zero = vec![0.0; nominal.model.channels()];
        nominal.model.untouched(&mut zero)?;
        let at = ["scratched-inside", "soft-spot"].into_iter().find_map(|id| causes.get(id));
        let spot = at.map_or_else(Point3::origin, |(cause, _)| cause.point_of(&skin.surface()));
        let seeing = match causes.get("scratched-inside") {
            Some(_) => seeing(&nominal, &blocks, &zero, &spot)?,
            None => Vec::new(),
        };
        Ok(Self {
            nominal,
            blocks,
            zero,
            noise: skin.channel_noise(),
            range: skin.channels().iter().map(|c| c.range).collect(),
            spot,
            seeing,
            causes,
        })
    }
}

/// How much each block sees of a place, 0 to 1: as much as a touch there changes its colours.
fn seeing(
    nominal: &Nominal,
    blocks: &Blocks,
    zero: &[f64],
    spot: &Point3<f64>,
) -> Result<Vec<f64>, BenchmarkError> {
    let (at, normal) = nominal.model.surface().project(spot);
    let touch = Indentation::sphere(at, -normal * PROBE, 0.004);
    let mut touched = vec![0.0; zero.len()];
    nominal.model.response(&Stimulus { contacts: vec![touch], ..Stimulus::default() }, &mut touched)?;
    let changes = touched.chunks(blocks.per).zip(zero.chunks(blocks.per));
    let changes: Vec<f64> = changes
        .map(|(a, b)| a.iter().zip(b).take(COLOURS).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt())
        .collect();
    let most = changes.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Ok(changes.into_iter().map(|c| c / most).collect())
}

impl ReferenceDevice for CameraDevice {
    fn model(&self) -> Arc<dyn ForwardModel> {
        Arc::clone(&self.nominal.model)
    }

    fn readings(&self, script: &Script, noise: Option<Noise>) -> Result<Vec<f64>, BenchmarkError> {
        let channels = self.zero.len();
        let mut readings = self.nominal.pressed(&self.causes, script)?;
        self.elastomer(script, &mut readings);
        self.light(script, &mut readings);
        self.lens(script, &mut readings);
        self.control(script, &mut readings);
        if let Some((_, duration)) = self.causes.get("rolling-rows") {
            let (rows, of_row) = (self.blocks.rows as f64, self.blocks.columns * self.blocks.per);
            let early = |c: usize| duration * (1.0 - (c / of_row) as f64 / rows);
            earlier(script, channels, early, &mut readings);
        }
        self.encoded(&mut readings);
        // Delays, and frames that are lost, know no zero.
        memory::electronics(&self.causes, script, channels, &mut readings);
        if let Some(noise) = noise {
            crate::add_noise(&self.noise, noise, &mut readings);
        }
        memory::converter(&self.causes, script, channels, &mut readings);
        memory::limit(&self.range, &mut readings);
        Ok(readings)
    }
}

impl CameraDevice {
    /// What the elastomer remembers, and where it differs: changes of what a touch changes.
    fn elastomer(&self, script: &Script, readings: &mut [f64]) {
        let ids = ["creeping", "standard-solid", "permanent-set", "soft-spot"];
        if ids.iter().all(|id| self.causes.get(id).is_none()) {
            return;
        }
        let channels = self.zero.len();
        shift(readings, &self.zero, -1.0);
        if let Some((_, rise)) = self.causes.get("soft-spot") {
            laws::soft_spot(script, channels, (&self.spot, SPOT), rise, readings);
        }
        if let Some((_, share)) = self.causes.get("creeping") {
            memory::creep(script, channels, (-share, 0.25), readings);
        }
        if let Some((cause, share)) = self.causes.get("standard-solid") {
            laws::standard_solid(script, channels, (-share, laws::solid_time(cause)), readings);
        }
        if let Some((_, share)) = self.causes.get("permanent-set") {
            laws::permanent_set(channels, share, readings);
        }
        shift(readings, &self.zero, 1.0);
    }

    /// Factor of the light of all blocks at an instant, by colour.
    fn dimmed(&self, time: f64, warmth: f64) -> [f64; COLOURS] {
        let mut factors = [1.0 + self.causes.size("built-exposure"); COLOURS];
        if let Some((cause, deviation)) = self.causes.get("white-balance") {
            factors.iter_mut().zip(cause.normals(COLOURS)).for_each(|(f, n)| *f *= (deviation * n).exp());
        }
        if let Some((_, loss)) = self.causes.get("fading-lamps") {
            let [good, hour] = FADING;
            let left = 1.0 - loss * ((time / good).ln_1p() / (hour / good).ln_1p()).min(1.0);
            factors = factors.map(|f| f * left);
        }
        if let Some((_, coefficient)) = self.causes.get("warm-lamps") {
            factors = factors.map(|f| f * (-coefficient * warmth).exp());
        }
        factors
    }

    /// What lamps and the inside do to the light of each block.
    fn light(&self, script: &Script, readings: &mut [f64]) {
        let ids =
            ["built-exposure", "white-balance", "fading-lamps", "warm-lamps", "weak-lamp", "beating-lamps"];
        let more = ["scratched-inside", "passing-glare"];
        if ids.iter().chain(&more).all(|id| self.causes.get(id).is_none()) {
            return;
        }
        let weak = self
            .causes
            .get("weak-lamp")
            .map(|(cause, loss)| (cause.rng().random_range(0..self.blocks.lamps()), loss));
        let (_, beating) = self.causes.get("beating-lamps").unzip();
        let scratch = self.causes.size("scratched-inside");
        let most = strongest(script);
        let glare = self.causes.get("passing-glare").map(|(cause, size)| Glare::of(cause, size, script));
        for (row, instant) in readings.chunks_mut(self.zero.len()).zip(&script.instants) {
            let all = self.dimmed(instant.time, instant.warmth());
            let open: f64 = instant
                .moment
                .stimulus
                .contacts
                .iter()
                .map(|c| {
                    let away = (c.position - self.spot).norm() / SPOT;
                    (c.force.norm() / most).sqrt() * (-0.5 * away * away).exp()
                })
                .sum();
            for block in 0..self.blocks.columns * self.blocks.rows {
                let mut factors = all;
                if let Some((lamp, loss)) = weak {
                    let lit = self.blocks.lit_by(block, lamp);
                    factors.iter_mut().zip(lit).for_each(|(f, share)| *f *= 1.0 - loss * share);
                }
                if let Some(depth) = beating {
                    let row = (block / self.blocks.columns) as f64 / self.blocks.rows as f64;
                    let turns = BEAT.0 * instant.time + BEAT.1 * row;
                    let beat = 1.0 + depth * (std::f64::consts::TAU * turns).sin();
                    factors = factors.map(|f| f * beat);
                }
                if scratch > 0.0 {
                    factors = factors.map(|f| f * (1.0 - scratch * open * self.seeing[block]).max(0.02));
                }
                self.blocks.lighten(row, block, factors);
            }
            if let Some(glare) = &glare
                && !instant.moment.stimulus.contacts.is_empty()
            {
                glare.add(&self.blocks, instant.moment.press, row);
            }
        }
    }

    /// What the lens and its mount do.
    fn lens(&self, script: &Script, readings: &mut [f64]) {
        let askew =
            self.causes.get("askew-camera").map(|(cause, way)| (f64::NEG_INFINITY, askew(cause, way)));
        let bumped = self.causes.get("bumped-camera").map(|(cause, way)| bumped(cause, way, script));
        let focal = self
            .causes
            .get("built-focal")
            .map(|(_, change)| (f64::NEG_INFINITY, Moved { by: [0.0; 2], turn: 0.0, larger: change }));
        let moved: Vec<(f64, Moved)> = [askew, bumped, focal].into_iter().flatten().collect();
        let radius = self.causes.size("out-of-focus");
        let power = self.causes.size("vignetting");
        let stained = self.causes.get("stained-lens").map(|(cause, loss)| (drops(&self.blocks, cause), loss));
        if moved.is_empty() && radius == 0.0 && power == 0.0 && stained.is_none() {
            return;
        }
        let [width, height] = self.blocks.size();
        for (row, instant) in readings.chunks_mut(self.zero.len()).zip(&script.instants) {
            for (_, moved) in moved.iter().filter(|(from, _)| instant.time > *from) {
                self.blocks.shift(row, *moved);
            }
            if radius > 0.0 {
                self.blocks.blur(row, radius);
            }
            for block in 0..self.blocks.columns * self.blocks.rows {
                if power > 0.0 {
                    let at = self.blocks.middle(block);
                    // Half a field of view of a right angle at half of the width.
                    let far = (at[0] - width / 2.0).hypot(at[1] - height / 2.0) / width;
                    self.blocks.lighten(row, block, [far.atan().cos().powf(4.0 * power); COLOURS]);
                }
                if let Some((drops, loss)) = &stained {
                    let left = 1.0 - loss * (1.0 - through(&self.blocks, drops, block));
                    self.blocks.fade(row, &self.zero, block, left);
                }
            }
        }
    }

    /// What a camera controls by itself: exposure and colours follow the picture's means.
    fn control(&self, script: &Script, readings: &mut [f64]) {
        let (exposure, balance) =
            (self.causes.size("automatic-exposure"), self.causes.size("automatic-balance"));
        if exposure == 0.0 && balance == 0.0 {
            return;
        }
        let means = |row: &[f64]| -> [f64; COLOURS] {
            let blocks = (self.blocks.columns * self.blocks.rows) as f64;
            let sum = |k: usize| row.iter().skip(k).step_by(self.blocks.per).sum::<f64>();
            std::array::from_fn(|k| (sum(k) / blocks).max(1e-3))
        };
        let rest = means(&self.zero);
        let mut seen = rest;
        let mut last: Option<f64> = None;
        for (row, instant) in readings.chunks_mut(self.zero.len()).zip(&script.instants) {
            let now = means(row);
            let step = last.map_or(0.0, |last| instant.time - last);
            last = Some(instant.time);
            let share = 1.0 - (-step / CONTROL).exp();
            seen.iter_mut().zip(now).for_each(|(seen, now)| *seen += (now - *seen) * share);
            let all = (rest.iter().sum::<f64>() / seen.iter().sum::<f64>()).powf(exposure * 4.0);
            let gains: [f64; COLOURS] = std::array::from_fn(|k| {
                let own = rest[k] / seen[k] * seen.iter().sum::<f64>() / rest.iter().sum::<f64>();
                // A few touched blocks move a mean little: cameras weigh what changes.
                all * own.powf(balance * 8.0)
            });
            let light = gains.map(|g| g.powf(self.blocks.gamma));
            for block in 0..self.blocks.columns * self.blocks.rows {
                self.blocks.lighten(row, block, light);
            }
        }
    }

    /// What becomes of light on its way into a file.
    fn encoded(&self, readings: &mut [f64]) {
        let (black, coarse) = (self.causes.size("black-level"), self.causes.get("coarse-pictures"));
        let change = self.causes.size("built-gamma");
        let texture = coarse.map(|(cause, step)| {
            let texture = cause.normals(self.blocks.squares());
            (step, texture.into_iter().map(|n| 0.03 * n).collect::<Vec<f64>>())
        });
        if black == 0.0 && change == 0.0 && texture.is_none() {
            return;
        }
        let gamma = self.blocks.gamma;
        for row in readings.chunks_mut(self.zero.len()) {
            if black > 0.0 {
                self.blocks.encode(row, |v| ((v.powf(gamma) + black) / (1.0 + black)).powf(1.0 / gamma));
            }
            if change != 0.0 {
                self.blocks.encode(row, |v| v.powf(1.0 / (1.0 + change)));
            }
            if let Some((step, texture)) = &texture {
                self.blocks.compress(row, *step, texture);
            }
        }
    }
}

/// \[N\] of the hardest press.
fn strongest(script: &Script) -> f64 {
    let contacts = script.instants.iter().flat_map(|i| &i.moment.stimulus.contacts);
    contacts.map(|c| c.force.norm()).fold(f64::MIN_POSITIVE, f64::max)
}

/// Light from outside, by press: how bright, and from which side \[rad\].
struct Glare {
    presses: Vec<Option<(f64, f64)>>,
}

impl Glare {
    /// One press in four is lit.
    fn of(cause: &Cause, size: f64, script: &Script) -> Self {
        let mut rng = cause.rng();
        let one = |_| {
            let (lit, bright) = (rng.random::<f64>() < 0.25, rng.random_range(0.5..1.5));
            let side = rng.random_range(0.0..std::f64::consts::TAU);
            lit.then_some((size * bright, side))
        };
        Self { presses: (0..=script.presses()).map(one).collect() }
    }

    fn add(&self, blocks: &Blocks, press: u64, row: &mut [f64]) {
        let Some(Some((bright, side))) = self.presses.get(press as usize) else { return };
        let (size, (sin, cos)) = (blocks.size(), side.sin_cos());
        for (block, numbers) in row.chunks_mut(blocks.per).enumerate() {
            let at = blocks.middle(block);
            let across = (at[0] / size[0] - 0.5) * cos + (at[1] / size[1] - 0.5) * sin;
            let lit = bright / (1.0 + (-12.0 * (across - 0.2)).exp());
            numbers[..COLOURS].iter_mut().for_each(|v| *v += lit);
        }
    }
}

#[cfg(test)]
mod tests;
