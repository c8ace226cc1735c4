//! Forward model: the voltages of a panel of fabric for what presses it.
//!
//! A tip's force becomes pressure on the points of the grid ([`crate::foam`]), which the foam remembers ([`crate::memory`]) and
//! turns into conductance to the grounded top layer. The sheet below with these conductances is solved by an update of its Green's
//! function ([`crate::sheet`]); resistances between electrodes become voltages in [`crate::electronics`].
//!
//! Derivatives are exact in everything electrical: a change of the conductance of a point changes the resistance between two
//! electrodes by minus the product of their potentials there. Changes of pressures themselves are central differences.
//!
//! Assumptions: a press changes the foam below it only, and not the sheets; tips press along the normal. Cost of a frame: some tens
//! of microseconds for one contact, some hundreds for six.

mod state;

use std::cell::RefCell;

use dermis_model::{DeviceState, Differences, ForwardModel, Indentation, Stimulus, TipShape, Unknowns};
use dermis_skin::{ModelError, SkinDescription, Surface};
use nalgebra::Point3;

use crate::effects::{self, Dynamics};
use crate::foam::Stack;
use crate::parameters::Parameters;
use crate::sheet::{Load, Sheet, Update};

use state::Device;

/// \[K\] that resistances are given for.
const STANDARD_TEMPERATURE: f64 = 293.15;
/// Factor of the sheets' resistance, whatever the temperature.
const FACTORS: [f64; 2] = [0.05, 20.0];
/// \[S\] of a point that only its derivatives ask for: nothing beside any other, and not 0.
const HARDLY: f64 = 1e-30;

/// Pressures \[Pa\] by points of the grid, each once and in rising order.
type Pressures = Vec<(usize, f64)>;
/// Derivatives of conductances \[S\] by one unknown, by the place of their points among the pressures.
type Slopes = Vec<(usize, f64)>;

/// Fabric over foam: voltages for presses of its outside.
#[derive(Debug)]
pub struct FabricModel {
    parameters: Parameters,
    sheet: Sheet,
    noise: Vec<f64>,
    dynamics: Dynamics,
}

/// Memory that frames share on a thread.
#[derive(Debug, Default)]
struct Scratch {
    update: Update,
    loads: Vec<Load>,
    resistances: Vec<f64>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

impl FabricModel {
    /// The model of a skin whose `medium` names `cells`, `electrodes`, `sheet`, `foam`, `top` and `drive`. Takes milliseconds for a
    /// sheet that is the same everywhere, some seconds for any other.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible, effects included.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let mut parameters = Parameters::nominal(skin)?;
        effects::shape(skin, &mut parameters)?;
        let sheet = Sheet::new(&parameters.sheet(), &parameters.electrodes)
            .map_err(|error| skin.refusal("medium", error.to_string()))?;
        Ok(Self { dynamics: Dynamics::new(skin)?, noise: skin.channel_noise(), sheet, parameters })
    }

    /// What it is computed from.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The sheet with its electrodes.
    #[must_use]
    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    fn stack(&self) -> &Stack {
        &self.parameters.stack
    }

    /// Appends what one contact presses.
    fn press(&self, index: usize, contact: &Indentation, out: &mut Pressures) -> Result<(), ModelError> {
        let surface = &self.parameters.surface;
        let normal = contact.check_any_tip(index, surface)?;
        let force = -contact.force.dot(&normal);
        let Some(profile) = self.stack().profile(&contact.tip.shape, force) else {
            let reason = format!(
                "its tip is a {}, and this model knows spheres and flat punches: give a tip of shape \"sphere\" or \"flat-punch\"",
                contact.tip.shape.name()
            );
            return Err(ModelError::Stimulus { index, reason });
        };
        if force > 0.0 {
            let at = self.parameters.panel.unroll(&surface.project(&contact.position).0);
            self.stack().press(&self.parameters.grid, at, &profile, force, out);
        }
        Ok(())
    }

