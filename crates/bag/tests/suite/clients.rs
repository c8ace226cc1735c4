//! Bags in the hands of libraries that others wrote: `rosbags` and `mcap-ros2-support`.
//!
//! `DERMIS_CLIENT_PYTHON` names a Python that has them; without it these tests skip and say so.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use dermis_bag::{BagOptions, BagQos, BagReader, BagWriter, Compression};
use dermis_msgs::{
    Message, TypeSupport,
    geometry_msgs::msg::{Point, Pose, Vector3},
    msg::{Indentation, IndentationContact, SkinGeometry, TaxelFrame},
    sensor_msgs::msg::{PointCloud2, PointField},
    std_msgs::msg::Header,
    type_supports,
};
use serde_json::{Value, json};

const START: i64 = 1_742_155_052_516_165_123;

fn python() -> Option<PathBuf> {
    let python = std::env::var_os("DERMIS_CLIENT_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: DERMIS_CLIENT_PYTHON names no Python with `rosbags` and `mcap-ros2-support`");
    }
    python
}

fn run(python: &Path, command: &str, bag: &Path, lines: &Path) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients.py");
    let output = Command::new(python)
        .arg(script)
        .arg(command)
        .arg(bag)
        .arg(lines)
        .output()
        .expect("the client starts");
    let said =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{said}");
    said
}

fn line<T: Message>(topic: &str, log_time: i64, message: &T) -> Value {
    let support = TypeSupport::of::<T>();
    let message = (support.cdr_to_json)(&message.to_cdr()).expect("its own bytes decode");
    json!({"topic": topic, "type": T::TYPE_NAME, "log_time": log_time, "message": message})
}

fn header(frame: &str) -> Header {
    Header { frame_id: frame.into(), ..Header::default() }
}

fn frame(index: u64) -> TaxelFrame {
    TaxelFrame {
        header: header("pad"),
        skin: "pad".into(),
        sequence: index,
        device_time_us: u64::MAX - index,
        layout_id: u32::MAX,
        values: vec![index as f32 * 1.1e-3, f32::NAN, -0.5],
        flags: vec![0, TaxelFrame::FLAG_NOT_FINITE, 16],
        temperature: 293.15,
    }
}

fn truth(index: u64) -> Indentation {
    Indentation {
        header: header("pad"),
        skin: "pad".into(),
        session: "run".into(),
        press: index,
        location: 961,
        phase: Indentation::PHASE_LOAD,
        temperature: f32::NAN,
        contacts: vec![IndentationContact {
            position: Point { x: -0.015, y: 0.001 * index as f64, z: 0.0 },
            normal: Vector3 { z: 1.0, ..Vector3::default() },
            force: Vector3 { x: f64::NAN, y: f64::NAN, z: -3.25 },
            force_components: 1,
            depth: f64::NAN,
            diameter: 0.004,
            tip: IndentationContact::TIP_BOX,
            tip_parameters: vec![0.003, 0.002, f64::NAN],
            tip_name: "edge µ".into(),
            tip_pose: Pose { position: Point::UNKNOWN, ..Pose::default() },
            temperature: 300.5,
        }],
        gravity: Vector3::UNKNOWN,
        ..Indentation::default()
    }
}

fn cloud() -> PointCloud2 {
    let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: 7, count: 1 };
    PointCloud2 {
        header: header("pad"),
        height: 1,
        width: 2,
        fields: vec![field("x", 0), field("y", 4)],
        point_step: 8,
        row_step: 16,
        data: (0..16).collect(),
        is_dense: true,
        ..PointCloud2::default()
    }
}

