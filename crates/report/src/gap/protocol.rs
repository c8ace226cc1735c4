//! Presses to come, for a person with a rig.

use std::fmt::Write;

use dermis_gap::protocol::design::settles;
use dermis_studies::gap::planning::Planned;
use dermis_studies::gap::protocol::Protocol;

/// A probability as people read it.
fn probability(p: f64) -> String {
    if p < 0.001 { "< 0.1 %".to_owned() } else { format!("{:.1} %", 100.0 * p) }
}

/// Millimetres.
fn mm(metres: f64) -> String {
    format!("{:.2}", 1000.0 * metres)
}

/// What a person needs to carry out a plan: tips and locations, then step after step what to do and what for. `plan` is how the plan file is
/// called.
#[must_use]
pub fn instructions(found: &Planned, plan: &str) -> String {
    let protocol = &found.protocol;
    let mut text = format!(
        "# {}: {} presses, {:.1} min\n\nSkin `{}`: {}.\n",
        protocol.name, found.presses, found.minutes, protocol.skin, protocol.description
    );
    if !found.separations.is_empty() {
        text.push_str(&separations(found));
    }
    if let Some(unknown) = found.unknown {
        let _ = writeln!(
            text,
            "\n{:.0} % of the time asks what no known effect explains: does it come again (the same press again), and where is it \
             (locations that were not pressed yet).",
            100.0 * unknown
        );
    }
    let _ = writeln!(text, "\nTips: {}.\n", tips(protocol));
    tables(&mut text, protocol);
    let _ = write!(
        text,
        "\nPlaces are in the frame of the skin's link, forces along the inward normal. Record readings, place, force, tip and session the whole \
         time, the pauses included, as one bag.\n"
    );
    match found.unknown {
        None => {
            let _ = write!(
                text,
                "Do it twice, the second time after the skin was switched off, or mounted anew: the same locations in two sessions tell what a \
                 session changes.\n\n```\ndermis collect SKIN --plan {plan} --out BAG      # on the model\n\
                 dermis gap diagnose --skin SKIN --real BAG --and BAG2 --out DIR\n```\n"
            );
        }
        Some(_) => {
            let _ = write!(
                text,
                "\n```\ndermis collect SKIN --plan {plan} --out BAG2     # on the model\n\
                 dermis gap diagnose --skin SKIN --real BAG --and BAG2 --out DIR\n```\n"
            );
        }
    }
    text
}

/// The tips that a protocol needs.
fn tips(protocol: &Protocol) -> String {
    let mut tips: Vec<f64> = protocol.steps.iter().filter(|s| !s.at.is_empty()).map(|s| s.tip).collect();
    tips.sort_by(f64::total_cmp);
    tips.dedup();
    let shape = match protocol.tip {
        dermis_skin::TipKind::Sphere => "ball",
        dermis_skin::TipKind::FlatPunch => "flat punch",
    };
    let sizes: Vec<String> = tips.iter().map(|t| format!("a {shape} of {} mm", mm(*t))).collect();
    sizes.join(", ")
}

/// The table of steps and that of the locations that they number.
fn tables(text: &mut String, protocol: &Protocol) {
    let mut locations: Vec<[f64; 3]> = Vec::new();
    let mut number = |at: &[f64; 3]| match locations.iter().position(|p| p == at) {
        Some(index) => index + 1,
        None => {
            locations.push(*at);
            locations.len()
        }
    };
    text.push_str(
        "| step | what | locations | forces [N] | times | tip [mm] | load, hold, let go, rest [s] | presses | min | for |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (index, step) in protocol.steps.iter().enumerate() {
        let [load, hold, unload, rest] = step.seconds;
        if step.at.is_empty() {
            let _ = writeln!(
                text,
                "| {} | {} | | | | | {rest} s | | {:.1} | {} |",
                index + 1,
                step.what,
                step.minutes(),
                step.why
            );
            continue;
        }
        let numbers: Vec<String> = step.at.iter().map(|at| number(at).to_string()).collect();
        let forces: Vec<String> = step.forces.iter().map(f64::to_string).collect();
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {load}, {hold}, {unload}, {rest} | {} | {:.1} | {} |",
            index + 1,
            step.what,
            numbers.join(" "),
            forces.join(" "),
            step.repeats,
            mm(step.tip),
            step.presses(),
            step.minutes(),
            step.why
        );
    }
    text.push_str("\n| place | x [mm] | y [mm] | z [mm] |\n|---|---|---|---|\n");
    for (index, [x, y, z]) in locations.iter().enumerate() {
        let _ = writeln!(text, "| {} | {} | {} | {} |", index + 1, mm(*x), mm(*y), mm(*z));
    }
}

/// What tells what apart.
fn separations(found: &Planned) -> String {
    let mut text = String::from("\n| between | confused before | after | by |\n|---|---|---|---|\n");
    for of in &found.separations {
        let [a, b] = &of.between;
        let by = match (of.one_thing, of.by) {
            (true, _) => "no press of this rig: two names of one thing here",
            (false, Some(kind)) => kind.name(),
            (false, None) => "-",
        };
        let after = if of.one_thing {
            "-".to_owned()
        } else {
            format!("{}{}", probability(of.p_after), if settles(of.p_after) { ", settled" } else { "" })
        };
        let _ = writeln!(text, "| {a} or {b} | {} | {after} | {by} |", probability(of.p_before));
    }
    text
}
