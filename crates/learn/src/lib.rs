//! Data sets, splits, metrics, evaluation, training and ONNX export.
//!
//! | word | type | what it is |
//! |---|---|---|
//! | data set | [`Dataset`] | frames of labelled bags, tared as a node tares them, joined with the ground truth |
//! | map | [`LabelMap`] | how a robot's and a force sensor's topics become ground truth |
//! | import | [`import_onnx`](import_onnx::import_onnx) | an ONNX graph that was trained elsewhere becomes a bundle |
//! | join | [`join`](join::join_bundles) | a transfer network and what was trained on the forward model become one bundle |
//! | export | [`export`] | Parquet and NPZ, for people who train elsewhere |
//! | finding | [`Findings`] | what data lack, and what that blocks |
//! | target | [`Target`](target::Target) | what a model learns: scalars of a contact, or maps over the surface |
//! | split | [`SplitConfig`], [`Split`] | which samples are held out; by default whole contact locations |
//! | metrics | [`Scores`], [`Summary`] | errors per quantity and force, with intervals over locations |
//! | evaluation | [`evaluate`], [`Evaluation`] | what an estimator makes of a data set |
//! | bound | [`Requirement`] | a figure that an evaluation has to reach |
//! | real2sim | [`real2sim`] | readings of a device → a simulated map of displacements → several contacts |
//!
//! All quantities are in SI units and in the frame of the skin's link.
//!
//! Feature `train` adds convolutional networks, and with them a framework that takes minutes to build; dense networks train
//! without it.

mod bounds;
pub mod card;
pub mod cli;
mod dataset;
mod error;
mod evaluate;
mod evaluator;
pub mod export;
mod findings;
pub mod import_onnx;
pub mod join;
mod map;
mod metrics;
pub mod picture;
pub mod plot;
mod random;
pub mod real2sim;
mod recordings;
pub mod refine;
mod split;
pub mod target;
pub mod train;

pub use bounds::{
    AgainstBound, Bounds, FrameBounds, MOST as MOST_BOUNDED, OfSeveral, Ratio, RatioBin, Unbounded,
    Uncounted, UncountedBin, Undetermined, WellDetermined, frame_bounds, stimulus,
};
pub use dataset::{
    Dataset, DatasetOptions, FrameInfo, MOST_FRAMES, Run, Sample, SampleId, Truth, TruthContact,
};
pub use error::LearnError;
pub use evaluate::{
    Evaluation, Evaluator, Requirement, Verdict, Verdicts, evaluate, evaluate_by, evaluate_parts,
};
pub use findings::{Finding, Findings};
pub use map::{Bias, Carrier, ContactRule, Exerted, ForceSide, Join, LabelMap, Mount, RobotSide, SkinSide};
pub use metrics::{
    Answer, Bin, COUNTED_FROM, ChannelErrors, Consistencies, Consistency, ConsistencyBin, ContactError,
    ContactsOfMaps, ContactsRead, FORCE_BINS, MapContacts, MapErrors, MapExample, MapOfNumber, MapPart,
    MapReading, MapScores, MapSummary, Rule, Scores, Spread, Stated, StrongestErrors, StrongestPart, Summary,
    bins,
};
pub use recordings::{Recorded, superpose};
pub use split::{Split, SplitConfig, SplitKind};

/// Whether this build trains convolutional networks.
pub const CONVOLUTIONAL: bool = cfg!(feature = "train");
/// Whether it trains them on a GPU.
pub const GPU: bool = cfg!(feature = "gpu");
