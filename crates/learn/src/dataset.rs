//! Frames of labelled bags, joined with their ground truth.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use dermis_bag::{BagReader, Filter};
use dermis_inference::{Baseline, FeatureConfig, Features};
use dermis_msgs::Message;
use dermis_msgs::TypeSupport;
use dermis_msgs::msg::{Contact as ContactMsg, Indentation, SkinGeometry, TaxelFrame};
use dermis_skin::{ForceComponents, Frame, SkinDescription, Stamp, ZeroTracker};
use nalgebra::{Point3, Vector3};
use sha2::{Digest, Sha256};

use crate::LearnError;

/// Frames that a tare takes at least.
const FEWEST_TARE_FRAMES: usize = 3;

/// One true contact at one instant, in the frame of the skin's link. What is unknown is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthContact {
    /// \[m\] first point of contact on the undeformed surface.
    pub position: Point3<f64>,
    /// Unit, out of the skin.
    pub normal: Vector3<f64>,
    /// \[N\] exerted on the skin.
    pub force: Vector3<f64>,
    /// Which components of `force` are known.
    pub components: ForceComponents,
}

impl TruthContact {
    /// \[N\] pressing force, positive when pushed in; `None` where unknown.
    #[must_use]
    pub fn normal_force(&self) -> Option<f64> {
        // A component across the normal may be unknown, and NaN · 0 is NaN.
        let along = self.force.iter().zip(&self.normal).filter(|(_, n)| **n != 0.0);
        let force = -along.map(|(f, n)| f * n).sum::<f64>();
        (self.components != ForceComponents::None && force.is_finite()).then_some(force)
    }
}

/// What was true at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Counts presses within the session.
    pub press: u64,
    /// Identity of the contact location.
    pub location: u32,
    /// Whether the testbed stood by, away from the skin: a stretch in which the zero can be taken.
    pub idle: bool,
    /// All contacts; empty means that the skin was untouched.
    pub contacts: Vec<TruthContact>,
}

impl Truth {
    /// Names of the quantities that [`value`](Self::value) knows.
    pub const TARGETS: [&'static str; 8] = [
        "position.x",
        "position.y",
        "position.z",
        "force.x",
        "force.y",
        "force.z",
        "force.normal",
        "contact",
    ];

    /// Whether something touches the skin.
    #[must_use]
    pub fn touched(&self) -> bool {
        !self.contacts.is_empty()
    }

    /// The only contact; `None` where there is none or more than one.
    #[must_use]
    pub fn single(&self) -> Option<&TruthContact> {
        match self.contacts.as_slice() {
            [contact] => Some(contact),
            _ => None,
        }
    }

    /// One of [`TARGETS`](Self::TARGETS) in SI units, `None` where it is unknown or has no meaning: a position of
    /// an untouched skin, or anything but `contact` of several contacts. Untouched means no force.
    #[must_use]
    pub fn value(&self, target: &str) -> Option<f64> {
        if target == "contact" {
            return Some(f64::from(u8::from(self.touched())));
        }
        if !self.touched() {
            return target.starts_with("force.").then_some(0.0);
        }
        let contact = self.single()?;
        let full = |v: f64| (contact.components == ForceComponents::Full).then_some(v);
        let value = match target {
            "position.x" => Some(contact.position.x),
            "position.y" => Some(contact.position.y),
            "position.z" => Some(contact.position.z),
            "force.x" => full(contact.force.x),
            "force.y" => full(contact.force.y),
            "force.z" => full(contact.force.z),
            "force.normal" => contact.normal_force(),
            _ => None,
        };
        value.filter(|v| v.is_finite())
    }
}

/// One frame and what was true when it was acquired.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// As the device gave it, in the unit of the skin.
    pub frame: Frame,
    /// `value − zero` in the unit of the skin, one a channel; NaN where a channel is invalid or its zero unknown.
    pub tared: Vec<f32>,
    /// Whether the zero is taken anew from this frame on: the first of an idle stretch that is long enough.
    pub tare: bool,
    /// `None` for a frame without ground truth; it still feeds history.
    pub truth: Option<Truth>,
}

/// One recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Where it was read from.
    pub path: PathBuf,
    /// Readings of one session share their mounting, zero and temperature history.
    pub session: String,
    /// `sha256:` and 64 hex digits over frames and ground truth as they are stored.
    pub hash: String,
    /// Every frame, in order of acquisition.
    pub samples: Vec<Sample>,
    /// Frames that the device sent and the bag lacks.
    pub lost: u64,
}

