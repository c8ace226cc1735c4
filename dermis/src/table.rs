//! The table of what skins feel, as `dermis demo` and `dermis watch` show it.
//!
//! On a terminal the table is drawn over the last one, several times a second; elsewhere it is one line a second for each skin,
//! which a log can hold.

use std::io::{IsTerminal, Write};
use std::time::Duration;

use dermis_operate::Touch;
use dermis_report::touch::lines;

/// Where the table is drawn.
pub struct Table {
    terminal: bool,
    /// Lines of the last table, on a terminal.
    drawn: usize,
    /// Seconds that lines were printed of, elsewhere.
    seconds: u64,
}

impl Table {
    /// On standard output.
    pub fn begin() -> Self {
        Self { terminal: std::io::stdout().is_terminal(), drawn: 0, seconds: 0 }
    }

    /// Draws what each skin feels now, this long after the beginning.
    ///
    /// # Errors
    ///
    /// When standard output is closed.
    pub fn draw<'a>(
        &mut self,
        elapsed: Duration,
        skins: impl Iterator<Item = &'a Touch>,
    ) -> std::io::Result<()> {
        let second = elapsed.as_secs();
        if !self.terminal && second <= self.seconds {
            return Ok(());
        }
        self.seconds = second;
        let (elapsed, now) = (elapsed.as_secs_f64(), dermis_transport::now_ns());
        let tables: Vec<Vec<String>> = skins.map(|skin| lines(skin, elapsed, now)).collect();
        let mut out = std::io::stdout().lock();
        if !self.terminal {
            for lines in &tables {
                let last = lines.last().map_or("", |l| l.trim());
                writeln!(out, "{}  {last}", lines.first().map_or("", String::as_str))?;
            }
            return out.flush();
        }
        let (height, width) = console::Term::stdout().size();
        if self.drawn > 0 {
            write!(out, "\x1b[{}A\x1b[J", self.drawn)?;
        }
        self.drawn = 0;
        // A line that wraps, or scrolls out, would not be drawn over.
        for line in tables.iter().flatten().take(usize::from(height).saturating_sub(1)) {
            writeln!(out, "{}", console::truncate_str(line, usize::from(width), "…"))?;
            self.drawn += 1;
        }
        out.flush()
    }
}
