//! Bytes against those of real ROS 2.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use dermis_msgs::{type_support, type_supports};

/// Samples of each type beside its default.
const VARIANTS: usize = 12;

/// `DERMIS_ROS_PYTHON` is a Python that has rclpy and dermis_msgs. It fills every message that this crate knows with
/// values and encodes it; the same values must be the same bytes here, and those bytes the same values. Equal bytes
/// are the other direction, too: rclpy decodes its own.
#[test]
fn every_message_has_the_bytes_of_rclpy() {
    let Some(python) = std::env::var_os("DERMIS_ROS_PYTHON") else {
        println!("skipped: DERMIS_ROS_PYTHON names no Python with rclpy and dermis_msgs");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/rclpy_samples.py");
    let mut child = Command::new(python)
        .arg(script)
        .arg(folder.path())
        .arg(VARIANTS.to_string())
        // Fast CDR leaves padding as it finds it. This has glibc hand out memory filled with 255 ^ 255, which its cache
        // of freed memory would go round.
        .env("MALLOC_PERTURB_", "255")
        .env("GLIBC_TUNABLES", "glibc.malloc.tcache_count=0")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let names: Vec<&str> = type_supports().iter().map(|support| support.name).collect();
    child.stdin.take().unwrap().write_all(names.join("\n").as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "the Python script failed");

    let mut compared = 0;
    for line in String::from_utf8(output.stdout).unwrap().lines() {
        let (sample, name) = line.split_once(' ').unwrap();
        if sample == "missing" {
            panic!("{name} is not installed there");
        }
        let support = type_support(name).unwrap();
        let cdr = fs::read(folder.path().join(format!("{sample}.cdr"))).unwrap();
        let json =
            serde_json::from_slice(&fs::read(folder.path().join(format!("{sample}.json"))).unwrap()).unwrap();
        let ours = (support.json_to_cdr)(&json).unwrap();
        // What follows is no part of the message: `serialize_message` hands out as many bytes as it had estimated.
        assert_eq!(cdr.get(..ours.len()), Some(&ours[..]), "bytes of {name} {json}");
        let decoded = (support.cdr_to_json)(&cdr).unwrap();
        if json != serde_json::json!({}) {
            assert_eq!(decoded, json, "values of {name}");
        }
        compared += 1;
    }
    assert!(compared >= names.len() * (VARIANTS + 1) - VARIANTS - 1, "{compared} samples compared");
    println!("{compared} samples of {} messages are equal", names.len());
}
