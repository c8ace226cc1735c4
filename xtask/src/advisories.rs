//! Known vulnerabilities of the crates in `Cargo.lock`, by `cargo deny` and the RustSec advisory database.
//!
//! The database is fetched where it can be reached. Elsewhere the dated copy under `.ci/advisories` is used, and the step says
//! its date. `cargo deny` clones a database from a git repository, so the copy is unpacked and committed into one first.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::environment;
use crate::run::{cargo, output, run};

/// What the copy is called in the configuration of `cargo deny`, which takes no path: git goes to the copy instead.
const COPY: &str = "https://advisories.invalid/advisory-db";

/// Longest time to fetch the database.
const PATIENCE: Duration = Duration::from_secs(60);

/// Makes sure that `cargo deny` is there.
pub fn tool(root: &Path) -> Result<()> {
    environment::subcommand(root, "deny", "0.20.2")
}

/// Checks `Cargo.lock`; answers what to know of the database, where it is not the present one.
pub fn check(root: &Path) -> Result<Option<String>> {
    let config = root.join("deny.toml");
    if fetched(root, &config) {
        run(deny(root, &config).args(["check", "--disable-fetch", "advisories"]))?;
        return Ok(None);
    }
    let copy = newest(&root.join(".ci/advisories"))?;
    let date =
        copy.file_name().and_then(|n| n.to_str()).and_then(|n| n.split('.').next()).unwrap_or_default();
    let home = root.join(".dermis/advisories").join(date);
    let source = home.join("source");
    unpack(&copy, &source, date).with_context(|| format!("{} cannot be unpacked", copy.display()))?;
    let copied = home.join("deny.toml");
    fs::write(&copied, with_database(&fs::read_to_string(&config)?, &home.join("databases"))?)?;
    run(deny(root, &copied)
        .args(["check", "advisories"])
        .env("GIT_CONFIG_COUNT", "1")
        .env("GIT_CONFIG_KEY_0", format!("url.file://{}.insteadOf", source.display()))
        .env("GIT_CONFIG_VALUE_0", COPY))?;
    Ok(Some(format!(
        "advisories newer than {date}: the database could not be fetched, its copy in .ci/advisories was used"
    )))
}

fn deny(root: &Path, config: &Path) -> Command {
    let mut command = cargo(root);
    command.args(["deny", "--manifest-path", "Cargo.toml", "--config"]).arg(config);
    command
}

/// Whether the present database could be fetched, in a limited time and without asking anybody for a password.
fn fetched(root: &Path, config: &Path) -> bool {
    let mut command = deny(root, config);
    command.args(["fetch", "db"]).env("GIT_TERMINAL_PROMPT", "0").stdout(Stdio::null()).stderr(Stdio::null());
    let Ok(mut child) = command.spawn() else { return false };
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        match child.try_wait() {
            Ok(Some(status)) => return status.success(),
            Ok(None) => std::thread::sleep(Duration::from_millis(100)),
            Err(_) => break,
        }
    }
    // It may have ended by itself; either way the copy is used.
    let _ = child.kill();
    let _ = child.wait();
    false
}

/// The copy with the latest date in its name.
fn newest(folder: &Path) -> Result<PathBuf> {
    let mut copies = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("{} cannot be read", folder.display()))? {
        let path = entry?.path();
        if path.to_string_lossy().ends_with(".tar.gz") {
            copies.push(path);
        }
    }
    copies.into_iter().max().with_context(|| format!("{} holds no copy of the database", folder.display()))
}

/// Makes a git repository of a copy, unless it has been made.
fn unpack(copy: &Path, source: &Path, date: &str) -> Result<()> {
    if source.join(".git/refs/heads/main").exists() {
        return Ok(());
    }
    if source.exists() {
        fs::remove_dir_all(source)?;
    }
    fs::create_dir_all(source)?;
    run(Command::new("tar").arg("-xzf").arg(copy).arg("-C").arg(source))?;
    let git = |arguments: &[&str]| {
        let stamp = format!("{date}T00:00:00Z");
        output(
            Command::new("git")
                .arg("-C")
                .arg(source)
                .args([
                    "-c",
                    "user.name=dermis",
                    "-c",
                    "user.email=dermis@localhost",
                    "-c",
                    "commit.gpgsign=false",
                ])
                .args(arguments)
                .env("GIT_AUTHOR_DATE", &stamp)
                .env("GIT_COMMITTER_DATE", &stamp),
        )
    };
    git(&["init", "--quiet", "--initial-branch=main"])?;
    git(&["add", "--all"])?;
    git(&["commit", "--quiet", "--no-verify", "--message", date])?;
    Ok(())
}

/// The configuration of `cargo deny` with another database.
fn with_database(config: &str, databases: &Path) -> Result<String> {
    let mut config: toml::Table = toml::from_str(config).context("deny.toml cannot be read")?;
    let Some(toml::Value::Table(advisories)) = config.get_mut("advisories") else {
        bail!("deny.toml has no table `advisories`");
    };
    advisories.insert("db-path".into(), databases.display().to_string().into());
    advisories.insert("db-urls".into(), vec![COPY].into());
    Ok(toml::to_string(&config)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ignored_stays_where_the_database_changes() {
        let config = "[advisories]\nignore = [{ id = 'RUSTSEC-2023-0071', reason = 'x' }]\n[bans]\nwildcards = 'allow'";
        let other = with_database(config, Path::new("/d")).unwrap();
        let other: toml::Table = toml::from_str(&other).unwrap();
        assert_eq!(other["advisories"]["db-urls"][0].as_str(), Some(COPY));
        assert_eq!(other["advisories"]["ignore"][0]["id"].as_str(), Some("RUSTSEC-2023-0071"));
        assert_eq!(other["bans"]["wildcards"].as_str(), Some("allow"));
        assert!(with_database("[bans]", Path::new("/d")).is_err());
    }

    #[test]
    fn the_copy_that_ships_can_be_read() {
        let copy = newest(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../.ci/advisories")).unwrap();
        let listed = output(Command::new("tar").arg("-tzf").arg(copy)).unwrap();
        assert!(listed.lines().any(|l| l.starts_with("crates/") && l.contains("RUSTSEC-")));
    }
}
