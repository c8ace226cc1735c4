//! The program over the ROS 2 that is sourced, real `rclpy` on the other side. Needs the program with the feature `ros2`
//! and is skipped, with a printed line, where no ROS 2 is set up for tests.

use std::process::Command;
use std::time::{Duration, Instant};

use dermis_integration_tests::{Pad, Peer, Rclpy, Recorded, hand, program, root, ros_python};
use serde_json::{Value, json};

const SOON: Duration = Duration::from_secs(60);
/// `dermis_msgs/msg/ContactArray.STATUS_OK`.
const OK: u8 = 0;

fn demo() -> Peer {
    Peer::start(Command::new(program("dermis")).args([
        "demo",
        "--backend",
        "ros2",
        "--duration",
        "120s",
        "--json",
        "--no-bridge",
    ]))
}

/// Asks about the graph until `found` has an answer.
fn find<T>(rclpy: &mut Rclpy, what: &str, mut found: impl FnMut(&Value) -> Option<T>) -> T {
    rclpy.tell(&json!({"do": "graph"}));
    rclpy.wait_and(what, |rclpy, said| {
        if said["event"] != "graph" {
            return None;
        }
        let answer = found(said);
        if answer.is_none() {
            rclpy.tell(&json!({"do": "graph"}));
        }
        answer
    })
}

/// Name of the service or topic of this type.
fn of_type(names: &Value, suffix: &str, kind: &str) -> Option<String> {
    let all = names.as_object()?;
    all.iter()
        .find(|(name, kinds)| {
            name.ends_with(suffix) && kinds.as_array().is_some_and(|k| k.contains(&kind.into()))
        })
        .map(|(name, _)| name.clone())
}

#[test]
fn the_lines_of_the_readme_print_contacts() {
    let Some(python) = ros_python() else { return };
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let start = readme.find("import rclpy").expect("README.md shows an rclpy client");
    let client = &readme[start..start + readme[start..].find("```").unwrap()];
    let _demo = demo();
    let mut client = Peer::start(Command::new(python).args(["-c", client]));
    let line = client.expect("baro-grid ", SOON);
    let numbers: Vec<f64> = line.split(' ').skip(1).map(|n| n.parse().unwrap()).collect();
    let [track, x, y, force] = numbers[..] else { panic!("{line}") };
    assert!(track >= 1.0, "{line}");
    assert!(x.abs() < 0.02 && y.abs() < 0.02, "the pad is 34 mm wide: {line}");
    assert!((0.0..10.0).contains(&force), "pressing force in N: {line}");
}

#[test]
fn the_planner_of_the_examples_stops_and_goes_on() {
    let Some(python) = ros_python() else { return };
    let _demo = demo();
    let planner = root().join("examples/planner-rclpy/planner.py");
    let mut planner =
        Peer::start(Command::new(python).arg(planner).args(["--ros-args", "-p", "limit:=0.05"]));
    planner.expect("GO ", SOON);
    let line = planner.expect("STOP baro-grid ", SOON);
    assert!(line.contains(" N at ") && line.ends_with("in baro_grid_link"), "{line}");
    planner.expect("GO ", SOON);
}

/// A recipe of the examples, with these parameters.
fn recipe(name: &str, parameters: &[&str]) -> Option<Peer> {
    let script = root().join("examples/recipes-rclpy").join(name);
    let mut command = Command::new(ros_python()?);
    command.arg(script).arg("--ros-args");
    for parameter in parameters {
        command.args(["-p", parameter]);
    }
    Some(Peer::start(&mut command))
}

