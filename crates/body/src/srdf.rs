//! SRDF text → the pairs of links that may touch each other.
//!
//! Problem: where two links of a robot touch each other, the skins of both feel it, and nothing of the environment is there. Which
//! links can do so is what planners know of a robot: MoveIt keeps it in the SRDF (semantic robot description format).
//!
//! Method: the allowed collision matrix as MoveIt makes it of the file (`AllowedCollisionMatrix` of `moveit_core`):
//! `disable_default_collisions` allows all pairs of its link, `enable_collisions` takes a pair out of that, and `disable_collisions`
//! decides last. There is one difference. A pair whose reason is `Never` is not allowed: MoveIt leaves its check out because no posture
//! that it sampled brings these links together. What touches both of them is then something between them.
//!
//! Assumptions: a pair stands for its two links, and not for what is fixed to them. Pairs that collide in some postures only are not
//! in the file, because planners have to avoid those.
//!
//! Cost: linear in the length of the file; quadratic in the number of links with skins where it has `disable_default_collisions`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use roxmltree::Node;

use crate::body::Body;
use crate::urdf::{Reader, UrdfError, parse};

/// Reason of a pair that no posture brings together.
const NEVER: &str = "never";

/// Reads an SRDF file: the pairs of `carriers` (indices of links) that may touch each other, the smaller index first.
///
/// # Errors
///
/// [`UrdfError`] names the file, the line and the element.
pub(crate) fn load(
    path: &Path,
    body: &Body,
    carriers: &BTreeSet<usize>,
) -> Result<Vec<[usize; 2]>, UrdfError> {
    let text = dermis_io::read_text(path, dermis_io::TEXT)
        .map_err(|source| UrdfError::Read { path: path.to_owned(), source })?;
    read(&text, &path.display().to_string(), body, carriers)
}

/// Reads SRDF text; `file` is what errors call it.
fn read(
    text: &str,
    file: &str,
    body: &Body,
    carriers: &BTreeSet<usize>,
) -> Result<Vec<[usize; 2]>, UrdfError> {
    let reader = Reader { document: &parse(text, file)?, file };
    let robot = reader.robot("an SRDF")?;
    let of_urdf = body.name();
    if robot.attribute("name").is_some_and(|name| !of_urdf.is_empty() && name != of_urdf) {
        let reason = format!("is another robot than \"{of_urdf}\" of the URDF; give the SRDF of that robot");
        return Err(reader.wrong(robot, reason));
    }
    let all = |tag: &'static str| robot.children().filter(move |node| node.has_tag_name(tag));
    let mut allowed: BTreeMap<[usize; 2], bool> = BTreeMap::new();
    for node in all("disable_default_collisions") {
        let link = reader.named_link(node, "link", body)?;
        if carriers.contains(&link) {
            allowed.extend(carriers.iter().filter(|c| **c != link).map(|c| (pair(link, *c), true)));
        }
    }
    for node in all("enable_collisions") {
        allowed.insert(reader.named_pair(node, body)?, false);
    }
    for node in all("disable_collisions") {
        let never = node.attribute("reason").is_some_and(|r| r.trim().eq_ignore_ascii_case(NEVER));
        allowed.insert(reader.named_pair(node, body)?, !never);
    }
    let carry = |links: &[usize; 2]| links.iter().all(|link| carriers.contains(link));
    Ok(allowed.into_iter().filter(|(links, may)| *may && carry(links)).map(|(links, _)| links).collect())
}

/// Two links, the smaller index first.
fn pair(a: usize, b: usize) -> [usize; 2] {
    [a.min(b), a.max(b)]
}

impl Reader<'_, '_> {
    /// The link that an attribute names.
    fn named_link(&self, node: Node<'_, '_>, key: &str, body: &Body) -> Result<usize, UrdfError> {
        let Some(name) = node.attribute(key).map(str::trim) else {
            return Err(self.wrong(node, format!("has no `{key}`; name a link there")));
        };
        body.link(name).ok_or_else(|| {
            let reason = format!(
                "names link \"{name}\" as `{key}`, and the URDF has none of that name; correct it, or remove the line"
            );
            self.wrong(node, reason)
        })
    }

    /// The two links that an element is about.
    fn named_pair(&self, node: Node<'_, '_>, body: &Body) -> Result<[usize; 2], UrdfError> {
        let (a, b) = (self.named_link(node, "link1", body)?, self.named_link(node, "link2", body)?);
        if a == b {
            let name = &body.links()[a];
            return Err(self.wrong(node, format!("names link \"{name}\" twice; name two links")));
        }
        Ok(pair(a, b))
    }
}

#[cfg(test)]
mod tests;
