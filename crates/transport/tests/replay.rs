//! Recordings replayed as bytes.

#![expect(clippy::unwrap_used, reason = "a panic in a test is its failure report")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dermis_msgs::msg::{Contact, TaxelFrame};
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::{Message, TypeSupport, v0};
use dermis_transport::framing::{DecodedFrame, FrameDecoder, NativeDecoder};
use dermis_transport::{Event, Source, SourceOptions, SourceUrl};

const START: i64 = 1_700_000_000_000_000_000;
const PATIENCE: Duration = Duration::from_secs(20);

fn frame(i: u64) -> TaxelFrame {
    TaxelFrame {
        header: Header::new(START + i64::try_from(i).unwrap() * 10_000_000, "palm"),
        sequence: i,
        values: vec![i as f32, f32::NAN, 0.25, -1e-6],
        ..TaxelFrame::default()
    }
}

struct Recording {
    writer: mcap::Writer<std::io::BufWriter<std::fs::File>>,
    channels: BTreeMap<String, u16>,
}

impl Recording {
    fn create(path: &Path) -> Self {
        let file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
        let writer = mcap::WriteOptions::new().chunk_size(Some(4096)).create(file).unwrap();
        Self { writer, channels: BTreeMap::new() }
    }

    fn write<T: Message>(&mut self, topic: &str, message: &T, log_time: i64) {
        let support = TypeSupport::of::<T>();
        let id = *self.channels.entry(topic.to_owned()).or_insert_with(|| {
            let schema =
                self.writer.add_schema(support.name, "ros2msg", support.definition.as_bytes()).unwrap();
            self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
        });
        let time = u64::try_from(log_time).unwrap();
        let header =
            mcap::records::MessageHeader { channel_id: id, sequence: 0, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &message.to_cdr()).unwrap();
    }

    fn finish(mut self) {
        self.writer.finish().unwrap();
    }
}

fn record(path: &Path, topic: &str, numbers: impl IntoIterator<Item = u64>) {
    let mut recording = Recording::create(path);
    recording.write("/skin/contact", &Contact::default(), START);
    for i in numbers {
        recording.write(topic, &frame(i), START + i64::try_from(i).unwrap() * 10_000_000);
    }
    recording.finish();
}

fn url(path: &Path, keys: &str) -> SourceUrl {
    SourceUrl::parse(&format!("replay://{}{keys}", path.display())).unwrap()
}

#[test]
fn a_recording_of_before_is_played() {
    let old = |i: u64| {
        let TaxelFrame { header, sequence, values, .. } = frame(i);
        let channels = vec!["a".into(), "b".into(), "c".into(), "d".into()];
        v0::msg::TaxelFrame { header, sequence, values, channels, unit: "Pa".into(), ..Default::default() }
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.mcap");
    let mut recording = Recording::create(&path);
    for i in 0..5 {
        recording.write("/skin/taxels", &old(i), START + i64::try_from(i).unwrap() * 1000);
    }
    recording.finish();
    let played = play(url(&path, "?speed=0"), SourceOptions::default(), usize::MAX);
    let sequences: Vec<u64> = played.frames.iter().map(|frame| frame.sequence).collect();
    assert_eq!(sequences, [0, 1, 2, 3, 4]);
    assert_eq!(played.frames[3].values[0], 3.0);
}

#[test]
fn a_skin_that_changes_in_the_middle_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.mcap");
    let mut recording = Recording::create(&path);
    for i in 0..5 {
        let layout_id = if i < 3 { 0xa } else { 0xb };
        let time = START + i64::try_from(i).unwrap() * 1000;
        recording.write("/skin/taxels", &TaxelFrame { layout_id, ..frame(i) }, time);
    }
    recording.finish();
    insta::assert_snapshot!(hide(&failure(url(&path, "?speed=0")), folder.path()), @"frame 3 on /skin/taxels of BAG/changed.mcap has the channel layout 0000000b where those before have 0000000a: the skin was changed in the middle");
}

struct Played {
    frames: Vec<DecodedFrame>,
    lost: u64,
    connected: Vec<String>,
    reasons: Vec<String>,
    dropped: u64,
}

fn play(url: SourceUrl, options: SourceOptions, most: usize) -> Played {
    let source = Source::open(url, options);
    let mut decoder = NativeDecoder::new(Some(4));
    let (mut frames, mut connected, mut reasons) = (Vec::new(), Vec::new(), Vec::new());
    let deadline = Instant::now() + PATIENCE;
    while frames.len() < most {
        assert!(Instant::now() < deadline, "{} frames, {reasons:?}", frames.len());
        match source.next_timeout(Duration::from_millis(100)) {
            Some(Event::Bytes { data, received_ns }) => decoder.push(&data, received_ns, &mut frames),
            Some(Event::Connected { description }) => connected.push(description),
            Some(Event::Disconnected { reason, .. }) => reasons.push(reason),
            Some(Event::Ended) => break,
            _ => {}
        }
    }
    assert_eq!(decoder.stats().rejected.total(), 0);
    Played { frames, lost: decoder.stats().lost, connected, reasons, dropped: source.stats().dropped_bytes }
}

