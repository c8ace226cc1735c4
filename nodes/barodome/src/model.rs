//! Forward model: what barometers in a flat elastic layer read when spheres press on it.
//!
//! A barometer molded into an elastomer reads the mean compressive stress at its port. The layer is linear
//! elastic, of uniform thickness on a rigid base, and as wide as it likes: what its edges do to a press within
//! about one thickness of them is left out. Each press is solved as the contact of a rigid sphere with the layer
//! ([`dermis_mechanics::SphereContact`]); several presses add up, and the part of a force along the surface is not
//! felt. Strains are taken as small, which a soft pad outgrows: at 1 N a 4 mm tip already sinks 3 mm into 10 mm of
//! a 70 kPa elastomer, where a real one stiffens. Readings are gauge pressures: 0 when untouched at one standard
//! atmosphere.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use dermis_mechanics::{Base, Medium, PressureTable};
use dermis_skin::{ForwardModel, ModelError, SkinDescription, Stimulus, Surface, SurfaceSpec};
use serde::Deserialize;

/// \[Pa\] that gauge pressures are relative to.
const STANDARD_ATMOSPHERE: f64 = 101_325.0;
/// \[N\] up to which contacts are solved; readings grow in proportion to the force beyond.
const FORCE_MAX: f64 = 5.0;
/// \[m\] off the surface that a contact may lie: rounding of single precision, with room to spare.
const OFF_SURFACE: f64 = 1e-4;
/// \[m\] diameters of a tip that the theory can speak of.
const DIAMETERS: std::ops::RangeInclusive<f64> = 1e-4..=0.1;
/// Diameters whose tables are kept.
const TABLES_MAX: usize = 32;

/// `medium` of a skin description.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct MediumSpec {
    /// \[m\].
    thickness: f64,
    /// \[Pa\].
    young_modulus: f64,
    poisson_ratio: f64,
    #[serde(default)]
    base: Base,
}

/// Channels at one depth.
#[derive(Debug, Clone)]
struct Layer {
    depth: f64,
    /// Channel and where it lies along the surface \[m\].
    channels: Vec<(usize, f64, f64)>,
}

/// Barometers in a flat elastic layer: readings \[Pa\] for spherical tips that press on it.
///
/// The field of each tip's diameter is tabulated when it first presses (a fraction of a second) and kept; after
/// that a press costs a few nanoseconds a channel.
#[derive(Debug)]
pub struct BarometerModel {
    medium: Medium,
    surface: Surface,
    layers: Vec<Layer>,
    noise: Vec<f64>,
    /// Largest distance along the surface between a place that can be pressed and a taxel \[m\].
    reach: f64,
    /// Bits of a diameter → one table a layer.
    tables: RwLock<BTreeMap<u64, Arc<[PressureTable]>>>,
}

impl BarometerModel {
    /// The model of a skin whose `surface` is a rectangle and whose `medium` names `thickness` \[m\],
    /// `young_modulus` \[Pa\], `poisson_ratio` and `base` (`"bonded"`, the default, or `"slip"`).
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let wrong = |field: &str, reason: String| ModelError::Description {
            skin: skin.name.clone(),
            field: field.to_owned(),
            reason,
        };
        let SurfaceSpec::Rectangle { size, .. } = skin.surface else {
            return Err(wrong("surface.type", "this model knows a flat `rectangle` only".into()));
        };
        if skin.unit != "Pa" {
            return Err(wrong("unit", format!("is \"{}\" where barometers read \"Pa\"", skin.unit)));
        }
        let spec: MediumSpec = serde_path_to_error::deserialize(toml::Value::Table(skin.medium.clone()))
            .map_err(|e| {
                let field = match e.path().to_string() {
                    p if p == "." => "medium".to_owned(),
                    p => format!("medium.{p}"),
                };
                wrong(&field, e.inner().message().trim().replace('\n', " "))
            })?;
        // One number at a time, so that the refusal names its field.
        let impossible = |field| move |e: dermis_mechanics::MechanicsError| wrong(field, e.to_string());
        Medium::half_space(1.0, spec.poisson_ratio).map_err(impossible("medium.poisson_ratio"))?;
        Medium::half_space(spec.young_modulus, 0.0).map_err(impossible("medium.young_modulus"))?;
        let medium = Medium::layer(spec.young_modulus, spec.poisson_ratio, spec.thickness, spec.base)
            .map_err(impossible("medium.thickness"))?;

