//! The layouts for viewers that ship name topics that a node publishes, with the types that their displays read, and ask for
//! no more than the node offers.
#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::time::{Duration, Instant};

use dermis_integration_tests::{Pad, backend, domain, json, root};
use dermis_node::backend::EndpointKind;
use dermis_node::{Durability, History, Node, NodeOptions, Qos, Reliability};
use yaml_rust2::{Yaml, YamlLoader};

const SOON: Duration = Duration::from_secs(60);

/// What a display wants: topic, types that it reads, and the profile that it subscribes with, where the layout says it.
struct Wish {
    topic: String,
    types: &'static [&'static str],
    qos: Option<Qos>,
}

fn text(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// Displays of RViz by their class, and the message that each reads.
fn rviz_type(class: &str) -> Option<&'static [&'static str]> {
    match class.strip_prefix("rviz_default_plugins/")? {
        "MarkerArray" => Some(&["visualization_msgs/msg/MarkerArray"]),
        "PointCloud2" => Some(&["sensor_msgs/msg/PointCloud2"]),
        "Wrench" => Some(&["geometry_msgs/msg/WrenchStamped"]),
        "Grid" => None,
        other => panic!("no type is known here for the display {other}"),
    }
}

fn rviz() -> Vec<Wish> {
    let file = YamlLoader::load_from_str(&text("launch/rviz/dermis.rviz")).unwrap();
    let manager = &file[0]["Visualization Manager"];
    assert!(manager["Global Options"]["Fixed Frame"].as_str().is_some());
    let displays = manager["Displays"].as_vec().unwrap();
    let wish = |display: &Yaml| {
        let class = display["Class"].as_str().unwrap();
        if class == "rviz_default_plugins/TF" {
            // It listens to this topic by itself, with this profile.
            let types = &["tf2_msgs/msg/TFMessage"];
            return Some(Wish { topic: "/tf_static".to_owned(), types, qos: Some(Qos::latched()) });
        }
        let types = rviz_type(class)?;
        let topic = &display["Topic"];
        let word =
            |key: &str| topic[key].as_str().unwrap_or_else(|| panic!("{key} of {display:?}")).to_owned();
        let depth = usize::try_from(topic["Depth"].as_i64().unwrap()).unwrap();
        assert_eq!(word("History Policy"), "Keep Last");
        Some(Wish {
            topic: word("Value"),
            types,
            qos: Some(Qos {
                reliability: match word("Reliability Policy").as_str() {
                    "Reliable" => Reliability::Reliable,
                    "Best Effort" => Reliability::BestEffort,
                    other => panic!("RViz knows no reliability `{other}`"),
                },
                durability: match word("Durability Policy").as_str() {
                    "Volatile" => Durability::Volatile,
                    "Transient Local" => Durability::TransientLocal,
                    other => panic!("RViz knows no durability `{other}`"),
                },
                history: History::KeepLast(depth),
            }),
        })
    };
    displays.iter().filter_map(wish).collect()
}

fn foxglove() -> Vec<Wish> {
    let layout = json(&text("launch/foxglove/dermis.json"));
    let panels = layout["configById"].as_object().unwrap();
    let mut shown = Vec::new();
    for (name, panel) in panels {
        assert!(layout["layout"].to_string().contains(name), "{name} is nowhere in the layout");
        let mut want = |topic: &str, types| shown.push(Wish { topic: topic.to_owned(), types, qos: None });
        match name.split('!').next().unwrap() {
            "3D" => {
                for topic in panel["topics"].as_object().unwrap().keys() {
                    want(topic, &["visualization_msgs/msg/MarkerArray", "sensor_msgs/msg/PointCloud2"]);
                }
            }
            "Plot" => {
                for path in panel["paths"].as_array().unwrap() {
                    let value = path["value"].as_str().unwrap();
                    let (topic, field) = value.split_once('.').unwrap();
                    assert!(
                        ["wrench.force.x", "wrench.force.y", "wrench.force.z"].contains(&field),
                        "{value}"
                    );
                    want(topic, &["geometry_msgs/msg/WrenchStamped"]);
                }
            }
            "RawMessages" => want(panel["topicPath"].as_str().unwrap(), &["dermis_msgs/msg/ContactArray"]),
            "DiagnosticSummary" => {
                want(panel["topicToRender"].as_str().unwrap(), &["diagnostic_msgs/msg/DiagnosticArray"]);
            }
            other => panic!("no type is known here for the panel {other}"),
        }
    }
    shown
}

#[test]
fn layouts_show_what_a_node_publishes() {
    let folder = tempfile::tempdir().unwrap();
    // Mounted, so that it is in the tree of frames, too.
    let _pad = Pad::start(folder.path(), &["--mount", "wrist,0,0,0.1"]);
    let options = NodeOptions::new("viewer").domain_id(domain()).localhost_only(true);
    let viewer = Node::open(options, &backend()).unwrap();
    let begun = Instant::now();
    let published = loop {
        let topics = viewer.topics().unwrap();
        // The last that a node announces.
        let all = ["/skin_geometry", "/diagnostics", "/tf_static"]
            .iter()
            .all(|t| topics.iter().any(|(name, _)| name == t));
        if all {
            break topics;
        }
        assert!(begun.elapsed() < SOON, "{topics:?}");
        std::thread::sleep(Duration::from_millis(50));
    };
    let (rviz, foxglove) = (rviz(), foxglove());
    assert_eq!((rviz.len(), foxglove.len()), (4, 7));
    for wish in rviz.into_iter().chain(foxglove) {
        let found = published.iter().find(|(name, _)| *name == wish.topic);
        let (_, kind) = found.unwrap_or_else(|| panic!("nobody publishes {}: {published:?}", wish.topic));
        assert!(
            wish.types.contains(&kind.as_str()),
            "{} is a {kind}, not one of {:?}",
            wish.topic,
            wish.types
        );
        let Some(requested) = wish.qos else { continue };
        for offer in viewer.endpoints(&wish.topic, EndpointKind::Publisher).unwrap() {
            assert_eq!(requested.unmet_by(&offer.qos.unwrap()), None, "{}", wish.topic);
        }
    }
}
