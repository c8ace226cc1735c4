//! The "real" side of the check of the tool that diagnoses gaps between simulated and real skins.
//!
//! A [`ReferenceDevice`] is a skin that is pressed as a rig would press it ([`Script`]). Layers and shells are computed by other
//! means than the models that the tool works with: another discretisation, other laws of contact, material and electronics, taken
//! from the literature and not from any model of this workspace. Sheets over foam and cameras are by design what their family's
//! own model answers ([`Designs`]); how a device differs from that is computed here, by laws of its own, as for the others. What
//! makes it differ from its design, its [`Cause`]s, is withheld: a benchmark [`set`] of recordings is published with the hash of
//! each ground truth, and [`score`]d after the tool has written its reports.
//!
//! No crate but the program and tests of the check may import this one, and the tool never (`cargo xtask layers`).

mod camera;
mod cause;
mod common;
mod designs;
mod error;
mod fabric;
mod laws;
mod layer;
mod loads;
mod memory;
mod record;
pub mod score;
mod script;
pub mod set;
mod shell;

use std::sync::Arc;

use dermis_model::ForwardModel;
use dermis_skin::SkinDescription;
use rand::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

pub use cause::{Cause, CauseInfo, Cell, parameters};
pub use designs::{Designs, Make};
pub use error::BenchmarkError;
pub use record::record;
pub use script::{Climate, Instant, Rig, Script};

use memory::add_noise;

/// How a reference device is computed: what differs between simulators and is no cause of a gap that a device has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Numerics {
    /// \[m\] after which a layer repeats.
    pub period: f64,
    /// Finite elements across a layer, or a fifth of the facets along a shell.
    pub elements: usize,
    /// Whether a tip is the exact sphere, or a paraboloid.
    pub sphere: bool,
    /// Whether the pressure under a tip flattens with the contact's size.
    pub flattening: bool,
    /// Share of a tip's depth by which elements come nearer to it.
    pub nearer: f64,
}

impl Default for Numerics {
    fn default() -> Self {
        Self { period: 0.12, elements: 24, sphere: true, flattening: true, nearer: 0.06 }
    }
}

impl Numerics {
    /// Another mesh and other laws, drawn by `seed`.
    #[must_use]
    pub fn varied(seed: u64) -> Self {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        Self {
            period: [0.10, 0.12, 0.14][rng.random_range(0..3)],
            elements: [18, 24, 32][rng.random_range(0..3)],
            sphere: rng.random::<f64>() < 0.7,
            flattening: rng.random(),
            nearer: rng.random_range(0.0..0.10),
        }
    }
}

/// Noise of a reference device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// What it is drawn by.
    pub seed: u64,
    /// So many times that of the skin's channels.
    pub factor: f64,
    /// Whether its tails are heavy and channels differ, instead of Gaussian and alike.
    pub heavy: bool,
}

/// A skin as it would be in reality.
pub trait ReferenceDevice: Send + Sync {
    /// What of it does not change with time, and how deep tips sink in: what a [`Script`] needs.
    fn model(&self) -> Arc<dyn ForwardModel>;

    /// One reading a channel, row after row, one row an instant of `script`, in the unit of the skin; with this
    /// noise.
    ///
    /// # Errors
    ///
    /// [`BenchmarkError::Model`] where the script holds a contact that cannot be.
    fn readings(&self, script: &Script, noise: Option<Noise>) -> Result<Vec<f64>, BenchmarkError>;
}

/// What reference devices are like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A soft layer over elements that read pressure.
    Layer,
    /// A clamped shell with strain gauges.
    Shell,
    /// A sheet over foam with electrodes.
    Fabric,
    /// A camera inside an elastomer.
    Camera,
}

impl Kind {
    fn of(skin: &SkinDescription) -> Result<Self, BenchmarkError> {
        if camera::CameraDevice::is_like(skin) {
            Ok(Self::Camera)
        } else if fabric::FabricDevice::is_like(skin) {
            Ok(Self::Fabric)
        } else if layer::LayerDevice::is_like(skin) {
            Ok(Self::Layer)
        } else if shell::ShellDevice::is_like(skin) {
            Ok(Self::Shell)
        } else {
            Err(unlike(skin))
        }
    }

    const fn causes(self) -> &'static [CauseInfo] {
        match self {
            Self::Layer => layer::LayerDevice::causes(),
            Self::Shell => shell::ShellDevice::causes(),
            Self::Fabric => fabric::CAUSES,
            Self::Camera => camera::CAUSES,
        }
    }

    const ALL: [Self; 4] = [Self::Layer, Self::Shell, Self::Fabric, Self::Camera];
}

/// The reference device that is like a skin. Sheets over foam and cameras are by design as `designs` says.
///
/// # Errors
///
/// [`BenchmarkError`] where no reference device is like it, or a cause is unknown.
pub fn reference_device(
    skin: &SkinDescription,
    numerics: &Numerics,
    causes: &[Cause],
    designs: &Designs<'_>,
) -> Result<Box<dyn ReferenceDevice>, BenchmarkError> {
    Ok(match Kind::of(skin)? {
        Kind::Layer => Box::new(layer::LayerDevice::new(skin, numerics, causes)?),
        Kind::Shell => Box::new(shell::ShellDevice::new(skin, numerics, causes, designs)?),
        Kind::Fabric => Box::new(fabric::FabricDevice::new(skin, numerics, causes, designs)?),
        Kind::Camera => Box::new(camera::CameraDevice::new(skin, causes, designs)?),
    })
}

