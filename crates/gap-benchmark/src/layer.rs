//! Reference devices of elements that read the mean pressure in a soft elastic layer over a rigid base.
//!
//! The field: waves by finite elements across the depth ([`depth`]), summed as a doubly periodic Fourier series ([`field`]).
//! The tip: Sneddon's sphere with a thickness correction ([`tip`]); under it the pressure flattens with the contact's size, and the
//! surface that sinks in comes nearer to the elements. Causes have laws of their own ([`causes`]).

mod causes;
mod depth;
mod field;
mod tip;

use std::sync::Arc;

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::{ModelError, SkinDescription, Surface, SurfaceSpec, TipKind};
use nalgebra::{Point3, Rotation2, Vector2, Vector3};
use rand::Rng;

use crate::cause::{Cause, CauseInfo, Causes};
use crate::script::{Rig, Script};
use crate::{BenchmarkError, Noise, Numerics, ReferenceDevice, Region, laws, memory};
use depth::Layer;
use field::{Field, Grain, Profile};
use tip::Tip;

/// \[m\] of depth below an element within which its table holds.
const AROUND: f64 = 0.0025;
/// \[m\] along the surface beyond which a press changes no reading.
const REACH: f64 = 0.045;

/// \[m\] deviation of a cavity's reach.
const CAVITY: f64 = 0.004;

/// Where a cavity is: near one of the elements.
fn cavity_at(elements: &[Point3<f64>], cause: &Cause) -> Vector2<f64> {
    let mut rng = cause.rng();
    let over = elements[rng.random_range(0..elements.len())];
    over.xy().coords + Vector2::from_fn(|_, _| rng.random_range(-0.003..0.003))
}

/// A layer with its elements.
#[derive(Debug)]
struct Skin {
    surface: Surface,
    noise: Vec<f64>,
    range: Vec<Option<[f64; 2]>>,
    /// \[m\] as they lie in this reference device.
    elements: Vec<Point3<f64>>,
    tip: Tip,
    nearer: f64,
    /// By the thickness that each is of \[m\].
    fields: Vec<(f64, Field)>,
    /// \[1\] that the layer thickens along each axis.
    wedge: Vector2<f64>,
    rig: RigError,
    /// Place \[m\] and loss of a cavity.
    cavity: Option<(Vector2<f64>, f64)>,
}

/// Where the rig really presses, compared to where it says.
#[derive(Debug)]
struct RigError {
    shift: Vector2<f64>,
    turn: Rotation2<f64>,
    /// \[m\] from the middle of the tip to the points where it presses.
    fork: Vector2<f64>,
}

/// The reference device.
#[derive(Debug)]
pub(crate) struct LayerDevice {
    skin: Arc<Skin>,
    causes: Causes,
}

impl LayerDevice {
    /// Whether such a reference device is like this skin.
    pub fn is_like(skin: &SkinDescription) -> bool {
        matches!(skin.surface, SurfaceSpec::Rectangle { .. }) && skin.unit == "Pa"
    }

    /// What presses such a skin.
    pub fn rig(skin: &SkinDescription, size: f64) -> Rig {
        let wide = matches!(skin.surface, SurfaceSpec::Rectangle { size, .. } if size[1] > 0.004);
        Rig {
            diameter: 0.004,
            tip: TipKind::Sphere,
            force: [0.02, 1.5],
            margin: if wide { 0.002 } else { 0.0 },
            slide: [0.004, 0.012],
            rate: skin.rate.min(100.0),
            size,
            loudest: f64::INFINITY,
        }
    }

    /// Where a cause sits on the surface.
    pub fn place(skin: &SkinDescription, cause: &Cause) -> Option<Region> {
        if !["cavity", "soft-spot"].contains(&cause.id.as_str()) {
            return None;
        }
        let elements: Vec<Point3<f64>> =
            skin.channel_taxels().into_iter().map(|t| skin.taxels[t].point()).collect();
        let at = cavity_at(&elements, cause);
        Some(Region::Place { at: [at.x, at.y, 0.0], within: 2.0 * CAVITY })
    }

