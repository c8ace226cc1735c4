//! Figures 4.3, 4.5 and 4.6 of the thesis, drawn from the record of what was measured.
//!
//! What is missing in the record stays white, or has no point: nothing is made up. Figures 4.2, 4.4 and the examples of 4.6 are in the
//! pages that `dermis evaluate --report` writes beside the networks.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use dermis_figures::{Axes, Curve, Dots, column, curves, dots, heat};
use serde_json::Value;

/// Name in the record, title with its unit, and factor, of what is read off a map.
pub(super) const ERRORS: [(&str, &str, f64); 4] = [
    ("number", "number error [%]", 100.0),
    ("position_nearest", "location error [mm]", 1e3),
    ("force", "force error [%]", 100.0),
    ("diameter", "diameter error [%]", 100.0),
];
/// \[N\] the thesis' threshold.
const THRESHOLD: f64 = 5.0;

/// Contacts that were read off maps with the thesis' threshold.
pub(super) fn read(contacts: &Value) -> Option<&Value> {
    let fits = |of: &&Value| of["threshold"].as_f64() == Some(THRESHOLD);
    Some(&contacts.as_array()?.iter().find(fits)?["all"])
}

fn mean(contacts: &Value, name: &str) -> Option<f64> {
    read(contacts)?[name]["mean"].as_f64()
}

/// Draws what the record holds; the files that were written.
pub(super) fn draw(folder: &Path, record: &Value) -> Result<Vec<PathBuf>> {
    let rows = |key: &str| record[key]["rows"].as_array().map_or(&[][..], Vec::as_slice);
    let scale = |key: &str| {
        let reduced = &record[key]["reduced"];
        let of = |name: &str, part: &str| reduced[name][part].to_string();
        format!(
            "{} of {} locations, {} of {} epochs",
            of("locations_of_each_number", "here"),
            of("locations_of_each_number", "thesis"),
            of("epochs", "here"),
            of("epochs", "thesis")
        )
    };
    let (maps, pipeline) = (rows("table_4_5"), rows("pipeline"));
    let drawn = [
        ("4-3", grid(maps, &scale("table_4_5"))?),
        ("4-5", noises(pipeline, &scale("pipeline"))?),
        ("4-6", unseen(pipeline, &scale("pipeline"))?),
    ];
    let mut written = Vec::new();
    for (name, pictures) in drawn {
        if pictures.is_empty() {
            continue;
        }
        let file = folder.join(format!("ert-figure-{name}.svg"));
        std::fs::write(&file, column(&pictures))
            .with_context(|| format!("{} cannot be written", file.display()))?;
        written.push(file);
    }
    Ok(written)
}

/// Fig. 4.3: errors by pixel and diameter; combinations that were not measured stay white.
fn grid(rows: &[Value], scale: &str) -> Result<Vec<String>> {
    let sorted = |key: &str| {
        let mut all: Vec<f64> = rows.iter().filter_map(|row| row[key].as_f64()).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    };
    let (pixels, diameters) = (sorted("pixel_mm"), sorted("diameter_mm"));
    if rows.is_empty() {
        return Ok(Vec::new());
    }
    let mut pictures = Vec::new();
    for (name, title, factor) in ERRORS {
        let at = |pixel: f64, diameter: f64| {
            let of = |row: &&Value| {
                row["pixel_mm"].as_f64() == Some(pixel) && row["diameter_mm"].as_f64() == Some(diameter)
            };
            Some(mean(&rows.iter().find(of)?["contacts"], name)? * factor)
        };
        let values: Vec<Vec<Option<f64>>> =
            pixels.iter().map(|pixel| diameters.iter().map(|d| at(*pixel, *d)).collect()).collect();
        let axes = Axes::new(scale, "diameter of a contact in the map [mm]", "pixel [mm]");
        pictures.push(heat(&axes, title, (&diameters, &pixels), &values, &[])?);
    }
    Ok(pictures)
}

/// Rows of the pipeline that were made in this way.
fn made_by<'a>(rows: &'a [Value], way: &'a str) -> impl Iterator<Item = &'a Value> {
    rows.iter().filter(move |row| row["way"] == way)
}

