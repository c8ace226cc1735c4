//! The arguments that a launch file declares, with their values.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::scope::{At, LaunchContext, is_name};
use super::types::Declared;
use crate::error::LaunchError;
use crate::faults::Faults;
use crate::file::{self, Argument, Text};
use crate::substitute::Scope;

/// What `${…}` gives in every file.
const FOLDERS: [&str; 3] = ["here", "cwd", "tmp"];

/// The arguments that a file declares, with their values; one that cannot be used has the text that it has in the file.
pub(super) fn arguments(
    tree: &Value,
    mut given: BTreeMap<String, String>,
    path: &Path,
    scope: &Scope,
    context: &LaunchContext,
    folder: &Path,
    faults: &mut Faults,
) -> Vec<Declared> {
    let at = At { file: path, field: "arguments" };
    let empty = Map::new();
    let declarations = match tree.get("arguments") {
        None | Some(Value::Null) => &empty,
        Some(Value::Object(declarations)) => declarations,
        Some(_) => {
            let reason = "is no table; write `name: default`, or `name: {default: …, about: …}`";
            faults.push(at.refuse("", reason));
            &empty
        }
    };
    let mut declared = Vec::new();
    for (name, declaration) in declarations {
        if FOLDERS.contains(&name.as_str()) || !is_name(name, true) {
            faults.push(at.refuse(
                name,
                format!(
                    "cannot be the name of an argument: it begins with a letter, goes on with letters, digits, `_`, `-` or `.`, and is none of {}",
                    FOLDERS.join(", ")
                ),
            ));
            continue;
        }
        let field = format!("arguments.{name}");
        let argument = match declaration {
            Value::Object(_) => file::typed::<Argument>(declaration.clone(), path, &field, faults).0,
            Value::Null => Some(Argument { default: None, about: String::new(), path: false }),
            scalar => file::typed::<Text>(scalar.clone(), path, &field, faults).0.map(|text| Argument {
                default: Some(text),
                about: String::new(),
                path: false,
            }),
        };
        // It is known all the same, so that what uses it is no mistake.
        let argument = argument.unwrap_or(Argument {
            default: Some(Text::default()),
            about: String::new(),
            path: false,
        });
        let (value, base) = match (given.remove(name), argument.default) {
            // What is given is relative to where it is given.
            (Some(value), _) => (value, &context.folder),
            (None, Some(Text(default))) => {
                let value = scope.text(&default).unwrap_or_else(|reason| {
                    faults.push(at.refuse(name, reason));
                    default
                });
                (value, &folder.to_owned())
            }
            (None, None) => {
                faults.push(at.refuse(name, format!("has no default; give it: `{name}:=VALUE`")));
                (String::new(), &context.folder)
            }
        };
        let value =
            if argument.path && !value.is_empty() { base.join(value).display().to_string() } else { value };
        declared.push(Declared { name: name.clone(), value, about: argument.about });
    }
    for (name, value) in given {
        let known: Vec<&str> = declarations.keys().map(String::as_str).collect();
        let known =
            if known.is_empty() { "it has none".to_owned() } else { format!("it has {}", known.join(", ")) };
        faults.push(LaunchError::Argument {
            path: path.to_owned(),
            argument: format!("{name}:={value}"),
            reason: format!("the file declares no argument `{name}`; {known}"),
        });
    }
    declared
}
