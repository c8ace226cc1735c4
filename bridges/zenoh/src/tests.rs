use super::*;

#[test]
fn wrong_configuration_is_named() {
    let refused =
        |config: BridgeConfig| session_config(&config, &Network::default()).unwrap_err().to_string();
    assert_eq!(
        refused(BridgeConfig { robot: "a/b".into(), ..Default::default() }),
        "bridge: field `robot`: \"a/b\" must be one word of letters, digits, `-`, `_` and `.`"
    );
    assert_eq!(
        refused(BridgeConfig { mode: "router".into(), ..Default::default() }),
        "bridge: field `mode`: is \"router\" and must be \"peer\" or \"client\""
    );
    assert!(refused(BridgeConfig { mode: "client".into(), ..Default::default() }).contains("`connect`"));
    assert!(
        refused(BridgeConfig { connect: vec!["nonsense".into()], ..Default::default() })
            .contains("`connect`")
    );
}

#[test]
fn keys_tell_domains_apart() {
    assert_eq!(prefix("arm", 0), "dermis/arm");
    assert_eq!(prefix("arm", 7), "dermis/arm@7");
    let every = zenoh::key_expr::KeyExpr::try_from("dermis/*/*/contacts").unwrap();
    let one = zenoh::key_expr::KeyExpr::try_from("dermis/arm@7/palm/contacts").unwrap();
    assert!(every.includes(&one), "a client that asks for every robot hears every domain");
}

#[test]
fn it_listens_on_the_loopback_by_default() {
    let config = session_config(&BridgeConfig::default(), &Network::default()).unwrap();
    assert_eq!(config.get_json("listen/endpoints").unwrap(), "[\"tcp/127.0.0.1:0\"]");
    let listen = vec!["tcp/0.0.0.0:7448".to_owned()];
    let requested = BridgeConfig { listen, ..BridgeConfig::default() };
    let config = session_config(&requested, &Network::default()).unwrap();
    assert_eq!(config.get_json("listen/endpoints").unwrap(), "[\"tcp/0.0.0.0:7448\"]");
}

#[test]
fn frames_get_the_names_of_their_layout_only() {
    let geometry = |unit: &str, layout_id: u32| {
        let message = SkinGeometry {
            unit: unit.into(),
            channels: vec!["p0".into(), "p1".into()],
            layout_id,
            ..SkinGeometry::default()
        };
        serde_json::to_value(&message).unwrap()
    };
    let id = ChannelLayout::id_of("Pa", ["p0", "p1"]);
    let mut layouts = Layouts::new();
    learn_layout(&mut layouts, &geometry("Pa", id));
    // Not the number of what it names.
    learn_layout(&mut layouts, &geometry("V", 7));
    let frame = |layout_id: u32| {
        let message = TaxelFrame { layout_id, values: vec![1.5, 2.0], ..TaxelFrame::default() };
        let mut value = serde_json::to_value(&message).unwrap();
        name_channels(&layouts, &mut value);
        value
    };
    let named = frame(id);
    assert_eq!((&named["channels"][1], &named["unit"]), (&"p1".into(), &"Pa".into()));
    for unknown in [0, 7, id ^ 1] {
        assert!(frame(unknown).get("channels").is_none(), "{unknown}");
    }
}

#[test]
fn names_that_would_change_the_key_are_refused() {
    assert_eq!(key_word("baro-grid").as_deref(), Some("baro-grid"));
    for bad in ["", "a/b", "*", "a$b"] {
        assert_eq!(key_word(bad), None);
    }
}
