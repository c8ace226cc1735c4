use super::*;

fn toml(text: &str) -> Result<Config, String> {
    Config::parse(text, false, Path::new("palm.toml")).map_err(|e| e.to_string())
}

#[test]
fn toml_and_yaml_say_the_same() {
    let a = toml(
        "skin = 'pad.toml'\nsource = 'udp://0.0.0.0:7400'\nmodels = ['a', 'b']\nautostart = false\n\
         [parameters]\ncontact_threshold = 5.5\n[runtime]\nchoice = 'embedded'",
    )
    .unwrap();
    let b = Config::parse(
        "skin: pad.toml\nsource: udp://0.0.0.0:7400\nmodels: [a, b]\nautostart: false\n\
         parameters: {contact_threshold: 5.5}\nruntime: {choice: embedded}",
        true,
        Path::new("palm.yaml"),
    )
    .unwrap();
    assert_eq!(a, b);
    assert_eq!(a.models, [Path::new("a"), Path::new("b")]);
    assert_eq!(a.parameters["contact_threshold"], serde_json::json!(5.5));
    assert!(!a.autostart && !a.strict);
}

#[test]
fn what_is_left_out_is_as_in_new() {
    assert_eq!(toml("skin = 'p.toml'\nsource = 's'").unwrap(), Config::new("p.toml", "s"));
}

#[test]
fn the_network_is_read_and_the_older_key_still_counts() {
    let choice = |text: &str| toml(&format!("skin = 'p'\nsource = 's'\n{text}")).unwrap().network_choice();
    let reach = |text: &str| choice(text).network;
    assert_eq!(reach(""), None);
    assert_eq!(reach("network = 'lan'"), Some(Reach::Lan));
    assert_eq!(reach("network = '192.168.1.5'"), Some(Reach::Address([192, 168, 1, 5].into())));
    assert_eq!(reach("localhost_only = true"), Some(Reach::Loopback));
    assert_eq!(reach("localhost_only = false"), Some(Reach::Lan));
    assert_eq!(reach("network = 'loopback'\nlocalhost_only = false"), Some(Reach::Loopback));
    assert_eq!(choice("zenoh_config = 'z.json5'").zenoh_config.as_deref(), Some(Path::new("z.json5")));
    let refused = toml("skin = 'p'\nsource = 's'\nnetwork = 'wan'").unwrap_err();
    assert!(refused.contains("`network`") && refused.contains("give loopback, lan, off"), "{refused}");
}

