//! Maps of surfaces that are laid flat: every point has the cell that is nearer to it than to any other point.

use plotters::prelude::*;

use crate::scale::{BAR, Scale};
use crate::{Axes, Result, frame, svg};

/// \[pixels\] of the axes.
pub(crate) const SIZE: (u32, u32) = (430, 430);
/// \[pixels\] that cells are rounded to.
const GRAIN: u32 = 3;
/// Distances between points that a cell reaches: half of the diagonal of a square, and a little.
const REACH: f64 = 0.8;

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

/// As [`surface`], with colours from the first to the second value of `range`, whatever the values are.
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
) -> Result<String> {
    draw(axes, name, points, values, &[], &Scale::within(range))
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

/// Stretches of rows that belong to one point: its index, the row, and the first and last column.
fn cells(points: &[(f64, f64)], span: f64, count: (usize, usize)) -> Vec<(usize, usize, usize, usize)> {
    let reach = REACH * apart(points);
    let at = |i: usize, of: usize| span * (2.0 * (i as f64 + 0.5) / of as f64 - 1.0);
    let mut found = Vec::new();
    for row in 0..count.1 {
        let y = at(row, count.1);
        let near: Vec<usize> = (0..points.len()).filter(|i| (points[*i].1 - y).abs() <= reach).collect();
        let mut open: Option<(usize, usize, usize, usize)> = None;
        for column in 0..count.0 {
            let x = at(column, count.0);
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
    svg((width + BAR, height), |root| {
        let (left, right) = root.split_horizontally(width);
        let mut chart = frame(&left, axes, (-span, span), (-span, span), false)?;
        let (wide, high) = chart.plotting_area().dim_in_pixel();
        let count = ((wide / GRAIN).max(1) as usize, (high / GRAIN).max(1) as usize);
        let edge = |i: usize, of: usize| span * (2.0 * i as f64 / of as f64 - 1.0);
        let shown = cells(points, span, count).into_iter().filter(|c| values[c.0].is_finite());
        chart.draw_series(shown.map(|(point, row, first, last)| {
            let corners = [
                (edge(first, count.0), edge(row, count.1)),
                (edge(last + 1, count.0), edge(row + 1, count.1)),
            ];
            Rectangle::new(corners, scale.colour(values[point]).filled())
        }))?;
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
        let found = cells(&points, 3.0, (60, 60));
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
