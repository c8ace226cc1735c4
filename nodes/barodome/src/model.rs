//! Forward model: what barometers in an elastomer read when spheres press on it.
//!
//! A barometer molded into an elastomer reads the mean compressive stress at its port. What is computed here is linear
//! elastic: several presses add up, and every shape of skin has its own [`Field`]. What all of them share stands here: which
//! contacts there can be, gauge pressure (0 when untouched at one standard atmosphere), the gain of a sensing element, and
//! what its package does to a contact above it.

mod bore;
mod dome;
mod flat;
mod rim;
mod sink;

use dermis_model::{DeviceState, ForwardModel, Indentation, Stepped, Stimulus};
use dermis_skin::{ModelError, SkinDescription, Surface, SurfaceSpec};
use nalgebra::{Point3, Vector3};

use crate::effects::{self, Dynamics};
use crate::parameters::Parameters;

/// \[Pa\] that gauge pressures are relative to.
const STANDARD_ATMOSPHERE: f64 = 101_325.0;
/// Mean compressive stress that one contact makes at every sensing element.
trait Field: std::fmt::Debug + Send + Sync {
    /// Adds the stress \[Pa\] under `contact` to `out`, one number a channel. The contact has been checked: its numbers are
    /// finite, it lies on the surface and presses, and the theory can speak of its diameter. `index` is its place in the
    /// stimulus.
    ///
    /// # Errors
    ///
    /// [`ModelError::Stimulus`] for a contact that this field has no answer to.
    fn add(&self, index: usize, contact: &Indentation, out: &mut [f64]) -> Result<(), ModelError>;
}

/// Packages under the surface, each of which makes the elastomer above it stiffer.
#[derive(Debug)]
struct Packages {
    /// Where each lies \[m\] and what is up for it.
    locations: Vec<(Point3<f64>, Vector3<f64>)>,
    stiffening: f64,
    reach: f64,
}

impl Packages {
    /// Modulus that a contact at `point` feels, relative to the elastomer's own.
    fn stiffness(&self, point: &Point3<f64>) -> f64 {
        let rise = |(location, up): &(Point3<f64>, Vector3<f64>)| {
            let offset = point - location;
            let above = offset.dot(up);
            // What lies below a package is the other side of a skin that is not flat.
            if above < 0.0 {
                0.0
            } else {
                (-(offset - up * above).norm_squared() / (2.0 * self.reach.powi(2))).exp()
            }
        };
        1.0 + self.stiffening * self.locations.iter().map(rise).sum::<f64>()
    }
}

/// Barometers in an elastomer: readings \[Pa\] for spherical tips that press on it.
///
/// The field of each tip's diameter is tabulated when it first presses (a fraction of a second) and kept; after
/// that a press costs a few nanoseconds a channel.
#[derive(Debug)]
pub struct BarometerModel {
    surface: Surface,
    field: Box<dyn Field>,
    gains: Vec<f64>,
    noise: Vec<f64>,
    diameter_scale: f64,
    /// Where they stiffen anything.
    packages: Option<Packages>,
    sink: sink::Sink,
    dynamics: Dynamics,
}

