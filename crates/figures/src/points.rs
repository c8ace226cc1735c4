//! Clouds of points, and lines from where something is to where it was said to be.

use plotters::prelude::*;

use crate::axis::range;
use crate::scale::{BAR, Scale};
use crate::{
    Area, Axes, COLOURS, Curve, Failure, Pen, Result, beside, draw_legend, draw_series, frame, nothing, svg,
};

/// Points of one kind. Those that are not finite are left out.
#[derive(Debug, Clone, Default)]
pub struct Dots {
    /// Empty: it has no entry in the legend.
    pub name: String,
    /// In the units of the axes.
    pub points: Vec<(f64, f64)>,
    /// How large each is, from 0 to 1; all are small where this is empty.
    pub sizes: Vec<f64>,
    /// Their colour.
    pub colour: RGBColor,
}

impl Dots {
    /// Small points of the n-th colour.
    pub fn new(name: impl Into<String>, n: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, sizes: Vec::new(), colour: COLOURS[n % COLOURS.len()] }
    }
}

/// Points over curves; the legend stands beside them. Points let through what lies under them, so that many look darker than
/// one.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn dots(axes: &Axes, groups: &[Dots], under: &[Curve]) -> Result<String> {
    let (width, height) = axes.size();
    let mut legend: Vec<Curve> = under.to_vec();
    legend.extend(groups.iter().map(|group| Curve {
        name: group.name.clone(),
        points: Vec::new(),
        colour: group.colour,
        pen: Pen::Mark,
    }));
    let right = beside(&legend);
    svg((width + right, height), |root| {
        let (left, right_side) = root.split_horizontally(width);
        let of_groups = groups.iter().flat_map(|group| group.points.iter());
        let all = || under.iter().flat_map(|c| &c.points).chain(of_groups.clone());
        let x = range(all().map(|p| p.0), axes.x_range, false);
        let y = range(all().map(|p| p.1), axes.y_range, false);
        let any = all().any(|p| p.0.is_finite() && p.1.is_finite());
        let (Some(x), Some(y), true) = (x, y, any) else { return nothing(&left, axes, &axes.y) };
        let mut chart = frame(&left, axes, x, y, true)?;
        draw_series(&mut chart, axes, under)?;
        for group in groups {
            let finite = |(_, p): &(usize, &(f64, f64))| p.0.is_finite() && p.1.is_finite();
            chart.draw_series(group.points.iter().enumerate().filter(finite).map(|(i, point)| {
                let share = group.sizes.get(i).copied().unwrap_or(0.2);
                let radius = 1 + (3.0 * share.clamp(0.0, 1.0).sqrt()).round() as i32;
                Circle::new(*point, radius, group.colour.mix(0.6).filled())
            }))?;
        }
        if right > 0 { draw_legend(&right_side, &legend) } else { Ok(()) }
    })
}

/// From a point to another one, in the units of the axes.
pub type Segment = [(f64, f64); 2];

/// A line from each first point, which has a dot, to its second one; the colour is that of a value. A line that leaves the axes
/// ends at their edge.
///
/// # Errors
///
/// Where the figure cannot be drawn.
pub fn segments(axes: &Axes, name: &str, pairs: &[Segment], values: &[f64]) -> Result<String> {
    let (width, height) = axes.size();
    let scale = Scale::of(values.iter().copied());
    svg((width + BAR, height), |root| {
        let (left, right) = root.split_horizontally(width);
        if !pairs.iter().zip(values).any(known) {
            return nothing(&left, axes, &axes.y);
        }
        draw_segments(&left, axes, pairs, values, &scale)?;
        scale.bar(&right, name)
    })
}

/// Whether a line and its value are of finite numbers.
fn known((ends, value): (&Segment, &f64)) -> bool {
    ends.iter().all(|p| p.0.is_finite() && p.1.is_finite()) && value.is_finite()
}

