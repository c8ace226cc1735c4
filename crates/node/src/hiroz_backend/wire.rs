//! Names, types and QoS as `rmw_zenoh` writes them.

use hiroz::entity::{EndpointEntity, Entity, TypeHash, TypeInfo};
use hiroz_protocol::qos as wire_qos;

use crate::backend::BackendError;
use crate::qos::{Durability, History, Qos, Reliability};

/// Depth of the history that `rmw_zenoh` keeps for “keep all”.
const KEEP_ALL_DEPTH: usize = 42;

/// Whether an endpoint has this type, by name and hash.
pub(super) fn has_type(entity: &Entity, type_info: &TypeInfo) -> bool {
    endpoint(entity).is_some_and(|endpoint| {
        endpoint
            .type_info
            .as_ref()
            .is_some_and(|other| other.name == type_info.name && other.hash == type_info.hash)
    })
}

pub(super) fn endpoint(entity: &Entity) -> Option<&EndpointEntity> {
    if let Entity::Endpoint(endpoint) = entity { Some(endpoint) } else { None }
}

/// `std_msgs/msg/String` as the wire names it: `std_msgs::msg::dds_::String_`.
fn wire_type_name(name: &str) -> String {
    match name.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => name.to_owned(),
    }
}

/// The inverse of [`wire_type_name`].
pub(super) fn ros_type_name(name: &str) -> String {
    name.replace("::dds_::", "/").replace("::", "/").trim_end_matches('_').to_owned()
}

pub(super) fn type_info(
    what: &'static str,
    topic: &str,
    name: &str,
    hash: &str,
) -> Result<TypeInfo, BackendError> {
    let hash = TypeHash::from_rihs_string(hash).ok_or_else(|| BackendError::Endpoint {
        what,
        name: topic.to_owned(),
        reason: format!("`{hash}` is not a RIHS01 type hash"),
    })?;
    Ok(TypeInfo { name: wire_type_name(name), hash })
}

pub(super) fn to_wire_qos(qos: &Qos) -> hiroz::qos::QosProfile {
    hiroz::qos::QosProfile {
        reliability: match qos.reliability {
            Reliability::BestEffort => hiroz::qos::QosReliability::BestEffort,
            Reliability::Reliable => hiroz::qos::QosReliability::Reliable,
        },
        durability: match qos.durability {
            Durability::Volatile => hiroz::qos::QosDurability::Volatile,
            Durability::TransientLocal => hiroz::qos::QosDurability::TransientLocal,
        },
        history: match qos.depth() {
            Some(depth) => hiroz::qos::QosHistory::from_depth(depth),
            None => hiroz::qos::QosHistory::KeepAll,
        },
        ..hiroz::qos::QosProfile::default()
    }
}

pub(super) fn from_wire_qos(qos: &wire_qos::QosProfile) -> Qos {
    Qos {
        reliability: match qos.reliability {
            wire_qos::QosReliability::BestEffort => Reliability::BestEffort,
            wire_qos::QosReliability::Reliable => Reliability::Reliable,
        },
        durability: match qos.durability {
            wire_qos::QosDurability::Volatile => Durability::Volatile,
            wire_qos::QosDurability::TransientLocal => Durability::TransientLocal,
        },
        history: match qos.history {
            wire_qos::QosHistory::KeepLast(0) => History::KeepLast(KEEP_ALL_DEPTH),
            wire_qos::QosHistory::KeepLast(depth) => History::KeepLast(depth),
            wire_qos::QosHistory::KeepAll => History::KeepAll,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn type_names_go_both_ways() {
        for (ros, wire) in [
            ("dermis_msgs/msg/ContactArray", "dermis_msgs::msg::dds_::ContactArray_"),
            ("std_srvs/srv/Trigger", "std_srvs::srv::dds_::Trigger_"),
        ] {
            assert_eq!(wire_type_name(ros), wire);
            assert_eq!(ros_type_name(wire), ros);
        }
    }

    #[test]
    fn qos_survives_the_wire_form() {
        for qos in [Qos::sensor_data(), Qos::latched(), Qos::services()] {
            assert_eq!(from_wire_qos(&to_wire_qos(&qos).to_protocol_qos()), qos);
        }
    }
}
