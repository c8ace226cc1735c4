//! Looks at every byte of a bag, and says what is wrong where.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    path::{Path, PathBuf},
};

use dermis_msgs::sequence::SequenceTracker;

use crate::{BagError, RecordedLosses, metadata::Metadata, reader::mcap_files};

use file::FileCheck;

mod file;

/// Findings of one kind are listed up to this many; the rest is counted.
const LISTED: usize = 20;

/// How grave a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The bag is what it says; somebody should know all the same.
    Note,
    /// Something is missing or contradicts itself.
    Error,
}

/// Something that was found.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Finding {
    /// How grave.
    pub severity: Severity,
    /// The file, and where in it.
    pub place: String,
    /// What is wrong.
    pub problem: String,
}

/// What [`check`] found; `Display` prints it for people.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct BagReport {
    /// The folder or file.
    pub path: PathBuf,
    /// Its `.mcap` files.
    pub files: usize,
    /// Chunks whose checksum was compared.
    pub chunks: u64,
    /// Messages that are whole.
    pub messages: u64,
    /// What was found, the first of each kind in full.
    pub findings: Vec<Finding>,
    /// What the recorder missed, as it counted; `None` where the bag does not say.
    pub losses: Option<RecordedLosses>,
    /// Steps in the numbers of taxel frames, by topic.
    pub missing_frames: BTreeMap<String, MissingFrames>,
}

/// Taxel frames that a topic lacks, by their numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct MissingFrames {
    /// Frames that the skin numbered and that are not there.
    pub frames: u64,
    /// Stretches where some are missing.
    pub gaps: u64,
}

impl BagReport {
    /// Whether nothing is wrong; notes don't count.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity == Severity::Note)
    }

    /// Whether nothing is wrong, nothing is known to be missing, and a recorder that counts has recorded it.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.is_sound()
            && self.missing_frames.is_empty()
            && self.losses.as_ref().is_some_and(RecordedLosses::is_complete)
    }

    /// What is missing, in words; empty where nothing is known to be.
    #[must_use]
    pub fn missing(&self) -> String {
        let mut clauses = Vec::new();
        if let Some(losses) = self.losses.as_ref().filter(|losses| !losses.is_complete()) {
            clauses.push(losses.to_string());
        }
        if !self.missing_frames.is_empty() {
            let of = self.missing_frames.iter();
            let of = of.map(|(topic, m)| format!("{topic} {} in {}", m.frames, gap_count(m.gaps)));
            clauses.push(format!("taxel frames are missing: {}", of.collect::<Vec<_>>().join(", ")));
        }
        clauses.join("; ")
    }
}

fn gap_count(count: u64) -> String {
    if count == 1 { "1 place".to_owned() } else { format!("{count} places") }
}

impl fmt::Display for BagReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            let word = if finding.severity == Severity::Note { "note: " } else { "" };
            writeln!(f, "{}: {word}{}", finding.place, finding.problem)?;
        }
        let missing = self.missing();
        let (word, but) = (
            if self.is_sound() { "sound" } else { "not sound" },
            if self.is_sound() { "but" } else { "and" },
        );
        write!(
            f,
            "{}: {word}{}{missing} ({} messages, {} chunks, {} files)",
            self.path.display(),
            if missing.is_empty() { String::new() } else { format!(", {but} ") },
            self.messages,
            self.chunks,
            self.files
        )
    }
}

/// Gathers findings, few of each kind.
#[derive(Default)]
struct Findings {
    list: Vec<Finding>,
    counts: BTreeMap<(String, &'static str, Severity), usize>,
}

impl Findings {
    fn add(&mut self, severity: Severity, place: String, kind: &'static str, problem: String) {
        let count = self.counts.entry((place.clone(), kind, severity)).or_default();
        *count += 1;
        if *count <= LISTED {
            self.list.push(Finding { severity, place, problem });
        }
    }

    fn error(&mut self, place: impl fmt::Display, kind: &'static str, problem: String) {
        self.add(Severity::Error, place.to_string(), kind, problem);
    }

