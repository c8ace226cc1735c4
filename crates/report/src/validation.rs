//! A sensor family's physics against references.

use std::fmt::Write as _;

use dermis_mechanics::Case;

/// Five digits, which is more than any reference has.
fn digits(value: f64) -> String {
    let magnitude = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    if (-3..6).contains(&magnitude) {
        format!("{value:.*}", (4 - magnitude).max(0) as usize)
    } else {
        format!("{value:.4e}")
    }
}

/// For people.
#[must_use]
pub fn text(cases: &[Case]) -> String {
    let width = cases.iter().map(|c| c.id.chars().count()).max().unwrap_or(0);
    let mut out =
        format!("{:<width$}  {:>10} {:>10} {:>10} unit\n", "case", "reference", "computed", "tolerance");
    for case in cases {
        let _ = writeln!(
            out,
            "{:<width$}  {:>10} {:>10} {:>10} {:<4} {}  {} ({})",
            case.id,
            digits(case.reference),
            digits(case.got),
            digits(case.tolerance),
            case.unit,
            if case.pass { "pass" } else { "FAIL" },
            case.what,
            case.source,
        );
    }
    let passed = cases.iter().filter(|c| c.pass).count();
    let _ = writeln!(out, "{passed} of {} cases within their tolerance", cases.len());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_read_a_table() {
        let cases = [
            Case::relative("B1", "half-space", "Boussinesq", "Pa", [6324.2, 6324.1], 0.005),
            Case::relative("B2 w", "displacement", "another code", "m", [7.0e-3, 6.313e-3], 0.005),
            Case::new("B7", "a difference", "the integral", "Pa", [0.0, 0.0], (0.001, 7103.0)),
        ];
        insta::assert_snapshot!(text(&cases), @r#"
case   reference   computed  tolerance unit
B1        6324.1     6324.2     31.621 Pa   pass  half-space (Boussinesq)
B2 w   0.0063130  0.0070000  3.1565e-5 m    FAIL  displacement (another code)
B7        0.0000     0.0000     7.1030 Pa   pass  a difference (the integral)
2 of 3 cases within their tolerance
"#);
    }

    #[test]
    fn digits_are_few() {
        assert_eq!(
            [0.0, 65.5, 6324.123, -11.919, 6.313e-3, 1e-9].map(digits),
            ["0.0000", "65.500", "6324.1", "-11.919", "0.0063130", "1.0000e-9"]
        );
    }
}
