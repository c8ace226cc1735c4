//! What a contact is due to: something that the configuration expects, another link of the robot, or neither.
//!
//! An expected contact is a support or a tool that the robot holds. Where a contact lies in its region, the force that is
//! expected there is taken away, and what is left counts. Links that may touch each other are named in pairs, by the
//! configuration and by the SRDF of the robot file; two contacts on such a pair that are in one place of the body and look at
//! each other are the robot's own touch.

use std::collections::BTreeSet;

use dermis_body::{Body, Robot};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A support or a tool.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expected {
    /// What it is, for people.
    pub name: String,
    /// URDF link that it touches.
    pub link: String,
    /// \[m\] middle of its region, in the frame of the link.
    pub position: [f64; 3],
    /// \[m\] radius of its region.
    pub radius: f64,
    /// \[N\] that it exerts on the link, in the frame of the link; all that is measured there where absent.
    pub force: Option<[f64; 3]>,
    /// \[N\] by which a force may differ from that and still be nothing else.
    #[serde(default = "usual_tolerance")]
    pub tolerance: f64,
}

fn usual_tolerance() -> f64 {
    2.0
}

/// Two links that may touch each other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelfContact {
    /// URDF links.
    pub links: [String; 2],
}

/// \[m\] between two contacts of a robot with itself, at most: their skins' errors and thickness.
const SELF_DISTANCE: f64 = 0.03;
/// Cosine between their normals, at most.
const SELF_COSINE: f64 = -0.5;

/// Why a list of expected contacts cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CauseError {
    /// A link that the robot does not have.
    #[error("`{field}`: \"{link}\" is no link of the robot; correct the name")]
    Link {
        /// Path of the field.
        field: String,
        /// Link that was named.
        link: String,
    },
    /// A number that cannot be.
    #[error("`{field}`: is {value} and must be {range}")]
    Number {
        /// Path of the field.
        field: String,
        /// What it is.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}

#[derive(Debug, Clone)]
struct Region {
    link: usize,
    position: Point3<f64>,
    radius: f64,
    force: Option<Vector3<f64>>,
    tolerance: f64,
}

/// What a contact is due to, and what of its force counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Neither of the others.
    Environment,
    /// Another link of the robot.
    OwnBody,
    /// A support or a tool that the configuration names.
    Expected,
}

/// Two links, the smaller index first.
fn pair(a: usize, b: usize) -> [usize; 2] {
    [a.min(b), a.max(b)]
}

/// Contacts that have an explanation.
#[derive(Debug, Clone, Default)]
pub(crate) struct Causes {
    regions: Vec<Region>,
    /// Links that may touch each other, the smaller index first.
    pairs: BTreeSet<[usize; 2]>,
}

