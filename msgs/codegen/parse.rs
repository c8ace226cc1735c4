//! Reads the ROS 2 interface text of `.msg` and `.srv` files.

use std::fmt;

/// A type without its array part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Base {
    Bool,
    Byte,
    Uint8,
    Int8,
    Uint16,
    Int16,
    Uint32,
    Int32,
    Uint64,
    Int64,
    Float32,
    Float64,
    /// A string, with its bound in bytes.
    String(Option<u32>),
    /// Another message by its full name, `pkg/msg/Type`.
    Nested(String),
}

/// How many of a base type a field holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    One,
    Array(u32),
    Sequence,
    Bounded(u32),
}

/// One field of a structure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    pub name: String,
    pub base: Base,
    pub shape: Shape,
    pub default: Option<String>,
    pub ros_type: String,
    pub doc: String,
}

/// One named constant of a structure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Constant {
    pub name: String,
    pub base: Base,
    pub value: String,
    pub doc: String,
}

/// A message, or one half of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Structure {
    /// `pkg/msg/Type`, or `pkg/srv/Type_Request`.
    pub name: String,
    pub doc: String,
    pub text: String,
    pub fields: Vec<Field>,
    pub constants: Vec<Constant>,
}

/// A service: two structures.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Service {
    /// `pkg/srv/Type`.
    pub name: String,
    pub doc: String,
    pub request: Structure,
    pub response: Structure,
}

/// A line that is not interface text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParseError {
    pub line: usize,
    pub problem: String,
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.problem)
    }
}

/// Reads a `.msg` file. `package` resolves types that name no package.
pub fn message(package: &str, name: &str, text: &str) -> Result<Structure, ParseError> {
    structure(package, format!("{package}/msg/{name}"), text, 0)
}

/// Reads a `.srv` file: request and response around one `---` line.
pub fn service(package: &str, name: &str, text: &str) -> Result<Service, ParseError> {
    let lines: Vec<&str> = text.lines().collect();
    let bars: Vec<usize> =
        lines.iter().enumerate().filter(|(_, line)| line.trim_end() == "---").map(|(i, _)| i).collect();
    let [bar] = bars[..] else {
        return Err(ParseError {
            line: bars.get(1).map_or(lines.len(), |i| i + 1),
            problem: format!("a service has exactly one `---` line, this one has {}", bars.len()),
        });
    };
    let half = |suffix: &str, lines: &[&str], offset: usize| {
        let mut text = lines.join("\n");
        if !text.is_empty() {
            text.push('\n');
        }
        structure(package, format!("{package}/srv/{name}_{suffix}"), &text, offset)
    };
    let mut request = half("Request", &lines[..bar], 0)?;
    let mut response = half("Response", &lines[bar + 1..], bar + 1)?;
    let doc = std::mem::take(&mut request.doc);
    request.doc = format!("Request of the service `{package}/srv/{name}`.");
    response.doc = format!("Response of the service `{package}/srv/{name}`.");
    Ok(Service { name: format!("{package}/srv/{name}"), doc, request, response })
}

fn structure(package: &str, name: String, text: &str, first_line: usize) -> Result<Structure, ParseError> {
    let mut out =
        Structure { name, doc: String::new(), text: text.to_owned(), fields: vec![], constants: vec![] };
    let mut at_top = true;
    let mut pending = Vec::new();
    for (index, raw) in text.lines().enumerate() {
        let fail = |problem: String| ParseError { line: first_line + index + 1, problem };
        let (code, comment) = split_comment(raw);
        let code = code.trim();
        if code.is_empty() {
            match comment {
                Some(comment) => pending.push(comment),
                None if at_top && !pending.is_empty() => {
                    out.doc = std::mem::take(&mut pending).join("\n");
                    at_top = false;
                }
                None => pending.clear(),
            }
            continue;
        }
        // The first block of comments speaks of the whole file.
        if at_top {
            out.doc = std::mem::take(&mut pending).join("\n");
            at_top = false;
        }
        let mut doc = std::mem::take(&mut pending);
        doc.extend(comment);
        let doc = doc.join("\n");

        let (ros_type, rest) = code
            .split_once(char::is_whitespace)
            .ok_or_else(|| fail(format!("`{code}` is neither `TYPE name` nor `TYPE NAME=value`")))?;
        let (base, shape) = field_type(package, ros_type).map_err(fail)?;
        let rest = rest.trim();
        let name_len = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
        let (name, value) = rest.split_at(name_len);
        let value = value.trim();
        if let Some(value) = value.strip_prefix('=') {
            if !is_constant_name(name) {
                return Err(fail(format!("constant `{name}` is not UPPER_CASE")));
            }
            if shape != Shape::One || matches!(base, Base::Nested(_)) {
                return Err(fail(format!(
                    "constant `{name}` has the type `{ros_type}`; only scalars can be constant"
                )));
            }
            let value = value.trim();
            check_value(&base, value).map_err(fail)?;
            out.constants.push(Constant { name: name.to_owned(), base, value: value.to_owned(), doc });
        } else {
            if !is_field_name(name) {
                return Err(fail(format!("field name `{name}` is not lower_case with single underscores")));
            }
            if out.fields.iter().any(|field| field.name == name) {
                return Err(fail(format!("field `{name}` appears twice")));
            }
            let default = (!value.is_empty()).then(|| value.to_owned());
            if let Some(value) = &default {
                if shape != Shape::One || matches!(base, Base::Nested(_)) {
                    return Err(fail(format!("field `{name}`: only scalars can have a default value here")));
                }
                check_value(&base, value).map_err(fail)?;
            }
            out.fields.push(Field {
                name: name.to_owned(),
                base,
                shape,
                default,
                ros_type: ros_type.to_owned(),
                doc,
            });
        }
    }
    if at_top {
        out.doc = pending.join("\n");
    }
    Ok(out)
}

