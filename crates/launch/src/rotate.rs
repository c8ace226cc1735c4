//! A log file that does not grow for ever.
//!
//! Once `NAME.log` is as long as it may be it becomes `NAME.log.1`, that one `NAME.log.2`, and so on; the oldest goes.

use std::fs::File;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// A log file and the older ones of its name.
#[derive(Debug)]
pub(crate) struct LogFile {
    path: PathBuf,
    out: BufWriter<File>,
    written: u64,
    /// \[byte\]; 0 is without limit.
    size: u64,
    keep: u32,
}

fn append(path: &Path) -> io::Result<File> {
    File::options().create(true).append(true).open(path)
}

impl LogFile {
    /// Goes on with the file at `path`: up to `size` \[byte\], and `keep` older files.
    pub(crate) fn open(path: PathBuf, size: u64, keep: u32) -> io::Result<Self> {
        let file = append(&path)?;
        let written = file.metadata()?.len();
        Ok(Self { path, out: BufWriter::new(file), written, size, keep })
    }

    /// Appends a line.
    pub(crate) fn line(&mut self, line: &str) -> io::Result<()> {
        if self.size > 0 && self.written > 0 && self.written + line.len() as u64 >= self.size {
            self.rotate()?;
        }
        self.written += line.len() as u64 + 1;
        writeln!(self.out, "{line}")
    }

    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Lets it go without another try to write what waits in its buffer.
    pub(crate) fn give_up(self) -> PathBuf {
        let _ = self.out.into_parts();
        self.path
    }

    fn older(&self, number: u32) -> PathBuf {
        let mut name = self.path.clone().into_os_string();
        name.push(format!(".{number}"));
        name.into()
    }

    fn rotate(&mut self) -> io::Result<()> {
        self.out.flush()?;
        let file = self.out.get_ref();
        let length = file.metadata()?.len();
        if length < self.written / 2 {
            // Somebody else (`logrotate` with `copytruncate`) has cut it meanwhile.
            self.written = length;
            return Ok(());
        }
        if self.keep == 0 {
            file.set_len(0)?;
        } else {
            for number in (0..self.keep).rev() {
                let from = if number == 0 { self.path.clone() } else { self.older(number) };
                match std::fs::rename(from, self.older(number + 1)) {
                    // Not so many yet, or somebody has removed it.
                    Err(e) if e.kind() == ErrorKind::NotFound => {}
                    other => other?,
                }
            }
            self.out = BufWriter::new(append(&self.path)?);
        }
        self.written = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(path: &Path) -> Vec<u64> {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        text.lines().map(|line| line.trim().parse().unwrap()).collect()
    }

    #[test]
    fn the_latest_lines_are_kept_within_the_bound_over_restarts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pad.log");
        let mut at = 0;
        for _ in 0..5 {
            let mut file = LogFile::open(path.clone(), 1000, 2).unwrap();
            for _ in 0..150 {
                file.line(&format!("{at:9}")).unwrap();
                at += 1;
            }
            file.flush().unwrap();
        }
        let mut names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["pad.log", "pad.log.1", "pad.log.2"]);
        let all: Vec<u64> = ["pad.log.2", "pad.log.1", "pad.log"]
            .iter()
            .flat_map(|name| {
                let path = folder.path().join(name);
                assert!(std::fs::metadata(&path).unwrap().len() <= 1000, "{name}");
                lines(&path)
            })
            .collect();
        assert_eq!(
            all,
            (at - all.len() as u64..at).collect::<Vec<_>>(),
            "the latest, and none is missing between files"
        );
        assert!(all.len() > 200);
    }

    #[test]
    fn a_file_that_others_cut_or_removed_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pad.log");
        let mut file = LogFile::open(path.clone(), 1000, 1).unwrap();
        let fill = |file: &mut LogFile, count: u64| {
            for i in 0..count {
                file.line(&format!("{i:9}")).unwrap();
            }
            file.flush().unwrap();
        };
        fill(&mut file, 95);
        File::options().write(true).open(&path).unwrap().set_len(0).unwrap();
        fill(&mut file, 10);
        assert_eq!((lines(&path).len(), file.older(1).exists()), (10, false));
        fill(&mut file, 80);
        std::fs::remove_file(&path).unwrap();
        fill(&mut file, 30);
        assert!(!lines(&path).is_empty());
    }

    #[test]
    fn without_older_files_it_starts_over_and_without_bound_it_grows() {
        let folder = tempfile::tempdir().unwrap();
        for (size, keep, most) in [(1000, 0, 1000), (0, 3, 5000)] {
            let path = folder.path().join(format!("{size}.log"));
            let mut file = LogFile::open(path.clone(), size, keep).unwrap();
            for i in 0..500 {
                file.line(&format!("{i:9}")).unwrap();
            }
            file.flush().unwrap();
            let length = std::fs::metadata(&path).unwrap().len();
            assert!(length <= most && lines(&path).last() == Some(&499), "{length} bytes");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
