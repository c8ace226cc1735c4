//! A recording that goes on: takes up topics as they appear, counts what is lost on the way to it, and says what is missing.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dermis_bag::{BagError, Recorded, Recorder, RecorderState, Topic, TopicSink};
use dermis_node::backend::EndpointKind;
use dermis_node::{Level, Node, PublicationCounter, Qos, Status, Subscription};

use super::selection::{Selection, adapt, support_of};
use crate::{OperateError, Progress};

/// A topic that was requested by name and is not published for so long is mentioned.
const ABSENT: Duration = Duration::from_secs(3);
/// How long what has arrived may take into the queue of the recorder, at the end of a subscription.
const DRAIN: Duration = Duration::from_secs(5);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A topic that is being recorded.
struct Taken {
    /// Taken out while it is replaced by one with other terms.
    subscription: Option<Subscription>,
    sink: TopicSink,
    qos: Qos,
    /// Counts over all subscriptions, so that what is lost between two of them counts, too.
    counter: Arc<Mutex<PublicationCounter>>,
}

impl Taken {
    /// Says to the recorder what was lost on the way.
    fn tell_losses(&self, numbered: bool) {
        let losses = lock(&self.counter).losses();
        // Where nothing came, nothing is missing that anybody knows of; where all came without a number, it is not known.
        let nothing_came = losses.numbered == 0 && losses.unnumbered == 0;
        let lost = losses.known().or((numbered && nothing_came).then_some(0));
        self.sink.set_lost(lost.filter(|lost| *lost > 0 || losses.unnumbered == 0));
    }

    /// Ends its subscription; what had arrived is recorded.
    fn end(&mut self) {
        let Some(subscription) = self.subscription.take() else { return };
        let unread = subscription.finish(DRAIN);
        let numbered = lock(&self.counter).losses().known().is_some();
        // What its queue dropped is a step in the numbers, where there are numbers.
        self.sink.add_dropped(unread.waiting + if numbered { 0 } else { unread.dropped });
    }
}

/// How it ended.
pub struct Ended {
    pub recorded: Result<Recorded, BagError>,
    /// What was recorded and lost, also where the bag could not be completed.
    pub state: RecorderState,
    /// Topics that were requested by name and on which nothing came, each with why.
    pub silent: Vec<(String, String)>,
}

pub struct Session {
    node: Node,
    recorder: Recorder,
    selection: Selection,
    taken: BTreeMap<String, Taken>,
    began: Instant,
    /// Topics that were requested and were not published for a while.
    absent: BTreeSet<String>,
    /// Topics that cannot be recorded, and why, each said once.
    said: BTreeSet<(String, String)>,
}

impl Session {
    pub fn new(node: Node, recorder: Recorder, selection: Selection) -> Self {
        let state = recorder.watch();
        let mut before = (0, 0);
        node.diagnostics().add("recorder", move || {
            let state = state();
            let status = status(&state, before);
            before = (state.lost.unwrap_or(0), state.dropped);
            status
        });
        Self {
            node,
            recorder,
            selection,
            taken: BTreeMap::new(),
            began: Instant::now(),
            absent: BTreeSet::new(),
            said: BTreeSet::new(),
        }
    }

    pub fn state(&self) -> RecorderState {
        self.recorder.state()
    }

    pub fn failed(&self) -> bool {
        self.recorder.failed()
    }

    /// Whether publishers number their messages, as far as the backend can tell.
    fn is_numbered(&self) -> bool {
        self.node.backend_name() == "hiroz"
    }

    /// Takes up topics that appeared, and tells the recorder what was lost so far.
    pub fn look_around(&mut self, progress: &dyn Progress) {
        match self.node.topics() {
            Ok(topics) => self.take_up(topics, progress),
            Err(error) => self.say(progress, "the ROS graph", &error.to_string()),
        }
        let numbered = self.is_numbered();
        for taken in self.taken.values() {
            taken.tell_losses(numbered);
        }
        self.watch_absent(progress);
    }

    fn take_up(&mut self, topics: Vec<(String, String)>, progress: &dyn Progress) {
        let mut by_name: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (name, type_name) in topics {
            by_name.entry(name).or_default().push(type_name);
        }
        let there: Vec<_> = by_name.iter().map(|(name, types)| (name.as_str(), types[0].as_str())).collect();
        let wanted: BTreeSet<String> = self.selection.chosen(&there).into_iter().map(str::to_owned).collect();
        for (name, types) in by_name {
            if !wanted.contains(&name) {
                continue;
            }
            if let Err(why) = self.take(&name, &types) {
                self.say(progress, &name, &why.whole());
            }
        }
    }

    fn say(&mut self, progress: &dyn Progress, what: &str, why: &str) {
        if self.said.insert((what.to_owned(), why.to_owned())) {
            progress.note(&format!("{what} is not recorded: {why}"));
        }
    }

    /// Says of topics that were requested that nobody publishes them, and when somebody does.
    fn watch_absent(&mut self, progress: &dyn Progress) {
        if self.began.elapsed() < ABSENT {
            return;
        }
        for name in &self.selection.topics {
            let known = self.taken.contains_key(name) || self.said.iter().any(|(what, _)| what == name);
            if !known && self.absent.insert(name.clone()) {
                progress.note(&format!("nobody publishes {name} yet: it is recorded once somebody does"));
            } else if known && self.absent.remove(name) {
                progress.note(&format!("{name} is published now"));
            }
        }
    }

