//! Imports between the crates of this workspace run one way.

use std::path::Path;

use anyhow::{Result, bail};
use serde::Deserialize;

use crate::run::{cargo, output};

/// A layer of the workspace: a crate may import crates of its own layer's rank (but see [`Layer::alone`]) or a lower one.
struct Layer {
    rank: u8,
    /// Crates of this layer never import each other.
    alone: bool,
}

fn layer(folder: &str, name: &str) -> Option<Layer> {
    let (first, _) = folder.split_once('/').unwrap_or((folder, ""));
    let layer = |rank, alone| Some(Layer { rank, alone });
    match (first, name) {
        ("xtask" | "integration-tests" | "fuzz" | "benches", _) => layer(12, true),
        ("dermis", _) => layer(11, true),
        ("nodes" | "bridges", _) => layer(10, true),
        ("msgs", _) | ("crates", "dermis-io") => layer(0, true),
        // Drawing knows nothing of skins.
        ("crates", "dermis-skin" | "dermis-figures") => layer(1, true),
        // A robot's body carries skins, and knows nothing of what they read.
        ("crates", "dermis-model" | "dermis-body") => layer(2, true),
        // Skins and models of tests: whoever tests on them lies above skin and model, or takes their text only.
        ("crates", "dermis-fixtures") => layer(3, true),
        // What bundles say of it, inference reads.
        ("crates", "dermis-inversion") => layer(3, true),
        ("crates", "dermis-transport" | "dermis-electrics" | "dermis-mechanics" | "dermis-inference") => {
            layer(4, true)
        }
        ("crates", "dermis-sensor") => layer(5, true),
        ("crates", "dermis-estimate") => layer(6, true),
        // Experiments, and what people do with running skins: neither needs the other.
        ("crates", "dermis-studies" | "dermis-operate") => layer(8, true),
        ("crates", "dermis-report") => layer(9, true),
        ("crates", _) => layer(7, false),
        _ => None,
    }
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    workspace_root: String,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    manifest_path: String,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    kind: Option<String>,
    path: Option<String>,
}

/// Words that only a crate under nodes/ may use for itself: the names of the sensor families. `HapDefX`, a published method, is another word.
const FAMILIES: [&str; 4] = ["hapdef", "barodome", "insight", "ert"];

/// Names of the sensor families that exist for a test, of their wire and of their package (`integration-tests/toys`). They show that a
/// family needs nothing under crates/, so that nothing there may know them.
const TOYS: [&str; 4] = ["toy-foam", "toy-camera", "toy-picture", "dermis-toys"];

/// What is said of a name of [`FAMILIES`], and of one of [`TOYS`].
const FAMILY: &str = "a sensor family";
const TOY: &str = "a sensor family of the tests";

/// What makes the check of the diagnosis honest: the diagnosis never sees the benchmark that it is checked by.
const TOOL: &str = "dermis-gap";
const BENCHMARK: &str = "dermis-gap-benchmark";
/// Who scores the diagnosis on the benchmark.
const MAY_SCORE: [&str; 4] = ["dermis", "dermis-studies", "dermis-report", "integration-tests"];
/// What the benchmark shares with the rest: vocabulary, stimuli and files, no model. What a family's undamaged device reads it may be handed
/// (`Designs`); it imports none.
const BENCHMARK_MAY: [&str; 6] =
    ["dermis-skin", "dermis-model", "dermis-testbed", "dermis-bag", "dermis-io", "dermis_msgs"];