impl BarometerModel {
    /// The model of a skin whose `medium` names `thickness` \[m\], `young_modulus` \[Pa\], `poisson_ratio`, `base`
    /// (`"bonded"`, the default, `"slip"`, or a share of slip from 0 to 1) and `edge` (`"wide"`, the default, or `"free"`); or a
    /// `bore` through it.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] names the field that is missing, unknown or impossible, effects included.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let mut parameters = Parameters::nominal(skin)?;
        effects::shape(skin, &mut parameters)?;
        Self::from_parameters(skin, &parameters)
    }

    fn from_parameters(skin: &SkinDescription, parameters: &Parameters) -> Result<Self, ModelError> {
        let field: Box<dyn Field> = match parameters.surface {
            SurfaceSpec::Rectangle { size, .. } => match parameters.bore {
                Some(spec) => Box::new(bore::Bore::new(skin, parameters, spec)?),
                None => Box::new(flat::Flat::new(skin, parameters, size)?),
            },
            SurfaceSpec::Dome { radius, cylinder, .. } => {
                Box::new(dome::Dome::new(skin, parameters, radius, cylinder)?)
            }
            SurfaceSpec::Panel { .. } | SurfaceSpec::Mesh { .. } | SurfaceSpec::Family(_) => {
                return Err(skin.refusal(
                    "surface.type",
                    "is none that this sensor's model knows: rectangle or dome".into(),
                ));
            }
        };
        let packages = (parameters.stiffening != 0.0).then(|| {
            let mut locations: Vec<(Point3<f64>, Vector3<f64>)> = Vec::new();
            for element in &parameters.elements {
                // Channels of one taxel share its package.
                if locations.iter().all(|(location, _)| *location != element.position) {
                    locations.push((element.position, element.normal));
                }
            }
            Packages { locations, stiffening: parameters.stiffening, reach: parameters.stiffening_reach }
        });
        Ok(Self {
            surface: Surface::from_spec(&parameters.surface),
            field,
            gains: parameters.elements.iter().map(|e| e.gain).collect(),
            noise: skin.channel_noise(),
            diameter_scale: parameters.diameter_scale,
            packages,
            sink: sink::Sink::new(skin, parameters)?,
            dynamics: Dynamics::new(skin)?,
        })
    }

    /// Modulus that a contact at `point` feels, relative to the elastomer's own.
    fn stiffness(&self, point: &Point3<f64>) -> f64 {
        self.packages.as_ref().map_or(1.0, |packages| packages.stiffness(point))
    }

    /// Adds what one contact that has been checked does to the stress at every element.
    fn add(&self, index: usize, contact: &Indentation, out: &mut [f64]) -> Result<(), ModelError> {
        let Some(packages) = &self.packages else { return self.field.add(index, contact, out) };
        // All is linear in stress: under the force F, a medium that is c times as stiff has c times the field that this one
        // has under F/c.
        let stiffness = packages.stiffness(&contact.position);
        let softer = Indentation { force: contact.force / stiffness, ..contact.clone() };
        let mut field = vec![0.0; out.len()];
        self.field.add(index, &softer, &mut field)?;
        for (o, f) in out.iter_mut().zip(&field) {
            *o += stiffness * f;
        }
        Ok(())
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
        assert_eq!(out.len(), self.channels());
        out.fill(0.0);
        for (index, contact) in stimulus.contacts.iter().enumerate() {
            let normal = contact.check(index, &self.surface)?;
            let pressing = -contact.force.dot(&normal);
            if pressing == 0.0 {
                continue;
            }
            if self.diameter_scale == 1.0 {
                self.add(index, contact, out)?;
            } else {
                let diameter = contact.diameter() * self.diameter_scale;
                self.add(index, &contact.clone().with_diameter(diameter), out)?;
            }
        }
        let ambient = stimulus.ambient_pressure - STANDARD_ATMOSPHERE;
        for (value, gain) in out.iter_mut().zip(&self.gains) {
            *value = *value * gain + ambient;
        }
        Ok(())
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    fn start(&self, seed: u64) -> Box<dyn DeviceState + '_> {
        Box::new(Stepped::new(self, self.dynamics.start(seed)))
    }

    /// Of a layer as wide as it likes, on which the curvature of a skin makes a tip sharper; edges have no effect.
    fn force_at(&self, at: &Point3<f64>, diameter: f64, depth: f64) -> Option<f64> {
        let contacts = self.sink.contacts(at, diameter * self.diameter_scale)?;
        contacts.force_at(depth).map(|force| force * self.stiffness(at))
    }

    fn depth_at(&self, at: &Point3<f64>, diameter: f64, force: f64) -> Option<f64> {
        let contacts = self.sink.contacts(at, diameter * self.diameter_scale)?;
        contacts.depth_at(force / self.stiffness(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_model::Indentation;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;
    use std::sync::LazyLock;

    const GRID: &str = include_str!("../../../launch/skins/baro-grid.toml");

    /// The grid without its edges, and with something replaced.
    fn skin(from: &str, to: &str) -> SkinDescription {
        let wide = GRID.replace("edge = \"free\"", "");
        assert!(wide.contains(from), "{from} is not in the file");
        SkinDescription::from_toml(&wide.replace(from, to), "baro-grid.toml").unwrap()
    }

    static MODEL: LazyLock<BarometerModel> = LazyLock::new(|| BarometerModel::new(&skin("", "")).unwrap());

    fn press(x: f64, y: f64, force: f64) -> Indentation {
        Indentation::sphere(Point3::new(x, y, 0.0), Vector3::new(0.0, 0.0, -force), 0.004)
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

    fn changed(change: impl FnOnce(&mut Parameters)) -> BarometerModel {
        let skin = skin("", "");
        let mut parameters = Parameters::nominal(&skin).unwrap();
        change(&mut parameters);
        BarometerModel::from_parameters(&skin, &parameters).unwrap()
    }

    #[test]
    fn gain_multiplies_stress_but_not_the_weather() {
        let model = changed(|p| p.elements[12].gain = 1.3);
        let contacts = vec![press(0.0, 0.0, 0.4), press(0.01, 0.0, 0.2)];
        let (plain, gained) = (read(&MODEL, contacts.clone()), read(&model, contacts.clone()));
        approx::assert_relative_eq!(gained[12], 1.3 * plain[12], max_relative = 1e-12);
        assert_eq!(gained[11], plain[11]);
        let mut stormy = [0.0; 25];
        model
            .response(&Stimulus { contacts, ambient_pressure: 101_225.0, ..Stimulus::default() }, &mut stormy)
            .unwrap();
        approx::assert_relative_eq!(stormy[12], gained[12] - 100.0, max_relative = 1e-12);
    }

    #[test]
    fn stiffening_all_over_is_a_stiffer_medium() {
        // Packages that reach everywhere: 25 of them make it twice as stiff.
        let packages = changed(|p| (p.stiffening, p.stiffening_reach) = (1.0 / 25.0, 1e3));
        let medium = changed(|p| p.young_modulus *= 2.0);
        let contacts = vec![Indentation { force: Vector3::new(0.2, 0.1, -1.0), ..press(0.004, -0.009, 1.0) }];
        let (a, b) = (read(&packages, contacts.clone()), read(&medium, contacts.clone()));
        for (a, b) in a.iter().zip(&b) {
            // Their tables have other rows.
            approx::assert_relative_eq!(a, b, max_relative = 2e-4);
        }
        assert!((a[8] / read(&MODEL, contacts)[8] - 1.0).abs() > 1e-3);
    }

    #[test]
    fn stiffening_fades_beside_a_package() {
        let model = changed(|p| (p.stiffening, p.stiffening_reach) = (0.5, 0.001));
        let ratio =
            |x: f64| read(&model, vec![press(x, 0.0, 2.0)])[12] / read(&MODEL, vec![press(x, 0.0, 2.0)])[12];
        let [above, beside] = [0.0, 0.00325].map(ratio);
        assert!(above > 1.005 && (beside - 1.0).abs() < 0.1 * (above - 1.0), "{above}, {beside}");
    }

    #[test]
    fn scaled_tips_are_other_tips() {
        let model = changed(|p| p.diameter_scale = 1.5);
        let tip = |diameter: f64| vec![press(0.001, 0.002, 0.7).with_diameter(diameter)];
        assert_eq!(read(&model, tip(0.004)), read(&MODEL, tip(0.006)));
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
    fn free_edges_change_what_is_near_them() {
        let model = BarometerModel::new(&skin("base = \"bonded\"", "edge = \"free\"")).unwrap();
        // Straight above b14, 4 mm from the edge, the elastomer gives way; beyond it, nothing else carries the force.
        let (wide, free) =
            (read(&MODEL, vec![press(0.013, 0.0, 0.1)]), read(&model, vec![press(0.013, 0.0, 0.1)]));
        assert!(free[14] < 0.95 * wide[14], "{} {}", free[14], wide[14]);
        let (wide, free) =
            (read(&MODEL, vec![press(0.017, 0.0, 0.1)]), read(&model, vec![press(0.017, 0.0, 0.1)]));
        assert!(free[14] > 1.2 * wide[14], "{} {}", free[14], wide[14]);
        // In the middle, 17 mm from every edge, hardly anything is left.
        let (wide, free) =
            (read(&MODEL, vec![press(0.0, 0.0, 0.1)]), read(&model, vec![press(0.0, 0.0, 0.1)]));
        assert!((free[12] - wide[12]).abs() < 0.025 * wide[12], "{} {}", free[12], wide[12]);
        // Beside an edge, left is like right.
        let (left, right) =
            (read(&model, vec![press(-0.015, 0.004, 0.1)]), read(&model, vec![press(0.015, 0.004, 0.1)]));
        for row in 0..5 {
            for column in 0..5 {
                let (a, b) = (left[5 * row + column], right[5 * row + 4 - column]);
                approx::assert_relative_eq!(a, b, epsilon = 1e-3);
            }
        }
        let outside = skin("[medium]", "effects = []\n[medium]\nedge = \"free\"");
        let mut parameters = Parameters::nominal(&outside).unwrap();
        parameters.elements[3].position.y = -0.0171;
        let refused = BarometerModel::from_parameters(&outside, &parameters).unwrap_err().to_string();
        insta::assert_snapshot!(refused, @"skin `baro-grid`: field `taxels[3].position`: `b03` reads at (0.0065, -0.0171, -0.005) m, where an elastomer with free edges of 0.034 m by 0.034 m has ended");
    }

    #[test]
    fn impossible_skins_are_refused_by_field() {
        let refused = |from: &str, to: &str| BarometerModel::new(&skin(from, to)).unwrap_err().to_string();
        insta::assert_snapshot!(refused("thickness = 0.010", "thickness = 0.004"), @"skin `baro-grid`: field `taxels[0].position`: z of `b00` is -0.005 m and must lie in the medium: below 0 and not below -0.004 m");
        insta::assert_snapshot!(refused("thickness = 0.010", "thicknes = 0.010"), @"skin `baro-grid`: field `medium.thicknes`: unknown field `thicknes`, expected one of `thickness`, `young_modulus`, `poisson_ratio`, `base`, `edge`, `bore`");
        insta::assert_snapshot!(refused("poisson_ratio = 0.49", ""), @"skin `baro-grid`: field `medium`: missing field `poisson_ratio`");
        insta::assert_snapshot!(refused("poisson_ratio = 0.49", "poisson_ratio = 0.5"), @"skin `baro-grid`: field `medium.poisson_ratio`: Poisson's ratio is 0.5 and must be between 0 and 0.4999");
        insta::assert_snapshot!(refused("base = \"bonded\"", "base = \"glued\""), @"skin `baro-grid`: field `medium.base`: must be \"bonded\", \"slip\", or a share of slip from 0 to 1");
        insta::assert_snapshot!(refused("base = \"bonded\"", "base = 1.5"), @r#"skin `baro-grid`: field `medium.base`: is 1.5 and must be "bonded", "slip", or a share of slip from 0 to 1"#);
        insta::assert_snapshot!(refused("thickness = 0.010", "thickness = -0.010"), @"skin `baro-grid`: field `medium.thickness`: is -0.01 m and must be a positive length");
        insta::assert_snapshot!(refused("[-0.0130, -0.0130, -0.005]", "[-0.0230, -0.0130, -0.005]"), @"skin `baro-grid`: field `taxels[0].position`: `b00` lies at (-0.023, -0.013) m, beside the surface of 0.034 m by 0.034 m");
        insta::assert_snapshot!(refused("[-0.0130, -0.0130, -0.005]", "[-0.0130, -0.0130, 0.005]"), @"skin `baro-grid`: field `taxels[0].position`: z of `b00` is 0.005 m and must lie in the medium: below 0 and not below -0.01 m");
        insta::assert_snapshot!(refused("[-0.0130, -0.0130, -0.005]", "[-0.0130, -0.0130, -0.0001]"), @"skin `baro-grid`: field `taxels[0].position`: `b00` is too near to the surface: it must be at least 0.000424 m deep");
        insta::assert_snapshot!(refused("unit = \"Pa\"", "unit = \"kPa\""), @r#"skin `baro-grid`: field `unit`: is "kPa" where barometers read "Pa""#);
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
        insta::assert_snapshot!(refused(|c| c.tip = dermis_model::Tip::sphere(0.0)), @"contact 1: its diameter is 0 m and must be 0.0001 to 0.1 m");
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