        let [half_x, half_y] = size.map(|s| s / 2.0);
        let (mut layers, mut reach): (Vec<Layer>, f64) = (Vec::new(), 0.0);
        for (i, taxel) in skin.taxels.iter().enumerate() {
            let [x, y, z] = taxel.position;
            let field = format!("taxels[{i}].position");
            if !(z < 0.0 && -z <= spec.thickness) {
                let reason = format!(
                    "z of `{}` is {z} m and must lie in the medium: below 0 and not below -{} m",
                    taxel.name, spec.thickness
                );
                return Err(wrong(&field, reason));
            }
            if x.abs() > half_x || y.abs() > half_y {
                let reason = format!(
                    "`{}` lies at ({x}, {y}) m, beside the surface of {} m by {} m",
                    taxel.name, size[0], size[1]
                );
                return Err(wrong(&field, reason));
            }
            let far = (half_x + x.abs()).hypot(half_y + y.abs());
            if far > 100.0 * -z {
                let reason = format!(
                    "`{}` is too near to the surface: it must be at least {:.6} m deep",
                    taxel.name,
                    far / 100.0
                );
                return Err(wrong(&field, reason));
            }
            reach = reach.max(far);
        }
        for (channel, taxel) in skin.channel_taxels().into_iter().enumerate() {
            let [x, y, z] = skin.taxels[taxel].position;
            // A micrometre is far below what a table resolves, and one table fewer.
            match layers.iter_mut().find(|l| (l.depth + z).abs() < 1e-6) {
                Some(layer) => layer.channels.push((channel, x, y)),
                None => layers.push(Layer { depth: -z, channels: vec![(channel, x, y)] }),
            }
        }
        Ok(Self {
            medium,
            surface: skin.surface(),
            layers,
            noise: skin.channel_noise(),
            reach: reach + OFF_SURFACE,
            tables: RwLock::default(),
        })
    }

    /// The medium.
    #[must_use]
    pub fn medium(&self) -> &Medium {
        &self.medium
    }

    fn tables(&self, index: usize, diameter: f64) -> Result<Arc<[PressureTable]>, ModelError> {
        let key = diameter.to_bits();
        // A table is inserted whole: a panic elsewhere leaves none half-made.
        if let Some(tables) = self.tables.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(Arc::clone(tables));
        }
        let tables = self
            .layers
            .iter()
            .map(|l| {
                PressureTable::sphere(
                    &self.medium,
                    diameter,
                    l.depth,
                    self.reach.min(100.0 * l.depth),
                    FORCE_MAX,
                )
            })
            .collect::<Result<Arc<[_]>, _>>()
            .map_err(|e| ModelError::Stimulus { index, reason: e.to_string() })?;
        let mut kept = self.tables.write().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= TABLES_MAX {
            kept.clear();
        }
        kept.insert(key, Arc::clone(&tables));
        Ok(tables)
    }
}

impl ForwardModel for BarometerModel {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Mean compressive stress at each taxel plus what the ambient pressure is above one standard atmosphere.
    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        debug_assert_eq!(out.len(), self.channels());
        out.fill(stimulus.ambient_pressure - STANDARD_ATMOSPHERE);
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let wrong = |reason: String| Err(ModelError::Stimulus { index, reason });
            let p = contact.position;
            if !p.iter().chain(contact.force.iter()).all(|v| v.is_finite()) {
                return wrong("its position or force is not a number".into());
            }
            let off = self.surface.distance(&p);
            if off > OFF_SURFACE {
                return wrong(format!("({}, {}, {}) m lies {off:.6} m off the surface", p.x, p.y, p.z));
            }
            let pressing = -contact.force.z;
            if pressing < 0.0 {
                return wrong(format!("it pulls with {} N, and this model knows no adhesion", -pressing));
            }
            if !DIAMETERS.contains(&contact.diameter) {
                let (low, high) = (DIAMETERS.start(), DIAMETERS.end());
                return wrong(format!(
                    "its diameter is {} m and must be {low} to {high} m",
                    contact.diameter
                ));
            }
            if pressing == 0.0 {
                continue;
            }
            let tables = self.tables(index, contact.diameter)?;
            for (layer, table) in self.layers.iter().zip(tables.iter()) {
                let profile = table.under(pressing);
                for &(channel, x, y) in &layer.channels {
                    let (dx, dy) = (p.x - x, p.y - y);
                    out[channel] += profile.pressure((dx * dx + dy * dy).sqrt());
                }
            }
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Indentation;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;
    use std::sync::LazyLock;

