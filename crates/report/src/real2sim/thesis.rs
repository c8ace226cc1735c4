//! Chapter 3 of the thesis, measured again.

use std::fmt::Write as _;

use dermis_studies::real2sim::compare::Row;
use dermis_studies::real2sim::thesis::{Findings, Rule, Strongest};

/// What was found, for people.
#[must_use]
pub fn text(findings: &Findings) -> String {
    let Findings { skin, sizes, trained, reduced, .. } = findings;
    let widths = |layers: &[usize]| layers.iter().map(ToString::to_string).collect::<Vec<_>>().join("-");
    let mut out = format!("{skin}: one and two contacts by way of a simulated displacement map\n");
    for (name, layers) in [
        ("transfer", &sizes.transfer),
        ("reconstruction", &sizes.reconstruction),
        ("sensitivity", &sizes.sensitivity),
    ] {
        let _ = writeln!(out, "{name} network: {}", widths(layers));
    }
    let _ = writeln!(
        out,
        "{} recorded contacts; the transfer leaves {:.1} % of held-out virtual sensors",
        trained.recorded,
        trained.transfer_error * 100.0
    );
    for sentence in reduced {
        let _ = writeln!(out, "reduced: {sentence}");
    }
    for left_out in &findings.left_out {
        let _ = writeln!(out, "{left_out}");
    }
    maps(&mut out, findings);
    contacts(&mut out, findings);
    by_force(&mut out, &findings.rows);
    let _ = writeln!(out, "\n{:.0} s", findings.seconds);
    out
}

/// Fig. 3.5 A.
fn maps(out: &mut String, findings: &Findings) {
    let _ = writeln!(
        out,
        "\nmaps of recorded contacts, by virtual sensors near each element and kind of transfer: unexplained variance [%], RMS \
         error [µm]\n{:>8} {:<12}{:>20}{:>20}",
        "sensors", "transfer", "one contact", "two contacts"
    );
    for row in &findings.maps {
        let cell = |of: &dermis_learn::MapSummary| format!("{:.1} {:.1}", of.fvu * 100.0, of.rms * 1e6);
        let _ = writeln!(
            out,
            "{:>8} {:<12}{:>20}{:>20}",
            row.each,
            row.transfer,
            cell(&row.single),
            cell(&row.double)
        );
    }
}

/// Table 3.2.
fn contacts(out: &mut String, findings: &Findings) {
    let _ = writeln!(
        out,
        "\ncontacts, each assigned one that was found; what is missed counts as far away as the middle of the surface, and as a \
         force of 0\n{:<24}{:<14}{:>8}{:>10}{:>10}{:>10}{:>12}",
        "", "", "frames", "mean mm", "mean N", "lost %", "number ok %"
    );
    for Row { method, kind, errors, .. } in &findings.rows {
        let right = errors.count_right.map_or_else(|| "-".to_owned(), |v| format!("{:.1}", v * 100.0));
        let _ = writeln!(
            out,
            "{method:<24}{kind:<14}{:>8}{:>10.2}{:>10.2}{:>10.1}{right:>12}",
            errors.frames,
            errors.position_mean * 1e3,
            errors.force_mean,
            errors.lost * 100.0
        );
    }
    let whose = [("", &findings.strongest), (" of the true maps", &findings.strongest_of_true_maps)];
    for (whose, rows) in whose {
        let _ = writeln!(
            out,
            "\nstrongest peaks{whose}, each held against the nearest contact, as many as there are contacts\n{:<38}{:>8}{:>10}{:>10}{:>10}",
            "", "frames", "mean mm", "mean N", "short %"
        );
        strongest(out, rows);
    }
}

fn strongest(out: &mut String, rows: &[Strongest]) {
    for row in rows {
        let rule = match row.rule {
            Rule::Strongest => "the strongest",
            Rule::NextWithinTenth => "the next for the last if within 10 %",
        };
        let _ = writeln!(
            out,
            "{} {rule:<36}{:>8}{:>10.2}{:>10.2}{:>10.1}",
            row.contacts,
            row.frames,
            row.position_mean * 1e3,
            row.force_mean,
            row.short * 100.0
        );
    }
}

