//! Reading a bundle's files, which may be anything that somebody put there.
//!
//! A file is opened without waiting, inspected, and read only where it is a plain one and not longer than it may be: a pipe would hold
//! the program up, a device has no end, and a sparse file of gigabytes takes no space on the disk but all of the memory.

use std::fs::{File, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::bundle::BundleError;

/// Opens a plain file of at most `most` bytes.
fn open(folder: &Path, file: &'static str, most: u64) -> Result<(File, u64, PathBuf), BundleError> {
    let path = folder.join(file);
    let failed = |source: std::io::Error| match source.kind() {
        std::io::ErrorKind::NotFound => BundleError::NoFile { path: folder.to_owned(), file },
        _ => BundleError::Io { path: folder.join(file), action: "read", source },
    };
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        // A pipe that nobody writes to must not hold the program up before it is known to be one.
        options.custom_flags(nix::fcntl::OFlag::O_NONBLOCK.bits());
    }
    let opened = options.open(&path).map_err(failed)?;
    let found = opened.metadata().map_err(failed)?;
    if !found.is_file() {
        return Err(BundleError::NotAFile { path });
    }
    if found.len() > most {
        return Err(BundleError::TooLong { path, found: found.len(), most });
    }
    Ok((opened, found.len(), path))
}

/// Reads a plain file of at most `most` bytes.
pub(crate) fn read(folder: &Path, file: &'static str, most: u64) -> Result<Vec<u8>, BundleError> {
    let (opened, length, path) = open(folder, file, most)?;
    content(opened, length, path)
}

/// Reads a plain file that must have `expected` bytes by the manifest's table `field`, and at most `most`.
pub(crate) fn read_exactly(
    folder: &Path,
    (file, field): (&'static str, &'static str),
    expected: u64,
    most: u64,
) -> Result<Vec<u8>, BundleError> {
    let (opened, found, path) = open(folder, file, most)?;
    if found != expected {
        return Err(BundleError::Length { path, field, found, expected });
    }
    content(opened, found, path)
}

fn content(file: File, length: u64, path: PathBuf) -> Result<Vec<u8>, BundleError> {
    let failed = |source| BundleError::Io { path: path.clone(), action: "read", source };
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or_default());
    // One that grows meanwhile is not followed.
    file.take(length + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 != length {
        let source = std::io::Error::other("its length changed while it was read");
        return Err(BundleError::Io { path, action: "read", source });
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(folder: &Path, most: u64) -> String {
        let text = read(folder, "model.onnx", most).unwrap_err().to_string();
        text.replace(&folder.display().to_string(), "DIR")
    }

    #[test]
    fn what_is_no_plain_file_of_a_length_that_can_be_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.onnx");
        insta::assert_snapshot!(refused(folder.path(), 10), @"model bundle DIR: holds no `model.onnx`, so it is not a whole bundle; copy it again or train it anew");
        // Eight gigabytes that take no space on the disk.
        File::create(&path).unwrap().set_len(8 << 30).unwrap();
        insta::assert_snapshot!(refused(folder.path(), 256 << 20), @"model bundle file DIR/model.onnx: has 8589934592 bytes, and at most 268435456 are read; is it the right file?");
        let text = read_exactly(folder.path(), ("model.onnx", "model"), 77, 1 << 40).unwrap_err().to_string();
        assert!(
            text.contains("has 8589934592 bytes where bundle.toml field `model.bytes` says 77"),
            "{text}"
        );
        std::fs::remove_file(&path).unwrap();
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        insta::assert_snapshot!(refused(folder.path(), 10), @"model bundle file DIR/model.onnx: is no plain file, but a pipe, a device or a folder; copy the bundle again");
        std::fs::remove_file(&path).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
        assert!(refused(folder.path(), 10).contains("is no plain file"));
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(refused(folder.path(), 10).contains("is no plain file"));
        std::fs::remove_dir(&path).unwrap();
        std::fs::write(&path, b"1234").unwrap();
        assert_eq!(read(folder.path(), "model.onnx", 4).unwrap(), b"1234");
    }
}
