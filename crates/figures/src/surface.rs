//! Maps of surfaces that are laid flat: every point has the cell that is nearer to it than to any other point.

use plotters::prelude::*;

use crate::axis::range;
use crate::scale::{BAR, Scale};
use crate::{Axes, Chart, Curve, Failure, Pen, Result, beside, draw_legend, frame, nothing, svg};

/// \[pixels\] of the axes.
pub(crate) const SIZE: (u32, u32) = (430, 430);
/// \[pixels\] that cells are rounded to.
const GRAIN: u32 = 3;
/// Distances between points that a cell reaches: half of the diagonal of a square, and a little.
const REACH: f64 = 0.8;
/// \[pixels\] radius of a mark that stands alone.
const MARK: i32 = 5;

/// Values at points of a surface, laid flat, and crosses where taxels are. What is not known stays white.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn surface(
    axes: &Axes,
    name: &str,
    points: &[(f64, f64)],
    values: &[f64],
    taxels: &[(f64, f64)],
) -> Result<String> {
    draw(axes, name, points, values, taxels, &Scale::of(values.iter().copied()))
}

/// As [`surface`], with a colour bar over `range`, whatever the values are. The last colour stands for the value `full`, or for the
/// end of the range where that is farther: below it neither the map nor its bar has that colour.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn surface_within(
    axes: &Axes,
    name: &str,
    points: &[(f64, f64)],
    values: &[f64],
    range: [f64; 2],
    full: f64,
) -> Result<String> {
    draw(axes, name, points, values, &[], &Scale::within(range, full))
}

/// Points of one kind on a surface that is laid flat.
#[derive(Debug, Clone)]
pub struct Kind {
    /// Its entry in the legend; none where it is empty.
    pub name: String,
    /// In the units of the axes.
    pub points: Vec<(f64, f64)>,
    /// Colour of its cells.
    pub colour: RGBColor,
}

/// Points of several kinds, laid flat: each has a cell in the colour of its kind. Marks over them are discs that never overlap. The
/// legend stands beside the map. Axes without ranges have one scale for both.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn kinds(axes: &Axes, kinds: &[Kind], marks: &Kind) -> Result<String> {
    let finite = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
    // A later kind has the cell where two points are the same.
    let all: Vec<((f64, f64), RGBColor)> = kinds
        .iter()
        .rev()
        .flat_map(|kind| kind.points.iter().filter(|p| finite(p)).map(|p| (*p, kind.colour)))
        .collect();
    let points: Vec<(f64, f64)> = all.iter().map(|(p, _)| *p).collect();
    let axes = if axes.x_range.is_some() && axes.y_range.is_some() {
        axes.clone()
    } else {
        axes.clone().equal(points.iter().copied())
    };
    let entry = |kind: &Kind| Curve {
        name: kind.name.clone(),
        points: Vec::new(),
        colour: kind.colour,
        pen: Pen::Mark,
    };
    let legend: Vec<Curve> = kinds.iter().chain([marks]).map(entry).collect();
    let (width, height) = axes.size();
    let right = beside(&legend);
    svg((width + right, height), |root| {
        let (left, right_side) = root.split_horizontally(width);
        let ranges = |of: fn(&(f64, f64)) -> f64, given| range(points.iter().map(of), given, false);
        let (Some(x), Some(y)) = (ranges(|p| p.0, axes.x_range), ranges(|p| p.1, axes.y_range)) else {
            return nothing(&left, &axes, &axes.y);
        };
        if points.is_empty() {
            return nothing(&left, &axes, &axes.y);
        }
        let mut chart = frame(&left, &axes, x, y, false)?;
        draw_cells(&mut chart, &points, (x, y), |i| all.get(i).map(|(_, colour)| *colour))?;
        let shown: Vec<(f64, f64)> = marks.points.iter().copied().filter(finite).collect();
        let radius = radius_of(&shown, |p| chart.backend_coord(p));
        // White around them, so that they show on every colour.
        chart.draw_series(shown.iter().map(|p| Circle::new(*p, radius + 1, WHITE.filled())))?;
        chart.draw_series(shown.iter().map(|p| Circle::new(*p, radius, marks.colour.filled())))?;
        if right > 0 { draw_legend(&right_side, &legend) } else { Ok(()) }
    })
}

/// \[pixels\] of discs around these points that do not touch; a point that is there twice is one.
fn radius_of(points: &[(f64, f64)], pixel: impl Fn(&(f64, f64)) -> (i32, i32)) -> i32 {
    let at: Vec<(i32, i32)> = points.iter().map(pixel).collect();
    let mut least = f64::INFINITY;
    for (i, a) in at.iter().enumerate() {
        for b in at.get(i + 1..).unwrap_or_default() {
            let far = f64::from(a.0 - b.0).hypot(f64::from(a.1 - b.1));
            least = if far > 0.0 { least.min(far) } else { least };
        }
    }
    ((least / 2.0 - 1.0).floor().clamp(1.0, f64::from(MARK))) as i32
}

