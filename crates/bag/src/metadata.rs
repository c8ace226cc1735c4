//! `metadata.yaml` of rosbag2: written as version 9, read from version 4 on.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    io::ErrorKind,
    path::{Component, Path, PathBuf},
};

use dermis_io::yaml::{self, Budget};
use yaml_rust2::{Yaml, YamlLoader};

use crate::{BagError, BagQos};

/// Metadata larger than this was not written by a recorder.
const LARGEST: u64 = 16 << 20;

/// What rosbag2 writes as the start of a bag without messages.
const NO_START: i64 = i64::MAX;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TopicMetadata {
    pub(crate) name: String,
    pub(crate) type_name: String,
    pub(crate) encoding: String,
    pub(crate) qos: Option<BagQos>,
    pub(crate) type_hash: Option<String>,
    pub(crate) messages: u64,
}

/// One `.mcap` file of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileMetadata {
    /// Relative to the folder.
    pub(crate) path: PathBuf,
    /// First and last log time [ns]; `None` where it holds no message, or nothing is said of it.
    pub(crate) span: Option<(i64, i64)>,
    /// Messages in it, where that is said.
    pub(crate) messages: Option<u64>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Metadata {
    /// In the order in which they were written.
    pub(crate) files: Vec<FileMetadata>,
    /// First and last log time [ns]; `None` for a bag without messages.
    pub(crate) span: Option<(i64, i64)>,
    pub(crate) messages: u64,
    pub(crate) topics: Vec<TopicMetadata>,
    pub(crate) custom: BTreeMap<String, String>,
}

/// A YAML double-quoted scalar; JSON's escapes are a subset of YAML's.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

impl Metadata {
    pub(crate) fn to_yaml(&self) -> String {
        let times =
            |span: Option<(i64, i64)>| span.map_or((NO_START, 0), |(first, last)| (first, last - first));
        let (start, duration) = times(self.span);
        let mut out = String::new();
        let mut line = |text: String| {
            out.push_str(&text);
            out.push('\n');
        };
        line("rosbag2_bagfile_information:".into());
        line("  version: 9".into());
        line("  storage_identifier: mcap".into());
        line(format!("  duration:\n    nanoseconds: {duration}"));
        line(format!("  starting_time:\n    nanoseconds_since_epoch: {start}"));
        line(format!("  message_count: {}", self.messages));
        if self.topics.is_empty() {
            line("  topics_with_message_count: []".into());
        } else {
            line("  topics_with_message_count:".into());
        }
        for topic in &self.topics {
            line("    - topic_metadata:".into());
            line(format!("        name: {}", quoted(&topic.name)));
            line(format!("        type: {}", quoted(&topic.type_name)));
            line(format!("        serialization_format: {}", quoted(&topic.encoding)));
            match topic.qos {
                Some(qos) => {
                    line(format!("        offered_qos_profiles:\n{}", qos.to_yaml("          ").trim_end()));
                }
                None => line("        offered_qos_profiles: []".into()),
            }
            line(format!(
                "        type_description_hash: {}",
                quoted(topic.type_hash.as_deref().unwrap_or_default())
            ));
            line(format!("      message_count: {}", topic.messages));
        }
        line("  compression_format: \"\"".into());
        line("  compression_mode: \"\"".into());
        line("  relative_file_paths:".into());
        for file in &self.files {
            line(format!("    - {}", quoted(&file.path.to_string_lossy())));
        }
        line("  files:".into());
        for file in &self.files {
            let (start, duration) = times(file.span);
            line(format!("    - path: {}", quoted(&file.path.to_string_lossy())));
            line(format!("      starting_time:\n        nanoseconds_since_epoch: {start}"));
            line(format!("      duration:\n        nanoseconds: {duration}"));
            line(format!("      message_count: {}", file.messages.unwrap_or(0)));
        }
        if self.custom.is_empty() {
            line("  custom_data: ~".into());
        } else {
            line("  custom_data:".into());
            for (key, value) in &self.custom {
                line(format!("    {}: {}", quoted(key), quoted(value)));
            }
        }
        // Definitions and hashes are those of this distribution.
        let _ = writeln!(out, "  ros_distro: kilted");
        out
    }

    /// Reads the `metadata.yaml` at `path`; refuses a storage or compression that is not read here.
    pub(crate) fn read(path: &Path) -> Result<Self, BagError> {
        let text = dermis_io::read_text(path, LARGEST).map_err(|error| match error.kind() {
            ErrorKind::FileTooLarge | ErrorKind::InvalidData => {
                BagError::Metadata { path: path.into(), problem: error.to_string() }
            }
            _ => BagError::io("open", path)(error),
        })?;
        Self::parse(path, &text)
    }

