//! Round trips, bad files and interrupted recordings.

use std::{fs, path::Path};

use dermis_bag::{BagError, BagQos, BagReader, BagWriter, Filter};
use dermis_msgs::{
    ChannelLayout, Message, TypeSupport,
    msg::{Indentation, SkinGeometry, TaxelFrame},
    std_msgs::msg::Header,
};
use proptest::prelude::*;

const START: i64 = 1_742_155_052_516_165_000;

fn frame(index: u64) -> TaxelFrame {
    TaxelFrame {
        header: Header { frame_id: "pad".into(), ..Header::default() },
        skin: "pad".into(),
        sequence: index,
        layout_id: ChannelLayout::id_of("Pa", ["p0", "p1"]),
        values: vec![index as f32, f32::NAN],
        flags: vec![0, TaxelFrame::FLAG_DEAD],
        temperature: f32::NAN,
        ..TaxelFrame::default()
    }
}

fn truth(index: u64) -> Indentation {
    Indentation {
        session: "s".into(),
        press: index,
        phase: Indentation::PHASE_IDLE,
        ..Indentation::default()
    }
}

/// NaN differs from itself, the bytes don't.
fn same<T: Message>(a: &T, b: &T) -> bool {
    a.to_cdr() == b.to_cdr()
}

#[expect(clippy::unwrap_used, reason = "a helper of tests")]
fn write(dir: &Path, count: u64) {
    let mut writer = BagWriter::create(dir).unwrap();
    writer.set_custom("source", "a test");
    writer.add_topic("skin_geometry", TypeSupport::of::<SkinGeometry>(), BagQos::latched()).unwrap();
    writer.write("skin_geometry", &SkinGeometry::default(), START).unwrap();
    for index in 0..count {
        let time = START + i64::try_from(index).unwrap() * 10_000_000;
        writer.write("left/taxels", &frame(index), time).unwrap();
        writer.write("left/ground_truth", &truth(index), time).unwrap();
    }
    let info = writer.finish().unwrap();
    assert_eq!(info.messages, 2 * count + 1);
}

#[test]
fn every_message_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("presses");
    write(&bag, 300);

    for path in [bag.clone(), bag.join("presses_0.mcap")] {
        let reader = BagReader::open(&path).unwrap();
        let frames: Vec<_> = reader.read::<TaxelFrame>("taxels").unwrap().map(Result::unwrap).collect();
        assert_eq!(frames.len(), 300);
        for (index, read) in (0u64..).zip(&frames) {
            assert!(same(&read.message, &frame(index)));
            assert_eq!(read.log_time, START + i64::try_from(index).unwrap() * 10_000_000);
        }
        let truths: Vec<_> = reader.read_only_topic::<Indentation>().unwrap().map(Result::unwrap).collect();
        assert!(truths.len() == 300 && truths[299].message == truth(299));
        assert_eq!(reader.messages().map(Result::unwrap).count(), 601);

        let geometry = reader.topic_of_type::<SkinGeometry>().unwrap();
        assert_eq!(geometry.name, "/skin_geometry");
        assert_eq!(geometry.qos, Some(BagQos::latched()));
        assert_eq!(geometry.type_hash.as_deref(), Some(SkinGeometry::TYPE_HASH));
        assert_eq!(geometry.messages, 1);
        assert_eq!(reader.topic("/left/taxels").unwrap().qos, Some(BagQos::sensor_data()));
    }

    let reader = BagReader::open(&bag).unwrap();
    assert_eq!(reader.custom()["source"], "a test");
    let info = reader.info();
    assert_eq!(info.span, Some((START, START + 2_990_000_000)));
    assert!(info.complete && (info.duration_s() - 2.99).abs() < 1e-12);

    let by_type = Filter::default().types([TaxelFrame::TYPE_NAME]).between(START, START + 50_000_000);
    let few: Vec<_> = reader.messages_where(by_type).map(Result::unwrap).collect();
    assert_eq!(few.len(), 5);
    assert!(few.iter().all(|message| &*message.topic == "/left/taxels"));
    assert_eq!(reader.messages_where(Filter::default().topics(["/none"])).count(), 0);
}

#[test]
fn an_empty_bag_is_a_bag() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("empty");
    BagWriter::create(&bag).unwrap().finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    assert!(reader.info().span.is_none() && reader.messages().next().is_none());
}

