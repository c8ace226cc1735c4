//! Takes messages from many threads and writes them on one, without ever holding a sender up.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use crate::{BagError, BagInfo, BagOptions, BagWriter, Compression, Topic, TopicId};

/// What a message costs in the queue beside its bytes.
const OVERHEAD: usize = size_of::<Item>() + 16;

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
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            bag: BagOptions { chunk_bytes: 4 << 20, ..BagOptions::default() }.compression(Compression::Fast),
            queue_bytes: 512 << 20,
            chunk_time: Duration::from_millis(500),
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
    dropped: AtomicU64,
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
}

fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a recorder has done so far.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RecorderState {
    /// Messages that were written.
    pub messages: u64,
    /// Bytes of those messages.
    pub payload_bytes: u64,
    /// Bytes of the files.
    pub stored_bytes: u64,
    /// Messages that came while the queue was full, or after writing had failed.
    pub dropped: u64,
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
    /// Messages that were not.
    pub dropped: u64,
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

    /// Counts messages that were lost before they came here.
    pub fn lost(&self, count: u64) {
        self.shared.dropped.fetch_add(count, Ordering::Relaxed);
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
        let writer = BagWriter::create_with(&dir, &options.bag)?;
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
            let shared = Arc::new(Shared {
                topic,
                id: OnceLock::new(),
                recorded: AtomicU64::new(0),
                dropped: AtomicU64::new(0),
            });
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

    /// Whether writing has failed, so that nothing more is recorded; [`finish`](Self::finish) says why.
    #[must_use]
    pub fn failed(&self) -> bool {
        self.core.failed.load(Ordering::Acquire)
    }

    /// Writes what waits and completes the bag. Its custom data hold `custom`, and how many messages were dropped: `dropped`
    /// in all, and `dropped <topic>` where there were some.
    ///
    /// # Errors
    /// What kept the thread from writing; what was written before stays readable.
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
        for (key, value) in custom {
            writer.set_custom(key, value);
        }
        writer.set_custom("dropped", state.dropped.to_string());
        for topic in state.topics.iter().filter(|topic| topic.dropped > 0) {
            writer.set_custom(format!("dropped {}", topic.name), topic.dropped.to_string());
        }
        let bag = writer.finish()?;
        let state = RecorderState { stored_bytes: bag.bytes, ..state };
        Ok(Recorded { bag, state })
    }

    fn end(&mut self) -> Result<Option<BagWriter>, BagError> {
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
        let topics: Vec<TopicState> = lock(&self.topics)
            .iter()
            .map(|shared| TopicState {
                name: shared.topic.name.clone(),
                type_name: shared.topic.type_name.clone(),
                recorded: shared.recorded.load(Ordering::Relaxed),
                dropped: shared.dropped.load(Ordering::Relaxed),
            })
            .collect();
        RecorderState {
            messages: topics.iter().map(|topic| topic.recorded).sum(),
            dropped: topics.iter().map(|topic| topic.dropped).sum(),
            payload_bytes: self.payload.load(Ordering::Relaxed),
            stored_bytes: self.stored.load(Ordering::Relaxed),
            queued_bytes: self.held.load(Ordering::Relaxed),
            files: self.files.load(Ordering::Relaxed),
            topics,
        }
    }
}

/// Writes until the queue is closed and empty. After a failure, what waits is counted as dropped.
fn write(core: &Core, mut writer: BagWriter, chunk_time: Duration) -> Result<BagWriter, BagError> {
    let mut batch = VecDeque::new();
    let done = write_all(core, &mut writer, chunk_time, &mut batch);
    let Err(error) = done else { return Ok(writer) };
    core.failed.store(true, Ordering::Release);
    let waiting = std::mem::take(&mut lock(&core.queue).items);
    for item in batch.into_iter().chain(waiting) {
        if let Item::Message { topic, data, .. } = item {
            topic.dropped.fetch_add(1, Ordering::Relaxed);
            core.held.fetch_sub(data.len() + OVERHEAD, Ordering::AcqRel);
        }
    }
    Err(error)
}

fn write_all(
    core: &Core,
    writer: &mut BagWriter,
    chunk_time: Duration,
    batch: &mut VecDeque<Item>,
) -> Result<(), BagError> {
    // Since when a chunk is open.
    let mut open: Option<Instant> = None;
    loop {
        let closed = {
            let queue = lock(&core.queue);
            let wait = open.map_or(chunk_time, |since| chunk_time.saturating_sub(since.elapsed()));
            let idle = |queue: &mut Queue| queue.items.is_empty() && !queue.closed;
            let (mut queue, _) =
                core.filled.wait_timeout_while(queue, wait, idle).unwrap_or_else(PoisonError::into_inner);
            std::mem::swap(&mut queue.items, batch);
            queue.closed && batch.is_empty()
        };
        if closed {
            return Ok(());
        }
        while let Some(item) = batch.front() {
            match item {
                Item::Topic(shared) => {
                    let id = writer.declare(&shared.topic)?;
                    // Each topic is queued once.
                    let _ = shared.id.set(id);
                }
                Item::Message { topic, data, log_time, publish_time } => {
                    let Some(&id) = topic.id.get() else {
                        batch.pop_front();
                        continue;
                    };
                    match writer.write_bytes(id, data, *log_time, *publish_time) {
                        Ok(()) => {
                            topic.recorded.fetch_add(1, Ordering::Relaxed);
                            core.payload.fetch_add(data.len() as u64, Ordering::Relaxed);
                        }
                        Err(BagError::Refused { .. }) => {
                            topic.dropped.fetch_add(1, Ordering::Relaxed);
                        }
                        Err(error) => return Err(error),
                    }
                    core.held.fetch_sub(data.len() + OVERHEAD, Ordering::AcqRel);
                    open.get_or_insert_with(Instant::now);
                }
            }
            batch.pop_front();
            if open.is_some_and(|since| since.elapsed() >= chunk_time) {
                writer.flush()?;
                open = None;
                core.stored.store(writer.bytes(), Ordering::Relaxed);
                core.files.store(writer.files(), Ordering::Relaxed);
            }
        }
        if open.is_some_and(|since| since.elapsed() >= chunk_time) {
            writer.flush()?;
            open = None;
        }
        core.stored.store(writer.bytes(), Ordering::Relaxed);
        core.files.store(writer.files(), Ordering::Relaxed);
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