fn failure(url: SourceUrl) -> String {
    let played = play(url, SourceOptions::default(), usize::MAX);
    assert_eq!(played.reasons.len(), 1, "{:?}", played.reasons);
    played.reasons[0].clone()
}

/// A message without the path of the temporary folder.
fn hide(text: &str, folder: &Path) -> String {
    text.replace(&*folder.to_string_lossy(), "BAG")
}

fn bag() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    std::fs::create_dir(&path).unwrap();
    (folder, path)
}

#[test]
fn a_split_recording_comes_back_whole_with_its_gaps_and_waits_for_a_slow_consumer() {
    let (_folder, path) = bag();
    std::fs::write(path.join("metadata.yaml"), "").unwrap();
    // More than ten parts, so that the order is not that of the letters; 50 and 51 were lost when it was recorded.
    for part in 0..12u64 {
        let numbers = (part * 100..(part + 1) * 100).filter(|i| !matches!(i, 50 | 51));
        record(&path.join(format!("run_{part}.mcap")), "/skin/taxels", numbers);
    }
    let options = SourceOptions::default().with_queue(1000, 4);
    let played = play(url(&path, "?speed=0"), options, usize::MAX);
    let numbers: Vec<u64> = played.frames.iter().map(|f| f.sequence).collect();
    assert_eq!(numbers, (0..1200).filter(|i| !matches!(i, 50 | 51)).collect::<Vec<_>>());
    assert_eq!((played.lost, played.dropped), (2, 0));
    for frame in &played.frames {
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&frame.values), bits(&self::frame(frame.sequence).values));
        let stamp_us = START as u64 / 1000 + frame.sequence * 10_000;
        assert_eq!(frame.device_time_us, Some(stamp_us));
    }
    let shown = path.display();
    assert_eq!(played.connected, [format!("recording {shown}, topic /skin/taxels, as fast as possible")]);
    assert!(played.reasons.is_empty());
}

#[test]
fn the_pace_is_the_recorded_one_times_the_speed() {
    let (_folder, path) = bag();
    let file = path.join("run_0.mcap");
    record(&file, "/skin/taxels", 0..41);
    // 0.4 s of recording.
    for (keys, seconds) in [("", 0.4), ("?speed=4", 0.1)] {
        let played = play(url(&file, keys), SourceOptions::default(), usize::MAX);
        let first = played.frames[0].received_ns;
        let spans: Vec<f64> = played.frames.iter().map(|f| (f.received_ns - first) as f64 / 1e9).collect();
        // Never early; late by what a busy machine makes of it.
        for (i, span) in spans.iter().enumerate() {
            let due = seconds * i as f64 / 40.0;
            assert!(*span > due - 0.02, "frame {i} of {keys} after {span} s, due after {due} s");
        }
        assert!(spans[40] < seconds + 2.0, "{} s instead of {seconds} s", spans[40]);
        let device = |i: usize| played.frames[i].device_time_us.unwrap();
        let rate = (device(40) - device(0)) as f64 / 1e6;
        assert!((rate - seconds).abs() < 1e-3, "the device clock runs with the pace: {rate} s");
    }
}

#[test]
fn a_loop_goes_on_counting() {
    let (_folder, path) = bag();
    record(&path.join("run_0.mcap"), "taxels", 5..15);
    let played = play(url(&path, "?speed=0&loop=true"), SourceOptions::default(), 35);
    let numbers: Vec<u64> = played.frames.iter().map(|f| f.sequence).collect();
    assert_eq!(numbers[..35], (5..40).collect::<Vec<_>>());
    let times: Vec<u64> = played.frames.iter().filter_map(|f| f.device_time_us).collect();
    assert!(times.windows(2).all(|w| w[1] == w[0] + 10_000), "the device clock never runs back");
    assert_eq!(played.frames[10].values[0], 5.0);
    assert_eq!(played.lost, 0);
}

#[test]
fn a_topic_is_chosen_or_must_be_given() {
    let (folder, path) = bag();
    let mut recording = Recording::create(&path.join("run_0.mcap"));
    for i in 0..3 {
        recording.write("/left/taxels", &frame(i), START);
        recording.write("/right/taxels", &frame(100 + i), START);
    }
    recording.finish();
    insta::assert_snapshot!(hide(&failure(url(&path, "?speed=0")), folder.path()), @"BAG/run holds frames on several topics, choose one with topic=…, or a skin with skin=…: /left/taxels, /right/taxels");
    insta::assert_snapshot!(hide(&failure(url(&path, "?topic=/palm/taxels")), folder.path()), @"BAG/run has no topic /palm/taxels of type dermis_msgs/msg/TaxelFrame; it has /left/taxels, /right/taxels");
    let played = play(url(&path, "?speed=0&topic=right/taxels"), SourceOptions::default(), usize::MAX);
    assert_eq!(played.frames.iter().map(|f| f.sequence).collect::<Vec<_>>(), [100, 101, 102]);
}

