//! What a computed figure is checked against.

use serde::Serialize;

/// One figure, computed now, beside the reference that it has to meet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Case {
    /// Short, unique in its list.
    pub id: String,
    /// What is computed, in words.
    pub what: String,
    /// Where the reference is from: an equation, a paper, another program.
    pub source: String,
    /// What it should be, in `unit`.
    pub reference: f64,
    /// What was computed, in `unit`.
    pub got: f64,
    /// Largest |got − reference| that passes, in `unit`.
    pub tolerance: f64,
    /// SI symbol; empty for a ratio.
    pub unit: &'static str,
    /// Whether it passes.
    pub pass: bool,
}

impl Case {
    /// A figure that may differ from its reference by `share` of `scale`: of the reference itself where a relative
    /// tolerance is meant, of the peak for the tail of a field.
    #[must_use]
    pub fn new(
        id: impl Into<String>,
        what: impl Into<String>,
        source: impl Into<String>,
        unit: &'static str,
        [got, reference]: [f64; 2],
        (share, scale): (f64, f64),
    ) -> Self {
        let tolerance = share * scale.abs();
        // What is not a number does not pass.
        let pass = (got - reference).abs() <= tolerance;
        Self {
            id: id.into(),
            what: what.into(),
            source: source.into(),
            reference,
            got,
            tolerance,
            unit,
            pass,
        }
    }

    /// A figure that may differ from its reference by `share` of it.
    #[must_use]
    pub fn relative(
        id: impl Into<String>,
        what: impl Into<String>,
        source: impl Into<String>,
        unit: &'static str,
        [got, reference]: [f64; 2],
        share: f64,
    ) -> Self {
        Self::new(id, what, source, unit, [got, reference], (share, reference))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_figure_within_its_tolerance_passes() {
        let case = |got: f64| Case::relative("B0", "a length", "a ruler", "m", [got, -2.0], 0.01);
        assert!(case(-2.019).pass && case(-1.981).pass);
        assert!(!case(-2.021).pass && !case(2.0).pass && !case(f64::NAN).pass);
    }
}
