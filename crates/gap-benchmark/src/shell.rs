//! Reference devices of strain gauges on the inner side of a thin curved wall with openings that is clamped at both ends.
//!
//! Flat rectangular facets that shear across their thickness ([`plate`]) and reciprocity ([`panel`]); a touch presses with a parabola
//! over a round patch. Causes have laws of their own ([`causes`]).

mod causes;
mod panel;
mod plate;
mod relief;

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{ModelError, SkinDescription, Surface, TipKind};
use nalgebra::{Point3, Vector3};
use rand::Rng;

use crate::cause::{Cause, CauseInfo, Causes};
use crate::script::{Rig, Script};
use crate::{BenchmarkError, Designs, Noise, Numerics, ReferenceDevice, Region, laws, memory};
use panel::{Build, Gauge, Shape};
use plate::Material;
use relief::{Relief, THIN, thin_at};

pub(crate) use panel::Influence;

/// What of the reference device does not change with time.
#[derive(Debug)]
struct Panel {
    surface: Surface,
    noise: Vec<f64>,
    range: Vec<Option<[f64; 2]>>,
    influence: Arc<Influence>,
    radius: f64,
    patch: f64,
    /// Power of the stiffening.
    stretching: f64,
    /// Tangential share of every force, along x and the arc.
    askew: [f64; 2],
}

/// A shell as it is solved.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Solved {
    shape: Shape,
    build: Build,
    gauges: Vec<Gauge>,
}

impl Solved {
    /// The influence of forces on its gauges; `None` where it cannot be solved.
    pub fn influence(&self) -> Option<Influence> {
        Influence::new(self.shape, &self.build, &self.gauges)
    }
}

/// Facets along a shell for each element across a layer.
const FACETS: f64 = 5.0;

/// The reference device.
#[derive(Debug)]
pub(crate) struct ShellDevice {
    panel: Arc<Panel>,
    causes: Causes,
}

impl ShellDevice {
    /// Whether such a reference device is like this skin.
    pub fn is_like(skin: &SkinDescription) -> bool {
        Shape::of(&skin.surface).is_some() && skin.unit == "1"
    }

    /// What presses such a skin.
    pub fn rig(skin: &SkinDescription, size: f64) -> Rig {
        Rig {
            diameter: 0.010,
            tip: TipKind::Sphere,
            force: [1.0, 34.0],
            margin: 0.0,
            slide: [0.006, 0.015],
            rate: skin.rate.min(100.0),
            size,
            loudest: f64::INFINITY,
        }
    }

    /// Where a cause sits on the surface.
    pub fn place(skin: &SkinDescription, cause: &Cause) -> Option<Region> {
        if cause.id == "soft-spot" {
            let at = cause.point_of(&skin.surface());
            return Some(Region::Place { at: at.coords.into(), within: 2.0 * THIN });
        }
        let shape = Shape::of(&skin.surface).filter(|_| cause.id == "broken-beam")?;
        let [x, arc] = thin_at(&shape, cause);
        let (sin, cos) = (arc / shape.radius).sin_cos();
        Some(Region::Place { at: [x, shape.radius * sin, shape.radius * cos], within: 2.0 * THIN })
    }

