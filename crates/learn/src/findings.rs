//! What data lack, gathered before anything is learned or measured: all of it, not the first only.

use std::fmt;
use std::path::Path;

/// One thing about the data that someone who learns from it or measures on it has to know.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What it is about: a bag, or a map of its topics.
    pub place: String,
    /// What is the case.
    pub what: String,
    /// What that blocks, and what to do; empty where it blocks nothing.
    pub blocks: String,
    /// Whether nothing can go on.
    pub fatal: bool,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.what)?;
        if self.blocks.is_empty() { Ok(()) } else { write!(f, ": {}", self.blocks) }
    }
}

/// All that was found, in the order in which it was.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Findings(Vec<Finding>);

impl Findings {
    /// Something that does not stop anyone.
    pub fn notice(&mut self, place: impl fmt::Display, what: impl Into<String>, blocks: impl Into<String>) {
        self.push(place, what.into(), blocks.into(), false);
    }

    /// Something that has to be mended first.
    pub fn fatal(&mut self, place: impl fmt::Display, what: impl Into<String>, blocks: impl Into<String>) {
        self.push(place, what.into(), blocks.into(), true);
    }

    fn push(&mut self, place: impl fmt::Display, what: String, blocks: String, fatal: bool) {
        let finding = Finding { place: place.to_string(), what, blocks, fatal };
        if !self.0.contains(&finding) {
            self.0.push(finding);
        }
    }

    /// Takes over what was found elsewhere.
    pub fn extend(&mut self, other: Self) {
        other.0.into_iter().for_each(|f| self.push(f.place, f.what, f.blocks, f.fatal));
    }

    /// Whether something has to be mended first.
    #[must_use]
    pub fn is_fatal(&self) -> bool {
        self.0.iter().any(|f| f.fatal)
    }

    /// What stops nobody, a sentence each.
    #[must_use]
    pub fn notices(&self) -> Vec<String> {
        self.0.iter().filter(|f| !f.fatal).map(ToString::to_string).collect()
    }

    /// Everything.
    pub fn iter(&self) -> impl Iterator<Item = &Finding> {
        self.0.iter()
    }
}

impl fmt::Display for Findings {
    /// What has to be mended first, one line each where there are several; then what else there is to know.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fatal: Vec<&Finding> = self.0.iter().filter(|f| f.fatal).collect();
        match fatal.as_slice() {
            [only] => write!(f, "{only}")?,
            several => {
                write!(f, "{} things are in the way", several.len())?;
                for (i, finding) in several.iter().enumerate() {
                    write!(f, "\n  {}. {finding}", i + 1)?;
                }
            }
        }
        for notice in self.notices() {
            write!(f, "\n  note: {notice}")?;
        }
        Ok(())
    }
}

/// How findings call a bag.
pub(crate) fn bag(path: &Path) -> String {
    format!("bag {}", path.display())
}
