//! Messages of several files in the order of their log times.

use std::{cmp::Ordering, collections::BinaryHeap};

use crate::{BagError, BagMessage, Messages, reader::Part};

/// A message that waits for earlier ones; the earliest is the greatest, those of one time keep their order.
struct Waiting {
    message: BagMessage,
    number: u64,
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |waiting: &Self| (waiting.message.log_time, waiting.number);
        key(other).cmp(&key(self))
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

/// One file.
struct Source {
    messages: Messages,
    part: Part,
    waiting: BinaryHeap<Waiting>,
    newest: i64,
    number: u64,
    /// Nothing more comes; what ended it, where that was an error.
    ended: Option<Result<(), BagError>>,
}

impl Source {
    /// Reads on until no message can come that is earlier than the earliest that waits.
    fn fill(&mut self) {
        while self.ended.is_none() {
            let settled = self
                .waiting
                .peek()
                .is_some_and(|first| self.newest.saturating_sub(first.message.log_time) > self.part.disorder);
            if settled {
                return;
            }
            match self.messages.next() {
                Some(Ok(message)) => {
                    self.newest = self.newest.max(message.log_time);
                    self.waiting.push(Waiting { message, number: self.number });
                    self.number += 1;
                }
                Some(Err(error)) => self.ended = Some(Err(error)),
                None => self.ended = Some(Ok(())),
            }
        }
    }

    fn next_time(&self) -> Option<i64> {
        self.waiting.peek().map(|first| first.message.log_time)
    }
}

/// Iterator over the messages of a bag in the order of their log times; it ends after the first error. A file is read from
/// its start on when the first of its messages is due, and as much of it is held in memory as its chunks overlap in time.
pub struct MessagesByTime {
    /// Not begun, the earliest last.
    later: Vec<Source>,
    open: Vec<Source>,
    failed: bool,
}

impl std::fmt::Debug for MessagesByTime {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MessagesByTime").field("later", &self.later.len()).finish_non_exhaustive()
    }
}

impl MessagesByTime {
    pub(crate) fn new(files: impl Iterator<Item = (Messages, Part)>) -> Self {
        let mut later: Vec<Source> = files
            .filter(|(_, part)| part.span.is_some())
            .map(|(messages, part)| Source {
                messages,
                part,
                waiting: BinaryHeap::new(),
                newest: i64::MIN,
                number: 0,
                ended: None,
            })
            .collect();
        later.sort_by_key(|source| std::cmp::Reverse(source.part.span));
        Self { later, open: Vec::new(), failed: false }
    }

    /// The open file whose message is next.
    fn earliest(&self) -> Option<(usize, i64)> {
        let times = self.open.iter().enumerate().filter_map(|(at, source)| Some((at, source.next_time()?)));
        times.min_by_key(|(_, time)| *time)
    }
}

impl Iterator for MessagesByTime {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = loop {
            let next = self.earliest();
            let begins = |source: &mut Source| {
                let start = source.part.span.map_or(i64::MIN, |(first, _)| first);
                next.is_none_or(|(_, time)| start <= time)
            };
            match self.later.pop_if(begins) {
                Some(mut source) => {
                    source.fill();
                    self.open.push(source);
                }
                None => break next,
            }
            // A file that a filter leaves nothing of.
            let done = |source: &Source| matches!(source.ended, Some(Ok(()))) && source.waiting.is_empty();
            self.open.retain(|source| !done(source));
        };
        let Some((at, _)) = next else {
            // What is open has nothing left: an error ended it, or it is done.
            let error = self.open.drain(..).find_map(|source| source.ended?.err());
            self.failed = true;
            return error.map(Err);
        };
        let source = &mut self.open[at];
        let message = source.waiting.pop().map(|waiting| waiting.message)?;
        source.fill();
        if source.waiting.is_empty() {
            let source = self.open.swap_remove(at);
            if let Some(Err(error)) = source.ended {
                // Its messages come first.
                self.open.push(Source { ended: Some(Err(error)), ..source });
            }
        }
        Some(Ok(message))
    }
}