    fn finish(mut self) -> Vec<Finding> {
        for ((place, kind, severity), count) in self.counts {
            if count > LISTED {
                let problem = format!("{} more of this kind: {kind}", count - LISTED);
                self.list.push(Finding { severity, place, problem });
            }
        }
        self.list
    }
}

/// Numbers of the frames of a topic, over all files.
#[derive(Default)]
struct Frames {
    /// By the name of the skin.
    skins: BTreeMap<String, SequenceTracker>,
    gaps: u64,
}

impl Frames {
    fn missing(&self) -> MissingFrames {
        MissingFrames { frames: self.skins.values().map(SequenceTracker::missing).sum(), gaps: self.gaps }
    }
}

/// What is carried from file to file.
#[derive(Default)]
struct Across {
    frames: BTreeMap<String, Frames>,
    /// Types that were inspected.
    types: BTreeSet<String>,
    /// What the last note of the recorder says is missing.
    noted: Option<BTreeMap<String, String>>,
    /// Channel layouts that geometries name, by skin.
    layouts: BTreeSet<(String, u32)>,
    /// Those that frames refer to, with their topic.
    used: BTreeMap<(String, u32), String>,
}

/// What the messages of a file are.
#[derive(Default)]
struct Seen {
    messages: u64,
    chunks: u64,
    span: Option<(i64, i64)>,
    topics: BTreeMap<String, u64>,
}

/// Checks a bag: the checksum of every chunk, data section and index, the indexes against the messages, the order of the
/// messages of each topic, every type against what is built in here, the `sequence` of every taxel frame, and
/// `metadata.yaml` against the files.
///
/// # Errors
/// Where nothing can be read at all. What is wrong with the bag is in the report.
pub fn check(path: impl AsRef<Path>) -> Result<BagReport, BagError> {
    let path = path.as_ref();
    if !path.exists() {
        return Err(BagError::Missing { path: path.into() });
    }
    let mut findings = Findings::default();
    let (files, metadata) = files_of(path, &mut findings)?;
    let mut all = Seen::default();
    let mut across = Across::default();
    for (index, file) in files.iter().enumerate() {
        let mut state = FileCheck {
            file,
            findings: &mut findings,
            seen: Seen::default(),
            last: BTreeMap::new(),
            across: &mut across,
        };
        state.run()?;
        let seen = state.seen;
        if let Some(said) = metadata.as_ref().and_then(|metadata| metadata.files.get(index)) {
            let place = path.join("metadata.yaml");
            let name = said.path.display();
            if said.messages.is_some_and(|messages| messages != seen.messages) {
                findings.error(
                    place.display(),
                    "counts",
                    format!(
                        "says {} messages of {name}, which has {}",
                        said.messages.unwrap_or(0),
                        seen.messages
                    ),
                );
            } else if said.messages.is_some() && said.span != seen.span {
                findings.error(
                    place.display(),
                    "times",
                    format!("says {} of {name}, whose messages are {}", span(said.span), span(seen.span)),
                );
            }
        }
        all.chunks += seen.chunks;
        all.messages += seen.messages;
        if let Some((first, last)) = seen.span {
            let known = all.span.unwrap_or((first, last));
            all.span = Some((known.0.min(first), known.1.max(last)));
        }
        for (topic, count) in seen.topics {
            *all.topics.entry(topic).or_default() += count;
        }
    }
    if let Some(metadata) = &metadata {
        compare(path, metadata, &all, &mut findings);
    }
    for ((skin, layout), topic) in &across.used {
        if !across.layouts.contains(&(skin.clone(), *layout)) {
            let problem = format!(
                "nothing here names the channels of the frames of skin `{skin}` on {topic} (layout {layout:08x}): keep its \
                 skin description beside the bag, or record skin_geometry with it"
            );
            findings.add(Severity::Note, path.display().to_string(), "layouts", problem);
        }
    }
    let said = metadata.as_ref().map(|metadata| &metadata.custom).or(across.noted.as_ref());
    let missing = across.frames.iter().map(|(topic, frames)| (topic.clone(), frames.missing()));
    Ok(BagReport {
        losses: said.and_then(RecordedLosses::of),
        missing_frames: missing.filter(|(_, missing)| missing.frames > 0).collect(),
        path: path.into(),
        files: files.len(),
        chunks: all.chunks,
        messages: all.messages,
        findings: findings.finish(),
    })
}

fn span(span: Option<(i64, i64)>) -> String {
    span.map_or("no time".into(), |(first, last)| format!("{first} to {last} ns"))
}

/// The files that belong to a bag, and what its metadata says, where it has some that can be read.
fn files_of(path: &Path, findings: &mut Findings) -> Result<(Vec<PathBuf>, Option<Metadata>), BagError> {
    if !path.is_dir() {
        return Ok((vec![path.to_path_buf()], None));
    }
    let yaml = path.join("metadata.yaml");
    let present = mcap_files(path)?;
    if !yaml.exists() {
        if present.is_empty() {
            return Err(BagError::NoMetadata { path: path.into(), files: 0 });
        }
        let problem = "is missing: the recording was interrupted before it was finished";
        findings.error(yaml.display(), "metadata", problem.into());
        return Ok((present, None));
    }
    let metadata = match Metadata::read(&yaml) {
        Ok(metadata) => metadata,
        Err(BagError::Metadata { problem, .. }) => {
            findings.error(yaml.display(), "metadata", format!("is not rosbag2 metadata: {problem}"));
            return Ok((present, None));
        }
        Err(error) => return Err(error),
    };
    let mut files = Vec::new();
    for file in &metadata.files {
        let file = path.join(&file.path);
        if file.exists() {
            files.push(file);
        } else {
            findings.error(yaml.display(), "files", format!("names {}, which is missing", file.display()));
        }
    }
    for file in present.iter().filter(|file| !files.contains(file)) {
        findings.error(
            file.display(),
            "files",
            "is not named in metadata.yaml: `ros2 bag` leaves it out".into(),
        );
    }
    if files.len() == metadata.files.len() {
        return Ok((files, Some(metadata)));
    }
    // What it says of the whole cannot hold.
    Ok((files, None))
}

fn compare(path: &Path, metadata: &Metadata, seen: &Seen, findings: &mut Findings) {
    let yaml = path.join("metadata.yaml");
    if metadata.messages != seen.messages {
        findings.error(
            yaml.display(),
            "counts",
            format!("says {} messages, the files have {}", metadata.messages, seen.messages),
        );
    } else if metadata.span != seen.span {
        findings.error(
            yaml.display(),
            "times",
            format!("says {}, the messages are {}", span(metadata.span), span(seen.span)),
        );
    }
    let said: BTreeMap<&str, u64> = metadata.topics.iter().map(|t| (t.name.as_str(), t.messages)).collect();
    for (topic, &count) in &seen.topics {
        match said.get(topic.as_str()) {
            Some(&messages) if messages == count => {}
            Some(messages) => findings.error(
                yaml.display(),
                "counts",
                format!("says {messages} messages on {topic}, the files have {count}"),
            ),
            None => findings.error(
                yaml.display(),
                "topics",
                format!("does not name {topic} with its {count} messages"),
            ),
        }
    }
    for (topic, messages) in said {
        if messages > 0 && !seen.topics.contains_key(topic) {
            findings.error(
                yaml.display(),
                "counts",
                format!("says {messages} messages on {topic}, the files have none"),
            );
        }
    }
}
