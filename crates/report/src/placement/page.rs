//! The page: figures in the manner of the thesis' Figs. 2.3 and 2.5.

use std::fmt::Write as _;

use anyhow::Result;
use dermis_figures::{Axes, COLOURS, Curve, Kind, Pen, RGBColor, curves, escape, figure, kinds, page};
use dermis_studies::flat::laid_flat;
use dermis_studies::placement::{Choice, Findings, faster};
use dermis_theory::placement::{Method, Verdict};
use nalgebra::Point3;

use super::text::{seconds, taxels};

/// Colour of a skin below its elements.
const GROUND: RGBColor = RGBColor(215, 222, 230);

/// Colour of a method: the same in all figures.
fn colour(method: Method) -> usize {
    Method::ALL.iter().position(|m| *m == method).unwrap_or_default()
}

fn flat(findings: &Findings, points: &[Point3<f64>]) -> (Vec<(f64, f64)>, [&'static str; 2]) {
    laid_flat(&findings.skin, &findings.surface, points)
}

/// The whole page.
///
/// # Errors
///
/// Where a figure cannot be drawn.
pub fn html(findings: &Findings, text: &str) -> Result<String> {
    let mut body = format!("<pre>{}</pre>\n", escape(text));
    locations(&mut body, findings)?;
    errors(&mut body, findings)?;
    elements(&mut body, findings);
    Ok(page(&format!("{}: where to put sensing elements", findings.skin.name), &body))
}

/// Size of figures, so that two with their legends stand beside each other on a page.
const SIZE: (u32, u32) = (430, 320);

/// A map that keeps the shape of the skin.
fn map(findings: &Findings, title: String, cells: &[Kind], marks: &Kind) -> Result<String> {
    let (all, [x, y]) = flat(findings, &findings.surface.points);
    let span = |of: fn(&(f64, f64)) -> f64| {
        let ends =
            all.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let room = 0.04 * (ends.1 - ends.0).max(1e-3);
        (ends.0 - room, ends.1 + room)
    };
    let (x_range, y_range) = (span(|p| p.0), span(|p| p.1));
    let width = f64::from(SIZE.0);
    let height =
        ((width - 94.0) * (y_range.1 - y_range.0) / (x_range.1 - x_range.0) + 80.0).clamp(140.0, 700.0);
    let axes = Axes {
        x_range: Some(x_range),
        y_range: Some(y_range),
        size: (SIZE.0, height as u32),
        ..Axes::new(title, x, y)
    };
    Ok(kinds(&axes, cells, marks)?)
}

fn locations(body: &mut String, findings: &Findings) -> Result<()> {
    let cells = |name: &str, colour: RGBColor, points: &[Point3<f64>]| Kind {
        name: name.into(),
        points: flat(findings, points).0,
        colour,
    };
    let feet = |wanted: Verdict| -> Vec<Point3<f64>> {
        findings.feet.iter().filter(|(_, v)| *v == wanted).map(|(p, _)| *p).collect()
    };
    let few: Vec<Point3<f64>> =
        findings.reduction.chosen.iter().map(|c| findings.candidate_locations[*c]).collect();
    let all = [
        (cells("at an edge", COLOURS[4], &feet(Verdict::Edge)), findings.counts.edge),
        (cells("close to a support", COLOURS[5], &feet(Verdict::Held)), findings.counts.held),
        (cells("can be built", GROUND, &feet(Verdict::Feasible)), findings.counts.feasible),
    ];
    let all: Vec<Kind> = all.into_iter().filter(|(_, count)| *count > 0).map(|(kind, _)| kind).collect();
    let feasible = map(findings, "candidates".into(), &all, &cells("tells the others", COLOURS[6], &few))?;
    let left = findings.reduction.unexplained.iter().map(|(n, share)| (*n as f64, 100.0 * share)).collect();
    let axes = Axes {
        log_y: true,
        size: SIZE,
        ..Axes::new("candidates that tell the others", "number", "unexplained variance [%]")
    };
    let reduction = curves(&axes, &[Curve::new("", 0, left)])?;
    body.push_str("<h2>Candidates</h2>\n");
    body.push_str(&figure(
        &[feasible, reduction],
        "<b>Where an element could be.</b> Each cell of <i>candidates</i> is one; dots are those whose readings tell all others up \
         to the unexplained variance, among which greedy-svr searches. <i>Candidates that tell the others</i> shows that variance \
         by their number. Thesis Fig. 2.3.",
    ));
    let maps = findings
        .choices
        .iter()
        .map(|choice| {
            let locations: Vec<Point3<f64>> =
                choice.sets.last().iter().map(|c| findings.candidate_locations[*c]).collect();
            let title = format!("{}, {}", choice.method.name(), seconds(choice.seconds));
            let ground = cells("", GROUND, &findings.surface.points);
            map(findings, title, &[ground], &cells("", COLOURS[colour(choice.method)], &locations))
        })
        .collect::<Result<Vec<_>>>()?;
    body.push_str("<h2>Elements</h2>\n");
    body.push_str(&figure(
        &maps,
        "<b>The elements of every method</b> on the skin laid flat, and how long the search took. Thesis Fig. 2.5 a.",
    ));
    Ok(())
}

/// A curve with its interval as thin lines around it.
fn with_interval(choice: &Choice, points: &[(f64, f64, f64)]) -> [Curve; 3] {
    let n = colour(choice.method);
    let side = |sign: f64| {
        let shown = points.iter().map(|(x, y, i)| (*x, (y + sign * i).max(1e-3))).collect();
        Curve::new("", n, shown).pen(Pen::Dashed)
    };
    let middle = points.iter().map(|(x, y, _)| (*x, *y)).collect();
    [Curve::new(choice.method.name(), n, middle), side(1.0), side(-1.0)]
}

fn errors(body: &mut String, findings: &Findings) -> Result<()> {
    let (mut count, mut bound, mut failures, mut untaught) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for choice in &findings.choices {
        let (evaluation, n) = (&choice.evaluation, colour(choice.method));
        let with = |at: usize, mean: f64, interval: f64| (at as f64, mean * 1e3, interval * 1e3);
        let by: Vec<_> = evaluation.by_count.iter().map(|c| with(c.elements, c.mean, c.interval)).collect();
        count.extend(with_interval(choice, &by));
        let least =
            evaluation.by_count.iter().filter_map(|c| Some((c.elements as f64, c.bound? * 1e3))).collect();
        bound.push(Curve::new(choice.method.name(), n, least));
        let by: Vec<_> = evaluation.by_failures.iter().map(|f| with(f.failed, f.mean, f.interval)).collect();
        failures.extend(with_interval(choice, &by));
        let by = evaluation.by_failures.iter().map(|f| (f.failed as f64, f.untaught * 1e3)).collect();
        untaught.push(Curve::new(choice.method.name(), n, by));
    }
    let axes = |title: &str, x: &str, log_y: bool| Axes {
        log_y,
        size: SIZE,
        ..Axes::new(title, x, "position error [mm]")
    };
    body.push_str("<h2>What they are worth</h2>\n");
    body.push_str(&figure(
        &[
            curves(&axes("support vector regression", "elements", true), &count)?,
            curves(&axes("Cramér–Rao bound", "elements", true), &bound)?,
        ],
        "<b>Error against the number of elements</b> at locations that neither the search nor the estimator saw, mean and 95 % \
         interval over noises and divisions; and what the noise alone would leave. Thesis Fig. 2.5 b.",
    ));
    if failures.iter().any(|c| c.points.len() > 1) {
        body.push_str(&figure(
            &[
                curves(&axes("taught anew", "failed elements", false), &failures)?,
                curves(&axes("not taught anew", "failed elements", false), &untaught)?,
            ],
            "<b>Error once elements fail</b>, drawn at random, the same positions of every method. <i>Taught anew</i>: an estimator that \
             learns from those that are left, as on the device of the thesis, whose tenth gauge was dead. <i>Not taught anew</i>: the \
             estimator of all, which gets the mean of a failed one in place of its readings. Thesis Fig. 2.5 c.",
        ));
    }
    Ok(())
}

fn elements(body: &mut String, findings: &Findings) {
    body.push_str("<h2>For a skin file</h2>\n");
    for choice in &findings.choices {
        let _ = writeln!(body, "<pre>{}</pre>", escape(&taxels(choice, &findings.skin.name)));
    }
    if let Some(times) = faster(&findings.choices) {
        let _ = writeln!(body, "<p>crlb searches {times:.0} times as fast as greedy-svr.</p>");
    }
}
