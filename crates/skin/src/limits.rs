//! How large, how many and how far apart: what a skin description may say before anything is computed from it.
//!
//! Problem: every number of a skin file goes into sizes of tables, numbers of points and steps of time. A length of 1e300 m or a
//! noise of 1e-300 passes any test for "positive", and then fills the memory, runs for hours, or makes every reading a contact.
//!
//! Solution: each quantity has limits that lie far outside of any skin that can be built, and a sentence.

use std::collections::BTreeMap;

use crate::description::{SkinDescription, SurfaceSpec, Taxel};

/// Field, and what is wrong with it.
pub(crate) type Fault = (String, String);

/// \[m\] of lengths that a skin is made of.
const LENGTH: [f64; 2] = [1e-6, 100.0];
/// Elements of a skin.
const TAXELS: usize = 10_000;
/// Numbers of a frame.
const CHANNELS: usize = 3 * TAXELS;
/// Openings of a panel along one direction.
const CELLS: u32 = 1000;
/// Points of a triangulation.
const POINTS: f64 = 1e6;
/// Size of any number whose unit is not known here.
const NUMBER: f64 = 1e15;
/// Components of a direction before it is normalised.
const DIRECTION: f64 = 1e6;
/// \[Hz\] of frames.
pub(crate) const RATE: [f64; 2] = [1e-3, 1e6];
/// \[m\] below which two elements are at one place.
const SAME_PLACE: f64 = 1e-6;

/// Refuses what no skin can be. Signs, and what may not be 0, are for the description itself to check.
pub(crate) fn check(skin: &SkinDescription) -> Result<(), Fault> {
    let c = &skin.condition;
    for (field, value, [low, high], unit) in [
        ("rate", skin.rate, RATE, "Hz"),
        ("noise", skin.noise, [1.0 / NUMBER, NUMBER], &skin.unit),
        ("condition.tare_duration", c.tare_duration, [1e-3, 600.0], "s"),
        ("condition.contact_threshold", c.contact_threshold, [0.1, 1e6], ""),
        ("condition.drift_time", c.drift_time, [1e-3, 1e6], "s"),
        ("condition.stale_time", c.stale_time, [1e-3, 1e4], "s"),
    ] {
        // What is not positive at all has a sentence of its own.
        if value > 0.0 && value.is_finite() && !(low..=high).contains(&value) {
            return Err((field.into(), outside(value, low, high, unit)));
        }
    }
    if c.stuck_time.is_finite() && c.stuck_time > 1e6 {
        return Err(("condition.stuck_time".into(), outside(c.stuck_time, 0.0, 1e6, "s")));
    }
    for (field, value) in [("wire.scale", skin.wire.scale), ("wire.offset", skin.wire.offset)] {
        number(field, value)?;
    }
    for (field, values) in [("range", skin.range)] {
        for value in values.into_iter().flatten() {
            number(field, value)?;
        }
    }
    surface(&skin.surface)?;
    elements(skin)?;
    medium("medium", &toml::Value::Table(skin.medium.clone()))
}

pub(crate) fn outside(value: f64, low: f64, high: f64, unit: &str) -> String {
    let unit = if unit == "1" { "" } else { unit };
    format!("is {value:e} {unit} and must be {low} to {high} {unit}").replace("  ", " ").trim_end().to_owned()
}

/// A number in a unit that is not known here.
fn number(field: &str, value: f64) -> Result<(), Fault> {
    let size = value.abs();
    if size == 0.0 || !size.is_finite() || (1.0 / NUMBER..=NUMBER).contains(&size) {
        return Ok(());
    }
    Err((field.to_owned(), format!("is {value:e} and must be 0, or of a size from 1e-15 to 1e15")))
}

