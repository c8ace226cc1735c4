//! URDF text → [`Body`].
//!
//! What is read: links and their inertias, joints (fixed, revolute, continuous, prismatic, mimic), origins, axes and limits. Shapes,
//! transmissions and whatever else a file has are ignored: nothing here computes with them. xacro has to be expanded before.
//! A link whose `inertial` has no mass is one without inertia.
//!
//! The XML is read by `roxmltree`: it gives a tree with line numbers, so that an error names the place; it refuses document type
//! definitions, and with them entities that grow; it is one small crate without unsafe code. `urdf-rs` reads the same files, but
//! its errors name no place, it demands of a file what kinematics do not need, and it brings a dozen crates.
//!
//! Cost: linear in the length of the file, which [`dermis_io`] bounds.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node, ParsingOptions};

use crate::body::{Body, Friction, Joint, JointKind, Limits, Mimic};
use crate::dynamics::Inertia;

/// Most XML nodes of a file.
const NODES: u32 = 1 << 20;
/// \[m\] farthest that a joint can be from the link that carries it.
const FARTHEST: f64 = 100.0;
/// \[rad\] Larger angles are degrees.
const LARGEST_ANGLE: f64 = 10.0;
/// Shortest axis that has a direction.
const SHORTEST_AXIS: f64 = 1e-6;

/// Why a URDF or an SRDF cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UrdfError {
    /// The file cannot be read.
    #[error("robot description {path}: cannot be read: {source}; check the path and its permissions")]
    Read {
        /// File that was requested.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The text is no XML.
    #[error("robot description {file}: is no well-formed XML: {reason}")]
    Xml {
        /// What errors call the file.
        file: String,
        /// What is wrong, and where.
        reason: String,
    },
    /// An element cannot be as it is written.
    #[error("robot description {file}: line {line}: {element}: {reason}")]
    Element {
        /// What errors call the file.
        file: String,
        /// Line of the element, from 1.
        line: u32,
        /// The element, as `joint "elbow"`.
        element: String,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// Links and joints make no tree.
    #[error("robot description {file}: {reason}")]
    Tree {
        /// What errors call the file.
        file: String,
        /// What is wrong, and what to do.
        reason: String,
    },
}

impl Body {
    /// Reads a URDF file.
    ///
    /// # Errors
    ///
    /// [`UrdfError`] names the file, the line and the element.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, UrdfError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| UrdfError::Read { path: path.to_owned(), source })?;
        Self::from_urdf(&text, &path.display().to_string())
    }

    /// Reads URDF text; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_urdf(text: &str, file: &str) -> Result<Self, UrdfError> {
        Reader { document: &parse(text, file)?, file }.body()
    }
}

/// The elements of a file.
pub(crate) fn parse<'i>(text: &'i str, file: &str) -> Result<Document<'i>, UrdfError> {
    let options = ParsingOptions { nodes_limit: NODES, ..ParsingOptions::default() };
    Document::parse_with_options(text, options)
        .map_err(|error| UrdfError::Xml { file: file.to_owned(), reason: error.to_string() })
}

/// A joint as the file says it, before it is known what moves it.
struct Read<'a, 'i> {
    joint: Joint,
    /// Name of the joint that it follows, factor and offset.
    follows: Option<(&'a str, f64, f64)>,
    node: Node<'a, 'i>,
}

/// The first child with this tag.
fn child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|n| n.has_tag_name(tag))
}

/// A file that is read.
pub(crate) struct Reader<'a, 'i> {
    pub document: &'a Document<'i>,
    /// What errors call it.
    pub file: &'a str,
}

impl<'a, 'i> Reader<'a, 'i> {
    pub(crate) fn wrong(&self, node: Node<'_, '_>, reason: impl Into<String>) -> UrdfError {
        let tag = node.tag_name().name();
        let owner = node.ancestors().find_map(|n| n.attribute("name").map(|name| (n, name)));
        let element = match owner {
            Some((n, name)) if n == node => format!("{tag} \"{name}\""),
            Some((n, name)) => format!("{tag} of {} \"{name}\"", n.tag_name().name()),
            None => tag.to_owned(),
        };
        UrdfError::Element {
            file: self.file.to_owned(),
            line: self.document.text_pos_at(node.range().start).row,
            element,
            reason: reason.into(),
        }
    }

    fn tree(&self, reason: String) -> UrdfError {
        UrdfError::Tree { file: self.file.to_owned(), reason }
    }

