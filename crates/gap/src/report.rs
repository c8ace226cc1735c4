//! What a diagnosis says: `gap-report/2`. Files of `gap-report/1` are read as well: each key that was renamed has its old name as an
//! alias.

use dermis_skin::Effect;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::axes::{Axis, Bin, Map};
use crate::checks::Missing;
use crate::consistency_checks::ConsistencyCheck;
use crate::experiments::Experiment;
use crate::noise::Gap;
use crate::protocol::design::Hypothesis;
use crate::recording::Problem;
use crate::rivals::{Rival, Structure};
use crate::select::Tier;

/// Name of the format.
pub const SCHEMA: &str = "gap-report/2";
/// JSON schema of the format.
pub const SCHEMA_JSON: &str = include_str!("../gap-report-2.schema.json");

/// What a diagnosis comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Something is wrong with the recording that would make any answer wrong.
    UnusableRecording,
    /// The gap is too small to matter, with 97.5 % confidence.
    NoGapBeyondNoise,
    /// It may be too small to matter, and may not: the interval of its size holds what does not matter.
    Undecided,
    /// What the simulator's declared tolerances allow explains it, and no effect beyond.
    #[serde(alias = "simulator-form")]
    ModelDiscrepancy,
    /// Effects of the library explain it.
    Named,
    /// They explain some of it.
    NamedAndUnknown,
    /// It is systematic, and no effect of the library explains it.
    UnknownSystematic,
    /// Nothing that was recorded explains it.
    Unmeasured,
}

/// What was diagnosed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DataSummary {
    /// Recording.
    pub name: String,
    /// Hash of stimulus and readings.
    pub hash: String,
    /// Name of the skin, and hash of its description.
    pub skin: String,
    /// See above.
    pub skin_hash: String,
    /// Unit of readings.
    pub unit: String,
    /// Channels of a frame.
    pub channels: usize,
    /// Frames of the recording.
    pub frames: usize,
    /// Presses of the recording.
    pub presses: usize,
    /// Frames that were sampled.
    #[serde(alias = "rows")]
    pub samples: usize,
    /// Locations that were fitted and selected on, and locations kept for the end.
    #[serde(alias = "places")]
    pub locations: [usize; 2],
    /// Pairs of presses that were done alike.
    pub repeats: usize,
    /// Sessions.
    pub sessions: Vec<String>,
    /// What is not there, and what that blocks.
    pub missing: Vec<Missing>,
    /// What was noticed.
    pub problems: Vec<Problem>,
}

/// A fitted value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// Parameter.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Unit.
    pub unit: String,
    /// 90 % interval; absent where none could be had.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// Probability of a value as far off or farther by what is known of such devices; absent where nothing is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plausibility: Option<f64>,
}

/// A candidate that cannot be distinguished from a named effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// Name of the effect.
    pub name: String,
    /// Reduction of the held-out error by it instead, in shares of the readings' variance.
    pub gain: f64,
    /// Probability that other contacts would have put it first; that of the named effect for another name of it.
    pub p_confuse: f64,
    /// \[degrees\] between what both change, to first order; `None` where only the full simulator compared them.
    pub angle: Option<f64>,
    /// Whether it belongs to the rig rather than to the skin.
    pub rig: bool,
    /// Whether it is another name of the named effect: no press of any kind tells them apart.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub alias: bool,
    /// Fitted values, where it was fitted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<Value>,
    /// What a skin description would switch on for it, or which of its numbers it would change; empty where it cannot say it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<Effect>,
}

/// How far named effects reduce the residual: shares of the gap beyond the noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ResidualReduction {
    /// By contacts that were fitted.
    pub predicted: f64,
    /// On contacts that were neither fitted nor selected on, with the full simulator; `None` where the effects cannot be
    /// switched on in it.
    pub achieved: Option<f64>,
    /// 90 % interval of what is achieved in another recording of the same device, from running selection and fit again on other draws of
    /// locations, and from what depends on the past or drifts randomly.
    pub interval: [f64; 2],
}

/// An effect that is named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NamedEffect {
    /// Name.
    pub label: String,
    /// One sentence.
    pub what: String,
    /// All candidates that cannot be distinguished, the label first. The class is the answer.
    pub class: Vec<Alternative>,
    /// More general effects that contain it.
    pub covers: Vec<String>,
    /// How it stands against the model discrepancy; `loose` means: this effect, or that discrepancy.
    pub tier: Tier,
    /// Fitted values.
    pub theta: Vec<Value>,
    /// Reduction of the held-out error when it comes last, in shares of the readings' variance.
    pub gain: f64,
    /// The same when it comes alone.
    pub solo: f64,
    /// Its share of what all named effects explain together.
    pub shapley: f64,
    /// Family-wise probability of such a statistic by chance.
    pub p_max_t: f64,
    /// Probability of confusing it with the nearest other of its class.
    pub p_confuse: f64,
    /// What rises and falls with it in this recording, so that it may be the cause as well.
    pub covariate_alias: Vec<String>,
    /// Whether the corrected skin has it.
    pub written: bool,
}

/// An effect that alone would explain some of the gap. It is not named by that.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnconfirmedEffect {
    /// Name of the effect.
    pub name: String,
    /// Reduction of the held-out error, in shares of the readings' variance.
    pub gain: f64,
    /// The same beside the model discrepancy.
    #[serde(alias = "beyond_form")]
    pub beyond_discrepancy: f64,
}