/// Splits at the first `#` outside of quotes.
fn split_comment(line: &str) -> (&str, Option<String>) {
    let mut quote = None;
    for (i, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') => return (&line[..i], Some(line[i..].trim_start_matches('#').trim().to_owned())),
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), c) if open == c => quote = None,
            _ => {}
        }
    }
    (line, None)
}

fn field_type(package: &str, text: &str) -> Result<(Base, Shape), String> {
    let (base, shape) = match text.strip_suffix(']') {
        None => (text, Shape::One),
        Some(head) => {
            let (base, size) =
                head.rsplit_once('[').ok_or_else(|| format!("`{text}` has `]` without `[`"))?;
            let number = |digits: &str| match digits.parse() {
                Ok(n) if n > 0 => Ok(n),
                _ => Err(format!("`{size}` in `{text}` is not a size of at least 1")),
            };
            let shape = match size.strip_prefix("<=") {
                _ if size.is_empty() => Shape::Sequence,
                Some(bound) => Shape::Bounded(number(bound)?),
                None => Shape::Array(number(size)?),
            };
            (base, shape)
        }
    };
    let base = match base {
        "bool" => Base::Bool,
        "byte" => Base::Byte,
        "char" | "uint8" => Base::Uint8,
        "int8" => Base::Int8,
        "uint16" => Base::Uint16,
        "int16" => Base::Int16,
        "uint32" => Base::Uint32,
        "int32" => Base::Int32,
        "uint64" => Base::Uint64,
        "int64" => Base::Int64,
        "float32" => Base::Float32,
        "float64" => Base::Float64,
        "string" => Base::String(None),
        _ if base.starts_with("string<=") => {
            let bound = base["string<=".len()..].parse().ok().filter(|n| *n > 0);
            Base::String(Some(bound.ok_or_else(|| format!("`{base}` has no bound of at least 1"))?))
        }
        _ if base.starts_with("wstring") => {
            return Err("wide strings are not supported: use string".to_owned());
        }
        _ => {
            let (package, name) = base.split_once('/').unwrap_or((package, base));
            if !is_type_name(name) || !is_field_name(package) {
                return Err(format!("`{base}` is not a type"));
            }
            Base::Nested(format!("{package}/msg/{name}"))
        }
    };
    Ok((base, shape))
}

fn check_value(base: &Base, value: &str) -> Result<(), String> {
    let good = match base {
        Base::Bool => matches!(value, "true" | "false" | "True" | "False" | "0" | "1"),
        Base::Byte | Base::Uint8 => value.parse::<u8>().is_ok(),
        Base::Int8 => value.parse::<i8>().is_ok(),
        Base::Uint16 => value.parse::<u16>().is_ok(),
        Base::Int16 => value.parse::<i16>().is_ok(),
        Base::Uint32 => value.parse::<u32>().is_ok(),
        Base::Int32 => value.parse::<i32>().is_ok(),
        Base::Uint64 => value.parse::<u64>().is_ok(),
        Base::Int64 => value.parse::<i64>().is_ok(),
        Base::Float32 | Base::Float64 => value.parse::<f64>().is_ok_and(f64::is_finite),
        Base::String(_) => !value.is_empty(),
        Base::Nested(_) => false,
    };
    if good { Ok(()) } else { Err(format!("`{value}` is not a value of its type")) }
}

fn is_field_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
        && !name.ends_with('_')
        && !name.contains("__")
}

fn is_constant_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase())
        && name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
}

fn is_type_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase()) && name.chars().all(|c| c.is_ascii_alphanumeric())
}