    pub const fn causes() -> &'static [CauseInfo] {
        causes::CAUSES
    }

    pub fn new(
        skin: &SkinDescription,
        numerics: &Numerics,
        causes: &[Cause],
    ) -> Result<Self, BenchmarkError> {
        let wrong = |field: &str, reason: &str| BenchmarkError::skin(skin, field, reason);
        let causes = Causes::new(causes::CAUSES, causes)?;
        let SurfaceSpec::Rectangle { size, .. } = skin.surface else {
            return Err(wrong("surface", "is not flat"));
        };
        if skin.medium.get("edge").and_then(|e| e.as_str()) == Some("free") {
            return Err(wrong("medium.edge", "is \"free\", and layers here go on beyond it: take \"wide\""));
        }
        let drawn = crate::number(skin, "thickness")?;
        let (elements, mean) = elements(skin, &causes, drawn)?;
        let layer = layer(skin, numerics, &causes, drawn)?;
        let tip = Tip {
            radius: causes.size("other-tip"),
            young: crate::number(skin, "young_modulus")? * (1.0 + causes.size("other-modulus")),
            poisson: layer.poisson,
            thickness: layer.thickness,
            sphere: numerics.sphere,
        };
        let (fields, wedge) = fields(&layer, numerics, &causes, mean);
        let cavity = causes.get("cavity").map(|(cause, loss)| (cavity_at(&elements, cause), loss));
        let skin = Skin {
            surface: skin.surface(),
            noise: skin.channel_noise(),
            range: skin.channels().iter().map(|c| c.range).collect(),
            elements,
            tip,
            nearer: numerics.nearer,
            fields,
            wedge,
            rig: RigError::of(&causes, size[1] > 0.004),
            cavity,
        };
        Ok(Self { skin: Arc::new(skin), causes })
    }
}

/// Where the elements lie in this reference device, and how deep they lie on average by design \[m\]; `drawn` \[m\] is the thickness of
/// the layer by design.
fn elements(
    skin: &SkinDescription,
    causes: &Causes,
    drawn: f64,
) -> Result<(Vec<Point3<f64>>, f64), BenchmarkError> {
    let mut elements: Vec<Point3<f64>> =
        skin.channel_taxels().into_iter().map(|t| skin.taxels[t].point()).collect();
    let mean = -elements.iter().map(|e| e.z).sum::<f64>() / elements.len() as f64;
    if !(mean > 2.0 * AROUND * 0.6 && mean < drawn) {
        return Err(BenchmarkError::skin(skin, "taxels", "do not lie between the surface and the base"));
    }
    if let Some((cause, deviation)) = causes.get("displaced-elements") {
        let off = cause.normals(3 * elements.len());
        for (element, off) in elements.iter_mut().zip(off.chunks(3)) {
            *element += Vector3::new(off[0], off[1], 0.5 * off[2]) * deviation;
            element.z = element.z.clamp(-mean - AROUND, -mean + AROUND);
        }
    }
    for element in &mut elements {
        element.z = (element.z + causes.size("built-depth")).clamp(-mean - AROUND, -mean + AROUND);
    }
    let middle = elements.iter().map(|e| e.xy().coords).sum::<Vector2<f64>>() / elements.len() as f64;
    for element in &mut elements {
        let away = (element.xy().coords - middle) * causes.size("built-pitch");
        *element += Vector3::new(away.x, away.y, 0.0);
    }
    Ok((elements, mean))
}

/// The layer of this reference device; `drawn` \[m\] is its thickness by design.
fn layer(
    skin: &SkinDescription,
    numerics: &Numerics,
    causes: &Causes,
    drawn: f64,
) -> Result<Layer, BenchmarkError> {
    let poisson = crate::number(skin, "poisson_ratio")? * (1.0 - causes.size("built-poisson"));
    let slip = match skin.medium.get("base") {
        Some(toml::Value::String(base)) if base == "slip" => 1.0,
        Some(toml::Value::Float(share)) => *share,
        _ => 0.0,
    };
    Ok(Layer {
        thickness: drawn * (1.0 + causes.size("built-thickness")) + causes.size("other-thickness"),
        poisson: poisson.min(0.4995),
        grade: causes.size("uneven-cure"),
        slip: slip + (1.0 - slip) * causes.size("loose-base"),
        elements: numerics.elements,
    })
}

