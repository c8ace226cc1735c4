//! Values as colours.
//!
//! Magnitudes are shown by viridis, whose lightness rises evenly, so that equal steps look equal, also in grey and to eyes that
//! see red and green alike. Signed values are shown from blue over white to red, white at 0 and as far to either side.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::FontTransform;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::axis::{Scaled, place};
use crate::{Failure, label};

/// \[pixels\] beside the axes.
pub(crate) const BAR: u32 = 96;

/// Anchors of viridis, from dark to light.
const MAGNITUDE: [u32; 9] = [
    0x44_01_54, 0x47_2d_7b, 0x3b_52_8b, 0x2c_72_8e, 0x21_91_8c, 0x28_ae_80, 0x5e_c9_62, 0xad_dc_30,
    0xfd_e7_25,
];
/// Anchors from blue over white to red.
const SIGNED: [u32; 9] = [
    0x21_66_ac, 0x43_93_c3, 0x92_c5_de, 0xd1_e5_f0, 0xf7_f7_f7, 0xfd_db_c7, 0xf4_a5_82, 0xd6_60_4d,
    0xb2_18_2b,
];

/// The colour at a share from 0 to 1 of a map, between its anchors.
fn between(anchors: &[u32; 9], share: f64) -> RGBColor {
    let at = share.clamp(0.0, 1.0) * 8.0;
    let low = (at as usize).min(7);
    let channel = |shift: u32| {
        let of = |anchor: u32| f64::from((anchor >> shift) & 0xff);
        let (a, b) = (of(anchors[low]), of(anchors[low + 1]));
        (a + (b - a) * (at - low as f64)).round() as u8
    };
    RGBColor(channel(16), channel(8), channel(0))
}

/// Which value has which colour: on a logarithmic scale where all are positive and far apart, from blue to red where they have
/// both signs.
pub(crate) struct Scale {
    /// Ends of the bar: logarithms where `log`.
    low: f64,
    high: f64,
    /// What the first and the last colour stand for; the bar lies between them.
    ends: [f64; 2],
    log: bool,
    signed: bool,
}

