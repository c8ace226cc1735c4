//! Bags with more frames than are indexed.

use super::*;

/// Frames from one press to the next, and those of a press: an odd number, so that steps meet all parts of a press.
const PERIOD: i64 = 37;
const TOUCHED: i64 = 9;

/// In which order things lie in a bag.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Layout {
    Interleaved,
    /// Ground truth behind all frames.
    Apart,
    /// Frames and ground truth out of order, and the latter behind.
    Shuffled,
}

/// `frames` frames with ground truth at twice their rate; one is lost, and some have no ground truth.
fn recording(dir: &Path, frames: i64, layout: Layout) -> PathBuf {
    let path = dir.join(format!("{layout:?}"));
    let mut messages: Vec<(i64, Result<TaxelFrame, Indentation>)> = Vec::new();
    for k in 0..frames {
        let touched = k % PERIOD >= PERIOD - TOUCHED;
        let at = |half: i64| k * STEP + half * STEP / 2;
        let value = 100.0 + (k % 11) as f32 * 0.1 + if touched { 20.0 } else { 0.0 };
        // Frame 77 was lost.
        let place = match layout {
            Layout::Shuffled => 10 * (k - k % 7 + (3 * k + 2) % 7),
            _ => 10 * k,
        };
        if k != 77 {
            messages.push((place, Ok(frame(at(0), k as u64, vec![value, 50.0 + value]))));
        }
        for half in 0..2 {
            let contacts = [(0.0001 * (k / PERIOD) as f64, 1.0 + (k % PERIOD) as f64 * 0.1)];
            let mut said = truth(at(half), (k / PERIOD) as u64, if touched { &contacts } else { &[] });
            said.phase = if touched { Indentation::PHASE_HOLD } else { Indentation::PHASE_IDLE };
            let behind = match layout {
                Layout::Interleaved => 1 + half,
                Layout::Apart => 20 * frames,
                Layout::Shuffled => 405 - 3 * half,
            };
            if !(200..220).contains(&k) {
                messages.push((place + behind, Err(said)));
            }
        }
    }
    messages.sort_by_key(|(place, _)| *place);
    let mut writer = BagWriter::create(&path).unwrap();
    for (k, (_, message)) in messages.iter().enumerate() {
        let log = BEGIN + k as i64 * STEP;
        match message {
            Ok(frame) => writer.write("/pad/taxels", frame, log).unwrap(),
            Err(truth) => writer.write("/pad/ground_truth", truth, log).unwrap(),
        }
    }
    writer.finish().unwrap();
    path
}

fn read(path: &Path, most_frames: usize, memory: usize) -> Dataset {
    let options = DatasetOptions { most_frames, memory, tolerance: Some(0.004), ..DatasetOptions::default() };
    Dataset::from_bags(&[path], &skin(), &options).unwrap()
}

#[test]
fn a_thinned_run_is_the_whole_one_with_fewer_labels() {
    let dir = tempfile::tempdir().unwrap();
    for layout in [Layout::Interleaved, Layout::Apart, Layout::Shuffled] {
        let path = recording(dir.path(), 1000, layout);
        let whole = read(&path, 999, MEMORY);
        let of_whole = &whole.runs()[0];
        assert_eq!((of_whole.frames(), of_whole.every(), of_whole.samples.len()), (999, 1, 999));
        assert_eq!((whole.locations(), of_whole.lost, of_whole.tares()), (27, 1, 27));
        let all = samples(&whole);
        for memory in [0, MEMORY] {
            let thinned = read(&path, 200, memory);
            let run = &thinned.runs()[0];
            assert_eq!((run.frames(), run.every(), run.lost, run.tares()), (999, 6, 1, 27));
            assert!((166..=200).contains(&run.samples.len()), "{}", run.samples.len());
            assert_eq!((&run.hash, thinned.locations()), (&of_whole.hash, 27));
            for sample in &run.samples {
                // NaN is not equal to itself.
                let same = &of_whole.samples[sample.number as usize];
                assert_eq!(format!("{sample:?}"), format!("{same:?}"), "{layout:?}");
            }
            // Zeros are those of all frames, and so is history.
            let streamed = samples(&thinned);
            assert_eq!(streamed.len(), 999);
            for (k, (a, b)) in all.iter().zip(&streamed).enumerate() {
                let known = thinned.sample(SampleId { run: 0, sample: k }).is_some();
                let a = Sample { truth: a.truth.clone().filter(|_| known), ..a.clone() };
                assert_eq!(format!("{a:?}"), format!("{b:?}"), "frame {k}, {layout:?}");
            }
            let mut features = FeatureConfig::newest(vec![0.0; 2], vec![1.0; 2]);
            features.taps = dermis_inference::Taps::Frames(vec![0, 1, 3]);
            let (ids, rows) = thinned.inputs(&features, Baseline::Tared).unwrap();
            let (all_ids, all_rows) = whole.inputs(&features, Baseline::Tared).unwrap();
            let wanted: Vec<f32> = all_ids
                .iter()
                .zip(all_rows.chunks_exact(6))
                .filter(|(id, _)| ids.binary_search(id).is_ok())
                .flat_map(|(_, row)| row.to_vec())
                .collect();
            assert_eq!((ids.len() * 6, format!("{rows:?}")), (wanted.len(), format!("{wanted:?}")));
            let some = thinned.gather(&ids[..3]).unwrap();
            assert!(some.iter().all(|(id, s)| s.frame.values == all[id.sample].frame.values));
        }
    }
}