#[test]
fn mistakes_of_a_caller_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("presses");
    write(&bag, 3);
    let say = |error: BagError| error.to_string().replace(&dir.path().display().to_string(), "");

    insta::assert_snapshot!(say(BagWriter::create(&bag).unwrap_err()), @"/presses exists already: bags are never written over, give another name or remove it");
    insta::assert_snapshot!(say(BagReader::open(dir.path().join("nothing")).unwrap_err()), @"there is no bag at /nothing: give a rosbag2 folder or an .mcap file");
    let reader = BagReader::open(&bag).unwrap();
    insta::assert_snapshot!(say(reader.read::<TaxelFrame>("right/taxels").unwrap_err()), @"/presses has no topic right/taxels: it has /left/ground_truth, /left/taxels, /skin_geometry");
    insta::assert_snapshot!(say(reader.read::<TaxelFrame>("ground_truth").unwrap_err()), @"topic /left/ground_truth of /presses carries dermis_msgs/msg/Indentation, not dermis_msgs/msg/TaxelFrame");
    insta::assert_snapshot!(say(reader.read_only_topic::<Header>().unwrap_err()), @"/presses has no topic of type std_msgs/msg/Header: it has /left/ground_truth (dermis_msgs/msg/Indentation), /left/taxels (dermis_msgs/msg/TaxelFrame), /skin_geometry (dermis_msgs/msg/SkinGeometry)");
    let message = reader.messages().next().unwrap().unwrap();
    insta::assert_snapshot!(say(message.decode::<TaxelFrame>().unwrap_err()), @"topic /skin_geometry of /presses/presses_0.mcap carries dermis_msgs/msg/SkinGeometry, not dermis_msgs/msg/TaxelFrame");

    let mut writer = BagWriter::create(dir.path().join("other")).unwrap();
    writer.write("a/taxels", &frame(0), START).unwrap();
    writer.write("b/taxels", &frame(0), START).unwrap();
    insta::assert_snapshot!(say(writer.write("a/taxels", &truth(0), START).unwrap_err()), @"topic /a/taxels of /other carries dermis_msgs/msg/TaxelFrame, not dermis_msgs/msg/Indentation");
    insta::assert_snapshot!(say(writer.write("a/taxels", &frame(0), -1).unwrap_err()), @"message for topic /a/taxels refused by /other: its time of -1 ns is before 1970");
    insta::assert_snapshot!(say(writer.write_cdr("a/taxels", TypeSupport::of::<TaxelFrame>(), b"{\"json\":1}", START).unwrap_err()), @"message for topic /a/taxels refused by /other: it does not start with a CDR encapsulation header (00 01 00 00 or 00 00 00 00)");
    writer.write_cdr("a/taxels", TypeSupport::of::<TaxelFrame>(), &[0, 1, 0, 0, 9], START).unwrap();
    writer.finish().unwrap();
    let reader = BagReader::open(dir.path().join("other")).unwrap();
    insta::assert_snapshot!(say(reader.read::<TaxelFrame>("taxels").unwrap_err()), @"/other has several topics that fit taxels: /a/taxels, /b/taxels; name one");
    let items: Vec<_> = reader.read::<TaxelFrame>("a/taxels").unwrap().collect();
    assert!(items.len() == 2 && items[0].is_ok());
    let error = say(items.into_iter().next_back().unwrap().unwrap_err());
    assert!(
        error.starts_with(
            "message at 1742155052516165000 ns on topic /a/taxels of /other/other_0.mcap does not decode as dermis_msgs/msg/TaxelFrame: "
        ),
        "{error}"
    );
}

#[test]
fn another_version_of_a_type_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("old");
    let now = TypeSupport::of::<TaxelFrame>();
    let definition: &'static str =
        now.definition.replace("float32 temperature", "float64 temperature").leak();
    let old = TypeSupport { hash: "RIHS01_0000", definition, ..*now };
    let mut writer = BagWriter::create(&bag).unwrap();
    writer.write_cdr("taxels", &old, &frame(1).to_cdr(), START).unwrap();
    writer.finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    let error = reader.read::<TaxelFrame>("taxels").unwrap_err().to_string();
    insta::assert_snapshot!(error.replace(&dir.path().display().to_string(), ""), @r#"topic /taxels of /old was recorded with another version of dermis_msgs/msg/TaxelFrame: field 8 of dermis_msgs/TaxelFrame is "float64 temperature" in the bag and "float32 temperature" here"#);

    // The same fields under another hash (another hash version, an edited comment) are the same type.
    let same_fields = TypeSupport {
        hash: "RIHS02_0000",
        definition: format!("# edited\n{}", now.definition).leak(),
        ..*now
    };
    let mut writer = BagWriter::create(dir.path().join("new")).unwrap();
    writer.write_cdr("taxels", &same_fields, &frame(1).to_cdr(), START).unwrap();
    writer.finish().unwrap();
    let reader = BagReader::open(dir.path().join("new")).unwrap();
    assert!(same(&reader.read::<TaxelFrame>("taxels").unwrap().next().unwrap().unwrap().message, &frame(1)));
}

