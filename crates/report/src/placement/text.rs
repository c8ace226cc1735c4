//! What was found, for people, and the elements for a skin file.

use std::fmt::Write as _;

use dermis_skin::Taxel;
use dermis_studies::placement::{Choice, Findings, faster, rim};

fn mm(metres: f64) -> String {
    if metres.is_finite() { format!("{:.2}", metres * 1e3) } else { "-".into() }
}

/// Seconds with the digits that say something.
pub(crate) fn seconds(value: f64) -> String {
    match value {
        v if v < 0.0995 => format!("{:.0} ms", v * 1e3),
        v if v < 9.95 => format!("{v:.1} s"),
        v => format!("{v:.0} s"),
    }
}

/// Tables.
#[must_use]
pub fn text(findings: &Findings) -> String {
    let mut out = String::new();
    let counts = &findings.counts;
    let _ = writeln!(
        out,
        "{}: {} candidates, {} at edges, {} close to supports, {} can be built, of which {} tell the others",
        findings.skin.name, counts.all, counts.edge, counts.held, counts.feasible, counts.reduced
    );
    let forces: Vec<String> = findings.forces.iter().map(|f| format!("{f}")).collect();
    let [seen, held_out] = findings.locations;
    let _ = writeln!(
        out,
        "pressed with {} N at {} locations; judged at {held_out} of them, by support vector regression that learns the other {seen}\n",
        forces.join(", "),
        seen + held_out
    );
    let budget = findings.choices.iter().map(|c| c.sets.0.len()).max().unwrap_or_default();
    let mut shown: Vec<usize> = [1, 2, 3, 5, 7, budget].into_iter().filter(|k| *k <= budget).collect();
    shown.sort_unstable();
    shown.dedup();
    let _ = write!(out, "  error [mm] with       ");
    for k in &shown {
        let _ = write!(out, "{k:>12}");
    }
    let _ = writeln!(out, "     bound     search  outward  to rim");
    for choice in &findings.choices {
        let _ = write!(out, "  {:<22}", choice.method.name());
        for k in &shown {
            let found = choice.evaluation.by_count.iter().find(|c| c.elements == *k);
            let cell = found.map_or("-".into(), |c| format!("{} ±{:.1}", mm(c.mean), c.interval * 1e3));
            let _ = write!(out, "{cell:>12}");
        }
        let last = choice.evaluation.by_count.last();
        let bound = last.and_then(|c| c.bound).map_or("-".into(), mm);
        let (time, rim) = (seconds(choice.seconds), mm(choice.rim));
        let _ = writeln!(out, "{bound:>10} {time:>10} {:>8.2} {rim:>7}", choice.outwardness);
    }
    let failed: Vec<usize> = findings
        .choices
        .first()
        .map(|c| c.evaluation.by_failures.iter().map(|f| f.failed).collect())
        .unwrap_or_default();
    if failed.len() > 1 {
        let _ = write!(out, "\n  error [mm], failed    ");
        for k in &failed {
            let _ = write!(out, "{k:>12}");
        }
        let _ = writeln!(out);
        for choice in &findings.choices {
            let of = |taught: bool| -> String {
                let by = choice.evaluation.by_failures.iter();
                by.map(|f| {
                    let cell = if taught {
                        format!("{} ±{:.1}", mm(f.mean), f.interval * 1e3)
                    } else {
                        mm(f.untaught)
                    };
                    format!("{cell:>12}")
                })
                .collect()
            };
            let _ = writeln!(out, "  {:<22}{}", choice.method.name(), of(true));
            let _ = writeln!(out, "  {:<22}{}", "  not taught anew", of(false));
        }
    }
    let all = mm(rim(&findings.skin, &findings.surface, &findings.candidate_locations));
    let _ = writeln!(
        out,
        "\nsearch: CPU time; to rim: mean distance [mm] from it, {all} of all that can be built"
    );
    if let Some(times) = faster(&findings.choices) {
        let _ = writeln!(out, "crlb searches {times:.0} times as fast as greedy-svr");
    }
    if findings.interrupted {
        let _ = writeln!(out, "\ninterrupted: what was not through is left out");
    }
    out
}

fn numbers(of: [f64; 3]) -> String {
    // Micrometres are enough for a position, and so are as many digits for a direction.
    let each = of.map(|v| {
        let v = (v * 1e6).round() / 1e6;
        format!("{:?}", if v == 0.0 { 0.0 } else { v })
    });
    format!("[{}]", each.join(", "))
}

fn line(taxel: &Taxel) -> String {
    let mut line = format!(
        "    {{ name = {:?}, position = {}, normal = {}",
        taxel.name,
        numbers(taxel.position),
        numbers(taxel.normal)
    );
    if let Some(axis) = taxel.axis {
        let _ = write!(line, ", axis = {}", numbers(axis));
    }
    line + " },"
}

