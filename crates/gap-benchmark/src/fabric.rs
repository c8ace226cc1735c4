//! Reference devices of a resistive sheet over foam that is fed and read at electrodes, one injection after another.
//!
//! By design such a device reads what its family's own model says ([`Designs`]); what differs is computed here. Causes of the
//! sheet change it by the difference of two solutions of a sheet of this crate ([`sheet`]); causes of the foam act on the forces
//! of each place ([`loads`]); causes of seams, switches and wires act on the network of resistances between electrodes
//! ([`wires`]); numbers of the description are other ones in the description that the model is made of.

mod causes;
mod sheet;
mod wires;

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation};
use dermis_skin::{SkinDescription, SurfaceSpec, TipKind};
use nalgebra::Point3;
use rand::Rng;
use rand_distr::StandardNormal;

use crate::cause::{Cause, Causes};
use crate::designs::Nominal;
use crate::script::{Rig, Script};
use crate::{BenchmarkError, Designs, Noise, Numerics, ReferenceDevice, Region, laws, memory, number};
use sheet::{Foam, Sheet, Weave};
use wires::Drive;

pub(crate) use causes::CAUSES;
pub(crate) use wires::earlier;

/// \[m\] from the middle of a torn patch within which most of it is, and of a soft spot.
const PATCH: f64 = 0.06;
/// \[s\] in which a side dries.
const DRIES: f64 = 300.0;
/// Frames a second at most: a recorder that keeps every so many of a fast panel.
const RATE: f64 = 25.0;
/// Causes that another sheet shows.
const OF_SHEET: [&str; 3] = ["displaced-electrodes", "warp-and-weft", "torn-patch"];
/// Numbers of the description, by the cause that changes them.
const NUMBERS: [(&str, [&str; 2]); 5] = [
    ("built-conductance", ["foam", "conductance"]),
    ("built-exponent", ["foam", "exponent"]),
    ("built-fabric", ["sheet", "bottom"]),
    ("built-electrodes", ["electrodes", "radius"]),
    ("built-cover", ["top", "thickness"]),
];

/// The reference device.
#[derive(Debug)]
pub(crate) struct FabricDevice {
    nominal: Nominal,
    /// \[V\] where nothing touches.
    zero: Vec<f64>,
    noise: Vec<f64>,
    range: Vec<Option<[f64; 2]>>,
    drive: Drive,
    sheets: Option<Sheets>,
    /// Where a soft spot is.
    soft: Point3<f64>,
    causes: Causes,
}

/// Sheets whose differences are added.
#[derive(Debug)]
struct Sheets {
    design: Sheet,
    /// As it is from the start.
    still: Sheet,
    /// As it is when one side has dried.
    dried: Option<Sheet>,
    source: (f64, f64),
    unroll: Unroll,
}

/// What presses such a skin.
pub(crate) fn rig(skin: &SkinDescription, size: f64) -> Rig {
    Rig {
        diameter: 0.020,
        tip: TipKind::FlatPunch,
        force: [5.0, 40.0],
        margin: 0.02,
        slide: [0.0, 0.0],
        rate: skin.rate.min(RATE),
        size,
        loudest: 1.0,
    }
}

/// Where a cause sits.
pub(crate) fn place(skin: &SkinDescription, cause: &Cause) -> Option<Region> {
    let electrodes = skin.taxels.len();
    match cause.id.as_str() {
        "torn-patch" | "soft-spot" => {
            Some(Region::Place { at: cause.point_of(&skin.surface()).coords.into(), within: 2.0 * PATCH })
        }
        "open-wire" | "touching-thread" => {
            let e = wires::one(cause, electrodes);
            let of = |(c, _): &(usize, _)| c / electrodes == e || c % electrodes == e;
            let channels = skin.channels().iter().enumerate().filter(of);
            Some(Region::Channels { names: channels.map(|(_, channel)| channel.name.clone()).collect() })
        }
        _ => None,
    }
}

/// The description that the device was built by, on a mesh of its own.
fn built(skin: &SkinDescription, numerics: &Numerics, causes: &Causes) -> SkinDescription {
    let mut skin = skin.clone();
    for (id, [table, key]) in NUMBERS {
        let size = causes.size(id);
        let Some(value) = skin.medium.get_mut(table).and_then(|t| t.get_mut(key)) else { continue };
        if let (Some(designed), true) = (value.as_float(), size != 0.0) {
            let now = if id == "built-exponent" { designed + size } else { designed * (1.0 + size) };
            *value = toml::Value::Float(now);
        }
    }
    let usual = Numerics::default().elements;
    if numerics.elements != usual
        && let Some(cells) = skin.medium.get_mut("cells").and_then(toml::Value::as_array_mut)
    {
        for count in cells {
            let designed = count.as_integer().unwrap_or_default();
            *count = toml::Value::Integer((designed * numerics.elements as i64 / usual as i64).clamp(4, 200));
        }
    }
    skin
}

