//! Names for a recording that goes on: bags are never written over, so that the next part gets a number.

use std::path::{Path, PathBuf};

use crate::BagError;

/// Where a recording to `dir` can go on, and the part before it: `dir` itself and none where nothing is there, else the first
/// of `<dir>-2`, `<dir>-3` … that is free.
///
/// # Errors
/// Where a folder cannot be looked into, or `dir` is a file.
pub fn next_free(dir: impl AsRef<Path>) -> Result<(PathBuf, Option<PathBuf>), BagError> {
    let dir = dir.as_ref();
    let name = dir.file_name().map_or_else(|| "bag".to_owned(), |name| name.to_string_lossy().into_owned());
    let (mut next, mut before) = (dir.to_path_buf(), None);
    let mut number = 1_u64;
    while !is_free(&next)? {
        number += 1;
        before = Some(next);
        next = dir.with_file_name(format!("{name}-{number}"));
    }
    Ok((next, before))
}

fn is_free(dir: &Path) -> Result<bool, BagError> {
    match std::fs::read_dir(dir) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(error) => Err(BagError::io("open", dir)(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_numbered_from_two_on() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        let part = |number: u64| dir.path().join(format!("run-{number}"));
        assert_eq!(next_free(&run).unwrap(), (run.clone(), None));
        // An empty folder is free: whoever made it did not get further.
        std::fs::create_dir(&run).unwrap();
        assert_eq!(next_free(&run).unwrap(), (run.clone(), None));
        std::fs::write(run.join("run_0.mcap"), "").unwrap();
        assert_eq!(next_free(&run).unwrap(), (part(2), Some(run.clone())));
        std::fs::create_dir(part(2)).unwrap();
        std::fs::write(part(2).join("metadata.yaml"), "").unwrap();
        assert_eq!(next_free(run.join("")).unwrap(), (part(3), Some(part(2))));
        std::fs::write(part(3), "a file").unwrap();
        assert!(next_free(&run).is_err());
    }
}
