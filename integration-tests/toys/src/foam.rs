//! A skin of 784 voltages: nonlinear, non-local, and it remembers.
//!
//! Not a physical model: it has what the two families of this repository lack. A press changes many voltages at once, a second
//! press changes what the first one does, a share of every reading follows slowly, and the shape is the family's own.

mod effects;
mod model;

use std::sync::Arc;

use dermis_model::ForwardModel;
use dermis_sensor::Sensor;
use dermis_skin::{
    Channel, EffectInfo, Family, FieldFault, ModelError, SkinDescription, SurfaceSpec, Taxel, TriangleMesh,
};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

/// The family.
pub const FAMILY: &dyn Sensor = &Foam;

struct Foam;

/// Electrodes along x and along y.
const GRID: [usize; 2] = [7, 4];

/// z = rise · (x² - y²) / (size / 2)² over a square.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Saddle {
    /// \[m\] of a side.
    size: f64,
    /// \[m\] of the middle of a side above the centre.
    rise: f64,
    /// \[m\] between the points of its triangulation.
    spacing: f64,
}

impl Saddle {
    fn of(skin: &SkinDescription) -> Result<Option<Self>, FieldFault> {
        let SurfaceSpec::Family(shape) = &skin.surface else { return Ok(None) };
        if shape.name != "saddle" {
            return Ok(None);
        }
        let saddle: Self = shape.parameters_as()?;
        for (field, value, [low, high]) in [
            ("size", saddle.size, [0.01, 1.0]),
            ("rise", saddle.rise, [0.0, 0.1]),
            ("spacing", saddle.spacing, [saddle.size / 200.0, saddle.size / 2.0]),
        ] {
            if !(low..=high).contains(&value) {
                let reason = format!("is {value} m and must be {low} to {high} m");
                return Err(FieldFault::new(format!("surface.{field}"), reason));
            }
        }
        Ok(Some(saddle))
    }

    fn point(&self, x: f64, y: f64) -> Point3<f64> {
        let half = self.size / 2.0;
        Point3::new(x, y, self.rise * (x * x - y * y) / (half * half))
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        let steep = 2.0 * self.rise / (self.size / 2.0).powi(2);
        Vector3::new(-steep * x, steep * y, 1.0).normalize()
    }

    fn mesh(&self) -> Result<TriangleMesh, String> {
        let cells = (self.size / self.spacing).round().max(1.0) as usize;
        let along = |i: usize| (i as f64 / cells as f64 - 0.5) * self.size;
        let points = (0..=cells).flat_map(|j| (0..=cells).map(move |i| (i, j)));
        let points = points.map(|(i, j)| self.point(along(i), along(j))).collect();
        let corner = |i: usize, j: usize| j * (cells + 1) + i;
        let mut triangles = Vec::new();
        for (i, j) in (0..cells).flat_map(|j| (0..cells).map(move |i| (i, j))) {
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i, j + 1), corner(i + 1, j + 1)];
            triangles.extend([[a, b, d], [a, d, c]]);
        }
        TriangleMesh::from_triangles(points, &triangles, 1)
    }

    fn electrodes(&self) -> Vec<Taxel> {
        let [columns, rows] = GRID;
        let along = |i: usize, n: usize| ((i as f64 + 0.5) / n as f64 - 0.5) * self.size;
        let locations = (0..columns * rows).map(|e| (along(e % columns, columns), along(e / columns, rows)));
        locations
            .enumerate()
            .map(|(e, (x, y))| Taxel {
                name: format!("e{e}"),
                position: self.point(x, y).into(),
                normal: self.normal(x, y).into(),
                axis: None,
            })
            .collect()
    }
}

impl Family for Foam {
    fn name(&self) -> &'static str {
        "toy-foam"
    }

    fn complete(&self, skin: &mut SkinDescription) -> Result<(), FieldFault> {
        let Some(saddle) = Saddle::of(skin)? else { return Ok(()) };
        skin.set_shape(saddle.mesh().map_err(|reason| FieldFault::new("surface", reason))?);
        if skin.taxels.is_empty() {
            skin.taxels = saddle.electrodes();
        }
        if skin.channels().is_empty() {
            // One electrode is driven, all are read.
            let names: Vec<String> = skin.taxels.iter().map(|taxel| taxel.name.clone()).collect();
            let pairs = names.iter().flat_map(|driven| names.iter().map(move |read| (driven, read)));
            let channels = pairs.map(|(driven, read)| Channel {
                name: format!("{driven}-{read}"),
                taxel: read.clone(),
                range: None,
                noise: None,
            });
            skin.set_channels(channels.collect());
        }
        Ok(())
    }
}

impl Sensor for Foam {
    fn about(&self) -> &'static str {
        "Reads the foam of a test and publishes its contacts"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        Ok(Arc::new(model::FoamModel::new(skin)?))
    }

    fn check_medium(&self, skin: &SkinDescription) -> Result<(), ModelError> {
        skin.check_medium(|| model::Medium::of(skin).map(drop))
    }

    fn effects(&self) -> &'static [EffectInfo] {
        effects::EFFECTS
    }
}
