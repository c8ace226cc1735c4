//! Whether the schemas that `dermis schema` prints say what the readers of the files say.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use dermis_skin::{Effect, SkinDescription};
use dermis_testbed::Plan;
use serde_json::Value;

use crate::{SENSORS, program};

/// Kinds of files that have a schema.
const KINDS: [&str; 4] = ["skin", "launch", "plan", "effects"];

/// What `dermis schema` prints, run once.
fn text(kind: &str) -> String {
    static PRINTED: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());
    let mut printed = PRINTED.lock().unwrap_or_else(PoisonError::into_inner);
    let text = printed.entry(kind.to_owned()).or_insert_with(|| {
        let done = program(&["schema", kind]);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    });
    text.clone()
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn schema(kind: &str) -> Value {
    serde_json::from_str(&text(kind)).unwrap()
}

/// Files of a folder whose names end so.
fn files(folder: &str, end: &str) -> Vec<PathBuf> {
    let all = std::fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<PathBuf> =
        all.filter(|path| path.to_string_lossy().ends_with(end) && path.is_file()).collect();
    found.sort();
    assert!(!found.is_empty(), "{folder} has no {end}");
    found
}

fn toml(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap();
    serde_json::to_value(toml::from_str::<toml::Table>(&text).unwrap()).unwrap()
}

fn yaml(path: &Path) -> Value {
    let file = config::File::from(path).format(config::FileFormat::Yaml);
    config::Config::builder().add_source(file).build().unwrap().try_deserialize().unwrap()
}

/// The parts of JSON Schema that ours are written in.
struct Validator {
    main: Value,
    effects: Value,
}

impl Validator {
    fn new(kind: &str) -> Self {
        Self { main: schema(kind), effects: schema("effects") }
    }

    fn check(&self, value: &Value) -> Result<(), String> {
        self.fits(value, &self.main, "")
    }

    fn resolve(&self, reference: &str) -> &Value {
        let (file, pointer) = reference.split_once('#').unwrap();
        let base = if file.is_empty() { &self.main } else { &self.effects };
        assert!(file.is_empty() || file == "effects.schema.json", "{reference}");
        // A reference without a file inside the effects is one into them.
        base.pointer(pointer).or_else(|| self.effects.pointer(pointer)).unwrap()
    }

