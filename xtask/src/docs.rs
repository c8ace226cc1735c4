//! The book under `docs/`: tables of results from measured figures, the reference of commands, links, and the HTML pages.
//!
//! Links in the sources are relative paths, so that they work where the repository is browsed. The pages are built from a copy
//! under `target/`, in which a link that leaves `docs/` names the file in the public repository.

mod figures;
mod links;
pub mod tables;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::Args;

use crate::environment;
use crate::programs;
use crate::run::{output, run as execute, target_dir};
use crate::targets;

/// What to do with the book.
#[derive(Args)]
pub struct Options {
    /// Only write what is generated: tables of results, the reference of all commands, the schema of effects.
    #[arg(long, conflicts_with = "check")]
    tables: bool,
    /// Only draw the picture of the README from a run of `dermis demo`, which takes seconds.
    #[arg(long, conflicts_with_all = ["tables", "check"])]
    pictures: bool,
    /// Only check tables, where their figures are from, targets, and links; nothing is written or installed.
    #[arg(long)]
    check: bool,
}

/// Version of mdBook that builds the pages.
const MDBOOK: &str = "0.5.4";

pub fn run(root: &Path, options: &Options) -> Result<()> {
    if options.tables {
        return write_generated(root);
    }
    if options.pictures {
        let (python, dermis) = (environment::clients(root)?, programs::dermis(root)?);
        return execute(Command::new(python).arg("docs/picture.py").arg(dermis).current_dir(root));
    }
    let mut wrong = links::broken(root)?;
    wrong.extend(stale(root)?.iter().map(|path| {
        format!("{}: a table is stale; run `cargo xtask docs --tables`", shorter(root, path).display())
    }));
    wrong.extend(unmarked(root)?);
    wrong.extend(unwritten(root)?);
    wrong.extend(targets::untrue(root)?);
    if !wrong.is_empty() {
        bail!("{}", wrong.join("\n"));
    }
    if options.check {
        return Ok(());
    }
    environment::program(root, "mdbook", MDBOOK, &["--no-default-features", "--features=search"])?;
    let target = target_dir(root);
    let staged = target.join("book-source");
    stage(root, &staged)?;
    let book = target.join("book");
    execute(environment::tool(root, "mdbook").arg("build").arg(&staged).arg("--dest-dir").arg(&book))?;
    println!("{}", book.join("index.html").display());
    Ok(())
}

/// Markdown files that may hold tables of results.
fn pages(root: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    markdown(&root.join("docs"), &mut found)?;
    Ok(found)
}

/// Every Markdown file below a folder, in order.
fn markdown(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let entries = fs::read_dir(folder).with_context(|| format!("{} cannot be read", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            markdown(&path, found)?;
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
    Ok(())
}

fn shorter<'a>(root: &Path, path: &'a Path) -> &'a Path {
    path.strip_prefix(root).unwrap_or(path)
}

/// Pages whose tables differ from what the results say.
fn stale(root: &Path) -> Result<Vec<PathBuf>> {
    let sources = tables::Sources::new(root)?;
    let mut stale = Vec::new();
    for path in pages(root)? {
        let text = fs::read_to_string(&path)?;
        let fresh = sources.expand(&text).with_context(|| format!("{} has a bad table", path.display()))?;
        if fresh != text {
            stale.push(path);
        }
    }
    Ok(stale)
}

/// Tables of figures of which no one can tell where the figures are from, one sentence each.
fn unmarked(root: &Path) -> Result<Vec<String>> {
    let mut wrong = Vec::new();
    for path in pages(root)? {
        let text = fs::read_to_string(&path)?;
        let found = figures::unmarked(&text, |path| root.join(path).exists());
        wrong.extend(
            found.iter().map(|(line, why)| format!("{}:{line}: {why}", shorter(root, &path).display())),
        );
    }
    Ok(wrong)
}

/// Tables that wait for a record which the command that they name does not write, one sentence each.
fn unwritten(root: &Path) -> Result<Vec<String>> {
    let mut wrong = Vec::new();
    for path in pages(root)? {
        let text = fs::read_to_string(&path)?;
        for (line, file, command) in tables::awaited(&text)? {
            let why = match targets::written(command) {
                Ok(written) if written.iter().any(|name| name == file) => continue,
                Ok(written) => format!("`{command}` does not write `{file}`, but {written:?}"),
                Err(why) => why,
            };
            wrong.push(format!("{}:{line}: {why}", shorter(root, &path).display()));
        }
    }
    Ok(wrong)
}

