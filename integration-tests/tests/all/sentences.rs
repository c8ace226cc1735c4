//! Mistakes in a skin file, and a node that is given another family's skin: the program says what to write, before anything runs.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::Command;

use dermis_integration_tests::{finish, program, refused, root};

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    command.current_dir(root()).args(arguments);
    command
}

/// A copy of a skin that ships, with something replaced.
fn changed(folder: &Path, skin: &str, from: &str, to: &str) -> PathBuf {
    let text = std::fs::read_to_string(root().join("launch/skins").join(skin)).unwrap();
    assert!(text.contains(from));
    let path = folder.join(skin);
    std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
    path
}

#[test]
fn a_misspelt_key_of_the_medium_is_refused_with_the_known_ones() {
    let folder = tempfile::tempdir().unwrap();
    for (skin, node, known) in [
        (
            "baro-grid.toml",
            "barodome",
            "`thickness`, `young_modulus`, `poisson_ratio`, `base`, `edge`, `bore`",
        ),
        ("hapdef-shin.toml", "hapdef", "`thickness`, `young_modulus`, `poisson_ratio`, `gauge`, `patch`"),
    ] {
        let path = changed(folder.path(), skin, "young_modulus =", "young_modulos =");
        let place = format!("skin file {}: field `medium", path.display());
        let says = |text: String| {
            assert!(text.contains(&place) && text.contains("unknown field `young_modulos`"), "{text}");
            assert!(text.contains(known), "{text}");
        };
        let name = path.display().to_string();
        says(refused(&mut dermis(&["skin", &name])));
        says(refused(&mut dermis(&[node, "--source", "pty:///nowhere", "--skin", &name])));
        let launch = folder.path().join("skin.launch.yaml");
        let text = format!(
            "processes:\n  - name: skin\n    node: {node}\n    config: {{skin: {name}, source: 'pty:///nowhere'}}\n"
        );
        std::fs::write(&launch, text).unwrap();
        says(refused(&mut dermis(&["launch", "--check", &launch.display().to_string()])));
    }
    // A value that cannot be is named as well; a skin without a medium has no forward model, which is no mistake.
    let path = changed(folder.path(), "baro-line.toml", "poisson_ratio = 0.49", "poisson_ratio = 0.7");
    let text = refused(&mut dermis(&["skin", &path.display().to_string()]));
    assert!(text.contains("field `medium.poisson_ratio`"), "{text}");
    let text = finish(&mut dermis(&["skin", "launch/skins/eflesh.toml"]));
    assert!(text.contains("forward model  none"), "{text}");
}

#[test]
fn the_node_of_another_family_says_which_command_reads_the_skin() {
    let skin = "launch/skins/hapdef-shin.toml";
    let text = refused(&mut dermis(&["barodome", "--source", "pty:///nowhere", "--skin", skin]));
    assert!(text.contains("it reads \"barodome\"; `dermis hapdef` reads it"), "{text}");
    let skin = "launch/skins/baro-line.toml";
    let text = refused(&mut dermis(&["hapdef", "--source", "pty:///nowhere", "--skin", skin]));
    assert!(text.contains("; `dermis barodome` reads it"), "{text}");
}
