//! The thread that writes what was queued.

use std::collections::{BTreeMap, VecDeque};
use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::{Core, Item, NOTE, OVERHEAD, Queue, lock};
use crate::{BagError, BagWriter, RecordedLosses};

/// Writes until the queue is closed and empty. After a failure, what waits is counted as dropped.
pub(super) fn write(core: &Core, mut writer: BagWriter, chunk_time: Duration) -> Result<BagWriter, BagError> {
    let mut batch = VecDeque::new();
    let done = write_all(core, &mut writer, chunk_time, &mut batch);
    let Err(error) = done else { return Ok(writer) };
    core.failed.store(true, Ordering::Release);
    core.give_up_open_chunk();
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
    let mut notes = Notes { last: BTreeMap::new(), at: Instant::now() };
    // Since when a chunk is open.
    let mut open: Option<Instant> = None;
    let mut pauses = 0;
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
            write_item(core, writer, item, &mut open)?;
            batch.pop_front();
            if open.is_some_and(|since| since.elapsed() >= chunk_time) {
                end_chunk(core, writer, &mut open, &mut notes)?;
            }
            let now = core.patience.as_ref().map_or(0, |patience| patience.pauses());
            if now > pauses {
                pauses = now;
                // What was written before the pause is complete from here on, with its index.
                end_chunk(core, writer, &mut open, &mut notes)?;
                writer.split()?;
            }
        }
        if open.is_some_and(|since| since.elapsed() >= chunk_time) {
            end_chunk(core, writer, &mut open, &mut notes)?;
        }
        core.store_size(writer);
    }
}

fn write_item(
    core: &Core,
    writer: &mut BagWriter,
    item: &Item,
    open: &mut Option<Instant>,
) -> Result<(), BagError> {
    let (topic, data, log_time, publish_time) = match item {
        Item::Topic(shared) => {
            let id = writer.declare(&shared.topic)?;
            // Each topic is queued once.
            let _ = shared.id.set(id);
            return Ok(());
        }
        Item::Message { topic, data, log_time, publish_time } => (topic, data, *log_time, *publish_time),
    };
    let Some(&id) = topic.id.get() else { return Ok(()) };
    let before = writer.bytes();
    match writer.write_bytes(id, data, log_time, publish_time) {
        Ok(()) => {
            if writer.bytes() > before {
                // The chunk before was full, and is complete.
                core.keep_open_chunk();
            }
            topic.open_chunk.fetch_add(1, Ordering::Relaxed);
            topic.recorded.fetch_add(1, Ordering::Relaxed);
            core.payload.fetch_add(data.len() as u64, Ordering::Relaxed);
            if let Some(frames) = &topic.frames {
                lock(frames).observe(data);
            }
        }
        Err(BagError::Refused { .. }) => {
            topic.dropped.fetch_add(1, Ordering::Relaxed);
        }
        Err(error) => return Err(error),
    }
    core.held.fetch_sub(data.len() + OVERHEAD, Ordering::AcqRel);
    open.get_or_insert_with(Instant::now);
    Ok(())
}

/// What was noted of losses in the file, and when.
struct Notes {
    last: BTreeMap<String, String>,
    at: Instant,
}

/// Ends the chunk that is being filled, and notes what is missing where that has changed.
fn end_chunk(
    core: &Core,
    writer: &mut BagWriter,
    open: &mut Option<Instant>,
    notes: &mut Notes,
) -> Result<(), BagError> {
    if notes.at.elapsed() >= NOTE {
        let topics = lock(&core.topics).iter().map(|s| (s.topic.name.clone(), s.losses())).collect();
        let now = RecordedLosses::to_custom(&topics);
        if now != notes.last {
            writer.note_losses(&now)?;
            *notes = Notes { last: now, at: Instant::now() };
        }
    }
    writer.flush()?;
    *open = None;
    core.keep_open_chunk();
    core.store_size(writer);
    Ok(())
}
