//! Stimulus → numbers and pictures.
//!
//! Contacts become forces on the points of the outside, these displacements of the inside ([`Basis`]), these changes of colour
//! ([`Shading`]), and these numbers or a picture ([`Picture`]).
//!
//! Assumptions: displacements are linear in forces, and each contact's are less by what the elastomer's
//! [stretching](crate::elastic::stretching) takes of them; the camera and its lamps do not move; what a touch changes is smooth over the grid of the inside.
//!
//! Derivatives follow displacements through the displaced inside as the camera sees it ([`Shading::slopes`]).
//!
//! Cost: the first touch of a design computes its basis, one to two minutes for the thumb that ships, which is then kept on disk. After that,
//! 0.3 to 0.8 ms a response, and 0.9 to 1.9 ms the derivatives by five unknowns, of a press of 0.05 to 1.5 N.

mod state;
#[cfg(test)]
pub(crate) mod tests;

use std::cell::RefCell;
use std::sync::{Arc, OnceLock};

use dermis_mechanics::MechanicsError;
use dermis_model::{DeviceState, Differences, ForwardModel, Indentation, Stimulus, Tip, TipShape, Unknowns};
use dermis_skin::{Image, ModelError, PixelFormat, SkinDescription, Surface};
use nalgebra::{DMatrix, Point3, Vector3};

use crate::effects::{self, Dynamics};
use crate::elastic::basis::{Basis, Field};
use crate::elastic::contact::{Footprint, gripping};
use crate::elastic::stretching::Stretching;
use crate::optics::displaced::Displaced;
use crate::optics::picture::Picture;
use crate::optics::shading::{Changes, Shading};
use crate::optics::slopes::Linear;
use crate::optics::{Observer, Table};
use crate::parameters::Parameters;

use state::Device;

/// \[K\] that lamps are given for.
const STANDARD_TEMPERATURE: f64 = 293.15;
/// Factor of the lamps' light, whatever the temperature.
const FACTORS: [f64; 2] = [0.1, 10.0];
/// \[N\] up to which a tip's force is looked for.
const STRONGEST: f64 = 100.0;

/// A camera inside of a soft thumb.
#[derive(Debug)]
pub struct ThumbModel {
    skin: String,
    parameters: Parameters,
    surface: Surface,
    shading: Shading,
    picture: Picture,
    dynamics: Dynamics,
    basis: OnceLock<Result<Arc<Basis>, String>>,
    stretching: OnceLock<Stretching>,
}

/// A contact that presses.
struct Pressed {
    footprint: Footprint,
    /// \[N\] that it exerts.
    force: Vector3<f64>,
    /// \[N\] that would move as much if the elastomer did not stretch.
    moving: Vector3<f64>,
}

/// Memory that frames share on a thread.
#[derive(Debug, Default)]
struct Scratch {
    field: Field,
    moved: Field,
    displaced: Displaced,
    linear: Linear,
    changes: Changes,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

impl ThumbModel {
    /// The model of a skin. Makes the table of its picture: about a second for 410 × 308 pixels and an inside
    /// with ridges.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible, effects included.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let mut parameters = Parameters::nominal(skin)?;
        let design = parameters.clone();
        effects::shape(skin, &mut parameters)?;
        let shading = lit(&parameters);
        let table = table(&parameters, &shading);
        // What makes numbers of pictures does not know what became of a device.
        let observer = match parameters == design {
            true => Arc::new(Observer::new(&table, design.blocks)),
            false => observer(&design),
        };
        let picture = Picture::new(table, parameters.noise, observer);
        let numbers = picture.observer().numbers();
        if skin.channels().len() != numbers {
            let reason = format!(
                "are {} and must be {numbers}: the colours of every block of `medium.blocks` and, with ridges, how far these have moved; \
                 leave them out, and they follow",
                skin.channels().len()
            );
            return Err(skin.refusal("channels", reason));
        }
        Ok(Self {
            skin: skin.name.clone(),
            surface: skin.surface(),
            shading,
            picture,
            dynamics: Dynamics::new(skin)?,
            basis: OnceLock::new(),
            stretching: OnceLock::new(),
            parameters,
        })
    }

    /// What it is computed from.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The lit inside.
    #[must_use]
    pub fn shading(&self) -> &Shading {
        &self.shading
    }