/// Fig. 4.5: errors by noise, a curve for each map.
fn noises(rows: &[Value], scale: &str) -> Result<Vec<String>> {
    let mut maps: Vec<u64> = made_by(rows, "hybrid").filter_map(|row| row["map"].as_u64()).collect();
    maps.dedup();
    if maps.is_empty() {
        return Ok(Vec::new());
    }
    let mut pictures = Vec::new();
    for (name, title, factor) in ERRORS {
        let curve = |(n, map): (usize, &u64)| {
            let of_map: Vec<&Value> = made_by(rows, "hybrid").filter(|row| row["map"] == *map).collect();
            let point =
                |row: &&Value| Some((row["noise"].as_f64()? * 100.0, mean(&row["seen"], name)? * factor));
            let first = of_map.first().copied().unwrap_or(&Value::Null);
            let legend = format!("map {map}: {} mm, {} mm", first["pixel_mm"], first["diameter_mm"]);
            Curve::new(legend, n, of_map.iter().filter_map(point).collect())
        };
        let all: Vec<Curve> = maps.iter().enumerate().map(curve).collect();
        let axes = Axes::new(scale, "noise in training [% of what the transfer leaves]", title);
        pictures.push(curves(&axes, &all)?);
    }
    Ok(pictures)
}

/// Fig. 4.6 B: errors on patterns that nothing was learned from, a point for each network.
fn unseen(rows: &[Value], scale: &str) -> Result<Vec<String>> {
    let [_, (place, place_title, metres), others @ ..] = ERRORS;
    let mut pictures = Vec::new();
    for (name, title, factor) in others {
        let group = |(n, way): (usize, &&str)| {
            let point = |row: &Value| {
                let unseen = &row["unseen"];
                Some((mean(unseen, place)? * metres, mean(unseen, name)? * factor))
            };
            Dots::new(*way, n, made_by(rows, way).filter_map(point).collect())
        };
        let groups: Vec<Dots> = ["hybrid", "end to end"].iter().enumerate().map(group).collect();
        if groups.iter().all(|group| group.points.is_empty()) {
            return Ok(Vec::new());
        }
        pictures.push(dots(&Axes::new(scale, place_title, title), &groups, &[])?);
    }
    Ok(pictures)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn contacts(of: f64) -> Value {
        let all = json!({ "number": { "mean": -of }, "position_nearest": { "mean": of / 10.0 }, "force": { "mean": of },
                          "diameter": { "mean": 2.0 * of } });
        json!([{ "threshold": 2.5, "all": {} }, { "threshold": 5.0, "all": all }])
    }

    #[test]
    fn figures_show_what_was_measured_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        assert!(draw(folder.path(), &json!({})).unwrap().is_empty());
        assert!((mean(&contacts(0.2), "force").unwrap() - 0.2).abs() < 1e-12);
        let map = |map: u64, pixel: u64, diameter: u64, of: f64| json!({ "map": map, "pixel_mm": pixel, "diameter_mm": diameter, "contacts": contacts(of) });
        let reduced = json!({ "locations_of_each_number": { "here": 6, "thesis": 3000 },
                              "epochs": { "here": 3, "thesis": 1024 } });
        let mut rows = Vec::new();
        for (way, noise, of) in [("hybrid", 0.0, 0.1), ("hybrid", 0.5, 0.3), ("end to end", 0.0, 0.9)] {
            rows.push(json!({ "way": way, "map": 1, "pixel_mm": 4, "diameter_mm": 20, "noise": noise,
                              "seen": contacts(of), "unseen": contacts(of) }));
        }
        let record = json!({
            "table_4_5": { "reduced": reduced, "rows": [map(1, 4, 20, 0.1), map(12, 20, 60, 0.2)] },
            "pipeline": { "reduced": reduced, "rows": rows },
        });
        let files = draw(folder.path(), &record).unwrap();
        let names: Vec<_> = files.iter().filter_map(|f| f.file_name()?.to_str()).collect();
        assert_eq!(names, ["ert-figure-4-3.svg", "ert-figure-4-5.svg", "ert-figure-4-6.svg"]);
        let texts: Vec<String> = files.iter().map(|f| std::fs::read_to_string(f).unwrap()).collect();
        assert!(texts.iter().all(|text| text.contains("6 of 3000 locations, 3 of 1024 epochs")));
        assert!(texts[1].contains("map 1: 4 mm, 20 mm") && !texts[1].contains("end to end"));
        assert!(texts[2].contains("hybrid") && texts[2].contains("end to end"));
        assert_eq!(texts.iter().map(|t| t.matches("<svg").count()).collect::<Vec<_>>(), [5, 5, 3]);
    }
}
