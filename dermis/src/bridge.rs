//! The zenoh bridge as a program of its own.

use anyhow::Result;
use clap::Args;
use dermis_bridge_zenoh::{Bridge, BridgeConfig};
use dermis_node::{NetworkChoice, Node, NodeOptions, Reach};
use dermis_perception::cli::NetworkArguments;

use crate::backend::{Backends, Choice};

/// Where the bridge appears.
#[derive(Args)]
pub struct Options {
    /// Second part of every key: one word that tells this robot from others.
    #[arg(long, default_value = "robot")]
    robot: String,
    /// `peer` finds others by itself, `client` talks through a router.
    #[arg(long, default_value = "peer")]
    mode: String,
    /// Endpoint to connect to, e.g. tcp/192.0.2.1:7447; may be repeated.
    #[arg(long)]
    connect: Vec<String>,
    /// Endpoint to listen on, e.g. tcp/0.0.0.0:7448; may be repeated.
    #[arg(long)]
    listen: Vec<String>,
    /// Offer no commands: nobody tares, switches or loads a model through it.
    #[arg(long)]
    read_only: bool,
    #[command(flatten)]
    network: NetworkArguments,
    /// How far the ROS side reaches, where it is not to be as far as the JSON: `--network lan --ros-network loopback` offers
    /// the JSON of this machine's skins to other hosts, and no command.
    #[arg(long, value_name = "REACH")]
    ros_network: Option<Reach>,
    /// ROS 2 implementation that the skins speak.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C.
pub async fn run(options: Options, backends: &Backends) -> Result<()> {
    let network = options.network.choice();
    let ros = match options.ros_network {
        Some(reach) => NetworkChoice { network: Some(reach), zenoh_config: None },
        None => network.clone(),
    };
    // Before clients see it.
    dermis_node::end_all_nodes_on_signal()?;
    let node_options = NodeOptions::new("dermis_bridge").network(ros);
    let node = Node::open(node_options, backends.open(options.backend)?.as_ref())?;
    let config = BridgeConfig {
        robot: options.robot,
        mode: options.mode,
        connect: options.connect,
        listen: options.listen,
        read_only: options.read_only,
        network,
    };
    let bridge = Bridge::open(&node, config).await?;
    node.wait_for_shutdown().await?;
    bridge.close().await;
    Ok(())
}
