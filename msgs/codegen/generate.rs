//! Writes the Rust text of parsed interfaces.

use std::collections::BTreeMap;
use std::fmt::Write;

use crate::describe::Descriptions;
use crate::parse::{Base, Constant, Field, Service, Shape, Structure};

/// The package whose types stand at the root of the crate.
pub const OWN_PACKAGE: &str = "dermis_msgs";

/// Everything that one build turns into Rust.
#[derive(Default)]
pub struct Interfaces {
    /// By full name, halves of services included.
    pub structures: BTreeMap<String, Structure>,
    /// By full name.
    pub services: BTreeMap<String, Service>,
    pub descriptions: Descriptions,
}

impl Interfaces {
    /// The text of the generated file.
    pub fn rust(&self) -> Result<String, String> {
        let mut modules: BTreeMap<(&str, &str), String> = BTreeMap::new();
        for structure in self.structures.values() {
            let (package, kind, _) = split(&structure.name);
            modules.entry((package, kind)).or_default().push_str(&self.structure(structure)?);
        }
        for service in self.services.values() {
            let (package, kind, _) = split(&service.name);
            modules.entry((package, kind)).or_default().push_str(&self.service(service)?);
        }

        let mut packages: BTreeMap<&str, String> = BTreeMap::new();
        for ((package, kind), body) in modules {
            let what = if kind == "msg" { "Messages" } else { "Services" };
            writeln!(
                packages.entry(package).or_default(),
                "/// {what} of the package `{package}`.\n{QUALIFIED}pub mod {kind} {{\n{body}}}"
            )
            .expect(INFALLIBLE);
        }
        let mut out = String::new();
        for (package, body) in packages {
            if package == OWN_PACKAGE {
                out.push_str(&body);
            } else {
                writeln!(out, "/// The package `{package}`.\npub mod {package} {{\n{body}}}")
                    .expect(INFALLIBLE);
            }
        }

        writeln!(out, "{QUALIFIED}static MESSAGES: &[TypeSupport] = &[").expect(INFALLIBLE);
        for name in self.structures.keys() {
            writeln!(out, "    TypeSupport::new::<{}>(),", rust_path(name)).expect(INFALLIBLE);
        }
        writeln!(out, "];\n{QUALIFIED}static SERVICES: &[ServiceSupport] = &[").expect(INFALLIBLE);
        for name in self.services.keys() {
            writeln!(out, "    ServiceSupport::new::<{}>(),", rust_path(name)).expect(INFALLIBLE);
        }
        out.push_str("];\n");
        Ok(out)
    }

    /// The messages of [`OWN_PACKAGE`] alone, for a module that keeps definitions of before beside those of today.
    pub fn rust_of_own_messages(&self) -> Result<String, String> {
        let mut body = String::new();
        for structure in self.structures.values().filter(|s| split(&s.name).0 == OWN_PACKAGE) {
            body.push_str(&self.structure(structure)?);
        }
        Ok(format!("/// The messages as they were.\n{QUALIFIED}pub mod msg {{\n{body}}}\n"))
    }

