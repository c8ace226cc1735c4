//! Where a simulated skin and a real one differ: diagnosis of a recording, closing the gap, and the benchmark of both.

mod answers;
mod baselines;
pub mod benchmark;
pub mod calibration;
pub mod closing;
pub mod diagnosis;
mod follow_ups;
pub mod generation;
pub mod planning;
pub mod protocol;
mod scorecard;
