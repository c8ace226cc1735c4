//! Readings of a sensor in a medium under a sphere, tabulated.

use crate::error::positive;
use crate::quadrature::panels;
use crate::{MechanicsError, Medium, SphereContact};

/// Contacts along the force axis.
const CONTACTS: usize = 48;
/// Distances per depth of the sensor: the field varies on the scale of its depth.
const PER_DEPTH: f64 = 16.0;
/// A layer's field has vanished at this many thicknesses (below 10⁻⁵ of its peak).
const REACH: f64 = 12.0;
/// Largest distance in depths: the table's size and the time to fill it grow with it and its square.
const SPAN: f64 = 100.0;

/// Mean compressive stress at one depth under a rigid sphere, over the distance from its axis and the force.
///
/// Values are stored per force, so that the table is nearly flat in force; they are interpolated by cubics over
/// distance and linearly over the contact's artanh(a/R). Above the largest tabulated force the reading grows in
/// proportion to the force; beyond twelve thicknesses of the layer it is 0.
#[derive(Debug, Clone)]
pub struct PressureTable {
    /// Cube roots of the forces \[N^(1/3)\], ascending from 0: the contact radius is linear in them at first.
    roots: Vec<f64>,
    /// \[Pa/N\], `roots.len()` rows of `columns`.
    values: Vec<f64>,
    columns: usize,
    step: f64,
}

/// A force's place in a table, found once and used for many distances.
#[derive(Debug, Clone, Copy)]
struct ForcePlace {
    row: usize,
    fraction: f64,
    force: f64,
}

/// The field of one force of a [`PressureTable`].
#[derive(Debug, Clone, Copy)]
pub struct Profile<'a> {
    table: &'a PressureTable,
    place: ForcePlace,
}

impl Profile<'_> {
    /// Mean compressive stress \[Pa\] at the distance `r` \[m\] from the axis.
    #[must_use]
    pub fn pressure(&self, r: f64) -> f64 {
        self.table.at(self.place, r)
    }
}

impl PressureTable {
    /// Tabulates a sphere of `diameter` \[m\], pressed with up to `force_max` \[N\], for a sensor at `depth`
    /// \[m\] and distances up to `distance_max` \[m\].
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the depth lies outside of the medium or a number is not positive.
    pub fn sphere(
        medium: &Medium,
        diameter: f64,
        depth: f64,
        distance_max: f64,
        force_max: f64,
    ) -> Result<Self, MechanicsError> {
        let radius = positive("diameter of the sphere [m]", diameter)? / 2.0;
        positive("largest distance [m]", distance_max)?;
        positive("largest force [N]", force_max)?;
        medium.check_depth(depth)?;

        let contact = |u: f64| SphereContact::new(medium, radius, radius * u.tanh());
        // u = artanh(a/R) grows with the force without bound; find the one that reaches the largest force.
        // At 8 the contact radius is the sphere's to seven digits and the indentation eight times that.
        let mut u_max = 0.05;
        while u_max < 8.0 && contact(u_max)?.force() < force_max {
            u_max *= 1.25;
        }
        let contacts = (1..=CONTACTS)
            .map(|i| contact(u_max * i as f64 / CONTACTS as f64))
            .collect::<Result<Vec<_>, _>>()?;

        let reach = distance_max.min(REACH * medium.thickness());
        if reach > SPAN * depth {
            return Err(MechanicsError::Value {
                quantity: "depth of the sensor [m]",
                value: depth,
                expected: "at least a hundredth of the distance that it shall feel",
            });
        }
        let step = depth / PER_DEPTH;
        // Two more than needed: a cubic takes a neighbour on either side.
        let columns = (reach / step).ceil() as usize + 3;
        let r_end = step * columns as f64;
        let nodes = panels(40.0 / depth, (6.0 / (r_end + radius)).min(3.0 / depth));
        let kernel: Vec<f64> = nodes.iter().map(|&(k, w)| w * k * medium.pressure_kernel(k, depth)).collect();

        // Row 0 is the point load that a vanishing contact is.
        let mut transforms = vec![vec![1.0 / std::f64::consts::TAU; nodes.len()]];
        transforms.extend(
            contacts.iter().map(|c| nodes.iter().map(|n| c.transform(n.0) / c.force()).collect::<Vec<_>>()),
        );
        let rows = transforms.len();
        let mut values = vec![0.0; rows * columns];
        let mut wave = vec![0.0; nodes.len()];
        for column in 0..columns {
            let r = step * column as f64;
            for ((v, &(k, _)), weight) in wave.iter_mut().zip(&nodes).zip(&kernel) {
                *v = weight * libm::j0(k * r);
            }
            for (row, transform) in transforms.iter().enumerate() {
                values[row * columns + column] = wave.iter().zip(transform).map(|(a, b)| a * b).sum();
            }
        }
        let roots = std::iter::once(0.0).chain(contacts.iter().map(|c| c.force().cbrt())).collect();
        Ok(Self { roots, values, columns, step })
    }

