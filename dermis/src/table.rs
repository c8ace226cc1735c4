//! The table of what skins feel, as `dermis demo` and `dermis watch` show it.
//!
//! On a terminal the table is drawn over the last one, several times a second; elsewhere it is one line a second for each skin,
//! which a log can hold.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use dermis_msgs::msg::{Contact, ContactArray};

use crate::stats::Samples;

/// How often the table is drawn.
pub const DRAW: Duration = Duration::from_millis(200);
/// \[ns\] over which the rate that is shown is counted.
const RATE_OVER: i64 = 3_000_000_000;
/// Latencies that are kept: those of the last ten seconds of a fast skin, or of a hundred of a usual one.
const LATENCIES: usize = 10_000;
/// \[s\] without a message after which the table says so.
const SILENT: f64 = 1.0;
/// \[m\] beyond which a contact is not in the plane z = 0, and the table has a column for z.
const FLAT: f64 = 1e-9;

/// What came from one skin.
#[derive(Debug)]
pub struct Felt {
    name: String,
    /// Contact arrays that came.
    pub arrays: u64,
    /// Those with a contact.
    pub touched: u64,
    /// Arrays by status.
    pub statuses: [u64; 5],
    /// From acquisition to arrival here; the last [`LATENCIES`].
    pub latency_ms: Samples,
    /// The last one.
    pub latest: Option<ContactArray>,
    first_ns: i64,
    last_ns: i64,
    recent: VecDeque<i64>,
}

impl Felt {
    /// Nothing yet of the skin of this name.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            arrays: 0,
            touched: 0,
            statuses: [0; 5],
            latency_ms: Samples::last(LATENCIES),
            latest: None,
            first_ns: 0,
            last_ns: 0,
            recent: VecDeque::new(),
        }
    }

    /// Shows it by another name.
    pub fn rename(&mut self, name: String) {
        self.name = name;
    }

    /// Takes what came at a time [ns since the Unix epoch].
    pub fn take(&mut self, array: ContactArray, received_ns: i64) {
        if self.arrays == 0 {
            self.first_ns = received_ns;
        }
        self.arrays += 1;
        self.last_ns = received_ns;
        self.recent.push_back(received_ns);
        while self.recent.front().is_some_and(|at| received_ns.saturating_sub(*at) > RATE_OVER) {
            self.recent.pop_front();
        }
        self.latency_ms.push(received_ns.saturating_sub(array.header.stamp.as_nanos()) as f64 * 1e-6);
        self.touched += u64::from(!array.contacts.is_empty());
        if let Some(count) = self.statuses.get_mut(usize::from(array.status)) {
            *count += 1;
        }
        self.latest = Some(array);
    }

    /// \[1/s\] from the first array to the last.
    pub fn rate(&self) -> f64 {
        rate(self.arrays, self.first_ns, self.last_ns)
    }

    /// \[1/s\] over the last seconds.
    pub fn recent_rate(&self) -> f64 {
        let (Some(first), Some(last)) = (self.recent.front(), self.recent.back()) else { return 0.0 };
        rate(self.recent.len() as u64, *first, *last)
    }

    /// \[s\] since the last array.
    pub fn silent(&self, now_ns: i64) -> f64 {
        now_ns.saturating_sub(self.last_ns) as f64 * 1e-9
    }

    /// Name, rate and latency, then what is felt, a contact a line.
    pub fn lines(&self, elapsed: f64, now_ns: i64) -> Vec<String> {
        let (p50, p99) = (self.latency_ms.percentile(50.0), self.latency_ms.percentile(99.0));
        let mut lines = vec![format!(
            "{}  {elapsed:6.1} s  {:6.1} frames/s  latency {p50:.2} ms median, {p99:.2} ms p99",
            self.name,
            self.recent_rate(),
        )];
        let Some(array) = &self.latest else {
            lines.push("  waiting for the first frame".to_owned());
            return lines;
        };
        let silent = self.silent(now_ns);
        if silent > SILENT {
            lines.push(format!("  nothing has come for {silent:.0} s"));
            return lines;
        }
        let flat = array.contacts.iter().all(|c| c.position.z.abs() <= FLAT);
        lines.push(row(
            flat,
            "track",
            ["x / mm", "y / mm", "z / mm", "F / N"].map(str::to_owned),
            "confidence",
        ));
        for c in &array.contacts {
            let numbers = [c.position.x, c.position.y, c.position.z].map(|v| format!("{:.2}", v * 1e3));
            let [x, y, z] = numbers;
            let force = format!("{:.3}", pressing(c));
            lines.push(row(flat, &c.track_id.to_string(), [x, y, z, force], &format!("{:.2}", c.confidence)));
        }
        if array.contacts.is_empty() {
            let words =
                if array.status == ContactArray::STATUS_OK { "not touched" } else { &array.status_text };
            lines.push(format!("  {words}"));
        }
        lines
    }
}

/// \[N\] with which a contact presses onto the skin.
pub fn pressing(c: &Contact) -> f64 {
    -(c.force.x * c.normal.x + c.force.y * c.normal.y + c.force.z * c.normal.z)
}

fn rate(count: u64, first_ns: i64, last_ns: i64) -> f64 {
    let span = last_ns.saturating_sub(first_ns) as f64 * 1e-9;
    if span > 0.0 { count.saturating_sub(1) as f64 / span } else { 0.0 }
}

