//! Effects of a simulated device, on top of those of its description.

use std::path::PathBuf;

use clap::Args;
use dermis_skin::{Effect, SkinDescription, SkinError};
use serde::{Deserialize, Serialize};

/// Effects of a simulated device on a command line, on top of those of its description.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Chosen {
    /// File of effects, e.g. launch/effects/baro-default.toml; one of the same name replaces that of the description.
    #[arg(long, value_name = "FILE")]
    pub effects: Vec<PathBuf>,
    /// One effect; its strength is 1 where none is named. `dermis effects` lists them.
    #[arg(long, value_name = "NAME[=STRENGTH]", value_parser = named)]
    pub effect: Vec<(String, f64)>,
}

/// Reads `tilt` or `tilt=0.5`.
fn named(text: &str) -> Result<(String, f64), String> {
    let (name, strength) = text.split_once('=').unwrap_or((text, "1"));
    match strength.parse::<f64>() {
        Ok(strength) if strength.is_finite() && strength >= 0.0 && !name.is_empty() => {
            Ok((name.to_owned(), strength))
        }
        _ => Err(format!(
            "`{text}` is no effect: write its name, or e.g. `tilt=0.5` for another strength than 1"
        )),
    }
}

impl Chosen {
    /// The skin with these effects; what its description and the files leave open of the device is drawn by `seed`.
    ///
    /// # Errors
    ///
    /// Where a file of effects cannot be used.
    pub fn apply(&self, skin: &mut SkinDescription, seed: u64) -> Result<(), SkinError> {
        for file in &self.effects {
            Effect::merge(&mut skin.effects, Effect::load(file)?);
        }
        for (name, strength) in &self.effect {
            match skin.effects.iter_mut().find(|e| e.name == *name) {
                Some(effect) => effect.strength = *strength,
                None => skin.effects.push(Effect::new(name).strength(*strength)),
            }
        }
        for effect in &mut skin.effects {
            effect.seed.get_or_insert(seed);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_reads_as_people_write_it() {
        assert_eq!(named("tilt"), Ok(("tilt".to_owned(), 1.0)));
        assert_eq!(named("tilt=0.5"), Ok(("tilt".to_owned(), 0.5)));
        for bad in ["", "=1", "tilt=", "tilt=much", "tilt=-1", "tilt=inf", "tilt=NaN"] {
            assert!(named(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_command_line_goes_on_top_of_files_and_those_on_top_of_the_skin() {
        let text = include_str!("../../../launch/skins/baro-grid.toml");
        let mut skin = SkinDescription::from_toml(text, "baro-grid.toml").unwrap();
        skin.effects = vec![Effect::new("tilt").with("angle", 0.1).seed(3), Effect::new("thickness")];
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("effects.toml");
        std::fs::write(
            &file,
            "[[effects]]\nname = \"thickness\"\nchange = 1e-4\n[[effects]]\nname = \"mullins\"",
        )
        .unwrap();
        let chosen = Chosen {
            effects: vec![file],
            effect: vec![("tilt".to_owned(), 0.5), ("friction".to_owned(), 2.0)],
        };
        chosen.apply(&mut skin, 9).unwrap();
        assert_eq!(
            skin.effects,
            [
                Effect::new("tilt").with("angle", 0.1).seed(3).strength(0.5),
                Effect::new("thickness").with("change", 1e-4).seed(9),
                Effect::new("mullins").seed(9),
                Effect::new("friction").strength(2.0).seed(9),
            ]
        );
    }
}
