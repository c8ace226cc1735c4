//! Errors of maps and of the contacts in them: for people, and as figures that can be required.

use std::collections::BTreeMap;
use std::fmt;

use crate::metrics::{ContactsRead, MapContacts, MapErrors, MapPart, Spread, StrongestErrors, StrongestPart};

/// Errors of maps, for people: micrometres and millinewtons a point, newtons in all.
pub(super) fn write(f: &mut fmt::Formatter<'_>, maps: &BTreeMap<String, MapErrors>) -> fmt::Result {
    if maps.is_empty() {
        return Ok(());
    }
    writeln!(
        f,
        "  {:<28}{:>4}{:>12}{:>14}{:>16}{:>9}{:>12}",
        "maps, over all points", "", "RMS", "of the truth", "total force [N]", "frames", "unanswered"
    )?;
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".into());
    for (name, errors) in maps {
        let (unit, factor) = shown(&errors.unit);
        for (what, part) in [("touched", &errors.touched), ("untouched", &errors.untouched)] {
            let MapPart { frames, unanswered, rms, relative, total_force } = part;
            if frames + unanswered == 0 {
                continue;
            }
            writeln!(
                f,
                "  {:<28}{unit:>4}{:>12}{:>14}{:>16}{frames:>9}{unanswered:>12}",
                format!("{name} {what}"),
                or_dash(rms.map(|v| format!("{:.3}", v * factor))),
                or_dash(relative.map(|v| format!("{:.1} %", v * 100.0))),
                or_dash(total_force.map(|v| format!("{v:.3}"))),
            )?;
        }
    }
    by_number(f, maps)?;
    for (name, errors) in maps {
        errors.contacts.iter().try_for_each(|of| contacts(f, name, of))?;
        errors.strongest.iter().try_for_each(|of| strongest(f, name, of))?;
    }
    Ok(())
}

/// One contact by the strongest points of a map: medians in millimetres, newtons and degrees.
fn strongest(f: &mut fmt::Formatter<'_>, name: &str, of: &StrongestErrors) -> fmt::Result {
    writeln!(f, "  one contact by the {} strongest points of {name}, medians", StrongestErrors::POINTS)?;
    writeln!(
        f,
        "    {:<12}{:>8}{:>16}{:>12}{:>16}{:>12}{:>20}",
        "from [N]", "frames", "position [mm]", "force [N]", "amplitude [N]", "angle [°]", "wide [mm]"
    )?;
    let row = |f: &mut fmt::Formatter<'_>, name: &str, part: &StrongestPart| {
        let [most, least] = part.diameters.map(|d| d * 1e3);
        writeln!(
            f,
            "    {name:<12}{:>8}{:>16.2}{:>12.3}{:>16.3}{:>12.1}{:>20}",
            part.frames,
            part.position * 1e3,
            part.force,
            part.amplitude,
            part.angle.to_degrees(),
            format!("{most:.1} and {least:.1}"),
        )
    };
    of.by_force.iter().try_for_each(|part| row(f, &part.from.to_string(), part))?;
    row(f, "all", &of.all)?;
    let [most, least] = StrongestErrors::THRESHOLDS;
    writeln!(
        f,
        "    wide: as a circle of the area whose points have more than {most} N, and {least} N, each"
    )?;
    if of.left_out > 0.0 {
        let share = of.left_out * 100.0;
        writeln!(f, "    {share:.1} % of the touched frames are left out: not one contact of known force")?;
    }
    Ok(())
}

/// A unit that errors of one point are read in, and its factor.
fn shown(unit: &str) -> (&str, f64) {
    match unit {
        "m" => ("µm", 1e6),
        "N" => ("mN", 1e3),
        "V" => ("mV", 1e3),
        other => (other, 1.0),
    }
}

/// Errors of maps for each number of contacts, where there are several.
fn by_number(f: &mut fmt::Formatter<'_>, maps: &BTreeMap<String, MapErrors>) -> fmt::Result {
    for (name, errors) in maps.iter().filter(|(_, errors)| errors.by_number.len() > 1) {
        let (unit, factor) = shown(&errors.unit);
        write!(f, "  {name} RMS [{unit}] (unexplained variance) by number of contacts:")?;
        for (number, of) in &errors.by_number {
            let share = of.fvu.map_or_else(|| "-".into(), |fvu| format!("{:.1} %", fvu * 100.0));
            write!(f, "  {number}: {:.3} ({share})", of.rms * factor)?;
        }
        writeln!(f)?;
    }
    Ok(())
}