/// Which frame of which run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SampleId {
    /// Index in [`Dataset::runs`].
    pub run: usize,
    /// Index in [`Run::samples`].
    pub sample: usize,
}

/// How bags become a data set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DatasetOptions {
    /// \[s\] between a frame and its ground truth that still counts as the same instant; `None`: half a frame
    /// period of the skin, at least 10 ms.
    pub tolerance: Option<f64>,
    /// Takes the zero anew whenever the ground truth says that the testbed stands by for as long as a tare takes, as
    /// a robot does that knows it is touching nothing. Otherwise the zero is taken once and follows drift.
    pub tare_when_idle: bool,
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self { tolerance: None, tare_when_idle: true }
    }
}

/// Recordings of one skin.
#[derive(Debug, Clone)]
pub struct Dataset {
    skin: SkinDescription,
    runs: Vec<Run>,
    notices: Vec<String>,
}

impl Dataset {
    /// Reads bags of one skin: its frames, joined with the ground truth by acquisition time. Where the ground
    /// truth is sampled on both sides of a frame during one press, it is interpolated; otherwise the nearest
    /// within tolerance counts.
    ///
    /// # Errors
    ///
    /// [`LearnError`] names the bag and says what is missing in it.
    pub fn from_bags<P: AsRef<Path>>(
        paths: &[P],
        skin: &SkinDescription,
        options: DatasetOptions,
    ) -> Result<Self, LearnError> {
        let mut notices = Vec::new();
        let runs = paths
            .iter()
            .map(|path| read_run(path.as_ref(), skin, options, &mut notices))
            .collect::<Result<_, _>>()?;
        Ok(Self { skin: skin.clone(), runs, notices })
    }

