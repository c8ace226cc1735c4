//! The way through a launch file: files, groups and includes, down to the entries.
//!
//! Every mistake is collected with its file and field, so that one reading names all of them. What a file may cost is bounded:
//! depth, files and processes.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::arguments::arguments;
use super::scope::{At, LaunchContext, Network, is_name};
use super::types::{Declared, Host, Process};
use crate::error::LaunchError;
use crate::faults::Faults;
use crate::file::{self, Entry, File, Group, Include, Text};
use crate::log::LogLimits;
use crate::substitute::Scope;

/// Files within files, so that two that include each other end with a sentence.
const DEEPEST: usize = 16;
/// Files that a launch reads, each as often as it is included: a few files that include each other many times would never end.
const FILES: usize = 256;
/// Processes that a launch starts.
pub(super) const PROCESSES: usize = 1024;

/// An entry with a name, whether it can be started or not.
pub(super) struct Named {
    pub(super) label: String,
    pub(super) file: PathBuf,
    pub(super) field: String,
    pub(super) namespace: String,
    pub(super) after: Vec<String>,
    /// Whether it has the key `ready`, valid or not.
    pub(super) ready: bool,
    /// Process that it shares with others.
    pub(super) container: Option<String>,
}

/// What was read so far.
pub(super) struct Loader<'a> {
    pub(super) host: &'a dyn Host,
    pub(super) cwd: PathBuf,
    pub(super) tmp: PathBuf,
    /// What can be started. As long as nothing is wrong, there is one for each of `named`.
    pub(super) processes: Vec<Process>,
    pub(super) named: Vec<Named>,
    /// Whether all names are known: no file or entry was left out.
    pub(super) complete: bool,
    pub(super) open: Vec<PathBuf>,
    /// Files that were read.
    pub(super) files: usize,
    /// What `${…}` may still put in.
    pub(super) room: Cell<usize>,
    /// Of the outermost file.
    pub(super) log_limits: LogLimits,
    pub(super) faults: Faults,
}

