//! Texts in TOML as values, and what is wrong with them where.
//!
//! Problem: whoever writes a file by hand misspells keys and leaves out others. serde's own error names neither the table nor the entry of a
//! list that it stands in, and a key that no field reads is dropped without a word.
//!
//! Solution: [`parse`] follows the path through the file and collects keys that nothing reads. A misspelt key is the likely reason
//! for a missing one, so that it is what an error names first.
//!
//! Values are read through `erased_serde`: what follows paths is compiled once, here, and not again for every type of every file, which
//! took three quarters of a minute of CPU time of a cold build. Cost: a virtual call for each value.

use erased_serde::{Deserializer as Erased, Error as ErasedError};
use serde::de::DeserializeOwned;
use serde_path_to_error::Track;
use toml::{Table, Value};

use crate::one_line;

/// What is wrong with a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// It is no TOML.
    Syntax {
        /// Line, from 1 on.
        line: usize,
        /// Column in characters, from 1 on.
        column: usize,
        /// What is wrong there.
        reason: String,
    },
    /// A key that nothing reads.
    UnknownKey {
        /// `table.list[1].key`.
        key: String,
    },
    /// A value that is missing or cannot be.
    Value {
        /// `table.list[1].key`; `None` where it is the text as a whole.
        key: Option<String>,
        /// What is wrong with it.
        reason: String,
    },
}

impl Fault {
    /// Where it is, and what.
    #[must_use]
    pub fn into_field(self) -> (String, String) {
        self.into_field_or("(whole file)")
    }

    /// The same of a text that is the table `table` of a larger one.
    #[must_use]
    pub fn into_field_of(self, table: &str) -> (String, String) {
        let within = |key| format!("{table}.{key}");
        match self {
            Self::UnknownKey { key } => Self::UnknownKey { key: within(key) },
            Self::Value { key, reason } => Self::Value { key: key.map(within), reason },
            syntax @ Self::Syntax { .. } => syntax,
        }
        .into_field_or(table)
    }

    fn into_field_or(self, whole: &str) -> (String, String) {
        match self {
            Self::Syntax { line, column, reason } => (format!("line {line}, column {column}"), reason),
            Self::UnknownKey { key } => (key, "is not known; remove it or correct its spelling".to_owned()),
            Self::Value { key, reason } => (key.unwrap_or_else(|| whole.to_owned()), reason),
        }
    }

    fn syntax(text: &str, error: &toml::de::Error) -> Self {
        let start = error.span().map_or(0, |span| span.start);
        let before = text.get(..start).unwrap_or(text);
        Self::Syntax {
            line: before.matches('\n').count() + 1,
            column: before.chars().rev().take_while(|c| *c != '\n').count() + 1,
            reason: one_line(error.message()),
        }
    }
}

/// A text as it stands there, for who looks at some of its keys before it is a value.
///
/// # Errors
///
/// [`Fault::Syntax`] where it is no TOML.
pub fn table(text: &str) -> Result<Table, Fault> {
    text.parse().map_err(|error| Fault::syntax(text, &error))
}

/// A text as a value.
///
/// # Errors
///
/// [`Fault`] says what is wrong where.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, Fault> {
    of_table(table(text)?)
}

/// A table that was read before, or a part of one, as a value.
///
/// # Errors
///
/// As [`parse`].
pub fn of_table<T: DeserializeOwned>(table: Table) -> Result<T, Fault> {
    let mut value = None;
    tracked(table, &mut |tree| {
        value = Some(erased_serde::deserialize(tree)?);
        Ok(())
    })?;
    value.ok_or_else(|| Fault::Value { key: None, reason: "has no value".to_owned() })
}

