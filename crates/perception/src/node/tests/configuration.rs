//! What a configuration says, and what of it is refused.

use super::*;

#[test]
fn what_cannot_be_is_refused_in_one_sentence() {
    let bench = Bench::new();
    std::fs::write(bench.path("other.toml"), skin_text("sensor = \"camera\"")).unwrap();
    std::fs::write(bench.path("typo.toml"), skin_text("nosie = 3")).unwrap();
    insta::assert_snapshot!(bench.refusal(|c| c.skin = bench.path("none.toml")), @"skin file DIR/none.toml: cannot be read: No such file or directory (os error 2); check the path and its permissions");
    insta::assert_snapshot!(bench.refusal(|c| c.skin = bench.path("other.toml")), @r#"skin file DIR/other.toml: field `sensor`: is "camera", which this node does not read; it reads "pad""#);
    assert!(bench.refusal(|c| c.skin = bench.path("typo.toml")).contains("unknown key `nosie`"));
    assert!(bench.refusal(|c| c.source = "seriol:///dev/ttyACM0".into()).contains("unknown scheme `seriol`"));
    insta::assert_snapshot!(bench.refusal(|c| c.masked = vec!["t7".into()]), @"masked channel `t7` is none of skin `pad`; its channels are t0, t1, t2, t3");
    insta::assert_snapshot!(bench.refusal(|c| {
        c.strict = true;
        c.models = vec![bench.path("none")];
    }), @"model bundle DIR/none: there is no such folder; train one with `dermis train` or correct the path");
    insta::assert_snapshot!(bench.refusal(|c| {
        c.parameters.insert("contact_treshold".into(), 3.into());
    }), @"parameter `contact_treshold` is none of this node; its parameters are contact_threshold, correction, drift_time, force_threshold, frame_id, masked, models, mount_parent, mount_pose, release_share, skin, skin_hash, skin_type, source, stale_time, stuck_time, tare_duration, tare_while_touched, use_sim_time");
    insta::assert_snapshot!(bench.refusal(|c| {
        c.parameters.insert("contact_threshold".into(), "high".into());
    }), @r#"parameter `contact_threshold`: its type is double, but the value given at start is the string "high""#);
    insta::assert_snapshot!(bench.refusal(|c| {
        c.parameters.insert("skin".into(), "left".into());
    }), @"parameter `skin` follows from the configuration: write `instance` there, and leave it out of `parameters`");
    insta::assert_snapshot!(bench.refusal(|c| c.instance = Some("left pad".into())), @r#"`instance`: "left pad" is no name of a skin: take up to 128 letters, digits, `_` and `-`"#);
    insta::assert_snapshot!(bench.refusal(|c| c.mount = Some("pad_link,0,0,0".parse().unwrap())), @r#"`mount.parent` is "pad_link", the skin's own `frame_id`: name the link that the skin is fixed to"#);
    assert!(
        bench
            .refusal(|c| (c.correction, c.strict) = (Some(bench.path("none.json")), true))
            .contains("none.json")
    );
}

#[test]
fn a_node_says_which_device_it_reads() {
    let bench = Bench::new();
    let mut config = bench.config();
    config.instance = None;
    config.name = Some("palm".into());
    config.frame_id = Some("left_link".into());
    config.mount = Some("wrist,0,0.5,0".parse().unwrap());
    config.masked = vec!["t1".into()];
    let running = bench.start(&config);
    let text = |name: &str| running.node().parameters().get(name).unwrap().to_string();
    let name = format!("{}_palm", bench.namespace.trim_start_matches('/'));
    assert_eq!(running.skin().name, name, "the node's full name");
    let hash = SkinDescription::load(bench.path("pad.toml")).unwrap().hash();
    for (parameter, expected) in [
        ("skin", name.as_str()),
        ("skin_type", "pad"),
        ("skin_hash", hash.as_str()),
        ("frame_id", "left_link"),
        ("mount_parent", "wrist"),
        ("mount_pose", "[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0]"),
        ("masked", "[\"t1\"]"),
    ] {
        assert_eq!(text(parameter).trim_matches('"'), expected, "{parameter}");
    }
    let figures = running.diagnosis().values;
    let of_type = figures.iter().find(|(key, _)| key == "skin type").unwrap();
    assert!(of_type.1.starts_with("pad (sha256:"), "{of_type:?}");
}