/// Contacts that were read off a map: shares in percent, mean ± standard deviation; locations in millimetres.
fn contacts(f: &mut fmt::Formatter<'_>, name: &str, of: &MapContacts) -> fmt::Result {
    writeln!(
        f,
        "  contacts of {name}: largest in a disc of {} mm that bears {} N or more",
        of.disc * 1e3,
        of.threshold
    )?;
    writeln!(
        f,
        "    {:<7}{:>8}{:>9}{:>8}{:>14}{:>16}{:>16}{:>16}{:>12}{:>14}{:>14}",
        "true",
        "frames",
        "found",
        "right",
        "number [%]",
        "position [mm]",
        "found [mm]",
        "nearest [mm]",
        "force [N]",
        "force [%]",
        "diameter [%]"
    )?;
    for (number, read) in &of.by_number {
        row(f, &number.to_string(), read)?;
    }
    if of.by_number.len() > 1 {
        row(f, "all", &of.all)?;
    }
    if of.all.found < of.all.contacts {
        let lost = 1.0 - of.all.found as f64 / of.all.contacts as f64;
        writeln!(
            f,
            "    {:.1} % of the true contacts were not found: `position` has their distance to the middle of the surface, `force [N]` \
             a force of 0; the other columns leave them out",
            lost * 100.0
        )?;
    }
    if let Some(share) = of.left_out.filter(|share| *share > 0.0) {
        let share = share * 100.0;
        writeln!(f, "    {share:.1} % of the frames are left out: a true contact is lighter than requested")?;
    }
    if let Some(wrong) = of.untouched {
        writeln!(f, "    contacts a frame where nothing touches: {wrong:.3}")?;
    }
    Ok(())
}

fn row(f: &mut fmt::Formatter<'_>, name: &str, read: &ContactsRead) -> fmt::Result {
    let with = |spread: Option<Spread>, factor: f64, digits: usize| {
        spread.map_or_else(
            || "-".to_owned(),
            |s| format!("{:.digits$} ± {:.digits$}", s.mean * factor, s.deviation * factor),
        )
    };
    writeln!(
        f,
        "    {name:<7}{:>8}{:>8.1}%{:>7.1}%{:>14}{:>16}{:>16}{:>16}{:>12}{:>14}{:>14}",
        read.frames,
        100.0 * read.found as f64 / read.contacts.max(1) as f64,
        100.0 * read.number_right,
        with(read.number, 100.0, 0),
        with(read.position, 1e3, 1),
        with(read.position_found, 1e3, 1),
        with(read.position_nearest, 1e3, 1),
        read.force_rms.map_or_else(|| "-".into(), |v| format!("{v:.2}")),
        with(read.force, 100.0, 0),
        with(read.diameter, 100.0, 0),
    )
}

/// Adds what a requirement can name.
pub(super) fn figures(maps: &BTreeMap<String, MapErrors>, all: &mut BTreeMap<String, f64>) {
    for (name, errors) in maps {
        let name = name.replace('.', "_");
        for (part, what) in [(&errors.touched, ""), (&errors.untouched, "untouched_")] {
            let values = [("rms", part.rms), ("relative", part.relative), ("total_force", part.total_force)];
            let known = values.into_iter().filter_map(|(figure, v)| Some((figure, v?)));
            all.extend(known.map(|(figure, v)| (format!("{name}_{what}{figure}"), v)));
        }
        let unanswered = errors.touched.unanswered + errors.untouched.unanswered;
        let targets = errors.touched.frames + errors.untouched.frames + unanswered;
        all.insert(format!("{name}_unanswered"), unanswered as f64 / targets.max(1) as f64);
        for (number, of) in &errors.by_number {
            all.extend(of.fvu.map(|fvu| (format!("{name}_fvu_of_{number}"), fvu)));
        }
        if let Some(of) = &errors.strongest {
            let StrongestPart { position, force, amplitude, angle, .. } = of.all;
            let medians =
                [("position", position), ("force", force), ("amplitude", amplitude), ("angle", angle)];
            all.extend(medians.map(|(what, median)| (format!("{name}_strongest_{what}_median"), median)));
        }
        for of in &errors.contacts {
            let name = format!("{name}_{}n", of.threshold.to_string().replace('.', "_"));
            figures_of(&name, &of.all, all);
            of.by_number.iter().for_each(|(n, read)| figures_of(&format!("{name}_of_{n}"), read, all));
        }
    }
}