/// Lets `read` read a table, and says where it fails. Nothing here depends on the type of a value.
fn tracked(
    table: Table,
    read: &mut dyn FnMut(&mut dyn Erased<'_>) -> Result<(), ErasedError>,
) -> Result<(), Fault> {
    let (mut unknown, mut track) = (None, Track::new());
    let mut ignored = |path: serde_ignored::Path<'_>| {
        unknown.get_or_insert_with(|| with_indices(&path.to_string()));
    };
    let path_aware = serde_path_to_error::Deserializer::new(Value::Table(table), &mut track);
    let tree = serde_ignored::Deserializer::new(path_aware, &mut ignored);
    let done = read(&mut <dyn Erased<'_>>::erase(tree));
    if let Some(key) = unknown {
        return Err(Fault::UnknownKey { key });
    }
    done.map_err(|error| {
        let key = Some(track.path().to_string()).filter(|path| path != ".");
        // Each table on the way out adds a line that names it, which the path does, too.
        let text = error.to_string();
        let reason = one_line(text.split("\nin `").next().unwrap_or(&text));
        Fault::Value { key, reason }
    })
}

/// `list.1.part.?.key` as `list[1].part.key`: a question mark stands for a value that may be absent.
fn with_indices(path: &str) -> String {
    let mut out = String::with_capacity(path.len());
    for part in path.split('.').filter(|part| *part != "?") {
        if part.bytes().all(|b| b.is_ascii_digit()) {
            out += &format!("[{part}]");
        } else {
            out += if out.is_empty() { "" } else { "." };
            out += part;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    struct File {
        name: String,
        #[serde(default)]
        parts: Vec<Part>,
        #[serde(default)]
        rest: Table,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    struct Part {
        sizes: [f32; 2],
        count: Option<u64>,
        shape: Option<Shape>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
    enum Shape {
        Ball { radius: f64 },
        Flat,
    }

    fn refused(text: &str) -> String {
        let (field, reason) = parse::<File>(text).unwrap_err().into_field();
        format!("{field}: {reason}")
    }

    #[test]
    fn a_text_is_read() {
        let text = "name = 'a'\nrest.part.size = 2\n[[parts]]\nsizes = [1, 2.5]\ncount = 3\nshape = { type = 'ball', radius = 2 }";
        let file: File = parse(text).unwrap();
        let shape = Some(Shape::Ball { radius: 2.0 });
        assert_eq!(file.parts, [Part { sizes: [1.0, 2.5], count: Some(3), shape }]);
        assert_eq!(file.rest["part"]["size"], Value::Integer(2));
        assert_eq!(of_table::<File>(text.parse().unwrap()).unwrap(), file);
    }

    #[test]
    fn a_fault_says_where_it_is() {
        insta::assert_snapshot!(refused("name = 'a'\nname = 'b'"), @"line 2, column 1: duplicate key");
        insta::assert_snapshot!(refused("name = 3"), @"name: invalid type: integer `3`, expected a string");
        insta::assert_snapshot!(refused("parts = []"), @"(whole file): missing field `name`");
        insta::assert_snapshot!(refused("name = 'a'\n[[parts]]\nsizes = [1, 2]\n[[parts]]\nsizes = [1, 'b']"), @"parts[1].sizes[1]: invalid type: string \"b\", expected f32");
        insta::assert_snapshot!(refused("name = 'a'\n[[parts]]\nsizes = [1, 2]\ncount = -1"), @"parts[0].count: invalid value: integer `-1`, expected u64");
        insta::assert_snapshot!(refused("name = 'a'\n[[parts]]\nsizes = [1, 2]\nshape = { type = 'cube' }"), @"parts[0].shape.type: unknown variant `cube`, expected `ball` or `flat`");
        insta::assert_snapshot!(refused("name = 'a'\n[[parts]]\nsizes = [1, 2]\nshape = { type = 'ball', radios = 1 }"), @"parts[0].shape: unknown field `radios`, expected `radius`");
    }

    #[test]
    fn a_misspelt_key_comes_before_the_one_that_is_missing() {
        insta::assert_snapshot!(refused("nane = 'a'"), @"nane: is not known; remove it or correct its spelling");
        insta::assert_snapshot!(refused("name = 'a'\n[[parts]]\nsize = 1"), @"parts[0].size: is not known; remove it or correct its spelling");
    }

    #[test]
    fn a_part_of_a_file_is_named_in_it() {
        let table: Table = "name = 1".parse().unwrap();
        let fault = of_table::<File>(table).unwrap_err();
        assert_eq!(fault.clone().into_field_of("medium").0, "medium.name");
        let (field, _) = of_table::<File>(Table::new()).unwrap_err().into_field_of("medium");
        assert_eq!(field, "medium");
    }
}