    const GRID: &str = include_str!("../../../launch/skins/baro-grid.toml");

    fn skin(from: &str, to: &str) -> SkinDescription {
        assert!(GRID.contains(from), "{from} is not in the file");
        SkinDescription::from_toml(&GRID.replace(from, to), "baro-grid.toml").unwrap()
    }

    static MODEL: LazyLock<BarometerModel> = LazyLock::new(|| BarometerModel::new(&skin("", "")).unwrap());

    fn press(x: f64, y: f64, force: f64) -> Indentation {
        Indentation {
            position: Point3::new(x, y, 0.0),
            force: Vector3::new(0.0, 0.0, -force),
            diameter: 0.004,
        }
    }

    fn read(model: &BarometerModel, contacts: Vec<Indentation>) -> Vec<f64> {
        let mut out = vec![f64::NAN; 25];
        model.response(&Stimulus { contacts, ..Stimulus::default() }, &mut out).unwrap();
        out
    }

    #[test]
    fn a_light_touch_overhead_reads_like_a_point_load() {
        let out = read(&MODEL, vec![press(0.0, 0.0, 0.001)]);
        // Point load on the bonded layer: 7.1 kPa/N straight above, c(0) = 0.141 N/kPa.
        approx::assert_relative_eq!(out[12] / 0.001, 1000.0 / 0.141, max_relative = 0.01);
    }

    #[test]
    fn untouched_reads_the_weather() {
        assert_eq!(read(&MODEL, vec![]), [0.0; 25]);
        let mut out = [0.0; 25];
        let storm = Stimulus { ambient_pressure: 99_325.0, ..Stimulus::default() };
        MODEL.response(&storm, &mut out).unwrap();
        assert_eq!(out, [-2000.0; 25]);
    }

    #[test]
    fn base_decides_the_sign_of_the_wings() {
        let wing = |base: &str| {
            let model = BarometerModel::new(&skin("base = \"bonded\"", base)).unwrap();
            // b02 is 20 mm away from (0, 0.007).
            read(&model, vec![press(0.0, 0.007, 0.1)])[2]
        };
        assert!(wing("base = \"bonded\"") > 0.0);
        assert!(wing("base = \"slip\"") < 0.0);
    }

