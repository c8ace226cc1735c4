//! From launch files to what is started.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use regex::{Regex, RegexBuilder};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::backoff::{Backoff, bad_seconds};
use crate::error::{LaunchError, LaunchErrors};
use crate::faults::Faults;
use crate::file::{self, Argument, Entry, File, Group, Include, Text, loose};
use crate::log::LogLimits;
use crate::substitute::{PUT_IN, Scope};

/// Files within files, so that two that include each other end with a sentence.
const DEEPEST: usize = 16;
/// Files that a launch reads, each as often as it is included: a few files that include each other in turn would be read for years.
const FILES: usize = 256;
/// Processes that a launch starts.
const PROCESSES: usize = 1024;
/// \[bytes\] that a regular expression takes once it is compiled: repetitions of repetitions take gigabytes.
const PATTERN: usize = 1 << 20;
/// What `log` may say, beside filters.
const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];
/// What `${…}` gives in every file.
const FOLDERS: [&str; 3] = ["here", "cwd", "tmp"];

/// What the program that launches knows and this crate does not: its own nodes and commands.
pub trait Host {
    /// The program's own file, which runs its nodes and commands.
    fn program(&self) -> &Path;

    /// Whether the program takes these arguments.
    ///
    /// # Errors
    ///
    /// One sentence on what it does not take.
    fn check(&self, arguments: &[String]) -> Result<(), String>;

    /// Whether `text` says how far a program reaches over the network.
    ///
    /// # Errors
    ///
    /// One sentence on what would.
    fn network(&self, text: &str) -> Result<(), String>;

    /// The configuration of a node, checked as far as can be without starting it, with absolute paths.
    ///
    /// # Errors
    ///
    /// The fields that cannot be used, and why.
    fn node(&self, request: &NodeRequest<'_>) -> Result<Value, Vec<Refusal>>;

    /// Which of these nodes cannot run beside each other: label and configuration, as [`node`](Self::node) gave it, of each. Of those
    /// that cannot, its index, its field, and why.
    fn together(&self, nodes: &[(&str, &Value)]) -> Vec<(usize, Refusal)> {
        let _ = nodes;
        Vec::new()
    }
}

/// A node that a launch file asks for.
#[derive(Debug)]
#[non_exhaustive]
pub struct NodeRequest<'a> {
    /// Which node, as the command that runs it.
    pub kind: &'a str,
    /// Node name.
    pub name: &'a str,
    /// Full namespace.
    pub namespace: &'a str,
    /// ROS domain, where the file names one.
    pub domain_id: Option<u16>,
    /// Remappings `from:=to`.
    pub remap: &'a [String],
    /// Start values of parameters.
    pub parameters: &'a Map<String, Value>,
    /// The rest of its configuration: a table, or the path of a file; null where absent.
    pub config: &'a Value,
    /// Launch file that asks.
    pub file: &'a Path,
    /// Folder that relative paths start at.
    pub folder: &'a Path,
}

/// A field of a process that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// Path of the field within the process, e.g. `config.skin`.
    pub field: String,
    /// What is wrong, and what to do.
    pub reason: String,
}

/// When a process that ended by itself is started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// Never.
    #[default]
    Never,
    /// Where it ended with another exit code than 0, by a signal, or was not ready in time.
    OnFailure,
    /// However it ended.
    Always,
}

/// How a process is stopped: an interrupt (as Ctrl-C), then SIGTERM, then SIGKILL.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stop {
    /// \[s\] from the interrupt to SIGTERM.
    #[serde(deserialize_with = "loose")]
    pub interrupt: f64,
    /// \[s\] from SIGTERM to SIGKILL.
    #[serde(deserialize_with = "loose")]
    pub terminate: f64,
}

impl Default for Stop {
    fn default() -> Self {
        Self { interrupt: 5.0, terminate: 2.0 }
    }
}

/// What shows that a process can be used.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Ready {
    /// A file, link or folder that was not there before its start, or is another one since.
    File {
        /// Where.
        path: PathBuf,
        /// Longest wait.
        within: Duration,
    },
    /// A line that it prints.
    Line {
        /// What is found in it.
        pattern: Regex,
        /// Longest wait.
        within: Duration,
    },
}

