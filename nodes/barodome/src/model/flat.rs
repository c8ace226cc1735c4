//! A flat layer of elastomer, as wide as it likes.
//!
//! The layer is of uniform thickness on a rigid base, and goes on beyond the surface that can be pressed: what an edge does
//! to a press within about one thickness of it is left out. Each press is solved as the contact of a rigid sphere with the
//! layer ([`dermis_mechanics::SphereContact`]). Strains are taken as small, which a soft pad outgrows: at 1 N a 4 mm tip
//! already sinks 3 mm into 10 mm of a 70 kPa elastomer, where a real one stiffens.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use dermis_mechanics::{Base, Medium, PressureTable};
use dermis_skin::{Indentation, ModelError, SkinDescription};

use super::{Field, OFF_SURFACE, refusal};
use crate::parameters::Parameters;

/// \[N\] up to which contacts are solved; readings grow in proportion to the force beyond.
const FORCE_MAX: f64 = 5.0;
/// Diameters whose tables are kept.
const TABLES_MAX: usize = 32;

/// Channels at one depth.
#[derive(Debug, Clone)]
struct Layer {
    depth: f64,
    /// Channel and where it lies along the surface \[m\].
    channels: Vec<(usize, f64, f64)>,
}

/// Mean compressive stress in a flat layer.
#[derive(Debug)]
pub(super) struct Flat {
    medium: Medium,
    layers: Vec<Layer>,
    /// Largest distance along the surface between a place that can be pressed and a taxel \[m\].
    reach: f64,
    /// Bits of a diameter → one table a layer.
    tables: RwLock<BTreeMap<u64, Arc<[PressureTable]>>>,
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
        let base = if parameters.slip > 0.0 { Base::Slip } else { Base::Bonded };
        let medium = Medium::layer(parameters.young_modulus, parameters.poisson_ratio, thickness, base)
            .map_err(|e| refusal(skin, "medium", e.to_string()))?;
        let [half_x, half_y] = size.map(|s| s / 2.0);
        let (mut layers, mut reach): (Vec<Layer>, f64) = (Vec::new(), 0.0);
        for ((channel, element), taxel) in parameters.elements.iter().enumerate().zip(skin.channel_taxels()) {
            let [x, y, z] = [element.position.x, element.position.y, element.position.z];
            let name = &skin.taxels[taxel].name;
            let wrong = |reason: String| refusal(skin, &format!("taxels[{taxel}].position"), reason);
            if !(z < 0.0 && -z <= thickness) {
                return Err(wrong(format!(
                    "z of `{name}` is {z} m and must lie in the medium: below 0 and not below -{thickness} m"
                )));
            }
            // As designed: an effect may move it beyond a surface that is only what is pressed of the elastomer.
            let [x0, y0, _] = skin.taxels[taxel].position;
            if x0.abs() > half_x || y0.abs() > half_y {
                return Err(wrong(format!(
                    "`{name}` lies at ({x0}, {y0}) m, beside the surface of {} m by {} m",
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
            // A micrometre is far below what a table resolves, and one table fewer.
            match layers.iter_mut().find(|l| (l.depth + z).abs() < 1e-6) {
                Some(layer) => layer.channels.push((channel, x, y)),
                None => layers.push(Layer { depth: -z, channels: vec![(channel, x, y)] }),
            }
        }
        Ok(Self { medium, layers, reach: reach + OFF_SURFACE, tables: RwLock::default() })
    }

    fn tables(&self, index: usize, diameter: f64) -> Result<Arc<[PressureTable]>, ModelError> {
        let key = diameter.to_bits();
        // A table is inserted whole: a panic elsewhere leaves none half-made.
        if let Some(tables) = self.tables.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(Arc::clone(tables));
        }
        let table = |l: &Layer| {
            PressureTable::sphere(&self.medium, diameter, l.depth, self.reach.min(100.0 * l.depth), FORCE_MAX)
        };
        let tables = self
            .layers
            .iter()
            .map(table)
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

impl Field for Flat {
    fn add(&self, index: usize, contact: &Indentation, out: &mut [f64]) -> Result<(), ModelError> {
        let tables = self.tables(index, contact.diameter)?;
        let p = contact.position;
        for (layer, table) in self.layers.iter().zip(tables.iter()) {
            let profile = table.under(-contact.force.z);
            for &(channel, x, y) in &layer.channels {
                let (dx, dy) = (p.x - x, p.y - y);
                out[channel] += profile.pressure((dx * dx + dy * dy).sqrt());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    const GRID: &str = include_str!("../../../../launch/skins/baro-grid.toml");

    fn flat() -> Flat {
        let skin = SkinDescription::from_toml(GRID, "baro-grid.toml").unwrap();
        Flat::new(&skin, &Parameters::nominal(&skin).unwrap(), [0.034; 2]).unwrap()
    }

    #[test]
    fn a_diameter_is_tabulated_once() {
        let flat = flat();
        for diameter in [0.002, 0.003, 0.002] {
            let contact =
                Indentation { position: Point3::origin(), force: Vector3::new(0.0, 0.0, -0.3), diameter };
            flat.add(0, &contact, &mut [0.0; 25]).unwrap();
        }
        assert_eq!(flat.tables.read().unwrap().len(), 2);
    }
}