    #[expect(clippy::too_many_lines, reason = "one arm for each keyword of a schema")]
    fn fits(&self, value: &Value, schema: &Value, at: &str) -> Result<(), String> {
        let Value::Object(keywords) = schema else {
            return if *schema == Value::Bool(false) {
                Err(format!("{at} may not be there"))
            } else {
                Ok(())
            };
        };
        for (keyword, says) in keywords {
            match keyword.as_str() {
                "$schema" | "title" | "description" | "default" | "examples" | "$defs" | "if" => {}
                "$ref" => self.fits(value, self.resolve(says.as_str().unwrap()), at)?,
                "type" => {
                    let names: Vec<&str> = match says {
                        Value::Array(names) => names.iter().filter_map(Value::as_str).collect(),
                        name => vec![name.as_str().unwrap()],
                    };
                    if !names.iter().any(|name| is(value, name)) {
                        return Err(format!("{at} is no {}: {value}", names.join(" or ")));
                    }
                }
                "const" if value == says => {}
                "const" => return Err(format!("{at} must be {says}")),
                "enum" if says.as_array().unwrap().contains(value) => {}
                "enum" => return Err(format!("{at} must be one of {says}: {value}")),
                "oneOf" | "anyOf" => {
                    let tried: Vec<_> =
                        says.as_array().unwrap().iter().map(|s| self.fits(value, s, at)).collect();
                    let fitting = tried.iter().filter(|t| t.is_ok()).count();
                    if fitting == 0 || (keyword == "oneOf" && fitting > 1) {
                        let why: Vec<String> = tried.into_iter().filter_map(Result::err).collect();
                        return Err(format!("{at} fits {fitting} of its forms: {}", why.join("; ")));
                    }
                }
                "allOf" => {
                    for s in says.as_array().unwrap() {
                        self.fits(value, s, at)?;
                    }
                }
                "then" => {
                    if self.fits(value, &keywords["if"], at).is_ok() {
                        self.fits(value, says, at)?;
                    }
                }
                "items" => {
                    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
                        self.fits(item, says, &format!("{at}[{i}]"))?;
                    }
                }
                "minItems" | "maxItems" => {
                    let count = value.as_array().map(|a| a.len() as u64);
                    let limit = says.as_u64().unwrap();
                    if count.is_some_and(|c| if keyword == "minItems" { c < limit } else { c > limit }) {
                        return Err(format!("{at} has {count:?} items, {keyword} is {limit}"));
                    }
                }
                "minimum" | "maximum" | "exclusiveMinimum" => {
                    let limit = says.as_f64().unwrap();
                    let outside = |v: f64| match keyword.as_str() {
                        "minimum" => v < limit,
                        "maximum" => v > limit,
                        _ => v <= limit,
                    };
                    if value.as_f64().is_some_and(outside) {
                        return Err(format!("{at} is {value}, {keyword} is {limit}"));
                    }
                }
                "pattern" => {
                    let pattern = regex::Regex::new(says.as_str().unwrap()).unwrap();
                    if value.as_str().is_some_and(|text| !pattern.is_match(text)) {
                        return Err(format!("{at} does not match {pattern}: {value}"));
                    }
                }
                "required" => {
                    for key in says.as_array().unwrap().iter().filter_map(Value::as_str) {
                        if value.is_object() && value.get(key).is_none() {
                            return Err(format!("{at}.{key} is missing"));
                        }
                    }
                }
                "properties" => {
                    for (key, schema) in says.as_object().unwrap() {
                        if let Some(value) = value.get(key) {
                            self.fits(value, schema, &format!("{at}.{key}"))?;
                        }
                    }
                }
                "additionalProperties" => {
                    let known = &schema["properties"];
                    for (key, value) in value.as_object().into_iter().flatten() {
                        if known.get(key).is_none() {
                            self.fits(value, says, &format!("{at}.{key}"))?;
                        }
                    }
                }
                other => panic!("this test does not know the keyword {other}"),
            }
        }
        Ok(())
    }
}

fn is(value: &Value, name: &str) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        other => panic!("no type {other}"),
    }
}

#[test]
fn what_is_committed_is_what_is_printed() {
    for kind in KINDS {
        let path = root().join(format!("launch/schemas/{kind}.schema.json"));
        assert!(
            std::fs::read_to_string(&path).unwrap_or_default() == text(kind),
            "{} is stale: run `cargo xtask docs --tables`",
            path.display()
        );
    }
}

