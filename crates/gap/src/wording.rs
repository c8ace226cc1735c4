//! Numbers and verdicts as a person reads them.

use crate::report::{Report, Verdict};
use crate::select::Tier;

/// Three digits.
pub(crate) fn short(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        "0".to_owned()
    } else if !(1e-2..1e5).contains(&size) {
        format!("{value:.2e}")
    } else {
        let digits = (2 - size.log10().floor() as i32).max(0) as usize;
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    }
}

/// A share in percent.
pub(crate) fn percent(share: f64) -> String {
    short(100.0 * share)
}

/// One sentence that a person can act on.
pub(crate) fn sentence(report: &Report) -> String {
    let Some(gap) = &report.gap else { return String::new() };
    let list = |names: &[&str]| match names {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [all @ .., last] => format!("{} or {last}", all.join(", ")),
    };
    let size = format!("{} % of what the readings do", percent(gap.systematic.max(0.0)));
    let names: Vec<String> = report
        .effects
        .iter()
        .map(|e| {
            let mut class: Vec<&str> = e.class.iter().map(|a| a.name.as_str()).collect();
            if e.tier == Tier::Loose {
                class.push("the model discrepancy");
            }
            list(&class)
        })
        .collect();
    let place = || {
        let axis = report.axes.first().filter(|a| a.share > 0.1);
        axis.map_or(String::new(), |a| format!(", mostly along {}", a.axis))
    };
    let next = report.next_experiments.first().map_or(String::new(), |e| format!(" Next: {}.", e.what));
    let reduces = report.residual_reduction.map_or(String::new(), |c| {
        let share = c.achieved.unwrap_or(c.predicted);
        format!(
            "; switching it on removes {} % of the gap on held-out contacts ({} to {} %)",
            percent(share),
            percent(c.interval[0]),
            percent(c.interval[1])
        )
    });
    match report.verdict {
        Verdict::Named => format!("The gap ({size}) is {}{reduces}.{next}", names.join(", and ")),
        Verdict::NamedAndUnknown => format!(
            "{} make {} % of the gap ({size}){reduces}; the rest is none of the known effects.{next}",
            names.join(", and "),
            percent(report.unknown.library)
        ),
        Verdict::ModelDiscrepancy => format!(
            "The gap ({size}) is within what the simulator's own tolerances allow: measure the numbers of the medium before you \
             look for an effect."
        ),
        Verdict::Undecided => format!(
            "The gap ({size}, surely between {} and {} %) may be too small to matter: press more places, or harder, before you look for \
             its cause.",
            percent(gap.interval[0].max(0.0)),
            percent(gap.interval[1])
        ),
        Verdict::UnknownSystematic => format!(
            "The gap ({size}) is systematic{}, and none of the known effects makes it: look at its fingerprint before you trust a \
             simulation.",
            place()
        ),
        Verdict::Unmeasured => match gap.irreproducible.filter(|share| *share > 0.5 * gap.fvu_before) {
            Some(share) => format!(
                "Readings differ from press to press by {} % of what they do where the presses were done alike, and hardly \
                 otherwise ({} %): no deterministic model removes that; look at the rig, and record what changes between presses.",
                percent(share),
                percent(gap.systematic.max(0.0))
            ),
            None => format!(
                "The gap ({size}) follows nothing that was recorded: repeat presses, and record temperature and time."
            ),
        },
        Verdict::NoGapBeyondNoise | Verdict::UnusableRecording => report.sentence.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        let texts = [0.0, 12.3456, 120.0, 0.05, 1234.0, 1e-4].map(short);
        assert_eq!(texts, ["0", "12.3", "120", "0.05", "1234", "1.00e-4"]);
        assert_eq!(percent(0.1234), "12.3");
    }
}
