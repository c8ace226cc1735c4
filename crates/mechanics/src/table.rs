//! Readings of a sensor in a medium under a sphere, tabulated.

use dermis_skin::cache::{Bytes, Keep};
use nalgebra::DMatrix;

use crate::contact::DEEPEST;
use crate::error::positive;
use crate::quadrature::panels;
use crate::{MechanicsError, Medium, SphereContact};

/// Contacts along the force axis.
const CONTACTS: usize = 48;
/// Distances per depth of the sensor: the field varies on the scale of its depth.
const PER_DEPTH: f64 = 20.0;
/// A layer's field has vanished at this many thicknesses (below 10⁻⁵ of its peak).
const REACH: f64 = 12.0;
/// Share of a layer's thickness that a tip may sink in.
const DEPTH_MAX: f64 = 0.9;
/// Largest distance in depths: the table's size and the time to fill it grow with it and its square.
const SPAN: f64 = 100.0;

/// Contacts of one rigid sphere with a medium, from the lightest touch up: what tables at any depth are computed from.
#[derive(Debug, Clone)]
pub struct SphereContacts {
    medium: Medium,
    radius: f64,
    contacts: Vec<SphereContact>,
}

impl SphereContacts {
    /// Solves the contacts of a sphere of `diameter` \[m\] that is pressed with up to `force_max` \[N\].
    ///
    /// # Errors
    ///
    /// [`MechanicsError::Value`] where a number is not positive.
    pub fn new(medium: &Medium, diameter: f64, force_max: f64) -> Result<Self, MechanicsError> {
        let radius = positive("diameter of the sphere [m]", diameter)? / 2.0;
        positive("largest force [N]", force_max)?;
        let contact = |u: f64| SphereContact::new(medium, radius, radius * u.tanh());
        // u = artanh(a/R) grows with the force without bound; find the one that reaches the largest force.
        let mut u_max = 0.05;
        while u_max < DEEPEST && contact(u_max)?.force() < force_max {
            u_max *= 1.25;
        }
        let contacts = (1..=CONTACTS)
            .map(|i| contact(u_max * i as f64 / CONTACTS as f64))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self { medium: *medium, radius, contacts })
    }

    /// \[N\] that press the sphere in by `depth` \[m\], 0 above the surface; `None` beyond the largest requested
    /// force, and where so little is left of a layer that small strains say nothing.
    #[must_use]
    pub fn force_at(&self, depth: f64) -> Option<f64> {
        if depth.is_nan() || depth > DEPTH_MAX * self.medium.thickness() {
            return None;
        }
        let at = |c: &SphereContact| (c.indentation(), c.force().powf(2.0 / 3.0));
        self.between(depth, at).map(|root| root.powf(1.5))
    }

    /// \[m\] that the sphere sinks in when it presses with `force` \[N\]: the inverse of [`force_at`](Self::force_at).
    #[must_use]
    pub fn depth_at(&self, force: f64) -> Option<f64> {
        if force.is_nan() {
            return None;
        }
        let at = |c: &SphereContact| (c.force().powf(2.0 / 3.0), c.indentation());
        let depth = self.between(force.max(0.0).powf(2.0 / 3.0), at)?;
        (depth <= DEPTH_MAX * self.medium.thickness()).then_some(depth)
    }

    /// y at `x` where contacts are points (x, y) of a rising curve from the origin. A light touch is Hertz's, whose depth is
    /// linear in the force to 2/3: between contacts that is what is interpolated.
    fn between(&self, x: f64, at: impl Fn(&SphereContact) -> (f64, f64)) -> Option<f64> {
        if x <= 0.0 {
            return Some(0.0);
        }
        let after = self.contacts.partition_point(|c| at(c).0 < x);
        let (x1, y1) = at(self.contacts.get(after)?);
        let (x0, y0) = after.checked_sub(1).map_or((0.0, 0.0), |before| at(&self.contacts[before]));
        Some(y0 + (y1 - y0) * (x - x0) / (x1 - x0))
    }
}

