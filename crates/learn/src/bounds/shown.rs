//! Bounds, and errors beside them, as text.

use std::fmt;

use super::{AgainstBound, Bounds, Ratio, RatioBin, Unbounded, Undetermined};
use crate::metrics::Bin;

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line = |name: &str, contacts: &str, bins: &[Bin]| -> fmt::Result {
            let (unit, factor) = if name == "position" { ("mm", 1e3) } else { ("N", 1.0) };
            if bins.is_empty() {
                return Ok(());
            }
            write!(f, "  {name}{contacts} Cramér–Rao bound, RMS (median) [{unit}] by force [N]:")?;
            for bin in bins {
                let to = bin.to.map_or_else(|| "+".to_owned(), |to| format!("-{to}"));
                write!(f, "  {}{to}: {:.3}", bin.from, bin.rms * factor)?;
                if let Some(median) = bin.median {
                    write!(f, " ({:.3})", median * factor)?;
                }
            }
            writeln!(f)
        };
        line("position", "", &self.position)?;
        line("force.normal", "", &self.normal_force)?;
        for (number, several) in &self.several {
            line("position", &format!(" of {number}"), &several.position)?;
            line("force.normal", &format!(" of {number}"), &several.normal_force)?;
        }
        write!(f, "{}", self.left_out)
    }
}

impl fmt::Display for Unbounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = |frames: usize| frames as f64 / self.touched.max(1) as f64 * 100.0;
        for (frames, why) in [
            (self.thinned, "only every n-th frame is bounded"),
            (self.unknown, "place, force or tip of a contact is not known"),
            (self.refused, "the model has no answer, as where a noisy force cell says that a contact pulls"),
            (self.undetermined, "the channels do not determine the contact, the bound is infinite"),
        ] {
            if frames > 0 {
                writeln!(
                    f,
                    "  not held against a bound, {:.1} % of the touched frames: {why}",
                    share(frames)
                )?;
            }
        }
        Ok(())
    }
}

impl AgainstBound {
    /// Rows of a table for people, in millimetres and newtons: name of the bin, and figures.
    fn rows(&self) -> Vec<(String, &Ratio)> {
        let mut rows = of_bins("", &self.all, &self.by_force);
        if let Some(well) = &self.well_determined {
            rows.extend(of_bins(&format!("bound < {} mm, ", well.below * 1e3), &well.all, &well.by_force));
        }
        rows
    }
}

/// Rows of all contacts and of each bin, and below each those that were found, where some were not.
fn of_bins<'a>(which: &str, all: &'a Ratio, bins: &'a [RatioBin]) -> Vec<(String, &'a Ratio)> {
    let name = |b: &RatioBin| b.to.map_or(format!("{}+ N", b.from), |to| format!("{}-{to} N", b.from));
    let bins = bins.iter().map(|b| (format!("{which}{}", name(b)), &b.ratio));
    let rows = std::iter::once((format!("{which}all"), all)).chain(bins);
    rows.flat_map(|(name, ratio)| {
        let found = ratio.found.as_deref().map(|found| (format!("{name}, found"), found));
        std::iter::once((name, ratio)).chain(found)
    })
    .collect()
}

impl Undetermined {
    /// One line: how many, of these and of `bounded` others, and where; errors are multiplied by `factor`.
    fn line(&self, bounded: usize, factor: f64) -> String {
        let all = self.all;
        let by_force = self.by_force.iter().map(|b| {
            let to = b.to.map_or_else(|| "+".to_owned(), |to| format!("-{to}"));
            format!("{}{to} N {} ({:.1} %)", b.from, b.uncounted.contacts, b.uncounted.share * 100.0)
        });
        let by_force = by_force.collect::<Vec<_>>().join(", ");
        format!(
            "left out, the bound is infinite: {} of {} contacts ({:.1} %), error RMS {}; of {by_force}",
            all.contacts,
            all.contacts + bounded,
            all.share * 100.0,
            short(all.error_rms * factor)
        )
    }
}

/// A number that leaves room to its neighbour in a table: bounds of contacts that no reading tells apart have no end.
fn short(value: f64) -> String {
    match value.abs() {
        v if v < 1e3 || v.is_nan() => format!("{value:.3}"),
        v if v < 1e6 => format!("{value:.0}"),
        _ => format!("{value:.0e}"),
    }
}

impl fmt::Display for AgainstBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, factor) = if self.unit == "m" { ("mm", 1e3) } else { (self.unit.as_str(), 1.0) };
        let of =
            if self.contacts == 1 { "one contact".to_owned() } else { format!("{} contacts", self.contacts) };
        writeln!(f, "  {} [{unit}] beside its Cramér–Rao bound, the same frames of {of}", self.quantity)?;
        writeln!(
            f,
            "  {:<34}{:>9}{:>11}{:>10}{:>9}{:>9}{:>9}{:>9}{:>8}{:>14}",
            "",
            "contacts",
            "not found",
            "error RMS",
            "stated",
            "bound",
            "ratio",
            "median",
            "bound",
            "median ratio"
        )?;
        for (name, r) in self.rows() {
            let [error, bound, median, of] = [r.error_rms, r.bound_rms, r.error_median, r.bound_median];
            writeln!(
                f,
                "  {name:<34}{:>9}{:>9.2} %{:>10}{:>9}{:>9}{:>9.2}{:>9}{:>8}{:>14.2}",
                r.samples,
                r.not_found * 100.0,
                short(error * factor),
                r.stated_rms.map_or_else(|| "-".to_owned(), |stated| short(stated * factor)),
                short(bound * factor),
                r.ratio_of_rms,
                short(median * factor),
                short(of * factor),
                r.median_ratio
            )?;
        }
        let Some(open) = &self.undetermined else { return Ok(()) };
        writeln!(f, "  {}", open.line(self.all.samples, factor))
    }
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn every_number_leaves_room_to_its_neighbour() {
        let shown = [0.0, 45.376_9, 999.999_4, 1200.4, 908_872.986, 6.216_508e9, f64::NAN].map(short);
        assert_eq!(shown, ["0.000", "45.377", "999.999", "1200", "908873", "6e9", "NaN"]);
        assert!(shown.iter().all(|text| text.len() < 8));
    }
}
