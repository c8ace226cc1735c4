//! Devices that are read over their lines.

use std::sync::Arc;
use std::time::{Duration, Instant};

use dermis_bag::BagReader;
use dermis_model::ForwardModel;
use dermis_msgs::msg::TaxelFrame;
use dermis_skin::{Frame, SkinDescription, Stamp};
use dermis_transport::framing::{DecodedFrame, FrameDecoder, NativeDecoder};
use dermis_transport::{Event, Source, SourceOptions, SourceUrl};

use super::script::{ROUNDS, Script, lock};
use super::*;
use dermis_fixtures::SkinFile;

use crate::testing::{self, shared_bumps};
use crate::{CollectOptions, Plan, collect};

const PATIENCE: Duration = Duration::from_secs(20);

/// Waits until `done` says so.
fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !done() {
        assert!(begin.elapsed() < PATIENCE, "waited for {what} in vain");
        std::thread::park_timeout(Duration::from_millis(2));
    }
}

struct Reader {
    source: Source,
    decoder: NativeDecoder,
    frames: Vec<DecodedFrame>,
}

impl Reader {
    fn open(url: &str) -> Self {
        let url = SourceUrl::parse(url).unwrap();
        Self {
            source: Source::open(url, SourceOptions::default()),
            decoder: NativeDecoder::new(Some(3)),
            frames: Vec::new(),
        }
    }

    /// Reads on until there are `count` frames, or `false` where the line goes down.
    fn read(&mut self, count: usize) -> bool {
        let begin = Instant::now();
        while self.frames.len() < count {
            assert!(begin.elapsed() < PATIENCE, "only {} frames came", self.frames.len());
            match self.source.next_timeout(Duration::from_millis(100)) {
                Some(Event::Bytes { data, received_ns }) => {
                    self.decoder.push(&data, received_ns, &mut self.frames);
                }
                Some(Event::Disconnected { .. } | Event::Ended) => return false,
                _ => {}
            }
        }
        true
    }
}

fn check_readings(device: &VirtualDevice, model: &Arc<dyn ForwardModel>, frames: &[DecodedFrame], rate: f64) {
    let mut clean = vec![0.0; 3];
    let mut touched = 0;
    for pair in frames.windows(2) {
        assert_eq!(pair[1].sequence, pair[0].sequence + 1);
    }
    for frame in frames {
        let t = frame.sequence as f64 / rate;
        assert_eq!(frame.device_time_us, Some(1 + (t * 1e6).round() as u64));
        let stamp = device.script.start + (t * 1e9).round() as Stamp;
        let truth = device.truth(stamp).unwrap();
        touched += usize::from(!truth.stimulus.contacts.is_empty());
        model.response(&truth.stimulus, &mut clean).unwrap();
        for (value, clean) in frame.values.iter().zip(&clean) {
            assert!((f64::from(*value) - clean).abs() < 6.0 * 2.0, "{value} for {clean} at {t} s");
        }
    }
    assert!(touched > 5, "only {touched} of {} frames were touched", frames.len());
}

#[test]
fn bytes_decode_to_what_the_model_reads() {
    let skin = testing::skin(500.0);
    let model = shared_bumps(&skin);
    let device = VirtualDevice::start(Arc::clone(&model), &skin, &testing::plan(), 9, &Outlet::Pty).unwrap();
    let mut reader = Reader::open(device.url());
    assert!(reader.read(300));
    check_readings(&device, &model, &reader.frames, 500.0);
    // In real time: 300 frames at 500 Hz took at least as long as they last.
    let (first, last) = (&reader.frames[0], &reader.frames[299]);
    let measured = (last.sequence - first.sequence) as f64 / 500.0;
    assert!(device.script.at(measured).unwrap().is_some());
    assert!(last.received_ns >= device.script.start + (last.sequence as f64 / 500.0 * 1e9) as Stamp);

    let label = device.truth_message(device.script.start + 1_000_000_000).unwrap();
    assert_eq!(label.session, "all-kinds/9");
    assert_eq!(device.truth(device.script.start - 1), None);

    let stats = device.stop().unwrap();
    assert!(stats.frames >= 300);
    // The frames that the line could not take are missing whole.
    assert_eq!(reader.decoder.stats().rejected.total(), 0);
    assert!(!reader.read(usize::MAX), "the line stayed up after the plug was pulled");
}

