//! Ground truth: what is not known, and tips that are spheres.

use crate::geometry_msgs::msg::{Point, Pose, Quaternion, Vector3};
use crate::msg::IndentationContact;

impl Point {
    /// A place that nobody knows: not a number.
    pub const UNKNOWN: Self = Self { x: f64::NAN, y: f64::NAN, z: f64::NAN };
}

impl Vector3 {
    /// A vector that nobody knows: not a number.
    pub const UNKNOWN: Self = Self { x: f64::NAN, y: f64::NAN, z: f64::NAN };
}

impl Quaternion {
    /// The shortest rotation of the z axis to `normal`; not a number where that is none.
    fn from_z_to(normal: &Vector3) -> Self {
        let length = (normal.x * normal.x + normal.y * normal.y + normal.z * normal.z).sqrt();
        let [x, y, z] = [normal.x / length, normal.y / length, normal.z / length];
        // z × n and 1 + z · n, which vanish together where n points to -z.
        let (axis, rest) = ([-y, x], 1.0 + z);
        let norm = (axis[0] * axis[0] + axis[1] * axis[1] + rest * rest).sqrt();
        if norm < 1e-9 {
            return Self { x: 1.0, y: 0.0, z: 0.0, w: 0.0 };
        }
        Self { x: axis[0] / norm, y: axis[1] / norm, z: 0.0 / norm, w: rest / norm }
    }
}

impl IndentationContact {
    /// A spherical tip, whose pose follows from where and how deep it presses; its temperature is not known. `depth` and
    /// `diameter` \[m\] may be NaN.
    pub fn sphere(
        position: Point,
        normal: Vector3,
        force: Vector3,
        force_components: u8,
        depth: f64,
        diameter: f64,
    ) -> Self {
        let foremost = Point {
            x: position.x - depth * normal.x,
            y: position.y - depth * normal.y,
            z: position.z - depth * normal.z,
        };
        Self {
            tip: Self::TIP_SPHERE,
            tip_parameters: Vec::new(),
            tip_name: String::new(),
            tip_pose: Pose { position: foremost, orientation: Quaternion::from_z_to(&normal) },
            temperature: f32::NAN,
            position,
            normal,
            force,
            force_components,
            depth,
            diameter,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::msg::Contact;
    use proptest::prelude::*;

    fn rotated_z(q: &Quaternion) -> [f64; 3] {
        [2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)]
    }

    proptest! {
        #[test]
        fn a_sphere_stands_on_the_surface(polar in 0.0..=std::f64::consts::PI, around in 0.0..6.3_f64, depth in 0.0..0.01_f64) {
            let normal = [polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()];
            let [x, y, z] = normal;
            let at = Point { x: 0.1, y: -0.2, z: 0.3 };
            let contact = IndentationContact::sphere(
                at.clone(), Vector3 { x, y, z }, Vector3::default(), Contact::FORCE_FULL, depth, 0.004);
            for (turned, expected) in rotated_z(&contact.tip_pose.orientation).into_iter().zip(normal) {
                prop_assert!((turned - expected).abs() < 1e-6, "{contact:?}");
            }
            // Deeper is against the normal.
            let tip = &contact.tip_pose.position;
            let inwards = (at.x - tip.x) * x + (at.y - tip.y) * y + (at.z - tip.z) * z;
            prop_assert!((inwards - depth).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_not_known_stays_so() {
        let contact = IndentationContact::sphere(
            Point::default(),
            Vector3::UNKNOWN,
            Vector3::UNKNOWN,
            Contact::FORCE_NONE,
            f64::NAN,
            f64::NAN,
        );
        assert!(contact.tip_pose.position.x.is_nan() && contact.tip_pose.orientation.w.is_nan());
    }
}