#[test]
fn two_skins_are_never_sent_as_one() {
    let (folder, path) = bag();
    let of = |skin: &str, i| TaxelFrame { skin: skin.into(), ..frame(i) };
    let mut recording = Recording::create(&path.join("run_0.mcap"));
    for i in 0..3 {
        recording.write("/taxels", &of("left_palm", i), START);
        recording.write("/taxels", &of("right_palm", 100 + i), START);
        recording.write("/foot/taxels", &of("foot", 200 + i), START);
        recording.write("/twice/taxels", &of("foot", 300 + i), START);
    }
    recording.finish();
    let refusal = |keys| hide(&failure(url(&path, keys)), folder.path());
    insta::assert_snapshot!(refusal("?speed=0&topic=/taxels"), @"topic /taxels of BAG/run/run_0.mcap carries frames of `left_palm` and of `right_palm`, choose one with skin=…");
    insta::assert_snapshot!(refusal("?speed=0&skin=foot"), @"BAG/run/run_0.mcap holds frames of skin `foot` on /foot/taxels and on /twice/taxels, choose one with topic=…");
    insta::assert_snapshot!(refusal("?speed=0&skin=arm"), @"BAG/run holds no frame of skin `arm`; it has those of `foot`, `left_palm`, `right_palm`");
    for (keys, first) in
        [("skin=right_palm", 100), ("skin=left_palm", 0), ("skin=foot&topic=/twice/taxels", 300)]
    {
        let played = play(url(&path, &format!("?speed=0&{keys}")), SourceOptions::default(), usize::MAX);
        let numbers: Vec<u64> = played.frames.iter().map(|f| f.sequence).collect();
        assert_eq!(numbers, [first, first + 1, first + 2], "{keys}");
    }
}

#[test]
fn what_is_no_recording_is_named() {
    let (folder, path) = bag();
    let hidden = |keys| hide(&failure(url(&path, keys)), folder.path());
    insta::assert_snapshot!(hidden(""), @"BAG/run is no recording: a rosbag2 folder holds .mcap files");
    let mut recording = Recording::create(&path.join("run_0.mcap"));
    recording.write("/contact", &Contact::default(), START);
    recording.finish();
    insta::assert_snapshot!(hidden(""), @"BAG/run holds no dermis_msgs/msg/TaxelFrame; its types are: dermis_msgs/msg/Contact");
    std::fs::write(path.join("run_0.mcap"), b"not a recording at all, but long enough for one").unwrap();
    insta::assert_snapshot!(hidden(""), @"BAG/run/run_0.mcap is damaged or cut off: Bad magic number");
    let gone = hide(&failure(url(&path.join("gone"), "")), folder.path());
    insta::assert_snapshot!(gone, @"cannot open the recording BAG/run/gone: No such file or directory (os error 2)");
}

#[test]
fn a_recording_cut_off_anywhere_is_played_as_far_as_it_goes() {
    let (_folder, path) = bag();
    let file = path.join("run_0.mcap");
    record(&file, "/skin/taxels", 0..500);
    let whole = std::fs::read(&file).unwrap();
    for part in [0.02, 0.3, 0.5, 0.9] {
        let end = (whole.len() as f64 * part) as usize;
        std::fs::write(&file, &whole[..end]).unwrap();
        let played = play(url(&file, "?speed=0"), SourceOptions::default(), usize::MAX);
        let numbers: Vec<u64> = played.frames.iter().map(|f| f.sequence).collect();
        assert_eq!(numbers, (0..numbers.len() as u64).collect::<Vec<_>>());
        if (0.3..0.9).contains(&part) {
            assert!(numbers.len() > 50, "{} frames of {part}", numbers.len());
        }
        assert!(played.reasons[0].contains("is damaged or cut off"), "{:?}", played.reasons);
    }
}

#[test]
fn a_flipped_byte_is_an_error_and_no_panic() {
    let (_folder, path) = bag();
    let file = path.join("run_0.mcap");
    record(&file, "/skin/taxels", 0..60);
    let whole = std::fs::read(&file).unwrap();
    for at in (0..whole.len()).step_by(whole.len() / 60) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x55;
        std::fs::write(&file, &damaged).unwrap();
        let source = Source::open(url(&file, "?speed=0"), SourceOptions::default());
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "byte {at} stops the replay for good");
            match source.next_timeout(Duration::from_millis(100)) {
                Some(Event::Disconnected { reason, .. }) => {
                    assert!(!reason.contains("panicked"), "byte {at}: {reason}");
                }
                Some(Event::Ended) => break,
                _ => {}
            }
        }
    }
}
