//! What a skin is built to feel: the tip and the forces that somebody tries it with who has nothing else in mind.

use serde::{Deserialize, Serialize};

use crate::SkinDescription;
use crate::family::{self, FieldFault};

/// \[m\] diameters of a tip.
const DIAMETERS: [f64; 2] = [1e-4, 0.1];
/// \[N\] forces.
const FORCES: [f64; 2] = [1e-6, 1e6];
/// Mantissas of the forces of [`Rated::ladder`].
const STEPS: [f64; 3] = [1.0, 2.0, 5.0];

/// End of the tip that usually presses a skin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TipKind {
    /// A ball.
    #[default]
    Sphere,
    /// The flat end of a round rod.
    FlatPunch,
}

/// What usually presses a skin, and how hard.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rated {
    /// \[N\] pressing forces, from the least that is detected reliably to the most that the skin is built for.
    pub force: [f64; 2],
    /// \[m\] of the tip.
    pub diameter: f64,
    /// Its end.
    #[serde(default)]
    pub tip: TipKind,
}

impl Default for Rated {
    /// A ball of 4 mm with 0.05 to 1 N: a fingertip-sized skin of soft rubber.
    fn default() -> Self {
        Self { force: [0.05, 1.0], diameter: 0.004, tip: TipKind::Sphere }
    }
}

impl Rated {
    /// \[N\] forces of 1, 2 and 5 times powers of ten between the least and the most, and these two.
    #[must_use]
    pub fn ladder(&self) -> Vec<f64> {
        let [low, high] = self.force;
        let mut forces = vec![low];
        for power in low.log10().floor() as i32..=high.log10().ceil() as i32 {
            // Divided where it is small, so that 0.2 is the number that is written 0.2.
            let scaled = |step: f64| {
                if power < 0 { step / 10f64.powi(-power) } else { step * 10f64.powi(power) }
            };
            let inside = |force: &f64| (low * (1.0 + 1e-9)..high * (1.0 - 1e-9)).contains(force);
            forces.extend(STEPS.into_iter().map(scaled).filter(inside));
        }
        forces.push(high);
        forces
    }

    /// Says what cannot be.
    pub(crate) fn check(&self) -> Result<(), FieldFault> {
        let [low, high] = self.force;
        if !(low < high && [low, high].iter().all(|f| (FORCES[0]..=FORCES[1]).contains(f))) {
            let reason = format!(
                "is [{low}, {high}] N and must be a least and a greater largest force from {} to {} N",
                FORCES[0], FORCES[1]
            );
            return Err(FieldFault::new("rated.force", reason));
        }
        if !(DIAMETERS[0]..=DIAMETERS[1]).contains(&self.diameter) {
            let reason = format!("is {} m and must be {} to {} m", self.diameter, DIAMETERS[0], DIAMETERS[1]);
            return Err(FieldFault::new("rated.diameter", reason));
        }
        Ok(())
    }
}

impl SkinDescription {
    /// What usually presses this skin: as its file says, or else as its family does.
    #[must_use]
    pub fn rated_press(&self) -> Rated {
        self.rated.or_else(|| Some(family::registered(&self.sensor)?.rated(self))).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::PAD;

    #[test]
    fn forces_are_round_numbers_between_the_least_and_the_most() {
        assert_eq!(Rated::default().ladder(), [0.05, 0.1, 0.2, 0.5, 1.0]);
        let rated = |force| Rated { force, ..Rated::default() };
        assert_eq!(rated([5.0, 40.0]).ladder(), [5.0, 10.0, 20.0, 40.0]);
        assert_eq!(rated([0.3, 0.4]).ladder(), [0.3, 0.4]);
    }

    #[test]
    fn a_file_says_what_presses_its_skin() {
        let read = |rated: &str| {
            SkinDescription::from_toml(
                &PAD.replace("noise = 20.0", &format!("noise = 20.0\nrated = {rated}")),
                "pad.toml",
            )
        };
        let skin = read("{ force = [5.0, 40.0], diameter = 0.02, tip = \"flat-punch\" }").unwrap();
        let expected = Rated { force: [5.0, 40.0], diameter: 0.02, tip: TipKind::FlatPunch };
        assert_eq!(skin.rated_press(), expected);
        let plain = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        assert_eq!(plain.rated_press(), Rated::default());
        // What usually presses a skin is not what it is.
        assert_eq!(skin.hash(), plain.hash());
        let refused = |rated: &str| read(rated).unwrap_err().to_string();
        insta::assert_snapshot!(refused("{ force = [4.0, 4.0], diameter = 0.02 }"), @"skin file pad.toml: field `rated.force`: is [4, 4] N and must be a least and a greater largest force from 0.000001 to 1000000 N");
        insta::assert_snapshot!(refused("{ force = [4.0, 5.0], diameter = 2.0 }"), @"skin file pad.toml: field `rated.diameter`: is 2 m and must be 0.0001 to 0.1 m");
    }
}
