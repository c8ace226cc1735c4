use super::*;

fn parameters() -> Parameters {
    let given = [("rate".to_owned(), 50.into()), ("misspelt".to_owned(), true.into())];
    let parameters = Parameters::new(given.into());
    let limits = ParameterDescriptor::new("frames per second (Hz)").float_range(1.0, 1000.0);
    parameters.declare("rate", 100.0, limits).unwrap();
    parameters.declare("filter.cutoff", 20.0, ParameterDescriptor::new("Hz")).unwrap();
    parameters.declare("skin", "palm.toml", ParameterDescriptor::new("file").read_only()).unwrap();
    parameters
}

#[test]
fn overrides_win_over_defaults() {
    let parameters = parameters();
    assert_eq!(parameters.get("rate"), Some(ParameterValue::Double(50.0)));
    assert_eq!(parameters.unused_overrides(), ["misspelt"]);
}

#[test]
fn refusals_say_why() {
    let parameters = parameters();
    parameters.on_set(|changes| {
        if changes.iter().any(|(_, value)| *value == ParameterValue::Double(13.0)) {
            Err("13 Hz is unlucky".to_owned())
        } else {
            Ok(())
        }
    });
    let set = |name: &str, value: ParameterValue| parameters.set(name, value).unwrap_err();
    insta::assert_snapshot!(set("rate", 0.0.into()), @"parameter `rate`: 0.0 is outside of 1.0 to 1000.0");
    insta::assert_snapshot!(set("rate", f64::NAN.into()), @"parameter `rate`: NaN is outside of 1.0 to 1000.0");
    insta::assert_snapshot!(set("rate", 3.into()), @"parameter `rate`: its type is double, not integer");
    insta::assert_snapshot!(set("skin", "x".into()), @"parameter `skin`: it is read-only: give it when the node starts");
    insta::assert_snapshot!(set("gain", 3.into()), @"parameter `gain`: it is not declared by this node");
    insta::assert_snapshot!(set("rate", 13.0.into()), @"parameter `rate`: 13 Hz is unlucky");
    assert_eq!(parameters.get("rate"), Some(ParameterValue::Double(50.0)));
    let odd = Parameters::new([("rate".to_owned(), "fast".into())].into());
    insta::assert_snapshot!(
        odd.declare("rate", 1.0, ParameterDescriptor::default()).unwrap_err(),
        @r#"parameter `rate`: its type is double, but the value given at start is the string "fast""#
    );
}

#[test]
fn several_are_set_all_or_none() {
    let parameters = parameters();
    let changes = [("rate".to_owned(), 60.0.into()), ("skin".to_owned(), "x".into())];
    assert!(parameters.set_all(&changes).is_err());
    assert_eq!(parameters.get("rate"), Some(ParameterValue::Double(50.0)));
}

#[test]
fn watchers_see_what_changed() {
    let parameters = parameters();
    let seen: Arc<Mutex<Vec<String>>> = Arc::default();
    let log = Arc::clone(&seen);
    parameters.on_changed(move |name, value| lock(&log).push(format!("{name}={value}")));
    parameters.set("rate", 60.0).unwrap();
    assert!(parameters.set("rate", -1.0).is_err());
    assert_eq!(*lock(&seen), ["rate=60.0"]);
}

#[test]
fn lists_follow_prefix_and_depth() {
    let parameters = parameters();
    assert_eq!(parameters.list(&[], 0).names, ["filter.cutoff", "rate", "skin"]);
    assert_eq!(parameters.list(&[], 1).names, ["rate", "skin"]);
    let below = parameters.list(&["filter".to_owned()], 1);
    assert_eq!(below.names, ["filter.cutoff"]);
    assert_eq!(below.prefixes, ["filter"]);
}

#[test]
fn values_survive_the_wire_form() {
    let values = [
        ParameterValue::NotSet,
        true.into(),
        (-3i64).into(),
        2.5.into(),
        "text".into(),
        ParameterValue::ByteArray(vec![1, 255]),
        vec![true, false].into(),
        vec![1i64, 2].into(),
        vec![0.5, 1.5].into(),
        vec!["a".to_owned()].into(),
    ];
    for value in values {
        assert_eq!(ParameterValue::from_msg(value.to_msg()), Some(value));
    }
    assert_eq!(ParameterValue::from_msg(ValueMsg { r#type: 77, ..ValueMsg::default() }), None);
}

#[test]
fn text_becomes_the_value_that_was_meant() {
    for (text, value) in [
        ("true", true.into()),
        ("3", 3.into()),
        ("0.5", 0.5.into()),
        ("\"3\"", "3".into()),
        ("palm", "palm".into()),
        ("[1, 2.5]", vec![1.0, 2.5].into()),
    ] {
        assert_eq!(ParameterValue::parse(text), value);
    }
}
