//! Options that every command which reads labelled bags has.

use std::path::PathBuf;

use clap::Args;
use serde::{Deserialize, Serialize};

use crate::{DatasetOptions, LabelMap, LearnError};

/// How bags are read.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Labels {
    /// Take the ground truth from a robot's pose and a force sensor's wrench, as this file maps them; see
    /// `launch/labels/`.
    #[arg(long)]
    map: Option<PathBuf>,
    /// Which device, where a bag holds several of the skin's type; `dermis bag info` lists them.
    #[arg(long, value_name = "NAME")]
    skin_instance: Option<String>,
    /// Topic of the frames, where a bag holds several skins of one description.
    #[arg(long, value_name = "TOPIC")]
    taxels: Option<String>,
    /// Seconds between a frame and its ground truth that still count as the same instant; a map has its own.
    #[arg(long)]
    tolerance: Option<f64>,
}

impl Labels {
    /// How to read the bags.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where the map cannot be used.
    pub fn options(&self) -> Result<DatasetOptions, LearnError> {
        Ok(DatasetOptions {
            tolerance: self.tolerance,
            instance: self.skin_instance.clone(),
            taxels: self.taxels.clone(),
            map: self.map.as_ref().map(LabelMap::load).transpose()?,
            ..DatasetOptions::default()
        })
    }
}