    pub(crate) fn parse(path: &Path, text: &str) -> Result<Self, BagError> {
        let wrong = |problem: String| BagError::Metadata { path: path.into(), problem };
        yaml::check(text, Budget::REPORTED).map_err(wrong)?;
        let documents = YamlLoader::load_from_str(text).map_err(|error| wrong(error.to_string()))?;
        let root = documents.first().ok_or_else(|| wrong("it is empty".into()))?;
        let info = &root["rosbag2_bagfile_information"];
        if info.as_hash().is_none() {
            return Err(wrong("it has no field rosbag2_bagfile_information".into()));
        }
        let fields = Fields { path, info };
        fields.check_storage()?;
        let mut files = fields.files()?;
        let messages = fields.count(info)?;
        let span = span_of(info, messages);
        for entry in info["files"].as_vec().into_iter().flatten() {
            let path = entry["path"].as_str().map(Path::new);
            if let Some(file) = files.iter_mut().find(|file| Some(file.path.as_path()) == path) {
                let messages = fields.count(entry)?;
                (file.span, file.messages) = (span_of(entry, messages), Some(messages));
            }
        }
        let topics = fields.topics()?;
        let mut custom = BTreeMap::new();
        for (key, value) in info["custom_data"].as_hash().into_iter().flatten() {
            if let (Some(key), Some(value)) = (key.as_str(), value.as_str()) {
                custom.insert(key.to_owned(), value.to_owned());
            }
        }
        Ok(Self { files, span, messages, topics, custom })
    }
}

/// First and last log time of a file or a bag with so many messages.
fn span_of(value: &Yaml, messages: u64) -> Option<(i64, i64)> {
    let start = value["starting_time"]["nanoseconds_since_epoch"].as_i64()?;
    let duration = value["duration"]["nanoseconds"].as_i64()?;
    (messages > 0).then_some((start, start.saturating_add(duration)))
}

/// The fields of a `metadata.yaml`.
struct Fields<'a> {
    path: &'a Path,
    info: &'a Yaml,
}

