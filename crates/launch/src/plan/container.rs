//! Containers: nodes that share a process.
//!
//! Problem: eight skins and the node that merges them are nine processes, and each frame crosses a socket between them.
//!
//! Solution: entries with the same `container` become one process, which runs the program's command `container` with the arguments of
//! each, one after the other with `--` between them. Nodes start, are stopped and are started again together, so that what
//! supervises them is the strictest of what they ask for.

use std::collections::BTreeSet;

use super::loader::{Loader, Named};
use super::process::Command;
use super::scope::{At, LaunchContext};
use super::types::{Process, SharedNode};
use crate::backoff::Backoff;
use crate::file::Entry;

/// The command that runs nodes in one process.
const COMMAND: &str = "container";
/// What separates the arguments of two nodes of a container.
pub const NODE_SEPARATOR: &str = "--";

/// The arguments of a container.
pub(super) fn arguments(nodes: &[SharedNode]) -> Vec<String> {
    let mut all = vec![COMMAND.to_owned()];
    for (i, node) in nodes.iter().enumerate() {
        if i > 0 {
            all.push(NODE_SEPARATOR.to_owned());
        }
        all.extend_from_slice(&node.arguments);
    }
    all
}

/// For each entry the first one that shares its process: itself, where it shares none.
pub(super) fn first_of_process(named: &[Named]) -> Vec<usize> {
    let first = |(i, entry): (usize, &Named)| match &entry.container {
        None => i,
        Some(_) => named.iter().position(|other| other.container == entry.container).unwrap_or(i),
    };
    named.iter().enumerate().map(first).collect()
}

impl Loader<'_> {
    /// The container of an entry. Where a file or group names one, it holds for what can share a process only.
    pub(super) fn container(
        &mut self,
        entry: &Entry,
        command: Option<&Command>,
        at: &At,
        inner: &LaunchContext,
    ) -> Option<String> {
        let name = inner.container.clone()?;
        let command = command?;
        if command.own && self.host.can_share(&command.arguments) {
            if command.arguments.iter().any(|argument| argument == NODE_SEPARATOR) {
                let reason = format!(
                    "has the argument `{NODE_SEPARATOR}`, which separates the nodes of a container; leave one of them away"
                );
                self.faults.push(at.refuse("container", reason));
            }
            return Some(name);
        }
        if entry.container.is_some() {
            let reason = "shares its process with others, which only a node can: a skin, `fusion`, `reflex`, `bridge` or `record`";
            self.faults.push(at.refuse("container", reason));
        }
        None
    }

    /// What is started: entries of one container as one process. `waits` are indices of entries, of the first one of a container.
    pub(super) fn with_containers(&mut self, waits: &[Vec<usize>]) -> Vec<Process> {
        self.check_container_names();
        let processes = std::mem::take(&mut self.processes);
        // Otherwise entries and processes do not correspond, and the plan is of no use.
        if processes.len() != self.named.len() {
            return processes;
        }
        let first = first_of_process(&self.named);
        let started: BTreeSet<usize> = first.iter().copied().collect();
        let index = |entry: &usize| started.range(..entry).count();
        let mut all: Vec<Process> = Vec::with_capacity(started.len());
        for (i, (mut process, after)) in processes.into_iter().zip(waits).enumerate() {
            process.after = after.iter().map(index).collect();
            match self.named[i].container.clone() {
                None => all.push(process),
                Some(name) if first[i] == i => {
                    let node = node_of(&mut process);
                    process.nodes.push(node);
                    process.label = name;
                    all.push(process);
                }
                Some(_) => self.add(&mut all[index(&first[i])], process),
            }
        }
        for process in all.iter_mut().filter(|process| !process.nodes.is_empty()) {
            process.arguments = arguments(&process.nodes);
        }
        all
    }

    fn check_container_names(&mut self) {
        for entry in self.named.iter().filter(|entry| entry.container.is_some()) {
            let name = entry.container.as_deref().unwrap_or_default();
            if let Some(other) = self.named.iter().find(|other| other.label == name) {
                let reason = format!(
                    "`{name}` is the name of {} in {} too; give one of them another name",
                    other.field,
                    other.file.display()
                );
                self.faults.push(At { file: &entry.file, field: &entry.field }.refuse("container", reason));
            }
        }
    }

    /// Adds a node to a container.
    fn add(&mut self, container: &mut Process, mut process: Process) {
        let node = node_of(&mut process);
        let (name, of) = (container.label.clone(), container.nodes[0].label.clone());
        let at = At { file: &process.file, field: &process.field };
        let mut refuse = |field: &str, reason: String| self.faults.push(at.refuse(field, reason));
        if process.directory != container.directory {
            let reason = format!(
                "{} is another working directory than {}, that of `{of}`, which is in container `{name}` too; give both the same",
                process.directory.display(),
                container.directory.display()
            );
            refuse("directory", reason);
        }
        let keys: BTreeSet<&String> =
            process.environment.keys().chain(container.environment.keys()).collect();
        for key in keys {
            if process.environment.get(key) != container.environment.get(key) {
                let reason = format!(
                    "{key} is not what it is for `{of}`, which is in container `{name}` too; a process has one environment, \
                     domain, network and log level"
                );
                refuse("container", reason);
            }
        }
        if process.backoff != Backoff::default() {
            if container.backoff != Backoff::default() && container.backoff != process.backoff {
                refuse(
                    "backoff",
                    format!("differs from that of other nodes in container `{name}`; give it once"),
                );
            }
            container.backoff = process.backoff;
        }
        if let Some(ready) = process.ready {
            if container.ready.is_some() {
                refuse("ready", format!("is given twice for container `{name}`; leave one"));
            }
            container.ready = Some(ready);
        }
        container.restart = container.restart.max(process.restart);
        container.required |= process.required;
        container.stop.interrupt = container.stop.interrupt.max(process.stop.interrupt);
        container.stop.terminate = container.stop.terminate.max(process.stop.terminate);
        container.nodes.push(node);
    }
}

fn node_of(process: &mut Process) -> SharedNode {
    SharedNode {
        label: process.label.clone(),
        arguments: std::mem::take(&mut process.arguments),
        config: process.config.take(),
    }
}