    /// Mean compressive stress \[Pa\] at the distance `r` \[m\] from the axis of a sphere that presses with
    /// `force` \[N\]; 0 for a force that does not press.
    #[must_use]
    pub fn pressure(&self, force: f64, r: f64) -> f64 {
        self.under(force).pressure(r)
    }

    /// \[N\] up to which the contact was solved.
    #[must_use]
    pub fn force_max(&self) -> f64 {
        self.roots.last().map_or(0.0, |r| r.powi(3))
    }

    /// The field of a sphere that presses with `force` \[N\]: finds the force's place in the table once, for
    /// many distances.
    #[must_use]
    pub fn under(&self, force: f64) -> Profile<'_> {
        Profile { table: self, place: self.place(force) }
    }

    fn place(&self, force: f64) -> ForcePlace {
        let force = if force > 0.0 { force } else { 0.0 };
        let root = force.cbrt();
        let last = self.roots.len() - 1;
        let row = self.roots.partition_point(|r| *r <= root).clamp(1, last) - 1;
        let fraction = ((root - self.roots[row]) / (self.roots[row + 1] - self.roots[row])).clamp(0.0, 1.0);
        ForcePlace { row, fraction, force }
    }

    fn at(&self, place: ForcePlace, r: f64) -> f64 {
        let x = r / self.step;
        // Also what is not a number, or negative, has no place in the table.
        if !(0.0..(self.columns - 2) as f64).contains(&x) {
            return 0.0;
        }
        let i = x as usize;
        let t = x - i as f64;
        // Catmull-Rom weights; the field is even in r, which gives the neighbour left of the axis.
        let weights = [
            ((2.0 - t) * t - 1.0) * t * 0.5,
            ((3.0 * t - 5.0) * t * t + 2.0) * 0.5,
            ((4.0 - 3.0 * t) * t + 1.0) * t * 0.5,
            (t - 1.0) * t * t * 0.5,
        ];
        let left = if i == 0 { 1 } else { i - 1 };
        let along = |row: usize| {
            let v = &self.values[row * self.columns..(row + 1) * self.columns];
            weights[0] * v[left] + weights[1] * v[i] + weights[2] * v[i + 1] + weights[3] * v[i + 2]
        };
        let (low, high) = (along(place.row), along(place.row + 1));
        place.force * (low + place.fraction * (high - low))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Base, Load};
    use proptest::prelude::*;
    use std::sync::LazyLock;

    static PAD: LazyLock<Medium> = LazyLock::new(|| Medium::layer(70e3, 0.49, 0.010, Base::Bonded).unwrap());
    static TABLE: LazyLock<PressureTable> =
        LazyLock::new(|| PressureTable::sphere(&PAD, 0.004, 0.005, 0.05, 2.0).unwrap());

    #[test]
    fn table_agrees_with_the_integral() {
        let (depth, medium) = (0.005, *PAD);
        for u in [0.111, 0.4, 0.93, 1.7] {
            let contact = SphereContact::new(&medium, 0.002, 0.002 * f64::tanh(u)).unwrap();
            let peak = TABLE.pressure(contact.force(), 0.0);
            for r in [0.0, 0.00117, 0.0052, 0.0131, 0.0333] {
                let exact: f64 = panels(40.0 / depth, 50.0)
                    .iter()
                    .map(|&(k, w)| {
                        w * k * medium.pressure_kernel(k, depth) * contact.transform(k) * libm::j0(k * r)
                    })
                    .sum();
                let found = TABLE.pressure(contact.force(), r);
                assert!((found - exact).abs() < 5e-4 * peak, "u={u} r={r}: {found} for {exact}");
            }
        }
    }

    #[test]
    fn a_light_touch_reads_like_a_point_load() {
        for r in [0.0, 0.004, 0.010, 0.020] {
            let exact = PAD.pressure(&Load::Point { force: 1e-6 }, 0.005, r).unwrap();
            let found = TABLE.pressure(1e-6, r);
            assert!((found - exact).abs() < 2e-3 * exact, "r={r}: {found} for {exact}");
        }
    }

    #[test]
    fn the_field_has_vanished_where_the_table_ends() {
        let table = PressureTable::sphere(&PAD, 0.004, 0.005, 1.0, 1.0).unwrap();
        let end = 0.9999 * 12.0 * 0.010;
        let (last, peak) = (table.pressure(1.0, end), table.pressure(1.0, 0.0));
        assert!(last.abs() < 1e-5 * peak, "{last} of {peak}");
        assert_eq!(table.pressure(1.0, 0.2), 0.0);
    }

    proptest! {
        #[test]
        fn more_force_reads_more(force in 0.0..4.0f64, more in 1e-3..1.0f64, r in 0.0..0.03f64) {
            prop_assert!(TABLE.pressure(force + more, r) > TABLE.pressure(force, r));
        }

        #[test]
        fn further_away_reads_less(force in 0.001..4.0f64, r in 0.0..0.04f64, further in 1e-4..1e-2f64) {
            prop_assert!(TABLE.pressure(force, r + further) < TABLE.pressure(force, r));
        }

        #[test]
        fn no_question_panics(force in any::<f64>(), r in any::<f64>()) {
            let _ = TABLE.pressure(force, r);
        }
    }
}
