//! Where findings go: standard output, and a folder of files.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use dermis_io::pipe::ReaderGone;
use dermis_operate::{OperateError, Progress};
use serde::Serialize;

/// How findings are printed, and where their files go.
#[derive(Args)]
pub struct Output {
    /// Folder for a page (HTML) and a record (JSON) of what was found.
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// One JSON object in place of the text.
    #[arg(long)]
    pub json: bool,
}

/// Writes files of a folder that is made where it is missing.
pub fn save(folder: &Path, files: &[(&str, String)]) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("folder {} cannot be made", folder.display()))?;
    for (name, text) in files {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    Ok(())
}

/// Prints findings as one JSON object, or as text.
pub fn print(json: bool, findings: &impl Serialize, text: &str) -> Result<()> {
    if json {
        println!("{}", serde_json::to_string(findings)?);
    } else {
        print!("{text}");
    }
    Ok(())
}

/// Sentences on standard error, where they do not mix with what is printed.
pub struct StandardError;

impl Progress for StandardError {
    fn note(&self, sentence: &str) {
        eprintln!("{sentence}");
    }
}

/// What came of showing something. Where nobody reads the output any more, the program still ends as it does by Ctrl-C, so that its
/// device and its files go, too.
pub fn shown<T>(done: Result<T, OperateError>) -> Result<T> {
    done.map_err(|error| match error {
        OperateError::Io(error) if error.kind() == ErrorKind::BrokenPipe => ReaderGone.into(),
        other => other.into(),
    })
}
