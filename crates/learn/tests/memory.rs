//! What a data set takes in memory: an index of so many bytes a frame and a true contact, of so many frames at most, and no readings.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use dermis_bag::{BagOptions, BagWriter};
use dermis_fixtures::SkinFile;
use dermis_inference::{Baseline, FeatureConfig};
use dermis_learn::{Dataset, DatasetOptions, FrameInfo, TruthContact};
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
use dermis_msgs::msg::{Contact, Indentation, IndentationContact};
use dermis_msgs::std_msgs::msg::Header;
use dermis_skin::{Frame, SkinDescription};

/// Counts what lives.
struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: it hands everything on to the system's allocator, and only counts.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(now, Ordering::Relaxed);
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const CHANNELS: usize = 200;
const STEP: i64 = 10_000_000;
const BEGIN: i64 = 1_700_000_000_000_000_000;
/// Frames with ground truth where not all have it, whatever the length of the bag. Every other five of them are touched.
const LABELLED: usize = 60;

fn skin() -> SkinDescription {
    SkinFile::new("wide")
        .taxels((0..CHANNELS).map(|i| (format!("t{i}"), [i as f64 * 1e-4, 0.0, -0.005])))
        .tables(
            "[condition]
tare_duration = 0.03
",
        )
        .read()
}

fn bag(dir: &Path, skin: &SkinDescription, (frames, labelled): (usize, usize), chunk: u64) -> PathBuf {
    let path = dir.join(format!("bag-{frames}-{labelled}-{chunk}"));
    let mut options = BagOptions::default();
    options.chunk_bytes = chunk;
    let mut writer = BagWriter::create_with(&path, &options).unwrap();
    for k in 0..frames {
        let stamp = BEGIN + k as i64 * STEP;
        let values = (0..CHANNELS).map(|i| ((k * 7919 + i * 104_729) % 1000) as f32).collect();
        let frame = skin.frame_message(&Frame::new(stamp, k as u64, values));
        writer.write("/wide/taxels", &frame, stamp).unwrap();
        if k < labelled {
            let contact = IndentationContact {
                position: Point { x: 0.001 * (k / 10 % 20) as f64, y: 0.0, z: 0.0 },
                normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
                force: Vector3 { x: 0.0, y: 0.0, z: -1.0 },
                force_components: Contact::FORCE_FULL,
                ..Default::default()
            };
            let truth = Indentation {
                header: Header { stamp: Time::from_nanos(stamp), frame_id: "wide_link".into() },
                skin: "wide".into(),
                press: (k / 10) as u64,
                location: (k / 10) as u32,
                contacts: if k % 10 < 5 { Vec::new() } else { vec![contact] },
                ..Default::default()
            };
            writer.write("/wide/ground_truth", &truth, stamp).unwrap();
        }
    }
    writer.finish().unwrap();
    path
}

/// Bytes that a bag's data set takes once it is read, and most that lived at the same time while it was read.
fn taken(path: &Path, skin: &SkinDescription, memory: usize) -> [usize; 2] {
    taken_by(path, skin, &DatasetOptions { memory, ..options() })
}

fn options() -> DatasetOptions {
    // Less than a frame: the first one without ground truth must not borrow that of the last.
    DatasetOptions { tolerance: Some(0.004), ..DatasetOptions::default() }
}

fn taken_by(path: &Path, skin: &SkinDescription, options: &DatasetOptions) -> [usize; 2] {
    let before = NOW.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    let data = Dataset::from_bags(&[path], skin, options).unwrap();
    let taken = [&NOW, &MOST].map(|bytes| bytes.load(Ordering::Relaxed) - before);
    drop(data);
    taken
}

/// Most that lived while inputs were made of the frames that have ground truth.
fn most_for_inputs(path: &Path, skin: &SkinDescription) -> usize {
    let options = DatasetOptions { memory: 0, ..options() };
    let data = Dataset::from_bags(&[path], skin, &options).unwrap();
    let config = FeatureConfig::newest(vec![0.0; CHANNELS], vec![1.0; CHANNELS]);
    let before = NOW.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    let (ids, rows) = data.inputs(&config, Baseline::Raw).unwrap();
    assert_eq!((ids.len(), rows.len()), (LABELLED, LABELLED * CHANNELS));
    MOST.load(Ordering::Relaxed) - before
}