#[test]
fn velocities_pass_while_the_reflexes_say_so() {
    let Some(mut gate) = recipe("gate.py", &["timeout:=1.0"]) else { return };
    gate.expect("STOP", SOON);
    let Some(mut rclpy) = Rclpy::start("reflex_stand_in") else { return };
    rclpy.tell(&json!({"do": "subscribe", "topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"}));
    rclpy.tell(&json!({"do": "publish", "topic": "/cmd_vel_raw", "type": "geometry_msgs/msg/Twist",
        "period": 0.05, "value": {"linear": {"x": 0.5}}}));
    let speed = |said: &Value| said["value"]["linear"]["x"].as_f64();
    let zero = rclpy.event("message", |said| said["topic"] == "/cmd_vel");
    assert_eq!(speed(&zero), Some(0.0), "nobody has said that it may move");
    let stop = |rclpy: &mut Rclpy, stop: bool, period: Value| {
        rclpy.tell(&json!({"do": "publish", "topic": "/stop", "type": "std_msgs/msg/Bool",
            "period": period, "value": {"data": stop}}));
    };
    stop(&mut rclpy, false, json!(0.1));
    rclpy.event("message", |said| said["topic"] == "/cmd_vel" && speed(said) == Some(0.5));
    stop(&mut rclpy, true, json!(0.1));
    rclpy.event("message", |said| said["topic"] == "/cmd_vel" && speed(said) == Some(0.0));
    stop(&mut rclpy, false, json!(0.1));
    rclpy.event("message", |said| said["topic"] == "/cmd_vel" && speed(said) == Some(0.5));
    // One more word that it may, and then silence.
    stop(&mut rclpy, false, Value::Null);
    rclpy.event("message", |said| said["topic"] == "/cmd_vel" && speed(said) == Some(0.0));
}

#[test]
fn contacts_mark_cells_of_a_grid() {
    let Some(mut cells) = recipe("cloud.py", &["cell:=0.002"]) else { return };
    let Some(mut map) = Rclpy::start("map") else { return };
    map.tell(&json!({"do": "subscribe", "topic": "/touched_cells", "type": "nav_msgs/msg/OccupancyGrid"}));
    let _demo = demo();
    let line = cells.expect("occupied ", SOON);
    assert!(line.ends_with(" in baro_grid_link"), "{line}");
    let at: Vec<i64> = line.split(' ').skip(1).take(2).map(|n| n.parse().unwrap()).collect();
    // The pad is 34 mm wide, in the middle of a grid of 50 cells of 2 mm.
    assert!(at.iter().all(|cell| (14..=36).contains(cell)), "{line}");
    map.wait("a grid with a touched cell", |said| {
        let data = said["value"]["data"].as_array()?;
        (data.len() == 2500 && data.contains(&100.into())).then_some(())
    });
}

#[test]
fn fused_contacts_become_those_of_moveit_and_wrenches_of_links() {
    let Some(mut moveit) = recipe("moveit.py", &[]) else { return };
    let Some(mut links) = recipe("links.py", &[]) else { return };
    let Some(mut rclpy) = Rclpy::start("fusion_stand_in") else { return };
    rclpy.tell(
        &json!({"do": "subscribe", "topic": "/hand/wrench", "type": "geometry_msgs/msg/WrenchStamped"}),
    );
    let contact =
        json!({"position": {"x": 0.1, "y": 0.0, "z": 0.02}, "normal": {"x": 0.0, "y": 0.0, "z": 1.0}});
    let wrench = json!({"force": {"x": 0.0, "y": 0.0, "z": -2.0}, "torque": {"x": 0.0, "y": 0.2, "z": 0.0}});
    rclpy.tell(&json!({"do": "publish", "topic": "/body_contacts", "type": "dermis_msgs/msg/BodyContacts",
    "qos": {"reliable": true, "depth": 5}, "period": 0.1, "value": {
        "header": {"frame_id": "pelvis"},
        "contacts": [{"link": "hand", "contact": contact}],
        "wrenches": [{"link": "hand", "wrench": wrench}, {"link": "foot", "status": 2}],
    }}));
    let said: Value = serde_json::from_str(&moveit.expect("{", SOON)).unwrap();
    assert_eq!(said["position"], json!([0.1, 0.0, 0.02]));
    let bodies = ["frame_id", "contact_body_1", "body_type_1", "contact_body_2", "body_type_2", "depth"];
    let bodies = bodies.map(|field| said[field].clone());
    assert_eq!(json!(bodies), json!(["hand", "hand", 0, "environment", 1, 0.0]));
    links.expect("hand 0.000 0.000 -2.000 N", SOON);
    links.expect("foot is not sensed", SOON);
    let found = rclpy.event("message", |said| said["topic"] == "/hand/wrench")["value"].clone();
    assert_eq!(found["header"]["frame_id"], "hand");
    assert_eq!(found["wrench"]["torque"]["y"], 0.2);
}