    fn take(&mut self, name: &str, types: &[String]) -> Result<(), OperateError> {
        let mut offers = self.node.endpoints(name, EndpointKind::Publisher)?;
        offers.retain(|offer| !offer.own);
        let Some(first) = offers.first() else { return Ok(()) };
        let (wanted, offered) = adapt(&offers, self.node.backend_name());
        if let Some(taken) = self.taken.get(name)
            && (taken.qos == wanted || wanted.unmet_by(&taken.qos).is_none())
        {
            return Ok(());
        }
        if types.len() > 1 {
            return Err(OperateError::TypesDisagree(types.join(", ")));
        }
        let support = support_of(first)?;
        let sink = self.recorder.topic(Topic::of_type(name, support, Some(offered)));
        let taken = self.taken.entry(name.to_owned()).or_insert_with(|| Taken {
            subscription: None,
            sink,
            qos: wanted,
            counter: Arc::default(),
        });
        // Before a new subscription with other terms, the old one ends.
        taken.end();
        let (queue, counter) = (taken.sink.clone(), Arc::clone(&taken.counter));
        let subscription = self.node.subscribe_raw(name, support, wanted, move |data, info| {
            lock(&counter).observe(info.publication, info.source_ns);
            let published = info.source_ns.unwrap_or(info.received_ns);
            // What does not fit is counted there.
            let _ = queue.push(data.to_vec(), info.received_ns, published);
        })?;
        taken.subscription = Some(subscription);
        taken.qos = wanted;
        Ok(())
    }

    /// Ends the subscriptions, and completes the bag.
    pub fn finish(mut self, custom: Vec<(String, String)>) -> Ended {
        let numbered = self.is_numbered();
        for taken in self.taken.values_mut() {
            taken.end();
            taken.tell_losses(numbered);
        }
        let state = self.recorder.watch();
        let recorded = self.recorder.finish(custom);
        let silent = self.selection.topics.iter().filter_map(|name| {
            let why = match self.taken.get(name) {
                Some(taken) if taken.sink.recorded() + taken.sink.dropped() > 0 => return None,
                Some(_) => "it was published, but no message came".to_owned(),
                None => match self.said.iter().find(|(what, _)| what == name) {
                    Some((_, why)) => why.clone(),
                    None => "nobody published it".to_owned(),
                },
            };
            Some((name.clone(), why))
        });
        let silent = silent.collect();
        self.node.shutdown();
        let state = recorded.as_ref().map_or_else(|_| state(), |recorded| recorded.state.clone());
        Ended { recorded, state, silent }
    }
}

/// The diagnostics of a recorder; `before` is what was lost and dropped at the last report.
fn status(state: &RecorderState, before: (u64, u64)) -> Status {
    let mut status = Status::ok(format!("recording {} topics", state.topics.len()));
    if let Some(lost) = state.lost.filter(|lost| *lost > before.0) {
        status.worsen(Level::Warn, format!("{} messages were lost on the way", lost - before.0));
    }
    if state.dropped > before.1 {
        status.worsen(Level::Warn, format!("{} messages were dropped", state.dropped - before.1));
    }
    if let Some(reason) = state.waits {
        status.worsen(Level::Error, format!("waiting for room: {reason}"));
    }
    status.value("messages", state.messages);
    status.value("bytes of the files", state.stored_bytes);
    status.value("bytes that wait for the disk", state.queued_bytes);
    status
        .value("lost on the way", state.lost.map_or_else(|| "not known".to_owned(), |lost| lost.to_string()));
    status.value("dropped", state.dropped);
    status.value("waited for room (s)", format!("{:.1}", state.paused_ms as f64 * 1e-3));
    for topic in &state.topics {
        match topic.lost {
            Some(0) => {}
            Some(lost) => status.value(format!("{}: lost on the way", topic.name), lost),
            None => status.value(format!("{}: lost on the way", topic.name), "not known"),
        }
        if topic.dropped > 0 {
            status.value(format!("{}: dropped", topic.name), topic.dropped);
        }
    }
    status
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn diagnostics_tell_what_is_missing() {
        let mut state = RecorderState { messages: 10, lost: None, dropped: 0, ..RecorderState::default() };
        let value = |status: &Status, key: &str| {
            status.values.iter().find(|(k, _)| k == key).map(|(_, value)| value.clone()).unwrap_or_default()
        };
        let quiet = status(&state, (0, 0));
        assert_eq!((quiet.level, value(&quiet, "lost on the way").as_str()), (Level::Ok, "not known"));
        (state.lost, state.dropped) = (Some(7), 3);
        let lossy = status(&state, (5, 3));
        assert_eq!((lossy.level, lossy.message.as_str()), (Level::Warn, "2 messages were lost on the way"));
        assert_eq!(status(&state, (7, 3)).level, Level::Ok);
        state.waits = Some("the disk is full");
        assert_eq!(status(&state, (7, 0)).message, "waiting for room: the disk is full");
    }
}
