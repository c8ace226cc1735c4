//! What a bag tells over time beside its frames, in the order of stamps: ground truth, poses, forces.
//!
//! A [`Gathered`] is what is found on the first reading: all of it where it is little, and else only its order and its span. A [`Track`] then
//! gives what lies around a frame: out of memory, or by reading the bag once more beside the frames, so that memory holds what lies between
//! two of them and a window ([`InOrder`]). Assumption: what is told lies at most [`WINDOW`] messages of its own topic out of order; how topics
//! lie among each other does not matter. Cost: one more reading of the bag for each track.

use std::collections::VecDeque;

use dermis_bag::{BagMessage, BagReader, Filter, Messages};
use dermis_skin::Stamp;

use super::order::{InOrder, WINDOW};
use crate::LearnError;

/// What was found on the first reading.
#[derive(Debug)]
pub(crate) struct Gathered<T> {
    held: Vec<(Stamp, T)>,
    /// Where they are too many to be held.
    order: Option<InOrder<()>>,
    span: Option<(Stamp, Stamp)>,
    count: usize,
}

impl<T> Default for Gathered<T> {
    fn default() -> Self {
        Self { held: Vec::new(), order: None, span: None, count: 0 }
    }
}

impl<T> Gathered<T> {
    /// Holds none of them.
    pub(crate) fn streamed() -> Self {
        Self { order: Some(InOrder::new(WINDOW)), ..Self::default() }
    }

    pub(crate) fn push(&mut self, stamp: Stamp, item: T) {
        let (first, last) = self.span.unwrap_or((stamp, stamp));
        self.span = Some((first.min(stamp), last.max(stamp)));
        self.count += 1;
        match &mut self.order {
            None => self.held.push((stamp, item)),
            Some(order) => {
                order.push(stamp, ());
                while order.pop(false).is_some() {}
            }
        }
    }

    /// How many were found.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// First and last stamp.
    pub(crate) fn span(&self) -> Option<(Stamp, Stamp)> {
        self.span
    }

    /// How many come too late to be used.
    pub(crate) fn late(&self) -> usize {
        self.order.as_ref().map_or(0, InOrder::late)
    }

    /// Hands over those that are held.
    pub(crate) fn take(&mut self) -> Vec<(Stamp, T)> {
        std::mem::take(&mut self.held)
    }

    /// In order. Of several of one stamp, `distinct` keeps the first. `from` says how to read them anew.
    pub(crate) fn into_track(self, distinct: bool, from: FromBag<T>) -> Track<T>
    where
        T: 'static,
    {
        let Some(mut order) = self.order else {
            let mut held = self.held;
            held.sort_by_key(|(stamp, _)| *stamp);
            if distinct {
                held.dedup_by_key(|(stamp, _)| *stamp);
            }
            return Track::Held(held);
        };
        while order.pop(true).is_some() {}
        let window = order.needed();
        let open = Box::new(move || from.read(window, distinct));
        Track::Streamed(Box::new(Streamed { rest: open(), open, near: VecDeque::new() }))
    }
}

/// What makes stamped things of a message.
type Take<T> = dyn Fn(&BagMessage, &mut InOrder<T>) -> Result<(), LearnError>;

/// Where things are in a bag, and how they are read.
pub(crate) struct FromBag<T> {
    pub(crate) bag: BagReader,
    pub(crate) filter: Filter,
    pub(crate) take: std::sync::Arc<Take<T>>,
}

impl<T> FromBag<T> {
    fn read(&self, window: usize, distinct: bool) -> Reading<T> {
        Reading {
            messages: self.bag.messages_where(self.filter.clone()),
            take: self.take.clone(),
            order: InOrder::new(window),
            distinct,
            last: None,
            ended: false,
        }
    }
}

/// A bag that is being read.
pub(crate) struct Reading<T> {
    messages: Messages,
    take: std::sync::Arc<Take<T>>,
    order: InOrder<T>,
    distinct: bool,
    last: Option<Stamp>,
    ended: bool,
}

impl<T> Iterator for Reading<T> {
    type Item = Result<(Stamp, T), LearnError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            while let Some((stamp, item)) = self.order.pop(self.ended) {
                if !(self.distinct && self.last == Some(stamp)) {
                    self.last = Some(stamp);
                    return Some(Ok((stamp, item)));
                }
            }
            if self.ended {
                return None;
            }
            let taken = match self.messages.next() {
                Some(Ok(message)) => (self.take)(&message, &mut self.order),
                Some(Err(error)) => Err(error.into()),
                None => {
                    self.ended = true;
                    Ok(())
                }
            };
            if let Err(error) = taken {
                return Some(Err(error));
            }
        }
    }
}

/// Things in order of their stamps, as they are needed along the frames of a bag.
pub(crate) enum Track<T> {
    /// All of them.
    Held(Vec<(Stamp, T)>),
    /// Those around the last stamp that was asked for.
    Streamed(Box<Streamed<T>>),
}

/// Things that are read beside the frames.
pub(crate) struct Streamed<T> {
    /// Reads them from the beginning.
    open: Box<dyn Fn() -> Reading<T>>,
    /// Those that are not read yet.
    rest: Reading<T>,
    /// The last one before the stamp that was asked for, and those from then on that were read.
    near: VecDeque<(Stamp, T)>,
}

impl<T: Clone> Track<T> {
    /// At least the last one before `stamp` and the first one from it on, in order. From call to call, stamps must not become less.
    pub(crate) fn around(&mut self, stamp: Stamp) -> Result<&[(Stamp, T)], LearnError> {
        match self {
            Self::Held(all) => Ok(all),
            Self::Streamed(streamed) => {
                let Streamed { rest, near, .. } = &mut **streamed;
                loop {
                    while near.get(1).is_some_and(|(second, _)| *second < stamp) {
                        near.pop_front();
                    }
                    if near.back().is_some_and(|(last, _)| *last >= stamp) {
                        break;
                    }
                    let Some(next) = rest.next() else { break };
                    near.push_back(next?);
                }
                Ok(near.make_contiguous())
            }
        }
    }

    /// All of them, one after the other.
    pub(crate) fn all(&self) -> Box<dyn Iterator<Item = Result<(Stamp, T), LearnError>> + '_> {
        match self {
            Self::Held(all) => Box::new(all.iter().cloned().map(Ok)),
            Self::Streamed(streamed) => Box::new((streamed.open)()),
        }
    }

    /// Whether they are read anew.
    pub(crate) fn is_streamed(&self) -> bool {
        matches!(self, Self::Streamed(_))
    }

    /// Begins anew with any stamp.
    pub(crate) fn rewind(&mut self) {
        if let Self::Streamed(streamed) = self {
            streamed.rest = (streamed.open)();
            streamed.near.clear();
        }
    }
}
