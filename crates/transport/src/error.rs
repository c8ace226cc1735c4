//! What can be wrong with a source before it runs.

use std::path::PathBuf;

/// Why a source URL, a pseudo-terminal or a recording could not be used.
///
/// Messages are sentence fragments that name the part at fault and say what is valid instead.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// The text has no `scheme://`.
    #[error("source `{url}` is not a URL: write it as SCHEME://…, where SCHEME is one of {valid}")]
    NotAUrl {
        /// The text as given.
        url: String,
        /// Valid schemes, separated by commas.
        valid: String,
    },
    /// The scheme is none of ours.
    #[error("source `{url}` has the unknown scheme `{scheme}`; valid schemes are {valid}")]
    UnknownScheme {
        /// The text as given.
        url: String,
        /// The unknown scheme.
        scheme: String,
        /// Valid schemes, separated by commas.
        valid: String,
    },
    /// A key after `?` is not one that the scheme knows.
    #[error("source `{url}` has the unknown key `{key}`; valid keys of {scheme}:// are {valid}")]
    UnknownKey {
        /// The text as given.
        url: String,
        /// Scheme of the URL.
        scheme: &'static str,
        /// The unknown key.
        key: String,
        /// Valid keys, separated by commas.
        valid: String,
    },
    /// A key is there twice.
    #[error("source `{url}` gives the key `{key}` twice")]
    DuplicateKey {
        /// The text as given.
        url: String,
        /// The repeated key.
        key: String,
    },
    /// A key has a value that it cannot have.
    #[error("source `{url}` has {key}={value}, but {key} must be {expected}")]
    InvalidValue {
        /// The text as given.
        url: String,
        /// Key with the invalid value.
        key: String,
        /// The value as given.
        value: String,
        /// What would be valid.
        expected: String,
    },
    /// The part between `://` and `?` does not fit the scheme.
    #[error("source `{url}` has no usable {what}: {expected}")]
    InvalidTarget {
        /// The text as given.
        url: String,
        /// What the scheme needs there (path, address).
        what: &'static str,
        /// What would be valid.
        expected: String,
    },
    /// A pseudo-terminal could not be made.
    #[error("cannot make a pseudo-terminal ({step}): {source}")]
    Pty {
        /// The step that failed.
        step: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// A symbolic link to a pseudo-terminal could not be made.
    #[error("cannot make the link {path} to the pseudo-terminal: {source}")]
    PtyLink {
        /// Path of the link.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A frame requested of an encoder does not fit the wire format.
    #[error("cannot encode a frame of {channels} channels: a frame has 1 to {max}")]
    ChannelCount {
        /// Channels requested.
        channels: usize,
        /// Most channels of a frame.
        max: usize,
    },
    /// A frame that an encoder is to split does not fit datagrams of this length.
    #[error(
        "cannot send a frame of {channels} channels in datagrams of {most} bytes: they must have at least {least}, and a frame has at \
         most 255 parts"
    )]
    DatagramLength {
        /// \[bytes\] requested.
        most: usize,
        /// Channels of the frame.
        channels: usize,
        /// \[bytes\] of the shortest datagram that frames are split for.
        least: usize,
    },
}
