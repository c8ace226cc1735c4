//! A report that a browser shows without anything else: tables, error map, truth against estimate, examples of maps.

mod maps;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use dermis_figures::{Axes, Curve, Dots, RGBColor, Segment, dots, escape, figure, histogram, page, segments};

use crate::dataset::{Dataset, Run, Truth};
use crate::evaluate::Evaluation;
use crate::metrics::Answer;
use crate::{LearnError, SplitConfig, card};

/// Most points drawn in one picture; more are thinned out evenly.
const MOST_POINTS: usize = 4000;
/// \[pixels\] of a picture that is not a map.
const SIZE: (u32, u32) = (430, 430);

/// One compared sample.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Point {
    /// \[m\] true and estimated x and y.
    pub position: Option<([f64; 2], [f64; 2])>,
    /// \[N\] true and estimated normal force.
    pub force: Option<(f64, f64)>,
}

impl Point {
    /// What of an answer can be drawn.
    #[must_use]
    pub fn new(truth: &Truth, answer: &Answer) -> Self {
        let at = truth.value("position.x").zip(truth.value("position.y"));
        Self {
            position: at.zip(answer.position).map(|((x, y), p)| ([x, y], [p[0], p[1]])),
            force: truth.value("force.normal").zip(answer.normal_force),
        }
    }
}

/// Collects sections of an HTML file.
#[derive(Debug, Clone)]
pub struct Report {
    title: String,
    body: String,
}

impl Report {
    /// An empty report.
    #[must_use]
    pub fn new(title: String) -> Self {
        Self { title, body: String::new() }
    }

    /// Adds figures and pictures under a heading.
    ///
    /// # Errors
    ///
    /// [`LearnError::Figure`] where a picture cannot be drawn.
    pub fn section(
        &mut self,
        heading: &str,
        evaluation: &Evaluation,
        points: &[Point],
    ) -> Result<(), LearnError> {
        let _ = writeln!(
            self.body,
            "<h2>{}</h2>\n<pre>{}</pre>",
            escape(heading),
            escape(&evaluation.to_string())
        );
        let positions: Vec<_> = thin(points).filter_map(|p| p.position).collect();
        let mut pictures = Vec::new();
        if !positions.is_empty() {
            pictures.push(error_map(&positions)?);
        }
        let forces: Vec<_> = thin(points).filter_map(|p| p.force).collect();
        if !forces.is_empty() {
            pictures.push(scatter(forces)?);
        }
        if !pictures.is_empty() {
            let caption =
                "Estimates against the ground truth: positions and normal forces, as far as there are any.";
            self.body.push_str(&figure(&pictures, caption));
        }
        self.body.push_str(&maps::of_maps(evaluation)?);
        Ok(())
    }

    /// Adds what the data are: a table of the recordings, where and how hard the skin was pressed, what was noticed.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where a bag cannot be read once more, or a picture cannot be drawn.
    pub fn data(&mut self, data: &Dataset, split: Option<&SplitConfig>) -> Result<(), LearnError> {
        let skin = data.skin();
        let _ = write!(
            self.body,
            "<h2>Data</h2>\n<p>Skin {} ({} channels in {}, {} Hz), {} locations. Data hash <code>{}</code>.{}</p>\n\
             <table><tr><th>recording</th><th>session</th><th>frames</th><th>with truth</th><th>lost</th>\
             <th>zero taken</th><th>noise, median of channels [{}]</th><th>force sensor bias and noise [N]</th></tr>\n",
            escape(&skin.name),
            skin.channels().len(),
            escape(&skin.unit),
            skin.rate,
            data.locations(),
            data.hash(),
            split.map_or_else(String::new, |s| format!(" Held out: {}.", escape(&s.describe()))),
            escape(&skin.unit)
        );
        for (index, run) in data.runs().iter().enumerate() {
            let noise = card::noise(data, index)?.and_then(|n| n["median"].as_f64());
            let bias = run
                .bias
                .map(|b| format!("{:.3}, {:.3}, {:.3}; {:.4}", b.mean[0], b.mean[1], b.mean[2], b.noise));
            let _ = writeln!(
                self.body,
                "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                escape(&run.path.file_name().unwrap_or_default().to_string_lossy()),
                escape(&run.session),
                frames(run),
                run.samples.iter().filter(|s| s.truth.is_some()).count(),
                run.lost,
                run.tares(),
                noise.map_or_else(|| "unknown".to_owned(), |n| format!("{n:.3}")),
                bias.unwrap_or_else(|| "ground truth is ours".to_owned()),
            );
        }
        self.body.push_str("</table>\n");
        let pictures: Vec<String> =
            [location_map(data, split)?, force_histogram(data)?].into_iter().flatten().collect();
        if !pictures.is_empty() {
            let caption = "Pressed locations, larger where they were pressed harder, and touched frames by normal force.";
            self.body.push_str(&figure(&pictures, caption));
        }
        let notices = data.notices();
        if !notices.is_empty() {
            let items: String = notices.iter().map(|n| format!("<li>{}</li>", escape(n))).collect();
            let _ = writeln!(self.body, "<ul>{items}</ul>");
        }
        if let Some(map) = data.map().and_then(|m| serde_json::to_string_pretty(m).ok()) {
            let _ = writeln!(
                self.body,
                "<details><summary>Map of the labels</summary><pre>{}</pre></details>",
                escape(&map)
            );
        }
        Ok(())
    }

    /// The file.
    #[must_use]
    pub fn html(&self) -> String {
        page(&self.title, &self.body)
    }
}