fn row(flat: bool, track: &str, [x, y, z, force]: [String; 4], confidence: &str) -> String {
    let mut line = format!("  {track:>5} {x:>9} {y:>9}");
    if !flat {
        // Writing to a text does not fail.
        let _ = write!(line, " {z:>9}");
    }
    let _ = write!(line, " {force:>9} {confidence:>11}");
    line
}

/// Where the table is drawn.
pub struct Table {
    begun: Instant,
    terminal: bool,
    /// Lines of the last table, on a terminal.
    drawn: usize,
    /// Seconds that lines were printed of, elsewhere.
    seconds: u64,
}

impl Table {
    /// On standard output, from now on.
    pub fn begin() -> Self {
        Self { begun: Instant::now(), terminal: std::io::stdout().is_terminal(), drawn: 0, seconds: 0 }
    }

    /// Since it began.
    pub fn elapsed(&self) -> Duration {
        self.begun.elapsed()
    }

    /// Draws what each skin feels now.
    ///
    /// # Errors
    ///
    /// When standard output is closed.
    pub fn draw<'a>(&mut self, skins: impl Iterator<Item = &'a Felt>) -> std::io::Result<()> {
        let second = self.begun.elapsed().as_secs();
        if !self.terminal && second <= self.seconds {
            return Ok(());
        }
        self.seconds = second;
        let (elapsed, now) = (self.begun.elapsed().as_secs_f64(), dermis_transport::now_ns());
        let tables: Vec<Vec<String>> = skins.map(|skin| skin.lines(elapsed, now)).collect();
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

/// What came of drawing. Where nobody reads the output any more, the program still ends as it does by Ctrl-C, so that its device and
/// its files go, too.
pub fn shown(drawn: std::io::Result<()>) -> anyhow::Result<()> {
    drawn.map_err(|error| match error.kind() {
        std::io::ErrorKind::BrokenPipe => dermis_io::pipe::ReaderGone.into(),
        _ => error.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_msgs::builtin_interfaces::msg::Time;
    use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
    use dermis_msgs::std_msgs::msg::Header;

    const SECOND: i64 = 1_000_000_000;

    fn array(at_ns: i64, contacts: Vec<Contact>) -> ContactArray {
        let header = Header { stamp: Time::from_nanos(at_ns - 500_000), frame_id: "palm".to_owned() };
        ContactArray { header, skin: "palm".to_owned(), contacts, ..ContactArray::default() }
    }

    fn contact(position: [f64; 3], normal: [f64; 3], force: f64) -> Contact {
        let vector = |v: [f64; 3], by: f64| Vector3 { x: by * v[0], y: by * v[1], z: by * v[2] };
        let [x, y, z] = position;
        Contact {
            track_id: 8,
            position: Point { x, y, z },
            normal: vector(normal, 1.0),
            force: vector(normal, -force),
            confidence: 0.99,
            ..Contact::default()
        }
    }

    fn felt(contacts: &[Contact]) -> Felt {
        let mut felt = Felt::new("palm");
        for k in 0..=200 {
            felt.take(array(k * SECOND / 100, contacts.to_vec()), k * SECOND / 100);
        }
        felt
    }

    #[test]
    fn a_flat_skin_has_two_coordinates_and_a_curved_one_three() {
        let flat = felt(&[contact([1.2e-3, 9.18e-3, 0.0], [0.0, 0.0, 1.0], 0.301)]);
        insta::assert_snapshot!(flat.lines(12.1, 2 * SECOND).join("\n"), @r"
        palm    12.1 s   100.0 frames/s  latency 0.50 ms median, 0.50 ms p99
          track    x / mm    y / mm     F / N  confidence
              8      1.20      9.18     0.301        0.99
        ");
        let dome = felt(&[contact([6e-3, 0.0, 8e-3], [0.6, 0.0, 0.8], 1.5)]);
        insta::assert_snapshot!(dome.lines(12.1, 2 * SECOND).join("\n"), @r"
        palm    12.1 s   100.0 frames/s  latency 0.50 ms median, 0.50 ms p99
          track    x / mm    y / mm    z / mm     F / N  confidence
              8      6.00      0.00      8.00     1.500        0.99
        ");
    }

    #[test]
    fn a_skin_that_is_not_touched_and_one_that_cannot_tell_read_differently() {
        let words = |skin: &Felt, now| skin.lines(1.0, now).pop().unwrap();
        assert_eq!(words(&Felt::new("palm"), 0), "  waiting for the first frame");
        let mut skin = felt(&[]);
        assert_eq!(words(&skin, 2 * SECOND), "  not touched");
        assert_eq!(words(&skin, 9 * SECOND), "  nothing has come for 7 s");
        let blind = ContactArray {
            status: ContactArray::STATUS_STALE,
            status_text: "no frame for 1.0 s".to_owned(),
            ..array(2 * SECOND, Vec::new())
        };
        skin.take(blind, 2 * SECOND);
        assert_eq!(words(&skin, 2 * SECOND), "  no frame for 1.0 s");
        assert_eq!((skin.arrays, skin.touched, skin.statuses), (202, 0, [201, 0, 1, 0, 0]));
    }

    #[test]
    fn the_rate_that_is_shown_is_that_of_the_last_seconds() {
        let mut skin = felt(&[]);
        for k in 1..=40 {
            skin.take(array(2 * SECOND + k * SECOND / 10, Vec::new()), 2 * SECOND + k * SECOND / 10);
        }
        assert!((skin.recent_rate() - 10.0).abs() < 0.1, "{}", skin.recent_rate());
        assert!((skin.rate() - 40.0).abs() < 0.1, "{}", skin.rate());
    }
}
