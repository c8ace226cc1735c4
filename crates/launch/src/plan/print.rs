//! A plan as text for people and as JSON for programs.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use super::types::{Declared, Plan, Process, Ready, Restart};

impl Plan {
    /// The plan for people, one process after the other.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing to a text cannot fail.
        let _ = writeln!(out, "{}: {} to start", self.file.display(), counted(self.processes.len()));
        for Declared { name, value, about } in &self.arguments {
            let about = if about.is_empty() { String::new() } else { format!("   # {about}") };
            let _ = writeln!(out, "  {name}:={value}{about}");
        }
        for (i, p) in self.processes.iter().enumerate() {
            let _ = writeln!(out, "{:>3}  {}", i + 1, p.label);
            let _ = writeln!(out, "       {}", p.command_line());
            if let Some(config) = &p.config {
                let _ = writeln!(out, "       {}", said(config));
            }
            let mut notes = Vec::new();
            if !p.after.is_empty() {
                let after: Vec<&str> = p.after.iter().map(|a| self.processes[*a].label.as_str()).collect();
                notes.push(format!("after {}", after.join(", ")));
            }
            match &p.ready {
                Some(Ready::File { path, .. }) => notes.push(format!("ready with {}", path.display())),
                Some(Ready::Line { pattern, .. }) => notes.push(format!("ready with a line /{pattern}/")),
                None => {}
            }
            match p.restart {
                Restart::Never => {}
                Restart::OnFailure => notes.push("started again where it fails".to_owned()),
                Restart::Always => notes.push("started again whenever it ends".to_owned()),
            }
            if p.required {
                notes.push("required".to_owned());
            }
            if !notes.is_empty() {
                let _ = writeln!(out, "       {}", notes.join("; "));
            }
        }
        out
    }

    /// The plan for programs.
    #[must_use]
    pub fn json(&self) -> Value {
        let processes: Vec<Value> = self
            .processes
            .iter()
            .map(|p| {
                json!({
                    "name": p.label,
                    "file": p.file,
                    "field": p.field,
                    "program": p.program,
                    "arguments": p.arguments,
                    "config": p.config,
                    "environment": p.environment,
                    "directory": p.directory,
                    "after": p.after.iter().map(|a| &self.processes[*a].label).collect::<Vec<_>>(),
                    "required": p.required,
                })
            })
            .collect();
        let arguments: Map<String, Value> =
            self.arguments.iter().map(|a| (a.name.clone(), a.value.clone().into())).collect();
        json!({ "file": self.file, "arguments": arguments, "processes": processes })
    }
}

impl Process {
    /// The command as a person would type it.
    #[must_use]
    pub fn command_line(&self) -> String {
        let program = if self.own { "dermis".into() } else { self.program.display().to_string() };
        std::iter::once(&program)
            .chain(&self.arguments)
            .map(|word| {
                let plain = |c: char| c.is_ascii_alphanumeric() || "/._-:=?&,@%+".contains(c);
                if !word.is_empty() && word.chars().all(plain) {
                    word.clone()
                } else {
                    format!("'{}'", word.replace('\'', r"'\''"))
                }
            })
            .collect::<Vec<_>>()
            .join(" ")
    }
}

/// The keys of a configuration that are set.
fn said(config: &Value) -> Value {
    let open = |value: &Value| match value {
        Value::Null | Value::Bool(false) => true,
        Value::Array(items) => items.is_empty(),
        Value::Object(fields) => fields.is_empty(),
        _ => false,
    };
    match config {
        Value::Object(fields) => fields
            .iter()
            .filter(|(_, value)| !open(value))
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect(),
        other => other.clone(),
    }
}

fn counted(count: usize) -> String {
    if count == 1 { "1 process".to_owned() } else { format!("{count} processes") }
}
