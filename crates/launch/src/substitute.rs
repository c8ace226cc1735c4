//! `${…}` in the texts of a launch file.

use std::cell::Cell;
use std::collections::BTreeMap;

use serde_json::Value;

/// What `${…}` can stand for in one file.
#[derive(Debug, Default)]
pub(crate) struct Scope<'a> {
    /// Arguments and the folders `here`, `cwd`, `tmp`.
    pub values: BTreeMap<String, String>,
    /// What may still be put in, in all files of a launch.
    pub room: Room<'a>,
}

/// \[bytes\] that `${…}` may still put in: arguments are handed on from file to file, and each may repeat the one before.
pub(crate) type Room<'a> = Option<&'a Cell<usize>>;

/// \[bytes\] of all that `${…}` puts into a launch.
pub(crate) const PUT_IN: usize = 4 << 20;

/// Keys whose value is a command: a text there is cut at its spaces before anything is put in, so that what is put in
/// stays one word.
const COMMANDS: [&str; 2] = ["dermis", "program"];
/// Keys below which a text that is one `${…}` takes the type of what is put in, as if it had been written there.
const TYPED: [&str; 2] = ["parameters", "config"];

impl Scope<'_> {
    /// One text.
    pub(crate) fn text(&self, text: &str) -> Result<String, String> {
        let mut out = String::with_capacity(text.len());
        let mut rest = text;
        while let Some(at) = rest.find('$') {
            out.push_str(&rest[..at]);
            rest = &rest[at + 1..];
            if let Some(after) = rest.strip_prefix('$') {
                out.push('$');
                rest = after;
            } else if let Some(after) = rest.strip_prefix('{') {
                let end = after.find('}').ok_or_else(|| {
                    format!("`${{{after}` has no closing `}}`; write `$$` for a dollar sign")
                })?;
                let value = self.value(&after[..end])?;
                if let Some(room) = self.room {
                    let left = room.get().checked_sub(value.len()).ok_or_else(|| {
                        format!("`${{…}}` puts more than {PUT_IN} bytes into this launch; hand on less")
                    })?;
                    room.set(left);
                }
                out.push_str(&value);
                rest = &after[end + 1..];
            } else {
                out.push('$');
            }
        }
        out.push_str(rest);
        Ok(out)
    }

    fn value(&self, name: &str) -> Result<String, String> {
        let Some(variable) = name.strip_prefix("env:") else {
            return self.values.get(name).cloned().ok_or_else(|| {
                let known: Vec<&str> = self.values.keys().map(String::as_str).collect();
                format!(
                    "`${{{name}}}` is not known; declare it under `arguments`, or use one of {}, env:NAME",
                    known.join(", ")
                )
            });
        };
        let (variable, default) = match variable.split_once(":-") {
            Some((variable, default)) => (variable, Some(default)),
            None => (variable, None),
        };
        match (std::env::var(variable), default) {
            (Ok(value), _) => Ok(value),
            (Err(_), Some(default)) => Ok(default.to_owned()),
            (Err(std::env::VarError::NotPresent), None) => Err(format!(
                "environment variable {variable} is not set; set it, or give a default: `${{env:{variable}:-…}}`"
            )),
            (Err(error), None) => Err(format!("environment variable {variable}: {error}")),
        }
    }

    /// All texts of a tree, in place. What cannot be put in is reported with the path of its field, and stays.
    pub(crate) fn tree(
        &self,
        value: &mut Value,
        path: &str,
        typed: bool,
        tell: &mut impl FnMut(String, String),
    ) {
        match value {
            Value::String(text) => {
                let whole = typed && text.starts_with("${") && text.find('}') == Some(text.len() - 1);
                match self.text(text) {
                    Ok(put_in) => *value = if whole { scalar(put_in) } else { Value::String(put_in) },
                    Err(reason) => tell(path.to_owned(), reason),
                }
            }
            Value::Array(items) => {
                for (i, item) in items.iter_mut().enumerate() {
                    self.tree(item, &format!("{path}[{i}]"), typed, tell);
                }
            }
            Value::Object(fields) => {
                for (key, field) in fields {
                    if !typed
                        && COMMANDS.contains(&key.as_str())
                        && let Value::String(text) = field
                    {
                        *field = text.split_whitespace().collect();
                    }
                    let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    self.tree(field, &path, typed || TYPED.contains(&key.as_str()), tell);
                }
            }
            Value::Null | Value::Bool(_) | Value::Number(_) => {}
        }
    }
}

