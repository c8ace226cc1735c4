//! Everything that the forward model is computed from: what the skin description says, which static effects then change.

use dermis_skin::{Channel, FieldFault, ModelError, SkinDescription, Surface, Taxel};
use serde::Deserialize;

use crate::electronics::Drive;
use crate::foam::{Layer, Piezo, Stack};
use crate::memory::Memory;
use crate::panel::Panel;
use crate::sheet::{Design, Electrode, Grid};

/// Electrodes of a panel: a frame has the square of them.
const ELECTRODES: usize = 64;
/// Cells along an axis.
const CELLS: [usize; 2] = [4, 200];
/// Share of the lower sheet's depth that an electrode may be written off it: layers are not as thick as they were designed, and their
/// electrodes stay on the lower sheet.
const OFF_SHEET: f64 = 0.5;

/// `medium` of a skin description.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct MediumSpec {
    /// Of the grid, along both axes.
    cells: [usize; 2],
    electrodes: ElectrodesSpec,
    sheet: SheetSpec,
    foam: FoamSpec,
    top: LayerSpec,
    drive: DriveSpec,
}

/// `medium.electrodes`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct ElectrodesSpec {
    /// \[m\] of each disc.
    radius: f64,
    /// Where taxels are not listed.
    #[serde(default)]
    rows: Vec<RowSpec>,
}

/// A row of electrodes along x.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct RowSpec {
    /// \[m\] along y, or along the arc.
    y: f64,
    /// \[m\].
    x: Vec<f64>,
}

/// `medium.sheet`: \[Ω per square\].
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct SheetSpec {
    bottom: f64,
    /// The return of the current: where both sheets carry it, their resistances add up.
    top: f64,
}

/// `medium.foam`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct FoamSpec {
    thickness: f64,
    young_modulus: f64,
    poisson_ratio: f64,
    densification: f64,
    /// \[Ω per square\] undeformed.
    surface_resistance: f64,
    /// \[S/m²\] at the reference pressure.
    conductance: f64,
    /// \[Pa\].
    reference_pressure: f64,
    exponent: f64,
    #[serde(default)]
    hysteresis: f64,
    #[serde(default)]
    creep: f64,
}

/// `medium.top`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct LayerSpec {
    thickness: f64,
    young_modulus: f64,
    poisson_ratio: f64,
    densification: f64,
}

/// `medium.drive`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct DriveSpec {
    /// \[V\].
    source_voltage: f64,
    /// \[Ω\].
    source_resistance: f64,
    /// \[V\] of the converter's largest count.
    full_scale: f64,
    /// Of the converter.
    bits: u32,
}

/// The converter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Converter {
    /// \[V\].
    pub full_scale: f64,
    /// \[V\] of a count.
    pub step: f64,
}

/// Numbers that readings are computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    /// Where things are.
    pub panel: Panel,
    /// The outside.
    pub surface: Surface,
    /// The grid of the sheet.
    pub grid: Grid,
    /// \[Ω per square\] of the sheets along x and y.
    pub resistance: [f64; 2],
    /// Factor of that at every point of the grid, where it is not the same everywhere.
    pub field: Option<Vec<f64>>,
    /// \[S/m²\] of the foam that nothing presses.
    pub leak: f64,
    /// \[Pa\] everywhere, of fabric that is stretched over a curve.
    pub tension: f64,
    /// \[Pa\] besides, at every point of the grid.
    pub wrinkles: Option<Vec<f64>>,
    /// Factor of the sheets' resistance at the standard temperature.
    pub damp: f64,
    /// \[1/K\] by which that grows.
    pub per_kelvin: f64,
    /// Foam and top layer.
    pub stack: Stack,
    /// How the foam conducts.
    pub piezo: Piezo,
    /// What it remembers.
    pub memory: Memory,
    /// On the sheet.
    pub electrodes: Vec<Electrode>,
    /// From resistances to voltages.
    pub drive: Drive,
    /// From voltages to counts.
    pub converter: Converter,
}