#[test]
fn rounds_go_on_for_ever_and_differ() {
    let skin = testing::skin(100.0);
    let script = Script::new(testing::plan(), shared_bumps(&skin), 5).unwrap();
    let length = lock(&script.rounds).last[0].1.duration();
    let first = script.at(0.25).unwrap().unwrap();
    let mut t = 0.25;
    for _ in 0..9 {
        t += length;
        assert!(script.at(t).unwrap().is_some());
    }
    assert_eq!(lock(&script.rounds).last.len(), ROUNDS);
    assert_eq!(script.at(0.25).unwrap(), None, "what is forgotten is not made up");
    let fresh = Script::new(testing::plan(), shared_bumps(&skin), 5).unwrap();
    assert_eq!(fresh.at(0.25).unwrap().unwrap(), first);
}

#[test]
fn the_truth_holds_what_effects_do_to_what_touches() {
    let skin = testing::skin(100.0);
    let device = VirtualDevice::start(shared_bumps(&skin), &skin, &testing::plan(), 1, &Outlet::Pty).unwrap();
    let (mut still, mut dragged) = (0, 0);
    for i in 0..3000 {
        let moment = device.truth(device.script.start + i64::from(i) * 5_000_000).unwrap();
        for contact in &moment.stimulus.contacts {
            let along = contact.force.x.hypot(contact.force.y);
            if moment.phase == crate::Phase::Hold {
                assert_eq!(along, 0.0);
                still += 1;
            } else if (along - 0.05).abs() < 1e-12 {
                assert!(moment.phase == crate::Phase::Slide || moment.phase == crate::Phase::Unload);
                dragged += 1;
            }
        }
    }
    assert!(still > 50 && dragged > 10, "{still} still, {dragged} dragged");
    device.stop().unwrap();
}

#[test]
fn nobody_has_to_read() {
    let skin = testing::skin(2000.0);
    let device = VirtualDevice::start(shared_bumps(&skin), &skin, &testing::plan(), 1, &Outlet::Pty).unwrap();
    wait_for("a full line", || device.stats().dropped > 10);
    assert!(device.running());
    drop(device);
}

#[test]
fn tcp_serves_one_client_after_another() {
    let skin = testing::skin(500.0);
    let model = shared_bumps(&skin);
    let outlet = Outlet::Tcp("127.0.0.1:0".parse().unwrap());
    let device = VirtualDevice::start(Arc::clone(&model), &skin, &testing::plan(), 2, &outlet).unwrap();
    for _ in 0..2 {
        let mut reader = Reader::open(device.url());
        assert!(reader.read(150));
        check_readings(&device, &model, &reader.frames, 500.0);
    }
}

#[test]
fn a_link_comes_and_goes_with_the_device() {
    let dir = tempfile::tempdir().unwrap();
    let link = dir.path().join("pad");
    let skin = testing::skin(100.0);
    let outlet = Outlet::PtyLink(link.clone());
    let device = VirtualDevice::start(shared_bumps(&skin), &skin, &testing::plan(), 1, &outlet).unwrap();
    assert_eq!(device.url(), format!("pty://{}", link.display()));
    assert!(Reader::open(device.url()).read(5));
    device.stop().unwrap();
    assert!(!link.exists() && std::fs::symlink_metadata(&link).is_err());
}

