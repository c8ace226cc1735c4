//! How a demo went.

use dermis_operate::demo::Findings;

/// For people.
#[must_use]
pub fn text(found: &Findings) -> String {
    format!(
        "\n{} frames in {:.1} s, {} with a contact; median error {} mm and {} N over {} frames stronger than {} N\n",
        found.arrays,
        found.seconds,
        found.touched,
        rounded(found.position_error_mm.p50),
        rounded(found.force_error_n.p50),
        found.compared,
        found.least_force,
    )
}

fn rounded(value: f64) -> String {
    if value.is_finite() { format!("{value:.3}") } else { "-".to_owned() }
}

#[cfg(test)]
mod tests {
    use dermis_operate::demo::Statuses;
    use dermis_operate::{Samples, Spread};

    use super::*;

    #[test]
    fn what_was_not_compared_is_no_number() {
        let mut errors = Samples::default();
        let mut found = Findings {
            seconds: 10.04,
            frames_sent: 1000,
            arrays: 998,
            touched: 500,
            rate_hz: 100.0,
            latency_ms: Spread::from(&errors),
            compared: 0,
            least_force: 0.1,
            position_error_mm: Spread::from(&errors),
            force_error_n: Spread::from(&errors),
            status: Statuses { ok: 998, degraded: 0, stale: 0, uncalibrated: 0, fault: 0 },
        };
        assert!(text(&found).contains("median error - mm and - N over 0 frames"), "{}", text(&found));
        errors.push(0.25);
        (found.compared, found.position_error_mm) = (1, Spread::from(&errors));
        assert_eq!(
            text(&found),
            "\n998 frames in 10.0 s, 500 with a contact; median error 0.250 mm and - N over 1 frames stronger than 0.1 N\n"
        );
    }
}
