//! A bore full of fluid through the elastomer, with a sensing element at each end.
//!
//! A press squeezes fluid out from under it. While the bore is open all of it has one pressure; from the pinching force on, the
//! bore is closed under the tip, and what is squeezed out further goes half to either side, into the fluid between the tip and
//! that end: the nearer end reads more. What is squeezed out is given as a length of the undeformed bore; it levels off with the
//! force, because a bore that is closed can only close further along. All is quasi-static: neither the viscosity of the fluid
//! nor the memory of the elastomer is in it.

use dermis_model::Indentation;
use dermis_skin::{ModelError, SkinDescription};

use super::Field;
use crate::parameters::{BoreSpec, Parameters};

/// Pressure at the ends of a bore along x.
#[derive(Debug)]
pub(super) struct Bore {
    spec: BoreSpec,
    /// \[m\] of x, one a channel.
    ends: Vec<f64>,
    /// Force on the elastomer as designed that does what 1 N does on this one.
    softness: f64,
    /// \[m\] between the ends.
    length: f64,
}

impl Bore {
    /// # Errors
    ///
    /// [`ModelError::Description`] names the number that is no positive one, or says that there are not two ends.
    pub(super) fn new(
        skin: &SkinDescription,
        parameters: &Parameters,
        spec: BoreSpec,
    ) -> Result<Self, ModelError> {
        let numbers = [
            ("fluid_stiffness", spec.fluid_stiffness),
            ("dead_length", spec.dead_length),
            ("displaced_length", spec.displaced_length),
            ("half_force", spec.half_force),
            ("pinch_force", spec.pinch_force),
        ];
        for (name, value) in numbers {
            if !(value.is_finite() && value > 0.0) {
                let reason = format!("is {value} and must be a positive number");
                return Err(skin.refusal(&format!("medium.bore.{name}"), reason));
            }
        }
        let ends: Vec<f64> = parameters.elements.iter().map(|e| e.position.x).collect();
        let (low, high) =
            ends.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        let length = high - low;
        // What an effect moves is off its end by less than this.
        if ends.is_empty() || length <= 0.0 || ends.iter().any(|x| (x - low).min(high - x) > 0.1 * length) {
            let reason = "must lie at the two ends of the bore, along x".to_owned();
            return Err(skin.refusal("taxels", reason));
        }
        Ok(Self { spec, ends, softness: parameters.design_modulus / parameters.young_modulus, length })
    }

    /// \[m\] of undeformed bore that are squeezed out under this force.
    fn displaced(&self, force: f64) -> f64 {
        self.spec.displaced_length * force / (force + self.spec.half_force)
    }
}

impl Field for Bore {
    fn add(&self, _: usize, contact: &Indentation, out: &mut [f64]) -> Result<(), ModelError> {
        // A bore lies in the plane of its surface: what presses is the force into it.
        let force = (-contact.force.z).max(0.0) * self.softness;
        let open = self.displaced(force.min(self.spec.pinch_force));
        let beyond = (self.displaced(force) - open) / 2.0;
        let (stiffness, dead) = (self.spec.fluid_stiffness, self.spec.dead_length);
        let common = stiffness * open / (self.length + 2.0 * dead);
        for (o, end) in out.iter_mut().zip(&self.ends) {
            *o += common + stiffness * beyond / ((contact.position.x - end).abs() + dead);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::model::BarometerModel;
    use dermis_model::{ForwardModel as _, Indentation, Stimulus};
    use dermis_skin::SkinDescription;
    use nalgebra::{Point3, Vector3};

    const SKIN: &str = include_str!("../../../../launch/gap/tactile-fsi-air.toml");

    fn read(text: &str, x: f64, force: f64) -> [f64; 2] {
        let skin = SkinDescription::from_toml(text, "air.toml").unwrap();
        let contact = Indentation::sphere(Point3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, -force), 0.008);
        let mut out = [0.0; 2];
        let stimulus = Stimulus { contacts: vec![contact], ..Stimulus::default() };
        BarometerModel::new(&skin).unwrap().response(&stimulus, &mut out).unwrap();
        out
    }

    #[test]
    fn an_open_bore_has_one_pressure_and_a_pinched_one_two() {
        let [left, right] = read(SKIN, -0.03, 1.0);
        approx::assert_relative_eq!(left, right, max_relative = 1e-12);
        let [left, right] = read(SKIN, -0.03, 6.0);
        assert!(left > 1.2 * right, "{left} {right}");
        let mirrored = read(SKIN, 0.03, 6.0);
        approx::assert_relative_eq!(mirrored[1], left, max_relative = 1e-12);
        approx::assert_relative_eq!(mirrored[0], right, max_relative = 1e-12);
    }

    #[test]
    fn gas_obeys_boyle() {
        // A millimetre of a bore of 100 mm and twice 27.5 mm of dead length at one atmosphere, to first order.
        let text = SKIN
            .replace("displaced_length = 0.00288", "displaced_length = 0.002")
            .replace("half_force = 1.47", "half_force = 1.0")
            .replace("pinch_force = 1.49", "pinch_force = 10.0");
        let [left, _] = read(&text, 0.0, 1.0);
        approx::assert_relative_eq!(left, 101_325.0 * 0.001 / (0.1 + 2.0 * 0.0275), max_relative = 1e-9);
    }

    #[test]
    fn softer_elastomer_is_like_more_force() {
        let soft = SKIN.replace("young_modulus = 70e3", "young_modulus = 35e3");
        // The description is the design: its own modulus goes with its own forces.
        assert_eq!(read(&soft, 0.01, 2.0), read(SKIN, 0.01, 2.0));
    }

    #[test]
    fn impossible_bores_are_refused() {
        let refused = |from: &str, to: &str| {
            assert!(SKIN.contains(from));
            let skin = SkinDescription::from_toml(&SKIN.replace(from, to), "air.toml").unwrap();
            BarometerModel::new(&skin).unwrap_err().to_string()
        };
        insta::assert_snapshot!(refused("half_force = 1.47", "half_force = 0.0"), @"skin `tactile-fsi-line`: field `medium.bore.half_force`: is 0 and must be a positive number");
        insta::assert_snapshot!(refused("[-0.050, 0.0, -0.005]", "[0.050, 0.001, -0.005]"), @"skin `tactile-fsi-line`: field `taxels`: must lie at the two ends of the bore, along x");
        insta::assert_snapshot!(refused("half_force = 1.47", "half_forc = 1.47"), @"skin `tactile-fsi-line`: field `medium.bore.half_forc`: unknown field `half_forc`, expected one of `fluid_stiffness`, `dead_length`, `displaced_length`, `half_force`, `pinch_force`");
    }
}
