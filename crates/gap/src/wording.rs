//! Numbers and verdicts as a person reads them.

use crate::constants::report::{ALONG, IRREPRODUCIBLE, SHAPE_LEFT, SHAPED};
use crate::report::{Report, ResidualReduction, Verdict};
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

/// A reduction with its interval, where that says something.
pub fn reduction(of: &ResidualReduction) -> String {
    let share = of.achieved.unwrap_or(of.predicted).max(0.0);
    let [low, high] = of.interval;
    if low <= 0.0 {
        return format!(
            "{} % of the gap on held-out contacts (uncertain: anything up to {} %)",
            percent(share),
            percent(high)
        );
    }
    format!("{} % of the gap on held-out contacts ({} to {} %)", percent(share), percent(low), percent(high))
}

/// What becomes of the gap where the named effects are switched on, of which some may not be able to.
fn reduces(report: &Report, of: &ResidualReduction) -> String {
    let gap = |text: &str| text.replace("of the gap", "of it");
    let reduction = reduction(of);
    let written = report.effects.iter().filter(|e| e.written).count();
    match (written, report.effects.len() - written, of.achieved) {
        (0, _, _) | (_, _, None) => format!(
            "; the fitted signature explains {}, and no skin description can switch it on",
            gap(&reduction)
        ),
        (_, 0, _) => format!("; switching it on removes {reduction}"),
        _ => {
            format!("; switching on what can be, with the fitted signature of the rest, removes {reduction}")
        }
    }
}

/// What an unknown cause is shaped like, where a shape explains much of the gap and more than what is named.
fn shape(report: &Report) -> String {
    let rival = report.rivals.first().filter(|r| r.explains > SHAPED && r.excess.is_none_or(|e| e > 0.0));
    rival.map_or(String::new(), |r| {
        format!(", but shaped like {} ({} % of the gap)", r.what, percent(r.explains))
    })
}

/// Whether the calibration speaks for a cause that the library lacks.
fn called_unknown(report: &Report) -> bool {
    let of = &report.unknown;
    of.evidence.zip(of.threshold).is_some_and(|(evidence, threshold)| evidence > threshold)
}

/// What the names leave, in words.
fn remaining_shape(report: &Report) -> String {
    let of = &report.unknown;
    let matters = of.shape.as_ref().zip(of.shape_share).filter(|(_, share)| *share > SHAPE_LEFT);
    matters.map_or(String::new(), |(what, share)| {
        format!(", shaped like {what} ({} % of the gap),", percent(share))
    })
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
            let mut class = e.names();
            if e.tier == Tier::Loose {
                class.push("the model discrepancy".to_owned());
            }
            list(&class.iter().map(String::as_str).collect::<Vec<&str>>())
        })
        .collect();
    let place = || {
        let axis = report.axes.first().filter(|a| a.share > ALONG);
        axis.map_or(String::new(), |a| format!(", mostly along {}", a.axis))
    };
    let next = report.next_experiments.first().map_or(String::new(), |e| format!(" Next: {}.", e.what));
    let reduces = report.residual_reduction.map_or(String::new(), |c| reduces(report, &c));
    match report.verdict {
        Verdict::Named => format!("The gap ({size}) is {}{reduces}.{next}", names.join(", and ")),
        Verdict::NamedAndUnknown if called_unknown(report) => format!(
            "What makes the gap ({size}) is probably none of the known effects. It looks like {}{reduces}; what that leaves{} is not \
             what a right name leaves.{next}",
            names.join(", and "),
            remaining_shape(report)
        ),
        Verdict::NamedAndUnknown => format!(
            "{} make {} % of the gap ({size}){reduces}; the rest is none of the known effects{}.{next}",
            names.join(", and "),
            percent(report.unknown.library),
            shape(report)
        ),
        Verdict::ModelDiscrepancy => format!(
            "The gap ({size}) is within what the simulator's own tolerances allow: measure the numbers of the medium before you \
             look for an effect."
        ),
        Verdict::Undecided => format!(
            "The gap ({size}, surely between {} and {} %) may be too small to matter: press more locations, or harder, before you look for \
             its cause.",
            percent(gap.interval[0].max(0.0)),
            percent(gap.interval[1])
        ),
        Verdict::UnknownSystematic => format!(
            "The gap ({size}) is systematic{}, and none of the known effects makes it{}: look at its fingerprint before you trust a \
             simulation.",
            place(),
            shape(report)
        ),
        Verdict::Unmeasured => {
            match gap.irreproducible.filter(|share| *share > IRREPRODUCIBLE * gap.fvu_before) {
                Some(share) => format!(
                    "Readings differ from press to press by {} % of what they do where the presses were done alike, and hardly \
                 otherwise ({} %): no deterministic model removes that; look at the rig, and record what changes between presses.",
                    percent(share),
                    percent(gap.systematic.max(0.0))
                ),
                None => format!(
                    "The gap ({size}) follows nothing that was recorded: repeat presses, and record temperature and time."
                ),
            }
        }
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
