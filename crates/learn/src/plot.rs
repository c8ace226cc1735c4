//! A report that a browser shows without anything else: tables, error map, truth against estimate.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::dataset::{Dataset, Truth};
use crate::evaluate::Evaluation;
use crate::metrics::Answer;
use crate::{SplitConfig, card};

/// Most points drawn in one picture; more are thinned out evenly.
const MOST_POINTS: usize = 4000;
const SIZE: f64 = 460.0;
const MARGIN: f64 = 48.0;

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
    pub fn section(&mut self, heading: &str, evaluation: &Evaluation, points: &[Point]) {
        let _ = write!(
            self.body,
            "<h2>{}</h2>\n<pre>{}</pre>\n<div>",
            escape(heading),
            escape(&evaluation.to_string())
        );
        let positions: Vec<_> = thin(points).filter_map(|p| p.position).collect();
        if !positions.is_empty() {
            self.body.push_str(&error_map(&positions));
        }
        let forces: Vec<_> = thin(points).filter_map(|p| p.force).collect();
        if !forces.is_empty() {
            self.body.push_str(&scatter(&forces));
        }
        self.body.push_str("</div>\n");
    }

    /// Adds what the data are: a table of the recordings, where and how hard the skin was pressed, what was noticed.
    ///
    /// # Errors
    ///
    /// [`LearnError`](crate::LearnError) where a bag cannot be read once more.
    pub fn data(&mut self, data: &Dataset, split: Option<&SplitConfig>) -> Result<(), crate::LearnError> {
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
                run.samples.len(),
                run.samples.iter().filter(|s| s.truth.is_some()).count(),
                run.lost,
                run.samples.iter().filter(|s| s.tare).count(),
                noise.map_or_else(|| "unknown".to_owned(), |n| format!("{n:.3}")),
                bias.unwrap_or_else(|| "ground truth is ours".to_owned()),
            );
        }
        self.body.push_str("</table>\n<div>");
        self.body.push_str(&location_map(data, split));
        self.body.push_str(&force_histogram(data));
        self.body.push_str("</div>\n");
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
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\n\
             <style>body{{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;\
             color:#222;background:#fff}}pre{{background:#f4f4f2;padding:1rem;overflow-x:auto;font-size:12px}}\
             table{{border-collapse:collapse;font-size:13px}}td,th{{border:1px solid #ccc;padding:.2rem .5rem;\
             text-align:left}}svg{{max-width:100%}}svg text{{font:11px system-ui,sans-serif;fill:#444}}</style></head>\n\
             <body><h1>{title}</h1>\n{body}</body></html>\n",
            title = escape(&self.title),
            body = self.body
        )
    }
}

fn thin(points: &[Point]) -> impl Iterator<Item = &Point> {
    points.iter().step_by(points.len().div_ceil(MOST_POINTS).max(1))
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Maps a range of values to pixels.
#[derive(Clone, Copy)]
struct Axis {
    low: f64,
    high: f64,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter(|v| v.is_finite()) {
            (low, high) = (low.min(v), high.max(v));
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let pad = ((high - low) * 0.04).max(1e-9);
        Self { low: low - pad, high: high + pad }
    }

    fn at(self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low) * (SIZE - 2.0 * MARGIN) + MARGIN
    }

    fn up(self, value: f64) -> f64 {
        SIZE - self.at(value)
    }

    /// About five round numbers in the range.
    fn ticks(self) -> Vec<f64> {
        if self.high <= self.low {
            return Vec::new();
        }
        let rough = (self.high - self.low) / 5.0;
        let power = 10.0_f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough).unwrap_or(rough);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

fn frame(svg: &mut String, x: Axis, y: Axis, labels: [&str; 2]) {
    let (low, high) = (MARGIN, SIZE - MARGIN);
    let _ = write!(
        svg,
        "<svg viewBox=\"0 0 {SIZE} {SIZE}\" width=\"{SIZE}\" height=\"{SIZE}\" role=\"img\">\
         <path d=\"M{low} {low}V{high}H{high}\" fill=\"none\" stroke=\"#888\"/>"
    );
    for tick in x.ticks() {
        let at = x.at(tick);
        let _ = write!(
            svg,
            "<path d=\"M{at:.1} {high}v4\" stroke=\"#888\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            high + 16.0,
            number(tick)
        );
    }
    for tick in y.ticks() {
        let at = y.up(tick);
        let _ = write!(
            svg,
            "<path d=\"M{low} {at:.1}h-4\" stroke=\"#888\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            low - 7.0,
            at + 4.0,
            number(tick)
        );
    }
    let middle = SIZE / 2.0;
    let _ = write!(
        svg,
        "<text x=\"{middle}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
         <text transform=\"translate(13 {middle}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        SIZE - 8.0,
        labels[0],
        labels[1]
    );
}

fn number(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    format!("{}", if rounded == 0.0 { 0.0 } else { rounded })
}

/// Every pressed location once, larger where it was pressed harder; those that are held out in another colour.
fn location_map(data: &Dataset, split: Option<&SplitConfig>) -> String {
    let mut places: BTreeMap<(u32, bool), ([f64; 2], f64)> = BTreeMap::new();
    for run in data.runs() {
        let marks = split.map(|s| s.mark(run));
        for (i, truth) in run.samples.iter().enumerate().filter_map(|(i, s)| Some((i, s.truth.as_ref()?))) {
            let Some((x, y)) = truth.value("position.x").zip(truth.value("position.y")) else { continue };
            let held_out = marks.as_ref().is_some_and(|m| m[i] == Some(true));
            let force = truth.value("force.normal").unwrap_or(0.0);
            let place = places.entry((truth.location, held_out)).or_insert(([x * 1e3, y * 1e3], force));
            place.1 = place.1.max(force);
        }
    }
    if places.is_empty() {
        return String::new();
    }
    let half = |axis: usize| {
        let all = Axis::over(places.values().map(|(p, _)| p[axis]));
        ((all.low + all.high) / 2.0, (all.high - all.low) / 2.0)
    };
    let ((cx, hx), (cy, hy)) = (half(0), half(1));
    let reach = hx.max(hy);
    let (x, y) = (Axis { low: cx - reach, high: cx + reach }, Axis { low: cy - reach, high: cy + reach });
    let most = places.values().map(|(_, f)| *f).fold(1e-9, f64::max);
    let mut svg = String::new();
    frame(&mut svg, x, y, ["x [mm]", "y [mm]: pressed locations, held-out ones red"]);
    for ((_, held_out), (at, force)) in places.iter().step_by(places.len().div_ceil(MOST_POINTS).max(1)) {
        let _ = write!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{}\" fill-opacity=\"0.6\"/>",
            x.at(at[0]),
            y.up(at[1]),
            1.2 + 2.5 * (force / most).sqrt(),
            if *held_out { "#c0392b" } else { "#4682b4" }
        );
    }
    svg + "</svg>\n"
}

/// Touched frames by normal force, a bar for each range.
fn force_histogram(data: &Dataset) -> String {
    let bins = card::histogram(data);
    let most = bins.iter().filter_map(|b| b["frames"].as_f64()).fold(0.0, f64::max);
    if most == 0.0 {
        return String::new();
    }
    let y = Axis { low: 0.0, high: most * 1.05 };
    let mut svg = String::new();
    frame(&mut svg, Axis { low: 0.0, high: 0.0 }, y, ["normal force [N], from", "touched frames"]);
    let width = (SIZE - 2.0 * MARGIN) / bins.len() as f64;
    for (i, bin) in bins.iter().enumerate() {
        let (left, top) = (MARGIN + i as f64 * width, y.up(bin["frames"].as_f64().unwrap_or(0.0)));
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#4682b4\"/>\
             <text x=\"{left:.1}\" y=\"{:.1}\">{}</text>",
            left + 1.0,
            width - 2.0,
            SIZE - MARGIN - top,
            SIZE - MARGIN + 16.0,
            bin["from"]
        );
    }
    svg + "</svg>\n"
}

