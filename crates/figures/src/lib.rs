//! Figures as SVG text: curves, maps over two axes, maps of a surface; and the pages that hold them.
//!
//! The one place of this workspace where figures for people are drawn.

mod scale;
mod surface;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use plotters::style::RGBColor;

use scale::{BAR, Scale};
pub use surface::{surface, surface_within};

/// Colours that differ also for eyes that see red and green alike.
pub const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(60, 60, 60),
];

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Pen {
    /// Unbroken.
    #[default]
    Line,
    /// Broken.
    Dashed,
    /// Small dots.
    Dots,
    /// Larger dots.
    Mark,
}

/// One curve. Points that are not finite break it.
#[derive(Debug, Clone, Default)]
pub struct Curve {
    /// Empty: it has no entry in the legend.
    pub name: String,
    /// In the units of the axes.
    pub points: Vec<(f64, f64)>,
    /// Its colour.
    pub colour: RGBColor,
    /// How it is drawn.
    pub pen: Pen,
}

impl Curve {
    /// A line of the n-th colour.
    pub fn new(name: impl Into<String>, n: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, colour: COLOURS[n % COLOURS.len()], pen: Pen::Line }
    }

    /// The same curve with another pen.
    #[must_use]
    pub fn pen(self, pen: Pen) -> Self {
        Self { pen, ..self }
    }
}

/// Axes of a figure.
#[derive(Debug, Clone, Default)]
pub struct Axes {
    /// Above the axes.
    pub title: String,
    /// Label of the axis to the right, with its unit.
    pub x: String,
    /// Label of the axis upwards, with its unit.
    pub y: String,
    /// Whether it is logarithmic.
    pub log_x: bool,
    /// Whether it is logarithmic.
    pub log_y: bool,
    /// What is shown of either axis; all of the data where absent.
    pub x_range: Option<(f64, f64)>,
    /// As `x_range`.
    pub y_range: Option<(f64, f64)>,
    /// \[pixels\] without the legend; 520 × 340 where 0.
    pub size: (u32, u32),
}

impl Axes {
    /// Linear axes of the usual size.
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Self { title: title.into(), x: x.into(), y: y.into(), ..Self::default() }
    }

    fn size(&self) -> (u32, u32) {
        if self.size.0 == 0 { (520, 340) } else { self.size }
    }
}

/// An axis that knows its ticks.
#[derive(Clone)]
struct Scaled {
    low: f64,
    high: f64,
    ticks: Vec<f64>,
}

impl Scaled {
    fn new(low: f64, high: f64, log: bool) -> Self {
        Self { low, high, ticks: ticks(low, high, log) }
    }
}

impl Ranged for Scaled {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.low) / (self.high - self.low);
        limit.0 + (f64::from(limit.1 - limit.0) * share).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _hint: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.low..self.high
    }
}

/// A figure that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("a figure cannot be drawn: {0}")]
pub struct DrawError(String);

type Result<T, E = DrawError> = std::result::Result<T, E>;
type Failure = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Result<(), Failure>) -> Result<String> {
    let mut text = String::new();
    let all = || -> Result<(), Failure> {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root)?;
        root.present()?;
        Ok(())
    };
    all().map_err(|e| DrawError(e.to_string()))?;
    Ok(text)
}

/// Value → where it is drawn: its logarithm on a logarithmic axis.
fn place(value: f64, log: bool) -> f64 {
    if log { value.log10() } else { value }
}

