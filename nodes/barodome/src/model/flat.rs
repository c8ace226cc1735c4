//! A flat layer of elastomer, as wide as it likes.
//!
//! The layer is of uniform thickness on a rigid base, and goes on beyond the surface that can be pressed, unless its edges
//! are free: then what they change is added ([`super::rim`]). Each press is solved as the contact of a rigid sphere with the
//! layer ([`dermis_mechanics::SphereContact`]); a force along the surface is spread like the pressure. Strains are taken as
//! small, which a soft pad outgrows: at 1 N a 4 mm tip already sinks 3 mm into 10 mm of a 70 kPa elastomer, where a real one
//! stiffens.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

use dermis_mechanics::{MechanicsError, Medium, PressureTable, SphereContacts, gauss_legendre};
use dermis_model::Indentation;
use dermis_skin::cache::{Key, kept};
use dermis_skin::{ModelError, SkinDescription};
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::Field;
use super::rim::Rim;
use crate::parameters::{Edge, Element, Parameters};

/// \[N\] up to which contacts are solved; readings grow in proportion to the force beyond.
const FORCE_MAX: f64 = 5.0;
/// Diameters whose tables are kept.
const TABLES_MAX: usize = 32;
/// Depths that get a table each; where elements lie at more of them, they share tables on a grid of depths.
const DEPTHS_MAX: usize = 8;
/// Ratio of neighbouring depths of that grid, as a logarithm: cubics over it are right to 10⁻⁴.
const DEPTH_STEP: f64 = 0.1;
/// Points along each side of a footprint.
const ACROSS: usize = 3;

/// What is read at one depth.
#[derive(Debug, Clone)]
struct Layer {
    /// \[m\].
    depth: f64,
    points: Vec<Sample>,
}

/// One point whose stress goes into a reading.
#[derive(Debug, Clone, Copy)]
struct Sample {
    channel: usize,
    /// \[m\] along the surface.
    x: f64,
    y: f64,
    /// Share of the reading.
    weight: f64,
}

/// Mean compressive stress in a flat layer.
#[derive(Debug)]
pub(super) struct Flat {
    medium: Medium,
    layers: Vec<Layer>,
    /// Largest distance along the surface between a place that can be pressed and a point that is read \[m\].
    reach: f64,
    /// Bits of a diameter → one table a layer.
    tables: RwLock<BTreeMap<u64, Arc<[PressureTable]>>>,
    /// The same of the diameter that pressed first, often the only one: found without a lock that threads share.
    first: OnceLock<(u64, Arc<[PressureTable]>)>,
    /// What the sides change, where they are free.
    rim: Option<Rim>,
}

impl Flat {
    /// The field in a layer under a rectangle of `size` \[m\].
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the taxel that cannot lie where it does.
    pub(super) fn new(
        skin: &SkinDescription,
        parameters: &Parameters,
        size: [f64; 2],
    ) -> Result<Self, ModelError> {
        let thickness = parameters.thickness;
        let medium =
            Medium::mixed(parameters.young_modulus, parameters.poisson_ratio, thickness, parameters.slip)
                .map_err(|e| skin.refusal("medium", e.to_string()))?;
        let [half_x, half_y] = size.map(|s| s / 2.0);
        let (mut samples, mut reach): (Vec<(f64, Sample)>, f64) = (Vec::new(), 0.0);
        for ((channel, element), taxel) in parameters.elements.iter().enumerate().zip(skin.channel_taxels()) {
            let name = &skin.taxels[taxel].name;
            let wrong = |reason: String| skin.refusal(&format!("taxels[{taxel}].position"), reason);
            // As designed: what an effect moves beyond a surface still lies in a wide medium.
            let [x, y, _] = skin.taxels[taxel].position;
            if x.abs() > half_x || y.abs() > half_y {
                return Err(wrong(format!(
                    "`{name}` lies at ({x}, {y}) m, beside the surface of {} m by {} m",
                    size[0], size[1]
                )));
            }
            for (point, weight) in footprint(element) {
                let [x, y, z] = [point.x, point.y, point.z];
                if !(z < 0.0 && -z <= thickness) {
                    return Err(wrong(format!(
                        "z of `{name}` is {z} m and must lie in the medium: below 0 and not below -{thickness} m"
                    )));
                }
                if parameters.edge == Edge::Free && !(x.abs() < half_x && y.abs() < half_y && -z < thickness)
                {
                    return Err(wrong(format!(
                        "`{name}` reads at ({x}, {y}, {z}) m, where an elastomer with free edges of {} m by {} m has ended",
                        size[0], size[1]
                    )));
                }
                let far = (half_x + x.abs()).hypot(half_y + y.abs());
                if far > 100.0 * -z {
                    return Err(wrong(format!(
                        "`{name}` is too near to the surface: it must be at least {:.6} m deep",
                        far / 100.0
                    )));
                }
                reach = reach.max(far);
                samples.push((-z, Sample { channel, x, y, weight }));
            }
        }
        let layers = exact_layers(&samples).unwrap_or_else(|| grid_layers(&samples, thickness));
        let rim = (parameters.edge == Edge::Free).then(|| {
            let probes = parameters.elements.iter().map(footprint).collect();
            Rim::new(size, thickness, parameters.poisson_ratio, parameters.slip, probes)
        });
        Ok(Self {
            medium,
            layers,
            reach: reach + Indentation::OFF_SURFACE,
            tables: RwLock::default(),
            first: OnceLock::new(),
            rim,
        })
    }

