//! What the program says of itself while it works.

use std::io::IsTerminal;

use clap::ValueEnum;
use tracing_subscriber::EnvFilter;

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

/// Writes log lines to standard error, from `level` on where the environment does not say otherwise.
pub fn start(format: Format, level: &str) {
    let filter = filter(std::env::var(FILTER).ok().as_deref(), level);
    let lines = tracing_subscriber::fmt()
        .with_env_filter(EnvFilter::try_new(filter).unwrap_or_else(|_| EnvFilter::new(level)))
        .with_writer(std::io::stderr);
    match format {
        Format::Human => lines.with_ansi(std::io::stderr().is_terminal()).init(),
        Format::Json => lines.json().init(),
    }
}

/// A level alone is one for us; whoever writes a filter wants that filter.
fn filter(asked: Option<&str>, level: &str) -> String {
    match asked {
        Some(filter) if filter.contains(['=', ',']) => filter.to_owned(),
        Some(level) if !level.is_empty() => format!("{level},{QUIET}"),
        _ => format!("{level},{QUIET}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_keeps_the_network_quiet_and_a_filter_is_taken_as_it_is() {
        assert_eq!(filter(Some("debug"), "info"), format!("debug,{QUIET}"));
        assert_eq!(filter(Some("zenoh=debug"), "info"), "zenoh=debug");
        assert_eq!(filter(None, "warn"), format!("warn,{QUIET}"));
        assert_eq!(filter(Some(""), "warn"), format!("warn,{QUIET}"));
        for text in [filter(None, "info"), filter(Some("off"), "info")] {
            EnvFilter::try_new(text).unwrap();
        }
    }
}
