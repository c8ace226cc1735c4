//! Estimators side by side.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use anyhow::Result;
use dermis_figures::{escape, page};
use dermis_learn::Evaluation;
use dermis_studies::comparison::Findings;
use serde_json::Value;

/// One table for locations, one for forces, and one for each map that an estimator gives.
///
/// # Errors
///
/// Never, as findings are made of numbers and names.
pub fn text(findings: &Findings) -> Result<String> {
    let record = serde_json::to_value(findings)?;
    let skin = &findings.skin;
    let mut out = format!(
        "{}: {} readings at {} locations that nothing was trained on\n",
        skin.name, record["readings"], record["locations"]
    );
    for left_out in &findings.left_out {
        let _ = writeln!(out, "{left_out}");
    }
    out.push_str(
        "a contact that is not found counts as far away as the middle of the surface, and as a force of 0\n",
    );
    let bins: Vec<f64> =
        record["bins_n"].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    for (quantity, bound, unit, factor) in
        [("position", "position", "mm", 1e3), ("force.normal", "normal_force", "N", 1.0)]
    {
        if findings.methods.iter().all(|(_, e)| !e.quantities.contains_key(quantity)) {
            let _ =
                writeln!(out, "\n{quantity}: no estimator gives it, or it is not known in these recordings");
            continue;
        }
        let _ = write!(out, "\n{quantity} RMSE [{unit}] by force [N]\n{:<38}", "");
        for (i, from) in bins.iter().enumerate() {
            let head = bins.get(i + 1).map_or_else(|| format!("{from}+"), |to| format!("{from}-{to}"));
            let _ = write!(out, "{head:>10}");
        }
        let _ = writeln!(out, "{:>10}{:>10}", "all", "missed");
        let cells = |found: &Value, figure: &str| -> String {
            bins.iter().fold(String::new(), |mut line, from| {
                let bin = found.as_array().into_iter().flatten().find(|b| b["from"].as_f64() == Some(*from));
                let rms = bin.and_then(|b| b[figure].as_f64());
                let _ = match rms {
                    Some(rms) => write!(line, "{:>10.4}", rms * factor),
                    None => write!(line, "{:>10}", "-"),
                };
                line
            })
        };
        for method in record["methods"].as_array().into_iter().flatten() {
            let evaluation = &method["evaluation"];
            let name = method["name"].as_str().unwrap_or_default();
            let all = evaluation["quantities"][quantity]["rms"].as_f64().unwrap_or(f64::NAN) * factor;
            let missed = evaluation["not_found"].as_f64().unwrap_or(0.0) * 100.0;
            let _ = writeln!(
                out,
                "{name:<38}{}{all:>10.4}{missed:>8.1} %",
                cells(&evaluation["by_force"][quantity], "rms")
            );
            let found = format!("{quantity} found");
            if let Some(rms) = evaluation["quantities"][&found]["rms"].as_f64() {
                let cells = cells(&evaluation["by_force"][&found], "rms");
                let _ = writeln!(out, "{:<38}{cells}{:>10.4}", "  of contacts that were found", rms * factor);
            }
        }
        if !record["bound"].is_null() {
            let _ = writeln!(out, "{:<38}{}", "Cramér–Rao bound", cells(&record["bound"][bound], "rms"));
            let _ = writeln!(out, "{:<38}{}", "  its median", cells(&record["bound"][bound], "median"));
        }
    }
    maps(&mut out, &findings.methods);
    for (name, evaluation) in &findings.methods {
        if !evaluation.against_bound.is_empty() {
            let _ = writeln!(out, "\n{name}");
        }
        for against in &evaluation.against_bound {
            let _ = write!(out, "{against}");
        }
    }
    if let Some(bound) = &findings.bound {
        let _ = write!(out, "{}", bound.left_out);
    }
    Ok(out)
}

/// Errors of maps over all points of the readings that are compared.
fn maps(out: &mut String, methods: &[(String, Evaluation)]) {
    let names: BTreeSet<&String> = methods.iter().flat_map(|(_, e)| e.maps.keys()).collect();
    for map in names {
        let _ = writeln!(
            out,
            "\n{map}, over all points\n{:<38}{:>14}{:>16}{:>18}{:>9}{:>12}",
            "", "RMSE", "of the truth", "total force [N]", "frames", "unanswered"
        );
        for (name, errors) in methods.iter().filter_map(|(name, e)| Some((name, e.maps.get(map)?))) {
            let (unit, factor) = if errors.unit == "m" { ("µm", 1e6) } else { ("mN", 1e3) };
            let of = &errors.touched;
            let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".into());
            let _ = writeln!(
                out,
                "{name:<38}{:>14}{:>16}{:>18}{:>9}{:>12}",
                or_dash(of.rms.map(|v| format!("{:.3} {unit}", v * factor))),
                or_dash(of.relative.map(|v| format!("{:.1} %", v * 100.0))),
                or_dash(of.total_force.map(|v| format!("{v:.3}"))),
                of.frames,
                of.unanswered
            );
        }
    }
}

/// The whole page.
#[must_use]
pub fn html(findings: &Findings, text: &str) -> String {
    page(&format!("{}: estimators compared", findings.skin.name), &format!("<pre>{}</pre>", escape(text)))
}
