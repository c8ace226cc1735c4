//! What makes a device differ from its design.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use dermis_model::{COMMON, CommonEffect, CommonParameters};
use dermis_skin::{Effect, EffectInfo, ParameterInfo, SkinDescription};

use dermis_sensor::Sensor;

use crate::registry::SENSORS;

/// Whose effects.
#[derive(Args)]
pub struct Options {
    /// Sensor family, or a skin description, which may switch some of them on; all families where absent.
    of: Option<String>,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Effects of a simulated device on a command line, on top of those of its description.
#[derive(Args)]
pub struct Chosen {
    /// File of effects, e.g. launch/effects/baro-default.toml; one of the same name replaces that of the description.
    #[arg(long, value_name = "FILE")]
    pub(crate) effects: Vec<PathBuf>,
    /// One effect; its strength is 1 where none is named. `dermis effects` lists them.
    #[arg(long, value_name = "NAME[=STRENGTH]", value_parser = named)]
    pub(crate) effect: Vec<(String, f64)>,
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
    pub fn apply(&self, skin: &mut SkinDescription, seed: u64) -> Result<()> {
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

/// Lists effects.
pub fn run(options: &Options) -> Result<()> {
    let (families, skin): (Vec<&'static dyn Sensor>, Option<SkinDescription>) = match &options.of {
        None => (SENSORS.iter().collect(), None),
        Some(of) => match SENSORS.get(of) {
            Some(family) => (vec![family], None),
            None if Path::new(of).exists() => {
                let skin = SkinDescription::load(of)?;
                (vec![crate::registry::family(&skin)?], Some(skin))
            }
            None => {
                let known = SENSORS.names();
                bail!("`{of}` is neither a sensor family ({}) nor a skin description file", known.join(", "))
            }
        },
    };
    let on = |name: &str| skin.as_ref().and_then(|s| s.effects.iter().find(|e| e.name == name));
    if let Some(skin) = &skin {
        // Unknown names and impossible values are for the model to refuse.
        families[0].model(skin)?;
    }
    if options.json {
        let of = |family: &&'static dyn Sensor| -> Result<serde_json::Value> {
            let effects = family.effects().iter().map(|info| {
                let mut value = serde_json::to_value(info)?;
                if skin.is_some() {
                    value["of_skin"] = serde_json::to_value(on(info.name))?;
                }
                Ok(value)
            });
            Ok(serde_json::json!({ "name": family.name(), "effects": effects.collect::<Result<Vec<_>>>()? }))
        };
        let families = families.iter().map(of).collect::<Result<Vec<_>>>()?;
        let common = COMMON.iter().map(|info| {
            let mut value = serde_json::to_value(info)?;
            if skin.is_some() {
                value["of_skin"] = serde_json::to_value(on(info.name))?;
            }
            Ok(value)
        });
        let common = common.collect::<Result<Vec<_>>>()?;
        println!("{}", serde_json::json!({ "families": families, "common": common }));
        return Ok(());
    }
    for family in families {
        println!("{}", family.name());
        for info in family.effects() {
            print!("{}", describe(info, on(info.name)));
        }
    }
    println!("every skin");
    for info in COMMON {
        print!("{}", describe_common(info, on(info.name)));
    }
    Ok(())
}

/// One effect that every skin can have for people; with what a skin says of it, where it does.
fn describe_common(info: &CommonEffect, of_skin: Option<&Effect>) -> String {
    let mut text = format!("  {}", info.name);
    if let Some(effect) = of_skin {
        let _ = write!(text, "  [strength {} on this skin]", effect.strength);
    }
    let remembers = if info.stateful { " Remembers." } else { "" };
    let rig = if info.rig { " Of the rig." } else { "" };
    let _ = writeln!(text, "\n      {}{remembers}{rig}", info.what);
    let unit = match info.unit {
        "" => " in the unit of the skin".to_owned(),
        "1" => String::new(),
        unit => format!(" in {unit}"),
    };
    match info.parameters {
        CommonParameters::Channels | CommonParameters::ChannelsAnd(_) => {
            let _ = writeln!(text, "      names of channels, each a number{unit}");
        }
        CommonParameters::Taxels => {
            let _ = writeln!(text, "      names of taxels with .x, .y or .z, each a number{unit}");
        }
        CommonParameters::Named(_) => {}
    }
    numbers(&mut text, info.named(), of_skin);
    text
}

/// Parameters with their range, and what a skin says of them where it does.
fn numbers(text: &mut String, parameters: &[ParameterInfo], of_skin: Option<&Effect>) {
    for p in parameters {
        let value = of_skin.and_then(|effect| effect.parameters.get(p.name)).copied();
        let unit = if p.unit == "1" || p.unit.is_empty() { String::new() } else { format!(" {}", p.unit) };
        let [low, high] = p.range;
        let _ = writeln!(
            text,
            "      {:14} {}{unit} ({low} to {high}{unit})  {}",
            p.name,
            value.unwrap_or(p.typical),
            p.what
        );
    }
}

/// One effect for people; with what a skin says of it, where it does.
fn describe(info: &EffectInfo, of_skin: Option<&Effect>) -> String {
    let mut text = format!("  {}", info.name);
    if let Some(effect) = of_skin {
        let _ = write!(text, "  [strength {} on this skin]", effect.strength);
    }
    let traits = match (info.stateful, info.random) {
        (true, true) => " Remembers; drawn by its seed.",
        (true, false) => " Remembers.",
        (false, true) => " Drawn by its seed.",
        (false, false) => "",
    };
    let _ = writeln!(text, "\n      {}{traits}", info.what);
    numbers(&mut text, info.parameters, of_skin);
    text
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
        let text = include_str!("../../launch/skins/baro-grid.toml");
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

    #[test]
    fn an_effect_of_every_skin_is_described_alike() {
        let info = dermis_model::common_effect("warm-up").unwrap();
        insta::assert_snapshot!(describe_common(info, None), @r#"
warm-up
    The zero of channels, and the sensitivity of all, are off when the device is switched on, and go home as it warms itself. Remembers.
    names of channels, each a number in the unit of the skin
    time           300 s (30 to 1800 s)  after which 37 % of it is left
    span           0 (-0.3 to 0.3)  by which the sensitivity is too large at first
"#);
    }

    #[test]
    fn an_effect_is_described_with_units_and_ranges() {
        let info = dermis_barodome::FAMILY.effects().iter().find(|e| e.name == "tilt").unwrap();
        let effect = Effect::new("tilt").strength(0.5).with("angle", 0.1);
        insta::assert_snapshot!(describe(info, Some(&effect)), @r#"
tilt  [strength 0.5 on this skin]
    Packages are tilted: the port moves aside, and a footprint lies askew. Drawn by its seed.
    angle          0.1 rad (0.035 to 0.26 rad)  most, about a random axis
    lever          0.0011 m (0.0005 to 0.002 m)  from the axis up to the port
"#);
    }
}
