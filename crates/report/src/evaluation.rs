//! What bundles err by.

use std::fmt::Write as _;

use dermis_learn::{Bin, Evaluation, Ratio};
use dermis_studies::evaluation::{BaselineComparison, Findings};

/// For people.
#[must_use]
pub fn text(findings: &Findings) -> String {
    let Findings { everything, evaluation, bound, own, others, verdicts } = findings;
    let mut out = String::new();
    if let Some((everything, left_out)) = everything {
        let _ = writeln!(out, "{everything}{}", against(everything));
        for left_out in left_out {
            let _ = writeln!(out, "{left_out}");
        }
    }
    let _ = write!(out, "{evaluation}");
    if let Some(bound) = bound {
        let _ = write!(out, "{bound}{}", against(evaluation));
    }
    if !others.is_empty() {
        let _ = writeln!(out, "{}", table(own.as_ref().unwrap_or(evaluation), others));
    }
    let _ = write!(out, "{verdicts}");
    out
}

/// Errors beside their bounds.
fn against(evaluation: &Evaluation) -> String {
    evaluation.against_bound.iter().map(ToString::to_string).collect()
}

/// Mean and standard deviation of the magnitudes of errors.
fn spread(bin: &Bin, factor: f64) -> String {
    let deviation = (bin.rms * bin.rms - bin.mean * bin.mean).max(0.0).sqrt();
    format!("{:.2} ±{:.2}", bin.mean * factor, deviation * factor)
}

/// Errors by force on the same frames, side by side: means and standard deviations, and below them the bound of these frames as root
/// mean square and median.
fn table(own: &Evaluation, others: &[BaselineComparison]) -> String {
    let mut out = String::new();
    for (quantity, title, factor) in
        [("position", "position error [mm]", 1e3), ("force.normal", "force error [N]", 1.0)]
    {
        let Some(bins) = own.by_force.get(quantity) else { continue };
        let _ = write!(out, "\n  {title:<22}");
        for bin in bins {
            let to = bin.to.map_or_else(String::new, |v| format!("{v}"));
            let _ = write!(out, "{:>18}", format!("{}–{to} N", bin.from));
        }
        let _ = writeln!(out);
        let rows = others.iter().map(|b| (b.method, &b.evaluation));
        for (name, evaluation) in rows.chain([("the model", own)]) {
            let _ = write!(out, "  {name:<22}");
            for bin in bins {
                let same =
                    evaluation.by_force.get(quantity).into_iter().flatten().find(|b| b.from == bin.from);
                let cell = same.map_or_else(|| "-".to_owned(), |b| spread(b, factor));
                let _ = write!(out, "{cell:>18}");
            }
            let _ = writeln!(out);
        }
        let same = own.against_bound.iter().find(|a| a.contacts == 1 && a.quantity == quantity);
        let Some(of) = same else { continue };
        for (name, median) in [("bound, RMS", false), ("bound, median", true)] {
            let figure = |r: &Ratio| if median { r.bound_median } else { r.bound_rms };
            let _ = write!(out, "  {name:<22}");
            for bin in bins {
                let same = of.by_force.iter().find(|b| b.from == bin.from);
                let cell =
                    same.map_or_else(|| "-".to_owned(), |b| format!("{:.2}", figure(&b.ratio) * factor));
                let _ = write!(out, "{cell:>18}");
            }
            let _ = writeln!(out);
        }
        let Some(open) = &of.undetermined else { continue };
        let _ = write!(out, "  {:<22}", "bound infinite");
        for bin in bins {
            let same = open.by_force.iter().find(|b| b.from == bin.from).map(|b| b.uncounted);
            let cell =
                same.map_or_else(|| "0".to_owned(), |u| format!("{} ({:.1} %)", u.contacts, u.share * 100.0));
            let _ = write!(out, "{cell:>18}");
        }
        let _ = writeln!(out);
    }
    if out.is_empty() {
        out.push_str(
            "\n  no errors by force: neither position nor normal force of these contacts is given and known\n",
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use dermis_learn::{Evaluator, SampleId, Truth, TruthContact};
    use dermis_skin::{Contact, Estimate, ForceComponents};
    use nalgebra::{Point3, Vector3};
    use serde_json::Value;

    use super::*;

    /// One press of 2 N and one of 7 N, found so far off.
    fn evaluation(metres: f64, newtons: f64) -> Evaluation {
        let mut evaluator = Evaluator::new().by_force(&[0.5, 4.9, 9.8]);
        for (location, force) in [(0, 2.0), (1, 7.0)] {
            let at = Point3::new(0.0, 0.0, 0.0);
            let truth = Truth {
                location,
                press: u64::from(location),
                idle: false,
                contacts: vec![TruthContact {
                    position: at,
                    normal: Vector3::z(),
                    force: Vector3::new(0.0, 0.0, -force),
                    components: ForceComponents::Full,
                    diameter: 0.01,
                    flat: false,
                }],
            };
            let mut contact = Contact::at(at + Vector3::x() * metres * force, Vector3::z());
            contact.force = Vector3::new(0.0, 0.0, -force - newtons);
            contact.force_components = ForceComponents::Normal;
            let id = SampleId { run: 0, sample: location as usize };
            evaluator.push(id, &truth, &Estimate { contacts: vec![contact], ..Estimate::default() });
        }
        evaluator.finish("made up")
    }

    #[test]
    fn figures_with_everything_come_first() {
        let some = Findings {
            everything: Some((evaluation(0.0009, 0.1), Vec::new())),
            evaluation: evaluation(0.0002, 0.1),
            bound: None,
            own: None,
            others: Vec::new(),
            verdicts: dermis_learn::Verdicts::of(&[], &evaluation(0.0, 0.0)),
        };
        let text = text(&some);
        let (with, without) = (text.find("1.800").unwrap(), text.find("0.400").unwrap());
        assert!(with < without, "{text}");
    }

    #[test]
    fn an_empty_table_has_a_sentence() {
        let empty = Evaluator::new().finish("nothing");
        assert!(table(&empty, &[]).contains("no errors by force"), "{}", table(&empty, &[]));
    }

    #[test]
    fn people_read_every_way_by_force() {
        let others = [BaselineComparison {
            method: "support vectors",
            settings: Value::Null,
            evaluation: evaluation(0.001, 0.5),
        }];
        insta::assert_snapshot!(table(&evaluation(0.0002, 0.1), &others), @r#"
position error [mm]            0.5–4.9 N         4.9–9.8 N
support vectors               2.00 ±0.00        7.00 ±0.00
the model                     0.40 ±0.00        1.40 ±0.00

force error [N]                0.5–4.9 N         4.9–9.8 N
support vectors               0.50 ±0.00        0.50 ±0.00
the model                     0.10 ±0.00        0.10 ±0.00
"#);
    }
}