/// A number as a tick shows it: three digits that say something.
#[must_use]
pub fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Round numbers between two places of an axis.
fn ticks(low: f64, high: f64, log: bool) -> Vec<f64> {
    let round = |step: f64| -> Vec<f64> {
        let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
        (first..=last).map(|i| i as f64 * step).collect()
    };
    let span = high - low;
    if !(span.is_finite() && span > 0.0) {
        return vec![low];
    }
    if log {
        let parts: &[f64] = match span {
            s if s < 1.2 => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
            s if s < 2.5 => &[1.0, 2.0, 5.0],
            s if s < 4.5 => &[1.0, 3.0],
            _ => &[1.0],
        };
        let decades = low.floor() as i32..=high.ceil() as i32;
        let found: Vec<f64> = decades
            .flat_map(|d| parts.iter().map(move |p| f64::from(d) + p.log10()))
            .filter(|v| (low..=high).contains(v))
            .collect();
        // Within less than a half of a decade even steps say more.
        if span > 0.35 && found.len() > 2 {
            return found;
        }
        let (from, to) = (10f64.powf(low), 10f64.powf(high));
        return ticks(from, to, false).into_iter().filter(|v| *v > 0.0).map(f64::log10).collect();
    }
    let rough = 10f64.powf((span / 6.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * rough).find(|s| span / s <= 7.5);
    round(step.unwrap_or(span))
}

fn tick(value: f64, log: bool) -> String {
    if log && value < -3.9 {
        format!("{:.0e}", 10f64.powf(value))
    } else if log {
        let shown = 10f64.powf(value);
        let digits = (1 - shown.log10().floor() as i32).clamp(0, 9) as usize;
        let text = format!("{shown:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    } else if value.abs() < 1e-12 {
        "0".to_owned()
    } else {
        short(value)
    }
}

/// From the least to the largest of values that can be shown, with some room.
fn range(values: impl Iterator<Item = f64>, given: Option<(f64, f64)>, log: bool) -> (f64, f64) {
    if let Some((low, high)) = given {
        return (place(low, log), place(high, log));
    }
    let shown = values.map(|v| place(v, log)).filter(|v| v.is_finite());
    let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if !(low.is_finite() && high.is_finite()) {
        return (0.0, 1.0);
    }
    let room = ((high - low) * 0.04).max(high.abs().max(1e-9) * 1e-3);
    // A quantity that cannot be negative starts at 0 where that is near.
    let low = if !log && low >= 0.0 && low < 0.3 * high { 0.0 } else { low - room };
    (low, high + room)
}

/// Curves in one pair of axes; the legend stands beside them.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn curves(axes: &Axes, curves: &[Curve]) -> Result<String> {
    let (width, height) = axes.size();
    let longest = curves.iter().map(|c| c.name.chars().count()).max().unwrap_or(0);
    // A letter of 12 pixels is some 6.6 wide.
    let beside = if longest == 0 { 0 } else { 44 + (6.6 * longest as f64) as u32 };
    svg((width + beside, height), |root| {
        let (left, right) = root.split_horizontally(width);
        draw_curves(&left, axes, curves)?;
        if beside > 0 { draw_legend(&right, curves) } else { Ok(()) }
    })
}

/// One line for each curve that has a name.
fn draw_legend(area: &Area<'_>, curves: &[Curve]) -> Result<(), Failure> {
    let mut y = 40;
    for curve in curves.iter().filter(|c| !c.name.is_empty()) {
        let pieces: &[(i32, i32)] = match curve.pen {
            Pen::Line => &[(4, 24)],
            Pen::Dashed => &[(4, 12), (16, 24)],
            Pen::Dots | Pen::Mark => &[],
        };
        for (from, to) in pieces {
            area.draw(&PathElement::new(vec![(*from, y), (*to, y)], curve.colour.stroke_width(3)))?;
        }
        if pieces.is_empty() {
            area.draw(&Circle::new(
                (14, y),
                if curve.pen == Pen::Mark { 4 } else { 2 },
                curve.colour.filled(),
            ))?;
        }
        area.draw(&Text::new(curve.name.clone(), (32, y), label(Pos::new(HPos::Left, VPos::Center))))?;
        y += 17;
    }
    Ok(())
}

/// Letters beside axes, at this anchor.
fn label(at: Pos) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", 12)).pos(at)
}

