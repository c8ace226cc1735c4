//! What refinement on the forward model does.

use std::fmt::Write as _;

use dermis_inversion::Settings;
use dermis_studies::refinement::Findings;

/// For people.
#[must_use]
pub fn text(findings: &Findings) -> String {
    let Findings { refinement, ratio, on, before, after, has_network } = findings;
    let mut out = String::new();
    let settings = &refinement.settings;
    if let Some((learned, _)) = &refinement.correction {
        let _ = writeln!(
            out,
            "correction: {} presses; at other locations the forward model leaves {:.1} times the noise without it, {:.1} with it",
            learned.presses, learned.left[0], learned.left[1]
        );
    }
    let (low, high) =
        settings.gains.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), g| (l.min(*g), h.max(*g)));
    if !settings.gains.is_empty() {
        let _ = writeln!(out, "channel gains against the forward model: {low:.3} to {high:.3}");
    }
    let _ = writeln!(out, "model and device differ by {:.2} % of a signal", settings.model_error * 100.0);
    if settings.contacts > 1 {
        let _ = writeln!(
            out,
            "{} contacts at most; one more must lower the squared deviations by {}",
            settings.contacts, settings.evidence
        );
    }
    if settings.presence > Settings::new(settings.diameter, settings.force_max).presence {
        let _ = writeln!(
            out,
            "untouched readings drift: a contact that the level does not show must lower the squared deviations by {:.0}",
            settings.presence
        );
    }
    let (alone, with) = match has_network {
        true => ("model alone", "with the forward model"),
        false => ("forward model as it was", "with what was recorded"),
    };
    if let Some(ratio) = ratio {
        let _ = writeln!(out, "{with} the error is {ratio:.3} times that of the {alone} (choosing half)");
    }
    let off = format!("off: the {alone} is better");
    let _ = writeln!(out, "refinement is {}\n", if *on { "on" } else { off.as_str() });
    let _ = write!(out, "{alone}, other half: {before}\n{with}, other half: {after}");
    out
}
