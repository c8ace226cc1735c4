//! Definitions of message types that are not built in here, from the ROS 2 installation that is sourced.

use std::path::PathBuf;

use dermis_msgs::type_support;

/// The line between the definitions of a type and those that it refers to.
const RULE: &str = "================================================================================";

/// A file larger than this is no message definition.
const LARGEST: u64 = 1 << 20;

/// The full `ros2msg` definition of `pkg/msg/Type`, with every type it refers to: built in, or else from
/// `share/<pkg>/msg/<Type>.msg` below the folders of `AMENT_PREFIX_PATH`.
///
/// # Errors
/// The type whose definition was not found: this one, or one that it refers to.
pub fn definition_of(type_name: &str) -> Result<String, String> {
    let prefixes = std::env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
    let prefixes: Vec<PathBuf> = std::env::split_paths(&prefixes).collect();
    assemble(type_name, &|name| from_files(&prefixes, name).or_else(|| built_in(name)))
}

/// The text of `pkg/msg/Type` alone, from a file.
fn from_files(prefixes: &[PathBuf], name: &str) -> Option<String> {
    let (package, short) = name.split_once("/msg/")?;
    let plain = |part: &str| part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !plain(package) || !plain(short) {
        return None;
    }
    prefixes.iter().find_map(|prefix| {
        let path = prefix.join("share").join(package).join("msg").join(format!("{short}.msg"));
        dermis_io::read_text(&path, LARGEST).ok()
    })
}

/// The text of a type alone, of those that are built in.
fn built_in(name: &str) -> Option<String> {
    let text = type_support(name)?.definition;
    Some(text.split(RULE).next().unwrap_or_default().trim_end().to_owned())
}

fn assemble(root: &str, text_of: &dyn Fn(&str) -> Option<String>) -> Result<String, String> {
    let mut text = text_of(root).ok_or_else(|| root.to_owned())?;
    let mut known = vec![root.to_owned()];
    let mut index = 0;
    let mut current = text.clone();
    loop {
        let package = known[index].split('/').next().unwrap_or_default().to_owned();
        for name in current.lines().filter_map(|line| refers_to(line, &package)) {
            if !known.contains(&name) {
                known.push(name);
            }
        }
        index += 1;
        let Some(name) = known.get(index) else { return Ok(text) };
        current = text_of(name).ok_or_else(|| name.clone())?;
        let short = name.replace("/msg/", "/");
        text = format!("{}\n{RULE}\nMSG: {short}\n{current}", text.trim_end());
    }
}

/// The type that the field on this line is of, in full; `None` for a builtin type or no field.
fn refers_to(line: &str, package: &str) -> Option<String> {
    let field = line.split('#').next().unwrap_or_default().trim();
    let (kind, _) = field.split_once(char::is_whitespace)?;
    let base = kind.split(['[', '<']).next().unwrap_or_default();
    match base.split('/').collect::<Vec<_>>().as_slice() {
        [name] if name.starts_with(|c: char| c.is_ascii_uppercase()) => {
            if *name == "Header" && package != "std_msgs" {
                return Some("std_msgs/msg/Header".into());
            }
            Some(format!("{package}/msg/{name}"))
        }
        [package, name] | [package, "msg", name] => Some(format!("{package}/msg/{name}")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nested_types_are_found_once() {
        let dir = tempfile::tempdir().unwrap();
        let msg = dir.path().join("share/my_pkg/msg");
        std::fs::create_dir_all(&msg).unwrap();
        std::fs::write(
            msg.join("Outer.msg"),
            "# a comment\nstd_msgs/Header header\nInner[<=3] inner\nInner one\nuint8 A=1\nstring<=4 s \"x\"\n",
        )
        .unwrap();
        std::fs::write(msg.join("Inner.msg"), "geometry_msgs/msg/Point p\n").unwrap();
        let prefixes = [dir.path().to_path_buf()];
        let text_of = |name: &str| from_files(&prefixes, name).or_else(|| built_in(name));
        let text = assemble("my_pkg/msg/Outer", &text_of).unwrap();
        let found: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
        assert_eq!(
            found,
            ["std_msgs/Header", "my_pkg/Inner", "builtin_interfaces/Time", "geometry_msgs/Point"]
        );
        assert!(text.starts_with("# a comment\nstd_msgs/Header header\n"), "{text}");

        std::fs::remove_file(msg.join("Inner.msg")).unwrap();
        assert_eq!(assemble("my_pkg/msg/Outer", &text_of).unwrap_err(), "my_pkg/msg/Inner");
        assert_eq!(assemble("../msg/Outer", &text_of).unwrap_err(), "../msg/Outer");
    }

    #[test]
    fn what_is_built_in_is_made_as_the_build_makes_it() {
        for support in dermis_msgs::type_supports().iter().filter(|s| s.name.contains("/msg/")) {
            let ours = assemble(support.name, &built_in).unwrap();
            let difference = crate::definition::difference(support.name, &ours, support.definition);
            assert_eq!(difference, None, "{}", support.name);
        }
    }
}
