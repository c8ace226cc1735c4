//! Slides that the fusion finds, on simulated ones.
//!
//! Problem: how many slides are found within 0.1 s, and how often is a report right? Method: the test that bounds these figures prints
//! them, a line of JSON for each thing that slides; they are taken from there, so that the book and the test cannot differ. Assumptions and
//! cost are the test's: seeded simulations, seconds of CPU time once it is built.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::programs;
use crate::run::output;

/// The test of `dermis-fusion`.
const TEST: &str = "slip::tests::slides_are_found_and_others_are_not";
/// Begins a line of figures.
const FIGURES: &str = "figures: ";

pub(super) fn slip(root: &Path) -> Result<Value> {
    // By the name of one test: those of other crates run none.
    let mut test = programs::everything(root, &["test", "--release", "--quiet", "--lib"])?;
    printed(&output(test.args([TEST, "--", "--exact", "--nocapture"]))?)
}

/// The figures that a test printed.
fn printed(text: &str) -> Result<Value> {
    // What the test runner prints may stand before the first.
    let lines = text.lines().filter_map(|line| line.split_once(FIGURES));
    let rows = lines
        .map(|(_, row)| serde_json::from_str(row).with_context(|| format!("{row} is no JSON")))
        .collect::<Result<Vec<Value>>>()?;
    if rows.is_empty() {
        bail!("`{TEST}` printed no figures: {text}");
    }
    Ok(json!({ "test": TEST, "rows": rows }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_from_what_the_runner_prints() {
        let text = "running 1 test\ntest a ... figures: {\"what\": \"tip\", \"slides\": 60}\nfigures: {\"what\": \"flat\"}\nok\n";
        let found = printed(text).unwrap();
        assert_eq!(found["rows"], json!([{ "what": "tip", "slides": 60 }, { "what": "flat" }]));
        assert!(printed("running 0 tests\n").is_err() && printed("figures: {\n").is_err());
    }
}
