//! Frames of labelled bags, joined with their ground truth.
//!
//! A data set holds, of every frame, when it was acquired and what was true ([`FrameInfo`]). Readings stay in the bags and
//! are read again by who needs them ([`Dataset::stream`]), so that memory does not grow with the size of a frame; bags of
//! up to [`DatasetOptions::memory`] are held, which saves the second reading.
//!
//! Memory grows with the number of frames up to [`DatasetOptions::most_frames`], and not beyond: 72 bytes for each ([`FrameInfo`]), and
//! 88 for each true contact ([`TruthContact`]); while a bag is read, up to 136 bytes for each frame, 96 more where it has ground truth,
//! and 176 for each contact. An hour at 100 Hz, touched throughout by one contact, is 58 MB, and up to 147 MB while it is read. Of bags with
//! more frames, every k-th is in the index (`index`), and frames and ground truth are not held while they are joined (`track`). All
//! frames are still read in order, for zero, drift and history. The assumption is that frames that follow each other tell nearly the same; the
//! cost is two more readings of the bag. `tests/memory.rs` holds all of it.

mod index;
mod order;
mod read;
mod recording;
mod stream;
mod track;
mod truth;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dermis_inference::{Baseline, FeatureConfig, Features};
use dermis_skin::SkinDescription;
use sha2::{Digest, Sha256};

use crate::findings::{self, Findings};
use crate::map::{Bias, LabelMap, Locations};
use crate::{LearnError, SplitConfig, SplitKind};

pub(crate) use index::Sparse;
use index::{Between, Plan};
pub(crate) use read::check_late;
use read::{Opened, Reader};
use stream::{FEWEST_TARE_FRAMES, Source};
pub use stream::{FrameInfo, Sample};
pub(crate) use track::{FromBag, Gathered, Track};
pub use truth::{Truth, TruthContact};

/// Contact locations below which an interval over held-out ones says little.
const FEW_LOCATIONS: usize = 20;
/// Bytes of frames that a data set holds where nothing else is requested.
const MEMORY: usize = 256 << 20;
/// Frames that are in the index of a data set where nothing else is requested: 11 hours at 100 Hz. Touched throughout by one contact, they take
/// 0.6 GiB, and rows of a dense network of 25 inputs and 3 outputs 0.9 GB more, which a machine of 8 GiB has.
pub const MOST_FRAMES: usize = 4_000_000;

/// One recording.
#[derive(Debug, Clone)]
pub struct Run {
    /// Where it was read from.
    pub path: PathBuf,
    /// Readings of one session share their mounting, zero and temperature history.
    pub session: String,
    /// `sha256:` and 64 hex digits over frames and ground truth as they are stored.
    pub hash: String,
    /// What is known of the frames that are in the index, in order of acquisition: all of them, or every k-th where bags hold more than
    /// [`DatasetOptions::most_frames`]. [`Dataset::stream`] gives their readings, and those of the frames between.
    pub samples: Vec<FrameInfo>,
    /// Frames that the device sent and the bag lacks.
    pub lost: u64,
    /// What the rig's force sensor does when nothing touches; `None` where the ground truth is ours.
    pub bias: Option<Bias>,
    /// What is known of the other frames; `None` where all are in the index.
    between: Option<Arc<Between>>,
    source: Source,
}

/// Which frame of which run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SampleId {
    /// Index in [`Dataset::runs`].
    pub run: usize,
    /// Number of the frame in its run, in order of acquisition, from 0: [`FrameInfo::number`], and the index in [`Run::samples`] where
    /// all frames are there.
    pub sample: usize,
}

/// How bags become a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct DatasetOptions {
    /// \[s\] between a frame and its ground truth that still counts as the same instant; `None`: half a frame
    /// period of the skin, at least 10 ms.
    pub tolerance: Option<f64>,
    /// Takes the zero anew whenever the ground truth says that the testbed stands by for as long as a tare takes, as
    /// a robot does that knows it is touching nothing. Otherwise the zero is taken once and follows drift.
    pub tare_when_idle: bool,
    /// Which device of the skin's type, where several are in a bag.
    pub instance: Option<String>,
    /// Topic of the frames, where several skins of one description are in a bag; a map has its own.
    pub taxels: Option<String>,
    /// Takes the ground truth from a robot's and a force sensor's topics, instead of from
    /// `dermis_msgs/msg/Indentation`.
    pub map: Option<LabelMap>,
    /// Bytes of frames that are held in memory over all bags; further ones are read anew whenever their readings are
    /// needed.
    pub memory: usize,
    /// Frames that are indexed at most over all bags, at 72 bytes each and 88 for each contact. Where bags hold more, every k-th is used, and
    /// one of each press that has none among those; a notice says so.
    pub most_frames: usize,
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self {
            tolerance: None,
            tare_when_idle: true,
            instance: None,
            taxels: None,
            map: None,
            memory: MEMORY,
            most_frames: MOST_FRAMES,
        }
    }
}

