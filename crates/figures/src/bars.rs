//! Shares, counts and how often something was taken for something else: bars, and a matrix of cells.

use plotters::prelude::*;
use plotters::style::FontTransform;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::axis::{Labels, Scaled};
use crate::{Area, Axes, COLOURS, Failure, Result, label, nothing, svg};

/// \[pixels\] that a letter takes at most, on average over a label.
const LETTER: f64 = 8.0;
/// \[pixels\] of a row.
const ROW: i32 = 22;
/// \[pixels\] of the longest bar.
const LENGTH: i32 = 420;
/// \[pixels\] between things.
const GAP: i32 = 10;

/// A bar that lies: its name to the left, its value in words to the right.
#[derive(Debug, Clone)]
pub struct Bar {
    /// What it is of.
    pub name: String,
    /// How long it is.
    pub value: f64,
    /// An interval around the value.
    pub interval: Option<[f64; 2]>,
    /// Values that are aimed at: marks across the bar.
    pub aims: Vec<f64>,
    /// The value as it is written.
    pub text: String,
    /// Its colour.
    pub colour: RGBColor,
}

impl Bar {
    /// A bar of the first colour without interval and aims.
    pub fn new(name: impl Into<String>, value: f64, text: impl Into<String>) -> Self {
        let (name, text) = (name.into(), text.into());
        Self { name, value, interval: None, aims: Vec::new(), text, colour: COLOURS[0] }
    }

    /// The same bar with an interval, where that is of finite numbers.
    #[must_use]
    pub fn interval(self, interval: [f64; 2]) -> Self {
        Self { interval: interval.iter().all(|v| v.is_finite()).then_some(interval), ..self }
    }
}

/// \[pixels\] of the longest of these texts.
fn width<'a>(texts: impl Iterator<Item = &'a str>) -> i32 {
    (LETTER * texts.map(|text| text.chars().count()).max().unwrap_or(0) as f64).ceil() as i32
}

/// Letters of labels, at this anchor.
fn letters(h: HPos) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", 15)).pos(Pos::new(h, VPos::Center))
}

/// Draws a title in the first row where there is one; how high that is.
fn title(root: &Area<'_>, text: &str) -> Result<i32, Failure> {
    if text.is_empty() {
        return Ok(0);
    }
    let style = TextStyle::from(("sans-serif", 15, FontStyle::Bold)).pos(Pos::new(HPos::Left, VPos::Center));
    root.draw(&Text::new(text.to_owned(), (GAP, ROW / 2 + 4), style))?;
    Ok(ROW + 8)
}

/// Bars one below the other, from 0 to `full`, or to the largest value where that is absent. The title may be empty.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn bars(heading: &str, rows: &[Bar], full: Option<f64>) -> Result<String> {
    let left = GAP + width(rows.iter().map(|row| row.name.as_str())) + GAP;
    let right = left + LENGTH + GAP;
    let wide = (right + width(rows.iter().map(|row| row.text.as_str())) + GAP)
        .max(2 * GAP + width(std::iter::once(heading)));
    let above = if heading.is_empty() { 0 } else { ROW + 8 };
    let high = above + ROW * rows.len() as i32 + GAP;
    let values = rows.iter().flat_map(|row| [row.value, row.interval.map_or(0.0, |i| i[1])]);
    let largest = full.unwrap_or_else(|| values.filter(|v| v.is_finite()).fold(1e-12, f64::max));
    let x = |value: f64| left + (f64::from(LENGTH) * (value / largest).clamp(0.0, 1.0)).round() as i32;
    svg((wide as u32, high as u32), |root| {
        let mut y = title(root, heading)? + GAP / 2;
        for row in rows {
            let middle = y + ROW / 2;
            let end = if row.value.is_finite() { x(row.value) } else { left };
            root.draw(&Text::new(row.name.clone(), (left - GAP, middle), letters(HPos::Right)))?;
            let corners = [(left, middle - 6), (end.max(left + 1), middle + 6)];
            root.draw(&Rectangle::new(corners, row.colour.filled()))?;
            if let Some([low, high]) = row.interval.map(|interval| interval.map(x)) {
                let lines = [
                    [(low, middle), (high, middle)],
                    [(low, middle - 4), (low, middle + 4)],
                    [(high, middle - 4), (high, middle + 4)],
                ];
                // Black on white, so that they show on the bar.
                for pen in [WHITE.stroke_width(3), BLACK.stroke_width(1)] {
                    for line in lines {
                        root.draw(&PathElement::new(line, pen))?;
                    }
                }
            }
            for aim in row.aims.iter().map(|aim| x(*aim)) {
                let line = [(aim, middle - 8), (aim, middle + 8)];
                root.draw(&PathElement::new(line, COLOURS[1].stroke_width(2)))?;
            }
            root.draw(&Text::new(row.text.clone(), (right, middle), letters(HPos::Left)))?;
            y += ROW;
        }
        Ok(())
    })
}