/// Where a cause sits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Region {
    /// On some channels.
    Channels {
        /// Their names.
        names: Vec<String>,
    },
    /// Around one place of the surface.
    Place {
        /// \[m\] in the frame of the skin's link.
        at: [f64; 3],
        /// \[m\] around it where pressing shows it.
        within: f64,
    },
}

/// Where a cause of this skin's reference device sits; `None` where it does not sit in one place.
#[must_use]
pub fn region(skin: &SkinDescription, cause: &Cause) -> Option<Region> {
    let channels = skin.channels();
    if let Some(which) = memory::on_channels(cause, channels.len()) {
        return Some(Region::Channels {
            names: which.into_iter().map(|c| channels[c].name.clone()).collect(),
        });
    }
    match Kind::of(skin).ok()? {
        Kind::Layer => layer::LayerDevice::place(skin, cause),
        Kind::Shell => shell::ShellDevice::place(skin, cause),
        Kind::Fabric => fabric::place(skin, cause),
        Kind::Camera => camera::place(skin, cause),
    }
}

/// The causes that a reference device of this skin can have.
///
/// # Errors
///
/// [`BenchmarkError`] where no reference device is like it.
pub fn causes(skin: &SkinDescription) -> Result<&'static [CauseInfo], BenchmarkError> {
    Ok(Kind::of(skin)?.causes())
}

/// What cases of a cause count as; `None` of a cause that no reference device has.
#[must_use]
pub fn cell_of(id: &str) -> Option<Cell> {
    every_cause().find(|k| k.id == id).map(|k| k.cell)
}

/// The causes of all reference devices; what several have stands in it as often.
fn every_cause() -> impl Iterator<Item = &'static CauseInfo> {
    Kind::ALL.into_iter().flat_map(Kind::causes)
}

/// What a rig presses such a skin with, `size` times the usual 150 presses.
///
/// # Errors
///
/// [`BenchmarkError`] where no reference device is like it.
pub fn rig(skin: &SkinDescription, size: f64) -> Result<Rig, BenchmarkError> {
    Ok(match Kind::of(skin)? {
        Kind::Layer => layer::LayerDevice::rig(skin, size),
        Kind::Shell => shell::ShellDevice::rig(skin, size),
        Kind::Fabric => fabric::rig(skin, size),
        Kind::Camera => camera::rig(skin, size),
    })
}

/// A number of the medium: of a nested table by its path, as `foam.thickness`.
pub(crate) fn number(skin: &SkinDescription, key: &str) -> Result<f64, BenchmarkError> {
    let mut parts = key.split('.');
    let first = parts.next().and_then(|part| skin.medium.get(part));
    let value = parts.fold(first, |value, part| value.and_then(|v| v.get(part)));
    let value = value.and_then(|v| v.as_float().or(v.as_integer().map(|i| i as f64)));
    value.ok_or_else(|| BenchmarkError::skin(skin, &format!("medium.{key}"), "is missing, or no number"))
}

fn unlike(skin: &SkinDescription) -> BenchmarkError {
    BenchmarkError::skin(
        skin,
        "surface",
        "no reference device is like it: there are flat layers that read in Pa, clamped panels that read strain, sheets over foam \
         whose electrodes read each other's voltages, and cameras whose pictures are read in blocks",
    )
}

/// Fraction of the variance of `of` that `other` leaves unexplained while something touches: both minus what they read at the
/// start, when nothing does.
#[must_use]
pub fn unexplained(of: &[f64], other: &[f64], script: &Script, channels: usize) -> f64 {
    let zero = |readings: &[f64]| {
        let mut zero = vec![0.0; channels];
        for row in readings.chunks(channels).take(script.quiet) {
            zero.iter_mut().zip(row).for_each(|(z, v)| *z += v / script.quiet.max(1) as f64);
        }
        zero
    };
    let (zero_of, zero_other) = (zero(of), zero(other));
    let (mut sum, mut squares, mut missed) = (vec![0.0; channels], 0.0, 0.0);
    let mut count = 0.0f64;
    let rows = of.chunks(channels).zip(other.chunks(channels)).zip(&script.instants);
    for ((a, b), _) in rows.filter(|(_, i)| !i.moment.stimulus.contacts.is_empty()) {
        count += 1.0;
        for c in 0..channels {
            let (a, b) = (a[c] - zero_of[c], b[c] - zero_other[c]);
            sum[c] += a;
            squares += a * a;
            missed += (a - b) * (a - b);
        }
    }
    let variance = squares - sum.iter().map(|s| s * s).sum::<f64>() / count.max(1.0);
    if variance > 0.0 { missed / variance } else { f64::NAN }
}
