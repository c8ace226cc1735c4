//! A fisheye lens by equisolid projection: r = 2 f sin(θ/2), θ from the optical axis.
//!
//! The six fields of view of the thesis' Table 6.2 fit f = 789 to 797 pixels of a picture that is 1640 wide (equidistant 759 to 790,
//! stereographic 684 to 784). No distortion beyond the projection, no vignetting.

use nalgebra::{Point3, Rotation3, Vector3};

/// Pixels of the width that focal lengths are given for.
pub const FULL_WIDTH: f64 = 1640.0;

/// A camera at a place, which looks along its own z; its x points right in the picture, its y down.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Pixels across and down.
    pub size: [u32; 2],
    /// Focal length \[pixels of this picture\].
    pub focal: f64,
    /// \[m\] of the entrance pupil.
    pub position: Point3<f64>,
    /// From the camera's frame to that of the link.
    pub orientation: Rotation3<f64>,
}

impl Camera {
    /// Pixels from the upper left corner to the optical axis.
    fn centre(&self) -> [f64; 2] {
        self.size.map(|n| f64::from(n) / 2.0)
    }

    /// The unit vector from the camera, in the frame of the link, that a place of the picture \[pixels\] shows; `None` outside of what the
    /// lens projects.
    #[must_use]
    pub fn direction(&self, [x, y]: [f64; 2]) -> Option<Vector3<f64>> {
        let [cx, cy] = self.centre();
        let (x, y) = (x - cx, y - cy);
        let half = x.hypot(y) / (2.0 * self.focal);
        // sin θ = 2 sin(θ/2) cos(θ/2), and x over r is that of the direction.
        let cos_half = (1.0 - half * half).max(0.0).sqrt();
        let across = cos_half / self.focal;
        let local = Vector3::new(x * across, y * across, 1.0 - 2.0 * half * half);
        (half < 1.0).then(|| self.orientation * local)
    }

    /// Where a point of the link's frame is in the picture \[pixels\]; `None` for the camera's own place and what is straight behind it.
    #[must_use]
    pub fn project(&self, p: &Point3<f64>) -> Option<[f64; 2]> {
        let local = (self.orientation.inverse() * (p - self.position)).try_normalize(1e-12)?;
        let [cx, cy] = self.centre();
        equisolid(&local).map(|[x, y]| [cx + self.focal * x, cy + self.focal * y])
    }
}

/// Where a unit vector is in the picture of a lens that looks along z, in focal lengths; `None` straight behind it.
pub(super) fn equisolid(direction: &Vector3<f64>) -> Option<[f64; 2]> {
    // 2 sin(θ/2) / sin θ = 1 / cos(θ/2), and cos²(θ/2) = (1 + cos θ) / 2.
    let cos_half = ((1.0 + direction.z) / 2.0).max(0.0).sqrt();
    (cos_half > 1e-6).then(|| [direction.x / cos_half, direction.y / cos_half])
}

/// \[rad\] that a picture of so many pixels covers from edge to edge through its middle.
#[must_use]
pub fn field_of_view(pixels: f64, focal: f64) -> f64 {
    4.0 * (pixels / (4.0 * focal)).min(1.0).asin()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn it_looks_along_its_axis() {
        let camera = Camera {
            size: [410, 308],
            focal: 199.0,
            position: Point3::new(0.0, 0.0, 0.003),
            orientation: Rotation3::identity(),
        };
        assert!((camera.direction([205.0, 154.0]).unwrap() - Vector3::z()).norm() < 1e-12);
        // The field of view is twice the angle of an edge's middle.
        let edge = camera.direction([410.0, 154.0]).unwrap();
        assert!((edge.z.acos() - field_of_view(410.0, 199.0) / 2.0).abs() < 1e-12 && edge.x > 0.0);
        assert!(camera.project(&Point3::new(0.0, 0.0, -1.0)).is_none());
        assert!(camera.direction([5000.0, 0.0]).is_none());
    }

    proptest! {
        #[test]
        fn locations_are_found_again(x in 0.0..1640.0f64, y in 0.0..1232.0f64, far in 0.001..0.1f64, turn in -0.1..0.1f64) {
            let camera = Camera {
                size: [1640, 1232],
                focal: 795.0,
                position: Point3::new(1e-3, -2e-3, 0.003),
                orientation: Rotation3::from_euler_angles(turn, -turn, 3.0 * turn),
            };
            let direction = camera.direction([x, y]).unwrap();
            prop_assert!((direction.norm() - 1.0).abs() < 1e-12);
            let [u, v] = camera.project(&(camera.position + direction * far)).unwrap();
            prop_assert!((u - x).abs() < 0.01 && (v - y).abs() < 0.01, "{u} {v}");
        }
    }
}