/// Recordings of one skin.
#[derive(Debug, Clone)]
pub struct Dataset {
    skin: SkinDescription,
    runs: Vec<Run>,
    findings: Findings,
    map: Option<LabelMap>,
}

impl Dataset {
    /// Reads bags of one skin: its frames, joined with the ground truth by acquisition time. Where the ground
    /// truth is sampled on both sides of a frame during one press, it is interpolated; otherwise the nearest
    /// within tolerance counts. Readings of a rig ([`DatasetOptions::map`]) are always interpolated.
    ///
    /// # Errors
    ///
    /// [`LearnError::Unfit`] says all that the bags lack; [`LearnError::Bag`] where one cannot be read.
    pub fn from_bags<P: AsRef<Path>>(
        paths: &[P],
        skin: &SkinDescription,
        options: &DatasetOptions,
    ) -> Result<Self, LearnError> {
        let data = Self::survey(paths, skin, options)?;
        if data.findings.is_fatal() {
            return Err(LearnError::Unfit(data.findings));
        }
        Ok(data)
    }

    /// Reads bags as [`from_bags`](Self::from_bags), but keeps for [`check`](Self::check) what they lack: a bag that
    /// cannot be used is left out.
    ///
    /// # Errors
    ///
    /// [`LearnError::Bag`] where one cannot be read.
    pub fn survey<P: AsRef<Path>>(
        paths: &[P],
        skin: &SkinDescription,
        options: &DatasetOptions,
    ) -> Result<Self, LearnError> {
        let (mut findings, mut pressed) = (Findings::default(), Locations::default());
        let mut runs = Vec::new();
        let opened = paths.iter().map(|path| Opened::new(path.as_ref(), skin, options));
        let opened = opened.collect::<Result<Vec<_>, _>>()?;
        let frames: Vec<usize> = opened.iter().map(|bag| bag.frames).collect();
        let plan = Plan::new(options.most_frames, &frames);
        let mut reader = Reader { skin, options, plan, memory: options.memory };
        for bag in &opened {
            let mut own = Findings::default();
            runs.extend(reader.read(bag, &mut pressed, &mut own)?);
            findings.extend(own);
        }
        Ok(Self { skin: skin.clone(), runs, findings, map: options.map.clone() })
    }

    /// A data set of runs that were made elsewhere.
    #[must_use]
    pub fn from_runs(skin: &SkinDescription, runs: Vec<Run>) -> Self {
        Self { skin: skin.clone(), runs, findings: Findings::default(), map: None }
    }

    /// Says what of the data stands in the way of learning `targets` with this split, and what else there is to know:
    /// all of it, before anything is learned. What was found on reading the bags comes first.
    #[must_use]
    pub fn check(&self, targets: &[&str], baseline: Baseline, split: &SplitConfig) -> Findings {
        let mut findings = self.findings.clone();
        if self.runs.is_empty() {
            return findings;
        }
        let place = match self.runs.as_slice() {
            [run] => findings::bag(&run.path),
            _ => "the data".to_owned(),
        };
        let known = self.targets();
        let list =
            known.iter().map(|(name, n)| format!("{name} ({n} samples)")).collect::<Vec<_>>().join(", ");
        let list = if list.is_empty() {
            "nothing is known of a touched skin".to_owned()
        } else {
            format!("known are {list}")
        };
        let unknown: Vec<String> =
            targets.iter().filter(|t| !known.contains_key(**t)).map(|t| format!("`{t}`")).collect();
        if !unknown.is_empty() {
            findings.fatal(
                &place,
                format!("{} is never known while the skin is touched; {list}", unknown.join(", ")),
                "it cannot be learned; name other targets or record them",
            );
        }
        if targets.contains(&"contact") && self.labelled().all(|(_, _, t)| t.touched()) {
            findings.fatal(
                &place,
                "holds touched samples only",
                "`contact` cannot be learned; leave it out or record idle frames",
            );
        }
        if baseline == Baseline::Tared {
            for (index, run) in self.runs.iter().enumerate() {
                let zero_known = match self.knows_zero(index) {
                    Ok(known) => known,
                    Err(error) => {
                        findings.fatal(
                            findings::bag(&run.path),
                            error.to_string(),
                            "its readings are needed again",
                        );
                        continue;
                    }
                };
                if zero_known == Some(false) {
                    findings.fatal(
                        findings::bag(&run.path),
                        format!(
                            "no stretch of {} s (and {FEWEST_TARE_FRAMES} frames) before the touched frames is labelled \
                             untouched",
                            self.skin.condition.tare_duration
                        ),
                        "the zero is unknown; record idle frames first, or train with `baseline = \"raw\"`",
                    );
                }
            }
        }
        if unknown.len() < targets.len()
            && let Err(error) = split.apply(self)
        {
            findings.fatal(&place, error.to_string(), "nothing would be measured on what was not trained on");
        }
        let locations = self.locations();
        if split.kind == SplitKind::Location && (2..FEW_LOCATIONS).contains(&locations) {
            findings.notice(
                &place,
                format!("was pressed at {locations} locations only"),
                "figures of the held-out ones say little; press at more locations",
            );
        }
        findings
    }

