//! A data set takes as much memory as the samples that are kept of it, however long the recording is.
#![expect(clippy::unwrap_used, reason = "a test whose preparation fails should fail")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use dermis_bag::BagWriter;
use dermis_fixtures::SkinFile;
use dermis_inference::{Baseline, FeatureConfig};
use dermis_learn::{Dataset, DatasetOptions};
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
/// Frames with ground truth, whatever the length of the bag.
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

fn bag(dir: &Path, skin: &SkinDescription, frames: usize) -> PathBuf {
    let path = dir.join(format!("bag-{frames}"));
    let mut writer = BagWriter::create(&path).unwrap();
    for k in 0..frames {
        let stamp = BEGIN + k as i64 * STEP;
        let values = (0..CHANNELS).map(|i| ((k * 7919 + i * 104_729) % 1000) as f32).collect();
        let frame = skin.frame_message(&Frame::new(stamp, k as u64, values));
        writer.write("/wide/taxels", &frame, stamp).unwrap();
        if k < LABELLED {
            let contact = IndentationContact {
                position: Point { x: 0.001 * (k / 10) as f64, y: 0.0, z: 0.0 },
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

/// Bytes that lived at the same time, at most, while a bag was read and its inputs were made.
fn most(path: &Path, skin: &SkinDescription, memory: usize) -> usize {
    let before = NOW.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    // Less than a frame: the first one without ground truth must not borrow that of the last.
    let options = DatasetOptions { memory, tolerance: Some(0.004), ..DatasetOptions::default() };
    let data = Dataset::from_bags(&[path], skin, &options).unwrap();
    let config = FeatureConfig::newest(vec![0.0; CHANNELS], vec![1.0; CHANNELS]);
    let (ids, rows) = data.inputs(&config, Baseline::Raw).unwrap();
    assert_eq!((ids.len(), rows.len()), (LABELLED, LABELLED * CHANNELS));
    MOST.load(Ordering::Relaxed) - before
}

#[test]
fn memory_does_not_grow_with_the_length_of_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    let skin = skin();
    let (short, long) = (2_000, 8_000);
    let bags = [short, long].map(|frames| bag(dir.path(), &skin, frames));
    // The runtime's own caches.
    most(&bags[0], &skin, 0);
    let streamed = [most(&bags[0], &skin, 0), most(&bags[1], &skin, 0)];
    let held = most(&bags[1], &skin, usize::MAX);
    let more = long - short;
    let readings = more * CHANNELS * size_of::<f32>();
    println!("{streamed:?} bytes streamed, {held} held, {readings} of readings more");
    // Stamps, flags that are shared and the place for a label remain of a frame; 256 bytes are room for growing vectors.
    assert!(streamed[1] < streamed[0] + more * 256, "{streamed:?}");
    assert!(streamed[1] + readings < held, "{streamed:?} streamed, {held} held");
}
