//! What a description leaves out is filled in here, and what cannot be is refused: the first fault, with its field and what
//! would be right.

use std::collections::BTreeSet;
use std::path::Path;

use nalgebra::Vector3;

use super::parts::{Channel, SurfaceSpec, Taxel, WireProtocol, WireSamples};
use super::{SCHEMA, SkinDescription};
use crate::SkinError;
use crate::family::{self, FieldFault};
use crate::mesh::TriangleMesh;

/// \[bytes\] of a datagram that a frame is split for: what every network carries, and what UDP does.
const DATAGRAM: std::ops::RangeInclusive<u32> = 64..=65_507;

type Checked = Result<(), FieldFault>;

fn wrong(field: impl Into<String>, reason: impl Into<String>) -> Checked {
    Err(FieldFault::new(field, reason))
}

impl SkinDescription {
    /// Fills in what may be left out and refuses what cannot be.
    pub(super) fn finish(&mut self, file: &str) -> Result<(), SkinError> {
        self.complete_and_check(file).map_err(|FieldFault { field, reason }| SkinError::Impossible {
            file: file.to_owned(),
            field,
            reason,
        })
    }

    fn complete_and_check(&mut self, file: &str) -> Checked {
        if self.schema != SCHEMA {
            return wrong("schema", format!("is \"{}\" where this program reads \"{SCHEMA}\"", self.schema));
        }
        self.check_limits()?;
        family::complete(self)?;
        // Again, with what the family filled in.
        self.check_limits()?;
        self.check_names()?;
        self.check_numbers()?;
        self.surface.check()?;
        self.surface.load_mesh(file)?;
        if self.taxels.is_empty() {
            return wrong("taxels", "is empty: a skin has at least one");
        }
        if let Some((field, reason)) = crate::effect::impossible(&self.effects) {
            return wrong(field, reason);
        }
        let names = complete_taxels(&mut self.taxels)?;
        self.complete_channels(&names)
    }

    fn check_limits(&self) -> Checked {
        crate::limits::check(self).map_err(|(field, reason)| FieldFault { field, reason })
    }

    fn check_names(&self) -> Checked {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if self.name.is_empty() || !self.name.chars().all(plain) {
            return wrong(
                "name",
                format!("\"{}\" may only hold lower case letters, digits, `-` and `_`", self.name),
            );
        }
        if self.frame_id.is_empty() || self.frame_id.starts_with('/') {
            return wrong("frame_id", "names a link, without a leading slash");
        }
        Ok(())
    }

    /// Rate, noise, cleaning and wire.
    fn check_numbers(&self) -> Checked {
        let positive = [
            ("rate", self.rate),
            ("noise", self.noise),
            ("condition.tare_duration", self.condition.tare_duration),
            ("condition.contact_threshold", self.condition.contact_threshold),
            ("condition.drift_time", self.condition.drift_time),
            ("condition.stale_time", self.condition.stale_time),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, format!("is {value} and must be a positive number"));
            }
        }
        if !(0.0..1.0).contains(&self.condition.release_share) {
            return wrong("condition.release_share", "must be at least 0 (off) and below 1");
        }
        if !(self.condition.stuck_time.is_finite() && self.condition.stuck_time >= 0.0) {
            return wrong("condition.stuck_time", "must be 0 (off) or a positive number of seconds");
        }
        if !(self.wire.scale.is_finite() && self.wire.scale != 0.0 && self.wire.offset.is_finite()) {
            return wrong("wire.scale", "must be a finite number other than 0, and `offset` finite");
        }
        if let Some(rated) = &self.rated {
            rated.check()?;
        }
        self.check_samples()?;
        if let Some([low, high]) = self.wire.counts
            && low >= high
        {
            return wrong(
                "wire.counts",
                format!("is [{low}, {high}] and must be a least and a greater largest count"),
            );
        }
        Ok(())
    }

    /// Samples and datagrams of the native wire.
    fn check_samples(&self) -> Checked {
        let wire = &self.wire;
        for (field, set) in [("samples", wire.samples.is_some()), ("datagram", wire.datagram.is_some())] {
            if set && wire.protocol != WireProtocol::Native {
                let reason = "is of the binary wire: leave it out, or write `protocol = \"native\"`";
                return wrong(format!("wire.{field}"), reason);
            }
        }
        if wire.datagram.is_some_and(|most| !DATAGRAM.contains(&most)) {
            let reason = format!("must be {} to {} bytes", DATAGRAM.start(), DATAGRAM.end());
            return wrong("wire.datagram", reason);
        }
        let most = wire.counts.map_or(0, |[_, high]| high);
        match wire.samples.and_then(WireSamples::largest_count) {
            Some(largest) if most > largest => wrong(
                "wire.samples",
                format!("hold counts up to {largest}, and `wire.counts` goes up to {most}"),
            ),
            _ => Ok(()),
        }
    }

    /// One channel a taxel where the file names none; range and noise of the skin where a channel has none.
    fn complete_channels(&mut self, taxels: &BTreeSet<String>) -> Checked {
        if self.channels.is_empty() {
            self.channels = self
                .taxels
                .iter()
                .map(|t| Channel { name: t.name.clone(), taxel: t.name.clone(), range: None, noise: None })
                .collect();
        }
        let mut channels = BTreeSet::new();
        for (i, channel) in self.channels.iter_mut().enumerate() {
            if !channels.insert(channel.name.clone()) {
                return wrong(
                    format!("channels[{i}].name"),
                    format!("\"{}\" is already taken", channel.name),
                );
            }
            if !taxels.contains(&channel.taxel) {
                return wrong(
                    format!("channels[{i}].taxel"),
                    format!(
                        "\"{}\" is none of the taxels; they are {}",
                        channel.taxel,
                        join(taxels.iter(), 12)
                    ),
                );
            }
            channel.range = channel.range.or(self.range);
            if let Some([low, high]) = channel.range
                && low.partial_cmp(&high) != Some(std::cmp::Ordering::Less)
            {
                return wrong(
                    format!("channels[{i}].range"),
                    format!("[{low}, {high}] is empty: low must be below high"),
                );
            }
            let noise = *channel.noise.get_or_insert(self.noise);
            if !(noise.is_finite() && noise > 0.0) {
                return wrong(format!("channels[{i}].noise"), format!("is {noise} and must be positive"));
            }
        }
        Ok(())
    }
}

