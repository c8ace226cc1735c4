//! Figures as SVG text: curves, clouds of points, bars, matrices, maps over two axes, maps of a surface; and the pages that hold
//! them.
//!
//! The one place of this workspace where figures for people are drawn.

mod axis;
mod bars;
mod points;
mod scale;
mod surface;

use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use plotters::style::RGBColor;

pub use axis::short;
use axis::{Scaled, place, range};
pub use bars::{Bar, bars, histogram, matrix};
pub use points::{Dots, Segment, dots, segments};
use scale::{BAR, Scale};
pub use surface::{Kind, kinds, surface, surface_within};

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

    /// The same axes with one scale for both, so that distances are true, over all of these points.
    #[must_use]
    pub fn equal(self, points: impl Iterator<Item = (f64, f64)> + Clone) -> Self {
        let (x0, x1) = range(points.clone().map(|p| p.0), None, false).unwrap_or((0.0, 1.0));
        let (y0, y1) = range(points.map(|p| p.1), None, false).unwrap_or((0.0, 1.0));
        let half = f64::max(x1 - x0, y1 - y0) / 2.0;
        let around = |low: f64, high: f64| {
            let middle = f64::midpoint(low, high);
            Some((middle - half, middle + half))
        };
        Self { x_range: around(x0, x1), y_range: around(y0, y1), size: surface::SIZE, ..self }
    }

    fn size(&self) -> (u32, u32) {
        if self.size.0 == 0 { (520, 340) } else { self.size }
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

/// Curves in one pair of axes; the legend stands beside them.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn curves(axes: &Axes, curves: &[Curve]) -> Result<String> {
    let (width, height) = axes.size();
    let legend = beside(curves);
    svg((width + legend, height), |root| {
        let (left, right) = root.split_horizontally(width);
        let drawn = draw_curves(&left, axes, curves)?;
        if drawn && legend > 0 { draw_legend(&right, curves) } else { Ok(()) }
    })
}