impl Loader<'_> {
    /// Reads a file and all that it includes; returns the arguments that it declares.
    pub(super) fn file(
        &mut self,
        path: &Path,
        given: BTreeMap<String, String>,
        context: &LaunchContext,
    ) -> Vec<Declared> {
        let read = self.tree(path).and_then(|tree| Ok((tree, self.enter(path)?)));
        let (mut tree, folder) = match read {
            Ok(read) => read,
            Err(error) => {
                self.complete = false;
                self.faults.push(error);
                return Vec::new();
            }
        };
        let mut values: BTreeMap<String, String> =
            [("here", &folder), ("cwd", &self.cwd), ("tmp", &self.tmp)]
                .map(|(name, folder)| (name.to_owned(), folder.display().to_string()))
                .into();
        let room = Some(&self.room);
        let scope = Scope { values: values.clone(), room };
        let declared = arguments(&tree, given, path, &scope, context, &folder, &mut self.faults);
        values.extend(declared.iter().map(|a| (a.name.clone(), a.value.clone())));
        if let Value::Object(fields) = &mut tree {
            fields.remove("arguments");
        }
        Scope { values, room }.tree(&mut tree, "", false, &mut |field, reason| {
            self.faults.push(LaunchError::Field { path: path.to_owned(), field, reason });
        });
        let (file, _) = file::typed::<File>(tree, path, "", &mut self.faults);
        if let Some(file) = file {
            let at = At { file: path, field: "" };
            if let Err((field, reason)) = file.log_limits.check() {
                self.faults.push(at.refuse(&format!("log_limits.{field}"), reason));
            }
            if self.open.len() == 1 {
                self.log_limits = file.log_limits.clone();
            }
            let mut inner = context.inside(
                &at,
                file.namespace.as_ref(),
                &file.environment,
                file.domain_id,
                file.log.as_ref(),
                &mut self.faults,
            );
            inner.folder = folder;
            self.reach(&at, &mut inner, file.network.as_ref(), file.zenoh_config.as_ref());
            self.share(&at, &mut inner, file.container.as_ref());
            self.entries(file.processes, &at, &inner);
        } else {
            self.complete = false;
        }
        self.open.pop();
        declared
    }

    /// The content of a file, if there are not too many.
    fn tree(&mut self, path: &Path) -> Result<Value, LaunchError> {
        self.files += 1;
        if self.files > FILES {
            return Err(LaunchError::Read {
                path: path.to_owned(),
                reason: format!(
                    "is one file too many: a launch reads {FILES} at most, each as often as it is included"
                ),
            });
        }
        file::read(path)
    }

    /// Notes that a file is open; returns its folder.
    fn enter(&mut self, path: &Path) -> Result<PathBuf, LaunchError> {
        let real = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if self.open.len() >= DEEPEST || self.open.contains(&real) {
            return Err(LaunchError::Read {
                path: path.to_owned(),
                reason: "is included by itself, directly or through others; remove that `include`".to_owned(),
            });
        }
        self.open.push(real);
        let absolute = std::path::absolute(path).unwrap_or_else(|_| self.cwd.join(path));
        Ok(absolute.parent().unwrap_or(Path::new("/")).to_owned())
    }

    fn entries(&mut self, entries: Vec<Value>, at: &At, context: &LaunchContext) {
        if entries.is_empty() {
            self.faults.push(at.refuse("processes", "is empty; give at least one process"));
        }
        for (i, entry) in entries.into_iter().enumerate() {
            if self.faults.full() || self.files > FILES || self.named.len() > PROCESSES {
                self.complete = false;
                return;
            }
            let prefix = if at.field.is_empty() { String::new() } else { format!("{}.", at.field) };
            let path = format!("{prefix}processes[{i}]");
            self.entry(entry, &At { field: &path, file: at.file }, context);
        }
    }

    /// Applies the keys `network` and `zenoh_config`; the inner one wins.
    pub(super) fn reach(
        &mut self,
        at: &At,
        context: &mut LaunchContext,
        network: Option<&Text>,
        file: Option<&Text>,
    ) {
        match (network, file) {
            (None, None) => {}
            (Some(_), Some(_)) => {
                let reason = "stands beside `zenoh_config`, which says all of it; leave one";
                self.faults.push(at.refuse("network", reason));
            }
            (Some(Text(reach)), None) => {
                if let Err(reason) = self.host.network(reach) {
                    self.faults.push(at.refuse("network", reason));
                }
                context.network = Some(Network::Reach(reach.clone()));
            }
            (None, Some(Text(file))) => {
                let path = context.folder.join(file);
                if !path.is_file() {
                    let reason = format!("{} is no file; check the path", path.display());
                    self.faults.push(at.refuse("zenoh_config", reason));
                }
                context.network = Some(Network::File(path));
            }
        }
    }

    /// Applies the key `container`; the inner one wins, and an empty one is none.
    pub(super) fn share(&mut self, at: &At, context: &mut LaunchContext, container: Option<&Text>) {
        let Some(Text(name)) = container else { return };
        if !name.is_empty() && !is_name(name, true) {
            self.faults.push(at.refuse(
                "container",
                format!("`{name}` is no name; it begins with a letter and goes on with letters, digits, `_`, `-` or `.`"),
            ));
        }
        context.container = (!name.is_empty()).then(|| name.clone());
    }

    fn entry(&mut self, value: Value, at: &At, context: &LaunchContext) {
        let outer = ["group", "include"].into_iter().find(|key| value.get(key).is_some());
        if let (Some(key), Value::Object(fields)) = (outer, &value) {
            for other in fields.keys().filter(|k| *k != key) {
                let reason = format!("stands beside `{key}`; move it into the `{key}`, or remove it");
                self.faults.push(at.refuse(other, reason));
            }
        }
        match (outer, value) {
            (Some("group"), mut value) => self.group(value["group"].take(), at, context),
            (Some(_), mut value) => self.include(value["include"].take(), at, context),
            (None, value) => match file::typed::<Entry>(value, at.file, at.field, &mut self.faults) {
                (Some(entry), bad) => self.process(&entry, &bad, at, context),
                (None, _) => self.complete = false,
            },
        }
    }

    fn group(&mut self, group: Value, at: &At, context: &LaunchContext) {
        let path = format!("{}.group", at.field);
        let at = At { field: &path, file: at.file };
        let (Some(group), _) = file::typed::<Group>(group, at.file, at.field, &mut self.faults) else {
            self.complete = false;
            return;
        };
        let mut inner = context.inside(
            &at,
            group.namespace.as_ref(),
            &group.environment,
            group.domain_id,
            group.log.as_ref(),
            &mut self.faults,
        );
        self.reach(&at, &mut inner, group.network.as_ref(), group.zenoh_config.as_ref());
        self.share(&at, &mut inner, group.container.as_ref());
        self.entries(group.processes, &at, &inner);
    }

    fn include(&mut self, include: Value, at: &At, context: &LaunchContext) {
        let path = format!("{}.include", at.field);
        let at = At { field: &path, file: at.file };
        let (Some(include), _) = file::typed::<Include>(include, at.file, at.field, &mut self.faults) else {
            self.complete = false;
            return;
        };
        let mut inner = context.inside(
            &at,
            include.namespace.as_ref(),
            &include.environment,
            include.domain_id,
            include.log.as_ref(),
            &mut self.faults,
        );
        self.reach(&at, &mut inner, include.network.as_ref(), include.zenoh_config.as_ref());
        self.share(&at, &mut inner, include.container.as_ref());
        let path = context.folder.join(&include.file.0);
        if !path.exists() {
            self.complete = false;
            self.faults.push(at.refuse("file", format!("{} is no file; check the path", path.display())));
            return;
        }
        let given = include.arguments.iter().map(|(name, value)| (name.clone(), value.0.clone())).collect();
        self.file(&path, given, &inner);
    }
}