/// The elements as a skin file names them.
#[must_use]
pub fn taxels(choice: &Choice, skin: &str) -> String {
    let mut out = format!(
        "# Placed by `dermis optimize-placement` for {skin}, method {}: in place of the `taxels` of a skin file, without `channels`.\ntaxels = [\n",
        choice.method.name()
    );
    for taxel in &choice.elements {
        out.push_str(&line(taxel));
        out.push('\n');
    }
    out + "]\n"
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use dermis_regress::SvrSettings;
    use dermis_skin::SkinDescription;
    use dermis_studies::placement::{Counts, Request};
    use dermis_theory::placement::{ByCount, ByFailures, Evaluation, Method, Reduction, Sets, Verdict};

    use super::*;

    /// Two methods on the grid of barometers, with made-up figures.
    fn findings() -> Findings {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch/skins/baro-grid.toml");
        let skin = SkinDescription::load(path).unwrap();
        let surface = skin.surface();
        let candidate_locations: Vec<_> = skin.taxels.iter().map(|t| surface.project(&t.point()).0).collect();
        let count = |elements: usize, mean: f64, bound| ByCount {
            elements,
            errors: vec![mean],
            mean,
            interval: 0.1 * mean,
            bound,
            estimator: SvrSettings::default(),
        };
        let failures = |failed: usize, mean: f64| ByFailures {
            failed,
            errors: vec![mean],
            mean,
            interval: 0.1 * mean,
            untaught: 3.0 * mean,
        };
        let choice = |method, seconds, order: &[usize], unit: f64| Choice {
            method,
            seconds,
            clock: seconds,
            threads: 1,
            sets: Sets::nested(order),
            elements: order.iter().map(|i| skin.taxels[*i].clone()).collect(),
            outwardness: unit,
            rim: 0.004 * unit,
            evaluation: Evaluation {
                by_count: vec![count(1, 0.02 * unit, None), count(2, 0.004 * unit, Some(0.0003 * unit))],
                by_failures: vec![failures(0, 0.004 * unit), failures(1, 0.02 * unit)],
            },
        };
        let mut choices =
            vec![choice(Method::GreedySvr, 74.2, &[12, 3], 1.0), choice(Method::Crlb, 0.251, &[12, 20], 0.9)];
        choices[1].elements[1].axis = Some([1.0, 0.0, -0.0]);
        Findings {
            request: Request::default(),
            feet: candidate_locations
                .iter()
                .map(|p| (*p, Verdict::Feasible))
                .chain([(candidate_locations[0], Verdict::Edge)])
                .collect(),
            candidate_locations,
            counts: Counts { all: 26, edge: 1, held: 0, feasible: 25, reduced: 3 },
            reduction: Reduction { chosen: vec![3, 12, 20], unexplained: vec![(1, 0.4), (3, 0.008)] },
            forces: vec![0.42],
            locations: [900, 300],
            choices,
            interrupted: true,
            skin,
            surface,
        }
    }

    #[test]
    fn people_read_errors_failures_and_times() {
        insta::assert_snapshot!(text(&findings()), @r#"
baro-grid: 26 candidates, 1 at edges, 0 close to supports, 25 can be built, of which 3 tell the others
pressed with 0.42 N at 1200 locations; judged at 300 of them, by support vector regression that learns the other 900

  error [mm] with                  1           2     bound     search  outward  to rim
  greedy-svr              20.00 ±2.0   4.00 ±0.4      0.30       74 s     1.00    4.00
  crlb                    18.00 ±1.8   3.60 ±0.4      0.27      0.3 s     0.90    3.60

  error [mm], failed               0           1
  greedy-svr               4.00 ±0.4  20.00 ±2.0
    not taught anew            12.00       60.00
  crlb                     3.60 ±0.4  18.00 ±1.8
    not taught anew            10.80       54.00

search: CPU time; to rim: mean distance [mm] from it, 6.60 of all that can be built
crlb searches 296 times as fast as greedy-svr

interrupted: what was not through is left out
"#);
    }

    #[test]
    fn elements_fit_into_a_skin_file() {
        let findings = findings();
        let table = taxels(&findings.choices[1], "baro-grid");
        insta::assert_snapshot!(table, @r#"
# Placed by `dermis optimize-placement` for baro-grid, method crlb: in place of the `taxels` of a skin file, without `channels`.
taxels = [
    { name = "b12", position = [0.0, 0.0, -0.005], normal = [0.0, 0.0, 1.0] },
    { name = "b20", position = [-0.013, 0.013, -0.005], normal = [0.0, 0.0, 1.0], axis = [1.0, 0.0, 0.0] },
]
"#);
        let file = include_str!("../../../../launch/skins/baro-grid.toml");
        let (before, rest) = file.split_once("taxels = [").unwrap();
        let (_, after) = rest.split_once("\n]").unwrap();
        let skin = SkinDescription::from_toml(&format!("{before}{table}{after}"), "pasted").unwrap();
        assert_eq!(skin.taxels.len(), 2);
    }

    #[test]
    fn pages_show_every_method() {
        let findings = findings();
        let html = super::super::page::html(&findings, &text(&findings)).unwrap();
        assert!(html.contains("greedy-svr, 74 s") && html.contains("crlb, 0.3 s") && !html.contains("NaN"));
        // Figures wrap into as many rows as the window needs: no caption says where one stands.
        assert!(!html.contains("Left") && !html.contains("Right"));
        assert!(html.contains("can be built") && html.contains("tells the others"));
    }
}