#[test]
fn every_file_that_ships_fits_its_schema_and_names_it() {
    let tables: [(&str, &[&str], &str); 3] = [
        ("skin", &["launch/skins", "launch/gap"], "#:schema ../schemas/skin.schema.json\n"),
        ("plan", &["launch/plans"], "#:schema ../schemas/plan.schema.json\n"),
        ("effects", &["launch/effects"], "#:schema ../schemas/effects.schema.json\n"),
    ];
    let mut wrong = String::new();
    for (kind, folders, first) in tables {
        let validator = Validator::new(kind);
        for path in folders.iter().flat_map(|folder| files(folder, ".toml")) {
            let text = std::fs::read_to_string(&path).unwrap();
            if !text.starts_with(first) {
                let _ = writeln!(wrong, "{} must begin with {first}", path.display());
            }
            if let Err(why) = validator.check(&toml(&path)) {
                let _ = writeln!(wrong, "{}: {why}", path.display());
            }
        }
    }
    let validator = Validator::new("launch");
    for path in files("launch", ".launch.yaml") {
        let text = std::fs::read_to_string(&path).unwrap();
        if !text.starts_with("# yaml-language-server: $schema=schemas/launch.schema.json\n") {
            let _ = writeln!(wrong, "{} does not name its schema", path.display());
        }
        if let Err(why) = validator.check(&yaml(&path)) {
            let _ = writeln!(wrong, "{}: {why}", path.display());
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn mistakes_do_not_fit() {
    let skin = toml(&root().join("launch/skins/baro-grid.toml"));
    let validator = Validator::new("skin");
    for (pointer, value) in [
        ("/rate", serde_json::json!("fast")),
        ("/rate", serde_json::json!(0)),
        ("/name", serde_json::json!("Big Pad")),
        ("/surface/size", serde_json::json!([0.03])),
        ("/surface/type", serde_json::json!("disc")),
        ("/medium/base", serde_json::json!("glued")),
        ("/medium/thickness", serde_json::json!("10 mm")),
    ] {
        let mut wrong = skin.clone();
        *wrong.pointer_mut(pointer).unwrap() = value;
        assert!(validator.check(&wrong).is_err(), "{pointer}");
    }
    let effects = |text: &str| Validator::new("effects").check(&toml_text(text));
    assert_eq!(effects("[[effects]]\nname = \"tilt\"\nangle = 0.1"), Ok(()));
    for wrong in [
        "[[effects]]\nname = \"tilt\"\nangel = 0.1",
        "[[effects]]\nname = \"tillt\"",
        "[[effects]]\nname = \"tilt\"\nstrength = -1",
        "[[effects]]\nstrength = 1",
        "effect = []",
    ] {
        assert!(effects(wrong).is_err(), "{wrong}");
    }
}

fn toml_text(text: &str) -> Value {
    serde_json::to_value(toml::from_str::<toml::Table>(text).unwrap()).unwrap()
}

/// Keys that a refusal names as known: `expected one of `a`, `b``, or `known here: a, b`.
fn named(refusal: &str) -> BTreeSet<String> {
    let marks = ["expected one of ", "expected ", "known here: ", "known keys are ", "which has "];
    let (_, list) = marks
        .iter()
        .find_map(|mark| refusal.split_once(mark))
        .unwrap_or_else(|| panic!("names no known keys: {refusal}"));
    list.split(|c: char| !(c.is_alphanumeric() || "_-`, ".contains(c)))
        .next()
        .unwrap_or_default()
        .replace(" or ", ",")
        .split([',', ' '])
        .map(|key| key.trim_matches('`').to_owned())
        .filter(|key| !key.is_empty())
        .collect()
}

/// A file with one key more, which its reader refuses; the keys that the reader knows there, and those of the schema.
struct Probe<'a> {
    kind: &'a str,
    file: &'a str,
    /// Where the key is put.
    at: &'a str,
    /// The object in the schema.
    schema: &'a str,
}

const UNKNOWN: &str = "no_such_key";

impl Probe<'_> {
    fn check(&self, read: impl Fn(&str) -> String) {
        let mut value = toml(&root().join(self.file));
        for (key, there) in [("wire", "scale"), ("condition", "coupled")] {
            if self.at == format!("/{key}") {
                value[key][there] = if key == "wire" { 1.0.into() } else { true.into() };
            }
        }
        let object = value.pointer_mut(self.at).unwrap_or_else(|| panic!("{} has no {}", self.file, self.at));
        object[UNKNOWN] = 1.into();
        assert!(Validator::new(self.kind).check(&value).is_err(), "{} {}: fits", self.file, self.at);
        let refusal = read(&toml::to_string(&value).unwrap());
        assert!(refusal.contains(UNKNOWN), "{} {}: {refusal}", self.file, self.at);
        let schema = schema(self.kind);
        let object =
            schema.pointer(self.schema).unwrap_or_else(|| panic!("no {} in the schema", self.schema));
        let properties = object["properties"].as_object().unwrap();
        // Where a key says which form it is, readers have taken it before they look at the others.
        let form = |key: &String| key == "type" && properties[key]["const"].is_string();
        let written: BTreeSet<String> = properties.keys().filter(|key| !form(key)).cloned().collect();
        assert_eq!(written, named(&refusal), "{} {}: {refusal}", self.kind, self.schema);
    }
}

#[test]
fn a_skins_keys_are_those_that_its_reader_knows() {
    SENSORS.install();
    let read = |text: &str| {
        let skin = SkinDescription::from_toml(text, "skin.toml");
        match skin {
            Err(error) => error.to_string(),
            Ok(skin) => SENSORS.of(&skin).unwrap().check_medium(&skin).unwrap_err().to_string(),
        }
    };
    let [grid, dome, shin, eflesh] =
        ["baro-grid", "baro-dome", "hapdef-shin", "eflesh"].map(|name| format!("launch/skins/{name}.toml"));
    let bore = "launch/gap/tactile-fsi-air.toml".to_owned();
    let [ert, thumb] = ["ert-panel", "insight-thumb"].map(|name| format!("launch/skins/{name}.toml"));
    for (file, at, schema) in [
        (&grid, "", ""),
        (&grid, "/surface", "/properties/surface/oneOf/0"),
        (&dome, "/surface", "/properties/surface/oneOf/1"),
        (&shin, "/surface", "/properties/surface/oneOf/2"),
        (&grid, "/taxels/0", "/properties/taxels/items"),
        (&eflesh, "/channels/0", "/properties/channels/items"),
        (&shin, "/wire", "/properties/wire"),
        (&shin, "/condition", "/properties/condition"),
        (&grid, "/medium", "/allOf/0/then/properties/medium"),
        (&bore, "/medium/bore", "/allOf/0/then/properties/medium/properties/bore"),
        (&shin, "/medium", "/allOf/1/then/properties/medium"),
        (&shin, "/medium/bridge", "/allOf/1/then/properties/medium/properties/bridge"),
        (&ert, "/medium", "/allOf/2/then/properties/medium"),
        (&ert, "/medium/electrodes", "/allOf/2/then/properties/medium/properties/electrodes"),
        (&ert, "/medium/sheet", "/allOf/2/then/properties/medium/properties/sheet"),
        (&ert, "/medium/foam", "/allOf/2/then/properties/medium/properties/foam"),
        (&ert, "/medium/top", "/allOf/2/then/properties/medium/properties/top"),
        (&ert, "/medium/drive", "/allOf/2/then/properties/medium/properties/drive"),
        (&thumb, "/surface", "/properties/surface/oneOf/4"),
        (&thumb, "/medium", "/allOf/3/then/properties/medium"),
        (&thumb, "/medium/elastomer", "/allOf/3/then/properties/medium/properties/elastomer"),
        (&thumb, "/medium/skeleton", "/allOf/3/then/properties/medium/properties/skeleton"),
        (&thumb, "/medium/fovea", "/allOf/3/then/properties/medium/properties/fovea"),
        (&thumb, "/medium/ridges", "/allOf/3/then/properties/medium/properties/ridges"),
        (&thumb, "/medium/camera", "/allOf/3/then/properties/medium/properties/camera"),
        (&thumb, "/medium/lamps", "/allOf/3/then/properties/medium/properties/lamps"),
        (&thumb, "/medium/finish", "/allOf/3/then/properties/medium/properties/finish"),
        (&thumb, "/medium/noise", "/allOf/3/then/properties/medium/properties/noise"),
    ] {
        Probe { kind: "skin", file, at, schema }.check(read);
    }
}

#[test]
fn a_plans_keys_are_those_that_its_reader_knows() {
    let read = |text: &str| Plan::from_toml(text, "plan.toml").unwrap_err().to_string();
    let file = "launch/plans/every-kind.toml";
    for (at, schema) in [("", ""), ("/timing", "/properties/timing")] {
        Probe { kind: "plan", file, at, schema }.check(read);
    }
    // A step may have only the keys of its kind: one that another kind has is refused with a list of them.
    let forms = schema("plan")["properties"]["steps"]["items"]["oneOf"].as_array().unwrap().clone();
    let all: BTreeSet<String> =
        forms.iter().flat_map(|form| form["properties"].as_object().unwrap().keys().cloned()).collect();
    for form in &forms {
        let properties = form["properties"].as_object().unwrap();
        let kind = properties["kind"]["const"].as_str().unwrap();
        let mut plan = toml(&root().join(file));
        let foreign = match kind {
            "idle" => "count",
            "postures" => "shear",
            _ => "duration",
        };
        plan["steps"] = serde_json::json!([{ "kind": kind, foreign: 1 }]);
        let refusal = read(&toml::to_string(&plan).unwrap());
        let mut known = named(&refusal);
        known.insert("kind".to_owned());
        assert_eq!(known, properties.keys().cloned().collect(), "{kind}: {refusal}");
    }
    let mut plan = toml(&root().join(file));
    plan["steps"][0][UNKNOWN] = 1.into();
    assert_eq!(named(&read(&toml::to_string(&plan).unwrap())), all);
}

#[test]
fn a_launch_files_keys_are_those_that_its_reader_knows() {
    let folder = tempfile::tempdir().unwrap();
    let skin = root().join("launch/skins/baro-grid.toml");
    let node = serde_json::json!({
        "name": "pad", "node": "barodome", "config": { "skin": skin, "source": "udp://127.0.0.1:1" },
    });
    let other = serde_json::json!({ "name": "it", "program": ["true"] });
    let with = |pointer: &str, mut value: Value, key: &str| {
        value.pointer_mut(pointer).unwrap_or_else(|| panic!("no {pointer}"))[key] = 1.into();
        value
    };
    let file = |process: &Value| serde_json::json!({ "processes": [process] });
    let extended = |key: &str, value: Value| {
        let mut process = other.clone();
        process[key] = value;
        file(&process)
    };
    for (value, at, schema) in [
        (file(&other), "", ""),
        (file(&other), "/processes/0", "/$defs/process"),
        (file(&node), "/processes/0/config", "/$defs/config"),
        (
            serde_json::json!({ "processes": [{ "group": { "processes": [other] } }] }),
            "/processes/0/group",
            "/$defs/group",
        ),
        (
            serde_json::json!({ "processes": [{ "include": { "file": "a.launch.yaml" } }] }),
            "/processes/0/include",
            "/$defs/include",
        ),
        (
            serde_json::json!({ "arguments": { "a": { "default": "1" } }, "processes": [] }),
            "/arguments/a",
            "/$defs/argument",
        ),
        (serde_json::json!({ "log_limits": {}, "processes": [] }), "/log_limits", "/$defs/log_limits"),
        (extended("ready", serde_json::json!({ "line": "x" })), "/processes/0/ready", "/$defs/ready"),
        (extended("backoff", serde_json::json!({})), "/processes/0/backoff", "/$defs/backoff"),
        (extended("stop", serde_json::json!({})), "/processes/0/stop", "/$defs/stop"),
    ] {
        let wrong = with(at, value.clone(), UNKNOWN);
        let validator = Validator::new("launch");
        assert_eq!(validator.check(&value), Ok(()), "{value}");
        assert!(validator.check(&wrong).is_err(), "{at} fits");
        let path = folder.path().join("it.launch.toml");
        std::fs::write(&path, toml::to_string(&wrong).unwrap()).unwrap();
        let refusal = refusal_of(&path);
        let line = refusal.lines().find(|l| l.contains(UNKNOWN)).unwrap_or_else(|| panic!("{at}: {refusal}"));
        let schema = validator.main.pointer(schema).unwrap();
        let written: BTreeSet<String> = schema["properties"].as_object().unwrap().keys().cloned().collect();
        assert_eq!(written, named(line), "{at}: {line}");
    }
}

/// What `dermis launch --check` says of a file.
fn refusal_of(path: &Path) -> String {
    let checked = program(&["launch", &path.display().to_string(), "--check"]);
    assert!(!checked.status.success());
    String::from_utf8(checked.stderr).unwrap()
}

#[test]
fn an_effects_keys_are_those_that_its_reader_knows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("effects.toml");
    std::fs::write(&path, "effects = []\nno_such_key = 1").unwrap();
    let refusal = Effect::load(&path).unwrap_err().to_string();
    assert!(refusal.contains("expected `effects`"), "{refusal}");
}