/// How many frames a run has, and how many of them are used where those are fewer.
fn frames(run: &Run) -> String {
    match (run.frames(), run.samples.len()) {
        (all, used) if used < all => format!("{all} ({used} used)"),
        (all, _) => all.to_string(),
    }
}

fn thin(points: &[Point]) -> impl Iterator<Item = &Point> {
    points.iter().step_by(dermis_regress::stride(points.len(), MOST_POINTS))
}

/// Every pressed location once, larger where it was pressed harder; those that are held out in another colour.
fn location_map(data: &Dataset, split: Option<&SplitConfig>) -> Result<Option<String>, LearnError> {
    let mut locations: BTreeMap<(u32, bool), ((f64, f64), f64)> = BTreeMap::new();
    for run in data.runs() {
        let marks = split.map(|s| s.mark(run));
        for (i, truth) in run.samples.iter().enumerate().filter_map(|(i, s)| Some((i, s.truth.as_ref()?))) {
            let Some((x, y)) = truth.value("position.x").zip(truth.value("position.y")) else { continue };
            let held_out = marks.as_ref().is_some_and(|m| m[i] == Some(true));
            let force = truth.value("force.normal").unwrap_or(0.0);
            let place = locations.entry((truth.location, held_out)).or_insert(((x * 1e3, y * 1e3), force));
            place.1 = place.1.max(force);
        }
    }
    if locations.is_empty() {
        return Ok(None);
    }
    let most = locations.values().map(|(_, force)| *force).fold(1e-9, f64::max);
    let mut groups = [Dots::new("to learn from", 0, Vec::new()), Dots::new("held out", 1, Vec::new())];
    for ((_, held_out), (at, force)) in
        locations.iter().step_by(dermis_regress::stride(locations.len(), MOST_POINTS))
    {
        let group = &mut groups[usize::from(*held_out)];
        group.points.push(*at);
        group.sizes.push(force / most);
    }
    if split.is_none() {
        // Nothing to tell apart.
        groups.iter_mut().for_each(|group| group.name.clear());
    }
    let axes =
        Axes::new("pressed locations", "x [mm]", "y [mm]").equal(locations.values().map(|(at, _)| *at));
    Ok(Some(dots(&axes, &groups, &[])?))
}

/// Touched frames by normal force, a bar for each range.
fn force_histogram(data: &Dataset) -> Result<Option<String>, LearnError> {
    let bins = card::histogram(data);
    let bins: Vec<(f64, f64)> =
        bins.iter().filter_map(|b| b["from"].as_f64().zip(b["frames"].as_f64())).collect();
    if bins.is_empty() {
        return Ok(None);
    }
    let axes = Axes { size: SIZE, ..Axes::new("touched frames", "normal force [N], from", "frames") };
    Ok(Some(histogram(&axes, &bins)?))
}

/// A line from each true position to its estimate; its colour is the error.
fn error_map(points: &[([f64; 2], [f64; 2])]) -> Result<String, LearnError> {
    let mm = |p: [f64; 2]| (p[0] * 1e3, p[1] * 1e3);
    let pairs: Vec<Segment> = points.iter().map(|(truth, estimate)| [mm(*truth), mm(*estimate)]).collect();
    let errors: Vec<f64> = pairs.iter().map(|[a, b]| (a.0 - b.0).hypot(a.1 - b.1)).collect();
    // Of the surface: an estimate far off would make it small.
    let axes = Axes::new("true position, line to the estimate", "x [mm]", "y [mm]")
        .equal(pairs.iter().map(|[truth, _]| *truth));
    Ok(segments(&axes, "error [mm]", &pairs, &errors)?)
}

fn scatter(points: Vec<(f64, f64)>) -> Result<String, LearnError> {
    let both = points.iter().flat_map(|(truth, estimate)| [(*truth, *truth), (*estimate, *estimate)]);
    let axes = Axes::new("normal force", "true [N]", "estimate [N]").equal(both);
    let ends: Vec<(f64, f64)> = axes.x_range.into_iter().flat_map(|(a, b)| [(a, a), (b, b)]).collect();
    let line = Curve { colour: RGBColor(160, 160, 160), ..Curve::new("", 0, ends) };
    Ok(dots(&axes, &[Dots::new("", 0, points)], &[line])?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Scores;

    #[test]
    fn a_report_shows_every_sample() {
        let points = [
            Point { position: Some(([0.0, 0.0], [0.001, 0.0])), force: Some((1.0, 1.2)) },
            Point { position: Some(([0.01, 0.01], [0.01, 0.011])), force: Some((3.0, 2.9)) },
            Point { position: None, force: Some((0.0, 0.0)) },
        ];
        let mut report = Report::new("a < b".into());
        report.section("held out", &Evaluation::of(&Scores::default(), "x", 3, 0, 0), &points).unwrap();
        let html = report.html();
        assert_eq!(html.matches("<svg").count(), 2);
        assert_eq!(html.matches("<circle").count(), 5);
        let data = crate::dataset::tests::presses(20, 2);
        report.data(&data, Some(&SplitConfig::default())).unwrap();
        let html = report.html();
        assert_eq!(html.matches("<svg").count(), 4);
        assert_eq!(html.matches("<circle").count(), 5 + 20 + 2, "one for each location, and the legend");
        // Locations that are held out, and their entry in the legend.
        assert!(html.matches("fill=\"#D55E00\"").count() > 1 && html.contains("held out"));
        assert!(html.contains("a &lt; b") && !html.contains("NaN"));
    }
}