    /// What the elastomer does; computed, or found on disk, by the first that asks.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] where the elastomer cannot be meshed.
    pub fn basis(&self) -> Result<&Basis, ModelError> {
        let Parameters { elastomer, rings, grid, reach, .. } = &self.parameters;
        let made = self
            .basis
            .get_or_init(|| Basis::of(elastomer, rings, *grid, *reach).map_err(|error| error.to_string()));
        made.as_deref().map_err(|reason| ModelError::Description {
            skin: self.skin.clone(),
            field: "medium".into(),
            reason: reason.clone(),
        })
    }

    /// By how much less than in proportion it gives way.
    fn stretching(&self) -> Result<&Stretching, ModelError> {
        let basis = self.basis()?;
        let Parameters { elastomer, rings, .. } = &self.parameters;
        Ok(self.stretching.get_or_init(|| {
            let thickness = rings.locations().into_iter().map(|[s, phi]| elastomer.thickness_at(s, phi));
            Stretching::new(basis, &thickness.collect::<Vec<_>>())
        }))
    }

    /// The points that a contact's force is shared among, and that force; nothing where it does not press.
    fn footprint(&self, index: usize, contact: &Indentation) -> Result<Option<Pressed>, ModelError> {
        let normal = contact.check_any_tip(index, &self.surface)?;
        let pressing = -contact.force.dot(&normal);
        if pressing <= 0.0 {
            return Ok(None);
        }
        let footprint = self.under(&contact.position, &contact.tip, pressing)?.map_err(|error| {
            let reason = format!("its {}: {error}", contact.tip.shape.name());
            ModelError::Stimulus { index, reason }
        })?;
        let Parameters { friction, stiffness, stiffening, .. } = self.parameters;
        let force = gripping(contact, &normal, friction);
        let share = self.stretching()?.share(&footprint.shares, &(force / stiffness), stiffening);
        Ok(Some(Pressed { footprint, force, moving: force * share }))
    }

    /// What a tip does that presses with `force` \[N\]; a flat punch is taken to stand straight. The inner error is that of a tip which meets
    /// nothing.
    fn under(
        &self,
        at: &Point3<f64>,
        tip: &Tip,
        force: f64,
    ) -> Result<Result<Footprint, MechanicsError>, ModelError> {
        let Parameters { elastomer, rings, stiffness, .. } = &self.parameters;
        let thumb = &elastomer.thumb;
        Ok(match tip.shape {
            TipShape::Sphere { diameter } => {
                Ok(Footprint::of_sphere(thumb, rings, at, [diameter, force, self.parameters.modulus()]))
            }
            TipShape::FlatPunch { diameter } => Ok(Footprint::of_punch(thumb, rings, at, diameter)),
            _ => Footprint::of_tip((thumb, rings, self.basis()?), at, tip, [force, *stiffness]),
        })
    }