fn surface(spec: &SurfaceSpec) -> Result<(), Fault> {
    let [low, high] = LENGTH;
    let length = |field: &str, value: f64, least: f64| {
        if value > 0.0 && value.is_finite() && !(least..=high).contains(&value) {
            return Err((format!("surface.{field}"), outside(value, least, high, "m")));
        }
        Ok(())
    };
    let (points, spacing) = match *spec {
        SurfaceSpec::Rectangle { size: [x, y], spacing } => {
            length("size[0]", x, low)?;
            length("size[1]", y, low)?;
            ((x / spacing + 2.0) * (y / spacing + 2.0), spacing)
        }
        SurfaceSpec::Dome { radius, cylinder, spacing } => {
            length("radius", radius, low)?;
            length("cylinder", cylinder, low)?;
            let (around, up) =
                (std::f64::consts::TAU * radius, cylinder + std::f64::consts::FRAC_PI_2 * radius);
            ((around / spacing + 9.0) * (up / spacing + 4.0), spacing)
        }
        SurfaceSpec::Panel { radius, size, spacing, margin, rail, cells, beam } => {
            length("radius", radius, low)?;
            length("size[0]", size[0], low)?;
            length("size[1]", size[1], low)?;
            for (field, value) in
                [("margin", margin), ("rail", rail), ("beam[0]", beam[0]), ("beam[1]", beam[1])]
            {
                length(field, value, 0.0)?;
            }
            for (axis, count) in cells.into_iter().enumerate() {
                if count > CELLS {
                    return Err((
                        format!("surface.cells[{axis}]"),
                        format!("is {count}; {CELLS} openings in a row at most make sense"),
                    ));
                }
            }
            let along = |axis: usize| size[axis] / spacing + 2.0 * f64::from(cells[axis]) + 3.0;
            (along(0) * along(1), spacing)
        }
        SurfaceSpec::Mesh { scale, .. } => {
            if scale > 0.0 && scale.is_finite() && !(1e-9..=1e3).contains(&scale) {
                return Err(("surface.scale".into(), outside(scale, 1e-9, 1e3, "m")));
            }
            return Ok(());
        }
        // The mesh that its family makes of it has limits of its own.
        SurfaceSpec::Family(ref shape) => {
            return medium("surface", &toml::Value::Table(shape.parameters.clone()));
        }
    };
    length("spacing", spacing, low)?;
    if spacing > 0.0 && points > POINTS {
        let reason = format!("{spacing} m makes more than a million points; coarsen it");
        return Err(("surface.spacing".into(), reason));
    }
    Ok(())
}

fn elements(skin: &SkinDescription) -> Result<(), Fault> {
    let (taxels, channels) = (skin.taxels.len(), skin.channels().len());
    if taxels > TAXELS {
        return Err((
            "taxels".into(),
            format!("are {taxels}; a skin has {TAXELS} at most: describe it as several"),
        ));
    }
    if channels > CHANNELS {
        return Err(("channels".into(), format!("are {channels}; a frame has {CHANNELS} at most")));
    }
    for (i, taxel) in skin.taxels.iter().enumerate() {
        for (field, values, most, unit) in [
            ("position", Some(taxel.position), LENGTH[1], "m"),
            ("normal", Some(taxel.normal), DIRECTION, ""),
            ("axis", taxel.axis, DIRECTION, ""),
        ] {
            let bad = values.into_iter().flatten().find(|v| v.is_finite() && v.abs() > most);
            if let Some(value) = bad {
                return Err((
                    format!("taxels[{i}].{field}"),
                    format!("holds {}", &outside(value, -most, most, unit)[3..]),
                ));
            }
        }
    }
    for (i, channel) in skin.channels().iter().enumerate() {
        for (field, value) in channel
            .noise
            .map(|noise| ("noise", noise))
            .into_iter()
            .chain(channel.range.into_iter().flatten().map(|end| ("range", end)))
        {
            number(&format!("channels[{i}].{field}"), value)?;
        }
    }
    Ok(())
}

/// Every number of a table, whatever the sensor family makes of it.
fn medium(field: &str, value: &toml::Value) -> Result<(), Fault> {
    match value {
        toml::Value::Float(value) => number(field, *value),
        toml::Value::Integer(value) => number(field, *value as f64),
        toml::Value::Array(items) => {
            items.iter().enumerate().try_for_each(|(i, item)| medium(&format!("{field}[{i}]"), item))
        }
        toml::Value::Table(fields) => {
            fields.iter().try_for_each(|(key, value)| medium(&format!("{field}.{key}"), value))
        }
        _ => Ok(()),
    }
}

