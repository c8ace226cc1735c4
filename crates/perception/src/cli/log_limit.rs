//! A limit on log lines of one kind, for the programs.
//!
//! A fault on a line or a bus comes with every frame, and so would its log line: thousands a second, which fill a disk and
//! hide what else happens. So the first line of a kind is written, and what follows of that kind within [`PERIOD`] is
//! counted; then one line says how many there were. It acts on what every crate logs, also those of others (zenoh), where
//! a limit at each place would miss some.
//!
//! Two lines are of one kind when they come from the same place of the code and differ in numbers only. A place whose
//! lines differ in more (it shows what came over the line) may write [`MOST`] of them in that time. Lines below INFO are
//! for whoever asks for them, and not limited.

use std::collections::HashMap;
use std::fmt::{Debug, Write as _};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tracing::dispatcher::WeakDispatch;
use tracing::field::{Field, Visit};
use tracing::{Dispatch, Event, Level, Subscriber, callsite};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// Shortest time between two lines of one kind.
pub const PERIOD: Duration = Duration::from_secs(5);
/// Most lines of different kinds from one place of the code in that time.
pub const MOST: usize = 20;
/// How often it is looked whether counts are to be said.
const LOOK: Duration = Duration::from_secs(1);
/// Target of the lines that say counts; they are never limited.
pub const TARGET: &str = "dermis::left_out";

/// A layer for a subscriber of `tracing`; clones share their counts.
///
/// ```
/// use dermis_perception::cli::log_limit::LogLimit;
/// use tracing_subscriber::layer::SubscriberExt as _;
/// let limit = LogLimit::default();
/// let subscriber = tracing_subscriber::registry().with(limit.clone()).with(tracing_subscriber::fmt::layer());
/// tracing::subscriber::with_default(subscriber, || {
///     for _ in 0..1000 {
///         tracing::warn!("this is written once");
///     }
///     limit.finish(); // "999 more like this: this is written once"
/// });
/// ```
#[derive(Debug, Clone, Default)]
pub struct LogLimit(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    sites: HashMap<callsite::Identifier, Site>,
    /// Whether a thread looks after the counts.
    watched: bool,
    /// Where counts are written.
    dispatch: Option<WeakDispatch>,
}

/// A place of the code that logs.
#[derive(Debug)]
struct Site {
    level: Level,
    kinds: HashMap<u64, Kind>,
    /// When the time that `written` counts over began.
    since: Instant,
    written: usize,
    /// Lines of kinds beyond [`MOST`].
    beyond: Option<Kind>,
}

#[derive(Debug)]
struct Kind {
    since: Instant,
    left_out: u64,
    text: String,
}

/// A line that says a count.
type Said = (Level, String);

impl Kind {
    fn new(now: Instant, text: &str) -> Self {
        Self { since: now, left_out: 0, text: text.to_owned() }
    }

    fn is_over(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.since) >= PERIOD
    }

    /// Leaves a line out; the text is that of the latest.
    fn leave_out(&mut self, text: &str) {
        self.left_out += 1;
        text.clone_into(&mut self.text);
    }

    /// How many were left out, where some were; counts from the beginning then.
    fn say(&mut self, now: Instant) -> Option<String> {
        let count = std::mem::take(&mut self.left_out);
        let seconds = now.saturating_duration_since(std::mem::replace(&mut self.since, now)).as_secs_f64();
        (count > 0).then(|| format!("{count} more like this in {seconds:.0} s: {}", self.text))
    }
}

impl Site {
    fn allows(&mut self, kind: u64, text: &str, now: Instant) -> bool {
        if now.saturating_duration_since(self.since) >= PERIOD {
            self.since = now;
            self.written = 0;
        }
        if let Some(known) = self.kinds.get_mut(&kind) {
            if known.left_out > 0 || !known.is_over(now) {
                known.leave_out(text);
                return false;
            }
            self.kinds.remove(&kind);
        }
        if self.written >= MOST {
            self.beyond.get_or_insert_with(|| Kind::new(now, text)).leave_out(text);
            return false;
        }
        self.written += 1;
        self.kinds.insert(kind, Kind::new(now, text));
        true
    }

