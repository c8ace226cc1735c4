//! Pseudo-terminals: a serial line without a device, for simulated devices and tests.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::ttyname;

use crate::TransportError;

/// A pseudo-terminal pair: this end is the device, [`Pty::slave_path`] is what a `serial://` or `pty://` source opens.
///
/// Both ends are raw (no echo, no line editing). Dropping it is pulling the plug: whoever reads the other end sees
/// the line go down, and links made by [`Pty::link`] disappear.
///
/// ```
/// use std::io::Write;
/// let mut pty = dermis_transport::Pty::open()?;
/// let url = dermis_transport::SourceUrl::parse(&format!("pty://{}", pty.slave_path().display()))?;
/// pty.write_all(b"1,2,3\n")?;
/// # let _ = url;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Pty {
    master: File,
    // Held open so that the line settings stay, and the master never sees a hang-up while no reader is there.
    _slave: OwnedFd,
    path: PathBuf,
    links: Vec<PathBuf>,
}

impl Pty {
    /// Makes a pair.
    ///
    /// # Errors
    /// [`TransportError::Pty`] where the system has no pseudo-terminal left, or forbids them.
    pub fn open() -> Result<Self, TransportError> {
        let failed = |step| move |e: nix::Error| TransportError::Pty { step, source: e.into() };
        let pair = openpty(None, None).map_err(failed("openpty"))?;
        let mut settings = tcgetattr(&pair.slave).map_err(failed("tcgetattr"))?;
        cfmakeraw(&mut settings);
        tcsetattr(&pair.slave, SetArg::TCSANOW, &settings).map_err(failed("tcsetattr"))?;
        let path = ttyname(&pair.slave).map_err(failed("ttyname"))?;
        let flags = fcntl(&pair.master, FcntlArg::F_GETFL).map_err(failed("fcntl"))?;
        let flags = OFlag::from_bits_retain(flags) | OFlag::O_NONBLOCK;
        fcntl(&pair.master, FcntlArg::F_SETFL(flags)).map_err(failed("fcntl"))?;
        for fd in [&pair.master, &pair.slave] {
            fcntl(fd, FcntlArg::F_SETFD(nix::fcntl::FdFlag::FD_CLOEXEC)).map_err(failed("fcntl"))?;
        }
        Ok(Self { master: pair.master.into(), _slave: pair.slave, path, links: Vec::new() })
    }

    /// Path of the other end, such as `/dev/pts/3`.
    #[must_use]
    pub fn slave_path(&self) -> &Path {
        &self.path
    }

    /// Makes a symbolic link to the other end, in place of a link that is there; it goes away with the pair.
    ///
    /// # Errors
    /// [`TransportError::PtyLink`] where the folder cannot be written, or something other than a link is there.
    pub fn link(&mut self, path: impl Into<PathBuf>) -> Result<(), TransportError> {
        let path = path.into();
        let failed = |source| TransportError::PtyLink { path: path.clone(), source };
        match std::fs::symlink_metadata(&path) {
            Ok(meta) if meta.is_symlink() => std::fs::remove_file(&path).map_err(failed)?,
            Ok(_) => return Err(failed(io::Error::from(io::ErrorKind::AlreadyExists))),
            Err(_) => {}
        }
        std::os::unix::fs::symlink(&self.path, &path).map_err(failed)?;
        self.links.push(path);
        Ok(())
    }

    /// Sends what the line takes now and drops the rest, as a device does whose host does not read.
    ///
    /// Returns how many bytes were sent.
    ///
    /// # Errors
    /// What the system says, other than that the line is full.
    pub fn write_lossy(&mut self, mut bytes: &[u8]) -> io::Result<usize> {
        let mut sent = 0;
        while !bytes.is_empty() {
            match self.master.write(bytes) {
                Ok(n) => {
                    sent += n;
                    bytes = &bytes[n..];
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(sent)
    }

    /// Reads what is there.
    ///
    /// # Errors
    /// [`io::ErrorKind::WouldBlock`] where nothing is there, and what the system says.
    pub fn try_read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.master.read(buffer)
    }

    fn wait(&self, flags: PollFlags) -> io::Result<()> {
        let mut fds = [PollFd::new(self.master.as_fd(), flags)];
        match poll(&mut fds, PollTimeout::NONE) {
            Ok(_) | Err(nix::Error::EINTR) => Ok(()),
            Err(e) => Err(e.into()),
        }
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}

/// Waits while the line is full; see [`Pty::write_lossy`] for a device that does not.
impl Write for Pty {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            match self.master.write(bytes) {
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => self.wait(PollFlags::POLLOUT)?,
                done => return done,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Waits for bytes that the other end wrote.
impl Read for Pty {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.try_read(buffer) {
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => self.wait(PollFlags::POLLIN)?,
                done => return done,
            }
        }
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        for link in &self.links {
            // A later pair may have taken the link over.
            if std::fs::read_link(link).is_ok_and(|to| to == self.path) {
                let _ = std::fs::remove_file(link);
            }
        }
    }
}
