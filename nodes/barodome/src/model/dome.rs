//! An elastomer over a rigid core: a fingertip.
//!
//! Its field is that of finite elements ([`dermis_mechanics::fem::Dome`]): how a force at any point of the outside acts on the sensors.
//! A sphere's contact is spread over the outside like the pressure under a sphere on a flat layer of that thickness, with
//! the radius 1/(1/R_sphere + 1/R_dome) that two spheres have for each other; on the cylinder, which is curved one way only,
//! that takes a tip of 4 mm for 9 % sharper than it is, and its contact for 3 % narrower. A force along the surface is spread
//! like the pressure. Strains are small, as in a flat layer.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

use dermis_mechanics::fem::{self, DomeShape, Probe};
use dermis_mechanics::{Base, MechanicsError, Medium, SphereContact};
use dermis_model::Indentation;
use dermis_skin::cache::{Key, kept};
use dermis_skin::{ModelError, SkinDescription};
use nalgebra::Vector3;

use super::Field;
use super::flat::footprint;
use crate::parameters::{Edge, Parameters};

/// \[N\] up to which contacts are solved; a contact is not wider beyond.
const FORCE_MAX: f64 = 5.0;
/// Contacts along the force axis.
const CONTACTS: usize = 24;
/// Diameters whose contacts are kept.
const DIAMETERS_MAX: usize = 32;
/// Share of the thickness that a taxel must keep from each side of the elastomer.
const MARGIN: f64 = 0.05;
/// Radii of the rings of points that stand for a contact, squared and in contact radii, and how many points each has. With
/// the centre, their weights give a pressure its second and fourth moments.
const RINGS: [(f64, u32); 2] = [(0.4, 6), (0.9, 12)];
/// All of them, the centre included.
const POINTS: usize = 19;

/// Mean compressive stress in a dome.
#[derive(Debug)]
pub(super) struct Dome {
    shape: DomeShape,
    medium: Medium,
    poisson_ratio: f64,
    probes: Vec<Probe>,
    /// Solved when first requested: a second of work that a model without contacts can do without.
    field: OnceLock<Result<fem::Dome, MechanicsError>>,
    /// Cosine and sine of each point's place in its ring.
    turns: Vec<Vec<(f64, f64)>>,
    /// Bits of a diameter → its contacts.
    contacts: RwLock<BTreeMap<u64, Arc<[Contact]>>>,
}

/// How wide a contact is, and how its pressure is spread.
#[derive(Debug, Clone, Copy)]
struct Contact {
    /// Cube root of the force \[N^(1/3)\].
    root: f64,
    /// \[m\].
    radius: f64,
    /// Share of the force on each ring; the rest is in the centre.
    rings: [f64; 2],
}