#[test]
fn a_dropped_writer_leaves_a_bag_that_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("cut");
    let mut writer = BagWriter::create(&bag).unwrap();
    for index in 0..10 {
        writer.write("taxels", &frame(index), START).unwrap();
    }
    drop(writer);
    let say = |error: BagError| error.to_string().replace(&dir.path().display().to_string(), "");
    insta::assert_snapshot!(say(BagReader::open(&bag).unwrap_err()), @"/cut has no metadata.yaml: the recording was interrupted before it was finished, or this is not a bag (1 .mcap files are in it); name an .mcap file itself, or recover what is whole");
    let recovered = BagReader::recover(&bag).unwrap();
    assert!(!recovered.info().complete);
    assert_eq!(recovered.read::<TaxelFrame>("taxels").unwrap().map(Result::unwrap).count(), 10);
}

/// A bag whose last bytes are missing, wherever the cut falls, is named as such; recovery gives a prefix.
#[test]
fn a_truncated_file_is_named_and_recovered() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("long");
    let mut writer = BagWriter::create(&bag).unwrap();
    for index in 0..40 {
        writer.write("taxels", &frame(index), START).unwrap();
        if index % 10 == 9 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
    let file = bag.join("long_0.mcap");
    let whole = fs::read(&file).unwrap();
    let mut recovered_counts = Vec::new();
    for cut in (0..whole.len()).step_by(37).chain([whole.len() - 1]) {
        fs::write(&file, &whole[..cut]).unwrap();
        let error = BagReader::open(&bag).unwrap_err();
        let text = error.to_string();
        assert!(
            matches!(error, BagError::Truncated { .. } | BagError::Foreign { .. } | BagError::Corrupt { .. })
                && text.contains("long_0.mcap"),
            "cut at {cut}: {text}"
        );
        if let Ok(reader) = BagReader::recover(&bag) {
            let frames: Vec<_> =
                reader.messages().map(|message| message.unwrap().decode::<TaxelFrame>().unwrap()).collect();
            assert!((0u64..).zip(&frames).all(|(index, read)| same(read, &frame(index))), "cut at {cut}");
            assert_eq!(reader.info().messages, frames.len() as u64);
            assert!(!reader.info().complete);
            recovered_counts.push(frames.len());
        }
    }
    assert!(recovered_counts.is_sorted(), "{recovered_counts:?}");
    assert!(recovered_counts.contains(&20) && recovered_counts.last() == Some(&40), "{recovered_counts:?}");
}

#[test]
fn foreign_files_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let say = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        let error = BagReader::open(&path).unwrap_err().to_string();
        error.replace(&dir.path().display().to_string(), "")
    };
    insta::assert_snapshot!(say("a.mcap", b"x,y,z\n1,2,3\n"), @r#"/a.mcap is not an MCAP file: it starts with "x,y,z\n1,2,3\n""#);
    insta::assert_snapshot!(say("b.db3", b"SQLite format 3\0....."), @"/b.db3 is stored as `sqlite3`, which is not read here: convert it with `ros2 bag convert` to uncompressed `mcap` storage");
    insta::assert_snapshot!(say("c.mcap", b""), @"/c.mcap ends in the middle, after 0 whole messages: the recording was interrupted or the copy is not complete: copy it again, or recover what is whole");
    insta::assert_snapshot!(say("d.mcap.zstd", &[0x28, 0xb5, 0x2f, 0xfd, 0, 0]), @"/d.mcap.zstd is stored as a zstd-compressed file, which is not read here: convert it with `ros2 bag convert` to uncompressed `mcap` storage");
    let error = BagReader::open(dir.path()).unwrap_err().to_string();
    insta::assert_snapshot!(error.replace(&dir.path().display().to_string(), "FOLDER"), @"FOLDER has no metadata.yaml: the recording was interrupted before it was finished, or this is not a bag (2 .mcap files are in it); name an .mcap file itself, or recover what is whole");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever bytes change, reading ends in an error or in the messages that were written.
    #[test]
    fn damage_never_passes_for_data(changes in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..4)) {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("b");
        write(&bag, 30);
        let file = bag.join("b_0.mcap");
        let mut bytes = fs::read(&file).unwrap();
        for (at, change) in changes {
            let at = at.index(bytes.len());
            bytes[at] ^= change;
        }
        fs::write(&file, bytes).unwrap();
        for reader in [BagReader::open(&bag), BagReader::recover(&bag)].into_iter().flatten() {
            for message in reader.messages().take(1000) {
                let Ok(message) = message else { break };
                if &*message.type_name == TaxelFrame::TYPE_NAME && &*message.topic == "/left/taxels"
                    && let Ok(read) = message.decode::<TaxelFrame>()
                {
                    prop_assert!(same(&read, &frame(read.sequence)), "{read:?}");
                }
            }
        }
    }

    #[test]
    fn any_text_is_not_metadata(text in "\\PC{0,200}") {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("metadata.yaml"), text).unwrap();
        prop_assert!(BagReader::open(dir.path()).is_err());
    }
}