/// A field, its value, and the least and the largest that it may have.
type Limits = (&'static str, f64, [f64; 2]);

impl MediumSpec {
    /// All numbers, with what they may be.
    fn limits(&self) -> Vec<Limits> {
        let (foam, top, drive) = (&self.foam, &self.top, &self.drive);
        vec![
            ("electrodes.radius", self.electrodes.radius, [1e-5, 0.1]),
            ("sheet.bottom", self.sheet.bottom, [1e-3, 1e9]),
            ("sheet.top", self.sheet.top, [0.0, 0.1 * self.sheet.bottom]),
            ("foam.thickness", foam.thickness, [1e-4, 0.1]),
            ("foam.young_modulus", foam.young_modulus, [1e2, 1e9]),
            ("foam.poisson_ratio", foam.poisson_ratio, [0.0, 0.49]),
            ("foam.densification", foam.densification, [0.05, 1.0]),
            ("foam.surface_resistance", foam.surface_resistance, [1e3, 1e14]),
            ("foam.conductance", foam.conductance, [1e-9, 1e6]),
            ("foam.reference_pressure", foam.reference_pressure, [1.0, 1e9]),
            ("foam.exponent", foam.exponent, [1.0, 6.0]),
            ("foam.hysteresis", foam.hysteresis, [0.0, 1.0]),
            ("foam.creep", foam.creep, [0.0, Memory::MOST_CREEP]),
            ("top.thickness", top.thickness, [1e-4, 0.1]),
            ("top.young_modulus", top.young_modulus, [1e2, 1e9]),
            ("top.poisson_ratio", top.poisson_ratio, [0.0, 0.49]),
            ("top.densification", top.densification, [0.05, 1.0]),
            ("drive.source_voltage", drive.source_voltage, [1e-3, 1e3]),
            ("drive.source_resistance", drive.source_resistance, [0.0, 1e9]),
            ("drive.full_scale", drive.full_scale, [1e-3, 1e3]),
            ("drive.bits", f64::from(drive.bits), [1.0, 30.0]),
        ]
    }

    fn read(skin: &SkinDescription) -> Result<Self, ModelError> {
        let spec: Self = skin.medium_as()?;
        for (axis, cells) in spec.cells.iter().enumerate() {
            if !(CELLS[0]..=CELLS[1]).contains(cells) {
                let reason = format!("is {cells} and must be {} to {}", CELLS[0], CELLS[1]);
                return Err(skin.refusal(&format!("medium.cells[{axis}]"), reason));
            }
        }
        for (field, value, [low, high]) in spec.limits() {
            if !(low..=high).contains(&value) {
                let reason = format!("is {value} and must be {low} to {high}");
                return Err(skin.refusal(&format!("medium.{field}"), reason));
            }
        }
        Ok(spec)
    }
}

impl LayerSpec {
    fn layer(&self) -> Layer {
        Layer {
            thickness: self.thickness,
            young_modulus: self.young_modulus,
            poisson_ratio: self.poisson_ratio,
            densification: self.densification,
        }
    }
}

impl Parameters {
    /// The nominal numbers of a skin.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible.
    pub fn nominal(skin: &SkinDescription) -> Result<Self, ModelError> {
        if skin.unit != "V" {
            let reason = format!("is \"{}\" where electrodes read \"V\"", skin.unit);
            return Err(skin.refusal("unit", reason));
        }
        let spec = MediumSpec::read(skin)?;
        let panel = Panel::of(skin).map_err(|reason| skin.refusal("surface", reason))?;
        let count = skin.taxels.len();
        if !(2..=ELECTRODES).contains(&count) {
            let reason = format!("are {count} electrodes and must be 2 to {ELECTRODES}");
            return Err(skin.refusal("taxels", reason));
        }
        let wired = skin.channels().len() == count * count
            && skin.channels().iter().enumerate().all(|(i, c)| c.taxel == skin.taxels[i % count].name);
        if !wired {
            let reason = format!(
                "must be {} for {count} electrodes, injection by injection, each with the electrode that is read as its taxel; \
                 leave them out, and they follow from the electrodes",
                count * count
            );
            return Err(skin.refusal("channels", reason));
        }
        let grid = Grid { size: panel.size, cells: spec.cells };
        let electrodes = electrodes(skin, &spec, &panel)?;
        let SheetSpec { bottom, top } = spec.sheet;
        let foam = LayerSpec {
            thickness: spec.foam.thickness,
            young_modulus: spec.foam.young_modulus,
            poisson_ratio: spec.foam.poisson_ratio,
            densification: spec.foam.densification,
        };
        let drive = spec.drive;
        Ok(Self {
            surface: skin.surface(),
            panel,
            grid,
            resistance: [bottom + top; 2],
            field: None,
            // A resistance per square of a layer is its resistivity over its thickness.
            leak: 1.0 / (spec.foam.surface_resistance * spec.foam.thickness.powi(2)),
            tension: 0.0,
            wrinkles: None,
            damp: 1.0,
            per_kelvin: 0.0,
            stack: Stack::new(foam.layer(), spec.top.layer()),
            piezo: Piezo {
                conductance: spec.foam.conductance,
                reference: spec.foam.reference_pressure,
                exponent: spec.foam.exponent,
                threshold: 0.0,
            },
            memory: Memory {
                hysteresis: spec.foam.hysteresis,
                creep: spec.foam.creep,
                reference: spec.foam.reference_pressure,
            },
            drive: Drive::new(drive.source_voltage, drive.source_resistance, electrodes.len()),
            converter: Converter {
                full_scale: drive.full_scale,
                step: drive.full_scale / f64::from(1u32 << drive.bits),
            },
            electrodes,
        })
    }

    /// What the sheet is solved from.
    #[must_use]
    pub fn sheet(&self) -> Design {
        let pressed = self.wrinkles.as_ref().map(|wrinkles| {
            let at = |(node, p): (usize, &f64)| {
                (self.piezo.at(self.tension + p) - self.piezo.at(self.tension)) * self.grid.area(node)
            };
            wrinkles.iter().enumerate().map(at).collect()
        });
        let field = match (&self.field, pressed) {
            (None, None) => None,
            (field, pressed) => {
                let count = self.grid.count();
                let field = field.clone().unwrap_or_else(|| vec![1.0; count]);
                Some((field, pressed.unwrap_or_else(|| vec![0.0; count])))
            }
        };
        Design {
            grid: self.grid,
            resistance: self.resistance,
            leak: self.leak + self.piezo.at(self.tension),
            field,
        }
    }

    /// \[Pa\] on a point of the grid that nothing touches.
    #[must_use]
    pub fn resting(&self, node: usize) -> f64 {
        self.tension + self.wrinkles.as_ref().map_or(0.0, |wrinkles| wrinkles[node])
    }
}

/// Electrodes as the sheet knows them.
fn electrodes(
    skin: &SkinDescription,
    spec: &MediumSpec,
    panel: &Panel,
) -> Result<Vec<Electrode>, ModelError> {
    let depth = spec.foam.thickness + spec.top.thickness;
    let at = |(i, taxel): (usize, &Taxel)| {
        let at = panel.unroll(&taxel.point());
        let (outside, normal) = panel.roll(at);
        let off = (taxel.point() - (outside - normal * depth)).norm();
        if off > OFF_SHEET * depth || !panel.holds(at) {
            let reason = format!(
                "lies {off:.4} m off the lower sheet, which is {depth:.4} m below the outside and {:.3} x {:.3} m",
                panel.size[0], panel.size[1]
            );
            return Err(skin.refusal(&format!("taxels[{i}].position"), reason));
        }
        Ok(Electrode { at, radius: spec.electrodes.radius })
    };
    skin.taxels.iter().enumerate().map(at).collect()
}

/// Fills in electrodes and channels that a skin file leaves out: 28 electrodes make 784 channels, injection by injection.
///
/// # Errors
///
/// [`FieldFault`] names what cannot be.
pub fn complete(skin: &mut SkinDescription) -> Result<(), FieldFault> {
    if skin.taxels.is_empty() && !skin.medium.is_empty() {
        let spec = MediumSpec::read(skin).map_err(fault)?;
        let panel = Panel::of(skin).map_err(|reason| FieldFault::new("surface", reason))?;
        let depth = spec.foam.thickness + spec.top.thickness;
        let locations = spec.electrodes.rows.iter().flat_map(|row| row.x.iter().map(|x| [*x, row.y]));
        let mut taxels = Vec::new();
        for (i, at) in locations.enumerate() {
            if !panel.holds(at) || i >= ELECTRODES {
                let reason = format!(
                    "has an electrode at ({}, {}) m: a panel has {ELECTRODES} at most, all of them on its {} x {} m",
                    at[0], at[1], panel.size[0], panel.size[1]
                );
                return Err(FieldFault::new("medium.electrodes.rows", reason));
            }
            let (outside, normal) = panel.roll(at);
            taxels.push(Taxel {
                name: format!("e{i:02}"),
                position: (outside - normal * depth).into(),
                normal: normal.into(),
                axis: None,
            });
        }
        skin.taxels = taxels;
    }
    if skin.channels().is_empty() && skin.taxels.len() <= ELECTRODES {
        let names: Vec<String> = skin.taxels.iter().map(|taxel| taxel.name.clone()).collect();
        let pairs = names.iter().flat_map(|fed| names.iter().map(move |read| (fed, read)));
        let channels = pairs.map(|(fed, read)| Channel {
            name: format!("{fed}-{read}"),
            taxel: read.clone(),
            range: None,
            noise: None,
        });
        skin.set_channels(channels.collect());
    }
    Ok(())
}

fn fault(error: ModelError) -> FieldFault {
    match error {
        ModelError::Description { field, reason, .. } => FieldFault { field, reason },
        other => FieldFault::new("medium", other.to_string()),
    }
}