/// A line from each true position to its estimate; darker where the error is larger.
fn error_map(points: &[([f64; 2], [f64; 2])]) -> String {
    let mm = |v: f64| v * 1e3;
    // One scale for both axes, so that distances are true.
    let both = |axis: usize| Axis::over(points.iter().map(move |(t, _)| mm(t[axis])));
    let (x, y) = (both(0), both(1));
    let half = (x.high - x.low).max(y.high - y.low) / 2.0;
    let square = |a: Axis| Axis { low: (a.low + a.high) / 2.0 - half, high: (a.low + a.high) / 2.0 + half };
    let (x, y) = (square(x), square(y));
    let mut errors: Vec<f64> = points.iter().map(|(t, e)| (t[0] - e[0]).hypot(t[1] - e[1])).collect();
    let mut svg = String::new();
    frame(&mut svg, x, y, ["x [mm]", "y [mm]: true position, line to the estimate"]);
    let drawn: Vec<f64> = errors.clone();
    errors.sort_by(f64::total_cmp);
    let bad = errors.get(errors.len() * 95 / 100).copied().unwrap_or(1.0).max(1e-12);
    for ((t, e), error) in points.iter().zip(drawn) {
        let share = (error / bad).min(1.0);
        let (red, green, blue) = (70.0 + 150.0 * share, 130.0 - 90.0 * share, 180.0 - 140.0 * share);
        let _ = write!(
            svg,
            "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" stroke=\"rgb({red:.0},{green:.0},{blue:.0})\"/>\
             <circle cx=\"{0:.1}\" cy=\"{1:.1}\" r=\"1.6\" fill=\"rgb({red:.0},{green:.0},{blue:.0})\"/>",
            x.at(mm(t[0])),
            y.up(mm(t[1])),
            x.at(mm(e[0])),
            y.up(mm(e[1])),
        );
    }
    svg + "</svg>\n"
}