    /// Displacements of the inside.
    fn displace(&self, stimulus: &Stimulus, field: &mut Field) -> Result<(), ModelError> {
        let Parameters { grid, stiffness, flex, .. } = &self.parameters;
        field.clear(grid);
        let mut total = Vector3::zeros();
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let Some(Pressed { footprint, force, moving }) = self.footprint(index, contact)? else {
                continue;
            };
            let basis = self.basis()?;
            for (point, share) in &footprint.shares {
                basis.add(*point, &(moving * (share / stiffness)), field);
            }
            total += force;
        }
        if stimulus.gravity != Vector3::zeros() {
            self.basis()?.add_weight(&(stimulus.gravity / *stiffness), field);
        }
        if *flex > 0.0 && total != Vector3::zeros() {
            self.shading.sway(&(total * *flex), field);
        }
        Ok(())
    }

    /// Displacements of the inside by some contacts times a factor each, which nearly take each other away: forces are added up point by
    /// point before anything moves.
    fn displace_by(
        &self,
        index: usize,
        contacts: [(&Indentation, f64); 2],
        field: &mut Field,
    ) -> Result<(), ModelError> {
        field.clear(&self.parameters.grid);
        let mut forces: Vec<(usize, Vector3<f64>)> = Vec::new();
        for (contact, factor) in contacts {
            let Some(Pressed { footprint, moving, .. }) = self.footprint(index, contact)? else { continue };
            let force = moving * (factor / self.parameters.stiffness);
            forces.extend(footprint.shares.iter().map(|(point, share)| (*point, force * *share)));
        }
        forces.sort_unstable_by_key(|(point, _)| *point);
        for same in forces.chunk_by(|a, b| a.0 == b.0) {
            self.basis()?.add(same[0].0, &same.iter().map(|(_, force)| force).sum(), field);
        }
        Ok(())
    }

    /// Calls with what changes for each unknown of each contact, to first order; `None` where nothing can move. `field` has the displacements of
    /// the stimulus, and `displaced` what the camera sees of them.
    fn each_slope(
        &self,
        (stimulus, unknowns): (&Stimulus, Unknowns),
        differences: &Differences,
        Scratch { field, moved, displaced, linear, changes }: &mut Scratch,
        mut each: impl FnMut(Option<&Changes>),
    ) -> Result<(), ModelError> {
        self.shading.linearise(displaced, linear);
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            for unknown in unknowns.list() {
                let (plus, minus, step) = differences.neighbours(&self.surface, contact, unknowns, *unknown);
                if step == 0.0 {
                    each(None);
                    continue;
                }
                self.displace_by(index, [(&plus, 1.0 / step), (&minus, -1.0 / step)], moved)?;
                self.shading.slopes((field, displaced), linear, moved, changes);
                each(Some(&*changes));
            }
        }
        Ok(())
    }

    /// Fisher's information about the unknowns of contacts in all pixels of one picture, whose noise is Gaussian: the inverse bounds
    /// the covariance of any estimate without bias (H. Cramér, C. R. Rao). A picture's [numbers](ForwardModel::response) have less.
    ///
    /// # Errors
    ///
    /// What the model says of the stimulus.
    pub fn pixel_information(
        &self,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        differences: &Differences,
    ) -> Result<DMatrix<f64>, ModelError> {
        let mut columns: Vec<Vec<f32>> = Vec::new();
        SCRATCH.with_borrow_mut(|scratch| {
            self.see(stimulus, scratch)?;
            self.each_slope((stimulus, unknowns), differences, scratch, |changes| {
                columns.push(changes.map_or_else(Vec::new, |changes| self.picture.whitened(changes)));
            })
        })?;
        let product = |a: &[f32], b: &[f32]| -> f64 {
            // Sums of parts, so that f32 does not lose the small ones.
            let part = |(a, b): (&[f32], &[f32])| f64::from(a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>());
            a.chunks(1024).zip(b.chunks(1024)).map(part).sum()
        };
        Ok(DMatrix::from_fn(columns.len(), columns.len(), |i, j| product(&columns[i], &columns[j])))
    }

    /// Factor of what a picture says, at a temperature \[K\].
    fn brighter(&self, temperature: f64) -> f64 {
        let change = 1.0 + self.parameters.per_kelvin * (temperature - STANDARD_TEMPERATURE);
        change.clamp(FACTORS[0], FACTORS[1]).powf(1.0 / self.parameters.light.gamma)
    }

    /// A picture before the camera compresses it; `noise` as for [`capture`](ForwardModel::capture).
    ///
    /// # Errors
    ///
    /// As [`capture`](ForwardModel::capture).
    pub fn render(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.show(stimulus, |shown, brighter| self.picture.image(shown, brighter, seed(noise)))
    }

    /// What `make` makes of what a stimulus changes inside, and by what factor lamps are brighter.
    fn show<T>(
        &self,
        stimulus: &Stimulus,
        make: impl FnOnce(&[(&Changes, f64)], f64) -> T,
    ) -> Result<T, ModelError> {
        SCRATCH.with_borrow_mut(|scratch| {
            self.see(stimulus, scratch)?;
            Ok(make(&[(&scratch.changes, 1.0)], self.brighter(stimulus.temperature)))
        })
    }

    /// What a stimulus displaces inside, and what that changes.
    fn see(&self, stimulus: &Stimulus, scratch: &mut Scratch) -> Result<(), ModelError> {
        let Scratch { field, displaced, changes, .. } = scratch;
        self.displace(stimulus, field)?;
        self.shading.changes(field, displaced, changes);
        Ok(())
    }
}

fn lit(parameters: &Parameters) -> Shading {
    let Parameters { elastomer, grid, camera, texture, light, ambient, .. } = parameters;
    Shading::lit(elastomer, *grid, camera, light.clone(), (*ambient, texture.ridges.as_ref()))
}

fn table(parameters: &Parameters, shading: &Shading) -> Table {
    let Parameters { elastomer, camera, texture, .. } = parameters;
    Table::new(elastomer, camera, shading, texture)
}

/// What makes numbers of the pictures of a design. Makes the table of its picture, as a model does.
#[must_use]
pub fn observer(design: &Parameters) -> Arc<Observer> {
    Arc::new(Observer::new(&table(design, &lit(design)), design.blocks))
}

