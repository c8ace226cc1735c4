//! Going on with a bag that was begun.
//!
//! What a collection does depends on plan, skin, seed and start only, effects that remember included. So going on is doing it
//! again from the start, with the bag that was begun set aside and compared with, message by message: what was changed since
//! (plan, skin, effects, seed) shows at the first message that differs, and the begun bag takes its place again.

use std::path::{Path, PathBuf};

use dermis_bag::{BagReader, Filter};
use dermis_msgs::Message;
use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_skin::Stamp;

use super::INTERRUPTED;
use crate::TestbedError;

/// What there is of a bag.
pub(super) enum Found {
    /// Nothing that could be gone on with.
    Nothing,
    /// Part of a bag, set aside.
    Begun(Box<Begun>),
    /// All of it.
    Finished,
}

/// Part of a bag, set aside while it is collected again.
pub(super) struct Begun {
    /// Where the bag belongs.
    dir: PathBuf,
    /// Where it lies.
    aside: PathBuf,
    start: Stamp,
    frames: u64,
    messages: dermis_bag::Messages,
    met: u64,
    passed: bool,
    differs: bool,
}

/// Where a bag is set aside.
fn aside(dir: &Path) -> PathBuf {
    let mut name = dir.file_name().unwrap_or_default().to_owned();
    name.push(".interrupted");
    dir.with_file_name(name)
}

/// A bag, or what is whole of it; `None` where there is nothing, not even a message.
fn read(dir: &Path) -> Result<Option<(BagReader, u64)>, TestbedError> {
    let no_entries = |dir: &Path| std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_none());
    if !dir.exists() || no_entries(dir) {
        return Ok(None);
    }
    only_a_bag(dir)?;
    // A file that was hardly begun is no bag yet.
    let Ok(reader) = BagReader::recover(dir) else { return Ok(None) };
    let frames = reader.topics_of_type::<TaxelFrame>().map(|topic| topic.messages).sum();
    Ok(Some((reader, frames)))
}

/// Refuses a folder that holds other things than a bag's files.
fn only_a_bag(dir: &Path) -> Result<(), TestbedError> {
    let failed = |source| TestbedError::Io { path: dir.to_owned(), action: "read", source };
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        let name = name.to_string_lossy();
        if !(name.ends_with(".mcap") || name.starts_with("metadata.yaml")) {
            let reason = format!("the folder also holds `{name}`: it is no bag that was begun here");
            return Err(TestbedError::Resume { path: dir.to_owned(), reason });
        }
    }
    Ok(())
}

fn remove(dir: &Path) -> Result<(), TestbedError> {
    if !dir.exists() {
        return Ok(());
    }
    only_a_bag(dir)?;
    std::fs::remove_dir_all(dir).map_err(|source| TestbedError::Io {
        path: dir.to_owned(),
        action: "removed",
        source,
    })
}

fn rename(from: &Path, to: &Path) -> Result<(), TestbedError> {
    std::fs::rename(from, to).map_err(|source| TestbedError::Io {
        path: from.to_owned(),
        action: "set aside or put back",
        source,
    })
}

/// Looks for what an earlier call left of the bag `dir`, and sets it aside. `custom` is what the finished bag says of itself;
/// `is_type` says whether a hash is that of the skin, as earlier versions wrote it too.
pub(super) fn find(
    dir: &Path,
    custom: &[(&str, String)],
    is_type: impl Fn(&str) -> bool,
) -> Result<Found, TestbedError> {
    let aside = aside(dir);
    let here = read(dir)?;
    if let Some((reader, _)) = here.as_ref().filter(|(reader, _)| reader.is_complete()) {
        let said = reader.custom();
        for (key, value) in custom {
            let alike = *key == "skin_hash" && said.get(*key).is_some_and(|hash| is_type(hash));
            if said.get(*key) != Some(value) && !alike {
                let found = said.get(*key).map_or("nothing", String::as_str);
                let reason =
                    format!("its {key} is {found}, and now it is {value}; give the same, or another --out");
                return Err(TestbedError::Resume { path: dir.to_owned(), reason });
            }
        }
        if !said.contains_key(INTERRUPTED) {
            // An end just before this was removed.
            remove(&aside)?;
            return Ok(Found::Finished);
        }
    }
    // Going on may have been interrupted, too: the one that got further counts.
    let there = read(&aside)?;
    match (&here, &there) {
        (None, None) => {
            remove(dir)?;
            remove(&aside)?;
            return Ok(Found::Nothing);
        }
        (Some((_, frames)), Some((_, before))) if frames > before => {
            remove(&aside)?;
            rename(dir, &aside)?;
        }
        (Some(_), None) => {
            remove(&aside)?;
            rename(dir, &aside)?;
        }
        _ => remove(dir)?,
    }
    let Some((reader, frames)) = read(&aside)? else { return Ok(Found::Nothing) };
    let first = reader.messages_where(Filter::default().types([SkinGeometry::TYPE_NAME])).next();
    match first {
        Some(Ok(first)) => Ok(Found::Begun(Box::new(Begun {
            dir: dir.to_owned(),
            start: first.log_time,
            frames,
            messages: reader.messages(),
            aside,
            met: 0,
            passed: false,
            differs: false,
        }))),
        _ => {
            remove(&aside)?;
            Ok(Found::Nothing)
        }
    }
}

impl Begun {
    /// Stamp of its first frame.
    pub(super) fn start(&self) -> Stamp {
        self.start
    }

    /// Frames that are whole.
    pub(super) fn frames(&self) -> u64 {
        self.frames
    }

    /// Whether all of it was met again.
    pub(super) fn is_passed(&mut self) -> bool {
        self.passed = self.passed || !self.differs && self.messages.next().is_none();
        self.passed
    }

    /// Meets the next message.
    pub(super) fn expect(&mut self, topic: &str, cdr: &[u8], stamp: Stamp) -> Result<(), TestbedError> {
        if self.passed {
            return Ok(());
        }
        let Some(message) = self.messages.next().transpose()? else {
            self.passed = true;
            return Ok(());
        };
        self.met += 1;
        if message.topic.trim_start_matches('/') == topic
            && message.log_time == stamp
            && message.data[..] == *cdr
        {
            return Ok(());
        }
        self.differs = true;
        Err(TestbedError::Resume {
            path: self.dir.clone(),
            reason: format!(
                "its message {} on {} is another one than is collected now: it was begun with another plan, skin, \
                 effects, seed, noise or program; give the same, or another --out",
                self.met, message.topic
            ),
        })
    }

    /// Puts it back in its place, and says how many frames it has.
    pub(super) fn put_back(self) -> Result<u64, TestbedError> {
        remove(&self.dir)?;
        rename(&self.aside, &self.dir)?;
        Ok(self.frames)
    }

    /// Removes it: another bag holds all of it.
    pub(super) fn discard(self) -> Result<(), TestbedError> {
        remove(&self.aside)
    }
}
