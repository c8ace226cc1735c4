//! `dermis record`: what nodes publish, into a bag.

use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use dermis_bag::RecorderState;
use dermis_operate::Progress;
use dermis_operate::record::{Request, Watcher, record};
use dermis_report::recording as report;
use indicatif::{ProgressBar, ProgressStyle};

use crate::backend::{Backends, Choice};

/// What to record, and how.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    request: Request,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

/// Runs until `end` or the end of its time.
pub async fn run(options: Options, backends: &Backends, end: impl Future<Output = ()>) -> Result<()> {
    let watcher = Line::new()?;
    let found = record(&options.request, backends.open(options.backend)?.as_ref(), end, &watcher).await?;
    if let Ok(recording) = &found.recording {
        let text = if options.json {
            serde_json::to_value(recording)?.to_string()
        } else {
            recording.info.to_string()
        };
        // The bag is complete, whether or not somebody still reads what is printed.
        let _ = writeln!(std::io::stdout(), "{}", text.trim_end());
    }
    for sentence in report::losses(&found.state) {
        let _ = writeln!(std::io::stderr(), "{sentence}");
    }
    Ok(found.require(options.request.complete)?)
}

/// How often the line is drawn on a terminal.
const DRAW: Duration = Duration::from_millis(500);
/// How often it is printed elsewhere.
const SAY: Duration = Duration::from_secs(15);

/// How a recording goes: a line that is drawn over on a terminal, a line now and then elsewhere.
struct Line {
    style: ProgressStyle,
    state: Mutex<Shown>,
}

struct Shown {
    /// From the beginning of the recording on, where standard error is a terminal.
    bar: Option<ProgressBar>,
    /// When the line was shown last, and how many bytes of messages there were then.
    last: (Instant, u64),
    /// What is waited for, as it was said last.
    waits: Option<&'static str>,
}

impl Line {
    fn new() -> Result<Self> {
        let style = ProgressStyle::with_template("{spinner} {elapsed_precise} {msg}")?;
        Ok(Self { style, state: Mutex::new(Shown { bar: None, last: (Instant::now(), 0), waits: None }) })
    }

    fn shown(&self) -> MutexGuard<'_, Shown> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shown {
    fn say(&self, sentence: &str) {
        match &self.bar {
            Some(bar) => bar.println(sentence),
            None => eprintln!("{sentence}"),
        }
    }
}

impl Progress for Line {
    fn note(&self, sentence: &str) {
        self.shown().say(sentence);
    }
}

impl Watcher for Line {
    fn begin(&self, folder: &Path) {
        let mut shown = self.shown();
        shown.bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new_spinner().with_style(self.style.clone());
            bar.set_message(format!("waiting for topics; to {}", folder.display()));
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        shown.last = (Instant::now(), 0);
    }

    fn at(&self, state: &RecorderState, elapsed: Duration) {
        let mut shown = self.shown();
        if state.waits != shown.waits {
            shown.waits = state.waits;
            shown.say(&report::waiting(state));
        }
        let (last, bytes) = shown.last;
        let since = last.elapsed();
        if since < if shown.bar.is_some() { DRAW } else { SAY } {
            return;
        }
        shown.last = (Instant::now(), state.payload_bytes);
        let line = report::line(state, bytes, since);
        match &shown.bar {
            Some(bar) => bar.set_message(line),
            None => eprintln!("{:.0} s: {line}", elapsed.as_secs_f64()),
        }
    }

    fn end(&self) {
        if let Some(bar) = &self.shown().bar {
            bar.finish_and_clear();
        }
    }
}
