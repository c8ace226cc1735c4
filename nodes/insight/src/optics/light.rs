//! Lamps behind collimators, and how the inside reflects them.
//!
//! L = ρ Σ_k I_k B_k / d_k² · (k_d (n·l) + k_s (n·h)^m) + A, colour by colour (Lambert, and J. F. Blinn's specular term, 1977), I_k the
//! intensity of a lamp at the reference distance, B_k its beam: 1 inside of a cone, 0 outside, smooth over the collimator's hole between.
//! A is light that the inside has reflected once, the same everywhere. Sensor colours are a matrix of the lamps', times the gains of the
//! camera, and what a picture says is the power 1/γ of them.
//!
//! Assumptions: no shadows (the inside is convex as lamps see it), light that was reflected more often is part of A, lamps are points
//! below their holes.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::elastic::mesh::smooth_step;

/// \[m\] at which a lamp's intensity is said.
const REFERENCE: f64 = 0.03;
/// Colours of lamps and pixels.
pub const COLOURS: usize = 3;

/// One lamp behind its collimator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// \[m\] of the hole's middle.
    pub position: Point3<f64>,
    /// Along the beam.
    pub axis: Vector3<f64>,
    /// Intensity in red, green, blue.
    pub power: [f64; COLOURS],
}

/// The beams of all lamps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beam {
    /// \[m\] of its radius at the hole.
    pub radius: f64,
    /// \[m\] by which that grows with each metre.
    pub spread: f64,
    /// \[m\] over which its edge fades.
    pub edge: f64,
}

/// How the inside reflects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finish {
    /// Share that Lambert's term has.
    pub diffuse: f64,
    /// Share that the specular term has.
    pub specular: f64,
    /// Its exponent.
    pub shininess: f64,
}

impl Finish {
    /// The specular term's power of a cosine. Whole powers take a quarter of the time of others, and there is one for each lamp and node.
    fn lobe(&self, cosine: f64) -> f64 {
        let whole = self.shininess as i32;
        if f64::from(whole).to_bits() == self.shininess.to_bits() {
            cosine.powi(whole)
        } else {
            cosine.powf(self.shininess)
        }
    }
}

/// Everything that lights the inside, and what the camera makes of light.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// All lamps.
    pub lamps: Vec<Lamp>,
    /// Their beams.
    pub beam: Beam,
    /// How the inside reflects.
    pub finish: Finish,
    /// The inside's mean light by colour, as a share of which it lights itself.
    pub ambient: [f64; COLOURS],
    /// From the colours of lamps to those of the sensor, gains and exposure included.
    pub sensor: Matrix3<f64>,
    /// A picture says the power 1/γ.
    pub gamma: f64,
}

/// A lamp whose beam reaches a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reaching<'a> {
    lamp: &'a Lamp,
    /// Of its beam there, over the square of the distance in units of the reference.
    strength: f64,
    /// Unit vector from the point to the lamp.
    towards: Vector3<f64>,
}

impl Light {
    /// What one lamp sends to a point, per unit of its intensity: 1 on a plane that faces it at the reference distance, in its beam.
    #[must_use]
    pub fn irradiance(&self, lamp: &Lamp, p: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        self.beam_at(lamp, p).map_or(0.0, |lit| lit.strength * normal.dot(&lit.towards).max(0.0))
    }

    /// How many lamps' beams reach a point, by half of their strength or more.
    #[must_use]
    pub fn lamps_at(&self, p: &Point3<f64>, normal: &Vector3<f64>) -> usize {
        let lit = |lamp: &&Lamp| self.inside_beam(lamp, p) >= 0.5 && normal.dot(&(lamp.position - p)) > 0.0;
        self.lamps.iter().filter(lit).count()
    }

    /// 1 inside of a lamp's beam, 0 outside.
    fn inside_beam(&self, lamp: &Lamp, p: &Point3<f64>) -> f64 {
        let way = p - lamp.position;
        let along = way.dot(&lamp.axis);
        if along <= 0.0 {
            return 0.0;
        }
        let off = (way.norm_squared() - along * along).max(0.0);
        let within = self.beam.radius + self.beam.spread * along;
        // Most lamps do not light a place: that is decided without a root.
        if off >= (within + 0.5 * self.beam.edge).powi(2) {
            return 0.0;
        }
        let beyond = off.sqrt() - within;
        1.0 - smooth_step(beyond / self.beam.edge + 0.5)
    }