/// Unique names, finite positions, directions of length 1; returns the names.
fn complete_taxels(taxels: &mut [Taxel]) -> Result<BTreeSet<String>, FieldFault> {
    let fault = |field, reason: String| Err(FieldFault { field, reason });
    let mut names = BTreeSet::new();
    for (i, taxel) in taxels.iter_mut().enumerate() {
        if !names.insert(taxel.name.clone()) {
            return fault(format!("taxels[{i}].name"), format!("\"{}\" is already taken", taxel.name));
        }
        if taxel.position.iter().any(|v| !v.is_finite()) {
            return fault(format!("taxels[{i}].position"), "holds a number that is not finite".into());
        }
        let Some(unit) = Vector3::from(taxel.normal).try_normalize(1e-9) else {
            return fault(format!("taxels[{i}].normal"), "has no length".into());
        };
        taxel.normal = unit.into();
        if let Some(axis) = &mut taxel.axis {
            let along = Vector3::from(*axis);
            let along = along - unit * unit.dot(&along);
            let Some(along) = along.try_normalize(1e-6) else {
                return fault(
                    format!("taxels[{i}].axis"),
                    "must be a direction along the surface, not along `normal`".into(),
                );
            };
            *axis = along.into();
        }
    }
    Ok(names)
}

impl SurfaceSpec {
    /// Lengths that are positive, and openings that leave material.
    fn check(&self) -> Checked {
        let lengths: Vec<(&str, f64)> = match *self {
            SurfaceSpec::Panel { radius, size, spacing, .. } => {
                vec![("radius", radius), ("size[0]", size[0]), ("size[1]", size[1]), ("spacing", spacing)]
            }
            SurfaceSpec::Mesh { scale, .. } => vec![("scale", scale)],
            SurfaceSpec::Family(_) => Vec::new(),
            SurfaceSpec::Rectangle { size, spacing } => {
                vec![("size[0]", size[0]), ("size[1]", size[1]), ("spacing", spacing)]
            }
            SurfaceSpec::Dome { radius, cylinder, spacing } => {
                vec![("radius", radius), ("cylinder", cylinder), ("spacing", spacing)]
            }
        };
        for (field, value) in &lengths {
            if !(value.is_finite() && *value > 0.0) {
                return wrong(
                    format!("surface.{field}"),
                    format!("is {value} m and must be a positive length"),
                );
            }
        }
        if let SurfaceSpec::Panel { radius, size, margin, rail, beam, .. } = *self {
            let borders = [("margin", margin), ("rail", rail), ("beam[0]", beam[0]), ("beam[1]", beam[1])];
            if let Some((field, value)) = borders.iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
                return wrong(
                    format!("surface.{field}"),
                    format!("is {value} m and must be 0 or a positive length"),
                );
            }
            if size[1] >= std::f64::consts::TAU * radius {
                return wrong(
                    "surface.size[1]",
                    format!(
                        "{} m along the arc goes all the way around a cylinder of radius {radius} m",
                        size[1]
                    ),
                );
            }
            if self.panel().is_none() {
                return wrong(
                    "surface.cells",
                    "leaves no width for the openings between `margin`, `rail` and `beam`: take fewer",
                );
            }
        }
        Ok(())
    }

    /// Reads the file of a mesh; its path is relative to the folder of the skin file, whatever folder the program runs in.
    fn load_mesh(&mut self, skin: &str) -> Checked {
        let SurfaceSpec::Mesh { file: path, scale, rims, mesh } = self else { return Ok(()) };
        if let Some(folder) = Path::new(skin).parent() {
            *path = folder.join(&*path);
        }
        match TriangleMesh::load(path, *scale, *rims) {
            Ok(read) => *mesh = read,
            Err(reason) => return wrong("surface.file", reason),
        }
        Ok(())
    }
}

/// The first so many names, and how many more there are.
fn join<'a>(names: impl ExactSizeIterator<Item = &'a String>, most: usize) -> String {
    let total = names.len();
    let mut text = names.take(most).cloned().collect::<Vec<_>>().join(", ");
    if total > most {
        text.push_str(&format!(" and {} more", total - most));
    }
    text
}
