//! Shows how a recording goes: a line that is drawn over on a terminal, a line now and then elsewhere.

use std::cell::Cell;
use std::io::IsTerminal;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Result;
use dermis_bag::RecorderState;
use indicatif::{ProgressBar, ProgressStyle};

/// How often progress is shown on a terminal.
const DRAW: Duration = Duration::from_millis(500);
/// How often it is said elsewhere.
const SAY: Duration = Duration::from_secs(15);

pub struct Progress {
    bar: Option<ProgressBar>,
    last: Cell<(Instant, u64)>,
    /// What is waited for, as it was said last.
    waits: Cell<Option<&'static str>>,
}

impl Progress {
    pub fn start(out: &Path) -> Result<Self> {
        let bar = std::io::stderr().is_terminal().then(|| -> Result<_> {
            let bar = ProgressBar::new_spinner();
            bar.set_style(ProgressStyle::with_template("{spinner} {elapsed_precise} {msg}")?);
            bar.set_message(format!("waiting for topics; to {}", out.display()));
            bar.enable_steady_tick(Duration::from_millis(250));
            Ok(bar)
        });
        Ok(Self { bar: bar.transpose()?, last: Cell::new((Instant::now(), 0)), waits: Cell::new(None) })
    }

    /// Says a sentence at once.
    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None => eprintln!("{text}"),
        }
    }

    /// Shows where the recording is, now and then; that it waits, at once.
    pub fn show(&self, state: &RecorderState, elapsed: Duration) {
        if state.waits != self.waits.replace(state.waits) {
            match state.waits {
                Some(reason) => self.say(&format!(
                    "{reason}: recording waits for room; messages are kept in memory as far as --buffer allows, and counted beyond"
                )),
                None => self.say(&format!(
                    "there is room again, after {:.1} s in all: recording goes on, in a new file",
                    state.paused_ms as f64 * 1e-3
                )),
            }
        }
        let (last, bytes) = self.last.get();
        let since = last.elapsed();
        if since < if self.bar.is_some() { DRAW } else { SAY } {
            return;
        }
        let rate = (state.payload_bytes - bytes) as f64 / since.as_secs_f64() * 1e-6;
        self.last.set((Instant::now(), state.payload_bytes));
        let line = format!(
            "{} messages on {} topics, {:.1} MB, {rate:.1} MB/s, {} lost on the way, {} dropped{}",
            state.messages,
            state.topics.len(),
            state.payload_bytes as f64 * 1e-6,
            state.lost.map_or_else(|| "not known how many".to_owned(), |lost| lost.to_string()),
            state.dropped,
            state.waits.map_or_else(String::new, |reason| format!("; waiting, because {reason}")),
        );
        match &self.bar {
            Some(bar) => bar.set_message(line),
            None => eprintln!("{:.0} s: {line}", elapsed.as_secs_f64()),
        }
    }

    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
