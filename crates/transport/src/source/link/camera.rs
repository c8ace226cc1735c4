//! A camera of this machine, by Video4Linux 2: pictures as it compresses them itself, one after another.
//!
//! Its driver fills a few buffers in turn; a picture is copied out of one before the next is waited for. Pictures that nobody fetches in time are
//! the driver's to drop. What the driver marks as damaged is passed over.

use std::io::{self, ErrorKind};
use std::mem::ManuallyDrop;
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::time::Duration;

use moq_v4l::buffer::{Flags, Type};
use moq_v4l::framesize::FrameSizeEnum;
use moq_v4l::io::mmap::Stream;
use moq_v4l::io::traits::{CaptureStream, Stream as _};
use moq_v4l::video::Capture;
use moq_v4l::video::capture::Parameters;
use moq_v4l::{Device, FourCC};

/// Buffers that the driver fills in turn.
const BUFFERS: u32 = 4;
/// What cameras call pictures that are each a JPEG, the usual name first.
const COMPRESSED: [&[u8; 4]; 2] = [b"MJPG", b"JPEG"];

/// A camera that sends pictures.
pub(super) struct Camera {
    /// Dropped by hand: dropping it panics where the driver does not stop.
    stream: ManuallyDrop<Stream<'static>>,
    picture: Vec<u8>,
    /// Bytes of the picture that were read already.
    given: usize,
}

impl Camera {
    /// Sets a camera up and waits for its first picture, for so long; with what it is, for people. Otherwise a reason for people.
    pub(super) fn open(
        path: &Path,
        size: Option<[u32; 2]>,
        rate: Option<u32>,
        timeout: Duration,
    ) -> Result<(Self, String), String> {
        let name = path.display();
        let failed = |e: io::Error| explain(path, timeout, &e);
        let device = Device::with_path(path).map_err(failed)?;
        let caps = device.query_caps().map_err(failed)?;
        let mut format = compressed(&device, path)?;
        if let Some([width, height]) = size {
            (format.width, format.height) = (width, height);
        }
        let wanted = [format.width, format.height];
        let set = device.set_format(&format).map_err(failed)?;
        if [set.width, set.height] != wanted || set.fourcc != format.fourcc {
            let [width, height] = wanted;
            return Err(format!(
                "{name} has no pictures of {width}x{height}: take size={}",
                sizes(&device, format.fourcc)
            ));
        }
        let mut pace = String::new();
        if let Some(rate) = rate {
            let unset = |e: io::Error| {
                format!("{name} does not take {rate} pictures a second ({e}): leave `rate` out")
            };
            let interval = device.set_params(&Parameters::with_fps(rate)).map_err(unset)?.interval;
            let hertz = f64::from(interval.denominator) / f64::from(interval.numerator.max(1));
            pace = format!(", {rate} pictures a second");
            if (hertz - f64::from(rate)).abs() > 0.01 {
                let hertz = (hertz * 100.0).round() / 100.0;
                pace = format!(", {hertz} pictures a second where {rate} were asked for");
            }
        }
        let stream = Stream::with_buffers(&device, Type::VideoCapture, BUFFERS).map_err(failed)?;
        let mut camera = Self { stream: ManuallyDrop::new(stream), picture: Vec::new(), given: 0 };
        camera.stream.set_timeout(timeout);
        camera.next().map_err(failed)?;
        let [width, height] = wanted;
        Ok((camera, format!("{} at {name}, {width}x{height}{pace}", caps.card)))
    }

    /// Takes the next picture, where there is one that can be read.
    fn next(&mut self) -> io::Result<()> {
        self.picture.clear();
        self.given = 0;
        let (bytes, meta) = self.stream.next()?;
        if !meta.flags.contains(Flags::ERROR) {
            let length = bytes.len().min(meta.bytesused as usize);
            self.picture.extend_from_slice(&bytes[..length]);
        }
        Ok(())
    }

    /// Whether a picture is not read to its end yet.
    pub(super) fn holds(&self) -> bool {
        self.given < self.picture.len()
    }