fn draw_curves(root: &Area<'_>, axes: &Axes, curves: &[Curve]) -> Result<(), Failure> {
    let all = || curves.iter().flat_map(|c| &c.points).filter(|p| p.0.is_finite() && p.1.is_finite());
    let (x0, x1) = range(all().map(|p| p.0), axes.x_range, axes.log_x);
    let (y0, y1) = range(all().map(|p| p.1), axes.y_range, axes.log_y);
    let mut chart = ChartBuilder::on(root)
        .caption(&axes.title, ("sans-serif", 15))
        .margin(10)
        .x_label_area_size(38)
        .y_label_area_size(54)
        .build_cartesian_2d(Scaled::new(x0, x1, axes.log_x), Scaled::new(y0, y1, axes.log_y))?;
    chart
        .configure_mesh()
        .x_desc(&axes.x)
        .y_desc(&axes.y)
        .x_label_formatter(&|v| tick(*v, axes.log_x))
        .y_label_formatter(&|v| tick(*v, axes.log_y))
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(230, 230, 230))
        .draw()?;
    for curve in curves {
        let colour = curve.colour;
        let shown: Vec<(f64, f64)> =
            curve.points.iter().map(|p| (place(p.0, axes.log_x), place(p.1, axes.log_y))).collect();
        let inside = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite() && p.1 <= y1 && p.1 >= y0;
        // One piece between points that cannot be shown.
        for piece in shown.split(|p| !inside(p)).filter(|p| !p.is_empty()) {
            let points = piece.iter().copied();
            match curve.pen {
                Pen::Line => chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?,
                Pen::Dashed => {
                    chart.draw_series(DashedLineSeries::new(points, 6, 4, colour.stroke_width(2)))?
                }
                Pen::Dots => chart.draw_series(points.map(|p| Circle::new(p, 2, colour.filled())))?,
                Pen::Mark => chart.draw_series(points.map(|p| Circle::new(p, 4, colour.filled())))?,
            };
        }
    }
    Ok(())
}

/// Values over two axes: `values[j][i]` at `x[i]`, `y[j]`, with curves over them. What is not known stays white.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn heat(
    axes: &Axes,
    name: &str,
    (x, y): (&[f64], &[f64]),
    values: &[Vec<Option<f64>>],
    over: &[Curve],
) -> Result<String> {
    let (width, height) = axes.size();
    let scale = Scale::of(values.iter().flatten().filter_map(|v| *v));
    let edges = |at: &[f64], log: bool| -> Vec<f64> {
        let at: Vec<f64> = at.iter().map(|v| place(*v, log)).collect();
        let step = |i: usize| at.get(i + 1).zip(at.get(i)).map_or(1.0, |(b, a)| b - a);
        let mut edges: Vec<f64> = at.windows(2).map(|w| f64::midpoint(w[0], w[1])).collect();
        if let (Some(first), Some(last)) = (at.first(), at.last()) {
            edges.insert(0, first - step(0) / 2.0);
            edges.push(last + step(at.len().saturating_sub(2)) / 2.0);
        }
        edges
    };
    let (xs, ys) = (edges(x, axes.log_x), edges(y, axes.log_y));
    svg((width + BAR, height), |root| {
        let (left, right) = root.split_horizontally(width);
        let ends = |e: &[f64]| (e.first().copied().unwrap_or(0.0), e.last().copied().unwrap_or(1.0));
        let ((x0, x1), (y0, y1)) = (ends(&xs), ends(&ys));
        let mut chart = ChartBuilder::on(&left)
            .caption(&axes.title, ("sans-serif", 15))
            .margin(10)
            .x_label_area_size(38)
            .y_label_area_size(54)
            .build_cartesian_2d(Scaled::new(x0, x1, axes.log_x), Scaled::new(y0, y1, axes.log_y))?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc(&axes.x)
            .y_desc(&axes.y)
            .x_label_formatter(&|v| tick(*v, axes.log_x))
            .y_label_formatter(&|v| tick(*v, axes.log_y))
            .draw()?;
        for (j, row) in values.iter().enumerate() {
            chart.draw_series(row.iter().enumerate().filter_map(|(i, value)| {
                let value = value.filter(|v| v.is_finite())?;
                let corners = [(xs[i], ys[j]), (xs[i + 1], ys[j + 1])];
                Some(Rectangle::new(corners, scale.colour(value).filled()))
            }))?;
        }
        for curve in over {
            let shown = curve.points.iter().map(|p| (place(p.0, axes.log_x), place(p.1, axes.log_y)));
            let shown: Vec<_> = shown.collect();
            let inside = |p: &(f64, f64)| p.0.is_finite() && (y0..=y1).contains(&p.1);
            for piece in shown.split(|p| !inside(p)).filter(|p| p.len() > 1) {
                chart.draw_series(LineSeries::new(piece.iter().copied(), curve.colour.stroke_width(2)))?;
            }
        }
        scale.bar(&right, name)
    })
}

/// A whole page of sections.
#[must_use]
pub fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\n\
         <style>body{{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222;\
         background:#fff}}pre{{background:#f4f4f2;padding:1rem;overflow-x:auto;font-size:12px}}svg{{max-width:100%;\
         height:auto}}figure{{margin:1.2rem 0}}figure>div{{display:flex;flex-wrap:wrap;gap:.5rem}}figcaption{{\
         max-width:60rem;color:#444;font-size:14px}}table{{border-collapse:collapse;font-size:13px}}td,th{{border:1px \
         solid #ccc;padding:.2rem .5rem;text-align:right}}</style></head>\n<body><h1>{title}</h1>\n{body}</body></html>\n"
    )
}