impl Dome {
    /// The field in the elastomer of a dome.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the taxel that cannot lie where it does, or the number that cannot be.
    pub(super) fn new(
        skin: &SkinDescription,
        parameters: &Parameters,
        radius: f64,
        cylinder: f64,
    ) -> Result<Self, ModelError> {
        let thickness = parameters.thickness;
        if thickness >= radius {
            let reason = format!(
                "is {thickness} m and must be smaller than the dome's radius of {radius} m: a core is inside"
            );
            return Err(skin.refusal("medium.thickness", reason));
        }
        if parameters.edge == Edge::Free {
            let reason = "is for a flat surface: the foot of a dome is always free".into();
            return Err(skin.refusal("medium.edge", reason));
        }
        let medium =
            Medium::mixed(parameters.young_modulus, parameters.poisson_ratio, thickness, parameters.slip)
                .map_err(|e| skin.refusal("medium", e.to_string()))?;
        let shape = DomeShape { radius, cylinder, thickness };
        let margin = MARGIN * thickness;
        let mut probes = Vec::new();
        for (element, taxel) in parameters.elements.iter().zip(skin.channel_taxels()) {
            let probe = footprint(element);
            for (point, _) in &probe {
                let depth = shape.depth(point);
                // A hair of leave: numbers in a file are rounded.
                let inside = margin - 1e-9..=thickness - margin + 1e-9;
                if !(inside.contains(&depth) && point.z >= margin - 1e-9) {
                    let reason = format!(
                        "`{}` reads at ({}, {}, {}) m, {depth:.6} m below the outside, and must lie in the elastomer: \
                         {margin:.6} to {:.6} m below the outside, and {margin:.6} m above the foot",
                        skin.taxels[taxel].name,
                        point.x,
                        point.y,
                        point.z,
                        thickness - margin
                    );
                    return Err(skin.refusal(&format!("taxels[{taxel}].position"), reason));
                }
            }
            probes.push(probe);
        }
        let turns = RINGS
            .iter()
            .map(|&(_, count)| {
                (0..count)
                    .map(|k| (std::f64::consts::TAU * f64::from(k) / f64::from(count)).sin_cos())
                    .map(|(s, c)| (c, s))
                    .collect()
            })
            .collect();
        Ok(Self {
            shape,
            medium,
            poisson_ratio: parameters.poisson_ratio,
            probes,
            field: OnceLock::new(),
            turns,
            contacts: RwLock::default(),
        })
    }

    fn field(&self, index: usize) -> Result<&fem::Dome, ModelError> {
        let solve = |base| fem::Dome::new(self.shape, self.poisson_ratio, base, &self.probes);
        let slip = self.medium.slip();
        self.field
            .get_or_init(|| {
                let depends = (self.shape, self.poisson_ratio, slip, &self.probes);
                let what = "the field in the elastomer of the dome (finite elements)";
                kept(what, Key::new("dome").debug(&depends), || match slip {
                    0.0 => solve(Base::Bonded),
                    1.0 => solve(Base::Slip),
                    _ => Ok(solve(Base::Bonded)?.mixed(&solve(Base::Slip)?, slip)),
                })
            })
            .as_ref()
            .map_err(|e| ModelError::Stimulus { index, reason: e.to_string() })
    }

    fn contacts(&self, index: usize, diameter: f64) -> Result<Arc<[Contact]>, ModelError> {
        let key = diameter.to_bits();
        // What is inserted is whole: a panic elsewhere leaves none half-made.
        if let Some(contacts) = self.contacts.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(Arc::clone(contacts));
        }
        let radius = 1.0 / (2.0 / diameter + 1.0 / self.shape.radius);
        let contacts: Arc<[Contact]> = spread(&self.medium, radius)
            .map_err(|e| ModelError::Stimulus { index, reason: e.to_string() })?
            .into();
        let mut kept = self.contacts.write().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= DIAMETERS_MAX {
            kept.clear();
        }
        kept.insert(key, Arc::clone(&contacts));
        Ok(contacts)
    }
}

/// Contacts of a sphere of `radius` \[m\] from the lightest touch up to the largest force.
fn spread(medium: &Medium, radius: f64) -> Result<Vec<Contact>, MechanicsError> {
    let contact = |u: f64| SphereContact::new(medium, radius, radius * u.tanh());
    let mut end = 0.05;
    while end < 8.0 && contact(end)?.force() < FORCE_MAX {
        end *= 1.25;
    }
    let mut contacts = Vec::with_capacity(CONTACTS + 1);
    for i in 1..=CONTACTS {
        let contact = contact(end * i as f64 / CONTACTS as f64)?;
        // The transform of the pressure at small wavenumbers: F/2π (1 − k²⟨r²⟩/4 + k⁴⟨r⁴⟩/64).
        let a = contact.contact_radius();
        let lack = |ka: f64| 1.0 - contact.transform(ka / a) / contact.transform(0.0);
        let (low, high) = (0.25f64, 0.5f64);
        let (p, q) = (lack(low) / low.powi(2), lack(high) / high.powi(2));
        let fourth = 64.0 * (p - q) / (high.powi(2) - low.powi(2));
        let second = 4.0 * (p + fourth / 64.0 * low.powi(2));
        let [(x, _), (y, _)] = RINGS;
        let outer = (fourth - x * second) / (y * (y - x));
        let rings = [(second - outer * y) / x, outer];
        contacts.push(Contact { root: contact.force().cbrt(), radius: a, rings });
    }
    // The lightest touch is a point, with the profile of the first contact.
    contacts.insert(0, Contact { root: 0.0, radius: 0.0, rings: contacts[0].rings });
    Ok(contacts)
}

