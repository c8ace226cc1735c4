use super::*;

#[test]
fn limits_that_are_none_are_refused() {
    for (limits, field) in [
        (LogLimits { rate: -1.0, ..LogLimits::default() }, "rate"),
        (LogLimits { rate: f64::NAN, ..LogLimits::default() }, "rate"),
        (LogLimits { size: 1e-9, ..LogLimits::default() }, "size"),
        (LogLimits { size: f64::INFINITY, ..LogLimits::default() }, "size"),
        (LogLimits { keep: 1001, ..LogLimits::default() }, "keep"),
    ] {
        assert_eq!(limits.check().unwrap_err().0, field);
    }
    LogLimits::default().check().unwrap();
    LogLimits { rate: 0.0, size: 0.0, keep: 0 }.check().unwrap();
}

fn at_noon(mut record: Record) -> Record {
    record.time = "2026-11-21T12:00:00.000Z".to_owned();
    record
}

#[test]
fn lines_of_our_programs_keep_level_and_fields() {
    let line = br#"{"timestamp":"2026-11-21T12:34:56.789012Z","level":"WARN","fields":{"message":"no frame","seconds":2.5,"node":"/pad"},"target":"dermis_node"}"#;
    let record = Record::parse(line);
    insta::assert_snapshot!(record.json("left/pad"), @r#"{"fields":{"node":"/pad","seconds":2.5},"level":"WARN","message":"no frame","process":"left/pad","target":"dermis_node","time":"2026-11-21T12:34:56.789012Z"}"#);
    insta::assert_snapshot!(record.human(Some(("pad", 6, 0)), false), @"12:34:56.789 pad    WARN  no frame node=/pad seconds=2.5");
}

#[test]
fn levels_are_found_where_others_write_them() {
    for (line, level) in [
        ("[INFO] [1700000000.123] [talker]: hello", Some(Level::Info)),
        ("[ERROR] [1.0] [talker]: no", Some(Level::Error)),
        ("2026-11-21T12:00:00Z  WARN talker: hm", Some(Level::Warn)),
        ("WARNING:root:careful", Some(Level::Warn)),
        ("serial:///dev/pts/3", None),
        ("an ERROR may be reported later in a text", Some(Level::Error)),
        ("it says that an ERROR is no level", None),
        ("{\"level\": 3}", None),
        ("{", None),
    ] {
        let record = Record::parse(line.as_bytes());
        assert_eq!((record.level, record.message.as_str()), (level, line));
    }
    let record = at_noon(Record::parse(b"\xff\x1b[1m bytes"));
    let json: Value = serde_json::from_str(&record.json("x")).unwrap();
    assert_eq!(json["message"], "\u{fffd}\u{1b}[1m bytes");
}

#[test]
fn a_flood_is_counted_and_others_are_not_held_up() {
    let folder = tempfile::tempdir().unwrap();
    let limits = LogLimits { rate: 500.0, ..LogLimits::default() };
    let options = LogOptions { folder: Some(folder.path().to_owned()), limits, ..LogOptions::default() };
    let writer = Writer::start(&options, vec!["flood".into(), "calm".into()]).unwrap();
    let (flood, calm) = (writer.tap(0), writer.tap(1));
    let mut taken = 0;
    for _ in 0..100_000 {
        if flood.has_room() {
            flood.take(Record::parse(b"y"));
            taken += 1;
        }
    }
    assert!(calm.has_room());
    calm.take(Record::parse(b"still here"));
    flood.confess(true);
    drop((flood, calm));
    writer.finish();
    let text = std::fs::read_to_string(folder.path().join("flood.log")).unwrap();
    let left_out: u64 = text
        .lines()
        .filter_map(|line| {
            line.split_once("WARN ")?.1.split_once(" lines left out")?.0.trim().parse::<u64>().ok()
        })
        .sum();
    let written = text.lines().filter(|line| line.ends_with(" y")).count() as u64;
    assert_eq!((written, written + left_out), (taken, 100_000));
    assert!(written < 100_000 / 2, "{written} lines");
    assert!(
        text.contains("lines left out here: more than 500 a second (`log_limits.rate`)"),
        "{}",
        text.len()
    );
    assert!(std::fs::read_to_string(folder.path().join("calm.log")).unwrap().contains("still here"));
}