/// Fig. 3.8.
fn by_force(out: &mut String, rows: &[Row]) {
    for (quantity, unit, factor) in [("position", "mm", 1e3), ("force.normal", "N", 1.0)] {
        let _ = writeln!(out, "\none contact, mean error of {quantity} [{unit}] by force [N]");
        for row in rows.iter().filter(|r| r.kind == "single") {
            let Some(bins) = row.evaluation.as_ref().and_then(|e| e.by_force.get(quantity)) else { continue };
            let cells = bins.iter().map(|bin| format!("{}+: {:.2}", bin.from, bin.mean * factor));
            let _ = writeln!(out, "{:<24}{}", row.method, cells.collect::<Vec<_>>().join("  "));
        }
    }
}

#[cfg(test)]
mod tests {
    use dermis_learn::MapSummary;
    use dermis_learn::real2sim::{Settings, Trained};
    use dermis_studies::real2sim::compare::Errors;
    use dermis_studies::real2sim::thesis::{MapRow, Sizes};

    use super::*;

    #[test]
    fn all_figures_are_shown_and_what_was_reduced_is_said() {
        let summary = |fvu| MapSummary { maps: 10, rms: 1.5e-5, fvu };
        let errors = Errors {
            frames: 10,
            count_right: Some(0.5),
            position_mean: 0.005,
            position_rms: 0.006,
            position_median: 0.004,
            force_mean: 3.0,
            force_rms: 4.0,
            lost: 0.1,
        };
        let findings = Findings {
            skin: "limb".into(),
            skin_hash: "sha256:0".into(),
            settings: Settings::default(),
            reduced: vec!["10 of 60 epochs of the reconstruction network".into()],
            sizes: Sizes {
                transfer: vec![10, 250, 240],
                reconstruction: vec![240, 600, 3154],
                sensitivity: vec![4, 250, 1],
            },
            trained: Trained {
                sensors: "displacements".into(),
                virtual_sensors: 240,
                rank: 3154,
                kept: 1.0,
                recorded: 4000,
                transfer_error: 0.12,
                map_rms: vec![1e-5],
                peaks: 2000,
                settings: dermis_inversion::PeakSettings::default(),
            },
            data: ["a".into(), "b".into()],
            frames: [("single", 10)].into(),
            left_out: Vec::new(),
            maps: vec![MapRow {
                each: 24,
                sensors: 240,
                transfer: "network",
                single: summary(0.04),
                double: summary(0.29),
            }],
            rows: vec![Row {
                method: "peaks of maps".into(),
                kind: "single",
                with_everything: None,
                errors,
                found: None,
                seconds: 0.0,
                evaluation: None,
            }],
            strongest: vec![Strongest {
                contacts: 2,
                rule: Rule::NextWithinTenth,
                frames: 10,
                position_mean: 0.010,
                force_mean: 6.0,
                short: 0.2,
            }],
            strongest_of_true_maps: vec![Strongest {
                contacts: 1,
                rule: Rule::Strongest,
                frames: 10,
                position_mean: 0.002,
                force_mean: 1.0,
                short: 0.0,
            }],
            seconds: 12.0,
        };
        let text = text(&findings);
        for line in [
            "reconstruction network: 240-600-3154",
            "reduced: 10 of 60 epochs of the reconstruction network",
            "      24 network                 4.0 15.0           29.0 15.0",
            "peaks of maps           single              10      5.00      3.00      10.0        50.0",
            "2 the next for the last if within 10 %      10     10.00      6.00      20.0",
            "1 the strongest                             10      2.00      1.00       0.0",
        ] {
            assert!(text.lines().any(|l| l == line), "{line}\n{text}");
        }
    }
}