/// The contact under a force, between those that were solved.
fn at_force(contacts: &[Contact], force: f64) -> Contact {
    let root = force.cbrt();
    let upper = contacts.partition_point(|c| c.root <= root).clamp(1, contacts.len() - 1);
    let (a, b) = (&contacts[upper - 1], &contacts[upper]);
    let t = ((root - a.root) / (b.root - a.root)).clamp(0.0, 1.0);
    let between = |a: f64, b: f64| a + t * (b - a);
    Contact {
        root,
        radius: between(a.radius, b.radius),
        rings: [between(a.rings[0], b.rings[0]), between(a.rings[1], b.rings[1])],
    }
}

impl Field for Dome {
    fn add(&self, index: usize, contact: &Indentation, out: &mut [f64]) -> Result<(), ModelError> {
        let influence = self.field(index)?.influence();
        let contacts = self.contacts(index, contact.diameter())?;
        let [arc, angle] = self.shape.chart(&contact.position);
        let normal = self.shape.normal(&contact.position);
        let patch = at_force(&contacts, -contact.force.dot(&normal));
        // Two directions along the surface that turn smoothly with the normal, which never points down. (T. Duff et al.,
        // Building an orthonormal basis, revisited, 2017.)
        let a = -1.0 / (1.0 + normal.z);
        let b = normal.x * normal.y * a;
        let along = [
            Vector3::new(1.0 + normal.x * normal.x * a, b, -normal.x),
            Vector3::new(b, 1.0 + normal.y * normal.y * a, -normal.y),
        ];
        let mut points = [[arc, angle, 1.0 - patch.rings[0] - patch.rings[1]]; POINTS];
        let mut locations = points[1..].iter_mut();
        for ((share, (square, _)), turns) in patch.rings.iter().zip(RINGS).zip(&self.turns) {
            let radius = patch.radius * square.sqrt();
            let weight = share / turns.len() as f64;
            for ((c, s), location) in turns.iter().zip(&mut locations) {
                let point = contact.position + (along[0] * *c + along[1] * *s) * radius;
                let [arc, angle] = self.shape.chart(&point);
                *location = [arc, angle, weight];
            }
        }
        let mut sums = vec![0.0; influence.width()];
        influence.add_all(&points, &mut sums);
        for (o, a) in out.iter_mut().zip(sums.chunks_exact(3)) {
            *o += a[0] * contact.force.x + a[1] * contact.force.y + a[2] * contact.force.z;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::Point3;
    use std::f64::consts::TAU;
    use std::sync::LazyLock;

    const DOME: &str = include_str!("../../../../launch/skins/baro-dome.toml");
    static SKIN: LazyLock<SkinDescription> =
        LazyLock::new(|| SkinDescription::from_toml(DOME, "baro-dome.toml").unwrap());
    static NOMINAL: LazyLock<Dome> = LazyLock::new(|| dome(|_| ()).unwrap());

    fn dome(change: impl Fn(&mut Parameters)) -> Result<Dome, ModelError> {
        let mut parameters = Parameters::nominal(&SKIN).unwrap();
        change(&mut parameters);
        Dome::new(&SKIN, &parameters, 0.010, 0.016)
    }

    /// Readings under a tip of 4 mm at an arc from the dome's tip and an angle: forces into the surface, down along it, and
    /// around the axis.
    fn read(dome: &Dome, at: [f64; 2], force: [f64; 3]) -> Vec<f64> {
        let position = dome.shape.point(at);
        let out = dome.shape.normal(&position);
        let around = Vector3::new(-at[1].sin(), at[1].cos(), 0.0);
        let force = -out * force[0] + around.cross(&out) * force[1] + around * force[2];
        let mut readings = vec![0.0; 16];
        dome.add(0, &Indentation::sphere(position, force, 0.004), &mut readings).unwrap();
        readings
    }

    fn largest(readings: &[f64]) -> usize {
        (0..readings.len()).max_by(|a, b| readings[*a].total_cmp(&readings[*b])).unwrap()
    }

    #[test]
    fn the_taxel_below_feels_most() {
        for (channel, element) in Parameters::nominal(&SKIN).unwrap().elements.iter().enumerate() {
            let at = NOMINAL.shape.chart(&element.position);
            let readings = read(&NOMINAL, at, [0.5, 0.0, 0.0]);
            assert_eq!(largest(&readings), channel);
            assert!(readings[channel] > 2000.0, "{readings:?}");
        }
    }

    /// A fifth of a turn takes every ring to itself.
    #[test]
    fn turned_contacts_read_the_same_on_turned_taxels() {
        for arc in [0.004, 0.0157, 0.022] {
            let force = [0.4, 0.1, -0.2];
            let (before, after) =
                (read(&NOMINAL, [arc, 0.3], force), read(&NOMINAL, [arc, 0.3 + TAU / 5.0], force));
            let peak = before.iter().fold(0.0f64, |p, v| p.max(v.abs()));
            for ring in 0..3 {
                for k in 0..5 {
                    let (a, b) = (1 + 5 * ring + k, 1 + 5 * ring + (k + 1) % 5);
                    assert!((before[a] - after[b]).abs() < 2e-3 * peak, "{arc} {a}: {before:?} {after:?}");
                }
            }
        }
    }

    #[test]
    fn readings_and_their_slopes_are_continuous() {
        let step = 1e-5;
        let steps = || (-100..100).map(|i| f64::from(i) * step);
        // Over the tip, over the equator, and across where angles start again.
        let tip = steps().map(|x| [x.abs(), if x < 0.0 { 0.7 + TAU / 2.0 } else { 0.7 }]).collect::<Vec<_>>();
        let equator = steps().map(|x| [0.005 * TAU / 2.0 + x, 0.7]).collect();
        let seam = steps().map(|x| [0.012, (x / 0.01).rem_euclid(TAU)]).collect();
        for (line, force) in
            [(tip, [0.1, -0.2, -0.5]), (equator, [-0.4, -0.3, 0.2]), (seam, [-0.5, 0.1, -0.2])]
        {
            let readings: Vec<Vec<f64>> = line
                .iter()
                .map(|at| {
                    let position = NOMINAL.shape.point(*at);
                    let mut out = vec![0.0; 16];
                    let contact = Indentation::sphere(position, Vector3::from(force), 0.004);
                    NOMINAL.add(0, &contact, &mut out).unwrap();
                    out
                })
                .collect();
            for channel in 0..16 {
                let slope = |w: &[Vec<f64>]| (w[1][channel] - w[0][channel]) / step;
                let slopes: Vec<f64> = readings.windows(2).map(slope).collect();
                for pair in slopes.windows(2) {
                    // Kilopascals that come and go over millimetres: that much their slope may change in a step, and no more.
                    assert!((pair[1] - pair[0]).abs() < 2e4, "{force:?} {channel}: {pair:?}");
                }
            }
        }
    }

    #[test]
    fn the_wider_the_tip_the_less_is_read_below() {
        let below = |diameter: f64| {
            let position = Point3::new(0.0, 0.0, 0.026);
            let mut out = vec![0.0; 16];
            let force = Vector3::new(0.0, 0.0, -0.5);
            NOMINAL.add(0, &Indentation::sphere(position, force, diameter), &mut out).unwrap();
            out[0]
        };
        assert!(below(0.002) > below(0.004) && below(0.004) > below(0.012));
        // A point's force, nearly.
        let mut point = vec![0.0; 48];
        NOMINAL.field(0).unwrap().influence().add(0.0, 0.0, 0.5, &mut point);
        assert_relative_eq!(below(1e-4), -point[2], max_relative = 0.01);
    }

    /// The points that stand for a contact have a Hertzian contact's second and fourth moments where it is light.
    #[test]
    fn light_contacts_are_hertzian() {
        let contacts = NOMINAL.contacts(0, 0.004).unwrap();
        let [x, y] = RINGS.map(|r| r.0);
        let [a, b] = contacts[0].rings;
        assert_relative_eq!(a * x + b * y, 2.0 / 5.0, max_relative = 0.01);
        assert_relative_eq!(a * x * x + b * y * y, 8.0 / 35.0, max_relative = 0.01);
        for c in contacts.iter() {
            assert!(c.rings.iter().all(|w| *w > 0.0) && c.rings.iter().sum::<f64>() < 1.0, "{c:?}");
        }
    }

    #[test]
    fn what_a_base_holds_lies_between_bonded_and_slipping() {
        let at = |slip: f64| read(&dome(|p| p.slip = slip).unwrap(), [0.009, 0.2], [0.5, 0.1, 0.0])[1];
        let (bonded, half, slipping) = (at(0.0), at(0.5), at(1.0));
        assert!(bonded != slipping);
        assert!((half - bonded) * (half - slipping) < 0.0, "{bonded} {half} {slipping}");
    }

    #[test]
    fn a_footprint_averages() {
        let whole = dome(|p| p.elements.iter_mut().for_each(|e| e.footprint = [0.005, 0.003])).unwrap();
        let at = [0.0, 0.0];
        let (wide, point) = (read(&whole, at, [0.2, 0.0, 0.0]), read(&NOMINAL, at, [0.2, 0.0, 0.0]));
        assert!(wide[0] < point[0] && wide[0] > 0.7 * point[0]);
    }

    #[test]
    fn impossible_domes_are_refused_by_field() {
        let skin = |from: &str, to: &str| {
            assert!(DOME.contains(from), "{from} is not in the file");
            let skin = SkinDescription::from_toml(&DOME.replace(from, to), "baro-dome.toml").unwrap();
            Dome::new(&skin, &Parameters::nominal(&skin).unwrap(), 0.010, 0.016).unwrap_err().to_string()
        };
        insta::assert_snapshot!(skin("0.0000000, 0.0224000", "0.0000000, 0.0184000"), @"skin `baro-dome`: field `taxels[0].position`: `d00` reads at (0, 0, 0.0184) m, 0.007600 m below the outside, and must lie in the elastomer: 0.000360 to 0.006840 m below the outside, and 0.000360 m above the foot");
        insta::assert_snapshot!(skin("[0.0064000, 0.0000000, 0.0050000]", "[0.0064000, 0.0000000, 0.0000000]"), @"skin `baro-dome`: field `taxels[11].position`: `d11` reads at (0.0064, 0, 0) m, 0.003600 m below the outside, and must lie in the elastomer: 0.000360 to 0.006840 m below the outside, and 0.000360 m above the foot");
        insta::assert_snapshot!(skin("thickness = 0.0072", "thickness = 0.0102"), @"skin `baro-dome`: field `medium.thickness`: is 0.0102 m and must be smaller than the dome's radius of 0.01 m: a core is inside");
        insta::assert_snapshot!(skin("base = \"bonded\" ", "edge = \"free\" "), @"skin `baro-dome`: field `medium.edge`: is for a flat surface: the foot of a dome is always free");
    }
}