fn geometry() -> SkinGeometry {
    SkinGeometry {
        header: header("pad"),
        skin: "pad".into(),
        points: vec![Point { x: 1.0, y: 2.0, z: 3.0 }],
        normals: vec![Vector3 { z: 1.0, ..Vector3::default() }],
        areas: vec![1e-6],
        triangles: vec![0, 0, 0],
        taxels: vec!["m0".into()],
        taxel_poses: vec![Pose::default()],
        layout_id: 9,
        unit: "T".into(),
        channels: vec!["m0.x".into(), "m0.y µ".into(), String::new()],
        channel_taxels: vec![0, 0, 0],
        electrodes: 7,
        ..SkinGeometry::default()
    }
}

#[test]
fn others_read_every_topic_with_equal_values() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("presses");
    let mut writer = BagWriter::create(&bag).unwrap();
    writer.set_custom("source", "tests: \"quoted\" µ");
    let mut lines = Vec::new();
    writer.add_topic("skin_geometry", TypeSupport::of::<SkinGeometry>(), BagQos::latched()).unwrap();
    writer.write("skin_geometry", &geometry(), START).unwrap();
    lines.push(line("/skin_geometry", START, &geometry()));
    for index in 0..500 {
        let time = START + i64::try_from(index).unwrap() * 10_000_000;
        writer.write("left/taxels", &frame(index), time).unwrap();
        lines.push(line("/left/taxels", time, &frame(index)));
        writer.write("left/ground_truth", &truth(index), time).unwrap();
        lines.push(line("/left/ground_truth", time, &truth(index)));
    }
    writer.add_topic("cloud", TypeSupport::of::<PointCloud2>(), BagQos::reliable(10)).unwrap();
    writer.write("cloud", &cloud(), START + 1).unwrap();
    lines.push(line("/cloud", START + 1, &cloud()));
    writer.finish().unwrap();

    let expected = dir.path().join("expected.json");
    fs::write(&expected, lines.iter().map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    let said = run(&python, "check", &bag, &expected);
    assert!(said.contains("rosbags: 1002 messages equal"), "{said}");
    assert!(said.contains("mcap-ros2-support: 1002 messages equal"), "{said}");
}

/// A value for every field of a type, from its definition: numbers that count up, lists of two elements.
fn filled(definitions: &BTreeMap<String, String>, type_name: &str, count: &mut u32) -> Value {
    let package = type_name.split('/').next().unwrap_or_default();
    let mut fields = serde_json::Map::new();
    for line in definitions[type_name].lines() {
        let line = line.split('#').next().unwrap_or_default().trim();
        let Some((kind, rest)) = line.split_once(char::is_whitespace) else { continue };
        let name = rest.split_whitespace().next().unwrap_or_default();
        if name.is_empty()
            || name.contains('=')
            || rest.split_whitespace().nth(1).is_some_and(|w| w.starts_with('='))
        {
            continue;
        }
        let (base, array) = kind.split_once('[').unwrap_or((kind, ""));
        let mut one = || {
            *count = *count % 100 + 1;
            match base.split("<=").next().unwrap_or_default() {
                "bool" => json!(count.is_multiple_of(2)),
                "string" => json!(format!("text {count} µ")),
                "float32" | "float64" => json!(f64::from(*count) * 0.25),
                number
                    if number.starts_with("int")
                        || number.starts_with("uint")
                        || number == "byte"
                        || number == "char" =>
                {
                    json!(*count)
                }
                "Header" => filled(definitions, "std_msgs/Header", count),
                nested if nested.contains('/') => filled(definitions, &nested.replace("/msg/", "/"), count),
                nested => filled(definitions, &format!("{package}/{nested}"), count),
            }
        };
        let value = match array.trim_end_matches(']') {
            _ if !kind.contains('[') => one(),
            "" => json!([one(), one()]),
            bounded if bounded.starts_with("<=") => json!([one()]),
            fixed => (0..fixed.parse().expect("a length")).map(|_: usize| one()).collect(),
        };
        fields.insert(name.to_owned(), value);
    }
    Value::Object(fields)
}