/// One process.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Process {
    /// Namespace and name, as logs and `after` call it: `left/pad`.
    pub label: String,
    /// Launch file that asks for it.
    pub file: PathBuf,
    /// Path of its entry in that file.
    pub field: String,
    /// Whether it is this program itself.
    pub own: bool,
    /// Program file.
    pub program: PathBuf,
    /// Arguments.
    pub arguments: Vec<String>,
    /// Configuration of a node, as it is written to the file that `arguments` names.
    pub config: Option<Value>,
    /// Variables on top of the environment of the launch.
    pub environment: BTreeMap<String, String>,
    /// Working directory.
    pub directory: PathBuf,
    /// Processes of the plan that must be ready before.
    pub after: Vec<usize>,
    /// What shows that it can be used; at once where absent.
    pub ready: Option<Ready>,
    /// When it is started again.
    pub restart: Restart,
    /// How long after.
    pub backoff: Backoff,
    /// Whether its end is the end of the launch.
    pub required: bool,
    /// How it is stopped.
    pub stop: Stop,
}

impl Process {
    /// Says who can reach it over the network, whatever the file says: a reach as `--network` takes it, or the path of a
    /// configuration file of zenoh.
    pub fn set_network(&mut self, reach: bool, value: &str) {
        let network =
            if reach { Network::Reach(value.to_owned()) } else { Network::File(PathBuf::from(value)) };
        let variables = network.variables(self.own);
        self.environment.extend(variables.into_iter().map(|(name, value)| (name.to_owned(), value)));
    }
}

/// An argument of a launch file.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Declared {
    /// Name.
    pub name: String,
    /// Its value in this launch.
    pub value: String,
    /// What it is for.
    pub about: String,
}

/// What is started, in this order.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Plan {
    /// The launch file.
    pub file: PathBuf,
    /// Its arguments.
    pub arguments: Vec<Declared>,
    /// Its processes.
    pub processes: Vec<Process>,
    /// How much they may log.
    pub log_limits: LogLimits,
}

/// Reads a launch file with these arguments (`name:=value`); configurations of nodes, and what files call `${tmp}`, go
/// to the folder `tmp`, which must last as long as the processes.
///
/// # Errors
///
/// [`LaunchErrors`] names every mistake with the file and the field or argument.
pub fn load(path: &Path, arguments: &[String], tmp: &Path, host: &dyn Host) -> Result<Plan, LaunchErrors> {
    let cwd = std::env::current_dir()
        .map_err(|e| LaunchError::system("the working directory cannot be found out", e))?;
    let mut faults = Faults::default();
    let mut given = BTreeMap::new();
    for argument in arguments {
        let mut refuse = |reason: &str| {
            faults.push(LaunchError::Argument {
                path: path.to_owned(),
                argument: argument.clone(),
                reason: reason.to_owned(),
            });
        };
        match argument.split_once(":=") {
            None => refuse("is none; write `name:=value`"),
            Some((name, value)) => {
                if given.insert(name.to_owned(), value.to_owned()).is_some() {
                    refuse("is given twice; leave one");
                }
            }
        }
    }
    let mut loader = Loader {
        host,
        cwd,
        tmp: tmp.to_owned(),
        processes: Vec::new(),
        named: Vec::new(),
        complete: true,
        open: Vec::new(),
        files: 0,
        room: Cell::new(PUT_IN),
        log_limits: LogLimits::default(),
        faults,
    };
    let outer = Around { folder: loader.cwd.clone(), ..Around::default() };
    let declared = loader.file(path, given, &outer);
    let waits = loader.waits();
    loader.beside();
    let mut processes = loader.processes;
    for (process, after) in processes.iter_mut().zip(waits) {
        process.after = after;
    }
    let log_limits = loader.log_limits;
    loader.faults.or(Plan { file: path.to_owned(), arguments: declared, processes, log_limits })
}

/// What groups and files around an entry say.
#[derive(Debug, Clone, Default)]
struct Around {
    namespace: String,
    environment: BTreeMap<String, String>,
    domain_id: Option<u16>,
    network: Option<Network>,
    log: Option<String>,
    /// Folder of the file.
    folder: PathBuf,
}

/// Who can reach processes over the network.
#[derive(Debug, Clone)]
enum Network {
    /// As `--network` takes it.
    Reach(String),
    /// A configuration file of zenoh.
    File(PathBuf),
}

