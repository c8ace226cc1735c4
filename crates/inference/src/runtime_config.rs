//! What may be configured about the runtime.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Which runtime to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RuntimeChoice {
    /// ONNX Runtime's native library where one is found, otherwise the embedded runtime.
    #[default]
    Auto,
    /// The embedded runtime, even where a native library is installed.
    Embedded,
    /// ONNX Runtime's native library; an error where none is usable.
    Native,
}

/// What may be configured about the runtime.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RuntimeConfig {
    /// Which runtime to use.
    pub choice: RuntimeChoice,
    /// ONNX Runtime's library, tried before any other place.
    pub library: Option<PathBuf>,
}
