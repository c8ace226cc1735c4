//! From a configuration to what a node is started with: skin, source, options of the ROS node, correction.
//!
//! [`check`] does all that can be done of it without a device and without a ROS graph, and lists every fault.

use dermis_estimate::{SetupError, SkinEstimator};
use dermis_inference::Bundle;
use dermis_node::{NodeOptions, ParameterDescriptor, ParameterValue, Parameters, parse_remapping};
use dermis_sensor::Sensor;
use dermis_skin::{ModelError, SkinDescription};
use dermis_transport::SourceUrl;

use super::RunError;
use super::parameters::declare;
use crate::commands::Command;
use crate::config::Config;

pub(super) fn options(config: &Config, skin: &SkinDescription) -> Result<NodeOptions, RunError> {
    let mut options = NodeOptions::new(config.node_name(skin))
        .namespace(&config.namespace)
        .use_sim_time(config.use_sim_time);
    options.parameters_refused = config.commands.refusal(Command::Parameters);
    options.lifecycle_refused = config.commands.refusal(Command::Lifecycle);
    options.domain_id = config.domain_id;
    options.network = config.network_choice();
    for rule in &config.remap {
        let (from, to) = parse_remapping(rule)?;
        options = options.remap(from, to);
    }
    for (name, value) in &config.parameters {
        let value = ParameterValue::from_json(value)
            .ok_or_else(|| RunError::ParameterValue { name: name.clone(), value: value.to_string() })?;
        options = options.parameter(name, value);
    }
    Ok(options)
}

/// See [`crate::check`].
pub(crate) fn check(sensor: &dyn Sensor, config: &Config) -> Vec<RunError> {
    let mut faults: Vec<RunError> =
        SourceUrl::parse(&config.source).map_err(RunError::from).err().into_iter().collect();
    // All the rest is about the skin.
    let skin = match skin(sensor, config) {
        Ok(skin) => skin,
        Err(error) => {
            faults.push(error);
            return faults;
        }
    };
    let bundles = config
        .models
        .iter()
        .filter_map(|folder| Bundle::load_within(folder, &skin, &config.model_limits).err());
    faults.extend(bundles.map(|error| RunError::from(SetupError::from(error))));
    if faults.is_empty() {
        // What is wrong with a bundle makes its correction useless, too.
        faults.extend(check_correction(config, &skin).err());
    }
    let start = || -> Result<(), RunError> {
        let mut estimator = SkinEstimator::new(&skin, &config.masked)?;
        let parameters = Parameters::new(options(config, &skin)?.parameters);
        // Of every node.
        parameters.declare("use_sim_time", config.use_sim_time, ParameterDescriptor::default())?;
        declare(&parameters, config, &skin, &mut estimator)
    };
    faults.extend(start().err());
    faults
}

/// Whether the correction of this device can be read, and is of use to one of the models.
pub(super) fn check_correction(config: &Config, skin: &SkinDescription) -> Result<(), RunError> {
    let Some(file) = &config.correction else { return Ok(()) };
    let mut used = false;
    // A bundle that cannot be read is reported where it is loaded.
    for mut bundle in config.models.iter().filter_map(|folder| Bundle::load(folder, skin).ok()) {
        if bundle.manifest().inversion.is_some() {
            bundle.take_correction(file, skin).map_err(SetupError::from)?;
            used = true;
        }
    }
    if used { Ok(()) } else { Err(RunError::UnusedCorrection { path: file.clone() }) }
}

pub(super) fn skin_and_source(
    sensor: &dyn Sensor,
    config: &Config,
) -> Result<(SkinDescription, SourceUrl), RunError> {
    Ok((skin(sensor, config)?, SourceUrl::parse(&config.source)?))
}

fn skin(sensor: &dyn Sensor, config: &Config) -> Result<SkinDescription, RunError> {
    let skin = SkinDescription::load(&config.skin)?;
    if skin.sensor != sensor.name() {
        return Err(RunError::Sensor {
            path: config.skin.clone(),
            found: skin.sensor,
            expected: sensor.name(),
        });
    }
    if let Err(ModelError::Description { field, reason, .. }) = sensor.check(&skin) {
        return Err(RunError::Medium { path: config.skin.clone(), field, reason });
    }
    Ok(config.instance_of(skin)?)
}
