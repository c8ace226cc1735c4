//! Stimulus → picture.

use dermis_model::{ForwardModel, Stimulus};
use dermis_skin::{Image, ModelError, PixelFormat, SkinDescription, Surface, SurfaceSpec};
use nalgebra::Vector3;
use serde::Deserialize;

use super::{COLOURS, SIZE, means};

/// Exponent of the force: a sphere on an elastic body (Hertz).
const EXPONENT: f64 = 2.0 / 3.0;
/// Brightness without a lamp.
const AMBIENT: f64 = 0.15;
/// Brightness that a lamp adds to a surface that faces it.
const LAMP: f64 = 0.6;

/// Pixels along a side of a square of which the noise-free numbers look at one: dents are wider than that.
const STRIDE: usize = 4;

/// The pad and the camera.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Medium {
    /// \[m\] that a press of 1 N sinks in.
    give: f64,
    /// \[m\] of the dent around it.
    width: f64,
    /// Standard deviation of a pixel's noise, full scale 1.
    pixel_noise: f64,
    /// Share of its brightness that the first lamp has.
    #[serde(skip, default = "whole")]
    pub(super) red: f64,
    /// Factor of `give`.
    #[serde(skip, default = "whole")]
    pub(super) softness: f64,
}

fn whole() -> f64 {
    1.0
}

impl Medium {
    /// As the skin description says.
    pub fn of(skin: &SkinDescription) -> Result<Self, ModelError> {
        let medium: Self = skin.medium_as()?;
        for (field, value, [low, high]) in [
            ("give", medium.give, [1e-6, 0.01]),
            ("width", medium.width, [1e-4, 0.1]),
            ("pixel_noise", medium.pixel_noise, [0.0, 0.5]),
        ] {
            if !(low..=high).contains(&value) {
                return Err(ModelError::Description {
                    skin: skin.name.clone(),
                    field: format!("medium.{field}"),
                    reason: format!("is {value} and must be {low} to {high}"),
                });
            }
        }
        super::effects::apply(skin, medium)
    }
}

/// Pictures of a pad.
pub struct CameraModel {
    surface: Surface,
    size: [f64; 2],
    medium: Medium,
    noise: Vec<f64>,
}

impl CameraModel {
    /// The model of a skin.
    pub fn new(skin: &SkinDescription) -> Result<Self, ModelError> {
        let SurfaceSpec::Rectangle { size, .. } = skin.surface else {
            return Err(ModelError::Description {
                skin: skin.name.clone(),
                field: "surface.type".into(),
                reason: "must be \"rectangle\"".into(),
            });
        };
        Ok(Self { surface: skin.surface(), size, medium: Medium::of(skin)?, noise: skin.channel_noise() })
    }

    /// Where a press is, and how far it sinks in.
    fn dents(&self, stimulus: &Stimulus) -> Result<Vec<([f64; 2], f64)>, ModelError> {
        let dent = |(index, contact): (usize, &dermis_model::Indentation)| {
            let normal = contact.check(index, &self.surface)?;
            let pressing = (-contact.force.dot(&normal)).max(0.0);
            let give = self.medium.softness * self.medium.give;
            Ok(([contact.position.x, contact.position.y], give * pressing.powf(EXPONENT)))
        };
        stimulus.contacts.iter().enumerate().map(dent).collect()
    }

    /// Brightness in every colour, 0 to 1, of the pixels in the middle of squares of `stride`.
    fn render(
        &self,
        stimulus: &Stimulus,
        stride: usize,
        mut pixel: impl FnMut(usize, f64),
    ) -> Result<(), ModelError> {
        let dents = self.dents(stimulus)?;
        let lamps: [Vector3<f64>; COLOURS] = std::array::from_fn(|i| {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / COLOURS as f64).sin_cos();
            Vector3::new(cos, sin, 0.6).normalize()
        });
        let variance = self.medium.width * self.medium.width;
        let [width, height] = SIZE.map(|n| n as usize);
        for row in (stride / 2..height).step_by(stride) {
            let y = ((row as f64 + 0.5) / height as f64 - 0.5) * self.size[1];
            for column in (stride / 2..width).step_by(stride) {
                let x = ((column as f64 + 0.5) / width as f64 - 0.5) * self.size[0];
                let mut slope = [0.0; 2];
                for ([px, py], deep) in &dents {
                    let (dx, dy) = (x - px, y - py);
                    let bell = deep / variance * (-(dx * dx + dy * dy) / (2.0 * variance)).exp();
                    slope[0] += dx * bell;
                    slope[1] += dy * bell;
                }
                let normal = Vector3::new(-slope[0], -slope[1], 1.0).normalize();
                for (colour, lamp) in lamps.iter().enumerate() {
                    let power = if colour == 0 { LAMP * self.medium.red } else { LAMP };
                    let bright = AMBIENT + power * normal.dot(lamp).max(0.0);
                    pixel((row * width + column) * COLOURS + colour, bright.min(1.0));
                }
            }
        }
        Ok(())
    }
}

impl ForwardModel for CameraModel {
    fn channels(&self) -> usize {
        self.noise.len()
    }

    fn surface(&self) -> &Surface {
        &self.surface
    }

    fn response(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<(), ModelError> {
        out.fill(0.0);
        let [columns, _] = super::BLOCKS;
        let seen = super::BLOCK / STRIDE;
        let (width, share) = (SIZE[0] as usize, 1.0 / (seen * seen) as f64);
        self.render(stimulus, STRIDE, |i, bright| {
            let (pixel, colour) = (i / COLOURS, i % COLOURS);
            let block = pixel / width / super::BLOCK * columns + pixel % width / super::BLOCK;
            out[block * COLOURS + colour] += bright * share;
        })
    }

    fn noise(&self) -> &[f64] {
        &self.noise
    }

    fn displacement(&self, stimulus: &Stimulus, out: &mut [f64]) -> Result<bool, ModelError> {
        let dents = self.dents(stimulus)?;
        let variance = self.medium.width * self.medium.width;
        for (value, point) in out.iter_mut().zip(&self.surface.points) {
            let of = |([x, y], deep): &([f64; 2], f64)| {
                deep * (-((point.x - x).powi(2) + (point.y - y).powi(2)) / (2.0 * variance)).exp()
            };
            *value = dents.iter().map(of).sum();
        }
        Ok(true)
    }

    /// Shading is not linear in the slope, and colours end at full scale.
    fn superposes(&self) -> bool {
        false
    }

    fn capture(
        &self,
        stimulus: &Stimulus,
        noise: &mut dyn FnMut() -> f64,
    ) -> Result<Option<Image>, ModelError> {
        let mut data = vec![0_u8; SIZE[0] as usize * SIZE[1] as usize * COLOURS];
        self.render(stimulus, 1, |i, bright| {
            let read = bright + self.medium.pixel_noise * noise();
            data[i] = (read * 255.0).round().clamp(0.0, 255.0) as u8;
        })?;
        Ok(Image::new(SIZE[0], SIZE[1], PixelFormat::Rgb8, data))
    }

    fn observe(&self, image: &Image, out: &mut [f64]) -> bool {
        means(image, out)
    }
}