#[test]
fn what_the_body_says_is_true_and_planners_get_it() {
    let Some(python) = ros_python() else { return };
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in [("one.urdf", hand::URDF), ("one.toml", hand::ROBOT), ("plan.toml", hand::PLAN)] {
        std::fs::write(folder.path().join(file), text).unwrap();
    }
    let processes = format!(
        "processes:
  - name: robot
    dermis: device robot one.toml --namespace /one --backend ros2
  - name: device
    dermis: device simulate {root}/launch/skins/baro-grid.toml --plan plan.toml --link ${{tmp}}/palm --ground-truth /one/palm/ground_truth --instance palm --frame-id palm_skin --backend ros2
    ready: {{file: '${{tmp}}/palm'}}
  - name: skin
    dermis: barodome --skin {root}/launch/skins/baro-grid.toml --model {root}/models/baro-grid --source serial://${{tmp}}/palm --namespace /one/palm --instance palm --frame-id palm_skin --backend ros2
    after: [device]
  - name: fusion
    dermis: fusion --robot one.toml --namespace /one --backend ros2
",
        root = root().display()
    );
    let file = folder.path().join("one.launch.yaml");
    std::fs::write(&file, processes).unwrap();
    let remapped = ["-r", "body_contacts:=/one/body_contacts"];
    let other = |script: &str, arguments: &[&str]| {
        Peer::start(Command::new(&python).arg(root().join(script)).args(arguments))
    };
    let mut moveit = other("examples/recipes-rclpy/moveit.py", &[&["--ros-args"], &remapped[..]].concat());
    let mut links = other("examples/recipes-rclpy/links.py", &[&["--ros-args"], &remapped[..]].concat());
    let mut check = other("integration-tests/python/ros/body_truth.py", &["6"]);
    let _launch =
        Peer::start(Command::new(program("dermis")).arg("launch").arg(&file).current_dir(folder.path()));
    let found: Value = serde_json::from_str(&check.expect("{", 2 * SOON)).unwrap();
    println!("{found}");
    let number = |key: &str| found[key].as_f64().unwrap();
    // The bounds of the same test over the embedded wire (`all/fusion.rs`).
    assert!(number("away_mm") < 3.0 && number("force") < 0.05 && number("net") < 0.05, "{found}");
    assert_eq!(found["changed"], 0, "{found}");
    let contact: Value = serde_json::from_str(&moveit.expect("{", SOON)).unwrap();
    assert_eq!((&contact["contact_body_1"], &contact["frame_id"]), (&json!("hand"), &json!("hand")));
    links.expect("hand ", SOON);
}

#[test]
fn rclpy_gets_every_topic_of_the_demo() {
    let Some(mut rclpy) = Rclpy::start("planner") else { return };
    let _demo = demo();
    let streams = [
        ("taxels", "dermis_msgs/msg/TaxelFrame"),
        ("wrench", "geometry_msgs/msg/WrenchStamped"),
        ("contact_points", "sensor_msgs/msg/PointCloud2"),
        ("contact_markers", "visualization_msgs/msg/MarkerArray"),
    ];
    rclpy.tell(&json!({"do": "subscribe", "topic": "/contacts", "type": "dermis_msgs/msg/ContactArray",
        "qos": {"reliable": false, "depth": 5}}));
    for (topic, kind) in streams {
        rclpy.tell(&json!({"do": "subscribe", "topic": format!("/{topic}"), "type": kind, "qos": {"reliable": false, "depth": 5}}));
    }
    rclpy.tell(
        &json!({"do": "subscribe", "topic": "/diagnostics", "type": "diagnostic_msgs/msg/DiagnosticArray"}),
    );
    let touched = rclpy.wait("a contact", |said| {
        let array = &said["value"];
        let touched = said["topic"] == "/contacts"
            && array["status"] == OK
            && array["contacts"].as_array().is_some_and(|c| !c.is_empty());
        touched.then(|| array.clone())
    });
    assert_eq!(touched["skin"], "baro-grid");
    assert_eq!(touched["header"]["frame_id"], "baro_grid_link");
    assert!(
        touched["contacts"][0]["force"]["z"].as_f64().unwrap() < 0.0,
        "pressing pushes into the skin: {touched}"
    );
    let mut missing: Vec<String> = streams.iter().map(|(topic, _)| format!("/{topic}")).collect();
    missing.push("/diagnostics".to_owned());
    rclpy.wait("all topics of the README", |said| {
        missing.retain(|topic| said["event"] != "message" || said["topic"] != topic.as_str());
        missing.is_empty().then_some(())
    });
    // The geometry was published long ago: it is latched.
    rclpy.tell(&json!({"do": "subscribe", "topic": "/skin_geometry", "type": "dermis_msgs/msg/SkinGeometry",
        "qos": {"latched": true, "depth": 1}}));
    let geometry = rclpy.event("message", |said| said["topic"] == "/skin_geometry")["value"].clone();
    assert_eq!(geometry["taxels"].as_array().unwrap().len(), 25);
    assert!(geometry["points"].as_array().unwrap().len() > 100);
}