    /// What all contacts press together.
    fn pressures(&self, stimulus: &Stimulus) -> Result<Pressures, ModelError> {
        let mut all = Vec::with_capacity(32 * stimulus.contacts.len());
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            self.press(index, contact, &mut all)?;
        }
        if stimulus.contacts.len() > 1 {
            all.sort_unstable_by_key(|(node, _)| *node);
            all.dedup_by(|later, first| {
                let same = later.0 == first.0;
                if same {
                    first.1 += later.1;
                }
                same
            });
        }
        Ok(all)
    }

    /// \[S\] that a point has more under this pressure of contacts \[Pa\] than at rest.
    fn conductance(&self, node: usize, pressure: f64) -> f64 {
        let (rest, piezo) = (self.parameters.resting(node), &self.parameters.piezo);
        (piezo.at(rest + pressure) - piezo.at(rest)).max(0.0) * self.parameters.grid.area(node)
    }

    fn load(&self, node: usize, pressure: f64) -> Option<Load> {
        let conductance = self.conductance(node, pressure);
        (conductance > 0.0).then_some(Load { node, conductance })
    }

    /// What contacts add to the sheet, of foam that was never pressed before and whose creep is over.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] where a contact cannot be.
    pub fn loads(&self, stimulus: &Stimulus) -> Result<Vec<Load>, ModelError> {
        let pressures = self.pressures(stimulus)?;
        Ok(pressures.into_iter().filter_map(|(node, pressure)| self.load(node, pressure)).collect())
    }

    /// Factor of the sheets' resistance at a temperature \[K\].
    fn scale(&self, temperature: f64) -> f64 {
        let p = &self.parameters;
        (p.damp + p.per_kelvin * (temperature - STANDARD_TEMPERATURE)).clamp(FACTORS[0], FACTORS[1])
    }

    /// Voltages with these pressures of contacts.
    fn voltages(&self, pressures: &[(usize, f64)], scale: f64, scratch: &mut Scratch, out: &mut [f64]) {
        let Scratch { update, loads, resistances } = scratch;
        loads.clear();
        loads.extend(pressures.iter().filter_map(|&(node, pressure)| self.load(node, pressure)));
        resistances.resize(out.len(), 0.0);
        update.solve(&self.sheet, loads, scale, resistances);
        self.parameters.drive.read(resistances, out);
    }

    /// Derivatives of pressures as derivatives of conductances \[S\]: of each column, points by their place among `loads`.
    fn slopes(
        &self,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        differences: &Differences,
    ) -> Result<(Pressures, Vec<Slopes>), ModelError> {
        let mut all = self.pressures(stimulus)?;
        let mut columns = Vec::new();
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let mut own = Vec::new();
            self.press(index, contact, &mut own)?;
            for unknown in unknowns.list() {
                let (plus, minus, step) =
                    differences.neighbours(&self.parameters.surface, contact, unknowns, *unknown);
                let mut moved = [Vec::new(), Vec::new()];
                if step != 0.0 {
                    self.press(index, &plus, &mut moved[0])?;
                    self.press(index, &minus, &mut moved[1])?;
                }
                columns.push((own.clone(), moved, step));
            }
        }
        // Points that contacts reach only where they are moved.
        for (_, moved, _) in &columns {
            for (node, _) in moved.iter().flatten() {
                if let Err(place) = all.binary_search_by_key(node, |(n, _)| *n) {
                    all.insert(place, (*node, 0.0));
                }
            }
        }
        let slope = |(own, [plus, minus], step): (Pressures, [Pressures; 2], f64)| {
            let mut nodes: Vec<usize> = plus.iter().chain(&minus).map(|(node, _)| *node).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let of = |list: &Pressures, node: usize| {
                list.binary_search_by_key(&node, |(n, _)| *n).map_or(0.0, |i| list[i].1)
            };
            let change = |node: usize| {
                let place = all.binary_search_by_key(&node, |(n, _)| *n).ok()?;
                let others = (all[place].1 - of(&own, node)).max(0.0);
                let [more, less] =
                    [&plus, &minus].map(|list| self.conductance(node, others + of(list, node)));
                Some((place, (more - less) / step))
            };
            nodes.into_iter().filter_map(change).collect()
        };
        let columns = columns.into_iter().map(slope).collect();
        Ok((all, columns))
    }
}