/// Counts in neighbouring ranges: each with the value that its range begins at.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn histogram(axes: &Axes, bins: &[(f64, f64)]) -> Result<String> {
    let most = bins.iter().map(|bin| bin.1).filter(|v| v.is_finite()).fold(0.0, f64::max);
    let count = bins.len() as f64;
    let begins: Vec<f64> = bins.iter().map(|bin| bin.0).collect();
    let begins = Labels::of(&begins, false);
    svg(axes.size(), |root| {
        if !bins.iter().any(|bin| bin.0.is_finite() && bin.1.is_finite()) {
            return nothing(root, axes, &axes.y);
        }
        let heights = Scaled::new(0.0, (most * 1.05).max(1.0), false);
        let labels = heights.labels(false);
        let mut chart = ChartBuilder::on(root)
            .caption(&axes.title, ("sans-serif", 15))
            .margin(10)
            .x_label_area_size(38)
            .y_label_area_size(54)
            .build_cartesian_2d(
                Scaled::at(0.0, count.max(1.0), (0..bins.len()).map(|i| i as f64).collect()),
                heights,
            )?;
        let from = |at: &f64| bins.get(at.round() as usize).map_or(String::new(), |bin| begins.label(bin.0));
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_desc(&axes.x)
            .y_desc(&axes.y)
            .x_label_formatter(&from)
            .y_label_formatter(&|v| labels.label(*v))
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(230, 230, 230))
            .draw()?;
        let known = bins.iter().enumerate().filter(|(_, bin)| bin.1.is_finite());
        chart.draw_series(known.map(|(i, (_, height))| {
            let corners = [(i as f64 + 0.04, 0.0), (i as f64 + 0.96, *height)];
            Rectangle::new(corners, COLOURS[0].filled())
        }))?;
        Ok(())
    })
}

/// Counts by row and column: darker where the share of its row is larger. Columns are named from below upwards.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn matrix(heading: &str, columns: &[String], rows: &[(String, Vec<usize>)]) -> Result<String> {
    let left = GAP + width(rows.iter().map(|row| row.0.as_str())) + GAP;
    let names = width(columns.iter().map(String::as_str)) + GAP;
    let wide = (left + ROW * columns.len() as i32 + GAP).max(2 * GAP + width(std::iter::once(heading)));
    let above = if heading.is_empty() { 0 } else { ROW + 8 } + names;
    let high = above + ROW * rows.len() as i32 + GAP;
    svg((wide as u32, high as u32), |root| {
        title(root, heading)?;
        for (i, column) in columns.iter().enumerate() {
            let at = (left + ROW * i as i32 + ROW / 2, above - 4);
            let style = letters(HPos::Left).transform(FontTransform::Rotate270);
            root.draw(&Text::new(column.clone(), at, style))?;
        }
        for (j, (name, counts)) in rows.iter().enumerate() {
            let top = above + ROW * j as i32;
            root.draw(&Text::new(name.clone(), (left - GAP, top + ROW / 2), letters(HPos::Right)))?;
            let all = counts.iter().sum::<usize>().max(1);
            for i in 0..columns.len() {
                let count = counts.get(i).copied().unwrap_or(0);
                let share = count as f64 / all as f64;
                let corner = (left + ROW * i as i32, top);
                let corners = [corner, (corner.0 + ROW, corner.1 + ROW)];
                root.draw(&Rectangle::new(corners, shade(share).filled()))?;
                root.draw(&Rectangle::new(corners, RGBColor(225, 225, 225).stroke_width(1)))?;
                if count > 0 {
                    let colour = if share > 0.5 { WHITE } else { BLACK };
                    let style = label(Pos::new(HPos::Center, VPos::Center)).color(&colour);
                    root.draw(&Text::new(
                        count.to_string(),
                        (corner.0 + ROW / 2, corner.1 + ROW / 2),
                        style,
                    ))?;
                }
            }
        }
        Ok(())
    })
}