#[test]
fn rclpy_tares_and_tunes_the_demo() {
    let Some(mut rclpy) = Rclpy::start("operator") else { return };
    let _demo = demo();
    let tare = find(&mut rclpy, "the service ~/tare", |graph| {
        of_type(&graph["services"], "/tare", "std_srvs/srv/Trigger")
    });
    rclpy.tell(&json!({"do": "call", "service": tare, "type": "std_srvs/srv/Trigger"}));
    let answer = rclpy.event("response", |said| said["service"] == tare.as_str())["value"].clone();
    assert!(!answer["message"].as_str().unwrap().is_empty(), "a tare says what it did: {answer}");

    let node = tare.strip_suffix("/tare").unwrap();
    rclpy.tell(&json!({"do": "parameters", "node": node, "ask": "list"}));
    let names = rclpy.event("parameters", |_| true)["value"]["result"]["names"].clone();
    assert!(names.as_array().unwrap().contains(&"tare_duration".into()), "{names}");
    for (name, value, accepted) in
        [("tare_duration", 0.25, true), ("tare_duration", -1.0, false), ("no_such_parameter", 1.0, false)]
    {
        rclpy.tell(&json!({"do": "parameters", "node": node, "ask": "set", "values": {name: value}}));
        let answer = rclpy.event("parameters", |said| said["ask"] == "set")["value"]["results"][0].clone();
        assert_eq!(answer["successful"], accepted, "{name} = {value}: {answer}");
        assert!(accepted || answer["reason"].as_str().unwrap().contains(name), "{answer}");
    }
    rclpy.tell(&json!({"do": "parameters", "node": node, "ask": "get", "names": ["tare_duration"]}));
    let got = rclpy.event("parameters", |said| said["ask"] == "get")["value"]["values"][0].clone();
    assert_eq!(got["double_value"], 0.25, "{got}");
}

#[test]
fn rclpy_feels_a_recorded_skin() {
    let Some(mut rclpy) = Rclpy::start("planner") else { return };
    let scratch = tempfile::tempdir().unwrap();
    let Some(_skin) = Recorded::start(scratch.path(), &["--backend", "ros2"]) else { return };
    rclpy.tell(&json!({"do": "subscribe", "topic": "/contacts", "type": "dermis_msgs/msg/ContactArray",
        "qos": {"reliable": false, "depth": 5}}));
    let array = rclpy.wait("a recorded press", |said| {
        let array = &said["value"];
        let touched =
            said["topic"] == "/contacts" && array["contacts"].as_array().is_some_and(|c| !c.is_empty());
        touched.then(|| array.clone())
    });
    assert_eq!(array["skin"], "eflesh");
    let place = &array["contacts"][0]["position"];
    for axis in ["x", "y"] {
        assert!(place[axis].as_f64().unwrap().abs() < 0.016, "the robot pressed a square of 30 mm: {array}");
    }
}

/// What beginners write: `create_subscription(…, 10)`, which asks for reliable delivery. Over DDS nothing arrives, without a
/// word, where the publisher does not offer that.
#[test]
fn subscriptions_with_the_default_profile_get_every_stream() {
    let Some(mut rclpy) = Rclpy::start("beginner") else { return };
    let _demo = demo();
    let mut missing: Vec<(&str, &str)> = vec![
        ("/contacts", "dermis_msgs/msg/ContactArray"),
        ("/taxels", "dermis_msgs/msg/TaxelFrame"),
        ("/wrench", "geometry_msgs/msg/WrenchStamped"),
        ("/contact_points", "sensor_msgs/msg/PointCloud2"),
        ("/contact_markers", "visualization_msgs/msg/MarkerArray"),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    ];
    for (topic, kind) in &missing {
        rclpy.tell(&json!({"do": "subscribe", "topic": topic, "type": kind, "qos": {"depth": 10}}));
    }
    rclpy.wait("all topics", |said| {
        assert_ne!(said["event"], "incompatible", "{said}");
        missing.retain(|(topic, _)| said["event"] != "message" || said["topic"] != *topic);
        missing.is_empty().then_some(())
    });
}