    /// Says the counts whose time is over, or all; forgets kinds that do not come any more.
    fn say(&mut self, now: Instant, all: bool, said: &mut Vec<Said>) {
        let level = self.level;
        self.kinds.retain(|_, kind| {
            if !all && !kind.is_over(now) {
                return true;
            }
            let text = kind.say(now);
            let goes_on = text.is_some() && !all;
            said.extend(text.map(|text| (level, text)));
            goes_on
        });
        if self.beyond.as_ref().is_some_and(|kind| all || kind.is_over(now)) {
            let text = self.beyond.take().and_then(|mut kind| kind.say(now));
            said.extend(text.map(|text| (level, text)));
        }
    }
}

impl State {
    fn allows(&mut self, site: callsite::Identifier, level: Level, seen: &Seen, now: Instant) -> bool {
        let new = || Site { level, kinds: HashMap::new(), since: now, written: 0, beyond: None };
        self.sites.entry(site).or_insert_with(new).allows(seen.kind.finish(), &seen.text, now)
    }

    fn say(&mut self, now: Instant, all: bool) -> Vec<Said> {
        let mut said = Vec::new();
        self.sites.retain(|_, site| {
            site.say(now, all, &mut said);
            !site.kinds.is_empty() || site.beyond.is_some()
        });
        said
    }

    fn waits(&self) -> bool {
        self.sites
            .values()
            .any(|site| site.beyond.is_some() || site.kinds.values().any(|kind| kind.left_out > 0))
    }
}

impl LogLimit {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says what was left out and not yet said: for the end of a program.
    pub fn finish(&self) {
        let said = self.state().say(Instant::now(), true);
        write(said);
    }

    /// Says counts when their time is over, until there are none.
    fn watch(&self) {
        let limit = self.clone();
        let looks = move || {
            let dispatch = limit.state().dispatch.as_ref().and_then(WeakDispatch::upgrade);
            let _logs = dispatch.as_ref().map(tracing::dispatcher::set_default);
            loop {
                std::thread::sleep(LOOK);
                let (said, waits) = {
                    let mut state = limit.state();
                    let said = state.say(Instant::now(), false);
                    let waits = state.waits() || !said.is_empty();
                    state.watched = waits;
                    (said, waits)
                };
                write(said);
                if !waits {
                    return;
                }
            }
        };
        // Without the thread, counts are said at the end.
        let _ = std::thread::Builder::new().name("dermis-log".to_owned()).spawn(looks);
    }
}

fn write(said: Vec<Said>) {
    for (level, text) in said {
        match level {
            Level::ERROR => tracing::error!(target: TARGET, "{text}"),
            Level::WARN => tracing::warn!(target: TARGET, "{text}"),
            _ => tracing::info!(target: TARGET, "{text}"),
        }
    }
}

impl<S: Subscriber> Layer<S> for LogLimit {
    fn on_register_dispatch(&self, dispatch: &Dispatch) {
        self.state().dispatch = Some(dispatch.downgrade());
    }

    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if *metadata.level() > Level::INFO || metadata.target() == TARGET {
            return true;
        }
        let mut seen = Seen::default();
        event.record(&mut seen);
        let mut state = self.state();
        let allowed = state.allows(metadata.callsite(), *metadata.level(), &seen, Instant::now());
        let watch = !allowed && !state.watched;
        state.watched |= watch;
        drop(state);
        if watch {
            self.watch();
        }
        allowed
    }
}

/// What an event says.
#[derive(Default)]
struct Seen {
    text: String,
    kind: DefaultHasher,
}

impl Visit for Seen {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        let from = self.text.len();
        let gap = if from == 0 { "" } else { " " };
        // Writing to a text does not fail.
        let _ = match field.name() {
            "message" => write!(self.text, "{gap}{value:?}"),
            name => write!(self.text, "{gap}{name}={value:?}"),
        };
        without_numbers(&self.text[from..], &mut self.kind);
    }
}