    /// The element that holds all others; `kind` is what the file is to be.
    pub(crate) fn robot(&self, kind: &str) -> Result<Node<'a, 'i>, UrdfError> {
        let robot = self.document.root_element();
        if robot.tag_name().name() != "robot" {
            return Err(self.wrong(
                robot,
                format!("is not the element `robot` that {kind} begins with; give another file"),
            ));
        }
        if let Some(node) =
            robot.descendants().find(|n| n.tag_name().namespace().is_some_and(|ns| ns.contains("xacro")))
        {
            return Err(
                self.wrong(node, "is xacro, which is not expanded here; give the output of `xacro FILE`")
            );
        }
        Ok(robot)
    }

    fn body(&self) -> Result<Body, UrdfError> {
        let robot = self.robot("a URDF")?;
        let (links, index) = self.links(robot)?;
        let inertias = self.inertias(robot)?;
        let read = self.joints(robot, &index)?;
        let mut above = vec![None; links.len()];
        for (j, Read { joint, node, .. }) in read.iter().enumerate() {
            if let Some(other) = above[joint.child].replace(j) {
                let other = &read[other].joint.name;
                let child = &links[joint.child];
                return Err(self.wrong(
                    *node,
                    format!("carries link \"{child}\", which joint \"{other}\" carries already; remove one of them"),
                ));
            }
        }
        let root = self.root(&links, &above)?;
        let (joints, coordinates) = self.movers(read)?;
        let order = self.order(&links, &joints, root)?;
        let name = robot.attribute("name").unwrap_or_default().to_owned();
        Ok(Body { name, links, inertias, joints, above, order, root, coordinates })
    }

    /// The children of the robot with this tag, each with its name.
    fn named(&self, robot: Node<'a, 'i>, tag: &str) -> Result<Vec<(&'a str, Node<'a, 'i>)>, UrdfError> {
        let mut known: HashMap<&str, u32> = HashMap::new();
        let mut found = Vec::new();
        for node in robot.children().filter(|n| n.has_tag_name(tag)) {
            let Some(name) = node.attribute("name").filter(|name| !name.trim().is_empty()) else {
                return Err(self.wrong(node, "has no name; give it one"));
            };
            let line = self.document.text_pos_at(node.range().start).row;
            if let Some(first) = known.insert(name, line) {
                return Err(
                    self.wrong(node, format!("is there already, in line {first}; give each its own name"))
                );
            }
            found.push((name, node));
        }
        Ok(found)
    }

    fn links(&self, robot: Node<'a, 'i>) -> Result<(Vec<String>, HashMap<&'a str, usize>), UrdfError> {
        let named = self.named(robot, "link")?;
        if named.is_empty() {
            return Err(self.wrong(robot, "has no link; a body has one at least"));
        }
        let index = named.iter().enumerate().map(|(i, (name, _))| (*name, i)).collect();
        Ok((named.into_iter().map(|(name, _)| name.to_owned()).collect(), index))
    }

    fn inertias(&self, robot: Node<'a, 'i>) -> Result<Vec<Option<Inertia>>, UrdfError> {
        let links = robot.children().filter(|n| n.has_tag_name("link"));
        links.map(|link| child(link, "inertial").map_or(Ok(None), |n| self.inertia(n))).collect()
    }