    #[test]
    fn impossible_skins_are_refused_by_field() {
        let refused = |from: &str, to: &str| BarometerModel::new(&skin(from, to)).unwrap_err().to_string();
        insta::assert_snapshot!(refused("thickness = 0.010", "thickness = 0.004"), @"skin `baro-grid`: field `taxels[0].position`: z of `b00` is -0.005 m and must lie in the medium: below 0 and not below -0.004 m");
        insta::assert_snapshot!(refused("thickness = 0.010", "thicknes = 0.010"), @"skin `baro-grid`: field `medium.thicknes`: unknown field `thicknes`, expected one of `thickness`, `young_modulus`, `poisson_ratio`, `base`");
        insta::assert_snapshot!(refused("poisson_ratio = 0.49", ""), @"skin `baro-grid`: field `medium`: missing field `poisson_ratio`");
        insta::assert_snapshot!(refused("poisson_ratio = 0.49", "poisson_ratio = 0.5"), @"skin `baro-grid`: field `medium.poisson_ratio`: Poisson's ratio is 0.5 and must be between 0 and 0.4999");
        insta::assert_snapshot!(refused("base = \"bonded\"", "base = \"glued\""), @"skin `baro-grid`: field `medium.base`: unknown variant `glued`, expected `bonded` or `slip`");
        insta::assert_snapshot!(refused("[-0.0130, -0.0130, -0.005]", "[-0.0230, -0.0130, -0.005]"), @"skin `baro-grid`: field `taxels[0].position`: `b00` lies at (-0.023, -0.013) m, beside the surface of 0.034 m by 0.034 m");
        insta::assert_snapshot!(refused("[-0.0130, -0.0130, -0.005]", "[-0.0130, -0.0130, 0.005]"), @"skin `baro-grid`: field `taxels[0].position`: z of `b00` is 0.005 m and must lie in the medium: below 0 and not below -0.01 m");
        insta::assert_snapshot!(refused("[-0.0130, -0.0130, -0.005]", "[-0.0130, -0.0130, -0.0001]"), @"skin `baro-grid`: field `taxels[0].position`: `b00` is too near to the surface: it must be at least 0.000424 m deep");
        insta::assert_snapshot!(refused("unit = \"Pa\"", "unit = \"kPa\""), @r#"skin `baro-grid`: field `unit`: is "kPa" where barometers read "Pa""#);
        let dome = "type = \"dome\", radius = 0.01, cylinder = 0.016, spacing = 0.001";
        insta::assert_snapshot!(refused("type = \"rectangle\", size = [0.034, 0.034], spacing = 0.001", dome), @"skin `baro-grid`: field `surface.type`: this model knows a flat `rectangle` only");
    }

    #[test]
    fn impossible_stimuli_are_refused_by_contact() {
        let refused = |change: fn(&mut Indentation)| {
            let mut bad = press(0.0, 0.0, 0.5);
            change(&mut bad);
            let stimulus = Stimulus { contacts: vec![press(0.0, 0.0, 0.1), bad], ..Stimulus::default() };
            MODEL.response(&stimulus, &mut [0.0; 25]).unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused(|c| c.position.x = 0.020), @"contact 1: (0.02, 0, 0) m lies 0.003000 m off the surface");
        insta::assert_snapshot!(refused(|c| c.force.z = f64::NAN), @"contact 1: its position or force is not a number");
        insta::assert_snapshot!(refused(|c| c.force.z = 0.5), @"contact 1: it pulls with 0.5 N, and this model knows no adhesion");
        insta::assert_snapshot!(refused(|c| c.diameter = 0.0), @"contact 1: its diameter is 0 m and must be 0.0001 to 0.1 m");
    }

    #[test]
    fn a_diameter_is_tabulated_once() {
        let model = BarometerModel::new(&skin("", "")).unwrap();
        for diameter in [0.002, 0.003, 0.002] {
            read(&model, vec![Indentation { diameter, ..press(0.0, 0.0, 0.3) }]);
        }
        assert_eq!(model.tables.read().unwrap().len(), 2);
    }

    proptest! {
        #[test]
        fn every_channel_grows_with_the_force(
            x in -0.017..0.017f64, y in -0.017..0.017f64, force in 0.0..6.0f64, more in 0.001..1.0f64,
        ) {
            let (a, b) = (read(&MODEL, vec![press(x, y, force)]), read(&MODEL, vec![press(x, y, force + more)]));
            prop_assert!(a.iter().zip(&b).all(|(a, b)| b > a));
        }

        #[test]
        fn contacts_add_up(
            a in (-0.017..0.017f64, -0.017..0.017f64, 0.0..2.0f64), b in (-0.017..0.017f64, -0.017..0.017f64, 0.0..2.0f64),
        ) {
            let [a, b] = [a, b].map(|(x, y, f)| press(x, y, f));
            let both = read(&MODEL, vec![a.clone(), b.clone()]);
            let (a, b) = (read(&MODEL, vec![a]), read(&MODEL, vec![b]));
            for i in 0..25 {
                prop_assert!((both[i] - a[i] - b[i]).abs() < 1e-9 * (1.0 + both[i].abs()));
            }
        }

        #[test]
        fn the_grid_is_symmetric(x in -0.017..0.017f64, y in -0.017..0.017f64, force in 0.01..2.0f64) {
            let (a, b) = (read(&MODEL, vec![press(x, y, force)]), read(&MODEL, vec![press(-x, y, force)]));
            for row in 0..5 {
                for column in 0..5 {
                    let (p, q) = (a[5 * row + column], b[5 * row + 4 - column]);
                    prop_assert!((p - q).abs() < 1e-9 * (1.0 + p.abs()));
                }
            }
        }
    }
}