/// What the library does not explain.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Unknown {
    /// Share of the systematic gap that the library leaves.
    pub share: f64,
    /// Share of the systematic gap that named effects explain.
    pub library: f64,
    /// Share that the model discrepancy (the simulator's error within its tolerances) explains beside them.
    #[serde(alias = "form")]
    pub model_discrepancy: f64,
    /// Share of what is left that a smoother over all recorded circumstances predicts.
    pub explainable: f64,
    /// Axes along which what is left goes, the strongest first.
    pub fingerprint: Vec<Axis>,
    /// What named effects leave, by channels and locations; absent where none is named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub structure: Option<Structure>,
    /// How much speaks for a cause that the library lacks: logarithm of the odds where both kinds are equally frequent, calibrated on the
    /// library itself; absent where nothing was to explain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub evidence: Option<f64>,
    /// Evidence from which on the cause is called unknown: 2 % of known ones exceed it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// Where it is called so beside a name, what the name leaves is shaped like.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<String>,
    /// Share of the gap that this shape finds on locations that it was not fitted to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape_share: Option<f64>,
    /// What speaks for and against "unknown", by name: what the names leave, what shapes without a cause find in it, and whether the
    /// names' values and signatures hold.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub tests: BTreeMap<String, f64>,
}

/// How a downstream estimator does before and after.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Downstream {
    /// What is measured, with its unit.
    pub metric: String,
    /// Trained on the nominal simulation.
    pub before: f64,
    /// Trained on the corrected one.
    pub after: f64,
}

/// Where a report comes from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Program and version.
    pub tool: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Hash of the names of all effects that were tried.
    pub library_hash: String,
    /// Effects that were tried.
    pub tried: Vec<String>,
    /// Effects that cannot be seen in this recording, and why.
    pub silent: Vec<[String; 2]>,
    /// What the model discrepancy was made of.
    #[serde(alias = "form")]
    pub model_discrepancy: Vec<String>,
    /// Seconds for signatures (0 where they were kept), and for the rest.
    pub seconds: [f64; 2],
}

/// A diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// `gap-report/2`.
    pub schema: String,
    /// One sentence that a person can act on.
    pub sentence: String,
    /// What it comes to.
    pub verdict: Verdict,
    /// What was diagnosed.
    pub data: DataSummary,
    /// How large the gap is; `None` where that could not be measured.
    pub gap: Option<Gap>,
    /// Where it is, the most telling axis first.
    #[serde(rename = "where")]
    pub axes: Vec<Axis>,
    /// By channel.
    pub channels: Vec<Bin>,
    /// Over the surface: before, and after the named effects.
    pub maps: Vec<Map>,
    /// Checks without a model.
    #[serde(alias = "parity")]
    pub consistency_checks: Vec<ConsistencyCheck>,
    /// Named effects, the strongest first.
    pub effects: Vec<NamedEffect>,
    /// Effects that explain most when they come alone, whether they are named or not, the strongest first: where to look where no
    /// effect is named.
    pub suspects: Vec<UnconfirmedEffect>,
    /// How far all of them reduce it.
    #[serde(alias = "closure")]
    pub residual_reduction: Option<ResidualReduction>,
    /// Unexplained variance on the contacts kept for the end: before, after, floor.
    pub held_out: Option<[f64; 3]>,
    /// What is left.
    pub unknown: Unknown,
    /// Shapes without a cause that were held against the named effects, the one that explains most first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rivals: Vec<Rival>,
    /// What to do next, the best first.
    pub next_experiments: Vec<Experiment>,
    /// What the next presses are to tell apart: the members of a class that is open, as they would be switched on.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hypotheses: Vec<Hypothesis>,
    /// An estimator trained before and after, where that was done.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub downstream: Vec<Downstream>,
    /// Effects to switch on in the skin's description.
    pub corrected: Vec<Effect>,
    /// Where this comes from.
    pub provenance: Provenance,
    /// What else to know.
    pub warnings: Vec<String>,
}

impl NamedEffect {
    /// Names of what it may be, each with its other names in brackets, the label first.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut found: Vec<(String, Vec<&str>)> = Vec::new();
        for member in &self.class {
            match found.last_mut() {
                Some((_, also)) if member.alias => also.push(&member.name),
                _ => found.push((member.name.clone(), Vec::new())),
            }
        }
        let text = |(name, also): (String, Vec<&str>)| match also.as_slice() {
            [] => name,
            also => format!("{name} (also called {})", also.join(", ")),
        };
        found.into_iter().map(text).collect()
    }
}

impl ResidualReduction {
    /// The reduction in words, with its interval where that says something.
    #[must_use]
    pub fn text(&self) -> String {
        crate::wording::reduction(self)
    }
}

impl Report {
    /// Names of the class of the strongest effect, the label first; empty where none is named.
    #[must_use]
    pub fn class(&self) -> Vec<&str> {
        self.effects.first().map_or_else(Vec::new, |e| e.class.iter().map(|a| a.name.as_str()).collect())
    }

    /// As JSON text.
    ///
    /// # Errors
    ///
    /// [`GapError::Format`](crate::GapError::Format) where a number cannot be written.
    pub fn to_json(&self) -> Result<String, crate::GapError> {
        serde_json::to_string_pretty(self)
            .map_err(|e| crate::GapError::Format { what: "the report", reason: e.to_string() })
    }
}
