//! Training: bags → model bundle.
//!
//! Data set, split, network and targets come from a [`TrainConfig`]; see `launch/train/` for examples to copy.
//! What a model sees in training is what it sees in a node: frames are tared by
//! [`ZeroTracker`](dermis_skin::ZeroTracker) and become inputs in [`Features`](dermis_inference::Features).

mod balance;
mod candidates;
mod checkpoint;
mod choose;
pub mod command;
mod config;
#[cfg(feature = "train")]
pub mod conv;
#[cfg(feature = "train")]
mod fit_image;
#[cfg(feature = "train")]
mod held;
mod image;
mod kept;
mod kernels;
mod layer;
mod measure;
mod network;
mod prepare;
mod processor;
mod rows;
mod run;
#[cfg(feature = "train")]
mod run_conv;

pub use candidates::{Candidate, ModelChoice};
pub use choose::{Choice, Judged};
pub use config::{
    ChannelNoise, ConvConfig, FeatureChoice, InputForm, NetworkConfig, Scaling, TrainConfig, TrainingConfig,
};
pub use dermis_regress::dense::Activation;
pub use image::ImageConfig;
pub use kept::{States, fit_kept};
pub use layer::Layer;
pub use network::{Batch, Mlp, Progress, fit};
pub use prepare::Preparation;
pub use processor::Processor;
pub use run::{Outcome, Request, run};
