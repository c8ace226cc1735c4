//! What a skin description says.

use std::fmt::Write as _;

use dermis_skin::{ModelError, SkinDescription};
use serde::Serialize;

/// A skin description in numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Its name.
    pub name: String,
    /// The family that reads it.
    pub sensor: String,
    /// Hash of its type.
    pub hash: String,
    /// Unit of the readings.
    pub unit: String,
    /// Number of taxels.
    pub taxels: usize,
    /// Number of channels.
    pub channels: usize,
    /// \[Hz\] of frames.
    pub rate_hz: f64,
    /// Points of its surface.
    pub surface_points: usize,
    /// \[m²\] of its surface.
    pub area_m2: f64,
    /// `yes`, or why there is none.
    pub forward_model: String,
    #[serde(skip)]
    description: String,
    #[serde(skip)]
    frame_id: String,
    #[serde(skip)]
    modelled: bool,
}

impl Summary {
    /// Of a skin whose family has a forward model of it, or refuses one.
    #[must_use]
    pub fn new(skin: &SkinDescription, refused: Option<&ModelError>) -> Self {
        let surface = skin.surface();
        Self {
            name: skin.name.clone(),
            sensor: skin.sensor.clone(),
            hash: skin.hash(),
            unit: skin.unit.clone(),
            taxels: skin.taxels.len(),
            channels: skin.channels().len(),
            rate_hz: skin.rate,
            surface_points: surface.points.len(),
            area_m2: surface.areas.iter().sum(),
            forward_model: refused.map_or("yes".to_owned(), ToString::to_string),
            description: skin.description.clone(),
            frame_id: skin.frame_id.clone(),
            modelled: refused.is_none(),
        }
    }
}

/// For people.
#[must_use]
pub fn text(skin: &Summary) -> String {
    let mut text = format!("{}: {}\n", skin.name, skin.description);
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "  {name:<13}  {value}");
    };
    line("sensor family", skin.sensor.clone());
    line(
        "taxels",
        format!(
            "{} with {} channels in {}, {} frames/s",
            skin.taxels, skin.channels, skin.unit, skin.rate_hz
        ),
    );
    line(
        "surface",
        format!("{:.2} cm² in {} points, frame {}", skin.area_m2 * 1e4, skin.surface_points, skin.frame_id),
    );
    line(
        "forward model",
        if skin.modelled {
            "yes: it can be simulated".to_owned()
        } else {
            format!("none: {}", skin.forward_model)
        },
    );
    line("hash", skin.hash.clone());
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skin_is_described_line_by_line() {
        let file = include_str!("../../../launch/skins/baro-grid.toml");
        let skin = SkinDescription::from_toml(file, "baro-grid.toml").unwrap();
        let known = text(&Summary::new(&skin, None));
        let lines: Vec<&str> = known.lines().collect();
        assert_eq!(lines.len(), 6, "{known}");
        assert!(lines[0].starts_with("baro-grid: "), "{known}");
        assert!(lines[2].starts_with("  taxels         25 with 25 channels in "), "{known}");
        assert_eq!(lines[4], "  forward model  yes: it can be simulated");
        assert_eq!(lines[5], format!("  hash           {}", skin.hash()));
        let refused = ModelError::Stimulus { index: 1, reason: "is off".to_owned() };
        let summary = Summary::new(&skin, Some(&refused));
        assert!(text(&summary).contains("  forward model  none: contact 1: is off\n"));
        assert_eq!(serde_json::to_value(&summary).unwrap()["forward_model"], "contact 1: is off");
    }
}
