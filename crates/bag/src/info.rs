//! A bag at a glance.

use std::{collections::BTreeMap, fmt, path::PathBuf};

use crate::{BagQos, RecordedLosses};

/// Summary of a bag; `Display` prints it for people.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct BagInfo {
    /// The folder or file.
    pub path: PathBuf,
    /// How many `.mcap` files it has.
    pub files: usize,
    /// Bytes of its `.mcap` files together.
    pub bytes: u64,
    /// First and last log time [ns since the epoch]; `None` where there is no message.
    pub span: Option<(i64, i64)>,
    /// Messages in all.
    pub messages: u64,
    /// Topics in the order of their names.
    pub topics: Vec<TopicInfo>,
    /// Custom data of `metadata.yaml`: where an imported bag comes from, what was assumed.
    pub custom: BTreeMap<String, String>,
    /// False where the recording was interrupted: the figures count what is whole.
    pub complete: bool,
}

/// One line of a [`BagInfo`].
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct TopicInfo {
    /// Topic.
    pub name: String,
    /// Type, e.g. `dermis_msgs/msg/TaxelFrame`.
    pub type_name: String,
    /// Messages on this topic.
    pub messages: u64,
    /// RIHS01 hash of the type, where the bag has it.
    pub type_hash: Option<String>,
    /// Offered quality of service, where the bag has it.
    pub qos: Option<BagQos>,
}

impl BagInfo {
    /// Seconds between the first and the last message.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.span.map_or(0.0, |(first, last)| (last - first) as f64 * 1e-9)
    }

    /// What the recorder missed, as it counted; `None` where the bag does not say.
    #[must_use]
    pub fn losses(&self) -> Option<RecordedLosses> {
        RecordedLosses::of(&self.custom)
    }
}

impl fmt::Display for BagInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "bag       {}", self.path.display())?;
        if !self.complete {
            writeln!(f, "          INTERRUPTED: only whole messages are counted")?;
        }
        let files = if self.files == 1 { String::new() } else { format!(" in {} files", self.files) };
        writeln!(f, "size      {}{files}", size(self.bytes))?;
        match self.span {
            Some((first, last)) => {
                writeln!(f, "duration  {}", duration(self.duration_s()))?;
                writeln!(f, "start     {}", utc(first))?;
                writeln!(f, "end       {}", utc(last))?;
            }
            None => writeln!(f, "duration  empty")?,
        }
        writeln!(f, "messages  {}", self.messages)?;
        if let Some(losses) = self.losses() {
            writeln!(f, "losses    {losses}")?;
        }
        writeln!(f, "topics    {}", self.topics.len())?;
        let width = |text: fn(&TopicInfo) -> &str| {
            self.topics.iter().map(|topic| text(topic).len()).max().unwrap_or(0)
        };
        let (names, types) = (width(|topic| &topic.name), width(|topic| &topic.type_name));
        for topic in &self.topics {
            write!(f, "  {:names$}  {:types$}  {:>8}", topic.name, topic.type_name, topic.messages)?;
            if topic.messages > 1 && self.duration_s() > 0.0 {
                write!(f, "  {:>8.2} Hz", (topic.messages - 1) as f64 / self.duration_s())?;
            }
            writeln!(f)?;
        }
        for (key, value) in self.custom.iter().filter(|(key, _)| !RecordedLosses::owns(key)) {
            writeln!(f, "{key}: {value}")?;
        }
        Ok(())
    }
}

fn size(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{bytes} B") } else { format!("{value:.1} {}", UNITS[unit]) }
}

fn duration(seconds: f64) -> String {
    let whole = seconds as u64;
    let (hours, minutes) = (whole / 3600, whole / 60 % 60);
    let rest = seconds - (hours * 3600 + minutes * 60) as f64;
    match (hours, minutes) {
        (0, 0) => format!("{rest:.3} s"),
        (0, _) => format!("{minutes} min {rest:.1} s"),
        _ => format!("{hours} h {minutes} min {rest:.0} s"),
    }
}

/// Date and time in UTC with milliseconds (the civil calendar from days since 1970, by eras of 400 years).
fn utc(nanos: i64) -> String {
    let millis = nanos.div_euclid(1_000_000);
    let (days, in_day) = (millis.div_euclid(86_400_000), millis.rem_euclid(86_400_000));
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02}.{:03} UTC",
        in_day / 3_600_000,
        in_day / 60_000 % 60,
        in_day / 1000 % 60,
        in_day % 1000
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prints_for_people() {
        let info = BagInfo {
            path: "presses".into(),
            files: 2,
            bytes: 3_250_000,
            span: Some((1_742_155_052_516_000_000, 1_742_175_464_271_000_000)),
            messages: 9611,
            topics: vec![
                TopicInfo {
                    name: "/skin/ground_truth".into(),
                    type_name: "dermis_msgs/msg/Indentation".into(),
                    messages: 9610,
                    type_hash: None,
                    qos: None,
                },
                TopicInfo {
                    name: "/skin_geometry".into(),
                    type_name: "dermis_msgs/msg/SkinGeometry".into(),
                    messages: 1,
                    type_hash: None,
                    qos: None,
                },
            ],
            custom: BTreeMap::from([("source".to_owned(), "someone's recording".to_owned())]),
            complete: true,
        };
        insta::assert_snapshot!(info, @"
        bag       presses
        size      3.1 MiB in 2 files
        duration  5 h 40 min 12 s
        start     2025-03-16 19:57:32.516 UTC
        end       2025-03-17 01:37:44.271 UTC
        messages  9611
        topics    2
          /skin/ground_truth  dermis_msgs/msg/Indentation       9610      0.47 Hz
          /skin_geometry      dermis_msgs/msg/SkinGeometry         1
        source: someone's recording
        ");
        let custom = [("lost", "4"), ("lost /skin/taxels", "4"), ("dropped", "0"), ("source", "someone")];
        let lossy = BagInfo {
            custom: custom.map(|(key, value)| (key.to_owned(), value.to_owned())).into(),
            ..info.clone()
        };
        let text = lossy.to_string();
        let lines: Vec<&str> =
            text.lines().filter(|line| line.contains("los") || line.contains("someone")).collect();
        assert_eq!(
            lines,
            ["losses    4 messages were lost while recording: /skin/taxels 4", "source: someone"]
        );
        let empty = BagInfo {
            span: None,
            messages: 0,
            topics: vec![],
            custom: BTreeMap::new(),
            complete: false,
            files: 1,
            bytes: 512,
            ..info
        };
        insta::assert_snapshot!(empty, @"
        bag       presses
                  INTERRUPTED: only whole messages are counted
        size      512 B
        duration  empty
        messages  0
        topics    0
        ");
    }

    #[test]
    fn dates_and_durations() {
        assert_eq!(utc(0), "1970-01-01 00:00:00.000 UTC");
        assert_eq!(utc(951_782_400_123_456_789), "2000-02-29 00:00:00.123 UTC");
        assert_eq!(utc(-1_000_000), "1969-12-31 23:59:59.999 UTC");
        assert_eq!(utc(1_798_761_599_000_000_000), "2026-12-31 23:59:59.000 UTC");
        assert_eq!(duration(0.25), "0.250 s");
        assert_eq!(duration(61.5), "1 min 1.5 s");
        assert_eq!(duration(3723.0), "1 h 2 min 3 s");
    }
}