/// From white to the first colour.
fn shade(share: f64) -> RGBColor {
    let full = COLOURS[0];
    let channel = |end: u8| (255.0 + (f64::from(end) - 255.0) * share.clamp(0.0, 1.0)).round() as u8;
    RGBColor(channel(full.0), channel(full.1), channel(full.2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::numbers;

    #[test]
    fn bars_are_as_long_as_their_values() {
        let rows = [
            Bar::new("half", 0.5, "50 %").interval([0.4, 0.6]),
            Bar { aims: vec![0.9], ..Bar::new("all", 1.0, "100 %").interval([0.8, f64::NAN]) },
            Bar::new("unknown", f64::NAN, "-"),
        ];
        let drawn = bars("shares", &rows, Some(1.0)).unwrap();
        // The first rectangle is the background.
        assert_eq!(numbers(&drawn, "rect", "width")[1..], [210.0, 420.0, 1.0]);
        assert!(!drawn.contains("NaN"));
        // Three lines of an interval, each twice, and one aim.
        let [lines, polylines] = ["<line ", "<polyline "].map(|tag| drawn.matches(tag).count());
        assert_eq!(lines + polylines, 7, "{drawn}");
        let relative = bars("", &rows[..1], None).unwrap();
        assert_eq!(numbers(&relative, "rect", "width")[1..], [350.0], "0.5 of 0.6");
    }

    #[test]
    fn names_and_values_keep_clear_of_bars_and_edges() {
        let rows =
            [Bar::new("a name of some length, with words", 1.0, "12.3 % of 456"), Bar::new("b", 0.1, "c")];
        let drawn = bars("", &rows, None).unwrap();
        let x = numbers(&drawn, "text", "x");
        let (bar, whole) = (numbers(&drawn, "rect", "x")[1], numbers(&drawn, "svg", "width")[0]);
        assert!(x[0] < bar && x[0] >= LETTER * 33.0, "{x:?}");
        assert!(x[1] > bar + 420.0 && x[1] + LETTER * 13.0 <= whole, "{x:?} {whole}");
    }

    #[test]
    fn cells_are_darker_where_their_share_is_larger() {
        let columns = ["first".to_owned(), "second".to_owned()];
        let rows = [("row".to_owned(), vec![3, 1]), ("none".to_owned(), vec![0])];
        let drawn = matrix("taken for", &columns, &rows).unwrap();
        assert_eq!(drawn.matches(">\nrow\n</text>").count(), 1);
        assert_eq!(drawn.matches(">\n3\n</text>").count() + drawn.matches(">\n1\n</text>").count(), 2);
        // Background, then each cell and its border.
        assert_eq!(drawn.matches("<rect ").count(), 1 + 2 * 4);
        assert_eq!([shade(0.0), shade(1.0)], [WHITE, COLOURS[0]]);
        assert!(shade(0.25).0 > shade(0.75).0);
    }

    #[test]
    fn ranges_stand_side_by_side() {
        let axes = Axes::new("", "force [N]", "frames");
        let drawn = histogram(&axes, &[(0.0, 10.0), (0.5, 20.0), (2.0, 5.0)]).unwrap();
        let (x, width) = (numbers(&drawn, "rect", "x"), numbers(&drawn, "rect", "width"));
        // The first rectangle is the background.
        let ends: Vec<(f64, f64)> = x.iter().zip(&width).map(|(x, w)| (*x, x + w)).skip(1).collect();
        assert_eq!(ends.len(), 3);
        assert!(ends.windows(2).all(|w| w[0].1 < w[1].0), "{ends:?}");
        for label in ["0.5", "2", "force [N]"] {
            assert!(drawn.contains(&format!(">\n{label}\n</text>")), "{label}: {drawn}");
        }
        assert!(histogram(&axes, &[]).is_ok());
    }
}
