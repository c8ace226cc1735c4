//! Copies bags, whole or in part, and makes complete ones of what is whole of others.
//!
//! A copy that fails, as on a full disk, is removed again: nothing of it is left that would be taken for a bag, or that would
//! stand in the way of the next try. A repair in place writes the new bag under a hidden name beside the old one, then renames
//! the old one to `<name>.damaged` and the new one to `<name>`. Whatever interrupts it, one of the two has its name or the next
//! repair ends what was begun.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use crate::{BagError, BagInfo, BagOptions, BagReader, BagWriter, Filter, TopicId};

/// Copies what `filter` takes of a bag into a new one, file by file and message by message as it was recorded: topics with their
/// schemas, qualities of service, times and bytes. Topics that nothing is taken of are left out; `custom` is added to the
/// custom data. The original is only read; where it was opened with [`BagReader::recover`], what is whole is copied.
///
/// # Errors
/// Where reading or writing fails, or the target exists. What was written of the copy is removed then.
pub fn copy(
    reader: &BagReader,
    out: impl AsRef<Path>,
    filter: Filter,
    options: &BagOptions,
    custom: impl IntoIterator<Item = (String, String)>,
) -> Result<BagInfo, BagError> {
    let out = out.as_ref();
    written(out, || copy_into(reader, BagWriter::create_with(out, options)?, filter, custom))
}

/// Writes a new bag; where that fails, nothing is left of it.
pub(crate) fn written(
    out: &Path,
    write: impl FnOnce() -> Result<BagInfo, BagError>,
) -> Result<BagInfo, BagError> {
    let before = Before::of(out);
    write().map_err(|error| before.restore(out, error))
}

/// What stood where a copy is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Before {
    Nothing,
    EmptyFolder,
    /// Something that is not ours, and is not touched.
    Other,
}

impl Before {
    fn of(out: &Path) -> Self {
        match std::fs::read_dir(out).map(|mut entries| entries.next().is_none()) {
            Ok(true) => Self::EmptyFolder,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Self::Nothing,
            _ => Self::Other,
        }
    }

    /// Removes what was written of a copy before `error`, which says so then.
    fn restore(self, out: &Path, error: BagError) -> BagError {
        let removed = match self {
            Self::Other => return error,
            Self::Nothing => std::fs::remove_dir_all(out),
            Self::EmptyFolder => std::fs::read_dir(out).and_then(|entries| {
                entries.into_iter().try_for_each(|entry| std::fs::remove_file(entry?.path()))
            }),
        };
        match (error, removed) {
            (BagError::Full { reason, .. }, Ok(())) => BagError::NoRoom { path: out.into(), reason },
            (error, _) => error,
        }
    }
}

fn copy_into(
    reader: &BagReader,
    mut writer: BagWriter,
    filter: Filter,
    custom: impl IntoIterator<Item = (String, String)>,
) -> Result<BagInfo, BagError> {
    for (key, value) in reader.custom().clone().into_iter().chain(custom) {
        writer.set_custom(key, value);
    }
    let mut ids: BTreeMap<String, TopicId> = BTreeMap::new();
    for topic in reader.topics().iter().filter(|topic| filter.takes_topic(&topic.name, &topic.type_name)) {
        ids.insert(topic.name.clone(), writer.declare(topic)?);
    }
    for message in reader.recorded_where(filter) {
        let message = message?;
        let Some(&id) = ids.get(&*message.topic) else { continue };
        writer.write_bytes(id, &message.data, message.log_time, message.publish_time)?;
    }
    writer.finish()
}

/// What [`repair`] made.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Repaired {
    /// The complete bag.
    pub bag: BagInfo,
    /// Where the original lies now, where the repaired bag has taken its place.
    pub original: Option<PathBuf>,
}

/// Makes a complete bag of what is whole of a damaged or interrupted one. With `out`, a new bag there; without, the repaired
/// bag is written beside the original, which then makes room: it is renamed to `<name>.damaged` and kept.
///
/// # Errors
/// Where nothing can be read, or writing fails; the original is untouched then, and nothing is left of the new bag.
pub fn repair(
    path: impl AsRef<Path>,
    out: Option<&Path>,
    options: &BagOptions,
) -> Result<Repaired, BagError> {
    let path = path.as_ref();
    let custom = [("repaired".to_owned(), "what was whole of a damaged or interrupted bag".to_owned())];
    if let Some(out) = out {
        let reader = BagReader::recover(path)?;
        return Ok(Repaired { bag: copy(&reader, out, Filter::default(), options, custom)?, original: None });
    }
    if path.is_file() {
        return Err(BagError::Repair {
            path: path.into(),
            problem: "it is a single file, which becomes a folder: give the new folder by --out".into(),
        });
    }
    let names = Names::of(path)?;
    if let Some(repaired) = names.end_what_was_begun(path)? {
        return Ok(repaired);
    }
    let reader = BagReader::recover(path)?;
    if names.kept.exists() {
        return Err(BagError::Exists { path: names.kept });
    }
    let writing = BagWriter::create_named(names.new.clone(), names.name.clone(), options, None)
        .and_then(|writer| copy_into(&reader, writer, Filter::default(), custom));
    let bag = writing.map_err(|error| Before::Nothing.restore(&names.new, error))?;
    names.exchange()?;
    Ok(Repaired { bag: BagInfo { path: path.into(), ..bag }, original: Some(names.kept) })
}

/// The folders of a repair in place.
struct Names {
    name: String,
    /// The bag.
    full: PathBuf,
    /// Where the new one is written; nobody else gives such a name.
    new: PathBuf,
    /// Where the original goes.
    kept: PathBuf,
}

impl Names {
    fn of(path: &Path) -> Result<Self, BagError> {
        // `presses/` and `.` have a name, too; and a repair may have been interrupted while the bag had none.
        let full = match path.canonicalize() {
            Ok(full) => full,
            Err(_) => std::path::absolute(path).map_err(BagError::io("open", path))?,
        };
        let Some(name) = full.file_name().map(|name| name.to_string_lossy().into_owned()) else {
            return Err(BagError::Repair { path: path.into(), problem: "it has no name: give --out".into() });
        };
        let (new, kept) = (
            full.with_file_name(format!(".{name}.repairing")),
            full.with_file_name(format!("{name}.damaged")),
        );
        Ok(Self { name, full, new, kept })
    }

    /// What an interrupted repair left: a new bag that is complete takes its place where the original has made room already;
    /// else it is begun anew.
    fn end_what_was_begun(&self, path: &Path) -> Result<Option<Repaired>, BagError> {
        if !self.new.exists() {
            return Ok(None);
        }
        if !self.full.exists() && self.kept.exists() && self.new.join("metadata.yaml").exists() {
            std::fs::rename(&self.new, &self.full).map_err(BagError::io("rename", &self.new))?;
            let bag = BagInfo { path: path.into(), ..BagReader::open(&self.full)?.info() };
            return Ok(Some(Repaired { bag, original: Some(self.kept.clone()) }));
        }
        std::fs::remove_dir_all(&self.new).map_err(BagError::io("remove", &self.new))?;
        Ok(None)
    }

    /// The original makes room for the new bag.
    fn exchange(&self) -> Result<(), BagError> {
        std::fs::rename(&self.full, &self.kept).map_err(BagError::io("rename", &self.full))?;
        std::fs::rename(&self.new, &self.full).map_err(|error| {
            // The bag keeps its name; what is new is made again the next time.
            let _ = std::fs::rename(&self.kept, &self.full);
            BagError::io("rename", &self.new)(error)
        })
    }
}