/// Every import that runs the wrong way, as one sentence each.
pub fn violations(metadata: &str) -> Result<Vec<String>> {
    let metadata: Metadata = serde_json::from_str(metadata)?;
    let folder = |manifest: &str| {
        manifest
            .trim_start_matches(&metadata.workspace_root)
            .trim_start_matches('/')
            .trim_end_matches("/Cargo.toml")
            .to_owned()
    };
    let mut found = Vec::new();
    for package in &metadata.packages {
        let here = folder(&package.manifest_path);
        let Some(from) = layer(&here, &package.name) else {
            found.push(format!("{} lies in {here}, which is no layer: see ARCHITECTURE.md", package.name));
            continue;
        };
        if here.starts_with("crates/") {
            for family in FAMILIES {
                if package.name.split('-').any(|word| word == family) {
                    found.push(format!("{} under crates/ names the sensor family {family}", package.name));
                }
            }
        }
        for dependency in &package.dependencies {
            if dependency.name == BENCHMARK && !MAY_SCORE.contains(&package.name.as_str()) {
                let why = if package.name == TOOL {
                    "what it is checked against is none of its business, not in tests either"
                } else {
                    "only the studies, what reports them, the program and tests of the check may"
                };
                found.push(format!("{} ({here}) imports {BENCHMARK}: {why}", package.name));
            }
            if package.name == BENCHMARK
                && !BENCHMARK_MAY.contains(&dependency.name.as_str())
                && dependency.path.is_some()
            {
                found.push(format!(
                    "{BENCHMARK} ({here}) imports {}: the benchmark has a physics of its own",
                    dependency.name
                ));
            }
            // Tests may reach anywhere: they are not shipped.
            if dependency.kind.as_deref() == Some("dev") {
                continue;
            }
            let Some(path) = &dependency.path else { continue };
            let there = folder(&format!("{path}/Cargo.toml"));
            let Some(to) = layer(&there, &dependency.name) else { continue };
            if to.rank > from.rank || (to.rank == from.rank && from.alone) {
                found.push(format!(
                    "{} ({here}) imports {} ({there}): imports run downwards only",
                    package.name, dependency.name
                ));
            }
        }
    }
    Ok(found)
}

/// Fails with every import that runs the wrong way, and where a file under crates/ names a sensor family, or one of the tests.
pub fn check(root: &Path) -> Result<()> {
    let metadata = output(cargo(root).args(["metadata", "--format-version", "1", "--no-deps", "--offline"]))?;
    let mut found = violations(&metadata)?;
    let crates = root.join("crates");
    found.extend(named(&crates, FAMILY, names_family)?);
    found.extend(named(&crates, TOY, names_toy)?);
    if found.is_empty() {
        println!("imports run one way");
        return Ok(());
    }
    bail!("{}", found.join("\n"))
}

/// Whether one of the words is the name of a sensor family. Whatever is no letter or digit, `_` and `-` too, ends a word:
/// `ert-panel` names one, `expert` does not.
fn names_family(text: &str) -> bool {
    let mut words = text.split(|c: char| !c.is_ascii_alphanumeric());
    words.any(|word| FAMILIES.iter().any(|family| word.eq_ignore_ascii_case(family)))
}

/// Whether a text names what `integration-tests/toys` holds.
fn names_toy(text: &str) -> bool {
    TOYS.iter().any(|name| has_name(text, name))
}

/// Whether a name stands in a text, as a string or in an identifier: of `toy-foam` so do `toy_foam`, `TOY_FOAM` and `ToyFoamModel`, but not
/// the words "toy" and "foam" by themselves.
fn has_name(text: &str, name: &str) -> bool {
    let joined = |text: &str| text.replace(['-', '_'], "").to_ascii_lowercase();
    joined(text).contains(&joined(name))
}

