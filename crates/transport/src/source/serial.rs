//! Serial lines and terminals: opening them raw and exclusively, and saying what is wrong where that fails.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind};
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::libc;
use nix::sys::termios::{
    ControlFlags, FlushArg, SetArg, SpecialCharacterIndices as Cc, cfmakeraw, tcflush, tcgetattr, tcsetattr,
};

use crate::Parity;

mod ioctl {
    use nix::libc;
    nix::ioctl_none_bad!(
        /// Later openings of this terminal fail.
        tiocexcl,
        libc::TIOCEXCL
    );
    nix::ioctl_none_bad!(
        /// Undoes `tiocexcl`.
        tiocnxcl,
        libc::TIOCNXCL
    );
    nix::ioctl_read_bad!(
        /// Line settings with the rate as a number.
        tcgets2,
        libc::TCGETS2,
        libc::termios2
    );
    nix::ioctl_write_ptr_bad!(
        /// Line settings with the rate as a number.
        tcsets2,
        libc::TCSETS2,
        libc::termios2
    );
}

/// An open terminal; `serial://` ones are locked against a second reader.
#[derive(Debug)]
pub(super) enum Terminal {
    Serial(Flock<File>),
    Plain(File),
}

impl Terminal {
    pub(super) fn file(&self) -> &File {
        match self {
            Self::Serial(file) => file,
            Self::Plain(file) => file,
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Self::Serial(file) = self {
            // The mark would outlive us on a line that another process holds open.
            // SAFETY: the descriptor is open, and this request takes no argument.
            let _ = unsafe { ioctl::tiocnxcl(file.as_raw_fd()) };
        }
    }
}

/// Settings of a serial line.
pub(super) struct Line {
    pub(super) baud: u32,
    pub(super) parity: Parity,
    pub(super) stop_bits: u8,
}

/// Opens a serial line: raw, 8 bits, exclusive, without bytes from before.
pub(super) fn open_serial(path: &Path, line: &Line) -> Result<Terminal, String> {
    let file = open_raw(path, Some(line))?;
    let file = Flock::lock(file, FlockArg::LockExclusiveNonblock)
        .map_err(|(_, errno)| explain(path, &io::Error::from(errno)))?;
    // A pseudo-terminal is held open by the device at its other end, so that the mark would outlive a reader that is
    // killed, and lock out the next one for ever. The lock does not.
    if !nix::unistd::ttyname(&*file).is_ok_and(|name| name.starts_with("/dev/pts")) {
        // SAFETY: the descriptor is open, and this request takes no argument.
        unsafe { ioctl::tiocexcl(file.as_raw_fd()) }.map_err(|e| explain(path, &io::Error::from(e)))?;
    }
    set_baud(&file, line.baud)
        .map_err(|e| format!("{} does not take {} baud: {e}", path.display(), line.baud))?;
    tcflush(&*file, FlushArg::TCIFLUSH).map_err(|e| explain(path, &io::Error::from(e)))?;
    Ok(Terminal::Serial(file))
}

/// Opens a terminal as it is, but raw.
pub(super) fn open_plain(path: &Path) -> Result<Terminal, String> {
    open_raw(path, None).map(Terminal::Plain)
}

fn open_raw(path: &Path, line: Option<&Line>) -> Result<File, String> {
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK)
        .open(path)
        .map_err(|e| explain(path, &e))?;
    let mut settings = tcgetattr(&file).map_err(|e| explain(path, &io::Error::from(e)))?;
    cfmakeraw(&mut settings);
    settings.control_chars[Cc::VMIN as usize] = 1;
    settings.control_chars[Cc::VTIME as usize] = 0;
    if let Some(line) = line {
        let flags = &mut settings.control_flags;
        flags.insert(ControlFlags::CREAD | ControlFlags::CLOCAL | ControlFlags::CS8);
        flags.remove(ControlFlags::CRTSCTS);
        flags.set(ControlFlags::CSTOPB, line.stop_bits == 2);
        flags.set(ControlFlags::PARENB, line.parity != Parity::None);
        flags.set(ControlFlags::PARODD, line.parity == Parity::Odd);
    }
    tcsetattr(&file, SetArg::TCSANOW, &settings).map_err(|e| explain(path, &io::Error::from(e)))?;
    Ok(file)
}

/// Sets any rate, also one that has no name in POSIX (250000 is common on microcontrollers).
fn set_baud(file: &File, baud: u32) -> Result<(), String> {
    let fd = file.as_raw_fd();
    // SAFETY: `termios2` is plain old data, for which zeroes are valid.
    let mut settings: libc::termios2 = unsafe { std::mem::zeroed() };
    // SAFETY: the descriptor is open, and the pointer is to a live `termios2`.
    unsafe { ioctl::tcgets2(fd, &raw mut settings) }.map_err(|e| e.to_string())?;
    settings.c_cflag &= !libc::CBAUD;
    settings.c_cflag |= libc::BOTHER;
    settings.c_ispeed = baud;
    settings.c_ospeed = baud;
    // SAFETY: as above.
    unsafe { ioctl::tcsets2(fd, &raw const settings) }.map_err(|e| e.to_string())?;
    // SAFETY: as above.
    unsafe { ioctl::tcgets2(fd, &raw mut settings) }.map_err(|e| e.to_string())?;
    // A UART samples in the middle of a bit: beyond 3 % the last bits of a byte are read wrong.
    if settings.c_ospeed.abs_diff(baud) > baud / 33 {
        return Err(format!("its nearest rate is {}", settings.c_ospeed));
    }
    Ok(())
}