impl FabricDevice {
    /// Whether such a reference device is like this skin.
    pub fn is_like(skin: &SkinDescription) -> bool {
        let electrodes = skin.taxels.len();
        let tables = ["sheet", "foam", "drive"].iter().all(|t| skin.medium.contains_key(*t));
        skin.unit == "V" && tables && electrodes > 1 && skin.channels().len() == electrodes * electrodes
    }

    pub fn new(
        skin: &SkinDescription,
        numerics: &Numerics,
        causes: &[Cause],
        designs: &Designs<'_>,
    ) -> Result<Self, BenchmarkError> {
        let causes = Causes::new(CAUSES, causes)?;
        let nominal = designs.of(&built(skin, numerics, &causes))?;
        let mut zero = vec![0.0; nominal.model.channels()];
        nominal.model.untouched(&mut zero)?;
        let full_scale = number(skin, "drive.full_scale")?;
        let drive = Drive {
            source: number(skin, "drive.source_voltage")?,
            series: number(skin, "drive.source_resistance")?,
            full_scale,
            count: full_scale / number(skin, "drive.bits")?.exp2(),
            electrodes: skin.taxels.len(),
        };
        let soft =
            causes.get("soft-spot").map_or_else(Point3::origin, |(cause, _)| cause.point_of(&skin.surface()));
        Ok(Self {
            sheets: sheets(skin, &causes, &drive)?,
            noise: skin.channel_noise(),
            range: skin.channels().iter().map(|c| c.range).collect(),
            nominal,
            zero,
            drive,
            soft,
            causes,
        })
    }
}

/// The sheets that causes need; none where no cause is one of the sheet.
fn sheets(skin: &SkinDescription, causes: &Causes, drive: &Drive) -> Result<Option<Sheets>, BenchmarkError> {
    let dries = causes.get("drying-side");
    if dries.is_none() && OF_SHEET.iter().all(|id| causes.get(id).is_none()) {
        return Ok(None);
    }
    let unroll = Unroll::of(skin);
    let designed: Vec<[f64; 2]> = skin.taxels.iter().map(|t| unroll.at(&t.point())).collect();
    let (SurfaceSpec::Rectangle { size, .. } | SurfaceSpec::Panel { size, .. }) = skin.surface else {
        return Err(BenchmarkError::skin(skin, "surface", "is no rectangle, flat or bent around x"));
    };
    let half = size.map(|s| s / 2.0);
    let mut sewn = designed.clone();
    if let Some((cause, deviation)) = causes.get("displaced-electrodes") {
        for (electrode, off) in sewn.iter_mut().zip(cause.normals(2 * designed.len()).chunks(2)) {
            for ((at, off), half) in electrode.iter_mut().zip(off).zip(half) {
                *at = (*at + deviation * off).clamp(-half, half);
            }
        }
    }
    let (bottom, thickness) = (number(skin, "sheet.bottom")?, number(skin, "foam.thickness")?);
    let foam = Foam {
        leak: 1.0 / (number(skin, "foam.surface_resistance")? * thickness * thickness),
        conductance: number(skin, "foam.conductance")?,
        reference: number(skin, "foam.reference_pressure")?,
        exponent: number(skin, "foam.exponent")?,
        cover: number(skin, "top.thickness").unwrap_or(0.0),
    };
    let torn = causes
        .get("torn-patch")
        .map(|(cause, decades)| (unroll.at(&cause.point_of(&skin.surface())), decades));
    let patch = move |at: [f64; 2]| {
        torn.map_or(1.0, |(middle, decades)| {
            let off = (at[0] - middle[0]).hypot(at[1] - middle[1]) / PATCH;
            10f64.powf(decades * (-off * off).exp())
        })
    };
    let slope = dries.map(|(cause, gradient)| {
        let (sin, cos) = cause.rng().random_range(0.0..std::f64::consts::TAU).sin_cos();
        [gradient * cos / half[0], gradient * sin / half[1]]
    });
    let damp = |at: [f64; 2]| {
        let [x, y] = slope.unwrap_or_default();
        patch(at) * (1.0 + (x * at[0] + y * at[1]) / 2f64.sqrt()).max(0.05)
    };
    let solve = |resistance: [f64; 2], factor: &dyn Fn([f64; 2]) -> f64, electrodes: &[[f64; 2]]| {
        let radius = number(skin, "electrodes.radius")?;
        Sheet::new(&Weave { size, resistance, factor, electrodes, radius, foam })
            .ok_or_else(|| BenchmarkError::skin(skin, "medium", "makes a sheet that cannot be solved"))
    };
    let ratio = [bottom * (1.0 + causes.size("warp-and-weft")), bottom];
    Ok(Some(Sheets {
        design: solve([bottom; 2], &|_| 1.0, &designed)?,
        still: solve(ratio, &patch, &sewn)?,
        dried: dries.map(|_| solve(ratio, &damp, &sewn)).transpose()?,
        source: (drive.source, drive.series),
        unroll,
    }))
}