    fn tables(&self, index: usize, diameter: f64) -> Result<Arc<[PressureTable]>, ModelError> {
        let key = diameter.to_bits();
        // A table is inserted whole: a panic elsewhere leaves none half-made.
        if let Some(tables) = self.tables.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(Arc::clone(tables));
        }
        let tables =
            self.tabulate(diameter).map_err(|e| ModelError::Stimulus { index, reason: e.to_string() })?;
        let mut kept = self.tables.write().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= TABLES_MAX {
            kept.clear();
        }
        kept.insert(key, Arc::clone(&tables));
        // Of two that come at once, one is the first.
        let _ = self.first.set((key, Arc::clone(&tables)));
        Ok(tables)
    }
}

impl Flat {
    /// The tables of a tip, one a layer.
    fn tabulate(&self, diameter: f64) -> Result<Arc<[PressureTable]>, MechanicsError> {
        let locations: Vec<[f64; 2]> =
            self.layers.iter().map(|l| [l.depth, self.reach.min(100.0 * l.depth)]).collect();
        let depends = (&self.medium, diameter, FORCE_MAX, &locations);
        let what = "the pressure in the elastomer under a tip";
        let tables: Box<[PressureTable]> =
            kept(what, Key::new("flat").debug(&depends), || -> Result<_, MechanicsError> {
                let contacts = SphereContacts::new(&self.medium, diameter, FORCE_MAX)?;
                locations.iter().map(|[depth, reach]| PressureTable::new(&contacts, *depth, *reach)).collect()
            })?;
        Ok(tables.into())
    }
}

/// Points that an element reads, with their weights: its port, or Gauss points over the rectangle across its normal.
pub(super) fn footprint(element: &Element) -> Vec<(Point3<f64>, f64)> {
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &element.normal)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let along = |side: f64| match side {
        side if side > 0.0 => {
            gauss_legendre(ACROSS).into_iter().map(|(t, w)| ((t - 0.5) * side, w)).collect()
        }
        _ => vec![(0.0, 1.0)],
    };
    let [a, b] = element.footprint.map(along);
    if (a.len(), b.len()) == (1, 1) {
        return vec![(element.position, 1.0)];
    }
    a.iter()
        .flat_map(|&(u, weight)| b.iter().map(move |&(v, other)| (Vector3::new(u, v, 0.0), weight * other)))
        .map(|(offset, weight)| (element.position + turn * offset, weight))
        .collect()
}

/// A layer for every depth, where those are few.
fn exact_layers(samples: &[(f64, Sample)]) -> Option<Vec<Layer>> {
    let mut layers: Vec<Layer> = Vec::new();
    for &(depth, sample) in samples {
        // A micrometre is far below what a table resolves, and one table fewer.
        match layers.iter().position(|l| (l.depth - depth).abs() < 1e-6) {
            Some(layer) => layers[layer].points.push(sample),
            None if layers.len() == DEPTHS_MAX => return None,
            None => layers.push(Layer { depth, points: vec![sample] }),
        }
    }
    Some(layers)
}

/// Layers on a grid of depths, in the thickness times powers of e^(−0.1); what lies between is the cubic through four
/// of them. The grid does not depend on where the samples lie, so that the field is continuous in that.
fn grid_layers(samples: &[(f64, Sample)], thickness: f64) -> Vec<Layer> {
    let mut layers: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
    for &(depth, sample) in samples {
        let place = (thickness / depth).ln() / DEPTH_STEP;
        let first = (place.floor() - 1.0).max(0.0);
        let t = place - first;
        for node in 0..4u32 {
            let lagrange: f64 = (0..4u32)
                .filter(|other| *other != node)
                .map(|other| (t - f64::from(other)) / (f64::from(node) - f64::from(other)))
                .product();
            if lagrange != 0.0 {
                let weighted = Sample { weight: sample.weight * lagrange, ..sample };
                layers.entry(first as u32 + node).or_default().push(weighted);
            }
        }
    }
    layers
        .into_iter()
        .map(|(node, points)| Layer { depth: thickness * (-DEPTH_STEP * f64::from(node)).exp(), points })
        .collect()
}

