//! Elastic media, Green's functions and fields.