    /// A data set of runs that were made elsewhere; their samples must be tared.
    #[must_use]
    pub fn from_runs(skin: &SkinDescription, runs: Vec<Run>) -> Self {
        Self { skin: skin.clone(), runs, notices: Vec::new() }
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
    pub fn notices(&self) -> &[String] {
        &self.notices
    }

    /// One sample; `None` where there is none of this identity.
    #[must_use]
    pub fn sample(&self, id: SampleId) -> Option<&Sample> {
        self.runs.get(id.run)?.samples.get(id.sample)
    }

    /// Every sample that has ground truth, in order.
    pub fn labelled(&self) -> impl Iterator<Item = (SampleId, &Sample, &Truth)> {
        self.runs.iter().enumerate().flat_map(|(run, r)| {
            r.samples
                .iter()
                .enumerate()
                .filter_map(move |(sample, s)| s.truth.as_ref().map(|t| (SampleId { run, sample }, s, t)))
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
        let mut features = Features::new(config.clone())?;
        let (mut ids, mut rows) = (Vec::new(), Vec::new());
        for (run, r) in self.runs.iter().enumerate() {
            features.reset();
            for (sample, s) in r.samples.iter().enumerate() {
                if s.tare {
                    // As an estimator does: history seen with another zero would hold a step.
                    features.reset();
                }
                match baseline {
                    Baseline::Tared => features.push(s.frame.stamp, &s.tared)?,
                    Baseline::Raw => features.push(s.frame.stamp, &s.frame.values)?,
                }
                if s.truth.is_some()
                    && let Some(input) = features.input()
                {
                    ids.push(SampleId { run, sample });
                    rows.extend_from_slice(input);
                }
            }
        }
        Ok((ids, rows))
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    let digits: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{digits}")
}

fn read_run(
    path: &Path,
    skin: &SkinDescription,
    options: DatasetOptions,
    notices: &mut Vec<String>,
) -> Result<Run, LearnError> {
    let bag = BagReader::open(path)?;
    let (mut frames, mut truths) = (Vec::new(), Vec::new());
    let mut others = BTreeSet::new();
    let mut sessions = BTreeSet::new();
    let mut hasher = Sha256::new();
    let mut geometry = None;
    for support in [TypeSupport::of::<TaxelFrame>(), TypeSupport::of::<Indentation>()] {
        for topic in bag.topics().iter().filter(|t| t.type_name == support.name) {
            bag.check_type(topic, support)?;
        }
    }
    let wanted = [TaxelFrame::TYPE_NAME, Indentation::TYPE_NAME, SkinGeometry::TYPE_NAME];
    for message in bag.messages_where(Filter::default().types(wanted)) {
        let message = message?;
        if *message.type_name == *TaxelFrame::TYPE_NAME {
            let frame: TaxelFrame = message.decode()?;
            if frame.skin == skin.name {
                check_frame(path, skin, &frame)?;
                hasher.update(&message.data);
                frames.push(Frame::from(&frame));
            } else {
                others.insert(frame.skin);
            }
        } else if *message.type_name == *Indentation::TYPE_NAME {
            let truth: Indentation = message.decode()?;
            if truth.skin == skin.name {
                hasher.update(&message.data);
                sessions.insert(truth.session.clone());
                truths.push((truth.header.stamp.as_nanos(), truth_of(&truth)));
            }
        } else if let Ok(message) = message.decode::<SkinGeometry>()
            && message.skin == skin.name
        {
            geometry = Some(message.skin_hash);
        }
    }
    let shown = path.display();
    if frames.is_empty() {
        let found = match others.len() {
            0 => "no frames at all".to_owned(),
            _ => {
                format!("those of {}", others.iter().map(|s| format!("`{s}`")).collect::<Vec<_>>().join(", "))
            }
        };
        return Err(LearnError::NoFrames { bag: path.into(), skin: skin.name.clone(), found });
    }
    if truths.is_empty() {
        return Err(LearnError::NoTruth { bag: path.into(), skin: skin.name.clone(), frames: frames.len() });
    }
    if !others.is_empty() {
        notices.push(format!(
            "bag {shown}: also holds frames of {}, which are not used",
            others.iter().map(|s| format!("`{s}`")).collect::<Vec<_>>().join(", ")
        ));
    }
    if let Some(hash) = geometry.filter(|hash| !hash.is_empty() && *hash != skin.hash()) {
        notices.push(format!(
            "bag {shown}: was recorded with another description of skin `{}` ({hash}, here {})",
            skin.name,
            skin.hash()
        ));
    }
    if sessions.len() > 1 {
        notices.push(format!("bag {shown}: holds {} sessions, which count as one run", sessions.len()));
    }
    frames.sort_by_key(|f| f.stamp);
    truths.sort_by_key(|(stamp, _)| *stamp);
    let lost = frames
        .windows(2)
        .map(|w| w[1].sequence.saturating_sub(w[0].sequence).saturating_sub(1))
        .fold(0, u64::saturating_add);
    if lost > 0 {
        notices.push(format!("bag {shown}: {lost} frames were lost between device and bag"));
    }
    let tolerance = options.tolerance.unwrap_or_else(|| (0.5 / skin.rate).max(0.01));
    let samples = join(&frames, &truths, skin, tolerance, options.tare_when_idle);
    let labelled = samples.iter().filter(|s| s.truth.is_some()).count();
    if labelled == 0 {
        return Err(LearnError::NeverMeet { bag: path.into(), frames: samples.len(), tolerance });
    }
    if labelled < samples.len() {
        notices.push(format!(
            "bag {shown}: {} of {} frames have no ground truth within {tolerance} s and are used as history only",
            samples.len() - labelled,
            samples.len()
        ));
    }
    let several = samples.iter().filter(|s| s.truth.as_ref().is_some_and(|t| t.contacts.len() > 1)).count();
    if several > 0 {
        notices.push(format!(
            "bag {shown}: {several} frames have several contacts; they only count for the target `contact`"
        ));
    }
    let invalid = samples.iter().filter(|s| s.frame.healthy_channels() < s.frame.values.len()).count();
    if invalid > 0 {
        notices.push(format!("bag {shown}: {invalid} frames have channels that are not healthy"));
    }
    let session = sessions.into_iter().collect::<Vec<_>>().join("+");
    Ok(Run { path: path.into(), session, hash: hex(&hasher.finalize()), samples, lost })
}

fn check_frame(path: &Path, skin: &SkinDescription, frame: &TaxelFrame) -> Result<(), LearnError> {
    let wrong =
        |reason: String| Err(LearnError::Frame { bag: path.into(), sequence: frame.sequence, reason });
    let channels = skin.channels();
    if frame.values.len() != channels.len() {
        return wrong(format!(
            "has {} values where the skin has {} channels",
            frame.values.len(),
            channels.len()
        ));
    }
    if let Some((i, (got, _))) =
        frame.channels.iter().zip(channels).enumerate().find(|(_, (got, expected))| **got != expected.name)
    {
        return wrong(format!("channel {i} is `{got}` where the skin has `{}`", channels[i].name));
    }
    if frame.unit != skin.unit {
        return wrong(format!("is in \"{}\" where the skin is in \"{}\"", frame.unit, skin.unit));
    }
    Ok(())
}

fn truth_of(message: &Indentation) -> Truth {
    let contacts: Vec<TruthContact> = message
        .contacts
        .iter()
        .map(|c| TruthContact {
            position: Point3::new(c.position.x, c.position.y, c.position.z),
            normal: Vector3::new(c.normal.x, c.normal.y, c.normal.z),
            force: Vector3::new(c.force.x, c.force.y, c.force.z),
            components: match c.force_components {
                ContactMsg::FORCE_FULL => ForceComponents::Full,
                ContactMsg::FORCE_NORMAL => ForceComponents::Normal,
                _ => ForceComponents::None,
            },
        })
        .collect();
    let idle = message.phase == Indentation::PHASE_IDLE && contacts.is_empty();
    Truth { press: message.press, location: message.location, idle, contacts }
}

/// Labels frames and subtracts their zero. Both inputs are in order of their stamps.
fn join(
    frames: &[Frame],
    truths: &[(Stamp, Truth)],
    skin: &SkinDescription,
    tolerance: f64,
    tare_when_idle: bool,
) -> Vec<Sample> {
    let labels: Vec<Option<Truth>> =
        frames.iter().map(|f| truth_at(truths, f.stamp, (tolerance * 1e9) as i64)).collect();
    let idle = |k: usize| labels[k].as_ref().is_some_and(|t| t.idle);
    let mut zero = ZeroTracker::labelled(skin);
    let mut samples = Vec::with_capacity(frames.len());
    for (k, frame) in frames.iter().enumerate() {
        let begins = tare_when_idle && idle(k) && (k == 0 || !idle(k - 1));
        let tare = begins && {
            let end = (k..frames.len()).take_while(|&i| idle(i)).last().unwrap_or(k);
            let lasts = frames[end].stamp.saturating_sub(frame.stamp) as f64 * 1e-9;
            end - k + 1 >= FEWEST_TARE_FRAMES && lasts >= skin.condition.tare_duration
        };
        if tare {
            zero.reset();
        }
        // What is not known to be untouched must not move the zero.
        zero.push(frame, labels[k].as_ref().is_none_or(Truth::touched));
        let mut tared = frame.clone();
        zero.subtract(&mut tared);
        samples.push(Sample { frame: frame.clone(), tared: tared.values, tare, truth: labels[k].clone() });
    }
    samples
}

fn truth_at(truths: &[(Stamp, Truth)], stamp: Stamp, tolerance: i64) -> Option<Truth> {
    let after = truths.partition_point(|(t, _)| *t < stamp);
    let before = after.checked_sub(1).and_then(|i| truths.get(i));
    let after = truths.get(after);
    let near = |t: &Stamp| t.saturating_sub(stamp).abs() <= tolerance;
    let distance = |(t, _): &(Stamp, Truth)| t.saturating_sub(stamp).abs();
    let (nearest, other) = match (before, after) {
        (Some(b), Some(a)) if distance(b) < distance(a) => (b, Some(a)),
        (Some(b), Some(a)) => (a, Some(b)),
        (Some(only), None) | (None, Some(only)) => (only, None),
        (None, None) => return None,
    };
    if !near(&nearest.0) {
        return None;
    }
    let mut truth = nearest.1.clone();
    if let Some((time, other)) = other
        && (time - nearest.0).abs() <= 2 * tolerance.max(1)
        && other.press == truth.press
        && other.location == truth.location
        && let ([mine], [theirs]) = (truth.contacts.as_mut_slice(), other.contacts.as_slice())
        && mine.components == theirs.components
        && *time != nearest.0
    {
        let weight = (stamp - nearest.0) as f64 / (time - nearest.0) as f64;
        // A gap in one of the readings must not spread to the other.
        let blend = |a: f64, b: f64| if a.is_finite() && b.is_finite() { a + weight * (b - a) } else { a };
        mine.position = Point3::from(mine.position.coords.zip_map(&theirs.position.coords, blend));
        mine.force = mine.force.zip_map(&theirs.force, blend);
    }
    Some(truth)
}

#[cfg(test)]
pub(crate) mod tests;
