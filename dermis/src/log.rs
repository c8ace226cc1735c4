//! What the program says of itself while it works.

use std::io::IsTerminal;

use clap::ValueEnum;
use dermis_perception::cli::log_limit::{self, LogLimit};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _};

/// How log lines are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Human,
    /// One JSON object a line.
    Json,
}

/// Names the format where no option does; `dermis launch` sets it for what it starts.
const FORMAT: &str = "DERMIS_LOG_FORMAT";
/// A level, or a filter of `tracing`.
const FILTER: &str = "DERMIS_LOG";
/// zenoh reports every peer that comes and goes as a warning of its own.
const QUIET: &str = "zenoh=error,zenoh_transport=error,hiroz=warn";

impl Format {
    /// What the option says, or else the environment.
    ///
    /// # Errors
    ///
    /// One sentence where the environment says something else.
    pub fn choose(option: Option<Self>) -> Result<Self, String> {
        if let Some(format) = option {
            return Ok(format);
        }
        match std::env::var(FORMAT) {
            Ok(text) if !text.is_empty() => Self::from_str(&text, true)
                .map_err(|_| format!("environment variable {FORMAT} is `{text}`; give human or json")),
            _ => Ok(Self::Human),
        }
    }
}

/// Writes log lines to standard error, from `level` on where the environment does not say otherwise, and not too many of
/// one kind; what was left out is said by [`LogLimit::finish`] at the end.
pub fn start(format: Format, level: &str) -> LogLimit {
    let filter = filter(std::env::var(FILTER).ok().as_deref(), level);
    let filter = EnvFilter::try_new(filter).unwrap_or_else(|_| EnvFilter::new(level));
    let limit = LogLimit::default();
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let lines = match format {
        Format::Human => lines.with_ansi(std::io::stderr().is_terminal()).boxed(),
        Format::Json => lines.json().boxed(),
    };
    tracing_subscriber::registry().with(filter).with(limit.clone()).with(lines).init();
    limit
}

/// A level alone is one for us; whoever writes a filter wants that filter.
fn filter(requested: Option<&str>, level: &str) -> String {
    // How many lines were left out is said of those that pass the rest of the filter.
    let counts = format!("{}=info", log_limit::TARGET);
    match requested {
        Some(filter) if filter.contains(['=', ',']) => format!("{filter},{counts}"),
        Some(level) if !level.is_empty() => format!("{level},{QUIET},{counts}"),
        _ => format!("{level},{QUIET},{counts}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_keeps_the_network_quiet_and_a_filter_is_taken_as_it_is() {
        let counts = "dermis::left_out=info";
        assert_eq!(filter(Some("debug"), "info"), format!("debug,{QUIET},{counts}"));
        assert_eq!(filter(Some("zenoh=debug"), "info"), format!("zenoh=debug,{counts}"));
        assert_eq!(filter(None, "warn"), format!("warn,{QUIET},{counts}"));
        assert_eq!(filter(Some(""), "warn"), format!("warn,{QUIET},{counts}"));
        for text in [filter(None, "info"), filter(Some("off"), "info")] {
            EnvFilter::try_new(text).unwrap();
        }
    }
}
