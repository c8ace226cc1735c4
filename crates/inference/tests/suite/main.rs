//! Bundles and runtimes together.

#![allow(clippy::unwrap_used, reason = "in a test, the panic is the failure report")]

mod bundles;
mod graphs;
mod runtimes;