impl Causes {
    pub(crate) fn new(robot: &Robot, expected: &[Expected], own: &[SelfContact]) -> Result<Self, CauseError> {
        let body: &Body = &robot.body;
        let link = |name: &str, field: String| {
            body.link(name).ok_or_else(|| CauseError::Link { field, link: name.to_owned() })
        };
        let mut regions = Vec::new();
        for (i, e) in expected.iter().enumerate() {
            let number = |key: &str, value: f64, fits: bool, range: &'static str| {
                let field = format!("expected[{i}].{key}");
                if fits { Ok(()) } else { Err(CauseError::Number { field, value, range }) }
            };
            number("radius", e.radius, e.radius > 0.0 && e.radius <= 10.0, "above 0 and up to 10 m")?;
            number("tolerance", e.tolerance, (0.0..=1e6).contains(&e.tolerance), "from 0 to 10⁶ N")?;
            for (key, values) in [("position", Some(e.position)), ("force", e.force)] {
                for value in values.into_iter().flatten() {
                    number(key, value, value.is_finite() && value.abs() <= 1e6, "finite, and 10⁶ at most")?;
                }
            }
            regions.push(Region {
                link: link(&e.link, format!("expected[{i}].link"))?,
                position: Point3::from(e.position),
                radius: e.radius,
                force: e.force.map(Vector3::from),
                tolerance: e.tolerance,
            });
        }
        let mut pairs: BTreeSet<[usize; 2]> = robot.self_contact.iter().copied().collect();
        for (i, SelfContact { links: [a, b] }) in own.iter().enumerate() {
            let a = link(a, format!("self_contact[{i}].links[0]"))?;
            pairs.insert(pair(a, link(b, format!("self_contact[{i}].links[1]"))?));
        }
        Ok(Self { regions, pairs })
    }

    /// What is left of the force of a contact at `position` on `link`, and what the contact is due to by that. All of it where nothing
    /// is expected there; none where what is left is within the tolerance.
    pub(crate) fn left(
        &self,
        link: usize,
        position: &Point3<f64>,
        force: &Vector3<f64>,
    ) -> (Vector3<f64>, Cause) {
        let region =
            self.regions.iter().find(|r| r.link == link && (r.position - position).norm() <= r.radius);
        let Some(region) = region else { return (*force, Cause::Environment) };
        let left = region.force.map_or_else(Vector3::zeros, |expected| force - expected);
        // What is not measured cannot differ from what is expected.
        let differs = left.iter().filter(|v| v.is_finite()).map(|v| v * v).sum::<f64>().sqrt();
        if differs <= region.tolerance {
            (Vector3::zeros(), Cause::Expected)
        } else {
            (left, Cause::Environment)
        }
    }

    /// Which of these contacts (link, position and normal in the body frame) are the robot's own.
    pub(crate) fn own(&self, contacts: &[(usize, Point3<f64>, Vector3<f64>)]) -> Vec<bool> {
        let mut own = vec![false; contacts.len()];
        if self.pairs.is_empty() {
            return own;
        }
        for (i, first) in contacts.iter().enumerate() {
            for (j, second) in contacts.iter().enumerate().skip(i + 1) {
                if (first.1 - second.1).norm() <= SELF_DISTANCE
                    && first.2.dot(&second.2) <= SELF_COSINE
                    && self.pairs.contains(&pair(first.0, second.0))
                {
                    (own[i], own[j]) = (true, true);
                }
            }
        }
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot() -> Robot {
        with_srdf("")
    }

    /// Two links with a skin each, and what an SRDF says of them.
    fn with_srdf(elements: &str) -> Robot {
        let folder = tempfile::tempdir().unwrap();
        let urdf = "<robot name='r'><link name='a'/><link name='b'/>\
                    <joint name='j' type='continuous'><parent link='a'/><child link='b'/></joint></robot>";
        std::fs::write(folder.path().join("r.urdf"), urdf).unwrap();
        let srdf = format!("<robot name='r'>{elements}</robot>");
        std::fs::write(folder.path().join("r.srdf"), srdf).unwrap();
        let text = "schema = 'dermis-robot/1'\nname = 'r'\nurdf = 'r.urdf'\nsrdf = 'r.srdf'\n\
                    [[skins]]\nname = 'first'\nframe_id = 'a'\n[[skins]]\nname = 'second'\nframe_id = 'b'\n";
        Robot::from_toml(text, &folder.path().join("r.toml")).unwrap()
    }

    fn expected() -> Expected {
        Expected {
            name: "foot".into(),
            link: "a".into(),
            position: [0.0, 0.0, 0.1],
            radius: 0.05,
            force: Some([0.0, 0.0, -50.0]),
            tolerance: 2.0,
        }
    }

    #[test]
    fn what_is_expected_is_taken_away() {
        let causes = Causes::new(&robot(), &[expected()], &[]).unwrap();
        let at = Point3::new(0.01, 0.0, 0.1);
        let press = |n: f64| Vector3::new(0.0, 0.0, -n);
        assert_eq!(causes.left(0, &at, &press(51.0)), (Vector3::zeros(), Cause::Expected));
        assert_eq!(causes.left(0, &at, &press(60.0)), (press(10.0), Cause::Environment));
        assert_eq!(causes.left(0, &at, &press(0.0)).1, Cause::Environment, "the support is gone");
        assert_eq!(causes.left(1, &at, &press(51.0)), (press(51.0), Cause::Environment), "another link");
        let beside = Point3::new(0.1, 0.0, 0.1);
        assert_eq!(causes.left(0, &beside, &press(51.0)), (press(51.0), Cause::Environment));
        let any = Causes::new(&robot(), &[Expected { force: None, ..expected() }], &[]).unwrap();
        assert_eq!(any.left(0, &at, &press(400.0)), (Vector3::zeros(), Cause::Expected));
        let unknown = Vector3::new(f64::NAN, f64::NAN, -51.0);
        assert_eq!(causes.left(0, &at, &unknown).1, Cause::Expected);
    }

    #[test]
    fn links_that_touch_each_other_are_the_robots_own() {
        let own = [SelfContact { links: ["a".into(), "b".into()] }];
        let causes = Causes::new(&robot(), &[], &own).unwrap();
        let contact = |link: usize, x: f64, z: f64| (link, Point3::new(x, 0.0, 0.0), Vector3::z() * z);
        assert_eq!(causes.own(&[contact(0, 0.0, 1.0), contact(1, 0.01, -1.0)]), [true, true]);
        assert_eq!(causes.own(&[contact(0, 0.0, 1.0), contact(1, 0.01, 1.0)]), [false, false]);
        assert_eq!(causes.own(&[contact(0, 0.0, 1.0), contact(1, 0.1, -1.0)]), [false, false]);
        assert_eq!(causes.own(&[contact(0, 0.0, 1.0), contact(0, 0.01, -1.0)]), [false, false]);
    }

    #[test]
    fn an_srdf_says_which_links_touch_each_other() {
        let touch = [(1, Point3::origin(), Vector3::z()), (0, Point3::new(0.01, 0.0, 0.0), -Vector3::z())];
        for (reason, own) in [("Adjacent", true), ("Default", true), ("User", true), ("Never", false)] {
            let robot = with_srdf(&format!("<disable_collisions link1='b' link2='a' reason='{reason}'/>"));
            assert_eq!(Causes::new(&robot, &[], &[]).unwrap().own(&touch), [own, own], "{reason}");
            // What the configuration names counts in any case.
            let named = [SelfContact { links: ["b".into(), "a".into()] }];
            assert_eq!(Causes::new(&robot, &[], &named).unwrap().own(&touch), [true, true], "{reason}");
        }
        assert_eq!(Causes::new(&robot(), &[], &[]).unwrap().own(&touch), [false, false]);
    }

    #[test]
    fn refusals_name_the_field() {
        let wrong = |e: Expected| Causes::new(&robot(), &[e], &[]).unwrap_err().to_string();
        insta::assert_snapshot!(wrong(Expected { link: "c".into(), ..expected() }), @r#"`expected[0].link`: "c" is no link of the robot; correct the name"#);
        insta::assert_snapshot!(wrong(Expected { radius: 0.0, ..expected() }), @"`expected[0].radius`: is 0 and must be above 0 and up to 10 m");
        insta::assert_snapshot!(wrong(Expected { force: Some([0.0, f64::NAN, 0.0]), ..expected() }), @"`expected[0].force`: is NaN and must be finite, and 10⁶ at most");
    }
}