    fn structure(&self, structure: &Structure) -> Result<String, String> {
        let name = rust_name(&structure.name);
        let FieldTexts { fields, write, read, sizes, defaults } = FieldTexts::of(structure)?;
        let read = if structure.fields.is_empty() {
            "        r.placeholder()?;\n        Ok(Self {})\n".to_owned()
        } else {
            format!("        Ok(Self {{\n{read}        }})\n")
        };
        let derive = if has_defaults(structure) { "" } else { "Default, " };
        let default = if has_defaults(structure) {
            format!(
                "impl Default for {name} {{\n    fn default() -> Self {{\n        Self {{\n{defaults}        }}\n    }}\n}}\n"
            )
        } else {
            String::new()
        };
        let constants = self.constants(&name, &structure.constants);
        let doc =
            if structure.doc.is_empty() { format!("`{}`.", structure.name) } else { escape(&structure.doc) };
        let full = &structure.name;
        let hash = self.descriptions.hash(full)?;
        let definition = self.definition(structure)?;
        Ok(format!(
            "#[doc = {doc:?}]
#[derive(Debug, Clone, PartialEq, {derive}serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct {name} {{
{fields}}}
{default}{constants}impl crate::cdr::Cdr for {name} {{
    const MIN_SIZE: usize = {};
    fn write(&self, w: &mut crate::cdr::Writer) {{
{write}    }}
    fn read(r: &mut crate::cdr::Reader<'_>) -> Result<Self, crate::cdr::CdrErrorKind> {{
{read}    }}
}}
impl crate::Message for {name} {{
    const TYPE_NAME: &'static str = \"{full}\";
    const TYPE_HASH: &'static str = \"{hash}\";
    const DEFINITION: &'static str = {definition:?};
}}
",
            sizes.join(" + ")
        ))
    }

    fn constants(&self, name: &str, constants: &[Constant]) -> String {
        if constants.is_empty() {
            return String::new();
        }
        let mut out = format!("impl {name} {{\n");
        for constant in constants {
            let doc = if constant.doc.is_empty() {
                format!("`{}`", constant.value)
            } else {
                format!("`{}`: {}", constant.value, escape(&constant.doc))
            };
            let ty = match constant.base {
                Base::String(_) => "&'static str".to_owned(),
                ref base => rust_base(base),
            };
            writeln!(
                out,
                "    #[doc = {doc:?}]\n    pub const {}: {ty} = {};",
                constant.name,
                literal(&constant.base, &constant.value)
            )
            .expect(INFALLIBLE);
        }
        out.push_str("}\n");
        out
    }

    fn service(&self, service: &Service) -> Result<String, String> {
        let name = rust_name(&service.name);
        let full = &service.name;
        let doc = if service.doc.is_empty() { format!("`{full}`.") } else { escape(&service.doc) };
        Ok(format!(
            "#[doc = {doc:?}]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct {name};
impl crate::Service for {name} {{
    const TYPE_NAME: &'static str = \"{full}\";
    const TYPE_HASH: &'static str = \"{}\";
    type Request = {name}Request;
    type Response = {name}Response;
}}
",
            self.descriptions.hash(full)?
        ))
    }

    /// The text of a structure and of all it refers to, as MCAP's `ros2msg` schemas have it.
    fn definition(&self, structure: &Structure) -> Result<String, String> {
        let mut out = structure.text.clone();
        for name in self.descriptions.references(&structure.name)? {
            let reference = self
                .structures
                .get(name)
                .ok_or_else(|| format!("{} refers to {name}, which has no text", structure.name))?;
            let (package, _, last) = split(name);
            write!(out, "{}\nMSG: {package}/{last}\n{}", "=".repeat(80), reference.text).expect(INFALLIBLE);
        }
        Ok(out)
    }
}

/// What the fields of a structure make.
#[derive(Default)]
struct FieldTexts {
    fields: String,
    /// Statements of `write`.
    write: String,
    /// Fields of what `read` returns.
    read: String,
    /// Terms of the smallest size.
    sizes: Vec<String>,
    /// Fields of what `default` returns.
    defaults: String,
}

impl FieldTexts {
    fn of(structure: &Structure) -> Result<Self, String> {
        let mut texts = Self::default();
        for field in &structure.fields {
            texts.add(structure, field)?;
        }
        if structure.fields.is_empty() {
            texts.write.push_str("        w.placeholder();\n");
            texts.sizes.push("1".to_owned());
        }
        Ok(texts)
    }

    fn add(&mut self, structure: &Structure, field: &Field) -> Result<(), String> {
        let id = rust_field(&field.name);
        let ty = rust_type(field);
        if let Shape::Array(n @ 33..) = field.shape {
            // Default, Serialize and Deserialize end at 32.
            return Err(format!("{}.{}: arrays of {n} > 32 are not supported", structure.name, field.name));
        }
        let mut doc = format!("`{}`", field.ros_type);
        if !field.doc.is_empty() {
            write!(doc, ": {}", escape(&field.doc)).expect(INFALLIBLE);
        }
        let json = match field.base {
            Base::Float32 | Base::Float64 => "    #[serde(with = \"crate::json\")]\n",
            _ => "",
        };
        writeln!(self.fields, "    #[doc = {doc:?}]\n{json}    pub {id}: {ty},").expect(INFALLIBLE);
        self.sizes.push(format!("<{ty} as crate::cdr::Cdr>::MIN_SIZE"));
        writeln!(self.write, "        crate::cdr::Cdr::write(&self.{id}, w);").expect(INFALLIBLE);
        let (_, _, last) = split(&structure.name);
        let call = match (&field.base, field.shape) {
            (_, Shape::Bounded(max)) => format!("r.bounded_sequence({max})?"),
            (Base::String(Some(max)), Shape::One) => format!("r.bounded_string({max})?"),
            (Base::String(Some(_)), _) => {
                return Err(format!(
                    "{}.{}: arrays of bounded strings are not supported",
                    structure.name, field.name
                ));
            }
            _ => "crate::cdr::Cdr::read(r)?".to_owned(),
        };
        writeln!(self.read, "            {id}: {{ r.enter(\"{last}.{}\"); {call} }},", field.name)
            .expect(INFALLIBLE);
        let default =
            field.default.as_deref().map_or("Default::default()".to_owned(), |v| literal(&field.base, v));
        let owned = matches!(field.base, Base::String(_)) && field.default.is_some();
        writeln!(self.defaults, "            {id}: {default}{},", if owned { ".to_owned()" } else { "" })
            .expect(INFALLIBLE);
        Ok(())
    }
}

