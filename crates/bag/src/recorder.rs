//! Takes messages from many threads and writes them on one, without ever holding a sender up.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use crate::{
    BagError, BagInfo, BagOptions, BagWriter, Compression, RecordedLosses, Topic, TopicId, TopicLosses,
    frames::FrameCounter, patience::Patience,
};

use writing::write;

mod writing;

/// What a message costs in the queue beside its bytes.
const OVERHEAD: usize = size_of::<Item>() + 16;
/// What is missing is noted in the file at most this often.
const NOTE: Duration = Duration::from_secs(2);

/// How a recorder works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecorderOptions {
    /// Layout of the bag.
    pub bag: BagOptions,
    /// Memory [bytes] for messages that wait for the disk. What comes while it is full is dropped and counted.
    pub queue_bytes: usize,
    /// A chunk is ended at latest after this time, so that a crash loses no more.
    pub chunk_time: Duration,
    /// Whether to wait while the disk is full, until there is room or [`Recorder::finish`] is called, and then to go on in a
    /// new file of the bag. Without, a full disk ends the recording.
    pub wait_for_room: bool,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            bag: BagOptions { chunk_bytes: 4 << 20, ..BagOptions::default() }.compression(Compression::Fast),
            queue_bytes: 512 << 20,
            chunk_time: Duration::from_millis(500),
            wait_for_room: false,
        }
    }
}

impl RecorderOptions {
    /// With this layout of the bag.
    #[must_use]
    pub fn bag(mut self, bag: BagOptions) -> Self {
        self.bag = bag;
        self
    }

    /// Waits while the disk is full.
    #[must_use]
    pub fn wait_for_room(mut self, wait: bool) -> Self {
        self.wait_for_room = wait;
        self
    }

    /// With this much memory [bytes] for messages that wait.
    #[must_use]
    pub fn queue_bytes(mut self, bytes: usize) -> Self {
        self.queue_bytes = bytes;
        self
    }
}

/// A topic with what became of its messages.
#[derive(Debug)]
struct Shared {
    topic: Topic,
    /// Known to the writing thread.
    id: OnceLock<TopicId>,
    recorded: AtomicU64,
    /// Of those, what is in the chunk that is not complete yet.
    open_chunk: AtomicU64,
    dropped: AtomicU64,
    /// What was lost on the way, as far as whoever pushes knows.
    lost: Mutex<Option<u64>>,
    /// For taxel frames: which are missing of those that were written.
    frames: Option<Mutex<FrameCounter>>,
}

impl Shared {
    fn new(topic: Topic) -> Self {
        Self {
            frames: FrameCounter::of(&topic).map(Mutex::new),
            topic,
            id: OnceLock::new(),
            recorded: AtomicU64::new(0),
            open_chunk: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            lost: Mutex::default(),
        }
    }

    fn losses(&self) -> TopicLosses {
        TopicLosses {
            lost: *lock(&self.lost),
            dropped: self.dropped.load(Ordering::Relaxed),
            missing_frames: self.frames.as_ref().map_or(0, |frames| lock(frames).missing()),
        }
    }

    fn state(&self) -> TopicState {
        let TopicLosses { lost, dropped, missing_frames } = self.losses();
        TopicState {
            name: self.topic.name.clone(),
            type_name: self.topic.type_name.clone(),
            recorded: self.recorded.load(Ordering::Relaxed),
            dropped,
            lost,
            missing_frames: self.frames.as_ref().map(|_| missing_frames),
        }
    }
}

enum Item {
    Topic(Arc<Shared>),
    Message { topic: Arc<Shared>, data: Vec<u8>, log_time: i64, publish_time: i64 },
}

#[derive(Default)]
struct Queue {
    items: VecDeque<Item>,
    closed: bool,
}