fn draw_segments(
    root: &Area<'_>,
    axes: &Axes,
    pairs: &[Segment],
    values: &[f64],
    scale: &Scale,
) -> Result<(), Failure> {
    let x = range(pairs.iter().flat_map(|[a, b]| [a.0, b.0]), axes.x_range, false);
    let y = range(pairs.iter().flat_map(|[a, b]| [a.1, b.1]), axes.y_range, false);
    let (Some(x), Some(y)) = (x, y) else { return nothing(root, axes, &axes.y) };
    let mut chart = frame(root, axes, x, y, true)?;
    let shown = || pairs.iter().zip(values).filter(|pair| known(*pair));
    chart.draw_series(shown().map(|([from, to], v)| {
        PathElement::new([*from, cut([*from, *to], x, y)], scale.colour(*v).stroke_width(1))
    }))?;
    chart.draw_series(shown().map(|([from, _], v)| Circle::new(*from, 2, scale.colour(*v).filled())))?;
    Ok(())
}

/// Where a line that begins within these ranges ends, or leaves them.
fn cut([from, to]: Segment, x: (f64, f64), y: (f64, f64)) -> (f64, f64) {
    let share = |from: f64, to: f64, (low, high): (f64, f64)| {
        let edge = if to > high { high } else { low };
        if (low..=high).contains(&to) { 1.0 } else { (edge - from) / (to - from) }
    };
    let share = share(from.0, to.0, x).min(share(from.1, to.1, y)).clamp(0.0, 1.0);
    (from.0 + share * (to.0 - from.0), from.1 + share * (to.1 - from.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::numbers;

    #[test]
    fn every_point_is_drawn_once_and_larger_ones_are_larger() {
        let points = vec![(0.0, 0.0), (1.0, 1.0), (2.0, f64::NAN)];
        let groups = [
            Dots { sizes: vec![0.0, 1.0, 0.5], ..Dots::new("pressed", 0, points) },
            Dots::new("", 1, vec![(0.5, 0.5)]),
        ];
        let drawn = dots(&Axes::new("t", "x", "y"), &groups, &[]).unwrap();
        // Two of the first group, one of the second, and the legend of the first.
        assert_eq!(numbers(&drawn, "circle", "r")[..3], [1.0, 4.0, 2.0]);
        assert_eq!(drawn.matches("<circle ").count(), 4);
        assert!(!drawn.contains("NaN"));
        assert!(dots(&Axes::new("t", "x", "y"), &[], &[]).is_ok());
    }

    #[test]
    fn lines_end_at_the_edge() {
        let (x, y) = ((0.0, 10.0), (0.0, 5.0));
        assert_eq!(cut([(1.0, 1.0), (2.0, 3.0)], x, y), (2.0, 3.0));
        assert_eq!(cut([(0.0, 0.0), (20.0, 5.0)], x, y), (10.0, 2.5));
        assert_eq!(cut([(4.0, 4.0), (0.0, -4.0)], x, y), (2.0, 0.0));
    }

    #[test]
    fn distances_are_true_on_equal_axes() {
        let pairs = [[(0.0, 0.0), (0.0, 4.0)], [(10.0, 0.0), (14.0, 0.0)], [(0.0, 0.0), (f64::NAN, 0.0)]];
        let all = pairs.iter().flatten().copied();
        let drawn =
            segments(&Axes::new("t", "x", "y").equal(all), "error [mm]", &pairs, &[4.0, 4.0, 1.0]).unwrap();
        assert_eq!(drawn.matches("<circle ").count(), 2);
        let (x, y) = (numbers(&drawn, "circle", "cx"), numbers(&drawn, "circle", "cy"));
        // Both begin at y = 0, ten units apart.
        assert!((y[0] - y[1]).abs() <= 1.0 && x[1] > x[0], "{x:?} {y:?}");
        let per_unit = (x[1] - x[0]) / 10.0;
        assert!((20.0..35.0).contains(&per_unit), "{per_unit}");
        assert!(!drawn.contains("NaN"));
    }
}
