//! The file that a bag is written to.

use std::{
    fs::File,
    io::{self, BufWriter, Seek, SeekFrom, Write},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::patience::Patient;

/// A file that is only appended to, and knows its length without asking the system.
pub(super) struct Out {
    pub(super) file: BufWriter<Patient<File>>,
    pub(super) written: u64,
    /// [`Self::written`], for the writer of the bag.
    pub(super) length: Arc<AtomicU64>,
}

impl Write for Out {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.written += count as u64;
        self.length.store(self.written, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Out {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.written),
            SeekFrom::Start(at) if at == self.written => Ok(at),
            _ => Err(io::Error::new(io::ErrorKind::Unsupported, "a bag is only appended to")),
        }
    }
}
