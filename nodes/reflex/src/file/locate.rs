//! The line of a field in a TOML text.

use toml::de::{DeTable, DeValue};

/// Line (from 1) of the field at a path such as `rules[2].force.above`, or of the innermost part of the path that stands in the
/// text; 1 where there is none.
pub(super) fn line_of(text: &str, path: &str) -> usize {
    let Ok(table) = DeTable::parse(text) else { return 1 };
    let mut at = table.span().start;
    let mut value: Option<&DeValue<'_>> = None;
    for part in path.split(['.', '[', ']']).filter(|part| !part.is_empty()) {
        let here = value.and_then(DeValue::as_table).or(value.is_none().then(|| table.get_ref()));
        let found = if let Some(here) = here {
            here.iter()
                .find(|(key, _)| key.get_ref().as_ref() == part)
                .map(|(key, value)| (key.span().start, value))
        } else {
            let items = value.and_then(DeValue::as_array);
            let index = part.parse::<usize>().ok();
            items.zip(index).and_then(|(items, i)| items.get(i)).map(|item| (item.span().start, item))
        };
        let Some((start, next)) = found else { break };
        at = first_key(next.get_ref())
            .map_or(start, |first| if next.span().is_empty() { first } else { start });
        value = Some(next.get_ref());
    }
    line(text, at)
}

/// Where the first key of a table stands: tables without a header have no place of their own.
fn first_key(value: &DeValue<'_>) -> Option<usize> {
    value.as_table()?.keys().map(|key| key.span().start).min()
}

/// Line (from 1) of a byte.
pub(super) fn line(text: &str, byte: usize) -> usize {
    1 + text.bytes().take(byte).filter(|b| *b == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "name = 'a'\n\n[inputs.palm]\ntopic = 't'\n\n[[rules]]\nname = 'one'\n[[rules]]\nname = 'two'\nforce = { above = 3,\n  release = 4 }\n";

    #[test]
    fn fields_are_found() {
        for (path, expected) in [
            ("name", 1),
            ("inputs.palm", 3),
            ("inputs.palm.topic", 4),
            ("rules[0].name", 7),
            ("rules[1].name", 9),
            ("rules.1.name", 9),
            ("rules[1].force", 10),
            ("rules[1].force.release", 11),
        ] {
            assert_eq!(line_of(TEXT, path), expected, "{path}");
        }
    }

    #[test]
    fn what_is_missing_is_reported_at_its_table() {
        assert_eq!(line_of(TEXT, "inputs.palm.timeout"), 3);
        assert_eq!(line_of(TEXT, "rules[1].actions"), 8);
        assert_eq!(line_of(TEXT, "nothing.here"), 1);
        assert_eq!(line_of("no toml", "a"), 1);
    }
}