struct Core {
    limit: usize,
    queue: Mutex<Queue>,
    filled: Condvar,
    /// Bytes that wait or are being written.
    held: AtomicUsize,
    /// Bytes of the messages that were recorded.
    payload: AtomicU64,
    /// Bytes of the files.
    stored: AtomicU64,
    files: AtomicUsize,
    failed: AtomicBool,
    topics: Mutex<Vec<Arc<Shared>>>,
    patience: Option<Arc<Patience>>,
}

fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a recorder has done so far.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct RecorderState {
    /// Messages that were written.
    pub messages: u64,
    /// Bytes of those messages.
    pub payload_bytes: u64,
    /// Bytes of the files.
    pub stored_bytes: u64,
    /// Messages that came while the queue was full, or after writing had failed.
    pub dropped: u64,
    /// Messages that were lost on the way, on all topics of which it is known; `None` where it is known of none.
    pub lost: Option<u64>,
    /// What is waited for while nothing can be written, e.g. `the disk is full`.
    pub waits: Option<&'static str>,
    /// How often room was waited for.
    pub pauses: u64,
    /// [ms] that room was waited for, in all.
    pub paused_ms: u64,
    /// Bytes that wait for the disk.
    pub queued_bytes: usize,
    /// Files, the open one included.
    pub files: usize,
    /// The topics in the order in which they were added.
    pub topics: Vec<TopicState>,
}

/// One topic of a [`RecorderState`].
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct TopicState {
    /// Topic.
    pub name: String,
    /// Type, e.g. `dermis_msgs/msg/TaxelFrame`.
    pub type_name: String,
    /// Messages that were written.
    pub recorded: u64,
    /// Messages that arrived and were not written.
    pub dropped: u64,
    /// Messages that were lost on the way; `None` where nothing tells.
    pub lost: Option<u64>,
    /// Taxel frames that the skin numbered and that were not written, whatever the reason; `None` for other types.
    pub missing_frames: Option<u64>,
}

impl RecorderState {
    /// What the recording lacks.
    #[must_use]
    pub fn losses(&self) -> RecordedLosses {
        let of = |topic: &TopicState| TopicLosses {
            lost: topic.lost,
            dropped: topic.dropped,
            missing_frames: topic.missing_frames.unwrap_or(0),
        };
        RecordedLosses { topics: self.topics.iter().map(|topic| (topic.name.clone(), of(topic))).collect() }
    }
}

/// A finished recording.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Recorded {
    /// The bag.
    pub bag: BagInfo,
    /// What was recorded and dropped.
    pub state: RecorderState,
}

/// Records messages into a bag: they go, in the order in which they come, through a queue that is bounded in bytes to one
/// thread that compresses and writes. A sender never waits; what does not fit is dropped and counted by topic.
///
/// ```no_run
/// use dermis_bag::{BagQos, Recorder, RecorderOptions, Topic};
/// use dermis_msgs::{Message, TypeSupport, msg::TaxelFrame};
///
/// # fn main() -> Result<(), dermis_bag::BagError> {
/// let recorder = Recorder::start("run", RecorderOptions::default())?;
/// let support = TypeSupport::of::<TaxelFrame>();
/// let taxels = recorder.topic(Topic::of_type("/taxels", support, Some(BagQos::sensor_data())));
/// let now = 1_700_000_000_000_000_000;
/// taxels.push(TaxelFrame::default().to_cdr(), now, now);
/// let recorded = recorder.finish([])?;
/// assert_eq!(recorded.state.dropped, 0);
/// # Ok(())
/// # }
/// ```
pub struct Recorder {
    dir: PathBuf,
    core: Arc<Core>,
    thread: Option<JoinHandle<Result<BagWriter, BagError>>>,
}

/// Where messages of one topic go; cheap to clone.
#[derive(Clone)]
pub struct TopicSink {
    core: Arc<Core>,
    shared: Arc<Shared>,
}

