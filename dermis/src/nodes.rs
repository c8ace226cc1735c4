//! The nodes, one command each.

use anyhow::Result;
use clap::Args;
use dermis_launch::{NodeRequest, Refusal};
use dermis_node::NodeError;
use dermis_perception::{Config, ConfigError, RunError, Sensor};
use serde_json::Value;

use crate::backend::Choice;

/// The node of one skin.
#[derive(Args)]
pub struct Skin {
    #[command(flatten)]
    arguments: dermis_perception::cli::Arguments,
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C, or until it is shut down through its lifecycle.
pub async fn run(sensor: &Sensor, options: Skin) -> Result<()> {
    let config = options.arguments.into_config()?;
    Ok(sensor.run(&config, options.backend.open()?.as_ref()).await?)
}

/// What the process itself says in a launch file, and its table `config` must not say again.
const OUTSIDE: [&str; 5] = ["name", "namespace", "domain_id", "remap", "parameters"];

/// The configuration that a launch file gives this node.
pub fn config(sensor: &Sensor, request: &NodeRequest<'_>) -> Result<Value, Refusal> {
    let refuse = |field: String, reason: String| Refusal { field, reason };
    let loaded = match request.config {
        Value::String(path) => Config::load(request.folder.join(path)),
        Value::Null => {
            return Err(refuse(
                "config".into(),
                "is missing; give a table with `skin` and `source`, or a configuration file".into(),
            ));
        }
        table => {
            if let Some(key) = OUTSIDE.into_iter().find(|key| table.get(key).is_some()) {
                return Err(refuse(
                    format!("config.{key}"),
                    format!("belongs to the process; move `{key}` out of `config`"),
                ));
            }
            Config::from_json(table.clone(), request.file, request.folder)
        }
    };
    let mut config = loaded.map_err(|error| match error {
        ConfigError::UnknownKey { key, path } if path == request.file => {
            let known: Vec<&str> = Config::KEYS.into_iter().filter(|key| !OUTSIDE.contains(key)).collect();
            refuse(format!("config.{key}"), format!("is not known; known here: {}", known.join(", ")))
        }
        ConfigError::Field { field, reason, path } if path == request.file => match field.as_str() {
            "(top level)" => refuse("config".into(), reason),
            field => refuse(format!("config.{field}"), reason),
        },
        other => refuse("config".into(), other.to_string()),
    })?;
    config.name = Some(request.name.to_owned());
    request.namespace.clone_into(&mut config.namespace);
    config.domain_id = request.domain_id.or(config.domain_id);
    config.remap.extend_from_slice(request.remap);
    config.parameters.extend(request.parameters.iter().map(|(name, value)| (name.clone(), value.clone())));
    sensor.check(&config).map_err(|error| {
        let field = match &error {
            RunError::Skin(_) | RunError::Sensor { .. } => "config.skin".to_owned(),
            RunError::Source(_) => "config.source".to_owned(),
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
        refuse(field, error.to_string())
    })?;
    serde_json::to_value(&config).map_err(|error| refuse("config".into(), error.to_string()))
}