/// The seed of a picture's noise, of a source of normal numbers; none where they are all 0.
fn seed(noise: &mut dyn FnMut() -> f64) -> Option<u64> {
    let [a, b] = [noise(), noise()];
    (a != 0.0 || b != 0.0).then(|| a.to_bits() ^ b.to_bits().rotate_left(32))
}

impl ForwardModel for ThumbModel {
    fn channels(&self) -> usize {
        self.picture.observer().numbers()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        assert_eq!(out.len(), self.channels());
        self.show(stimulus, |shown, brighter| self.picture.respond(shown, brighter, out))
    }

    fn jacobian(
        &self,
        stimulus: &Stimulus,
        unknowns: Unknowns,
        differences: &Differences,
        out: &mut [f64],
    ) -> Result<(), ModelError> {
        if self.parameters.flex > 0.0 {
            return differences.jacobian(self, stimulus, unknowns, out);
        }
        let brighter = self.brighter(stimulus.temperature);
        let mut columns = out.chunks_exact_mut(self.channels());
        SCRATCH.with_borrow_mut(|scratch| {
            self.see(stimulus, scratch)?;
            let switches = self.picture.switches(&scratch.changes, brighter);
            self.each_slope((stimulus, unknowns), differences, scratch, |changes| {
                match (columns.next(), changes) {
                    (Some(column), Some(changes)) => {
                        self.picture.change(changes, &switches, brighter, column);
                    }
                    (Some(column), None) => column.fill(0.0),
                    _ => {}
                }
            })
        })
    }

    fn noise(&self) -> &[f64] {
        self.picture.deviations()
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        out.fill(0.0);
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let Some(Pressed { footprint, moving, .. }) = self.footprint(index, contact)? else { continue };
            let basis = self.basis()?;
            for (point, share) in &footprint.shares {
                basis.give(*point, &(moving * (share / self.parameters.stiffness)), |k, by| out[k] += by);
            }
        }
        Ok(true)
    }

    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        self.show(stimulus, |shown, brighter| self.picture.capture(shown, brighter, seed(noise)))
    }

    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        let observer = self.picture.observer();
        let fits = [image.width(), image.height()] == observer.size() && image.format() == PixelFormat::Rgb8;
        if fits && out.len() == observer.numbers() {
            observer.observe(image.data(), out);
        }
        fits
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

    fn force_of_tip(&self, at: &Point3<f64>, tip: &TipShape, depth: f64) -> Option<f64> {
        if depth <= 0.0 {
            return (depth == 0.0).then_some(0.0);
        }
        // A ball's depth is nearly linear in this power of its force (H. Hertz), so that false position (Illinois: M. Dowell and P. Jarratt,
        // 1971) needs few depths.
        let force = |x: f64| x.powf(1.5);
        let over = |x: f64| Some(self.depth_of_tip(at, tip, force(x).min(STRONGEST))? - depth);
        let (mut low, mut high) = ((0.0, -depth), (STRONGEST.powf(2.0 / 3.0), 0.0));
        high.1 = over(high.0)?;
        if high.1 < 0.0 {
            return None;
        }
        let mut side = 0;
        for _ in 0..60 {
            let x = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1).max(f64::MIN_POSITIVE);
            let found = over(x)?;
            if found.abs() <= 1e-10 * depth {
                return Some(force(x));
            }
            if found < 0.0 {
                low = (x, found);
                high.1 *= if side < 0 { 0.5 } else { 1.0 };
                side = -1;
            } else {
                high = (x, found);
                low.1 *= if side > 0 { 0.5 } else { 1.0 };
                side = 1;
            }
        }
        Some(force(f64::midpoint(low.0, high.0)))
    }

    /// Of the points under the tip, in the mean, and of its own shape.
    fn depth_of_tip(&self, at: &Point3<f64>, tip: &TipShape, force: f64) -> Option<f64> {
        tip.check().ok()?;
        if !(0.0..=STRONGEST).contains(&force) {
            return None;
        }
        if force == 0.0 {
            return Some(0.0);
        }
        let (_, normal) = self.surface.project(at);
        let footprint = self.under(at, &Tip::standing(*tip, &normal), force).ok()?.ok()?;
        let give =
            self.basis().ok()?.mean_give(&footprint.shares, &(normal * (-force / self.parameters.stiffness)));
        Some(give + footprint.height)
    }
}
