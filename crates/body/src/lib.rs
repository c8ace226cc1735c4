//! A robot's body: what carries the skins, where each link is at an instant, and what a touch does to the joints.
//!
//! | module | question |
//! |---|---|
//! | [`Body`] | which links and joints are there? (URDF) |
//! | [`Poses`] | where is each link for these joint positions, and how does a point on a link move with the joints? |
//! | [`Inertia`], [`Momentum`] | what does it take to move the links? |
//! | [`JointHistory`] | where were the joints when a frame was acquired? |
//! | [`Wrench`] | the same forces about another point, in another frame |
//! | [`Robot`] | which skins are on which links, and which of these may touch each other? (robot file, SRDF) |
//! | [`taxel_table`] | where are the taxels of a skin that has a table of positions only? |
//!
//! Lengths are in metres, angles in radians, forces in newtons, torques in newton metres. `a_from_b` is the pose of frame b in
//! frame a: it takes a point of b to the same point in a.
//!
//! ```
//! use dermis_body::{Body, Wrench};
//! use nalgebra::{Point3, Vector3};
//!
//! let body = Body::from_urdf(
//!     r#"<robot name="arm">
//!          <link name="base"/> <link name="fore"/>
//!          <joint name="elbow" type="continuous">
//!            <parent link="base"/> <child link="fore"/> <origin xyz="0 0 1"/> <axis xyz="0 0 1"/>
//!          </joint>
//!        </robot>"#,
//!     "arm.urdf",
//! )?;
//! let poses = body.poses(&[std::f64::consts::FRAC_PI_2]);
//! let fore = body.link("fore").ok_or("no such link")?;
//! let hand = poses.root_from(fore) * Point3::new(0.5, 0.0, 0.0);
//! assert!((hand - Point3::new(0.0, 0.5, 1.0)).norm() < 1e-12);
//!
//! // A push of 2 N along -x at the hand turns the elbow with 1 N m.
//! let push = Wrench::of_force(Vector3::new(-2.0, 0.0, 0.0), hand);
//! assert!((poses.torques(fore, &push)[0] - 1.0).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod body;
mod dynamics;
mod history;
mod kinematics;
mod robot;
mod srdf;
pub mod taxel_table;
mod urdf;
mod wrench;

pub use body::{Body, Friction, Joint, JointKind, Limits, Mimic};
pub use dynamics::{Inertia, Momentum};
pub use history::{HistoryLimits, JointHistory, JointsAt, MissingJoint, Refused};
pub use kinematics::Poses;
pub use robot::{BodyTaxel, Robot, RobotError, SkinOnBody};
pub use urdf::UrdfError;
pub use wrench::Wrench;
