//! What the processes of a plan are to each other: which cannot run together, and which waits for which.

use serde_json::Value;

use super::container::first_of_process;
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

    /// What each process waits for, as indices of entries: of the first one where several share a process.
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
        // What is in one container waits for all that its nodes wait for.
        let first = first_of_process(&self.named);
        let mut waits: Vec<Vec<usize>> = vec![Vec::new(); found.len()];
        for (entry, after) in found.iter().enumerate() {
            for other in after.iter().flatten().map(|other| first[*other]) {
                let of = &mut waits[first[entry]];
                let within = self.named[entry].container.is_some() && other == first[entry];
                if !within && !of.contains(&other) {
                    of.push(other);
                }
            }
        }
        for (entry, (named, found)) in self.named.iter().zip(&found).enumerate() {
            for (i, (wanted, other)) in named.after.iter().zip(found).enumerate() {
                let reason = match other.map(|other| (other, &self.named[other])) {
                    None if !self.complete => continue,
                    None => format!("there is no process `{wanted}`; there are {}", labels.join(", ")),
                    Some((_, other)) if named.container.is_some() && other.container == named.container => {
                        format!(
                            "`{}` is in the same container, whose nodes start together; remove it",
                            other.label
                        )
                    }
                    Some((_, other)) if !other.ready => format!(
                        "`{}` says not when it is ready; give it `ready: {{file: …}}` or `ready: {{line: …}}`",
                        other.label
                    ),
                    Some((at, other)) if waits_for(&waits, first[at], first[entry]) => format!(
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

/// Whether a process waits for another one, or is it.
fn waits_for(waits: &[Vec<usize>], from: usize, other: usize) -> bool {
    let mut seen = vec![false; waits.len()];
    let mut open = vec![from];
    while let Some(i) = open.pop() {
        if i == other {
            return true;
        }
        if !std::mem::replace(&mut seen[i], true) {
            open.extend(&waits[i]);
        }
    }
    false
}