impl TopicSink {
    /// Queues a message: CDR bytes with their encapsulation header, when they came and when they were published,
    /// nanoseconds since the epoch. Returns at once; false where the message was dropped.
    #[must_use = "a message that was dropped is counted, but should not pass unseen"]
    pub fn push(&self, data: Vec<u8>, log_time_ns: i64, publish_time_ns: i64) -> bool {
        let cost = data.len() + OVERHEAD;
        let before = self.core.held.fetch_add(cost, Ordering::AcqRel);
        // One message always fits, however large.
        let full = before > 0 && before + cost > self.core.limit;
        if full || self.core.failed.load(Ordering::Acquire) {
            self.core.held.fetch_sub(cost, Ordering::AcqRel);
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        let topic = Arc::clone(&self.shared);
        let item = Item::Message { topic, data, log_time: log_time_ns, publish_time: publish_time_ns };
        lock(&self.core.queue).items.push_back(item);
        self.core.filled.notify_one();
        true
    }

    /// Counts messages that arrived and were dropped before they came here.
    pub fn add_dropped(&self, count: u64) {
        self.shared.dropped.fetch_add(count, Ordering::Relaxed);
    }

    /// Says how many messages were lost on the way so far; `None`, as before the first call, where that is not known.
    pub fn set_lost(&self, lost: Option<u64>) {
        *lock(&self.shared.lost) = lost;
    }

    /// Messages that were written so far.
    #[must_use]
    pub fn recorded(&self) -> u64 {
        self.shared.recorded.load(Ordering::Relaxed)
    }

    /// Messages that were dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }
}

impl Recorder {
    /// Makes the folder `dir`, starts a bag named like it and the thread that writes it.
    ///
    /// # Errors
    /// As [`BagWriter::create`].
    pub fn start(dir: impl AsRef<Path>, options: RecorderOptions) -> Result<Self, BagError> {
        let patience = options.wait_for_room.then(Arc::<Patience>::default);
        let writer = BagWriter::create_waiting(dir.as_ref(), &options.bag, patience.clone())?;
        // Before, there was nothing that waiting would have saved.
        if let Some(patience) = &patience {
            patience.begin();
        }
        let core = Arc::new(Core {
            limit: options.queue_bytes,
            queue: Mutex::default(),
            filled: Condvar::new(),
            held: AtomicUsize::new(0),
            payload: AtomicU64::new(0),
            stored: AtomicU64::new(0),
            files: AtomicUsize::new(1),
            failed: AtomicBool::new(false),
            topics: Mutex::default(),
            patience,
        });
        let thread = std::thread::Builder::new()
            .name("bag-writer".into())
            .spawn({
                let core = Arc::clone(&core);
                move || write(&core, writer, options.chunk_time)
            })
            .map_err(BagError::io("start a thread for", dir.as_ref()))?;
        Ok(Self { dir: dir.as_ref().to_path_buf(), core, thread: Some(thread) })
    }

    /// Declares a topic. The same name again gives the sink of the first one.
    pub fn topic(&self, topic: Topic) -> TopicSink {
        let mut topics = lock(&self.core.topics);
        let known = topics.iter().find(|shared| shared.topic.name == topic.name);
        let shared = known.cloned().unwrap_or_else(|| {
            let shared = Arc::new(Shared::new(topic));
            topics.push(Arc::clone(&shared));
            lock(&self.core.queue).items.push_back(Item::Topic(Arc::clone(&shared)));
            shared
        });
        self.core.filled.notify_one();
        TopicSink { core: Arc::clone(&self.core), shared }
    }

    /// What was done so far.
    #[must_use]
    pub fn state(&self) -> RecorderState {
        self.core.state()
    }

    /// Says what was done so far from anywhere, as long as it is kept.
    pub fn watch(&self) -> impl Fn() -> RecorderState + Send + Sync + 'static {
        let core = Arc::clone(&self.core);
        move || core.state()
    }

    /// Whether writing has failed, so that nothing more is recorded; [`finish`](Self::finish) says why.
    #[must_use]
    pub fn failed(&self) -> bool {
        self.core.failed.load(Ordering::Acquire)
    }