fn scatter(points: &[(f64, f64)]) -> String {
    let axis = Axis::over(points.iter().flat_map(|(t, e)| [*t, *e]));
    let mut svg = String::new();
    frame(&mut svg, axis, axis, ["true normal force [N]", "estimate [N]"]);
    let (low, high) = (axis.low, axis.high);
    let _ = write!(
        svg,
        "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" stroke=\"#bbb\"/>",
        axis.at(low),
        axis.up(low),
        axis.at(high),
        axis.up(high)
    );
    for (truth, estimate) in points {
        let _ = write!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"1.6\" fill=\"#4682b4\" fill-opacity=\"0.6\"/>",
            axis.at(*truth),
            axis.up(*estimate)
        );
    }
    svg + "</svg>\n"
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
        report.section("held out", &Evaluation::of(&Scores::default(), "x", 3, 0, 0), &points);
        let html = report.html();
        assert_eq!(html.matches("<svg").count(), 2);
        assert_eq!(html.matches("<circle").count(), 5);
        let data = crate::dataset::tests::presses(20, 2);
        report.data(&data, Some(&SplitConfig::default())).unwrap();
        let html = report.html();
        assert_eq!(html.matches("<svg").count(), 4);
        assert_eq!(html.matches("<circle").count(), 5 + 20, "one for each location");
        assert!(html.matches("#c0392b").count() > 0 && html.contains("<rect"));
        assert!(html.contains("a &lt; b") && !html.contains("NaN"));
    }

    #[test]
    fn ticks_are_round_and_inside() {
        for (low, high) in [(0.0, 30.0), (-1.3, 0.2), (274.0, 304.0), (0.0, 0.004)] {
            let ticks = Axis { low, high }.ticks();
            assert!((2..=6).contains(&ticks.len()), "{ticks:?}");
            assert!(ticks.iter().all(|t| *t >= low - 1e-12 && *t <= high + 1e-12), "{ticks:?}");
        }
    }
}
