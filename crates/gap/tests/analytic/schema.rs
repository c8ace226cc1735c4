//! A small validator of JSON schemas.

/// Whether a value is as a schema says: types, required and known keys.
pub(crate) fn fits(
    value: &serde_json::Value,
    schema: &serde_json::Value,
    root: &serde_json::Value,
    at: &str,
) {
    use serde_json::Value;
    if let Some(name) = schema["$ref"].as_str() {
        return fits(value, root.pointer(&name[1..]).unwrap(), root, at);
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let choice = choices.iter().find(|c| (c["type"] == "null") == value.is_null()).unwrap();
        return fits(value, choice, root, at);
    }
    if let Some(allowed) = schema["enum"].as_array() {
        assert!(allowed.contains(value), "{at}: {value}");
    }
    if let Some(constant) = schema.get("const") {
        assert_eq!(value, constant, "{at}");
    }
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(n) if n.is_u64() => "integer",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    let is = |t: &Value| t == kind || (t == "number" && kind == "integer");
    match &schema["type"] {
        Value::Null => {}
        Value::Array(types) => assert!(types.iter().any(is), "{at}: {kind} is none of {types:?}"),
        one => assert!(is(one), "{at}: {kind} where {one} is said"),
    }
    if let (Some(items), Some(values)) = (schema.get("items"), value.as_array()) {
        values.iter().enumerate().for_each(|(i, v)| fits(v, items, root, &format!("{at}[{i}]")));
    }
    if let Some(fields) = value.as_object() {
        for key in schema["required"].as_array().into_iter().flatten() {
            assert!(fields.contains_key(key.as_str().unwrap()), "{at} lacks {key}");
        }
        for (key, field) in fields {
            match schema["properties"].get(key) {
                Some(schema) => fits(field, schema, root, &format!("{at}.{key}")),
                None => assert!(schema["additionalProperties"] != false, "{at}.{key} is not in the schema"),
            }
        }
    }
}
