//! JSON schemas of the files that people write, for editors that complete and check them.
//!
//! Skin, plan and launch files: schemas are written by hand under `launch/schemas/`, and the tests here compare their keys with
//! those that the readers of these files name when they refuse one. Effects: made from what the families say of theirs.

use anyhow::Result;
use clap::{Args, ValueEnum};
use dermis_model::{COMMON, CommonParameters};
use dermis_skin::ParameterInfo;
use serde_json::{Map, Value, json};

use crate::registry::sensors;

/// Of which files.
#[derive(Args)]
pub struct Options {
    /// Kind of file.
    #[arg(value_enum)]
    of: Kind,
}

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Skin descriptions (TOML), `launch/skins/`.
    Skin,
    /// Launch files (YAML or TOML), `launch/*.launch.yaml`.
    Launch,
    /// Stimulus plans of the virtual testbed (TOML), `launch/plans/`.
    Plan,
    /// Effects that make a device differ from its design (TOML), `launch/effects/`.
    Effects,
}

/// Prints a schema.
pub fn run(options: &Options) -> Result<()> {
    print!("{}", text(options.of)?);
    Ok(())
}

fn text(kind: Kind) -> Result<String> {
    Ok(match kind {
        Kind::Skin => include_str!("../../launch/schemas/skin.schema.json").to_owned(),
        Kind::Launch => include_str!("../../launch/schemas/launch.schema.json").to_owned(),
        Kind::Plan => include_str!("../../launch/schemas/plan.schema.json").to_owned(),
        Kind::Effects => serde_json::to_string_pretty(&effects())? + "\n",
    })
}

/// The schema of effects: one entry for each effect of each family, and for each that every skin can have.
fn effects() -> Value {
    let mut entries = Vec::new();
    for family in sensors().iter() {
        for info in family.effects() {
            let title = format!("{} ({})", info.name, family.name());
            entries.push(effect(&title, info.name, info.what, info.parameters, &json!(false)));
        }
    }
    for info in COMMON {
        // Of channels or taxels, whose names are those of the skin.
        let others = match info.parameters {
            CommonParameters::Named(_) => json!(false),
            _ => json!({ "type": "number" }),
        };
        let title = format!("{} (every skin)", info.name);
        entries.push(effect(&title, info.name, info.what, info.named(), &others));
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

fn effect(title: &str, name: &str, what: &str, parameters: &[ParameterInfo], others: &Value) -> Value {
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
#[path = "schema/tests.rs"]
mod tests;
