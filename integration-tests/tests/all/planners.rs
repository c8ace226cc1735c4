//! What planners and controllers are given: parameter files for Nav2, and values per link by topic.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::process::Command;
use std::sync::mpsc::channel;
use std::time::Duration;

use dermis_integration_tests::{Peer, backend, domain, program, root};
use dermis_msgs::geometry_msgs::msg::{Vector3, Wrench, WrenchStamped};
use dermis_msgs::msg::{BodyContacts, ContactArray, LinkWrench};
use dermis_msgs::std_msgs::msg::Header;
use dermis_node::{Node, NodeOptions, Qos};
use yaml_rust2::{Yaml, YamlLoader};

const SOON: Duration = Duration::from_secs(60);

fn yaml(path: &str) -> Yaml {
    let text = std::fs::read_to_string(root().join(path)).unwrap();
    YamlLoader::load_from_str(&text).unwrap_or_else(|e| panic!("{path}: {e}")).remove(0)
}

#[test]
fn the_collision_monitor_reads_the_points_of_a_skin() {
    let file = yaml("launch/nav2/collision_monitor.yaml");
    let monitor = &file["collision_monitor"]["ros__parameters"];
    let names = |list: &Yaml| list.clone().into_iter().map(|n| n.into_string().unwrap()).collect::<Vec<_>>();
    for source in names(&monitor["observation_sources"]) {
        let source = &monitor[source.as_str()];
        assert_eq!(
            (source["type"].as_str(), source["topic"].as_str()),
            (Some("pointcloud"), Some("contact_points"))
        );
        assert!(source["min_height"].as_f64() < source["max_height"].as_f64());
    }
    for polygon in names(&monitor["polygons"]) {
        let polygon = &monitor[polygon.as_str()];
        assert_eq!(polygon["action_type"].as_str(), Some("stop"));
        // A skin reports one point a contact, where a lidar reports many.
        assert_eq!(polygon["min_points"].as_i64(), Some(1));
        let corners: Vec<[f64; 2]> = serde_json::from_str(polygon["points"].as_str().unwrap()).unwrap();
        assert!(corners.len() >= 3, "{corners:?}");
    }
    assert!(monitor["source_timeout"].as_f64().is_some_and(|s| s > 0.0), "0 would switch the check off");
}

#[test]
fn the_costmap_marks_contacts_and_clears_nothing_by_them() {
    let file = yaml("launch/nav2/costmap.yaml");
    let costmap = &file["local_costmap"]["local_costmap"]["ros__parameters"];
    let layer = &costmap["touch_layer"];
    let source = &layer[layer["observation_sources"].as_str().unwrap()];
    assert_eq!(
        (source["topic"].as_str(), source["data_type"].as_str()),
        (Some("contact_points"), Some("PointCloud2"))
    );
    assert_eq!((source["marking"].as_bool(), source["clearing"].as_bool()), (Some(true), Some(false)));
    assert_eq!(source["obstacle_min_range"].as_f64(), Some(0.0));
    assert_eq!(layer["footprint_clearing_enabled"].as_bool(), Some(false));
    let plugins = costmap["plugins"].as_vec().unwrap();
    assert!(plugins.iter().all(|name| !costmap[name.as_str().unwrap()]["plugin"].is_badvalue()));
}

#[test]
fn the_force_on_each_link_is_a_topic() {
    let links = program("examples/links");
    assert!(
        links.is_file(),
        "{} is missing: `cargo build --release -p dermis-node --example links`",
        links.display()
    );
    let options = NodeOptions::new("fusion_stand_in").domain_id(domain()).localhost_only(true);
    let node = Node::open(options, &backend()).unwrap();
    let body = node.stream_publisher::<BodyContacts>("/body_contacts", 10).unwrap();
    let (send, wrenches) = channel();
    let _hand = node
        .subscribe::<WrenchStamped>("/hand/wrench", Qos::reliable(10), move |message, _| {
            // A test that got what it wanted hangs up.
            let _ = send.send(message);
        })
        .unwrap();
    let force = Vector3 { x: 0.0, y: 0.0, z: -2.0 };
    let hand = LinkWrench {
        link: "hand".into(),
        wrench: Wrench { force, ..Wrench::default() },
        ..LinkWrench::default()
    };
    let foot =
        LinkWrench { link: "foot".into(), status: ContactArray::STATUS_STALE, ..LinkWrench::default() };
    let message = BodyContacts {
        header: Header::new(5, "pelvis"),
        wrenches: vec![hand, foot],
        ..BodyContacts::default()
    };
    let _timer = node.timer(Duration::from_millis(50), move || {
        // Before anybody listens, nothing is lost.
        let _ = body.publish(&message);
    });
    let mut links = Peer::start(&mut Command::new(links));
    links.expect("hand 0.000 0.000 -2.000 N", SOON);
    links.expect("foot is not sensed", SOON);
    let found = wrenches.recv_timeout(SOON).unwrap();
    assert_eq!((found.header.frame_id.as_str(), found.wrench.force.z), ("hand", -2.0));
}