    /// How a rig's topics became ground truth; `None` where the bags hold ours.
    #[must_use]
    pub fn map(&self) -> Option<&LabelMap> {
        self.map.as_ref()
    }

    /// The skin.
    #[must_use]
    pub fn skin(&self) -> &SkinDescription {
        &self.skin
    }

    /// The recordings.
    #[must_use]
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// What someone who trains on it should know: a sentence each.
    #[must_use]
    pub fn notices(&self) -> Vec<String> {
        self.findings.notices()
    }

    /// Whether the zero is known at any touched frame of a run; `None` where none is touched.
    fn knows_zero(&self, run: usize) -> Result<Option<bool>, LearnError> {
        let mut answer = None;
        for sample in self.stream(run)? {
            let sample = sample?;
            if sample.truth.as_ref().is_some_and(Truth::touched) {
                let known = sample.tared.iter().any(|v| !v.is_nan());
                answer = Some(known);
                if known {
                    break;
                }
            }
        }
        Ok(answer)
    }

    /// What is known of one sample, without its readings; `None` where there is none of this identity in the index.
    #[must_use]
    pub fn sample(&self, id: SampleId) -> Option<&FrameInfo> {
        let samples = &self.runs.get(id.run)?.samples;
        if let Some(sample) = samples.get(id.sample).filter(|s| s.number as usize == id.sample) {
            return Some(sample);
        }
        let at = samples.binary_search_by_key(&id.sample, |s| s.number as usize).ok()?;
        samples.get(at)
    }

    /// Every sample that has ground truth, in order.
    pub fn labelled(&self) -> impl Iterator<Item = (SampleId, &FrameInfo, &Truth)> {
        self.runs.iter().enumerate().flat_map(|(run, r)| {
            let id = move |s: &FrameInfo| SampleId { run, sample: s.number as usize };
            r.samples.iter().filter_map(move |s| s.truth.as_ref().map(|t| (id(s), s, t)))
        })
    }

    /// Number of samples in which the skin is touched and a target is known, by target; targets that are never
    /// known are left out.
    #[must_use]
    pub fn targets(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for (_, _, truth) in self.labelled().filter(|(_, _, t)| t.touched()) {
            for target in Truth::TARGETS {
                if truth.value(target).is_some() {
                    *counts.entry(target).or_insert(0) += 1;
                }
            }
        }
        counts
    }

    /// Number of contact locations.
    #[must_use]
    pub fn locations(&self) -> usize {
        self.labelled()
            .filter(|(_, _, t)| t.touched())
            .map(|(_, _, t)| t.location)
            .collect::<BTreeSet<_>>()
            .len()
    }

    /// Hash over the hashes of the runs, in order.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        for run in &self.runs {
            hasher.update(run.hash.as_bytes());
        }
        hex(&hasher.finalize())
    }

    /// Input of a model for every labelled sample whose history reaches back far enough, computed by the same code
    /// as in a node. Rows lie end to end.
    ///
    /// # Errors
    ///
    /// [`LearnError::Feature`] where the configuration is wrong or does not fit the skin.
    pub fn inputs(
        &self,
        config: &FeatureConfig,
        baseline: Baseline,
    ) -> Result<(Vec<SampleId>, Vec<f32>), LearnError> {
        let (mut ids, mut rows) = (Vec::new(), Vec::new());
        self.each_input(config, baseline, |id, input| {
            ids.push(id);
            rows.extend_from_slice(input);
            Ok(())
        })?;
        Ok((ids, rows))
    }

    /// As [`inputs`](Self::inputs), one input after the other.
    ///
    /// # Errors
    ///
    /// As [`inputs`](Self::inputs), and those of `take`.
    pub fn each_input(
        &self,
        config: &FeatureConfig,
        baseline: Baseline,
        mut take: impl FnMut(SampleId, &[f32]) -> Result<(), LearnError>,
    ) -> Result<(), LearnError> {
        let mut features = Features::new(config.clone())?;
        for run in 0..self.runs.len() {
            features.reset();
            for (sample, s) in self.stream_for(run, config.image)?.enumerate() {
                let s = s?;
                if s.tare {
                    // As an estimator does: history seen with another zero would hold a step.
                    features.reset();
                }
                features.push(s.frame.stamp, s.numbers(baseline, config.image.is_some()))?;
                if s.truth.is_some()
                    && let Some(input) = features.input()
                {
                    take(SampleId { run, sample }, input)?;
                }
            }
        }
        Ok(())
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    let digits: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{digits}")
}

#[cfg(test)]
pub(crate) mod tests;