/// Whether a structure has other defaults than Rust's own.
fn has_defaults(structure: &Structure) -> bool {
    structure.fields.iter().any(|field| {
        let value = field.default.as_deref().map(|value| literal(&field.base, value));
        value.is_some_and(|value| !matches!(value.as_str(), "false" | "0" | "0.0" | "\"\""))
    })
}

/// Paths are spelled out from the root of the crate, so that no type of a package hides another.
const QUALIFIED: &str = "#[allow(unused_qualifications, reason = \"generated\")]\n";

const INFALLIBLE: &str = "writing to a String cannot fail";

/// Splits `pkg/msg/Type` into its parts.
fn split(name: &str) -> (&str, &str, &str) {
    let mut parts = name.splitn(3, '/');
    let mut next = || parts.next().expect("full names are made of three parts by the parser");
    (next(), next(), next())
}

fn rust_name(full: &str) -> String {
    split(full).2.replace('_', "")
}

fn rust_path(full: &str) -> String {
    let (package, kind, _) = split(full);
    if package == OWN_PACKAGE {
        format!("crate::{kind}::{}", rust_name(full))
    } else {
        format!("crate::{package}::{kind}::{}", rust_name(full))
    }
}

fn rust_field(name: &str) -> String {
    const KEYWORDS: &[&str] = &[
        "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "do", "dyn",
        "else", "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop",
        "macro", "match", "mod", "move", "mut", "override", "priv", "pub", "ref", "return", "static",
        "struct", "trait", "true", "try", "type", "typeof", "unsafe", "unsized", "use", "virtual", "where",
        "while", "yield",
    ];
    if KEYWORDS.contains(&name) { format!("r#{name}") } else { name.to_owned() }
}

fn rust_base(base: &Base) -> String {
    match base {
        Base::Bool => "bool",
        Base::Byte | Base::Uint8 => "u8",
        Base::Int8 => "i8",
        Base::Uint16 => "u16",
        Base::Int16 => "i16",
        Base::Uint32 => "u32",
        Base::Int32 => "i32",
        Base::Uint64 => "u64",
        Base::Int64 => "i64",
        Base::Float32 => "f32",
        Base::Float64 => "f64",
        // std_msgs has a message of that name.
        Base::String(_) => "::std::string::String",
        // Beside the type that refers to it, in whichever module both are.
        Base::Nested(name) if split(name).0 == OWN_PACKAGE => {
            return format!("super::{}::{}", split(name).1, rust_name(name));
        }
        Base::Nested(name) => return rust_path(name),
    }
    .to_owned()
}

fn rust_type(field: &Field) -> String {
    let base = rust_base(&field.base);
    match field.shape {
        Shape::One => base,
        Shape::Array(n) => format!("[{base}; {n}]"),
        Shape::Sequence | Shape::Bounded(_) => format!("Vec<{base}>"),
    }
}

fn literal(base: &Base, value: &str) -> String {
    match base {
        Base::Bool => matches!(value, "true" | "True" | "1").to_string(),
        Base::Float32 | Base::Float64 => {
            value.parse::<f64>().map_or_else(|_| value.to_owned(), |number| format!("{number:?}"))
        }
        Base::String(_) => {
            let bare = [('"', '"'), ('\'', '\'')]
                .iter()
                .find_map(|&(open, close)| value.strip_prefix(open)?.strip_suffix(close))
                .unwrap_or(value);
            format!("{bare:?}")
        }
        _ => value.to_owned(),
    }
}

/// Keeps units in square brackets and the like from being read as markdown.
fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        if matches!(c, '[' | ']' | '*' | '<' | '>' | '_') {
            out.push('\\');
        }
        out.push(c);
    }
    out
}