/// Median distance from a point to the nearest other one.
fn apart(points: &[(f64, f64)]) -> f64 {
    let nearest = |i: usize| {
        let others = points.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, p)| (p.0 - points[i].0).hypot(p.1 - points[i].1)).fold(f64::INFINITY, f64::min)
    };
    let mut all: Vec<f64> = (0..points.len()).map(nearest).filter(|d| d.is_finite() && *d > 0.0).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(1.0)
}

/// Stretches of rows that belong to one point: its index, the row, and the first and last column. The ranges are those of `count`
/// columns and rows.
fn cells(
    points: &[(f64, f64)],
    ((x0, x1), (y0, y1)): ((f64, f64), (f64, f64)),
    count: (usize, usize),
) -> Vec<(usize, usize, usize, usize)> {
    let grain = ((x1 - x0) / count.0 as f64, (y1 - y0) / count.1 as f64);
    // A row of points that are closer than pixels must not fall between two of them.
    let reach = (REACH * apart(points)).max(0.75 * grain.0.hypot(grain.1));
    let at = |i: usize, low: f64, grain: f64| low + (i as f64 + 0.5) * grain;
    let mut found = Vec::new();
    for row in 0..count.1 {
        let y = at(row, y0, grain.1);
        let near: Vec<usize> = (0..points.len()).filter(|i| (points[*i].1 - y).abs() <= reach).collect();
        let mut open: Option<(usize, usize, usize, usize)> = None;
        for column in 0..count.0 {
            let x = at(column, x0, grain.0);
            let far = |i: usize| (points[i].0 - x).hypot(points[i].1 - y);
            let owner =
                near.iter().copied().filter(|i| far(*i) <= reach).min_by(|a, b| far(*a).total_cmp(&far(*b)));
            match (&mut open, owner) {
                (Some(stretch), Some(owner)) if stretch.0 == owner => stretch.3 = column,
                (_, owner) => {
                    found.extend(open.take());
                    open = owner.map(|owner| (owner, row, column, column));
                }
            }
        }
        found.extend(open);
    }
    found
}

/// Cells of points within these ranges of axes; those without a colour stay white.
fn draw_cells(
    chart: &mut Chart<'_, '_>,
    points: &[(f64, f64)],
    (x, y): ((f64, f64), (f64, f64)),
    colour: impl Fn(usize) -> Option<RGBColor>,
) -> Result<(), Failure> {
    let (wide, high) = chart.plotting_area().dim_in_pixel();
    let count = ((wide / GRAIN).max(1) as usize, (high / GRAIN).max(1) as usize);
    let edge = |i: usize, (low, high): (f64, f64), of: usize| low + (high - low) * i as f64 / of as f64;
    let shown = cells(points, (x, y), count)
        .into_iter()
        .filter_map(|(point, row, first, last)| Some((colour(point)?, row, first, last)));
    chart.draw_series(shown.map(|(colour, row, first, last)| {
        let corners = [
            (edge(first, x, count.0), edge(row, y, count.1)),
            (edge(last + 1, x, count.0), edge(row + 1, y, count.1)),
        ];
        Rectangle::new(corners, colour.filled())
    }))?;
    Ok(())
}

fn draw(
    axes: &Axes,
    name: &str,
    points: &[(f64, f64)],
    values: &[f64],
    taxels: &[(f64, f64)],
    scale: &Scale,
) -> Result<String> {
    let (width, height) = SIZE;
    let span = points.iter().flat_map(|p| [p.0.abs(), p.1.abs()]).fold(1e-4, f64::max) * 1.06;
    let known = |i: usize| values.get(i).copied().filter(|v| v.is_finite());
    svg((width + BAR, height), |root| {
        let (left, right) = root.split_horizontally(width);
        if !(0..points.len()).any(|i| known(i).is_some()) {
            return nothing(&left, axes, name);
        }
        let range = (-span, span);
        let mut chart = frame(&left, axes, range, range, false)?;
        draw_cells(&mut chart, points, (range, range), |i| Some(scale.colour(known(i)?)))?;
        // Black on white, so that they show on every colour.
        chart.draw_series(taxels.iter().map(|p| Cross::new(*p, 4, WHITE.stroke_width(3))))?;
        chart.draw_series(taxels.iter().map(|p| Cross::new(*p, 4, BLACK.stroke_width(1))))?;
        scale.bar(&right, name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_belongs_to_the_nearest_point() {
        let points: Vec<(f64, f64)> =
            (0..25).map(|i| (f64::from(i % 5) - 2.0, f64::from(i / 5) - 2.0)).collect();
        let found = cells(&points, ((-3.0, 3.0), (-3.0, 3.0)), (60, 60));
        // A pixel is a tenth wide: a cell of one square unit has a hundred of them.
        let pixels = |point: usize| -> usize {
            found.iter().filter(|c| c.0 == point).map(|(.., first, last)| last + 1 - first).sum()
        };
        assert_eq!(pixels(12), 100);
        let mut taken = std::collections::BTreeSet::new();
        for (_, row, first, last) in &found {
            assert!((*first..=*last).all(|column| taken.insert((*row, column))), "cells overlap");
        }
        // Nothing is coloured beyond the reach of the outermost points.
        assert!(!taken.contains(&(0, 0)) && !taken.contains(&(59, 30)));
    }
}
