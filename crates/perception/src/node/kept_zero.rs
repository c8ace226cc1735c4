//! The zero of a skin over a crash of its node.
//!
//! A node that starts averages untouched readings for its zero. One that was killed and starts again may find the skin
//! touched, because the hand holds something: it would give no contacts until that is let go. So a node under `launch`
//! keeps its zero in a file, in a folder that ends with the launch, and one that starts again within [`FRESH`] goes on with
//! it. A zero drifts over minutes, so that an older one is not used. A node that is stopped removes the file: its next start
//! averages a new zero.

use std::path::{Path, PathBuf};
use std::time::Duration;

use dermis_skin::SkinDescription;
use serde::{Deserialize, Serialize};

/// Names the folder; `launch` sets it for what it starts.
pub(super) const FOLDER: &str = "DERMIS_RESTART_DIR";
/// How often the zero is written down.
pub(super) const PERIOD: Duration = Duration::from_millis(500);
/// Oldest zero that is used.
const FRESH: Duration = Duration::from_secs(60);
/// \[byte\] longest file that is read; one of ours has some 20 a channel.
const LONGEST: u64 = 1 << 20;

/// Where the zero of a node is kept, if anywhere.
#[derive(Debug)]
pub(super) struct KeptZero {
    path: Option<PathBuf>,
    /// Hash of the skin description.
    skin: String,
}

#[derive(Debug, Serialize, Deserialize)]
struct Saved {
    skin: String,
    /// \[ns since the Unix epoch\]
    time: i64,
    /// In the unit of the skin; none for a channel without a zero.
    zero: Vec<Option<f64>>,
}

impl KeptZero {
    /// For the node of this full name, in this folder.
    pub(super) fn new(folder: Option<&Path>, node: &str, skin: &SkinDescription) -> Self {
        let name = format!("{}.zero.json", node.trim_start_matches('/').replace('/', "."));
        Self { path: folder.map(|folder| folder.join(name)), skin: skin.hash() }
    }

    /// The zero that was kept, and its age, where it is of this skin and fresh at `now` \[ns since the Unix epoch\].
    pub(super) fn load(&self, now: i64) -> Option<(Vec<f64>, Duration)> {
        let path = self.path.as_ref()?;
        if std::fs::metadata(path).ok()?.len() > LONGEST {
            return None;
        }
        let saved: Saved = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        // A clock that was set back makes a negative age, which is refused.
        let age = Duration::from_nanos(u64::try_from(now.checked_sub(saved.time)?).ok()?);
        let zero = saved.zero.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect();
        (saved.skin == self.skin && age <= FRESH).then_some((zero, age))
    }

    /// What writes the zero down, for a thread that may wait for the disk.
    pub(super) fn save(&self, zero: &[f64], now: i64) -> Option<impl FnOnce() + Send + 'static> {
        let path = self.path.clone()?;
        let zero = zero.iter().map(|value| value.is_finite().then_some(*value)).collect();
        let saved = Saved { skin: self.skin.clone(), time: now, zero };
        Some(move || {
            // A crash in the middle leaves the one before.
            let written = serde_json::to_vec(&saved).map_err(std::io::Error::from).and_then(|text| {
                let new = path.with_extension("new");
                std::fs::write(&new, text)?;
                std::fs::rename(&new, &path)
            });
            if let Err(error) = written {
                tracing::debug!("the zero is not kept at {}: {error}", path.display());
            }
        })
    }

    /// Takes the file away.
    pub(super) fn forget(&self) {
        if let Some(path) = &self.path {
            // There may be none.
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_estimate::testing::skin_with;

    const NOW: i64 = 1_800_000_000_000_000_000;

    #[test]
    fn a_zero_is_kept_for_the_same_skin_and_not_for_long() {
        let folder = tempfile::tempdir().unwrap();
        let skin = skin_with("");
        let kept = KeptZero::new(Some(folder.path()), "/left/pad", &skin);
        assert_eq!(kept.load(NOW), None);
        let zero = [101_325.25, -3.0, f64::NAN, 1e-9];
        kept.save(&zero, NOW).unwrap()();
        assert!(folder.path().join("left.pad.zero.json").exists());
        let later = |seconds: i64| kept.load(NOW + seconds * 1_000_000_000);
        let (found, age) = later(2).unwrap();
        assert_eq!((found[0], found[1], found[3], age), (zero[0], zero[1], zero[3], Duration::from_secs(2)));
        assert!(found[2].is_nan() && found.len() == 4);
        assert!(later(60).is_some() && later(61).is_none() && later(-1).is_none());

        let wider = skin_with("surface = { type = \"rectangle\", size = [0.03, 0.02], spacing = 0.005 }");
        let other = KeptZero::new(Some(folder.path()), "/left/pad", &wider);
        assert!(other.load(NOW).is_none(), "the zero of another skin is none");
        let elsewhere = KeptZero::new(Some(folder.path()), "/right/pad", &skin);
        assert_eq!(elsewhere.load(NOW), None);
        kept.forget();
        assert_eq!(kept.load(NOW), None);
    }

    #[test]
    fn without_a_folder_and_from_nonsense_there_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let skin = skin_with("");
        let nowhere = KeptZero::new(None, "/pad", &skin);
        assert!(nowhere.load(NOW).is_none() && nowhere.save(&[0.0; 4], NOW).is_none());
        let kept = KeptZero::new(Some(folder.path()), "/pad", &skin);
        for text in ["", "{", "[]", "{\"skin\": 3}", "\u{0}\u{1}"] {
            std::fs::write(folder.path().join("pad.zero.json"), text).unwrap();
            assert_eq!(kept.load(NOW), None, "{text}");
        }
    }
}
