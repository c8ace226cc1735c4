//! What makes a device differ from its design: the effects that sensor families know, for people and for editors.

use std::fmt::Write as _;

use dermis_model::{COMMON, CommonEffect, CommonParameters};
use dermis_sensor::{Registry, Sensor};
use dermis_skin::{Effect, EffectInfo, ParameterInfo, SkinDescription};
use serde::Serialize;
use serde_json::{Map, Value, json};

/// What a skin says of an effect.
fn on<'a>(skin: Option<&'a SkinDescription>, name: &str) -> Option<&'a Effect> {
    skin?.effects.iter().find(|effect| effect.name == name)
}

/// For people; with what a skin says of each, where one is given.
#[must_use]
pub fn text(families: &[&'static dyn Sensor], skin: Option<&SkinDescription>) -> String {
    let mut text = String::new();
    for family in families {
        let _ = writeln!(text, "{}", family.name());
        for info in family.effects() {
            text += &describe(info, on(skin, info.name));
        }
    }
    text += "every skin\n";
    for info in COMMON {
        text += &describe_common(info, on(skin, info.name));
    }
    text
}

/// For programs.
///
/// # Errors
///
/// Where an effect cannot be written as JSON.
pub fn record(
    families: &[&'static dyn Sensor],
    skin: Option<&SkinDescription>,
) -> Result<Value, serde_json::Error> {
    let of = |family: &&'static dyn Sensor| -> Result<Value, serde_json::Error> {
        let effects = family.effects().iter().map(|info| entry(info, info.name, skin));
        Ok(json!({ "name": family.name(), "effects": effects.collect::<Result<Vec<_>, _>>()? }))
    };
    let families = families.iter().map(of).collect::<Result<Vec<_>, _>>()?;
    let common = COMMON.iter().map(|info| entry(info, info.name, skin));
    let common = common.collect::<Result<Vec<_>, _>>()?;
    Ok(json!({ "families": families, "common": common }))
}

fn entry(
    info: &impl Serialize,
    name: &str,
    skin: Option<&SkinDescription>,
) -> Result<Value, serde_json::Error> {
    let mut value = serde_json::to_value(info)?;
    if skin.is_some() {
        value["of_skin"] = serde_json::to_value(on(skin, name))?;
    }
    Ok(value)
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

/// The JSON schema of files of effects: one entry for each effect of each family, and for each that every skin can have.
#[must_use]
pub fn schema(sensors: &Registry) -> Value {
    let mut entries = Vec::new();
    for family in sensors.iter() {
        for info in family.effects() {
            let title = format!("{} ({})", info.name, family.name());
            entries.push(entry_schema(&title, info.name, info.what, info.parameters, &json!(false)));
        }
    }
    for info in COMMON {
        // Of channels or taxels, whose names are those of the skin.
        let others = match info.parameters {
            CommonParameters::Named(_) => json!(false),
            _ => json!({ "type": "number" }),
        };
        let title = format!("{} (every skin)", info.name);
        entries.push(entry_schema(&title, info.name, info.what, info.named(), &others));
    }
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "dermis effects",
        "description": "What makes a device differ from its design; `dermis effects` lists the same. SI units.",
        "type": "object",
        "additionalProperties": false,
        "required": ["effects"],
        "properties": { "effects": { "$ref": "#/$defs/effects" } },
        "$defs": {
            "effects": { "type": "array", "items": { "anyOf": entries } },
        },
    })
}

fn entry_schema(title: &str, name: &str, what: &str, parameters: &[ParameterInfo], others: &Value) -> Value {
    let mut properties = Map::new();
    properties.insert("name".to_owned(), json!({ "const": name, "description": what }));
    properties.insert(
        "strength".to_owned(),
        json!({
            "type": "number", "minimum": 0, "default": 1,
            "description": "0 is off, 1 is what the parameters say",
        }),
    );
    properties.insert(
        "seed".to_owned(),
        json!({ "type": "integer", "minimum": 0, "description": "which device is drawn" }),
    );
    for p in parameters {
        let unit = if p.unit.is_empty() || p.unit == "1" { String::new() } else { format!("[{}] ", p.unit) };
        let [low, high] = p.range;
        properties.insert(
            p.name.to_owned(),
            json!({
                "type": "number", "minimum": bound(p.limits[0]), "maximum": bound(p.limits[1]), "default": p.typical,
                "description": format!("{unit}{}; usually {low} to {high}", p.what),
            }),
        );
    }
    json!({
        "title": title, "description": what, "type": "object", "required": ["name"],
        "properties": properties, "additionalProperties": others,
    })
}

/// JSON has no infinity: the largest number instead.
fn bound(limit: f64) -> f64 {
    limit.clamp(f64::MIN, f64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        const PARAMETERS: [ParameterInfo; 2] = [
            ParameterInfo::new("angle", "rad", "most, about a random axis", 0.087, [0.035, 0.26], [0.0, 1.5]),
            ParameterInfo::new(
                "lever",
                "m",
                "from the axis up to the port",
                0.0011,
                [0.0005, 0.002],
                [0.0, 1.0],
            ),
        ];
        let info = EffectInfo {
            name: "tilt",
            what: "Packages are tilted: the port moves aside, and a footprint lies askew.",
            source: "",
            parameters: &PARAMETERS,
            stateful: false,
            random: true,
        };
        let effect = Effect::new("tilt").strength(0.5).with("angle", 0.1);
        insta::assert_snapshot!(describe(&info, Some(&effect)), @r#"
tilt  [strength 0.5 on this skin]
    Packages are tilted: the port moves aside, and a footprint lies askew. Drawn by its seed.
    angle          0.1 rad (0.035 to 0.26 rad)  most, about a random axis
    lever          0.0011 m (0.0005 to 0.002 m)  from the axis up to the port
"#);
    }
}
