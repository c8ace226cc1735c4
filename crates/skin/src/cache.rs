//! Results that take seconds to compute, kept on disk from one start of a program to the next.
//!
//! The problem: fields of finite elements depend on the skin description alone, and are computed anew whenever a node starts. Here
//! they are kept in a folder ([`use_folder`]; nothing is kept before that is called), one file a result.
//!
//! - The name of a file is the hash of everything that its result depends on ([`Key`]): format, program (its version, and length and
//!   time of its file, so that a program that was built again begins anew), kind of result and parameters.
//! - A file is written beside its place and renamed, so that it is whole or not there. It ends in a checksum. One that is cut
//!   short, damaged, too long or no plain file is ignored, and replaced by what is computed instead.
//! - The folder is private to the user, and has a limit: the entries that were used longest ago go first.
//!
//! Failures of the cache are never failures of the program: [`kept`] computes then.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};
use std::time::{Duration, Instant, SystemTime};

use sha2::{Digest, Sha256};

const MAGIC: &[u8; 16] = b"dermis-cache/1\n\0";
/// \[bytes\] from the start of a file to its payload: magic, key, length of the payload.
const HEADER: usize = 16 + 32 + 8;
const CHECKSUM: usize = 32;
/// \[bytes\] that one entry may have: a result that is larger is computed each time. The largest is the compliance of a soft thumb.
pub const ENTRY_MAX: u64 = 512 << 20;
/// \[bytes\] that all entries may have together.
pub const FOLDER_MAX: u64 = 2 << 30;
/// How the names of entries end.
const EXTENSION: &str = "kept";

static FOLDER: RwLock<Option<PathBuf>> = RwLock::new(None);
static OBSERVER: RwLock<Option<fn(&Work)>> = RwLock::new(None);

/// Something that took time, or would have without the cache.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Work {
    /// What it is, for people.
    pub what: &'static str,
    /// How far it is.
    pub stage: Stage,
}

/// How far a piece of [`Work`] is.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// It is being computed from here on.
    Computing,
    /// It was computed, in this time.
    Computed(Duration),
    /// It was found in the cache, in this time.
    Found(Duration),
    /// An entry of the cache cannot be used, and is ignored: its file, and why.
    Ignored(PathBuf, String),
    /// What was computed cannot be kept: in which folder, and why.
    NotKept(PathBuf, String),
}

/// Keeps results in this folder from now on, or none; holds for the whole process. The folder is made when it is needed.
pub fn use_folder(folder: Option<PathBuf>) {
    *FOLDER.write().unwrap_or_else(PoisonError::into_inner) = folder;
}

/// Calls `observer` for every piece of work from now on, on the thread that does it.
pub fn observe(observer: fn(&Work)) {
    *OBSERVER.write().unwrap_or_else(PoisonError::into_inner) = Some(observer);
}

/// Where results are kept.
#[must_use]
pub fn folder() -> Option<PathBuf> {
    FOLDER.read().unwrap_or_else(PoisonError::into_inner).clone()
}

/// The folder for this user by the XDG base directory specification: `$XDG_CACHE_HOME/dermis`, or else `~/.cache/dermis`;
/// `None` where neither variable is an absolute path.
#[must_use]
pub fn usual_folder() -> Option<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let base = variable("XDG_CACHE_HOME").or_else(|| variable("HOME").map(|home| home.join(".cache")))?;
    Some(base.join("dermis"))
}

/// Everything that a result depends on.
#[derive(Debug, Clone)]
pub struct Key(Sha256);

impl Key {
    /// Of a kind of result; the program itself is part of it.
    #[must_use]
    pub fn new(kind: &str) -> Self {
        let mut key = Self(Sha256::new());
        key.0.update(MAGIC);
        key.0.update(fingerprint());
        key.text(kind)
    }

    /// Adds a text.
    #[must_use]
    pub fn text(mut self, text: &str) -> Self {
        self.0.update((text.len() as u64).to_le_bytes());
        self.0.update(text.as_bytes());
        self
    }

    /// Adds a value by its debugging text, which says numbers exactly.
    #[must_use]
    pub fn debug(self, value: &dyn std::fmt::Debug) -> Self {
        self.text(&format!("{value:?}"))
    }

    fn bytes(self) -> [u8; 32] {
        self.0.finalize().into()
    }
}