/// Fields of the layer by the thickness \[m\] that each is of, and how much \[1\] it thickens along each axis; `mean` \[m\] is how deep
/// elements lie.
fn fields(
    layer: &Layer,
    numerics: &Numerics,
    causes: &Causes,
    mean: f64,
) -> (Vec<(f64, Field)>, Vector2<f64>) {
    let grain = Grain { period: numerics.period, shortest: 2500.0, elements: numerics.elements };
    let range = ([mean - AROUND - 0.0005, mean + AROUND], 0.004, REACH);
    let profile = if numerics.flattening { Profile::Flattening(0.002) } else { Profile::Ellipsoid };
    let lid = causes.size("wide-port");
    let field = |thickness: f64| {
        let layer = Layer { thickness, ..layer.clone() };
        (thickness, Field::new(&layer, grain, profile, range, lid))
    };
    let mut wedge = Vector2::zeros();
    let mut fields = vec![field(layer.thickness)];
    if let Some((cause, change)) = causes.get("other-thickness") {
        // A tenth of the change for every 10 mm.
        let turn = cause.rng().random_range(0.0..std::f64::consts::TAU);
        wedge = Vector2::new(turn.cos(), turn.sin()) * change * 10.0;
        let away = 0.3 * change.abs();
        fields.insert(0, field(layer.thickness - away));
        fields.push(field(layer.thickness + away));
    }
    (fields, wedge)
}

impl RigError {
    /// On a surface that is not `wide` a rig is off along it.
    fn of(causes: &Causes, wide: bool) -> Self {
        let direction = |cause: &Cause| {
            let most = if wide { std::f64::consts::PI } else { 0.5 };
            let turn = cause.rng().random_range(-most..most);
            Vector2::new(turn.cos(), turn.sin())
        };
        let (mut shift, mut turn) = (Vector2::zeros(), Rotation2::identity());
        if let Some((cause, away)) = causes.get("shifted-rig") {
            shift = direction(cause) * away * cause.sign();
            turn = Rotation2::new(0.02 * cause.strength * cause.normals(1)[0]);
        }
        let fork =
            causes.get("forked-tip").map_or_else(Vector2::zeros, |(c, away)| direction(c) * away / 2.0);
        Self { shift, turn, fork }
    }
}

impl Skin {
    /// The tip of an indenter of this diameter \[m\], as it is in this reference device.
    fn tip(&self, diameter: f64) -> Tip {
        Tip { radius: (diameter / 2.0 + self.tip.radius).max(1e-4), ..self.tip }
    }

    /// Adds what one contact leaves in every element \[Pa\].
    fn add(&self, contact: &Indentation, out: &mut [f64]) {
        let pressing = -contact.force.z;
        let along = contact.force.xy();
        let said = contact.position.xy().coords;
        let RigError { shift, turn, fork } = self.rig;
        let middle = turn * said + shift;
        let (forks, share): (&[f64], f64) =
            if fork == Vector2::zeros() { (&[0.0], 1.0) } else { (&[-1.0, 1.0], 0.5) };
        let (a, depth) = self.tip(contact.diameter()).under(pressing * share);
        for side in forks {
            let at = middle + fork * *side;
            for (value, element) in out.iter_mut().zip(&self.elements) {
                let to = element.xy().coords - at;
                let distance = to.norm();
                let below = -element.z - self.nearer * depth;
                let (mut normal, mut tangential) = (0.0, 0.0);
                for (weight, field) in self.local(&((element.xy().coords + at) / 2.0)) {
                    let (n, t) = field.at(below, a, distance);
                    normal += weight * n;
                    tangential += weight * t;
                }
                let along = if distance > 1e-9 { along.dot(&to) / distance } else { 0.0 };
                let mut pressure = share * (pressing * normal + along * tangential);
                if let Some((place, loss)) = &self.cavity {
                    let away = (element.xy().coords - place).norm() / CAVITY;
                    let near = (-0.5 * away * away).exp();
                    pressure *= 1.0 - loss * near * (-pressing / 0.8).exp();
                }
                *value += pressure;
            }
        }
    }

