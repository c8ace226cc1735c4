//! The plan of a launch: what is started, in which order, and how.
//!
//! [`load`] reads a launch file and all that it includes into a [`Plan`]. `types` has the plan itself, `loader` the way through
//! files, groups and includes, `process` a single entry, `container` nodes that share a process, `arguments` the arguments that a
//! file declares, `scope` what groups and files set for the entries within them, `order` what waits for what, and `print` a plan
//! for people and programs.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::Path;

use crate::error::{LaunchError, LaunchErrors};
use crate::faults::Faults;
use crate::log::LogLimits;
use crate::substitute::PUT_IN;
use loader::Loader;
use scope::LaunchContext;

pub use container::NODE_SEPARATOR;
pub use types::{Declared, Host, NodeRequest, Plan, Process, Ready, Refusal, Restart, SharedNode, Stop};

mod arguments;
mod container;
mod loader;
mod order;
mod print;
mod process;
mod scope;
mod types;

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
    let outer = LaunchContext { folder: loader.cwd.clone(), ..LaunchContext::default() };
    let declared = loader.file(path, given, &outer);
    let waits = loader.waits();
    loader.beside();
    let processes = loader.with_containers(&waits);
    let log_limits = loader.log_limits;
    loader.faults.or(Plan { file: path.to_owned(), arguments: declared, processes, log_limits })
}

#[cfg(test)]
mod tests;
