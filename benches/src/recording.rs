//! How much a recorder takes: the disk alone, the way from the queue to the file, and the way over the bus.

mod bus;

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use dermis_bag::{BagQos, Compression, Recorder, RecorderOptions, Topic};
use dermis_msgs::msg::TaxelFrame;
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::{Message, TypeSupport};
use serde_json::{Value, json};

pub use bus::{SourceOptions, source};

/// Bytes of an image of 640 × 480 pixels with three colours.
const IMAGE: usize = 640 * 480 * 3;
/// Frames of each of two skins for one image: a thousand frames a second beside a camera's thirty images.
const FRAMES: usize = 32;

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Seconds of each measurement.
    #[arg(long, default_value_t = 8.0)]
    seconds: f64,
    /// Rate \[MB/s\] that the recorder shall keep up with.
    #[arg(long, default_value_t = 200.0)]
    rate: f64,
    /// Folder on the disk that is measured; a temporary one where absent.
    #[arg(long)]
    folder: Option<PathBuf>,
    /// Program `dermis`; the one beside this program where absent.
    #[arg(long)]
    dermis: Option<PathBuf>,
    /// Only the disk and the way from the queue to the file, with each compression.
    #[arg(long)]
    writer_only: bool,
}

/// Measures the disk, then the recorder on it, in one run.
///
/// # Errors
///
/// Where the disk refuses, or a process does not start.
pub fn run(options: &Options) -> Result<Value> {
    let folder = match &options.folder {
        Some(folder) => tempfile::tempdir_in(folder),
        None => tempfile::tempdir(),
    };
    let folder = folder.context("no folder for bags")?;
    let bytes = (options.rate * options.seconds * 1e6) as u64;
    let disk = disk(&folder.path().join("disk"), bytes)?;
    eprintln!("the disk takes {:.0} MB/s, {:.0} MB/s until all lies on it", disk.0, disk.1);
    let mut writer = Vec::new();
    for (name, compression) in
        [("none", Compression::None), ("fast", Compression::Fast), ("default", Compression::Default)]
    {
        for (paced, rate) in [(true, options.rate), (false, f64::INFINITY)] {
            let measured = through_writer(folder.path(), compression, rate, options.seconds)?;
            eprintln!(
                "queue to file, {name:8}{:8} {:6.0} MB/s, {} dropped, {:.2} cores, {:.2} of the size",
                if paced { "at rate" } else { "flat out" },
                measured.rate,
                measured.dropped,
                measured.cores,
                measured.stored
            );
            writer.push(json!({
                "compression": name, "paced": paced, "mb_s": measured.rate, "synced_mb_s": measured.synced_rate,
                "messages": measured.messages, "dropped": measured.dropped, "cores": measured.cores, "stored_share": measured.stored,
            }));
        }
    }
    let mut result = json!({
        "seconds": options.seconds,
        "target_mb_s": options.rate,
        "disk_mb_s": disk.0,
        "disk_synced_mb_s": disk.1,
        "writer": writer,
    });
    if !options.writer_only {
        let dermis = match &options.dermis {
            Some(path) => path.clone(),
            None => std::env::current_exe()?.with_file_name("dermis"),
        };
        result["bus"] = bus::run(&dermis, folder.path(), options.rate, options.seconds)?;
    }
    Ok(result)
}

/// What a plain file takes \[MB/s\]: until it is written, and until it lies on the disk.
fn disk(path: &Path, bytes: u64) -> Result<(f64, f64)> {
    let block = image(1);
    let mut file = File::create(path)?;
    let begun = Instant::now();
    let mut written = 0;
    while written < bytes {
        file.write_all(&block)?;
        written += block.len() as u64;
    }
    let buffered = begun.elapsed();
    file.sync_all()?;
    let synced = begun.elapsed();
    drop(file);
    std::fs::remove_file(path)?;
    let rate = |time: Duration| written as f64 * 1e-6 / time.as_secs_f64();
    Ok((rate(buffered), rate(synced)))
}

struct Measured {
    /// While messages came, or, where they came as fast as they went, until the end \[MB/s\].
    rate: f64,
    /// Until all lies on the disk \[MB/s\].
    synced_rate: f64,
    messages: u64,
    dropped: u64,
    /// Processor time over real time, the maker of messages included.
    cores: f64,
    /// Bytes of the files over bytes of the messages.
    stored: f64,
}