/// One test, because allocations of another would be counted.
#[test]
fn a_frame_takes_its_entry_of_the_index() {
    let dir = tempfile::tempdir().unwrap();
    let skin = skin();
    let (few, many) = (2_000, 8_000);
    let more = many - few;
    // A reader holds one chunk, which must not hide what frames take.
    let [short, long, full] = [(few, LABELLED), (many, LABELLED), (many, many)]
        .map(|counts| bag(dir.path(), &skin, counts, 32 << 10));
    // The runtime's own caches.
    taken(&short, &skin, 0);
    // Texts with longer numbers, and the index of the bag's chunks.
    let slack = 16 << 10;

    // What is said of it in docs/training.md, "Memory".
    assert_eq!((size_of::<FrameInfo>(), size_of::<TruthContact>()), (72, 88));
    let [of_short, of_long, of_full] = [&short, &long, &full].map(|path| taken(path, &skin, 0));
    println!("{of_short:?} {of_long:?} {of_full:?} bytes kept, and at most");
    // A frame is an entry of the index.
    assert!(of_long[0] - of_short[0] <= more * 72 + slack, "{of_short:?} {of_long:?}");
    // While the bag is read, its mark (32) lies beside that, in a vector that doubles.
    let doubled = |n: usize| n.next_power_of_two();
    let marks = 32 * (doubled(many) - doubled(few));
    assert!(of_long[1] - of_short[1] <= more * 72 + marks + slack, "{of_short:?} {of_long:?}");
    // Of a label, the contacts are more; while the bag is read, the message that it came of, and its contacts, lie beside that.
    let touched = (many - LABELLED) / 2;
    let messages = 48 * (doubled(many) - doubled(LABELLED));
    assert!(of_full[0] - of_long[0] <= touched * 88 + slack, "{of_long:?} {of_full:?}");
    assert!(of_full[1] - of_long[1] <= messages + touched * 2 * 88 + slack, "{of_long:?} {of_full:?}");

    // Readings are in memory where they may be, and else only those that inputs are made of.
    let readings = more * CHANNELS * size_of::<f32>();
    let held = taken(&long, &skin, usize::MAX)[0];
    assert!(of_long[0] + readings < held, "{of_long:?} streamed, {held} held");
    let inputs = [&short, &long].map(|path| most_for_inputs(path, &skin));
    assert!(inputs[1] <= inputs[0] + slack, "{inputs:?}");
    long_bags_take_no_more(dir.path(), &skin);
}

/// Beyond the bound on frames, a bag of four times the length takes the same memory, within 3 percent: what is left is the index of
/// the bag's chunks.
fn long_bags_take_no_more(dir: &Path, skin: &SkinDescription) {
    let most_frames = 500;
    let [short, long] = [8_000, 32_000].map(|frames| bag(dir, skin, (frames, frames), 256 << 10));
    let options = DatasetOptions { memory: 0, most_frames, ..options() };
    let [of_short, of_long] = [&short, &long].map(|path| taken_by(path, skin, &options));
    println!("{of_short:?} {of_long:?} bytes kept of thinned bags, and at most");
    for (short, long) in of_short.into_iter().zip(of_long) {
        assert!(long * 100 <= 103 * short, "{of_short:?} {of_long:?}");
    }
    // Of a frame, its entry, its contact, and a stretch of untouched ones; besides, the skin.
    assert!(of_long[0] <= most_frames * (72 + 88 + 12) + (48 << 10), "{of_long:?}");
    // So do the rows that networks are fitted to, and passes over the frames.
    let config = FeatureConfig::newest(vec![0.0; CHANNELS], vec![1.0; CHANNELS]);
    let passes = [&short, &long].map(|path| {
        let data = Dataset::from_bags(&[path], skin, &options).unwrap();
        let before = NOW.load(Ordering::Relaxed);
        MOST.store(before, Ordering::Relaxed);
        let (ids, rows) = data.inputs(&config, Baseline::Raw).unwrap();
        assert!(ids.len() <= most_frames && rows.len() == ids.len() * CHANNELS);
        MOST.load(Ordering::Relaxed) - before
    });
    println!("{passes:?} bytes at most while inputs are made");
    assert!(passes[1] * 100 <= 103 * passes[0], "{passes:?}");
}