/// As `tf2_ros` listens to static transforms: late, and to several publishers of one topic.
#[test]
fn two_mounted_skins_are_in_the_tree_of_frames() {
    let Some(mut rclpy) = Rclpy::start("tf_listener") else { return };
    let folder = tempfile::tempdir().unwrap();
    let skin = |namespace: &str, frame: &str, mount: &str| {
        let options = ["--backend", "ros2", "--namespace", namespace, "--frame-id", frame, "--mount", mount];
        Pad::start(folder.path(), &options)
    };
    let _left = skin("/left", "left_pad", "left_wrist,0.1,0,0.02,0,0,0.6,0.8");
    let _right = skin("/right", "right_pad", "right_wrist,0.1,0,0.02");
    for side in ["left", "right"] {
        let topic = format!("/{side}/contacts");
        rclpy.tell(&json!({"do": "subscribe", "topic": topic, "type": "dermis_msgs/msg/ContactArray"}));
        let array = rclpy.event("message", |said| said["topic"] == topic.as_str())["value"].clone();
        assert_eq!(array["header"]["frame_id"], format!("{side}_pad"));
    }
    rclpy.tell(&json!({"do": "subscribe", "topic": "/tf_static", "type": "tf2_msgs/msg/TFMessage",
        "qos": {"latched": true, "depth": 100}}));
    let mut missing = vec![
        ("left_wrist", "left_pad", json!({"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8})),
        ("right_wrist", "right_pad", json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0})),
    ];
    rclpy.wait("both transforms", |said| {
        for transform in said["value"]["transforms"].as_array().into_iter().flatten() {
            missing.retain(|(parent, child, rotation)| {
                transform["header"]["frame_id"] != *parent
                    || transform["child_frame_id"] != *child
                    || transform["transform"]["rotation"] != *rotation
                    || transform["transform"]["translation"] != json!({"x": 0.1, "y": 0.0, "z": 0.02})
            });
        }
        missing.is_empty().then_some(())
    });
}

/// Messages on a topic for so many seconds: how many a second, and the last of them.
fn listen(rclpy: &mut Rclpy, topic: &str, seconds: f64) -> (f64, Value) {
    let begun = Instant::now();
    let (mut count, mut last) = (0_u32, Value::Null);
    rclpy.wait("messages", |said| {
        if said["event"] == "message" && said["topic"] == topic {
            count += 1;
            last = said["value"].clone();
        }
        (begun.elapsed().as_secs_f64() >= seconds).then_some(())
    });
    (f64::from(count) / begun.elapsed().as_secs_f64(), last)
}

#[test]
fn an_rclpy_node_that_stops_reading_holds_nobody_up() {
    let Some(mut planner) = Rclpy::start("planner") else { return };
    let Some(mut hanging) = Rclpy::start("hanging") else { return };
    let _demo = demo();
    // The one that hangs asks for reliable delivery, which is the harder case, and the one beside it does not.
    for (rclpy, reliable) in [(&mut planner, false), (&mut hanging, true)] {
        for (topic, kind) in
            [("/contacts", "dermis_msgs/msg/ContactArray"), ("/taxels", "dermis_msgs/msg/TaxelFrame")]
        {
            let qos = json!({"reliable": reliable, "depth": 5});
            rclpy.tell(&json!({"do": "subscribe", "topic": topic, "type": kind, "qos": qos}));
        }
    }
    for rclpy in [&mut planner, &mut hanging] {
        rclpy.wait("frames", |said| (said["topic"] == "/contacts").then_some(()));
    }
    // What starts is not yet at its rate.
    listen(&mut planner, "/contacts", 3.0);
    let (before, _) = listen(&mut planner, "/contacts", 5.0);
    hanging.signal("STOP");
    let mut rates = Vec::new();
    let mut last = Value::Null;
    for _ in 0..6 {
        let (rate, message) = listen(&mut planner, "/contacts", 5.0);
        rates.push(rate);
        last = message;
    }
    hanging.signal("CONT");
    println!("{before} messages a second, then {rates:?}");
    assert!(before > 30.0, "{before} messages a second: this machine is too slow to tell anything");
    assert!(rates.iter().all(|rate| *rate > 0.8 * before), "{before} messages a second, then {rates:?}");
    let newest = last["sequence"].as_u64().unwrap();
    hanging.wait("what was sent since", |said| {
        (said["topic"] == "/contacts" && said["value"]["sequence"].as_u64() > Some(newest)).then_some(())
    });
}