impl Field for Flat {
    fn add(&self, index: usize, contact: &Indentation, out: &mut [f64]) -> Result<(), ModelError> {
        let kept;
        let tables: &[PressureTable] = match self.first.get() {
            Some((diameter, tables)) if *diameter == contact.diameter().to_bits() => tables,
            _ => {
                kept = self.tables(index, contact.diameter())?;
                &kept
            }
        };
        let (p, force) = (contact.position, contact.force);
        let sheared = force.x != 0.0 || force.y != 0.0;
        for (layer, table) in self.layers.iter().zip(tables.iter()) {
            let profile = table.under(-force.z);
            for s in &layer.points {
                let (dx, dy) = (s.x - p.x, s.y - p.y);
                let r = (dx * dx + dy * dy).sqrt();
                out[s.channel] += s.weight * profile.pressure(r);
                // Straight under the contact, shear has no effect.
                if sheared && r > 0.0 {
                    let ahead = (force.x * dx + force.y * dy) / r;
                    out[s.channel] += s.weight * ahead * profile.shear(r);
                }
            }
        }
        if let Some(rim) = &self.rim {
            let ring = tables.first().map_or((0.0, 0.0), |table| table.under(-force.z).ring());
            rim.add(contact, ring, out).map_err(|e| ModelError::Stimulus { index, reason: e.to_string() })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    const GRID: &str = include_str!("../../../../launch/skins/baro-grid.toml");
    static SKIN: LazyLock<SkinDescription> =
        LazyLock::new(|| SkinDescription::from_toml(GRID, "baro-grid.toml").unwrap());
    static NOMINAL: LazyLock<Flat> = LazyLock::new(|| flat(|_| ()));

    fn flat(change: impl Fn(&mut Parameters)) -> Flat {
        let mut parameters = Parameters::nominal(&SKIN).unwrap();
        parameters.edge = Edge::Wide;
        change(&mut parameters);
        Flat::new(&SKIN, &parameters, [0.034; 2]).unwrap()
    }

    fn read(flat: &Flat, [x, y]: [f64; 2], force: [f64; 3]) -> Vec<f64> {
        let contact = Indentation::sphere(Point3::new(x, y, 0.0), Vector3::from(force), 0.004);
        let mut out = vec![0.0; 25];
        flat.add(0, &contact, &mut out).unwrap();
        out
    }

    #[test]
    fn a_diameter_is_tabulated_once() {
        let flat = flat(|_| ());
        for diameter in [0.002, 0.012, 0.002] {
            let contact = Indentation::sphere(Point3::origin(), Vector3::new(0.0, 0.0, -0.3), diameter);
            flat.add(0, &contact, &mut [0.0; 25]).unwrap();
        }
        assert_eq!(flat.tables.read().unwrap().len(), 2);
    }

    #[test]
    fn shear_presses_what_lies_ahead_and_relieves_what_lies_behind() {
        let (without, with) =
            (read(&NOMINAL, [0.0, 0.0], [0.0, 0.0, -0.5]), read(&NOMINAL, [0.0, 0.0], [0.2, 0.0, -0.5]));
        // b11, b12, b13 lie behind, under, and ahead of a contact that is pushed along x.
        assert!(with[13] > without[13] && with[11] < without[11]);
        assert_eq!(with[12], without[12]);
        assert_relative_eq!(with[13] - without[13], without[11] - with[11], max_relative = 1e-9);
        // As a point load would, to the share that the contact's width takes.
        let load = dermis_mechanics::Load::Point { force: 0.2 };
        let ahead = NOMINAL.medium.pressure_of_shear(&load, 0.005, 0.0065).unwrap();
        assert_relative_eq!(with[13] - without[13], ahead, max_relative = 0.05);
    }

    #[test]
    fn shear_turns_with_its_direction() {
        let along_x = read(&NOMINAL, [0.001, 0.003], [0.2, 0.0, -0.5]);
        let along_y = read(&NOMINAL, [0.003, 0.001], [0.0, 0.2, -0.5]);
        for row in 0..5 {
            for column in 0..5 {
                let (a, b) = (along_x[5 * row + column], along_y[5 * column + row]);
                assert_relative_eq!(a, b, max_relative = 1e-9);
            }
        }
    }

    #[test]
    fn a_footprint_averages() {
        let wide = flat(|p| p.elements.iter_mut().for_each(|e| e.footprint = [0.005, 0.003]));
        let found = read(&wide, [0.001, 0.002], [0.1, -0.05, -0.3]);
        // The midpoint rule over the same rectangle, by moving the contact the other way.
        let (n, mut mean) = (15, vec![0.0; 25]);
        let offset = |i: i32, side: f64| ((f64::from(i) + 0.5) / f64::from(n) - 0.5) * side;
        for i in 0..n {
            for j in 0..n {
                let at = [0.001 - offset(i, 0.005), 0.002 - offset(j, 0.003)];
                for (m, v) in mean.iter_mut().zip(read(&NOMINAL, at, [0.1, -0.05, -0.3])) {
                    *m += v / f64::from(n * n);
                }
            }
        }
        for (a, b) in found.iter().zip(&mean) {
            assert_relative_eq!(a, b, epsilon = 2e-3 * mean[12]);
        }
        let point = read(&NOMINAL, [0.001, 0.002], [0.1, -0.05, -0.3]);
        assert!(found[12] < 0.95 * point[12], "{} for {}", found[12], point[12]);
    }

    #[test]
    fn tilting_a_footprint_tells_its_sides_apart() {
        let tilted = flat(|p| {
            for e in &mut p.elements {
                e.footprint = [0.005, 0.003];
                e.normal = Vector3::new(0.1, 0.0, 1.0).normalize();
            }
        });
        // The chip's +x side is deeper.
        let [left, right] = [-0.002, 0.002].map(|x| read(&tilted, [x, 0.0], [0.0, 0.0, -0.3])[12]);
        assert!(left > 1.005 * right, "{left}, {right}");
    }

    /// Every element at a depth of its own: tables on the grid of depths against one table a depth.
    #[test]
    fn many_depths_share_tables() {
        let sunk = |i: usize| 0.0002 * (i % 7) as f64 - 0.0006;
        let depths = |p: &mut Parameters| {
            for (i, e) in p.elements.iter_mut().enumerate() {
                e.position.z += sunk(i) + 1e-5 * (i / 7) as f64;
            }
        };
        let grid = flat(depths);
        assert!(grid.layers.len() < 9, "{} layers", grid.layers.len());
        let (at, force) = ([0.0021, -0.0013], [0.1, 0.2, -0.4]);
        let found = read(&grid, at, force);
        for channel in [0, 6, 12, 13, 24] {
            let one = flat(|p| {
                depths(p);
                let depth = p.elements[channel].position.z;
                p.elements.iter_mut().for_each(|e| e.position.z = depth);
            });
            assert_eq!(one.layers.len(), 1);
            let exact = read(&one, at, force)[channel];
            assert_relative_eq!(found[channel], exact, epsilon = 2e-4 * found[12]);
        }
    }

    #[test]
    fn a_grid_of_depths_ends_at_the_base() {
        let sample = Sample { channel: 0, x: 0.0, y: 0.0, weight: 1.0 };
        for depth in [0.010, 0.0099, 0.0091, 0.005] {
            let layers = grid_layers(&[(depth, sample)], 0.010);
            let weights: f64 = layers.iter().map(|l| l.points[0].weight).sum();
            let mean: f64 = layers.iter().map(|l| l.points[0].weight * l.depth.ln()).sum();
            assert!(layers.iter().all(|l| l.depth <= 0.010));
            assert_relative_eq!(weights, 1.0, max_relative = 1e-12);
            assert_relative_eq!(mean, depth.ln(), max_relative = 1e-12);
        }
    }

    #[test]
    fn slip_mixes_both_bases() {
        let bases = [0.0, 0.4, 1.0].map(|slip| flat(move |p| p.slip = slip));
        // A light touch: the contact itself does not change with the base.
        let [bonded, between, slipping] =
            bases.each_ref().map(|b| read(b, [0.003, -0.011], [3e-4, 0.0, -1e-3]));
        for i in 0..25 {
            let mixed = 0.6 * bonded[i] + 0.4 * slipping[i];
            assert_relative_eq!(between[i], mixed, epsilon = 1e-3 * bonded[2]);
        }
        assert!(slipping[2] != bonded[2]);
    }

    proptest! {
        #[test]
        fn shear_is_linear_and_odd(x in -0.017..0.017f64, y in -0.017..0.017f64, fx in -0.5..0.5f64, fy in -0.5..0.5f64) {
            let [none, one, back, twice] = [0.0, 1.0, -1.0, 2.0].map(|s| read(&NOMINAL, [x, y], [s * fx, s * fy, -0.4]));
            for i in 0..25 {
                let part = one[i] - none[i];
                prop_assert!((back[i] - none[i] + part).abs() < 1e-9 * (1.0 + none[i].abs()));
                prop_assert!((twice[i] - none[i] - 2.0 * part).abs() < 1e-9 * (1.0 + none[i].abs()));
            }
        }
    }
}
