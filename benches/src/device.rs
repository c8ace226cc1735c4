//! The device of the measurements: precomputed frames of a pressed skin, written to a pseudo-terminal on request.

use std::io::Write;

use anyhow::{Context, Result};
use dermis_model::{Indentation, Stimulus};
use dermis_skin::SkinDescription;
use dermis_transport::framing::{NativeEncoder, NativeFormat};
use dermis_transport::{Pty, now_ns};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Different frames of each kind; they repeat.
const VARIETY: usize = 512;
/// \[N\] of the touch.
const FORCE: f64 = 0.8;
/// \[m\] radius of the circle on which the touch moves.
const CIRCLE: f64 = 0.008;

/// A skin behind a pseudo-terminal.
pub struct Device {
    pty: Pty,
    encoder: NativeEncoder,
    untouched: Vec<Vec<f32>>,
    touched: Vec<Vec<f32>>,
    begun: i64,
    /// When the last byte of each frame went out, ns since the epoch, by sequence number.
    pub sent: Vec<i64>,
}

impl Device {
    /// A device for this skin; the frames come from its forward model, with its noise.
    ///
    /// # Errors
    ///
    /// Where the skin has no model or the system no pseudo-terminal.
    pub fn new(skin: &SkinDescription, seed: u64) -> Result<Self> {
        let model = dermis_barodome::model(skin)?;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut frames = |force: Option<f64>| -> Result<Vec<Vec<f32>>> {
            (0..VARIETY)
                .map(|i| {
                    let angle = i as f64 / VARIETY as f64 * std::f64::consts::TAU;
                    let contacts = force.map(|force| {
                        Indentation::sphere(
                            Point3::new(CIRCLE * angle.cos(), CIRCLE * angle.sin(), 0.0),
                            Vector3::new(0.0, 0.0, -force),
                            0.004,
                        )
                    });
                    let stimulus =
                        Stimulus { contacts: contacts.into_iter().collect(), ..Stimulus::default() };
                    let mut reading = vec![0.0; model.channels()];
                    model.response(&stimulus, &mut reading)?;
                    let noisy = reading.iter().zip(model.noise()).map(|(value, sigma)| {
                        let noise = Normal::new(0.0, *sigma).map_or(0.0, |n| n.sample(&mut random));
                        (value + noise) as f32
                    });
                    Ok(noisy.collect())
                })
                .collect()
        };
        Self::playing(NativeFormat::F32, frames(None)?, frames(Some(FORCE))?)
    }

    /// A device that sends these frames, over and over.
    ///
    /// # Errors
    ///
    /// Where the system has no pseudo-terminal.
    pub fn playing(format: NativeFormat, untouched: Vec<Vec<f32>>, touched: Vec<Vec<f32>>) -> Result<Self> {
        let encoder = NativeEncoder::new(format);
        Ok(Self { pty: Pty::open()?, encoder, untouched, touched, begun: now_ns(), sent: Vec::new() })
    }

    /// Where a node finds it.
    #[must_use]
    pub fn path(&self) -> String {
        self.pty.slave_path().display().to_string()
    }

    /// Sends the next frame; waits while the line is full. The time that is kept is that before the bytes are handed
    /// over, so that the hand-over counts as latency.
    ///
    /// # Errors
    ///
    /// Where the line is down.
    pub fn send(&mut self, touched: bool) -> Result<()> {
        let sequence = self.sent.len();
        let pool = if touched { &self.touched } else { &self.untouched };
        let now = now_ns();
        let device_time = u64::try_from((now - self.begun) / 1000 + 1)?;
        let bytes = self.encoder.encode(sequence as u32, device_time, &pool[sequence % pool.len()])?;
        self.sent.push(now_ns());
        self.pty.write_all(bytes).context("the device's line is down")
    }
}
