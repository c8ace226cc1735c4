//! What launch files say of nodes: whether a node would start with it, and whether nodes can run side by side.
//!
//! `dermis-launch` knows processes, and nothing of skins. What it must know of a node it asks its host, which answers with these
//! functions.

use dermis_launch::{NodeRequest, Plan, Refusal};
use dermis_node::{NetworkChoice, NodeError};
use dermis_perception::{Config, ConfigError, RunError};
use dermis_sensor::Registry;
use dermis_skin::{InstanceError, SkinDescription};
use serde_json::Value;

use crate::OperateError;

/// What the command line says of the network wins over what the file says, for every process but those whose own command
/// line says it.
///
/// # Errors
///
/// Where the zenoh configuration file is not there.
pub fn hand_over(network: &NetworkChoice, plan: &mut Plan) -> Result<(), OperateError> {
    let (flag, value) = match (network.network, &network.zenoh_config) {
        (None, None) => return Ok(()),
        (Some(reach), _) => ("--network", reach.to_string()),
        (None, Some(file)) => {
            let file = file
                .canonicalize()
                .map_err(|source| OperateError::ZenohConfig { path: file.clone(), source })?;
            ("--zenoh-config", file.display().to_string())
        }
    };
    for process in &mut plan.processes {
        process.set_network(network.network.is_some(), &value);
        process.set_option(flag, &value, &["--network", "--zenoh-config"]);
    }
    Ok(())
}

/// The command that reads a skin which another family's node was given.
#[must_use]
pub fn reader(error: &RunError, sensors: &Registry) -> Option<&'static str> {
    let RunError::Sensor { found, .. } = error else { return None };
    sensors.get(found).map(dermis_skin::Family::name)
}

/// What the process itself says in a launch file, and its table `config` must not say again.
const OUTSIDE: [&str; 5] = ["name", "namespace", "domain_id", "remap", "parameters"];

/// The configuration that a launch file gives this node.
///
/// # Errors
///
/// What is wrong in the file, field by field.
pub fn config(request: &NodeRequest<'_>, sensors: &Registry) -> Result<Value, Vec<Refusal>> {
    let sensor = sensors.get(request.kind).ok_or_else(|| {
        let known = sensors.names();
        vec![Refusal {
            field: "node".to_owned(),
            reason: format!("there is no node `{}`; there is {}", request.kind, known.join(", ")),
        }]
    })?;
    let refuse = |field: String, reason: String| Refusal { field, reason };
    let loaded = match request.config {
        Value::String(path) => Config::load(request.folder.join(path)),
        Value::Null => {
            return Err(vec![refuse(
                "config".into(),
                "is missing; give a table with `skin` and `source`, or a configuration file".into(),
            )]);
        }
        table => {
            let outside: Vec<Refusal> = OUTSIDE
                .into_iter()
                .filter(|key| table.get(key).is_some())
                .map(|key| {
                    let reason = format!("belongs to the process; move `{key}` out of `config`");
                    refuse(format!("config.{key}"), reason)
                })
                .collect();
            if !outside.is_empty() {
                return Err(outside);
            }
            Config::from_json(table.clone(), request.file, request.folder)
        }
    };
    let mut config = loaded.map_err(|error| match error {
        ConfigError::UnknownKey { key, path } if path == request.file => {
            let known: Vec<&str> = Config::KEYS.into_iter().filter(|key| !OUTSIDE.contains(key)).collect();
            vec![refuse(format!("config.{key}"), format!("is not known; known here: {}", known.join(", ")))]
        }
        ConfigError::Field { field, reason, path } if path == request.file => match field.as_str() {
            "(top level)" => vec![refuse("config".into(), reason)],
            field => vec![refuse(format!("config.{field}"), reason)],
        },
        other => vec![refuse("config".into(), other.to_string())],
    })?;
    config.name = Some(request.name.to_owned());
    request.namespace.clone_into(&mut config.namespace);
    config.domain_id = request.domain_id.or(config.domain_id);
    config.remap.extend_from_slice(request.remap);
    config.parameters.extend(request.parameters.iter().map(|(name, value)| (name.clone(), value.clone())));
    let refusals: Vec<Refusal> =
        dermis_perception::check(sensor, &config).into_iter().map(|error| refusal(&error, sensors)).collect();
    if !refusals.is_empty() {
        return Err(refusals);
    }
    // Said outright, so that `--check` shows them and nodes can be compared.
    if let Ok(skin) = SkinDescription::load(&config.skin) {
        config.instance = Some(config.instance_name(&skin));
        config.frame_id.get_or_insert(skin.frame_id);
    }
    serde_json::to_value(&config).map_err(|error| vec![refuse("config".into(), error.to_string())])
}