fn write_generated(root: &Path) -> Result<()> {
    let sources = tables::Sources::new(root)?;
    for path in stale(root)? {
        let text = fs::read_to_string(&path)?;
        fs::write(&path, sources.expand(&text)?)?;
        println!("{}", shorter(root, &path).display());
    }
    let dermis = programs::dermis(root)?;
    let says = |arguments: &[&str]| output(Command::new(&dermis).args(arguments).current_dir(root));
    for (file, arguments) in [
        ("docs/reference/commands.md", &["reference"][..]),
        ("launch/schemas/effects.schema.json", &["schema", "effects"]),
    ] {
        let path = root.join(file);
        let text = says(arguments)?;
        if fs::read_to_string(&path).unwrap_or_default() != text {
            fs::write(&path, text)?;
            println!("{file}");
        }
    }
    Ok(())
}

/// Copies the book, with links out of it that work outside of the repository.
fn stage(root: &Path, staged: &Path) -> Result<()> {
    let manifest: toml::Table = toml::from_str(&fs::read_to_string(root.join("Cargo.toml"))?)?;
    let repository = manifest["workspace"]["package"]["repository"]
        .as_str()
        .context("Cargo.toml names no repository")?
        .to_owned();
    if staged.exists() {
        fs::remove_dir_all(staged)?;
    }
    copy(&root.join("docs"), staged)?;
    let mut copied = Vec::new();
    markdown(staged, &mut copied)?;
    for page in copied {
        let inside = page.strip_prefix(staged)?.to_owned();
        let original = root.join("docs").join(&inside);
        let text = fs::read_to_string(&page)?;
        let mut pictures = Vec::new();
        let text = links::rewrite(&text, |link| {
            let (path, anchor) = link.split_once('#').map_or((link, None), |(p, a)| (p, Some(a)));
            let aim = links::resolve(root, &original, path)?;
            let anchor = anchor.map(|a| format!("#{a}")).unwrap_or_default();
            if aim.starts_with("docs") {
                return path.strip_suffix("README.md").map(|folder| format!("{folder}index.md{anchor}"));
            }
            if aim.extension().is_some_and(|e| e == "svg" || e == "png") {
                let up = "../".repeat(inside.components().count() - 1);
                let place = format!("{up}repository/{}", aim.display());
                pictures.push(aim);
                return Some(place);
            }
            let kind = if root.join(&aim).is_dir() { "tree" } else { "blob" };
            Some(format!("{repository}/{kind}/main/{}{anchor}", aim.display()))
        });
        for picture in pictures {
            let place = staged.join("repository").join(&picture);
            if let Some(folder) = place.parent() {
                fs::create_dir_all(folder)?;
            }
            fs::copy(root.join(&picture), place)?;
        }
        // mdBook makes `index.html` of a README, but leaves links to it as they are.
        if page.ends_with("README.md") {
            fs::remove_file(&page)?;
            fs::write(page.with_file_name("index.md"), text)?;
        } else {
            fs::write(&page, text)?;
        }
    }
    Ok(())
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let path = entry?.path();
        let place = to.join(path.file_name().unwrap_or_default());
        if path.is_dir() {
            copy(&path, &place)?;
        } else {
            fs::copy(&path, &place)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::root;

    #[test]
    fn no_table_of_the_book_is_stale() {
        let root = root().unwrap();
        assert_eq!(stale(&root).unwrap(), Vec::<PathBuf>::new(), "run `cargo xtask docs --tables`");
    }

    #[test]
    fn every_table_of_figures_is_generated_or_marked() {
        assert_eq!(unmarked(&root().unwrap()).unwrap(), Vec::<String>::new());
    }

    #[test]
    fn every_table_that_waits_names_the_command_that_makes_it() {
        assert_eq!(unwritten(&root().unwrap()).unwrap(), Vec::<String>::new());
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("docs")).unwrap();
        let waits = |file: &str, command: &str| {
            format!("<!-- table once {file}: cargo xtask {command}\n| a |\n-->\n<!-- end table -->\n")
        };
        let text = [waits("start", "measure start"), waits("stop", "measure start"), waits("a", "measure a")];
        fs::write(dir.path().join("docs/page.md"), text.concat()).unwrap();
        let wrong = unwritten(dir.path()).unwrap();
        assert_eq!(
            wrong[0],
            "docs/page.md:5: `cargo xtask measure start` does not write `stop`, but [\"start\"]"
        );
        assert!(wrong.len() == 2 && wrong[1].starts_with("docs/page.md:9: "), "{wrong:#?}");
    }

    #[test]
    fn every_link_leads_somewhere() {
        assert_eq!(links::broken(&root().unwrap()).unwrap(), Vec::<String>::new());
    }

    #[test]
    fn the_contents_list_every_page_once() {
        let root = root().unwrap();
        let docs = root.join("docs");
        let summary = fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
        let mut listed: Vec<PathBuf> =
            links::of(&summary).into_iter().map(|link| docs.join(link.target)).collect();
        listed.sort();
        let mut there = pages(&root).unwrap();
        there.retain(|path| !path.ends_with("SUMMARY.md"));
        assert_eq!(listed, there);
    }

    #[test]
    fn the_readme_is_short() {
        let text = fs::read_to_string(root().unwrap().join("README.md")).unwrap();
        let lines = text.lines().count();
        assert!(lines <= 150, "README.md has {lines} lines, of 150; move what is more into the book");
        let longest = text.lines().map(|line| line.chars().count()).max().unwrap_or(0);
        assert!(longest <= 400, "README.md has a line of {longest} characters");
    }

    #[test]
    fn a_link_out_of_the_book_names_the_public_repository() {
        let root = root().unwrap();
        let dir = tempfile::tempdir().unwrap();
        stage(&root, &dir.path().join("staged")).unwrap();
        let mut copied = Vec::new();
        markdown(dir.path(), &mut copied).unwrap();
        let mut public = 0;
        for page in copied {
            for link in links::of(&fs::read_to_string(&page).unwrap()) {
                let target = link.target.split('#').next().unwrap_or_default();
                if target.is_empty() || target.contains("://") || target.starts_with("mailto:") {
                    public += usize::from(target.contains("/blob/main/"));
                    continue;
                }
                let aim = page.parent().unwrap().join(target);
                assert!(aim.exists(), "{}: {} is not in the book", page.display(), link.target);
            }
        }
        assert!(public > 10, "{public} links into the repository");
    }

    /// A value of an attribute in a line of SVG.
    fn attribute<'a>(line: &'a str, name: &str) -> Option<&'a str> {
        line.split_once(&format!(" {name}=\""))?.1.split('"').next()
    }

    #[test]
    fn text_in_pictures_stays_in_its_box() {
        let folder = root().unwrap().join("docs");
        let (mut checked, number) = (0, |line: &str, name| attribute(line, name)?.parse::<f64>().ok());
        for name in ["one-frame.svg", "live.svg"] {
            let svg = fs::read_to_string(folder.join(name)).unwrap();
            let boxes: Vec<[f64; 4]> = svg
                .lines()
                .filter(|line| line.starts_with("<rect"))
                .filter_map(|l| {
                    Some([number(l, "x")?, number(l, "y")?, number(l, "width")?, number(l, "height")?])
                })
                .collect();
            for line in svg.lines().filter(|line| line.starts_with("<text")) {
                let (x, y) = (number(line, "x").unwrap(), number(line, "y").unwrap());
                let size = number(line, "font-size").unwrap_or(13.0);
                let text = line.split_once('>').unwrap().1.split('<').next().unwrap();
                // Wider than the letters of common fonts are on average.
                let em = match (line.contains("monospace"), line.contains("bold")) {
                    (true, _) => 0.61,
                    (false, true) => 0.62,
                    (false, false) => 0.56,
                };
                let width = em * size * text.chars().count() as f64;
                let left = if line.contains("middle") { x - width / 2.0 } else { x };
                let around = boxes
                    .iter()
                    .filter(|b| (b[0]..b[0] + b[2]).contains(&x) && (b[1]..b[1] + b[3]).contains(&y));
                let Some(inner) = around.min_by(|a, b| (a[2] * a[3]).total_cmp(&(b[2] * b[3]))) else {
                    continue;
                };
                assert!(
                    left >= inner[0] && left + width <= inner[0] + inner[2],
                    "{name}: `{text}` is wider than its box"
                );
                checked += 1;
            }
        }
        assert!(checked > 15, "{checked} texts");
    }
}
