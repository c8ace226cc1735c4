//! Byte sources by URL, framing and reconnection.
