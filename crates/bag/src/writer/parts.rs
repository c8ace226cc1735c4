//! Files of a bag as they are closed, and what `metadata.yaml` says of its topics.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

use super::{Part, write_error};
use crate::info::TopicInfo;
use crate::metadata::TopicMetadata;
use crate::{BagError, Topic};

/// Writes `metadata.yaml` under a temporary name, then gives it its real one; on an error neither is left.
pub(super) fn write_metadata_file(dir: &Path, yaml: &str) -> Result<(), BagError> {
    let target = dir.join("metadata.yaml");
    let partial = dir.join("metadata.yaml.partial");
    let written = File::create(&partial).and_then(|mut out| {
        out.write_all(yaml.as_bytes())?;
        out.sync_all()?;
        std::fs::rename(&partial, &target)
    });
    written.map_err(|error| {
        // Best effort: it is in nobody's way.
        let _ = std::fs::remove_file(&partial);
        BagError::io_or_full("write", &target, error)
    })
}

impl Part {
    /// Writes index and footer.
    pub(super) fn close(mut self, yaml: &str) -> Result<File, BagError> {
        // The same text inside the file, as the rosbag2 plugin stores it, so that the .mcap alone tells all.
        self.mcap
            .write_metadata(&mcap::records::Metadata {
                name: "rosbag2".into(),
                metadata: BTreeMap::from([("serialized_metadata".to_owned(), yaml.to_owned())]),
            })
            .and_then(|()| self.mcap.finish().map(drop))
            .map_err(|error| write_error(&self.path, &error))?;
        let file = self.mcap.into_inner().file.into_inner().map_err(io::IntoInnerError::into_error);
        let file = file.map_err(|error| write_error(&self.path, &mcap::McapError::Io(error)))?;
        Ok(file.inner)
    }
}

impl TopicMetadata {
    pub(super) fn of(topic: &Topic) -> Self {
        Self {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            encoding: "cdr".to_owned(),
            qos: topic.qos,
            type_hash: topic.type_hash.clone(),
            messages: topic.messages,
        }
    }
}

impl From<TopicMetadata> for TopicInfo {
    fn from(topic: TopicMetadata) -> Self {
        Self {
            name: topic.name,
            type_name: topic.type_name,
            messages: topic.messages,
            type_hash: topic.type_hash,
            qos: topic.qos,
        }
    }
}