#[test]
fn what_thinning_leaves_out_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = recording(dir.path(), 1000, Layout::Interleaved);
    let said = |data: &Dataset| data.notices().join("\n").replace(&path.display().to_string(), "BAG");
    insta::assert_snapshot!(said(&read(&path, 999, 0)), @"
    bag BAG: 1 frames (0.1 %) were lost between device and bag, the longest gap is 0.02 s: a model that looks back sees steps there
    bag BAG: 20 of 999 frames have no ground truth within 0.004 s: they are used as history only
    ");
    insta::assert_snapshot!(said(&read(&path, 200, 0)), @"
    bag BAG: 1 frames (0.1 %) were lost between device and bag, the longest gap is 0.02 s: a model that looks back sees steps there
    bag BAG: 20 of 999 frames have no ground truth within 0.004 s: they are used as history only
    bag BAG: 999 frames, every 6th of which is used, and one of each press that has none among those: 168 of them (most_frames = 200); 831, 83.2 %, are left out: they serve as history and for the zero only; more are used with `--most-frames`, at 72 bytes each and 88 for each contact
    ");
    // So few that not every press has one.
    insta::assert_snapshot!(said(&read(&path, 10, 0)), @"
    bag BAG: 1 frames (0.1 %) were lost between device and bag, the longest gap is 0.02 s: a model that looks back sees steps there
    bag BAG: 20 of 999 frames have no ground truth within 0.004 s: they are used as history only
    bag BAG: 999 frames, every 111th of which is used, and one of each press that has none among those: 11 of them (most_frames = 10); 988, 98.9 %, are left out: they serve as history and for the zero only; more are used with `--most-frames`, at 72 bytes each and 88 for each contact
    bag BAG: no frame of 25 short presses is used: locations may be missing; raise `--most-frames`
    bag BAG: 21 untouched stretches are more than are kept track of: the zero rests in them as if the skin was touched; raise `--most-frames`
    ");
    let card = crate::card::of_data(&read(&path, 200, 0)).unwrap();
    let bag = &card["bags"][0];
    assert_eq!((&bag["frames"], &bag["every"]), (&999.into(), &6.into()));
    assert!(bag["used"].as_u64().unwrap() < 200);
}

#[test]
fn frames_of_a_long_bag_that_lie_far_out_of_order_are_left_out_with_a_word() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("late");
    let mut writer = BagWriter::create(&path).unwrap();
    // The first three come last.
    let order = (3..3000_i64).chain(0..3);
    for (log, k) in (BEGIN..).zip(order) {
        writer.write("/pad/taxels", &frame(k * STEP, k as u64, vec![k as f32, 1.0 - k as f32]), log).unwrap();
        writer.write("/pad/ground_truth", &truth(k * STEP, 0, &[(0.001, 1.0)]), log).unwrap();
    }
    writer.finish().unwrap();
    let whole = read(&path, 3000, 0);
    assert_eq!((whole.runs()[0].frames(), whole.notices().len()), (3000, 0));
    for memory in [0, MEMORY] {
        let thinned = read(&path, 1000, memory);
        let run = &thinned.runs()[0];
        assert_eq!((run.frames(), run.hash == whole.runs()[0].hash), (2997, true));
        assert_eq!(samples(&thinned)[0].frame.sequence, 3);
        let notices = thinned.notices().join("\n").replace(&path.display().to_string(), "BAG");
        insta::allow_duplicates! {
            insta::assert_snapshot!(notices, @"
            bag BAG: 3 frames lie behind more than 1024 later ones: they are left out; where memory allows, raise `--most-frames` above the number of messages, and all are brought into order
            bag BAG: 3 ground truth messages lie behind more than 1024 later ones: they are left out; where memory allows, raise `--most-frames` above the number of messages, and all are brought into order
            bag BAG: 2997 frames, every 4th of which is used, and one of each press that has none among those: 750 of them (most_frames = 1000); 2247, 75.0 %, are left out: they serve as history and for the zero only; more are used with `--most-frames`, at 72 bytes each and 88 for each contact
            ");
        }
    }
}

#[test]
fn tables_hold_the_frames_that_are_used() {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    let dir = tempfile::tempdir().unwrap();
    let data = read(&recording(dir.path(), 500, Layout::Interleaved), 100, 0);
    let options = crate::export::ExportOptions {
        formats: vec![crate::export::Format::Parquet],
        tared: false,
        split: SplitConfig::default(),
    };
    let files = crate::export::export(&data, 0, dir.path(), "thinned", &options).unwrap();
    let table = SerializedFileReader::new(std::fs::File::open(&files[0]).unwrap()).unwrap();
    let rows = table.get_row_iter(None).unwrap().map(|row| {
        let row = row.unwrap();
        let column = |name: &str| row.get_column_iter().find(|(n, _)| *n == name).unwrap().1.to_string();
        (column("stamp"), column("press"))
    });
    let of = |s: &FrameInfo| {
        let press = s.truth.as_ref().map_or(-1, |t| t.press.cast_signed());
        (s.stamp.to_string(), press.to_string())
    };
    let used: Vec<(String, String)> = data.runs()[0].samples.iter().map(of).collect();
    assert!(used.len() <= 100);
    assert_eq!(rows.collect::<Vec<_>>(), used);
}

/// The statistics of an MCAP file count `count` messages on each channel (<https://mcap.dev/spec#statistics-op0x0b>).
fn counting(file: &Path, count: u64) {
    let mut bytes = std::fs::read(file).unwrap();
    let number = |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    // Footer: where the summary begins, where its offsets begin, and a checksum (0: none); then the magic bytes.
    let footer = bytes.len() - 8 - 20;
    bytes[footer + 16..footer + 20].fill(0);
    let mut at = number(&bytes, footer);
    while bytes[at] != 0x0b {
        at += 9 + number(&bytes, at + 1);
    }
    // Behind numbers of messages and other records, and two instants, a map from channel to number of messages.
    let map = at + 9 + 8 + 2 + 4 * 4 + 8 + 8;
    let size = u32::from_le_bytes(bytes[map..map + 4].try_into().unwrap()) as usize;
    for entry in (map + 4..map + 4 + size).step_by(10) {
        bytes[entry + 2..entry + 10].copy_from_slice(&count.to_le_bytes());
    }
    std::fs::write(file, bytes).unwrap();
}

/// Memory is set aside by what the summary says; one that lies is refused where its frames are more.
#[test]
fn a_bag_with_more_frames_than_its_summary_counts_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = recording(dir.path(), 1000, Layout::Interleaved);
    let is_mcap = |p: &PathBuf| p.extension().is_some_and(|e| e == "mcap");
    let file = std::fs::read_dir(&path).unwrap().map(|e| e.unwrap().path()).find(is_mcap).unwrap();
    let options = DatasetOptions { most_frames: 200, memory: 0, ..DatasetOptions::default() };
    let read = |count| {
        counting(&file, count);
        Dataset::from_bags(&[&path], &skin(), &options)
    };
    assert_eq!(read(999).unwrap().runs()[0].frames(), 999);
    let error = read(50).unwrap_err().to_string();
    let first = error.lines().next().unwrap().replace(&path.display().to_string(), "BAG");
    insta::assert_snapshot!(first, @"bag BAG: holds more than 200 frames, which its summary does not count, or which are too many for one bag: it is not read to its end; `dermis bag slice` writes it anew, or in parts");
}