impl Network {
    /// The variables that tell a process: ours for our own programs, those of ROS 2 for others. An empty one counts as unset,
    /// and takes away what the launch itself was told.
    fn variables(&self, own: bool) -> Vec<(&'static str, String)> {
        let pairs = match (self, own) {
            (Self::Reach(reach), true) => {
                [("DERMIS_NETWORK", reach.clone()), ("DERMIS_ZENOH_CONFIG", String::new())]
            }
            (Self::File(file), true) => {
                [("DERMIS_NETWORK", String::new()), ("DERMIS_ZENOH_CONFIG", file.display().to_string())]
            }
            (Self::File(file), false) => {
                return vec![("ZENOH_SESSION_CONFIG_URI", file.display().to_string())];
            }
            (Self::Reach(reach), false) => {
                let range = match reach.as_str() {
                    "loopback" => "LOCALHOST",
                    "lan" => "SUBNET",
                    "off" => "OFF",
                    // ROS 2 cannot be told an address.
                    _ => return vec![],
                };
                [("ROS_AUTOMATIC_DISCOVERY_RANGE", range.to_owned()), ("ROS_LOCALHOST_ONLY", "0".to_owned())]
            }
        };
        pairs.into()
    }
}

/// What has a name, whether it can be started or not.
struct Named {
    label: String,
    file: PathBuf,
    field: String,
    namespace: String,
    after: Vec<String>,
    /// Whether it says when it is ready, or tries to.
    ready: bool,
}

/// What is run.
struct Command {
    own: bool,
    program: PathBuf,
    arguments: Vec<String>,
    config: Option<Value>,
}

struct Loader<'a> {
    host: &'a dyn Host,
    cwd: PathBuf,
    tmp: PathBuf,
    /// What can be started. As long as nothing is wrong, there is one for each of `named`.
    processes: Vec<Process>,
    named: Vec<Named>,
    /// Whether all names are known: no file or entry was left out.
    complete: bool,
    open: Vec<PathBuf>,
    /// Files that were read.
    files: usize,
    /// What `${…}` may still put in.
    room: Cell<usize>,
    /// Of the outermost file.
    log_limits: LogLimits,
    faults: Faults,
}

/// Errors of one field of a file.
struct At<'a> {
    file: &'a Path,
    field: &'a str,
}

impl At<'_> {
    fn refuse(&self, field: &str, reason: impl Into<String>) -> LaunchError {
        let field = match (self.field, field) {
            ("", field) => field.to_owned(),
            (at, "") => at.to_owned(),
            (at, field) => format!("{at}.{field}"),
        };
        LaunchError::Field { path: self.file.to_owned(), field, reason: reason.into() }
    }
}