/// Mean compressive stress at one depth under a rigid sphere, over the distance from its axis and the force.
///
/// The shear traction under a sphere that is dragged along the surface is taken as its pressure times the ratio of both
/// forces: full friction, up to where the sphere slides. That traction is taken to leave the contact as it is.
///
/// Values are stored per force, so that the table is nearly flat in force; they are interpolated by cubics over
/// distance and linearly over the contact's artanh(a/R). Above the largest tabulated force the reading grows in
/// proportion to the force; beyond twelve thicknesses of a layer on a base that holds it is 0.
#[derive(Debug, Clone)]
pub struct PressureTable {
    /// Cube roots of the forces \[N^(1/3)\], ascending from 0: the contact radius is linear in them at first.
    roots: Vec<f64>,
    /// Radius \[m\] and share of the force of the [ring](SphereContact::ring) that stands for each contact.
    rings: Vec<[f64; 2]>,
    /// \[Pa/N\] of pressing force, `roots.len()` rows of `columns`.
    normal: Vec<Cubic>,
    /// \[Pa/N\] of shear force, straight ahead; as many.
    shear: Vec<Cubic>,
    columns: usize,
    /// [1/m] columns per distance.
    density: f64,
}

/// Coefficients of a cubic over one column, from the constant up: what a look-up needs lies side by side.
type Cubic = [f64; 4];

/// Catmull-Rom's cubics through `values` at equal distances from the axis on; the last two only bound. `parity` is 1 for a
/// field that is even in the distance, −1 for an odd one.
fn cubics(values: &[f64], parity: f64) -> impl Iterator<Item = Cubic> {
    (0..values.len() - 2).map(move |i| {
        let left = if i == 0 { parity * values[1] } else { values[i - 1] };
        let [a, b, c] = [values[i], values[i + 1], values[i + 2]];
        [a, (b - left) * 0.5, left - 2.5 * a + 2.0 * b - 0.5 * c, 1.5 * (a - b) + 0.5 * (c - left)]
    })
}

/// A force's place in a table, found once and used for many distances.
#[derive(Debug, Clone, Copy)]
struct ForceIndex {
    row: usize,
    fraction: f64,
    force: f64,
}

/// The field of one force of a [`PressureTable`].
#[derive(Debug, Clone, Copy)]
pub struct Profile<'a> {
    table: &'a PressureTable,
    place: ForceIndex,
}

impl Profile<'_> {
    /// The [ring](SphereContact::ring) that stands for the contact: its radius \[m\] and its share of the force.
    #[must_use]
    pub fn ring(&self) -> (f64, f64) {
        let ForceIndex { row, fraction, .. } = self.place;
        let [low, high] = [row, row + 1].map(|row| self.table.rings[row]);
        let between = |k: usize| low[k] + fraction * (high[k] - low[k]);
        (between(0), between(1))
    }

    /// Mean compressive stress \[Pa\] at the distance `r` \[m\] from the axis.
    #[inline]
    #[must_use]
    pub fn pressure(&self, r: f64) -> f64 {
        self.place.force * self.table.at(&self.table.normal, self.place, r)
    }

    /// Mean compressive stress \[Pa\] per newton of shear force on the surface, at the distance `r` \[m\] from the axis
    /// straight ahead; at the angle θ from the force's direction it is cos θ of that.
    #[inline]
    #[must_use]
    pub fn shear(&self, r: f64) -> f64 {
        self.table.at(&self.table.shear, self.place, r)
    }
}

impl Keep for PressureTable {
    fn put(&self, out: &mut Vec<u8>) {
        self.roots.put(out);
        for part in [&self.normal, &self.shear] {
            part.as_flattened().to_vec().put(out);
        }
        (self.columns as u64).put(out);
        self.density.put(out);
        self.rings.as_flattened().to_vec().put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let roots = Vec::<f64>::take(from)?;
        let mut part = || -> Option<Vec<Cubic>> {
            let flat = Vec::<f64>::take(from)?;
            let (cubics, rest) = flat.as_chunks();
            rest.is_empty().then(|| cubics.to_vec())
        };
        let (normal, shear) = (part()?, part()?);
        let columns = usize::try_from(u64::take(from)?).ok()?;
        let fits = |part: &[Cubic]| roots.len().checked_mul(columns) == Some(part.len());
        let whole = roots.len() >= 2 && columns > 0 && fits(&normal) && fits(&shear);
        let density = f64::take(from)?;
        let flat = Vec::<f64>::take(from)?;
        let (rings, rest) = flat.as_chunks();
        let whole = whole && rings.len() == roots.len() && rest.is_empty();
        whole.then(|| Self { rings: rings.to_vec(), roots, normal, shear, columns, density })
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
        Self::new(&SphereContacts::new(medium, diameter, force_max)?, depth, distance_max)
    }