    /// Writes what waits and completes the bag. Its custom data hold `custom`, and what the recording lacks
    /// ([`RecordedLosses`]). While the disk is full, this does not wait any longer.
    ///
    /// # Errors
    /// What kept the thread from writing; what was written before stays readable. What was not is counted as dropped.
    pub fn finish(
        mut self,
        custom: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Recorded, BagError> {
        let Some(mut writer) = self.end()? else {
            return Err(BagError::Write {
                path: self.dir.clone(),
                problem: "the recording has ended before".into(),
            });
        };
        let state = self.core.state();
        let losses = RecordedLosses::to_custom(&state.losses().topics);
        // In the last file as well, so that the .mcap alone tells it.
        let noted = writer.note_losses(&losses);
        for (key, value) in custom.into_iter().chain(losses) {
            writer.set_custom(key, value);
        }
        if state.pauses > 0 {
            let seconds = state.paused_ms as f64 * 1e-3;
            writer.set_custom("waited for room", format!("{} times, {seconds:.1} s in all", state.pauses));
        }
        let done = noted.and_then(|()| writer.finish());
        let bag = done.inspect_err(|_| self.core.give_up_open_chunk())?;
        let state = RecorderState { stored_bytes: bag.bytes, ..state };
        Ok(Recorded { bag, state })
    }

    fn end(&mut self) -> Result<Option<BagWriter>, BagError> {
        if let Some(patience) = &self.core.patience {
            patience.end();
        }
        lock(&self.core.queue).closed = true;
        self.core.filled.notify_one();
        let Some(thread) = self.thread.take() else { return Ok(None) };
        match thread.join() {
            Ok(written) => written.map(Some),
            Err(_) => Err(BagError::Write {
                path: self.dir.clone(),
                problem: "the thread that writes the bag ended by a panic".into(),
            }),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // The bag stays without metadata, and so recognised as interrupted.
        let _ = self.end();
    }
}

impl Core {
    fn state(&self) -> RecorderState {
        let topics: Vec<TopicState> = lock(&self.topics).iter().map(|shared| shared.state()).collect();
        let known: Vec<u64> = topics.iter().filter_map(|topic| topic.lost).collect();
        let patience = self.patience.as_deref();
        RecorderState {
            messages: topics.iter().map(|topic| topic.recorded).sum(),
            dropped: topics.iter().map(|topic| topic.dropped).sum(),
            lost: (!known.is_empty()).then(|| known.iter().sum()),
            waits: patience.and_then(Patience::waiting),
            pauses: patience.map_or(0, Patience::pauses),
            paused_ms: patience.map_or(0, |p| u64::try_from(p.waited().as_millis()).unwrap_or(u64::MAX)),
            payload_bytes: self.payload.load(Ordering::Relaxed),
            stored_bytes: self.stored.load(Ordering::Relaxed),
            queued_bytes: self.held.load(Ordering::Relaxed),
            files: self.files.load(Ordering::Relaxed),
            topics,
        }
    }

    /// The chunk that was being filled is complete.
    fn keep_open_chunk(&self) {
        for shared in lock(&self.topics).iter() {
            shared.open_chunk.store(0, Ordering::Relaxed);
        }
    }

    /// The chunk that was being filled never reaches the disk: its messages are not recorded.
    fn give_up_open_chunk(&self) {
        for shared in lock(&self.topics).iter() {
            let lost = shared.open_chunk.swap(0, Ordering::Relaxed);
            shared.recorded.fetch_sub(lost, Ordering::Relaxed);
            shared.dropped.fetch_add(lost, Ordering::Relaxed);
        }
    }

    fn store_size(&self, writer: &BagWriter) {
        self.stored.store(writer.bytes(), Ordering::Relaxed);
        self.files.store(writer.files(), Ordering::Relaxed);
    }
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder").field("state", &self.core.state()).finish_non_exhaustive()
    }
}

impl std::fmt::Debug for TopicSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TopicSink").field("topic", &self.shared.topic.name).finish_non_exhaustive()
    }
}
