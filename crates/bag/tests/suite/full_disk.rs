//! A disk that is full, and has room again.
//!
//! Each test has a small file system of its own, which only root may mount; where that is not allowed, a test says so and
//! passes (what waits for room is tested with a made-up disk in `patience.rs` as well).

#![expect(clippy::unwrap_used, reason = "helpers of tests are not seen as tests")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use dermis_bag::{
    BagError, BagOptions, BagQos, BagReader, BagWriter, Compression, Filter, RecordedLosses, Recorder,
    RecorderOptions, RecorderState, Topic, check, copy, repair,
};
use dermis_msgs::{Message, TypeSupport, msg::TaxelFrame};

const PATIENCE: Duration = Duration::from_secs(30);
const START: i64 = 1_742_155_052_516_165_000;

/// A file system in memory of so many KiB, with everything on it gone at the end.
struct Disk {
    dir: tempfile::TempDir,
}

impl Disk {
    fn mount(kib: u64) -> Option<Self> {
        let dir = tempfile::tempdir().unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={kib}k"), "tmpfs"])
            .arg(dir.path())
            .output();
        if mounted.is_ok_and(|out| out.status.success()) {
            return Some(Self { dir });
        }
        eprintln!("skipped: a file system of one's own cannot be mounted here");
        None
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Takes all room but about so many KiB.
    fn fill(&self, leave_kib: usize) {
        let block = vec![0x55; 1024 * 4];
        let filler = self.path("filler");
        let mut file = fs::File::create(&filler).unwrap();
        while std::io::Write::write_all(&mut file, &block).is_ok() {}
        let length = file.metadata().unwrap().len();
        file.set_len(length.saturating_sub(leave_kib as u64 * 1024)).unwrap();
    }

    fn free(&self) {
        fs::remove_file(self.path("filler")).unwrap();
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Lazily: a test that failed may hold a file open.
        let _ = Command::new("umount").arg("-l").arg(self.dir.path()).status();
    }
}

fn frame(index: u64) -> TaxelFrame {
    TaxelFrame {
        skin: "pad".into(),
        sequence: index,
        values: (0..256).map(|i| (index * 31 + i) as f32).collect(),
        ..TaxelFrame::default()
    }
}

fn at(index: u64) -> i64 {
    START + i64::try_from(index).unwrap() * 1_000_000
}

fn taxels() -> Topic {
    Topic::of_type("/taxels", TypeSupport::of::<TaxelFrame>(), Some(BagQos::reliable(10)))
}

fn options(queue_bytes: usize) -> RecorderOptions {
    let bag = RecorderOptions::default().bag.compression(Compression::None);
    let mut options = RecorderOptions::default().bag(bag).queue_bytes(queue_bytes).wait_for_room(true);
    options.chunk_time = Duration::from_millis(10);
    options
}

fn until(what: &str, recorder: &Recorder, holds: impl Fn(&RecorderState) -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds(&recorder.state()) {
        assert!(Instant::now() < deadline, "not within {PATIENCE:?}: {what}: {:?}", recorder.state());
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn sequences(bag: &Path) -> Vec<u64> {
    let frames = BagReader::open(bag).unwrap().read::<TaxelFrame>("/taxels").unwrap();
    frames.map(|frame| frame.unwrap().message.sequence).collect()
}

#[test]
fn a_recorder_waits_for_room_and_goes_on_in_a_new_file() {
    let Some(disk) = Disk::mount(8192) else { return };
    let bag = disk.path("run");
    let recorder = Recorder::start(&bag, options(64 << 20)).unwrap();
    let sink = recorder.topic(taxels());
    sink.set_lost(Some(0));
    disk.fill(64);
    let mut sent = 0;
    while recorder.state().waits.is_none() {
        assert!(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
        sent += 1;
        assert!(sent < 1_000_000, "the disk never fills");
    }
    // What comes while it waits is kept.
    for _ in 0..100 {
        assert!(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
        sent += 1;
    }
    assert_eq!(recorder.state().waits, Some("the disk is full"));
    disk.free();
    until("it goes on", &recorder, |state| state.waits.is_none() && state.messages == sent);
    assert!(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
    let recorded = recorder.finish([]).unwrap();
    assert_eq!((recorded.state.messages, recorded.state.dropped), (sent + 1, 0));
    assert!(recorded.state.pauses >= 1 && recorded.state.paused_ms > 0, "{:?}", recorded.state);
    assert!(recorded.bag.files >= 2, "what was written before is a file of its own: {}", recorded.bag);
    assert!(recorded.bag.custom["waited for room"].contains("times"));
    assert!(sequences(&bag).into_iter().eq(0..=sent));
    assert!(check(&bag).unwrap().is_complete(), "{}", check(&bag).unwrap());
}

#[test]
fn what_does_not_fit_while_it_waits_is_counted() {
    let Some(disk) = Disk::mount(8192) else { return };
    let bag = disk.path("run");
    let recorder = Recorder::start(&bag, options(200_000)).unwrap();
    let sink = recorder.topic(taxels());
    sink.set_lost(Some(0));
    disk.fill(64);
    let (mut sent, mut taken) = (0, 0);
    while sink.dropped() < 50 || recorder.state().waits.is_none() {
        taken += u64::from(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
        sent += 1;
        assert!(sent < 10_000_000, "the queue never fills");
    }
    disk.free();
    until("it goes on", &recorder, |state| state.waits.is_none() && state.queued_bytes == 0);
    while !sink.push(frame(sent).to_cdr(), at(sent), at(sent)) {}
    (sent, taken) = (sent + 1, taken + 1);
    let recorded = recorder.finish([]).unwrap();
    let state = &recorded.state;
    assert_eq!((state.messages, state.messages + state.dropped >= sent), (taken, true), "{state:?}");
    let report = check(&bag).unwrap();
    assert!(report.is_sound() && !report.is_complete(), "{report}");
    // The numbers of the frames say the same.
    assert_eq!(report.missing_frames["/taxels"].frames, sent - taken, "{report}");
    let said = format!("{} messages were lost while recording: /taxels {}", state.dropped, state.dropped);
    assert!(report.to_string().contains(&said), "{report}");
}

#[test]
fn ending_while_the_disk_is_full_says_what_was_not_written() {
    let Some(disk) = Disk::mount(4096) else { return };
    let bag = disk.path("run");
    let recorder = Recorder::start(&bag, options(64 << 20)).unwrap();
    let (sink, state) = (recorder.topic(taxels()), recorder.watch());
    let mut sent = 0;
    while sent < 20 {
        assert!(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
        sent += 1;
    }
    until("these are on the disk", &recorder, |state| state.messages == 20 && state.stored_bytes > 20_000);
    disk.fill(64);
    while recorder.state().waits.is_none() {
        assert!(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
        sent += 1;
    }
    let error = recorder.finish([]).unwrap_err();
    assert!(matches!(&error, BagError::Full { .. }) && error.is_no_room(), "{error}");
    let state = state();
    assert_eq!(state.messages + state.dropped, sent, "{state:?}");
    disk.free();
    let whole = BagReader::recover(&bag).unwrap().info().messages;
    assert!(
        state.messages >= 20 && whole >= state.messages,
        "{whole} are whole of what is said to be recorded: {state:?}"
    );
    repair(&bag, None, &BagOptions::default()).unwrap();
    assert!(sequences(&bag).into_iter().eq(0..whole));
}

/// A bag of about 1 MiB that was interrupted.
fn interrupted(bag: &Path) {
    let mut writer =
        BagWriter::create_with(bag, &BagOptions::default().compression(Compression::None)).unwrap();
    let id = writer.declare(&taxels()).unwrap();
    for index in 0..1000 {
        writer.write_bytes(id, &frame(index).to_cdr(), at(index), at(index)).unwrap();
    }
    writer.finish().unwrap();
    fs::remove_file(bag.join("metadata.yaml")).unwrap();
}

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_repair_on_a_full_disk_leaves_nothing_behind() {
    let Some(disk) = Disk::mount(4096) else { return };
    let bag = disk.path("run");
    interrupted(&bag);
    disk.fill(300);
    let none = BagOptions::default().compression(Compression::None);
    let error = repair(&bag, None, &none).unwrap_err();
    assert!(matches!(error, BagError::NoRoom { .. }), "{error}");
    let error = repair(&bag, Some(&disk.path("out")), &none).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "/out: the disk is full; what was written of it is removed again: make room and try again"
        ),
        "{error}"
    );
    fs::create_dir(disk.path("empty")).unwrap();
    let reader = BagReader::recover(&bag).unwrap();
    let copied = copy(&reader, disk.path("empty"), Filter::default(), &none, []);
    assert!(matches!(copied.unwrap_err(), BagError::NoRoom { .. }));
    assert_eq!(names(disk.dir.path()), ["empty", "filler", "run"]);
    assert_eq!(names(&disk.path("empty")), Vec::<String>::new());
    disk.free();
    repair(&bag, None, &none).unwrap();
    assert_eq!(sequences(&bag).len(), 1000);
    assert_eq!(names(disk.dir.path()), ["empty", "run", "run.damaged"]);
}

#[test]
fn an_interrupted_repair_does_not_block_the_next() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    interrupted(&path("run"));
    // Killed while the new bag was written.
    fs::create_dir(path(".run.repairing")).unwrap();
    fs::write(path(".run.repairing").join("run_0.mcap"), "half of it").unwrap();
    repair(path("run"), None, &BagOptions::default()).unwrap();
    assert_eq!(names(dir.path()), ["run", "run.damaged"]);

    // Killed between the two renames: the bag has no name for a moment.
    fs::rename(path("run"), path(".run.repairing")).unwrap();
    let repaired = repair(path("run"), None, &BagOptions::default()).unwrap();
    assert_eq!(repaired.original, Some(path("run.damaged").canonicalize().unwrap()));
    assert_eq!(names(dir.path()), ["run", "run.damaged"]);
    assert!(check(path("run")).unwrap().is_sound());
}

#[test]
fn a_folder_of_somebody_else_is_never_removed() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    interrupted(&bag);
    let reader = BagReader::recover(&bag).unwrap();
    let theirs = dir.path().join("theirs");
    fs::create_dir(&theirs).unwrap();
    fs::write(theirs.join("thesis.tex"), "years of work").unwrap();
    let file = dir.path().join("file");
    fs::write(&file, "a file").unwrap();
    for out in [&theirs, &file] {
        assert!(copy(&reader, out, Filter::default(), &BagOptions::default(), []).is_err());
    }
    assert_eq!(
        (names(&theirs), fs::read_to_string(&file).unwrap()),
        (vec!["thesis.tex".into()], "a file".into())
    );
}

#[test]
fn an_interrupted_recording_still_tells_what_it_lacks() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let recorder = Recorder::start(&bag, options(64 << 20)).unwrap();
    let sink = recorder.topic(taxels());
    sink.set_lost(Some(7));
    let deadline = Instant::now() + PATIENCE;
    let mut sent = 0;
    // Noted in the file some seconds after it is known.
    let noted = loop {
        assert!(sink.push(frame(sent).to_cdr(), at(sent), at(sent)));
        sent += 1;
        let reader = BagReader::recover(&bag);
        let losses = reader.ok().and_then(|reader| RecordedLosses::of(reader.custom()));
        if let Some(losses) = losses {
            break losses;
        }
        assert!(Instant::now() < deadline, "not noted within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!(noted.topics["/taxels"].lost, Some(7));
    drop(recorder);
    repair(&bag, None, &BagOptions::default()).unwrap();
    let report = check(&bag).unwrap().to_string();
    assert!(report.contains("sound, but 7 messages were lost while recording: /taxels 7"), "{report}");
    assert!(BagReader::open(&bag).unwrap().info().to_string().contains("losses    7 messages were lost"));
}
