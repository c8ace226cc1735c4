//! Frames of labelled bags, joined with their ground truth.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use dermis_bag::{BagReader, BagSkin, Filter, SkinChoice, SkinChoiceError};
use dermis_inference::{Baseline, FeatureConfig, Features};
use dermis_msgs::Message;
use dermis_msgs::TypeSupport;
use dermis_msgs::geometry_msgs::msg::{TransformStamped, WrenchStamped};
use dermis_msgs::msg::{Contact as ContactMsg, Indentation, SkinGeometry, TaxelFrame};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_skin::{ForceComponents, Frame, SkinDescription, Stamp, ZeroTracker};
use nalgebra::{Point3, Vector3};
use sha2::{Digest, Sha256};

use crate::findings::{self, Findings};
use crate::map::{self, Bias, LabelMap, Places, Readings};
use crate::{LearnError, SplitConfig, SplitKind};

/// Contact locations below which an interval over held-out ones says little.
const FEW_LOCATIONS: usize = 20;
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
    /// \[m\] diameter of the tip.
    pub diameter: f64,
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
    /// What the rig's force sensor does when nothing touches; `None` where the ground truth is ours.
    pub bias: Option<Bias>,
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
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self { tolerance: None, tare_when_idle: true, instance: None, taxels: None, map: None }
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
        let (mut findings, mut places) = (Findings::default(), Places::default());
        let mut runs = Vec::new();
        for path in paths {
            runs.extend(read_run(path.as_ref(), skin, options, &mut places, &mut findings)?);
        }
        Ok(Self { skin: skin.clone(), runs, findings, map: options.map.clone() })
    }

    /// A data set of runs that were made elsewhere; their samples must be tared.
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
            for run in &self.runs {
                let mut labelled =
                    run.samples.iter().filter(|s| s.truth.as_ref().is_some_and(Truth::touched)).peekable();
                if labelled.peek().is_some() && labelled.all(|s| s.tared.iter().all(|v| v.is_nan())) {
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
                "figures of the held-out ones say little; press at more places",
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

/// What one bag holds for a skin, before it is joined.
#[derive(Default)]
struct Contents {
    frames: Vec<Frame>,
    truths: Vec<(Stamp, Truth)>,
    rig: Readings,
    /// Frames of the skin by topic.
    topics: BTreeMap<String, usize>,
    /// Other skins that the bag holds.
    others: BTreeSet<String>,
    sessions: BTreeSet<String>,
    geometry: Option<String>,
    /// Device whose frames these are.
    instance: String,
    /// Why no frames were taken.
    choice: Option<SkinChoiceError>,
    /// Frames and ground truth without a stamp.
    unstamped: [u64; 2],
    /// First frame that is not as the skin's description says.
    unlike: Option<String>,
}

impl Contents {
    fn read(
        path: &Path,
        skin: &SkinDescription,
        options: &DatasetOptions,
        hasher: &mut Sha256,
    ) -> Result<Self, LearnError> {
        let bag = BagReader::open(path)?;
        let mut found = Self::default();
        let mut wanted = vec![
            TypeSupport::of::<TaxelFrame>(),
            TypeSupport::of::<SkinGeometry>(),
            TypeSupport::of::<Indentation>(),
        ];
        if options.map.is_some() {
            wanted.truncate(2);
            wanted.extend([
                TypeSupport::of::<WrenchStamped>(),
                TypeSupport::of::<TransformStamped>(),
                TypeSupport::of::<TFMessage>(),
            ]);
        }
        for support in &wanted {
            for topic in bag.topics().iter().filter(|t| t.type_name == support.name) {
                bag.check_type(topic, support)?;
            }
        }
        let named = options.map.as_ref().and_then(|m| m.skin.taxels.as_ref()).or(options.taxels.as_ref());
        let skins = bag.skins()?;
        let choice = SkinChoice {
            instance: options.instance.as_deref(),
            topic: named.map(String::as_str),
            type_name: skin.type_name(),
        };
        let mut layouts = BTreeMap::new();
        let truths = match choice.of(&skins, |hash, name| skin.is_type(hash, name)) {
            Ok(chosen) => {
                found.instance.clone_from(&chosen.name);
                layouts.clone_from(&chosen.layouts);
                Truths::of(chosen, &skins, named.map(String::as_str), skin)
            }
            Err(error) => {
                found.choice = Some(error);
                return Ok(found);
            }
        };
        for message in bag.messages_where(Filter::default().types(wanted.iter().map(|s| s.name))) {
            let message = message?;
            if *message.type_name == *TaxelFrame::TYPE_NAME {
                let frame: TaxelFrame = message.decode()?;
                if frame.skin != found.instance {
                    found.others.insert(frame.skin);
                } else if named.is_none_or(|topic| **topic == *message.topic) {
                    hasher.update(message.recorded());
                    *found.topics.entry(message.topic.to_string()).or_insert(0) += 1;
                    if found.unlike.is_none() {
                        found.unlike = skin.unlike(&frame, &layouts);
                    }
                    if frame.header.stamp.as_nanos() == 0 {
                        found.unstamped[0] += 1;
                    } else {
                        found.frames.push(Frame::from(&frame));
                    }
                }
            } else if *message.type_name == *Indentation::TYPE_NAME {
                let truth: Indentation = message.decode()?;
                if truths.take(&message.topic, &truth.skin) {
                    hasher.update(message.recorded());
                    found.sessions.insert(truth.session.clone());
                    if truth.header.stamp.as_nanos() == 0 {
                        found.unstamped[1] += 1;
                    } else {
                        found.truths.push((truth.header.stamp.as_nanos(), truth_of(&truth)));
                    }
                }
            } else if *message.type_name == *SkinGeometry::TYPE_NAME {
                if let Ok(message) = message.decode::<SkinGeometry>()
                    && message.skin == found.instance
                {
                    found.geometry = Some(message.skin_hash);
                }
            } else if let Some(map) = &options.map {
                if *message.topic == *map.robot.topic || *message.topic == *map.force.topic {
                    hasher.update(message.recorded());
                }
                found.rig.take(map, &message)?;
            }
        }
        found.frames.sort_by_key(|f| f.stamp);
        found.truths.sort_by_key(|(stamp, _)| *stamp);
        Ok(found)
    }

    /// Says what is wrong with the frames themselves.
    fn check_frames(&self, skin: &SkinDescription, place: &str, findings: &mut Findings) {
        if let Some(error) = &self.choice {
            let what = match error {
                SkinChoiceError::Several { .. } => {
                    "two devices would be taken for one; name one of them with `--skin-instance`, or its topic with `--taxels`"
                }
                _ => {
                    "there is nothing to learn from; `--skin-instance` names a device of this type, `dermis bag info` lists them"
                }
            };
            findings.fatal(place, error.to_string(), what);
            return;
        }
        if self.instance != skin.name {
            findings.notice(
                place,
                format!("its frames are of `{}`, a skin of the type `{}`", self.instance, skin.type_name()),
                "",
            );
        }
        if let Some(reason) = &self.unlike {
            findings.fatal(
                place,
                reason.clone(),
                "the readings cannot be told apart; check the skin description",
            );
        }
        if self.unstamped[0] > 0 {
            findings.fatal(
                place,
                format!("{} frames have no stamp (header.stamp is 0)", self.unstamped[0]),
                "nothing can be joined by acquisition time; let the driver stamp its frames",
            );
        }
        if self.topics.len() > 1 {
            let topics: Vec<&str> = self.topics.keys().map(String::as_str).collect();
            findings.fatal(
                place,
                format!("frames of skin `{}` come on several topics: {}", self.instance, topics.join(", ")),
                "two skins would be taken for one; name one of them with `--taxels`, or skin.taxels of the map",
            );
        }
        if !self.others.is_empty() {
            let others = self.others.iter().map(|s| format!("`{s}`")).collect::<Vec<_>>().join(", ");
            findings.notice(place, format!("also holds frames of {others}"), "they are not used");
        }
        let other = |hash: &&String| !hash.is_empty() && !skin.is_type(hash, &self.instance);
        if let Some(hash) = self.geometry.as_ref().filter(other) {
            findings.notice(
                place,
                format!(
                    "was recorded with another description of skin `{}` ({hash}, here {})",
                    self.instance,
                    skin.hash()
                ),
                "a model of one does not load for the other",
            );
        }
        self.check_channels(skin, place, findings);
    }

    fn check_channels(&self, skin: &SkinDescription, place: &str, findings: &mut Findings) {
        if self.frames.len() < 10 || self.unlike.is_some() {
            return;
        }
        let (mut silent, mut constant) = (Vec::new(), Vec::new());
        for (i, channel) in skin.channels().iter().enumerate() {
            let mut values = self.frames.iter().filter_map(|f| f.values.get(i)).filter(|v| v.is_finite());
            match values.next() {
                None => silent.push(channel.name.as_str()),
                Some(first) if values.all(|v| v == first) => constant.push(channel.name.as_str()),
                Some(_) => {}
            }
        }
        let all = silent.len() + constant.len() == skin.channels().len();
        for (names, what) in [(silent, "never give a number"), (constant, "never change")] {
            if names.is_empty() {
                continue;
            }
            let what =
                format!("{} of {} channels {what}: {}", names.len(), skin.channels().len(), listed(&names));
            if all {
                findings.fatal(place, what, "there is nothing to learn from");
            } else {
                findings.notice(
                    place,
                    what,
                    "a model will not know them; check the wiring before it is trained",
                );
            }
        }
    }
}

/// Which ground truth of a bag is that of a device. What presses a skin may know its type only.
struct Truths {
    instance: String,
    type_name: String,
    /// Namespaces of the device's frames, where the type's name is not enough.
    namespaces: Option<BTreeSet<String>>,
    /// Whether the device's own name is not enough either: another one has it too.
    shared: bool,
}

impl Truths {
    fn of(chosen: &BagSkin, skins: &[BagSkin], topic: Option<&str>, skin: &SkinDescription) -> Self {
        let framed = |skin: &&BagSkin| skin.topics_of::<TaxelFrame>().next().is_some();
        let shared = chosen.topics_of::<TaxelFrame>().count() > 1;
        let alone = !shared && skins.iter().filter(framed).count() == 1;
        let topics =
            chosen.topics_of::<TaxelFrame>().filter(|other| topic.is_none_or(|topic| topic == *other));
        Self {
            instance: chosen.name.clone(),
            type_name: skin.type_name().to_owned(),
            namespaces: (!alone).then(|| topics.map(|topic| namespace(topic).to_owned()).collect()),
            shared,
        }
    }

    fn take(&self, topic: &str, skin: &str) -> bool {
        let beside = || self.namespaces.as_ref().is_none_or(|of_frames| of_frames.contains(namespace(topic)));
        skin == self.instance && (!self.shared || beside()) || skin == self.type_name && beside()
    }
}

fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}

/// The first few of many names.
fn listed(names: &[&str]) -> String {
    let mut text = names.iter().take(8).copied().collect::<Vec<_>>().join(", ");
    if names.len() > 8 {
        text.push_str(&format!(" and {} more", names.len() - 8));
    }
    text
}

/// One bag, joined; `None` where it cannot be.
fn read_run(
    path: &Path,
    skin: &SkinDescription,
    options: &DatasetOptions,
    places: &mut Places,
    findings: &mut Findings,
) -> Result<Option<Run>, LearnError> {
    let place = &findings::bag(path);
    let mut own = Findings::default();
    let mut hasher = Sha256::new();
    let mut found = Contents::read(path, skin, options, &mut hasher)?;
    found.check_frames(skin, place, &mut own);
    if found.choice.is_some() {
        findings.extend(own);
        return Ok(None);
    }
    let frames = std::mem::take(&mut found.frames);
    let (mut lost, mut gap) = (0_u64, 0);
    for w in frames.windows(2) {
        lost = lost.saturating_add(w[1].sequence.saturating_sub(w[0].sequence).saturating_sub(1));
        gap = gap.max(w[1].stamp.saturating_sub(w[0].stamp));
    }
    if lost > 0 {
        own.notice(
            place,
            format!(
                "{lost} frames ({:.1} %) were lost between device and bag, the longest gap is {:.2} s",
                100.0 * lost as f64 / (lost as f64 + frames.len() as f64),
                gap as f64 * 1e-9
            ),
            "a model that looks back sees steps there",
        );
    }
    let tolerance = options.map.as_ref().map_or_else(
        || options.tolerance.unwrap_or_else(|| (0.5 / skin.rate).max(0.01)),
        |map| map.join.max_gap,
    );
    let (mut labels, mut bias) = (Vec::new(), None);
    let mut span = found.rig.span();
    if let Some(map) = &options.map {
        (labels, bias) = map::label(&frames, &mut found.rig, map, skin, places, place, &mut own);
        hasher.update(serde_json::to_vec(map).unwrap_or_default());
        found.sessions.insert(path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned());
    } else {
        span = found.truths.first().zip(found.truths.last()).map(|((a, _), (b, _))| (*a, *b));
        if found.unstamped[1] > 0 {
            own.fatal(
                place,
                format!("{} ground truth messages have no stamp (header.stamp is 0)", found.unstamped[1]),
                "nothing can be joined by acquisition time",
            );
        } else if found.truths.is_empty() {
            own.fatal(
                place,
                format!(
                    "holds {} frames of skin `{}` but no ground truth (dermis_msgs/msg/Indentation) for it",
                    frames.len(),
                    found.instance
                ),
                "nothing can be learned or measured; record one with `dermis collect`, `dermis import` a labelled \
                 recording, or name a robot's and a force sensor's topics in a file and pass it as `--map`",
            );
        }
        if found.sessions.len() > 1 {
            own.notice(place, format!("holds {} sessions, which count as one run", found.sessions.len()), "");
        }
        labels.extend(frames.iter().map(|f| truth_at(&found.truths, f.stamp, (tolerance * 1e9) as i64)));
    }
    if own.is_fatal() {
        findings.extend(own);
        return Ok(None);
    }
    let samples = join(&frames, labels, skin, options.tare_when_idle);
    let labelled = samples.iter().filter(|s| s.truth.is_some()).count();
    if labelled == 0 {
        let begin = frames.first().map_or(0, |f| f.stamp);
        let relative = |t: Stamp| t.saturating_sub(begin) as f64 * 1e-9;
        let (from, to) = span.unwrap_or_default();
        own.fatal(
            place,
            format!(
                "none of {} frames has ground truth within {tolerance} s of its stamp: frames reach from 0 to {:.2} s, \
                 the ground truth from {:.2} to {:.2} s after the first frame",
                samples.len(),
                relative(frames.last().map_or(begin, |f| f.stamp)),
                relative(from),
                relative(to)
            ),
            "check that both were stamped by the same clock",
        );
        findings.extend(own);
        return Ok(None);
    }
    if labelled < samples.len() {
        own.notice(
            place,
            format!(
                "{} of {} frames have no ground truth within {tolerance} s",
                samples.len() - labelled,
                samples.len()
            ),
            "they are used as history only",
        );
    }
    let several = samples.iter().filter(|s| s.truth.as_ref().is_some_and(|t| t.contacts.len() > 1)).count();
    if several > 0 {
        own.notice(
            place,
            format!("{several} frames have several contacts"),
            "they only count for the target `contact`",
        );
    }
    let invalid = samples.iter().filter(|s| s.frame.healthy_channels() < s.frame.values.len()).count();
    if invalid > 0 {
        own.notice(place, format!("{invalid} frames have channels that are not healthy"), "");
    }
    findings.extend(own);
    let session = found.sessions.into_iter().collect::<Vec<_>>().join("+");
    Ok(Some(Run { path: path.into(), session, hash: hex(&hasher.finalize()), samples, lost, bias }))
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
            diameter: c.diameter,
        })
        .collect();
    let idle = message.phase == Indentation::PHASE_IDLE && contacts.is_empty();
    Truth { press: message.press, location: message.location, idle, contacts }
}

/// Subtracts the zero of frames. Frames are in order of their stamps, with a label each.
fn join(
    frames: &[Frame],
    labels: Vec<Option<Truth>>,
    skin: &SkinDescription,
    tare_when_idle: bool,
) -> Vec<Sample> {
    let idle = |k: usize| labels[k].as_ref().is_some_and(|t| t.idle);
    let mut zero = ZeroTracker::labelled(skin);
    let mut samples: Vec<Sample> = Vec::with_capacity(frames.len());
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
        samples.push(Sample { frame: frame.clone(), tared: tared.values, tare, truth: None });
    }
    for (sample, truth) in samples.iter_mut().zip(labels) {
        sample.truth = truth;
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
