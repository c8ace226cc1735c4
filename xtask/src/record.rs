//! Records of what was measured: `benches/results/NAME.json`, each written with the command, the commit and the machine that it is of.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::run::output;

/// Where the record of a name lies.
pub fn path(root: &Path, name: &str) -> PathBuf {
    root.join(format!("benches/results/{name}.json"))
}

/// The commit that is measured.
pub fn commit(root: &Path) -> Result<String> {
    let text = output(Command::new("git").args(["rev-parse", "--short", "HEAD"]).current_dir(root))?;
    Ok(text.trim().to_owned())
}

/// Writes a record as it is.
pub fn write(path: &Path, value: &Value) -> Result<()> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    std::fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}

/// The command that this program was started by.
pub fn command() -> String {
    std::iter::once("cargo xtask".to_owned()).chain(std::env::args().skip(1)).collect::<Vec<_>>().join(" ")
}

/// Writes what this program measured as the record of a name.
pub fn keep(root: &Path, name: &str, measured: &Value) -> Result<()> {
    let mut record = measured.clone();
    sign(&mut record, &command(), &commit(root)?)?;
    write(&path(root, name), &record)
}

/// Makes what another program measured the record of a name, where it wrote its file: with `--help` it measures nothing.
pub fn take(root: &Path, name: &str, file: &Path) -> Result<()> {
    if !file.exists() {
        return Ok(());
    }
    keep(root, name, &read(file)?)?;
    Ok(std::fs::remove_file(file)?)
}

/// A file of JSON.
pub fn read(path: &Path) -> Result<Value> {
    let text = dermis_io::read_text(path, dermis_io::REPORT)
        .with_context(|| format!("{} cannot be read", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} is no JSON", path.display()))
}

/// Says of a record which command made it, at which commit, and, where it does not say so itself, on which machine.
pub fn sign(record: &mut Value, command: &str, commit: &str) -> Result<()> {
    let Some(object) = record.as_object_mut() else {
        bail!("`{command}` measured no object, but {record}");
    };
    object.insert("command".into(), json!(command));
    object.insert("commit".into(), json!(commit));
    object.entry("machine").or_insert_with(|| {
        let dermis_io::Machine { processor, cores, load } = dermis_io::machine();
        json!({ "processor": processor, "cores": cores, "load_1min_at_end": load })
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_says_what_made_it() {
        let mut record = json!({ "a": 1, "command": "dermis x", "machine": { "profile": "release" } });
        sign(&mut record, "cargo xtask measure x", "1234567").unwrap();
        let signed = json!({
            "a": 1, "command": "cargo xtask measure x", "commit": "1234567", "machine": { "profile": "release" }
        });
        assert_eq!(record, signed);
        let mut bare = json!({});
        sign(&mut bare, "c", "1234567").unwrap();
        assert!(bare["machine"]["cores"].as_u64().is_some_and(|cores| cores > 0), "{bare}");
        assert!(sign(&mut json!([1]), "c", "1234567").is_err());
    }
}
