//! One entry of a launch file: its name, what it runs, and how it is supervised.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

use regex::RegexBuilder;
use serde_json::{Map, Value};

use super::loader::{Loader, Named, PROCESSES};
use super::scope::{At, LEVELS, LaunchContext, is_name, texts};
use super::types::{NodeRequest, Process, Ready, Refusal};
use crate::backoff::bad_seconds;
use crate::error::LaunchError;
use crate::faults::Faults;
use crate::file::{self, Entry, Text};

/// \[bytes\] that a regular expression takes once it is compiled: repetitions of repetitions take gigabytes.
const PATTERN: usize = 1 << 20;

/// What is run.
pub(super) struct Command {
    pub(super) own: bool,
    program: PathBuf,
    pub(super) arguments: Vec<String>,
    config: Option<Value>,
}

impl Loader<'_> {
    /// A process; keys in `bad` are there, but not as they should be.
    pub(super) fn process(
        &mut self,
        entry: &Entry,
        bad: &BTreeSet<String>,
        at: &At,
        context: &LaunchContext,
    ) {
        let before = self.faults.count();
        let mut inner = context.inside(
            at,
            entry.namespace.as_ref(),
            &entry.environment,
            entry.domain_id,
            entry.log.as_ref(),
            &mut self.faults,
        );
        self.reach(at, &mut inner, entry.network.as_ref(), entry.zenoh_config.as_ref());
        self.share(at, &mut inner, entry.container.as_ref());
        let label = self.label(entry, at, &inner);
        if label.is_none() {
            self.complete = false;
        }
        let label = label.unwrap_or_default();
        let command = self.command(entry, bad, &label, at, &inner);

        let own = command.as_ref().is_some_and(|command| command.own);
        let container = self.container(entry, command.as_ref(), at, &inner);
        let environment = environment(&inner, own);
        let directory = match &entry.directory {
            None => inner.folder.clone(),
            Some(directory) => inner.folder.join(&directory.0),
        };
        if !directory.is_dir() {
            self.faults.push(at.refuse("directory", format!("{} is no folder", directory.display())));
        }
        self.check_times(entry, at);
        let ready = entry.ready.as_ref().map(|ready| readiness(ready, at, &inner.folder, &mut self.faults));
        if self.named.len() == PROCESSES {
            let reason = format!("is one process too many: a launch starts {PROCESSES} at most");
            self.faults.tell(at.refuse("", reason));
        }
        self.named.push(Named {
            label: label.clone(),
            file: at.file.to_owned(),
            field: at.field.to_owned(),
            namespace: inner.namespace,
            after: texts(&entry.after),
            ready: ready.is_some() || bad.contains("ready"),
            container,
        });
        let (Some(Command { own, program, arguments, config }), ready) = (command, ready.flatten()) else {
            return;
        };
        if self.faults.count() > before {
            return;
        }
        self.processes.push(Process {
            label,
            file: at.file.to_owned(),
            field: at.field.to_owned(),
            own,
            program,
            arguments,
            config,
            nodes: Vec::new(),
            environment,
            directory,
            after: Vec::new(),
            ready,
            restart: entry.restart,
            backoff: entry.backoff.clone(),
            required: entry.required,
            stop: entry.stop.clone(),
        });
    }

    fn check_times(&mut self, entry: &Entry, at: &At) {
        if let Some((field, reason)) = entry.backoff.fault() {
            self.faults.push(at.refuse(&format!("backoff.{field}"), reason));
        }
        for (field, seconds) in [("interrupt", entry.stop.interrupt), ("terminate", entry.stop.terminate)] {
            if let Some(reason) = bad_seconds(seconds) {
                self.faults.push(at.refuse(&format!("stop.{field}"), reason));
            }
        }
    }

    /// Namespace and name of a process, if they can be used.
    fn label(&mut self, entry: &Entry, at: &At, inner: &LaunchContext) -> Option<String> {
        let Some(Text(name)) = &entry.name else {
            self.faults.push(at.refuse("name", "is missing; logs and `after` call the process by it"));
            return None;
        };
        let ros_name = entry.node.is_some() || entry.ros_args;
        if !is_name(name, !ros_name) {
            let more = if ros_name { "" } else { ", `-` or `.`" };
            self.faults.push(at.refuse(
                "name",
                format!(
                    "`{name}` is no name; it begins with a letter and goes on with letters, digits, `_`{more}"
                ),
            ));
            return None;
        }
        let label = format!("{}/{name}", inner.namespace).trim_start_matches('/').to_owned();
        if let Some(other) = self.named.iter().find(|named| named.label == label) {
            self.faults.push(at.refuse(
                "name",
                format!(
                    "`{label}` is the name of {} in {} too; give one of them another name or namespace",
                    other.field,
                    other.file.display()
                ),
            ));
        }
        Some(label)
    }

    fn command(
        &mut self,
        entry: &Entry,
        bad: &BTreeSet<String>,
        label: &str,
        at: &At,
        inner: &LaunchContext,
    ) -> Option<Command> {
        let remap = texts(&entry.remap);
        for (i, rule) in remap.iter().enumerate().filter(|(_, rule)| !rule.contains(":=")) {
            self.faults.push(at.refuse(&format!("remap[{i}]"), format!("`{rule}` is no `from:=to`")));
        }
        if entry.node.is_none() && !bad.contains("node") {
            for (field, given) in [("config", entry.config.is_some()), ("flags", !entry.flags.is_empty())] {
                if given {
                    self.faults.push(at.refuse(field, "only a `node` takes this"));
                }
            }
            for (field, given) in [("parameters", !entry.parameters.is_empty()), ("remap", !remap.is_empty())]
            {
                if given && !entry.ros_args {
                    let only = "only a `node`, or a `program` with `ros_args: true`, takes this";
                    self.faults.push(at.refuse(field, only));
                }
            }
        }
        if entry.ros_args && entry.program.is_none() && !bad.contains("program") {
            self.faults.push(at.refuse("ros_args", "only a `program` takes this"));
        }
        match (&entry.node, &entry.dermis, &entry.program) {
            (Some(Text(kind)), None, None) => self.node(entry, kind, &remap, label, at, inner),
            (None, Some(arguments), None) => {
                let arguments = texts(arguments);
                if let Err(reason) = self.host.check(&arguments) {
                    self.faults.push(at.refuse("dermis", reason));
                }
                Some(Command { own: true, program: self.host.program().to_owned(), arguments, config: None })
            }
            (None, None, Some(words)) => {
                let words = texts(words);
                let Some((program, rest)) = words.split_first() else {
                    self.faults.push(at.refuse("program", "is empty; give a program and its arguments"));
                    return None;
                };
                let file = find_program(program, inner)
                    .map_err(|reason| self.faults.push(at.refuse("program[0]", reason)))
                    .ok()?;
                let mut arguments = rest.to_vec();
                if entry.ros_args {
                    let name = entry.name.as_ref().map_or("", |name| name.0.as_str());
                    arguments.extend(ros_args(name, inner, &remap, &entry.parameters));
                }
                Some(Command { own: false, program: file, arguments, config: None })
            }
            (None, None, None) => {
                if !["node", "dermis", "program"].into_iter().any(|key| bad.contains(key)) {
                    self.faults.tell(at.refuse(
                        "",
                        "says not what to start; give one of `node`, `dermis`, `program`, `group`, `include`",
                    ));
                }
                None
            }
            _ => {
                let reason = "says twice what to start; leave one of `node`, `dermis`, `program`";
                self.faults.tell(at.refuse("", reason));
                None
            }
        }
    }

    fn node(
        &mut self,
        entry: &Entry,
        kind: &str,
        remap: &[String],
        label: &str,
        at: &At,
        inner: &LaunchContext,
    ) -> Option<Command> {
        let request = NodeRequest {
            kind,
            // One that has no name, or none that can be used, is checked all the same.
            name: label.rsplit('/').next().filter(|name| !name.is_empty()).unwrap_or("unnamed"),
            namespace: if inner.namespace.is_empty() { "/" } else { &inner.namespace },
            domain_id: inner.domain_id,
            remap,
            parameters: &entry.parameters,
            config: entry.config.as_ref().unwrap_or(&Value::Null),
            file: at.file,
            folder: &inner.folder,
        };
        // JSON is YAML too.
        let file = self.tmp.join(format!("{}.yaml", label.replace('/', ".")));
        let mut arguments = vec![kind.to_owned(), "--config".to_owned(), file.display().to_string()];
        arguments.extend(texts(&entry.flags));
        let config = self.host.node(&request);
        let known = !matches!(&config, Err(refusals) if refusals.iter().any(|r| r.field == "node"));
        if known && let Err(reason) = self.host.check(&arguments) {
            self.faults.push(at.refuse("flags", reason));
        }
        let config = match config {
            Ok(config) => config,
            Err(refusals) => {
                for Refusal { field, reason } in refusals {
                    self.faults.push(at.refuse(&field, reason));
                }
                return None;
            }
        };
        if let Err(error) = std::fs::write(&file, format!("{config:#}\n")) {
            let what = format!("{} cannot be written", file.display());
            self.faults.push(LaunchError::system(what, error));
        }
        let program = self.host.program().to_owned();
        Some(Command { own: true, program, arguments, config: Some(config) })
    }
}

