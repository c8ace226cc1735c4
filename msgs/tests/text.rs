//! What the build script says about text that is no interface.

#[path = "../codegen/parse.rs"]
mod parse;

use parse::{Base, Shape, message, service};

#[test]
fn comments_constants_and_defaults_are_read() {
    let text = "# About the\n# message.\n\nuint8 A=1 # first\nstring NAME=\"a # b\"\n\n# [m] above\nfloat64[3] at # behind\nstring<=9 \
                name \"x\"\nOther[<=4] others\nstd_msgs/Header[] headers\nchar c 7\n";
    let read = message("pkg", "Type", text).unwrap();
    assert_eq!(read.name, "pkg/msg/Type");
    assert_eq!(read.doc, "About the\nmessage.");
    assert_eq!((read.constants[0].value.as_str(), read.constants[0].doc.as_str()), ("1", "first"));
    assert_eq!(read.constants[1].value, "\"a # b\"");
    let fields: Vec<_> = read.fields.iter().map(|f| (f.name.as_str(), f.base.clone(), f.shape)).collect();
    assert_eq!(
        fields,
        [
            ("at", Base::Float64, Shape::Array(3)),
            ("name", Base::String(Some(9)), Shape::One),
            ("others", Base::Nested("pkg/msg/Other".to_owned()), Shape::Bounded(4)),
            ("headers", Base::Nested("std_msgs/msg/Header".to_owned()), Shape::Sequence),
            ("c", Base::Uint8, Shape::One),
        ]
    );
    assert_eq!(read.fields[0].doc, "[m] above\nbehind");
    assert_eq!(read.fields[4].default.as_deref(), Some("7"));
}

#[test]
fn services_have_two_halves() {
    let read = service("pkg", "Do", "# What it does.\nbool on\n---\n# why\nstring message\n").unwrap();
    assert_eq!(read.doc, "What it does.");
    assert_eq!(read.request.name, "pkg/srv/Do_Request");
    assert_eq!(read.response.fields[0].name, "message");
}

#[test]
fn text_that_is_no_interface_is_named_by_its_line() {
    let refuse = |text: &str| message("pkg", "Type", text).unwrap_err().to_string();
    insta::assert_snapshot!(refuse("uint8 a\n\nuint8"), @"line 3: `uint8` is neither `TYPE name` nor `TYPE NAME=value`");
    insta::assert_snapshot!(refuse("uint8 Big"), @"line 1: field name `Big` is not lower_case with single underscores");
    insta::assert_snapshot!(refuse("uint8 a__b"), @"line 1: field name `a__b` is not lower_case with single underscores");
    insta::assert_snapshot!(refuse("uint8 a\nint8 a"), @"line 2: field `a` appears twice");
    insta::assert_snapshot!(refuse("uint8 A=256"), @"line 1: `256` is not a value of its type");
    insta::assert_snapshot!(refuse("uint8 lower=1"), @"line 1: constant `lower` is not UPPER_CASE");
    insta::assert_snapshot!(refuse("uint8[2] A=1"), @"line 1: constant `A` has the type `uint8[2]`; only scalars can be constant");
    insta::assert_snapshot!(refuse("uint8[0] a"), @"line 1: `0` in `uint8[0]` is not a size of at least 1");
    insta::assert_snapshot!(refuse("uint8] a"), @"line 1: `uint8]` has `]` without `[`");
    insta::assert_snapshot!(refuse("uint8[] a [1, 2]"), @"line 1: field `a`: only scalars can have a default value here");
    insta::assert_snapshot!(refuse("wstring a"), @"line 1: wide strings are not supported: use string");
    insta::assert_snapshot!(refuse("float a"), @"line 1: `float` is not a type");
    insta::assert_snapshot!(service("pkg", "Do", "bool on\n").unwrap_err(), @"line 1: a service has exactly one `---` line, this one has 0");
    insta::assert_snapshot!(service("pkg", "Do", "bool on\n---\nbool x y\n").unwrap_err(), @"line 3: `y` is not a value of its type");
}