#[test]
fn others_read_every_type_from_split_files() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("all");
    let options = BagOptions::default().compression(Compression::Fast).split_ns(Some(20_000_000));
    let mut writer = BagWriter::create_with(&bag, &options).unwrap();
    let (mut lines, mut count) = (Vec::new(), 0);
    // `rosbags` hashes a field of type `char` otherwise than ROS 2 does, and refuses the one type that has such a field.
    let types = type_supports()
        .iter()
        .filter(|s| s.name.contains("/msg/") && s.name != "service_msgs/msg/ServiceEventInfo");
    for (support, index) in types.zip(0..) {
        let mut definitions = BTreeMap::new();
        let mut name = support.name.replace("/msg/", "/");
        for part in support.definition.split(&"=".repeat(80)) {
            let part = match part.trim_start().strip_prefix("MSG: ") {
                Some(rest) => {
                    let (head, body) = rest.split_once('\n').unwrap_or((rest, ""));
                    head.trim().clone_into(&mut name);
                    body
                }
                None => part,
            };
            definitions.insert(name.clone(), part.to_owned());
        }
        let root = support.name.replace("/msg/", "/");
        let value = filled(&definitions, &root, &mut count);
        let cdr = (support.json_to_cdr)(&value).unwrap_or_else(|e| panic!("{}: {e}", support.name));
        let (topic, time) = (format!("/topic{index}"), START + index * 1_000_000);
        writer.write_cdr(&topic, support, &cdr, time).unwrap();
        let message = (support.cdr_to_json)(&cdr).unwrap();
        lines.push(json!({"topic": topic, "type": support.name, "log_time": time, "message": message}));
    }
    let info = writer.finish().unwrap();
    assert!(info.files > 2 && info.messages > 40, "{info}");
    let expected = dir.path().join("expected.json");
    fs::write(&expected, lines.iter().map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    let said = run(&python, "check", &bag, &expected);
    for library in ["rosbags", "mcap-ros2-support"] {
        assert!(said.contains(&format!("{library}: {} messages equal", lines.len())), "{said}");
    }
}

#[test]
fn a_bag_of_rosbags_reads_here() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("theirs");
    let mut lines = Vec::new();
    for index in 0..50 {
        let time = START + i64::try_from(index).unwrap() * 10_000_000;
        let mut taxels = line("/taxels", time, &frame(index));
        taxels["definition"] = TaxelFrame::DEFINITION.into();
        lines.push(taxels);
        let mut indentation = line("/ground_truth", time, &truth(index));
        indentation["definition"] = Indentation::DEFINITION.into();
        lines.push(indentation);
    }
    let given = dir.path().join("given.json");
    fs::write(&given, lines.iter().map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    let said = run(&python, "write", &bag, &given);

    let reader = BagReader::open(&bag).unwrap();
    let topic = reader.topic_of_type::<TaxelFrame>().unwrap();
    assert_eq!(topic.qos.map(|qos| qos.depth), Some(7));
    // Their hash is computed by their code from the definition.
    assert!(said.contains(TaxelFrame::TYPE_HASH) && said.contains(Indentation::TYPE_HASH), "{said}");
    assert_eq!(topic.type_hash.as_deref(), Some(TaxelFrame::TYPE_HASH));
    let frames: Vec<_> = reader.read_only_topic::<TaxelFrame>().unwrap().map(Result::unwrap).collect();
    let truths: Vec<_> = reader.read_only_topic::<Indentation>().unwrap().map(Result::unwrap).collect();
    assert_eq!((frames.len(), truths.len()), (50, 50));
    for ((index, frame_read), truth_read) in (0u64..).zip(&frames).zip(&truths) {
        assert_eq!(frame_read.message.to_cdr(), frame(index).to_cdr());
        assert_eq!(truth_read.message.to_cdr(), truth(index).to_cdr());
        assert_eq!(frame_read.log_time, START + i64::try_from(index).unwrap() * 10_000_000);
    }
}
