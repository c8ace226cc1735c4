//! Where `~/load_model` may take bundles from.
//!
//! The name of a bundle comes over the network. It is looked for below some folders only: none that leads out of them by `..`, by
//! an absolute path or by a link is followed, so that nobody has a node read what else lies on its machine.

use std::path::{Component, Path, PathBuf};

use dermis_inference::Bundle;

/// The folder of the bundle that is called `name`, a path below one of `folders` or, where it is absolute, in one of them.
///
/// # Errors
///
/// A sentence that says why it is not taken.
pub(crate) fn bundle(name: &str, folders: &[PathBuf]) -> Result<PathBuf, String> {
    let requested = Path::new(name);
    let listed = || folders.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", ");
    if folders.is_empty() {
        return Err(format!(
            "model bundle {name}: no model folder is configured; name one in `model_folders` of the node's configuration"
        ));
    }
    if name.is_empty() || requested.components().any(|c| c == Component::ParentDir) {
        return Err(format!(
            "model bundle {name}: give the name of a bundle below {}, without `..`; nothing else is loaded",
            listed()
        ));
    }
    let outside = || {
        format!(
            "model bundle {name}: does not lie in {}; copy it there, or name its folder in `model_folders` of the node's \
             configuration",
            listed()
        )
    };
    for folder in folders {
        // Links are followed here, so that what is compared is where things really lie.
        let Ok(inside) = folder.canonicalize() else { continue };
        // An absolute name replaces the folder.
        let Ok(found) = folder.join(requested).canonicalize() else { continue };
        if !found.starts_with(&inside) {
            continue;
        }
        if found == inside && !requested.is_absolute() {
            continue;
        }
        for file in Bundle::FILES {
            // One that is not there is missed later, with a sentence.
            if let Ok(lies) = found.join(file).canonicalize()
                && !lies.starts_with(&inside)
            {
                return Err(format!(
                    "model bundle {name}: its file `{file}` is a link that leads out of {}; copy the bundle whole",
                    folder.display()
                ));
            }
        }
        return Ok(found);
    }
    // What lies elsewhere is not distinguished from what is not there.
    let lexically = |f: &PathBuf| !requested.is_absolute() || requested.starts_with(f);
    let linked = folders.iter().any(|f| f.join(requested).symlink_metadata().is_ok());
    Err(if folders.iter().any(lexically) && !linked {
        format!("model bundle {name}: there is none of that name in {}", listed())
    } else {
        outside()
    })
}

/// The folders that contain these bundles: what is taken where the configuration names none.
pub(crate) fn of_bundles(bundles: &[PathBuf]) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = Vec::new();
    for bundle in bundles {
        let parent = match bundle.parent() {
            Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
            Some(parent) => parent,
            None => continue,
        };
        if !folders.iter().any(|f| f == parent) {
            folders.push(parent.to_owned());
        }
    }
    folders
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn nothing_leads_out_of_the_folders() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["models/a", "models/links", "secret/b", "more/c"] {
            std::fs::create_dir_all(at(folder)).unwrap();
            std::fs::write(at(folder).join("bundle.toml"), "").unwrap();
        }
        symlink(at("secret/b"), at("models/b")).unwrap();
        symlink(at("models/a"), at("models/same")).unwrap();
        symlink(at("secret/b/bundle.toml"), at("models/links/model.onnx")).unwrap();
        let folders = [at("models"), at("more")];
        let found =
            |name: &str| bundle(name, &folders).map_err(|e| e.replace(&at("").display().to_string(), ""));
        let real = |name: &str| Ok(at(name).canonicalize().unwrap());
        assert_eq!(found("a"), real("models/a"));
        assert_eq!(found("same"), real("models/a"), "a link within is one");
        assert_eq!(found("c"), real("more/c"));
        assert_eq!(found(&at("models/a").display().to_string()), real("models/a"));
        insta::assert_snapshot!(found("../secret/b").unwrap_err(), @"model bundle ../secret/b: give the name of a bundle below models, more, without `..`; nothing else is loaded");
        assert!(found("a/../../secret/b").unwrap_err().contains("without `..`"));
        insta::assert_snapshot!(found(&at("secret/b").display().to_string()).unwrap_err(), @"model bundle secret/b: does not lie in models, more; copy it there, or name its folder in `model_folders` of the node's configuration");
        insta::assert_snapshot!(found("b").unwrap_err(), @"model bundle b: does not lie in models, more; copy it there, or name its folder in `model_folders` of the node's configuration");
        insta::assert_snapshot!(found("links").unwrap_err(), @"model bundle links: its file `model.onnx` is a link that leads out of models; copy the bundle whole");
        insta::assert_snapshot!(found("none").unwrap_err(), @"model bundle none: there is none of that name in models, more");
        assert!(found("").is_err() && found(".").is_err() && found("/etc/passwd").is_err());
        insta::assert_snapshot!(bundle("a", &[]).unwrap_err(), @"model bundle a: no model folder is configured; name one in `model_folders` of the node's configuration");
        assert_eq!(of_bundles(&["m/a".into(), "m/b".into(), "c".into()]), [Path::new("m"), Path::new(".")]);
    }
}