/// Pictures side by side over what they show; the caption may hold markup.
#[must_use]
pub fn figure(pictures: &[String], caption: &str) -> String {
    format!("<figure><div>{}</div><figcaption>{caption}</figcaption></figure>\n", pictures.concat())
}

/// Text as HTML and SVG write it.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_short() {
        let of = |v: f64| tick(v, false);
        assert_eq!([of(0.0), of(0.05), of(12.0), of(1234.5)], ["0", "0.05", "12", "1234"]);
        assert_eq!(ticks(0.0, 1.04, false), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        let log: Vec<String> = ticks(-1.1, 1.2, true).iter().map(|v| tick(*v, true)).collect();
        assert_eq!(log, ["0.1", "0.2", "0.5", "1", "2", "5", "10"]);
        assert_eq!([tick(-2.0, true), tick(2.0, true), tick(-1.5, true)], ["0.01", "100", "0.032"]);
    }

    #[test]
    fn whatever_is_not_a_number_is_left_out() {
        let axes = Axes { log_y: true, ..Axes::new("t", "x", "y") };
        let bad = vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, -1.0), (3.0, 2.0), (4.0, f64::INFINITY)];
        let text = curves(&axes, &[Curve::new("a", 0, bad), Curve::new("b", 9, vec![])]).unwrap();
        assert!(text.starts_with("<svg") && !text.contains("NaN"));
        let text = heat(
            &axes,
            "z",
            (&[1.0, 2.0], &[1.0, 10.0]),
            &[vec![None, Some(1.0)], vec![Some(f64::NAN), None]],
            &[],
        );
        assert!(!text.unwrap().contains("NaN"));
        assert!(surface(&axes, "z", &[], &[], &[]).is_ok());
    }

    /// Attribute of every element of a name, as a number.
    fn numbers(svg: &str, element: &str, attribute: &str) -> Vec<f64> {
        let of = |text: &str| -> Option<f64> {
            let tag = format!(" {}", text.split('>').next()?);
            tag.split_once(&format!(" {attribute}=\""))?.1.split('"').next()?.parse().ok()
        };
        svg.split(&format!("<{element} ")).skip(1).filter_map(of).collect()
    }

    #[test]
    fn legends_stand_beside_the_curves() {
        let line = |name: &str, n| Curve::new(name, n, vec![(0.0, 0.0), (1.0, 1.0)]);
        let axes = Axes::new("t", "x", "y");
        let plain = curves(&axes, &[line("", 0)]).unwrap();
        assert_eq!(numbers(&plain, "svg", "width"), [520.0]);
        let named = curves(&axes, &[line("first", 0), line("a much longer name", 1)]).unwrap();
        let width = numbers(&named, "svg", "width")[0];
        let beside: Vec<f64> = numbers(&named, "text", "x").into_iter().filter(|x| *x > 520.0).collect();
        assert_eq!(beside, [552.0, 552.0]);
        assert!(width >= 552.0 + 6.6 * 18.0, "{width}");
    }

    #[test]
    fn colour_bars_leave_their_labels_free() {
        let points: Vec<(f64, f64)> = (0..16).map(|i| (f64::from(i % 4), f64::from(i / 4))).collect();
        let values: Vec<f64> = (0..16).map(|i| 1e-4 * f64::from(i + 1)).collect();
        let drawn =
            surface(&Axes::new("t", "x", "y"), "bound of the position [mm]", &points, &values, &[]).unwrap();
        let (left, width) = (numbers(&drawn, "rect", "x"), numbers(&drawn, "rect", "width"));
        let ends = left.iter().zip(&width).filter(|(x, _)| **x > 430.0).map(|(x, w)| x + w);
        let bar = ends.fold(0.0, f64::max);
        let labels: Vec<f64> = numbers(&drawn, "text", "x").into_iter().filter(|x| *x > 430.0).collect();
        assert!(bar > 440.0 && labels.len() > 3 && labels.iter().all(|x| *x > bar + 4.0), "{bar} {labels:?}");
    }
}
