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
            let mut run = |of: &str, arguments: &[String], config: Option<&Value>| {
                let _ = writeln!(out, "       {of}{}", command_line(&p.program_name(), arguments));
                if let Some(config) = config {
                    let _ = writeln!(out, "       {}", said(config));
                }
            };
            if p.nodes.is_empty() {
                run("", &p.arguments, p.config.as_ref());
            }
            for node in &p.nodes {
                run(&format!("{}: ", node.label), &node.arguments, node.config.as_ref());
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
                    "nodes": p.nodes.iter().map(|node| json!({
                        "name": node.label, "arguments": node.arguments, "config": node.config,
                    })).collect::<Vec<_>>(),
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
    fn program_name(&self) -> String {
        if self.own { "dermis".into() } else { self.program.display().to_string() }
    }
}

/// A command as a person would type it.
fn command_line(program: &str, arguments: &[String]) -> String {
    let quoted = |word: &str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "/._-:=?&,@%+".contains(c);
        if !word.is_empty() && word.chars().all(plain) {
            word.to_owned()
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    };
    let words = std::iter::once(program).chain(arguments.iter().map(String::as_str));
    words.map(quoted).collect::<Vec<_>>().join(" ")
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