/// Version of this program, and length and time of its file: another build may compute otherwise.
fn fingerprint() -> &'static [u8] {
    static FINGERPRINT: OnceLock<Vec<u8>> = OnceLock::new();
    FINGERPRINT.get_or_init(|| {
        let mut text = env!("CARGO_PKG_VERSION").to_owned();
        if let Ok(file) = std::env::current_exe().and_then(std::fs::metadata) {
            let modified = file.modified().ok().and_then(|t| t.duration_since(SystemTime::UNIX_EPOCH).ok());
            text += &format!(" {} {:?}", file.len(), modified);
        }
        text.into_bytes()
    })
}

/// A result that can be written to a file and read back exactly.
pub trait Keep: Sized {
    /// Appends it.
    fn put(&self, out: &mut Vec<u8>);

    /// Reads it; `None` where the bytes are none of it.
    fn take(from: &mut Bytes<'_>) -> Option<Self>;
}

/// What is left of an entry's bytes.
#[derive(Debug)]
pub struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn split(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.split(N)?.try_into().ok()
    }

    /// A length that was put before so many things of `size` bytes each, that are there.
    fn length(&mut self, size: usize) -> Option<usize> {
        let length = usize::try_from(u64::from_le_bytes(self.array()?)).ok()?;
        (length.checked_mul(size)? <= self.0.len()).then_some(length)
    }
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Keep for $number {
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }

            fn take(from: &mut Bytes<'_>) -> Option<Self> {
                Some(Self::from_le_bytes(from.array()?))
            }
        }

        impl Keep for Vec<$number> {
            fn put(&self, out: &mut Vec<u8>) {
                out.reserve(8 + size_of_val(self.as_slice()));
                (self.len() as u64).put(out);
                self.iter().for_each(|number| number.put(out));
            }

            fn take(from: &mut Bytes<'_>) -> Option<Self> {
                let length = from.length(size_of::<$number>())?;
                let (numbers, rest) = from.split(length * size_of::<$number>())?.as_chunks();
                rest.is_empty().then(|| numbers.iter().map(|n| <$number>::from_le_bytes(*n)).collect())
            }
        }
    )*};
}

numbers!(f64, f32, u64, i16);

impl<T: Keep, const N: usize> Keep for [T; N] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|item| item.put(out));
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let items: Vec<T> = (0..N).map(|_| T::take(from)).collect::<Option<_>>()?;
        items.try_into().ok()
    }
}

impl<T: Keep> Keep for Box<[T]> {
    fn put(&self, out: &mut Vec<u8>) {
        (self.len() as u64).put(out);
        self.iter().for_each(|item| item.put(out));
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        let length = from.length(1)?;
        (0..length).map(|_| T::take(from)).collect()
    }
}

impl<T: Keep> Keep for Arc<T> {
    fn put(&self, out: &mut Vec<u8>) {
        T::put(self, out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        T::take(from).map(Self::new)
    }
}

impl Keep for () {
    fn put(&self, _: &mut Vec<u8>) {}

