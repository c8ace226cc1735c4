//! The process's one ROS context, and the network that it joins.

use std::sync::OnceLock;

use dermis_node::backend::{BackendError, NodeSpec};
use dermis_node::{Network, Reach};

use super::NAME;

/// Domain and network that the process's one ROS context was made with.
static CONTEXT: OnceLock<(u16, Network)> = OnceLock::new();

/// The process's ROS context; the first call decides on the domain and the network.
pub(crate) fn context(spec: &NodeSpec) -> Result<r2r::Context, BackendError> {
    let refuse = |reason: String| BackendError::Open { backend: NAME, node: spec.full_name(), reason };
    let variables =
        ros_variables(&spec.network, std::env::var("RMW_IMPLEMENTATION").ok().as_deref()).map_err(refuse)?;
    let made = CONTEXT.get_or_init(|| {
        set_variable("ROS_DOMAIN_ID", Some(&spec.domain_id.to_string()));
        for (name, value) in &variables {
            set_variable(name, value.as_deref());
        }
        (spec.domain_id, spec.network.clone())
    });
    if made.0 != spec.domain_id {
        return Err(refuse(format!(
            "this process is in ROS domain {} already and cannot be in domain {} too: start another process",
            made.0, spec.domain_id
        )));
    }
    if (made.1.reach, &made.1.static_peers, &made.1.zenoh_config)
        != (spec.network.reach, &spec.network.static_peers, &spec.network.zenoh_config)
    {
        return Err(refuse(format!(
            "this process has joined ROS with network {} (by {}) already and cannot have network {} (by {}) too: start another process",
            made.1.reach, made.1.decided_by, spec.network.reach, spec.network.decided_by
        )));
    }
    // r2r panics where rcl refuses the program's `--ros-args`.
    match std::panic::catch_unwind(r2r::Context::create) {
        Ok(context) => context.map_err(|e| refuse(format!("ROS 2 does not start ({e}): is it sourced?"))),
        Err(panic) => {
            let why = panic.downcast_ref::<String>().map_or("no reason given", String::as_str);
            Err(refuse(format!("ROS 2 does not start: {why}")))
        }
    }
}

/// The variables that tell rcl and its middleware how far to reach; `None` unsets one.
pub(crate) fn ros_variables(
    network: &Network,
    rmw: Option<&str>,
) -> Result<Vec<(&'static str, Option<String>)>, String> {
    if let Some(file) = &network.zenoh_config {
        if rmw != Some("rmw_zenoh_cpp") {
            return Err(format!(
                "the zenoh configuration {} means nothing to {}: set RMW_IMPLEMENTATION=rmw_zenoh_cpp, or use --network loopback or lan",
                file.display(),
                rmw.unwrap_or("the ROS middleware in use"),
            ));
        }
        return Ok(vec![("ZENOH_SESSION_CONFIG_URI", Some(file.display().to_string()))]);
    }
    let range = match network.reach {
        Reach::Off => "OFF",
        Reach::Loopback => "LOCALHOST",
        Reach::Lan => "SUBNET",
        Reach::Address(address) => {
            return Err(format!(
                "ROS 2 cannot be restricted to the address {address}: use --network loopback or lan, or choose the interface in the configuration of your middleware (FASTRTPS_DEFAULT_PROFILES_FILE, CYCLONEDDS_URI)"
            ));
        }
    };
    let peers = (!network.static_peers.is_empty()).then(|| network.static_peers.join(";"));
    Ok(vec![
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", Some(range.to_owned())),
        ("ROS_STATIC_PEERS", peers),
        // It would win over the two above.
        ("ROS_LOCALHOST_ONLY", None),
    ])
}

/// Who can reach a node of this backend, which is up to the middleware in the end.
pub(crate) fn open_to(network: &Network) -> String {
    let rmw = std::env::var("RMW_IMPLEMENTATION").unwrap_or_else(|_| "the default middleware".to_owned());
    let by = &network.decided_by;
    let mut sentence = match (&network.zenoh_config, network.reach) {
        (Some(file), _) => format!("network: open to whom {} lets in", file.display()),
        (None, Reach::Off) => "network: looks for nobody".to_owned(),
        (None, Reach::Loopback | Reach::Address(_)) => {
            "network: looks for programs on this machine only (ROS 2 discovery; DDS itself may still listen on every interface)"
                .to_owned()
        }
        (None, Reach::Lan) => "network: open to every host that reaches this machine".to_owned(),
    };
    if !network.static_peers.is_empty() {
        sentence += &format!("; connects to {}", network.static_peers.join(", "));
    }
    format!("{sentence}, over ROS 2 with {rmw} (by {by})")
}

/// Sets a variable that rcl reads when it starts; it takes the domain and the discovery range from nowhere else.
fn set_variable(name: &str, value: Option<&str>) {
    if std::env::var(name).ok().as_deref() == value {
        return;
    }
    // SAFETY: this runs once, before rcl is initialised, so that no ROS thread reads the environment yet; threads
    // of Rust read it under the lock of the standard library.
    unsafe {
        match value {
            Some(value) => std::env::set_var(name, value),
            None => std::env::remove_var(name),
        }
    }
}
