//! What a model bundle may cost. Bundles come from others: a file that claims to be larger, or a graph that wants more, is refused
//! before it is read or run, with a sentence that names the limit.

use serde::{Deserialize, Serialize};

/// What a model bundle may cost, before it is refused. The table `model_limits` of a node's configuration; what is left out is as in
/// [`Limits::default`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct Limits {
    /// \[bytes\] of `bundle.toml`: the largest that ship have 35 kB.
    pub manifest_bytes: u64,
    /// \[bytes\] of a graph: the largest that ship have 1.4 MB.
    pub graph_bytes: u64,
    /// \[bytes\] of `correction.json`.
    pub correction_bytes: u64,
    /// \[bytes\] that all constants of a graph have together once they are unpacked.
    pub constant_bytes: u64,
    /// \[bytes\] of address space that the trial of a model may take, the program itself included.
    pub memory_bytes: u64,
    /// \[s\] that the trial of a model may take, by the clock and of the processor.
    pub seconds: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            manifest_bytes: 16 << 20,
            graph_bytes: 256 << 20,
            correction_bytes: 64 << 20,
            constant_bytes: 512 << 20,
            memory_bytes: 2 << 30,
            seconds: 20,
        }
    }
}