/// Images and frames through queue, compression and file, at a rate \[MB/s\] or as fast as the queue takes them.
fn through_writer(folder: &Path, compression: Compression, rate: f64, seconds: f64) -> Result<Measured> {
    let bag = folder.join("writer");
    let defaults = RecorderOptions::default();
    let recorder = Recorder::start(&bag, defaults.bag(defaults.bag.compression(compression)))?;
    let images: Vec<Vec<u8>> = (0..16).map(|seed| cloud(seed, IMAGE).to_cdr()).collect();
    let frames: Vec<Vec<u8>> = (0..256).map(|index| frame(index).to_cdr()).collect();
    let qos = Some(BagQos::reliable(10));
    let images_to = recorder.topic(Topic::of_type("/image", TypeSupport::of::<PointCloud2>(), qos));
    let frames_to = [0, 1].map(|skin| {
        recorder.topic(Topic::of_type(&format!("/skin{skin}/taxels"), TypeSupport::of::<TaxelFrame>(), qos))
    });
    let cpu = own_cpu()?;
    let begun = Instant::now();
    let (mut sent, mut count) = (0_usize, 0_usize);
    while begun.elapsed().as_secs_f64() < seconds {
        if rate.is_finite() {
            let due = Duration::from_secs_f64(sent as f64 / (rate * 1e6));
            std::thread::sleep(due.saturating_sub(begun.elapsed()));
        } else if recorder.state().queued_bytes > defaults.queue_bytes / 2 {
            std::thread::sleep(Duration::from_micros(200));
            continue;
        }
        let now = dermis_transport::now_ns();
        let mut push = |to: &dermis_bag::TopicSink, data: &Vec<u8>| {
            sent += data.len();
            // What does not fit is counted by the recorder.
            let _ = to.push(data.clone(), now, now);
        };
        push(&images_to, &images[count % images.len()]);
        for index in 0..FRAMES {
            for to in &frames_to {
                push(to, &frames[(count * FRAMES + index) % frames.len()]);
            }
        }
        count += 1;
    }
    let came = begun.elapsed().as_secs_f64();
    let recorded = recorder.finish([])?;
    let wall = begun.elapsed().as_secs_f64();
    let payload = recorded.state.payload_bytes as f64;
    let measured = Measured {
        rate: payload * 1e-6 / if rate.is_finite() { came } else { wall },
        synced_rate: payload * 1e-6 / wall,
        messages: recorded.state.messages,
        dropped: recorded.state.dropped,
        cores: (own_cpu()? - cpu).as_secs_f64() / wall,
        stored: recorded.bag.bytes as f64 / payload,
    };
    std::fs::remove_dir_all(&bag)?;
    Ok(measured)
}

/// Processor time of this process.
fn own_cpu() -> Result<Duration> {
    let stat = std::fs::read_to_string("/proc/self/stat").context("/proc/self/stat")?;
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks: u64 =
        after_name.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<u64>().ok()).sum();
    // The unit of that file, USER_HZ, is 100 on every Linux.
    Ok(Duration::from_millis(ticks * 10))
}

/// A camera's image: slow gradients under noise of a few levels.
fn image(seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut noise = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (0..4).map(|byte| (state >> (8 * byte)) & 7).sum::<u64>() as u8
    };
    let value = |at: usize| ((at / 3 % 640) / 8 + (at / 1920) / 6 + at % 3 * 20) as u8;
    (0..IMAGE).map(|at| value(at).wrapping_add(noise())).collect()
}

fn cloud(seed: u64, bytes: usize) -> PointCloud2 {
    let mut data = image(seed);
    data.truncate(bytes);
    PointCloud2 {
        header: Header { frame_id: "camera".into(), ..Header::default() },
        height: 1,
        width: data.len() as u32,
        point_step: 1,
        row_step: data.len() as u32,
        data,
        ..PointCloud2::default()
    }
}

/// A frame of a skin with 25 taxels.
fn frame(index: u64) -> TaxelFrame {
    let value = |taxel: u64| {
        let mixed = (index * 25 + taxel).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
        101_325.0 + (mixed % 4001) as f32 * 0.01
    };
    TaxelFrame {
        header: Header { frame_id: "palm".into(), ..Header::default() },
        skin: "palm".into(),
        sequence: index,
        device_time_us: index * 1000,
        layout_id: 1,
        values: (0..25).map(value).collect(),
        flags: vec![0; 25],
        temperature: 296.5,
    }
}