/// Files and lines of a folder that name `what`: sources, manifests, tables and texts, but nothing that is not text.
fn named(folder: &Path, what: &str, names: impl Fn(&str) -> bool) -> Result<Vec<String>> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder)? {
            let entry = entry?;
            let path = entry.path();
            if names(&entry.file_name().to_string_lossy()) {
                found.push(format!("{}: is named after {what}", path.display()));
            }
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let Ok(text) = String::from_utf8(std::fs::read(&path)?) else { continue };
            for (number, _) in text.lines().enumerate().filter(|(_, line)| names(line)) {
                found.push(format!("{}:{}: names {what}", path.display(), number + 1));
            }
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metadata(from: (&str, &str), to: (&str, &str)) -> String {
        serde_json::json!({
            "workspace_root": "/w",
            "packages": [{
                "name": from.1,
                "manifest_path": format!("/w/{}/Cargo.toml", from.0),
                "dependencies": [{ "name": to.1, "kind": null, "path": format!("/w/{}", to.0) }],
            }],
        })
        .to_string()
    }

    #[test]
    fn this_workspace_imports_one_way() {
        check(&crate::run::root().unwrap()).unwrap();
    }

    #[test]
    fn an_upward_import_is_named() {
        let found =
            violations(&metadata(("crates/skin", "dermis-skin"), ("nodes/barodome", "dermis-barodome")))
                .unwrap();
        assert_eq!(
            found,
            [
                "dermis-skin (crates/skin) imports dermis-barodome (nodes/barodome): imports run downwards only"
            ]
        );
    }

    #[test]
    fn the_diagnosis_never_sees_the_benchmark_that_it_is_checked_by() {
        let benchmark = ("crates/gap-benchmark", "dermis-gap-benchmark");
        for kind in ["null", "\"dev\"", "\"build\""] {
            let text = metadata(("crates/gap", "dermis-gap"), benchmark);
            let found = violations(&text.replace("\"kind\":null", &format!("\"kind\":{kind}"))).unwrap();
            assert_eq!(found.len(), 1, "{kind}: {found:?}");
            assert!(found[0].contains("not in tests either"), "{found:?}");
        }
        assert!(violations(&metadata(("dermis", "dermis"), benchmark)).unwrap().is_empty());
        assert_eq!(violations(&metadata(("crates/learn", "dermis-learn"), benchmark)).unwrap().len(), 1);
        let physics = ("crates/mechanics", "dermis-mechanics");
        assert_eq!(violations(&metadata(benchmark, physics)).unwrap().len(), 1);
    }

    #[test]
    fn studies_and_operation_are_apart() {
        let (studies, operate) = (("crates/studies", "dermis-studies"), ("crates/operate", "dermis-operate"));
        for (from, to) in [(studies, operate), (operate, studies)] {
            assert_eq!(violations(&metadata(from, to)).unwrap().len(), 1, "{from:?} imports {to:?}");
        }
        for to in [("crates/perception", "dermis-perception"), ("crates/testbed", "dermis-testbed")] {
            assert!(violations(&metadata(operate, to)).unwrap().is_empty(), "{to:?}");
            assert_eq!(violations(&metadata(to, operate)).unwrap().len(), 1, "{to:?}");
        }
    }

    #[test]
    fn a_node_never_imports_a_node() {
        let found =
            violations(&metadata(("nodes/fusion", "dermis-fusion"), ("nodes/ert", "dermis-ert"))).unwrap();
        assert_eq!(found.len(), 1);
    }

    #[test]
    fn every_family_is_found_in_any_text() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, bytes: &[u8]| std::fs::write(dir.path().join(name), bytes).unwrap();
        write(
            "a.rs",
            b"// An expert inserts insights by HapDefX.\nlet skin = \"ert\";\nload(\"ert-panel.toml\");\n",
        );
        write("b.toml", b"rate = 100.0\nsensor = \"barodome\"\n");
        write("c.md", b"A limb of HapDef, and `insight_thumb`.\n");
        write("d.bin", b"\xff ert");
        std::fs::create_dir(dir.path().join("hapdef")).unwrap();
        let found = named(dir.path(), FAMILY, names_family).unwrap();
        let prefix = format!("{}/", dir.path().display());
        let found: Vec<&str> = found.iter().map(|line| line.strip_prefix(&prefix).unwrap()).collect();
        assert_eq!(
            found,
            [
                "a.rs:2: names a sensor family",
                "a.rs:3: names a sensor family",
                "b.toml:2: names a sensor family",
                "c.md:1: names a sensor family",
                "hapdef: is named after a sensor family",
            ]
        );
    }

    #[test]
    fn no_crate_names_a_family_of_the_tests() {
        let root = crate::run::root().unwrap();
        assert_eq!(named(&root.join("crates"), TOY, names_toy).unwrap(), Vec::<String>::new());
        // The families' own folder names all of them, so that the search above can find what it looks for.
        let toys = root.join("integration-tests/toys");
        for name in TOYS {
            let found = named(&toys, TOY, |text| has_name(text, name)).unwrap();
            assert!(!found.is_empty(), "{name} is not in {}", toys.display());
        }
        // Another family of the tests is not forgotten above.
        let mut skins = 0;
        for file in std::fs::read_dir(toys.join("skins")).unwrap() {
            let text = std::fs::read_to_string(file.unwrap().path()).unwrap();
            let skin: toml::Table = toml::from_str(&text).unwrap();
            assert!(TOYS.contains(&skin["sensor"].as_str().unwrap()), "{text}");
            skins += 1;
        }
        assert_eq!(skins, 2);
    }

    #[test]
    fn a_family_of_the_tests_is_found_in_strings_and_identifiers() {
        for text in [
            "sensor = \"toy-foam\"",
            "use dermis_toys::SENSORS;",
            "struct ToyCameraModel;",
            "TOY_PICTURE => 1",
        ] {
            assert!(names_toy(text), "{text}");
        }
        for text in ["a toy of foam, and a camera", "fn toy(skin: &Skin)", "let toy = camera();", "no toys"] {
            assert!(!names_toy(text), "{text}");
        }
    }

    #[test]
    fn a_crate_outside_of_the_layers_is_named() {
        let found = violations(&metadata(("stuff", "dermis-stuff"), ("crates/skin", "dermis-skin"))).unwrap();
        assert_eq!(found.len(), 1);
    }
}