#[test]
fn refusals_name_the_key() {
    insta::assert_snapshot!(toml("skin = 'p'\nsource = 's'\nmodel = 'm'").unwrap_err(), @"configuration palm.toml: unknown key `model`; remove it or correct its spelling (known here: skin, source, name, namespace, instance, frame_id, mount, models, invert, model_folders, model_limits, commands, cache, masked, correction, runtime, force_threshold, strict, autostart, domain_id, network, zenoh_config, localhost_only, use_sim_time, device_time, remap, parameters)");
    insta::assert_snapshot!(toml("skin = 'p'").unwrap_err(), @r#"configuration palm.toml: field `(top level)`: missing configuration field "source""#);
    insta::assert_snapshot!(toml("skin = 'p'\nsource = 's'\nautostart = 'maybe'").unwrap_err(), @r#"configuration palm.toml: field `autostart`: invalid type: string "maybe", expected a boolean for key `autostart`"#);
    assert!(toml("skin = ").is_err());
}

#[test]
fn a_device_has_a_name_a_frame_and_a_place() {
    let text = "skin = 'p'\nsource = 's'\ninstance = 'left_palm'\nframe_id = 'left_palm_link'\ncorrection = 'c.json'\n";
    let config =
        toml(&format!("{text}mount = {{ parent = 'wrist', translation = [0, 0, 1], rpy = [0, 0, 0] }}"));
    let config = config.unwrap();
    let mount = config.mount.clone().unwrap();
    assert_eq!((mount.parent(), mount.translation()), ("wrist", [0.0, 0.0, 1.0]));
    // As `dermis launch` hands it on.
    let written = serde_json::to_value(&config).unwrap();
    assert_eq!(Config::parse(&written.to_string(), true, Path::new("palm.yaml")).unwrap(), config);
    assert_eq!(Config::from_json(written, Path::new("palm.yaml"), Path::new("")).unwrap(), config);
    for (mount, reason) in [
        (
            "parent = 'wrist', rpy = [0, 0, 90]",
            "`rpy` is [0.0, 0.0, 90.0] and must be roll, pitch and yaw in radians",
        ),
        (
            "parent = 'wrist', pose = [0, 0, 0]",
            "unknown field `pose`, expected one of `parent`, `translation`",
        ),
        ("translation = [0, 0, 0]", "missing"),
    ] {
        let message = toml(&format!("{text}mount = {{ {mount} }}")).unwrap_err();
        assert!(
            message.starts_with("configuration palm.toml: field `mount") && message.contains(reason),
            "{message}"
        );
    }
}

#[test]
fn two_skins_of_one_file_have_two_names() {
    let skin =
        SkinDescription::from_toml(include_str!("../../../../launch/skins/baro-grid.toml"), "grid").unwrap();
    let name = |namespace: &str, node: Option<&str>, instance: Option<&str>| {
        let mut config = Config::new("p", "s");
        config.namespace = namespace.into();
        (config.name, config.instance) = (node.map(Into::into), instance.map(Into::into));
        config.instance_name(&skin)
    };
    assert_eq!(name("/", None, None), "baro-grid", "as before there were instances");
    assert_eq!(name("/", Some("baro_grid"), None), "baro-grid");
    assert_eq!(name("/", Some("palm"), None), "palm");
    assert_eq!(name("/left", None, None), "left_baro_grid");
    assert_eq!(name("/gripper/left/", Some("palm"), None), "gripper_left_palm");
    assert_eq!(name("gripper/right", Some("palm"), None), "gripper_right_palm");
    assert_eq!(name("/gripper/left", Some("palm"), Some("left-palm")), "left-palm");
}

#[test]
fn paths_are_relative_to_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("palm.toml");
    std::fs::write(&file, "skin = 'skins/pad.toml'\nsource = 's'\nmodels = ['m', '/abs']").unwrap();
    let config = Config::load(&file).unwrap();
    assert_eq!(config.skin, folder.path().join("skins/pad.toml"));
    assert_eq!(config.models, [folder.path().join("m"), PathBuf::from("/abs")]);
    let missing = Config::load(folder.path().join("none.toml")).unwrap_err().to_string();
    assert!(missing.contains("none.toml: cannot be read"), "{missing}");
}

#[test]
fn commands_folders_limits_and_cache_are_read() {
    let config = toml(
        "skin = 'p'\nsource = 's'\ncommands = ['tare']\nmodel_folders = ['m']\ncache = 'off'\n\
         [model_limits]\nseconds = 3",
    )
    .unwrap();
    assert_eq!(config.commands, "tare".parse().unwrap());
    assert_eq!(config.model_folders, Some(vec!["m".into()]));
    assert_eq!(config.model_limits.seconds, 3);
    assert_eq!((config.cache.folder(), toml("skin = 'p'\nsource = 's'").unwrap().cache), {
        (None, CacheConfig::Auto)
    });
    insta::assert_snapshot!(toml("skin = 'p'\nsource = 's'\ncommands = 'tear'").unwrap_err(), @"configuration palm.toml: field `commands`: there is no group of commands `tear`; give `all`, `none`, or some of tare, enable, load, lifecycle, parameters for key `commands`");
    // As a launch file hands it on.
    let text = serde_json::to_value(&config).unwrap();
    assert_eq!(Config::from_json(text, Path::new("x"), Path::new("")).unwrap(), config);
}

#[test]
fn what_is_nested_without_end_is_refused() {
    for text in ["- ".repeat(100_000), (0..5000).map(|i| " ".repeat(i) + "a:\n").collect()] {
        let error = Config::parse(&text, true, Path::new("palm.yaml")).unwrap_err().to_string();
        assert!(error.contains("nested too deeply"), "{error}");
    }
}
