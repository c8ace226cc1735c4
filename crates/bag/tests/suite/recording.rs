//! Recording through the queue, splits, order over files, checking and mending.

use std::{fs, path::Path, sync::Arc, time::Duration};

use dermis_bag::{
    BagError, BagOptions, BagQos, BagReader, BagWriter, Compression, Filter, Recorder, RecorderOptions,
    Severity, Topic, check, copy, repair,
};
use dermis_msgs::{
    Message, TypeSupport,
    msg::{Indentation, TaxelFrame},
};
use proptest::prelude::*;

const START: i64 = 1_742_155_052_516_165_000;

fn frame(index: u64) -> TaxelFrame {
    TaxelFrame {
        skin: "pad".into(),
        sequence: index,
        values: vec![index as f32],
        flags: vec![0],
        ..TaxelFrame::default()
    }
}

#[expect(clippy::unwrap_used, reason = "a helper of tests")]
fn at(index: u64) -> i64 {
    START + i64::try_from(index).unwrap() * 10_000_000
}

fn taxels() -> Topic {
    Topic::of_type("/taxels", TypeSupport::of::<TaxelFrame>(), Some(BagQos::reliable(10)))
}

#[expect(clippy::unwrap_used, reason = "a helper of tests")]
fn write(dir: &Path, count: u64, options: &BagOptions) {
    let mut writer = BagWriter::create_with(dir, options).unwrap();
    let id = writer.declare(&taxels()).unwrap();
    for index in 0..count {
        writer.write_bytes(id, &frame(index).to_cdr(), at(index), at(index) - 1000).unwrap();
        if index % 10 == 9 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
}

/// What a check says, without the folder.
#[expect(clippy::unwrap_used, reason = "a helper of tests")]
fn said(bag: &Path) -> String {
    let folder = format!("{}/", bag.parent().unwrap().display());
    check(bag).unwrap().to_string().replace(&folder, "")
}

#[test]
fn files_are_split_by_time_and_each_tells_all_topics() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    write(&bag, 100, &BagOptions::default().split_ns(Some(300_000_000)));
    let reader = BagReader::open(&bag).unwrap();
    assert_eq!(reader.info().files, 4);
    let metadata = fs::read_to_string(bag.join("metadata.yaml")).unwrap();
    for (index, (first, count)) in [(0, 30), (30, 30), (60, 30), (90, 10)].into_iter().enumerate() {
        let file = BagReader::open(bag.join(format!("run_{index}.mcap"))).unwrap();
        assert_eq!(file.info().messages, count);
        assert_eq!(file.span(), Some((at(first), at(first + count - 1))));
        assert_eq!(file.topics()[0].definition.as_ref(), TaxelFrame::DEFINITION);
        let entry = format!(
            "    - path: \"run_{index}.mcap\"\n      starting_time:\n        nanoseconds_since_epoch: {}\n      duration:\n        nanoseconds: {}\n      message_count: {count}\n",
            at(first),
            at(first + count - 1) - at(first)
        );
        assert!(metadata.contains(&entry), "{entry}\n{metadata}");
    }
    assert_eq!(said(&bag), "run: sound (100 messages, 10 chunks, 4 files)");
    let message = reader.messages().next().unwrap().unwrap();
    assert_eq!((message.log_time, message.publish_time), (at(0), at(0) - 1000));
}

#[test]
fn files_are_split_by_size() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let options = BagOptions::default().compression(Compression::None).split_bytes(Some(4000));
    write(&bag, 200, &options);
    let reader = BagReader::open(&bag).unwrap();
    assert!(reader.info().files > 5, "{}", reader.info());
    assert_eq!(reader.messages().map(Result::unwrap).count(), 200);
    assert!(check(&bag).unwrap().is_sound());
}

#[test]
fn many_threads_record_in_order_and_nothing_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let recorder = Recorder::start(&bag, RecorderOptions::default()).unwrap();
    std::thread::scope(|scope| {
        for topic in 0..4 {
            let name = format!("/skin{topic}/taxels");
            let sink = recorder.topic(Topic { name, ..taxels() });
            scope.spawn(move || {
                for index in 0..500 {
                    assert!(sink.push(frame(index).to_cdr(), at(index), at(index)));
                }
            });
        }
    });
    let recorded = recorder.finish([("who".to_owned(), "a test".to_owned())]).unwrap();
    assert_eq!((recorded.state.messages, recorded.state.dropped), (2000, 0));
    assert_eq!(recorded.bag.custom["dropped"], "0");
    let reader = BagReader::open(&bag).unwrap();
    for topic in 0..4 {
        let frames = reader.read::<TaxelFrame>(&format!("/skin{topic}/taxels")).unwrap();
        assert!((0..500).eq(frames.map(|frame| frame.unwrap().message.sequence)));
    }
    assert!(check(&bag).unwrap().is_sound());
}

