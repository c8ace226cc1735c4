//! Bags in the hands of libraries that others wrote: `rosbags` and `mcap-ros2-support`.
//!
//! `DERMIS_CLIENT_PYTHON` names a Python that has them; without it these tests skip and say so.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use dermis_bag::{BagQos, BagReader, BagWriter};
use dermis_msgs::{
    Message, TypeSupport,
    geometry_msgs::msg::{Point, Pose, Vector3},
    msg::{Indentation, IndentationContact, SkinGeometry, TaxelFrame},
    sensor_msgs::msg::{PointCloud2, PointField},
    std_msgs::msg::Header,
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
        channels: vec!["m0.x".into(), "m0.y µ".into(), String::new()],
        unit: "T".into(),
        values: vec![index as f32 * 1.1e-3, f32::NAN, -0.5],
        flags: vec![0, TaxelFrame::FLAG_NOT_FINITE, 16],
        electrodes: 7,
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
        }],
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
        channel_taxels: vec![0, 0, 0],
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
