//! What the processes of a plan are to each other: which cannot run together, and which waits for which.

use serde_json::Value;

use super::loader::{Loader, Named};
use super::scope::At;
use super::types::{Process, Refusal};
use crate::error::LaunchError;

impl Loader<'_> {
    /// Asks the host whether the nodes can run beside each other.
    pub(super) fn beside(&mut self) {
        let nodes: Vec<(&Process, &Value)> =
            self.processes.iter().filter_map(|p| Some((p, p.config.as_ref()?))).collect();
        let given: Vec<(&str, &Value)> =
            nodes.iter().map(|(p, config)| (p.label.as_str(), *config)).collect();
        for (i, Refusal { field, reason }) in self.host.together(&given) {
            let process = nodes[i].0;
            self.faults.push(At { file: &process.file, field: &process.field }.refuse(&field, reason));
        }
    }

    /// What each process waits for, as indices.
    pub(super) fn waits(&mut self) -> Vec<Vec<usize>> {
        let labels: Vec<&str> = self.named.iter().map(|named| named.label.as_str()).collect();
        let find = |named: &Named, wanted: &str| {
            let near = format!("{}/{wanted}", named.namespace);
            let names = [near.trim_start_matches('/'), wanted.trim_start_matches('/')];
            names.into_iter().find_map(|name| labels.iter().position(|label| *label == name))
        };
        let found: Vec<Vec<Option<usize>>> = self
            .named
            .iter()
            .map(|named| named.after.iter().map(|wanted| find(named, wanted)).collect())
            .collect();
        let waits: Vec<Vec<usize>> =
            found.iter().map(|after| after.iter().copied().flatten().collect()).collect();
        for (named, found) in self.named.iter().zip(&found) {
            for (i, (wanted, other)) in named.after.iter().zip(found).enumerate() {
                let reason = match other.map(|other| (other, &self.named[other])) {
                    None if !self.complete => continue,
                    None => format!("there is no process `{wanted}`; there are {}", labels.join(", ")),
                    Some((_, other)) if !other.ready => format!(
                        "`{}` says not when it is ready; give it `ready: {{file: …}}` or `ready: {{line: …}}`",
                        other.label
                    ),
                    Some((at, other)) if waits_for(&labels, &waits, at, &named.label) => format!(
                        "`{}` waits for `{}` itself, so that neither would start",
                        other.label, named.label
                    ),
                    Some(_) => continue,
                };
                self.faults.push(LaunchError::Field {
                    path: named.file.clone(),
                    field: format!("{}.after[{i}]", named.field),
                    reason,
                });
            }
        }
        waits
    }
}

/// Whether a process waits for the one with this label, or is it.
fn waits_for(labels: &[&str], waits: &[Vec<usize>], from: usize, label: &str) -> bool {
    let mut seen = vec![false; waits.len()];
    let mut open = vec![from];
    while let Some(i) = open.pop() {
        if labels[i] == label {
            return true;
        }
        if !std::mem::replace(&mut seen[i], true) {
            open.extend(&waits[i]);
        }
    }
    false
}
