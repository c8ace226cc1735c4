//! Which topics are recorded, and on which terms.

use std::collections::BTreeSet;

use dermis_bag::BagQos;
use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_msgs::{Message as _, TypeSupport, type_support};
use dermis_node::backend::EndpointInfo;
use dermis_node::{Durability, History, Node, Qos, Reliability};
use regex::Regex;

use super::Request;
use crate::{OperateError, foreign};

/// Messages that a queue of ROS 2 holds for us, where it cannot be without a bound.
const DEPTH: usize = 1000;

/// Which topics are wanted.
pub struct Selection {
    /// Those that were requested by name.
    pub topics: BTreeSet<String>,
    regex: Vec<Regex>,
    types: Vec<String>,
    exclude: Vec<Regex>,
    all: bool,
    hidden: bool,
}

impl Selection {
    pub fn new(request: &Request, node: &Node) -> Result<Self, OperateError> {
        let topics = request.topics.iter().map(|topic| node.resolve_name(topic)).collect::<Result<_, _>>()?;
        let some = !request.topics.is_empty() || !request.regex.is_empty() || !request.types.is_empty();
        Ok(Self {
            topics,
            regex: request.regex.clone(),
            types: request.types.clone(),
            exclude: request.exclude.clone(),
            all: request.all || !some,
            hidden: request.include_hidden,
        })
    }

    /// Which of these topics (name, type) are to be recorded: those that are wanted, and the geometry beside frames that are:
    /// it names their channels, and the recording shall be read by who has nothing else.
    pub fn chosen<'a>(&self, topics: &[(&'a str, &'a str)]) -> Vec<&'a str> {
        let namespace = |topic: &'a str| topic.rsplit_once('/').map_or("", |(namespace, _)| namespace);
        let wanted = |(name, kind): &&(&str, &str)| self.wants(name, kind);
        let framed: BTreeSet<&str> = topics
            .iter()
            .filter(wanted)
            .filter(|(_, kind)| *kind == TaxelFrame::TYPE_NAME)
            .map(|(name, _)| namespace(name))
            .collect();
        let describes = |(name, kind): &(&'a str, &str)| {
            *kind == SkinGeometry::TYPE_NAME
                && framed.contains(namespace(name))
                && !self.exclude.iter().any(|regex| regex.is_match(name))
        };
        topics.iter().filter(|topic| wanted(topic) || describes(topic)).map(|(name, _)| *name).collect()
    }

    /// Whether a topic of this name and type was requested.
    pub fn wants(&self, topic: &str, type_name: &str) -> bool {
        if self.topics.contains(topic) {
            return true;
        }
        let hidden = topic.split('/').any(|part| part.starts_with('_'));
        let found = self.all
            || self.regex.iter().any(|regex| regex.is_match(topic))
            || self.types.iter().any(|wanted| wanted == type_name);
        found && (self.hidden || !hidden) && !self.exclude.iter().any(|regex| regex.is_match(topic))
    }
}

/// The terms to subscribe with, and those to store: reliable and latched only where all publishers offer it.
pub fn adapt(offers: &[EndpointInfo], backend: &str) -> (Qos, BagQos) {
    let known = || offers.iter().filter_map(|offer| offer.qos);
    let all = |test: fn(&Qos) -> bool| known().next().is_some() && known().all(|qos| test(&qos));
    let reliable = all(|qos| qos.reliability == Reliability::Reliable);
    let latched = all(|qos| qos.durability == Durability::TransientLocal);
    let depth = known().map(|qos| qos.depth().unwrap_or(0)).max().unwrap_or(10);
    let keep_all = known().any(|qos| qos.depth().is_none());
    let wanted = Qos {
        reliability: if reliable { Reliability::Reliable } else { Reliability::BestEffort },
        durability: if latched { Durability::TransientLocal } else { Durability::Volatile },
        // What the recorder's own queue, bounded in bytes, does not take, it counts: no queue before it may drop.
        history: if backend == "hiroz" { History::KeepAll } else { History::KeepLast(DEPTH) },
    };
    let offered = BagQos {
        reliability: if reliable {
            dermis_bag::Reliability::Reliable
        } else {
            dermis_bag::Reliability::BestEffort
        },
        durability: if latched {
            dermis_bag::Durability::TransientLocal
        } else {
            dermis_bag::Durability::Volatile
        },
        depth: if keep_all { 0 } else { depth },
    };
    (wanted, offered)
}

