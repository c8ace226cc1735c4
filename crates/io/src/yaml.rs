//! What a YAML text stands for, counted before anything is built of it.
//!
//! Problem ("billion laughs"): an alias repeats what its anchor names, anchors may hold aliases, and every level multiplies: 457
//! bytes stand for gigabytes. Readers copy what an alias names, and read nested values by recursion.
//!
//! Solution: the parser gives events one after the other without building anything. Every anchor remembers how many values and
//! bytes of text it stands for, an alias adds as many, and the count ends at a budget. Cost: one pass over the text, and memory
//! for the open levels and the anchors.

use std::collections::HashMap;

use yaml_rust2::parser::{Event, Parser};

/// What a text may stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Scalars, lists and tables, with what aliases repeat.
    pub values: u64,
    /// \[bytes\] of all scalars, with what aliases repeat.
    pub text: u64,
}

impl Budget {
    /// For files that people write: [`TEXT`](crate::TEXT) long at most.
    pub const WRITTEN: Self = Self { values: 100_000, text: 2 * crate::TEXT };
    /// For files that programs write.
    pub const REPORTED: Self = Self { values: 1_000_000, text: 2 * crate::REPORT };
}

/// Lists and tables within one another: what reads them does so by recursion.
const DEEPEST: usize = 64;

/// What a value stands for.
#[derive(Debug, Clone, Copy, Default)]
struct Weight {
    values: u64,
    text: u64,
}

impl Weight {
    fn add(&mut self, other: Self) {
        self.values = self.values.saturating_add(other.values);
        self.text = self.text.saturating_add(other.text);
    }
}

/// Whether a text stays within a budget. A text that is no YAML passes up to where it goes wrong: its reader says more about it.
///
/// # Errors
///
/// A sentence with the line where it becomes too much.
pub fn check(text: &str, budget: Budget) -> Result<(), String> {
    let mut parser = Parser::new_from_str(text);
    let mut anchors: HashMap<usize, Weight> = HashMap::new();
    // Anchor of each open list or table, and what is in it.
    let mut open: Vec<(usize, Weight)> = Vec::new();
    // Readers keep a copy of what an anchor names.
    let mut kept = Weight::default();
    let mut whole = Weight::default();
    loop {
        let Ok((event, marker)) = parser.next_token() else { return Ok(()) };
        let line = marker.line();
        let (anchor, weight) = match event {
            Event::StreamEnd => return Ok(()),
            Event::SequenceStart(anchor, _) | Event::MappingStart(anchor, _) => {
                if open.len() >= DEEPEST {
                    return Err(format!("line {line} is nested too deeply: {DEEPEST} levels at most"));
                }
                open.push((anchor, Weight::default()));
                continue;
            }
            Event::SequenceEnd | Event::MappingEnd => {
                let (anchor, inside) = open.pop().unwrap_or_default();
                (anchor, Weight { values: inside.values.saturating_add(1), text: inside.text })
            }
            Event::Scalar(text, _, anchor, _) => (anchor, Weight { values: 1, text: text.len() as u64 }),
            // One that stands within its own anchor stands for nothing.
            Event::Alias(anchor) => {
                (0, anchors.get(&anchor).copied().unwrap_or(Weight { values: 1, text: 0 }))
            }
            _ => continue,
        };
        if anchor > 0 {
            anchors.insert(anchor, weight);
            kept.add(weight);
        }
        match open.last_mut() {
            Some((_, inside)) => inside.add(weight),
            None => whole.add(weight),
        }
        let mut all = kept;
        all.add(whole);
        open.iter().for_each(|(_, inside)| all.add(*inside));
        if all.values > budget.values {
            return Err(format!(
                "line {line}: with what its aliases repeat the file holds more than {} values; write fewer",
                budget.values
            ));
        }
        if all.text > budget.text {
            return Err(format!(
                "line {line}: with what its aliases repeat the file holds more than {} bytes of text; write less",
                budget.text
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each line repeats the one before ten times.
    fn laughs(lines: usize) -> String {
        let mut text = "a0: &a0 ha\n".to_owned();
        for i in 1..=lines {
            let before = format!("*a{}", i - 1);
            text += &format!("a{i}: &a{i} [{}]\n", vec![before; 10].join(", "));
        }
        text
    }

    fn refused(text: &str) -> String {
        check(text, Budget::WRITTEN).unwrap_err()
    }

    #[test]
    fn aliases_are_counted_and_not_followed() {
        assert_eq!(check(&laughs(3), Budget::WRITTEN), Ok(()));
        insta::assert_snapshot!(refused(&laughs(9)), @"line 6: with what its aliases repeat the file holds more than 100000 values; write fewer");
        let long = format!("a: &a {}\nb: [{}]", "x".repeat(100_000), vec!["*a"; 1000].join(", "));
        insta::assert_snapshot!(refused(&long), @"line 2: with what its aliases repeat the file holds more than 8388608 bytes of text; write less");
        // An anchor on every level is copied on every level.
        let nested = format!("{}[{}]{}", "&a [".repeat(60), "1, ".repeat(20_000), "]".repeat(60));
        insta::assert_snapshot!(refused(&nested), @"line 1: with what its aliases repeat the file holds more than 100000 values; write fewer");
        assert_eq!(check("a: &a [*a]\nb: *a", Budget::WRITTEN), Ok(()));
    }

    #[test]
    fn depth_ends() {
        for text in [
            "- ".repeat(100_000),
            (0..5000).map(|i| " ".repeat(i) + "a:\n").collect(),
            "[".repeat(100) + &"]".repeat(100),
        ] {
            assert!(refused(&text).contains("nested too deeply"), "{}", refused(&text));
        }
        assert_eq!(check(&"- ".repeat(60), Budget::WRITTEN), Ok(()));
    }

    #[test]
    fn what_is_no_yaml_is_for_its_reader_to_refuse() {
        for text in ["", "a: [", "*none", "\u{0}", "{a: 1}}"] {
            assert_eq!(check(text, Budget::WRITTEN), Ok(()), "{text}");
        }
    }
}
