//! Compares message definitions by what decides the layout of a message: its fields, in order, through all nested
//! types. Comments, constants and default values don't.

use std::collections::{BTreeMap, BTreeSet};

const BUILTIN: [&str; 15] = [
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32",
    "int64", "uint64", "string", "wstring",
];

type Fields = Vec<(String, String)>;

/// Splits `ros2msg` text into types with their fields as (type, name); the first is `root`.
fn parse(root: &str, text: &str) -> BTreeMap<String, Fields> {
    let mut types = BTreeMap::new();
    let mut current = short_name(root);
    let mut fields: Fields = Vec::new();
    for line in text.lines() {
        let line = line.trim();
        if line.len() >= 8 && line.bytes().all(|b| b == b'=') {
            continue;
        }
        if let Some(name) = line.strip_prefix("MSG:") {
            types.insert(
                std::mem::replace(&mut current, short_name(name.trim())),
                std::mem::take(&mut fields),
            );
            continue;
        }
        if let Some(field) = parse_field(line, &current) {
            fields.push(field);
        }
    }
    types.insert(current, fields);
    types
}

/// `pkg/msg/Type` → `pkg/Type`.
fn short_name(name: &str) -> String {
    name.replace("/msg/", "/")
}

fn parse_field(line: &str, owner: &str) -> Option<(String, String)> {
    let line = line.split('#').next().unwrap_or_default().trim();
    let (type_name, rest) = line.split_once(char::is_whitespace)?;
    let rest = rest.trim_start();
    let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
    let (name, after) = rest.split_at(end);
    if name.is_empty() || after.trim_start().starts_with('=') {
        return None;
    }
    let (base, array) = type_name.find('[').map_or((type_name, ""), |at| type_name.split_at(at));
    // A bound restricts values, not the layout.
    let base = base.split("<=").next().unwrap_or_default();
    let array = if array.contains("<=") { "[]" } else { array };
    let base = match base {
        "byte" | "char" => "uint8".to_owned(),
        known if BUILTIN.contains(&known) => known.to_owned(),
        "Header" => "std_msgs/Header".to_owned(),
        "time" => "builtin_interfaces/Time".to_owned(),
        "duration" => "builtin_interfaces/Duration".to_owned(),
        full if full.contains('/') => short_name(full),
        local => format!("{}/{local}", owner.split('/').next().unwrap_or_default()),
    };
    Some((format!("{base}{array}"), name.to_owned()))
}

/// How the layout of type `root` differs between two definitions; `None` where it doesn't.
pub(crate) fn difference(root: &str, recorded: &str, ours: &str) -> Option<String> {
    let recorded = parse(root, recorded);
    let ours = parse(root, ours);
    let mut seen = BTreeSet::new();
    let mut queue = vec![short_name(root)];
    while let Some(name) = queue.pop() {
        if !seen.insert(name.clone()) {
            continue;
        }
        let Some(mine) = ours.get(&name) else {
            // Neither text spells this type out: nothing to compare.
            continue;
        };
        let Some(theirs) = recorded.get(&name) else {
            return Some(format!("its definition does not say what {name} is"));
        };
        for index in 0..mine.len().max(theirs.len()) {
            let print = |field: Option<&(String, String)>| {
                field.map_or("nothing".to_owned(), |(kind, field)| format!("\"{kind} {field}\""))
            };
            if mine.get(index) != theirs.get(index) {
                return Some(format!(
                    "field {} of {name} is {} in the bag and {} here",
                    index + 1,
                    print(theirs.get(index)),
                    print(mine.get(index))
                ));
            }
        }
        for (kind, _) in mine {
            let base = kind.split('[').next().unwrap_or_default();
            if base.contains('/') {
                queue.push(base.to_owned());
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const OURS: &str = "# comment\nstd_msgs/Header header\nuint8 A=1\nfloat32[] values   # [Pa]\nPoint[4] corners\n\
        ================================================================================\nMSG: std_msgs/Header\n\
        builtin_interfaces/Time stamp\nstring frame_id\n\
        ================================================================================\nMSG: pkg/Point\nfloat64 x 0\n";

    #[test]
    fn spelling_does_not_matter() {
        let other = "Header   header\nfloat32[<=9] values\npkg/msg/Point[4] corners\n\
            ========\nMSG: pkg/msg/Point\nfloat64 x\n========\nMSG: std_msgs/msg/Header\ntime stamp\nstring<=5 frame_id\n";
        assert_eq!(difference("pkg/msg/Frame", other, OURS), None);
    }

    #[test]
    fn a_changed_field_is_named() {
        let changed = OURS.replace("float64 x", "float32 x");
        insta::assert_snapshot!(
            difference("pkg/msg/Frame", &changed, OURS).unwrap(),
            @r#"field 1 of pkg/Point is "float32 x" in the bag and "float64 x" here"#
        );
        let fewer = OURS.replace("float32[] values   # [Pa]\n", "");
        insta::assert_snapshot!(
            difference("pkg/msg/Frame", &fewer, OURS).unwrap(),
            @r#"field 2 of pkg/Frame is "pkg/Point[4] corners" in the bag and "float32[] values" here"#
        );
        let longer = OURS.replace("string frame_id", "string frame_id\nuint32 seq");
        insta::assert_snapshot!(
            difference("pkg/msg/Frame", &longer, OURS).unwrap(),
            @r#"field 3 of std_msgs/Header is "uint32 seq" in the bag and nothing here"#
        );
        insta::assert_snapshot!(
            difference("pkg/msg/Frame", "Header header\nfloat32[] values\nPoint[4] corners\n", OURS).unwrap(),
            @"its definition does not say what pkg/Point is"
        );
    }
}