impl ForwardModel for FabricModel {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.parameters.surface
    }

    /// Voltages of foam that was never pressed before and whose creep is over.
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        assert_eq!(out.len(), self.channels());
        let pressures = self.pressures(stimulus)?;
        let scale = self.scale(stimulus.temperature);
        SCRATCH.with_borrow_mut(|scratch| self.voltages(&pressures, scale, scratch, out));
        Ok(())
    }

    fn jacobian(
        &self,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        differences: &Differences,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        let (pressures, columns) = self.slopes(stimulus, unknowns, differences)?;
        let (channels, n) = (self.channels(), self.sheet.electrodes());
        SCRATCH.with_borrow_mut(|Scratch { update, loads, resistances }| {
            loads.clear();
            loads.extend(pressures.iter().map(|&(node, pressure)| Load {
                node,
                conductance: self.conductance(node, pressure).max(HARDLY),
            }));
            resistances.resize(channels, 0.0);
            update.solve(&self.sheet, loads, self.scale(stimulus.temperature), resistances);
            let mut potentials = Vec::new();
            update.potentials(&mut potentials);
            let mut change = vec![0.0; channels];
            for (slopes, column) in columns.iter().zip(out.chunks_exact_mut(channels)) {
                change.fill(0.0);
                for (place, slope) in slopes {
                    let of = &potentials[place * n..(place + 1) * n];
                    for (row, a) in change.chunks_exact_mut(n).zip(of) {
                        let by = -slope * a;
                        row.iter_mut().zip(of).for_each(|(c, b)| *c += by * b);
                    }
                }
                self.parameters.drive.change(resistances, &mut change, column);
            }
        });
        Ok(())
    }

    /// Contacts draw from one current.
    fn superposes(&self) -> bool {
        false
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// Of foam and top layer under the pressure at each point.
    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        let Parameters { surface, panel, .. } = &self.parameters;
        out.fill(0.0);
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let normal = contact.check_any_tip(index, surface)?;
            let force = -contact.force.dot(&normal);
            let Some(profile) = self.stack().profile(&contact.tip.shape, force) else { return Ok(false) };
            let at = panel.unroll(&contact.position);
            let peak = force / profile.area();
            for (pressure, point) in out.iter_mut().zip(&surface.points) {
                let p = panel.unroll(point);
                *pressure += peak * profile.at((p[0] - at[0]).powi(2) + (p[1] - at[1]).powi(2));
            }
        }
        out.iter_mut().for_each(|p| *p = self.stack().stroke(*p));
        Ok(true)
    }

    fn remembers(&self) -> bool {
        self.parameters.memory.remembers()
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Device::new(self, self.dynamics.start(seed)))
    }

    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        self.force_of_tip(at, &TipShape::Sphere { diameter }, depth)
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        self.depth_of_tip(at, &TipShape::Sphere { diameter }, force)
    }

    fn force_of_tip(&self, _: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        is_known(tip).then(|| self.stack().force(tip, depth)).flatten()
    }

    fn depth_of_tip(&self, _: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        is_known(tip).then(|| self.stack().depth(tip, force)).flatten()
    }
}

/// Whether a tip is a ball or a flat punch of a size that can be.
fn is_known(tip: &TipShape) -> bool {
    match tip {
        TipShape::Sphere { diameter } | TipShape::FlatPunch { diameter } => {
            Indentation::DIAMETERS.contains(diameter)
        }
        _ => false,
    }
}

#[cfg(test)]
pub(crate) mod tests;