    /// The fields that hold where the layer is as thick as here, and their shares.
    fn local(&self, at: &Vector2<f64>) -> impl Iterator<Item = (f64, &Field)> {
        let middle = self.fields.len() / 2;
        let (thickness, field) = &self.fields[middle];
        let here = self.wedge.dot(at);
        let other = if here < 0.0 { self.fields.first() } else { self.fields.last() };
        let share = match other {
            Some((t, _)) if (t - thickness).abs() > 0.0 => (here / (t - thickness)).clamp(0.0, 1.0),
            _ => 0.0,
        };
        let other = other.map(|(_, f)| (share, f)).filter(|(share, _)| *share > 0.0);
        std::iter::once((1.0 - share, field)).chain(other)
    }
}

impl ForwardModel for Skin {
    fn channels(&self) -> usize {
        self.elements.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        for contact in &stimulus.contacts {
            self.add(contact, out);
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    fn depth_at(&self, _: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        Some(self.tip(diameter).under(force).1)
    }
}

impl ReferenceDevice for LayerDevice {
    fn model(&self) -> Arc<dyn ForwardModel> {
        Arc::clone(&self.skin) as Arc<dyn ForwardModel>
    }

    fn readings(&self, script: &Script, noise: Option<Noise>) -> Result<Vec<f64>, BenchmarkError> {
        let channels = self.skin.elements.len();
        let mut readings = self.pressed(script)?;
        self.locally(script, &mut readings);
        self.remember(script, &mut readings);
        laws::remember(&self.causes, script, channels, 1.0, &mut readings);
        memory::gains(&self.causes, script, channels, &mut readings);
        memory::electronics(&self.causes, script, channels, &mut readings);
        if let Some(noise) = noise {
            crate::add_noise(&self.skin.noise, noise, &mut readings);
        }
        memory::converter(&self.causes, script, channels, &mut readings);
        memory::limit(&self.skin.range, &mut readings);
        Ok(readings)
    }
}

impl LayerDevice {
    /// What the field alone does \[Pa\], frame by frame.
    fn pressed(&self, script: &Script) -> Result<Vec<f64>, BenchmarkError> {
        let channels = self.skin.elements.len();
        let friction = self.causes.size("dragging-tip");
        let mut readings = vec![0.0; channels * script.instants.len()];
        let mut before: Option<(f64, Point3<f64>)> = None;
        let bump = memory::bump(&self.causes, script);
        for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
            let mut stimulus = instant.moment.stimulus.clone();
            if let Some((_, by, angle)) = bump.filter(|(from, ..)| instant.time > *from) {
                let off = Vector3::new(angle.cos(), angle.sin(), 0.0) * by;
                stimulus.contacts.iter_mut().for_each(|c| c.position += off);
            }
            if friction > 0.0 {
                let now = stimulus.contacts.first().map(|c| (instant.time, c.position));
                if let (Some((then, from)), Some((time, to)), Some(contact)) =
                    (before, now, stimulus.contacts.first_mut())
                {
                    let pressing = -contact.force.z;
                    contact.force += laws::drag(friction, pressing, to - from, time - then);
                }
                before = now;
            }
            self.skin.response(&stimulus, row)?;
        }
        Ok(readings)
    }

    /// What differs from place to place.
    fn locally(&self, script: &Script, readings: &mut [f64]) {
        let elements = &self.skin.elements;
        if let Some((cause, rise)) = self.causes.get("soft-spot") {
            let at = cavity_at(elements, cause);
            let at = Point3::new(at.x, at.y, 0.0);
            laws::soft_spot(script, elements.len(), (&at, CAVITY), rise, readings);
        }
        if let Some((cause, loss)) = self.causes.get("crack") {
            let through = cavity_at(elements, cause);
            let turn = cause.normals(1)[0] * 0.4;
            let across = Vector2::new(turn.cos(), turn.sin());
            let flat: Vec<_> = elements.iter().map(Point3::xy).collect();
            laws::crack(script, &flat, (&through.into(), &across), loss, readings);
        }
    }

    /// What the material makes of it, which remembers.
    fn remember(&self, script: &Script, readings: &mut [f64]) {
        let channels = self.skin.elements.len();
        if let Some((_, loss)) = self.causes.get("softening") {
            memory::softening(channels, loss, readings);
        }
        if let Some((_, width)) = self.causes.get("inner-friction") {
            memory::bouc_wen(channels, width, readings);
        }
        if let Some((_, share)) = self.causes.get("creeping") {
            memory::creep(script, channels, (share, 0.25), readings);
        }
        if let Some((cause, share)) = self.causes.get("air-pocket") {
            // A pocket of compressibility c / (p0 + s) shunts the stress that the element should see.
            let own: Vec<f64> = cause.normals(channels).iter().map(|n| share * (0.35 * n).exp()).collect();
            for (row, instant) in readings.chunks_mut(channels).zip(&script.instants) {
                for (value, own) in row.iter_mut().zip(&own) {
                    let atmosphere = 101_325.0 + value.max(-9e4);
                    *value /= 1.0 + own * (101_325.0 / atmosphere).powi(4);
                    *value += 0.2 * own * 101_325.0 * instant.warmth() / 293.15;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn line() -> SkinDescription {
        let text = include_str!("../../../launch/skins/baro-line.toml");
        SkinDescription::from_toml(text, "line").unwrap()
    }

    fn device(causes: &[Cause]) -> LayerDevice {
        LayerDevice::new(&line(), &Numerics::default(), causes).unwrap()
    }

    #[test]
    fn readings_add_up_and_fade_with_the_distance() {
        let device = device(&[]);
        let at = |x: f64, force: f64| {
            let contact =
                Indentation::sphere(Point3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, -force), 0.004);
            let mut out = vec![0.0; 6];
            device
                .skin
                .response(&Stimulus { contacts: vec![contact], ..Stimulus::default() }, &mut out)
                .unwrap();
            out
        };
        let readings = at(0.00325, 0.5);
        // Above an element, five millimetres deep: half-space theory says 3.2 kPa for 0.5 N, the bonded base adds to it.
        assert!((2500.0..4500.0).contains(&readings[3]), "{readings:?}");
        assert!(readings[3] > readings[4] && readings[4] > readings[5]);
        let mirrored = at(-0.00325, 0.5);
        approx::assert_relative_eq!(readings[3], mirrored[2], max_relative = 1e-9);
    }

    #[test]
    fn every_cause_moves_the_readings_and_unknown_ones_are_named() {
        let nominal = device(&[]);
        let rig = Rig { size: 0.2, ..LayerDevice::rig(&line(), 0.2) };
        let script = Script::draw(&nominal.model(), &rig, crate::Climate::Varied, 3).unwrap();
        let clean = nominal.readings(&script, None).unwrap();
        for info in LayerDevice::causes() {
            let cause = Cause { id: info.id.to_owned(), strength: 1.0, seed: 5 };
            let other = device(&[cause]).readings(&script, None).unwrap();
            let moved = crate::unexplained(&clean, &other, &script, 6);
            assert!(other.iter().all(|v| v.is_finite()), "{}", info.id);
            assert!(moved > 1e-4, "{} moves {moved} of the variance", info.id);
        }
        let made_up = Cause { id: "gremlins".to_owned(), strength: 1.0, seed: 5 };
        let refused = LayerDevice::new(&line(), &Numerics::default(), &[made_up]).unwrap_err().to_string();
        assert!(refused.contains("gremlins") && refused.contains("creeping"), "{refused}");
    }
}