/// \[pixels\] that the legend of these curves takes; 0 where none has a name.
fn beside(curves: &[Curve]) -> u32 {
    let longest = curves.iter().map(|c| c.name.chars().count()).max().unwrap_or(0);
    // A letter of 12 pixels is some 6.6 wide.
    if longest == 0 { 0 } else { 44 + (6.6 * longest as f64) as u32 }
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

/// Axes that stand, for locations of their values: logarithms on a logarithmic axis.
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scaled, Scaled>>;

/// Title, axes and their labels, from the first to the second place; with `mesh` also lines at the ticks.
fn frame<'a, 'b>(
    root: &'a Area<'b>,
    axes: &Axes,
    x: (f64, f64),
    y: (f64, f64),
    mesh: bool,
) -> Result<Chart<'a, 'b>, Failure> {
    let (horizontal, vertical) = (Scaled::new(x.0, x.1, axes.log_x), Scaled::new(y.0, y.1, axes.log_y));
    let (labels_x, labels_y) = (horizontal.labels(axes.log_x), vertical.labels(axes.log_y));
    let mut chart = ChartBuilder::on(root)
        .caption(&axes.title, ("sans-serif", 15))
        .margin(10)
        // Half of the last label of the axis stands beyond it.
        .margin_right(24)
        .x_label_area_size(38)
        .y_label_area_size(60)
        .build_cartesian_2d(horizontal, vertical)?;
    let (label_x, label_y) = (|v: &f64| labels_x.label(*v), |v: &f64| labels_y.label(*v));
    let mut style = chart.configure_mesh();
    style.x_desc(&axes.x).y_desc(&axes.y).x_label_formatter(&label_x).y_label_formatter(&label_y);
    if mesh {
        style.light_line_style(WHITE).bold_line_style(RGBColor(230, 230, 230)).draw()?;
    } else {
        style.disable_mesh().draw()?;
    }
    Ok(chart)
}

/// Whether there was anything to draw.
fn draw_curves(root: &Area<'_>, axes: &Axes, curves: &[Curve]) -> Result<bool, Failure> {
    let all = || curves.iter().flat_map(|c| &c.points).filter(|p| p.0.is_finite() && p.1.is_finite());
    let x = range(all().map(|p| p.0), axes.x_range, axes.log_x);
    let y = range(all().map(|p| p.1), axes.y_range, axes.log_y);
    let (Some(x), Some(y)) = (x, y) else {
        nothing(root, axes, &axes.y)?;
        return Ok(false);
    };
    // Given ranges are no values.
    if all().next().is_none() {
        nothing(root, axes, &axes.y)?;
        return Ok(false);
    }
    let mut chart = frame(root, axes, x, y, true)?;
    draw_series(&mut chart, axes, curves)?;
    Ok(true)
}

/// A sentence in place of axes that no value of this quantity would stand in.
fn nothing(root: &Area<'_>, axes: &Axes, quantity: &str) -> Result<(), Failure> {
    let (width, height) = root.dim_in_pixel();
    let middle = (width as i32 / 2, height as i32 / 2);
    let style = || label(Pos::new(HPos::Center, VPos::Center));
    root.draw(&Text::new(axes.title.clone(), (middle.0, 18), style()))?;
    root.draw(&Text::new(quantity.to_owned(), (middle.0, middle.1 - 9), style()))?;
    root.draw(&Text::new(
        "is not determined anywhere: no value is finite.",
        (middle.0, middle.1 + 9),
        style(),
    ))?;
    Ok(())
}

/// Curves in axes that are there.
fn draw_series(chart: &mut Chart<'_, '_>, axes: &Axes, curves: &[Curve]) -> Result<(), Failure> {
    let y_spec = chart.y_range();
    let (y0, y1) = (y_spec.start, y_spec.end);
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
        if !values.iter().flatten().flatten().any(|v| v.is_finite()) {
            return nothing(&left, axes, name);
        }
        let ends = |e: &[f64]| (e.first().copied().unwrap_or(0.0), e.last().copied().unwrap_or(1.0));
        let ((x0, x1), (y0, y1)) = (ends(&xs), ends(&ys));
        let mut chart = frame(&left, axes, (x0, x1), (y0, y1), false)?;
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

/// Pictures one below the other, as one.
#[must_use]
pub fn column(pictures: &[String]) -> String {
    let size = |picture: &str, name: &str| -> u32 {
        let tag = picture.split('>').next().unwrap_or_default();
        let value = tag.split_once(&format!(" {name}=\"")).and_then(|(_, rest)| rest.split('"').next());
        value.and_then(|value| value.parse().ok()).unwrap_or(0)
    };
    let (mut width, mut height, mut all) = (0, 0, String::new());
    for picture in pictures {
        all += &picture.replacen("<svg ", &format!("<svg y=\"{height}\" "), 1);
        width = width.max(size(picture, "width"));
        height += size(picture, "height");
    }
    format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" xmlns=\"http://www.w3.org/2000/svg\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>\n{all}</svg>\n"
    )
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
pub(crate) mod tests {
    use super::*;

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
    }

    /// Texts of a figure.
    pub(crate) fn texts(svg: &str) -> Vec<String> {
        let of = |text: &str| Some(text.split_once('>')?.1.split_once("</text>")?.0.trim().to_owned());
        svg.split("<text ").skip(1).filter_map(of).collect()
    }

    #[test]
    fn a_sentence_stands_where_no_value_is_finite() {
        let axes = Axes {
            y_range: Some((0.0, 1.0)),
            x_range: Some((0.0, 1.0)),
            ..Axes::new("t", "x", "error [mm]")
        };
        let line = Curve::new("a", 0, vec![(0.0, f64::INFINITY), (1.0, f64::NAN)]);
        let at = [(0.0, 0.0), (1.0, 1.0)];
        let all = [
            curves(&axes, std::slice::from_ref(&line)),
            curves(&Axes::new("t", "x", "error [mm]"), std::slice::from_ref(&line)),
            heat(&axes, "error [mm]", (&[1.0, 2.0], &[1.0]), &[vec![None, Some(f64::NAN)]], &[]),
            surface(&axes, "error [mm]", &at, &[f64::NAN, f64::INFINITY], &[]),
            surface_within(&axes, "error [mm]", &[], &[], [0.0, 1.0], 1.0),
            segments(&Axes::new("t", "x", "error [mm]"), "e", &[[at[0], at[1]]], &[f64::NAN]),
            dots(&Axes::new("t", "x", "error [mm]"), &[Dots::new("a", 0, line.points)], &[]),
            histogram(&axes, &[]),
        ];
        for figure in all {
            let figure = figure.unwrap();
            assert_eq!(
                texts(&figure),
                ["t", "error [mm]", "is not determined anywhere: no value is finite."]
            );
            assert!(!figure.contains("NaN"));
        }
    }

    /// Attribute of every element of a name, as a number.
    pub(crate) fn numbers(svg: &str, element: &str, attribute: &str) -> Vec<f64> {
        let of = |text: &str| -> Option<f64> {
            let tag = format!(" {}", text.split('>').next()?);
            tag.split_once(&format!(" {attribute}=\""))?.1.split('"').next()?.parse().ok()
        };
        svg.split(&format!("<{element} ")).skip(1).filter_map(of).collect()
    }

    #[test]
    fn pictures_of_a_column_do_not_overlap() {
        let line = Curve::new("", 0, vec![(0.0, 0.0), (1.0, 1.0)]);
        let wide = Axes { size: (900, 350), ..Axes::new("first", "x", "y") };
        let pictures = [
            curves(&wide, std::slice::from_ref(&line)),
            curves(&Axes::new("second", "x", "y"), std::slice::from_ref(&line)),
        ];
        let all = column(&pictures.map(Result::unwrap));
        assert_eq!(numbers(&all, "svg", "width"), [900.0, 900.0, 520.0]);
        assert_eq!(numbers(&all, "svg", "height"), [690.0, 350.0, 340.0]);
        assert_eq!(numbers(&all, "svg", "y"), [0.0, 350.0]);
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