/// What is known of the type of a publisher: built in, or by its hash from the graph and its definition from the ROS 2
/// that is sourced.
pub fn support_of(offer: &EndpointInfo) -> Result<&'static TypeSupport, OperateError> {
    let built_in = type_support(&offer.type_name);
    let Some(hash) = &offer.type_hash else {
        return built_in
            .ok_or_else(|| OperateError::UnknownType { type_name: offer.type_name.clone(), place: "graph" });
    };
    if let Some(support) = built_in.filter(|support| support.hash == hash) {
        return Ok(support);
    }
    let definition = foreign::definition(&offer.type_name).map_err(|source| OperateError::ForeignType {
        node: offer.node.clone(),
        other: if built_in.is_some() { "another version of " } else { "" },
        type_name: offer.type_name.clone(),
        source,
    })?;
    Ok(foreign::support(&offer.type_name, hash, &definition))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selection(topics: &[&str], regex: &[&str], types: &[&str], exclude: &[&str], all: bool) -> Selection {
        let regexes = |list: &[&str]| list.iter().map(|text| Regex::new(text).unwrap()).collect();
        Selection {
            topics: topics.iter().map(|&t| t.to_owned()).collect(),
            regex: regexes(regex),
            types: types.iter().map(|&t| t.to_owned()).collect(),
            exclude: regexes(exclude),
            all: all || (topics.is_empty() && regex.is_empty() && types.is_empty()),
            hidden: false,
        }
    }

    #[test]
    fn topics_are_chosen_as_requested() {
        let frame = "dermis_msgs/msg/TaxelFrame";
        assert!(selection(&[], &[], &[], &[], false).wants("/left/taxels", frame));
        assert!(!selection(&[], &[], &[], &[], false).wants("/left/_hidden/x", frame));
        let some = selection(&["/_a"], &["^/left/"], &[frame], &["truth$"], false);
        assert!(some.wants("/_a", "x/msg/Y") && some.wants("/left/b", "x/msg/Y") && some.wants("/c", frame));
        assert!(!some.wants("/c", "x/msg/Y") && !some.wants("/left/ground_truth", frame));
    }

    #[test]
    fn the_geometry_comes_with_its_frames() {
        let geometry = SkinGeometry::TYPE_NAME;
        let there = vec![
            ("/left/contacts", "dermis_msgs/msg/ContactArray"),
            ("/left/skin_geometry", geometry),
            ("/left/taxels", TaxelFrame::TYPE_NAME),
            ("/right/skin_geometry", geometry),
        ];
        let chosen = |topics: &[&str], exclude: &[&str]| {
            selection(topics, &[], &[], exclude, false).chosen(&there).join(" ")
        };
        assert_eq!(chosen(&["/left/taxels"], &[]), "/left/skin_geometry /left/taxels");
        assert_eq!(chosen(&["/left/taxels"], &["geometry"]), "/left/taxels");
        assert_eq!(chosen(&["/left/contacts"], &[]), "/left/contacts");
    }

    #[test]
    fn terms_fit_every_publisher() {
        let offer = |qos: Qos| EndpointInfo {
            node: "/n".into(),
            own: false,
            type_name: String::new(),
            type_hash: None,
            qos: Some(qos),
        };
        let (wanted, stored) = adapt(&[offer(Qos::latched())], "hiroz");
        assert_eq!(
            (wanted.reliability, wanted.durability),
            (Reliability::Reliable, Durability::TransientLocal)
        );
        assert_eq!(stored, BagQos::latched());
        let (wanted, stored) = adapt(&[offer(Qos::latched()), offer(Qos::sensor_data())], "r2r");
        assert_eq!((wanted.reliability, wanted.durability), (Reliability::BestEffort, Durability::Volatile));
        assert_eq!(wanted.history, History::KeepLast(DEPTH));
        assert_eq!(stored, BagQos { depth: 5, ..BagQos::sensor_data() });
    }
}