    fn take(_: &mut Bytes<'_>) -> Option<Self> {
        Some(())
    }
}

/// The result of this key: out of the cache, or else computed by `make` and kept. `what` says to people what it is.
///
/// # Errors
///
/// Those of `make`; nothing is kept then.
pub fn kept<T: Keep, E>(what: &'static str, key: Key, make: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    let Some(folder) = folder() else { return made(what, make) };
    let key = key.bytes();
    let path = place(&folder, &key);
    let begun = Instant::now();
    match read(&path, &key) {
        Ok(Some(found)) => {
            tell(what, Stage::Found(begun.elapsed()));
            return Ok(found);
        }
        Ok(None) => {}
        Err(reason) => tell(what, Stage::Ignored(path.clone(), reason)),
    }
    let result = made(what, make)?;
    if let Err(error) = write(&folder, &path, &key, &result) {
        tell(what, Stage::NotKept(folder, error.to_string()));
    }
    Ok(result)
}

/// Whether the cache knows that what this key stands for was found to be right once ([`note`]).
#[must_use]
pub fn noted(key: Key) -> bool {
    let Some(folder) = folder() else { return false };
    let key = key.bytes();
    matches!(read::<()>(&place(&folder, &key), &key), Ok(Some(())))
}

/// Remembers that what this key stands for was found to be right.
pub fn note(what: &'static str, key: Key) {
    let Some(folder) = folder() else { return };
    let key = key.bytes();
    if let Err(error) = write(&folder, &place(&folder, &key), &key, &()) {
        tell(what, Stage::NotKept(folder, error.to_string()));
    }
}

fn made<T, E>(what: &'static str, make: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    tell(what, Stage::Computing);
    let begun = Instant::now();
    let result = make()?;
    tell(what, Stage::Computed(begun.elapsed()));
    Ok(result)
}

fn tell(what: &'static str, stage: Stage) {
    let observer = *OBSERVER.read().unwrap_or_else(PoisonError::into_inner);
    if let Some(observer) = observer {
        observer(&Work { what, stage });
    }
}

fn place(folder: &Path, key: &[u8; 32]) -> PathBuf {
    let name: String = key.iter().map(|b| format!("{b:02x}")).collect();
    folder.join(name).with_extension(EXTENSION)
}

/// The entry in a file; `None` where there is none, an error with the reason where it cannot be used.
fn read<T: Keep>(path: &Path, key: &[u8; 32]) -> Result<Option<T>, String> {
    // Whatever lies there is not opened before it is known to be a plain file of a length that can be.
    let found = match std::fs::symlink_metadata(path) {
        Ok(found) => found,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error.to_string()),
    };
    if !found.is_file() {
        return Err("it is no plain file".into());
    }
    if !((HEADER + CHECKSUM) as u64..=ENTRY_MAX).contains(&found.len()) {
        return Err(format!("it has {} bytes", found.len()));
    }
    let file = File::open(path).map_err(|e| e.to_string())?;
    let mut bytes = Vec::with_capacity(usize::try_from(found.len()).unwrap_or_default());
    (&file).take(ENTRY_MAX).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    let damaged = || "it is damaged".to_owned();
    let (content, checksum) = bytes.split_last_chunk::<CHECKSUM>().ok_or_else(damaged)?;
    if Sha256::digest(content).as_slice() != checksum {
        return Err(damaged());
    }
    let mut rest = Bytes(content);
    let header = (rest.array::<16>(), rest.array::<32>(), rest.array::<8>());
    let (Some(magic), Some(of), Some(length)) = header else { return Err(damaged()) };
    if &magic != MAGIC || of != *key || u64::from_le_bytes(length) != rest.0.len() as u64 {
        return Err(damaged());
    }
    let found = T::take(&mut rest).filter(|_| rest.0.is_empty()).ok_or_else(damaged)?;
    // Entries that are used stay. Best effort: a folder that cannot be written to serves all the same.
    let _ = file.set_modified(SystemTime::now());
    Ok(Some(found))
}

fn write<T: Keep>(folder: &Path, path: &Path, key: &[u8; 32], result: &T) -> std::io::Result<()> {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let mut bytes = Vec::new();
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(key);
    bytes.extend_from_slice(&[0; 8]);
    result.put(&mut bytes);
    let payload = (bytes.len() - HEADER) as u64;
    bytes[HEADER - 8..HEADER].copy_from_slice(&payload.to_le_bytes());
    let checksum = Sha256::digest(&bytes);
    bytes.extend_from_slice(&checksum);
    if bytes.len() as u64 > ENTRY_MAX {
        return Err(std::io::Error::other(format!(
            "{} bytes are more than the {ENTRY_MAX} of an entry",
            bytes.len()
        )));
    }
    make_folder(folder)?;
    // A reader that follows a link, or waits on a pipe, that someone put there is none of ours.
    let scratch = folder.join(format!(".{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed)));
    let written = OpenOptions::new().write(true).create_new(true).open(&scratch).and_then(|mut file| {
        file.write_all(&bytes)?;
        std::fs::rename(&scratch, path)
    });
    if written.is_err() {
        // What is left of it is of no use.
        let _ = std::fs::remove_file(&scratch);
    }
    tidy(folder, FOLDER_MAX);
    written
}

fn make_folder(folder: &Path) -> std::io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::DirBuilderExt;
        builder.mode(0o700);
    }
    builder.create(folder)
}

/// Removes the entries that were used longest ago until all of them have at most `most` bytes, and what a program that was killed
/// while it wrote has left. Best effort: what cannot be removed stays.
fn tidy(folder: &Path, most: u64) {
    const FORGOTTEN: Duration = Duration::from_secs(3600);
    let mut entries: Vec<(SystemTime, u64, PathBuf)> = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, Ok(data)) = (entry.path(), entry.metadata()) else { continue };
        let Ok(used) = data.modified() else { continue };
        if path.extension().is_some_and(|e| e == EXTENSION) {
            entries.push((used, data.len(), path));
        } else if entry.file_name().as_encoded_bytes().starts_with(b".")
            && used.elapsed().is_ok_and(|age| age > FORGOTTEN)
        {
            let _ = std::fs::remove_file(path);
        }
    }
    entries.sort();
    let mut all: u64 = entries.iter().map(|(_, length, _)| length).sum();
    for (_, length, path) in entries {
        if all <= most {
            return;
        }
        let _ = std::fs::remove_file(path);
        all = all.saturating_sub(length);
    }
}

#[cfg(test)]
mod tests;
