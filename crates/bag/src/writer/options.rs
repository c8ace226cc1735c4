//! How a bag is laid out.

/// How the chunks of a bag are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// Not at all.
    None,
    /// zstd at level 1: what a recorder keeps up with.
    Fast,
    /// zstd at its default level 3.
    #[default]
    Default,
    /// zstd at level 15: for archives; far slower than a sensor.
    Small,
}

/// How a bag is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct BagOptions {
    /// Compression of the chunks.
    pub compression: Compression,
    /// Uncompressed bytes of a chunk: a reader holds one chunk in memory, and an interruption loses at most the one
    /// that is being filled.
    pub chunk_bytes: u64,
    /// A file that has reached this many bytes is closed and the next one is begun; `None` for one file.
    pub split_bytes: Option<u64>,
    /// A file whose messages span this much log time [ns] is closed and the next one is begun.
    pub split_ns: Option<i64>,
}

impl Default for BagOptions {
    fn default() -> Self {
        Self {
            compression: Compression::default(),
            chunk_bytes: 768 * 1024,
            split_bytes: None,
            split_ns: None,
        }
    }
}

impl BagOptions {
    /// With this compression.
    #[must_use]
    pub fn compression(mut self, compression: Compression) -> Self {
        self.compression = compression;
        self
    }

    /// Begins a new file after this many bytes; a message is never split.
    #[must_use]
    pub fn split_bytes(mut self, bytes: Option<u64>) -> Self {
        self.split_bytes = bytes;
        self
    }

    /// Begins a new file after this much log time [ns].
    #[must_use]
    pub fn split_ns(mut self, nanos: Option<i64>) -> Self {
        self.split_ns = nanos;
        self
    }
}