/// From places of a panel that is bent around x to its sheet.
#[derive(Debug, Clone, Copy)]
struct Unroll {
    /// \[m\]; 0 of a flat one.
    radius: f64,
}

impl Unroll {
    fn of(skin: &SkinDescription) -> Self {
        let radius = match skin.surface {
            SurfaceSpec::Panel { radius, .. } => radius,
            _ => 0.0,
        };
        Self { radius }
    }

    fn at(&self, p: &Point3<f64>) -> [f64; 2] {
        if self.radius > 0.0 { [p.x, self.radius * p.y.atan2(p.z)] } else { [p.x, p.y] }
    }
}

impl Sheets {
    /// Adds what the sheets change under the (first) contact of every instant.
    fn add(&self, script: &Script, readings: &mut [f64]) {
        let channels = self.design.untouched().len();
        let of = |sheet: &Sheet, contact: Option<&Indentation>| {
            let pressed = contact
                .and_then(|c| sheet.between(self.unroll.at(&c.position), 0.5 * c.diameter(), c.force.norm()));
            sheet::voltages(pressed.as_ref().unwrap_or(sheet.untouched()), self.source)
        };
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            let contact = instant.moment.stimulus.contacts.first();
            let still = of(&self.still, contact);
            let mut change = &still - of(&self.design, contact);
            if let Some(dried) = &self.dried {
                let share = 1.0 - (-instant.time / DRIES).exp();
                change += (of(dried, contact) - still) * share;
            }
            row.iter_mut().zip(change.iter()).for_each(|(v, c)| *v += c);
        }
    }
}

impl ReferenceDevice for FabricDevice {
    fn model(&self) -> Arc<dyn ForwardModel> {
        Arc::clone(&self.nominal.model)
    }

    fn readings(&self, script: &Script, noise: Option<Noise>) -> Result<Vec<f64>, BenchmarkError> {
        let channels = self.zero.len();
        let mut readings = self.nominal.pressed(&self.causes, script)?;
        if let Some(sheets) = &self.sheets {
            sheets.add(script, &mut readings);
        }
        self.drive.apply(&self.causes, script, &mut readings);
        // Laws of signals speak of what a touch changes.
        shift(&mut readings, &self.zero, -1.0);
        self.signals(script, &mut readings);
        if let Some(noise) = noise {
            crate::add_noise(&self.noise, noise, &mut readings);
        }
        memory::converter(&self.causes, script, channels, &mut readings);
        shift(&mut readings, &self.zero, 1.0);
        if noise.is_some() {
            self.drive.convert(&mut readings);
        }
        memory::limit(&self.range, &mut readings);
        Ok(readings)
    }
}

/// Adds the zeros of channels so many times.
pub(crate) fn shift(readings: &mut [f64], zero: &[f64], times: f64) {
    for row in readings.chunks_mut(zero.len()) {
        row.iter_mut().zip(zero).for_each(|(v, zero)| *v += times * zero);
    }
}

impl FabricDevice {
    /// Causes that act on what a touch changes.
    fn signals(&self, script: &Script, readings: &mut [f64]) {
        let channels = self.zero.len();
        if let Some((_, rise)) = self.causes.get("soft-spot") {
            laws::soft_spot(script, channels, (&self.soft, PATCH), rise, readings);
        }
        if let Some((_, share)) = self.causes.get("permanent-set") {
            laws::permanent_set(channels, share, readings);
        }
        if let Some((_, loss)) = self.causes.get("wearing-logarithmic") {
            laws::worn(channels, loss, readings);
        }
        memory::gains(&self.causes, script, channels, readings);
        if let Some((_, coefficient)) = self.causes.get("warm-fabric") {
            for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
                let factor = (coefficient * instant.warmth()).exp();
                row.iter_mut().for_each(|v| *v *= factor);
            }
        }
        if let Some((cause, size)) = self.causes.get("rubbed-charge") {
            rubbed(script, channels, cause, size, readings);
        }
        memory::electronics(&self.causes, script, channels, readings);
    }
}

/// Each press leaves another charge.
fn rubbed(script: &Script, channels: usize, cause: &Cause, size: f64, readings: &mut [f64]) {
    let own = cause.normals(channels);
    let mut rng = cause.rng();
    rng.set_stream(4);
    let charges: Vec<f64> =
        (0..=script.presses()).map(|_| size * rng.sample::<f64, _>(StandardNormal)).collect();
    for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
        if instant.moment.stimulus.contacts.is_empty() {
            continue;
        }
        let now = charges[instant.moment.press as usize];
        row.iter_mut().zip(&own).for_each(|(v, own)| *v += now * (0.5 + 0.5 * own));
    }
}

#[cfg(test)]
mod tests;
