//! Looks at the ROS graph for what silently keeps messages from arriving: two nodes of one name, quality
//! of service that does not match, and types of one topic that differ.

use std::collections::BTreeMap;

use crate::backend::{BackendError, BackendNode, EndpointInfo, EndpointKind};
use crate::qos::Qos;

/// Kind of a [`Problem`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum ProblemKind {
    /// Another node has the name of this one.
    DuplicateNode,
    /// A peer's quality of service does not fit.
    QosMismatch,
    /// A peer uses another type, or another version of the type, on the same topic.
    TypeMismatch,
}

/// Something in the ROS graph that keeps messages from arriving.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What kind.
    pub kind: ProblemKind,
    /// The node, topic or service it is about.
    pub name: String,
    /// One sentence with what to do.
    pub sentence: String,
}

/// An endpoint of this node, as far as others must fit it.
#[derive(Debug, Clone)]
pub(crate) struct OwnEndpoint {
    pub kind: EndpointKind,
    pub name: String,
    pub type_name: &'static str,
    pub type_hash: &'static str,
    /// None for services.
    pub qos: Option<Qos>,
}

/// All problems of a node, by a key that stays the same while a problem lasts.
pub(crate) fn problems(
    node: &dyn BackendNode,
    full_name: &str,
    own: &[OwnEndpoint],
) -> Result<BTreeMap<(ProblemKind, String), Problem>, BackendError> {
    let mut found = BTreeMap::new();
    let count = node.node_names()?.iter().filter(|name| *name == full_name).count();
    if count > 1 {
        let problem = Problem {
            kind: ProblemKind::DuplicateNode,
            name: full_name.to_owned(),
            sentence: format!(
                "{count} nodes are named {full_name}: their topics and services mix; stop one of them or \
                 start it under another name or namespace (`__node:=…`, `__ns:=…`)"
            ),
        };
        found.insert((problem.kind, problem.name.clone()), problem);
    }
    for endpoint in own {
        let other_kind = match endpoint.kind {
            EndpointKind::Publisher => EndpointKind::Subscription,
            EndpointKind::Subscription => EndpointKind::Publisher,
            EndpointKind::Service => EndpointKind::Client,
            EndpointKind::Client => EndpointKind::Service,
        };
        for peer in node.endpoints(&endpoint.name, other_kind)? {
            if let Some(problem) = mismatch(endpoint, other_kind, &peer) {
                let key = format!("{} {} {}", endpoint.name, peer.node, problem.sentence);
                found.insert((problem.kind, key), problem);
            }
        }
    }
    Ok(found)
}

fn word(kind: EndpointKind) -> &'static str {
    match kind {
        EndpointKind::Publisher => "publishes",
        EndpointKind::Subscription => "subscribes",
        EndpointKind::Service => "serves",
        EndpointKind::Client => "calls",
    }
}

fn mismatch(own: &OwnEndpoint, kind: EndpointKind, peer: &EndpointInfo) -> Option<Problem> {
    let name = &own.name;
    if !peer.type_name.is_empty() && peer.type_name != own.type_name {
        return Some(Problem {
            kind: ProblemKind::TypeMismatch,
            name: name.clone(),
            sentence: format!(
                "{name}: node {} {} {}, this node uses {}: no message passes between them",
                peer.node,
                word(kind),
                peer.type_name,
                own.type_name
            ),
        });
    }
    if let Some(hash) = peer.type_hash.as_deref()
        && hash != own.type_hash
        && hash.starts_with("RIHS01_")
    {
        return Some(Problem {
            kind: ProblemKind::TypeMismatch,
            name: name.clone(),
            sentence: format!(
                "{name}: node {} was built with another version of {} ({} there, {} here): no message \
                     passes between them; build both against the same interface package",
                peer.node,
                own.type_name,
                short(hash),
                short(own.type_hash)
            ),
        });
    }
    let (own_qos, peer_qos) = (own.qos?, peer.qos?);
    let why = match own.kind {
        EndpointKind::Publisher => peer_qos.unmet_by(&own_qos)?,
        EndpointKind::Subscription => own_qos.unmet_by(&peer_qos)?,
        EndpointKind::Service | EndpointKind::Client => return None,
    };
    Some(Problem {
        kind: ProblemKind::QosMismatch,
        name: name.clone(),
        sentence: format!(
            "{name}: {why}: node {} has ({peer_qos}), this node has ({own_qos}); over DDS no message \
             passes, over zenoh the requested profile is not kept",
            peer.node
        ),
    })
}

/// The beginning of a hash, enough to tell two apart.
fn short(hash: &str) -> &str {
    hash.get(..15).unwrap_or(hash)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn own(kind: EndpointKind, qos: Qos) -> OwnEndpoint {
        OwnEndpoint {
            kind,
            name: "/contacts".to_owned(),
            type_name: "dermis_msgs/msg/ContactArray",
            type_hash: "RIHS01_1111111111111111",
            qos: Some(qos),
        }
    }

    fn peer(qos: Qos) -> EndpointInfo {
        EndpointInfo {
            node: "/planner".to_owned(),
            own: false,
            type_name: "dermis_msgs/msg/ContactArray".to_owned(),
            type_hash: Some("RIHS01_1111111111111111".to_owned()),
            qos: Some(qos),
        }
    }

    #[test]
    fn what_fits_is_no_problem() {
        let own = own(EndpointKind::Publisher, Qos::latched());
        assert_eq!(mismatch(&own, EndpointKind::Subscription, &peer(Qos::sensor_data())), None);
    }

    #[test]
    fn qos_is_compared_in_the_right_direction() {
        let publisher = own(EndpointKind::Publisher, Qos::sensor_data());
        let problem = mismatch(&publisher, EndpointKind::Subscription, &peer(Qos::reliable(10))).unwrap();
        insta::assert_snapshot!(problem.sentence, @"/contacts: the subscription asks for reliable, the publisher offers best effort: node /planner has (reliable, volatile, keep last 10), this node has (best effort, volatile, keep last 5); over DDS no message passes, over zenoh the requested profile is not kept");
        let subscription = own(EndpointKind::Subscription, Qos::sensor_data());
        assert_eq!(mismatch(&subscription, EndpointKind::Publisher, &peer(Qos::reliable(10))), None);
    }

    #[test]
    fn types_are_compared_by_name_and_hash() {
        let own = own(EndpointKind::Publisher, Qos::sensor_data());
        let mut other = peer(Qos::sensor_data());
        other.type_hash = Some("RIHS01_2222222222222222".to_owned());
        let problem = mismatch(&own, EndpointKind::Subscription, &other).unwrap();
        insta::assert_snapshot!(problem.sentence, @"/contacts: node /planner was built with another version of dermis_msgs/msg/ContactArray (RIHS01_22222222 there, RIHS01_11111111 here): no message passes between them; build both against the same interface package");
        other.type_name = "std_msgs/msg/String".to_owned();
        let problem = mismatch(&own, EndpointKind::Subscription, &other).unwrap();
        insta::assert_snapshot!(problem.sentence, @"/contacts: node /planner subscribes std_msgs/msg/String, this node uses dermis_msgs/msg/ContactArray: no message passes between them");
    }
}