    /// A lamp, where its beam reaches a point.
    fn beam_at<'a>(&self, lamp: &'a Lamp, p: &Point3<f64>) -> Option<Reaching<'a>> {
        let inside = self.inside_beam(lamp, p);
        if inside <= 0.0 {
            return None;
        }
        let way = lamp.position - p;
        let square = way.norm_squared();
        let distance = square.sqrt();
        let strength = inside * REFERENCE * REFERENCE / square;
        Some(Reaching { lamp, strength, towards: way / distance })
    }

    /// The lamps whose beams reach a point.
    pub(super) fn reaching(&self, p: &Point3<f64>) -> impl Iterator<Item = Reaching<'_>> {
        let at = *p;
        self.lamps.iter().filter_map(move |lamp| self.beam_at(lamp, &at))
    }

    /// Light of each colour of the lamps that a point of the inside sends to the camera; `normal` points inwards, `view` to the camera.
    #[must_use]
    pub fn radiance(&self, p: &Point3<f64>, normal: &Vector3<f64>, view: &Vector3<f64>) -> [f64; COLOURS] {
        self.reflected(self.reaching(p), normal, view)
    }

    /// The same of a point that these lamps reach.
    pub(super) fn reflected<'a>(
        &self,
        reaching: impl IntoIterator<Item = Reaching<'a>>,
        normal: &Vector3<f64>,
        view: &Vector3<f64>,
    ) -> [f64; COLOURS] {
        let mut sum = self.ambient;
        for Reaching { lamp, strength, towards } in reaching {
            let facing = normal.dot(&towards);
            if facing <= 0.0 {
                continue;
            }
            let mut reflected = self.finish.diffuse * facing;
            if self.finish.specular > 0.0 {
                let half = (towards + view).try_normalize(1e-9).map_or(0.0, |h| normal.dot(&h).max(0.0));
                reflected += self.finish.specular * self.finish.lobe(half);
            }
            for (sum, power) in sum.iter_mut().zip(lamp.power) {
                *sum += power * strength * reflected;
            }
        }
        sum
    }

    /// What a picture says of this light: 1 is full scale, and more is not cut off.
    #[must_use]
    pub fn seen(&self, light: [f64; COLOURS]) -> [f32; COLOURS] {
        let sensed = self.sensor * Vector3::from(light);
        let exponent = (1.0 / self.gamma) as f32;
        std::array::from_fn(|colour| (sensed[colour].max(0.0) as f32).powf(exponent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn one_lamp() -> Light {
        Light {
            lamps: vec![Lamp { position: Point3::origin(), axis: Vector3::z(), power: [1.0, 0.0, 0.0] }],
            beam: Beam { radius: 0.002, spread: 0.2, edge: 0.001 },
            finish: Finish { diffuse: 1.0, specular: 0.0, shininess: 10.0 },
            ambient: [0.0; COLOURS],
            sensor: Matrix3::identity(),
            gamma: 1.0,
        }
    }

    #[test]
    fn light_falls_with_the_square_of_the_distance_and_ends_with_the_beam() {
        let light = one_lamp();
        let at = |x: f64, z: f64| light.irradiance(&light.lamps[0], &Point3::new(x, 0.0, z), &-Vector3::z());
        assert_relative_eq!(at(0.0, 0.03), 1.0, max_relative = 1e-12);
        assert_relative_eq!(at(0.0, 0.06), 0.25, max_relative = 1e-12);
        // The beam's radius at 30 mm is 8 mm, and half of the light is there.
        let free = 0.03 * 0.03 / (0.03f64.powi(2) + 0.008f64.powi(2));
        let cos = 0.03 / 0.03f64.hypot(0.008);
        assert_relative_eq!(at(0.008, 0.03), 0.5 * free * cos, max_relative = 1e-9);
        assert_eq!((at(0.0086, 0.03), at(0.0, -0.01)), (0.0, 0.0));
        let p = Point3::new(0.004, 0.0, 0.03);
        assert_eq!((light.lamps_at(&p, &-Vector3::z()), light.lamps_at(&p, &Vector3::z())), (1, 0));
    }

    #[test]
    fn a_mirror_shows_the_lamp_where_both_angles_are_one() {
        let mut light = one_lamp();
        light.finish = Finish { diffuse: 0.0, specular: 1.0, shininess: 50.0 };
        light.beam.spread = 1.0;
        let (p, normal) = (Point3::new(0.0, 0.0, 0.03), -Vector3::z());
        let seen = |from: [f64; 3]| light.radiance(&p, &normal, &(Point3::from(from) - p).normalize())[0];
        assert_relative_eq!(seen([0.0, 0.0, 0.0]), 1.0, max_relative = 1e-12);
        assert!(seen([0.01, 0.0, 0.0]) < 0.6);
    }

    #[test]
    fn whole_powers_are_powers() {
        let finish = |shininess| Finish { diffuse: 0.0, specular: 1.0, shininess };
        for cosine in [0.0, 0.3, 0.97, 1.0f64] {
            assert_relative_eq!(finish(12.0).lobe(cosine), cosine.powf(12.0), max_relative = 1e-12);
            assert_eq!(finish(12.5).lobe(cosine), cosine.powf(12.5));
        }
    }

    #[test]
    fn pictures_are_the_gamma_of_what_the_sensor_mixes() {
        let mut light = one_lamp();
        light.sensor = Matrix3::new(1.0, 0.0, 0.0, 0.25, 1.0, 0.0, 0.0, 0.0, 2.0);
        light.gamma = 2.0;
        let [r, g, b] = light.seen([0.25, 0.0, 0.5]);
        assert_relative_eq!(r, 0.5, max_relative = 1e-6);
        assert_relative_eq!(g, 0.25, max_relative = 1e-6);
        assert_relative_eq!(b, 1.0, max_relative = 1e-6);
    }
}