#[test]
fn what_does_not_fit_is_dropped_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let options = RecorderOptions::default().queue_bytes(100_000);
    let recorder = Recorder::start(&bag, options).unwrap();
    let sink = recorder.topic(taxels());
    let message = frame(0).to_cdr();
    let mut taken = 0;
    let mut tried = 0;
    while sink.dropped() < 10 {
        taken += u64::from(sink.push(message.clone(), at(0), at(0)));
        tried += 1;
        assert!(tried < 100_000_000, "the queue never fills");
    }
    let recorded = recorder.finish([]).unwrap();
    assert_eq!((recorded.state.messages, recorded.state.dropped), (taken, 10));
    assert_eq!((&*recorded.bag.custom["dropped"], &*recorded.bag.custom["dropped /taxels"]), ("10", "10"));
}

#[test]
fn a_chunk_does_not_wait_for_the_next_message() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let recorder = Recorder::start(&bag, RecorderOptions::default()).unwrap();
    let sink = recorder.topic(taxels());
    assert!(sink.push(frame(0).to_cdr(), at(0), at(0)));
    for _ in 0..200 {
        if BagReader::recover(&bag).is_ok_and(|reader| reader.info().messages == 1) {
            drop(recorder);
            assert!(matches!(BagReader::open(&bag).unwrap_err(), BagError::NoMetadata { .. }));
            return;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    panic!("the message is not on the disk after 10 s");
}

#[test]
fn what_is_wrong_is_said_with_its_place() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    write(&bag, 50, &BagOptions::default());
    let (yaml, file) = (bag.join("metadata.yaml"), bag.join("run_0.mcap"));
    let (text, bytes) = (fs::read_to_string(&yaml).unwrap(), fs::read(&file).unwrap());

    fs::write(&yaml, text.replace("message_count: 50", "message_count: 51")).unwrap();
    insta::assert_snapshot!(said(&bag), @"
    run/metadata.yaml: says 51 messages of run_0.mcap, which has 50
    run/metadata.yaml: says 51 messages, the files have 50
    run/metadata.yaml: says 51 messages on /taxels, the files have 50
    run: not sound (50 messages, 5 chunks, 1 files)
    ");
    fs::write(&yaml, text.replace("run_0.mcap", "run_7.mcap")).unwrap();
    insta::assert_snapshot!(said(&bag), @"
    run/metadata.yaml: names run/run_7.mcap, which is missing
    run/run_0.mcap: is not named in metadata.yaml: `ros2 bag` leaves it out
    run: not sound (0 messages, 0 chunks, 0 files)
    ");
    fs::write(&yaml, &text).unwrap();
    fs::write(&file, &bytes[..bytes.len() - 9]).unwrap();
    insta::assert_snapshot!(said(&bag), @"
    run/run_0.mcap: ends in the middle, after 50 whole messages
    run: not sound (50 messages, 5 chunks, 1 files)
    ");
    fs::write(&file, &bytes).unwrap();
    assert!(check(&bag).unwrap().is_sound());

    // Order, sequence and bytes.
    let bag = dir.path().join("odd");
    let mut writer = BagWriter::create(&bag).unwrap();
    let id = writer.declare(&taxels()).unwrap();
    for (index, time) in [(0, 1), (1, 0), (5, 2), (0, 3)] {
        writer.write_bytes(id, &frame(index).to_cdr(), at(time), at(time)).unwrap();
    }
    writer.write_bytes(id, &[0, 1, 0, 0, 9], at(4), at(4)).unwrap();
    writer.finish().unwrap();
    insta::assert_snapshot!(said(&bag), @"
    odd/odd_0.mcap: message on /taxels at 1742155052516165000 ns is stored after one at 1742155052526165000 ns
    odd/odd_0.mcap: note: /taxels lacks 3 frames before 1742155052536165000 ns
    odd/odd_0.mcap: note: the frames of /taxels count from 0 again at 1742155052546165000 ns
    odd/odd_0.mcap: message on /taxels at 1742155052556165000 ns: not a dermis_msgs/msg/TaxelFrame: Time.sec at byte 4 needs 4 bytes, 1 are left
    odd: not sound, and taxel frames are missing: /taxels 3 in 1 place (5 messages, 1 chunks, 1 files)
    ");
    let notes = check(&bag).unwrap().findings.iter().filter(|f| f.severity == Severity::Note).count();
    assert_eq!(notes, 2);
}

/// Notes are notes, however many: a bag that many frames are missing of is sound, and so is its repaired copy.
#[test]
fn many_notes_are_no_error() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut writer = BagWriter::create(&bag).unwrap();
    let id = writer.declare(&taxels()).unwrap();
    for index in 0..60 {
        // Every other pair is missing.
        let number = index / 2 * 4 + index % 2;
        writer.write_bytes(id, &frame(number).to_cdr(), at(index), at(index)).unwrap();
    }
    writer.finish().unwrap();
    let report = check(&bag).unwrap();
    assert!(report.is_sound(), "{report}");
    let said = said(&bag);
    let last: Vec<&str> = said.lines().rev().take(2).collect();
    assert_eq!(
        last,
        [
            "run: sound, but taxel frames are missing: /taxels 58 in 29 places (60 messages, 1 chunks, 1 files)",
            "run/run_0.mcap: note: 9 more of this kind: sequence",
        ]
    );
    assert_eq!(report.findings.len(), 21);

    // Errors and notes of one kind are distinguished, too: 30 errors stay an error.
    let mut writer = BagWriter::create(dir.path().join("bad")).unwrap();
    let id = writer.declare(&taxels()).unwrap();
    for index in 0..30 {
        writer.write_bytes(id, &[0, 1, 0, 0, 9], at(index), at(index)).unwrap();
    }
    writer.finish().unwrap();
    let report = check(dir.path().join("bad")).unwrap();
    assert!(!report.is_sound());
    assert_eq!(report.findings.last().unwrap().problem, "10 more of this kind: content");
}

/// Two skins on one topic count on their own, and what comes late or again is no loss.
#[test]
fn frames_are_counted_by_skin() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut writer = BagWriter::create(&bag).unwrap();
    for (time, (skin, number)) in
        [("a", 5), ("b", 90), ("a", 6), ("b", 91), ("a", 9), ("a", 8), ("b", 91)].into_iter().enumerate()
    {
        let header = dermis_msgs::std_msgs::msg::Header::new(at(number), "pad");
        let frame = TaxelFrame { skin: skin.into(), header, ..frame(number) };
        writer.write("/taxels", &frame, at(time as u64)).unwrap();
    }
    writer.finish().unwrap();
    insta::assert_snapshot!(said(&bag), @"
    run/run_0.mcap: note: /taxels lacks 2 frames before 1742155052556165000 ns
    run/run_0.mcap: note: frame 8 of /taxels is stored late, at 1742155052566165000 ns
    run/run_0.mcap: note: frame 91 of /taxels is there again at 1742155052576165000 ns
    run: sound, but taxel frames are missing: /taxels 1 in 1 place (7 messages, 1 chunks, 1 files)
    ");
}

/// What was lost on the way is in the bag, in its file, and in what is said of it; what is not known is not 0.
#[test]
fn losses_are_stored_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let recorder = Recorder::start(&bag, RecorderOptions::default()).unwrap();
    let known = recorder.topic(taxels());
    let unknown = recorder.topic(Topic { name: "/other".into(), ..taxels() });
    known.set_lost(Some(2));
    for number in [0, 1, 4, 7] {
        for sink in [&known, &unknown] {
            assert!(sink.push(frame(number).to_cdr(), at(number), at(number)));
        }
    }
    let recorded = recorder.finish([]).unwrap();
    assert_eq!(recorded.state.lost, Some(2));
    assert_eq!(recorded.state.topics[0].missing_frames, Some(4));
    assert_eq!(recorded.state.topics[1].lost, None);
    let custom = &recorded.bag.custom;
    assert_eq!((&*custom["lost"], &*custom["lost /taxels"], &*custom["lost /other"]), ("2", "2", "unknown"));
    let clause = "2 messages were lost while recording: /taxels 2; taxel frames are missing that were not published: /other 4, /taxels 2; whether messages were lost on the way is not known of /other";
    assert_eq!(recorded.state.losses().to_string(), clause);
    for path in [bag.clone(), bag.join("run_0.mcap")] {
        let report = check(&path).unwrap();
        assert!(report.is_sound() && !report.is_complete());
        assert_eq!(report.losses.unwrap().to_string(), clause);
    }
    assert!(recorded.bag.to_string().contains(&format!("losses    {clause}\n")), "{}", recorded.bag);
}

#[test]
fn a_damaged_chunk_costs_its_own_messages_only() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    write(&bag, 50, &BagOptions::default().compression(Compression::None));
    let file = bag.join("run_0.mcap");
    let mut bytes = fs::read(&file).unwrap();
    // In the values of frame 25: the third of five chunks.
    let needle = frame(25).to_cdr();
    let place = bytes.windows(needle.len()).position(|window| window == needle).unwrap();
    bytes[place + needle.len() - 3] ^= 1;
    fs::write(&file, bytes).unwrap();
    assert!(!check(&bag).unwrap().is_sound());

    let out = dir.path().join("mended");
    let repaired = repair(&bag, Some(&out), &BagOptions::default()).unwrap();
    assert_eq!((repaired.bag.messages, repaired.original), (40, None));
    let frames = BagReader::open(&out).unwrap().read::<TaxelFrame>("/taxels").unwrap();
    let sequences: Vec<u64> = frames.map(|frame| frame.unwrap().message.sequence).collect();
    assert!(sequences.into_iter().eq((0..20).chain(30..50)));
    assert!(check(&out).unwrap().is_sound());
}

#[test]
fn a_bag_is_repaired_where_it_lies_and_the_original_kept() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    write(&bag, 95, &BagOptions::default().split_ns(Some(300_000_000)));
    fs::remove_file(bag.join("metadata.yaml")).unwrap();
    let last = bag.join("run_3.mcap");
    let bytes = fs::read(&last).unwrap();
    // In the middle of its only chunk.
    fs::write(&last, &bytes[..300]).unwrap();
    let whole = BagReader::recover(&bag).unwrap().info().messages;
    assert_eq!(whole, 90);

    let repaired = repair(&bag, None, &BagOptions::default()).unwrap();
    assert_eq!((repaired.bag.messages, repaired.bag.path.as_path()), (whole, bag.as_path()));
    assert!(bag.join("run_0.mcap").exists() && check(&bag).unwrap().is_sound());
    assert!(repaired.original.unwrap().join("run_3.mcap").exists());
    let error = repair(&bag, None, &BagOptions::default()).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "run.damaged exists already: bags are never written over, give another name or remove it"
        ),
        "{error}"
    );
}