/// The environment of a process: what the files set, and our own variables where they do not.
fn environment(inner: &LaunchContext, own: bool) -> BTreeMap<String, String> {
    let mut environment = inner.environment.clone();
    let mut preset = |name: &str, value: String| {
        environment.entry(name.to_owned()).or_insert(value);
    };
    if let Some(domain) = inner.domain_id {
        preset("ROS_DOMAIN_ID", domain.to_string());
    }
    for (name, value) in inner.network.iter().flat_map(|network| network.variables(own)) {
        preset(name, value);
    }
    if own {
        // So that levels and fields survive the way through the pipe.
        preset("DERMIS_LOG_FORMAT", "json".to_owned());
        if let Some(log) = &inner.log {
            preset("DERMIS_LOG", log.clone());
        }
    }
    environment
}

fn readiness(ready: &file::Ready, at: &At, folder: &Path, faults: &mut Faults) -> Option<Ready> {
    let bad = bad_seconds(ready.within);
    let seconds = if bad.is_some() { 0.0 } else { ready.within };
    if let Some(reason) = bad {
        faults.push(at.refuse("ready.within", reason));
    }
    let within = Duration::from_secs_f64(seconds);
    match (&ready.file, &ready.line) {
        (Some(Text(path)), None) => Some(Ready::File { path: folder.join(path), within }),
        (None, Some(Text(line))) => match RegexBuilder::new(line).size_limit(PATTERN).build() {
            Ok(pattern) => Some(Ready::Line { pattern, within }),
            Err(error) => {
                let error = dermis_io::one_line(&error.to_string());
                faults.push(at.refuse("ready.line", format!("is no regular expression: {error}")));
                None
            }
        },
        _ => {
            faults.push(at.refuse("ready", "needs one of `file` and `line`"));
            None
        }
    }
}

