//! The behaviour that every backend must show, as tests.