    fn inertia(&self, node: Node<'_, '_>) -> Result<Option<Inertia>, UrdfError> {
        let Some(mass) = child(node, "mass") else { return Ok(None) };
        let mass = self.number(mass, "value", 0.0)?;
        let pose = child(node, "origin").map_or(Ok(Isometry3::identity()), |n| self.origin(n))?;
        let mut tensor = Matrix3::zeros();
        if let Some(inertia) = child(node, "inertia") {
            let keys =
                [("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)];
            for (key, row, column) in keys {
                let value = self.number(inertia, key, 0.0)?;
                (tensor[(row, column)], tensor[(column, row)]) = (value, value);
            }
        }
        let turn = pose.rotation.to_rotation_matrix();
        let tensor = turn * tensor * turn.transpose();
        Ok(Some(Inertia { mass, center: Point3::from(pose.translation.vector), tensor }))
    }

    fn joints(
        &self,
        robot: Node<'a, 'i>,
        links: &HashMap<&'a str, usize>,
    ) -> Result<Vec<Read<'a, 'i>>, UrdfError> {
        let named = self.named(robot, "joint")?;
        named.into_iter().map(|(name, node)| self.joint(name, node, links)).collect()
    }

    fn joint(
        &self,
        name: &str,
        node: Node<'a, 'i>,
        links: &HashMap<&'a str, usize>,
    ) -> Result<Read<'a, 'i>, UrdfError> {
        let child_of = |tag: &str| child(node, tag);
        let kind = match node.attribute("type") {
            Some("fixed") => JointKind::Fixed,
            Some("revolute") => JointKind::Revolute,
            Some("continuous") => JointKind::Continuous,
            Some("prismatic") => JointKind::Prismatic,
            other => {
                return Err(self.wrong(
                    node,
                    format!(
                        "has type \"{}\"; fixed, revolute, continuous and prismatic are known: write a joint of several degrees \
                         of freedom as several joints",
                        other.unwrap_or_default()
                    ),
                ));
            }
        };
        let end = |tag: &str| {
            let link = child_of(tag).and_then(|n| n.attribute("link"));
            let link = link.ok_or_else(|| self.wrong(node, format!("has no <{tag} link=\"…\"/>; add it")))?;
            links.get(link).copied().ok_or_else(|| {
                self.wrong(
                    node,
                    format!("names link \"{link}\" as {tag}, and there is none; add it or correct the name"),
                )
            })
        };
        let (parent, child) = (end("parent")?, end("child")?);
        if parent == child {
            return Err(self.wrong(node, "carries its own parent; name another link"));
        }
        let axis = match child_of("axis") {
            Some(axis) if kind != JointKind::Fixed => self.axis(axis)?,
            _ => Vector3::x_axis(),
        };
        let follows = child_of("mimic").filter(|_| kind != JointKind::Fixed);
        let follows = follows.map(|n| self.mimic(n)).transpose()?;
        Ok(Read {
            joint: Joint {
                name: name.to_owned(),
                kind,
                parent,
                child,
                origin: child_of("origin").map_or(Ok(Isometry3::identity()), |n| self.origin(n))?,
                axis,
                limits: child_of("limit").map(|n| self.limits(n, kind)).transpose()?,
                friction: child_of("dynamics").map_or(Ok(Friction::default()), |n| self.friction(n))?,
                moved_by: None,
            },
            follows,
            node,
        })
    }

    /// Three numbers of an attribute; `default` where it is not there.
    fn three(&self, node: Node<'_, '_>, key: &str, default: [f64; 3]) -> Result<[f64; 3], UrdfError> {
        let Some(text) = node.attribute(key) else { return Ok(default) };
        let numbers: Option<Vec<f64>> =
            text.split_whitespace().map(|word| word.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| {
            self.wrong(node, format!("`{key}` is \"{text}\" and must be three finite numbers"))
        })
    }

    /// A number of an attribute; `default` where it is not there.
    fn number(&self, node: Node<'_, '_>, key: &str, default: f64) -> Result<f64, UrdfError> {
        let Some(text) = node.attribute(key) else { return Ok(default) };
        text.trim()
            .parse()
            .ok()
            .filter(|v: &f64| v.is_finite())
            .ok_or_else(|| self.wrong(node, format!("`{key}` is \"{text}\" and must be a finite number")))
    }

    fn origin(&self, node: Node<'_, '_>) -> Result<Isometry3<f64>, UrdfError> {
        let xyz = self.three(node, "xyz", [0.0; 3])?;
        let rpy = self.three(node, "rpy", [0.0; 3])?;
        if xyz.iter().any(|length| length.abs() > FARTHEST) {
            return Err(self.wrong(node, format!("`xyz` is {xyz:?}, more than {FARTHEST} m; give metres")));
        }
        if rpy.iter().any(|angle| angle.abs() > LARGEST_ANGLE) {
            return Err(
                self.wrong(node, format!("`rpy` is {rpy:?}, more than {LARGEST_ANGLE} rad; give radians"))
            );
        }
        let turn = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
        Ok(Isometry3::from_parts(Translation3::from(xyz), turn))
    }

    fn axis(&self, node: Node<'_, '_>) -> Result<Unit<Vector3<f64>>, UrdfError> {
        let axis = Vector3::from(self.three(node, "xyz", [1.0, 0.0, 0.0])?);
        Unit::try_new(axis, SHORTEST_AXIS)
            .ok_or_else(|| self.wrong(node, "has no direction; give a vector of length 1"))
    }

    fn mimic(&self, node: Node<'a, '_>) -> Result<(&'a str, f64, f64), UrdfError> {
        let Some(joint) = node.attribute("joint") else {
            return Err(self.wrong(node, "does not say which joint it follows; add `joint`"));
        };
        Ok((joint, self.number(node, "multiplier", 1.0)?, self.number(node, "offset", 0.0)?))
    }

    fn limits(&self, node: Node<'_, '_>, kind: JointKind) -> Result<Limits, UrdfError> {
        let limits = Limits {
            lower: self.number(node, "lower", 0.0)?,
            upper: self.number(node, "upper", 0.0)?,
            velocity: self.number(node, "velocity", 0.0)?,
            effort: self.number(node, "effort", 0.0)?,
        };
        if matches!(kind, JointKind::Revolute | JointKind::Prismatic) && limits.lower > limits.upper {
            return Err(self.wrong(
                node,
                format!("`lower` is {} and above `upper`, {}; exchange them", limits.lower, limits.upper),
            ));
        }
        Ok(limits)
    }

    fn friction(&self, node: Node<'_, '_>) -> Result<Friction, UrdfError> {
        let least_0 = |key: &str| {
            let value = self.number(node, key, 0.0)?;
            if value < 0.0 {
                return Err(self.wrong(node, format!("`{key}` is {value} and must be 0 or more")));
            }
            Ok(value)
        };
        Ok(Friction { coulomb: least_0("friction")?, viscous: least_0("damping")? })
    }

    fn root(&self, links: &[String], above: &[Option<usize>]) -> Result<usize, UrdfError> {
        let roots: Vec<usize> = (0..links.len()).filter(|link| above[*link].is_none()).collect();
        match *roots.as_slice() {
            [root] => Ok(root),
            [] => Err(self.tree(
                "every link is carried by a joint, so that the joints form a loop; remove the joint that closes it".into(),
            )),
            _ => {
                let names: Vec<&str> = roots.iter().map(|link| links[*link].as_str()).collect();
                Err(self.tree(format!(
                    "has {} roots, links that no joint carries: {}; join them by joints (type \"fixed\" where nothing moves)",
                    roots.len(),
                    names.join(", ")
                )))
            }
        }
    }

    /// What moves each joint: itself, or the one at the end of the chain that it follows.
    fn movers(&self, mut read: Vec<Read<'_, '_>>) -> Result<(Vec<Joint>, Vec<usize>), UrdfError> {
        let index: HashMap<String, usize> =
            read.iter().enumerate().map(|(j, r)| (r.joint.name.clone(), j)).collect();
        let free = |r: &Read<'_, '_>| r.joint.kind != JointKind::Fixed && r.follows.is_none();
        let coordinates: Vec<usize> = (0..read.len()).filter(|j| free(&read[*j])).collect();
        let mut moved = vec![None; read.len()];
        for (start, slot) in moved.iter_mut().enumerate() {
            if read[start].joint.kind == JointKind::Fixed {
                continue;
            }
            let (mut at, mut multiplier, mut offset) = (start, 1.0, 0.0);
            let mut steps = 0;
            while let Some((name, factor, shift)) = read[at].follows {
                let node = read[at].node;
                let leader = index.get(name).copied().filter(|j| read[*j].joint.kind != JointKind::Fixed);
                at = leader.ok_or_else(|| {
                    self.wrong(
                        node,
                        format!("follows joint \"{name}\", and there is no joint of that name that moves"),
                    )
                })?;
                (multiplier, offset) = (multiplier * factor, offset + multiplier * shift);
                steps += 1;
                if steps > read.len() {
                    return Err(
                        self.wrong(node, "follows itself over other joints; let one of them follow nobody")
                    );
                }
            }
            let coordinate = coordinates.iter().position(|j| *j == at).unwrap_or_default();
            *slot = Some(Mimic { coordinate, multiplier, offset });
        }
        for (r, by) in read.iter_mut().zip(moved) {
            r.joint.moved_by = by;
        }
        Ok((read.into_iter().map(|r| r.joint).collect(), coordinates))
    }

    /// Joints with those nearer to the root first. What cannot be reached from the root is a loop: each link has one joint above.
    fn order(&self, links: &[String], joints: &[Joint], root: usize) -> Result<Vec<usize>, UrdfError> {
        let mut below: Vec<Vec<usize>> = vec![Vec::new(); links.len()];
        for (j, joint) in joints.iter().enumerate() {
            below[joint.parent].push(j);
        }
        let (mut order, mut reached) = (Vec::with_capacity(joints.len()), vec![root]);
        while let Some(link) = reached.pop() {
            for j in &below[link] {
                order.push(*j);
                reached.push(joints[*j].child);
            }
        }
        if order.len() == joints.len() {
            return Ok(order);
        }
        let loose: Vec<&str> =
            (0..joints.len()).filter(|j| !order.contains(j)).map(|j| joints[j].name.as_str()).collect();
        Err(self.tree(format!(
            "joints {} form a loop that the root \"{}\" does not carry; remove the joint that closes it",
            loose.join(", "),
            links[root]
        )))
    }
}

#[cfg(test)]
mod tests;