/// A text with the type that it would have in a file.
fn scalar(text: String) -> Value {
    match serde_json::from_str(&text) {
        Ok(value @ (Value::Bool(_) | Value::Number(_))) => value,
        _ => Value::String(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    fn scope() -> Scope<'static> {
        let values = [("skin", "a b.toml"), ("rate", "50.0"), ("on", "true"), ("here", "/robot")];
        Scope { values: values.map(|(k, v)| (k.to_owned(), v.to_owned())).into(), room: None }
    }

    #[test]
    fn values_are_put_in() {
        let scope = scope();
        assert_eq!(scope.text("${here}/x/${skin}").unwrap(), "/robot/x/a b.toml");
        assert_eq!(scope.text("5 $ and $${skin} $").unwrap(), "5 $ and ${skin} $");
        assert_eq!(scope.text("${env:DERMIS_SURELY_NOT_SET:-x:-y}").unwrap(), "x:-y");
        assert_eq!(scope.text("${env:PATH}").unwrap(), std::env::var("PATH").unwrap());
        insta::assert_snapshot!(scope.text("${skim}").unwrap_err(), @"`${skim}` is not known; declare it under `arguments`, or use one of here, on, rate, skin, env:NAME");
        insta::assert_snapshot!(scope.text("a ${skin").unwrap_err(), @"`${skin` has no closing `}`; write `$$` for a dollar sign");
        insta::assert_snapshot!(scope.text("${env:DERMIS_SURELY_NOT_SET}").unwrap_err(), @"environment variable DERMIS_SURELY_NOT_SET is not set; set it, or give a default: `${env:DERMIS_SURELY_NOT_SET:-…}`");
    }

    #[test]
    fn commands_are_cut_first_and_parameters_keep_their_type() {
        let mut tree = json!({
            "dermis": "device simulate ${skin}  --seed 3",
            "parameters": {"rate": "${rate}", "text": "x${rate}", "list": ["${on}"], "program": "a b"},
            "log": "${rate}",
        });
        scope().tree(&mut tree, "", false, &mut |field, reason| panic!("{field}: {reason}"));
        assert_eq!(
            tree,
            json!({
                "dermis": ["device", "simulate", "a b.toml", "--seed", "3"],
                "parameters": {"rate": 50.0, "text": "x50.0", "list": [true], "program": "a b"},
                "log": "50.0",
            })
        );
        let mut tree = json!({"processes": [{"dermis": "skin ${none}"}, {"log": "${no"}]});
        let mut fields = Vec::new();
        scope().tree(&mut tree, "", false, &mut |field, _| fields.push(field));
        assert_eq!(fields, ["processes[0].dermis[1]", "processes[1].log"]);
    }

    #[test]
    fn what_is_put_in_has_an_end() {
        let room = Cell::new(20);
        let scope = Scope { room: Some(&room), ..scope() };
        assert_eq!(scope.text("${skin}${skin}").unwrap(), "a b.tomla b.toml");
        insta::assert_snapshot!(scope.text("${skin}").unwrap_err(), @"`${…}` puts more than 4194304 bytes into this launch; hand on less");
    }

    proptest! {
        #[test]
        fn no_text_panics_and_what_is_escaped_comes_back(text in ".{0,40}") {
            let _ = scope().text(&text);
            prop_assert_eq!(scope().text(&text.replace('$', "$$")).unwrap(), text);
        }
    }
}
