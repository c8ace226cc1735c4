//! Regular files, up to a limit.

use std::fs::{File, FileType, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use nix::fcntl::OFlag;

/// Opens a regular file for reading, without waiting for anybody.
///
/// # Errors
///
/// What the system says; [`ErrorKind::InvalidInput`] where the path names something else, as a pipe or a device.
pub fn open(path: &Path) -> Result<File> {
    // Opening alone may already do something to a device, or wait for the other end of a pipe.
    regular(std::fs::metadata(path)?.file_type())?;
    // It may have become something else since; on a regular file the flags mean nothing.
    let flags = OFlag::O_NONBLOCK | OFlag::O_NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits()).open(path)?;
    regular(file.metadata()?.file_type())?;
    Ok(file)
}

/// Opens a regular file of at most `most` bytes, for readers that keep what they read.
///
/// # Errors
///
/// As [`open`]; [`ErrorKind::FileTooLarge`] where there is more in it.
pub fn open_at_most(path: &Path, most: u64) -> Result<File> {
    let file = open(path)?;
    let length = file.metadata()?.len();
    if length > most { Err(too_large(&size(length), most)) } else { Ok(file) }
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
///
/// As [`open_at_most`].
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = open_at_most(path, most)?;
    let length = file.metadata()?.len();
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    // Some files say that they are empty, and others grow.
    if file.take(most + 1).read_to_end(&mut bytes)? as u64 > most {
        return Err(too_large(&format!("more than {}", size(most)), most));
    }
    Ok(bytes)
}

/// Reads a regular file of at most `most` bytes of UTF-8.
///
/// # Errors
///
/// As [`read`]; [`ErrorKind::InvalidData`] where it is no text.
pub fn read_text(path: &Path, most: u64) -> Result<String> {
    String::from_utf8(read(path, most)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::new(ErrorKind::InvalidData, format!("byte {at} is not UTF-8 text"))
    })
}

fn too_large(found: &str, most: u64) -> Error {
    Error::new(
        ErrorKind::FileTooLarge,
        format!("it is {found} long, and a file of this kind has {} at most", size(most)),
    )
}

fn regular(kind: FileType) -> Result<()> {
    let what = match kind {
        k if k.is_file() => return Ok(()),
        k if k.is_dir() => {
            return Err(Error::new(ErrorKind::IsADirectory, "it is a folder and not a regular file"));
        }
        k if k.is_fifo() => "named pipe",
        k if k.is_socket() => "socket",
        k if k.is_char_device() => "character device",
        k if k.is_block_device() => "block device",
        _ => "special file",
    };
    Err(Error::new(ErrorKind::InvalidInput, format!("it is a {what} and not a regular file")))
}

/// A length as people read it.
fn size(bytes: u64) -> String {
    let units = [("GiB", 1u64 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];
    match units.into_iter().find(|(_, unit)| bytes >= *unit) {
        Some((unit, of)) if bytes.is_multiple_of(of) => format!("{} {unit}", bytes / of),
        Some((unit, of)) => format!("{:.1} {unit}", bytes as f64 / of as f64),
        None => format!("{bytes} bytes"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(path: impl AsRef<Path>, most: u64) -> String {
        read(path.as_ref(), most).unwrap_err().to_string()
    }

    #[test]
    fn only_regular_files_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let socket = folder.path().join("socket");
        let _listens = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        insta::assert_snapshot!(refused(&pipe, 10), @"it is a named pipe and not a regular file");
        insta::assert_snapshot!(refused(&socket, 10), @"it is a socket and not a regular file");
        insta::assert_snapshot!(refused("/dev/zero", 10), @"it is a character device and not a regular file");
        insta::assert_snapshot!(refused(folder.path(), 10), @"it is a folder and not a regular file");
        insta::assert_snapshot!(refused("/nowhere", 10), @"No such file or directory (os error 2)");
        assert_eq!(open(&pipe).unwrap_err().kind(), ErrorKind::InvalidInput);
    }

    #[test]
    fn what_is_longer_than_the_limit_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "0123456789").unwrap();
        assert_eq!(read_text(&path, 10).unwrap(), "0123456789");
        insta::assert_snapshot!(refused(&path, 9), @"it is 10 bytes long, and a file of this kind has 9 bytes at most");
        // It takes no room on the disk, and would take all of the memory.
        File::create(&path).unwrap().set_len(8_200_000_000).unwrap();
        insta::assert_snapshot!(refused(&path, crate::TEXT), @"it is 7.6 GiB long, and a file of this kind has 4 MiB at most");
        // The system says that it is empty.
        insta::assert_snapshot!(refused("/proc/self/maps", 20), @"it is more than 20 bytes long, and a file of this kind has 20 bytes at most");
        std::fs::write(&path, b"ab\xff").unwrap();
        insta::assert_snapshot!(read_text(&path, 10).unwrap_err(), @"byte 2 is not UTF-8 text");
    }
}