#[test]
fn raw_counts_are_what_the_description_says() {
    let mut skin = testing::skin(100.0);
    (skin.wire.scale, skin.wire.offset) = (0.25, 100.0);
    let frame = |sequence: u64, values: [f32; 3]| Frame::new(0, sequence, values.to_vec());
    let encode = |skin: &SkinDescription, frame: Frame| {
        plain_encoder(skin).unwrap().encode(&frame, 8).unwrap().to_vec()
    };
    let mut decoded = Vec::new();
    NativeDecoder::new(Some(3)).push(&encode(&skin, frame(7, [100.0, 101.0, f32::NAN])), 0, &mut decoded);
    assert_eq!(decoded[0].values[..2], [0.0, 4.0]);
    assert!(decoded[0].values[2].is_nan());
    skin.wire.protocol = dermis_skin::WireProtocol::Ascii;
    assert_eq!(encode(&skin, frame(7, [100.0, 101.0, 99.5])), b"0,4,-2\n");
    skin.wire.counts = Some([0, 3]);
    assert_eq!(encode(&skin, frame(7, [99.99, 100.6, 101.0])), b"0,2,3\n");
}

#[test]
fn a_recording_is_sent_bit_by_bit() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let skin = testing::skin(200.0);
    let report =
        collect(&shared_bumps(&skin), &skin, &testing::plan(), &bag, &CollectOptions::default()).unwrap();
    let options = ReplayOptions { speed: f64::INFINITY, ..ReplayOptions::default() };
    let device = ReplayDevice::start(&bag, &skin, &options).unwrap();
    let mut reader = Reader::open(device.url());
    assert!(reader.read(report.frames as usize));
    wait_for("the end of the recording", || device.finished());
    let recorded = BagReader::open(&bag).unwrap();
    for (sent, frame) in recorded.read::<TaxelFrame>("taxels").unwrap().zip(&reader.frames) {
        let sent = sent.unwrap().message;
        assert_eq!((sent.sequence, sent.device_time_us), (frame.sequence, frame.device_time_us.unwrap()));
        assert!(sent.values.iter().zip(&frame.values).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
    assert_eq!(device.stop().unwrap().frames, report.frames);
}

#[test]
fn a_recording_keeps_its_pace() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let skin = testing::skin(100.0);
    let plan = testing::PLAN.split("[[steps]]").take(2).collect::<Vec<_>>().join("[[steps]]");
    let plan = Plan::from_toml(&plan, "idle.toml").unwrap();
    collect(&shared_bumps(&skin), &skin, &plan, &bag, &CollectOptions::default()).unwrap();
    let begin = Instant::now();
    let device =
        ReplayDevice::start(&bag, &skin, &ReplayOptions { speed: 0.5, ..ReplayOptions::default() }).unwrap();
    wait_for("the end of the recording", || device.finished());
    // 20 frames of 10 ms: the last is due 190 ms after the first, at half the pace after 380 ms.
    assert!(begin.elapsed() >= Duration::from_millis(380));
}

#[test]
fn a_replay_that_nobody_reads_can_be_stopped() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let skin = testing::skin(200.0);
    collect(&shared_bumps(&skin), &skin, &testing::plan(), &bag, &CollectOptions::default()).unwrap();
    let options = ReplayOptions { speed: f64::INFINITY, ..ReplayOptions::default() };
    let device = ReplayDevice::start(&bag, &skin, &options).unwrap();
    let mut sent = 0;
    wait_for("a full line", || std::mem::replace(&mut sent, device.stats().frames) == sent && sent > 10);
    assert!(!device.finished());
    device.stop().unwrap();
}

#[test]
fn recordings_of_other_skins_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let skin = testing::skin(200.0);
    collect(&shared_bumps(&skin), &skin, &testing::plan(), &bag, &CollectOptions::default()).unwrap();
    let other =
        SkinFile::new("other").set("sensor", "\"bumps\"").taxels([("only", [0.0, 0.0, -0.005])]).read();
    let refused = |skin: &SkinDescription, options: &ReplayOptions| {
        let error = ReplayDevice::start(&bag, skin, options).unwrap_err().to_string();
        error.replace(&bag.display().to_string(), "BAG")
    };
    insta::assert_snapshot!(refused(&other, &ReplayOptions::default()), @"bag BAG: its frames are of skin `pad`, and not as `other` sends them: frame 0 has 3 values where the skin has 1 channels");
    let still = ReplayOptions { speed: 0.0, ..ReplayOptions::default() };
    insta::assert_snapshot!(refused(&skin, &still), @"bag BAG: replay speed is 0 and must be positive");
}