    pub const fn causes() -> &'static [CauseInfo] {
        causes::CAUSES
    }

    pub fn new(
        skin: &SkinDescription,
        numerics: &Numerics,
        causes: &[Cause],
        designs: &Designs<'_>,
    ) -> Result<Self, BenchmarkError> {
        let causes = Causes::new(causes::CAUSES, causes)?;
        let shape = Shape::of(&skin.surface).ok_or_else(|| crate::unlike(skin))?;
        let wall = crate::number(skin, "thickness")? * (1.0 + causes.size("built-wall"));
        let young = crate::number(skin, "young_modulus")? * (1.0 + causes.size("stiffer-wall"));
        let gauges = gauges(skin, &causes, &shape)?;
        let clamp = match causes.size("yielding-clamp") {
            decades if decades > 0.0 => 1e11 * 10f64.powf(-decades),
            _ => 1e12,
        };
        let build = Build {
            material: Material {
                young: [young, young * (1.0 - causes.size("printed-direction"))],
                poisson: crate::number(skin, "poisson_ratio")? * (1.0 - causes.size("built-poisson")),
            },
            wall,
            relief: Relief::of(&causes, &shape),
            clamp,
            spacing: shape.size[0] / (FACETS * numerics.elements as f64),
        };
        let influence = designs
            .solved(&Solved { shape, build, gauges })
            .ok_or_else(|| BenchmarkError::skin(skin, "surface", "makes a shell that cannot be solved"))?;
        let askew = causes.get("askew-tip").map_or([0.0; 2], |(cause, angle)| {
            let (sin, cos) = cause.rng().random_range(0.0..std::f64::consts::TAU).sin_cos();
            [angle.tan() * cos, angle.tan() * sin]
        });
        let panel = Panel {
            surface: skin.surface(),
            noise: skin.channel_noise(),
            range: skin.channels().iter().map(|c| c.range).collect(),
            influence,
            radius: shape.radius,
            patch: crate::number(skin, "patch").unwrap_or(0.005)
                * (1.0 + causes.size("built-patch"))
                * if numerics.flattening { 1.1 } else { 1.25 },
            stretching: causes.size("stretching"),
            askew,
        };
        Ok(Self { panel: Arc::new(panel), causes })
    }
}

/// The gauges as they are glued on in this reference device.
fn gauges(skin: &SkinDescription, causes: &Causes, shape: &Shape) -> Result<Vec<Gauge>, BenchmarkError> {
    let wrong = |field: &str, reason: &str| BenchmarkError::skin(skin, field, reason);
    let size = match skin.medium.get("gauge").and_then(|g| g.as_array()).map(Vec::as_slice) {
        Some([along, across]) => [along, across].map(|v| v.as_float().unwrap_or(0.005)),
        _ => return Err(wrong("medium.gauge", "is missing: two lengths along and across the axis")),
    };
    let size = size.map(|v| v * (1.0 + causes.size("built-gauge")));
    let mut gauges = Vec::new();
    for index in skin.channel_taxels() {
        let taxel = &skin.taxels[index];
        let axis = taxel.axis.ok_or_else(|| wrong("taxels", "have no `axis`, as gauges need"))?;
        let [x, y, z] = taxel.position;
        let angle = y.atan2(z);
        let tangent = Vector3::new(0.0, angle.cos(), -angle.sin());
        let turn = Vector3::from(axis).dot(&tangent).atan2(axis[0]);
        gauges.push(Gauge {
            at: [x, shape.radius * angle],
            angle: turn,
            size,
            across: causes.size("strain-across"),
        });
    }
    let count = gauges.len();
    if let Some((cause, deviation)) = causes.get("displaced-gauges") {
        for (gauge, off) in gauges.iter_mut().zip(cause.normals(2 * count).chunks(2)) {
            gauge.at[0] += deviation * off[0];
            gauge.at[1] += deviation * off[1];
        }
    }
    if let Some((cause, deviation)) = causes.get("turned-gauges") {
        gauges.iter_mut().zip(cause.normals(count)).for_each(|(g, n)| g.angle += deviation * n);
    }
    Ok(gauges)
}

impl Panel {
    fn unroll(&self, at: &Point3<f64>) -> [f64; 2] {
        [at.x, self.radius * at.y.atan2(at.z)]
    }

    /// Adds what one contact leaves in every gauge; `influence` is what a unit force at its place does.
    fn add(&self, contact: &Indentation, influence: &[Vector3<f64>], out: &mut [f64]) {
        let (sin, cos) = contact.position.y.atan2(contact.position.z).sin_cos();
        let normal = Vector3::new(0.0, sin, cos);
        let tangent = Vector3::new(0.0, cos, -sin);
        let pressing = -contact.force.dot(&normal);
        let mut force = contact.force + (Vector3::x() * self.askew[0] + tangent * self.askew[1]) * pressing;
        force *= (1.0 + force.norm() / 10.0).powf(-self.stretching);
        out.iter_mut().zip(influence).for_each(|(value, influence)| *value += influence.dot(&force));
    }
}

impl ForwardModel for Panel {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for contact in &stimulus.contacts {
            let influence = self.influence.of_patch(self.unroll(&contact.position), self.patch);
            self.add(contact, &influence, out);
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

impl ReferenceDevice for ShellDevice {
    fn model(&self) -> Arc<dyn ForwardModel> {
        Arc::clone(&self.panel) as Arc<dyn ForwardModel>
    }