impl Scale {
    pub(crate) fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let known = values.filter(|v| v.is_finite());
        let low = known.clone().fold(f64::INFINITY, f64::min);
        let high = known.fold(f64::NEG_INFINITY, f64::max);
        if low < 0.0 && high > 0.0 {
            return Self::within([low, high], high);
        }
        let log = low > 0.0 && high > 3.0 * low;
        Self::magnitude(place(low, log), place(high, log), log)
    }

    /// A linear scale from the first to the second value; the last colour stands for `full` where that is farther from 0.
    pub(crate) fn within([low, high]: [f64; 2], full: f64) -> Self {
        if low < 0.0 && high > 0.0 {
            let most = high.max(-low);
            let full = most.max(full);
            return Self { low: -most, high: most, ends: [-full, full], log: false, signed: true };
        }
        let scale = Self::magnitude(low, high, false);
        Self { ends: [scale.low, scale.high.max(full)], ..scale }
    }

    /// From the least to the largest magnitude, which may be the same one.
    fn magnitude(low: f64, high: f64, log: bool) -> Self {
        // Where nothing is known, nothing is drawn: see `nothing`.
        let (low, high) = if low.is_finite() && high.is_finite() { (low, high) } else { (0.0, 1.0) };
        let high = if high > low { high } else { low + (low.abs() * 1e-3).max(1e-12) };
        Self { low, high, ends: [low, high], log, signed: false }
    }

    fn map(&self) -> &'static [u32; 9] {
        if self.signed { &SIGNED } else { &MAGNITUDE }
    }

    pub(crate) fn colour(&self, value: f64) -> RGBColor {
        self.at(place(value, self.log))
    }

    /// The colour at a place of the scale.
    fn at(&self, place: f64) -> RGBColor {
        let [first, last] = self.ends;
        between(self.map(), (place - first) / (last - first))
    }

    /// The bar, its ticks to the right of it, and the name beyond them.
    pub(crate) fn bar<D: DrawingBackend>(
        &self,
        area: &DrawingArea<D, Shift>,
        name: &str,
    ) -> Result<(), Failure>
    where
        D::ErrorType: 'static,
    {
        let height = area.dim_in_pixel().1 as i32;
        let (top, bottom) = (34, height - 48);
        let (left, right) = (8, 24);
        let steps = 64;
        let at = |share: f64| bottom + (f64::from(top - bottom) * share).round() as i32;
        for i in 0..steps {
            let share = |k: i32| f64::from(k) / f64::from(steps);
            let colour = self.at(self.low + (self.high - self.low) * (share(i) + 0.5 / f64::from(steps)));
            area.draw(&Rectangle::new([(left, at(share(i + 1))), (right, at(share(i)))], colour.filled()))?;
        }
        area.draw(&Rectangle::new([(left, top), (right, bottom)], RGBColor(120, 120, 120).stroke_width(1)))?;
        let axis = Scaled::new(self.low, self.high, self.log);
        let labels = axis.labels(self.log);
        for &value in axis.ticks() {
            let y = at((value - self.low) / (self.high - self.low));
            area.draw(&PathElement::new(vec![(right, y), (right + 4, y)], BLACK.stroke_width(1)))?;
            let style = label(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(labels.label(value), (right + 7, y), style))?;
        }
        let style = label(Pos::new(HPos::Center, VPos::Center)).transform(FontTransform::Rotate270);
        area.draw(&Text::new(name.to_owned(), (BAR as i32 - 10, i32::midpoint(top, bottom)), style))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness(colour: RGBColor) -> f64 {
        let linear = |v: u8| (f64::from(v) / 255.0).powf(2.2);
        0.2126 * linear(colour.0) + 0.7152 * linear(colour.1) + 0.0722 * linear(colour.2)
    }

    #[test]
    fn more_is_lighter_and_nothing_is_white() {
        let scale = Scale::of([1.0, 2.0, 2.9].into_iter());
        let all: Vec<f64> = (0..20).map(|i| lightness(scale.colour(1.0 + 0.1 * f64::from(i)))).collect();
        assert!(all.windows(2).all(|w| w[1] > w[0]), "{all:?}");
        let scale = Scale::of([-1.0, 0.25].into_iter());
        assert_eq!(scale.colour(0.0), RGBColor(0xf7, 0xf7, 0xf7));
        // As far to either side: a quarter of the way to red is pale.
        assert!(scale.colour(0.25).1 > 180 && scale.colour(-1.0) == RGBColor(0x21, 0x66, 0xac));
    }
    #[test]
    fn what_is_far_below_the_full_colour_is_pale_on_map_and_bar() {
        let deep = |c: RGBColor| i32::from(c.0) - i32::from(c.1.max(c.2)) > 100;
        let [strong, pale] = [2.0, 10.0].map(|full| Scale::within([-2.0, 2.0], full));
        assert!(deep(strong.colour(2.0)) && !deep(pale.colour(2.0)));
        for (scale, has) in [(strong, true), (pale, false)] {
            let mut bar = String::new();
            let root = SVGBackend::with_string(&mut bar, (BAR, 300)).into_drawing_area();
            scale.bar(&root, "Pa").unwrap();
            drop(root);
            let colours =
                bar.split('#').skip(1).filter_map(|rest| u32::from_str_radix(rest.get(..6)?, 16).ok());
            let channel = |of: u32, shift: u32| ((of >> shift) & 0xff) as u8;
            let mut colours = colours.map(|c| RGBColor(channel(c, 16), channel(c, 8), channel(c, 0)));
            assert_eq!(colours.any(deep), has, "{bar}");
            // The ends of the bar are those of the range all the same.
            assert!(bar.contains(">\n2\n</text>") && !bar.contains(">\n10\n</text>"), "{bar}");
        }
        // A full colour within the range changes nothing.
        assert_eq!(Scale::within([0.0, 3.0], 1.0).colour(3.0), RGBColor(0xfd, 0xe7, 0x25));
    }

    #[test]
    fn one_value_has_a_scale_of_its_size() {
        for value in [5e-9, 1.0, -7e12] {
            let scale = Scale::of(std::iter::once(value));
            assert!(scale.low < scale.high && scale.low <= value && value <= scale.high, "{value}");
            let labels = Scaled::new(scale.low, scale.high, scale.log).labels(scale.log);
            assert!(!labels.label(value).is_empty());
        }
    }
}