/// Where in the launch file that is wrong which the node would refuse.
fn refusal(error: &RunError, sensors: &Registry) -> Refusal {
    let field = match error {
        RunError::Skin(_) | RunError::Medium { .. } | RunError::Sensor { .. } => "config.skin".to_owned(),
        RunError::Source(_) => "config.source".to_owned(),
        RunError::Instance(InstanceError::Name(_)) => "config.instance".to_owned(),
        RunError::Instance(InstanceError::Frame(_)) => "config.frame_id".to_owned(),
        RunError::Instance(_) => "config.mount".to_owned(),
        RunError::FixedParameter { name, .. } => format!("parameters.{name}"),
        RunError::ParameterValue { name, .. } | RunError::Node(NodeError::Parameter { name, .. }) => {
            format!("parameters.{name}")
        }
        RunError::UnknownParameter { names, .. } => match names.split_once('`') {
            Some(_) => "parameters".to_owned(),
            None => format!("parameters.{names}"),
        },
        RunError::Node(NodeError::Remapping { .. }) => "remap".to_owned(),
        _ => "config".to_owned(),
    };
    let hint = reader(error, sensors).map_or(String::new(), |command| format!("; write `node: {command}`"));
    Refusal { field, reason: format!("{error}{hint}") }
}

/// Whether the devices of these nodes can be distinguished: two of one name would be one skin to everybody who listens, and two of
/// one type in one coordinate frame would lie on top of each other.
#[must_use]
pub fn together(nodes: &[(&str, &Value)]) -> Vec<(usize, Refusal)> {
    let mut found = Vec::new();
    let configs: Vec<Option<Config>> =
        nodes.iter().map(|(_, config)| serde_json::from_value((*config).clone()).ok()).collect();
    let known = |i: usize| configs[i].as_ref().map(|config| (nodes[i].0, config));
    for (i, (_, config)) in (0..nodes.len()).filter_map(|i| Some((i, known(i)?))) {
        for (label, other) in
            (0..i).filter_map(known).filter(|(_, other)| other.domain_id == config.domain_id)
        {
            if let Some(reason) = clash(config, label, other) {
                found.push((i, reason));
            }
        }
    }
    found
}

fn clash(config: &Config, label: &str, other: &Config) -> Option<Refusal> {
    let refusal = |field: &str, reason: String| Some(Refusal { field: format!("config.{field}"), reason });
    let name = config.instance.as_ref()?;
    if other.instance.as_ref() == Some(name) {
        return refusal(
            "instance",
            format!("`{name}` is the skin of `{label}` too; give each a name of its own"),
        );
    }
    let frame_id = config.frame_id.as_ref()?;
    if other.frame_id.as_ref() != Some(frame_id) {
        return None;
    }
    let hash = |config: &Config| SkinDescription::load(&config.skin).ok().map(|skin| skin.hash());
    let alike = hash(config)? == hash(other)?;
    alike.then(|| refusal(
        "frame_id",
        format!(
            "`{frame_id}` is the coordinate frame of `{label}` too, a skin of the same type: their contacts would lie on top of \
             each other; give each a `frame_id` of its own"
        ),
    ))?
}