    fn readings(&self, script: &Script, noise: Option<Noise>) -> Result<Vec<f64>, BenchmarkError> {
        let channels = self.panel.noise.len();
        let friction = self.causes.size("dragging-tip");
        let mut readings = vec![0.0; channels * script.instants.len()];
        let bump = memory::bump(&self.causes, script);
        let mut before: Option<(f64, Point3<f64>)> = None;
        // A tip that stays where it is leaves the same influence.
        let mut last: Option<(Point3<f64>, Vec<Vector3<f64>>)> = None;
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            let now = instant.moment.stimulus.contacts.first().map(|c| (instant.time, c.position));
            for contact in &instant.moment.stimulus.contacts {
                let mut contact = contact.clone();
                if let Some((_, by, angle)) = bump.filter(|(from, ..)| instant.time > *from) {
                    let [x, arc] = self.panel.unroll(&contact.position);
                    let (sin, cos) = ((arc + by * angle.sin()) / self.panel.radius).sin_cos();
                    let radius = contact.position.y.hypot(contact.position.z);
                    contact.position = Point3::new(x + by * angle.cos(), radius * sin, radius * cos);
                }
                if let (true, Some((then, from)), Some((time, to))) = (friction > 0.0, before, now) {
                    let pressing = contact.force.norm();
                    contact.force += laws::drag(friction, pressing, to - from, time - then);
                }
                let influence = match &last {
                    Some((at, influence)) if *at == contact.position => influence.clone(),
                    _ => {
                        self.panel.influence.of_patch(self.panel.unroll(&contact.position), self.panel.patch)
                    }
                };
                self.panel.add(&contact, &influence, row);
                last = Some((contact.position, influence));
            }
            before = now;
        }
        if let Some((cause, rise)) = self.causes.get("soft-spot") {
            let at = cause.point_of(&self.panel.surface);
            laws::soft_spot(script, channels, (&at, THIN), rise, &mut readings);
        }
        if let Some((_, width)) = self.causes.get("rubbing-joint") {
            memory::bouc_wen(channels, width, &mut readings);
        }
        if let Some((_, share)) = self.causes.get("flowing-plastic") {
            memory::creep(script, channels, (-share, 0.25), &mut readings);
        }
        laws::remember(&self.causes, script, channels, -1.0, &mut readings);
        memory::gains(&self.causes, script, channels, &mut readings);
        memory::electronics(&self.causes, script, channels, &mut readings);
        memory::zeros(&self.causes, script, channels, &mut readings);
        if let Some(noise) = noise {
            crate::add_noise(&self.panel.noise, noise, &mut readings);
        }
        memory::converter(&self.causes, script, channels, &mut readings);
        memory::limit(&self.panel.range, &mut readings);
        Ok(readings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The skin that ships of which such a reference device is like.
    fn shin() -> SkinDescription {
        let skins = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/skins")).unwrap();
        let skins = skins.filter_map(|entry| SkinDescription::load(entry.unwrap().path()).ok());
        skins.into_iter().find(ShellDevice::is_like).unwrap()
    }

    #[test]
    fn every_cause_moves_the_readings() {
        let skin = shin();
        let numerics = Numerics { elements: 10, ..Numerics::default() };
        let designs = Designs::default();
        let device = |causes: &[Cause]| ShellDevice::new(&skin, &numerics, causes, &designs).unwrap();
        let nominal = device(&[]);
        let rig = ShellDevice::rig(&skin, 0.1);
        let script = Script::draw(&nominal.model(), &rig, crate::Climate::Varied, 3).unwrap();
        let clean = nominal.readings(&script, None).unwrap();
        let largest = clean.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        assert!((1e-4..1e-2).contains(&largest), "strains up to {largest}");
        for info in ShellDevice::causes() {
            let cause = Cause { id: info.id.to_owned(), strength: 1.0, seed: 5 };
            let other = device(&[cause]).readings(&script, None).unwrap();
            let moved = crate::unexplained(&clean, &other, &script, skin.channels().len());
            assert!(moved.is_finite() && moved > 1e-4, "{} moves {moved} of the variance", info.id);
        }
    }
}
