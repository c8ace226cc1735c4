//! Figures that tests print: what they bound is what the book says.
//!
//! Problem: a figure that a test bounds and a page states would be two numbers if each measured its own. Method: the test prints it, a line
//! of JSON for each row, and it is taken from there. Assumptions and cost are the test's, once it is built.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::programs;
use crate::run::output;

/// Begins a line of figures.
const FIGURES: &str = "figures: ";

/// Simulated slides that the fusion finds, and reports of slides that are right.
pub(super) fn slip(root: &Path) -> Result<Value> {
    of(root, &["--lib"], &["slip::tests::slides_are_found_and_others_are_not"])
}

/// What a subscriber that stopped reading costs the node that publishes, over both backends.
pub(super) fn hanging(root: &Path) -> Result<Value> {
    let tests = ["a_hanging_peer_never_holds_a_stream_up", "a_hanging_rclpy_node_never_holds_a_stream_up"];
    of(root, &["--test=suite_hiroz", "--test=rclpy"], &tests)
}

/// Runs tests of these targets, one after the other, and collects what they print.
fn of(root: &Path, targets: &[&str], tests: &[&str]) -> Result<Value> {
    let mut command = programs::everything(root, &["test", "--release", "--quiet"])?;
    command.args(targets).args(["--", "--exact", "--nocapture", "--test-threads=1"]).args(tests);
    printed(&output(&mut command)?, tests)
}

/// The figures that tests printed.
fn printed(text: &str, tests: &[&str]) -> Result<Value> {
    // What the test runner prints may stand before the first.
    let lines = text.lines().filter_map(|line| line.split_once(FIGURES));
    let rows = lines
        .map(|(_, row)| serde_json::from_str(row).with_context(|| format!("{row} is no JSON")))
        .collect::<Result<Vec<Value>>>()?;
    if rows.len() < tests.len() {
        bail!("of `{}`, not all printed figures: {text}", tests.join("`, `"));
    }
    Ok(json!({ "test": tests.join(", "), "rows": rows }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_from_what_the_runner_prints() {
        let text = "running 1 test\ntest a ... figures: {\"what\": \"tip\", \"slides\": 60}\nfigures: {\"what\": \"flat\"}\nok\n";
        let found = printed(text, &["a"]).unwrap();
        assert_eq!(found["rows"], json!([{ "what": "tip", "slides": 60 }, { "what": "flat" }]));
        assert!(printed("running 0 tests\n", &["a"]).is_err() && printed("figures: {\n", &["a"]).is_err());
        assert!(printed("figures: {}\n", &["a", "b"]).is_err(), "one of two tests was skipped");
    }
}