/// What went wrong with a terminal, and what to do about it.
fn explain(path: &Path, error: &io::Error) -> String {
    let shown = path.display();
    let errno = error.raw_os_error().map_or(Errno::UnknownErrno, Errno::from_raw);
    match (errno, error.kind()) {
        (_, ErrorKind::NotFound) | (Errno::ENXIO | Errno::ENODEV, _) => {
            let found = terminals(Path::new("/dev"));
            if found.is_empty() {
                format!("no such device {shown}, and no serial device is plugged in")
            } else {
                format!("no such device {shown}; serial devices here: {}", found.join(", "))
            }
        }
        (_, ErrorKind::PermissionDenied) => format!(
            "permission denied on {shown}: add yourself to its group (sudo usermod -aG dialout $USER) and log in again"
        ),
        (Errno::EBUSY | Errno::EAGAIN, _) => {
            format!("{shown} is in use by another program (fuser {shown} names it)")
        }
        (Errno::ENOTTY | Errno::EISDIR | Errno::EINVAL, _) => {
            format!("{shown} is not a serial line or terminal")
        }
        _ => format!("cannot open {shown}: {error}"),
    }
}

/// Serial devices of this machine; stable names first. `/dev/ttyS*` exist without a port and are left out.
fn terminals(dev: &Path) -> Vec<String> {
    let list = |folder: &Path, wanted: &dyn Fn(&str) -> bool| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut found: Vec<String> = entries
            .filter(|e| wanted(&e.file_name().to_string_lossy()))
            .map(|e| e.path().display().to_string())
            .collect();
        found.sort();
        found
    };
    let mut found = list(&dev.join("serial/by-id"), &|_| true);
    found.extend(list(dev, &|name| {
        ["ttyACM", "ttyUSB", "ttyAMA", "ttyTHS", "ttymxc", "rfcomm"].iter().any(|p| name.starts_with(p))
    }));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_say_what_to_do() {
        let path = Path::new("/dev/ttyACM9");
        let denied = explain(path, &io::Error::from(Errno::EACCES));
        insta::assert_snapshot!(denied, @"permission denied on /dev/ttyACM9: add yourself to its group (sudo usermod -aG dialout $USER) and log in again");
        let busy = explain(path, &io::Error::from(Errno::EBUSY));
        insta::assert_snapshot!(busy, @"/dev/ttyACM9 is in use by another program (fuser /dev/ttyACM9 names it)");
        let missing = explain(path, &io::Error::from(Errno::ENOENT));
        assert!(missing.starts_with("no such device /dev/ttyACM9"), "{missing}");
        let regular = open_plain(Path::new("/dev/null")).unwrap_err();
        insta::assert_snapshot!(regular, @"/dev/null is not a serial line or terminal");
    }

    #[test]
    fn lists_serial_devices_by_their_stable_names_first() {
        let dev = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(dev.path().join("serial/by-id")).unwrap();
        for name in ["ttyUSB0", "ttyACM1", "ttyS0", "tty", "null", "serial/by-id/usb-Skin_01-if00"] {
            std::fs::write(dev.path().join(name), "").unwrap();
        }
        let found: Vec<String> =
            terminals(dev.path()).iter().map(|p| p.replace(&*dev.path().to_string_lossy(), "/dev")).collect();
        assert_eq!(found, ["/dev/serial/by-id/usb-Skin_01-if00", "/dev/ttyACM1", "/dev/ttyUSB0"]);
    }

    #[test]
    fn unusual_rates_are_set_and_read_back() {
        let pty = crate::Pty::open().unwrap();
        for baud in [9600, 115_200, 250_000, 921_600, 2_000_000, 74_880] {
            let line = Line { baud, parity: Parity::None, stop_bits: 1 };
            open_serial(pty.slave_path(), &line).unwrap();
        }
    }

    #[test]
    fn a_second_reader_is_refused() {
        let pty = crate::Pty::open().unwrap();
        let line = || Line { baud: 115_200, parity: Parity::None, stop_bits: 1 };
        let first = open_serial(pty.slave_path(), &line()).unwrap();
        let refused = open_serial(pty.slave_path(), &line()).unwrap_err();
        assert!(refused.contains("is in use by another program"), "{refused}");
        drop(first);
        open_serial(pty.slave_path(), &line()).unwrap();
    }
}
