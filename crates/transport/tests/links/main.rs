//! Sources over real pseudo-terminals and sockets: what a day in the life of a plug does to them.

#![expect(clippy::unwrap_used, reason = "a panic in a test is its failure report")]

mod network;
mod terminals;

use std::path::Path;
use std::time::{Duration, Instant};

use dermis_transport::framing::{DecodedFrame, FrameDecoder, NativeDecoder, NativeEncoder, NativeFormat};
use dermis_transport::{Event, Source, SourceOptions, SourceUrl};

const PATIENCE: Duration = Duration::from_secs(20);
const CHANNELS: usize = 16;

fn quick() -> SourceOptions {
    SourceOptions::default().with_backoff(Duration::from_millis(5), Duration::from_millis(50))
}

fn open(url: &str) -> Source {
    Source::open(SourceUrl::parse(url).unwrap(), quick())
}

fn values(sequence: u32) -> Vec<f32> {
    (0..CHANNELS).map(|i| sequence as f32 + i as f32 / 16.0).collect()
}

fn frame(sequence: u32) -> Vec<u8> {
    let mut encoder = NativeEncoder::new(NativeFormat::F32);
    encoder.encode(sequence, 1 + u64::from(sequence) * 1000, &values(sequence)).unwrap().to_vec()
}

/// A consumer: decodes what a source yields, and keeps what it says about the link.
struct Consumer {
    source: Source,
    decoder: Box<dyn FrameDecoder>,
    frames: Vec<DecodedFrame>,
    connected: u32,
    reasons: Vec<String>,
    notices: Vec<(String, bool)>,
    overflows: u64,
    ended: bool,
}

impl Consumer {
    fn new(source: Source) -> Self {
        Self::with(source, NativeDecoder::new(Some(CHANNELS)))
    }

    fn with(source: Source, decoder: impl FrameDecoder + 'static) -> Self {
        Self {
            source,
            decoder: Box::new(decoder),
            frames: Vec::new(),
            connected: 0,
            reasons: Vec::new(),
            notices: Vec::new(),
            overflows: 0,
            ended: false,
        }
    }

    fn step(&mut self, timeout: Duration) -> bool {
        match self.source.next_timeout(timeout) {
            Some(Event::Bytes { data, received_ns }) => {
                self.decoder.push(&data, received_ns, &mut self.frames);
            }
            Some(Event::Overflow { .. }) => {
                self.overflows += 1;
                self.decoder.gap();
            }
            Some(Event::Connected { .. }) => self.connected += 1,
            Some(Event::Disconnected { reason, .. }) => {
                self.decoder.gap();
                self.reasons.push(reason);
            }
            Some(Event::OtherSender { notice, taken_over }) => {
                if taken_over {
                    self.decoder.gap();
                }
                self.notices.push((notice, taken_over));
            }
            Some(Event::Ended) => self.ended = true,
            Some(_) => {}
            None => return false,
        }
        true
    }

    /// Takes events until `done`, and fails where that does not come.
    #[track_caller]
    fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        while !done(self) {
            assert!(
                Instant::now() < deadline && !self.ended,
                "never came: {what}; {} frames, reasons {:?}, {:?}, {:?}",
                self.frames.len(),
                self.reasons,
                self.source.stats(),
                self.decoder.stats(),
            );
            self.step(Duration::from_millis(50));
        }
    }

    /// All values are those that were sent with their number.
    #[track_caller]
    fn assert_true(&self) {
        for frame in &self.frames {
            let sent = frame.values[0] as u32;
            assert_eq!(frame.values, values(sent), "frame {}", frame.sequence);
        }
    }
}

/// Waits for a condition that no event announces.
#[track_caller]
fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "never came: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn link_in(folder: &Path) -> String {
    folder.join("skin").display().to_string()
}