/// The file of a program: a path with `/` relative to the launch file, or a name on PATH.
fn find_program(program: &str, context: &LaunchContext) -> Result<PathBuf, String> {
    let runs =
        |path: &Path| path.is_file() && nix::unistd::access(path, nix::unistd::AccessFlags::X_OK).is_ok();
    if program.contains('/') {
        let path = context.folder.join(program);
        return if runs(&path) {
            Ok(path)
        } else {
            Err(format!("{} is no program; check the path and its permissions", path.display()))
        };
    }
    let search = context.environment.get("PATH").cloned().or_else(|| std::env::var("PATH").ok());
    std::env::split_paths(&search.unwrap_or_default())
        .map(|folder| folder.join(program))
        .find(|path| runs(path))
        .ok_or_else(|| format!("`{program}` is not on PATH; install it, or give its path"))
}

/// `--ros-args` with name, namespace, remappings, parameters and log level.
fn ros_args(
    name: &str,
    context: &LaunchContext,
    remap: &[String],
    parameters: &Map<String, Value>,
) -> Vec<String> {
    let mut all = vec!["--ros-args".to_owned()];
    let mut rule = |flag: &str, rule: String| all.extend([flag.to_owned(), rule]);
    rule("-r", format!("__node:={name}"));
    if !context.namespace.is_empty() {
        rule("-r", format!("__ns:={}", context.namespace));
    }
    for remapping in remap {
        rule("-r", remapping.clone());
    }
    for (name, value) in parameters {
        // JSON is YAML, which is what ROS reads here.
        rule("-p", format!("{name}:={value}"));
    }
    // ROS has neither `trace` nor `off`, and does not know our filters.
    match context.log.as_deref() {
        Some("trace") => rule("--log-level", "debug".to_owned()),
        Some("off") => rule("--log-level", "fatal".to_owned()),
        Some(level) if LEVELS.contains(&level) => rule("--log-level", level.to_owned()),
        _ => {}
    }
    all
}