#[test]
fn a_slice_keeps_what_the_filter_takes() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut writer = BagWriter::create(&bag).unwrap();
    writer.set_custom("source", "a test");
    for index in 0..100 {
        writer.write("/taxels", &frame(index), at(index)).unwrap();
        writer.write("/truth", &Indentation::default(), at(index)).unwrap();
    }
    writer.finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    let filter = Filter::default().topics(["/taxels"]).between(at(10), at(30));
    let info = copy(&reader, dir.path().join("cut"), filter, &BagOptions::default(), []).unwrap();
    assert_eq!((info.messages, info.span, info.topics.len()), (20, Some((at(10), at(29))), 1));
    assert_eq!(info.custom["source"], "a test");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Whatever the messages, their times and the layout: all come back, stored as they came and played by time.
    #[test]
    fn bags_hold_what_they_were_given(
        messages in prop::collection::vec((0..3usize, prop::collection::vec(any::<u8>(), 4..200), 0..1_000_000_000i64), 0..200),
        split in prop::option::of(200..5000u64),
        compression in prop::sample::select(vec![Compression::None, Compression::Fast, Compression::Default]),
        chunk in 100..3000u64,
    ) {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("run");
        let mut options = BagOptions::default().compression(compression).split_bytes(split);
        options.chunk_bytes = chunk;
        let mut writer = BagWriter::create_with(&bag, &options).unwrap();
        let names = ["/a", "/b/c", "/b/d"];
        let ids = names.map(|name| writer.declare(&Topic { name: name.into(), ..taxels() }).unwrap());
        for (topic, data, time) in &messages {
            writer.write_bytes(ids[*topic], data, START + time, START).unwrap();
        }
        writer.finish().unwrap();
        let reader = BagReader::open(&bag).unwrap();
        let key = |message: dermis_bag::BagMessage| (message.log_time - START, message.topic, message.data);
        let stored: Vec<_> = reader.messages().map(|message| key(message.unwrap())).collect();
        let mut given: Vec<_> = messages
            .iter()
            .map(|(topic, data, time)| (*time, Arc::<str>::from(names[*topic]), data.clone()))
            .collect();
        prop_assert_eq!(&stored, &given);
        let played: Vec<_> =
            reader.messages_by_time(&Filter::default()).map(|message| key(message.unwrap())).collect();
        prop_assert!(played.is_sorted_by_key(|(time, ..)| *time));
        given.sort();
        let mut played = played;
        played.sort();
        prop_assert_eq!(played, given);
    }
}