/// Hashes a text but for its numbers; a digit in a name (`ttyACM0`, `pad_2`) is none.
fn without_numbers(text: &str, hasher: &mut impl Hasher) {
    let (mut in_word, mut in_number) = (false, false);
    for c in text.chars() {
        in_number = c.is_ascii_digit() && !in_word || in_number && matches!(c, '.' | ',');
        if in_number {
            continue;
        }
        in_word = c.is_alphanumeric() || c == '_';
        c.hash(hasher);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use tracing_subscriber::layer::SubscriberExt as _;

    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    fn logged(work: impl FnOnce(&LogLimit)) -> Vec<String> {
        let (lines, limit) = (Lines::default(), LogLimit::default());
        let sink = lines.clone();
        let format = tracing_subscriber::fmt::layer()
            .with_ansi(false)
            .without_time()
            .with_target(false)
            .with_writer(move || sink.clone());
        let subscriber = tracing_subscriber::registry().with(limit.clone()).with(format);
        tracing::subscriber::with_default(subscriber, || work(&limit));
        let bytes = lines.0.lock().unwrap().clone();
        String::from_utf8(bytes).unwrap().lines().map(|line| line.trim().to_owned()).collect()
    }

    #[test]
    fn one_of_a_kind_is_written_and_the_rest_is_counted() {
        let lines = logged(|limit| {
            for frame in 0..24_849 {
                tracing::warn!("skin `pad_1`: frame {frame} has a bad checksum");
            }
            tracing::warn!("skin `pad_2`: it is another skin");
            for node in ["/left/pad", "/right/pad"] {
                tracing::warn!(node, "no frame for {:.1} s", 2.5);
            }
            limit.finish();
            limit.finish();
        });
        let mut sorted = lines[..4].to_vec();
        sorted.sort();
        insta::assert_snapshot!(sorted.join("\n"), @r#"
        WARN no frame for 2.5 s node="/left/pad"
        WARN no frame for 2.5 s node="/right/pad"
        WARN skin `pad_1`: frame 0 has a bad checksum
        WARN skin `pad_2`: it is another skin
        "#);
        let (count, of) = lines[4].trim_start_matches("WARN ").split_once(" more like this in ").unwrap();
        assert_eq!((count, lines.len()), ("24848", 5), "{lines:?}");
        assert!(of.ends_with("s: skin `pad_1`: frame 24848 has a bad checksum"), "{of}");
    }

    #[test]
    fn a_place_that_shows_what_came_is_limited_as_a_whole() {
        let lines = logged(|limit| {
            for word in 0..1000_u32 {
                let word: String = word.to_string().chars().map(|c| char::from(c as u8 + 49)).collect();
                tracing::error!("the device sent {word}");
            }
            limit.finish();
        });
        assert_eq!(lines.len(), MOST + 1);
        assert!(lines[MOST].starts_with("ERROR 980 more like this in "), "{}", lines[MOST]);
    }

    #[test]
    fn counts_are_said_while_it_goes_on_and_nothing_is_kept_after() {
        let lines = logged(|limit| {
            let begun = Instant::now();
            let mut written = 0;
            while begun.elapsed() < PERIOD + 3 * LOOK {
                tracing::info!("again");
                written += 1;
                std::thread::sleep(Duration::from_millis(20));
            }
            limit.finish();
            assert!(limit.state().sites.is_empty() && written > 50);
            tracing::info!("again");
        });
        assert!((3..=5).contains(&lines.len()), "{lines:?}");
        assert!(
            lines[1].contains(" more like this in 5 s: again") || lines[1].contains(" in 6 s: again"),
            "{lines:?}"
        );
        assert!(lines.last().is_some_and(|line| line == "INFO again"), "what is over may be said anew");
    }

    #[test]
    fn who_asks_for_details_gets_them() {
        let lines = logged(|_| {
            for _ in 0..100 {
                tracing::debug!("a detail");
            }
        });
        assert_eq!(lines.len(), 100);
    }
}
