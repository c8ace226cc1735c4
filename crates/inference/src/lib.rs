//! Learned models: which runtime evaluates them, what a model bundle is, and how frames become inputs.
//!
//! | word | type | what it is |
//! |---|---|---|
//! | runtime | [`Runtime`] | ONNX Runtime's native library where one is found, otherwise the embedded one |
//! | bundle | [`Bundle`] | folder of manifest, ONNX graph and model card, bound to one skin |
//! | features | [`Features`] | conditioned frames → input of the graph; the same code in training and in a node |
//! | outputs | [`Outputs`] | output of the graph → named quantities in SI units, with their sigma |
//! | model | [`Model`] | one loaded graph: input slice → output vector |
//! | peaks | [`MapContacts`] | a displacement map → contacts |
//! | | [`ForceMapContacts`] | a force map → contacts |
//! | correction | [`Bundle::correction`] | how a device differs from its forward model, as recorded presses showed |
//! | graph builder | [`onnx::GraphBuilder`] | writes the ONNX graphs that training exports |
//!
//! A frame's way through this crate is `Features::push` → `Features::input` → `Model::run` → `Outputs::decode`.

mod bundle;
mod correction;
mod features;
mod file;
mod force_peaks;
mod interface;
mod limits;
mod manifest;
mod model;
mod normalisation;
pub mod onnx;
mod outputs;
mod peaks;
mod rows;
mod runtime;
mod runtime_config;
pub mod trial;

pub use bundle::{Bundle, BundleError, BundleWriter, JoinError, Joined, SIGNAL, SkinMismatch, join};
pub use correction::{CorrectionError, CorrectionSection};
pub use features::{FeatureConfig, FeatureError, Features, Missing, Taps};
pub use force_peaks::{ForceMapContacts, ForcePeakSection, MAP_NORMAL};
pub use interface::{Interface, TensorPort};
pub use limits::Limits;
pub use manifest::{
    Baseline, FileSection, Manifest, ManifestError, ModelSection, SkinSection, TrainingSection,
};
pub use model::{Model, ModelError, rehearse_embedded};
pub use outputs::{Link, OutputConfig, OutputError, OutputSpec, Outputs, SigmaBin};
pub use peaks::{MAP_DISPLACEMENT, MapContacts, PeakSection};
pub use runtime::{RejectedPath, Runtime, RuntimeError, RuntimeKind, RuntimeReport};
pub use runtime_config::{RuntimeChoice, RuntimeConfig};