    /// Tabulates what a sensor at `depth` \[m\] feels of `contacts` at distances up to `distance_max` \[m\].
    ///
    /// # Errors
    ///
    /// [`MechanicsError`] where the depth lies outside of the medium or the distance is not positive.
    pub fn new(contacts: &SphereContacts, depth: f64, distance_max: f64) -> Result<Self, MechanicsError> {
        let SphereContacts { medium, radius, contacts } = contacts;
        positive("largest distance [m]", distance_max)?;
        medium.check_depth(depth)?;
        // What shear does to a layer that slips falls off as 1/r only: the layer is a sheet that is pulled.
        let reach =
            if medium.slip() > 0.0 { distance_max } else { distance_max.min(REACH * medium.thickness()) };
        if reach > SPAN * depth {
            return Err(MechanicsError::Value {
                quantity: "depth of the sensor [m]",
                value: depth,
                expected: "at least a hundredth of the distance that it shall feel",
            });
        }
        let step = depth / PER_DEPTH;
        let columns = (reach / step).ceil() as usize + 1;
        // Two more than needed: a cubic takes a neighbour on either side.
        let knots = columns + 2;
        let r_end = step * knots as f64;
        let nodes = panels(40.0 / depth, (6.0 / (r_end + radius)).min(3.0 / depth));
        // Row 0 is the point load that a vanishing contact is.
        let rows = 1 + contacts.len();
        let transform = DMatrix::from_fn(rows, nodes.len(), |row, q| match row.checked_sub(1) {
            None => 1.0 / std::f64::consts::TAU,
            Some(i) => contacts[i].transform(nodes[q].0) / contacts[i].force(),
        });
        let kernels: Vec<[f64; 2]> =
            nodes.iter().map(|&(k, w)| medium.kernels(k, depth).map(|kernel| w * k * kernel)).collect();
        let field = |part: usize, bessel: fn(f64) -> f64, parity: f64| -> Vec<Cubic> {
            let waves = DMatrix::from_fn(nodes.len(), knots, |q, knot| {
                kernels[q][part] * bessel(nodes[q].0 * step * knot as f64)
            });
            // Column-major of the transpose is row-major.
            let values = (&transform * waves).transpose();
            values.as_slice().chunks_exact(knots).flat_map(|row| cubics(row, parity)).collect()
        };
        let (normal, shear) = (field(0, libm::j0, 1.0), field(1, libm::j1, -1.0));
        let roots = std::iter::once(0.0).chain(contacts.iter().map(|c| c.force().cbrt())).collect();
        // A vanishing contact is a light one, Hertz's.
        let rings = std::iter::once([0.0, 0.7]).chain(contacts.iter().map(|c| c.ring().into())).collect();
        Ok(Self { roots, rings, normal, shear, columns, density: 1.0 / step })
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

    fn place(&self, force: f64) -> ForceIndex {
        let force = if force > 0.0 { force } else { 0.0 };
        let root = force.cbrt();
        let last = self.roots.len() - 1;
        let row = self.roots.partition_point(|r| *r <= root).clamp(1, last) - 1;
        let fraction = ((root - self.roots[row]) / (self.roots[row + 1] - self.roots[row])).clamp(0.0, 1.0);
        ForceIndex { row, fraction, force }
    }

    /// Value of `cubics` per newton at the distance `r`.
    #[inline]
    fn at(&self, cubics: &[Cubic], place: ForceIndex, r: f64) -> f64 {
        let x = r * self.density;
        // Also what is not a number, or negative, has no place in the table.
        if !(0.0..self.columns as f64).contains(&x) {
            return 0.0;
        }
        // By way of 32 bits, which x86 converts to in fewer steps; a table has no more columns than that.
        let column = x as u32 as usize;
        let t = x - column as f64;
        let at = place.row * self.columns + column;
        let (low, high) = (&cubics[at], &cubics[at + self.columns]);
        let coefficient = |i: usize| low[i] + place.fraction * (high[i] - low[i]);
        ((coefficient(3) * t + coefficient(2)) * t + coefficient(1)) * t + coefficient(0)
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
        let depth = 0.005;
        for (diameter, slip) in [(0.002, 0.0), (0.004, 0.0), (0.012, 0.0), (0.004, 0.3)] {
            let medium = Medium::mixed(70e3, 0.49, 0.010, slip).unwrap();
            let table = PressureTable::sphere(&medium, diameter, depth, 0.05, 5.0).unwrap();
            let waves: Vec<(f64, [f64; 2])> = panels(40.0 / depth, 120.0)
                .iter()
                .map(|&(k, w)| (k, medium.kernels(k, depth).map(|s| w * k * s)))
                .collect();
            // Contacts that are not rows.
            for u in [0.029f64, 0.211, 0.47, 0.86, 1.31, 2.17] {
                let radius = diameter / 2.0;
                let contact = SphereContact::new(&medium, radius, radius * u.tanh()).unwrap();
                if contact.force() > table.force_max() {
                    break;
                }
                let profile = table.under(contact.force());
                let loads: Vec<f64> = waves.iter().map(|(k, _)| contact.transform(*k)).collect();
                let (mut peaks, mut errors) = ([0.0f64; 2], [0.0f64; 2]);
                for r in (0..60).map(|i| 0.000_577 * f64::from(i)) {
                    let exact = waves.iter().zip(&loads).fold([0.0; 2], |sum, (&(k, s), load)| {
                        [sum[0] + s[0] * load * libm::j0(k * r), sum[1] + s[1] * load * libm::j1(k * r)]
                    });
                    let found = [profile.pressure(r), profile.shear(r) * contact.force()];
                    for i in 0..2 {
                        peaks[i] = peaks[i].max(exact[i].abs());
                        errors[i] = errors[i].max((found[i] - exact[i]).abs());
                    }
                }
                for i in 0..2 {
                    let share = errors[i] / peaks[i];
                    assert!(share < 5e-4, "{diameter} m, slip {slip}, {} N, {i}: {share}", contact.force());
                }
            }
        }
    }

    #[test]
    fn shear_of_a_light_touch_is_that_of_a_point() {
        let one = Load::Point { force: 1.0 };
        let light = TABLE.under(1e-6);
        for r in [0.0, 0.0001, 0.002, 0.010, 0.020] {
            let exact = PAD.pressure_of_shear(&one, 0.005, r).unwrap();
            assert!((light.shear(r) - exact).abs() < 2.0, "r={r}: {} for {exact} Pa/N", light.shear(r));
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
    fn depth_and_force_are_each_others_inverse_and_those_of_the_contact() {
        let contacts = SphereContacts::new(&PAD, 0.004, 2.0).unwrap();
        for depth in [1e-5, 2e-4, 1.2e-3, 2.4e-3, 3.6e-3] {
            let force = contacts.force_at(depth).unwrap();
            let exact = SphereContact::at_indentation(&PAD, 0.002, depth).unwrap().force();
            assert!((force - exact).abs() < 1e-3 * exact, "{depth} m: {force} N for {exact} N");
            assert!((contacts.depth_at(force).unwrap() - depth).abs() < 1e-9 * depth);
        }
        assert_eq!((contacts.force_at(-1e-3), contacts.depth_at(0.0)), (Some(0.0), Some(0.0)));
        assert_eq!((contacts.force_at(0.0095), contacts.force_at(f64::NAN)), (None, None));
        assert_eq!((contacts.depth_at(1e3), contacts.depth_at(f64::NAN)), (None, None));
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