/// Refuses two elements that no touch tells apart: at one place, looking and measuring in one direction.
pub(crate) fn distinct(taxels: &[Taxel]) -> Result<(), Fault> {
    // Whatever is closer than a cell lies in the same one or in a neighbour.
    let cell = |taxel: &Taxel| taxel.position.map(|v| (v / SAME_PLACE).floor() as i64);
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (i, taxel) in taxels.iter().enumerate() {
        let [x, y, z] = cell(taxel);
        for (dx, dy, dz) in (0..27).map(|n| (n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)) {
            let near = cells.get(&[x + dx, y + dy, z + dz]).into_iter().flatten();
            if let Some(other) = near.copied().find(|other| same(&taxels[*other], taxel)) {
                return Err((
                    format!("taxels[{i}].position"),
                    format!(
                        "is that of \"{}\" (taxels[{other}]), which has the same normal and axis: nothing tells them apart; \
                         move or remove one",
                        taxels[other].name
                    ),
                ));
            }
        }
        cells.entry([x, y, z]).or_default().push(i);
    }
    Ok(())
}

fn same(a: &Taxel, b: &Taxel) -> bool {
    let near = |a: &[f64; 3], b: &[f64; 3], within: f64| {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt() < within
    };
    near(&a.position, &b.position, SAME_PLACE)
        && near(&a.normal, &b.normal, 1e-6)
        && match (&a.axis, &b.axis) {
            (Some(a), Some(b)) => near(a, b, 1e-6),
            (a, b) => a.is_none() && b.is_none(),
        }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAD: &str = r#"
        schema = "dermis-skin/1"
        name = "pad"
        sensor = "taxels"
        frame_id = "pad_link"
        unit = "Pa"
        rate = 100.0
        noise = 20.0
        surface = { type = "rectangle", size = [0.02, 0.01], spacing = 0.005 }
        taxels = [
            { name = "a", position = [-0.005, 0.0, -0.005] },
            { name = "b", position = [0.005, 0.0, -0.005] },
        ]
    "#;

    fn refused(from: &str, to: &str) -> String {
        assert!(PAD.contains(from), "{from} is not in the description");
        SkinDescription::from_toml(&PAD.replace(from, to), "pad.toml").unwrap_err().to_string()
    }

    #[test]
    fn what_no_skin_can_be_is_refused_before_it_is_computed() {
        insta::assert_snapshot!(refused("[0.02, 0.01]", "[1e300, 1e-300]"), @"skin file pad.toml: field `surface.size[0]`: is 1e300 m and must be 0.000001 to 100 m");
        insta::assert_snapshot!(refused("[0.02, 0.01]", "[100.0, 90.0]"), @"skin file pad.toml: field `surface.spacing`: 0.005 m makes more than a million points; coarsen it");
        insta::assert_snapshot!(refused("spacing = 0.005", "spacing = 1e-300"), @"skin file pad.toml: field `surface.spacing`: is 1e-300 m and must be 0.000001 to 100 m");
        insta::assert_snapshot!(refused("rate = 100.0", "rate = 1e300"), @"skin file pad.toml: field `rate`: is 1e300 Hz and must be 0.001 to 1000000 Hz");
        insta::assert_snapshot!(refused("rate = 100.0", "rate = 1e-300"), @"skin file pad.toml: field `rate`: is 1e-300 Hz and must be 0.001 to 1000000 Hz");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 1e300"), @"skin file pad.toml: field `noise`: is 1e300 Pa and must be 0.000000000000001 to 1000000000000000 Pa");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 1e-300"), @"skin file pad.toml: field `noise`: is 1e-300 Pa and must be 0.000000000000001 to 1000000000000000 Pa");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\nrange = [-1e300, 1e5]"), @"skin file pad.toml: field `range`: is -1e300 and must be 0, or of a size from 1e-15 to 1e15");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\nwire = { scale = 1e-300 }"), @"skin file pad.toml: field `wire.scale`: is 1e-300 and must be 0, or of a size from 1e-15 to 1e15");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\ncondition = { tare_duration = 1e9 }"), @"skin file pad.toml: field `condition.tare_duration`: is 1e9 s and must be 0.001 to 600 s");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\nmedium = { layers = [{ young = 1e300 }] }"), @"skin file pad.toml: field `medium.layers[0].young`: is 1e300 and must be 0, or of a size from 1e-15 to 1e15");
        insta::assert_snapshot!(refused("[0.005, 0.0, -0.005]", "[1e9, 0.0, -0.005]"), @"skin file pad.toml: field `taxels[1].position`: holds 1e9 m and must be -100 to 100 m");
        insta::assert_snapshot!(refused("[0.005, 0.0, -0.005]", "[0.005, 0.0, -0.005], normal = [0, 0, 1e300]"), @"skin file pad.toml: field `taxels[1].normal`: holds 1e300 and must be -1000000 to 1000000");
        let rectangle = "{ type = \"rectangle\", size = [0.02, 0.01], spacing = 0.005 }";
        let panel =
            "{ type = \"panel\", radius = 0.1, size = [0.2, 0.2], spacing = 0.01, cells = [4000000000, 1] }";
        insta::assert_snapshot!(refused(rectangle, panel), @"skin file pad.toml: field `surface.cells[0]`: is 4000000000; 1000 openings in a row at most make sense");
        let dome = "{ type = \"dome\", radius = 100.0, cylinder = 1e-6, spacing = 0.01 }";
        insta::assert_snapshot!(refused(rectangle, dome), @"skin file pad.toml: field `surface.spacing`: 0.01 m makes more than a million points; coarsen it");
        let mesh = "{ type = \"mesh\", file = \"pad.stl\", scale = 1e300 }";
        insta::assert_snapshot!(refused(rectangle, mesh), @"skin file pad.toml: field `surface.scale`: is 1e300 m and must be 0.000000001 to 1000 m");
    }

    #[test]
    fn elements_are_counted_before_they_are_inspected() {
        let many: String =
            (0..=TAXELS).map(|i| format!("{{ name = \"t{i}\", position = [0, 0, 0] }},")).collect();
        let first = "{ name = \"a\", position = [-0.005, 0.0, -0.005] },";
        insta::assert_snapshot!(refused(first, &many), @"skin file pad.toml: field `taxels`: are 10002; a skin has 10000 at most: describe it as several");
        let channels: String =
            (0..=CHANNELS).map(|i| format!("{{ name = \"c{i}\", taxel = \"a\" }},")).collect();
        insta::assert_snapshot!(refused("taxels = [", &format!("channels = [{channels}]\ntaxels = [")), @"skin file pad.toml: field `channels`: are 30001; a frame has 30000 at most");
    }

    #[test]
    fn two_elements_at_one_place_are_refused_unless_they_measure_in_two_directions() {
        insta::assert_snapshot!(refused("[0.005,", "[-0.005,"), @r#"skin file pad.toml: field `taxels[1].position`: is that of "a" (taxels[0]), which has the same normal and axis: nothing tells them apart; move or remove one"#);
        insta::assert_snapshot!(refused("[0.005,", "[-0.0050000005,"), @r#"skin file pad.toml: field `taxels[1].position`: is that of "a" (taxels[0]), which has the same normal and axis: nothing tells them apart; move or remove one"#);
        let rosette = PAD
            .replace("[0.005, 0.0, -0.005]", "[-0.005, 0.0, -0.005], axis = [0, 1, 0]")
            .replace("[-0.005, 0.0, -0.005] },", "[-0.005, 0.0, -0.005], axis = [1, 0, 0] },");
        assert!(SkinDescription::from_toml(&rosette, "pad.toml").is_ok());
        assert!(SkinDescription::from_toml(&PAD.replace("[0.005,", "[-0.004998,"), "pad.toml").is_ok());
    }
}