    pub(super) fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the stream keeps the file open for as long as it lives, which is longer than this borrow.
        unsafe { BorrowedFd::borrow_raw(self.stream.handle().fd()) }
    }

    /// The next bytes; `None` where a picture was damaged. Called where there is a picture: it waits for one otherwise.
    pub(super) fn read(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        if !self.holds() {
            self.next()?;
        }
        let rest = &self.picture[self.given..];
        let given = rest.len().min(buffer.len());
        buffer[..given].copy_from_slice(&rest[..given]);
        self.given += given;
        Ok((given > 0).then_some(given))
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        // One that does not stop, other than because it was unplugged, would panic: its buffers stay until the program ends.
        let stopped = self.stream.stop();
        if stopped.is_ok() || stopped.is_err_and(|e| e.raw_os_error() == Some(nix::libc::ENODEV)) {
            // SAFETY: it is not used after this.
            unsafe { ManuallyDrop::drop(&mut self.stream) };
        }
    }
}

/// The format that the camera is set to, but compressed.
fn compressed(device: &Device, path: &Path) -> Result<moq_v4l::Format, String> {
    let formats = device.enum_formats().map_err(|e| format!("cannot read {}: {e}", path.display()))?;
    let has = |kind: &&[u8; 4]| formats.iter().any(|format| format.fourcc == FourCC::new(kind));
    let Some(kind) = COMPRESSED.into_iter().find(has) else {
        if formats.is_empty() {
            return Err(format!(
                "{} gives no pictures: a camera has several device files, of which one does; try the others",
                path.display()
            ));
        }
        let known: Vec<String> = formats.iter().map(|format| format.fourcc.to_string()).collect();
        return Err(format!(
            "{} does not compress its pictures (it has {}), and MJPG is what is read: serve it by a program that does, as \
             ustreamer, and read that by http://",
            path.display(),
            known.join(", ")
        ));
    };
    let mut format =
        device.format().map_err(|e| format!("cannot read the format of {}: {e}", path.display()))?;
    format.fourcc = FourCC::new(kind);
    Ok(format)
}

/// Sizes that a camera has, for people.
fn sizes(device: &Device, kind: FourCC) -> String {
    let known: Vec<String> = device
        .enum_framesizes(kind)
        .unwrap_or_default()
        .into_iter()
        .map(|size| match size.size {
            FrameSizeEnum::Discrete(one) => format!("{}x{}", one.width, one.height),
            FrameSizeEnum::Stepwise(all) => {
                format!(
                    "{}x{} to {}x{} in steps of {}x{}",
                    all.min_width,
                    all.min_height,
                    all.max_width,
                    all.max_height,
                    all.step_width,
                    all.step_height
                )
            }
        })
        .collect();
    if known.is_empty() { "what its driver lists".to_owned() } else { known.join(", ") }
}

/// What an error means to people.
fn explain(path: &Path, timeout: Duration, error: &io::Error) -> String {
    let name = path.display();
    match (error.kind(), error.raw_os_error()) {
        (ErrorKind::NotFound, _) => {
            format!("there is no {name}: plug the camera in, or look for it under /dev/v4l/by-id")
        }
        (ErrorKind::PermissionDenied, _) => {
            format!("{name} may not be opened: add this user to the group video, and log in again")
        }
        (ErrorKind::TimedOut, _) => format!("{name} sends no picture within {timeout:?}"),
        (_, Some(nix::libc::ENOTTY | nix::libc::EINVAL)) => {
            format!("{name} is no camera of Video4Linux 2, or does not take these settings: {error}")
        }
        (_, Some(nix::libc::EBUSY)) => format!("{name} is in use by another program (fuser {name} names it)"),
        _ => format!("cannot use the camera {name}: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_is_refused_with_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| Camera::open(path, None, None, Duration::from_secs(1)).err().unwrap();
        let missing = folder.path().join("video9");
        assert_eq!(
            refused(&missing),
            format!(
                "there is no {}: plug the camera in, or look for it under /dev/v4l/by-id",
                missing.display()
            )
        );
        let said = refused(Path::new("/dev/null"));
        assert!(said.starts_with("/dev/null is no camera of Video4Linux 2"), "{said}");
        let file = folder.path().join("file");
        std::fs::write(&file, "no camera").unwrap();
        let said = refused(&file);
        assert!(said.contains("is no camera of Video4Linux 2"), "{said}");
    }
}
