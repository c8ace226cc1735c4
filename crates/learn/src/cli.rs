//! Options that every command which reads labelled bags has.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::Args;
use dermis_skin::Surface;
use serde::{Deserialize, Serialize};

use crate::{DatasetOptions, LabelMap, LearnError, MOST_FRAMES, MapReading};

/// How bags are read.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Labels {
    /// Take the ground truth from a robot's pose and a force sensor's wrench, as this file maps them; see
    /// `launch/labels/`.
    #[arg(long)]
    map: Option<PathBuf>,
    /// Which device, where a bag holds several of the skin's type; `dermis bag info` lists them.
    #[arg(long, value_name = "NAME")]
    skin_instance: Option<String>,
    /// Topic of the frames, where a bag holds several skins of one description.
    #[arg(long, value_name = "TOPIC")]
    taxels: Option<String>,
    /// Seconds between a frame and its ground truth that still count as the same instant; a map has its own.
    #[arg(long)]
    tolerance: Option<f64>,
    /// Frames of all bags together that are used at most, 4000000 by default. Where there are more, every k-th is used, and one of each
    /// press that has none among those.
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    most_frames: Option<NonZeroUsize>,
}

impl Labels {
    /// How to read the bags.
    ///
    /// # Errors
    ///
    /// [`LearnError`] where the map cannot be used.
    pub fn options(&self) -> Result<DatasetOptions, LearnError> {
        Ok(DatasetOptions {
            tolerance: self.tolerance,
            instance: self.skin_instance.clone(),
            taxels: self.taxels.clone(),
            map: self.map.as_ref().map(LabelMap::load).transpose()?,
            most_frames: self.most_frames.map_or(MOST_FRAMES, NonZeroUsize::get),
            ..DatasetOptions::default()
        })
    }
}

/// How contacts are read off the maps of forces of a model.
#[derive(Debug, Clone, Default, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReadMaps {
    /// Diameter [m] of the disc in which a contact is the largest pressure of a map of forces, e.g. `0.064`, which skins of a quarter of
    /// a metre and more have without being requested.
    #[arg(long, value_name = "METRES")]
    map_disc: Option<f64>,
    /// Force [N] that the disc of a contact bears at least; of several, everything is reported for each, e.g. `5,2.5`.
    #[arg(long, value_name = "NEWTONS", value_delimiter = ',')]
    map_threshold: Vec<f64>,
    /// Force [N] below which a true contact keeps its frame out of the comparison of contacts in maps.
    #[arg(long, value_name = "NEWTONS")]
    map_least_force: Option<f64>,
}

impl ReadMaps {
    /// How to read maps over this surface; `None` where nothing is requested and the surface is small.
    ///
    /// # Errors
    ///
    /// [`LearnError::Config`] names the flag whose number cannot be.
    pub fn reading(&self, surface: &Surface) -> Result<Option<MapReading>, LearnError> {
        let requested =
            self.map_disc.is_some() || self.map_least_force.is_some() || !self.map_threshold.is_empty();
        let own = MapReading::of_surface(surface);
        if !requested {
            return Ok(own);
        }
        let mut reading = own.unwrap_or_default();
        reading.disc = self.map_disc.unwrap_or(reading.disc);
        reading.least_force = self.map_least_force.unwrap_or(reading.least_force);
        if !self.map_threshold.is_empty() {
            reading.thresholds.clone_from(&self.map_threshold);
        }
        let wrong = |(field, reason): (&str, String)| {
            let flag = match field {
                "disc" => "--map-disc",
                "thresholds" => "--map-threshold",
                _ => "--map-least-force",
            };
            LearnError::Config { file: "flags".into(), field: flag.into(), reason }
        };
        reading.check().map_err(wrong)?;
        Ok(Some(reading))
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::SurfaceSpec;

    use super::*;

    #[test]
    fn flags_change_how_maps_are_read_and_small_skins_are_read_on_request_only() {
        let of =
            |size: f64| Surface::from_spec(&SurfaceSpec::Rectangle { size: [size; 2], spacing: size / 10.0 });
        let (pad, panel) = (of(0.05), of(0.5));
        assert_eq!(ReadMaps::default().reading(&pad).unwrap(), None);
        assert_eq!(ReadMaps::default().reading(&panel).unwrap(), Some(MapReading::default()));
        let flags = ReadMaps { map_disc: Some(0.006), map_threshold: vec![0.2], map_least_force: None };
        let wanted = MapReading { disc: 0.006, thresholds: vec![0.2], least_force: 0.0 };
        assert_eq!(flags.reading(&pad).unwrap(), Some(wanted));
        let wrong = ReadMaps { map_threshold: vec![-1.0], ..flags };
        insta::assert_snapshot!(wrong.reading(&pad).unwrap_err(), @"flags: field `--map-threshold`: has -1 N and must be 0 or positive");
    }
}