impl Fields<'_> {
    fn wrong(&self, problem: impl Into<String>) -> BagError {
        BagError::Metadata { path: self.path.into(), problem: problem.into() }
    }

    fn text(&self, value: &Yaml, field: &str) -> Result<String, BagError> {
        let missing = || self.wrong(format!("field {field} is missing or not text"));
        value[field].as_str().map(str::to_owned).ok_or_else(missing)
    }

    fn count(&self, value: &Yaml) -> Result<u64, BagError> {
        let count = value["message_count"].as_i64().and_then(|count| u64::try_from(count).ok());
        count.ok_or_else(|| self.wrong("field message_count is missing or not a count"))
    }

    /// Refuses a storage or compression that is not read here.
    fn check_storage(&self) -> Result<(), BagError> {
        let refused = |storage: String| BagError::Storage {
            path: self.path.parent().unwrap_or(self.path).into(),
            storage,
        };
        let storage = self.text(self.info, "storage_identifier")?;
        if storage != "mcap" {
            return Err(refused(format!("`{storage}`")));
        }
        let mode = self.info["compression_mode"].as_str().unwrap_or_default();
        if !mode.is_empty() && mode != "NONE" {
            let format = self.info["compression_format"].as_str().unwrap_or("unknown");
            return Err(refused(format!("`mcap` with {format} compression by {}", mode.to_lowercase())));
        }
        Ok(())
    }

    /// The files of the bag, by their names alone.
    fn files(&self) -> Result<Vec<FileMetadata>, BagError> {
        let listed = self.info["relative_file_paths"]
            .as_vec()
            .ok_or_else(|| self.wrong("field relative_file_paths is missing or not a list"))?;
        let mut files = Vec::new();
        for entry in listed {
            let name = entry
                .as_str()
                .ok_or_else(|| self.wrong("relative_file_paths holds an entry that is not text"))?;
            let path = PathBuf::from(name);
            if path.as_os_str().is_empty()
                || !path.components().all(|part| matches!(part, Component::Normal(_)))
            {
                let problem = format!("relative_file_paths names {name:?}, which lies outside of the bag");
                return Err(self.wrong(problem));
            }
            files.push(FileMetadata { path, span: None, messages: None });
        }
        if files.is_empty() {
            return Err(self.wrong("relative_file_paths is empty"));
        }
        Ok(files)
    }

    fn topics(&self) -> Result<Vec<TopicMetadata>, BagError> {
        let mut topics = Vec::new();
        for entry in self.info["topics_with_message_count"].as_vec().into_iter().flatten() {
            let topic = &entry["topic_metadata"];
            topics.push(TopicMetadata {
                name: self.text(topic, "name")?,
                type_name: self.text(topic, "type")?,
                encoding: self.text(topic, "serialization_format")?,
                qos: BagQos::from_yaml(&topic["offered_qos_profiles"]),
                type_hash: topic["type_description_hash"]
                    .as_str()
                    .filter(|hash| !hash.is_empty())
                    .map(str::to_owned),
                messages: self.count(entry)?,
            });
        }
        Ok(topics)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Metadata {
        Metadata {
            files: vec![
                FileMetadata {
                    path: "a_0.mcap".into(),
                    span: Some((1_700_000_000_000_000_000, 1_700_000_001_000_000_000)),
                    messages: Some(2),
                },
                FileMetadata {
                    path: "a_1.mcap".into(),
                    span: Some((1_700_000_002_500_000_000, 1_700_000_002_500_000_000)),
                    messages: Some(1),
                },
            ],
            span: Some((1_700_000_000_000_000_000, 1_700_000_002_500_000_000)),
            messages: 3,
            topics: vec![TopicMetadata {
                name: "/skin/taxels".into(),
                type_name: "dermis_msgs/msg/TaxelFrame".into(),
                encoding: "cdr".into(),
                qos: Some(BagQos::sensor_data()),
                type_hash: Some("RIHS01_00".into()),
                messages: 3,
            }],
            custom: BTreeMap::from([("source: \"x\"\n".to_owned(), "a # b\\ µ".to_owned())]),
        }
    }

    #[test]
    fn survives_its_text() {
        for metadata in [
            sample(),
            Metadata {
                files: vec![FileMetadata { path: "e_0.mcap".into(), span: None, messages: Some(0) }],
                span: None,
                messages: 0,
                topics: vec![],
                custom: BTreeMap::new(),
            },
        ] {
            let text = metadata.to_yaml();
            assert_eq!(Metadata::parse(Path::new("metadata.yaml"), &text).unwrap(), metadata, "{text}");
        }
    }

    #[test]
    fn text_is_that_of_version_9() {
        let mut metadata = sample();
        metadata.custom.clear();
        insta::assert_snapshot!(metadata.to_yaml());
    }

    #[test]
    fn bad_metadata_is_refused_with_the_field() {
        let say = |text: &str| Metadata::parse(Path::new("bag/metadata.yaml"), text).unwrap_err().to_string();
        let good = sample().to_yaml();
        insta::assert_snapshot!(say(""), @"bag/metadata.yaml is not rosbag2 metadata: it is empty");
        insta::assert_snapshot!(say("a: 1"), @"bag/metadata.yaml is not rosbag2 metadata: it has no field rosbag2_bagfile_information");
        assert!(say("a: [").starts_with("bag/metadata.yaml is not rosbag2 metadata: "));
        insta::assert_snapshot!(
            say(&good.replace("identifier: mcap", "identifier: sqlite3")),
            @"bag is stored as `sqlite3`, which is not read here: convert it with `ros2 bag convert` to uncompressed `mcap` storage"
        );
        insta::assert_snapshot!(
            say(&good.replace("compression_format: \"\"", "compression_format: zstd").replace("compression_mode: \"\"", "compression_mode: FILE")),
            @"bag is stored as `mcap` with zstd compression by file, which is not read here: convert it with `ros2 bag convert` to uncompressed `mcap` storage"
        );
        insta::assert_snapshot!(
            say(&good.replace("- \"a_0.mcap\"", "- ../../secret.mcap")),
            @r#"bag/metadata.yaml is not rosbag2 metadata: relative_file_paths names "../../secret.mcap", which lies outside of the bag"#
        );
        insta::assert_snapshot!(
            say(&good.replace("      message_count: 3\n  compression", "      message_count: -3\n  compression")),
            @"bag/metadata.yaml is not rosbag2 metadata: field message_count is missing or not a count"
        );
    }

    #[test]
    fn what_is_nested_without_end_is_refused() {
        for text in ["- ".repeat(100_000), (0..5000).map(|i| " ".repeat(i) + "a:\n").collect()] {
            assert!(Metadata::parse(Path::new("metadata.yaml"), &text).is_err());
        }
    }
}