fn figures_of(name: &str, read: &ContactsRead, all: &mut BTreeMap<String, f64>) {
    let means = [
        ("number", read.number),
        ("position", read.position),
        ("position_found", read.position_found),
        ("position_nearest", read.position_nearest),
        ("force", read.force),
        ("diameter", read.diameter),
    ];
    let known = means.into_iter().filter_map(|(what, spread)| Some((what, spread?.mean)));
    all.extend(known.map(|(what, mean)| (format!("{name}_{what}_mean"), mean)));
    all.insert(format!("{name}_number_right"), read.number_right);
    all.extend(read.force_rms.map(|rms| (format!("{name}_force_rms"), rms)));
}

#[cfg(test)]
mod tests {
    use dermis_skin::{Surface, SurfaceSpec};

    use crate::dataset::tests::contact;
    use crate::metrics::{ContactsOfMaps, MapErrors, MapOfNumber, MapPart, MapReading, Scores};
    use crate::{Evaluation, StrongestErrors, StrongestPart, Truth, TruthContact};

    /// One to three contacts, of which maps hold nine tenths of the force 8 mm beside it; the last one is not in them.
    fn made_up() -> Evaluation {
        let surface = Surface::from_spec(&SurfaceSpec::Rectangle { size: [0.5, 0.5], spacing: 0.004 });
        let mut contacts =
            ContactsOfMaps::new(&surface, MapReading { least_force: 4.0, ..MapReading::default() });
        let locations = [(-0.1, 0.1), (0.1, -0.1), (0.12, 0.14)];
        for number in 1..=3 {
            let true_ones = locations[..number]
                .iter()
                .map(|(x, y)| TruthContact { diameter: 0.02, ..contact(*x, *y, 20.0) });
            let truth = Truth { press: 1, location: 1, idle: false, contacts: true_ones.collect() };
            let mut map = vec![0.0; surface.points.len()];
            for (x, y) in &locations[..number.min(2)] {
                let inside = |i: &usize| {
                    let p = surface.points[*i];
                    (p.x - x - 0.008).hypot(p.y - y) <= 0.010 + 1e-9
                };
                let near: Vec<usize> = (0..map.len()).filter(inside).collect();
                near.iter().for_each(|i| map[*i] = 18.0 / near.len() as f64);
            }
            contacts.push(&truth, &map);
        }
        contacts.push(
            &Truth { press: 0, location: 0, idle: true, contacts: Vec::new() },
            &vec![0.0; surface.points.len()],
        );
        let of = |rms, fvu| MapOfNumber { frames: 1, rms, fvu };
        let errors = MapErrors {
            unit: "N".into(),
            touched: MapPart { frames: 3, rms: Some(0.0123), ..MapPart::default() },
            untouched: MapPart::default(),
            by_number: [(1, of(0.0123, Some(0.25))), (2, of(0.0234, None)), (3, of(0.03, Some(0.5)))].into(),
            contacts: contacts.finish(),
            strongest: Some(StrongestErrors {
                left_out: 0.5,
                all: StrongestPart {
                    from: 0.0,
                    frames: 3,
                    position: 0.6e-3,
                    force: 0.09,
                    amplitude: 0.08,
                    angle: 0.17,
                    diameters: [4.8e-3, 5.6e-3],
                },
                by_force: Vec::new(),
            }),
            channels: None,
            examples: Vec::new(),
        };
        let mut evaluation = Evaluation::of(&Scores::default(), "made up", 3, 0, 0);
        evaluation.maps.insert("map.normal".into(), errors);
        evaluation
    }

