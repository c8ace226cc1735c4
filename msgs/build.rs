//! Turns the `.msg` and `.srv` text of this package and of the standard packages it builds on into Rust.

#[path = "codegen/describe.rs"]
mod describe;
#[path = "codegen/generate.rs"]
mod generate;
#[path = "codegen/parse.rs"]
mod parse;

use std::error::Error;
use std::path::{Path, PathBuf};
use std::{env, fs};

use generate::{Interfaces, OWN_PACKAGE};

fn main() -> Result<(), Box<dyn Error>> {
    for path in ["build.rs", "codegen", "msg", "srv", "std", "v0"] {
        println!("cargo::rerun-if-changed={path}");
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    fs::write(out.join("interfaces.rs"), interfaces(Path::new("."))?.rust()?)?;
    fs::write(out.join("v0.rs"), interfaces(Path::new("v0"))?.rust_of_own_messages()?)?;
    Ok(())
}

/// Our package as it stands in `own`, and the standard ones.
fn interfaces(own: &Path) -> Result<Interfaces, Box<dyn Error>> {
    let mut interfaces = Interfaces::default();
    read_package(&mut interfaces, OWN_PACKAGE, own)?;
    for folder in entries(Path::new("std"))? {
        let package =
            folder.file_name().and_then(|name| name.to_str()).ok_or("a package name is not UTF-8")?;
        read_package(&mut interfaces, package, &folder)?;
    }
    Ok(interfaces)
}

fn read_package(interfaces: &mut Interfaces, package: &str, folder: &Path) -> Result<(), Box<dyn Error>> {
    for kind in ["msg", "srv"] {
        let folder = folder.join(kind);
        if !folder.is_dir() {
            continue;
        }
        for path in entries(&folder)? {
            let in_file = |problem: &dyn std::fmt::Display| format!("{}: {problem}", path.display());
            if path.extension().is_none_or(|extension| extension != kind) {
                return Err(in_file(&format!("this folder holds .{kind} files only")).into());
            }
            let name =
                path.file_stem().and_then(|name| name.to_str()).ok_or_else(|| in_file(&"not UTF-8"))?;
            let text = fs::read_to_string(&path).map_err(|e| in_file(&e))?;
            if kind == "msg" {
                let message = parse::message(package, name, &text).map_err(|e| in_file(&e))?;
                interfaces.descriptions.add(&message);
                interfaces.structures.insert(message.name.clone(), message);
            } else {
                let service = parse::service(package, name, &text).map_err(|e| in_file(&e))?;
                interfaces.descriptions.add_service(&service);
                for half in [&service.request, &service.response] {
                    interfaces.structures.insert(half.name.clone(), half.clone());
                }
                interfaces.services.insert(service.name.clone(), service);
            }
        }
    }
    Ok(())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let mut paths = fs::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(|e| format!("{}: {e}", folder.display()))?;
    paths.sort();
    Ok(paths)
}