impl Loader<'_> {
    /// Reads a file and all that it includes; what it declares.
    fn file(&mut self, path: &Path, given: BTreeMap<String, String>, around: &Around) -> Vec<Declared> {
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
        let declared = arguments(&tree, given, path, &scope, around, &folder, &mut self.faults);
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
            let mut inner = around.inside(
                &at,
                file.namespace.as_ref(),
                &file.environment,
                file.domain_id,
                file.log.as_ref(),
                &mut self.faults,
            );
            inner.folder = folder;
            self.reach(&at, &mut inner, file.network.as_ref(), file.zenoh_config.as_ref());
            self.entries(file.processes, &at, &inner);
        } else {
            self.complete = false;
        }
        self.open.pop();
        declared
    }

    /// What a file says, if it may be read.
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

    /// Notes that a file is open; its folder.
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

    fn entries(&mut self, entries: Vec<Value>, at: &At, around: &Around) {
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
            self.entry(entry, &At { field: &path, file: at.file }, around);
        }
    }

    /// Takes the keys `network` and `zenoh_config` into what is around; the inner one wins.
    fn reach(&mut self, at: &At, around: &mut Around, network: Option<&Text>, file: Option<&Text>) {
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
                around.network = Some(Network::Reach(reach.clone()));
            }
            (None, Some(Text(file))) => {
                let path = around.folder.join(file);
                if !path.is_file() {
                    let reason = format!("{} is no file; check the path", path.display());
                    self.faults.push(at.refuse("zenoh_config", reason));
                }
                around.network = Some(Network::File(path));
            }
        }
    }

    fn entry(&mut self, value: Value, at: &At, around: &Around) {
        let outer = ["group", "include"].into_iter().find(|key| value.get(key).is_some());
        if let (Some(key), Value::Object(fields)) = (outer, &value) {
            for other in fields.keys().filter(|k| *k != key) {
                let reason = format!("stands beside `{key}`; move it into the `{key}`, or remove it");
                self.faults.push(at.refuse(other, reason));
            }
        }
        match (outer, value) {
            (Some("group"), mut value) => self.group(value["group"].take(), at, around),
            (Some(_), mut value) => self.include(value["include"].take(), at, around),
            (None, value) => match file::typed::<Entry>(value, at.file, at.field, &mut self.faults) {
                (Some(entry), bad) => self.process(&entry, &bad, at, around),
                (None, _) => self.complete = false,
            },
        }
    }

    fn group(&mut self, group: Value, at: &At, around: &Around) {
        let path = format!("{}.group", at.field);
        let at = At { field: &path, file: at.file };
        let (Some(group), _) = file::typed::<Group>(group, at.file, at.field, &mut self.faults) else {
            self.complete = false;
            return;
        };
        let mut inner = around.inside(
            &at,
            group.namespace.as_ref(),
            &group.environment,
            group.domain_id,
            group.log.as_ref(),
            &mut self.faults,
        );
        self.reach(&at, &mut inner, group.network.as_ref(), group.zenoh_config.as_ref());
        self.entries(group.processes, &at, &inner);
    }

    fn include(&mut self, include: Value, at: &At, around: &Around) {
        let path = format!("{}.include", at.field);
        let at = At { field: &path, file: at.file };
        let (Some(include), _) = file::typed::<Include>(include, at.file, at.field, &mut self.faults) else {
            self.complete = false;
            return;
        };
        let mut inner = around.inside(
            &at,
            include.namespace.as_ref(),
            &include.environment,
            include.domain_id,
            include.log.as_ref(),
            &mut self.faults,
        );
        self.reach(&at, &mut inner, include.network.as_ref(), include.zenoh_config.as_ref());
        let path = around.folder.join(&include.file.0);
        if !path.exists() {
            self.complete = false;
            self.faults.push(at.refuse("file", format!("{} is no file; check the path", path.display())));
            return;
        }
        let given = include.arguments.iter().map(|(name, value)| (name.clone(), value.0.clone())).collect();
        self.file(&path, given, &inner);
    }

    /// A process; keys in `bad` are there, but not as they should be.
    fn process(&mut self, entry: &Entry, bad: &BTreeSet<String>, at: &At, around: &Around) {
        let before = self.faults.count();
        let mut inner = around.inside(
            at,
            entry.namespace.as_ref(),
            &entry.environment,
            entry.domain_id,
            entry.log.as_ref(),
            &mut self.faults,
        );
        self.reach(at, &mut inner, entry.network.as_ref(), entry.zenoh_config.as_ref());
        let label = self.label(entry, at, &inner);
        if label.is_none() {
            self.complete = false;
        }
        let label = label.unwrap_or_default();
        let command = self.command(entry, bad, &label, at, &inner);

        let mut environment = inner.environment.clone();
        let mut preset = |name: &str, value: String| {
            environment.entry(name.to_owned()).or_insert(value);
        };
        if let Some(domain) = inner.domain_id {
            preset("ROS_DOMAIN_ID", domain.to_string());
        }
        let own = command.as_ref().is_some_and(|command| command.own);
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
        let directory = match &entry.directory {
            None => inner.folder.clone(),
            Some(directory) => inner.folder.join(&directory.0),
        };
        if !directory.is_dir() {
            self.faults.push(at.refuse("directory", format!("{} is no folder", directory.display())));
        }
        if let Some((field, reason)) = entry.backoff.fault() {
            self.faults.push(at.refuse(&format!("backoff.{field}"), reason));
        }
        for (field, seconds) in [("interrupt", entry.stop.interrupt), ("terminate", entry.stop.terminate)] {
            if let Some(reason) = bad_seconds(seconds) {
                self.faults.push(at.refuse(&format!("stop.{field}"), reason));
            }
        }
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

    /// Namespace and name of a process, if they can be used.
    fn label(&mut self, entry: &Entry, at: &At, inner: &Around) -> Option<String> {
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
        inner: &Around,
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
        inner: &Around,
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

    /// Asks whether the nodes can run beside each other.
    fn beside(&mut self) {
        let nodes: Vec<(&Process, &Value)> =
            self.processes.iter().filter_map(|p| Some((p, p.config.as_ref()?))).collect();
        let asked: Vec<(&str, &Value)> =
            nodes.iter().map(|(p, config)| (p.label.as_str(), *config)).collect();
        for (i, Refusal { field, reason }) in self.host.together(&asked) {
            let process = nodes[i].0;
            self.faults.push(At { file: &process.file, field: &process.field }.refuse(&field, reason));
        }
    }

    /// What each process waits for, as indices.
    fn waits(&mut self) -> Vec<Vec<usize>> {
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

/// The arguments that a file declares, with their values; one that cannot be used has the text that it has in the file.
fn arguments(
    tree: &Value,
    mut given: BTreeMap<String, String>,
    path: &Path,
    scope: &Scope,
    around: &Around,
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
            (Some(value), _) => (value, &around.folder),
            (None, Some(Text(default))) => {
                let value = scope.text(&default).unwrap_or_else(|reason| {
                    faults.push(at.refuse(name, reason));
                    default
                });
                (value, &folder.to_owned())
            }
            (None, None) => {
                faults.push(at.refuse(name, format!("has no default; give it: `{name}:=VALUE`")));
                (String::new(), &around.folder)
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

impl Around {
    fn inside(
        &self,
        at: &At,
        namespace: Option<&Text>,
        environment: &BTreeMap<String, Text>,
        domain_id: Option<u16>,
        log: Option<&Text>,
        faults: &mut Faults,
    ) -> Self {
        let mut inner = self.clone();
        if let Some(Text(namespace)) = namespace {
            let joined = match namespace.strip_prefix('/') {
                Some(absolute) => absolute.to_owned(),
                None => format!("{}/{namespace}", self.namespace),
            };
            let tokens: Vec<&str> = joined.split('/').filter(|t| !t.is_empty()).collect();
            if let Some(bad) = tokens.iter().find(|token| !is_name(token, false)) {
                faults.push(at.refuse(
                    "namespace",
                    format!("`{bad}` is no part of a namespace; it begins with a letter and goes on with letters, digits or `_`"),
                ));
            }
            inner.namespace = tokens.iter().fold(String::new(), |all, token| all + "/" + token);
        }
        for (name, Text(value)) in environment {
            if name.is_empty() || name.contains(['=', '\0']) || value.contains('\0') {
                faults.push(at.refuse(&format!("environment.{name}"), "is no environment variable"));
            }
            inner.environment.insert(name.clone(), value.clone());
        }
        if let Some(domain) = domain_id {
            if domain > 232 {
                faults.push(at.refuse("domain_id", format!("{domain} is no ROS domain; give 0 to 232")));
            }
            inner.domain_id = Some(domain);
        }
        if let Some(Text(log)) = log {
            if !LEVELS.contains(&log.as_str()) && !log.contains(['=', ',']) {
                faults.push(at.refuse(
                    "log",
                    format!(
                        "`{log}` is no level; give one of {}, or a filter such as `info,dermis_node=debug`",
                        LEVELS.join(", ")
                    ),
                ));
            }
            inner.log = Some(log.clone());
        }
        inner
    }
}

fn texts(texts: &[Text]) -> Vec<String> {
    texts.iter().map(|text| text.0.clone()).collect()
}

fn is_name(name: &str, free: bool) -> bool {
    let more = |c: char| c.is_ascii_alphanumeric() || c == '_' || (free && (c == '-' || c == '.'));
    name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') && name.chars().all(more)
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
                let error = file::one_line(&error.to_string());
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
fn find_program(program: &str, around: &Around) -> Result<PathBuf, String> {
    let runs =
        |path: &Path| path.is_file() && nix::unistd::access(path, nix::unistd::AccessFlags::X_OK).is_ok();
    if program.contains('/') {
        let path = around.folder.join(program);
        return if runs(&path) {
            Ok(path)
        } else {
            Err(format!("{} is no program; check the path and its permissions", path.display()))
        };
    }
    let search = around.environment.get("PATH").cloned().or_else(|| std::env::var("PATH").ok());
    std::env::split_paths(&search.unwrap_or_default())
        .map(|folder| folder.join(program))
        .find(|path| runs(path))
        .ok_or_else(|| format!("`{program}` is not on PATH; install it, or give its path"))
}

/// How a program of ROS 2 is told its name, namespace, remappings and parameters.
fn ros_args(name: &str, around: &Around, remap: &[String], parameters: &Map<String, Value>) -> Vec<String> {
    let mut all = vec!["--ros-args".to_owned()];
    let mut rule = |flag: &str, rule: String| all.extend([flag.to_owned(), rule]);
    rule("-r", format!("__node:={name}"));
    if !around.namespace.is_empty() {
        rule("-r", format!("__ns:={}", around.namespace));
    }
    for remapping in remap {
        rule("-r", remapping.clone());
    }
    for (name, value) in parameters {
        // JSON is YAML, which is what ROS reads here.
        rule("-p", format!("{name}:={value}"));
    }
    // ROS has no word for the ends of our scale, and does not know our filters.
    match around.log.as_deref() {
        Some("trace") => rule("--log-level", "debug".to_owned()),
        Some("off") => rule("--log-level", "fatal".to_owned()),
        Some(level) if LEVELS.contains(&level) => rule("--log-level", level.to_owned()),
        _ => {}
    }
    all
}

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

/// What a configuration says, without what it leaves open.
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

#[cfg(test)]
mod tests;