    #[test]
    fn people_read_contacts_of_maps() {
        insta::assert_snapshot!(made_up(), @r"
        made up: 3 frames
                                            RMS       95 % interval     mean   median      p95   frames
          maps, over all points                    RMS  of the truth total force [N]   frames  unanswered
          map.normal touched            mN      12.300             -               -        3           0
          map.normal RMS [mN] (unexplained variance) by number of contacts:  1: 12.300 (25.0 %)  2: 23.400 (-)  3: 30.000 (50.0 %)
          contacts of map.normal: largest in a disc of 64 mm that bears 5 N or more
            true     frames    found   right    number [%]   position [mm]      found [mm]    nearest [mm]   force [N]     force [%]  diameter [%]
            1             1   100.0%  100.0%         0 ± 0       8.0 ± 0.0       8.0 ± 0.0       8.0 ± 0.0        2.00       -10 ± 0       -10 ± 0
            2             1   100.0%  100.0%         0 ± 0       8.0 ± 0.0       8.0 ± 0.0       8.0 ± 0.0        2.00       -10 ± 0       -10 ± 0
            3             1    66.7%    0.0%       -33 ± 0     66.8 ± 83.2       8.0 ± 0.0     77.2 ± 97.9       11.66       -10 ± 0       -10 ± 0
            all           3    83.3%   66.7%      -11 ± 16     37.4 ± 65.7       8.0 ± 0.0     42.6 ± 77.4        8.37       -10 ± 0       -10 ± 0
            16.7 % of the true contacts were not found: `position` has their distance to the middle of the surface, `force [N]` a force of 0; the other columns leave them out
            contacts a frame where nothing touches: 0.000
          contacts of map.normal: largest in a disc of 64 mm that bears 2.5 N or more
            true     frames    found   right    number [%]   position [mm]      found [mm]    nearest [mm]   force [N]     force [%]  diameter [%]
            1             1   100.0%  100.0%         0 ± 0       8.0 ± 0.0       8.0 ± 0.0       8.0 ± 0.0        2.00       -10 ± 0       -10 ± 0
            2             1   100.0%  100.0%         0 ± 0       8.0 ± 0.0       8.0 ± 0.0       8.0 ± 0.0        2.00       -10 ± 0       -10 ± 0
            3             1    66.7%    0.0%       -33 ± 0     66.8 ± 83.2       8.0 ± 0.0     77.2 ± 97.9       11.66       -10 ± 0       -10 ± 0
            all           3    83.3%   66.7%      -11 ± 16     37.4 ± 65.7       8.0 ± 0.0     42.6 ± 77.4        8.37       -10 ± 0       -10 ± 0
            16.7 % of the true contacts were not found: `position` has their distance to the middle of the surface, `force [N]` a force of 0; the other columns leave them out
            contacts a frame where nothing touches: 0.000
          one contact by the 20 strongest points of map.normal, medians
            from [N]      frames   position [mm]   force [N]   amplitude [N]   angle [°]           wide [mm]
            all                3            0.60       0.090           0.080         9.7         4.8 and 5.6
            wide: as a circle of the area whose points have more than 0.02 N, and 0.01 N, each
            50.0 % of the touched frames are left out: not one contact of known force
        ");
    }

    #[test]
    fn every_figure_of_contacts_can_be_required() {
        let evaluation = made_up();
        let figures = evaluation.figures();
        let of =
            |name: &str| figures.get(name).copied().unwrap_or_else(|| panic!("no {name} in {figures:?}"));
        approx::assert_relative_eq!(of("map_normal_5n_of_2_position_found_mean"), 0.008, max_relative = 1e-9);
        approx::assert_relative_eq!(of("map_normal_5n_force_mean"), -0.1, max_relative = 1e-9);
        approx::assert_relative_eq!(of("map_normal_2_5n_of_3_number_mean"), -1.0 / 3.0, max_relative = 1e-9);
        approx::assert_relative_eq!(of("map_normal_5n_number_right"), 2.0 / 3.0, max_relative = 1e-9);
        approx::assert_relative_eq!(of("map_normal_fvu_of_3"), 0.5, max_relative = 1e-9);
        assert!(!figures.contains_key("map_normal_fvu_of_2"), "it is not known");
        let again: Evaluation = serde_json::from_value(evaluation.to_json()).unwrap();
        let read = again.figures();
        assert!(read.len() > 50 && read.keys().eq(figures.keys()), "{read:?}");
        // JSON keeps all digits but the last.
        for (name, value) in &figures {
            assert!((read[name] - value).abs() <= 1e-12 * value.abs(), "{name}");
        }
    }
}
