use dermis_node::{Network, Reach};

use crate::context::ros_variables;

#[test]
fn the_network_is_handed_to_ros_in_its_own_variables() {
    let of = |network: &Network| ros_variables(network, Some("rmw_fastrtps_cpp"));
    let value = |network: &Network, name: &str| {
        of(network).unwrap().into_iter().find(|(n, _)| *n == name).and_then(|(_, value)| value)
    };
    let reach = |reach| Network { reach, ..Network::default() };
    for (wanted, range) in [(Reach::Loopback, "LOCALHOST"), (Reach::Lan, "SUBNET"), (Reach::Off, "OFF")] {
        let network = reach(wanted);
        assert_eq!(value(&network, "ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref(), Some(range));
        assert_eq!(value(&network, "ROS_LOCALHOST_ONLY"), None, "it would win over the range");
        assert_eq!(value(&network, "ROS_STATIC_PEERS"), None, "an explicit choice wins over the environment");
    }
    let peers = Network { static_peers: vec!["10.0.0.1".into(), "b".into()], ..Network::default() };
    assert_eq!(value(&peers, "ROS_STATIC_PEERS").as_deref(), Some("10.0.0.1;b"));
    let refused = of(&reach(Reach::Address([10, 0, 0, 1].into()))).unwrap_err();
    assert!(refused.contains("the address 10.0.0.1: use --network loopback or lan"), "{refused}");
    let file = Network { zenoh_config: Some("z.json5".into()), ..Network::default() };
    assert!(of(&file).unwrap_err().contains("z.json5 means nothing to rmw_fastrtps_cpp"));
    let zenoh = ros_variables(&file, Some("rmw_zenoh_cpp")).unwrap();
    assert_eq!(zenoh, [("ZENOH_SESSION_CONFIG_URI", Some("z.json5".to_owned()))]);
}
